//! Area and clock of a machine's modules with open tools: Yosys counts cells, nextpnr places and routes.
//!
//! | module | content |
//! |---|---|
//! | [`target`] | the devices: capacity, mapping of modules, and the area of each cell |
//! | `tools` | finding and running the tools |
//! | `wrapper` | shift registers at a module's ports, which keep pins off its critical paths |
//! | `cells` | Yosys' report |
//! | `outreg` | the output registers of ECP5 block RAMs and multipliers, which Yosys leaves unused |
//! | `timing` | nextpnr's report, with the names of our modules |
//! | [`constraints`], [`selftest`] | the files for a bitstream, and its self-test |
//! | `store` | stored results |
//!
//! Every module is synthesised alone, with everything below it flattened into it. The figures of a unit include its parts. The sum over
//! the parts differs from the whole, because shared logic, and logic that a constant port makes superfluous, is counted only once.
//!
//! A result is stored in the cache folder under a key of all its inputs: the Verilog of the module and of all modules below
//! it, the tool's version, and its options. A module is synthesised again only if one of them changes, and an interrupted run
//! resumes where it stopped.

mod cells;
pub mod constraints;
mod outreg;
pub mod selftest;
pub(crate) mod store;
pub mod target;
mod timing;
mod tools;
mod wrapper;

pub use cells::{Cells, parse_cells};
pub use target::{Area, Target};
pub use timing::{CriticalPath, Point, Timing, parse_timing};

use self::outreg::Blocks;
use crate::config::Config;
use crate::emit;
use crate::hdl::{Design, Module};
use crate::hw;
use crate::temporary;
use crate::tools::Tool;
use anyhow::{Context, Result, bail, ensure};
use serde::Serialize;
use serde_json::Value;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Instant;
use store::Store;

/// A request for measurements.
#[derive(Clone, Debug)]
pub struct Request {
    /// The design whose modules are synthesised.
    pub top: emit::Top,
    /// The device.
    pub target: Target,
    /// Names of the modules; empty for all of them and the whole machine.
    pub units: Vec<String>,
    /// Number of seeds, starting at 1, with which each module is placed and routed; 0: not at all.
    pub seeds: u32,
    /// The cache folder; `None` for the user's, as for models (see [`crate::cosim::model`]).
    pub cache: Option<PathBuf>,
}

/// The area and clock of a machine on a device.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    pub generator: &'static str,
    /// Every key of the configuration, by section.
    pub configuration: Value,
    pub target: &'static str,
    /// The capacity of the device.
    pub device: Area,
    /// The definition of the columns.
    pub counted: &'static str,
    /// The tools' versions.
    pub tools: Vec<String>,
    /// The modules below the top module, children first, or the requested ones.
    pub units: Vec<Unit>,
    /// The top module; `None` if single units were requested.
    pub total: Option<Unit>,
}

/// The area and clock of one module, including everything below it.
#[derive(Clone, Debug, Serialize)]
pub struct Unit {
    pub name: String,
    /// Pipeline registers from inputs to outputs, if the module is a pipeline.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub latency: Option<u32>,
    #[serde(flatten)]
    pub area: Area,
    /// The area in percent of the device.
    pub share_percent: Share,
    /// Number of cells by Yosys' names of the kinds.
    pub cells: Cells,
    /// The clock of the worst seed in MHz, if the module was routed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mhz: Option<f64>,
    /// The critical path of the worst seed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub critical_path: Option<CriticalPath>,
    /// The clocks of all seeds from 1 on, in MHz.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub mhz_by_seed: Vec<f64>,
}

/// Shares of a device, in percent.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Share {
    pub lut4: f64,
    pub ff: f64,
    pub dsp: f64,
    pub ram: f64,
}

impl Share {
    fn new(area: Area, device: Area) -> Share {
        let percent =
            |part: u64, whole: u64| (part as f64 * 10_000.0 / whole as f64).round() / 100.0;
        Share {
            lut4: percent(area.lut4, device.lut4),
            ff: percent(area.ff, device.ff),
            dsp: percent(area.dsp, device.dsp),
            ram: percent(area.ram, device.ram),
        }
    }
}

/// Synthesises modules of a configuration's machine and, if `request.seeds` is not 0, places and routes them. Only one tool runs at a
/// time. `progress` receives one line per step, and none if all results are stored.
///
/// # Errors
/// One line if there is no such module, if no open tool routes for the target, if a tool is missing or too old (with the command that
/// installs it), if a tool fails (with its first message and the path of its log), or if the cache cannot be written.
pub fn synthesise(config: &Config, request: &Request, progress: &dyn Fn(&str)) -> Result<Report> {
    let target = request.target;
    let is_routed = request.seeds > 0;
    let plan = hw::Plan::new(config)?;
    let machine = emit::machine_with(&plan, hw::core::default_prefix(), request.top)?;
    let design = &machine.design;
    let chosen = choose(design, &request.units)?;
    ensure!(
        !is_routed || target.is_routable(),
        "target {}: no open tool supports place and route for it; use --target {}, the most similar supported device",
        target.name(),
        Target::Ecp5_85f.name()
    );
    let tools = Tools {
        yosys: tools::yosys(target)?,
        nextpnr: is_routed.then(tools::nextpnr).transpose()?,
    };
    let bench = Bench {
        target,
        clock_mhz: config.clock_mhz,
        seeds: request.seeds,
        store: Store::open(request.cache.clone())?,
        tools: &tools,
        progress,
    };
    let count = chosen.len();
    let mut measured = Vec::with_capacity(count);
    for (index, module) in chosen.into_iter().enumerate() {
        let number = format!("{} of {count}", index + 1);
        let unit = bench
            .measure(module, &number)
            .with_context(|| format!("module {}", unit_name(module)))?;
        measured.push(unit);
    }
    let total = match request.units.is_empty() {
        true => measured.pop(),
        false => None,
    };
    Ok(Report {
        generator: concat!("dynrt ", env!("CARGO_PKG_VERSION")),
        configuration: emit::configuration(config),
        target: target.name(),
        device: target.holds(),
        counted: target.counting(),
        tools: tools.versions(),
        units: measured,
        total,
    })
}

/// The name of a module in measurements: that of its description, without the prefix of the emitted machine, so figures are
/// comparable for all prefixes. Only the whole core keeps its emitted name.
pub fn unit_name(module: &Module) -> &str {
    measured_name(module.name())
}

fn measured_name(name: &str) -> &str {
    const CORE: &str = "dynrt_core";
    match name {
        hw::core::NAME => CORE,
        _ => name,
    }
}

/// The Verilog of a module and of everything below it, by file, with the names of [`unit_name`].
fn measured_files(module: &Arc<Module>) -> Result<Vec<(String, String)>> {
    let design = Design::new(module.clone())?;
    let file = |module: &Arc<Module>| {
        let text = module.verilog_with(&|name| measured_name(name).to_string());
        (format!("{}.v", unit_name(module)), text)
    };
    Ok(design.modules().iter().map(file).collect())
}

/// Identifies the Verilog of a module and of all modules below it. Comments are ignored, because they do not affect results.
///
/// # Errors
/// None for a module of [`emit::machine`].
pub fn fingerprint(module: &Arc<Module>) -> Result<String> {
    let files = measured_files(module)?;
    let code: Vec<(&str, String)> = (files.iter())
        .map(|(name, text)| (name.as_str(), without_comments(text)))
        .collect();
    let parts: Vec<&str> = (code.iter())
        .flat_map(|(name, code)| [*name, code.as_str()])
        .collect();
    Ok(store::key(&parts))
}

/// Generated Verilog without comments and blank lines. Its strings contain no `//`.
fn without_comments(text: &str) -> String {
    let lines = text
        .lines()
        .map(|line| line.split("//").next().unwrap_or_default().trim_end());
    let lines = lines.filter(|line| !line.is_empty());
    lines.flat_map(|line| [line, "\n"]).collect()
}

/// The modules with the given names, or all modules. Emitted names are also accepted.
fn choose<'d>(design: &'d Design, names: &[String]) -> Result<Vec<&'d Arc<Module>>> {
    let modules = design.modules();
    if names.is_empty() {
        return Ok(modules.iter().collect());
    }
    let find = |name: &String| {
        let is_named = |module: &&Arc<Module>| {
            unit_name(module) == name || design.emitted(module.name()) == *name
        };
        let Some(module) = modules.iter().find(is_named) else {
            let known: Vec<&str> = modules.iter().map(|module| unit_name(module)).collect();
            bail!(
                "unit {name}: this machine has no such module; choose one of {}",
                known.join(", ")
            )
        };
        Ok(module)
    };
    names.iter().map(find).collect()
}

struct Tools {
    yosys: Tool,
    nextpnr: Option<Tool>,
}

impl Tools {
    fn versions(&self) -> Vec<String> {
        let tools = std::iter::once(&self.yosys).chain(&self.nextpnr);
        tools.map(|tool| tool.version.clone()).collect()
    }
}

/// The common settings of all measurements.
struct Bench<'a> {
    target: Target,
    /// The clock target in MHz.
    clock_mhz: u32,
    seeds: u32,
    store: Store,
    tools: &'a Tools,
    progress: &'a dyn Fn(&str),
}

/// The netlist for nextpnr.
const NETLIST: &str = "netlist.json";

impl Bench<'_> {
    fn blocks(&self) -> Blocks {
        Blocks::at(self.clock_mhz)
    }

    fn measure(&self, module: &Arc<Module>, number: &str) -> Result<Unit> {
        let job = Job::new(self, module)?;
        let name = unit_name(module);
        let mut cells = self.store.get::<Cells>(name, &job.area_key);
        let timings: Vec<Option<Timing>> = (1..=self.seeds)
            .map(|seed| self.store.get(name, &job.timing_key(self, seed)))
            .collect();
        // Netlists are large and are not stored; a placement creates its netlist again.
        if cells.is_none() || timings.iter().any(Option::is_none) {
            job.write()?;
            cells = Some(self.synthesise(&job, number)?);
        }
        let cells = cells.expect("known or just counted");
        let area = self.target.area(&cells)?;
        let mut routed = Vec::new();
        for (seed, known) in (1..).zip(timings) {
            routed.push(match known {
                Some(timing) => timing,
                None => self.route(&job, seed, number)?,
            });
        }
        let worst = routed.iter().min_by(|a, b| a.mhz.total_cmp(&b.mhz));
        Ok(Unit {
            name: name.to_string(),
            latency: module.latency(),
            area,
            share_percent: Share::new(area, self.target.holds()),
            cells,
            mhz: worst.map(|timing| timing.mhz),
            critical_path: worst.map(|timing| timing.critical_path.clone()),
            mhz_by_seed: routed.iter().map(|timing| timing.mhz).collect(),
        })
    }

    fn synthesise(&self, job: &Job<'_>, number: &str) -> Result<Cells> {
        let name = unit_name(job.module);
        let started = Instant::now();
        (self.progress)(&format!("synthesising {name} ({number})"));
        let log = self.store.failure_log(&format!("{name}-yosys"));
        self.tools
            .yosys
            .run(job.folder.path(), &["-q", "-p", &job.script], &log)?;
        let mut cells = parse_cells(&job.read(target::CELLS)?)?;
        if self.target.is_routable() {
            wrapper::subtract(job.module, &mut cells)?;
            job.absorb_output_registers(&mut cells, self.blocks())?;
        }
        self.target.area(&cells)?;
        self.store.put(name, &job.area_key, &cells)?;
        let seconds = started.elapsed().as_secs_f64();
        (self.progress)(&format!("synthesised {name} in {seconds:.0} s"));
        Ok(cells)
    }

    fn route(&self, job: &Job<'_>, seed: u32, number: &str) -> Result<Timing> {
        const REPORT: &str = "timing.json";
        let name = unit_name(job.module);
        let nextpnr = (self.tools.nextpnr.as_ref()).expect("found where modules are routed");
        let started = Instant::now();
        (self.progress)(&format!("routing {name} from seed {seed} ({number})"));
        let options = target::nextpnr_options(self.clock_mhz, seed);
        let mut args: Vec<&str> = options.iter().map(String::as_str).collect();
        args.extend(["--json", NETLIST, "--report", REPORT]);
        let log = self.store.failure_log(&format!("{name}-nextpnr"));
        nextpnr.run(job.folder.path(), &args, &log)?;
        let timing = parse_timing(&job.read(REPORT)?, job.module)?;
        self.store.put(name, &job.timing_key(self, seed), &timing)?;
        let seconds = started.elapsed().as_secs_f64();
        (self.progress)(&format!(
            "routed {name} in {seconds:.0} s: {:.1} MHz",
            timing.mhz
        ));
        Ok(timing)
    }
}

/// A module in its own folder, with the inputs of the tools.
struct Job<'a> {
    module: &'a Arc<Module>,
    /// The Verilog, by file.
    files: Vec<(String, String)>,
    /// The script for Yosys.
    script: String,
    area_key: String,
    folder: temporary::Folder,
}

impl<'a> Job<'a> {
    fn new(bench: &Bench<'_>, module: &'a Arc<Module>) -> Result<Job<'a>> {
        let mut files = measured_files(module)?;
        let mut top = unit_name(module);
        if bench.target.is_routable() {
            let text = wrapper::verilog(module)?;
            files.push((format!("{}.v", wrapper::NAME), text));
            top = wrapper::NAME;
        }
        let names: Vec<&str> = files.iter().map(|(name, _)| name.as_str()).collect();
        let script = bench.target.yosys_script(&names, top, NETLIST);
        let mut parts = vec![bench.tools.yosys.version.as_str(), &script];
        if bench.target.is_routable() {
            parts.push(bench.blocks().key());
        }
        parts.extend(files.iter().flat_map(|(n, text)| [n.as_str(), text]));
        let area_key = store::key(&parts);
        let folder = temporary::Folder::new().context("cannot create a temporary folder")?;
        Ok(Job {
            module,
            area_key,
            script,
            files,
            folder,
        })
    }

    fn timing_key(&self, bench: &Bench<'_>, seed: u32) -> String {
        let options = target::nextpnr_options(bench.clock_mhz, seed);
        let nextpnr = bench.tools.nextpnr.as_ref();
        let version = nextpnr.map_or("", |tool| &tool.version);
        let mut parts = vec![self.area_key.as_str(), version];
        parts.extend(options.iter().map(String::as_str));
        store::key(&parts)
    }

    fn write(&self) -> Result<()> {
        for (name, text) in &self.files {
            let path = self.folder.path().join(name);
            std::fs::write(&path, text)
                .with_context(|| format!("cannot write {}", path.display()))?;
        }
        Ok(())
    }

    /// Moves registers into `blocks`, both in the netlist for nextpnr and in the counts of cells.
    fn absorb_output_registers(&self, cells: &mut Cells, blocks: Blocks) -> Result<()> {
        let mut netlist = serde_json::from_str(&self.read(NETLIST)?)
            .context("Yosys has written no whole netlist")?;
        let saved = outreg::absorb(&mut netlist, wrapper::NAME, wrapper::CAPTURED, blocks)?;
        let path = self.folder.path().join(NETLIST);
        std::fs::write(&path, netlist.to_string())
            .with_context(|| format!("cannot write {}", path.display()))?;
        if let Some(count) = cells.get_mut(outreg::FLIP_FLOP) {
            *count = count.saturating_sub(saved);
        }
        Ok(())
    }

    fn read(&self, name: &str) -> Result<String> {
        let path = self.folder.path().join(name);
        std::fs::read_to_string(&path)
            .with_context(|| format!("the tool has not written {}", path.display()))
    }
}
