//! What is proved of the ray casting unit: every packet number is in one place, so no queue overflows and hits leave under the tag that
//! their rays came with; rays of the world give way to those of an object's space, and none is lost; and of rays and skinning only one has
//! the geometry unit and its port to vertex memory, whose answers reach who asked.
//!
//! It is assumed of the units within what is proved of them: the traversal unit finishes each packet that it was given once, the geometry
//! unit asks for nothing between packets, the skinning processor for nothing between meshes, and what they show at a port stays. Of memory
//! it is assumed that it answers what it was asked.

use super::hits::Hits;
use super::packets::Packets;
use super::units::VertexRequest;
use super::{Inputs, Outputs};
use crate::hdl::properties::{assert_shown_stays, count, shown_stays};
use crate::hdl::{Bundle, Proof, Signal};
use crate::hw::plan::Plan;

/// Bits in which packets, and vertices that are owed, are counted.
const BITS: u32 = 16;

/// Fewer vertices than this are owed to each unit, so that no count wraps.
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
        "packet numbers are in one place, hits keep their tag, the geometry unit and its port serve one, answers reach who asked",
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
        "a ray of the world is taken only where none of an object's space comes",
        !(unit.packets.take_ray & unit.object_valid),
    );
    proof.assert(
        "a ray waits for nothing but a packet under way, an object's ray or a mesh",
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
        "a ray is taken where an object's comes",
        (unit.outputs.ray_ready.reads(unit.object_valid)).as_value(0),
    );
    proof.fault(
        "a packet starts while a mesh is skinned",
        unit.paused.reads(unit.skinning).as_value(0),
    );
    proof.fault(
        "skinning's vertices go to the geometry unit too",
        unit.to_geometry.reads(unit.skinning).as_value(0),
    );
    proof.fault(
        "a packet is free before its last hit is taken",
        (unit.hits.leaves.reads(unit.hits.taken)).as_signal(unit.outputs.hit.valid),
    );
    proof.fault(
        "skinning's requests reach no memory",
        (unit.outputs.vertex.request.valid.reads(unit.skinning)).as_value(0),
    );
}

/// How many packets are where.
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
        "every packet under way is traversing, finished or leaving",
        under_way.eq(traversing + finished + wide(unit.hits.out_valid)),
    );
    let swept = free.eq(wide(unit.packets.sweep_packet)) & under_way.is_zero();
    proof.assert(
        "every packet number is free or under way",
        (unit.packets.sweeping).mux(swept, (free + under_way).eq(all)),
    );
    proof.assert(
        "no more packets are under way than there are",
        under_way.le(all) & traversing.le(all) & finished.le(all),
    );
    proof.assert(
        "packets are swept once each",
        (unit.packets.sweeping).implies(wide(unit.packets.sweep_packet).lt(all)),
    );
    proof.assert(
        "nothing is pushed to a full queue of free packets",
        unit.packets.free.push.implies(free.lt(all)),
    );
    proof.assert(
        "nothing is pushed to a full queue of finished packets",
        unit.hits.finished.push.implies(finished.lt(all)),
    );
    proof.assert(
        "queues are popped only where they show a word",
        unit.packets.free.pop.implies(unit.packets.free.shows())
            & unit.hits.finished.pop.implies(unit.hits.finished.shows()),
    );
}

/// One packet number, any: where it is, and the tag that its first ray came with.
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
        "a packet that is finished was traversing",
        finishes.implies(is_traversing.q),
    );
    proof.assume(
        "what comes out of the queue of free numbers was in it",
        (free.valid & in_front).implies(is_free.q),
    );
    proof.assume(
        "what comes out of the queue of finished packets was in it",
        (finished.valid & finished_front).implies(is_finished.q),
    );
    proof.assume(
        "the front of the queue of free numbers stays until it is taken",
        shown_stays(proof, free.valid, free.pop, &[free.front]),
    );

    let to_sweep = unit.packets.sweeping & packet.ge(unit.packets.sweep_packet);
    let places = m.concat(&[is_free.q, is_traversing.q, is_finished.q, is_out]);
    proof.assert(
        "a packet number is in one place",
        places.count_ones(3).eq((!to_sweep).extend(3)),
    );
    proof.assert(
        "a packet's hits leave under the tag that its first ray came with",
        is_out.implies(unit.outputs.hit.payload.tag.eq(tag.q)),
    );
    proof.assert(
        "a packet's tag stays while it is under way",
        (is_traversing.q | is_finished.q | is_out).implies(stored.eq(tag.q)),
    );
}

/// That skinning and packets exclude each other.
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
        "the skinning processor is busy with a mesh alone",
        unit.skinning.implies(mesh),
    );
    proof.assert(
        "no packet is under way while a mesh is skinned",
        (unit.skinning | mesh).implies(unit.packets.under_way.is_zero() & !unit.packets.sweeping),
    );
    proof.assert(
        "no ray is taken while a mesh is skinned",
        !(unit.skinning & unit.packets.take_ray),
    );
}

/// Who is owed what vertex memory answers.
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
        "memory gives vertices that it was asked for",
        response.implies(owed_geometry.any() | owed_skinner.any()),
    );
    for owed in [owed_geometry, owed_skinner] {
        proof.assume(
            "fewer vertex requests are open than can be counted",
            (owed + wide(asks)).lt(m.lit(OWED_BELOW, BITS)),
        );
    }
    let quiet = !geometry.valid & !unit.object_valid & owed_geometry.is_zero();
    proof.assume(
        "the geometry unit is quiet between packets",
        traversing.any() | quiet,
    );
    proof.assume(
        "the skinning processor asks for nothing between meshes",
        unit.skinning | (!skinner.valid & owed_skinner.is_zero()),
    );
    for request in [geometry, skinner] {
        proof.assume(
            "a vertex request that is not taken stays",
            shown_stays(
                proof,
                request.valid,
                vertex.request_ready,
                &request.payload.leaves(),
            ),
        );
    }
    proof.assert(
        "only one unit is owed vertices",
        owed_geometry.is_zero() | owed_skinner.is_zero(),
    );
    proof.assert(
        "a vertex reaches the unit that asked",
        unit.to_geometry.implies(owed_geometry.any()) & unit.to_skinner.implies(owed_skinner.any()),
    );
    proof.assert(
        "a vertex reaches one unit",
        response.eq(unit.to_geometry ^ unit.to_skinner),
    );
    proof.assert(
        "what a unit asks for is asked",
        request.valid.eq(geometry.valid | skinner.valid),
    );
}
