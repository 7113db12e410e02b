//! Parses nextpnr's report: the clock reached, and the critical path, with the names of our modules.

use super::wrapper;
use crate::hdl::Module;
use anyhow::{Context, Result};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::fmt;

/// The timing of a placed and routed module.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Timing {
    /// The fastest clock.
    pub mhz: f64,
    pub critical_path: CriticalPath,
}

/// The slowest path between two registers.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CriticalPath {
    /// The start of the path.
    pub from: Point,
    /// The signals on the path that have a name in the Verilog.
    pub through: Vec<Point>,
    /// The end of the path.
    pub to: Point,
    /// Delay of the logic in ns, including the delays of the registers.
    pub logic_ns: f64,
    /// Delay of the wires in ns.
    pub routing_ns: f64,
}

/// A signal of one of our modules, with its position below the routed module.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Point {
    /// Names of the instances from the routed module down, joined by dots; empty in the routed module itself.
    pub instance: String,
    /// The module that contains the signal.
    pub module: String,
    /// The signal, or `inputs` or `outputs` for the registers around the routed module.
    pub signal: String,
}

impl fmt::Display for Point {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.instance.as_str() {
            "" => write!(f, "{}", self.signal),
            instance => write!(f, "{instance}.{}", self.signal),
        }
    }
}

impl fmt::Display for CriticalPath {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} → {}", self.from, self.to)?;
        let deepest = (self.through.iter().chain([&self.from, &self.to])).max_by_key(|point| {
            point.instance.split('.').count() * usize::from(!point.instance.is_empty())
        });
        match deepest.filter(|point| !point.instance.is_empty()) {
            Some(point) => write!(f, " ({})", point.module),
            None => Ok(()),
        }
    }
}

/// The clock and its critical path, from the output of nextpnr's `--report` for a wrapped `module`.
///
/// # Errors
/// If the text is not such a report, if it is incomplete, or if it has no path between registers.
pub fn parse_timing(report: &str, module: &Module) -> Result<Timing> {
    const WHAT: &str = "nextpnr has written no whole report of its timing";
    let report: Value = serde_json::from_str(report).context(WHAT)?;
    let clocks = report["fmax"].as_object().context(WHAT)?;
    let (clock, figures) = clocks.iter().next().context(WHAT)?;
    let mhz = figures["achieved"].as_f64().context(WHAT)?;
    let edge = format!("posedge {clock}");
    let paths = report["critical_paths"].as_array().context(WHAT)?;
    let path = (paths.iter())
        .find(|path| path["from"] == edge.as_str() && path["to"] == edge.as_str())
        .context(WHAT)?;
    let segments = path["path"].as_array().context(WHAT)?;
    let cell = |segment: Option<&Value>, end: &str| {
        let name = segment?[end]["cell"].as_str()?;
        Some(point(module, name))
    };
    let from = cell(segments.first(), "from").context(WHAT)?;
    let to = cell(segments.last(), "to").context(WHAT)?;
    let mut through: Vec<Point> = vec![];
    let (mut logic_ns, mut routing_ns) = (0.0, 0.0);
    for segment in segments {
        let delay = segment["delay"].as_f64().context(WHAT)?;
        if segment["type"] != "routing" {
            logic_ns += delay;
            continue;
        }
        routing_ns += delay;
        let net = segment["net"].as_str().context(WHAT)?;
        let passed = point(module, net);
        if passed != from && passed != to && through.last() != Some(&passed) {
            through.push(passed);
        }
    }
    let picoseconds = |ns: f64| (ns * 1000.0).round() / 1000.0;
    Ok(Timing {
        mhz: (mhz * 100.0).round() / 100.0,
        critical_path: CriticalPath {
            from,
            through,
            to,
            logic_ns: picoseconds(logic_ns),
            routing_ns: picoseconds(routing_ns),
        },
    })
}

/// Suffixes that Yosys appends to a signal's name for the cells and wires around it.
const SUFFIXES: [&str; 9] = [
    "_TRELLIS_",
    "_LUT4_",
    "_CCU2C_",
    "_PFUMX_",
    "_L6MUX21_",
    "_MULT18X18D",
    "_DP16KD",
    "_PDPW16KD",
    "$",
];

/// The signal to which a flattened cell or net belongs, or after which it is named.
fn point(module: &Module, flat: &str) -> Point {
    let cut = (SUFFIXES.iter())
        .filter_map(|suffix| flat.find(suffix))
        .min()
        .unwrap_or(flat.len());
    let name = flat[..cut].split('[').next().unwrap_or_default();
    let mut parts = name.split('.').peekable();
    let mut point = Point {
        instance: String::new(),
        module: super::unit_name(module).to_string(),
        signal: match parts.next() {
            Some(wrapper::INSTANCE) => String::new(),
            Some(wrapper::STIMULUS) => "inputs".into(),
            Some(wrapper::CAPTURED) => "outputs".into(),
            _ => name.to_string(),
        },
    };
    if !point.signal.is_empty() {
        return point;
    }
    let mut within = module;
    while let Some(part) = parts.peek() {
        let Some(instance) = (within.instances().into_iter()).find(|i| i.name() == *part) else {
            break;
        };
        if !point.instance.is_empty() {
            point.instance.push('.');
        }
        point.instance.push_str(part);
        within = instance.module();
        parts.next();
    }
    point.module = super::unit_name(within).to_string();
    // The cells of a memory are numbered after a dot.
    point.signal = parts.next().unwrap_or("(unnamed)").to_string();
    point
}
