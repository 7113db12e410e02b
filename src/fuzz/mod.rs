//! Random machines: each is generated, linted by three tools, and co-simulated unit by unit and as a whole.
//!
//! A [`Case`] is a configuration and the sizes of its workload, both generated from a seed. It passes through [`Stage`]s.
//! The first failure ends the run, and [`shrink`] searches for the simplest case that fails in the same stage. Machine
//! number k of seed S is the first machine of seed S + k, so a seed is sufficient to repeat a machine.
//!
//! Passed machines are stored in the cache under a hash of the case and of all its Verilog. An interrupted run resumes where
//! it stopped, and a machine whose Verilog has changed is checked again.

mod case;
mod scene;
mod shrink;
mod stages;

pub use case::{Case, Size, Sizes};
pub use scene::RandomFilm;
pub use shrink::{Shrunk, shrink};
pub use stages::{Checked, Failure, Stage, Workbench};

use crate::cache;
use crate::config::Config;
use crate::hdl::HdlError;
use crate::hw::{self, Plan};
use crate::synth::store::CHECKS;
use anyhow::{Context, Result, ensure};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::time::Instant;

/// The machines to check, and the checks.
#[derive(Clone, Debug)]
pub struct Options {
    /// Seed of the first machine; it increases by one per machine.
    pub seed: u64,
    /// Number of machines, at least 1.
    pub machines: u32,
    /// Stages to run; at least one.
    pub stages: Vec<Stage>,
    /// If given, this machine is checked with different workloads, instead of random machines.
    pub config: Option<Config>,
    /// Sizes that replace random ones, as `NAME=VALUE`.
    pub sizes: Vec<String>,
    /// Whether to check machines again that have passed before.
    pub again: bool,
    /// Maximum number of cases to try while shrinking; 0: do not shrink.
    pub shrink_attempts: usize,
}

impl Options {
    /// All stages for the given number of random machines.
    pub fn new(seed: u64, machines: u32) -> Options {
        Options {
            seed,
            machines,
            stages: Stage::ALL.into(),
            config: None,
            sizes: vec![],
            again: false,
            shrink_attempts: 80,
        }
    }

    /// The machines, in order.
    ///
    /// # Errors
    /// If a size is invalid.
    pub fn cases(&self) -> Result<Vec<Case>> {
        (0..self.machines).map(|number| self.case(number)).collect()
    }

    fn case(&self, number: u32) -> Result<Case> {
        let mut case = Case::random(self.seed.wrapping_add(u64::from(number)));
        if let Some(config) = &self.config {
            case.config = config.clone();
        }
        for size in &self.sizes {
            case.sizes.parse(size)?;
        }
        Ok(case)
    }
}

/// A machine that has passed.
#[derive(Clone, Debug)]
pub struct Passed {
    pub case: Case,
    pub checked: Vec<Checked>,
    /// Duration of its checks when they were run.
    pub seconds: f64,
    /// Whether an earlier run checked it.
    pub remembered: bool,
}

/// A machine that has failed.
#[derive(Clone, Debug)]
pub struct Failed {
    pub case: Case,
    pub failure: Failure,
    /// The simplest case found that fails in the same stage, its failure, and the number of cases tried.
    pub shrunk: Case,
    pub shrunk_failure: Failure,
    pub attempts: usize,
}

/// Progress of a run.
pub enum Event<'a> {
    /// A machine, counted from 0, starts a stage.
    Enters(u32, &'a Case, Stage),
    Passed(u32, &'a Passed),
    /// The machine has failed, and shrinking starts.
    Failed(u32, &'a Case, &'a Failure),
    /// The number of cases tried so far, and the simplest one that fails.
    Shrinks(usize, &'a Case),
}

/// The result of a run.
#[derive(Clone, Debug, Default)]
pub struct Report {
    pub passed: Vec<Passed>,
    /// The first failed machine; the run ended there.
    pub failed: Option<Failed>,
}

impl Report {
    /// Number of files, tools and results that passed, over all machines.
    pub fn checked(&self) -> u64 {
        let checked = self.passed.iter().flat_map(|passed| &passed.checked);
        checked.map(|checked| checked.count).sum()
    }

    /// The same for one stage.
    pub fn checked_in(&self, stage: Stage) -> u64 {
        let checked = self.passed.iter().flat_map(|passed| &passed.checked);
        let of_stage = checked.filter(|checked| checked.stage == stage);
        of_stage.map(|checked| checked.count).sum()
    }
}

/// Checks machines one after another until one fails.
///
/// # Errors
/// If nothing is to be checked, if a size is invalid, or if a tool is missing. A failing machine is no error here; it is in the report.
pub fn run(
    bench: &Workbench,
    options: &Options,
    told: &mut dyn FnMut(Event<'_>),
) -> Result<Report> {
    ensure!(
        options.machines > 0 && !options.stages.is_empty(),
        "there is no machine or no stage to check: nothing would be checked"
    );
    let memory = Memory::open()?;
    let mut report = Report::default();
    for number in 0..options.machines {
        let case = options.case(number)?;
        let key = Memory::key(&case, &options.stages);
        let recalled = match (&key, options.again) {
            (Some(key), false) => memory.recall(key, &options.stages),
            _ => None,
        };
        if let Some((checked, seconds)) = recalled {
            report.passed.push(Passed {
                case,
                checked,
                seconds,
                remembered: true,
            });
        } else {
            let started = Instant::now();
            let shared = std::cell::RefCell::new(&mut *told);
            let enters = |stage| (shared.borrow_mut())(Event::Enters(number, &case, stage));
            let outcome = bench.check(&case, &options.stages, &enters);
            match outcome {
                Ok(checked) => {
                    let seconds = started.elapsed().as_secs_f64();
                    if let Some(key) = &key {
                        memory.remember(key, &case, &checked, seconds)?;
                    }
                    report.passed.push(Passed {
                        case,
                        checked,
                        seconds,
                        remembered: false,
                    });
                }
                Err(failure) => {
                    told(Event::Failed(number, &case, &failure));
                    report.failed = Some(plainest(bench, options, case, failure, told));
                    bench.clear();
                    return Ok(report);
                }
            }
            bench.clear();
        }
        told(Event::Passed(
            number,
            &report.passed[report.passed.len() - 1],
        ));
    }
    Ok(report)
}

/// Shrinks a failing case while it fails in the same stage.
fn plainest(
    bench: &Workbench,
    options: &Options,
    case: Case,
    failure: Failure,
    told: &mut dyn FnMut(Event<'_>),
) -> Failed {
    let stage = failure.stage;
    let mut shrunk_failure = failure.clone();
    let (mut attempts, mut best) = (0, case.clone());
    let shrunk = shrink(&case, options.shrink_attempts, |other| {
        attempts += 1;
        let outcome = bench.check(other, &[stage], &|_| ());
        if let Err(found) = &outcome {
            shrunk_failure = found.clone();
            best = other.clone();
        }
        told(Event::Shrinks(attempts, &best));
        outcome.is_err()
    });
    Failed {
        case,
        failure,
        shrunk: shrunk.case,
        shrunk_failure,
        attempts: shrunk.attempts,
    }
}

/// The passed machines, one file per machine in the cache.
struct Memory {
    folder: PathBuf,
}

impl Memory {
    fn open() -> Result<Memory> {
        let folder = cache::folder(None)?.join("fuzz");
        std::fs::create_dir_all(&folder).with_context(|| {
            format!(
                "cannot create {}; set DYNRT_CACHE to a folder that can be written",
                folder.display()
            )
        })?;
        Ok(Memory { folder })
    }

    /// The key of everything on which a machine's checks depend; `None` if the machine cannot be generated.
    fn key(case: &Case, stages: &[Stage]) -> Option<String> {
        let emitted = std::panic::catch_unwind(|| {
            let plan = Plan::new(&case.config)?;
            let traced = hw::core::emit(&plan.clone().with_trace(true))?;
            Ok::<_, HdlError>([hw::core::emit(&plan)?, traced, hw::chip::emit(&plan)?])
        });
        let machines = emitted.ok()?.ok()?;
        let files = machines.map(|machine| machine.design.files()).concat();
        let (config, seed, sizes) = (
            case.config.to_toml(),
            case.seed.to_string(),
            format!("{:?}", case.sizes),
        );
        let mut parts = vec![CHECKS, &config, &seed, &sizes];
        parts.extend(stages.iter().map(|stage| stage.name()));
        parts.extend(files.iter().flat_map(|(name, text)| [&**name, &**text]));
        Some(cache::key(&parts))
    }

    fn path(&self, key: &str) -> PathBuf {
        self.folder.join(format!("{key}.json"))
    }

    /// The stored results of a machine and their duration; `None` unless they are complete.
    fn recall(&self, key: &str, stages: &[Stage]) -> Option<(Vec<Checked>, f64)> {
        let text = std::fs::read_to_string(self.path(key)).ok()?;
        let value: Value = serde_json::from_str(&text).ok()?;
        let stages = Stage::ALL.into_iter().filter(|s| stages.contains(s));
        let checked = stages.map(|stage| {
            let count = value["checked"][stage.name()].as_u64()?;
            (count > 0).then_some(Checked { stage, count })
        });
        Some((checked.collect::<Option<_>>()?, value["seconds"].as_f64()?))
    }

    fn remember(&self, key: &str, case: &Case, checked: &[Checked], seconds: f64) -> Result<()> {
        let mut value = json!({ "seed": case.seed, "seconds": seconds, "checked": {} });
        for Checked { stage, count } in checked {
            value["checked"][stage.name()] = json!(count);
        }
        let path: &Path = &self.path(key);
        crate::report::json(path, &value)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_knows_a_case_by_all_that_it_depends_on() {
        let folder = tempfile::tempdir().unwrap();
        let memory = Memory {
            folder: folder.path().into(),
        };
        let stages = [Stage::Lint, Stage::Tpu];
        let case = Case::random(5);
        let key = Memory::key(&case, &stages).unwrap();
        assert!(memory.recall(&key, &stages).is_none());
        let checked = [3, 70].into_iter().zip(stages);
        let checked: Vec<_> = (checked.map(|(count, stage)| Checked { stage, count })).collect();
        memory.remember(&key, &case, &checked, 1.5).unwrap();
        assert_eq!(memory.recall(&key, &stages), Some((checked, 1.5)));
        // A stage that was not run is not stored as passed.
        assert!(memory.recall(&key, &Stage::ALL).is_none());

        let mut others = vec![(Case::random(6), &stages[..]), (case.clone(), &stages[..1])];
        let mut other = case.clone();
        other
            .sizes
            .set(Size::Triangles, 25 - case.sizes.get(Size::Triangles));
        others.push((other, &stages));
        let mut other = case.clone();
        other.config.memory_latency = 101 - case.config.memory_latency;
        others.push((other, &stages));
        for (case, stages) in others {
            assert_ne!(Memory::key(&case, stages).unwrap(), key);
        }
        std::fs::write(memory.path(&key), "{\"seed\": 5, \"chec").unwrap();
        assert!(memory.recall(&key, &stages).is_none());
    }

    #[test]
    fn the_machines_of_a_seed_are_those_of_the_seeds_that_follow() {
        let options = Options::new(40, 3);
        for number in 0..3 {
            assert_eq!(
                options.case(number).unwrap(),
                Case::random(40 + u64::from(number))
            );
        }
    }
}
