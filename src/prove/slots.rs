//! Proves that slots of a pipeline are independent: the outputs of a slot depend only on the inputs of the same slot.
//!
//! Slots of the triangle test are used for transformations and skinning (`hw/share.rs`), and slots of all kinds follow each other
//! in any order. In the gates of the emitted module, including registers, every path from an input to an output must have as many
//! registers as the difference of their stages. Then an output in a cycle is a function of the inputs of a single slot, including the
//! input that gives the kind of the slot, and independent of the slots before and after it.
//!
//! The arithmetic units inside are replaced by one gate of all their operands, followed by as many registers as their latency. Their
//! own proofs show that their paths have equal lengths.

use super::aig::Circuit;
use super::{Outcome, Seeded, tools};
use crate::config::Config;
use crate::emit;
use crate::hdl::{Direction, Module, Mutation};
use anyhow::{Context, Result, ensure};
use std::fmt::Write as _;
use std::path::Path;
use std::sync::Arc;

/// A pipelined module whose slots are kept apart.
pub struct Slots {
    pub module: Arc<Module>,
    pub what: String,
    pub faults: Vec<Seeded<Mutation>>,
}

/// The prefix of arithmetic units' names.
const ARITHMETIC: &str = "fp_";

/// The proof for the triangle test of a machine.
///
/// # Errors
/// If the machine's description has a mistake, or if the test has no stage to remove for a fault.
pub fn proofs(unit: &str, config: &Config) -> Result<Vec<Slots>> {
    if unit != "slots" {
        return Ok(vec![]);
    }
    let design = emit::machine(config)?.design;
    let test = design
        .modules()
        .iter()
        .find(|m| m.name() == "triangle_test");
    let module = test.context("the machine has a triangle test")?.clone();
    let seeded = |what: &str, input: &str| -> Result<Seeded<Mutation>> {
        let mut instances = module.instances().into_iter();
        let given = instances.find_map(|instance| instance.input(input).ok());
        let given = given.with_context(|| format!("no part of the test has an input {input}"))?;
        Ok(Seeded {
            what: what.into(),
            change: given.one_clock_late(),
        })
    };
    let faults = vec![
        seeded("the test's kind is a slot late", "matrix")?,
        seeded("sums are chosen by the kind of a slot before", "accumulate")?,
    ];
    Ok(vec![Slots {
        what:
            "the outputs of a slot depend only on its own inputs, for any use of the neighbouring slots"
                .into(),
        faults,
        module,
    }])
}

impl Slots {
    /// Checks every path. Returns the number of output bits.
    ///
    /// # Errors
    /// If a tool fails, or if a fault cannot be made.
    pub fn prove(&self, folder: &Path, fault: Option<usize>) -> Result<(usize, Outcome)> {
        let changed = fault.map(|fault| self.module.with(&self.faults[fault].change));
        let module = changed.transpose()?.unwrap_or(self.module.clone());
        let mut texts = vec![module.verilog().to_string()];
        let mut names = vec![];
        add_children(&self.module, &mut names, &mut texts);
        std::fs::write(folder.join("slots.v"), texts.concat()).context("slots.v")?;
        tools::yosys(
            folder,
            &format!(
                "read_verilog slots.v; hierarchy -check -top {}; proc; flatten; opt -nodffe -nosdff; techmap; \
                 opt -nodffe -nosdff; aigmap; opt_clean; write_aiger -ascii -symbols slots.aag",
                self.module.name()
            ),
        )?;
        let aiger = std::fs::read_to_string(folder.join("slots.aag")).context("slots.aag")?;
        let stage = |word: &str| {
            let port = self.module.port(word);
            port.and_then(|port| port.stage).unwrap_or(0)
        };
        let outputs = self.module.ports().iter();
        let bits: u32 = outputs
            .filter(|port| port.direction == Direction::Output)
            .map(|port| port.width)
            .sum();
        ensure!(bits > 0, "{} has no outputs", self.module.name());
        Ok(match Circuit::parse(&aiger)?.staged(stage, stage) {
            Ok(_) => (bits as usize, Outcome::Proved),
            Err(error) => (0, Outcome::Refuted(format!("{error:#}"))),
        })
    }
}

/// Collects the Verilog of all modules below a module, each once, with arithmetic units as registers.
fn add_children(module: &Module, names: &mut Vec<String>, texts: &mut Vec<String>) {
    for child in module.children() {
        if names.iter().any(|name| name == child.name()) {
            continue;
        }
        names.push(child.name().to_string());
        if child.name().starts_with(ARITHMETIC) {
            texts.push(registers(child));
        } else {
            texts.push(child.verilog().to_string());
            add_children(child, names, texts);
        }
    }
}

/// A replacement for a unit: one gate of all its operands, then registers.
fn registers(unit: &Module) -> String {
    let (mut ports, mut operands, mut body) = (vec![], vec![], String::new());
    for port in unit.ports() {
        let (name, last) = (&port.name, port.width - 1);
        if port.direction == Direction::Input {
            ports.push(format!("  input wire [{last}:0] {name}"));
            if name != "clk" {
                operands.push(format!("^{name}"));
            }
        }
    }
    for port in unit.ports() {
        let (name, last) = (&port.name, port.width - 1);
        if port.direction == Direction::Output {
            ports.push(format!("  output wire [{last}:0] {name}"));
            let latency = port.stage.unwrap_or(0);
            let _ = writeln!(body, "  wire {name}_0 = {};", operands.join(" ^ "));
            for stage in 1..=latency {
                let _ = writeln!(
                    body,
                    "  reg {name}_{stage};\n  always @(posedge clk) {name}_{stage} <= {name}_{};",
                    stage - 1
                );
            }
            let _ = writeln!(
                body,
                "  assign {name} = {{{}{{{name}_{latency}}}}};",
                port.width
            );
        }
    }
    format!(
        "module {} (\n{}\n);\n{body}endmodule\n",
        unit.name(),
        ports.join(",\n")
    )
}
