//! The machine, described with [`crate::hdl`].

pub mod fp;
