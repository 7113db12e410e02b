//! The answer collector: puts the answers to any-hit rays, which come in any order, in words of 32 in the order of the rays.
//!
//! ```text
//! answers of a packet ─► memory, by the packet's number ─► the next packet in order ─► word
//! ```
//!
//! The memory is a window of the packets that follow the last one in a word. Each of its words tells in which pass over the memory it
//! was written, so a packet that has not finished is told from one of the pass before. Packets are numbered on from cast to cast.

mod properties;

use super::{COUNT_BITS, fitted};
use crate::hdl::{Builder, Flow, HdlError, Memory, Module, Reg, Signal, Specs, Style, Wire};
use crate::hw::plan::Plan;
use crate::{bundle, interface};
use std::sync::Arc;

/// Rays of a word of answers.
pub const RAYS_PER_WORD: u32 = 32;

bundle! {
    /// The answers to the rays of a packet.
    pub struct Answers(plan: &Plan) {
        tag: plan.config.tag_bits,
        /// A bit for each ray, the first in bit 0: whether it hits.
        bits: plan.rays(),
    }
}

bundle! {
    /// The answers to 32 rays.
    pub struct AnswerWord() {
        /// The number of the word in its cast.
        number: COUNT_BITS,
        bits: RAYS_PER_WORD,
    }
}

interface! {
    pub (plan: &Plan) {
        in "A cast of any-hit rays starts, with a number of packets; only while the unit is idle" { start: 1, packets: COUNT_BITS }
        in "Answers of a packet that was not held; always accepted" { answers: Flow<Answers>(plan) }
        in "The packet that the next ray belongs to" { packet: plan.config.tag_bits }
        in "Words of answers" { word_ready: 1 }
        out "High from the cycle after the start until the last word is accepted" { running: 1 }
        out "High while no further packet may start" { hold: 1 }
        out "Words of answers, in order" { word: Flow<AnswerWord>() }
    }
}

/// Packets of the window, a power of two: a packet may take much longer than those that follow it.
fn window(plan: &Plan) -> u32 {
    (16 * plan.packets()).next_power_of_two()
}

/// Describes the answer collector of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    of_window(plan, window(plan))
}

/// Describes an answer collector whose window has `depth` packets, a power of two.
///
/// # Errors
/// As [`module`].
pub fn of_window(plan: &Plan, depth: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "answer_collector",
        "puts the answers to any-hit rays in words of 32, in the order of the rays.\n\
         Packets finish in any order: a memory keeps their answers until those of all earlier packets are there.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let window = Window::new(&m, plan, depth, &inputs);
    let words = Words::new(&m, plan, &inputs, &window);
    let outputs = Outputs {
        running: words.left.q.any() | words.valid.q,
        hold: window.sweeping.q | window.distance.high(1),
        word: Flow::new(
            words.valid.q,
            AnswerWord {
                number: words.number.q,
                bits: words.word.q,
            },
        ),
    };
    ports.outputs.outputs(&m, outputs);
    properties::describe(&properties::Unit {
        m: &m,
        plan,
        inputs,
        outputs,
        window: &window,
        words: &words,
    });
    m.finish()
}

/// The packets that follow the last one in a word.
struct Window<'b> {
    depth: u32,
    /// After reset the memory is written, a word in each cycle.
    sweeping: Reg<'b>,
    swept: Reg<'b>,
    /// The first packet that is not in a word, and that of the cast.
    first: Reg<'b>,
    offset: Reg<'b>,
    /// How many packets are before the one that the next ray belongs to.
    distance: Signal<'b>,
    memory: Memory<'b>,
    write_place: Signal<'b>,
    pass: Signal<'b>,
    answered_packet: Signal<'b>,
    read_place: Signal<'b>,
    /// The word of the first packet; whether it was written while it was read.
    entry: Signal<'b>,
    was_written: Reg<'b>,
    /// Whether it has the answers of the first packet.
    first_is_answered: Signal<'b>,
    /// The first packet goes into a word.
    moves: Wire<'b>,
}

impl<'b> Window<'b> {
    fn new(m: &'b Builder, plan: &Plan, depth: u32, inputs: &Inputs<Signal<'b>>) -> Window<'b> {
        let rays = plan.rays();
        let place_bits = depth.ilog2();
        let number_bits = place_bits + 1;

        m.comment("After reset every word of the memory becomes one of the pass before.");
        let sweeping = m.reg_reset("is_sweeping", 1, 1);
        let swept = m.reg_reset("swept_words", place_bits, 0);
        sweeping.next(sweeping.q & !swept.q.equals(u128::from(depth) - 1));
        swept.next(swept.q + m.lit(1u8, place_bits));

        m.comment("Packets are numbered modulo two passes. The first packet of a cast follows the last one of the cast before.");
        let first = m.reg_reset("first_packet", number_bits, 0);
        let offset = m.reg_reset("packet_offset", number_bits, 0);
        offset.next_when(inputs.start, first.q);
        let number = |tag| fitted(tag, number_bits) + offset.q;
        let answered = number(inputs.answers.payload.tag).named("answered_packet");
        let next = number(inputs.packet).named("next_packet");
        let distance = (next - first.q).named("next_distance");

        m.comment(
            "A word of the memory: the pass in which it was written, and the answers of a packet.",
        );
        let memory = m.memory("answers", depth, rays + 1, Style::Block);
        let writes = (sweeping.q | inputs.answers.valid).named("writes");
        let write_place = (sweeping.q)
            .mux(swept.q, answered.low(place_bits))
            .named("write_place");
        let pass = (sweeping.q | answered.high(1)).named("written_pass");
        memory.write(
            writes,
            write_place,
            pass.concat(inputs.answers.payload.bits),
        );

        m.comment("The first packet moves on once it is answered. A word that is being written is read again.");
        let moves = m.wire("first_moves", 1);
        let first_next = (first.q + moves.get().extend(number_bits)).named("first_next");
        first.next(first_next);
        let read_place = first_next.low(place_bits).named("read_place");
        let entry = memory.read(read_place);
        let was_written = m.reg("was_written", 1);
        was_written.next(writes & write_place.eq(read_place));
        let first_is_answered =
            (entry.high(1).eq(first.q.high(1)) & !was_written.q).named("first_is_answered");
        Window {
            depth,
            sweeping,
            swept,
            first,
            offset,
            distance,
            memory,
            write_place,
            pass,
            answered_packet: answered,
            read_place,
            entry,
            was_written,
            first_is_answered,
            moves,
        }
    }
}

/// The words of a cast.
struct Words<'b> {
    /// Packets that are not in a word.
    left: Reg<'b>,
    /// The word that is offered or made, whether it is offered, and its number.
    word: Reg<'b>,
    valid: Reg<'b>,
    number: Reg<'b>,
    /// The number of the next packet in its word, if a word has several.
    slot: Option<Reg<'b>>,
    /// Whether there is room for a packet.
    free: Signal<'b>,
}

impl<'b> Words<'b> {
    fn new(
        m: &'b Builder,
        plan: &Plan,
        inputs: &Inputs<Signal<'b>>,
        window: &Window<'b>,
    ) -> Words<'b> {
        let (rays, entry) = (plan.rays(), window.entry);
        let left = m.reg_reset("packets_left", COUNT_BITS, 0);
        let valid = m.reg_reset("is_word_valid", 1, 0);
        let free = (!valid.q | inputs.word_ready).named("word_is_free");
        (window.moves).drive(left.q.any() & window.first_is_answered & free);
        let moves = window.moves.get();
        let one = m.lit(1u8, COUNT_BITS);
        left.next_when(
            inputs.start | moves,
            inputs.start.mux(inputs.packets, left.q - one),
        );

        m.comment("The answers of consecutive packets make a word.");
        let packets = RAYS_PER_WORD / rays;
        let word = m.reg("word", RAYS_PER_WORD);
        let (bits, completes, slot) = match packets {
            1 => (entry.low(rays), moves, None),
            _ => {
                let slot_bits = packets.ilog2();
                let slot = m.reg("slot", slot_bits);
                slot.next_when(
                    inputs.start | moves,
                    (inputs.start).mux(m.zero(slot_bits), slot.q + m.lit(1u8, slot_bits)),
                );
                let shift = match rays {
                    1 => slot.q,
                    _ => slot.q.concat(m.zero(rays.ilog2())),
                };
                let earlier = slot.q.any().mux(word.q, m.zero(RAYS_PER_WORD));
                let bits = earlier | entry.low(rays).extend(RAYS_PER_WORD).shl(shift);
                let is_last = slot.q.equals(u128::from(packets) - 1) | left.q.equals(1);
                (bits, moves & is_last, Some(slot))
            }
        };
        word.next_when(moves, bits);
        valid.next(completes | (valid.q & !inputs.word_ready));
        let number = m.reg("number_of_word", COUNT_BITS);
        let leaves = (valid.q & inputs.word_ready).named("word_leaves");
        number.next_when(
            inputs.start | leaves,
            inputs.start.mux(m.zero(COUNT_BITS), number.q + one),
        );
        Words {
            left,
            word,
            valid,
            number,
            slot,
            free,
        }
    }
}
