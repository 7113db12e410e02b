// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_raycast_unit: casts packets of 4 rays into a scene, 48 packets at a time.
// Rays arrive one a clock, a packet's in order; its hits leave the same way under its tag, packets
// in any order. After reset, wait for ray_ready.

`default_nettype none

module dynrt_raycast_unit (
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
  output wire [6:0]   node_request_tag,

  // Node memory: answers, in any order, always taken
  input  wire         node_response_valid,
  input  wire [6:0]   node_response_tag,
  input  wire [127:0] node_response_data,

  // Record memory: requests
  input  wire         record_request_ready,
  output wire         record_request_valid,
  output wire [21:0]  record_request_address,
  output wire [6:0]   record_request_tag,

  // Record memory: answers, in any order, always taken
  input  wire         record_response_valid,
  input  wire [6:0]   record_response_tag,
  input  wire [127:0] record_response_data,

  // Vertex memory: requests
  input  wire         vertex_request_ready,
  output wire         vertex_request_valid,
  output wire [21:0]  vertex_request_address,
  output wire [8:0]   vertex_request_tag,

  // Vertex memory: answers, in any order, always taken
  input  wire         vertex_response_valid,
  input  wire [8:0]   vertex_response_tag,
  input  wire [71:0]  vertex_response_data,

  // Influence memory: requests
  input  wire         influence_request_ready,
  output wire         influence_request_valid,
  output wire [21:0]  influence_request_address,
  output wire [2:0]   influence_request_tag,

  // Influence memory: answers, in any order, always taken
  input  wire         influence_response_valid,
  input  wire [2:0]   influence_response_tag,
  input  wire [127:0] influence_response_data,

  // A mesh to skin, taken when no packet is under way: indices of its palette, influence rows, vertices at rest and vertices to write, and how many of each
  input  wire         skin_start_valid,
  input  wire [21:0]  skin_start_palette,
  input  wire [8:0]   skin_start_joints,
  input  wire [21:0]  skin_start_influences,
  input  wire [21:0]  skin_start_rows,
  input  wire [21:0]  skin_start_rest,
  input  wire [21:0]  skin_start_vertices,
  input  wire [21:0]  skin_start_target,
  output wire         skin_start_ready,

  // Vertex memory: writes of skinned vertices
  input  wire         skin_write_ready,
  output wire         skin_write_valid,
  output wire [21:0]  skin_write_address,
  output wire [71:0]  skin_write_data,

  // High for a clock when a mesh is complete
  output wire         skin_done,

  // Counters since reset
  output wire [39:0]  count_cycles,
  output wire [39:0]  count_packet_steps,
  output wire [39:0]  count_ray_triangle_tests,
  output wire [39:0]  count_tpu_busy_cycles,
  output wire [39:0]  count_tpu_starved_cycles,
  output wire [39:0]  count_ray_transforms,
  output wire [39:0]  count_gu_busy_cycles,
  output wire [39:0]  count_gu_starved_cycles,
  output wire [39:0]  count_skin_influences,
  output wire [39:0]  count_skin_cycles,
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
  output wire [31:0]  watch_test_instance,
  output wire         watch_test_hit,
  output wire         watch_test_replaces,
  output wire [23:0]  watch_test_t,
  output wire [23:0]  watch_test_u,
  output wire [23:0]  watch_test_v,
  output wire         watch_transform_valid,
  output wire [5:0]   watch_transform_packet,
  output wire [1:0]   watch_transform_ray,
  output wire [21:0]  watch_transform_record,
  output wire [23:0]  watch_transform_near,
  output wire [23:0]  watch_transform_far,
  output wire [23:0]  watch_transform_origin_x,
  output wire [23:0]  watch_transform_origin_y,
  output wire [23:0]  watch_transform_origin_z,
  output wire [23:0]  watch_transform_direction_x,
  output wire [23:0]  watch_transform_direction_y,
  output wire [23:0]  watch_transform_direction_z
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
  dynrt_fifo_6x48 free_queue (
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
  wire object_valid;
  wire skinning_now;
  wire paused = skin_start_valid | skinning_now;
  wire ready = ~sweeping & free_queue_valid & ~object_valid & ~paused;
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

  wire tag_memory_write_enable = take_ray & first_ray;

  // Ray setup: of a ray of the world, or, before that, of one that the geometry unit has taken to
  // an object's space.
  wire [5:0] object_packet;
  wire [5:0] setup_packet = object_valid ? object_packet : free_queue_front;
  wire [1:0] object_ray;
  wire object_first;
  wire setup_first = object_valid ? object_first : first_ray;
  wire object_last;
  wire setup_last = object_valid ? object_last : last_ray;
  wire [23:0] object_tmin;
  wire [23:0] setup_tmin = object_valid ? object_tmin : ray_tmin;
  wire [23:0] object_tmax;
  wire [23:0] setup_tmax = object_valid ? object_tmax : ray_tmax;
  wire [23:0] object_origin_x;
  wire [23:0] setup_origin_x = object_valid ? object_origin_x : ray_origin_x;
  wire [23:0] object_origin_y;
  wire [23:0] setup_origin_y = object_valid ? object_origin_y : ray_origin_y;
  wire [23:0] object_origin_z;
  wire [23:0] setup_origin_z = object_valid ? object_origin_z : ray_origin_z;
  wire [23:0] object_direction_x;
  wire [23:0] setup_direction_x = object_valid ? object_direction_x : ray_direction_x;
  wire [23:0] object_direction_y;
  wire [23:0] setup_direction_y = object_valid ? object_direction_y : ray_direction_y;
  wire [23:0] object_direction_z;
  wire [23:0] setup_direction_z = object_valid ? object_direction_z : ray_direction_z;

  wire setup_out_valid;
  wire [5:0] setup_out_packet;
  wire [1:0] setup_out_ray;
  wire setup_out_first;
  wire setup_out_last;
  wire setup_out_object;
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
  wire [5:0] setup_next_packet;
  wire setup_soon;
  dynrt_ray_setup setup (
    .clk(clk),
    .rst(rst),
    .valid(object_valid | take_ray),
    .packet(setup_packet),
    .ray(object_valid ? object_ray : place),
    .first(setup_first),
    .last(setup_last),
    .object(object_valid),
    .active(object_valid | ray_active),
    .any_hit(ray_any_hit),
    .origin_x(setup_origin_x),
    .origin_y(setup_origin_y),
    .origin_z(setup_origin_z),
    .direction_x(setup_direction_x),
    .direction_y(setup_direction_y),
    .direction_z(setup_direction_z),
    .tmin(setup_tmin),
    .tmax(setup_tmax),
    .scene_lo_x(scene_lo_x),
    .scene_lo_y(scene_lo_y),
    .scene_lo_z(scene_lo_z),
    .scene_hi_x(scene_hi_x),
    .scene_hi_y(scene_hi_y),
    .scene_hi_z(scene_hi_z),
    .out_valid(setup_out_valid),
    .out_packet(setup_out_packet),
    .out_ray(setup_out_ray),
    .out_first(setup_out_first),
    .out_last(setup_out_last),
    .out_object(setup_out_object),
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
    .next_packet(setup_next_packet),
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
  wire [10:0] done_context;
  wire [21:0] start_address;
  wire start_leaf;
  wire [10:0] start_context;

  wire traversal_node_request_valid;
  wire [21:0] traversal_node_request_address;
  wire [6:0] traversal_node_request_tag;
  wire traversal_leaf_valid;
  wire [5:0] traversal_leaf_packet;
  wire [21:0] traversal_leaf_address;
  wire [10:0] traversal_leaf_context;
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
  dynrt_tpu traversal (
    .clk(clk),
    .rst(rst),
    .setup_soon(setup_soon),
    .setup_valid(setup_out_valid),
    .setup_packet(setup_out_packet),
    .setup_ray(setup_out_ray),
    .setup_first(setup_out_first),
    .setup_last(setup_out_last),
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
    .setup_object(setup_out_object),
    .object_address(start_address),
    .object_leaf(start_leaf),
    .object_context(start_context),
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
  wire intersection_vertex_response_valid = vertex_response_valid & ~skinning_now;
  wire skin_palette_valid;
  wire [7:0] skin_palette_joint;
  wire [1:0] skin_palette_column;
  wire [71:0] skin_palette_data;
  wire skin_issue_valid;
  wire [1:0] skin_issue_position;
  wire skin_issue_last;
  wire [7:0] skin_issue_joint;
  wire [23:0] skin_issue_x;
  wire [23:0] skin_issue_y;
  wire [23:0] skin_issue_z;
  wire [23:0] skin_issue_weight;
  wire [23:0] skin_pair_a_x;
  wire [23:0] skin_pair_b_x;
  wire [23:0] skin_pair_a_y;
  wire [23:0] skin_pair_b_y;
  wire [23:0] skin_pair_a_z;
  wire [23:0] skin_pair_b_z;
  wire [23:0] skin_vertex_a_x;
  wire [23:0] skin_vertex_b_x;
  wire [23:0] skin_vertex_a_y;
  wire [23:0] skin_vertex_b_y;
  wire [23:0] skin_vertex_a_z;
  wire [23:0] skin_vertex_b_z;
  wire scene_root_right_leaf = scene_root[27];

  wire intersection_leaf_ready;
  wire intersection_record_request_valid;
  wire [21:0] intersection_record_request_address;
  wire [6:0] intersection_record_request_tag;
  wire intersection_vertex_request_valid;
  wire [21:0] intersection_vertex_request_address;
  wire [8:0] intersection_vertex_request_tag;
  wire intersection_skin_weighted_valid;
  wire [1:0] intersection_skin_weighted_position;
  wire intersection_skin_weighted_last;
  wire [23:0] intersection_skin_weighted_x;
  wire [23:0] intersection_skin_weighted_y;
  wire [23:0] intersection_skin_weighted_z;
  wire [23:0] intersection_skin_pair_sum_x;
  wire [23:0] intersection_skin_pair_sum_y;
  wire [23:0] intersection_skin_pair_sum_z;
  wire [23:0] intersection_skin_vertex_sum_x;
  wire [23:0] intersection_skin_vertex_sum_y;
  wire [23:0] intersection_skin_vertex_sum_z;
  wire intersection_object_valid;
  wire [5:0] intersection_object_packet;
  wire [1:0] intersection_object_ray;
  wire intersection_object_first;
  wire intersection_object_last;
  wire [23:0] intersection_object_origin_x;
  wire [23:0] intersection_object_origin_y;
  wire [23:0] intersection_object_origin_z;
  wire [23:0] intersection_object_direction_x;
  wire [23:0] intersection_object_direction_y;
  wire [23:0] intersection_object_direction_z;
  wire [23:0] intersection_object_tmin;
  wire [23:0] intersection_object_tmax;
  wire [21:0] intersection_start_address;
  wire intersection_start_leaf;
  wire [10:0] intersection_start_context;
  wire intersection_limit_valid;
  wire [5:0] intersection_limit_packet;
  wire [1:0] intersection_limit_ray;
  wire [23:0] intersection_limit_value;
  wire intersection_done_valid;
  wire [5:0] intersection_done_packet;
  wire [10:0] intersection_done_context;
  wire [23:0] intersection_read_t;
  wire [23:0] intersection_read_u;
  wire [23:0] intersection_read_v;
  wire [31:0] intersection_read_instance;
  wire [31:0] intersection_read_triangle;
  wire intersection_slot_taken;
  wire intersection_test_issued;
  wire intersection_transform_issued;
  wire intersection_watch_test_valid;
  wire [5:0] intersection_watch_test_packet;
  wire [1:0] intersection_watch_test_ray;
  wire [21:0] intersection_watch_test_record;
  wire [31:0] intersection_watch_test_instance;
  wire intersection_watch_test_hit;
  wire intersection_watch_test_replaces;
  wire [23:0] intersection_watch_test_t;
  wire [23:0] intersection_watch_test_u;
  wire [23:0] intersection_watch_test_v;
  wire intersection_watch_transform_valid;
  wire [5:0] intersection_watch_transform_packet;
  wire [1:0] intersection_watch_transform_ray;
  wire [21:0] intersection_watch_transform_record;
  wire [23:0] intersection_watch_transform_near;
  wire [23:0] intersection_watch_transform_far;
  wire [23:0] intersection_watch_transform_origin_x;
  wire [23:0] intersection_watch_transform_origin_y;
  wire [23:0] intersection_watch_transform_origin_z;
  wire [23:0] intersection_watch_transform_direction_x;
  wire [23:0] intersection_watch_transform_direction_y;
  wire [23:0] intersection_watch_transform_direction_z;
  dynrt_geometry_unit intersection (
    .clk(clk),
    .rst(rst),
    .setup_valid(setup_out_valid),
    .setup_packet(setup_out_packet),
    .setup_ray(setup_out_ray),
    .setup_object(setup_out_object),
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
    .setup_next_packet(setup_next_packet),
    .instanced(scene_root_right_leaf),
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
    .vertex_response_valid(intersection_vertex_response_valid),
    .vertex_response_tag(vertex_response_tag),
    .vertex_response_data(vertex_response_data),
    .skinning(skinning_now),
    .skin_palette_valid(skin_palette_valid),
    .skin_palette_joint(skin_palette_joint),
    .skin_palette_column(skin_palette_column),
    .skin_palette_data(skin_palette_data),
    .skin_issue_valid(skin_issue_valid),
    .skin_issue_position(skin_issue_position),
    .skin_issue_last(skin_issue_last),
    .skin_issue_joint(skin_issue_joint),
    .skin_issue_x(skin_issue_x),
    .skin_issue_y(skin_issue_y),
    .skin_issue_z(skin_issue_z),
    .skin_issue_weight(skin_issue_weight),
    .skin_pair_a_x(skin_pair_a_x),
    .skin_pair_b_x(skin_pair_b_x),
    .skin_pair_a_y(skin_pair_a_y),
    .skin_pair_b_y(skin_pair_b_y),
    .skin_pair_a_z(skin_pair_a_z),
    .skin_pair_b_z(skin_pair_b_z),
    .skin_vertex_a_x(skin_vertex_a_x),
    .skin_vertex_b_x(skin_vertex_b_x),
    .skin_vertex_a_y(skin_vertex_a_y),
    .skin_vertex_b_y(skin_vertex_b_y),
    .skin_vertex_a_z(skin_vertex_a_z),
    .skin_vertex_b_z(skin_vertex_b_z),
    .sweep(sweeping),
    .sweep_packet(sweep_packet),
    .read_packet(read_packet),
    .read_ray(read_ray),
    .world_valid(take_ray),
    .world_packet(free_queue_front),
    .world_ray(place),
    .world_direction_x(ray_direction_x),
    .world_direction_y(ray_direction_y),
    .world_direction_z(ray_direction_z),
    .setup_shear_z(setup_out_shear_z),
    .skin_weighted_valid(intersection_skin_weighted_valid),
    .skin_weighted_position(intersection_skin_weighted_position),
    .skin_weighted_last(intersection_skin_weighted_last),
    .skin_weighted_x(intersection_skin_weighted_x),
    .skin_weighted_y(intersection_skin_weighted_y),
    .skin_weighted_z(intersection_skin_weighted_z),
    .skin_pair_sum_x(intersection_skin_pair_sum_x),
    .skin_pair_sum_y(intersection_skin_pair_sum_y),
    .skin_pair_sum_z(intersection_skin_pair_sum_z),
    .skin_vertex_sum_x(intersection_skin_vertex_sum_x),
    .skin_vertex_sum_y(intersection_skin_vertex_sum_y),
    .skin_vertex_sum_z(intersection_skin_vertex_sum_z),
    .object_valid(intersection_object_valid),
    .object_packet(intersection_object_packet),
    .object_ray(intersection_object_ray),
    .object_first(intersection_object_first),
    .object_last(intersection_object_last),
    .object_origin_x(intersection_object_origin_x),
    .object_origin_y(intersection_object_origin_y),
    .object_origin_z(intersection_object_origin_z),
    .object_direction_x(intersection_object_direction_x),
    .object_direction_y(intersection_object_direction_y),
    .object_direction_z(intersection_object_direction_z),
    .object_tmin(intersection_object_tmin),
    .object_tmax(intersection_object_tmax),
    .start_address(intersection_start_address),
    .start_leaf(intersection_start_leaf),
    .start_context(intersection_start_context),
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
    .read_instance(intersection_read_instance),
    .read_triangle(intersection_read_triangle),
    .slot_taken(intersection_slot_taken),
    .test_issued(intersection_test_issued),
    .transform_issued(intersection_transform_issued),
    .watch_test_valid(intersection_watch_test_valid),
    .watch_test_packet(intersection_watch_test_packet),
    .watch_test_ray(intersection_watch_test_ray),
    .watch_test_record(intersection_watch_test_record),
    .watch_test_instance(intersection_watch_test_instance),
    .watch_test_hit(intersection_watch_test_hit),
    .watch_test_replaces(intersection_watch_test_replaces),
    .watch_test_t(intersection_watch_test_t),
    .watch_test_u(intersection_watch_test_u),
    .watch_test_v(intersection_watch_test_v),
    .watch_transform_valid(intersection_watch_transform_valid),
    .watch_transform_packet(intersection_watch_transform_packet),
    .watch_transform_ray(intersection_watch_transform_ray),
    .watch_transform_record(intersection_watch_transform_record),
    .watch_transform_near(intersection_watch_transform_near),
    .watch_transform_far(intersection_watch_transform_far),
    .watch_transform_origin_x(intersection_watch_transform_origin_x),
    .watch_transform_origin_y(intersection_watch_transform_origin_y),
    .watch_transform_origin_z(intersection_watch_transform_origin_z),
    .watch_transform_direction_x(intersection_watch_transform_direction_x),
    .watch_transform_direction_y(intersection_watch_transform_direction_y),
    .watch_transform_direction_z(intersection_watch_transform_direction_z)
  );

  assign leaf_ready = intersection_leaf_ready;
  assign limit_valid = intersection_limit_valid;
  assign limit_packet = intersection_limit_packet;
  assign limit_ray = intersection_limit_ray;
  assign limit_value = intersection_limit_value;
  assign done_valid = intersection_done_valid;
  assign done_packet = intersection_done_packet;
  assign done_context = intersection_done_context;
  assign start_address = intersection_start_address;
  assign start_leaf = intersection_start_leaf;
  assign start_context = intersection_start_context;
  assign object_valid = intersection_object_valid;
  assign object_packet = intersection_object_packet;
  assign object_ray = intersection_object_ray;
  assign object_first = intersection_object_first;
  assign object_last = intersection_object_last;
  assign object_tmin = intersection_object_tmin;
  assign object_tmax = intersection_object_tmax;
  assign object_origin_x = intersection_object_origin_x;
  assign object_origin_y = intersection_object_origin_y;
  assign object_origin_z = intersection_object_origin_z;
  assign object_direction_x = intersection_object_direction_x;
  assign object_direction_y = intersection_object_direction_y;
  assign object_direction_z = intersection_object_direction_z;

  // Finished packets hand out their hits ray by ray. The word read is always that of the ray shown
  // next.
  wire take_finished;
  wire [9:0] finished_queue_data = {traversal_finished_touched, traversal_finished_packet};

  wire finished_queue_valid;
  wire [9:0] finished_queue_front;
  dynrt_fifo_10x48 finished_queue (
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
  assign hit_tag = tag_memory_copy0[out_packet];

  // Skinning borrows the geometry unit and its port to vertex memory.
  reg  [6:0] under_way;
  wire some_under_way = |under_way;

  always @(posedge clk) begin
    if (rst) under_way <= 7'd0; else if (packet_enters ^ packet_leaves) under_way <= packet_enters ? (under_way + 7'd1) : (under_way - 7'd1);
  end

  wire skinner_vertex_response_valid = vertex_response_valid & skinning_now;

  wire skinner_start_ready;
  wire skinner_vertex_request_valid;
  wire [21:0] skinner_vertex_request_address;
  wire [3:0] skinner_vertex_request_tag;
  wire skinner_influence_request_valid;
  wire [21:0] skinner_influence_request_address;
  wire [2:0] skinner_influence_request_tag;
  wire skinner_write_valid;
  wire [21:0] skinner_write_address;
  wire [71:0] skinner_write_data;
  wire skinner_skinning;
  wire skinner_palette_valid;
  wire [7:0] skinner_palette_joint;
  wire [1:0] skinner_palette_column;
  wire [71:0] skinner_palette_data;
  wire skinner_issue_valid;
  wire [7:0] skinner_issue_joint;
  wire [23:0] skinner_issue_x;
  wire [23:0] skinner_issue_y;
  wire [23:0] skinner_issue_z;
  wire [23:0] skinner_issue_weight;
  wire [1:0] skinner_issue_position;
  wire skinner_issue_last;
  wire [23:0] skinner_pair_a_x;
  wire [23:0] skinner_pair_b_x;
  wire [23:0] skinner_pair_a_y;
  wire [23:0] skinner_pair_b_y;
  wire [23:0] skinner_pair_a_z;
  wire [23:0] skinner_pair_b_z;
  wire [23:0] skinner_vertex_a_x;
  wire [23:0] skinner_vertex_b_x;
  wire [23:0] skinner_vertex_a_y;
  wire [23:0] skinner_vertex_b_y;
  wire [23:0] skinner_vertex_a_z;
  wire [23:0] skinner_vertex_b_z;
  wire skinner_done;
  wire skinner_influence_issued;
  dynrt_skinning_processor skinner (
    .clk(clk),
    .rst(rst),
    .start_valid(skin_start_valid),
    .start_palette(skin_start_palette),
    .start_joints(skin_start_joints),
    .start_influences(skin_start_influences),
    .start_rows(skin_start_rows),
    .start_rest(skin_start_rest),
    .start_vertices(skin_start_vertices),
    .start_target(skin_start_target),
    .start_ready(skinner_start_ready),
    .may_start(~some_under_way & ~sweeping),
    .vertex_request_ready(vertex_request_ready),
    .vertex_request_valid(skinner_vertex_request_valid),
    .vertex_request_address(skinner_vertex_request_address),
    .vertex_request_tag(skinner_vertex_request_tag),
    .vertex_response_valid(skinner_vertex_response_valid),
    .vertex_response_tag(vertex_response_tag[3:0]),
    .vertex_response_data(vertex_response_data),
    .influence_request_ready(influence_request_ready),
    .influence_request_valid(skinner_influence_request_valid),
    .influence_request_address(skinner_influence_request_address),
    .influence_request_tag(skinner_influence_request_tag),
    .influence_response_valid(influence_response_valid),
    .influence_response_tag(influence_response_tag),
    .influence_response_data(influence_response_data),
    .write_ready(skin_write_ready),
    .write_valid(skinner_write_valid),
    .write_address(skinner_write_address),
    .write_data(skinner_write_data),
    .weighted_valid(intersection_skin_weighted_valid),
    .weighted_position(intersection_skin_weighted_position),
    .weighted_last(intersection_skin_weighted_last),
    .weighted_x(intersection_skin_weighted_x),
    .weighted_y(intersection_skin_weighted_y),
    .weighted_z(intersection_skin_weighted_z),
    .pair_sum_x(intersection_skin_pair_sum_x),
    .pair_sum_y(intersection_skin_pair_sum_y),
    .pair_sum_z(intersection_skin_pair_sum_z),
    .vertex_sum_x(intersection_skin_vertex_sum_x),
    .vertex_sum_y(intersection_skin_vertex_sum_y),
    .vertex_sum_z(intersection_skin_vertex_sum_z),
    .skinning(skinner_skinning),
    .palette_valid(skinner_palette_valid),
    .palette_joint(skinner_palette_joint),
    .palette_column(skinner_palette_column),
    .palette_data(skinner_palette_data),
    .issue_valid(skinner_issue_valid),
    .issue_joint(skinner_issue_joint),
    .issue_x(skinner_issue_x),
    .issue_y(skinner_issue_y),
    .issue_z(skinner_issue_z),
    .issue_weight(skinner_issue_weight),
    .issue_position(skinner_issue_position),
    .issue_last(skinner_issue_last),
    .pair_a_x(skinner_pair_a_x),
    .pair_b_x(skinner_pair_b_x),
    .pair_a_y(skinner_pair_a_y),
    .pair_b_y(skinner_pair_b_y),
    .pair_a_z(skinner_pair_a_z),
    .pair_b_z(skinner_pair_b_z),
    .vertex_a_x(skinner_vertex_a_x),
    .vertex_b_x(skinner_vertex_b_x),
    .vertex_a_y(skinner_vertex_a_y),
    .vertex_b_y(skinner_vertex_b_y),
    .vertex_a_z(skinner_vertex_a_z),
    .vertex_b_z(skinner_vertex_b_z),
    .done(skinner_done),
    .influence_issued(skinner_influence_issued)
  );

  assign skinning_now = skinner_skinning;
  assign skin_palette_valid = skinner_palette_valid;
  assign skin_palette_joint = skinner_palette_joint;
  assign skin_palette_column = skinner_palette_column;
  assign skin_palette_data = skinner_palette_data;
  assign skin_issue_valid = skinner_issue_valid;
  assign skin_issue_position = skinner_issue_position;
  assign skin_issue_last = skinner_issue_last;
  assign skin_issue_joint = skinner_issue_joint;
  assign skin_issue_x = skinner_issue_x;
  assign skin_issue_y = skinner_issue_y;
  assign skin_issue_z = skinner_issue_z;
  assign skin_issue_weight = skinner_issue_weight;
  assign skin_pair_a_x = skinner_pair_a_x;
  assign skin_pair_b_x = skinner_pair_b_x;
  assign skin_pair_a_y = skinner_pair_a_y;
  assign skin_pair_b_y = skinner_pair_b_y;
  assign skin_pair_a_z = skinner_pair_a_z;
  assign skin_pair_b_z = skinner_pair_b_z;
  assign skin_vertex_a_x = skinner_vertex_a_x;
  assign skin_vertex_b_x = skinner_vertex_b_x;
  assign skin_vertex_a_y = skinner_vertex_a_y;
  assign skin_vertex_b_y = skinner_vertex_b_y;
  assign skin_vertex_a_z = skinner_vertex_a_z;
  assign skin_vertex_b_z = skinner_vertex_b_z;
  assign vertex_request_valid =
      skinning_now ? skinner_vertex_request_valid :
      intersection_vertex_request_valid;
  assign vertex_request_address =
      skinning_now ? skinner_vertex_request_address :
      intersection_vertex_request_address;
  assign vertex_request_tag =
      skinning_now ? {5'd0, skinner_vertex_request_tag} :
      intersection_vertex_request_tag;

  // Counters since reset.
  reg  [39:0] cycles_counter;
  reg  [39:0] packet_steps_counter;
  reg  [39:0] ray_triangle_tests_counter;
  reg  [39:0] tpu_busy_cycles_counter;
  reg  [39:0] tpu_starved_cycles_counter;
  reg  [39:0] ray_transforms_counter;
  reg  [39:0] gu_busy_cycles_counter;
  reg  [39:0] gu_starved_cycles_counter;
  reg  [39:0] skin_influences_counter;
  reg  [39:0] skin_cycles_counter;

  always @(posedge clk) begin
    if (rst) cycles_counter <= 40'd0; else cycles_counter <= cycles_counter + 40'd1;
    if (rst) packet_steps_counter <= 40'd0; else if (traversal_step_taken) packet_steps_counter <= packet_steps_counter + 40'd1;
    if (rst) ray_triangle_tests_counter <= 40'd0; else if (intersection_test_issued) ray_triangle_tests_counter <= ray_triangle_tests_counter + 40'd1;
    if (rst) tpu_busy_cycles_counter <= 40'd0; else if (traversal_step_taken) tpu_busy_cycles_counter <= tpu_busy_cycles_counter + 40'd1;
    if (rst) tpu_starved_cycles_counter <= 40'd0; else if (some_under_way & ~traversal_step_taken) tpu_starved_cycles_counter <= tpu_starved_cycles_counter + 40'd1;
    if (rst) ray_transforms_counter <= 40'd0; else if (intersection_transform_issued) ray_transforms_counter <= ray_transforms_counter + 40'd1;
    if (rst) gu_busy_cycles_counter <= 40'd0; else if (intersection_slot_taken) gu_busy_cycles_counter <= gu_busy_cycles_counter + 40'd1;
    if (rst) gu_starved_cycles_counter <= 40'd0; else if (some_under_way & ~intersection_slot_taken) gu_starved_cycles_counter <= gu_starved_cycles_counter + 40'd1;
    if (rst) skin_influences_counter <= 40'd0; else if (skinner_influence_issued) skin_influences_counter <= skin_influences_counter + 40'd1;
    if (rst) skin_cycles_counter <= 40'd0; else if (skinning_now) skin_cycles_counter <= skin_cycles_counter + 40'd1;
  end

  wire [15:0] tag_memory_read1 = tag_memory_copy1[free_queue_front];

  // Memories.
  always @(posedge clk) begin
    if (tag_memory_write_enable) tag_memory_copy0[free_queue_front] <= ray_tag;
  end

  always @(posedge clk) begin
    if (tag_memory_write_enable) tag_memory_copy1[free_queue_front] <= ray_tag;
  end

  assign ray_ready = ready;
  assign hit_valid = shown;
  assign hit_t = out_touched ? intersection_read_t : 24'h7f0000;
  assign hit_u = out_touched ? intersection_read_u : 24'd0;
  assign hit_v = out_touched ? intersection_read_v : 24'd0;
  assign hit_instance = out_touched ? intersection_read_instance : 32'hffffffff;
  assign hit_triangle = out_touched ? intersection_read_triangle : 32'hffffffff;
  assign node_request_valid = traversal_node_request_valid;
  assign node_request_address = traversal_node_request_address;
  assign node_request_tag = traversal_node_request_tag;
  assign record_request_valid = intersection_record_request_valid;
  assign record_request_address = intersection_record_request_address;
  assign record_request_tag = intersection_record_request_tag;
  assign influence_request_valid = skinner_influence_request_valid;
  assign influence_request_address = skinner_influence_request_address;
  assign influence_request_tag = skinner_influence_request_tag;
  assign skin_start_ready = skinner_start_ready;
  assign skin_write_valid = skinner_write_valid;
  assign skin_write_address = skinner_write_address;
  assign skin_write_data = skinner_write_data;
  assign skin_done = skinner_done;
  assign count_cycles = cycles_counter;
  assign count_packet_steps = packet_steps_counter;
  assign count_ray_triangle_tests = ray_triangle_tests_counter;
  assign count_tpu_busy_cycles = tpu_busy_cycles_counter;
  assign count_tpu_starved_cycles = tpu_starved_cycles_counter;
  assign count_ray_transforms = ray_transforms_counter;
  assign count_gu_busy_cycles = gu_busy_cycles_counter;
  assign count_gu_starved_cycles = gu_starved_cycles_counter;
  assign count_skin_influences = skin_influences_counter;
  assign count_skin_cycles = skin_cycles_counter;
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
  assign watch_test_instance = intersection_watch_test_instance;
  assign watch_test_hit = intersection_watch_test_hit;
  assign watch_test_replaces = intersection_watch_test_replaces;
  assign watch_test_t = intersection_watch_test_t;
  assign watch_test_u = intersection_watch_test_u;
  assign watch_test_v = intersection_watch_test_v;
  assign watch_transform_valid = intersection_watch_transform_valid;
  assign watch_transform_packet = intersection_watch_transform_packet;
  assign watch_transform_ray = intersection_watch_transform_ray;
  assign watch_transform_record = intersection_watch_transform_record;
  assign watch_transform_near = intersection_watch_transform_near;
  assign watch_transform_far = intersection_watch_transform_far;
  assign watch_transform_origin_x = intersection_watch_transform_origin_x;
  assign watch_transform_origin_y = intersection_watch_transform_origin_y;
  assign watch_transform_origin_z = intersection_watch_transform_origin_z;
  assign watch_transform_direction_x = intersection_watch_transform_direction_x;
  assign watch_transform_direction_y = intersection_watch_transform_direction_y;
  assign watch_transform_direction_z = intersection_watch_transform_direction_z;

endmodule

`default_nettype wire
