//! Fetch: starts meshes, and prefetches their influences, palettes and vertices at rest.

use super::{Around, Column, Start, joint_bits};
use crate::hdl::properties::Reader;
use crate::hdl::{Flow, HdlError, Signal};
use crate::hw::counters::{counts_down, counts_up};

/// The prefetched influence rows of a mesh.
pub(super) struct Rows<'b> {
    /// Whether a mesh may start, and the mesh that starts.
    pub start_ready: Signal<'b>,
    pub start: Start<'b>,
    /// High from the cycle after a start until the whole mesh is written.
    pub skinning: Signal<'b>,
    pub reader: Reader<'b>,
    // For the properties.
    pub wanted: Signal<'b>,
    pub address: Signal<'b>,
    pub requested: Signal<'b>,
}

impl<'b> Rows<'b> {
    /// Starts a mesh when the previous one is written, none of its rows is left and the geometry unit is available, and requests its rows
    /// in order. The front row is stable until `pop_row`, which may be high only while the row is valid.
    pub fn new(around: &Around<'b>) -> Result<Rows<'b>, HdlError> {
        let Around { plan, m, .. } = *around;
        let (inputs, told) = (&around.inputs, &around.told);
        let (start, mesh, a) = (inputs.start.valid, inputs.start.payload, plan.address());
        m.comment("A mesh starts when the last one is written and none of its rows is left in the prefetcher.");
        let skinning = m.reg_reset("skinning_now", 1, 0);
        let rows_left = m.reg_reset("rows_left", a, 0);
        let no_rows = m.wire("no_rows", 1);
        let wanted = rows_left.q.any().named("rows_wanted");
        let idle = (no_rows.get() & !(skinning.q | wanted)).named("idle");
        let start_ready = (idle & inputs.may_start).named("starts_if_asked");
        let starts = (start & start_ready).named("start");
        skinning.next(starts | (skinning.q & !told.over));

        m.comment("Prefetch of influence rows.");
        let address = m.reg("row_address", a);
        let names = ("row_prefetch", "rows");
        let room = plan.config.skinning_rows_ahead;
        let (fetch, memory) = (Flow::new(wanted, address.q), inputs.influence);
        let reader = Reader::new(
            plan.timing.arrival,
            names,
            room,
            fetch,
            memory,
            told.pop_row,
        )?;
        no_rows.drive(reader.empty);
        let requested = (wanted & reader.fetch_ready).named("row_requested");
        counts_down(rows_left, (starts, mesh.rows), requested);
        counts_up(address, (starts, mesh.influences), requested);
        Ok(Rows {
            start_ready,
            start: Flow::new(starts, mesh),
            skinning: skinning.q,
            reader,
            wanted,
            address: address.q,
            requested,
        })
    }
}

/// The prefetched vectors of a mesh: the palette, then the vertices at rest.
pub(super) struct Vectors<'b> {
    /// The vectors of the palette, output when they arrive; `loading` is high until the last one has arrived.
    pub palette: Flow<Column<Signal<'b>>, Signal<'b>>,
    pub loading: Signal<'b>,
    pub reader: Reader<'b>,
    // For the properties.
    pub columns_to_request: Signal<'b>,
    pub rest_to_request: Signal<'b>,
    pub wanted: Signal<'b>,
    pub address: Signal<'b>,
    pub requested: Signal<'b>,
    pub column_requested: Signal<'b>,
    pub rest_requested: Signal<'b>,
    pub columns_to_come: Signal<'b>,
}

impl<'b> Vectors<'b> {
    /// Requests the vectors of a mesh in order. A vertex at rest stays at the front until `completes`.
    pub fn new(around: &Around<'b>, start: Start<'b>) -> Result<Vectors<'b>, HdlError> {
        let Around { plan, m, .. } = *around;
        let (inputs, told) = (&around.inputs, &around.told);
        let (start, mesh) = (start.valid, start.payload);
        m.comment("Prefetch of vectors: the palette, then the vertices at rest.");
        let a = plan.address();
        let columns = mesh.joints.concat(m.zero(2)).named("columns");
        let columns_to_request = m.reg_reset("columns_to_request", columns.width(), 0);
        let column_address = m.reg("column_address", a);
        let rest_to_request = m.reg_reset("rest_to_request", a, 0);
        let rest_address = m.reg("rest_address", a);
        let requests_column = columns_to_request.q.any().named("requests_column");
        let wanted = (requests_column | rest_to_request.q.any()).named("vector_wanted");
        let pop = m.wire("pop_vector", 1);
        let address = requests_column.mux(column_address.q, rest_address.q);
        let names = ("vector_prefetch", "vectors");
        let room = plan.config.skinning_vertices_ahead;
        let fetch = Flow::new(wanted, address);
        let reader = Reader::new(
            plan.timing.arrival,
            names,
            room,
            fetch,
            inputs.vertex,
            pop.get(),
        )?;
        let requested = (wanted & reader.fetch_ready).named("vector_requested");
        let column_requested = (requested & requests_column).named("column_requested");
        let rest_requested = (requested & !requests_column).named("rest_requested");
        counts_down(columns_to_request, (start, columns), column_requested);
        counts_up(column_address, (start, mesh.palette), column_requested);
        counts_down(rest_to_request, (start, mesh.vertices), rest_requested);
        counts_up(rest_address, (start, mesh.rest), rest_requested);

        m.comment("The vectors of the palette are written to its memories as they arrive.");
        let joint_width = joint_bits(plan);
        let columns_to_come = m.reg_reset("columns_to_come", columns.width(), 0);
        let column_place = m.reg("column_place", joint_width + 2);
        let loading = columns_to_come.q.any().named("loading");
        let column_comes = (reader.valid & loading).named("column_comes");
        counts_down(columns_to_come, (start, columns), column_comes);
        let first_place = m.zero(joint_width + 2);
        counts_up(column_place, (start, first_place), column_comes);
        pop.drive(column_comes | told.completes);
        let palette = Column {
            joint: column_place.q.high(joint_width),
            column: column_place.q.low(2),
            data: reader.front,
        };
        Ok(Vectors {
            palette: Flow::new(column_comes, palette),
            loading,
            reader,
            columns_to_request: columns_to_request.q,
            rest_to_request: rest_to_request.q,
            wanted,
            address,
            requested,
            column_requested,
            rest_requested,
            columns_to_come: columns_to_come.q,
        })
    }
}
