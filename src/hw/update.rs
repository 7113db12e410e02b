//! The update processor: runs an update program (`docs/update.md`) and rewrites the bounds of all nodes of an object.
//!
//! The program never branches, so everything is known ahead, and three parts work at their own pace. Only execution
//! can wait for memory, and where it waits all later instructions do. So merges need no interlock: their distance in
//! clocks is at least the one in instructions that the program was compiled for.
//!
//! ```text
//! program rows ─► prefetch ─► window ─► decode ─┬─► instruction queue ─► execute ─► merge ─► box registers
//!                                               │                         ▲  │  └─► node queue ─► node writes
//!                                               └─► vertex prefetch ──────┘  └─► vertex registers
//! ```
//!
//! | clock, MHz | merge distance |
//! |---|---|
//! | below 70 | 4 |
//! | 70 to 119 | 5 |
//! | from 120 on | 8 |
//!
//! The reference machine's takes, as Yosys counts them for Virtex-4, 2,708 LUT4, 1,780 flip-flops, 454 RAM16X1D, which are 908 LUT4
//! more, and 14 block RAMs; no DSP48.

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
    Builder, Bundle, Flow, HdlError, Module, ReadInputs, ReadOutputs, Signal, Specs, Wires, Write,
    bits_for,
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

/// Target clock, in MHz, from which on an event has a stage of its own before it is counted.
const REGISTER_EVENTS_FROM: u32 = 120;

/// Bits of a row of the program.
const ROW_BITS: u32 = 8 * Program::ROW_BYTES as u32;

/// Bits that the window takes from a row at a time.
const WORD_BITS: u32 = 32;

/// Bytes of the window. Four more find room beside the longest instruction, of five: it never runs dry by itself.
const WINDOW_BYTES: u32 = 12;

/// Vertex indices decoded and not yet requested: enough for a load every clock.
const VERTEX_INDICES: u32 = 4;

/// The lanes of a node's write mask: its four numbers, lowest first, and above them the link word, never written.
pub const NODE_LANES: u32 = 5;
const NODE_MASK: u32 = 0b01111;

bundle! {
    /// An update: rows of its program, bases of the object's vertices and nodes, index of its box.
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
    /// What is counted since reset.
    pub struct Counters() {
        instructions: COUNTER_BITS,
        busy_cycles: COUNTER_BITS,
        stalled_cycles: COUNTER_BITS,
        vertex_wait_cycles: COUNTER_BITS,
        node_wait_cycles: COUNTER_BITS,
    }
}

bundle! {
    /// An instruction that is decoded.
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
    /// What later parts tell earlier ones.
    struct Back() {
        /// The front row has been used; the vertex in front goes to its register.
        pop_row: 1,
        pop_vertex: 1,
        /// There is room for an instruction, a vertex's index, a node.
        queue_room: 1,
        index_room: 1,
        node_room: 1,
        /// The object's box is written, which ends the update.
        box_taken: 1,
    }
}

/// An update, in the clock in which it starts.
type Start<'b> = Flow<Update<Signal<'b>>, Signal<'b>>;

fn vertex_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.update_vertex_registers))
}

fn box_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.update_box_registers))
}

interface! {
    pub (plan: &Plan) {
        in "An update: rows of its program, bases of the object's vertices and nodes, index of its box" {
            start: Flow<Update>(plan),
        }
        in "" {
            program: {ReadInputs}(
                "Program memory", "of any latency, in any order",
                bits_for(u64::from(plan.config.update_program_rows)), ROW_BITS
            ),
            vertex: {ReadInputs}(
                "Vertex memory", "of any latency, in any order",
                bits_for(u64::from(plan.config.update_vertices_ahead)), Record::vertex(plan.format).width
            ),
        }
        in "Node memory: writes" { node_write_ready: 1 }
        in "The object's box: its write, after all of the nodes'" { box_write_ready: 1 }
        out "An update: rows of its program, bases of the object's vertices and nodes, index of its box" {
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
        out "The object's box: its write, after all of the nodes'" {
            box_write: Flow<Write>(plan.address(), Record::bounding_box(plan.format).width),
        }
        out "High for a clock when an update is complete" { done: 1 }
        out "Counters since reset" { count: {Counters}() }
    }
}

/// The update processor, and what its programs must be compiled for.
pub struct UpdateProcessor {
    pub module: Arc<Module>,
    /// Its registers, and the merge distance that follows from its depth.
    pub machine: UpdateMachine,
}

/// The update processor of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<UpdateProcessor, HdlError> {
    let config = &plan.config;
    let m = Builder::new(
        "update_processor",
        "the update processor: runs an update program, which rewrites the bounds of an object's nodes.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    m.comment("What later parts tell earlier ones.");
    let back = Back::of().wires(&m, "");
    let told = back.get();

    let rows = m.part(
        "row_fetch",
        "starts updates and reads the rows of their programs ahead.",
        || {
            let (pop, ends) = (told.pop_row, told.box_taken);
            Rows::new(plan, &m, inputs.start, inputs.program, pop, ends)
        },
    )?;
    let decode = m.part(
        "instructions",
        "cuts the program's rows into instructions, one a clock.",
        || {
            let room = [told.queue_room, told.index_room];
            Decode::new(plan, &m, rows.start, rows.fetched, room)
        },
    );
    let vertices = m.part(
        "vertex_fetch",
        "reads the vertices of load instructions ahead.",
        || {
            let (load, index) = (decode.decode_load, decode.index);
            Vertices::new(plan, &m, load, index, inputs.vertex, told.pop_vertex)
        },
    )?;
    let execute = m.part(
        "execute",
        "lets the current instruction go when what it needs is there.",
        || {
            let (decoded, completed) = (decode.decode, decode.completed);
            let room = [told.node_room, told.box_taken];
            Execute::new(plan, &m, decoded, completed, vertices.fetched.valid, room)
        },
    )?;
    let p = m.pipeline();
    let (operands, merge) = m.part(
        "merge",
        "merges two boxes, or three vertices, into one box.",
        || {
            let (load_goes, vertex) = (execute.load_goes, vertices.fetched.front);
            let operands = Operands::read(plan, p, &execute.current, load_goes, vertex);
            let target = execute.current.target;
            let merge = Merge::new(plan, p, execute.merge_goes, target, &operands);
            (operands, merge)
        },
    );
    let nodes = m.part("node_write", "writes the intervals of nodes.", || {
        let ready = inputs.node_write_ready;
        Nodes::new(plan, p, rows.start, &execute, &operands, ready)
    })?;
    let end = m.part("box_write", "writes the object's box at the end.", || {
        let of_box = (&operands, &merge, &nodes);
        let ready = inputs.box_write_ready;
        End::new(plan, p, rows.start, execute.end_waits, of_box, ready)
    });
    back.drive(Back {
        pop_row: decode.pop_row,
        queue_room: execute.queue_room,
        index_room: vertices.index_room,
        pop_vertex: execute.load_goes,
        node_room: nodes.room,
        box_taken: end.box_taken,
    });

    let outputs = Outputs {
        start_ready: rows.start_ready,
        program: ReadOutputs {
            request: rows.fetched.request,
        },
        vertex: ReadOutputs {
            request: vertices.fetched.request,
        },
        node_write: nodes.write,
        box_write: end.write,
        done: end.done,
        count: counters(plan, &m, rows.running, &execute),
    };
    ports.outputs.outputs(&m, outputs);
    let machine = UpdateMachine {
        vertex_registers: config.update_vertex_registers,
        box_registers: config.update_box_registers,
        merge_distance: merge.written + 1,
    };
    let unit = Unit {
        told,
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

/// Counts, since reset, what happens in each clock.
fn counters<'b>(
    plan: &Plan,
    m: &'b Builder,
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

/// A bit a clock later, 0 after a reset.
fn later<'b>(m: &'b Builder, name: &str, bit: Signal<'b>) -> Signal<'b> {
    let register = m.reg_reset(name, 1, 0);
    register.next(bit);
    register.q
}

/// Whether an event is counted a clock later: it leaves too little of the clock for the wires to a counter.
fn counts_later(plan: &Plan) -> bool {
    plan.config.clock_mhz >= REGISTER_EVENTS_FROM
}
