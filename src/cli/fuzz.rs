//! `dynrt fuzz`: tests of random machines: generation, lint, co-simulation.

use super::files::{Kind, Output};
use super::{counted, grouped, print};
use anyhow::{Result, bail};
use dynrt::emit;
use dynrt::fuzz::{
    Case, Event, Failed, Failure, Options, Passed, Report, Size, Stage, Workbench, run,
};
use dynrt::report;
use serde_json::{Map, Value, json};
use std::time::Instant;

const HELP: &str = "\
Every configuration key has a random value within its range. Each machine is generated, linted with verilator -Wall,
iverilog -g2001 and yosys, and co-simulated with the golden model, with comparison of all bits: traversal unit, geometry unit,
update processor and skinning processor alone, the ray casting unit on two-level scenes, and the whole machine on an animated
scene. The scenes include degenerate, thin, coincident and axis-parallel triangles, and rotated, mirrored and flattened instances.

Machine number K of seed S is the first machine of seed S + K. The first failure ends the run and is reported with the command that
replays it. The failing case is then shrunk to the simplest one that fails in the same stage: key by key towards the reference
machine, and by halves towards a smaller scene; the command for this case is printed as well. Machines that pass are recorded in
the cache by their Verilog and scene, so an interrupted run can be resumed.

Requires verilator, iverilog, yosys and g++. One machine takes about 30 seconds on two cores.

Examples:
  dynrt fuzz                                       ten machines with a new seed
  dynrt fuzz --machines 200 --seed 1 --json F      the same 200 machines every time
  dynrt fuzz --machines 1 --seed 27 --list         print the machine of this seed, without checks
  dynrt fuzz --config tiny --machines 5            one machine, five random scenes
  dynrt fuzz --seed 1 --stage lint --machines 500  some stages only";

/// Generate, lint and co-simulate random machines
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// Number of machines
    #[arg(long, value_name = "N", default_value_t = 10, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    machines: u32,
    /// Random seed of the first machine; it increases by one per machine [default: a new seed, which is printed]
    #[arg(long, value_name = "S")]
    seed: Option<u64>,
    /// Run only this stage; may be repeated [default: all]
    #[arg(long, value_name = "STAGE")]
    stage: Vec<Stage>,
    /// Check this machine instead of random ones: the name of a configuration or a TOML file
    #[arg(long, value_name = "C")]
    config: Option<super::ConfigName>,
    /// Set one key of --config, such as packets.rays=8; may be repeated
    #[arg(long, value_name = "SECTION.KEY=VALUE", requires = "config")]
    set: Vec<String>,
    /// Set one size of the workload: objects, triangles, instances, frames, packets or transactions
    #[arg(long, value_name = "NAME=N")]
    size: Vec<String>,
    /// Check machines again even if they passed in an earlier run
    #[arg(long)]
    again: bool,
    /// Maximum number of attempts to shrink a failing case
    #[arg(long, value_name = "N", default_value_t = 80)]
    shrink: usize,
    /// Print the machines without checks
    #[arg(long, conflicts_with = "json")]
    list: bool,
    /// Write the results per machine as JSON, at the end or after a failure
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

impl Args {
    fn options(&self) -> Result<Options> {
        let seed = self.seed.unwrap_or_else(|| fastrand::u64(..1 << 32));
        let mut options = Options::new(seed, self.machines);
        if !self.stage.is_empty() {
            options.stages.clone_from(&self.stage);
        }
        if let Some(config) = &self.config {
            let chosen = super::ConfigArgs {
                config: config.clone(),
                set: self.set.clone(),
            };
            options.config = Some(chosen.load()?);
        }
        options.sizes.clone_from(&self.size);
        options.again = self.again;
        options.shrink_attempts = self.shrink;
        Ok(options)
    }
}

pub fn run_fuzz(args: &Args) -> Result<()> {
    let options = args.options()?;
    // An invalid size is reported before any other output.
    let cases = options.cases()?;
    print(&format!(
        "{} from seed {}\n",
        counted(options.machines.into(), "machine"),
        options.seed
    ))?;
    if args.list {
        return cases.iter().try_for_each(|case| print(&line(case)));
    }
    let bar = report::progress(options.machines.into(), "machines");
    let started = Instant::now();
    let bench = Workbench::new()?;
    let mut printed = Ok(());
    let report = run(&bench, &options, &mut |event| match event {
        Event::Enters(number, case, stage) => {
            bar.set_message(format!("seed {}: {}", case.seed, stage.name()));
            bar.set_position(number.into());
        }
        Event::Passed(number, passed) => {
            bar.set_position(u64::from(number) + 1);
            let text = line_of(passed);
            bar.suspend(|| {
                if printed.is_ok() {
                    printed = print(&text);
                }
            });
        }
        Event::Failed(_, case, failure) => bar.suspend(|| {
            let text = format!("{}{}", line(case), why("it fails", case, failure));
            if printed.is_ok() {
                printed = print(&text);
            }
        }),
        Event::Shrinks(attempts, _) => {
            bar.set_message(format!(
                "shrinking: {attempts} of {}",
                options.shrink_attempts
            ));
            bar.tick();
        }
    })?;
    bar.finish_and_clear();
    printed?;
    let seconds = started.elapsed().as_secs_f64();
    if let Some(json) = &args.json {
        json.json(&to_json(&options, &report, seconds))?.publish()?;
    }
    let summary = Stage::ALL
        .into_iter()
        .filter(|stage| options.stages.contains(stage))
        .map(|stage| format!("{} {}", stage.name(), grouped(report.checked_in(stage))))
        .collect::<Vec<_>>()
        .join(", ");
    if let Some(failed) = &report.failed {
        print(&format!(
            "shrunk in {} to\n  {}\n",
            counted(failed.attempts as u64, "attempt"),
            failed.shrunk.command(Some(failed.shrunk_failure.stage))
        ))?;
        if failed.shrunk_failure != failed.failure {
            print(&indented(&failed.shrunk_failure.message))?;
        }
        bail!(
            "the machine of seed {} fails in stage {}, after {} that passed; replay it with {}",
            failed.case.seed,
            failed.failure.stage.name(),
            counted(report.passed.len() as u64, "machine"),
            failed.case.command(Some(failed.failure.stage))
        );
    }
    let remembered = report.passed.iter().filter(|p| p.remembered).count();
    let before = match remembered {
        0 => String::new(),
        some => format!(" ({some} in earlier runs; --again checks them again)"),
    };
    print(&format!(
        "{} passed{before}, {} results compared: {summary}; in {seconds:.0} s\n",
        counted(report.passed.len() as u64, "machine"),
        grouped(report.checked()),
    ))
}

/// A machine as a list of settings.
fn line(case: &Case) -> String {
    let settings = case.settings();
    let settings: Vec<String> = settings.iter().map(|s| format!("--set {s}")).collect();
    format!("seed {}: {}\n", case.seed, settings.join(" "))
}

fn line_of(passed: &Passed) -> String {
    let results: u64 = passed.checked.iter().map(|checked| checked.count).sum();
    let when = match passed.remembered {
        true => "passed in an earlier run".to_string(),
        false => format!("passed in {:.1} s", passed.seconds),
    };
    format!(
        "{}  {when}, {}\n",
        line(&passed.case),
        counted(results, "result")
    )
}

fn why(what: &str, case: &Case, failure: &Failure) -> String {
    format!(
        "{what} in stage {}; replay with\n  {}\n{}",
        failure.stage.name(),
        case.command(Some(failure.stage)),
        indented(&failure.message)
    )
}

fn indented(text: &str) -> String {
    text.lines().map(|line| format!("    {line}\n")).collect()
}

fn to_json(options: &Options, report: &Report, seconds: f64) -> Value {
    let stages: Map<String, Value> = Stage::ALL
        .into_iter()
        .filter(|stage| options.stages.contains(stage))
        .map(|stage| (stage.name().into(), json!(report.checked_in(stage))))
        .collect();
    json!({
        "seed": options.seed,
        "asked": options.machines,
        "passed": report.passed.len(),
        "failed": u32::from(report.failed.is_some()),
        "checked": stages,
        "seconds": seconds,
        "machines": report.passed.iter().map(machine_json).collect::<Vec<_>>(),
        "failure": report.failed.as_ref().map(failed_json),
    })
}

fn sizes_json(case: &Case) -> Value {
    let size = |size: Size| (size.name().to_string(), json!(case.sizes.get(size)));
    Value::Object(Size::ALL.into_iter().map(size).collect())
}

fn machine_json(passed: &Passed) -> Value {
    let checked: Map<String, Value> = (passed.checked.iter())
        .map(|checked| (checked.stage.name().into(), json!(checked.count)))
        .collect();
    json!({
        "seed": passed.case.seed,
        "config": emit::configuration(&passed.case.config),
        "sizes": sizes_json(&passed.case),
        "checked": checked,
        "seconds": passed.seconds,
        "remembered": passed.remembered,
    })
}

fn failed_json(failed: &Failed) -> Value {
    let one = |case: &Case, failure: &Failure| {
        json!({
            "seed": case.seed,
            "config": emit::configuration(&case.config),
            "sizes": sizes_json(case),
            "stage": failure.stage.name(),
            "message": failure.message,
            "command": case.command(Some(failure.stage)),
        })
    };
    json!({
        "machine": one(&failed.case, &failed.failure),
        "shrunk": one(&failed.shrunk, &failed.shrunk_failure),
        "attempts": failed.attempts,
    })
}
