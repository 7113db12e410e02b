// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_tpu: the traversal processing unit: takes packets through a B-KD tree, a packet step a clock.

`default_nettype none

module dynrt_tpu (
  input  wire         clk,
  input  wire         rst,

  // A ray that has been set up; a packet's last one that comes starts the packet. soon says so pop_latency clocks before
  input  wire         setup_soon,
  input  wire         setup_valid,
  input  wire [5:0]   setup_packet,
  input  wire [1:0]   setup_ray,
  input  wire         setup_first,
  input  wire         setup_last,
  input  wire         setup_enters,
  input  wire [23:0]  setup_near,
  input  wire [23:0]  setup_far,
  input  wire [2:0]   setup_signs,
  input  wire [23:0]  setup_origin_x,
  input  wire [23:0]  setup_origin_y,
  input  wire [23:0]  setup_origin_z,
  input  wire [23:0]  setup_reciprocal_x,
  input  wire [23:0]  setup_reciprocal_y,
  input  wire [23:0]  setup_reciprocal_z,

  // The ray is in an object's space: where and with which context its packet starts there, beside its last ray
  input  wire         setup_object,
  input  wire [21:0]  object_address,
  input  wire         object_leaf,
  input  wire [10:0]  object_context,

  // The root link word, constant while packets are under way
  input  wire [31:0]  root,

  // Node memory: requests
  input  wire         node_request_ready,
  output wire         node_request_valid,
  output wire [21:0]  node_request_address,
  output wire [6:0]   node_request_tag,

  // Node memory: answers, in any order, always taken
  input  wire         node_response_valid,
  input  wire [6:0]   node_response_tag,
  input  wire [127:0] node_response_data,

  // Leaves to the geometry unit
  input  wire         leaf_ready,
  output wire         leaf_valid,
  output wire [5:0]   leaf_packet,
  output wire [21:0]  leaf_address,
  output wire [10:0]  leaf_context,
  output wire [3:0]   leaf_mask,

  // A closer hit of a ray: what its near must not exceed from now on
  input  wire         limit_valid,
  input  wire [5:0]   limit_packet,
  input  wire [1:0]   limit_ray,
  input  wire [23:0]  limit_value,

  // A leaf all of whose tests are merged
  input  wire         done_valid,
  input  wire [5:0]   done_packet,
  input  wire [10:0]  done_context,

  // A finished packet, and which of its rays have hit something
  output wire         finished_valid,
  output wire [5:0]   finished_packet,
  output wire [3:0]   finished_touched,

  // Counters' events, and marks
  output wire         step_taken,
  output wire [5:0]   stack_high_water,
  output wire         stack_overflow,

  // The packet step just decided, for whoever watches
  output wire [5:0]   watch_step_packet,
  output wire [21:0]  watch_step_node,
  output reg  [3:0]   watch_step_left,
  output reg  [3:0]   watch_step_right,
  output reg          watch_step_left_first,
  output reg  [191:0] watch_step_left_intervals,
  output reg  [191:0] watch_step_right_intervals
);

  // Rays: origin, reciprocal and signs, a memory for each place in the packet, written when set up:
  // in the world, and behind that in the object's space, so that the world's are still there when
  // the packet leaves an object.
  wire [146:0] setup_word = {
      setup_signs,
      setup_reciprocal_z,
      setup_reciprocal_y,
      setup_reciprocal_x,
      setup_origin_z,
      setup_origin_y,
      setup_origin_x
    };
  wire setup_ray_is_0 = setup_ray == 2'd0;
  wire setup_of_ray0 = setup_valid & setup_ray_is_0;
  wire setup_ray_is_1 = setup_ray == 2'd1;
  wire setup_of_ray1 = setup_valid & setup_ray_is_1;
  wire setup_ray_is_2 = setup_ray == 2'd2;
  wire setup_of_ray2 = setup_valid & setup_ray_is_2;
  wire setup_ray_is_3 = setup_ray == 2'd3;
  wire setup_of_ray3 = setup_valid & setup_ray_is_3;
  (* no_rw_check, ram_style = "block" *)
  reg  [146:0] ray0_memory [0:111];
  wire [6:0] setup_level_packet = {setup_object, setup_packet};
  (* no_rw_check, ram_style = "block" *)
  reg  [146:0] ray1_memory [0:111];
  (* no_rw_check, ram_style = "block" *)
  reg  [146:0] ray2_memory [0:111];
  (* no_rw_check, ram_style = "block" *)
  reg  [146:0] ray3_memory [0:111];

  // Where a requested node lies, and its packet's context, kept while the request is out.
  wire request_fire;
  wire [38:0] request_item;
  wire request_popped;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [33:0] request_memory [0:47];
  wire [5:0] request_item_packet = request_item[5:0];
  assign node_request_address = request_item[27:6];
  wire [10:0] request_item_context = request_item[38:28];

  // Intervals and mask of the packet in the node it goes to: as a step left them, and as a pop or
  // the setup did.
  wire stepped_write;
  wire [5:0] stepped_packet;
  wire [191:0] stepped_intervals;
  wire [3:0] stepped_mask;
  (* no_rw_check, ram_style = "block" *)
  reg  [195:0] stepped_memory [0:47];
  wire [5:0] popped_packet;
  wire popped_mask_write;
  wire [3:0] popped_mask;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [3:0] popped_mask_memory [0:47];
  wire popped_write0;
  wire popped_write1;
  wire popped_write2;
  wire popped_write3;
  wire [47:0] popped_interval0;
  wire [47:0] popped_interval1;
  wire [47:0] popped_interval2;
  wire [47:0] popped_interval3;
  (* no_rw_check, ram_style = "block" *)
  reg  [47:0] popped0_memory [0:47];
  (* no_rw_check, ram_style = "block" *)
  reg  [47:0] popped1_memory [0:47];
  (* no_rw_check, ram_style = "block" *)
  reg  [47:0] popped2_memory [0:47];
  (* no_rw_check, ram_style = "block" *)
  reg  [47:0] popped3_memory [0:47];

  // The packet step. A node's answer enters with the packet's rays.
  wire [5:0] packet = node_response_tag[5:0];
  wire [23:0] left_lo = node_response_data[23:0];
  wire [23:0] left_hi = node_response_data[47:24];
  wire [23:0] right_lo = node_response_data[71:48];
  wire [23:0] right_hi = node_response_data[95:72];
  wire [1:0] left_axis = node_response_data[125:124];
  wire [1:0] right_axis = node_response_data[127:126];
  reg  [146:0] ray0_memory_read;
  reg  [146:0] ray0_memory_read_s2;
  reg  [146:0] ray1_memory_read;
  reg  [146:0] ray1_memory_read_s2;
  reg  [146:0] ray2_memory_read;
  reg  [146:0] ray2_memory_read_s2;
  reg  [146:0] ray3_memory_read;
  reg  [146:0] ray3_memory_read_s2;
  reg  [95:0] packet_delay;
  wire [5:0] packet_s10 = packet_delay[59:54];
  wire [5:0] packet_s11 = packet_delay[65:60];
  wire [33:0] request_memory_read = request_memory[packet_s11];
  reg  [33:0] request_memory_read_s12;
  wire [21:0] request_memory_read_address_s12 = request_memory_read_s12[21:0];
  wire [10:0] request_memory_read_context_s12 = request_memory_read_s12[32:22];
  wire request_memory_read_popped_s12 = request_memory_read_s12[33];
  reg  [195:0] stepped_memory_read;
  reg  [195:0] stepped_memory_read_s12;
  wire [191:0] stepped_memory_read_intervals_s12 = stepped_memory_read_s12[191:0];
  wire [3:0] stepped_memory_read_mask_s12 = stepped_memory_read_s12[195:192];
  wire [3:0] popped_mask_memory_read = popped_mask_memory[packet_s11];
  reg  [3:0] popped_mask_memory_read_s12;
  wire [3:0] mask_in =
      request_memory_read_popped_s12 ? popped_mask_memory_read_s12 :
      stepped_memory_read_mask_s12;
  reg  [47:0] popped0_memory_read;
  reg  [47:0] popped0_memory_read_s12;
  wire [47:0] ray0_interval =
      request_memory_read_popped_s12 ? popped0_memory_read_s12 :
      stepped_memory_read_intervals_s12[47:0];
  wire [23:0] ray0_memory_read_origin_x_s2 = ray0_memory_read_s2[23:0];
  wire [23:0] ray0_memory_read_origin_y_s2 = ray0_memory_read_s2[47:24];
  wire [23:0] ray0_memory_read_origin_z_s2 = ray0_memory_read_s2[71:48];
  wire [23:0] ray0_memory_read_reciprocal_x_s2 = ray0_memory_read_s2[95:72];
  wire [23:0] ray0_memory_read_reciprocal_y_s2 = ray0_memory_read_s2[119:96];
  wire [23:0] ray0_memory_read_reciprocal_z_s2 = ray0_memory_read_s2[143:120];
  wire [2:0] ray0_memory_read_signs_s2 = ray0_memory_read_s2[146:144];
  reg  left_axis_is_1_s1, left_axis_is_1_s2;
  reg  left_axis_is_0_s1, left_axis_is_0_s2;
  wire ray0_left_sign =
      left_axis_is_0_s2 ? ray0_memory_read_signs_s2[0] :
      left_axis_is_1_s2 ? ray0_memory_read_signs_s2[1] :
      ray0_memory_read_signs_s2[2];
  reg  ray0_left_sign_s3;
  wire [23:0] ray0_left_origin =
      left_axis_is_0_s2 ? ray0_memory_read_origin_x_s2 :
      left_axis_is_1_s2 ? ray0_memory_read_origin_y_s2 :
      ray0_memory_read_origin_z_s2;
  reg  [23:0] ray0_left_origin_s3;
  wire [23:0] ray0_left_reciprocal =
      left_axis_is_0_s2 ? ray0_memory_read_reciprocal_x_s2 :
      left_axis_is_1_s2 ? ray0_memory_read_reciprocal_y_s2 :
      ray0_memory_read_reciprocal_z_s2;
  reg  [23:0] ray0_left_reciprocal_s3;
  reg  right_axis_is_1_s1, right_axis_is_1_s2;
  reg  right_axis_is_0_s1, right_axis_is_0_s2;
  wire ray0_right_sign =
      right_axis_is_0_s2 ? ray0_memory_read_signs_s2[0] :
      right_axis_is_1_s2 ? ray0_memory_read_signs_s2[1] :
      ray0_memory_read_signs_s2[2];
  reg  ray0_right_sign_s3;
  wire [23:0] ray0_right_origin =
      right_axis_is_0_s2 ? ray0_memory_read_origin_x_s2 :
      right_axis_is_1_s2 ? ray0_memory_read_origin_y_s2 :
      ray0_memory_read_origin_z_s2;
  reg  [23:0] ray0_right_origin_s3;
  wire [23:0] ray0_right_reciprocal =
      right_axis_is_0_s2 ? ray0_memory_read_reciprocal_x_s2 :
      right_axis_is_1_s2 ? ray0_memory_read_reciprocal_y_s2 :
      ray0_memory_read_reciprocal_z_s2;
  reg  [23:0] ray0_right_reciprocal_s3;
  wire [23:0] ray0_interval_near = ray0_interval[23:0];
  wire [23:0] ray0_interval_far = ray0_interval[47:24];
  reg  [23:0] left_lo_s1, left_lo_s2, left_lo_s3;
  reg  [23:0] left_hi_s1, left_hi_s2, left_hi_s3;
  reg  [23:0] right_lo_s1, right_lo_s2, right_lo_s3;
  reg  [23:0] right_hi_s1, right_hi_s2, right_hi_s3;

  wire [23:0] slice0_out_left_near;
  wire [23:0] slice0_out_left_far;
  wire [23:0] slice0_out_right_near;
  wire [23:0] slice0_out_right_far;
  wire slice0_to_left;
  wire slice0_to_right;
  wire slice0_left_before_right;
  dynrt_tpu_slice slice0 (
    .clk(clk),
    .left_lo(left_lo_s3),
    .left_hi(left_hi_s3),
    .right_lo(right_lo_s3),
    .right_hi(right_hi_s3),
    .left_sign(ray0_left_sign_s3),
    .left_origin(ray0_left_origin_s3),
    .left_reciprocal(ray0_left_reciprocal_s3),
    .right_sign(ray0_right_sign_s3),
    .right_origin(ray0_right_origin_s3),
    .right_reciprocal(ray0_right_reciprocal_s3),
    .ray_near(ray0_interval_near),
    .ray_far(ray0_interval_far),
    .ray_active(mask_in[0]),
    .out_left_near(slice0_out_left_near),
    .out_left_far(slice0_out_left_far),
    .out_right_near(slice0_out_right_near),
    .out_right_far(slice0_out_right_far),
    .to_left(slice0_to_left),
    .to_right(slice0_to_right),
    .left_before_right(slice0_left_before_right)
  );

  reg  [47:0] popped1_memory_read;
  reg  [47:0] popped1_memory_read_s12;
  wire [47:0] ray1_interval =
      request_memory_read_popped_s12 ? popped1_memory_read_s12 :
      stepped_memory_read_intervals_s12[95:48];
  wire [23:0] ray1_memory_read_origin_x_s2 = ray1_memory_read_s2[23:0];
  wire [23:0] ray1_memory_read_origin_y_s2 = ray1_memory_read_s2[47:24];
  wire [23:0] ray1_memory_read_origin_z_s2 = ray1_memory_read_s2[71:48];
  wire [23:0] ray1_memory_read_reciprocal_x_s2 = ray1_memory_read_s2[95:72];
  wire [23:0] ray1_memory_read_reciprocal_y_s2 = ray1_memory_read_s2[119:96];
  wire [23:0] ray1_memory_read_reciprocal_z_s2 = ray1_memory_read_s2[143:120];
  wire [2:0] ray1_memory_read_signs_s2 = ray1_memory_read_s2[146:144];
  wire ray1_left_sign =
      left_axis_is_0_s2 ? ray1_memory_read_signs_s2[0] :
      left_axis_is_1_s2 ? ray1_memory_read_signs_s2[1] :
      ray1_memory_read_signs_s2[2];
  reg  ray1_left_sign_s3;
  wire [23:0] ray1_left_origin =
      left_axis_is_0_s2 ? ray1_memory_read_origin_x_s2 :
      left_axis_is_1_s2 ? ray1_memory_read_origin_y_s2 :
      ray1_memory_read_origin_z_s2;
  reg  [23:0] ray1_left_origin_s3;
  wire [23:0] ray1_left_reciprocal =
      left_axis_is_0_s2 ? ray1_memory_read_reciprocal_x_s2 :
      left_axis_is_1_s2 ? ray1_memory_read_reciprocal_y_s2 :
      ray1_memory_read_reciprocal_z_s2;
  reg  [23:0] ray1_left_reciprocal_s3;
  wire ray1_right_sign =
      right_axis_is_0_s2 ? ray1_memory_read_signs_s2[0] :
      right_axis_is_1_s2 ? ray1_memory_read_signs_s2[1] :
      ray1_memory_read_signs_s2[2];
  reg  ray1_right_sign_s3;
  wire [23:0] ray1_right_origin =
      right_axis_is_0_s2 ? ray1_memory_read_origin_x_s2 :
      right_axis_is_1_s2 ? ray1_memory_read_origin_y_s2 :
      ray1_memory_read_origin_z_s2;
  reg  [23:0] ray1_right_origin_s3;
  wire [23:0] ray1_right_reciprocal =
      right_axis_is_0_s2 ? ray1_memory_read_reciprocal_x_s2 :
      right_axis_is_1_s2 ? ray1_memory_read_reciprocal_y_s2 :
      ray1_memory_read_reciprocal_z_s2;
  reg  [23:0] ray1_right_reciprocal_s3;
  wire [23:0] ray1_interval_near = ray1_interval[23:0];
  wire [23:0] ray1_interval_far = ray1_interval[47:24];

  wire [23:0] slice1_out_left_near;
  wire [23:0] slice1_out_left_far;
  wire [23:0] slice1_out_right_near;
  wire [23:0] slice1_out_right_far;
  wire slice1_to_left;
  wire slice1_to_right;
  wire slice1_left_before_right;
  dynrt_tpu_slice slice1 (
    .clk(clk),
    .left_lo(left_lo_s3),
    .left_hi(left_hi_s3),
    .right_lo(right_lo_s3),
    .right_hi(right_hi_s3),
    .left_sign(ray1_left_sign_s3),
    .left_origin(ray1_left_origin_s3),
    .left_reciprocal(ray1_left_reciprocal_s3),
    .right_sign(ray1_right_sign_s3),
    .right_origin(ray1_right_origin_s3),
    .right_reciprocal(ray1_right_reciprocal_s3),
    .ray_near(ray1_interval_near),
    .ray_far(ray1_interval_far),
    .ray_active(mask_in[1]),
    .out_left_near(slice1_out_left_near),
    .out_left_far(slice1_out_left_far),
    .out_right_near(slice1_out_right_near),
    .out_right_far(slice1_out_right_far),
    .to_left(slice1_to_left),
    .to_right(slice1_to_right),
    .left_before_right(slice1_left_before_right)
  );

  reg  [47:0] popped2_memory_read;
  reg  [47:0] popped2_memory_read_s12;
  wire [47:0] ray2_interval =
      request_memory_read_popped_s12 ? popped2_memory_read_s12 :
      stepped_memory_read_intervals_s12[143:96];
  wire [23:0] ray2_memory_read_origin_x_s2 = ray2_memory_read_s2[23:0];
  wire [23:0] ray2_memory_read_origin_y_s2 = ray2_memory_read_s2[47:24];
  wire [23:0] ray2_memory_read_origin_z_s2 = ray2_memory_read_s2[71:48];
  wire [23:0] ray2_memory_read_reciprocal_x_s2 = ray2_memory_read_s2[95:72];
  wire [23:0] ray2_memory_read_reciprocal_y_s2 = ray2_memory_read_s2[119:96];
  wire [23:0] ray2_memory_read_reciprocal_z_s2 = ray2_memory_read_s2[143:120];
  wire [2:0] ray2_memory_read_signs_s2 = ray2_memory_read_s2[146:144];
  wire ray2_left_sign =
      left_axis_is_0_s2 ? ray2_memory_read_signs_s2[0] :
      left_axis_is_1_s2 ? ray2_memory_read_signs_s2[1] :
      ray2_memory_read_signs_s2[2];
  reg  ray2_left_sign_s3;
  wire [23:0] ray2_left_origin =
      left_axis_is_0_s2 ? ray2_memory_read_origin_x_s2 :
      left_axis_is_1_s2 ? ray2_memory_read_origin_y_s2 :
      ray2_memory_read_origin_z_s2;
  reg  [23:0] ray2_left_origin_s3;
  wire [23:0] ray2_left_reciprocal =
      left_axis_is_0_s2 ? ray2_memory_read_reciprocal_x_s2 :
      left_axis_is_1_s2 ? ray2_memory_read_reciprocal_y_s2 :
      ray2_memory_read_reciprocal_z_s2;
  reg  [23:0] ray2_left_reciprocal_s3;
  wire ray2_right_sign =
      right_axis_is_0_s2 ? ray2_memory_read_signs_s2[0] :
      right_axis_is_1_s2 ? ray2_memory_read_signs_s2[1] :
      ray2_memory_read_signs_s2[2];
  reg  ray2_right_sign_s3;
  wire [23:0] ray2_right_origin =
      right_axis_is_0_s2 ? ray2_memory_read_origin_x_s2 :
      right_axis_is_1_s2 ? ray2_memory_read_origin_y_s2 :
      ray2_memory_read_origin_z_s2;
  reg  [23:0] ray2_right_origin_s3;
  wire [23:0] ray2_right_reciprocal =
      right_axis_is_0_s2 ? ray2_memory_read_reciprocal_x_s2 :
      right_axis_is_1_s2 ? ray2_memory_read_reciprocal_y_s2 :
      ray2_memory_read_reciprocal_z_s2;
  reg  [23:0] ray2_right_reciprocal_s3;
  wire [23:0] ray2_interval_near = ray2_interval[23:0];
  wire [23:0] ray2_interval_far = ray2_interval[47:24];

  wire [23:0] slice2_out_left_near;
  wire [23:0] slice2_out_left_far;
  wire [23:0] slice2_out_right_near;
  wire [23:0] slice2_out_right_far;
  wire slice2_to_left;
  wire slice2_to_right;
  wire slice2_left_before_right;
  dynrt_tpu_slice slice2 (
    .clk(clk),
    .left_lo(left_lo_s3),
    .left_hi(left_hi_s3),
    .right_lo(right_lo_s3),
    .right_hi(right_hi_s3),
    .left_sign(ray2_left_sign_s3),
    .left_origin(ray2_left_origin_s3),
    .left_reciprocal(ray2_left_reciprocal_s3),
    .right_sign(ray2_right_sign_s3),
    .right_origin(ray2_right_origin_s3),
    .right_reciprocal(ray2_right_reciprocal_s3),
    .ray_near(ray2_interval_near),
    .ray_far(ray2_interval_far),
    .ray_active(mask_in[2]),
    .out_left_near(slice2_out_left_near),
    .out_left_far(slice2_out_left_far),
    .out_right_near(slice2_out_right_near),
    .out_right_far(slice2_out_right_far),
    .to_left(slice2_to_left),
    .to_right(slice2_to_right),
    .left_before_right(slice2_left_before_right)
  );

  reg  [47:0] popped3_memory_read;
  reg  [47:0] popped3_memory_read_s12;
  wire [47:0] ray3_interval =
      request_memory_read_popped_s12 ? popped3_memory_read_s12 :
      stepped_memory_read_intervals_s12[191:144];
  wire [23:0] ray3_memory_read_origin_x_s2 = ray3_memory_read_s2[23:0];
  wire [23:0] ray3_memory_read_origin_y_s2 = ray3_memory_read_s2[47:24];
  wire [23:0] ray3_memory_read_origin_z_s2 = ray3_memory_read_s2[71:48];
  wire [23:0] ray3_memory_read_reciprocal_x_s2 = ray3_memory_read_s2[95:72];
  wire [23:0] ray3_memory_read_reciprocal_y_s2 = ray3_memory_read_s2[119:96];
  wire [23:0] ray3_memory_read_reciprocal_z_s2 = ray3_memory_read_s2[143:120];
  wire [2:0] ray3_memory_read_signs_s2 = ray3_memory_read_s2[146:144];
  wire ray3_left_sign =
      left_axis_is_0_s2 ? ray3_memory_read_signs_s2[0] :
      left_axis_is_1_s2 ? ray3_memory_read_signs_s2[1] :
      ray3_memory_read_signs_s2[2];
  reg  ray3_left_sign_s3;
  wire [23:0] ray3_left_origin =
      left_axis_is_0_s2 ? ray3_memory_read_origin_x_s2 :
      left_axis_is_1_s2 ? ray3_memory_read_origin_y_s2 :
      ray3_memory_read_origin_z_s2;
  reg  [23:0] ray3_left_origin_s3;
  wire [23:0] ray3_left_reciprocal =
      left_axis_is_0_s2 ? ray3_memory_read_reciprocal_x_s2 :
      left_axis_is_1_s2 ? ray3_memory_read_reciprocal_y_s2 :
      ray3_memory_read_reciprocal_z_s2;
  reg  [23:0] ray3_left_reciprocal_s3;
  wire ray3_right_sign =
      right_axis_is_0_s2 ? ray3_memory_read_signs_s2[0] :
      right_axis_is_1_s2 ? ray3_memory_read_signs_s2[1] :
      ray3_memory_read_signs_s2[2];
  reg  ray3_right_sign_s3;
  wire [23:0] ray3_right_origin =
      right_axis_is_0_s2 ? ray3_memory_read_origin_x_s2 :
      right_axis_is_1_s2 ? ray3_memory_read_origin_y_s2 :
      ray3_memory_read_origin_z_s2;
  reg  [23:0] ray3_right_origin_s3;
  wire [23:0] ray3_right_reciprocal =
      right_axis_is_0_s2 ? ray3_memory_read_reciprocal_x_s2 :
      right_axis_is_1_s2 ? ray3_memory_read_reciprocal_y_s2 :
      ray3_memory_read_reciprocal_z_s2;
  reg  [23:0] ray3_right_reciprocal_s3;
  wire [23:0] ray3_interval_near = ray3_interval[23:0];
  wire [23:0] ray3_interval_far = ray3_interval[47:24];

  wire [23:0] slice3_out_left_near;
  wire [23:0] slice3_out_left_far;
  wire [23:0] slice3_out_right_near;
  wire [23:0] slice3_out_right_far;
  wire slice3_to_left;
  wire slice3_to_right;
  wire slice3_left_before_right;
  dynrt_tpu_slice slice3 (
    .clk(clk),
    .left_lo(left_lo_s3),
    .left_hi(left_hi_s3),
    .right_lo(right_lo_s3),
    .right_hi(right_hi_s3),
    .left_sign(ray3_left_sign_s3),
    .left_origin(ray3_left_origin_s3),
    .left_reciprocal(ray3_left_reciprocal_s3),
    .right_sign(ray3_right_sign_s3),
    .right_origin(ray3_right_origin_s3),
    .right_reciprocal(ray3_right_reciprocal_s3),
    .ray_near(ray3_interval_near),
    .ray_far(ray3_interval_far),
    .ray_active(mask_in[3]),
    .out_left_near(slice3_out_left_near),
    .out_left_far(slice3_out_left_far),
    .out_right_near(slice3_out_right_near),
    .out_right_far(slice3_out_right_far),
    .to_left(slice3_to_left),
    .to_right(slice3_to_right),
    .left_before_right(slice3_left_before_right)
  );

  // The packet's decision.
  wire [3:0] to_left = {slice3_to_left, slice2_to_left, slice1_to_left, slice0_to_left};
  wire [3:0] to_right = {slice3_to_right, slice2_to_right, slice1_to_right, slice0_to_right};
  wire goes_left = |to_left;
  wire goes_right = |to_right;
  wire [3:0] left_before_right = {
      slice3_left_before_right,
      slice2_left_before_right,
      slice1_left_before_right,
      slice0_left_before_right
    };
  wire left_first = goes_left & ((|left_before_right) | ~goes_right);
  wire [191:0] left_intervals = {
      slice3_out_left_far,
      slice3_out_left_near,
      slice2_out_left_far,
      slice2_out_left_near,
      slice1_out_left_far,
      slice1_out_left_near,
      slice0_out_left_far,
      slice0_out_left_near
    };
  wire [191:0] right_intervals = {
      slice3_out_right_far,
      slice3_out_right_near,
      slice2_out_right_far,
      slice2_out_right_near,
      slice1_out_right_far,
      slice1_out_right_near,
      slice0_out_right_far,
      slice0_out_right_near
    };
  reg  [87:0] request_memory_read_address_delay;
  wire [21:0] own_address = request_memory_read_address_delay[65:44];
  reg  [10:0] request_memory_read_context_s13, request_memory_read_context_s14;
  reg  [10:0] request_memory_read_context_s15;
  wire [25:0] node_response_data_link = node_response_data[121:96];
  wire [21:0] link = node_response_data_link[21:0];
  wire left_leaf = node_response_data[122];
  wire right_leaf = node_response_data[123];
  wire [21:0] link_after = link + 22'd1;
  reg  [14:0] left_leaf_delay;
  wire left_leaf_s15 = left_leaf_delay[14];
  reg  [329:0] link_delay;
  wire [21:0] link_s15 = link_delay[329:308];
  wire [21:0] left_address = left_leaf_s15 ? own_address : link_s15;
  reg  [14:0] right_leaf_delay;
  wire right_leaf_s15 = right_leaf_delay[14];
  reg  [329:0] right_inner_address_delay;
  wire [21:0] right_inner_address_s15 = right_inner_address_delay[329:308];
  wire [21:0] right_address =
      right_leaf_s15 ? (left_leaf_s15 ? link_s15 : own_address) :
      right_inner_address_s15;
  wire first_leaf = left_first ? left_leaf_s15 : right_leaf_s15;
  wire second_leaf = left_first ? right_leaf_s15 : left_leaf_s15;
  wire [21:0] first_address = left_first ? left_address : right_address;
  wire [21:0] second_address = left_first ? right_address : left_address;
  wire [3:0] first_mask = left_first ? to_left : to_right;
  wire [3:0] second_mask = left_first ? to_right : to_left;
  wire [191:0] first_intervals = left_first ? left_intervals : right_intervals;
  wire [191:0] second_intervals = left_first ? right_intervals : left_intervals;
  wire [5:0] level_before = request_memory_read_context_s15[5:0];
  wire request_memory_read_context_inside_s15 = request_memory_read_context_s15[10];
  wire goes_both = goes_left & goes_right;
  reg  [15:0] node_response_valid_delay;
  wire node_response_valid_s15 = node_response_valid_delay[14];
  wire pushes = goes_both & node_response_valid_s15;
  wire [5:0] next_level = level_before + {5'd0, goes_both};
  wire [10:0] next_context = {request_memory_read_context_s15[10:6], next_level};
  wire step_valid = node_response_valid_delay[15];
  wire [5:0] step_packet = packet_delay[95:90];
  wire goes_on = goes_left | goes_right;
  reg  goes_on_s16;
  reg  first_leaf_s16;
  reg  [21:0] first_address_s16;
  reg  [10:0] next_context_s16;
  reg  [3:0] first_mask_s16;
  reg  [191:0] first_intervals_s16;
  wire step_goes_on = step_valid & goes_on_s16;
  assign stepped_write = step_goes_on;
  assign stepped_packet = step_packet;
  assign stepped_intervals = first_intervals_s16;
  assign stepped_mask = first_mask_s16;

  // The stack.
  reg  pushes_s16;
  reg  [5:0] level_before_s16;
  wire [219:0] stack_write_data = {
      second_intervals,
      second_mask,
      request_memory_read_context_inside_s15,
      second_leaf,
      second_address
    };
  reg  [219:0] stack_write_data_s16;
  assign watch_step_node = request_memory_read_address_delay[87:66];
  wire stack_full = level_before_s16 == 6'd32;
  wire stack_write = pushes_s16 & ~stack_full;
  (* no_rw_check, ram_style = "block" *)
  reg  [219:0] stack [0:1535];
  reg  overflow;
  reg  [5:0] high_water;

  always @(posedge clk) begin
    if (rst) overflow <= 1'b0; else overflow <= overflow | (pushes_s16 & stack_full);
  end

  wire [5:0] next_context_level_s16 = next_context_s16[5:0];

  always @(posedge clk) begin
    if (rst) high_water <= 6'd0; else if (pushes_s16 & (high_water < next_context_level_s16)) high_water <= next_context_level_s16;
  end

  // Packets that pop: from the geometry unit, from steps that went nowhere, and again after a
  // dropped entry or an instance that no ray enters.
  wire take_done;
  wire take_retry;
  wire take_stepped_pop;
  wire retry_push;
  wire [16:0] retry_item;

  wire done_queue_valid;
  wire [16:0] done_queue_front;
  dynrt_fifo_17x48 done_queue (
    .clk(clk),
    .rst(rst),
    .push(done_valid),
    .data({done_context, done_packet}),
    .pop(take_done),
    .valid(done_queue_valid),
    .front(done_queue_front)
  );

  wire retry_queue_valid;
  wire [16:0] retry_queue_front;
  dynrt_fifo_17x48 retry_queue (
    .clk(clk),
    .rst(rst),
    .push(retry_push),
    .data(retry_item),
    .pop(take_retry),
    .valid(retry_queue_valid),
    .front(retry_queue_front)
  );

  wire step_goes_nowhere = step_valid & ~goes_on_s16;

  wire nowhere_queue_valid;
  wire [16:0] nowhere_queue_front;
  dynrt_fifo_17x48 nowhere_queue (
    .clk(clk),
    .rst(rst),
    .push(step_goes_nowhere),
    .data({next_context_s16, step_packet}),
    .pop(take_stepped_pop),
    .valid(nowhere_queue_valid),
    .front(nowhere_queue_front)
  );

  wire may_pop = ~setup_soon;
  assign take_retry = may_pop & retry_queue_valid;
  wire may_pop_and_no_retry = may_pop & ~retry_queue_valid;
  assign take_done = may_pop_and_no_retry & done_queue_valid;
  assign take_stepped_pop = may_pop_and_no_retry & ~done_queue_valid & nowhere_queue_valid;

  // The pop.
  wire pop_valid = may_pop & (retry_queue_valid | done_queue_valid | nowhere_queue_valid);
  wire [16:0] pop_chosen =
      retry_queue_valid ? retry_queue_front :
      done_queue_valid ? done_queue_front :
      nowhere_queue_front;
  reg  [16:0] pop;
  wire [5:0] pop_packet = pop[5:0];
  wire [10:0] pop_context = pop[16:6];
  wire [5:0] pop_context_level = pop_context[5:0];
  wire [3:0] pop_context_touched = pop_context[9:6];
  wire stack_empty = ~|pop_context_level;
  wire [5:0] level_below = pop_context_level - 6'd1;
  reg  [219:0] stack_read;
  reg  [219:0] stack_read_s3;
  wire [21:0] stack_read_address_s3 = stack_read_s3[21:0];
  wire stack_read_leaf_s3 = stack_read_s3[22];
  wire stack_read_inside_s3 = stack_read_s3[23];
  wire [3:0] stack_read_mask_s3 = stack_read_s3[27:24];
  wire [191:0] stack_read_intervals_s3 = stack_read_s3[219:28];
  (* no_rw_check, ram_style = "distributed" *)
  reg  [23:0] limit0_memory [0:47];
  reg  [23:0] pop_packet_delay;
  wire [5:0] pop_packet_s2 = pop_packet_delay[5:0];
  wire [23:0] limit0_memory_read = limit0_memory[pop_packet_s2];
  reg  [23:0] limit0_memory_read_s3;
  wire [47:0] stack_read_intervals_ray0_s3 = stack_read_intervals_s3[47:0];
  wire [23:0] stack_read_intervals_ray0_near_s3 = stack_read_intervals_ray0_s3[23:0];
  wire [23:0] stack_read_intervals_ray0_far_s3 = stack_read_intervals_ray0_s3[47:24];
  wire ray0_within = ~((limit0_memory_read_s3[22:0] < stack_read_intervals_ray0_near_s3[22:0]) | limit0_memory_read_s3[23]);
  reg  ray0_untouched_s2, ray0_untouched_s3;
  wire ray0_stays = stack_read_mask_s3[0] & (ray0_within | ray0_untouched_s3);
  wire ray0_far_or_limit_is_less =
      (limit0_memory_read_s3[23] ^ stack_read_intervals_ray0_far_s3[23]) ? limit0_memory_read_s3[23] :
      ((limit0_memory_read_s3[22:0] < stack_read_intervals_ray0_far_s3[22:0]) ^ limit0_memory_read_s3[23]);
  wire [23:0] ray0_far_or_limit =
      ray0_far_or_limit_is_less ? limit0_memory_read_s3 :
      stack_read_intervals_ray0_far_s3;
  reg  pop_context_touched_ray0_s2, pop_context_touched_ray0_s3;
  wire [23:0] ray0_far =
      pop_context_touched_ray0_s3 ? ray0_far_or_limit :
      stack_read_intervals_ray0_far_s3;
  reg  ray0_stays_s4;
  reg  [47:0] ray0_popped_interval_s4;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [23:0] limit1_memory [0:47];
  wire [23:0] limit1_memory_read = limit1_memory[pop_packet_s2];
  reg  [23:0] limit1_memory_read_s3;
  wire [47:0] stack_read_intervals_ray1_s3 = stack_read_intervals_s3[95:48];
  wire [23:0] stack_read_intervals_ray1_near_s3 = stack_read_intervals_ray1_s3[23:0];
  wire [23:0] stack_read_intervals_ray1_far_s3 = stack_read_intervals_ray1_s3[47:24];
  wire ray1_within = ~((limit1_memory_read_s3[22:0] < stack_read_intervals_ray1_near_s3[22:0]) | limit1_memory_read_s3[23]);
  reg  ray1_untouched_s2, ray1_untouched_s3;
  wire ray1_stays = stack_read_mask_s3[1] & (ray1_within | ray1_untouched_s3);
  wire ray1_far_or_limit_is_less =
      (limit1_memory_read_s3[23] ^ stack_read_intervals_ray1_far_s3[23]) ? limit1_memory_read_s3[23] :
      ((limit1_memory_read_s3[22:0] < stack_read_intervals_ray1_far_s3[22:0]) ^ limit1_memory_read_s3[23]);
  wire [23:0] ray1_far_or_limit =
      ray1_far_or_limit_is_less ? limit1_memory_read_s3 :
      stack_read_intervals_ray1_far_s3;
  reg  pop_context_touched_ray1_s2, pop_context_touched_ray1_s3;
  wire [23:0] ray1_far =
      pop_context_touched_ray1_s3 ? ray1_far_or_limit :
      stack_read_intervals_ray1_far_s3;
  reg  ray1_stays_s4;
  reg  [47:0] ray1_popped_interval_s4;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [23:0] limit2_memory [0:47];
  wire [23:0] limit2_memory_read = limit2_memory[pop_packet_s2];
  reg  [23:0] limit2_memory_read_s3;
  wire [47:0] stack_read_intervals_ray2_s3 = stack_read_intervals_s3[143:96];
  wire [23:0] stack_read_intervals_ray2_near_s3 = stack_read_intervals_ray2_s3[23:0];
  wire [23:0] stack_read_intervals_ray2_far_s3 = stack_read_intervals_ray2_s3[47:24];
  wire ray2_within = ~((limit2_memory_read_s3[22:0] < stack_read_intervals_ray2_near_s3[22:0]) | limit2_memory_read_s3[23]);
  reg  ray2_untouched_s2, ray2_untouched_s3;
  wire ray2_stays = stack_read_mask_s3[2] & (ray2_within | ray2_untouched_s3);
  wire ray2_far_or_limit_is_less =
      (limit2_memory_read_s3[23] ^ stack_read_intervals_ray2_far_s3[23]) ? limit2_memory_read_s3[23] :
      ((limit2_memory_read_s3[22:0] < stack_read_intervals_ray2_far_s3[22:0]) ^ limit2_memory_read_s3[23]);
  wire [23:0] ray2_far_or_limit =
      ray2_far_or_limit_is_less ? limit2_memory_read_s3 :
      stack_read_intervals_ray2_far_s3;
  reg  pop_context_touched_ray2_s2, pop_context_touched_ray2_s3;
  wire [23:0] ray2_far =
      pop_context_touched_ray2_s3 ? ray2_far_or_limit :
      stack_read_intervals_ray2_far_s3;
  reg  ray2_stays_s4;
  reg  [47:0] ray2_popped_interval_s4;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [23:0] limit3_memory [0:47];
  wire [23:0] limit3_memory_read = limit3_memory[pop_packet_s2];
  reg  [23:0] limit3_memory_read_s3;
  wire [47:0] stack_read_intervals_ray3_s3 = stack_read_intervals_s3[191:144];
  wire [23:0] stack_read_intervals_ray3_near_s3 = stack_read_intervals_ray3_s3[23:0];
  wire [23:0] stack_read_intervals_ray3_far_s3 = stack_read_intervals_ray3_s3[47:24];
  wire ray3_within = ~((limit3_memory_read_s3[22:0] < stack_read_intervals_ray3_near_s3[22:0]) | limit3_memory_read_s3[23]);
  reg  ray3_untouched_s2, ray3_untouched_s3;
  wire ray3_stays = stack_read_mask_s3[3] & (ray3_within | ray3_untouched_s3);
  wire ray3_far_or_limit_is_less =
      (limit3_memory_read_s3[23] ^ stack_read_intervals_ray3_far_s3[23]) ? limit3_memory_read_s3[23] :
      ((limit3_memory_read_s3[22:0] < stack_read_intervals_ray3_far_s3[22:0]) ^ limit3_memory_read_s3[23]);
  wire [23:0] ray3_far_or_limit =
      ray3_far_or_limit_is_less ? limit3_memory_read_s3 :
      stack_read_intervals_ray3_far_s3;
  reg  pop_context_touched_ray3_s2, pop_context_touched_ray3_s3;
  wire [23:0] ray3_far =
      pop_context_touched_ray3_s3 ? ray3_far_or_limit :
      stack_read_intervals_ray3_far_s3;
  reg  ray3_stays_s4;
  reg  [47:0] ray3_popped_interval_s4;
  wire [3:0] stay_mask = {ray3_stays_s4, ray2_stays_s4, ray1_stays_s4, ray0_stays_s4};
  reg  [3:0] pop_out_mask;
  reg  [47:0] ray0_popped_interval_s5;
  reg  [47:0] ray1_popped_interval_s5;
  reg  [47:0] ray2_popped_interval_s5;
  reg  [47:0] ray3_popped_interval_s5;
  reg  [4:0] pop_valid_delay;
  wire pop_done = pop_valid_delay[4];
  wire [5:0] pop_out_packet = pop_packet_delay[23:18];
  reg  [3:0] stack_empty_delay;
  wire stack_empty_s5 = stack_empty_delay[3];
  reg  [15:0] pop_context_touched_delay;
  wire [3:0] pop_context_touched_s5 = pop_context_touched_delay[15:12];
  reg  [23:0] level_below_delay;
  wire [5:0] level_below_s5 = level_below_delay[23:18];
  reg  [21:0] stack_read_address_s4, stack_read_address_s5;
  reg  stack_read_leaf_s4, stack_read_leaf_s5;
  reg  stack_read_inside_s4, stack_read_inside_s5;
  wire [10:0] pop_out_context = {stack_read_inside_s5, pop_context_touched_s5, level_below_s5};
  wire pop_has_entry = pop_done & ~stack_empty_s5;
  wire pop_any_stays = |pop_out_mask;
  wire pop_goes_on = pop_has_entry & pop_any_stays;
  wire pop_dropped = pop_has_entry & ~pop_any_stays;

  // The start, in the scene or in an object: rays arrive one by one, the last one starts the packet
  // at the root. No pop ends while one arrives. Rays of the world and of an object's space may
  // alternate.
  wire [3:0] bit_in = {
      setup_enters & setup_ray_is_3,
      setup_enters & setup_ray_is_2,
      setup_enters & setup_ray_is_1,
      setup_enters & setup_ray_is_0
    };
  reg  [3:0] gathered;
  reg  [3:0] gathered_object;
  wire [3:0] gathered_so_far =
      setup_first ? 4'd0 :
      setup_object ? gathered_object :
      gathered;
  wire [3:0] start_mask = gathered_so_far | bit_in;

  always @(posedge clk) begin
    if (setup_valid & ~setup_object) gathered <= start_mask;
    if (setup_valid & setup_object) gathered_object <= start_mask;
  end

  wire start = setup_valid & setup_last;
  wire any_enters = |start_mask;
  wire start_goes = start & any_enters;
  wire start_nowhere = start & ~any_enters;
  wire [25:0] root_link = root[25:0];
  wire root_left_leaf = root[26];
  assign retry_push = pop_dropped | (start_nowhere & setup_object);
  assign retry_item =
      setup_valid ? {object_context, setup_packet} :
      {pop_out_context, pop_out_packet};
  assign popped_packet = setup_valid ? setup_packet : pop_out_packet;
  wire entered = start_goes | pop_goes_on;
  assign popped_mask_write = entered;
  assign popped_mask = setup_valid ? start_mask : pop_out_mask;
  wire [47:0] setup_interval = {setup_far, setup_near};
  assign popped_write0 = setup_of_ray0 | pop_goes_on;
  assign popped_interval0 = setup_valid ? setup_interval : ray0_popped_interval_s5;
  assign popped_write1 = setup_of_ray1 | pop_goes_on;
  assign popped_interval1 = setup_valid ? setup_interval : ray1_popped_interval_s5;
  assign popped_write2 = setup_of_ray2 | pop_goes_on;
  assign popped_interval2 = setup_valid ? setup_interval : ray2_popped_interval_s5;
  assign popped_write3 = setup_of_ray3 | pop_goes_on;
  assign popped_interval3 = setup_valid ? setup_interval : ray3_popped_interval_s5;
  wire entering_leaf =
      setup_valid ? (setup_object ? object_leaf : root_left_leaf) :
      stack_read_leaf_s5;
  wire [21:0] entering_address =
      setup_valid ? (setup_object ? object_address : root_link[21:0]) :
      stack_read_address_s5;
  wire [10:0] entering_context =
      setup_valid ? (setup_object ? object_context : 11'd0) :
      pop_out_context;

  // Nodes to fetch: after steps, and after pops and starts.
  wire take_step_item;
  wire take_pop_item;
  wire [38:0] step_queue_data = {next_context_s16, first_address_s16, step_packet};

  wire step_queue_valid;
  wire [38:0] step_queue_front;
  dynrt_fifo_39x48 step_queue (
    .clk(clk),
    .rst(rst),
    .push(stepped_write & ~first_leaf_s16),
    .data(step_queue_data),
    .pop(take_step_item),
    .valid(step_queue_valid),
    .front(step_queue_front)
  );

  wire [38:0] entered_queue_data = {entering_context, entering_address, popped_packet};

  wire entered_queue_valid;
  wire [38:0] entered_queue_front;
  dynrt_fifo_39x48 entered_queue (
    .clk(clk),
    .rst(rst),
    .push(entered & ~entering_leaf),
    .data(entered_queue_data),
    .pop(take_pop_item),
    .valid(entered_queue_valid),
    .front(entered_queue_front)
  );

  wire node_wanted = step_queue_valid | entered_queue_valid;
  reg  request_waits;
  reg  request_waiting_choice;
  wire request_choice = request_waits ? request_waiting_choice : step_queue_valid;

  always @(posedge clk) begin
    if (rst) request_waits <= 1'b0; else request_waits <= node_wanted & ~node_request_ready;
    request_waiting_choice <= request_choice;
  end

  assign request_item = request_choice ? step_queue_front : entered_queue_front;
  assign request_popped = ~request_choice;
  assign request_fire = node_wanted & node_request_ready;
  assign take_step_item = node_request_ready & request_choice;
  assign take_pop_item = node_request_ready & ~request_choice & entered_queue_valid;
  wire request_item_context_inside = request_item_context[10];

  // Leaves to hand over: after steps, and after pops and starts.
  wire take_step_leaf;
  wire take_pop_leaf;
  wire [42:0] step_leaf_queue_data = {
      first_mask_s16,
      next_context_s16,
      first_address_s16,
      step_packet
    };

  wire step_leaf_queue_valid;
  wire [42:0] step_leaf_queue_front;
  dynrt_block_fifo_43x48 step_leaf_queue (
    .clk(clk),
    .rst(rst),
    .push(stepped_write & first_leaf_s16),
    .data(step_leaf_queue_data),
    .pop(take_step_leaf),
    .valid(step_leaf_queue_valid),
    .front(step_leaf_queue_front)
  );

  wire [42:0] entered_leaf_queue_data = {
      popped_mask,
      entering_context,
      entering_address,
      popped_packet
    };

  wire entered_leaf_queue_valid;
  wire [42:0] entered_leaf_queue_front;
  dynrt_block_fifo_43x48 entered_leaf_queue (
    .clk(clk),
    .rst(rst),
    .push(entered & entering_leaf),
    .data(entered_leaf_queue_data),
    .pop(take_pop_leaf),
    .valid(entered_leaf_queue_valid),
    .front(entered_leaf_queue_front)
  );

  wire leaf_wanted = step_leaf_queue_valid | entered_leaf_queue_valid;
  reg  leaf_waits;
  reg  leaf_waiting_choice;
  wire leaf_choice = leaf_waits ? leaf_waiting_choice : step_leaf_queue_valid;

  always @(posedge clk) begin
    if (rst) leaf_waits <= 1'b0; else leaf_waits <= leaf_wanted & ~leaf_ready;
    leaf_waiting_choice <= leaf_choice;
  end

  wire [42:0] leaf_front = leaf_choice ? step_leaf_queue_front : entered_leaf_queue_front;
  assign take_step_leaf = leaf_ready & leaf_choice;
  assign take_pop_leaf = leaf_ready & ~leaf_choice & entered_leaf_queue_valid;
  assign leaf_packet = leaf_front[5:0];
  assign leaf_address = leaf_front[27:6];
  assign leaf_context = leaf_front[38:28];
  assign leaf_mask = leaf_front[42:39];

  // Memories.
  always @(posedge clk) begin
    if (setup_of_ray0) ray0_memory[setup_level_packet] <= setup_word;
    ray0_memory_read <= ray0_memory[node_response_tag];
  end

  always @(posedge clk) begin
    if (setup_of_ray1) ray1_memory[setup_level_packet] <= setup_word;
    ray1_memory_read <= ray1_memory[node_response_tag];
  end

  always @(posedge clk) begin
    if (setup_of_ray2) ray2_memory[setup_level_packet] <= setup_word;
    ray2_memory_read <= ray2_memory[node_response_tag];
  end

  always @(posedge clk) begin
    if (setup_of_ray3) ray3_memory[setup_level_packet] <= setup_word;
    ray3_memory_read <= ray3_memory[node_response_tag];
  end

  always @(posedge clk) begin
    if (request_fire) request_memory[request_item_packet] <= {request_popped, request_item[38:6]};
  end

  always @(posedge clk) begin
    if (stepped_write) stepped_memory[stepped_packet] <= {stepped_mask, stepped_intervals};
    stepped_memory_read <= stepped_memory[packet_s10];
  end

  always @(posedge clk) begin
    if (popped_mask_write) popped_mask_memory[popped_packet] <= popped_mask;
  end

  always @(posedge clk) begin
    if (popped_write0) popped0_memory[popped_packet] <= popped_interval0;
    popped0_memory_read <= popped0_memory[packet_s10];
  end

  always @(posedge clk) begin
    if (popped_write1) popped1_memory[popped_packet] <= popped_interval1;
    popped1_memory_read <= popped1_memory[packet_s10];
  end

  always @(posedge clk) begin
    if (popped_write2) popped2_memory[popped_packet] <= popped_interval2;
    popped2_memory_read <= popped2_memory[packet_s10];
  end

  always @(posedge clk) begin
    if (popped_write3) popped3_memory[popped_packet] <= popped_interval3;
    popped3_memory_read <= popped3_memory[packet_s10];
  end

  always @(posedge clk) begin
    if (stack_write) stack[{step_packet, level_before_s16[4:0]}] <= stack_write_data_s16;
    stack_read <= stack[{pop_packet, level_below[4:0]}];
  end

  always @(posedge clk) begin
    if (limit_valid & (limit_ray == 2'd0)) limit0_memory[limit_packet] <= limit_value;
  end

  always @(posedge clk) begin
    if (limit_valid & (limit_ray == 2'd1)) limit1_memory[limit_packet] <= limit_value;
  end

  always @(posedge clk) begin
    if (limit_valid & (limit_ray == 2'd2)) limit2_memory[limit_packet] <= limit_value;
  end

  always @(posedge clk) begin
    if (limit_valid & (limit_ray == 2'd3)) limit3_memory[limit_packet] <= limit_value;
  end

  // Pipeline registers.
  always @(posedge clk) begin
    // Pipeline 1, stage 1
    left_axis_is_1_s1 <= left_axis == 2'd1;
    left_axis_is_0_s1 <= left_axis == 2'd0;
    right_axis_is_1_s1 <= right_axis == 2'd1;
    right_axis_is_0_s1 <= right_axis == 2'd0;
    left_lo_s1 <= left_lo;
    left_hi_s1 <= left_hi;
    right_lo_s1 <= right_lo;
    right_hi_s1 <= right_hi;

    // Pipeline 1, stage 2
    ray0_memory_read_s2 <= ray0_memory_read;
    ray1_memory_read_s2 <= ray1_memory_read;
    ray2_memory_read_s2 <= ray2_memory_read;
    ray3_memory_read_s2 <= ray3_memory_read;
    left_axis_is_1_s2 <= left_axis_is_1_s1;
    left_axis_is_0_s2 <= left_axis_is_0_s1;
    right_axis_is_1_s2 <= right_axis_is_1_s1;
    right_axis_is_0_s2 <= right_axis_is_0_s1;
    left_lo_s2 <= left_lo_s1;
    left_hi_s2 <= left_hi_s1;
    right_lo_s2 <= right_lo_s1;
    right_hi_s2 <= right_hi_s1;

    // Pipeline 1, stage 3
    ray0_left_sign_s3 <= ray0_left_sign;
    ray0_left_origin_s3 <= ray0_left_origin;
    ray0_left_reciprocal_s3 <= ray0_left_reciprocal;
    ray0_right_sign_s3 <= ray0_right_sign;
    ray0_right_origin_s3 <= ray0_right_origin;
    ray0_right_reciprocal_s3 <= ray0_right_reciprocal;
    left_lo_s3 <= left_lo_s2;
    left_hi_s3 <= left_hi_s2;
    right_lo_s3 <= right_lo_s2;
    right_hi_s3 <= right_hi_s2;
    ray1_left_sign_s3 <= ray1_left_sign;
    ray1_left_origin_s3 <= ray1_left_origin;
    ray1_left_reciprocal_s3 <= ray1_left_reciprocal;
    ray1_right_sign_s3 <= ray1_right_sign;
    ray1_right_origin_s3 <= ray1_right_origin;
    ray1_right_reciprocal_s3 <= ray1_right_reciprocal;
    ray2_left_sign_s3 <= ray2_left_sign;
    ray2_left_origin_s3 <= ray2_left_origin;
    ray2_left_reciprocal_s3 <= ray2_left_reciprocal;
    ray2_right_sign_s3 <= ray2_right_sign;
    ray2_right_origin_s3 <= ray2_right_origin;
    ray2_right_reciprocal_s3 <= ray2_right_reciprocal;
    ray3_left_sign_s3 <= ray3_left_sign;
    ray3_left_origin_s3 <= ray3_left_origin;
    ray3_left_reciprocal_s3 <= ray3_left_reciprocal;
    ray3_right_sign_s3 <= ray3_right_sign;
    ray3_right_origin_s3 <= ray3_right_origin;
    ray3_right_reciprocal_s3 <= ray3_right_reciprocal;

    // Pipeline 1, stage 12
    request_memory_read_s12 <= request_memory_read;
    stepped_memory_read_s12 <= stepped_memory_read;
    popped_mask_memory_read_s12 <= popped_mask_memory_read;
    popped0_memory_read_s12 <= popped0_memory_read;
    popped1_memory_read_s12 <= popped1_memory_read;
    popped2_memory_read_s12 <= popped2_memory_read;
    popped3_memory_read_s12 <= popped3_memory_read;

    // Pipeline 1, stage 13
    request_memory_read_context_s13 <= request_memory_read_context_s12;

    // Pipeline 1, stage 14
    request_memory_read_context_s14 <= request_memory_read_context_s13;

    // Pipeline 1, stage 15
    request_memory_read_context_s15 <= request_memory_read_context_s14;

    // Pipeline 1, stage 16
    goes_on_s16 <= goes_on;
    first_leaf_s16 <= first_leaf;
    first_address_s16 <= first_address;
    next_context_s16 <= next_context;
    first_mask_s16 <= first_mask;
    first_intervals_s16 <= first_intervals;
    if (rst) pushes_s16 <= 1'b0; else pushes_s16 <= pushes;
    level_before_s16 <= level_before;
    stack_write_data_s16 <= stack_write_data;
    watch_step_left <= to_left;
    watch_step_right <= to_right;
    watch_step_left_first <= left_first;
    watch_step_left_intervals <= left_intervals;
    watch_step_right_intervals <= right_intervals;

    // Pipeline 2, stage 1
    pop <= pop_chosen;

    // Pipeline 2, stage 2
    ray0_untouched_s2 <= ~pop_context_touched[0];
    pop_context_touched_ray0_s2 <= pop_context_touched[0];
    ray1_untouched_s2 <= ~pop_context_touched[1];
    pop_context_touched_ray1_s2 <= pop_context_touched[1];
    ray2_untouched_s2 <= ~pop_context_touched[2];
    pop_context_touched_ray2_s2 <= pop_context_touched[2];
    ray3_untouched_s2 <= ~pop_context_touched[3];
    pop_context_touched_ray3_s2 <= pop_context_touched[3];

    // Pipeline 2, stage 3
    stack_read_s3 <= stack_read;
    limit0_memory_read_s3 <= limit0_memory_read;
    ray0_untouched_s3 <= ray0_untouched_s2;
    pop_context_touched_ray0_s3 <= pop_context_touched_ray0_s2;
    limit1_memory_read_s3 <= limit1_memory_read;
    ray1_untouched_s3 <= ray1_untouched_s2;
    pop_context_touched_ray1_s3 <= pop_context_touched_ray1_s2;
    limit2_memory_read_s3 <= limit2_memory_read;
    ray2_untouched_s3 <= ray2_untouched_s2;
    pop_context_touched_ray2_s3 <= pop_context_touched_ray2_s2;
    limit3_memory_read_s3 <= limit3_memory_read;
    ray3_untouched_s3 <= ray3_untouched_s2;
    pop_context_touched_ray3_s3 <= pop_context_touched_ray3_s2;

    // Pipeline 2, stage 4
    ray0_stays_s4 <= ray0_stays;
    ray0_popped_interval_s4 <= {ray0_far, stack_read_intervals_ray0_near_s3};
    ray1_stays_s4 <= ray1_stays;
    ray1_popped_interval_s4 <= {ray1_far, stack_read_intervals_ray1_near_s3};
    ray2_stays_s4 <= ray2_stays;
    ray2_popped_interval_s4 <= {ray2_far, stack_read_intervals_ray2_near_s3};
    ray3_stays_s4 <= ray3_stays;
    ray3_popped_interval_s4 <= {ray3_far, stack_read_intervals_ray3_near_s3};
    stack_read_address_s4 <= stack_read_address_s3;
    stack_read_leaf_s4 <= stack_read_leaf_s3;
    stack_read_inside_s4 <= stack_read_inside_s3;

    // Pipeline 2, stage 5
    pop_out_mask <= stay_mask;
    ray0_popped_interval_s5 <= ray0_popped_interval_s4;
    ray1_popped_interval_s5 <= ray1_popped_interval_s4;
    ray2_popped_interval_s5 <= ray2_popped_interval_s4;
    ray3_popped_interval_s5 <= ray3_popped_interval_s4;
    stack_read_address_s5 <= stack_read_address_s4;
    stack_read_leaf_s5 <= stack_read_leaf_s4;
    stack_read_inside_s5 <= stack_read_inside_s4;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    packet_delay <= {packet_delay[89:0], packet};
    request_memory_read_address_delay <= {request_memory_read_address_delay[65:0], request_memory_read_address_s12};
    left_leaf_delay <= {left_leaf_delay[13:0], left_leaf};
    link_delay <= {link_delay[307:0], link};
    right_leaf_delay <= {right_leaf_delay[13:0], right_leaf};
    right_inner_address_delay <= {right_inner_address_delay[307:0], left_leaf ? link : link_after};
    if (rst) node_response_valid_delay <= 16'd0; else node_response_valid_delay <= {node_response_valid_delay[14:0], node_response_valid};
    pop_packet_delay <= {pop_packet_delay[17:0], pop_packet};
    if (rst) pop_valid_delay <= 5'd0; else pop_valid_delay <= {pop_valid_delay[3:0], pop_valid};
    stack_empty_delay <= {stack_empty_delay[2:0], stack_empty};
    pop_context_touched_delay <= {pop_context_touched_delay[11:0], pop_context_touched};
    level_below_delay <= {level_below_delay[17:0], level_below};
  end

  assign node_request_valid = node_wanted;
  assign node_request_tag = {request_item_context_inside, request_item_packet};
  assign leaf_valid = leaf_wanted;
  assign finished_valid = (start_nowhere & ~setup_object) | (pop_done & stack_empty_s5);
  assign finished_packet = popped_packet;
  assign finished_touched = setup_valid ? 4'd0 : pop_context_touched_s5;
  assign step_taken = step_valid;
  assign stack_high_water = high_water;
  assign stack_overflow = overflow;
  assign watch_step_packet = step_packet;

  // What nothing reads.
  wire unused = &{
    1'b0,
    root[31:27],
    request_item_context[9:0],
    node_response_data_link[25:22],
    pop_context[10],
    root_link[25:22]
  };

endmodule

`default_nettype wire
