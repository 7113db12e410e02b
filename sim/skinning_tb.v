// Replays skinned meshes in the skinning processor, which is part of the ray casting unit. Compares every written vertex in order,
// address and all bits, and the number of influences.
//
// Plusargs: those of memory.v; +writes=PERCENT of the cycles in which a vertex is accepted (100 by default).
`default_nettype none
`timescale 1ns / 1ps
`include "vectors.vh"
`include "bench.vh"

module dynrt_skinning_tb;
    reg     clk, rst, failed;
    integer file, line;
    always #5 clk = !clk;

    localparam A = `DYNRT_ADDRESS_BITS;

    reg [`DYNRT_SKINNING_COMMANDS_BITS-1:0] commands [0:`DYNRT_SKINNING_COMMANDS_LINES-1];
    reg [`DYNRT_SKINNING_EXPECTED_BITS-1:0] expected [0:`DYNRT_SKINNING_EXPECTED_LINES-1];

    // The unit and its memories. There are no rays.
    integer                             number;
    wire [`DYNRT_SKINNING_COMMANDS_BITS-1:0]  command = commands[number];
    reg                                 skin_start_valid;
    wire                                skin_start_ready, skin_done;
    wire                                vertex_request_ready, vertex_request_valid, vertex_response_valid;
    wire [A-1:0]                        vertex_request_address;
    wire [`DYNRT_VERTEX_TAG_BITS-1:0]         vertex_request_tag, vertex_response_tag;
    wire [`DYNRT_SKINNING_VECTORS_BITS-1:0]   vertex_response_data;
    wire                                influence_request_ready, influence_request_valid, influence_response_valid;
    wire [A-1:0]                        influence_request_address;
    wire [`DYNRT_INFLUENCE_TAG_BITS-1:0]      influence_request_tag, influence_response_tag;
    wire [`DYNRT_SKINNING_INFLUENCES_BITS-1:0] influence_response_data;
    reg                                 skin_write_ready;
    wire                                skin_write_valid;
    wire [A-1:0]                        skin_write_address;
    wire [`DYNRT_SKINNING_VECTORS_BITS-1:0]   skin_write_data;
    wire [39:0]                         count_skin_influences;

    dynrt_raycast_unit unit (
        .clk(clk),
        .rst(rst),
        .scene_root(32'b0),
        .scene_lo_x({`DYNRT_NUMBER_BITS{1'b0}}),
        .scene_lo_y({`DYNRT_NUMBER_BITS{1'b0}}),
        .scene_lo_z({`DYNRT_NUMBER_BITS{1'b0}}),
        .scene_hi_x({`DYNRT_NUMBER_BITS{1'b0}}),
        .scene_hi_y({`DYNRT_NUMBER_BITS{1'b0}}),
        .scene_hi_z({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_ready(),
        .ray_valid(1'b0),
        .ray_tag({`DYNRT_TAG_BITS{1'b0}}),
        .ray_origin_x({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_origin_y({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_origin_z({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_direction_x({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_direction_y({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_direction_z({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_tmin({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_tmax({`DYNRT_NUMBER_BITS{1'b0}}),
        .ray_active(1'b0),
        .ray_any_hit(1'b0),
        .hit_ready(1'b0),
        .hit_valid(),
        .hit_tag(),
        .hit_t(),
        .hit_u(),
        .hit_v(),
        .hit_instance(),
        .hit_triangle(),
        .node_request_ready(1'b0),
        .node_request_valid(),
        .node_request_address(),
        .node_request_tag(),
        .node_response_valid(1'b0),
        .node_response_tag({(`DYNRT_PACKET_BITS + 1){1'b0}}),
        .node_response_data({`DYNRT_NODES_BITS{1'b0}}),
        .record_request_ready(1'b0),
        .record_request_valid(),
        .record_request_address(),
        .record_request_tag(),
        .record_response_valid(1'b0),
        .record_response_tag({(`DYNRT_PACKET_BITS + 1){1'b0}}),
        .record_response_data({`DYNRT_RECORDS_BITS{1'b0}}),
        .vertex_request_ready(vertex_request_ready),
        .vertex_request_valid(vertex_request_valid),
        .vertex_request_address(vertex_request_address),
        .vertex_request_tag(vertex_request_tag),
        .vertex_response_valid(vertex_response_valid),
        .vertex_response_tag(vertex_response_tag),
        .vertex_response_data(vertex_response_data),
        .skin_start_valid(skin_start_valid),
        .skin_start_palette(command[`DYNRT_SKINNING_COMMANDS_PALETTE_LSB +: A]),
        .skin_start_joints(command[`DYNRT_SKINNING_COMMANDS_JOINTS_LSB +: `DYNRT_JOINT_COUNT_BITS]),
        .skin_start_influences(command[`DYNRT_SKINNING_COMMANDS_INFLUENCES_LSB +: A]),
        .skin_start_rows(command[`DYNRT_SKINNING_COMMANDS_ROWS_LSB +: A]),
        .skin_start_rest(command[`DYNRT_SKINNING_COMMANDS_REST_LSB +: A]),
        .skin_start_vertices(command[`DYNRT_SKINNING_COMMANDS_VERTICES_LSB +: A]),
        .skin_start_target(command[`DYNRT_SKINNING_COMMANDS_TARGET_LSB +: A]),
        .skin_start_ready(skin_start_ready),
        .skin_done(skin_done),
        .skin_write_ready(skin_write_ready),
        .skin_write_valid(skin_write_valid),
        .skin_write_address(skin_write_address),
        .skin_write_data(skin_write_data),
        .influence_request_ready(influence_request_ready),
        .influence_request_valid(influence_request_valid),
        .influence_request_address(influence_request_address),
        .influence_request_tag(influence_request_tag),
        .influence_response_valid(influence_response_valid),
        .influence_response_tag(influence_response_tag),
        .influence_response_data(influence_response_data),
        .count_cycles(),
        .count_packet_steps(),
        .count_ray_triangle_tests(),
        .count_ray_transforms(),
        .count_tpu_busy_cycles(),
        .count_tpu_starved_cycles(),
        .count_gu_busy_cycles(),
        .count_gu_starved_cycles(),
        .count_skin_influences(count_skin_influences),
        .count_skin_cycles(),
        .stack_high_water(),
        .stack_overflow()
    );

    dynrt_memory #(
        .NAME("skinning_vectors.hex"), .WIDTH(`DYNRT_SKINNING_VECTORS_BITS), .LINES(`DYNRT_SKINNING_VECTORS_LINES),
        .ADDRESS_BITS(A), .TAG_BITS(`DYNRT_VERTEX_TAG_BITS)
    ) vectors (
        .clk(clk), .rst(rst),
        .request_ready(vertex_request_ready), .request_valid(vertex_request_valid),
        .request_address(vertex_request_address), .request_tag(vertex_request_tag),
        .response_valid(vertex_response_valid), .response_tag(vertex_response_tag), .response_data(vertex_response_data)
    );
    dynrt_memory #(
        .NAME("skinning_influences.hex"), .WIDTH(`DYNRT_SKINNING_INFLUENCES_BITS), .LINES(`DYNRT_SKINNING_INFLUENCES_LINES),
        .ADDRESS_BITS(A), .TAG_BITS(`DYNRT_INFLUENCE_TAG_BITS)
    ) influences (
        .clk(clk), .rst(rst),
        .request_ready(influence_request_ready), .request_valid(influence_request_valid),
        .request_address(influence_request_address), .request_tag(influence_request_tag),
        .response_valid(influence_response_valid), .response_tag(influence_response_tag), .response_data(influence_response_data)
    );

    integer seed, write_percent, idle, next_vertex, last_vertex;
    integer vertices_checked, influences_checked;
    reg     running, finished;
    reg [`DYNRT_SKINNING_EXPECTED_BITS-1:0] vertex;

    initial begin
        clk    = 1'b0;
        rst    = 1'b1;
        failed = 1'b0;
        seed          = 1;
        write_percent = 100;
        if (!$value$plusargs("seed=%d", seed)) seed = 1;
        if (!$value$plusargs("writes=%d", write_percent)) write_percent = 100;
        number             = 0;
        skin_start_valid   = 1'b0;
        skin_write_ready   = 1'b0;
        running            = 1'b0;
        finished           = 1'b0;
        next_vertex        = 0;
        last_vertex        = 0;
        vertices_checked   = 0;
        influences_checked = 0;
        idle               = 0;
        #1;
        `LOAD("skinning_vectors.hex", vectors.words, `DYNRT_SKINNING_VECTORS_LINES)
        `LOAD("skinning_influences.hex", influences.words, `DYNRT_SKINNING_INFLUENCES_LINES)
        `LOAD("skinning_commands.hex", commands, `DYNRT_SKINNING_COMMANDS_LINES)
        `LOAD("skinning_expected.hex", expected, `DYNRT_SKINNING_EXPECTED_LINES)
        repeat (4) @(posedge clk);
        rst <= 1'b0;
    end

    task fail;
        begin
            failed = 1'b1;
            $finish;
        end
    endtask

    // Meshes start one after another.
    always @(posedge clk)
        if (!rst && !failed) begin
            skin_start_valid <= !running && !(skin_start_valid && skin_start_ready) && number < `DYNRT_SKINNING_COMMANDS_LINES;
            skin_write_ready <= {$random(seed)} % 100 < write_percent;
            if (skin_start_valid && skin_start_ready) begin
                running     = 1'b1;
                next_vertex = command[`DYNRT_SKINNING_COMMANDS_FIRST_VERTEX];
                last_vertex = command[`DYNRT_SKINNING_COMMANDS_FIRST_VERTEX] + command[`DYNRT_SKINNING_COMMANDS_VERTICES];
            end
        end

    // Vertices written.
    always @(posedge clk)
        if (!rst && !failed && skin_write_valid && skin_write_ready) begin
            vertex = {`DYNRT_SKINNING_EXPECTED_BITS{1'b0}};
            vertex[`DYNRT_SKINNING_EXPECTED_VERTEX] = skin_write_address;
            vertex[`DYNRT_SKINNING_EXPECTED_X_LSB +: `DYNRT_SKINNING_VECTORS_BITS] = skin_write_data;
            if (!running || next_vertex == last_vertex) begin
                $display("FAIL skinning_commands.hex line %0d: vertex %0d is written after its last", number + 1, skin_write_address);
                fail;
            end else if (vertex !== expected[next_vertex]) begin
                $display("FAIL skinning_expected.hex line %0d: expected %h, computed %h", next_vertex + 1, expected[next_vertex], vertex);
                fail;
            end
            next_vertex      = next_vertex + 1;
            vertices_checked = vertices_checked + 1;
        end

    // The end of a mesh, and of the run.
    always @(negedge clk)
        if (!rst && !failed && !finished) begin
            if (running && skin_done) begin
                influences_checked = influences_checked + command[`DYNRT_SKINNING_COMMANDS_COUNT];
                if (next_vertex != last_vertex || count_skin_influences !== influences_checked) begin
                    $display("FAIL skinning_commands.hex line %0d: %0d vertices are missing, influences so far %0d of %0d",
                        number + 1, last_vertex - next_vertex, count_skin_influences, influences_checked);
                    fail;
                end
                running = 1'b0;
                number  = number + 1;
            end
            if (number == `DYNRT_SKINNING_COMMANDS_LINES && !failed) begin
                finished = 1'b1;
                $display("PASS %0d meshes checked, %0d vertices, %0d influences", number, vertices_checked, influences_checked);
                $finish;
            end
            idle = (!running || vertex_response_valid || influence_response_valid || (skin_write_valid && skin_write_ready)) ? 0 : idle + 1;
            if (idle == 100000) begin
                $display("FAIL nothing has happened for 100000 clocks in skinning_commands.hex line %0d", number + 1);
                fail;
            end
        end
endmodule

`default_nettype wire
