//! The part of one ray in a pop.

use crate::hdl::{Builder, Bundle, Flow, HdlError, Module, Specs, Style};
use crate::hw::fp::{Knowing, Known, less_equal};
use crate::hw::plan::Plan;
use crate::hw::ray::Interval;
use crate::{bundle, interface};
use std::sync::Arc;

bundle! {
    /// A new upper bound for near of the ray.
    pub(super) struct Limit(plan: &Plan) {
        packet: plan.packet_bits(),
        value: plan.number(),
    }
}

interface! {
    pub(super) (plan: &Plan) {
        in "New upper bound for near of the ray, from a closer hit" {
            limit: Flow<Limit>(plan),
        }
        in "Packet that pops; one cycle later the popped entry: whether it contains the ray, the ray's interval in it, \
            and whether the ray has had a hit" {
            packet: plan.packet_bits(),
            was_in: 1,
            entry: {Interval}(plan),
            touched: 1,
        }
        out "High if the ray stays in the entry" { stays: 1 }
        out "Clipped interval of the ray" { clipped: {Interval}(plan) }
    }
}

/// Describes the limit of a ray, which bounds its interval in a stack entry.
pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "tpu_clip",
        "one ray's part of a pop: the ray's closest hit bounds its interval in the popped entry; a ray with an empty interval leaves the entry.",
    );
    let p = m.pipeline();
    let ports = ports(plan);
    let inputs = &ports.inputs;
    let limit = inputs.limit.inputs(&m);
    let packet = inputs.packet.input_at(&p, 0);
    let was_in = inputs.was_in.input_at(&p, 1);
    let Interval { near, far } = inputs.entry.inputs_at(&p, 1);
    let touched = inputs.touched.input_at(&p, 1);
    let limits = m.memory(
        "limit_memory",
        plan.packets(),
        plan.number(),
        Style::Distributed,
    );
    limits.write(limit.valid, limit.payload.packet, limit.payload.value);
    // The limit of an any-hit ray with a hit is minus infinity; that of other rays is a distance.
    let limit = limits.read_now(packet).register().known(Known::Number);
    let near_known = near.known(Known::Positive);
    let within = less_equal(plan.format, "is_within", near_known, limit).named("is_within");
    let stay = (was_in & (within | !touched)).named("stay");
    let nearer = plan.min("far_or_limit", far.known(Known::Number), limit);
    let clipped = Interval {
        near,
        far: touched.mux(nearer, far).named("far"),
    };
    let outputs = Outputs {
        stays: plan.settle(stay),
        clipped: clipped.map(|_, number| plan.settle(number).register()),
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}
