// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_fp_mul: y = a * b in fp24(1-7-16), rounded to nearest even, for 100 MHz.
// Latency: 3 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_fp_mul (
  input  wire        clk,
  input  wire [23:0] a,
  input  wire [23:0] b,
  output reg  [23:0] y
);

  wire a_sign = a[23];
  wire [6:0] a_exponent = a[22:16];
  wire [15:0] a_fraction = a[15:0];
  wire b_sign = b[23];
  wire [6:0] b_exponent = b[22:16];
  wire [15:0] b_fraction = b[15:0];

  // The significands, in [1, 2), and their product, in [1, 4).
  wire [16:0] a_significand = {1'b1, a_fraction};
  wire [16:0] b_significand = {1'b1, b_fraction};
  wire [33:0] product = a_significand * b_significand;
  reg  [33:0] product_s1;

  // The exponent for a product in [1, 2). The bias is a power of two less 1: the 1 is carried in.
  wire sign = a_sign ^ b_sign;
  wire [8:0] exponent_sum = {1'b0, a_exponent, 1'b1} + {1'b0, b_exponent, 1'b1};
  wire [8:0] low_exponent = {{1'b0, exponent_sum[8:7]} - 3'd1, exponent_sum[6:1]};

  // Zero times infinity is a NaN, as is whatever has a NaN for a factor.
  wire a_is_zero = ~|a_exponent;
  wire b_is_zero = ~|b_exponent;
  wire a_is_special = &a_exponent;
  wire b_is_special = &b_exponent;
  wire special = a_is_special | b_is_special;
  wire factor_is_zero = a_is_zero | b_is_zero;
  wire nan =
      (a_is_special & (|a_fraction)) |
      (b_is_special & (|b_fraction)) |
      (special & factor_is_zero);
  wire [3:0] status = {sign, special, nan, factor_is_zero};

  // Round to nearest even.
  wire at_least_2 = product_s1[33];
  wire [15:0] product_fraction = at_least_2 ? product_s1[32:17] : product_s1[31:16];
  wire half = at_least_2 ? product_s1[16] : product_s1[15];
  wire more_than_half = (|product_s1[14:0]) | (at_least_2 & product_s1[15]);
  wire round_up = half & (more_than_half | product_fraction[0]);
  reg  [8:0] low_exponent_s1, low_exponent_s2;
  reg  [15:0] product_fraction_s2;
  wire [25:0] unrounded = {low_exponent_s2, product_fraction_s2, 1'b1};
  reg  at_least_2_s2;
  reg  round_up_s2;
  wire [25:0] correction = {8'd0, at_least_2_s2, 16'd0, round_up_s2};
  wire [25:0] rounded = unrounded + correction;

  // Below the least normal number: zero. Above the greatest: infinity.
  reg  [3:0] status_s1, status_s2;
  wire y_is_negative = status_s2[3];
  wire y_is_special = status_s2[2];
  wire y_is_nan = status_s2[1];
  wire y_is_zero = status_s2[0];
  wire [8:0] exponent = rounded[25:17];
  wire [15:0] fraction = rounded[16:1];
  wire underflow = exponent[8] | (~|exponent);
  wire overflow = ~exponent[8] & (exponent[7] | (&exponent[6:0]));
  wire zero = (underflow | y_is_zero) & ~y_is_special;
  wire infinity_or_nan = y_is_special | (overflow & ~y_is_zero);
  wire y_sign = y_is_negative & ~y_is_nan & ~zero;
  wire [6:0] y_exponent = {7{infinity_or_nan}} | (exponent[6:0] & {7{~zero}});
  wire [15:0] number_fraction = fraction & {16{~(infinity_or_nan | zero)}};
  wire [15:0] y_fraction = {number_fraction[15] | y_is_nan, number_fraction[14:0]};
  wire [23:0] result = {y_sign, y_exponent, y_fraction};

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    product_s1 <= product;
    low_exponent_s1 <= low_exponent;
    status_s1 <= status;

    // Stage 2
    low_exponent_s2 <= low_exponent_s1;
    product_fraction_s2 <= product_fraction;
    at_least_2_s2 <= at_least_2;
    round_up_s2 <= round_up;
    status_s2 <= status_s1;

    // Stage 3
    y <= result;
  end

  // What nothing reads.
  wire unused = &{1'b0, exponent_sum[0], rounded[0]};

endmodule

`default_nettype wire
