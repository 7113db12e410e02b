//! The burst reader: reads a sequence of 16-byte words by bursts of up to 128 bytes, and hands them on in order.
//!
//! ```text
//! start ─► next block, words left ─► burst ─► bus
//! beats ─► row ─► buffer ─► words
//! ```
//!
//! A row of the buffer is a word, or a beat if that is wider; narrower beats are assembled. A burst is requested if the rows of a whole
//! block are free: one bit of the count of free rows tells, and few of the bits of an address and of a number of words have to be known
//! together.

mod properties;

use super::combiner::{WORD_BITS, WORD_BYTES};
use super::{ADDRESS_BITS, BEATS_BITS, Burst, kept};
use crate::hdl::fifo::{self, Placed};
use crate::hdl::{Builder, Flow, HdlError, Module, Reg, Signal, Specs, bits_for};
use crate::{bundle, interface};
use std::sync::Arc;

/// Bytes and words of a block: a burst does not cross the multiples of it.
pub const BLOCK_BYTES: u32 = 128;
pub const BLOCK_WORDS: u32 = BLOCK_BYTES / WORD_BYTES;

/// Bits of an offset in a word, and of a word's number in its block.
const WORD_OFFSET: u32 = WORD_BYTES.ilog2();
const PLACE_BITS: u32 = BLOCK_WORDS.ilog2();

/// Bits of a word's number in memory.
pub const WORD_ADDRESS_BITS: u32 = ADDRESS_BITS - WORD_OFFSET;

/// The parameters of a reader.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Bits of data on the bus: 32, 64, 128 or 256.
    pub data_bits: u32,
    /// Bits of the identifier of its bursts, which is 0.
    pub id_bits: u32,
    /// Words of the buffer, a multiple of 2 and at least 8.
    pub words: u32,
    /// Whether the front of the buffer is a register, as that of every queue of a design.
    pub registers_front: bool,
}

impl Sizes {
    /// Words of a row, and beats of a row: one of them is 1.
    fn row_words(&self) -> u32 {
        (self.data_bits / WORD_BITS).max(1)
    }

    fn row_beats(&self) -> u32 {
        (WORD_BITS / self.data_bits).max(1)
    }

    fn row_bits(&self) -> u32 {
        self.data_bits.max(WORD_BITS)
    }

    fn rows(&self) -> u32 {
        self.words / self.row_words()
    }

    fn free_bits(&self) -> u32 {
        bits_for(u64::from(self.rows()) + 1)
    }

    /// Bits of a row's number in its block.
    fn block_row_bits(&self) -> u32 {
        PLACE_BITS - self.row_words().ilog2()
    }
}

bundle! {
    /// A sequence of words.
    pub struct Sequence() {
        /// The byte address of the first word, a multiple of 16.
        address: ADDRESS_BITS,
        /// The number of words.
        words: WORD_ADDRESS_BITS,
    }
}

bundle! {
    /// A word.
    pub struct Word() { data: WORD_BITS }
}

bundle! {
    /// Data of a beat.
    pub struct Datum(data_bits: u32) { data: data_bits }
}

interface! {
    pub (sizes: &Sizes) {
        in "A sequence of words to read" { start: Flow<Sequence>() }
        out "A sequence of words to read" { start_ready: 1 }
        out "Bursts" { read: Flow<Burst>(sizes.id_bits) }
        in "Bursts" { read_ready: 1 }
        in "Beats, always taken" { beat: Flow<Datum>(sizes.data_bits) }
        out "The words, in order" { word: Flow<Word>() }
        in "The words, in order" { word_ready: 1 }
    }
}

/// Describes a reader.
///
/// # Errors
/// None for a buffer of at least one block.
pub fn module(sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        format!("burst_reader_{}", sizes.words),
        format!(
            "the burst reader: reads a sequence of words by bursts, with a buffer of {} words.",
            sizes.words
        ),
    );
    let ports = ports(sizes);
    let inputs = ports.inputs.inputs(&m);
    let start = m.wire("start", 1);
    let pop = m.wire("row_pop", 1);
    let requests = Requests::new(&m, sizes, &inputs, start.get(), pop.get());
    let buffer = Buffer::new(&m, sizes, inputs.beat, pop.get())?;
    let words = Words::new(&m, sizes, &inputs, start.get(), &buffer);
    pop.drive(words.pop);

    m.comment("A sequence starts when all words of the one before are taken.");
    let all_free = requests.free.q.equals(sizes.rows().into());
    let ready = all_free & !(requests.any_left.q | requests.offered.q);
    let ready = ready.named("idle");
    start.drive(inputs.start.valid & ready);
    let outputs = Outputs {
        start_ready: ready,
        read: requests.read,
        word: words.word,
    };
    ports.outputs.outputs(&m, outputs);
    properties::reads(&properties::Unit {
        m: &m,
        sizes,
        inputs,
        outputs,
        requests: &requests,
        buffer: &buffer,
    });
    m.finish()
}

/// What is left to be requested.
struct Requests<'b> {
    read: Flow<Burst<Signal<'b>>, Signal<'b>>,
    offered: Reg<'b>,
    any_left: Reg<'b>,
    left: Reg<'b>,
    /// Rows that are neither requested nor in the buffer.
    free: Reg<'b>,
    /// A burst is requested; it is the last one; its rows, minus one.
    load: Signal<'b>,
    is_last: Signal<'b>,
    rows_less_one: Signal<'b>,
}

impl<'b> Requests<'b> {
    fn new(
        m: &'b Builder,
        sizes: &Sizes,
        inputs: &Inputs<Signal<'b>>,
        start: Signal<'b>,
        pop: Signal<'b>,
    ) -> Requests<'b> {
        m.comment("The next burst: up to the end of the block, or to the last word.");
        let next = m.reg("next_word", WORD_ADDRESS_BITS);
        let left = m.reg("words_left", WORD_ADDRESS_BITS);
        let any_left = m.reg_reset("any_left", 1, 0);
        let free = m.reg_reset("rows_free", sizes.free_bits(), sizes.rows().into());
        let offered = m.reg_reset("burst_offered", 1, 0);
        let place = next.q.part("place", 0, PLACE_BITS);
        let bits = PLACE_BITS + 1;
        let in_block = m.lit(BLOCK_WORDS, bits) - place.extend(bits);
        let in_block = in_block.named("words_in_block");
        let few = (!left.q.high(WORD_ADDRESS_BITS - bits).any()).named("few_left");
        let whole = (!few | left.q.low(bits).ge(in_block)).named("to_end_of_block");
        let is_last = (few & left.q.low(bits).le(in_block)).named("is_last_burst");
        let one = m.lit(1u8, PLACE_BITS);
        let last_word = place + left.q.low(PLACE_BITS) - one;
        let last_word = whole.mux(m.ones(PLACE_BITS), last_word).named("last_word");
        let row_bits = sizes.block_row_bits();
        let (first_row, last_row) = (place.high(row_bits), last_word.high(row_bits));
        let rows_less_one = (last_row - first_row).named("rows_after_first");

        m.comment("It is requested if all rows of a block are free.");
        let room = free.q.high(sizes.free_bits() - row_bits).any();
        let load = (any_left.q & room & !offered.q).named("load");
        let count = whole
            .mux(in_block, left.q.low(bits))
            .named("words_of_burst");
        let moves = (start | load).hinted("moves");
        let block = next.q.high(WORD_ADDRESS_BITS - PLACE_BITS);
        let following = block + m.lit(1u8, WORD_ADDRESS_BITS - PLACE_BITS);
        let following = following.concat(m.zero(PLACE_BITS)).hinted("next_block");
        let first = inputs.start.payload.address.high(WORD_ADDRESS_BITS);
        next.next_when(moves, start.mux(first, following));
        let words = inputs.start.payload.words;
        let fewer = left.q - count.extend(WORD_ADDRESS_BITS);
        left.next_when(moves, start.mux(words, fewer.hinted("words_left_then")));
        any_left.next_when(moves, start.mux(words.any(), !is_last));

        let free_bits = sizes.free_bits();
        let rows = rows_less_one.extend(free_bits) + m.lit(1u8, free_bits);
        let taken = load.repeat(free_bits) & rows;
        let change = (pop.extend(free_bits) - taken).hinted("rows_change");
        free.next_when(load | pop, free.q + change);

        let beats = match sizes.row_beats().ilog2() {
            0 => rows_less_one,
            bits => rows_less_one.concat(m.ones(bits)),
        };
        let row = next.q.high(WORD_ADDRESS_BITS - sizes.row_words().ilog2());
        let burst = Burst {
            address: row.concat(m.zero(ADDRESS_BITS - row.width())),
            beats: beats.extend(BEATS_BITS),
            id: m.zero(sizes.id_bits),
        };
        let Burst { address, beats, .. } = kept("burst", &Burst::of(sizes.id_bits), load, burst);
        offered.next(load | (offered.q & !inputs.read_ready));
        let burst = Burst {
            address,
            beats,
            id: m.zero(sizes.id_bits),
        };
        Requests {
            read: Flow::new(offered.q, burst),
            offered,
            any_left,
            left,
            free,
            load,
            is_last,
            rows_less_one,
        }
    }
}

/// The rows that have arrived.
struct Buffer<'b> {
    rows: Placed<'b>,
    /// The number of the next beat in its row, if a row has several.
    part: Option<Reg<'b>>,
}

impl<'b> Buffer<'b> {
    fn new(
        m: &'b Builder,
        sizes: &Sizes,
        beat: Flow<Datum<Signal<'b>>, Signal<'b>>,
        pop: Signal<'b>,
    ) -> Result<Buffer<'b>, HdlError> {
        m.comment("The rows that have arrived.");
        let data = beat.payload.data;
        let (push, row, part) = match sizes.row_beats() {
            1 => (beat.valid, data, None),
            beats => {
                let part = m.reg_reset("part", beats.ilog2(), 0);
                part.next_when(beat.valid, part.q + m.lit(1u8, beats.ilog2()));
                let before = m.reg("parts_before", sizes.row_bits() - sizes.data_bits);
                let row = data.concat(before.q).hinted("row");
                before.next_when(beat.valid, row.high(before.q.width()));
                (beat.valid & part.q.all(), row, Some(part))
            }
        };
        let push = push.hinted("row_complete");
        let rows = fifo::place(sizes.registers_front, "rows", sizes.rows(), push, row, pop)?;
        Ok(Buffer { rows, part })
    }
}

/// The words that are handed on.
struct Words<'b> {
    word: Flow<Word<Signal<'b>>, Signal<'b>>,
    /// Removes the front row.
    pop: Signal<'b>,
}

impl<'b> Words<'b> {
    fn new(
        m: &'b Builder,
        sizes: &Sizes,
        inputs: &Inputs<Signal<'b>>,
        start: Signal<'b>,
        buffer: &Buffer<'b>,
    ) -> Words<'b> {
        let (valid, row) = (buffer.rows.valid, buffer.rows.front);
        let taken = (valid & inputs.word_ready).named("word_taken");
        if sizes.row_words() == 1 {
            return Words {
                word: Flow::new(valid, Word { data: row }),
                pop: taken,
            };
        }
        m.comment("A row has two words. The first row may begin with the upper one, and the last row may end with the lower one.");
        let upper = m.reg("upper", 1);
        let left = m.reg("words_to_take", WORD_ADDRESS_BITS);
        let Sequence { address, words } = inputs.start.payload;
        upper.next_when(start | taken, start.mux(address.bit(WORD_OFFSET), !upper.q));
        let one = m.lit(1u8, WORD_ADDRESS_BITS);
        left.next_when(start | taken, start.mux(words, left.q - one));
        let is_last = left.q.equals(1).named("is_last_word");
        let data = upper.q.mux(row.high(WORD_BITS), row.low(WORD_BITS));
        Words {
            word: Flow::new(valid, Word { data }),
            pop: (taken & (upper.q | is_last)).named("row_done"),
        }
    }
}
