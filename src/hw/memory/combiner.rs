//! The write combiner: merges writes of 16-byte words in open lines of 64 bytes, and writes each line as one burst.
//!
//! ```text
//! words ─► stage ─┬─► line state: tag, open, waiting, leaving; words touched, words full; order
//!                 └─► strobes, data (RAM) ────────────────────────────────┐
//! oldest waiting line ─► next burst (address, beats) ─► stream (place) ──┴─► data of the burst
//! ```
//!
//! A line is *open* from its first word on, *waiting* from its closing until it is the next burst, and *leaving* until its last datum has
//! been taken. The order of two lines is one bit, so the oldest open and the oldest waiting line follow from few gates. A line becomes
//! the newest when it is opened and again when it is closed, so one set of bits orders both kinds.
//!
//! A word's address is compared with all tags when it enters the stage, and it acts one cycle later. Only the word in the stage can
//! change a tag in that cycle, so the new word is compared with its address as well.

mod order;
mod properties;

use super::{ADDRESS_BITS, BEATS_BITS, WriteBeat, WriteBurst, kept};
use crate::hdl::prefetch::Occupancy;
use crate::hdl::{
    Builder, Flow, HdlError, Memory, Module, Reg, Signal, Specs, Style, Wire, bits_for,
};
use crate::{bundle, interface};
use order::Order;
use std::sync::Arc;

/// Bytes and bits of a word.
pub const WORD_BYTES: u32 = 16;
pub const WORD_BITS: u32 = 8 * WORD_BYTES;
/// Bytes and words of a line.
pub const LINE_BYTES: u32 = 64;
pub const LINE_WORDS: u32 = LINE_BYTES / WORD_BYTES;

/// Bits of an offset in a word, and in a line.
const WORD_OFFSET: u32 = WORD_BYTES.ilog2();
const LINE_OFFSET: u32 = LINE_BYTES.ilog2();
const TAG_BITS: u32 = ADDRESS_BITS - LINE_OFFSET;
/// Bits of the number of a word in its line.
const PLACE_BITS: u32 = LINE_OFFSET - WORD_OFFSET;

/// The parameters of a combiner.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    /// Bits of data on the bus: 32, 64, 128 or 256.
    pub data_bits: u32,
    /// Lines, at least 2.
    pub lines: u32,
    /// The greatest number of bursts without a response.
    pub writes: u32,
}

impl Sizes {
    fn line_bits(&self) -> u32 {
        bits_for(u64::from(self.lines))
    }

    /// Bytes of a row of the memory for data: a word, or a beat if that is wider.
    fn row_bytes(&self) -> u32 {
        WORD_BYTES.max(self.data_bits / 8)
    }

    /// Words of a row.
    fn row_words(&self) -> u32 {
        self.row_bytes() / WORD_BYTES
    }

    fn rows(&self) -> u32 {
        self.lines * LINE_BYTES / self.row_bytes()
    }

    /// Beats of a row.
    fn row_beats(&self) -> u32 {
        8 * self.row_bytes() / self.data_bits
    }

    /// Bits of the number of a beat in its line.
    fn beat_bits(&self) -> u32 {
        (8 * LINE_BYTES / self.data_bits).ilog2()
    }
}

bundle! {
    /// A word to write.
    pub struct Word() {
        /// Its byte address, a multiple of 16.
        address: ADDRESS_BITS,
        data: WORD_BITS,
        /// One bit for each byte that is to be written.
        strobes: WORD_BYTES,
    }
}

interface! {
    pub (sizes: &Sizes) {
        in "Words to write" { word: Flow<Word>() }
        out "Words to write" { word_ready: 1 }
        in "While it is high, no word is accepted and all lines are closed" { flush: 1 }
        out "Bursts" { write: Flow<WriteBurst>() }
        in "Bursts" { write_ready: 1 }
        out "Data of the bursts, in order" { datum: Flow<WriteBeat>(sizes.data_bits) }
        in "Data of the bursts, in order" { datum_ready: 1 }
        in "High for one cycle when a burst has its response" { written: 1 }
        out "High if no accepted word is on its way to memory" { empty: 1 }
    }
}

/// Describes a write combiner.
///
/// # Errors
/// None for at least two lines.
pub fn module(sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "write_combiner",
        "the write combiner: merges writes of words in open lines, and writes each line as one burst.",
    );
    let ports = ports(sizes);
    let inputs = ports.inputs.inputs(&m);
    let lines = Lines::new(&m, sizes);
    let stage = Stage::new(&m, &inputs, &lines);
    let contents = Contents::new(&m, sizes, &lines, &stage);
    let next = m.part(
        "next",
        "selects the closed line that is sent next, and offers its burst.",
        || Next::new(&m, sizes, &lines, inputs.write_ready),
    );
    let stream = Stream::new(&m, sizes, &next, inputs.datum_ready);
    let closing = lines.follow(&m, &inputs, &stage, &contents, &next, &stream);

    m.comment("Bursts without a response; nothing is left if there is none and no line is in use.");
    let outstanding = Occupancy::new(
        false,
        &m,
        "outstanding",
        sizes.writes,
        next.sent,
        inputs.written,
    );
    let in_use = m.or_all(&lines.used()).named("any_line_used");
    let outputs = Outputs {
        word_ready: stage.ready,
        write: next.write,
        datum: Flow::new(stream.valid.q, contents.beat(&m, sizes, &stream)),
        empty: !(stage.valid.q | in_use | outstanding.any),
    };
    ports.outputs.outputs(&m, outputs);
    properties::keeps(&properties::Unit {
        m: &m,
        sizes,
        inputs,
        outputs,
        lines: &lines,
        stage: &stage,
        contents: &contents,
        next: &next,
        stream: &stream,
        outstanding: &outstanding,
        closes: &closing.closes,
        close_oldest: closing.oldest,
    });
    m.finish()
}

/// The number of the bit that is set; 0 for none.
fn index<'b>(bits: &[Signal<'b>], width: u32) -> Signal<'b> {
    let m = bits[0].module();
    let of_bit = |place: u32| {
        let set = (0..bits.len()).filter(|i| i >> place & 1 != 0);
        let set: Vec<_> = set.map(|i| bits[i]).collect();
        match set.is_empty() {
            true => m.zero(1),
            false => m.or_all(&set),
        }
    };
    let all: Vec<_> = (0..width).rev().map(of_bit).collect();
    m.concat(&all)
}

/// The value that belongs to the bit that is set; 0 for none.
fn chosen<'b>(name: &str, bits: &[Signal<'b>], values: &[Signal<'b>]) -> Signal<'b> {
    let m = bits[0].module();
    let all = bits.iter().zip(values);
    let all: Vec<_> = all
        .map(|(bit, value)| bit.repeat(value.width()) & *value)
        .collect();
    m.or_all(&all).hinted(name)
}

/// A bit for each word of a line, of which the one at `place` is set.
fn one_of_line(place: Signal<'_>) -> Signal<'_> {
    place.module().lit(1u8, LINE_WORDS).shl(place)
}

/// The state of the lines.
struct Lines<'b> {
    tags: Vec<Reg<'b>>,
    open: Vec<Reg<'b>>,
    waiting: Vec<Reg<'b>>,
    leaving: Vec<Reg<'b>>,
    /// The words with any strobe set, and those with all.
    touched: Vec<Reg<'b>>,
    full: Vec<Reg<'b>>,
    order: Order<'b>,
}

impl<'b> Lines<'b> {
    fn new(m: &'b Builder, sizes: &Sizes) -> Lines<'b> {
        m.comment("The state of the lines.");
        let each = |name: &str, width: u32| -> Vec<Reg<'b>> {
            (0..sizes.lines)
                .map(|line| m.reg(format!("{name}{line}"), width))
                .collect()
        };
        let flags = |name: &str| -> Vec<Reg<'b>> {
            (0..sizes.lines)
                .map(|line| m.reg_reset(format!("{name}{line}"), 1, 0))
                .collect()
        };
        Lines {
            tags: each("tag", TAG_BITS),
            open: flags("open"),
            waiting: flags("waiting"),
            leaving: flags("leaving"),
            touched: each("touched", LINE_WORDS),
            full: each("full", LINE_WORDS),
            order: Order::new(m, sizes.lines as usize),
        }
    }

    fn count(&self) -> usize {
        self.tags.len()
    }

    /// Whether each line is in use.
    fn used(&self) -> Vec<Signal<'b>> {
        (0..self.count())
            .map(|i| {
                let used = self.open[i].q | self.waiting[i].q | self.leaving[i].q;
                used.hinted(format!("used{i}"))
            })
            .collect()
    }

    /// Drives the state.
    fn follow(
        &self,
        m: &'b Builder,
        inputs: &Inputs<Signal<'b>>,
        stage: &Stage<'b>,
        contents: &Contents<'b>,
        next: &Next<'b>,
        stream: &Stream<'b>,
    ) -> Closing<'b> {
        m.comment("A line is closed if it is full. The oldest one is closed if all are open, unless a word goes into it or fills another, or by a flush.");
        let open = self.open.iter().map(|reg| reg.q).collect::<Vec<_>>();
        let oldest: Vec<_> = (0..self.count())
            .map(|i| {
                let oldest = self.order.is_oldest("open", i, &open);
                oldest.named(format!("open{i}_is_oldest"))
            })
            .collect();
        let written: Vec<_> = (0..self.count())
            .map(|i| {
                let keeps = stage.hits[i] & (oldest[i] | contents.line_full);
                keeps.named(format!("keeps{i}"))
            })
            .collect();
        let stays = (stage.valid.q & m.or_all(&written)).named("oldest_stays");
        let needed = m.and_all(&open) & !stays;
        let flushes = inputs.flush & !stage.valid.q;
        let close_oldest = (needed | flushes).named("close_oldest");
        let (mut newest, mut all) = (vec![], vec![]);
        for (i, &oldest) in oldest.iter().enumerate() {
            let fills = stage.hits[i] & stage.valid.q & contents.line_full;
            let closes = (fills | (close_oldest & oldest)).named(format!("close{i}"));
            let opens = stage.opens[i];
            let takes = next.takes[i];
            let frees =
                (stream.finishes & stream.line.equals(i as u128)).hinted(format!("free{i}"));
            self.open[i].next(opens | (self.open[i].q & !closes));
            self.waiting[i].next(closes | (self.waiting[i].q & !takes));
            self.leaving[i].next(takes | (self.leaving[i].q & !frees));
            self.tags[i].next_when(opens, stage.tag());
            let (writes, hit) = (stage.writes[i], stage.hits[i].repeat(LINE_WORDS));
            self.touched[i].next_when(writes, (self.touched[i].q & hit) | stage.word_bit);
            self.full[i].next_when(writes, (self.full[i].q & hit) | contents.now_full);
            all.push(closes);
            newest.push((opens | closes).hinted(format!("newest{i}")));
        }
        self.order.drive(&newest);
        Closing {
            closes: all,
            oldest: close_oldest,
        }
    }
}

/// The lines that are closed.
struct Closing<'b> {
    closes: Vec<Signal<'b>>,
    /// The oldest one is, for want of room or by a flush.
    oldest: Signal<'b>,
}

/// The word that acts on the lines.
struct Stage<'b> {
    valid: Reg<'b>,
    word: Word<Signal<'b>>,
    ready: Signal<'b>,
    /// Its address is that of an open line, for each line and for any; it writes into a line; it opens a line.
    matches: Vec<Reg<'b>>,
    hits: Vec<Signal<'b>>,
    any_hit: Signal<'b>,
    writes: Vec<Signal<'b>>,
    opens: Vec<Signal<'b>>,
    /// Its place in its line, as a number and as a bit.
    place: Signal<'b>,
    word_bit: Signal<'b>,
    /// It writes into a line, and leaves the stage.
    acts: Signal<'b>,
}

impl<'b> Stage<'b> {
    fn new(m: &'b Builder, inputs: &Inputs<Signal<'b>>, lines: &Lines<'b>) -> Stage<'b> {
        m.comment("A word waits in the stage for the comparison of its address, and until there is a line for it. A word without a strobe is dropped.");
        let valid = m.reg_reset("stage_valid", 1, 0);
        let goes = m.wire("stage_goes", 1);
        let ready = ((!valid.q | goes.get()) & !inputs.flush).named("stage_room");
        let accept = (inputs.word.valid & ready).named("accept");
        let new = inputs.word.payload;
        let word = kept("stage", &Word::of(), accept, new);
        valid.next((accept & new.strobes.any()) | (valid.q & !goes.get()));
        let tag = word.address.part("tag", LINE_OFFSET, TAG_BITS);
        let new_tag = new.address.part("tag", LINE_OFFSET, TAG_BITS);
        let same = new_tag.eq(tag).named("same_line");

        let used = lines.used();
        let mut below = vec![m.lit(1u8, 1)];
        for (i, used) in used.iter().enumerate() {
            below.push((below[i] & *used).hinted(format!("all_used_to{i}")));
        }
        let free = (!below[lines.count()]).named("any_line_free");
        let matches: Vec<_> = (0..lines.count())
            .map(|i| m.reg(format!("match{i}"), 1))
            .collect();
        let hits: Vec<_> = (0..lines.count())
            .map(|i| (matches[i].q & lines.open[i].q).named(format!("hit{i}")))
            .collect();
        let any_hit = m.or_all(&hits).named("any_hit");
        goes.drive(any_hit | free);
        let fresh = (valid.q & !any_hit).named("needs_line");
        let (mut opens, mut writes) = (vec![], vec![]);
        for i in 0..lines.count() {
            let open = (fresh & !used[i] & below[i]).named(format!("opens{i}"));
            let is_same = new_tag.eq(lines.tags[i].q).hinted(format!("same_as{i}"));
            matches[i].next_when(accept, open.mux(same, is_same));
            let hits = (hits[i] & valid.q).hinted(format!("hits{i}"));
            writes.push((hits | open).hinted(format!("writes{i}")));
            opens.push(open);
        }
        let place = word.address.part("place", WORD_OFFSET, PLACE_BITS);
        Stage {
            valid,
            word,
            ready,
            matches,
            hits,
            any_hit,
            writes,
            opens,
            place,
            word_bit: one_of_line(place).named("word_bit"),
            acts: (valid.q & goes.get()).named("stage_acts"),
        }
    }

    fn tag(&self) -> Signal<'b> {
        self.word.address.part("tag", LINE_OFFSET, TAG_BITS)
    }
}

/// The data of the lines and their strobes.
struct Contents<'b> {
    /// One memory for each byte of a row.
    data: Vec<Memory<'b>>,
    /// One memory for each word of a row, and a copy that is read by the stream.
    strobes: Vec<Memory<'b>>,
    strobes_to_send: Vec<Memory<'b>>,
    /// The words of its line that the word in the stage fills; whether the line is full with them.
    now_full: Signal<'b>,
    line_full: Signal<'b>,
}

impl<'b> Contents<'b> {
    fn new(m: &'b Builder, sizes: &Sizes, lines: &Lines<'b>, stage: &Stage<'b>) -> Contents<'b> {
        m.comment("A byte is written if its strobe is set. Strobes are merged with those of the same word, if it has any.");
        let line = index(&stage.writes, sizes.line_bits()).named("line_to_write");
        let lane_bits = sizes.row_words().ilog2();
        let row = stage.place.high(PLACE_BITS - lane_bits);
        let row = line.concat(row).named("row_to_write");
        let of_lane = |lane: u32| match lane_bits {
            0 => stage.acts,
            _ => (stage.acts & stage.place.low(lane_bits).equals(lane.into()))
                .named(format!("writes_lane{lane}")),
        };
        let lanes: Vec<_> = (0..sizes.row_words()).map(of_lane).collect();
        let byte = |number: u32| {
            let memory = m.memory(format!("byte{number}"), sizes.rows(), 8, Style::Distributed);
            let (lane, place) = (number / WORD_BYTES, number % WORD_BYTES);
            let enable = lanes[lane as usize] & stage.word.strobes.bit(place);
            memory.write(enable, row, stage.word.data.field(8 * place, 8));
            memory
        };
        let data = (0..sizes.row_bytes()).map(byte).collect();
        let of_lanes = |name: &str| -> Vec<Memory<'b>> {
            (0..sizes.row_words())
                .map(|lane| {
                    let name = format!("{name}{lane}");
                    m.memory(name, sizes.rows(), WORD_BYTES, Style::Distributed)
                })
                .collect()
        };
        let (strobes, strobes_to_send) = (of_lanes("strobes"), of_lanes("strobes_to_send"));
        let stored: Vec<_> = strobes.iter().map(|memory| memory.read_now(row)).collect();
        let stored = match lane_bits {
            0 => stored[0],
            _ => m.select(stage.place.low(lane_bits), &stored),
        };
        let of = |name: &str, state: &[Reg<'b>]| {
            let state: Vec<_> = state.iter().map(|reg| reg.q).collect();
            chosen(name, &stage.hits, &state)
        };
        let touched = (of("line_touched", &lines.touched) & stage.word_bit)
            .any()
            .named("word_touched");
        let stored = stored.hinted("stored_strobes");
        let before = (touched.repeat(WORD_BYTES) & stored).hinted("strobes_before");
        let merged = (before | stage.word.strobes).named("merged_strobes");
        for (lane, writes) in lanes.iter().enumerate() {
            strobes[lane].write(*writes, row, merged);
            strobes_to_send[lane].write(*writes, row, merged);
        }
        let now_full = merged.all().repeat(LINE_WORDS) & stage.word_bit;
        let now_full = now_full.named("now_full");
        Contents {
            data,
            strobes,
            strobes_to_send,
            now_full,
            line_full: (of("words_full", &lines.full) | now_full)
                .hinted("words_full_now")
                .all()
                .named("line_full"),
        }
    }

    /// The datum that the stream offers.
    fn beat(&self, m: &'b Builder, sizes: &Sizes, stream: &Stream<'b>) -> WriteBeat<Signal<'b>> {
        m.comment(
            "The datum: a row, or a part of one. A word that was not touched has no strobes.",
        );
        let part_bits = sizes.row_beats().ilog2();
        let beat = stream.beat.q;
        let row = beat.high(sizes.beat_bits() - part_bits);
        let at = stream.line.concat(row).named("row_to_send");
        let bytes: Vec<_> = self
            .data
            .iter()
            .rev()
            .map(|byte| byte.read_now(at))
            .collect();
        let data = m.concat(&bytes).named("row_sent");
        let lanes = sizes.row_words();
        let strobes = (0..lanes).rev().map(|lane| {
            let strobes = self.strobes_to_send[lane as usize].read_now(at);
            let of_lane: Vec<_> = (0..LINE_WORDS / lanes)
                .map(|row| stream.touched.bit(row * lanes + lane))
                .collect();
            let touched = m
                .select(row, &of_lane)
                .hinted(format!("lane{lane}_touched"));
            (touched.repeat(WORD_BYTES) & strobes).hinted(format!("strobes_sent{lane}"))
        });
        let strobes = m.concat(&strobes.collect::<Vec<_>>()).named("row_strobes");
        let part = |name: &str, of: Signal<'b>| {
            let width = of.width() / sizes.row_beats();
            let parts: Vec<_> = (0..sizes.row_beats())
                .map(|part| of.field(part * width, width))
                .collect();
            match part_bits {
                0 => of,
                _ => m.select(beat.low(part_bits).hinted(name), &parts),
            }
        };
        WriteBeat {
            data: part("part_sent", data),
            strobes: part("part_sent", strobes),
        }
    }
}

/// The line whose burst is offered, and then waits for its turn to send its data.
struct Next<'b> {
    valid: Reg<'b>,
    /// Its address is yet to be accepted.
    unsent: Reg<'b>,
    line: Signal<'b>,
    tag: Signal<'b>,
    touched: Signal<'b>,
    /// Its first and its last beat in the line.
    first: Signal<'b>,
    last: Signal<'b>,
    write: Flow<WriteBurst<Signal<'b>>, Signal<'b>>,
    /// Its address is accepted.
    sent: Signal<'b>,
    /// Each line is taken as the next one.
    takes: Vec<Signal<'b>>,
    /// The stream takes it; the stream's answer.
    moves: Signal<'b>,
    stream_ready: Wire<'b>,
}

impl<'b> Next<'b> {
    fn new(m: &'b Builder, sizes: &Sizes, lines: &Lines<'b>, ready: Signal<'b>) -> Next<'b> {
        m.comment("The next burst: from the first to the last word that was touched in the oldest waiting line.");
        let valid = m.reg_reset("next_valid", 1, 0);
        let unsent = m.reg_reset("next_unsent", 1, 0);
        let stream_ready = m.wire("stream_ready", 1);
        let moves = (valid.q & !unsent.q & stream_ready.get()).named("next_moves");
        let loads = (!valid.q | moves).named("next_free");
        let waiting: Vec<_> = lines.waiting.iter().map(|reg| reg.q).collect();
        let takes: Vec<_> = (0..lines.count())
            .map(|i| {
                (loads & lines.order.is_oldest("waiting", i, &waiting)).named(format!("take{i}"))
            })
            .collect();
        let any = (loads & m.or_all(&waiting)).named("next_taken");
        let hold = |name: &str, value: Signal<'b>| {
            let register = m.reg(name, value.width());
            register.next_when(loads, value);
            register.q
        };
        let of = |name: &str, state: &[Reg<'b>]| {
            let state: Vec<_> = state.iter().map(|reg| reg.q).collect();
            chosen(name, &takes, &state)
        };
        let line = hold("next_line", index(&takes, sizes.line_bits()));
        let tag = hold("next_tag", of("oldest_tag", &lines.tags));
        let touched = hold("next_touched", of("oldest_touched", &lines.touched));
        valid.next(any | (valid.q & !moves));
        let write_valid = (valid.q & unsent.q).named("burst_offered");
        let sent = (write_valid & ready).named("burst_sent");
        unsent.next(any | (unsent.q & !sent));

        // A number of a beat from that of a word: several beats in a word, or the other way round.
        let beat = |word: Signal<'b>, lowest: bool| {
            let name = if lowest { "first_beat" } else { "last_beat" };
            match sizes.row_beats().ilog2() {
                0 if word.width() == sizes.beat_bits() => word,
                0 => word.high(sizes.beat_bits()).named(name),
                bits if lowest => word.concat(m.zero(bits)).hinted(name),
                bits => word.concat(m.ones(bits)).hinted(name),
            }
        };
        let number = |word: u32| m.lit(word, PLACE_BITS);
        let up: Vec<_> = (0..LINE_WORDS - 1)
            .map(|i| (touched.bit(i), number(i)))
            .collect();
        let down: Vec<_> = (1..LINE_WORDS)
            .rev()
            .map(|i| (touched.bit(i), number(i)))
            .collect();
        let first = m.priority(&up, number(LINE_WORDS - 1)).named("first_word");
        let last = m.priority(&down, number(0)).named("last_word");
        let [first, last] = [beat(first, true), beat(last, false)];
        let offset = first.concat(m.zero(LINE_OFFSET - sizes.beat_bits()));
        let burst = WriteBurst {
            address: tag.concat(offset),
            beats: (last - first)
                .hinted("beats_after_first")
                .extend(BEATS_BITS),
        };
        Next {
            valid,
            unsent,
            line,
            tag,
            touched,
            first,
            last,
            write: Flow::new(write_valid, burst),
            sent,
            takes,
            moves,
            stream_ready,
        }
    }
}

/// The line whose data are offered.
struct Stream<'b> {
    valid: Reg<'b>,
    line: Signal<'b>,
    touched: Signal<'b>,
    /// The beat that is offered, and the last one.
    beat: Reg<'b>,
    last: Signal<'b>,
    /// The last datum is taken.
    finishes: Signal<'b>,
}

impl<'b> Stream<'b> {
    fn new(m: &'b Builder, sizes: &Sizes, next: &Next<'b>, ready: Signal<'b>) -> Stream<'b> {
        m.comment(
            "The data of a burst, one after another. The line is free when the last one is taken.",
        );
        let valid = m.reg_reset("stream_valid", 1, 0);
        let beat = m.reg("stream_beat", sizes.beat_bits());
        let hold = |name: &str, value: Signal<'b>| {
            let register = m.reg(name, value.width());
            register.next_when(next.moves, value);
            register.q
        };
        let line = hold("stream_line", next.line);
        let touched = hold("stream_touched", next.touched);
        let last = hold("stream_last", next.last);
        let takes = (valid.q & ready).named("datum_taken");
        let finishes = (takes & beat.q.eq(last)).named("stream_finishes");
        next.stream_ready.drive(!valid.q | finishes);
        valid.next(next.moves | (valid.q & !finishes));
        let one = m.lit(1u8, sizes.beat_bits());
        beat.next_when(next.moves | takes, next.moves.mux(next.first, beat.q + one));
        Stream {
            valid,
            line,
            touched,
            beat,
            last,
            finishes,
        }
    }
}
