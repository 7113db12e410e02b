// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_triangle_test: a ray against a triangle: the test itself, clamped to the ray's interval in the
// triangle's own box, within tmin and tmax; or a matrix applied to a point.
// Latency: 8 to 53 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_triangle_test (
  input  wire        clk,

  // What the slot is: 0 a test, 1 a matrix
  input  wire        matrix,

  // The triangle's vertices, or the matrix's columns x, y, z
  input  wire [23:0] v0_x,
  input  wire [23:0] v0_y,
  input  wire [23:0] v0_z,
  input  wire [23:0] v1_x,
  input  wire [23:0] v1_y,
  input  wire [23:0] v1_z,
  input  wire [23:0] v2_x,
  input  wire [23:0] v2_y,
  input  wire [23:0] v2_z,

  // The ray's origin, or the point
  input  wire [23:0] origin_x,
  input  wire [23:0] origin_y,
  input  wire [23:0] origin_z,

  // The ray's shear
  input  wire [1:0]  kz,
  input  wire [23:0] shear_x,
  input  wire [23:0] shear_y,

  // The matrix's fourth column
  input  wire [23:0] translation_y,
  input  wire [23:0] translation_x,
  input  wire [23:0] translation_z,

  // The weight of the moved point
  input  wire [23:0] weight,

  // The reciprocal of the direction's greatest component
  input  wire [23:0] shear_z,

  // The ray
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

  // The ray's limits, needed last
  input  wire [23:0] tmin,
  input  wire [23:0] tmax,

  // Whether the ray hits, and where
  output reg         hit,
  output reg  [23:0] t,
  output reg  [23:0] u,
  output reg  [23:0] v,

  // The point moved by the matrix
  output wire [23:0] moved_x,
  output wire [23:0] moved_y,
  output wire [23:0] moved_z,

  // The point moved and weighted
  output wire [23:0] weighted_x,
  output wire [23:0] weighted_y,
  output wire [23:0] weighted_z,

  // The interval, and whether the box alone makes the ray miss
  output wire [23:0] box_near,
  output wire [23:0] box_far
);

  wire [23:0] intersection_test_t;
  wire [23:0] intersection_test_u;
  wire [23:0] intersection_test_v;
  wire intersection_test_misses;
  wire [23:0] intersection_moved_x;
  wire [23:0] intersection_moved_y;
  wire [23:0] intersection_moved_z;
  wire [23:0] intersection_weighted_x;
  wire [23:0] intersection_weighted_y;
  wire [23:0] intersection_weighted_z;
  dynrt_triangle_watertight intersection (
    .clk(clk),
    .matrix(matrix),
    .v0_x(v0_x),
    .v0_y(v0_y),
    .v0_z(v0_z),
    .v1_x(v1_x),
    .v1_y(v1_y),
    .v1_z(v1_z),
    .v2_x(v2_x),
    .v2_y(v2_y),
    .v2_z(v2_z),
    .origin_x(origin_x),
    .origin_y(origin_y),
    .origin_z(origin_z),
    .kz(kz),
    .shear_x(shear_x),
    .shear_y(shear_y),
    .translation_y(translation_y),
    .translation_x(translation_x),
    .translation_z(translation_z),
    .weight(weight),
    .shear_z(shear_z),
    .test_t(intersection_test_t),
    .test_u(intersection_test_u),
    .test_v(intersection_test_v),
    .test_misses(intersection_test_misses),
    .moved_x(intersection_moved_x),
    .moved_y(intersection_moved_y),
    .moved_z(intersection_moved_z),
    .weighted_x(intersection_weighted_x),
    .weighted_y(intersection_weighted_y),
    .weighted_z(intersection_weighted_z)
  );

  wire [23:0] own_box_sum_0;
  wire [23:0] own_box_sum_1;
  wire [23:0] own_box_sum_2;
  wire [23:0] own_box_sum_3;
  wire [23:0] own_box_sum_4;
  wire [23:0] own_box_sum_5;
  wire [23:0] own_box_box_near;
  wire [23:0] own_box_box_far;
  wire own_box_box_misses;
  dynrt_triangle_box own_box (
    .clk(clk),
    .v0_x(v0_x),
    .v0_y(v0_y),
    .v0_z(v0_z),
    .v1_x(v1_x),
    .v1_y(v1_y),
    .v1_z(v1_z),
    .v2_x(v2_x),
    .v2_y(v2_y),
    .v2_z(v2_z),
    .origin_x(origin_x),
    .origin_y(origin_y),
    .origin_z(origin_z),
    .reciprocal_x(reciprocal_x),
    .reciprocal_y(reciprocal_y),
    .reciprocal_z(reciprocal_z),
    .signs(signs),
    .accumulate(accumulate),
    .sum_a_0(sum_a_0),
    .sum_b_0(sum_b_0),
    .sum_a_1(sum_a_1),
    .sum_b_1(sum_b_1),
    .sum_a_2(sum_a_2),
    .sum_b_2(sum_b_2),
    .sum_a_3(sum_a_3),
    .sum_b_3(sum_b_3),
    .sum_a_4(sum_a_4),
    .sum_b_4(sum_b_4),
    .sum_a_5(sum_a_5),
    .sum_b_5(sum_b_5),
    .sum_0(own_box_sum_0),
    .sum_1(own_box_sum_1),
    .sum_2(own_box_sum_2),
    .sum_3(own_box_sum_3),
    .sum_4(own_box_sum_4),
    .sum_5(own_box_sum_5),
    .window_near(window_near),
    .window_far(window_far),
    .box_near(own_box_box_near),
    .box_far(own_box_box_far),
    .box_misses(own_box_box_misses)
  );

  // Clamp t into the box's interval; the box decides a miss before.
  reg  [815:0] own_box_box_near_delay;
  wire [23:0] own_box_box_near_s50 = own_box_box_near_delay[815:792];
  reg  [839:0] own_box_box_far_delay;
  wire [23:0] own_box_box_far_s50 = own_box_box_far_delay[815:792];
  wire raised_is_greater_by_sign =
      (intersection_test_t[22:0] < own_box_box_near_s50[22:0]) ^
      intersection_test_t[23];
  wire raised_is_greater =
      (intersection_test_t[23] ^ own_box_box_near_s50[23]) ? intersection_test_t[23] :
      raised_is_greater_by_sign;
  wire [23:0] raised = raised_is_greater ? own_box_box_near_s50 : intersection_test_t;
  reg  [23:0] raised_s51;
  reg  [22:0] own_box_box_far_magnitude_s51;
  reg  own_box_box_far_sign_s51;
  wire clamped_is_less_unless_nan =
      (own_box_box_far_sign_s51 ^ raised_s51[23]) ? own_box_box_far_sign_s51 :
      ((own_box_box_far_magnitude_s51 < raised_s51[22:0]) ^ own_box_box_far_sign_s51);
  wire clamped_is_less = clamped_is_less_unless_nan & ~((&raised_s51[22:16]) & (|raised_s51[15:0]));
  wire [23:0] own_box_box_far_s51 = own_box_box_far_delay[839:816];
  wire [23:0] clamped = clamped_is_less ? own_box_box_far_s51 : raised_s51;
  reg  [23:0] clamped_s52;
  reg  [33:0] own_box_box_misses_delay;
  wire own_box_box_misses_s50 = own_box_box_misses_delay[33];
  wire misses =
      intersection_test_misses |
      own_box_box_misses_s50 |
      ((&intersection_test_t[22:16]) & (|intersection_test_t[15:0]));
  wire within_limits =
      ~((clamped_s52[22:0] < tmin[22:0]) | clamped_s52[23]) &
      ~((tmax[22:0] < clamped_s52[22:0]) & ~clamped_s52[23]) &
      ~(&clamped_s52[22:16]);
  reg  misses_s51, misses_s52;
  wire hits = within_limits & ~misses_s52;
  reg  [23:0] intersection_test_u_s51, intersection_test_u_s52;
  reg  [23:0] intersection_test_v_s51, intersection_test_v_s52;

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 51
    raised_s51 <= raised;
    own_box_box_far_magnitude_s51 <= own_box_box_far_s50[22:0];
    own_box_box_far_sign_s51 <= own_box_box_far_s50[23];
    misses_s51 <= misses;
    intersection_test_u_s51 <= intersection_test_u;
    intersection_test_v_s51 <= intersection_test_v;

    // Stage 52
    clamped_s52 <= clamped;
    misses_s52 <= misses_s51;
    intersection_test_u_s52 <= intersection_test_u_s51;
    intersection_test_v_s52 <= intersection_test_v_s51;

    // Stage 53
    hit <= hits;
    t <= clamped_s52;
    u <= intersection_test_u_s52;
    v <= intersection_test_v_s52;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    own_box_box_near_delay <= {own_box_box_near_delay[791:0], own_box_box_near};
    own_box_box_far_delay <= {own_box_box_far_delay[815:0], own_box_box_far};
    own_box_box_misses_delay <= {own_box_box_misses_delay[32:0], own_box_box_misses};
  end

  assign sum_0 = own_box_sum_0;
  assign sum_1 = own_box_sum_1;
  assign sum_2 = own_box_sum_2;
  assign sum_3 = own_box_sum_3;
  assign sum_4 = own_box_sum_4;
  assign sum_5 = own_box_sum_5;
  assign moved_x = intersection_moved_x;
  assign moved_y = intersection_moved_y;
  assign moved_z = intersection_moved_z;
  assign weighted_x = intersection_weighted_x;
  assign weighted_y = intersection_weighted_y;
  assign weighted_z = intersection_weighted_z;
  assign box_near = own_box_box_near;
  assign box_far = own_box_box_far;

  // What nothing reads.
  wire unused = &{1'b0, tmin[23], tmax[23]};

endmodule

`default_nettype wire
