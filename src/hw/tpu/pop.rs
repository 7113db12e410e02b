//! Pops: the selection of a packet, and the clip of its popped entry.

use super::clip;
use super::stack::{Entry, Stack};
use super::step::Step;
use crate::bundle;
use crate::hdl::fifo::Placed;
use crate::hdl::{Builder, Bundle, Flow, HdlError, Module, Signal, Specs};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, InContext, Interval, Limit};
use std::sync::Arc;

bundle! {
    /// A packet that is to pop again.
    pub(super) struct Retry(plan: &Plan) {
        push: 1,
        item: InContext::of(plan).width(),
    }
}

/// The packet that pops, in its own pipeline: selected in stage 0. If the target clock requires it, all fields except `valid` are one cycle later.
pub(super) struct Popping<'b> {
    /// The queues of packets that wait for a pop: from the geometry unit, for another pop, and from steps without a next node.
    pub queues: [Placed<'b>; 3],
    pub valid: Signal<'b>,
    /// A word of [`InContext`], and its fields.
    pub word: Signal<'b>,
    pub packet: Signal<'b>,
    pub level: Signal<'b>,
    touched: Signal<'b>,
    /// Whether its stack is empty.
    pub empty: Signal<'b>,
}

/// Queues packets that wait for a pop, and takes one per cycle unless a ray will arrive in the cycle in which the pop would end.
pub(super) fn choose<'b>(
    m: &'b Builder,
    plan: &Plan,
    setup_soon: Signal<'b>,
    done: Flow<InContext<Signal<'b>>, Signal<'b>>,
    retry: Retry<Signal<'b>>,
    step: &Step<'b>,
) -> Result<Popping<'b>, HdlError> {
    let of_word = InContext::of(plan);
    m.comment(
        "Packets that pop: from the geometry unit, from steps without a next node, and again after a dropped entry or an instance \
         that no ray enters.",
    );
    let [take_done, take_retry, take_stepped] =
        ["take_done", "take_retry", "take_stepped_pop"].map(|name| m.wire(name, 1));
    let queue =
        |name, push, word, take: Signal<'b>| plan.queue(name, plan.packets(), push, word, take);
    let word = of_word.pack(done.payload);
    let done_queue = queue("done_queue", done.valid, word, take_done.get())?;
    let retry_queue = queue("retry_queue", retry.push, retry.item, take_retry.get())?;
    let nowhere = (step.valid & !step.goes).named("step_goes_nowhere");
    let word = of_word.pack(InContext {
        packet: step.packet,
        context: step.context,
    });
    let nowhere_queue = queue("nowhere_queue", nowhere, word, take_stepped.get())?;
    let (done_any, retry_any) = (done_queue.valid, retry_queue.valid);
    let nowhere_any = nowhere_queue.valid;
    let may_pop = (!setup_soon).named("may_pop");
    take_retry.drive(may_pop & retry_any);
    let no_retry = (may_pop & !retry_any).hinted("may_pop_and_no_retry");
    take_done.drive(no_retry & done_any);
    take_stepped.drive(no_retry & !done_any & nowhere_any);

    let q = m.pipeline();
    let valid = q
        .enter(may_pop & (retry_any | done_any | nowhere_any))
        .named("pop_valid")
        .cleared_by_reset();
    let choices = [(retry_any, retry_queue.front), (done_any, done_queue.front)];
    let chosen = q.enter(m.priority(&choices, nowhere_queue.front));
    let word = plan.choose(chosen.named("pop_chosen")).named("pop");
    let InContext { packet, context } = of_word.unpack(word);
    let Context { level, touched, .. } = Context::of(plan).unpack(context);
    Ok(Popping {
        queues: [done_queue, retry_queue, nowhere_queue],
        valid,
        word,
        packet,
        level,
        touched,
        empty: level.is_zero().named("stack_empty"),
    })
}

/// The outputs of the pop pipeline, in the cycle in which a pop ends; fields marked as in the pipeline are earlier.
pub(super) struct Popped<'b> {
    /// Cycles from the selection of a packet to the end of its pop.
    pub latency: u32,
    /// The rays that stay, at the stage of the decision; in the pipeline.
    pub stays: Signal<'b>,
    pub done: Signal<'b>,
    pub packet: Signal<'b>,
    /// Whether the stack was empty.
    pub empty: Signal<'b>,
    pub mask: Signal<'b>,
    pub touched: Signal<'b>,
    pub address: Signal<'b>,
    pub leaf: Signal<'b>,
    pub context: Signal<'b>,
    pub level: Signal<'b>,
    pub intervals: Vec<Interval<Signal<'b>>>,
    /// Whether there was an entry and at least one ray stays, and whether there was one and no ray stays.
    pub goes: Signal<'b>,
    pub dropped: Signal<'b>,
}

/// Clips the popped entry to the current closest hits, with one module per ray.
pub(super) fn clip<'b>(
    m: &'b Builder,
    plan: &Plan,
    module: &Arc<Module>,
    limit: Flow<Limit<Signal<'b>>, Signal<'b>>,
    popping: &Popping<'b>,
    stack: &Stack<'b>,
) -> Popped<'b> {
    m.comment("Pop: clip the entry.");
    let entry = Entry::of(plan).unpack(stack.entry.word);
    let (ports, interval) = (clip::ports(plan), Interval::of(plan));
    let touched = popping.touched.at(entry.mask.stage());
    let Limit { packet, ray, value } = limit.payload;
    let clipped = (0..plan.rays()).map(|i| {
        let width = interval.width();
        let within = entry.intervals.part(format!("ray{i}"), i * width, width);
        let is_ray = ray.equals(u128::from(i));
        let given = clip::Inputs {
            limit: Flow::new(limit.valid & is_ray, clip::Limit { packet, value }),
            packet: popping.packet,
            was_in: entry.mask.bit(i),
            entry: interval.unpack(within),
            touched: touched.bit(i),
        };
        ports.place(format!("clip{i}"), m, module, given)
    });
    let clipped: Vec<_> = clipped.collect();
    let stays: Vec<_> = clipped.iter().rev().map(|ray| ray.stays).collect();
    let stays = m.concat(&stays).named("stay_mask");
    let mask = stays.register();
    // The clip of far can take one cycle more than the decision whether a ray stays.
    let latency = mask.stage().max(clipped[0].clipped.far.stage());
    let late = |signal: Signal<'b>| signal.at(latency).untimed();
    let mask = late(mask).named("pop_out_mask");
    let intervals = clipped
        .iter()
        .map(|ray| ray.clipped.map(|_, number| late(number)));
    let intervals = intervals.collect();
    let done = late(popping.valid).named("pop_done");
    let packet = late(popping.packet).named("pop_out_packet");
    let empty = late(popping.empty);
    let (level, touched) = (late(stack.level_below), late(popping.touched));
    let context = Context::of(plan).pack(Context {
        level,
        touched,
        inside: late(entry.inside),
    });
    let has_entry = (done & !empty).hinted("pop_has_entry");
    let any_stays = mask.any().hinted("pop_any_stays");
    Popped {
        latency,
        stays,
        done,
        packet,
        empty,
        mask,
        touched,
        address: late(entry.address),
        leaf: late(entry.leaf),
        context: context.named("pop_out_context"),
        level,
        intervals,
        goes: (has_entry & any_stays).named("pop_goes_on"),
        dropped: (has_entry & !any_stays).named("pop_dropped"),
    }
}
