//! The modules of the chip that are proved beside those of its memory system.

use super::induction::Induction;
use crate::config::Config;
use crate::hw::Plan;
use crate::hw::chip::{commands, counters, registers};
use anyhow::{Context, Result};

/// All inductions of a unit of the given name; none if it is no unit of the chip.
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
    let found = modules.into_iter().map(|(module, name)| {
        let mut proofs = module.proofs().into_iter();
        let proof = proofs.find(|proof| proof.name == name);
        Ok(Induction {
            proof: proof.with_context(|| format!("{unit}: the module has no proof {name}"))?,
            module,
            few: &[],
        })
    });
    found.collect()
}
