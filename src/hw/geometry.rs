//! The geometry unit: fetches a leaf and its vertices, and passes the packet's rays one a clock through the triangle test.
//!
//! - A leaf that is a **triangle** takes a slot of the test for each ray; the hits are merged.
//! - A leaf that is an **instance** of an object takes three slots for each ray, in which the test's own operators transform the ray:
//!   *box* (the ray's interval in the instance's box: its window), *direction* and *origin* (each a matrix times a vector). The
//!   transformed ray goes through ray setup again and the packet goes on in the object's space.
//!
//! A packet has at most one leaf under way, so everything here is numbered by its packet, queues are as deep as there are packets,
//! and nothing can overflow. Rays outside a leaf's mask are skipped and cost nothing.
//!
//! While no packet is under way, the skinning processor (`skinning.rs`) borrows the test: it writes a palette of matrices and then
//! issues an influence a clock, which takes a slot.
//!
//! One file a part, in the order in which a leaf meets them:
//!
//! | part | does |
//! |---|---|
//! | `fetch` | requests a leaf's record and vertices, and says when all are there |
//! | `issue` | issues slots of the test, one a clock |
//! | `vectors`, `rays` | keep vertices, vectors and matrices, and rays; a slot reads its own |
//! | `operands` | chooses what the test takes with a slot |
//! | `object` | takes transformed rays to ray setup |
//! | `leaves` | keeps what is needed of a leaf behind the test |
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
    /// What is kept of a ray for its tests.
    pub struct Kept(plan: &Plan) {
        limits: ..{Limits}(plan),
        any_hit: 1,
    }
}

bundle! {
    /// A ray that has been set up, as tests need it.
    pub struct SetUp(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        /// Whether it is in an object's space.
        object: 1,
        tested: ..{Tested}(plan),
        kept: ..{Kept}(plan),
    }
}

bundle! {
    /// A leaf: the tag of its record's request.
    struct Fetched(plan: &Plan) {
        packet: plan.packet_bits(),
        instance: 1,
    }
}

bundle! {
    /// A direction in the world, and whose it is.
    pub struct World(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        direction: [plan.number(); xyz],
    }
}

bundle! {
    /// A ray in an object's space.
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
    /// A ray taken to an object's space, and its interval in the instance's box.
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
        in "A ray that has been set up, of the world or in an object's space" {
            setup: Flow<SetUp>(plan),
        }
        in "The packet of the ray that will have been set up so many clocks later as a memory's read takes" {
            setup_next_packet: plan.packet_bits(),
        }
        in "Whether leaves in the world are instances of objects: bit right_leaf of the scene's root" {
            instanced: 1,
        }
        in "Leaves from the traversal unit" { leaf: Flow<Leaf>(plan) }
        in "" {
            record: {ReadInputs}(
                "Record memory", "in any order, always taken", plan.packet_bits() + 1, Record::triangle().width
            ),
            vertex: {ReadInputs}(
                "Vertex memory", "in any order, always taken",
                plan.packet_bits() + CORNER_BITS, Record::vertex(plan.format).width
            ),
        }
        in "Skinning: whether it borrows this unit" { skinning: 1 }
        in "Skinning: a column of a joint's matrix" {
            skin_palette: Flow<Column>(plan),
        }
        in "Skinning: an influence, and which of its vertex's it is" {
            skin_issue: Flow<Taken>(plan),
        }
        in "Skinning: numbers to add" {
            skin: {Sums}(plan, "", ""),
        }
        in "After reset, packet numbers in turn, to clear what counts by packet" {
            sweep: 1,
            sweep_packet: plan.packet_bits(),
        }
        in "Closest hits are read by packet and ray; the word is there a clock later" {
            read_packet: plan.packet_bits(),
            read_ray: plan.ray_bits(),
        }
        in "A ray of the world as it comes: the watertight test needs its direction for transformations alone" {
            world if (plan.watertight()): Flow<World>(plan),
            setup_shear_z if (plan.watertight()): plan.number(),
        }
        out "Leaves from the traversal unit" { leaf_ready: 1 }
        out "" {
            record: {ReadOutputs}("Record memory", plan.address(), plan.packet_bits() + 1),
            vertex: {ReadOutputs}("Vertex memory", plan.address(), plan.packet_bits() + CORNER_BITS),
        }
        out "Skinning: an influence's vertex moved and weighted, and which of its vertex's it is" {
            skin_weighted: Flow<Weighted>(plan),
        }
        out "Skinning: sums" {
            skin_pair_sum: [plan.number(); xyz],
            skin_vertex_sum: [plan.number(); xyz],
        }
        out "A ray in an object's space, to be set up; its interval comes as tmin and tmax" {
            object: Flow<Moved>(plan),
        }
        out "Where the packet announced by setup_next_packet starts in its object, when its ray has been set up" {
            start: {Start}(plan),
        }
        out "A closer hit of a ray: what its near must not exceed from now on" {
            limit: Flow<Limit>(plan),
        }
        out "A leaf all of whose tests are merged" {
            done: Flow<InContext>(plan),
        }
        out "The closest hit that was asked for, a clock or two later" { read: {Hit}(plan) }
        out "Counters' events" { slot_taken: 1, test_issued: 1, transform_issued: 1 }
        out "Trace: the ray-triangle test just merged" {
            trace_test if (plan.trace): Flow<TestTrace>(plan),
        }
        out "Trace: the ray just transformed, its interval in the instance's box, and the instance's record" {
            trace_transform if (plan.trace): Flow<TransformTrace>(plan),
        }
    }
}

/// The geometry unit, and the triangle test within.
pub struct Geometry {
    pub module: Arc<Module>,
    pub test: Arc<Module>,
}

/// The geometry unit of a machine.
pub fn module(plan: &Plan) -> Result<Geometry, HdlError> {
    let test = triangle::module(plan)?;
    let m = Builder::new(
        "geometry_unit",
        "the geometry unit: a leaf's triangle and vertices are fetched, the packet's rays tested one a clock, the hits merged.",
    );
    let ports = ports(plan);
    let inputs = &ports.inputs.inputs(&m);
    let stages = &Stages::of(plan, &m, &test);

    let fetch = m.part(
        "leaf_fetch",
        "requests a leaf's record, then its vertices, and counts what arrives until the leaf is complete.",
        || fetch::fetch(plan, &m, inputs),
    )?;
    let (issue, slot) = m.part(
        "slot_issue",
        "lets the rays of complete leaves into the triangle test, one a clock; joints of the skinning processor instead.",
        || {
            let issue = issue::issue(plan, &m, inputs, &fetch)?;
            let slot = issue::enter(plan, &m, inputs, &issue);
            Ok((issue, slot))
        },
    )?;
    let slot = &slot;
    let vectors = m.part(
        "vector_store",
        "keeps vertices, instances' vectors and joints' matrices.",
        || vectors::keep(plan, &m, inputs, &fetch.arrival, slot, stages),
    );
    let rays = m.part(
        "ray_store",
        "keeps what tests and transformations need of a ray.",
        || rays::keep(plan, &m, inputs, slot, stages),
    );
    let operands = m.part(
        "operands",
        "chooses what the triangle test takes with a slot.",
        || operands::operands(plan, &m, inputs, slot, stages, vectors, &rays),
    );
    let tested = &triangle::ports(plan).place("test", &m, &test, operands);
    let weighted = m.part(
        "weighted",
        "says whose the weighted points are that leave the triangle test.",
        || operands::weighted(inputs, slot, tested),
    );
    let object = m.part(
        "object_rays",
        "lets transformed rays leave for ray setup, each with its interval in the instance's box.",
        || object::leave(plan, &m, slot, stages, &rays, tested),
    );
    let leaves = m.part(
        "leaf_store",
        "keeps what is needed of a packet's leaf when its rays leave the test.",
        || leaves::keep(plan, &m, inputs, &fetch, slot, stages, object.leaves_at),
    );
    let leaves = &leaves;
    let merge = m.part(
        "hit_merge",
        "keeps each ray's closest hit, and tells when a leaf is done.",
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
