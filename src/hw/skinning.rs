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
//! Each part has a file: `fetch` (vectors and influence rows), `issue`, `sum` and `write`.
//!
//! What is issued never waits; a vertex's last influence is issued when the write queue has room for the vertex.
//!
//! The reference machine's takes, as Yosys counts them for Virtex-4, 642 LUT4, 1,039 flip-flops, 2 RAMB16 (the write queue) and, as
//! distributed RAM, 200 RAM16X1D, which are 400 LUT4 more; no DSP48. Beside that the geometry unit chooses between its own operands and these.

mod fetch;
mod issue;
mod properties;
mod sum;
mod write;

use super::plan::Plan;
use super::ray::Vector;
use super::triangle;
use crate::bkd::layout::Record;
use crate::hdl::bundle::Axes;
use crate::hdl::{
    Builder, Flow, HdlError, Module, ReadInputs, ReadOutputs, Signal, Specs, Wires, Write, bits_for,
};
use crate::{bundle, interface};
use fetch::{Rows, Vectors};
use issue::Issue;
use properties::Unit;
use std::sync::Arc;
use sum::VertexSums;
use write::Queue;

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
        in "Mesh to skin: index and count of its palette, influence rows, vertices at rest and vertices to write" {
            start: Flow<Mesh>(plan),
        }
        in "High if the geometry unit is available" { may_start: 1 }
        in "" {
            vertex: {ReadInputs}(
                "Vertex memory", "any latency, any order",
                vector_tag_bits(plan), Record::vertex(plan.format).width
            ),
            influence: {ReadInputs}(
                "Influence memory", "any latency, any order",
                row_tag_bits(plan), Record::influence_row(plan.format).width
            ),
        }
        in "Vertex memory: writes" { write_ready: 1 }
        in "From the geometry unit: a transformed vertex times its weight, and the index of the influence" {
            weighted: Flow<Weighted>(plan),
        }
        in "From the geometry unit: sums of two weighted points, and of two sums" {
            pair_sum: [plan.number(); xyz],
            vertex_sum: [plan.number(); xyz],
        }
        out "Mesh to skin: index and count of its palette, influence rows, vertices at rest and vertices to write" {
            start_ready: 1,
        }
        out "High from the cycle after the start of a mesh until it is complete" { skinning: 1 }
        out "" {
            vertex: {ReadOutputs}("Vertex memory", plan.address(), vector_tag_bits(plan)),
            influence: {ReadOutputs}("Influence memory", plan.address(), row_tag_bits(plan)),
        }
        out "To the geometry unit: one column of a joint's matrix" {
            palette: Flow<Column>(plan),
        }
        out "To the geometry unit: one influence, and its index within the vertex" {
            issue: Flow<Issued>(plan),
        }
        out "" {
            operands: ..{Sums}(
                plan,
                "To the geometry unit: operands of the sums of two weighted points",
                "To the geometry unit: operands of the sums of two sums"
            ),
        }
        out "Vertex memory: writes" {
            write: Flow<Write>(plan.address(), Record::vertex(plan.format).width),
        }
        out "High for one cycle when a mesh is complete" { done: 1 }
        out "Events for the counters" { influence_issued: 1 }
    }
}

bundle! {
    /// What later parts tell earlier ones.
    struct Back() {
        /// The front row has been used.
        pop_row: 1,
        /// A vertex's last influence is issued, so the vertex at rest has been used; there is room for one more vertex that is.
        completes: 1,
        room: 1,
        /// All of the mesh is written.
        over: 1,
    }
}

/// What every part is given: the unit's inputs and what later parts tell, and what it is described with.
struct Around<'b> {
    plan: &'b Plan,
    m: &'b Builder,
    inputs: Inputs<Signal<'b>>,
    told: Back<Signal<'b>>,
}

/// A mesh, in the clock in which it starts.
type Start<'b> = Flow<Mesh<Signal<'b>>, Signal<'b>>;

/// The skinning processor of a machine whose triangle test is `test`.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub(super) fn module(plan: &Plan, test: &Module) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "skinning_processor",
        "the skinning processor: transforms vertices at rest with the weighted matrices of a palette.",
    );
    let of_test = triangle::ports(plan);
    let sum_latency =
        of_test.outputs.sum[0].stage(&m, test) - of_test.inputs.pairs.sum_a[0].stage(&m, test);
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    m.comment("Signals from later parts to earlier ones.");
    let back = Back::of().wires(&m, "");
    let told = back.get();

    let around = Around {
        plan,
        m: &m,
        inputs,
        told,
    };

    let rows = m.part(
        "row_fetch",
        "starts meshes and prefetches their influences.",
        || Rows::new(&around),
    )?;
    let vectors = m.part(
        "vector_fetch",
        "prefetches palettes, then vertices at rest.",
        || Vectors::new(&around, rows.start),
    )?;
    let issue = m.part(
        "influence_issue",
        "issues influences to the geometry unit, each with its vertex.",
        || Issue::new(&around, &rows, &vectors),
    );
    let sums = m.part(
        "vertex_sum",
        "adds the weighted points of each vertex.",
        || VertexSums::new(&around, sum_latency),
    );
    let queue = m.part(
        "vertex_write",
        "queues vertices until they are written, and signals the completion of a mesh.",
        || Queue::new(&around, &rows, vectors.loading, &issue, &sums),
    );
    back.drive(Back {
        pop_row: issue.pop_row,
        completes: issue.completes,
        room: queue.under_way.room,
        over: queue.over,
    });
    let outputs = Outputs {
        start_ready: rows.start_ready,
        skinning: rows.skinning,
        vertex: ReadOutputs {
            request: vectors.reader.request,
        },
        influence: ReadOutputs {
            request: rows.reader.request,
        },
        palette: vectors.palette,
        issue: issue.issued,
        operands: sums.operands,
        write: queue.write,
        done: queue.done,
        influence_issued: issue.issue,
    };
    ports.outputs.outputs(&m, outputs);

    let unit = Unit {
        around,
        rows,
        vectors,
        issue,
        sums,
        queue,
    };
    properties::conserves(&m, &unit);
    properties::write_queue(&m, &unit);
    m.finish()
}
