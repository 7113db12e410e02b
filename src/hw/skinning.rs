//! The skinning processor: transforms the vertices at rest of a mesh with the weighted matrices of their joints.
//!
//! It is a stream processor without a program: it copies the palette to the memories of the geometry unit, then prefetches
//! vertices at rest and their influences and pairs them, one influence per cycle. It has no arithmetic: it uses the
//! multipliers and adders of the triangle test in the geometry unit, so no packet may be in flight meanwhile.
//!
//! ```text
//! vector memory ──► prefetch ─┬─► palette memories (geometry unit)
//!                             └─► vertex at rest ─┐                 matrix × point × weight         two sums
//! influence rows ─► prefetch ─► slot of four ─────┴─► issue ─► (geometry unit's triangle test) ─► (its subtractors) ─► write queue
//! ```
//!
//! Each part has a file: `fetch` (vectors and influence rows), `issue`, `sum` and `write`.
//!
//! An issued influence never waits; the last influence of a vertex is issued when the write queue has room for the vertex.
//!
//! Its area in the reference machine, without the operand multiplexers in the geometry unit, is in `docs/numbers.md`.

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

/// Width of the index of an influence within its vertex.
const POSITION_BITS: u32 = 2;

/// Width of a joint number.
pub(super) fn joint_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.skinning_joints))
}

/// Width of the tags of vector reads.
pub(super) fn vector_tag_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.skinning_vertices_ahead))
}

/// Width of the tags of influence row reads.
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
    /// The mark that an influence carries through the geometry unit: its index within the vertex, returned with the result.
    pub struct Mark() {
        position: POSITION_BITS,
        last: 1,
    }
}

bundle! {
    /// An influence and its vertex at rest.
    pub struct Influence(plan: &Plan) {
        joint: joint_bits(plan),
        point: ..{Vector}(plan),
        weight: plan.number(),
    }
}

bundle! {
    /// An influence as issued by the processor.
    pub struct Issued(plan: &Plan) {
        influence: ..{Influence}(plan),
        mark: ..{Mark}(),
    }
}

bundle! {
    /// An influence as accepted by the geometry unit.
    pub struct Taken(plan: &Plan) {
        mark: ..{Mark}(),
        influence: ..{Influence}(plan),
    }
}

bundle! {
    /// A transformed vertex times its weight.
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
    /// Operands of an addition.
    pub struct Operands(plan: &Plan) {
        a: plan.number(),
        b: plan.number(),
    }
}

bundle! {
    /// Operands of the additions on each axis: of two weighted points, and of two sums.
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
    /// The signals from later parts to earlier ones.
    struct Back() {
        /// Removes the front row, which has been used.
        pop_row: 1,
        /// The last influence of a vertex is issued, so its vertex at rest has been used; there is room for one more such vertex.
        completes: 1,
        room: 1,
        /// The whole mesh is written.
        over: 1,
    }
}

/// The environment of every part: the inputs of the unit, the signals from later parts, and the description.
struct Around<'b> {
    plan: &'b Plan,
    m: &'b Builder,
    inputs: Inputs<Signal<'b>>,
    told: Back<Signal<'b>>,
}

/// A mesh, in the cycle of its start.
type Start<'b> = Flow<Mesh<Signal<'b>>, Signal<'b>>;

/// Describes the skinning processor of a machine with the triangle test `test`.
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
