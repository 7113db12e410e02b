//! Properties of the ray reader: each ray has the numbers of its own words; packets are numbered from 0, and inactive rays fill the last
//! one only; an offered ray is stable, and no packet starts while it is held; no deadlock.
//!
//! The conversion of numbers is arbitrary here. Of the words of a cast the proof watches one, by its number.

use super::{Inputs, Loaded, Outputs, Words};
use crate::hdl::properties::assert_shown_stays;
use crate::hdl::{Builder, Bundle, Proof, Reg, Signal};
use crate::hw::chip::{COUNT_BITS, fitted};
use crate::hw::memory::combiner::WORD_BITS;
use crate::hw::plan::Plan;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub plan: &'a Plan,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub words: &'a Words<'b>,
    pub loaded: &'a Loaded<'b>,
    pub packets: Packets<'b>,
}

/// The packets that leave.
pub(super) struct Packets<'b> {
    pub running: Reg<'b>,
    pub left: Reg<'b>,
    pub slot: Reg<'b>,
    pub packet: Reg<'b>,
    pub short: Signal<'b>,
    pub fills: Signal<'b>,
    pub held: Signal<'b>,
    pub taken: Signal<'b>,
    pub none_left: Signal<'b>,
}

/// The greatest number of rays of a cast, as `docs/chip.md` states.
const MOST_RAYS: u32 = 1 << 26;

/// A cast as its environment knows it.
struct Cast<'b> {
    count: Signal<'b>,
    short: Signal<'b>,
    any_hit: Signal<'b>,
    /// The word of the start.
    origin: Signal<'b>,
    /// Words of the cast, and those that are yet to come.
    words: Signal<'b>,
    due: Signal<'b>,
    /// Rays that were accepted, with those that are inactive, and all there will be.
    sent: Signal<'b>,
    all: Signal<'b>,
    /// An origin was converted, and, but for short rays, no direction since.
    has_origin: Signal<'b>,
}

impl<'b> Cast<'b> {
    fn new(proof: &Proof<'b>, unit: &Unit<'_, 'b>) -> Cast<'b> {
        let (m, start) = (unit.m, unit.inputs.start);
        let of_start = |name: &str, value: Signal<'b>| {
            let register = proof.reg_reset(name, value.width(), 0);
            register.next_when(start.valid, value);
            register.q
        };
        let asked = start.payload;
        let twice = asked.count.low(COUNT_BITS - 1).concat(m.zero(1));
        let words = asked.short.mux(asked.count, twice);
        let due = proof.reg_reset("due", COUNT_BITS, 0);
        let fewer = due.q - (unit.inputs.word_valid & unit.outputs.word_ready).extend(COUNT_BITS);
        due.next(start.valid.mux(words, fewer));
        let sent = proof.reg_reset("sent", COUNT_BITS, 0);
        let ray = unit.outputs.ray.valid & unit.inputs.ray_ready;
        let more = sent.q + ray.extend(COUNT_BITS);
        sent.next(start.valid.mux(m.zero(COUNT_BITS), more));
        let slots = unit.plan.rays();
        let up = asked.count + m.lit(slots - 1, COUNT_BITS);
        let all = match slots.ilog2() {
            0 => up,
            bits => up.high(COUNT_BITS - bits).concat(m.zero(bits)),
        };
        let loaded = unit.loaded;
        let has_origin = proof.reg_reset("has_origin", 1, 0);
        let ends = loaded.direction_loads & !unit.packets.short;
        let has = loaded.origin_loads | (has_origin.q & !ends);
        has_origin.next(!start.valid & has);
        Cast {
            has_origin: has_origin.q,
            count: of_start("count", asked.count),
            short: of_start("short", asked.short),
            any_hit: of_start("any_hit", asked.any_hit),
            origin: of_start("origin", asked.origin),
            words: of_start("words", words),
            due: due.q,
            sent: sent.q,
            all: of_start("all", all),
        }
    }

    /// What is assumed of the environment.
    fn assumed(&self, proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
        let (m, inputs, outputs) = (unit.m, &unit.inputs, &unit.outputs);
        let start = inputs.start;
        proof.assume(
            "a cast starts while the unit is idle",
            start.valid.implies(!outputs.running),
        );
        let count = start.payload.count;
        proof.assume(
            "a cast has a ray, and no more than are allowed",
            (start.valid).implies(count.any() & count.le(m.lit(MOST_RAYS, COUNT_BITS))),
        );
        proof.assume(
            "the words of the cast come, and no others",
            inputs.word_valid.implies(self.due.any()),
        );
        let same = outputs.packet.eq(proof.past(outputs.packet));
        let free = proof.past(!m.reset() & outputs.running & !inputs.hold);
        proof.assume(
            "a packet that is not held stays so",
            (free & outputs.running & same).implies(!inputs.hold),
        );
    }
}

pub(super) fn packs(unit: &Unit<'_, '_>) {
    let proof = &unit.m.proof(
        "packs",
        "rays have the numbers of their words and leave in packets with tags from 0; inactive rays fill the last one only",
    );
    let cast = &Cast::new(proof, unit);
    cast.assumed(proof, unit);
    let ray = unit.outputs.ray;
    assert_shown_stays(
        proof,
        "ray",
        ray.valid,
        unit.inputs.ray_ready,
        &ray.payload.leaves(),
    );
    packets(proof, unit, cast);
    words(proof, unit, cast);
    watched(proof, unit, cast);
    progress(proof, unit, cast);
    covers(proof, unit, cast);
    faults(proof, unit);
}

/// Rays and packets are counted exactly.
fn packets<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, packets, plan) = (unit.m, &unit.packets, unit.plan);
    let (running, ray) = (unit.outputs.running, unit.outputs.ray);
    let exists = cast.sent.lt(cast.count);
    let left = exists.mux(cast.count - cast.sent, m.zero(COUNT_BITS));
    proof.assert(
        "the rays of the cast that have not left are counted",
        running.implies(packets.left.q.eq(left)),
    );
    proof.assert(
        "the unit is idle when the last packet is complete, and not before",
        running.eq(cast.sent.ne(cast.all)) & cast.sent.le(cast.all),
    );
    let slots = plan.rays().ilog2();
    let number = cast.sent.high(COUNT_BITS - slots);
    let slot = match slots {
        0 => m.zero(1),
        bits => cast.sent.low(bits),
    };
    proof.assert(
        "the slot is the place of the ray in its packet",
        running.implies(packets.slot.q.eq(slot)),
    );
    proof.assert(
        "the tag of a packet is its number in the cast",
        (running.implies(unit.outputs.packet.eq(fitted(number, plan.config.tag_bits))))
            & ray.valid.implies(ray.payload.tag.eq(unit.outputs.packet)),
    );
    proof.assert(
        "a ray is offered only while a cast runs, as one of its kind",
        ray.valid.implies(running) & running.implies(ray.payload.any_hit.eq(cast.any_hit)),
    );
    proof.assert(
        "the rays of the cast are active, those behind them are not",
        ray.valid.implies(ray.payload.active.eq(exists)),
    );
    let behind = cast.all - cast.count;
    let is_whole = match slots {
        0 => m.lit(1u8, 1),
        bits => cast.all.low(bits).is_zero(),
    };
    proof.assert(
        "inactive rays fill the last packet and no other",
        is_whole & behind.lt(m.lit(plan.rays(), COUNT_BITS)),
    );
    proof.assert(
        "no packet starts while it is held",
        (ray.valid & slot.is_zero()).implies(!unit.inputs.hold),
    );
    proof.assert(
        "the event counts the active rays that leave",
        (unit.outputs.ray_taken).eq(ray.valid & unit.inputs.ray_ready & exists),
    );
}

/// Words are counted exactly, and those of origins are told from those of directions.
fn words<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, words) = (unit.m, unit.words);
    let running = unit.outputs.running;
    let has_origin = cast.has_origin;
    let wide = |signal: Signal<'b>| signal.extend(COUNT_BITS);
    let twice = |signal: Signal<'b>| signal.low(COUNT_BITS - 1).concat(m.zero(1));
    let left = unit.packets.left.q;
    let (valid, ray) = (words.valid.q, words.ray_valid.q);
    let long = cast.due + wide(valid) + wide(has_origin) + twice(wide(ray));
    let short = cast.due + wide(valid & !words.is_origin.q) + wide(ray);
    proof.assert(
        "the words of the rays that have not left are to come or in the unit",
        running.implies(cast.short.mux(left.eq(short), twice(left).eq(long))),
    );
    proof.assert(
        "no word is left when the unit is idle",
        (!running).implies(cast.due.is_zero() & !valid & !ray),
    );
    proof.assert(
        "the kind of the rays is known",
        running.implies(unit.packets.short.eq(cast.short)),
    );
    proof.assert(
        "words to come and rays that have not left are of the cast",
        cast.due.le(cast.words)
            & running.implies(cast.words.eq(cast.short.mux(cast.count, twice(cast.count))))
            & cast.count.le(m.lit(MOST_RAYS, COUNT_BITS)),
    );
    let is_odd = cast.due.bit(0);
    let of_long = words.expects_origin.q.eq(!is_odd)
        & valid.implies(words.is_origin.q.eq(is_odd) & has_origin.eq(!is_odd))
        & (!valid).implies(has_origin.eq(is_odd))
        & !(has_origin & ray);
    proof.assert(
        "the first word of a ray is its origin, the second its direction",
        (running & !cast.short).implies(of_long),
    );
    let is_first = cast.due.eq(cast.count) & cast.sent.is_zero() & !ray & !has_origin;
    let is_origin = valid & words.is_origin.q;
    let of_short = !words.expects_origin.q
        & is_origin.implies(is_first & words.word.q.eq(cast.origin))
        & has_origin.ne(is_origin)
        & ray.implies(has_origin);
    proof.assert(
        "the first word of a cast of short rays is the origin of all, each other one a direction",
        (running & cast.short).implies(of_short),
    );
}

/// The numbers of one word.
fn watched<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, words, loaded) = (unit.m, unit.words, unit.loaded);
    let watched = proof.any_const("watched", COUNT_BITS);
    let one = m.lit(1u8, COUNT_BITS);
    let data = proof.reg("data", WORD_BITS);
    let taken = cast.words - cast.due;
    data.next_when(words.taken & taken.eq(watched), unit.inputs.word);
    // The word of the start of short rays has no number.
    let of_start = cast.short & words.is_origin.q;
    let is_here = words.valid.q & !of_start & (taken - one).eq(watched);
    proof.assert(
        "the word that is converted is that of its number",
        (unit.outputs.running & is_here).implies(words.word.q.eq(data.q)),
    );
    let numbers = m.concat(&loaded.numbers);
    let converted = |name: &str, when: Signal<'b>| {
        let register = proof.reg(name, numbers.width());
        register.next_when(when, numbers);
        register.q
    };
    let own = converted("numbers", words.moves & is_here);
    let of_all = converted("numbers_of_start", words.moves & of_start);
    let [ox, oy, oz] = loaded.origin;
    let origin = m.concat(&[ox, oy, oz, loaded.tmin]);
    let [dx, dy, dz] = loaded.direction;
    let direction = m.concat(&[dx, dy, dz, loaded.tmax]);
    let first = cast.sent.low(COUNT_BITS - 1).concat(m.zero(1));
    let running = unit.outputs.running;
    let long = running & !cast.short & (words.ray_valid.q | cast.has_origin);
    proof.assert(
        "a ray has the origin that its first word holds",
        (long & watched.eq(first)).implies(origin.eq(own)),
    );
    let ray = running & words.ray_valid.q;
    let its = cast.short.mux(cast.sent, first + one);
    proof.assert(
        "a ray has the direction that its last word holds",
        (ray & watched.eq(its)).implies(direction.eq(own)),
    );
    proof.assert(
        "short rays have the origin of the start",
        (running & cast.short & cast.has_origin).implies(origin.eq(of_all)),
    );
}

/// Nothing waits without a reason.
fn progress<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (words, outputs) = (unit.words, &unit.outputs);
    let takes = outputs.word_ready & cast.due.any();
    let held = unit.inputs.hold & unit.packets.slot.q.is_zero();
    proof.assert(
        "a cast offers a ray, takes a word that is to come, converts one, or is held",
        (outputs.running).implies(outputs.ray.valid | takes | words.moves | held),
    );
}

fn covers<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let ray = unit.outputs.ray;
    let leaves = ray.valid & unit.inputs.ray_ready;
    let is_second = cast.sent.equals(1);
    for (kind, is_kind) in [("long", !cast.short), ("short", cast.short)] {
        proof.cover(
            format!("the second of two {kind} rays leaves"),
            leaves & is_kind & is_second & ray.payload.active & cast.count.equals(2),
        );
    }
    proof.cover(
        "an inactive ray ends the second packet",
        leaves & !ray.payload.active & ray.payload.tag.equals(1),
    );
    proof.cover(
        "a ray is held while the next word waits",
        unit.packets.held & unit.words.ray_valid.q & unit.words.valid.q,
    );
}

fn faults<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (words, packets, outputs) = (unit.words, &unit.packets, &unit.outputs);
    let start = unit.inputs.start.valid;
    let ray = outputs.ray.payload;
    for (what, fault) in [
        (
            "a word is converted while a ray waits",
            words.moves.reads(words.ray_valid.q).as_value(0),
        ),
        (
            "a word is taken while another one waits",
            outputs.word_ready.reads(words.valid.q).as_value(0),
        ),
        ("no word is taken", outputs.word_ready.fault().as_value(0)),
        (
            "a word that waits is overwritten",
            words.word.q.enable().as_value(1),
        ),
        (
            "rays become short when a short cast waits",
            packets.short.enable().as_value(1),
        ),
        (
            "the slot goes on without a ray",
            packets.slot.q.enable().as_value(1),
        ),
        (
            "inactive rays are counted",
            outputs.ray_taken.fault().as_signal(packets.taken),
        ),
        (
            "the numbers of an origin are those of the next word",
            unit.loaded.origin_loads.fault().one_clock_late(),
        ),
        (
            "each word of short rays but one is an origin",
            words.expects_origin.q.reads(packets.short).as_value(0),
        ),
        (
            "a second word of a ray is an origin",
            words.expects_origin.q.enable().as_signal(start),
        ),
        (
            "the origin of short rays is a word of memory",
            words.word.q.reads(start).as_value(0),
        ),
        (
            "a packet starts while it is held",
            packets.held.fault().as_value(0),
        ),
        (
            "inactive rays are active",
            ray.active.reads(packets.fills).as_value(0),
        ),
        (
            "the unit is idle after the first packet",
            packets.running.q.reads(packets.none_left).as_value(1),
        ),
        (
            "the last packet is not filled",
            packets.fills.fault().as_value(0),
        ),
        (
            "a tag is the number of a ray",
            packets.packet.q.enable().as_signal(packets.taken),
        ),
        (
            "tags go on from cast to cast",
            packets.packet.q.reads(start).as_value(0),
        ),
        (
            "a ray is counted when it is offered",
            packets.left.q.enable().as_signal(ray.active),
        ),
        (
            "a ray is lost while it is refused",
            words.ray_valid.q.reads(words.ray_valid.q).as_value(0),
        ),
        (
            "the kind of a ray is that of the next cast",
            ray.any_hit
                .fault()
                .as_signal(unit.inputs.start.payload.any_hit),
        ),
        (
            "the numbers of a direction are those of the next word",
            unit.loaded.direction_loads.fault().one_clock_late(),
        ),
    ] {
        proof.fault(what, fault);
    }
}
