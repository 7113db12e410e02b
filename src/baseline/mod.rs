//! The regression gate: compares area, clock and cycle counts of the reference machine with the figures checked in
//! under `docs/`.
//!
//! | figure | passes if |
//! |---|---|
//! | cycles and counts of fixed frames and films, of the reference machine and of [`FAST`], and of the chip | they are exactly equal |
//! | area of each module | it grows by at most 1 %; a module with unchanged Verilog is not synthesised |
//! | clock of each unit, placed and routed | the worst seed is at most 3 % slower |
//!
//! [`page`] generates the page of numbers and its plots from the same figures.

mod measure;
pub mod page;
mod plots;

pub use measure::{Clocks, Request, UNITS, measure};

use crate::synth::{Area, Target};
use anyhow::{Context, Result, anyhow};
use serde::{Deserialize, Serialize};
use std::fmt::{self, Write as _};
use std::path::Path;

/// Figures of the reference machine and of some others.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Baseline {
    /// The configuration of units, frames and films, unless a field says otherwise.
    pub machine: String,
    /// Whole pictures in the ray casting unit.
    pub frames: Vec<FrameFigures>,
    /// Animated scenes in all units.
    pub films: Vec<FilmFigures>,
    /// The same frames on the configuration [`FAST`], whose pipelines are deeper.
    pub fast_frames: Vec<FrameFigures>,
    pub fast_films: Vec<FilmFigures>,
    /// Pictures whose rays the chip of the reference machine casts from memory.
    pub chip_frames: Vec<ChipFigures>,
    /// The same for larger pictures behind each model of memory, and with caches of each size.
    pub chip_memories: Vec<ChipFigures>,
    pub chip_caches: Vec<ChipFigures>,
    /// Fingerprint of the chip with which these two tables were measured.
    pub chip_verilog: String,
    /// Versions of the tools that measured area.
    pub area_tools: Vec<String>,
    /// Area on a Virtex-4 LX160: every module, the whole machine last.
    pub area: Vec<UnitArea>,
    /// Area of the chip's modules around the core, the whole chip last.
    pub chip_area: Vec<UnitArea>,
    /// Versions of the tools that placed and routed.
    pub clock_tools: Vec<String>,
    /// Clock on an ECP5-85F, speed grade 6: the worst of [`SEEDS`] seeds.
    pub clock: Vec<UnitClock>,
    /// The same for the configuration [`FAST`].
    pub fast_clock: Vec<UnitClock>,
    /// Area of all named configurations.
    pub configurations: Vec<ConfigurationArea>,
    /// Area and clock of units with several clock targets.
    pub depths: Vec<Depth>,
}

/// Number of seeds with which each module is placed and routed.
pub const SEEDS: u32 = 3;

/// The configuration for the fastest clock.
pub const FAST: &str = "ecp5-85f";

/// A picture whose rays were all cast in the RTL.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameFigures {
    pub scene: String,
    /// `inside`, `outside` or `framing`.
    pub view: String,
    pub size: String,
    pub rays: u64,
    /// From the first ray accepted to the last hit.
    pub cycles: u64,
    pub packet_steps: u64,
    pub ray_triangle_tests: u64,
    /// Packet steps per cycle.
    pub tpu_utilisation: f64,
    /// Used slots of the triangle test per cycle.
    pub gu_utilisation: f64,
    /// Cycles per interval of the following fields.
    pub interval_cycles: u64,
    /// `tpu_utilisation` of each interval.
    pub tpu_by_interval: Vec<f64>,
    /// `gu_utilisation` of each interval.
    pub gu_by_interval: Vec<f64>,
}

/// A picture whose rays the chip cast from memory.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ChipFigures {
    pub scene: String,
    /// As in [`FrameFigures`].
    pub view: String,
    pub size: String,
    /// `primary`, `shadow` or `diffuse`.
    pub ray_kind: String,
    /// The model of memory.
    pub memory: String,
    /// Sizes of the caches.
    pub nodes_kib: u32,
    pub records_kib: u32,
    pub vertices_kib: u32,
    /// Active rays.
    pub rays: u64,
    pub hits: u64,
    /// In casts.
    pub cycles: u64,
    pub bytes_read: u64,
    pub bytes_written: u64,
    /// Hits ÷ requests of each cache.
    pub node_hit_rate: f64,
    pub record_hit_rate: f64,
    pub vertex_hit_rate: f64,
}

/// Frames of an animated scene, with every stage run in RTL.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FilmFigures {
    pub scene: String,
    pub size: String,
    pub frames: u64,
    pub rays: u64,
    pub skinning_cycles: u64,
    pub influences: u64,
    pub update_cycles: u64,
    pub instructions: u64,
    pub triangles: u64,
    pub nodes_written: u64,
    pub raycast_cycles: u64,
}

/// The area of a module, including everything below it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitArea {
    pub name: String,
    /// See [`crate::synth::fingerprint`].
    pub verilog: String,
    #[serde(flatten)]
    pub area: Area,
}

/// The clock of a module, placed and routed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct UnitClock {
    pub name: String,
    pub verilog: String,
    /// The worst seed's clock.
    pub mhz: f64,
    /// Start and end of the slowest path, with the Verilog's names.
    pub critical_path: String,
}

/// The area of a named configuration's machine on a Virtex-4.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ConfigurationArea {
    pub name: String,
    /// Its clock target.
    pub clock_mhz: u32,
    pub verilog: String,
    #[serde(flatten)]
    pub area: Area,
}

/// A unit with one clock target, on an ECP5-85F with one seed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Depth {
    pub unit: String,
    /// The clock target.
    pub asked_mhz: u32,
    /// Pipeline registers from its inputs to its outputs.
    pub depth: u32,
    #[serde(flatten)]
    pub area: Area,
    pub mhz: f64,
}

/// Result of a comparison with the checked-in figure.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// Within the allowed change.
    Holds,
    /// Different although it must be equal, or worse than allowed.
    Fails,
    /// Not measured in this run; the old figure is kept.
    Kept,
    /// A goal that is reached.
    Reached,
}

/// A figure and its checked-in value.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// The module or picture, and the name of the figure.
    pub figure: String,
    pub was: String,
    pub is: String,
    pub verdict: Verdict,
}

impl fmt::Display for Finding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Finding {
            figure, was, is, ..
        } = self;
        match self.verdict {
            Verdict::Kept => write!(f, "{figure}: {was}, not measured now: {is}"),
            _ if was == is => write!(f, "{figure}: {is}"),
            _ => write!(f, "{figure}: {was} → {is}"),
        }
    }
}

/// Printed for a figure that does not exist.
const NOTHING: &str = "nothing";

/// Allowed growth of a module's area, as a fraction.
const AREA_SLACK: f64 = 0.01;

/// Allowed loss of clock, as a fraction: place and route of the same netlist varies by about as much.
const CLOCK_SLACK: f64 = 0.03;

/// Maximum shares of an LX160.
#[derive(Clone, Copy)]
struct Shares {
    lut4: f64,
    dsp: f64,
    ram: f64,
}

/// The core leaves room for a second traversal unit, the chip for a shading processor.
const CORE_GOAL: Shares = Shares {
    lut4: 0.35,
    dsp: 0.60,
    ram: 0.40,
};
const CHIP_GOAL: Shares = Shares {
    lut4: 0.40,
    dsp: 0.60,
    ram: 0.55,
};

/// The minimum clock of each unit in MHz, for the reference machine (the original had 66 MHz) and for [`FAST`].
const CLOCK_GOAL: f64 = 100.0;
const FAST_CLOCK_GOAL: f64 = 125.0;

impl Baseline {
    /// Reads a checked-in file.
    ///
    /// # Errors
    /// One line with the file and the remedy if it cannot be read or has another format.
    pub fn read(path: &Path) -> Result<Baseline> {
        let shown = path.display();
        let text = std::fs::read_to_string(path).map_err(|error| {
            anyhow!("{shown}: {error}; run this in a checkout, give --file, or make one: dynrt baseline --accept \"the first\" --configurations --depths --clock")
        })?;
        serde_json::from_str(&text).with_context(|| {
            format!("{shown}: is not a baseline of this version; restore it from the repository, or remove it and create a new one")
        })
    }
}

/// A named group of figures.
trait Figures {
    fn name(&self) -> String;
    /// The names and values of the figures, and the allowed changes.
    fn values(&self) -> Vec<(&'static str, f64, Rule)>;
}

impl Figures for FrameFigures {
    fn name(&self) -> String {
        format!("{} {} {}", self.scene, self.view, self.size)
    }
    fn values(&self) -> Vec<(&'static str, f64, Rule)> {
        vec![
            ("rays", self.rays as f64, Rule::Same),
            ("cycles", self.cycles as f64, Rule::Same),
            ("packet_steps", self.packet_steps as f64, Rule::Same),
            (
                "ray_triangle_tests",
                self.ray_triangle_tests as f64,
                Rule::Same,
            ),
            ("tpu_utilisation", self.tpu_utilisation, Rule::Same),
            ("gu_utilisation", self.gu_utilisation, Rule::Same),
        ]
    }
}

impl Figures for ChipFigures {
    fn name(&self) -> String {
        let ChipFigures {
            scene,
            view,
            size,
            ray_kind,
            memory,
            nodes_kib,
            records_kib,
            vertices_kib,
            ..
        } = self;
        format!(
            "chip {scene} {view} {size}, {ray_kind} rays, {memory}, {nodes_kib}/{records_kib}/{vertices_kib} KiB"
        )
    }
    fn values(&self) -> Vec<(&'static str, f64, Rule)> {
        vec![
            ("rays", self.rays as f64, Rule::Same),
            ("hits", self.hits as f64, Rule::Same),
            ("cycles", self.cycles as f64, Rule::Same),
            ("bytes_read", self.bytes_read as f64, Rule::Same),
            ("bytes_written", self.bytes_written as f64, Rule::Same),
            ("node_hit_rate", self.node_hit_rate, Rule::Same),
            ("record_hit_rate", self.record_hit_rate, Rule::Same),
            ("vertex_hit_rate", self.vertex_hit_rate, Rule::Same),
        ]
    }
}

impl Figures for FilmFigures {
    fn name(&self) -> String {
        format!("{} {} frames {}", self.scene, self.frames, self.size)
    }
    fn values(&self) -> Vec<(&'static str, f64, Rule)> {
        vec![
            ("rays", self.rays as f64, Rule::Same),
            ("skinning_cycles", self.skinning_cycles as f64, Rule::Same),
            ("influences", self.influences as f64, Rule::Same),
            ("update_cycles", self.update_cycles as f64, Rule::Same),
            ("instructions", self.instructions as f64, Rule::Same),
            ("triangles", self.triangles as f64, Rule::Same),
            ("nodes_written", self.nodes_written as f64, Rule::Same),
            ("raycast_cycles", self.raycast_cycles as f64, Rule::Same),
        ]
    }
}

fn area_values(area: Area) -> Vec<(&'static str, f64, Rule)> {
    let more = Rule::AtMost(AREA_SLACK);
    vec![
        ("lut4", area.lut4 as f64, more),
        ("ff", area.ff as f64, more),
        ("dsp", area.dsp as f64, more),
        ("ram", area.ram as f64, more),
    ]
}

impl Figures for UnitArea {
    fn name(&self) -> String {
        self.name.clone()
    }
    fn values(&self) -> Vec<(&'static str, f64, Rule)> {
        area_values(self.area)
    }
}

impl Figures for ConfigurationArea {
    fn name(&self) -> String {
        format!("configuration {}", self.name)
    }
    fn values(&self) -> Vec<(&'static str, f64, Rule)> {
        area_values(self.area)
    }
}

impl Figures for UnitClock {
    fn name(&self) -> String {
        self.name.clone()
    }
    fn values(&self) -> Vec<(&'static str, f64, Rule)> {
        vec![("mhz", self.mhz, Rule::AtLeast(CLOCK_SLACK))]
    }
}

impl Figures for Depth {
    fn name(&self) -> String {
        format!("{} made for {} MHz", self.unit, self.asked_mhz)
    }
    fn values(&self) -> Vec<(&'static str, f64, Rule)> {
        let mut values = vec![
            ("depth", f64::from(self.depth), Rule::AtMost(0.0)),
            ("mhz", self.mhz, Rule::AtLeast(CLOCK_SLACK)),
        ];
        values.extend(area_values(self.area));
        values
    }
}

/// The allowed change of a figure.
#[derive(Clone, Copy)]
enum Rule {
    Same,
    AtMost(f64),
    AtLeast(f64),
}

impl Rule {
    fn holds(self, was: f64, is: f64) -> bool {
        match self {
            Rule::Same => was == is,
            Rule::AtMost(slack) => is <= was * (1.0 + slack),
            Rule::AtLeast(slack) => is >= was * (1.0 - slack),
        }
    }
}

/// Compares lists by the names of their elements. An element that is new or missing fails too.
fn compare_all<T: Figures>(was: &[T], is: &[T], findings: &mut Vec<Finding>) {
    for new in is {
        let name = new.name();
        let Some(old) = was.iter().find(|old| old.name() == name) else {
            findings.push(Finding {
                figure: name,
                was: NOTHING.into(),
                is: "new".into(),
                verdict: Verdict::Fails,
            });
            continue;
        };
        for ((what, old, rule), (_, new, _)) in old.values().into_iter().zip(new.values()) {
            findings.push(Finding {
                figure: format!("{name}: {what}"),
                was: format!("{old}"),
                is: format!("{new}"),
                verdict: match rule.holds(old, new) {
                    true => Verdict::Holds,
                    false => Verdict::Fails,
                },
            });
        }
    }
    for old in was {
        let name = old.name();
        if !is.iter().any(|new| new.name() == name) {
            findings.push(Finding {
                figure: name,
                was: "there".into(),
                is: NOTHING.into(),
                verdict: Verdict::Fails,
            });
        }
    }
}

/// Compares every figure of `is` with that of `was`, and with its goal. `kept` gives the modules that were not measured, with
/// the reasons.
pub fn compare(was: &Baseline, is: &Baseline, kept: &[(String, String)]) -> Vec<Finding> {
    let mut findings = vec![];
    compare_all(&was.frames, &is.frames, &mut findings);
    compare_all(&was.films, &is.films, &mut findings);
    let fast = findings.len();
    compare_all(&was.fast_frames, &is.fast_frames, &mut findings);
    compare_all(&was.fast_films, &is.fast_films, &mut findings);
    for finding in &mut findings[fast..] {
        finding.figure = format!("{FAST}, {}", finding.figure);
    }
    compare_all(&was.chip_frames, &is.chip_frames, &mut findings);
    compare_all(&was.chip_memories, &is.chip_memories, &mut findings);
    compare_all(&was.chip_caches, &is.chip_caches, &mut findings);
    compare_all(&was.area, &is.area, &mut findings);
    compare_all(&was.chip_area, &is.chip_area, &mut findings);
    compare_all(&was.clock, &is.clock, &mut findings);
    compare_all(&was.fast_clock, &is.fast_clock, &mut findings);
    compare_all(&was.configurations, &is.configurations, &mut findings);
    compare_all(&was.depths, &is.depths, &mut findings);
    goals(is, &mut findings);
    for (name, why) in kept {
        findings.push(Finding {
            figure: name.clone(),
            was: "changed".into(),
            is: why.clone(),
            verdict: Verdict::Kept,
        });
    }
    findings
}

/// Checks the goals, which do not depend on the checked-in figures.
fn goals(is: &Baseline, findings: &mut Vec<Finding>) {
    let mut goal = |figure: String, goal: String, is: String, holds: bool| {
        findings.push(Finding {
            figure,
            was: goal,
            is,
            verdict: match holds {
                true => Verdict::Reached,
                false => Verdict::Fails,
            },
        });
    };
    for (areas, most) in [(&is.area, CORE_GOAL), (&is.chip_area, CHIP_GOAL)] {
        let Some(whole) = areas.last() else { continue };
        let (takes, holds) = (whole.area, Target::Virtex4Lx160.holds());
        for (what, takes, holds, most) in [
            ("LUT4", takes.lut4, holds.lut4, most.lut4),
            ("DSP48", takes.dsp, holds.dsp, most.dsp),
            ("RAMB16", takes.ram, holds.ram, most.ram),
        ] {
            let share = takes as f64 / holds as f64;
            goal(
                format!("{}: {what} of an LX160", whole.name),
                format!("at most {:.0} %", most * 100.0),
                format!("{:.1} %", share * 100.0),
                share <= most,
            );
        }
    }
    for (machine, clocks, least) in [
        (is.machine.as_str(), &is.clock, CLOCK_GOAL),
        (FAST, &is.fast_clock, FAST_CLOCK_GOAL),
    ] {
        for unit in clocks {
            goal(
                format!("{machine}, {}: clock", unit.name),
                format!("at least {least} MHz"),
                format!("{:.1} MHz", unit.mhz),
                unit.mhz >= least,
            );
        }
    }
    for depth in &is.depths {
        goal(
            format!("{}: clock", depth.name()),
            format!("at least {} MHz", depth.asked_mhz),
            format!("{:.1} MHz", depth.mhz),
            depth.mhz >= f64::from(depth.asked_mhz),
        );
    }
}

/// A section of the log: the reason, and every changed figure.
pub fn log_entry(why: &str, findings: &[Finding]) -> String {
    let mut text = format!("\n## {why}\n\n");
    let changed = |f: &&Finding| f.was != f.is && f.verdict != Verdict::Reached;
    let changed: Vec<&Finding> = findings.iter().filter(changed).collect();
    if changed.is_empty() {
        text += "No figure changed.\n";
    }
    for finding in changed {
        let _ = writeln!(text, "- {finding}");
    }
    text
}

/// The head of a new log.
pub const LOG_HEAD: &str =
    "# Changes of the baseline\n\nWritten by `dynrt baseline --accept WHY`, the latest last.\n";
