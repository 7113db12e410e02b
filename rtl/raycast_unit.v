// SPDX-License-Identifier: MIT OR Apache-2.0
// raycast_unit: casts packets of 4 rays into a scene, 48 packets at a time.
// Rays arrive one a clock, a packet's in order; its hits leave the same way under its tag, packets
// in any order. After reset, wait for ray_ready.

`default_nettype none

module raycast_unit (
  input  wire         clk,
  input  wire         rst,

  // The scene: root link word and box, constant while packets are under way
  input  wire [31:0]  scene_root,
  input  wire [23:0]  scene_lo_x,
  input  wire [23:0]  scene_lo_y,
  input  wire [23:0]  scene_lo_z,
  input  wire [23:0]  scene_hi_x,
  input  wire [23:0]  scene_hi_y,
  input  wire [23:0]  scene_hi_z,

  // Rays in
  input  wire         ray_valid,
  input  wire [15:0]  ray_tag,
  input  wire [23:0]  ray_origin_x,
  input  wire [23:0]  ray_origin_y,
  input  wire [23:0]  ray_origin_z,
  input  wire [23:0]  ray_direction_x,
  input  wire [23:0]  ray_direction_y,
  input  wire [23:0]  ray_direction_z,
  input  wire [23:0]  ray_tmin,
  input  wire [23:0]  ray_tmax,
  input  wire         ray_active,
  input  wire         ray_any_hit,
  output wire         ray_ready,

  // Hits out
  input  wire         hit_ready,
  output wire         hit_valid,
  output wire [15:0]  hit_tag,
  output wire [23:0]  hit_t,
  output wire [23:0]  hit_u,
  output wire [23:0]  hit_v,
  output wire [31:0]  hit_instance,
  output wire [31:0]  hit_triangle,

  // Node memory: requests
  input  wire         node_request_ready,
  output wire         node_request_valid,
  output wire [21:0]  node_request_address,
  output wire [5:0]   node_request_tag,

  // Node memory: answers, in any order, always taken
  input  wire         node_response_valid,
  input  wire [5:0]   node_response_tag,
  input  wire [127:0] node_response_data,

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

  // Counters since reset
  output wire [39:0]  count_cycles,
  output wire [39:0]  count_packet_steps,
  output wire [39:0]  count_ray_triangle_tests,
  output wire [39:0]  count_tpu_busy_cycles,
  output wire [39:0]  count_tpu_starved_cycles,
  output wire [39:0]  count_gu_busy_cycles,
  output wire [39:0]  count_gu_starved_cycles,
  output wire [5:0]   stack_high_water,
  output wire         stack_overflow,

  // What happens inside, for whoever watches
  output wire         watch_start_valid,
  output wire [5:0]   watch_start_packet,
  output wire [15:0]  watch_start_tag,
  output wire         watch_step_valid,
  output wire [5:0]   watch_step_packet,
  output wire [21:0]  watch_step_node,
  output wire [3:0]   watch_step_left,
  output wire [3:0]   watch_step_right,
  output wire         watch_step_left_first,
  output wire [191:0] watch_step_left_intervals,
  output wire [191:0] watch_step_right_intervals,
  output wire         watch_test_valid,
  output wire [5:0]   watch_test_packet,
  output wire [1:0]   watch_test_ray,
  output wire [21:0]  watch_test_record,
  output wire         watch_test_hit,
  output wire         watch_test_replaces,
  output wire [23:0]  watch_test_t,
  output wire [23:0]  watch_test_u,
  output wire [23:0]  watch_test_v
);

  // After reset every packet number is put into the queue of free ones, and what counts by packet
  // is cleared.
  reg  sweeping;
  reg  [5:0] sweep_packet;
  wire freed;
  wire [5:0] freed_packet;
  wire take_free;

  always @(posedge clk) begin
    if (rst) sweeping <= 1'b1; else sweeping <= sweeping & (sweep_packet != 6'd47);
    if (rst) sweep_packet <= 6'd0; else if (sweeping) sweep_packet <= sweep_packet + 6'd1;
  end

  wire [5:0] free_queue_data = sweeping ? sweep_packet : freed_packet;

  wire free_queue_valid;
  wire [5:0] free_queue_front;
  fifo_6x48 free_queue (
    .clk(clk),
    .rst(rst),
    .push(sweeping | freed),
    .data(free_queue_data),
    .pop(take_free),
    .valid(free_queue_valid),
    .front(free_queue_front)
  );

  // A packet's rays arrive one by one; the first takes a free packet number, the others share it.
  reg  [1:0] place;
  wire first_ray = ~|place;
  wire last_ray = place == 2'd3;
  wire ready = ~sweeping & free_queue_valid;
  wire take_ray = ray_valid & ready;
  wire packet_enters = take_ray & last_ray;
  assign take_free = packet_enters;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [15:0] tag_memory_copy0 [0:47];
  (* no_rw_check, ram_style = "distributed" *)
  reg  [15:0] tag_memory_copy1 [0:47];

  always @(posedge clk) begin
    if (rst) place <= 2'd0; else if (take_ray) place <= last_ray ? 2'd0 : (place + 2'd1);
  end

  wire take_ray_and_first_ray = take_ray & first_ray;

  // Ray setup.
  wire setup_out_valid;
  wire [5:0] setup_out_packet;
  wire [1:0] setup_out_ray;
  wire setup_out_enters;
  wire [23:0] setup_out_near;
  wire [23:0] setup_out_far;
  wire [2:0] setup_out_signs;
  wire [23:0] setup_out_tmin;
  wire [23:0] setup_out_tmax;
  wire setup_out_any_hit;
  wire [23:0] setup_out_origin_x;
  wire [23:0] setup_out_reciprocal_x;
  wire [23:0] setup_out_origin_y;
  wire [23:0] setup_out_reciprocal_y;
  wire [23:0] setup_out_origin_z;
  wire [23:0] setup_out_reciprocal_z;
  wire [1:0] setup_out_kz;
  wire [23:0] setup_out_shear_x;
  wire [23:0] setup_out_shear_y;
  wire [23:0] setup_out_shear_z;
  wire setup_soon;
  ray_setup setup (
    .clk(clk),
    .rst(rst),
    .valid(take_ray),
    .packet(free_queue_front),
    .ray(place),
    .active(ray_active),
    .any_hit(ray_any_hit),
    .origin_x(ray_origin_x),
    .origin_y(ray_origin_y),
    .origin_z(ray_origin_z),
    .direction_x(ray_direction_x),
    .direction_y(ray_direction_y),
    .direction_z(ray_direction_z),
    .tmin(ray_tmin),
    .tmax(ray_tmax),
    .scene_lo_x(scene_lo_x),
    .scene_lo_y(scene_lo_y),
    .scene_lo_z(scene_lo_z),
    .scene_hi_x(scene_hi_x),
    .scene_hi_y(scene_hi_y),
    .scene_hi_z(scene_hi_z),
    .out_valid(setup_out_valid),
    .out_packet(setup_out_packet),
    .out_ray(setup_out_ray),
    .out_enters(setup_out_enters),
    .out_near(setup_out_near),
    .out_far(setup_out_far),
    .out_signs(setup_out_signs),
    .out_tmin(setup_out_tmin),
    .out_tmax(setup_out_tmax),
    .out_any_hit(setup_out_any_hit),
    .out_origin_x(setup_out_origin_x),
    .out_reciprocal_x(setup_out_reciprocal_x),
    .out_origin_y(setup_out_origin_y),
    .out_reciprocal_y(setup_out_reciprocal_y),
    .out_origin_z(setup_out_origin_z),
    .out_reciprocal_z(setup_out_reciprocal_z),
    .out_kz(setup_out_kz),
    .out_shear_x(setup_out_shear_x),
    .out_shear_y(setup_out_shear_y),
    .out_shear_z(setup_out_shear_z),
    .soon(setup_soon)
  );

  // Traversal and geometry.
  wire leaf_ready;
  wire limit_valid;
  wire [5:0] limit_packet;
  wire [1:0] limit_ray;
  wire [23:0] limit_value;
  wire done_valid;
  wire [5:0] done_packet;
  wire [9:0] done_context;

  wire traversal_node_request_valid;
  wire [21:0] traversal_node_request_address;
  wire [5:0] traversal_node_request_tag;
  wire traversal_leaf_valid;
  wire [5:0] traversal_leaf_packet;
  wire [21:0] traversal_leaf_address;
  wire [9:0] traversal_leaf_context;
  wire [3:0] traversal_leaf_mask;
  wire traversal_finished_valid;
  wire [5:0] traversal_finished_packet;
  wire [3:0] traversal_finished_touched;
  wire traversal_step_taken;
  wire [5:0] traversal_stack_high_water;
  wire traversal_stack_overflow;
  wire [5:0] traversal_watch_step_packet;
  wire [21:0] traversal_watch_step_node;
  wire [3:0] traversal_watch_step_left;
  wire [3:0] traversal_watch_step_right;
  wire traversal_watch_step_left_first;
  wire [191:0] traversal_watch_step_left_intervals;
  wire [191:0] traversal_watch_step_right_intervals;
  tpu traversal (
    .clk(clk),
    .rst(rst),
    .setup_soon(setup_soon),
    .setup_valid(setup_out_valid),
    .setup_packet(setup_out_packet),
    .setup_ray(setup_out_ray),
    .setup_enters(setup_out_enters),
    .setup_near(setup_out_near),
    .setup_far(setup_out_far),
    .setup_signs(setup_out_signs),
    .setup_origin_x(setup_out_origin_x),
    .setup_origin_y(setup_out_origin_y),
    .setup_origin_z(setup_out_origin_z),
    .setup_reciprocal_x(setup_out_reciprocal_x),
    .setup_reciprocal_y(setup_out_reciprocal_y),
    .setup_reciprocal_z(setup_out_reciprocal_z),
    .root(scene_root),
    .node_request_ready(node_request_ready),
    .node_request_valid(traversal_node_request_valid),
    .node_request_address(traversal_node_request_address),
    .node_request_tag(traversal_node_request_tag),
    .node_response_valid(node_response_valid),
    .node_response_tag(node_response_tag),
    .node_response_data(node_response_data),
    .leaf_ready(leaf_ready),
    .leaf_valid(traversal_leaf_valid),
    .leaf_packet(traversal_leaf_packet),
    .leaf_address(traversal_leaf_address),
    .leaf_context(traversal_leaf_context),
    .leaf_mask(traversal_leaf_mask),
    .limit_valid(limit_valid),
    .limit_packet(limit_packet),
    .limit_ray(limit_ray),
    .limit_value(limit_value),
    .done_valid(done_valid),
    .done_packet(done_packet),
    .done_context(done_context),
    .finished_valid(traversal_finished_valid),
    .finished_packet(traversal_finished_packet),
    .finished_touched(traversal_finished_touched),
    .step_taken(traversal_step_taken),
    .stack_high_water(traversal_stack_high_water),
    .stack_overflow(traversal_stack_overflow),
    .watch_step_packet(traversal_watch_step_packet),
    .watch_step_node(traversal_watch_step_node),
    .watch_step_left(traversal_watch_step_left),
    .watch_step_right(traversal_watch_step_right),
    .watch_step_left_first(traversal_watch_step_left_first),
    .watch_step_left_intervals(traversal_watch_step_left_intervals),
    .watch_step_right_intervals(traversal_watch_step_right_intervals)
  );

  wire [5:0] read_packet;
  wire [1:0] read_ray;

  wire intersection_leaf_ready;
  wire intersection_record_request_valid;
  wire [21:0] intersection_record_request_address;
  wire [5:0] intersection_record_request_tag;
  wire intersection_vertex_request_valid;
  wire [21:0] intersection_vertex_request_address;
  wire [7:0] intersection_vertex_request_tag;
  wire intersection_limit_valid;
  wire [5:0] intersection_limit_packet;
  wire [1:0] intersection_limit_ray;
  wire [23:0] intersection_limit_value;
  wire intersection_done_valid;
  wire [5:0] intersection_done_packet;
  wire [9:0] intersection_done_context;
  wire [23:0] intersection_read_t;
  wire [23:0] intersection_read_u;
  wire [23:0] intersection_read_v;
  wire [31:0] intersection_read_triangle;
  wire intersection_test_issued;
  wire intersection_watch_test_valid;
  wire [5:0] intersection_watch_test_packet;
  wire [1:0] intersection_watch_test_ray;
  wire [21:0] intersection_watch_test_record;
  wire intersection_watch_test_hit;
  wire intersection_watch_test_replaces;
  wire [23:0] intersection_watch_test_t;
  wire [23:0] intersection_watch_test_u;
  wire [23:0] intersection_watch_test_v;
  geometry_unit intersection (
    .clk(clk),
    .rst(rst),
    .setup_valid(setup_out_valid),
    .setup_packet(setup_out_packet),
    .setup_ray(setup_out_ray),
    .setup_origin_x(setup_out_origin_x),
    .setup_origin_y(setup_out_origin_y),
    .setup_origin_z(setup_out_origin_z),
    .setup_reciprocal_x(setup_out_reciprocal_x),
    .setup_reciprocal_y(setup_out_reciprocal_y),
    .setup_reciprocal_z(setup_out_reciprocal_z),
    .setup_signs(setup_out_signs),
    .setup_kz(setup_out_kz),
    .setup_shear_x(setup_out_shear_x),
    .setup_shear_y(setup_out_shear_y),
    .setup_tmin(setup_out_tmin),
    .setup_tmax(setup_out_tmax),
    .setup_any_hit(setup_out_any_hit),
    .setup_shear_z(setup_out_shear_z),
    .leaf_valid(traversal_leaf_valid),
    .leaf_packet(traversal_leaf_packet),
    .leaf_address(traversal_leaf_address),
    .leaf_context(traversal_leaf_context),
    .leaf_mask(traversal_leaf_mask),
    .leaf_ready(intersection_leaf_ready),
    .record_request_ready(record_request_ready),
    .record_request_valid(intersection_record_request_valid),
    .record_request_address(intersection_record_request_address),
    .record_request_tag(intersection_record_request_tag),
    .record_response_valid(record_response_valid),
    .record_response_tag(record_response_tag),
    .record_response_data(record_response_data),
    .vertex_request_ready(vertex_request_ready),
    .vertex_request_valid(intersection_vertex_request_valid),
    .vertex_request_address(intersection_vertex_request_address),
    .vertex_request_tag(intersection_vertex_request_tag),
    .vertex_response_valid(vertex_response_valid),
    .vertex_response_tag(vertex_response_tag),
    .vertex_response_data(vertex_response_data),
    .sweep(sweeping),
    .sweep_packet(sweep_packet),
    .read_packet(read_packet),
    .read_ray(read_ray),
    .limit_valid(intersection_limit_valid),
    .limit_packet(intersection_limit_packet),
    .limit_ray(intersection_limit_ray),
    .limit_value(intersection_limit_value),
    .done_valid(intersection_done_valid),
    .done_packet(intersection_done_packet),
    .done_context(intersection_done_context),
    .read_t(intersection_read_t),
    .read_u(intersection_read_u),
    .read_v(intersection_read_v),
    .read_triangle(intersection_read_triangle),
    .test_issued(intersection_test_issued),
    .watch_test_valid(intersection_watch_test_valid),
    .watch_test_packet(intersection_watch_test_packet),
    .watch_test_ray(intersection_watch_test_ray),
    .watch_test_record(intersection_watch_test_record),
    .watch_test_hit(intersection_watch_test_hit),
    .watch_test_replaces(intersection_watch_test_replaces),
    .watch_test_t(intersection_watch_test_t),
    .watch_test_u(intersection_watch_test_u),
    .watch_test_v(intersection_watch_test_v)
  );

  assign leaf_ready = intersection_leaf_ready;
  assign limit_valid = intersection_limit_valid;
  assign limit_packet = intersection_limit_packet;
  assign limit_ray = intersection_limit_ray;
  assign limit_value = intersection_limit_value;
  assign done_valid = intersection_done_valid;
  assign done_packet = intersection_done_packet;
  assign done_context = intersection_done_context;

  // Finished packets hand out their hits ray by ray. The word read is always that of the ray shown
  // next.
  wire take_finished;
  wire [9:0] finished_queue_data = {traversal_finished_touched, traversal_finished_packet};

  wire finished_queue_valid;
  wire [9:0] finished_queue_front;
  fifo_10x48 finished_queue (
    .clk(clk),
    .rst(rst),
    .push(traversal_finished_valid),
    .data(finished_queue_data),
    .pop(take_finished),
    .valid(finished_queue_valid),
    .front(finished_queue_front)
  );

  reg  [9:0] out;
  reg  out_valid;
  reg  out_fresh;
  reg  [1:0] out_ray;
  wire shown = out_valid & out_fresh;
  wire hit_taken = shown & hit_ready;
  wire out_last = out_ray == 2'd3;
  wire packet_leaves = hit_taken & out_last;
  wire load = finished_queue_valid & (~out_valid | packet_leaves);
  assign take_finished = load;

  always @(posedge clk) begin
    if (load) out <= finished_queue_front;
    if (rst) out_valid <= 1'b0; else out_valid <= load | (out_valid & ~packet_leaves);
  end

  wire [1:0] next_ray = hit_taken ? (out_ray + 2'd1) : out_ray;

  always @(posedge clk) begin
    out_ray <= load ? 2'd0 : next_ray;
    out_fresh <= ~load & out_valid & ~packet_leaves;
  end

  wire [5:0] out_packet = out[5:0];
  assign read_packet = out_packet;
  assign read_ray = next_ray;
  assign freed = packet_leaves;
  assign freed_packet = out_packet;
  wire out_touched =
      (out_ray == 2'd0) ? out[6] :
      (out_ray == 2'd1) ? out[7] :
      (out_ray == 2'd2) ? out[8] :
      out[9];
  wire [31:0] out_triangle = out_touched ? intersection_read_triangle : 32'hffffffff;
  assign hit_tag = tag_memory_copy0[out_packet];

  // Counters since reset.
  reg  [6:0] under_way;

  always @(posedge clk) begin
    if (rst) under_way <= 7'd0; else if (packet_enters ^ packet_leaves) under_way <= packet_enters ? (under_way + 7'd1) : (under_way - 7'd1);
  end

  wire some_under_way = |under_way;
  reg  [39:0] cycles_counter;
  reg  [39:0] packet_steps_counter;
  reg  [39:0] ray_triangle_tests_counter;
  reg  [39:0] tpu_busy_cycles_counter;
  reg  [39:0] tpu_starved_cycles_counter;
  reg  [39:0] gu_busy_cycles_counter;
  reg  [39:0] gu_starved_cycles_counter;

  always @(posedge clk) begin
    if (rst) cycles_counter <= 40'd0; else cycles_counter <= cycles_counter + 40'd1;
    if (rst) packet_steps_counter <= 40'd0; else if (traversal_step_taken) packet_steps_counter <= packet_steps_counter + 40'd1;
    if (rst) ray_triangle_tests_counter <= 40'd0; else if (intersection_test_issued) ray_triangle_tests_counter <= ray_triangle_tests_counter + 40'd1;
    if (rst) tpu_busy_cycles_counter <= 40'd0; else if (traversal_step_taken) tpu_busy_cycles_counter <= tpu_busy_cycles_counter + 40'd1;
    if (rst) tpu_starved_cycles_counter <= 40'd0; else if (some_under_way & ~traversal_step_taken) tpu_starved_cycles_counter <= tpu_starved_cycles_counter + 40'd1;
    if (rst) gu_busy_cycles_counter <= 40'd0; else if (intersection_test_issued) gu_busy_cycles_counter <= gu_busy_cycles_counter + 40'd1;
    if (rst) gu_starved_cycles_counter <= 40'd0; else if (some_under_way & ~intersection_test_issued) gu_starved_cycles_counter <= gu_starved_cycles_counter + 40'd1;
  end

  wire [15:0] tag_memory_read1 = tag_memory_copy1[free_queue_front];

  // Memories.
  always @(posedge clk) begin
    if (take_ray_and_first_ray) tag_memory_copy0[free_queue_front] <= ray_tag;
  end

  always @(posedge clk) begin
    if (take_ray_and_first_ray) tag_memory_copy1[free_queue_front] <= ray_tag;
  end

  assign ray_ready = ready;
  assign hit_valid = shown;
  assign hit_t = out_touched ? intersection_read_t : 24'h7f0000;
  assign hit_u = out_touched ? intersection_read_u : 24'd0;
  assign hit_v = out_touched ? intersection_read_v : 24'd0;
  assign hit_instance = {32{&out_triangle}};
  assign hit_triangle = out_triangle;
  assign node_request_valid = traversal_node_request_valid;
  assign node_request_address = traversal_node_request_address;
  assign node_request_tag = traversal_node_request_tag;
  assign record_request_valid = intersection_record_request_valid;
  assign record_request_address = intersection_record_request_address;
  assign record_request_tag = intersection_record_request_tag;
  assign vertex_request_valid = intersection_vertex_request_valid;
  assign vertex_request_address = intersection_vertex_request_address;
  assign vertex_request_tag = intersection_vertex_request_tag;
  assign count_cycles = cycles_counter;
  assign count_packet_steps = packet_steps_counter;
  assign count_ray_triangle_tests = ray_triangle_tests_counter;
  assign count_tpu_busy_cycles = tpu_busy_cycles_counter;
  assign count_tpu_starved_cycles = tpu_starved_cycles_counter;
  assign count_gu_busy_cycles = gu_busy_cycles_counter;
  assign count_gu_starved_cycles = gu_starved_cycles_counter;
  assign stack_high_water = traversal_stack_high_water;
  assign stack_overflow = traversal_stack_overflow;
  assign watch_start_valid = packet_enters;
  assign watch_start_packet = free_queue_front;
  assign watch_start_tag = first_ray ? ray_tag : tag_memory_read1;
  assign watch_step_valid = traversal_step_taken;
  assign watch_step_packet = traversal_watch_step_packet;
  assign watch_step_node = traversal_watch_step_node;
  assign watch_step_left = traversal_watch_step_left;
  assign watch_step_right = traversal_watch_step_right;
  assign watch_step_left_first = traversal_watch_step_left_first;
  assign watch_step_left_intervals = traversal_watch_step_left_intervals;
  assign watch_step_right_intervals = traversal_watch_step_right_intervals;
  assign watch_test_valid = intersection_watch_test_valid;
  assign watch_test_packet = intersection_watch_test_packet;
  assign watch_test_ray = intersection_watch_test_ray;
  assign watch_test_record = intersection_watch_test_record;
  assign watch_test_hit = intersection_watch_test_hit;
  assign watch_test_replaces = intersection_watch_test_replaces;
  assign watch_test_t = intersection_watch_test_t;
  assign watch_test_u = intersection_watch_test_u;
  assign watch_test_v = intersection_watch_test_v;

endmodule

`default_nettype wire
