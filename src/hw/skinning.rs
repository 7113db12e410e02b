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
use super::prefetch::{self, Occupancy, pick, prefetch};
use super::properties::Reader;
use super::ray::Vector;
use super::triangle;
use crate::bkd::layout::{INFLUENCES_PER_ROW, Record, fields};
use crate::hdl::bundle::Axes;
use crate::hdl::{
    Builder, Flow, HdlError, Module, ReadInputs, ReadOutputs, Signals, Specs, Style, Write,
    bits_for,
};
use crate::{bundle, interface};
use properties::Unit;
use std::sync::Arc;

/// Bits that number an influence of its vertex.
const POSITION_BITS: u32 = 2;

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

bundle! {
    /// A mesh to skin: indices and counts of records.
    pub struct Mesh(plan: &Plan) {
        palette: plan.address(),
        joints: bits_for(u64::from(plan.config.skinning_joints) + 1),
        influences: plan.address(),
        rows: plan.address(),
        rest: plan.address(),
        vertices: plan.address(),
        target: plan.address(),
    }
}

bundle! {
    /// What goes with an influence through the geometry unit and comes back with the result: which of its vertex's it is.
    pub struct Mark() {
        position: POSITION_BITS,
        last: 1,
    }
}

bundle! {
    /// An influence, and the vertex at rest that it moves.
    pub struct Influence(plan: &Plan) {
        joint: joint_bits(plan),
        point: ..{Vector}(plan),
        weight: plan.number(),
    }
}

bundle! {
    /// An influence as the processor issues it.
    pub struct Issued(plan: &Plan) {
        influence: ..{Influence}(plan),
        mark: ..{Mark}(),
    }
}

bundle! {
    /// An influence as the geometry unit takes it.
    pub struct Taken(plan: &Plan) {
        mark: ..{Mark}(),
        influence: ..{Influence}(plan),
    }
}

bundle! {
    /// A vertex moved and weighted.
    pub struct Weighted(plan: &Plan) {
        mark: ..{Mark}(),
        point: ..{Vector}(plan),
    }
}

bundle! {
    /// A column of a joint's matrix.
    pub struct Column(plan: &Plan) {
        joint: joint_bits(plan),
        column: 2,
        data: Record::vertex(plan.format).width,
    }
}

bundle! {
    /// Numbers to add.
    pub struct Operands(plan: &Plan) {
        a: plan.number(),
        b: plan.number(),
    }
}

bundle! {
    /// Numbers to add on each axis: weighted ones, and sums of two.
    pub struct Sums(plan: &Plan, pair_heading: &str, vertex_heading: &str) {
        pair_heading { pair: {Axes<Operands> = [(); 3].map(|()| Operands::of(plan))} }
        vertex_heading { vertex: {Axes<Operands> = [(); 3].map(|()| Operands::of(plan))} }
    }
}

interface! {
    pub (plan: &Plan) {
        in "A mesh to skin: indices of its palette, influence rows, vertices at rest and vertices to write, and how many" {
            start: Flow<Mesh>(plan),
        }
        in "Whether the geometry unit is free for it" { may_start: 1 }
        in "" {
            vertex: {ReadInputs}(
                "Vertex memory", "of any latency, in any order",
                vector_tag_bits(plan), Record::vertex(plan.format).width
            ),
            influence: {ReadInputs}(
                "Influence memory", "of any latency, in any order",
                row_tag_bits(plan), Record::influence_row(plan.format).width
            ),
        }
        in "Vertex memory: writes" { write_ready: 1 }
        in "From the geometry unit: a moved vertex times a weight, and which of its vertex's it is" {
            weighted: Flow<Weighted>(plan),
        }
        in "From the geometry unit: sums of two weighted ones, and of two sums" {
            pair_sum: [plan.number(); xyz],
            vertex_sum: [plan.number(); xyz],
        }
        out "A mesh to skin: indices of its palette, influence rows, vertices at rest and vertices to write, and how many" {
            start_ready: 1,
        }
        out "High while a mesh is being skinned, from the clock after its start" { skinning: 1 }
        out "" {
            vertex: {ReadOutputs}("Vertex memory", plan.address(), vector_tag_bits(plan)),
            influence: {ReadOutputs}("Influence memory", plan.address(), row_tag_bits(plan)),
        }
        out "To the geometry unit: a column of a joint's matrix" {
            palette: Flow<Column>(plan),
        }
        out "To the geometry unit: an influence, and which of its vertex's it is" {
            issue: Flow<Issued>(plan),
        }
        out "" {
            operands: ..{Sums}(
                plan,
                "To the geometry unit: operands of the sums of two weighted ones",
                "To the geometry unit: operands of the sums of two sums"
            ),
        }
        out "Vertex memory: writes" {
            write: Flow<Write>(plan.address(), Record::vertex(plan.format).width),
        }
        out "High for a clock when a mesh is complete" { done: 1 }
        out "Counters' events" { influence_issued: 1 }
    }
}

/// The skinning processor of a machine whose triangle test is `test`.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub(super) fn module(plan: &Plan, test: &Module) -> Result<Arc<Module>, HdlError> {
    let (w, a) = (plan.number(), plan.address());
    let config = &plan.config;
    let vector = Record::vertex(plan.format);
    let joint_width = joint_bits(plan);

    let m = Builder::new(
        "skinning_processor",
        "the skinning processor: moves vertices at rest by the weighted matrices of a palette.",
    );
    let of_test = triangle::ports(plan);
    let sum_latency =
        of_test.outputs.sum[0].stage(&m, test) - of_test.inputs.pairs.sum_a[0].stage(&m, test);
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let Inputs {
        start: Flow {
            valid: start_valid,
            payload: mesh,
        },
        may_start,
        vertex: vertex_memory,
        influence: influence_memory,
        write_ready,
        weighted,
        pair_sum,
        vertex_sum,
    } = inputs;

    m.comment("A mesh starts when the last one is written and none of its rows is left.");
    let skinning = m.reg_reset("skinning_now", 1, 0);
    let rows_left = m.reg_reset("rows_left", a, 0);
    let no_rows = m.wire("no_rows", 1);
    let idle = (no_rows.get() & !(skinning.q | rows_left.q.any())).named("idle");
    let start_ready = (idle & may_start).named("starts_if_asked");
    let start = (start_valid & start_ready).named("start");
    let one = m.lit(1u8, a);

    m.comment("Vectors ahead of their use: the palette's, then the vertices at rest.");
    let count_bits = mesh.joints.width() + 2;
    let column_unit = m.lit(1u8, count_bits);
    let columns = mesh.joints.concat(m.zero(2)).named("columns");
    let columns_to_request = m.reg_reset("columns_to_request", count_bits, 0);
    let column_address = m.reg("column_address", a);
    let rest_to_request = m.reg_reset("rest_to_request", a, 0);
    let rest_address = m.reg("rest_address", a);
    let requests_column = columns_to_request.q.any().named("requests_column");
    let vector_wanted = (requests_column | rest_to_request.q.any()).named("vector_wanted");
    let pop_vector = m.wire("pop_vector", 1);
    let vector_address = requests_column.mux(column_address.q, rest_address.q);
    let vectors = prefetch(
        plan,
        ("vector_prefetch", "vectors"),
        config.skinning_vertices_ahead,
        prefetch::Inputs {
            fetch_valid: vector_wanted,
            fetch_address: vector_address,
            memory: vertex_memory,
            pop: pop_vector.get(),
        },
    )?;
    let requested = (vector_wanted & vectors.fetch_ready).named("vector_requested");
    let column_requested = (requested & requests_column).named("column_requested");
    let rest_requested = (requested & !requests_column).named("rest_requested");
    columns_to_request.next_when(
        start | column_requested,
        start.mux(columns, columns_to_request.q - column_unit),
    );
    column_address.next_when(
        start | column_requested,
        start.mux(mesh.palette, column_address.q + one),
    );
    rest_to_request.next_when(
        start | rest_requested,
        start.mux(mesh.vertices, rest_to_request.q - one),
    );
    rest_address.next_when(
        start | rest_requested,
        start.mux(mesh.rest, rest_address.q + one),
    );

    m.comment("Rows of influences ahead of their use.");
    let row_address = m.reg("row_address", a);
    let rows_wanted = rows_left.q.any().named("rows_wanted");
    let pop_row = m.wire("pop_row", 1);
    let fetched_rows = prefetch(
        plan,
        ("row_prefetch", "rows"),
        config.skinning_rows_ahead,
        prefetch::Inputs {
            fetch_valid: rows_wanted,
            fetch_address: row_address.q,
            memory: influence_memory,
            pop: pop_row.get(),
        },
    )?;
    no_rows.drive(fetched_rows.empty);
    let row_requested = (rows_wanted & fetched_rows.fetch_ready).named("row_requested");
    rows_left.next_when(
        start | row_requested,
        start.mux(mesh.rows, rows_left.q - one),
    );
    row_address.next_when(
        start | row_requested,
        start.mux(mesh.influences, row_address.q + one),
    );

    m.comment("The palette's vectors go into its memories as they come.");
    let columns_to_come = m.reg_reset("columns_to_come", count_bits, 0);
    let column_place = m.reg("column_place", joint_width + 2);
    let loading = columns_to_come.q.any().named("loading");
    let vector_here = vectors.valid;
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
    let palette = Column {
        joint: column_place.q.high(joint_width),
        column: column_place.q.low(2),
        data: vectors.front,
    };

    m.comment("Issue: an influence goes with its vertex unless either is missing, or room for a vertex that it completes.");
    let slot_bits = bits_for(INFLUENCES_PER_ROW as u64);
    let slot = m.reg("slot", slot_bits);
    let of_row = fields::Influence::of(plan.format);
    let slots: Vec<_> = (0..INFLUENCES_PER_ROW as u32)
        .map(|k| fetched_rows.front.field(k * of_row.width(), of_row.width()))
        .collect();
    let influence = pick("influence", slot.q, &slots).named("influence");
    let fields::Influence {
        weight,
        joint,
        last,
    } = of_row.unpack(influence).named("influence");
    let room = m.wire("room", 1);
    let vertex_missing = (!vector_here | loading).named("vertex_missing");
    let row_missing = (!fetched_rows.valid).named("row_missing");
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
    pop_row.drive(fetched_rows.valid & (!skinning.q | (issue & last_slot)));
    pop_vector.drive(column_comes | completes);
    let position = m.reg("position", POSITION_BITS);
    let position_unit = m.lit(1u8, POSITION_BITS);
    position.next_when(
        start | issue,
        (start | last).mux(m.zero(POSITION_BITS), position.q + position_unit),
    );
    let issued = m.reg_reset("issued", 1, 0);
    issued.next(issue);
    let point = fields::Vertex::of(plan.format).unpack(vectors.front);
    let influence = Influence {
        joint: joint.low(joint_width),
        point: Vector {
            axes: point.position,
        },
        weight: m.zero(1).concat(weight),
    };
    let position = position.q;
    let mark = Mark { position, last };
    let of_issued = &ports.outputs.issue.payload;
    let influence = of_issued.hold("issued", Issued { influence, mark });

    m.comment("Accumulation: the first and the second, the third and the fourth, then both; an absent one is 0.");
    let p = m.pipeline();
    let (weighted_valid, Weighted { mark, point }) = (weighted.valid, weighted.payload);
    let odd = mark.position.bit(0);
    let first_of_pair = (weighted_valid & !odd).named("first_of_pair");
    let pair_ends = (weighted_valid & (odd | mark.last)).named("pair_ends");
    let ready = p.enter(pair_ends).cleared_by_reset().register();
    let upper = p.enter(mark.position.bit(1)).named("upper_pair").register();
    let complete = p.enter(mark.last).named("completes_vertex").register();
    let start_of_sum = ready.stage();
    let pair = [0, 1, 2].map(|i| {
        let (x, number) = (AXES[i], point.axes[i]);
        let first = m.reg(format!("first_{x}"), w);
        first.next_when(first_of_pair, number);
        let a = p.enter(number).register().untimed();
        let other = (first.q & odd.repeat(w)).named(format!("other_{x}"));
        let b = p.enter(other).register().untimed();
        Operands { a, b }
    });
    let at_pair = start_of_sum + sum_latency;
    let pair_done = ready.at(at_pair).untimed().named("pair_done");
    let upper_done = upper.at(at_pair).untimed().named("upper_done");
    let start_of_vertex = at_pair + 1;
    let vertex = [0, 1, 2].map(|i| {
        let (x, sum) = (AXES[i], pair_sum[i]);
        let lower = m.reg(format!("lower_{x}"), w);
        let lower_done = (pair_done & !upper_done).hinted("lower_done");
        lower.next_when(lower_done, sum);
        let a = p.enter_at(sum, at_pair).register().untimed();
        let other = (lower.q & upper_done.repeat(w)).named(format!("lower_sum_{x}"));
        let b = p.enter_at(other, at_pair).register().untimed();
        Operands { a, b }
    });
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
    let queue_data = fields::Vertex::of(plan.format).pack(fields::Vertex {
        position: vertex_sum,
    });
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
        start.mux(mesh.target, next_written.q + one),
    );

    m.comment("The end: the last vertex is written.");
    let vertices_left = m.reg_reset("vertices_left", a, 0);
    vertices_left.next_when(
        start | written.get(),
        start.mux(mesh.vertices, vertices_left.q - one),
    );
    let over = (skinning.q & !(loading | vertices_left.q.any())).named("over");
    skinning.next(start | (skinning.q & !over));
    let done = m.reg_reset("mesh_done", 1, 0);
    done.next(over);
    let outputs = Outputs {
        start_ready,
        skinning: skinning.q,
        vertex: ReadOutputs {
            request: vectors.request,
        },
        influence: ReadOutputs {
            request: fetched_rows.request,
        },
        palette: Flow::new(column_comes, palette),
        issue: Flow::new(issued.q, influence),
        operands: Sums { pair, vertex },
        write: Flow::new(
            shown,
            Write {
                address: next_written.q,
                data: front,
            },
        ),
        done: done.q,
        influence_issued: issue,
    };
    ports.outputs.outputs(&m, outputs);

    let unit = Unit {
        inputs,
        outputs,
        start,
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
        written: written.get(),
        vertices_left: vertices_left.q,
    };
    properties::conserves(&m, &unit);
    properties::write_queue(&m, &unit);
    m.finish()
}
