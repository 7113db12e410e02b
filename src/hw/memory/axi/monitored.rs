//! The AXI4 master beside its protocol monitor: the module of its bench and of its proof.

use super::monitor::{self, Rules, Sizes};
use super::{Bus, Inputs as AxiInputs, Outputs as AxiOutputs};
use crate::hdl::properties::shown_stays;
use crate::hdl::{self, Builder, Bundle, HdlError, Module, Proof, Signal, Specs};
use crate::hw::memory::BEATS_BITS;
use crate::interface;
use std::sync::Arc;

interface! {
    pub (bus: &Bus) {
        in "" { master: ..{AxiInputs}(bus) }
        out "" { master: ..{AxiOutputs}(bus) }
        out "The monitor: whether any rule has been violated since reset, and which" {
            error: 1,
            violated: {Rules}(),
        }
    }
}

/// Describes the master of a bus and its monitor.
///
/// # Errors
/// None is known.
pub fn module(sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let bus = &sizes.bus;
    let m = Builder::new(
        "axi_master_monitored",
        "the AXI4 master and the protocol monitor of its bus.",
    );
    let ports = ports(bus);
    let Inputs { master: inputs } = ports.inputs.inputs(&m);
    let unit = super::module(bus)?;
    let (master, of_master) = super::ports(bus).instance("master", &m, &unit, inputs);
    let design = monitor::module(sizes)?;
    let watched = monitor::Inputs {
        master: master.m_axi,
        slave: inputs.m_axi,
    };
    let (seen, of_monitor) = monitor::ports(bus).instance("monitor", &m, &design, watched);
    let outputs = Outputs {
        master,
        error: seen.error,
        violated: seen.rules,
    };
    ports.outputs.outputs(&m, outputs);
    let pair = Pair {
        bus: *bus,
        inputs,
        outputs: master,
        master: of_master,
        monitor: of_monitor,
    };
    pair.obeys(&m, &unit)?;
    m.finish()
}

/// Width of sums of bursts and of beats.
const BITS: u32 = BEATS_BITS + 2;

/// The rules that the master must obey; the others are the slave's.
const OF_MASTER: &[&str] = &[
    "stable_aw",
    "stable_w",
    "stable_ar",
    "boundary_aw",
    "boundary_ar",
    "size_aw",
    "size_ar",
    "last_w",
    "early_w",
    "bound_r",
    "bound_w",
];

/// The two instances, and the ports of the master.
struct Pair<'b> {
    bus: Bus,
    inputs: AxiInputs<Signal<'b>>,
    outputs: AxiOutputs<Signal<'b>>,
    master: hdl::Outputs<'b>,
    monitor: hdl::Outputs<'b>,
}

fn wide(signal: Signal<'_>) -> Signal<'_> {
    signal.extend(BITS)
}

/// A burst whose data are not complete: whether there is one, and its number of beats, minus one.
struct Incomplete<'b> {
    valid: Signal<'b>,
    beats: Signal<'b>,
}

impl<'b> Pair<'b> {
    /// A signal of the master, and of the monitor.
    fn of_master(&self, name: &str) -> Signal<'b> {
        self.master.inside(name)
    }

    fn of_monitor(&self, name: &str) -> Signal<'b> {
        self.monitor.inside(name)
    }

    /// The master obeys its rules in front of any slave that obeys its own.
    fn obeys(&self, m: &'b Builder, unit: &Module) -> Result<(), HdlError> {
        let proof = &m.proof(
            "obeys",
            "the master obeys the rules of the bus in front of any slave that does; no deadlock",
        );
        proof.keep(&self.master);
        proof.keep(&self.monitor);
        self.assume(proof);
        for rule in OF_MASTER {
            let violated = self.of_monitor(&format!("{rule}_now"));
            proof.assert(format!("rule {rule}"), !violated);
        }
        proof.cover("a write burst has its response", self.outputs.written);
        let read = self.outputs.beat;
        proof.cover("a read burst is complete", read.valid & read.payload.last);
        self.counts(proof);
        self.data(proof);
        self.progress(proof);
        faults(proof, unit)
    }

    /// What clients and slave must do.
    fn assume(&self, proof: &Proof<'b>) {
        let m = proof.module();
        let within = m.lit(self.bus.bytes() - 1, 12);
        for (what, valid, address, beats) in [
            (
                "a burst to read",
                self.inputs.read.valid,
                self.inputs.read.payload.address,
                self.inputs.read.payload.beats,
            ),
            (
                "a burst to write",
                self.inputs.write.valid,
                self.inputs.write.payload.address,
                self.inputs.write.payload.beats,
            ),
        ] {
            let address = address.low(12);
            let bytes = beats.extend(14).shl(m.lit(self.bus.size(), 3));
            let last = address.extend(14) + bytes;
            proof.assume(
                format!("{what} is aligned to the width of the data"),
                valid.implies((address & within).is_zero()),
            );
            proof.assume(
                format!("{what} does not cross a multiple of 4 KiB"),
                valid.implies(last.high(2).is_zero()),
            );
        }
        for rule in ["id_r", "id_b"] {
            let violated = self.of_monitor(&format!("{rule}_now"));
            proof.assume(format!("the slave obeys rule {rule}"), !violated);
        }
        let b = self.inputs.m_axi;
        proof.assume(
            "responses have the identifier of all write bursts",
            b.bvalid.implies(b.b.bid.is_zero()),
        );
    }

    /// The master counts what the monitor counts.
    fn counts(&self, proof: &Proof<'b>) {
        let bits = BITS.max(self.of_master("reads_outstanding").width() + 1);
        let wide = |signal: Signal<'b>| signal.extend(bits);
        let beat = self.outputs.beat;
        for (what, most, offered, late) in [
            (
                "reads",
                self.bus.reads,
                self.outputs.m_axi.arvalid,
                beat.valid & beat.payload.last,
            ),
            (
                "writes",
                self.bus.writes,
                self.outputs.m_axi.awvalid,
                self.outputs.written,
            ),
        ] {
            let counted = wide(self.of_master(&format!("{what}_outstanding")));
            let seen = wide(self.of_monitor(&format!("{what}_outstanding")));
            let room = self.of_master(&format!("{what}_outstanding_room"));
            let most = proof.module().lit(most, bits);
            proof.assert(
                format!("the master counts {what} that are offered, accepted, or just complete"),
                counted.eq(seen + wide(offered) + wide(late)),
            );
            proof.assert(
                format!("no more {what} are counted than the bound"),
                counted.le(most),
            );
            proof.assert(
                format!("the register says whether there is room for {what}"),
                room.eq(counted.ne(most)),
            );
        }
    }

    /// The bursts whose data are not complete are the same in master and monitor, in order.
    fn data(&self, proof: &Proof<'b>) {
        let m = proof.module();
        let (out, bits) = (&self.outputs.m_axi, self.of_monitor("write_head").width());
        let [head, tail] = ["write_head", "write_tail"].map(|name| self.of_monitor(name));
        let (queued, lengths) = (tail - head, self.of_monitor("write_lengths"));
        let seen = |place: u32| {
            let at = m.lit(place, bits);
            let stored = lengths.shr((head + at).concat(m.zero(3))).low(BEATS_BITS);
            let ahead = self.of_monitor("data_ahead");
            let offered = out.awvalid & !ahead & queued.eq(at);
            Incomplete {
                valid: queued.gt(at) | offered,
                beats: queued.gt(at).mux(stored, out.aw.awlen),
            }
        };
        let all = [seen(0), seen(1), seen(2)];
        let written = self.of_monitor("beats_written");
        let [left, pending] = ["beats_left", "beats_pending"].map(|name| self.of_master(name));
        let rest = self.of_master("left_after_next");
        let last_offered = out.wvalid & out.w.wlast;
        let same = |what: &str, condition: Signal<'b>, burst: &Incomplete<'b>, beats| {
            proof.assert(what, condition.implies(burst.valid & burst.beats.eq(beats)));
        };
        same(
            "the last datum of a burst is offered as such",
            last_offered,
            &all[0],
            written,
        );
        same(
            "the beats of the first burst are written, offered or left",
            left & !last_offered,
            &all[0],
            written + rest + out.wvalid.extend(BEATS_BITS),
        );
        let wraps = wide(written) + wide(rest) + wide(out.wvalid);
        proof.assert(
            "a burst has at most 256 beats",
            (left & !last_offered).implies(wraps.high(2).is_zero()),
        );
        same(
            "the beats of the second burst are left",
            left & last_offered,
            &all[1],
            rest,
        );
        let beats = self.of_master("aw_beats");
        for (at, burst) in all.iter().enumerate() {
            let before = wide(left) + wide(last_offered);
            same(
                "a pending burst is the last one",
                pending & before.equals(at as u128),
                burst,
                beats,
            );
        }
        proof.assert(
            "a datum that is not the last has others behind it",
            (out.wvalid & !out.w.wlast).implies(left),
        );
        proof.assert(
            "no beat of the next burst is written before the last of this one",
            (!left & !last_offered).implies(written.is_zero()),
        );
        let ahead = self.of_monitor("data_ahead");
        let in_monitor = wide(queued) + wide(out.awvalid & !ahead);
        proof.assert(
            "master and monitor know the same number of incomplete bursts",
            in_monitor.eq(wide(left) + wide(last_offered) + wide(pending)),
        );
        proof.assert(
            "data are ahead of an address only while it is offered",
            ahead.implies(out.awvalid & queued.is_zero()),
        );
        proof.assert(
            "a pending burst is the one whose address is held",
            pending.implies(in_monitor.any()),
        );
    }

    /// A burst that the master has taken waits for the slave or for its data alone.
    fn progress(&self, proof: &Proof<'b>) {
        let (out, inputs) = (&self.outputs.m_axi, &self.inputs);
        let [left, pending] = ["beats_left", "beats_pending"].map(|name| self.of_master(name));
        proof.assert(
            "pending beats start when none is left",
            (pending & !left).implies(self.of_master("data_start")),
        );
        let stuck = left & !self.outputs.datum_ready;
        proof.assert(
            "data that are left wait for the slave or for the client",
            stuck.implies(out.wvalid & !inputs.m_axi.wready),
        );
        proof.assert(
            "a burst to read is refused only while one is offered or all are outstanding",
            (!self.outputs.read_ready)
                .implies(out.arvalid | !self.of_master("reads_outstanding_room")),
        );
        proof.assert(
            "a burst to write is refused only while one is offered or pending or all are outstanding",
            (!self.outputs.write_ready)
                .implies(out.awvalid | pending | !self.of_master("writes_outstanding_room")),
        );
        proof.assert(
            "offers to the slave are stable",
            shown_stays(proof, out.arvalid, inputs.m_axi.arready, &out.ar.leaves()),
        );
    }
}

/// One fault of the master for each rule that it must obey, and others.
fn faults(proof: &Proof<'_>, unit: &Module) -> Result<(), HdlError> {
    let signal = |name: &str| unit.signal(name);
    // What a signal reads of another.
    let read = |name: &str, other: &str| -> Result<_, HdlError> {
        Ok(signal(name)?.reads(signal(other)?))
    };
    for (what, fault) in [
        (
            "an offered read address is withdrawn (stable_ar)",
            read("read_offered", "m_axi_arready")?.as_value(1),
        ),
        (
            "an offered write address is withdrawn (stable_aw)",
            read("write_offered", "m_axi_awready")?.as_value(1),
        ),
        (
            "an offered datum is replaced (stable_w)",
            read("datum_room", "m_axi_wready")?.as_value(1),
        ),
        (
            "a read burst has a beat more (boundary_ar)",
            signal("m_axi_arlen")?.fault().with_flipped(1),
        ),
        (
            "a write burst begins at another place (boundary_aw)",
            signal("m_axi_awaddr")?.fault().with_flipped(0x800),
        ),
        (
            "read beats are of another width (size_ar)",
            signal("m_axi_arsize")?.fault().with_flipped(1),
        ),
        (
            "write bursts are not INCR (size_aw)",
            signal("m_axi_awburst")?.fault().with_flipped(2),
        ),
        (
            "the last datum is not marked (last_w)",
            signal("m_axi_wlast")?.fault().as_value(0),
        ),
        (
            "an address is never offered, and its data are (early_w)",
            signal("m_axi_awvalid")?.fault().as_value(0),
        ),
        (
            "a read is begun with all outstanding (bound_r)",
            read("reads_outstanding_room", "read_ends")?.as_value(1),
        ),
        (
            "a write is begun with all outstanding (bound_w)",
            read("writes_outstanding_room", "written_q")?.as_value(1),
        ),
        (
            "a burst is taken while the beats of another are pending",
            read("write_room", "beats_pending")?.as_value(0),
        ),
        (
            "the last beat does not end a burst",
            read("beats_left", "data_finish")?.as_value(0),
        ),
    ] {
        proof.fault(what, fault);
    }
    Ok(())
}
