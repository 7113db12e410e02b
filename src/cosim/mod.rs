//! Co-simulation: the emitted Verilog, run by Verilator under Rust.
//!
//! [`model`] builds a module into a library and drives it clock by clock; [`memory`] stands in for what a
//! unit's ports lead to. Both are generic: they know nothing of ray tracing.

mod build;
pub mod memory;
pub mod model;
