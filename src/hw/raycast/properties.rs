//! Properties of the ray casting unit: every packet number is in one place, so no queue overflows, and hits leave with the tag of
//! their rays; rays in object space have priority over new rays, and none is lost; rays and skinning never use the geometry unit and
//! its port to vertex memory at the same time, and each response reaches the unit that sent the request.
//!
//! The proved properties of the instantiated units are assumptions: the traversal unit finishes each packet once, the geometry unit
//! sends no request between packets, the skinning processor none between meshes, and their ports are stable. Memory is assumed to
//! respond to requests only.

use super::hits::Hits;
use super::packets::Packets;
use super::units::VertexRequest;
use super::{Inputs, Outputs};
use crate::hdl::properties::{assert_shown_stays, count, shown_stays};
use crate::hdl::{Bundle, Proof, Signal};
use crate::hw::plan::Plan;

/// Width of counts of packets and of outstanding vertices.
const BITS: u32 = 16;

/// The assumed limit of outstanding vertices per unit, so that no count wraps.
const OWED_BELOW: u32 = 1024;

/// The unit's signals.
pub(super) struct Watched<'a, 'b> {
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub plan: &'a Plan,
    pub packets: &'a Packets<'b>,
    pub hits: &'a Hits<'b>,
    pub object_valid: Signal<'b>,
    pub paused: Signal<'b>,
    pub finished_packet: Signal<'b>,
    /// Whether a mesh may start, and whether one is skinned.
    pub may_start: Signal<'b>,
    pub skinning: Signal<'b>,
    // Vertex memory.
    pub of_geometry: VertexRequest<'b>,
    pub of_skinner: VertexRequest<'b>,
    pub to_geometry: Signal<'b>,
    pub to_skinner: Signal<'b>,
}

fn wide(signal: Signal<'_>) -> Signal<'_> {
    signal.extend(BITS)
}

pub(super) fn shares(unit: &Watched<'_, '_>) {
    let m = unit.paused.module();
    let proof = m.proof(
        "shares",
        "packet numbers are in one place, hits keep their tag, the geometry unit and its port serve one user, responses reach the requester",
    );
    let proof = &proof;
    unit.packets.free.keep(proof);
    unit.hits.finished.keep(proof);
    proof.cover("a packet leaves", unit.hits.leaves);
    assert_shown_stays(
        proof,
        "hit",
        unit.outputs.hit.valid,
        unit.inputs.hit_ready,
        &[unit.hits.out, unit.hits.ray],
    );
    let request = unit.outputs.vertex.request;
    assert_shown_stays(
        proof,
        "vertex request",
        request.valid,
        unit.inputs.vertex.request_ready,
        &request.payload.leaves(),
    );
    let traversing = count(
        proof,
        BITS,
        "traversing",
        unit.packets.enters,
        unit.hits.finished.push,
    );
    packets(proof, unit, traversing);
    packet(proof, unit);
    proof.assert(
        "a new ray is accepted only if no ray in object space arrives",
        !(unit.packets.take_ray & unit.object_valid),
    );
    proof.assert(
        "a ray waits only for a packet in flight, a ray in object space or a mesh",
        m.or_all(&[
            unit.packets.sweeping,
            unit.outputs.ray_ready,
            unit.object_valid,
            unit.paused,
            unit.packets.under_way.any(),
        ]),
    );
    skinning(proof, unit);
    vertices(proof, unit, traversing);
    seed_faults(proof, unit);
}

fn seed_faults<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>) {
    proof.fault(
        "a ray is accepted while one in object space arrives",
        (unit.outputs.ray_ready.reads(unit.object_valid)).as_value(0),
    );
    proof.fault(
        "a packet starts while a mesh is skinned",
        unit.paused.reads(unit.skinning).as_value(0),
    );
    proof.fault(
        "vertices for skinning also reach the geometry unit",
        unit.to_geometry.reads(unit.skinning).as_value(0),
    );
    proof.fault(
        "a packet is free before its last hit is accepted",
        (unit.hits.leaves.reads(unit.hits.taken)).as_signal(unit.outputs.hit.valid),
    );
    proof.fault(
        "requests of skinning do not reach memory",
        (unit.outputs.vertex.request.valid.reads(unit.skinning)).as_value(0),
    );
}

/// Asserts the numbers of packets in each place.
fn packets<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>, traversing: Signal<'b>) {
    let m = proof.module();
    let all = m.lit(unit.plan.packets(), BITS);
    let (free, finished) = (
        unit.packets.free.count(BITS),
        unit.hits.finished.count(BITS),
    );
    let under_way = wide(unit.packets.under_way);
    proof.assume(
        "the traversal unit finishes packets that it has",
        unit.hits.finished.push.implies(traversing.any()),
    );
    proof.assert(
        "every packet in flight is in traversal, finished or leaving",
        under_way.eq(traversing + finished + wide(unit.hits.out_valid)),
    );
    let swept = free.eq(wide(unit.packets.sweep_packet)) & under_way.is_zero();
    proof.assert(
        "every packet number is free or in flight",
        (unit.packets.sweeping).mux(swept, (free + under_way).eq(all)),
    );
    proof.assert(
        "no more packets are in flight than there are packet numbers",
        under_way.le(all) & traversing.le(all) & finished.le(all),
    );
    proof.assert(
        "each packet number is initialised once",
        (unit.packets.sweeping).implies(wide(unit.packets.sweep_packet).lt(all)),
    );
    proof.assert(
        "no number is pushed to a full queue of free packet numbers",
        unit.packets.free.push.implies(free.lt(all)),
    );
    proof.assert(
        "no packet is pushed to a full queue of finished packets",
        unit.hits.finished.push.implies(finished.lt(all)),
    );
    proof.assert(
        "queues are popped only while they present a word",
        unit.packets.free.pop.implies(unit.packets.free.shows())
            & unit.hits.finished.pop.implies(unit.hits.finished.shows()),
    );
}

/// Watches one arbitrary packet number: its place, and the tag of its first ray.
fn packet<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>) {
    let m = proof.module();
    let packet = proof.any_const("packet", unit.packets.sweep_packet.width());
    proof.assume(
        "the watched packet has a number",
        wide(packet).lt(m.lit(unit.plan.packets(), BITS)),
    );
    let (free, finished) = (&unit.packets.free, &unit.hits.finished);
    let in_front = free.front.eq(packet);
    let enters = unit.packets.enters & in_front;
    let finishes = finished.push & unit.finished_packet.eq(packet);
    let finished_front = finished.front.low(packet.width()).eq(packet);
    let is_free = proof.reg_reset("is_free", 1, 0);
    let is_traversing = proof.reg_reset("is_traversing", 1, 0);
    let is_finished = proof.reg_reset("is_finished", 1, 0);
    let is_out = unit.hits.out_valid & unit.hits.packet.eq(packet);
    let comes = unit.packets.sweeping.mux(
        unit.packets.sweep_packet.eq(packet),
        unit.hits.leaves & unit.hits.packet.eq(packet),
    );
    is_free.next((is_free.q & !enters) | comes);
    is_traversing.next((is_traversing.q & !finishes) | enters);
    is_finished.next((is_finished.q & !(unit.hits.load & finished_front)) | finishes);
    let ray_tag = unit.inputs.ray.payload.tag;
    let tag = proof.reg("tag", ray_tag.width());
    let stored = unit.packets.tags.peek(packet);
    tag.next_when(enters, unit.packets.place.first.mux(ray_tag, stored));

    proof.assume(
        "a packet that is finished was in traversal",
        finishes.implies(is_traversing.q),
    );
    proof.assume(
        "a number that leaves the queue of free numbers was in it",
        (free.valid & in_front).implies(is_free.q),
    );
    proof.assume(
        "a packet that leaves the queue of finished packets was in it",
        (finished.valid & finished_front).implies(is_finished.q),
    );
    proof.assume(
        "the front of the queue of free numbers is stable until it is taken",
        shown_stays(proof, free.valid, free.pop, &[free.front]),
    );

    let to_sweep = unit.packets.sweeping & packet.ge(unit.packets.sweep_packet);
    let places = m.concat(&[is_free.q, is_traversing.q, is_finished.q, is_out]);
    proof.assert(
        "a packet number is in one place",
        places.count_ones(3).eq((!to_sweep).extend(3)),
    );
    proof.assert(
        "the hits of a packet leave with the tag of its first ray",
        is_out.implies(unit.outputs.hit.payload.tag.eq(tag.q)),
    );
    proof.assert(
        "the tag of a packet is stable while it is in flight",
        (is_traversing.q | is_finished.q | is_out).implies(stored.eq(tag.q)),
    );
}

/// Asserts that skinning and packets exclude each other.
fn skinning<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>) {
    let m = proof.module();
    let start_ready = unit.outputs.skin_start_ready;
    let starts = unit.inputs.skin_start.valid & start_ready;
    let mesh = proof.past(!m.reset() & (unit.skinning | starts));
    proof.assume(
        "a mesh starts where the skinning processor is idle and may start",
        start_ready.implies(!unit.skinning & unit.may_start),
    );
    proof.assume(
        "the skinning processor is busy only with a mesh",
        unit.skinning.implies(mesh),
    );
    proof.assert(
        "no packet is in flight while a mesh is skinned",
        (unit.skinning | mesh).implies(unit.packets.under_way.is_zero() & !unit.packets.sweeping),
    );
    proof.assert(
        "no ray is accepted while a mesh is skinned",
        !(unit.skinning & unit.packets.take_ray),
    );
}

/// Asserts that responses of vertex memory reach the unit that sent the request.
fn vertices<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>, traversing: Signal<'b>) {
    let m = proof.module();
    let (geometry, skinner) = (unit.of_geometry, unit.of_skinner);
    let vertex = unit.inputs.vertex;
    let (request, response) = (unit.outputs.vertex.request, vertex.response.valid);
    let asks = request.valid & vertex.request_ready;
    let geometry_asks = asks & !unit.skinning;
    let owed_geometry = count(
        proof,
        BITS,
        "owed_geometry",
        geometry_asks,
        unit.to_geometry,
    );
    let skinner_asks = asks & unit.skinning;
    let owed_skinner = count(proof, BITS, "owed_skinner", skinner_asks, unit.to_skinner);
    proof.assume(
        "memory responds to vertex requests only",
        response.implies(owed_geometry.any() | owed_skinner.any()),
    );
    for owed in [owed_geometry, owed_skinner] {
        proof.assume(
            "the number of outstanding vertex requests does not wrap",
            (owed + wide(asks)).lt(m.lit(OWED_BELOW, BITS)),
        );
    }
    let quiet = !geometry.valid & !unit.object_valid & owed_geometry.is_zero();
    proof.assume(
        "the geometry unit sends no request between packets",
        traversing.any() | quiet,
    );
    proof.assume(
        "the skinning processor sends no request between meshes",
        unit.skinning | (!skinner.valid & owed_skinner.is_zero()),
    );
    for request in [geometry, skinner] {
        proof.assume(
            "a vertex request is stable until it is accepted",
            shown_stays(
                proof,
                request.valid,
                vertex.request_ready,
                &request.payload.leaves(),
            ),
        );
    }
    proof.assert(
        "only one unit has outstanding vertices",
        owed_geometry.is_zero() | owed_skinner.is_zero(),
    );
    proof.assert(
        "a vertex reaches the unit that requested it",
        unit.to_geometry.implies(owed_geometry.any()) & unit.to_skinner.implies(owed_skinner.any()),
    );
    proof.assert(
        "a vertex reaches one unit",
        response.eq(unit.to_geometry ^ unit.to_skinner),
    );
    proof.assert(
        "a request of a unit reaches the port",
        request.valid.eq(geometry.valid | skinner.valid),
    );
}
