//! What is proved of the geometry unit: a leaf that it takes is in one place and leaves once, under its own packet's number, as a
//! triangle or as an instance as it came; its rays go into the test once each, and not before every one of its vertices is there; no
//! queue overflows; what is asked for stays asked for until it is taken, once; and a leaf that is here moves, or waits for memory.
//!
//! It is assumed that a packet has one leaf here at a time, with a ray in its mask, that skinning borrows the unit when none is here, and
//! that memory answers what it was asked, once. Every packet is watched: the machine of the proof has few.

use super::fetch::{CORNER_BITS, Fetch};
use super::issue::{Issue, ORIGIN_SLOT, Slot};
use super::{Inputs, Outputs, VECTORS_OF_INSTANCE, VERTICES_OF_TRIANGLE};
use crate::hdl::{Builder, Bundle, Proof, ReadPort, Reg, Signal, bits_for};
use crate::hw::properties::{assert_shown_stays, shown_stays};

/// Vertices or vectors that a leaf's requests can number.
const CORNERS: u32 = 1 << CORNER_BITS;
/// Bits that count a leaf's vertices or vectors.
const COUNT_BITS: u32 = CORNER_BITS + 1;
/// Bits of the clocks since a leaf's last slot went into the test: enough for all stages of the test.
const AGE_BITS: u32 = 8;

/// Slots of one kind on their way through the test, at each register behind its entrance up to where they leave.
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

/// The packets whose leaf is in a place, a bit each.
struct Places<'b> {
    /// Its record is asked for.
    record: Reg<'b>,
    /// Its vertices are being asked for.
    job: Reg<'b>,
    /// All its vertices are asked for, and not all there.
    owed: Reg<'b>,
    /// All its vertices are there.
    ready: Reg<'b>,
    /// Its rays are in the test's entrance.
    now: Reg<'b>,
    /// All its rays are in the test.
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

/// What is remembered of a packet's leaf.
struct Leaf<'b> {
    is_instance: Signal<'b>,
    mask: Signal<'b>,
    /// Vertices or vectors that it has asked for, and that have come.
    asked: Signal<'b>,
    arrived: Signal<'b>,
    /// Clocks since its last slot went into the test.
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

    /// Whether the leaf in the test's entrance leaves it.
    fn issued_last(&self) -> Signal<'b> {
        self.issue.busy & self.issue.now_last
    }

    /// Whether a packet goes on in an object's space.
    fn moved(&self) -> Signal<'b> {
        self.outputs.object.valid & self.outputs.object.payload.place.last
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

    /// Remembers of a packet's leaf what came with it, and counts its vertices.
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
        let age = reg("age", AGE_BITS);
        let issued = self.issued_last() & is_of(self.issue.now_packet);
        age.next(issued.mux(m.zero(AGE_BITS), age.q + m.lit(1u8, AGE_BITS)));
        Leaf {
            is_instance: is_instance.q,
            mask: mask.q,
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
            "the last vertex is not asked for",
            (self.fetch.requests.last_corner.literal_of(last_vector)).as_value(last_vector - 1),
        );
        proof.fault(
            "a vertex counts as asked for before it is taken",
            (self
                .fetch
                .requests
                .fire
                .reads(self.inputs.vertex.request_ready))
            .as_value(1),
        );
        proof.fault(
            "a leaf is taken while another's rays are issued",
            self.issue.idle_next.fault().as_value(1),
        );
        proof.fault(
            "an instance leaves as a triangle",
            (self.outputs.test_issued.reads(self.issue.now_instance)).as_value(0),
        );
    }
}

pub(super) fn conserves<'b>(unit: &Unit<'b>) {
    let m = unit.module();
    let proof = &m.proof(
        "conserves",
        "a leaf is in one place and leaves once, its rays tested once each when all is there, ports, nothing locks up",
    );
    let (packets, inputs, outputs) = (unit.packets, unit.inputs, unit.outputs);
    let leaf = inputs.leaf.payload;
    let vertex = inputs.vertex.response;
    let record_requests = ReadPort::of_unit(outputs.record, inputs.record).request;
    let vertex_requests = ReadPort::of_unit(outputs.vertex, inputs.vertex).request;
    unit.fetch.requests.queue.keep(proof);
    unit.issue.queue.keep(proof);
    let places = unit.places(proof);
    let here = proof.named("here", m.or_all(&places.all()));
    let all_vertices = packets * CORNERS;
    let owed_vertices = proof.reg_reset("owed_vertices", all_vertices, 0);
    owed_vertices.next(
        (owed_vertices.q
            | bit_in(
                all_vertices,
                unit.fetch.requests.fire,
                vertex_requests.payload.tag,
            ))
            & !bit_in(all_vertices, vertex.valid, vertex.payload.tag),
    );
    let rays = leaf.mask.width();
    let issued = proof.reg("issued", rays);
    let issues = unit.issue.busy & unit.issue.last_slot;
    issued.next(unit.takes().mux(
        m.zero(rays),
        issued.q | bit_in(rays, issues, unit.issue.ray),
    ));
    // What counts by packet is cleared after reset, before anything comes.
    let sweeping = proof.reg_reset("sweeping", 1, 1);
    let packet_bits = inputs.sweep_packet.width();
    let swept = proof.reg_reset("swept", packet_bits, 0);
    let last_packet = u128::from(packets - 1);
    sweeping.next_when(sweeping.q, !swept.q.equals(last_packet));
    swept.next_when(sweeping.q, swept.q + m.lit(1u8, packet_bits));
    let leaves: Vec<Leaf<'b>> = (0..packets).map(|p| unit.leaf(proof, p)).collect();
    let list = |name: &str, part: &dyn Fn(&Leaf<'b>) -> Signal<'b>| {
        List::new(proof, name, &leaves.iter().map(part).collect::<Vec<_>>())
    };
    let instances = list("instances", &|leaf| leaf.is_instance).word;
    let masks = list("masks", &|leaf| leaf.mask);
    let ages = list("ages", &|leaf| leaf.age);

    let never_changes = inputs.instanced.eq(proof.past(inputs.instanced));
    proof.assume(
        "whether the scene has instances never changes",
        never_changes,
    );
    let leaf_valid = inputs.leaf.valid;
    proof.assume(
        "what counts by packet is cleared after a reset",
        inputs.sweep.eq(sweeping.q) & inputs.sweep_packet.eq(swept.q),
    );
    proof.assume(
        "no leaf and no vertex comes while that is cleared",
        !(inputs.sweep & (leaf_valid | vertex.valid)),
    );
    proof.assume(
        "no leaf is here or comes while a mesh is skinned",
        !(inputs.skinning & (leaf_valid | here.any())),
    );
    proof.assume(
        "a packet has one leaf here at a time, with a ray in its mask",
        leaf_valid.implies(!here.bit_at(leaf.packet) & leaf.mask.any()),
    );
    proof.assume(
        "a leaf that is not taken stays",
        shown_stays(
            proof,
            leaf_valid,
            inputs.record.request_ready,
            &[leaf.packet, leaf.address, leaf.context],
        ),
    );
    // An answer is of something asked for; and what comes out of a queue went in.
    for (shown, place, packet, is_instance) in [
        (
            inputs.record.response.valid,
            places.record,
            unit.fetch.record.packet,
            unit.fetch.record.instance,
        ),
        (
            unit.fetch.requests.queue.valid,
            places.job,
            unit.fetch.requests.job.packet,
            unit.fetch.requests.job.instance,
        ),
        (
            unit.issue.queue.valid,
            places.ready,
            unit.issue.ready.packet,
            unit.issue.ready.instance,
        ),
    ] {
        let as_it_came = is_instance.eq(instances.bit_at(packet));
        proof.assume(
            "records and queues give back what they were given",
            shown.implies(place.q.bit_at(packet) & as_it_came),
        );
    }
    proof.assume(
        "memory gives vertices that it was asked for, once",
        (vertex.valid).implies(owed_vertices.q.bit_at(vertex.payload.tag)),
    );
    proof.cover("all rays of a leaf are in the test", places.out.q.any());

    unit.seed_faults(proof);

    for (what, requests) in [
        ("record request", record_requests),
        ("vertex request", vertex_requests),
    ] {
        let shown = requests.payload.leaves();
        assert_shown_stays(proof, what, requests.valid, requests.ready, &shown);
    }
    // One bit more than a queue's own count: what it holds is in two places.
    let count_bits = unit.fetch.requests.queue.count_bits() + 1;
    let jobs_held = unit.fetch.requests.queue.count(count_bits);
    proof.assert(
        "as many leaves are in the vertex queue as it holds",
        jobs_held.eq(places.job.q.count_ones(count_bits)),
    );
    let ready_held = unit.issue.queue.count(count_bits);
    proof.assert(
        "as many leaves are in the ready queue as it holds",
        ready_held.eq(places.ready.q.count_ones(count_bits)),
    );
    proof.assert(
        "vertices are asked for from the first on",
        unit.fetch.requests.queue.valid | unit.fetch.requests.corner.is_zero(),
    );
    let in_entrance = unit.of_packet(unit.issue.busy, unit.issue.now_packet);
    let as_it_came = unit
        .issue
        .now_instance
        .eq(instances.bit_at(unit.issue.now_packet));
    proof.assert(
        "one leaf is in the test's entrance, as it came",
        places.now.q.eq(in_entrance) & unit.issue.busy.implies(as_it_came),
    );
    let last_slot = (unit.issue.now_instance).mux(m.lit(ORIGIN_SLOT, 2), m.zero(2));
    proof.assert(
        "a ray takes three slots, or one",
        unit.issue.busy.implies(unit.issue.slot.le(last_slot)),
    );
    let to_be_issued = unit.issue.now_mask;
    let each = to_be_issued.any()
        & (issued.q & to_be_issued).is_zero()
        & (issued.q | to_be_issued).eq(masks.at(unit.issue.now_packet));
    proof.assert(
        "each ray of the mask is issued or to be issued",
        unit.issue.busy.implies(each),
    );
    let was_out = |packet| (places.out.q.bit_at(packet), instances.bit_at(packet));
    let (was_here, instance) = was_out(outputs.done.payload.packet);
    proof.assert(
        "a leaf that leaves was here, as a triangle",
        outputs.done.valid.implies(was_here & !instance),
    );
    let (was_here, instance) = was_out(outputs.object.payload.place.packet);
    proof.assert(
        "a packet that goes on in an object was here, at an instance",
        unit.moved().implies(was_here & instance),
    );
    proof.assert(
        "nothing is here until what counts by packet is clear",
        sweeping.q.implies(here.is_zero()),
    );
    let moves = unit.takes()
        | unit.issue.busy
        | places.out.q.any()
        | (jobs_held.any() & !unit.fetch.requests.queue.valid);
    let memory = places.record.q.any() | owed_vertices.q.any() | vertex_requests.valid;
    proof.assert(
        "a leaf that is here moves, or waits for memory",
        here.any().implies(moves | memory),
    );
    unit.fetch.requests.queue.assert_settles(proof);

    // The last of a leaf's slots, in the stages of the test.
    let mut passing = vec![];
    for (name, passage, is_instance) in
        [("tests", &unit.tests, false), ("moves", &unit.moves, true)]
    {
        let ends: Vec<_> = (passage.valid.iter().zip(&passage.last))
            .map(|(valid, last)| *valid & *last)
            .collect();
        let strays: Vec<_> = (0..)
            .zip(ends.iter().zip(&passage.packet))
            .map(|(stage, (end, packet)): (u128, _)| {
                let (is_out, instance) = was_out(*packet);
                let as_it_came = if is_instance { instance } else { !instance };
                let in_time = ages.at(*packet).equals(stage);
                *end & !(is_out & as_it_came & in_time)
            })
            .collect();
        proof.assert(
            "the last slot of a leaf in the test is of one that is there",
            m.concat(&strays).is_zero(),
        );
        passing.push((
            List::new(proof, &format!("{name}_end"), &ends),
            List::new(proof, &format!("{name}_packet"), &passage.packet),
        ));
    }
    for (p, leaf) in (0..).zip(&leaves) {
        let at = |place: Signal<'b>| place.bit(p);
        let is_p = |packet: Signal<'b>| packet.equals(u128::from(p));
        let assert = |what: &str, holds| proof.assert(format!("{what}, packet {p}"), holds);
        let vertices = leaf.is_instance.mux(
            m.lit(VECTORS_OF_INSTANCE, COUNT_BITS),
            m.lit(VERTICES_OF_TRIANGLE, COUNT_BITS),
        );
        let vertices = proof.named(&format!("vertices_{p}"), vertices);
        let owed = owed_vertices.q.field(p * CORNERS, CORNERS);
        let (is_job, is_owed) = (at(places.job.q), at(places.owed.q));
        let fetching = is_job | is_owed;
        assert(
            "a leaf is in one place",
            m.concat(&places.all().map(at))
                .count_ones(3)
                .le(m.lit(1u8, 3)),
        );
        let at_front = unit.fetch.requests.queue.valid & is_p(unit.fetch.requests.job.packet);
        let next = at_front.mux(
            unit.fetch.requests.corner.extend(COUNT_BITS),
            m.zero(COUNT_BITS),
        );
        assert(
            "vertices are asked for in turn, by the leaf at the front",
            is_job.implies(leaf.asked.eq(next) & leaf.asked.lt(vertices)),
        );
        assert(
            "a leaf leaves the queue when all its vertices are asked for",
            is_owed.implies(leaf.asked.eq(vertices) & leaf.arrived.lt(vertices)),
        );
        let sum_bits = COUNT_BITS + 1;
        let known = owed.count_ones(sum_bits) + leaf.arrived.extend(sum_bits);
        assert(
            "every vertex asked for is owed or has arrived",
            fetching.implies(known.eq(leaf.asked.extend(sum_bits))),
        );
        assert(
            "no vertex is owed that was not asked for",
            fetching.mux(owed.shr(leaf.asked).is_zero(), owed.is_zero()),
        );
        let number = m.lit(p, packet_bits);
        let to_be_swept = sweeping.q & swept.q.le(number);
        let counted = fetching.mux(leaf.arrived, m.zero(COUNT_BITS));
        assert(
            "arrivals are counted",
            to_be_swept
                | unit
                    .fetch
                    .arrival
                    .counts
                    .peek(number)
                    .extend(COUNT_BITS)
                    .eq(counted),
        );
        let kept = leaf.mask.any()
            & unit
                .fetch
                .leaf
                .instance_leaves
                .peek(number)
                .eq(leaf.is_instance)
            & unit.issue.masks.peek(number).eq(leaf.mask);
        assert("its kind and its mask are kept", at(here).implies(kept));
        let with_this = leaf.arrived + m.lit(1u8, COUNT_BITS);
        assert(
            "a leaf is complete when all its vertices are there",
            (unit.fetch.arrival.complete & is_p(unit.fetch.arrival.of.packet))
                .implies(is_owed & with_this.eq(vertices)),
        );
        let [as_triangle, as_instance] = [0, 1].map(|kind| {
            let (end, packet) = &passing[kind];
            end.at(leaf.age) & is_p(packet.at(leaf.age))
        });
        assert(
            "all of whose rays are issued is in the test until it leaves",
            at(places.out.q).implies(leaf.is_instance.mux(as_instance, as_triangle)),
        );
    }
}
