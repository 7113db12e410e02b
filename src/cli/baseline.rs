//! `dynrt baseline`: the regression gate; `dynrt numbers`: the page generated from its figures.

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
Measures the reference machine and compares it with the recorded figures. Cycles and counts of fixed frames and animations must be
equal; no module may use over 1 % more of any resource or become over 3 % slower; and the goals must be met: at most 35 % of the
LUT4, 60 % of the DSP48 and 40 % of the RAMB16 of an LX160, with the chip 40 %, 60 % and 55 %; 100 MHz, or 125 MHz for ecp5-85f;
every pipeline at its target clock.
Modules with unchanged Verilog are not synthesised again.

Examples:
  dynrt baseline                            cycles, and the area of the smaller modules that have changed
  dynrt baseline --all                      also the area of the larger modules (up to an hour if they have changed)
  dynrt baseline --all --configurations --chip --depths --clock     everything, with place and route from three seeds (hours)
  dynrt baseline --all --clock=changed --accept 'a stack of 24'     record the new figures and log the reason";

/// Modules above this size are skipped without `--all`: Yosys takes minutes for each.
const MOST_LUT4: u64 = 6000;

/// Units to place and route.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Which {
    All,
    Changed,
}

/// Compare cycles, area and clock with the recorded figures, or record new ones
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The file of recorded figures
    #[arg(long, value_name = "F", default_value = "docs/baseline.json")]
    file: Figures,
    /// Measure the area of every module that has changed, of any size
    #[arg(long)]
    all: bool,
    /// Measure the area of the other named configurations too
    #[arg(long)]
    configurations: bool,
    /// Measure the tables of the chip's caches and memories too
    #[arg(long)]
    chip: bool,
    /// Measure the table of pipeline depths too
    #[arg(long)]
    depths: bool,
    /// Measure the clock of the units too, with place and route from three seeds: all units, or with =changed those with changed Verilog
    #[arg(
        long,
        value_name = "WHICH",
        require_equals = true,
        num_args = 0..=1,
        default_missing_value = "all"
    )]
    clock: Option<Which>,
    /// Place and route only these of the units, such as tpu,geometry_unit; the others keep the clocks that are recorded
    #[arg(long, value_name = "U", value_delimiter = ',', requires = "clock", value_parser = clap::builder::PossibleValuesParser::new(baseline::UNITS))]
    clock_units: Vec<String>,
    /// Record the new figures, and log this reason
    #[arg(long, value_name = "WHY")]
    accept: Option<String>,
    /// Write the comparison as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    let file = args.file.path();
    if let Some(why) = &args.accept {
        let why = why.trim();
        ensure!(
            !why.is_empty() && why.lines().count() == 1,
            "--accept: give the reason for the change in one line"
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
        clock_units: args.clock_units.clone(),
        configurations: args.configurations,
        chip: args.chip,
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
            "{failed} of {} have become worse, the first is {first}; if this is intended: dynrt baseline --accept WHY",
            counted(findings.len() as u64, "figure")
        ),
    }
}

/// The log beside a file of figures.
fn log_of(file: &Path) -> PathBuf {
    file.with_extension("log.md")
}

/// Writes the new figures, and the log with the reason.
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
    // The log first: figures must never be without their reason.
    Ok([
        Staged::text(&log, &format!("{before}{entry}"))?,
        Staged::json(file, &serde_json::to_value(is)?)?,
    ])
}

const NUMBERS_HELP: &str = "\
This command measures nothing: the page shows the figures that `dynrt baseline --accept` recorded.

Examples:
  dynrt numbers                                     docs/numbers.md and its plots, from docs/baseline.json
  dynrt numbers --file my-baseline.json --out page  the same for other figures, in another folder";

/// Write the page of numbers and its plots from the recorded figures
#[derive(clap::Args)]
#[command(after_help = NUMBERS_HELP)]
pub struct NumbersArgs {
    /// The file of recorded figures
    #[arg(long, value_name = "F", default_value = "docs/baseline.json")]
    file: Figures,
    /// The folder for the page and its plots
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
