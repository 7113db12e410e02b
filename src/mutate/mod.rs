//! Mutants: single changes of the emitted Verilog, which co-simulation must notice.
//!
//! All mutants of a unit are compiled into one model, in which an input selects one ([`Design::selectable`]); with none selected it is the
//! machine as it is, and passes. Each mutant then runs through what the unit's tests run, and is noticed at the first bit that differs, when
//! the unit stops, when its own checks fail, or when the run takes another number of clocks than without a mutant, as fixed frames do
//! in [`crate::baseline`]. What survives is tried for equivalence (`equivalence`) and otherwise listed.
//!
//! | unit | modules | runs |
//! |---|---|---|
//! | `arithmetic` | adder, subtractor, multiplier, reciprocal, plane distances | operands, each result |
//! | `tpu` | traversal unit and below | packets in tiny scenes of one and of two levels |
//! | `geometry` | geometry unit and below, what the traversal unit has too left out | triangle tests, ray transformations; skinned meshes in the whole machine, which borrows its operators |
//! | `update` | update processor and its prefetch | programs of random topologies |
//! | `raycast` | ray setup, skinning processor, what joins the units | whole small scenes of two levels; random skinned meshes |
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
    raycast, unit_arithmetic, unit_axi, unit_bus, unit_geometry, unit_skinning, unit_tpu,
    unit_update,
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

/// The units, whose modules are mutated.
pub const UNITS: [&str; 9] = [
    "arithmetic",
    "tpu",
    "geometry",
    "update",
    "raycast",
    "axi",
    "combiner",
    "arbiter",
    "reader",
];

/// The module that is mutated of a unit of the memory system; its neighbours are there for its bench.
fn only_module(unit: &str) -> Option<&'static str> {
    match unit {
        "axi" => Some("axi_master"),
        "combiner" => Some("write_combiner"),
        "arbiter" => Some("read_arbiter"),
        "reader" => Some("burst_reader_16"),
        _ => None,
    }
}

/// Transactions of a mutant's runs: most are noticed in the first, what is left goes on to the last.
const LENGTHS: [u64; 3] = [2_000, 30_000, 200_000];

/// What to do.
#[derive(Clone, Debug)]
pub struct Request {
    pub mutants: u32,
    pub seed: u64,
    /// Of [`UNITS`]; all, if there is none.
    pub units: Vec<String>,
    /// This mutant alone, by its number from 1 on.
    pub only: Option<u32>,
    /// Whether survivors are tried for equivalence.
    pub prove: bool,
    /// How many run lengths each survivor runs, of those that there are.
    pub lengths: usize,
    /// The cache folder; `None` for the user's.
    pub cache: Option<PathBuf>,
}

impl Request {
    /// All units, everything tried.
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

/// What became of a mutant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase", tag = "outcome")]
pub enum Outcome {
    /// The run, and the first line of what it said.
    Noticed { run: String, how: String },
    /// No difference can ever be seen at the module's ports: what showed it.
    Equivalent { proof: String },
    /// The runs that it passed.
    Survived { runs: Vec<String> },
}

/// A mutant.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Mutant {
    /// From 1 on, for [`Request::only`].
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

/// What became of all.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    pub seed: u64,
    /// Of how many the outcome was known from a run before.
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

    /// Noticed, of those not proved equivalent, in percent.
    pub fn share_percent(&self) -> f64 {
        self.noticed() as f64 * 100.0 / (self.mutants.len() - self.equivalent()).max(1) as f64
    }
}

/// A unit with the mutants drawn of it.
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
        "axi" => unit_axi::module_of(&unit_axi::reference())?,
        "combiner" | "arbiter" | "reader" => unit_bus::module(&unit_bus::Sizes::reference())?,
        _ => bail!("unit {unit}: is not one of {}", UNITS.join(", ")),
    };
    Ok(Design::new(top)?.apart()?)
}

/// Draws mutants: as many of each unit, in a unit by turns of each kind, in a kind of any place alike. A module that two units have is
/// mutated in the first.
fn draw(config: &Config, request: &Request) -> Result<Vec<Population>> {
    let mut rng = fastrand::Rng::with_seed(request.seed);
    let mut seen: BTreeSet<String> = BTreeSet::new();
    let mut number = 0;
    let mut all = vec![];
    for (index, unit) in UNITS.into_iter().enumerate() {
        let design = design_of(config, unit)?;
        let mut places: Vec<Vec<Site>> = vec![vec![]; Kind::ALL.len()];
        for module in design.modules() {
            if only_module(unit).is_some_and(|only| only != module.name()) {
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
        let units = UNITS.len() as u32;
        let share = request.mutants / units + u32::from((index as u32) < request.mutants % units);
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

/// What a run came to.
#[derive(Default)]
struct Ended {
    /// What does not agree.
    mismatch: Option<String>,
    /// Those of the traffic that its first reset has ended, too.
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

/// How a run is done.
#[derive(Clone, Default)]
struct Play {
    mutated: Option<Mutated>,
    /// Traffic before it, which its first reset interrupts.
    interrupted: Option<Interrupted>,
    record: Option<Recorder>,
}

impl Play {
    /// Clocks of the traffic that a reset ends, with the one in which it begins.
    fn interrupted_clocks(&self) -> u64 {
        (self.interrupted.as_ref()).map_or(0, |interrupted| interrupted.at as u64 + 1)
    }

    /// The same run of the same model, no mutant selected.
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

/// Times that each of the shortest runs is done once more, after a reset amid its traffic: of what a reset leaves, most shows soon or never.
const INTERRUPTIONS: u64 = 24;

/// Scenes of two levels and rays into them, for whole machines.
struct Scenes(Vec<(MemoryImage, Vec<Ray>)>);

impl Scenes {
    fn new(config: &Config, count: usize, rays: usize, seed: u64) -> Result<Scenes> {
        let mut rng = fastrand::Rng::with_seed(seed);
        let scenes = (0..count).map(|_| instanced_scene(config, rays, &mut rng));
        scenes.collect::<Result<_>>().map(Scenes)
    }
}

/// The runs of a unit, the shortest first. Those that need more than the unit have `whole`, with the same mutants.
fn runs<'a>(
    config: &'a Config,
    unit: &str,
    lengths: usize,
    whole: Option<Arc<Design>>,
) -> Result<Vec<Run<'a>>> {
    let mut all: Vec<Run<'a>> = vec![];
    for (seed, &length) in (1u64..).zip(&LENGTHS[..lengths]) {
        let kinds: &[&str] = match unit {
            "arithmetic" => &["operands"],
            "tpu" => &["packets", "instances"],
            "geometry" => &["tests", "transforms", "skins"],
            "update" => &["programs"],
            "axi" => &["bursts"],
            "combiner" | "arbiter" | "reader" => &["traffic"],
            _ => &["rays", "skins"],
        };
        for &kind in kinds {
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
                "bursts" => Box::new(move |play: Play| {
                    let (bus, options) = (unit_axi::reference(), play.options(seed));
                    Ok(unit_axi::run(&bus, length / 4, &options)?.into())
                }),
                "traffic" => Box::new(move |play: Play| {
                    let (sizes, options) = (unit_bus::Sizes::reference(), play.options(seed));
                    Ok(unit_bus::run(&sizes, length, &options)?.into())
                }),
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

/// Why a run did not come to its end.
enum Stopped {
    /// A mismatch: the mutant's doing.
    Differs(String),
    /// An error, or a check of the bench's own: a mutant may break what a bench takes for granted, such as that a packet has a number
    /// that exists. But a full disk says no more.
    Breaks(String),
}

impl Stopped {
    fn said(self) -> String {
        match self {
            Stopped::Differs(said) | Stopped::Breaks(said) => said,
        }
    }
}

/// What made a run end: nothing, after so many clocks from its last reset on, or what stopped it, a line.
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

/// How a run with a mutant differs from one of so many clocks without.
///
/// # Errors
/// What breaks the run breaks it without the mutant too: the mutant has not been told.
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

/// Draws mutants and runs them. `progress` is told what is going on; `done` how many mutants of how many are through.
///
/// # Errors
/// A tool that is missing; a machine that fails without any mutant; no such unit or mutant.
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

/// What became of a unit's mutants, and of how many that was known.
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
        // A mutant's number seeds when its resets come.
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
    // What the unit of arithmetic has is no traffic, and it has no reset.
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
