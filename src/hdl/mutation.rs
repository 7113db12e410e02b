//! Single changes of a module: mutants, and faults that proofs and benches must find.
//!
//! A [`Mutation`] says that something is read as something else in one place: `sum.reads(carry).as_value(0)`. It is made from
//! [`Signal`]s, where a module is described, or from [`SignalRef`]s, by the names of a finished one, and holds no more than numbers of
//! nodes. [`Module::with`] is the module with the change, [`Design::with`] the design; [`Design::selectable`] holds many changes, of which
//! one is selected.
//!
//! Only the nodes between the place and what is read there are made anew: whatever else reads shared logic sees nothing of it.

use super::builder::Builder;
use super::design::{Design, Direction, Module, Port};
use super::error::HdlError;
use super::ir::{Binary, Id, Item, Netlist, Node, Op, Place, Register, Root};
use super::memory::Memory;
use super::signal::Signal;
use super::verilog::{Printer, literal};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::panic::Location;
use std::sync::Arc;

/// A change of one module.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Mutation {
    module: String,
    edit: Edit,
}

impl Mutation {
    /// The name of the module that it changes.
    pub fn module(&self) -> &str {
        &self.module
    }
}

#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Edit {
    Read(Where, Change),
    /// What reset gives a register, if it gives it anything.
    Reset(Id, Option<u128>),
    /// Why there is no such change.
    Wrong(String),
}

/// What is read otherwise.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub enum Where {
    /// A node, where a signal is computed.
    Of(Point, Id),
    /// Literals of a value, where a signal is computed.
    Literal(Point, u128),
    /// A signal, wherever it is read.
    Everywhere(Point),
    /// What a place reads, or what that reads: operands, each of the one before.
    At(Slot, Vec<usize>),
}

/// A signal, by its node or, of an output, by its port.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Point {
    Node(Id),
    Output(usize),
}

/// A place that reads a node, for what is public in name alone.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Slot(pub(super) Root);

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Change {
    Value(u128),
    Inverted,
    Signal(Id),
    Late,
    Early,
    /// Another operator, or none.
    Operator,
    /// A slice without its top bit, or a bit lower.
    Shorter,
    Lower,
}

/// What a change changes.
#[derive(
    Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, serde::Serialize, serde::Deserialize,
)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// One operator in place of another, or none.
    Operator,
    /// The lowest bit of a literal.
    Constant,
    /// A condition negated, or held.
    Condition,
    /// A slice that loses its top bit, or lies a bit lower.
    Width,
    /// A register's value in reset, or no reset at all.
    Reset,
    /// A pipeline's register left out: a value from the stage before.
    Register,
}

impl Kind {
    pub const ALL: [Kind; 6] = [
        Kind::Operator,
        Kind::Constant,
        Kind::Condition,
        Kind::Width,
        Kind::Reset,
        Kind::Register,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Kind::Operator => "operator",
            Kind::Constant => "constant",
            Kind::Condition => "condition",
            Kind::Width => "width",
            Kind::Reset => "reset",
            Kind::Register => "register",
        }
    }
}

/// A change that a module admits, and how its Verilog shows it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Site {
    pub kind: Kind,
    pub mutation: Mutation,
    /// Where in the module's Verilog the statement begins, from 1 on.
    pub line: usize,
    /// The expression as it is and as it becomes.
    pub before: String,
    pub after: String,
}

/// Where signals are from: a description, or a finished module.
pub trait Owner: Sized {
    type Signal;

    fn made(&self, edit: Edit, place: Place) -> Mutation;

    /// The signal's place, if it is the owner's.
    fn point(&self, signal: Self::Signal) -> Option<Point>;

    fn id(&self, point: Point) -> Id;
}

impl<'b> Owner for &'b Builder {
    type Signal = Signal<'b>;

    fn made(&self, edit: Edit, place: Place) -> Mutation {
        let module = self.name.clone();
        let mutation = Mutation { module, edit };
        let mut inner = self.inner.borrow_mut();
        inner.mutations.push((mutation.clone(), place));
        mutation
    }

    fn point(&self, signal: Signal<'b>) -> Option<Point> {
        std::ptr::eq(signal.builder, *self).then_some(Point::Node(signal.id))
    }

    fn id(&self, point: Point) -> Id {
        self.inner.borrow().ir.node_of(point)
    }
}

impl<'m> Owner for &'m Module {
    type Signal = SignalRef<'m>;

    fn made(&self, edit: Edit, _: Place) -> Mutation {
        let module = self.name().to_string();
        Mutation { module, edit }
    }

    fn point(&self, signal: SignalRef<'m>) -> Option<Point> {
        std::ptr::eq(signal.module, *self).then_some(signal.point)
    }

    fn id(&self, point: Point) -> Id {
        self.ir.node_of(point)
    }
}

impl Netlist {
    fn node_of(&self, point: Point) -> Id {
        match point {
            Point::Node(id) => id,
            Point::Output(port) => self.ports[port].1,
        }
    }
}

/// What is read, in one place or in all, before it is said as what it is read instead.
#[must_use]
#[derive(Clone)]
pub struct Reads<O> {
    owner: O,
    at: Result<Where, String>,
}

impl<O: Owner> Reads<O> {
    fn made_of(self, change: Result<Change, String>, place: Place) -> Mutation {
        let edit = match self.at.and_then(|at| Ok(Edit::Read(at, change?))) {
            Ok(edit) => edit,
            Err(why) => Edit::Wrong(why),
        };
        self.owner.made(edit, place)
    }

    /// It is read as a constant.
    #[track_caller]
    pub fn as_value(self, value: u128) -> Mutation {
        self.made_of(Ok(Change::Value(value)), Location::caller())
    }

    /// It is read with all bits inverted.
    #[track_caller]
    pub fn inverted(self) -> Mutation {
        self.made_of(Ok(Change::Inverted), Location::caller())
    }

    /// Another signal of the module is read.
    #[track_caller]
    pub fn as_signal(self, other: O::Signal) -> Mutation {
        let point = self.owner.point(other);
        let change = point.map(|point| Change::Signal(self.owner.id(point)));
        let change = change.ok_or("what is to be read is a signal of another module".to_string());
        self.made_of(change, Location::caller())
    }

    /// Its value of the clock before is read.
    #[track_caller]
    pub fn one_clock_late(self) -> Mutation {
        self.made_of(Ok(Change::Late), Location::caller())
    }

    /// What a delay register takes is read rather than what it shows.
    #[track_caller]
    pub fn one_clock_early(self) -> Mutation {
        self.made_of(Ok(Change::Early), Location::caller())
    }
}

macro_rules! changes_of_signals {
    ($signal:ty, $owner:ty, $of:expr) => {
        /// Changes: see [`Mutation`].
        impl<'b> $signal {
            fn reading(self, at: impl FnOnce(Point) -> Where) -> Reads<$owner> {
                let owner: $owner = $of(&self);
                let point = owner.point(self).expect("a signal is of its own module");
                Reads {
                    at: Ok(at(point)),
                    owner,
                }
            }

            /// `of`, where this signal is computed: in its combinational logic; of a wire in its driver's, of a register in that of its
            /// next value and its enable. Where the logic as far back as the next named signals reads `of`, it changes there alone, else
            /// further back. Of a pipeline, `of` stands for itself at later stages too, where it is not read itself.
            pub fn reads(self, of: Self) -> Reads<$owner> {
                let owner: $owner = $of(&self);
                let of = owner.point(of).map(|of| owner.id(of));
                match of {
                    Some(of) => self.reading(|point| Where::Of(point, of)),
                    None => Reads {
                        at: Err("what is read is a signal of another module".into()),
                        owner,
                    },
                }
            }

            /// Literals of this value, where this signal is computed: see [`Self::reads`].
            pub fn literal_of(self, value: u128) -> Reads<$owner> {
                self.reading(|point| Where::Literal(point, value))
            }

            /// This signal, wherever it is read.
            pub fn fault(self) -> Reads<$owner> {
                self.reading(Where::Everywhere)
            }

            /// This register's enable; 1 where it has none.
            pub fn enable(self) -> Reads<$owner> {
                let owner: $owner = $of(&self);
                self.reading(|point| Where::At(Slot(Root::Enable(owner.id(point))), vec![]))
            }

            /// Reset leaves this register as it is.
            #[track_caller]
            pub fn without_reset(self) -> Mutation {
                let owner: $owner = $of(&self);
                let point = owner.point(self).expect("a signal is of its own module");
                owner.made(Edit::Reset(owner.id(point), None), Location::caller())
            }
        }
    };
}
changes_of_signals!(Signal<'b>, &'b Builder, |signal: &Signal<'b>| signal
    .builder);
changes_of_signals!(SignalRef<'b>, &'b Module, |signal: &SignalRef<'b>| signal
    .module);

impl<'b> Reads<&'b Builder> {
    pub(super) fn of_input(
        owner: &'b Builder,
        instance: usize,
        input: Result<usize, String>,
    ) -> Self {
        let slot = |input| Where::At(Slot(Root::Input(instance, input)), vec![]);
        Reads {
            owner,
            at: input.map(slot),
        }
    }
}

fn write_port<O>(owner: O, memory: usize, role: usize) -> Reads<O> {
    Reads {
        owner,
        at: Ok(Where::At(Slot(Root::Write(memory, role)), vec![])),
    }
}

impl<'b> Memory<'b> {
    /// The write port's enable, for a [`Mutation`].
    pub fn write_enable(&self) -> Reads<&'b Builder> {
        write_port(self.builder, self.index, 0)
    }

    /// The write port's address, for a [`Mutation`].
    pub fn write_address(&self) -> Reads<&'b Builder> {
        write_port(self.builder, self.index, 1)
    }
}

/// A signal of a finished module.
#[derive(Clone, Copy, Debug)]
pub struct SignalRef<'m> {
    module: &'m Module,
    point: Point,
}

impl<'m> SignalRef<'m> {
    pub fn width(&self) -> u32 {
        self.module.ir.nodes[self.module.id(self.point)].width
    }

    /// The module that has it.
    pub fn module(&self) -> &'m Module {
        self.module
    }
}

/// A memory of a finished module.
#[derive(Clone, Copy, Debug)]
pub struct MemoryRef<'m> {
    module: &'m Module,
    index: usize,
}

impl<'m> MemoryRef<'m> {
    pub fn name(&self) -> &'m str {
        &self.module.ir.memories[self.index].name
    }

    pub fn depth(&self) -> u32 {
        self.module.ir.memories[self.index].depth
    }

    pub fn width(&self) -> u32 {
        self.module.ir.memories[self.index].width
    }

    /// Copies of it, one for each place that reads it.
    pub fn copies(&self) -> usize {
        self.module.printed.copies[self.index]
    }

    /// The write port's enable, for a [`Mutation`].
    pub fn write_enable(&self) -> Reads<&'m Module> {
        write_port(self.module, self.index, 0)
    }

    /// The write port's address, for a [`Mutation`].
    pub fn write_address(&self) -> Reads<&'m Module> {
        write_port(self.module, self.index, 1)
    }
}

/// An instance in a finished module.
#[derive(Clone, Copy, Debug)]
pub struct InstanceRef<'m> {
    within: &'m Module,
    index: usize,
}

impl<'m> InstanceRef<'m> {
    pub fn name(&self) -> &'m str {
        &self.within.ir.instances[self.index].name
    }

    pub fn module(&self) -> &'m Arc<Module> {
        &self.within.ir.instances[self.index].module
    }

    /// What an input is given.
    ///
    /// # Errors
    /// There is no such input.
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

    /// What an output gives.
    ///
    /// # Errors
    /// There is no such output.
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

/// How many names like a wrong one a message offers.
const OFFERED: usize = 5;

impl Module {
    fn missing(&self, what: &str, name: &str, names: &[&str], place: Place) -> HdlError {
        // Names that have most pairs of letters in common are nearest.
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
            near => format!("; it has {}", near.join(", ")),
        };
        HdlError {
            module: self.name().to_string(),
            message: format!("{what} \"{name}\"{offer}"),
            place,
        }
    }

    /// A signal by the name that the description gives it, or a port.
    ///
    /// # Errors
    /// There is none; the error has the names that are most like it.
    #[track_caller]
    pub fn signal(&self, name: &str) -> Result<SignalRef<'_>, HdlError> {
        let named = |node: &Node| node.name.as_deref() == Some(name);
        let output =
            |(port, _): &(Port, Id)| port.direction == Direction::Output && port.name == name;
        let point = match self.ir.ports.iter().position(output) {
            Some(port) => Some(Point::Output(port)),
            None => self.ir.nodes.iter().position(named).map(Point::Node),
        };
        let module = self;
        point
            .map(|point| SignalRef { module, point })
            .ok_or_else(|| {
                let outputs = self.ir.ports.iter().map(|(port, _)| port.name.as_str());
                let nodes = self.ir.nodes.iter();
                let named = nodes.filter_map(|node| node.name.as_deref());
                let names: Vec<_> = named.chain(outputs).collect();
                self.missing("it has no signal", name, &names, Location::caller())
            })
    }

    /// A memory by its name.
    ///
    /// # Errors
    /// There is none.
    #[track_caller]
    pub fn memory(&self, name: &str) -> Result<MemoryRef<'_>, HdlError> {
        let place = Location::caller();
        let found = self.memories().into_iter().find(|m| m.name() == name);
        found.ok_or_else(|| {
            let names: Vec<_> = self.memories().iter().map(|m| m.name()).collect();
            self.missing("it has no memory", name, &names, place)
        })
    }

    pub fn memories(&self) -> Vec<MemoryRef<'_>> {
        let all = 0..self.ir.memories.len();
        all.map(|index| MemoryRef {
            module: self,
            index,
        })
        .collect()
    }

    pub fn instances(&self) -> Vec<InstanceRef<'_>> {
        let all = 0..self.ir.instances.len();
        all.map(|index| InstanceRef {
            within: self,
            index,
        })
        .collect()
    }

    /// Instances of modules that are called so, or so with `_` and parameters behind it.
    pub fn instances_of(&self, module: &str) -> Vec<InstanceRef<'_>> {
        let of = |instance: &InstanceRef<'_>| {
            let rest = instance.module().name().strip_prefix(module);
            rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('_'))
        };
        self.instances().into_iter().filter(of).collect()
    }

    fn error(&self, message: String, place: Place) -> HdlError {
        HdlError {
            module: self.name().to_string(),
            message,
            place,
        }
    }

    /// Whether a mutation can be made.
    pub(super) fn admits(&self, mutation: &Mutation, place: Place) -> Result<(), HdlError> {
        let printer = Printer::new(&self.ir);
        let found = Editor::new(&printer).resolve(mutation);
        found.map(drop).map_err(|why| self.error(why, place))
    }

    /// The module with a change.
    ///
    /// # Errors
    /// The change is not of this module, or changes nothing; the module that it makes is not sound.
    #[track_caller]
    pub fn with(&self, mutation: &Mutation) -> Result<Arc<Module>, HdlError> {
        self.changed(mutation, Location::caller())
    }

    fn changed(&self, mutation: &Mutation, place: Place) -> Result<Arc<Module>, HdlError> {
        let error = |why| self.error(why, place);
        if mutation.module != self.name() {
            return Err(error(format!("the change is of {}", mutation.module)));
        }
        let printer = Printer::new(&self.ir);
        let mut editor = Editor::new(&printer);
        for (root, instead) in editor.resolve(mutation).map_err(error)? {
            editor.set(root, instead);
        }
        if let Edit::Reset(register, value) = mutation.edit {
            let register = editor.stands[register];
            if let Op::Register(register) = &mut editor.ir.nodes[register].op {
                register.reset = value;
            }
        }
        let module = Module::of(editor.finish())?;
        if module.verilog() == self.verilog() {
            return Err(error(format!("nothing comes of a change: {mutation:?}")));
        }
        Ok(Arc::new(module))
    }
}

/// The place of a new item: before the item of this number; first there where something is changed as soon as it is made.
type Gap = (usize, bool);

/// A netlist that is being changed: one without copies of equal nodes, to which nodes are added.
struct Editor {
    ir: Netlist,
    /// For each node of the module as it was the one that is printed for it.
    stands: Vec<Id>,
    /// What a delay register, or a slice of one, shows a clock later.
    earlier: HashMap<Id, Id>,
    /// From which gap on a node can be read.
    available: Vec<usize>,
    /// The items that drive wires and registers, and that of each instance.
    drives: HashMap<Id, usize>,
    instances: Vec<usize>,
    new: BTreeMap<(usize, bool), Vec<Item>>,
    /// What every reader of a node reads instead.
    redirected: HashMap<Id, Id>,
    /// New nodes that read a node in spite of that.
    exempt: HashSet<(Id, Id)>,
}

/// Comes before those that are not first.
const FIRST: bool = false;

impl Editor {
    fn new(printer: &Printer<'_>) -> Editor {
        let plan = &printer.plan;
        let mut ir = plan.ir.clone();
        let at = |id: &mut Id| *id = plan.stands[*id];
        let mut earlier = HashMap::new();
        for (id, node) in ir.nodes.iter_mut().enumerate() {
            if let Op::Register(Register {
                next: Some(next),
                delay: true,
                ..
            }) = node.op
            {
                earlier.insert(plan.stands[id], plan.stands[next]);
            }
            node.op = plan.ops[id].clone();
            node.name.clone_from(&plan.given[id]);
        }
        ir.drivers.values_mut().for_each(at);
        ir.ports.iter_mut().for_each(|(_, id)| at(id));
        for instance in &mut ir.instances {
            instance.inputs.iter_mut().for_each(|(_, id)| at(id));
        }
        for proof in &mut ir.proofs {
            proof.nodes().for_each(at);
        }
        for (enable, address, data) in ir.memories.iter_mut().filter_map(|m| m.write.as_mut()) {
            [enable, address, data].into_iter().for_each(at);
        }
        let mut available = vec![0; ir.nodes.len()];
        let (mut drives, mut instances) = (HashMap::new(), vec![0; ir.instances.len()]);
        for (place, item) in ir.items.iter().enumerate() {
            match item {
                Item::Node(id) => available[*id] = place + 1,
                Item::Drive(id) => drop(drives.insert(*id, place)),
                Item::Instance(index) => {
                    instances[*index] = place;
                    for (_, id) in &ir.instances[*index].outputs {
                        available[*id] = place + 1;
                    }
                }
                Item::Comment(_) | Item::Memory(_) => {}
            }
        }
        Editor {
            stands: plan.stands.clone(),
            earlier,
            available,
            drives,
            instances,
            new: BTreeMap::new(),
            redirected: HashMap::new(),
            exempt: HashSet::new(),
            ir,
        }
    }

    fn end(&self) -> Gap {
        (self.ir.items.len(), !FIRST)
    }

    /// Where what a place reads is made.
    fn gap(&self, root: Root) -> Gap {
        let delay = |id: Id| matches!(&self.ir.nodes[id].op, Op::Register(r) if r.delay);
        match root {
            Root::Value(id) => (self.available[id], FIRST),
            Root::Next(id) if delay(id) => (self.available[id] - 1, !FIRST),
            Root::Driver(id) | Root::Next(id) | Root::Enable(id) => (self.drives[&id], !FIRST),
            Root::Address(id) => (self.available[id] - 1, !FIRST),
            Root::Input(instance, _) => (self.instances[instance], !FIRST),
            Root::Write(..) | Root::Output(_) => self.end(),
        }
    }

    fn push(&mut self, gap: Gap, op: Op, width: u32) -> Id {
        let id = self.ir.nodes.len();
        let place = self.ir.place;
        self.ir.nodes.push(Node {
            op,
            width,
            name: None,
            place,
            stage: None,
            cleared: false,
            formal: false,
        });
        self.available.push(gap.0);
        self.new.entry(gap).or_default().push(Item::Node(id));
        id
    }

    fn literal(&mut self, value: u128, width: u32) -> Id {
        self.push((0, FIRST), Op::Literal(value), width)
    }

    fn not(&mut self, gap: Gap, id: Id) -> Id {
        self.push(gap, Op::Not(id), self.ir.nodes[id].width)
    }

    /// A wire for what is made later, or earlier than it is named.
    fn wire(&mut self, gap: Gap, driver: Id) -> Id {
        let name = (0..)
            .map(|number| format!("changed_{number}"))
            .find(|name| !self.ir.names.contains_key(name));
        let name = name.expect("some number is free");
        let wire = self.push(gap, Op::Wire, self.ir.nodes[driver].width);
        self.ir.names.insert(name.clone(), self.ir.place);
        self.ir.nodes[wire].name = Some(name);
        self.ir.drivers.insert(wire, driver);
        wire
    }

    /// What a place reads, if it can be read otherwise.
    fn get(&self, root: Root) -> Result<Id, String> {
        let computed = |id: Id| {
            let name = &self.ir.nodes[id].name;
            format!(
                "nothing is read there by {}",
                name.as_deref().unwrap_or("it")
            )
        };
        Ok(match root {
            Root::Value(id) => id,
            Root::Driver(id) => self.ir.drivers[&id],
            Root::Next(id) => match &self.ir.nodes[id].op {
                Op::Register(register) => register.next.ok_or_else(|| computed(id))?,
                _ => return Err(computed(id)),
            },
            Root::Enable(id) => match &self.ir.nodes[id].op {
                Op::Register(register) => register.enable.ok_or_else(|| computed(id))?,
                _ => return Err(computed(id)),
            },
            Root::Address(id) => match self.ir.nodes[id].op {
                Op::Read(_, _, address, _) => address,
                _ => return Err(computed(id)),
            },
            Root::Write(memory, role) => {
                let port = self.ir.memories[memory].write;
                let (enable, address, data) = port.ok_or("the memory is not written")?;
                [enable, address, data][role]
            }
            Root::Input(instance, input) => self.ir.instances[instance].inputs[input].1,
            Root::Output(port) => self.ir.ports[port].1,
        })
    }

    fn set(&mut self, root: Root, new: Id) {
        match root {
            Root::Value(id) => {
                // A computed value's name goes with it.
                let nodes = &mut self.ir.nodes;
                let state = matches!(
                    nodes[id].op,
                    Op::Input | Op::Register(_) | Op::Read(..) | Op::Instance(..)
                );
                if !state && new >= self.stands.len() && nodes[new].name.is_none() {
                    nodes[new].name = nodes[id].name.take();
                }
                self.redirected.insert(id, new);
            }
            Root::Driver(id) => drop(self.ir.drivers.insert(id, new)),
            Root::Next(id) | Root::Enable(id) => {
                if let Op::Register(register) = &mut self.ir.nodes[id].op {
                    match root {
                        Root::Next(_) => {
                            register.next = Some(new);
                            self.ir.drivers.insert(id, new);
                        }
                        _ => register.enable = Some(new),
                    }
                }
            }
            Root::Address(id) => {
                if let Op::Read(_, _, address, _) = &mut self.ir.nodes[id].op {
                    *address = new;
                }
            }
            Root::Write(memory, role) => {
                if let Some((enable, address, data)) = &mut self.ir.memories[memory].write {
                    *[enable, address, data][role] = new;
                }
            }
            Root::Input(instance, input) => self.ir.instances[instance].inputs[input].1 = new,
            Root::Output(port) => self.ir.ports[port].1 = new,
        }
    }

    /// What the places of a mutation read instead.
    fn resolve(&mut self, mutation: &Mutation) -> Result<Vec<(Root, Id)>, String> {
        let before = self.ir.nodes.len();
        let all = match &mutation.edit {
            Edit::Wrong(why) => return Err(why.clone()),
            Edit::Reset(register, value) => {
                let node = &self.ir.nodes[self.stands[*register]];
                let reset = match &node.op {
                    Op::Register(register) => register.reset,
                    _ => None,
                };
                return match reset == *value || reset.is_none() {
                    true => Err("reset gives it no other value as it is".into()),
                    false => Ok(vec![]),
                };
            }
            Edit::Read(Where::At(Slot(root), path), change) => {
                let root = match *root {
                    Root::Enable(id) => Root::Enable(self.stands[id]),
                    root => root,
                };
                let gap = self.gap(root);
                let id = match (root, self.get(root)) {
                    // A register without an enable takes every value.
                    (Root::Enable(id), Err(_)) if self.drives.contains_key(&id) => {
                        self.literal(1, 1)
                    }
                    (_, id) => id?,
                };
                vec![(root, self.along(id, path, *change, gap)?)]
            }
            Edit::Read(Where::Everywhere(point), change) => {
                let root = match *point {
                    Point::Output(port) => Root::Output(port),
                    Point::Node(id) => {
                        let id = self.stands[id];
                        match self.ir.nodes[id].op {
                            Op::Wire => Root::Driver(id),
                            _ => Root::Value(id),
                        }
                    }
                };
                let (gap, id) = (self.gap(root), self.get(root)?);
                vec![(root, self.instead(id, *change, gap)?)]
            }
            Edit::Read(Where::Of(point, of), change) => {
                let of = self.stands[*of];
                let exactly = self.within(*point, &mut |_, id| id == of, *change)?;
                let later = |editor: &Editor, id: Id| {
                    let mut at = id;
                    while let Some(earlier) = editor.earlier.get(&at) {
                        at = *earlier;
                        if at == of {
                            return true;
                        }
                    }
                    false
                };
                match exactly.is_empty() {
                    true => self.within(*point, &mut |editor, id| later(editor, id), *change)?,
                    false => exactly,
                }
            }
            Edit::Read(Where::Literal(point, value), change) => {
                let is = |editor: &Editor, id: Id| editor.ir.nodes[id].op == Op::Literal(*value);
                self.within(*point, &mut |editor, id| is(editor, id), *change)?
            }
        };
        for (root, _) in &all {
            if let Root::Value(id) = root {
                self.exempt
                    .extend((before..self.ir.nodes.len()).map(|new| (new, *id)));
            }
        }
        match all.is_empty() {
            true => Err(format!("it is not read there: {:?}", mutation.edit)),
            false => Ok(all),
        }
    }

    /// The places of a signal's logic, with all that `is` meant changed.
    fn within(
        &mut self,
        point: Point,
        is: &mut dyn FnMut(&Editor, Id) -> bool,
        change: Change,
    ) -> Result<Vec<(Root, Id)>, String> {
        let roots = match point {
            Point::Output(port) => vec![Root::Output(port)],
            Point::Node(id) => {
                let id = self.stands[id];
                match self.ir.nodes[id].op {
                    Op::Wire => vec![Root::Driver(id)],
                    Op::Register(_) => vec![Root::Next(id), Root::Enable(id)],
                    Op::Read(..) => vec![Root::Address(id)],
                    _ => vec![Root::Value(id)],
                }
            }
        };
        for deep in [false, true] {
            let mut found = vec![];
            for &root in &roots {
                let Ok(id) = self.get(root) else {
                    continue; // a register without an enable
                };
                let gap = self.gap(root);
                let mut copier = Copier {
                    is: &mut *is,
                    change,
                    deep,
                    known: HashMap::new(),
                };
                let new = match root {
                    // A signal is not read where it is computed.
                    Root::Value(id) => copier.operands(self, id, gap)?,
                    _ => copier.copy(self, id, gap)?,
                };
                if new != id {
                    found.push((root, new));
                }
            }
            if !found.is_empty() {
                return Ok(found);
            }
        }
        Ok(vec![])
    }

    /// A copy of a node in which the last operand of a path is changed.
    fn along(&mut self, id: Id, path: &[usize], change: Change, gap: Gap) -> Result<Id, String> {
        let Some((&first, rest)) = path.split_first() else {
            return self.instead(id, change, gap);
        };
        let node = self.ir.nodes[id].clone();
        let operands = node.op.operands();
        let old = operands.get(first).ok_or("there is no such operand")?;
        let new = self.along(*old, rest, change, gap)?;
        let mut number = 0;
        let op = node.op.map(&mut |operand| {
            number += 1;
            if number - 1 == first { new } else { operand }
        });
        Ok(self.push(gap, op, node.width))
    }

    /// What is read instead of a node.
    fn instead(&mut self, id: Id, change: Change, gap: Gap) -> Result<Id, String> {
        let Node { op, width, .. } = self.ir.nodes[id].clone();
        Ok(match change {
            Change::Value(value) if width < 128 && value >> width != 0 => {
                return Err(format!("{value} does not fit {width} bits"));
            }
            Change::Value(value) => self.literal(value, width),
            Change::Inverted => self.not(gap, id),
            Change::Signal(other) => {
                let other = self.stands[other];
                let bits = self.ir.nodes[other].width;
                if bits != width {
                    return Err(format!("{bits} bits cannot be read for {width}"));
                }
                let late = (self.available[other], !FIRST) > (gap.0, gap.1 || other == id);
                if late { self.wire(gap, other) } else { other }
            }
            Change::Late => {
                let register = Register {
                    next: Some(id),
                    delay: true,
                    ..Register::default()
                };
                let late = self.push(gap, Op::Register(register), width);
                self.ir.drivers.insert(late, id);
                late
            }
            Change::Early => *(self.earlier.get(&id)).ok_or("what is read there is no delay")?,
            Change::Operator => {
                let op = match op {
                    Op::Not(a) => return Ok(a),
                    Op::Any(a) => Op::All(a),
                    Op::All(a) => Op::Any(a),
                    Op::Parity(a) => Op::All(a),
                    Op::Binary(op, a, b) => {
                        let other = match op {
                            Binary::And | Binary::Xor => Binary::Or,
                            Binary::Or => Binary::And,
                            Binary::Add => Binary::Sub,
                            Binary::Sub | Binary::Mul => Binary::Add,
                            Binary::Equal => Binary::NotEqual,
                            Binary::NotEqual => Binary::Equal,
                            Binary::Less => Binary::LessEqual,
                            Binary::LessEqual => Binary::Less,
                            Binary::ShiftLeft => Binary::ShiftRight,
                            Binary::ShiftRight => Binary::ShiftLeft,
                        };
                        let wide = op == Binary::Mul;
                        let [a, b] = [a, b].map(|id| match wide {
                            true => self.extended(id, width, gap),
                            false => id,
                        });
                        Op::Binary(other, a, b)
                    }
                    _ => return Err("there is no operator".into()),
                };
                self.push(gap, op, width)
            }
            Change::Shorter | Change::Lower => match op {
                Op::Slice(of, low) if change == Change::Shorter && width > 1 => {
                    let slice = self.push(gap, Op::Slice(of, low), width - 1);
                    self.extended(slice, width, gap)
                }
                Op::Slice(of, low) if low > 0 => self.push(gap, Op::Slice(of, low - 1), width),
                _ => return Err("there is no slice that could be shorter or lower".into()),
            },
        })
    }

    /// Zeros in front.
    fn extended(&mut self, id: Id, width: u32, gap: Gap) -> Id {
        let missing = width - self.ir.nodes[id].width;
        if missing == 0 {
            return id;
        }
        let zeros = self.literal(0, missing);
        self.push(gap, Op::Concat(vec![zeros, id]), width)
    }

    /// The netlist with the new nodes where they belong, numbered in the order of items.
    fn finish(mut self) -> Netlist {
        let redirected = std::mem::take(&mut self.redirected);
        let to = |reader: Option<Id>, id: Id| match redirected.get(&id) {
            Some(new) if !reader.is_some_and(|r| self.exempt.contains(&(r, id))) => *new,
            _ => id,
        };
        let old = std::mem::take(&mut self.ir.items);
        let end = old.len();
        let mut items = vec![];
        let mut drives = vec![];
        for (place, item) in old.into_iter().map(Some).chain([None]).enumerate() {
            for first in [FIRST, !FIRST] {
                for item in self.new.remove(&(place, first)).into_iter().flatten() {
                    if let Item::Node(id) = item
                        && matches!(self.ir.nodes[id].op, Op::Wire | Op::Register(_))
                    {
                        drives.push(Item::Drive(id));
                    }
                    items.push(item);
                }
            }
            items.extend(item);
        }
        debug_assert!(self.new.is_empty(), "items end at {end}");
        items.extend(drives);
        let mut numbers = vec![0; self.ir.nodes.len()];
        let mut order = vec![];
        for item in &items {
            if let Item::Node(id) = item {
                numbers[*id] = order.len();
                order.push(*id);
            }
        }
        let of = |reader, id| numbers[to(reader, id)];
        let ir = self.ir;
        let nodes = order.iter().map(|&id| Node {
            op: ir.nodes[id].op.map(&mut |operand| of(Some(id), operand)),
            ..ir.nodes[id].clone()
        });
        let nodes = nodes.collect();
        let renumbered = |item| match item {
            Item::Node(id) => Item::Node(numbers[id]),
            Item::Drive(id) => Item::Drive(numbers[id]),
            other => other,
        };
        let drivers = ir.drivers.iter();
        let mut instances = ir.instances.clone();
        for instance in &mut instances {
            for (_, id) in &mut instance.inputs {
                *id = of(None, *id);
            }
            for (_, id) in &mut instance.outputs {
                *id = numbers[*id];
            }
        }
        let mut memories = ir.memories.clone();
        for memory in &mut memories {
            let write = memory.write;
            memory.write = write.map(|(e, a, d)| (of(None, e), of(None, a), of(None, d)));
        }
        let mut proofs = ir.proofs.clone();
        for proof in &mut proofs {
            proof.nodes().for_each(|id| *id = of(None, *id));
            // They are of the nodes as they were.
            proof.faults.clear();
        }
        let ports = ir.ports.iter().map(|(port, id)| {
            let id = match port.direction {
                Direction::Input => numbers[*id],
                Direction::Output => of(None, *id),
            };
            (port.clone(), id)
        });
        Netlist {
            nodes,
            items: items.into_iter().map(renumbered).collect(),
            drivers: drivers
                .map(|(id, driver)| (numbers[*id], of(Some(*id), *driver)))
                .collect(),
            driven_at: (ir.driven_at.iter())
                .map(|(id, place)| (numbers[*id], *place))
                .collect(),
            ports: ports.collect(),
            proofs,
            instances,
            memories,
            ..ir
        }
    }
}

/// Copies of logic in which something is read otherwise.
struct Copier<'a> {
    is: &'a mut dyn FnMut(&Editor, Id) -> bool,
    change: Change,
    /// Whether it goes on behind named signals.
    deep: bool,
    known: HashMap<(Id, Gap), Id>,
}

impl Copier<'_> {
    fn copy(&mut self, editor: &mut Editor, id: Id, gap: Gap) -> Result<Id, String> {
        if (self.is)(editor, id) {
            return editor.instead(id, self.change, gap);
        }
        let named = editor.ir.nodes[id].name.is_some() && !self.deep;
        match editor.ir.nodes[id].op {
            Op::Register(_) | Op::Read(..) => Ok(id),
            _ if named => Ok(id),
            Op::Wire => {
                // Its driver is made later.
                let (driver, end) = (editor.ir.drivers[&id], editor.end());
                let new = self.copy(editor, driver, end)?;
                Ok(if new == driver {
                    id
                } else {
                    editor.wire(gap, new)
                })
            }
            _ => self.operands(editor, id, gap),
        }
    }

    /// The node, or a copy that reads something otherwise.
    fn operands(&mut self, editor: &mut Editor, id: Id, gap: Gap) -> Result<Id, String> {
        if let Some(known) = self.known.get(&(id, gap)) {
            return Ok(*known);
        }
        let Node { op, width, .. } = editor.ir.nodes[id].clone();
        let mut wrong = None;
        let new = op.map(&mut |operand| {
            let copied = self.copy(editor, operand, gap);
            copied.unwrap_or_else(|why| {
                wrong = Some(why);
                operand
            })
        });
        if let Some(why) = wrong {
            return Err(why);
        }
        let copy = if new == op {
            id
        } else {
            editor.push(gap, new, width)
        };
        self.known.insert((id, gap), copy);
        Ok(copy)
    }
}

/// How a change of [`Design::selectable`] is selected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Select<'a> {
    /// By an input of this name, which every module has. Registers that reset sets begin as the complement of what it gives them:
    /// simulation begins with zeros, which most resets give too, and a reset left out would change nothing.
    Port(&'a str),
    /// By a constant: what differs between two of them is the constant alone.
    Constant(u32),
}

/// Bits of a change's number.
const SELECT_BITS: u32 = 32;

impl Netlist {
    /// Puts other modules of the same names below, with an input more where `select` says which.
    fn place(&mut self, children: &HashMap<&str, Arc<Module>>, select: Option<(&str, Id)>) -> bool {
        let mut placed = false;
        for (number, instance) in self.instances.iter_mut().enumerate() {
            let Some(child) = children.get(instance.module.name()) else {
                continue;
            };
            placed = true;
            for node in &mut self.nodes {
                if let Op::Inside(within, id) = &mut node.op
                    && *within == number
                {
                    let name = instance.module.name_of(*id);
                    let id_now = child.node_of(name);
                    *id = id_now.expect("a changed module has the registers that it had");
                }
            }
            instance.module = child.clone();
            let select = select.map(|(name, id)| (name.to_string(), id));
            instance.inputs.extend(select);
            for (name, id) in &instance.outputs {
                let port = child.ports.iter().position(|port| port.name == *name);
                let port = port.expect("a changed module has the outputs that it had");
                self.nodes[*id].op = Op::Instance(number, port);
            }
        }
        placed
    }
}

impl Design {
    /// The design with a change in one of its modules.
    ///
    /// # Errors
    /// It has no such module; see [`Module::with`].
    #[track_caller]
    pub fn with(&self, mutation: &Mutation) -> Result<Design, HdlError> {
        let place = Location::caller();
        self.module(&mutation.module)?;
        self.rebuilt(&|module, children| {
            if module.name() == mutation.module {
                return module.changed(mutation, place).map(Some);
            }
            let mut ir = module.ir.clone();
            let placed = ir.place(children, None);
            placed.then(|| Module::of(ir).map(Arc::new)).transpose()
        })
    }

    /// A module by its name.
    ///
    /// # Errors
    /// There is none.
    #[track_caller]
    pub fn module(&self, name: &str) -> Result<&Arc<Module>, HdlError> {
        let place = Location::caller();
        let found = self.modules.iter().find(|module| module.name() == name);
        found.ok_or_else(|| {
            let names: Vec<_> = self.modules.iter().map(|module| module.name()).collect();
            let top = self.top();
            top.missing("below it is no module", name, &names, place)
        })
    }

    /// The design with many changes, of which the one that is selected by its number holds; with 0, or another number, none does.
    ///
    /// # Errors
    /// A change is of no module; as [`Module::with`].
    #[track_caller]
    pub fn selectable(
        &self,
        changes: &[(u32, &Mutation)],
        select: Select<'_>,
    ) -> Result<Design, HdlError> {
        let place = Location::caller();
        for (_, change) in changes {
            self.module(&change.module)?;
        }
        self.rebuilt(&|module, children| {
            let of_module = changes.iter().filter(|(_, m)| m.module == module.name());
            let of_module: Vec<_> = of_module.copied().collect();
            let selected = module.selecting(&of_module, select, children);
            selected
                .map_err(|why| module.error(why, place))
                .and_then(Module::of)
                .map(|module| Some(Arc::new(module)))
        })
    }

    fn rebuilt(&self, change: &Rebuild<'_>) -> Result<Design, HdlError> {
        let mut changed: HashMap<&str, Arc<Module>> = HashMap::new();
        let mut modules = vec![];
        for module in &self.modules {
            let new = change(module, &changed)?;
            if let Some(new) = &new {
                changed.insert(module.name(), new.clone());
            }
            modules.push(new.unwrap_or_else(|| module.clone()));
        }
        Ok(Design {
            modules,
            prefix: self.prefix.clone(),
        })
    }
}

/// Makes a module anew, if it must be, with those below it that were.
type Rebuild<'a> =
    dyn Fn(&Module, &HashMap<&str, Arc<Module>>) -> Result<Option<Arc<Module>>, HdlError> + 'a;

impl Module {
    fn selecting(
        &self,
        changes: &[(u32, &Mutation)],
        select: Select<'_>,
        children: &HashMap<&str, Arc<Module>>,
    ) -> Result<Netlist, String> {
        let printer = Printer::new(&self.ir);
        let mut editor = Editor::new(&printer);
        let selected = match select {
            Select::Constant(number) => editor.literal(number.into(), SELECT_BITS),
            Select::Port(_) => editor.push((0, FIRST), Op::Input, SELECT_BITS),
        };
        let mut input = None;
        if let Select::Port(name) = select {
            input = Some((name, selected));
            let taken = editor.ir.names.insert(name.to_string(), self.ir.place);
            if taken.is_some() {
                return Err(format!("name clash: a signal is called {name}"));
            }
            editor.ir.nodes[selected].name = Some(name.to_string());
            let port = Port {
                name: name.to_string(),
                width: SELECT_BITS,
                direction: Direction::Input,
                group: String::new(),
                stage: None,
            };
            editor.ir.ports.insert(0, (port, selected));
        }
        let mut choices: BTreeMap<Root, Vec<(Id, Id)>> = BTreeMap::new();
        let mut resets: BTreeMap<Id, Vec<(Id, Option<u128>)>> = BTreeMap::new();
        for (number, mutation) in changes {
            let number = editor.literal((*number).into(), SELECT_BITS);
            let holds = Op::Binary(Binary::Equal, selected, number);
            let holds = editor.push((0, FIRST), holds, 1);
            for (root, new) in editor.resolve(mutation)? {
                choices.entry(root).or_default().push((holds, new));
            }
            if let Edit::Reset(register, value) = mutation.edit {
                let register = editor.stands[register];
                resets.entry(register).or_default().push((holds, value));
            }
        }
        for (root, choices) in choices {
            // Ports were counted without the one that selects.
            let root = match root {
                Root::Output(port) => Root::Output(port + usize::from(input.is_some())),
                root => root,
            };
            let gap = editor.gap(root);
            let mut chosen = match editor.get(root) {
                Err(_) if matches!(root, Root::Enable(_)) => editor.literal(1, 1),
                id => id?,
            };
            for (holds, new) in choices {
                let width = editor.ir.nodes[chosen].width;
                chosen = editor.push(gap, Op::Mux(holds, new, chosen), width);
                if let Root::Value(id) = root {
                    editor.exempt.insert((chosen, id));
                }
            }
            editor.set(root, chosen);
        }
        if let Select::Port(_) = select {
            for node in &mut editor.ir.nodes {
                let width = node.width;
                if let Op::Register(register) = &mut node.op {
                    register.initial = register.reset.map(|value| !value & ones(width));
                }
            }
        }
        for (register, choices) in resets {
            editor.choose_reset(register, &choices);
        }
        editor.ir.place(children, input);
        Ok(editor.finish())
    }

    /// Every single change of each kind that the module's Verilog shows, in its order.
    pub fn mutations(&self) -> Vec<Site> {
        let mut printer = Printer::new(&self.ir);
        let mut editor = Editor::new(&printer);
        let mut walk = Walk {
            printer: &printer,
            editor: &editor,
            line: 0,
            found: vec![],
        };
        let mut seen = HashSet::new();
        for (root, line) in &self.printed.statements {
            if seen.insert(*root) {
                walk.line = *line;
                walk.statement(*root);
            }
        }
        let found: Vec<_> = (walk.found.into_iter())
            .map(|(kind, edit, line)| {
                let module = self.name().to_string();
                let mutation = Mutation { module, edit };
                let instead = editor.resolve(&mutation);
                let instead = instead.expect("what a statement shows can be changed");
                (kind, mutation, line, instead.first().copied())
            })
            .collect();
        printer.extend(&editor.ir);
        let site = |(kind, mutation, line, instead): (_, Mutation, _, Option<(Root, Id)>)| {
            let (before, after) = match (instead, &mutation.edit) {
                (Some((root, new)), _) => {
                    let before = match root {
                        Root::Value(id) => printer.expression(id),
                        root => {
                            let id = editor.get(root);
                            printer.part(id.expect("a statement reads something"))
                        }
                    };
                    (before, printer.part(new))
                }
                (None, Edit::Reset(id, Some(value))) => {
                    let width = self.ir.nodes[*id].width;
                    (literal(value ^ 1, width), literal(*value, width))
                }
                (None, _) => ("rst".into(), "1'b0".into()),
            };
            Site {
                kind,
                mutation,
                line,
                before,
                after,
            }
        };
        found.into_iter().map(site).collect()
    }
}

fn ones(width: u32) -> u128 {
    if width >= 128 {
        u128::MAX
    } else {
        (1 << width) - 1
    }
}

impl Editor {
    /// Lets logic do what a register's reset does, so that what it gives can be chosen.
    fn choose_reset(&mut self, id: Id, choices: &[(Id, Option<u128>)]) {
        let Node { op, width, .. } = self.ir.nodes[id].clone();
        let Op::Register(register) = op else {
            return; // resolved: it is one that reset sets
        };
        let (Some(reset), Some(mut next)) = (register.reset, register.next) else {
            return;
        };
        let gap = self.gap(Root::Next(id));
        if let Some(enable) = register.enable {
            next = self.push(gap, Op::Mux(enable, next, id), width);
        }
        let mut resets = self.push((0, FIRST), Op::Reset, 1);
        let mut value = self.literal(reset, width);
        for (holds, choice) in choices {
            match choice {
                Some(other) => {
                    let other = self.literal(*other, width);
                    value = self.push(gap, Op::Mux(*holds, other, value), width);
                }
                None => {
                    let not = self.not(gap, *holds);
                    resets = self.push(gap, Op::Binary(Binary::And, resets, not), 1);
                }
            }
        }
        let next = self.push(gap, Op::Mux(resets, value, next), width);
        self.set(Root::Next(id), next);
        if let Op::Register(register) = &mut self.ir.nodes[id].op {
            (register.enable, register.reset) = (None, None);
        }
    }
}

/// Finds the changes that statements admit.
struct Walk<'a> {
    printer: &'a Printer<'a>,
    editor: &'a Editor,
    line: usize,
    found: Vec<(Kind, Edit, usize)>,
}

impl Walk<'_> {
    fn add(&mut self, kind: Kind, root: Root, path: &[usize], change: Change) {
        let at = Where::At(Slot(root), path.to_vec());
        self.found.push((kind, Edit::Read(at, change), self.line));
    }

    fn op(&self, id: Id) -> &Op {
        &self.printer.plan.ops[id]
    }

    fn statement(&mut self, root: Root) {
        match root {
            Root::Value(id) => self.node(root, &mut vec![], id),
            Root::Next(id) => {
                let registers = match self.printer.plan.in_line[id] {
                    Some((line, _)) => self.printer.plan.lines[line].registers.clone(),
                    None => vec![id],
                };
                for id in registers {
                    if let Op::Register(Register {
                        reset: Some(value), ..
                    }) = self.op(id)
                    {
                        let other = Edit::Reset(id, Some(value ^ 1));
                        for edit in [Edit::Reset(id, None), other] {
                            self.found.push((Kind::Reset, edit, self.line));
                        }
                    }
                }
                self.condition(Root::Enable(id));
                self.read(root);
            }
            Root::Write(memory, _) => {
                self.condition(Root::Write(memory, 0));
                self.read(Root::Write(memory, 1));
                self.read(Root::Write(memory, 2));
            }
            root => self.read(root),
        }
    }

    /// A condition, which may be held.
    fn condition(&mut self, root: Root) {
        let Ok(id) = self.editor.get(root) else {
            return;
        };
        for held in [0, 1] {
            if *self.op(id) != Op::Literal(held) {
                self.add(Kind::Condition, root, &[], Change::Value(held));
            }
        }
        self.read(root);
    }

    fn read(&mut self, root: Root) {
        if let Ok(id) = self.editor.get(root) {
            self.operand(root, &mut vec![], id);
        }
    }

    fn operand(&mut self, root: Root, path: &mut Vec<usize>, id: Id) {
        if let Op::Register(_) = self.op(id)
            && self.editor.earlier.contains_key(&id)
        {
            self.add(Kind::Register, root, path, Change::Early);
        }
        if !self.printer.plan.declared[id] {
            self.node(root, path, id);
        }
    }

    /// A node that is written out.
    fn node(&mut self, root: Root, path: &mut Vec<usize>, id: Id) {
        let op = self.op(id).clone();
        match &op {
            Op::Register(_) => return,
            Op::Literal(value) => {
                self.add(Kind::Constant, root, path, Change::Value(value ^ 1));
            }
            Op::Not(_) | Op::Binary(..) | Op::Any(_) | Op::All(_) | Op::Parity(_) => {
                self.add(Kind::Operator, root, path, Change::Operator);
            }
            Op::Mux(..) => {
                path.push(0);
                self.add(Kind::Condition, root, path, Change::Inverted);
                path.pop();
            }
            Op::Slice(of, low) => {
                let width = self.printer.plan.width(id);
                if width > 1 && width < self.printer.plan.width(*of) {
                    self.add(Kind::Width, root, path, Change::Shorter);
                    if *low > 0 {
                        self.add(Kind::Width, root, path, Change::Lower);
                    }
                }
            }
            _ => {}
        }
        for (number, operand) in op.operands().into_iter().enumerate() {
            path.push(number);
            self.operand(root, path, operand);
            path.pop();
        }
    }
}
