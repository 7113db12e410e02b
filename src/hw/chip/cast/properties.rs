//! Properties of the cast unit: what its two parts assume of each other holds. The parts are known here by what their own proofs say.

use super::{Inputs, Outputs};
use crate::hdl::{Builder, Signal};
use crate::hw::chip::{COUNT_BITS, hits, rays};
use crate::hw::plan::Plan;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub plan: &'a Plan,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub reader: rays::Outputs<Signal<'b>>,
    pub writer: hits::Outputs<Signal<'b>>,
    /// What the reader is told.
    pub hold: Signal<'b>,
}

/// The greatest number of rays of a cast, as `docs/chip.md` states.
const MOST_RAYS: u32 = 1 << 26;

pub(super) fn joins(unit: &Unit<'_, '_>) {
    let (m, inputs, outputs) = (unit.m, &unit.inputs, &unit.outputs);
    let (reader, writer, start) = (&unit.reader, &unit.writer, inputs.start);
    let proof = &m.proof(
        "joins",
        "a cast runs until its rays have left and its hits are written; a packet that is not held stays so",
    );
    // Rays of the cast, with inactive ones; those that have left, and the hits that have come.
    let counter = |name: &str, steps: Signal<'_>| {
        let register = proof.reg_reset(name, COUNT_BITS, 0);
        let next = register.q + steps.extend(COUNT_BITS);
        register.next(start.valid.mux(m.zero(COUNT_BITS), next));
        register.q
    };
    let sent = counter("sent", outputs.ray.valid & inputs.ray_ready);
    let came = counter("came", inputs.hit.valid & outputs.hit_ready);
    let asked = start.payload.rays.count;
    let slots = unit.plan.ray_bits();
    let up = asked + m.lit(unit.plan.rays() - 1, COUNT_BITS);
    let all = proof.reg_reset("all", COUNT_BITS, 0);
    all.next_when(
        start.valid,
        up.high(COUNT_BITS - slots).concat(m.zero(slots)),
    );
    let due = came.ne(all.q);
    proof.assume(
        "a cast starts while none runs",
        start.valid.implies(!outputs.casting),
    );
    proof.assume(
        "a cast has a ray, and no more than are allowed",
        (start.valid).implies(asked.any() & asked.le(m.lit(MOST_RAYS, COUNT_BITS))),
    );
    proof.assume(
        "a hit is that of a ray that has left",
        inputs.hit.valid.implies(came.lt(sent)),
    );
    proof.assume(
        "the reader works until all rays have left, and offers none behind them",
        reader.running.eq(sent.ne(all.q)) & reader.ray.valid.implies(reader.running),
    );
    proof.assume(
        "the writer is idle only when all hits have come",
        (!writer.running).implies(!due),
    );
    let same = reader.packet.eq(proof.past(reader.packet));
    let free = proof.past(!m.reset() & due & !writer.hold);
    proof.assume(
        "the writer does not hold a packet later, while hits are to come",
        (free & due & same).implies(!writer.hold),
    );

    proof.assert(
        "no more hits come than rays leave, and no more rays than the cast has",
        came.le(sent) & sent.le(all.q),
    );
    proof.assert(
        "the writer works while rays leave",
        reader.running.implies(writer.running & due),
    );
    let free = proof.past(!m.reset() & reader.running & !unit.hold);
    proof.assert(
        "the reader is not told later to hold a packet",
        (free & reader.running & same).implies(!unit.hold),
    );
    proof.assert(
        "no part works when no cast runs",
        (!outputs.casting).implies(!reader.running & !writer.running & !due),
    );
    proof.assert(
        "a cast runs from its start on",
        proof
            .past(!m.reset() & start.valid)
            .implies(outputs.casting),
    );
    proof.cover(
        "the last hit comes after the last ray has left",
        inputs.hit.valid & outputs.hit_ready & came.equals(3) & all.q.equals(4),
    );
    proof.fault(
        "no cast is shown while hits are written",
        outputs.casting.reads(writer.running).as_value(0),
    );
    proof.fault(
        "the reader is told a cycle late to hold a packet",
        unit.hold.fault().one_clock_late(),
    );
}
