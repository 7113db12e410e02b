//! The part of a module to which a node belongs, and the nodes that cross the boundaries of parts.

use super::super::ir::{Id, Item, Netlist, Op};
use super::plan::Plan;
use std::collections::{BTreeMap, BTreeSet};

/// Parts by their numbers; 0 is the module itself.
pub(in super::super) struct Owners {
    pub nodes: Vec<usize>,
    pub memories: Vec<usize>,
    pub instances: Vec<usize>,
}

impl Owners {
    pub fn of(ir: &Netlist) -> Owners {
        let mut owners = Owners {
            nodes: vec![0; ir.nodes.len()],
            memories: vec![0; ir.memories.len()],
            instances: vec![0; ir.instances.len()],
        };
        let mut part = 0;
        for item in &ir.items {
            match item {
                Item::Part(begun) => part = *begun,
                // A wire belongs to the part that drives it, which is known later.
                Item::Node(id) => owners.nodes[*id] = part,
                Item::Drive(id) if ir.nodes[*id].op == Op::Wire => owners.nodes[*id] = part,
                Item::Memory(index) => owners.memories[*index] = part,
                Item::Instance(index) => owners.instances[*index] = part,
                Item::Drive(_) | Item::Comment(_) => {}
            }
        }
        for (id, node) in ir.nodes.iter().enumerate() {
            match node.op {
                Op::Input => owners.nodes[id] = 0,
                Op::Read(memory, ..) => owners.nodes[id] = owners.memories[memory],
                Op::Instance(instance, _) => owners.nodes[id] = owners.instances[instance],
                _ => {}
            }
        }
        owners
    }
}

/// The nodes of each part.
pub(in super::super) struct Borders {
    pub owners: Owners,
    /// For each part, its own nodes, and copies of nodes that need no logic.
    pub has: Vec<BTreeSet<Id>>,
    /// For each part, the nodes of other parts that it reads.
    pub enters: Vec<BTreeSet<Id>>,
}

/// The way in which a part reads a node of another one.
#[derive(Default)]
struct Use {
    whole: bool,
    slices: BTreeSet<Id>,
}

impl Borders {
    pub fn of(plan: &Plan, owners: Owners) -> Borders {
        let parts = plan.ir.parts.len() + 1;
        let mut owners = owners;
        for id in 0..plan.ops.len() {
            // A wire that only renames a signal belongs to the part of the signal.
            owners.nodes[id] = owners.nodes[plan.signal(id)];
        }
        let mut borders = Borders {
            owners,
            has: vec![BTreeSet::new(); parts],
            enters: vec![BTreeSet::new(); parts],
        };
        let mut uses: BTreeMap<(usize, Id), Use> = BTreeMap::new();
        for (part, id) in borders.reads(plan) {
            borders.read(plan, part, id, &mut uses);
        }
        for ((part, id), of) in uses {
            let mut covered = vec![false; plan.width(id) as usize];
            for slice in &of.slices {
                let low = slice_of(plan, *slice).1 as usize;
                covered[low..low + plan.width(*slice) as usize].fill(true);
            }
            let whole = of.whole || covered.into_iter().all(|bit| bit);
            // If only fields of a word are read, they cross the boundary instead of the word.
            let (entering, sliced_in) = match whole {
                true => (BTreeSet::from([id]), part),
                false => (of.slices.clone(), borders.owners.nodes[id]),
            };
            borders.enters[part].extend(entering);
            for mut slice in of.slices {
                while let Op::Slice(of, _) = plan.ops[slice] {
                    borders.has[sliced_in].insert(slice);
                    slice = of;
                }
            }
        }
        borders
    }

    /// The nodes that each part's own logic reads, in addition to that logic.
    fn reads(&mut self, plan: &Plan) -> Vec<(usize, Id)> {
        let mut reads = vec![];
        let owners = &self.owners;
        for id in 0..plan.ops.len() {
            let placed = matches!(plan.ops[id], Op::Input | Op::Instance(..));
            if plan.signal(id) != id {
                continue;
            }
            if placed || plan.live[id] && plan.stands[id] == id && !plan.is_light(id) {
                let owner = owners.nodes[id];
                self.has[owner].insert(id);
                reads.extend(plan.sources(id).into_iter().map(|source| (owner, source)));
            }
        }
        for (memory, copies) in plan.copies.iter().enumerate() {
            if !copies.is_empty() {
                let written = plan.write_port(memory).into_iter();
                reads.extend(written.map(|id| (owners.memories[memory], id)));
            }
        }
        for (number, instance) in plan.ir.instances.iter().enumerate() {
            let inputs = instance.inputs.iter();
            reads.extend(inputs.map(|(_, id)| (owners.instances[number], plan.stands[*id])));
        }
        reads.extend(plan.outputs().map(|id| (0, id)));
        reads
    }

    fn read(&mut self, plan: &Plan, part: usize, id: Id, uses: &mut BTreeMap<(usize, Id), Use>) {
        if !plan.is_light(id) {
            if self.owners.nodes[id] != part {
                uses.entry((part, plan.signal(id))).or_default().whole = true;
            } else if plan.signal(id) != id {
                self.has[part].insert(id);
            }
            return;
        }
        let (of, _) = slice_of(plan, id);
        if of != id && !plan.is_light(of) && self.owners.nodes[of] != part {
            let of = plan.signal(of);
            uses.entry((part, of)).or_default().slices.insert(id);
        } else if self.has[part].insert(id) {
            for source in plan.sources(id) {
                self.read(plan, part, source, uses);
            }
        }
    }

    /// The parts that read a node of another.
    pub fn readers(&self, id: Id) -> impl Iterator<Item = usize> + '_ {
        let parts = self.enters.iter().enumerate();
        parts
            .filter(move |(_, enters)| enters.contains(&id))
            .map(|(part, _)| part)
    }

    /// The part from which a node comes to those that read it.
    pub fn source(&self, plan: &Plan, id: Id) -> usize {
        self.owners.nodes[slice_of(plan, id).0]
    }

    /// The nodes of a part that other parts read.
    pub fn leaves(&self, plan: &Plan, part: usize) -> BTreeSet<Id> {
        let all = self.enters.iter().flatten().copied();
        all.filter(|id| self.source(plan, *id) == part).collect()
    }
}

/// The signal and the lowest bit of a slice, or of a slice of a slice.
pub(in super::super) fn slice_of(plan: &Plan, mut id: Id) -> (Id, u32) {
    let mut lowest = 0;
    while let Op::Slice(of, low) = plan.ops[id] {
        lowest += low;
        id = of;
    }
    (id, lowest)
}
