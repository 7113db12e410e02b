// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_fifo_17x48: a queue of 48 words of 17 bits. What feeds it never has more than 48 words under way.

`default_nettype none

module dynrt_fifo_17x48 (
  input  wire        clk,
  input  wire        rst,

  // In
  input  wire        push,
  input  wire [16:0] data,

  // Out: the front word, taken by pop
  input  wire        pop,
  output wire        valid,
  output wire [16:0] front
);

  reg  [5:0] head;
  reg  [5:0] tail;
  reg  [5:0] count;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [16:0] words [0:47];

  always @(posedge clk) begin
    if (rst) head <= 6'd0; else if (pop) head <= (head == 6'd47) ? 6'd0 : (head + 6'd1);
    if (rst) tail <= 6'd0; else if (push) tail <= (tail == 6'd47) ? 6'd0 : (tail + 6'd1);
    if (rst) count <= 6'd0; else if (push ^ pop) count <= push ? (count + 6'd1) : (count - 6'd1);
  end

  assign front = words[head];

  // Memories.
  always @(posedge clk) begin
    if (push) words[tail] <= data;
  end

  assign valid = |count;

endmodule

`default_nettype wire
