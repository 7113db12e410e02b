//! Whether two modules do the same at the outputs that they share.

use super::design::{Direction, Module};
use super::ir::{Id, Netlist, Op};
use std::collections::{HashMap, HashSet};

/// How much of two modules was compared, all levels of the hierarchy together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Compared {
    pub outputs: usize,
    pub registers: usize,
    pub memories: usize,
    pub instances: usize,
}

impl Compared {
    fn add(&mut self, other: Compared) {
        self.outputs += other.outputs;
        self.registers += other.registers;
        self.memories += other.memories;
        self.instances += other.instances;
    }
}

impl Module {
    /// Compares every output of this module with that of the same name in `whole`, which may have more.
    ///
    /// Both are taken apart into expressions over inputs, registers, memories and outputs of instances. Registers, memories and
    /// instances correspond by name. Outputs that are equal expressions, over state whose next values, resets and writes are equal
    /// expressions, are equal at all clocks from a reset on: the two states stay the same, step by step.
    ///
    /// # Errors
    /// What differs, in one line. Modules that do the same by other expressions differ too.
    pub fn compare_outputs(&self, whole: &Module) -> Result<Compared, String> {
        let mut matching = Matching::new(self, whole);
        matching
            .run()
            .map_err(|what| format!("{}: {what}", self.name()))
    }
}

/// What an expression is, in terms of those that it is made of: equal ones have one number on both sides.
#[derive(PartialEq, Eq, Hash)]
enum Key {
    Input(String),
    Register(String),
    /// Memory, address, and whether the read is synchronous.
    Read(String, Id, bool),
    /// Instance and port.
    Output(String, String),
    /// Operands are numbers of expressions.
    Op(Op, u32),
}

/// State that an expression depends on, and whose own next state is to be compared.
enum State {
    Register(String),
    Memory(String),
    Instance(String),
}

struct Side<'a> {
    ir: &'a Netlist,
    numbers: Vec<Option<Id>>,
}

struct Matching<'a> {
    sides: [Side<'a>; 2],
    known: HashMap<Key, Id>,
    open: Vec<State>,
}

impl<'a> Matching<'a> {
    fn new(reduced: &'a Module, whole: &'a Module) -> Self {
        let side = |module: &'a Module| Side {
            ir: &module.ir,
            numbers: vec![None; module.ir.nodes.len()],
        };
        Matching {
            sides: [side(reduced), side(whole)],
            known: HashMap::new(),
            open: vec![],
        }
    }

    fn run(&mut self) -> Result<Compared, String> {
        let mut compared = Compared::default();
        let ports = self.sides.each_ref().map(|side| &side.ir.ports);
        for (port, id) in ports[0] {
            if port.direction == Direction::Input {
                continue;
            }
            let other = ports[1].iter().find(|(other, _)| other.name == port.name);
            let (_, other) = other.ok_or_else(|| format!("only one has output {}", port.name))?;
            self.equal([*id, *other], || format!("output {}", port.name))?;
            compared.outputs += 1;
        }
        let mut seen = HashSet::new();
        while let Some(state) = self.open.pop() {
            match state {
                State::Register(name) if seen.insert(format!("register {name}")) => {
                    self.registers(&name)?;
                    compared.registers += 1;
                }
                State::Memory(name) if seen.insert(format!("memory {name}")) => {
                    self.memories(&name)?;
                    compared.memories += 1;
                }
                State::Instance(name) if seen.insert(format!("instance {name}")) => {
                    compared.add(self.instances(&name)?);
                    compared.instances += 1;
                }
                _ => {}
            }
        }
        Ok(compared)
    }

    fn equal(&mut self, [a, b]: [Id; 2], what: impl Fn() -> String) -> Result<(), String> {
        match self.number(0, a) == self.number(1, b) {
            true => Ok(()),
            false => Err(format!("{} differs", what())),
        }
    }

    fn both<T>(
        &self,
        what: &str,
        find: impl Fn(&'a Netlist) -> Option<T>,
    ) -> Result<[T; 2], String> {
        let [a, b] = self.sides.each_ref().map(|side| find(side.ir));
        a.zip(b)
            .map(|(a, b)| [a, b])
            .ok_or_else(|| format!("only one has {what}"))
    }

    fn registers(&mut self, name: &str) -> Result<(), String> {
        let what = format!("register {name}");
        let named = |ir: &'a Netlist| {
            let mut nodes = ir.nodes.iter();
            nodes.find_map(|node| match &node.op {
                Op::Register(register) if node.name.as_deref() == Some(name) && !register.delay => {
                    Some((node.width, register))
                }
                _ => None,
            })
        };
        let [(width, a), (other_width, b)] = self.both(&what, named)?;
        if (width, a.reset, a.initial, a.enable.is_some())
            != (other_width, b.reset, b.initial, b.enable.is_some())
        {
            return Err(format!("{what} differs"));
        }
        for part in [[a.next, b.next], [a.enable, b.enable]] {
            if let [Some(a), Some(b)] = part {
                self.equal([a, b], || what.clone())?;
            }
        }
        Ok(())
    }

    fn memories(&mut self, name: &str) -> Result<(), String> {
        let what = format!("memory {name}");
        let named = |ir: &'a Netlist| ir.memories.iter().find(|memory| memory.name == name);
        let [a, b] = self.both(&what, named)?;
        let [written, other_written] = [a, b].map(|memory| memory.write);
        let alike = (a.depth, a.width, a.style) == (b.depth, b.width, b.style);
        match written.zip(other_written).filter(|_| alike) {
            Some(((enable, address, data), (other_enable, other_address, other_data))) => {
                self.equal([enable, other_enable], || what.clone())?;
                self.equal([address, other_address], || what.clone())?;
                self.equal([data, other_data], || what.clone())
            }
            None => Err(format!("{what} differs")),
        }
    }

    fn instances(&mut self, name: &str) -> Result<Compared, String> {
        let what = format!("instance {name}");
        let named = |ir: &'a Netlist| ir.instances.iter().find(|instance| instance.name == name);
        let [a, b] = self.both(&what, named)?;
        for (port, id) in &a.inputs {
            let other = b.inputs.iter().find(|(other, _)| other == port);
            let (_, other) = other.ok_or_else(|| format!("only one {what} has input {port}"))?;
            self.equal([*id, *other], || format!("input {port} of {what}"))?;
        }
        a.module.compare_outputs(&b.module)
    }

    /// The number of the expression that a node is.
    fn number(&mut self, side: usize, id: Id) -> Id {
        if let Some(known) = self.sides[side].numbers[id] {
            return known;
        }
        let ir = self.sides[side].ir;
        let node = &ir.nodes[id];
        let number = match &node.op {
            Op::Wire => self.number(side, ir.drivers[&id]),
            Op::Slice(of, _) if ir.nodes[*of].width == node.width => self.number(side, *of),
            op => {
                let key = self.key(side, id, op, node.width);
                let next = self.known.len();
                *self.known.entry(key).or_insert(next)
            }
        };
        self.sides[side].numbers[id] = Some(number);
        number
    }

    fn key(&mut self, side: usize, id: Id, op: &Op, width: u32) -> Key {
        let ir = self.sides[side].ir;
        match op {
            Op::Input => {
                let port = ir.ports.iter().find(|(_, node)| *node == id);
                Key::Input(port.map(|(port, _)| port.name.clone()).unwrap_or_default())
            }
            Op::Register(register) if !register.delay => {
                let name = ir.nodes[id].name.clone();
                // One without a name corresponds to none.
                let name = name.unwrap_or_else(|| format!("{id} of {side}"));
                self.open.push(State::Register(name.clone()));
                Key::Register(name)
            }
            Op::Read(memory, _, address, synchronous) => {
                let name = ir.memories[*memory].name.clone();
                self.open.push(State::Memory(name.clone()));
                Key::Read(name, self.number(side, *address), *synchronous)
            }
            Op::Instance(instance, port) => {
                let instance = &ir.instances[*instance];
                self.open.push(State::Instance(instance.name.clone()));
                let port = &instance.module.ports[*port].name;
                Key::Output(instance.name.clone(), port.clone())
            }
            op => Key::Op(op.map(&mut |operand| self.number(side, operand)), width),
        }
    }
}
