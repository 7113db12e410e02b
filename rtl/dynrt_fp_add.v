// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_fp_add: y = a + b in fp24(1-7-16), rounded to nearest even, for 100 MHz.
// Latency: 5 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_fp_add (
  input  wire        clk,
  input  wire [23:0] a,
  input  wire [23:0] b,
  output reg  [23:0] y
);

  wire a_sign = a[23];
  wire [6:0] a_exponent = a[22:16];
  wire [15:0] a_fraction = a[15:0];
  wire [22:0] a_magnitude = a[22:0];
  wire b_sign = b[23];
  wire [6:0] b_exponent = b[22:16];
  wire [15:0] b_fraction = b[15:0];
  wire [22:0] b_magnitude = b[22:0];

  // The operand of the greater magnitude, and by how many bits the other must move.
  wire swap = a_magnitude < b_magnitude;
  wire [7:0] exponent_difference = {1'b0, a_exponent} - {1'b0, b_exponent};
  wire [6:0] distance = exponent_difference[7] ? (b_exponent - a_exponent) : exponent_difference[6:0];
  wire subtracting = a_sign ^ b_sign;
  wire both_are_special = (&a_exponent) & (&b_exponent);
  wire either_is_zero = (~|a_exponent) | (~|b_exponent);
  wire too_far = |distance[6:5];
  wire small_vanishes = either_is_zero | too_far;
  wire big_sign = swap ? b_sign : a_sign;
  wire [6:0] big_exponent = swap ? b_exponent : a_exponent;
  wire [15:0] big_fraction = swap ? b_fraction : a_fraction;
  wire [15:0] small_fraction = (swap ? a_fraction : b_fraction) & {16{~small_vanishes}};

  // Align the smaller significand; a sticky bit collects what is shifted out.
  wire [18:0] unaligned = {~small_vanishes, small_fraction, 2'd0};
  reg  distance_by_16_s1;
  reg  [18:0] unaligned_s1;
  wire [18:0] aligned_within_16 = distance_by_16_s1 ? {16'd0, unaligned_s1[18:16]} : unaligned_s1;
  reg  small_is_far_s1;
  wire sticky_within_16 = small_is_far_s1 | (distance_by_16_s1 & (|unaligned_s1[15:0]));
  reg  distance_by_8_s1;
  wire [18:0] aligned_within_8 =
      distance_by_8_s1 ? {8'd0, aligned_within_16[18:8]} :
      aligned_within_16;
  wire sticky_within_8 = sticky_within_16 | (distance_by_8_s1 & (|aligned_within_16[7:0]));
  reg  distance_by_4_s1;
  wire [18:0] aligned_within_4 = distance_by_4_s1 ? {4'd0, aligned_within_8[18:4]} : aligned_within_8;
  wire sticky_within_4 = sticky_within_8 | (distance_by_4_s1 & (|aligned_within_8[3:0]));
  reg  distance_by_2_s1;
  wire [18:0] aligned_within_2 = distance_by_2_s1 ? {2'd0, aligned_within_4[18:2]} : aligned_within_4;
  wire sticky_within_2 = sticky_within_4 | (distance_by_2_s1 & (|aligned_within_4[1:0]));
  reg  distance_by_1_s1;
  wire [18:0] aligned_within_1 = distance_by_1_s1 ? {1'b0, aligned_within_2[18:1]} : aligned_within_2;
  wire sticky_within_1 = sticky_within_2 | (distance_by_1_s1 & aligned_within_2[0]);

  // The sum: carry, significand, three bits to round by. It is never negative.
  reg  subtracting_s1;
  reg  [15:0] big_fraction_s1;
  wire [20:0] augend = {2'd1, big_fraction_s1, 2'd0, subtracting_s1};
  wire [20:0] addend = {
      subtracting_s1,
      aligned_within_1[18] ^ subtracting_s1,
      aligned_within_1[17:2] ^ {16{subtracting_s1}},
      aligned_within_1[1:0] ^ {2{subtracting_s1}},
      sticky_within_1 ^ subtracting_s1
    };
  wire [20:0] sum = augend + addend;

  // A NaN or an infinity is always the greater operand. Infinities of the same sign add to one.
  reg  [6:0] big_exponent_s1;
  wire big_is_special = &big_exponent_s1;
  reg  both_are_special_s1;
  wire nan = big_is_special & ((|big_fraction_s1) | (both_are_special_s1 & subtracting_s1));
  reg  big_sign_s1;
  wire [2:0] status = {big_sign_s1, big_is_special, nan};
  wire [8:0] exponent_plus_2 = {2'd0, big_exponent_s1} + 9'd2;

  // Normalise: the leading one moves to the front, to where a carry would be.
  reg  [20:0] sum_s2;
  wire zeros_16 = ~|sum_s2[20:5];
  wire [20:0] normal_within_16 = zeros_16 ? {sum_s2[4:0], 16'd0} : sum_s2;
  wire zeros_8 = ~|normal_within_16[20:13];
  wire [20:0] normal_within_8 = zeros_8 ? {normal_within_16[12:0], 8'd0} : normal_within_16;
  reg  [20:0] normal_within_8_s3;
  wire zeros_4 = ~|normal_within_8_s3[20:17];
  wire [20:0] normal_within_4 = zeros_4 ? {normal_within_8_s3[16:0], 4'd0} : normal_within_8_s3;
  wire zeros_2 = ~|normal_within_4[20:19];
  wire [20:0] normal_within_2 = zeros_2 ? {normal_within_4[18:0], 2'd0} : normal_within_4;
  wire zeros_1 = ~normal_within_2[20];
  wire [20:0] normal_within_1 = zeros_1 ? {normal_within_2[19:0], 1'b0} : normal_within_2;

  // Round to nearest even. The exponent is that of the greater operand, plus 1, minus the shift;
  // minus the shift is plus its complement plus 1.
  wire round_up = normal_within_1[3] & (normal_within_1[4] | (|normal_within_1[2:0]));
  wire cancelled = ~normal_within_1[20];
  wire [15:0] normal_fraction = normal_within_1[19:4];
  reg  zeros_16_s3;
  reg  zeros_8_s3;
  wire [4:0] shift = {zeros_16_s3, zeros_8_s3, zeros_4, zeros_2, zeros_1};
  reg  [4:0] shift_s4;
  reg  [8:0] exponent_plus_2_s2, exponent_plus_2_s3, exponent_plus_2_s4;
  reg  [15:0] normal_fraction_s4;
  wire [25:0] unrounded = {exponent_plus_2_s4, normal_fraction_s4, 1'b1};
  reg  round_up_s4;
  wire [25:0] correction = {~{4'd0, shift_s4}, 16'd0, round_up_s4};
  wire [25:0] rounded = unrounded + correction;

  // Below the least normal number: zero. Above the greatest: infinity.
  reg  [2:0] status_s2, status_s3, status_s4;
  wire y_is_negative = status_s4[2];
  wire y_is_special = status_s4[1];
  wire y_is_nan = status_s4[0];
  wire [8:0] exponent = rounded[25:17];
  wire [15:0] fraction = rounded[16:1];
  wire underflow = exponent[8] | (~|exponent);
  wire overflow = ~exponent[8] & (exponent[7] | (&exponent[6:0]));
  reg  cancelled_s4;
  wire zero = (underflow | cancelled_s4) & ~y_is_special;
  wire infinity_or_nan = y_is_special | (overflow & ~cancelled_s4);
  wire y_sign = y_is_negative & ~y_is_nan & ~zero;
  wire [6:0] y_exponent = {7{infinity_or_nan}} | (exponent[6:0] & {7{~zero}});
  wire [15:0] number_fraction = fraction & {16{~(infinity_or_nan | zero)}};
  wire [15:0] y_fraction = {number_fraction[15] | y_is_nan, number_fraction[14:0]};
  wire [23:0] result = {y_sign, y_exponent, y_fraction};

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    distance_by_16_s1 <= distance[4];
    unaligned_s1 <= unaligned;
    small_is_far_s1 <= too_far & ~either_is_zero;
    distance_by_8_s1 <= distance[3];
    distance_by_4_s1 <= distance[2];
    distance_by_2_s1 <= distance[1];
    distance_by_1_s1 <= distance[0];
    subtracting_s1 <= subtracting;
    big_fraction_s1 <= big_fraction;
    big_exponent_s1 <= big_exponent;
    both_are_special_s1 <= both_are_special;
    big_sign_s1 <= big_sign;

    // Stage 2
    sum_s2 <= sum;
    exponent_plus_2_s2 <= exponent_plus_2;
    status_s2 <= status;

    // Stage 3
    normal_within_8_s3 <= normal_within_8;
    zeros_16_s3 <= zeros_16;
    zeros_8_s3 <= zeros_8;
    exponent_plus_2_s3 <= exponent_plus_2_s2;
    status_s3 <= status_s2;

    // Stage 4
    shift_s4 <= shift;
    exponent_plus_2_s4 <= exponent_plus_2_s3;
    normal_fraction_s4 <= normal_fraction;
    round_up_s4 <= round_up;
    status_s4 <= status_s3;
    cancelled_s4 <= cancelled;

    // Stage 5
    y <= result;
  end

  // What nothing reads.
  wire unused = &{1'b0, rounded[0]};

endmodule

`default_nettype wire
