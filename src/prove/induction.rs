//! Properties of units, by induction: queues, credits, the stack, ports.
//!
//! The units describe their properties ([`crate::hdl::Proof`]) next to their hardware, in `src/hw`. This module lists the proofs and the
//! machine of each. Yosys converts a module with its properties to a transition system. `yosys-smtbmc` with z3 shows that no property
//! fails in the first cycles after reset, and that if all hold for a number of cycles they also hold in the next one. Therefore they
//! always hold. Logic on which the properties do not depend is removed.

use super::{Outcome, cast, chip, memory, tools};
use crate::config::Config;
use crate::emit;
use crate::hdl::{Design, Module, ProofFacts};
use crate::hw::memory::cache;
use crate::tools::Ended;
use anyhow::{Context, Result, ensure};
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

/// Time limit of z3 for each of base and step.
const LIMIT: Duration = Duration::from_secs(240);

/// Number of cycles after reset within which the covers must be reached.
pub(super) const SOON: u32 = 40;

/// The last stage of a proof, which shows that it is not vacuous.
const HAPPENS: &str = "what can happen";

/// Properties with one name, in all modules whose names start with it, or end with it if it starts with `_`.
struct Wanted {
    unit: &'static str,
    modules: &'static str,
    proof: &'static str,
    /// Keys with other values than in the given machine. A solver has difficulties with the sum over nine deep queues; the
    /// description is the same for any number of packets.
    few: &'static [(&'static str, u32)],
}

const FEW_PACKETS: &[(&str, u32)] = &[("packets.in_flight", 4)];

/// Not a power of two, so that the wrap-around of the write queue is included.
const FEW_VERTICES: &[(&str, u32)] = &[("skinning.vertices_waiting", 6)];

const fn wanted(
    unit: &'static str,
    modules: &'static str,
    proof: &'static str,
    few: &'static [(&'static str, u32)],
) -> Wanted {
    Wanted {
        unit,
        modules,
        proof,
        few,
    }
}

const WANTED: &[Wanted] = &[
    wanted("fifo", "fifo_", "order", &[]),
    wanted("fifo", "block_fifo_", "order", &[]),
    wanted("prefetch", "_prefetch", "order", &[]),
    wanted("credit", "update_processor", "credit", &[]),
    wanted("skin", "skinning_processor", "conserves", &[]),
    wanted("skin", "skinning_processor", "write_queue", FEW_VERTICES),
    wanted("geometry", "geometry_unit", "conserves", FEW_PACKETS),
    wanted("tpu", "tpu", "packets", FEW_PACKETS),
    wanted("tpu", "tpu", "choices", &[]),
    wanted("stack", "tpu", "stack", &[]),
    wanted("share", "raycast_unit", "shares", FEW_PACKETS),
];

/// The cache's, which has no parameter of the machine's: of a small one in distributed RAM and in block RAM.
pub(super) const CACHE: &str = "cache";
const OF_CACHE: [&str; 3] = ["lists", "lines", "records"];

fn caches() -> Result<Vec<Induction>> {
    let mut found = vec![];
    for (name, in_block_ram) in [("cache", false), ("block_cache", true)] {
        let module = cache::module(name, &cache::small(in_block_ram))?;
        for wanted in OF_CACHE {
            let mut proofs = module.proofs().into_iter();
            let proof = proofs.find(|proof| proof.name == wanted);
            found.push(Induction {
                proof: proof
                    .with_context(|| format!("a cache has no properties called {wanted}"))?,
                module: module.clone(),
                few: &[],
            });
        }
    }
    Ok(found)
}

/// The properties of one proof, of one module.
pub struct Induction {
    pub module: Arc<Module>,
    pub proof: ProofFacts,
    /// Keys with other values than in the given machine.
    pub few: &'static [(&'static str, u32)],
}

/// The proof of this name of a module that is an instance for the proof.
///
/// # Errors
/// If the module has no properties of this name.
pub(super) fn of_module(unit: &str, module: Arc<Module>, name: &str) -> Result<Induction> {
    let mut proofs = module.proofs().into_iter();
    let proof = proofs.find(|proof| proof.name == name);
    let proof = proof.with_context(|| format!("{unit}: the module has no proof {name}"))?;
    Ok(Induction {
        module,
        proof,
        few: &[],
    })
}

/// All inductions of the unit with this name; empty if the unit has none.
///
/// # Errors
/// If the machine's description has a mistake, or if a module no longer has the properties.
pub fn proofs(unit: &str, config: &Config) -> Result<Vec<Induction>> {
    if unit == CACHE {
        return caches();
    }
    let mut found = memory::proofs(unit)?;
    found.extend(cast::proofs(unit)?);
    found.extend(chip::proofs(unit, config)?);
    for wanted in WANTED.iter().filter(|wanted| wanted.unit == unit) {
        let mut config = config.clone();
        for (key, value) in wanted.few {
            config.set(key, &value.to_string())?;
        }
        let machine = emit::machine(&config)?;
        let before = found.len();
        for module in machine.design.modules() {
            let is_wanted = match wanted.modules.strip_prefix('_') {
                Some(_) => module.name().ends_with(wanted.modules),
                None => module.name().starts_with(wanted.modules),
            };
            let proofs = module.proofs().into_iter();
            let proofs = proofs.filter(|proof| is_wanted && proof.name == wanted.proof);
            found.extend(proofs.map(|proof| Induction {
                module: module.clone(),
                proof,
                few: wanted.few,
            }));
        }
        ensure!(
            found.len() > before,
            "the machine has no module {} with properties called {}",
            wanted.modules,
            wanted.proof
        );
    }
    Ok(found)
}

impl Induction {
    /// Descriptions of its seeded faults.
    pub fn faults(&self) -> impl Iterator<Item = &str> {
        self.proof.faults.iter().map(|(what, _)| what.as_str())
    }

    /// The method of the proof, for reports.
    pub fn how(&self) -> String {
        format!("z3, induction, depth {}", self.proof.depth)
    }

    /// Yosys' commands that convert a file with the properties to a transition system.
    pub fn script(&self, file: &str, top: &str, cut: &[String]) -> String {
        let memory = match self.proof.arrays {
            true => "memory_collect",
            false => "memory -nordff",
        };
        let cut: Vec<_> = cut.iter().map(|name| format!("w:{name}")).collect();
        let cut = match cut.is_empty() {
            true => String::new(),
            false => format!("cutpoint {}; ", cut.join(" ")),
        };
        format!(
            "read_verilog -formal -sv {file}; hierarchy -check -top {top}; proc; flatten; {cut}delete -output o:*; \
             opt -purge -nodffe -nosdff; {memory}; opt -purge -nodffe -nosdff; dffunmap; opt_clean -purge"
        )
    }

    /// Proves all properties by induction, or finds one that fails.
    ///
    /// # Errors
    /// If a tool fails, or if a fault cannot be made.
    pub fn prove(&self, folder: &Path, fault: Option<usize>) -> Result<(usize, Outcome)> {
        let module = match fault {
            // A fault may be one of a module below.
            Some(fault) => {
                let design = Design::new(self.module.clone())?;
                let changed = design.with(&self.proof.faults[fault].1)?;
                changed.top().clone()
            }
            None => self.module.clone(),
        };
        let formal = module.formal(&self.proof.name, &str::to_string)?;
        std::fs::write(folder.join("proof.sv"), &formal.text).context("proof.sv")?;
        let write = match self.proof.arrays {
            true => "write_smt2",
            false => "write_smt2 -nomem",
        };
        let script = self.script("proof.sv", self.module.name(), &formal.cut);
        tools::yosys(folder, &format!("{script}; {write} proof.smt2"))?;
        // The base must cover as many cycles as the step assumes, and as many as a seeded fault needs to show.
        let base = (self.proof.depth + 1).to_string();
        let depth = self.proof.depth.to_string();
        let soon = SOON.to_string();
        for (stage, stage_args) in [
            ("after reset", &["-t", &base][..]),
            ("a step of the induction", &["-t", &depth, "-i"]),
            (HAPPENS, &["-t", &soon, "-c"]),
        ] {
            let mut args = vec!["--noprogress", "-s", "z3"];
            args.extend(stage_args);
            if stage == HAPPENS {
                // Not incremental: z3 then simplifies before it searches, which is twenty times as fast for the stack's arrays.
                args.extend(["--noincr", "--unroll"]);
            } else if !self.proof.arrays {
                args.push("--unroll");
            }
            args.push("proof.smt2");
            let text = match tools::tools()?.smtbmc.run_for(folder, LIMIT, &args)? {
                Ended::With { text, .. } => text,
                Ended::OutOfTime => {
                    let limit = LIMIT.as_secs();
                    let why = format!("{stage}: z3 takes more than {limit} s");
                    return Ok((0, Outcome::Undecided(why)));
                }
            };
            let mut lines = text.lines().rev();
            let last = lines.find(|line| line.contains("Status:"));
            let last = last.unwrap_or_default();
            if last.ends_with("FAILED") && stage == HAPPENS {
                let why = format!(
                    "{} is not reachable within {SOON} cycles after reset: the properties are vacuous",
                    self.proof.covers.join(", or ")
                );
                return Ok((0, Outcome::Undecided(why)));
            }
            if last.ends_with("FAILED") {
                let broken = self.broken(&text, &formal.asserts);
                return Ok((0, Outcome::Refuted(format!("{stage}: {broken}"))));
            }
            if !last.ends_with("PASSED") {
                let line = text
                    .lines()
                    .last()
                    .unwrap_or("smtbmc printed no status")
                    .trim();
                return Ok((0, Outcome::Undecided(format!("{stage}: {line}"))));
            }
        }
        Ok((self.proof.asserts.len(), Outcome::Proved))
    }

    /// The properties that smtbmc reports as failed, identified by their lines, and the cycle.
    fn broken(&self, text: &str, lines: &[usize]) -> String {
        let mut broken: Vec<&str> = vec![];
        for line in text.lines().filter(|line| line.contains("Assert failed")) {
            let number = line
                .split_once("proof.sv:")
                .and_then(|(_, rest)| rest.split(['.', '-']).nth(2));
            let number = number.and_then(|n| n.parse::<usize>().ok());
            let property = number.and_then(|n| lines.iter().position(|line| *line == n));
            broken.extend(property.map(|n| self.proof.asserts[n].as_str()));
        }
        broken.dedup();
        let step = text
            .lines()
            .rev()
            .find_map(|line| line.split_once(" in step ").map(|(_, n)| n));
        let clock = step.map_or(String::new(), |step| {
            format!(" in cycle {}", step.trim_end_matches('.'))
        });
        match broken.is_empty() {
            true => format!("a property fails{clock}"),
            false => format!("not so{clock}: {}", broken.join("; ")),
        }
    }
}
