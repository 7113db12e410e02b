//! Proves that a mutated module does the same in every single cycle: from any state and any inputs, the same outputs and the same next state.
//!
//! Registers and memories are cut out: their values become inputs, and their next values become outputs. This leaves two pieces of
//! combinational logic with mostly identical text. Yosys merges the identical part, and its solver decides the rest. Memories may be
//! of any size. A mutation that changes the next value of a register is never proved in this way, even if no port depends on it.
//!
//! Registers are paired by name. The proof is valid for any pairing: states that are equal in every pair remain so.

use crate::hdl::Design;
use crate::prove::tools;
use crate::temporary;
use crate::tools::Ended;
use anyhow::{Context, Result, anyhow};
use serde_json::{Map, Value, json};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

const LIMIT: Duration = Duration::from_secs(60);

/// The description of the proof, for reports.
pub(super) const PROOF: &str = "Yosys: sat, the same outputs and next state from any state";

/// Whether the designs `gold` and `gate` were proved equal within the time limit.
///
/// # Errors
/// If Yosys cannot be started.
pub(super) fn proved(designs: &[(&str, Design); 2]) -> Result<bool> {
    let folder = temporary::Folder::new().context("cannot create a temporary folder")?;
    let mut shapes = vec![];
    for (name, design) in designs {
        let top = design.top().name();
        let mut script = super::equivalence::read(folder.path(), name, design)?;
        script += &format!(
            "hierarchy -top {top}; proc; flatten; memory_collect; opt_clean; setundef -zero; rename {top} {name}; write_json {name}.json"
        );
        if !content(folder.path(), &script)? {
            return Ok(false);
        }
        let Some(cut) = cut(folder.path(), name)? else {
            return Ok(false);
        };
        shapes.push(cut);
    }
    if shapes[0] != shapes[1] {
        return Ok(false);
    }
    let script = "read_json gold.json; read_json gate.json; miter -equiv -flatten gold gate both; hierarchy -top both; \
                  opt_clean; opt -nodffe -nosdff; opt_share; opt -nodffe -nosdff; sat -verify -prove trigger 0 both";
    content(folder.path(), script)
}

/// Whether a script succeeds within the time limit.
fn content(folder: &Path, script: &str) -> Result<bool> {
    let ended = tools::tools()?
        .yosys
        .run_for(folder, LIMIT, &["-q", "-p", script])?;
    Ok(matches!(ended, Ended::With { success: true, .. }))
}

/// Properties that must be equal in two designs before their ports are compared: the ports of cut registers with their widths, and the
/// parameters of the memories.
type Shape = BTreeMap<String, String>;

/// Cuts registers and memories out of the only module of `design`.json. `None` if it contains other cells with a state, or an unknown value.
fn cut(folder: &Path, design: &str) -> Result<Option<Shape>> {
    let path = folder.join(format!("{design}.json"));
    let text = std::fs::read_to_string(&path).context("cannot read a temporary file")?;
    let mut netlist: Value = serde_json::from_str(&text).context("Yosys' JSON")?;
    let module = netlist["modules"][design]
        .as_object_mut()
        .ok_or_else(|| anyhow!("Yosys' JSON has no module {design}"))?;
    let by_bits = public_names(module);
    let mut shape = Shape::new();
    let mut ports: Map<String, Value> = Map::new();
    let mut kept: Map<String, Value> = Map::new();
    let cells = module.remove("cells").unwrap_or_default();
    for (name, cell) in cells.as_object().into_iter().flatten() {
        let kind = cell["type"].as_str().unwrap_or_default();
        let connections = cell["connections"].as_object().cloned().unwrap_or_default();
        if (connections.values()).any(|bits| bits.to_string().contains("\"x\"")) {
            return Ok(None);
        }
        let pairing = match kind {
            "$dff" => match by_bits.get(&connections["Q"].to_string()) {
                Some(name) => name.clone(),
                None => return Ok(None),
            },
            "$mem_v2" => name.clone(),
            _ if stateless(kind) => {
                kept.insert(name.clone(), cell.clone());
                continue;
            }
            _ => return Ok(None),
        };
        shape.insert(format!("{pairing}/{kind}"), cell["parameters"].to_string());
        for (port, bits) in connections {
            let direction = match cell["port_directions"][&port].as_str() {
                Some("output") => "input",
                _ => "output",
            };
            let width = bits.as_array().map_or(0, Vec::len);
            if width == 0 {
                continue;
            }
            let port = format!("{pairing}/{port}");
            shape.insert(port.clone(), format!("{direction} {width}"));
            // Two registers with the same name would become one port.
            if ports
                .insert(port, json!({"direction": direction, "bits": bits}))
                .is_some()
            {
                return Ok(None);
            }
        }
    }
    for (name, port) in module["ports"].as_object().into_iter().flatten() {
        shape.insert(name.clone(), port["direction"].to_string());
        ports.insert(name.clone(), port.clone());
    }
    module.insert("cells".into(), kept.into());
    module.insert("ports".into(), ports.into());
    module.insert("netnames".into(), json!({}));
    std::fs::write(&path, netlist.to_string()).context("cannot write a temporary file")?;
    Ok(Some(shape))
}

/// Prefixes of Yosys' internal cells that have a state, or may have one.
fn stateless(kind: &str) -> bool {
    let stateful = [
        "$mem", "$dff", "$adff", "$sdff", "$aldff", "$sr", "$dlatch", "$ff", "$_", "$any", "$all",
    ];
    kind.starts_with('$') && !stateful.iter().any(|start| kind.starts_with(start))
}

/// The first name of each signal, by its bits.
fn public_names(module: &Map<String, Value>) -> BTreeMap<String, String> {
    let mut names = BTreeMap::new();
    for (name, net) in module["netnames"].as_object().into_iter().flatten() {
        if net["hide_name"] == json!(0) {
            let first = names
                .entry(net["bits"].to_string())
                .or_insert_with(|| name.clone());
            if name < first {
                first.clone_from(name);
            }
        }
    }
    names
}
