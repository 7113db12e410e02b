//! The update processor.

use super::*;

/// Of the update processor: its credits are exactly what they stand for, so none is lost and no queue overflows; what it shows at
/// its ports stays until it is taken; and while it runs, something in it moves unless memory is waited for: it cannot lock up. Of
/// its queues and of its readers ahead it assumes what is proved of them; of a program, that its instructions are of one kind each
/// and that its rows have its end.
pub(super) fn credit(module: &Arc<Module>) -> Result<Induction> {
    let queues = queues(module)?;
    let instructions = queue(&queues, "instruction_queue")?;
    let indices = queue(&queues, "vertex_indices")?;
    let nodes = queue(&queues, "node_queue")?;
    let to_node_queue = pipeline_bits(module, &nodes.push)?;
    // The box is read behind as many registers as a node's bounds.
    let shown = between(module, "assign box_write_data = {", "}")?;
    let (_, read) = shown
        .rsplit_once("_s")
        .context("the box is read through registers")?;
    let read: usize = read
        .trim()
        .parse()
        .context("the registers behind a box's read")?;
    let kind = |of: &str, name: &str| {
        let bit = between(module, &format!("wire current_{name} = current["), "]")?;
        anyhow::Ok(format!("{of}[{bit}]"))
    };
    let kinds = |of: &str| {
        let [load, leaf, node, end] = ["load", "leaf", "node", "end"].map(|name| kind(of, name));
        anyhow::Ok([load?, leaf?, node?, end?])
    };
    let [load, leaf, node, end] = kinds("instruction_queue_front")?;
    let pushed = kinds("completed_instruction")?;
    let (pushed_load, pushed_end) = (&pushed[0], &pushed[3]);
    let held = instructions.count();
    let mut observer = START.to_string();
    for queue in [instructions, indices, nodes] {
        observer += &queue.view();
    }
    let rows = Ahead {
        name: "rows",
        takes: "row_requested",
        pops: "pop_row",
        room: ahead_room(module, "rows")?,
    };
    let vertices = Ahead {
        name: "vertices",
        takes: "take_index",
        pops: "pop_vertex",
        room: ahead_room(module, "vertices")?,
    };
    observer += &rows.observer();
    observer += &vertices.observer();
    let _ = write!(
        observer,
        "
  wire [9:0] f_merging = {merging};
  reg [{read}-1:0] f_ends;
  always @(posedge clk) if (rst) f_ends <= 0; else f_ends <= {{f_ends, end_waits}};

  // The instruction queue's words come out as they went in: so many loads among them, the end after so many.
  reg [9:0] f_loads, f_before_end;
  reg f_end_in_queue;
  always @(posedge clk)
    if (rst) begin
      f_loads <= 0;
      f_end_in_queue <= 1'b0;
    end else begin
      f_loads <= f_loads + (completed & {pushed_load}) - (take & {load});
      if (completed & {pushed_end}) begin
        f_end_in_queue <= 1'b1;
        f_before_end <= {held} - take;
      end else if (take) begin
        if (f_before_end == 0) f_end_in_queue <= 1'b0;
        f_before_end <= f_before_end - 1'b1;
      end
    end
  always @* if (instruction_queue_valid) begin
    assume ({load} + {leaf} + {node} + {end} <= 3'd1);
    assume (!{load} | f_loads != 0);
    assume ({load} | f_loads != {held});
    assume ({end} == (f_end_in_queue & f_before_end == 0));
  end
  // Of a program.
  always @* assume (!(is_reload & is_end));
  always @* assume (!(decoding & !complete & !refill & !any_rows_left & rows_empty));

  wire f_moves = row_requested | pop_row | take_word | refill | decode | decoded | completed | take_index | take | goes | f_merging != 0
    | (end_waits & (!box_was_read | (all_complete & !box_shown) | (!all_complete & nodes_under_way == 0)));
  wire f_memory = (any_rows_left & f_rows_ahead < {row_room}) | (f_rows_ahead != 0 & !rows_valid)
    | (vertex_indices_valid & f_vertices_ahead < {vertex_room}) | (f_vertices_ahead != 0 & !vertices_valid)
    | node_write_valid | box_write_valid;
",
        merging = to_node_queue.join(" + "),
        row_room = rows.room,
        vertex_room = vertices.room,
    );
    let mut laws = vec![];
    for (name, valid, ready, stays) in [
        (
            "program row",
            "any_rows_left",
            "rows_fetch_ready",
            "fetch_row",
        ),
        (
            "vertex",
            "vertex_indices_valid",
            "vertices_fetch_ready",
            "1'b0",
        ),
        (
            "node write",
            "node_write_valid",
            "node_write_ready",
            "{node_write_address, node_write_mask}",
        ),
        (
            "box write",
            "box_write_valid",
            "box_write_ready",
            "box_write_address",
        ),
    ] {
        laws.push(shown_stays(&mut observer, name, valid, ready, stays));
    }
    for register in 1..=read {
        laws.push(law(
            "nothing merges while the end waits",
            format!("!(f_ends[{}] & merge_goes_s{register})", register - 1),
        ));
    }
    for register in 1..read {
        laws.push(law(
            "an end waits as long as its registers say",
            format!("end_waits_s{register} == f_ends[{}]", register - 1),
        ));
    }
    let most = |queue: &Queue| queue.depth;
    for (count, queue) in [
        ("instructions_waiting", instructions),
        ("indices_under_way", indices),
        ("nodes_under_way", nodes),
    ] {
        laws.extend(room(module, count, most(queue)));
    }
    if module.verilog().contains("\n  reg  no_rows_before;") {
        laws.push(law(
            "what is said to be empty is",
            "!no_rows_before | f_rows_ahead == 0",
        ));
    }
    laws.extend([
        law(
            "the window's bytes are there from the first on",
            "!decoding | (window_there & (window_there + 1'b1)) == 0",
        ),
        law(
            "the window is empty when an update starts",
            "running | idle_before",
        ),
        law(
            "no row is there so soon after a start that it would be lost",
            "!(decoding & idle_before) | (!rows_valid & f_rows_ahead == 0)",
        ),
        law(
            "a decoded instruction is of one kind",
            "!decoded | (decoded_load + decoded_leaf + decoded_node + decoded_end <= 3'd1)",
        ),
        law(
            "the current instruction is of one kind",
            "!current_valid | (current_load + current_leaf + current_node + current_end <= 3'd1)",
        ),
        law(
            "a completed instruction is of one kind",
            format!("!completed | ({} <= 3'd1)", pushed.join(" + ")),
        ),
        law(
            "an instruction's credit is in the queue, or just decoded or completed",
            format!("instructions_waiting == 10'd0 + {held} + decoded + completed"),
        ),
        law(
            "no more instructions have credits than there is room",
            format!("instructions_waiting <= {}", most(instructions)),
        ),
        law(
            "nothing is pushed to a full instruction queue",
            format!("!completed | {held} < {}", most(instructions)),
        ),
        law(
            "a vertex index's credit is in the queue or just decoded",
            format!(
                "indices_under_way == {} + (decoded & decoded_load)",
                indices.count()
            ),
        ),
        law(
            "no more vertex indices have credits than there is room",
            format!("indices_under_way <= {}", most(indices)),
        ),
        law(
            "nothing is pushed to a full queue of vertex indices",
            format!(
                "!(decoded & decoded_load) | {} < {}",
                indices.count(),
                most(indices)
            ),
        ),
        law(
            "a node's credit is in the queue or in the merge",
            format!("nodes_under_way == {} + f_merging", nodes.count()),
        ),
        law(
            "no more nodes have credits than there is room",
            format!("nodes_under_way <= {}", most(nodes)),
        ),
        law(
            "nothing is pushed to a full node queue",
            format!("!{} | {} < {}", nodes.push, nodes.count(), most(nodes)),
        ),
        rows.law(),
        vertices.law(),
        law(
            "every load that waits has its vertex on the way",
            format!(
                "f_loads + load_waits + (completed & {pushed_load}) == {} + f_vertices_ahead",
                indices.count()
            ),
        ),
        law(
            "no more loads are in the queue than instructions",
            format!("f_loads <= {held}"),
        ),
        law(
            "the end is the last in its queue",
            format!("!f_end_in_queue | f_before_end + 11'd1 == {held}"),
        ),
        law(
            "nothing is decoded after an end",
            format!(
                "!(f_end_in_queue | end_waits | (completed & {pushed_end}) | (decoded & decoded_end)) | !(decoding | (decoded & !decoded_end))"
            ),
        ),
        law(
            "nothing is behind the end",
            format!("!end_waits | ({held} == 0 & !decoded & !completed)"),
        ),
        law(
            "nothing is completed behind the end",
            format!("!(f_end_in_queue | (completed & {pushed_end})) | !decoded & !(f_end_in_queue & completed)"),
        ),
        law(
            "an update that runs is being decoded, or its end is on its way",
            format!(
                "running == (decoding | (decoded & decoded_end) | (completed & {pushed_end}) | f_end_in_queue | end_waits)"
            ),
        ),
        law(
            "an update has one end",
            format!(
                "(decoded & decoded_end) + (completed & {pushed_end}) + f_end_in_queue + end_waits <= 2'd1"
            ),
        ),
        law(
            "an update runs while anything of it is left",
            format!("running | !(decoded | completed | {held} != 0 | current_valid | nodes_under_way != 0)"),
        ),
        law(
            "no update starts while rows are left",
            "!(any_rows_left | f_rows_ahead != 0) | !start",
        ),
        law(
            "a box is shown at an update's end only",
            "!box_shown | end_waits",
        ),
        law(
            "a box is shown when all else is complete",
            "!box_shown | all_complete",
        ),
        law(
            "the box that is shown was read since the end came",
            "!box_shown | &f_ends",
        ),
        law(
            "while it runs something moves, or memory is waited for",
            "!running | f_moves | f_memory",
        ),
    ]);
    Ok(Induction {
        module: module.name().into(),
        what: "no credit is lost or invented, no queue overflows, what is shown at a port stays, nothing locks up"
            .into(),
        texts: texts(module, &["_prefetch"]),
        observer,
        laws,
        happens: "done".into(),
        cut: vec![],
        depth: 1,
        arrays: false,
        plants: vec![
            plant(
                "a credit comes back twice",
                "if (decode ^ take_instruction)",
                "decode ^ take_instruction",
                "take_instruction",
            ),
            plant(
                "a node goes without room",
                "wire node_goes =",
                "& node_room",
                "",
            ),
            plant(
                "room for an instruction is never seen",
                "assign queue_room =",
                "instructions_waiting",
                "1'b0 & instructions_waiting",
            ),
            plant(
                "a load's vertex is not asked for",
                " vertex_indices (",
                ".push(",
                ".push(1'b0 & ",
            ),
        ],
    })
}
