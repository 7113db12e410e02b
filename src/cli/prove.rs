//! `dynrt prove`: proofs about the emitted Verilog.

use super::files::{Kind, Output};
use super::{ConfigArgs, counted, print};
use anyhow::{Result, bail};
use dynrt::prove::{self, Options, Outcome, Row};
use dynrt::report;
use serde_json::{Value, json};
use std::time::Instant;

const HELP: &str = "\
Units:
  add, sub, mul     the result is the exact one, rounded once, for all operands, specials included
  reciprocal        the same; every operand is tried on the gates
  compare, step     less, less or equal, equal, min, max; steps of three ulps
  slots             the triangle test: own slots and borrowed ones never meet
  fifo, prefetch    every queue and every reader ahead of the machine: order, no loss, no duplicate, no overflow
  credit            the update processor: credits are what they stand for, ports keep what they show, nothing locks up
  skin, geometry    the skinning processor, the geometry unit: the same of vertices, meshes, leaves and rays
  tpu, stack        packets are neither lost nor doubled, no queue overflows; a pop reads what the push wrote
  share             the ray casting unit: packet numbers, tags, who has the geometry unit and its port to memory
  trace             the core without trace ports is the core with them, but for these ports

Arithmetic is compared with a reference of its own by ABC, on gates that Yosys makes of both, once every path through the
unit has been seen to have as many registers as its latency says. With and without trace ports, outputs are compared as
expressions over equal state. The rest is proved by induction with yosys-smtbmc and z3.
A proof that a tool leaves undecided has failed. Lines appear as proofs end; the last one says whether all hold.

Needs yosys and z3 (Debian: apt-get install yosys z3). A tool runs on each core, at low priority.

Examples:
  dynrt prove                    everything
  dynrt prove --quick            what takes about two minutes: some of the sums' cases, all else whole
  dynrt prove add mul            two units
  dynrt prove --plant            instead, seeded faults: each proof must refute each of its own
  dynrt prove --json proofs.json";

/// Prove the arithmetic, the queues and the ports of the emitted Verilog
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// What to prove; all units if none is named
    #[arg(value_name = "UNIT")]
    units: Vec<String>,
    /// Of the sums' cases only those where the operands meet at the rounding bits
    #[arg(long)]
    quick: bool,
    /// Instead, seeded faults: changes of the netlist, one at a time; each must be refuted
    #[arg(long)]
    plant: bool,
    #[command(flatten)]
    config: ConfigArgs,
    /// The table, as JSON; written only when every proof has ended
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
        "configuration {}{}\n{:10} {:18} {:>5} {:>8}  {:9} what, and how\n",
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
