// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_triangle_watertight: the watertight ray-triangle test of Woop, Benthin and Wald: edge functions
// of vertices sheared into the ray's frame. Its operators also apply a matrix to a point.
// Latency: 35 to 50 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_triangle_watertight (
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

  // Distance, the second and third vertex's weights, and whether the ray passes the triangle
  output wire [23:0] test_t,
  output reg  [23:0] test_u,
  output reg  [23:0] test_v,
  output wire        test_misses,

  // The point moved by the matrix
  output wire [23:0] moved_x,
  output wire [23:0] moved_y,
  output wire [23:0] moved_z,

  // The point moved and weighted
  output wire [23:0] weighted_x,
  output wire [23:0] weighted_y,
  output wire [23:0] weighted_z
);

  // Matrix: the columns pass as if seen from the origin and along z; the point takes the shear's
  // way.
  wire [23:0] seen_from_x = matrix ? 24'd0 : origin_x;
  wire [23:0] seen_from_y = matrix ? 24'd0 : origin_y;
  wire [23:0] seen_from_z = matrix ? 24'd0 : origin_z;
  wire [1:0] axis = matrix ? 2'd0 : kz;
  wire [23:0] shear_or_point_x = matrix ? origin_x : shear_x;
  wire [23:0] shear_or_point_y = matrix ? origin_y : shear_y;

  // The vertices a, b, c, seen from the origin, their axes turned.
  wire [23:0] a_x_y;
  dynrt_fp_sub a_x (
    .clk(clk),
    .a(v0_x),
    .b(seen_from_x),
    .y(a_x_y)
  );

  wire [23:0] a_y_y;
  dynrt_fp_sub a_y (
    .clk(clk),
    .a(v0_y),
    .b(seen_from_y),
    .y(a_y_y)
  );

  wire [23:0] a_z_y;
  dynrt_fp_sub a_z (
    .clk(clk),
    .a(v0_z),
    .b(seen_from_z),
    .y(a_z_y)
  );

  wire [23:0] b_x_y;
  dynrt_fp_sub b_x (
    .clk(clk),
    .a(v1_x),
    .b(seen_from_x),
    .y(b_x_y)
  );

  wire [23:0] b_y_y;
  dynrt_fp_sub b_y (
    .clk(clk),
    .a(v1_y),
    .b(seen_from_y),
    .y(b_y_y)
  );

  wire [23:0] b_z_y;
  dynrt_fp_sub b_z (
    .clk(clk),
    .a(v1_z),
    .b(seen_from_z),
    .y(b_z_y)
  );

  wire [23:0] c_x_y;
  dynrt_fp_sub c_x (
    .clk(clk),
    .a(v2_x),
    .b(seen_from_x),
    .y(c_x_y)
  );

  wire [23:0] c_y_y;
  dynrt_fp_sub c_y (
    .clk(clk),
    .a(v2_y),
    .b(seen_from_y),
    .y(c_y_y)
  );

  wire [23:0] c_z_y;
  dynrt_fp_sub c_z (
    .clk(clk),
    .a(v2_z),
    .b(seen_from_z),
    .y(c_z_y)
  );

  reg  [4:0] axis_is_1_delay;
  wire axis_is_1_s5 = axis_is_1_delay[4];
  reg  [4:0] axis_is_0_delay;
  wire axis_is_0_s5 = axis_is_0_delay[4];
  wire [23:0] a_kz =
      axis_is_0_s5 ? a_x_y :
      axis_is_1_s5 ? a_y_y :
      a_z_y;
  reg  [407:0] a_kz_delay;
  wire [23:0] a_kz_s6 = a_kz_delay[23:0];
  wire [23:0] a_kx =
      axis_is_0_s5 ? a_y_y :
      axis_is_1_s5 ? a_z_y :
      a_x_y;
  reg  [95:0] a_kx_delay;
  wire [23:0] a_ky =
      axis_is_0_s5 ? a_z_y :
      axis_is_1_s5 ? a_x_y :
      a_y_y;
  reg  [95:0] a_ky_delay;
  wire [23:0] b_kz =
      axis_is_0_s5 ? b_x_y :
      axis_is_1_s5 ? b_y_y :
      b_z_y;
  reg  [407:0] b_kz_delay;
  wire [23:0] b_kz_s6 = b_kz_delay[23:0];
  wire [23:0] b_kx =
      axis_is_0_s5 ? b_y_y :
      axis_is_1_s5 ? b_z_y :
      b_x_y;
  reg  [95:0] b_kx_delay;
  wire [23:0] b_ky =
      axis_is_0_s5 ? b_z_y :
      axis_is_1_s5 ? b_x_y :
      b_y_y;
  reg  [95:0] b_ky_delay;
  wire [23:0] c_kz =
      axis_is_0_s5 ? c_x_y :
      axis_is_1_s5 ? c_y_y :
      c_z_y;
  reg  [407:0] c_kz_delay;
  wire [23:0] c_kx =
      axis_is_0_s5 ? c_y_y :
      axis_is_1_s5 ? c_z_y :
      c_x_y;
  reg  [95:0] c_kx_delay;
  wire [23:0] c_ky =
      axis_is_0_s5 ? c_z_y :
      axis_is_1_s5 ? c_x_y :
      c_y_y;
  reg  [95:0] c_ky_delay;

  // What shears them. Matrix: the products of column x (by shear x) and y (by shear y), each
  // component once.
  reg  [143:0] shear_or_point_x_delay;
  wire [23:0] shear_or_point_x_s6 = shear_or_point_x_delay[143:120];

  wire [23:0] ax_shift_y;
  dynrt_fp_mul ax_shift (
    .clk(clk),
    .a(shear_or_point_x_s6),
    .b(a_kz_s6),
    .y(ax_shift_y)
  );

  reg  [43:0] matrix_delay;
  wire matrix_s5 = matrix_delay[4];
  wire [23:0] bx_shift_factor = matrix_s5 ? a_z_y : b_kz;
  reg  [23:0] bx_shift_factor_s6;

  wire [23:0] bx_shift_y;
  dynrt_fp_mul bx_shift (
    .clk(clk),
    .a(shear_or_point_x_s6),
    .b(bx_shift_factor_s6),
    .y(bx_shift_y)
  );

  wire [23:0] cx_shift_factor = matrix_s5 ? a_y_y : c_kz;
  reg  [23:0] cx_shift_factor_s6;

  wire [23:0] cx_shift_y;
  dynrt_fp_mul cx_shift (
    .clk(clk),
    .a(shear_or_point_x_s6),
    .b(cx_shift_factor_s6),
    .y(cx_shift_y)
  );

  wire [23:0] ay_shift_factor = matrix_s5 ? b_y_y : a_kz;
  reg  [23:0] ay_shift_factor_s6;
  reg  [143:0] shear_or_point_y_delay;
  wire [23:0] shear_or_point_y_s6 = shear_or_point_y_delay[143:120];

  wire [23:0] ay_shift_y;
  dynrt_fp_mul ay_shift (
    .clk(clk),
    .a(shear_or_point_y_s6),
    .b(ay_shift_factor_s6),
    .y(ay_shift_y)
  );

  wire [23:0] by_shift_y;
  dynrt_fp_mul by_shift (
    .clk(clk),
    .a(shear_or_point_y_s6),
    .b(b_kz_s6),
    .y(by_shift_y)
  );

  wire [23:0] cy_shift_factor = matrix_s5 ? b_z_y : c_kz;
  reg  [23:0] cy_shift_factor_s6;

  wire [23:0] cy_shift_y;
  dynrt_fp_mul cy_shift (
    .clk(clk),
    .a(shear_or_point_y_s6),
    .b(cy_shift_factor_s6),
    .y(cy_shift_y)
  );

  // Sheared. Matrix: the sum of columns x and y in ax, ay, bx; column z passes in cx, cy.
  wire matrix_s9 = matrix_delay[8];
  wire [23:0] a_kx_s9 = a_kx_delay[95:72];
  wire [23:0] ax_minuend = matrix_s9 ? by_shift_y : a_kx_s9;
  wire [23:0] ax_subtrahend = {ax_shift_y[23] ^ matrix_s9, ax_shift_y[22:0]};

  wire [23:0] ax_y;
  dynrt_fp_sub ax (
    .clk(clk),
    .a(ax_minuend),
    .b(ax_subtrahend),
    .y(ax_y)
  );

  wire [23:0] a_ky_s9 = a_ky_delay[95:72];
  wire [23:0] ay_minuend = matrix_s9 ? cx_shift_y : a_ky_s9;
  wire [23:0] ay_subtrahend = {ay_shift_y[23] ^ matrix_s9, ay_shift_y[22:0]};

  wire [23:0] ay_y;
  dynrt_fp_sub ay (
    .clk(clk),
    .a(ay_minuend),
    .b(ay_subtrahend),
    .y(ay_y)
  );

  wire [23:0] b_kx_s9 = b_kx_delay[95:72];
  wire [23:0] bx_minuend = matrix_s9 ? cy_shift_y : b_kx_s9;
  wire [23:0] bx_subtrahend = {bx_shift_y[23] ^ matrix_s9, bx_shift_y[22:0]};

  wire [23:0] bx_y;
  dynrt_fp_sub bx (
    .clk(clk),
    .a(bx_minuend),
    .b(bx_subtrahend),
    .y(bx_y)
  );

  wire [23:0] b_ky_s9 = b_ky_delay[95:72];

  wire [23:0] by_y;
  dynrt_fp_sub by (
    .clk(clk),
    .a(b_ky_s9),
    .b(by_shift_y),
    .y(by_y)
  );

  wire [23:0] cx_subtrahend = matrix_s9 ? 24'd0 : cx_shift_y;
  wire [23:0] c_kx_s9 = c_kx_delay[95:72];

  wire [23:0] cx_y;
  dynrt_fp_sub cx (
    .clk(clk),
    .a(c_kx_s9),
    .b(cx_subtrahend),
    .y(cx_y)
  );

  wire [23:0] cy_subtrahend = matrix_s9 ? 24'd0 : cy_shift_y;
  wire [23:0] c_ky_s9 = c_ky_delay[95:72];

  wire [23:0] cy_y;
  dynrt_fp_sub cy (
    .clk(clk),
    .a(c_ky_s9),
    .b(cy_subtrahend),
    .y(cy_y)
  );

  // Edge functions. Matrix: plus the products of column z, which is added to the sum.
  wire matrix_s14 = matrix_delay[13];
  reg  [335:0] origin_z_delay;
  wire [23:0] origin_z_s14 = origin_z_delay[335:312];
  wire [23:0] eu_factor = matrix_s14 ? origin_z_s14 : by_y;

  wire [23:0] eu_plus_y;
  dynrt_fp_mul eu_plus (
    .clk(clk),
    .a(cx_y),
    .b(eu_factor),
    .y(eu_plus_y)
  );

  wire [23:0] eu_minus_y;
  dynrt_fp_mul eu_minus (
    .clk(clk),
    .a(cy_y),
    .b(bx_y),
    .y(eu_minus_y)
  );

  wire [23:0] ev_factor = matrix_s14 ? origin_z_s14 : ax_y;

  wire [23:0] ev_plus_y;
  dynrt_fp_mul ev_plus (
    .clk(clk),
    .a(ev_factor),
    .b(cy_y),
    .y(ev_plus_y)
  );

  wire [23:0] ev_minus_y;
  dynrt_fp_mul ev_minus (
    .clk(clk),
    .a(ay_y),
    .b(cx_y),
    .y(ev_minus_y)
  );

  wire [23:0] c_kz_s14 = c_kz_delay[215:192];
  wire [23:0] ew_factor_b = matrix_s14 ? c_kz_s14 : bx_y;
  wire [23:0] ew_factor_a = matrix_s14 ? origin_z_s14 : ay_y;

  wire [23:0] ew_plus_y;
  dynrt_fp_mul ew_plus (
    .clk(clk),
    .a(ew_factor_b),
    .b(ew_factor_a),
    .y(ew_plus_y)
  );

  wire [23:0] ew_minus_y;
  dynrt_fp_mul ew_minus (
    .clk(clk),
    .a(by_y),
    .b(ax_y),
    .y(ew_minus_y)
  );

  wire matrix_s17 = matrix_delay[16];
  reg  [23:0] ay_y_negated_s15, ay_y_negated_s16, ay_y_negated_s17;
  wire [23:0] eu_subtrahend = matrix_s17 ? ay_y_negated_s17 : eu_minus_y;

  wire [23:0] eu_y;
  dynrt_fp_sub eu (
    .clk(clk),
    .a(eu_plus_y),
    .b(eu_subtrahend),
    .y(eu_y)
  );

  reg  [23:0] bx_y_negated_s15, bx_y_negated_s16, bx_y_negated_s17;
  wire [23:0] ev_subtrahend = matrix_s17 ? bx_y_negated_s17 : ev_minus_y;

  wire [23:0] ev_y;
  dynrt_fp_sub ev (
    .clk(clk),
    .a(ev_plus_y),
    .b(ev_subtrahend),
    .y(ev_y)
  );

  reg  [23:0] ax_y_negated_s15, ax_y_negated_s16, ax_y_negated_s17;
  wire [23:0] ew_subtrahend = matrix_s17 ? ax_y_negated_s17 : ew_minus_y;

  wire [23:0] ew_y;
  dynrt_fp_sub ew (
    .clk(clk),
    .a(ew_plus_y),
    .b(ew_subtrahend),
    .y(ew_y)
  );

  wire some_negative = eu_y[23] | ev_y[23] | ew_y[23];
  reg  some_negative_s23;
  wire eu_positive = (23'd0 < eu_y[22:0]) & ~eu_y[23] & ~((&eu_y[22:16]) & (|eu_y[15:0]));
  wire ev_positive = (23'd0 < ev_y[22:0]) & ~ev_y[23] & ~((&ev_y[22:16]) & (|ev_y[15:0]));
  wire ew_positive = (23'd0 < ew_y[22:0]) & ~ew_y[23] & ~((&ew_y[22:16]) & (|ew_y[15:0]));
  wire some_positive = eu_positive | ev_positive | ew_positive;
  reg  some_positive_s23;

  // det = (U + V) + W, i = 1 / det. Matrix: the translation is added, y in U + V, x in det.
  wire matrix_s22 = matrix_delay[21];
  wire [23:0] ev_or_translation = matrix_s22 ? translation_y : ev_y;

  wire [23:0] uv_y;
  dynrt_fp_add uv (
    .clk(clk),
    .a(eu_y),
    .b(ev_or_translation),
    .y(uv_y)
  );

  wire matrix_s27 = matrix_delay[26];
  wire [23:0] uv_or_translation = matrix_s27 ? translation_x : uv_y;
  reg  [239:0] ew_y_delay;
  wire [23:0] ew_y_s27 = ew_y_delay[119:96];

  wire [23:0] det_y;
  dynrt_fp_add det (
    .clk(clk),
    .a(uv_or_translation),
    .b(ew_y_s27),
    .y(det_y)
  );

  wire [23:0] i_y;
  dynrt_fp_reciprocal i (
    .clk(clk),
    .a(det_y),
    .y(i_y)
  );

  wire det_is_zero = ~|det_y[22:16];
  reg  det_is_zero_s33;

  // T = U Az + V Bz + W Cz. Matrix: the translation is added, z in T.
  wire [23:0] a_kz_s22 = a_kz_delay[407:384];

  wire [23:0] ua_y;
  dynrt_fp_mul ua (
    .clk(clk),
    .a(eu_y),
    .b(a_kz_s22),
    .y(ua_y)
  );

  wire [23:0] b_kz_s22 = b_kz_delay[407:384];

  wire [23:0] vb_y;
  dynrt_fp_mul vb (
    .clk(clk),
    .a(ev_y),
    .b(b_kz_s22),
    .y(vb_y)
  );

  wire [23:0] c_kz_s22 = c_kz_delay[407:384];

  wire [23:0] wc_y;
  dynrt_fp_mul wc (
    .clk(clk),
    .a(ew_y),
    .b(c_kz_s22),
    .y(wc_y)
  );

  wire [23:0] ua_vb_y;
  dynrt_fp_add ua_vb (
    .clk(clk),
    .a(ua_y),
    .b(vb_y),
    .y(ua_vb_y)
  );

  wire matrix_s30 = matrix_delay[29];
  reg  [191:0] ev_y_delay;
  wire [23:0] ev_y_s27 = ev_y_delay[119:96];
  wire [23:0] ev_y_s30 = ev_y_delay[191:168];
  wire [23:0] ua_vb_or_sum = matrix_s30 ? ev_y_s30 : ua_vb_y;
  reg  [119:0] wc_y_delay;
  wire [23:0] wc_y_s30 = wc_y_delay[119:96];
  wire [23:0] wc_or_translation = matrix_s30 ? translation_z : wc_y_s30;

  wire [23:0] scaled_y;
  dynrt_fp_add scaled (
    .clk(clk),
    .a(ua_vb_or_sum),
    .b(wc_or_translation),
    .y(scaled_y)
  );

  // t = (T i) Sz, u = V i, v = W i. Matrix: all by the weight; the point moved takes the way of V
  // and W.
  wire [23:0] v_or_moved_y = matrix_s27 ? uv_y : ev_y_s27;
  wire matrix_s32 = matrix_delay[31];
  wire [23:0] ew_y_s32 = ew_y_delay[239:216];
  wire [23:0] w_or_moved_x = matrix_s32 ? det_y : ew_y_s32;
  wire matrix_s44 = matrix_delay[43];
  wire [23:0] i_or_weight = matrix_s44 ? weight : i_y;
  reg  [215:0] scaled_y_delay;
  wire [23:0] scaled_y_s44 = scaled_y_delay[215:192];

  wire [23:0] distance_y;
  dynrt_fp_mul distance (
    .clk(clk),
    .a(scaled_y_s44),
    .b(i_or_weight),
    .y(distance_y)
  );

  reg  [407:0] v_or_moved_y_delay;
  assign moved_y = v_or_moved_y_delay[191:168];
  wire [23:0] v_or_moved_y_s44 = v_or_moved_y_delay[407:384];

  wire [23:0] u_y;
  dynrt_fp_mul u (
    .clk(clk),
    .a(v_or_moved_y_s44),
    .b(i_or_weight),
    .y(u_y)
  );

  reg  [287:0] w_or_moved_x_delay;
  assign moved_x = w_or_moved_x_delay[71:48];
  wire [23:0] w_or_moved_x_s44 = w_or_moved_x_delay[287:264];

  wire [23:0] v_y;
  dynrt_fp_mul v (
    .clk(clk),
    .a(w_or_moved_x_s44),
    .b(i_or_weight),
    .y(v_y)
  );

  wire [23:0] t_y;
  dynrt_fp_mul t (
    .clk(clk),
    .a(distance_y),
    .b(shear_z),
    .y(t_y)
  );

  reg  [9:0] edge_signs_differ_delay;
  wire edge_signs_differ_s33 = edge_signs_differ_delay[9];
  reg  [23:0] u_y_s48, u_y_s49;
  reg  [23:0] v_y_s48, v_y_s49;
  reg  [16:0] test_misses_delay;
  assign test_misses = test_misses_delay[16];

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 6
    bx_shift_factor_s6 <= bx_shift_factor;
    cx_shift_factor_s6 <= cx_shift_factor;
    ay_shift_factor_s6 <= ay_shift_factor;
    cy_shift_factor_s6 <= cy_shift_factor;

    // Stage 15
    ay_y_negated_s15 <= {~ay_y[23], ay_y[22:0]};
    bx_y_negated_s15 <= {~bx_y[23], bx_y[22:0]};
    ax_y_negated_s15 <= {~ax_y[23], ax_y[22:0]};

    // Stage 16
    ay_y_negated_s16 <= ay_y_negated_s15;
    bx_y_negated_s16 <= bx_y_negated_s15;
    ax_y_negated_s16 <= ax_y_negated_s15;

    // Stage 17
    ay_y_negated_s17 <= ay_y_negated_s16;
    bx_y_negated_s17 <= bx_y_negated_s16;
    ax_y_negated_s17 <= ax_y_negated_s16;

    // Stage 23
    some_negative_s23 <= some_negative;
    some_positive_s23 <= some_positive;

    // Stage 33
    det_is_zero_s33 <= det_is_zero;

    // Stage 48
    u_y_s48 <= u_y;
    v_y_s48 <= v_y;

    // Stage 49
    u_y_s49 <= u_y_s48;
    v_y_s49 <= v_y_s48;

    // Stage 50
    test_u <= u_y_s49;
    test_v <= v_y_s49;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    axis_is_1_delay <= {axis_is_1_delay[3:0], axis == 2'd1};
    axis_is_0_delay <= {axis_is_0_delay[3:0], axis == 2'd0};
    a_kz_delay <= {a_kz_delay[383:0], a_kz};
    a_kx_delay <= {a_kx_delay[71:0], a_kx};
    a_ky_delay <= {a_ky_delay[71:0], a_ky};
    b_kz_delay <= {b_kz_delay[383:0], b_kz};
    b_kx_delay <= {b_kx_delay[71:0], b_kx};
    b_ky_delay <= {b_ky_delay[71:0], b_ky};
    c_kz_delay <= {c_kz_delay[383:0], c_kz};
    c_kx_delay <= {c_kx_delay[71:0], c_kx};
    c_ky_delay <= {c_ky_delay[71:0], c_ky};
    shear_or_point_x_delay <= {shear_or_point_x_delay[119:0], shear_or_point_x};
    matrix_delay <= {matrix_delay[42:0], matrix};
    shear_or_point_y_delay <= {shear_or_point_y_delay[119:0], shear_or_point_y};
    origin_z_delay <= {origin_z_delay[311:0], origin_z};
    ew_y_delay <= {ew_y_delay[215:0], ew_y};
    ev_y_delay <= {ev_y_delay[167:0], ev_y};
    wc_y_delay <= {wc_y_delay[95:0], wc_y};
    scaled_y_delay <= {scaled_y_delay[191:0], scaled_y};
    v_or_moved_y_delay <= {v_or_moved_y_delay[383:0], v_or_moved_y};
    w_or_moved_x_delay <= {w_or_moved_x_delay[263:0], w_or_moved_x};
    edge_signs_differ_delay <= {edge_signs_differ_delay[8:0], some_negative_s23 & some_positive_s23};
    test_misses_delay <= {test_misses_delay[15:0], edge_signs_differ_s33 | det_is_zero_s33};
  end

  assign test_t = t_y;
  assign moved_z = scaled_y;
  assign weighted_x = v_y;
  assign weighted_y = u_y;
  assign weighted_z = distance_y;

endmodule

`default_nettype wire
