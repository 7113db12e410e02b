//! The whole core: every unit of the machine, side by side, each with its own ports to memory.

use super::plan::Plan;
use super::raycast::{self, Machine};
use super::update;
use crate::hdl::{Builder, Design, Direction, HdlError, Module, Prefix};
use std::sync::Arc;

/// The core's module.
pub const NAME: &str = "core";

/// What the names of all modules of a machine begin with in Verilog, unless another prefix is asked for.
pub const PREFIX: &str = "dynrt_";

/// [`PREFIX`], for a design.
pub fn default_prefix() -> Prefix {
    PREFIX.parse().expect("it is of the pattern")
}

/// Describes the core of a machine. The top module is [`NAME`], which is emitted as `dynrt_core`; another prefix is set by
/// [`Design::with_prefix`].
///
/// # Errors
/// A mistake in the description itself, with its place in the Rust source.
pub fn emit(plan: &Plan) -> Result<Machine, HdlError> {
    Ok(Machine {
        config: plan.config.clone(),
        trace: plan.trace,
        design: Design::new(module(plan)?)?.with_prefix(default_prefix()),
    })
}

fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        NAME,
        "the whole machine: ray casting, skinning and tree update. The units run independently; the host must prevent conflicting operations.",
    );
    for (name, prefix, unit) in [
        ("casting", "", raycast::module(plan)?),
        ("updating", "update_", update::module(plan)?.module),
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

/// The heading of a unit's group of ports among all units'.
fn group(prefix: &str, heading: &str) -> String {
    match prefix {
        "" => heading.to_string(),
        _ => format!("Update processor. {heading}"),
    }
}
