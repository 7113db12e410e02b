//! Properties of the motion unit: one processor runs at a time, from its start until its last word is accepted; each requested row is
//! answered once, in order; each record becomes the words that hold it; no deadlock.

use super::records::{Bases, Writer};
use super::rows::Rows;
use super::{Inputs, Outputs};
use crate::bkd::bytes::ByteRecord;
use crate::hdl::properties::{assert_shown_stays, count, shown_stays};
use crate::hdl::{Builder, Bundle, Proof, Reg, Signal};
use crate::hw::memory::combiner::WORD_BYTES;
use crate::hw::plan::Plan;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub plan: &'a Plan,
    pub inputs: &'a Inputs<Signal<'b>>,
    pub outputs: &'a Outputs<Signal<'b>>,
    pub active: Reg<'b>,
    pub is_update: Reg<'b>,
    pub rows: &'a Rows<'b>,
    pub writer: &'a Writer<'b>,
    pub bases: Bases<'b>,
}

/// What the properties know of the processors.
struct Known<'b> {
    /// Whether a processor runs, and which.
    runs: Signal<'b>,
    is_update: Signal<'b>,
    /// Rows that are requested and not answered.
    owed: Signal<'b>,
}

pub(super) fn moves(unit: &Unit<'_, '_>) {
    let proof = &unit.m.proof(
        "moves",
        "one processor runs at a time; rows are answered once and in order; records become their words; no deadlock",
    );
    unit.rows.tags.keep(proof);
    let known = unit.assumed(proof);
    unit.runs(proof, &known);
    unit.answers(proof, &known);
    unit.writes(proof, &known);
    unit.covers(proof);
    unit.faults(proof);
}

impl<'b> Unit<'_, 'b> {
    fn starts(&self) -> Signal<'b> {
        self.inputs.start.valid & self.outputs.start_ready
    }

    /// What is assumed of the environment.
    fn assumed(&self, proof: &Proof<'b>) -> Known<'b> {
        let (m, units) = (self.m, &self.inputs.units);
        let (starts, asked) = (self.starts(), self.inputs.start.payload);
        let runs = proof.reg_reset("runs", 1, 0);
        let done = units.skin_done | units.update_done;
        runs.next(starts | (runs.q & !done));
        let is_update = proof.reg_reset("updates", 1, 0);
        is_update.next_when(starts, asked.is_update);
        let (of_skin, of_update) = (runs.q & !is_update.q, runs.q & is_update.q);
        let skins = units.skin_done | units.skinned.valid | units.influence.valid;
        let updates = m.or_all(&[
            units.update_done,
            units.node.valid,
            units.bounds_valid,
            units.program.valid,
        ]);
        proof.assume(
            "a processor acts only while it runs",
            skins.implies(of_skin) & updates.implies(of_update),
        );
        let offers = units.skinned.valid | units.node.valid | units.bounds_valid;
        proof.assume(
            "a processor is done when its writes are accepted",
            done.implies(!offers),
        );
        proof.assume(
            "the box comes after the nodes",
            units.bounds_valid.implies(!units.node.valid),
        );
        for (what, valid, ready, shown) in [
            (
                "vertex",
                units.skinned.valid,
                self.outputs.units.skinned_ready,
                units.skinned.payload.leaves(),
            ),
            (
                "node",
                units.node.valid,
                self.outputs.units.node_ready,
                units.node.payload.leaves(),
            ),
            (
                "box",
                units.bounds_valid,
                self.outputs.units.bounds_ready,
                vec![units.bounds],
            ),
        ] {
            let stays = shown_stays(proof, valid, ready, &shown);
            proof.assume(format!("a {what} is stable until it is accepted"), stays);
        }
        let bits = self.rows.tags.count_bits();
        let asks = units.influence.valid | units.program.valid;
        let owed = count(proof, bits, "rows_owed", asks, self.rows.leaves);
        proof.assume(
            "a processor has at most as many rows under way as there are tags",
            owed.equals(self.rows.tags.depth.into()).implies(!asks),
        );
        Known {
            runs: runs.q,
            is_update: is_update.q,
            owed,
        }
    }

    /// One processor runs at a time.
    fn runs(&self, proof: &Proof<'b>, known: &Known<'b>) {
        let (out, inputs) = (self.outputs, self.inputs);
        let writing = self.writer.valid.q;
        proof.assert(
            "one processor runs, from its start until its last word is accepted",
            (out.skinning.eq((known.runs | writing) & !self.is_update.q))
                & out.updating.eq((known.runs | writing) & self.is_update.q)
                & known.runs.eq(self.active.q)
                & known.runs.implies(known.is_update.eq(self.is_update.q)),
        );
        let busy = out.skinning | out.updating;
        let asked = inputs.start.payload.is_update;
        let ready = asked.mux(inputs.units.update_ready, inputs.units.skin_ready);
        proof.assert(
            "a start is taken when reader and processor are idle, and not before",
            out.start_ready.eq(!busy & inputs.sequence_ready & ready),
        );
        let starts = self.starts();
        proof.assert(
            "the reader starts with the processor",
            out.sequence.valid.eq(starts),
        );
        proof.assert(
            "the processor that is asked for starts, and no other",
            (starts.eq((out.units.skin.valid & inputs.units.skin_ready)
                | (out.units.update.valid & inputs.units.update_ready)))
                & out.units.skin.valid.implies(!asked)
                & out.units.update.valid.implies(asked),
        );
    }

    /// Requested rows are answered in order.
    fn answers(&self, proof: &Proof<'b>, known: &Known<'b>) {
        let (out, inputs) = (self.outputs, self.inputs);
        let influence = out.units.influence.response;
        let program = out.units.program.response;
        proof.assert(
            "the tags of rows that are not answered wait",
            known.owed.eq(self.rows.tags.count(known.owed.width())),
        );
        proof.assert(
            "a row goes to the processor that runs",
            (influence.valid | program.valid).eq(self.rows.leaves)
                & influence.valid.implies(!self.is_update.q)
                & program.valid.implies(self.is_update.q),
        );
        let tag = self.rows.tags.front;
        let width = |answer: Signal<'b>| answer.eq(tag.low(answer.width()));
        proof.assert(
            "a row has the tag that waits longest",
            self.rows.leaves.implies(
                self.rows.tags.valid & width(influence.payload.tag) & width(program.payload.tag),
            ),
        );
        proof.assert(
            "a row leaves only with a word, or with the half of one",
            self.rows
                .leaves
                .implies(inputs.word_valid | self.rows.kept.map_or(self.m.zero(1), |kept| kept.q)),
        );
        proof.assert(
            "a word is taken with a row, or as the first half of one",
            (inputs.word_valid & out.word_ready)
                .implies(self.rows.leaves | self.rows.kept.map_or(self.m.zero(1), |kept| !kept.q)),
        );
        proof.assert(
            "rows do not wait if tags and words are there",
            (self.rows.tags.valid & inputs.word_valid).implies(self.rows.leaves | out.word_ready),
        );
    }

    /// Records become words.
    fn writes(&self, proof: &Proof<'b>, known: &Known<'b>) {
        let (m, out, units) = (self.m, self.outputs, &self.inputs.units);
        let write = out.write;
        assert_shown_stays(
            proof,
            "write",
            write.valid,
            self.inputs.write_ready,
            &write.payload.leaves(),
        );
        proof.assert(
            "words are aligned",
            write
                .valid
                .implies(write.payload.address.low(WORD_BYTES.ilog2()).is_zero()),
        );
        let takes = [
            units.skinned.valid & out.units.skinned_ready,
            units.node.valid & out.units.node_ready,
            units.bounds_valid & out.units.bounds_ready,
        ];
        let second = self.writer.second.map_or(m.zero(1), |second| second.q);
        let taken = m.or_all(&takes);
        proof.assert(
            "a record is taken with its last word, and a word is stored of it",
            taken.implies(self.writer.loads)
                & (self.writer.loads & !taken).implies(!second)
                & takes[0].implies(!second | m.lit(u8::from(self.is_wide()[0]), 1)),
        );
        let offers = [units.skinned.valid, units.node.valid, units.bounds_valid];
        let wide = offers.into_iter().zip(self.is_wide());
        let wide: Vec<_> = wide
            .map(|(valid, is_wide)| valid & m.lit(u8::from(is_wide), 1))
            .collect();
        proof.assert(
            "the second word is awaited only while a record of two words is offered",
            second.implies(known.runs & m.or_all(&wide)),
        );
        let loads = proof.past(self.writer.loads & !m.reset());
        proof.assert(
            "a word is offered in the cycle after",
            loads.implies(write.valid),
        );
        let vertex = ByteRecord::vertex(self.plan.format).bytes;
        let of_vertex = proof.past(takes[0] & !m.reset());
        let index = units.skinned.payload.address;
        let scale = vertex.ilog2();
        let offset = index
            .concat(m.zero(scale))
            .extend(self.bases.vertices.width().max(index.width() + scale));
        let wanted = self.bases.vertices + offset.low(self.bases.vertices.width());
        let low = WORD_BYTES.ilog2();
        let part = |address: Signal<'b>| address.high(address.width() - low);
        proof.assert(
            "a vertex is written at its place",
            of_vertex.implies(part(write.payload.address).eq(proof.past(part(wanted)))),
        );
        let bytes = m.lit(vertex.min(WORD_BYTES), 6);
        proof.assert(
            "all bytes of a vertex are written",
            of_vertex.implies(write.payload.strobes.count_ones(6).eq(bytes)),
        );
        let of_node = proof.past(takes[1] & units.node.payload.mask.is_zero() & !m.reset());
        proof.assert(
            "nothing is written of a node without numbers",
            of_node.implies(write.payload.strobes.is_zero()),
        );
    }

    /// Whether vertices, nodes and boxes take two words.
    fn is_wide(&self) -> [bool; 3] {
        let format = self.plan.format;
        let vertex = ByteRecord::vertex(format).bytes;
        [vertex, ByteRecord::node(format).bytes, 2 * vertex].map(|bytes| bytes > WORD_BYTES)
    }

    fn covers(&self, proof: &Proof<'b>) {
        let (out, units) = (self.outputs, &self.inputs.units);
        proof.cover(
            "a mesh is skinned",
            proof.past(out.skinning) & !out.skinning,
        );
        proof.cover(
            "an object is updated",
            proof.past(out.updating) & !out.updating,
        );
        proof.cover("a row is answered", self.rows.leaves);
        proof.cover(
            "a box is written",
            units.bounds_valid & out.units.bounds_ready,
        );
    }

    fn faults(&self, proof: &Proof<'b>) {
        let (inputs, out) = (self.inputs, self.outputs);
        for (what, fault) in [
            (
                "a start is taken while the reader is busy",
                out.start_ready.reads(inputs.sequence_ready).as_value(1),
            ),
            (
                "a start is taken while a word waits to be written",
                out.start_ready.reads(self.writer.valid.q).as_value(0),
            ),
            (
                "the unit is idle before the processor is done",
                self.active.q.reads(self.active.q).as_value(0),
            ),
            (
                "the unit stays active when the processor is done",
                self.active.q.reads(inputs.units.skin_done).as_value(0),
            ),
            (
                "the unit is active after a reset",
                self.active.q.without_reset(),
            ),
            (
                "the processor of the start before is meant",
                self.is_update.q.enable().as_value(0),
            ),
            (
                "rows leave without a tag",
                self.rows.leaves.reads(self.rows.tags.valid).as_value(1),
            ),
            (
                "tags are not stored",
                self.rows.tags.push_input().as_value(0),
            ),
            (
                "a write is withdrawn",
                self.writer.valid.q.reads(inputs.write_ready).as_value(1),
            ),
            (
                "a write survives a reset",
                self.writer.valid.q.without_reset(),
            ),
            (
                "a word replaces one that waits",
                self.writer.loads.reads(inputs.write_ready).as_value(1),
            ),
        ] {
            proof.fault(what, fault);
        }
        if let Some(second) = self.writer.second {
            proof.fault(
                "the second word of a record is left out",
                second.q.fault().as_value(1),
            );
        }
    }
}
