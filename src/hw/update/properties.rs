//! Properties of the update processor: credits are exact, so none is lost and no queue overflows; ports are stable until their offers
//! are accepted; and while it runs, it makes progress or waits for memory (no deadlock). Assumptions: the proved properties of queues
//! and prefetchers; each instruction of a program is of one kind; the rows of a program contain its end.

use super::decode::Decode;
use super::execute::Execute;
use super::fetch::{Rows, Vertices};
use super::write::{End, Nodes};
use super::{Around, Instruction};
use crate::hdl::properties::{Ahead, assert_shown_stays};
use crate::hdl::{Builder, Proof, Signal};

/// Width of sums over several places.
const BITS: u32 = 10;

impl<'b> Instruction<Signal<'b>> {
    /// Whether it is of at most one kind.
    fn one(&self) -> Signal<'b> {
        at_most_one(&[self.load, self.leaf, self.node, self.end])
    }
}

fn at_most_one<'b>(bits: &[Signal<'b>]) -> Signal<'b> {
    let m = bits[0].module();
    m.concat(bits).count_ones(3).le(m.lit(1u8, 3))
}

/// The unit's parts.
pub(super) struct Unit<'b> {
    pub around: Around<'b>,
    pub rows: Rows<'b>,
    pub decode: Decode<'b>,
    pub vertices: Vertices<'b>,
    pub execute: Execute<'b>,
    pub nodes: Nodes<'b>,
    pub end: End<'b>,
}

fn wide(signal: Signal<'_>) -> Signal<'_> {
    signal.extend(BITS)
}

/// The content of the instruction queue, whose words leave unchanged.
struct Passing<'b> {
    /// Loads among its words.
    loads: Signal<'b>,
    /// Whether it contains an end, and the number of words before it.
    end: Signal<'b>,
    before_end: Signal<'b>,
}

impl<'b> Passing<'b> {
    fn new(unit: &Unit<'b>, proof: &Proof<'b>) -> Passing<'b> {
        let m = proof.module();
        let held = unit.execute.queue.count(BITS);
        let front = unit.execute.front;
        let loads = proof.reg_reset("loads", BITS, 0);
        let comes = unit.decode.completed.valid & unit.decode.completed_as.load;
        let goes = unit.execute.take & front.load;
        loads.next(loads.q + wide(comes) - wide(goes));
        let end = proof.reg_reset("end_in_queue", 1, 0);
        let before_end = proof.reg("before_end", BITS);
        let ends = unit.decode.completed.valid & unit.decode.completed_as.end;
        let leaves = unit.execute.take & before_end.q.is_zero();
        end.next(ends | (end.q & !leaves));
        before_end.next_when(
            ends | unit.execute.take,
            ends.mux(
                held - wide(unit.execute.take),
                before_end.q - m.lit(1u8, BITS),
            ),
        );
        let shown = unit.execute.queue.valid;
        let assume =
            |what: &str, condition: Signal<'b>| proof.assume(what, shown.implies(condition));
        assume("an instruction is of one kind", front.one());
        assume(
            "a load that leaves the queue was in it",
            front.load.implies(loads.q.any()),
        );
        assume(
            "if the front is not a load, not all words are loads",
            front.load | loads.q.ne(held),
        );
        assume(
            "the end leaves in order",
            front.end.eq(end.q & before_end.q.is_zero()),
        );
        Passing {
            loads: loads.q,
            end: end.q,
            before_end: before_end.q,
        }
    }
}

pub(super) fn credit<'b>(m: &'b Builder, unit: &Unit<'b>) {
    let proof = m.proof(
        "credit",
        "credits are exact; no queue overflows; stable ports; no deadlock",
    );
    let proof = &proof;
    let queues = [
        &unit.execute.queue,
        &unit.vertices.indices,
        &unit.nodes.queue,
    ];
    queues.iter().for_each(|queue| queue.keep(proof));
    let rows = Ahead::assumed(proof, "rows", unit.rows.requested, &unit.rows.reader);
    let take_index = unit.vertices.indices.pop;
    let vertices = Ahead::assumed(proof, "vertices", take_index, &unit.vertices.reader);
    let passing = Passing::new(unit, proof);
    proof.assume(
        "no instruction is both a reload and an end",
        !(unit.decode.first.says.reload & unit.decode.first.says.end),
    );
    let starved = unit.decode.decoding
        & !unit.decode.first.complete
        & !unit.decode.window.refill
        & !unit.rows.any_left;
    proof.assume(
        "the rows of a program contain its end",
        !(starved & unit.rows.reader.empty),
    );
    proof.cover("an update is done", unit.end.done);

    let (node_write, box_write) = (unit.nodes.write, unit.end.write);
    for (what, valid, ready, shown) in [
        (
            "program row",
            unit.rows.any_left,
            unit.rows.reader.fetch_ready,
            &[unit.rows.next][..],
        ),
        (
            "vertex",
            unit.vertices.indices.valid,
            unit.vertices.reader.fetch_ready,
            &[],
        ),
        (
            "node write",
            node_write.valid,
            unit.around.inputs.node_write_ready,
            &[node_write.payload.address, node_write.payload.mask],
        ),
        (
            "box write",
            box_write.valid,
            unit.around.inputs.box_write_ready,
            &[box_write.payload.address],
        ),
    ] {
        assert_shown_stays(proof, what, valid, ready, shown);
    }
    if let Some(before) = unit.rows.none_before {
        proof.assert(
            "a prefetcher marked as empty is empty",
            before.implies(rows.count.is_zero()),
        );
    }
    proof.fault(
        "a credit is returned twice",
        (unit.execute.in_flight.count.enable()).as_signal(unit.execute.queue.pop),
    );
    proof.fault(
        "a node is issued without room",
        unit.execute
            .node_goes
            .reads(unit.around.told.node_room)
            .as_value(1),
    );
    proof.fault(
        "room for an instruction is never detected",
        unit.around.told.queue_room.fault().as_value(0),
    );
    proof.fault(
        "the vertex of a load is not requested",
        unit.vertices.indices.push_input().as_value(0),
    );
    credits(proof, unit, &vertices, &passing);
    order(proof, unit, &rows, &passing);
    ends(proof, unit, &rows, &vertices);
}

/// Asserts the meaning of each credit.
fn credits<'b>(proof: &Proof<'b>, unit: &Unit<'b>, vertices: &Ahead<'b>, passing: &Passing<'b>) {
    let decoded_load = unit.decode.decoded & unit.decode.decoded_as.load;
    let merging = unit.nodes.to_queue.iter().map(|bit| wide(*bit));
    let merging = merging
        .reduce(|sum, bit| sum + bit)
        .expect("a merge takes cycles");
    let held = unit.execute.queue.count(BITS);
    let waiting = unit.vertices.indices.count(BITS);
    for (occupancy, place, stands_for, what) in [
        (
            &unit.execute.in_flight,
            &unit.execute.queue,
            held + wide(unit.decode.decoded) + wide(unit.decode.completed.valid),
            "an instruction's credit is in the queue, or just decoded or completed",
        ),
        (
            &unit.vertices.indices_in_flight,
            &unit.vertices.indices,
            waiting + wide(decoded_load),
            "a vertex index's credit is in the queue or just decoded",
        ),
        (
            &unit.nodes.in_flight,
            &unit.nodes.queue,
            unit.nodes.queue.count(BITS) + merging,
            "a node's credit is in the queue or in the merge",
        ),
    ] {
        let most = proof.module().lit(place.depth, BITS);
        occupancy.assert_room(proof);
        proof.assert(what, wide(occupancy.count).eq(stands_for));
        proof.assert(
            format!(
                "no more credits for {} are in use than there is room",
                place.name
            ),
            wide(occupancy.count).le(most),
        );
        proof.assert(
            format!("no word is pushed to a full {}", place.name),
            place.push.implies(place.count(BITS).lt(most)),
        );
    }
    let loads = passing.loads
        + wide(unit.execute.load_waits)
        + wide(unit.decode.completed.valid & unit.decode.completed_as.load);
    proof.assert(
        "every waiting load has its vertex in flight",
        loads.eq(waiting + vertices.count),
    );
    proof.assert(
        "no more loads are in the queue than instructions",
        passing.loads.le(held),
    );
}

/// Asserts, from the window to the instruction queue, that instructions are of one kind and that the end is last.
fn order<'b>(proof: &Proof<'b>, unit: &Unit<'b>, rows: &Ahead<'b>, passing: &Passing<'b>) {
    let m = proof.module();
    let there = unit.decode.window.there.q;
    let one = m.lit(1u8, there.width());
    proof.assert(
        "the valid bytes of the window start with the first",
        unit.decode
            .decoding
            .implies((there & (there + one)).is_zero()),
    );
    proof.assert(
        "the window is empty when an update starts",
        unit.rows.running | unit.decode.window.idle_before,
    );
    proof.assert(
        "no row arrives so soon after a start that it would be lost",
        (unit.decode.decoding & unit.decode.window.idle_before)
            .implies(!unit.rows.reader.valid & rows.count.is_zero()),
    );
    for (what, valid, kinds) in [
        ("a decoded", unit.decode.decoded, unit.decode.decoded_as),
        ("the current", unit.execute.valid, unit.execute.current),
        (
            "a completed",
            unit.decode.completed.valid,
            unit.decode.completed_as,
        ),
    ] {
        proof.assert(
            format!("{what} instruction is of one kind"),
            valid.implies(kinds.one()),
        );
    }
    let held = unit.execute.queue.count(BITS + 1);
    let decoded_end = unit.decode.decoded & unit.decode.decoded_as.end;
    let completed_end = unit.decode.completed.valid & unit.decode.completed_as.end;
    let end_waits = unit.execute.end_waits;
    proof.assert(
        "the end is the last in its queue",
        (passing.end)
            .implies((passing.before_end.extend(BITS + 1) + m.lit(1u8, BITS + 1)).eq(held)),
    );
    let decodes = unit.decode.decoding | (unit.decode.decoded & !unit.decode.decoded_as.end);
    proof.assert(
        "no instruction is decoded after an end",
        (passing.end | end_waits | completed_end | decoded_end).implies(!decodes),
    );
    proof.assert(
        "no instruction follows the end",
        end_waits.implies(held.is_zero() & !unit.decode.decoded & !unit.decode.completed.valid),
    );
    proof.assert(
        "no instruction is completed after the end",
        (passing.end | completed_end)
            .implies(!unit.decode.decoded & !(passing.end & unit.decode.completed.valid)),
    );
    proof.assert(
        "a running update is being decoded, or its end is in flight",
        (unit.rows.running).eq(unit.decode.decoding
            | decoded_end
            | completed_end
            | passing.end
            | end_waits),
    );
    proof.assert(
        "an update has one end",
        at_most_one(&[decoded_end, completed_end, passing.end, end_waits]),
    );
    let left = unit.decode.decoded
        | unit.decode.completed.valid
        | held.any()
        | unit.execute.valid
        | unit.nodes.in_flight.count.any();
    proof.assert(
        "an update runs while anything of it is left",
        left.implies(unit.rows.running),
    );
    proof.assert(
        "no update starts while rows are left",
        (unit.rows.any_left | rows.count.any()).implies(!unit.rows.start.valid),
    );
}

/// Asserts the conditions of the end of an update, and that it is reached.
fn ends<'b>(proof: &Proof<'b>, unit: &Unit<'b>, rows: &Ahead<'b>, vertices: &Ahead<'b>) {
    let m = proof.module();
    let box_shown = unit.end.write.valid;
    let mut waited = vec![];
    let mut so_far = unit.execute.end_waits;
    for clock in 0..unit.end.merging.len() {
        let register = proof.reg_reset(&format!("waited{clock}"), 1, 0);
        register.next(so_far);
        so_far = register.q;
        waited.push(so_far);
    }
    for (waited, merges) in waited.iter().zip(&unit.end.merging) {
        proof.assert("no merge starts while the end waits", !(*waited & *merges));
    }
    for (waited, waits) in waited.iter().zip(&unit.end.waiting) {
        proof.assert("the registers of a waiting end agree", waits.eq(*waited));
    }
    proof.assert(
        "a box is presented only at the end of an update",
        box_shown.implies(unit.execute.end_waits),
    );
    proof.assert(
        "a box is presented only when all else is complete",
        box_shown.implies(unit.end.all_complete),
    );
    proof.assert(
        "the presented box was read after the end arrived",
        box_shown.implies(m.and_all(&waited)),
    );
    let end_moves = !unit.end.box_was_read
        | (unit.end.all_complete & !box_shown)
        | (!unit.end.all_complete & unit.nodes.in_flight.count.is_zero());
    let moves = m.or_all(&[
        unit.rows.requested,
        unit.rows.reader.pop,
        unit.decode.window.take_word,
        unit.decode.window.refill,
        unit.decode.decode,
        unit.decode.decoded,
        unit.decode.completed.valid,
        unit.vertices.indices.pop,
        unit.execute.take,
        unit.execute.goes,
        m.or_all(&unit.nodes.to_queue),
        unit.execute.end_waits & end_moves,
    ]);
    let memory = m.or_all(&[
        unit.rows.any_left & rows.has_room,
        rows.count.any() & !unit.rows.reader.valid,
        unit.vertices.indices.valid & vertices.has_room,
        vertices.count.any() & !unit.vertices.reader.valid,
        unit.nodes.write.valid,
        box_shown,
    ]);
    proof.assert(
        "an update makes progress or waits for memory",
        unit.rows.running.implies(moves | memory),
    );
}
