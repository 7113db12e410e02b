//! The plane distance: (plane − origin) × reciprocal, minus or plus three ulps.

use super::fp::{Units, step_up_or_down};
use super::timing::Timing;
use crate::hdl::{Builder, HdlError, Library, Module, Parameter, Signal, Specs};
use crate::interface;
use std::sync::Arc;

/// The ulps by which a near distance is decreased and a far one increased: they cover the three roundings of the plane distance.
const SLACK: u64 = 3;

interface! {
    pub(super) (number: u32) {
        in "Plane position; the ray's origin and reciprocal direction on the plane's axis" {
            plane: number,
            origin: number,
            reciprocal: number,
        }
        out "Distance, as a multiple of the ray's direction" { distance: number }
    }
}

pub(super) fn near(units: &Units) -> Result<Arc<Module>, HdlError> {
    module(units, false)
}

pub(super) fn far(units: &Units) -> Result<Arc<Module>, HdlError> {
    module(units, true)
}

fn module(units: &Units, far: bool) -> Result<Arc<Module>, HdlError> {
    let library = Library {
        name: "plane_distance",
        doc: "the distance of a ray to a plane, conservative: three ulps less for a near plane (never above the exact distance), three ulps more for a far plane (never below it).",
        parameters: &[Parameter::flag("FAR", "1 for a far plane")],
        values: &|far| vec![u32::from(*far)],
        samples: &[false, true],
        describe: &|far| describe(units, *far),
    };
    library.module(&far)
}

fn describe(units: &Units, far: bool) -> Result<Arc<Module>, HdlError> {
    let (name, doc) = match far {
        false => (
            "near_distance",
            "the distance of a ray to a near plane, three ulps less: never above the exact distance.",
        ),
        true => (
            "far_distance",
            "the distance of a ray to a far plane, three ulps more: never below the exact distance.",
        ),
    };
    let w = units.format.width();
    let m = Builder::new(name, doc);
    let p = m.pipeline();
    let ports = ports(w);
    let inputs = &ports.inputs;
    let plane = inputs.plane.input_at(&p, 0);
    let origin = inputs.origin.input_at(&p, 0);
    let offset = units.sub("offset", plane, origin);
    // The reciprocal is needed at the stage of the difference.
    let reciprocal = (inputs.reciprocal).input_at(&p, offset.stage());
    let distance = {
        // The literal selects a variant; it must not simplify the logic.
        m.simplify(false);
        from_offset("scaled", units, offset, reciprocal, m.lit(u8::from(far), 1))
    };
    ports.outputs.outputs(&m, Outputs { distance });
    m.finish()
}

/// The distance of a plane, given its `offset` from the origin: decreased, or increased if `up` (a far plane).
pub(super) fn from_offset<'b>(
    name: impl AsRef<str>,
    units: &Units,
    offset: Signal<'b>,
    reciprocal: Signal<'b>,
    up: Signal<'b>,
) -> Signal<'b> {
    let exact = units.mul(name, offset, reciprocal);
    let after_sum = |sum: Signal<'b>| match Timing::at(units.clock_mhz).step_sum {
        true => sum.register(),
        false => sum,
    };
    step_up_or_down(units.format, exact, up, SLACK, after_sum).register()
}

/// Instantiates a [`near`] or [`far`] distance as `name` in the module of `plane`.
pub(super) fn place<'b>(
    name: impl AsRef<str>,
    distance: &Arc<Module>,
    plane: Signal<'b>,
    origin: Signal<'b>,
    reciprocal: Signal<'b>,
) -> Signal<'b> {
    let inputs = Inputs {
        plane,
        origin,
        reciprocal,
    };
    ports(plane.width())
        .place(name, plane.module(), distance, inputs)
        .distance
}
