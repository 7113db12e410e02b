// SPDX-License-Identifier: MIT OR Apache-2.0
// triangle_test: a ray against a triangle: the test itself, clamped to the ray's interval in the
// triangle's own box, within tmin and tmax.
// Latency: 53 clocks, one set of inputs a clock.

`default_nettype none

module triangle_test (
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

  // The ray, and its shear
  input  wire [23:0] origin_x,
  input  wire [23:0] origin_y,
  input  wire [23:0] origin_z,
  input  wire [1:0]  kz,
  input  wire [23:0] shear_x,
  input  wire [23:0] shear_y,

  // The reciprocal of the direction's greatest component, needed last
  input  wire [23:0] shear_z,

  // The ray
  input  wire [23:0] reciprocal_x,
  input  wire [23:0] reciprocal_y,
  input  wire [23:0] reciprocal_z,
  input  wire [2:0]  signs,

  // The ray's limits, needed last
  input  wire [23:0] tmin,
  input  wire [23:0] tmax,

  // Whether the ray hits, and where
  output reg         hit,
  output reg  [23:0] t,
  output reg  [23:0] u,
  output reg  [23:0] v
);

  wire [23:0] intersection_test_t;
  wire [23:0] intersection_test_u;
  wire [23:0] intersection_test_v;
  wire intersection_test_misses;
  triangle_watertight intersection (
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
    .kz(kz),
    .shear_x(shear_x),
    .shear_y(shear_y),
    .shear_z(shear_z),
    .test_t(intersection_test_t),
    .test_u(intersection_test_u),
    .test_v(intersection_test_v),
    .test_misses(intersection_test_misses)
  );

  wire [23:0] own_box_box_near;
  wire [23:0] own_box_box_far;
  wire own_box_box_misses;
  triangle_box own_box (
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
    .box_near(own_box_box_near),
    .box_far(own_box_box_far),
    .box_misses(own_box_box_misses)
  );

  // Clamp t into the box's interval; the box decides a miss before.
  reg  [815:0] own_box_box_near_delay;
  wire [23:0] own_box_box_near_s50 = own_box_box_near_delay[815:792];
  reg  [839:0] own_box_box_far_delay;
  wire [23:0] own_box_box_far_s50 = own_box_box_far_delay[815:792];
  wire comparison =
      {intersection_test_t[22:0], 1'b0} <
      {own_box_box_near_s50[22:0], own_box_box_near_s50[23]};
  wire choice =
      (intersection_test_t[23] ^ own_box_box_near_s50[23]) ? intersection_test_t[23] :
      (comparison ^ intersection_test_t[23]);
  wire term = choice & ~((~|intersection_test_t[22:16]) & (~|own_box_box_near_s50[22:16]));
  wire term_2 = (&intersection_test_t[22:16]) & (|intersection_test_t[15:0]);
  wire term_3 = term & ~(term_2 | ((&own_box_box_near_s50[22:16]) & (|own_box_box_near_s50[15:0])));
  wire [23:0] raised = term_3 ? own_box_box_near_s50 : intersection_test_t;
  reg  [23:0] raised_s51;
  reg  own_box_box_far_22_16_is_zero_s51;
  reg  [23:0] joined_s51;
  reg  own_box_box_far_23_s51;
  wire term_4 = (joined_s51 < {raised_s51[22:0], raised_s51[23]}) ^ own_box_box_far_23_s51;
  wire choice_2 = (own_box_box_far_23_s51 ^ raised_s51[23]) ? own_box_box_far_23_s51 : term_4;
  reg  term_5_s51;
  wire term_6 =
      choice_2 &
      ~(own_box_box_far_22_16_is_zero_s51 & (~|raised_s51[22:16])) &
      ~(term_5_s51 | ((&raised_s51[22:16]) & (|raised_s51[15:0])));
  wire [23:0] own_box_box_far_s51 = own_box_box_far_delay[839:816];
  wire [23:0] clamped = term_6 ? own_box_box_far_s51 : raised_s51;
  reg  [23:0] clamped_s52;
  reg  [33:0] own_box_box_misses_delay;
  wire own_box_box_misses_s50 = own_box_box_misses_delay[33];
  wire misses = intersection_test_misses | own_box_box_misses_s50 | term_2;
  wire clamped_22_16_is_zero = ~|clamped_s52[22:16];
  wire term_7 = ({clamped_s52[22:0], 1'b0} < {tmin[22:0], tmin[23]}) ^ clamped_s52[23];
  wire term_8 =
      ((clamped_s52[23] ^ tmin[23]) ? clamped_s52[23] : term_7) &
      ~(clamped_22_16_is_zero & (~|tmin[22:16]));
  wire all_clamped_22_16 = &clamped_s52[22:16];
  wire any_clamped_15_0 = |clamped_s52[15:0];
  wire term_9 = all_clamped_22_16 & any_clamped_15_0;
  wire term_10 = ~term_8 & ~(((&tmin[22:16]) & (|tmin[15:0])) | term_9);
  wire term_11 = ({tmax[22:0], 1'b0} < {clamped_s52[22:0], clamped_s52[23]}) ^ tmax[23];
  wire term_12 =
      ((tmax[23] ^ clamped_s52[23]) ? tmax[23] : term_11) &
      ~((~|tmax[22:16]) & clamped_22_16_is_zero);
  wire term_13 = ~term_12 & ~(term_9 | ((&tmax[22:16]) & (|tmax[15:0])));
  wire within_limits = term_10 & term_13 & ~(all_clamped_22_16 & ~any_clamped_15_0);
  reg  misses_s51, misses_s52;
  wire hits = within_limits & ~misses_s52;
  reg  [23:0] intersection_test_u_s51, intersection_test_u_s52;
  reg  [23:0] intersection_test_v_s51, intersection_test_v_s52;

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 51
    raised_s51 <= raised;
    own_box_box_far_22_16_is_zero_s51 <= ~|own_box_box_far_s50[22:16];
    joined_s51 <= {own_box_box_far_s50[22:0], 1'b0};
    own_box_box_far_23_s51 <= own_box_box_far_s50[23];
    term_5_s51 <= (&own_box_box_far_s50[22:16]) & (|own_box_box_far_s50[15:0]);
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

endmodule

`default_nettype wire
