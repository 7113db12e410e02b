//! The skinning processor: moves a mesh's vertices at rest by the matrices of the joints that they follow.
//!
//! It is a stream without a program: the palette is copied into the geometry unit's memories, then vertices at rest
//! and their influences are read ahead and meet, an influence a clock. It has no arithmetic: the geometry unit's
//! triangle test lends its multipliers and adders, so no packet may be under way meanwhile.
//!
//! ```text
//! vector memory ──► prefetch ─┬─► palette memories (geometry unit)
//!                             └─► vertex at rest ─┐                 matrix × point × weight         two sums
//! influence rows ─► prefetch ─► slot of four ─────┴─► issue ─► (geometry unit's triangle test) ─► (its subtractors) ─► write queue
//! ```
//!
//! What is issued never waits; a vertex's last influence is issued when the write queue has room for the vertex.
//!
//! The reference machine's takes, as Yosys counts them for Virtex-4, 642 LUT4, 1,039 flip-flops, 2 RAMB16 (the write queue) and, as
//! distributed RAM, 200 RAM16X1D, which are 400 LUT4 more; no DSP48. Beside that the geometry unit chooses between its own operands and these.

mod properties;

use super::plan::{AXES, Plan};
use super::prefetch::{Occupancy, pick, prefetch};
use super::properties::Reader;
use crate::bkd::layout::{INFLUENCES_PER_ROW, Record};
use crate::hdl::{Builder, HdlError, Module, Outputs, Pipeline, Signal, Style, bits_for};
use properties::Unit;
use std::sync::Arc;

/// Bits that number an influence of its vertex.
const POSITION_BITS: u32 = 2;

/// What goes with an influence through the geometry unit and comes back with the result, and its bits.
const ISSUED: [(&str, u32); 3] = [("valid", 1), ("position", POSITION_BITS), ("last", 1)];

/// Bits that number a joint of a machine's palette.
pub(super) fn joint_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.skinning_joints))
}

/// Bits of the tags of the processor's vector reads.
pub(super) fn vector_tag_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.skinning_vertices_ahead))
}

/// Bits of the tags of its reads of influence rows.
pub(super) fn row_tag_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.skinning_rows_ahead))
}

/// The inputs that start a mesh, with their bits: indices and counts of records.
pub(super) fn start_ports(plan: &Plan) -> [(&'static str, u32); 7] {
    let a = plan.address();
    [
        ("palette", a),
        (
            "joints",
            bits_for(u64::from(plan.config.skinning_joints) + 1),
        ),
        ("influences", a),
        ("rows", a),
        ("rest", a),
        ("vertices", a),
        ("target", a),
    ]
}

/// The skinning processor of a machine whose triangle test is `test`.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub(super) fn module(plan: &Plan, test: &Module) -> Result<Arc<Module>, HdlError> {
    let stage_of = |port: &str| test.port(port).and_then(|p| p.stage).unwrap_or(0);
    let sum_latency = stage_of("sum_0") - stage_of("sum_a_0");
    let (w, a) = (plan.number(), plan.address());
    let config = &plan.config;
    let vector = Record::vertex(plan.format);
    let row = Record::influence_row(plan.format);
    let joint_width = joint_bits(plan);

    let m = Builder::new(
        "skinning_processor",
        "the skinning processor: moves vertices at rest by the weighted matrices of a palette.",
    );
    const START: &str = "A mesh to skin: indices of its palette, influence rows, vertices at rest and vertices to write, and how many";
    m.group(START);
    let start_valid = m.input("start_valid", 1);
    let [palette, joints, influences, rows, rest, vertices, target] =
        start_ports(plan).map(|(name, width)| m.input(format!("start_{name}"), width));
    m.group("Whether the geometry unit is free for it");
    let may_start = m.input("may_start", 1);
    let read_port = |name: &str, title: &str, tag: u32, width: u32| {
        m.group(format!("{title}: requests"));
        let ready = m.input(format!("{name}_request_ready"), 1);
        m.group(format!("{title}: answers, of any latency, in any order"));
        [
            ready,
            m.input(format!("{name}_response_valid"), 1),
            m.input(format!("{name}_response_tag"), tag),
            m.input(format!("{name}_response_data"), width),
        ]
    };
    let vector_port = read_port(
        "vertex",
        "Vertex memory",
        vector_tag_bits(plan),
        vector.width,
    );
    let row_port = read_port(
        "influence",
        "Influence memory",
        row_tag_bits(plan),
        row.width,
    );
    m.group("Vertex memory: writes");
    let write_ready = m.input("write_ready", 1);
    m.group(
        "From the geometry unit: a moved vertex times a weight, and which of its vertex's it is",
    );
    let [weighted_valid, weighted_position, weighted_last] =
        ISSUED.map(|(name, width)| m.input(format!("weighted_{name}"), width));
    let weighted = AXES.map(|x| m.input(format!("weighted_{x}"), w));
    m.group("From the geometry unit: sums of two weighted ones, and of two sums");
    let pair_sums = AXES.map(|x| m.input(format!("pair_sum_{x}"), w));
    let vertex_sums = AXES.map(|x| m.input(format!("vertex_sum_{x}"), w));

    m.comment("A mesh starts when the last one is written and none of its rows is left.");
    let skinning = m.reg_reset("skinning_now", 1, 0);
    let rows_left = m.reg_reset("rows_left", a, 0);
    let no_rows = m.wire("no_rows", 1);
    let idle = (no_rows.get() & !(skinning.q | rows_left.q.any())).named("idle");
    let start_ready = (idle & may_start).named("starts_if_asked");
    let start = (start_valid & start_ready).named("start");
    m.group(START);
    m.output("start_ready", start_ready);
    m.group("High while a mesh is being skinned, from the clock after its start");
    m.output("skinning", skinning.q);
    let one = m.lit(1u8, a);

    m.comment("Vectors ahead of their use: the palette's, then the vertices at rest.");
    let count_bits = joints.width() + 2;
    let column_unit = m.lit(1u8, count_bits);
    let columns = joints.concat(m.zero(2)).named("columns");
    let columns_to_request = m.reg_reset("columns_to_request", count_bits, 0);
    let column_address = m.reg("column_address", a);
    let rest_to_request = m.reg_reset("rest_to_request", a, 0);
    let rest_address = m.reg("rest_address", a);
    let requests_column = columns_to_request.q.any().named("requests_column");
    let vector_wanted = (requests_column | rest_to_request.q.any()).named("vector_wanted");
    let pop_vector = m.wire("pop_vector", 1);
    let vector_prefetch = prefetch(
        plan,
        "vector_prefetch",
        vector.width,
        config.skinning_vertices_ahead,
        a,
    )?;
    let vector_address = requests_column.mux(column_address.q, rest_address.q);
    let vectors = m.instance(
        "vectors",
        &vector_prefetch,
        &[
            ("fetch_valid", vector_wanted),
            ("fetch_address", vector_address),
            ("request_ready", vector_port[0]),
            ("response_valid", vector_port[1]),
            ("response_tag", vector_port[2]),
            ("response_data", vector_port[3]),
            ("pop", pop_vector.get()),
        ],
    );
    let requested = (vector_wanted & vectors.get("fetch_ready")).named("vector_requested");
    let column_requested = (requested & requests_column).named("column_requested");
    let rest_requested = (requested & !requests_column).named("rest_requested");
    columns_to_request.next_when(
        start | column_requested,
        start.mux(columns, columns_to_request.q - column_unit),
    );
    column_address.next_when(
        start | column_requested,
        start.mux(palette, column_address.q + one),
    );
    rest_to_request.next_when(
        start | rest_requested,
        start.mux(vertices, rest_to_request.q - one),
    );
    rest_address.next_when(
        start | rest_requested,
        start.mux(rest, rest_address.q + one),
    );
    m.group("Vertex memory: requests");
    for name in ["valid", "address", "tag"] {
        m.output(
            format!("vertex_request_{name}"),
            vectors.get(&format!("request_{name}")),
        );
    }

    m.comment("Rows of influences ahead of their use.");
    let row_address = m.reg("row_address", a);
    let rows_wanted = rows_left.q.any().named("rows_wanted");
    let pop_row = m.wire("pop_row", 1);
    let row_prefetch = prefetch(
        plan,
        "row_prefetch",
        row.width,
        config.skinning_rows_ahead,
        a,
    )?;
    let fetched_rows = m.instance(
        "rows",
        &row_prefetch,
        &[
            ("fetch_valid", rows_wanted),
            ("fetch_address", row_address.q),
            ("request_ready", row_port[0]),
            ("response_valid", row_port[1]),
            ("response_tag", row_port[2]),
            ("response_data", row_port[3]),
            ("pop", pop_row.get()),
        ],
    );
    no_rows.drive(fetched_rows.get("empty"));
    let row_requested = (rows_wanted & fetched_rows.get("fetch_ready")).named("row_requested");
    rows_left.next_when(start | row_requested, start.mux(rows, rows_left.q - one));
    row_address.next_when(
        start | row_requested,
        start.mux(influences, row_address.q + one),
    );
    m.group("Influence memory: requests");
    for name in ["valid", "address", "tag"] {
        m.output(
            format!("influence_request_{name}"),
            fetched_rows.get(&format!("request_{name}")),
        );
    }

    m.comment("The palette's vectors go into its memories as they come.");
    let columns_to_come = m.reg_reset("columns_to_come", count_bits, 0);
    let column_place = m.reg("column_place", joint_width + 2);
    let loading = columns_to_come.q.any().named("loading");
    let vector_here = vectors.get("valid");
    let column_comes = (vector_here & loading).named("column_comes");
    columns_to_come.next_when(
        start | column_comes,
        start.mux(columns, columns_to_come.q - column_unit),
    );
    let place_unit = m.lit(1u8, joint_width + 2);
    column_place.next_when(
        start | column_comes,
        start.mux(m.zero(joint_width + 2), column_place.q + place_unit),
    );
    m.group("To the geometry unit: a column of a joint's matrix");
    m.output("palette_valid", column_comes);
    m.output("palette_joint", column_place.q.high(joint_width));
    m.output("palette_column", column_place.q.low(2));
    m.output("palette_data", vectors.get("front"));

    m.comment("Issue: an influence goes with its vertex unless either is missing, or room for a vertex that it completes.");
    let slot_bits = bits_for(INFLUENCES_PER_ROW as u64);
    let slot = m.reg("slot", slot_bits);
    let front_row = fetched_rows.get("front");
    let influence_width = row.width / INFLUENCES_PER_ROW as u32;
    let slots: Vec<_> = (0..INFLUENCES_PER_ROW as u32)
        .map(|k| front_row.field(k * influence_width, influence_width))
        .collect();
    let influence = pick(slot.q, &slots).named("influence");
    // All slots are alike, and the first begins at bit 0.
    let part = |name: &str| {
        let field = row.field(&format!("{name}0"));
        influence
            .field(field.lsb, field.width)
            .named(format!("influence_{name}"))
    };
    let (weight, joint, last) = (part("weight"), part("joint"), part("last"));
    let room = m.wire("room", 1);
    let vertex_missing = (!vector_here | loading).named("vertex_missing");
    let row_missing = (!fetched_rows.get("valid")).named("row_missing");
    let room_missing = (last & !room.get()).named("room_missing");
    let issue = (skinning.q & !(vertex_missing | row_missing | room_missing)).named("issue");
    let completes = (issue & last).named("completes");
    let last_slot = slot.q.all().named("last_slot");
    let slot_unit = m.lit(1u8, slot_bits);
    slot.next_when(
        start | issue,
        start.mux(m.zero(slot_bits), slot.q + slot_unit),
    );
    m.comment("What is left of the last row when the mesh is complete is of no use.");
    pop_row.drive(fetched_rows.get("valid") & (!skinning.q | (issue & last_slot)));
    pop_vector.drive(column_comes | completes);
    let position = m.reg("position", POSITION_BITS);
    let position_unit = m.lit(1u8, POSITION_BITS);
    position.next_when(
        start | issue,
        (start | last).mux(m.zero(POSITION_BITS), position.q + position_unit),
    );
    let issued = m.reg_reset("issued", 1, 0);
    issued.next(issue);
    let hold = |name: &str, value: Signal<'_>| {
        let register = m.reg(format!("issued_{name}"), value.width());
        register.next(value);
        m.output(format!("issue_{name}"), register.q);
        register.q
    };
    m.group("To the geometry unit: an influence, and which of its vertex's it is");
    m.output("issue_valid", issued.q);
    hold("joint", joint.low(joint_width));
    let front_vector = vectors.get("front");
    for (k, x) in AXES.into_iter().enumerate() {
        hold(x, front_vector.field(k as u32 * w, w));
    }
    hold("weight", m.zero(1).concat(weight));
    hold("position", position.q);
    let issued_last = hold("last", last);

    m.comment("Accumulation: the first and the second, the third and the fourth, then both; an absent one is 0.");
    let p = m.pipeline();
    let odd = weighted_position.bit(0);
    let first_of_pair = (weighted_valid & !odd).named("first_of_pair");
    let pair_ends = (weighted_valid & (odd | weighted_last)).named("pair_ends");
    let ready = p.enter(pair_ends).cleared_by_reset().register();
    let upper = p
        .enter(weighted_position.bit(1))
        .named("upper_pair")
        .register();
    let complete = p.enter(weighted_last).named("completes_vertex").register();
    let start_of_sum = ready.stage().unwrap_or(0);
    m.group("To the geometry unit: operands of the sums of two weighted ones");
    for (x, number) in AXES.into_iter().zip(weighted) {
        let first = m.reg(format!("first_{x}"), w);
        first.next_when(first_of_pair, number);
        m.output(format!("pair_a_{x}"), p.enter(number).register().untimed());
        let other = first.q & odd.repeat(w);
        m.output(
            format!("pair_b_{x}"),
            p.enter(other.named(format!("other_{x}")))
                .register()
                .untimed(),
        );
    }
    let at_pair = start_of_sum + sum_latency;
    let pair_done = ready.at(at_pair).untimed().named("pair_done");
    let upper_done = upper.at(at_pair).untimed().named("upper_done");
    let start_of_vertex = at_pair + 1;
    m.group("To the geometry unit: operands of the sums of two sums");
    for (x, sum) in AXES.into_iter().zip(pair_sums) {
        let lower = m.reg(format!("lower_{x}"), w);
        lower.next_when(pair_done & !upper_done, sum);
        m.output(
            format!("vertex_a_{x}"),
            p.enter_at(sum, at_pair).register().untimed(),
        );
        let other = (lower.q & upper_done.repeat(w)).named(format!("lower_sum_{x}"));
        m.output(
            format!("vertex_b_{x}"),
            p.enter_at(other, at_pair).register().untimed(),
        );
    }
    let vertex_ready = (ready & complete).named("vertex_ready").cleared_by_reset();
    let done_at = start_of_vertex + sum_latency;
    let vertex_done = vertex_ready.at(done_at).untimed().named("vertex_done");

    m.comment("The write queue, in block RAM: always read where the front is next, a word shows two clocks after it came.");
    let depth = config.skinning_vertices_waiting;
    let index_bits = bits_for(u64::from(depth));
    let queue = m.memory("write_queue", depth, vector.width, Style::Block);
    let head = m.reg_reset("queue_head", index_bits, 0);
    let tail = m.reg_reset("queue_tail", index_bits, 0);
    let index_unit = m.lit(1u8, index_bits);
    let (first_index, last_index) = (m.zero(index_bits), u128::from(depth) - 1);
    let next_tail = tail
        .q
        .equals(last_index)
        .mux(first_index, tail.q + index_unit);
    let after_head = head
        .q
        .equals(last_index)
        .mux(first_index, head.q + index_unit);
    let [x, y, z] = vertex_sums;
    let queue_data = m.concat(&[z, y, x]);
    queue.write(vertex_done, tail.q, queue_data);
    tail.next_when(vertex_done, next_tail);
    let written = m.wire("written", 1);
    let readable = m.reg_reset("queue_grows", 1, 0);
    readable.next(vertex_done);
    let queued = Occupancy::new(plan, &m, "queue_count", depth, readable.q, written.get());
    let shown = queued.any;
    let next_head = written.get().mux(after_head, head.q).named("next_head");
    head.next(next_head);
    let front = queue.read(next_head);
    written.drive(shown & write_ready);
    let under_way = Occupancy::new(
        plan,
        &m,
        "vertices_under_way",
        depth,
        completes,
        written.get(),
    );
    room.drive(under_way.room);
    let next_written = m.reg("next_written", a);
    next_written.next_when(
        start | written.get(),
        start.mux(target, next_written.q + one),
    );
    m.group("Vertex memory: writes");
    m.output("write_valid", shown);
    m.output("write_address", next_written.q);
    m.output("write_data", front);

    m.comment("The end: the last vertex is written.");
    let vertices_left = m.reg_reset("vertices_left", a, 0);
    vertices_left.next_when(
        start | written.get(),
        start.mux(vertices, vertices_left.q - one),
    );
    let over = (skinning.q & !(loading | vertices_left.q.any())).named("over");
    skinning.next(start | (skinning.q & !over));
    let done = m.reg_reset("mesh_done", 1, 0);
    done.next(over);
    m.group("High for a clock when a mesh is complete");
    m.output("done", done.q);
    m.group("Counters' events");
    m.output("influence_issued", issue);

    let unit = Unit {
        start,
        start_vertices: vertices,
        skinning: skinning.q,
        over,
        columns_to_request: columns_to_request.q,
        rest_to_request: rest_to_request.q,
        vector_wanted,
        vector_address,
        vector_requested: requested,
        column_requested,
        rest_requested,
        vectors: Reader::of(&vectors, config.skinning_vertices_ahead, pop_vector.get()),
        rows_wanted,
        row_address: row_address.q,
        row_requested,
        rows: Reader::of(&fetched_rows, config.skinning_rows_ahead, pop_row.get()),
        columns_to_come: columns_to_come.q,
        loading,
        column_comes,
        room: room.get(),
        room_missing,
        issue,
        completes,
        issued: issued.q,
        issued_last,
        weighted_valid,
        weighted_last,
        summing: vertex_ready.stages(start_of_sum..=done_at),
        vertex_done,
        depth,
        queue,
        queue_data,
        queue_head: head.q,
        queue_tail: tail.q,
        queue_grows: readable.q,
        queued,
        under_way,
        write_valid: shown,
        write_ready,
        write_address: next_written.q,
        write_data: front,
        written: written.get(),
        vertices_left: vertices_left.q,
    };
    properties::conserves(&m, &unit);
    properties::write_queue(&m, &unit);
    m.finish()
}

/// Sums that the triangle test makes at once: a pair's in each component, then a vertex's.
const SUMS: usize = 6;

/// What the geometry unit is given while it is borrowed.
pub(super) struct Borrower<'b> {
    /// Whether it is: constant while anything of skinning is under way.
    pub active: Signal<'b>,
    palette_valid: Signal<'b>,
    palette_column: Signal<'b>,
    pub palette_joint: Signal<'b>,
    pub palette_data: Signal<'b>,
    issued: [Signal<'b>; 3],
    /// Of the influence that is issued.
    pub joint: Signal<'b>,
    pub point: [Signal<'b>; 3],
    pub weight: Signal<'b>,
    /// By the names of the triangle test's inputs, `sum_a_0` and so on.
    pub operands: Vec<(String, Signal<'b>)>,
}

/// How the processor and the triangle test call the operands and the sum of one of [`SUMS`].
fn sum_names(k: usize) -> [(String, String); 3] {
    let (of, x) = (["pair", "vertex"][k / 3], AXES[k % 3]);
    [("a_", "sum_a_"), ("b_", "sum_b_"), ("sum_", "sum_")]
        .map(|(processor, test)| (format!("{of}_{processor}{x}"), format!("{test}{k}")))
}

impl<'b> Borrower<'b> {
    /// The geometry unit's inputs from the processor, named as the processor's outputs are, after `skin_`.
    pub fn new(m: &'b Builder, plan: &Plan) -> Borrower<'b> {
        let (w, joint_width) = (plan.number(), joint_bits(plan));
        m.group("Skinning: whether it borrows this unit");
        let active = m.input("skinning", 1);
        let input = |name: &str, width| m.input(format!("skin_{name}"), width);
        m.group("Skinning: a column of a joint's matrix");
        let palette_valid = input("palette_valid", 1);
        let palette_joint = input("palette_joint", joint_width);
        let palette_column = input("palette_column", 2);
        let palette_data = input("palette_data", Record::vertex(plan.format).width);
        m.group("Skinning: an influence, and which of its vertex's it is");
        let issued = ISSUED.map(|(name, width)| input(&format!("issue_{name}"), width));
        let joint = input("issue_joint", joint_width);
        let point = AXES.map(|x| input(&format!("issue_{x}"), w));
        let weight = input("issue_weight", w);
        m.group("Skinning: numbers to add");
        let operands = (0..SUMS).flat_map(|k| {
            let [a, b, _] = sum_names(k);
            [a, b].map(|(processor, test)| (test, input(&processor, w)))
        });
        Borrower {
            active,
            palette_valid,
            palette_column,
            palette_joint,
            palette_data,
            issued,
            joint,
            point,
            weight,
            operands: operands.collect(),
        }
    }

    /// Whether a palette's column comes, and is this one.
    pub fn writes_column(&self, column: u128) -> Signal<'b> {
        self.palette_valid & self.palette_column.equals(column)
    }

    /// The geometry unit's outputs to the processor: what was issued, moved and weighted, with what it was issued with, and
    /// sums.
    pub fn give_back(&self, m: &'b Builder, p: &Pipeline<'b>, tested: &Outputs<'b>) {
        m.group(
            "Skinning: an influence's vertex moved and weighted, and which of its vertex's it is",
        );
        let weighted = AXES.map(|x| tested.get(&format!("weighted_{x}")));
        let at = weighted[0].stage().unwrap_or(0);
        for ((name, _), signal) in ISSUED.into_iter().zip(self.issued) {
            let entered = p.enter(signal);
            let entered = match name {
                "valid" => entered.cleared_by_reset(),
                _ => entered,
            };
            m.output(format!("skin_weighted_{name}"), entered.at(at).untimed());
        }
        for (x, number) in AXES.into_iter().zip(weighted) {
            m.output(format!("skin_weighted_{x}"), number.untimed());
        }
        m.group("Skinning: sums");
        for k in 0..SUMS {
            let [.., (processor, test)] = sum_names(k);
            m.output(format!("skin_{processor}"), tested.get(&test).untimed());
        }
    }
}
