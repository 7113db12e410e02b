// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_selftest: the core casts 512 rays from a ROM into a scene in ROMs (builtin:cornell) and adds up its hits.
// done says that all have returned, pass that their checksum is the golden model's; select chooses the byte of it that
// checksum_byte shows, 0 the least. rst_n starts it over.

`default_nettype none

module dynrt_selftest (
  input  wire       clk,
  input  wire       rst_n,
  input  wire [2:0] select,
  output reg        done,
  output reg        pass,
  output reg  [7:0] checksum_byte
);

  localparam [63:0] EXPECTED = 64'h315b38ac01d842fa;
  localparam [9:0] RAYS = 10'd512;

  // Reset for several cycles after configuration, and while rst_n is low.
  reg  [1:0] rst_n_synchronised;
  reg  [3:0] startup;
  reg        rst;
  initial rst_n_synchronised = 2'd0;
  initial startup = 4'd0;
  initial rst = 1'b1;
  always @(posedge clk) begin
    rst_n_synchronised <= {rst_n_synchronised[0], rst_n};
    if (!rst_n_synchronised[1]) startup <= 4'd0; else if (!(&startup)) startup <= startup + 4'd1;
    rst <= !(&startup);
  end

  // A ray is read, then offered until the core accepts it.
  reg  [9:0] ray_index;
  reg  ray_read;
  reg  ray_valid;
  wire ray_ready;
  wire [193:0] ray;
  wire [15:0] ray_tag = {8'd0, ray_index[9:2]};
  always @(posedge clk) begin
    if (rst) begin
      ray_index <= 10'd0;
      ray_read <= 1'b0;
      ray_valid <= 1'b0;
    end else if (ray_valid) begin
      if (ray_ready) begin
        ray_index <= ray_index + 10'd1;
        ray_read <= 1'b0;
        ray_valid <= 1'b0;
      end
    end else begin
      ray_read <= 1'b1;
      ray_valid <= ray_read & (ray_index != RAYS);
    end
  end
  dynrt_selftest_ray_rom ray_rom (.clk(clk), .address(ray_index[8:0]), .word(ray));

  // The node memory responds two cycles after a request.
  wire node_request_valid;
  wire [21:0] node_request_address;
  wire [6:0] node_request_tag;
  reg  node_read;
  reg  node_response_valid;
  reg  [6:0] node_read_tag;
  reg  [6:0] node_response_tag;
  wire [127:0] node_word;
  reg  [127:0] node_response_data;
  always @(posedge clk) begin
    node_read <= node_request_valid & !rst;
    node_read_tag <= node_request_tag;
    node_response_valid <= node_read & !rst;
    node_response_tag <= node_read_tag;
    node_response_data <= node_word;
  end
  dynrt_selftest_node_rom node_rom (.clk(clk), .address(node_request_address[5:0]), .word(node_word));

  // The record memory responds two cycles after a request.
  wire record_request_valid;
  wire [21:0] record_request_address;
  wire [6:0] record_request_tag;
  reg  record_read;
  reg  record_response_valid;
  reg  [6:0] record_read_tag;
  reg  [6:0] record_response_tag;
  wire [127:0] record_word;
  reg  [127:0] record_response_data;
  always @(posedge clk) begin
    record_read <= record_request_valid & !rst;
    record_read_tag <= record_request_tag;
    record_response_valid <= record_read & !rst;
    record_response_tag <= record_read_tag;
    record_response_data <= record_word;
  end
  dynrt_selftest_record_rom record_rom (.clk(clk), .address(record_request_address[5:0]), .word(record_word));

  // The vertex memory responds two cycles after a request.
  wire vertex_request_valid;
  wire [21:0] vertex_request_address;
  wire [8:0] vertex_request_tag;
  reg  vertex_read;
  reg  vertex_response_valid;
  reg  [8:0] vertex_read_tag;
  reg  [8:0] vertex_response_tag;
  wire [71:0] vertex_word;
  reg  [71:0] vertex_response_data;
  always @(posedge clk) begin
    vertex_read <= vertex_request_valid & !rst;
    vertex_read_tag <= vertex_request_tag;
    vertex_response_valid <= vertex_read & !rst;
    vertex_response_tag <= vertex_read_tag;
    vertex_response_data <= vertex_word;
  end
  dynrt_selftest_vertex_rom vertex_rom (.clk(clk), .address(vertex_request_address[4:0]), .word(vertex_word));

  // The hash of a hit, and the sum of all hashes: packets return in any order, the rays of a packet in order.
  wire hit_valid;
  wire [15:0] hit_tag;
  wire [23:0] hit_t;
  wire [23:0] hit_u;
  wire [23:0] hit_v;
  wire [31:0] hit_instance;
  wire [31:0] hit_triangle;
  reg  [1:0] slot;
  wire [63:0] hash_0 = {40'd0, hit_t};
  wire [63:0] hash_1 = {hash_0[56:0], hash_0[63:57]} ^ {40'd0, hit_u};
  wire [63:0] hash_2 = {hash_1[56:0], hash_1[63:57]} ^ {40'd0, hit_v};
  wire [63:0] hash_3 = {hash_2[56:0], hash_2[63:57]} ^ {32'd0, hit_instance};
  wire [63:0] hash_4 = {hash_3[56:0], hash_3[63:57]} ^ {32'd0, hit_triangle};
  wire [63:0] hash_5 = {hash_4[56:0], hash_4[63:57]} ^ {48'd0, hit_tag};
  wire [63:0] hash_6 = {hash_5[56:0], hash_5[63:57]} ^ {62'd0, slot};
  reg  hashed;
  reg  [63:0] hash;
  reg  [63:0] checksum;
  reg  [9:0] hits;
  always @(posedge clk) begin
    hash <= hash_6;
    hashed <= hit_valid & !rst;
    if (rst) begin
      slot <= 2'd0;
      checksum <= 64'd0;
      hits <= 10'd0;
      done <= 1'b0;
      pass <= 1'b0;
    end else begin
      if (hit_valid) slot <= (slot == 2'd3) ? 2'd0 : (slot + 2'd1);
      if (hashed) begin
        checksum <= checksum + hash;
        hits <= hits + 10'd1;
      end
      done <= hits == RAYS;
      pass <= (hits == RAYS) & (checksum == EXPECTED);
    end
    case (select)
      3'd0: checksum_byte <= checksum[7:0];
      3'd1: checksum_byte <= checksum[15:8];
      3'd2: checksum_byte <= checksum[23:16];
      3'd3: checksum_byte <= checksum[31:24];
      3'd4: checksum_byte <= checksum[39:32];
      3'd5: checksum_byte <= checksum[47:40];
      3'd6: checksum_byte <= checksum[55:48];
      3'd7: checksum_byte <= checksum[63:56];
    endcase
  end

  wire [1107:0] unread;
  dynrt_core core (
    .clk(clk),
    .rst(rst),
    .scene_root(32'h00000024),
    .scene_lo_x(24'h0),
    .scene_lo_y(24'h0),
    .scene_lo_z(24'h0),
    .scene_hi_x(24'h461600),
    .scene_hi_y(24'h461266),
    .scene_hi_z(24'h46179a),
    .ray_valid(ray_valid),
    .ray_tag(ray_tag),
    .ray_origin_x(ray[23:0]),
    .ray_origin_y(ray[47:24]),
    .ray_origin_z(ray[71:48]),
    .ray_direction_x(ray[95:72]),
    .ray_direction_y(ray[119:96]),
    .ray_direction_z(ray[143:120]),
    .ray_tmin(ray[167:144]),
    .ray_tmax(ray[191:168]),
    .ray_active(ray[192]),
    .ray_any_hit(ray[193]),
    .ray_ready(ray_ready),
    .hit_ready(1'b1),
    .hit_valid(hit_valid),
    .hit_tag(hit_tag),
    .hit_t(hit_t),
    .hit_u(hit_u),
    .hit_v(hit_v),
    .hit_instance(hit_instance),
    .hit_triangle(hit_triangle),
    .node_request_ready(1'b1),
    .node_request_valid(node_request_valid),
    .node_request_address(node_request_address),
    .node_request_tag(node_request_tag),
    .node_response_valid(node_response_valid),
    .node_response_tag(node_response_tag),
    .node_response_data(node_response_data),
    .record_request_ready(1'b1),
    .record_request_valid(record_request_valid),
    .record_request_address(record_request_address),
    .record_request_tag(record_request_tag),
    .record_response_valid(record_response_valid),
    .record_response_tag(record_response_tag),
    .record_response_data(record_response_data),
    .vertex_request_ready(1'b1),
    .vertex_request_valid(vertex_request_valid),
    .vertex_request_address(vertex_request_address),
    .vertex_request_tag(vertex_request_tag),
    .vertex_response_valid(vertex_response_valid),
    .vertex_response_tag(vertex_response_tag),
    .vertex_response_data(vertex_response_data),
    .influence_request_ready(1'd0),
    .influence_request_valid(unread[0:0]),
    .influence_request_address(unread[22:1]),
    .influence_request_tag(unread[25:23]),
    .influence_response_valid(1'd0),
    .influence_response_tag(3'd0),
    .influence_response_data(128'd0),
    .skin_start_valid(1'd0),
    .skin_start_palette(22'd0),
    .skin_start_joints(9'd0),
    .skin_start_influences(22'd0),
    .skin_start_rows(22'd0),
    .skin_start_rest(22'd0),
    .skin_start_vertices(22'd0),
    .skin_start_target(22'd0),
    .skin_start_ready(unread[26:26]),
    .skin_write_ready(1'd0),
    .skin_write_valid(unread[27:27]),
    .skin_write_address(unread[49:28]),
    .skin_write_data(unread[121:50]),
    .skin_done(unread[122:122]),
    .count_cycles(unread[162:123]),
    .count_packet_steps(unread[202:163]),
    .count_ray_triangle_tests(unread[242:203]),
    .count_tpu_busy_cycles(unread[282:243]),
    .count_tpu_starved_cycles(unread[322:283]),
    .count_ray_transforms(unread[362:323]),
    .count_gu_busy_cycles(unread[402:363]),
    .count_gu_starved_cycles(unread[442:403]),
    .count_skin_influences(unread[482:443]),
    .count_skin_cycles(unread[522:483]),
    .stack_high_water(unread[528:523]),
    .stack_overflow(unread[529:529]),
    .update_start_valid(1'd0),
    .update_start_program(22'd0),
    .update_start_rows(22'd0),
    .update_start_vertex_base(22'd0),
    .update_start_node_base(22'd0),
    .update_start_box_index(22'd0),
    .update_start_ready(unread[530:530]),
    .update_program_request_ready(1'd0),
    .update_program_request_valid(unread[531:531]),
    .update_program_request_address(unread[553:532]),
    .update_program_request_tag(unread[556:554]),
    .update_program_response_valid(1'd0),
    .update_program_response_tag(3'd0),
    .update_program_response_data(128'd0),
    .update_vertex_request_ready(1'd0),
    .update_vertex_request_valid(unread[557:557]),
    .update_vertex_request_address(unread[579:558]),
    .update_vertex_request_tag(unread[583:580]),
    .update_vertex_response_valid(1'd0),
    .update_vertex_response_tag(4'd0),
    .update_vertex_response_data(72'd0),
    .update_node_write_ready(1'd0),
    .update_node_write_valid(unread[584:584]),
    .update_node_write_address(unread[606:585]),
    .update_node_write_mask(unread[611:607]),
    .update_node_write_data(unread[739:612]),
    .update_box_write_ready(1'd0),
    .update_box_write_valid(unread[740:740]),
    .update_box_write_address(unread[762:741]),
    .update_box_write_data(unread[906:763]),
    .update_done(unread[907:907]),
    .update_count_instructions(unread[947:908]),
    .update_count_busy_cycles(unread[987:948]),
    .update_count_stalled_cycles(unread[1027:988]),
    .update_count_vertex_wait_cycles(unread[1067:1028]),
    .update_count_node_wait_cycles(unread[1107:1068])
  );

  // Unused bits.
  wire unused = &{1'b0, node_request_address[21:6], record_request_address[21:6], vertex_request_address[21:5], unread};

endmodule

`default_nettype wire
