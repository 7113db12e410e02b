//! A module as data: what the builder makes, and what is checked, printed and changed.
//!
//! Nothing here refers to the builder, and everything is owned: a netlist can be shared between threads and outlives
//! the description that made it.

use super::design::{Module, Port};
use super::library::Placed;
use super::memory::MemoryData;
use super::mutation::Mutation;
use super::pipeline::Stage;
use std::collections::HashMap;
use std::panic::Location;
use std::sync::Arc;

pub(super) type Id = usize;
pub(super) type Place = &'static Location<'static>;

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) enum Binary {
    And,
    Or,
    Xor,
    Add,
    Sub,
    Mul,
    Equal,
    NotEqual,
    Less,
    LessEqual,
    ShiftLeft,
    ShiftRight,
}

impl Binary {
    /// Whether a chain of it needs no parentheses.
    pub fn is_associative(self) -> bool {
        matches!(self, Binary::And | Binary::Or | Binary::Xor | Binary::Add)
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Op {
    Input,
    /// The reset, `rst`.
    Reset,
    Literal(u128),
    Not(Id),
    Binary(Binary, Id, Id),
    Mux(Id, Id, Id),
    /// Most significant part first.
    Concat(Vec<Id>),
    Repeat(Id, u32),
    /// Operand and least significant bit; the width is the node's.
    Slice(Id, u32),
    /// Word, and the number of one of its bits.
    Bit(Id, Id),
    Any(Id),
    All(Id),
    Parity(Id),
    Wire,
    Register(Register),
    /// Memory, copy of it, address, and whether the read is synchronous.
    Read(usize, usize, Id, bool),
    /// Instance and index of its port.
    Instance(usize, usize),
    /// Of properties: a value that is any, and stays.
    AnyConst,
    /// Of properties: any value, at each clock another.
    AnySeq,
    /// Of properties: a word of a memory, at an address, as it is stored.
    Peek(usize, Id),
    /// Of properties: a signal inside an instance, by its node there.
    Inside(usize, Id),
}

impl Op {
    /// The same operation on other operands. A register's are its next value, then its enable.
    pub fn map(&self, at: &mut dyn FnMut(Id) -> Id) -> Op {
        match self {
            Op::Not(a) => Op::Not(at(*a)),
            Op::Binary(op, a, b) => Op::Binary(*op, at(*a), at(*b)),
            Op::Mux(c, a, b) => Op::Mux(at(*c), at(*a), at(*b)),
            Op::Concat(parts) => Op::Concat(parts.iter().map(|id| at(*id)).collect()),
            Op::Repeat(a, times) => Op::Repeat(at(*a), *times),
            Op::Slice(a, low) => Op::Slice(at(*a), *low),
            Op::Bit(a, index) => Op::Bit(at(*a), at(*index)),
            Op::Any(a) => Op::Any(at(*a)),
            Op::All(a) => Op::All(at(*a)),
            Op::Parity(a) => Op::Parity(at(*a)),
            Op::Register(register) => Op::Register(Register {
                next: register.next.map(&mut *at),
                enable: register.enable.map(&mut *at),
                ..register.clone()
            }),
            Op::Read(memory, copy, address, synchronous) => {
                Op::Read(*memory, *copy, at(*address), *synchronous)
            }
            Op::Peek(memory, address) => Op::Peek(*memory, at(*address)),
            Op::Input
            | Op::Reset
            | Op::Literal(_)
            | Op::Wire
            | Op::Instance(..)
            | Op::AnyConst
            | Op::AnySeq
            | Op::Inside(..) => self.clone(),
        }
    }

    pub fn operands(&self) -> Vec<Id> {
        let mut all = vec![];
        self.map(&mut |id| {
            all.push(id);
            id
        });
        all
    }
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Register {
    pub next: Option<Id>,
    pub enable: Option<Id>,
    pub reset: Option<u128>,
    /// What it holds before the first clock, in simulation.
    pub initial: Option<u128>,
    /// A delay register belongs to the pipeline, not to the module's state.
    pub delay: bool,
}

/// What a node is called if it gets a name in the Verilog.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Hint {
    pub name: String,
    /// The node behind whose name it goes.
    pub after: Option<Id>,
    /// A field of a word: it gets a name wherever it is read.
    pub field: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    pub op: Op,
    pub width: u32,
    pub name: Option<String>,
    pub hint: Option<Hint>,
    pub place: Place,
    pub stage: Option<Stage>,
    /// Delay registers of this signal are cleared by reset.
    pub cleared: bool,
    /// Made for properties: the module's Verilog does without it.
    pub formal: bool,
}

impl Node {
    /// Whether a slice is a word's part that has a name.
    pub fn is_part(&self) -> bool {
        self.name.is_some() || self.hint.as_ref().is_some_and(|hint| hint.after.is_some())
    }
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct InstanceData {
    pub name: String,
    pub module: Arc<Module>,
    /// Input ports by name.
    pub inputs: Vec<(String, Id)>,
    /// Output ports by name.
    pub outputs: Vec<(String, Id)>,
}

/// A place that reads a node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub(super) enum Root {
    /// Every reader of a node; what it computes itself is read there, so to speak.
    Value(Id),
    /// A wire.
    Driver(Id),
    /// A register.
    Next(Id),
    Enable(Id),
    /// What reads a memory.
    Address(Id),
    /// A memory's write port: enable, address, data.
    Write(usize, usize),
    /// An instance and its input.
    Input(usize, usize),
    /// A port.
    Output(usize),
}

/// What is printed, in order.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Item {
    Node(Id),
    /// A wire's driver or a register's next value.
    Drive(Id),
    Comment(String),
    Instance(usize),
    Memory(usize),
    /// What follows is described in a part, by its number from 1 on; 0 is the module itself.
    Part(usize),
}

/// A part of a module that is printed as a module of its own.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PartData {
    pub name: String,
    pub doc: String,
    pub place: Place,
}

/// Properties that are proved together, and what of the module may be anything meanwhile.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ProofData {
    pub name: String,
    pub what: String,
    pub place: Place,
    pub assumes: Vec<(String, Id)>,
    pub asserts: Vec<(String, Id)>,
    pub covers: Vec<(String, Id)>,
    /// Signals that have any value at each clock, whatever drives them.
    pub cut: Vec<Id>,
    /// Instances that stay; all others have outputs of any value.
    pub kept: Vec<usize>,
    /// Clocks that a step of the induction looks back.
    pub depth: u32,
    /// Whether memories stay arrays for the solver; else each word is a register.
    pub arrays: bool,
    /// Faults that the proof must find, in words.
    pub faults: Vec<(String, Mutation)>,
}

impl ProofData {
    /// All the nodes that it speaks of.
    pub fn nodes(&mut self) -> impl Iterator<Item = &mut Id> {
        let said = self.assumes.iter_mut().chain(&mut self.asserts);
        let said = said.chain(&mut self.covers).map(|(_, id)| id);
        said.chain(&mut self.cut)
    }
}

/// A module's hierarchy level: its nodes and what connects them.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Netlist {
    pub name: String,
    pub doc: String,
    pub place: Place,
    pub nodes: Vec<Node>,
    pub items: Vec<Item>,
    /// What drives each wire and register.
    pub drivers: HashMap<Id, Id>,
    /// Where each wire or register is driven.
    pub driven_at: HashMap<Id, Place>,
    pub instances: Vec<InstanceData>,
    pub memories: Vec<MemoryData>,
    /// Ports in order, with the node of each.
    pub ports: Vec<(Port, Id)>,
    /// Names that are taken, and where.
    pub names: HashMap<String, Place>,
    /// What is printed as modules of its own.
    pub parts: Vec<PartData>,
    pub proofs: Vec<ProofData>,
    /// What of the library it is.
    pub placed: Option<Placed>,
}

impl Netlist {
    /// A module of nothing.
    pub fn new(name: String, doc: String, place: Place) -> Self {
        Netlist {
            name,
            doc,
            place,
            nodes: vec![],
            items: vec![],
            drivers: HashMap::new(),
            driven_at: HashMap::new(),
            instances: vec![],
            memories: vec![],
            ports: vec![],
            names: HashMap::new(),
            parts: vec![],
            proofs: vec![],
            placed: None,
        }
    }
}
