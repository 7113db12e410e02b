//! Verilator models under Rust.
//!
//! [`model`] builds a module into a library, which is kept by its content, and drives it cycle by cycle; [`memory`] stands in for what
//! the module's ports lead to. Ports are resolved once, as typed bundles of [`dynrt_hdl`] or by name.
//!
//! External tools are run by [`child`] so that they end with this process; [`temporary`] files vanish with it, and [`interrupt`] sees
//! to both where a signal ends it.

pub mod build;
pub mod cache;
pub mod child;
pub mod interrupt;
pub mod memory;
pub mod model;
pub mod seed;
pub mod temporary;
pub mod text;
pub mod tools;
