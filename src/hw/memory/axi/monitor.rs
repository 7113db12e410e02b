//! The protocol monitor of an AXI4 bus: one bit for each rule of `docs/chip.md`, which is set when the rule is violated.
//!
//! It only observes, so it can stand beside any master and any slave. The number of outstanding bursts of an identifier is the distance
//! between two counters, one of bursts accepted and one of bursts complete. The counters are in memories, one word for each identifier; a flag
//! for each identifier says that its word has been written since reset, and is 0 otherwise.

use super::{Bus, INCR, MasterInputs, MasterOutputs, ReadAddress, ReadData};
use super::{WriteAddress, WriteData, WriteResponse};
use crate::hdl::bundle::Like;
use crate::hdl::{
    Builder, Bundle, HdlError, Library, Memory, Module, Parameter, Reg, Signal, Spec, Specs, Style,
    bits_for,
};
use crate::hw::memory::{ADDRESS_BITS, BEATS_BITS};
use crate::{bundle, interface};
use std::sync::Arc;

/// The name of the module.
pub const NAME: &str = "axi_monitor";

bundle! {
    /// The rules, each with a bit that says whether it was violated.
    pub struct Rules() {
        stable_aw: 1,
        stable_w: 1,
        stable_ar: 1,
        stable_r: 1,
        stable_b: 1,
        boundary_aw: 1,
        boundary_ar: 1,
        size_aw: 1,
        size_ar: 1,
        last_w: 1,
        early_w: 1,
        last_r: 1,
        id_r: 1,
        id_b: 1,
        bound_r: 1,
        bound_w: 1,
        progress: 1,
    }
}

interface! {
    pub (bus: &Bus) {
        in "" {
            master: ..{MasterOutputs}(bus),
            slave: ..{MasterInputs}(bus),
        }
        out "High from the cycle after any violation until reset" { error: 1 }
        out "The rules that have been violated since reset" { rules: ..{Rules}() }
    }
}

/// The numbers that a monitor is made for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Sizes {
    pub bus: Bus,
    /// The number of cycles within which a valid must be accepted and an outstanding burst must progress.
    pub patience: u32,
}

impl Sizes {
    /// Bits of the counters of bursts of an identifier. They hold one more than the bound, so full and empty differ.
    fn read_bits(&self) -> u32 {
        bits_for(u64::from(self.bus.reads) + 1)
    }

    fn write_bits(&self) -> u32 {
        bits_for(u64::from(self.bus.writes) + 1)
    }

    fn ids(&self) -> u32 {
        1 << self.bus.id_bits
    }

    fn length_bits(&self) -> u32 {
        self.bus.id_bits + self.read_bits()
    }

    fn wait_bits(&self) -> u32 {
        bits_for(u64::from(self.patience) + 1)
    }
}

/// Sizes that tell the parameters apart.
const SAMPLES: &[Sizes] = &[
    Sizes {
        bus: Bus {
            data_bits: 64,
            id_bits: 6,
            reads: 21,
            writes: 11,
        },
        patience: 3000,
    },
    Sizes {
        bus: Bus {
            data_bits: 128,
            id_bits: 3,
            reads: 35,
            writes: 20,
        },
        patience: 600,
    },
    Sizes {
        bus: Bus {
            data_bits: 256,
            id_bits: 9,
            reads: 300,
            writes: 5,
        },
        patience: 70_000,
    },
];

const PARAMETERS: &[Parameter] = &[
    Parameter::number("DATA_BITS", "bits of data"),
    Parameter::number("BYTES", "bytes of data: DATA_BITS / 8"),
    Parameter::number("SIZE", "the code of a full-width beat: 2**SIZE = BYTES"),
    Parameter::number("ID_BITS", "bits of an identifier"),
    Parameter::number("IDS", "identifiers: 2**ID_BITS"),
    Parameter::number("READS", "greatest number of outstanding read bursts"),
    Parameter::number(
        "READ_BITS",
        "bits of a count of read bursts: 2**READ_BITS > READS",
    ),
    Parameter::number("LENGTHS", "2**(ID_BITS + READ_BITS)"),
    Parameter::number("WRITES", "greatest number of outstanding write bursts"),
    Parameter::number(
        "WRITE_BITS",
        "bits of a count of write bursts: 2**WRITE_BITS > WRITES",
    ),
    Parameter::number("WRITE_SLOTS", "2**WRITE_BITS"),
    Parameter::number("WRITE_LENGTHS", "bits of as many lengths: 8 * WRITE_SLOTS"),
    Parameter::number("OTHER_LENGTHS", "WRITE_LENGTHS - 8"),
    Parameter::number("PLACE_BITS", "WRITE_BITS + 3"),
    Parameter::number("PATIENCE", "greatest number of cycles without progress"),
    Parameter::number(
        "WAIT_BITS",
        "bits of such a number: 2**WAIT_BITS > PATIENCE",
    ),
];

fn values(sizes: &Sizes) -> Vec<u32> {
    let bus = &sizes.bus;
    vec![
        bus.data_bits,
        bus.bytes(),
        bus.size(),
        bus.id_bits,
        sizes.ids(),
        bus.reads,
        sizes.read_bits(),
        1 << sizes.length_bits(),
        bus.writes,
        sizes.write_bits(),
        1 << sizes.write_bits(),
        BEATS_BITS << sizes.write_bits(),
        (BEATS_BITS << sizes.write_bits()) - BEATS_BITS,
        sizes.write_bits() + 3,
        sizes.patience,
        sizes.wait_bits(),
    ]
}

/// Describes the monitor of a bus. In a design it is a module with parameters.
///
/// # Errors
/// None for a bus of 32 to 256 bits.
pub fn module(sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let library = Library {
        name: NAME,
        doc: "a protocol monitor for an AXI4 bus of full-width INCR bursts. Each rule has a bit, which is set when the rule is violated.",
        parameters: PARAMETERS,
        values: &values,
        samples: SAMPLES,
        describe: &describe,
    };
    library.module(sizes)
}

fn describe(sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        format!("{NAME}_{}", sizes.bus.data_bits),
        "a protocol monitor for an AXI4 bus of full-width INCR bursts. Each rule has a bit, which is set when the rule is violated.",
    );
    m.simplify(false);
    let ports = ports(&sizes.bus);
    let Inputs { master, slave } = ports.inputs.inputs(&m);
    let watch = Watch {
        m: &m,
        sizes,
        master,
        slave,
    };
    let [stable_aw, stable_w, stable_ar, stable_r, stable_b] = watch.stable();
    let writes = Writes::new(&watch);
    let responses = watch.responses(&writes);
    let reads = Reads::new(&watch);
    let now = Rules {
        stable_aw,
        stable_w,
        stable_ar,
        stable_r,
        stable_b,
        boundary_aw: watch.crosses(master.aw.awaddr, master.aw.awlen) & master.awvalid,
        boundary_ar: watch.crosses(master.ar.araddr, master.ar.arlen) & master.arvalid,
        size_aw: watch.unlike(master.aw.awaddr, master.aw.awsize, master.aw.awburst)
            & master.awvalid,
        size_ar: watch.unlike(master.ar.araddr, master.ar.arsize, master.ar.arburst)
            & master.arvalid,
        last_w: writes.last,
        early_w: writes.early,
        last_r: reads.last,
        id_r: reads.id,
        id_b: responses.id,
        bound_r: reads.bound,
        bound_w: responses.bound,
        progress: watch.progress(reads.any, responses.any),
    };
    m.comment("A violation is kept until reset.");
    let rules = now.map(|name, violated| {
        let violated = violated.named(format!("{name}_now"));
        let kept = m.reg_reset(format!("{name}_seen"), 1, 0);
        kept.next(kept.q | violated);
        kept.q
    });
    let error = m.or_all(&rules.leaves()).named("any_seen");
    ports.outputs.outputs(&m, Outputs { error, rules });
    m.finish()
}

/// The signals of the bus.
struct Watch<'b> {
    m: &'b Builder,
    sizes: &'b Sizes,
    master: MasterOutputs<Signal<'b>>,
    slave: MasterInputs<Signal<'b>>,
}

/// What is seen of the addresses and the data of write bursts.
struct Writes<'b> {
    last: Signal<'b>,
    early: Signal<'b>,
    /// A burst is complete, address and data, and its identifier.
    completes: Signal<'b>,
    id: Signal<'b>,
}

/// What is seen of write bursts from their addresses to their responses.
struct Responses<'b> {
    id: Signal<'b>,
    bound: Signal<'b>,
    /// Whether bursts are outstanding.
    any: Signal<'b>,
}

/// What is seen of read bursts.
struct Reads<'b> {
    last: Signal<'b>,
    id: Signal<'b>,
    bound: Signal<'b>,
    /// Whether bursts are outstanding.
    any: Signal<'b>,
}

/// A number for each identifier, which is 0 after a reset.
struct PerId<'b> {
    known: Reg<'b>,
    numbers: Memory<'b>,
}

impl<'b> PerId<'b> {
    fn new(watch: &Watch<'b>, name: &str, bits: u32) -> PerId<'b> {
        let (m, ids) = (watch.m, watch.sizes.ids());
        PerId {
            known: m.reg_reset(format!("{name}_known"), ids, 0),
            numbers: m.memory(name, ids, bits, Style::Distributed),
        }
    }

    fn of(&self, id: Signal<'b>) -> Signal<'b> {
        let number = self.numbers.read_now(id);
        let zero = number.module().zero(number.width());
        self.known.q.bit_numbered(id).mux(number, zero)
    }

    fn set(&self, when: Signal<'b>, id: Signal<'b>, number: Signal<'b>) {
        let one = id.module().lit(1u8, self.known.q.width());
        let name = self.numbers.name();
        let also = self.known.q | one.shl(id).hinted(format!("{name}_id"));
        self.known.next_when(when, also);
        self.numbers.write(when, id, number);
    }
}

/// The handshake of a channel.
struct Offer<'b> {
    name: &'static str,
    valid: Signal<'b>,
    ready: Signal<'b>,
}

impl<'b> Offer<'b> {
    /// Whether it was not accepted in the cycle before, and is gone or has another payload now.
    fn changed<B: Bundle<Leaf = Spec>>(&self, of: &B, payload: Like<B, Signal<'b>>) -> Signal<'b> {
        let m = self.valid.module();
        let waits = m.reg_reset(format!("{}_waits", self.name), 1, 0);
        waits.next(self.valid & !self.ready);
        let mut differs = !self.valid;
        of.with(payload, |spec: Spec, now: Signal<'b>| {
            let before = m.reg(format!("{}_before", spec.name), spec.width);
            before.next(now);
            differs = differs | now.ne(before.q);
        });
        waits.q & differs.named(format!("{}_differs", self.name))
    }
}

fn plus_one(count: Signal<'_>) -> Signal<'_> {
    count + count.module().lit(1u8, count.width())
}

impl<'b> Watch<'b> {
    /// Whether an offer was not accepted in the cycle before and is not the same now, for each channel.
    fn stable(&self) -> [Signal<'b>; 5] {
        let (m, bus) = (self.m, &self.sizes.bus);
        m.comment("An offer stays as it is until it is accepted.");
        let (out, into) = (&self.master, &self.slave);
        let is = |name, valid, ready| Offer { name, valid, ready };
        [
            is("aw", out.awvalid, into.awready).changed(&WriteAddress::of(bus), out.aw),
            is("w", out.wvalid, into.wready).changed(&WriteData::of(bus), out.w),
            is("ar", out.arvalid, into.arready).changed(&ReadAddress::of(bus), out.ar),
            is("r", into.rvalid, out.rready).changed(&ReadData::of(bus), into.r),
            is("b", into.bvalid, out.bready).changed(&WriteResponse::of(bus), into.b),
        ]
    }

    /// Whether the last beat of a burst is beyond the next multiple of 4 KiB.
    fn crosses(&self, address: Signal<'b>, beats: Signal<'b>) -> Signal<'b> {
        let m = self.m;
        let first = m.concat(&[m.zero(2), address.low(12)]);
        let size = m.lit(self.sizes.bus.size(), 3);
        let bytes = m.concat(&[m.zero(6), beats]).shl(size);
        let last = first + bytes.hinted_after(beats, "bytes");
        last.hinted_after(address, "last").high(2).any()
    }

    /// Whether a burst is not INCR, not of the full width, or not aligned to it.
    fn unlike(&self, address: Signal<'b>, size: Signal<'b>, burst: Signal<'b>) -> Signal<'b> {
        let (m, bus) = (self.m, &self.sizes.bus);
        let within = m.lit(bus.bytes() - 1, ADDRESS_BITS);
        (address & within).any() | size.ne(m.lit(bus.size(), 3)) | burst.ne(m.lit(INCR, 2))
    }

    /// Counts outstanding bursts: the number, and whether one too many is accepted.
    fn outstanding(
        &self,
        name: &str,
        most: u32,
        accepted: Signal<'b>,
        ends: Signal<'b>,
    ) -> [Signal<'b>; 2] {
        let bits = bits_for(u64::from(most) + 1);
        let count = self.m.reg_reset(format!("{name}_outstanding"), bits, 0);
        let one = self.m.lit(1u8, bits);
        count.next_when(accepted ^ ends, accepted.mux(count.q + one, count.q - one));
        let full = count.q.eq(self.m.lit(most, bits));
        [count.q, accepted & full & !ends]
    }

    fn responses(&self, writes: &Writes<'b>) -> Responses<'b> {
        let m = self.m;
        m.comment("Responses: of each identifier, the complete bursts and those with a response are counted.");
        let (out, into) = (&self.master, &self.slave);
        let bits = self.sizes.write_bits();
        let (complete, answered) = (
            PerId::new(self, "bursts_complete", bits),
            PerId::new(self, "bursts_answered", bits),
        );
        let accepted = (into.bvalid & out.bready).named("response_accepted");
        let id = into.b.bid;
        let before = answered.of(id).named("answered_of_id");
        complete.set(
            writes.completes,
            writes.id,
            plus_one(complete.of(writes.id)),
        );
        answered.set(accepted, id, plus_one(before));
        let address_accepted = out.awvalid & into.awready;
        let [count, bound] =
            self.outstanding("writes", self.sizes.bus.writes, address_accepted, accepted);
        let any = count.any().named("any_write");
        let same = complete.of(id).eq(before).named("all_answered");
        Responses {
            id: into.bvalid & (same | !any),
            bound,
            any,
        }
    }

    /// Whether something has waited for longer than the bound.
    fn progress(&self, reads: Signal<'b>, writes: Signal<'b>) -> Signal<'b> {
        let m = self.m;
        m.comment("Progress: the cycles are counted in which an offer waits, or in which bursts are outstanding and none of them moves.");
        let (out, into) = (&self.master, &self.slave);
        let bits = self.sizes.wait_bits();
        let most = m.lit(self.sizes.patience, bits);
        let stuck = |name: &str, waits: Signal<'b>| {
            let waited = m.reg_reset(format!("{name}_waited"), bits, 0);
            let over = waited.q.eq(most).named(format!("{name}_stuck"));
            let more = plus_one(waited.q).hinted(format!("{name}_waited_more"));
            let waits = (waits & !over).named(format!("{name}_waits_on"));
            waited.next(waits.mux(more, m.zero(bits)));
            over
        };
        let moves = |valid: Signal<'b>, ready: Signal<'b>| valid & ready;
        let write_moves = moves(out.awvalid, into.awready)
            | moves(out.wvalid, into.wready)
            | moves(into.bvalid, out.bready);
        let read_moves = moves(out.arvalid, into.arready) | moves(into.rvalid, out.rready);
        m.or_all(&[
            stuck("address_of_write", out.awvalid & !into.awready),
            stuck("datum", out.wvalid & !into.wready),
            stuck("response", into.bvalid & !out.bready),
            stuck("address_of_read", out.arvalid & !into.arready),
            stuck("beat", into.rvalid & !out.rready),
            stuck("writes", writes & !write_moves),
            stuck("reads", reads & !read_moves),
        ])
    }
}

impl<'b> Writes<'b> {
    /// Follows the data of write bursts: which burst each datum belongs to.
    fn new(watch: &Watch<'b>) -> Writes<'b> {
        let (m, sizes) = (watch.m, watch.sizes);
        let (out, into) = (&watch.master, &watch.slave);
        let (bits, id_bits) = (sizes.write_bits(), sizes.bus.id_bits);
        m.comment("Write bursts whose address is accepted and whose data are not complete, the oldest first. Their lengths are in one register.");
        let head = m.reg_reset("write_head", bits, 0);
        let tail = m.reg_reset("write_tail", bits, 0);
        let slots = 1 << bits;
        let ids = m.memory("write_ids", slots, id_bits, Style::Distributed);
        let lengths = m.reg("write_lengths", slots * BEATS_BITS);
        let queued = head.q.ne(tail.q).named("write_queued");
        m.comment("Without one, data are of the burst whose address is offered, unless they are complete.");
        let ahead = m.reg_reset("data_ahead", 1, 0);
        let has_address = (queued | (out.awvalid & !ahead.q)).named("has_address");
        let place = |slot: Signal<'b>| slot.concat(m.zero(3));
        let front = lengths.q.shr(place(head.q)).hinted("write_lengths_left");
        let length = queued.mux(front.low(BEATS_BITS), out.aw.awlen);
        let beats = m.reg_reset("beats_written", BEATS_BITS, 0);
        let is_last = beats.q.eq(length).named("is_last_write");
        let accepted = (out.wvalid & into.wready).named("datum_accepted");
        beats.next_when(
            accepted,
            out.w.wlast.mux(m.zero(BEATS_BITS), plus_one(beats.q)),
        );
        let ends = (accepted & out.w.wlast).named("data_end");
        let address_accepted = (out.awvalid & into.awready).named("write_accepted");
        let complete = (ahead.q | (ends & !queued)).named("offered_complete");
        ahead.next(complete & !address_accepted);
        let leaves = ends & queued;
        let enters = address_accepted & !complete;
        ids.write(enters, tail.q, out.aw.awid);
        let width = slots * BEATS_BITS;
        let place_of_tail = place(tail.q).named("write_place");
        let mask = m.lit(u8::MAX, width).shl(place_of_tail);
        let beats = m.concat(&[m.zero(width - BEATS_BITS), out.aw.awlen]);
        let beats = beats.shl(place_of_tail).hinted("length_in_place");
        lengths.next_when(enters, (lengths.q & !mask.hinted("length_mask")) | beats);
        tail.next_when(enters, plus_one(tail.q));
        head.next_when(leaves, plus_one(head.q));
        Writes {
            last: out.wvalid & has_address & out.w.wlast.ne(is_last),
            early: out.wvalid & !has_address,
            completes: (leaves | (address_accepted & complete)).named("burst_complete"),
            id: (queued.mux(ids.read_now(head.q), out.aw.awid)).named("complete_id"),
        }
    }
}

impl<'b> Reads<'b> {
    /// Follows read bursts. Those of an identifier have their beats one after another.
    fn new(watch: &Watch<'b>) -> Reads<'b> {
        let (m, sizes) = (watch.m, watch.sizes);
        let (out, into) = (&watch.master, &watch.slave);
        m.comment("Read bursts: of each identifier, the bursts accepted, the bursts complete, and the beats of the oldest one that is not.");
        let bits = sizes.read_bits();
        let (begun, ended) = (
            PerId::new(watch, "bursts_begun", bits),
            PerId::new(watch, "bursts_ended", bits),
        );
        let beats = PerId::new(watch, "beats_read", BEATS_BITS);
        let lengths = m.memory(
            "read_lengths",
            1 << sizes.length_bits(),
            BEATS_BITS,
            Style::Distributed,
        );
        let accepted = (out.arvalid & into.arready).named("read_accepted");
        let new_id = out.ar.arid;
        let place = begun.of(new_id).named("read_place");
        lengths.write(accepted, m.concat(&[new_id, place]), out.ar.arlen);
        begun.set(accepted, new_id, plus_one(place));

        let (beat, id) = (
            (into.rvalid & out.rready).named("beat_accepted"),
            into.r.rid,
        );
        let oldest = ended.of(id).named("read_oldest");
        let length = lengths.read_now(m.concat(&[id, oldest]));
        let so_far = beats.of(id).named("beats_so_far");
        let is_last = so_far.eq(length).named("is_last_read");
        beats.set(
            beat,
            id,
            into.r.rlast.mux(m.zero(BEATS_BITS), plus_one(so_far)),
        );
        let ends = (beat & into.r.rlast).named("read_ends");
        ended.set(ends, id, plus_one(oldest));
        let [count, bound] = watch.outstanding("reads", sizes.bus.reads, accepted, ends);
        let any = count.any().named("any_read");
        let none = (begun.of(id).eq(oldest) | !any).named("none_of_id");
        Reads {
            last: into.rvalid & !none & into.r.rlast.ne(is_last),
            id: into.rvalid & none,
            bound,
            any,
        }
    }
}
