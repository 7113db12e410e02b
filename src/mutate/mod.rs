//! Mutants: single changes of the emitted Verilog, which co-simulation must notice.
//!
//! All mutants of a unit are compiled into one model, in which an input selects one ([`text`]); with none selected it is the machine
//! as it is, and passes. Each mutant then runs through what the unit's tests run, and is noticed at the first bit that differs, when
//! the unit stops, when its own checks fail, or when the run takes another number of clocks than without a mutant, as fixed frames do
//! in [`crate::baseline`]. What survives is tried for equivalence ([`equivalence`]) and otherwise listed.
//!
//! | unit | modules | runs |
//! |---|---|---|
//! | `arithmetic` | adder, subtractor, multiplier, reciprocal, plane distances | operands, each result |
//! | `tpu` | traversal unit and below | packets in tiny scenes of one and of two levels |
//! | `geometry` | geometry unit and below, what the traversal unit has too left out | triangle tests, ray transformations; skinned meshes in the whole machine, which borrows its operators |
//! | `update` | update processor and its prefetch | programs of random topologies |
//! | `raycast` | ray setup, skinning processor, what joins the units | whole small scenes of two levels; random skinned meshes |

mod equivalence;
mod next_state;
pub mod text;

pub use text::Kind;

use crate::bkd::layout::MemoryImage;
use crate::config::Config;
use crate::cosim::model::Recording;
use crate::cosim::raycast::RaycastUnit;
use crate::cosim::scoreboard::{Interrupted, Mutated, Recorder, UnitOptions, UnitReport};
use crate::cosim::workload::{Workload, instanced_scene};
use crate::cosim::{raycast, unit_arithmetic, unit_geometry, unit_skinning, unit_tpu, unit_update};
use crate::hdl::{Design, Module};
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
use text::{SELECT, Site, instrument, sites};

/// The units, whose modules are mutated.
pub const UNITS: [&str; 5] = ["arithmetic", "tpu", "geometry", "update", "raycast"];

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
    /// How many of [`LENGTHS`] survivors run.
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
    /// Its modules, the unit last.
    modules: Vec<Arc<Module>>,
    /// What stands around them for the run, name and text, where that is no module of the machine.
    around: Option<(&'static str, String)>,
    /// Number, index of the module, change.
    drawn: Vec<(u32, usize, Site)>,
}

/// A unit's modules, and what stands around them.
type Modules = (Vec<Arc<Module>>, Option<(&'static str, String)>);

fn modules_of(config: &Config, unit: &str) -> Result<Modules> {
    if unit == unit_arithmetic::TOP {
        let (modules, around) = unit_arithmetic::modules(config)?;
        return Ok((modules, Some((unit_arithmetic::TOP, around))));
    }
    let plan = || hw::Plan::new(config);
    let top = match unit {
        "tpu" => hw::tpu::module(&plan()?)?.module,
        "geometry" => hw::geometry::module(&plan()?)?.module,
        "update" => hw::update::module(&plan()?)?.module,
        "raycast" => hw::emit(config)?.design.top().clone(),
        _ => bail!("unit {unit}: is not one of {}", UNITS.join(", ")),
    };
    Ok((Design::new(top)?.modules().to_vec(), None))
}

/// Draws mutants: as many of each unit, in a unit by turns of each kind, in a kind of any place alike. A module that two units have is
/// mutated in the first.
fn draw(config: &Config, request: &Request) -> Result<Vec<Population>> {
    let mut rng = fastrand::Rng::with_seed(request.seed);
    let mut seen: BTreeSet<String> = BTreeSet::new();
    let mut number = 0;
    let mut all = vec![];
    for (index, unit) in UNITS.into_iter().enumerate() {
        let (modules, around) = modules_of(config, unit)?;
        let mut places: Vec<Vec<(usize, Site)>> = vec![vec![]; Kind::ALL.len()];
        for (at, module) in modules.iter().enumerate() {
            if !seen.insert(module.name().to_string()) {
                continue;
            }
            for site in sites(module.verilog()) {
                let kind = Kind::ALL.iter().position(|kind| *kind == site.kind);
                places[kind.expect("every kind is listed")].push((at, site));
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
            let (at, site) = of_kind.swap_remove(rng.usize(..of_kind.len()));
            number += 1;
            drawn.push((number, at, site));
        }
        all.push(Population {
            unit,
            modules,
            around,
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
            population.drawn.retain(|(number, ..)| *number == only);
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

type Files = Arc<Vec<(String, String)>>;

/// The whole machine's Verilog around a unit's with mutants.
fn whole_machine(config: &Config, unit: &[(String, String)]) -> Result<Files> {
    let machine = hw::emit(config)?;
    let modules = machine.design.modules();
    let names: Vec<&str> = modules.iter().map(|module| module.name()).collect();
    let file = |module: &Arc<Module>| {
        let name = format!("{}.v", module.name());
        let of_unit = unit.iter().find(|(other, _)| *other == name).cloned();
        of_unit.unwrap_or_else(|| (name, instrument(module.verilog(), &[], &names)))
    };
    Ok(Arc::new(modules.iter().map(file).collect()))
}

/// The runs of a unit, the shortest first. Those that need more than the unit have `whole`, with the same mutants.
fn runs<'a>(
    config: &'a Config,
    unit: &str,
    lengths: usize,
    whole: Option<Files>,
) -> Result<Vec<Run<'a>>> {
    let mut all: Vec<Run<'a>> = vec![];
    for (seed, &length) in (1u64..).zip(&LENGTHS[..lengths]) {
        let kinds: &[&str] = match unit {
            "arithmetic" => &["operands"],
            "tpu" => &["packets", "instances"],
            "geometry" => &["tests", "transforms", "skins"],
            "update" => &["programs"],
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
                            Some(files) => Mutated {
                                files: files.clone(),
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
        Ok(now) => return Ok(Some(format!("{now} clocks, not {clocks}"))),
        Err(Stopped::Differs(said)) => return Ok(Some(said)),
        Err(Stopped::Breaks(said)) => said,
    };
    match told(run, play.without_mutant()) {
        Ok(now) if now == clocks => Ok(Some(said)),
        Ok(now) => bail!(
            "{}: takes {now} clocks without any mutant, and took {clocks} before",
            run.0
        ),
        Err(stopped) => bail!("{}: fails without any mutant: {}", run.0, stopped.said()),
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
        modules,
        around,
        drawn,
    } = population;
    let texts: Vec<String> = modules
        .iter()
        .map(|module| module.verilog().to_string())
        .collect();
    let names: Vec<&str> = modules.iter().map(|module| module.name()).collect();
    let mut files: Vec<(String, String)> = (modules.iter().zip(&texts).enumerate())
        .map(|(at, (module, text))| {
            let of_module = drawn.iter().filter(|(_, module, _)| *module == at);
            let changes: Vec<_> = of_module.map(|(number, _, site)| (*number, site)).collect();
            (
                format!("{}.v", module.name()),
                instrument(text, &changes, &names),
            )
        })
        .collect();
    if let Some((name, text)) = around {
        files.push((format!("{name}.v"), instrument(text, &[], &names)));
    }
    let files = Arc::new(files);
    let whole = match *unit {
        "geometry" => Some(whole_machine(config, &files)?),
        _ => None,
    };
    let around = match &whole {
        Some(_) => {
            let machine = hw::emit(config)?;
            let modules = machine.design.modules();
            modules.iter().map(|module| module.verilog()).collect()
        }
        None => around
            .as_ref()
            .map(|(_, text)| text.clone())
            .unwrap_or_default(),
    };
    let key = |number: u32| -> String {
        let (_, at, site) = drawn.iter().find(|d| d.0 == number).expect("drawn");
        // A mutant's number seeds when its resets come.
        let place = format!(
            "{number} {:?} {} {}",
            site.place, site.instead, request.lengths
        );
        let config = config.to_toml();
        let mut parts = vec![CHECKS, *unit, names[*at], &place, &config, &around];
        parts.extend(texts.iter().map(String::as_str));
        store::key(&parts)
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
            files: files.clone(),
            port: SELECT,
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
                    "{unit}, {}: fails without any mutant: {}",
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
                    "{unit}, {}, after a reset {after} clocks into its traffic: fails without any mutant: {said}",
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
            let name = format!(
                "{}, after a reset {} clocks into its traffic",
                runs[run].0, interrupted.at
            );
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
    // Modules are not to be shared between threads; their texts are.
    let outcomes: Vec<(u32, Outcome)> = drawn
        .par_iter()
        .map(|(number, at, site)| {
            let outcome = match known(*number).filter(|_| request.only.is_none()) {
                Some(outcome) => outcome,
                None => {
                    let outcome = match noticed_by(*number) {
                        Some(outcome) => outcome?,
                        None => survivor(request, &texts, &names, *at, site, &runs)?,
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
        let (_, at, site) = (drawn.iter().find(|d| d.0 == number)).context("a mutant")?;
        let text = &texts[*at];
        let plain = |text: &str| text.split_whitespace().collect::<Vec<_>>().join(" ");
        Ok(Mutant {
            number,
            unit,
            module: names[*at].to_string(),
            line: site.line(text),
            kind: site.kind,
            before: plain(&text[site.expression.clone()]),
            after: plain(&site.changed(text)),
            outcome,
        })
    };
    let mutants = outcomes.into_iter().map(describe).collect::<Result<_>>()?;
    Ok((mutants, remembered))
}

fn survivor(
    request: &Request,
    texts: &[String],
    names: &[&str],
    at: usize,
    site: &Site,
    runs: &[Run<'_>],
) -> Result<Outcome> {
    if request.prove
        && let Some(proof) = equivalence::proved(texts, names, at, site)?
    {
        return Ok(Outcome::Equivalent { proof });
    }
    Ok(Outcome::Survived {
        runs: runs.iter().map(|run| run.0.clone()).collect(),
    })
}
