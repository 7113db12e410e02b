//! Bundles that several units know: parts of a ray, and what else passes between units.

use super::plan::Plan;
use crate::bundle;
use crate::hdl::Specs;
use crate::hdl::bundle::{Axes, Xyz, leaf};

bundle! {
    /// Which ray of which packet, and whether it is the first and the last of the packet's rays that come.
    pub struct Place(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        first: 1,
        last: 1,
    }
}

bundle! {
    /// Where a ray runs.
    pub struct Line(plan: &Plan) {
        origin: [plan.number(); xyz],
        direction: [plan.number(); xyz],
    }
}

bundle! {
    /// The distances that count.
    pub struct Limits(plan: &Plan) {
        tmin: plan.number(),
        tmax: plan.number(),
    }
}

bundle! {
    /// A ray's interval in a box.
    pub struct Interval(plan: &Plan) {
        near: plan.number(),
        far: plan.number(),
    }
}

bundle! {
    /// A ray's origin and reciprocal direction on an axis.
    pub struct Along(plan: &Plan) {
        origin: plan.number(),
        reciprocal: plan.number(),
    }
}

bundle! {
    /// What the watertight test turns a ray into the z axis with: the axis that becomes z, and the shear of the two others.
    pub struct Shear(plan: &Plan) {
        kz: 2,
        shear_x: plan.number(),
        shear_y: plan.number(),
    }
}

bundle! {
    /// What the triangle test takes of a ray first.
    pub struct Tested(plan: &Plan) {
        origin: [plan.number(); xyz],
        reciprocal: [plan.number(); xyz],
        signs: 3,
        shear if (plan.watertight()): ..{Shear}(plan),
        direction if (!plan.watertight()): [plan.number(); xyz],
    }
}

bundle! {
    /// A ray that has been set up.
    pub struct SetUp(plan: &Plan) {
        place: ..{Place}(plan),
        /// Whether it is in an object's space.
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
    /// What belongs to a packet beside its rays.
    pub struct Context(plan: &Plan) {
        /// How full its stack is.
        level: plan.level_bits(),
        /// Which rays have hit something.
        touched: plan.rays(),
        /// Whether it is inside an object, in whose space its rays then are.
        inside: 1,
    }
}

bundle! {
    /// A packet somewhere; its context is a word of [`Context`].
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
    /// What a ray's near must not exceed from now on.
    pub struct Limit(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        value: plan.number(),
    }
}

bundle! {
    /// Where a packet starts in an object.
    pub struct Start(plan: &Plan) {
        address: plan.address(),
        leaf: 1,
        context: Context::of(plan).width(),
    }
}

bundle! {
    /// A ray's closest hit.
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
