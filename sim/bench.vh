// Reads a file into MEMORY, which has as many words as the file should have lines. For a bench that includes replay.v or has a
// reg `failed` and integers `file` and `line` of its own.
//
// A bench runs in the folder of the vectors and prints one line that begins with PASS or FAIL; then it ends, by $stop after a FAIL: with
// `vvp -N` the exit status says it, too.
`define LOAD(NAME, MEMORY, LINES) \
    if (!failed) begin \
        file = $fopen(NAME, "r"); \
        if (file == 0) begin \
            $display("FAIL %0s: the file is missing", NAME); \
            failed = 1'b1; \
        end else begin \
            $fclose(file); \
            $readmemh(NAME, MEMORY); \
            for (line = 0; line < LINES && !failed; line = line + 1) \
                if (^MEMORY[line] === 1'bx) begin \
                    $display("FAIL %0s line %0d: missing, or no hexadecimal number", NAME, line + 1); \
                    failed = 1'b1; \
                end \
        end \
        if (failed) $stop; \
    end
