//! The triangle test as a pipeline: Möller–Trumbore or watertight, and the interval of the ray in the triangle's own box.
//!
//! # Slots
//! One slot enters per cycle. `matrix` is its kind.
//! - 0: a test of a valid ray (0 ≤ tmin ≤ tmax, no NaN) against the triangle v0, v1, v2 within the interval `window_near`,
//!   `window_far`, which consists of results of operators: no NaN, no -0. An arbitrary box is measured as the triangle lo, hi, hi:
//!   `box_near`, `box_far` are the window clipped by it, for any other content of the slot. A vertex with a NaN makes the ray
//!   miss; the box is then undefined.
//! - 1: a matrix. v0, v1, v2 carry the columns c_x, c_y, c_z, `origin` a point p, `translation` the column c_w: in each component
//!   `moved` = ((c_x × p_x + c_y × p_y) + c_z × p_z) + c_w, and `weighted` = moved × `weight`. All other outputs of
//!   the slot are undefined.
//!
//! Both kinds use the same operators (operator sharing, `share.rs`), and their slots can follow each other in any order.
//! While `accumulate` is 1 no slot may be a test, because the six subtractors of the box's plane distances are then adders:
//! `sum_K` = `sum_a_K` + `sum_b_K` for K = 0 … 5, each pair of its own.
//!
//! # Stages
//! Inputs and outputs are at different stages, which are given by the ports of the module ([`crate::hdl::Port::stage`]): an input
//! at stage s is expected s cycles after the first inputs of the slot. Outputs of one kind are at one stage. `accumulate`, `sum_a`,
//! `sum_b` and `sum` do not belong to a slot; only the difference of their stages matters: the cycles from operands to sum.

use super::distance;
use super::fp::{Knowing, Known, Operand, equal, is_finite, is_nan, is_zero, less, less_equal};
use super::plan::{AXES, Plan};
use super::ray::{Interval, Limits, Shear, Tested};
use super::share::{Lender, negated};
use crate::config::TriangleTest;
use crate::hdl::{
    Builder, Bundle, Direction, HdlError, Module, Pipeline, Ports, Signal, Signals, Spec, Specs,
};
use crate::{bundle, interface};
use std::collections::HashMap;
use std::sync::Arc;

type Vector<'b> = [Signal<'b>; 3];

bundle! {
    /// The vertices of a triangle, or three columns of a matrix.
    pub(super) struct Corners(plan: &Plan) {
        v0: [plan.number(); xyz],
        v1: [plan.number(); xyz],
        v2: [plan.number(); xyz],
    }
}

bundle! {
    /// Pairs of numbers to add while `accumulate` is 1.
    pub(super) struct Pairs(plan: &Plan) {
        sum_a: [plan.number(); 6],
        sum_b: [plan.number(); 6],
    }
}

interface! {
    pub(super) (plan: &Plan) {
        in "One slot of the test" {
            matrix: 1,
            corners: ..{Corners}(plan),
            ray: ..{Tested}(plan),
            translation: [plan.number(); xyz],
            weight: plan.number(),
            window: {Interval}(plan),
            shear_z if (plan.watertight()): plan.number(),
            accumulate: 1,
            pairs: ..{Pairs}(plan),
        }
        in "The ray's limits, at a late stage" { limits: ..{Limits}(plan) }
        out "Hit flag, distance and weights" {
            hit: 1,
            t: plan.number(),
            u: plan.number(),
            v: plan.number(),
        }
        out "Transformed point" { moved: [plan.number(); xyz] }
        out "Transformed point times the weight" { weighted: [plan.number(); xyz] }
        out "Interval in the box, and a flag for a miss because of the box" {
            box_near: plan.number(),
            box_far: plan.number(),
        }
        out "Sums, while accumulate is high; independent of the slots" {
            sum: [plan.number(); 6],
        }
    }
}

/// The ports of the two tests.
mod intersection {
    use super::*;

    bundle! {
        /// The result of a test.
        pub struct Test(plan: &Plan) {
            t: plan.number(),
            u: plan.number(),
            v: plan.number(),
            misses: 1,
        }
    }

    interface! {
        pub (plan: &Plan) {
            in "Kind of the slot: 0 for a test, 1 for a matrix" { matrix: 1 }
            in "Vertices of the triangle, or columns x, y, z of the matrix" {
                corners: ..{Corners}(plan),
            }
            in "Origin of the ray, or the point" { origin: [plan.number(); xyz] }
            in "Direction of the ray" { direction if (!plan.watertight()): [plan.number(); xyz] }
            in "Shear of the ray" { shear if (plan.watertight()): ..{Shear}(plan) }
            in "Fourth column of the matrix" { translation: [plan.number(); xyz] }
            in "Weight of the transformed point" { weight: plan.number() }
            in "Reciprocal of the greatest component of the direction" {
                shear_z if (plan.watertight()): plan.number(),
            }
            out "Distance, weights of the second and third vertex, and a flag for a miss" {
                test: {Test}(plan),
            }
            out "Transformed point" { moved: [plan.number(); xyz] }
            out "Transformed point times the weight" { weighted: [plan.number(); xyz] }
        }
    }
}

/// The ports of the triangle's own box.
mod own_box {
    use super::*;

    interface! {
        pub (plan: &Plan) {
            in "Vertices of the triangle" { corners: ..{Corners}(plan) }
            in "Ray" {
                origin: [plan.number(); xyz],
                reciprocal: [plan.number(); xyz],
                signs: 3,
            }
            in "Sums, while accumulate is high; independent of the slots" {
                accumulate: 1,
                pairs: ..{Pairs}(plan),
            }
            in "Interval before the box clips it" { window: {Interval}(plan) }
            out "Interval in the box, and a flag for a miss because of the box" {
                box_near: plan.number(),
                box_far: plan.number(),
                box_misses: 1,
            }
            out "Sums, while accumulate is high; independent of the slots" {
                sum: [plan.number(); 6],
            }
        }
    }
}

/// The number of pairs that are added in parallel while `accumulate` is 1.
const PAIRS: usize = 6;

/// A triangle's own box, and the conditions for a degenerate triangle.
struct OwnBox<'b> {
    /// The least and greatest coordinate on each axis.
    sides: Vec<(Signal<'b>, Signal<'b>)>,
    /// Whether they are equal.
    flat: Vec<Signal<'b>>,
    /// Whether the first and second vertex are equal on each axis, the second and third, the third and first.
    same: [Vec<Signal<'b>>; 3],
}

impl<'b> OwnBox<'b> {
    fn of(plan: &Plan, m: &'b Builder, v: [Vector<'b>; 3]) -> OwnBox<'b> {
        let f = plan.format;
        let mut sides = vec![];
        let mut flat = vec![];
        let mut same = [vec![], vec![], vec![]];
        // A vertex with a NaN makes the determinant a NaN, so the ray misses for any box; a zero of either sign is valid in the box.
        fn any_zero<'b>(coordinate: Signal<'b>) -> Operand<'b> {
            coordinate.known(Known::Number)
        }
        fn number<'b>(coordinate: Signal<'b>) -> Operand<'b> {
            coordinate.known(Known::NoNan)
        }
        for (i, x) in AXES.iter().enumerate() {
            m.comment(format!("The box on the {x} axis."));
            let [v0, v1, v2] = [0, 1, 2].map(|k: usize| any_zero(v[k][i]));
            let lo = plan.settle(plan.min(format!("lo01_{x}"), v0, v1));
            let hi = plan.settle(plan.max(format!("hi01_{x}"), v0, v1));
            let lo = plan.min(format!("lo_{x}"), any_zero(lo), v2).register();
            let hi = plan.max(format!("hi_{x}"), any_zero(hi), v2).register();
            sides.push((lo, hi));
            let name = format!("flat_{x}");
            let is_flat = equal(f, &name, number(lo), number(hi)).named(&name);
            flat.push(is_flat.register());
            for (pair, (j, k)) in [(0, 1), (1, 2), (2, 0)].into_iter().enumerate() {
                let name = format!("same{j}{k}_{x}");
                let is_same = equal(f, &name, number(v[j][i]), number(v[k][i]));
                same[pair].push(is_same.named(name).register());
            }
        }
        OwnBox { sides, flat, same }
    }

    fn is_degenerate(&self, m: &'b Builder) -> Signal<'b> {
        m.comment("Degenerate triangle: two vertices are equal, or the box is flat on two axes.");
        let flat_on = |i: usize, j: usize| {
            (self.flat[i] & self.flat[j]).hinted(format!("flat_{}{}", AXES[i], AXES[j]))
        };
        let flats = [flat_on(0, 1), flat_on(1, 2), flat_on(2, 0)];
        let sames = (self.same.iter().zip(["same01", "same12", "same20"]))
            .map(|(axes, name)| m.and_all(axes).hinted(name));
        let same = m.or_all(&sames.collect::<Vec<_>>()).hinted("any_same");
        (m.or_all(&flats) | same).named("any_degenerate").register()
    }
}

/// Describes the interval of a ray in the triangle's own box, and the check for degenerate triangles.
fn triangle_box(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let f = plan.format;
    let m = Builder::new(
        "triangle_box",
        "the interval of a ray in a triangle's own box, with the same plane distances as in traversal, and the check for degenerate triangles.",
    );
    let p = m.pipeline();
    let ports = own_box::ports(plan);
    let inputs = &ports.inputs;
    let Corners { v0, v1, v2 } = inputs.corners.inputs_at(&p, 0);
    let v = [v0, v1, v2];
    let origin = inputs.origin.each_ref().map(|x| x.input_at(&p, 0));
    let reciprocal = inputs.reciprocal.each_ref().map(|x| x.input_at(&p, 0));
    let signs = inputs.signs.input_at(&p, 0);

    let own = OwnBox::of(plan, &m, v);
    let planes_at = own.sides[0].0.stage();
    let accumulate = inputs.accumulate.input_at(&p, planes_at);
    let Pairs { sum_a, sum_b } = &inputs.pairs;
    let pairs: Vec<_> = std::iter::zip(sum_a, sum_b)
        .map(|(a, b)| (a.input_at(&p, planes_at), b.input_at(&p, planes_at)))
        .collect();
    let lender = Lender::new(&plan.units, accumulate);
    let mut sums = [None; PAIRS];
    // The distance of a plane. Its subtractor adds pair `k` while `accumulate` is 1.
    let mut plane_distance = |name: &str, i: usize, k: usize, plane, far: bool| {
        let (a, b) = pairs[k];
        let plane = lender.choice(&format!("{name}_plane"), plane, a);
        let origin = lender.choice(&format!("{name}_origin"), origin[i], negated(b));
        let offset = plan.units.sub(
            format!("{name}_offset"),
            plane.register(),
            origin.register(),
        );
        sums[k] = Some(offset);
        let up = m.lit(u8::from(far), 1);
        distance::from_offset(name, &plan.units, offset, reciprocal[i], up)
    };
    let mut interval: Option<(Signal<'_>, Signal<'_>)> = None;
    for (i, x) in AXES.iter().enumerate() {
        m.comment(format!("Clip on the {x} axis."));
        let (lo, hi) = own.sides[i];
        let sign = signs.part(x, i as u32, 1);
        let near_plane = sign.mux(hi, lo);
        let n = plane_distance(&format!("near_{x}"), i, i, near_plane, false);
        let far_plane = sign.mux(lo, hi);
        let d = plane_distance(&format!("far_{x}"), i, 3 + i, far_plane, true);
        let (near, far) = interval.unwrap_or_else(|| {
            let at = n.stage();
            let Interval { near, far } = inputs.window.inputs_at(&p, at);
            (near, far)
        });
        interval = Some((
            plan.max(
                format!("near_after_{x}"),
                near.known(Known::Number),
                n.known(Known::Result),
            )
            .register(),
            plan.min(
                format!("far_after_{x}"),
                far.known(Known::Number),
                d.known(Known::Result),
            )
            .register(),
        ));
    }
    let (near, far) = interval.expect("three axes");
    let degenerate = own.is_degenerate(&m);
    let [near_end, far_end] = [near, far].map(|end| end.known(Known::Number));
    let empty = less(f, "empty_interval", far_end, near_end)
        .named("empty_interval")
        .register();
    let end = empty.stage();
    let outputs = own_box::Outputs {
        box_near: near.at(end),
        box_far: far.at(end),
        box_misses: empty | degenerate.at(end),
        sum: sums.map(|sum| sum.expect("a sum for each pair")),
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}

/// The inputs that both tests have in common, and the operand selection for operator sharing.
struct Shared<'b> {
    p: Pipeline<'b>,
    ports: Ports<intersection::Inputs<Spec>, intersection::Outputs<Spec>>,
    lender: Lender<'b>,
    vertices: [Vector<'b>; 3],
    origin: Vector<'b>,
}

impl<'b> Shared<'b> {
    fn new(m: &'b Builder, plan: &Plan) -> Shared<'b> {
        let p = m.pipeline();
        let ports = intersection::ports(plan);
        let matrix = ports.inputs.matrix.input_at(&p, 0);
        let Corners { v0, v1, v2 } = ports.inputs.corners.inputs_at(&p, 0);
        Shared {
            lender: Lender::new(&plan.units, matrix),
            vertices: [v0, v1, v2],
            origin: ports.inputs.origin.each_ref().map(|x| x.input_at(&p, 0)),
            ports,
            p,
        }
    }

    /// The subtrahend called `name`: `own` in a test, +0 in a matrix slot. The minuend then passes unchanged, except for the sign of a
    /// zero, which does not affect the products.
    fn subtracted(&self, name: &str, own: Signal<'b>) -> Signal<'b> {
        let zero = own.module().zero(own.width());
        self.lender.term(name, own, zero)
    }

    /// Component `axis` of the fourth column, at the stage of `other`.
    fn translation(&self, axis: usize, other: Signal<'b>) -> Signal<'b> {
        let translation = &self.ports.inputs.translation[axis];
        translation.input_at(&self.p, other.stage())
    }

    /// The weight, at the stage of `other`.
    fn weight(&self, other: Signal<'b>) -> Signal<'b> {
        let weight = &self.ports.inputs.weight;
        weight.input_at(&self.p, other.stage())
    }

    /// Makes the outputs: t, u, v and the miss flag; the transformed point, and this point times the weight.
    fn finish(
        &self,
        m: &Builder,
        [t, u, v]: Vector<'b>,
        misses: Signal<'b>,
        moved: Vector<'b>,
        weighted: Vector<'b>,
    ) {
        let test = intersection::Test { t, u, v, misses };
        let [of_test, of_moved, of_weighted] =
            [&[t, u, v, misses][..], &moved, &weighted].map(latest);
        let outputs = intersection::Outputs {
            test: test.at(of_test),
            moved: moved.map(|x| x.at(of_moved)),
            weighted: weighted.map(|x| x.at(of_weighted)),
        };
        self.ports.outputs.outputs(m, outputs);
    }
}

/// Describes the test of Möller and Trumbore: t, u, v and the miss flag, before box and limits; a transformed point.
fn moller_trumbore(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let units = &plan.units;
    let m = Builder::new(
        "triangle_moller_trumbore",
        "the ray-triangle test of Moeller and Trumbore. Its operators also apply a matrix to a point.",
    );
    let inputs = Shared::new(&m, plan);
    let Shared {
        ref p,
        ref lender,
        vertices: v,
        origin,
        ..
    } = inputs;
    let direction = (inputs.ports.inputs.direction.as_ref()).expect("this test needs it");
    let direction = direction.each_ref().map(|x| x.input_at(p, 0));

    m.comment("Edges, and the origin relative to the first vertex. Matrix: the columns y and z, and x negated.");
    let base = [0, 1, 2].map(|i| inputs.subtracted(&format!("base_{}", AXES[i]), v[0][i]));
    let e1 = difference(plan, "e1", v[1], base);
    let e2 = difference(plan, "e2", v[2], base);
    // The subtrahend is the column here: the other operand is +0.
    let o = [0, 1, 2].map(|i| inputs.subtracted(&format!("seen_from_{}", AXES[i]), origin[i]));
    let c = difference(plan, "c", o, v[0]);
    m.comment("Matrix: the point replaces the direction, with x negated like its column.");
    let point = [negated(origin[0]), origin[1], origin[2]];
    let d = [0, 1, 2].map(|i| {
        let name = format!("direction_or_point_{}", AXES[i]);
        lender.choice(&name, direction[i], point[i])
    });

    m.comment("The products of d x e2. Matrix: those of column z.");
    let [p_x, p_y, p_z] = [0, 1, 2].map(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let x = AXES[i];
        // These are six of the nine products of d and e2; z × z is not among them.
        let plus = match i {
            0 => lender.factor("direction_y_or_point_z_2", d[1], d[2]),
            _ => d[j],
        };
        [
            units.mul(format!("p_{x}_plus"), plus, e2[k]),
            units.mul(format!("p_{x}_minus"), d[k], e2[j]),
        ]
    });
    let column_z = [p_y[0], p_x[1], p_x[0]];
    m.comment("The products of c x e1. Matrix: plus those of column x, minus those of column y.");
    let q = [0, 1, 2].map(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let x = AXES[i];
        let plus = lender.factor(&format!("q_{x}_plus_factor"), e1[k], d[0]);
        let minus = lender.factor(&format!("q_{x}_minus_factor"), c[k], d[1]);
        [
            units.mul(format!("q_{x}_plus"), c[j], plus),
            units.mul(format!("q_{x}_minus"), minus, e1[j]),
        ]
    });
    m.comment("p = d x e2, q = c x e1. Matrix: the sum of columns x and y; its component y is in q_x, and so on.");
    let pv = [p_x, p_y, p_z];
    let pv = [0, 1, 2].map(|i| units.sub(format!("p_{}", AXES[i]), pv[i][0], pv[i][1]));
    let qv = [0, 1, 2].map(|i| {
        let x = AXES[i];
        let minus = lender.added(&format!("q_{x}_subtrahend"), q[i][1]);
        units.sub(format!("q_{x}"), q[i][0], minus)
    });
    let columns_xy = [qv[2], qv[0], qv[1]];

    m.comment("det = e1 . p, i = 1 / det.");
    let det = dot(plan, "det", e1, pv);
    m.comment("c . p, d . q, e2 . q. Matrix: column z and the translation are added.");
    let dots = [("cp", c, pv), ("dq", d, qv), ("e2q", e2, qv)];
    let [cp, dq, e2q] = [0, 1, 2].map(|component| {
        let (name, a, b) = dots[component];
        let of = products(plan, name, a, b);
        let xy = units.add(
            format!("{name}_xy"),
            lender.term(&format!("{name}_xy_a"), of[0], columns_xy[component]),
            lender.term(&format!("{name}_xy_b"), of[1], column_z[component]),
        );
        let translation = inputs.translation(component, xy);
        let z = lender.term(&format!("{name}_z_or_translation"), of[2], translation);
        units.add(name, xy, z)
    });
    m.comment("u = (c . p) i, v = (d . q) i, t = (e2 . q) i. Matrix: all times the weight.");
    let i = units.reciprocal("i", det);
    let factor = lender.factor("i_or_weight", i, inputs.weight(i));
    let u = units.mul("u", cp, factor);
    let vv = units.mul("v", dq, factor);
    let t = units.mul("t", e2q, factor);
    let sum = units.add("u_plus_v", u, vv);
    let zero = m.zero(w);
    let one = m.lit(u128::from(f.one()), w);
    let none = zero.known(Known::Positive);
    let [u_or_nan, v_or_nan, sum] = [u, vv, sum].map(|weight| weight.known(Known::Result));
    let inside =
        less_equal(f, "u_positive", none, u_or_nan) & less_equal(f, "v_positive", none, v_or_nan);
    let inside = inside.named("weights_positive").register();
    let below = less_equal(f, "below_diagonal", sum, one.known(Known::Positive))
        .named("below_diagonal")
        .register();
    let flat = is_zero(f, det).named("det_is_zero").register();
    let misses = (!inside).hinted("weight_negative") | (!below).hinted("beyond_diagonal") | flat;
    inputs.finish(&m, [t, u, vv], misses, [cp, dq, e2q], [u, vv, t]);
    m.finish()
}

/// The vertices in the frame of the ray, in which the ray is the z axis. In a matrix slot, the columns.
struct Sheared<'b> {
    a: Vector<'b>,
    b: Vector<'b>,
    c: Vector<'b>,
}

impl<'b> Sheared<'b> {
    fn of(plan: &Plan, m: &'b Builder, inputs: &Shared<'b>) -> Sheared<'b> {
        let units = &plan.units;
        let Shared {
            p,
            ports,
            lender,
            vertices,
            origin,
        } = inputs;
        let shear = (ports.inputs.shear.as_ref()).expect("this test needs it");
        let Shear {
            kz,
            shear_x,
            shear_y,
        } = shear.inputs_at(p, 0);
        let shear = [shear_x, shear_y];

        m.comment("Matrix: the columns pass unchanged, as if relative to the origin and along z; the point replaces the shear.");
        let o = [0, 1, 2].map(|i| inputs.subtracted(&format!("seen_from_{}", AXES[i]), origin[i]));
        let kz = lender.choice("axis", kz, m.zero(2));
        let [along_x, along_y] = [0, 1].map(|i| {
            let name = format!("shear_or_point_{}", AXES[i]);
            lender.choice(&name, shear[i], origin[i])
        });

        m.comment("The vertices a, b, c relative to the origin, with permuted axes.");
        let names = ["a", "b", "c"];
        let seen = [0, 1, 2].map(|i| difference(plan, names[i], vertices[i], o));
        // kz is the number of an axis; kx and ky follow it cyclically. In a matrix slot component x is at the position of kz, and so on.
        let pick = |i: usize, choices: [usize; 3]| m.select(kz, &choices.map(|axis| seen[i][axis]));
        let turned = [0, 1, 2].map(|i| {
            let turn = |what: &str, choices| {
                let name = format!("{}_{what}", names[i]);
                pick(i, choices).named(name).register()
            };
            let z = turn("kz", [0, 1, 2]);
            [turn("kx", [1, 2, 0]), turn("ky", [2, 0, 1]), z]
        });
        let [a_turned, b_turned, c_turned] = turned;
        m.comment("The shifts by the shear. Matrix: the products of columns x (times shear x) and y (times shear y), each component once.");
        let shift = |i: usize, along: usize, column: usize, component: usize| {
            let name = format!("{}{}_shift", names[i], AXES[along]);
            // Selected before the register that follows the axis multiplexer in any case.
            let z = match (i, component) {
                (i, 0) if i == column => turned[i][2],
                _ => {
                    let own = pick(i, [0, 1, 2]);
                    lender
                        .choice(&format!("{name}_factor"), own, seen[column][component])
                        .register()
                }
            };
            units.mul(name, [along_x, along_y][along], z)
        };
        let [ax_shift, bx_shift, cx_shift] =
            [(0, 0), (1, 2), (2, 1)].map(|(i, x)| shift(i, 0, 0, x));
        let [ay_shift, by_shift, cy_shift] =
            [(0, 1), (1, 0), (2, 2)].map(|(i, x)| shift(i, 1, 1, x));
        m.comment(
            "Sheared vertices. Matrix: the sum of columns x and y in ax, ay, bx; column z passes in cx, cy.",
        );
        let ax = units.sub(
            "ax",
            lender.term("ax_minuend", a_turned[0], by_shift),
            lender.added("ax_subtrahend", ax_shift),
        );
        let ay = units.sub(
            "ay",
            lender.term("ay_minuend", a_turned[1], cx_shift),
            lender.added("ay_subtrahend", ay_shift),
        );
        let bx = units.sub(
            "bx",
            lender.term("bx_minuend", b_turned[0], cy_shift),
            lender.added("bx_subtrahend", bx_shift),
        );
        let by = units.sub("by", b_turned[1], by_shift);
        let cx = units.sub(
            "cx",
            c_turned[0],
            inputs.subtracted("cx_subtrahend", cx_shift),
        );
        let cy = units.sub(
            "cy",
            c_turned[1],
            inputs.subtracted("cy_subtrahend", cy_shift),
        );
        Sheared {
            a: [ax, ay, a_turned[2]],
            b: [bx, by, b_turned[2]],
            c: [cx, cy, c_turned[2]],
        }
    }

    /// The edge functions u, v, w.
    fn edges(&self, plan: &Plan, m: &'b Builder, inputs: &Shared<'b>) -> Vector<'b> {
        let (units, lender) = (&plan.units, &inputs.lender);
        let point_z = inputs.origin[2];
        let ([ax, ay, _], [bx, by, _], [cx, cy, cz]) = (self.a, self.b, self.c);
        let columns_xy = [ax, ay, bx];
        let column_z = [cz, cx, cy];
        m.comment("Edge functions. Matrix: the products of column z are added to the sum.");
        let eu_plus = units.mul(
            "eu_plus",
            column_z[1],
            lender.factor("eu_factor", by, point_z),
        );
        let eu_minus = units.mul("eu_minus", cy, bx);
        let ev_plus = units.mul(
            "ev_plus",
            lender.factor("ev_factor", ax, point_z),
            column_z[2],
        );
        let ev_minus = units.mul("ev_minus", ay, cx);
        let ew_plus = units.mul(
            "ew_plus",
            lender.factor("ew_factor_b", bx, column_z[0]),
            lender.factor("ew_factor_a", ay, point_z),
        );
        let ew_minus = units.mul("ew_minus", by, ax);
        let edge = |name: &str, plus, minus, component: usize| {
            let minus =
                lender.subtrahend(&format!("{name}_subtrahend"), minus, columns_xy[component]);
            units.sub(name, plus, minus)
        };
        [
            edge("eu", eu_plus, eu_minus, 1),
            edge("ev", ev_plus, ev_minus, 2),
            edge("ew", ew_plus, ew_minus, 0),
        ]
    }
}

/// Whether any edge function is negative, and whether any is positive, one register later.
fn edge_signs<'b>(plan: &Plan, m: &'b Builder, [eu, ev, ew]: Vector<'b>) -> [Signal<'b>; 2] {
    let f = plan.format;
    let none = m.zero(plan.number()).known(Known::Positive);
    let edges =
        [("eu", eu), ("ev", ev), ("ew", ew)].map(|(name, e)| (name, e.known(Known::Result)));
    let negative = edges.map(|(name, e)| less(f, format!("{name}_negative"), e, none));
    let some_negative = m.or_all(&negative).named("some_negative").register();
    let positive = edges.map(|(name, e)| less(f, format!("{name}_positive"), none, e));
    let some_positive = m.or_all(&positive).named("some_positive").register();
    [some_negative, some_positive]
}

/// Describes the watertight test of Woop, Benthin and Wald: t, u, v and the miss flag, before box and limits; a transformed point.
fn watertight(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let f = plan.format;
    let units = &plan.units;
    let m = Builder::new(
        "triangle_watertight",
        "the watertight ray-triangle test of Woop, Benthin and Wald: edge functions of vertices sheared into the ray's frame. \
         Its operators also apply a matrix to a point.",
    );
    let inputs = Shared::new(&m, plan);
    let Shared { p, lender, .. } = &inputs;
    let sheared = Sheared::of(plan, &m, &inputs);
    let [eu, ev, ew] = sheared.edges(plan, &m, &inputs);
    let ([_, _, az], [_, _, bz], [_, _, cz]) = (sheared.a, sheared.b, sheared.c);
    let [some_negative, some_positive] = edge_signs(plan, &m, [eu, ev, ew]);
    m.comment(
        "det = (U + V) + W, i = 1 / det. Matrix: the translation is added, y in U + V, x in det.",
    );
    let translation_y = inputs.translation(1, eu);
    let uv = units.add(
        "uv",
        eu,
        lender.term("ev_or_translation", ev, translation_y),
    );
    let translation_x = inputs.translation(0, uv);
    let det = units.add(
        "det",
        lender.term("uv_or_translation", uv, translation_x),
        ew,
    );
    let i = units.reciprocal("i", det);
    let flat = is_zero(f, det).named("det_is_zero").register();
    m.comment("T = U Az + V Bz + W Cz. Matrix: the translation is added, z in T.");
    let ua = units.mul("ua", eu, az);
    let vb = units.mul("vb", ev, bz);
    let wc = units.mul("wc", ew, cz);
    let ua_vb = units.add("ua_vb", ua, vb);
    let translation_z = inputs.translation(2, ua_vb);
    let scaled = units.add(
        "scaled",
        lender.term("ua_vb_or_sum", ua_vb, ev),
        lender.term("wc_or_translation", wc, translation_z),
    );
    m.comment("t = (T i) Sz, u = V i, v = W i. Matrix: all times the weight; the transformed point replaces V and W.");
    let second = lender.choice("v_or_moved_y", ev, uv);
    let third = lender.choice("w_or_moved_x", ew, det);
    let factor = lender.factor("i_or_weight", i, inputs.weight(i));
    let distance = units.mul("distance", scaled, factor);
    let u = units.mul("u", second, factor);
    let vv = units.mul("v", third, factor);
    let shear_z = (inputs.ports.inputs.shear_z.as_ref()).expect("this test needs it");
    let shear_z = shear_z.input_at(p, distance.stage());
    let t = units.mul("t", distance, shear_z);
    let signs_differ = (some_negative & some_positive).hinted("edge_signs_differ");
    let misses = signs_differ | flat;
    let moved = [third, second, scaled];
    inputs.finish(&m, [t, u, vv], misses, moved, [vv, u, distance]);
    m.finish()
}

/// The latest stage of some signals.
fn latest(signals: &[Signal<'_>]) -> u32 {
    (signals.iter().map(Signal::stage).max()).expect("some signals")
}

fn difference<'b>(plan: &Plan, name: &str, a: Vector<'b>, b: Vector<'b>) -> Vector<'b> {
    [0, 1, 2].map(|i| plan.units.sub(format!("{name}_{}", AXES[i]), a[i], b[i]))
}

/// a_x b_x, a_y b_y, a_z b_z.
fn products<'b>(plan: &Plan, name: &str, a: Vector<'b>, b: Vector<'b>) -> Vector<'b> {
    [0, 1, 2].map(|i| plan.units.mul(format!("{name}_of_{}", AXES[i]), a[i], b[i]))
}

/// (a_x b_x + a_y b_y) + a_z b_z.
fn dot<'b>(plan: &Plan, name: &str, a: Vector<'b>, b: Vector<'b>) -> Signal<'b> {
    let [x, y, z] = products(plan, name, a, b);
    let xy = plan.units.add(format!("{name}_xy"), x, y);
    plan.units.add(name, xy, z)
}

/// Describes the triangle test as a pipeline: the configured test, the box, the clamp, and the check of the ray's limits.
pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let f = plan.format;
    let test = match plan.config.triangle_test {
        TriangleTest::MollerTrumbore => moller_trumbore(plan)?,
        TriangleTest::Watertight => watertight(plan)?,
    };
    let in_box = triangle_box(plan)?;
    let m = Builder::new(
        "triangle_test",
        "the triangle test: a ray against a triangle, with the distance clamped to the ray's interval in the triangle's own box and checked against tmin and tmax; \
         or a matrix times a point.",
    );
    let p = m.pipeline();
    // The inputs of both, at the stages that they need.
    let mut made: HashMap<&str, Signal<'_>> = HashMap::new();
    for module in [&test, &in_box] {
        let ports = module.ports().iter();
        let inputs = ports.filter(|port| port.direction == Direction::Input && port.name != "clk");
        for port in inputs {
            let stage = module.stage(&port.name)?;
            made.entry(&port.name).or_insert_with(|| {
                m.group(port.group.clone());
                p.input_at(&port.name, port.width, stage)
            });
        }
    }
    let (of_test, of_box) = (intersection::ports(plan), own_box::ports(plan));
    let inputs = of_test.inputs.map(|_, spec| made[spec.name.as_str()]);
    let tested = of_test.place("intersection", &m, &test, inputs);
    let inputs = of_box.inputs.map(|_, spec| made[spec.name.as_str()]);
    let boxed = of_box.place("own_box", &m, &in_box, inputs);
    let end = latest(&[tested.test.t, boxed.box_near]);
    m.comment("Clamp t to the interval in the box; a miss of the box is decided before.");
    let t = tested.test.t.at(end);
    let near = boxed.box_near.at(end);
    let far = boxed.box_far.at(end);
    // A NaN is never replaced: a NaN for t is a miss.
    let [near, far] = [near, far].map(|end| end.known(Known::Number));
    let raised = plan.max("raised", t.known(Known::Result), near).register();
    let clamped = plan
        .min("clamped", raised.known(Known::Result), far)
        .register();
    let limits_at = clamped.stage();
    let ports = ports(plan);
    let Limits { tmin, tmax } = ports.inputs.limits.inputs_at(&p, limits_at);
    let misses =
        (tested.test.misses | boxed.box_misses | is_nan(f, tested.test.t).at(end)).named("misses");
    let [least, most] = [tmin, tmax].map(|limit| limit.known(Known::Positive));
    // A NaN is always a miss.
    let distance = clamped.known(Known::Number);
    let within_limits = (less_equal(f, "not_before_tmin", least, distance)
        & less_equal(f, "not_behind_tmax", distance, most)
        & is_finite(f, clamped))
    .named("within_limits");
    let hits = (within_limits & !misses.at(limits_at))
        .named("hits")
        .register();
    let last = limits_at + 1;
    let outputs = Outputs {
        hit: hits,
        t: clamped.at(last),
        u: tested.test.u.at(last),
        v: tested.test.v.at(last),
        moved: tested.moved,
        weighted: tested.weighted,
        box_near: boxed.box_near,
        box_far: boxed.box_far,
        sum: boxed.sum,
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}
