//! A module as data, which the builder creates and which is checked, printed and changed.
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
    /// Whether a chain of this operator needs no parentheses.
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
    /// Operand and lowest bit; the width is that of the node.
    Slice(Id, u32),
    /// A word, and the number of one of its bits.
    Bit(Id, Id),
    Any(Id),
    All(Id),
    Parity(Id),
    Wire,
    Register(Register),
    /// Memory, number of its copy, address, and whether the read is synchronous.
    Read(usize, usize, Id, bool),
    /// Instance and index of its port.
    Instance(usize, usize),
    /// For properties: an arbitrary constant value.
    AnyConst,
    /// For properties: an arbitrary value in each cycle.
    AnySeq,
    /// For properties: the stored word of a memory at an address.
    Peek(usize, Id),
    /// For properties: a signal inside an instance, by its node there.
    Inside(usize, Id),
}

impl Op {
    /// The same operation with other operands. The operands of a register are its next value, then its enable.
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
    /// Its value before the first clock edge in simulation.
    pub initial: Option<u128>,
    /// Whether it is a pipeline register, which is not part of the module's state.
    pub delay: bool,
}

/// The suggested name of a node, if it needs a name in the Verilog.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Hint {
    pub name: String,
    /// The node whose name is the prefix.
    pub after: Option<Id>,
    /// Whether the node is a field of a word, which is named wherever it is read.
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
    /// Whether reset clears the pipeline registers of this signal.
    pub cleared: bool,
    /// Whether it was made for properties and is not in the module's Verilog.
    pub formal: bool,
}

impl Node {
    /// Whether it is a slice that is a named part of a word.
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
    /// All readers of a node at once, for the place where it is computed.
    Value(Id),
    /// The driver of a wire.
    Driver(Id),
    /// The next value of a register.
    Next(Id),
    Enable(Id),
    /// The address of a memory's read port.
    Address(Id),
    /// A memory's write port: enable, address, data.
    Write(usize, usize),
    /// An instance, and the number of its input.
    Input(usize, usize),
    /// An output port.
    Output(usize),
}

/// The statements to print, in order.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Item {
    Node(Id),
    /// The driver of a wire, or the next value of a register.
    Drive(Id),
    Comment(String),
    Instance(usize),
    Memory(usize),
    /// The following statements belong to a part, numbered from 1; 0 is the module itself.
    Part(usize),
}

/// A part of a module that is printed as a separate module.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct PartData {
    pub name: String,
    pub doc: String,
    pub place: Place,
}

/// Properties that are proved together, and the signals that are arbitrary in the proof.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ProofData {
    pub name: String,
    pub what: String,
    pub place: Place,
    pub assumes: Vec<(String, Id)>,
    pub asserts: Vec<(String, Id)>,
    pub covers: Vec<(String, Id)>,
    /// Signals with an arbitrary value in each cycle, independent of their drivers.
    pub cut: Vec<Id>,
    /// Instances with their actual logic; the outputs of all others are arbitrary.
    pub kept: Vec<usize>,
    /// The number of cycles that an induction step looks back.
    pub depth: u32,
    /// Whether memories remain arrays for the solver; otherwise each word is a register.
    pub arrays: bool,
    /// Faults that the proof must detect, with descriptions.
    pub faults: Vec<(String, Mutation)>,
}

impl ProofData {
    /// All nodes to which it refers.
    pub fn nodes(&mut self) -> impl Iterator<Item = &mut Id> {
        let said = self.assumes.iter_mut().chain(&mut self.asserts);
        let said = said.chain(&mut self.covers).map(|(_, id)| id);
        said.chain(&mut self.cut)
    }
}

/// One level of the hierarchy: the nodes of a module and their connections.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Netlist {
    pub name: String,
    pub doc: String,
    pub place: Place,
    pub nodes: Vec<Node>,
    pub items: Vec<Item>,
    /// The driver of each wire and register.
    pub drivers: HashMap<Id, Id>,
    /// The place of each driver in the Rust source.
    pub driven_at: HashMap<Id, Place>,
    pub instances: Vec<InstanceData>,
    pub memories: Vec<MemoryData>,
    /// Ports in order, with the node of each.
    pub ports: Vec<(Port, Id)>,
    /// Used names, and the places of their declarations.
    pub names: HashMap<String, Place>,
    /// The parts that are printed as separate modules.
    pub parts: Vec<PartData>,
    pub proofs: Vec<ProofData>,
    /// Its library and parameters, if it belongs to one.
    pub placed: Option<Placed>,
}

impl Netlist {
    /// Creates an empty module.
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
