//! The machine, one file or folder a unit, named as in `golden`. It follows `docs/arithmetic.md` and knows nothing of how
//! its Verilog is simulated.
//!
//! [`core`] places all units. [`raycast`] is the largest: ray setup, traversal processing unit, geometry unit, and the packets' bookkeeping.

mod banks;
pub mod core;
mod counters;
mod distance;
pub mod fp;
pub mod geometry;
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
