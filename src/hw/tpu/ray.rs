//! One ray of every packet in the traversal unit: its memories, and its part of a traversal step.

use super::slice::{self, Outputs as Goes, Side};
use crate::bkd::layout::fields::Planes;
use crate::hdl::{Builder, HdlError, Module, Signals, Specs, Style};
use crate::hw::plan::Plan;
use crate::hw::ray::Interval;
use crate::{bundle, interface};
use std::sync::Arc;

bundle! {
    /// The data of a ray for a traversal step.
    pub(super) struct RayWord(plan: &Plan) {
        origin: [plan.number(); xyz],
        reciprocal: [plan.number(); xyz],
        signs: 3,
    }
}

bundle! {
    /// A write of a ray's interval.
    pub(super) struct Write(plan: &Plan) {
        write: 1,
        interval: ..{Interval}(plan),
    }
}

interface! {
    pub(super) (plan: &Plan) {
        in "Ray from ray setup, and its address: the space (1 for object space) and the packet number" {
            setup_write: 1,
            setup_packet: plan.level_packet_bits(),
            setup: {RayWord}(plan),
        }
        in "Interval of the ray in the packet's next node, from a pop or a start" {
            popped_packet: plan.packet_bits(),
            popped: {Write}(plan),
        }
        in "Response with a node: its packet and, when the ray has been read, the axes and planes of the children" {
            packet: plan.level_packet_bits(),
            left_axis: 2,
            right_axis: 2,
            planes: ..{Planes}(plan.format),
        }
        in "Packet, at a later stage; with the distances: whether it comes from a pop or a start, the ray's interval \
        from a step, and whether the ray is in the node" {
            late_packet: plan.packet_bits(),
            from_pop: 1,
            stepped: {Interval}(plan),
            active: 1,
        }
        out "" { goes: ..{Goes}(plan) }
    }
}

/// Describes the memories of a ray and the slice that follows them. Stage 0 is the response with the node.
pub(super) fn module(plan: &Plan, slice: &Arc<Module>) -> Result<Arc<Module>, HdlError> {
    let builder = Builder::new(
        "tpu_ray",
        "one ray of every packet in the traversal unit: the ray, its interval after a pop or a start, and its part of a \
         traversal step.",
    );
    let m = &builder;
    let p = m.pipeline();
    let (ports, of_slice) = (ports(plan), slice::ports(plan));
    let inputs = &ports.inputs;
    let latency = plan.read_latency();
    let setup_write = inputs.setup_write.input(m);
    let setup_packet = inputs.setup_packet.input(m);
    let setup = inputs.setup.inputs(m);
    let popped_packet = inputs.popped_packet.input(m);
    let popped = inputs.popped.inputs(m);
    let packet = inputs.packet.input_at(&p, 0);
    let axes = [&inputs.left_axis, &inputs.right_axis].map(|axis| axis.input_at(&p, latency));
    let planes = inputs.planes.inputs_at(&p, latency + 1);
    let interval_at = latency + 1 + of_slice.inputs.ray.near.stage(m, slice);
    let late_packet = inputs.late_packet.input_at(&p, interval_at - latency);
    let from_pop = inputs.from_pop.input_at(&p, interval_at);
    let stepped = inputs.stepped.inputs_at(&p, interval_at);
    let active = inputs.active.input_at(&p, interval_at);

    m.comment("The ray in world space and, in the upper half, in object space: the ray in world space is needed again when the packet leaves the object.");
    let of_word = RayWord::of(plan);
    let rays = m.memory(
        "ray_memory",
        plan.level_packets(),
        of_word.width(),
        Style::Block,
    );
    rays.write(setup_write, setup_packet, of_word.pack(setup));
    let ray = of_word.unpack(plan.read(rays, packet));
    let side = |name: &str, axis| {
        let along = |what: &str, of: &[_; 3]| {
            m.select(axis, of)
                .named(format!("{name}_{what}"))
                .register()
        };
        Side {
            sign: along("sign", &[0, 1, 2].map(|axis| ray.signs.bit(axis))),
            origin: along("origin", &ray.origin),
            reciprocal: along("reciprocal", &ray.reciprocal),
        }
    };
    let [left, right] = axes;
    let (left, right) = (side("left", left), side("right", right));

    m.comment("The interval of the ray in the packet's node.");
    let of_interval = Interval::of(plan);
    let intervals = m.memory(
        "popped_memory",
        plan.packets(),
        of_interval.width(),
        Style::Block,
    );
    intervals.write(
        popped.write,
        popped_packet,
        of_interval.pack(popped.interval),
    );
    let popped = of_interval.unpack(plan.read(intervals, late_packet));
    let given = slice::Inputs {
        planes,
        left,
        right,
        ray: from_pop.choose(popped, stepped).named("ray"),
        ray_active: active,
    };
    let goes = of_slice.place("slice", m, slice, given);
    ports.outputs.outputs(m, Outputs { goes });
    builder.finish()
}
