//! Prints state: registers, delays, memories.

use super::super::ir::{Id, Op, Register, Root};
use super::super::memory::Style;
use super::plan::DelayLine;
use super::{Body, LINE, Printer, length};
use std::fmt::Write as _;

/// Verilator unrolls loops up to this number of steps, and does not accept longer loops with delayed assignments to an array.
const LOOP_STEPS: usize = 64;

impl Printer<'_> {
    fn register(&self, id: Id) -> &Register {
        match &self.plan.ops[id] {
            Op::Register(register) => register,
            _ => unreachable!("only registers are clocked"),
        }
    }

    pub(super) fn register_statement(&self, id: Id) -> String {
        let register = self.register(id);
        let name = &self.names.of[id];
        let next = register.next.expect("checked: every register is driven");
        let mark = self.mark(Root::Next(id));
        let condition = register.enable.map(|id| format!("if ({})", self.part(id)));
        let fits = |line: &str| !line.contains('\n') && length(line) + 4 <= LINE;
        // After its dependencies, on a separate line if it then fits on one line.
        let assigned = |before: &str| {
            let condition = condition.as_deref().unwrap_or_default();
            let before = format!("{before} {condition}");
            let before = before.trim();
            let alone = self.assignment(&format!("{name} <="), next);
            let line = self.assignment(format!("{before} {name} <=").trim(), next);
            match fits(&line) || condition.is_empty() || alone.contains('\n') {
                true => line,
                false => format!("{before}\n    {alone}"),
            }
        };
        let Some(reset) = register.reset else {
            return mark + &assigned("");
        };
        let clear = self.numbers.literal(reset, self.plan.width(id));
        let clear = format!("if (rst) {name} <= {clear};");
        let line = assigned(&format!("{clear} else"));
        match fits(&line) {
            true => mark + &line,
            false => format!("{mark}{clear}\n  {}", assigned("else")),
        }
    }

    /// Prints pipeline registers stage by stage, then delay lines.
    pub(super) fn delays(&self, body: &mut Body, delays: Vec<Id>) {
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
        let lines = &self.plan.lines;
        if !lines.is_empty() {
            body.comment(
                "Delay lines: they align values of a pipeline; index 0 is the newest value.",
            );
            if lines.iter().any(|line| self.is_array(line)) {
                body.line(&format!("integer {};", self.names.counter));
            }
            let names = lines.iter().zip(&self.names.lines);
            let statements = names.flat_map(|(line, name)| self.delay_line(line, name));
            body.always(&statements.collect::<Vec<_>>());
        }
    }

    /// Whether a delay line is an array of words; bits form one word.
    fn is_array(&self, line: &DelayLine) -> bool {
        self.plan.width(line.registers[0]) > 1
    }

    pub(super) fn delay_line_declaration(&self, line: usize) -> String {
        let (line, name) = (&self.plan.lines[line], &self.names.lines[line]);
        let last = (self.numbers).bits(line.registers.len() as u32 - 1, 0);
        match self.is_array(line) {
            // Yosys converts it to registers in any case; the attribute suppresses its warning.
            true => format!(
                "(* mem2reg *) reg {}{name} [0:{}];",
                self.numbers.range(self.plan.width(line.registers[0])),
                line.registers.len() - 1
            ),
            false => format!("reg  {last} {name};"),
        }
    }

    fn delay_line(&self, line: &DelayLine, name: &str) -> Vec<String> {
        let head = line.registers[0];
        let register = self.register(head);
        let next = register.next.expect("a delay register has a next value");
        let (mark, clocks) = (self.mark(Root::Next(head)), line.registers.len());
        if !self.is_array(line) {
            let next = format!(
                "{name} <= {{{name}{}, {}}};",
                self.numbers.bits(clocks as u32 - 2, 0),
                self.part(next)
            );
            let clear = register.reset.map(|value| {
                format!(
                    "if (rst) {name} <= {};",
                    self.numbers.literal(value, clocks as u32)
                )
            });
            return vec![match clear {
                None => mark + &next,
                Some(clear) if length(&clear) + length(&next) + 10 <= LINE => {
                    format!("{mark}{clear} else {next}")
                }
                Some(clear) => format!("{mark}{clear}\n  else {next}"),
            }];
        }
        let i = &self.names.counter;
        let first = mark + &self.assignment(&format!("{name}[0] <="), next);
        let loops = (1..clocks).step_by(LOOP_STEPS).map(|from| {
            let end = clocks.min(from + LOOP_STEPS);
            let head = format!("for ({i} = {from}; {i} < {end}; {i} = {i} + 1)");
            let step = format!("{name}[{i}] <= {name}[{i} - 1];");
            match head.len() + step.len() + 5 <= LINE {
                true => format!("{head} {step}"),
                false => format!("{head}\n    {step}"),
            }
        });
        std::iter::once(first).chain(loops).collect()
    }

    /// Prints the copies of a memory, each with the statement that writes and reads it.
    pub(super) fn memory(&self, body: &mut Body, index: usize, early: &[bool]) {
        let memory = &self.ir().memories[index];
        let style = match memory.style {
            Style::Block => "block",
            Style::Distributed => "distributed",
        };
        let clocked = std::mem::take(&mut body.clocked);
        for (name, &read) in self.names.copies[index]
            .iter()
            .zip(&self.plan.copies[index])
        {
            let mut text = format!(
                "  (* no_rw_check, ram_style = \"{style}\" *)\n  reg  {}{name} [0:{}];\n",
                self.numbers.range(memory.width),
                self.numbers.plain(memory.depth - 1)
            );
            let declared = early[read] || self.is_declared_elsewhere(read);
            let word = format!(
                "{}{}",
                self.numbers.range(memory.width),
                self.names.of[read]
            );
            if self.is_reg(read) && !declared {
                let _ = writeln!(text, "  reg  {word};");
            }
            let [enable, address, data] = self.plan.write_port(index).map(|id| self.part(id));
            let mark = self.mark(Root::Write(index, 0));
            let write = format!("{mark}if ({enable}) {name}[{address}] <= {data};");
            let mut statements = vec![write];
            let mark = self.mark(Root::Address(read));
            let (target, value) = (&self.names.of[read], self.expression(read));
            if self.is_reg(read) {
                statements.push(format!("{mark}{target} <= {value};"));
            }
            text += &Body::always_block(&statements);
            body.block(&text);
            if !self.is_reg(read) {
                let target = if declared {
                    format!("assign {target}")
                } else {
                    format!("wire {word}")
                };
                body.line(&format!("{mark}{target} = {value};"));
            }
        }
        body.clocked = clocked;
    }

    /// Prints the initial values of registers in simulation.
    pub(super) fn initial(&self, body: &mut Body) {
        let plan = &self.plan;
        let mut lines = vec![];
        for id in (0..plan.ops.len()).filter(|id| plan.live[*id]) {
            let Op::Register(register) = &plan.ops[id] else {
                continue;
            };
            let Some(value) = register.initial else {
                continue;
            };
            let value = self.numbers.literal(value, plan.width(id));
            let target = match plan.in_line[id] {
                None => self.names.of[id].clone(),
                Some((line, at)) => format!("{}[{at}]", self.names.lines[line]),
            };
            lines.push(format!("    {target} = {value};\n"));
        }
        if !lines.is_empty() {
            body.block(&format!("  initial begin\n{}  end\n", lines.concat()));
        }
    }
}
