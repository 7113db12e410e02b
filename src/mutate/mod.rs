//! Mutants: single changes of the emitted Verilog, which co-simulation must detect.
//!
//! All mutants of a unit are compiled into one model, in which an input selects one ([`Design::selectable`]). If none is selected,
//! the model is the original machine, and passes. Each mutant goes through the runs of the unit's tests. It is noticed if a bit
//! differs, if the unit stops, if its own checks fail, or if the run takes another number of cycles than without a mutant, as for
//! the fixed frames in [`crate::baseline`]. Survivors are tried for equivalence (`equivalence`) and otherwise listed.
//!
//! | unit | modules | runs |
//! |---|---|---|
//! | `arithmetic` | adder, subtractor, multiplier, reciprocal, plane distances | operands, with every result compared |
//! | `tpu` | traversal unit and below | packets in tiny scenes of one and of two levels |
//! | `geometry` | geometry unit and below, without the modules of the traversal unit | triangle tests, ray transformations; skinned meshes in the whole machine, which uses its operators |
//! | `update` | update processor and its prefetch | programs of random topologies |
//! | `raycast` | ray setup, skinning processor, what joins the units | whole small scenes of two levels; random skinned meshes |
//! | `cache` | a cache, which is not in the core | requests of every locality |
//! | `cast` | the chip's ray reader and hit writer | casts in front of a random ray casting unit |
//! | `registers` | the chip's register file and event counters | accesses of a random host |
//! | `commands` | the chip's command processor | random command lists |
//! | `axi` | AXI4 master | bursts in front of a random slave |
//! | `combiner`, `arbiter`, `reader` | write combiner; read arbiter; burst reader | a memory system in front of a random slave |

mod equivalence;
mod next_state;

pub use crate::hdl::Kind;

use crate::bkd::layout::MemoryImage;
use crate::config::Config;
use crate::cosim::model::Recording;
use crate::cosim::raycast::RaycastUnit;
use crate::cosim::scoreboard::{Interrupted, Mutated, Recorder, SELECT, UnitOptions, UnitReport};
use crate::cosim::workload::{Workload, instanced_scene};
use crate::cosim::{
    raycast, unit_arithmetic, unit_axi, unit_bus, unit_cache, unit_cast, unit_commands,
    unit_geometry, unit_motion, unit_registers, unit_skinning, unit_tpu, unit_update,
};
use crate::hdl::{Design, Mutation, Select, Site};
use crate::hw;
use crate::port::Ray;
use crate::synth::store::{self, CHECKS, Store};
use anyhow::{Context, Result, bail, ensure};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;
use std::sync::Arc;

/// The units, whose modules are mutated. What is not in the core comes last, so that mutants of the core keep their numbers.
pub const UNITS: [&str; 14] = [
    "arithmetic",
    "tpu",
    "geometry",
    "update",
    "raycast",
    "cache",
    "axi",
    "combiner",
    "arbiter",
    "reader",
    "cast",
    "registers",
    "commands",
    "motion",
];

/// The modules that are mutated of a unit of the memory system; its neighbours are there for its bench. Empty: all.
fn only_modules(unit: &str) -> &'static [&'static str] {
    match unit {
        "axi" => &["axi_master"],
        "combiner" => &["write_combiner", "write_combiner_next"],
        "arbiter" => &["read_arbiter"],
        "reader" => &["burst_reader_16"],
        _ => &[],
    }
}

/// The first of them: the core, over which the mutants that are asked for are divided.
const OF_CORE: u32 = 5;

/// Numbers of transactions of a mutant's runs: most mutants are noticed in the first run, and only the others go on to the next.
const LENGTHS: [u64; 3] = [2_000, 30_000, 200_000];

/// A request to run mutants.
#[derive(Clone, Debug)]
pub struct Request {
    /// Over all units of the core; each unit that is not in it gets as many as one of these.
    pub mutants: u32,
    pub seed: u64,
    /// Names from [`UNITS`]; empty for all.
    pub units: Vec<String>,
    /// Only this mutant, by its number from 1.
    pub only: Option<u32>,
    /// Whether to try survivors for equivalence.
    pub prove: bool,
    /// The number of run lengths that each survivor passes through.
    pub lengths: usize,
    /// The cache folder; `None` for the user's.
    pub cache: Option<PathBuf>,
}

impl Request {
    /// All units, with every run and proof.
    pub fn new(mutants: u32, seed: u64) -> Request {
        Request {
            mutants,
            seed,
            units: vec![],
            only: None,
            prove: true,
            lengths: LENGTHS.len(),
            cache: None,
        }
    }
}

/// The outcome of a mutant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "outcome")]
pub enum Outcome {
    /// The run, and the first line of its message.
    Noticed { run: String, how: String },
    /// No difference can occur at the module's ports; with the proof.
    Equivalent { proof: String },
    /// The passed runs.
    Survived { runs: Vec<String> },
}

/// A mutant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Mutant {
    /// Counted from 1, as for [`Request::only`].
    pub number: u32,
    pub unit: &'static str,
    pub module: String,
    pub line: usize,
    pub kind: Kind,
    /// The expression before and after.
    pub before: String,
    pub after: String,
    #[serde(flatten)]
    pub outcome: Outcome,
}

/// The outcomes of all mutants.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    pub seed: u64,
    /// Number of mutants whose outcome was stored by an earlier run.
    pub remembered: usize,
    pub mutants: Vec<Mutant>,
}

impl Report {
    pub fn noticed(&self) -> usize {
        let noticed = |m: &&Mutant| matches!(m.outcome, Outcome::Noticed { .. });
        self.mutants.iter().filter(noticed).count()
    }

    pub fn equivalent(&self) -> usize {
        let equivalent = |m: &&Mutant| matches!(m.outcome, Outcome::Equivalent { .. });
        self.mutants.iter().filter(equivalent).count()
    }

    pub fn survivors(&self) -> impl Iterator<Item = &Mutant> {
        let survived = |m: &&Mutant| matches!(m.outcome, Outcome::Survived { .. });
        self.mutants.iter().filter(survived)
    }

    /// Percentage of noticed mutants among those not proved equivalent.
    pub fn share_percent(&self) -> f64 {
        self.noticed() as f64 * 100.0 / (self.mutants.len() - self.equivalent()).max(1) as f64
    }
}

/// A unit with its selected mutants.
struct Population {
    unit: &'static str,
    design: Design,
    drawn: Vec<(u32, Site)>,
}

impl Population {
    fn changes(&self) -> Vec<(u32, &Mutation)> {
        let drawn = self.drawn.iter();
        drawn
            .map(|(number, site)| (*number, &site.mutation))
            .collect()
    }

    /// The design with all mutants.
    fn selectable(&self, design: &Design) -> Result<Arc<Design>> {
        let design = design.selectable(&self.changes(), Select::Port(SELECT))?;
        Ok(Arc::new(design))
    }
}

fn design_of(config: &Config, unit: &str) -> Result<Design> {
    let plan = &hw::Plan::new(config)?.with_trace(true);
    let top = match unit {
        unit_arithmetic::TOP => unit_arithmetic::module(plan)?,
        "tpu" => hw::tpu::module(plan)?.module,
        "geometry" => hw::geometry::module(plan)?.module,
        "update" => hw::update::module(plan)?.module,
        "raycast" => return Ok(hw::emit(plan)?.design.apart()?),
        "cache" => hw::memory::cache::module("cache", &unit_cache::reference())?,
        "cast" => hw::chip::cast::module(&hw::Plan::new(&unit_cast::reference())?)?,
        "registers" => unit_registers::module(&hw::Plan::new(config)?)?,
        "commands" => {
            let config = unit_commands::reference();
            hw::chip::commands::module(&hw::Plan::new(&config)?, config.bus_data_bits)?
        }
        "motion" => hw::chip::motion::module(&hw::Plan::new(config)?)?,
        "axi" => unit_axi::module_of(&unit_axi::reference())?,
        "combiner" | "arbiter" | "reader" => unit_bus::module(&unit_bus::Sizes::reference())?,
        _ => bail!("unit {unit}: is not one of {}", UNITS.join(", ")),
    };
    Ok(Design::new(top)?.apart()?)
}

/// Selects mutants at random: the same number per unit, in turns of the kinds, and with equal probability for all places of a kind. A
/// module of two units is mutated in the first.
fn draw(config: &Config, request: &Request) -> Result<Vec<Population>> {
    let mut rng = fastrand::Rng::with_seed(request.seed);
    let mut seen: BTreeSet<String> = BTreeSet::new();
    let mut number = 0;
    let mut all = vec![];
    for (index, unit) in UNITS.into_iter().enumerate() {
        let design = design_of(config, unit)?;
        let mut places: Vec<Vec<Site>> = vec![vec![]; Kind::ALL.len()];
        for module in design.modules() {
            let only = only_modules(unit);
            if !only.is_empty() && !only.contains(&module.name()) {
                continue;
            }
            if !seen.insert(module.name().to_string()) {
                continue;
            }
            for site in module.mutations() {
                let kind = Kind::ALL.iter().position(|kind| *kind == site.kind);
                places[kind.expect("every kind is listed")].push(site);
            }
        }
        let share =
            request.mutants / OF_CORE + u32::from((index as u32) < request.mutants % OF_CORE);
        let mut drawn = vec![];
        let mut kind = 0;
        while (drawn.len() as u32) < share && places.iter().any(|places| !places.is_empty()) {
            let of_kind = &mut places[kind % Kind::ALL.len()];
            kind += 1;
            if of_kind.is_empty() {
                continue;
            }
            let site = of_kind.swap_remove(rng.usize(..of_kind.len()));
            number += 1;
            drawn.push((number, site));
        }
        all.push(Population {
            unit,
            design,
            drawn,
        });
    }
    for unit in &request.units {
        ensure!(
            UNITS.contains(&&**unit),
            "unit {unit}: is not one of {}",
            UNITS.join(", ")
        );
    }
    if !request.units.is_empty() {
        all.retain(|population| request.units.iter().any(|unit| unit == population.unit));
    }
    if let Some(only) = request.only {
        for population in &mut all {
            population.drawn.retain(|(number, _)| *number == only);
        }
    }
    all.retain(|population| !population.drawn.is_empty());
    ensure!(
        !all.is_empty(),
        "there is no such mutant: {number} were drawn with seed {}",
        request.seed
    );
    Ok(all)
}

/// The result of a run.
#[derive(Default)]
struct Ended {
    /// The first mismatch.
    mismatch: Option<String>,
    /// Number of cycles, including those before a reset in the middle of traffic.
    clocks: u64,
}

impl From<UnitReport> for Ended {
    fn from(report: UnitReport) -> Ended {
        Ended {
            mismatch: report.mismatch,
            clocks: report.cycles,
        }
    }
}

/// A run of a unit with a mutant.
type Run<'a> = (String, Box<dyn Fn(Play) -> Result<Ended> + Sync + 'a>);

/// The settings of a run.
#[derive(Clone, Default)]
struct Play {
    mutated: Option<Mutated>,
    /// Traffic before the run, which its first reset interrupts.
    interrupted: Option<Interrupted>,
    record: Option<Recorder>,
}

impl Play {
    /// Cycles of the interrupted traffic, including the one in which the reset begins.
    fn interrupted_clocks(&self) -> u64 {
        (self.interrupted.as_ref()).map_or(0, |interrupted| interrupted.at as u64 + 1)
    }

    /// The same run of the same model without a mutant.
    fn without_mutant(mut self) -> Play {
        if let Some(mutated) = &mut self.mutated {
            mutated.selected = 0;
        }
        self
    }

    fn options(self, seed: u64) -> UnitOptions {
        UnitOptions {
            mutated: self.mutated,
            interrupted: self.interrupted,
            record: self.record,
            ..UnitOptions::new(seed)
        }
    }
}

/// The number of repetitions of each of the shortest runs after a reset in the middle of traffic. Most faults of a reset show early or never.
const INTERRUPTIONS: u64 = 24;

/// Scenes of two levels with their rays, for whole machines.
struct Scenes(Vec<(MemoryImage, Vec<Ray>)>);

impl Scenes {
    fn new(config: &Config, count: usize, rays: usize, seed: u64) -> Result<Scenes> {
        let mut rng = fastrand::Rng::with_seed(seed);
        let scenes = (0..count).map(|_| instanced_scene(config, rays, &mut rng));
        scenes.collect::<Result<_>>().map(Scenes)
    }
}

/// The kinds of runs of a unit.
fn kinds_of(unit: &str) -> &'static [&'static str] {
    match unit {
        "arithmetic" => &["operands"],
        "tpu" => &["packets", "instances"],
        "geometry" => &["tests", "transforms", "skins"],
        "update" => &["programs"],
        "cache" => &["requests"],
        "axi" => &["bursts"],
        "cast" => &["casts"],
        "registers" => &["accesses"],
        "commands" => &["lists"],
        "motion" => &["motions"],
        "combiner" | "arbiter" | "reader" => &["traffic"],
        _ => &["rays", "skins"],
    }
}

/// A run of a unit that is not in the core.
fn run_outside_core(
    config: &Config,
    kind: &str,
    length: u64,
    options: &UnitOptions,
) -> Result<Ended> {
    Ok(match kind {
        "requests" => unit_cache::run(&unit_cache::reference(), length, options)?
            .unit
            .into(),
        "casts" => unit_cast::run(&unit_cast::reference(), length / 4, options)?.into(),
        "accesses" => unit_registers::run(config, length, options)?.into(),
        "lists" => unit_commands::run(&unit_commands::reference(), length, options)?.into(),
        "motions" => unit_motion::run(config, length, options)?.into(),
        "bursts" => unit_axi::run(&unit_axi::reference(), length / 4, options)?.into(),
        _ => unit_bus::run(&unit_bus::Sizes::reference(), length, options)?.into(),
    })
}

/// The runs of a unit, the shortest first. `whole` is a model of the whole machine with the same mutants, for the runs that need it.
fn runs<'a>(
    config: &'a Config,
    unit: &str,
    lengths: usize,
    whole: Option<Arc<Design>>,
) -> Result<Vec<Run<'a>>> {
    let mut all: Vec<Run<'a>> = vec![];
    for (seed, &length) in (1u64..).zip(&LENGTHS[..lengths]) {
        for &kind in kinds_of(unit) {
            let name = format!("{kind} {length}");
            let run: Box<dyn Fn(Play) -> Result<Ended> + Sync> = match kind {
                "operands" => Box::new(move |play: Play| {
                    unit_arithmetic::run(config, 20 * length, &play.options(seed))?;
                    Ok(Ended::default())
                }),
                "packets" => Box::new(move |play: Play| {
                    let workload = Workload::Coincidences {
                        transactions: length,
                    };
                    Ok(unit_tpu::run(config, workload, &play.options(seed))?.into())
                }),
                "instances" => Box::new(move |play: Play| {
                    let workload = Workload::Instances {
                        transactions: length,
                    };
                    Ok(unit_tpu::run(config, workload, &play.options(seed))?.into())
                }),
                "tests" => Box::new(move |play: Play| {
                    let workload = Workload::Coincidences {
                        transactions: length,
                    };
                    Ok(unit_geometry::run(config, workload, &play.options(seed))?.into())
                }),
                "transforms" => Box::new(move |play: Play| {
                    let workload = Workload::Instances {
                        transactions: length / 2,
                    };
                    let options = play.options(seed);
                    Ok(unit_geometry::run_transform(config, workload, &options)?.into())
                }),
                "programs" => Box::new(move |play: Play| {
                    let workload = unit_update::Workload::Random {
                        instructions: length,
                    };
                    let options = play.options(seed);
                    let traffic = unit_update::Traffic::Separate;
                    let report = unit_update::run(config, workload, traffic, &options)?;
                    Ok(report.unit.into())
                }),
                "requests" | "casts" | "accesses" | "lists" | "motions" | "bursts" | "traffic" => {
                    Box::new(move |play: Play| {
                        run_outside_core(config, kind, length, &play.options(seed))
                    })
                }
                "rays" => {
                    let count = 1 + length as usize / 4000;
                    let scenes = Scenes::new(config, count, 600, seed)?;
                    Box::new(move |play: Play| {
                        let mut unit = RaycastUnit::mutated(config, play.mutated.as_ref())?;
                        if let Some(interrupted) = &play.interrupted {
                            unit.interrupt(interrupted)?;
                        }
                        if play.record.is_some() {
                            unit.record();
                        }
                        let mut clocks = play.interrupted_clocks();
                        for (number, (image, rays)) in scenes.0.iter().enumerate() {
                            let stall = [0.0, 0.3][number % 2];
                            let options = raycast::Options {
                                seed: seed + number as u64,
                                ray_stall: stall,
                                hit_stall: stall,
                                ..raycast::Options::default()
                            };
                            clocks += unit.cast(image, rays, &options, &|_| ())?.cycles;
                        }
                        if let Some(recorder) = &play.record {
                            unit.recorded(recorder);
                        }
                        Ok(Ended {
                            mismatch: None,
                            clocks,
                        })
                    })
                }
                _ => {
                    let whole = whole.clone();
                    Box::new(move |play: Play| {
                        let workload = unit_skinning::Workload::Random {
                            vertices: length / 4,
                        };
                        let in_whole = |mutated: Mutated| match &whole {
                            Some(design) => Mutated {
                                design: design.clone(),
                                ..mutated
                            },
                            None => mutated,
                        };
                        let options = Play {
                            mutated: play.mutated.clone().map(in_whole),
                            ..play
                        }
                        .options(seed);
                        let traffic = unit_skinning::Traffic::Separate;
                        let report = unit_skinning::run(config, workload, traffic, &options)?;
                        Ok(report.unit.into())
                    })
                }
            };
            all.push((name, run));
        }
    }
    Ok(all)
}

/// The reason why a run stopped early.
enum Stopped {
    /// A mismatch, which the mutant has caused.
    Differs(String),
    /// An error, or a failed check of the bench. A mutant may violate an assumption of the bench, such as that the number of a packet
    /// is valid; but the cause may also be unrelated, such as a full disk.
    Breaks(String),
}

impl Stopped {
    fn said(self) -> String {
        match self {
            Stopped::Differs(said) | Stopped::Breaks(said) => said,
        }
    }
}

/// The result of a run: its number of cycles since the last reset, or the reason why it stopped, in one line.
fn told(run: &Run<'_>, play: Play) -> Result<u64, Stopped> {
    let interrupted = play.interrupted_clocks();
    let line = |said: &str| said.lines().next().unwrap_or("stopped").to_string();
    match catch_unwind(AssertUnwindSafe(|| (run.1)(play))) {
        Ok(Ok(Ended {
            mismatch: None,
            clocks,
        })) => Ok(clocks - interrupted),
        Ok(Ok(Ended {
            mismatch: Some(mismatch),
            ..
        })) => Err(Stopped::Differs(line(&mismatch))),
        Ok(Err(error)) => Err(Stopped::Breaks(line(&format!("{error:#}")))),
        Err(_) => Err(Stopped::Breaks("the bench's own check fails".into())),
    }
}

/// The difference between a run with a mutant and the same run without one, which took the given number of cycles.
///
/// # Errors
/// If the run also stops without the mutant, so that the mutant is not decided.
fn noticed(run: &Run<'_>, play: Play, clocks: u64) -> Result<Option<String>> {
    let said = match told(run, play.clone()) {
        Ok(now) if now == clocks => return Ok(None),
        Ok(now) => return Ok(Some(format!("{now} cycles, not {clocks}"))),
        Err(Stopped::Differs(said)) => return Ok(Some(said)),
        Err(Stopped::Breaks(said)) => said,
    };
    match told(run, play.without_mutant()) {
        Ok(now) if now == clocks => Ok(Some(said)),
        Ok(now) => bail!(
            "{}: takes {now} cycles without a mutant, but took {clocks} before",
            run.0
        ),
        Err(stopped) => bail!("{}: fails without a mutant: {}", run.0, stopped.said()),
    }
}

/// Selects mutants and runs them. `progress` receives a line per step; `done` receives the number of finished mutants and the total.
///
/// # Errors
/// If a tool is missing, if the machine fails without a mutant, or if there is no such unit or mutant.
pub fn mutate(
    config: &Config,
    request: &Request,
    progress: &dyn Fn(&str),
    done: &(dyn Fn(usize, usize) + Sync),
) -> Result<Report> {
    ensure!(request.mutants > 0, "--mutants 0: nothing would be checked");
    let populations = draw(config, request)?;
    let total = populations.iter().map(|p| p.drawn.len()).sum();
    let store = Store::open_in(request.cache.clone(), "mutants")?;
    let mut mutants: Vec<Mutant> = vec![];
    let mut remembered = 0;
    for population in &populations {
        let before = mutants.len();
        let told = |count| done(before + count, total);
        let (of_unit, known) = run_unit(config, request, population, &store, progress, &told)?;
        mutants.extend(of_unit);
        remembered += known;
    }
    Ok(Report {
        seed: request.seed,
        remembered,
        mutants,
    })
}

/// The outcomes of a unit's mutants, and the number of those that were stored.
fn run_unit(
    config: &Config,
    request: &Request,
    population: &Population,
    store: &Store,
    progress: &dyn Fn(&str),
    done: &(dyn Fn(usize) + Sync),
) -> Result<(Vec<Mutant>, usize)> {
    let Population {
        unit,
        design,
        drawn,
    } = population;
    let selectable = population.selectable(design)?;
    let machine = match *unit {
        "geometry" => Some(design_of(config, "raycast")?),
        _ => None,
    };
    let whole = machine.as_ref().map(|whole| population.selectable(whole));
    let whole = whole.transpose()?;
    let verilog = |design: &Design| -> String {
        let modules = design.modules().iter();
        modules.map(|module| module.verilog()).collect()
    };
    let (texts, around) = (
        verilog(design),
        machine.as_ref().map_or(String::new(), verilog),
    );
    let key = |number: u32| -> String {
        let (_, site) = drawn.iter().find(|d| d.0 == number).expect("drawn");
        // The mutant's number is the seed for the cycles of its resets.
        let place = format!("{number} {:?} {}", site.mutation, request.lengths);
        store::key(&[CHECKS, *unit, &place, &config.to_toml(), &around, &texts])
    };
    let known = |number: u32| store.get::<Outcome>(unit, &key(number));
    let runs = runs(config, unit, request.lengths, whole)?;
    let remembered = match request.only {
        None => drawn.iter().filter(|d| known(d.0).is_some()).count(),
        Some(_) => 0,
    };
    let all_known = remembered == drawn.len();
    let select = |selected| Play {
        mutated: Some(Mutated {
            design: selectable.clone(),
            selected,
        }),
        ..Play::default()
    };
    let shortest = runs.len().checked_div(request.lengths).unwrap_or(0);
    let mut traffic: Vec<Option<Arc<Recording>>> = vec![];
    let mut clocks = vec![];
    if !all_known {
        progress(&format!("building {unit} with {} mutants", drawn.len()));
        for run in &runs {
            let recorder = Recorder::default();
            let play = Play {
                record: Some(recorder.clone()),
                ..select(0)
            };
            match told(run, play) {
                Ok(taken) => clocks.push(taken),
                Err(stopped) => bail!(
                    "{unit}, {}: fails without a mutant: {}",
                    run.0,
                    stopped.said()
                ),
            }
            traffic.push(recorder.take());
        }
    }
    // The unit `arithmetic` has no traffic and no reset.
    let interruptions = |number: u32| {
        let mut rng = fastrand::Rng::with_seed(u64::from(number));
        let mut all = vec![];
        for (run, traffic) in traffic.iter().enumerate().take(shortest) {
            for _ in 0..INTERRUPTIONS {
                if let Some(traffic) = traffic {
                    let at = rng.usize(traffic.len() / 8..traffic.len());
                    let traffic = traffic.clone();
                    all.push((run, Interrupted { traffic, at }));
                }
            }
        }
        all
    };
    if !all_known {
        for (run, interrupted) in interruptions(0) {
            let after = interrupted.at;
            let play = Play {
                interrupted: Some(interrupted),
                ..select(0)
            };
            if let Some(said) = noticed(&runs[run], play, clocks[run])? {
                bail!(
                    "{unit}, {}, after a reset in cycle {after}: fails without a mutant: {said}",
                    runs[run].0
                );
            }
        }
        progress(&format!(
            "{unit} passes without a mutant; running the mutants"
        ));
    }
    let noticed_by = |number: u32| -> Option<Result<Outcome>> {
        let outcome = |run: String, how: Result<Option<String>>| {
            let how = how.transpose()?;
            Some(how.map(|how| Outcome::Noticed { run, how }))
        };
        let by = |run: usize| {
            outcome(
                runs[run].0.clone(),
                noticed(&runs[run], select(number), clocks[run]),
            )
        };
        let amid = |(run, interrupted): (usize, Interrupted)| {
            let name = format!("{}, after a reset in cycle {}", runs[run].0, interrupted.at);
            let play = Play {
                interrupted: Some(interrupted),
                ..select(number)
            };
            outcome(name, noticed(&runs[run], play, clocks[run]))
        };
        ((0..shortest).find_map(by))
            .or_else(|| interruptions(number).into_iter().find_map(amid))
            .or_else(|| (shortest..runs.len()).find_map(by))
    };
    let finished = std::sync::atomic::AtomicUsize::new(0);
    let outcomes: Vec<(u32, Outcome)> = drawn
        .par_iter()
        .map(|(number, site)| {
            let outcome = match known(*number).filter(|_| request.only.is_none()) {
                Some(outcome) => outcome,
                None => {
                    let outcome = match noticed_by(*number) {
                        Some(outcome) => outcome?,
                        None => survivor(request, design, &site.mutation, &runs)?,
                    };
                    store.put(unit, &key(*number), &outcome)?;
                    outcome
                }
            };
            done(1 + finished.fetch_add(1, std::sync::atomic::Ordering::Relaxed));
            Ok((*number, outcome))
        })
        .collect::<Result<_>>()?;
    let describe = |(number, outcome): (u32, Outcome)| {
        let (_, site) = (drawn.iter().find(|d| d.0 == number)).context("a mutant")?;
        Ok(Mutant {
            number,
            unit,
            module: site.mutation.module().to_string(),
            line: site.line,
            kind: site.kind,
            before: site.before.clone(),
            after: site.after.clone(),
            outcome,
        })
    };
    let mutants = outcomes.into_iter().map(describe).collect::<Result<_>>()?;
    Ok((mutants, remembered))
}

fn survivor(
    request: &Request,
    design: &Design,
    mutation: &Mutation,
    runs: &[Run<'_>],
) -> Result<Outcome> {
    if request.prove
        && let Some(proof) = equivalence::proved(design, mutation)?
    {
        return Ok(Outcome::Equivalent { proof });
    }
    Ok(Outcome::Survived {
        runs: runs.iter().map(|run| run.0.clone()).collect(),
    })
}
