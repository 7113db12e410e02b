//! The skinning processor.

use super::*;

/// Words of the write queue on which its order is proved; no power of two, so that the wrap of its places is seen. The description
/// is the same for any depth.
pub(super) const FEW_VERTICES: u32 = 6;

/// Of the skinning processor: every vertex that it has begun is in one place until it is written, so its write queue never
/// overflows; a mesh is over when, and only when, all of it is written; what it shows at its ports stays; and while it works,
/// something in it moves unless memory or the geometry unit is waited for. It is assumed that the geometry unit returns what it was
/// issued, and that a mesh's rows have an end for each vertex.
pub(super) fn conserves(module: &Arc<Module>) -> Result<Induction> {
    let depth = words(module, "write_queue")?;
    let summing = pipeline_bits(module, "vertex_done")?;
    let vectors = Ahead {
        name: "vectors",
        takes: "vector_requested",
        pops: "pop_vector",
        room: ahead_room(module, "vectors")?,
    };
    let rows = Ahead {
        name: "rows",
        takes: "row_requested",
        pops: "pop_row",
        room: ahead_room(module, "rows")?,
    };
    let mut observer = START.to_string();
    observer += &vectors.observer();
    observer += &rows.observer();
    let _ = write!(
        observer,
        "
  wire f_returns = weighted_valid & weighted_last;
  reg [15:0] f_outside, f_summing, f_begun, f_returned, f_columns_ahead, f_rest_ahead;
  reg [31:0] f_to_begin;
  always @(posedge clk)
    if (rst) begin
      f_outside <= 0; f_summing <= 0; f_begun <= 0; f_returned <= 0;
      f_columns_ahead <= 0; f_rest_ahead <= 0; f_to_begin <= 0;
    end else begin
      f_outside <= f_outside + (issued & issued_last) - f_returns;
      f_summing <= f_summing + f_returns - vertex_done;
      f_begun <= f_begun + completes - f_returns;
      f_returned <= f_returned + f_returns - written;
      f_columns_ahead <= f_columns_ahead + column_requested - column_comes;
      f_rest_ahead <= f_rest_ahead + rest_requested - completes;
      f_to_begin <= start ? start_vertices : f_to_begin - completes;
    end
  always @* assume (!f_returns | f_outside != 0);
  always @* assume (!(skinning_now & !loading & vectors_valid & rows_empty & !rows_wanted));
  wire [15:0] f_summing_bits = vertex_ready + {bits};
  wire [15:0] f_held = queue_count + queue_grows;
  wire f_moves = vector_requested | row_requested | column_comes | issue | issued | f_summing != 0 | queue_grows | over;
  wire f_waits = (vector_wanted & f_vectors_ahead < {vector_room}) | (f_vectors_ahead != 0 & !vectors_valid)
    | (rows_wanted & f_rows_ahead < {row_room}) | (f_rows_ahead != 0 & !rows_valid) | f_outside != 0 | write_valid;
",
        bits = summing.join(" + "),
        vector_room = vectors.room,
        row_room = rows.room,
    );
    let mut laws = vec![
        shown_stays(
            &mut observer,
            "vector request",
            "vector_wanted",
            "vectors_fetch_ready",
            "vectors_fetch_address",
        ),
        shown_stays(
            &mut observer,
            "row request",
            "rows_wanted",
            "rows_fetch_ready",
            "row_address",
        ),
        shown_stays(
            &mut observer,
            "write",
            "write_valid",
            "write_ready",
            "write_address",
        ),
        vectors.law(),
        rows.law(),
    ];
    laws.extend([
        law(
            "what is ahead is columns and vertices",
            "f_vectors_ahead == f_columns_ahead + f_rest_ahead",
        ),
        law(
            "every column to come is to be requested or ahead",
            "columns_to_come == columns_to_request + f_columns_ahead",
        ),
        law(
            "vertices are requested behind all columns",
            "columns_to_request == 0 | f_rest_ahead == 0",
        ),
        law(
            "every vertex to begin is to be requested or ahead",
            "f_to_begin == rest_to_request + f_rest_ahead",
        ),
        law(
            "every vertex left is to begin or under way",
            "vertices_left == f_to_begin + vertices_under_way",
        ),
        law(
            "every vertex under way is on its way to the geometry unit or back from it",
            "vertices_under_way == f_begun + f_returned",
        ),
        law(
            "every vertex not yet back is issued or in the geometry unit",
            "f_begun == f_outside + (issued & issued_last)",
        ),
        law(
            "every vertex that is back is being summed or queued",
            "f_returned == f_summing + f_held",
        ),
        law(
            "as many vertices are being summed as bits say",
            "f_summing == f_summing_bits",
        ),
        law(
            "no more vertices are under way than the write queue has room for",
            format!("vertices_under_way <= {depth} & f_outside <= {depth}"),
        ),
        law(
            "nothing is pushed to a full write queue",
            format!("f_held <= {depth} & (!vertex_done | f_held < {depth})"),
        ),
        law(
            "no more is ahead than has room",
            format!(
                "f_columns_ahead <= {room} & f_rest_ahead <= {room} & f_summing <= {depth}",
                room = vectors.room + 1
            ),
        ),
        law(
            "a mesh is over only when all of it is written",
            "skinning_now | (vertices_left == 0 & columns_to_come == 0 & !issued)",
        ),
        law(
            "a vertex is in the geometry unit only while that is borrowed",
            "skinning | f_outside == 0",
        ),
        law(
            "no vector is requested but for a mesh",
            "skinning | !vector_wanted",
        ),
        law(
            "while a mesh is skinned something moves, or memory or the geometry unit is waited for",
            "!skinning_now | f_moves | f_waits",
        ),
    ]);
    laws.extend(room(module, "vertices_under_way", depth));
    laws.extend(room(module, "queue_count", depth));
    Ok(Induction {
        module: module.name().into(),
        what: "no vertex is lost or doubled, no queue overflows, a mesh ends when written, ports, nothing locks up"
            .into(),
        texts: texts(module, &["_prefetch"]),
        observer,
        laws,
        happens: "written".into(),
        cut: vec![],
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a vertex is begun without room",
                "wire room_missing =",
                "influence_last & ~room",
                "1'b0",
            ),
            plant(
                "a mesh is over when the last vertex is requested",
                "wire over =",
                "vertices_left",
                "rest_to_request",
            ),
            plant(
                "a vertex's room comes back when it is summed",
                "if (completes ^ written)",
                "completes ^ written",
                "completes ^ vertex_done",
            ),
            plant(
                "room for a vertex is never seen",
                "assign room =",
                "vertices_under_way",
                "1'b0 & vertices_under_way",
            ),
        ],
    })
}

/// Of its write queue: vertices are written in the order in which they were summed, each once, and the one that is shown stays until
/// it is written. Nothing is pushed to it where it is full, which [`conserves`] shows. One vertex, any, is watched.
pub(super) fn write_queue(module: &Arc<Module>) -> Result<Induction> {
    let depth = words(module, "write_queue")?;
    let width = port_width(module, "write_data")?;
    let observer = format!(
        "{START}
  wire [15:0] f_held = queue_count + queue_grows;
  always @* assume (!vertex_done | f_held < {depth});
  (* anyseq *) wire f_choose;
  reg f_watching;
  reg [{width}-1:0] f_word;
  reg [15:0] f_before, f_slot;
  always @(posedge clk)
    if (rst) f_watching <= 1'b0;
    else if (!f_watching) begin
      if (vertex_done & f_choose) begin
        f_watching <= 1'b1;
        f_word <= write_queue_write_data;
        f_before <= f_held - written;
        f_slot <= queue_tail;
      end
    end else if (written) begin
      f_before <= f_before - 1'b1;
      if (f_before == 0) f_watching <= 1'b0;
    end
  wire [15:0] f_end = queue_head + f_held;
  wire [15:0] f_tail = f_end >= {depth} ? f_end - {depth} : f_end;
  wire [15:0] f_at = queue_head + f_before;
  wire [15:0] f_from_head = f_at >= {depth} ? f_at - {depth} : f_at;
  wire [{width}-1:0] f_stored = write_queue[f_slot[{index}-1:0]];
",
        index = bits_for(u64::from(depth)),
    );
    Ok(Induction {
        module: module.name().into(),
        what: format!(
            "vertices are written in order, each once, and stay until taken; a queue of {depth}"
        ),
        texts: alone(module),
        observer,
        laws: vec![
            law(
                "no more vertices are queued than there is room",
                format!("f_held <= {depth}"),
            ),
            law("the head is a slot", format!("queue_head < {depth}")),
            law(
                "the tail is as far from the head as there are vertices",
                "queue_tail == f_tail",
            ),
            law(
                "a watched vertex is held until it is written",
                "!f_watching | f_before < f_held",
            ),
            law(
                "a watched vertex keeps its slot",
                "!f_watching | f_slot == f_from_head",
            ),
            law(
                "a watched vertex is stored as it was summed",
                "!f_watching | f_stored == f_word",
            ),
            law(
                "a watched vertex is shown in its turn, until it is written",
                "!(f_watching & f_before == 0 & write_valid) | write_data == f_word",
            ),
        ],
        happens: "f_watching & written".into(),
        cut: vec!["vertex_done".into(), "write_queue_write_data".into()],
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a vertex shows before it is in the queue",
                "else queue_grows <=",
                "vertex_done",
                "weighted_valid",
            ),
            plant(
                "the vertex behind is read where none is written",
                "assign written =",
                "write_valid & write_ready",
                "write_ready",
            ),
            plant(
                "a vertex is stored beside its slot",
                "write_queue[queue_tail] <=",
                "queue_tail",
                "queue_head",
            ),
        ],
    })
}
