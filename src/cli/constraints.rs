//! `dynrt constraints`: the files for the flow from Verilog to bitstream.

use super::files::{Kind, Output};
use super::generate::PrefixArg;
use super::{ConfigArgs, print};
use anyhow::Result;
use dynrt::synth::constraints;

const HELP: &str = "\
Writes a self-testing design for a board to DIR (the core, a small scene and rays in ROM, the checksum of the hits of the golden
model), and the files for its flow to a bitstream:
  dynrt_selftest*.v      the design and its test bench; sh simulate.sh runs it in Icarus Verilog
  dynrt_selftest.ucf     constraints for a Virtex-4, at the clock of the configuration
  dynrt_selftest.prj/xst the project and options of XST; sh ise.sh runs ISE from synthesis to bitstream
  edif.sh                synthesis by Yosys to an EDIF netlist, the input of sh ise.sh edif
  dynrt_ulx3s.v/lpf      the design and pins for a ULX3S board with an ECP5-85F; sh ecp5.sh makes the bitstream with open tools
  manifest.json          the files, the configuration, the checksum

The Verilog of the machine itself is expected in the folder of --rtl; generate it with dynrt generate and the same --prefix.

Examples:
  dynrt constraints --out build/constraints && dynrt generate --out build/rtl && sh build/constraints/simulate.sh
  dynrt generate --config tiny --out tiny/rtl && dynrt constraints --config tiny --out tiny/constraints && sh tiny/constraints/ecp5.sh";

/// Write a self-testing board design with constraints and scripts for the bitstream
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The output folder
    #[arg(long, value_name = "DIR", value_parser = Kind::Files)]
    out: Output,
    /// The folder of the machine's Verilog, relative to DIR
    #[arg(long, value_name = "RTL", default_value = "../rtl")]
    rtl: String,
    /// The clock of the ECP5 board in MHz, at most that of the configuration [default: half of it]
    #[arg(long, value_name = "MHZ")]
    board_mhz: Option<u32>,
    #[command(flatten)]
    prefix: PrefixArg,
    #[command(flatten)]
    config: ConfigArgs,
}

pub fn run(args: &Args) -> Result<()> {
    let config = args.config.load()?;
    let prefix = args.prefix.parse()?;
    let files = constraints::files(&config, prefix, &args.rtl, args.board_mhz)?;
    args.out.files(&files)?;
    print(&format!(
        "{}: {} files for configuration {}\n",
        args.out,
        files.len(),
        config.name
    ))
}
