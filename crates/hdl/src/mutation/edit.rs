//! Applies changes to a netlist.

use super::select::ones;
use super::{Change, Edit, Mutation, Point, Slot, Where};
use crate::design::{Direction, Module};
use crate::error::HdlError;
use crate::ir::{Binary, Hint, Id, Item, Netlist, Node, Op, Place, Register, Root};
use crate::verilog::Printer;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::panic::Location;
use std::sync::Arc;

impl Module {
    pub(super) fn error(&self, message: String, place: Place) -> HdlError {
        HdlError {
            module: self.name().to_string(),
            message,
            place,
        }
    }

    /// Checks that each mutation is possible.
    pub(crate) fn admits(&self, mutations: &[(Mutation, Place)]) -> Result<(), HdlError> {
        if mutations.is_empty() {
            return Ok(());
        }
        let printer = Printer::new(&self.ir);
        let mut editor = Editor::new(&printer);
        mutations.iter().try_for_each(|(mutation, place)| {
            let found = editor.resolve(mutation);
            found.map(drop).map_err(|why| self.error(why, place))
        })
    }

    /// Returns the module with a change.
    ///
    /// # Errors
    /// The change belongs to another module, is not possible, has no effect on the Verilog, or makes the
    /// module invalid, for example by a combinational loop.
    #[track_caller]
    pub fn with(&self, mutation: &Mutation) -> Result<Arc<Module>, HdlError> {
        self.changed(mutation, Location::caller())
    }

    pub(super) fn changed(
        &self,
        mutation: &Mutation,
        place: Place,
    ) -> Result<Arc<Module>, HdlError> {
        let error = |why| self.error(why, place);
        if mutation.module != self.name() {
            return Err(error(format!(
                "the change is for module {}",
                mutation.module
            )));
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
        if module.printed.text == self.printed.text {
            return Err(error("the change leaves the Verilog as it is".to_string()));
        }
        Ok(Arc::new(module))
    }
}

/// The position of a new item: before the item with this number. First come items that are changed where they are made.
pub(super) type Gap = (usize, bool);

/// A netlist during a change: equal nodes are merged, and new nodes are added.
pub(super) struct Editor {
    pub ir: Netlist,
    /// For each node of the original module, the node that is printed for it.
    pub stands: Vec<Id>,
    /// The value of a pipeline register, or of a slice of one, in the next cycle.
    pub earlier: HashMap<Id, Id>,
    /// For each node, the first position at which it can be read.
    pub available: Vec<usize>,
    /// The items that drive wires and registers, and the item of each instance.
    pub drives: HashMap<Id, usize>,
    pub instances: Vec<usize>,
    pub new: BTreeMap<(usize, bool), Vec<Item>>,
    /// The replacement of a node for all readers.
    pub redirected: HashMap<Id, Id>,
    /// Pairs of a new node and a node that it reads without the replacement.
    pub exempt: HashSet<(Id, Id)>,
}

/// Sorts before items that are not first.
pub(super) const FIRST: bool = false;

impl Editor {
    pub fn new(printer: &Printer<'_>) -> Editor {
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
                Item::Comment(_) | Item::Memory(_) | Item::Part(_) => {}
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

    /// The position for new nodes that a place reads.
    pub fn gap(&self, root: Root) -> Gap {
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

    pub fn push(&mut self, gap: Gap, op: Op, width: u32) -> Id {
        let id = self.ir.nodes.len();
        let place = self.ir.place;
        self.ir.nodes.push(Node {
            op,
            width,
            name: None,
            hint: None,
            place,
            stage: None,
            cleared: false,
            formal: false,
        });
        self.available.push(gap.0);
        self.new.entry(gap).or_default().push(Item::Node(id));
        id
    }

    /// Adds a node that replaces another one and is named after it.
    fn copy(&mut self, gap: Gap, op: Op, id: Id) -> Id {
        let node = &self.ir.nodes[id];
        let (width, hint) = (node.width, node.hint.clone());
        let own = node.name.clone().map(|name| Hint {
            name,
            after: None,
            field: false,
        });
        let copy = self.push(gap, op, width);
        self.ir.nodes[copy].hint = own.or(hint);
        copy
    }

    pub fn literal(&mut self, value: u128, width: u32) -> Id {
        self.push((0, FIRST), Op::Literal(value), width)
    }

    pub fn not(&mut self, gap: Gap, id: Id) -> Id {
        self.push(gap, Op::Not(id), self.ir.nodes[id].width)
    }

    /// A wire for a node that is made later, or is read before its name is declared.
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

    /// The node that a place reads, if it can be replaced.
    pub fn get(&self, root: Root) -> Result<Id, String> {
        let computed = |id: Id| {
            let name = &self.ir.nodes[id].name;
            format!(
                "{} reads nothing there",
                name.as_deref().unwrap_or("the signal")
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

    pub fn set(&mut self, root: Root, new: Id) {
        match root {
            Root::Value(id) => {
                // The replacement takes over the name.
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

    /// The replacements for the places of a mutation.
    pub fn resolve(&mut self, mutation: &Mutation) -> Result<Vec<(Root, Id)>, String> {
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
                    true => Err("the register has no reset, or that reset value already".into()),
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
                    // A register without an enable loads in every cycle.
                    (Root::Enable(id), Err(_)) if self.drives.contains_key(&id) => {
                        self.literal(1, 1)
                    }
                    (_, id) => id?,
                };
                vec![(root, self.along(id, path, *change, gap)?)]
            }
            Edit::Read(Where::Everywhere(point), change) => {
                let root = match (*point, self.roots(*point)[0]) {
                    (Point::Output(_), root) | (_, root @ Root::Driver(_)) => root,
                    (Point::Node(id), _) => Root::Value(self.stands[id]),
                };
                let (gap, id) = (self.gap(root), self.get(root)?);
                vec![(root, self.instead(id, *change, gap)?)]
            }
            Edit::Read(Where::Operand(point, path), change) => {
                let root = self.roots(*point)[0];
                let (gap, id) = (self.gap(root), self.get(root)?);
                vec![(root, self.along(id, path, *change, gap)?)]
            }
            Edit::Read(Where::Of(point, of), change) => {
                let of = self.stands[*of];
                let later = move |editor: &Editor, id: Id| {
                    let mut at = editor.earlier.get(&id);
                    while let Some(id) = at
                        && *id != of
                    {
                        at = editor.earlier.get(id);
                    }
                    at.is_some()
                };
                self.within(*point, &[&move |_, id| id == of, &later], *change)?
            }
            Edit::Read(Where::Literal(point, value), change) => {
                let value = Op::Literal(*value);
                let is = |editor: &Editor, id: Id| editor.ir.nodes[id].op == value;
                self.within(*point, &[&is], *change)?
            }
        };
        for (root, _) in &all {
            if let Root::Value(id) = root {
                self.exempt
                    .extend((before..self.ir.nodes.len()).map(|new| (new, *id)));
            }
        }
        match all.is_empty() {
            true => Err("the signal is not read there".to_string()),
            false => Ok(all),
        }
    }

    /// The places in which a signal is computed.
    fn roots(&self, point: Point) -> Vec<Root> {
        match point {
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
        }
    }

    /// The places of a signal's logic, with all nodes replaced that match the first of `meant` that has a match.
    fn within(
        &mut self,
        point: Point,
        meant: &[&Meant<'_>],
        change: Change,
    ) -> Result<Vec<(Root, Id)>, String> {
        let roots = self.roots(point);
        for deep in [false, true] {
            for &meant in meant {
                let mut found = vec![];
                for &root in &roots {
                    let Ok(id) = self.get(root) else {
                        continue; // a register without an enable
                    };
                    let gap = self.gap(root);
                    let mut copier = Copier {
                        meant,
                        change,
                        deep,
                        known: HashMap::new(),
                    };
                    let new = match root {
                        // The place where a signal is computed does not read it.
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
        Ok(self.copy(gap, op, id))
    }

    /// The replacement of a node.
    fn instead(&mut self, id: Id, change: Change, gap: Gap) -> Result<Id, String> {
        let Node { op, width, .. } = self.ir.nodes[id].clone();
        Ok(match change {
            Change::Value(value) | Change::Flipped(value) if width < 128 && value >> width != 0 => {
                return Err(format!("{value} does not fit in {width} bits"));
            }
            Change::Value(value) => self.literal(value, width),
            Change::Inverted => self.not(gap, id),
            Change::Flipped(mask) => {
                let mask = self.literal(mask, width);
                self.push(gap, Op::Binary(Binary::Xor, id, mask), width)
            }
            Change::Signal(other) => {
                let other = self.stands[other];
                let bits = self.ir.nodes[other].width;
                if bits != width {
                    return Err(format!(
                        "width mismatch: {width} bits are read, the other signal has {bits}"
                    ));
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
            Change::Early => *(self.earlier.get(&id))
                .ok_or("the signal read there is not a pipeline register")?,
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
                    _ => return Err("there is no operator to replace".into()),
                };
                self.push(gap, op, width)
            }
            Change::Shorter | Change::Lower => match op {
                Op::Slice(of, low) if change == Change::Shorter && width > 1 => {
                    let slice = self.push(gap, Op::Slice(of, low), width - 1);
                    self.extended(slice, width, gap)
                }
                Op::Slice(of, low) if low > 0 => self.push(gap, Op::Slice(of, low - 1), width),
                _ => return Err("there is no slice to shorten or shift".into()),
            },
        })
    }

    /// Zero-extends a node.
    fn extended(&mut self, id: Id, width: u32, gap: Gap) -> Id {
        let missing = width - self.ir.nodes[id].width;
        if missing == 0 {
            return id;
        }
        let zeros = self.literal(0, missing);
        self.push(gap, Op::Concat(vec![zeros, id]), width)
    }

    /// The netlist with the new nodes at their positions, renumbered in the order of items.
    pub fn finish(mut self) -> Netlist {
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
        let read = |reader: Id| {
            let node = &ir.nodes[reader];
            match &node.op {
                // Verilog cannot take a part-select of a constant.
                Op::Slice(whole, low) => match ir.nodes[to(Some(reader), *whole)].op {
                    Op::Literal(value) => {
                        Op::Literal(value.checked_shr(*low).unwrap_or(0) & ones(node.width))
                    }
                    _ => node.op.map(&mut |id| of(Some(reader), id)),
                },
                op => op.map(&mut |id| of(Some(reader), id)),
            }
        };
        let nodes = order.iter().map(|&id| Node {
            op: read(id),
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
            // Proofs refer to the original nodes.
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
            // A changed module no longer belongs to the library.
            placed: None,
            ..ir
        }
    }
}

/// Whether a node is to be replaced.
type Meant<'a> = dyn Fn(&Editor, Id) -> bool + 'a;

/// Copies logic and replaces some of the nodes that it reads.
struct Copier<'a> {
    meant: &'a Meant<'a>,
    change: Change,
    /// Whether it continues beyond named signals.
    deep: bool,
    known: HashMap<(Id, Gap), Id>,
}

impl Copier<'_> {
    fn copy(&mut self, editor: &mut Editor, id: Id, gap: Gap) -> Result<Id, String> {
        if (self.meant)(editor, id) {
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

    /// The node, or a copy of it that reads a replacement.
    fn operands(&mut self, editor: &mut Editor, id: Id, gap: Gap) -> Result<Id, String> {
        if let Some(known) = self.known.get(&(id, gap)) {
            return Ok(*known);
        }
        let op = editor.ir.nodes[id].op.clone();
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
            editor.copy(gap, new, id)
        };
        self.known.insert((id, gap), copy);
        Ok(copy)
    }
}
