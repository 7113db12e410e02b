// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_ray_setup: what traversal and intersection need to know of a ray, and its interval in the scene's
// box.
// Latency: 15 to 20 clocks, one set of inputs a clock.

`default_nettype none

module dynrt_ray_setup (
  input  wire        clk,
  input  wire        rst,

  // A ray's packet and place in it, and whether it is the first and the last of the packet's rays that come
  input  wire        valid,
  input  wire [5:0]  packet,
  input  wire [1:0]  ray,
  input  wire        first,
  input  wire        last,

  // Whether it is in an object's space: the scene's box does not clip it
  input  wire        object,

  // The ray
  input  wire        active,
  input  wire        any_hit,
  input  wire [23:0] origin_x,
  input  wire [23:0] origin_y,
  input  wire [23:0] origin_z,
  input  wire [23:0] direction_x,
  input  wire [23:0] direction_y,
  input  wire [23:0] direction_z,
  input  wire [23:0] tmin,
  input  wire [23:0] tmax,

  // The scene's box, constant while rays are under way
  input  wire [23:0] scene_lo_x,
  input  wire [23:0] scene_lo_y,
  input  wire [23:0] scene_lo_z,
  input  wire [23:0] scene_hi_x,
  input  wire [23:0] scene_hi_y,
  input  wire [23:0] scene_hi_z,

  // The ray, set up
  output wire        out_valid,
  output wire [5:0]  out_packet,
  output wire [1:0]  out_ray,
  output wire        out_first,
  output wire        out_last,
  output wire        out_object,
  output reg         out_enters,
  output reg  [23:0] out_near,
  output reg  [23:0] out_far,
  output wire [2:0]  out_signs,
  output wire [23:0] out_tmin,
  output wire [23:0] out_tmax,
  output wire        out_any_hit,
  output wire [23:0] out_origin_x,
  output wire [23:0] out_reciprocal_x,
  output wire [23:0] out_origin_y,
  output wire [23:0] out_reciprocal_y,
  output wire [23:0] out_origin_z,
  output wire [23:0] out_reciprocal_z,
  output wire [1:0]  out_kz,
  output wire [23:0] out_shear_x,
  output wire [23:0] out_shear_y,
  output wire [23:0] out_shear_z,

  // The packet of the ray that comes out 2 clocks later
  output wire [5:0]  next_packet,

  // Says 5 clocks ahead that a ray is coming out
  output wire        soon
);

  // A ray is valid if it is active, nothing in it is a NaN, and 0 <= tmin <= tmax.
  wire [23:0] tmin_clean = (~|tmin[22:16]) ? 24'd0 : tmin;
  wire [23:0] tmax_clean = (~|tmax[22:16]) ? 24'd0 : tmax;
  wire any_nan =
      ((&origin_x[22:16]) & (|origin_x[15:0])) |
      ((&origin_y[22:16]) & (|origin_y[15:0])) |
      ((&origin_z[22:16]) & (|origin_z[15:0])) |
      ((&direction_x[22:16]) & (|direction_x[15:0])) |
      ((&direction_y[22:16]) & (|direction_y[15:0])) |
      ((&direction_z[22:16]) & (|direction_z[15:0])) |
      ((&tmax_clean[22:16]) & (|tmax_clean[15:0]));
  reg  any_nan_s1;
  wire tmin_not_behind_tmax_not_by_sign =
      ({tmax_clean[22:0], 1'b0} < {tmin_clean[22:0], tmin_clean[23]}) ^
      tmax_clean[23];
  wire tmin_not_behind_tmax = ~((tmax_clean[23] ^ tmin_clean[23]) ? tmax_clean[23] : tmin_not_behind_tmax_not_by_sign);
  wire ordered = ~tmin_clean[23] & tmin_not_behind_tmax;
  reg  ordered_s1;
  reg  active_s1;
  wire sound = active_s1 & ~any_nan_s1 & ordered_s1;

  // Reciprocals of the direction, and its sign bits.
  wire [23:0] reciprocal_x_y;
  dynrt_fp_reciprocal reciprocal_x (
    .clk(clk),
    .a(direction_x),
    .y(reciprocal_x_y)
  );

  wire [23:0] reciprocal_y_y;
  dynrt_fp_reciprocal reciprocal_y (
    .clk(clk),
    .a(direction_y),
    .y(reciprocal_y_y)
  );

  wire [23:0] reciprocal_z_y;
  dynrt_fp_reciprocal reciprocal_z (
    .clk(clk),
    .a(direction_z),
    .y(reciprocal_z_y)
  );

  // near and far, clipped by the scene's box; in an object's space by (-infinity, +infinity), which
  // never clips.
  wire [23:0] clip_lo_x = object ? 24'hff0000 : scene_lo_x;
  wire [23:0] clip_hi_x = object ? 24'h7f0000 : scene_hi_x;
  reg  [167:0] near_x_plane_delay;
  wire [23:0] near_x_plane_s7 = near_x_plane_delay[167:144];
  reg  [479:0] origin_x_delay;
  wire [23:0] origin_x_s7 = origin_x_delay[167:144];

  wire [23:0] near_x_distance;
  dynrt_near_distance near_x (
    .clk(clk),
    .plane(near_x_plane_s7),
    .origin(origin_x_s7),
    .reciprocal(reciprocal_x_y),
    .distance(near_x_distance)
  );

  reg  [167:0] far_x_plane_delay;
  wire [23:0] far_x_plane_s7 = far_x_plane_delay[167:144];

  wire [23:0] far_x_distance;
  dynrt_far_distance far_x (
    .clk(clk),
    .plane(far_x_plane_s7),
    .origin(origin_x_s7),
    .reciprocal(reciprocal_x_y),
    .distance(far_x_distance)
  );

  reg  [367:0] tmin_clean_magnitude_delay;
  wire [22:0] tmin_clean_magnitude_s16 = tmin_clean_magnitude_delay[367:345];
  wire near_after_x_is_greater =
      (tmin_clean_magnitude_s16 < near_x_distance[22:0]) &
      ~near_x_distance[23] &
      ~((&near_x_distance[22:16]) & (|near_x_distance[15:0]));
  reg  [479:0] out_tmin_delay;
  wire [23:0] out_tmin_s16 = out_tmin_delay[383:360];
  wire [23:0] near_after_x = near_after_x_is_greater ? near_x_distance : out_tmin_s16;
  reg  [23:0] near_after_x_s17;
  reg  [367:0] tmax_clean_magnitude_delay;
  wire [22:0] tmax_clean_magnitude_s16 = tmax_clean_magnitude_delay[367:345];
  wire far_after_x_is_less =
      far_x_distance[23] ? far_x_distance[23] :
      ((far_x_distance[22:0] < tmax_clean_magnitude_s16) ^ far_x_distance[23]);
  reg  [479:0] out_tmax_delay;
  wire [23:0] out_tmax_s16 = out_tmax_delay[383:360];
  wire [23:0] far_after_x = far_after_x_is_less ? far_x_distance : out_tmax_s16;
  reg  [23:0] far_after_x_s17;
  wire [23:0] clip_lo_y = object ? 24'hff0000 : scene_lo_y;
  wire [23:0] clip_hi_y = object ? 24'h7f0000 : scene_hi_y;
  reg  [167:0] near_y_plane_delay;
  wire [23:0] near_y_plane_s7 = near_y_plane_delay[167:144];
  reg  [479:0] origin_y_delay;
  wire [23:0] origin_y_s7 = origin_y_delay[167:144];

  wire [23:0] near_y_distance;
  dynrt_near_distance near_y (
    .clk(clk),
    .plane(near_y_plane_s7),
    .origin(origin_y_s7),
    .reciprocal(reciprocal_y_y),
    .distance(near_y_distance)
  );

  reg  [167:0] far_y_plane_delay;
  wire [23:0] far_y_plane_s7 = far_y_plane_delay[167:144];

  wire [23:0] far_y_distance;
  dynrt_far_distance far_y (
    .clk(clk),
    .plane(far_y_plane_s7),
    .origin(origin_y_s7),
    .reciprocal(reciprocal_y_y),
    .distance(far_y_distance)
  );

  reg  [22:0] near_y_distance_magnitude_s17;
  reg  near_y_distance_is_positive_s17;
  reg  near_after_y_is_greater_ordered_s17;
  wire near_after_y_is_greater =
      (near_after_x_s17[22:0] < near_y_distance_magnitude_s17) &
      near_y_distance_is_positive_s17 &
      near_after_y_is_greater_ordered_s17;
  reg  [23:0] near_y_distance_s17;
  wire [23:0] near_after_y = near_after_y_is_greater ? near_y_distance_s17 : near_after_x_s17;
  reg  [23:0] near_after_y_s18;
  reg  [22:0] far_y_distance_magnitude_s17;
  reg  far_y_distance_sign_s17;
  wire far_after_y_is_less =
      (far_y_distance_sign_s17 ^ far_after_x_s17[23]) ? far_y_distance_sign_s17 :
      ((far_y_distance_magnitude_s17 < far_after_x_s17[22:0]) ^ far_y_distance_sign_s17);
  reg  [23:0] far_y_distance_s17;
  wire [23:0] far_after_y = far_after_y_is_less ? far_y_distance_s17 : far_after_x_s17;
  reg  [23:0] far_after_y_s18;
  wire [23:0] clip_lo_z = object ? 24'hff0000 : scene_lo_z;
  wire [23:0] clip_hi_z = object ? 24'h7f0000 : scene_hi_z;
  reg  [167:0] near_z_plane_delay;
  wire [23:0] near_z_plane_s7 = near_z_plane_delay[167:144];
  reg  [479:0] origin_z_delay;
  wire [23:0] origin_z_s7 = origin_z_delay[167:144];

  wire [23:0] near_z_distance;
  dynrt_near_distance near_z (
    .clk(clk),
    .plane(near_z_plane_s7),
    .origin(origin_z_s7),
    .reciprocal(reciprocal_z_y),
    .distance(near_z_distance)
  );

  reg  [167:0] far_z_plane_delay;
  wire [23:0] far_z_plane_s7 = far_z_plane_delay[167:144];

  wire [23:0] far_z_distance;
  dynrt_far_distance far_z (
    .clk(clk),
    .plane(far_z_plane_s7),
    .origin(origin_z_s7),
    .reciprocal(reciprocal_z_y),
    .distance(far_z_distance)
  );

  reg  [22:0] near_z_distance_magnitude_s17, near_z_distance_magnitude_s18;
  reg  near_z_distance_is_positive_s17, near_z_distance_is_positive_s18;
  reg  near_after_z_is_greater_ordered_s17, near_after_z_is_greater_ordered_s18;
  wire near_after_z_is_greater =
      (near_after_y_s18[22:0] < near_z_distance_magnitude_s18) &
      near_z_distance_is_positive_s18 &
      near_after_z_is_greater_ordered_s18;
  reg  [23:0] near_z_distance_s17, near_z_distance_s18;
  wire [23:0] near_after_z = near_after_z_is_greater ? near_z_distance_s18 : near_after_y_s18;
  reg  [23:0] near_after_z_s19;
  reg  [22:0] far_z_distance_magnitude_s17, far_z_distance_magnitude_s18;
  reg  far_z_distance_sign_s17, far_z_distance_sign_s18;
  wire far_after_z_is_less =
      (far_z_distance_sign_s18 ^ far_after_y_s18[23]) ? far_z_distance_sign_s18 :
      ((far_z_distance_magnitude_s18 < far_after_y_s18[22:0]) ^ far_z_distance_sign_s18);
  reg  [23:0] far_z_distance_s17, far_z_distance_s18;
  wire [23:0] far_after_z = far_after_z_is_less ? far_z_distance_s18 : far_after_y_s18;
  reg  [23:0] far_after_z_s19;
  reg  [17:0] sound_delay;
  wire sound_s19 = sound_delay[17];
  wire enters = sound_s19 & ~((far_after_z_s19[22:0] < near_after_z_s19[22:0]) | far_after_z_s19[23]);

  // The shear that the watertight test turns the ray into the z axis with.
  wire [22:0] size_x = (~|direction_x[22:16]) ? 23'd0 : direction_x[22:0];
  wire [22:0] size_y = (~|direction_y[22:16]) ? 23'd0 : direction_y[22:0];
  wire [22:0] size_z = (~|direction_z[22:16]) ? 23'd0 : direction_z[22:0];
  wire y_beats_x = size_x < size_y;
  reg  y_beats_x_s1;
  reg  [22:0] size_y_s1;
  reg  [22:0] size_x_s1;
  reg  [22:0] size_z_s1;
  wire z_wins = (y_beats_x_s1 ? size_y_s1 : size_x_s1) < size_z_s1;
  reg  [10:0] z_wins_delay;
  wire z_wins_s2 = z_wins_delay[0];
  reg  y_beats_x_s2;
  wire y_wins = y_beats_x_s2 & ~z_wins_s2;
  wire [1:0] kz = {z_wins_s2, y_wins};
  reg  [23:0] direction_z_s1, direction_z_s2;
  reg  [23:0] direction_y_s1, direction_y_s2;
  reg  [23:0] direction_x_s1, direction_x_s2;
  wire [23:0] direction_kx =
      z_wins_s2 ? direction_x_s2 :
      y_wins ? direction_z_s2 :
      direction_y_s2;
  reg  [263:0] direction_kx_delay;
  wire [23:0] direction_ky =
      z_wins_s2 ? direction_y_s2 :
      y_wins ? direction_x_s2 :
      direction_z_s2;
  reg  [263:0] direction_ky_delay;
  reg  [9:0] y_wins_delay;
  wire y_wins_s12 = y_wins_delay[9];
  wire z_wins_s12 = z_wins_delay[10];
  wire [23:0] reciprocal_kz =
      z_wins_s12 ? reciprocal_z_y :
      y_wins_s12 ? reciprocal_y_y :
      reciprocal_x_y;
  reg  [191:0] reciprocal_kz_delay;
  wire [23:0] reciprocal_kz_s13 = reciprocal_kz_delay[23:0];
  wire [23:0] direction_kx_s13 = direction_kx_delay[263:240];

  wire [23:0] shear_x_y;
  dynrt_fp_mul shear_x (
    .clk(clk),
    .a(direction_kx_s13),
    .b(reciprocal_kz_s13),
    .y(shear_x_y)
  );

  wire [23:0] direction_ky_s13 = direction_ky_delay[263:240];

  wire [23:0] shear_y_y;
  dynrt_fp_mul shear_y (
    .clk(clk),
    .a(direction_ky_s13),
    .b(reciprocal_kz_s13),
    .y(shear_y_y)
  );

  reg  [19:0] valid_delay;
  assign soon = valid_delay[14];
  assign out_valid = valid_delay[19];
  reg  [119:0] packet_delay;
  assign next_packet = packet_delay[107:102];
  assign out_packet = packet_delay[119:114];
  reg  [39:0] ray_delay;
  assign out_ray = ray_delay[39:38];
  reg  [19:0] first_delay;
  assign out_first = first_delay[19];
  reg  [19:0] last_delay;
  assign out_last = last_delay[19];
  reg  [19:0] object_delay;
  assign out_object = object_delay[19];
  reg  [59:0] out_signs_delay;
  assign out_signs = out_signs_delay[59:57];
  assign out_tmin = out_tmin_delay[479:456];
  assign out_tmax = out_tmax_delay[479:456];
  reg  [19:0] any_hit_delay;
  assign out_any_hit = any_hit_delay[19];
  assign out_origin_x = origin_x_delay[479:456];
  reg  [191:0] reciprocal_x_y_delay;
  assign out_reciprocal_x = reciprocal_x_y_delay[191:168];
  assign out_origin_y = origin_y_delay[479:456];
  reg  [191:0] reciprocal_y_y_delay;
  assign out_reciprocal_y = reciprocal_y_y_delay[191:168];
  assign out_origin_z = origin_z_delay[479:456];
  reg  [191:0] reciprocal_z_y_delay;
  assign out_reciprocal_z = reciprocal_z_y_delay[191:168];
  reg  [35:0] kz_delay;
  assign out_kz = kz_delay[35:34];
  reg  [95:0] shear_x_y_delay;
  assign out_shear_x = shear_x_y_delay[95:72];
  reg  [95:0] shear_y_y_delay;
  assign out_shear_y = shear_y_y_delay[95:72];
  assign out_shear_z = reciprocal_kz_delay[191:168];

  // Pipeline registers.
  always @(posedge clk) begin
    // Stage 1
    any_nan_s1 <= any_nan;
    ordered_s1 <= ordered;
    active_s1 <= active;
    y_beats_x_s1 <= y_beats_x;
    size_y_s1 <= size_y;
    size_x_s1 <= size_x;
    size_z_s1 <= size_z;
    direction_z_s1 <= direction_z;
    direction_y_s1 <= direction_y;
    direction_x_s1 <= direction_x;

    // Stage 2
    y_beats_x_s2 <= y_beats_x_s1;
    direction_z_s2 <= direction_z_s1;
    direction_y_s2 <= direction_y_s1;
    direction_x_s2 <= direction_x_s1;

    // Stage 17
    near_after_x_s17 <= near_after_x;
    far_after_x_s17 <= far_after_x;
    near_y_distance_magnitude_s17 <= near_y_distance[22:0];
    near_y_distance_is_positive_s17 <= ~near_y_distance[23];
    near_after_y_is_greater_ordered_s17 <= ~((&near_y_distance[22:16]) & (|near_y_distance[15:0]));
    near_y_distance_s17 <= near_y_distance;
    far_y_distance_magnitude_s17 <= far_y_distance[22:0];
    far_y_distance_sign_s17 <= far_y_distance[23];
    far_y_distance_s17 <= far_y_distance;
    near_z_distance_magnitude_s17 <= near_z_distance[22:0];
    near_z_distance_is_positive_s17 <= ~near_z_distance[23];
    near_after_z_is_greater_ordered_s17 <= ~((&near_z_distance[22:16]) & (|near_z_distance[15:0]));
    near_z_distance_s17 <= near_z_distance;
    far_z_distance_magnitude_s17 <= far_z_distance[22:0];
    far_z_distance_sign_s17 <= far_z_distance[23];
    far_z_distance_s17 <= far_z_distance;

    // Stage 18
    near_after_y_s18 <= near_after_y;
    far_after_y_s18 <= far_after_y;
    near_z_distance_magnitude_s18 <= near_z_distance_magnitude_s17;
    near_z_distance_is_positive_s18 <= near_z_distance_is_positive_s17;
    near_after_z_is_greater_ordered_s18 <= near_after_z_is_greater_ordered_s17;
    near_z_distance_s18 <= near_z_distance_s17;
    far_z_distance_magnitude_s18 <= far_z_distance_magnitude_s17;
    far_z_distance_sign_s18 <= far_z_distance_sign_s17;
    far_z_distance_s18 <= far_z_distance_s17;

    // Stage 19
    near_after_z_s19 <= near_after_z;
    far_after_z_s19 <= far_after_z;

    // Stage 20
    out_enters <= enters;
    out_near <= near_after_z_s19;
    out_far <= far_after_z_s19;
  end

  // Delay lines: values that wait for others of their pipeline, the newest lowest.
  always @(posedge clk) begin
    near_x_plane_delay <= {near_x_plane_delay[143:0], direction_x[23] ? clip_hi_x : clip_lo_x};
    origin_x_delay <= {origin_x_delay[455:0], origin_x};
    far_x_plane_delay <= {far_x_plane_delay[143:0], direction_x[23] ? clip_lo_x : clip_hi_x};
    tmin_clean_magnitude_delay <= {tmin_clean_magnitude_delay[344:0], tmin_clean[22:0]};
    out_tmin_delay <= {out_tmin_delay[455:0], {1'b0, tmin_clean[22:0]}};
    tmax_clean_magnitude_delay <= {tmax_clean_magnitude_delay[344:0], tmax_clean[22:0]};
    out_tmax_delay <= {out_tmax_delay[455:0], {1'b0, tmax_clean[22:0]}};
    near_y_plane_delay <= {near_y_plane_delay[143:0], direction_y[23] ? clip_hi_y : clip_lo_y};
    origin_y_delay <= {origin_y_delay[455:0], origin_y};
    far_y_plane_delay <= {far_y_plane_delay[143:0], direction_y[23] ? clip_lo_y : clip_hi_y};
    near_z_plane_delay <= {near_z_plane_delay[143:0], direction_z[23] ? clip_hi_z : clip_lo_z};
    origin_z_delay <= {origin_z_delay[455:0], origin_z};
    far_z_plane_delay <= {far_z_plane_delay[143:0], direction_z[23] ? clip_lo_z : clip_hi_z};
    sound_delay <= {sound_delay[16:0], sound};
    z_wins_delay <= {z_wins_delay[9:0], z_wins};
    direction_kx_delay <= {direction_kx_delay[239:0], direction_kx};
    direction_ky_delay <= {direction_ky_delay[239:0], direction_ky};
    y_wins_delay <= {y_wins_delay[8:0], y_wins};
    reciprocal_kz_delay <= {reciprocal_kz_delay[167:0], reciprocal_kz};
    if (rst) valid_delay <= 20'd0; else valid_delay <= {valid_delay[18:0], valid};
    packet_delay <= {packet_delay[113:0], packet};
    ray_delay <= {ray_delay[37:0], ray};
    first_delay <= {first_delay[18:0], first};
    last_delay <= {last_delay[18:0], last};
    object_delay <= {object_delay[18:0], object};
    out_signs_delay <= {out_signs_delay[56:0], {direction_z[23], direction_y[23], direction_x[23]}};
    any_hit_delay <= {any_hit_delay[18:0], any_hit};
    reciprocal_x_y_delay <= {reciprocal_x_y_delay[167:0], reciprocal_x_y};
    reciprocal_y_y_delay <= {reciprocal_y_y_delay[167:0], reciprocal_y_y};
    reciprocal_z_y_delay <= {reciprocal_z_y_delay[167:0], reciprocal_z_y};
    kz_delay <= {kz_delay[33:0], kz};
    shear_x_y_delay <= {shear_x_y_delay[71:0], shear_x_y};
    shear_y_y_delay <= {shear_y_y_delay[71:0], shear_y_y};
  end

endmodule

`default_nettype wire
