//! The update processor: runs an update program (`docs/update.md`) and rewrites the bounds of all nodes of an object.
//!
//! The program never branches, so everything is known ahead, and three parts work at their own pace. Only execution
//! can wait for memory, and where it waits all later instructions do. So merges need no interlock: their distance in
//! clocks is at least the one in instructions that the program was compiled for.
//!
//! ```text
//! program rows ─► prefetch ─► window ─► decode ─┬─► instruction queue ─► execute ─► merge ─► box registers
//!                                               │                         ▲  │  └─► node queue ─► node writes
//!                                               └─► vertex prefetch ──────┘  └─► vertex registers
//! ```
//!
//! | clock, MHz | merge distance |
//! |---|---|
//! | below 70 | 4 |
//! | 70 to 119 | 5 |
//! | from 120 on | 8 |
//!
//! The reference machine's takes, as Yosys counts them for Virtex-4, 2,708 LUT4, 1,780 flip-flops, 454 RAM16X1D, which are 908 LUT4
//! more, and 14 block RAMs; no DSP48.

mod properties;

use super::fifo;
use super::fp::{Knowing, Known, is_nan, less};
use super::plan::{AXES, Plan};
use super::prefetch::{self, Occupancy, pick, prefetch};
use super::properties::Reader;
use super::raycast::COUNTER_BITS;
use crate::bkd::layout::{Record, fields};
use crate::hdl::{
    Builder, Bundle, Flow, HdlError, Memory, Module, ReadInputs, ReadOutputs, Signal, Spec, Specs,
    Style, Write, bits_for,
};
use crate::program::{Program, UpdateMachine};
use crate::{bundle, interface};
use properties::Unit;
use std::sync::Arc;

/// Target clock, in MHz, from which on a comparison and the choice that it makes have a stage each.
const SPLIT_COMPARISONS_FROM: u32 = 120;

/// Target clock, in MHz, from which on a block RAM's output has a stage of its own. Below, a choice between two follows it.
const REGISTER_RAM_OUTPUT_FROM: u32 = 120;

/// Target clock, in MHz, from which on an event has a stage of its own before it is counted.
const REGISTER_EVENTS_FROM: u32 = 120;

/// Bits of a row of the program.
const ROW_BITS: u32 = 8 * Program::ROW_BYTES as u32;

/// Bits that the window takes from a row at a time.
const WORD_BITS: u32 = 32;

/// Bytes of the window. Four more find room beside the longest instruction, of five: it never runs dry by itself.
const WINDOW_BYTES: u32 = 12;

/// Vertex indices decoded and not yet requested: enough for a load every clock.
const VERTEX_INDICES: u32 = 4;

/// The lanes of a node's write mask: its four numbers, lowest first, and above them the link word, never written.
pub const NODE_LANES: u32 = 5;
const NODE_MASK: u32 = 0b01111;

bundle! {
    /// An update: rows of its program, bases of the object's vertices and nodes, index of its box.
    pub struct Update(plan: &Plan) {
        program: plan.address(),
        rows: plan.address(),
        vertex_base: plan.address(),
        node_base: plan.address(),
        box_index: plan.address(),
    }
}

bundle! {
    /// A write of some lanes of a node.
    pub struct NodeWrite(plan: &Plan) {
        address: plan.address(),
        mask: NODE_LANES,
        data: Record::node(plan.format).width,
    }
}

bundle! {
    /// What is counted since reset.
    pub struct Counters() {
        instructions: COUNTER_BITS,
        busy_cycles: COUNTER_BITS,
        stalled_cycles: COUNTER_BITS,
        vertex_wait_cycles: COUNTER_BITS,
        node_wait_cycles: COUNTER_BITS,
    }
}

bundle! {
    /// An instruction that is decoded.
    struct Instruction(plan: &Plan) {
        load: 1,
        leaf: 1,
        node: 1,
        end: 1,
        /// A vertex or box register.
        x: vertex_bits(plan).max(box_bits(plan)),
        y: vertex_bits(plan).max(box_bits(plan)),
        /// A vertex register, or a node's two axes.
        z: vertex_bits(plan).max(4),
        target: box_bits(plan),
    }
}

fn vertex_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.update_vertex_registers))
}

fn box_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.update_box_registers))
}

interface! {
    pub (plan: &Plan) {
        in "An update: rows of its program, bases of the object's vertices and nodes, index of its box" {
            start: Flow<Update>(plan),
        }
        in "" {
            program: {ReadInputs}(
                "Program memory", "of any latency, in any order",
                bits_for(u64::from(plan.config.update_program_rows)), ROW_BITS
            ),
            vertex: {ReadInputs}(
                "Vertex memory", "of any latency, in any order",
                bits_for(u64::from(plan.config.update_vertices_ahead)), Record::vertex(plan.format).width
            ),
        }
        in "Node memory: writes" { node_write_ready: 1 }
        in "The object's box: its write, after all of the nodes'" { box_write_ready: 1 }
        out "An update: rows of its program, bases of the object's vertices and nodes, index of its box" {
            start_ready: 1,
        }
        out "" {
            program: {ReadOutputs}(
                "Program memory", plan.address(), bits_for(u64::from(plan.config.update_program_rows))
            ),
            vertex: {ReadOutputs}(
                "Vertex memory", plan.address(), bits_for(u64::from(plan.config.update_vertices_ahead))
            ),
        }
        out "Node memory: writes" {
            node_write: Flow<NodeWrite>(plan),
        }
        out "The object's box: its write, after all of the nodes'" {
            box_write: Flow<Write>(plan.address(), Record::bounding_box(plan.format).width),
        }
        out "High for a clock when an update is complete" { done: 1 }
        out "Counters since reset" { count: {Counters}() }
    }
}

/// The update processor, and what its programs must be compiled for.
pub struct UpdateProcessor {
    pub module: Arc<Module>,
    /// Its registers, and the merge distance that follows from its depth.
    pub machine: UpdateMachine,
}

/// The update processor of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<UpdateProcessor, HdlError> {
    let (w, f, a) = (plan.number(), plan.format, plan.address());
    let config = &plan.config;
    let (vertex_bits, box_bits) = (vertex_bits(plan), box_bits(plan));
    let instruction = Instruction::of(plan);
    let z_bits = instruction.z.width;

    let m = Builder::new(
        "update_processor",
        "the update processor: runs an update program, which rewrites the bounds of an object's nodes.",
    );
    let ports = ports(plan);
    let Inputs {
        start: Flow {
            valid: start_valid,
            payload: update,
        },
        program: program_memory,
        vertex: vertex_memory,
        node_write_ready,
        box_write_ready,
    } = ports.inputs.inputs(&m);
    let vertex_width = vertex_memory.response.payload.data.width();

    m.comment("An update starts when the last one is over and none of its rows is left.");
    let running = m.reg_reset("running", 1, 0);
    let decoding = m.reg_reset("decoding", 1, 0);
    let rows_left = m.reg("rows_left", a);
    let any_rows_left = m.reg_reset("any_rows_left", 1, 0);
    let no_rows = m.wire("no_rows", 1);
    let start_ready = (no_rows.get() & !(running.q | any_rows_left.q)).named("idle");
    let start = (start_valid & start_ready).named("start");

    m.comment("Fetch: rows of the program, ahead of their use.");
    let fetch_row = m.reg("fetch_row", a);
    let pop_row = m.wire("pop_row", 1);
    let rows_wanted = any_rows_left.q;
    let rows = prefetch(
        plan,
        ("program_prefetch", "rows"),
        config.update_program_rows,
        prefetch::Inputs {
            fetch_valid: rows_wanted,
            fetch_address: fetch_row.q,
            memory: program_memory,
            pop: pop_row.get(),
        },
    )?;
    let empty = rows.empty;
    // Not while a row is requested that it does not count yet.
    let no_rows_before = counts_later(plan).then(|| {
        let before = m.reg_reset("no_rows_before", 1, 1);
        before.next(empty & !rows_wanted);
        before.q
    });
    no_rows.drive(no_rows_before.unwrap_or(empty));
    let row_requested = (rows_wanted & rows.fetch_ready).named("row_requested");
    let one = m.lit(1u8, a);
    let fetch_moves = (start | row_requested).hinted("fetch_moves");
    fetch_row.next_when(fetch_moves, start.mux(update.program, fetch_row.q + one));
    rows_left.next_when(fetch_moves, start.mux(update.rows, rows_left.q - one));
    let last_row = rows_left.q.equals(1).named("last_row");
    any_rows_left.next_when(fetch_moves, start.mux(update.rows.any(), !last_row));

    m.comment("The window: the program's next bytes, refilled by words, and which of them are there. The others are 0.");
    let window = m.reg("window", 8 * WINDOW_BYTES);
    let there = m.reg("window_there", WINDOW_BYTES);
    let words = ROW_BITS / WORD_BITS;
    let word_bits = bits_for(u64::from(words));
    let word_index = m.reg("word_index", word_bits);
    // A clock later than it could be: there is no row for the window so soon after a start.
    let idle = m.reg_reset("idle_before", 1, 1);
    idle.next(!decoding.q);
    let busy = !idle.q;
    let row = rows.front;
    let row_words: Vec<_> = (0..words)
        .map(|i| row.field(i * WORD_BITS, WORD_BITS))
        .collect();
    let word_bytes = WORD_BITS / 8;
    let word = m.reg("next_word", WORD_BITS);
    let word_there = m.reg("next_word_there", 1);
    let has_room = !there.q.bit(WINDOW_BYTES - word_bytes);
    let refill = (has_room & word_there.q & decoding.q).named("refill");
    let take_word = (rows.valid & decoding.q & (!word_there.q | refill)).named("take_word");
    word.next_when(take_word, pick("row_word", word_index.q, &row_words));
    word_there.next((take_word | (word_there.q & !refill)) & busy);
    let last_word = word_index.q.equals(u128::from(words) - 1);
    pop_row.drive(rows.valid & (!decoding.q | (take_word & last_word)));
    word_index.next((word_index.q + take_word.extend(word_bits)) & busy.repeat(word_bits));
    let word = (word.q & refill.repeat(WORD_BITS)).named("refill_word");
    // The word goes behind the last byte that is there.
    let goes_to: Vec<_> = (0..=WINDOW_BYTES - word_bytes)
        .map(|byte| {
            let free = !there.q.bit(byte);
            let first_free = match byte {
                0 => free,
                _ => there.q.bit(byte - 1) & free,
            };
            first_free.named(format!("refill_at_{byte}"))
        })
        .collect();
    let filled = |byte: u32| {
        let old = window.q.field(8 * byte, 8);
        (0..word_bytes)
            .filter_map(|k| Some((k, goes_to.get(byte.checked_sub(k)? as usize)?)))
            .fold(old, |so_far, (k, at)| {
                let with = so_far | (word.field(8 * k, 8) & at.repeat(8));
                with.hinted(format!("filled_byte{byte}_by_{k}"))
            })
    };
    let bytes: Vec<_> = (0..WINDOW_BYTES).rev().map(filled).collect();
    let filled = m.concat(&bytes).named("filled");
    let more = there
        .q
        .low(WINDOW_BYTES - word_bytes)
        .concat(m.lit((1u8 << word_bytes) - 1, word_bytes));
    let filled_there = (there.q | (more & refill.repeat(WINDOW_BYTES))).named("filled_there");

    m.comment("Decode: the first byte tells the kind and the length.");
    let code = |bit: u32| window.q.bit(bit);
    let long = (code(3) & code(2)).named("long_code");
    let reload_or_end = (long & code(1) & !code(0)).hinted("is_reload_or_end");
    crate::named! {
        let is_next = code(1) & code(0);
        let is_leaf = long & !code(1);
        let is_node = !long & !is_next;
        let is_reload = reload_or_end & code(5);
        let is_end = reload_or_end & code(4);
    }
    let is_short = (is_leaf & code(0)).named("is_short");
    let is_three = (is_leaf & !code(0)).named("is_three");
    let is_two = (is_short | is_node | is_end).named("is_two");
    let is_load = (is_next | is_reload).named("is_load");
    let lengths = [(5, is_reload), (3, is_three), (2, is_two)];
    let has = |bytes: u32| there.q.bit(bytes - 1);
    let complete =
        (lengths.iter()).fold(has(1), |so_far, (bytes, is)| so_far & (!*is | has(*bytes)));
    let complete_instruction = complete.named("complete");
    let queue_room = m.wire("queue_room", 1);
    let index_room = m.wire("index_room", 1);
    let decode =
        (decoding.q & complete_instruction & queue_room.get() & index_room.get()).named("decode");
    for (register, name, filled, unit) in [
        (window, "rest", filled, 8),
        (there, "rest_there", filled_there, 1),
    ] {
        let after = |bytes: u32| {
            m.zero(unit * bytes)
                .concat(filled.high(unit * (WINDOW_BYTES - bytes)))
        };
        let choices = lengths.map(|(bytes, is)| (is, after(bytes)));
        let rest = m.priority(&choices, after(1)).named(name);
        register.next(decode.mux(rest, filled) & busy.repeat(unit * WINDOW_BYTES));
    }
    decoding.next(start | (decoding.q & !(decode & is_end)));

    m.comment("The decoded instruction. Its implicit registers and its vertex's index follow from those before it.");
    let decoded = m.reg_reset("decoded", 1, 0);
    decoded.next(decode);
    let hold = |name: &str, value| {
        let register = m.reg(name, Signal::width(&value));
        register.next(value);
        register.q
    };
    let in_second_byte = is_reload | is_end;
    let x = is_next.mux(
        window.q.field(2, 6),
        in_second_byte.mux(window.q.field(8, 6), window.q.field(4, 6)),
    );
    let x = hold("decoded_x", x.hinted("x_field").low(instruction.x.width));
    let y = hold("decoded_y", window.q.field(10, 6).low(instruction.y.width));
    let explicit_z = hold("decoded_z", window.q.field(16, 6).low(vertex_bits));
    let axes = hold("decoded_axes", window.q.low(4));
    let again = hold("decoded_index", window.q.field(14, 26).low(a));
    let load = hold("decoded_load", is_load);
    let reload = hold("decoded_reload", is_reload);
    let leaf = hold("decoded_leaf", is_leaf);
    let short = hold("decoded_short", is_short);
    let node = hold("decoded_node", is_node);
    let end = hold("decoded_end", is_end);

    let last = m.reg("last", vertex_bits);
    let decoded_load = (decoded.q & load).hinted("load_is_decoded");
    last.next_when(decoded_load, x.low(vertex_bits));
    let z = short
        .mux(last.q, explicit_z)
        .hinted("vertex_z")
        .extend(z_bits);
    let z_or_axes = node.mux(axes, z.low(4));
    let z = match z_bits {
        4 => z_or_axes,
        _ => z.high(z_bits - 4).concat(z_or_axes),
    };
    let z = z.named("implied_z");

    let boxes_count_bits = bits_for(u64::from(config.update_box_registers) + 1);
    let free_count = m.reg("free_count", boxes_count_bits);
    let fresh = m.reg("fresh", box_bits);
    let any_free = free_count.q.any().named("any_free");
    let frees = (decoded.q & node).named("frees");
    let takes = (decoded.q & leaf).named("takes");
    let takes_free = (takes & any_free).named("takes_free");
    let unit = m.lit(1u8, boxes_count_bits);
    free_count.next_when(
        start | frees | takes_free,
        start.mux(
            m.zero(boxes_count_bits),
            frees.mux(free_count.q + unit, free_count.q - unit),
        ),
    );
    let box_unit = m.lit(1u8, box_bits);
    fresh.next_when(
        start | (takes & !any_free),
        start.mux(m.zero(box_bits), fresh.q + box_unit),
    );
    let free_list = m.memory(
        "free_list",
        config.update_box_registers,
        box_bits,
        Style::Distributed,
    );
    free_list.write(frees, free_count.q.low(box_bits), y.low(box_bits));
    let free = free_list.read_now(free_count.q.low(box_bits) - box_unit);
    let target = node
        .mux(x.low(box_bits), any_free.mux(free, fresh.q))
        .named("implied_target");

    let vertex_base = m.reg("vertex_base", a);
    vertex_base.next_when(start, update.vertex_base);
    let next_vertex = m.reg("next_vertex", a);
    let counts = (decoded_load & !reload).named("loads_next");
    next_vertex.next_when(
        start | counts,
        start.mux(update.vertex_base, next_vertex.q + one),
    );
    let index = reload.mux(vertex_base.q + again, next_vertex.q);

    m.comment("Vertices are requested in the order of their loads, ahead of their use.");
    let take_index = m.wire("take_index", 1);
    let pop_vertex = m.wire("pop_vertex", 1);
    let vertex_indices = fifo::place(
        plan,
        "vertex_indices",
        VERTEX_INDICES,
        decoded_load,
        index,
        take_index.get(),
    )?;
    let (index_valid, index_front) = (vertex_indices.valid, vertex_indices.front);
    let indices_in_flight = Occupancy::new(
        plan,
        &m,
        "indices_under_way",
        VERTEX_INDICES,
        (decode & is_load).hinted("decode_load"),
        take_index.get(),
    );
    index_room.drive(indices_in_flight.room);
    let fetched = prefetch(
        plan,
        ("vertex_prefetch", "vertices"),
        config.update_vertices_ahead,
        prefetch::Inputs {
            fetch_valid: index_valid,
            fetch_address: index_front,
            memory: vertex_memory,
            pop: pop_vertex.get(),
        },
    )?;
    take_index.drive(index_valid & fetched.fetch_ready);

    m.comment("Instructions wait for their vertices.");
    let take_instruction = m.wire("take_instruction", 1);
    let decoded_as = Instruction {
        load,
        leaf,
        node,
        end,
        x,
        y,
        z,
        target,
    };
    let whole = instruction.pack(decoded_as);
    // The target may have come from the list of free ones: it queues a clock later.
    let queued = m.reg_reset("completed", 1, 0);
    queued.next(decoded.q);
    let whole = hold("completed_instruction", whole);
    let instruction_queue = fifo::place(
        plan,
        "instruction_queue",
        config.update_instructions_ahead,
        queued.q,
        whole,
        take_instruction.get(),
    )?;
    let (queue_valid, queue_front) = (instruction_queue.valid, instruction_queue.front);
    let instructions_in_flight = Occupancy::new(
        plan,
        &m,
        "instructions_waiting",
        config.update_instructions_ahead,
        decode,
        take_instruction.get(),
    );
    queue_room.drive(instructions_in_flight.room);

    m.comment("Execute: the current instruction goes unless what it needs is missing.");
    let current = m.reg("current", instruction.width());
    let current_valid = m.reg_reset("current_valid", 1, 0);
    let part = |field: &Spec| {
        let part = instruction.get(current.q, field);
        part.named(format!("current_{}", field.name))
    };
    let valid_part =
        |field: &Spec| (current_valid.q & part(field)).named(format!("{}_waits", field.name));
    let (loads, leafs, nodes, ends) = (
        valid_part(&instruction.load),
        valid_part(&instruction.leaf),
        valid_part(&instruction.node),
        valid_part(&instruction.end),
    );
    let node_room = m.wire("node_room", 1);
    let box_taken = m.wire("box_taken", 1);
    let missing_vertex = (loads & !fetched.valid).named("missing_vertex");
    let missing_room = (nodes & !node_room.get()).named("missing_room");
    let unfinished = (ends & !box_taken.get()).named("unfinished");
    let goes = (current_valid.q & !(missing_vertex | missing_room | unfinished)).named("goes");
    let take = (queue_valid & (goes | !current_valid.q)).named("take");
    take_instruction.drive(take);
    current.next_when(take, queue_front);
    current_valid.next(take | (current_valid.q & !goes));
    let load_goes = (loads & fetched.valid).named("load_goes");
    let node_goes = (nodes & node_room.get()).named("node_goes");
    pop_vertex.drive(load_goes);

    m.comment("The registers. A load is written as it goes; the next instruction can read it.");
    let vertex_registers = m.memory(
        "vertex_registers",
        config.update_vertex_registers,
        vertex_width,
        Style::Block,
    );
    vertex_registers.write(
        load_goes,
        part(&instruction.x).low(vertex_bits),
        fetched.front,
    );
    let p = m.pipeline();
    let [x, y, z] = [&instruction.x, &instruction.y, &instruction.z];
    let (of_vertex, of_box) = (fields::Vertex::of(f), fields::Box::of(f));
    let corners = [x, y, z].map(|field| {
        let number = p.enter(part(field).low(vertex_bits));
        read(plan, vertex_registers, number)
    });
    let box_registers = m.memory(
        "box_registers",
        config.update_box_registers,
        of_box.width(),
        Style::Block,
    );
    let boxes = [x, y].map(|field| {
        let number = p.enter(part(field).low(box_bits));
        of_box.unpack(read(plan, box_registers, number))
    });

    m.comment("Merge: of two boxes, or of three vertices, of which each is a box too. A number that is no NaN goes before one that is.");
    // What a reset leaves here is written before an update can merge anything.
    let merges = p.enter((leafs | node_goes).named("merge_goes"));
    let of_leaf = p.enter(part(&instruction.leaf)).named("of_leaf");
    let target = p.enter(part(&instruction.target)).named("merge_target");
    let mut merged = vec![];
    let mut operands = vec![];
    let infinity = u128::from(f.infinity());
    let infinities = [infinity, infinity | 1 << (w - 1)];
    for end in 0..2 {
        for (axis, axis_name) in AXES.iter().enumerate() {
            let name = |of: &str| format!("{of}_{}_{axis_name}", ["lo", "hi"][end]);
            let of_axis = &of_vertex.position[axis];
            let corner = corners.map(|corner| of_vertex.get(corner, of_axis));
            let bound = boxes.map(|of| [of.lo, of.hi][end][axis]);
            let operand = |k: usize| of_leaf.mux(corner[k], bound[k]);
            let first = operand(0).named(name("first")).register();
            let second = operand(1).named(name("second")).register();
            let third = corner[2].named(format!("third_{axis_name}")).register();
            operands.push((first, second));
            let beats = |who: &str, x, bound| {
                let (a, b) = if end == 0 { (x, bound) } else { (bound, x) };
                less(f, name(&format!("{who}_beats")), a, b)
            };
            let [nan_1, nan_2, nan_3] = [first, second, third].map(|x| is_nan(f, x));
            let nan_1 = nan_1.named(name("nan_first"));
            let nan_2 = nan_2.named(name("nan_second"));
            let nan_3 = nan_3.named(format!("nan_third_{axis_name}"));
            // A bound that is a NaN is looked for beside the comparison.
            let (challenger, holder) = (second.known(Known::Nothing), first.known(Known::NoNan));
            let two = beats("second", challenger, holder) | (nan_1 & !nan_2);
            let two = split_comparison(plan, two.named(name("take_second")));
            let best = two.mux(second, first).named(name("best")).register();
            let none = (nan_1 & nan_2).named(name("nan_both")).register();
            let (challenger, holder) = (third.known(Known::Nothing), best.known(Known::NoNan));
            let only_third = (none & !nan_3).hinted(name("only_third"));
            let beats_two = beats("third", challenger, holder) | only_third;
            let three = of_leaf & beats_two.hinted(name("third_is_better"));
            let three = split_comparison(plan, three.named(name("take_third")));
            let nothing = m.lit(infinities[end], w);
            let all_nan = (none & nan_3).hinted(name("nan_all"));
            let bound = all_nan.mux(nothing, three.mux(third, best));
            merged.push(plan.settle(bound.named(name("merged"))));
        }
    }
    let by_end = |of: &[_]| fields::Box {
        lo: [of[0], of[1], of[2]],
        hi: [of[3], of[4], of[5]],
    };
    let merged = of_box.pack(by_end(&merged));
    let written = merged.stage();
    let read_at = operands[0].0.stage();
    box_registers.write(
        merges.at(written).untimed(),
        target.at(written).untimed(),
        merged.untimed(),
    );

    m.comment("A node's intervals, each on its axis, wait until they are written.");
    let axes = p.enter(part(z).low(4)).named("merge_axes").at(read_at);
    let mut numbers = vec![];
    for (child, side) in ["left", "right"].into_iter().enumerate() {
        let axis = axes.part(side, 2 * child as u32, 2);
        for (end, bound) in ["lo", "hi"].into_iter().enumerate() {
            let of_axis: Vec<_> = operands[3 * end..3 * end + 3]
                .iter()
                .map(|(first, second)| if child == 0 { *first } else { *second })
                .collect();
            let number = m.select(axis, &of_axis).named(format!("{side}_{bound}"));
            numbers.push(number.register());
        }
    }
    let [left_lo, left_hi, right_lo, right_hi] = numbers[..] else {
        unreachable!("two children of two ends");
    };
    let intervals = fields::Planes::of(f).pack(fields::Planes {
        left_lo,
        left_hi,
        right_lo,
        right_hi,
    });
    let intervals_at = intervals.stage();
    let node_done = p.enter(node_goes).cleared_by_reset();
    let node_pop = m.wire("node_pop", 1);
    let node_queue = fifo::place(
        plan,
        "node_queue",
        config.update_nodes_waiting,
        node_done.at(intervals_at).untimed(),
        intervals.untimed(),
        node_pop.get(),
    )?;
    let (node_valid, node_front) = (node_queue.valid, node_queue.front);
    node_pop.drive(node_valid & node_write_ready);
    let nodes_in_flight = Occupancy::new(
        plan,
        &m,
        "nodes_under_way",
        config.update_nodes_waiting,
        node_goes,
        node_pop.get(),
    );
    node_room.drive(nodes_in_flight.room);
    let next_node = m.reg("next_node", a);
    next_node.next_when(
        start | node_pop.get(),
        start.mux(update.node_base, next_node.q + one),
    );

    let later = |name: &str, bit| {
        let register = m.reg_reset(name, 1, 0);
        register.next(bit);
        register.q
    };
    m.comment("The end: when all merges are in their registers and all nodes written, the box, read like a node's.");
    // What is shown was read read_at clocks before.
    // Since the end waits, nothing has merged.
    let under_way: Vec<_> = (read_at..written + read_at)
        .map(|k| merges.at(k).untimed())
        .collect();
    let under_way = m.or_all(&under_way).hinted("merges_under_way");
    let under_way = (under_way | nodes_in_flight.any).hinted("work_under_way");
    let all_complete = (!under_way).named("all_complete");
    let box_shown = m.reg_reset("box_shown", 1, 0);
    box_taken.drive(box_shown.q & box_write_ready);
    // The end must itself have waited until its register is read: nothing else may have been under way for long.
    let waits = p.enter(ends).cleared_by_reset();
    let was_read = (1..read_at).fold(ends, |so_far, k| so_far & waits.at(k).untimed());
    let was_read = was_read.named("box_was_read");
    box_shown.next(was_read & all_complete & !box_taken.get());
    let box_index = m.reg("box_index", a);
    box_index.next_when(start, update.box_index);
    let bounds: Vec<_> = operands.iter().map(|(first, _)| *first).collect();
    let box_write = Write {
        address: box_index.q,
        data: of_box.pack(by_end(&bounds)).untimed(),
    };
    running.next(start | (running.q & !box_taken.get()));
    let done = m.reg_reset("over", 1, 0);
    done.next(box_taken.get());
    // As late as what is counted.
    let done = match counts_later(plan) {
        false => done.q,
        true => later("over_before", done.q),
    };

    m.comment("Counters since reset.");
    let events = Counters {
        instructions: goes,
        busy_cycles: running.q,
        stalled_cycles: running.q & !goes,
        vertex_wait_cycles: missing_vertex,
        node_wait_cycles: missing_room,
    };
    let count = events.map(|name, event| {
        let event = match counts_later(plan) {
            false => event,
            true => later(&format!("{name}_event"), event),
        };
        let counter = m.reg_reset(format!("{name}_counter"), COUNTER_BITS, 0);
        counter.next_when(event, counter.q + m.lit(1u8, COUNTER_BITS));
        counter.q
    });
    let outputs = Outputs {
        start_ready,
        program: ReadOutputs {
            request: rows.request,
        },
        vertex: ReadOutputs {
            request: fetched.request,
        },
        node_write: Flow::new(
            node_valid,
            NodeWrite {
                address: next_node.q,
                mask: m.lit(NODE_MASK, NODE_LANES),
                data: node_front.extend(Record::node(f).width),
            },
        ),
        box_write: Flow::new(box_shown.q, box_write),
        done,
        count,
    };
    ports.outputs.outputs(&m, outputs);

    let unit = Unit {
        start,
        running: running.q,
        done,
        any_rows_left: any_rows_left.q,
        fetch_row: fetch_row.q,
        row_requested,
        rows: Reader::of(&rows, config.update_program_rows, pop_row.get()),
        no_rows_before,
        window_there: there.q,
        idle_before: idle.q,
        take_word,
        refill,
        decoding: decoding.q,
        instruction_there: complete_instruction,
        is_reload,
        is_end,
        decode,
        decoded: decoded.q,
        decoded_as,
        vertex_indices,
        indices: indices_in_flight,
        vertices: Reader::of(&fetched, config.update_vertices_ahead, pop_vertex.get()),
        completed: queued.q,
        completed_as: instruction.unpack(whole),
        instruction_queue,
        instructions: instructions_in_flight,
        front_as: instruction.unpack(queue_front),
        take,
        goes,
        current_valid: current_valid.q,
        current_as: instruction.unpack(current.q),
        queue_room: queue_room.get(),
        node_room: node_room.get(),
        node_goes,
        load_waits: loads,
        end_waits: ends,
        merging: merges.stages(1..=read_at),
        waiting: waits.stages(1..=read_at - 1),
        to_node_queue: node_done.stages(1..=intervals_at),
        node_queue,
        nodes: nodes_in_flight,
        node_write: outputs.node_write,
        node_write_ready,
        box_write: outputs.box_write,
        box_write_ready,
        box_was_read: was_read,
        all_complete,
    };
    properties::credit(&m, &unit);
    Ok(UpdateProcessor {
        module: m.finish()?,
        machine: UpdateMachine {
            vertex_registers: config.update_vertex_registers,
            box_registers: config.update_box_registers,
            merge_distance: written + 1,
        },
    })
}

/// Whether an event is counted a clock later: it leaves too little of the clock for the wires to a counter.
fn counts_later(plan: &Plan) -> bool {
    plan.config.clock_mhz >= REGISTER_EVENTS_FROM
}

/// A register's contents, a clock later or two.
fn read<'b>(plan: &Plan, registers: Memory<'b>, number: Signal<'b>) -> Signal<'b> {
    let word = registers.read(number);
    if plan.config.clock_mhz >= REGISTER_RAM_OUTPUT_FROM {
        word.register()
    } else {
        word
    }
}

/// A register between a comparison and the choice that it makes, where the clock asks for it.
fn split_comparison<'b>(plan: &Plan, choice: Signal<'b>) -> Signal<'b> {
    if plan.config.clock_mhz >= SPLIT_COMPARISONS_FROM {
        choice.register()
    } else {
        choice
    }
}
