// SPDX-License-Identifier: MIT OR Apache-2.0
// triangle_box: a ray's interval in a triangle's own box, by the very plane distances of traversal,
// and whether the triangle is degenerate.
// Latency: 16 clocks, one set of inputs a clock.

`default_nettype none

module triangle_box (
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

  // The interval, and whether the box alone makes the ray miss
  output reg  [23:0] box_near,
  output reg  [23:0] box_far,
  output wire        box_misses
);

  // The x axis.
  wire v1_x_22_16_is_zero = ~|v1_x[22:16];
  wire v0_x_22_16_is_zero = ~|v0_x[22:16];
  wire choice =
      (v1_x[23] ^ v0_x[23]) ? v1_x[23] :
      (({v1_x[22:0], 1'b0} < {v0_x[22:0], v0_x[23]}) ^ v1_x[23]);
  wire all_v1_x_22_16_and_any_v1_x_15_0 = (&v1_x[22:16]) & (|v1_x[15:0]);
  wire all_v0_x_22_16_and_any_v0_x_15_0 = (&v0_x[22:16]) & (|v0_x[15:0]);
  wire term =
      choice &
      ~(v1_x_22_16_is_zero & v0_x_22_16_is_zero) &
      ~(all_v1_x_22_16_and_any_v1_x_15_0 | all_v0_x_22_16_and_any_v0_x_15_0);
  wire [23:0] lo01_x = term ? v1_x : v0_x;
  reg  [23:0] lo01_x_s1;
  wire term_2 = v0_x_22_16_is_zero & v1_x_22_16_is_zero;
  wire choice_2 =
      (v0_x[23] ^ v1_x[23]) ? v0_x[23] :
      (({v0_x[22:0], 1'b0} < {v1_x[22:0], v1_x[23]}) ^ v0_x[23]);
  wire term_3 =
      choice_2 &
      ~term_2 &
      ~(all_v0_x_22_16_and_any_v0_x_15_0 | all_v1_x_22_16_and_any_v1_x_15_0);
  wire [23:0] hi01_x = term_3 ? v1_x : v0_x;
  reg  [23:0] hi01_x_s1;
  wire v2_x_22_16_is_zero = ~|v2_x[22:16];
  reg  v2_x_22_16_is_zero_s1;
  reg  [23:0] joined_s1;
  reg  v2_x_23_s1;
  wire term_4 = (joined_s1 < {lo01_x_s1[22:0], lo01_x_s1[23]}) ^ v2_x_23_s1;
  wire choice_3 = (v2_x_23_s1 ^ lo01_x_s1[23]) ? v2_x_23_s1 : term_4;
  wire all_v2_x_22_16_and_any_v2_x_15_0 = (&v2_x[22:16]) & (|v2_x[15:0]);
  reg  all_v2_x_22_16_and_any_v2_x_15_0_s1;
  wire term_5 =
      choice_3 &
      ~(v2_x_22_16_is_zero_s1 & (~|lo01_x_s1[22:16])) &
      ~(all_v2_x_22_16_and_any_v2_x_15_0_s1 | ((&lo01_x_s1[22:16]) & (|lo01_x_s1[15:0])));
  reg  [23:0] v2_x_s1;
  wire [23:0] lo_x = term_5 ? v2_x_s1 : lo01_x_s1;
  reg  [23:0] lo_x_s2;
  reg  [23:0] joined_2_s1;
  wire choice_4 =
      (hi01_x_s1[23] ^ v2_x_23_s1) ? hi01_x_s1[23] :
      (({hi01_x_s1[22:0], 1'b0} < joined_2_s1) ^ hi01_x_s1[23]);
  wire term_6 =
      choice_4 &
      ~((~|hi01_x_s1[22:16]) & v2_x_22_16_is_zero_s1) &
      ~(((&hi01_x_s1[22:16]) & (|hi01_x_s1[15:0])) | all_v2_x_22_16_and_any_v2_x_15_0_s1);
  wire [23:0] hi_x = term_6 ? v2_x_s1 : hi01_x_s1;
  reg  [23:0] hi_x_s2;
  wire term_7 = (lo_x_s2 == hi_x_s2) | ((~|lo_x_s2[22:16]) & (~|hi_x_s2[22:16]));
  wire flat_x =
      term_7 &
      ~((&lo_x_s2[22:16]) & (|lo_x_s2[15:0])) &
      ~((&hi_x_s2[22:16]) & (|hi_x_s2[15:0]));
  reg  flat_x_s3;
  wire same01_x =
      ((v0_x == v1_x) | term_2) &
      ~all_v0_x_22_16_and_any_v0_x_15_0 &
      ~all_v1_x_22_16_and_any_v1_x_15_0;
  reg  same01_x_s1;
  wire term_8 =
      ((v1_x == v2_x) | (v1_x_22_16_is_zero & v2_x_22_16_is_zero)) &
      ~all_v1_x_22_16_and_any_v1_x_15_0;
  wire same12_x = term_8 & ~all_v2_x_22_16_and_any_v2_x_15_0;
  reg  same12_x_s1;
  wire term_9 =
      ((v2_x == v0_x) | (v2_x_22_16_is_zero & v0_x_22_16_is_zero)) &
      ~all_v2_x_22_16_and_any_v2_x_15_0;
  wire same20_x = term_9 & ~all_v0_x_22_16_and_any_v0_x_15_0;
  reg  same20_x_s1;
  reg  signs_0_s1, signs_0_s2;
  wire [23:0] near_plane_x = signs_0_s2 ? hi_x_s2 : lo_x_s2;
  reg  [23:0] near_plane_x_s3;
  reg  [23:0] origin_x_s1, origin_x_s2, origin_x_s3;
  reg  [191:0] reciprocal_x_delay;
  wire [23:0] reciprocal_x_s8 = reciprocal_x_delay[191:168];

  wire [23:0] near_x_distance;
  near_distance near_x (
    .clk(clk),
    .plane(near_plane_x_s3),
    .origin(origin_x_s3),
    .reciprocal(reciprocal_x_s8),
    .distance(near_x_distance)
  );

  wire [23:0] far_plane_x = signs_0_s2 ? lo_x_s2 : hi_x_s2;
  reg  [23:0] far_plane_x_s3;

  wire [23:0] far_x_distance;
  far_distance far_x (
    .clk(clk),
    .plane(far_plane_x_s3),
    .origin(origin_x_s3),
    .reciprocal(reciprocal_x_s8),
    .distance(far_x_distance)
  );

  wire [23:0] near_after_x =
      ((&near_x_distance[22:16]) & (|near_x_distance[15:0])) ? 24'hff0000 :
      near_x_distance;
  reg  [23:0] near_after_x_s13;
  wire [23:0] far_after_x =
      ((&far_x_distance[22:16]) & (|far_x_distance[15:0])) ? 24'h7f0000 :
      far_x_distance;
  reg  [23:0] far_after_x_s13;

  // The y axis.
  wire v1_y_22_16_is_zero = ~|v1_y[22:16];
  wire v0_y_22_16_is_zero = ~|v0_y[22:16];
  wire choice_5 =
      (v1_y[23] ^ v0_y[23]) ? v1_y[23] :
      (({v1_y[22:0], 1'b0} < {v0_y[22:0], v0_y[23]}) ^ v1_y[23]);
  wire all_v1_y_22_16_and_any_v1_y_15_0 = (&v1_y[22:16]) & (|v1_y[15:0]);
  wire all_v0_y_22_16_and_any_v0_y_15_0 = (&v0_y[22:16]) & (|v0_y[15:0]);
  wire term_10 =
      choice_5 &
      ~(v1_y_22_16_is_zero & v0_y_22_16_is_zero) &
      ~(all_v1_y_22_16_and_any_v1_y_15_0 | all_v0_y_22_16_and_any_v0_y_15_0);
  wire [23:0] lo01_y = term_10 ? v1_y : v0_y;
  reg  [23:0] lo01_y_s1;
  wire term_11 = v0_y_22_16_is_zero & v1_y_22_16_is_zero;
  wire choice_6 =
      (v0_y[23] ^ v1_y[23]) ? v0_y[23] :
      (({v0_y[22:0], 1'b0} < {v1_y[22:0], v1_y[23]}) ^ v0_y[23]);
  wire term_12 =
      choice_6 &
      ~term_11 &
      ~(all_v0_y_22_16_and_any_v0_y_15_0 | all_v1_y_22_16_and_any_v1_y_15_0);
  wire [23:0] hi01_y = term_12 ? v1_y : v0_y;
  reg  [23:0] hi01_y_s1;
  wire v2_y_22_16_is_zero = ~|v2_y[22:16];
  reg  v2_y_22_16_is_zero_s1;
  reg  [23:0] joined_3_s1;
  reg  v2_y_23_s1;
  wire term_13 = (joined_3_s1 < {lo01_y_s1[22:0], lo01_y_s1[23]}) ^ v2_y_23_s1;
  wire choice_7 = (v2_y_23_s1 ^ lo01_y_s1[23]) ? v2_y_23_s1 : term_13;
  wire all_v2_y_22_16_and_any_v2_y_15_0 = (&v2_y[22:16]) & (|v2_y[15:0]);
  reg  all_v2_y_22_16_and_any_v2_y_15_0_s1;
  wire term_14 =
      choice_7 &
      ~(v2_y_22_16_is_zero_s1 & (~|lo01_y_s1[22:16])) &
      ~(all_v2_y_22_16_and_any_v2_y_15_0_s1 | ((&lo01_y_s1[22:16]) & (|lo01_y_s1[15:0])));
  reg  [23:0] v2_y_s1;
  wire [23:0] lo_y = term_14 ? v2_y_s1 : lo01_y_s1;
  reg  [23:0] lo_y_s2;
  reg  [23:0] joined_4_s1;
  wire choice_8 =
      (hi01_y_s1[23] ^ v2_y_23_s1) ? hi01_y_s1[23] :
      (({hi01_y_s1[22:0], 1'b0} < joined_4_s1) ^ hi01_y_s1[23]);
  wire term_15 =
      choice_8 &
      ~((~|hi01_y_s1[22:16]) & v2_y_22_16_is_zero_s1) &
      ~(((&hi01_y_s1[22:16]) & (|hi01_y_s1[15:0])) | all_v2_y_22_16_and_any_v2_y_15_0_s1);
  wire [23:0] hi_y = term_15 ? v2_y_s1 : hi01_y_s1;
  reg  [23:0] hi_y_s2;
  wire term_16 = (lo_y_s2 == hi_y_s2) | ((~|lo_y_s2[22:16]) & (~|hi_y_s2[22:16]));
  wire flat_y =
      term_16 &
      ~((&lo_y_s2[22:16]) & (|lo_y_s2[15:0])) &
      ~((&hi_y_s2[22:16]) & (|hi_y_s2[15:0]));
  reg  flat_y_s3;
  wire same01_y =
      ((v0_y == v1_y) | term_11) &
      ~all_v0_y_22_16_and_any_v0_y_15_0 &
      ~all_v1_y_22_16_and_any_v1_y_15_0;
  reg  same01_y_s1;
  wire term_17 =
      ((v1_y == v2_y) | (v1_y_22_16_is_zero & v2_y_22_16_is_zero)) &
      ~all_v1_y_22_16_and_any_v1_y_15_0;
  wire same12_y = term_17 & ~all_v2_y_22_16_and_any_v2_y_15_0;
  reg  same12_y_s1;
  wire term_18 =
      ((v2_y == v0_y) | (v2_y_22_16_is_zero & v0_y_22_16_is_zero)) &
      ~all_v2_y_22_16_and_any_v2_y_15_0;
  wire same20_y = term_18 & ~all_v0_y_22_16_and_any_v0_y_15_0;
  reg  same20_y_s1;
  reg  signs_1_s1, signs_1_s2;
  wire [23:0] near_plane_y = signs_1_s2 ? hi_y_s2 : lo_y_s2;
  reg  [23:0] near_plane_y_s3;
  reg  [23:0] origin_y_s1, origin_y_s2, origin_y_s3;
  reg  [191:0] reciprocal_y_delay;
  wire [23:0] reciprocal_y_s8 = reciprocal_y_delay[191:168];

  wire [23:0] near_y_distance;
  near_distance near_y (
    .clk(clk),
    .plane(near_plane_y_s3),
    .origin(origin_y_s3),
    .reciprocal(reciprocal_y_s8),
    .distance(near_y_distance)
  );

  wire [23:0] far_plane_y = signs_1_s2 ? lo_y_s2 : hi_y_s2;
  reg  [23:0] far_plane_y_s3;

  wire [23:0] far_y_distance;
  far_distance far_y (
    .clk(clk),
    .plane(far_plane_y_s3),
    .origin(origin_y_s3),
    .reciprocal(reciprocal_y_s8),
    .distance(far_y_distance)
  );

  reg  near_y_distance_22_16_is_zero_s13;
  reg  [23:0] joined_5_s13;
  reg  near_y_distance_23_s13;
  wire choice_9 =
      (near_after_x_s13[23] ^ near_y_distance_23_s13) ? near_after_x_s13[23] :
      (({near_after_x_s13[22:0], 1'b0} < joined_5_s13) ^ near_after_x_s13[23]);
  reg  term_19_s13;
  wire term_20 =
      choice_9 &
      ~((~|near_after_x_s13[22:16]) & near_y_distance_22_16_is_zero_s13) &
      ~(((&near_after_x_s13[22:16]) & (|near_after_x_s13[15:0])) | term_19_s13);
  reg  [23:0] near_y_distance_s13;
  wire [23:0] near_after_y = term_20 ? near_y_distance_s13 : near_after_x_s13;
  reg  [23:0] near_after_y_s14;
  reg  far_y_distance_22_16_is_zero_s13;
  reg  [23:0] joined_6_s13;
  reg  far_y_distance_23_s13;
  wire term_21 =
      (joined_6_s13 < {far_after_x_s13[22:0], far_after_x_s13[23]}) ^
      far_y_distance_23_s13;
  wire choice_10 = (far_y_distance_23_s13 ^ far_after_x_s13[23]) ? far_y_distance_23_s13 : term_21;
  reg  term_22_s13;
  wire term_23 =
      choice_10 &
      ~(far_y_distance_22_16_is_zero_s13 & (~|far_after_x_s13[22:16])) &
      ~(term_22_s13 | ((&far_after_x_s13[22:16]) & (|far_after_x_s13[15:0])));
  reg  [23:0] far_y_distance_s13;
  wire [23:0] far_after_y = term_23 ? far_y_distance_s13 : far_after_x_s13;
  reg  [23:0] far_after_y_s14;

  // The z axis.
  wire v1_z_22_16_is_zero = ~|v1_z[22:16];
  wire v0_z_22_16_is_zero = ~|v0_z[22:16];
  wire choice_11 =
      (v1_z[23] ^ v0_z[23]) ? v1_z[23] :
      (({v1_z[22:0], 1'b0} < {v0_z[22:0], v0_z[23]}) ^ v1_z[23]);
  wire all_v1_z_22_16_and_any_v1_z_15_0 = (&v1_z[22:16]) & (|v1_z[15:0]);
  wire all_v0_z_22_16_and_any_v0_z_15_0 = (&v0_z[22:16]) & (|v0_z[15:0]);
  wire term_24 =
      choice_11 &
      ~(v1_z_22_16_is_zero & v0_z_22_16_is_zero) &
      ~(all_v1_z_22_16_and_any_v1_z_15_0 | all_v0_z_22_16_and_any_v0_z_15_0);
  wire [23:0] lo01_z = term_24 ? v1_z : v0_z;
  reg  [23:0] lo01_z_s1;
  wire term_25 = v0_z_22_16_is_zero & v1_z_22_16_is_zero;
  wire choice_12 =
      (v0_z[23] ^ v1_z[23]) ? v0_z[23] :
      (({v0_z[22:0], 1'b0} < {v1_z[22:0], v1_z[23]}) ^ v0_z[23]);
  wire term_26 =
      choice_12 &
      ~term_25 &
      ~(all_v0_z_22_16_and_any_v0_z_15_0 | all_v1_z_22_16_and_any_v1_z_15_0);
  wire [23:0] hi01_z = term_26 ? v1_z : v0_z;
  reg  [23:0] hi01_z_s1;
  wire v2_z_22_16_is_zero = ~|v2_z[22:16];
  reg  v2_z_22_16_is_zero_s1;
  reg  [23:0] joined_7_s1;
  reg  v2_z_23_s1;
  wire term_27 = (joined_7_s1 < {lo01_z_s1[22:0], lo01_z_s1[23]}) ^ v2_z_23_s1;
  wire choice_13 = (v2_z_23_s1 ^ lo01_z_s1[23]) ? v2_z_23_s1 : term_27;
  wire all_v2_z_22_16_and_any_v2_z_15_0 = (&v2_z[22:16]) & (|v2_z[15:0]);
  reg  all_v2_z_22_16_and_any_v2_z_15_0_s1;
  wire term_28 =
      choice_13 &
      ~(v2_z_22_16_is_zero_s1 & (~|lo01_z_s1[22:16])) &
      ~(all_v2_z_22_16_and_any_v2_z_15_0_s1 | ((&lo01_z_s1[22:16]) & (|lo01_z_s1[15:0])));
  reg  [23:0] v2_z_s1;
  wire [23:0] lo_z = term_28 ? v2_z_s1 : lo01_z_s1;
  reg  [23:0] lo_z_s2;
  reg  [23:0] joined_8_s1;
  wire choice_14 =
      (hi01_z_s1[23] ^ v2_z_23_s1) ? hi01_z_s1[23] :
      (({hi01_z_s1[22:0], 1'b0} < joined_8_s1) ^ hi01_z_s1[23]);
  wire term_29 =
      choice_14 &
      ~((~|hi01_z_s1[22:16]) & v2_z_22_16_is_zero_s1) &
      ~(((&hi01_z_s1[22:16]) & (|hi01_z_s1[15:0])) | all_v2_z_22_16_and_any_v2_z_15_0_s1);
  wire [23:0] hi_z = term_29 ? v2_z_s1 : hi01_z_s1;
  reg  [23:0] hi_z_s2;
  wire term_30 = (lo_z_s2 == hi_z_s2) | ((~|lo_z_s2[22:16]) & (~|hi_z_s2[22:16]));
  wire flat_z =
      term_30 &
      ~((&lo_z_s2[22:16]) & (|lo_z_s2[15:0])) &
      ~((&hi_z_s2[22:16]) & (|hi_z_s2[15:0]));
  reg  flat_z_s3;
  wire same01_z =
      ((v0_z == v1_z) | term_25) &
      ~all_v0_z_22_16_and_any_v0_z_15_0 &
      ~all_v1_z_22_16_and_any_v1_z_15_0;
  reg  same01_z_s1;
  wire term_31 =
      ((v1_z == v2_z) | (v1_z_22_16_is_zero & v2_z_22_16_is_zero)) &
      ~all_v1_z_22_16_and_any_v1_z_15_0;
  wire same12_z = term_31 & ~all_v2_z_22_16_and_any_v2_z_15_0;
  reg  same12_z_s1;
  wire term_32 =
      ((v2_z == v0_z) | (v2_z_22_16_is_zero & v0_z_22_16_is_zero)) &
      ~all_v2_z_22_16_and_any_v2_z_15_0;
  wire same20_z = term_32 & ~all_v0_z_22_16_and_any_v0_z_15_0;
  reg  same20_z_s1;
  reg  signs_2_s1, signs_2_s2;
  wire [23:0] near_plane_z = signs_2_s2 ? hi_z_s2 : lo_z_s2;
  reg  [23:0] near_plane_z_s3;
  reg  [23:0] origin_z_s1, origin_z_s2, origin_z_s3;
  reg  [191:0] reciprocal_z_delay;
  wire [23:0] reciprocal_z_s8 = reciprocal_z_delay[191:168];

  wire [23:0] near_z_distance;
  near_distance near_z (
    .clk(clk),
    .plane(near_plane_z_s3),
    .origin(origin_z_s3),
    .reciprocal(reciprocal_z_s8),
    .distance(near_z_distance)
  );

  wire [23:0] far_plane_z = signs_2_s2 ? lo_z_s2 : hi_z_s2;
  reg  [23:0] far_plane_z_s3;

  wire [23:0] far_z_distance;
  far_distance far_z (
    .clk(clk),
    .plane(far_plane_z_s3),
    .origin(origin_z_s3),
    .reciprocal(reciprocal_z_s8),
    .distance(far_z_distance)
  );

  reg  near_z_distance_22_16_is_zero_s13, near_z_distance_22_16_is_zero_s14;
  reg  [23:0] joined_9_s13, joined_9_s14;
  reg  near_z_distance_23_s13, near_z_distance_23_s14;
  wire choice_15 =
      (near_after_y_s14[23] ^ near_z_distance_23_s14) ? near_after_y_s14[23] :
      (({near_after_y_s14[22:0], 1'b0} < joined_9_s14) ^ near_after_y_s14[23]);
  reg  term_33_s13, term_33_s14;
  wire term_34 =
      choice_15 &
      ~((~|near_after_y_s14[22:16]) & near_z_distance_22_16_is_zero_s14) &
      ~(((&near_after_y_s14[22:16]) & (|near_after_y_s14[15:0])) | term_33_s14);
  reg  [23:0] near_z_distance_s13, near_z_distance_s14;
  wire [23:0] near_after_z = term_34 ? near_z_distance_s14 : near_after_y_s14;
  reg  [23:0] near_after_z_s15;
  reg  far_z_distance_22_16_is_zero_s13, far_z_distance_22_16_is_zero_s14;
  reg  [23:0] joined_10_s13, joined_10_s14;
  reg  far_z_distance_23_s13, far_z_distance_23_s14;
  wire term_35 =
      (joined_10_s14 < {far_after_y_s14[22:0], far_after_y_s14[23]}) ^
      far_z_distance_23_s14;
  wire choice_16 = (far_z_distance_23_s14 ^ far_after_y_s14[23]) ? far_z_distance_23_s14 : term_35;
  reg  term_36_s13, term_36_s14;
  wire term_37 =
      choice_16 &
      ~(far_z_distance_22_16_is_zero_s14 & (~|far_after_y_s14[22:16])) &
      ~(term_36_s14 | ((&far_after_y_s14[22:16]) & (|far_after_y_s14[15:0])));
  reg  [23:0] far_z_distance_s13, far_z_distance_s14;
  wire [23:0] far_after_z = term_37 ? far_z_distance_s14 : far_after_y_s14;
  reg  [23:0] far_after_z_s15;

  // Degenerate: two vertices are equal, or the box is flat on two axes.
  wire term_38 = (flat_x_s3 & flat_y_s3) | (flat_y_s3 & flat_z_s3) | (flat_z_s3 & flat_x_s3);
  reg  same01_x_and_same01_y_and_same01_z_s2, same01_x_and_same01_y_and_same01_z_s3;
  reg  same12_x_and_same12_y_and_same12_z_s2, same12_x_and_same12_y_and_same12_z_s3;
  reg  same20_x_and_same20_y_and_same20_z_s2, same20_x_and_same20_y_and_same20_z_s3;
  wire any_degenerate =
      term_38 |
      same01_x_and_same01_y_and_same01_z_s3 |
      same12_x_and_same12_y_and_same12_z_s3 |
      same20_x_and_same20_y_and_same20_z_s3;
  reg  [12:0] any_degenerate_delay;
  wire comparison = {far_after_z_s15[22:0], 1'b0} < {near_after_z_s15[22:0], near_after_z_s15[23]};
  wire choice_17 =
      (far_after_z_s15[23] ^ near_after_z_s15[23]) ? far_after_z_s15[23] :
      (comparison ^ far_after_z_s15[23]);
  wire term_39 = choice_17 & ~((~|far_after_z_s15[22:16]) & (~|near_after_z_s15[22:16]));
  wire term_40 =
      ((&far_after_z_s15[22:16]) & (|far_after_z_s15[15:0])) |
      ((&near_after_z_s15[22:16]) & (|near_after_z_s15[15:0]));
  wire empty_interval = term_39 & ~term_40;
  reg  empty_interval_s16;
  wire any_degenerate_s16 = any_degenerate_delay[12];

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    lo01_x_s1 <= lo01_x;
    hi01_x_s1 <= hi01_x;
    v2_x_22_16_is_zero_s1 <= v2_x_22_16_is_zero;
    joined_s1 <= {v2_x[22:0], 1'b0};
    v2_x_23_s1 <= v2_x[23];
    all_v2_x_22_16_and_any_v2_x_15_0_s1 <= all_v2_x_22_16_and_any_v2_x_15_0;
    v2_x_s1 <= v2_x;
    joined_2_s1 <= {v2_x[22:0], v2_x[23]};
    same01_x_s1 <= same01_x;
    same12_x_s1 <= same12_x;
    same20_x_s1 <= same20_x;
    signs_0_s1 <= signs[0];
    origin_x_s1 <= origin_x;
    lo01_y_s1 <= lo01_y;
    hi01_y_s1 <= hi01_y;
    v2_y_22_16_is_zero_s1 <= v2_y_22_16_is_zero;
    joined_3_s1 <= {v2_y[22:0], 1'b0};
    v2_y_23_s1 <= v2_y[23];
    all_v2_y_22_16_and_any_v2_y_15_0_s1 <= all_v2_y_22_16_and_any_v2_y_15_0;
    v2_y_s1 <= v2_y;
    joined_4_s1 <= {v2_y[22:0], v2_y[23]};
    same01_y_s1 <= same01_y;
    same12_y_s1 <= same12_y;
    same20_y_s1 <= same20_y;
    signs_1_s1 <= signs[1];
    origin_y_s1 <= origin_y;
    lo01_z_s1 <= lo01_z;
    hi01_z_s1 <= hi01_z;
    v2_z_22_16_is_zero_s1 <= v2_z_22_16_is_zero;
    joined_7_s1 <= {v2_z[22:0], 1'b0};
    v2_z_23_s1 <= v2_z[23];
    all_v2_z_22_16_and_any_v2_z_15_0_s1 <= all_v2_z_22_16_and_any_v2_z_15_0;
    v2_z_s1 <= v2_z;
    joined_8_s1 <= {v2_z[22:0], v2_z[23]};
    same01_z_s1 <= same01_z;
    same12_z_s1 <= same12_z;
    same20_z_s1 <= same20_z;
    signs_2_s1 <= signs[2];
    origin_z_s1 <= origin_z;

    // Stage 2
    lo_x_s2 <= lo_x;
    hi_x_s2 <= hi_x;
    signs_0_s2 <= signs_0_s1;
    origin_x_s2 <= origin_x_s1;
    lo_y_s2 <= lo_y;
    hi_y_s2 <= hi_y;
    signs_1_s2 <= signs_1_s1;
    origin_y_s2 <= origin_y_s1;
    lo_z_s2 <= lo_z;
    hi_z_s2 <= hi_z;
    signs_2_s2 <= signs_2_s1;
    origin_z_s2 <= origin_z_s1;
    same01_x_and_same01_y_and_same01_z_s2 <= same01_x_s1 & same01_y_s1 & same01_z_s1;
    same12_x_and_same12_y_and_same12_z_s2 <= same12_x_s1 & same12_y_s1 & same12_z_s1;
    same20_x_and_same20_y_and_same20_z_s2 <= same20_x_s1 & same20_y_s1 & same20_z_s1;

    // Stage 3
    flat_x_s3 <= flat_x;
    near_plane_x_s3 <= near_plane_x;
    origin_x_s3 <= origin_x_s2;
    far_plane_x_s3 <= far_plane_x;
    flat_y_s3 <= flat_y;
    near_plane_y_s3 <= near_plane_y;
    origin_y_s3 <= origin_y_s2;
    far_plane_y_s3 <= far_plane_y;
    flat_z_s3 <= flat_z;
    near_plane_z_s3 <= near_plane_z;
    origin_z_s3 <= origin_z_s2;
    far_plane_z_s3 <= far_plane_z;
    same01_x_and_same01_y_and_same01_z_s3 <= same01_x_and_same01_y_and_same01_z_s2;
    same12_x_and_same12_y_and_same12_z_s3 <= same12_x_and_same12_y_and_same12_z_s2;
    same20_x_and_same20_y_and_same20_z_s3 <= same20_x_and_same20_y_and_same20_z_s2;

    // Stage 13
    near_after_x_s13 <= near_after_x;
    far_after_x_s13 <= far_after_x;
    near_y_distance_22_16_is_zero_s13 <= ~|near_y_distance[22:16];
    joined_5_s13 <= {near_y_distance[22:0], near_y_distance[23]};
    near_y_distance_23_s13 <= near_y_distance[23];
    term_19_s13 <= (&near_y_distance[22:16]) & (|near_y_distance[15:0]);
    near_y_distance_s13 <= near_y_distance;
    far_y_distance_22_16_is_zero_s13 <= ~|far_y_distance[22:16];
    joined_6_s13 <= {far_y_distance[22:0], 1'b0};
    far_y_distance_23_s13 <= far_y_distance[23];
    term_22_s13 <= (&far_y_distance[22:16]) & (|far_y_distance[15:0]);
    far_y_distance_s13 <= far_y_distance;
    near_z_distance_22_16_is_zero_s13 <= ~|near_z_distance[22:16];
    joined_9_s13 <= {near_z_distance[22:0], near_z_distance[23]};
    near_z_distance_23_s13 <= near_z_distance[23];
    term_33_s13 <= (&near_z_distance[22:16]) & (|near_z_distance[15:0]);
    near_z_distance_s13 <= near_z_distance;
    far_z_distance_22_16_is_zero_s13 <= ~|far_z_distance[22:16];
    joined_10_s13 <= {far_z_distance[22:0], 1'b0};
    far_z_distance_23_s13 <= far_z_distance[23];
    term_36_s13 <= (&far_z_distance[22:16]) & (|far_z_distance[15:0]);
    far_z_distance_s13 <= far_z_distance;

    // Stage 14
    near_after_y_s14 <= near_after_y;
    far_after_y_s14 <= far_after_y;
    near_z_distance_22_16_is_zero_s14 <= near_z_distance_22_16_is_zero_s13;
    joined_9_s14 <= joined_9_s13;
    near_z_distance_23_s14 <= near_z_distance_23_s13;
    term_33_s14 <= term_33_s13;
    near_z_distance_s14 <= near_z_distance_s13;
    far_z_distance_22_16_is_zero_s14 <= far_z_distance_22_16_is_zero_s13;
    joined_10_s14 <= joined_10_s13;
    far_z_distance_23_s14 <= far_z_distance_23_s13;
    term_36_s14 <= term_36_s13;
    far_z_distance_s14 <= far_z_distance_s13;

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

  assign box_misses = empty_interval_s16 | any_degenerate_s16;

endmodule

`default_nettype wire
