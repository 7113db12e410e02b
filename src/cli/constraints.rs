//! `dynrt constraints`: what takes a machine to a bitstream.

use super::files::{Kind, Output};
use super::generate::PrefixArg;
use super::{ConfigArgs, print};
use anyhow::Result;
use dynrt::synth::constraints;

const HELP: &str = "\
Writes into DIR a design that tests itself on a board (the core, a small scene and rays in ROM, a checksum of the hits that the
golden model knows) and what takes it to a bitstream:
  dynrt_selftest*.v      the design and its test bench; sh simulate.sh runs it in Icarus Verilog
  dynrt_selftest.ucf     constraints for a Virtex-4, from the configuration's clock
  dynrt_selftest.prj/xst the project and options of XST; sh ise.sh goes from synthesis to bitstream, where ISE is installed
  edif.sh                the same netlist as EDIF by Yosys, which sh ise.sh edif goes on from
  dynrt_ulx3s.v/lpf      the design and pins on a ULX3S board with an ECP5-85F; sh ecp5.sh goes to a packed bitstream with open tools
  manifest.json          the files, the configuration, the checksum

The machine's own Verilog is expected where --rtl says; write it with dynrt generate, with the same --prefix.

Examples:
  dynrt constraints --out build/constraints && dynrt generate --out build/rtl && sh build/constraints/simulate.sh
  dynrt generate --config tiny --out tiny/rtl && dynrt constraints --config tiny --out tiny/constraints && sh tiny/constraints/ecp5.sh";

/// Write constraints, scripts and a self-testing design: from Verilog to a bitstream
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The folder to write
    #[arg(long, value_name = "DIR", value_parser = Kind::Files)]
    out: Output,
    /// The folder of the machine's Verilog, seen from DIR
    #[arg(long, value_name = "RTL", default_value = "../rtl")]
    rtl: String,
    /// The clock of the ECP5 board in MHz, at most the configuration's [default: half of it]
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
