//! A module as data: what the builder makes, and what is checked, printed and changed.
//!
//! Nothing here refers to the builder, and everything is owned: a netlist can be shared between threads and outlives
//! the description that made it.

use super::design::{Module, Port};
use super::memory::MemoryData;
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

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub(super) enum Op {
    Input,
    Literal(u128),
    Not(Id),
    Binary(Binary, Id, Id),
    Mux(Id, Id, Id),
    /// Most significant part first.
    Concat(Vec<Id>),
    Repeat(Id, u32),
    /// Operand and least significant bit; the width is the node's.
    Slice(Id, u32),
    Any(Id),
    All(Id),
    Parity(Id),
    Wire,
    Register(Register),
    /// Memory, copy of it, address, and whether the read is synchronous.
    Read(usize, usize, Id, bool),
    /// Instance and index of its port.
    Instance(usize, usize),
    /// The reset.
    Reset,
    /// Of properties: a value that is any, and stays.
    AnyConst,
    /// Of properties: any value, at each clock another.
    AnySeq,
    /// Of properties: a word of a memory, at an address, as it is stored.
    Peek(usize, Id),
    /// Of properties: a signal inside an instance, by its node there.
    Inside(usize, Id),
}

#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(super) struct Register {
    pub next: Option<Id>,
    pub enable: Option<Id>,
    pub reset: Option<u128>,
    /// A delay register belongs to the pipeline, not to the module's state.
    pub delay: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub(super) struct Node {
    pub op: Op,
    pub width: u32,
    pub name: Option<String>,
    pub place: Place,
    pub stage: Option<Stage>,
    /// Delay registers of this signal are cleared by reset.
    pub cleared: bool,
    /// Made for properties: the module's Verilog does without it.
    pub formal: bool,
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

/// What is printed, in order.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Item {
    Node(Id),
    /// A wire's driver or a register's next value.
    Drive(Id),
    Comment(String),
    Instance(usize),
    Memory(usize),
}

/// Properties that are proved together, and what of the module may be anything meanwhile.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct ProofData {
    pub name: String,
    pub what: String,
    pub place: Place,
    pub assumes: Vec<(Place, Id)>,
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
    pub proofs: Vec<ProofData>,
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
            proofs: vec![],
        }
    }
}
