// Replays whole rays in the ray casting unit: every hit is compared in all bits by its tag, and in the end the numbers of packet steps,
// ray-triangle tests and ray transformations. Where the macro DYNRT_TRACE is defined, as it must be of a unit with trace ports and of no
// other, each step, test and transformation that they show is compared, too, in the packet's order.
//
// Plusargs: those of memory.v; +rays=PERCENT of the cycles in which a ray is offered, +hits=PERCENT in which a hit is taken
// (100 by default, both).
`default_nettype none
`timescale 1ns / 1ps
`include "vectors.vh"
`include "bench.vh"

module dynrt_raycast_tb;
    reg     clk, rst, failed;
    integer file, line;
    always #5 clk = !clk;

    localparam N = `DYNRT_RAYS_PER_PACKET;
    localparam W = `DYNRT_NUMBER_BITS;

    reg [`DYNRT_RAYCAST_RAYS_BITS-1:0]           rays            [0:`DYNRT_RAYCAST_RAYS_LINES-1];
    reg [`DYNRT_RAYCAST_HITS_BITS-1:0]           hits            [0:`DYNRT_RAYCAST_HITS_LINES-1];
    reg [`DYNRT_RAYCAST_PACKETS_BITS-1:0]        packets         [0:`DYNRT_RAYCAST_PACKETS_LINES-1];
    // The registers are those of the scene that the packets under way are in.
    reg [`DYNRT_SCENE_BITS-1:0]                  scene           [0:`DYNRT_SCENE_LINES-1];
    integer                                      scene_now;
    wire [`DYNRT_SCENE_BITS-1:0] registers = scene[scene_now];

    // The unit and its memories.
    reg                           ray_valid;
    wire                          ray_ready;
    integer                       next_ray;
    wire [`DYNRT_RAYCAST_RAYS_BITS-1:0] ray = rays[next_ray];
    reg                           hit_ready;
    wire                          hit_valid;
    wire [`DYNRT_TAG_BITS-1:0]          hit_tag;
    wire [W-1:0]                  hit_t, hit_u, hit_v;
    wire [31:0]                   hit_instance, hit_triangle;
    wire                          node_request_ready, node_request_valid, node_response_valid;
    wire [`DYNRT_ADDRESS_BITS-1:0]      node_request_address;
    wire [`DYNRT_PACKET_BITS:0]         node_request_tag, node_response_tag;
    wire [`DYNRT_NODES_BITS-1:0]        node_response_data;
    wire                          record_request_ready, record_request_valid, record_response_valid;
    wire [`DYNRT_ADDRESS_BITS-1:0]      record_request_address;
    wire [`DYNRT_PACKET_BITS:0]         record_request_tag, record_response_tag;
    wire [`DYNRT_RECORDS_BITS-1:0]      record_response_data;
    wire                          vertex_request_ready, vertex_request_valid, vertex_response_valid;
    wire [`DYNRT_ADDRESS_BITS-1:0]      vertex_request_address;
    wire [`DYNRT_VERTEX_TAG_BITS-1:0]   vertex_request_tag, vertex_response_tag;
    wire [`DYNRT_VERTICES_BITS-1:0]     vertex_response_data;
    wire [39:0]                   count_packet_steps, count_ray_triangle_tests, count_ray_transforms;
    wire                          stack_overflow;

`ifdef DYNRT_TRACE
    // What trace ports show, and what they should.
    wire                          trace_start_valid, trace_step_valid, trace_test_valid;
    wire [`DYNRT_PACKET_BITS-1:0]       trace_start_packet, trace_step_packet, trace_test_packet;
    wire [`DYNRT_TAG_BITS-1:0]          trace_start_tag;
    wire [`DYNRT_ADDRESS_BITS-1:0]      trace_step_node, trace_test_record;
    wire [N-1:0]                  trace_step_left, trace_step_right;
    wire                          trace_step_left_first;
    wire [2*N*W-1:0]              trace_step_left_intervals, trace_step_right_intervals;
    wire [`DYNRT_RAY_BITS-1:0]          trace_test_ray;
    wire                          trace_test_hit;
    wire [W-1:0]                  trace_test_t, trace_test_u, trace_test_v;
    wire                          trace_transform_valid;
    wire [`DYNRT_PACKET_BITS-1:0]       trace_transform_packet;
    wire [`DYNRT_RAY_BITS-1:0]          trace_transform_ray;
    wire [`DYNRT_ADDRESS_BITS-1:0]      trace_transform_record;
    wire [W-1:0]                  trace_transform_near, trace_transform_far;
    wire [W-1:0]                  trace_transform_origin_x, trace_transform_origin_y, trace_transform_origin_z;
    wire [W-1:0]                  trace_transform_direction_x, trace_transform_direction_y, trace_transform_direction_z;
    reg [`DYNRT_PACKET_STEP_STIMULUS_BITS-1:0]   step_stimulus   [0:`DYNRT_PACKET_STEP_STIMULUS_LINES-1];
    reg [`DYNRT_PACKET_STEP_EXPECTED_BITS-1:0]   step_expected   [0:`DYNRT_PACKET_STEP_EXPECTED_LINES-1];
    reg [`DYNRT_PACKET_STEP_CARE_BITS-1:0]       step_care       [0:`DYNRT_PACKET_STEP_CARE_LINES-1];
    reg [`DYNRT_TRIANGLE_TEST_STIMULUS_BITS-1:0] test_stimulus   [0:`DYNRT_TRIANGLE_TEST_STIMULUS_LINES-1];
    reg [`DYNRT_TRIANGLE_TEST_EXPECTED_BITS-1:0] test_expected   [0:`DYNRT_TRIANGLE_TEST_EXPECTED_LINES-1];
    reg [`DYNRT_TRIANGLE_TEST_CARE_BITS-1:0]     test_care       [0:`DYNRT_TRIANGLE_TEST_CARE_LINES-1];
`ifdef DYNRT_TWO_LEVELS
    reg [`DYNRT_RAY_TRANSFORM_STIMULUS_BITS-1:0] transform_stimulus [0:`DYNRT_RAY_TRANSFORM_STIMULUS_LINES-1];
    reg [`DYNRT_RAY_TRANSFORM_EXPECTED_BITS-1:0] transform_expected [0:`DYNRT_RAY_TRANSFORM_EXPECTED_LINES-1];
    reg [`DYNRT_RAY_TRANSFORM_STIMULUS_BITS-1:0] transform_in;
    reg [`DYNRT_RAY_TRANSFORM_EXPECTED_BITS-1:0] transform, transform_due;
`endif
    // The place of each packet in the unit.
    integer place_in [0:(1<<`DYNRT_PACKET_BITS)-1];
    reg [`DYNRT_PACKET_STEP_STIMULUS_BITS-1:0]   step_in;
    reg [`DYNRT_PACKET_STEP_EXPECTED_BITS-1:0]   step_due, step_mask;
    reg [`DYNRT_TRIANGLE_TEST_STIMULUS_BITS-1:0] test_in;
    reg [`DYNRT_TRIANGLE_TEST_EXPECTED_BITS-1:0] test, test_due, test_mask;

    localparam LEFT  = `DYNRT_PACKET_STEP_EXPECTED_LEFT_RAY0_NEAR_LSB;
    localparam RIGHT = `DYNRT_PACKET_STEP_EXPECTED_RIGHT_RAY0_NEAR_LSB;
`endif

    dynrt_raycast_unit unit (
        .clk(clk),
        .rst(rst),
        .scene_root(registers[`DYNRT_SCENE_ROOT]),
        .scene_lo_x(registers[`DYNRT_SCENE_LO_X]),
        .scene_lo_y(registers[`DYNRT_SCENE_LO_Y]),
        .scene_lo_z(registers[`DYNRT_SCENE_LO_Z]),
        .scene_hi_x(registers[`DYNRT_SCENE_HI_X]),
        .scene_hi_y(registers[`DYNRT_SCENE_HI_Y]),
        .scene_hi_z(registers[`DYNRT_SCENE_HI_Z]),
        .ray_ready(ray_ready),
        .ray_valid(ray_valid),
        .ray_tag(ray[`DYNRT_RAYCAST_RAYS_TAG]),
        .ray_origin_x(ray[`DYNRT_RAYCAST_RAYS_ORIGIN_X]),
        .ray_origin_y(ray[`DYNRT_RAYCAST_RAYS_ORIGIN_Y]),
        .ray_origin_z(ray[`DYNRT_RAYCAST_RAYS_ORIGIN_Z]),
        .ray_direction_x(ray[`DYNRT_RAYCAST_RAYS_DIRECTION_X]),
        .ray_direction_y(ray[`DYNRT_RAYCAST_RAYS_DIRECTION_Y]),
        .ray_direction_z(ray[`DYNRT_RAYCAST_RAYS_DIRECTION_Z]),
        .ray_tmin(ray[`DYNRT_RAYCAST_RAYS_TMIN]),
        .ray_tmax(ray[`DYNRT_RAYCAST_RAYS_TMAX]),
        .ray_active(ray[`DYNRT_RAYCAST_RAYS_ACTIVE]),
        .ray_any_hit(ray[`DYNRT_RAYCAST_RAYS_ANY_HIT]),
        .hit_ready(hit_ready),
        .hit_valid(hit_valid),
        .hit_tag(hit_tag),
        .hit_t(hit_t),
        .hit_u(hit_u),
        .hit_v(hit_v),
        .hit_instance(hit_instance),
        .hit_triangle(hit_triangle),
        .node_request_ready(node_request_ready),
        .node_request_valid(node_request_valid),
        .node_request_address(node_request_address),
        .node_request_tag(node_request_tag),
        .node_response_valid(node_response_valid),
        .node_response_tag(node_response_tag),
        .node_response_data(node_response_data),
        .record_request_ready(record_request_ready),
        .record_request_valid(record_request_valid),
        .record_request_address(record_request_address),
        .record_request_tag(record_request_tag),
        .record_response_valid(record_response_valid),
        .record_response_tag(record_response_tag),
        .record_response_data(record_response_data),
        .vertex_request_ready(vertex_request_ready),
        .vertex_request_valid(vertex_request_valid),
        .vertex_request_address(vertex_request_address),
        .vertex_request_tag(vertex_request_tag),
        .vertex_response_valid(vertex_response_valid),
        .vertex_response_tag(vertex_response_tag),
        .vertex_response_data(vertex_response_data),
        // Nothing is skinned.
        .skin_start_valid(1'b0),
        .skin_start_palette({`DYNRT_ADDRESS_BITS{1'b0}}),
        .skin_start_joints({`DYNRT_JOINT_COUNT_BITS{1'b0}}),
        .skin_start_influences({`DYNRT_ADDRESS_BITS{1'b0}}),
        .skin_start_rows({`DYNRT_ADDRESS_BITS{1'b0}}),
        .skin_start_rest({`DYNRT_ADDRESS_BITS{1'b0}}),
        .skin_start_vertices({`DYNRT_ADDRESS_BITS{1'b0}}),
        .skin_start_target({`DYNRT_ADDRESS_BITS{1'b0}}),
        .skin_start_ready(),
        .skin_done(),
        .skin_write_ready(1'b0),
        .skin_write_valid(),
        .skin_write_address(),
        .skin_write_data(),
        .influence_request_ready(1'b0),
        .influence_request_valid(),
        .influence_request_address(),
        .influence_request_tag(),
        .influence_response_valid(1'b0),
        .influence_response_tag({`DYNRT_INFLUENCE_TAG_BITS{1'b0}}),
        .influence_response_data({`DYNRT_INFLUENCE_ROW_BITS{1'b0}}),
`ifdef DYNRT_TRACE
        .trace_start_valid(trace_start_valid),
        .trace_start_packet(trace_start_packet),
        .trace_start_tag(trace_start_tag),
        .trace_step_valid(trace_step_valid),
        .trace_step_packet(trace_step_packet),
        .trace_step_node(trace_step_node),
        .trace_step_left(trace_step_left),
        .trace_step_right(trace_step_right),
        .trace_step_left_first(trace_step_left_first),
        .trace_step_left_intervals(trace_step_left_intervals),
        .trace_step_right_intervals(trace_step_right_intervals),
        .trace_test_valid(trace_test_valid),
        .trace_test_packet(trace_test_packet),
        .trace_test_ray(trace_test_ray),
        .trace_test_record(trace_test_record),
        .trace_test_hit(trace_test_hit),
        .trace_test_t(trace_test_t),
        .trace_test_u(trace_test_u),
        .trace_test_v(trace_test_v),
        .trace_transform_valid(trace_transform_valid),
        .trace_transform_packet(trace_transform_packet),
        .trace_transform_ray(trace_transform_ray),
        .trace_transform_record(trace_transform_record),
        .trace_transform_near(trace_transform_near),
        .trace_transform_far(trace_transform_far),
        .trace_transform_origin_x(trace_transform_origin_x),
        .trace_transform_origin_y(trace_transform_origin_y),
        .trace_transform_origin_z(trace_transform_origin_z),
        .trace_transform_direction_x(trace_transform_direction_x),
        .trace_transform_direction_y(trace_transform_direction_y),
        .trace_transform_direction_z(trace_transform_direction_z),
`endif
        .count_cycles(),
        .count_packet_steps(count_packet_steps),
        .count_ray_triangle_tests(count_ray_triangle_tests),
        .count_ray_transforms(count_ray_transforms),
        .count_tpu_busy_cycles(),
        .count_tpu_starved_cycles(),
        .count_gu_busy_cycles(),
        .count_gu_starved_cycles(),
        .count_skin_influences(),
        .count_skin_cycles(),
        .stack_high_water(),
        .stack_overflow(stack_overflow)
    );

    dynrt_memory #(
        .NAME("nodes.hex"), .WIDTH(`DYNRT_NODES_BITS), .LINES(`DYNRT_NODES_LINES),
        .ADDRESS_BITS(`DYNRT_ADDRESS_BITS), .TAG_BITS(`DYNRT_PACKET_BITS + 1)
    ) nodes (
        .clk(clk), .rst(rst),
        .request_ready(node_request_ready), .request_valid(node_request_valid),
        .request_address(node_request_address), .request_tag(node_request_tag),
        .response_valid(node_response_valid), .response_tag(node_response_tag), .response_data(node_response_data)
    );
    dynrt_memory #(
        .NAME("records.hex"), .WIDTH(`DYNRT_RECORDS_BITS), .LINES(`DYNRT_RECORDS_LINES),
        .ADDRESS_BITS(`DYNRT_ADDRESS_BITS), .TAG_BITS(`DYNRT_PACKET_BITS + 1)
    ) records (
        .clk(clk), .rst(rst),
        .request_ready(record_request_ready), .request_valid(record_request_valid),
        .request_address(record_request_address), .request_tag(record_request_tag),
        .response_valid(record_response_valid), .response_tag(record_response_tag), .response_data(record_response_data)
    );
    dynrt_memory #(
        .NAME("vertices.hex"), .WIDTH(`DYNRT_VERTICES_BITS), .LINES(`DYNRT_VERTICES_LINES),
        .ADDRESS_BITS(`DYNRT_ADDRESS_BITS), .TAG_BITS(`DYNRT_VERTEX_TAG_BITS)
    ) vertices (
        .clk(clk), .rst(rst),
        .request_ready(vertex_request_ready), .request_valid(vertex_request_valid),
        .request_address(vertex_request_address), .request_tag(vertex_request_tag),
        .response_valid(vertex_response_valid), .response_tag(vertex_response_tag), .response_data(vertex_response_data)
    );

    // Packets under way, by the low bits of their tags. A packet waits while another one has its place.
    localparam PLACE_BITS = (`DYNRT_TAG_BITS < 12) ? `DYNRT_TAG_BITS : 12;
    localparam PLACES     = 1 << PLACE_BITS;
    reg     busy      [0:PLACES-1];
    integer packet_of [0:PLACES-1];
    integer hits_of   [0:PLACES-1];
    // The next lines of its steps, tests and transformations, and the lines after its last.
    integer step_of   [0:PLACES-1];
    integer step_end  [0:PLACES-1];
    integer test_of   [0:PLACES-1];
    integer test_end  [0:PLACES-1];
    integer transform_of  [0:PLACES-1];
    integer transform_end [0:PLACES-1];

    integer seed, ray_percent, hit_percent, idle;
    integer hits_checked, steps_checked, tests_checked, transforms_checked;
    integer place, at, under_way;
    reg     goes_on;

    reg [`DYNRT_RAYCAST_PACKETS_BITS-1:0]        packet;
    reg [`DYNRT_RAYCAST_RAYS_BITS-1:0]           upcoming;
    reg [`DYNRT_RAYCAST_HITS_BITS-1:0]           hit, hit_due;

    initial begin
        clk    = 1'b0;
        rst    = 1'b1;
        failed = 1'b0;
        seed        = 1;
        ray_percent = 100;
        hit_percent = 100;
        if (!$value$plusargs("seed=%d", seed)) seed = 1;
        if (!$value$plusargs("rays=%d", ray_percent)) ray_percent = 100;
        if (!$value$plusargs("hits=%d", hit_percent)) hit_percent = 100;
        for (at = 0; at < PLACES; at = at + 1) busy[at] = 1'b0;
        ray_valid     = 1'b0;
        hit_ready     = 1'b0;
        next_ray      = 0;
        scene_now     = 0;
        under_way     = 0;
        hits_checked  = 0;
        steps_checked = 0;
        tests_checked = 0;
        transforms_checked = 0;
        idle          = 0;
        #1;
        `LOAD("nodes.hex", nodes.words, `DYNRT_NODES_LINES)
        `LOAD("records.hex", records.words, `DYNRT_RECORDS_LINES)
        `LOAD("vertices.hex", vertices.words, `DYNRT_VERTICES_LINES)
        `LOAD("scene.hex", scene, `DYNRT_SCENE_LINES)
        `LOAD("raycast_rays.hex", rays, `DYNRT_RAYCAST_RAYS_LINES)
        `LOAD("raycast_hits.hex", hits, `DYNRT_RAYCAST_HITS_LINES)
        `LOAD("raycast_packets.hex", packets, `DYNRT_RAYCAST_PACKETS_LINES)
`ifdef DYNRT_TRACE
        `LOAD("packet_step_stimulus.hex", step_stimulus, `DYNRT_PACKET_STEP_STIMULUS_LINES)
        `LOAD("packet_step_expected.hex", step_expected, `DYNRT_PACKET_STEP_EXPECTED_LINES)
        `LOAD("packet_step_care.hex", step_care, `DYNRT_PACKET_STEP_CARE_LINES)
        `LOAD("triangle_test_stimulus.hex", test_stimulus, `DYNRT_TRIANGLE_TEST_STIMULUS_LINES)
        `LOAD("triangle_test_expected.hex", test_expected, `DYNRT_TRIANGLE_TEST_EXPECTED_LINES)
        `LOAD("triangle_test_care.hex", test_care, `DYNRT_TRIANGLE_TEST_CARE_LINES)
`ifdef DYNRT_TWO_LEVELS
        `LOAD("ray_transform_stimulus.hex", transform_stimulus, `DYNRT_RAY_TRANSFORM_STIMULUS_LINES)
        `LOAD("ray_transform_expected.hex", transform_expected, `DYNRT_RAY_TRANSFORM_EXPECTED_LINES)
`endif
`endif
        repeat (4) @(posedge clk);
        rst <= 1'b0;
    end

    task fail;
        begin
            failed = 1'b1;
            $stop;
        end
    endtask

    // Rays in.
    always @(posedge clk)
        if (!rst && !failed) begin
            if (ray_valid && ray_ready) begin
                if (next_ray % N == 0) begin
                    place  = ray[`DYNRT_RAYCAST_RAYS_TAG_LSB +: PLACE_BITS];
                    packet = packets[next_ray / N];
                    busy[place]      = 1'b1;
                    under_way        = under_way + 1;
                    packet_of[place] = next_ray / N;
                    hits_of[place]   = 0;
                    step_of[place]   = packet[`DYNRT_RAYCAST_PACKETS_FIRST_STEP];
                    step_end[place]  = packet[`DYNRT_RAYCAST_PACKETS_FIRST_STEP] + packet[`DYNRT_RAYCAST_PACKETS_STEPS];
                    test_of[place]   = packet[`DYNRT_RAYCAST_PACKETS_FIRST_TEST];
                    test_end[place]  = packet[`DYNRT_RAYCAST_PACKETS_FIRST_TEST] + packet[`DYNRT_RAYCAST_PACKETS_TESTS];
                    transform_of[place]  = packet[`DYNRT_RAYCAST_PACKETS_FIRST_TRANSFORM];
                    transform_end[place] = packet[`DYNRT_RAYCAST_PACKETS_FIRST_TRANSFORM] + packet[`DYNRT_RAYCAST_PACKETS_TRANSFORMS];
                end
                at = next_ray + 1;
            end else begin
                at = next_ray;
            end
            next_ray <= at;
            upcoming = rays[at];
            packet   = packets[at / N];
            goes_on  = packet[`DYNRT_RAYCAST_PACKETS_SCENE] == scene_now;
            // Another scene begins when no packet of the last one is under way.
            if (at < `DYNRT_RAYCAST_RAYS_LINES && !goes_on && under_way == 0) scene_now <= packet[`DYNRT_RAYCAST_PACKETS_SCENE];
            ray_valid <= at < `DYNRT_RAYCAST_RAYS_LINES && goes_on
                && (at % N != 0 || !busy[upcoming[`DYNRT_RAYCAST_RAYS_TAG_LSB +: PLACE_BITS]])
                && ((ray_valid && !ray_ready) || {$random(seed)} % 100 < ray_percent);
            hit_ready <= {$random(seed)} % 100 < hit_percent;
        end

`ifdef DYNRT_TRACE
    // What happens inside.
    always @(posedge clk)
        if (!rst && !failed) begin
            if (trace_start_valid) place_in[trace_start_packet] = trace_start_tag[PLACE_BITS-1:0];
            if (trace_step_valid) begin
                place = place_in[trace_step_packet];
                at    = step_of[place];
                if (at >= step_end[place]) begin
                    $display("FAIL raycast_packets.hex line %0d: a packet step (node %0d) beyond its last",
                        packet_of[place] + 1, trace_step_node);
                    fail;
                end else begin
                    step_in   = step_stimulus[at];
                    step_due  = step_expected[at];
                    step_mask = step_care[at];
                    if (trace_step_node !== step_in[`DYNRT_PACKET_STEP_STIMULUS_NODE_LSB +: `DYNRT_ADDRESS_BITS]
                        || trace_step_left !== step_due[`DYNRT_PACKET_STEP_EXPECTED_TO_LEFT]
                        || trace_step_right !== step_due[`DYNRT_PACKET_STEP_EXPECTED_TO_RIGHT]
                        || trace_step_left_first !== step_due[`DYNRT_PACKET_STEP_EXPECTED_LEFT_FIRST]
                        || ((trace_step_left_intervals ^ step_due[LEFT +: 2*N*W]) & step_mask[LEFT +: 2*N*W]) !== {2*N*W{1'b0}}
                        || ((trace_step_right_intervals ^ step_due[RIGHT +: 2*N*W]) & step_mask[RIGHT +: 2*N*W]) !== {2*N*W{1'b0}}
                    ) begin
                        $display("FAIL packet_step_expected.hex line %0d: node %0d, expected %0d; left %b, expected %b; right %b, expected %b; left first %b, expected %b; intervals %h and %h, expected %h and %h where compared",
                            at + 1,
                            trace_step_node, step_in[`DYNRT_PACKET_STEP_STIMULUS_NODE],
                            trace_step_left, step_due[`DYNRT_PACKET_STEP_EXPECTED_TO_LEFT],
                            trace_step_right, step_due[`DYNRT_PACKET_STEP_EXPECTED_TO_RIGHT],
                            trace_step_left_first, step_due[`DYNRT_PACKET_STEP_EXPECTED_LEFT_FIRST],
                            trace_step_left_intervals, trace_step_right_intervals,
                            step_due[LEFT +: 2*N*W], step_due[RIGHT +: 2*N*W]);
                        fail;
                    end
                    step_of[place] = at + 1;
                    steps_checked  = steps_checked + 1;
                end
            end
            if (trace_test_valid) begin
                place = place_in[trace_test_packet];
                at    = test_of[place];
                if (at >= test_end[place]) begin
                    $display("FAIL raycast_packets.hex line %0d: a triangle test (record %0d) beyond its last",
                        packet_of[place] + 1, trace_test_record);
                    fail;
                end else begin
                    test_in   = test_stimulus[at];
                    test_due  = test_expected[at];
                    test_mask = test_care[at];
                    test[`DYNRT_TRIANGLE_TEST_EXPECTED_HIT] = trace_test_hit;
                    test[`DYNRT_TRIANGLE_TEST_EXPECTED_T]   = trace_test_t;
                    test[`DYNRT_TRIANGLE_TEST_EXPECTED_U]   = trace_test_u;
                    test[`DYNRT_TRIANGLE_TEST_EXPECTED_V]   = trace_test_v;
                    if (trace_test_record !== test_in[`DYNRT_TRIANGLE_TEST_STIMULUS_RECORD_LSB +: `DYNRT_ADDRESS_BITS]
                        || (N > 1 && trace_test_ray !== test_in[`DYNRT_TRIANGLE_TEST_STIMULUS_SLOT_LSB +: `DYNRT_RAY_BITS])
                        || ((test ^ test_due) & test_mask) !== {`DYNRT_TRIANGLE_TEST_EXPECTED_BITS{1'b0}}
                    ) begin
                        $display("FAIL triangle_test_expected.hex line %0d: record %0d, expected %0d; ray %0d, expected %0d; result %h, expected %h where compared",
                            at + 1, trace_test_record, test_in[`DYNRT_TRIANGLE_TEST_STIMULUS_RECORD],
                            trace_test_ray, test_in[`DYNRT_TRIANGLE_TEST_STIMULUS_SLOT], test, test_due);
                        fail;
                    end
                    test_of[place] = at + 1;
                    tests_checked  = tests_checked + 1;
                end
            end
        end

    // Rays taken to an object's space.
    always @(posedge clk)
        if (!rst && !failed && trace_transform_valid) begin
            place = place_in[trace_transform_packet];
            at    = transform_of[place];
            if (at >= transform_end[place]) begin
                $display("FAIL raycast_packets.hex line %0d: a ray transformation (record %0d) beyond its last",
                    packet_of[place] + 1, trace_transform_record);
                fail;
            end
`ifdef DYNRT_TWO_LEVELS
            else begin
                transform_in  = transform_stimulus[at];
                transform_due = transform_expected[at];
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_ORIGIN_X]    = trace_transform_origin_x;
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_ORIGIN_Y]    = trace_transform_origin_y;
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_ORIGIN_Z]    = trace_transform_origin_z;
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_DIRECTION_X] = trace_transform_direction_x;
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_DIRECTION_Y] = trace_transform_direction_y;
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_DIRECTION_Z] = trace_transform_direction_z;
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_NEAR]        = trace_transform_near;
                transform[`DYNRT_RAY_TRANSFORM_EXPECTED_FAR]         = trace_transform_far;
                if (trace_transform_record !== transform_in[`DYNRT_RAY_TRANSFORM_STIMULUS_RECORD_LSB +: `DYNRT_ADDRESS_BITS]
                    || (N > 1 && trace_transform_ray !== transform_in[`DYNRT_RAY_TRANSFORM_STIMULUS_SLOT_LSB +: `DYNRT_RAY_BITS])
                    || transform !== transform_due
                ) begin
                    $display("FAIL ray_transform_expected.hex line %0d: record %0d, expected %0d; ray %0d, expected %0d; result %h, expected %h",
                        at + 1, trace_transform_record, transform_in[`DYNRT_RAY_TRANSFORM_STIMULUS_RECORD],
                        trace_transform_ray, transform_in[`DYNRT_RAY_TRANSFORM_STIMULUS_SLOT], transform, transform_due);
                    fail;
                end
                transform_of[place] = at + 1;
                transforms_checked  = transforms_checked + 1;
            end
`endif
        end
`endif

    // Hits out.
    always @(posedge clk)
        if (!rst && !failed && hit_valid && hit_ready) begin
            place = hit_tag[PLACE_BITS-1:0];
            if (busy[place] !== 1'b1) begin
                $display("FAIL a hit with tag %h, which no packet has", hit_tag);
                fail;
            end else begin
                at      = packet_of[place] * N + hits_of[place];
                hit_due = hits[at];
                hit[`DYNRT_RAYCAST_HITS_T]        = hit_t;
                hit[`DYNRT_RAYCAST_HITS_U]        = hit_u;
                hit[`DYNRT_RAYCAST_HITS_V]        = hit_v;
                hit[`DYNRT_RAYCAST_HITS_INSTANCE] = hit_instance;
                hit[`DYNRT_RAYCAST_HITS_TRIANGLE] = hit_triangle;
                hit[`DYNRT_RAYCAST_HITS_TAG]      = hit_tag;
                if (hit !== hit_due) begin
                    $display("FAIL raycast_hits.hex line %0d: expected %h, computed %h", at + 1, hit_due, hit);
                    fail;
                end
                hits_checked   = hits_checked + 1;
                hits_of[place] = hits_of[place] + 1;
                if (hits_of[place] == N) begin
                    busy[place] = 1'b0;
                    under_way   = under_way - 1;
`ifdef DYNRT_TRACE
                    if (step_of[place] != step_end[place] || test_of[place] != test_end[place]
                        || transform_of[place] != transform_end[place]
                    ) begin
                        $display("FAIL raycast_packets.hex line %0d: %0d packet steps, %0d triangle tests and %0d ray transformations are missing",
                            packet_of[place] + 1, step_end[place] - step_of[place], test_end[place] - test_of[place],
                            transform_end[place] - transform_of[place]);
                        fail;
                    end
`else
                    // There are as many as there should be, if the unit's counters agree in the end.
                    steps_checked      = steps_checked + step_end[place] - step_of[place];
                    tests_checked      = tests_checked + test_end[place] - test_of[place];
                    transforms_checked = transforms_checked + transform_end[place] - transform_of[place];
`endif
                end
            end
        end

    // The end.
    always @(negedge clk)
        if (!rst && !failed) begin
            if (hits_checked == `DYNRT_RAYCAST_HITS_LINES) begin
                if (stack_overflow !== 1'b0 || count_packet_steps !== steps_checked || count_ray_triangle_tests !== tests_checked
                    || count_ray_transforms !== transforms_checked
                ) begin
                    $display("FAIL counters: stack_overflow %b, packet steps %0d of %0d, triangle tests %0d of %0d, ray transformations %0d of %0d",
                        stack_overflow, count_packet_steps, steps_checked, count_ray_triangle_tests, tests_checked,
                        count_ray_transforms, transforms_checked);
                    fail;
                end else begin
`ifdef DYNRT_TRACE
                    $display("PASS %0d hits checked, %0d packet steps, %0d triangle tests, %0d ray transformations",
                        hits_checked, steps_checked, tests_checked, transforms_checked);
`else
                    $display("PASS %0d hits checked; counted %0d packet steps, %0d triangle tests, %0d ray transformations",
                        hits_checked, steps_checked, tests_checked, transforms_checked);
`endif
                    $finish;
                end
            end
            idle = (node_response_valid || record_response_valid || (hit_valid && hit_ready) || (ray_valid && ray_ready)) ? 0 : idle + 1;
            if (idle == 100000) begin
                $display("FAIL nothing has happened for 100000 clocks; %0d of %0d hits are missing",
                    `DYNRT_RAYCAST_HITS_LINES - hits_checked, `DYNRT_RAYCAST_HITS_LINES);
                fail;
            end
        end
endmodule

`default_nettype wire
