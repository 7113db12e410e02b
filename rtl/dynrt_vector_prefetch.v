// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_vector_prefetch: requests up to 16 words ahead through a tagged read port and gives them out in
// order.

`default_nettype none

module dynrt_vector_prefetch (
  input  wire        clk,
  input  wire        rst,

  // Addresses to read, taken where fetch_ready is high
  input  wire        fetch_valid,
  input  wire [21:0] fetch_address,

  // Memory: requests
  input  wire        request_ready,

  // Memory: answers, of any latency, in any order
  input  wire        response_valid,
  input  wire [3:0]  response_tag,
  input  wire [71:0] response_data,

  // The words in order; pop takes the front word, and only where valid is high
  input  wire        pop,
  output wire        fetch_ready,
  output wire        request_valid,
  output wire [21:0] request_address,
  output wire [3:0]  request_tag,
  output wire        valid,
  output wire [71:0] front,

  // Whether no word is under way or in here
  output wire        empty
);

  // A request takes a slot, whose number is its tag; the slot is free again when its word is the
  // front.
  reg  [3:0] head;
  reg  [3:0] tail;
  reg  [4:0] count;
  reg  [15:0] arrived;
  reg  front_valid;
  wire room = count != 5'd16;
  wire requested = fetch_valid & request_ready & room;
  wire head_arrived_high_high =
      head[1] ? (head[0] ? arrived[15] : arrived[14]) :
      head[0] ? arrived[13] :
      arrived[12];
  wire head_arrived_high =
      head[2] ? head_arrived_high_high :
      head[1] ? (head[0] ? arrived[11] : arrived[10]) :
      head[0] ? arrived[9] :
      arrived[8];
  wire head_arrived_low_high =
      head[1] ? (head[0] ? arrived[7] : arrived[6]) :
      head[0] ? arrived[5] :
      arrived[4];
  wire head_arrived =
      head[3] ? head_arrived_high :
      head[2] ? head_arrived_low_high :
      head[1] ? (head[0] ? arrived[3] : arrived[2]) :
      head[0] ? arrived[1] :
      arrived[0];
  wire advance = head_arrived & (~front_valid | pop);

  always @(posedge clk) begin
    if (rst) head <= 4'd0; else if (advance) head <= (head == 4'd15) ? 4'd0 : (head + 4'd1);
    if (rst) tail <= 4'd0; else if (requested) tail <= (tail == 4'd15) ? 4'd0 : (tail + 4'd1);
    if (rst) count <= 5'd0; else if (requested ^ advance) count <= requested ? (count + 5'd1) : (count - 5'd1);
  end

  wire [15:0] arrived_next =
      (arrived | ((16'd1 << response_tag) & {16{response_valid}})) &
      ~((16'd1 << head) & {16{advance}});
  (* no_rw_check, ram_style = "distributed" *)
  reg  [71:0] words [0:15];
  reg  [71:0] front_word;

  always @(posedge clk) begin
    if (rst) arrived <= 16'd0; else arrived <= arrived_next;
  end

  wire [71:0] words_read = words[head];

  always @(posedge clk) begin
    if (advance) front_word <= words_read;
    if (rst) front_valid <= 1'b0; else front_valid <= advance | (front_valid & ~pop);
  end

  // Memories.
  always @(posedge clk) begin
    if (response_valid) words[response_tag] <= response_data;
  end

  assign fetch_ready = request_ready & room;
  assign request_valid = fetch_valid & room;
  assign request_address = fetch_address;
  assign request_tag = tail;
  assign valid = front_valid;
  assign front = front_word;
  assign empty = ~((|count) | front_valid);

endmodule

`default_nettype wire
