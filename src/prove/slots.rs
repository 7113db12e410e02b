//! Slots of a pipeline never meet: what comes out of one is made of what went into the same one.
//!
//! The triangle test is lent, slot by slot, to transformations and to skinning (`hw/share.rs`), and slots of all kinds follow each other
//! in any order. On the gates of the emitted module, registers included, every path from an input to an output is checked to have as many
//! registers as their stages are apart. So an output at a clock is a function of the inputs of one slot alone, the one that says whose
//! slot it is among them, whatever is in the slots before and behind it.
//!
//! The arithmetic units within are replaced by registers, as many as their latency, behind one gate of all of their operands: that their
//! own paths are of one length is part of their proofs.

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

/// What the names of arithmetic units begin with.
const ARITHMETIC: &str = "fp_";

/// The triangle test of a machine.
///
/// # Errors
/// A mistake in the machine's description; a test that has no stage to leave out.
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
    /// Checks every path. Returns how many output bits there are.
    ///
    /// # Errors
    /// A tool that fails; a fault that cannot be made.
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

/// The texts of all below a module, arithmetic units as registers, each once.
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

/// A unit's registers behind one gate of all of its operands.
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
