//! What is proved of the skinning processor: every vertex that it has begun is in one place until it is written, so its write queue never
//! overflows; a mesh is over when, and only when, all of it is written; what it shows at its ports stays; and while it works, something in
//! it moves unless memory or the geometry unit is waited for. Of its readers ahead it assumes what is proved of them, of the geometry unit
//! that it returns what it was issued, of a mesh that its rows have an end for each vertex.
//!
//! Of its write queue: vertices are written in the order in which they were summed, each once, and the one that is shown stays until it is
//! written.

use super::{Inputs, Outputs};
use crate::hdl::{Builder, Memory, Signal, bits_for};
use crate::hw::prefetch::Occupancy;
use crate::hw::properties::{Ahead, Reader, assert_shown_stays, count};

/// Bits in which what is under way is counted, and those of a mesh's vertices.
const BITS: u32 = 16;
const VERTEX_BITS: u32 = 32;

/// The unit's signals, part by part.
pub(super) struct Unit<'b> {
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub start: Signal<'b>,
    pub over: Signal<'b>,
    // Vectors and rows ahead.
    pub columns_to_request: Signal<'b>,
    pub rest_to_request: Signal<'b>,
    pub vector_wanted: Signal<'b>,
    pub vector_address: Signal<'b>,
    pub vector_requested: Signal<'b>,
    pub column_requested: Signal<'b>,
    pub rest_requested: Signal<'b>,
    pub vectors: Reader<'b>,
    pub rows_wanted: Signal<'b>,
    pub row_address: Signal<'b>,
    pub row_requested: Signal<'b>,
    pub rows: Reader<'b>,
    // The palette.
    pub columns_to_come: Signal<'b>,
    pub loading: Signal<'b>,
    pub column_comes: Signal<'b>,
    // Issue.
    pub room: Signal<'b>,
    pub room_missing: Signal<'b>,
    pub issue: Signal<'b>,
    pub completes: Signal<'b>,
    // Accumulation.
    /// Whether a vertex is being summed, at each stage until it is done.
    pub summing: Vec<Signal<'b>>,
    pub vertex_done: Signal<'b>,
    // The write queue.
    pub depth: u32,
    pub queue: Memory<'b>,
    pub queue_data: Signal<'b>,
    pub queue_head: Signal<'b>,
    pub queue_tail: Signal<'b>,
    pub queue_grows: Signal<'b>,
    pub queued: Occupancy<'b>,
    pub under_way: Occupancy<'b>,
    pub written: Signal<'b>,
    pub vertices_left: Signal<'b>,
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
        wide(self.queued.count) + wide(self.queue_grows)
    }
}

pub(super) fn conserves<'b>(m: &'b Builder, unit: &Unit<'b>) {
    let proof = m.proof(
        "conserves",
        "no vertex is lost or doubled, no queue overflows, a mesh ends when written, ports, nothing locks up",
    );
    let proof = &proof;
    let (issued, write) = (unit.outputs.issue, unit.outputs.write);
    proof.cover("a vertex is written", unit.written);
    for (what, valid, ready, shown) in [
        (
            "vector request",
            unit.vector_wanted,
            unit.vectors.fetch_ready,
            unit.vector_address,
        ),
        (
            "row request",
            unit.rows_wanted,
            unit.rows.fetch_ready,
            unit.row_address,
        ),
        (
            "write",
            write.valid,
            unit.inputs.write_ready,
            write.payload.address,
        ),
    ] {
        assert_shown_stays(proof, what, valid, ready, &[shown]);
    }
    let vectors = Ahead::assumed(proof, "vectors", unit.vector_requested, &unit.vectors);
    let rows = Ahead::assumed(proof, "rows", unit.row_requested, &unit.rows);
    let (skinning, completes) = (unit.outputs.skinning, unit.completes);
    let weighted = unit.inputs.weighted;
    let returns = weighted.valid & weighted.payload.mark.last;
    let last_issued = issued.valid & issued.payload.mark.last;
    let outside = count(proof, BITS, "outside", last_issued, returns);
    let summing = count(proof, BITS, "summing", returns, unit.vertex_done);
    let begun = count(proof, BITS, "begun", completes, returns);
    let returned = count(proof, BITS, "returned", returns, unit.written);
    let columns_ahead = count(
        proof,
        BITS,
        "columns_ahead",
        unit.column_requested,
        unit.column_comes,
    );
    let rest_ahead = count(proof, BITS, "rest_ahead", unit.rest_requested, completes);
    let to_begin = proof.reg_reset("to_begin", VERTEX_BITS, 0);
    let vertices = wider(unit.inputs.start.payload.vertices);
    to_begin.next((unit.start).mux(vertices, to_begin.q - wider(completes)));
    let starved = skinning & !unit.loading & unit.vectors.valid;
    proof.assume(
        "the geometry unit gives back influences that it was issued",
        returns.implies(outside.any()),
    );
    proof.assume(
        "the rows have an end for each vertex",
        !(starved & unit.rows.empty & !unit.rows_wanted),
    );

    let depth = m.lit(unit.depth, BITS);
    let held = unit.held();
    let under_way = unit.under_way.count;
    proof.assert(
        "what is ahead is columns and vertices",
        wide(vectors.count).eq(columns_ahead + rest_ahead),
    );
    proof.assert(
        "every column to come is to be requested or ahead",
        wide(unit.columns_to_come).eq(wide(unit.columns_to_request) + columns_ahead),
    );
    proof.assert(
        "vertices are requested behind all columns",
        unit.columns_to_request.is_zero() | rest_ahead.is_zero(),
    );
    proof.assert(
        "every vertex to begin is to be requested or ahead",
        (to_begin.q).eq(wider(unit.rest_to_request) + wider(rest_ahead)),
    );
    proof.assert(
        "every vertex left is to begin or under way",
        wider(unit.vertices_left).eq(to_begin.q + wider(under_way)),
    );
    proof.assert(
        "every vertex under way is on its way to the geometry unit or back from it",
        wide(under_way).eq(begun + returned),
    );
    proof.assert(
        "every vertex not yet back is issued or in the geometry unit",
        begun.eq(outside + wide(last_issued)),
    );
    proof.assert(
        "every vertex that is back is being summed or queued",
        returned.eq(summing + held),
    );
    proof.assert(
        "as many vertices are being summed as bits say",
        summing.eq(m.concat(&unit.summing).count_ones(BITS)),
    );
    proof.assert(
        "no more vertices are under way than the write queue has room for",
        wide(under_way).le(depth) & outside.le(depth),
    );
    proof.assert(
        "nothing is pushed to a full write queue",
        held.le(depth) & unit.vertex_done.implies(held.lt(depth)),
    );
    let most_ahead = m.lit(unit.vectors.room + 1, BITS);
    proof.assert(
        "no more is ahead than has room",
        columns_ahead.le(most_ahead) & rest_ahead.le(most_ahead) & summing.le(depth),
    );
    let nothing_left = unit.vertices_left.is_zero() & unit.columns_to_come.is_zero();
    proof.assert(
        "a mesh is over only when all of it is written",
        skinning | (nothing_left & !issued.valid),
    );
    proof.assert(
        "a vertex is in the geometry unit only while that is borrowed",
        skinning | outside.is_zero(),
    );
    proof.assert(
        "no vector is requested but for a mesh",
        unit.vector_wanted.implies(skinning),
    );
    let moves = m.or_all(&[
        unit.vector_requested,
        unit.row_requested,
        unit.column_comes,
        unit.issue,
        issued.valid,
        summing.any(),
        unit.queue_grows,
        unit.over,
    ]);
    let waits = m.or_all(&[
        unit.vector_wanted & vectors.has_room,
        vectors.count.any() & !unit.vectors.valid,
        unit.rows_wanted & rows.has_room,
        rows.count.any() & !unit.rows.valid,
        outside.any(),
        write.valid,
    ]);
    proof.assert(
        "while a mesh is skinned something moves, or memory or the geometry unit is waited for",
        skinning.implies(moves | waits),
    );
    unit.under_way.assert_room(proof);
    proof.fault(
        "a vertex is begun without room",
        unit.room_missing.fault().as_value(0),
    );
    proof.fault(
        "a mesh is over when the last vertex is requested",
        (unit.over.reads(unit.vertices_left)).as_signal(unit.rest_to_request),
    );
    proof.fault(
        "a vertex's room comes back when it is summed",
        under_way.reads(unit.written).as_signal(unit.vertex_done),
    );
    proof.fault(
        "room for a vertex is never seen",
        unit.room.fault().as_value(0),
    );
}

/// Nothing is pushed to the write queue where it is full, which [`conserves`] shows. One vertex, any, is watched.
pub(super) fn write_queue<'b>(m: &'b Builder, unit: &Unit<'b>) {
    let proof = m.proof(
        "write_queue",
        format!(
            "vertices are written in order, each once, and stay until taken; a queue of {}",
            unit.depth
        ),
    );
    let depth = m.lit(unit.depth, BITS);
    let (held, head) = (unit.held(), wide(unit.queue_head));
    let write = unit.outputs.write;
    // Of any bits that come and go, so of those of the pipeline too. The data are inputs.
    proof.cut(unit.vertex_done);
    proof.assume(
        "a vertex comes only where the write queue has room",
        unit.vertex_done.implies(held.lt(depth)),
    );
    let watching = proof.reg_reset("watching", 1, 0);
    let word = proof.reg("word", unit.queue_data.width());
    let before = proof.reg("before", BITS);
    let slot = proof.reg("slot", BITS);
    let begins = !watching.q & unit.vertex_done & proof.any_seq("choose", 1);
    let passes = watching.q & unit.written;
    let in_turn = watching.q & before.q.is_zero();
    watching.next(begins | (watching.q & !(passes & in_turn)));
    word.next_when(begins, unit.queue_data);
    before.next_when(
        begins | passes,
        begins.mux(held - wide(unit.written), before.q - m.lit(1u8, BITS)),
    );
    slot.next_when(begins, wide(unit.queue_tail));
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
        "the tail is as far from the head as there are vertices",
        wide(unit.queue_tail).eq(from_head(held)),
    );
    proof.assert(
        "a watched vertex is held until it is written",
        watching.q.implies(before.q.lt(held)),
    );
    proof.assert(
        "a watched vertex keeps its slot",
        watching.q.implies(slot.q.eq(from_head(before.q))),
    );
    let stored = (unit.queue).peek(slot.q.low(bits_for(u64::from(unit.depth))));
    proof.assert(
        "a watched vertex is stored as it was summed",
        watching.q.implies(stored.eq(word.q)),
    );
    proof.assert(
        "a watched vertex is shown in its turn, until it is written",
        (in_turn & write.valid).implies(write.payload.data.eq(word.q)),
    );
    proof.fault(
        "a vertex shows before it is in the queue",
        (unit.queue_grows.reads(unit.vertex_done)).as_signal(unit.inputs.weighted.valid),
    );
    proof.fault(
        "the vertex behind is read where none is written",
        unit.written.reads(write.valid).as_value(1),
    );
    proof.fault(
        "a vertex is stored beside its slot",
        unit.queue.write_address().as_signal(unit.queue_head),
    );
}
