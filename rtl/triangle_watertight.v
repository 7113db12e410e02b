// SPDX-License-Identifier: MIT OR Apache-2.0
// triangle_watertight: the watertight ray-triangle test of Woop, Benthin and Wald: edge functions
// of vertices sheared into the ray's frame.
// Latency: 50 clocks, one set of inputs a clock.

`default_nettype none

module triangle_watertight (
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

  // Distance, the second and third vertex's weights, and whether the ray passes the triangle
  output wire [23:0] test_t,
  output reg  [23:0] test_u,
  output reg  [23:0] test_v,
  output wire        test_misses
);

  // A, seen from the origin and sheared.
  wire [23:0] a_x_y;
  fp_sub a_x (
    .clk(clk),
    .a(v0_x),
    .b(origin_x),
    .y(a_x_y)
  );

  wire [23:0] a_y_y;
  fp_sub a_y (
    .clk(clk),
    .a(v0_y),
    .b(origin_y),
    .y(a_y_y)
  );

  wire [23:0] a_z_y;
  fp_sub a_z (
    .clk(clk),
    .a(v0_z),
    .b(origin_z),
    .y(a_z_y)
  );

  reg  [4:0] kz_is_1_delay;
  wire kz_is_1_s5 = kz_is_1_delay[4];
  reg  [4:0] kz_is_0_delay;
  wire kz_is_0_s5 = kz_is_0_delay[4];
  wire [23:0] a_kz =
      kz_is_0_s5 ? a_x_y :
      kz_is_1_s5 ? a_y_y :
      a_z_y;
  reg  [407:0] a_kz_delay;
  wire [23:0] a_kz_s6 = a_kz_delay[23:0];
  wire [23:0] a_kx =
      kz_is_0_s5 ? a_y_y :
      kz_is_1_s5 ? a_z_y :
      a_x_y;
  reg  [95:0] a_kx_delay;
  wire [23:0] a_ky =
      kz_is_0_s5 ? a_z_y :
      kz_is_1_s5 ? a_x_y :
      a_y_y;
  reg  [95:0] a_ky_delay;
  reg  [143:0] shear_x_delay;
  wire [23:0] shear_x_s6 = shear_x_delay[143:120];

  wire [23:0] ax_shift_y;
  fp_mul ax_shift (
    .clk(clk),
    .a(shear_x_s6),
    .b(a_kz_s6),
    .y(ax_shift_y)
  );

  wire [23:0] a_kx_s9 = a_kx_delay[95:72];

  wire [23:0] ax_y;
  fp_sub ax (
    .clk(clk),
    .a(a_kx_s9),
    .b(ax_shift_y),
    .y(ax_y)
  );

  reg  [143:0] shear_y_delay;
  wire [23:0] shear_y_s6 = shear_y_delay[143:120];

  wire [23:0] ay_shift_y;
  fp_mul ay_shift (
    .clk(clk),
    .a(shear_y_s6),
    .b(a_kz_s6),
    .y(ay_shift_y)
  );

  wire [23:0] a_ky_s9 = a_ky_delay[95:72];

  wire [23:0] ay_y;
  fp_sub ay (
    .clk(clk),
    .a(a_ky_s9),
    .b(ay_shift_y),
    .y(ay_y)
  );

  // B, seen from the origin and sheared.
  wire [23:0] b_x_y;
  fp_sub b_x (
    .clk(clk),
    .a(v1_x),
    .b(origin_x),
    .y(b_x_y)
  );

  wire [23:0] b_y_y;
  fp_sub b_y (
    .clk(clk),
    .a(v1_y),
    .b(origin_y),
    .y(b_y_y)
  );

  wire [23:0] b_z_y;
  fp_sub b_z (
    .clk(clk),
    .a(v1_z),
    .b(origin_z),
    .y(b_z_y)
  );

  wire [23:0] b_kz =
      kz_is_0_s5 ? b_x_y :
      kz_is_1_s5 ? b_y_y :
      b_z_y;
  reg  [407:0] b_kz_delay;
  wire [23:0] b_kz_s6 = b_kz_delay[23:0];
  wire [23:0] b_kx =
      kz_is_0_s5 ? b_y_y :
      kz_is_1_s5 ? b_z_y :
      b_x_y;
  reg  [95:0] b_kx_delay;
  wire [23:0] b_ky =
      kz_is_0_s5 ? b_z_y :
      kz_is_1_s5 ? b_x_y :
      b_y_y;
  reg  [95:0] b_ky_delay;

  wire [23:0] bx_shift_y;
  fp_mul bx_shift (
    .clk(clk),
    .a(shear_x_s6),
    .b(b_kz_s6),
    .y(bx_shift_y)
  );

  wire [23:0] b_kx_s9 = b_kx_delay[95:72];

  wire [23:0] bx_y;
  fp_sub bx (
    .clk(clk),
    .a(b_kx_s9),
    .b(bx_shift_y),
    .y(bx_y)
  );

  wire [23:0] by_shift_y;
  fp_mul by_shift (
    .clk(clk),
    .a(shear_y_s6),
    .b(b_kz_s6),
    .y(by_shift_y)
  );

  wire [23:0] b_ky_s9 = b_ky_delay[95:72];

  wire [23:0] by_y;
  fp_sub by (
    .clk(clk),
    .a(b_ky_s9),
    .b(by_shift_y),
    .y(by_y)
  );

  // C, seen from the origin and sheared.
  wire [23:0] c_x_y;
  fp_sub c_x (
    .clk(clk),
    .a(v2_x),
    .b(origin_x),
    .y(c_x_y)
  );

  wire [23:0] c_y_y;
  fp_sub c_y (
    .clk(clk),
    .a(v2_y),
    .b(origin_y),
    .y(c_y_y)
  );

  wire [23:0] c_z_y;
  fp_sub c_z (
    .clk(clk),
    .a(v2_z),
    .b(origin_z),
    .y(c_z_y)
  );

  wire [23:0] c_kz =
      kz_is_0_s5 ? c_x_y :
      kz_is_1_s5 ? c_y_y :
      c_z_y;
  reg  [407:0] c_kz_delay;
  wire [23:0] c_kz_s6 = c_kz_delay[23:0];
  wire [23:0] c_kx =
      kz_is_0_s5 ? c_y_y :
      kz_is_1_s5 ? c_z_y :
      c_x_y;
  reg  [95:0] c_kx_delay;
  wire [23:0] c_ky =
      kz_is_0_s5 ? c_z_y :
      kz_is_1_s5 ? c_x_y :
      c_y_y;
  reg  [95:0] c_ky_delay;

  wire [23:0] cx_shift_y;
  fp_mul cx_shift (
    .clk(clk),
    .a(shear_x_s6),
    .b(c_kz_s6),
    .y(cx_shift_y)
  );

  wire [23:0] c_kx_s9 = c_kx_delay[95:72];

  wire [23:0] cx_y;
  fp_sub cx (
    .clk(clk),
    .a(c_kx_s9),
    .b(cx_shift_y),
    .y(cx_y)
  );

  wire [23:0] cy_shift_y;
  fp_mul cy_shift (
    .clk(clk),
    .a(shear_y_s6),
    .b(c_kz_s6),
    .y(cy_shift_y)
  );

  wire [23:0] c_ky_s9 = c_ky_delay[95:72];

  wire [23:0] cy_y;
  fp_sub cy (
    .clk(clk),
    .a(c_ky_s9),
    .b(cy_shift_y),
    .y(cy_y)
  );

  // Edge functions.
  wire [23:0] eu_plus_y;
  fp_mul eu_plus (
    .clk(clk),
    .a(cx_y),
    .b(by_y),
    .y(eu_plus_y)
  );

  wire [23:0] eu_minus_y;
  fp_mul eu_minus (
    .clk(clk),
    .a(cy_y),
    .b(bx_y),
    .y(eu_minus_y)
  );

  wire [23:0] eu_y;
  fp_sub eu (
    .clk(clk),
    .a(eu_plus_y),
    .b(eu_minus_y),
    .y(eu_y)
  );

  wire [23:0] ev_plus_y;
  fp_mul ev_plus (
    .clk(clk),
    .a(ax_y),
    .b(cy_y),
    .y(ev_plus_y)
  );

  wire [23:0] ev_minus_y;
  fp_mul ev_minus (
    .clk(clk),
    .a(ay_y),
    .b(cx_y),
    .y(ev_minus_y)
  );

  wire [23:0] ev_y;
  fp_sub ev (
    .clk(clk),
    .a(ev_plus_y),
    .b(ev_minus_y),
    .y(ev_y)
  );

  wire [23:0] ew_plus_y;
  fp_mul ew_plus (
    .clk(clk),
    .a(bx_y),
    .b(ay_y),
    .y(ew_plus_y)
  );

  wire [23:0] ew_minus_y;
  fp_mul ew_minus (
    .clk(clk),
    .a(by_y),
    .b(ax_y),
    .y(ew_minus_y)
  );

  wire [23:0] ew_y;
  fp_sub ew (
    .clk(clk),
    .a(ew_plus_y),
    .b(ew_minus_y),
    .y(ew_y)
  );

  wire any_eu_y_22_16 = |eu_y[22:16];
  wire term = ~((&eu_y[22:16]) & (|eu_y[15:0]));
  wire any_ev_y_22_16 = |ev_y[22:16];
  wire term_2 = ~((&ev_y[22:16]) & (|ev_y[15:0]));
  wire term_3 = (eu_y[23] & any_eu_y_22_16 & term) | (ev_y[23] & any_ev_y_22_16 & term_2);
  wire any_ew_y_22_16 = |ew_y[22:16];
  wire term_4 = ~((&ew_y[22:16]) & (|ew_y[15:0]));
  wire some_negative = term_3 | (ew_y[23] & any_ew_y_22_16 & term_4);
  reg  some_negative_s23;
  wire term_5 = (eu_y[23] ? 1'b0 : (24'd0 < {eu_y[22:0], eu_y[23]})) & any_eu_y_22_16 & term;
  wire term_6 = (ev_y[23] ? 1'b0 : (24'd0 < {ev_y[22:0], ev_y[23]})) & any_ev_y_22_16 & term_2;
  wire term_7 = (ew_y[23] ? 1'b0 : (24'd0 < {ew_y[22:0], ew_y[23]})) & any_ew_y_22_16 & term_4;
  wire some_positive = term_5 | term_6 | term_7;
  reg  some_positive_s23;

  // det = (U + V) + W, i = 1 / det.
  wire [23:0] uv_y;
  fp_add uv (
    .clk(clk),
    .a(eu_y),
    .b(ev_y),
    .y(uv_y)
  );

  reg  [527:0] ew_y_delay;
  wire [23:0] ew_y_s27 = ew_y_delay[119:96];

  wire [23:0] det_y;
  fp_add det (
    .clk(clk),
    .a(uv_y),
    .b(ew_y_s27),
    .y(det_y)
  );

  wire [23:0] i_y;
  fp_reciprocal i (
    .clk(clk),
    .a(det_y),
    .y(i_y)
  );

  wire det_is_zero = ~|det_y[22:16];
  reg  det_is_zero_s33;

  // T = (U Az + V Bz) + W Cz, t = (T i) Sz, u = V i, v = W i.
  wire [23:0] a_kz_s22 = a_kz_delay[407:384];

  wire [23:0] ua_y;
  fp_mul ua (
    .clk(clk),
    .a(eu_y),
    .b(a_kz_s22),
    .y(ua_y)
  );

  wire [23:0] b_kz_s22 = b_kz_delay[407:384];

  wire [23:0] vb_y;
  fp_mul vb (
    .clk(clk),
    .a(ev_y),
    .b(b_kz_s22),
    .y(vb_y)
  );

  wire [23:0] c_kz_s22 = c_kz_delay[407:384];

  wire [23:0] wc_y;
  fp_mul wc (
    .clk(clk),
    .a(ew_y),
    .b(c_kz_s22),
    .y(wc_y)
  );

  wire [23:0] ua_vb_y;
  fp_add ua_vb (
    .clk(clk),
    .a(ua_y),
    .b(vb_y),
    .y(ua_vb_y)
  );

  reg  [119:0] wc_y_delay;
  wire [23:0] wc_y_s30 = wc_y_delay[119:96];

  wire [23:0] scaled_y;
  fp_add scaled (
    .clk(clk),
    .a(ua_vb_y),
    .b(wc_y_s30),
    .y(scaled_y)
  );

  reg  [215:0] scaled_y_delay;
  wire [23:0] scaled_y_s44 = scaled_y_delay[215:192];

  wire [23:0] distance_y;
  fp_mul distance (
    .clk(clk),
    .a(scaled_y_s44),
    .b(i_y),
    .y(distance_y)
  );

  wire [23:0] t_y;
  fp_mul t (
    .clk(clk),
    .a(distance_y),
    .b(shear_z),
    .y(t_y)
  );

  reg  [527:0] ev_y_delay;
  wire [23:0] ev_y_s44 = ev_y_delay[527:504];

  wire [23:0] u_y;
  fp_mul u (
    .clk(clk),
    .a(ev_y_s44),
    .b(i_y),
    .y(u_y)
  );

  wire [23:0] ew_y_s44 = ew_y_delay[527:504];

  wire [23:0] v_y;
  fp_mul v (
    .clk(clk),
    .a(ew_y_s44),
    .b(i_y),
    .y(v_y)
  );

  reg  [9:0] some_negative_and_some_positive_delay;
  wire some_negative_and_some_positive_s33 = some_negative_and_some_positive_delay[9];
  reg  [23:0] u_y_s48, u_y_s49;
  reg  [23:0] v_y_s48, v_y_s49;
  reg  [16:0] test_misses_delay;
  assign test_misses = test_misses_delay[16];

  // Pipeline registers.
  always @(posedge clk) begin
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
    kz_is_1_delay <= {kz_is_1_delay[3:0], kz == 2'd1};
    kz_is_0_delay <= {kz_is_0_delay[3:0], kz == 2'd0};
    a_kz_delay <= {a_kz_delay[383:0], a_kz};
    a_kx_delay <= {a_kx_delay[71:0], a_kx};
    a_ky_delay <= {a_ky_delay[71:0], a_ky};
    shear_x_delay <= {shear_x_delay[119:0], shear_x};
    shear_y_delay <= {shear_y_delay[119:0], shear_y};
    b_kz_delay <= {b_kz_delay[383:0], b_kz};
    b_kx_delay <= {b_kx_delay[71:0], b_kx};
    b_ky_delay <= {b_ky_delay[71:0], b_ky};
    c_kz_delay <= {c_kz_delay[383:0], c_kz};
    c_kx_delay <= {c_kx_delay[71:0], c_kx};
    c_ky_delay <= {c_ky_delay[71:0], c_ky};
    ew_y_delay <= {ew_y_delay[503:0], ew_y};
    wc_y_delay <= {wc_y_delay[95:0], wc_y};
    scaled_y_delay <= {scaled_y_delay[191:0], scaled_y};
    ev_y_delay <= {ev_y_delay[503:0], ev_y};
    some_negative_and_some_positive_delay <= {some_negative_and_some_positive_delay[8:0], some_negative_s23 & some_positive_s23};
    test_misses_delay <= {test_misses_delay[15:0], some_negative_and_some_positive_s33 | det_is_zero_s33};
  end

  assign test_t = t_y;

endmodule

`default_nettype wire
