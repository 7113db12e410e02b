//! Describes synchronous hardware in Rust and emits Verilog-2001.
//!
//! The crate is a hardware-construction layer: a Rust program calls its functions to build the netlist of a module,
//! which is then checked and printed. It is meant for generators, where widths, depths and structure follow from a
//! configuration, and for designs that are verified from Rust as well.
//!
//! ```
//! use dynrt_hdl::{Builder, Design, HdlError};
//! let m = Builder::new("multiply_add", "a * b + c, two stages.");
//! let p = m.pipeline();
//! let (a, b, c) = (p.input("a", 8), p.input("b", 8), p.input("c", 16));
//! let product = a.mul(b).named("product").register();
//! m.output("y", (product + c).register()); // c is delayed by one register to meet the product
//! let module = m.finish()?;
//! assert_eq!(module.latency(), Some(2));
//! let (name, verilog) = &Design::new(module)?.files()[0];
//! assert_eq!(name, "multiply_add.v");
//! assert!(verilog.contains("wire [15:0] product = a * b;"));
//! # Ok::<(), HdlError>(())
//! ```
//!
//! # Tour
//!
//! - A [`Builder`] describes one module. [`Signal`]s have a width, which every operation checks; their operators are
//!   combinational logic. [`Builder::reg`], [`Builder::memory`], [`Builder::instance`] and [`Builder::wire`] add
//!   registers, memories, instances and wires that are driven later.
//! - There is one clock, `clk`, and one synchronous, active-high reset, `rst`. They are connected automatically and
//!   are ports of a module only where it needs them.
//! - In a [`Pipeline`], signals have a stage. Operators align their operands by pipeline registers, an instance of a
//!   pipelined module adds its latency, and a finished module reports the stages of its outputs
//!   ([`Module::latency`]). Latencies are never counted by hand.
//! - [`bundle!`](macro@crate::bundle) defines Rust structs of signals, for the fields of a word;
//!   [`interface!`] defines the ports of a module: see the module [`bundle`](mod@bundle).
//! - [`Builder::part`] prints a part of a large module as a module of its own.
//! - [`Library`] turns a family of modules of different sizes into one Verilog module with parameters.
//! - [`Builder::finish`] returns a [`Module`], which is immutable data; a [`Design`] is a top module with everything
//!   below it, and returns the Verilog files.
//! - A [`Proof`] states properties of a module in its own signals, for a prover or a simulator.
//! - A [`Mutation`] is a single change of a finished module, for mutation tests. [`Module::compare_outputs`] compares
//!   two modules structurally.
//!
//! # Names
//!
//! Names in the Verilog follow from the description. A field of a word is named after both (`word_field`), a pipeline
//! register after its signal and its stage (`sum_s3`), the value of a port after the port, and the output of an
//! instance after the port or wire that it drives. A signal that several places read needs a name:
//! [`Signal::named`] sets it, [`Signal::hinted`] suggests one, [`named!`] takes that of a Rust variable.
//! [`Module::made_up_names`] lists the signals without one.
//!
//! # Errors
//!
//! A mistake in a description (a width mismatch, a combinational loop, an undriven signal or one that is driven
//! twice, a name clash, a signal without a stage where one is needed) does not panic. [`Builder::finish`] reports
//! the first one as an [`HdlError`] with its place in the Rust source. Structural misuse of the bundle types panics
//! where this is documented.

#![deny(missing_docs)]
#![deny(rustdoc::broken_intra_doc_links)]

mod builder;
pub mod bundle;
mod check;
mod design;
mod equal;
mod error;
pub mod fifo;
mod ir;
mod library;
mod memory;
mod mutation;
mod outline;
mod pipeline;
pub mod prefetch;
mod proof;
pub mod properties;
mod signal;
mod verilog;

pub use builder::{Builder, Outputs, Reg, Wire};
pub use bundle::{
    Bundle, Flow, Ports, ReadInputs, ReadOutputs, ReadPort, Request, Response, Signals, Spec,
    Specs, Stream, Wires, Write,
};
pub use design::{Design, Direction, Module, Port, Prefix};
pub use equal::Compared;
pub use error::HdlError;
pub use library::{Library, Parameter};
pub use memory::{Memory, Style};
pub use mutation::{InstanceRef, Kind, MemoryRef, Mutation, Reads, Select, SignalRef, Site};
pub use pipeline::Pipeline;
pub use proof::{Formal, Proof, ProofFacts};
pub use signal::Signal;
pub use verilog::GENERATED;

/// Names signals after the Rust variables that hold them.
///
/// `named! { let sum = a + b; }` stands for `let sum = (a + b).named("sum");`.
#[macro_export]
macro_rules! named {
    ($(let $name:ident = $value:expr;)*) => {
        $(let $name = ($value).named(stringify!($name));)*
    };
}

/// Returns the number of bits that a counter from 0 to `values` − 1 needs, at least 1: the width of
/// an address of a memory with `values` words.
pub const fn bits_for(values: u64) -> u32 {
    if values <= 2 {
        1
    } else {
        64 - (values - 1).leading_zeros()
    }
}

/// Compiles the examples of the README.
#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;
