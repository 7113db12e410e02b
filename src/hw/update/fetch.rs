//! Fetch: starts updates, and reads the rows of their programs and the vertices of their loads ahead of their use.

use super::{Start, VERTEX_INDICES, counts_later};
use crate::hdl::{Builder, Flow, HdlError, ReadInputs, Signal};
use crate::hw::counters::{counts_down, counts_up};
use crate::hw::fifo::{self, Placed};
use crate::hw::plan::Plan;
use crate::hw::prefetch::{self, Occupancy, prefetch};
use crate::hw::properties::Reader;

/// The rows of a program, as they come.
pub(super) struct Rows<'b> {
    /// Whether an update may start, and one that starts.
    pub start_ready: Signal<'b>,
    pub start: Start<'b>,
    /// High from the clock after a start until the object's box is taken.
    pub running: Signal<'b>,
    pub fetched: prefetch::Outputs<Signal<'b>>,
    // For the properties.
    pub any_left: Signal<'b>,
    pub next: Signal<'b>,
    pub requested: Signal<'b>,
    pub reader: Reader<'b>,
    /// Where it has one, the register that says that nothing was in the reader.
    pub none_before: Option<Signal<'b>>,
}

impl<'b> Rows<'b> {
    /// Starts an update when the last one is over and none of its rows is left, and requests its rows in order. The front row stays until
    /// `pop_row`, which comes only where it is valid; `box_taken` ends the update.
    pub fn new(
        plan: &Plan,
        m: &'b Builder,
        start: Start<'b>,
        memory: ReadInputs<Signal<'b>>,
        pop_row: Signal<'b>,
        box_taken: Signal<'b>,
    ) -> Result<Rows<'b>, HdlError> {
        let (update, a) = (start.payload, plan.address());
        m.comment("An update starts when the last one is over and none of its rows is left.");
        let running = m.reg_reset("running", 1, 0);
        let rows_left = m.reg("rows_left", a);
        let any_rows_left = m.reg_reset("any_rows_left", 1, 0);
        let no_rows = m.wire("no_rows", 1);
        let start_ready = (no_rows.get() & !(running.q | any_rows_left.q)).named("idle");
        let start = (start.valid & start_ready).named("start");
        running.next(start | (running.q & !box_taken));

        m.comment("Fetch: rows of the program, ahead of their use.");
        let fetch_row = m.reg("fetch_row", a);
        let wanted = any_rows_left.q;
        let room = plan.config.update_program_rows;
        let inputs = prefetch::Inputs {
            fetch_valid: wanted,
            fetch_address: fetch_row.q,
            memory,
            pop: pop_row,
        };
        let fetched = prefetch(plan, ("program_prefetch", "rows"), room, inputs)?;
        // Not while a row is requested that it does not count yet.
        let none_before = counts_later(plan).then(|| {
            let before = m.reg_reset("no_rows_before", 1, 1);
            before.next(fetched.empty & !wanted);
            before.q
        });
        no_rows.drive(none_before.unwrap_or(fetched.empty));
        let requested = (wanted & fetched.fetch_ready).named("row_requested");
        let moves = (start | requested).hinted("fetch_moves");
        counts_up(fetch_row, (start, update.program), requested);
        counts_down(rows_left, (start, update.rows), requested);
        let last_row = rows_left.q.equals(1).named("last_row");
        any_rows_left.next_when(moves, start.mux(update.rows.any(), !last_row));
        Ok(Rows {
            start_ready,
            start: Flow::new(start, update),
            running: running.q,
            fetched,
            any_left: wanted,
            next: fetch_row.q,
            requested,
            reader: Reader::of(&fetched, room, pop_row),
            none_before,
        })
    }
}

/// The vertices of loads, as they come.
pub(super) struct Vertices<'b> {
    /// Whether one more load may be decoded.
    pub index_room: Signal<'b>,
    pub fetched: prefetch::Outputs<Signal<'b>>,
    // For the properties.
    pub indices: Placed<'b>,
    pub indices_in_flight: Occupancy<'b>,
    pub reader: Reader<'b>,
}

impl<'b> Vertices<'b> {
    /// Requests the vertex of each decoded load, in their order. A load takes room for its index by `decode_load`, and comes with its `index` a
    /// clock later. The front vertex stays until `pop_vertex`, which comes only where it is valid.
    pub fn new(
        plan: &Plan,
        m: &'b Builder,
        decode_load: Signal<'b>,
        index: Flow<Signal<'b>, Signal<'b>>,
        memory: ReadInputs<Signal<'b>>,
        pop_vertex: Signal<'b>,
    ) -> Result<Vertices<'b>, HdlError> {
        m.comment("Vertices are requested in the order of their loads, ahead of their use.");
        let take_index = m.wire("take_index", 1);
        let take = take_index.get();
        let (push, data) = (index.valid, index.payload);
        let indices = fifo::place(plan, "vertex_indices", VERTEX_INDICES, push, data, take)?;
        let most = VERTEX_INDICES;
        let in_flight = Occupancy::new(plan, m, "indices_under_way", most, decode_load, take);
        let room = plan.config.update_vertices_ahead;
        let inputs = prefetch::Inputs {
            fetch_valid: indices.valid,
            fetch_address: indices.front,
            memory,
            pop: pop_vertex,
        };
        let fetched = prefetch(plan, ("vertex_prefetch", "vertices"), room, inputs)?;
        take_index.drive(indices.valid & fetched.fetch_ready);
        Ok(Vertices {
            index_room: in_flight.room,
            fetched,
            indices,
            indices_in_flight: in_flight,
            reader: Reader::of(&fetched, room, pop_vertex),
        })
    }
}
