// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_fifo_96x8: a queue of 8 words of 96 bits. What feeds it never has more than 8 words under way.

`default_nettype none

module dynrt_fifo_96x8 (
  input  wire        clk,
  input  wire        rst,

  // In
  input  wire        push,
  input  wire [95:0] data,

  // Out: the front word, taken by pop
  input  wire        pop,
  output wire        valid,
  output wire [95:0] front
);

  reg  [2:0] head;
  reg  [2:0] tail;
  reg  [3:0] count;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [95:0] words [0:7];

  always @(posedge clk) begin
    if (rst) head <= 3'd0; else if (pop) head <= (head == 3'd7) ? 3'd0 : (head + 3'd1);
    if (rst) tail <= 3'd0; else if (push) tail <= (tail == 3'd7) ? 3'd0 : (tail + 3'd1);
    if (rst) count <= 4'd0; else if (push ^ pop) count <= push ? (count + 4'd1) : (count - 4'd1);
  end

  assign front = words[head];

  // Memories.
  always @(posedge clk) begin
    if (push) words[tail] <= data;
  end

  assign valid = |count;

endmodule

`default_nettype wire
