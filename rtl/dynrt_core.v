// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_core: the core: ray casting and update of the tree. Units work independently; what may not
// overlap is for whoever starts them to see to.

`default_nettype none

module dynrt_core (
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
  output wire [23:0]  watch_transform_direction_z,

  // Update processor. An update: rows of its program, bases of the object's vertices and nodes, index of its box
  input  wire         update_start_valid,
  input  wire [21:0]  update_start_program,
  input  wire [21:0]  update_start_rows,
  input  wire [21:0]  update_start_vertex_base,
  input  wire [21:0]  update_start_node_base,
  input  wire [21:0]  update_start_box_index,
  output wire         update_start_ready,

  // Update processor. Program memory: requests
  input  wire         update_program_request_ready,
  output wire         update_program_request_valid,
  output wire [21:0]  update_program_request_address,
  output wire [2:0]   update_program_request_tag,

  // Update processor. Program memory: answers, of any latency, in any order
  input  wire         update_program_response_valid,
  input  wire [2:0]   update_program_response_tag,
  input  wire [127:0] update_program_response_data,

  // Update processor. Vertex memory: requests
  input  wire         update_vertex_request_ready,
  output wire         update_vertex_request_valid,
  output wire [21:0]  update_vertex_request_address,
  output wire [3:0]   update_vertex_request_tag,

  // Update processor. Vertex memory: answers, of any latency, in any order
  input  wire         update_vertex_response_valid,
  input  wire [3:0]   update_vertex_response_tag,
  input  wire [71:0]  update_vertex_response_data,

  // Update processor. Node memory: writes
  input  wire         update_node_write_ready,
  output wire         update_node_write_valid,
  output wire [21:0]  update_node_write_address,
  output wire [4:0]   update_node_write_mask,
  output wire [127:0] update_node_write_data,

  // Update processor. The object's box: its write, after all of the nodes'
  input  wire         update_box_write_ready,
  output wire         update_box_write_valid,
  output wire [21:0]  update_box_write_address,
  output wire [143:0] update_box_write_data,

  // Update processor. High for a clock when an update is complete
  output wire         update_done,

  // Update processor. Counters since reset
  output wire [39:0]  update_count_instructions,
  output wire [39:0]  update_count_busy_cycles,
  output wire [39:0]  update_count_stalled_cycles,
  output wire [39:0]  update_count_vertex_wait_cycles,
  output wire [39:0]  update_count_node_wait_cycles
);

  wire casting_ray_ready;
  wire casting_hit_valid;
  wire [15:0] casting_hit_tag;
  wire [23:0] casting_hit_t;
  wire [23:0] casting_hit_u;
  wire [23:0] casting_hit_v;
  wire [31:0] casting_hit_instance;
  wire [31:0] casting_hit_triangle;
  wire casting_node_request_valid;
  wire [21:0] casting_node_request_address;
  wire [6:0] casting_node_request_tag;
  wire casting_record_request_valid;
  wire [21:0] casting_record_request_address;
  wire [6:0] casting_record_request_tag;
  wire casting_vertex_request_valid;
  wire [21:0] casting_vertex_request_address;
  wire [8:0] casting_vertex_request_tag;
  wire casting_influence_request_valid;
  wire [21:0] casting_influence_request_address;
  wire [2:0] casting_influence_request_tag;
  wire casting_skin_start_ready;
  wire casting_skin_write_valid;
  wire [21:0] casting_skin_write_address;
  wire [71:0] casting_skin_write_data;
  wire casting_skin_done;
  wire [39:0] casting_count_cycles;
  wire [39:0] casting_count_packet_steps;
  wire [39:0] casting_count_ray_triangle_tests;
  wire [39:0] casting_count_tpu_busy_cycles;
  wire [39:0] casting_count_tpu_starved_cycles;
  wire [39:0] casting_count_ray_transforms;
  wire [39:0] casting_count_gu_busy_cycles;
  wire [39:0] casting_count_gu_starved_cycles;
  wire [39:0] casting_count_skin_influences;
  wire [39:0] casting_count_skin_cycles;
  wire [5:0] casting_stack_high_water;
  wire casting_stack_overflow;
  wire casting_watch_start_valid;
  wire [5:0] casting_watch_start_packet;
  wire [15:0] casting_watch_start_tag;
  wire casting_watch_step_valid;
  wire [5:0] casting_watch_step_packet;
  wire [21:0] casting_watch_step_node;
  wire [3:0] casting_watch_step_left;
  wire [3:0] casting_watch_step_right;
  wire casting_watch_step_left_first;
  wire [191:0] casting_watch_step_left_intervals;
  wire [191:0] casting_watch_step_right_intervals;
  wire casting_watch_test_valid;
  wire [5:0] casting_watch_test_packet;
  wire [1:0] casting_watch_test_ray;
  wire [21:0] casting_watch_test_record;
  wire [31:0] casting_watch_test_instance;
  wire casting_watch_test_hit;
  wire casting_watch_test_replaces;
  wire [23:0] casting_watch_test_t;
  wire [23:0] casting_watch_test_u;
  wire [23:0] casting_watch_test_v;
  wire casting_watch_transform_valid;
  wire [5:0] casting_watch_transform_packet;
  wire [1:0] casting_watch_transform_ray;
  wire [21:0] casting_watch_transform_record;
  wire [23:0] casting_watch_transform_near;
  wire [23:0] casting_watch_transform_far;
  wire [23:0] casting_watch_transform_origin_x;
  wire [23:0] casting_watch_transform_origin_y;
  wire [23:0] casting_watch_transform_origin_z;
  wire [23:0] casting_watch_transform_direction_x;
  wire [23:0] casting_watch_transform_direction_y;
  wire [23:0] casting_watch_transform_direction_z;
  dynrt_raycast_unit casting (
    .clk(clk),
    .rst(rst),
    .scene_root(scene_root),
    .scene_lo_x(scene_lo_x),
    .scene_lo_y(scene_lo_y),
    .scene_lo_z(scene_lo_z),
    .scene_hi_x(scene_hi_x),
    .scene_hi_y(scene_hi_y),
    .scene_hi_z(scene_hi_z),
    .ray_valid(ray_valid),
    .ray_tag(ray_tag),
    .ray_origin_x(ray_origin_x),
    .ray_origin_y(ray_origin_y),
    .ray_origin_z(ray_origin_z),
    .ray_direction_x(ray_direction_x),
    .ray_direction_y(ray_direction_y),
    .ray_direction_z(ray_direction_z),
    .ray_tmin(ray_tmin),
    .ray_tmax(ray_tmax),
    .ray_active(ray_active),
    .ray_any_hit(ray_any_hit),
    .ray_ready(casting_ray_ready),
    .hit_ready(hit_ready),
    .hit_valid(casting_hit_valid),
    .hit_tag(casting_hit_tag),
    .hit_t(casting_hit_t),
    .hit_u(casting_hit_u),
    .hit_v(casting_hit_v),
    .hit_instance(casting_hit_instance),
    .hit_triangle(casting_hit_triangle),
    .node_request_ready(node_request_ready),
    .node_request_valid(casting_node_request_valid),
    .node_request_address(casting_node_request_address),
    .node_request_tag(casting_node_request_tag),
    .node_response_valid(node_response_valid),
    .node_response_tag(node_response_tag),
    .node_response_data(node_response_data),
    .record_request_ready(record_request_ready),
    .record_request_valid(casting_record_request_valid),
    .record_request_address(casting_record_request_address),
    .record_request_tag(casting_record_request_tag),
    .record_response_valid(record_response_valid),
    .record_response_tag(record_response_tag),
    .record_response_data(record_response_data),
    .vertex_request_ready(vertex_request_ready),
    .vertex_request_valid(casting_vertex_request_valid),
    .vertex_request_address(casting_vertex_request_address),
    .vertex_request_tag(casting_vertex_request_tag),
    .vertex_response_valid(vertex_response_valid),
    .vertex_response_tag(vertex_response_tag),
    .vertex_response_data(vertex_response_data),
    .influence_request_ready(influence_request_ready),
    .influence_request_valid(casting_influence_request_valid),
    .influence_request_address(casting_influence_request_address),
    .influence_request_tag(casting_influence_request_tag),
    .influence_response_valid(influence_response_valid),
    .influence_response_tag(influence_response_tag),
    .influence_response_data(influence_response_data),
    .skin_start_valid(skin_start_valid),
    .skin_start_palette(skin_start_palette),
    .skin_start_joints(skin_start_joints),
    .skin_start_influences(skin_start_influences),
    .skin_start_rows(skin_start_rows),
    .skin_start_rest(skin_start_rest),
    .skin_start_vertices(skin_start_vertices),
    .skin_start_target(skin_start_target),
    .skin_start_ready(casting_skin_start_ready),
    .skin_write_ready(skin_write_ready),
    .skin_write_valid(casting_skin_write_valid),
    .skin_write_address(casting_skin_write_address),
    .skin_write_data(casting_skin_write_data),
    .skin_done(casting_skin_done),
    .count_cycles(casting_count_cycles),
    .count_packet_steps(casting_count_packet_steps),
    .count_ray_triangle_tests(casting_count_ray_triangle_tests),
    .count_tpu_busy_cycles(casting_count_tpu_busy_cycles),
    .count_tpu_starved_cycles(casting_count_tpu_starved_cycles),
    .count_ray_transforms(casting_count_ray_transforms),
    .count_gu_busy_cycles(casting_count_gu_busy_cycles),
    .count_gu_starved_cycles(casting_count_gu_starved_cycles),
    .count_skin_influences(casting_count_skin_influences),
    .count_skin_cycles(casting_count_skin_cycles),
    .stack_high_water(casting_stack_high_water),
    .stack_overflow(casting_stack_overflow),
    .watch_start_valid(casting_watch_start_valid),
    .watch_start_packet(casting_watch_start_packet),
    .watch_start_tag(casting_watch_start_tag),
    .watch_step_valid(casting_watch_step_valid),
    .watch_step_packet(casting_watch_step_packet),
    .watch_step_node(casting_watch_step_node),
    .watch_step_left(casting_watch_step_left),
    .watch_step_right(casting_watch_step_right),
    .watch_step_left_first(casting_watch_step_left_first),
    .watch_step_left_intervals(casting_watch_step_left_intervals),
    .watch_step_right_intervals(casting_watch_step_right_intervals),
    .watch_test_valid(casting_watch_test_valid),
    .watch_test_packet(casting_watch_test_packet),
    .watch_test_ray(casting_watch_test_ray),
    .watch_test_record(casting_watch_test_record),
    .watch_test_instance(casting_watch_test_instance),
    .watch_test_hit(casting_watch_test_hit),
    .watch_test_replaces(casting_watch_test_replaces),
    .watch_test_t(casting_watch_test_t),
    .watch_test_u(casting_watch_test_u),
    .watch_test_v(casting_watch_test_v),
    .watch_transform_valid(casting_watch_transform_valid),
    .watch_transform_packet(casting_watch_transform_packet),
    .watch_transform_ray(casting_watch_transform_ray),
    .watch_transform_record(casting_watch_transform_record),
    .watch_transform_near(casting_watch_transform_near),
    .watch_transform_far(casting_watch_transform_far),
    .watch_transform_origin_x(casting_watch_transform_origin_x),
    .watch_transform_origin_y(casting_watch_transform_origin_y),
    .watch_transform_origin_z(casting_watch_transform_origin_z),
    .watch_transform_direction_x(casting_watch_transform_direction_x),
    .watch_transform_direction_y(casting_watch_transform_direction_y),
    .watch_transform_direction_z(casting_watch_transform_direction_z)
  );

  wire updating_start_ready;
  wire updating_program_request_valid;
  wire [21:0] updating_program_request_address;
  wire [2:0] updating_program_request_tag;
  wire updating_vertex_request_valid;
  wire [21:0] updating_vertex_request_address;
  wire [3:0] updating_vertex_request_tag;
  wire updating_node_write_valid;
  wire [21:0] updating_node_write_address;
  wire [4:0] updating_node_write_mask;
  wire [127:0] updating_node_write_data;
  wire updating_box_write_valid;
  wire [21:0] updating_box_write_address;
  wire [143:0] updating_box_write_data;
  wire updating_done;
  wire [39:0] updating_count_instructions;
  wire [39:0] updating_count_busy_cycles;
  wire [39:0] updating_count_stalled_cycles;
  wire [39:0] updating_count_vertex_wait_cycles;
  wire [39:0] updating_count_node_wait_cycles;
  dynrt_update_processor updating (
    .clk(clk),
    .rst(rst),
    .start_valid(update_start_valid),
    .start_program(update_start_program),
    .start_rows(update_start_rows),
    .start_vertex_base(update_start_vertex_base),
    .start_node_base(update_start_node_base),
    .start_box_index(update_start_box_index),
    .start_ready(updating_start_ready),
    .program_request_ready(update_program_request_ready),
    .program_request_valid(updating_program_request_valid),
    .program_request_address(updating_program_request_address),
    .program_request_tag(updating_program_request_tag),
    .program_response_valid(update_program_response_valid),
    .program_response_tag(update_program_response_tag),
    .program_response_data(update_program_response_data),
    .vertex_request_ready(update_vertex_request_ready),
    .vertex_request_valid(updating_vertex_request_valid),
    .vertex_request_address(updating_vertex_request_address),
    .vertex_request_tag(updating_vertex_request_tag),
    .vertex_response_valid(update_vertex_response_valid),
    .vertex_response_tag(update_vertex_response_tag),
    .vertex_response_data(update_vertex_response_data),
    .node_write_ready(update_node_write_ready),
    .node_write_valid(updating_node_write_valid),
    .node_write_address(updating_node_write_address),
    .node_write_mask(updating_node_write_mask),
    .node_write_data(updating_node_write_data),
    .box_write_ready(update_box_write_ready),
    .box_write_valid(updating_box_write_valid),
    .box_write_address(updating_box_write_address),
    .box_write_data(updating_box_write_data),
    .done(updating_done),
    .count_instructions(updating_count_instructions),
    .count_busy_cycles(updating_count_busy_cycles),
    .count_stalled_cycles(updating_count_stalled_cycles),
    .count_vertex_wait_cycles(updating_count_vertex_wait_cycles),
    .count_node_wait_cycles(updating_count_node_wait_cycles)
  );

  assign ray_ready = casting_ray_ready;
  assign hit_valid = casting_hit_valid;
  assign hit_tag = casting_hit_tag;
  assign hit_t = casting_hit_t;
  assign hit_u = casting_hit_u;
  assign hit_v = casting_hit_v;
  assign hit_instance = casting_hit_instance;
  assign hit_triangle = casting_hit_triangle;
  assign node_request_valid = casting_node_request_valid;
  assign node_request_address = casting_node_request_address;
  assign node_request_tag = casting_node_request_tag;
  assign record_request_valid = casting_record_request_valid;
  assign record_request_address = casting_record_request_address;
  assign record_request_tag = casting_record_request_tag;
  assign vertex_request_valid = casting_vertex_request_valid;
  assign vertex_request_address = casting_vertex_request_address;
  assign vertex_request_tag = casting_vertex_request_tag;
  assign influence_request_valid = casting_influence_request_valid;
  assign influence_request_address = casting_influence_request_address;
  assign influence_request_tag = casting_influence_request_tag;
  assign skin_start_ready = casting_skin_start_ready;
  assign skin_write_valid = casting_skin_write_valid;
  assign skin_write_address = casting_skin_write_address;
  assign skin_write_data = casting_skin_write_data;
  assign skin_done = casting_skin_done;
  assign count_cycles = casting_count_cycles;
  assign count_packet_steps = casting_count_packet_steps;
  assign count_ray_triangle_tests = casting_count_ray_triangle_tests;
  assign count_tpu_busy_cycles = casting_count_tpu_busy_cycles;
  assign count_tpu_starved_cycles = casting_count_tpu_starved_cycles;
  assign count_ray_transforms = casting_count_ray_transforms;
  assign count_gu_busy_cycles = casting_count_gu_busy_cycles;
  assign count_gu_starved_cycles = casting_count_gu_starved_cycles;
  assign count_skin_influences = casting_count_skin_influences;
  assign count_skin_cycles = casting_count_skin_cycles;
  assign stack_high_water = casting_stack_high_water;
  assign stack_overflow = casting_stack_overflow;
  assign watch_start_valid = casting_watch_start_valid;
  assign watch_start_packet = casting_watch_start_packet;
  assign watch_start_tag = casting_watch_start_tag;
  assign watch_step_valid = casting_watch_step_valid;
  assign watch_step_packet = casting_watch_step_packet;
  assign watch_step_node = casting_watch_step_node;
  assign watch_step_left = casting_watch_step_left;
  assign watch_step_right = casting_watch_step_right;
  assign watch_step_left_first = casting_watch_step_left_first;
  assign watch_step_left_intervals = casting_watch_step_left_intervals;
  assign watch_step_right_intervals = casting_watch_step_right_intervals;
  assign watch_test_valid = casting_watch_test_valid;
  assign watch_test_packet = casting_watch_test_packet;
  assign watch_test_ray = casting_watch_test_ray;
  assign watch_test_record = casting_watch_test_record;
  assign watch_test_instance = casting_watch_test_instance;
  assign watch_test_hit = casting_watch_test_hit;
  assign watch_test_replaces = casting_watch_test_replaces;
  assign watch_test_t = casting_watch_test_t;
  assign watch_test_u = casting_watch_test_u;
  assign watch_test_v = casting_watch_test_v;
  assign watch_transform_valid = casting_watch_transform_valid;
  assign watch_transform_packet = casting_watch_transform_packet;
  assign watch_transform_ray = casting_watch_transform_ray;
  assign watch_transform_record = casting_watch_transform_record;
  assign watch_transform_near = casting_watch_transform_near;
  assign watch_transform_far = casting_watch_transform_far;
  assign watch_transform_origin_x = casting_watch_transform_origin_x;
  assign watch_transform_origin_y = casting_watch_transform_origin_y;
  assign watch_transform_origin_z = casting_watch_transform_origin_z;
  assign watch_transform_direction_x = casting_watch_transform_direction_x;
  assign watch_transform_direction_y = casting_watch_transform_direction_y;
  assign watch_transform_direction_z = casting_watch_transform_direction_z;
  assign update_start_ready = updating_start_ready;
  assign update_program_request_valid = updating_program_request_valid;
  assign update_program_request_address = updating_program_request_address;
  assign update_program_request_tag = updating_program_request_tag;
  assign update_vertex_request_valid = updating_vertex_request_valid;
  assign update_vertex_request_address = updating_vertex_request_address;
  assign update_vertex_request_tag = updating_vertex_request_tag;
  assign update_node_write_valid = updating_node_write_valid;
  assign update_node_write_address = updating_node_write_address;
  assign update_node_write_mask = updating_node_write_mask;
  assign update_node_write_data = updating_node_write_data;
  assign update_box_write_valid = updating_box_write_valid;
  assign update_box_write_address = updating_box_write_address;
  assign update_box_write_data = updating_box_write_data;
  assign update_done = updating_done;
  assign update_count_instructions = updating_count_instructions;
  assign update_count_busy_cycles = updating_count_busy_cycles;
  assign update_count_stalled_cycles = updating_count_stalled_cycles;
  assign update_count_vertex_wait_cycles = updating_count_vertex_wait_cycles;
  assign update_count_node_wait_cycles = updating_count_node_wait_cycles;

endmodule

`default_nettype wire
