//! Structural comparison of two modules at the outputs that they share.

use super::design::{Direction, Module};
use super::ir::{Id, InstanceData, Netlist, Op};
use super::memory::MemoryData;
use super::outline::Outline;
use std::collections::{HashMap, HashSet};
use std::sync::Arc;

/// The extent of a comparison of two modules, summed over all levels of the hierarchy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Compared {
    /// The number of outputs compared.
    pub outputs: usize,
    /// The number of registers compared.
    pub registers: usize,
    /// The number of memories compared.
    pub memories: usize,
    /// The number of instances compared.
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
    /// Compares every output of this module with the output of the same name of `whole`. The module
    /// `whole` may have more outputs.
    ///
    /// Both modules are reduced to expressions over inputs, registers, memories and outputs of
    /// instances; registers, memories and instances correspond by name. Two outputs are equal if
    /// their expressions are, and if the next values, enables, reset values and writes of all state
    /// that they depend on are equal expressions too. Then they have equal values in every cycle
    /// after a reset. The comparison is structural: modules that compute the same values by
    /// different expressions are reported as different.
    ///
    /// # Errors
    /// The first difference, in one line.
    pub fn compare_outputs(&self, whole: &Module) -> Result<Compared, String> {
        let sides = [Side::new(self, &[]), Side::new(whole, &[])];
        let mut matching = Matching::new(sides);
        matching
            .run()
            .map_err(|what| format!("{}: {what}", self.name()))
    }

    /// Compares a module with the modules of its parts.
    ///
    /// # Errors
    /// As [`Self::compare_outputs`].
    pub(super) fn compare_parts(&self, outline: &Outline) -> Result<Compared, String> {
        let sides = [
            Side::new(self, &[]),
            Side::new(&outline.top, &outline.parts),
        ];
        Matching::new(sides).run()
    }
}

/// An expression in terms of the numbers of its operands; equal expressions have the same number on both sides.
#[derive(PartialEq, Eq, Hash)]
enum Key {
    Input(String),
    Register(String),
    /// Memory and address of a combinational read.
    Read(String, Id),
    /// Memory and number of a synchronous read port; its address may depend on its value.
    SynchronousRead(String, usize),
    /// Instance and port.
    Output(String, String),
    /// An operation whose operands are numbers of expressions.
    Op(Op, u32),
}

/// State on which an expression depends, and whose next state must be compared as well.
enum State {
    Register(String),
    Memory(String),
    /// Memory, and number of a synchronous read port.
    Read(String, usize),
    Instance(String),
}

/// A netlist and its position in the hierarchy. Parts of a module are treated as if they were in the module itself.
struct Scope<'a> {
    ir: &'a Netlist,
    /// The parent scope, and the index of the instance there.
    within: Option<(usize, usize)>,
}

/// A node of a scope.
type At = (usize, Id);

struct Side<'a> {
    scopes: Vec<Scope<'a>>,
    /// The scope of each part, by the instance of the part.
    parts: HashMap<(usize, usize), usize>,
    registers: HashMap<&'a str, At>,
    /// The name of each register.
    names: HashMap<At, &'a str>,
    numbers: HashMap<At, Id>,
}

impl<'a> Side<'a> {
    /// Creates the scopes of a module and of its parts.
    fn new(module: &'a Module, parts: &'a [Arc<Module>]) -> Self {
        let mut side = Side {
            scopes: vec![],
            parts: HashMap::new(),
            registers: HashMap::new(),
            names: HashMap::new(),
            numbers: HashMap::new(),
        };
        side.open(&module.ir, None);
        for (instance, placed) in module.ir.instances.iter().enumerate() {
            if parts.iter().any(|part| Arc::ptr_eq(part, &placed.module)) {
                side.parts.insert((0, instance), side.scopes.len());
                side.open(&placed.module.ir, Some((0, instance)));
            }
        }
        side
    }

    fn open(&mut self, ir: &'a Netlist, within: Option<(usize, usize)>) {
        let scope = self.scopes.len();
        self.scopes.push(Scope { ir, within });
        let is_register = |id: Id| matches!(&ir.nodes[id].op, Op::Register(r) if !r.delay);
        for (id, node) in ir.nodes.iter().enumerate() {
            // An element with the name of a port has no name of its own.
            let mut ports = ir.ports.iter();
            let port = || ports.find_map(|(port, of)| (*of == id).then_some(&port.name));
            if is_register(id)
                && let Some(name) = node.name.as_ref().or_else(port)
            {
                self.registers.insert(name, (scope, id));
                self.names.insert((scope, id), name);
            }
        }
    }

    fn ir(&self, scope: usize) -> &'a Netlist {
        self.scopes[scope].ir
    }

    fn memory(&self, name: &str) -> Option<(usize, &'a MemoryData)> {
        let scopes = self.scopes.iter().enumerate();
        let mut memories =
            scopes.flat_map(|(scope, of)| of.ir.memories.iter().map(move |m| (scope, m)));
        memories.find(|(_, memory)| memory.name == name)
    }

    /// The address of a read port.
    fn address(&self, name: &str, port: usize) -> Option<At> {
        let (scope, _) = self.memory(name)?;
        let ir = self.ir(scope);
        ir.nodes.iter().find_map(|node| match node.op {
            Op::Read(memory, of, address, _) if ir.memories[memory].name == name && of == port => {
                Some((scope, address))
            }
            _ => None,
        })
    }

    fn instance(&self, name: &str) -> Option<(usize, &'a InstanceData)> {
        let scopes = self.scopes.iter().enumerate();
        let mut instances =
            scopes.flat_map(|(scope, of)| of.ir.instances.iter().map(move |i| (scope, i)));
        instances.find(|(_, instance)| instance.name == name)
    }

    /// The node that computes a value, behind wires and behind ports of parts.
    fn origin(&self, (scope, id): At) -> At {
        let ir = self.ir(scope);
        let node = &ir.nodes[id];
        let origin = match &node.op {
            Op::Wire => (scope, ir.drivers[&id]),
            Op::Slice(of, _) if ir.nodes[*of].width == node.width => (scope, *of),
            Op::Instance(instance, port) => match self.parts.get(&(scope, *instance)) {
                Some(part) => {
                    let name = &ir.instances[*instance].module.ports[*port].name;
                    let mut ports = self.ir(*part).ports.iter();
                    let port = ports.find(|(port, _)| port.name == *name);
                    (*part, port.expect("an instance has its module's ports").1)
                }
                None => return (scope, id),
            },
            Op::Input => match self.scopes[scope].within {
                Some((outer, instance)) => {
                    let mut inputs = self.ir(outer).instances[instance].inputs.iter();
                    let input = inputs.find(|(name, _)| node.name.as_ref() == Some(name));
                    (outer, input.expect("checked: every port is connected").1)
                }
                None => return (scope, id),
            },
            _ => return (scope, id),
        };
        self.origin(origin)
    }
}

struct Matching<'a> {
    sides: [Side<'a>; 2],
    known: HashMap<Key, Id>,
    open: Vec<State>,
}

impl<'a> Matching<'a> {
    fn new(sides: [Side<'a>; 2]) -> Self {
        Matching {
            sides,
            known: HashMap::new(),
            open: vec![],
        }
    }

    fn run(&mut self) -> Result<Compared, String> {
        let mut compared = Compared::default();
        let ports = self.sides.each_ref().map(|side| &side.ir(0).ports);
        for (port, id) in ports[0] {
            if port.direction == Direction::Input {
                continue;
            }
            let other = ports[1].iter().find(|(other, _)| other.name == port.name);
            let (_, other) =
                other.ok_or_else(|| format!("only one module has output {}", port.name))?;
            self.equal([(0, *id), (0, *other)], || format!("output {}", port.name))?;
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
                State::Read(name, port) if seen.insert(format!("read {port} of {name}")) => {
                    self.reads(&name, port)?;
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

    fn equal(&mut self, [a, b]: [At; 2], what: impl Fn() -> String) -> Result<(), String> {
        match self.number(0, a) == self.number(1, b) {
            true => Ok(()),
            false => Err(format!("{} differs", what())),
        }
    }

    fn both<T>(&self, what: &str, find: impl Fn(&Side<'a>) -> Option<T>) -> Result<[T; 2], String> {
        let [a, b] = self.sides.each_ref().map(find);
        a.zip(b)
            .map(|(a, b)| [a, b])
            .ok_or_else(|| format!("only one module has {what}"))
    }

    fn registers(&mut self, name: &str) -> Result<(), String> {
        let what = format!("register {name}");
        let [(scope, a), (other_scope, b)] =
            self.both(&what, |side| side.registers.get(name).copied())?;
        let nodes = [
            &self.sides[0].ir(scope).nodes[a],
            &self.sides[1].ir(other_scope).nodes[b],
        ];
        let [Op::Register(a), Op::Register(b)] = nodes.map(|node| &node.op) else {
            return Err(format!("{what} is none"));
        };
        let [width, other_width] = nodes.map(|node| node.width);
        if (width, a.reset, a.initial, a.enable.is_some())
            != (other_width, b.reset, b.initial, b.enable.is_some())
        {
            return Err(format!("{what} differs"));
        }
        for part in [[a.next, b.next], [a.enable, b.enable]] {
            if let [Some(a), Some(b)] = part {
                self.equal([(scope, a), (other_scope, b)], || what.clone())?;
            }
        }
        Ok(())
    }

    fn memories(&mut self, name: &str) -> Result<(), String> {
        let what = format!("memory {name}");
        let [(scope, a), (other_scope, b)] = self.both(&what, |side| side.memory(name))?;
        let alike = (a.depth, a.width, a.style) == (b.depth, b.width, b.style);
        let written = a.write.zip(b.write).filter(|_| alike);
        let (written, other) = written.ok_or_else(|| format!("{what} differs"))?;
        let ports = |(enable, address, data): (Id, Id, Id)| [enable, address, data];
        for (id, other) in ports(written).into_iter().zip(ports(other)) {
            self.equal([(scope, id), (other_scope, other)], || what.clone())?;
        }
        Ok(())
    }

    /// Compares the addresses of a synchronous read port.
    fn reads(&mut self, name: &str, port: usize) -> Result<(), String> {
        let what = format!("read port {port} of memory {name}");
        let [a, b] = self.both(&what, |side| side.address(name, port))?;
        self.equal([a, b], || what.clone())
    }

    fn instances(&mut self, name: &str) -> Result<Compared, String> {
        let what = format!("instance {name}");
        let [(scope, a), (other_scope, b)] = self.both(&what, |side| side.instance(name))?;
        for (port, id) in &a.inputs {
            let other = b.inputs.iter().find(|(other, _)| other == port);
            let (_, other) = other.ok_or_else(|| format!("only one {what} has input {port}"))?;
            let inputs = [(scope, *id), (other_scope, *other)];
            self.equal(inputs, || format!("input {port} of {what}"))?;
        }
        a.module.compare_outputs(&b.module)
    }

    /// The number of a node's expression.
    fn number(&mut self, side: usize, at: At) -> Id {
        if let Some(known) = self.sides[side].numbers.get(&at) {
            return *known;
        }
        let origin = self.sides[side].origin(at);
        let number = match origin == at {
            false => self.number(side, origin),
            true => {
                let key = self.key(side, at);
                let next = self.known.len();
                *self.known.entry(key).or_insert(next)
            }
        };
        self.sides[side].numbers.insert(at, number);
        number
    }

    fn key(&mut self, side: usize, (scope, id): At) -> Key {
        let ir = self.sides[side].ir(scope);
        let node = &ir.nodes[id];
        match &node.op {
            Op::Input => {
                let port = ir.ports.iter().find(|(_, node)| *node == id);
                Key::Input(port.map(|(port, _)| port.name.clone()).unwrap_or_default())
            }
            Op::Register(register) if !register.delay => {
                let name = self.sides[side].names.get(&(scope, id));
                // An element without a name has no counterpart.
                let name = name.map_or_else(
                    || format!("{scope}.{id} of {side}"),
                    |name| name.to_string(),
                );
                self.open.push(State::Register(name.clone()));
                Key::Register(name)
            }
            Op::Read(memory, port, address, synchronous) => {
                let name = ir.memories[*memory].name.clone();
                self.open.push(State::Memory(name.clone()));
                match synchronous {
                    false => Key::Read(name, self.number(side, (scope, *address))),
                    true => {
                        self.open.push(State::Read(name.clone(), *port));
                        Key::SynchronousRead(name, *port)
                    }
                }
            }
            Op::Instance(instance, port) => {
                let instance = &ir.instances[*instance];
                self.open.push(State::Instance(instance.name.clone()));
                let port = &instance.module.ports[*port].name;
                Key::Output(instance.name.clone(), port.clone())
            }
            Op::Slice(of, low) => {
                // Merge a slice of a slice into one slice.
                let (mut of, mut lowest) = (self.sides[side].origin((scope, *of)), *low);
                while let Op::Slice(whole, low) = &self.sides[side].ir(of.0).nodes[of.1].op {
                    lowest += low;
                    of = self.sides[side].origin((of.0, *whole));
                }
                Key::Op(Op::Slice(self.number(side, of), lowest), node.width)
            }
            op => Key::Op(
                op.map(&mut |operand| self.number(side, (scope, operand))),
                node.width,
            ),
        }
    }
}

#[cfg(test)]
mod tests {
    use crate::{Builder, Module, Style};
    use std::sync::Arc;

    /// A memory that is read at an address which depends on the word that was read before.
    fn chase(step: u8) -> Arc<Module> {
        let m = Builder::new("chase", "follows links.");
        let enable = m.input("enable", 1);
        let links = m.memory("links", 16, 4, Style::Block);
        let address = m.wire("address", 4);
        let link = links.read(address.get());
        address.drive(link + m.lit(step, 4));
        links.write(enable, m.lit(3u8, 4), link);
        m.output("link", link);
        m.finish().unwrap()
    }

    #[test]
    fn a_read_may_depend_on_the_word_read_before() {
        let (one, two) = (chase(1), chase(2));
        let compared = one.compare_outputs(&chase(1)).unwrap();
        assert_eq!((compared.outputs, compared.memories), (1, 1));
        let difference = one.compare_outputs(&two).unwrap_err();
        assert_eq!(difference, "chase: read port 0 of memory links differs");
    }
}
