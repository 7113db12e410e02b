// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_update_processor: the update processor: runs an update program, which rewrites the bounds of an
// object's nodes.

`default_nettype none

module dynrt_update_processor (
  input  wire         clk,
  input  wire         rst,

  // An update: rows of its program, bases of the object's vertices and nodes, index of its box
  input  wire         start_valid,
  input  wire [21:0]  start_program,
  input  wire [21:0]  start_rows,
  input  wire [21:0]  start_vertex_base,
  input  wire [21:0]  start_node_base,
  input  wire [21:0]  start_box_index,
  output wire         start_ready,

  // Program memory: requests
  input  wire         program_request_ready,
  output wire         program_request_valid,
  output wire [21:0]  program_request_address,
  output wire [2:0]   program_request_tag,

  // Program memory: answers, of any latency, in any order
  input  wire         program_response_valid,
  input  wire [2:0]   program_response_tag,
  input  wire [127:0] program_response_data,

  // Vertex memory: requests
  input  wire         vertex_request_ready,
  output wire         vertex_request_valid,
  output wire [21:0]  vertex_request_address,
  output wire [3:0]   vertex_request_tag,

  // Vertex memory: answers, of any latency, in any order
  input  wire         vertex_response_valid,
  input  wire [3:0]   vertex_response_tag,
  input  wire [71:0]  vertex_response_data,

  // Node memory: writes
  input  wire         node_write_ready,
  output wire         node_write_valid,
  output wire [21:0]  node_write_address,
  output wire [4:0]   node_write_mask,
  output wire [127:0] node_write_data,

  // The object's box: its write, after all of the nodes'
  input  wire         box_write_ready,
  output wire         box_write_valid,
  output wire [21:0]  box_write_address,
  output wire [143:0] box_write_data,

  // High for a clock when an update is complete
  output wire         done,

  // Counters since reset
  output wire [39:0]  count_instructions,
  output wire [39:0]  count_busy_cycles,
  output wire [39:0]  count_stalled_cycles,
  output wire [39:0]  count_vertex_wait_cycles,
  output wire [39:0]  count_node_wait_cycles
);

  // An update starts when the last one is over and none of its rows is left.
  reg  running;
  reg  decoding;
  reg  [21:0] rows_left;
  reg  any_rows_left;
  wire no_rows;
  wire idle = no_rows & ~(running | any_rows_left);
  wire start = start_valid & idle;

  // Fetch: rows of the program, ahead of their use.
  reg  [21:0] fetch_row;
  wire pop_row;

  wire rows_fetch_ready;
  wire rows_request_valid;
  wire [21:0] rows_request_address;
  wire [2:0] rows_request_tag;
  wire rows_valid;
  wire [127:0] rows_front;
  wire rows_empty;
  dynrt_program_prefetch rows (
    .clk(clk),
    .rst(rst),
    .fetch_valid(any_rows_left),
    .fetch_address(fetch_row),
    .request_ready(program_request_ready),
    .response_valid(program_response_valid),
    .response_tag(program_response_tag),
    .response_data(program_response_data),
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
  wire row_requested = any_rows_left & rows_fetch_ready;
  wire fetch_moves = start | row_requested;

  always @(posedge clk) begin
    if (fetch_moves) fetch_row <= start ? start_program : (fetch_row + 22'd1);
    if (fetch_moves) rows_left <= start ? start_rows : (rows_left - 22'd1);
  end

  wire last_row = rows_left == 22'd1;

  always @(posedge clk) begin
    if (rst) any_rows_left <= 1'b0; else if (fetch_moves) any_rows_left <= start ? (|start_rows) : ~last_row;
  end

  // The window: the program's next bytes, refilled by words, and which of them are there. The
  // others are 0.
  reg  [95:0] window;
  reg  [11:0] window_there;
  reg  [1:0] word_index;
  reg  idle_before;
  reg  [31:0] next_word;
  reg  next_word_there;

  always @(posedge clk) begin
    if (rst) idle_before <= 1'b1; else idle_before <= ~decoding;
  end

  wire refill = ~window_there[8] & next_word_there & decoding;
  wire take_word = rows_valid & decoding & (~next_word_there | refill);

  always @(posedge clk) begin
    if (take_word) next_word <=
        word_index[1] ? (word_index[0] ? rows_front[127:96] : rows_front[95:64]) :
        word_index[0] ? rows_front[63:32] :
        rows_front[31:0];
    next_word_there <= (take_word | (next_word_there & ~refill)) & ~idle_before;
  end

  assign pop_row = rows_valid & (~decoding | (take_word & (word_index == 2'd3)));

  always @(posedge clk) begin
    word_index <= (word_index + {1'b0, take_word}) & {2{~idle_before}};
  end

  wire [31:0] refill_word = next_word & {32{refill}};
  wire refill_at_0 = ~window_there[0];
  wire refill_at_1 = window_there[0] & ~window_there[1];
  wire refill_at_2 = window_there[1] & ~window_there[2];
  wire refill_at_3 = window_there[2] & ~window_there[3];
  wire refill_at_4 = window_there[3] & ~window_there[4];
  wire refill_at_5 = window_there[4] & ~window_there[5];
  wire refill_at_6 = window_there[5] & ~window_there[6];
  wire refill_at_7 = window_there[6] & ~window_there[7];
  wire refill_at_8 = window_there[7] & ~window_there[8];
  wire [7:0] filled_byte10_by_3 =
      window[87:80] |
      (refill_word[23:16] & {8{refill_at_8}}) |
      (refill_word[31:24] & {8{refill_at_7}});
  wire [7:0] filled_byte9_by_3 =
      window[79:72] |
      (refill_word[15:8] & {8{refill_at_8}}) |
      (refill_word[23:16] & {8{refill_at_7}}) |
      (refill_word[31:24] & {8{refill_at_6}});
  wire [7:0] filled_byte8_by_3 =
      window[71:64] |
      (refill_word[7:0] & {8{refill_at_8}}) |
      (refill_word[15:8] & {8{refill_at_7}}) |
      (refill_word[23:16] & {8{refill_at_6}}) |
      (refill_word[31:24] & {8{refill_at_5}});
  wire [7:0] filled_byte7_by_3 =
      window[63:56] |
      (refill_word[7:0] & {8{refill_at_7}}) |
      (refill_word[15:8] & {8{refill_at_6}}) |
      (refill_word[23:16] & {8{refill_at_5}}) |
      (refill_word[31:24] & {8{refill_at_4}});
  wire [7:0] filled_byte6_by_3 =
      window[55:48] |
      (refill_word[7:0] & {8{refill_at_6}}) |
      (refill_word[15:8] & {8{refill_at_5}}) |
      (refill_word[23:16] & {8{refill_at_4}}) |
      (refill_word[31:24] & {8{refill_at_3}});
  wire [7:0] filled_byte5_by_3 =
      window[47:40] |
      (refill_word[7:0] & {8{refill_at_5}}) |
      (refill_word[15:8] & {8{refill_at_4}}) |
      (refill_word[23:16] & {8{refill_at_3}}) |
      (refill_word[31:24] & {8{refill_at_2}});
  wire [7:0] filled_byte4_by_3 =
      window[39:32] |
      (refill_word[7:0] & {8{refill_at_4}}) |
      (refill_word[15:8] & {8{refill_at_3}}) |
      (refill_word[23:16] & {8{refill_at_2}}) |
      (refill_word[31:24] & {8{refill_at_1}});
  wire [7:0] filled_byte3_by_3 =
      window[31:24] |
      (refill_word[7:0] & {8{refill_at_3}}) |
      (refill_word[15:8] & {8{refill_at_2}}) |
      (refill_word[23:16] & {8{refill_at_1}}) |
      (refill_word[31:24] & {8{refill_at_0}});
  wire [7:0] filled_byte2_by_2 =
      window[23:16] |
      (refill_word[7:0] & {8{refill_at_2}}) |
      (refill_word[15:8] & {8{refill_at_1}}) |
      (refill_word[23:16] & {8{refill_at_0}});
  wire [7:0] filled_byte1_by_1 =
      window[15:8] |
      (refill_word[7:0] & {8{refill_at_1}}) |
      (refill_word[15:8] & {8{refill_at_0}});
  wire [95:0] filled = {
      window[95:88] | (refill_word[31:24] & {8{refill_at_8}}),
      filled_byte10_by_3,
      filled_byte9_by_3,
      filled_byte8_by_3,
      filled_byte7_by_3,
      filled_byte6_by_3,
      filled_byte5_by_3,
      filled_byte4_by_3,
      filled_byte3_by_3,
      filled_byte2_by_2,
      filled_byte1_by_1,
      window[7:0] | (refill_word[7:0] & {8{refill_at_0}})
    };
  wire [11:0] filled_there = window_there | ({window_there[7:0], 4'd15} & {12{refill}});

  // Decode: the first byte tells the kind and the length.
  wire long_code = window[3] & window[2];
  wire is_reload_or_end = long_code & window[1] & ~window[0];
  wire is_next = window[1] & window[0];
  wire is_leaf = long_code & ~window[1];
  wire is_node = ~long_code & ~is_next;
  wire is_reload = is_reload_or_end & window[5];
  wire is_end = is_reload_or_end & window[4];
  wire is_short = is_leaf & window[0];
  wire is_three = is_leaf & ~window[0];
  wire is_two = is_short | is_node | is_end;
  wire is_load = is_next | is_reload;
  wire complete =
      window_there[0] &
      (~is_reload | window_there[4]) &
      (~is_three | window_there[2]) &
      (~is_two | window_there[1]);
  wire queue_room;
  wire index_room;
  wire decode = decoding & complete & queue_room & index_room;
  wire [95:0] rest =
      is_reload ? {40'd0, filled[95:40]} :
      is_three ? {24'd0, filled[95:24]} :
      is_two ? {16'd0, filled[95:16]} :
      {8'd0, filled[95:8]};

  always @(posedge clk) begin
    window <= (decode ? rest : filled) & {96{~idle_before}};
  end

  wire [11:0] rest_there =
      is_reload ? {5'd0, filled_there[11:5]} :
      is_three ? {3'd0, filled_there[11:3]} :
      is_two ? {2'd0, filled_there[11:2]} :
      {1'b0, filled_there[11:1]};

  always @(posedge clk) begin
    window_there <= (decode ? rest_there : filled_there) & {12{~idle_before}};
    if (rst) decoding <= 1'b0; else decoding <= start | (decoding & ~(decode & is_end));
  end

  // The decoded instruction. Its implicit registers and its vertex's index follow from those before
  // it.
  reg  decoded;
  reg  [5:0] decoded_x;
  reg  [5:0] decoded_y;
  reg  [5:0] decoded_z;
  reg  [3:0] decoded_axes;
  reg  [21:0] decoded_index;
  reg  decoded_load;
  reg  decoded_reload;
  reg  decoded_leaf;
  reg  decoded_short;
  reg  decoded_node;
  reg  decoded_end;
  reg  [5:0] last;

  always @(posedge clk) begin
    if (rst) decoded <= 1'b0; else decoded <= decode;
    decoded_x <=
        is_next ? window[7:2] :
        (is_reload | is_end) ? window[13:8] :
        window[9:4];
    decoded_y <= window[15:10];
    decoded_z <= window[21:16];
    decoded_axes <= window[3:0];
    decoded_index <= window[35:14];
    decoded_load <= is_load;
    decoded_reload <= is_reload;
    decoded_leaf <= is_leaf;
    decoded_short <= is_short;
    decoded_node <= is_node;
    decoded_end <= is_end;
  end

  wire load_is_decoded = decoded & decoded_load;

  always @(posedge clk) begin
    if (load_is_decoded) last <= decoded_x;
  end

  wire [5:0] vertex_z = decoded_short ? last : decoded_z;
  wire [5:0] implied_z = {vertex_z[5:4], decoded_node ? decoded_axes : vertex_z[3:0]};
  reg  [6:0] free_count;
  reg  [5:0] fresh;
  wire any_free = |free_count;
  wire frees = decoded & decoded_node;
  wire takes = decoded & decoded_leaf;
  wire takes_free = takes & any_free;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [5:0] free_list [0:63];

  always @(posedge clk) begin
    if (start | frees | takes_free) free_count <=
        start ? 7'd0 :
        frees ? (free_count + 7'd1) :
        (free_count - 7'd1);
    if (start | (takes & ~any_free)) fresh <= start ? 6'd0 : (fresh + 6'd1);
  end

  wire [5:0] free_list_read = free_list[free_count[5:0] - 6'd1];
  wire [5:0] implied_target =
      decoded_node ? decoded_x :
      any_free ? free_list_read :
      fresh;
  reg  [21:0] vertex_base;
  reg  [21:0] next_vertex;

  always @(posedge clk) begin
    if (start) vertex_base <= start_vertex_base;
  end

  wire loads_next = load_is_decoded & ~decoded_reload;

  always @(posedge clk) begin
    if (start | loads_next) next_vertex <= start ? start_vertex_base : (next_vertex + 22'd1);
  end

  wire [21:0] vertex_indices_data = decoded_reload ? (vertex_base + decoded_index) : next_vertex;

  // Vertices are requested in the order of their loads, ahead of their use.
  wire take_index;
  wire pop_vertex;

  wire vertex_indices_valid;
  wire [21:0] vertex_indices_front;
  dynrt_fifo_22x4 vertex_indices (
    .clk(clk),
    .rst(rst),
    .push(load_is_decoded),
    .data(vertex_indices_data),
    .pop(take_index),
    .valid(vertex_indices_valid),
    .front(vertex_indices_front)
  );

  wire decode_load = decode & is_load;
  reg  [2:0] indices_under_way;
  wire [2:0] indices_under_way_next =
      decode_load ? (indices_under_way + 3'd1) :
      (indices_under_way - 3'd1);

  always @(posedge clk) begin
    if (rst) indices_under_way <= 3'd0; else if (decode_load ^ take_index) indices_under_way <= indices_under_way_next;
  end

  assign index_room = indices_under_way != 3'd4;

  wire vertices_fetch_ready;
  wire vertices_request_valid;
  wire [21:0] vertices_request_address;
  wire [3:0] vertices_request_tag;
  wire vertices_valid;
  wire [71:0] vertices_front;
  wire vertices_empty;
  dynrt_vertex_prefetch vertices (
    .clk(clk),
    .rst(rst),
    .fetch_valid(vertex_indices_valid),
    .fetch_address(vertex_indices_front),
    .request_ready(vertex_request_ready),
    .response_valid(vertex_response_valid),
    .response_tag(vertex_response_tag),
    .response_data(vertex_response_data),
    .pop(pop_vertex),
    .fetch_ready(vertices_fetch_ready),
    .request_valid(vertices_request_valid),
    .request_address(vertices_request_address),
    .request_tag(vertices_request_tag),
    .valid(vertices_valid),
    .front(vertices_front),
    .empty(vertices_empty)
  );

  assign take_index = vertex_indices_valid & vertices_fetch_ready;

  // Instructions wait for their vertices.
  wire take_instruction;
  wire [27:0] completed_instruction_next = {
      implied_target,
      implied_z,
      decoded_y,
      decoded_x,
      decoded_end,
      decoded_node,
      decoded_leaf,
      decoded_load
    };
  reg  completed;
  reg  [27:0] completed_instruction;

  always @(posedge clk) begin
    if (rst) completed <= 1'b0; else completed <= decoded;
    completed_instruction <= completed_instruction_next;
  end

  wire instruction_queue_valid;
  wire [27:0] instruction_queue_front;
  dynrt_fifo_28x64 instruction_queue (
    .clk(clk),
    .rst(rst),
    .push(completed),
    .data(completed_instruction),
    .pop(take_instruction),
    .valid(instruction_queue_valid),
    .front(instruction_queue_front)
  );

  reg  [6:0] instructions_waiting;
  wire [6:0] instructions_waiting_next =
      decode ? (instructions_waiting + 7'd1) :
      (instructions_waiting - 7'd1);

  always @(posedge clk) begin
    if (rst) instructions_waiting <= 7'd0; else if (decode ^ take_instruction) instructions_waiting <= instructions_waiting_next;
  end

  assign queue_room = instructions_waiting != 7'd64;

  // Execute: the current instruction goes unless what it needs is missing.
  reg  [27:0] current;
  reg  current_valid;
  wire current_load = current[0];
  wire load_waits = current_valid & current_load;
  wire current_leaf = current[1];
  wire leaf_waits = current_valid & current_leaf;
  wire current_node = current[2];
  wire node_waits = current_valid & current_node;
  wire current_end = current[3];
  wire end_waits = current_valid & current_end;
  wire node_room;
  wire box_taken;
  wire missing_vertex = load_waits & ~vertices_valid;
  wire missing_room = node_waits & ~node_room;
  wire unfinished = end_waits & ~box_taken;
  wire goes = current_valid & ~(missing_vertex | missing_room | unfinished);
  wire take = instruction_queue_valid & (goes | ~current_valid);
  assign take_instruction = take;

  always @(posedge clk) begin
    if (take) current <= instruction_queue_front;
    if (rst) current_valid <= 1'b0; else current_valid <= take | (current_valid & ~goes);
  end

  wire load_goes = load_waits & vertices_valid;
  wire node_goes = node_waits & node_room;
  assign pop_vertex = load_goes;

  // The registers. A load is written as it goes; the next instruction can read it.
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex_registers_copy0 [0:63];
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex_registers_copy1 [0:63];
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex_registers_copy2 [0:63];
  wire [5:0] current_x = current[9:4];
  reg  [71:0] vertex_registers_read0;
  wire [5:0] current_y = current[15:10];
  reg  [71:0] vertex_registers_read1;
  wire [5:0] current_z = current[21:16];
  reg  [71:0] vertex_registers_read2;
  (* no_rw_check, ram_style = "block" *)
  reg  [143:0] box_registers_copy0 [0:63];
  (* no_rw_check, ram_style = "block" *)
  reg  [143:0] box_registers_copy1 [0:63];
  reg  [143:0] box_registers_read0;
  wire [23:0] box_registers_read0_lo_x = box_registers_read0[23:0];
  wire [23:0] box_registers_read0_lo_y = box_registers_read0[47:24];
  wire [23:0] box_registers_read0_lo_z = box_registers_read0[71:48];
  wire [23:0] box_registers_read0_hi_x = box_registers_read0[95:72];
  wire [23:0] box_registers_read0_hi_y = box_registers_read0[119:96];
  wire [23:0] box_registers_read0_hi_z = box_registers_read0[143:120];
  reg  [143:0] box_registers_read1;
  wire [23:0] box_registers_read1_lo_x = box_registers_read1[23:0];
  wire [23:0] box_registers_read1_lo_y = box_registers_read1[47:24];
  wire [23:0] box_registers_read1_lo_z = box_registers_read1[71:48];
  wire [23:0] box_registers_read1_hi_x = box_registers_read1[95:72];
  wire [23:0] box_registers_read1_hi_y = box_registers_read1[119:96];
  wire [23:0] box_registers_read1_hi_z = box_registers_read1[143:120];

  // Merge: of two boxes, or of three vertices, of which each is a box too. A number that is no NaN
  // goes before one that is.
  wire merge_goes = leaf_waits | node_goes;
  wire of_leaf = current_leaf;
  wire [5:0] current_target = current[27:22];
  wire [5:0] merge_target = current_target;
  wire [23:0] vertex_registers_read0_x = vertex_registers_read0[23:0];
  wire [23:0] vertex_registers_read1_x = vertex_registers_read1[23:0];
  wire [23:0] third_x = vertex_registers_read2[23:0];
  reg  of_leaf_s1;
  wire [23:0] first_lo_x = of_leaf_s1 ? vertex_registers_read0_x : box_registers_read0_lo_x;
  reg  [23:0] first_lo_x_s2;
  wire [23:0] second_lo_x = of_leaf_s1 ? vertex_registers_read1_x : box_registers_read1_lo_x;
  reg  [23:0] second_lo_x_s2;
  reg  [23:0] third_x_s2;
  wire nan_first_lo_x = (&first_lo_x_s2[22:16]) & (|first_lo_x_s2[15:0]);
  wire nan_second_lo_x = (&second_lo_x_s2[22:16]) & (|second_lo_x_s2[15:0]);
  wire nan_third_x = (&third_x_s2[22:16]) & (|third_x_s2[15:0]);
  wire second_beats_lo_x_by_magnitude =
      {second_lo_x_s2[22:0], 1'b0} <
      {first_lo_x_s2[22:0], first_lo_x_s2[23]};
  wire second_beats_lo_x_unless_zero =
      (second_lo_x_s2[23] ^ first_lo_x_s2[23]) ? second_lo_x_s2[23] :
      (second_beats_lo_x_by_magnitude ^ second_lo_x_s2[23]);
  wire second_beats_lo_x =
      second_beats_lo_x_unless_zero &
      ~((~|second_lo_x_s2[22:16]) & (~|first_lo_x_s2[22:16])) &
      ~nan_second_lo_x;
  wire take_second_lo_x = second_beats_lo_x | (nan_first_lo_x & ~nan_second_lo_x);
  wire [23:0] best_lo_x = take_second_lo_x ? second_lo_x_s2 : first_lo_x_s2;
  reg  [23:0] best_lo_x_s3;
  wire nan_both_lo_x = nan_first_lo_x & nan_second_lo_x;
  reg  nan_both_lo_x_s3;
  reg  third_beats_lo_x_ordered_s3;
  reg  [23:0] third_x_magnitude_twice_s3;
  reg  third_x_sign_s3;
  wire third_beats_lo_x_by_sign =
      (third_x_magnitude_twice_s3 < {best_lo_x_s3[22:0], best_lo_x_s3[23]}) ^
      third_x_sign_s3;
  wire third_beats_lo_x_unless_zero =
      (third_x_sign_s3 ^ best_lo_x_s3[23]) ? third_x_sign_s3 :
      third_beats_lo_x_by_sign;
  reg  third_x_is_zero_s3;
  wire third_beats_lo_x =
      third_beats_lo_x_unless_zero &
      ~(third_x_is_zero_s3 & (~|best_lo_x_s3[22:16])) &
      third_beats_lo_x_ordered_s3;
  reg  of_leaf_s2, of_leaf_s3;
  wire take_third_lo_x =
      of_leaf_s3 &
      (third_beats_lo_x | (nan_both_lo_x_s3 & third_beats_lo_x_ordered_s3));
  reg  nan_third_x_s3;
  reg  [23:0] third_x_s3;
  wire [23:0] merged_lo_x =
      (nan_both_lo_x_s3 & nan_third_x_s3) ? 24'h7f0000 :
      take_third_lo_x ? third_x_s3 :
      best_lo_x_s3;
  reg  [23:0] merged_lo_x_s4;
  wire [23:0] vertex_registers_read0_y = vertex_registers_read0[47:24];
  wire [23:0] vertex_registers_read1_y = vertex_registers_read1[47:24];
  wire [23:0] third_y = vertex_registers_read2[47:24];
  wire [23:0] first_lo_y = of_leaf_s1 ? vertex_registers_read0_y : box_registers_read0_lo_y;
  reg  [23:0] first_lo_y_s2;
  wire [23:0] second_lo_y = of_leaf_s1 ? vertex_registers_read1_y : box_registers_read1_lo_y;
  reg  [23:0] second_lo_y_s2;
  reg  [23:0] third_y_s2;
  wire nan_first_lo_y = (&first_lo_y_s2[22:16]) & (|first_lo_y_s2[15:0]);
  wire nan_second_lo_y = (&second_lo_y_s2[22:16]) & (|second_lo_y_s2[15:0]);
  wire nan_third_y = (&third_y_s2[22:16]) & (|third_y_s2[15:0]);
  wire second_beats_lo_y_by_magnitude =
      {second_lo_y_s2[22:0], 1'b0} <
      {first_lo_y_s2[22:0], first_lo_y_s2[23]};
  wire second_beats_lo_y_unless_zero =
      (second_lo_y_s2[23] ^ first_lo_y_s2[23]) ? second_lo_y_s2[23] :
      (second_beats_lo_y_by_magnitude ^ second_lo_y_s2[23]);
  wire second_beats_lo_y =
      second_beats_lo_y_unless_zero &
      ~((~|second_lo_y_s2[22:16]) & (~|first_lo_y_s2[22:16])) &
      ~nan_second_lo_y;
  wire take_second_lo_y = second_beats_lo_y | (nan_first_lo_y & ~nan_second_lo_y);
  wire [23:0] best_lo_y = take_second_lo_y ? second_lo_y_s2 : first_lo_y_s2;
  reg  [23:0] best_lo_y_s3;
  wire nan_both_lo_y = nan_first_lo_y & nan_second_lo_y;
  reg  nan_both_lo_y_s3;
  reg  third_beats_lo_y_ordered_s3;
  reg  [23:0] third_y_magnitude_twice_s3;
  reg  third_y_sign_s3;
  wire third_beats_lo_y_by_sign =
      (third_y_magnitude_twice_s3 < {best_lo_y_s3[22:0], best_lo_y_s3[23]}) ^
      third_y_sign_s3;
  wire third_beats_lo_y_unless_zero =
      (third_y_sign_s3 ^ best_lo_y_s3[23]) ? third_y_sign_s3 :
      third_beats_lo_y_by_sign;
  reg  third_y_is_zero_s3;
  wire third_beats_lo_y =
      third_beats_lo_y_unless_zero &
      ~(third_y_is_zero_s3 & (~|best_lo_y_s3[22:16])) &
      third_beats_lo_y_ordered_s3;
  wire take_third_lo_y =
      of_leaf_s3 &
      (third_beats_lo_y | (nan_both_lo_y_s3 & third_beats_lo_y_ordered_s3));
  reg  nan_third_y_s3;
  reg  [23:0] third_y_s3;
  wire [23:0] merged_lo_y =
      (nan_both_lo_y_s3 & nan_third_y_s3) ? 24'h7f0000 :
      take_third_lo_y ? third_y_s3 :
      best_lo_y_s3;
  reg  [23:0] merged_lo_y_s4;
  wire [23:0] vertex_registers_read0_z = vertex_registers_read0[71:48];
  wire [23:0] vertex_registers_read1_z = vertex_registers_read1[71:48];
  wire [23:0] third_z = vertex_registers_read2[71:48];
  wire [23:0] first_lo_z = of_leaf_s1 ? vertex_registers_read0_z : box_registers_read0_lo_z;
  reg  [23:0] first_lo_z_s2;
  wire [23:0] second_lo_z = of_leaf_s1 ? vertex_registers_read1_z : box_registers_read1_lo_z;
  reg  [23:0] second_lo_z_s2;
  reg  [23:0] third_z_s2;
  wire nan_first_lo_z = (&first_lo_z_s2[22:16]) & (|first_lo_z_s2[15:0]);
  wire nan_second_lo_z = (&second_lo_z_s2[22:16]) & (|second_lo_z_s2[15:0]);
  wire nan_third_z = (&third_z_s2[22:16]) & (|third_z_s2[15:0]);
  wire second_beats_lo_z_by_magnitude =
      {second_lo_z_s2[22:0], 1'b0} <
      {first_lo_z_s2[22:0], first_lo_z_s2[23]};
  wire second_beats_lo_z_unless_zero =
      (second_lo_z_s2[23] ^ first_lo_z_s2[23]) ? second_lo_z_s2[23] :
      (second_beats_lo_z_by_magnitude ^ second_lo_z_s2[23]);
  wire second_beats_lo_z =
      second_beats_lo_z_unless_zero &
      ~((~|second_lo_z_s2[22:16]) & (~|first_lo_z_s2[22:16])) &
      ~nan_second_lo_z;
  wire take_second_lo_z = second_beats_lo_z | (nan_first_lo_z & ~nan_second_lo_z);
  wire [23:0] best_lo_z = take_second_lo_z ? second_lo_z_s2 : first_lo_z_s2;
  reg  [23:0] best_lo_z_s3;
  wire nan_both_lo_z = nan_first_lo_z & nan_second_lo_z;
  reg  nan_both_lo_z_s3;
  reg  third_beats_lo_z_ordered_s3;
  reg  [23:0] third_z_magnitude_twice_s3;
  reg  third_z_sign_s3;
  wire third_beats_lo_z_by_sign =
      (third_z_magnitude_twice_s3 < {best_lo_z_s3[22:0], best_lo_z_s3[23]}) ^
      third_z_sign_s3;
  wire third_beats_lo_z_unless_zero =
      (third_z_sign_s3 ^ best_lo_z_s3[23]) ? third_z_sign_s3 :
      third_beats_lo_z_by_sign;
  reg  third_z_is_zero_s3;
  wire third_beats_lo_z =
      third_beats_lo_z_unless_zero &
      ~(third_z_is_zero_s3 & (~|best_lo_z_s3[22:16])) &
      third_beats_lo_z_ordered_s3;
  wire take_third_lo_z =
      of_leaf_s3 &
      (third_beats_lo_z | (nan_both_lo_z_s3 & third_beats_lo_z_ordered_s3));
  reg  nan_third_z_s3;
  reg  [23:0] third_z_s3;
  wire [23:0] merged_lo_z =
      (nan_both_lo_z_s3 & nan_third_z_s3) ? 24'h7f0000 :
      take_third_lo_z ? third_z_s3 :
      best_lo_z_s3;
  reg  [23:0] merged_lo_z_s4;
  wire [23:0] first_hi_x = of_leaf_s1 ? vertex_registers_read0_x : box_registers_read0_hi_x;
  reg  [23:0] first_hi_x_s2;
  wire [23:0] second_hi_x = of_leaf_s1 ? vertex_registers_read1_x : box_registers_read1_hi_x;
  reg  [23:0] second_hi_x_s2;
  wire nan_first_hi_x = (&first_hi_x_s2[22:16]) & (|first_hi_x_s2[15:0]);
  wire nan_second_hi_x = (&second_hi_x_s2[22:16]) & (|second_hi_x_s2[15:0]);
  wire second_beats_hi_x_by_magnitude =
      {first_hi_x_s2[22:0], 1'b0} <
      {second_hi_x_s2[22:0], second_hi_x_s2[23]};
  wire second_beats_hi_x_unless_zero =
      (first_hi_x_s2[23] ^ second_hi_x_s2[23]) ? first_hi_x_s2[23] :
      (second_beats_hi_x_by_magnitude ^ first_hi_x_s2[23]);
  wire second_beats_hi_x =
      second_beats_hi_x_unless_zero &
      ~((~|first_hi_x_s2[22:16]) & (~|second_hi_x_s2[22:16])) &
      ~nan_second_hi_x;
  wire take_second_hi_x = second_beats_hi_x | (nan_first_hi_x & ~nan_second_hi_x);
  wire [23:0] best_hi_x = take_second_hi_x ? second_hi_x_s2 : first_hi_x_s2;
  reg  [23:0] best_hi_x_s3;
  wire nan_both_hi_x = nan_first_hi_x & nan_second_hi_x;
  reg  nan_both_hi_x_s3;
  reg  [23:0] third_x_magnitude_and_sign_s3;
  wire third_beats_hi_x_unless_zero =
      (best_hi_x_s3[23] ^ third_x_sign_s3) ? best_hi_x_s3[23] :
      (({best_hi_x_s3[22:0], 1'b0} < third_x_magnitude_and_sign_s3) ^ best_hi_x_s3[23]);
  wire third_beats_hi_x =
      third_beats_hi_x_unless_zero &
      ~((~|best_hi_x_s3[22:16]) & third_x_is_zero_s3) &
      third_beats_lo_x_ordered_s3;
  wire take_third_hi_x =
      of_leaf_s3 &
      (third_beats_hi_x | (nan_both_hi_x_s3 & third_beats_lo_x_ordered_s3));
  wire [23:0] merged_hi_x =
      (nan_both_hi_x_s3 & nan_third_x_s3) ? 24'hff0000 :
      take_third_hi_x ? third_x_s3 :
      best_hi_x_s3;
  reg  [23:0] merged_hi_x_s4;
  wire [23:0] first_hi_y = of_leaf_s1 ? vertex_registers_read0_y : box_registers_read0_hi_y;
  reg  [23:0] first_hi_y_s2;
  wire [23:0] second_hi_y = of_leaf_s1 ? vertex_registers_read1_y : box_registers_read1_hi_y;
  reg  [23:0] second_hi_y_s2;
  wire nan_first_hi_y = (&first_hi_y_s2[22:16]) & (|first_hi_y_s2[15:0]);
  wire nan_second_hi_y = (&second_hi_y_s2[22:16]) & (|second_hi_y_s2[15:0]);
  wire second_beats_hi_y_by_magnitude =
      {first_hi_y_s2[22:0], 1'b0} <
      {second_hi_y_s2[22:0], second_hi_y_s2[23]};
  wire second_beats_hi_y_unless_zero =
      (first_hi_y_s2[23] ^ second_hi_y_s2[23]) ? first_hi_y_s2[23] :
      (second_beats_hi_y_by_magnitude ^ first_hi_y_s2[23]);
  wire second_beats_hi_y =
      second_beats_hi_y_unless_zero &
      ~((~|first_hi_y_s2[22:16]) & (~|second_hi_y_s2[22:16])) &
      ~nan_second_hi_y;
  wire take_second_hi_y = second_beats_hi_y | (nan_first_hi_y & ~nan_second_hi_y);
  wire [23:0] best_hi_y = take_second_hi_y ? second_hi_y_s2 : first_hi_y_s2;
  reg  [23:0] best_hi_y_s3;
  wire nan_both_hi_y = nan_first_hi_y & nan_second_hi_y;
  reg  nan_both_hi_y_s3;
  reg  [23:0] third_y_magnitude_and_sign_s3;
  wire third_beats_hi_y_unless_zero =
      (best_hi_y_s3[23] ^ third_y_sign_s3) ? best_hi_y_s3[23] :
      (({best_hi_y_s3[22:0], 1'b0} < third_y_magnitude_and_sign_s3) ^ best_hi_y_s3[23]);
  wire third_beats_hi_y =
      third_beats_hi_y_unless_zero &
      ~((~|best_hi_y_s3[22:16]) & third_y_is_zero_s3) &
      third_beats_lo_y_ordered_s3;
  wire take_third_hi_y =
      of_leaf_s3 &
      (third_beats_hi_y | (nan_both_hi_y_s3 & third_beats_lo_y_ordered_s3));
  wire [23:0] merged_hi_y =
      (nan_both_hi_y_s3 & nan_third_y_s3) ? 24'hff0000 :
      take_third_hi_y ? third_y_s3 :
      best_hi_y_s3;
  reg  [23:0] merged_hi_y_s4;
  wire [23:0] first_hi_z = of_leaf_s1 ? vertex_registers_read0_z : box_registers_read0_hi_z;
  reg  [23:0] first_hi_z_s2;
  wire [23:0] second_hi_z = of_leaf_s1 ? vertex_registers_read1_z : box_registers_read1_hi_z;
  reg  [23:0] second_hi_z_s2;
  wire nan_first_hi_z = (&first_hi_z_s2[22:16]) & (|first_hi_z_s2[15:0]);
  wire nan_second_hi_z = (&second_hi_z_s2[22:16]) & (|second_hi_z_s2[15:0]);
  wire second_beats_hi_z_by_magnitude =
      {first_hi_z_s2[22:0], 1'b0} <
      {second_hi_z_s2[22:0], second_hi_z_s2[23]};
  wire second_beats_hi_z_unless_zero =
      (first_hi_z_s2[23] ^ second_hi_z_s2[23]) ? first_hi_z_s2[23] :
      (second_beats_hi_z_by_magnitude ^ first_hi_z_s2[23]);
  wire second_beats_hi_z =
      second_beats_hi_z_unless_zero &
      ~((~|first_hi_z_s2[22:16]) & (~|second_hi_z_s2[22:16])) &
      ~nan_second_hi_z;
  wire take_second_hi_z = second_beats_hi_z | (nan_first_hi_z & ~nan_second_hi_z);
  wire [23:0] best_hi_z = take_second_hi_z ? second_hi_z_s2 : first_hi_z_s2;
  reg  [23:0] best_hi_z_s3;
  wire nan_both_hi_z = nan_first_hi_z & nan_second_hi_z;
  reg  nan_both_hi_z_s3;
  reg  [23:0] third_z_magnitude_and_sign_s3;
  wire third_beats_hi_z_unless_zero =
      (best_hi_z_s3[23] ^ third_z_sign_s3) ? best_hi_z_s3[23] :
      (({best_hi_z_s3[22:0], 1'b0} < third_z_magnitude_and_sign_s3) ^ best_hi_z_s3[23]);
  wire third_beats_hi_z =
      third_beats_hi_z_unless_zero &
      ~((~|best_hi_z_s3[22:16]) & third_z_is_zero_s3) &
      third_beats_lo_z_ordered_s3;
  wire take_third_hi_z =
      of_leaf_s3 &
      (third_beats_hi_z | (nan_both_hi_z_s3 & third_beats_lo_z_ordered_s3));
  wire [23:0] merged_hi_z =
      (nan_both_hi_z_s3 & nan_third_z_s3) ? 24'hff0000 :
      take_third_hi_z ? third_z_s3 :
      best_hi_z_s3;
  reg  [23:0] merged_hi_z_s4;
  wire [143:0] box_registers_write_data = {
      merged_hi_z_s4,
      merged_hi_y_s4,
      merged_hi_x_s4,
      merged_lo_z_s4,
      merged_lo_y_s4,
      merged_lo_x_s4
    };
  reg  merge_goes_s1, merge_goes_s2, merge_goes_s3, merge_goes_s4;
  reg  [23:0] merge_target_delay;
  wire [5:0] merge_target_s4 = merge_target_delay[23:18];

  // A node's intervals, each on its axis, wait until they are written.
  wire [3:0] merge_axes = current_z[3:0];
  reg  [3:0] merge_axes_s1, merge_axes_s2;
  wire merge_axes_left_is_1_s2 = merge_axes_s2[1:0] == 2'd1;
  wire merge_axes_left_is_0_s2 = merge_axes_s2[1:0] == 2'd0;
  wire [23:0] left_lo =
      merge_axes_left_is_0_s2 ? first_lo_x_s2 :
      merge_axes_left_is_1_s2 ? first_lo_y_s2 :
      first_lo_z_s2;
  reg  [23:0] left_lo_s3;
  wire [23:0] left_hi =
      merge_axes_left_is_0_s2 ? first_hi_x_s2 :
      merge_axes_left_is_1_s2 ? first_hi_y_s2 :
      first_hi_z_s2;
  reg  [23:0] left_hi_s3;
  wire merge_axes_right_is_1_s2 = merge_axes_s2[3:2] == 2'd1;
  wire merge_axes_right_is_0_s2 = merge_axes_s2[3:2] == 2'd0;
  wire [23:0] right_lo =
      merge_axes_right_is_0_s2 ? second_lo_x_s2 :
      merge_axes_right_is_1_s2 ? second_lo_y_s2 :
      second_lo_z_s2;
  reg  [23:0] right_lo_s3;
  wire [23:0] right_hi =
      merge_axes_right_is_0_s2 ? second_hi_x_s2 :
      merge_axes_right_is_1_s2 ? second_hi_y_s2 :
      second_hi_z_s2;
  reg  [23:0] right_hi_s3;
  wire [95:0] node_queue_data = {right_hi_s3, right_lo_s3, left_hi_s3, left_lo_s3};
  wire node_pop;
  reg  node_goes_s1, node_goes_s2, node_goes_s3;

  wire node_queue_valid;
  wire [95:0] node_queue_front;
  dynrt_fifo_96x8 node_queue (
    .clk(clk),
    .rst(rst),
    .push(node_goes_s3),
    .data(node_queue_data),
    .pop(node_pop),
    .valid(node_queue_valid),
    .front(node_queue_front)
  );

  assign node_pop = node_queue_valid & node_write_ready;
  reg  [3:0] nodes_under_way;

  always @(posedge clk) begin
    if (rst) nodes_under_way <= 4'd0; else if (node_goes ^ node_pop) nodes_under_way <= node_goes ? (nodes_under_way + 4'd1) : (nodes_under_way - 4'd1);
  end

  assign node_room = nodes_under_way != 4'd8;
  reg  [21:0] next_node;

  always @(posedge clk) begin
    if (start | node_pop) next_node <= start ? start_node_base : (next_node + 22'd1);
  end

  // The end: when all merges are in their registers and all nodes written, the box, read like a
  // node's.
  reg  merge_goes_s5;
  wire work_under_way =
      merge_goes_s2 |
      merge_goes_s3 |
      merge_goes_s4 |
      merge_goes_s5 |
      (|nodes_under_way);
  wire all_complete = ~work_under_way;
  reg  box_shown;
  assign box_taken = box_shown & box_write_ready;
  reg  end_waits_s1;
  wire box_was_read = end_waits & end_waits_s1;
  reg  [21:0] box_index;

  always @(posedge clk) begin
    if (rst) box_shown <= 1'b0; else box_shown <= box_was_read & all_complete & ~box_taken;
    if (start) box_index <= start_box_index;
  end

  assign box_write_data = {
      first_hi_z_s2,
      first_hi_y_s2,
      first_hi_x_s2,
      first_lo_z_s2,
      first_lo_y_s2,
      first_lo_x_s2
    };
  reg  over;

  always @(posedge clk) begin
    if (rst) running <= 1'b0; else running <= start | (running & ~box_taken);
    if (rst) over <= 1'b0; else over <= box_taken;
  end

  // Counters since reset.
  reg  [39:0] instructions_counter;
  reg  [39:0] busy_cycles_counter;
  reg  [39:0] stalled_cycles_counter;
  reg  [39:0] vertex_wait_cycles_counter;
  reg  [39:0] node_wait_cycles_counter;

  always @(posedge clk) begin
    if (rst) instructions_counter <= 40'd0; else if (goes) instructions_counter <= instructions_counter + 40'd1;
    if (rst) busy_cycles_counter <= 40'd0; else if (running) busy_cycles_counter <= busy_cycles_counter + 40'd1;
    if (rst) stalled_cycles_counter <= 40'd0; else if (running & ~goes) stalled_cycles_counter <= stalled_cycles_counter + 40'd1;
    if (rst) vertex_wait_cycles_counter <= 40'd0; else if (missing_vertex) vertex_wait_cycles_counter <= vertex_wait_cycles_counter + 40'd1;
    if (rst) node_wait_cycles_counter <= 40'd0; else if (missing_room) node_wait_cycles_counter <= node_wait_cycles_counter + 40'd1;
  end

  // Memories.
  always @(posedge clk) begin
    if (frees) free_list[free_count[5:0]] <= decoded_y;
  end

  always @(posedge clk) begin
    if (load_goes) vertex_registers_copy0[current_x] <= vertices_front;
    vertex_registers_read0 <= vertex_registers_copy0[current_x];
  end

  always @(posedge clk) begin
    if (load_goes) vertex_registers_copy1[current_x] <= vertices_front;
    vertex_registers_read1 <= vertex_registers_copy1[current_y];
  end

  always @(posedge clk) begin
    if (load_goes) vertex_registers_copy2[current_x] <= vertices_front;
    vertex_registers_read2 <= vertex_registers_copy2[current_z];
  end

  always @(posedge clk) begin
    if (merge_goes_s4) box_registers_copy0[merge_target_s4] <= box_registers_write_data;
    box_registers_read0 <= box_registers_copy0[current_x];
  end

  always @(posedge clk) begin
    if (merge_goes_s4) box_registers_copy1[merge_target_s4] <= box_registers_write_data;
    box_registers_read1 <= box_registers_copy1[current_y];
  end

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    of_leaf_s1 <= of_leaf;
    merge_goes_s1 <= merge_goes;
    merge_axes_s1 <= merge_axes;
    if (rst) node_goes_s1 <= 1'b0; else node_goes_s1 <= node_goes;
    if (rst) end_waits_s1 <= 1'b0; else end_waits_s1 <= end_waits;

    // Stage 2
    first_lo_x_s2 <= first_lo_x;
    second_lo_x_s2 <= second_lo_x;
    third_x_s2 <= third_x;
    of_leaf_s2 <= of_leaf_s1;
    first_lo_y_s2 <= first_lo_y;
    second_lo_y_s2 <= second_lo_y;
    third_y_s2 <= third_y;
    first_lo_z_s2 <= first_lo_z;
    second_lo_z_s2 <= second_lo_z;
    third_z_s2 <= third_z;
    first_hi_x_s2 <= first_hi_x;
    second_hi_x_s2 <= second_hi_x;
    first_hi_y_s2 <= first_hi_y;
    second_hi_y_s2 <= second_hi_y;
    first_hi_z_s2 <= first_hi_z;
    second_hi_z_s2 <= second_hi_z;
    merge_goes_s2 <= merge_goes_s1;
    merge_axes_s2 <= merge_axes_s1;
    if (rst) node_goes_s2 <= 1'b0; else node_goes_s2 <= node_goes_s1;

    // Stage 3
    best_lo_x_s3 <= best_lo_x;
    nan_both_lo_x_s3 <= nan_both_lo_x;
    third_beats_lo_x_ordered_s3 <= ~nan_third_x;
    third_x_magnitude_twice_s3 <= {third_x_s2[22:0], 1'b0};
    third_x_sign_s3 <= third_x_s2[23];
    third_x_is_zero_s3 <= ~|third_x_s2[22:16];
    of_leaf_s3 <= of_leaf_s2;
    nan_third_x_s3 <= nan_third_x;
    third_x_s3 <= third_x_s2;
    best_lo_y_s3 <= best_lo_y;
    nan_both_lo_y_s3 <= nan_both_lo_y;
    third_beats_lo_y_ordered_s3 <= ~nan_third_y;
    third_y_magnitude_twice_s3 <= {third_y_s2[22:0], 1'b0};
    third_y_sign_s3 <= third_y_s2[23];
    third_y_is_zero_s3 <= ~|third_y_s2[22:16];
    nan_third_y_s3 <= nan_third_y;
    third_y_s3 <= third_y_s2;
    best_lo_z_s3 <= best_lo_z;
    nan_both_lo_z_s3 <= nan_both_lo_z;
    third_beats_lo_z_ordered_s3 <= ~nan_third_z;
    third_z_magnitude_twice_s3 <= {third_z_s2[22:0], 1'b0};
    third_z_sign_s3 <= third_z_s2[23];
    third_z_is_zero_s3 <= ~|third_z_s2[22:16];
    nan_third_z_s3 <= nan_third_z;
    third_z_s3 <= third_z_s2;
    best_hi_x_s3 <= best_hi_x;
    nan_both_hi_x_s3 <= nan_both_hi_x;
    third_x_magnitude_and_sign_s3 <= {third_x_s2[22:0], third_x_s2[23]};
    best_hi_y_s3 <= best_hi_y;
    nan_both_hi_y_s3 <= nan_both_hi_y;
    third_y_magnitude_and_sign_s3 <= {third_y_s2[22:0], third_y_s2[23]};
    best_hi_z_s3 <= best_hi_z;
    nan_both_hi_z_s3 <= nan_both_hi_z;
    third_z_magnitude_and_sign_s3 <= {third_z_s2[22:0], third_z_s2[23]};
    merge_goes_s3 <= merge_goes_s2;
    left_lo_s3 <= left_lo;
    left_hi_s3 <= left_hi;
    right_lo_s3 <= right_lo;
    right_hi_s3 <= right_hi;
    if (rst) node_goes_s3 <= 1'b0; else node_goes_s3 <= node_goes_s2;

    // Stage 4
    merged_lo_x_s4 <= merged_lo_x;
    merged_lo_y_s4 <= merged_lo_y;
    merged_lo_z_s4 <= merged_lo_z;
    merged_hi_x_s4 <= merged_hi_x;
    merged_hi_y_s4 <= merged_hi_y;
    merged_hi_z_s4 <= merged_hi_z;
    merge_goes_s4 <= merge_goes_s3;

    // Stage 5
    merge_goes_s5 <= merge_goes_s4;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    merge_target_delay <= {merge_target_delay[17:0], merge_target};
  end

  assign start_ready = idle;
  assign program_request_valid = rows_request_valid;
  assign program_request_address = rows_request_address;
  assign program_request_tag = rows_request_tag;
  assign vertex_request_valid = vertices_request_valid;
  assign vertex_request_address = vertices_request_address;
  assign vertex_request_tag = vertices_request_tag;
  assign node_write_valid = node_queue_valid;
  assign node_write_address = next_node;
  assign node_write_mask = 5'd15;
  assign node_write_data = {32'd0, node_queue_front};
  assign box_write_valid = box_shown;
  assign box_write_address = box_index;
  assign done = over;
  assign count_instructions = instructions_counter;
  assign count_busy_cycles = busy_cycles_counter;
  assign count_stalled_cycles = stalled_cycles_counter;
  assign count_vertex_wait_cycles = vertex_wait_cycles_counter;
  assign count_node_wait_cycles = node_wait_cycles_counter;

  // What nothing reads.
  wire unused = &{1'b0, vertices_empty};

endmodule

`default_nettype wire
