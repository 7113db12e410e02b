//! What is proved of the update processor: its credits are exactly what they stand for, so none is lost and no queue overflows; what it
//! shows at its ports stays until it is taken; and while it runs, something in it moves unless memory is waited for: it cannot lock up.
//! Of its queues and of its readers ahead it assumes what is proved of them; of a program, that its instructions are of one kind each and
//! that its rows have its end.

use super::{Instruction, NodeWrite};
use crate::hdl::{Builder, Flow, Proof, Signal, Write};
use crate::hw::fifo::Placed;
use crate::hw::prefetch::Occupancy;
use crate::hw::properties::{Ahead, Reader, assert_shown_stays};

/// Bits in which what is in several places is added up.
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

/// The unit's signals, part by part.
pub(super) struct Unit<'b> {
    pub start: Signal<'b>,
    pub running: Signal<'b>,
    pub done: Signal<'b>,
    // Fetch.
    pub any_rows_left: Signal<'b>,
    pub fetch_row: Signal<'b>,
    pub row_requested: Signal<'b>,
    pub rows: Reader<'b>,
    /// Where it has one, the register that says that nothing was in the reader.
    pub no_rows_before: Option<Signal<'b>>,
    // The window and decode.
    pub window_there: Signal<'b>,
    pub idle_before: Signal<'b>,
    pub take_word: Signal<'b>,
    pub refill: Signal<'b>,
    pub decoding: Signal<'b>,
    pub instruction_there: Signal<'b>,
    pub is_reload: Signal<'b>,
    pub is_end: Signal<'b>,
    pub decode: Signal<'b>,
    pub decoded: Signal<'b>,
    pub decoded_as: Instruction<Signal<'b>>,
    // Vertices.
    pub vertex_indices: Placed<'b>,
    pub indices: Occupancy<'b>,
    pub vertices: Reader<'b>,
    // Instructions.
    pub completed: Signal<'b>,
    pub completed_as: Instruction<Signal<'b>>,
    pub instruction_queue: Placed<'b>,
    pub instructions: Occupancy<'b>,
    pub front_as: Instruction<Signal<'b>>,
    pub take: Signal<'b>,
    pub goes: Signal<'b>,
    pub current_valid: Signal<'b>,
    pub current_as: Instruction<Signal<'b>>,
    pub queue_room: Signal<'b>,
    pub node_room: Signal<'b>,
    pub node_goes: Signal<'b>,
    pub load_waits: Signal<'b>,
    pub end_waits: Signal<'b>,
    // Merge.
    /// Of a merge, one register after the other; as many as a box's read takes.
    pub merging: Vec<Signal<'b>>,
    /// Of an end that waits, the same but the last.
    pub waiting: Vec<Signal<'b>>,
    /// Of a node's bounds on their way to the queue, all registers.
    pub to_node_queue: Vec<Signal<'b>>,
    pub node_queue: Placed<'b>,
    pub nodes: Occupancy<'b>,
    pub node_write: Flow<NodeWrite<Signal<'b>>, Signal<'b>>,
    pub node_write_ready: Signal<'b>,
    pub box_write: Flow<Write<Signal<'b>>, Signal<'b>>,
    pub box_write_ready: Signal<'b>,
    pub box_was_read: Signal<'b>,
    pub all_complete: Signal<'b>,
}

fn wide(signal: Signal<'_>) -> Signal<'_> {
    signal.extend(BITS)
}

/// What passes through the instruction queue, whose words come out as they went in.
struct Passing<'b> {
    /// Loads among its words.
    loads: Signal<'b>,
    /// Whether an end is among them, and how many are before it.
    end: Signal<'b>,
    before_end: Signal<'b>,
}

impl<'b> Passing<'b> {
    fn new(unit: &Unit<'b>, proof: &Proof<'b>) -> Passing<'b> {
        let m = proof.module();
        let held = unit.instruction_queue.count(BITS);
        let front = unit.front_as;
        let loads = proof.reg_reset("loads", BITS, 0);
        let comes = unit.completed & unit.completed_as.load;
        let goes = unit.take & front.load;
        loads.next(loads.q + wide(comes) - wide(goes));
        let end = proof.reg_reset("end_in_queue", 1, 0);
        let before_end = proof.reg("before_end", BITS);
        let ends = unit.completed & unit.completed_as.end;
        let leaves = unit.take & before_end.q.is_zero();
        end.next(ends | (end.q & !leaves));
        before_end.next_when(
            ends | unit.take,
            ends.mux(held - wide(unit.take), before_end.q - m.lit(1u8, BITS)),
        );
        let shown = unit.instruction_queue.valid;
        let assume =
            |what: &str, condition: Signal<'b>| proof.assume(what, shown.implies(condition));
        assume("an instruction is of one kind", front.one());
        assume(
            "a load that comes out went in",
            front.load.implies(loads.q.any()),
        );
        assume(
            "not all are loads where the front is none",
            front.load | loads.q.ne(held),
        );
        assume(
            "the end comes out in its turn",
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
        "no credit is lost or invented, no queue overflows, what is shown at a port stays, nothing locks up",
    );
    let proof = &proof;
    let queues = [
        &unit.instruction_queue,
        &unit.vertex_indices,
        &unit.node_queue,
    ];
    queues.iter().for_each(|queue| queue.keep(proof));
    let rows = Ahead::assumed(proof, "rows", unit.row_requested, &unit.rows);
    let take_index = unit.vertex_indices.pop;
    let vertices = Ahead::assumed(proof, "vertices", take_index, &unit.vertices);
    let passing = Passing::new(unit, proof);
    proof.assume(
        "no instruction is both a reload and an end",
        !(unit.is_reload & unit.is_end),
    );
    let starved = unit.decoding & !unit.instruction_there & !unit.refill & !unit.any_rows_left;
    proof.assume(
        "a program's rows have its end",
        !(starved & unit.rows.empty),
    );
    proof.cover("an update is done", unit.done);

    let (node_write, box_write) = (unit.node_write, unit.box_write);
    for (what, valid, ready, shown) in [
        (
            "program row",
            unit.any_rows_left,
            unit.rows.fetch_ready,
            &[unit.fetch_row][..],
        ),
        (
            "vertex",
            unit.vertex_indices.valid,
            unit.vertices.fetch_ready,
            &[],
        ),
        (
            "node write",
            node_write.valid,
            unit.node_write_ready,
            &[node_write.payload.address, node_write.payload.mask],
        ),
        (
            "box write",
            box_write.valid,
            unit.box_write_ready,
            &[box_write.payload.address],
        ),
    ] {
        assert_shown_stays(proof, what, valid, ready, shown);
    }
    if let Some(before) = unit.no_rows_before {
        proof.assert(
            "what is said to be empty is",
            before.implies(rows.count.is_zero()),
        );
    }
    proof.fault(
        "a credit comes back twice",
        (unit.instructions.count.enable()).as_signal(unit.instruction_queue.pop),
    );
    proof.fault(
        "a node goes without room",
        unit.node_goes.reads(unit.node_room).as_value(1),
    );
    proof.fault(
        "room for an instruction is never seen",
        unit.queue_room.fault().as_value(0),
    );
    proof.fault(
        "a load's vertex is not asked for",
        unit.vertex_indices.push_input().as_value(0),
    );
    credits(proof, unit, &vertices, &passing);
    order(proof, unit, &rows, &passing);
    ends(proof, unit, &rows, &vertices);
}

/// What each credit stands for.
fn credits<'b>(proof: &Proof<'b>, unit: &Unit<'b>, vertices: &Ahead<'b>, passing: &Passing<'b>) {
    let decoded_load = unit.decoded & unit.decoded_as.load;
    let merging = unit.to_node_queue.iter().map(|bit| wide(*bit));
    let merging = merging
        .reduce(|sum, bit| sum + bit)
        .expect("a merge takes clocks");
    let held = unit.instruction_queue.count(BITS);
    let waiting = unit.vertex_indices.count(BITS);
    for (occupancy, place, stands_for, what) in [
        (
            &unit.instructions,
            &unit.instruction_queue,
            held + wide(unit.decoded) + wide(unit.completed),
            "an instruction's credit is in the queue, or just decoded or completed",
        ),
        (
            &unit.indices,
            &unit.vertex_indices,
            waiting + wide(decoded_load),
            "a vertex index's credit is in the queue or just decoded",
        ),
        (
            &unit.nodes,
            &unit.node_queue,
            unit.node_queue.count(BITS) + merging,
            "a node's credit is in the queue or in the merge",
        ),
    ] {
        let most = proof.module().lit(place.depth, BITS);
        occupancy.assert_room(proof);
        proof.assert(what, wide(occupancy.count).eq(stands_for));
        proof.assert(
            format!(
                "no more credits for {} are out than there is room",
                place.name
            ),
            wide(occupancy.count).le(most),
        );
        proof.assert(
            format!("nothing is pushed to a full {}", place.name),
            place.push.implies(place.count(BITS).lt(most)),
        );
    }
    let loads =
        passing.loads + wide(unit.load_waits) + wide(unit.completed & unit.completed_as.load);
    proof.assert(
        "every load that waits has its vertex on the way",
        loads.eq(waiting + vertices.count),
    );
    proof.assert(
        "no more loads are in the queue than instructions",
        passing.loads.le(held),
    );
}

/// From the window through the instruction queue: kinds, and that the end is last.
fn order<'b>(proof: &Proof<'b>, unit: &Unit<'b>, rows: &Ahead<'b>, passing: &Passing<'b>) {
    let m = proof.module();
    let there = unit.window_there;
    let one = m.lit(1u8, there.width());
    proof.assert(
        "the window's bytes are there from the first on",
        unit.decoding.implies((there & (there + one)).is_zero()),
    );
    proof.assert(
        "the window is empty when an update starts",
        unit.running | unit.idle_before,
    );
    proof.assert(
        "no row is there so soon after a start that it would be lost",
        (unit.decoding & unit.idle_before).implies(!unit.rows.valid & rows.count.is_zero()),
    );
    for (what, valid, kinds) in [
        ("a decoded", unit.decoded, unit.decoded_as),
        ("the current", unit.current_valid, unit.current_as),
        ("a completed", unit.completed, unit.completed_as),
    ] {
        proof.assert(
            format!("{what} instruction is of one kind"),
            valid.implies(kinds.one()),
        );
    }
    let held = unit.instruction_queue.count(BITS + 1);
    let decoded_end = unit.decoded & unit.decoded_as.end;
    let completed_end = unit.completed & unit.completed_as.end;
    let end_waits = unit.end_waits;
    proof.assert(
        "the end is the last in its queue",
        (passing.end)
            .implies((passing.before_end.extend(BITS + 1) + m.lit(1u8, BITS + 1)).eq(held)),
    );
    let decodes = unit.decoding | (unit.decoded & !unit.decoded_as.end);
    proof.assert(
        "nothing is decoded after an end",
        (passing.end | end_waits | completed_end | decoded_end).implies(!decodes),
    );
    proof.assert(
        "nothing is behind the end",
        end_waits.implies(held.is_zero() & !unit.decoded & !unit.completed),
    );
    proof.assert(
        "nothing is completed behind the end",
        (passing.end | completed_end).implies(!unit.decoded & !(passing.end & unit.completed)),
    );
    proof.assert(
        "an update that runs is being decoded, or its end is on its way",
        (unit.running).eq(unit.decoding | decoded_end | completed_end | passing.end | end_waits),
    );
    proof.assert(
        "an update has one end",
        at_most_one(&[decoded_end, completed_end, passing.end, end_waits]),
    );
    let left =
        unit.decoded | unit.completed | held.any() | unit.current_valid | unit.nodes.count.any();
    proof.assert(
        "an update runs while anything of it is left",
        left.implies(unit.running),
    );
    proof.assert(
        "no update starts while rows are left",
        (unit.any_rows_left | rows.count.any()).implies(!unit.start),
    );
}

/// The end of an update, and that it comes.
fn ends<'b>(proof: &Proof<'b>, unit: &Unit<'b>, rows: &Ahead<'b>, vertices: &Ahead<'b>) {
    let m = proof.module();
    let box_shown = unit.box_write.valid;
    let mut waited = vec![];
    let mut so_far = unit.end_waits;
    for clock in 0..unit.merging.len() {
        let register = proof.reg_reset(&format!("waited{clock}"), 1, 0);
        register.next(so_far);
        so_far = register.q;
        waited.push(so_far);
    }
    for (waited, merges) in waited.iter().zip(&unit.merging) {
        proof.assert("nothing merges while the end waits", !(*waited & *merges));
    }
    for (waited, waits) in waited.iter().zip(&unit.waiting) {
        proof.assert(
            "an end waits as long as its registers say",
            waits.eq(*waited),
        );
    }
    proof.assert(
        "a box is shown at an update's end only",
        box_shown.implies(unit.end_waits),
    );
    proof.assert(
        "a box is shown when all else is complete",
        box_shown.implies(unit.all_complete),
    );
    proof.assert(
        "the box that is shown was read since the end came",
        box_shown.implies(m.and_all(&waited)),
    );
    let end_moves = !unit.box_was_read
        | (unit.all_complete & !box_shown)
        | (!unit.all_complete & unit.nodes.count.is_zero());
    let moves = m.or_all(&[
        unit.row_requested,
        unit.rows.pop,
        unit.take_word,
        unit.refill,
        unit.decode,
        unit.decoded,
        unit.completed,
        unit.vertex_indices.pop,
        unit.take,
        unit.goes,
        m.or_all(&unit.to_node_queue),
        unit.end_waits & end_moves,
    ]);
    let memory = m.or_all(&[
        unit.any_rows_left & rows.has_room,
        rows.count.any() & !unit.rows.valid,
        unit.vertex_indices.valid & vertices.has_room,
        vertices.count.any() & !unit.vertices.valid,
        unit.node_write.valid,
        box_shown,
    ]);
    proof.assert(
        "while it runs something moves, or memory is waited for",
        unit.running.implies(moves | memory),
    );
}
