// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_fifo_28x64: a queue of 64 words of 28 bits. What feeds it never has more than 64 words under way.

`default_nettype none

module dynrt_fifo_28x64 (
  input  wire        clk,
  input  wire        rst,

  // In
  input  wire        push,
  input  wire [27:0] data,

  // Out: the front word, taken by pop
  input  wire        pop,
  output wire        valid,
  output wire [27:0] front
);

  reg  [5:0] head;
  reg  [5:0] tail;
  reg  [6:0] count;
  (* no_rw_check, ram_style = "distributed" *)
  reg  [27:0] words [0:63];

  always @(posedge clk) begin
    if (rst) head <= 6'd0; else if (pop) head <= (head == 6'd63) ? 6'd0 : (head + 6'd1);
    if (rst) tail <= 6'd0; else if (push) tail <= (tail == 6'd63) ? 6'd0 : (tail + 6'd1);
    if (rst) count <= 7'd0; else if (push ^ pop) count <= push ? (count + 7'd1) : (count - 7'd1);
  end

  assign front = words[head];

  // Memories.
  always @(posedge clk) begin
    if (push) words[tail] <= data;
  end

  assign valid = |count;

endmodule

`default_nettype wire
