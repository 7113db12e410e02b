// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_near_distance: a ray's distance to a near plane, three ulps down: it is never beyond the exact
// one.
// Latency: 9 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_near_distance (
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

  wire [22:0] scaled_y_moved = scaled_y[22:0] + (scaled_y[23] ? 23'd3 : 23'h7ffffd);
  wire [15:0] scaled_y_moved_fraction = scaled_y_moved[15:0];
  wire scaled_y_is_not_zero = |scaled_y[22:16];
  wire scaled_y_steps_to_zero = scaled_y_is_not_zero & (~|(~scaled_y_moved_fraction[1:0]));
  wire [1:0] scaled_y_fraction_about_zero =
      scaled_y_steps_to_zero ? 2'd0 :
      ~scaled_y_is_not_zero ? 2'd2 :
      (~scaled_y_moved_fraction[1:0] - 2'd1);
  wire [23:0] scaled_y_stepped_about_zero = {
      ~scaled_y_steps_to_zero,
      6'd0,
      ~scaled_y_steps_to_zero,
      14'd0,
      scaled_y_fraction_about_zero
    };
  wire [23:0] scaled_y_stepped_further = {
      scaled_y[23],
      scaled_y_moved[22:16],
      scaled_y_moved_fraction & {16{~(&scaled_y_moved[22:16])}}
    };
  wire [23:0] scaled_y_stepped_number =
      (~scaled_y_is_not_zero | (~scaled_y[23] & (~|scaled_y_moved[22:16]))) ? scaled_y_stepped_about_zero :
      scaled_y_stepped_further;

  // Pipeline registers.
  always @(posedge clk) begin
    distance <= (&scaled_y[22:16]) ? scaled_y : scaled_y_stepped_number;
  end

endmodule

`default_nettype wire
