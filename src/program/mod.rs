//! The update program: a tree's topology compiled to the instruction stream that the update processor executes
//! after every motion of the vertices. `docs/update.md` is normative.
//!
//! [`Program::compile`] determines the instructions and two orders: that of the vertices in memory (by first load) and
//! that of the nodes (by write). [`Program::image`] lays an object out accordingly.

mod compile;
mod encode;

use std::fmt::Write as _;

use anyhow::{Result, bail, ensure};
use serde::Serialize;

use crate::bkd::{MemoryImage, Tree, layout};
use crate::float::Format;

pub use encode::{FORMS, Form, Instruction, decode, encode};

/// The parameters of the update processor for which a program is compiled.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
pub struct UpdateMachine {
    /// Number of vertex registers, in [`UpdateMachine::REGISTERS`].
    pub vertex_registers: u32,
    /// Number of box registers, in [`UpdateMachine::REGISTERS`].
    pub box_registers: u32,
    /// Minimum distance between the instruction that writes a box register and the first one that may read it, in
    /// [`UpdateMachine::MERGE_DISTANCE`]; 1 is the next instruction.
    pub merge_distance: u32,
}

impl UpdateMachine {
    /// The valid numbers of registers of a kind.
    pub const REGISTERS: std::ops::RangeInclusive<u32> = 8..=64;
    /// The valid merge distances.
    pub const MERGE_DISTANCE: std::ops::RangeInclusive<u32> = 1..=16;

    /// # Errors
    /// Names the parameter that is out of range.
    pub fn check(&self) -> Result<()> {
        for (name, value, range) in [
            ("vertex registers", self.vertex_registers, Self::REGISTERS),
            ("box registers", self.box_registers, Self::REGISTERS),
            (
                "instructions of merge distance",
                self.merge_distance,
                Self::MERGE_DISTANCE,
            ),
        ] {
            ensure!(
                range.contains(&value),
                "an update processor has {} to {} {name}, not {value}",
                range.start(),
                range.end()
            );
        }
        Ok(())
    }
}

impl Default for UpdateMachine {
    /// 64 registers of either kind, as in the original, and a merge distance of 6.
    fn default() -> Self {
        UpdateMachine {
            vertex_registers: 64,
            box_registers: 64,
            merge_distance: 6,
        }
    }
}

/// How a program finds its vertices in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loads {
    /// The vertices of an object, which are numbered in the order of their first loads.
    InOrder,
    /// The corners of instances, which have other vectors between them: every load names an index below `vertices`.
    ByIndex { vertices: u32 },
}

/// The update program of one object, or of a top-level tree.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Program {
    /// The machine for which it was compiled. It runs on any machine with at least as many registers and at most the same distance.
    pub machine: UpdateMachine,
    pub loads: Loads,
    /// The instructions, with `end` as the last one.
    pub instructions: Vec<Instruction>,
    /// The mesh's vertices in the order of memory: by first load, followed by unused ones. Of a top-level tree: the array as it is.
    /// Entry k is the mesh's index of the vertex at vertex base + k.
    pub vertex_order: Vec<u32>,
    /// Indices into [`Tree::nodes`] in the order of the writes: the `order` of [`layout::place`].
    pub node_order: Vec<u32>,
    vertices_used: u32,
    box_registers_used: u32,
}

/// Statistics of a program.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Statistics {
    pub triangles: u64,
    /// Number of nodes written: one less than the number of triangles.
    pub nodes: u64,
    /// Number of vertices that triangles use.
    pub vertices: u64,
    /// Number of all instructions, including `end` and `nop`.
    pub instructions: u64,
    /// Number of loads of vertices, including repeated ones.
    pub loads: u64,
    /// Number of repeated loads.
    pub reloads: u64,
    /// Number of merges of three vertices.
    pub leaf_merges: u64,
    /// Number of those in the short form, which implies the vertex loaded last.
    pub short_leaf_merges: u64,
    /// Number of merges of two boxes.
    pub node_merges: u64,
    /// Number of `nop` instructions.
    pub nops: u64,
    /// Encoded length in bytes, without the padding after `end`.
    pub bytes: u64,
    pub vertex_registers_used: u32,
    pub box_registers_used: u32,
    /// `loads` ÷ `vertices`; the minimum is 1.
    pub loads_per_vertex: f64,
    pub instructions_per_triangle: f64,
    pub bytes_per_triangle: f64,
}

impl Program {
    /// Compiles the update program of a tree over `triangles`, whose indices are below `vertices`, for a machine.
    /// The result depends only on the arguments.
    ///
    /// # Errors
    /// If a machine's parameter is out of range, if the tree is not a tree over these triangles, if a triangle names a missing
    /// vertex, or if the tree needs more box registers than the machine has.
    pub fn compile(
        tree: &Tree,
        triangles: &[[u32; 3]],
        vertices: usize,
        machine: UpdateMachine,
    ) -> Result<Program> {
        compile::compile(tree, triangles, vertices, machine, Loads::InOrder)
    }

    /// Compiles the update program of a top-level tree for a machine. `corners` are, for each instance, the indices of the least and
    /// the greatest corner of its box from the command's vertex base on; all are below `vertices`.
    ///
    /// # Errors
    /// As [`Program::compile`].
    pub fn compile_top(
        tree: &Tree,
        corners: &[[u32; 2]],
        vertices: u32,
        machine: UpdateMachine,
    ) -> Result<Program> {
        // The box of both corners, one of them taken twice, is the instance's.
        let leaves: Vec<[u32; 3]> = corners.iter().map(|&[lo, hi]| [lo, hi, hi]).collect();
        let loads = Loads::ByIndex { vertices };
        compile::compile(tree, &leaves, vertices as usize, machine, loads)
    }

    /// The program in memory: encoded, and padded with zeros to a multiple of [`Program::ROW_BYTES`].
    pub fn bytes(&self) -> Vec<u8> {
        let mut bytes = encode(&self.instructions);
        bytes.resize(bytes.len().next_multiple_of(Self::ROW_BYTES), 0);
        bytes
    }

    /// A program starts at a multiple of this number of bytes and is padded to one.
    pub const ROW_BYTES: usize = 16;

    /// The rows of [`Program::bytes`] as text for `$readmemh`, one line of hexadecimal digits per row.
    pub fn hex_lines(&self) -> String {
        let mut lines = String::new();
        for row in self.bytes().chunks_exact(Self::ROW_BYTES) {
            for byte in row.iter().rev() {
                write!(lines, "{byte:02x}").expect("a string takes all");
            }
            lines.push('\n');
        }
        lines
    }

    /// Reorders one item per vertex of the mesh to the order of the program.
    ///
    /// # Panics
    /// If the number of items is not the number of the mesh's vertices.
    pub fn reorder_vertices<T: Clone>(&self, items: &[T]) -> Vec<T> {
        assert_eq!(
            items.len(),
            self.vertex_order.len(),
            "an item for each vertex"
        );
        let order = self.vertex_order.iter();
        order.map(|&old| items[old as usize].clone()).collect()
    }

    /// The mesh's triangles with vertices numbered in the order of the program.
    ///
    /// # Panics
    /// If a triangle names a vertex that the mesh did not have.
    pub fn renumber(&self, triangles: &[[u32; 3]]) -> Vec<[u32; 3]> {
        let mut place_of = vec![0; self.vertex_order.len()];
        for (place, &old) in self.vertex_order.iter().enumerate() {
            place_of[old as usize] = place as u32;
        }
        let renumbered = |&triangle: &[u32; 3]| triangle.map(|old| place_of[old as usize]);
        triangles.iter().map(renumbered).collect()
    }

    /// The memory image of the object at base 0, with vertices and nodes in the order of the program. `tree`, `triangles` and
    /// `vertices` are those for which it was compiled; `vertices` are values of `format`, in the mesh's order.
    ///
    /// # Errors
    /// If the mesh is too large for the link word.
    pub fn image(
        &self,
        format: Format,
        vertices: &[[f64; 3]],
        triangles: &[[u32; 3]],
        tree: &Tree,
    ) -> Result<MemoryImage> {
        let refit = tree.refit(vertices, triangles);
        let placement = layout::place(
            tree,
            &refit,
            &self.renumber(triangles),
            &self.node_order,
            0,
            0,
        )?;
        Ok(MemoryImage {
            format,
            nodes: placement.nodes,
            records: placement.records,
            vertices: self.reorder_vertices(vertices),
            root: placement.root,
            bounds: (refit.root.lo, refit.root.hi),
        })
    }

    /// Number of vertices that triangles use: the first ones in the program's order.
    pub fn vertices_used(&self) -> u32 {
        self.vertices_used
    }

    /// The statistics of the program.
    pub fn statistics(&self) -> Statistics {
        let (mut loads, mut leaves, mut short, mut nodes, mut nops) = (0, 0, 0, 0, 0);
        let (mut bytes, mut vertex_registers_used) = (0, 0);
        for instruction in &self.instructions {
            bytes += instruction.form().bytes as u64;
            match *instruction {
                Instruction::Load { register } | Instruction::Reload { register, .. } => {
                    loads += 1;
                    vertex_registers_used = vertex_registers_used.max(u32::from(register) + 1);
                }
                Instruction::Leaf { .. } => leaves += 1,
                Instruction::LeafLast { .. } => {
                    leaves += 1;
                    short += 1;
                }
                Instruction::Node { .. } => nodes += 1,
                Instruction::Nop => nops += 1,
                Instruction::End { .. } => {}
            }
        }
        let vertices = u64::from(self.vertices_used);
        let instructions = self.instructions.len() as u64;
        Statistics {
            triangles: leaves,
            nodes,
            vertices,
            instructions,
            loads,
            reloads: loads - vertices,
            leaf_merges: leaves,
            short_leaf_merges: short,
            node_merges: nodes,
            nops,
            bytes,
            vertex_registers_used,
            box_registers_used: self.box_registers_used,
            loads_per_vertex: loads as f64 / vertices as f64,
            instructions_per_triangle: instructions as f64 / leaves as f64,
            bytes_per_triangle: bytes as f64 / leaves as f64,
        }
    }

    /// Checks the properties that `docs/update.md` guarantees for a program.
    ///
    /// # Errors
    /// Names the instruction that breaks a rule, and the rule.
    pub fn check(&self) -> Result<()> {
        check(&self.instructions, self.machine, self.loads)
    }

    /// The program as text, one line per instruction: byte address, bytes, and the instruction with its implicit
    /// operands.
    pub fn listing(&self) -> String {
        let mut listing = String::with_capacity(self.instructions.len() * 48);
        let mut state = Implicit::default();
        let mut address = 0;
        for &instruction in &self.instructions {
            let code = encode(&[instruction]);
            let mut hex = String::new();
            for byte in &code {
                write!(hex, "{byte:02x} ").expect("a string takes all");
            }
            let text = state.step(instruction);
            writeln!(listing, "{address:08x}  {hex:<15} {text}").expect("a string takes all");
            address += code.len();
        }
        listing
    }
}

/// The implicit operands of instructions, determined by decoding in order.
#[derive(Default)]
struct Implicit {
    next_vertex: u32,
    next_node: u32,
    last: u8,
    free: Vec<u8>,
    fresh: u8,
}

impl Implicit {
    fn box_register(&mut self) -> u8 {
        self.free.pop().unwrap_or_else(|| {
            self.fresh += 1;
            self.fresh - 1
        })
    }

    /// Advances by one instruction and returns its description.
    fn step(&mut self, instruction: Instruction) -> String {
        let axis = |axis: u8| ["x", "y", "z"][axis as usize];
        match instruction {
            Instruction::Load { register } => {
                self.last = register;
                self.next_vertex += 1;
                format!("load v{register}, [{}]", self.next_vertex - 1)
            }
            Instruction::Reload { register, vertex } => {
                self.last = register;
                format!("load v{register}, [{vertex}]  ; again")
            }
            Instruction::Leaf {
                vertices: [x, y, z],
            } => {
                format!("leaf b{}, v{x} v{y} v{z}", self.box_register())
            }
            Instruction::LeafLast { vertices: [x, y] } => {
                format!("leaf b{}, v{x} v{y} v{}", self.box_register(), self.last)
            }
            Instruction::Node {
                children: [a, b],
                axes: [left, right],
            } => {
                self.free.push(b);
                self.next_node += 1;
                format!(
                    "node b{a}, b{a}.{} b{b}.{}  ; node {}",
                    axis(left),
                    axis(right),
                    self.next_node - 1
                )
            }
            Instruction::Nop => "nop".into(),
            Instruction::End { register } => format!("end  b{register}"),
        }
    }
}

/// Checks a stream of instructions against the rules for a machine; see [`Program::check`].
///
/// # Errors
/// Names the instruction that breaks a rule, and the rule.
pub fn check(instructions: &[Instruction], machine: UpdateMachine, loads: Loads) -> Result<()> {
    machine.check()?;
    let mut vertex_written = vec![false; machine.vertex_registers as usize];
    // For each box register in use, the number of the instruction that wrote it.
    let mut box_written: Vec<Option<usize>> = vec![None; machine.box_registers as usize];
    let mut state = Implicit::default();
    for (number, &instruction) in instructions.iter().enumerate() {
        let fault = |what: String| {
            Err(anyhow::anyhow!(
                "instruction {number} ({instruction:?}) {what}; compile the program again"
            ))
        };
        if instruction.form().name == "end" && number + 1 != instructions.len() {
            return fault("is not the last".into());
        }
        match instruction {
            Instruction::Load { register } | Instruction::Reload { register, .. } => {
                match (instruction, loads) {
                    (Instruction::Reload { vertex, .. }, Loads::InOrder)
                        if vertex >= state.next_vertex =>
                    {
                        return fault("loads a vertex again that was never loaded".into());
                    }
                    (Instruction::Reload { vertex, .. }, Loads::ByIndex { vertices })
                        if vertex >= vertices =>
                    {
                        return fault("loads a vertex that is not there".into());
                    }
                    (Instruction::Load { .. }, Loads::ByIndex { .. }) => {
                        return fault("loads the next vertex, but these have no order".into());
                    }
                    _ => {}
                }
                let Some(written) = vertex_written.get_mut(register as usize) else {
                    return fault("names a vertex register that the machine lacks".into());
                };
                *written = true;
                state.step(instruction);
            }
            Instruction::Leaf { .. } | Instruction::LeafLast { .. } => {
                let vertices = match instruction {
                    Instruction::Leaf { vertices } => vertices,
                    Instruction::LeafLast { vertices: [x, y] } => [x, y, state.last],
                    _ => unreachable!("a leaf merge"),
                };
                for register in vertices {
                    if vertex_written.get(register as usize) != Some(&true) {
                        return fault(format!("reads v{register}, which nothing wrote"));
                    }
                }
                let register = state.box_register();
                let Some(written) = box_written.get_mut(register as usize) else {
                    return fault("finds no free box register".into());
                };
                *written = Some(number);
            }
            Instruction::Node { children, axes } => {
                for register in children {
                    let Some(&Some(written)) = box_written.get(register as usize) else {
                        return fault(format!("reads b{register}, which holds no box"));
                    };
                    if number - written < machine.merge_distance as usize {
                        return fault(format!(
                            "reads b{register} {} instructions after it is written",
                            number - written
                        ));
                    }
                }
                let [a, b] = children;
                if a == b || axes.iter().any(|&axis| axis > 2) {
                    return fault("merges a box with itself or has an axis beyond z".into());
                }
                box_written[a as usize] = Some(number);
                box_written[b as usize] = None;
                state.step(instruction);
            }
            Instruction::Nop => {}
            Instruction::End { register } => {
                let held = box_written.iter().filter(|written| written.is_some());
                if held.count() != 1 || !matches!(box_written.get(register as usize), Some(Some(_)))
                {
                    return fault("does not find all boxes merged into its own".into());
                }
            }
        }
    }
    let Some(Instruction::End { .. }) = instructions.last() else {
        bail!("the program does not end; compile it again");
    };
    Ok(())
}
