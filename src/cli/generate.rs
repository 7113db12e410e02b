//! `dynrt generate`: the machine as Verilog.

use super::files::{Kind, Output};
use super::{ConfigArgs, print};
use anyhow::Result;
use dynrt::emit::{self, Extras};
use dynrt::hdl::Prefix;
use dynrt::hw::Plan;
use dynrt::hw::core::PREFIX;
use dynrt::prove::formal;

const HELP: &str = "\
Writes into DIR
  *.v              Verilog-2001, one module a file
  dynrt_core.f     the Verilog files, children first, for -f of most tools
  dynrt_core.core  the same for FuseSoC (2.4 or later), with targets lint, sim, sim_verilator and synth
  sim/             a bench of the ray casting unit, and a small set of golden vectors that it replays: for the sim targets
  formal/          with --formal: for each proof by induction the module with its properties, and a task for SymbiYosys
  manifest.json    configuration, whether it has trace ports, top module, modules with ports and latencies, layouts of the records in memory

Trace ports (trace_*) of the ray casting unit show every packet step, triangle test and ray transformation. With --trace-ports the
machine has them, at a cost in area, and the bench compares what they show; without, it compares hits and counts. All else is the same.

The names of all modules, their files and the core begin with dynrt_, or what --prefix says: two machines of different prefixes
can stand in one design.

DIR is made if it does not exist. In one that exists, files of the same names are replaced, files that its old
manifest.json lists and this machine lacks are removed, and nothing else is touched. All files are written whole before
the first takes its place, the manifest last. The same configuration gives the same files, to the byte.

Examples:
  dynrt generate --out build/rtl
  dynrt generate --config dynrt-2006 --out build/original
  dynrt generate --set packets.rays=8 --set clock.target_mhz=133 --out build/wide
  dynrt generate --config tiny --prefix small_ --out build/small
  dynrt generate --formal --out build/rtl && cd build/rtl/formal && sby -f dynrt_update_processor_credit.sby
  dynrt generate --checks --out build/checked
  dynrt generate --trace-ports --out build/traced
  cd build/rtl && verilator --lint-only -Wall -f dynrt_core.f --top-module dynrt_core

Every configuration key, with its range, is explained in the files of configs/.";

/// Emit the machine: Verilog, file lists and a manifest
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The folder to write
    #[arg(long, value_name = "DIR", value_parser = Kind::Files)]
    out: Output,
    /// Write the properties of all units for provers: formal/*.sv for Yosys, formal/*.sby for SymbiYosys
    #[arg(long)]
    formal: bool,
    /// Let the modules check their properties in simulation, where the macro DYNRT_CHECKS is defined
    #[arg(long)]
    checks: bool,
    /// Give the machine trace ports, which show every packet step, triangle test and ray transformation
    #[arg(long)]
    trace_ports: bool,
    #[command(flatten)]
    prefix: PrefixArg,
    #[command(flatten)]
    config: ConfigArgs,
}

/// What the names of a machine's modules and files begin with.
#[derive(clap::Args)]
pub struct PrefixArg {
    /// What the names of all modules and files begin with, exactly as given: [a-z][a-z0-9_]*
    #[arg(long, value_name = "NAME", default_value = PREFIX)]
    prefix: String,
}

impl PrefixArg {
    /// The prefix, or one line that says what it must be.
    pub fn parse(&self) -> Result<Prefix> {
        self.prefix.parse().map_err(anyhow::Error::msg)
    }
}

pub fn run(args: &Args) -> Result<()> {
    let config = args.config.load()?;
    let prefix = args.prefix.parse()?;
    let formal = match args.formal {
        true => Some(formal::files(&config, &prefix)?),
        false => None,
    };
    let extras = Extras {
        checks: args.checks,
        formal,
    };
    let plan = Plan::new(&config)?.with_trace(args.trace_ports);
    let (machine, files) = emit::generate_with(&plan, prefix, extras)?;
    args.out.files(&files)?;
    let modules = machine.design.files();
    let lines: usize = modules.iter().map(|(_, text)| text.lines().count()).sum();
    print(&format!(
        "{}: {} modules, {} lines of Verilog, top module {}, configuration {}\n",
        args.out,
        modules.len(),
        super::grouped(lines as u64),
        machine.design.emitted(machine.design.top().name()),
        config.name
    ))
}
