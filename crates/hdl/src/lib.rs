//! A small hardware-construction layer: Rust describes synchronous hardware, Verilog-2001 comes out.
//!
//! A [`Builder`] makes one module. [`Signal`]s are width-checked; their operators are combinational. Registers,
//! memories, instances and forward-declared wires make the rest. One clock `clk`, one synchronous reset
//! `rst`, connected by themselves where they are needed.
//!
//! A [`Pipeline`] gives signals a stage. Operators align staged operands by delay registers, an instance of a
//! pipelined module adds its latency, and a module reports the stages of its outputs: no latency is ever counted
//! by hand.
//!
//! What [`Builder::part`] surrounds is printed as a module of its own; to properties and mutations the module stays one netlist.
//!
//! Signals that go together are fields of Rust structs ([`bundle!`](crate::bundle)), a unit's ports too
//! ([`interface!`](crate::interface)). What holds of a module is part of its description ([`Proof`]); a finished one is data,
//! which can be looked into and changed in one place ([`Mutation`]).
//!
//! Names in the Verilog follow from the description: a field of a word is called after both (`stack_read_near`), a register in a
//! pipeline after its signal and stage (`sum_s3`), a port's value after the port, an instance's output after the port or wire that it
//! drives. A register that a port shows keeps its name. What several places read needs a name of its own:
//! [`Signal::named`] gives one, [`Signal::hinted`] offers one. [`Module::made_up_names`] lists what is left.
//!
//! Mistakes (a width mismatch, a combinational loop, an undriven or doubly driven signal, a name clash, a stage of a signal that
//! has none) are reported by [`Builder::finish`] with the place in the Rust source.
//!
//! ```
//! use dynrt_hdl::{Builder, Design};
//! let m = Builder::new("multiply_add", "a * b + c, two stages.");
//! let p = m.pipeline();
//! let (a, b, c) = (p.input("a", 8), p.input("b", 8), p.input("c", 16));
//! let product = a.mul(b).named("product").register();
//! m.output("y", (product + c).register()); // c is delayed by a stage to meet the product
//! let module = m.finish().unwrap();
//! assert_eq!(module.latency(), Some(2));
//! assert!(Design::new(module).unwrap().files()[0].1.contains("product"));
//! ```

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
/// `named! { let sum = a + b; }` is `let sum = (a + b).named("sum");`.
#[macro_export]
macro_rules! named {
    ($(let $name:ident = $value:expr;)*) => {
        $(let $name = ($value).named(stringify!($name));)*
    };
}

/// Bits that count from 0 to `values` − 1; at least 1.
pub const fn bits_for(values: u64) -> u32 {
    if values <= 2 {
        1
    } else {
        64 - (values - 1).leading_zeros()
    }
}
