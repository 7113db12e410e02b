//! The chip around the core: registers, command processor, ray reader, hit writer, caches, and the AXI4 master, as `docs/chip.md`
//! defines them.

pub mod answers;
pub mod cast;
pub mod commands;
pub mod counters;
pub mod hits;
mod memory;
pub mod monitored;
pub mod motion;
pub mod number;
pub mod rays;
pub mod registers;
mod top;

pub use top::{Inputs, Outputs, Trace, emit, module, ports};

use super::memory::axi::Bus;
use super::memory::cache::{BLOCK_BITS, Shape};
use super::memory::combiner::{WORD_BITS, WORD_BYTES, Word};
use super::memory::{ADDRESS_BITS, arbiter};
use super::plan::Plan;
use crate::bkd::bytes::{ByteRecord, Meaning};
use crate::config::Config;
use crate::hdl::{Signal, bits_for};

/// The name of the chip's module.
pub const NAME: &str = "chip";

/// Width of the number of rays of a cast.
pub const COUNT_BITS: u32 = 32;

/// A number in another width: extended, or its low bits.
fn fitted(number: Signal<'_>, width: u32) -> Signal<'_> {
    match number.width() < width {
        true => number.extend(width),
        false => number.low(width),
    }
}

/// A 32-bit value as a write to its part of a word: `lane` is the part's number, and `address` is within the word.
fn write_of_32_bits<'b>(
    address: Signal<'b>,
    lane: Signal<'b>,
    value: Signal<'b>,
) -> Word<Signal<'b>> {
    let m = value.module();
    let lanes: Vec<_> = (0..WORD_BYTES / 4)
        .rev()
        .map(|k| lane.equals(k.into()).repeat(4))
        .collect();
    let offset = WORD_BYTES.ilog2();
    Word {
        address: address.high(ADDRESS_BITS - offset).concat(m.zero(offset)),
        data: value.repeat(WORD_BITS / 32),
        strobes: m.concat(&lanes),
    }
}

/// The clients of the read arbiter, in the order of their numbers in AXI identifiers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Client {
    Commands,
    Rays,
    /// Rows of an update program or of influences.
    Rows,
    Nodes,
    Records,
    Vertices,
    /// The vertices that the update processor reads.
    Moved,
}

impl Client {
    pub const ALL: [Client; 7] = [
        Client::Commands,
        Client::Rays,
        Client::Rows,
        Client::Nodes,
        Client::Records,
        Client::Vertices,
        Client::Moved,
    ];

    /// The name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Client::Commands => "commands",
            Client::Rays => "rays",
            Client::Rows => "rows",
            Client::Nodes => "nodes",
            Client::Records => "records",
            Client::Vertices => "vertices",
            Client::Moved => "moved",
        }
    }

    /// The client of an AXI identifier.
    pub fn of_id(config: &Config, id: u32) -> Option<Client> {
        let own = Client::ALL.map(|client| client.id_bits(config));
        let own = own.into_iter().max().unwrap_or(1);
        Client::ALL.get((id >> own) as usize).copied()
    }

    /// Bits of the client's own identifiers.
    pub fn id_bits(self, config: &Config) -> u32 {
        match self {
            Client::Commands | Client::Rays | Client::Rows => 1,
            Client::Nodes | Client::Records | Client::Vertices | Client::Moved => {
                bits_for(u64::from(config.cache_misses))
            }
        }
    }
}

/// The read arbiter of a machine.
fn arbiter_sizes(config: &Config) -> arbiter::Sizes {
    arbiter::Sizes {
        data_bits: config.bus_data_bits,
        clients: Client::ALL.map(|client| client.id_bits(config)).into(),
    }
}

/// The memory bus of a machine.
pub fn bus(config: &Config) -> Bus {
    Bus {
        data_bits: config.bus_data_bits,
        id_bits: arbiter_sizes(config).id_bits(),
        reads: config.bus_reads,
        writes: config.bus_writes,
    }
}

/// A cache of records of `layout`, of `kib` KiB, behind a read port with these widths.
fn cache_shape(
    plan: &Plan,
    layout: &ByteRecord,
    kib: u32,
    index_bits: u32,
    tag_bits: u32,
) -> Shape {
    let config = &plan.config;
    let end = layout
        .parts
        .last()
        .map_or(0, |part| part.offset + part.bytes());
    Shape {
        record_bits: 8 * end,
        record_bytes: layout.bytes,
        line_bytes: config.cache_line_bytes,
        ways: config.cache_ways,
        sets: 1024 * kib / (config.cache_line_bytes * config.cache_ways),
        misses: config.cache_misses,
        tag_bits,
        index_bits,
        bus_bits: config.bus_data_bits,
        address_bits: ADDRESS_BITS,
        block_bits: BLOCK_BITS,
        timing: plan.timing,
    }
}

/// The word of a record from its bytes; −0 becomes +0.
fn record_of<'b>(plan: &Plan, layout: &ByteRecord, bytes: Signal<'b>) -> Signal<'b> {
    let part = |part: &crate::bkd::bytes::Part| {
        let bits = bytes.field(8 * part.offset, part.width);
        match part.meaning {
            Meaning::Number => plan.without_minus_zero(bits),
            Meaning::Bits => bits,
        }
    };
    let mut parts: Vec<_> = layout.parts.iter().map(part).collect();
    parts.reverse();
    bytes.module().concat(&parts)
}
