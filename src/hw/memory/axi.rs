//! The AXI4 master: turns bursts into transactions on the five channels of an AXI4 bus.
//!
//! It neither reorders nor splits bursts, so it holds one address per direction and one datum. Every valid and every payload is a
//! register: nothing on the bus depends on a ready in the same cycle. Received channels are registered as well, so the wires to and from
//! the bus have a cycle of their own.
//!
//! ```text
//! bursts to read ──► AR register            R ──► register ──► beats
//! bursts to write ─┬► AW register           B ──► register ──► written
//!                  └► beats pending ─► beats left ─┐
//! data to write ───────────────────────────────────┴► W register
//! ```
//!
//! [`monitor`] describes the rules of the bus as a module, which [`monitored`] places beside the master for benches and for the proof.

pub mod monitor;
pub mod monitored;

use super::{ADDRESS_BITS, BEATS_BITS, Beat, Burst, WriteBeat, WriteBurst, kept};
use crate::hdl::prefetch::Occupancy;
use crate::hdl::{Builder, Flow, HdlError, Module, Signal, Specs};
use crate::{bundle, interface};
use std::sync::Arc;

/// The parameters of a bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bus {
    /// Bits of data: 32, 64, 128 or 256.
    pub data_bits: u32,
    /// Bits of an identifier.
    pub id_bits: u32,
    /// Read bursts and write bursts that may be outstanding.
    pub reads: u32,
    /// See `reads`.
    pub writes: u32,
}

impl Bus {
    /// Bytes of a beat.
    pub fn bytes(&self) -> u32 {
        self.data_bits / 8
    }

    /// The code of a full-width beat in `AxSIZE`: the binary logarithm of its bytes.
    pub fn size(&self) -> u32 {
        self.bytes().ilog2()
    }
}

/// The name of the module.
const NAME: &str = "axi_master";

/// `AxBURST` of a burst of ascending addresses.
const INCR: u32 = 1;
/// `AxCACHE`: modifiable, bufferable.
const CACHE: u32 = 3;
/// `AxPROT`: unprivileged, non-secure, data.
const PROT: u32 = 2;

/// Width of a response.
pub const RESPONSE_BITS: u32 = 2;

bundle! {
    /// The payload of the write address channel, under the names of the standard.
    pub struct WriteAddress(bus: &Bus) {
        awid: bus.id_bits,
        awaddr: ADDRESS_BITS,
        awlen: BEATS_BITS,
        awsize: 3,
        awburst: 2,
        awlock: 1,
        awcache: 4,
        awprot: 3,
        awqos: 4,
    }
}

bundle! {
    /// The payload of the write data channel.
    pub struct WriteData(bus: &Bus) {
        wdata: bus.data_bits,
        wstrb: bus.bytes(),
        wlast: 1,
    }
}

bundle! {
    /// The payload of the write response channel.
    pub struct WriteResponse(bus: &Bus) {
        bid: bus.id_bits,
        bresp: RESPONSE_BITS,
    }
}

bundle! {
    /// The payload of the read address channel.
    pub struct ReadAddress(bus: &Bus) {
        arid: bus.id_bits,
        araddr: ADDRESS_BITS,
        arlen: BEATS_BITS,
        arsize: 3,
        arburst: 2,
        arlock: 1,
        arcache: 4,
        arprot: 3,
        arqos: 4,
    }
}

bundle! {
    /// The payload of the read data channel.
    pub struct ReadData(bus: &Bus) {
        rid: bus.id_bits,
        rdata: bus.data_bits,
        rresp: RESPONSE_BITS,
        rlast: 1,
    }
}

bundle! {
    /// The signals of an AXI4 bus that its master drives.
    pub struct MasterOutputs(bus: &Bus) {
        "AXI4 master: write address channel" {
            awvalid: 1,
            aw: ..{WriteAddress}(bus),
        }
        "AXI4 master: write data channel" {
            wvalid: 1,
            w: ..{WriteData}(bus),
        }
        "AXI4 master: write response channel" {
            bready: 1,
        }
        "AXI4 master: read address channel" {
            arvalid: 1,
            ar: ..{ReadAddress}(bus),
        }
        "AXI4 master: read data channel" {
            rready: 1,
        }
    }
}

bundle! {
    /// The signals of an AXI4 bus that its slave drives.
    pub struct MasterInputs(bus: &Bus) {
        "AXI4 master: write address channel" {
            awready: 1,
        }
        "AXI4 master: write data channel" {
            wready: 1,
        }
        "AXI4 master: write response channel" {
            bvalid: 1,
            b: ..{WriteResponse}(bus),
        }
        "AXI4 master: read address channel" {
            arready: 1,
        }
        "AXI4 master: read data channel" {
            rvalid: 1,
            r: ..{ReadData}(bus),
        }
    }
}

bundle! {
    /// Events for counters, each for one cycle.
    pub struct Events() {
        /// A beat was read; a beat was written.
        beat_read: 1,
        beat_written: 1,
        /// An offered address of a read, address of a write, or datum waited.
        read_waits: 1,
        write_waits: 1,
        datum_waits: 1,
        /// A beat of read data was not OKAY; a response was not OKAY.
        read_error: 1,
        write_error: 1,
    }
}

interface! {
    pub (bus: &Bus) {
        in "Bursts to read" { read: Flow<Burst>(bus.id_bits) }
        out "Bursts to read" { read_ready: 1 }
        out "Read data, always taken" { beat: Flow<Beat>(bus.id_bits, bus.data_bits) }
        in "Bursts to write" { write: Flow<WriteBurst>() }
        out "Bursts to write" { write_ready: 1 }
        in "Data to write, in the order of the bursts" { datum: Flow<WriteBeat>(bus.data_bits) }
        out "Data to write, in the order of the bursts" { datum_ready: 1 }
        out "High for one cycle when a write burst has its response" { written: 1 }
        in "" { m_axi: {MasterInputs}(bus) }
        out "" { m_axi: {MasterOutputs}(bus) }
        out "Events for counters" { event: {Events}() }
    }
}

/// Describes the AXI4 master of a bus.
///
/// # Errors
/// None is known.
pub fn module(bus: &Bus) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        NAME,
        "the AXI4 master: full-width INCR bursts, of which a bounded number is outstanding.",
    );
    let ports = ports(bus);
    let inputs = ports.inputs.inputs(&m);
    let bus_in = inputs.m_axi;

    let beat = received(&m, bus, &bus_in);
    let [written, write_error] = responses(&m, bus, &bus_in);
    let reads = Reads::new(&m, bus, &inputs, &beat);
    let writes = Writes::new(&m, bus, &inputs, written);

    m.comment("Events have a register before they leave.");
    let event = |name: &str, happens: Signal<'_>| {
        let event = m.reg_reset(name, 1, 0);
        event.next(happens);
        event.q
    };
    let events = Events {
        beat_read: beat.valid,
        beat_written: event("beat_written", writes.valid & bus_in.wready),
        read_waits: event("read_waits", reads.valid & !bus_in.arready),
        write_waits: event("write_waits", writes.address_valid & !bus_in.awready),
        datum_waits: event("datum_waits", writes.valid & !bus_in.wready),
        read_error: beat.valid & beat.payload.error,
        write_error,
    };
    let always = m.lit(1u8, 1);
    let m_axi = MasterOutputs {
        awvalid: writes.address_valid,
        aw: writes.address,
        wvalid: writes.valid,
        w: writes.data,
        bready: always,
        arvalid: reads.valid,
        ar: reads.address,
        rready: always,
    };
    let outputs = Outputs {
        read_ready: reads.ready,
        beat,
        write_ready: writes.ready,
        datum_ready: writes.data_ready,
        written,
        m_axi,
        event: events,
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}

/// The read data channel behind a register.
fn received<'b>(
    m: &'b Builder,
    bus: &Bus,
    bus_in: &MasterInputs<Signal<'b>>,
) -> Flow<Beat<Signal<'b>>, Signal<'b>> {
    m.comment(
        "Received channels have a register: the wires from the bus have a cycle of their own.",
    );
    let valid = m.reg_reset("beat_valid_q", 1, 0);
    valid.next(bus_in.rvalid);
    let ReadData {
        rid,
        rdata,
        rresp,
        rlast,
    } = bus_in.r;
    let beat = Beat {
        id: rid,
        data: rdata,
        last: rlast,
        error: rresp.any(),
    };
    let of = Beat::of(bus.id_bits, bus.data_bits);
    Flow::new(valid.q, of.hold("received", beat))
}

/// Whether a write burst has its response, and whether that reports an error.
fn responses<'b>(m: &'b Builder, bus: &Bus, bus_in: &MasterInputs<Signal<'b>>) -> [Signal<'b>; 2] {
    let mine = bus_in.b.bid.eq(m.zero(bus.id_bits));
    let answered = (bus_in.bvalid & mine).named("answered");
    let written = m.reg_reset("written_q", 1, 0);
    written.next(answered);
    let error = m.reg_reset("write_error", 1, 0);
    error.next(answered & bus_in.b.bresp.any());
    [written.q, error.q]
}

/// The read address channel.
struct Reads<'b> {
    ready: Signal<'b>,
    valid: Signal<'b>,
    address: ReadAddress<Signal<'b>>,
}

impl<'b> Reads<'b> {
    /// Offers a burst until it is accepted. The next one is taken when the register is empty: the ready depends on registers alone, and two
    /// cycles for each burst are enough for bursts of two beats.
    fn new(
        m: &'b Builder,
        bus: &Bus,
        inputs: &Inputs<Signal<'b>>,
        beat: &Flow<Beat<Signal<'b>>, Signal<'b>>,
    ) -> Reads<'b> {
        m.comment("Read addresses: one burst is offered at a time.");
        let Flow { valid, payload } = inputs.read;
        let takes = m.wire("takes_read", 1);
        let ends = (beat.valid & beat.payload.last).named("read_ends");
        let outstanding =
            Occupancy::new(true, m, "reads_outstanding", bus.reads, takes.get(), ends);
        let offered = m.reg_reset("read_offered", 1, 0);
        let ready = (outstanding.room & !offered.q).named("read_room");
        takes.drive(valid & ready);
        offered.next(takes.get() | (offered.q & !inputs.m_axi.arready));
        let burst = kept("ar", &Burst::of(bus.id_bits), takes.get(), payload);
        let address = ReadAddress {
            arid: burst.id,
            araddr: burst.address,
            arlen: burst.beats,
            arsize: m.lit(bus.size(), 3),
            arburst: m.lit(INCR, 2),
            arlock: m.zero(1),
            arcache: m.lit(CACHE, 4),
            arprot: m.lit(PROT, 3),
            arqos: m.zero(4),
        };
        Reads {
            ready,
            valid: offered.q,
            address,
        }
    }
}

/// The write address and the write data channel.
struct Writes<'b> {
    ready: Signal<'b>,
    address_valid: Signal<'b>,
    address: WriteAddress<Signal<'b>>,
    data_ready: Signal<'b>,
    valid: Signal<'b>,
    data: WriteData<Signal<'b>>,
}

impl<'b> Writes<'b> {
    /// Offers a burst's address until it is accepted, and its data one after another from the same cycle on. The address of the next burst
    /// may be offered while data are left, but its data follow those of this burst.
    fn new(
        m: &'b Builder,
        bus: &Bus,
        inputs: &Inputs<Signal<'b>>,
        written: Signal<'b>,
    ) -> Writes<'b> {
        m.comment(
            "Write addresses: one burst is offered at a time, and one more may wait for its data.",
        );
        let bus_in = &inputs.m_axi;
        let takes = m.wire("takes_write", 1);
        let outstanding = Occupancy::new(
            true,
            m,
            "writes_outstanding",
            bus.writes,
            takes.get(),
            written,
        );
        let offered = m.reg_reset("write_offered", 1, 0);
        let pending = m.reg_reset("beats_pending", 1, 0);
        let ready = (outstanding.room & !(offered.q | pending.q)).named("write_room");
        takes.drive(inputs.write.valid & ready);
        offered.next(takes.get() | (offered.q & !bus_in.awready));
        let burst = kept("aw", &WriteBurst::of(), takes.get(), inputs.write.payload);

        m.comment("Write data: as many as the burst has beats.");
        let beats_left = m.reg_reset("beats_left", 1, 0);
        let left = m.reg("left_after_next", BEATS_BITS);
        let valid = m.reg_reset("datum_offered", 1, 0);
        let data_ready = (beats_left.q & (!valid.q | bus_in.wready)).named("datum_room");
        let takes_datum = (inputs.datum.valid & data_ready).named("takes_datum");
        let last = left.q.is_zero().named("is_last_datum");
        let finishes = (takes_datum & last).named("data_finish");
        let starts = (pending.q & (!beats_left.q | finishes)).named("data_start");
        pending.next(takes.get() | (pending.q & !starts));
        beats_left.next(starts | (beats_left.q & !finishes));
        let one = m.lit(1u8, BEATS_BITS);
        left.next_when(starts | takes_datum, starts.mux(burst.beats, left.q - one));
        valid.next(takes_datum | (valid.q & !bus_in.wready));
        let WriteBeat { data, strobes } = inputs.datum.payload;
        let datum = WriteData {
            wdata: data,
            wstrb: strobes,
            wlast: last,
        };
        let address = WriteAddress {
            awid: m.zero(bus.id_bits),
            awaddr: burst.address,
            awlen: burst.beats,
            awsize: m.lit(bus.size(), 3),
            awburst: m.lit(INCR, 2),
            awlock: m.zero(1),
            awcache: m.lit(CACHE, 4),
            awprot: m.lit(PROT, 3),
            awqos: m.zero(4),
        };
        Writes {
            ready,
            address_valid: offered.q,
            address,
            data_ready,
            valid: valid.q,
            data: kept("out", &WriteData::of(bus), takes_datum, datum),
        }
    }
}
