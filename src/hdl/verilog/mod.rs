//! Prints a checked module as Verilog-2001.

mod borders;
mod expression;
mod formal;
mod names;
mod plan;

use super::design::{Direction, Port};
use super::ir::{Id, Item, Netlist, Op, Root};
use super::memory::Style;
pub(super) use borders::{Borders, slice_of};
use expression::bits;
pub(super) use expression::literal;
pub(super) use formal::{with_checks, with_proof};
use names::Names;
use plan::Plan;
use std::cell::RefCell;
use std::fmt::Write as _;

const LINE: usize = 100;

/// Stands before a module's name while a module is being printed; no text has it.
const MARK: char = '\u{1}';

/// Stands before a statement while a module is being printed, with the statement's number behind it.
const STATEMENT: char = '\u{2}';

#[derive(Debug)]
pub(super) struct Printed {
    pub text: String,
    /// Where in the text a module's name begins: its own and those of the modules that it places.
    pub names: Vec<usize>,
    /// Under which name each node is declared.
    pub signals: Vec<Option<String>>,
    /// Names that the description does not say, and the node that each is of.
    pub made_up: Vec<(String, Id)>,
    /// Where statements begin: what each reads, and its line, from 1 on.
    pub statements: Vec<(Root, usize)>,
    /// For each memory how many copies are declared.
    pub copies: Vec<usize>,
    /// Whether the module has the ports `clk` and `rst`.
    pub clocked: bool,
    pub reset: bool,
}

pub(super) struct Printer<'a> {
    pub plan: Plan<'a>,
    pub names: Names,
    clocked: bool,
    reset: bool,
    statements: RefCell<Vec<Root>>,
}

pub(super) fn print(ir: &Netlist) -> Printed {
    let printer = Printer::new(ir);
    let (text, names, lines) = unmarked(&printer.module(&ir.name, &ir.doc));
    let signals = printer.signals();
    let statements = printer.statements.into_inner();
    Printed {
        text,
        names,
        signals,
        made_up: printer.names.made_up,
        statements: lines
            .into_iter()
            .map(|(n, line)| (statements[n], line))
            .collect(),
        copies: printer.plan.copies.iter().map(Vec::len).collect(),
        clocked: printer.clocked,
        reset: printer.reset,
    }
}

/// The ports as they are printed: those of one heading together, headings in order of first appearance.
pub(super) fn port_order(ports: &[(Port, Id)]) -> Vec<usize> {
    let mut headings: Vec<&str> = vec![];
    for (port, _) in ports {
        if !headings.contains(&port.group.as_str()) {
            headings.push(&port.group);
        }
    }
    let mut order: Vec<usize> = (0..ports.len()).collect();
    order.sort_by_key(|i| headings.iter().position(|h| *h == ports[*i].0.group));
    order
}

fn range(width: u32) -> String {
    if width == 1 {
        String::new()
    } else {
        format!("[{}:0] ", width - 1)
    }
}

/// The text of a body, with blank lines around what takes several lines.
#[derive(Default)]
struct Body {
    text: String,
    /// What the last line belongs to.
    last: Last,
    /// Declarations of one signal's delays are gathered on one line: the last of them.
    declared: Option<Id>,
    /// Statements of the state's registers, until the next thing that is not a register.
    clocked: Vec<String>,
}

#[derive(Clone, Copy, Default, PartialEq)]
enum Last {
    #[default]
    Start,
    Comment,
    Line,
    Block,
}

impl Body {
    fn line(&mut self, line: &str) {
        self.flush();
        if matches!(self.last, Last::Start | Last::Block) {
            self.text.push('\n');
        }
        let _ = writeln!(self.text, "  {line}");
        self.last = Last::Line;
        self.declared = None;
    }

    fn block(&mut self, block: &str) {
        self.flush();
        if self.last != Last::Comment {
            self.text.push('\n');
        }
        self.text.push_str(block);
        self.last = Last::Block;
        self.declared = None;
    }

    fn comment(&mut self, comment: &str) {
        self.flush();
        self.text.push('\n');
        for line in wrap(comment, LINE - 5) {
            let _ = writeln!(self.text, "  // {line}");
        }
        self.last = Last::Comment;
        self.declared = None;
    }

    fn always(&mut self, statements: &[String]) {
        let mut block = String::from("  always @(posedge clk) begin\n");
        for statement in statements {
            match statement.as_str() {
                "" => block.push('\n'),
                text => {
                    let _ = writeln!(block, "    {}", text.replace('\n', "\n  "));
                }
            }
        }
        block.push_str("  end\n");
        self.block(&block);
    }

    fn flush(&mut self) {
        if !self.clocked.is_empty() {
            let statements = std::mem::take(&mut self.clocked);
            self.always(&statements);
        }
    }
}

impl<'a> Printer<'a> {
    pub fn new(ir: &'a Netlist) -> Printer<'a> {
        let plan = Plan::new(ir);
        let below = |port| {
            let mut modules = ir.instances.iter().map(|i| &i.module);
            modules.any(|m| m.ports.iter().any(|p| p.name == port))
        };
        let mut ops = plan.ops.iter().zip(&plan.live).filter(|(_, live)| **live);
        let clocked = ops
            .clone()
            .any(|(op, _)| matches!(op, Op::Register(_) | Op::Read(..)));
        let reset = ops.any(|(op, _)| match op {
            Op::Register(register) => register.reset.is_some(),
            op => *op == Op::Reset,
        });
        Printer {
            names: Names::new(&plan),
            clocked: clocked || below("clk"),
            reset: reset || below("rst"),
            plan,
            statements: RefCell::default(),
        }
    }

    /// Under which name each node is declared.
    fn signals(&self) -> Vec<Option<String>> {
        let names = self.names.of.iter().zip(&self.plan.declared);
        let named = names.map(|(name, declared)| declared.then(|| name.clone()));
        named.collect()
    }

    /// Lets expressions of nodes be printed that were added to the netlist.
    pub fn extend(&mut self, ir: &'a Netlist) {
        for id in self.plan.ops.len()..ir.nodes.len() {
            self.plan.ops.push(ir.nodes[id].op.clone());
            self.plan.declared.push(false);
            self.plan.in_line.push(None);
            self.names.of.push(String::new());
        }
        self.plan.ir = ir;
    }

    /// Goes before the statement in which stands what `root` reads.
    fn mark(&self, root: Root) -> String {
        let mut statements = self.statements.borrow_mut();
        statements.push(root);
        format!("{STATEMENT}{}{STATEMENT}", statements.len() - 1)
    }

    fn ir(&self) -> &Netlist {
        self.plan.ir
    }

    fn module(&self, name: &str, doc: &str) -> String {
        let mut text = String::from("// SPDX-License-Identifier: MIT OR Apache-2.0\n");
        let head = format!("{name}: {doc}");
        for (number, line) in wrap(&head, LINE - 3).iter().enumerate() {
            // Lines are divided by the name without a prefix: a module has the same lines under every prefix.
            let mark = if number == 0 {
                MARK.to_string()
            } else {
                String::new()
            };
            let _ = writeln!(text, "// {mark}{line}");
        }
        let outputs = || {
            let ports = self.ir().ports.iter().map(|(port, _)| port);
            ports
                .filter(|p| p.direction == Direction::Output)
                .filter_map(|p| p.stage)
        };
        if let (Some(least), Some(greatest)) = (outputs().min(), outputs().max()) {
            let clocks = match (least, greatest) {
                (1, 1) => "1 clock".to_string(),
                _ if least == greatest => format!("{least} clocks"),
                _ => format!("{least} to {greatest} clocks"),
            };
            let _ = writeln!(text, "// Latency: {clocks}, one set of inputs a clock.");
        }
        text.push_str("\n`default_nettype none\n\n");
        let _ = writeln!(text, "module {MARK}{name} (");
        text.push_str(&self.port_list());
        text.push_str(");\n");
        text.push_str(&self.body());
        text.push_str("\nendmodule\n\n`default_nettype wire\n");
        text
    }

    fn port_list(&self) -> String {
        let ports = &self.ir().ports;
        let widest = ports.iter().map(|(p, _)| range(p.width).len()).max();
        let widest = widest.unwrap_or(0);
        let mut lines: Vec<(Option<&str>, String)> = vec![];
        for (present, name) in [(self.clocked, "clk"), (self.reset, "rst")] {
            if present {
                lines.push((None, format!("input  wire {:widest$}{name}", "")));
            }
        }
        let mut group = "";
        for index in port_order(ports) {
            let (port, id) = &ports[index];
            let id = self.plan.stands[*id];
            let kind = match port.direction {
                Direction::Input => "input  wire",
                Direction::Output if self.is_port(id, port) && self.is_reg(id) => "output reg ",
                Direction::Output => "output wire",
            };
            let heading = (port.group != group && !port.group.is_empty()).then_some(&*port.group);
            group = &port.group;
            let range = range(port.width);
            lines.push((heading, format!("{kind} {range:widest$}{}", port.name)));
        }
        let mut text = String::new();
        for (i, (heading, line)) in lines.iter().enumerate() {
            if let Some(heading) = heading {
                let _ = writeln!(text, "{}  // {heading}", if i > 0 { "\n" } else { "" });
            }
            let comma = if i + 1 == lines.len() { "" } else { "," };
            let _ = writeln!(text, "  {line}{comma}");
        }
        text
    }

    /// Whether a node is declared as this output port.
    fn is_port(&self, id: Id, port: &Port) -> bool {
        self.names.port[id] && self.names.of[id] == port.name
    }

    /// Whether a declared node is assigned in an `always` block.
    fn is_reg(&self, id: Id) -> bool {
        match &self.plan.ops[id] {
            Op::Register(_) => self.plan.in_line[id].is_none(),
            Op::Read(_, _, _, synchronous) => *synchronous,
            _ => false,
        }
    }

    fn body(&self) -> String {
        let ir = self.ir();
        let mut body = Body::default();
        let mut delays = vec![];
        for item in &ir.items {
            match item {
                Item::Comment(comment) => body.comment(comment),
                Item::Node(id) => self.declaration(&mut body, *id, &mut delays),
                Item::Drive(id) if self.plan.live[*id] => match &self.plan.ops[*id] {
                    Op::Wire => {
                        let driver = self.plan.driver(*id);
                        if self.names.wire[driver] != Some(*id) {
                            let target = format!("assign {} =", self.names.of[*id]);
                            let mark = self.mark(Root::Driver(*id));
                            body.line(&(mark + &self.assignment(&target, driver)));
                        }
                    }
                    Op::Register(register) if !register.delay => {
                        body.clocked.push(self.register_statement(*id));
                    }
                    _ => {}
                },
                Item::Drive(_) => {}
                Item::Instance(index) => body.block(&self.instance(*index)),
                Item::Memory(index) => self.memory_declaration(&mut body, *index),
                Item::Part(_) => {}
            }
        }
        self.memories(&mut body);
        self.delays(&mut body, delays);
        let mut outputs = vec![];
        for index in port_order(&ir.ports) {
            let (port, id) = &ir.ports[index];
            let id = self.plan.stands[*id];
            if port.direction == Direction::Output && !self.is_port(id, port) {
                let target = format!("assign {} =", port.name);
                outputs.push(self.mark(Root::Output(index)) + &self.assignment(&target, id));
            }
        }
        if !outputs.is_empty() {
            body.flush();
            body.last = Last::Block;
        }
        for output in outputs {
            body.line(&output);
        }
        self.unused(&mut body);
        self.initial(&mut body);
        body.flush();
        body.text
    }

    fn declaration(&self, body: &mut Body, id: Id, delays: &mut Vec<Id>) {
        let plan = &self.plan;
        if let (true, Some((line, 0))) = (plan.live[id], plan.in_line[id]) {
            let clocks = plan.lines[line].registers.len() as u32;
            let range = bits(clocks * plan.width(id) - 1, 0);
            body.line(&format!("reg  {range} {};", self.names.lines[line]));
        }
        let delay = matches!(&plan.ops[id], Op::Register(register) if register.delay);
        if plan.live[id] && delay && plan.in_line[id].is_none() {
            delays.push(id);
        }
        if !plan.declared[id] || matches!(plan.ops[id], Op::Input | Op::Instance(..)) {
            return;
        }
        let name = &self.names.of[id];
        let declaration = format!("{}{name}", range(plan.width(id)));
        if self.is_reg(id) {
            if self.names.port[id] {
                return;
            }
            // Statements of registers wait: declarations of further ones do not part them.
            let last = plan.sources(id).first().copied();
            if delay && body.declared.is_some() && body.declared == last {
                let start = body.text.trim_end().rfind('\n').map_or(0, |i| i + 1);
                let line = body.text[start..].trim_end().trim_end_matches(';');
                if line.len() + name.len() + 3 <= LINE {
                    let line = format!("{line}, {name};\n");
                    body.text.truncate(start);
                    body.text.push_str(&line);
                    body.declared = Some(id);
                    return;
                }
            }
            let clocked = std::mem::take(&mut body.clocked);
            body.line(&format!("reg  {declaration};"));
            body.clocked = clocked;
            body.declared = delay.then_some(id);
        } else if plan.ops[id] == Op::Wire {
            if self.names.port[id] {
                return;
            }
            let clocked = std::mem::take(&mut body.clocked);
            body.line(&format!("wire {declaration};"));
            body.clocked = clocked;
        } else {
            let target = if self.names.port[id] || self.names.wire[id].is_some() {
                format!("assign {name} =")
            } else {
                format!("wire {declaration} =")
            };
            body.line(&(self.mark(self.root(id)) + &self.definition(&target, id)));
        }
    }

    /// What a declared node's statement reads.
    fn root(&self, id: Id) -> Root {
        match self.plan.ops[id] {
            Op::Read(..) => Root::Address(id),
            _ => Root::Value(id),
        }
    }

    fn clear(&self, name: &str, reset: Option<u128>, width: u32) -> String {
        match reset {
            Some(value) => format!("if (rst) {name} <= {}; else ", literal(value, width)),
            None => String::new(),
        }
    }

    fn register_statement(&self, id: Id) -> String {
        let Op::Register(register) = &self.plan.ops[id] else {
            unreachable!("only registers are clocked")
        };
        let name = &self.names.of[id];
        let next = register.next.expect("checked: every register is driven");
        let mut text = self.mark(Root::Next(id));
        text += &self.clear(name, register.reset, self.plan.width(id));
        if let Some(enable) = register.enable {
            let _ = write!(text, "if ({}) ", self.part(enable));
        }
        text + &self.assignment(&format!("{name} <="), next)
    }

    /// Delay registers stage by stage, then delay lines.
    fn delays(&self, body: &mut Body, delays: Vec<Id>) {
        let stage = |id: Id| {
            let stage = self.ir().nodes[id].stage;
            stage.map(|stage| (stage.pipeline, stage.at))
        };
        let mut stages: Vec<_> = delays.iter().map(|id| stage(*id)).collect();
        stages.sort_unstable();
        stages.dedup();
        let mut pipelines: Vec<u32> = stages.iter().flatten().map(|(p, _)| *p).collect();
        pipelines.dedup();
        if !delays.is_empty() {
            body.comment("Pipeline registers.");
            let mut statements = vec![];
            for (i, at) in stages.iter().enumerate() {
                if i > 0 {
                    statements.push(String::new());
                }
                if stages.len() > 1 {
                    statements.push(match at {
                        None => "// Outside the pipelines".to_string(),
                        Some((_, at)) if pipelines.len() == 1 => format!("// Stage {at}"),
                        Some((pipeline, at)) => format!("// Pipeline {pipeline}, stage {at}"),
                    });
                }
                let here = delays.iter().filter(|id| stage(**id) == *at);
                statements.extend(here.map(|id| self.register_statement(*id)));
            }
            body.always(&statements);
        }
        if !self.plan.lines.is_empty() {
            body.comment(
                "Delay lines: values that wait for others of their pipeline, the newest lowest.",
            );
            let mut statements = vec![];
            for (line, name) in self.plan.lines.iter().zip(&self.names.lines) {
                let head = line.registers[0];
                let Op::Register(register) = &self.plan.ops[head] else {
                    unreachable!("a delay line is of registers")
                };
                let next = register.next.expect("a delay register has a next value");
                let width = self.plan.width(head);
                let clocks = line.registers.len() as u32;
                let kept = bits((clocks - 1) * width - 1, 0);
                statements.push(format!(
                    "{}{}{name} <= {{{name}{kept}, {}}};",
                    self.mark(Root::Next(head)),
                    self.clear(name, register.reset, width * clocks),
                    self.part(next)
                ));
            }
            body.always(&statements);
        }
    }

    fn memory_declaration(&self, body: &mut Body, index: usize) {
        let memory = &self.ir().memories[index];
        let style = match memory.style {
            Style::Block => "block",
            Style::Distributed => "distributed",
        };
        let clocked = std::mem::take(&mut body.clocked);
        for name in &self.names.copies[index] {
            body.line(&format!(
                "(* no_rw_check, ram_style = \"{style}\" *)\n  reg  {}{name} [0:{}];",
                range(memory.width),
                memory.depth - 1
            ));
        }
        body.clocked = clocked;
    }

    fn memories(&self, body: &mut Body) {
        if self.plan.copies.iter().any(|copies| !copies.is_empty()) {
            body.comment("Memories.");
        }
        for (index, copies) in self.plan.copies.iter().enumerate() {
            for (name, read) in self.names.copies[index].iter().zip(copies) {
                let [enable, address, data] = self.plan.write_port(index).map(|id| self.part(id));
                let mark = self.mark(Root::Write(index, 0));
                let write = format!("{mark}if ({enable}) {name}[{address}] <= {data};");
                let mut statements = vec![write];
                if self.is_reg(*read) {
                    statements.push(format!(
                        "{}{} <= {};",
                        self.mark(Root::Address(*read)),
                        self.names.of[*read],
                        self.expression(*read)
                    ));
                }
                body.always(&statements);
            }
        }
    }

    fn instance(&self, index: usize) -> String {
        let instance = &self.ir().instances[index];
        let mut text = String::new();
        let mut connections = vec![];
        for port in &instance.module.ports {
            let mut mark = String::new();
            let value = if port.name == "clk" || port.name == "rst" {
                port.name.clone()
            } else if let Some(input) = instance.inputs.iter().position(|(n, _)| *n == port.name) {
                mark = self.mark(Root::Input(index, input));
                self.part(self.plan.stands[instance.inputs[input].1])
            } else {
                let output = instance.outputs.iter().find(|(n, _)| *n == port.name);
                let (_, id) = output.expect("checked: every port is connected");
                let name = &self.names.of[*id];
                // An output may be a port or a wire that was declared before.
                if !self.names.port[*id] && self.names.wire[*id].is_none() {
                    let _ = writeln!(text, "  wire {}{name};", range(port.width));
                }
                name.clone()
            };
            connections.push(format!("{mark}    .{}({value})", port.name));
        }
        let _ = writeln!(
            text,
            "  {MARK}{} {} (\n{}\n  );",
            instance.module.name(),
            instance.name,
            connections.join(",\n")
        );
        text
    }

    /// What registers hold before the first clock.
    fn initial(&self, body: &mut Body) {
        let plan = &self.plan;
        let mut lines = vec![];
        for id in (0..plan.ops.len()).filter(|id| plan.live[*id]) {
            let Op::Register(register) = &plan.ops[id] else {
                continue;
            };
            let Some(value) = register.initial else {
                continue;
            };
            let value = literal(value, plan.width(id));
            lines.push(match plan.in_line[id] {
                None => format!("    {} = {value};\n", self.names.of[id]),
                Some((line, 0)) => {
                    let clocks = plan.lines[line].registers.len();
                    format!(
                        "    {} = {{{clocks}{{{value}}}}};\n",
                        self.names.lines[line]
                    )
                }
                Some(_) => continue,
            });
        }
        if !lines.is_empty() {
            body.block(&format!("  initial begin\n{}  end\n", lines.concat()));
        }
    }

    /// Collects what nothing reads, so that lint knows that it is meant.
    fn unused(&self, body: &mut Body) {
        let plan = &self.plan;
        let mut parts = vec![];
        for id in (0..plan.ops.len()).filter(|id| plan.declared[*id]) {
            let (name, used) = (&self.names.of[id], &plan.used[id]);
            if used.iter().all(|u| !*u) {
                parts.push(name.clone());
                continue;
            }
            let mut bit = 0;
            while bit < used.len() {
                let low = bit;
                while bit < used.len() && used[bit] == used[low] {
                    bit += 1;
                }
                if !used[low] {
                    parts.push(format!("{name}{}", bits(bit as u32 - 1, low as u32)));
                }
            }
        }
        if parts.is_empty() {
            return;
        }
        body.comment("What nothing reads.");
        let name = &self.names.unused;
        let joined = parts.join(", ");
        let line = format!("wire {name} = &{{1'b0, {joined}}};");
        if line.len() + 2 <= LINE {
            body.line(&line);
        } else {
            body.line(&format!(
                "wire {name} = &{{\n    1'b0,\n    {}\n  }};",
                parts.join(",\n    ")
            ));
        }
    }
}

/// A text without its marks, where those of names were, and the lines of statements, by their numbers.
fn unmarked(text: &str) -> (String, Vec<usize>, Vec<(usize, usize)>) {
    let mut plain = String::with_capacity(text.len());
    let (mut places, mut lines) = (vec![], vec![]);
    let mut line = 1;
    let mut rest = text;
    while let Some(at) = rest.find([MARK, STATEMENT]) {
        plain.push_str(&rest[..at]);
        line += rest[..at].matches('\n').count();
        let name = rest[at..].starts_with(MARK);
        rest = &rest[at + 1..];
        if name {
            places.push(plain.len());
        } else if let Some((number, behind)) = rest.split_once(STATEMENT) {
            lines.extend(number.parse().ok().map(|number: usize| (number, line)));
            rest = behind;
        }
    }
    plain.push_str(rest);
    (plain, places, lines)
}

fn wrap(text: &str, width: usize) -> Vec<String> {
    let mut lines = vec![];
    for paragraph in text.lines() {
        let mut line = String::new();
        for word in paragraph.split_whitespace() {
            if !line.is_empty() && line.len() + 1 + word.len() > width {
                lines.push(std::mem::take(&mut line));
            }
            if !line.is_empty() {
                line.push(' ');
            }
            line.push_str(word);
        }
        lines.push(line);
    }
    lines
}
