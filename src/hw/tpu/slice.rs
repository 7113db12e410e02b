//! The part of one ray in a traversal step.

use crate::bkd::layout::fields::Planes;
use crate::hdl::{Builder, HdlError, Module, Signals, Specs};
use crate::hw::distance;
use crate::hw::fp::{Knowing, Known, Operand, less_equal};
use crate::hw::plan::Plan;
use crate::hw::ray::Interval;
use crate::{bundle, interface};
use std::sync::Arc;

bundle! {
    /// The ray on the axis of one child.
    pub(super) struct Side(plan: &Plan) {
        sign: 1,
        origin: plan.number(),
        reciprocal: plan.number(),
    }
}

interface! {
    pub(super) (plan: &Plan) {
        in "Intervals of the node" {
            planes: ..{Planes}(plan.format),
        }
        in "Ray on the axes of the left and the right child" {
            left: {Side}(plan),
            right: {Side}(plan),
        }
        in "Interval of the ray in the node, at the stage of the distances" {
            ray: {Interval}(plan),
            ray_active: 1,
        }
        out "Intervals of the ray in the children, and the children that it enters" {
            out_left: {Interval}(plan),
            out_right: {Interval}(plan),
            to_left: 1,
            to_right: 1,
            left_before_right: 1,
        }
    }
}

/// Describes the part of one ray in a traversal step: its interval in both children, and the children that it enters.
pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let f = plan.format;
    let m = Builder::new(
        "tpu_slice",
        "one ray's part of a traversal step: four plane distances, the interval in each child, and the children that the ray enters.",
    );
    let p = m.pipeline();
    let ports = ports(plan);
    let inputs = &ports.inputs;
    let planes = inputs.planes.inputs_at(&p, 0);
    let sides = [&inputs.left, &inputs.right].map(|side| side.inputs_at(&p, 0));
    let distance_latency = plan.near_distance.stage("distance")?;
    // For a valid ray 0 <= tmin <= near, and near and far are never NaN.
    let Interval { near, far } = inputs.ray.inputs_at(&p, distance_latency);
    let active = inputs.ray_active.input_at(&p, distance_latency);

    let mut intervals = vec![];
    for (name, side, lo, hi) in [
        ("left", sides[0], planes.left_lo, planes.left_hi),
        ("right", sides[1], planes.right_lo, planes.right_hi),
    ] {
        m.comment(format!("The {name} child: select near and far planes by the sign of the direction, then clip near and far."));
        let Side {
            sign,
            origin,
            reciprocal,
        } = side;
        let near_plane = sign
            .mux(hi, lo)
            .named(format!("{name}_near_plane"))
            .register();
        let far_plane = sign
            .mux(lo, hi)
            .named(format!("{name}_far_plane"))
            .register();
        let place = |which: &str, module: &Arc<Module>, plane| {
            let instance = format!("{name}_{which}_distance");
            distance::place(instance, module, plane, origin, reciprocal)
        };
        let near_distance = place("near", &plan.near_distance, near_plane);
        let far_distance = place("far", &plan.far_distance, far_plane);
        let near = plan.max(
            format!("{name}_near_clipped"),
            near.known(Known::Positive),
            near_distance.known(Known::Result),
        );
        let far = plan.min(
            format!("{name}_far_clipped"),
            far.known(Known::Number),
            far_distance.known(Known::Result),
        );
        let near = near.register().known(Known::Positive);
        intervals.push((near, far.register().known(Known::Number)));
    }
    m.comment("The children that the ray enters.");
    let (left_near, left_far) = intervals[0];
    let (right_near, right_far) = intervals[1];
    let compare = |name: &str, a, b| plan.decide(less_equal(f, name, a, b));
    let goes_left = (active & compare("left_is_met", left_near, left_far)).named("goes_left");
    let goes_right = (active & compare("right_is_met", right_near, right_far)).named("goes_right");
    let left_first = (goes_left & goes_right & compare("left_is_nearer", left_near, right_near))
        .named("both_left_first");
    let [left, right] = [(left_near, left_far), (right_near, right_far)].map(|(near, far)| {
        let [near, far] = [near, far].map(Operand::signal);
        Interval { near, far }
    });
    let outputs = Outputs {
        out_left: left,
        out_right: right,
        to_left: goes_left,
        to_right: goes_right,
        left_before_right: left_first,
    };
    let end = left_first.stage() + 1;
    ports.outputs.outputs(&m, outputs.at(end));
    m.finish()
}
