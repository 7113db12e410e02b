//! Prints properties at the end of a module's text, for a prover or a simulator.

use super::super::ir::{Id, Netlist, Op, ProofData};
use super::super::outline::Outline;
use super::{Body, Printer, unmarked};
use std::collections::HashSet;
use std::fmt::Write as _;

/// A module's text with the properties of one proof.
pub(in super::super) struct WithProof {
    pub text: String,
    /// The positions in the text at which names of modules start.
    pub modules: Vec<usize>,
    /// The line of each assertion, counted from 1.
    pub asserts: Vec<usize>,
    /// The name under which each node is declared.
    pub names: Vec<Option<String>>,
}

/// The start of the properties of either kind: they hold from the cycle after the first cycle of a reset.
fn started(name: &str) -> String {
    format!("  reg  {name} = 1'b0;\n  always @(posedge clk) if (rst) {name} <= 1'b1;\n")
}

/// The macro that enables the checks in a simulator.
const CHECKS: &str = "DYNRT_CHECKS";

const END: &str = "\nendmodule\n";

/// Inserts a section before the end of the text.
fn insert(text: &str, section: &str) -> (String, usize) {
    let end = text.rfind(END).expect("a module has an end");
    let first = text[..end].lines().count();
    (format!("{}{section}{}", &text[..end], &text[end..]), first)
}

pub(in super::super) fn with_proof(ir: &Netlist, proof: &ProofData) -> WithProof {
    let mut printer = Printer::new(ir);
    let module = printer.module(&ir.name, &ir.doc);
    let stands = |id: &Id| printer.plan.stands[*id];
    let assumes: Vec<Id> = proof.assumes.iter().map(|(_, id)| stands(id)).collect();
    let asserts: Vec<Id> = proof.asserts.iter().map(|(_, id)| stands(id)).collect();
    let covers: Vec<Id> = proof.covers.iter().map(|(_, id)| stands(id)).collect();
    let roots = [assumes.clone(), asserts.clone(), covers.clone()].concat();
    let inside = |instance: usize, node: Id| {
        let instance = &ir.instances[instance];
        format!("\\{}.{} ", instance.name, instance.module.name_of(node))
    };
    let mut section = printer.beside(&roots, &inside, true);
    let started_name = printer.names.free("f_started".to_string());
    section += &started(&started_name);
    let _ = writeln!(section, "  always @* if (!{started_name}) assume (rst);");
    // Also in the first cycle of reset, which determines the registers of the next cycle.
    for ((what, _), id) in proof.assumes.iter().zip(&assumes) {
        let _ = writeln!(
            section,
            "  always @* assume ({}); // {what}",
            printer.part(*id)
        );
    }
    let _ = writeln!(section, "  always @* if ({started_name}) begin");
    let mut lines = vec![];
    for ((what, _), id) in proof.asserts.iter().zip(&asserts) {
        lines.push(section.lines().count() + 1);
        let _ = writeln!(section, "    assert ({}); // {what}", printer.part(*id));
    }
    for ((what, _), id) in proof.covers.iter().zip(&covers) {
        let _ = writeln!(section, "    cover ({}); // {what}", printer.part(*id));
    }
    section += "  end\n";
    let (text, first) = insert(
        &module,
        &format!("\n  // Proof: {}.\n{section}", proof.what),
    );
    let names = printer.signals();
    let (text, modules, _) = unmarked(&text);
    WithProof {
        text,
        modules,
        // After a blank line and a heading.
        asserts: lines.into_iter().map(|line| first + 2 + line).collect(),
        names: (0..names.len())
            .map(|id| names[printer.plan.stands[id]].clone())
            .collect(),
    }
}

/// Whether a node depends on a value that only a prover can choose.
fn of_any(printer: &Printer, root: Id) -> bool {
    let mut seen = HashSet::new();
    let mut open = vec![root];
    while let Some(id) = open.pop() {
        if matches!(printer.plan.ops[id], Op::AnyConst | Op::AnySeq) {
            return true;
        }
        if seen.insert(id) {
            open.extend(printer.plan.sources(id));
        }
    }
    false
}

/// The text with checks, and the positions at which names of modules start.
pub(in super::super) fn with_checks(
    ir: &Netlist,
    outline: Option<&Outline>,
) -> (String, Vec<usize>) {
    let mut printer = Printer::new(ir);
    let module = match outline {
        None => printer.module(&ir.name, &ir.doc),
        Some(outline) => {
            printer.look_into(outline);
            Printer::new(&outline.top.ir).module(&ir.name, &ir.doc)
        }
    };
    let mut checks: Vec<(String, Id)> = vec![];
    for proof in &ir.proofs {
        let assumes = proof.assumes.iter();
        let assumed = assumes.map(|(what, id)| (format!("assumed: {what}"), *id));
        for (what, id) in assumed.chain(proof.asserts.iter().cloned()) {
            let id = printer.plan.stands[id];
            let trivial = printer.plan.ops[id] == Op::Literal(1);
            if !trivial && !of_any(&printer, id) && !checks.iter().any(|(_, known)| *known == id) {
                checks.push((what, id));
            }
        }
    }
    if checks.is_empty() {
        let (text, modules, _) = unmarked(&module);
        return (text, modules);
    }
    let roots: Vec<Id> = checks.iter().map(|(_, id)| *id).collect();
    let owners = printer.plan.borders.as_ref().map(|borders| &borders.owners);
    let parts = owners.map(|owners| owners.instances.clone());
    let inside = |instance: usize, node: Id| {
        let part = parts.as_ref().map_or(0, |parts| parts[instance]);
        let instance = &ir.instances[instance];
        let name = format!("{}.{}", instance.name, instance.module.name_of(node));
        within(ir, part, &name)
    };
    let mut section = printer.beside(&roots, &inside, false);
    let started_name = printer.names.free("f_started".to_string());
    section += &started(&started_name);
    let _ = writeln!(section, "  always @(posedge clk) if ({started_name}) begin");
    for (what, id) in &checks {
        let _ = writeln!(
            section,
            "    if (!({})) begin\n      $display(\"%m: not so: {what}\");\n      $stop;\n    end",
            printer.part(*id)
        );
    }
    section += "  end\n";
    let section = format!(
        "\n`ifdef {CHECKS}\n  // Properties of the module and assumptions on its environment, checked in every cycle\n  // after a reset.\n{section}`endif\n"
    );
    let (text, modules, _) = unmarked(&insert(&module, &section).0);
    (text, modules)
}

/// The hierarchical name of `name` in a part, seen from the module that instantiates it.
fn within(ir: &Netlist, part: usize, name: &str) -> String {
    match part {
        0 => name.to_string(),
        part => format!("{}.{name}", ir.parts[part - 1].name),
    }
}

impl Printer<'_> {
    /// Names the nodes in parts, seen from the module that instantiates them.
    fn look_into(&mut self, outline: &Outline) {
        let modules = [&outline.top].into_iter().chain(&outline.parts);
        let printers: Vec<_> = modules.map(|module| Printer::new(&module.ir)).collect();
        let within = |part: usize, name: &str| within(self.plan.ir, part, name);
        // A node that crosses a boundary also has a name outside, which is found first.
        let place = |id: &Id| {
            let numbers = outline.numbers.iter().enumerate();
            let mut places = numbers.filter_map(|(part, of)| Some((part, *of.get(id)?)));
            places.find(|(part, number)| {
                let plan = &printers[*part].plan;
                plan.declared[*number] || plan.in_line[*number].is_some()
            })
        };
        for id in 0..self.plan.ops.len() {
            if let (true, Some((part, number))) = (self.plan.declared[id], place(&id)) {
                self.names.of[id] = within(part, &printers[part].names.of[number]);
            }
        }
        for (line, name) in self.plan.lines.iter().zip(&mut self.names.lines) {
            let found = place(&line.registers[0]).and_then(|(part, number)| {
                let (line, _) = printers[part].plan.in_line[number]?;
                Some(within(part, &printers[part].names.lines[line]))
            });
            if let Some(found) = found {
                *name = found;
            }
        }
        let owners = self.plan.borders.as_ref().map(|borders| &borders.owners);
        for (memory, names) in self.names.copies.iter_mut().enumerate() {
            let part = owners.map_or(0, |owners| owners.memories[memory]);
            names.iter_mut().for_each(|name| *name = within(part, name));
        }
    }

    /// The declarations that the properties need in addition to the module.
    fn beside(
        &mut self,
        roots: &[Id],
        inside: &dyn Fn(usize, Id) -> String,
        for_prover: bool,
    ) -> String {
        let beside = self.plan.extend(roots);
        self.names.extend(&self.plan, &beside, inside);
        let mut body = Body::default();
        let mut later = vec![];
        let mut statements = vec![];
        for id in beside.into_iter().filter(|id| self.plan.declared[*id]) {
            let name = &self.names.of[id];
            let declaration = format!("{}{name}", self.numbers.range(self.plan.width(id)));
            match &self.plan.ops[id] {
                Op::Register(_) if self.plan.in_line[id].is_none() => {
                    body.line(&format!("reg  {declaration};"));
                    statements.push(self.register_statement(id));
                }
                Op::Wire => {
                    body.line(&format!("wire {declaration};"));
                    let target = format!("assign {name} =");
                    later.push(self.assignment(&target, self.plan.driver(id)));
                }
                Op::AnyConst => body.line(&format!("(* anyconst *) wire {declaration};")),
                Op::AnySeq => body.line(&format!("(* anyseq *) wire {declaration};")),
                Op::Inside(..) if for_prover => {
                    body.line(&format!("(* hierconn *) wire {declaration};"));
                }
                Op::Inside(..) => {}
                _ => body.line(&self.definition(&format!("wire {declaration} ="), id)),
            }
        }
        later.iter().for_each(|line| body.line(line));
        if !statements.is_empty() {
            body.always(&statements);
        }
        body.flush();
        body.text
    }
}
