// Replays the vectors of packet steps in the slices of the traversal unit, one slice per ray, one step per cycle. raycast_tb.v checks the
// results for the packet as a whole.
`default_nettype none
`timescale 1ns / 1ps
`include "vectors.vh"
`include "bench.vh"

module dynrt_packet_step_tb;
    reg     clk, running, failed;
    integer file, line;
    always #5 clk = !clk;

    localparam W      = `DYNRT_NUMBER_BITS;
    localparam STRIDE = `DYNRT_PACKET_STEP_STIMULUS_RAY_STRIDE;

    wire [`DYNRT_PACKET_STEP_STIMULUS_BITS-1:0] in;
    wire [`DYNRT_PACKET_STEP_EXPECTED_BITS-1:0] out;
    wire done;
    dynrt_replay #(
        .NAME("packet_step_expected.hex"), .LINES(`DYNRT_PACKET_STEP_STIMULUS_LINES), .LATENCY(`DYNRT_TPU_SLICE_LATENCY),
        .STIMULUS_BITS(`DYNRT_PACKET_STEP_STIMULUS_BITS), .EXPECTED_BITS(`DYNRT_PACKET_STEP_EXPECTED_BITS)
    ) step_replay (
        .clk(clk), .running(running), .stimulus_now(in), .computed(out), .done(done), .failed()
    );

    // The interval in the node is due in a later cycle.
    wire [31:0] late_line = step_replay.clock - `DYNRT_TPU_SLICE_RAY_NEAR_STAGE;
    wire [`DYNRT_PACKET_STEP_STIMULUS_BITS-1:0] late = step_replay.stimulus[late_line];

    wire [1:0] left_axis  = in[`DYNRT_PACKET_STEP_STIMULUS_LEFT_AXIS];
    wire [1:0] right_axis = in[`DYNRT_PACKET_STEP_STIMULUS_RIGHT_AXIS];

    genvar k;
    generate
        for (k = 0; k < `DYNRT_RAYS_PER_PACKET; k = k + 1) begin : ray
            wire [3*W-1:0] origin     = in[`DYNRT_PACKET_STEP_STIMULUS_RAY0_ORIGIN_X_LSB + k * STRIDE +: 3 * W];
            wire [3*W-1:0] reciprocal = in[`DYNRT_PACKET_STEP_STIMULUS_RAY0_RECIPROCAL_X_LSB + k * STRIDE +: 3 * W];
            wire [2:0]     signs      = in[`DYNRT_PACKET_STEP_STIMULUS_RAY0_SIGNS_LSB + k * STRIDE +: 3];
            dynrt_tpu_slice slice (
                .clk(clk),
                .left_lo(in[`DYNRT_PACKET_STEP_STIMULUS_LEFT_LO]),
                .left_hi(in[`DYNRT_PACKET_STEP_STIMULUS_LEFT_HI]),
                .right_lo(in[`DYNRT_PACKET_STEP_STIMULUS_RIGHT_LO]),
                .right_hi(in[`DYNRT_PACKET_STEP_STIMULUS_RIGHT_HI]),
                .left_sign(signs[left_axis]),
                .left_origin(origin[W * left_axis +: W]),
                .left_reciprocal(reciprocal[W * left_axis +: W]),
                .right_sign(signs[right_axis]),
                .right_origin(origin[W * right_axis +: W]),
                .right_reciprocal(reciprocal[W * right_axis +: W]),
                .ray_near(late[`DYNRT_PACKET_STEP_STIMULUS_RAY0_NEAR_LSB + k * STRIDE +: W]),
                .ray_far(late[`DYNRT_PACKET_STEP_STIMULUS_RAY0_FAR_LSB + k * STRIDE +: W]),
                .ray_active(late[`DYNRT_PACKET_STEP_STIMULUS_MASK_LSB + k]),
                .out_left_near(out[`DYNRT_PACKET_STEP_EXPECTED_LEFT_RAY0_NEAR_LSB + 2 * W * k +: W]),
                .out_left_far(out[`DYNRT_PACKET_STEP_EXPECTED_LEFT_RAY0_FAR_LSB + 2 * W * k +: W]),
                .out_right_near(out[`DYNRT_PACKET_STEP_EXPECTED_RIGHT_RAY0_NEAR_LSB + 2 * W * k +: W]),
                .out_right_far(out[`DYNRT_PACKET_STEP_EXPECTED_RIGHT_RAY0_FAR_LSB + 2 * W * k +: W]),
                .to_left(out[`DYNRT_PACKET_STEP_EXPECTED_TO_LEFT_LSB + k]),
                .to_right(out[`DYNRT_PACKET_STEP_EXPECTED_TO_RIGHT_LSB + k]),
                .left_before_right(out[`DYNRT_PACKET_STEP_EXPECTED_BOTH_LEFT_FIRST_LSB + k])
            );
        end
    endgenerate

    // The slices decide for each ray, not for the packet.
    localparam FIRST = `DYNRT_PACKET_STEP_EXPECTED_LEFT_FIRST_LSB;
    localparam LAST  = `DYNRT_PACKET_STEP_EXPECTED_LEFT_RAY0_NEAR_LSB - 1;
    localparam [`DYNRT_PACKET_STEP_EXPECTED_BITS-1:0] ONE     = 1;
    localparam [`DYNRT_PACKET_STEP_EXPECTED_BITS-1:0] OF_RAYS = ~(((ONE << (LAST + 1 - FIRST)) - ONE) << FIRST);
    assign out[LAST:FIRST] = {(LAST - FIRST + 1){1'b0}};

    initial begin
        clk     = 1'b0;
        running = 1'b0;
        failed  = 1'b0;
        #1;
        `LOAD("packet_step_stimulus.hex", step_replay.stimulus, `DYNRT_PACKET_STEP_STIMULUS_LINES)
        `LOAD("packet_step_expected.hex", step_replay.expected, `DYNRT_PACKET_STEP_EXPECTED_LINES)
        `LOAD("packet_step_care.hex", step_replay.care, `DYNRT_PACKET_STEP_CARE_LINES)
        for (line = 0; line < `DYNRT_PACKET_STEP_CARE_LINES; line = line + 1)
            step_replay.care[line] = step_replay.care[line] & OF_RAYS;
        running = !failed;
    end

    always @(posedge clk)
        if (done) begin
            $display("PASS %0d packet steps checked", `DYNRT_PACKET_STEP_EXPECTED_LINES);
            $finish;
        end
endmodule

`default_nettype wire
