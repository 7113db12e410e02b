//! Properties of the write combiner: an address has at most one open line; a byte stays as it was last written until its line is sent, as
//! part of that line's burst; lines are sent in the order in which they were closed; no deadlock.
//!
//! The proof watches one byte of memory: an arbitrary line and an arbitrary place in it. Of each line of the combiner that holds this
//! memory it knows whether the byte is to be written, and its value.

use super::{Contents, Inputs, Lines, Next, Outputs, PLACE_BITS, Sizes, Stage, Stream};
use super::{TAG_BITS, WORD_BYTES};
use crate::hdl::prefetch::Occupancy;
use crate::hdl::properties::{assert_shown_stays, count};
use crate::hdl::{Builder, Bundle, Proof, Signal, bits_for};

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub sizes: &'a Sizes,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub lines: &'a Lines<'b>,
    pub stage: &'a Stage<'b>,
    pub contents: &'a Contents<'b>,
    pub next: &'a Next<'b>,
    pub stream: &'a Stream<'b>,
    pub outstanding: &'a Occupancy<'b>,
    /// Each line is closed; the oldest one is.
    pub closes: &'a [Signal<'b>],
    pub close_oldest: Signal<'b>,
}

impl<'b> Unit<'_, 'b> {
    fn count(&self) -> usize {
        self.lines.count()
    }

    /// Whether a line is the next one, or is being sent.
    fn is_next(&self, line: usize) -> Signal<'b> {
        self.next.valid.q & self.next.line.equals(line as u128)
    }

    fn is_sent(&self, line: usize) -> Signal<'b> {
        self.stream.valid.q & self.stream.line.equals(line as u128)
    }
}

fn at_most_one<'b>(bits: &[Signal<'b>]) -> Signal<'b> {
    let m = bits[0].module();
    let width = bits_for(bits.len() as u64 + 1);
    m.concat(bits).count_ones(width).le(m.lit(1u8, width))
}

pub(super) fn keeps(unit: &Unit<'_, '_>) {
    let (m, inputs, outputs) = (unit.m, &unit.inputs, &unit.outputs);
    let proof = &m.proof(
        "keeps",
        "a byte is kept as last written until its line is sent; lines are sent in the order of their closing; no deadlock",
    );
    let width = unit.outstanding.count.width();
    let sent = count(proof, width, "sent", unit.next.sent, inputs.written);
    proof.assert(
        "bursts without a response are counted",
        unit.outstanding.count.eq(sent),
    );
    proof.assume(
        "a response comes for a burst that was sent",
        inputs.written.implies(sent.any()),
    );
    proof.assume(
        "a burst is accepted only while fewer are outstanding than the bound",
        inputs
            .write_ready
            .implies(sent.lt(m.lit(unit.sizes.writes, width))),
    );
    assert_shown_stays(
        proof,
        "burst",
        outputs.write.valid,
        inputs.write_ready,
        &outputs.write.payload.leaves(),
    );
    proof.assert(
        "a datum is offered until it is accepted",
        proof
            .past(!m.reset() & outputs.datum.valid & !inputs.datum_ready)
            .implies(outputs.datum.valid),
    );
    proof.assert(
        "no word is accepted during a flush",
        inputs.flush.implies(!outputs.word_ready),
    );
    let taken = outputs.datum.valid & inputs.datum_ready;
    let beat = unit.stream.beat.q;
    let next = beat.eq(proof.past(beat) + proof.past(taken).extend(beat.width()));
    proof.assert(
        "the beats of a burst follow each other",
        proof
            .past(!m.reset() & unit.stream.valid.q & !unit.stream.finishes)
            .implies(unit.stream.valid.q & next),
    );
    states(proof, unit);
    byte(proof, unit);
    progress(proof, unit);
    faults(proof, unit);
}

/// The state of each line, and what the stage knows of them.
fn states<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (m, lines, stage) = (unit.m, unit.lines, unit.stage);
    let used_lines = lines.used();
    for i in 0..unit.count() {
        let (open, waiting, leaving) = (lines.open[i].q, lines.waiting[i].q, lines.leaving[i].q);
        proof.assert(
            format!("line {i} is in one state"),
            at_most_one(&[open, waiting, leaving]),
        );
        proof.assert(
            format!("line {i} leaves if it is the next one or is being sent"),
            leaving.eq(unit.is_next(i) | unit.is_sent(i)),
        );
        proof.assert(
            format!("line {i} is not both the next one and being sent"),
            !(unit.is_next(i) & unit.is_sent(i)),
        );
        proof.assert(
            format!("the next line has the address and the words of line {i}"),
            unit.is_next(i).implies(
                unit.next.tag.eq(lines.tags[i].q) & unit.next.touched.eq(lines.touched[i].q),
            ),
        );
        proof.assert(
            format!("the line that is sent has the words of line {i}"),
            unit.is_sent(i)
                .implies(unit.stream.touched.eq(lines.touched[i].q)),
        );
        let used = open | waiting | leaving;
        proof.assert(
            format!("line {i} has a word"),
            used.implies(lines.touched[i].q.any()),
        );
        proof.assert(
            format!("full words of line {i} are touched"),
            used.implies((lines.full[i].q & !lines.touched[i].q).is_zero()),
        );
        proof.assert(
            format!("open line {i} is not full"),
            !(open & lines.full[i].q.all()),
        );
        proof.assert(
            format!("the stage knows whether its address is that of line {i}"),
            (stage.valid.q & open).implies(stage.matches[i].q.eq(stage.tag().eq(lines.tags[i].q))),
        );
        for other in 0..i {
            let same = lines.tags[i].q.eq(lines.tags[other].q);
            proof.assert(
                format!("lines {other} and {i} are not both open for an address"),
                !(open & lines.open[other].q & same),
            );
            // Which of the two was opened last.
            let newer = proof.reg_reset(&format!("newer{other}_{i}"), 1, 0);
            let opens = (stage.opens[i], stage.opens[other]);
            newer.next_when(opens.0 | opens.1, opens.0);
            proof.assert(
                format!("it is known which of the open lines {other} and {i} is older"),
                (open & lines.open[other].q).implies(lines.order.before(other, i).eq(newer.q)),
            );
            for third in 0..unit.count() {
                if third != i && third != other {
                    let before = |a, b| lines.order.before(a, b);
                    let cycle = before(other, i) & before(i, third) & before(third, other);
                    let back = before(i, other) & before(other, third) & before(third, i);
                    let used = m.and_all(&[i, other, third].map(|line| used_lines[line]));
                    proof.assert(
                        "the order of lines in use has no cycle",
                        !(used & (cycle | back)),
                    );
                }
            }
        }
    }
    let line = m.lit(unit.sizes.lines, unit.sizes.line_bits() + 1);
    let is_line = |line_bits: Signal<'b>| line_bits.extend(line.width()).lt(line);
    proof.assert(
        "the next line and the line that is sent are lines",
        (unit.next.valid.q.implies(is_line(unit.next.line)))
            & (unit.stream.valid.q.implies(is_line(unit.stream.line))),
    );
    proof.assert(
        "a burst is sent by the line whose address is accepted",
        unit.next.unsent.q.implies(unit.next.valid.q),
    );
    proof.assert(
        "the beat that is offered is one of the burst",
        unit.stream
            .valid
            .q
            .implies(unit.stream.beat.q.le(unit.stream.last)),
    );
    proof.assert(
        "a word is written into one line",
        at_most_one(&stage.writes),
    );
    let any_used = m.or_all(&used_lines);
    proof.assert(
        "it is empty only without lines and responses",
        !(unit.outputs.empty & (any_used | stage.valid.q | unit.outstanding.count.any())),
    );
}

/// The byte that is watched.
struct Watched<'b> {
    tag: Signal<'b>,
    /// The number of its word in its line.
    place: Signal<'b>,
}

/// Its place in its word: the description is the same for all.
const BYTE: u32 = WORD_BYTES / 2;

impl<'b> Watched<'b> {
    /// The number of its lane in a row of several words, and what a lane has.
    fn of_lane(&self, unit: &Unit<'_, 'b>, of: &dyn Fn(u32) -> Signal<'b>) -> Signal<'b> {
        match unit.sizes.row_words().ilog2() {
            0 => of(0),
            bits => {
                let all: Vec<_> = (0..1 << bits).map(of).collect();
                unit.m.select(self.place.low(bits), &all)
            }
        }
    }

    fn row(&self, unit: &Unit<'_, 'b>) -> Signal<'b> {
        self.place.high(PLACE_BITS - unit.sizes.row_words().ilog2())
    }

    /// The number of its beat in its line.
    fn beat(&self, unit: &Unit<'_, 'b>) -> Signal<'b> {
        match unit.sizes.row_beats().ilog2() {
            0 => self.row(unit),
            bits => {
                let part = 8 * BYTE / unit.sizes.data_bits;
                self.place.concat(unit.m.lit(part, bits))
            }
        }
    }
}

/// One byte of memory in each line that holds it.
fn byte<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (m, lines, stage, sizes) = (unit.m, unit.lines, unit.stage, unit.sizes);
    let watched = Watched {
        tag: proof.any_const("tag", TAG_BITS),
        place: proof.any_const("place", PLACE_BITS),
    };
    let is_here = stage.tag().eq(watched.tag) & stage.place.eq(watched.place);
    let here = stage.acts & is_here & stage.word.strobes.bit(BYTE);
    let value = stage.word.data.field(8 * BYTE, 8);
    // The line that the byte was written into last.
    let newest = proof.reg("newest", sizes.line_bits());
    newest.next_when(here, super::index(&stage.writes, sizes.line_bits()));
    let its_beat = watched.beat(unit);
    let datum = unit.outputs.datum.payload;
    let offset = BYTE % (sizes.data_bits / 8);
    let of_bus = |lane: u32| datum.data.field(8 * (lane * WORD_BYTES + offset), 8);
    let data_sent = watched.of_lane(unit, &of_bus);
    let of_bus = |lane: u32| datum.strobes.bit(lane * WORD_BYTES + offset);
    let strobe_sent = watched.of_lane(unit, &of_bus);
    let mut held = vec![];
    for i in 0..unit.count() {
        let has = proof.reg_reset(&format!("has{i}"), 1, 0);
        let last = proof.reg(&format!("value{i}"), 8);
        let now = here & stage.writes[i];
        let frees = unit.stream.finishes & unit.stream.line.equals(i as u128);
        has.next(now | (has.q & !stage.opens[i] & !frees));
        last.next_when(now, value);
        held.push(has.q);

        let at = m.lit(i as u32, sizes.line_bits()).concat(watched.row(unit));
        let of = |lane: u32| unit.contents.strobes[lane as usize].peek(at);
        let strobes = watched.of_lane(unit, &of);
        let of = |lane: u32| unit.contents.strobes_to_send[lane as usize].peek(at);
        let to_send = watched.of_lane(unit, &of);
        let of = |lane: u32| unit.contents.data[(lane * WORD_BYTES + BYTE) as usize].peek(at);
        let data = watched.of_lane(unit, &of);
        let touched = lines.touched[i].q.bit_at(watched.place);
        let used = lines.open[i].q | lines.waiting[i].q | lines.leaving[i].q;
        let of_tag = used & lines.tags[i].q.eq(watched.tag);
        proof.assert(
            format!("line {i} has the byte if it was written, as it was written last"),
            of_tag.implies((touched & strobes.bit(BYTE)).eq(has.q))
                & has.q.implies(of_tag & data.eq(last.q)),
        );
        proof.assert(
            format!("both copies of the strobes of line {i} agree"),
            (of_tag & touched).implies(strobes.eq(to_send)),
        );
        proof.assert(
            format!("a full word of line {i} has all its strobes"),
            (of_tag & lines.full[i].q.bit_at(watched.place)).implies(touched & strobes.all()),
        );
        let sending = unit.is_sent(i) & of_tag & unit.stream.beat.q.eq(its_beat);
        proof.assert(
            format!("the byte of line {i} is sent in its beat, and no other"),
            sending.implies(strobe_sent.eq(has.q) & has.q.implies(data_sent.eq(last.q))),
        );
        let is_in_burst = its_beat.le(unit.stream.last);
        proof.assert(
            format!("the byte of line {i} is in the burst"),
            (unit.is_sent(i) & has.q).implies(is_in_burst),
        );
        let offered = unit.outputs.write.payload;
        let beats = (unit.next.last - unit.next.first).extend(offered.beats.width());
        let address = unit.next.tag.concat(unit.next.first);
        let offset = offered.address.width() - address.width();
        let is_of_next = offered.address.high(address.width()).eq(address)
            & offered.address.low(offset).is_zero()
            & offered.beats.eq(beats);
        proof.assert(
            format!("the byte of line {i} is in the burst that is offered"),
            (unit.is_next(i) & has.q)
                .implies(unit.next.first.le(its_beat) & its_beat.le(unit.next.last) & is_of_next),
        );
        proof.assert(
            format!("the data of line {i} begin no later than with the byte"),
            (proof.past(!m.reset() & unit.next.moves) & unit.is_sent(i) & has.q)
                .implies(unit.stream.beat.q.le(its_beat)),
        );
        if i == 0 {
            proof.cover("the byte is sent", sending & has.q);
        }
    }
    // Lines with the byte leave in the order in which it was written into them.
    for i in 0..unit.count() {
        for other in (0..unit.count()).filter(|other| *other != i) {
            let both = held[i] & held[other] & newest.q.equals(i as u128);
            let before = lines.waiting[other].q & lines.order.before(other, i);
            let ahead = lines.open[i].q
                | (lines.waiting[i].q & (before | lines.leaving[other].q))
                | (unit.is_next(i) & unit.is_sent(other));
            proof.assert(
                format!("line {other} leaves before line {i}, which has the newer byte"),
                both.implies(!lines.open[other].q & ahead),
            );
        }
    }
}

/// A word in the stage goes on, or a line is on its way.
fn progress<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (m, lines) = (unit.m, unit.lines);
    let all = |state: &[crate::hdl::Reg<'b>]| {
        let bits: Vec<_> = state.iter().map(|reg| reg.q).collect();
        m.or_all(&bits)
    };
    let moving = all(&lines.waiting) | all(&lines.leaving);
    let open: Vec<_> = lines.open.iter().map(|reg| reg.q).collect();
    proof.assert(
        "a word in the stage goes on, closes a line, or waits for one that leaves",
        unit.stage
            .valid
            .q
            .implies(unit.stage.acts | moving | m.and_all(&open)),
    );
    proof.assert(
        "a waiting line is taken when there is no next one",
        (all(&lines.waiting) & !unit.next.valid.q).implies(m.or_all(&unit.next.takes)),
    );
    proof.assert(
        "the next line waits for the bus or for the line before it",
        unit.next
            .valid
            .q
            .implies(unit.outputs.write.valid | unit.next.moves | unit.stream.valid.q),
    );
    proof.assert(
        "the oldest line is closed if all are open, unless a word goes into an open one",
        (m.and_all(&open) & !(unit.stage.valid.q & unit.stage.any_hit))
            .implies(m.or_all(unit.closes)),
    );
    proof.assert("at most one line is closed", at_most_one(unit.closes));
}

fn faults<'b>(proof: &Proof<'b>, unit: &Unit<'_, 'b>) {
    let (lines, stage, contents) = (unit.lines, unit.stage, unit.contents);
    let (next, stream) = (unit.next, unit.stream);
    for (what, fault) in [
        (
            "the address of a new line is not compared with the next word",
            stage.matches[0].q.reads(stage.opens[0]).as_value(0),
        ),
        (
            "words of an earlier line are kept in a new one",
            lines.touched[0]
                .q
                .reads(stage.hits[0].repeat(super::LINE_WORDS))
                .as_value(15),
        ),
        (
            "strobes of a word replace earlier ones",
            contents.strobes[0]
                .write_data()
                .as_signal(stage.word.strobes),
        ),
        (
            "a byte is written without its strobe",
            contents.data[BYTE as usize]
                .write_enable()
                .as_signal(stage.acts),
        ),
        (
            "a line is closed and stays open",
            lines.open[0].q.reads(unit.closes[0]).as_value(0),
        ),
        (
            "a line is free before its last datum is taken",
            lines.leaving[1]
                .q
                .reads(unit.stream.finishes)
                .as_signal(unit.stream.valid.q),
        ),
        (
            "responses are not waited for",
            unit.outstanding.count.enable().as_value(0),
        ),
        (
            "a word waits for a line without closing one",
            unit.lines.open[0].q.reads(unit.close_oldest).as_value(0),
        ),
        (
            "the data of a burst are sent before its address",
            next.moves.reads(next.unsent.q).as_value(0),
        ),
        (
            "a burst that is refused is withdrawn",
            next.unsent.q.reads(next.sent).as_signal(next.write.valid),
        ),
        (
            "a line is taken while the next burst waits",
            next.takes[0].reads(next.valid.q).as_value(0),
        ),
        (
            "a waiting line is never taken",
            next.takes[0].fault().as_value(0),
        ),
        (
            "a burst has the address of another line",
            next.tag.reads(lines.tags[0].q).as_signal(lines.tags[1].q),
        ),
        (
            "a burst begins with its last beat",
            next.first.fault().as_signal(next.last),
        ),
        (
            "the data of a burst begin with its last beat",
            stream.beat.q.reads(next.first).as_signal(next.last),
        ),
        (
            "a datum is skipped while it is refused",
            stream.beat.q.enable().as_value(1),
        ),
        (
            "a burst ends while its last datum is refused",
            (stream.finishes.reads(unit.inputs.datum_ready)).as_value(1),
        ),
        (
            "the data of a burst have the words of the one before",
            stream.touched.enable().as_value(0),
        ),
        (
            "a full line stays open",
            unit.closes[0].reads(contents.line_full).as_value(0),
        ),
        (
            "the order of lines is not kept",
            lines.order.before(0, 1).enable().as_value(0),
        ),
        (
            "a word opens two lines",
            stage.opens[1].fault().as_signal(stage.opens[0]),
        ),
        (
            "two lines are closed at once",
            (unit.closes[1].reads(lines.order.before(0, 1))).as_value(0),
        ),
        (
            "a word is full when any of its bytes is written",
            contents.now_full.fault().as_signal(stage.word_bit),
        ),
        (
            "it is empty while a word is in the stage",
            unit.outputs.empty.reads(stage.valid.q).as_value(0),
        ),
        (
            "a word is accepted during a flush",
            unit.outputs.word_ready.reads(unit.inputs.flush).as_value(0),
        ),
    ] {
        proof.fault(what, fault);
    }
}
