// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_fp_reciprocal: y = 1 / a in fp24(1-7-16), rounded to nearest even, for 100 MHz.
// Latency: 12 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_fp_reciprocal (
  input  wire        clk,
  input  wire [23:0] a,
  output reg  [23:0] y
);

  wire a_sign = a[23];
  wire [6:0] a_exponent = a[22:16];
  wire [15:0] a_fraction = a[15:0];

  // The exponent of 1 / a where a is no power of two; for a power of two rounding adds the 1 that
  // lacks. The two greatest exponents give results below the least normal number, except for the
  // lesser power of two.
  wire [6:0] exponent = ~a_exponent - 7'd2;
  wire fraction_is_zero = ~|a_fraction;
  wire underflow = (a_exponent == 7'd126) | ((a_exponent == 7'd125) & ~fraction_is_zero);
  wire a_is_zero = ~|a_exponent;
  wire a_is_special = &a_exponent;
  wire nan = a_is_special & ~fraction_is_zero;
  wire zero = underflow | (a_is_special & fraction_is_zero);
  wire infinity_or_nan = a_is_zero | nan;
  wire [3:0] status = {a_sign, infinity_or_nan, nan, zero};

  // Non-restoring division of 2 by the significand: every remainder's sign is a bit of the
  // quotient.
  wire [17:0] significand = {2'd1, a_fraction};
  wire [17:0] remainder_1 = significand - {a_fraction, 2'd0};
  wire quotient_1 = ~remainder_1[17];
  wire [15:0] chosen_2 = a_fraction ^ {16{quotient_1}};
  reg  quotient_1_s1;
  reg  [16:0] remainder_1_low_s1;
  reg  [15:0] chosen_2_s1;
  wire [17:0] remainder_2 =
      {remainder_1_low_s1, quotient_1_s1} +
      {quotient_1_s1, ~quotient_1_s1, chosen_2_s1};
  wire subtract_3 = ~remainder_2[17];
  wire [15:0] chosen_3 = chosen_2_s1 ^ {16{quotient_1_s1 ^ subtract_3}};
  wire [17:0] remainder_3 = {remainder_2[16:0], subtract_3} + {subtract_3, ~subtract_3, chosen_3};
  wire [2:0] quotient_3 = {quotient_1_s1, subtract_3, ~remainder_3[17]};
  reg  [17:0] remainder_3_s2;
  reg  [15:0] chosen_2_s2;
  reg  quotient_1_s2;
  wire subtract_4 = ~remainder_3_s2[17];
  wire [15:0] chosen_4 = chosen_2_s2 ^ {16{quotient_1_s2 ^ subtract_4}};
  wire [17:0] remainder_4 = {remainder_3_s2[16:0], subtract_4} + {subtract_4, ~subtract_4, chosen_4};
  reg  [2:0] quotient_3_s2;
  wire subtract_5 = ~remainder_4[17];
  wire [3:0] quotient_4 = {quotient_3_s2, subtract_5};
  wire [15:0] chosen_5 = chosen_2_s2 ^ {16{quotient_1_s2 ^ subtract_5}};
  reg  subtract_5_s3;
  reg  [16:0] remainder_4_low_s3;
  reg  [15:0] chosen_5_s3;
  wire [17:0] remainder_5 =
      {remainder_4_low_s3, subtract_5_s3} +
      {subtract_5_s3, ~subtract_5_s3, chosen_5_s3};
  reg  [3:0] quotient_4_s3;
  wire subtract_6 = ~remainder_5[17];
  wire [15:0] chosen_6 = chosen_5_s3 ^ {16{subtract_5_s3 ^ subtract_6}};
  wire [17:0] remainder_6 = {remainder_5[16:0], subtract_6} + {subtract_6, ~subtract_6, chosen_6};
  wire [5:0] quotient_6 = {quotient_4_s3, subtract_6, ~remainder_6[17]};
  reg  [17:0] remainder_6_s4;
  reg  [15:0] chosen_5_s4;
  reg  subtract_5_s4;
  wire subtract_7 = ~remainder_6_s4[17];
  wire [15:0] chosen_7 = chosen_5_s4 ^ {16{subtract_5_s4 ^ subtract_7}};
  wire [17:0] remainder_7 = {remainder_6_s4[16:0], subtract_7} + {subtract_7, ~subtract_7, chosen_7};
  reg  [5:0] quotient_6_s4;
  wire subtract_8 = ~remainder_7[17];
  wire [6:0] quotient_7 = {quotient_6_s4, subtract_8};
  wire [15:0] chosen_8 = chosen_5_s4 ^ {16{subtract_5_s4 ^ subtract_8}};
  reg  subtract_8_s5;
  reg  [16:0] remainder_7_low_s5;
  reg  [15:0] chosen_8_s5;
  wire [17:0] remainder_8 =
      {remainder_7_low_s5, subtract_8_s5} +
      {subtract_8_s5, ~subtract_8_s5, chosen_8_s5};
  reg  [6:0] quotient_7_s5;
  wire subtract_9 = ~remainder_8[17];
  wire [15:0] chosen_9 = chosen_8_s5 ^ {16{subtract_8_s5 ^ subtract_9}};
  wire [17:0] remainder_9 = {remainder_8[16:0], subtract_9} + {subtract_9, ~subtract_9, chosen_9};
  wire [8:0] quotient_9 = {quotient_7_s5, subtract_9, ~remainder_9[17]};
  reg  [17:0] remainder_9_s6;
  reg  [15:0] chosen_8_s6;
  reg  subtract_8_s6;
  wire subtract_10 = ~remainder_9_s6[17];
  wire [15:0] chosen_10 = chosen_8_s6 ^ {16{subtract_8_s6 ^ subtract_10}};
  wire [17:0] remainder_10 =
      {remainder_9_s6[16:0], subtract_10} +
      {subtract_10, ~subtract_10, chosen_10};
  reg  [8:0] quotient_9_s6;
  wire subtract_11 = ~remainder_10[17];
  wire [9:0] quotient_10 = {quotient_9_s6, subtract_11};
  wire [15:0] chosen_11 = chosen_8_s6 ^ {16{subtract_8_s6 ^ subtract_11}};
  reg  subtract_11_s7;
  reg  [16:0] remainder_10_low_s7;
  reg  [15:0] chosen_11_s7;
  wire [17:0] remainder_11 =
      {remainder_10_low_s7, subtract_11_s7} +
      {subtract_11_s7, ~subtract_11_s7, chosen_11_s7};
  reg  [9:0] quotient_10_s7;
  wire subtract_12 = ~remainder_11[17];
  wire [15:0] chosen_12 = chosen_11_s7 ^ {16{subtract_11_s7 ^ subtract_12}};
  wire [17:0] remainder_12 =
      {remainder_11[16:0], subtract_12} +
      {subtract_12, ~subtract_12, chosen_12};
  wire [11:0] quotient_12 = {quotient_10_s7, subtract_12, ~remainder_12[17]};
  reg  [17:0] remainder_12_s8;
  reg  [15:0] chosen_11_s8;
  reg  subtract_11_s8;
  wire subtract_13 = ~remainder_12_s8[17];
  wire [15:0] chosen_13 = chosen_11_s8 ^ {16{subtract_11_s8 ^ subtract_13}};
  wire [17:0] remainder_13 =
      {remainder_12_s8[16:0], subtract_13} +
      {subtract_13, ~subtract_13, chosen_13};
  reg  [11:0] quotient_12_s8;
  wire subtract_14 = ~remainder_13[17];
  wire [12:0] quotient_13 = {quotient_12_s8, subtract_14};
  wire [15:0] chosen_14 = chosen_11_s8 ^ {16{subtract_11_s8 ^ subtract_14}};
  reg  subtract_14_s9;
  reg  [16:0] remainder_13_low_s9;
  reg  [15:0] chosen_14_s9;
  wire [17:0] remainder_14 =
      {remainder_13_low_s9, subtract_14_s9} +
      {subtract_14_s9, ~subtract_14_s9, chosen_14_s9};
  reg  [12:0] quotient_13_s9;
  wire subtract_15 = ~remainder_14[17];
  wire [15:0] chosen_15 = chosen_14_s9 ^ {16{subtract_14_s9 ^ subtract_15}};
  wire [17:0] remainder_15 =
      {remainder_14[16:0], subtract_15} +
      {subtract_15, ~subtract_15, chosen_15};
  wire [14:0] quotient_15 = {quotient_13_s9, subtract_15, ~remainder_15[17]};
  reg  [17:0] remainder_15_s10;
  reg  [15:0] chosen_14_s10;
  reg  subtract_14_s10;
  wire subtract_16 = ~remainder_15_s10[17];
  wire [15:0] chosen_16 = chosen_14_s10 ^ {16{subtract_14_s10 ^ subtract_16}};
  wire [17:0] remainder_16 =
      {remainder_15_s10[16:0], subtract_16} +
      {subtract_16, ~subtract_16, chosen_16};
  reg  [14:0] quotient_15_s10;
  wire subtract_17 = ~remainder_16[17];
  wire [15:0] quotient_16 = {quotient_15_s10, subtract_17};
  wire [15:0] chosen_17 = chosen_14_s10 ^ {16{subtract_14_s10 ^ subtract_17}};
  reg  subtract_17_s11;
  reg  [16:0] remainder_16_low_s11;
  reg  [15:0] chosen_17_s11;
  wire [17:0] remainder_17 =
      {remainder_16_low_s11, subtract_17_s11} +
      {subtract_17_s11, ~subtract_17_s11, chosen_17_s11};
  reg  [15:0] quotient_16_s11;

  // Round by the last bit of the quotient.
  reg  [43:0] status_delay;
  wire [3:0] status_s11 = status_delay[43:40];
  wire y_is_negative = status_s11[3];
  reg  [76:0] exponent_delay;
  wire [6:0] exponent_s11 = exponent_delay[76:70];
  wire [22:0] unrounded = {exponent_s11, quotient_16_s11};
  wire [22:0] rounded = unrounded + {22'd0, ~remainder_17[17]};
  wire y_is_infinity_or_nan = status_s11[2];
  wire y_is_nan = status_s11[1];
  wire y_is_zero = status_s11[0];
  wire y_sign = y_is_negative & ~y_is_nan & ~y_is_zero;
  wire [6:0] y_exponent = {7{y_is_infinity_or_nan}} | (rounded[22:16] & {7{~y_is_zero}});
  wire [15:0] number_fraction = rounded[15:0] & {16{~(y_is_infinity_or_nan | y_is_zero)}};
  wire [15:0] y_fraction = {number_fraction[15] | y_is_nan, number_fraction[14:0]};
  wire [23:0] result = {y_sign, y_exponent, y_fraction};

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    quotient_1_s1 <= quotient_1;
    remainder_1_low_s1 <= remainder_1[16:0];
    chosen_2_s1 <= chosen_2;

    // Stage 2
    remainder_3_s2 <= remainder_3;
    chosen_2_s2 <= chosen_2_s1;
    quotient_1_s2 <= quotient_1_s1;
    quotient_3_s2 <= quotient_3;

    // Stage 3
    subtract_5_s3 <= subtract_5;
    remainder_4_low_s3 <= remainder_4[16:0];
    chosen_5_s3 <= chosen_5;
    quotient_4_s3 <= quotient_4;

    // Stage 4
    remainder_6_s4 <= remainder_6;
    chosen_5_s4 <= chosen_5_s3;
    subtract_5_s4 <= subtract_5_s3;
    quotient_6_s4 <= quotient_6;

    // Stage 5
    subtract_8_s5 <= subtract_8;
    remainder_7_low_s5 <= remainder_7[16:0];
    chosen_8_s5 <= chosen_8;
    quotient_7_s5 <= quotient_7;

    // Stage 6
    remainder_9_s6 <= remainder_9;
    chosen_8_s6 <= chosen_8_s5;
    subtract_8_s6 <= subtract_8_s5;
    quotient_9_s6 <= quotient_9;

    // Stage 7
    subtract_11_s7 <= subtract_11;
    remainder_10_low_s7 <= remainder_10[16:0];
    chosen_11_s7 <= chosen_11;
    quotient_10_s7 <= quotient_10;

    // Stage 8
    remainder_12_s8 <= remainder_12;
    chosen_11_s8 <= chosen_11_s7;
    subtract_11_s8 <= subtract_11_s7;
    quotient_12_s8 <= quotient_12;

    // Stage 9
    subtract_14_s9 <= subtract_14;
    remainder_13_low_s9 <= remainder_13[16:0];
    chosen_14_s9 <= chosen_14;
    quotient_13_s9 <= quotient_13;

    // Stage 10
    remainder_15_s10 <= remainder_15;
    chosen_14_s10 <= chosen_14_s9;
    subtract_14_s10 <= subtract_14_s9;
    quotient_15_s10 <= quotient_15;

    // Stage 11
    subtract_17_s11 <= subtract_17;
    remainder_16_low_s11 <= remainder_16[16:0];
    chosen_17_s11 <= chosen_17;
    quotient_16_s11 <= quotient_16;

    // Stage 12
    y <= result;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    status_delay <= {status_delay[39:0], status};
    exponent_delay <= {exponent_delay[69:0], exponent};
  end

  // What nothing reads.
  wire unused = &{1'b0, remainder_17[16:0]};

endmodule

`default_nettype wire
