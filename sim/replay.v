// Replays the vectors of a pipelined unit: one line enters per cycle, and its result is compared LATENCY cycles later.
`default_nettype none

module dynrt_replay #(
    parameter NAME          = "unit",
    parameter STIMULUS_BITS = 1,
    parameter EXPECTED_BITS = 1,
    parameter LINES         = 1,
    parameter LATENCY       = 1
) (
    input  wire                     clk,
    // While this is high, one line enters per cycle.
    input  wire                     running,
    // The line that enters the pipeline, and the result that leaves it.
    output wire [STIMULUS_BITS-1:0] stimulus_now,
    input  wire [EXPECTED_BITS-1:0] computed,
    // `done` after the last line has been compared, `failed` after a difference.
    output reg                      done,
    output reg                      failed
);
    // The bench fills these. A bit of `expected` is compared if its bit in `care` is 1; without a care file all bits are compared.
    reg [STIMULUS_BITS-1:0] stimulus [0:LINES-1];
    reg [EXPECTED_BITS-1:0] expected [0:LINES-1];
    reg [EXPECTED_BITS-1:0] care     [0:LINES-1];
    integer clock, line;

    initial begin
        done   = 1'b0;
        failed = 1'b0;
        clock  = 0;
        for (line = 0; line < LINES; line = line + 1) care[line] = {EXPECTED_BITS{1'b1}};
    end

    // Outside the lines the operands are undefined, and no compared result may depend on them.
    assign stimulus_now = stimulus[clock];

    wire [31:0]              out    = clock - LATENCY;
    wire [EXPECTED_BITS-1:0] differ = (computed ^ expected[out]) & care[out];

    always @(posedge clk)
        if (running && !done && !failed) begin
            clock <= clock + 1;
            if (clock >= LATENCY) begin
                if (differ !== {EXPECTED_BITS{1'b0}}) begin
                    $display("FAIL %0s line %0d: expected %h, computed %h, compared where %h has a 1",
                        NAME, out + 1, expected[out], computed, care[out]);
                    failed <= 1'b1;
                    $finish;
                end
                done <= out == LINES - 1;
            end
        end
endmodule

`default_nettype wire
