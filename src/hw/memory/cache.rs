//! The read-only cache between a read port of a unit and memory, as the section Cache of `docs/chip.md` defines it.
//!
//! Tags are looked up before data. A line has an entry in the tag memory from the moment in which it is requested; whether it has
//! arrived follows from the miss registers alone: a line is in flight exactly while a miss register has its set and way. So the tag
//! memory is written in one place, when a line is requested, and a lookup needs no second state of a line.
//!
//! ```text
//! request ─► address ─► tags (1 to 3 cycles) ─► decision ──── hit ────► data ─► response
//!               ▲                                │  │                    ▲ ▲
//!               └──── a decision that waits ─────┘  │ miss, in flight    │ │
//!                     holds all stages              ▼                    │ │
//!                                   miss registers, lists ── answers ────┘ │
//!                                        │       ▲                         │
//!                                bursts ◄┘       └── last ── beats ────────┘
//! ```
//!
//! Why a word is never read too early or too late: a hit and an answer read the data memory in the cycle after their decision, and a
//! line's first beat arrives at least two cycles after the line was requested. So a line that is replaced has been read by all earlier
//! hits. An answer reads two cycles or more after the last beat was written.

mod answer;
mod decide;
mod fill;
mod lookup;
mod miss;
mod properties;

use super::{ADDRESS_BITS, Beat, Burst};
use crate::hdl::{
    Builder, Flow, HdlError, Memory, Module, Request, Response, Signal, Specs, Style, bits_for,
};
use crate::hw::timing::Timing;
use crate::{bundle, interface};
use std::panic::Location;
use std::sync::Arc;

/// The parameters of a cache.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Bits that a response carries.
    pub record_bits: u32,
    /// Bytes that a record takes in memory: a power of two.
    pub record_bytes: u32,
    /// Bytes of a line, which is one burst: a power of two, at least a record and at least a beat.
    pub line_bytes: u32,
    /// Lines per set: 1, 2 or 4.
    pub ways: u32,
    /// Sets: a power of two, at least 2.
    pub sets: u32,
    /// Miss registers: lines that can be in flight, 1 to 16.
    pub misses: u32,
    /// Bits of a request's tag.
    pub tag_bits: u32,
    /// Bits of a record's index.
    pub index_bits: u32,
    /// Bits of a beat: a power of two, at least 8.
    pub bus_bits: u32,
    /// Bits of a byte address that can be 1, the lowest ones; at most 32.
    pub address_bits: u32,
    /// Bits from which a memory of tags or of records is in block RAM: [`BLOCK_BITS`] but for proofs.
    pub block_bits: u32,
    /// The registers that the target clock requires.
    pub timing: Timing,
}

/// A cache of few states, for proofs, with its memories in block RAM or in distributed RAM.
pub fn small(in_block_ram: bool) -> Shape {
    Shape {
        record_bits: 3,
        record_bytes: 1,
        line_bytes: 2,
        ways: 2,
        sets: 2,
        misses: 2,
        tag_bits: 2,
        index_bits: 5,
        bus_bits: 8,
        address_bits: 5,
        block_bits: if in_block_ram { 0 } else { BLOCK_BITS },
        timing: Timing::at(100),
    }
}

/// The base of an array is a multiple of this many bytes.
pub const BASE_BYTES: u32 = 64;

/// Bits from which a memory is better in block RAM.
pub const BLOCK_BITS: u32 = 512;

impl Shape {
    /// Checks all parameters.
    ///
    /// # Errors
    /// The first that is out of its range, in words.
    pub fn check(&self) -> Result<(), String> {
        let power = |what: &str, value: u32| match value.is_power_of_two() {
            true => Ok(()),
            false => Err(format!("{what}: {value} is not a power of two")),
        };
        power("bytes of a record", self.record_bytes)?;
        power("bytes of a line", self.line_bytes)?;
        power("ways", self.ways)?;
        power("sets", self.sets)?;
        power("bits of a beat", self.bus_bits)?;
        let range =
            |what: &str, value: u32, least: u32, most: u32| match (least..=most).contains(&value) {
                true => Ok(()),
                false => Err(format!("{what}: {value} is not from {least} to {most}")),
            };
        range("bytes of a record", self.record_bytes, 1, BASE_BYTES)?;
        range(
            "bits of a record",
            self.record_bits,
            1,
            8 * self.record_bytes,
        )?;
        range("ways", self.ways, 1, 4)?;
        range("sets", self.sets, 2, 1 << 16)?;
        range("miss registers", self.misses, 1, 16)?;
        range("bits of a tag", self.tag_bits, 1, 12)?;
        range("bits of a beat", self.bus_bits, 8, 1024)?;
        let least = self.record_bytes.max(self.bus_bytes());
        range(
            "bytes of a line",
            self.line_bytes,
            least,
            256 * self.bus_bytes(),
        )?;
        let least = (self.sets * self.line_bytes).ilog2() + 1;
        range("bits of an address", self.address_bits, least, ADDRESS_BITS)?;
        let most = self.address_bits - self.record_bytes.ilog2();
        range("bits of an index", self.index_bits, 1, most)
    }

    /// Bytes of a beat.
    pub fn bus_bytes(&self) -> u32 {
        self.bus_bits / 8
    }

    /// Bytes of a word of the data memory: a record or a beat, whichever is longer.
    pub fn word_bytes(&self) -> u32 {
        self.record_bytes.max(self.bus_bytes())
    }

    /// Beats of a line.
    pub fn beats(&self) -> u32 {
        self.line_bytes / self.bus_bytes()
    }

    /// Bytes of all lines.
    pub fn bytes(&self) -> u32 {
        self.line_bytes * self.ways * self.sets
    }

    /// Bits of a miss register's number.
    pub fn id_bits(&self) -> u32 {
        bits_for(u64::from(self.misses))
    }

    /// Bits of a record's place in its line; may be 0.
    fn offset_bits(&self) -> u32 {
        (self.line_bytes / self.record_bytes).ilog2()
    }

    /// Bits of a word's place in its line; may be 0.
    fn word_bits(&self) -> u32 {
        (self.line_bytes / self.word_bytes()).ilog2()
    }

    /// Bits of a beat's place in its line; may be 0.
    fn beat_bits(&self) -> u32 {
        self.beats().ilog2()
    }

    /// Bits of a way's number; may be 0.
    fn way_bits(&self) -> u32 {
        self.ways.ilog2()
    }

    fn set_bits(&self) -> u32 {
        self.sets.ilog2()
    }

    /// Bits of a line's number: its byte address without those within the line.
    fn line_bits(&self) -> u32 {
        self.address_bits - self.line_bytes.ilog2()
    }

    /// Bits of a line's number above those of its set: what the tag memory stores.
    fn key_bits(&self) -> u32 {
        self.line_bits() - self.set_bits()
    }

    /// Bits of the address of the data memory: way, set, word.
    fn place_bits(&self) -> u32 {
        self.way_bits() + self.set_bits() + self.word_bits()
    }

    fn style(&self, bits: u32) -> Style {
        match bits < self.block_bits {
            true => Style::Distributed,
            false => Style::Block,
        }
    }

    fn tag_style(&self) -> Style {
        self.style(self.sets * (1 + self.key_bits()))
    }

    fn data_style(&self) -> Style {
        self.style(8 * self.bytes())
    }

    fn latency_of(&self, style: Style) -> u32 {
        match style {
            Style::Distributed => 1,
            Style::Block => self.timing.read_latency(),
        }
    }

    /// Cycles from the address of the tag memory to the comparison.
    fn tag_latency(&self) -> u32 {
        self.latency_of(self.tag_style())
    }

    /// Cycles from a decision to its response: the register of the address, the data memory, and the register of a selected record.
    pub fn answer_latency(&self) -> u32 {
        1 + self.latency_of(self.data_style()) + u32::from(self.records_per_word() > 1)
    }

    /// Cycles from the acceptance of a request to its decision, at least.
    pub fn decision_latency(&self) -> u32 {
        2 + self.tag_latency()
    }

    fn records_per_word(&self) -> u32 {
        self.word_bytes() / self.record_bytes
    }

    fn beats_per_word(&self) -> u32 {
        self.word_bytes() / self.bus_bytes()
    }
}

bundle! {
    /// An event for the counters: each is high for one cycle.
    pub struct Events() {
        /// A request has been decided.
        requests: 1,
        /// Its line was there.
        hits: 1,
        /// Its line was requested.
        misses: 1,
        /// A request waited for its decision in this cycle.
        stalls: 1,
    }
}

bundle! {
    /// A byte address.
    pub struct Address() {
        /// The address.
        address: ADDRESS_BITS,
    }
}

interface! {
    pub (shape: &Shape) {
        in "Records to read: requests. A tag is never in use twice" {
            /// A record's index, and the tag of its response.
            request: Flow<Request>(shape.index_bits, shape.tag_bits),
        }
        out "Records to read: requests. A tag is never in use twice" {
            /// Whether the request is accepted in this cycle.
            request_ready: 1,
        }
        out "Records to read: responses, in any order, always accepted" {
            /// The record, with the tag of its request.
            response: Flow<Response>(shape.tag_bits, shape.record_bits),
        }
        in "Byte address of the array, a multiple of 64, constant while a request is outstanding" {
            /// The byte address of record 0.
            base: ADDRESS_BITS,
        }
        in "Discards all lines; only while no request is outstanding" {
            /// Starts it.
            invalidate: 1,
        }
        out "Discards all lines; only while no request is outstanding" {
            /// High while it goes on; no request is accepted.
            invalidating: 1,
            /// Whether no request is outstanding.
            idle: 1,
        }
        out "Memory: bursts of a line; the identifier is the number of the miss register" {
            /// The line to read, held until it is accepted.
            burst: Flow<Burst>(shape.id_bits()),
        }
        in "Memory: bursts of a line; the identifier is the number of the miss register" {
            /// Whether the burst is accepted in this cycle.
            burst_ready: 1,
        }
        in "Memory: beats, those of a line in order, always accepted" {
            /// A beat of a line.
            beat: Flow<Beat>(shape.id_bits(), shape.bus_bits),
        }
        out "A beat had an error: the byte address of its line" {
            /// The address of the line.
            error: Flow<Address>(),
        }
        out "Events for the counters" {
            /// Events, a cycle after the decision.
            event: {Events}(),
        }
    }
}

/// What each part of the cache is described with.
#[derive(Clone, Copy)]
struct Around<'a, 'b> {
    m: &'b Builder,
    shape: &'a Shape,
    inputs: &'a Inputs<Signal<'b>>,
}

/// Describes a cache called `name`.
///
/// # Errors
/// A parameter out of its range.
pub fn module(name: &str, shape: &Shape) -> Result<Arc<Module>, HdlError> {
    shape.check().map_err(|message| HdlError {
        module: name.to_string(),
        message,
        place: Location::caller(),
    })?;
    let builder = Builder::new(
        name,
        format!(
            "a read-only cache of {} bytes: {} sets of {} lines of {} bytes; {} lines can be in flight.",
            shape.bytes(),
            shape.sets,
            shape.ways,
            shape.line_bytes,
            shape.misses
        ),
    );
    let m = &builder;
    let ports = ports(shape);
    let inputs = ports.inputs.inputs(m);
    let around = Around {
        m,
        shape,
        inputs: &inputs,
    };
    let told = decide::Told::new(m, shape);
    let draining = m.wire("draining", 1);
    let freed = m.wire("freed", shape.misses);
    let sweep = m.part("sweep", "discards all lines, a set per cycle.", || {
        lookup::Sweep::new(&around)
    });
    let lookup = m.part(
        "lookup",
        "looks up the line of a request: its address, the tags of its set, and the ways whose tag is the line's.",
        || lookup::Lookup::new(&around, &sweep, &told),
    );
    let decide = m.part(
        "decision",
        "decides whether a request is a hit, waits for a line in flight, or requests its line.",
        || decide::Decide::new(&around, &sweep, &lookup, &told, draining.get(), freed.get()),
    );
    let fill = m.part(
        "fill",
        "takes beats: the place of each in the data memory.",
        || fill::Fill::new(&around, &decide),
    );
    let bursts = m.part("bursts", "requests lines from memory.", || {
        miss::Bursts::new(&around, &decide)
    })?;
    let lists = m.part(
        "lists",
        "the requests that wait for a line, and their answers when it has arrived.",
        || miss::Lists::new(&around, &decide, &fill),
    );
    draining.drive(lists.draining);
    freed.drive(lists.freed);
    let answer = m.part(
        "data",
        "the data memory, and the record of a response.",
        || answer::Answer::new(&around, &decide, &fill, &lists),
    );
    let outstanding = m.or_all(&[
        lookup.any,
        decide.any_busy,
        m.or_all(&answer.on_the_way).named("responds"),
    ]);
    let outputs = Outputs {
        request_ready: lookup.ready,
        response: answer.response,
        invalidating: sweep.sweeping.q,
        idle: !outstanding.named("outstanding"),
        burst: bursts.burst,
        error: fill.error,
        event: decide.events,
    };
    ports.outputs.outputs(m, outputs);
    properties::describe(&properties::Watched {
        around,
        outputs: &outputs,
        sweep: &sweep,
        lookup: &lookup,
        decide: &decide,
        fill: &fill,
        bursts: &bursts,
        lists: &lists,
        answer: &answer,
    });
    builder.finish()
}

/// Concatenates the parts that there are, the first the most significant.
fn join<'b>(parts: &[Option<Signal<'b>>]) -> Option<Signal<'b>> {
    let parts: Vec<_> = parts.iter().copied().flatten().collect();
    let first = parts.first()?;
    Some(first.module().concat(&parts))
}

/// The bits from `lsb` upwards; none if there are 0.
fn bits<'b>(of: Option<Signal<'b>>, lsb: u32, width: u32) -> Option<Signal<'b>> {
    (width > 0).then(|| of.expect("a field with bits").field(lsb, width))
}

/// The number of the bit that is 1, for at most one; none if it takes 0 bits.
fn number<'b>(name: &str, one_hot: &[Signal<'b>]) -> Option<Signal<'b>> {
    let bits = one_hot.len().next_power_of_two().ilog2();
    let bit = |k: u32| {
        let with_it: Vec<_> = (one_hot.iter().enumerate())
            .filter(|(i, _)| i >> k & 1 != 0)
            .map(|(_, bit)| *bit)
            .collect();
        let bit = with_it[0].module().or_all(&with_it);
        bit.hinted(format!("{name}_bit{k}"))
    };
    let bits: Vec<_> = (0..bits).rev().map(|k| Some(bit(k))).collect();
    join(&bits).map(|number| number.hinted(name))
}

/// The lowest bit that is 1. `name` is what it is of miss register number 0, 1, ….
fn lowest<'b>(name: &str, bits: &[Signal<'b>]) -> Vec<Signal<'b>> {
    let before = |i: usize| {
        let lowest = bits[..i].iter().fold(bits[i], |it, before| it & !*before);
        lowest.hinted(format!("miss{i}_{name}"))
    };
    (0..bits.len()).map(before).collect()
}

/// The number of a miss register of which one bit is 1.
fn id<'b>(m: &'b Builder, shape: &Shape, name: &str, one_hot: &[Signal<'b>]) -> Signal<'b> {
    match number(name, one_hot) {
        Some(number) => number,
        None => m.zero(shape.id_bits()),
    }
}

/// Whether a miss register has this number, for each.
fn is_id<'b>(shape: &Shape, id: Signal<'b>) -> Vec<Signal<'b>> {
    let is = |k: u32| {
        let is = id.equals(u128::from(k));
        is.hinted_after(id, format!("is_{k}"))
    };
    match shape.misses {
        1 => vec![id.module().ones(1)],
        all => (0..all).map(is).collect(),
    }
}

/// A word for each miss register: a memory, or of one miss register a register.
#[derive(Clone, Copy)]
enum PerMiss<'b> {
    Memory(Memory<'b>),
    Register(Signal<'b>),
}

impl<'b> PerMiss<'b> {
    /// Declares the words and their write port.
    fn new(
        around: &Around<'_, 'b>,
        name: &str,
        enable: Signal<'b>,
        id: Signal<'b>,
        word: Signal<'b>,
    ) -> PerMiss<'b> {
        let Around { m, shape, .. } = *around;
        if shape.misses == 1 {
            let register = m.reg(name, word.width());
            register.next_when(enable, word);
            return PerMiss::Register(register.q);
        }
        let memory = m.memory(name, shape.misses, word.width(), Style::Distributed);
        memory.write(enable, id, word);
        PerMiss::Memory(memory)
    }

    fn read(&self, id: Signal<'b>) -> Signal<'b> {
        match self {
            PerMiss::Memory(memory) => memory.read_now(id),
            PerMiss::Register(word) => *word,
        }
    }

    /// The word for properties.
    fn peek(&self, id: Signal<'b>) -> Signal<'b> {
        match self {
            PerMiss::Memory(memory) => memory.peek(id),
            PerMiss::Register(word) => *word,
        }
    }
}
