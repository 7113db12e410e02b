//! Proves that trace ports have no side effect: without them, all other outputs of a machine are the same.
//!
//! The core without trace ports is compared with the core with trace ports by [`Module::compare_outputs`](crate::hdl::Module::compare_outputs),
//! module by module. Every output is the same expression over registers, memories and instances of the same names, whose next values,
//! writes and inputs are the same expressions. Results of co-simulation, which uses trace ports, therefore hold without them as well.

use super::{Outcome, Seeded};
use crate::config::Config;
use crate::hdl::{Compared, Design, Mutation};
use crate::hw::{self, Plan};
use anyhow::Result;

/// A core without trace ports, and the same core with them.
pub struct Variants {
    pub plain: Design,
    traced: Design,
    pub faults: Vec<Seeded<Mutation>>,
}

/// The description of the proof.
pub const WHAT: &str = "without trace ports, all other outputs are the same in every cycle";

/// The comparison for the core of a machine.
///
/// # Errors
/// If the machine's description has a mistake, or if a signal needed for a fault is missing.
pub fn proofs(unit: &str, config: &Config) -> Result<Vec<Variants>> {
    if unit != "trace" {
        return Ok(vec![]);
    }
    let plan = Plan::new(config)?;
    let plain = hw::core::emit(&plan)?.design;
    let traced = hw::core::emit(&plan.with_trace(true))?.design;
    let signal =
        |module: &str, name: &str| -> Result<_> { Ok(plain.module(module)?.signal(name)?.fault()) };
    let faults = [
        (
            "a packet goes to its farther child first",
            signal("tpu", "left_first")?.inverted(),
        ),
        (
            "a hit is merged a clock late",
            signal("geometry_unit", "merge_writes")?.one_clock_late(),
        ),
        (
            "rays come in although a mesh waits to be skinned",
            signal("raycast_unit", "paused")?.as_value(0),
        ),
    ];
    let faults = faults.map(|(what, change)| Seeded {
        what: what.into(),
        change,
    });
    Ok(vec![Variants {
        faults: faults.into(),
        plain,
        traced,
    }])
}

impl Variants {
    /// Compares all outputs. Also returns the amount of logic compared, for reports.
    ///
    /// # Errors
    /// If a fault cannot be made.
    pub fn prove(&self, fault: Option<usize>) -> Result<(String, (usize, Outcome))> {
        let changed = fault.map(|fault| self.plain.with(&self.faults[fault].change));
        let changed = changed.transpose()?;
        let plain = changed.as_ref().unwrap_or(&self.plain);
        Ok(match plain.top().compare_outputs(self.traced.top()) {
            Ok(compared) => {
                let Compared {
                    outputs,
                    registers,
                    memories,
                    instances,
                } = compared;
                let how = format!(
                    "outputs of {} modules in their places, {registers} registers, {memories} memories",
                    1 + instances
                );
                (how, (outputs, Outcome::Proved))
            }
            Err(what) => ("expressions compared".into(), (0, Outcome::Refuted(what))),
        })
    }
}
