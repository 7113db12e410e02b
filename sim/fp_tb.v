// Replays the vectors of the arithmetic units, one line per cycle.
`default_nettype none
`timescale 1ns / 1ps
`include "vectors.vh"
`include "bench.vh"

module dynrt_fp_tb;
    reg     clk, running, failed;
    integer file, line;
    always #5 clk = !clk;

    wire [3:0] done;

    wire [`DYNRT_FP_ADD_STIMULUS_BITS-1:0] add_in;
    wire [`DYNRT_NUMBER_BITS-1:0]          add_y;
    dynrt_replay #(
        .NAME("fp_add_expected.hex"), .LINES(`DYNRT_FP_ADD_STIMULUS_LINES), .LATENCY(`DYNRT_FP_ADD_LATENCY),
        .STIMULUS_BITS(`DYNRT_FP_ADD_STIMULUS_BITS), .EXPECTED_BITS(`DYNRT_FP_ADD_EXPECTED_BITS)
    ) add_replay (
        .clk(clk), .running(running), .stimulus_now(add_in), .computed(add_y), .done(done[0]), .failed()
    );
    dynrt_fp_add_sub #(.SUBTRACT(1'b0)) add (.clk(clk), .a(add_in[`DYNRT_FP_ADD_STIMULUS_A]), .b(add_in[`DYNRT_FP_ADD_STIMULUS_B]), .y(add_y));

    wire [`DYNRT_FP_SUB_STIMULUS_BITS-1:0] sub_in;
    wire [`DYNRT_NUMBER_BITS-1:0]          sub_y;
    dynrt_replay #(
        .NAME("fp_sub_expected.hex"), .LINES(`DYNRT_FP_SUB_STIMULUS_LINES), .LATENCY(`DYNRT_FP_SUB_LATENCY),
        .STIMULUS_BITS(`DYNRT_FP_SUB_STIMULUS_BITS), .EXPECTED_BITS(`DYNRT_FP_SUB_EXPECTED_BITS)
    ) sub_replay (
        .clk(clk), .running(running), .stimulus_now(sub_in), .computed(sub_y), .done(done[1]), .failed()
    );
    dynrt_fp_add_sub #(.SUBTRACT(1'b1)) sub (.clk(clk), .a(sub_in[`DYNRT_FP_SUB_STIMULUS_A]), .b(sub_in[`DYNRT_FP_SUB_STIMULUS_B]), .y(sub_y));

    wire [`DYNRT_FP_MUL_STIMULUS_BITS-1:0] mul_in;
    wire [`DYNRT_NUMBER_BITS-1:0]          mul_y;
    dynrt_replay #(
        .NAME("fp_mul_expected.hex"), .LINES(`DYNRT_FP_MUL_STIMULUS_LINES), .LATENCY(`DYNRT_FP_MUL_LATENCY),
        .STIMULUS_BITS(`DYNRT_FP_MUL_STIMULUS_BITS), .EXPECTED_BITS(`DYNRT_FP_MUL_EXPECTED_BITS)
    ) mul_replay (
        .clk(clk), .running(running), .stimulus_now(mul_in), .computed(mul_y), .done(done[2]), .failed()
    );
    dynrt_fp_mul mul (.clk(clk), .a(mul_in[`DYNRT_FP_MUL_STIMULUS_A]), .b(mul_in[`DYNRT_FP_MUL_STIMULUS_B]), .y(mul_y));

    wire [`DYNRT_FP_RECIPROCAL_STIMULUS_BITS-1:0] reciprocal_in;
    wire [`DYNRT_NUMBER_BITS-1:0]                 reciprocal_y;
    dynrt_replay #(
        .NAME("fp_reciprocal_expected.hex"), .LINES(`DYNRT_FP_RECIPROCAL_STIMULUS_LINES), .LATENCY(`DYNRT_FP_RECIPROCAL_LATENCY),
        .STIMULUS_BITS(`DYNRT_FP_RECIPROCAL_STIMULUS_BITS), .EXPECTED_BITS(`DYNRT_FP_RECIPROCAL_EXPECTED_BITS)
    ) reciprocal_replay (
        .clk(clk), .running(running), .stimulus_now(reciprocal_in), .computed(reciprocal_y), .done(done[3]), .failed()
    );
    dynrt_fp_reciprocal reciprocal (.clk(clk), .a(reciprocal_in[`DYNRT_FP_RECIPROCAL_STIMULUS_A]), .y(reciprocal_y));

    initial begin
        clk     = 1'b0;
        running = 1'b0;
        failed  = 1'b0;
        #1;
        `LOAD("fp_add_stimulus.hex", add_replay.stimulus, `DYNRT_FP_ADD_STIMULUS_LINES)
        `LOAD("fp_add_expected.hex", add_replay.expected, `DYNRT_FP_ADD_EXPECTED_LINES)
        `LOAD("fp_sub_stimulus.hex", sub_replay.stimulus, `DYNRT_FP_SUB_STIMULUS_LINES)
        `LOAD("fp_sub_expected.hex", sub_replay.expected, `DYNRT_FP_SUB_EXPECTED_LINES)
        `LOAD("fp_mul_stimulus.hex", mul_replay.stimulus, `DYNRT_FP_MUL_STIMULUS_LINES)
        `LOAD("fp_mul_expected.hex", mul_replay.expected, `DYNRT_FP_MUL_EXPECTED_LINES)
        `LOAD("fp_reciprocal_stimulus.hex", reciprocal_replay.stimulus, `DYNRT_FP_RECIPROCAL_STIMULUS_LINES)
        `LOAD("fp_reciprocal_expected.hex", reciprocal_replay.expected, `DYNRT_FP_RECIPROCAL_EXPECTED_LINES)
        running = !failed;
    end

    always @(posedge clk)
        if (&done) begin
            $display("PASS %0d additions, %0d subtractions, %0d multiplications, %0d reciprocals checked",
                `DYNRT_FP_ADD_EXPECTED_LINES, `DYNRT_FP_SUB_EXPECTED_LINES, `DYNRT_FP_MUL_EXPECTED_LINES, `DYNRT_FP_RECIPROCAL_EXPECTED_LINES);
            $finish;
        end
endmodule

`default_nettype wire
