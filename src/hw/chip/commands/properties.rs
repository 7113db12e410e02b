//! Properties of the command processor: it does one thing at a time and in the order of the list; casts, writes and invalidations are
//! waited for where they must be; errors end the list; no deadlock.

use super::{Decoded, Inputs, Outputs, States, Steps};
use crate::chip::{Limits, descriptor};
use crate::hdl::properties::{assert_shown_stays, count};
use crate::hdl::{Builder, Bundle, Proof, Reg, Signal};
use crate::hw::chip::COUNT_BITS;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    /// Bits of a byte's place in a beat.
    pub beat_bits: u32,
    /// What the numbers of descriptors are checked against.
    pub limits: Limits,
    pub inputs: &'a Inputs<Signal<'b>>,
    pub outputs: &'a Outputs<Signal<'b>>,
    pub states: &'a States<Reg<'b>>,
    pub steps: &'a Steps<Signal<'b>>,
    pub decoded: &'a Decoded<'b>,
    pub is_bad: Signal<'b>,
    pub code: Signal<'b>,
    pub value: Signal<'b>,
    /// The address of the descriptor.
    pub place: Reg<'b>,
    pub has_scene: Reg<'b>,
    pub begins: Reg<'b>,
    pub ends_list: Reg<'b>,
    pub asked: Reg<'b>,
    /// The word that a list waits for, and the counter between two reads.
    pub is_reached: Signal<'b>,
    pub rest: Reg<'b>,
}

/// What the properties know of the neighbours.
struct Around<'b> {
    /// Whether the cycle before was one without a reset.
    known: Signal<'b>,
    /// Whether beats of a burst are still to come.
    owed: Signal<'b>,
    /// Whether no word has been written since all were in memory.
    clean: Signal<'b>,
    /// Whether the caches may be invalidating themselves.
    sweeps: Signal<'b>,
}

pub(super) fn executes(unit: &Unit<'_, '_>) {
    let proof = &unit.m.proof(
        "executes",
        "one thing at a time, in the order of the list; casts, writes and caches are waited for; errors end the list; no deadlock",
    );
    let around = unit.around(proof);
    unit.one_thing(proof, &around);
    unit.waits(proof, &around);
    unit.descriptors(proof, &around);
    unit.errors(proof, &around);
    unit.ends(proof);
    unit.progress(proof, &around);
    unit.covers(proof);
    unit.faults(proof);
}

impl<'b> Unit<'_, 'b> {
    fn now(&self) -> States<Signal<'b>> {
        self.states.map(|_, state| state.q)
    }

    /// The states in which a descriptor is read, checked or executed, and no fence.
    fn in_command(&self) -> Signal<'b> {
        let now = self.now();
        self.m.or_all(&[
            now.fetches,
            now.receives,
            now.decodes,
            now.waits,
            now.fetches_box,
            now.receives_box,
            now.signals,
            now.publishes,
            now.fetches_word,
            now.receives_word,
            now.compares,
            now.rests,
        ])
    }

    fn is_last_beat(&self) -> Signal<'b> {
        self.inputs.beat.valid & self.inputs.beat.payload.last
    }

    /// What the neighbours do.
    fn around(&self, proof: &Proof<'b>) -> Around<'b> {
        let (m, inputs, out) = (self.m, self.inputs, self.outputs);
        let known = proof.reg_reset("known", 1, 0);
        known.next(m.ones(1));
        let reads = out.read.valid & inputs.read_ready;
        let owed = proof.reg_reset("owed", 1, 0);
        owed.next(reads | (owed.q & !self.is_last_beat()));
        proof.assume(
            "beats are those of accepted bursts",
            inputs.beat.valid.implies(owed.q),
        );

        let runs = proof.reg_reset("cast_runs", 1, 0);
        runs.next(out.cast_valid | (runs.q & inputs.casting));
        let started = proof.reg_reset("cast_started", 1, 0);
        started.next(out.cast_valid);
        proof.assume(
            "a cast runs from the cycle after its start, and none else runs",
            inputs.casting.implies(runs.q) & started.q.implies(inputs.casting),
        );

        let moves = inputs.skinning | inputs.updating;
        let moving = proof.reg_reset("motion_runs", 1, 0);
        let is_update = proof.reg_reset("motion_is_update", 1, 0);
        let taken = out.motion.valid & inputs.motion_ready;
        moving.next(taken | (moving.q & moves));
        is_update.next_when(taken, out.motion.payload.is_update);
        let began = proof.reg_reset("motion_began", 1, 0);
        began.next(taken);
        proof.assume(
            "a mesh or an update runs from the cycle after its start, and none else runs",
            (inputs.skinning.implies(moving.q & !is_update.q))
                & inputs.updating.implies(moving.q & is_update.q)
                & began.q.implies(moves),
        );
        proof.assume(
            "no start of a mesh or an update is taken while one runs",
            inputs.motion_ready.implies(!moves),
        );

        let clean = proof.reg_reset("clean", 1, 1);
        let written = out.write.valid & inputs.write_ready;
        clean.next(inputs.writes_done & !written & !inputs.casting & !moves);
        proof.assume(
            "writes are pending only of a cast, a mesh, an update or a signal",
            clean.q.implies(inputs.writes_done),
        );

        let sweeps = proof.reg_reset("sweeps", 1, 1);
        sweeps.next(out.invalidate | (sweeps.q & inputs.invalidating));
        let asked = proof.reg_reset("invalidated", 1, 0);
        asked.next(out.invalidate);
        proof.assume(
            "caches invalidate themselves after a reset and when they are told to",
            inputs.invalidating.implies(sweeps.q) & asked.q.implies(inputs.invalidating),
        );
        Around {
            known: known.q,
            owed: owed.q,
            clean: clean.q,
            sweeps: sweeps.q,
        }
    }

    /// The states, and what is offered in each.
    fn one_thing(&self, proof: &Proof<'b>, around: &Around<'b>) {
        let (m, inputs, out) = (self.m, self.inputs, self.outputs);
        let all: Vec<_> = self.now().leaves();
        let bits = 4;
        proof.assert(
            "the unit is in one state",
            m.concat(&all).count_ones(bits).equals(1),
        );
        let offers = [
            out.start_ready,
            out.read.valid,
            out.write.valid,
            out.cast_valid,
            out.motion.valid,
            out.flush,
            out.invalidate,
            out.ended,
        ];
        proof.assert(
            "one thing happens at a time",
            m.concat(&offers).count_ones(bits).le(m.lit(1u8, bits)),
        );
        let starts = inputs.start_valid & out.start_ready;
        let listed = count(proof, 2, "lists", starts, out.ended);
        proof.assert(
            "a list runs from its start to its end",
            out.running.extend(2).eq(listed),
        );
        let read = out.read;
        assert_shown_stays(
            proof,
            "burst",
            read.valid,
            inputs.read_ready,
            &[read.payload.address, read.payload.beats],
        );
        let write = out.write;
        assert_shown_stays(
            proof,
            "write",
            write.valid,
            inputs.write_ready,
            &write.payload.leaves(),
        );
        let now = self.now();
        proof.assert(
            "the unit receives while beats are to come",
            around
                .owed
                .eq(now.receives | now.receives_box | now.receives_word),
        );
        proof.assert(
            "a signal interrupts when its word is accepted",
            out.signalled.implies(write.valid & inputs.write_ready),
        );
    }

    /// Casts, writes and invalidations are waited for.
    fn waits(&self, proof: &Proof<'b>, around: &Around<'b>) {
        let (m, inputs, out, now) = (self.m, self.inputs, self.outputs, self.now());
        let moves = inputs.skinning | inputs.updating;
        let runs = inputs.casting | moves;
        proof.assert(
            "a cast starts when no cast runs and no mesh is skinned",
            out.cast_valid.implies(!inputs.casting & !inputs.skinning),
        );
        let motion = out.motion;
        let is_update = motion.payload.is_update;
        proof.assert(
            "a mesh starts when nothing runs, an update when no mesh and no update runs",
            motion.valid.implies(!moves) & (motion.valid & !is_update).implies(!runs),
        );
        proof.assert(
            "nothing runs while lines are flushed for a fence, caches invalidated, or no list runs",
            (now.flushes | now.invalidates | now.idle).implies(!runs),
        );
        proof.assert(
            "no cast runs while a scene is set",
            (now.fetches_box | now.receives_box).implies(!inputs.casting),
        );
        proof.assert(
            "all writes are in memory when caches are invalidated, and when no list runs",
            (now.invalidates | now.idle).implies(around.clean),
        );
        proof.assert(
            "commands are read and executed with invalid or valid caches, not between",
            (!now.idle & !now.invalidates).implies(!around.sweeps),
        );
        proof.assert(
            "the caches are asked once",
            self.asked.q.implies(now.invalidates) & out.invalidate.implies(!self.asked.q),
        );
        let flushed = proof.reg_reset("flushed", 1, 0);
        flushed.next((now.flushes & inputs.writes_done) | (flushed.q & !out.invalidate));
        let published = proof.reg_reset("published", 1, 0);
        let ends = self.steps.advances | (now.idle & inputs.start_valid);
        let written = now.publishes & inputs.writes_done;
        published.next((written | published.q) & !ends);
        proof.assert(
            "a word is read and awaited when all earlier writes were in memory",
            m.or_all(&[now.fetches_word, now.receives_word, now.compares, now.rests])
                .implies(published.q),
        );
        proof.assert(
            "a list goes on behind a wait if its word is great enough, or after an error",
            (now.compares & self.steps.advances).implies(self.is_reached | self.is_bad),
        );
        proof.assert(
            "caches are invalidated at the begin of a list, and after a flush",
            (now.invalidates & !self.asked.q).implies(self.begins.q | flushed.q),
        );
        proof.assert(
            "after a flush the caches are invalidated",
            flushed.q.implies(now.invalidates & !self.asked.q),
        );
    }

    /// A command is executed as it was checked.
    fn descriptors(&self, proof: &Proof<'b>, around: &Around<'b>) {
        let (m, out, now, decoded) = (self.m, self.outputs, self.now(), self.decoded);
        let box_read = proof.reg_reset("box_read", 1, 0);
        box_read.next(box_read.q | (now.receives_box & self.is_last_beat()));
        proof.assert(
            "there is a scene once a box has been read",
            self.has_scene.q.eq(box_read.q),
        );
        for (what, state, kind) in [
            (
                "command of a unit",
                now.waits,
                m.or_all(&[
                    decoded.is_cast,
                    decoded.is_scene,
                    decoded.is_skin,
                    decoded.is_update,
                ]),
            ),
            (
                "wait",
                m.or_all(&[
                    now.publishes,
                    now.fetches_word,
                    now.receives_word,
                    now.compares,
                    now.rests,
                ]),
                decoded.is_wait,
            ),
            ("scene", now.fetches_box, decoded.is_scene),
            ("signal", now.signals, decoded.is_signal),
        ] {
            proof.assert(
                format!("what is executed as a {what} is one without an error"),
                state.implies(kind & !decoded.fault),
            );
        }
        let cast = out.cast;
        let aligned = cast.rays_address.low(4).is_zero() & cast.cast.hits.address.low(6).is_zero();
        let count = cast.cast.rays.count;
        let in_range = count.any() & count.le(m.lit(self.limits.rays, COUNT_BITS));
        proof.assert(
            "a cast has a scene, aligned addresses and a number of rays in range",
            out.cast_valid
                .implies(self.has_scene.q & aligned & in_range),
        );
        self.motions(proof);
        let offset = descriptor::BYTES.ilog2();
        let address = out.read.payload.address;
        let of_beat = (out.read.valid & now.fetches_word)
            .implies(out.read.payload.beats.is_zero() & address.low(self.beat_bits).is_zero());
        proof.assert(
            "bursts are aligned to descriptors, and to beats for the word of a wait",
            of_beat & (out.read.valid & !now.fetches_word).implies(address.low(offset).is_zero()),
        );
        let odd = self.place.q.low(offset).any() & out.running;
        proof.assert(
            "a list at a misaligned address is not read",
            odd.implies(now.invalidates & self.begins.q & self.is_bad),
        );
        let follows = self
            .place
            .q
            .eq(proof.past(self.place.q) + m.lit(descriptor::BYTES, self.place.q.width()));
        let jumped = proof.past(now.decodes & self.decoded.is_jump);
        let first = proof.past(self.begins.q);
        let comes = now.fetches & proof.past(!now.fetches & !m.reset());
        proof.assert(
            "descriptors follow each other, but for jumps",
            (around.known & comes & !jumped & !first).implies(follows),
        );
    }

    /// A mesh and an object are those of a right descriptor.
    fn motions(&self, proof: &Proof<'b>) {
        let (m, motion) = (self.m, self.outputs.motion);
        let of = motion.payload;
        let corner_bits = self.limits.box_bytes.ilog2();
        let of_update = of.nodes.low(6).is_zero() & of.bounds.low(corner_bits).is_zero();
        let most = m.lit(self.limits.joints, of.joints.width());
        let of_skin = of.count.any() & of.joints.any() & of.joints.le(most);
        let both = of.vertices.low(6).is_zero() & of.rows_address.low(4).is_zero() & of.rows.any();
        proof.assert(
            "a mesh and an object have aligned addresses and counts in range",
            motion
                .valid
                .implies(both & of.is_update.mux(of_update, of_skin)),
        );
        let kind = of
            .is_update
            .mux(self.decoded.is_update, self.decoded.is_skin);
        proof.assert(
            "what starts is what the descriptor asks for",
            motion.valid.implies(kind & !self.decoded.fault),
        );
    }

    /// The first error is kept, and ends the list.
    fn errors(&self, proof: &Proof<'b>, around: &Around<'b>) {
        let (m, inputs, out, now) = (self.m, self.inputs, self.outputs, self.now());
        let kept = proof.past(out.running & self.is_bad & !m.reset());
        let same = self.code.eq(proof.past(self.code)) & self.value.eq(proof.past(self.value));
        proof.assert("the first error is kept", kept.implies(same));
        let fails = inputs.bus_error_valid & out.running & !self.is_bad;
        let address = proof.past(inputs.bus_error_address);
        proof.assert(
            "an error of the bus is kept with its address",
            proof
                .past(fails & !m.reset())
                .implies(self.code.equals(descriptor::Fault::BUS.into()) & self.value.eq(address)),
        );
        let refused = proof.past(now.decodes & (self.decoded.fault | self.is_bad) & !m.reset());
        proof.assert(
            "a refused descriptor, and one after an error, is followed by a fence",
            refused.implies(now.drains & self.is_bad & self.ends_list.q),
        );
        let end = out.ended & self.is_bad;
        proof.assert(
            "a failure is shown as it is kept",
            end.implies(
                out.failure.code.eq(self.code)
                    & out.failure.value.eq(self.value)
                    & out.failure.descriptor.eq(self.place.q),
            ),
        );
        proof.assert(
            "no error is left of an earlier list, but that of the address",
            (around.known & proof.past(inputs.start_valid & out.start_ready)).implies(
                self.is_bad
                    .eq(proof.past(inputs.start_address.low(descriptor::BYTES.ilog2()).any())),
            ),
        );
    }

    /// A list ends at its end or with an error.
    fn ends(&self, proof: &Proof<'b>) {
        let (inputs, out, now) = (self.inputs, self.outputs, self.now());
        let starts = inputs.start_valid & out.start_ready;
        let end_read = proof.reg_reset("end_read", 1, 0);
        end_read.next((now.decodes & self.decoded.is_end) | (end_read.q & !starts));
        proof.assert(
            "a list ends after its end, or with an error",
            out.ended.implies(end_read.q | self.is_bad),
        );
        proof.assert(
            "the flag of the end is that of an end or of an error",
            (out.running & self.ends_list.q).implies(end_read.q | self.is_bad),
        );
        proof.assert(
            "nothing is read behind an end",
            (out.running & end_read.q).implies(self.ends_list.q & !self.in_command()),
        );
        proof.assert(
            "commands are executed between begin and end",
            self.in_command()
                .implies(!self.begins.q & !self.ends_list.q),
        );
        proof.assert(
            "a list begins with invalid caches",
            (out.running & self.begins.q).implies(now.invalidates & !self.ends_list.q),
        );
    }

    /// In every state the unit goes on, or waits for a neighbour.
    fn progress(&self, proof: &Proof<'b>, around: &Around<'b>) {
        let (m, inputs, out, now) = (self.m, self.inputs, self.outputs, self.now());
        let waits = [
            now.idle & !inputs.start_valid,
            out.read.valid & !inputs.read_ready,
            around.owed & !self.is_last_beat(),
            out.write.valid & !inputs.write_ready,
            (now.waits | now.drains) & (inputs.casting | inputs.skinning | inputs.updating),
            out.motion.valid & !inputs.motion_ready,
            (now.flushes | now.publishes) & !inputs.writes_done,
            now.invalidates & self.asked.q & inputs.invalidating,
        ];
        let mut all = now.leaves();
        all.extend([self.asked.q, self.rest.q]);
        let state = m.concat(&all);
        let stays = around.known & state.eq(proof.past(state));
        proof.assert(
            "the unit goes on, or waits for a list, the bus, a unit, writes or caches",
            stays.implies(proof.past(m.or_all(&waits))),
        );
    }

    fn covers(&self, proof: &Proof<'b>) {
        let (out, now) = (self.outputs, self.now());
        let fenced = proof.past(now.invalidates & !self.begins.q);
        proof.cover("a cast starts", out.cast_valid);
        proof.cover("a list goes on after a fence", now.fetches & fenced);
        let motion = out.motion;
        proof.cover("a mesh starts", motion.valid & !motion.payload.is_update);
        let beside = motion.valid & motion.payload.is_update & self.inputs.casting;
        proof.cover("an update starts while a cast runs", beside);
        proof.cover("a word is great enough", now.compares & self.is_reached);
        proof.cover("a list ends without an error", out.ended & !self.is_bad);
        let odd = self.place.q.low(1).any();
        proof.cover("a list at a misaligned address ends", out.ended & odd);
    }

    fn faults(&self, proof: &Proof<'b>) {
        let (inputs, states, steps) = (self.inputs, self.states, self.steps);
        for (what, fault) in [
            (
                "a cast starts while another runs",
                steps.cast_starts.reads(inputs.casting).as_value(0),
            ),
            (
                "a cast starts while a mesh is skinned",
                steps.cast_starts.reads(inputs.skinning).as_value(0),
            ),
            (
                "a mesh or an update is not waited for",
                states.flushes.q.reads(inputs.updating).as_value(0),
            ),
            (
                "a mesh starts while a cast runs",
                self.outputs.motion.valid.reads(inputs.casting).as_value(0),
            ),
            (
                "an update starts while another runs",
                self.outputs.motion.valid.reads(inputs.updating).as_value(0),
            ),
            (
                "a word is read before the writes are in memory",
                states.fetches_word.q.reads(inputs.writes_done).as_value(1),
            ),
            (
                "a wait ends with a word that is too small",
                steps.wait_ends.reads(self.is_reached).as_value(1),
            ),
            (
                "a list does not rest between two reads of a word",
                states.rests.q.fault().as_value(0),
            ),
            (
                "a scene is set while a cast runs",
                steps.scene_starts.reads(inputs.casting).as_value(0),
            ),
            (
                "a fence does not wait for the cast",
                states.flushes.q.reads(inputs.casting).as_value(0),
            ),
            (
                "a fence does not wait for the writes",
                states.invalidates.q.reads(inputs.writes_done).as_value(1),
            ),
            (
                "a list does not wait for the caches",
                states.fetches.q.reads(inputs.invalidating).as_value(0),
            ),
            (
                "the caches are never invalidated",
                steps.asks_to_invalidate.fault().as_value(0),
            ),
            (
                "a jump to a misaligned address is executed",
                steps.jumps.reads(self.decoded.fault).as_value(0),
            ),
            (
                "a list at a misaligned address is read",
                self.code.reads(inputs.start_address).as_value(0),
            ),
            ("a scene survives a reset", self.has_scene.q.without_reset()),
            (
                "a state survives a reset",
                states.receives.q.without_reset(),
            ),
            (
                "a later error replaces the first",
                self.value.enable().as_value(1),
            ),
            (
                "errors of the bus do not count",
                self.code.reads(inputs.bus_error_valid).as_value(0),
            ),
            (
                "a jump is executed after an error",
                steps.jumps.reads(self.is_bad).as_value(0),
            ),
            (
                "a burst is withdrawn",
                states.fetches.q.reads(inputs.read_ready).as_value(1),
            ),
            (
                "a signal is withdrawn",
                states.signals.q.reads(inputs.write_ready).as_value(1),
            ),
            (
                "a descriptor is checked before its last beat",
                states.decodes.q.reads(inputs.beat.payload.last).as_value(1),
            ),
            (
                "a list goes on behind its end",
                self.ends_list.q.reads(self.decoded.is_end).as_value(0),
            ),
            (
                "every descriptor jumps",
                self.place.q.reads(steps.jumps).as_value(1),
            ),
        ] {
            proof.fault(what, fault);
        }
    }
}
