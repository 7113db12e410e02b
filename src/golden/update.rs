//! The update processor: runs an update program, as `docs/update.md` defines it, on the bits in memory.
//!
//! It is written from that page only and shares no code with the compiler.

use anyhow::{Result, bail, ensure};

use crate::bkd::{Bounds, Record};
use crate::float::{Arithmetic, Format};

/// The command to update an object.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct UpdateCommand {
    /// Address of the program's first byte, a multiple of 16.
    pub program: u32,
    /// Index of the object's first vertex.
    pub vertex_base: u32,
    /// Index of the object's first node.
    pub node_base: u32,
    /// Index at which the object's box is written.
    pub box_index: u32,
}

/// The arrays that an update reads and writes, as words of whole records ([`Record::words`] each).
pub struct UpdateMemory<'a> {
    pub format: Format,
    /// The bytes of the programs.
    pub program: &'a [u8],
    /// [`Record::vertex`].
    pub vertices: &'a [u32],
    /// [`Record::node`]; only the four numbers are written.
    pub nodes: &'a mut [u32],
    /// [`Record::bounding_box`].
    pub boxes: &'a mut [u32],
}

/// An externally visible event of an update. Events are in the order of the program.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum UpdateEvent {
    /// A vertex is read, by absolute index.
    VertexRead { vertex: u32 },
    /// A node's bounds are written, by absolute index: bit patterns of left_lo, left_hi, right_lo, right_hi.
    NodeWrite { node: u32, bounds: [u64; 4] },
    /// The object's box is written, by absolute index: bit patterns of the minimum and of the maximum corner.
    BoxWrite { index: u32, bounds: [u64; 6] },
}

/// The result of an update.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Updated {
    /// The object's box.
    pub bounds: Bounds,
    /// Number of instructions executed, including `end`.
    pub instructions: u64,
    pub vertices_read: u64,
    pub nodes_written: u64,
}

const REGISTERS: usize = 64;

/// Runs a program and reports all reads and writes to `observe`.
///
/// # Errors
/// If the program is invalid, uses a register without a value, or reads or writes outside the arrays. The message names the byte
/// at which the instruction starts.
pub fn update(
    memory: UpdateMemory,
    command: UpdateCommand,
    mut observe: impl FnMut(UpdateEvent),
) -> Result<Updated> {
    let UpdateMemory {
        format,
        program,
        vertices,
        nodes,
        boxes,
    } = memory;
    ensure!(
        command.program.is_multiple_of(16),
        "a program starts at a multiple of 16 bytes, not at {}",
        command.program
    );
    let vertex = Record::vertex(format);
    let (node_layout, box_layout) = (Record::node(format), Record::bounding_box(format));
    let vertex_at = |index: u32| {
        let start = index as usize * vertex.words();
        let record = vertices.get(start..start + vertex.words())?;
        Some(["x", "y", "z"].map(|name| format.to_f64(vertex.get(record, name))))
    };
    let write = |event: UpdateEvent| {
        match event {
            UpdateEvent::VertexRead { .. } => (),
            UpdateEvent::NodeWrite { node, bounds } => {
                let start = node as usize * node_layout.words();
                let Some(record) = nodes.get_mut(start..start + node_layout.words()) else {
                    bail!("node {node} is outside memory");
                };
                for (name, bits) in NODE_BOUNDS.into_iter().zip(bounds) {
                    node_layout.set(record, name, bits);
                }
            }
            UpdateEvent::BoxWrite { index, bounds } => {
                let start = index as usize * box_layout.words();
                let Some(record) = boxes.get_mut(start..start + box_layout.words()) else {
                    bail!("box {index} is outside memory");
                };
                for (field, bits) in box_layout.fields.iter().zip(bounds) {
                    field.set(record, bits);
                }
            }
        }
        observe(event);
        Ok(())
    };
    let program = program.get(command.program as usize..).unwrap_or_default();
    run(format, program, &command, vertex_at, write)
}

/// The numbers of a node, in the order of [`UpdateEvent::NodeWrite`].
pub const NODE_BOUNDS: [&str; 4] = ["left_lo", "left_hi", "right_lo", "right_hi"];

/// Runs the program that begins with the first byte of `program`, whose address is not used. `vertex_at` returns a vertex by its
/// absolute index, `None` outside memory; `event` writes what is written.
///
/// # Errors
/// If the program is invalid, uses a register without a value, reads outside memory, or if `event` fails. The message names the
/// byte at which the instruction starts, from the start of the program.
pub fn run(
    format: Format,
    program: &[u8],
    command: &UpdateCommand,
    vertex_at: impl FnMut(u32) -> Option<[f64; 3]>,
    event: impl FnMut(UpdateEvent) -> Result<()>,
) -> Result<Updated> {
    let mut processor = Processor {
        format,
        arithmetic: Arithmetic::new(format),
        vertex_at,
        event,
        v: [None; REGISTERS],
        b: [None; REGISTERS],
        next_vertex: command.vertex_base,
        next_node: command.node_base,
        last: 0,
        free_list: Vec::new(),
        fresh: 0,
        updated: Updated {
            bounds: Bounds::EMPTY,
            instructions: 0,
            vertices_read: 0,
            nodes_written: 0,
        },
    };
    let mut at = 0;
    loop {
        let window: [u8; 8] = std::array::from_fn(|k| program.get(at + k).copied().unwrap_or(0));
        let step = processor.execute(u64::from_le_bytes(window), command);
        let step = step.map_err(|error| error.context(format!("update program, byte {at}")))?;
        processor.updated.instructions += 1;
        match step {
            Step::Next(bytes) => at += bytes,
            Step::End => return Ok(processor.updated),
        }
        ensure!(
            at < program.len(),
            "the update program does not end: there are only {at} bytes"
        );
    }
}

/// The continuation after an instruction.
enum Step {
    /// The length of the instruction in bytes.
    Next(usize),
    End,
}

struct Processor<V, E> {
    format: Format,
    arithmetic: Arithmetic,
    vertex_at: V,
    event: E,
    v: [Option<[f64; 3]>; REGISTERS],
    b: [Option<Bounds>; REGISTERS],
    next_vertex: u32,
    next_node: u32,
    last: usize,
    free_list: Vec<usize>,
    fresh: usize,
    updated: Updated,
}

impl<V, E> Processor<V, E>
where
    V: FnMut(u32) -> Option<[f64; 3]>,
    E: FnMut(UpdateEvent) -> Result<()>,
{
    /// Executes the instruction in the low bits of `bits`.
    fn execute(&mut self, bits: u64, command: &UpdateCommand) -> Result<Step> {
        let six = |lsb: u32| (bits >> lsb & 63) as usize;
        let bytes = match (bits & 3, bits >> 2 & 3) {
            (3, _) => {
                self.load(six(2), self.next_vertex)?;
                self.next_vertex += 1;
                1
            }
            (0, 3) => {
                self.leaf([six(4), six(10), six(16)])?;
                3
            }
            (1, 3) => {
                self.leaf([six(4), six(10), self.last])?;
                2
            }
            (2, 3) => match bits >> 4 & 15 {
                0 => 1,
                1 => {
                    self.end(six(8), command.box_index)?;
                    return Ok(Step::End);
                }
                2 => {
                    let k = (bits >> 14 & 0x3ff_ffff) as u32;
                    self.load(six(8), command.vertex_base.saturating_add(k))?;
                    5
                }
                _ => bail!("{:#04x} starts no instruction", bits & 0xff),
            },
            (left_axis, right_axis) => {
                self.node(six(4), six(10), [left_axis as u8, right_axis as u8])?;
                2
            }
        };
        Ok(Step::Next(bytes))
    }

    fn load(&mut self, d: usize, vertex: u32) -> Result<()> {
        let Some(position) = (self.vertex_at)(vertex) else {
            bail!("vertex {vertex} is outside memory");
        };
        self.v[d] = Some(position);
        self.last = d;
        self.updated.vertices_read += 1;
        (self.event)(UpdateEvent::VertexRead { vertex })
    }

    fn leaf(&mut self, registers: [usize; 3]) -> Result<()> {
        let mut merged = Bounds::EMPTY;
        for register in registers {
            let Some(vertex) = self.v[register] else {
                bail!("v{register} is read, but nothing wrote it");
            };
            for (i, x) in vertex.into_iter().enumerate() {
                merged.lo[i] = self.arithmetic.min(merged.lo[i], x);
                merged.hi[i] = self.arithmetic.max(merged.hi[i], x);
            }
        }
        let d = match self.free_list.pop() {
            Some(register) => register,
            None => {
                self.fresh += 1;
                self.fresh - 1
            }
        };
        ensure!(d < REGISTERS, "there is no box register left");
        self.b[d] = Some(merged);
        Ok(())
    }

    fn node(&mut self, a: usize, b: usize, axes: [u8; 2]) -> Result<()> {
        ensure!(a != b, "b{a} is merged with itself");
        // `take` frees the second register; a later read of it is an error.
        let (Some(left), Some(right)) = (self.b[a], self.b[b].take()) else {
            bail!("b{a} or b{b} is read, but holds no box");
        };
        let [left_lo, left_hi] = left.interval(axes[0]);
        let [right_lo, right_hi] = right.interval(axes[1]);
        let bounds = [left_lo, left_hi, right_lo, right_hi].map(|x| self.format.to_bits(x));
        let node = self.next_node;
        self.next_node += 1;
        self.updated.nodes_written += 1;
        (self.event)(UpdateEvent::NodeWrite { node, bounds })?;

        let mut merged = left;
        for i in 0..3 {
            merged.lo[i] = self.arithmetic.min(left.lo[i], right.lo[i]);
            merged.hi[i] = self.arithmetic.max(left.hi[i], right.hi[i]);
        }
        self.b[a] = Some(merged);
        self.free_list.push(b);
        Ok(())
    }

    fn end(&mut self, r: usize, index: u32) -> Result<()> {
        let Some(whole) = self.b[r] else {
            bail!("b{r} is written as the object's box, but holds none");
        };
        let [x, y, z] = whole.lo;
        let [u, v, w] = whole.hi;
        let bounds = [x, y, z, u, v, w].map(|number| self.format.to_bits(number));
        self.updated.bounds = whole;
        (self.event)(UpdateEvent::BoxWrite { index, bounds })
    }
}
