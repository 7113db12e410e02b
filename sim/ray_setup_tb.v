// Replays the vectors of ray setup, one ray per cycle.
`default_nettype none
`timescale 1ns / 1ps
`include "vectors.vh"
`include "bench.vh"

module dynrt_ray_setup_tb;
    reg     clk, rst, running, failed;
    integer file, line;
    always #5 clk = !clk;

    wire [`DYNRT_RAY_SETUP_STIMULUS_BITS-1:0] in;
    wire [`DYNRT_RAY_SETUP_EXPECTED_BITS-1:0] out;
    wire done;
    dynrt_replay #(
        .NAME("ray_setup_expected.hex"), .LINES(`DYNRT_RAY_SETUP_STIMULUS_LINES), .LATENCY(`DYNRT_RAY_SETUP_LATENCY),
        .STIMULUS_BITS(`DYNRT_RAY_SETUP_STIMULUS_BITS), .EXPECTED_BITS(`DYNRT_RAY_SETUP_EXPECTED_BITS)
    ) setup_replay (
        .clk(clk), .running(running), .stimulus_now(in), .computed(out), .done(done), .failed()
    );

    // The box is that of the first scene.
    reg  [`DYNRT_SCENE_BITS-1:0] scene [0:`DYNRT_SCENE_LINES-1];
    wire [`DYNRT_SCENE_BITS-1:0] box = scene[0];
    wire out_valid;
    wire [`DYNRT_PACKET_BITS-1:0] packet = setup_replay.clock;
    wire [`DYNRT_RAY_BITS-1:0]    ray    = setup_replay.clock;
    wire [`DYNRT_PACKET_BITS-1:0] out_packet;
    wire [`DYNRT_RAY_BITS-1:0]    out_ray;

    dynrt_ray_setup setup (
        .clk(clk),
        .rst(rst),
        .valid(running),
        .packet(packet),
        .ray(ray),
        .first(1'b0),
        .last(1'b0),
        .object(1'b0),
        .active(in[`DYNRT_RAY_SETUP_STIMULUS_ACTIVE]),
        .any_hit(in[`DYNRT_RAY_SETUP_STIMULUS_ANY_HIT]),
        .origin_x(in[`DYNRT_RAY_SETUP_STIMULUS_ORIGIN_X]),
        .origin_y(in[`DYNRT_RAY_SETUP_STIMULUS_ORIGIN_Y]),
        .origin_z(in[`DYNRT_RAY_SETUP_STIMULUS_ORIGIN_Z]),
        .direction_x(in[`DYNRT_RAY_SETUP_STIMULUS_DIRECTION_X]),
        .direction_y(in[`DYNRT_RAY_SETUP_STIMULUS_DIRECTION_Y]),
        .direction_z(in[`DYNRT_RAY_SETUP_STIMULUS_DIRECTION_Z]),
        .tmin(in[`DYNRT_RAY_SETUP_STIMULUS_TMIN]),
        .tmax(in[`DYNRT_RAY_SETUP_STIMULUS_TMAX]),
        .scene_lo_x(box[`DYNRT_SCENE_LO_X]),
        .scene_lo_y(box[`DYNRT_SCENE_LO_Y]),
        .scene_lo_z(box[`DYNRT_SCENE_LO_Z]),
        .scene_hi_x(box[`DYNRT_SCENE_HI_X]),
        .scene_hi_y(box[`DYNRT_SCENE_HI_Y]),
        .scene_hi_z(box[`DYNRT_SCENE_HI_Z]),
        .out_valid(out_valid),
        .out_packet(out_packet),
        .out_ray(out_ray),
        .out_first(),
        .out_last(),
        .out_object(),
        .out_enters(out[`DYNRT_RAY_SETUP_EXPECTED_ENTERS]),
        .out_near(out[`DYNRT_RAY_SETUP_EXPECTED_NEAR]),
        .out_far(out[`DYNRT_RAY_SETUP_EXPECTED_FAR]),
        .out_signs(out[`DYNRT_RAY_SETUP_EXPECTED_SIGNS]),
        .out_tmin(out[`DYNRT_RAY_SETUP_EXPECTED_TMIN]),
        .out_tmax(out[`DYNRT_RAY_SETUP_EXPECTED_TMAX]),
        .out_any_hit(out[`DYNRT_RAY_SETUP_EXPECTED_ANY_HIT]),
        .out_origin_x(out[`DYNRT_RAY_SETUP_EXPECTED_ORIGIN_X]),
        .out_origin_y(out[`DYNRT_RAY_SETUP_EXPECTED_ORIGIN_Y]),
        .out_origin_z(out[`DYNRT_RAY_SETUP_EXPECTED_ORIGIN_Z]),
        .out_reciprocal_x(out[`DYNRT_RAY_SETUP_EXPECTED_RECIPROCAL_X]),
        .out_reciprocal_y(out[`DYNRT_RAY_SETUP_EXPECTED_RECIPROCAL_Y]),
        .out_reciprocal_z(out[`DYNRT_RAY_SETUP_EXPECTED_RECIPROCAL_Z]),
`ifdef DYNRT_WATERTIGHT
        .out_kz(out[`DYNRT_RAY_SETUP_EXPECTED_KZ]),
        .out_shear_x(out[`DYNRT_RAY_SETUP_EXPECTED_SHEAR_X]),
        .out_shear_y(out[`DYNRT_RAY_SETUP_EXPECTED_SHEAR_Y]),
        .out_shear_z(out[`DYNRT_RAY_SETUP_EXPECTED_SHEAR_Z]),
`else
        .out_direction_x(out[`DYNRT_RAY_SETUP_EXPECTED_DIRECTION_X]),
        .out_direction_y(out[`DYNRT_RAY_SETUP_EXPECTED_DIRECTION_Y]),
        .out_direction_z(out[`DYNRT_RAY_SETUP_EXPECTED_DIRECTION_Z]),
`endif
        .next_packet(),
        .soon()
    );

    initial begin
        clk     = 1'b0;
        rst     = 1'b1;
        running = 1'b0;
        failed  = 1'b0;
        #1;
        `LOAD("scene.hex", scene, `DYNRT_SCENE_LINES)
        `LOAD("ray_setup_stimulus.hex", setup_replay.stimulus, `DYNRT_RAY_SETUP_STIMULUS_LINES)
        `LOAD("ray_setup_expected.hex", setup_replay.expected, `DYNRT_RAY_SETUP_EXPECTED_LINES)
        `LOAD("ray_setup_care.hex", setup_replay.care, `DYNRT_RAY_SETUP_CARE_LINES)
        repeat (4) @(posedge clk);
        rst     <= 1'b0;
        running <= !failed;
    end

    // The identification of the ray travels with it.
    wire [`DYNRT_PACKET_BITS-1:0] packet_due = setup_replay.out;
    wire [`DYNRT_RAY_BITS-1:0]    ray_due    = setup_replay.out;
    always @(posedge clk)
        if (running && !failed && !done && setup_replay.clock >= `DYNRT_RAY_SETUP_LATENCY
            && (out_valid !== 1'b1 || out_packet !== packet_due || out_ray !== ray_due)) begin
            $display("FAIL ray_setup_expected.hex line %0d: valid %b packet %0d ray %0d, expected 1 %0d %0d",
                setup_replay.out + 1, out_valid, out_packet, out_ray, packet_due, ray_due);
            failed = 1'b1;
            $finish;
        end

    always @(posedge clk)
        if (done && !failed) begin
            $display("PASS %0d ray setups checked", `DYNRT_RAY_SETUP_EXPECTED_LINES);
            $finish;
        end
endmodule

`default_nettype wire
