//! Properties of the burst reader: the buffer never overflows, bursts are stable and stay within their block, and while a sequence is
//! read, the reader works or waits for the bus or for its user.

use super::{BLOCK_BYTES, Buffer, Inputs, Outputs, Requests, Sizes};
use crate::hdl::properties::{assert_shown_stays, shown_stays};
use crate::hdl::{Builder, Proof, Signal};
use crate::hw::memory::Burst;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub sizes: &'a Sizes,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub requests: &'a Requests<'b>,
    pub buffer: &'a Buffer<'b>,
}

impl<'b> Unit<'_, 'b> {
    /// Width of sums of beats.
    fn bits(&self) -> u32 {
        self.sizes.free_bits() + self.sizes.row_beats().ilog2() + 2
    }

    fn wide(&self, signal: Signal<'b>) -> Signal<'b> {
        signal.extend(self.bits())
    }

    /// The beats of some rows.
    fn in_beats(&self, rows: Signal<'b>) -> Signal<'b> {
        let by = self.m.lit(self.sizes.row_beats().ilog2(), 2);
        self.wide(rows).shl(by)
    }
}

pub(super) fn reads(unit: &Unit<'_, '_>) {
    let (m, requests) = (unit.m, unit.requests);
    let proof = &m.proof(
        "reads",
        "the buffer never overflows; bursts are stable and stay within their block; no deadlock",
    );
    let rows = &unit.buffer.rows;
    rows.keep(proof);
    let read = unit.outputs.read;
    let Burst { address, beats, .. } = read.payload;
    let accepted = read.valid & unit.inputs.read_ready;
    assert_shown_stays(
        proof,
        "burst",
        read.valid,
        unit.inputs.read_ready,
        &[address, beats],
    );
    assert_shown_stays(
        proof,
        "word",
        unit.outputs.word.valid,
        unit.inputs.word_ready,
        // That the front word of a queue is stable is a property of the queue.
        &[],
    );
    proof.assume(
        "a start is stable until it is accepted",
        shown_stays(
            proof,
            unit.inputs.start.valid,
            unit.outputs.start_ready,
            &[
                unit.inputs.start.payload.address,
                unit.inputs.start.payload.words,
            ],
        ),
    );

    // Beats that the bus owes.
    let bits = unit.bits();
    let in_burst = unit.wide(beats.low(bits.min(beats.width()))) + m.lit(1u8, bits);
    let owed = proof.reg_reset("owed", bits, 0);
    let comes = accepted.repeat(bits) & in_burst;
    let beat = unit.inputs.beat.valid;
    owed.next(owed.q + comes - unit.wide(beat));
    proof.assume(
        "the bus returns the beats of accepted bursts",
        beat.implies(owed.q.any()),
    );
    let parts = unit.buffer.part.map_or(m.zero(1), |part| part.q);
    let offered = read.valid.repeat(bits) & in_burst;
    let stored = unit.in_beats(rows.count(unit.sizes.free_bits()));
    let used = stored + unit.wide(parts) + owed.q + offered;
    let all = unit.in_beats(m.lit(unit.sizes.rows(), unit.sizes.free_bits()));
    proof.assert(
        "a row is free, requested, arriving or in the buffer",
        (unit.in_beats(requests.free.q) + used).eq(all),
    );
    for (what, count) in [
        ("owed beats", owed.q),
        ("offered beats", offered),
        ("stored beats", stored),
        ("beats of free rows", unit.in_beats(requests.free.q)),
    ] {
        proof.assert(format!("no more {what} than the buffer has"), count.le(all));
    }
    if let Some(part) = unit.buffer.part {
        let due = owed.q.low(part.q.width()) + part.q;
        proof.assert("beats of whole rows are owed", due.is_zero());
    }
    proof.assert(
        "no row is stored without room",
        rows.push
            .implies(rows.count(bits).lt(m.lit(unit.sizes.rows(), bits))),
    );
    in_block(proof, unit);
    let room = requests
        .free
        .q
        .high(unit.sizes.free_bits() - unit.sizes.block_row_bits());
    let waits_for_bus = read.valid | owed.q.any();
    proof.assert(
        "a sequence makes progress, or waits for the bus or the user",
        unit.outputs.start_ready | requests.load | waits_for_bus | unit.outputs.word.valid,
    );
    proof.assert(
        "words are requested while there is room",
        (requests.any_left.q & room.any() & !read.valid).implies(requests.load),
    );
    proof.cover(
        "a word is taken",
        unit.outputs.word.valid & unit.inputs.word_ready,
    );
    proof.fault(
        "a burst is requested without room",
        requests.load.reads(requests.offered.q).as_value(0),
    );
    proof.fault(
        "the rows of a burst are not counted",
        requests.free.q.enable().as_signal(rows.pop),
    );
    proof.fault(
        "the last burst is not known as such",
        requests.any_left.q.reads(requests.is_last).as_value(0),
    );
    proof.fault(
        "a burst goes on beyond its block",
        requests.rows_less_one.fault().with_flipped(1),
    );
}

/// Bursts are aligned and stay within a block.
fn in_block<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (m, requests) = (unit.m, unit.requests);
    let read = unit.outputs.read;
    let offset = BLOCK_BYTES.ilog2();
    let bytes = unit.sizes.data_bits / 8;
    let first = read.payload.address.low(offset).extend(offset + 2);
    let beats = read.payload.beats.low(offset).extend(offset + 2);
    let last = first + beats.shl(m.lit(bytes.ilog2(), 3));
    proof.assert(
        "a burst stays within its block",
        read.valid
            .implies(last.high(2).is_zero() & read.payload.beats.high(3).is_zero()),
    );
    proof.assert(
        "a burst is aligned to the width of the data",
        read.valid
            .implies(read.payload.address.low(bytes.ilog2()).is_zero()),
    );
    proof.assert(
        "the flag says whether words are left",
        requests.any_left.q.implies(requests.left.q.any()),
    );
}
