// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_selftest_vertex_rom: 28 words of 72 bits; a word a clock after its address.

`default_nettype none

module dynrt_selftest_vertex_rom (
  input  wire clk,
  input  wire [4:0] address,
  (* rom_style = "block" *)
  output reg  [71:0] word
);

  always @(posedge clk) begin
    case (address)
      5'd0: word <= 72'h46179a0000003e999a;
      5'd1: word <= 72'h46179a000000461600;
      5'd2: word <= 72'h000000000000461600;
      5'd3: word <= 72'h0000000000003f999a;
      5'd4: word <= 72'h46179a461266000000;
      5'd5: word <= 72'h454c3346126644aa00;
      5'd6: word <= 72'h454c33461266455700;
      5'd7: word <= 72'h46179a461266461600;
      5'd8: word <= 72'h44c666461266455700;
      5'd9: word <= 72'h000000461266461600;
      5'd10: word <= 72'h44c66646126644aa00;
      5'd11: word <= 72'h000000461266000000;
      5'd12: word <= 72'h45ee33444a0045aa00;
      5'd13: word <= 72'h454e33444a0045da00;
      5'd14: word <= 72'h451f33444a00453c00;
      5'd15: word <= 72'h45bd33444a00450a00;
      5'd16: word <= 72'h45ee3300000045aa00;
      5'd17: word <= 72'h454e3300000045da00;
      5'd18: word <= 72'h451f33000000453c00;
      5'd19: word <= 72'h45bd33000000450a00;
      5'd20: word <= 72'h453833454a00440a00;
      5'd21: word <= 72'h450733454a00452300;
      5'd22: word <= 72'h439ccd454a0044e400;
      5'd23: word <= 72'h443266454a00435000;
      5'd24: word <= 72'h453833000000440a00;
      5'd25: word <= 72'h450733000000452300;
      5'd26: word <= 72'h439ccd00000044e400;
      5'd27: word <= 72'h443266000000435000;
      default: word <= 72'd0;
    endcase
  end

endmodule

`default_nettype wire
