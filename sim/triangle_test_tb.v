// Replays the vectors of the triangle test, one ray and one triangle per cycle.
`default_nettype none
`timescale 1ns / 1ps
`include "vectors.vh"
`include "bench.vh"

module dynrt_triangle_test_tb;
    reg     clk, running, failed;
    integer file, line;
    always #5 clk = !clk;

    wire [`DYNRT_TRIANGLE_TEST_STIMULUS_BITS-1:0] in;
    wire [`DYNRT_TRIANGLE_TEST_EXPECTED_BITS-1:0] out;
    wire done;
    dynrt_replay #(
        .NAME("triangle_test_expected.hex"), .LINES(`DYNRT_TRIANGLE_TEST_STIMULUS_LINES), .LATENCY(`DYNRT_TRIANGLE_TEST_LATENCY),
        .STIMULUS_BITS(`DYNRT_TRIANGLE_TEST_STIMULUS_BITS), .EXPECTED_BITS(`DYNRT_TRIANGLE_TEST_EXPECTED_BITS)
    ) test_replay (
        .clk(clk), .running(running), .stimulus_now(in), .computed(out), .done(done), .failed()
    );

    // Some inputs are due in later cycles than the others.
    wire [31:0] limits_line = test_replay.clock - `DYNRT_TRIANGLE_TEST_TMIN_STAGE;
    wire [`DYNRT_TRIANGLE_TEST_STIMULUS_BITS-1:0] limits = test_replay.stimulus[limits_line];
    wire [31:0] window_line = test_replay.clock - `DYNRT_TRIANGLE_TEST_WINDOW_NEAR_STAGE;
    wire [`DYNRT_TRIANGLE_TEST_STIMULUS_BITS-1:0] window = test_replay.stimulus[window_line];
`ifdef DYNRT_WATERTIGHT
    wire [31:0] scale_line = test_replay.clock - `DYNRT_TRIANGLE_TEST_SHEAR_Z_STAGE;
    wire [`DYNRT_TRIANGLE_TEST_STIMULUS_BITS-1:0] scale = test_replay.stimulus[scale_line];
`endif

    dynrt_triangle_test test (
        .clk(clk),
        .v0_x(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V0_X]),
        .v0_y(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V0_Y]),
        .v0_z(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V0_Z]),
        .v1_x(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V1_X]),
        .v1_y(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V1_Y]),
        .v1_z(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V1_Z]),
        .v2_x(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V2_X]),
        .v2_y(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V2_Y]),
        .v2_z(in[`DYNRT_TRIANGLE_TEST_STIMULUS_V2_Z]),
        .origin_x(in[`DYNRT_TRIANGLE_TEST_STIMULUS_ORIGIN_X]),
        .origin_y(in[`DYNRT_TRIANGLE_TEST_STIMULUS_ORIGIN_Y]),
        .origin_z(in[`DYNRT_TRIANGLE_TEST_STIMULUS_ORIGIN_Z]),
        .reciprocal_x(in[`DYNRT_TRIANGLE_TEST_STIMULUS_RECIPROCAL_X]),
        .reciprocal_y(in[`DYNRT_TRIANGLE_TEST_STIMULUS_RECIPROCAL_Y]),
        .reciprocal_z(in[`DYNRT_TRIANGLE_TEST_STIMULUS_RECIPROCAL_Z]),
        .signs(in[`DYNRT_TRIANGLE_TEST_STIMULUS_SIGNS]),
`ifdef DYNRT_WATERTIGHT
        .kz(in[`DYNRT_TRIANGLE_TEST_STIMULUS_KZ]),
        .shear_x(in[`DYNRT_TRIANGLE_TEST_STIMULUS_SHEAR_X]),
        .shear_y(in[`DYNRT_TRIANGLE_TEST_STIMULUS_SHEAR_Y]),
        .shear_z(scale[`DYNRT_TRIANGLE_TEST_STIMULUS_SHEAR_Z]),
`else
        .direction_x(in[`DYNRT_TRIANGLE_TEST_STIMULUS_DIRECTION_X]),
        .direction_y(in[`DYNRT_TRIANGLE_TEST_STIMULUS_DIRECTION_Y]),
        .direction_z(in[`DYNRT_TRIANGLE_TEST_STIMULUS_DIRECTION_Z]),
`endif
        // Every slot contains a test.
        .matrix(1'b0),
        .translation_x({`DYNRT_NUMBER_BITS{1'b0}}),
        .translation_y({`DYNRT_NUMBER_BITS{1'b0}}),
        .translation_z({`DYNRT_NUMBER_BITS{1'b0}}),
        .weight({`DYNRT_NUMBER_BITS{1'b0}}),
        .accumulate(1'b0),
        .sum_a_0({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_b_0({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_a_1({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_b_1({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_a_2({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_b_2({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_a_3({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_b_3({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_a_4({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_b_4({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_a_5({`DYNRT_NUMBER_BITS{1'b0}}),
        .sum_b_5({`DYNRT_NUMBER_BITS{1'b0}}),
        .window_near(window[`DYNRT_TRIANGLE_TEST_STIMULUS_WINDOW_NEAR]),
        .window_far(window[`DYNRT_TRIANGLE_TEST_STIMULUS_WINDOW_FAR]),
        .tmin(limits[`DYNRT_TRIANGLE_TEST_STIMULUS_TMIN]),
        .tmax(limits[`DYNRT_TRIANGLE_TEST_STIMULUS_TMAX]),
        .moved_x(),
        .moved_y(),
        .moved_z(),
        .weighted_x(),
        .weighted_y(),
        .weighted_z(),
        .sum_0(),
        .sum_1(),
        .sum_2(),
        .sum_3(),
        .sum_4(),
        .sum_5(),
        .box_near(),
        .box_far(),
        .hit(out[`DYNRT_TRIANGLE_TEST_EXPECTED_HIT]),
        .t(out[`DYNRT_TRIANGLE_TEST_EXPECTED_T]),
        .u(out[`DYNRT_TRIANGLE_TEST_EXPECTED_U]),
        .v(out[`DYNRT_TRIANGLE_TEST_EXPECTED_V])
    );

    initial begin
        clk     = 1'b0;
        running = 1'b0;
        failed  = 1'b0;
        #1;
        `LOAD("triangle_test_stimulus.hex", test_replay.stimulus, `DYNRT_TRIANGLE_TEST_STIMULUS_LINES)
        `LOAD("triangle_test_expected.hex", test_replay.expected, `DYNRT_TRIANGLE_TEST_EXPECTED_LINES)
        `LOAD("triangle_test_care.hex", test_replay.care, `DYNRT_TRIANGLE_TEST_CARE_LINES)
        running = !failed;
    end

    always @(posedge clk)
        if (done) begin
            $display("PASS %0d triangle tests checked", `DYNRT_TRIANGLE_TEST_EXPECTED_LINES);
            $finish;
        end
endmodule

`default_nettype wire
