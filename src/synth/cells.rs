//! Parses Yosys' report of cells by kind.

use anyhow::{Context, Result};
use serde_json::Value;
use std::collections::BTreeMap;

/// Number of cells of each kind.
pub type Cells = BTreeMap<String, u64>;

/// The cells of a flattened design, from the output of Yosys' `stat -json`.
///
/// # Errors
/// If the text is not such a report, or is incomplete.
pub fn parse_cells(report: &str) -> Result<Cells> {
    const WHAT: &str = "Yosys has written no whole report of its cells";
    let report: Value = serde_json::from_str(report).context(WHAT)?;
    let design = &report["design"];
    let kinds = design["num_cells_by_type"].as_object().context(WHAT)?;
    let cells = (kinds.iter())
        .map(|(kind, count)| Some((kind.clone(), count.as_u64()?)))
        .collect::<Option<Cells>>()
        .context(WHAT)?;
    // Yosys 0.70 counts cells that store scope information separately.
    let all = design["num_cells"].as_u64().context(WHAT)?;
    let sum: u64 = cells.values().sum();
    anyhow::ensure!(
        sum == all,
        "{WHAT}: {all} cells in all, but {sum} by their kinds"
    );
    Ok(cells)
}
