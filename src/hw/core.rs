//! The whole core: all units of the machine, each with its own memory ports.

use super::plan::Plan;
use super::raycast::{self, Machine};
use super::update;
use crate::hdl::{Builder, Bundle, Design, Direction, HdlError, Module, Prefix, Signal};
use std::sync::Arc;

/// The name of the core's module.
pub const NAME: &str = "core";

/// The default prefix of all module names in the Verilog.
pub const PREFIX: &str = "dynrt_";

/// [`PREFIX`], for a design.
pub fn default_prefix() -> Prefix {
    PREFIX.parse().expect("it is of the pattern")
}

/// Describes the core of a machine. The top module is [`NAME`], which is emitted as `dynrt_core`; [`Design::with_prefix`] sets
/// another prefix.
///
/// # Errors
/// A mistake in the description, with its location in the Rust source.
pub fn emit(plan: &Plan) -> Result<Machine, HdlError> {
    Ok(Machine {
        config: plan.config.clone(),
        trace: plan.trace,
        design: Design::new(module(plan)?)?.with_prefix(default_prefix()),
    })
}

pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        NAME,
        "the whole machine: ray casting, skinning and tree update. The units run independently; the host must prevent conflicting operations.",
    );
    for (name, prefix, unit) in [
        ("casting", "", raycast::module(plan)?),
        ("updating", UPDATE, update::module(plan)?.module),
    ] {
        let of = |direction| {
            let ports = unit.ports().iter();
            ports.filter(move |port| {
                port.direction == direction && !matches!(port.name.as_str(), "clk" | "rst")
            })
        };
        let inputs: Vec<_> = of(Direction::Input)
            .map(|port| {
                m.group(group(prefix, &port.group));
                let outside = format!("{prefix}{}", port.name);
                (port.name.as_str(), m.input(outside, port.width))
            })
            .collect();
        let placed = m.instance(name, &unit, &inputs);
        for port in of(Direction::Output) {
            m.group(group(prefix, &port.group));
            m.output(format!("{prefix}{}", port.name), placed.get(&port.name));
        }
    }
    m.finish()
}

/// The prefix of the ports of the update processor.
const UPDATE: &str = "update_";

/// Instantiates a core: the inputs and outputs of its two units.
pub(super) fn place<'b>(
    plan: &Plan,
    core: &Arc<Module>,
    casting: raycast::Inputs<Signal<'b>>,
    updating: update::Inputs<Signal<'b>>,
) -> (raycast::Outputs<Signal<'b>>, update::Outputs<Signal<'b>>) {
    let m = casting.scene_root.module();
    let updating = updating.fields().into_iter();
    let updating = updating.map(|(name, signal)| (format!("{UPDATE}{name}"), signal));
    let inputs: Vec<_> = casting.fields().into_iter().chain(updating).collect();
    let inputs: Vec<_> = (inputs.iter())
        .map(|(name, signal)| (name.as_str(), *signal))
        .collect();
    let placed = m.instance(NAME, core, &inputs);
    let casting = raycast::ports(plan).outputs;
    let updating = update::ports(plan).outputs;
    (
        casting.map(|_, spec| placed.get(&spec.name)),
        updating.map(|_, spec| placed.get(&format!("{UPDATE}{}", spec.name))),
    )
}

/// The heading of a port group in the core: that of the unit, with the name of the unit.
fn group(prefix: &str, heading: &str) -> String {
    match prefix {
        "" => heading.to_string(),
        _ => format!("Update processor. {heading}"),
    }
}
