//! The traversal step: the children that each ray enters, then the packet's next node.

use super::enter::PoppedWires;
use super::kept::{Kept, Requested, Stepped, SteppedWrite};
use super::ray::{self, RayWord};
use super::slice::Outputs as Goes;
use super::stack::Entry;
use super::start::Start;
use super::{Inputs, StepTrace};
use crate::bkd::layout::fields::{Node, Planes};
use crate::bundle;
use crate::hdl::{Builder, Module, Signal, Signals, Specs, Wire, Wires};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Interval};
use std::sync::Arc;

/// The step pipeline up to the results of the rays. Stage 0 is the cycle of the response with the node.
pub(super) struct Sliced<'b> {
    pub valid: Signal<'b>,
    packet: Signal<'b>,
    node: Signal<'b>,
    request: Requested<Signal<'b>>,
    rays: Vec<Goes<Signal<'b>>>,
    /// The stage of the results of the rays.
    pub decided: u32,
}

/// Combines a node from memory with the packet's rays and the stored state of the packet, with one module per ray. Rays are written
/// there by ray setup, and intervals by pops and starts.
pub(super) fn slices<'b>(
    m: &'b Builder,
    plan: &Plan,
    module: &Arc<Module>,
    inputs: &Inputs<Signal<'b>>,
    start: &Start<'b>,
    popped: &PoppedWires<'b>,
    kept: &Kept<'b>,
) -> Sliced<'b> {
    let answer = inputs.node.response;
    let interval = Interval::of(plan);
    m.comment("The traversal step. A node from memory enters with the packet's rays.");
    let p = m.pipeline();
    let valid = p.enter(answer.valid).cleared_by_reset();
    let level_packet = p.enter(answer.payload.tag);
    let packet = level_packet.low(plan.packet_bits()).named("packet");
    let node = p.enter(answer.payload.data);
    let of_planes = Planes::of(plan.format);
    let planes = of_planes.unpack(node.low(of_planes.width())).named("");
    let [left_axis, right_axis] = axes(plan, node);

    // Intervals are needed later than rays.
    let ports = ray::ports(plan);
    let at = ports.inputs.active.stage(m, module);
    let late_packet = packet.at(at - plan.read_latency());
    let latest_packet = packet.at(at - 1);
    let request = kept.requests.read_now(latest_packet).register();
    let request = Requested::of(plan).unpack(request);
    let stepped = Stepped::of(plan).unpack(plan.read(kept.stepped, late_packet));
    let popped_mask = kept.popped_masks.read_now(latest_packet).register();
    let mask_in = request.popped.mux(popped_mask, stepped.mask);
    let mask_in = mask_in.named("mask_in");

    let setup = inputs.setup.payload;
    let setup_packet = inputs.setup_object.concat(setup.place.packet);
    let setup_packet = setup_packet.hinted("setup_level_packet");
    let rays = (0u32..).zip(&popped.rays).map(|(i, write)| {
        let width = interval.width();
        let stepped = (stepped.intervals).part(format!("ray{i}"), i * width, width);
        let given = ray::Inputs {
            setup_write: start.of_ray[i as usize],
            setup_packet,
            setup: RayWord {
                origin: setup.origin,
                reciprocal: setup.reciprocal,
                signs: setup.signs,
            },
            popped_packet: popped.packet.packet.get(),
            popped: write.get(),
            packet: level_packet,
            left_axis,
            right_axis,
            planes,
            late_packet,
            from_pop: request.popped,
            stepped: interval.unpack(stepped),
            active: mask_in.bit(i),
        };
        ports.place(format!("ray{i}"), m, module, given).goes
    });
    let rays: Vec<_> = rays.collect();
    Sliced {
        valid,
        packet,
        node,
        request,
        decided: rays[0].out_left.near.stage(),
        rays,
    }
}

/// The axes of a node's children, left and right.
fn axes<'b>(plan: &Plan, node: Signal<'b>) -> [Signal<'b>; 2] {
    let of_node = Node::of(plan.format);
    let axis = |spec| of_node.get(node, spec).named(&spec.name);
    let left = axis(&of_node.link.left_axis);
    match plan.config.axes_per_node {
        // One axis bounds both children, so the axis of the right one is the same.
        1 => [left; 2],
        _ => [left, axis(&of_node.link.right_axis)],
    }
}

bundle! {
    /// A child of a node, and the rays that enter it.
    pub(super) struct Child(plan: &Plan) {
        leaf: 1,
        address: plan.address(),
        mask: plan.rays(),
        intervals: plan.rays() * Interval::of(plan).width(),
    }
}

/// The result of a traversal step: the packet's next node or leaf, and the entry that it pushes. Fields are in the cycle in which the
/// step ends, except those marked as in the pipeline.
pub(super) struct Step<'b> {
    pub valid: Signal<'b>,
    pub packet: Signal<'b>,
    /// Whether any ray enters the left child, the right child, and both; the stack levels before and after. In the pipeline.
    pub goes_left: Signal<'b>,
    pub goes_right: Signal<'b>,
    pub goes_both: Signal<'b>,
    pub level_before: Signal<'b>,
    pub next_level: Signal<'b>,
    /// Whether the packet has a next node or leaf; its address, and the packet's context.
    pub goes: Signal<'b>,
    pub first: Child<Signal<'b>>,
    pub context: Signal<'b>,
    pub push: Signal<'b>,
    /// The number of entries on the stack before the push.
    pub push_level: Signal<'b>,
    pub push_word: Signal<'b>,
    pub trace: Option<StepTrace<Signal<'b>>>,
}

/// Decides the step. The packet first visits the child that its rays enter only or first; the other child is pushed. The step ends
/// one cycle after the results of the rays.
pub(super) fn decide<'b>(
    m: &'b Builder,
    plan: &Plan,
    sliced: &Sliced<'b>,
    stepped: SteppedWrite<Wire<'b>>,
) -> Step<'b> {
    let (rays, decided) = (&sliced.rays, sliced.decided);
    m.comment("The decision for the packet.");
    let gather = |of: fn(&Goes<Signal<'b>>) -> Signal<'b>| {
        let bits: Vec<_> = rays.iter().rev().map(of).collect();
        m.concat(&bits)
    };
    let to_left = gather(|ray| ray.to_left).named("to_left");
    let to_right = gather(|ray| ray.to_right).named("to_right");
    let goes_left = to_left.any().named("goes_left");
    let goes_right = to_right.any().named("goes_right");
    let some_left_first = gather(|ray| ray.left_before_right)
        .hinted("left_before_right")
        .any();
    let left_first = (goes_left & (some_left_first | !goes_right)).named("left_first");
    let intervals_of = |of: fn(&Goes<Signal<'b>>) -> Interval<Signal<'b>>| {
        let interval = Interval::of(plan);
        let parts = rays.iter().rev().map(|ray| interval.pack(of(ray)));
        m.concat(&parts.collect::<Vec<_>>())
    };
    let left_intervals = intervals_of(|ray| ray.out_left).named("left_intervals");
    let right_intervals = intervals_of(|ray| ray.out_right).named("right_intervals");
    let own = sliced.request.address.at(decided).named("own_address");
    let [(left_leaf, left_address), (right_leaf, right_address)] = children(plan, sliced, own);
    let left = Child {
        leaf: left_leaf,
        address: left_address,
        mask: to_left,
        intervals: left_intervals,
    };
    let right = Child {
        leaf: right_leaf,
        address: right_address,
        mask: to_right,
        intervals: right_intervals,
    };
    let first = left_first.choose(left, right).named("first");
    let second = left_first.choose(right, left).named("second");

    let of_context = Context::of(plan);
    let context = of_context.unpack(sliced.request.context.at(decided));
    let both = (goes_left & goes_right).named("goes_both");
    let valid = sliced.valid.at(decided);
    let pushes = (both & valid).named("pushes").cleared_by_reset();
    let next_level = (context.level + both.extend(plan.level_bits())).named("next_level");
    let next_context = of_context.pack(Context {
        level: next_level,
        ..context
    });
    let late = |signal: Signal<'b>| signal.at(decided + 1).untimed();
    let valid = late(valid).named("step_valid");
    let packet = late(sliced.packet).named("step_packet");
    let goes = late((goes_left | goes_right).named("goes_on"));
    let first = first.register().untimed();
    let context_after = late(next_context.named("next_context"));
    (stepped.write).drive((valid & goes).named("step_goes_on"));
    stepped.packet.drive(packet);
    stepped.kept.drive(Stepped {
        intervals: first.intervals,
        mask: first.mask,
    });
    let level_before = context.level.named("level_before");
    let push_word = Entry::of(plan).pack(Entry {
        address: second.address,
        leaf: second.leaf,
        inside: context.inside,
        mask: second.mask,
        intervals: second.intervals,
    });
    let trace = plan.trace.then(|| StepTrace {
        packet,
        node: late(own),
        left: late(to_left),
        right: late(to_right),
        left_first: late(left_first),
        left_intervals: late(left_intervals),
        right_intervals: late(right_intervals),
    });
    Step {
        valid,
        packet,
        goes_left,
        goes_right,
        goes_both: both,
        level_before,
        next_level,
        goes,
        first,
        context: context_after,
        push: late(pushes),
        push_level: late(level_before),
        push_word: late(push_word.named("push_word")),
        trace,
    }
}

/// The kind (leaf or node) and the address of each child, left and right. A leaf has the address of its node, or that of the link.
fn children<'b>(
    plan: &Plan,
    sliced: &Sliced<'b>,
    own: Signal<'b>,
) -> [(Signal<'b>, Signal<'b>); 2] {
    let m = own.module();
    let (node, a) = (sliced.node, plan.address());
    let of_node = Node::of(plan.format);
    let of_link = &of_node.link;
    let link = of_node.get(node, &of_link.link).low(a).named("link");
    let [left_leaf, right_leaf] = [
        (&of_link.left_leaf, "left_leaf"),
        (&of_link.right_leaf, "right_leaf"),
    ]
    .map(|(spec, name)| of_node.get(node, spec).named(name));
    let link_after = (link + m.lit(1u8, a)).named("link_after");
    let right_inner = left_leaf.mux(link, link_after);
    let right_inner = right_inner.hinted("right_inner_address").register();
    let late = |signal: Signal<'b>| signal.at(sliced.decided);
    let (left_is_leaf, right_is_leaf) = (late(left_leaf), late(right_leaf));
    let left_address = left_is_leaf.mux(own, late(link)).named("left_address");
    let right_address = right_is_leaf
        .mux(left_is_leaf.mux(late(link), own), late(right_inner))
        .named("right_address");
    [(left_is_leaf, left_address), (right_is_leaf, right_address)]
}
