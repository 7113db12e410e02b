//! Decode: splits the rows of the program into instructions, one per cycle, and adds the implicit registers and the vertex index of
//! each instruction.

use super::fetch::Rows;
use super::{Around, Instruction, ROW_BITS, Start, WINDOW_BYTES, WORD_BITS, box_bits, vertex_bits};
use crate::bundle;
use crate::hdl::properties::Reader;
use crate::hdl::{Builder, Flow, Reg, Signal, Specs, Style, bits_for};
use crate::hw::banks::pick;
use crate::hw::counters::counts_up;
use crate::hw::plan::Plan;

/// Bytes per refill.
const WORD_BYTES: u32 = WORD_BITS / 8;

bundle! {
    /// The explicit fields of an instruction, one cycle after it was in the window.
    pub(super) struct Decoded(plan: &Plan) {
        x: Instruction::of(plan).x.width,
        y: Instruction::of(plan).y.width,
        z: vertex_bits(plan),
        axes: 4,
        index: plan.address(),
        load: 1,
        reload: 1,
        leaf: 1,
        short: 1,
        node: 1,
        end: 1,
    }
}

/// The results of decode.
pub(super) struct Decode<'b> {
    /// Whether an instruction leaves the window, and whether it is a load.
    pub decode: Signal<'b>,
    pub decode_load: Signal<'b>,
    /// The vertex index of a load, one cycle later.
    pub index: Flow<Signal<'b>, Signal<'b>>,
    /// The instruction as a word, two cycles after it has left the window.
    pub completed: Flow<Signal<'b>, Signal<'b>>,
    // For the properties.
    pub window: Window<'b>,
    pub first: First<'b>,
    pub decoding: Signal<'b>,
    pub decoded: Signal<'b>,
    pub decoded_as: Instruction<Signal<'b>>,
    pub completed_as: Instruction<Signal<'b>>,
}

impl<'b> Decode<'b> {
    /// Decodes the program from start to end. An instruction is decoded when it is completely in the window and there is room for it and
    /// for a vertex index.
    pub fn new(&Around { plan, m, told, .. }: &Around<'b>, rows: &Rows<'b>) -> Decode<'b> {
        let start = rows.start;
        let decoding = m.reg_reset("decoding", 1, 0);
        let window = Window::new(m, decoding.q, &rows.reader);
        let first = First::of(plan, m, &window);
        let decode =
            (decoding.q & first.complete & told.queue_room & told.index_room).named("decode");
        window.advance(m, decode, &first);
        decoding.next(start.valid | (decoding.q & !(decode & first.says.end)));

        m.comment("The decoded instruction. Its implicit registers and its vertex index follow from earlier instructions.");
        let decoded = m.reg_reset("decoded", 1, 0);
        decoded.next(decode);
        let of = Decoded::of(plan).hold("decoded", first.says);
        let load = (decoded.q & of.load).hinted("load_is_decoded");
        let decoded_as = Instruction {
            load: of.load,
            leaf: of.leaf,
            node: of.node,
            end: of.end,
            x: of.x,
            y: of.y,
            z: implied_z(plan, m, load, &of),
            target: implied_target(plan, m, start.valid, decoded.q, &of),
        };
        let index = vertex_index(m, start, load, &of);
        // The target can be read from the list of free registers, so the instruction is queued one cycle later.
        let instruction = Instruction::of(plan);
        let word = instruction.pack(decoded_as);
        let completed = m.reg_reset("completed", 1, 0);
        completed.next(decoded.q);
        let completed_word = m.reg("completed_instruction", instruction.width());
        completed_word.next(word);
        Decode {
            decode,
            decode_load: (decode & first.says.load).hinted("decode_load"),
            index: Flow::new(load, index),
            completed: Flow::new(completed.q, completed_word.q),
            window,
            first,
            decoding: decoding.q,
            decoded: decoded.q,
            decoded_as,
            completed_as: instruction.unpack(completed_word.q),
        }
    }
}

/// The next bytes of the program, and their valid bits. Invalid bytes are 0.
pub(super) struct Window<'b> {
    bytes: Reg<'b>,
    pub there: Reg<'b>,
    /// Both with the next word appended, if there is room for it.
    filled: Signal<'b>,
    filled_there: Signal<'b>,
    pub idle_before: Signal<'b>,
    pub take_word: Signal<'b>,
    pub refill: Signal<'b>,
    /// High when the front row has been used.
    pub pop_row: Signal<'b>,
}

impl<'b> Window<'b> {
    /// Takes the words of the rows one by one, while `decoding`. [`Window::advance`] must be called afterwards.
    fn new(m: &'b Builder, decoding: Signal<'b>, rows: &Reader<'b>) -> Window<'b> {
        m.comment("The window: the next bytes of the program, refilled by words, and their valid bits. Invalid bytes are 0.");
        let bytes = m.reg("window", 8 * WINDOW_BYTES);
        let there = m.reg("window_there", WINDOW_BYTES);
        let words = ROW_BITS / WORD_BITS;
        let word_bits = bits_for(u64::from(words));
        let word_index = m.reg("word_index", word_bits);
        // One cycle later than necessary: no row arrives so soon after a start.
        let idle = m.reg_reset("idle_before", 1, 1);
        idle.next(!decoding);
        let busy = !idle.q;
        let row_words: Vec<_> = (0..words)
            .map(|i| rows.front.field(i * WORD_BITS, WORD_BITS))
            .collect();
        let word = m.reg("next_word", WORD_BITS);
        let word_there = m.reg("next_word_there", 1);
        let has_room = !there.q.bit(WINDOW_BYTES - WORD_BYTES);
        let refill = (has_room & word_there.q & decoding).named("refill");
        let take_word = (rows.valid & decoding & (!word_there.q | refill)).named("take_word");
        word.next_when(take_word, pick("row_word", word_index.q, &row_words));
        word_there.next((take_word | (word_there.q & !refill)) & busy);
        let last_word = word_index.q.equals(u128::from(words) - 1);
        let pop_row = rows.valid & (!decoding | (take_word & last_word));
        word_index.next((word_index.q + take_word.extend(word_bits)) & busy.repeat(word_bits));
        let word = (word.q & refill.repeat(WORD_BITS)).named("refill_word");
        let filled = filled(bytes.q, there.q, word);
        let more = there
            .q
            .low(WINDOW_BYTES - WORD_BYTES)
            .concat(m.ones(WORD_BYTES));
        let filled_there = (there.q | (more & refill.repeat(WINDOW_BYTES))).named("filled_there");
        Window {
            bytes,
            there,
            filled,
            filled_there,
            idle_before: idle.q,
            take_word,
            refill,
            pop_row,
        }
    }

    /// Removes the bytes of a decoded instruction.
    fn advance(&self, m: &'b Builder, decode: Signal<'b>, first: &First<'b>) {
        for (register, name, filled, unit) in [
            (self.bytes, "rest", self.filled, 8),
            (self.there, "rest_there", self.filled_there, 1),
        ] {
            let after = |bytes: u32| {
                m.zero(unit * bytes)
                    .concat(filled.high(unit * (WINDOW_BYTES - bytes)))
            };
            let choices = first.lengths.map(|(bytes, is)| (is, after(bytes)));
            let rest = m.priority(&choices, after(1)).named(name);
            let busy = (!self.idle_before).repeat(unit * WINDOW_BYTES);
            register.next(decode.mux(rest, filled) & busy);
        }
    }
}

/// The window with `word` (0 if there is none) after the last valid byte.
fn filled<'b>(window: Signal<'b>, there: Signal<'b>, word: Signal<'b>) -> Signal<'b> {
    let goes_to: Vec<_> = (0..=WINDOW_BYTES - WORD_BYTES)
        .map(|byte| {
            let free = !there.bit(byte);
            let first_free = match byte {
                0 => free,
                _ => there.bit(byte - 1) & free,
            };
            first_free.named(format!("refill_at_{byte}"))
        })
        .collect();
    let filled = |byte: u32| {
        let old = window.field(8 * byte, 8);
        (0..WORD_BYTES)
            .filter_map(|k| Some((k, goes_to.get(byte.checked_sub(k)? as usize)?)))
            .fold(old, |so_far, (k, at)| {
                let with = so_far | (word.field(8 * k, 8) & at.repeat(8));
                with.hinted(format!("filled_byte{byte}_by_{k}"))
            })
    };
    let bytes: Vec<_> = (0..WINDOW_BYTES).rev().map(filled).collect();
    window.module().concat(&bytes).named("filled")
}

/// The first instruction in the window.
pub(super) struct First<'b> {
    pub says: Decoded<Signal<'b>>,
    /// The lengths of instructions of more than one byte, in bytes, the longest first.
    lengths: [(u32, Signal<'b>); 3],
    /// Whether all of its bytes are valid.
    pub complete: Signal<'b>,
}

impl<'b> First<'b> {
    fn of(plan: &Plan, m: &'b Builder, window: &Window<'b>) -> First<'b> {
        m.comment("Decode: the first byte determines kind and length.");
        let code = |bit: u32| window.bytes.q.bit(bit);
        let long = (code(3) & code(2)).named("long_code");
        let reload_or_end = (long & code(1) & !code(0)).hinted("is_reload_or_end");
        crate::named! {
            let is_next = code(1) & code(0);
            let is_leaf = long & !code(1);
            let is_node = !long & !is_next;
            let is_reload = reload_or_end & code(5);
            let is_end = reload_or_end & code(4);
            let is_short = is_leaf & code(0);
            let is_three = is_leaf & !code(0);
            let is_two = is_short | is_node | is_end;
            let is_load = is_next | is_reload;
        }
        let lengths = [(5, is_reload), (3, is_three), (2, is_two)];
        let has = |bytes: u32| window.there.q.bit(bytes - 1);
        let complete =
            (lengths.iter()).fold(has(1), |so_far, (bytes, is)| so_far & (!*is | has(*bytes)));
        let of = Decoded::of(plan);
        let field = |lsb: u32, bits: u32| window.bytes.q.field(lsb, bits);
        let x = (is_reload | is_end).mux(field(8, 6), field(4, 6));
        let x = is_next.mux(field(2, 6), x);
        First {
            says: Decoded {
                x: x.hinted("x_field").low(of.x.width),
                y: field(10, 6).low(of.y.width),
                z: field(16, 6).low(of.z.width),
                axes: field(0, 4),
                index: field(14, 26).low(of.index.width),
                load: is_load,
                reload: is_reload,
                leaf: is_leaf,
                short: is_short,
                node: is_node,
                end: is_end,
            },
            lengths,
            complete: complete.named("complete"),
        }
    }
}

/// The third vertex register of a leaf, which is the last loaded one in the short form; the axes of a node.
fn implied_z<'b>(
    plan: &Plan,
    m: &'b Builder,
    load: Signal<'b>,
    decoded: &Decoded<Signal<'b>>,
) -> Signal<'b> {
    let (vertex_bits, z_bits) = (vertex_bits(plan), Instruction::of(plan).z.width);
    let last = m.reg("last", vertex_bits);
    last.next_when(load, decoded.x.low(vertex_bits));
    let z = decoded
        .short
        .mux(last.q, decoded.z)
        .hinted("vertex_z")
        .extend(z_bits);
    let z_or_axes = decoded.node.mux(decoded.axes, z.low(4));
    let z = match z_bits {
        4 => z_or_axes,
        _ => z.high(z_bits - 4).concat(z_or_axes),
    };
    z.named("implied_z")
}

/// The box register that a merge writes. A node reuses its first operand, and its second one becomes free; a leaf takes a free register, or else the next unused one.
fn implied_target<'b>(
    plan: &Plan,
    m: &'b Builder,
    start: Signal<'b>,
    valid: Signal<'b>,
    decoded: &Decoded<Signal<'b>>,
) -> Signal<'b> {
    let (registers, box_bits) = (plan.config.update_box_registers, box_bits(plan));
    let count_bits = bits_for(u64::from(registers) + 1);
    let free_count = m.reg("free_count", count_bits);
    let fresh = m.reg("fresh", box_bits);
    crate::named! {
        let any_free = free_count.q.any();
        let frees = valid & decoded.node;
        let takes = valid & decoded.leaf;
        let takes_free = takes & any_free;
    }
    let unit = m.lit(1u8, count_bits);
    let counted = frees.mux(free_count.q + unit, free_count.q - unit);
    free_count.next_when(
        start | frees | takes_free,
        start.mux(m.zero(count_bits), counted),
    );
    counts_up(fresh, (start, m.zero(box_bits)), takes & !any_free);
    let free_list = m.memory("free_list", registers, box_bits, Style::Distributed);
    free_list.write(frees, free_count.q.low(box_bits), decoded.y.low(box_bits));
    let newest = free_count.q.low(box_bits) - m.lit(1u8, box_bits);
    let free = free_list.read_now(newest);
    let of_leaf = any_free.mux(free, fresh.q);
    (decoded.node.mux(decoded.x.low(box_bits), of_leaf)).named("implied_target")
}

/// The vertex index of a load: the next one, or for a reload the given one, relative to the object's first vertex.
fn vertex_index<'b>(
    m: &'b Builder,
    start: Start<'b>,
    load: Signal<'b>,
    decoded: &Decoded<Signal<'b>>,
) -> Signal<'b> {
    let (start, base) = (start.valid, start.payload.vertex_base);
    let a = base.width();
    let vertex_base = m.reg("vertex_base", a);
    vertex_base.next_when(start, base);
    let next_vertex = m.reg("next_vertex", a);
    let counts = (load & !decoded.reload).named("loads_next");
    counts_up(next_vertex, (start, base), counts);
    let again = vertex_base.q + decoded.index;
    decoded.reload.mux(again, next_vertex.q)
}
