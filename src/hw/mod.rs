//! The machine: one file or folder per unit, named as in `golden`. It follows `docs/arithmetic.md` and is independent of the
//! simulation of its Verilog.
//!
//! [`core`] instantiates all units. [`raycast`] is the largest unit: ray setup, traversal unit, geometry unit, and the assignment of packet numbers.

mod banks;
pub mod chip;
pub mod core;
mod counters;
mod distance;
pub mod fp;
pub mod geometry;
pub mod memory;
mod plan;
pub mod ray;
pub mod raycast;
pub mod setup;
mod share;
pub mod skinning;
pub mod timing;
pub mod tpu;
mod triangle;
pub mod update;

pub use plan::Plan;
pub use raycast::{Machine, emit};
