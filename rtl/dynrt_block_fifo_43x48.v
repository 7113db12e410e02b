// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_block_fifo_43x48: a queue of 48 words of 43 bits in block RAM, for a word every few clocks. What
// feeds it never has more than 48 words under way.

`default_nettype none

module dynrt_block_fifo_43x48 (
  input  wire        clk,
  input  wire        rst,

  // In
  input  wire        push,
  input  wire [42:0] data,

  // Out: the front word, taken by pop
  input  wire        pop,
  output wire        valid,
  output wire [42:0] front
);

  reg  [5:0] head;
  reg  [5:0] tail;
  reg  [5:0] count;
  (* no_rw_check, ram_style = "block" *)
  reg  [42:0] words [0:47];
  reg  [42:0] words_read;
  reg  [42:0] words_read_d1;

  // The word at the head is read again and again; it is there once the head has stood still for the
  // RAM's latency.
  wire stored = |count;
  wire load;
  reg  settled0;
  reg  settled1;
  reg  front_valid;

  always @(posedge clk) begin
    if (rst) settled0 <= 1'b0; else settled0 <= stored & ~load;
    if (rst) settled1 <= 1'b0; else settled1 <= settled0 & stored & ~load;
  end

  assign load = settled1 & (~front_valid | pop);
  reg  [42:0] front_word;

  always @(posedge clk) begin
    if (rst) front_valid <= 1'b0; else front_valid <= load | (front_valid & ~pop);
    if (load) front_word <= words_read_d1;
    if (rst) head <= 6'd0; else if (load) head <= (head == 6'd47) ? 6'd0 : (head + 6'd1);
    if (rst) tail <= 6'd0; else if (push) tail <= (tail == 6'd47) ? 6'd0 : (tail + 6'd1);
    if (rst) count <= 6'd0; else if (push ^ load) count <= push ? (count + 6'd1) : (count - 6'd1);
  end

  // Memories.
  always @(posedge clk) begin
    if (push) words[tail] <= data;
    words_read <= words[head];
  end

  // Pipeline registers.
  always @(posedge clk) begin
    words_read_d1 <= words_read;
  end

  assign valid = front_valid;
  assign front = front_word;

endmodule

`default_nettype wire
