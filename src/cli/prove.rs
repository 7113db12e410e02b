//! `dynrt prove`: proofs about the generated Verilog.

use super::files::{Kind, Output};
use super::{ConfigArgs, counted, print};
use anyhow::{Result, bail};
use dynrt::prove::{self, Options, Outcome, Row};
use dynrt::report;
use serde_json::{Value, json};
use std::time::Instant;

const HELP: &str = "\
Units:
  add, sub, mul     the result is the exact one, rounded once, for all operands including special values
  reciprocal        the same, by simulation of the gates for every operand
  compare, step     less, less or equal, equal, min, max; steps of three ulps
  slots             the triangle test: shared operators, slots of different kinds do not affect each other
  fifo, prefetch    every queue and every prefetcher of the machine: order, no loss, no duplicate, no overflow
  credit            the update processor: exact credits, stable ports, no deadlock
  skin, geometry    the skinning processor, the geometry unit: the same for vertices, meshes, leaves and rays
  tpu, stack        the traversal unit: no packet is lost or duplicated, no queue overflows; a pop reads the pushed entry
  share             the ray casting unit: packet numbers, tags, sharing of the geometry unit and its memory port
  axi               the AXI4 master: the rules of the bus, in front of any slave that obeys its own
  combiner, arbiter the write combiner, the read arbiter: bytes and their order, bursts unchanged and in turn, no deadlock
  reader            burst readers: no overflow, bursts within their block, no deadlock
  registers         the chip's register file: accesses, doorbells, interrupts, snapshots; its event counters
  commands          the command processor: order of the list, waits, errors, no deadlock
  trace             the core behaves the same with and without trace ports

Arithmetic is compared with an independent reference by ABC, on gates that Yosys makes of both; before that, every path through
the unit is checked to have as many registers as the latency of the unit. For the trace ports, the outputs of both cores are
compared as expressions over equal state. All other proofs are inductions with yosys-smtbmc and z3.
A proof without a decision counts as failed. Each line appears when its proof ends; the last line is the overall result.

Requires yosys and z3 (Debian: apt-get install yosys z3). One tool runs per core, at low priority.

Examples:
  dynrt prove                    everything
  dynrt prove --quick            about two minutes: some cases of the sums, all other proofs
  dynrt prove add mul            two units
  dynrt prove --plant            seeded faults instead: each proof must refute each of its faults
  dynrt prove --json proofs.json";

/// Prove properties of the generated Verilog: arithmetic, queues, protocols
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The units to prove [default: all]
    #[arg(value_name = "UNIT")]
    units: Vec<String>,
    /// Of the cases of the sums, prove only those in which the operands overlap at the rounding bits
    #[arg(long)]
    quick: bool,
    /// Check seeded faults instead: single changes of the netlist, each of which must be refuted
    #[arg(long)]
    plant: bool,
    #[command(flatten)]
    config: ConfigArgs,
    /// Write the table as JSON, when all proofs have ended
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    prove::check(&args.units)?;
    let config = args.config.load()?;
    let options = Options {
        units: args.units.clone(),
        quick: args.quick,
        plant: args.plant,
    };
    let clock = Instant::now();
    let bar = report::progress(0, "proofs");
    let mut printed = print(&format!(
        "configuration {}{}\n{:10} {:18} {:>5} {:>8}  {:9} property and method\n",
        config.name,
        args.config.settings(),
        "unit",
        "module",
        "cases",
        "seconds",
        "result"
    ));
    let rows = prove::run(
        &config,
        &options,
        &|name| {
            bar.set_message(name.to_string());
            bar.tick();
        },
        &mut |row| {
            let line = || print(&line(row));
            printed = bar.suspend(|| std::mem::replace(&mut printed, Ok(())).and_then(|()| line()));
        },
    )?;
    bar.finish_and_clear();
    printed?;
    let failed = rows.iter().filter(|row| !row.holds()).count();
    if let Some(json) = &args.json {
        let value = json!({
            "config": config.name,
            "overrides": args.config.overrides(&config),
            "quick": args.quick,
            "plant": args.plant,
            "seconds": clock.elapsed().as_secs_f64(),
            "failed": failed,
            "proofs": rows.iter().map(to_json).collect::<Vec<_>>(),
        });
        json.json(&value)?.publish()?;
    }
    let of = counted(
        rows.len() as u64,
        if args.plant { "seeded fault" } else { "proof" },
    );
    if failed > 0 {
        let wrong = if args.plant {
            "not refuted"
        } else {
            "without a proof"
        };
        bail!("{failed} of {of} {wrong}; see the table");
    }
    let seconds = clock.elapsed().as_secs_f64();
    print(&match args.plant {
        true => format!("{of}, each refuted, in {seconds:.0} s\n"),
        false => format!("{of}, all hold, in {seconds:.0} s\n"),
    })
}

fn verdict(row: &Row) -> (&'static str, Option<&str>) {
    match &row.outcome {
        Outcome::Proved => ("proved", None),
        Outcome::Refuted(text) => ("refuted", Some(text)),
        Outcome::Undecided(text) => ("undecided", Some(text)),
    }
}

fn line(row: &Row) -> String {
    let (verdict, text) = verdict(row);
    let what = match &row.fault {
        Some(fault) => format!("{}, but {fault}", row.what),
        None => row.what.clone(),
    };
    let text = text.map_or(String::new(), |text| format!("\n{:55}{text}", ""));
    format!(
        "{:10} {:18} {:>5} {:>8.1}  {verdict:9} {what} [{}]{text}\n",
        row.unit, row.module, row.cases, row.seconds, row.how
    )
}

fn to_json(row: &Row) -> Value {
    let (verdict, text) = verdict(row);
    json!({
        "unit": row.unit,
        "module": row.module,
        "what": row.what,
        "fault": row.fault,
        "how": row.how,
        "cases": row.cases,
        "seconds": row.seconds,
        "result": verdict,
        "counterexample": text,
        "holds": row.holds(),
    })
}
