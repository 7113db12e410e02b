//! Properties of the traversal unit: packets are neither lost nor duplicated, ports are stable, and a pop reads the pushed entry.

use super::Inputs;
use super::enter::Entered;
use super::pop::{Popped, Popping};
use super::serve::Served;
use super::stack::Stack;
use super::step::{Sliced, Step};
use crate::hdl::fifo::Placed;
use crate::hdl::properties::shown_stays;
use crate::hdl::{Memory, Proof, Signal, Specs as _, bits_for};
use crate::hw::banks::Banks;
use crate::hw::plan::Plan;
use crate::hw::ray::Context;

/// The unit's parts, as its description made them.
pub(super) struct Watched<'a, 'b> {
    pub plan: &'a Plan,
    pub inputs: &'a Inputs<Signal<'b>>,
    pub sliced: &'a Sliced<'b>,
    pub step: &'a Step<'b>,
    /// Whether the packet of a step continues.
    pub stepped: Signal<'b>,
    pub stack: &'a Stack<'b>,
    pub popping: &'a Popping<'b>,
    pub pop: &'a Popped<'b>,
    pub entered: &'a Entered<'b>,
    pub nodes: &'a Served<'b>,
    pub leaves: &'a Served<'b>,
    pub finished: Signal<'b>,
}

pub(super) fn describe(unit: &Watched<'_, '_>) {
    packets(unit);
    choices(unit);
    stack(unit);
}

/// A place of packets: their number, and the events of arrival and departure.
struct Place<'b> {
    name: String,
    count: Signal<'b>,
    comes: Signal<'b>,
    goes: Signal<'b>,
}

/// Width of counts of packets.
fn count_bits(unit: &Watched<'_, '_>) -> u32 {
    bits_for(u64::from(unit.plan.packets()) + 1) + 4
}

/// Every accepted packet is in exactly one place, or finished, so no queue ever holds more entries than there are packets.
/// Assumptions: no more packets than packet numbers; memory and the geometry unit respond to requests only.
fn packets<'b>(unit: &Watched<'_, 'b>) {
    let Watched {
        step, popping, pop, ..
    } = unit;
    let packets = unit.plan.packets();
    let m = unit.finished.module();
    let proof = m.proof(
        "packets",
        format!("every packet is in one place, no queue overflows; a machine of {packets} packets"),
    );
    // The decision of a step is arbitrary.
    proof.cut(step.goes_left);
    proof.cut(step.goes_right);
    proof.cut(pop.stays);
    let words = &unit.stack.entry.of_banks;
    words.iter().for_each(|word| proof.cut(*word));
    let queues = unit.queues();
    queues.iter().for_each(|queue| queue.keep(&proof));

    let all = m.lit(packets, count_bits(unit));
    let (total, counted) = counted(&proof, unit);
    proof.cover("a packet is finished", unit.finished & total.any());
    conserved(&proof, unit, total, counted);
    for queue in queues {
        proof.assert(
            format!("{} is popped only while it presents a word", queue.name),
            queue.pop.implies(queue.shows()),
        );
        proof.assert(
            format!("no word is pushed to a full {}", queue.name),
            queue.push.implies(queue.count(count_bits(unit)).lt(all)),
        );
        queue.assert_settles(&proof);
    }
    unit.nodes.assert_held(&proof, "node request");
    unit.leaves.assert_held(&proof, "leaf");
    let [_, retry_queue, nowhere_queue] = &popping.queues;
    proof.fault(
        "a dropped entry's packet is lost",
        retry_queue.push.reads(pop.dropped).as_value(0),
    );
    proof.fault(
        "a packet both continues and ends",
        nowhere_queue.push.reads(step.goes).as_value(0),
    );
}

/// The number of all packets in the unit, and of those in places other than queues: the pop pipeline, memory, the step pipeline and
/// the geometry unit. Makes the assumptions on the environment, and asserts that the valid bits of the pipelines agree with the counts.
fn counted<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>) -> (Signal<'b>, [Place<'b>; 4]) {
    let (inputs, sliced, step) = (unit.inputs, unit.sliced, unit.step);
    let (popping, pop, nodes, leaves) = (unit.popping, unit.pop, unit.nodes, unit.leaves);
    let m = proof.module();
    let bits = count_bits(unit);
    let wide = |signal: Signal<'b>| signal.extend(bits);
    let counter = |register: &str, name: &str, comes, goes| {
        let counter = proof.reg_reset(register, bits, 0);
        counter.next(counter.q + comes - goes);
        Place {
            name: name.to_string(),
            count: counter.q,
            comes,
            goes,
        }
    };
    let starts = inputs.setup.valid & inputs.setup.payload.place.last & !inputs.setup_object;
    // A packet that was dispatched at an instance returns as rays in object space from ray setup.
    let enters = inputs.setup.valid & inputs.setup.payload.place.last & inputs.setup_object;
    let returns = wide(inputs.done.valid) + wide(enters);
    let requested = wide(nodes.valid & nodes.ready);
    let handed_over = wide(leaves.valid & leaves.ready);
    let answered = wide(inputs.node.response.valid);
    let (pop_begins, pop_ends) = (wide(popping.valid.untimed()), wide(pop.done));
    let total = counter("total", "the unit", wide(starts), wide(unit.finished)).count;
    let memory = counter("memory", "memory", requested, answered);
    let geometry = counter("geometry", "the geometry unit", handed_over, returns);
    let steps = wide(step.valid);
    let stepping = counter("stepping", "the step pipeline", answered, steps);
    let pops = counter("popping", "the pop pipeline", pop_begins, pop_ends);
    let soon = proof.reg_reset("soon", pop.latency, 0);
    soon.next(soon.q.concat(inputs.setup_soon).low(pop.latency));

    proof.assume(
        "setup_soon announces each ray from ray setup",
        inputs.setup.valid.eq(soon.q.msb()),
    );
    proof.assume(
        "no more packets start than there are numbers",
        starts.implies(total.lt(m.lit(unit.plan.packets(), bits))),
    );
    proof.assume(
        "node memory responds to requests only",
        inputs.node.response.valid.implies(memory.count.any()),
    );
    proof.assume(
        "the geometry unit completes dispatched leaves only",
        geometry.count.ge(returns),
    );
    let registers = |valid: Signal<'b>, last: u32| {
        let mut bits = valid.stages(1..=last);
        bits.reverse();
        m.concat(&bits)
    };
    let stepping_bits = registers(sliced.valid, sliced.decided + 1);
    proof.assert(
        "the number of packets in the step pipeline is that of its valid bits",
        stepping.count.eq(stepping_bits.count_ones(bits)),
    );
    let popping_bits = registers(popping.valid, pop.latency);
    proof.assert(
        "the number of packets in the pop pipeline is that of its valid bits",
        pops.count.eq(popping_bits.count_ones(bits)),
    );
    proof.assert(
        "no pop ends in a cycle in which a ray arrives",
        (soon.q & popping_bits).is_zero(),
    );
    (total, [pops, memory, stepping, geometry])
}

/// Asserts place by place that a packet that leaves one place arrives at another.
fn conserved<'b>(
    proof: &Proof<'b>,
    unit: &Watched<'_, 'b>,
    total: Signal<'b>,
    [pops, memory, stepping, geometry]: [Place<'b>; 4],
) {
    let m = proof.module();
    let bits = count_bits(unit);
    let all = m.lit(unit.plan.packets(), bits);
    let of_queue = |queue: &&Placed<'b>| Place {
        name: queue.name.clone(),
        count: queue.count(bits),
        comes: queue.push.extend(bits),
        goes: queue.pop.extend(bits),
    };
    let mut places: Vec<_> = unit.queues().iter().map(of_queue).collect();
    places.insert(unit.popping.queues.len(), pops);
    // The destination of a packet can have a register.
    let entered = unit.entered;
    if entered.registered {
        let goes = entered.valid.extend(bits);
        places.push(Place {
            name: "what enters".to_string(),
            count: goes,
            comes: entered.decided.extend(bits),
            goes,
        });
    }
    places.extend([memory, stepping, geometry]);
    // Partial sums in separate registers make it easy for the solver that the last one is the total.
    let (mut change, mut before) = (m.zero(bits), m.zero(bits));
    for (i, place) in places.iter().enumerate() {
        let Place { name, count, .. } = place;
        change = proof.named(&format!("change{i}"), change + place.comes - place.goes);
        let sum = proof.reg_reset(&format!("sum{i}"), bits, 0);
        sum.next(sum.q + change);
        proof.assert(
            format!("packets are neither lost nor duplicated up to {name}"),
            sum.q.eq(before + *count),
        );
        proof.assert(
            format!("{name} holds no more than there are packets"),
            count.le(all),
        );
        before = sum.q;
    }
    proof.assert("every packet is in one place or finished", before.eq(total));
    proof.assert(
        "no more packets are in flight than there are packet numbers",
        total.le(all),
    );
}

impl<'a, 'b> Watched<'a, 'b> {
    fn queues(&self) -> Vec<&'a Placed<'b>> {
        let (nodes, leaves) = (self.nodes, self.leaves);
        let served = [
            &nodes.preferred,
            &nodes.other,
            &leaves.preferred,
            &leaves.other,
        ];
        self.popping.queues.iter().chain(served).collect()
    }
}

impl<'b> Served<'b> {
    /// Asserts that a waiting word is still in its queue.
    fn assert_held(&self, proof: &Proof<'b>, what: &str) {
        let (preferred, other) = (self.preferred.shows(), self.other.shows());
        let there = self.held.waiting_choice.mux(preferred, other);
        proof.assert(
            format!("the {what} that waits is still in its queue"),
            self.held.waits.implies(there),
        );
    }
}

/// Properties of the choice between two queues: an offer that is not accepted is repeated, from the same queue, which keeps it at its
/// front (a property of the queue). Queues are assumed to have room for pushes, which [`packets`] proves.
fn choices<'b>(unit: &Watched<'_, 'b>) {
    let m = unit.finished.module();
    let proof = m.proof(
        "choices",
        "offered node requests and leaves are stable until accepted, and each is taken from one queue",
    );
    // The pushes.
    let [_, retry_queue, nowhere_queue] = &unit.popping.queues;
    let pushed = [
        unit.stepped,
        unit.entered.decided,
        retry_queue.push,
        nowhere_queue.push,
    ];
    let words = &unit.stack.entry.of_banks;
    pushed.iter().chain(words).for_each(|cut| proof.cut(*cut));
    for queue in unit.queues() {
        queue.keep(&proof);
        let bits = queue.count_bits() + 1;
        let (count, depth) = (queue.count(bits), m.lit(queue.depth, bits));
        proof.assume(
            "queues have room for pushes",
            queue.push.implies(count.lt(depth)),
        );
        proof.assert(
            format!("{} holds no more than it has room for", queue.name),
            count.le(depth),
        );
        queue.assert_settles(&proof);
    }
    for (name, served) in [("node request", unit.nodes), ("leaf", unit.leaves)] {
        let &Served { valid, ready, .. } = served;
        let (first, second) = (served.preferred.pop, served.other.pop);
        served.assert_held(&proof, name);
        proof.assert(
            format!("a {name} is stable until it is accepted, from the same queue"),
            shown_stays(&proof, valid, ready, &[served.held.choice]),
        );
        proof.assert(
            format!("one queue is popped when a {name} is accepted, otherwise none"),
            (first ^ second).eq(valid & ready),
        );
        proof.assert(
            format!("no two queues are popped for a {name}"),
            !(first & second),
        );
        proof.fault(
            format!("a waiting {name} is replaced"),
            served.held.choice.reads(served.held.waits).as_value(0),
        );
    }
    let &Served { valid, ready, .. } = unit.leaves;
    let refused = proof.past(!m.reset() & valid & !ready);
    proof.cover("a waiting leaf is accepted", refused & ready);
}

/// One arbitrary packet and level, with its pushes and pops.
struct WatchedEntry<'b> {
    packet: Signal<'b>,
    level: Signal<'b>,
    push: Signal<'b>,
    pop: Signal<'b>,
    /// Whether an entry has been pushed, and the last one.
    pushed: Signal<'b>,
    word: Signal<'b>,
}

/// A pop reads the entry that was last pushed for its packet at its level, and a packet's level increases by 1 with a push and
/// decreases by 1 with a pop. One arbitrary packet and level are watched. Pushed entries, popping packets and the levels in responses
/// are arbitrary, except that a level is at most the depth of the stack: above it the unit has already flagged an overflow.
fn stack<'b>(unit: &Watched<'_, 'b>) {
    let (plan, step, popping) = (unit.plan, unit.step, unit.popping);
    let (packets, levels) = (plan.packets(), plan.config.stack_depth);
    let m = unit.finished.module();
    let proof = m.proof(
        "stack",
        format!(
            "a pop reads the entry of the packet's push at its level; levels count pushes and pops; {packets} packets, {levels} levels"
        ),
    );
    // Cycles from the address of the stack to the end of the pop.
    proof.depth(unit.pop.latency - popping.word.stage() + 1);
    proof.arrays();
    let cut = [
        popping.word,
        step.goes_both,
        step.level_before,
        step.push_word,
        step.packet,
    ];
    cut.iter().for_each(|cut| proof.cut(*cut));
    let entry = watched_entry(&proof, unit);
    levels_count(&proof, unit);
    words_are_kept(&proof, unit, &entry);
}

/// Watches one arbitrary existing packet and level.
fn watched_entry<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>) -> WatchedEntry<'b> {
    let (plan, step, popping) = (unit.plan, unit.step, unit.popping);
    let m = proof.module();
    let (packets, level_bits) = (plan.packets(), plan.level_bits());
    let depth = m.lit(plan.config.stack_depth, level_bits);
    let below = |signal: Signal<'b>, most: u32| {
        let bits = signal.width() + 1;
        signal.extend(bits).lt(m.lit(most, bits))
    };
    let packet = proof.any_const("packet", plan.packet_bits());
    let level = proof.any_const("level", level_bits);
    proof.assume(
        "the watched packet and level exist",
        below(packet, packets) & level.lt(depth),
    );
    let may_be = below(step.packet, packets) & step.push_level.le(depth);
    proof.assume(
        "a step is of a packet and a level that exist",
        step.push.implies(may_be),
    );
    let here = step.packet.eq(packet) & step.push_level.eq(level);
    let push = proof.named("push", step.push & here & step.push_level.ne(depth));
    let addressed = popping.valid.at(popping.word.stage()).untimed();
    let [popped_packet, popped_level, empty] =
        [popping.packet, popping.level, popping.empty].map(Signal::untimed);
    let there = popped_packet.eq(packet) & popped_level.eq(level + m.lit(1u8, level_bits));
    let pop = proof.named("pop", addressed & !empty & there);
    let pushed = proof.reg_reset("pushed", 1, 0);
    let word = proof.reg("word", step.push_word.width());
    pushed.next(pushed.q | push);
    word.next_when(push, step.push_word);
    WatchedEntry {
        packet,
        level,
        push,
        pop,
        pushed: pushed.q,
        word: word.q,
    }
}

/// Asserts that a packet's level increases with a push and decreases with a pop, and that no entry is written above the stack's depth.
fn levels_count<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>) {
    let (step, stack, popping, pop) = (unit.step, unit.stack, unit.popping, unit.pop);
    let m = proof.module();
    let level_bits = unit.plan.level_bits();
    let one = m.lit(1u8, level_bits);
    let depth = m.lit(unit.plan.config.stack_depth, level_bits);
    let was_reset = proof.past(m.reset());
    let nothing = !stack.write & stack.high_water.q.is_zero() & !stack.overflow.q;
    proof.assert(
        "one cycle of reset is enough: no entry is pushed or counted after it",
        was_reset.implies(nothing),
    );
    proof.assert(
        "a push to a full stack is not written",
        stack.write.implies(step.push_level.lt(depth)),
    );
    let level_after = step.push_level + step.push.extend(level_bits);
    proof.assert(
        "a packet's level increases by 1 with a push, else it is unchanged",
        (step.valid).implies(stack.level_after.eq(level_after)),
    );
    // A wire, so that the level in the packet's context is meant, for any content of the context.
    let context = proof.wire("context", pop.context.width());
    context.drive(pop.context);
    let pops = pop.latency - popping.word.stage();
    let (was_level, is_level) = (
        popping.level.untimed().delay(pops),
        Context::of(unit.plan).unpack(context.get()).level,
    );
    proof.assert(
        "a packet's level decreases by 1 with a pop",
        (pop.done & was_level.any()).implies(is_level.eq(was_level - one)),
    );
    proof.fault(
        "a push to a full stack is written",
        stack.write.reads(stack.full).as_value(0),
    );
    proof.fault(
        "a push leaves the packet's level as it was",
        step.next_level.reads(step.goes_both).as_value(0),
    );
    proof.fault(
        "a pop leaves the packet two levels down",
        pop.context.reads(pop.level).as_signal(pop.level - one),
    );
    proof.fault(
        "a pop reads another level",
        stack.entry.address.reads(stack.level_below).inverted(),
    );
}

const STAYS: &str = "a pushed entry is stored until it is overwritten at its level";
const READS: &str = "a pop reads the pushed entry";

/// Asserts that the watched word is in the stack's memory until the next push there, and that a pop reads it.
fn words_are_kept<'b>(proof: &Proof<'b>, unit: &Watched<'_, 'b>, entry: &WatchedEntry<'b>) {
    let stack = unit.stack;
    let m = proof.module();
    let popped = proof.past(!m.reset() & entry.pop & entry.pushed);
    let expected = proof.past(entry.word);
    proof.cover("a word that was pushed is popped", popped);
    let level = entry.level.low(unit.plan.stack_bits());
    let place = (entry.packet.low(stack.packet_bits)).concat(level);
    if let ([(memory, _)], [read]) = (stack.memory.banks(), &stack.entry.of_banks[..]) {
        let kept = memory.peek(place).eq(entry.word);
        proof.assert(STAYS, entry.pushed.implies(kept));
        proof.assert(READS, popped.implies(read.untimed().eq(expected)));
        return;
    }
    words_are_kept_in_banks(proof, stack, entry, place, (popped, expected));
}

/// The same for a memory in banks. Writes and reads are one cycle later. The packet of a push cannot pop in these cycles, because it
/// has yet to request its next node.
fn words_are_kept_in_banks<'b>(
    proof: &Proof<'b>,
    stack: &Stack<'b>,
    entry: &WatchedEntry<'b>,
    place: Signal<'b>,
    (popped, expected): (Signal<'b>, Signal<'b>),
) {
    let flies = proof.past(entry.push);
    proof.assume(
        "a packet that pushes does not pop before its push is written",
        !(entry.pop & (entry.push | flies)),
    );
    let (bank, place) = Banks::split(place);
    // Selects the bank of the watched address.
    let of_bank = |of_banks: Vec<Signal<'b>>| {
        let (first, others) = of_banks.split_first().expect("a stack has a bank");
        let others = (1u32..).zip(others);
        others.fold(*first, |otherwise, (i, signal)| {
            bank.equals(u128::from(i)).mux(*signal, otherwise)
        })
    };
    let (banks, reads, writes) = (
        stack.memory.banks(),
        &stack.entry.of_banks,
        &stack.bank_writes,
    );
    let enable = of_bank(writes.iter().map(|write| write.enable).collect());
    let at_place = |address: Signal<'b>| address.extend(place.width()).eq(place);
    let address = of_bank(writes.iter().map(|write| at_place(write.address)).collect());
    let written = of_bank(writes.iter().map(|write| write.word).collect());
    let peek = |(memory, bits): &(Memory<'b>, u32)| memory.peek(place.low(*bits));
    let stored = of_bank(banks.iter().map(peek).collect());
    let read = of_bank(reads.iter().map(|word| word.untimed()).collect());
    let is_written = proof.named("is_written", enable & address);
    let kept = flies.mux(is_written & written.eq(entry.word), stored.eq(entry.word));
    proof.assert(STAYS, entry.pushed.implies(kept));
    proof.assert(
        "only a push at its level overwrites it",
        is_written.eq(flies),
    );
    let (mut then, mut expected) = (popped, expected);
    for clock in 0..3 {
        let next = proof.reg_reset(&format!("then{clock}"), 1, 0);
        next.next(then);
        (then, expected) = (next.q, proof.past(expected));
        if clock == 0 {
            proof.assert(READS, then.implies(read.eq(expected)));
        }
    }
    let chosen = stack.entry.word.untimed();
    proof.assert(
        "the word of its bank is chosen",
        then.implies(chosen.eq(expected)),
    );
    let (bank_of_pop, _) = Banks::split(stack.entry.address);
    proof.fault(
        "the multiplexer of banks selects the word of another bank",
        stack.entry.word.reads(bank_of_pop.bit(0)).inverted(),
    );
}
