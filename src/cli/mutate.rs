//! `dynrt mutate`: whether co-simulation would notice a bug.

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
Each mutant is one change of the netlist, as its Verilog shows it: an operator, a literal, a condition, a slice, a reset, a pipeline register left out.
All of a unit's are compiled into one model, which runs what the unit's tests run. What survives is tried for equivalence by Yosys, and
listed otherwise. Results are kept in the cache: a run that was cut off goes on where it was.

Examples:
  dynrt mutate --mutants 600 --seed 1 --json mutants.json
  dynrt mutate --mutants 600 --seed 1 --only 217          one of them again, with all that is said of it
  dynrt mutate --mutants 100 --seed 7 --unit update";

/// Change the emitted Verilog in many places, one at a time, and see whether co-simulation notices
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// How many, over all units
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    mutants: u32,
    /// Of the draw; the same draws the same
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Those of one unit only: arithmetic, tpu, geometry, update or raycast; may be repeated
    #[arg(long, value_name = "NAME")]
    unit: Vec<String>,
    /// One mutant alone, by its number
    #[arg(long, value_name = "K")]
    only: Option<u32>,
    /// Fail where fewer percent of those not proved equivalent are noticed
    #[arg(long, value_name = "P", default_value_t = 95.0)]
    least: f64,
    #[command(flatten)]
    config: ConfigArgs,
    /// Every mutant and what became of it, as JSON
    #[arg(long, value_name = "F", value_parser = files::Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    ensure!(
        (0.0..=100.0).contains(&args.least),
        "--least {}: give a share from 0 to 100 percent",
        text::number(args.least)
    );
    let config = args.config.load()?;
    let request = Request {
        units: args.unit.clone(),
        only: args.only,
        ..Request::new(args.mutants, args.seed)
    };
    let bar = report::progress(u64::from(args.mutants), "mutants");
    // A bench that a mutant breaks says so by a panic, of which there are many: that they happened is in the report.
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
        "{:.1} % of the mutants that are not equivalent were noticed, not {} %: the survivors above are gaps of the tests",
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
            "survived  {} {} {PREFIX}{}.v:{} {}\n  before {}\n  after  {}\n  again: dynrt mutate --mutants {} --seed {} --only {}{}",
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
                Outcome::Noticed { run, how } => writeln!(text, "noticed by {run}: {how}"),
                Outcome::Equivalent { proof } => writeln!(text, "equivalent: {proof}"),
                Outcome::Survived { runs } => writeln!(text, "survives {}", runs.join(", ")),
            };
        }
    }
    let _ = writeln!(
        text,
        "{:10} {:>8} {:>8} {:>10} {:>9}",
        "", "mutants", "noticed", "equivalent", "survived"
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
        "{} of seed {}, {} known from before: {} noticed, {} proved equivalent, {} survived: {:.1} % of those not equivalent are noticed",
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
