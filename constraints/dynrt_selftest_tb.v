// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_selftest_tb: runs the self-test and prints PASS or FAIL with the checksum.

`timescale 1ns / 1ps
`default_nettype none

module dynrt_selftest_tb;
  reg  clk;
  reg  [2:0] select;
  wire done, pass;
  wire [7:0] checksum_byte;
  dynrt_selftest dut (.clk(clk), .rst_n(1'b1), .select(select), .done(done), .pass(pass), .checksum_byte(checksum_byte));
  always #5 clk = !clk;

  integer quiet, cycles, number;
  reg  [9:0] hits_before;
  reg  [63:0] checksum;
  initial begin
    clk = 1'b0;
    select = 3'd0;
    quiet = 0;
    cycles = 0;
    hits_before = 0;
    while (done !== 1'b1 && quiet < 10000) begin
      @(negedge clk);
      cycles = cycles + 1;
      quiet = (dut.hits === hits_before) ? quiet + 1 : 0;
      hits_before = dut.hits;
    end
    if (done !== 1'b1) begin
      $display("FAIL no hit for 10000 clocks, %0d of 512 have returned", dut.hits);
      $finish;
    end
    for (number = 0; number < 8; number = number + 1) begin
      select = number;
      @(negedge clk);
      @(negedge clk);
      checksum[8*number +: 8] = checksum_byte;
    end
    if (pass === 1'b1) $display("PASS 512 rays in %0d clocks, checksum %h", cycles, checksum);
    else $display("FAIL checksum %h, expected %h", checksum, 64'h315b38ac01d842fa);
    $finish;
  end
endmodule

`default_nettype wire
