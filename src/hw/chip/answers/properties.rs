//! Properties of the answer collector: packets may be answered in any order; the words have their answers in the order of the packets,
//! none lost, doubled or left from the pass before; no more packets than the window has are begun; no deadlock.
//!
//! The proof follows each packet of a cast from its begin to its answers, by its tag. Of the answers themselves it watches those of one
//! arbitrary packet. A read of a word that is written in the same cycle returns any value, as that of a block RAM may.

use super::{Inputs, Outputs, RAYS_PER_WORD, Window, Words, fitted};
use crate::hdl::properties::assert_shown_stays;
use crate::hdl::{Builder, Bundle, Proof, Signal};
use crate::hw::chip::COUNT_BITS;
use crate::hw::plan::Plan;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub plan: &'a Plan,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub window: &'a Window<'b>,
    pub words: &'a Words<'b>,
}

/// The proof has a condition for each word of the memory and for each tag: it is described for few of them.
const FEW_PACKETS: u32 = 8;
const FEW_TAG_BITS: u32 = 5;

pub(super) fn describe(unit: &Unit<'_, '_>) {
    let plan = unit.plan;
    let is_small = unit.window.depth == FEW_PACKETS && plan.config.tag_bits <= FEW_TAG_BITS;
    if is_small && plan.rays() < RAYS_PER_WORD {
        orders(unit);
    }
}

/// The packets of a cast, as its environment knows them.
struct Cast<'b> {
    /// Packets of the cast, those that have begun, and those that are in a word: a prefix each.
    total: Signal<'b>,
    begun: Signal<'b>,
    moved: Signal<'b>,
    /// Words that have been accepted.
    sent: Signal<'b>,
    /// The packets that have begun and are not answered, by their tags.
    open: Signal<'b>,
    begins: Signal<'b>,
}

impl<'b> Cast<'b> {
    fn new(proof: &Proof<'b>, unit: &Unit<'_, 'b>) -> Cast<'b> {
        let (m, inputs) = (unit.m, &unit.inputs);
        let tags = unit.plan.config.tag_bits;
        let bits = tags + 1;
        let begins = proof.any_seq("begins", 1);
        let counter = |name: &str, steps: Signal<'b>| {
            let register = proof.reg_reset(name, bits, 0);
            let next = register.q + steps.extend(bits);
            register.next(inputs.start.mux(m.zero(bits), next));
            register.q
        };
        let total = proof.reg_reset("total", bits, 0);
        total.next_when(inputs.start, inputs.packets.low(bits));
        let begun = counter("begun", begins);
        let moved = counter("moved", unit.window.moves.get());
        let sent = counter("sent", unit.outputs.word.valid & inputs.word_ready);
        let open = proof.reg_reset("open", 1 << tags, 0);
        let one = |valid: Signal<'b>, tag: Signal<'b>| valid.extend(1 << tags).shl(tag);
        let answers = inputs.answers;
        let closed = one(answers.valid, answers.payload.tag);
        open.next((open.q & !closed) | one(begins, begun.low(tags)));
        Cast {
            total: total.q,
            begun,
            moved,
            sent,
            open: open.q,
            begins,
        }
    }

    /// What is assumed of the environment.
    fn assumed(&self, proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
        let (m, inputs) = (unit.m, &unit.inputs);
        let (tags, bits) = (unit.plan.config.tag_bits, self.total.width());
        let running = unit.outputs.running;
        proof.assume(
            "a cast starts while the unit is idle",
            inputs.start.implies(!running),
        );
        let most = m.lit(1u64 << tags, COUNT_BITS);
        proof.assume(
            "a cast has as many packets as there are tags, or fewer, and at least one",
            (inputs.start).implies(inputs.packets.any() & inputs.packets.le(most)),
        );
        let last = self.begun - m.lit(1u8, bits);
        let is_next = inputs.packet.eq(self.begun.low(tags));
        let is_last = inputs.packet.eq(last.low(tags)) & self.open.bit_at(inputs.packet);
        proof.assume(
            "the next ray is that of the packet that begins next, or that has begun last and is not answered",
            running.implies(is_next | is_last),
        );
        proof.assume(
            "packets of the cast begin in order, each while it is not held",
            (self.begins)
                .implies(running & is_next & self.begun.lt(self.total) & !unit.outputs.hold),
        );
        let answers = inputs.answers;
        proof.assume(
            "answers come once for each packet, after it has begun",
            (answers.valid).implies(self.open.bit_at(answers.payload.tag)),
        );
    }

    /// Whether a packet has its answers; its number is of the width of the counts.
    fn is_answered(&self, packet: Signal<'b>) -> Signal<'b> {
        let tag = packet.low(packet.width() - 1);
        packet.lt(self.begun) & !self.open.bit_at(tag)
    }
}

fn orders(unit: &Unit<'_, '_>) {
    let (m, window) = (unit.m, unit.window);
    let proof = &m.proof(
        "orders",
        "words have the answers of packets in order, whatever the order in which they come; no more packets than the window has",
    );
    let cast = &Cast::new(proof, unit);
    cast.assumed(proof, unit);
    let collides =
        (unit.inputs.answers.valid | window.sweeping.q) & window.write_place.eq(window.read_place);
    proof.cut(window.entry);
    proof.assume(
        "a word of the memory that is not written is read as it was",
        proof.past(collides) | (window.entry).eq(proof.past(window.memory.peek(window.read_place))),
    );
    counts(proof, unit, cast);
    memory(proof, unit, cast);
    watched(proof, unit, cast);
    assert_shown_stays(
        proof,
        "word",
        unit.outputs.word.valid,
        unit.inputs.word_ready,
        &unit.outputs.word.payload.leaves(),
    );
    progress(proof, unit, cast);
    covers(proof, unit, cast);
    faults(proof, unit);
}

/// Packets and words are counted exactly.
fn counts<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, window, words) = (unit.m, unit.window, unit.words);
    let bits = cast.total.width();
    let running = unit.outputs.running;
    proof.assert(
        "packets that are not in a word are counted",
        words
            .left
            .q
            .eq((cast.total - cast.moved).extend(COUNT_BITS)),
    );
    proof.assert(
        "packets in words have begun, and packets that have begun are of the cast",
        cast.moved.le(cast.begun) & cast.begun.le(cast.total),
    );
    proof.assert(
        "a cast has no more packets than there are tags",
        cast.total.le(m.lit(1u8, bits).shl(m.lit(bits - 1, bits))),
    );
    proof.assert(
        "no more packets than the window has are begun",
        (cast.begun - cast.moved).le(m.lit(FEW_PACKETS, bits)),
    );
    let number_bits = window.first.q.width();
    proof.assert(
        "the first packet follows those in words",
        (window.first.q).eq(window.offset.q + fitted(cast.moved, number_bits)),
    );
    let slot_bits = (RAYS_PER_WORD / unit.plan.rays()).ilog2();
    if let Some(slot) = words.slot {
        proof.assert(
            "the place in the word is that of the first packet",
            running.implies(slot.q.eq(cast.moved.low(slot_bits))),
        );
    }
    let ends_word = cast.moved.low(slot_bits).is_zero() | cast.moved.eq(cast.total);
    proof.assert(
        "no packet goes into the next word while one is offered",
        words.valid.q.implies(ends_word),
    );
    proof.assert(
        "no more words than packets have left",
        cast.sent.le(cast.moved),
    );
    let whole = cast.moved.high(bits - slot_bits).extend(bits);
    let part = (cast.moved.eq(cast.total) & cast.moved.low(slot_bits).any()).extend(bits);
    proof.assert(
        "a word is offered when its packets are complete, each once",
        (cast.sent + words.valid.q.extend(bits)).eq(whole + part),
    );
    proof.assert(
        "words are numbered from 0",
        running.implies(words.number.q.eq(cast.sent.extend(COUNT_BITS))),
    );
    let ends = proof.past(!unit.m.reset() & running) & !running;
    proof.assert(
        "the unit works from the start on, until its last word is accepted",
        (proof.past(!unit.m.reset() & unit.inputs.start)).implies(running)
            & ends.implies(proof.past(words.valid.q & unit.inputs.word_ready)),
    );
    proof.assert(
        "idle means that all packets are in words, and all words are accepted",
        (!running).implies(cast.moved.eq(cast.total) & cast.sent.eq(whole + part)),
    );
}

/// The words of the memory, and the packets whose answers they have.
fn memory<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, window) = (unit.m, unit.window);
    let (tags, bits) = (unit.plan.config.tag_bits, cast.total.width());
    let (sweeping, swept) = (window.sweeping.q, window.swept.q);
    let of_tag = |tag: u32| {
        let packet = m.lit(tag, bits);
        let in_window = cast.moved.le(packet) & packet.lt(cast.begun);
        cast.open.bit(tag).implies(in_window)
    };
    let all: Vec<_> = (0..1 << tags).map(of_tag).collect();
    proof.assert(
        "a packet without answers has begun and is in no word",
        m.and_all(&all),
    );
    proof.assert(
        "no packet begins before the memory is swept",
        sweeping
            .implies(window.first.q.is_zero() & window.offset.q.is_zero() & cast.begun.is_zero()),
    );
    let begins_sweep = sweeping & swept.is_zero();
    proof.assert(
        "no cast runs when the sweep begins",
        begins_sweep.implies(!unit.outputs.running),
    );
    let before = proof.past(swept);
    proof.assert(
        "the sweep writes one word after another and ends with the last",
        proof
            .past(!m.reset() & sweeping)
            .implies(swept.eq(before + m.lit(1u8, swept.width())) & sweeping.eq(swept.any())),
    );
    let place_bits = swept.width();
    for place in 0..FEW_PACKETS {
        let here = m.lit(place, place_bits);
        // How many packets are before the one of the window that has this place.
        let ahead = here - window.first.q.low(place_bits);
        let number = window.first.q + ahead.extend(window.first.q.width());
        let packet = cast.moved + ahead.extend(bits);
        let is_of_pass = (window.memory.peek(here).high(1)).eq(number.high(1));
        let unswept = sweeping & swept.le(here);
        proof.assert(
            format!("word {place} is of this pass if its packet is answered"),
            unswept | is_of_pass.eq(cast.is_answered(packet)),
        );
    }
    let first = window.first.q.low(place_bits);
    proof.assert(
        "the word that was read is that of the first packet",
        begins_sweep | window.was_written.q | window.entry.eq(window.memory.peek(first)),
    );
}

/// The answers of one packet.
fn watched<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, window, words) = (unit.m, unit.window, unit.words);
    let (tags, bits, rays) = (
        unit.plan.config.tag_bits,
        cast.total.width(),
        unit.plan.rays(),
    );
    let answers = unit.inputs.answers;
    let tag = proof.any_const("watched", tags);
    let packet = tag.extend(bits);
    let kept = proof.reg("kept", rays);
    kept.next_when(
        answers.valid & answers.payload.tag.eq(tag),
        answers.payload.bits,
    );
    let number = fitted(packet, window.first.q.width()) + window.offset.q;
    let stored = window.memory.peek(number.low(window.swept.q.width()));
    let is_moved = packet.lt(cast.moved);
    let is_answered = cast.is_answered(packet);
    proof.assert(
        "the answers of a packet are kept until they are in a word",
        (is_answered & !is_moved).implies(stored.low(rays).eq(kept.q)),
    );
    let packets = RAYS_PER_WORD / rays;
    let slot_bits = packets.ilog2();
    let fields: Vec<_> = (0..packets)
        .map(|slot| words.word.q.field(slot * rays, rays))
        .collect();
    let field = m.select(tag.low(slot_bits), &fields);
    let of_word = packet.high(bits - slot_bits).extend(bits);
    let running = unit.outputs.running;
    let is_made = running & of_word.eq(cast.sent);
    proof.assert(
        "the word that is made has the answers of its packets so far",
        (is_made & is_moved).implies(field.eq(kept.q)),
    );
    let has_any = words.slot.map_or(m.zero(1), |slot| slot.q.any()) | words.valid.q;
    proof.assert(
        "the word that is made has no other answers",
        (is_made & has_any & !is_moved).implies(field.is_zero()),
    );
    // The property for which the others are.
    let word = unit.outputs.word;
    let is_here = word.valid & word.payload.number.eq(of_word.extend(COUNT_BITS));
    let exists = packet.lt(cast.total);
    proof.assert(
        "a word has the answers of its packets, each at its place",
        (is_here & exists).implies(is_answered & field.eq(kept.q)),
    );
    proof.assert(
        "a word has zeros behind the last packet",
        (is_here & !exists).implies(field.is_zero()),
    );
}

/// Nothing waits without a reason.
fn progress<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (m, window, words) = (unit.m, unit.window, unit.words);
    let moves = window.moves.get();
    let waits = cast.is_answered(cast.moved);
    proof.assert(
        "a packet that was answered and is the first goes into a word that has room",
        (proof.past(!m.reset() & waits & !moves) & words.free).implies(moves),
    );
    let bits = cast.total.width();
    let (tags, running) = (unit.plan.config.tag_bits, unit.outputs.running);
    let is_next = running & unit.inputs.packet.eq(cast.begun.low(tags));
    let has_room = (cast.begun - cast.moved).lt(m.lit(FEW_PACKETS, bits));
    proof.assert(
        "the next packet is held by the sweep and by a full window, and by nothing else",
        is_next.implies(unit.outputs.hold.eq(window.sweeping.q | !has_room)),
    );
    let same = unit.inputs.packet.eq(proof.past(unit.inputs.packet));
    let free = proof.past(!m.reset() & running & !unit.outputs.hold);
    proof.assert(
        "a packet that is not held stays so",
        (free & running & same).implies(!unit.outputs.hold),
    );
}

fn covers<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>, cast: &Cast<'b>) {
    let (inputs, window) = (&unit.inputs, unit.window);
    let leaves = unit.outputs.word.valid & inputs.word_ready;
    let reversed = proof.reg_reset("reversed", 1, 0);
    let later = inputs.answers.valid & inputs.answers.payload.tag.equals(3);
    reversed.next(reversed.q | (later & cast.open.low(3).all()));
    let follows = window.offset.q.any();
    proof.cover(
        "a word leaves whose last packet was answered first, in a later cast",
        leaves & reversed.q & cast.moved.equals(4) & follows,
    );
    proof.cover(
        "a packet waits because the window is full",
        unit.outputs.running & unit.outputs.hold & !window.sweeping.q,
    );
    proof.cover(
        "a word is refused while the next packet is answered",
        unit.outputs.word.valid & !inputs.word_ready & cast.is_answered(cast.moved),
    );
}

fn faults<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (window, words, outputs) = (unit.window, unit.words, unit.outputs);
    let (first, inputs) = (window.first.q, &unit.inputs);
    let slot = words.slot.expect("a word has several packets").q;
    let answered = window.first_is_answered;
    for (what, fault) in [
        (
            "a word is used that was being written when it was read",
            answered.reads(window.was_written.q).as_value(0),
        ),
        (
            "answers of the pass before are taken",
            answered.reads(first).as_signal(window.answered_packet),
        ),
        (
            "the sweep begins anywhere and ends at any time",
            window.sweeping.q.without_reset(),
        ),
        (
            "the sweep stops while no answers come",
            (window.swept.q.enable()).as_signal(inputs.answers.valid),
        ),
        (
            "the sweep writes words of this pass",
            window.pass.reads(window.sweeping.q).as_value(0),
        ),
        (
            "a packet starts beyond the window",
            outputs.hold.reads(window.distance).as_value(0),
        ),
        (
            "a packet starts during the sweep",
            outputs.hold.reads(window.sweeping.q).as_value(0),
        ),
        (
            "a packet is held by its number in place of its distance",
            outputs.hold.reads(window.distance).as_signal(first),
        ),
        (
            "the packets of a cast are numbered as those of the first",
            window.offset.q.enable().as_value(0),
        ),
        (
            "answers are stored in the order in which they come",
            (window.memory.write_address()).as_signal(window.read_place),
        ),
        (
            "an answer is inverted in the memory",
            window.memory.write_data().with_flipped(1),
        ),
        (
            "the first packet stays as it is",
            (first.reads(window.moves.get())).as_value(0),
        ),
        (
            "the word of the first packet is always read again",
            window.was_written.q.fault().as_value(1),
        ),
        (
            "a cast begins in the middle of a word",
            slot.reads(inputs.start).as_value(0),
        ),
        (
            "the last packets of a cast make no word",
            words.valid.q.reads(words.left.q).as_value(2),
        ),
        (
            "a word has answers of the word before",
            words.word.q.reads(slot).as_value(1),
        ),
        (
            "a word that waits is overwritten",
            words.free.fault().as_value(1),
        ),
        (
            "words are numbered on from cast to cast",
            words.number.q.reads(inputs.start).as_value(0),
        ),
        (
            "a word is offered twice",
            words.valid.q.reads(inputs.word_ready).as_value(0),
        ),
        (
            "a packet is not counted while a word leaves",
            (words.left.q.enable()).as_signal(inputs.start),
        ),
        (
            "idle is shown before the last word is accepted",
            outputs.running.reads(words.valid.q).as_value(0),
        ),
    ] {
        proof.fault(what, fault);
    }
}
