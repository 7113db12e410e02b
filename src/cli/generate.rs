//! `dynrt generate`: generation of the Verilog.

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
  *.v              Verilog-2001, one module per file
  dynrt_core.f     the list of Verilog files, submodules first, for the -f option of most tools
  dynrt_core.core  the same for FuseSoC (2.4 or later), with targets lint, sim, sim_verilator and synth
  sim/             a test bench of the ray casting unit and a small set of golden vectors, for the sim targets
  formal/          with --formal: for each proof by induction, the module with its properties and a task for SymbiYosys
  dynrt_regs.h     with --top chip: registers, descriptors, record sizes and limits of the machine for C programs
  dynrt.rdl        with --top chip: the registers in SystemRDL 2.0
  manifest.json    configuration, trace ports, top module, modules with ports and latencies, layouts of the records in memory

With --trace-ports the ray casting unit has trace ports (trace_*), which show every traversal step, triangle test and ray
transformation, at a cost in area. The test bench then compares these as well; otherwise it compares hits and counts.

The names of all modules, their files and the core begin with dynrt_ or the value of --prefix. Two machines with different prefixes
can be part of one design.

DIR is created if it does not exist. In an existing DIR, files of the same names are replaced, and files that its old
manifest.json lists and this machine lacks are removed; no other file is changed. All files are written completely before
the first one is replaced, the manifest last. The same configuration always gives identical files.

Examples:
  dynrt generate --out build/rtl
  dynrt generate --config dynrt-2006 --out build/original
  dynrt generate --set packets.rays=8 --set clock.target_mhz=133 --out build/wide
  dynrt generate --config tiny --prefix small_ --out build/small
  dynrt generate --formal --out build/rtl && cd build/rtl/formal && sby -f dynrt_update_processor_credit.sby
  dynrt generate --checks --out build/checked
  dynrt generate --trace-ports --out build/traced
  cd build/rtl && verilator --lint-only -Wall -f dynrt_core.f --top-module dynrt_core

The files in configs/ explain every configuration key and its range.";

/// Generate the machine: Verilog, file lists and a manifest
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The output folder
    #[arg(long, value_name = "DIR", value_parser = Kind::Files)]
    out: Output,
    /// Write the properties of all units for formal tools: formal/*.sv for Yosys, formal/*.sby for SymbiYosys
    #[arg(long)]
    formal: bool,
    /// Add checks of the properties to the modules, for simulation with the macro DYNRT_CHECKS
    #[arg(long)]
    checks: bool,
    /// Add trace ports, which show every traversal step, triangle test and ray transformation
    #[arg(long)]
    trace_ports: bool,
    #[command(flatten)]
    top: TopArg,
    #[command(flatten)]
    prefix: PrefixArg,
    #[command(flatten)]
    config: ConfigArgs,
}

/// The top module of a design.
#[derive(clap::Args)]
pub struct TopArg {
    /// The top module
    #[arg(long, value_name = "TOP", default_value = "core")]
    top: Top,
}

#[derive(Clone, Copy, clap::ValueEnum)]
enum Top {
    /// All units, each with its own memory ports
    Core,
    /// The core with caches and command processor, behind an AXI4 and an AXI4-Lite bus
    Chip,
}

impl TopArg {
    pub fn top(&self) -> emit::Top {
        match self.top {
            Top::Core => emit::Top::Core,
            Top::Chip => emit::Top::Chip,
        }
    }
}

/// The prefix of the names of a machine's modules and files.
#[derive(clap::Args)]
pub struct PrefixArg {
    /// The prefix of all module and file names, [a-z][a-z0-9_]*
    #[arg(long, value_name = "NAME", default_value = PREFIX)]
    prefix: String,
}

impl PrefixArg {
    /// The prefix, or an error in one line.
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
    let (machine, files) = emit::generate_with(&plan, prefix, args.top.top(), extras)?;
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
