//! The burst reader: reads a sequence of 16-byte words ahead of its use.

use super::{ADDRESS_BITS, BEATS_BITS, Beat, Burst};
use crate::hdl::{Builder, Flow, HdlError, Module, Specs, bits_for, fifo};
use crate::{bundle, interface};
use std::sync::Arc;

/// Bytes and bits of a word.
const WORD_BYTES: u32 = 16;
const WORD_BITS: u32 = 128;

/// Words of the longest burst.
const BURST_WORDS: u32 = 8;

/// Width of a number of words.
pub const COUNT_BITS: u32 = 28;

bundle! {
    /// A sequence of words.
    pub struct Sequence() {
        address: ADDRESS_BITS,
        words: COUNT_BITS,
    }
}

interface! {
    pub (data_bits: u32) {
        in "Sequence to read, accepted while none is read" { start: Flow<Sequence>() }
        in "Memory: bursts" { read_ready: 1 }
        in "Memory: beats, in order, always accepted" { beat: Flow<Beat>(1, data_bits) }
        in "Words, in order" { word_ready: 1 }
        out "Memory: bursts" { read: Flow<Burst>(1) }
        out "Words, in order" { word_valid: 1, word: WORD_BITS }
    }
}

pub fn module(data_bits: u32, buffer: u32) -> Result<Arc<Module>, HdlError> {
    assert!(data_bits <= WORD_BITS);
    let m = Builder::new(
        "burst_reader",
        "reads a sequence of 16-byte words ahead of its use.",
    );
    let ports = ports(data_bits);
    let inputs = ports.inputs.inputs(&m);
    let start = inputs.start.valid;
    let address = m.reg("next_address", ADDRESS_BITS);
    let left = m.reg_reset("words_left", COUNT_BITS, 0);
    let used_bits = bits_for(u64::from(buffer) + 1);
    let used = m.reg_reset("words_ahead", used_bits, 0);
    let to_boundary = m.lit(BURST_WORDS, 4) - m.zero(1).concat(address.q.field(4, 3));
    let few = left.q.lt(to_boundary.extend(COUNT_BITS));
    let words = few.mux(left.q.low(4), to_boundary).named("burst_words");
    let room = m.lit(buffer, used_bits) - used.q;
    let fits = room.ge(words.extend(used_bits)).named("burst_fits");
    let valid = (left.q.any() & fits).named("offers");
    let taken = (valid & inputs.read_ready).named("taken");
    let step = words.extend(ADDRESS_BITS - 4).concat(m.zero(4));
    address.next_when(
        start | taken,
        start.mux(inputs.start.payload.address, address.q + step),
    );
    left.next_when(
        start | taken,
        start.mux(
            inputs.start.payload.words,
            left.q - words.extend(COUNT_BITS),
        ),
    );
    let pop = m.wire("pops", 1);
    let per_word = WORD_BITS / data_bits;
    let (push, word) = if per_word == 1 {
        (inputs.beat.valid, inputs.beat.payload.data)
    } else {
        let place_bits = per_word.ilog2();
        let place = m.reg_reset("beat_place", place_bits, 0);
        place.next_when(inputs.beat.valid, place.q + m.lit(1u8, place_bits));
        let earlier = m.reg("earlier_beats", WORD_BITS - data_bits);
        let all = inputs.beat.payload.data.concat(earlier.q);
        earlier.next_when(inputs.beat.valid, all.high(WORD_BITS - data_bits));
        (inputs.beat.valid & place.q.all(), all)
    };
    let queue = fifo::place(
        false,
        "words",
        buffer,
        push.named("word_arrives"),
        word.named("arriving_word"),
        pop.get(),
    )?;
    let pops = (queue.valid & inputs.word_ready).named("word_leaves");
    pop.drive(pops);
    let more = taken.mux(words.extend(used_bits), m.zero(used_bits));
    used.next(used.q + more - pops.extend(used_bits));
    let per_beat = data_bits / 8;
    let shift = (WORD_BYTES / per_beat).ilog2();
    let beats = match shift {
        0 => words.extend(BEATS_BITS),
        _ => words.extend(BEATS_BITS - shift).concat(m.zero(shift)),
    };
    let outputs = Outputs {
        read: Flow::new(
            valid,
            Burst {
                address: address.q,
                beats: beats - m.lit(1u8, BEATS_BITS),
                id: m.zero(1),
            },
        ),
        word_valid: queue.valid,
        word: queue.front,
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}
