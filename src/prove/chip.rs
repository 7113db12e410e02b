//! The modules of the chip that are proved beside those of its memory system.

use super::induction::{Induction, of_module};
use crate::config::Config;
use crate::hw::Plan;
use crate::hw::chip::{commands, counters, motion, registers};
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
        // Rows of a word, of two, and of half a word; records of one word and of two.
        "motion" => {
            let mut modules = vec![(motion::module(&plan()?)?, "moves")];
            for (exponent_bits, fraction_bits) in [(10, 23), (3, 2)] {
                let config = Config {
                    exponent_bits,
                    fraction_bits,
                    ..config.clone()
                };
                modules.push((motion::module(&Plan::new(&config)?)?, "moves"));
            }
            modules
        }
        _ => vec![],
    };
    let found = modules.into_iter();
    found
        .map(|(module, name)| of_module(unit, module, name))
        .collect()
}
