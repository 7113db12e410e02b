// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_far_distance: a ray's distance to a far plane, three ulps up: it is never short of the exact one.
// Latency: 9 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_far_distance (
  input  wire        clk,

  // The plane, and the ray's origin and reciprocal direction on the plane's axis
  input  wire [23:0] plane,
  input  wire [23:0] origin,
  input  wire [23:0] reciprocal,

  // Distance in multiples of the ray's direction
  output reg  [23:0] distance
);

  wire [23:0] offset_y;
  dynrt_fp_sub offset (
    .clk(clk),
    .a(plane),
    .b(origin),
    .y(offset_y)
  );

  wire [23:0] scaled_y;
  dynrt_fp_mul scaled (
    .clk(clk),
    .a(offset_y),
    .b(reciprocal),
    .y(scaled_y)
  );

  wire [22:0] sum = scaled_y[22:0] + (~scaled_y[23] ? 23'd3 : 23'h7ffffd);
  wire any_scaled_y_22_16 = |scaled_y[22:16];
  wire term = any_scaled_y_22_16 & (~|(~sum[1:0]));
  wire [1:0] choice =
      term ? 2'd0 :
      ~any_scaled_y_22_16 ? 2'd2 :
      (~sum[1:0] - 2'd1);
  wire [23:0] joined = {scaled_y[23], sum[22:16], sum[15:0] & {16{~(&sum[22:16])}}};
  wire [23:0] choice_2 =
      (~any_scaled_y_22_16 | (scaled_y[23] & (~|sum[22:16]))) ? {1'b0, 6'd0, ~term, 14'd0, choice} :
      joined;

  // Pipeline registers.
  always @(posedge clk) begin
    distance <= (&scaled_y[22:16]) ? scaled_y : choice_2;
  end

endmodule

`default_nettype wire
