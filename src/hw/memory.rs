//! The memory system between the read and write ports of the units and an AXI4 master, as `docs/chip.md` defines it. Its modules know
//! records, lines and bursts, but nothing of rays or trees.

pub mod arbiter;
pub mod axi;
pub mod cache;
pub mod combiner;
pub mod reader;

use crate::bundle;
use crate::hdl::bundle::Like;
use crate::hdl::{Bundle, Signal, Spec};

/// Width of a byte address.
pub const ADDRESS_BITS: u32 = 32;

/// Width of the number of beats in a burst, minus one, as on an AXI4 bus.
pub const BEATS_BITS: u32 = 8;

bundle! {
    /// A burst to read: full-width beats from an address that is a multiple of the burst's size.
    pub struct Burst(id_bits: u32) {
        /// The byte address of the first beat.
        address: ADDRESS_BITS,
        /// The number of beats, minus one.
        beats: BEATS_BITS,
        /// The requester's identifier. Beats of bursts with one identifier arrive in the order of the bursts; all others in any order.
        id: id_bits,
    }
}

bundle! {
    /// A beat of read data. It is always accepted.
    pub struct Beat(id_bits: u32, data_bits: u32) {
        /// The identifier of its burst.
        id: id_bits,
        /// The data.
        data: data_bits,
        /// Whether it is the last beat of its burst.
        last: 1,
        /// Whether the bus reported an error (SLVERR or DECERR).
        error: 1,
    }
}

bundle! {
    /// A burst to write: full-width beats from an address that is a multiple of the width. It does not cross a multiple of 4 KiB.
    pub struct WriteBurst() {
        /// The byte address of the first beat.
        address: ADDRESS_BITS,
        /// The number of beats, minus one.
        beats: BEATS_BITS,
    }
}

bundle! {
    /// A beat of a write burst.
    pub struct WriteBeat(data_bits: u32) {
        /// The data.
        data: data_bits,
        /// One bit for each byte that is to be written.
        strobes: data_bits / 8,
    }
}

/// Registers for the fields of a bundle that take new values while `load` is 1. They are called `prefix`, `_` and the field's name.
#[track_caller]
fn kept<'b, B: Bundle<Leaf = Spec>>(
    prefix: &str,
    of: &B,
    load: Signal<'b>,
    values: Like<B, Signal<'b>>,
) -> Like<B, Signal<'b>> {
    let mut registers = vec![];
    of.with(values, |spec: Spec, value: Signal<'b>| {
        let register = (load.module()).reg(format!("{prefix}_{}", spec.name), spec.width);
        register.next_when(load, value);
        registers.push(register.q);
    });
    let mut registers = registers.into_iter();
    of.map(|_, _| registers.next().expect("a register for each field"))
}
