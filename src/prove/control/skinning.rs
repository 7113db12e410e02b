//! The skinning processor.

use super::*;

/// Of the skinning processor: every vertex that it has begun is in one place until it is written, so its write queue never
/// overflows; vertices are written in the order in which the geometry unit returns them, each once; a mesh is over when, and only when,
/// all of it is written; what it shows at its ports stays; and while it works, something in it moves unless memory or the geometry
/// unit is waited for. It is assumed that the geometry unit returns what it was issued, and that a mesh's rows have an end for each
/// vertex.
pub(super) fn conserves(module: &Rc<Module>) -> Result<Induction> {
    let depth = words(module, "write_queue")?;
    let width = port_width(module, "write_data")?;
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
  reg [15:0] f_outside, f_summing;
  always @(posedge clk)
    if (rst) begin
      f_outside <= 0; f_summing <= 0;
    end else begin
      f_outside <= f_outside + (issued & issued_last) - f_returns;
      f_summing <= f_summing + f_returns - vertex_done;
    end
  always @* assume (!f_returns | f_outside != 0);
  always @* assume (!(skinning_now & !loading & vectors_valid & rows_empty & !rows_wanted));
  wire [15:0] f_summing_bits = vertex_ready + {bits};
  wire [31:0] f_left = columns_to_request + rest_to_request + f_vectors_ahead + vertices_under_way;
  wire [31:0] f_columns_here = columns_to_come - columns_to_request;

  (* anyseq *) wire f_choose;
  reg f_watching;
  reg [{width}-1:0] f_word;
  reg [15:0] f_before;
  always @(posedge clk)
    if (rst) f_watching <= 1'b0;
    else if (!f_watching) begin
      if (vertex_done & f_choose) begin
        f_watching <= 1'b1;
        f_word <= write_queue_write_data;
        f_before <= queue_count + queue_grows - written;
      end
    end else if (written) begin
      f_before <= f_before - 1'b1;
      if (f_before == 0) f_watching <= 1'b0;
    end
  wire [15:0] f_held = queue_count + queue_grows;
  wire [15:0] f_end = queue_head + f_held;
  wire [15:0] f_tail = f_end >= {depth} ? f_end - {depth} : f_end;
  wire [15:0] f_at = queue_head + f_before;
  wire [15:0] f_slot = f_at >= {depth} ? f_at - {depth} : f_at;
  wire [{width}-1:0] f_stored = write_queue[f_slot[{index}-1:0]];
  wire [{width}-1:0] f_first = write_queue[queue_head];

  wire f_moves = vector_requested | row_requested | column_comes | issue | issued | f_summing != 0 | queue_grows | over;
  wire f_waits = (vector_wanted & f_vectors_ahead < {vector_room}) | (f_vectors_ahead != 0 & !vectors_valid)
    | (rows_wanted & f_rows_ahead < {row_room}) | (f_rows_ahead != 0 & !rows_valid) | f_outside != 0 | write_valid;
",
        bits = summing.join(" + "),
        index = bits_for(u64::from(depth)),
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
            "{write_address, write_data}",
        ),
        vectors.law(),
        rows.law(),
    ];
    laws.extend([
        law(
            "as many vertices are being summed as bits say",
            "f_summing == f_summing_bits",
        ),
        law(
            "every vertex begun is issued, in the geometry unit, being summed or queued",
            "vertices_under_way == f_outside + f_summing + f_held + (issued & issued_last)",
        ),
        law(
            "no more vertices are in the geometry unit than have room",
            format!("f_outside <= {depth}"),
        ),
        law(
            "no more vertices are begun than the write queue has room for",
            format!("vertices_under_way <= {depth}"),
        ),
        law(
            "nothing is pushed to a full write queue",
            format!("!vertex_done | f_held < {depth}"),
        ),
        law("the head is a slot", format!("queue_head < {depth}")),
        law(
            "the tail is as far from the head as there are words",
            "queue_tail == f_tail",
        ),
        law(
            "a watched word is held until it is written",
            "!f_watching | f_before < f_held",
        ),
        law(
            "a watched word keeps its slot",
            "!f_watching | f_stored == f_word",
        ),
        law(
            "the word that is shown is the head's",
            "!write_valid | write_data == f_first",
        ),
        law(
            "a watched word is written in its turn",
            "!(f_watching & f_before == 0 & write_valid) | write_data == f_word",
        ),
        law(
            "columns come as they were requested",
            "columns_to_request <= columns_to_come & f_columns_here <= f_vectors_ahead",
        ),
        law(
            "vertices are requested behind all columns",
            "columns_to_request == 0 | f_columns_here == f_vectors_ahead",
        ),
        law(
            "what is left to do is to be requested, ahead, or under way",
            "f_left == columns_to_come + vertices_left",
        ),
        law(
            "a mesh is over only when all of it is written",
            "skinning_now | (f_left == 0 & !issued)",
        ),
        law(
            "a vertex is in the geometry unit only while that is borrowed",
            "skinning | f_outside == 0",
        ),
        law(
            "while a mesh is skinned something moves, or memory or the geometry unit is waited for",
            "!skinning_now | f_moves | f_waits",
        ),
    ]);
    Ok(Induction {
        module: module.name().into(),
        what: "no vertex is lost or doubled, the write queue keeps order, a mesh ends when written, ports, nothing locks up"
            .into(),
        texts: texts(module, &["_prefetch"]),
        observer,
        laws,
        cut: vec![],
        depth: 1,
        arrays: true,
        plants: vec![
            plant(
                "a vertex is begun without room",
                "wire room_missing =",
                "influence_last & ~room",
                "1'b0",
            ),
            plant(
                "a mesh is over when the last vertex is begun",
                "wire over =",
                "vertices_left",
                "rest_to_request",
            ),
            plant(
                "a word shows before it is in the queue",
                "queue_grows <= ",
                "0; else queue_grows <= vertex_done",
                "0; else queue_grows <= vertex_ready",
            ),
            plant(
                "a vertex's room comes back when it is summed",
                "if (completes ^ written)",
                "completes ^ written",
                "completes ^ vertex_done",
            ),
        ],
    })
}
