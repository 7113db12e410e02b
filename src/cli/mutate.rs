//! `dynrt mutate`: mutation test of the co-simulation.

use super::files::{self, Output};
use super::{ConfigArgs, counted, print, tell};
use anyhow::{Result, ensure};
use dynrt::hw::core::PREFIX;
use dynrt::mutate::{self, Kind, Outcome, Report, Request, UNITS};
use dynrt::report;
use dynrt::text;
use serde_json::json;
use std::fmt::Write as _;

const HELP: &str = "\
Each mutant is one change of the netlist: of an operator, literal, condition, slice or reset, or a missing pipeline register. The
mutants of a unit are compiled into one model, which runs the co-simulation of the unit. Yosys checks survivors for equivalence;
the others are listed. Results are kept in the cache, so an interrupted run can be resumed.

Examples:
  dynrt mutate --mutants 600 --seed 1 --json mutants.json
  dynrt mutate --mutants 600 --seed 1 --only 217          one of these mutants again, with details
  dynrt mutate --mutants 100 --seed 7 --unit update";

/// Mutation test: change the netlist in one place, and check that co-simulation detects it
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// Number of mutants, over all five units of the core; each unit of the chip gets as many as one of these
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    mutants: u32,
    /// Random seed
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Mutate only this unit: arithmetic, tpu, geometry, update, raycast, cache, axi, combiner, arbiter, reader, cast, registers, commands or motion; may be repeated
    #[arg(long, value_name = "NAME")]
    unit: Vec<String>,
    /// Run only the mutant with this number
    #[arg(long, value_name = "K")]
    only: Option<u32>,
    /// Fail if the mutation score (killed mutants, in percent of those not proved equivalent) is below this value
    #[arg(long, value_name = "P", default_value_t = 95.0)]
    least: f64,
    #[command(flatten)]
    config: ConfigArgs,
    /// Write all mutants and their outcomes as JSON
    #[arg(long, value_name = "F", value_parser = files::Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    ensure!(
        (0.0..=100.0).contains(&args.least),
        "--least {}: give a percentage from 0 to 100",
        text::number(args.least)
    );
    let config = args.config.load()?;
    let request = Request {
        units: args.unit.clone(),
        only: args.only,
        ..Request::new(args.mutants, args.seed)
    };
    let bar = report::progress(u64::from(args.mutants), "mutants");
    // Mutants make benches panic. These panics are part of the report and are not printed.
    let hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(|_| ()));
    let found = mutate::mutate(&config, &request, &tell, &|done, total| {
        bar.set_length(total as u64);
        bar.set_position(done as u64);
    });
    std::panic::set_hook(hook);
    bar.finish_and_clear();
    let found = found?;
    if let Some(json) = &args.json {
        let value = json!({
            "configuration": config.name,
            "overrides": args.config.overrides(&config),
            "seed": found.seed,
            "drawn": found.mutants.len(),
            "remembered": found.remembered,
            "noticed": found.noticed(),
            "equivalent": found.equivalent(),
            "survived": found.survivors().count(),
            "noticed_percent": found.share_percent(),
            "mutants": found.mutants,
        });
        json.json(&value)?.publish()?;
    }
    print(&to_text(args, &found))?;
    ensure!(
        found.share_percent() >= args.least,
        "the mutation score is {:.1} %, below {} %: the survivors above are gaps in the tests",
        found.share_percent(),
        args.least
    );
    Ok(())
}

fn to_text(args: &Args, found: &Report) -> String {
    let mut text = String::new();
    for mutant in found.survivors() {
        let _ = writeln!(
            text,
            "survived  {} {} {PREFIX}{}.v:{} {}\n  before {}\n  after  {}\n  replay: dynrt mutate --mutants {} --seed {} --only {}{}",
            mutant.number,
            mutant.unit,
            mutant.module,
            mutant.line,
            mutant.kind.name(),
            mutant.before,
            mutant.after,
            args.mutants,
            args.seed,
            mutant.number,
            args.config.replay(),
        );
    }
    if args.only.is_some() {
        for mutant in &found.mutants {
            let _ = writeln!(
                text,
                "{} {PREFIX}{}.v:{}: {} → {}",
                mutant.unit, mutant.module, mutant.line, mutant.before, mutant.after
            );
            let _ = match &mutant.outcome {
                Outcome::Noticed { run, how } => writeln!(text, "killed by {run}: {how}"),
                Outcome::Equivalent { proof } => writeln!(text, "equivalent: {proof}"),
                Outcome::Survived { runs } => writeln!(text, "survives {}", runs.join(", ")),
            };
        }
    }
    let _ = writeln!(
        text,
        "{:10} {:>8} {:>8} {:>10} {:>9}",
        "", "mutants", "killed", "equivalent", "survived"
    );
    let row = |name: &str, of: &dyn Fn(&mutate::Mutant) -> bool| {
        let mutants: Vec<_> = found.mutants.iter().filter(|m| of(m)).cloned().collect();
        let part = Report {
            seed: found.seed,
            remembered: 0,
            mutants,
        };
        match part.mutants.len() {
            0 => String::new(),
            all => format!(
                "{name:10} {all:>8} {:>8} {:>10} {:>9}\n",
                part.noticed(),
                part.equivalent(),
                part.survivors().count()
            ),
        }
    };
    for unit in UNITS {
        text += &row(unit, &|mutant| mutant.unit == unit);
    }
    for kind in Kind::ALL {
        text += &row(kind.name(), &|mutant| mutant.kind == kind);
    }
    let _ = writeln!(
        text,
        "{} of seed {}, {} from earlier runs: {} killed, {} proved equivalent, {} survived; mutation score {:.1} %",
        counted(found.mutants.len() as u64, "mutant"),
        found.seed,
        found.remembered,
        found.noticed(),
        found.equivalent(),
        found.survivors().count(),
        found.share_percent()
    );
    text
}
