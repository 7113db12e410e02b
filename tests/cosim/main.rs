//! The Verilog in Verilator, compared with the golden model: units, frames, films, a picture.

mod animate;
mod bus;
mod cache;
mod chip;
mod driver;
mod film;
mod fp_units;
mod frames;
mod lending;
mod picture;
mod skinning;
#[path = "../support/mod.rs"]
mod support;
mod units;
mod update;
