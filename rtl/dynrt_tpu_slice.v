// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_tpu_slice: one ray's part of a packet step: four plane distances, its interval in each child,
// where it goes.
// Latency: 12 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_tpu_slice (
  input  wire        clk,

  // The node's intervals
  input  wire [23:0] left_lo,
  input  wire [23:0] left_hi,
  input  wire [23:0] right_lo,
  input  wire [23:0] right_hi,

  // The ray on the left and the right child's axis
  input  wire        left_sign,
  input  wire [23:0] left_origin,
  input  wire [23:0] left_reciprocal,
  input  wire        right_sign,
  input  wire [23:0] right_origin,
  input  wire [23:0] right_reciprocal,

  // The ray's interval in the node, needed when the distances are there
  input  wire [23:0] ray_near,
  input  wire [23:0] ray_far,
  input  wire        ray_active,

  // The ray's interval in the children, and where it goes
  output reg  [23:0] out_left_near,
  output reg  [23:0] out_left_far,
  output reg  [23:0] out_right_near,
  output reg  [23:0] out_right_far,
  output reg         to_left,
  output reg         to_right,
  output reg         left_before_right
);

  // The left child: near and far planes by the direction's sign, then near and far clipped.
  wire [23:0] left_near_plane = left_sign ? left_hi : left_lo;
  reg  [23:0] left_near_plane_s1;
  wire [23:0] left_far_plane = left_sign ? left_lo : left_hi;
  reg  [23:0] left_far_plane_s1;
  reg  [23:0] left_origin_s1;
  reg  [143:0] left_reciprocal_delay;
  wire [23:0] left_reciprocal_s6 = left_reciprocal_delay[143:120];

  wire [23:0] left_near_distance_distance;
  dynrt_near_distance left_near_distance (
    .clk(clk),
    .plane(left_near_plane_s1),
    .origin(left_origin_s1),
    .reciprocal(left_reciprocal_s6),
    .distance(left_near_distance_distance)
  );

  wire [23:0] left_far_distance_distance;
  dynrt_far_distance left_far_distance (
    .clk(clk),
    .plane(left_far_plane_s1),
    .origin(left_origin_s1),
    .reciprocal(left_reciprocal_s6),
    .distance(left_far_distance_distance)
  );

  reg  [22:0] ray_near_magnitude_s10;
  wire left_near_distance_distance_is_nan =
      (&left_near_distance_distance[22:16]) &
      (|left_near_distance_distance[15:0]);
  wire left_near_clipped_is_greater =
      (ray_near_magnitude_s10 < left_near_distance_distance[22:0]) &
      ~left_near_distance_distance[23] &
      ~left_near_distance_distance_is_nan;
  reg  [23:0] ray_near_s10;
  wire [23:0] left_near_clipped =
      left_near_clipped_is_greater ? left_near_distance_distance :
      ray_near_s10;
  reg  [22:0] ray_far_magnitude_s10;
  reg  ray_far_sign_s10;
  wire left_far_clipped_is_less_by_sign =
      (left_far_distance_distance[22:0] < ray_far_magnitude_s10) ^
      left_far_distance_distance[23];
  wire left_far_clipped_is_less =
      (left_far_distance_distance[23] ^ ray_far_sign_s10) ? left_far_distance_distance[23] :
      left_far_clipped_is_less_by_sign;
  reg  [23:0] ray_far_s10;
  wire [23:0] left_far_clipped = left_far_clipped_is_less ? left_far_distance_distance : ray_far_s10;
  reg  [23:0] left_near_clipped_s11;
  reg  [23:0] left_far_clipped_s11;

  // The right child: near and far planes by the direction's sign, then near and far clipped.
  wire [23:0] right_near_plane = right_sign ? right_hi : right_lo;
  reg  [23:0] right_near_plane_s1;
  wire [23:0] right_far_plane = right_sign ? right_lo : right_hi;
  reg  [23:0] right_far_plane_s1;
  reg  [23:0] right_origin_s1;
  reg  [143:0] right_reciprocal_delay;
  wire [23:0] right_reciprocal_s6 = right_reciprocal_delay[143:120];

  wire [23:0] right_near_distance_distance;
  dynrt_near_distance right_near_distance (
    .clk(clk),
    .plane(right_near_plane_s1),
    .origin(right_origin_s1),
    .reciprocal(right_reciprocal_s6),
    .distance(right_near_distance_distance)
  );

  wire [23:0] right_far_distance_distance;
  dynrt_far_distance right_far_distance (
    .clk(clk),
    .plane(right_far_plane_s1),
    .origin(right_origin_s1),
    .reciprocal(right_reciprocal_s6),
    .distance(right_far_distance_distance)
  );

  wire right_near_distance_distance_is_nan =
      (&right_near_distance_distance[22:16]) &
      (|right_near_distance_distance[15:0]);
  wire right_near_clipped_is_greater =
      (ray_near_magnitude_s10 < right_near_distance_distance[22:0]) &
      ~right_near_distance_distance[23] &
      ~right_near_distance_distance_is_nan;
  wire [23:0] right_near_clipped =
      right_near_clipped_is_greater ? right_near_distance_distance :
      ray_near_s10;
  wire right_far_clipped_is_less_by_sign =
      (right_far_distance_distance[22:0] < ray_far_magnitude_s10) ^
      right_far_distance_distance[23];
  wire right_far_clipped_is_less =
      (right_far_distance_distance[23] ^ ray_far_sign_s10) ? right_far_distance_distance[23] :
      right_far_clipped_is_less_by_sign;
  wire [23:0] right_far_clipped =
      right_far_clipped_is_less ? right_far_distance_distance :
      ray_far_s10;
  reg  [23:0] right_near_clipped_s11;
  reg  [23:0] right_far_clipped_s11;

  // Where the ray goes.
  reg  ray_active_s10, ray_active_s11;
  wire goes_left =
      ray_active_s11 &
      ~((left_far_clipped_s11[22:0] < left_near_clipped_s11[22:0]) | left_far_clipped_s11[23]);
  wire goes_right =
      ray_active_s11 &
      ~((right_far_clipped_s11[22:0] < right_near_clipped_s11[22:0]) | right_far_clipped_s11[23]);
  wire both_left_first =
      goes_left &
      goes_right &
      (left_near_clipped_s11[22:0] <= right_near_clipped_s11[22:0]);

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    left_near_plane_s1 <= left_near_plane;
    left_far_plane_s1 <= left_far_plane;
    left_origin_s1 <= left_origin;
    right_near_plane_s1 <= right_near_plane;
    right_far_plane_s1 <= right_far_plane;
    right_origin_s1 <= right_origin;

    // Stage 10
    ray_near_magnitude_s10 <= ray_near[22:0];
    ray_near_s10 <= ray_near;
    ray_far_magnitude_s10 <= ray_far[22:0];
    ray_far_sign_s10 <= ray_far[23];
    ray_far_s10 <= ray_far;
    ray_active_s10 <= ray_active;

    // Stage 11
    left_near_clipped_s11 <= left_near_clipped;
    left_far_clipped_s11 <= left_far_clipped;
    right_near_clipped_s11 <= right_near_clipped;
    right_far_clipped_s11 <= right_far_clipped;
    ray_active_s11 <= ray_active_s10;

    // Stage 12
    out_left_near <= left_near_clipped_s11;
    out_left_far <= left_far_clipped_s11;
    out_right_near <= right_near_clipped_s11;
    out_right_far <= right_far_clipped_s11;
    to_left <= goes_left;
    to_right <= goes_right;
    left_before_right <= both_left_first;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    left_reciprocal_delay <= {left_reciprocal_delay[119:0], left_reciprocal};
    right_reciprocal_delay <= {right_reciprocal_delay[119:0], right_reciprocal};
  end

endmodule

`default_nettype wire
