// SPDX-License-Identifier: MIT OR Apache-2.0
// geometry_unit: the geometry unit: a leaf's triangle and vertices are fetched, the packet's rays
// tested one a clock, the hits merged.

`default_nettype none

module geometry_unit (
  input  wire         clk,
  input  wire         rst,

  // A ray that has been set up
  input  wire         setup_valid,
  input  wire [5:0]   setup_packet,
  input  wire [1:0]   setup_ray,
  input  wire [23:0]  setup_origin_x,
  input  wire [23:0]  setup_origin_y,
  input  wire [23:0]  setup_origin_z,
  input  wire [23:0]  setup_reciprocal_x,
  input  wire [23:0]  setup_reciprocal_y,
  input  wire [23:0]  setup_reciprocal_z,
  input  wire [2:0]   setup_signs,
  input  wire [1:0]   setup_kz,
  input  wire [23:0]  setup_shear_x,
  input  wire [23:0]  setup_shear_y,
  input  wire [23:0]  setup_tmin,
  input  wire [23:0]  setup_tmax,
  input  wire         setup_any_hit,
  input  wire [23:0]  setup_shear_z,

  // Leaves from the traversal unit
  input  wire         leaf_valid,
  input  wire [5:0]   leaf_packet,
  input  wire [21:0]  leaf_address,
  input  wire [9:0]   leaf_context,
  input  wire [3:0]   leaf_mask,
  output wire         leaf_ready,

  // Triangle record memory: requests
  input  wire         record_request_ready,
  output wire         record_request_valid,
  output wire [21:0]  record_request_address,
  output wire [5:0]   record_request_tag,

  // Triangle record memory: answers, in any order, always taken
  input  wire         record_response_valid,
  input  wire [5:0]   record_response_tag,
  input  wire [127:0] record_response_data,

  // Vertex memory: requests
  input  wire         vertex_request_ready,
  output wire         vertex_request_valid,
  output wire [21:0]  vertex_request_address,
  output wire [7:0]   vertex_request_tag,

  // Vertex memory: answers, in any order, always taken
  input  wire         vertex_response_valid,
  input  wire [7:0]   vertex_response_tag,
  input  wire [71:0]  vertex_response_data,

  // After reset, packet numbers in turn, to clear what counts by packet
  input  wire         sweep,
  input  wire [5:0]   sweep_packet,

  // Closest hits are read by packet and ray; the word is there a clock later
  input  wire [5:0]   read_packet,
  input  wire [1:0]   read_ray,

  // A closer hit of a ray: what its near must not exceed from now on
  output wire         limit_valid,
  output wire [5:0]   limit_packet,
  output wire [1:0]   limit_ray,
  output wire [23:0]  limit_value,

  // A leaf all of whose tests are merged
  output wire         done_valid,
  output wire [5:0]   done_packet,
  output wire [9:0]   done_context,

  // The closest hit that was asked for, a clock or two later
  output wire [23:0]  read_t,
  output wire [23:0]  read_u,
  output wire [23:0]  read_v,
  output wire [31:0]  read_triangle,

  // Counters' events
  output wire         test_issued,

  // The ray-triangle test just merged, for whoever watches
  output wire         watch_test_valid,
  output wire [5:0]   watch_test_packet,
  output wire [1:0]   watch_test_ray,
  output reg  [21:0]  watch_test_record,
  output reg          watch_test_hit,
  output reg          watch_test_replaces,
  output reg  [23:0]  watch_test_t,
  output reg  [23:0]  watch_test_u,
  output reg  [23:0]  watch_test_v
);

  // A leaf is taken when its record can be requested.
  wire take_leaf = leaf_valid & record_request_ready;
  wire [35:0] leaf_data = {leaf_address, leaf_mask, leaf_context};
  (* no_rw_check, ram_style = "distributed" *)
  reg  [35:0] leaf_memory_copy0 [0:47];
  (* no_rw_check, ram_style = "distributed" *)
  reg  [35:0] leaf_memory_copy1 [0:47];

  // A record's answer: its number is kept, its three vertices are requested one a clock.
  (* no_rw_check, ram_style = "distributed" *)
  reg  [31:0] number_memory [0:47];
  wire job_done;
  wire [71:0] vertex_queue_data = {
      record_response_data[85:64],
      record_response_data[53:32],
      record_response_data[21:0],
      record_response_tag
    };

  wire vertex_queue_valid;
  wire [71:0] vertex_queue_front;
  fifo_72x48 vertex_queue (
    .clk(clk),
    .rst(rst),
    .push(record_response_valid),
    .data(vertex_queue_data),
    .pop(job_done),
    .valid(vertex_queue_valid),
    .front(vertex_queue_front)
  );

  reg  [1:0] corner;
  wire vertex_fire = vertex_queue_valid & vertex_request_ready;
  wire last_corner = corner == 2'd2;

  always @(posedge clk) begin
    if (rst) corner <= 2'd0; else if (vertex_fire) corner <= last_corner ? 2'd0 : (corner + 2'd1);
  end

  assign job_done = vertex_fire & last_corner;

  // Vertices arrive in any order; the third makes the triangle complete.
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex0_memory [0:47];
  wire vertex0_memory_write_enable = vertex_response_valid & (vertex_response_tag[1:0] == 2'd0);
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex1_memory [0:47];
  wire vertex1_memory_write_enable = vertex_response_valid & (vertex_response_tag[1:0] == 2'd1);
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex2_memory [0:47];
  wire vertex2_memory_write_enable = vertex_response_valid & (vertex_response_tag[1:0] == 2'd2);
  (* no_rw_check, ram_style = "distributed" *)
  reg  [1:0] arrival_memory [0:47];
  wire [1:0] arrival_memory_read = arrival_memory[vertex_response_tag[7:2]];
  wire arrival_memory_read_is_2 = arrival_memory_read == 2'd2;
  wire triangle_complete = vertex_response_valid & arrival_memory_read_is_2;
  wire [5:0] arrival_memory_write_address = sweep ? sweep_packet : vertex_response_tag[7:2];
  wire [1:0] arrival_memory_write_data =
      sweep ? 2'd0 :
      arrival_memory_read_is_2 ? 2'd0 :
      (arrival_memory_read + 2'd1);

  // The rays of a complete triangle's mask go into the test, one a clock.
  wire take_ready;

  wire ready_queue_valid;
  wire [5:0] ready_queue_front;
  fifo_6x48 ready_queue (
    .clk(clk),
    .rst(rst),
    .push(triangle_complete),
    .data(vertex_response_tag[7:2]),
    .pop(take_ready),
    .valid(ready_queue_valid),
    .front(ready_queue_front)
  );

  wire [35:0] leaf_memory_read0 = leaf_memory_copy0[ready_queue_front];
  reg  busy;
  reg  [5:0] now_packet;
  reg  [3:0] now_mask;
  reg  now_first;
  wire [1:0] issue_ray =
      now_mask[0] ? 2'd0 :
      now_mask[1] ? 2'd1 :
      now_mask[2] ? 2'd2 :
      2'd3;
  wire [3:0] rest_mask = now_mask & (now_mask - 4'd1);
  wire now_last = ~|rest_mask;
  wire takes_next = ~busy | now_last;
  assign take_ready = takes_next & ready_queue_valid;

  always @(posedge clk) begin
    if (rst) busy <= 1'b0; else busy <= takes_next ? ready_queue_valid : 1'b1;
    if (take_ready) now_packet <= ready_queue_front;
    now_mask <= take_ready ? leaf_memory_read0[13:10] : rest_mask;
    now_first <= take_ready;
  end

  // The test.
  wire [7:0] ray_memory_write_address = {setup_packet, setup_ray};
  (* no_rw_check, ram_style = "block" *)
  reg  [196:0] ray_memory [0:191];
  wire [196:0] ray_memory_write_data = {
      setup_shear_y,
      setup_shear_x,
      setup_kz,
      setup_signs,
      setup_reciprocal_z,
      setup_reciprocal_y,
      setup_reciprocal_x,
      setup_origin_z,
      setup_origin_y,
      setup_origin_x
    };
  (* no_rw_check, ram_style = "block" *)
  reg  [72:0] ray_limit_memory_copy0 [0:191];
  (* no_rw_check, ram_style = "block" *)
  reg  [72:0] ray_limit_memory_copy1 [0:191];
  wire [72:0] ray_limit_memory_write_data = {setup_shear_z, setup_any_hit, setup_tmax, setup_tmin};
  wire [7:0] test_index = {now_packet, issue_ray};
  reg  [196:0] ray_memory_read;
  reg  [196:0] ray_memory_read_s2;
  reg  [71:0] vertex0_memory_read;
  reg  [71:0] vertex0_memory_read_s2;
  reg  [71:0] vertex1_memory_read;
  reg  [71:0] vertex1_memory_read_s2;
  reg  [71:0] vertex2_memory_read;
  reg  [71:0] vertex2_memory_read_s2;
  reg  [423:0] test_index_delay;
  wire [7:0] test_index_s47 = test_index_delay[375:368];
  wire [7:0] test_index_s52 = test_index_delay[415:408];
  reg  [72:0] ray_limit_memory_read0;
  reg  [72:0] ray_limit_memory_read0_s54;
  reg  [72:0] ray_limit_memory_read1;
  reg  [72:0] ray_limit_memory_read1_s49;

  wire test_hit;
  wire [23:0] test_t;
  wire [23:0] test_u;
  wire [23:0] test_v;
  triangle_test test (
    .clk(clk),
    .v0_x(vertex0_memory_read_s2[23:0]),
    .v0_y(vertex0_memory_read_s2[47:24]),
    .v0_z(vertex0_memory_read_s2[71:48]),
    .v1_x(vertex1_memory_read_s2[23:0]),
    .v1_y(vertex1_memory_read_s2[47:24]),
    .v1_z(vertex1_memory_read_s2[71:48]),
    .v2_x(vertex2_memory_read_s2[23:0]),
    .v2_y(vertex2_memory_read_s2[47:24]),
    .v2_z(vertex2_memory_read_s2[71:48]),
    .origin_x(ray_memory_read_s2[23:0]),
    .origin_y(ray_memory_read_s2[47:24]),
    .origin_z(ray_memory_read_s2[71:48]),
    .kz(ray_memory_read_s2[148:147]),
    .shear_x(ray_memory_read_s2[172:149]),
    .shear_y(ray_memory_read_s2[196:173]),
    .shear_z(ray_limit_memory_read1_s49[72:49]),
    .reciprocal_x(ray_memory_read_s2[95:72]),
    .reciprocal_y(ray_memory_read_s2[119:96]),
    .reciprocal_z(ray_memory_read_s2[143:120]),
    .signs(ray_memory_read_s2[146:144]),
    .tmin(ray_limit_memory_read0_s54[23:0]),
    .tmax(ray_limit_memory_read0_s54[47:24]),
    .hit(test_hit),
    .t(test_t),
    .u(test_u),
    .v(test_v)
  );

  // The merge: a hit replaces the ray's closest one if it is closer, or as close and of a lower
  // triangle.
  (* no_rw_check, ram_style = "block" *)
  reg  [103:0] closest_memory_copy0 [0:191];
  (* no_rw_check, ram_style = "block" *)
  reg  [103:0] closest_memory_copy1 [0:191];
  wire [7:0] test_index_s53 = test_index_delay[423:416];
  reg  [103:0] closest_memory_read0;
  reg  [103:0] closest_memory_read0_s55;
  reg  [335:0] now_packet_delay;
  wire [5:0] now_packet_s54 = now_packet_delay[323:318];
  wire [35:0] leaf_memory_read1 = leaf_memory_copy1[now_packet_s54];
  reg  [35:0] leaf_memory_read1_s55;
  wire [31:0] number_memory_read = number_memory[now_packet_s54];
  reg  [31:0] number_memory_read_s55;
  reg  [111:0] issue_ray_delay;
  wire [1:0] issue_ray_s55 = issue_ray_delay[109:108];
  wire was_touched =
      (issue_ray_s55 == 2'd0) ? leaf_memory_read1_s55[6] :
      (issue_ray_s55 == 2'd1) ? leaf_memory_read1_s55[7] :
      (issue_ray_s55 == 2'd2) ? leaf_memory_read1_s55[8] :
      leaf_memory_read1_s55[9];
  wire term = (~|test_t[22:16]) & (~|closest_memory_read0_s55[22:16]);
  wire term_2 =
      ({test_t[22:0], 1'b0} < {closest_memory_read0_s55[22:0], closest_memory_read0_s55[23]}) ^
      test_t[23];
  wire term_3 = ((test_t[23] ^ closest_memory_read0_s55[23]) ? test_t[23] : term_2) & ~term;
  wire all_test_t_22_16_and_any_test_t_15_0 = (&test_t[22:16]) & (|test_t[15:0]);
  wire term_4 = (&closest_memory_read0_s55[22:16]) & (|closest_memory_read0_s55[15:0]);
  wire closer = term_3 & ~(all_test_t_22_16_and_any_test_t_15_0 | term_4);
  wire as_close =
      ((test_t == closest_memory_read0_s55[23:0]) | term) &
      ~all_test_t_22_16_and_any_test_t_15_0 &
      ~term_4;
  wire lower = number_memory_read_s55 < closest_memory_read0_s55[103:72];
  reg  ray_limit_memory_read0_48_s55;
  wire replaces =
      test_hit &
      (ray_limit_memory_read0_48_s55 | ~was_touched | closer | (as_close & lower));
  reg  ray_limit_memory_read0_48_s56;
  reg  [23:0] ray_limit_memory_read0_23_0_s55, ray_limit_memory_read0_23_0_s56;
  reg  [31:0] number_memory_read_s56;
  wire [103:0] merged = {
      ray_limit_memory_read0_48_s56 ? 32'hffffffff : number_memory_read_s56,
      ray_limit_memory_read0_48_s56 ? 24'd0 : watch_test_v,
      ray_limit_memory_read0_48_s56 ? 24'd0 : watch_test_u,
      ray_limit_memory_read0_48_s56 ? ray_limit_memory_read0_23_0_s56 : watch_test_t
    };
  reg  [55:0] busy_delay;
  assign watch_test_valid = busy_delay[55];
  wire merge_writes = watch_test_valid & watch_test_replaces;
  wire [5:0] merge_packet = now_packet_delay[335:330];
  wire [1:0] merge_ray = issue_ray_delay[111:110];
  wire [7:0] closest_memory_write_address = {merge_packet, merge_ray};

  // Which rays have hit something, gathered over the triangle's rays.
  reg  [3:0] gathered;
  reg  [55:0] now_first_delay;
  wire now_first_s56 = now_first_delay[55];
  reg  [3:0] leaf_memory_read1_9_6_s56;
  wire [3:0] joined = {
      merge_writes & (merge_ray == 2'd3),
      merge_writes & (merge_ray == 2'd2),
      merge_writes & (merge_ray == 2'd1),
      merge_writes & (merge_ray == 2'd0)
    };
  wire [3:0] now_touched = (now_first_s56 ? leaf_memory_read1_9_6_s56 : gathered) | joined;

  always @(posedge clk) begin
    if (watch_test_valid) gathered <= now_touched;
  end

  reg  [55:0] now_last_delay;
  wire now_last_s56 = now_last_delay[55];
  reg  [5:0] leaf_memory_read1_5_0_s56;
  reg  [103:0] closest_memory_read1;

  // Memories.
  always @(posedge clk) begin
    if (take_leaf) leaf_memory_copy0[leaf_packet] <= leaf_data;
  end

  always @(posedge clk) begin
    if (take_leaf) leaf_memory_copy1[leaf_packet] <= leaf_data;
  end

  always @(posedge clk) begin
    if (record_response_valid) number_memory[record_response_tag] <= record_response_data[127:96];
  end

  always @(posedge clk) begin
    if (vertex0_memory_write_enable) vertex0_memory[vertex_response_tag[7:2]] <= vertex_response_data;
    vertex0_memory_read <= vertex0_memory[now_packet];
  end

  always @(posedge clk) begin
    if (vertex1_memory_write_enable) vertex1_memory[vertex_response_tag[7:2]] <= vertex_response_data;
    vertex1_memory_read <= vertex1_memory[now_packet];
  end

  always @(posedge clk) begin
    if (vertex2_memory_write_enable) vertex2_memory[vertex_response_tag[7:2]] <= vertex_response_data;
    vertex2_memory_read <= vertex2_memory[now_packet];
  end

  always @(posedge clk) begin
    if (sweep | vertex_response_valid) arrival_memory[arrival_memory_write_address] <= arrival_memory_write_data;
  end

  always @(posedge clk) begin
    if (setup_valid) ray_memory[ray_memory_write_address] <= ray_memory_write_data;
    ray_memory_read <= ray_memory[test_index];
  end

  always @(posedge clk) begin
    if (setup_valid) ray_limit_memory_copy0[ray_memory_write_address] <= ray_limit_memory_write_data;
    ray_limit_memory_read0 <= ray_limit_memory_copy0[test_index_s52];
  end

  always @(posedge clk) begin
    if (setup_valid) ray_limit_memory_copy1[ray_memory_write_address] <= ray_limit_memory_write_data;
    ray_limit_memory_read1 <= ray_limit_memory_copy1[test_index_s47];
  end

  always @(posedge clk) begin
    if (merge_writes) closest_memory_copy0[closest_memory_write_address] <= merged;
    closest_memory_read0 <= closest_memory_copy0[test_index_s53];
  end

  always @(posedge clk) begin
    if (merge_writes) closest_memory_copy1[closest_memory_write_address] <= merged;
    closest_memory_read1 <= closest_memory_copy1[{read_packet, read_ray}];
  end

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 2
    ray_memory_read_s2 <= ray_memory_read;
    vertex0_memory_read_s2 <= vertex0_memory_read;
    vertex1_memory_read_s2 <= vertex1_memory_read;
    vertex2_memory_read_s2 <= vertex2_memory_read;

    // Stage 49
    ray_limit_memory_read1_s49 <= ray_limit_memory_read1;

    // Stage 54
    ray_limit_memory_read0_s54 <= ray_limit_memory_read0;

    // Stage 55
    closest_memory_read0_s55 <= closest_memory_read0;
    leaf_memory_read1_s55 <= leaf_memory_read1;
    number_memory_read_s55 <= number_memory_read;
    ray_limit_memory_read0_48_s55 <= ray_limit_memory_read0_s54[48];
    ray_limit_memory_read0_23_0_s55 <= ray_limit_memory_read0_s54[23:0];

    // Stage 56
    watch_test_replaces <= replaces;
    ray_limit_memory_read0_48_s56 <= ray_limit_memory_read0_48_s55;
    ray_limit_memory_read0_23_0_s56 <= ray_limit_memory_read0_23_0_s55;
    watch_test_t <= test_t;
    watch_test_u <= test_u;
    watch_test_v <= test_v;
    number_memory_read_s56 <= number_memory_read_s55;
    leaf_memory_read1_9_6_s56 <= leaf_memory_read1_s55[9:6];
    leaf_memory_read1_5_0_s56 <= leaf_memory_read1_s55[5:0];
    watch_test_record <= leaf_memory_read1_s55[35:14];
    watch_test_hit <= test_hit;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    test_index_delay <= {test_index_delay[415:0], test_index};
    now_packet_delay <= {now_packet_delay[329:0], now_packet};
    issue_ray_delay <= {issue_ray_delay[109:0], issue_ray};
    if (rst) busy_delay <= 56'd0; else busy_delay <= {busy_delay[54:0], busy};
    now_first_delay <= {now_first_delay[54:0], now_first};
    now_last_delay <= {now_last_delay[54:0], now_last};
  end

  assign leaf_ready = record_request_ready;
  assign record_request_valid = leaf_valid;
  assign record_request_address = leaf_address;
  assign record_request_tag = leaf_packet;
  assign vertex_request_valid = vertex_queue_valid;
  assign vertex_request_address =
      (corner == 2'd0) ? vertex_queue_front[27:6] :
      (corner == 2'd1) ? vertex_queue_front[49:28] :
      vertex_queue_front[71:50];
  assign vertex_request_tag = {vertex_queue_front[5:0], corner};
  assign limit_valid = merge_writes;
  assign limit_packet = merge_packet;
  assign limit_ray = merge_ray;
  assign limit_value = ray_limit_memory_read0_48_s56 ? 24'hff0000 : watch_test_t;
  assign done_valid = watch_test_valid & now_last_s56;
  assign done_packet = merge_packet;
  assign done_context = {now_touched, leaf_memory_read1_5_0_s56};
  assign read_t = closest_memory_read1[23:0];
  assign read_u = closest_memory_read1[47:24];
  assign read_v = closest_memory_read1[71:48];
  assign read_triangle = closest_memory_read1[103:72];
  assign test_issued = busy;
  assign watch_test_packet = merge_packet;
  assign watch_test_ray = merge_ray;

  // What nothing reads.
  wire unused = &{
    1'b0,
    record_response_data[31:22],
    record_response_data[63:54],
    record_response_data[95:86],
    leaf_memory_read0[9:0],
    leaf_memory_read0[35:14],
    ray_limit_memory_read0_s54[72:49],
    ray_limit_memory_read1_s49[48:0],
    closest_memory_read0_s55[71:24],
    leaf_memory_read1_s55[13:10]
  };

endmodule

`default_nettype wire
