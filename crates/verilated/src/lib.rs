//! Simulates Verilog modules in a Rust process, by means of Verilator.
//!
//! [`model::build()`] translates a module to C++ with Verilator, compiles it to a shared library and keeps that in a
//! cache, so that each version of a module is built once. [`model::Model`] loads the library and runs it cycle by
//! cycle: a test sets inputs, clocks the module, and reads outputs, at the speed of the compiled model.
//!
//! ```
//! use dynrt_hdl::{Builder, Design};
//! use dynrt_verilated::model::{BuildOptions, Model, Sources, build};
//!
//! // A module described with dynrt-hdl; `Sources` can also be filled with any Verilog.
//! let m = Builder::new("counter", "counts the cycles in which step is 1.");
//! let count = m.reg_reset("count", 8, 0);
//! count.next_when(m.input("step", 1), count.q + m.lit(1u8, 8));
//! m.output("value", count.q);
//! let sources = Sources::of(&Design::new(m.finish()?)?);
//!
//! let built = build(&sources, &BuildOptions::default(), &|line| eprintln!("{line}"))?;
//! let mut model = Model::load(&built, &sources.ports)?;
//! let (step, value) = (model.port("step")?, model.port("value")?);
//! model.reset(1);
//! model.set(step, 1);
//! model.run(5);
//! assert_eq!(model.get(value), 5);
//! # Ok::<(), anyhow::Error>(())
//! ```
//!
//! # Tour
//!
//! - [`model`] builds and runs models. Ports are found once by name ([`model::Model::port`]) or as the typed bundles of
//!   [`dynrt_hdl`] ([`model::Model::ports`]). Models can write FST traces.
//! - [`memory`] models the environment of a module: memories behind tagged read ports and write ports, with
//!   configurable latency, bandwidth, order and back-pressure, and ready/valid streams that stall at random.
//! - [`model::lint`] checks Verilog with Verilator, Icarus Verilog and Yosys.
//! - [`seed`] chooses the seed of a test with random data.
//! - [`child`], [`temporary`] and [`interrupt`] are general helpers for programs that run external tools: the tools
//!   end with the process, and temporary files are removed even if it is ended by a signal. [`text`] escapes text from
//!   outside for printing, [`tools`] finds and runs external tools, and [`cache`] stores results that took long to compute.
//!
//! # Requirements
//!
//! Verilator 5.006 or later, g++ and, for traces, the headers of zlib are called from the path. Two environment
//! variables are read: `DYNRT_CACHE`, the directory of the cache (see [`model`]), and `DYNRT_SEED` (see [`seed`]).
//! The crate is developed on Linux.

#![deny(missing_docs)]
#![deny(rustdoc::broken_intra_doc_links)]

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

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
