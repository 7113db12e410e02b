// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_skinning_processor: the skinning processor: moves vertices at rest by the weighted matrices of a
// palette.

`default_nettype none

module dynrt_skinning_processor (
  input  wire         clk,
  input  wire         rst,

  // A mesh to skin: indices of its palette, influence rows, vertices at rest and vertices to write, and how many
  input  wire         start_valid,
  input  wire [21:0]  start_palette,
  input  wire [8:0]   start_joints,
  input  wire [21:0]  start_influences,
  input  wire [21:0]  start_rows,
  input  wire [21:0]  start_rest,
  input  wire [21:0]  start_vertices,
  input  wire [21:0]  start_target,
  output wire         start_ready,

  // Whether the geometry unit is free for it
  input  wire         may_start,

  // Vertex memory: requests
  input  wire         vertex_request_ready,
  output wire         vertex_request_valid,
  output wire [21:0]  vertex_request_address,
  output wire [3:0]   vertex_request_tag,

  // Vertex memory: answers, of any latency, in any order
  input  wire         vertex_response_valid,
  input  wire [3:0]   vertex_response_tag,
  input  wire [71:0]  vertex_response_data,

  // Influence memory: requests
  input  wire         influence_request_ready,
  output wire         influence_request_valid,
  output wire [21:0]  influence_request_address,
  output wire [2:0]   influence_request_tag,

  // Influence memory: answers, of any latency, in any order
  input  wire         influence_response_valid,
  input  wire [2:0]   influence_response_tag,
  input  wire [127:0] influence_response_data,

  // Vertex memory: writes
  input  wire         write_ready,
  output wire         write_valid,
  output wire [21:0]  write_address,
  output reg  [71:0]  write_data,

  // From the geometry unit: a moved vertex times a weight, and which of its vertex's it is
  input  wire         weighted_valid,
  input  wire [1:0]   weighted_position,
  input  wire         weighted_last,
  input  wire [23:0]  weighted_x,
  input  wire [23:0]  weighted_y,
  input  wire [23:0]  weighted_z,

  // From the geometry unit: sums of two weighted ones, and of two sums
  input  wire [23:0]  pair_sum_x,
  input  wire [23:0]  pair_sum_y,
  input  wire [23:0]  pair_sum_z,
  input  wire [23:0]  vertex_sum_x,
  input  wire [23:0]  vertex_sum_y,
  input  wire [23:0]  vertex_sum_z,

  // High while a mesh is being skinned, from the clock after its start
  output wire         skinning,

  // To the geometry unit: a column of a joint's matrix
  output wire         palette_valid,
  output wire [7:0]   palette_joint,
  output wire [1:0]   palette_column,
  output wire [71:0]  palette_data,

  // To the geometry unit: an influence, and which of its vertex's it is
  output wire         issue_valid,
  output wire [7:0]   issue_joint,
  output wire [23:0]  issue_x,
  output wire [23:0]  issue_y,
  output wire [23:0]  issue_z,
  output wire [23:0]  issue_weight,
  output wire [1:0]   issue_position,
  output wire         issue_last,

  // To the geometry unit: operands of the sums of two weighted ones
  output reg  [23:0]  pair_a_x,
  output reg  [23:0]  pair_b_x,
  output reg  [23:0]  pair_a_y,
  output reg  [23:0]  pair_b_y,
  output reg  [23:0]  pair_a_z,
  output reg  [23:0]  pair_b_z,

  // To the geometry unit: operands of the sums of two sums
  output reg  [23:0]  vertex_a_x,
  output reg  [23:0]  vertex_b_x,
  output reg  [23:0]  vertex_a_y,
  output reg  [23:0]  vertex_b_y,
  output reg  [23:0]  vertex_a_z,
  output reg  [23:0]  vertex_b_z,

  // High for a clock when a mesh is complete
  output wire         done,

  // Counters' events
  output wire         influence_issued
);

  // A mesh starts when the last one is written and none of its rows is left.
  reg  skinning_now;
  reg  [21:0] rows_left;
  wire no_rows;
  wire rows_wanted = |rows_left;
  wire idle = no_rows & ~(skinning_now | rows_wanted);
  wire starts_if_asked = idle & may_start;
  wire start = start_valid & starts_if_asked;

  // Vectors ahead of their use: the palette's, then the vertices at rest.
  wire [10:0] columns = {start_joints, 2'd0};
  reg  [10:0] columns_to_request;
  reg  [21:0] column_address;
  reg  [21:0] rest_to_request;
  reg  [21:0] rest_address;
  wire requests_column = |columns_to_request;
  wire vector_wanted = requests_column | (|rest_to_request);
  wire pop_vector;
  wire [21:0] vectors_fetch_address = requests_column ? column_address : rest_address;

  wire vectors_fetch_ready;
  wire vectors_request_valid;
  wire [21:0] vectors_request_address;
  wire [3:0] vectors_request_tag;
  wire vectors_valid;
  wire [71:0] vectors_front;
  wire vectors_empty;
  dynrt_vector_prefetch vectors (
    .clk(clk),
    .rst(rst),
    .fetch_valid(vector_wanted),
    .fetch_address(vectors_fetch_address),
    .request_ready(vertex_request_ready),
    .response_valid(vertex_response_valid),
    .response_tag(vertex_response_tag),
    .response_data(vertex_response_data),
    .pop(pop_vector),
    .fetch_ready(vectors_fetch_ready),
    .request_valid(vectors_request_valid),
    .request_address(vectors_request_address),
    .request_tag(vectors_request_tag),
    .valid(vectors_valid),
    .front(vectors_front),
    .empty(vectors_empty)
  );

  wire vector_requested = vector_wanted & vectors_fetch_ready;
  wire column_requested = vector_requested & requests_column;
  wire rest_requested = vector_requested & ~requests_column;
  wire columns_to_request_enable = start | column_requested;

  always @(posedge clk) begin
    if (rst) columns_to_request <= 11'd0; else if (columns_to_request_enable) columns_to_request <= start ? columns : (columns_to_request - 11'd1);
    if (columns_to_request_enable) column_address <= start ? start_palette : (column_address + 22'd1);
  end

  wire rest_to_request_enable = start | rest_requested;

  always @(posedge clk) begin
    if (rst) rest_to_request <= 22'd0; else if (rest_to_request_enable) rest_to_request <= start ? start_vertices : (rest_to_request - 22'd1);
    if (rest_to_request_enable) rest_address <= start ? start_rest : (rest_address + 22'd1);
  end

  // Rows of influences ahead of their use.
  reg  [21:0] row_address;
  wire pop_row;

  wire rows_fetch_ready;
  wire rows_request_valid;
  wire [21:0] rows_request_address;
  wire [2:0] rows_request_tag;
  wire rows_valid;
  wire [127:0] rows_front;
  wire rows_empty;
  dynrt_row_prefetch rows (
    .clk(clk),
    .rst(rst),
    .fetch_valid(rows_wanted),
    .fetch_address(row_address),
    .request_ready(influence_request_ready),
    .response_valid(influence_response_valid),
    .response_tag(influence_response_tag),
    .response_data(influence_response_data),
    .pop(pop_row),
    .fetch_ready(rows_fetch_ready),
    .request_valid(rows_request_valid),
    .request_address(rows_request_address),
    .request_tag(rows_request_tag),
    .valid(rows_valid),
    .front(rows_front),
    .empty(rows_empty)
  );

  assign no_rows = rows_empty;
  wire row_requested = rows_wanted & rows_fetch_ready;
  wire rows_left_enable = start | row_requested;

  always @(posedge clk) begin
    if (rst) rows_left <= 22'd0; else if (rows_left_enable) rows_left <= start ? start_rows : (rows_left - 22'd1);
    if (rows_left_enable) row_address <= start ? start_influences : (row_address + 22'd1);
  end

  // The palette's vectors go into its memories as they come.
  reg  [10:0] columns_to_come;
  reg  [9:0] column_place;
  wire loading = |columns_to_come;
  wire column_comes = vectors_valid & loading;
  wire columns_to_come_enable = start | column_comes;

  always @(posedge clk) begin
    if (rst) columns_to_come <= 11'd0; else if (columns_to_come_enable) columns_to_come <= start ? columns : (columns_to_come - 11'd1);
    if (columns_to_come_enable) column_place <= start ? 10'd0 : (column_place + 10'd1);
  end

  // Issue: an influence goes with its vertex unless either is missing, or room for a vertex that it
  // completes.
  reg  [1:0] slot;
  wire [31:0] influence =
      slot[1] ? (slot[0] ? rows_front[127:96] : rows_front[95:64]) :
      slot[0] ? rows_front[63:32] :
      rows_front[31:0];
  wire [22:0] influence_weight = influence[22:0];
  wire [7:0] influence_joint = influence[30:23];
  wire influence_last = influence[31];
  wire room;
  wire vertex_missing = ~vectors_valid | loading;
  wire row_missing = ~rows_valid;
  wire room_missing = influence_last & ~room;
  wire issue = skinning_now & ~(vertex_missing | row_missing | room_missing);
  wire completes = issue & influence_last;
  wire last_slot = &slot;
  wire slot_enable = start | issue;

  always @(posedge clk) begin
    if (slot_enable) slot <= start ? 2'd0 : (slot + 2'd1);
  end

  // What is left of the last row when the mesh is complete is of no use.
  assign pop_row = rows_valid & (~skinning_now | (issue & last_slot));
  assign pop_vector = column_comes | completes;
  reg  [1:0] position;
  reg  issued;

  always @(posedge clk) begin
    if (slot_enable) position <= (start | influence_last) ? 2'd0 : (position + 2'd1);
    if (rst) issued <= 1'b0; else issued <= issue;
  end

  wire [23:0] vectors_front_x = vectors_front[23:0];
  wire [23:0] vectors_front_y = vectors_front[47:24];
  wire [23:0] vectors_front_z = vectors_front[71:48];
  reg  [7:0] issued_joint;
  reg  [23:0] issued_x;
  reg  [23:0] issued_y;
  reg  [23:0] issued_z;
  reg  [23:0] issued_weight;
  reg  [1:0] issued_position;
  reg  issued_last;

  always @(posedge clk) begin
    issued_joint <= influence_joint;
    issued_x <= vectors_front_x;
    issued_y <= vectors_front_y;
    issued_z <= vectors_front_z;
    issued_weight <= {1'b0, influence_weight};
    issued_position <= position;
    issued_last <= influence_last;
  end

  // Accumulation: the first and the second, the third and the fourth, then both; an absent one is
  // 0.
  wire first_of_pair = weighted_valid & ~weighted_position[0];
  wire pair_ends = weighted_valid & (weighted_position[0] | weighted_last);
  reg  [6:0] pair_ends_delay;
  wire pair_ends_s1 = pair_ends_delay[0];
  wire upper_pair = weighted_position[1];
  reg  [6:0] upper_pair_delay;
  wire completes_vertex = weighted_last;
  reg  completes_vertex_s1;
  reg  [23:0] first_x;

  always @(posedge clk) begin
    if (first_of_pair) first_x <= weighted_x;
  end

  wire [23:0] other_x = first_x & {24{weighted_position[0]}};
  reg  [23:0] first_y;

  always @(posedge clk) begin
    if (first_of_pair) first_y <= weighted_y;
  end

  wire [23:0] other_y = first_y & {24{weighted_position[0]}};
  reg  [23:0] first_z;

  always @(posedge clk) begin
    if (first_of_pair) first_z <= weighted_z;
  end

  wire [23:0] other_z = first_z & {24{weighted_position[0]}};
  wire pair_done = pair_ends_delay[6];
  wire upper_done = upper_pair_delay[6];
  reg  [23:0] lower_x;
  wire lower_done = pair_done & ~upper_done;

  always @(posedge clk) begin
    if (lower_done) lower_x <= pair_sum_x;
  end

  wire [23:0] lower_sum_x = lower_x & {24{upper_done}};
  reg  [23:0] lower_y;

  always @(posedge clk) begin
    if (lower_done) lower_y <= pair_sum_y;
  end

  wire [23:0] lower_sum_y = lower_y & {24{upper_done}};
  reg  [23:0] lower_z;

  always @(posedge clk) begin
    if (lower_done) lower_z <= pair_sum_z;
  end

  wire [23:0] lower_sum_z = lower_z & {24{upper_done}};
  wire vertex_ready = pair_ends_s1 & completes_vertex_s1;
  reg  [12:0] vertex_ready_delay;
  wire vertex_done = vertex_ready_delay[12];

  // The write queue, in block RAM: always read where the front is next, a word shows two clocks
  // after it came.
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] write_queue [0:127];
  reg  [6:0] queue_head;
  reg  [6:0] queue_tail;
  wire [71:0] write_queue_write_data = {vertex_sum_z, vertex_sum_y, vertex_sum_x};
  wire written;
  reg  queue_grows;
  reg  [7:0] queue_count;

  always @(posedge clk) begin
    if (rst) queue_tail <= 7'd0; else if (vertex_done) queue_tail <= (queue_tail == 7'd127) ? 7'd0 : (queue_tail + 7'd1);
    if (rst) queue_grows <= 1'b0; else queue_grows <= vertex_done;
    if (rst) queue_count <= 8'd0; else if (queue_grows ^ written) queue_count <= queue_grows ? (queue_count + 8'd1) : (queue_count - 8'd1);
  end

  assign write_valid = |queue_count;
  wire [6:0] next_head = written ? ((queue_head == 7'd127) ? 7'd0 : (queue_head + 7'd1)) : queue_head;

  always @(posedge clk) begin
    if (rst) queue_head <= 7'd0; else queue_head <= next_head;
  end

  assign written = write_valid & write_ready;
  reg  [7:0] vertices_under_way;
  wire [7:0] vertices_under_way_next =
      completes ? (vertices_under_way + 8'd1) :
      (vertices_under_way - 8'd1);

  always @(posedge clk) begin
    if (rst) vertices_under_way <= 8'd0; else if (completes ^ written) vertices_under_way <= vertices_under_way_next;
  end

  assign room = vertices_under_way != 8'd128;
  reg  [21:0] next_written;
  wire next_written_enable = start | written;

  always @(posedge clk) begin
    if (next_written_enable) next_written <= start ? start_target : (next_written + 22'd1);
  end

  // The end: the last vertex is written.
  reg  [21:0] vertices_left;

  always @(posedge clk) begin
    if (rst) vertices_left <= 22'd0; else if (next_written_enable) vertices_left <= start ? start_vertices : (vertices_left - 22'd1);
  end

  wire over = skinning_now & ~(loading | (|vertices_left));
  reg  mesh_done;

  always @(posedge clk) begin
    if (rst) skinning_now <= 1'b0; else skinning_now <= start | (skinning_now & ~over);
    if (rst) mesh_done <= 1'b0; else mesh_done <= over;
  end

  // Memories.
  always @(posedge clk) begin
    if (vertex_done) write_queue[queue_tail] <= write_queue_write_data;
    write_data <= write_queue[next_head];
  end

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    completes_vertex_s1 <= completes_vertex;
    pair_a_x <= weighted_x;
    pair_b_x <= other_x;
    pair_a_y <= weighted_y;
    pair_b_y <= other_y;
    pair_a_z <= weighted_z;
    pair_b_z <= other_z;

    // Stage 8
    vertex_a_x <= pair_sum_x;
    vertex_b_x <= lower_sum_x;
    vertex_a_y <= pair_sum_y;
    vertex_b_y <= lower_sum_y;
    vertex_a_z <= pair_sum_z;
    vertex_b_z <= lower_sum_z;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    if (rst) pair_ends_delay <= 7'd0; else pair_ends_delay <= {pair_ends_delay[5:0], pair_ends};
    upper_pair_delay <= {upper_pair_delay[5:0], upper_pair};
    if (rst) vertex_ready_delay <= 13'd0; else vertex_ready_delay <= {vertex_ready_delay[11:0], vertex_ready};
  end

  assign start_ready = starts_if_asked;
  assign vertex_request_valid = vectors_request_valid;
  assign vertex_request_address = vectors_request_address;
  assign vertex_request_tag = vectors_request_tag;
  assign influence_request_valid = rows_request_valid;
  assign influence_request_address = rows_request_address;
  assign influence_request_tag = rows_request_tag;
  assign write_address = next_written;
  assign skinning = skinning_now;
  assign palette_valid = column_comes;
  assign palette_joint = column_place[9:2];
  assign palette_column = column_place[1:0];
  assign palette_data = vectors_front;
  assign issue_valid = issued;
  assign issue_joint = issued_joint;
  assign issue_x = issued_x;
  assign issue_y = issued_y;
  assign issue_z = issued_z;
  assign issue_weight = issued_weight;
  assign issue_position = issued_position;
  assign issue_last = issued_last;
  assign done = mesh_done;
  assign influence_issued = issue;

  // What nothing reads.
  wire unused = &{1'b0, vectors_empty};

endmodule

`default_nettype wire
