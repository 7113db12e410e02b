//! The geometry unit: fetches a leaf and its vertices, and passes the packet's rays through the triangle test, one per cycle.
//!
//! - A leaf that is a **triangle** takes one slot of the test per ray; the hits are merged.
//! - A leaf that is an **instance** of an object takes three slots per ray, in which the operators of the test transform the ray:
//!   *box* (the ray's interval in the instance's box: its window), *direction* and *origin* (each a matrix times a vector). The
//!   transformed ray passes through ray setup again, and the packet continues in object space.
//!
//! A packet has at most one leaf in flight. So all state is addressed by the packet number, each queue has one entry per packet,
//! and no queue can overflow. Rays outside the mask of a leaf are skipped without a slot.
//!
//! While no packet is in flight, the skinning processor (`skinning.rs`) can use the test: it writes a palette of matrices and then
//! issues one influence per cycle, which takes one slot.
//!
//! Each part has a file; a leaf passes the parts in this order:
//!
//! | part | function |
//! |---|---|
//! | `fetch` | requests the record and the vertices of a leaf, and signals when all have arrived |
//! | `issue` | issues slots of the test, one per cycle |
//! | `vectors`, `rays` | store vertices, vectors and matrices, and rays; each slot reads its data |
//! | `operands` | selects the operands of the test for each slot |
//! | `object` | sends transformed rays to ray setup |
//! | `leaves` | stores the data of a leaf that is needed after the test |
//! | `merge` | merges hits |

mod fetch;
mod issue;
mod leaves;
mod merge;
mod object;
mod operands;
mod properties;
mod rays;
mod stages;
mod vectors;

use super::plan::Plan;
use super::ray::{Hit, InContext, Interval, Leaf, Limit, Limits, Line, Place, Start, Tested};
use super::skinning::{Column, Sums, Taken, Weighted};
use super::triangle;
use crate::bkd::layout::Record;
use crate::hdl::{Builder, Flow, HdlError, Module, ReadInputs, ReadOutputs, Signal, Specs};
use crate::{bundle, interface};
pub(super) use fetch::CORNER_BITS;
use issue::ORIGIN_SLOT;
use properties::{Passage, Unit};
use stages::Stages;
use std::sync::Arc;

const VERTICES_OF_TRIANGLE: u8 = 3;
/// Four columns of the matrix, two corners of the box.
const VECTORS_OF_INSTANCE: u8 = 6;

bundle! {
    /// The limits of a ray and its kind, stored for the tests.
    pub struct Kept(plan: &Plan) {
        limits: ..{Limits}(plan),
        any_hit: 1,
    }
}

bundle! {
    /// A ray from ray setup, in the form that tests use.
    pub struct SetUp(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        /// Whether it is in object space.
        object: 1,
        tested: ..{Tested}(plan),
        kept: ..{Kept}(plan),
    }
}

bundle! {
    /// A leaf, as the tag of the request for its record.
    struct Fetched(plan: &Plan) {
        packet: plan.packet_bits(),
        instance: 1,
    }
}

bundle! {
    /// A ray's direction in world space, with packet and slot.
    pub struct World(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        direction: [plan.number(); xyz],
    }
}

bundle! {
    /// A ray in object space.
    pub struct Moved(plan: &Plan) {
        place: ..{Place}(plan),
        line: ..{Line}(plan),
        limits: ..{Limits}(plan),
    }
}

bundle! {
    /// A ray-triangle test.
    pub struct TestTrace(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        record: plan.address(),
        instance: 32,
        hit: 1,
        replaces: 1,
        t: plan.number(),
        u: plan.number(),
        v: plan.number(),
    }
}

bundle! {
    /// A ray transformed into object space, and its interval in the instance's box.
    pub struct TransformTrace(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        record: plan.address(),
        window: ..{Interval}(plan),
        line: ..{Line}(plan),
    }
}

interface! {
    pub (plan: &Plan) {
        in "Ray from ray setup, in world space or in object space" {
            setup: Flow<SetUp>(plan),
        }
        in (format!("Packet of the ray from ray setup, ahead of it by one RAM read (latency {})", plan.read_latency())) {
            setup_next_packet: plan.packet_bits(),
        }
        in "High if leaves in world space are instances: bit right_leaf of the scene's root" {
            instanced: 1,
        }
        in "Leaves from the traversal unit" { leaf: Flow<Leaf>(plan) }
        in "" {
            record: {ReadInputs}(
                "Record memory", "any order, always accepted", plan.packet_bits() + 1, Record::triangle().width
            ),
            vertex: {ReadInputs}(
                "Vertex memory", "any order, always accepted",
                plan.packet_bits() + CORNER_BITS, Record::vertex(plan.format).width
            ),
        }
        in "Skinning: high while it uses this unit" { skinning: 1 }
        in "Skinning: one column of a joint's matrix" {
            skin_palette: Flow<Column>(plan),
        }
        in "Skinning: one influence, and its index within the vertex" {
            skin_issue: Flow<Taken>(plan),
        }
        in "Skinning: operands of the adders" {
            skin: {Sums}(plan, "", ""),
        }
        in "After reset: packet numbers in turn, to clear the counts per packet" {
            sweep: 1,
            sweep_packet: plan.packet_bits(),
        }
        in "Read address of the closest hits; the word is valid one cycle later" {
            read_packet: plan.packet_bits(),
            read_ray: plan.ray_bits(),
        }
        in "Ray as it enters the machine: in the watertight configuration only transformations use its direction" {
            world if (plan.watertight()): Flow<World>(plan),
            setup_shear_z if (plan.watertight()): plan.number(),
        }
        out "Leaves from the traversal unit" { leaf_ready: 1 }
        out "" {
            record: {ReadOutputs}("Record memory", plan.address(), plan.packet_bits() + 1),
            vertex: {ReadOutputs}("Vertex memory", plan.address(), plan.packet_bits() + CORNER_BITS),
        }
        out "Skinning: the vertex transformed by one influence and multiplied by its weight, and the index of the influence" {
            skin_weighted: Flow<Weighted>(plan),
        }
        out "Skinning: sums" {
            skin_pair_sum: [plan.number(); xyz],
            skin_vertex_sum: [plan.number(); xyz],
        }
        out "Ray in object space, to ray setup; tmin and tmax are its interval in the instance" {
            object: Flow<Moved>(plan),
        }
        out "Start of the packet named by setup_next_packet in its object, valid with its ray from ray setup" {
            start: {Start}(plan),
        }
        out "New upper bound for near, from a closer hit" {
            limit: Flow<Limit>(plan),
        }
        out "Leaf complete: all of its tests are merged" {
            done: Flow<InContext>(plan),
        }
        out "Closest hit that was read, one cycle after its address" { read: {Hit}(plan) }
        out "Events for the counters" { slot_taken: 1, test_issued: 1, transform_issued: 1 }
        out "Trace: last ray-triangle test" {
            trace_test if (plan.trace): Flow<TestTrace>(plan),
        }
        out "Trace: last ray transformation, with the ray's interval in the instance's box and the instance's record" {
            trace_transform if (plan.trace): Flow<TransformTrace>(plan),
        }
    }
}

/// The geometry unit, and the triangle test that it contains.
pub struct Geometry {
    pub module: Arc<Module>,
    pub test: Arc<Module>,
}

/// Describes the geometry unit of a machine.
pub fn module(plan: &Plan) -> Result<Geometry, HdlError> {
    let test = triangle::module(plan)?;
    let m = Builder::new(
        "geometry_unit",
        "the geometry unit: fetches the record and the vertices of a leaf, tests the packet's rays, one per cycle, and merges the hits.",
    );
    let ports = ports(plan);
    let inputs = &ports.inputs.inputs(&m);
    let stages = &Stages::of(plan, &m, &test);

    let fetch = m.part(
        "leaf_fetch",
        "requests the record of a leaf, then its vertices, and counts the responses until the leaf is complete.",
        || fetch::fetch(plan, &m, inputs),
    )?;
    let (issue, slot) = m.part(
        "slot_issue",
        "issues the rays of complete leaves to the triangle test, one per cycle; during skinning, the influences of the skinning processor.",
        || {
            let issue = issue::issue(plan, &m, inputs, &fetch)?;
            let slot = issue::enter(plan, &m, inputs, &issue);
            Ok((issue, slot))
        },
    )?;
    let slot = &slot;
    let vectors = m.part(
        "vector_store",
        "stores vertices, vectors of instances and matrices of joints.",
        || vectors::keep(plan, &m, inputs, &fetch.arrival, slot, stages),
    );
    let rays = m.part(
        "ray_store",
        "stores rays in the form that tests and transformations use.",
        || rays::keep(plan, &m, inputs, slot, stages),
    );
    let operands = m.part(
        "operands",
        "selects the operands of the triangle test for each slot.",
        || operands::operands(plan, &m, inputs, slot, stages, vectors, &rays),
    );
    let tested = &triangle::ports(plan).place("test", &m, &test, operands);
    let weighted = m.part(
        "weighted",
        "passes weighted points from the triangle test to the skinning processor, with the marks of their influences.",
        || operands::weighted(inputs, slot, tested),
    );
    let object = m.part(
        "object_rays",
        "sends transformed rays to ray setup, each with its interval in the instance's box.",
        || object::leave(plan, &m, slot, stages, &rays, tested),
    );
    let leaves = m.part(
        "leaf_store",
        "stores the data of a packet's leaf until its rays leave the test.",
        || leaves::keep(plan, &m, inputs, &fetch, slot, stages, object.leaves_at),
    );
    let leaves = &leaves;
    let merge = m.part(
        "hit_merge",
        "keeps the closest hit of each ray and signals the completion of a leaf.",
        || merge::merge(plan, &m, inputs, slot, leaves, rays.kept, tested),
    );

    let [a, b, c, d, e, f] = tested.sum.map(Signal::untimed);
    let outputs = Outputs {
        leaf_ready: inputs.record.request_ready,
        record: ReadOutputs {
            request: fetch.leaf.request,
        },
        vertex: ReadOutputs {
            request: fetch.requests.request,
        },
        skin_weighted: weighted,
        skin_pair_sum: [a, b, c],
        skin_vertex_sum: [d, e, f],
        object: object.ray,
        start: leaves.start,
        limit: merge.limit,
        done: merge.done,
        read: merge.read,
        slot_taken: issue.busy,
        test_issued: issue.is_test(),
        transform_issued: issue.is_transform(ORIGIN_SLOT),
        trace_test: merge.trace,
        trace_transform: (leaves.traced.as_ref()).map(|leaves| object.trace(&rays, leaves)),
    };
    ports.outputs.outputs(&m, outputs);
    properties::conserves(&Unit {
        packets: plan.packets(),
        inputs: *inputs,
        outputs,
        tests: Passage::new(slot, slot.test, stages.hit + 1),
        moves: Passage::new(slot, slot.origin, object.leaves_at),
        fetch,
        issue,
    });
    Ok(Geometry {
        module: m.finish()?,
        test,
    })
}
