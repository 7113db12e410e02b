//! `vectors.vh`: what the Verilog benches in `sim/` must know of a machine and its vectors, as macros.

use super::layout::Layout;
use super::shape::Shape;
use crate::config::{Config, TriangleTest};
use crate::hdl::{Design, Direction, Module};
use serde_json::{Value, json};
use std::fmt::Write as _;

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

/// The pipelined modules of a design: how long each takes, and which inputs are due later than the others.
pub fn pipelines(design: &Design) -> Vec<Value> {
    modules(design)
        .map(|module| {
            let late = inputs(module).filter(|(_, stage)| *stage > 0);
            let late: serde_json::Map<String, Value> = late
                .map(|(name, stage)| (name.to_string(), json!(stage)))
                .collect();
            json!({"module": design.emitted(module.name()), "latency": latency(module), "late_inputs": late})
        })
        .collect()
}

fn modules(design: &Design) -> impl Iterator<Item = &Module> {
    PIPELINES.iter().map(|name| {
        let module = design
            .modules()
            .iter()
            .find(|module| module.name() == *name);
        &**module.unwrap_or_else(|| panic!("a machine has a module {name}"))
    })
}

fn inputs(module: &Module) -> impl Iterator<Item = (&str, u32)> {
    let inputs = module.ports().iter();
    inputs
        .filter(|port| port.direction == Direction::Input)
        .filter_map(|port| Some((port.name.as_str(), port.stage?)))
}

/// The stage of a module's results: that of most of its outputs, the last. (`soon` of ray setup comes before.)
fn latency(module: &Module) -> u32 {
    let outputs = module.ports().iter();
    outputs
        .filter(|port| port.direction == Direction::Output)
        .filter_map(|port| port.stage)
        .max()
        .unwrap_or(0)
}

/// The text of `vectors.vh`.
pub fn text(config: &Config, shape: &Shape, design: &Design, files: &[Entry<'_>]) -> String {
    let mut text = String::from(
        "// What the benches in sim/ must know of the vectors beside this file. Generated with them by `dynrt vectors`.\n",
    );
    let bits_of = |port: &str| design.top().port(port).map_or(1, |port| port.width.into());
    define(
        &mut text,
        "The machine",
        &[
            ("NUMBER_BITS", shape.format.width().into()),
            ("EXPONENT_BITS", config.exponent_bits.into()),
            ("RAYS_PER_PACKET", shape.rays as u64),
            ("RAY_BITS", bits_of("watch_test_ray")),
            ("PACKET_BITS", bits_of("watch_start_packet")),
            ("VERTEX_TAG_BITS", bits_of("vertex_request_tag")),
            ("INFLUENCE_TAG_BITS", bits_of("influence_request_tag")),
            ("INFLUENCE_ROW_BITS", bits_of("influence_response_data")),
            ("JOINT_COUNT_BITS", bits_of("skin_start_joints")),
            (
                "UPDATE_PROGRAM_TAG_BITS",
                bits_of("update_program_request_tag"),
            ),
            (
                "UPDATE_VERTEX_TAG_BITS",
                bits_of("update_vertex_request_tag"),
            ),
            ("NODE_LANES", bits_of("update_node_write_mask")),
            ("TAG_BITS", shape.tag_bits.into()),
            ("ADDRESS_BITS", config.address_bits.into()),
            ("MEMORY_LATENCY", config.memory_latency.into()),
            ("MEMORY_JITTER", config.memory_jitter.into()),
            ("MEMORY_READY_PERCENT", config.memory_ready_percent.into()),
        ],
    );
    if shape.test == TriangleTest::Watertight {
        text.push_str("`define WATERTIGHT\n");
    }
    if files
        .iter()
        .any(|file| file.stem == "ray_transform_stimulus")
    {
        text.push_str("`define TWO_LEVELS\n");
    }
    if config.memory_in_order {
        text.push_str("`define MEMORY_IN_ORDER\n");
    }
    text.push_str("\n// Clocks from operands to results, and by how many an input is due later than the first\n");
    for module in modules(design) {
        let name = module.name().to_uppercase();
        let _ = writeln!(text, "`define {name}_LATENCY {}", latency(module));
        for (port, stage) in inputs(module) {
            let _ = writeln!(text, "`define {name}_{}_STAGE {stage}", port.to_uppercase());
        }
    }
    for Entry {
        stem,
        lines,
        layout,
    } in files
    {
        let prefix = stem.to_uppercase();
        define(
            &mut text,
            &format!("{stem}.hex"),
            &[
                (&format!("{prefix}_LINES"), *lines),
                (&format!("{prefix}_BITS"), layout.width.into()),
            ],
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
    define(
        &mut text,
        "Bits from one ray's fields to the next's",
        &[(
            "PACKET_STEP_STIMULUS_RAY_STRIDE",
            shape.packet_step_ray_bits().into(),
        )],
    );
    text
}

fn define(text: &mut String, title: &str, values: &[(&str, u64)]) {
    let _ = writeln!(text, "\n// {title}");
    for (name, value) in values {
        let _ = writeln!(text, "`define {name} {value}");
    }
}
