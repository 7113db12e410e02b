//! Ray setup: reciprocals, the shear of the watertight test, and the clip to the scene's box. It processes one ray per cycle.
//!
//! Rays in world space come from the ray port. Rays in object space come from the geometry unit, with their interval in the
//! instance as tmin and tmax; no box clips them further.

use super::distance;
use super::fp::{Knowing, Known, is_nan, is_zero, less_equal};
use super::plan::{AXES, Plan};
use super::ray::{Along, Interval, Limits, Line, Place, SetUp, Shear};
use crate::hdl::{Builder, Bundle, Flow, HdlError, Module, Pipeline, Signal, Signals, Specs};
use crate::interface;
use std::sync::Arc;

interface! {
    pub (plan: &Plan, lookahead: u32) {
        in "Packet and slot of the ray; high if it is the first or the last ray of the packet" {
            valid: 1,
            place: ..{Place}(plan),
        }
        in "High for a ray in object space, which the scene's box does not clip" { object: 1 }
        in "Ray" {
            active: 1,
            any_hit: 1,
            line: ..{Line}(plan),
            limits: ..{Limits}(plan),
        }
        in "Scene's box, constant while rays are in flight" {
            scene_lo: [plan.number(); xyz],
            scene_hi: [plan.number(); xyz],
        }
        out "Ray after setup" {
            out: Flow<SetUp>(plan),
        }
        out (format!("Packet of the ray that leaves {} cycles later", plan.read_latency())) {
            next_packet: plan.packet_bits(),
        }
        out (format!("High {lookahead} cycles before a ray leaves")) { soon: 1 }
    }
}

/// Describes ray setup as a pipeline. `soon` announces a ray `lookahead` cycles before the other outputs. The packet number
/// leaves [`Plan::read_latency`] cycles before them, as a read address.
pub fn module(plan: &Plan, lookahead: u32) -> Result<Arc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let m = Builder::new(
        "ray_setup",
        "ray setup: reciprocals of the direction, shear of the triangle test, and the ray's interval in the scene's box.",
    );
    let p = m.pipeline();
    let ports = ports(plan, lookahead);
    let inputs = &ports.inputs;
    let valid = inputs.valid.input_at(&p, 0).cleared_by_reset();
    let place = inputs.place.inputs_at(&p, 0);
    let object = inputs.object.input_at(&p, 0);
    let active = inputs.active.input_at(&p, 0);
    let any_hit = inputs.any_hit.input_at(&p, 0);
    let line = inputs.line.inputs_at(&p, 0);
    let Line { origin, direction } = line;
    let Limits { tmin, tmax } = inputs.limits.inputs_at(&p, 0);
    let scene =
        [&inputs.scene_lo, &inputs.scene_hi].map(|corner| corner.each_ref().map(|x| x.input(&m)));

    m.comment("A ray is valid if it is active, contains no NaN, and 0 <= tmin <= tmax.");
    let zero = m.zero(w);
    let tmin = is_zero(f, tmin).mux(zero, tmin).named("tmin_clean");
    let tmax = is_zero(f, tmax).mux(zero, tmax).named("tmax_clean");
    let mut nans: Vec<_> = origin
        .iter()
        .chain(&direction)
        .map(|n| plan.decide(is_nan(f, *n)))
        .collect();
    // If tmin is a NaN, it is negative or greater than any tmax that is not a NaN.
    nans.push(plan.decide(is_nan(f, tmax)));
    let any_nan = m.or_all(&nans).named("any_nan").register();
    // The result for a NaN is not used.
    let [least, most] = [tmin, tmax].map(|limit| limit.known(Known::Number));
    let not_negative = less_equal(f, "tmin_not_negative", zero.known(Known::Positive), least);
    let ordered = (not_negative & less_equal(f, "tmin_not_behind_tmax", least, most))
        .named("ordered")
        .register();
    let sound = (active & !any_nan & ordered).named("sound");
    // The limits of a valid ray are not negative; those of an invalid ray are not used.
    let [tmin, tmax] = [tmin, tmax].map(|limit| m.zero(1).concat(limit.low(w - 1)));
    let limits = Limits { tmin, tmax };

    m.comment("Reciprocals and signs of the direction.");
    let reciprocal: Vec<_> = (0..3)
        .map(|i| {
            plan.units
                .reciprocal(format!("reciprocal_{}", AXES[i]), direction[i])
        })
        .collect();
    let signs = m.concat(&[direction[2].msb(), direction[1].msb(), direction[0].msb()]);

    let Interval { near, far } = clipped(plan, &p, object, scene, line, &reciprocal, limits);
    let (least, most) = (near.known(Known::Positive), far.known(Known::Number));
    let enters = (sound & less_equal(f, "meets_box", least, most))
        .named("enters")
        .register();

    let shear = (plan.watertight()).then(|| shear(plan, &m, direction, &reciprocal));
    let out = SetUp {
        place,
        object,
        enters,
        interval: Interval { near, far },
        signs,
        limits,
        any_hit,
        along: [0, 1, 2].map(|i| Along {
            origin: origin[i],
            reciprocal: reciprocal[i],
        }),
        shear: shear.map(|(shear, _)| shear),
        shear_z: shear.map(|(_, shear_z)| shear_z),
        direction: (!plan.watertight()).then_some(direction),
    };

    let ahead = plan.read_latency();
    // All fields of a ray except constants are in the pipeline.
    let stages = out.fields().into_iter().filter_map(|(_, s)| s.staged());
    let last = stages.fold(lookahead.max(ahead), u32::max);
    let outputs = Outputs {
        out: Flow::new(valid.at(last), out.at(last)),
        next_packet: place.packet.at(last - ahead),
        soon: valid.at(last - lookahead),
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}

/// The interval of a ray within its limits and the scene's box. `scene` is the least and the greatest corner of the box.
fn clipped<'b>(
    plan: &Plan,
    p: &Pipeline<'b>,
    object: Signal<'b>,
    scene: [[Signal<'b>; 3]; 2],
    line: Line<Signal<'b>>,
    reciprocal: &[Signal<'b>],
    limits: Limits<Signal<'b>>,
) -> Interval<Signal<'b>> {
    let m = object.module();
    let [scene_lo, scene_hi] = scene;
    m.comment("near and far, clipped to the scene's box; in object space, clipped to (-infinity, +infinity), which has no effect.");
    let infinity = plan.infinity(m);
    let minus_infinity = plan.minus_infinity(m);
    let Limits {
        tmin: mut near,
        tmax: mut far,
    } = limits;
    for (i, axis) in AXES.iter().enumerate() {
        let sign = line.direction[i].msb();
        // The box is constant while rays are in flight, so it needs no delay registers.
        let (lo, hi) = (p.enter_at(scene_lo[i], 0), p.enter_at(scene_hi[i], 0));
        let lo = object
            .mux(minus_infinity, lo)
            .hinted(format!("clip_lo_{axis}"));
        let hi = object.mux(infinity, hi).hinted(format!("clip_hi_{axis}"));
        let near_plane = sign.mux(hi, lo);
        let far_plane = sign.mux(lo, hi);
        let place = |name: String, module: &Arc<Module>, plane| {
            distance::place(name, module, plane, line.origin[i], reciprocal[i])
        };
        let near_distance = place(format!("near_{axis}"), &plan.near_distance, near_plane);
        let far_distance = place(format!("far_{axis}"), &plan.far_distance, far_plane);
        let [near_distance, far_distance] =
            [near_distance, far_distance].map(|distance| distance.known(Known::Result));
        near = plan
            .max(
                format!("near_after_{axis}"),
                near.known(Known::Positive),
                near_distance,
            )
            .register();
        far = plan
            .min(
                format!("far_after_{axis}"),
                far.known(Known::Number),
                far_distance,
            )
            .register();
    }
    Interval { near, far }
}

/// The shear of the watertight test, and the reciprocal of the direction's greatest component.
fn shear<'b>(
    plan: &Plan,
    m: &'b Builder,
    direction: [Signal<'b>; 3],
    reciprocal: &[Signal<'b>],
) -> (Shear<Signal<'b>>, Signal<'b>) {
    let (w, f) = (plan.number(), plan.format);
    m.comment("The shear that maps the ray to the z axis, for the watertight test.");
    let size: Vec<_> = (0..3)
        .map(|i| {
            is_zero(f, direction[i])
                .mux(m.zero(w - 1), direction[i].low(w - 1))
                .named(format!("size_{}", AXES[i]))
        })
        .collect();
    let y_beats_x = size[1].gt(size[0]).named("y_beats_x").register();
    let xy_size = y_beats_x.mux(size[1], size[0]);
    let z_wins = size[2].at(1).gt(xy_size).named("z_wins").register();
    let y_wins = (y_beats_x & !z_wins).named("y_wins");
    let kz = z_wins.concat(y_wins).named("kz");
    let pick = |x, y, z| z_wins.mux(z, y_wins.mux(y, x));
    let dkx = pick(direction[1], direction[2], direction[0])
        .named("direction_kx")
        .register();
    let dky = pick(direction[2], direction[0], direction[1])
        .named("direction_ky")
        .register();
    let rkz = pick(reciprocal[0], reciprocal[1], reciprocal[2])
        .named("reciprocal_kz")
        .register();
    let of = Shear {
        kz,
        shear_x: plan.units.mul("shear_x", dkx, rkz),
        shear_y: plan.units.mul("shear_y", dky, rkz),
    };
    (of, rkz)
}
