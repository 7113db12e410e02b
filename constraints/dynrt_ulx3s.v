// SPDX-License-Identifier: MIT OR Apache-2.0
// dynrt_ulx3s: the self-test on a ULX3S with an LFE5U-85F, at 50 MHz.
// LED 0: done; LED 1: pass; with switch 4 on, a byte of the checksum, which switches 1 to 3 choose. FIRE1 starts over.

`default_nettype none

module dynrt_ulx3s (
  input  wire       clk_25mhz,
  input  wire       fire1,
  input  wire [3:0] sw,
  output wire [7:0] led,
  output wire       wifi_gpio0
);

  wire clk, locked, done, pass;
  wire [7:0] checksum_byte;

  (* FREQUENCY_PIN_CLKI = "25", FREQUENCY_PIN_CLKOP = "50" *)
  (* ICP_CURRENT = "12", LPF_RESISTOR = "8", MFG_ENABLE_FILTEROPAMP = "1", MFG_GMCREF_SEL = "2" *)
  EHXPLLL #(
    .CLKI_DIV(1),
    .CLKFB_DIV(2),
    .FEEDBK_PATH("CLKOP"),
    .CLKOP_ENABLE("ENABLED"),
    .CLKOP_DIV(12),
    .CLKOP_CPHASE(5),
    .CLKOP_FPHASE(0),
    .PLLRST_ENA("DISABLED"),
    .STDBY_ENABLE("DISABLED"),
    .DPHASE_SOURCE("DISABLED"),
    .INTFB_WAKE("DISABLED"),
    .OUTDIVIDER_MUXA("DIVA"),
    .OUTDIVIDER_MUXB("DIVB"),
    .OUTDIVIDER_MUXC("DIVC"),
    .OUTDIVIDER_MUXD("DIVD")
  ) pll (
    .CLKI(clk_25mhz),
    .CLKFB(clk),
    .CLKOP(clk),
    .LOCK(locked),
    .RST(1'b0),
    .STDBY(1'b0),
    .PHASESEL0(1'b0),
    .PHASESEL1(1'b0),
    .PHASEDIR(1'b1),
    .PHASESTEP(1'b1),
    .PHASELOADREG(1'b1),
    .PLLWAKESYNC(1'b0),
    .ENCLKOP(1'b0)
  );

  dynrt_selftest selftest (
    .clk(clk),
    .rst_n(locked & ~fire1),
    .select(sw[2:0]),
    .done(done),
    .pass(pass),
    .checksum_byte(checksum_byte)
  );

  assign led = sw[3] ? checksum_byte : {6'd0, pass, done};
  // Low, it would let the board's processor load its own bitstream.
  assign wifi_gpio0 = 1'b1;

endmodule

`default_nettype wire
