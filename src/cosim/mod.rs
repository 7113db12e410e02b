//! Co-simulation: runs the emitted Verilog with Verilator and compares it with the golden model.
//!
//! [`model`] builds a module into a library and drives it clock by clock; [`memory`] stands in for what a
//! unit's ports lead to. Both are generic: they know nothing of ray tracing. [`raycast`] drives the whole ray
//! casting unit, [`unit_tpu`], [`unit_geometry`], [`unit_skinning`], [`unit_update`] and [`unit_cache`] drive one unit each, on a [`workload`] or a random one, under a [`scoreboard`];
//! [`unit_cast`], [`unit_commands`] and [`unit_registers`] drive the units of the chip;
//! [`unit_axi`] drives the AXI4 master and [`unit_bus`] a memory system, in front of the slave of [`axi`];
//! [`mismatch`] says where RTL and golden model differ.

pub mod animate;
pub mod axi;
pub mod chip;
pub mod dram;
pub mod lists;
pub mod mismatch;
mod processor;
pub mod raycast;
pub mod scoreboard;
pub mod unit_arithmetic;
pub mod unit_axi;
pub mod unit_bus;
pub mod unit_cache;
pub mod unit_cast;
pub mod unit_commands;
pub mod unit_geometry;
pub mod unit_motion;
pub mod unit_registers;
pub mod unit_skinning;
pub mod unit_tpu;
pub mod unit_update;
pub mod workload;

pub(crate) use dynrt_verilated::build;
pub use dynrt_verilated::{memory, model};

use crate::config::Config;

/// Message if a machine for comparison lacks trace ports.
const TRACED: &str = "a machine that is compared has trace ports";

/// The timing of the memories that a configuration defines.
pub fn timing(config: &Config, seed: u64) -> memory::Timing {
    memory::Timing {
        latency: config.memory_latency,
        jitter: config.memory_jitter,
        // Without jitter, responses cannot overtake each other.
        out_of_order: !config.memory_in_order && config.memory_jitter > 0,
        backpressure: 1.0 - f64::from(config.memory_ready_percent) / 100.0,
        seed,
        ..memory::Timing::default()
    }
}
