//! Trace ports change nothing else: without them, a machine does the same at all its outputs.
//!
//! The core without trace ports is compared with the core with them by [`Module::compare_outputs`](crate::hdl::Module::compare_outputs),
//! module by module: every output is the same expression, over registers, memories and instances of the same names whose next values,
//! writes and inputs are the same expressions. So what co-simulation, which looks at trace ports, says of the one holds of the other.

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

/// What is proved.
pub const WHAT: &str =
    "without trace ports, every other output is what it is with them, at all clocks";

/// The core of a machine.
///
/// # Errors
/// A mistake in the machine's description; a signal to change that is gone.
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
    /// Compares all outputs. Returns how much was compared, too, as the report says it.
    ///
    /// # Errors
    /// A fault that cannot be made.
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
