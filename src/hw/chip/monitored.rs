//! The chip beside the protocol monitor of its memory bus: the module of its co-simulation.

use super::top::{Inputs as ChipInputs, Outputs as ChipOutputs};
use super::{bus, top};
use crate::hdl::{Builder, HdlError, Module, Specs};
use crate::hw::memory::axi::monitor::{self, Rules, Sizes};
use crate::hw::plan::Plan;
use crate::interface;
use std::sync::Arc;

/// Cycles within which a valid must be accepted and a burst must progress.
const PATIENCE: u32 = 60_000;

interface! {
    pub (plan: &Plan) {
        in "" { chip: ..{ChipInputs}(plan) }
        out "" { chip: ..{ChipOutputs}(plan) }
        out "The monitor: whether any rule has been violated since reset, and which" {
            error: 1,
            violated: {Rules}(),
        }
    }
}

/// Describes the chip of a machine and the monitor of its memory bus.
///
/// # Errors
/// As [`top::module`].
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "chip_monitored",
        "the chip and the protocol monitor of its memory bus.",
    );
    let ports = ports(plan);
    let Inputs { chip: inputs } = ports.inputs.inputs(&m);
    let chip = top::ports(plan).place("chip", &m, &top::module(plan)?, inputs);
    let sizes = Sizes {
        bus: bus(&plan.config),
        patience: PATIENCE,
    };
    let watched = monitor::Inputs {
        master: chip.m_axi,
        slave: inputs.m_axi,
    };
    let seen = monitor::ports(&sizes.bus).place("monitor", &m, &monitor::module(&sizes)?, watched);
    let outputs = Outputs {
        chip,
        error: seen.error,
        violated: seen.rules,
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}
