//! The signals, memories and instances of a finished module, by name.

use super::{Owner, Point, Reads, Slot, Where, write_port};
use crate::design::{Direction, Module, Port};
use crate::error::HdlError;
use crate::ir::{Id, Node, Op, Place, Root};
use std::collections::HashSet;
use std::panic::Location;
use std::sync::Arc;

/// A signal of a finished module. Returned by [`Module::signal`].
#[derive(Clone, Copy, Debug)]
pub struct SignalRef<'m> {
    pub(super) module: &'m Module,
    pub(super) point: Point,
}

impl<'m> SignalRef<'m> {
    /// Returns the width in bits.
    pub fn width(&self) -> u32 {
        self.module.ir.nodes[self.module.id(self.point)].width
    }

    /// Returns the module that has the signal.
    pub fn module(&self) -> &'m Module {
        self.module
    }
}

/// A memory of a finished module. Returned by [`Module::memory`].
#[derive(Clone, Copy, Debug)]
pub struct MemoryRef<'m> {
    module: &'m Module,
    index: usize,
}

impl<'m> MemoryRef<'m> {
    /// Returns the name of the memory.
    pub fn name(&self) -> &'m str {
        &self.module.ir.memories[self.index].name
    }

    /// Returns the number of words.
    pub fn depth(&self) -> u32 {
        self.module.ir.memories[self.index].depth
    }

    /// Returns the width of a word in bits.
    pub fn width(&self) -> u32 {
        self.module.ir.memories[self.index].width
    }

    /// Returns the number of copies in the Verilog, one for each read port.
    pub fn copies(&self) -> usize {
        self.module.printed.copies[self.index]
    }

    /// Names the enable of the write port, for a [`Mutation`](super::Mutation).
    pub fn write_enable(&self) -> Reads<&'m Module> {
        write_port(self.module, self.index, 0)
    }

    /// Names the address of the write port, for a [`Mutation`](super::Mutation).
    pub fn write_address(&self) -> Reads<&'m Module> {
        write_port(self.module, self.index, 1)
    }

    /// Names the data of the write port, for a [`Mutation`](super::Mutation).
    pub fn write_data(&self) -> Reads<&'m Module> {
        write_port(self.module, self.index, 2)
    }
}

/// An instance in a finished module. Returned by [`Module::instances`].
#[derive(Clone, Copy, Debug)]
pub struct InstanceRef<'m> {
    within: &'m Module,
    index: usize,
}

impl<'m> InstanceRef<'m> {
    /// Returns the name of the instance.
    pub fn name(&self) -> &'m str {
        &self.within.ir.instances[self.index].name
    }

    /// Returns the module that is instantiated.
    pub fn module(&self) -> &'m Arc<Module> {
        &self.within.ir.instances[self.index].module
    }

    /// Names the signal that an input of the instance reads, for a [`Mutation`](super::Mutation).
    ///
    /// # Errors
    /// The instance has no such input.
    #[track_caller]
    pub fn input(&self, port: &str) -> Result<Reads<&'m Module>, HdlError> {
        let inputs = self.within.ir.instances[self.index].inputs.iter();
        let names = inputs.map(|(name, _)| name.as_str()).collect();
        let input = self.found("input", port, names, Location::caller())?;
        Ok(Reads {
            owner: self.within,
            at: Ok(Where::At(Slot(Root::Input(self.index, input)), vec![])),
        })
    }

    /// Returns an output of the instance.
    ///
    /// # Errors
    /// The instance has no such output.
    #[track_caller]
    pub fn output(&self, port: &str) -> Result<SignalRef<'m>, HdlError> {
        let outputs = &self.within.ir.instances[self.index].outputs;
        let names = outputs.iter().map(|(name, _)| name.as_str()).collect();
        let output = self.found("output", port, names, Location::caller())?;
        Ok(SignalRef {
            module: self.within,
            point: Point::Node(outputs[output].1),
        })
    }

    fn found(
        &self,
        kind: &str,
        port: &str,
        names: Vec<&str>,
        place: Place,
    ) -> Result<usize, HdlError> {
        let at = names.iter().position(|name| *name == port);
        at.ok_or_else(|| {
            let kind = format!("instance {} has no {kind}", self.name());
            self.within.missing(&kind, port, &names, place)
        })
    }
}

/// Maximum number of similar names in an error message.
const OFFERED: usize = 5;

impl Module {
    pub(super) fn missing(&self, what: &str, name: &str, names: &[&str], place: Place) -> HdlError {
        // Names with the most common pairs of letters are the most similar.
        let pairs = |text: &str| -> HashSet<(u8, u8)> {
            let bytes = text.as_bytes();
            bytes.windows(2).map(|pair| (pair[0], pair[1])).collect()
        };
        let wanted = pairs(name);
        let mut near: Vec<_> = (names.iter())
            .map(|other| {
                let of_other = pairs(other);
                let common = wanted.intersection(&of_other).count();
                let all = wanted.union(&of_other).count().max(1);
                (common * 1000 / all, *other)
            })
            .filter(|(common, _)| *common > 0)
            .collect();
        near.sort_by(|a, b| b.0.cmp(&a.0).then(a.1.cmp(b.1)));
        near.dedup();
        let near: Vec<_> = near.iter().take(OFFERED).map(|(_, name)| *name).collect();
        let offer = match &near[..] {
            [] => String::new(),
            near => format!("; similar names: {}", near.join(", ")),
        };
        HdlError {
            module: self.name().to_string(),
            message: format!("{what} \"{name}\"{offer}"),
            place,
        }
    }

    /// Returns a signal by its name in the description, or an output port.
    ///
    /// # Errors
    /// The module has no such signal; the message suggests similar names.
    #[track_caller]
    pub fn signal(&self, name: &str) -> Result<SignalRef<'_>, HdlError> {
        let named = |node: &Node| node.name.as_deref() == Some(name);
        let output =
            |(port, _): &(Port, Id)| port.direction == Direction::Output && port.name == name;
        let ports = &self.ir.ports;
        let point = match ports.iter().position(output) {
            Some(port) => {
                // A signal without another name has the name of its output port.
                let id = ports[port].1;
                let node = &self.ir.nodes[id];
                let first = ports.iter().position(|(_, other)| *other == id);
                let own = node.name.is_none() && !matches!(node.op, Op::Literal(_));
                Some(match own && first == Some(port) {
                    true => Point::Node(id),
                    false => Point::Output(port),
                })
            }
            None => self.ir.nodes.iter().position(named).map(Point::Node),
        };
        let (module, place) = (self, Location::caller());
        point
            .map(|point| SignalRef { module, point })
            .ok_or_else(|| {
                let outputs = self.ir.ports.iter().map(|(port, _)| port.name.as_str());
                let nodes = self.ir.nodes.iter();
                let named = nodes.filter_map(|node| node.name.as_deref());
                let names: Vec<_> = named.chain(outputs).collect();
                self.missing("it has no signal", name, &names, place)
            })
    }

    /// Returns a memory by its name.
    ///
    /// # Errors
    /// The module has no such memory; the message suggests similar names.
    #[track_caller]
    pub fn memory(&self, name: &str) -> Result<MemoryRef<'_>, HdlError> {
        let place = Location::caller();
        let found = self.memories().into_iter().find(|m| m.name() == name);
        found.ok_or_else(|| {
            let names: Vec<_> = self.memories().iter().map(|m| m.name()).collect();
            self.missing("it has no memory", name, &names, place)
        })
    }

    /// Returns all memories, in the order of their declaration.
    pub fn memories(&self) -> Vec<MemoryRef<'_>> {
        let all = 0..self.ir.memories.len();
        all.map(|index| MemoryRef {
            module: self,
            index,
        })
        .collect()
    }

    /// Returns all instances, in the order of their declaration.
    pub fn instances(&self) -> Vec<InstanceRef<'_>> {
        let all = 0..self.ir.instances.len();
        all.map(|index| InstanceRef {
            within: self,
            index,
        })
        .collect()
    }

    /// Returns the instances of modules whose name is `module`, or `module` followed by `_` and
    /// anything.
    pub fn instances_of(&self, module: &str) -> Vec<InstanceRef<'_>> {
        let of = |instance: &InstanceRef<'_>| {
            let rest = instance.module().name().strip_prefix(module);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('_'))
        };
        self.instances().into_iter().filter(of).collect()
    }
}
