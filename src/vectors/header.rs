//! `vectors.vh`: the parameters of a machine and its vectors for the Verilog benches in `sim/`, as macros.

use super::layout::Layout;
use super::shape::Shape;
use crate::config::{Config, TriangleTest};
use crate::emit::parameters;
use crate::hdl::{Design, Direction, Module};
use serde_json::{Map, Value, json};
use std::fmt::Write as _;

/// The prefix of every macro.
pub const PREFIX: &str = "DYNRT_";

/// The modules that the benches drive as pipelines.
const PIPELINES: [&str; 7] = [
    "ray_setup",
    "tpu_slice",
    "triangle_test",
    "fp_add",
    "fp_sub",
    "fp_mul",
    "fp_reciprocal",
];

/// One file's part of the header.
pub struct Entry<'a> {
    pub stem: &'a str,
    pub lines: u64,
    pub layout: &'a Layout,
}

/// The pipelined modules of a design, with the latency of each and the cycle in which each input is due after the first.
pub fn pipelines(design: &Design) -> Vec<Value> {
    modules(design)
        .map(|module| {
            let stages: Map<String, Value> = inputs(module)
                .map(|(name, stage)| (name.to_string(), json!(stage)))
                .collect();
            json!({
                "unit": module.name(),
                "module": design.module_name(module),
                "parameters": parameters(module),
                "macros": format!("{PREFIX}{}", module.name().to_uppercase()),
                "latency": latency(module),
                "stages": stages,
            })
        })
        .collect()
}

/// The module of a design whose description has this name.
///
/// # Panics
/// If there is none.
pub fn module<'d>(design: &'d Design, name: &str) -> &'d Module {
    let mut modules = design.modules().iter();
    let found = modules.find(|module| module.name() == name);
    found.unwrap_or_else(|| panic!("a machine has a module {name}"))
}

fn modules(design: &Design) -> impl Iterator<Item = &Module> {
    PIPELINES.iter().map(|name| module(design, name))
}

fn inputs(module: &Module) -> impl Iterator<Item = (&str, u32)> {
    let inputs = module.ports().iter();
    inputs
        .filter(|port| port.direction == Direction::Input)
        .filter_map(|port| Some((port.name.as_str(), port.stage?)))
}

/// The stage of a module's last output. Most outputs have this stage; `soon` of ray setup is earlier.
fn latency(module: &Module) -> u32 {
    let outputs = module.ports().iter();
    outputs
        .filter(|port| port.direction == Direction::Output)
        .filter_map(|port| port.stage)
        .max()
        .unwrap_or(0)
}

/// Widths of ports and settings of memories. A key is the macro's name in lower case, without the prefix.
pub fn machine(
    config: &Config,
    shape: &Shape,
    design: &Design,
    two_levels: bool,
) -> Map<String, Value> {
    let bits_of = |port: &str| design.top().port(port).map_or(1, |port| port.width);
    let settings = json!({
        "number_bits": shape.format.width(),
        "exponent_bits": config.exponent_bits,
        "rays_per_packet": shape.rays,
        "ray_bits": bits_of("trace_test_ray"),
        "packet_bits": bits_of("trace_start_packet"),
        "vertex_tag_bits": bits_of("vertex_request_tag"),
        "influence_tag_bits": bits_of("influence_request_tag"),
        "influence_row_bits": bits_of("influence_response_data"),
        "joint_count_bits": bits_of("skin_start_joints"),
        "update_program_tag_bits": bits_of("update_program_request_tag"),
        "update_vertex_tag_bits": bits_of("update_vertex_request_tag"),
        "node_lanes": bits_of("update_node_write_mask"),
        "tag_bits": shape.tag_bits,
        "address_bits": config.address_bits,
        "memory_latency": config.memory_latency,
        "memory_jitter": config.memory_jitter,
        "memory_ready_percent": config.memory_ready_percent,
        "packet_step_stimulus_ray_stride": shape.packet_step_ray_bits(),
        "watertight": shape.test == TriangleTest::Watertight,
        "two_levels": two_levels,
        "memory_in_order": config.memory_in_order,
    });
    match settings {
        Value::Object(settings) => settings,
        _ => unreachable!("an object was written"),
    }
}

/// The text of `vectors.vh`.
pub fn text(machine: &Map<String, Value>, design: &Design, files: &[Entry<'_>]) -> String {
    let mut text = String::from(
        "// What the benches in sim/ must know of the vectors beside this file. Generated with them by `dynrt vectors`; all of it is in\n\
         // manifest.json, too.\n",
    );
    text.push_str("\n// The machine\n");
    for (key, value) in machine {
        let name = key.to_uppercase();
        let _ = match value {
            Value::Bool(false) => Ok(()),
            Value::Bool(true) => writeln!(text, "`define {PREFIX}{name}"),
            number => writeln!(text, "`define {PREFIX}{name} {number}"),
        };
    }
    text.push_str("\n// Cycles from operands to results, and by how many an input is due later than the first\n");
    for module in modules(design) {
        let name = module.name().to_uppercase();
        let _ = writeln!(text, "`define {PREFIX}{name}_LATENCY {}", latency(module));
        for (port, stage) in inputs(module) {
            let port = port.to_uppercase();
            let _ = writeln!(text, "`define {PREFIX}{name}_{port}_STAGE {stage}");
        }
    }
    for Entry {
        stem,
        lines,
        layout,
    } in files
    {
        let prefix = format!("{PREFIX}{}", stem.to_uppercase());
        let _ = writeln!(
            text,
            "\n// {stem}.hex\n`define {prefix}_LINES {lines}\n`define {prefix}_BITS {}",
            layout.width
        );
        for field in &layout.fields {
            let name = format!("{prefix}_{}", field.name.to_uppercase());
            let _ = writeln!(
                text,
                "`define {name} {}:{}\n`define {name}_LSB {}",
                field.lsb + field.width - 1,
                field.lsb,
                field.lsb
            );
        }
    }
    text
}
