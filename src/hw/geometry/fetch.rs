//! Leaf fetch: requests the record of a leaf, then its vertices, and counts the responses until the leaf is complete.

use super::{Fetched, Inputs, VECTORS_OF_INSTANCE, VERTICES_OF_TRIANGLE};
use crate::bkd::layout::fields;
use crate::bundle;
use crate::hdl::fifo;
use crate::hdl::{Builder, Flow, HdlError, Memory, Request, Signal, Specs, Style};
use crate::hw::plan::Plan;
use crate::hw::ray::Context;

/// Width of the index of a vertex or vector within its leaf, in the tags of requests.
pub(in crate::hw) const CORNER_BITS: u32 = 3;

bundle! {
    /// The tag of the request for a vertex or vector.
    struct Corner(plan: &Plan) {
        number: CORNER_BITS,
        packet: plan.packet_bits(),
    }
}

bundle! {
    /// The vertices to fetch for a packet, or an instance's first vector.
    pub(super) struct Job(plan: &Plan) {
        packet: plan.packet_bits(),
        instance: 1,
        v0: plan.address(),
        v1: plan.address(),
        v2: plan.address(),
    }
}

/// The signals of leaf fetch for other parts and for the properties.
pub(super) struct Fetch<'b> {
    pub leaf: TakenLeaf<'b>,
    pub record: Fetched<Signal<'b>>,
    pub requests: VertexRequests<'b>,
    pub arrival: Arrival<'b>,
}

/// A leaf that arrives, and the request for its record in the same cycle.
pub(super) struct TakenLeaf<'b> {
    /// Whether it is accepted.
    pub taken: Signal<'b>,
    pub is_instance: Signal<'b>,
    /// Whether the leaf is an instance, by packet.
    pub instance_leaves: Memory<'b>,
    pub request: Flow<Request<Signal<'b>>, Signal<'b>>,
}

/// The requests for the vertices of the leaf at the front of the queue.
pub(super) struct VertexRequests<'b> {
    pub queue: fifo::Placed<'b>,
    pub job: Job<Signal<'b>>,
    /// The index of the requested vertex or vector, whether it is the leaf's last, and whether the request is accepted.
    pub corner: Signal<'b>,
    pub last_corner: Signal<'b>,
    pub fire: Signal<'b>,
    pub request: Flow<Request<Signal<'b>>, Signal<'b>>,
}

/// A vertex or vector that arrives.
pub(super) struct Arrival<'b> {
    pub number: Signal<'b>,
    pub of: Fetched<Signal<'b>>,
    /// The number of earlier arrivals, by packet.
    pub counts: Memory<'b>,
    /// Whether the count is that of the leaf's last vertex, and whether the last vertex arrives.
    pub last_arrives: Signal<'b>,
    pub complete: Signal<'b>,
}

/// Accepts leaves at the ports, drives the requests to both memories, and signals a complete leaf in the cycle of its last response.
/// One vertex is requested in each cycle in which the vertex memory is ready. The first request of a leaf is
/// [`Plan::read_latency`] + 2 cycles after the arrival of its record, because the queue is in block RAM.
pub(super) fn fetch<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
) -> Result<Fetch<'b>, HdlError> {
    let leaf = take(plan, m, inputs);
    m.comment(
        "Response with a record: its three vertices, or its six consecutive vectors, are requested, one per cycle.",
    );
    let record = Fetched::of(plan).unpack(inputs.record.response.payload.tag);
    let requests = request_vertices(plan, m, inputs, record)?;
    m.comment("Vertices and vectors arrive in any order; the last one completes the leaf.");
    let arrival = count_arrivals(plan, m, inputs, leaf.instance_leaves);
    Ok(Fetch {
        leaf,
        record,
        requests,
        arrival,
    })
}

/// Accepts a leaf in the cycle in which its record can be requested.
fn take<'b>(plan: &Plan, m: &'b Builder, inputs: &Inputs<Signal<'b>>) -> TakenLeaf<'b> {
    m.comment("A leaf is accepted when its record can be requested. Its tag marks the leaf of an instance.");
    let (valid, leaf) = (inputs.leaf.valid, inputs.leaf.payload);
    let taken = (valid & inputs.record.request_ready).named("take_leaf");
    let inside = Context::of(plan).unpack(leaf.context).inside;
    let is_instance = (inputs.instanced & !inside).named("leaf_is_instance");
    let packets = plan.packets();
    let instance_leaves = m.memory("instance_leaf_memory", packets, 1, Style::Distributed);
    instance_leaves.write(taken, leaf.packet, is_instance);
    let tag = Fetched::of(plan).pack(Fetched {
        packet: leaf.packet,
        instance: is_instance,
    });
    let address = leaf.address;
    TakenLeaf {
        taken,
        is_instance,
        instance_leaves,
        request: Flow::new(valid, Request { address, tag }),
    }
}

/// Queues the packets whose record has arrived, and requests the vertices of the front packet.
fn request_vertices<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    record: Fetched<Signal<'b>>,
) -> Result<VertexRequests<'b>, HdlError> {
    let a = plan.address();
    let Flow { valid, payload } = inputs.record.response;
    let triangle = fields::Triangle::of().unpack(payload.data);
    let job = Job::of(plan);
    let job_done = m.wire("job_done", 1);
    let queue = plan.block_queue(
        "vertex_queue",
        plan.packets(),
        valid,
        job.pack(Job {
            packet: record.packet,
            instance: record.instance,
            // The index of an instance's first vector is in the same field as that of a triangle's first vertex.
            v0: triangle.v0.low(a).hinted("first_vertex"),
            v1: triangle.v1.low(a).hinted("second_vertex"),
            v2: triangle.v2.low(a).hinted("third_vertex"),
        }),
        job_done.get(),
    )?;
    let corner = m.reg_reset("corner", CORNER_BITS, 0);
    let fire = (queue.valid & inputs.vertex.request_ready).named("vertex_fire");
    let job = job.unpack(queue.front);
    let last_corner = corner
        .q
        .eq(last_corner_of(job.instance))
        .named("last_corner");
    corner.next_when(
        fire,
        last_corner.mux(m.zero(CORNER_BITS), corner.q + m.lit(1u8, CORNER_BITS)),
    );
    job_done.drive(fire & last_corner);
    let vector_address = (job.v0 + corner.q.extend(a)).named("vector_address");
    let vertex_address = m
        .select(corner.q.low(2), &[job.v0, job.v1, job.v2])
        .named("vertex_address");
    let request = Request {
        address: job.instance.mux(vector_address, vertex_address),
        tag: Corner::of(plan).pack(Corner {
            number: corner.q,
            packet: job.packet,
        }),
    };
    Ok(VertexRequests {
        request: Flow::new(queue.valid, request),
        queue,
        job,
        corner: corner.q,
        last_corner,
        fire,
    })
}

/// Counts arrivals, by packet.
fn count_arrivals<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    instance_leaves: Memory<'b>,
) -> Arrival<'b> {
    let Flow { valid, payload } = inputs.vertex.response;
    let Corner { number, packet } = Corner::of(plan).unpack(payload.tag);
    let packets = plan.packets();
    let counts = m.memory("arrival_memory", packets, CORNER_BITS, Style::Distributed);
    let before = counts.read_now(packet);
    let instance = instance_leaves
        .read_now(packet)
        .named("arrived_is_instance");
    let last_arrives = before.eq(last_corner_of(instance)).named("last_arrives");
    let complete = (valid & last_arrives).named("leaf_complete");
    let zero = m.zero(CORNER_BITS);
    let counted = last_arrives.mux(zero, before + m.lit(1u8, CORNER_BITS));
    counts.write(
        inputs.sweep | valid,
        inputs.sweep.mux(inputs.sweep_packet, packet),
        inputs.sweep.mux(zero, counted),
    );
    Arrival {
        number,
        of: Fetched { packet, instance },
        counts,
        last_arrives,
        complete,
    }
}

/// The last of a leaf's vertices or vectors.
fn last_corner_of(is_instance: Signal<'_>) -> Signal<'_> {
    let m = is_instance.module();
    is_instance.mux(
        m.lit(VECTORS_OF_INSTANCE - 1, CORNER_BITS),
        m.lit(VERTICES_OF_TRIANGLE - 1, CORNER_BITS),
    )
}
