//! Measures the figures of a baseline.

mod chip;

use super::{
    Baseline, ConfigurationArea, Depth, FAST, FilmFigures, FrameFigures, SEEDS, UnitArea, UnitClock,
};
use crate::bkd::layout::MemoryImage;
use crate::bkd::{BuildOptions, build};
use crate::config::{Config, NAMED};
use crate::cosim::animate::{self, Figures, Film};
use crate::cosim::raycast::{self, Counters};
use crate::emit::{self, Top};
use crate::hw::{self, Plan};
use crate::port::Ray;
use crate::scene::animation::{MachineFrame, MachineScene};
use crate::scene::load_animated;
use crate::scene::{self, Camera, Frame, ImageSize, MachineMesh, RayPacket, View};
use crate::synth::{self, Target};
use anyhow::{Context, Result, ensure};
use std::path::PathBuf;

/// The fixed frames; their scenes need no file.
const FRAMES: [(&str, Option<View>, &str); 3] = [
    ("builtin:teapot", None, "256x192"),
    ("builtin:cornell", None, "256x192"),
    ("builtin:interior", Some(View::Inside), "256x192"),
];

/// The fixed films: one with skinning, one with vertices written by the host, one of two levels.
const FILMS: [(&str, usize, &str); 3] = [
    ("builtin:figure", 3, "256x192"),
    ("builtin:water", 2, "128x96"),
    ("builtin:reef", 2, "128x96"),
];

/// The units that are placed and routed, each with everything below it. Together they are the machine except for its glue logic.
pub const UNITS: [&str; 5] = [
    "ray_setup",
    "tpu",
    "geometry_unit",
    "skinning_processor",
    "update_processor",
];

/// Approximate number of intervals into which a frame is divided.
const INTERVALS: u64 = 100;

/// Units in the table of depths, and their clock targets.
const DEPTH_UNITS: [&str; 4] = ["fp_add", "fp_mul", "fp_reciprocal", "near_distance"];
const DEPTH_CLOCKS: [u32; 6] = [50, 66, 75, 100, 125, 150];

/// Selection of the units to place and route.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Clocks {
    #[default]
    None,
    /// Only units whose Verilog has changed, with the tools that measured the others.
    Changed,
    /// All units: hours without a cache.
    All,
}

/// Selection of the measurements; all other figures are copied from the given baseline.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// Modules that took more LUT4 than this are not synthesised again; `None`: all changed modules are.
    pub most_lut4: Option<u64>,
    /// The units whose clocks are measured, for the reference machine and for [`FAST`].
    pub clocks: Clocks,
    /// Restricts the clocks to these [`UNITS`]; empty: all. The other units keep their recorded clocks.
    pub clock_units: Vec<String>,
    /// Whether to measure the area of the other named configurations: half an hour without a cache.
    pub configurations: bool,
    /// Whether to measure the table of depths: half an hour without a cache.
    pub depths: bool,
    /// Whether to measure the tables of the chip's caches and memories: minutes.
    pub chip: bool,
    /// The cache folder; `None` for the user's cache.
    pub cache: Option<PathBuf>,
}

/// Measures the reference machine. Returns its figures, and the name of each module that has changed but was not synthesised,
/// with the reason. `progress` receives one line per step.
///
/// # Errors
/// A mismatch of RTL and golden model, or a tool that is missing or fails.
pub fn measure(
    was: &Baseline,
    request: &Request,
    progress: &dyn Fn(&str),
) -> Result<(Baseline, Vec<(String, String)>)> {
    let config = Config::reference();
    let mut is = Baseline {
        machine: config.name.clone(),
        ..was.clone()
    };
    (is.frames, is.films) = pictures(&config, progress)?;
    (is.fast_frames, is.fast_films) = pictures(&Config::load(FAST)?, progress)?;
    is.chip_frames = chip::frames(&config, progress)?;
    let core = area(&config, (Top::Core, &was.area), &[], request, progress)?;
    let whole = (Top::Chip, &*was.chip_area);
    let chip = area(&config, whole, &core.units, request, progress)?;
    (is.area, is.chip_area) = (core.units, chip.units);
    is.area_tools = chip.tools.or(core.tools).unwrap_or(was.area_tools.clone());
    let mut kept = [core.kept, chip.kept].concat();
    let verilog = chip::verilog(&config)?;
    if request.chip {
        (is.chip_memories, is.chip_caches) = chip::sweep(&config, progress)?;
        is.chip_verilog = verilog;
    } else if verilog != was.chip_verilog {
        let why = "dynrt baseline --chip measures them";
        kept.push((
            "tables of the chip's caches and memories".into(),
            why.into(),
        ));
    }
    let routing = |units: &[&str], seeds| synth::Request {
        top: Top::Core,
        target: Target::Ecp5_85f,
        units: units.iter().map(ToString::to_string).collect(),
        seeds,
        cache: request.cache.clone(),
    };
    if request.configurations {
        configurations(&mut is, &routing, progress)?;
    } else {
        stale_configurations(was, &mut kept)?;
    }
    if request.depths {
        depths(&config, &mut is, &routing, progress)?;
    }
    if request.clocks != Clocks::None {
        let machines = [
            (&config, &was.clock, &mut is.clock),
            (&Config::load(FAST)?, &was.fast_clock, &mut is.fast_clock),
        ];
        for (config, known, clock) in machines {
            let (measured, tools) = clocks(config, known, request, &routing, progress)?;
            let Some(tools) = tools else {
                *clock = measured;
                continue;
            };
            ensure!(
                request.clocks == Clocks::All || tools == was.clock_tools,
                "the clocks were measured with {}, but the tools are {}; use --clock to measure all of them again",
                was.clock_tools.join(", "),
                tools.join(", ")
            );
            (*clock, is.clock_tools) = (measured, tools);
        }
    }
    stale_clocks(&config, &is.clock, &mut kept)?;
    stale_clocks(&Config::load(FAST)?, &is.fast_clock, &mut kept)?;
    Ok((is, kept))
}

fn rounded(value: f64) -> f64 {
    (value * 1e4).round() / 1e4
}

/// Runs the fixed frames and films on a machine.
fn pictures(
    config: &Config,
    progress: &dyn Fn(&str),
) -> Result<(Vec<FrameFigures>, Vec<FilmFigures>)> {
    let told = |what: &str| progress(&format!("{}: {what}", config.name));
    let frames = FRAMES
        .iter()
        .map(|&(scene, view, size)| frame(config, scene, view, size, &told));
    let frames = frames.collect::<Result<_>>()?;
    let films = FILMS
        .iter()
        .map(|&(scene, frames, size)| film(config, scene, frames, size, &told));
    Ok((frames, films.collect::<Result<_>>()?))
}

/// A picture of a built-in scene in the memory of a machine, with its default tree.
pub(super) struct Picture {
    pub mesh: MachineMesh,
    pub image: MemoryImage,
    /// The name of the camera.
    pub view: &'static str,
    /// A light in scene units.
    pub light: [f64; 3],
    /// The primary rays.
    pub packets: Vec<RayPacket>,
    /// The command that casts them, without options of rays.
    pub options: String,
}

impl Picture {
    pub fn new(config: &Config, spec: &str, view: Option<View>, size: &str) -> Result<Picture> {
        let scene = scene::load(spec)?;
        let mesh = MachineMesh::new(&scene, config.format())?;
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        let tree = build(&mesh.vertices, &mesh.triangles, &options)?;
        let image = MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree)?;
        let bounds = scene.bounds();
        let (camera, name) = match view {
            Some(View::Inside) => (Camera::inside(bounds), "inside"),
            Some(View::Outside) => (Camera::outside(bounds), "outside"),
            None => (Camera::framing(bounds), "framing"),
        };
        let pixels: ImageSize = size.parse()?;
        let picture = Frame::new(pixels, config.rays_per_packet as usize)?;
        let mut options = format!("{spec} --size {size}");
        if view.is_some() {
            options += &format!(" --view {name}");
        }
        Ok(Picture {
            light: scene::default_light(bounds, &camera),
            packets: picture.primary_rays(&camera, &mesh)?,
            mesh,
            image,
            view: name,
            options,
        })
    }
}

/// The rays of packets, one after the other.
pub(super) fn rays_of(packets: &[RayPacket]) -> Vec<Ray> {
    packets.iter().flat_map(|p| p.rays.clone()).collect()
}

fn frame(
    config: &Config,
    spec: &str,
    view: Option<View>,
    size: &str,
    progress: &dyn Fn(&str),
) -> Result<FrameFigures> {
    progress(&format!("casting {spec} at {size}"));
    let picture = Picture::new(config, spec, view, size)?;
    let (image, rays) = (&picture.image, rays_of(&picture.packets));
    let mut options = raycast::Options {
        replay: format!("dynrt cosim {}", picture.options),
        ..raycast::Options::default()
    };
    let mut unit = raycast::RaycastUnit::new(config, None)?;
    // The first run measures the length of the frame; intervals are about 1/100 of it, in round numbers.
    let cycles = unit.cast(image, &rays, &options, &|_| ())?.cycles;
    let interval_cycles = (cycles / INTERVALS).next_power_of_two();
    options.sample_cycles = Some(interval_cycles);
    let report = unit.cast(image, &rays, &options, &|_| ())?;
    ensure!(
        report.cycles == cycles,
        "{spec}: {cycles} cycles, then {} for the same rays: the run is not deterministic",
        report.cycles
    );
    let by_interval = |count: fn(&Counters) -> u64| {
        let mut before = 0;
        let mut share = |sample: &Counters| {
            let now = count(sample);
            let share = (now - before) as f64 / interval_cycles as f64;
            before = now;
            rounded(share)
        };
        report.samples.iter().map(&mut share).collect()
    };
    Ok(FrameFigures {
        scene: spec.into(),
        view: picture.view.into(),
        size: size.into(),
        rays: rays.iter().filter(|ray| ray.active).count() as u64,
        cycles,
        packet_steps: report.counters.packet_steps,
        ray_triangle_tests: report.counters.ray_triangle_tests,
        tpu_utilisation: rounded(report.tpu_utilisation()),
        gu_utilisation: rounded(report.gu_utilisation()),
        interval_cycles,
        tpu_by_interval: by_interval(|counters| counters.packet_steps),
        gu_by_interval: by_interval(|counters| counters.gu_busy_cycles),
    })
}

fn film(
    config: &Config,
    spec: &str,
    count: usize,
    size: &str,
    progress: &dyn Fn(&str),
) -> Result<FilmFigures> {
    progress(&format!("showing {count} frames of {spec} at {size}"));
    let scene = load_animated(spec)?;
    let clip = scene.clip(None)?;
    let times = clip.map_or(vec![0.0; count], |clip| {
        scene.clips[clip].frame_times(count)
    });
    let poses = times.iter().map(|&time| scene.pose(clip, time));
    let poses = poses.collect::<Result<Vec<_>>>()?;
    let extents = scene.extents_of(&poses)?;
    let format = config.format();
    let machine = MachineScene::new(&scene, &extents, format, config.skinning_joints)?;
    let frames = poses.iter().map(|pose| machine.frame(pose));
    let frames = frames.collect::<Result<Vec<MachineFrame>>>()?;
    let pixels: ImageSize = size.parse()?;
    let camera = scene.camera(&poses, pixels);
    let picture = Frame::new(pixels, config.rays_per_packet as usize)?;
    let packets = picture.rays_in(&camera, format, machine.log2_scale)?;
    let film = Film {
        scene: &machine,
        frames: &frames,
        size: pixels,
        packets: &packets,
    };
    let options = animate::Options {
        replay: format!("dynrt animate {spec} --frames {count} --size {size}"),
        ..animate::Options::default()
    };
    let mut total = Figures::default();
    animate::run(config, film, &options, &|_, _| (), |frame| {
        total.add(&frame.figures);
        Ok(())
    })?;
    Ok(FilmFigures {
        scene: spec.into(),
        size: size.into(),
        frames: count as u64,
        rays: total.rays,
        skinning_cycles: total.skinning_cycles,
        influences: total.influences,
        update_cycles: total.update_cycles,
        instructions: total.instructions,
        triangles: total.triangles,
        nodes_written: total.nodes_written,
        raycast_cycles: total.raycast_cycles,
    })
}

/// Area of the modules of a design that `elsewhere` does not have: known figures for unchanged modules and, with the reason, for those
/// that are too large to be measured now.
fn area(
    config: &Config,
    (top, known): (Top, &[UnitArea]),
    elsewhere: &[UnitArea],
    request: &Request,
    progress: &dyn Fn(&str),
) -> Result<Areas> {
    let plan = Plan::new(config)?;
    let machine = emit::machine_with(&plan, hw::core::default_prefix(), top)?;
    let mut areas = Areas::default();
    let mut changed = vec![];
    // The area of a part is included in its unit.
    for module in machine.design.units() {
        let name = synth::unit_name(module).to_string();
        if elsewhere.iter().any(|unit| unit.name == name) {
            continue;
        }
        let verilog = synth::fingerprint(module)?;
        let old = known.iter().find(|unit| unit.name == name);
        if let Some(old) = old.filter(|old| old.verilog == verilog) {
            areas.units.push(old.clone());
            continue;
        }
        if let (Some(old), Some(most)) = (old, request.most_lut4)
            && old.area.lut4 > most
        {
            areas.kept.push((
                name,
                format!(
                    "it took {} LUT4, and modules of more than {most} are measured by dynrt baseline --all",
                    old.area.lut4
                ),
            ));
            areas.units.push(old.clone());
            continue;
        }
        // Placeholder; the area is measured below.
        changed.push(name.clone());
        areas.units.push(UnitArea {
            name,
            verilog,
            area: Default::default(),
        });
    }
    if !changed.is_empty() {
        let report = synth::synthesise(
            config,
            &synth::Request {
                top,
                target: Target::Virtex4Lx160,
                units: changed,
                seeds: 0,
                cache: request.cache.clone(),
            },
            progress,
        )?;
        areas.tools = Some(report.tools);
        for measured in report.units {
            let unit = areas
                .units
                .iter_mut()
                .find(|unit| unit.name == measured.name);
            unit.context("a module that was not asked for")?.area = measured.area;
        }
    }
    Ok(areas)
}

/// Areas of a design's modules, the whole last.
#[derive(Default)]
struct Areas {
    units: Vec<UnitArea>,
    /// Changed modules that were not measured, with the reason.
    kept: Vec<(String, String)>,
    /// The tools, if they were needed.
    tools: Option<Vec<String>>,
}

/// Creates the request that places and routes the given modules with the given number of seeds.
type Routing<'a> = &'a dyn Fn(&[&str], u32) -> synth::Request;

fn configurations(is: &mut Baseline, routing: Routing<'_>, progress: &dyn Fn(&str)) -> Result<()> {
    is.configurations.clear();
    for &(name, _) in NAMED {
        let config = Config::load(name)?;
        let machine = emit::machine(&config)?;
        let top = machine.design.top();
        let verilog = synth::fingerprint(top)?;
        let known = is.area.iter().find(|unit| unit.verilog == verilog);
        let area = match known {
            Some(unit) => unit.area,
            None => {
                let asked = synth::Request {
                    target: Target::Virtex4Lx160,
                    ..routing(&[synth::unit_name(top)], 0)
                };
                let report = synth::synthesise(&config, &asked, progress)?;
                report.units.first().context("the machine")?.area
            }
        };
        is.configurations.push(ConfigurationArea {
            name: name.into(),
            clock_mhz: config.clock_mhz,
            verilog,
            area,
        });
    }
    Ok(())
}

fn depths(
    config: &Config,
    is: &mut Baseline,
    routing: Routing<'_>,
    progress: &dyn Fn(&str),
) -> Result<()> {
    is.depths.clear();
    for asked_mhz in DEPTH_CLOCKS {
        let mut config = config.clone();
        config.set("clock.target_mhz", &asked_mhz.to_string())?;
        let report = synth::synthesise(&config, &routing(&DEPTH_UNITS, 1), progress)?;
        for unit in report.units {
            is.depths.push(Depth {
                depth: unit.latency.context("the depth of a pipeline")?,
                mhz: rounded(unit.mhz.context("a module that was routed has a clock")?),
                unit: unit.name,
                asked_mhz,
                area: unit.area,
            });
        }
    }
    Ok(())
}

/// Records configurations whose Verilog has changed since they were measured.
fn stale_configurations(was: &Baseline, kept: &mut Vec<(String, String)>) -> Result<()> {
    for known in &was.configurations {
        let machine = emit::machine(&Config::load(&known.name)?)?;
        if synth::fingerprint(machine.design.top())? != known.verilog {
            kept.push((
                format!("configuration {}", known.name),
                "dynrt baseline --configurations measures it".into(),
            ));
        }
    }
    Ok(())
}

/// Records units whose Verilog has changed since they were routed.
fn stale_clocks(
    config: &Config,
    known: &[UnitClock],
    kept: &mut Vec<(String, String)>,
) -> Result<()> {
    let machine = emit::machine(config)?;
    let modules = machine.design.modules();
    for clock in known {
        let module = modules
            .iter()
            .find(|module| synth::unit_name(module) == clock.name);
        let verilog = synth::fingerprint(module.context("a unit of the machine")?)?;
        if verilog != clock.verilog {
            kept.push((
                format!("{}, {}: clock", config.name, clock.name),
                "dynrt baseline --clock=changed measures it".into(),
            ));
        }
    }
    Ok(())
}

/// The clocks of a machine's units, and the tools if any were needed. Known clocks are kept for units that are not selected and,
/// unless all are selected, for units whose Verilog is unchanged.
fn clocks(
    config: &Config,
    known: &[UnitClock],
    request: &Request,
    routing: Routing<'_>,
    progress: &dyn Fn(&str),
) -> Result<(Vec<UnitClock>, Option<Vec<String>>)> {
    let machine = emit::machine(config)?;
    let modules = machine.design.modules();
    let (mut clocks, mut changed) = (vec![], vec![]);
    for name in UNITS {
        let module = modules
            .iter()
            .find(|module| synth::unit_name(module) == name);
        let verilog = synth::fingerprint(module.context("a unit of the machine")?)?;
        let asked =
            request.clock_units.is_empty() || request.clock_units.iter().any(|unit| unit == name);
        let current =
            |known: &UnitClock| request.clocks == Clocks::Changed && known.verilog == verilog;
        let of = |known: &&UnitClock| known.name == name && (!asked || current(known));
        clocks.push(match known.iter().find(of) {
            Some(known) => known.clone(),
            None => {
                changed.push(name);
                // Placeholder; the clock is measured below.
                UnitClock {
                    name: name.into(),
                    verilog,
                    mhz: 0.0,
                    critical_path: String::new(),
                }
            }
        });
    }
    if changed.is_empty() {
        return Ok((clocks, None));
    }
    let report = synth::synthesise(config, &routing(&changed, SEEDS), progress)?;
    for unit in report.units {
        let clock = clocks.iter_mut().find(|clock| clock.name == unit.name);
        let clock = clock.context("a unit that was not asked for")?;
        let path = unit.critical_path.context("a critical path")?;
        (clock.mhz, clock.critical_path) =
            (rounded(unit.mhz.context("a clock")?), path.to_string());
    }
    Ok((clocks, Some(report.tools)))
}
