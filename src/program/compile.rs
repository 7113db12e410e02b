//! From a tree's topology to its update program.
//!
//! 1. [`walk`] fixes the order of leaves and the order of nodes, each as one sequence.
//! 2. [`VertexFile`] turns the sequence of leaves into one of loads and leaf merges.
//! 3. [`compile`] interleaves that with the sequence of nodes so that no merge has to wait for another.

use anyhow::{Result, ensure};

use super::{Instruction, Program, UpdateMachine};
use crate::bkd::{Child, Tree};

/// The two sequences of which a program is made.
struct Walk {
    /// Triangles, in the order of their leaf merges.
    leaves: Vec<u32>,
    nodes: Vec<NodeStep>,
    /// Box registers that the sequences need at least.
    box_registers: u32,
}

struct NodeStep {
    /// The index in [`Tree::nodes`].
    node: u32,
    /// Leaves that must have been merged before.
    leaves_before: u32,
}

pub(super) fn compile(
    tree: &Tree,
    triangles: &[[u32; 3]],
    vertices: usize,
    machine: UpdateMachine,
) -> Result<Program> {
    machine.check()?;
    ensure!(
        tree.triangle_count() == triangles.len(),
        "the tree has {} leaves but the mesh {} triangles; build the tree anew",
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
    ensure!(
        walk.leaves.len() == triangles.len() && walk.nodes.len() == tree.nodes.len(),
        "the tree does not reach each of its {} nodes once; build it anew",
        tree.nodes.len()
    );
    ensure!(
        walk.box_registers <= machine.box_registers,
        "the tree's update program needs {} box registers, but the machine has {}; give it more or split the mesh",
        walk.box_registers,
        machine.box_registers
    );

    let distance = machine.merge_distance as usize;
    let mut vertex_file = VertexFile::new(&walk.leaves, triangles, vertices, machine);
    let mut instructions = Vec::with_capacity(triangles.len() * 11 / 4 + 16);
    let mut boxes = BoxFile::default();
    // Where the box of each node and of each leaf is, once it is.
    let mut of_node = vec![Held::default(); tree.nodes.len()];
    let mut of_leaf = vec![Held::default(); triangles.len()];
    let (mut nodes_done, mut leaves_done) = (0, 0);
    while nodes_done < walk.nodes.len() || leaves_done < walk.leaves.len() {
        let now = instructions.len();
        if let Some(step) = walk.nodes.get(nodes_done)
            && step.leaves_before as usize <= leaves_done
        {
            let node = &tree.nodes[step.node as usize];
            let [left, right] = node.children.map(|child| match child {
                Child::Inner(index) => of_node[index as usize],
                Child::Leaf(number) => of_leaf[number as usize],
            });
            if now >= left.written + distance && now >= right.written + distance {
                instructions.push(Instruction::Node {
                    children: [left.register, right.register],
                    axes: node.axes,
                });
                of_node[step.node as usize] = Held {
                    register: left.register,
                    written: now,
                };
                boxes.release(right.register);
                nodes_done += 1;
                continue;
            }
        }
        let instruction = if let Some(load) = vertex_file.next_load() {
            load
        } else if leaves_done < walk.leaves.len() && boxes.in_use < machine.box_registers {
            of_leaf[walk.leaves[leaves_done] as usize] = Held {
                register: boxes.take(),
                written: now,
            };
            leaves_done += 1;
            vertex_file.merge_leaf()
        } else {
            Instruction::Nop
        };
        instructions.push(instruction);
    }
    let root = match tree.root {
        Child::Inner(index) => of_node[index as usize],
        Child::Leaf(number) => of_leaf[number as usize],
    };
    instructions.push(Instruction::End {
        register: root.register,
    });

    let vertices_used = vertex_file.loaded.len() as u32;
    Ok(Program {
        machine,
        instructions,
        vertex_order: vertex_file.vertex_order(),
        node_order: walk.nodes.iter().map(|step| step.node).collect(),
        vertices_used,
        box_registers_used: boxes.most_in_use,
    })
}

/// A box in a register.
#[derive(Clone, Copy, Default)]
struct Held {
    register: u8,
    /// The number of the instruction that wrote it.
    written: usize,
}

/// Which box registers are free, as the machine itself decides it.
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

/// What is left to do in [`walk`], last in, first out.
enum Task {
    /// Make the boxes of a node's children.
    Children(u32),
    /// Merge a node's children, whose boxes are made.
    Node(u32),
    Leaf(u32),
}

/// Walks the tree depth first, the greedier subtree first. Siblings are written side by side, so what a subtree leaves
/// behind until its sibling is done is not its box but those of its two children.
fn walk(tree: &Tree) -> Walk {
    let need = box_registers_needed(tree);
    let mut walk = Walk {
        leaves: Vec::with_capacity(tree.triangle_count()),
        nodes: Vec::with_capacity(tree.nodes.len()),
        box_registers: 1,
    };
    let mut tasks = match tree.root {
        Child::Inner(root) => vec![Task::Node(root), Task::Children(root)],
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
                        Task::Node(right),
                        Task::Node(left),
                        Task::Children(second),
                        Task::Children(first),
                    ]);
                }
                [Child::Inner(inner), Child::Leaf(number)]
                | [Child::Leaf(number), Child::Inner(inner)] => {
                    tasks.extend([Task::Leaf(number), Task::Node(inner), Task::Children(inner)]);
                }
                [Child::Leaf(left), Child::Leaf(right)] => {
                    tasks.extend([Task::Leaf(right), Task::Leaf(left)]);
                }
            },
            Task::Node(index) => {
                let leaves_before = walk.leaves.len() as u32;
                // A leaf takes a register and a node frees one.
                let in_use = leaves_before - walk.nodes.len() as u32;
                walk.box_registers = walk.box_registers.max(in_use);
                walk.nodes.push(NodeStep {
                    node: index,
                    leaves_before,
                });
            }
            Task::Leaf(number) => walk.leaves.push(number),
        }
    }
    walk
}

/// For each node, the box registers in which its children's boxes can be made.
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

/// The vertex registers, filled for one leaf after the other. The vertex whose next use is farthest gives way.
struct VertexFile<'a> {
    leaves: &'a [u32],
    triangles: &'a [[u32; 3]],
    /// For each leaf, in order, and corner, the leaf that uses the vertex next.
    next_uses: Vec<[u32; 3]>,
    /// The leaf whose vertices are being loaded.
    leaf: usize,
    /// For each vertex, the register it is in, or [`NOWHERE`].
    register_of: Vec<u8>,
    /// For each vertex, its place in `loaded`, or [`NEVER`].
    place_of: Vec<u32>,
    /// Vertices by first load.
    loaded: Vec<u32>,
    /// For each register, the vertex in it, or [`NEVER`].
    contents: Vec<u32>,
    /// For each register, the leaf that uses it next, or [`NEVER`].
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

    /// The next load that the leaf needs, if any.
    fn next_load(&mut self) -> Option<Instruction> {
        let number = *self.leaves.get(self.leaf)?;
        let triangle = self.triangles[number as usize];
        let vertex = triangle
            .into_iter()
            .find(|&vertex| self.register_of[vertex as usize] == NOWHERE)?;
        // Those of this leaf are used soonest, hence stay.
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
        Some(if *place == NEVER {
            *place = self.loaded.len() as u32;
            self.loaded.push(vertex);
            Instruction::Load { register }
        } else {
            Instruction::Reload {
                register,
                vertex: *place,
            }
        })
    }

    /// The merge of the leaf, whose vertices are all loaded, and on to the next leaf.
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

    /// All vertices, by first load, unused ones last.
    fn vertex_order(self) -> Vec<u32> {
        let mut order = self.loaded;
        let unused = (0..self.place_of.len() as u32)
            .filter(|&vertex| self.place_of[vertex as usize] == NEVER);
        order.extend(unused);
        order
    }
}
