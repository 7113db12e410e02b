// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_triangle_box: a ray's interval in a triangle's own box, by the very plane distances of traversal,
// and whether the triangle is degenerate.
// Latency: 8 to 16 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_triangle_box (
  input  wire        clk,

  // The triangle's vertices
  input  wire [23:0] v0_x,
  input  wire [23:0] v0_y,
  input  wire [23:0] v0_z,
  input  wire [23:0] v1_x,
  input  wire [23:0] v1_y,
  input  wire [23:0] v1_z,
  input  wire [23:0] v2_x,
  input  wire [23:0] v2_y,
  input  wire [23:0] v2_z,

  // The ray
  input  wire [23:0] origin_x,
  input  wire [23:0] origin_y,
  input  wire [23:0] origin_z,
  input  wire [23:0] reciprocal_x,
  input  wire [23:0] reciprocal_y,
  input  wire [23:0] reciprocal_z,
  input  wire [2:0]  signs,

  // While it accumulates: sums, whose operands are given at any time
  input  wire        accumulate,
  input  wire [23:0] sum_a_0,
  input  wire [23:0] sum_b_0,
  input  wire [23:0] sum_a_1,
  input  wire [23:0] sum_b_1,
  input  wire [23:0] sum_a_2,
  input  wire [23:0] sum_b_2,
  input  wire [23:0] sum_a_3,
  input  wire [23:0] sum_b_3,
  input  wire [23:0] sum_a_4,
  input  wire [23:0] sum_b_4,
  input  wire [23:0] sum_a_5,
  input  wire [23:0] sum_b_5,
  output wire [23:0] sum_0,
  output wire [23:0] sum_1,
  output wire [23:0] sum_2,
  output wire [23:0] sum_3,
  output wire [23:0] sum_4,
  output wire [23:0] sum_5,

  // The interval that the box clips
  input  wire [23:0] window_near,
  input  wire [23:0] window_far,

  // The interval, and whether the box alone makes the ray miss
  output reg  [23:0] box_near,
  output reg  [23:0] box_far,
  output wire        box_misses
);

  // The box on the x axis.
  wire lo01_x_is_less = (v1_x[23] ^ v0_x[23]) ? v1_x[23] : ((v1_x[22:0] < v0_x[22:0]) ^ v1_x[23]);
  wire [23:0] lo01_x = lo01_x_is_less ? v1_x : v0_x;
  reg  [23:0] lo01_x_s1;
  wire hi01_x_is_greater = (v0_x[23] ^ v1_x[23]) ? v0_x[23] : ((v0_x[22:0] < v1_x[22:0]) ^ v0_x[23]);
  wire [23:0] hi01_x = hi01_x_is_greater ? v1_x : v0_x;
  reg  [23:0] hi01_x_s1;
  reg  [22:0] v2_x_magnitude_s1;
  reg  v2_x_sign_s1;
  wire lo_x_is_less =
      (v2_x_sign_s1 ^ lo01_x_s1[23]) ? v2_x_sign_s1 :
      ((v2_x_magnitude_s1 < lo01_x_s1[22:0]) ^ v2_x_sign_s1);
  reg  [23:0] v2_x_s1;
  wire [23:0] lo_x = lo_x_is_less ? v2_x_s1 : lo01_x_s1;
  reg  [23:0] lo_x_s2;
  wire hi_x_is_greater =
      (hi01_x_s1[23] ^ v2_x_sign_s1) ? hi01_x_s1[23] :
      ((hi01_x_s1[22:0] < v2_x_magnitude_s1) ^ hi01_x_s1[23]);
  wire [23:0] hi_x = hi_x_is_greater ? v2_x_s1 : hi01_x_s1;
  reg  [23:0] hi_x_s2;
  wire flat_x = (lo_x_s2 == hi_x_s2) | ((~|lo_x_s2[22:16]) & (~|hi_x_s2[22:16]));
  reg  flat_x_s3;
  wire v0_x_is_zero = ~|v0_x[22:16];
  wire v1_x_is_zero = ~|v1_x[22:16];
  wire same01_x = (v0_x == v1_x) | (v0_x_is_zero & v1_x_is_zero);
  reg  same01_x_s1;
  wire v2_x_is_zero = ~|v2_x[22:16];
  wire same12_x = (v1_x == v2_x) | (v1_x_is_zero & v2_x_is_zero);
  reg  same12_x_s1;
  wire same20_x = (v2_x == v0_x) | (v2_x_is_zero & v0_x_is_zero);
  reg  same20_x_s1;

  // The box on the y axis.
  wire lo01_y_is_less = (v1_y[23] ^ v0_y[23]) ? v1_y[23] : ((v1_y[22:0] < v0_y[22:0]) ^ v1_y[23]);
  wire [23:0] lo01_y = lo01_y_is_less ? v1_y : v0_y;
  reg  [23:0] lo01_y_s1;
  wire hi01_y_is_greater = (v0_y[23] ^ v1_y[23]) ? v0_y[23] : ((v0_y[22:0] < v1_y[22:0]) ^ v0_y[23]);
  wire [23:0] hi01_y = hi01_y_is_greater ? v1_y : v0_y;
  reg  [23:0] hi01_y_s1;
  reg  [22:0] v2_y_magnitude_s1;
  reg  v2_y_sign_s1;
  wire lo_y_is_less =
      (v2_y_sign_s1 ^ lo01_y_s1[23]) ? v2_y_sign_s1 :
      ((v2_y_magnitude_s1 < lo01_y_s1[22:0]) ^ v2_y_sign_s1);
  reg  [23:0] v2_y_s1;
  wire [23:0] lo_y = lo_y_is_less ? v2_y_s1 : lo01_y_s1;
  reg  [23:0] lo_y_s2;
  wire hi_y_is_greater =
      (hi01_y_s1[23] ^ v2_y_sign_s1) ? hi01_y_s1[23] :
      ((hi01_y_s1[22:0] < v2_y_magnitude_s1) ^ hi01_y_s1[23]);
  wire [23:0] hi_y = hi_y_is_greater ? v2_y_s1 : hi01_y_s1;
  reg  [23:0] hi_y_s2;
  wire flat_y = (lo_y_s2 == hi_y_s2) | ((~|lo_y_s2[22:16]) & (~|hi_y_s2[22:16]));
  reg  flat_y_s3;
  wire v0_y_is_zero = ~|v0_y[22:16];
  wire v1_y_is_zero = ~|v1_y[22:16];
  wire same01_y = (v0_y == v1_y) | (v0_y_is_zero & v1_y_is_zero);
  reg  same01_y_s1;
  wire v2_y_is_zero = ~|v2_y[22:16];
  wire same12_y = (v1_y == v2_y) | (v1_y_is_zero & v2_y_is_zero);
  reg  same12_y_s1;
  wire same20_y = (v2_y == v0_y) | (v2_y_is_zero & v0_y_is_zero);
  reg  same20_y_s1;

  // The box on the z axis.
  wire lo01_z_is_less = (v1_z[23] ^ v0_z[23]) ? v1_z[23] : ((v1_z[22:0] < v0_z[22:0]) ^ v1_z[23]);
  wire [23:0] lo01_z = lo01_z_is_less ? v1_z : v0_z;
  reg  [23:0] lo01_z_s1;
  wire hi01_z_is_greater = (v0_z[23] ^ v1_z[23]) ? v0_z[23] : ((v0_z[22:0] < v1_z[22:0]) ^ v0_z[23]);
  wire [23:0] hi01_z = hi01_z_is_greater ? v1_z : v0_z;
  reg  [23:0] hi01_z_s1;
  reg  [22:0] v2_z_magnitude_s1;
  reg  v2_z_sign_s1;
  wire lo_z_is_less =
      (v2_z_sign_s1 ^ lo01_z_s1[23]) ? v2_z_sign_s1 :
      ((v2_z_magnitude_s1 < lo01_z_s1[22:0]) ^ v2_z_sign_s1);
  reg  [23:0] v2_z_s1;
  wire [23:0] lo_z = lo_z_is_less ? v2_z_s1 : lo01_z_s1;
  reg  [23:0] lo_z_s2;
  wire hi_z_is_greater =
      (hi01_z_s1[23] ^ v2_z_sign_s1) ? hi01_z_s1[23] :
      ((hi01_z_s1[22:0] < v2_z_magnitude_s1) ^ hi01_z_s1[23]);
  wire [23:0] hi_z = hi_z_is_greater ? v2_z_s1 : hi01_z_s1;
  reg  [23:0] hi_z_s2;
  wire flat_z = (lo_z_s2 == hi_z_s2) | ((~|lo_z_s2[22:16]) & (~|hi_z_s2[22:16]));
  reg  flat_z_s3;
  wire v0_z_is_zero = ~|v0_z[22:16];
  wire v1_z_is_zero = ~|v1_z[22:16];
  wire same01_z = (v0_z == v1_z) | (v0_z_is_zero & v1_z_is_zero);
  reg  same01_z_s1;
  wire v2_z_is_zero = ~|v2_z[22:16];
  wire same12_z = (v1_z == v2_z) | (v1_z_is_zero & v2_z_is_zero);
  reg  same12_z_s1;
  wire same20_z = (v2_z == v0_z) | (v2_z_is_zero & v0_z_is_zero);
  reg  same20_z_s1;

  // Clipped on the x axis.
  reg  signs_x_s1, signs_x_s2;
  wire [23:0] near_x_plane =
      accumulate ? sum_a_0 :
      signs_x_s2 ? hi_x_s2 :
      lo_x_s2;
  reg  [23:0] origin_x_s1, origin_x_s2;
  wire [23:0] near_x_origin = accumulate ? {~sum_b_0[23], sum_b_0[22:0]} : origin_x_s2;
  reg  [23:0] near_x_plane_s3;
  reg  [23:0] near_x_origin_s3;

  wire [23:0] near_x_offset_y;
  dynrt_fp_sub near_x_offset (
    .clk(clk),
    .a(near_x_plane_s3),
    .b(near_x_origin_s3),
    .y(near_x_offset_y)
  );

  reg  [191:0] reciprocal_x_delay;
  wire [23:0] reciprocal_x_s8 = reciprocal_x_delay[191:168];

  wire [23:0] near_x_y;
  dynrt_fp_mul near_x (
    .clk(clk),
    .a(near_x_offset_y),
    .b(reciprocal_x_s8),
    .y(near_x_y)
  );

  wire [22:0] near_x_y_moved = near_x_y[22:0] + (near_x_y[23] ? 23'd3 : 23'h7ffffd);
  wire [15:0] near_x_y_moved_fraction = near_x_y_moved[15:0];
  wire near_x_y_is_not_zero = |near_x_y[22:16];
  wire near_x_y_steps_to_zero = near_x_y_is_not_zero & (~|(~near_x_y_moved_fraction[1:0]));
  wire [1:0] near_x_y_fraction_about_zero =
      near_x_y_steps_to_zero ? 2'd0 :
      ~near_x_y_is_not_zero ? 2'd2 :
      (~near_x_y_moved_fraction[1:0] - 2'd1);
  wire [23:0] near_x_y_stepped_about_zero = {
      ~near_x_y_steps_to_zero,
      6'd0,
      ~near_x_y_steps_to_zero,
      14'd0,
      near_x_y_fraction_about_zero
    };
  wire [23:0] near_x_y_stepped_further = {
      near_x_y[23],
      near_x_y_moved[22:16],
      near_x_y_moved_fraction & {16{~(&near_x_y_moved[22:16])}}
    };
  wire [23:0] near_x_y_stepped_number =
      (~near_x_y_is_not_zero | (~near_x_y[23] & (~|near_x_y_moved[22:16]))) ? near_x_y_stepped_about_zero :
      near_x_y_stepped_further;
  reg  [23:0] near_x_y_stepped_s12;
  wire [23:0] far_x_plane =
      accumulate ? sum_a_3 :
      signs_x_s2 ? lo_x_s2 :
      hi_x_s2;
  wire [23:0] far_x_origin = accumulate ? {~sum_b_3[23], sum_b_3[22:0]} : origin_x_s2;
  reg  [23:0] far_x_plane_s3;
  reg  [23:0] far_x_origin_s3;

  wire [23:0] far_x_offset_y;
  dynrt_fp_sub far_x_offset (
    .clk(clk),
    .a(far_x_plane_s3),
    .b(far_x_origin_s3),
    .y(far_x_offset_y)
  );

  wire [23:0] far_x_y;
  dynrt_fp_mul far_x (
    .clk(clk),
    .a(far_x_offset_y),
    .b(reciprocal_x_s8),
    .y(far_x_y)
  );

  wire [22:0] far_x_y_moved = far_x_y[22:0] + (~far_x_y[23] ? 23'd3 : 23'h7ffffd);
  wire [15:0] far_x_y_moved_fraction = far_x_y_moved[15:0];
  wire far_x_y_is_not_zero = |far_x_y[22:16];
  wire far_x_y_steps_to_zero = far_x_y_is_not_zero & (~|(~far_x_y_moved_fraction[1:0]));
  wire [1:0] far_x_y_fraction_about_zero =
      far_x_y_steps_to_zero ? 2'd0 :
      ~far_x_y_is_not_zero ? 2'd2 :
      (~far_x_y_moved_fraction[1:0] - 2'd1);
  wire [23:0] far_x_y_stepped_further = {
      far_x_y[23],
      far_x_y_moved[22:16],
      far_x_y_moved_fraction & {16{~(&far_x_y_moved[22:16])}}
    };
  wire [23:0] far_x_y_stepped_number =
      (~far_x_y_is_not_zero | (far_x_y[23] & (~|far_x_y_moved[22:16]))) ? {1'b0, 6'd0, ~far_x_y_steps_to_zero, 14'd0, far_x_y_fraction_about_zero} :
      far_x_y_stepped_further;
  reg  [23:0] far_x_y_stepped_s12;
  wire near_after_x_is_greater_unless_nan =
      (window_near[23] ^ near_x_y_stepped_s12[23]) ? window_near[23] :
      ((window_near[22:0] < near_x_y_stepped_s12[22:0]) ^ window_near[23]);
  wire near_after_x_is_greater =
      near_after_x_is_greater_unless_nan &
      ~((&near_x_y_stepped_s12[22:16]) & (|near_x_y_stepped_s12[15:0]));
  wire [23:0] near_after_x = near_after_x_is_greater ? near_x_y_stepped_s12 : window_near;
  reg  [23:0] near_after_x_s13;
  wire far_after_x_is_less =
      (far_x_y_stepped_s12[23] ^ window_far[23]) ? far_x_y_stepped_s12[23] :
      ((far_x_y_stepped_s12[22:0] < window_far[22:0]) ^ far_x_y_stepped_s12[23]);
  wire [23:0] far_after_x = far_after_x_is_less ? far_x_y_stepped_s12 : window_far;
  reg  [23:0] far_after_x_s13;

  // Clipped on the y axis.
  reg  signs_y_s1, signs_y_s2;
  wire [23:0] near_y_plane =
      accumulate ? sum_a_1 :
      signs_y_s2 ? hi_y_s2 :
      lo_y_s2;
  reg  [23:0] origin_y_s1, origin_y_s2;
  wire [23:0] near_y_origin = accumulate ? {~sum_b_1[23], sum_b_1[22:0]} : origin_y_s2;
  reg  [23:0] near_y_plane_s3;
  reg  [23:0] near_y_origin_s3;

  wire [23:0] near_y_offset_y;
  dynrt_fp_sub near_y_offset (
    .clk(clk),
    .a(near_y_plane_s3),
    .b(near_y_origin_s3),
    .y(near_y_offset_y)
  );

  reg  [191:0] reciprocal_y_delay;
  wire [23:0] reciprocal_y_s8 = reciprocal_y_delay[191:168];

  wire [23:0] near_y_y;
  dynrt_fp_mul near_y (
    .clk(clk),
    .a(near_y_offset_y),
    .b(reciprocal_y_s8),
    .y(near_y_y)
  );

  wire [22:0] near_y_y_moved = near_y_y[22:0] + (near_y_y[23] ? 23'd3 : 23'h7ffffd);
  wire [15:0] near_y_y_moved_fraction = near_y_y_moved[15:0];
  wire near_y_y_is_not_zero = |near_y_y[22:16];
  wire near_y_y_steps_to_zero = near_y_y_is_not_zero & (~|(~near_y_y_moved_fraction[1:0]));
  wire [1:0] near_y_y_fraction_about_zero =
      near_y_y_steps_to_zero ? 2'd0 :
      ~near_y_y_is_not_zero ? 2'd2 :
      (~near_y_y_moved_fraction[1:0] - 2'd1);
  wire [23:0] near_y_y_stepped_about_zero = {
      ~near_y_y_steps_to_zero,
      6'd0,
      ~near_y_y_steps_to_zero,
      14'd0,
      near_y_y_fraction_about_zero
    };
  wire [23:0] near_y_y_stepped_further = {
      near_y_y[23],
      near_y_y_moved[22:16],
      near_y_y_moved_fraction & {16{~(&near_y_y_moved[22:16])}}
    };
  wire [23:0] near_y_y_stepped_number =
      (~near_y_y_is_not_zero | (~near_y_y[23] & (~|near_y_y_moved[22:16]))) ? near_y_y_stepped_about_zero :
      near_y_y_stepped_further;
  reg  [23:0] near_y_y_stepped_s12;
  wire [23:0] far_y_plane =
      accumulate ? sum_a_4 :
      signs_y_s2 ? lo_y_s2 :
      hi_y_s2;
  wire [23:0] far_y_origin = accumulate ? {~sum_b_4[23], sum_b_4[22:0]} : origin_y_s2;
  reg  [23:0] far_y_plane_s3;
  reg  [23:0] far_y_origin_s3;

  wire [23:0] far_y_offset_y;
  dynrt_fp_sub far_y_offset (
    .clk(clk),
    .a(far_y_plane_s3),
    .b(far_y_origin_s3),
    .y(far_y_offset_y)
  );

  wire [23:0] far_y_y;
  dynrt_fp_mul far_y (
    .clk(clk),
    .a(far_y_offset_y),
    .b(reciprocal_y_s8),
    .y(far_y_y)
  );

  wire [22:0] far_y_y_moved = far_y_y[22:0] + (~far_y_y[23] ? 23'd3 : 23'h7ffffd);
  wire [15:0] far_y_y_moved_fraction = far_y_y_moved[15:0];
  wire far_y_y_is_not_zero = |far_y_y[22:16];
  wire far_y_y_steps_to_zero = far_y_y_is_not_zero & (~|(~far_y_y_moved_fraction[1:0]));
  wire [1:0] far_y_y_fraction_about_zero =
      far_y_y_steps_to_zero ? 2'd0 :
      ~far_y_y_is_not_zero ? 2'd2 :
      (~far_y_y_moved_fraction[1:0] - 2'd1);
  wire [23:0] far_y_y_stepped_further = {
      far_y_y[23],
      far_y_y_moved[22:16],
      far_y_y_moved_fraction & {16{~(&far_y_y_moved[22:16])}}
    };
  wire [23:0] far_y_y_stepped_number =
      (~far_y_y_is_not_zero | (far_y_y[23] & (~|far_y_y_moved[22:16]))) ? {1'b0, 6'd0, ~far_y_y_steps_to_zero, 14'd0, far_y_y_fraction_about_zero} :
      far_y_y_stepped_further;
  reg  [23:0] far_y_y_stepped_s12;
  reg  [22:0] near_y_y_stepped_magnitude_s13;
  reg  near_y_y_stepped_sign_s13;
  wire near_after_y_is_greater_unless_nan =
      (near_after_x_s13[23] ^ near_y_y_stepped_sign_s13) ? near_after_x_s13[23] :
      ((near_after_x_s13[22:0] < near_y_y_stepped_magnitude_s13) ^ near_after_x_s13[23]);
  reg  near_after_y_is_greater_ordered_s13;
  wire near_after_y_is_greater =
      near_after_y_is_greater_unless_nan &
      near_after_y_is_greater_ordered_s13;
  reg  [23:0] near_y_y_stepped_s13;
  wire [23:0] near_after_y = near_after_y_is_greater ? near_y_y_stepped_s13 : near_after_x_s13;
  reg  [23:0] near_after_y_s14;
  reg  [22:0] far_y_y_stepped_magnitude_s13;
  reg  far_y_y_stepped_sign_s13;
  wire far_after_y_is_less =
      (far_y_y_stepped_sign_s13 ^ far_after_x_s13[23]) ? far_y_y_stepped_sign_s13 :
      ((far_y_y_stepped_magnitude_s13 < far_after_x_s13[22:0]) ^ far_y_y_stepped_sign_s13);
  reg  [23:0] far_y_y_stepped_s13;
  wire [23:0] far_after_y = far_after_y_is_less ? far_y_y_stepped_s13 : far_after_x_s13;
  reg  [23:0] far_after_y_s14;

  // Clipped on the z axis.
  reg  signs_z_s1, signs_z_s2;
  wire [23:0] near_z_plane =
      accumulate ? sum_a_2 :
      signs_z_s2 ? hi_z_s2 :
      lo_z_s2;
  reg  [23:0] origin_z_s1, origin_z_s2;
  wire [23:0] near_z_origin = accumulate ? {~sum_b_2[23], sum_b_2[22:0]} : origin_z_s2;
  reg  [23:0] near_z_plane_s3;
  reg  [23:0] near_z_origin_s3;

  wire [23:0] near_z_offset_y;
  dynrt_fp_sub near_z_offset (
    .clk(clk),
    .a(near_z_plane_s3),
    .b(near_z_origin_s3),
    .y(near_z_offset_y)
  );

  reg  [191:0] reciprocal_z_delay;
  wire [23:0] reciprocal_z_s8 = reciprocal_z_delay[191:168];

  wire [23:0] near_z_y;
  dynrt_fp_mul near_z (
    .clk(clk),
    .a(near_z_offset_y),
    .b(reciprocal_z_s8),
    .y(near_z_y)
  );

  wire [22:0] near_z_y_moved = near_z_y[22:0] + (near_z_y[23] ? 23'd3 : 23'h7ffffd);
  wire [15:0] near_z_y_moved_fraction = near_z_y_moved[15:0];
  wire near_z_y_is_not_zero = |near_z_y[22:16];
  wire near_z_y_steps_to_zero = near_z_y_is_not_zero & (~|(~near_z_y_moved_fraction[1:0]));
  wire [1:0] near_z_y_fraction_about_zero =
      near_z_y_steps_to_zero ? 2'd0 :
      ~near_z_y_is_not_zero ? 2'd2 :
      (~near_z_y_moved_fraction[1:0] - 2'd1);
  wire [23:0] near_z_y_stepped_about_zero = {
      ~near_z_y_steps_to_zero,
      6'd0,
      ~near_z_y_steps_to_zero,
      14'd0,
      near_z_y_fraction_about_zero
    };
  wire [23:0] near_z_y_stepped_further = {
      near_z_y[23],
      near_z_y_moved[22:16],
      near_z_y_moved_fraction & {16{~(&near_z_y_moved[22:16])}}
    };
  wire [23:0] near_z_y_stepped_number =
      (~near_z_y_is_not_zero | (~near_z_y[23] & (~|near_z_y_moved[22:16]))) ? near_z_y_stepped_about_zero :
      near_z_y_stepped_further;
  reg  [23:0] near_z_y_stepped_s12;
  wire [23:0] far_z_plane =
      accumulate ? sum_a_5 :
      signs_z_s2 ? lo_z_s2 :
      hi_z_s2;
  wire [23:0] far_z_origin = accumulate ? {~sum_b_5[23], sum_b_5[22:0]} : origin_z_s2;
  reg  [23:0] far_z_plane_s3;
  reg  [23:0] far_z_origin_s3;

  wire [23:0] far_z_offset_y;
  dynrt_fp_sub far_z_offset (
    .clk(clk),
    .a(far_z_plane_s3),
    .b(far_z_origin_s3),
    .y(far_z_offset_y)
  );

  wire [23:0] far_z_y;
  dynrt_fp_mul far_z (
    .clk(clk),
    .a(far_z_offset_y),
    .b(reciprocal_z_s8),
    .y(far_z_y)
  );

  wire [22:0] far_z_y_moved = far_z_y[22:0] + (~far_z_y[23] ? 23'd3 : 23'h7ffffd);
  wire [15:0] far_z_y_moved_fraction = far_z_y_moved[15:0];
  wire far_z_y_is_not_zero = |far_z_y[22:16];
  wire far_z_y_steps_to_zero = far_z_y_is_not_zero & (~|(~far_z_y_moved_fraction[1:0]));
  wire [1:0] far_z_y_fraction_about_zero =
      far_z_y_steps_to_zero ? 2'd0 :
      ~far_z_y_is_not_zero ? 2'd2 :
      (~far_z_y_moved_fraction[1:0] - 2'd1);
  wire [23:0] far_z_y_stepped_further = {
      far_z_y[23],
      far_z_y_moved[22:16],
      far_z_y_moved_fraction & {16{~(&far_z_y_moved[22:16])}}
    };
  wire [23:0] far_z_y_stepped_number =
      (~far_z_y_is_not_zero | (far_z_y[23] & (~|far_z_y_moved[22:16]))) ? {1'b0, 6'd0, ~far_z_y_steps_to_zero, 14'd0, far_z_y_fraction_about_zero} :
      far_z_y_stepped_further;
  reg  [23:0] far_z_y_stepped_s12;
  reg  [22:0] near_z_y_stepped_magnitude_s13, near_z_y_stepped_magnitude_s14;
  reg  near_z_y_stepped_sign_s13, near_z_y_stepped_sign_s14;
  wire near_after_z_is_greater_unless_nan =
      (near_after_y_s14[23] ^ near_z_y_stepped_sign_s14) ? near_after_y_s14[23] :
      ((near_after_y_s14[22:0] < near_z_y_stepped_magnitude_s14) ^ near_after_y_s14[23]);
  reg  near_after_z_is_greater_ordered_s13, near_after_z_is_greater_ordered_s14;
  wire near_after_z_is_greater =
      near_after_z_is_greater_unless_nan &
      near_after_z_is_greater_ordered_s14;
  reg  [23:0] near_z_y_stepped_s13, near_z_y_stepped_s14;
  wire [23:0] near_after_z = near_after_z_is_greater ? near_z_y_stepped_s14 : near_after_y_s14;
  reg  [23:0] near_after_z_s15;
  reg  [22:0] far_z_y_stepped_magnitude_s13, far_z_y_stepped_magnitude_s14;
  reg  far_z_y_stepped_sign_s13, far_z_y_stepped_sign_s14;
  wire far_after_z_is_less =
      (far_z_y_stepped_sign_s14 ^ far_after_y_s14[23]) ? far_z_y_stepped_sign_s14 :
      ((far_z_y_stepped_magnitude_s14 < far_after_y_s14[22:0]) ^ far_z_y_stepped_sign_s14);
  reg  [23:0] far_z_y_stepped_s13, far_z_y_stepped_s14;
  wire [23:0] far_after_z = far_after_z_is_less ? far_z_y_stepped_s14 : far_after_y_s14;
  reg  [23:0] far_after_z_s15;

  // Degenerate: two vertices are equal, or the box is flat on two axes.
  wire any_same =
      (same01_x_s1 & same01_y_s1 & same01_z_s1) |
      (same12_x_s1 & same12_y_s1 & same12_z_s1) |
      (same20_x_s1 & same20_y_s1 & same20_z_s1);
  reg  any_same_s2, any_same_s3;
  wire any_degenerate =
      (flat_x_s3 & flat_y_s3) |
      (flat_y_s3 & flat_z_s3) |
      (flat_z_s3 & flat_x_s3) |
      any_same_s3;
  reg  [12:0] any_degenerate_delay;
  wire empty_interval_by_magnitude =
      {far_after_z_s15[22:0], 1'b0} <
      {near_after_z_s15[22:0], near_after_z_s15[23]};
  wire empty_interval =
      (far_after_z_s15[23] ^ near_after_z_s15[23]) ? far_after_z_s15[23] :
      (empty_interval_by_magnitude ^ far_after_z_s15[23]);
  reg  empty_interval_s16;
  wire any_degenerate_s16 = any_degenerate_delay[12];

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    lo01_x_s1 <= lo01_x;
    hi01_x_s1 <= hi01_x;
    v2_x_magnitude_s1 <= v2_x[22:0];
    v2_x_sign_s1 <= v2_x[23];
    v2_x_s1 <= v2_x;
    same01_x_s1 <= same01_x;
    same12_x_s1 <= same12_x;
    same20_x_s1 <= same20_x;
    lo01_y_s1 <= lo01_y;
    hi01_y_s1 <= hi01_y;
    v2_y_magnitude_s1 <= v2_y[22:0];
    v2_y_sign_s1 <= v2_y[23];
    v2_y_s1 <= v2_y;
    same01_y_s1 <= same01_y;
    same12_y_s1 <= same12_y;
    same20_y_s1 <= same20_y;
    lo01_z_s1 <= lo01_z;
    hi01_z_s1 <= hi01_z;
    v2_z_magnitude_s1 <= v2_z[22:0];
    v2_z_sign_s1 <= v2_z[23];
    v2_z_s1 <= v2_z;
    same01_z_s1 <= same01_z;
    same12_z_s1 <= same12_z;
    same20_z_s1 <= same20_z;
    signs_x_s1 <= signs[0];
    origin_x_s1 <= origin_x;
    signs_y_s1 <= signs[1];
    origin_y_s1 <= origin_y;
    signs_z_s1 <= signs[2];
    origin_z_s1 <= origin_z;

    // Stage 2
    lo_x_s2 <= lo_x;
    hi_x_s2 <= hi_x;
    lo_y_s2 <= lo_y;
    hi_y_s2 <= hi_y;
    lo_z_s2 <= lo_z;
    hi_z_s2 <= hi_z;
    signs_x_s2 <= signs_x_s1;
    origin_x_s2 <= origin_x_s1;
    signs_y_s2 <= signs_y_s1;
    origin_y_s2 <= origin_y_s1;
    signs_z_s2 <= signs_z_s1;
    origin_z_s2 <= origin_z_s1;
    any_same_s2 <= any_same;

    // Stage 3
    flat_x_s3 <= flat_x;
    flat_y_s3 <= flat_y;
    flat_z_s3 <= flat_z;
    near_x_plane_s3 <= near_x_plane;
    near_x_origin_s3 <= near_x_origin;
    far_x_plane_s3 <= far_x_plane;
    far_x_origin_s3 <= far_x_origin;
    near_y_plane_s3 <= near_y_plane;
    near_y_origin_s3 <= near_y_origin;
    far_y_plane_s3 <= far_y_plane;
    far_y_origin_s3 <= far_y_origin;
    near_z_plane_s3 <= near_z_plane;
    near_z_origin_s3 <= near_z_origin;
    far_z_plane_s3 <= far_z_plane;
    far_z_origin_s3 <= far_z_origin;
    any_same_s3 <= any_same_s2;

    // Stage 12
    near_x_y_stepped_s12 <= (&near_x_y[22:16]) ? near_x_y : near_x_y_stepped_number;
    far_x_y_stepped_s12 <= (&far_x_y[22:16]) ? far_x_y : far_x_y_stepped_number;
    near_y_y_stepped_s12 <= (&near_y_y[22:16]) ? near_y_y : near_y_y_stepped_number;
    far_y_y_stepped_s12 <= (&far_y_y[22:16]) ? far_y_y : far_y_y_stepped_number;
    near_z_y_stepped_s12 <= (&near_z_y[22:16]) ? near_z_y : near_z_y_stepped_number;
    far_z_y_stepped_s12 <= (&far_z_y[22:16]) ? far_z_y : far_z_y_stepped_number;

    // Stage 13
    near_after_x_s13 <= near_after_x;
    far_after_x_s13 <= far_after_x;
    near_y_y_stepped_magnitude_s13 <= near_y_y_stepped_s12[22:0];
    near_y_y_stepped_sign_s13 <= near_y_y_stepped_s12[23];
    near_after_y_is_greater_ordered_s13 <= ~((&near_y_y_stepped_s12[22:16]) & (|near_y_y_stepped_s12[15:0]));
    near_y_y_stepped_s13 <= near_y_y_stepped_s12;
    far_y_y_stepped_magnitude_s13 <= far_y_y_stepped_s12[22:0];
    far_y_y_stepped_sign_s13 <= far_y_y_stepped_s12[23];
    far_y_y_stepped_s13 <= far_y_y_stepped_s12;
    near_z_y_stepped_magnitude_s13 <= near_z_y_stepped_s12[22:0];
    near_z_y_stepped_sign_s13 <= near_z_y_stepped_s12[23];
    near_after_z_is_greater_ordered_s13 <= ~((&near_z_y_stepped_s12[22:16]) & (|near_z_y_stepped_s12[15:0]));
    near_z_y_stepped_s13 <= near_z_y_stepped_s12;
    far_z_y_stepped_magnitude_s13 <= far_z_y_stepped_s12[22:0];
    far_z_y_stepped_sign_s13 <= far_z_y_stepped_s12[23];
    far_z_y_stepped_s13 <= far_z_y_stepped_s12;

    // Stage 14
    near_after_y_s14 <= near_after_y;
    far_after_y_s14 <= far_after_y;
    near_z_y_stepped_magnitude_s14 <= near_z_y_stepped_magnitude_s13;
    near_z_y_stepped_sign_s14 <= near_z_y_stepped_sign_s13;
    near_after_z_is_greater_ordered_s14 <= near_after_z_is_greater_ordered_s13;
    near_z_y_stepped_s14 <= near_z_y_stepped_s13;
    far_z_y_stepped_magnitude_s14 <= far_z_y_stepped_magnitude_s13;
    far_z_y_stepped_sign_s14 <= far_z_y_stepped_sign_s13;
    far_z_y_stepped_s14 <= far_z_y_stepped_s13;

    // Stage 15
    near_after_z_s15 <= near_after_z;
    far_after_z_s15 <= far_after_z;

    // Stage 16
    empty_interval_s16 <= empty_interval;
    box_near <= near_after_z_s15;
    box_far <= far_after_z_s15;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    reciprocal_x_delay <= {reciprocal_x_delay[167:0], reciprocal_x};
    reciprocal_y_delay <= {reciprocal_y_delay[167:0], reciprocal_y};
    reciprocal_z_delay <= {reciprocal_z_delay[167:0], reciprocal_z};
    any_degenerate_delay <= {any_degenerate_delay[11:0], any_degenerate};
  end

  assign sum_0 = near_x_offset_y;
  assign sum_1 = near_y_offset_y;
  assign sum_2 = near_z_offset_y;
  assign sum_3 = far_x_offset_y;
  assign sum_4 = far_y_offset_y;
  assign sum_5 = far_z_offset_y;
  assign box_misses = empty_interval_s16 | any_degenerate_s16;

endmodule

`default_nettype wire
