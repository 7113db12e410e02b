//! `dynrt baseline`: the ratchet; `dynrt numbers`: the page made of it.

use super::files::{Figures, Kind, Output};
use super::{counted, print, tell};
use anyhow::{Context, Result, bail, ensure};
use dynrt::baseline::{self, Baseline, Clocks, LOG_HEAD, Request, Verdict, page};
use dynrt::report::{self, Staged};
use dynrt::text;
use serde_json::json;
use std::fmt::Write as _;
use std::path::{Path, PathBuf};

const HELP: &str = "\
Measures the reference machine and compares: clocks and counts of fixed frames and films must be the same, no module may take more than
1 % more of anything, none may become more than 3 % slower, and what the machine must reach (at most 35 % of an LX160's LUT4, 60 % of
its DSP48, 40 % of its RAMB16; 100 MHz, ecp5-85f 125 MHz; a pipeline the clock it is made for) it must reach still. A module whose Verilog has not changed is not synthesised again.

Examples:
  dynrt baseline                            clocks, and the area of the smaller modules that have changed
  dynrt baseline --all                      the area of the larger ones too: up to an hour where they have changed
  dynrt baseline --all --configurations --depths --clock     everything, placed and routed from three seeds: hours
  dynrt baseline --all --clock=changed --accept 'a stack of 24'     take the figures as they are now, and log why";

/// Larger modules are left out without `--all`: Yosys takes minutes for them.
const MOST_LUT4: u64 = 6000;

/// Units to place and route.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Which {
    All,
    Changed,
}

/// Compare what the machine costs with what is checked in, or accept what it costs now
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The checked-in figures
    #[arg(long, value_name = "F", default_value = "docs/baseline.json")]
    file: Figures,
    /// The area of every module that has changed, however large
    #[arg(long)]
    all: bool,
    /// The area of the other named configurations too
    #[arg(long)]
    configurations: bool,
    /// The table of depths too
    #[arg(long)]
    depths: bool,
    /// The clocks of the units too, placed and routed from three seeds: of all, or with =changed of those whose Verilog has changed
    #[arg(
        long,
        value_name = "WHICH",
        require_equals = true,
        num_args = 0..=1,
        default_missing_value = "all"
    )]
    clock: Option<Which>,
    /// Write the figures as they are now, and why, into the log beside them
    #[arg(long, value_name = "WHY")]
    accept: Option<String>,
    /// The comparison, as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    let file = args.file.path();
    if let Some(why) = &args.accept {
        let why = why.trim();
        ensure!(
            !why.is_empty() && why.lines().count() == 1,
            "--accept: say in one line why the figures may change"
        );
        report::check_writable(file)?;
        let log = log_of(file);
        if let Some(json) = &args.json {
            ensure!(
                !report::is_same_file(json.path(), &log),
                "{json}: is the log of the figures; give the output another name"
            );
        }
    }
    let was = match (&args.accept, file.exists()) {
        (Some(_), false) => Baseline::default(),
        _ => Baseline::read(file)?,
    };
    let request = Request {
        most_lut4: (!args.all && args.accept.is_none()).then_some(MOST_LUT4),
        clocks: match args.clock {
            None => Clocks::None,
            Some(Which::Changed) => Clocks::Changed,
            Some(Which::All) => Clocks::All,
        },
        configurations: args.configurations,
        depths: args.depths,
        cache: None,
    };
    let (is, kept) = baseline::measure(&was, &request, &tell)?;
    let findings = baseline::compare(&was, &is, &kept);
    ensure!(!findings.is_empty(), "nothing was compared");
    let count = |verdict| findings.iter().filter(|f| f.verdict == verdict).count();
    let failed = count(Verdict::Fails);
    let mut files = vec![];
    if let Some(json) = &args.json {
        let value = json!({
            "checked": findings.len(),
            "failed": failed,
            "kept": kept.len(),
            "findings": findings,
            "figures": is,
        });
        files.push(json.json(&value)?);
    }
    if let Some(why) = &args.accept {
        files.extend(accept(file, why.trim(), &is, &findings)?);
    }
    report::publish_all(files)?;
    if args.accept.is_some() {
        return print(&format!(
            "{}: {} written; make numbers refreshes the page\n",
            text::path(file),
            counted(findings.len() as u64, "figure")
        ));
    }
    let mut lines = String::new();
    for finding in &findings {
        let word = match finding.verdict {
            Verdict::Fails => "FAILS",
            Verdict::Kept => "later",
            Verdict::Holds if finding.was != finding.is => "moved",
            Verdict::Holds | Verdict::Reached => continue,
        };
        let _ = writeln!(lines, "{word}  {finding}");
    }
    let _ = writeln!(lines, "{} goals reached", count(Verdict::Reached));
    let _ = writeln!(
        lines,
        "{} compared with {}, {failed} fail, {} not measured now",
        counted(findings.len() as u64, "figure"),
        text::path(file),
        kept.len()
    );
    print(&lines)?;
    match findings.iter().find(|f| f.verdict == Verdict::Fails) {
        None => Ok(()),
        Some(first) => bail!(
            "{failed} of {} have changed for the worse, the first {first}; if that is meant: dynrt baseline --accept WHY",
            counted(findings.len() as u64, "figure")
        ),
    }
}

/// The log beside a file of figures.
fn log_of(file: &Path) -> PathBuf {
    file.with_extension("log.md")
}

/// The figures as they are now, and the log with the reason.
fn accept(
    file: &Path,
    why: &str,
    is: &Baseline,
    findings: &[baseline::Finding],
) -> Result<[Staged; 2]> {
    let log = log_of(file);
    let before = match log.exists() {
        true => std::fs::read_to_string(&log)
            .with_context(|| format!("{}: cannot be read", text::path(&log)))?,
        false => LOG_HEAD.to_string(),
    };
    let entry = baseline::log_entry(why, findings);
    // The log first: figures without their reason would look as if they had always been so.
    Ok([
        Staged::text(&log, &format!("{before}{entry}"))?,
        Staged::json(file, &serde_json::to_value(is)?)?,
    ])
}

const NUMBERS_HELP: &str = "\
Measures nothing: what the page says is what `dynrt baseline --accept` has measured.

Examples:
  dynrt numbers                                     docs/numbers.md and its plots, from docs/baseline.json
  dynrt numbers --file my-baseline.json --out page  those of other figures, in a folder of their own";

/// Write the page of numbers and its plots from the checked-in figures
#[derive(clap::Args)]
#[command(after_help = NUMBERS_HELP)]
pub struct NumbersArgs {
    /// The checked-in figures
    #[arg(long, value_name = "F", default_value = "docs/baseline.json")]
    file: Figures,
    /// The folder of page and plots
    #[arg(long, value_name = "DIR", default_value = "docs", value_parser = Kind::Files)]
    out: Output,
}

pub fn numbers(args: &NumbersArgs) -> Result<()> {
    let files = page::files(&Baseline::read(args.file.path())?)?;
    args.out.texts(&files)?;
    print(&format!(
        "{}: {} written\n",
        args.out,
        counted(files.len() as u64, "file")
    ))
}
