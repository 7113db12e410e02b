//! Determines what is printed for each node: equal values once, expressions in place or under a
//! name, and long chains of pipeline registers as delay lines.

use super::super::design::Direction;
use super::super::ir::{Binary, Hint, Id, Netlist, Op, Register};
use super::borders::{Borders, Owners};
use std::collections::{HashMap, HashSet};

/// Estimated length in characters above which an expression gets a wire.
const LONG_EXPRESSION: usize = 72;
/// The same for connections of an instance or a memory.
const LONG_CONNECTION: usize = 36;
/// Minimum number of registers of a chain with few readers that is printed as a delay line.
const DELAY_LINE: usize = 4;

/// A chain of pipeline registers of one signal, printed as a shift register or an array.
pub(in super::super) struct DelayLine {
    /// The registers, in the order in which they receive the value.
    pub registers: Vec<Id>,
}

pub(in super::super) struct Plan<'a> {
    pub ir: &'a Netlist,
    /// The node that is printed for a node: itself, or an earlier one with the same value.
    pub stands: Vec<Id>,
    /// The operation of each node, in terms of nodes that are printed.
    pub ops: Vec<Op>,
    /// Names given by the Rust source.
    pub given: Vec<Option<String>>,
    /// Suggested names; those of slices follow the names of their words.
    pub hints: Vec<Option<Hint>>,
    /// Whether the node is reached from an output, an instance or a memory.
    pub live: Vec<bool>,
    /// Whether the node is declared with a name.
    pub declared: Vec<bool>,
    /// For declared nodes, the bits that are used.
    pub used: Vec<Vec<bool>>,
    pub lines: Vec<DelayLine>,
    /// The delay line of a register, and the number of registers before it.
    pub in_line: Vec<Option<(usize, usize)>>,
    /// For each memory, its copies, each with the node that reads it.
    pub copies: Vec<Vec<Id>>,
    /// The declared node that a wire renames; both are one signal in the Verilog.
    merged: Vec<Option<Id>>,
    /// The boundaries of parts, for a module with parts.
    pub borders: Option<Borders>,
}

/// Nodes by value: equal expressions and equal pipeline registers are merged, independent of their recorded stage.
struct Values {
    stands: Vec<Id>,
    ops: Vec<Op>,
    given: Vec<Option<String>>,
    hints: Vec<Option<Hint>>,
}

impl Values {
    /// With `live`, the delayed slice of a signal becomes a slice of the delayed signal if that is live.
    fn of(ir: &Netlist, live: Option<&[bool]>) -> Values {
        let mut values = Values {
            stands: (0..ir.nodes.len()).collect(),
            ops: Vec::with_capacity(ir.nodes.len()),
            given: ir.nodes.iter().map(|n| n.name.clone()).collect(),
            hints: ir.nodes.iter().map(|n| n.hint.clone()).collect(),
        };
        let mut known: HashMap<(Op, u32), Id> = HashMap::new();
        for (id, node) in ir.nodes.iter().enumerate() {
            let state = matches!(&node.op, Op::Register(register) if !register.delay);
            let mut op = if state {
                node.op.clone() // its next value may come later
            } else {
                values.resolved(&node.op)
            };
            if let (Some(live), Op::Register(register)) = (live, &op)
                && let (true, Some(next)) = (register.delay, register.next)
                && let Some(slice) = values.of_delayed(ir, &known, live, register, next)
            {
                op = slice;
                let hint = values.hints[next].clone();
                values.hints[id] = values.hints[id].take().or(hint);
            }
            let same = match &op {
                Op::Slice(of, _) if ir.nodes[*of].width == node.width => Some(*of),
                Op::Input
                | Op::Wire
                | Op::Read(..)
                | Op::Instance(..)
                | Op::AnyConst
                | Op::AnySeq => None,
                Op::Register(_) if state => None,
                _ => known.get(&(op.clone(), node.width)).copied(),
            };
            match same {
                // A name given for properties does not apply to nodes of the module itself.
                Some(same)
                    if node.formal && !ir.nodes[same].formal && values.given[id].is_some() => {}
                Some(same) if values.given[id].is_none() || values.given[same].is_none() => {
                    values.stands[id] = same;
                    if let Some(name) = values.given[id].take() {
                        values.given[same] = Some(name);
                    }
                    let hint = values.hints[id].clone();
                    let of_module = !node.formal || ir.nodes[same].formal;
                    let is_field = hint.as_ref().is_some_and(|hint| hint.field);
                    if of_module && (is_field || values.hints[same].is_none()) {
                        values.hints[same] = hint;
                    }
                }
                Some(_) => {}
                None => {
                    known.insert((op.clone(), node.width), id);
                }
            }
            values.ops.push(op);
        }
        for id in 0..values.ops.len() {
            if matches!(&values.ops[id], Op::Register(register) if !register.delay) {
                values.ops[id] = values.resolved(&values.ops[id]);
            }
        }
        values
    }

    /// The slice of a live pipeline register that equals a delayed slice.
    fn of_delayed(
        &self,
        ir: &Netlist,
        known: &HashMap<(Op, u32), Id>,
        live: &[bool],
        register: &Register,
        mut slice: Id,
    ) -> Option<Op> {
        let mut lsb = 0;
        while let Op::Slice(of, low) = self.ops[slice] {
            lsb += low;
            let whole = Op::Register(Register {
                next: Some(of),
                ..register.clone()
            });
            if let Some(&whole) = known.get(&(whole, ir.nodes[of].width))
                && live[whole]
            {
                return Some(Op::Slice(whole, lsb));
            }
            slice = of;
        }
        None
    }

    /// Whether a slice is a named part of a word.
    fn is_part(&self, id: Id) -> bool {
        self.given[id].is_some()
            || self.hints[id]
                .as_ref()
                .is_some_and(|hint| hint.after.is_some())
    }

    fn resolved(&self, op: &Op) -> Op {
        match op.map(&mut |id| self.stands[id]) {
            Op::Slice(a, low) => match self.ops[a] {
                // A slice of a slice, with a change of stage in between, is one slice.
                Op::Slice(of, base) if !self.is_part(a) => Op::Slice(of, base + low),
                _ => Op::Slice(a, low),
            },
            op => op,
        }
    }
}

impl<'a> Plan<'a> {
    pub fn new(ir: &'a Netlist) -> Plan<'a> {
        let nodes = ir.nodes.len();
        let mut plan = Plan {
            ir,
            stands: vec![],
            ops: vec![],
            given: vec![],
            hints: vec![],
            live: vec![],
            declared: vec![false; nodes],
            used: vec![vec![]; nodes],
            lines: vec![],
            in_line: vec![None; nodes],
            copies: vec![],
            merged: vec![None; nodes],
            borders: None,
        };
        for first in [true, false] {
            let values = Values::of(ir, (!first).then_some(&plan.live));
            plan.stands = values.stands;
            plan.ops = values.ops;
            plan.given = values.given;
            plan.hints = values.hints;
            plan.live = plan.liveness();
        }
        plan.copies = vec![vec![]; ir.memories.len()];
        for (id, op) in plan.ops.iter().enumerate() {
            if let (true, Op::Read(memory, ..)) = (plan.live[id], op) {
                plan.copies[*memory].push(id);
            }
        }
        let count = plan.count_uses();
        let owners = Owners::of(ir);
        plan.find_delay_lines(&count, &owners);
        let live = plan.live.clone();
        plan.choose_declared(&count, &live);
        for id in (0..nodes).filter(|id| live[*id]) {
            let signal = plan.driven_by_name(id);
            // A node that each part computes itself has no declaration.
            let placed = |signal: &Id| ir.parts.is_empty() || !plan.is_light(*signal);
            plan.merged[id] = signal.filter(placed);
        }
        if !ir.parts.is_empty() {
            let borders = Borders::of(&plan, owners);
            for id in borders.enters.iter().flatten() {
                plan.declared[*id] = true;
            }
            plan.borders = Some(borders);
        }
        plan.mark_used();
        plan
    }

    /// The declared node that drives a wire, also through other wires.
    fn driven_by_name(&self, wire: Id) -> Option<Id> {
        if self.ops[wire] != Op::Wire {
            return None;
        }
        let driver = self.driver(wire);
        match self.driven_by_name(driver) {
            None => self.declared[driver].then_some(driver),
            further => further,
        }
    }

    /// Whether each part that reads a node computes it itself, instead of reading it through a port.
    pub fn is_light(&self, id: Id) -> bool {
        match self.ops[id] {
            Op::Literal(_) | Op::Reset | Op::Slice(..) => true,
            Op::Not(_) | Op::Repeat(..) => !self.declared[id],
            _ => false,
        }
    }

    /// The node whose declaration is used for a node: for a wire that a declared node drives, that node.
    pub fn signal(&self, id: Id) -> Id {
        self.merged.get(id).copied().flatten().unwrap_or(id)
    }

    /// Plans the nodes that properties read in addition to the module, and returns the new ones in order. Declarations of the module do not change.
    pub fn extend(&mut self, roots: &[Id]) -> Vec<Id> {
        let nodes = self.ops.len();
        let mut beside = vec![false; nodes];
        let mut count = vec![0; nodes];
        let (mut open, mut words) = (roots.to_vec(), vec![]);
        roots.iter().for_each(|id| count[*id] += 1);
        while let Some(id) = open.pop() {
            if self.declared[id] || std::mem::replace(&mut beside[id], true) {
                continue;
            }
            // A register of a delay line is an element of that line.
            if self.live[id] && self.in_line[id].is_some() {
                words.push(id);
                continue;
            }
            for source in self.sources(id) {
                count[source] += 1;
                open.push(source);
            }
        }
        self.choose_declared(&count, &beside);
        // Icarus 11 cannot read a word of an array within an expression.
        for id in words {
            self.declared[id] = true;
        }
        (0..nodes).filter(|id| beside[*id]).collect()
    }

    pub fn width(&self, id: Id) -> u32 {
        self.ir.nodes[id].width
    }

    /// The driver of a wire.
    pub fn driver(&self, wire: Id) -> Id {
        self.stands[self.ir.drivers[&wire]]
    }

    /// Enable, address and data of a memory's write port.
    pub fn write_port(&self, memory: usize) -> [Id; 3] {
        let (enable, address, data) = self.ir.memories[memory]
            .write
            .expect("checked: every memory is written");
        [enable, address, data].map(|id| self.stands[id])
    }

    /// All nodes on which a node depends, also through registers.
    pub fn sources(&self, id: Id) -> Vec<Id> {
        match &self.ops[id] {
            Op::Wire => vec![self.driver(id)],
            op => op.operands(),
        }
    }

    /// The nodes that instances read.
    fn connected(&self) -> impl Iterator<Item = Id> + '_ {
        self.ir
            .instances
            .iter()
            .flat_map(|i| i.inputs.iter().map(|(_, id)| self.stands[*id]))
    }

    /// The nodes that output ports read.
    pub fn outputs(&self) -> impl Iterator<Item = Id> + '_ {
        self.ir
            .ports
            .iter()
            .filter(|(p, _)| p.direction == Direction::Output)
            .map(|(_, id)| self.stands[*id])
    }

    fn liveness(&self) -> Vec<bool> {
        let mut live = vec![false; self.ops.len()];
        let mut stored = vec![false; self.ir.memories.len()];
        let mut open: Vec<Id> = self.outputs().chain(self.connected()).collect();
        while let Some(id) = open.pop() {
            if std::mem::replace(&mut live[id], true) {
                continue;
            }
            open.extend(self.sources(id));
            if let Op::Read(memory, ..) = self.ops[id]
                && !std::mem::replace(&mut stored[memory], true)
            {
                open.extend(self.write_port(memory));
            }
        }
        live
    }

    /// The number of readers of each node.
    fn count_uses(&self) -> Vec<usize> {
        let mut count = vec![0; self.ops.len()];
        for id in (0..self.ops.len()).filter(|id| self.live[*id]) {
            for source in self.sources(id) {
                count[source] += 1;
            }
        }
        for id in self.connected().chain(self.outputs()) {
            count[id] += 1;
        }
        for (memory, copies) in self.copies.iter().enumerate() {
            if !copies.is_empty() {
                for id in self.write_port(memory) {
                    count[id] += copies.len(); // each copy is written
                }
            }
        }
        count
    }

    fn delay(&self, id: Id) -> Option<(Id, Option<u128>)> {
        match &self.ops[id] {
            Op::Register(r) if r.delay && self.live[id] && self.stands[id] == id => {
                Some((r.next.expect("a delay register has a next value"), r.reset))
            }
            _ => None,
        }
    }

    fn find_delay_lines(&mut self, count: &[usize], owners: &Owners) {
        let mut follows: HashMap<Id, Id> = HashMap::new();
        let mut heads = vec![];
        for id in 0..self.ops.len() {
            let Some((next, reset)) = self.delay(id) else {
                continue;
            };
            match self.delay(next) {
                Some((_, before))
                    if before == reset
                        && !follows.contains_key(&next)
                        && owners.nodes[id] == owners.nodes[next] =>
                {
                    follows.insert(next, id);
                }
                _ => heads.push(id),
            }
        }
        for head in heads {
            let mut registers = vec![head];
            while let Some(id) = follows.get(&registers[registers.len() - 1]) {
                registers.push(*id);
            }
            let last = registers[registers.len() - 1];
            let read = registers
                .iter()
                .filter(|id| **id == last || count[**id] > 1 || self.given[**id].is_some())
                .count();
            // Reset clears only bits; arrays have no reset.
            let plain =
                self.width(head) == 1 || self.delay(head).is_some_and(|(_, reset)| reset.is_none());
            if plain && registers.len() >= DELAY_LINE && 2 * read <= registers.len() {
                for (at, id) in registers.iter().enumerate() {
                    self.in_line[*id] = Some((self.lines.len(), at));
                }
                self.lines.push(DelayLine { registers });
            }
        }
    }

    /// Whether the expression of an undeclared node is as short as a name.
    fn short(&self, id: Id) -> bool {
        match &self.ops[id] {
            Op::Literal(_) | Op::Reset | Op::Slice(..) => true,
            Op::Not(a) | Op::Repeat(a, _) => self.declared[*a] || self.short(*a),
            _ => false,
        }
    }

    /// Chooses the declared nodes among those in `scope`.
    fn choose_declared(&mut self, count: &[usize], scope: &[bool]) {
        let mut sliced = HashSet::new();
        for (id, op) in self.ops.iter().enumerate() {
            if let (true, Op::Slice(of, _) | Op::Bit(of, _)) = (scope[id], op) {
                sliced.insert(*of);
            }
        }
        // The first operands of a chain of equal operators are printed with it, one line per operand if it is long.
        let mut goes_on = HashSet::new();
        for op in &self.ops {
            if let Op::Binary(of, first, _) = op
                && of.is_associative()
                && matches!(self.ops[*first], Op::Binary(before, ..) if before == *of)
                && count[*first] == 1
            {
                goes_on.insert(*first);
            }
        }
        let mut length = vec![0usize; self.ops.len()];
        for id in 0..self.ops.len() {
            // Inputs and outputs of instances exist even if they are unused.
            if matches!(self.ops[id], Op::Input | Op::Instance(..)) {
                self.declared[id] = true;
                continue;
            }
            if !scope[id] {
                continue;
            }
            let state = match &self.ops[id] {
                Op::Register(_) => match self.in_line[id] {
                    Some((line, at)) => {
                        let read = at + 1 == self.lines[line].registers.len() || count[id] > 1;
                        self.declared[id] =
                            read || self.given[id].is_some() || sliced.contains(&id);
                        continue;
                    }
                    None => true,
                },
                Op::Wire | Op::Read(..) | Op::AnyConst | Op::AnySeq | Op::Inside(..) => true,
                _ => false,
            };
            if state {
                self.declared[id] = true;
                continue;
            }
            let sources = self.sources(id);
            for source in &sources {
                // A chain of choices is printed with one line per choice, so it cannot be an operand.
                let rest = matches!(self.ops[id], Op::Mux(_, _, rest) if rest == *source);
                if !rest && self.chained(*source) {
                    self.declared[*source] = true;
                }
            }
            if let Op::Binary(Binary::Mul, ..) = self.ops[id] {
                // The operands of a product have its width, so they cannot be expressions with operators.
                for source in sources.iter().filter(|source| scope[**source]) {
                    self.declared[*source] |= !matches!(
                        self.ops[*source],
                        Op::Literal(_) | Op::Slice(..) | Op::Concat(_) | Op::Repeat(..)
                    );
                }
            }
            let own = match &self.ops[id] {
                Op::Literal(_) => 6,
                Op::Binary(..) => 5,
                Op::Mux(..) => 8,
                Op::Concat(parts) => 2 * parts.len(),
                _ => 4,
            };
            let operands: usize = sources
                .iter()
                .filter(|source| {
                    let chain = matches!(self.ops[id], Op::Mux(_, _, rest) if rest == **source);
                    !(chain && matches!(self.ops[**source], Op::Mux(..)))
                })
                .map(|source| match &self.given[*source] {
                    Some(name) => name.len(),
                    None if self.declared[*source] => 14,
                    None => length[*source],
                })
                .sum();
            length[id] = own + operands;
            self.declared[id] = self.given[id].is_some()
                || self.hints[id].as_ref().is_some_and(|hint| hint.field)
                || sliced.contains(&id)
                // The width of a product is determined by its context, so it gets its own assignment.
                || matches!(self.ops[id], Op::Binary(Binary::Mul, ..))
                || !self.short(id)
                    && (count[id] > 1 || length[id] > LONG_EXPRESSION && !goes_on.contains(&id));
        }
        let mut connected: Vec<Id> = self.connected().collect();
        for (memory, copies) in self.copies.iter().enumerate() {
            if !copies.is_empty() {
                connected.extend(self.write_port(memory));
            }
        }
        for id in connected {
            if self.chained(id) || length[id] > LONG_CONNECTION {
                self.declared[id] = true;
            }
        }
        // It can be neither a condition, nor an address, nor a part of a delay line's next value.
        let heads = self.lines.iter().map(|line| line.registers[0]);
        let heads: Vec<Id> = heads.flat_map(|id| self.sources(id)).collect();
        let within = (0..self.ops.len()).filter(|id| scope[*id]);
        let within = within.filter_map(|id| match &self.ops[id] {
            Op::Register(register) => register.enable,
            Op::Read(_, _, address, _) | Op::Peek(_, address) | Op::Bit(_, address) => {
                Some(*address)
            }
            _ => None,
        });
        for id in within.chain(heads).collect::<Vec<_>>() {
            if self.chained(id) {
                self.declared[id] = true;
            }
        }
    }

    /// Whether the last alternative of a choice is another choice that is printed in place.
    pub fn chained(&self, id: Id) -> bool {
        match &self.ops[id] {
            Op::Mux(_, _, rest) => {
                !self.declared[id]
                    && !self.declared[*rest]
                    && matches!(self.ops[*rest], Op::Mux(..))
            }
            _ => false,
        }
    }

    fn mark_used(&mut self) {
        for id in 0..self.ops.len() {
            self.used[id] = vec![false; self.width(id) as usize];
        }
        for reader in 0..self.ops.len() {
            if !self.live[reader] {
                continue;
            }
            match self.ops[reader] {
                // The reader of a slice that is printed in place reads the sliced signal: see `mark`.
                Op::Slice(..) if !self.declared[reader] => {}
                Op::Slice(of, low) => self.mark(of, low, self.width(reader)),
                // A register of a delay line reads its predecessor inside the line.
                Op::Register(_) if self.in_line[reader].is_some_and(|(_, at)| at > 0) => {}
                Op::Wire if self.merged[reader].is_some() => {}
                _ => {
                    for source in self.sources(reader) {
                        self.mark(source, 0, self.width(source));
                    }
                }
            }
        }
        let mut outside: Vec<Id> = self.connected().chain(self.outputs()).collect();
        for (memory, copies) in self.copies.iter().enumerate() {
            if !copies.is_empty() {
                outside.extend(self.write_port(memory));
            }
        }
        for id in outside {
            self.mark(id, 0, self.width(id));
        }
        for wire in 0..self.ops.len() {
            if let Some(signal) = self.merged[wire] {
                let used = std::mem::take(&mut self.used[wire]);
                for (of_signal, of_wire) in self.used[signal].iter_mut().zip(used) {
                    *of_signal |= of_wire;
                }
            }
        }
    }

    fn mark(&mut self, id: Id, low: u32, width: u32) {
        self.used[id][low as usize..(low + width) as usize].fill(true);
        if let Op::Slice(of, base) = self.ops[id]
            && !self.declared[id]
        {
            self.mark(of, base + low, width);
        }
    }
}
