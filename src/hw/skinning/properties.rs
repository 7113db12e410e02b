//! Properties of the skinning processor: every begun vertex is in one place until it is written, so the write queue never overflows;
//! a mesh is complete if and only if all of it is written; ports are stable; and while it is busy, it makes progress or waits for
//! memory or the geometry unit. Assumptions: the proved properties of prefetchers; the geometry unit returns each issued influence;
//! the rows of a mesh have an end for each vertex.
//!
//! Properties of the write queue: vertices are written in the order of their sums, once each, and the presented vertex is stable until
//! it is written.

use super::Around;
use super::fetch::{Rows, Vectors};
use super::issue::Issue;
use super::sum::VertexSums;
use super::write::Queue;
use crate::hdl::properties::{Ahead, assert_shown_stays, count};
use crate::hdl::{Builder, Proof, Signal, bits_for};

/// Width of counts of vertices in flight, and of the vertices of a mesh.
const BITS: u32 = 16;
const VERTEX_BITS: u32 = 32;

/// The unit's parts.
pub(super) struct Unit<'b> {
    pub around: Around<'b>,
    pub rows: Rows<'b>,
    pub vectors: Vectors<'b>,
    pub issue: Issue<'b>,
    pub sums: VertexSums<'b>,
    pub queue: Queue<'b>,
}

fn wide(signal: Signal<'_>) -> Signal<'_> {
    signal.extend(BITS)
}

fn wider(signal: Signal<'_>) -> Signal<'_> {
    signal.extend(VERTEX_BITS)
}

impl<'b> Unit<'b> {
    /// Vertices in the write queue.
    fn held(&self) -> Signal<'b> {
        wide(self.queue.queued.count) + wide(self.queue.grows)
    }
}

pub(super) fn conserves<'b>(m: &'b Builder, unit: &Unit<'b>) {
    let proof = m.proof(
        "conserves",
        "no vertex is lost or duplicated; no queue overflows; a mesh ends when written; stable ports; no deadlock",
    );
    proof.cover("a vertex is written", unit.queue.written);
    ports(&proof, unit);
    let places = Places::of(&proof, unit);
    places.are_all(&proof, unit);
    places.have_room(&proof, unit);
    ends(&proof, unit, &places);
    goes_on(&proof, unit, &places);
    faults(&proof, unit);
}

/// Asserts that offers at ports are stable until they are accepted.
fn ports<'b>(proof: &Proof<'b>, unit: &Unit<'b>) {
    let (vectors, rows, write) = (&unit.vectors, &unit.rows, unit.queue.write);
    let write_ready = unit.around.inputs.write_ready;
    for (what, valid, ready, shown) in [
        (
            "vector request",
            vectors.wanted,
            vectors.reader.fetch_ready,
            vectors.address,
        ),
        (
            "row request",
            rows.wanted,
            rows.reader.fetch_ready,
            rows.address,
        ),
        ("write", write.valid, write_ready, write.payload.address),
    ] {
        assert_shown_stays(proof, what, valid, ready, &[shown]);
    }
}

/// The numbers of vertices and columns in each place.
struct Places<'b> {
    vectors: Ahead<'b>,
    rows: Ahead<'b>,
    columns_ahead: Signal<'b>,
    rest_ahead: Signal<'b>,
    /// Vertices whose last influence has not been issued.
    to_begin: Signal<'b>,
    /// Vertices from the issue of the last influence until the return from the geometry unit.
    begun: Signal<'b>,
    /// Those of them that are in the geometry unit.
    outside: Signal<'b>,
    /// The last influence is presented to the geometry unit.
    last_issued: Signal<'b>,
    /// Vertices from the return until the write.
    returned: Signal<'b>,
    /// Those of them that are not yet in the write queue, and those in it.
    summing: Signal<'b>,
    held: Signal<'b>,
}

impl<'b> Places<'b> {
    fn of(proof: &Proof<'b>, unit: &Unit<'b>) -> Places<'b> {
        let (vectors, rows, issued) = (&unit.vectors, &unit.rows, unit.issue.issued);
        let vectors_ahead = Ahead::assumed(proof, "vectors", vectors.requested, &vectors.reader);
        let rows_ahead = Ahead::assumed(proof, "rows", rows.requested, &rows.reader);
        let completes = unit.issue.completes;
        let weighted = unit.around.inputs.weighted;
        let returns = weighted.valid & weighted.payload.mark.last;
        let last_issued = issued.valid & issued.payload.mark.last;
        let count = |name: &str, comes, goes| count(proof, BITS, name, comes, goes);
        let outside = count("outside", last_issued, returns);
        let summing = count("summing", returns, unit.sums.vertex_done);
        let begun = count("begun", completes, returns);
        let returned = count("returned", returns, unit.queue.written);
        let column_comes = vectors.palette.valid;
        let columns_ahead = count("columns_ahead", vectors.column_requested, column_comes);
        let rest_ahead = count("rest_ahead", vectors.rest_requested, completes);
        let to_begin = proof.reg_reset("to_begin", VERTEX_BITS, 0);
        let start = rows.start;
        let vertices = wider(start.payload.vertices);
        to_begin.next((start.valid).mux(vertices, to_begin.q - wider(completes)));
        let starved = rows.skinning & !vectors.loading & vectors.reader.valid;
        proof.assume(
            "the geometry unit returns issued influences only",
            returns.implies(outside.any()),
        );
        proof.assume(
            "the rows have an end for each vertex",
            !(starved & rows.reader.empty & !rows.wanted),
        );
        Places {
            vectors: vectors_ahead,
            rows: rows_ahead,
            columns_ahead,
            rest_ahead,
            to_begin: to_begin.q,
            begun,
            outside,
            last_issued,
            returned,
            summing,
            held: unit.held(),
        }
    }

    /// Asserts that every column and every vertex is in one place.
    fn are_all(&self, proof: &Proof<'b>, unit: &Unit<'b>) {
        let vectors = &unit.vectors;
        let under_way = unit.queue.under_way.count;
        proof.assert(
            "prefetched vectors are columns or vertices",
            wide(self.vectors.count).eq(self.columns_ahead + self.rest_ahead),
        );
        proof.assert(
            "every missing column is unrequested or in the prefetcher",
            wide(vectors.columns_to_come).eq(wide(vectors.columns_to_request) + self.columns_ahead),
        );
        proof.assert(
            "vertices are requested after all columns",
            vectors.columns_to_request.is_zero() | self.rest_ahead.is_zero(),
        );
        proof.assert(
            "every vertex to begin is unrequested or in the prefetcher",
            (self.to_begin).eq(wider(vectors.rest_to_request) + wider(self.rest_ahead)),
        );
        proof.assert(
            "every remaining vertex is to begin or in flight",
            wider(unit.queue.vertices_left).eq(self.to_begin + wider(under_way)),
        );
        proof.assert(
            "every vertex in flight is before or after its return from the geometry unit",
            wide(under_way).eq(self.begun + self.returned),
        );
        proof.assert(
            "every vertex before its return is being issued or in the geometry unit",
            (self.begun).eq(self.outside + wide(self.last_issued)),
        );
        proof.assert(
            "every returned vertex is being summed or queued",
            (self.returned).eq(self.summing + self.held),
        );
        proof.assert(
            "the number of vertices being summed is that of the pipeline's valid bits",
            (self.summing).eq(proof.module().concat(&unit.sums.summing).count_ones(BITS)),
        );
    }

    /// Asserts that no queue overflows.
    fn have_room(&self, proof: &Proof<'b>, unit: &Unit<'b>) {
        let m = proof.module();
        let depth = m.lit(unit.queue.depth, BITS);
        let under_way = &unit.queue.under_way;
        proof.assert(
            "no more vertices are in flight than the write queue has room for",
            wide(under_way.count).le(depth) & self.outside.le(depth),
        );
        proof.assert(
            "no vertex is pushed to a full write queue",
            self.held.le(depth) & unit.sums.vertex_done.implies(self.held.lt(depth)),
        );
        let most_ahead = m.lit(unit.vectors.reader.room + 1, BITS);
        proof.assert(
            "no prefetcher holds more than it has room for",
            self.columns_ahead.le(most_ahead)
                & self.rest_ahead.le(most_ahead)
                & self.summing.le(depth),
        );
        under_way.assert_room(proof);
    }
}

/// Asserts that a mesh is complete if and only if all of it is written.
fn ends<'b>(proof: &Proof<'b>, unit: &Unit<'b>, places: &Places<'b>) {
    let skinning = unit.rows.skinning;
    let nothing_left = unit.queue.vertices_left.is_zero() & unit.vectors.columns_to_come.is_zero();
    proof.assert(
        "a mesh is complete only when all of it is written",
        skinning | (nothing_left & !unit.issue.issued.valid),
    );
    proof.assert(
        "a vertex is in the geometry unit only during skinning",
        skinning | places.outside.is_zero(),
    );
    proof.assert(
        "vectors are requested only for a mesh",
        unit.vectors.wanted.implies(skinning),
    );
}

/// Asserts the absence of deadlock.
fn goes_on<'b>(proof: &Proof<'b>, unit: &Unit<'b>, places: &Places<'b>) {
    let m = proof.module();
    let (vectors, rows) = (&places.vectors, &places.rows);
    let moves = m.or_all(&[
        unit.vectors.requested,
        unit.rows.requested,
        unit.vectors.palette.valid,
        unit.issue.issue,
        unit.issue.issued.valid,
        places.summing.any(),
        unit.queue.grows,
        unit.queue.over,
    ]);
    let waits = m.or_all(&[
        unit.vectors.wanted & vectors.has_room,
        vectors.count.any() & !unit.vectors.reader.valid,
        unit.rows.wanted & rows.has_room,
        rows.count.any() & !unit.rows.reader.valid,
        places.outside.any(),
        unit.queue.write.valid,
    ]);
    proof.assert(
        "skinning makes progress or waits for memory or the geometry unit",
        unit.rows.skinning.implies(moves | waits),
    );
}

fn faults<'b>(proof: &Proof<'b>, unit: &Unit<'b>) {
    let queue = &unit.queue;
    proof.fault(
        "a vertex is begun without room",
        unit.issue.room_missing.fault().as_value(0),
    );
    proof.fault(
        "a mesh is complete when the last vertex is requested",
        (queue.over.reads(queue.vertices_left)).as_signal(unit.vectors.rest_to_request),
    );
    proof.fault(
        "the room of a vertex is released when it is summed",
        (queue.under_way.count.reads(queue.written)).as_signal(unit.sums.vertex_done),
    );
    proof.fault(
        "room for a vertex is never detected",
        unit.around.told.room.fault().as_value(0),
    );
}

/// Properties of the write queue. It is assumed never to be pushed when full, which [`conserves`] proves. One arbitrary vertex is watched.
pub(super) fn write_queue<'b>(m: &'b Builder, unit: &Unit<'b>) {
    let proof = m.proof(
        "write_queue",
        format!(
            "vertices are written in order, each once, and are stable until accepted; a queue of {}",
            unit.queue.depth
        ),
    );
    let depth = m.lit(unit.queue.depth, BITS);
    let (held, head) = (unit.held(), wide(unit.queue.head));
    let write = unit.queue.write;
    // The valid bit is arbitrary, which includes that of the pipeline. The data are inputs.
    proof.cut(unit.sums.vertex_done);
    proof.assume(
        "a vertex arrives only if the write queue has room",
        unit.sums.vertex_done.implies(held.lt(depth)),
    );
    let watching = proof.reg_reset("watching", 1, 0);
    let word = proof.reg("word", unit.queue.data.width());
    let before = proof.reg("before", BITS);
    let slot = proof.reg("slot", BITS);
    let begins = !watching.q & unit.sums.vertex_done & proof.any_seq("choose", 1);
    let passes = watching.q & unit.queue.written;
    let in_turn = watching.q & before.q.is_zero();
    watching.next(begins | (watching.q & !(passes & in_turn)));
    word.next_when(begins, unit.queue.data);
    before.next_when(
        begins | passes,
        begins.mux(held - wide(unit.queue.written), before.q - m.lit(1u8, BITS)),
    );
    slot.next_when(begins, wide(unit.queue.tail));
    proof.cover("a vertex is written while one is watched", passes);

    let from_head = |words: Signal<'b>| {
        let place = head + words;
        place.ge(depth).mux(place - depth, place)
    };
    proof.assert(
        "no more vertices are queued than there is room",
        held.le(depth),
    );
    proof.assert("the head is a slot", head.lt(depth));
    proof.assert(
        "the distance from head to tail is the number of vertices",
        wide(unit.queue.tail).eq(from_head(held)),
    );
    proof.assert(
        "a watched vertex is held until it is written",
        watching.q.implies(before.q.lt(held)),
    );
    proof.assert(
        "a watched vertex keeps its slot",
        watching.q.implies(slot.q.eq(from_head(before.q))),
    );
    let stored = (unit.queue.words).peek(slot.q.low(bits_for(u64::from(unit.queue.depth))));
    proof.assert(
        "a watched vertex is stored as it was summed",
        watching.q.implies(stored.eq(word.q)),
    );
    proof.assert(
        "a watched vertex is presented in order, until it is written",
        (in_turn & write.valid).implies(write.payload.data.eq(word.q)),
    );
    proof.fault(
        "a vertex is presented before it is in the queue",
        (unit.queue.grows.reads(unit.sums.vertex_done))
            .as_signal(unit.around.inputs.weighted.valid),
    );
    proof.fault(
        "the next vertex is read although none is written",
        unit.queue.written.reads(write.valid).as_value(1),
    );
    proof.fault(
        "a vertex is stored in a wrong slot",
        unit.queue.words.write_address().as_signal(unit.queue.head),
    );
}
