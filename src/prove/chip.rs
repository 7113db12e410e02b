//! The modules of the chip that are proved beside those of its memory system.

use super::induction::{Induction, of_module};
use crate::config::Config;
use crate::hw::Plan;
use crate::hw::chip::{commands, counters, registers};
use anyhow::Result;

/// All inductions of a unit of the given name; empty for a unit that is not the chip's.
///
/// # Errors
/// A mistake in a description.
pub fn proofs(unit: &str, config: &Config) -> Result<Vec<Induction>> {
    let plan = || Plan::new(config);
    let modules = match unit {
        "registers" => vec![
            (registers::module(&plan()?)?, "serves"),
            (counters::module()?, "counts"),
        ],
        "commands" => vec![(
            commands::module(&plan()?, config.bus_data_bits)?,
            "executes",
        )],
        _ => vec![],
    };
    let found = modules.into_iter();
    found
        .map(|(module, name)| of_module(unit, module, name))
        .collect()
}
