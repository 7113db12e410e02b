//! Fetch: starts updates, and prefetches the rows of their programs and the vertices of their loads.

use super::decode::Decode;
use super::{Around, Start, VERTEX_INDICES, counts_later};
use crate::hdl::fifo::Placed;
use crate::hdl::prefetch::Occupancy;
use crate::hdl::properties::Reader;
use crate::hdl::{Flow, HdlError, Signal};
use crate::hw::counters::{counts_down, counts_up};

/// The prefetched rows of a program.
pub(super) struct Rows<'b> {
    /// Whether an update may start, and the update that starts.
    pub start_ready: Signal<'b>,
    pub start: Start<'b>,
    /// High from the cycle after a start until the object's box is accepted.
    pub running: Signal<'b>,
    pub reader: Reader<'b>,
    // For the properties.
    pub any_left: Signal<'b>,
    pub next: Signal<'b>,
    pub requested: Signal<'b>,
    /// The register that tells that the prefetcher was empty, if there is one.
    pub none_before: Option<Signal<'b>>,
}

impl<'b> Rows<'b> {
    /// Starts an update when the previous one is complete and none of its rows is left, and requests its rows in order. The front row is
    /// stable until `pop_row`, which may be high only while the row is valid; `box_taken` ends the update.
    pub fn new(around: &Around<'b>) -> Result<Rows<'b>, HdlError> {
        let Around { plan, m, .. } = *around;
        let (inputs, told) = (&around.inputs, &around.told);
        let (start, update, a) = (inputs.start.valid, inputs.start.payload, plan.address());
        m.comment("An update starts when the last one is complete and none of its rows is left in the prefetcher.");
        let running = m.reg_reset("running", 1, 0);
        let rows_left = m.reg("rows_left", a);
        let any_rows_left = m.reg_reset("any_rows_left", 1, 0);
        let no_rows = m.wire("no_rows", 1);
        let start_ready = (no_rows.get() & !(running.q | any_rows_left.q)).named("idle");
        let start = (start & start_ready).named("start");
        running.next(start | (running.q & !told.box_taken));

        m.comment("Prefetch of program rows.");
        let fetch_row = m.reg("fetch_row", a);
        let wanted = any_rows_left.q;
        let names = ("program_prefetch", "rows");
        let room = plan.config.update_program_rows;
        let fetch = Flow::new(wanted, fetch_row.q);
        let reader = Reader::new(
            plan.timing.arrival,
            names,
            room,
            fetch,
            inputs.program,
            told.pop_row,
        )?;
        // Not while a row is requested that the register does not reflect yet.
        let none_before = counts_later(plan).then(|| {
            let before = m.reg_reset("no_rows_before", 1, 1);
            before.next(reader.empty & !wanted);
            before.q
        });
        no_rows.drive(none_before.unwrap_or(reader.empty));
        let requested = (wanted & reader.fetch_ready).named("row_requested");
        let moves = (start | requested).hinted("fetch_moves");
        counts_up(fetch_row, (start, update.program), requested);
        counts_down(rows_left, (start, update.rows), requested);
        let last_row = rows_left.q.equals(1).named("last_row");
        any_rows_left.next_when(moves, start.mux(update.rows.any(), !last_row));
        Ok(Rows {
            start_ready,
            start: Flow::new(start, update),
            running: running.q,
            reader,
            any_left: wanted,
            next: fetch_row.q,
            requested,
            none_before,
        })
    }
}

/// The prefetched vertices of loads.
pub(super) struct Vertices<'b> {
    /// The loads with reserved room: it determines whether one more may be decoded.
    pub indices_in_flight: Occupancy<'b>,
    pub reader: Reader<'b>,
    // For the properties.
    pub indices: Placed<'b>,
}

impl<'b> Vertices<'b> {
    /// Requests the vertices of decoded loads in order. The front vertex is stable until `pop_vertex`, which may be high only while it is valid.
    pub fn new(around: &Around<'b>, decode: &Decode<'b>) -> Result<Vertices<'b>, HdlError> {
        let Around { plan, m, .. } = *around;
        let (inputs, told) = (&around.inputs, &around.told);
        m.comment("Prefetch of vertices, in the order of their loads.");
        let take_index = m.wire("take_index", 1);
        let take = take_index.get();
        let (push, data, comes) = (decode.index.valid, decode.index.payload, decode.decode_load);
        let indices = plan.queue("vertex_indices", VERTEX_INDICES, push, data, take)?;
        let most = VERTEX_INDICES;
        let in_flight = Occupancy::new(plan.timing.room, m, "indices_under_way", most, comes, take);
        let names = ("vertex_prefetch", "vertices");
        let room = plan.config.update_vertices_ahead;
        let fetch = Flow::new(indices.valid, indices.front);
        let reader = Reader::new(
            plan.timing.arrival,
            names,
            room,
            fetch,
            inputs.vertex,
            told.pop_vertex,
        )?;
        take_index.drive(indices.valid & reader.fetch_ready);
        Ok(Vertices {
            reader,
            indices,
            indices_in_flight: in_flight,
        })
    }
}
