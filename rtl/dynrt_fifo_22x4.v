// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_fifo_22x4: a queue of 4 words of 22 bits. What feeds it never has more than 4 words under way.

`default_nettype none

module dynrt_fifo_22x4 (
  input  wire        clk,
  input  wire        rst,

  // In
  input  wire        push,
  input  wire [21:0] data,

  // Out: the front word, taken by pop
  input  wire        pop,
  output wire        valid,
  output wire [21:0] front
);

  reg  [1:0] head;
  reg  [1:0] tail;
  reg  [2:0] count;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [21:0] words [0:3];

  always @(posedge clk) begin
    if (rst) head <= 2'd0; else if (pop) head <= (head == 2'd3) ? 2'd0 : (head + 2'd1);
    if (rst) tail <= 2'd0; else if (push) tail <= (tail == 2'd3) ? 2'd0 : (tail + 2'd1);
    if (rst) count <= 3'd0; else if (push ^ pop) count <= push ? (count + 3'd1) : (count - 3'd1);
  end

  assign front = words[head];

  // Memories.
  always @(posedge clk) begin
    if (push) words[tail] <= data;
  end

  assign valid = |count;

endmodule

`default_nettype wire
