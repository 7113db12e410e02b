//! Bundles shared by several units: parts of a ray, and other data between units.

use super::plan::Plan;
use crate::bundle;
use crate::hdl::Specs;
use crate::hdl::bundle::{Axes, Xyz, leaf};

bundle! {
    /// The packet and the slot of a ray, and flags for the first and last ray of the packet.
    pub struct Place(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        first: 1,
        last: 1,
    }
}

bundle! {
    /// The origin and the direction of a ray.
    pub struct Line(plan: &Plan) {
        origin: [plan.number(); xyz],
        direction: [plan.number(); xyz],
    }
}

bundle! {
    /// The range of valid distances.
    pub struct Limits(plan: &Plan) {
        tmin: plan.number(),
        tmax: plan.number(),
    }
}

bundle! {
    /// The interval of a ray in a box.
    pub struct Interval(plan: &Plan) {
        near: plan.number(),
        far: plan.number(),
    }
}

bundle! {
    /// The origin and the reciprocal direction of a ray on one axis.
    pub struct Along(plan: &Plan) {
        origin: plan.number(),
        reciprocal: plan.number(),
    }
}

bundle! {
    /// The shear that maps a ray to the z axis in the watertight test: the axis that becomes z, and the shear of the other two.
    pub struct Shear(plan: &Plan) {
        kz: 2,
        shear_x: plan.number(),
        shear_y: plan.number(),
    }
}

bundle! {
    /// The operands from a ray that the triangle test takes at its first stage.
    pub struct Tested(plan: &Plan) {
        origin: [plan.number(); xyz],
        reciprocal: [plan.number(); xyz],
        signs: 3,
        shear if (plan.watertight()): ..{Shear}(plan),
        direction if (!plan.watertight()): [plan.number(); xyz],
    }
}

bundle! {
    /// A ray after ray setup.
    pub struct SetUp(plan: &Plan) {
        place: ..{Place}(plan),
        /// Whether it is in object space.
        object: 1,
        /// Whether it is valid and enters the scene or the object.
        enters: 1,
        interval: ..{Interval}(plan),
        signs: 3,
        limits: ..{Limits}(plan),
        any_hit: 1,
        along: ..{Axes<Along> = [(); 3].map(|()| Along::of(plan))},
        shear if (plan.watertight()): ..{Shear}(plan),
        shear_z if (plan.watertight()): plan.number(),
        direction if (!plan.watertight()): [plan.number(); xyz],
    }
}

bundle! {
    /// The context of a packet.
    pub struct Context(plan: &Plan) {
        /// The number of entries on its stack.
        level: plan.level_bits(),
        /// The hit mask: the rays that have had a hit.
        touched: plan.rays(),
        /// Whether it is in object space.
        inside: 1,
    }
}

bundle! {
    /// A packet and its context, a word of [`Context`].
    pub struct InContext(plan: &Plan) {
        packet: plan.packet_bits(),
        context: Context::of(plan).width(),
    }
}

bundle! {
    /// A leaf for the geometry unit.
    pub struct Leaf(plan: &Plan) {
        packet: plan.packet_bits(),
        address: plan.address(),
        context: Context::of(plan).width(),
        mask: plan.rays(),
    }
}

bundle! {
    /// A new upper bound for near of a ray.
    pub struct Limit(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        value: plan.number(),
    }
}

bundle! {
    /// The start of a packet in an object.
    pub struct Start(plan: &Plan) {
        address: plan.address(),
        leaf: 1,
        context: Context::of(plan).width(),
    }
}

bundle! {
    /// The closest hit of a ray.
    pub struct Hit(plan: &Plan) {
        t: plan.number(),
        u: plan.number(),
        v: plan.number(),
        instance: 32,
        triangle: 32,
    }
}

bundle! {
    /// A vector without a name of its own.
    pub struct Vector(plan: &Plan) {
        axes: ..{Xyz = [(); 3].map(|()| leaf(plan.number()))},
    }
}
