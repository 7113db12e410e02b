// Replays updates of objects in the update processor. Compares every written node in order (address, mask and numbers), every box, and
// the number of executed instructions. After the last update it compares the whole node memory.
//
// Plusargs: those of memory.v; +writes=PERCENT of the cycles in which a node or a box is accepted (100 by default).
`default_nettype none
`timescale 1ns / 1ps
`include "vectors.vh"
`include "bench.vh"

module dynrt_update_tb;
    reg     clk, rst, failed;
    integer file, line;
    always #5 clk = !clk;

    localparam W    = `DYNRT_NUMBER_BITS;
    localparam A    = `DYNRT_ADDRESS_BITS;
    localparam NODE = `DYNRT_UPDATE_NODES_BEFORE_BITS;

    reg [`DYNRT_UPDATE_COMMANDS_BITS-1:0]    commands    [0:`DYNRT_UPDATE_COMMANDS_LINES-1];
    reg [`DYNRT_UPDATE_NODE_WRITES_BITS-1:0] writes      [0:`DYNRT_UPDATE_NODE_WRITES_LINES-1];
    reg [NODE-1:0]                     nodes       [0:`DYNRT_UPDATE_NODES_BEFORE_LINES-1];
    reg [NODE-1:0]                     nodes_after [0:`DYNRT_UPDATE_NODES_AFTER_LINES-1];
    reg [`DYNRT_UPDATE_BOXES_BITS-1:0]       boxes       [0:`DYNRT_UPDATE_BOXES_LINES-1];

    // The unit and its memories.
    integer                           number;
    wire [`DYNRT_UPDATE_COMMANDS_BITS-1:0]  command = commands[number];
    reg                               start_valid;
    wire                              start_ready, done;
    wire                              program_request_ready, program_request_valid, program_response_valid;
    wire [A-1:0]                      program_request_address;
    wire [`DYNRT_UPDATE_PROGRAM_TAG_BITS-1:0] program_request_tag, program_response_tag;
    wire [`DYNRT_UPDATE_PROGRAM_BITS-1:0]   program_response_data;
    wire                              vertex_request_ready, vertex_request_valid, vertex_response_valid;
    wire [A-1:0]                      vertex_request_address;
    wire [`DYNRT_UPDATE_VERTEX_TAG_BITS-1:0] vertex_request_tag, vertex_response_tag;
    wire [`DYNRT_UPDATE_VERTICES_BITS-1:0]  vertex_response_data;
    reg                               node_write_ready, box_write_ready;
    wire                              node_write_valid, box_write_valid;
    wire [A-1:0]                      node_write_address, box_write_address;
    wire [`DYNRT_NODE_LANES-1:0]            node_write_mask;
    wire [NODE-1:0]                   node_write_data;
    wire [`DYNRT_UPDATE_BOXES_BITS-1:0]     box_write_data;
    wire [39:0]                       count_instructions;

    dynrt_update_processor unit (
        .clk(clk),
        .rst(rst),
        .start_ready(start_ready),
        .start_valid(start_valid),
        .start_program(command[`DYNRT_UPDATE_COMMANDS_PROGRAM_LSB +: A]),
        .start_rows(command[`DYNRT_UPDATE_COMMANDS_ROWS_LSB +: A]),
        .start_vertex_base(command[`DYNRT_UPDATE_COMMANDS_VERTEX_BASE_LSB +: A]),
        .start_node_base(command[`DYNRT_UPDATE_COMMANDS_NODE_BASE_LSB +: A]),
        .start_box_index(command[`DYNRT_UPDATE_COMMANDS_BOX_INDEX_LSB +: A]),
        .program_request_ready(program_request_ready),
        .program_request_valid(program_request_valid),
        .program_request_address(program_request_address),
        .program_request_tag(program_request_tag),
        .program_response_valid(program_response_valid),
        .program_response_tag(program_response_tag),
        .program_response_data(program_response_data),
        .vertex_request_ready(vertex_request_ready),
        .vertex_request_valid(vertex_request_valid),
        .vertex_request_address(vertex_request_address),
        .vertex_request_tag(vertex_request_tag),
        .vertex_response_valid(vertex_response_valid),
        .vertex_response_tag(vertex_response_tag),
        .vertex_response_data(vertex_response_data),
        .node_write_ready(node_write_ready),
        .node_write_valid(node_write_valid),
        .node_write_address(node_write_address),
        .node_write_mask(node_write_mask),
        .node_write_data(node_write_data),
        .box_write_ready(box_write_ready),
        .box_write_valid(box_write_valid),
        .box_write_address(box_write_address),
        .box_write_data(box_write_data),
        .done(done),
        .count_instructions(count_instructions),
        .count_busy_cycles(),
        .count_stalled_cycles(),
        .count_vertex_wait_cycles(),
        .count_node_wait_cycles()
    );

    dynrt_memory #(
        .NAME("update_program.hex"), .WIDTH(`DYNRT_UPDATE_PROGRAM_BITS), .LINES(`DYNRT_UPDATE_PROGRAM_LINES),
        .ADDRESS_BITS(A), .TAG_BITS(`DYNRT_UPDATE_PROGRAM_TAG_BITS)
    ) program (
        .clk(clk), .rst(rst),
        .request_ready(program_request_ready), .request_valid(program_request_valid),
        .request_address(program_request_address), .request_tag(program_request_tag),
        .response_valid(program_response_valid), .response_tag(program_response_tag), .response_data(program_response_data)
    );
    dynrt_memory #(
        .NAME("update_vertices.hex"), .WIDTH(`DYNRT_UPDATE_VERTICES_BITS), .LINES(`DYNRT_UPDATE_VERTICES_LINES),
        .ADDRESS_BITS(A), .TAG_BITS(`DYNRT_UPDATE_VERTEX_TAG_BITS)
    ) vertices (
        .clk(clk), .rst(rst),
        .request_ready(vertex_request_ready), .request_valid(vertex_request_valid),
        .request_address(vertex_request_address), .request_tag(vertex_request_tag),
        .response_valid(vertex_response_valid), .response_tag(vertex_response_tag), .response_data(vertex_response_data)
    );

    integer seed, write_percent, idle, at, next_write, last_write;
    integer writes_checked, instructions_checked;
    reg     running, box_written, compared;
    reg [`DYNRT_UPDATE_NODE_WRITES_BITS-1:0] write, write_due;
    reg [NODE-1:0]                     node;

    // The four numbers are the lowest bits of a node, in memory and in a line.
    localparam NUMBERS = 4 * W;

    initial begin
        clk    = 1'b0;
        rst    = 1'b1;
        failed = 1'b0;
        seed          = 1;
        write_percent = 100;
        if (!$value$plusargs("seed=%d", seed)) seed = 1;
        if (!$value$plusargs("writes=%d", write_percent)) write_percent = 100;
        number               = 0;
        start_valid          = 1'b0;
        node_write_ready     = 1'b0;
        box_write_ready      = 1'b0;
        running              = 1'b0;
        box_written          = 1'b0;
        compared             = 1'b0;
        next_write           = 0;
        last_write           = 0;
        writes_checked       = 0;
        instructions_checked = 0;
        idle                 = 0;
        #1;
        `LOAD("update_program.hex", program.words, `DYNRT_UPDATE_PROGRAM_LINES)
        `LOAD("update_vertices.hex", vertices.words, `DYNRT_UPDATE_VERTICES_LINES)
        `LOAD("update_nodes_before.hex", nodes, `DYNRT_UPDATE_NODES_BEFORE_LINES)
        `LOAD("update_commands.hex", commands, `DYNRT_UPDATE_COMMANDS_LINES)
        `LOAD("update_node_writes.hex", writes, `DYNRT_UPDATE_NODE_WRITES_LINES)
        `LOAD("update_nodes_after.hex", nodes_after, `DYNRT_UPDATE_NODES_AFTER_LINES)
        `LOAD("update_boxes.hex", boxes, `DYNRT_UPDATE_BOXES_LINES)
        repeat (4) @(posedge clk);
        rst <= 1'b0;
    end

    task fail;
        begin
            failed = 1'b1;
            $finish;
        end
    endtask

    // Updates start one after another.
    always @(posedge clk)
        if (!rst && !failed) begin
            start_valid      <= !running && !(start_valid && start_ready) && number < `DYNRT_UPDATE_COMMANDS_LINES;
            node_write_ready <= {$random(seed)} % 100 < write_percent;
            box_write_ready  <= {$random(seed)} % 100 < write_percent;
            if (start_valid && start_ready) begin
                running     = 1'b1;
                box_written = 1'b0;
                next_write  = command[`DYNRT_UPDATE_COMMANDS_FIRST_WRITE];
                last_write  = command[`DYNRT_UPDATE_COMMANDS_FIRST_WRITE] + command[`DYNRT_UPDATE_COMMANDS_WRITES];
            end
        end

    // Nodes and boxes written.
    always @(posedge clk)
        if (!rst && !failed && node_write_valid && node_write_ready) begin
            write                                = {`DYNRT_UPDATE_NODE_WRITES_BITS{1'b0}};
            write[`DYNRT_UPDATE_NODE_WRITES_NODE]      = node_write_address;
            write[`DYNRT_UPDATE_NODE_WRITES_MASK]      = node_write_mask;
            write[`DYNRT_UPDATE_NODE_WRITES_LEFT_LO_LSB +: NUMBERS] = node_write_data[NUMBERS-1:0];
            write_due = writes[next_write];
            if (!running || next_write == last_write) begin
                $display("FAIL update_commands.hex line %0d: node %0d is written after its last", number + 1, node_write_address);
                fail;
            end else if (write !== write_due) begin
                $display("FAIL update_node_writes.hex line %0d: expected %h, computed %h", next_write + 1, write_due, write);
                fail;
            end else begin
                node = nodes[node_write_address];
                node[NUMBERS-1:0] = node_write_data[NUMBERS-1:0];
                nodes[node_write_address] = node;
            end
            next_write     = next_write + 1;
            writes_checked = writes_checked + 1;
        end
    always @(posedge clk)
        if (!rst && !failed && box_write_valid && box_write_ready) begin
            at = command[`DYNRT_UPDATE_COMMANDS_BOX_INDEX];
            if (!running || box_written || box_write_address !== at[A-1:0]) begin
                $display("FAIL update_commands.hex line %0d: box %0d is written, expected box %0d, once", number + 1, box_write_address, at);
                fail;
            end else if (box_write_data !== boxes[at]) begin
                $display("FAIL update_boxes.hex line %0d: expected %h, computed %h", at + 1, boxes[at], box_write_data);
                fail;
            end
            box_written = 1'b1;
        end

    // The end of an update, and of the run.
    always @(negedge clk)
        if (!rst && !failed) begin
            if (running && done) begin
                instructions_checked = instructions_checked + command[`DYNRT_UPDATE_COMMANDS_INSTRUCTIONS];
                if (next_write != last_write || !box_written || count_instructions !== instructions_checked) begin
                    $display("FAIL update_commands.hex line %0d: %0d node writes are missing, box written %b, instructions so far %0d of %0d",
                        number + 1, last_write - next_write, box_written, count_instructions, instructions_checked);
                    fail;
                end
                running = 1'b0;
                number  = number + 1;
            end
            if (number == `DYNRT_UPDATE_COMMANDS_LINES && !failed && !compared) begin
                compared = 1'b1;
                for (at = 0; at < `DYNRT_UPDATE_NODES_AFTER_LINES && !failed; at = at + 1)
                    if (nodes[at] !== nodes_after[at]) begin
                        $display("FAIL update_nodes_after.hex line %0d: expected %h, in memory %h", at + 1, nodes_after[at], nodes[at]);
                        fail;
                    end
                if (!failed)
                    $display("PASS %0d updates checked, %0d node writes, %0d instructions",
                        number, writes_checked, instructions_checked);
                $finish;
            end
            idle = (!running || program_request_valid || program_response_valid || vertex_response_valid
                || (node_write_valid && node_write_ready)) ? 0 : idle + 1;
            if (idle == 100000) begin
                $display("FAIL nothing has happened for 100000 clocks in update_commands.hex line %0d", number + 1);
                fail;
            end
        end
endmodule

`default_nettype wire
