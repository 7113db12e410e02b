//! The stack of all packets.

use super::pop::Popping;
use super::step::Step;
use crate::bundle;
use crate::hdl::{Builder, Reg, Signal, Specs, bits_for};
use crate::hw::banks::{BankRead, BankWrite, Banks};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Interval};

bundle! {
    /// An entry of the stack.
    pub(super) struct Entry(plan: &Plan) {
        address: plan.address(),
        leaf: 1,
        inside: 1,
        mask: plan.rays(),
        intervals: plan.rays() * Interval::of(plan).width(),
    }
}

/// The stack, with its push and its pop.
pub(super) struct Stack<'b> {
    pub memory: Banks<'b>,
    /// Width of the packet number in its address.
    pub packet_bits: u32,
    pub full: Signal<'b>,
    pub write: Signal<'b>,
    pub bank_writes: Vec<BankWrite<'b>>,
    /// Entries on the stack after a push.
    pub level_after: Signal<'b>,
    pub overflow: Reg<'b>,
    pub high_water: Reg<'b>,
    /// The packet's level after the pop, and the popped entry; in the pipeline of pops.
    pub level_below: Signal<'b>,
    pub entry: BankRead<'b>,
}

/// Writes the entry that a step pushes, in the cycle in which the step ends; reads the entry of a packet that pops, with the latency
/// of [`Banks`].
pub(super) fn stack<'b>(
    m: &'b Builder,
    plan: &Plan,
    step: &Step<'b>,
    popping: &Popping<'b>,
) -> Stack<'b> {
    m.comment("The stack.");
    let entries = plan.packets() << plan.stack_bits();
    let memory = Banks::new(plan, m, "stack", entries, Entry::of(plan).width());
    let packet_bits = bits_for(u64::from(entries)) - plan.stack_bits();
    let place = |packet: Signal<'b>, level: Signal<'b>, name| {
        let place = (packet.low(packet_bits)).concat(level.low(plan.stack_bits()));
        place.hinted(name)
    };
    let full = step.push_level.equals(u128::from(plan.config.stack_depth));
    let full = full.named("stack_full");
    let write = (step.push & !full).named("stack_write");
    let push_place = place(step.packet, step.push_level, "push_place");
    let bank_writes = memory.write(write, push_place, step.push_word);
    let overflow = m.reg_reset("overflow", 1, 0);
    overflow.next(overflow.q | (step.push & full));
    let high_water = m.reg_reset("high_water", plan.level_bits(), 0);
    let level_after = Context::of(plan).unpack(step.context).level;
    high_water.next_when(step.push & high_water.q.lt(level_after), level_after);
    let one = m.lit(1u8, plan.level_bits());
    let level_below = (popping.level - one).named("level_below");
    let entry = memory.read(plan, place(popping.packet, level_below, "pop_place"));
    Stack {
        memory,
        packet_bits,
        full,
        write,
        bank_writes,
        level_after,
        overflow,
        high_water,
        level_below,
        entry,
    }
}
