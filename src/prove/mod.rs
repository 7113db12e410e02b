//! Proofs about the emitted Verilog, by open tools.
//!
//! Arithmetic units (`arithmetic`) are compared with an exact reference for all operands. A pipeline with operator sharing keeps its
//! slots apart (`slots`). A machine is the same with and without trace ports (`trace`). Queues, credits, stack and ports
//! (`induction`) are proved by induction. Every proof has *seeded faults*: changes of the module, each of which must refute the
//! proof with a counterexample. A proof that a tool leaves undecided counts as failed.

mod aig;
mod arithmetic;
mod cast;
mod chip;
pub mod formal;
mod induction;
mod memory;
mod reference;
mod slots;
pub(crate) mod tools;
mod trace;

use crate::config::Config;
use crate::temporary;
use anyhow::{Context, Result, bail, ensure};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::{Arc, mpsc};
use std::time::Instant;

/// What can be proved, with what it is.
pub const UNITS: [(&str, &str); 25] = [
    ("add", "fp_add: the sum of any two operands"),
    ("sub", "fp_sub: the difference of any two operands"),
    ("mul", "fp_mul: the product of any two operands"),
    ("reciprocal", "fp_reciprocal: the reciprocal of any operand"),
    (
        "compare",
        "less, less or equal, equal, min, max of any two operands",
    ),
    ("step", "steps of three ulps from any operand"),
    (
        "slots",
        "the triangle test: own and borrowed slots never meet",
    ),
    (
        "fifo",
        "every queue: order, no loss, no duplicate, no overflow",
    ),
    (
        "prefetch",
        "every prefetcher: order, slots, ports, no deadlock",
    ),
    (
        "credit",
        "the update processor: credits, ports, no deadlock",
    ),
    (
        "skin",
        "the skinning processor: credits, write queue, ports, no deadlock",
    ),
    (
        "geometry",
        "the geometry unit: leaves, vertices, rays, ports, no deadlock",
    ),
    (
        "tpu",
        "the traversal unit: packets, queues, ports, arbitration",
    ),
    (
        "stack",
        "the traversal unit's stack: a pop reads the pushed entry",
    ),
    (
        "share",
        "the ray casting unit: packet numbers, tags, sharing of the geometry unit and its port",
    ),
    ("trace", "the core: the same with trace ports and without"),
    (
        "cache",
        "a small cache: tags, lists, lines, lookups, ports, no deadlock",
    ),
    (
        "axi",
        "the AXI4 master: the rules of the bus, in front of any slave that obeys its own",
    ),
    (
        "combiner",
        "the write combiner: bytes and their order, lines, no deadlock",
    ),
    (
        "arbiter",
        "the read arbiter: bursts unchanged, rotation, routing of beats",
    ),
    (
        "reader",
        "burst readers: room in the buffer, blocks, ports, no deadlock",
    ),
    (
        "cast",
        "the cast unit: rays, packets, answers in order, writes, ports, no deadlock",
    ),
    (
        "registers",
        "the register file and the event counters: accesses, doorbells, interrupts, snapshots",
    ),
    (
        "commands",
        "the command processor: order, waits, errors, ports, no deadlock",
    ),
    (
        "motion",
        "the motion unit: one processor at a time, rows in order, words of records, no deadlock",
    ),
];

/// The outcome of a proof.
#[derive(Clone, PartialEq, Eq, Debug)]
pub enum Outcome {
    Proved,
    /// A counterexample, in one line.
    Refuted(String),
    /// The reason why there is neither a proof nor a counterexample, which counts as a failure.
    Undecided(String),
}

/// A fault that a proof must detect.
#[derive(Clone, Debug)]
pub struct Seeded<Change> {
    pub what: String,
    pub change: Change,
}

/// The proofs to run.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// Names from [`UNITS`]; empty for all.
    pub units: Vec<String>,
    /// Whether to prove only a selection of the sums' cases, in a few minutes in total; all other proofs are complete.
    pub quick: bool,
    /// Whether to run every seeded fault, one at a time, instead of the original design.
    pub plant: bool,
}

/// The outcome of one proof, or of one seeded fault.
#[derive(Clone, Debug)]
pub struct Row {
    pub unit: &'static str,
    pub module: String,
    pub what: String,
    /// The seeded fault.
    pub fault: Option<String>,
    pub how: String,
    /// Number of cases proved: properties in an induction, outputs in a comparison of variants.
    pub cases: usize,
    pub seconds: f64,
    pub outcome: Outcome,
}

impl Row {
    /// Whether the outcome is as required: proved, or refuted for a seeded fault.
    pub fn holds(&self) -> bool {
        matches!(
            (&self.fault, &self.outcome),
            (None, Outcome::Proved) | (Some(_), Outcome::Refuted(_))
        )
    }
}

/// Checks that every name is one of [`UNITS`], and that the tools are installed.
///
/// # Errors
/// One line with an unknown name and the known ones, or with a tool that is missing or too old.
pub fn check(names: &[String]) -> Result<()> {
    for name in names {
        if !UNITS.iter().any(|(unit, _)| unit == name) {
            let all: Vec<&str> = UNITS.iter().map(|(unit, _)| *unit).collect();
            bail!(
                "{name}: nothing of this name can be proved; use {}",
                all.join(", ")
            );
        }
    }
    tools::tools().map(drop)
}

/// Runs the requested proofs for the machine of a configuration. `started` receives each proof's name, `done`
/// receives each row.
///
/// # Errors
/// If a unit does not exist, if a tool is missing or fails, or if a fault cannot be made. A failed proof is a row, not an error.
pub fn run(
    config: &Config,
    options: &Options,
    started: &dyn Fn(&str),
    done: &mut dyn FnMut(&Row),
) -> Result<Vec<Row>> {
    check(&options.units)?;
    let jobs = jobs(config, options)?;
    ensure!(!jobs.is_empty(), "nothing was proved");
    let (sender, told) = mpsc::channel();
    let mut rows = vec![];
    std::thread::scope(|scope| {
        let proofs = scope.spawn(move || {
            let jobs = jobs.into_iter().enumerate().par_bridge();
            jobs.try_for_each_with(sender, |tell, (place, job)| {
                // The receiver is gone if the run has failed.
                let row = job.row(options, &|| drop(tell.send(Told::Started(job.name()))))?;
                let _ = tell.send(Told::Ended(place, row));
                anyhow::Ok(())
            })
        });
        // Rows are in the order of the proofs, independent of which one ends first.
        let mut early = BTreeMap::new();
        for told in told {
            match told {
                Told::Started(name) => started(&name),
                Told::Ended(place, row) => drop(early.insert(place, row)),
            }
            while let Some(row) = early.remove(&rows.len()) {
                done(&row);
                rows.push(row);
            }
        }
        let ended = proofs.join();
        ended.unwrap_or_else(|panic| std::panic::resume_unwind(panic))
    })?;
    Ok(rows)
}

/// Progress of a proof.
enum Told {
    Started(String),
    /// The index of the proof, and its outcome.
    Ended(usize, Row),
}

/// A proof of the original design, or of the design with one of the proof's faults.
struct Job {
    unit: &'static str,
    subject: Arc<Subject>,
    /// The index of the fault.
    fault: Option<usize>,
}

/// The requested proofs, in order.
fn jobs(config: &Config, options: &Options) -> Result<Vec<Job>> {
    let mut jobs = vec![];
    for (unit, _) in UNITS {
        if !options.units.is_empty() && !options.units.iter().any(|name| name == unit) {
            continue;
        }
        for subject in subjects(unit, config)? {
            ensure!(
                !subject.faults().is_empty(),
                "{unit}, {}: no fault would show that this proof can fail",
                subject.what()
            );
            let subject = Arc::new(subject);
            let faults: Vec<Option<usize>> = match options.plant {
                true => (0..subject.faults().len()).map(Some).collect(),
                false => vec![None],
            };
            jobs.extend(faults.into_iter().map(|fault| Job {
                unit,
                subject: subject.clone(),
                fault,
            }));
        }
    }
    Ok(jobs)
}

impl Job {
    fn name(&self) -> String {
        format!("{}: {}", self.unit, self.subject.what())
    }

    /// Runs the proof. `started` is called when it begins, and when a part of it begins.
    fn row(&self, options: &Options, started: &dyn Fn()) -> Result<Row> {
        started();
        let folder = temporary::Folder::new().context("a temporary folder")?;
        let row = (self.subject).row(self.unit, folder.path(), options, self.fault, started);
        row.with_context(|| format!("{}, {}", self.unit, self.subject.module()))
    }
}

/// A proof of one of the kinds.
enum Subject {
    Equivalence(arithmetic::Equivalence),
    Slots(slots::Slots),
    Induction(induction::Induction),
    Trace(trace::Variants),
}

fn subjects(unit: &str, config: &Config) -> Result<Vec<Subject>> {
    let equivalences = arithmetic::proofs(unit, config.format(), config.clock_mhz)?;
    let inductions = induction::proofs(unit, config)?;
    let equivalences = equivalences.into_iter().map(Subject::Equivalence);
    let slots = slots::proofs(unit, config)?.into_iter().map(Subject::Slots);
    let variants = trace::proofs(unit, config)?;
    Ok(equivalences
        .chain(slots)
        .chain(inductions.into_iter().map(Subject::Induction))
        .chain(variants.into_iter().map(Subject::Trace))
        .collect())
}

impl Subject {
    /// Descriptions of its faults.
    fn faults(&self) -> Vec<&str> {
        fn names<T>(faults: &[Seeded<T>]) -> Vec<&str> {
            faults.iter().map(|fault| fault.what.as_str()).collect()
        }
        match self {
            Subject::Equivalence(proof) => names(&proof.faults),
            Subject::Slots(proof) => names(&proof.faults),
            Subject::Induction(proof) => proof.faults().collect(),
            Subject::Trace(proof) => names(&proof.faults),
        }
    }

    fn what(&self) -> &str {
        match self {
            Subject::Equivalence(proof) => &proof.what,
            Subject::Slots(proof) => &proof.what,
            Subject::Induction(proof) => &proof.proof.what,
            Subject::Trace(_) => trace::WHAT,
        }
    }

    fn module(&self) -> &str {
        match self {
            Subject::Equivalence(proof) => proof.module.name(),
            Subject::Slots(proof) => proof.module.name(),
            Subject::Induction(proof) => proof.module.name(),
            Subject::Trace(proof) => proof.plain.top().name(),
        }
    }

    fn row(
        &self,
        unit: &'static str,
        folder: &Path,
        options: &Options,
        fault: Option<usize>,
        done: &dyn Fn(),
    ) -> Result<Row> {
        let clock = Instant::now();
        let (how, (cases, outcome)) = match self {
            Subject::Equivalence(proof) => (
                proof.how(),
                proof.prove(folder, options.quick, fault, done)?,
            ),
            Subject::Slots(proof) => (
                "every path's registers".to_string(),
                proof.prove(folder, fault)?,
            ),
            Subject::Induction(proof) => (proof.how(), proof.prove(folder, fault)?),
            Subject::Trace(proof) => proof.prove(fault)?,
        };
        Ok(Row {
            unit,
            module: self.module().to_string(),
            what: self.what().to_string(),
            fault: fault.map(|fault| self.faults()[fault].to_string()),
            how,
            cases,
            seconds: clock.elapsed().as_secs_f64(),
            outcome,
        })
    }
}
