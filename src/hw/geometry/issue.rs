//! Slot issue: issues the rays of complete leaves to the test, one per cycle, or influences of the skinning processor.

use super::fetch::Fetch;
use super::{Fetched, Inputs};
use crate::hdl::fifo;
use crate::hdl::{Builder, HdlError, Memory, Pipeline, Signal, Specs, Style};
use crate::hw::plan::Plan;

/// The slots of a ray transformation, in their order.
const BOX_SLOT: u128 = 0;
const DIRECTION_SLOT: u128 = 1;
pub(super) const ORIGIN_SLOT: u128 = 2;

/// The signals of slot issue for the properties. The issued slot is [`Slot`].
pub(super) struct Issue<'b> {
    /// The mask of each packet's leaf.
    pub masks: Memory<'b>,
    pub queue: fifo::Placed<'b>,
    /// The leaf at the queue's front.
    pub ready: Fetched<Signal<'b>>,
    /// Whether the rays of a leaf are being issued; then the leaf, the remaining rays, and the slot of the ray.
    pub busy: Signal<'b>,
    pub now_packet: Signal<'b>,
    pub now_instance: Signal<'b>,
    pub now_mask: Signal<'b>,
    pub slot: Signal<'b>,
    pub ray: Signal<'b>,
    /// Whether it is the last slot of the ray, and the last slot of the leaf.
    pub last_slot: Signal<'b>,
    pub now_last: Signal<'b>,
    /// Whether another leaf can be accepted.
    pub idle_next: Signal<'b>,
    now_first: Signal<'b>,
}

impl<'b> Issue<'b> {
    /// Whether a test slot is issued.
    pub fn is_test(&self) -> Signal<'b> {
        self.busy & !self.now_instance
    }

    /// Whether the transformation slot of this number is issued.
    pub fn is_transform(&self, slot: u128) -> Signal<'b> {
        let transforming = (self.busy & self.now_instance).hinted("transforming");
        transforming & self.slot.equals(slot)
    }
}

/// The data of a slot in the pipeline of the test. Stage 0 is the cycle of issue.
pub(super) struct Slot<'b> {
    pub pipeline: Pipeline<'b>,
    /// Whether a ray is tested.
    pub test: Signal<'b>,
    /// Whether the slot transforms a ray: box (interval in the instance's box), direction, or origin.
    pub in_box: Signal<'b>,
    pub direction: Signal<'b>,
    pub origin: Signal<'b>,
    /// The packet, or the low bits of a joint.
    pub packet: Signal<'b>,
    /// The high bits of a joint, if it has more; 0 in a packet's slot.
    pub joint_high: Option<Signal<'b>>,
    pub ray: Signal<'b>,
    /// Whether the ray is the first of its leaf, and whether the slot is the last of its leaf.
    pub first: Signal<'b>,
    pub last: Signal<'b>,
    /// Whether the packet is in object space.
    pub inside: Signal<'b>,
    /// The address of the ray in memories by ray, and in memories by space and ray.
    pub index: Signal<'b>,
    pub level_index: Signal<'b>,
    /// Whether the skinning processor uses the test, and the same one cycle later. The flag is constant for a whole mesh, so the
    /// additional register is harmless; it keeps a fan-out to hundreds of operands off the first stage of the operators.
    skinning: Signal<'b>,
    skinning_held: Signal<'b>,
}

impl<'b> Slot<'b> {
    /// Whether the skinning processor uses the test, for signals at a stage.
    pub fn skinning_at(&self, stage: u32) -> Signal<'b> {
        let skinning = match stage {
            0 => self.skinning,
            _ => self.skinning_held,
        };
        self.pipeline.enter_at(skinning, stage)
    }
}

/// Takes complete leaves in order, each after the last slot of the previous one, and issues one slot per cycle: one per ray in the
/// mask of a triangle, three per ray in the mask of an instance.
pub(super) fn issue<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    fetch: &Fetch<'b>,
) -> Result<Issue<'b>, HdlError> {
    let packets = plan.packets();
    let masks = m.memory("mask_memory", packets, plan.rays(), Style::Distributed);
    let leaf = inputs.leaf.payload;
    masks.write(fetch.leaf.taken, leaf.packet, leaf.mask);
    m.comment(
        "The rays in a complete leaf's mask enter the test, one slot per cycle: one slot per ray for a triangle, three for an instance \
        (box, direction, origin).",
    );
    let take_ready = m.wire("take_ready", 1);
    let fetched = Fetched::of(plan);
    let queue = plan.queue(
        "ready_queue",
        packets,
        fetch.arrival.complete,
        fetched.pack(fetch.arrival.of),
        take_ready.get(),
    )?;
    let ready = fetched.unpack(queue.front);
    let ready_mask = masks.read_now(ready.packet);
    let busy = m.reg_reset("busy", 1, 0);
    let now_packet = m.reg("now_packet", plan.packet_bits());
    let now_instance = m.reg("now_instance", 1);
    let now_mask = m.reg("now_mask", plan.rays());
    let now_first = m.reg("now_first", 1);
    let slot = m.reg("slot", 2);
    let (ray, rest_mask) = lowest(m, now_mask.q, plan.ray_bits());
    let origin_next = slot.q.equals(ORIGIN_SLOT).hinted("slot_is_origin");
    let last_slot = (!now_instance.q | origin_next).named("last_slot");
    let now_last = (last_slot & rest_mask.is_zero()).named("now_last");
    let idle_next = (!busy.q | now_last).named("takes_next");
    let takes = (idle_next & queue.valid).named("takes");
    take_ready.drive(takes);
    busy.next(m.priority(&[(idle_next, queue.valid)], m.lit(1u8, 1)));
    now_packet.next_when(takes, ready.packet);
    now_instance.next_when(takes, ready.instance);
    let next_ray = (takes | last_slot).hinted("next_ray");
    now_mask.next_when(next_ray, takes.mux(ready_mask, rest_mask));
    now_first.next_when(next_ray, takes);
    slot.next(next_ray.mux(m.zero(2), slot.q + m.lit(1u8, 2)));
    Ok(Issue {
        queue,
        ready,
        busy: busy.q,
        now_packet: now_packet.q,
        now_instance: now_instance.q,
        now_mask: now_mask.q,
        slot: slot.q,
        ray,
        last_slot,
        now_last,
        idle_next,
        now_first: now_first.q,
        masks,
    })
}

/// The issued slot, at stage 0 of a new pipeline. During skinning the fields of the packet carry a joint.
pub(super) fn enter<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    issue: &Issue<'b>,
) -> Slot<'b> {
    m.comment("The data of a slot in the pipeline.");
    let p = m.pipeline();
    let test = p.enter(issue.is_test()).cleared_by_reset();
    // The state after a reset is overwritten before the first packet uses it.
    let in_box = p.enter(issue.is_transform(BOX_SLOT).named("in_box_slot"));
    let direction = p.enter(
        issue
            .is_transform(DIRECTION_SLOT)
            .named("in_direction_slot"),
    );
    let origin = p
        .enter(issue.is_transform(ORIGIN_SLOT).named("in_origin_slot"))
        .cleared_by_reset();
    // The fields of the packet carry the low bits of a joint; an additional field carries its high bits.
    let (skinning, joint) = (inputs.skinning, inputs.skin_issue.payload.influence.joint);
    let (joint_width, pb) = (joint.width(), plan.packet_bits());
    let joint_low = joint.extend(joint_width.max(pb)).low(pb);
    let packet = skinning
        .mux(joint_low, issue.now_packet)
        .named("packet_or_joint");
    let packet = p.enter(packet);
    let joint_high = (joint_width > pb).then(|| {
        let high = joint.high(joint_width - pb);
        p.enter((high & skinning.repeat(joint_width - pb)).named("joint_high"))
    });
    let ray = p.enter(issue.ray);
    let inside = p.enter((inputs.instanced & !issue.now_instance).named("now_inside"));
    let index = plan.ray_index(packet, ray).named("test_index");
    Slot {
        pipeline: p,
        test,
        in_box,
        direction,
        origin,
        packet,
        joint_high,
        ray,
        first: p.enter(issue.now_first),
        last: p.enter(issue.now_last),
        inside,
        index,
        level_index: inside.concat(index).named("test_level_index"),
        skinning,
        skinning_held: skinning.register().named("skinning_held"),
    }
}

/// The index of the lowest bit that is set, and the mask without this bit.
fn lowest<'b>(m: &'b Builder, mask: Signal<'b>, bits: u32) -> (Signal<'b>, Signal<'b>) {
    let width = mask.width();
    let choices: Vec<_> = (0..width)
        .map(|i| (mask.bit(i), m.lit(u128::from(i), bits)))
        .collect();
    let number = m
        .priority(&choices[..choices.len() - 1], choices[choices.len() - 1].1)
        .named("issue_ray");
    let rest = (mask & (mask - m.lit(1u8, width))).named("rest_mask");
    (number, rest)
}
