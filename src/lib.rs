//! DynRT: a hardware ray tracer for dynamic scenes.
//!
//! Data flows one way: [`scene`] → [`bkd`] tree and memory image → machine ([`golden`] or the Verilog
//! that [`hw`] describes with [`hdl`]) → results → [`report`]. [`film`] does so for animated scenes, frame by frame. [`cosim`] joins golden model and RTL.

pub use dynrt_hdl::{self as hdl, bundle, interface, named};
pub use dynrt_verilated::{cache, child, interrupt, seed, temporary, text, tools};

pub mod baseline;
pub mod bkd;
pub mod chip;
pub mod compare;
pub mod config;
pub mod cosim;
pub mod emit;
pub mod film;
pub mod float;
pub mod fuzz;
pub mod golden;
pub mod hw;
pub mod mutate;
pub mod port;
pub mod program;
pub mod prove;
pub mod report;
pub mod scene;
pub mod synth;
pub mod vectors;
