// A memory behind a read port: address and tag in, data and tag out, after a latency that may vary, then in any order.
//
// Plusargs: +latency=CYCLES and +jitter=CYCLES (an answer takes latency to latency + jitter), +in_order=0|1, +ready=PERCENT of
// the cycles in which a request is taken, +seed=N. By default they are the configuration's.
`default_nettype none
`include "vectors.vh"

module dynrt_memory #(
    parameter NAME         = "memory",
    parameter WIDTH        = 1,
    parameter LINES        = 1,
    parameter ADDRESS_BITS = 1,
    parameter TAG_BITS     = 1
) (
    input  wire                    clk,
    input  wire                    rst,
    output reg                     request_ready,
    input  wire                    request_valid,
    input  wire [ADDRESS_BITS-1:0] request_address,
    input  wire [TAG_BITS-1:0]     request_tag,
    output reg                     response_valid,
    output reg  [TAG_BITS-1:0]     response_tag,
    output reg  [WIDTH-1:0]        response_data
);
    // Filled by the bench.
    reg [WIDTH-1:0] words [0:LINES-1];

    // Answers by the clock at which they leave: more places than there can be answers under way.
    localparam PLACES = 1024;
    reg                    due         [0:PLACES-1];
    reg [ADDRESS_BITS-1:0] due_address [0:PLACES-1];
    reg [TAG_BITS-1:0]     due_tag     [0:PLACES-1];

    integer latency, jitter, ready, seed, in_order;
    integer clock, leaves, last_leaves, place, percent;

    initial begin
        latency = `DYNRT_MEMORY_LATENCY;
        jitter  = `DYNRT_MEMORY_JITTER;
        ready   = `DYNRT_MEMORY_READY_PERCENT;
        seed    = 1;
`ifdef DYNRT_MEMORY_IN_ORDER
        in_order = 1;
`else
        in_order = 0;
`endif
        if (!$value$plusargs("latency=%d", latency)) latency = latency;
        if (!$value$plusargs("jitter=%d", jitter)) jitter = jitter;
        if (!$value$plusargs("in_order=%d", in_order)) in_order = in_order;
        if (!$value$plusargs("ready=%d", ready)) ready = ready;
        if (!$value$plusargs("seed=%d", seed)) seed = seed;
        if (latency < 1 || jitter < 0 || latency + jitter > 500 || ready < 1) begin
            $display("FAIL %0s: give +latency of at least 1, +jitter so that both are at most 500, +ready of at least 1", NAME);
            $stop;
        end
        for (place = 0; place < PLACES; place = place + 1) due[place] = 1'b0;
        clock          = 0;
        last_leaves    = 0;
        request_ready  = 1'b0;
        response_valid = 1'b0;
    end

    always @(posedge clk) begin
        if (request_valid === 1'b1 && request_ready && !rst) begin
            if (request_address >= LINES) begin
                $display("FAIL %0s: address %0d is read, but there are %0d lines", NAME, request_address, LINES);
                $stop;
            end
            leaves = clock + latency - 1 + {$random(seed)} % (jitter + 1);
            if (in_order && leaves <= last_leaves) leaves = last_leaves + 1;
            while (due[leaves % PLACES]) leaves = leaves + 1;
            last_leaves = leaves;
            due[leaves % PLACES]         = 1'b1;
            due_address[leaves % PLACES] = request_address;
            due_tag[leaves % PLACES]     = request_tag;
        end
        place = clock % PLACES;
        response_valid <= due[place];
        response_tag   <= due_tag[place];
        response_data  <= words[due_address[place]];
        due[place]     = 1'b0;
        // By a variable: Verilator takes no seed in a non-blocking assignment.
        percent        = {$random(seed)} % 100;
        request_ready  <= percent < ready;
        clock          = clock + 1;
    end
endmodule

`default_nettype wire
