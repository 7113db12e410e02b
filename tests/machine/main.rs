//! Generated files: machines, golden vectors, machines of other configurations.

mod host;
mod machines;
mod rtl_current;
#[path = "../support/mod.rs"]
mod support;
mod vectors;
