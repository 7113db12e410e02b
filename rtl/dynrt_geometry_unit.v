// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_geometry_unit: the geometry unit: a leaf's triangle and vertices are fetched, the packet's rays
// tested one a clock, the hits merged.

`default_nettype none

module dynrt_geometry_unit (
  input  wire         clk,
  input  wire         rst,

  // A ray that has been set up, of the world or in an object's space
  input  wire         setup_valid,
  input  wire [5:0]   setup_packet,
  input  wire [1:0]   setup_ray,
  input  wire         setup_object,
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

  // The packet of the ray that will have been set up so many clocks later as a memory's read takes
  input  wire [5:0]   setup_next_packet,

  // Whether leaves in the world are instances of objects: bit right_leaf of the scene's root
  input  wire         instanced,

  // Leaves from the traversal unit
  input  wire         leaf_valid,
  input  wire [5:0]   leaf_packet,
  input  wire [21:0]  leaf_address,
  input  wire [10:0]  leaf_context,
  input  wire [3:0]   leaf_mask,
  output wire         leaf_ready,

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

  // Skinning: whether it borrows this unit
  input  wire         skinning,

  // Skinning: a column of a joint's matrix
  input  wire         skin_palette_valid,
  input  wire [7:0]   skin_palette_joint,
  input  wire [1:0]   skin_palette_column,
  input  wire [71:0]  skin_palette_data,

  // Skinning: an influence, and which of its vertex's it is
  input  wire         skin_issue_valid,
  input  wire [1:0]   skin_issue_position,
  input  wire         skin_issue_last,
  input  wire [7:0]   skin_issue_joint,
  input  wire [23:0]  skin_issue_x,
  input  wire [23:0]  skin_issue_y,
  input  wire [23:0]  skin_issue_z,
  input  wire [23:0]  skin_issue_weight,

  // Skinning: numbers to add
  input  wire [23:0]  skin_pair_a_x,
  input  wire [23:0]  skin_pair_b_x,
  input  wire [23:0]  skin_pair_a_y,
  input  wire [23:0]  skin_pair_b_y,
  input  wire [23:0]  skin_pair_a_z,
  input  wire [23:0]  skin_pair_b_z,
  input  wire [23:0]  skin_vertex_a_x,
  input  wire [23:0]  skin_vertex_b_x,
  input  wire [23:0]  skin_vertex_a_y,
  input  wire [23:0]  skin_vertex_b_y,
  input  wire [23:0]  skin_vertex_a_z,
  input  wire [23:0]  skin_vertex_b_z,

  // After reset, packet numbers in turn, to clear what counts by packet
  input  wire         sweep,
  input  wire [5:0]   sweep_packet,

  // Closest hits are read by packet and ray; the word is there a clock later
  input  wire [5:0]   read_packet,
  input  wire [1:0]   read_ray,

  // A ray of the world as it comes: the watertight test needs its direction for transformations alone
  input  wire         world_valid,
  input  wire [5:0]   world_packet,
  input  wire [1:0]   world_ray,
  input  wire [23:0]  world_direction_x,
  input  wire [23:0]  world_direction_y,
  input  wire [23:0]  world_direction_z,
  input  wire [23:0]  setup_shear_z,

  // Skinning: an influence's vertex moved and weighted, and which of its vertex's it is
  output wire         skin_weighted_valid,
  output wire [1:0]   skin_weighted_position,
  output wire         skin_weighted_last,
  output wire [23:0]  skin_weighted_x,
  output wire [23:0]  skin_weighted_y,
  output wire [23:0]  skin_weighted_z,

  // Skinning: sums
  output wire [23:0]  skin_pair_sum_x,
  output wire [23:0]  skin_pair_sum_y,
  output wire [23:0]  skin_pair_sum_z,
  output wire [23:0]  skin_vertex_sum_x,
  output wire [23:0]  skin_vertex_sum_y,
  output wire [23:0]  skin_vertex_sum_z,

  // A ray in an object's space, to be set up; its interval comes as tmin and tmax
  output wire         object_valid,
  output wire [5:0]   object_packet,
  output wire [1:0]   object_ray,
  output wire         object_first,
  output wire         object_last,
  output reg  [23:0]  object_origin_x,
  output reg  [23:0]  object_origin_y,
  output reg  [23:0]  object_origin_z,
  output reg  [23:0]  object_direction_x,
  output reg  [23:0]  object_direction_y,
  output reg  [23:0]  object_direction_z,
  output reg  [23:0]  object_tmin,
  output reg  [23:0]  object_tmax,

  // Where the packet announced by setup_next_packet starts in its object, when its ray has been set up
  output wire [21:0]  start_address,
  output wire         start_leaf,
  output wire [10:0]  start_context,

  // A closer hit of a ray: what its near must not exceed from now on
  output wire         limit_valid,
  output wire [5:0]   limit_packet,
  output wire [1:0]   limit_ray,
  output wire [23:0]  limit_value,

  // A leaf all of whose tests are merged
  output wire         done_valid,
  output wire [5:0]   done_packet,
  output wire [10:0]  done_context,

  // The closest hit that was asked for, a clock or two later
  output wire [23:0]  read_t,
  output wire [23:0]  read_u,
  output wire [23:0]  read_v,
  output wire [31:0]  read_instance,
  output wire [31:0]  read_triangle,

  // Counters' events
  output wire         slot_taken,
  output wire         test_issued,
  output wire         transform_issued,

  // The ray-triangle test just merged, for whoever watches
  output wire         watch_test_valid,
  output wire [5:0]   watch_test_packet,
  output wire [1:0]   watch_test_ray,
  output reg  [21:0]  watch_test_record,
  output reg  [31:0]  watch_test_instance,
  output reg          watch_test_hit,
  output reg          watch_test_replaces,
  output reg  [23:0]  watch_test_t,
  output reg  [23:0]  watch_test_u,
  output reg  [23:0]  watch_test_v,

  // The ray just transformed, its interval in the instance's box, and the instance's record, for whoever watches
  output wire         watch_transform_valid,
  output wire [5:0]   watch_transform_packet,
  output wire [1:0]   watch_transform_ray,
  output wire [21:0]  watch_transform_record,
  output reg  [23:0]  watch_transform_near,
  output reg  [23:0]  watch_transform_far,
  output wire [23:0]  watch_transform_origin_x,
  output wire [23:0]  watch_transform_origin_y,
  output wire [23:0]  watch_transform_origin_z,
  output wire [23:0]  watch_transform_direction_x,
  output wire [23:0]  watch_transform_direction_y,
  output wire [23:0]  watch_transform_direction_z
);

  // A leaf is taken when its record can be requested. Its tag says whether it is an instance's.
  wire take_leaf = leaf_valid & record_request_ready;
  wire [32:0] leaf_data = {leaf_address, leaf_context};
  (* no_rw_check, ram_style = "block" *)
  reg  [32:0] leaf_memory_copy0 [0:47];
  (* no_rw_check, ram_style = "block" *)
  reg  [32:0] leaf_memory_copy1 [0:47];
  (* no_rw_check, ram_style = "block" *)
  reg  [32:0] leaf_memory_copy2 [0:47];
  (* no_rw_check, ram_style = "distributed" *)
  reg  [3:0] mask_memory [0:47];
  wire leaf_context_inside = leaf_context[10];
  wire leaf_is_instance = instanced & ~leaf_context_inside;
  (* no_rw_check, ram_style = "distributed" *)
  reg  instance_leaf_memory [0:47];

  // A record's answer: numbers and an instance's root are kept; three vertices, or the six vectors
  // that lie one after another, are requested one a clock.
  wire [5:0] record_response_tag_packet = record_response_tag[5:0];
  wire record_response_tag_instance = record_response_tag[6];
  wire [31:0] record_response_data_v0 = record_response_data[31:0];
  wire [31:0] record_response_data_v1 = record_response_data[63:32];
  wire [31:0] record_response_data_v2 = record_response_data[95:64];
  wire [31:0] record_response_data_number = record_response_data[127:96];
  (* no_rw_check, ram_style = "block" *)
  reg  [31:0] triangle_number_memory [0:47];
  wire triangle_number_memory_write_enable = record_response_valid & ~record_response_tag_instance;
  (* no_rw_check, ram_style = "block" *)
  reg  [31:0] instance_number_memory [0:47];
  wire instance_answer = record_response_valid & record_response_tag_instance;
  wire [25:0] record_response_data_v1_link = record_response_data_v1[25:0];
  wire record_response_data_v1_left_leaf = record_response_data_v1[26];
  wire [22:0] root_data = {record_response_data_v1_left_leaf, record_response_data_v1_link[21:0]};
  (* no_rw_check, ram_style = "block" *)
  reg  [22:0] root_memory [0:47];
  wire job_done;
  wire [72:0] vertex_queue_data = {
      record_response_data_v2[21:0],
      record_response_data_v1[21:0],
      record_response_data_v0[21:0],
      record_response_tag
    };

  wire vertex_queue_valid;
  wire [72:0] vertex_queue_front;
  dynrt_block_fifo_73x48 vertex_queue (
    .clk(clk),
    .rst(rst),
    .push(record_response_valid),
    .data(vertex_queue_data),
    .pop(job_done),
    .valid(vertex_queue_valid),
    .front(vertex_queue_front)
  );

  reg  [2:0] corner;
  wire vertex_fire = vertex_queue_valid & vertex_request_ready;
  wire [5:0] vertex_queue_front_packet = vertex_queue_front[5:0];
  wire vertex_queue_front_instance = vertex_queue_front[6];
  wire [21:0] vertex_queue_front_v0 = vertex_queue_front[28:7];
  wire [21:0] vertex_queue_front_v1 = vertex_queue_front[50:29];
  wire [21:0] vertex_queue_front_v2 = vertex_queue_front[72:51];
  wire last_corner = corner == (vertex_queue_front_instance ? 3'd5 : 3'd2);

  always @(posedge clk) begin
    if (rst) corner <= 3'd0; else if (vertex_fire) corner <= last_corner ? 3'd0 : (corner + 3'd1);
  end

  assign job_done = vertex_fire & last_corner;
  wire [21:0] vector_address = vertex_queue_front_v0 + {19'd0, corner};
  wire [21:0] vertex_address =
      (corner[1:0] == 2'd0) ? vertex_queue_front_v0 :
      (corner[1:0] == 2'd1) ? vertex_queue_front_v1 :
      vertex_queue_front_v2;

  // Vertices and vectors arrive in any order; the last one to come makes the leaf complete.
  wire [2:0] vertex_response_tag_number = vertex_response_tag[2:0];
  wire [5:0] vertex_response_tag_packet = vertex_response_tag[8:3];
  wire [71:0] vector_data = skinning ? skin_palette_data : vertex_response_data;
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex0_memory [0:511];
  wire [7:0] vertex0_memory_place =
      skinning ? skin_palette_joint :
      {1'b0, vertex_response_tag_number[2], vertex_response_tag_packet};
  wire vertex0_memory_takes_it =
      vertex_response_valid &
      ((vertex_response_tag_number == 3'd0) | (vertex_response_tag_number == 3'd4));
  wire vertex0_memory_write_enable =
      skinning ? (skin_palette_valid & (skin_palette_column == 2'd0)) :
      vertex0_memory_takes_it;
  wire [8:0] vertex0_memory_write_address = {skinning, vertex0_memory_place};
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex1_memory [0:511];
  wire corner5_arrives = vertex_response_tag_number == 3'd5;
  wire vertex1_memory_write_enable =
      skinning ? (skin_palette_valid & (skin_palette_column == 2'd1)) :
      (vertex_response_valid & ((vertex_response_tag_number == 3'd1) | corner5_arrives));
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] vertex2_memory [0:511];
  wire vertex2_memory_write_enable =
      skinning ? (skin_palette_valid & (skin_palette_column == 2'd2)) :
      (vertex_response_valid & ((vertex_response_tag_number == 3'd2) | corner5_arrives));
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] translation_memory [0:511];
  wire translation_memory_write_enable =
      skinning ? (skin_palette_valid & (skin_palette_column == 2'd3)) :
      (vertex_response_valid & (vertex_response_tag_number == 3'd3));
  wire [8:0] translation_memory_write_address = {
      skinning,
      skinning ? skin_palette_joint : {2'd0, vertex_response_tag_packet}
    };
  (* no_rw_check, ram_style = "distributed" *)
  reg  [2:0] arrival_memory [0:47];
  wire [2:0] arrival_memory_read = arrival_memory[vertex_response_tag_packet];
  wire instance_leaf_memory_read = instance_leaf_memory[vertex_response_tag_packet];
  wire last_arrives = arrival_memory_read == (instance_leaf_memory_read ? 3'd5 : 3'd2);
  wire leaf_complete = vertex_response_valid & last_arrives;
  wire [5:0] arrival_memory_write_address = sweep ? sweep_packet : vertex_response_tag_packet;
  wire [2:0] arrival_memory_write_data =
      sweep ? 3'd0 :
      last_arrives ? 3'd0 :
      (arrival_memory_read + 3'd1);

  // The rays of a complete leaf's mask go into the test, one a clock: a ray once for a triangle,
  // three times for an instance, for its box, the direction and the origin.
  wire take_ready;

  wire ready_queue_valid;
  wire [6:0] ready_queue_front;
  dynrt_fifo_7x48 ready_queue (
    .clk(clk),
    .rst(rst),
    .push(leaf_complete),
    .data({instance_leaf_memory_read, vertex_response_tag_packet}),
    .pop(take_ready),
    .valid(ready_queue_valid),
    .front(ready_queue_front)
  );

  wire [5:0] ready_queue_front_packet = ready_queue_front[5:0];
  wire ready_queue_front_instance = ready_queue_front[6];
  wire [3:0] mask_memory_read = mask_memory[ready_queue_front_packet];
  reg  busy;
  reg  [5:0] now_packet;
  reg  now_instance;
  reg  [3:0] now_mask;
  reg  now_first;
  reg  [1:0] slot;
  wire [1:0] issue_ray =
      now_mask[0] ? 2'd0 :
      now_mask[1] ? 2'd1 :
      now_mask[2] ? 2'd2 :
      2'd3;
  wire [3:0] rest_mask = now_mask & (now_mask - 4'd1);
  wire slot_is_origin = slot == 2'd2;
  wire last_slot = ~now_instance | slot_is_origin;
  wire now_last = last_slot & (~|rest_mask);
  wire takes_next = ~busy | now_last;
  wire takes = takes_next & ready_queue_valid;
  assign take_ready = takes;

  always @(posedge clk) begin
    if (rst) busy <= 1'b0; else busy <= takes_next ? ready_queue_valid : 1'b1;
    if (takes) now_packet <= ready_queue_front_packet;
    if (takes) now_instance <= ready_queue_front_instance;
  end

  wire next_ray = takes | last_slot;

  always @(posedge clk) begin
    if (next_ray) now_mask <= takes ? mask_memory_read : rest_mask;
    if (next_ray) now_first <= takes;
    slot <= next_ray ? 2'd0 : (slot + 2'd1);
  end

  wire transforming = busy & now_instance;

  // The test, and what it lends its operators to.
  assign test_issued = busy & ~now_instance;
  wire in_box_slot = transforming & (slot == 2'd0);
  wire in_direction_slot = transforming & (slot == 2'd1);
  wire in_origin_slot = transforming & slot_is_origin;
  wire [5:0] packet_or_joint = skinning ? skin_issue_joint[5:0] : now_packet;
  wire [1:0] joint_high = skin_issue_joint[7:6] & {2{skinning}};
  wire now_inside = instanced & ~now_instance;
  wire [7:0] setup_index = {setup_packet, setup_ray};
  wire [8:0] ray_memory_write_address = {setup_object, setup_index};
  wire setup_of_world = setup_valid & ~setup_object;
  (* no_rw_check, ram_style = "block" *)
  reg  [196:0] ray_memory [0:447];
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
  reg  [48:0] ray_limit_memory_copy0 [0:191];
  (* no_rw_check, ram_style = "block" *)
  reg  [48:0] ray_limit_memory_copy1 [0:191];
  wire [48:0] ray_limit_memory_write_data = {setup_any_hit, setup_tmax, setup_tmin};
  wire [7:0] test_index = {packet_or_joint, issue_ray};
  wire [8:0] test_level_index = {now_inside, test_index};
  reg  [196:0] ray_memory_read;
  reg  [196:0] ray_memory_read_s2;
  wire [23:0] ray_memory_read_origin_x_s2 = ray_memory_read_s2[23:0];
  wire [23:0] ray_memory_read_origin_y_s2 = ray_memory_read_s2[47:24];
  wire [23:0] ray_memory_read_origin_z_s2 = ray_memory_read_s2[71:48];
  wire [23:0] ray_memory_read_reciprocal_x_s2 = ray_memory_read_s2[95:72];
  wire [23:0] ray_memory_read_reciprocal_y_s2 = ray_memory_read_s2[119:96];
  wire [23:0] ray_memory_read_reciprocal_z_s2 = ray_memory_read_s2[143:120];
  wire [2:0] ray_memory_read_signs_s2 = ray_memory_read_s2[146:144];
  wire [1:0] ray_memory_read_kz_s2 = ray_memory_read_s2[148:147];
  wire [23:0] ray_memory_read_shear_x_s2 = ray_memory_read_s2[172:149];
  wire [23:0] ray_memory_read_shear_y_s2 = ray_memory_read_s2[196:173];
  (* no_rw_check, ram_style = "block" *)
  reg  [71:0] direction_memory [0:191];
  wire [71:0] direction_memory_write_data = {world_direction_z, world_direction_y, world_direction_x};
  reg  [71:0] direction_memory_read;
  reg  [71:0] direction_memory_read_s2;
  wire [23:0] direction_memory_read_x_s2 = direction_memory_read_s2[23:0];
  wire [23:0] direction_memory_read_y_s2 = direction_memory_read_s2[47:24];
  wire [23:0] direction_memory_read_z_s2 = direction_memory_read_s2[71:48];
  reg  [8:0] corner_index_s1;
  reg  [71:0] vertex0_memory_read;
  reg  [71:0] vertex0_memory_read_s3;
  wire [23:0] vertex0_memory_read_x_s3 = vertex0_memory_read_s3[23:0];
  wire [23:0] vertex0_memory_read_y_s3 = vertex0_memory_read_s3[47:24];
  wire [23:0] vertex0_memory_read_z_s3 = vertex0_memory_read_s3[71:48];
  reg  [71:0] vertex1_memory_read;
  reg  [71:0] vertex1_memory_read_s3;
  wire [23:0] vertex1_memory_read_x_s3 = vertex1_memory_read_s3[23:0];
  wire [23:0] vertex1_memory_read_y_s3 = vertex1_memory_read_s3[47:24];
  wire [23:0] vertex1_memory_read_z_s3 = vertex1_memory_read_s3[71:48];
  reg  [71:0] vertex2_memory_read;
  reg  [71:0] vertex2_memory_read_s3;
  wire [23:0] vertex2_memory_read_x_s3 = vertex2_memory_read_s3[23:0];
  wire [23:0] vertex2_memory_read_y_s3 = vertex2_memory_read_s3[47:24];
  wire [23:0] vertex2_memory_read_z_s3 = vertex2_memory_read_s3[71:48];
  reg  [37:0] in_direction_slot_delay;
  wire point_is_direction = in_direction_slot_delay[1];
  reg  skinning_s2;
  reg  [23:0] skin_issue_x_s1, skin_issue_x_s2;
  wire [23:0] point_x =
      skinning_s2 ? skin_issue_x_s2 :
      point_is_direction ? direction_memory_read_x_s2 :
      ray_memory_read_origin_x_s2;
  reg  [23:0] point_x_s3;
  reg  [23:0] skin_issue_y_s1, skin_issue_y_s2;
  wire [23:0] point_y =
      skinning_s2 ? skin_issue_y_s2 :
      point_is_direction ? direction_memory_read_y_s2 :
      ray_memory_read_origin_y_s2;
  reg  [23:0] point_y_s3;
  reg  [23:0] skin_issue_z_s1, skin_issue_z_s2;
  wire [23:0] point_z =
      skinning_s2 ? skin_issue_z_s2 :
      point_is_direction ? direction_memory_read_z_s2 :
      ray_memory_read_origin_z_s2;
  reg  [23:0] point_z_s3;
  reg  in_transform_slot_s1, in_transform_slot_s2;
  reg  matrix_slot_s3;
  reg  [45:0] joint_high_delay;
  wire [1:0] joint_high_s23 = joint_high_delay[45:44];
  reg  [341:0] packet_or_joint_delay;
  wire [5:0] packet_or_joint_s23 = packet_or_joint_delay[137:132];
  reg  [38:0] in_origin_slot_delay;
  wire in_origin_slot_s23 = in_origin_slot_delay[22];
  reg  translation_memory_wanted_s24;
  reg  [71:0] translation_memory_read;
  reg  [71:0] translation_memory_read_or_default_s25;
  wire [23:0] translation_memory_read_or_default_x_s25 = translation_memory_read_or_default_s25[23:0];
  wire [23:0] translation_memory_read_or_default_y_s25 = translation_memory_read_or_default_s25[47:24];
  wire [23:0] translation_memory_read_or_default_z_s25 = translation_memory_read_or_default_s25[71:48];
  (* no_rw_check, ram_style = "block" *)
  reg  [47:0] window_memory_copy0 [0:191];
  (* no_rw_check, ram_style = "block" *)
  reg  [47:0] window_memory_copy1 [0:191];
  reg  [431:0] test_index_delay;
  wire [7:0] test_index_s13 = test_index_delay[103:96];
  reg  [54:0] now_inside_delay;
  wire now_inside_s14 = now_inside_delay[13];
  reg  [47:0] window_memory_read0;
  reg  [47:0] window_memory_read0_or_default_s15;
  wire [23:0] window_memory_read0_or_default_near_s15 = window_memory_read0_or_default_s15[23:0];
  wire [23:0] window_memory_read0_or_default_far_s15 = window_memory_read0_or_default_s15[47:24];
  wire [7:0] test_index_s19 = test_index_delay[151:144];
  wire [7:0] test_index_s36 = test_index_delay[287:280];
  wire [7:0] test_index_s53 = test_index_delay[423:416];
  reg  [48:0] ray_limit_memory_read0;
  reg  [48:0] ray_limit_memory_read0_s55;
  wire [23:0] ray_limit_memory_read0_tmin_s55 = ray_limit_memory_read0_s55[23:0];
  wire [23:0] ray_limit_memory_read0_tmax_s55 = ray_limit_memory_read0_s55[47:24];
  wire ray_limit_memory_read0_any_hit_s55 = ray_limit_memory_read0_s55[48];
  (* no_rw_check, ram_style = "block" *)
  reg  [23:0] shear_memory [0:447];
  reg  [431:0] test_level_index_delay;
  wire [8:0] test_level_index_s48 = test_level_index_delay[431:423];
  reg  [23:0] shear_memory_read;
  reg  [23:0] shear_memory_read_s50;
  reg  [1127:0] skin_issue_weight_delay;
  wire [23:0] skin_issue_weight_s47 = skin_issue_weight_delay[1127:1104];
  reg  [1:0] ray_memory_read_kz_s3;
  reg  [23:0] ray_memory_read_shear_x_s3;
  reg  [23:0] ray_memory_read_shear_y_s3;
  reg  [119:0] translation_memory_read_or_default_x_delay;
  wire [23:0] translation_memory_read_or_default_x_s30 = translation_memory_read_or_default_x_delay[119:96];
  reg  [191:0] translation_memory_read_or_default_z_delay;
  wire [23:0] translation_memory_read_or_default_z_s33 = translation_memory_read_or_default_z_delay[191:168];
  reg  [23:0] ray_memory_read_reciprocal_x_s3;
  reg  [23:0] ray_memory_read_reciprocal_y_s3;
  reg  [23:0] ray_memory_read_reciprocal_z_s3;
  reg  [2:0] ray_memory_read_signs_s3;

  wire [23:0] test_sum_0;
  wire [23:0] test_sum_1;
  wire [23:0] test_sum_2;
  wire [23:0] test_sum_3;
  wire [23:0] test_sum_4;
  wire [23:0] test_sum_5;
  wire test_hit;
  wire [23:0] test_t;
  wire [23:0] test_u;
  wire [23:0] test_v;
  wire [23:0] test_moved_x;
  wire [23:0] test_moved_y;
  wire [23:0] test_moved_z;
  wire [23:0] test_weighted_x;
  wire [23:0] test_weighted_y;
  wire [23:0] test_weighted_z;
  wire [23:0] test_box_near;
  wire [23:0] test_box_far;
  dynrt_triangle_test test (
    .clk(clk),
    .matrix(matrix_slot_s3),
    .v0_x(vertex0_memory_read_x_s3),
    .v0_y(vertex0_memory_read_y_s3),
    .v0_z(vertex0_memory_read_z_s3),
    .v1_x(vertex1_memory_read_x_s3),
    .v1_y(vertex1_memory_read_y_s3),
    .v1_z(vertex1_memory_read_z_s3),
    .v2_x(vertex2_memory_read_x_s3),
    .v2_y(vertex2_memory_read_y_s3),
    .v2_z(vertex2_memory_read_z_s3),
    .origin_x(point_x_s3),
    .origin_y(point_y_s3),
    .origin_z(point_z_s3),
    .kz(ray_memory_read_kz_s3),
    .shear_x(ray_memory_read_shear_x_s3),
    .shear_y(ray_memory_read_shear_y_s3),
    .translation_y(translation_memory_read_or_default_y_s25),
    .translation_x(translation_memory_read_or_default_x_s30),
    .translation_z(translation_memory_read_or_default_z_s33),
    .weight(skin_issue_weight_s47),
    .shear_z(shear_memory_read_s50),
    .reciprocal_x(ray_memory_read_reciprocal_x_s3),
    .reciprocal_y(ray_memory_read_reciprocal_y_s3),
    .reciprocal_z(ray_memory_read_reciprocal_z_s3),
    .signs(ray_memory_read_signs_s3),
    .accumulate(skinning_s2),
    .sum_a_0(skin_pair_a_x),
    .sum_b_0(skin_pair_b_x),
    .sum_a_1(skin_pair_a_y),
    .sum_b_1(skin_pair_b_y),
    .sum_a_2(skin_pair_a_z),
    .sum_b_2(skin_pair_b_z),
    .sum_a_3(skin_vertex_a_x),
    .sum_b_3(skin_vertex_b_x),
    .sum_a_4(skin_vertex_a_y),
    .sum_b_4(skin_vertex_b_y),
    .sum_a_5(skin_vertex_a_z),
    .sum_b_5(skin_vertex_b_z),
    .sum_0(test_sum_0),
    .sum_1(test_sum_1),
    .sum_2(test_sum_2),
    .sum_3(test_sum_3),
    .sum_4(test_sum_4),
    .sum_5(test_sum_5),
    .window_near(window_memory_read0_or_default_near_s15),
    .window_far(window_memory_read0_or_default_far_s15),
    .tmin(ray_limit_memory_read0_tmin_s55),
    .tmax(ray_limit_memory_read0_tmax_s55),
    .hit(test_hit),
    .t(test_t),
    .u(test_u),
    .v(test_v),
    .moved_x(test_moved_x),
    .moved_y(test_moved_y),
    .moved_z(test_moved_z),
    .weighted_x(test_weighted_x),
    .weighted_y(test_weighted_y),
    .weighted_z(test_weighted_z),
    .box_near(test_box_near),
    .box_far(test_box_far)
  );

  reg  [49:0] skin_issue_valid_delay;
  assign skin_weighted_valid = skin_issue_valid_delay[49];
  reg  [99:0] skin_issue_position_delay;
  assign skin_weighted_position = skin_issue_position_delay[99:98];
  reg  [49:0] skin_issue_last_delay;
  assign skin_weighted_last = skin_issue_last_delay[49];

  // A ray's window is kept as soon as its box slot has it.
  wire [47:0] window_memory_write_data = {test_box_far, test_box_near};
  reg  [18:0] in_box_slot_delay;
  wire in_box_slot_s19 = in_box_slot_delay[18];

  // The direction waits for the origin, a clock behind it; then the transformed ray leaves, with
  // its interval.
  reg  [23:0] moved_direction_x;
  wire point_is_direction_s38 = in_direction_slot_delay[37];
  reg  [23:0] moved_direction_y;
  reg  [23:0] moved_direction_z;
  reg  [47:0] window_memory_read1;
  reg  [47:0] window_memory_read1_s38;
  reg  [48:0] ray_limit_memory_read1;
  reg  [48:0] ray_limit_memory_read1_s38;

  always @(posedge clk) begin
    if (point_is_direction_s38) moved_direction_x <= test_moved_x;
    if (point_is_direction_s38) moved_direction_y <= test_moved_y;
    if (point_is_direction_s38) moved_direction_z <= test_moved_z;
  end

  wire [23:0] window_memory_read1_near_s38 = window_memory_read1_s38[23:0];
  wire [23:0] window_memory_read1_far_s38 = window_memory_read1_s38[47:24];
  wire [23:0] ray_limit_memory_read1_tmin_s38 = ray_limit_memory_read1_s38[23:0];
  wire [23:0] ray_limit_memory_read1_tmax_s38 = ray_limit_memory_read1_s38[47:24];
  wire object_near_is_greater =
      (ray_limit_memory_read1_tmin_s38[22:0] < window_memory_read1_near_s38[22:0]) &
      ~window_memory_read1_near_s38[23];
  wire [23:0] object_near =
      object_near_is_greater ? window_memory_read1_near_s38 :
      ray_limit_memory_read1_tmin_s38;
  wire object_far_is_less =
      (window_memory_read1_far_s38[22:0] < ray_limit_memory_read1_tmax_s38[22:0]) |
      window_memory_read1_far_s38[23];
  wire [23:0] object_far =
      object_far_is_less ? window_memory_read1_far_s38 :
      ray_limit_memory_read1_tmax_s38;
  assign object_valid = in_origin_slot_delay[38];
  wire [5:0] packet_or_joint_s37 = packet_or_joint_delay[221:216];
  assign object_packet = packet_or_joint_delay[233:228];
  reg  [113:0] issue_ray_delay;
  assign object_ray = issue_ray_delay[77:76];
  reg  [56:0] now_first_delay;
  assign object_first = now_first_delay[38];
  reg  [56:0] now_last_delay;
  assign object_last = now_last_delay[38];
  reg  [22:0] root_memory_read;
  reg  [22:0] root_memory_read_d1;
  assign start_address = root_memory_read_d1[21:0];
  assign start_leaf = root_memory_read_d1[22];
  reg  [32:0] leaf_memory_read0;
  reg  [32:0] leaf_memory_read0_d1;
  wire [10:0] leaf_memory_read0_context_d1 = leaf_memory_read0_d1[10:0];

  // The merge: a hit replaces the ray's closest one if it is closer, or as close and of a lower
  // instance and triangle.
  (* no_rw_check, ram_style = "block" *)
  reg  [135:0] closest_memory_copy0 [0:191];
  (* no_rw_check, ram_style = "block" *)
  reg  [135:0] closest_memory_copy1 [0:191];
  wire [7:0] test_index_s54 = test_index_delay[431:424];
  reg  [135:0] closest_memory_read0;
  reg  [135:0] closest_memory_read0_s56;
  wire [23:0] closest_memory_read0_t_s56 = closest_memory_read0_s56[23:0];
  wire [5:0] packet_or_joint_s54 = packet_or_joint_delay[323:318];
  reg  [32:0] leaf_memory_read1;
  reg  [32:0] leaf_memory_read1_s56;
  wire [10:0] leaf_memory_read1_context_s56 = leaf_memory_read1_s56[10:0];
  wire [21:0] leaf_memory_read1_address_s56 = leaf_memory_read1_s56[32:11];
  reg  [31:0] triangle_number_memory_read;
  reg  [31:0] triangle_number_memory_read_s56;
  wire now_inside_s55 = now_inside_delay[54];
  reg  [31:0] instance_number_memory_read;
  reg  [31:0] instance_number_memory_read_or_default_s56;
  wire [5:0] leaf_memory_read1_context_level_s56 = leaf_memory_read1_context_s56[5:0];
  wire [3:0] leaf_memory_read1_context_touched_s56 = leaf_memory_read1_context_s56[9:6];
  wire leaf_memory_read1_context_inside_s56 = leaf_memory_read1_context_s56[10];
  wire [1:0] issue_ray_s56 = issue_ray_delay[111:110];
  wire was_touched =
      (issue_ray_s56 == 2'd0) ? leaf_memory_read1_context_touched_s56[0] :
      (issue_ray_s56 == 2'd1) ? leaf_memory_read1_context_touched_s56[1] :
      (issue_ray_s56 == 2'd2) ? leaf_memory_read1_context_touched_s56[2] :
      leaf_memory_read1_context_touched_s56[3];
  wire closer = test_t[22:0] < closest_memory_read0_t_s56[22:0];
  wire as_close = test_t == closest_memory_read0_t_s56;
  wire [63:0] identity = {
      instance_number_memory_read_or_default_s56,
      triangle_number_memory_read_s56
    };
  wire lower = identity < closest_memory_read0_s56[135:72];
  reg  ray_limit_memory_read0_any_hit_s56;
  wire replaces =
      test_hit &
      (ray_limit_memory_read0_any_hit_s56 | ~was_touched | closer | (as_close & lower));
  reg  ray_limit_memory_read0_any_hit_s57;
  reg  [23:0] ray_limit_memory_read0_tmin_s56, ray_limit_memory_read0_tmin_s57;
  reg  [31:0] triangle_number_memory_read_s57;
  wire [135:0] merged = {
      ray_limit_memory_read0_any_hit_s57 ? 32'hffffffff : watch_test_instance,
      ray_limit_memory_read0_any_hit_s57 ? 32'hffffffff : triangle_number_memory_read_s57,
      ray_limit_memory_read0_any_hit_s57 ? 24'd0 : watch_test_v,
      ray_limit_memory_read0_any_hit_s57 ? 24'd0 : watch_test_u,
      ray_limit_memory_read0_any_hit_s57 ? ray_limit_memory_read0_tmin_s57 : watch_test_t
    };
  reg  [56:0] test_issued_delay;
  assign watch_test_valid = test_issued_delay[56];
  wire merge_writes = watch_test_valid & watch_test_replaces;
  wire [5:0] merge_packet = packet_or_joint_delay[341:336];
  wire [1:0] merge_ray = issue_ray_delay[113:112];
  wire [7:0] closest_memory_write_address = {merge_packet, merge_ray};

  // Which rays have hit something, gathered over the triangle's rays.
  reg  [3:0] gathered;
  wire now_first_s57 = now_first_delay[56];
  reg  [3:0] leaf_memory_read1_context_touched_s57;
  wire [3:0] newly_touched = {
      merge_writes & (merge_ray == 2'd3),
      merge_writes & (merge_ray == 2'd2),
      merge_writes & (merge_ray == 2'd1),
      merge_writes & (merge_ray == 2'd0)
    };
  wire [3:0] now_touched =
      (now_first_s57 ? leaf_memory_read1_context_touched_s57 : gathered) |
      newly_touched;

  always @(posedge clk) begin
    if (watch_test_valid) gathered <= now_touched;
  end

  wire now_last_s57 = now_last_delay[56];
  reg  [5:0] leaf_memory_read1_context_level_s57;
  reg  leaf_memory_read1_context_inside_s57;
  reg  [135:0] closest_memory_read1;
  assign read_t = closest_memory_read1[23:0];
  assign read_u = closest_memory_read1[47:24];
  assign read_v = closest_memory_read1[71:48];
  assign read_triangle = closest_memory_read1[103:72];
  assign read_instance = closest_memory_read1[135:104];
  reg  [32:0] leaf_memory_read2;
  reg  [32:0] leaf_memory_read2_s39;
  assign watch_transform_record = leaf_memory_read2_s39[32:11];

  // Memories.
  always @(posedge clk) begin
    if (take_leaf) leaf_memory_copy0[leaf_packet] <= leaf_data;
    leaf_memory_read0 <= leaf_memory_copy0[setup_next_packet];
  end

  always @(posedge clk) begin
    if (take_leaf) leaf_memory_copy1[leaf_packet] <= leaf_data;
    leaf_memory_read1 <= leaf_memory_copy1[packet_or_joint_s54];
  end

  always @(posedge clk) begin
    if (take_leaf) leaf_memory_copy2[leaf_packet] <= leaf_data;
    leaf_memory_read2 <= leaf_memory_copy2[packet_or_joint_s37];
  end

  always @(posedge clk) begin
    if (take_leaf) mask_memory[leaf_packet] <= leaf_mask;
  end

  always @(posedge clk) begin
    if (take_leaf) instance_leaf_memory[leaf_packet] <= leaf_is_instance;
  end

  always @(posedge clk) begin
    if (triangle_number_memory_write_enable) triangle_number_memory[record_response_tag_packet] <= record_response_data_number;
    triangle_number_memory_read <= triangle_number_memory[packet_or_joint_s54];
  end

  always @(posedge clk) begin
    if (instance_answer) instance_number_memory[record_response_tag_packet] <= record_response_data_number;
    instance_number_memory_read <= instance_number_memory[packet_or_joint_s54];
  end

  always @(posedge clk) begin
    if (instance_answer) root_memory[record_response_tag_packet] <= root_data;
    root_memory_read <= root_memory[setup_next_packet];
  end

  always @(posedge clk) begin
    if (vertex0_memory_write_enable) vertex0_memory[vertex0_memory_write_address] <= vector_data;
    vertex0_memory_read <= vertex0_memory[corner_index_s1];
  end

  always @(posedge clk) begin
    if (vertex1_memory_write_enable) vertex1_memory[vertex0_memory_write_address] <= vector_data;
    vertex1_memory_read <= vertex1_memory[corner_index_s1];
  end

  always @(posedge clk) begin
    if (vertex2_memory_write_enable) vertex2_memory[vertex0_memory_write_address] <= vector_data;
    vertex2_memory_read <= vertex2_memory[corner_index_s1];
  end

  always @(posedge clk) begin
    if (translation_memory_write_enable) translation_memory[translation_memory_write_address] <= vector_data;
    translation_memory_read <= translation_memory[{skinning_s2, joint_high_s23, packet_or_joint_s23}];
  end

  always @(posedge clk) begin
    if (sweep | vertex_response_valid) arrival_memory[arrival_memory_write_address] <= arrival_memory_write_data;
  end

  always @(posedge clk) begin
    if (setup_valid) ray_memory[ray_memory_write_address] <= ray_memory_write_data;
    ray_memory_read <= ray_memory[test_level_index];
  end

  always @(posedge clk) begin
    if (setup_of_world) ray_limit_memory_copy0[setup_index] <= ray_limit_memory_write_data;
    ray_limit_memory_read0 <= ray_limit_memory_copy0[test_index_s53];
  end

  always @(posedge clk) begin
    if (setup_of_world) ray_limit_memory_copy1[setup_index] <= ray_limit_memory_write_data;
    ray_limit_memory_read1 <= ray_limit_memory_copy1[test_index_s36];
  end

  always @(posedge clk) begin
    if (world_valid) direction_memory[{world_packet, world_ray}] <= direction_memory_write_data;
    direction_memory_read <= direction_memory[test_index];
  end

  always @(posedge clk) begin
    if (in_box_slot_s19) window_memory_copy0[test_index_s19] <= window_memory_write_data;
    window_memory_read0 <= window_memory_copy0[test_index_s13];
  end

  always @(posedge clk) begin
    if (in_box_slot_s19) window_memory_copy1[test_index_s19] <= window_memory_write_data;
    window_memory_read1 <= window_memory_copy1[test_index_s36];
  end

  always @(posedge clk) begin
    if (setup_valid) shear_memory[ray_memory_write_address] <= setup_shear_z;
    shear_memory_read <= shear_memory[test_level_index_s48];
  end

  always @(posedge clk) begin
    if (merge_writes) closest_memory_copy0[closest_memory_write_address] <= merged;
    closest_memory_read0 <= closest_memory_copy0[test_index_s54];
  end

  always @(posedge clk) begin
    if (merge_writes) closest_memory_copy1[closest_memory_write_address] <= merged;
    closest_memory_read1 <= closest_memory_copy1[{read_packet, read_ray}];
  end

  // Pipeline registers.
  always @(posedge clk) begin
    // Outside the pipelines
    root_memory_read_d1 <= root_memory_read;
    leaf_memory_read0_d1 <= leaf_memory_read0;

    // Stage 1
    corner_index_s1 <= {skinning, joint_high | {1'b0, in_box_slot}, packet_or_joint};
    skin_issue_x_s1 <= skin_issue_x;
    skin_issue_y_s1 <= skin_issue_y;
    skin_issue_z_s1 <= skin_issue_z;
    in_transform_slot_s1 <= in_direction_slot | in_origin_slot;

    // Stage 2
    ray_memory_read_s2 <= ray_memory_read;
    direction_memory_read_s2 <= direction_memory_read;
    skinning_s2 <= skinning;
    skin_issue_x_s2 <= skin_issue_x_s1;
    skin_issue_y_s2 <= skin_issue_y_s1;
    skin_issue_z_s2 <= skin_issue_z_s1;
    in_transform_slot_s2 <= in_transform_slot_s1;

    // Stage 3
    vertex0_memory_read_s3 <= vertex0_memory_read;
    vertex1_memory_read_s3 <= vertex1_memory_read;
    vertex2_memory_read_s3 <= vertex2_memory_read;
    point_x_s3 <= point_x;
    point_y_s3 <= point_y;
    point_z_s3 <= point_z;
    matrix_slot_s3 <= in_transform_slot_s2 | skinning_s2;
    ray_memory_read_kz_s3 <= ray_memory_read_kz_s2;
    ray_memory_read_shear_x_s3 <= ray_memory_read_shear_x_s2;
    ray_memory_read_shear_y_s3 <= ray_memory_read_shear_y_s2;
    ray_memory_read_reciprocal_x_s3 <= ray_memory_read_reciprocal_x_s2;
    ray_memory_read_reciprocal_y_s3 <= ray_memory_read_reciprocal_y_s2;
    ray_memory_read_reciprocal_z_s3 <= ray_memory_read_reciprocal_z_s2;
    ray_memory_read_signs_s3 <= ray_memory_read_signs_s2;

    // Stage 15
    window_memory_read0_or_default_s15 <= now_inside_s14 ? window_memory_read0 : 48'h7f0000ff0000;

    // Stage 24
    translation_memory_wanted_s24 <= in_origin_slot_s23 | skinning_s2;

    // Stage 25
    translation_memory_read_or_default_s25 <=
        translation_memory_wanted_s24 ? translation_memory_read :
        72'd0;

    // Stage 38
    window_memory_read1_s38 <= window_memory_read1;
    ray_limit_memory_read1_s38 <= ray_limit_memory_read1;

    // Stage 39
    object_origin_x <= test_moved_x;
    object_origin_y <= test_moved_y;
    object_origin_z <= test_moved_z;
    object_direction_x <= moved_direction_x;
    object_direction_y <= moved_direction_y;
    object_direction_z <= moved_direction_z;
    object_tmin <= object_near;
    object_tmax <= object_far;
    leaf_memory_read2_s39 <= leaf_memory_read2;
    watch_transform_near <= window_memory_read1_near_s38;
    watch_transform_far <= window_memory_read1_far_s38;

    // Stage 50
    shear_memory_read_s50 <= shear_memory_read;

    // Stage 55
    ray_limit_memory_read0_s55 <= ray_limit_memory_read0;

    // Stage 56
    closest_memory_read0_s56 <= closest_memory_read0;
    leaf_memory_read1_s56 <= leaf_memory_read1;
    triangle_number_memory_read_s56 <= triangle_number_memory_read;
    instance_number_memory_read_or_default_s56 <= now_inside_s55 ? instance_number_memory_read : 32'd0;
    ray_limit_memory_read0_any_hit_s56 <= ray_limit_memory_read0_any_hit_s55;
    ray_limit_memory_read0_tmin_s56 <= ray_limit_memory_read0_tmin_s55;

    // Stage 57
    watch_test_replaces <= replaces;
    ray_limit_memory_read0_any_hit_s57 <= ray_limit_memory_read0_any_hit_s56;
    ray_limit_memory_read0_tmin_s57 <= ray_limit_memory_read0_tmin_s56;
    watch_test_t <= test_t;
    watch_test_u <= test_u;
    watch_test_v <= test_v;
    triangle_number_memory_read_s57 <= triangle_number_memory_read_s56;
    watch_test_instance <= instance_number_memory_read_or_default_s56;
    leaf_memory_read1_context_touched_s57 <= leaf_memory_read1_context_touched_s56;
    leaf_memory_read1_context_level_s57 <= leaf_memory_read1_context_level_s56;
    leaf_memory_read1_context_inside_s57 <= leaf_memory_read1_context_inside_s56;
    watch_test_record <= leaf_memory_read1_address_s56;
    watch_test_hit <= test_hit;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    in_direction_slot_delay <= {in_direction_slot_delay[36:0], in_direction_slot};
    joint_high_delay <= {joint_high_delay[43:0], joint_high};
    packet_or_joint_delay <= {packet_or_joint_delay[335:0], packet_or_joint};
    if (rst) in_origin_slot_delay <= 39'd0; else in_origin_slot_delay <= {in_origin_slot_delay[37:0], in_origin_slot};
    test_index_delay <= {test_index_delay[423:0], test_index};
    now_inside_delay <= {now_inside_delay[53:0], now_inside};
    test_level_index_delay <= {test_level_index_delay[422:0], test_level_index};
    skin_issue_weight_delay <= {skin_issue_weight_delay[1103:0], skin_issue_weight};
    translation_memory_read_or_default_x_delay <= {translation_memory_read_or_default_x_delay[95:0], translation_memory_read_or_default_x_s25};
    translation_memory_read_or_default_z_delay <= {translation_memory_read_or_default_z_delay[167:0], translation_memory_read_or_default_z_s25};
    if (rst) skin_issue_valid_delay <= 50'd0; else skin_issue_valid_delay <= {skin_issue_valid_delay[48:0], skin_issue_valid};
    skin_issue_position_delay <= {skin_issue_position_delay[97:0], skin_issue_position};
    skin_issue_last_delay <= {skin_issue_last_delay[48:0], skin_issue_last};
    in_box_slot_delay <= {in_box_slot_delay[17:0], in_box_slot};
    issue_ray_delay <= {issue_ray_delay[111:0], issue_ray};
    now_first_delay <= {now_first_delay[55:0], now_first};
    now_last_delay <= {now_last_delay[55:0], now_last};
    if (rst) test_issued_delay <= 57'd0; else test_issued_delay <= {test_issued_delay[55:0], test_issued};
  end

  assign leaf_ready = record_request_ready;
  assign record_request_valid = leaf_valid;
  assign record_request_address = leaf_address;
  assign record_request_tag = {leaf_is_instance, leaf_packet};
  assign vertex_request_valid = vertex_queue_valid;
  assign vertex_request_address = vertex_queue_front_instance ? vector_address : vertex_address;
  assign vertex_request_tag = {vertex_queue_front_packet, corner};
  assign skin_weighted_x = test_weighted_x;
  assign skin_weighted_y = test_weighted_y;
  assign skin_weighted_z = test_weighted_z;
  assign skin_pair_sum_x = test_sum_0;
  assign skin_pair_sum_y = test_sum_1;
  assign skin_pair_sum_z = test_sum_2;
  assign skin_vertex_sum_x = test_sum_3;
  assign skin_vertex_sum_y = test_sum_4;
  assign skin_vertex_sum_z = test_sum_5;
  assign start_context = {1'b1, leaf_memory_read0_context_d1[9:0]};
  assign limit_valid = merge_writes;
  assign limit_packet = merge_packet;
  assign limit_ray = merge_ray;
  assign limit_value = ray_limit_memory_read0_any_hit_s57 ? 24'hff0000 : watch_test_t;
  assign done_valid = watch_test_valid & now_last_s57;
  assign done_packet = merge_packet;
  assign done_context = {
      leaf_memory_read1_context_inside_s57,
      now_touched,
      leaf_memory_read1_context_level_s57
    };
  assign slot_taken = busy;
  assign transform_issued = in_origin_slot;
  assign watch_test_packet = merge_packet;
  assign watch_test_ray = merge_ray;
  assign watch_transform_valid = object_valid;
  assign watch_transform_packet = object_packet;
  assign watch_transform_ray = object_ray;
  assign watch_transform_origin_x = object_origin_x;
  assign watch_transform_origin_y = object_origin_y;
  assign watch_transform_origin_z = object_origin_z;
  assign watch_transform_direction_x = object_direction_x;
  assign watch_transform_direction_y = object_direction_y;
  assign watch_transform_direction_z = object_direction_z;

  // What nothing reads.
  wire unused = &{
    1'b0,
    record_response_data_v0[31:22],
    record_response_data_v1[31:27],
    record_response_data_v2[31:22],
    record_response_data_v1_link[25:22],
    ray_limit_memory_read1_s38[48],
    leaf_memory_read0_d1[32:11],
    leaf_memory_read0_context_d1[10],
    closest_memory_read0_s56[71:24],
    leaf_memory_read2_s39[10:0]
  };

endmodule

`default_nettype wire
