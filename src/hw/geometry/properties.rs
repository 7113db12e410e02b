//! Properties of the geometry unit: an accepted leaf is in one place and leaves once, with its own packet number and its kind
//! (triangle or instance) unchanged; its rays enter the test once each, and not before all of its vertices have arrived; no queue
//! overflows; a request is stable until it is accepted, once; and a leaf makes progress or waits for memory.
//!
//! Assumptions: a packet has at most one leaf in the unit, with a ray in its mask; skinning uses the unit only without leaves; memory
//! responds once to each request. Every packet is watched, because the machine of the proof has few.

use super::fetch::{CORNER_BITS, Fetch, Job};
use super::issue::{Issue, ORIGIN_SLOT, Slot};
use super::{Fetched, Inputs, Outputs, VECTORS_OF_INSTANCE, VERTICES_OF_TRIANGLE};
use crate::hdl::fifo::Placed;
use crate::hdl::properties::{assert_shown_stays, shown_stays};
use crate::hdl::{Builder, Bundle, Flow, Proof, ReadPort, Reg, Request, Signal, Stream, bits_for};

/// Vertices or vectors that a leaf's requests can number.
const CORNERS: u32 = 1 << CORNER_BITS;
/// Width of a count of a leaf's vertices or vectors.
const COUNT_BITS: u32 = CORNER_BITS + 1;
/// Width of the cycles since a leaf's last slot entered the test: enough for all stages of the test.
const AGE_BITS: u32 = 8;

/// Slots of one kind in the test, at each register from its input to its output.
pub(super) struct Passage<'b> {
    pub valid: Vec<Signal<'b>>,
    /// Whether the slot is its leaf's last.
    pub last: Vec<Signal<'b>>,
    pub packet: Vec<Signal<'b>>,
}

impl<'b> Passage<'b> {
    pub fn new(slot: &Slot<'b>, valid: Signal<'b>, leaves_at: u32) -> Passage<'b> {
        let stages = |signal: Signal<'b>| signal.stages(1..=leaves_at);
        Passage {
            valid: stages(valid),
            last: stages(slot.last),
            packet: stages(slot.packet),
        }
    }
}

/// The unit's signals, part by part.
pub(super) struct Unit<'b> {
    pub packets: u32,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub fetch: Fetch<'b>,
    pub issue: Issue<'b>,
    pub tests: Passage<'b>,
    pub moves: Passage<'b>,
}

/// The packets whose leaf is in each place, one bit per packet.
struct Places<'b> {
    /// Its record is requested.
    record: Reg<'b>,
    /// Its vertices are being requested.
    job: Reg<'b>,
    /// All its vertices are requested, and not all have arrived.
    owed: Reg<'b>,
    /// All its vertices have arrived.
    ready: Reg<'b>,
    /// Its rays are being issued.
    now: Reg<'b>,
    /// All its rays are issued.
    out: Reg<'b>,
}

impl<'b> Places<'b> {
    fn all(&self) -> [Signal<'b>; 6] {
        [
            self.record,
            self.job,
            self.owed,
            self.ready,
            self.now,
            self.out,
        ]
        .map(|place| place.q)
    }
}

/// The state that the proof records of a packet's leaf.
struct Leaf<'b> {
    is_instance: Signal<'b>,
    mask: Signal<'b>,
    /// The numbers of its vertices or vectors: in all, requested, and arrived.
    vertices: Signal<'b>,
    asked: Signal<'b>,
    arrived: Signal<'b>,
    /// Cycles since its last slot entered the test.
    age: Signal<'b>,
}

/// A bit at the place that an index names, in a word of `width` bits.
fn bit_in<'b>(width: u32, bit: Signal<'b>, index: Signal<'b>) -> Signal<'b> {
    bit.extend(width).shl(index)
}

/// A list that an index reads, as one word.
struct List<'b> {
    word: Signal<'b>,
    width: u32,
}

impl<'b> List<'b> {
    fn new(proof: &Proof<'b>, name: &str, parts: &[Signal<'b>]) -> List<'b> {
        let reversed: Vec<_> = parts.iter().rev().copied().collect();
        List {
            word: proof.named(name, proof.module().concat(&reversed)),
            width: parts[0].width(),
        }
    }

    /// The part that an index names; 0 past the last.
    fn at(&self, index: Signal<'b>) -> Signal<'b> {
        if self.width == 1 {
            return self.word.bit_at(index);
        }
        let bits = bits_for(u64::from(self.width) + 1);
        let width = index.module().lit(self.width, bits);
        self.word.shr(index.mul(width)).low(self.width)
    }
}

impl<'b> Unit<'b> {
    fn module(&self) -> &'b Builder {
        self.issue.busy.module()
    }

    /// Whether the last ray of the current leaf is issued.
    fn issued_last(&self) -> Signal<'b> {
        self.issue.busy & self.issue.now_last
    }

    /// Whether a packet continues in object space.
    fn moved(&self) -> Signal<'b> {
        self.outputs.object.valid & self.outputs.object.payload.place.last
    }

    fn record_requests(&self) -> Stream<Request<Signal<'b>>, Signal<'b>> {
        ReadPort::of_unit(self.outputs.record, self.inputs.record).request
    }

    fn vertex_requests(&self) -> Stream<Request<Signal<'b>>, Signal<'b>> {
        ReadPort::of_unit(self.outputs.vertex, self.inputs.vertex).request
    }

    fn takes(&self) -> Signal<'b> {
        self.issue.queue.pop
    }

    /// A bit at a packet's place among all packets'.
    fn of_packet(&self, bit: Signal<'b>, packet: Signal<'b>) -> Signal<'b> {
        bit_in(self.packets, bit, packet)
    }

    /// Follows leaves from place to place.
    fn places(&self, proof: &Proof<'b>) -> Places<'b> {
        let set = |name| proof.reg_reset(name, self.packets, 0);
        let places = Places {
            record: set("record"),
            job: set("job"),
            owed: set("owed"),
            ready: set("ready"),
            now: set("now"),
            out: set("out"),
        };
        let (inputs, outputs) = (&self.inputs, &self.outputs);
        let taken = self.of_packet(self.fetch.leaf.taken, inputs.leaf.payload.packet);
        let answered = self.of_packet(inputs.record.response.valid, self.fetch.record.packet);
        let asked = self.of_packet(
            self.fetch.requests.queue.pop,
            self.fetch.requests.job.packet,
        );
        let complete = self.of_packet(self.fetch.arrival.complete, self.fetch.arrival.of.packet);
        let enters = self.of_packet(self.takes(), self.issue.ready.packet);
        let issued = self.of_packet(self.issued_last(), self.issue.now_packet);
        let done = self.of_packet(outputs.done.valid, outputs.done.payload.packet);
        let moved = self.of_packet(self.moved(), outputs.object.payload.place.packet);
        let step = |place: &Reg<'b>, comes, goes: Signal<'b>| place.next((place.q | comes) & !goes);
        step(&places.record, taken, answered);
        step(&places.job, answered, asked);
        step(&places.owed, asked, complete);
        step(&places.ready, complete, enters);
        // A packet's next leaf may come in the clock in which its last one leaves.
        places.now.next((places.now.q & !issued) | enters);
        places.out.next((places.out.q & !done & !moved) | issued);
        places
    }

    /// Records a packet's leaf, and counts its vertices.
    fn leaf(&self, proof: &Proof<'b>, packet: u32) -> Leaf<'b> {
        let m = self.module();
        let reg = |name: &str, width| proof.reg(&format!("{name}_{packet}"), width);
        let is_of = |of: Signal<'b>| of.equals(u128::from(packet));
        let leaf = self.inputs.leaf.payload;
        let is_instance = reg("instance", 1);
        let mask = reg("mask", leaf.mask.width());
        let taken = self.fetch.leaf.taken & is_of(leaf.packet);
        is_instance.next_when(taken, self.fetch.leaf.is_instance);
        mask.next_when(taken, leaf.mask);
        let (asked, arrived) = (reg("asked", COUNT_BITS), reg("arrived", COUNT_BITS));
        let begins = self.inputs.record.response.valid & is_of(self.fetch.record.packet);
        for (count, comes) in [
            (
                asked,
                self.fetch.requests.fire & is_of(self.fetch.requests.job.packet),
            ),
            (
                arrived,
                self.inputs.vertex.response.valid & is_of(self.fetch.arrival.of.packet),
            ),
        ] {
            let more = count.q + comes.extend(COUNT_BITS);
            count.next(begins.mux(m.zero(COUNT_BITS), more));
        }
        let vertices = is_instance.q.mux(
            m.lit(VECTORS_OF_INSTANCE, COUNT_BITS),
            m.lit(VERTICES_OF_TRIANGLE, COUNT_BITS),
        );
        let age = reg("age", AGE_BITS);
        let issued = self.issued_last() & is_of(self.issue.now_packet);
        age.next(issued.mux(m.zero(AGE_BITS), age.q + m.lit(1u8, AGE_BITS)));
        Leaf {
            is_instance: is_instance.q,
            mask: mask.q,
            vertices: proof.named(&format!("vertices_{packet}"), vertices),
            asked: asked.q,
            arrived: arrived.q,
            age: age.q,
        }
    }

    fn seed_faults(&self, proof: &Proof<'b>) {
        let last = |vertices: u8| u128::from(vertices - 1);
        let last_vertex = last(VERTICES_OF_TRIANGLE);
        proof.fault(
            "a leaf is complete before its last vertex comes",
            (self.fetch.arrival.last_arrives.literal_of(last_vertex)).as_value(last_vertex - 1),
        );
        let last_vector = last(VECTORS_OF_INSTANCE);
        proof.fault(
            "the last vertex is not requested",
            (self.fetch.requests.last_corner.literal_of(last_vector)).as_value(last_vector - 1),
        );
        proof.fault(
            "a vertex counts as requested before the request is accepted",
            (self
                .fetch
                .requests
                .fire
                .reads(self.inputs.vertex.request_ready))
            .as_value(1),
        );
        proof.fault(
            "a leaf is accepted while the rays of another one are issued",
            self.issue.idle_next.fault().as_value(1),
        );
        proof.fault(
            "an instance leaves as a triangle",
            (self.outputs.test_issued.reads(self.issue.now_instance)).as_value(0),
        );
    }
}

pub(super) fn conserves<'b>(unit: &Unit<'b>) {
    let proof = &unit.module().proof(
        "conserves",
        "a leaf is in one place and leaves once; its rays are tested once each, when it is complete; stable ports; no deadlock",
    );
    unit.fetch.requests.queue.keep(proof);
    unit.issue.queue.keep(proof);
    let watched = Watched::new(unit, proof);
    watched.assume_inputs();
    watched.assume_returns();
    let out = watched.places.out.q;
    proof.cover("all rays of a leaf are in the test", out.any());
    unit.seed_faults(proof);
    watched.assert_ports();
    watched.assert_queues();
    watched.assert_issue();
    watched.assert_departures();
    watched.assert_progress();
    let triangles = watched.assert_passage("tests", &unit.tests, false);
    let instances = watched.assert_passage("moves", &unit.moves, true);
    for (packet, leaf) in (0..).zip(&watched.leaves) {
        watched.assert_packet(packet, leaf, [&triangles, &instances]);
    }
}

/// The unit, with the recorded state.
struct Watched<'a, 'b> {
    unit: &'a Unit<'b>,
    proof: &'a Proof<'b>,
    places: Places<'b>,
    /// The packets whose leaf is in any place.
    here: Signal<'b>,
    /// The outstanding vertex requests, by tag.
    owed_vertices: Signal<'b>,
    /// The issued rays of the current leaf.
    issued: Signal<'b>,
    /// Whether the counts per packet are being cleared after a reset, and the current packet.
    sweeping: Signal<'b>,
    swept: Signal<'b>,
    leaves: Vec<Leaf<'b>>,
    /// Of each packet's leaf.
    instances: Signal<'b>,
    masks: List<'b>,
    ages: List<'b>,
}

impl<'a, 'b> Watched<'a, 'b> {
    fn new(unit: &'a Unit<'b>, proof: &'a Proof<'b>) -> Watched<'a, 'b> {
        let (m, inputs, issue) = (unit.module(), &unit.inputs, &unit.issue);
        let places = unit.places(proof);
        let tags = unit.packets * CORNERS;
        let owed_vertices = proof.reg_reset("owed_vertices", tags, 0);
        let tag = unit.vertex_requests().payload.tag;
        let asked = bit_in(tags, unit.fetch.requests.fire, tag);
        let Flow { valid, payload } = inputs.vertex.response;
        let answered = bit_in(tags, valid, payload.tag);
        owed_vertices.next((owed_vertices.q | asked) & !answered);
        let rays = issue.now_mask.width();
        let issued = proof.reg("issued", rays);
        let this = bit_in(rays, issue.busy & issue.last_slot, issue.ray);
        issued.next(unit.takes().mux(m.zero(rays), issued.q | this));
        // What counts by packet is cleared after reset, before anything comes.
        let sweeping = proof.reg_reset("sweeping", 1, 1);
        let packet_bits = inputs.sweep_packet.width();
        let swept = proof.reg_reset("swept", packet_bits, 0);
        let last_packet = u128::from(unit.packets - 1);
        sweeping.next_when(sweeping.q, !swept.q.equals(last_packet));
        swept.next_when(sweeping.q, swept.q + m.lit(1u8, packet_bits));
        let leaves: Vec<_> = (0..unit.packets).map(|p| unit.leaf(proof, p)).collect();
        let list = |name: &str, part: &dyn Fn(&Leaf<'b>) -> Signal<'b>| {
            List::new(proof, name, &leaves.iter().map(part).collect::<Vec<_>>())
        };
        Watched {
            unit,
            proof,
            here: proof.named("here", m.or_all(&places.all())),
            places,
            owed_vertices: owed_vertices.q,
            issued: issued.q,
            sweeping: sweeping.q,
            swept: swept.q,
            instances: list("instances", &|leaf| leaf.is_instance).word,
            masks: list("masks", &|leaf| leaf.mask),
            ages: list("ages", &|leaf| leaf.age),
            leaves,
        }
    }

    /// Makes the assumptions on the environment.
    fn assume_inputs(&self) {
        let (proof, inputs, here) = (self.proof, &self.unit.inputs, self.here);
        let Flow {
            valid: leaf_valid,
            payload: leaf,
        } = inputs.leaf;
        proof.assume(
            "whether the scene has instances never changes",
            inputs.instanced.eq(proof.past(inputs.instanced)),
        );
        proof.assume(
            "the counts per packet are cleared after a reset",
            inputs.sweep.eq(self.sweeping) & inputs.sweep_packet.eq(self.swept),
        );
        proof.assume(
            "no leaf and no vertex arrives while these are cleared",
            !(inputs.sweep & (leaf_valid | inputs.vertex.response.valid)),
        );
        proof.assume(
            "no leaf is in the unit or arrives while a mesh is skinned",
            !(inputs.skinning & (leaf_valid | here.any())),
        );
        proof.assume(
            "a packet has one leaf in the unit at a time, with a ray in its mask",
            leaf_valid.implies(!here.bit_at(leaf.packet) & leaf.mask.any()),
        );
        proof.assume(
            "a leaf is stable until it is accepted",
            shown_stays(
                proof,
                leaf_valid,
                inputs.record.request_ready,
                &[leaf.packet, leaf.address, leaf.context],
            ),
        );
    }

    /// Assumes that responses belong to requests, and that queues return the words pushed.
    fn assume_returns(&self) {
        let (fetch, issue) = (&self.unit.fetch, &self.unit.issue);
        let (record, vertex) = (self.unit.inputs.record, self.unit.inputs.vertex);
        let Job {
            packet, instance, ..
        } = fetch.requests.job;
        let job = Fetched { packet, instance };
        for (shown, place, of) in [
            (record.response.valid, self.places.record, fetch.record),
            (fetch.requests.queue.valid, self.places.job, job),
            (issue.queue.valid, self.places.ready, issue.ready),
        ] {
            let as_it_came = of.instance.eq(self.instances.bit_at(of.packet));
            self.proof.assume(
                "records and queues return the packets that they were given",
                shown.implies(place.q.bit_at(of.packet) & as_it_came),
            );
        }
        let Flow { valid, payload } = vertex.response;
        self.proof.assume(
            "memory responds once to each vertex request",
            valid.implies(self.owed_vertices.bit_at(payload.tag)),
        );
    }

    fn assert_ports(&self) {
        for (what, requests) in [
            ("record request", self.unit.record_requests()),
            ("vertex request", self.unit.vertex_requests()),
        ] {
            let shown = requests.payload.leaves();
            assert_shown_stays(self.proof, what, requests.valid, requests.ready, &shown);
        }
    }

    fn assert_queues(&self) {
        let (proof, places) = (self.proof, &self.places);
        let (requests, ready) = (&self.unit.fetch.requests, &self.unit.issue.queue);
        let jobs_held = self.held(&requests.queue);
        proof.assert(
            "the number of leaves in the vertex queue is its count",
            jobs_held.eq(places.job.q.count_ones(jobs_held.width())),
        );
        let ready_held = self.held(ready);
        proof.assert(
            "the number of leaves in the ready queue is its count",
            ready_held.eq(places.ready.q.count_ones(ready_held.width())),
        );
        proof.assert(
            "vertices are requested starting with the first",
            requests.queue.valid | requests.corner.is_zero(),
        );
        requests.queue.assert_settles(proof);
    }

    /// The number of leaves in a queue, with one bit more than its count, because its words are in two places.
    fn held(&self, queue: &Placed<'b>) -> Signal<'b> {
        queue.count(queue.count_bits() + 1)
    }

    fn assert_issue(&self) {
        let (proof, issue, m) = (self.proof, &self.unit.issue, self.unit.module());
        let in_entrance = self.unit.of_packet(issue.busy, issue.now_packet);
        let as_it_came = (issue.now_instance).eq(self.instances.bit_at(issue.now_packet));
        proof.assert(
            "one leaf is being issued, unchanged",
            self.places.now.q.eq(in_entrance) & issue.busy.implies(as_it_came),
        );
        let last_slot = (issue.now_instance).mux(m.lit(ORIGIN_SLOT, 2), m.zero(2));
        proof.assert(
            "a ray takes three slots, or one",
            issue.busy.implies(issue.slot.le(last_slot)),
        );
        let to_be_issued = issue.now_mask;
        let each = to_be_issued.any()
            & (self.issued & to_be_issued).is_zero()
            & (self.issued | to_be_issued).eq(self.masks.at(issue.now_packet));
        proof.assert(
            "each ray of the mask is issued or to be issued",
            issue.busy.implies(each),
        );
    }

    /// Whether all rays of a packet's leaf are in the test, and whether it is an instance.
    fn was_out(&self, packet: Signal<'b>) -> (Signal<'b>, Signal<'b>) {
        let out = self.places.out.q.bit_at(packet);
        (out, self.instances.bit_at(packet))
    }

    fn assert_departures(&self) {
        let (proof, outputs) = (self.proof, &self.unit.outputs);
        let (was_here, instance) = self.was_out(outputs.done.payload.packet);
        proof.assert(
            "a leaf that leaves was here, as a triangle",
            outputs.done.valid.implies(was_here & !instance),
        );
        let (was_here, instance) = self.was_out(outputs.object.payload.place.packet);
        proof.assert(
            "a packet that continues in object space was here, at an instance",
            self.unit.moved().implies(was_here & instance),
        );
        proof.assert(
            "no leaf is here until the counts per packet are clear",
            self.sweeping.implies(self.here.is_zero()),
        );
    }

    fn assert_progress(&self) {
        let (unit, places) = (self.unit, &self.places);
        let queue = &unit.fetch.requests.queue;
        let moves = unit.takes()
            | unit.issue.busy
            | places.out.q.any()
            | (self.held(queue).any() & !queue.valid);
        let asks = unit.vertex_requests().valid;
        let memory = places.record.q.any() | self.owed_vertices.any() | asks;
        self.proof.assert(
            "a leaf makes progress or waits for memory",
            self.here.any().implies(moves | memory),
        );
    }

    /// The last slots of leaves of one kind, in the stages of the test.
    fn assert_passage(&self, name: &str, passage: &Passage<'b>, is_instance: bool) -> Ends<'b> {
        let proof = self.proof;
        let ends: Vec<_> = (passage.valid.iter().zip(&passage.last))
            .map(|(valid, last)| *valid & *last)
            .collect();
        let strays: Vec<_> = (0..)
            .zip(ends.iter().zip(&passage.packet))
            .map(|(stage, (end, packet)): (u128, _)| {
                let (is_out, instance) = self.was_out(*packet);
                let as_it_came = if is_instance { instance } else { !instance };
                let in_time = self.ages.at(*packet).equals(stage);
                *end & !(is_out & as_it_came & in_time)
            })
            .collect();
        proof.assert(
            "the last slot of a leaf in the test belongs to a leaf in the unit",
            self.unit.module().concat(&strays).is_zero(),
        );
        Ends {
            end: List::new(proof, &format!("{name}_end"), &ends),
            packet: List::new(proof, &format!("{name}_packet"), &passage.packet),
        }
    }

    /// `ends`: of triangles, and of instances.
    fn assert_packet(&self, p: u32, leaf: &Leaf<'b>, ends: [&Ends<'b>; 2]) {
        let (unit, places, m) = (self.unit, &self.places, self.unit.module());
        let (requests, arrival) = (&unit.fetch.requests, &unit.fetch.arrival);
        let at = |place: Signal<'b>| place.bit(p);
        let is_p = |packet: Signal<'b>| packet.equals(u128::from(p));
        let number = m.lit(p, self.swept.width());
        let assert = |what: &str, holds| self.proof.assert(format!("{what}, packet {p}"), holds);
        let all = places.all().map(at);
        assert(
            "a leaf is in one place",
            m.concat(&all).count_ones(3).le(m.lit(1u8, 3)),
        );
        let kept = leaf.mask.any()
            & (unit.fetch.leaf.instance_leaves.peek(number)).eq(leaf.is_instance)
            & unit.issue.masks.peek(number).eq(leaf.mask);
        assert(
            "its kind and its mask are kept",
            at(self.here).implies(kept),
        );
        let [as_triangle, as_instance] =
            ends.map(|Ends { end, packet }| end.at(leaf.age) & is_p(packet.at(leaf.age)));
        assert(
            "with all rays issued is in the test until it leaves",
            at(places.out.q).implies(leaf.is_instance.mux(as_instance, as_triangle)),
        );

        let (is_job, is_owed) = (at(places.job.q), at(places.owed.q));
        let fetching = is_job | is_owed;
        let at_front = requests.queue.valid & is_p(requests.job.packet);
        let next = at_front.mux(requests.corner.extend(COUNT_BITS), m.zero(COUNT_BITS));
        assert(
            "vertices are requested in order, for the leaf at the front",
            is_job.implies(leaf.asked.eq(next) & leaf.asked.lt(leaf.vertices)),
        );
        assert(
            "a leaf leaves the queue when all its vertices are requested",
            is_owed.implies(leaf.asked.eq(leaf.vertices) & leaf.arrived.lt(leaf.vertices)),
        );
        let owed = self.owed_vertices.field(p * CORNERS, CORNERS);
        let sum_bits = COUNT_BITS + 1;
        let known = owed.count_ones(sum_bits) + leaf.arrived.extend(sum_bits);
        assert(
            "every requested vertex is outstanding or has arrived",
            fetching.implies(known.eq(leaf.asked.extend(sum_bits))),
        );
        assert(
            "no vertex is outstanding without a request",
            fetching.mux(owed.shr(leaf.asked).is_zero(), owed.is_zero()),
        );

        let to_be_swept = self.sweeping & self.swept.le(number);
        let counted = fetching.mux(leaf.arrived, m.zero(COUNT_BITS));
        let count = arrival.counts.peek(number).extend(COUNT_BITS);
        assert("arrivals are counted", to_be_swept | count.eq(counted));
        let with_this = leaf.arrived + m.lit(1u8, COUNT_BITS);
        assert(
            "a leaf is complete when all its vertices have arrived",
            (arrival.complete & is_p(arrival.of.packet))
                .implies(is_owed & with_this.eq(leaf.vertices)),
        );
    }
}

/// At each stage of the test, whether a leaf's last slot of a kind is there, and which packet's.
struct Ends<'b> {
    end: List<'b>,
    packet: List<'b>,
}
