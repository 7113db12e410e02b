//! The register file: the AXI4-Lite slave, doorbells, interrupts, and the snapshot of the counters. The registers are those of
//! [`crate::chip::registers`].

mod properties;

use super::commands::Failure;
use super::counters::Counted;
use crate::chip::registers::{
    self as table, Access, COUNTER_BITS, COUNTERS, interrupt, offset, status,
};
use crate::hdl::{Builder, Bundle, HdlError, Module, Reg, Signal, Specs};
use crate::hw::memory::ADDRESS_BITS;
use crate::hw::plan::Plan;
use crate::hw::raycast::Counters;
use crate::hw::update::Counters as UpdateCounters;
use crate::{bundle, interface};
use std::collections::BTreeMap;
use std::sync::Arc;

/// Width of an address in the register window.
pub const WINDOW_BITS: u32 = table::WINDOW.ilog2();

bundle! {
    /// The signals of an AXI4-Lite bus that its master drives, under the names of the standard.
    pub struct LiteInputs() {
        "AXI4-Lite slave: write address channel" { awvalid: 1, awaddr: WINDOW_BITS, awprot: 3 }
        "AXI4-Lite slave: write data channel" { wvalid: 1, wdata: 32, wstrb: 4 }
        "AXI4-Lite slave: write response channel" { bready: 1 }
        "AXI4-Lite slave: read address channel" { arvalid: 1, araddr: WINDOW_BITS, arprot: 3 }
        "AXI4-Lite slave: read data channel" { rready: 1 }
    }
}

bundle! {
    /// The signals of an AXI4-Lite bus that its slave drives.
    pub struct LiteOutputs() {
        "AXI4-Lite slave: write address channel" { awready: 1 }
        "AXI4-Lite slave: write data channel" { wready: 1 }
        "AXI4-Lite slave: write response channel" { bvalid: 1, bresp: 2 }
        "AXI4-Lite slave: read address channel" { arready: 1 }
        "AXI4-Lite slave: read data channel" { rvalid: 1, rdata: 32, rresp: 2 }
    }
}

interface! {
    pub () {
        in "" { s_axi: {LiteInputs}() }
        out "" { s_axi: {LiteOutputs}() }
        in "From the command processor" {
            start_ready: 1,
            running: 1,
            signalled: 1,
            ended: 1,
            failure: {Failure}(),
        }
        in "Counters of the ray casting unit" { count: {Counters}() }
        in "Counters of the update processor" { update: {UpdateCounters}() }
        in "Counters of the chip" { counted: {Counted}() }
        out "Command list to start" { start_valid: 1, start_address: ADDRESS_BITS }
        out "Interrupt request, high while an enabled event is pending" { irq: 1 }
    }
}

/// Describes the register file of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "registers",
        "the register file: an AXI4-Lite slave with the doorbell, status, interrupts and counters. One access of each kind at a time.",
    );
    let ports = ports();
    let inputs = ports.inputs.inputs(&m);
    let bus = inputs.s_axi;

    m.comment(
        "A write is accepted when address and data are there and the last response has been taken.",
    );
    let responds = m.reg_reset("responds", 1, 0);
    let writes = (bus.awvalid & bus.wvalid & !responds.q).named("writes");
    responds.next(writes | (responds.q & !bus.bready));
    let write = WriteAccess {
        m: &m,
        valid: writes,
        address: bus.awaddr,
        data: bus.wdata,
        strobes: bus.wstrb,
    };

    let control = control(&m, &inputs, &write);
    let snapshot = write.to(offset::SNAPSHOT).named("takes_snapshot");
    let copies = copies(&m, &inputs, snapshot);
    let words = all_words(&m, plan, &control, &copies);

    m.comment("A read takes two cycles: the address is registered, then the selected word.");
    let address = m.reg("read_address", WINDOW_BITS);
    let selects = m.reg_reset("selects", 1, 0);
    let shows = m.reg_reset("shows", 1, 0);
    let data = m.reg("read_data", 32);
    let read_ready = (!selects.q & !shows.q).named("read_ready");
    let reads = (bus.arvalid & read_ready).named("reads");
    selects.next(reads);
    shows.next(selects.q | (shows.q & !bus.rready));
    address.next_when(reads, bus.araddr);
    let last = words.keys().last().expect("there are registers") / 4;
    let bits = last.ilog2() + 1;
    let inside = address
        .q
        .high(WINDOW_BITS - 2 - bits)
        .is_zero()
        .named("is_inside");
    let selected = tree(address.q.field(2, bits), 0, &words).unwrap_or(m.zero(32));
    let selected = selected.named("selected_word");
    data.next_when(selects.q, inside.mux(selected, m.zero(32)));

    let outputs = Outputs {
        s_axi: LiteOutputs {
            awready: writes,
            wready: writes,
            bvalid: responds.q,
            bresp: m.zero(2),
            arready: read_ready,
            rvalid: shows.q,
            rdata: data.q,
            rresp: m.zero(2),
        },
        start_valid: control.queued.q,
        start_address: control.next.q,
        irq: control.interrupt,
    };
    ports.outputs.outputs(&m, outputs);
    properties::serves(&properties::Unit {
        m: &m,
        inputs: &inputs,
        outputs: &outputs,
        write: &write,
        responds,
        address,
        selects,
        control: &control,
        words: &words,
        copies: &copies,
    });
    m.finish()
}

/// The words that are read, by offset: all registers whose reset value or later value is not 0.
fn all_words<'b>(
    m: &'b Builder,
    plan: &Plan,
    control: &Control<'b>,
    copies: &[(Reg<'b>, Signal<'b>)],
) -> BTreeMap<u32, Signal<'b>> {
    let mut words = control.words.clone();
    for register in table::registers(&plan.config) {
        if register.access == Access::ReadOnly && register.reset != 0 {
            let name = format!("{}_VALUE", register.name);
            words.insert(register.offset, m.constant(&name, register.reset, 32));
        }
    }
    for (place, (copy, _)) in copies.iter().enumerate() {
        let [low, high] = table::counter(place);
        words.insert(low, copy.q.low(32));
        words.insert(high, copy.q.high(COUNTER_BITS - 32).extend(32));
    }
    words
}

/// A write to the registers.
struct WriteAccess<'b> {
    m: &'b Builder,
    valid: Signal<'b>,
    address: Signal<'b>,
    data: Signal<'b>,
    strobes: Signal<'b>,
}

impl<'b> WriteAccess<'b> {
    /// Whether a register is written.
    fn to(&self, offset: u32) -> Signal<'b> {
        let word = self.address.high(WINDOW_BITS - 2);
        self.valid & word.equals(u128::from(offset / 4))
    }

    /// The bits that the strobes select.
    fn mask(&self) -> Signal<'b> {
        let lanes: Vec<_> = (0..4)
            .rev()
            .map(|k| self.strobes.bit(k).repeat(8))
            .collect();
        self.m.concat(&lanes)
    }

    /// Stores what is written to a register, byte by byte; bits above the register's width are dropped.
    fn store(&self, register: &Reg<'b>, offset: u32) {
        let width = register.q.width();
        let mask = self.mask().low(width);
        let merged = (self.data.low(width) & mask) | (register.q & !mask);
        register.next_when(self.to(offset), merged);
    }
}

/// Doorbell, status and interrupts.
struct Control<'b> {
    words: BTreeMap<u32, Signal<'b>>,
    /// The registers, for the words and for the properties.
    list: Reg<'b>,
    queued: Reg<'b>,
    next: Reg<'b>,
    code: Reg<'b>,
    descriptor: Reg<'b>,
    value: Reg<'b>,
    enable: Reg<'b>,
    pending: Reg<'b>,
    interrupt: Signal<'b>,
}

fn control<'b>(
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    write: &WriteAccess<'b>,
) -> Control<'b> {
    m.comment("A doorbell starts the list, or queues it; behind a queued list it has no effect.");
    let list = m.reg_reset("list", ADDRESS_BITS, 0);
    write.store(&list, offset::LIST);
    let rings = write.to(offset::DOORBELL).named("rings");
    let queued = m.reg_reset("is_queued", 1, 0);
    let next = m.reg("next_list", ADDRESS_BITS);
    let starts = (queued.q & inputs.start_ready).named("list_starts");
    let is_accepted = (rings & !queued.q).named("doorbell_accepted");
    let is_lost = (rings & queued.q).named("doorbell_lost");
    queued.next(is_accepted | (queued.q & !starts));
    next.next_when(is_accepted, list.q);

    m.comment("How the last list has ended.");
    let failure = inputs.failure;
    let failed = failure.code.any().named("has_failed");
    let code = m.reg_reset("error_code", failure.code.width(), 0);
    let descriptor = m.reg_reset("error_descriptor", ADDRESS_BITS, 0);
    let value = m.reg_reset("error_address", ADDRESS_BITS, 0);
    code.next_when(
        starts | inputs.ended,
        starts.mux(m.zero(code.q.width()), failure.code),
    );
    descriptor.next_when(inputs.ended, failure.descriptor);
    value.next_when(inputs.ended, failure.value);

    m.comment("Interrupts.");
    let enable = m.reg_reset("interrupt_enable", interrupt::COUNT, 0);
    write.store(&enable, offset::INTERRUPT_ENABLE);
    let pending = m.reg_reset("interrupt_status", interrupt::COUNT, 0);
    let mut events = [m.zero(1); interrupt::COUNT as usize];
    events[interrupt::END as usize] = inputs.ended & !failed;
    events[interrupt::SIGNAL as usize] = inputs.signalled;
    events[interrupt::ERROR as usize] = inputs.ended & failed;
    events[interrupt::OVERRUN as usize] = is_lost;
    events.reverse();
    let clears = write.to(offset::INTERRUPT_STATUS).repeat(interrupt::COUNT);
    let clears = clears & write.data.low(interrupt::COUNT) & write.mask().low(interrupt::COUNT);
    pending.next((pending.q & !clears) | m.concat(&events));

    let mut state = [m.zero(1); 3];
    state[status::BUSY as usize] = inputs.running;
    state[status::QUEUED as usize] = queued.q;
    state[status::OVERRUN as usize] = pending.q.bit(interrupt::OVERRUN);
    state.reverse();
    let words = [
        (offset::LIST, list.q),
        (offset::STATUS, m.concat(&state)),
        (offset::ERROR_CODE, code.q),
        (offset::ERROR_DESCRIPTOR, descriptor.q),
        (offset::ERROR_ADDRESS, value.q),
        (offset::INTERRUPT_STATUS, pending.q),
        (offset::INTERRUPT_ENABLE, enable.q),
    ];
    Control {
        words: words.map(|(at, word)| (at, word.extend(32))).into(),
        list,
        queued,
        next,
        code,
        descriptor,
        value,
        enable,
        pending,
        interrupt: (pending.q & enable.q).any(),
    }
}

/// The counters' copies, in the order of the table, with what they copy.
fn copies<'b>(
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    snapshot: Signal<'b>,
) -> Vec<(Reg<'b>, Signal<'b>)> {
    m.comment("The copies of the counters: all of one cycle.");
    let of_core = inputs.count.fields().into_iter();
    let of_update = inputs.update.fields().into_iter();
    let of_chip = inputs.counted.fields().into_iter();
    let all = of_core.chain(of_update).chain(of_chip);
    let all = all.map(|(_, count)| count);
    let copy = |(count, (name, _)): (Signal<'b>, &(&str, &str))| {
        let copy = m.reg_reset(format!("copy_{name}"), COUNTER_BITS, 0);
        copy.next_when(snapshot, count);
        (copy, count)
    };
    all.zip(COUNTERS).map(copy).collect()
}

/// Selects the word at the number `index`: a tree of multiplexers. `first` is the number of the first word of the subtree. `None` where
/// no register is in the subtree.
fn tree<'b>(
    index: Signal<'b>,
    first: u32,
    words: &BTreeMap<u32, Signal<'b>>,
) -> Option<Signal<'b>> {
    let bits = index.width();
    let half = 1 << (bits - 1);
    let side = |start: u32| match bits {
        1 => words.get(&(4 * start)).copied(),
        _ => tree(index.low(bits - 1), start, words),
    };
    match (side(first), side(first + half)) {
        (None, None) => None,
        (Some(low), None) => Some(index.msb().mux(low.module().zero(32), low)),
        (None, Some(high)) => Some(index.msb().mux(high, high.module().zero(32))),
        (Some(low), Some(high)) => Some(index.msb().mux(high, low)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The counters of the table are those that are counted, in their order.
    #[test]
    fn the_counters_are_those_of_the_table() {
        let of_core = Counters::of().fields();
        let of_update = UpdateCounters::of().fields().into_iter();
        let of_update = of_update.map(|(name, width)| (format!("update_{name}"), width));
        let of_update: Vec<_> = of_update.collect();
        let of_chip = Counted::of().fields();
        let all = of_core.iter().chain(&of_update).chain(&of_chip);
        let names = all.map(|(name, _)| name.as_str());
        let expected = COUNTERS.iter().map(|(name, _)| *name);
        assert_eq!(names.collect::<Vec<_>>(), expected.collect::<Vec<_>>());
    }
}
