//! The motion unit: skins a mesh or updates an object from memory, one at a time.
//!
//! ```text
//! start ─┬─► burst reader ─► words ─► rows ─► influences, program ─┐
//!        └─────────────────────────────────► start ────────────────┴─► skinning processor, update processor
//! writes ◄─ words ◄─ records ◄─ vertices, nodes, box ◄─────────────────────────────┘
//! ```
//!
//! The two processors never run at once, so they share the burst reader, the rows and the writer. The vertices that they read come from
//! caches.

mod properties;
mod records;
mod rows;

use crate::bkd::bytes::ByteRecord;
use crate::bkd::layout::Record;
use crate::hdl::{Builder, Flow, HdlError, Module, ReadInputs, Signal, Specs, Write, bits_for};
use crate::hw::memory::ADDRESS_BITS;
use crate::hw::memory::combiner::{WORD_BITS, WORD_BYTES, Word};
use crate::hw::memory::reader::{Sequence, WORD_ADDRESS_BITS};
use crate::hw::plan::Plan;
use crate::hw::skinning::{self, Mesh};
use crate::hw::update::{NodeWrite, Update};
use crate::{bundle, interface};
use records::Writer;
use rows::Rows;
use std::sync::Arc;

bundle! {
    /// A mesh to skin or an object to update.
    pub struct Motion(plan: &Plan) {
        is_update: 1,
        /// Byte addresses of the arrays, of the box, and of the rows.
        vertices: ADDRESS_BITS,
        nodes: ADDRESS_BITS,
        bounds: ADDRESS_BITS,
        rows_address: ADDRESS_BITS,
        /// Rows of influences or of the program.
        rows: plan.address(),
        /// Of a mesh: indices and counts.
        palette: plan.address(),
        joints: Mesh::of(plan).joints.width,
        rest: plan.address(),
        count: plan.address(),
        target: plan.address(),
        /// Of an object: indices.
        first_vertex: plan.address(),
        first_node: plan.address(),
    }
}

bundle! {
    /// The request of a row, without its address: rows are requested in order.
    pub struct RowRequest(tag_bits: u32) { tag: tag_bits }
}

bundle! {
    /// What the processors show.
    pub struct FromUnits(plan: &Plan) {
        "Skinning processor" {
            skin_ready: 1,
            skin_done: 1,
            skinned: Flow<Write>(plan.address(), Record::vertex(plan.format).width),
            influence: Flow<RowRequest>(skinning::row_tag_bits(plan)),
        }
        "Update processor" {
            update_ready: 1,
            update_done: 1,
            node: Flow<NodeWrite>(plan),
            bounds_valid: 1,
            bounds: Record::bounding_box(plan.format).width,
            program: Flow<RowRequest>(program_tag_bits(plan)),
        }
    }
}

bundle! {
    /// What the processors are given.
    pub struct ToUnits(plan: &Plan) {
        "Skinning processor" {
            skin: Flow<Mesh>(plan),
            skinned_ready: 1,
            influence: {ReadInputs}(
                "Rows of influences", "in order",
                skinning::row_tag_bits(plan), Record::influence_row(plan.format).width
            ),
        }
        "Update processor" {
            update: Flow<Update>(plan),
            node_ready: 1,
            bounds_ready: 1,
            program: {ReadInputs}("Rows of the program", "in order", program_tag_bits(plan), WORD_BITS),
        }
    }
}

interface! {
    pub (plan: &Plan) {
        in "Mesh to skin or object to update" { start: Flow<Motion>(plan) }
        in "Burst reader: whether it takes a sequence, and the words, in order" {
            sequence_ready: 1,
            word_valid: 1,
            word: WORD_BITS,
        }
        in "" { units: ..{FromUnits}(plan) }
        in "Writes" { write_ready: 1 }
        out "Mesh to skin or object to update" { start_ready: 1 }
        out "High from the cycle after the start until the last write is accepted" { skinning: 1, updating: 1 }
        out "Byte address of the vertices" { vertices: ADDRESS_BITS }
        out "Burst reader: the words to read" { sequence: Flow<Sequence>(), word_ready: 1 }
        out "" { units: ..{ToUnits}(plan) }
        out "Writes" { write: Flow<Word>() }
    }
}

/// Width of the tags of program rows.
fn program_tag_bits(plan: &Plan) -> u32 {
    bits_for(u64::from(plan.config.update_program_rows))
}

/// The environment of every part.
struct Around<'a, 'b> {
    m: &'b Builder,
    plan: &'a Plan,
    inputs: &'a Inputs<Signal<'b>>,
    /// A start is taken in this cycle.
    starts: Signal<'b>,
    /// Whether the update processor runs, not the skinning processor.
    is_update: Signal<'b>,
}

/// Describes the motion unit of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "motion_unit",
        "skins a mesh or updates an object, one at a time: hands rows to the processors, and writes their records.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let (start, asked) = (inputs.start.valid, inputs.start.payload);

    m.comment("A start is taken when the reader and the processor are idle.");
    let active = m.reg_reset("active", 1, 0);
    let busy = m.wire("busy", 1);
    let idle = (!busy.get() & inputs.sequence_ready).named("idle");
    let unit_ready = asked
        .is_update
        .mux(inputs.units.update_ready, inputs.units.skin_ready);
    let start_ready = (idle & unit_ready).named("starts_if_asked");
    let starts = (start & start_ready).named("starts");
    let is_update = m.reg("is_update", 1);
    is_update.next_when(starts, asked.is_update);
    let done = (inputs.units.skin_done | inputs.units.update_done).named("unit_done");
    active.next(starts | (active.q & !done));
    let register = |name: &str, value: Signal<'_>| {
        let register = m.reg(name, ADDRESS_BITS);
        register.next_when(starts, value);
        register.q
    };
    let bases = records::Bases {
        vertices: register("vertices_address", asked.vertices),
        nodes: register("nodes_address", asked.nodes),
        bounds: register("box_address", asked.bounds),
    };
    let around = Around {
        m: &m,
        plan,
        inputs: &inputs,
        starts,
        is_update: is_update.q,
    };
    let rows = m.part("rows", "hands rows to the processors, in order.", || {
        Rows::new(&around)
    })?;
    let writer = m.part("record_writer", "writes records as words.", || {
        Writer::new(&around, bases)
    });
    busy.drive(active.q | writer.valid.q);

    let zero = m.zero(plan.address());
    let mesh = Mesh {
        palette: asked.palette,
        joints: asked.joints,
        influences: zero,
        rows: asked.rows,
        rest: asked.rest,
        vertices: asked.count,
        target: asked.target,
    };
    let object = Update {
        program: zero,
        rows: asked.rows,
        vertex_base: asked.first_vertex,
        node_base: asked.first_node,
        box_index: zero,
    };
    let outputs = Outputs {
        start_ready,
        skinning: busy.get() & !is_update.q,
        updating: busy.get() & is_update.q,
        vertices: bases.vertices,
        sequence: Flow::new(
            starts,
            Sequence {
                address: asked.rows_address,
                words: words_of_rows(plan, asked.is_update, asked.rows),
            },
        ),
        word_ready: rows.word_ready,
        units: ToUnits {
            skin: Flow::new(start & idle & !asked.is_update, mesh),
            skinned_ready: writer.takes_vertex,
            influence: rows.influence,
            update: Flow::new(start & idle & asked.is_update, object),
            node_ready: writer.takes_node,
            bounds_ready: writer.takes_box,
            program: rows.program,
        },
        write: Flow::new(writer.valid.q, writer.word),
    };
    ports.outputs.outputs(&m, outputs);
    properties::moves(&properties::Unit {
        m: &m,
        plan,
        inputs: &inputs,
        outputs: &outputs,
        active,
        is_update,
        rows: &rows,
        writer: &writer,
        bases,
    });
    m.finish()
}

/// Words of 16 bytes of some rows: a row of a program is one word.
fn words_of_rows<'b>(plan: &Plan, is_update: Signal<'b>, rows: Signal<'b>) -> Signal<'b> {
    let m = rows.module();
    let bits = WORD_ADDRESS_BITS;
    let words = rows.extend(bits);
    let row = ByteRecord::influence_row(plan.format).bytes;
    if row == WORD_BYTES {
        return words;
    }
    let of_mesh = match row > WORD_BYTES {
        true => words.low(bits - 1).concat(m.zero(1)),
        false => (words + m.lit(1u8, bits)).high(bits - 1).extend(bits),
    };
    is_update.mux(words, of_mesh)
}
