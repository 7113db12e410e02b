// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_program_prefetch: requests up to 8 words ahead through a tagged read port and gives them out in
// order.

`default_nettype none

module dynrt_program_prefetch (
  input  wire         clk,
  input  wire         rst,

  // Addresses to read, taken where fetch_ready is high
  input  wire         fetch_valid,
  input  wire [21:0]  fetch_address,

  // Memory: requests
  input  wire         request_ready,

  // Memory: answers, of any latency, in any order
  input  wire         response_valid,
  input  wire [2:0]   response_tag,
  input  wire [127:0] response_data,

  // The words in order; pop takes the front word, and only where valid is high
  input  wire         pop,
  output wire         fetch_ready,
  output wire         request_valid,
  output wire [21:0]  request_address,
  output wire [2:0]   request_tag,
  output wire         valid,
  output wire [127:0] front,

  // Whether no word is under way or in here
  output wire         empty
);

  // A request takes a slot, whose number is its tag; the slot is free again when its word is the
  // front.
  reg  [2:0] head;
  reg  [2:0] tail;
  reg  [3:0] count;
  reg  [7:0] arrived;
  reg  front_valid;
  wire room = count != 4'd8;
  wire requested = fetch_valid & request_ready & room;
  wire head_arrived_high =
      head[1] ? (head[0] ? arrived[7] : arrived[6]) :
      head[0] ? arrived[5] :
      arrived[4];
  wire head_arrived =
      head[2] ? head_arrived_high :
      head[1] ? (head[0] ? arrived[3] : arrived[2]) :
      head[0] ? arrived[1] :
      arrived[0];
  wire advance = head_arrived & (~front_valid | pop);

  always @(posedge clk) begin
    if (rst) head <= 3'd0; else if (advance) head <= (head == 3'd7) ? 3'd0 : (head + 3'd1);
    if (rst) tail <= 3'd0; else if (requested) tail <= (tail == 3'd7) ? 3'd0 : (tail + 3'd1);
    if (rst) count <= 4'd0; else if (requested ^ advance) count <= requested ? (count + 4'd1) : (count - 4'd1);
  end

  wire [7:0] arrived_next =
      (arrived | ((8'd1 << response_tag) & {8{response_valid}})) &
      ~((8'd1 << head) & {8{advance}});
  (* no_rw_check, ram_style = "distributed" *)
  reg  [127:0] words [0:7];
  reg  [127:0] front_word;

  always @(posedge clk) begin
    if (rst) arrived <= 8'd0; else arrived <= arrived_next;
  end

  wire [127:0] words_read = words[head];

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
