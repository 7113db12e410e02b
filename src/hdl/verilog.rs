//! Prints a checked module as Verilog-2001.
//!
//! Expressions used once are written where they are used; what has a name, is used again or must be sliced
//! becomes a wire. All operands of one width are printed at that width, so Verilog's own widening never applies.

use super::builder::{Binary, Builder, Id, Inner, Item, Op};
use super::design::{Direction, Port};
use super::memory::Style;
use std::collections::HashSet;
use std::fmt::Write as _;

pub(super) struct Printed {
    pub text: String,
    pub clocked: bool,
}

/// Beyond this many characters an expression gets a wire of its own.
const LONG_EXPRESSION: usize = 72;
const LINE: usize = 100;

struct Printer<'a> {
    inner: &'a Inner,
    /// Reached from an output, an instance or a memory.
    live: Vec<bool>,
    /// Declared under a name of its own.
    declared: Vec<bool>,
    names: Vec<String>,
    /// For declared nodes: which bits are used.
    used: Vec<Vec<bool>>,
}

pub(super) fn print(builder: &Builder) -> Printed {
    let inner = builder.inner.borrow();
    let mut printer = Printer {
        live: liveness(&inner),
        declared: vec![false; inner.nodes.len()],
        names: vec![String::new(); inner.nodes.len()],
        used: vec![vec![]; inner.nodes.len()],
        inner: &inner,
    };
    printer.choose_declared();
    printer.choose_names();
    printer.mark_used();
    let clocked = inner.nodes.iter().enumerate().any(|(id, node)| {
        printer.live[id] && matches!(node.op, Op::Register(_) | Op::Read(_, _, _, true))
    }) || !inner.memories.is_empty()
        || inner
            .instances
            .iter()
            .any(|i| i.module.ports.iter().any(|p| p.name == "clk"));
    let has_reset = inner.nodes.iter().enumerate().any(|(id, node)| {
        printer.live[id] && matches!(&node.op, Op::Register(r) if r.reset.is_some())
    }) || inner
        .instances
        .iter()
        .any(|i| i.module.ports.iter().any(|p| p.name == "rst"));
    builder.has_reset.set(has_reset);
    let text = printer.module(&builder.name, &builder.doc, clocked, has_reset);
    Printed { text, clocked }
}

/// All the nodes that a node's value comes from, through registers too.
fn sources(inner: &Inner, id: Id) -> Vec<Id> {
    match &inner.nodes[id].op {
        Op::Register(register) => register.next.into_iter().chain(register.enable).collect(),
        Op::Read(_, _, address, true) => vec![*address],
        Op::Instance(..) => vec![],
        _ => inner.combinational_inputs(id),
    }
}

fn liveness(inner: &Inner) -> Vec<bool> {
    let mut live = vec![false; inner.nodes.len()];
    let mut open: Vec<Id> = inner.ports.iter().map(|(_, id)| *id).collect();
    for instance in &inner.instances {
        open.extend(instance.inputs.iter().map(|(_, id)| id));
    }
    for memory in &inner.memories {
        open.extend(memory.write.iter().flat_map(|(e, a, d)| [*e, *a, *d]));
    }
    while let Some(id) = open.pop() {
        if !std::mem::replace(&mut live[id], true) {
            open.extend(sources(inner, id));
        }
    }
    live
}

fn range(width: u32) -> String {
    if width == 1 {
        String::new()
    } else {
        format!("[{}:0] ", width - 1)
    }
}

fn literal(value: u128, width: u32) -> String {
    if width == 1 {
        format!("1'b{value}")
    } else if value < 1000 {
        format!("{width}'d{value}")
    } else {
        format!("{width}'h{value:x}")
    }
}

impl Printer<'_> {
    /// Every place that reads a node.
    fn uses(&self) -> Vec<Id> {
        let inner = self.inner;
        let mut uses: Vec<Id> = (0..inner.nodes.len())
            .filter(|id| self.live[*id])
            .flat_map(|id| sources(inner, id))
            .collect();
        uses.extend(
            inner
                .instances
                .iter()
                .flat_map(|i| i.inputs.iter().map(|(_, id)| *id)),
        );
        uses.extend(
            inner
                .memories
                .iter()
                .flat_map(|m| m.write)
                .flat_map(|(e, a, d)| [e, a, d]),
        );
        uses.extend(
            inner
                .ports
                .iter()
                .filter(|(p, _)| p.direction == Direction::Output)
                .map(|(_, id)| *id),
        );
        uses
    }

    fn choose_declared(&mut self) {
        let inner = self.inner;
        let mut count = vec![0usize; inner.nodes.len()];
        for id in self.uses() {
            count[id] += 1;
        }
        // A memory's write data and address are read by each of its copies.
        for memory in &inner.memories {
            for id in memory.write.iter().flat_map(|(e, a, d)| [*e, *a, *d]) {
                count[id] += memory.reads - 1;
            }
        }
        let mut sliced = HashSet::new();
        for (id, node) in inner.nodes.iter().enumerate() {
            if let (true, Op::Slice(of, _)) = (self.live[id], &node.op) {
                sliced.insert(*of);
            }
        }
        let mut length = vec![0usize; inner.nodes.len()];
        for (id, node) in inner.nodes.iter().enumerate() {
            let own = match &node.op {
                Op::Literal(_) => 6,
                Op::Binary(..) => 5,
                Op::Mux(..) => 8,
                _ => 4,
            };
            let inputs: usize = match &node.op {
                Op::Input | Op::Wire | Op::Register(_) | Op::Read(..) | Op::Instance(..) => 0,
                _ => inner
                    .combinational_inputs(id)
                    .iter()
                    // A chain of choices is printed a line each, however long.
                    .filter(|i| {
                        let chain = matches!(node.op, Op::Mux(_, _, rest) if rest == **i);
                        !(chain && matches!(inner.nodes[**i].op, Op::Mux(..)))
                    })
                    .map(|i| if self.declared[*i] { 10 } else { length[*i] })
                    .sum(),
            };
            length[id] = own + inputs;
            let stateful = matches!(
                node.op,
                Op::Input | Op::Wire | Op::Register(_) | Op::Read(..) | Op::Instance(..)
            );
            let trivial = matches!(node.op, Op::Literal(_) | Op::Slice(..));
            self.declared[id] = self.live[id]
                && (stateful
                    || node.name.is_some()
                    || !trivial
                        && (count[id] > 1 || sliced.contains(&id) || length[id] > LONG_EXPRESSION));
            // A slice of a slice must have a name to take bits of, unless it is all of its operand.
            if let Op::Slice(of, _) = node.op
                && sliced.contains(&id)
                && inner.nodes[of].width != node.width
            {
                self.declared[id] = self.live[id];
            }
            // Inputs and instances' outputs exist whether used or not.
            if matches!(node.op, Op::Input | Op::Instance(..)) {
                self.declared[id] = true;
            }
        }
    }

    fn choose_names(&mut self) {
        let inner = self.inner;
        let mut taken: HashSet<String> = inner.names.keys().cloned().collect();
        let mut counters: std::collections::HashMap<&'static str, u32> = Default::default();
        for (id, node) in inner.nodes.iter().enumerate() {
            if !self.declared[id] {
                continue;
            }
            if let Some(name) = &node.name {
                self.names[id] = name.clone();
                continue;
            }
            let name = match &node.op {
                Op::Register(register) if register.delay => {
                    let (root, steps) = self.delay_root(id);
                    let base = self.base_name(root);
                    match node.stage {
                        Some(stage) => format!("{base}_s{}", stage.at),
                        None => format!("{base}_d{steps}"),
                    }
                }
                op => {
                    let kind = match op {
                        Op::Binary(Binary::Add, ..) => "sum",
                        Op::Binary(Binary::Sub, ..) => "difference",
                        Op::Binary(Binary::Mul, ..) => "product",
                        Op::Binary(
                            Binary::Equal | Binary::NotEqual | Binary::Less | Binary::LessEqual,
                            ..,
                        ) => "compare",
                        Op::Binary(Binary::ShiftLeft | Binary::ShiftRight, ..) => "shifted",
                        Op::Mux(..) => "choice",
                        Op::Concat(_) | Op::Repeat(..) => "joined",
                        Op::Slice(..) => "part",
                        _ => "term",
                    };
                    let n = counters.entry(kind).or_default();
                    *n += 1;
                    format!("{kind}_{n}")
                }
            };
            let mut unique = name.clone();
            let mut n = 1;
            while !taken.insert(unique.clone()) {
                n += 1;
                unique = format!("{name}_{n}");
            }
            self.names[id] = unique;
        }
    }

    /// The signal that a chain of delay registers starts from, and the chain's length.
    fn delay_root(&self, id: Id) -> (Id, u32) {
        let (mut id, mut steps) = (id, 0);
        loop {
            match &self.inner.nodes[id].op {
                Op::Register(r) if r.delay => {
                    steps += 1;
                    id = r.next.expect("a delay register has a next value");
                }
                Op::Slice(of, 0)
                    if self.inner.nodes[*of].width == self.inner.nodes[id].width
                        && !self.declared[id] =>
                {
                    id = *of
                }
                _ => return (id, steps),
            }
        }
    }

    fn base_name(&self, id: Id) -> String {
        if self.declared[id] {
            return self.names[id].clone();
        }
        match &self.inner.nodes[id].op {
            Op::Slice(of, low) => {
                let width = self.inner.nodes[id].width;
                let base = self.base_name(self.delay_root(*of).0);
                if width == self.inner.nodes[*of].width {
                    base
                } else if width == 1 {
                    format!("{base}_{low}")
                } else {
                    format!("{base}_{}_{low}", low + width - 1)
                }
            }
            Op::Not(a) => format!("not_{}", self.base_name(*a)),
            _ => "value".to_string(),
        }
    }

    fn mark_used(&mut self) {
        let inner = self.inner;
        for (id, node) in inner.nodes.iter().enumerate() {
            self.used[id] = vec![false; node.width as usize];
        }
        let live: Vec<Id> = (0..inner.nodes.len()).filter(|id| self.live[*id]).collect();
        // Undeclared slices are read through: what counts is what reads them.
        let mut readers: Vec<(Id, Id)> = vec![];
        for id in live {
            for source in sources(inner, id) {
                readers.push((source, id));
            }
        }
        for (source, reader) in &readers {
            // What reads a slice that is written in place reads through it: see mark.
            if matches!(inner.nodes[*reader].op, Op::Slice(..)) && !self.declared[*reader] {
                continue;
            }
            let (low, width) = match inner.nodes[*reader].op {
                Op::Slice(of, low) if of == *source => (low, inner.nodes[*reader].width),
                _ => (0, inner.nodes[*source].width),
            };
            self.mark(*source, low, width);
        }
        let outside: Vec<Id> = inner
            .instances
            .iter()
            .flat_map(|i| i.inputs.iter().map(|(_, id)| *id))
            .chain(
                inner
                    .memories
                    .iter()
                    .flat_map(|m| m.write)
                    .flat_map(|(e, a, d)| [e, a, d]),
            )
            .chain(
                inner
                    .ports
                    .iter()
                    .filter(|(p, _)| p.direction == Direction::Output)
                    .map(|(_, id)| *id),
            )
            .collect();
        for id in outside {
            self.mark(id, 0, inner.nodes[id].width);
        }
    }

    fn mark(&mut self, id: Id, low: u32, width: u32) {
        for bit in low..low + width {
            self.used[id][bit as usize] = true;
        }
        // A full-width slice that is not declared passes the use on.
        if let Op::Slice(of, base) = self.inner.nodes[id].op
            && !self.declared[id]
        {
            self.mark(of, base + low, width);
        }
    }

    /// A node as an operand: its name, or its expression in parentheses where needed.
    fn operand(&self, id: Id) -> String {
        if self.declared[id] {
            return self.names[id].clone();
        }
        let text = self.expression(id);
        match &self.inner.nodes[id].op {
            Op::Binary(..) | Op::Mux(..) => format!("({text})"),
            Op::Any(_) | Op::All(_) | Op::Parity(_) => format!("({text})"),
            Op::Not(a) if !self.declared[*a] && matches!(self.inner.nodes[*a].op, Op::Any(_)) => {
                format!("({text})")
            }
            _ => text,
        }
    }

    /// A node's expression, written out even if the node is declared.
    fn expression(&self, id: Id) -> String {
        let inner = self.inner;
        let node = &inner.nodes[id];
        match &node.op {
            Op::Input | Op::Wire | Op::Register(_) | Op::Instance(..) => self.names[id].clone(),
            Op::Read(memory, copy, address, _) => {
                format!(
                    "{}[{}]",
                    self.copy_name(*memory, *copy),
                    self.operand(*address)
                )
            }
            Op::Literal(value) => literal(*value, node.width),
            Op::Not(a) => match &inner.nodes[*a].op {
                Op::Any(of) if !self.declared[*a] => format!("~|{}", self.operand(*of)),
                _ => format!("~{}", self.operand(*a)),
            },
            Op::Binary(op, a, b) => {
                let symbol = match op {
                    Binary::And => "&",
                    Binary::Or => "|",
                    Binary::Xor => "^",
                    Binary::Add => "+",
                    Binary::Sub => "-",
                    Binary::Mul => "*",
                    Binary::Equal => "==",
                    Binary::NotEqual => "!=",
                    Binary::Less => "<",
                    Binary::LessEqual => "<=",
                    Binary::ShiftLeft => "<<",
                    Binary::ShiftRight => ">>",
                };
                if *op == Binary::Mul {
                    let (wa, wb) = (inner.nodes[*a].width, inner.nodes[*b].width);
                    return format!(
                        "{{{wb}'d0, {}}} * {{{wa}'d0, {}}}",
                        self.operand(*a),
                        self.operand(*b)
                    );
                }
                format!(
                    "{} {symbol} {}",
                    self.chain_operand(*op, *a),
                    self.operand(*b)
                )
            }
            Op::Mux(condition, a, b) => {
                format!(
                    "{} ? {} : {}",
                    self.operand(*condition),
                    self.operand(*a),
                    self.operand(*b)
                )
            }
            Op::Concat(parts) => {
                let parts: Vec<_> = parts.iter().map(|p| self.part(*p)).collect();
                format!("{{{}}}", parts.join(", "))
            }
            Op::Repeat(a, times) => format!("{{{times}{{{}}}}}", self.part(*a)),
            Op::Slice(of, low) => {
                let width = node.width;
                if width == inner.nodes[*of].width {
                    return self.operand(*of);
                }
                let of = self.sliceable(*of);
                if width == 1 {
                    format!("{of}[{low}]")
                } else {
                    format!("{of}[{}:{low}]", low + width - 1)
                }
            }
            Op::Any(a) => format!("|{}", self.operand(*a)),
            Op::All(a) => format!("&{}", self.operand(*a)),
            Op::Parity(a) => format!("^{}", self.operand(*a)),
        }
    }

    /// The name of a node of which bits are taken, through renamings that are not declared.
    fn sliceable(&self, id: Id) -> String {
        match self.inner.nodes[id].op {
            Op::Slice(of, 0)
                if !self.declared[id]
                    && self.inner.nodes[of].width == self.inner.nodes[id].width =>
            {
                self.sliceable(of)
            }
            _ => self.names[id].clone(),
        }
    }

    /// Within braces no parentheses are needed.
    fn part(&self, id: Id) -> String {
        if self.declared[id] {
            self.names[id].clone()
        } else {
            self.expression(id)
        }
    }

    /// The left operand of an associative chain needs no parentheses.
    fn chain_operand(&self, op: Binary, id: Id) -> String {
        match &self.inner.nodes[id].op {
            Op::Binary(inner, ..)
                if !self.declared[id]
                    && *inner == op
                    && matches!(op, Binary::And | Binary::Or | Binary::Xor | Binary::Add) =>
            {
                self.expression(id)
            }
            _ => self.operand(id),
        }
    }

    /// `target = expression;`, broken over lines where it is long.
    fn assignment(&self, target: &str, id: Id) -> String {
        let expression = if self.declared[id] && !target.ends_with(&format!("{} =", self.names[id]))
        {
            self.names[id].clone()
        } else {
            self.expression(id)
        };
        let one_line = format!("{target} {expression};");
        if expression == self.names[id] {
            return one_line;
        }
        match &self.inner.nodes[id].op {
            Op::Mux(..) if one_line.len() > LINE || self.chained(id) => {
                let mut text = target.to_string();
                let mut at = id;
                loop {
                    match &self.inner.nodes[at].op {
                        Op::Mux(c, a, b) if at == id || !self.declared[at] => {
                            let _ = write!(
                                text,
                                "\n      {} ? {} :",
                                self.operand(*c),
                                self.operand(*a)
                            );
                            at = *b;
                        }
                        _ => break,
                    }
                }
                let _ = write!(text, "\n      {};", self.operand(at));
                text
            }
            Op::Concat(parts) if one_line.len() > LINE => {
                let parts: Vec<_> = parts
                    .iter()
                    .map(|p| format!("\n      {}", self.part(*p)))
                    .collect();
                format!("{target} {{{}\n    }};", parts.join(","))
            }
            _ => one_line,
        }
    }

    fn chained(&self, id: Id) -> bool {
        match &self.inner.nodes[id].op {
            Op::Mux(_, _, b) => {
                !self.declared[*b] && matches!(self.inner.nodes[*b].op, Op::Mux(..))
            }
            _ => false,
        }
    }

    fn copy_name(&self, memory: usize, copy: usize) -> String {
        let name = &self.inner.memories[memory].name;
        if self.live_copies(memory).len() == 1 {
            name.clone()
        } else {
            format!("{name}_{copy}")
        }
    }

    /// The copies of a memory that are read, with the node that reads each.
    fn live_copies(&self, memory: usize) -> Vec<(usize, Id)> {
        (0..self.inner.nodes.len())
            .filter(|id| self.live[*id])
            .filter_map(|id| match self.inner.nodes[id].op {
                Op::Read(m, copy, ..) if m == memory => Some((copy, id)),
                _ => None,
            })
            .collect()
    }

    fn register_statement(&self, id: Id) -> String {
        let Op::Register(register) = &self.inner.nodes[id].op else {
            unreachable!("only registers are clocked")
        };
        let name = &self.names[id];
        let next = register.next.expect("checked: every register is driven");
        let width = self.inner.nodes[id].width;
        let mut text = String::new();
        if let Some(reset) = register.reset {
            let _ = write!(text, "if (rst) {name} <= {}; else ", literal(reset, width));
        }
        if let Some(enable) = register.enable {
            let _ = write!(text, "if ({}) ", self.part(enable));
        }
        text + &self.assignment(&format!("{name} <="), next)
    }

    fn module(&self, name: &str, doc: &str, clocked: bool, has_reset: bool) -> String {
        let inner = self.inner;
        let mut text = String::from("// SPDX-License-Identifier: MIT OR Apache-2.0\n");
        let head = format!("{name}: {doc}");
        for line in wrap(&head, LINE - 3) {
            let _ = writeln!(text, "// {line}");
        }
        let stages: Vec<u32> = inner
            .ports
            .iter()
            .filter(|(p, _)| p.direction == Direction::Output)
            .filter_map(|(p, _)| p.stage)
            .collect();
        if let (Some(least), Some(greatest)) = (stages.iter().min(), stages.iter().max()) {
            if least == greatest {
                let _ = writeln!(
                    text,
                    "// Latency: {least} clocks, one set of inputs a clock."
                );
            } else {
                let _ = writeln!(
                    text,
                    "// Latency: {least} to {greatest} clocks, one set of inputs a clock."
                );
            }
        }
        text.push_str("\n`default_nettype none\n\n");
        let _ = writeln!(text, "module {name} (");
        text.push_str(&self.port_list(clocked, has_reset));
        text.push_str(");\n");
        self.body(&mut text, clocked);
        text.push_str("\nendmodule\n\n`default_nettype wire\n");
        text
    }

    fn port_list(&self, clocked: bool, has_reset: bool) -> String {
        let mut lines: Vec<(Option<String>, String)> = vec![];
        if clocked {
            lines.push((None, "input  wire clk".to_string()));
        }
        if has_reset {
            lines.push((None, "input  wire rst".to_string()));
        }
        let mut group = "";
        for (port, _) in &self.inner.ports {
            let direction = match port.direction {
                Direction::Input => "input  wire",
                Direction::Output => "output wire",
            };
            let Port { name, width, .. } = port;
            let heading = (port.group != group).then(|| port.group.clone());
            group = &port.group;
            lines.push((heading, format!("{direction} {}{name}", range(*width))));
        }
        let mut text = String::new();
        for (i, (heading, line)) in lines.iter().enumerate() {
            if let Some(heading) = heading {
                let _ = writeln!(text, "\n  // {heading}");
            }
            let comma = if i + 1 == lines.len() { "" } else { "," };
            let _ = writeln!(text, "  {line}{comma}");
        }
        text
    }

    fn body(&self, text: &mut String, clocked: bool) {
        let inner = self.inner;
        let mut delays = vec![];
        let mut clocked_block: Vec<String> = vec![];
        let flush = |text: &mut String, block: &mut Vec<String>| {
            if block.is_empty() {
                return;
            }
            text.push_str("  always @(posedge clk) begin\n");
            for statement in block.drain(..) {
                let _ = writeln!(text, "    {}", statement.replace('\n', "\n  "));
            }
            text.push_str("  end\n");
        };
        for item in &inner.items {
            match item {
                Item::Comment(comment) => {
                    flush(text, &mut clocked_block);
                    text.push('\n');
                    for line in wrap(comment, LINE - 5) {
                        let _ = writeln!(text, "  // {line}");
                    }
                }
                Item::Node(id) => {
                    let node = &inner.nodes[*id];
                    if !self.declared[*id] || matches!(node.op, Op::Input) {
                        continue;
                    }
                    let declaration = format!("{}{}", range(node.width), self.names[*id]);
                    match &node.op {
                        Op::Wire | Op::Instance(..) => {
                            let _ = writeln!(text, "  wire {declaration};");
                        }
                        Op::Register(_) | Op::Read(_, _, _, true) => {
                            let _ = writeln!(text, "  reg  {declaration};");
                        }
                        _ => {
                            flush(text, &mut clocked_block);
                            let _ = writeln!(
                                text,
                                "  {}",
                                self.assignment(&format!("wire {declaration} ="), *id)
                            );
                        }
                    }
                }
                Item::Drive(id) => {
                    if !self.live[*id] {
                        continue;
                    }
                    match &inner.nodes[*id].op {
                        Op::Wire => {
                            flush(text, &mut clocked_block);
                            let _ = writeln!(
                                text,
                                "  {}",
                                self.assignment(
                                    &format!("assign {} =", self.names[*id]),
                                    inner.drivers[id]
                                )
                            );
                        }
                        Op::Register(register) if register.delay => delays.push(*id),
                        Op::Register(_) => clocked_block.push(self.register_statement(*id)),
                        _ => {}
                    }
                }
                Item::Instance(index) => {
                    flush(text, &mut clocked_block);
                    self.instance(text, *index);
                }
                Item::Memory(index) => {
                    let memory = &inner.memories[*index];
                    let style = match memory.style {
                        Style::Block => "block",
                        Style::Distributed => "distributed",
                    };
                    for (copy, _) in self.live_copies(*index) {
                        let _ = writeln!(
                            text,
                            "  (* no_rw_check, ram_style = \"{style}\" *)\n  reg {}{} [0:{}];",
                            range(memory.width),
                            self.copy_name(*index, copy),
                            memory.depth - 1
                        );
                    }
                }
            }
        }
        flush(text, &mut clocked_block);
        self.memories(text);
        if !delays.is_empty() {
            text.push_str("\n  // Registers that keep the pipeline's stages aligned.\n");
            for id in delays {
                clocked_block.push(self.register_statement(id));
            }
            flush(text, &mut clocked_block);
        }
        text.push('\n');
        for (port, id) in &inner.ports {
            if port.direction == Direction::Output {
                let _ = writeln!(
                    text,
                    "  {}",
                    self.assignment(&format!("assign {} =", port.name), *id)
                );
            }
        }
        self.unused(text, clocked);
    }

    fn memories(&self, text: &mut String) {
        for (index, memory) in self.inner.memories.iter().enumerate() {
            let (enable, address, data) = memory.write.expect("checked: every memory is written");
            for (copy, read) in self.live_copies(index) {
                let name = self.copy_name(index, copy);
                let _ = writeln!(
                    text,
                    "\n  always @(posedge clk) begin\n    if ({}) {name}[{}] <= {};",
                    self.part(enable),
                    self.part(address),
                    self.part(data)
                );
                if let Op::Read(_, _, _, true) = self.inner.nodes[read].op {
                    let _ = writeln!(
                        text,
                        "    {} <= {};",
                        self.names[read],
                        self.expression(read)
                    );
                }
                text.push_str("  end\n");
            }
        }
    }

    fn instance(&self, text: &mut String, index: usize) {
        let instance = &self.inner.instances[index];
        let mut connections = vec![];
        for port in &instance.module.ports {
            let value = if port.name == "clk" || port.name == "rst" {
                port.name.clone()
            } else if let Some((_, id)) = instance.inputs.iter().find(|(n, _)| *n == port.name) {
                self.part(*id)
            } else {
                let (_, id) = instance
                    .outputs
                    .iter()
                    .find(|(n, _)| *n == port.name)
                    .expect("checked: every port is connected");
                self.names[*id].clone()
            };
            connections.push(format!("    .{}({value})", port.name));
        }
        let _ = writeln!(
            text,
            "  {} {} (\n{}\n  );",
            instance.module.name,
            instance.name,
            connections.join(",\n")
        );
    }

    /// Collects what nothing reads, so that lint knows that it is meant.
    fn unused(&self, text: &mut String, clocked: bool) {
        let mut parts = vec![];
        for (id, node) in self.inner.nodes.iter().enumerate() {
            if !self.declared[id] {
                continue;
            }
            let used = &self.used[id];
            if used.iter().all(|u| *u) {
                continue;
            }
            if used.iter().all(|u| !*u) {
                parts.push(self.names[id].clone());
                continue;
            }
            let mut bit = 0;
            while bit < node.width as usize {
                if used[bit] {
                    bit += 1;
                    continue;
                }
                let low = bit;
                while bit < node.width as usize && !used[bit] {
                    bit += 1;
                }
                parts.push(if bit - low == 1 {
                    format!("{}[{low}]", self.names[id])
                } else {
                    format!("{}[{}:{low}]", self.names[id], bit - 1)
                });
            }
        }
        let _ = clocked;
        if !parts.is_empty() {
            let _ = writeln!(text, "\n  // What nothing reads.");
            let joined = parts.join(", ");
            if joined.len() < LINE - 30 {
                let _ = writeln!(text, "  wire unused_ok = &{{1'b0, {joined}}};");
            } else {
                let _ = writeln!(
                    text,
                    "  wire unused_ok = &{{\n    1'b0,\n    {}\n  }};",
                    parts.join(",\n    ")
                );
            }
        }
    }
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
