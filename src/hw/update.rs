//! The update processor: runs an update program (`docs/update.md`) and rewrites the bounds of all nodes of an object.
//!
//! The program has no branches, so all reads can be prefetched, and three parts work independently. Only execution waits for
//! memory, and it then stalls all later instructions. So merges need no interlock: their distance in cycles is at least the
//! merge distance in instructions for which the program is compiled.
//!
//! ```text
//! program rows ─► prefetch ─► window ─► decode ─┬─► instruction queue ─► execute ─► merge ─► box registers
//!                                               │                         ▲  │  └─► node queue ─► node writes
//!                                               └─► vertex prefetch ──────┘  └─► vertex registers
//! ```
//!
//! Each part has a file: `fetch` (program rows and vertices), `decode`, `execute`, `merge` (with the registers) and `write`. A part
//! takes the results of earlier parts, and the signals of later parts through `Back`.
//!
//! | clock, MHz | merge distance |
//! |---|---|
//! | below 70 | 4 |
//! | 70 to 119 | 5 |
//! | 120 and above | 8 |
//!
//! Its area in the reference machine is in `docs/numbers.md`.

mod decode;
mod execute;
mod fetch;
mod merge;
mod properties;
mod write;

use super::plan::Plan;
use super::raycast::COUNTER_BITS;
use crate::bkd::layout::Record;
use crate::hdl::{
    Builder, Bundle, Flow, HdlError, Module, Pipeline, ReadInputs, ReadOutputs, Signal, Specs,
    Wires, Write, bits_for,
};
use crate::program::{Program, UpdateMachine};
use crate::{bundle, interface};
use decode::Decode;
use execute::Execute;
use fetch::{Rows, Vertices};
use merge::{Merge, Operands};
use properties::Unit;
use std::sync::Arc;
use write::{End, Nodes};

/// Width of a row of the program.
const ROW_BITS: u32 = 8 * Program::ROW_BYTES as u32;

/// Width of the words by which the window is refilled.
const WORD_BITS: u32 = 32;

/// Bytes of the window. It has room for a refill of four bytes in addition to the longest instruction (five bytes), so decoding never waits for a refill if rows are available.
const WINDOW_BYTES: u32 = 12;

/// Maximum number of vertex indices that are decoded and not yet requested: enough for one load per cycle.
const VERTEX_INDICES: u32 = 4;

/// The lanes of a node's write mask: its four numbers, lowest first, then the link word, which is never written.
pub const NODE_LANES: u32 = 5;
const NODE_MASK: u32 = 0b01111;

bundle! {
    /// An update command: rows of its program, bases of the object's vertices and nodes, index of its box.
    pub struct Update(plan: &Plan) {
        program: plan.address(),
        rows: plan.address(),
        vertex_base: plan.address(),
        node_base: plan.address(),
        box_index: plan.address(),
    }
}

bundle! {
    /// A write of some lanes of a node.
    pub struct NodeWrite(plan: &Plan) {
        address: plan.address(),
        mask: NODE_LANES,
        data: Record::node(plan.format).width,
    }
}

bundle! {
    /// The counters since reset.
    pub struct Counters() {
        instructions: COUNTER_BITS,
        busy_cycles: COUNTER_BITS,
        stalled_cycles: COUNTER_BITS,
        vertex_wait_cycles: COUNTER_BITS,
        node_wait_cycles: COUNTER_BITS,
    }
}

bundle! {
    /// A decoded instruction.
    struct Instruction(plan: &Plan) {
        load: 1,
        leaf: 1,
        node: 1,
        end: 1,
        /// A vertex or box register.
        x: vertex_bits(plan).max(box_bits(plan)),
        y: vertex_bits(plan).max(box_bits(plan)),
        /// A vertex register, or a node's two axes.
        z: vertex_bits(plan).max(4),
        target: box_bits(plan),
    }
}

bundle! {
    /// The signals from later parts to earlier ones.
    struct Back() {
        /// Removes the front row, which has been used, and the front vertex, which is written to its register.
        pop_row: 1,
        pop_vertex: 1,
        /// There is room for an instruction, a vertex index, a node.
        queue_room: 1,
        index_room: 1,
        node_room: 1,
        /// The object's box is accepted, which ends the update.
        box_taken: 1,
    }
}

/// The environment of every part: the inputs of the unit, the signals from later parts, and the description.
struct Around<'b> {
    plan: &'b Plan,
    m: &'b Builder,
    /// The pipeline of merges.
    p: Pipeline<'b>,
    inputs: Inputs<Signal<'b>>,
    told: Back<Signal<'b>>,
}

/// An update, in the cycle of its start.
type Start<'b> = Flow<Update<Signal<'b>>, Signal<'b>>;

fn vertex_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.update_vertex_registers))
}

fn box_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.update_box_registers))
}

interface! {
    pub (plan: &Plan) {
        in "Update: rows of its program, bases of the object's vertices and nodes, index of its box" {
            start: Flow<Update>(plan),
        }
        in "" {
            program: {ReadInputs}(
                "Program memory", "any latency, any order",
                bits_for(u64::from(plan.config.update_program_rows)), ROW_BITS
            ),
            vertex: {ReadInputs}(
                "Vertex memory", "any latency, any order",
                bits_for(u64::from(plan.config.update_vertices_ahead)), Record::vertex(plan.format).width
            ),
        }
        in "Node memory: writes" { node_write_ready: 1 }
        in "Object's box: write, after the writes of all nodes" { box_write_ready: 1 }
        out "Update: rows of its program, bases of the object's vertices and nodes, index of its box" {
            start_ready: 1,
        }
        out "" {
            program: {ReadOutputs}(
                "Program memory", plan.address(), bits_for(u64::from(plan.config.update_program_rows))
            ),
            vertex: {ReadOutputs}(
                "Vertex memory", plan.address(), bits_for(u64::from(plan.config.update_vertices_ahead))
            ),
        }
        out "Node memory: writes" {
            node_write: Flow<NodeWrite>(plan),
        }
        out "Object's box: write, after the writes of all nodes" {
            box_write: Flow<Write>(plan.address(), Record::bounding_box(plan.format).width),
        }
        out "High for one cycle when an update is complete" { done: 1 }
        out "Counters since reset" { count: {Counters}() }
    }
}

/// The update processor, and the machine parameters for the compiler of its programs.
pub struct UpdateProcessor {
    pub module: Arc<Module>,
    /// Its number of registers, and the merge distance, which follows from its pipeline depth.
    pub machine: UpdateMachine,
}

/// Describes the update processor of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<UpdateProcessor, HdlError> {
    let m = Builder::new(
        "update_processor",
        "the update processor: runs an update program, which rewrites the bounds of an object's nodes.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    m.comment("Signals from later parts to earlier ones.");
    let back = Back::of().wires(&m, "");
    let told = back.get();
    let around = Around {
        plan,
        m: &m,
        p: m.pipeline(),
        inputs,
        told,
    };

    let rows = m.part(
        "row_fetch",
        "starts updates and prefetches the rows of their programs.",
        || Rows::new(&around),
    )?;
    let decode = m.part(
        "instructions",
        "decodes the rows of the program into instructions, one per cycle.",
        || Decode::new(&around, &rows),
    );
    let vertices = m.part(
        "vertex_fetch",
        "prefetches the vertices of load instructions.",
        || Vertices::new(&around, &decode),
    )?;
    let execute = m.part(
        "execute",
        "issues the current instruction when its operands are available.",
        || Execute::new(&around, &decode, &vertices),
    )?;
    let (operands, merge) = m.part(
        "merge",
        "merges two boxes, or three vertices, into one box.",
        || {
            let operands = Operands::read(&around, &execute, &vertices);
            let merge = Merge::new(&around, &execute, &operands);
            (operands, merge)
        },
    );
    let nodes = m.part("node_write", "writes the intervals of nodes.", || {
        Nodes::new(&around, rows.start, &execute, &operands)
    })?;
    let end = m.part("box_write", "writes the object's box at the end.", || {
        End::new(&around, rows.start, &execute, &operands, &merge, &nodes)
    });
    back.drive(Back {
        pop_row: decode.window.pop_row,
        queue_room: execute.in_flight.room,
        index_room: vertices.indices_in_flight.room,
        pop_vertex: execute.load_goes,
        node_room: nodes.in_flight.room,
        box_taken: end.box_taken,
    });

    let outputs = Outputs {
        start_ready: rows.start_ready,
        program: ReadOutputs {
            request: rows.reader.request,
        },
        vertex: ReadOutputs {
            request: vertices.reader.request,
        },
        node_write: nodes.write,
        box_write: end.write,
        done: end.done,
        count: counters(&around, rows.running, &execute),
    };
    ports.outputs.outputs(&m, outputs);
    let machine = UpdateMachine {
        vertex_registers: plan.config.update_vertex_registers,
        box_registers: plan.config.update_box_registers,
        merge_distance: merge.written + 1,
    };
    let unit = Unit {
        around,
        rows,
        decode,
        vertices,
        execute,
        nodes,
        end,
    };
    properties::credit(&m, &unit);
    Ok(UpdateProcessor {
        module: m.finish()?,
        machine,
    })
}

/// Counts events since reset.
fn counters<'b>(
    &Around { plan, m, .. }: &Around<'b>,
    running: Signal<'b>,
    execute: &Execute<'b>,
) -> Counters<Signal<'b>> {
    m.comment("Counters since reset.");
    let events = Counters {
        instructions: execute.goes,
        busy_cycles: running,
        stalled_cycles: running & !execute.goes,
        vertex_wait_cycles: execute.missing_vertex,
        node_wait_cycles: execute.missing_room,
    };
    events.map(|name, event| {
        let event = match counts_later(plan) {
            false => event,
            true => later(m, &format!("{name}_event"), event),
        };
        let counter = m.reg_reset(format!("{name}_counter"), COUNTER_BITS, 0);
        counter.next_when(event, counter.q + m.lit(1u8, COUNTER_BITS));
        counter.q
    })
}

/// Delays a bit by one cycle; it is 0 after a reset.
fn later<'b>(m: &'b Builder, name: &str, bit: Signal<'b>) -> Signal<'b> {
    let register = m.reg_reset(name, 1, 0);
    register.next(bit);
    register.q
}

/// Whether events have a register before their counters: they leave too little of the cycle for the wires to a counter.
fn counts_later(plan: &Plan) -> bool {
    plan.timing.event
}
