//! What is proved of the traversal unit: packets are neither lost nor doubled, its ports keep what they show, a pop reads what was pushed.

use super::Context;
use super::{Entered, Inputs, Pop, Served, Sliced, Stack, Step};
use crate::hdl::{Memory, Proof, Signal, Specs as _, bits_for};
use crate::hw::banks::Banks;
use crate::hw::fifo::Placed;
use crate::hw::plan::Plan;
use crate::hw::properties::shown_stays;

/// The unit's parts, as its description made them.
pub(super) struct Watched<'a, 'b> {
    pub plan: &'a Plan,
    pub inputs: &'a Inputs<Signal<'b>>,
    pub sliced: &'a Sliced<'b>,
    pub step: &'a Step<'b>,
    /// Whether a step's packet goes on.
    pub stepped: Signal<'b>,
    pub stack: &'a Stack<'b>,
    pub pop: &'a Pop<'b>,
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

/// Where packets are: how many, and where one comes and one goes.
struct Place<'b> {
    name: String,
    count: Signal<'b>,
    comes: Signal<'b>,
    goes: Signal<'b>,
}

/// Every packet that the unit was given is in exactly one place, or is finished: so no queue ever holds more than there are packets. It
/// is given no more packets than it has numbers for; memory and geometry unit answer what they were asked.
fn packets<'b>(unit: &Watched<'_, 'b>) {
    let Watched {
        inputs,
        sliced,
        step,
        pop,
        entered,
        nodes,
        leaves,
        finished,
        ..
    } = unit;
    let packets = unit.plan.packets();
    let m = finished.module();
    let proof = m.proof(
        "packets",
        format!("every packet is in one place, no queue overflows; a machine of {packets} packets"),
    );
    // Which way a packet goes.
    proof.cut(step.goes_left);
    proof.cut(step.goes_right);
    proof.cut(pop.stays);
    pop.entry.of_banks.iter().for_each(|word| proof.cut(*word));
    let queues = unit.queues();
    queues.iter().for_each(|queue| queue.keep(&proof));

    let bits = bits_for(u64::from(packets) + 1) + 4;
    let wide = |signal: Signal<'b>| signal.extend(bits);
    let all = m.lit(packets, bits);
    let counter = |name: &str, comes, goes| {
        let counter = proof.reg_reset(name, bits, 0);
        counter.next(counter.q + comes - goes);
        counter.q
    };
    let starts = inputs.setup.valid & inputs.setup.payload.place.last & !inputs.setup_object;
    // A packet that was handed over at an instance comes back as rays set up in the object's space.
    let enters = inputs.setup.valid & inputs.setup.payload.place.last & inputs.setup_object;
    let returns = wide(inputs.done.valid) + wide(enters);
    let requested = wide(nodes.valid & nodes.ready);
    let handed_over = wide(leaves.valid & leaves.ready);
    let answered = wide(inputs.node.response.valid);
    let (pop_begins, pop_ends) = (wide(pop.valid.untimed()), wide(pop.done));
    let total = counter("total", wide(starts), wide(*finished));
    let memory = counter("memory", requested, answered);
    let geometry = counter("geometry", handed_over, returns);
    let stepping = counter("stepping", answered, wide(step.valid));
    let popping = counter("popping", pop_begins, pop_ends);
    let soon = proof.reg_reset("soon", pop.latency, 0);
    soon.next(soon.q.concat(inputs.setup_soon).low(pop.latency));

    proof.assume(
        "setup_soon announces each ray that has been set up",
        inputs.setup.valid.eq(soon.q.msb()),
    );
    proof.assume(
        "no more packets start than there are numbers",
        starts.implies(total.lt(all)),
    );
    proof.assume(
        "node memory answers requests that were made",
        inputs.node.response.valid.implies(memory.any()),
    );
    proof.assume(
        "the geometry unit gives back leaves that it was given",
        geometry.ge(returns),
    );
    proof.cover("a packet is finished", *finished & total.any());

    let registers = |valid: Signal<'b>, last: u32| {
        let mut bits = valid.stages(1..=last);
        bits.reverse();
        m.concat(&bits)
    };
    proof.assert(
        "as many packets are in the step pipeline as its valid bits say",
        stepping.eq(registers(sliced.valid, sliced.decided + 1).count_ones(bits)),
    );
    let pops = registers(pop.valid, pop.latency);
    proof.assert(
        "as many packets are in the pop pipeline as its valid bits say",
        popping.eq(pops.count_ones(bits)),
    );
    proof.assert("no pop ends where a ray arrives", (soon.q & pops).is_zero());

    let place = |name: &str, count, comes, goes| Place {
        name: name.to_string(),
        count,
        comes,
        goes,
    };
    let of_queue = |queue: &&Placed<'b>| Place {
        name: queue.name.clone(),
        count: queue.count(bits),
        comes: wide(queue.push),
        goes: wide(queue.pop),
    };
    let mut places: Vec<_> = queues.iter().map(of_queue).collect();
    let pop_pipeline = place("the pop pipeline", popping, pop_begins, pop_ends);
    places.insert(pop.queues.len(), pop_pipeline);
    // Where a packet goes may have a register of its own.
    if entered.registered {
        let (comes, goes) = (wide(entered.decided), wide(entered.valid));
        places.push(place("what enters", goes, comes, goes));
    }
    places.extend([
        place("memory", memory, requested, answered),
        place("the step pipeline", stepping, answered, wide(step.valid)),
        place("the geometry unit", geometry, handed_over, returns),
    ]);
    // Partial sums, each kept by itself: that the last is the total is then easy to see, clock by clock.
    let (mut change, mut before) = (m.zero(bits), m.zero(bits));
    for (i, place) in places.iter().enumerate() {
        let Place { name, count, .. } = place;
        change = proof.named(&format!("change{i}"), change + place.comes - place.goes);
        let sum = proof.reg_reset(&format!("sum{i}"), bits, 0);
        sum.next(sum.q + change);
        proof.assert(
            format!("packets are neither lost nor doubled up to {name}"),
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
        "no more packets are under way than there are",
        total.le(all),
    );
    for queue in queues {
        proof.assert(
            format!("{} is popped only where it shows a word", queue.name),
            queue.pop.implies(queue.shows()),
        );
        proof.assert(
            format!("nothing is pushed to a full {}", queue.name),
            queue.push.implies(queue.count(bits).lt(all)),
        );
        queue.assert_settles(&proof);
    }
    nodes.assert_held(&proof, "node request");
    leaves.assert_held(&proof, "leaf");
    let [_, retry_queue, nowhere_queue] = &pop.queues;
    proof.fault(
        "a dropped entry's packet is lost",
        retry_queue.push.reads(pop.dropped).as_value(0),
    );
    proof.fault(
        "a packet goes on and ends",
        nowhere_queue.push.reads(step.goes).as_value(0),
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
        self.pop.queues.iter().chain(served).collect()
    }
}

impl<'b> Served<'b> {
    /// That the queue which something that waits is from has it.
    fn assert_held(&self, proof: &Proof<'b>, what: &str) {
        let (preferred, other) = (self.preferred.shows(), self.other.shows());
        let there = self.held.waiting_choice.mux(preferred, other);
        proof.assert(
            format!("the {what} that waits is still in its queue"),
            self.held.waits.implies(there),
        );
    }
}

/// Of the choices between two queues: what is offered and not taken is offered again, from the same queue, which keeps it at its front (a
/// property of the queue). What feeds a queue finds room in it, which [`packets`] shows.
fn choices<'b>(unit: &Watched<'_, 'b>) {
    let m = unit.finished.module();
    let proof = m.proof(
        "choices",
        "node requests and leaves shown stay until taken, each taken from one queue",
    );
    // What is pushed, and when.
    let [_, retry_queue, nowhere_queue] = &unit.pop.queues;
    let pushed = [
        unit.stepped,
        unit.entered.decided,
        retry_queue.push,
        nowhere_queue.push,
    ];
    let words = &unit.pop.entry.of_banks;
    pushed.iter().chain(words).for_each(|cut| proof.cut(*cut));
    for queue in unit.queues() {
        queue.keep(&proof);
        let bits = queue.count_bits() + 1;
        let (count, depth) = (queue.count(bits), m.lit(queue.depth, bits));
        proof.assume(
            "what feeds a queue finds room in it",
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
            format!("a {name} that is not taken stays, from the same queue"),
            shown_stays(&proof, valid, ready, &[served.held.choice]),
        );
        proof.assert(
            format!("one queue is popped where a {name} is taken, none elsewhere"),
            (first ^ second).eq(valid & ready),
        );
        proof.assert(
            format!("no two queues are popped for a {name}"),
            !(first & second),
        );
        proof.fault(
            format!("a waiting {name} gives way"),
            served.held.choice.reads(served.held.waits).as_value(0),
        );
    }
    let &Served { valid, ready, .. } = unit.leaves;
    let refused = proof.past(!m.reset() & valid & !ready);
    proof.cover("a leaf that was not taken is", refused & ready);
}

/// What a pop reads is what was last pushed for that packet at that level, and a packet's level goes up by 1 with a push and down by 1 with
/// a pop. One packet and level, any, are watched. What is pushed, who pops and which level a node's answer brings back may be anything; but
/// a level is assumed to be at most the stack's depth: beyond it the unit has long flagged an overflow.
fn stack<'b>(unit: &Watched<'_, 'b>) {
    let Watched {
        plan,
        step,
        stack,
        pop,
        ..
    } = unit;
    let (packets, levels) = (plan.packets(), plan.config.stack_depth);
    let m = unit.finished.module();
    let proof = m.proof(
        "stack",
        format!(
            "a pop reads what the packet's push at its level wrote; levels count; {packets} packets, {levels} levels"
        ),
    );
    // Clocks from where what pops addresses the stack to where the pop ends.
    let addressed = pop.popping.stage();
    let pops = pop.latency - addressed;
    proof.depth(pops + 1);
    proof.arrays();
    let (packet_of_step, word) = (step.packet, step.push_word);
    let cut = [
        pop.popping,
        step.goes_both,
        step.level_before,
        word,
        packet_of_step,
    ];
    cut.iter().for_each(|cut| proof.cut(*cut));

    let level_bits = plan.level_bits();
    let one = m.lit(1u8, level_bits);
    let depth = m.lit(levels, level_bits);
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
    let pushed_level = step.push_level;
    let may_be = below(packet_of_step, packets) & pushed_level.le(depth);
    proof.assume(
        "a step is of a packet and a level that exist",
        step.push.implies(may_be),
    );

    let (popped_packet, popped_level) = (pop.popping_packet.untimed(), pop.popping_level.untimed());
    let here = packet_of_step.eq(packet) & pushed_level.eq(level);
    let push = proof.named("push", step.push & here & pushed_level.ne(depth));
    let entry_popped = pop.valid.at(addressed).untimed() & !pop.popping_empty.untimed();
    let there = popped_packet.eq(packet) & popped_level.eq(level + one);
    let pop_here = proof.named("pop", entry_popped & there);
    let pushed = proof.reg_reset("pushed", 1, 0);
    let last_word = proof.reg("word", word.width());
    pushed.next(pushed.q | push);
    last_word.next_when(push, word);
    let popped = proof.past(!m.reset() & pop_here & pushed.q);
    let expected = proof.past(last_word.q);
    proof.cover("a word that was pushed is popped", popped);

    let was_reset = proof.past(m.reset());
    let nothing = !stack.write & stack.high_water.q.is_zero() & !stack.overflow.q;
    proof.assert(
        "a clock of reset is enough: nothing is pushed after it, nor counted",
        was_reset.implies(nothing),
    );
    proof.assert(
        "a push to a full stack is not written",
        stack.write.implies(pushed_level.lt(depth)),
    );
    let level_after = stack.level_after;
    proof.assert(
        "a packet's level goes up by 1 where it pushes, else stays",
        (step.valid).implies(level_after.eq(pushed_level + step.push.extend(level_bits))),
    );
    // A wire, so that it is the level in the packet's context that is meant, whatever is packed there.
    let context = proof.wire("context", pop.context.width());
    context.drive(pop.context);
    let (was_level, is_level) = (
        popped_level.delay(pops),
        Context::of(plan).unpack(context.get()).level,
    );
    proof.assert(
        "a packet's level goes down by 1 where it pops",
        (pop.done & was_level.any()).implies(is_level.eq(was_level - one)),
    );
    proof.fault(
        "a full stack is written",
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
        pop.entry.address.reads(pop.level_below).inverted(),
    );

    let place = (packet.low(stack.packet_bits)).concat(level.low(plan.stack_bits()));
    let stays = "what was pushed stays until it is overwritten at its level";
    let reads = "a pop reads what was pushed";
    let (banks, reads_of_banks) = (stack.memory.banks(), &pop.entry.of_banks);
    if let ([(memory, _)], [read]) = (banks, &reads_of_banks[..]) {
        let kept = memory.peek(place).eq(last_word.q);
        proof.assert(stays, pushed.q.implies(kept));
        proof.assert(reads, popped.implies(read.untimed().eq(expected)));
        return;
    }
    // A push is written a clock later, as a pop reads. Its packet cannot pop in the clocks until then: it has yet to ask for its next node.
    let flies = proof.past(push);
    proof.assume(
        "a packet that pushes does not pop before its push is written",
        !(pop_here & (push | flies)),
    );
    let (bank, place) = Banks::split(place);
    // Of the bank that the watched place is in.
    let of_bank = |of_banks: Vec<Signal<'b>>| {
        let (first, others) = of_banks.split_first().expect("a stack has a bank");
        let others = (1u32..).zip(others);
        others.fold(*first, |otherwise, (i, signal)| {
            bank.equals(u128::from(i)).mux(*signal, otherwise)
        })
    };
    let writes = &stack.bank_writes;
    let enable = of_bank(writes.iter().map(|write| write.enable).collect());
    let at_place = |address: Signal<'b>| address.extend(place.width()).eq(place);
    let address = of_bank(writes.iter().map(|write| at_place(write.address)).collect());
    let written = of_bank(writes.iter().map(|write| write.word).collect());
    let peek = |(memory, bits): &(Memory<'b>, u32)| memory.peek(place.low(*bits));
    let stored = of_bank(banks.iter().map(peek).collect());
    let read = of_bank(reads_of_banks.iter().map(|word| word.untimed()).collect());
    let is_written = proof.named("is_written", enable & address);
    let kept = flies.mux(is_written & written.eq(last_word.q), stored.eq(last_word.q));
    proof.assert(stays, pushed.q.implies(kept));
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
            proof.assert(reads, then.implies(read.eq(expected)));
        }
    }
    let chosen = pop.entry.word.untimed();
    proof.assert(
        "the word of its bank is chosen",
        then.implies(chosen.eq(expected)),
    );
    let (bank_of_pop, _) = Banks::split(pop.entry.address);
    proof.fault(
        "the choice between banks takes another bank's word",
        pop.entry.word.reads(bank_of_pop.bit(0)).inverted(),
    );
}
