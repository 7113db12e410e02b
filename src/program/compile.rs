//! Compiles a tree's topology to its update program.
//!
//! 1. [`walk`] determines the order of the leaves.
//! 2. [`VertexFile`] converts the sequence of leaves to loads and leaf merges.
//! 3. [`NodeQueue`] inserts the nodes between them, so that no merge has to wait for another.

use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};

use anyhow::{Result, ensure};

use super::{Instruction, Loads, Program, UpdateMachine};
use crate::bkd::{Child, Tree, TreeNode};

/// The order of the leaves, and the order of the nodes that needs the fewest box registers.
struct Walk {
    /// Triangles in the order of their leaf merges.
    leaves: Vec<u32>,
    /// Nodes, each with its right sibling if both are inner nodes.
    units: Vec<(u32, Option<u32>)>,
    /// Minimum number of box registers for these sequences.
    box_registers: u32,
}

pub(super) fn compile(
    tree: &Tree,
    triangles: &[[u32; 3]],
    vertices: usize,
    machine: UpdateMachine,
    loads: Loads,
) -> Result<Program> {
    machine.check()?;
    ensure!(
        tree.triangle_count() == triangles.len(),
        "the tree has {} leaves but the mesh {} triangles; build the tree again",
        tree.triangle_count(),
        triangles.len()
    );
    for (number, triangle) in triangles.iter().enumerate() {
        for &vertex in triangle {
            ensure!(
                (vertex as usize) < vertices,
                "triangle {number} names vertex {vertex}, but there are {vertices}; correct the mesh"
            );
        }
    }
    let walk = walk(tree);
    let nodes_walked: usize = (walk.units.iter())
        .map(|(_, second)| 1 + usize::from(second.is_some()))
        .sum();
    ensure!(
        walk.leaves.len() == triangles.len() && nodes_walked == tree.nodes.len(),
        "the tree does not reach each of its {} nodes once; build it again",
        tree.nodes.len()
    );
    ensure!(
        walk.box_registers <= machine.box_registers,
        "the tree's update program needs {} box registers, but the machine has {}; give it more or split the mesh",
        walk.box_registers,
        machine.box_registers
    );

    let mut vertex_file = VertexFile::new(&walk.leaves, triangles, vertices, machine, loads);
    let mut nodes = NodeQueue::new(tree, &walk, machine);
    let mut instructions = Vec::with_capacity(triangles.len() * 11 / 4 + 16);
    let mut leaves_done = 0;
    while nodes.order.len() < tree.nodes.len() || leaves_done < walk.leaves.len() {
        let now = instructions.len();
        let instruction = if let Some(node) = nodes.next(now) {
            node
        } else if let Some(load) = vertex_file.next_load() {
            load
        } else if leaves_done < walk.leaves.len() && nodes.boxes.in_use < machine.box_registers {
            nodes.leaf_merged(walk.leaves[leaves_done], now);
            leaves_done += 1;
            vertex_file.merge_leaf()
        } else {
            nodes.next_early(now).unwrap_or(Instruction::Nop)
        };
        instructions.push(instruction);
    }
    instructions.push(Instruction::End {
        register: nodes.held(tree.root).register,
    });

    let vertices_used = vertex_file.loaded.len() as u32;
    Ok(Program {
        machine,
        loads,
        instructions,
        vertex_order: vertex_file.vertex_order(),
        vertices_used,
        box_registers_used: nodes.boxes.most_in_use,
        node_order: nodes.order,
    })
}

/// Selects the next node: the first one of the walk whose operands are available and old enough.
///
/// Two inner siblings are written next to each other. They form one *unit*, which is ready when all four operands are; any
/// other node is a unit alone.
struct NodeQueue<'a> {
    tree: &'a Tree,
    distance: usize,
    boxes: BoxFile,
    /// Nodes in the order of their writes.
    order: Vec<u32>,
    /// The register of the box of each node and of each leaf, after it is written.
    of_node: Vec<Held>,
    of_leaf: Vec<Held>,
    /// For each node and each leaf, the unit that reads its box, which is that of its parent; [`NEVER`] for the root.
    reader_of_node: Vec<u32>,
    reader_of_leaf: Vec<u32>,
    units: Vec<Unit>,
    /// Units whose operands are all written, with the time of the last write.
    waiting: VecDeque<(usize, u32)>,
    /// Units that can be issued.
    ready: BinaryHeap<Reverse<u32>>,
    /// The second node of a unit whose first node has been issued.
    sibling: Option<u32>,
}

/// One node, or two siblings.
struct Unit {
    first: u32,
    second: Option<u32>,
    /// Number of operands not yet written.
    missing: u8,
}

impl<'a> NodeQueue<'a> {
    fn new(tree: &'a Tree, walk: &Walk, machine: UpdateMachine) -> Self {
        let mut queue = NodeQueue {
            tree,
            distance: machine.merge_distance as usize,
            boxes: BoxFile::default(),
            order: Vec::with_capacity(tree.nodes.len()),
            of_node: vec![Held::default(); tree.nodes.len()],
            of_leaf: vec![Held::default(); tree.triangle_count()],
            reader_of_node: vec![NEVER; tree.nodes.len()],
            reader_of_leaf: vec![NEVER; tree.triangle_count()],
            units: Vec::with_capacity(tree.nodes.len()),
            waiting: VecDeque::new(),
            ready: BinaryHeap::new(),
            sibling: None,
        };
        for &(first, second) in &walk.units {
            let number = queue.units.len() as u32;
            let mut missing = 0;
            for node in [Some(first), second].into_iter().flatten() {
                for child in tree.nodes[node as usize].children {
                    missing += 1;
                    match child {
                        Child::Inner(index) => queue.reader_of_node[index as usize] = number,
                        Child::Leaf(leaf) => queue.reader_of_leaf[leaf as usize] = number,
                    }
                }
            }
            queue.units.push(Unit {
                first,
                second,
                missing,
            });
        }
        queue
    }

    fn held(&self, child: Child) -> Held {
        match child {
            Child::Inner(index) => self.of_node[index as usize],
            Child::Leaf(number) => self.of_leaf[number as usize],
        }
    }

    /// The node to issue as instruction `now`, if there is one.
    fn next(&mut self, now: usize) -> Option<Instruction> {
        while let Some(&(written, unit)) = self.waiting.front()
            && now >= written + self.distance
        {
            self.waiting.pop_front();
            self.ready.push(Reverse(unit));
        }
        if let Some(second) = self.sibling {
            return self.old_enough(second, now).then(|| {
                self.sibling = None;
                self.merge(second, now)
            });
        }
        let Reverse(unit) = self.ready.pop()?;
        Some(self.begin(unit, now))
    }

    /// A node to issue as instruction `now` if there is nothing else: the first of two siblings, the second of
    /// which has to wait.
    fn next_early(&mut self, now: usize) -> Option<Instruction> {
        if self.sibling.is_some() {
            return None;
        }
        let place = (self.waiting.iter())
            .position(|&(_, unit)| self.old_enough(self.units[unit as usize].first, now))?;
        let (_, unit) = self.waiting.remove(place).expect("a place in the queue");
        Some(self.begin(unit, now))
    }

    fn begin(&mut self, unit: u32, now: usize) -> Instruction {
        let Unit { first, second, .. } = self.units[unit as usize];
        self.sibling = second;
        self.merge(first, now)
    }

    fn old_enough(&self, node: u32, now: usize) -> bool {
        let children = self.tree.nodes[node as usize].children;
        (children.into_iter()).all(|child| now >= self.held(child).written + self.distance)
    }

    fn merge(&mut self, node: u32, now: usize) -> Instruction {
        let TreeNode { children, axes } = self.tree.nodes[node as usize];
        let [left, right] = children.map(|child| self.held(child).register);
        self.boxes.release(right);
        self.of_node[node as usize] = Held {
            register: left,
            written: now,
        };
        self.order.push(node);
        self.written(self.reader_of_node[node as usize], now);
        Instruction::Node {
            children: [left, right],
            axes,
        }
    }

    /// Records that instruction `now` writes a leaf's box.
    fn leaf_merged(&mut self, number: u32, now: usize) {
        self.of_leaf[number as usize] = Held {
            register: self.boxes.take(),
            written: now,
        };
        self.written(self.reader_of_leaf[number as usize], now);
    }

    /// Records that instruction `now` writes an operand of a unit.
    fn written(&mut self, unit: u32, now: usize) {
        if unit == NEVER {
            return;
        }
        let missing = &mut self.units[unit as usize].missing;
        *missing -= 1;
        if *missing == 0 {
            self.waiting.push_back((now, unit));
        }
    }
}

/// A box in a register.
#[derive(Clone, Copy, Default)]
struct Held {
    register: u8,
    /// The number of the instruction that wrote it.
    written: usize,
}

/// The free box registers, with the same allocation as in the machine.
#[derive(Default)]
struct BoxFile {
    free: Vec<u8>,
    fresh: u8,
    in_use: u32,
    most_in_use: u32,
}

impl BoxFile {
    fn take(&mut self) -> u8 {
        self.in_use += 1;
        self.most_in_use = self.most_in_use.max(self.in_use);
        self.free.pop().unwrap_or_else(|| {
            self.fresh += 1;
            self.fresh - 1
        })
    }

    fn release(&mut self, register: u8) {
        self.in_use -= 1;
        self.free.push(register);
    }
}

/// The remaining tasks of [`walk`], last in, first out.
enum Task {
    /// Compute the boxes of a node's children.
    Children(u32),
    /// Merge the children of a node, or of two siblings, whose boxes are computed.
    Unit(u32, Option<u32>),
    Leaf(u32),
}

/// Walks the tree depth first, starting with the subtree that needs more registers. Siblings are written next to each other, so
/// until its sibling is done a subtree occupies not one box but those of its two children.
fn walk(tree: &Tree) -> Walk {
    let need = box_registers_needed(tree);
    let mut walk = Walk {
        leaves: Vec::with_capacity(tree.triangle_count()),
        units: Vec::with_capacity(tree.nodes.len()),
        box_registers: 1,
    };
    let mut nodes_done = 0;
    let mut tasks = match tree.root {
        Child::Inner(root) => vec![Task::Unit(root, None), Task::Children(root)],
        Child::Leaf(number) => vec![Task::Leaf(number)],
    };
    while let Some(task) = tasks.pop() {
        match task {
            Task::Children(index) => match tree.nodes[index as usize].children {
                [Child::Inner(left), Child::Inner(right)] => {
                    let (first, second) = if need[right as usize] > need[left as usize] {
                        (right, left)
                    } else {
                        (left, right)
                    };
                    tasks.extend([
                        Task::Unit(left, Some(right)),
                        Task::Children(second),
                        Task::Children(first),
                    ]);
                }
                [Child::Inner(inner), Child::Leaf(number)]
                | [Child::Leaf(number), Child::Inner(inner)] => {
                    tasks.extend([
                        Task::Leaf(number),
                        Task::Unit(inner, None),
                        Task::Children(inner),
                    ]);
                }
                [Child::Leaf(left), Child::Leaf(right)] => {
                    tasks.extend([Task::Leaf(right), Task::Leaf(left)]);
                }
            },
            Task::Unit(first, second) => {
                // A leaf takes a register and a node frees one.
                let in_use = walk.leaves.len() as u32 - nodes_done;
                walk.box_registers = walk.box_registers.max(in_use);
                nodes_done += 1 + u32::from(second.is_some());
                walk.units.push((first, second));
            }
            Task::Leaf(number) => walk.leaves.push(number),
        }
    }
    walk
}

/// For each node, the number of box registers needed to compute its children's boxes.
fn box_registers_needed(tree: &Tree) -> Vec<u32> {
    let mut need = vec![0u32; tree.nodes.len()];
    for index in tree.children_first() {
        need[index as usize] = match tree.nodes[index as usize].children {
            [Child::Inner(left), Child::Inner(right)] => {
                let (left, right) = (need[left as usize], need[right as usize]);
                left.max(right).max(left.min(right) + 2)
            }
            [Child::Inner(inner), Child::Leaf(_)] | [Child::Leaf(_), Child::Inner(inner)] => {
                need[inner as usize]
            }
            [Child::Leaf(_), Child::Leaf(_)] => 2,
        };
    }
    need
}

/// The vertex registers, filled for one leaf after another. The vertex with the most distant next use is replaced.
struct VertexFile<'a> {
    loads: Loads,
    leaves: &'a [u32],
    triangles: &'a [[u32; 3]],
    /// For each leaf, in order, and each corner, the leaf with the next use of the vertex.
    next_uses: Vec<[u32; 3]>,
    /// The leaf whose vertices are being loaded.
    leaf: usize,
    /// For each vertex, its register, or [`NOWHERE`].
    register_of: Vec<u8>,
    /// For each vertex, its index in `loaded`, or [`NEVER`].
    place_of: Vec<u32>,
    /// Vertices in the order of their first loads.
    loaded: Vec<u32>,
    /// For each register, its vertex, or [`NEVER`].
    contents: Vec<u32>,
    /// For each register, the leaf with its next use, or [`NEVER`].
    used_next: Vec<u32>,
    last: u8,
}

const NEVER: u32 = u32::MAX;
const NOWHERE: u8 = u8::MAX;

impl<'a> VertexFile<'a> {
    fn new(
        leaves: &'a [u32],
        triangles: &'a [[u32; 3]],
        vertices: usize,
        machine: UpdateMachine,
        loads: Loads,
    ) -> Self {
        let mut used_from_here = vec![NEVER; vertices];
        let mut next_uses = vec![[NEVER; 3]; leaves.len()];
        for (leaf, &number) in leaves.iter().enumerate().rev() {
            let triangle = triangles[number as usize];
            next_uses[leaf] = triangle.map(|vertex| used_from_here[vertex as usize]);
            for vertex in triangle {
                used_from_here[vertex as usize] = leaf as u32;
            }
        }
        let registers = machine.vertex_registers as usize;
        VertexFile {
            loads,
            leaves,
            triangles,
            next_uses,
            leaf: 0,
            register_of: vec![NOWHERE; vertices],
            place_of: vec![NEVER; vertices],
            loaded: Vec::new(),
            contents: vec![NEVER; registers],
            used_next: vec![NEVER; registers],
            last: 0,
        }
    }

    /// The next load for the leaf, if it needs one.
    fn next_load(&mut self) -> Option<Instruction> {
        let number = *self.leaves.get(self.leaf)?;
        let triangle = self.triangles[number as usize];
        let vertex = triangle
            .into_iter()
            .find(|&vertex| self.register_of[vertex as usize] == NOWHERE)?;
        // The vertices of this leaf have the nearest next use, so they are not replaced.
        for held in triangle {
            let register = self.register_of[held as usize];
            if register != NOWHERE {
                debug_assert_eq!(self.used_next[register as usize], self.leaf as u32);
            }
        }
        let mut victim = 0;
        for (register, &next) in self.used_next.iter().enumerate() {
            if next > self.used_next[victim] {
                victim = register;
            }
        }
        let evicted = self.contents[victim];
        if evicted != NEVER {
            self.register_of[evicted as usize] = NOWHERE;
        }
        let register = victim as u8;
        self.contents[victim] = vertex;
        self.used_next[victim] = self.leaf as u32;
        self.register_of[vertex as usize] = register;
        self.last = register;
        let place = &mut self.place_of[vertex as usize];
        let first = *place == NEVER;
        if first {
            *place = self.loaded.len() as u32;
            self.loaded.push(vertex);
        }
        Some(match self.loads {
            Loads::InOrder if first => Instruction::Load { register },
            Loads::InOrder => Instruction::Reload {
                register,
                vertex: *place,
            },
            Loads::ByIndex { .. } => Instruction::Reload { register, vertex },
        })
    }

    /// The merge of the leaf, whose vertices are all loaded; advances to the next leaf.
    fn merge_leaf(&mut self) -> Instruction {
        let triangle = self.triangles[self.leaves[self.leaf] as usize];
        let registers = triangle.map(|vertex| self.register_of[vertex as usize]);
        for (register, next) in registers.into_iter().zip(self.next_uses[self.leaf]) {
            self.used_next[register as usize] = next;
        }
        self.leaf += 1;
        let [x, y, z] = registers;
        let last = self.last;
        // Minimum and maximum do not depend on the order.
        if z == last {
            Instruction::LeafLast { vertices: [x, y] }
        } else if y == last {
            Instruction::LeafLast { vertices: [x, z] }
        } else if x == last {
            Instruction::LeafLast { vertices: [y, z] }
        } else {
            Instruction::Leaf {
                vertices: registers,
            }
        }
    }

    /// All vertices in the order of their first loads, followed by unused ones; or all of them in their own order.
    fn vertex_order(self) -> Vec<u32> {
        if let Loads::ByIndex { vertices } = self.loads {
            return (0..vertices).collect();
        }
        let mut order = self.loaded;
        let unused = (0..self.place_of.len() as u32)
            .filter(|&vertex| self.place_of[vertex as usize] == NEVER);
        order.extend(unused);
        order
    }
}
