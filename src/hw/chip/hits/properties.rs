//! Properties of the hit writer: each hit of a ray is written once, at its place, and no other; the answers of a packet are those of its
//! rays; each word of answers is written once, at its place; a write is stable until it is accepted; the unit is idle only after its last
//! write; no deadlock.
//!
//! The proof watches one ray, by its number. Of the answer collector it assumes what that unit's own proof says.

use super::{Offer, Outputs, Stored, answers};
use crate::hdl::properties::{assert_shown_stays, shown_stays};
use crate::hdl::{Builder, Bundle, Flow, Proof, Reg, Signal};
use crate::hw::chip::{COUNT_BITS, fitted};
use crate::hw::memory::ADDRESS_BITS;
use crate::hw::memory::combiner::{WORD_BITS, WORD_BYTES};
use crate::hw::plan::Plan;
use crate::hw::ray::Hit;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub plan: &'a Plan,
    pub inputs: super::Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub stored: &'a Stored<'b>,
    pub packets: Packets<'b>,
    /// The record of the hit that is offered, and the write of a word of answers.
    pub record: Offer<'b>,
    pub answer_write: Offer<'b>,
    /// The answers of a packet, and those of its rays so far.
    pub answers: Flow<answers::Answers<Signal<'b>>, Signal<'b>>,
    pub earlier: Option<Reg<'b>>,
    pub collector: answers::Outputs<Signal<'b>>,
}

/// The hits that are accepted.
pub(super) struct Packets<'b> {
    pub left: Reg<'b>,
    /// The packets of the cast to start.
    pub all: Signal<'b>,
    pub slot: Reg<'b>,
    pub any_hit: Reg<'b>,
    pub count: Reg<'b>,
    pub base: Reg<'b>,
    pub taken: Signal<'b>,
    pub ends: Signal<'b>,
}

/// The greatest number of rays of a cast, as `docs/chip.md` states.
const MOST_RAYS: u32 = 1 << 26;

/// The bits of an address that are 0 in that of the hits.
const ALIGNED_BITS: u32 = 6;

impl<'b> Unit<'_, 'b> {
    /// Bits of the number of a ray in its packet, and of a ray that has a tag.
    fn slots(&self) -> u32 {
        self.plan.rays().ilog2()
    }

    fn ray_bits(&self) -> u32 {
        (self.plan.config.tag_bits + self.slots()).min(COUNT_BITS)
    }

    /// Whether a hit of a record is two words.
    fn is_wide(&self) -> bool {
        self.stored.data.q.width() > WORD_BITS
    }

    /// A hit in memory, as `docs/chip.md` states.
    fn bytes(&self, hit: Hit<Signal<'b>>) -> Signal<'b> {
        let m = self.m;
        let whole = |value: Signal<'b>| value.extend(value.width().next_multiple_of(8));
        let [t, u, v] = [hit.t, hit.u, hit.v].map(whole);
        let parts = m.concat(&[hit.instance.low(24), hit.triangle, v, u, t]);
        let width = self.stored.data.q.width();
        match parts.width() == width {
            true => parts,
            false => parts.extend(width),
        }
    }
}

/// A cast as its environment knows it.
struct Cast<'b> {
    count: Signal<'b>,
    any_hit: Signal<'b>,
    address: Signal<'b>,
    /// Hits that are yet to come, with those of inactive rays.
    due: Signal<'b>,
    /// The number of the ray whose hit is offered.
    ray: Signal<'b>,
    /// Words that were taken and are not written.
    owed: Signal<'b>,
    /// A word of answers is taken.
    takes_answers: Signal<'b>,
}

impl<'b> Cast<'b> {
    fn new(proof: &Proof<'b>, unit: &Unit<'_, 'b>) -> Cast<'b> {
        let (m, start, hit) = (unit.m, unit.inputs.start, unit.inputs.hit);
        let of_start = |name: &str, value: Signal<'b>| {
            let register = proof.reg_reset(name, value.width(), 0);
            register.next_when(start.valid, value);
            register.q
        };
        let asked = start.payload;
        let (count, any_hit) = (
            of_start("count", asked.count),
            of_start("any_hit", asked.any_hit),
        );
        let taken = hit.valid & unit.outputs.hit_ready;
        let due = proof.reg_reset("due", COUNT_BITS, 0);
        let slots = unit.slots();
        let up = asked.count + m.lit(unit.plan.rays() - 1, COUNT_BITS);
        let all = up.high(COUNT_BITS - slots).concat(m.zero(slots));
        due.next(start.valid.mux(all, due.q - taken.extend(COUNT_BITS)));
        // The place of the next hit in its packet, counted from the last one.
        let slot = m.zero(slots) - due.q.low(slots);
        let ray = fitted(hit.payload.tag.concat(slot), COUNT_BITS);
        let takes_record = taken & !any_hit & ray.lt(count);
        let word = unit.collector.word;
        let takes_answers = word.valid & unit.stored.room;
        let owed = proof.reg_reset("owed", 3, 0);
        let words = m.lit(1 + u32::from(unit.is_wide()), 3);
        let comes = (takes_record.repeat(3) & words) + takes_answers.extend(3);
        let goes = unit.outputs.write.valid & unit.inputs.write_ready;
        owed.next(owed.q + comes - goes.extend(3));
        Cast {
            count,
            any_hit,
            address: of_start("address", asked.address),
            due: due.q,
            ray,
            owed: owed.q,
            takes_answers,
        }
    }

    /// What is assumed of the environment.
    fn assumed(&self, proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
        let (m, start, hit) = (unit.m, unit.inputs.start, unit.inputs.hit);
        proof.assume(
            "a cast starts while the unit is idle",
            start.valid.implies(!unit.outputs.running),
        );
        let count = start.payload.count;
        proof.assume(
            "a cast has a ray, and no more than are allowed",
            (start.valid).implies(count.any() & count.le(m.lit(MOST_RAYS, COUNT_BITS))),
        );
        proof.assume(
            "the address of the hits is aligned",
            (start.valid).implies(start.payload.address.low(ALIGNED_BITS).is_zero()),
        );
        proof.assume(
            "the hits of the cast come, and no others",
            hit.valid.implies(self.due.any()),
        );
        proof.assume(
            "a hit is stable until it is accepted",
            shown_stays(
                proof,
                hit.valid,
                unit.outputs.hit_ready,
                &hit.payload.leaves(),
            ),
        );
        let tag = proof.reg("tag", unit.plan.config.tag_bits);
        tag.next_when(hit.valid & unit.outputs.hit_ready, hit.payload.tag);
        let is_first = self.due.low(unit.slots()).is_zero();
        proof.assume(
            "the hits of a packet follow each other",
            hit.valid.implies(is_first | hit.payload.tag.eq(tag.q)),
        );
        self.collector_assumed(proof, unit);
    }

    /// What the answer collector's own properties say.
    fn collector_assumed(&self, proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
        let (m, collector) = (unit.m, &unit.collector);
        let start = unit.inputs.start;
        let starts = start.valid & start.payload.any_hit;
        proof.assume(
            "the collector works from the start of a cast of any-hit rays on, and not before",
            (collector.running).implies(proof.past(!m.reset() & (starts | collector.running)))
                & proof.past(!m.reset() & starts).implies(collector.running),
        );
        proof.assume(
            "the collector is idle only after its last word",
            (proof.past(!m.reset() & collector.running) & !collector.running)
                .implies(proof.past(self.takes_answers)),
        );
        let word = collector.word;
        proof.assume(
            "the collector has a word only while it works",
            word.valid.implies(collector.running),
        );
        proof.assume(
            "a word of answers is stable until it is accepted",
            shown_stays(proof, word.valid, unit.stored.room, &word.payload.leaves()),
        );
    }
}

pub(super) fn writes(unit: &Unit<'_, '_>) {
    if unit.slots() == 0 {
        // A proof of packets of several rays.
        return;
    }
    let proof = &unit.m.proof(
        "writes",
        "each hit and each word of answers is written once, at its place; the unit is idle only after its last write",
    );
    let cast = &Cast::new(proof, unit);
    cast.assumed(proof, unit);
    let write = unit.outputs.write;
    assert_shown_stays(
        proof,
        "write",
        write.valid,
        unit.inputs.write_ready,
        &write.payload.leaves(),
    );
    counts(proof, unit, cast);
    record(proof, unit, cast);
    answers_of_packets(proof, unit, cast);
    words_of_answers(proof, unit, cast);
    faults(proof, unit);
}

/// Hits and writes are counted exactly.
fn counts<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, packets, stored) = (unit.m, &unit.packets, unit.stored);
    let (slots, running) = (unit.slots(), unit.outputs.running);
    let whole = packets.left.q.low(COUNT_BITS - slots).concat(m.zero(slots));
    let some = cast.due.any();
    proof.assert(
        "the packets whose hits are to come are counted",
        some.eq(packets.left.q.any())
            & some.implies(whole.eq(cast.due + packets.slot.q.extend(COUNT_BITS))),
    );
    proof.assert(
        "no more hits are to come than a cast has",
        cast.due.le(m.lit(MOST_RAYS, COUNT_BITS)) & packets.left.q.le(m.lit(MOST_RAYS, COUNT_BITS)),
    );
    proof.assert(
        "the cast is known while it runs",
        running.implies(
            packets.count.q.eq(cast.count)
                & packets.any_hit.q.eq(cast.any_hit)
                & packets.base.q.eq(cast.address),
        ),
    );
    proof.assert(
        "only a cast of any-hit rays collects answers",
        unit.collector.running.implies(cast.any_hit),
    );
    let offered = stored.valid.q.extend(3) + stored.second.q.extend(3);
    proof.assert(
        "a write is offered for each word that was taken, once, and no other",
        cast.owed.eq(offered) & stored.second.q.implies(stored.valid.q),
    );
    proof.assert(
        "idle means that all hits have come and all words are written",
        (!running).implies(!some & cast.owed.is_zero() & !unit.collector.running),
    );
    let hit = unit.inputs.hit;
    let refused = stored.valid.q & (!unit.inputs.write_ready | stored.second.q);
    proof.assert(
        "a hit waits only for a write, and answers never wait",
        (hit.valid & !unit.outputs.hit_ready).implies(refused & !cast.any_hit),
    );
    proof.assert(
        "packets are held only while answers are collected",
        (running & unit.outputs.hold).implies(cast.any_hit & unit.collector.hold),
    );
    proof.cover(
        "a hit waits for a write",
        hit.valid & !unit.outputs.hit_ready,
    );
}

/// The offset of the hit of a ray.
fn record_offset<'b>(unit: &Unit<'_, 'b>, ray: Signal<'b>) -> Signal<'b> {
    let scale = (unit.stored.data.q.width() / 8).ilog2();
    ray.low(ADDRESS_BITS - scale).concat(unit.m.zero(scale))
}

/// The hit of one ray.
fn record<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, stored) = (unit.m, unit.stored);
    let watched = proof.any_const("watched", unit.ray_bits());
    let watched = watched.extend(COUNT_BITS);
    let hit = unit.inputs.hit;
    let taken = hit.valid & unit.outputs.hit_ready & !cast.any_hit;
    let here = taken & cast.ray.eq(watched) & watched.lt(cast.count);
    let accepted = unit.outputs.write.valid & unit.inputs.write_ready;
    let is_wide = unit.is_wide();
    // The hit is taken: its first word is offered, then its second.
    let first = proof.reg_reset("first", 1, 0);
    first.next(here | (first.q & !accepted));
    let second = proof.reg_reset("second", 1, 0);
    let goes_on = first.q & accepted & m.lit(u8::from(is_wide), 1);
    second.next(goes_on | (second.q & !accepted));
    let bytes = unit.bytes(hit.payload.hit);
    let kept = proof.reg("kept", bytes.width());
    kept.next_when(here, bytes);
    let write = unit.outputs.write;
    let address = cast.address + record_offset(unit, watched);
    let is_write = |address: Signal<'b>, data: Signal<'b>| {
        write.valid
            & write.payload.address.eq(address)
            & write.payload.data.eq(data)
            & write.payload.strobes.all()
    };
    let follows = stored.second.q.eq(m.lit(u8::from(is_wide), 1));
    proof.assert(
        "the hit of a ray is written at its place, the first word first",
        (first.q).implies(is_write(address, kept.q.low(WORD_BITS)) & follows),
    );
    if is_wide {
        let behind = address + m.lit(WORD_BYTES, ADDRESS_BITS);
        let rest = stored.data.q.low(WORD_BITS).eq(kept.q.high(WORD_BITS));
        proof.assert(
            "the second word of a hit is written behind the first",
            (second.q).implies(is_write(behind, kept.q.high(WORD_BITS)) & rest & !stored.second.q),
        );
        let high = stored.data.q.high(WORD_BITS);
        proof.assert(
            "the second word of a hit is kept while the first is offered",
            first.q.implies(high.eq(kept.q.high(WORD_BITS))),
        );
    }
    let last = match is_wide {
        true => second.q,
        false => first.q,
    };
    proof.cover(
        "the hit of the last ray is written, and inactive rays follow",
        last & accepted & (watched + m.lit(1u8, COUNT_BITS)).eq(cast.count) & cast.due.any(),
    );
}

/// The answers of a packet: those of its rays in their order.
fn answers_of_packets<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, packets, rays) = (unit.m, &unit.packets, unit.plan.rays());
    let slot = proof.any_const("slot", unit.slots());
    let hit = unit.inputs.hit;
    let taken = hit.valid & unit.outputs.hit_ready;
    let now = cast.ray.low(unit.slots());
    let is_hit = hit.payload.hit.t.ne(unit.plan.infinity(m));
    let answer = proof.reg("answer", 1);
    answer.next_when(taken & now.eq(slot), is_hit);
    let earlier = unit.earlier.expect("a packet has several rays").q;
    let all: Vec<_> = (1..rays)
        .flat_map(|next| (0..next).map(move |before| (next, before)))
        .map(|(next, before)| {
            let here = packets.slot.q.equals(next.into()) & slot.equals(before.into());
            here.implies(earlier.bit(rays - 1 - next + before).eq(answer.q))
        })
        .collect();
    proof.assert(
        "the answers so far are those of the rays that have come",
        cast.due.any().implies(m.and_all(&all)),
    );
    let ends = taken & now.all();
    let answers = unit.answers;
    proof.assert(
        "a packet has answers with its last hit, if it is one of any-hit rays",
        answers.valid.eq(ends & cast.any_hit),
    );
    let its = now.eq(slot).mux(is_hit, answer.q);
    proof.assert(
        "the answers of a packet are those of its rays",
        answers.valid.implies(
            answers.payload.tag.eq(hit.payload.tag) & answers.payload.bits.bit_at(slot).eq(its),
        ),
    );
}

/// A word of answers becomes a write.
fn words_of_answers<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, word, write) = (unit.m, unit.collector.word.payload, unit.outputs.write);
    let number = proof.past(word.number);
    let bits = proof.past(word.bits);
    let lane = number.low(2);
    let offset = number
        .high(COUNT_BITS - 2)
        .low(ADDRESS_BITS - 4)
        .concat(m.zero(4));
    let address = cast.address + offset;
    let lanes = m.lit(15u8, WORD_BYTES).shl(lane.concat(m.zero(2)));
    let data = write.payload.data.shr(lane.concat(m.zero(5))).low(32);
    proof.assert(
        "a word of answers is written at its place",
        proof.past(!m.reset() & cast.takes_answers).implies(
            write.valid
                & write.payload.address.eq(address)
                & write.payload.strobes.eq(lanes)
                & data.eq(bits),
        ),
    );
    proof.assert(
        "the address of the hits is aligned while a cast runs",
        cast.address.low(ALIGNED_BITS).is_zero(),
    );
    proof.cover(
        "the last word of answers is written in the last part of a word of memory",
        unit.outputs.running
            & write.valid
            & unit.inputs.write_ready
            & write.payload.strobes.bit(WORD_BYTES - 1)
            & cast.any_hit
            & cast.due.is_zero(),
    );
}

fn faults<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (stored, packets, outputs) = (unit.stored, &unit.packets, &unit.outputs);
    let slot = packets.slot.q;
    let earlier = unit.earlier.expect("a packet has several rays").q;
    for (what, fault) in [
        (
            "a hit is taken while a write is refused",
            outputs.hit_ready.reads(stored.room).as_value(1),
        ),
        (
            "answers wait for writes of other words",
            outputs.hit_ready.reads(packets.any_hit.q).as_value(0),
        ),
        (
            "the hits of inactive rays are written",
            unit.record.valid.operand(&[1]).as_value(1),
        ),
        (
            "each hit counts as a packet",
            packets.left.q.reads(packets.ends).as_signal(packets.taken),
        ),
        (
            "a packet is counted when a hit is offered",
            packets
                .ends
                .reads(packets.taken)
                .as_signal(unit.inputs.hit.valid),
        ),
        (
            "the last packet is counted only if it is full",
            packets.all.operand(&[1]).as_value(0),
        ),
        (
            "idle is shown while the last write waits",
            outputs.running.reads(stored.valid.q).as_value(0),
        ),
        (
            "idle is shown while the collector works",
            outputs.running.reads(unit.collector.running).as_value(0),
        ),
        (
            "the hits of a packet are written at one place",
            unit.record.address.reads(slot).as_value(0),
        ),
        (
            "the number of rays changes during a cast",
            packets.count.q.enable().as_value(1),
        ),
        (
            "a write that is refused is overwritten",
            stored.room.fault().as_value(1),
        ),
        (
            "a write is lost when it is refused",
            stored.valid.q.reads(stored.leaves).as_value(1),
        ),
        (
            "answers move on without a hit",
            earlier.enable().as_value(1),
        ),
        (
            "a packet has the answers of its misses",
            unit.answers.payload.bits.fault().inverted(),
        ),
        (
            "records of closest hits have answers",
            unit.answers.valid.reads(packets.any_hit.q).as_value(1),
        ),
        (
            "a word of answers is written in the first part",
            unit.answer_write.strobes.fault().as_value(15),
        ),
        (
            "packets of closest hits are held",
            outputs.hold.reads(packets.any_hit.q).as_value(1),
        ),
    ] {
        proof.fault(what, fault);
    }
    if unit.is_wide() {
        for (what, fault) in [
            (
                "the second word is written over the first",
                stored.address.q.literal_of(WORD_BYTES.into()).as_value(0),
            ),
            (
                "the data of a write change while it waits",
                stored.data.q.enable().as_value(1),
            ),
            (
                "the second word is left out",
                stored.leaves.reads(stored.second.q).as_value(0),
            ),
            (
                "answers have a second word",
                stored.second.q.reads(packets.any_hit.q).as_value(0),
            ),
        ] {
            proof.fault(what, fault);
        }
    }
}
