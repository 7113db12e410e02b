//! Properties of the register file: every access has one response, a read returns its register, a write changes its bytes alone, no
//! doorbell and no interrupt is lost.

use super::{Control, Inputs, Outputs, WINDOW_BITS, WriteAccess};
use crate::chip::registers::{COUNTERS, interrupt, offset};
use crate::hdl::properties::{assert_shown_stays, count};
use crate::hdl::{Builder, Proof, Reg, Signal};
use std::collections::BTreeMap;

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub inputs: &'a Inputs<Signal<'b>>,
    pub outputs: &'a Outputs<Signal<'b>>,
    pub write: &'a WriteAccess<'b>,
    pub responds: Reg<'b>,
    /// The address of the read whose word is selected.
    pub address: Reg<'b>,
    pub selects: Reg<'b>,
    pub control: &'a Control<'b>,
    /// The words that are read, by offset.
    pub words: &'a BTreeMap<u32, Signal<'b>>,
    pub copies: &'a [(Reg<'b>, Signal<'b>)],
}

pub(super) fn serves(unit: &Unit<'_, '_>) {
    let proof = &unit.m.proof(
        "serves",
        "every access has one response; reads return their register; no doorbell and no interrupt is lost",
    );
    // Whether the cycle before was one without a reset: what it had can be compared with.
    let known = proof.reg_reset("known", 1, 0);
    known.next(unit.m.ones(1));
    unit.accesses(proof);
    unit.reads(proof);
    unit.writes(proof, known.q);
    unit.lists(proof, known.q);
    unit.interrupts(proof, known.q);
    unit.counters(proof, known.q);
    unit.faults(proof);
}

impl<'b> Unit<'_, 'b> {
    /// The handshakes of the bus.
    fn accesses(&self, proof: &Proof<'b>) {
        let (bus, out) = (self.inputs.s_axi, self.outputs.s_axi);
        assert_shown_stays(proof, "response", out.bvalid, bus.bready, &[out.bresp]);
        assert_shown_stays(
            proof,
            "read datum",
            out.rvalid,
            bus.rready,
            &[out.rdata, out.rresp],
        );
        proof.assert(
            "address and data of a write are accepted together",
            out.awready.eq(out.wready) & out.awready.implies(bus.awvalid & bus.wvalid),
        );
        proof.assert(
            "a write waits only for the response to the one before",
            (bus.awvalid & bus.wvalid & !out.bvalid).implies(out.awready),
        );
        let writes = bus.awvalid & out.awready;
        let owed = count(proof, 2, "owed_responses", writes, out.bvalid & bus.bready);
        proof.assert(
            "a response is shown for each write",
            out.bvalid.extend(2).eq(owed),
        );
        let reads = bus.arvalid & out.arready;
        let owed = count(proof, 2, "owed_data", reads, out.rvalid & bus.rready);
        proof.assert(
            "a datum is shown for each read, in the second cycle",
            owed.eq(self.selects.q.extend(2) + out.rvalid.extend(2)),
        );
        proof.assert(
            "a read is refused only while one is under way",
            out.arready.eq(owed.is_zero()) & !owed.bit(1),
        );
        proof.cover(
            "a write and a read are answered at once",
            out.bvalid & bus.bready & out.rvalid & bus.rready,
        );
    }

    /// What is read of each register, and elsewhere.
    fn reads(&self, proof: &Proof<'b>) {
        let rdata = self.outputs.s_axi.rdata;
        let selected = proof.past(self.selects.q & !self.m.reset());
        let word = proof.past(self.address.q.high(WINDOW_BITS - 2));
        let is = |offset: u32| selected & word.equals((offset / 4).into());
        for (offset, value) in self.words {
            proof.assert(
                format!("a read at {offset:#05x} returns the register"),
                is(*offset).implies(rdata.eq(proof.past(*value))),
            );
        }
        let any: Vec<_> = self.words.keys().map(|offset| is(*offset)).collect();
        proof.assert(
            "a read of no register returns 0",
            (selected & !self.m.or_all(&any)).implies(rdata.is_zero()),
        );
    }

    /// What was written in the cycle before to a register.
    fn written(&self, proof: &Proof<'b>, offset: u32) -> Signal<'b> {
        let bus = self.inputs.s_axi;
        let valid = bus.awvalid & self.outputs.s_axi.awready;
        let word = bus.awaddr.high(WINDOW_BITS - 2);
        proof.past(valid & word.equals((offset / 4).into()) & !self.m.reset())
    }

    /// Each byte of a stored register is as it was last written.
    fn writes(&self, proof: &Proof<'b>, known: Signal<'b>) {
        let bus = self.inputs.s_axi;
        let (data, strobes) = (proof.past(bus.wdata), proof.past(bus.wstrb));
        for (name, offset, register) in [
            ("LIST", offset::LIST, self.control.list.q),
            (
                "INTERRUPT_ENABLE",
                offset::INTERRUPT_ENABLE,
                self.control.enable.q,
            ),
        ] {
            let before = proof.past(register);
            let written = self.written(proof, offset);
            for byte in 0..register.width().div_ceil(8) {
                let width = (register.width() - 8 * byte).min(8);
                let of = |word: Signal<'b>| word.field(8 * byte, width);
                let changes = written & strobes.bit(byte);
                proof.assert(
                    format!("byte {byte} of {name} is changed by its strobe alone"),
                    known.implies(of(register).eq(changes.mux(of(data), of(before)))),
                );
            }
        }
    }

    /// Doorbells, the queued list, and how a list has ended.
    fn lists(&self, proof: &Proof<'b>, known: Signal<'b>) {
        let (m, control, inputs) = (self.m, self.control, self.inputs);
        let (valid, address) = (self.outputs.start_valid, self.outputs.start_address);
        let rings = self.written(proof, offset::DOORBELL);
        let [was_valid, started] = [valid, valid & inputs.start_ready].map(|s| proof.past(s));
        proof.assert(
            "a doorbell queues a list, which waits until it starts",
            known.implies(valid.eq(rings & !was_valid | (was_valid & !started))),
        );
        let list = proof.past(control.list.q);
        proof.assert(
            "the queued list is the one at the doorbell",
            (rings & !was_valid).implies(address.eq(list)),
        );
        proof.assert(
            "a queued list stays the same",
            (known & was_valid).implies(address.eq(proof.past(address))),
        );
        proof.assert(
            "a doorbell behind a queued list is an overrun",
            (rings & was_valid).implies(control.pending.q.bit(interrupt::OVERRUN)),
        );
        proof.assert(
            "no error is shown once a list has started",
            (known & started).implies(control.code.q.is_zero()),
        );
        let ended = proof.past(inputs.ended & !m.reset());
        let failure = inputs.failure;
        let shown = control.code.q.eq(proof.past(failure.code))
            & control.descriptor.q.eq(proof.past(failure.descriptor))
            & control.value.q.eq(proof.past(failure.value));
        proof.assert(
            "the end of a list is shown with its error",
            (ended & !started).implies(shown),
        );
        let stays = |register: Signal<'b>| register.eq(proof.past(register));
        proof.assert(
            "an error is shown until a list starts or ends",
            (known & !started & !ended).implies(stays(control.code.q)),
        );
        proof.assert(
            "the descriptor and the value of an error are shown until a list ends",
            (known & !ended).implies(stays(control.descriptor.q) & stays(control.value.q)),
        );
        proof.cover(
            "a doorbell has no effect while a queued list starts",
            rings & started,
        );
    }

    /// Each bit of the status is set by its event and cleared by its 1 alone.
    fn interrupts(&self, proof: &Proof<'b>, known: Signal<'b>) {
        let (inputs, pending) = (self.inputs, self.control.pending.q);
        let cleared =
            self.written(proof, offset::INTERRUPT_STATUS) & proof.past(inputs.s_axi.wstrb.bit(0));
        let failed = inputs.failure.code.any();
        let rings = self.written(proof, offset::DOORBELL);
        let events = [
            ("end", interrupt::END, proof.past(inputs.ended & !failed)),
            ("signal", interrupt::SIGNAL, proof.past(inputs.signalled)),
            ("error", interrupt::ERROR, proof.past(inputs.ended & failed)),
            (
                "overrun",
                interrupt::OVERRUN,
                rings & proof.past(self.outputs.start_valid),
            ),
        ];
        for (name, bit, event) in events {
            let clears = cleared & proof.past(inputs.s_axi.wdata.bit(bit));
            let before = proof.past(pending.bit(bit));
            proof.assert(
                format!("{name} is pending from its event until it is cleared"),
                known.implies(pending.bit(bit).eq(event | (before & !clears))),
            );
        }
        let control = self.control;
        let stored = [
            pending,
            control.enable.q,
            control.list.q,
            control.code.q,
            control.descriptor.q,
            control.value.q,
        ];
        let copies = self.copies.iter().map(|(copy, _)| copy.q);
        let any: Vec<_> = stored.into_iter().chain(copies).map(|q| q.any()).collect();
        proof.assert(
            "all registers are 0 after a reset",
            known | !self.m.or_all(&any),
        );
        // Bit by bit: not the expression of the output, which a fault would change here too.
        let enabled = |bit: u32| pending.bit(bit) & control.enable.q.bit(bit);
        let enabled: Vec<_> = (0..interrupt::COUNT).map(enabled).collect();
        proof.assert(
            "the interrupt is high while an enabled event is pending",
            self.outputs.irq.eq(self.m.or_all(&enabled)),
        );
        proof.cover(
            "the interrupt ends",
            known & proof.past(self.outputs.irq) & !self.outputs.irq,
        );
    }

    /// The copies are those of one cycle.
    fn counters(&self, proof: &Proof<'b>, known: Signal<'b>) {
        let snapshot = self.written(proof, offset::SNAPSHOT);
        let names = COUNTERS.iter().map(|(name, _)| *name);
        for (name, (copy, count)) in names.zip(self.copies) {
            let taken = snapshot.mux(proof.past(*count), proof.past(copy.q));
            proof.assert(
                format!("the copy of {name} is that of the last snapshot"),
                known.implies(copy.q.eq(taken)),
            );
        }
        proof.cover("a snapshot is taken", snapshot);
    }

    fn faults(&self, proof: &Proof<'b>) {
        let control = self.control;
        let rdata = self.outputs.s_axi.rdata;
        let (copy, _) = &self.copies[0];
        for (what, fault) in [
            (
                "a response is withdrawn",
                self.responds.q.reads(self.inputs.s_axi.bready).as_value(1),
            ),
            (
                "a read datum follows the registers while it waits",
                rdata.enable().as_value(1),
            ),
            (
                "a write does not wait for the response before",
                self.write.valid.reads(self.responds.q).as_value(0),
            ),
            (
                "a read selects the register beside",
                rdata.reads(self.address.q).with_flipped(1 << 2),
            ),
            (
                "a strobe does not count",
                control
                    .list
                    .q
                    .reads(self.write.strobes)
                    .with_flipped(1 << 1),
            ),
            (
                "a doorbell replaces the queued list",
                control.next.q.enable().as_value(1),
            ),
            (
                "a queued list is forgotten",
                control.queued.q.reads(self.inputs.start_ready).as_value(1),
            ),
            (
                "a started list leaves the error of the last one",
                control.code.q.reads(self.inputs.ended).as_value(1),
            ),
            (
                "the wrong value is not kept",
                control.value.q.enable().as_value(1),
            ),
            (
                "a signal does not interrupt",
                control.pending.q.reads(self.inputs.signalled).as_value(0),
            ),
            (
                "a failed list ends without an error",
                control
                    .pending
                    .q
                    .reads(self.inputs.failure.code)
                    .as_value(0),
            ),
            (
                "an interrupt is not cleared",
                control.pending.q.reads(self.write.data).as_value(0),
            ),
            (
                "the interrupt does not ask whether it is enabled",
                self.outputs.irq.reads(control.enable.q).as_value(15),
            ),
            (
                "events are pending after a reset",
                control.pending.q.without_reset(),
            ),
            ("a reset leaves the list", control.list.q.without_reset()),
            ("a reset leaves the copies", copy.q.without_reset()),
            (
                "a copy is taken in every cycle",
                copy.q.enable().as_value(1),
            ),
        ] {
            proof.fault(what, fault);
        }
    }
}
