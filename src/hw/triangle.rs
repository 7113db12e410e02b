//! The triangle test as a pipeline: Möller–Trumbore or watertight, and the ray's interval in the triangle's own box.
//!
//! # Slots
//! One slot enters a clock. `matrix` says what it is.
//! - 0: a test. The ray, a valid one (0 ≤ tmin ≤ tmax, no NaN), against the triangle v0, v1, v2, from the interval `window_near`,
//!   `window_far`, which operators gave: no NaN, no -0. Any box is measured as the triangle lo, hi, hi: `box_near`, `box_far` are
//!   the window clipped by it, whatever else the slot says. A vertex with a NaN makes the ray miss; the box then means nothing.
//! - 1: a matrix. v0, v1, v2 carry the columns c_x, c_y, c_z, `origin` a point p, `translation` the column c_w: in each component
//!   `moved` = ((c_x × p_x + c_y × p_y) + c_z × p_z) + c_w, and `weighted` = moved × `weight`. Everything else of
//!   the slot has no meaning.
//!
//! All of this is done by the test's own operators (`share.rs`), so slots of both kinds follow each other in any order.
//! While `accumulate` is 1 no slot may be a test, as the six subtractors of the box's plane distances are adders then:
//! `sum_K` = `sum_a_K` + `sum_b_K` for K = 0 … 5, each pair of its own.
//!
//! # Stages
//! Inputs and outputs are at differing stages, which the module's ports tell ([`crate::hdl::Port::stage`]): an input at stage
//! s must be given s clocks after the slot's first ones. Outputs of one kind are at one stage. `accumulate`, `sum_a`, `sum_b` and
//! `sum` belong to no slot; only the difference of their stages matters: the clocks from operands to sum.

use super::distance;
use super::fp::{Knowing, Known, Operand, equal, is_finite, is_nan, is_zero, less, less_equal};
use super::plan::{AXES, Plan};
use super::ray::{Interval, Limits, Tested};
use super::share::{Lender, negated};
use crate::config::TriangleTest;
use crate::hdl::{Builder, Direction, HdlError, Module, Pipeline, Signal};
use crate::interface;
use std::sync::Arc;

type Vector<'b> = [Signal<'b>; 3];

fn vector<'b>(f: impl FnMut(&'static str) -> Signal<'b>) -> Vector<'b> {
    AXES.map(f)
}

interface! {
    pub(super) (plan: &Plan) {
        in "A slot of the test" {
            matrix: 1,
            v0: [plan.number(); xyz],
            v1: [plan.number(); xyz],
            v2: [plan.number(); xyz],
            ray: ..{Tested = Tested::of(plan)},
            translation: [plan.number(); xyz],
            weight: plan.number(),
            window: {Interval = Interval::of(plan)},
            limits: ..{Limits = Limits::of(plan)},
            shear_z if (plan.watertight()): plan.number(),
            accumulate: 1,
            sum_a: [plan.number(); 6],
            sum_b: [plan.number(); 6],
        }
        out "What comes of it" {
            hit: 1,
            t: plan.number(),
            u: plan.number(),
            v: plan.number(),
            box_near: plan.number(),
            box_far: plan.number(),
            moved: [plan.number(); xyz],
            weighted: [plan.number(); xyz],
            sum: [plan.number(); 6],
        }
    }
}

/// Pairs of numbers that are added at once while the test accumulates.
const PAIRS: usize = 6;

/// The ray's interval in the triangle's own box, and whether the triangle is degenerate.
fn triangle_box(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let m = Builder::new(
        "triangle_box",
        "a ray's interval in a triangle's own box, by the very plane distances of traversal, and whether the triangle is degenerate.",
    );
    let p = m.pipeline();
    m.group("The triangle's vertices");
    let v: Vec<Vector<'_>> = (0..3)
        .map(|i| vector(|x| p.input(format!("v{i}_{x}"), w)))
        .collect();
    m.group("The ray");
    let origin = vector(|x| p.input(format!("origin_{x}"), w));
    let reciprocal = vector(|x| p.input(format!("reciprocal_{x}"), w));
    let signs = p.input("signs", 3);

    let mut boxes = vec![];
    let mut flat = vec![];
    let mut same = [vec![], vec![], vec![]];
    // A vertex with a NaN makes the ray miss by its determinant, whatever the box is; and of zeros any may be the box's.
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
        boxes.push((lo, hi));
        let is_flat = equal(f, number(lo), number(hi)).named(format!("flat_{x}"));
        flat.push(is_flat.register());
        for (pair, (j, k)) in [(0, 1), (1, 2), (2, 0)].into_iter().enumerate() {
            same[pair].push(
                equal(f, number(v[j][i]), number(v[k][i]))
                    .named(format!("same{j}{k}_{x}"))
                    .register(),
            );
        }
    }

    m.group("While it accumulates: sums, whose operands are given at any time");
    let planes_at = boxes[0].0.stage().unwrap_or(0);
    let accumulate = p.input_at("accumulate", 1, planes_at);
    let operand = |which: &str, k: usize| p.input_at(format!("sum_{which}_{k}"), w, planes_at);
    let pairs: Vec<_> = (0..PAIRS)
        .map(|k| (operand("a", k), operand("b", k)))
        .collect();
    let lender = Lender::new(&plan.units, accumulate);
    let mut sums = [None; PAIRS];
    // The distance of a plane; its subtractor adds pair `k`.
    let mut plane_distance = |name: &str, i: usize, k: usize, plane, slack| {
        let (a, b) = pairs[k];
        let plane = lender.choice(&format!("{name}_plane"), plane, a);
        let origin = lender.choice(&format!("{name}_origin"), origin[i], negated(b));
        let offset = plan.units.sub(
            format!("{name}_offset"),
            plane.register(),
            origin.register(),
        );
        sums[k] = Some(offset);
        distance::from_offset(name, &plan.units, offset, reciprocal[i], slack)
    };
    let mut interval: Option<(Signal<'_>, Signal<'_>)> = None;
    for (i, x) in AXES.iter().enumerate() {
        m.comment(format!("Clipped on the {x} axis."));
        let (lo, hi) = boxes[i];
        let sign = signs.bit(i as u32);
        let near_plane = sign.mux(hi, lo);
        let n = plane_distance(&format!("near_{x}"), i, i, near_plane, distance::NEAR_SLACK);
        let far_plane = sign.mux(lo, hi);
        let d = plane_distance(
            &format!("far_{x}"),
            i,
            3 + i,
            far_plane,
            distance::FAR_SLACK,
        );
        let (near, far) = interval.unwrap_or_else(|| {
            m.group("The interval that the box clips");
            let window = |name: &str, at| p.input_at(name, w, at);
            let at = n.stage().unwrap_or(0);
            (window("window_near", at), window("window_far", at))
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
    m.comment("Degenerate: two vertices are equal, or the box is flat on two axes.");
    let mut degenerate = vec![flat[0] & flat[1], flat[1] & flat[2], flat[2] & flat[0]];
    degenerate.extend(same.iter().map(|s| m.and_all(s)));
    let degenerate = m.or_all(&degenerate).named("any_degenerate").register();
    let empty = less(f, far.known(Known::Number), near.known(Known::Number))
        .named("empty_interval")
        .register();
    let end = empty.stage().unwrap_or(0);
    m.group("The interval, and whether the box alone makes the ray miss");
    m.output("box_near", near.at(end));
    m.output("box_far", far.at(end));
    m.output("box_misses", empty | degenerate.at(end));
    m.group("While it accumulates: sums, whose operands are given at any time");
    for (k, sum) in sums.iter().enumerate() {
        m.output(format!("sum_{k}"), sum.expect("a sum for each pair"));
    }
    m.finish()
}

/// The inputs that both tests have alike, and what lends their operators.
struct Shared<'b> {
    p: Pipeline<'b>,
    lender: Lender<'b>,
    vertices: [Vector<'b>; 3],
    origin: Vector<'b>,
    matrix: Signal<'b>,
}

impl<'b> Shared<'b> {
    fn new(m: &'b Builder, plan: &Plan) -> Shared<'b> {
        let w = plan.number();
        let p = m.pipeline();
        m.group("What the slot is: 0 a test, 1 a matrix");
        let matrix = p.input("matrix", 1);
        m.group("The triangle's vertices, or the matrix's columns x, y, z");
        let vertices = [0, 1, 2].map(|i| vector(|x| p.input(format!("v{i}_{x}"), w)));
        m.group("The ray's origin, or the point");
        let origin = vector(|x| p.input(format!("origin_{x}"), w));
        Shared {
            p,
            lender: Lender::new(&plan.units, matrix),
            vertices,
            origin,
            matrix,
        }
    }

    /// What is subtracted from `name`: `own` in a test; +0 in a matrix slot, which keeps what it is subtracted from, for a
    /// product does not tell a zero's sign.
    fn subtracted(&self, name: &str, own: Signal<'b>) -> Signal<'b> {
        let zero = own.module().zero(own.width());
        self.lender.term(name, own, zero)
    }

    fn translation(&self, x: &str, at: Option<u32>, width: u32) -> Signal<'b> {
        self.late(
            "The matrix's fourth column",
            &format!("translation_{x}"),
            width,
            at,
        )
    }

    fn weight(&self, at: Option<u32>, width: u32) -> Signal<'b> {
        self.late("The weight of the moved point", "weight", width, at)
    }

    /// An input that is needed late.
    fn late(&self, group: &str, name: &str, width: u32, at: Option<u32>) -> Signal<'b> {
        self.matrix.module().group(group);
        self.p.input_at(name, width, at.unwrap_or(0))
    }
}

/// Möller–Trumbore: t, u, v and whether the ray misses, before the box and the limits; a moved point.
fn moller_trumbore(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let units = &plan.units;
    let m = Builder::new(
        "triangle_moller_trumbore",
        "the ray-triangle test of Moeller and Trumbore, whose operators also apply a matrix to a point.",
    );
    let inputs = Shared::new(&m, plan);
    let Shared {
        ref p,
        ref lender,
        vertices: v,
        origin,
        ..
    } = inputs;
    m.group("The ray's direction");
    let direction = vector(|x| p.input(format!("direction_{x}"), w));

    m.comment("Edges, and the origin seen from the first vertex. Matrix: the columns y and z, and x negated.");
    let base = [0, 1, 2].map(|i| inputs.subtracted(&format!("base_{}", AXES[i]), v[0][i]));
    let e1 = difference(plan, "e1", v[1], base);
    let e2 = difference(plan, "e2", v[2], base);
    // The subtrahend is the column here: the other operand is nothing.
    let o = [0, 1, 2].map(|i| inputs.subtracted(&format!("seen_from_{}", AXES[i]), origin[i]));
    let c = difference(plan, "c", o, v[0]);
    m.comment("Matrix: the point takes the direction's way, its x negated as its column is.");
    let point = [negated(origin[0]), origin[1], origin[2]];
    let d = [0, 1, 2].map(|i| {
        let name = format!("direction_or_point_{}", AXES[i]);
        lender.choice(&name, direction[i], point[i])
    });

    m.comment("The products of d x e2. Matrix: those of column z.");
    let [p_x, p_y, p_z] = [0, 1, 2].map(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let x = AXES[i];
        // Of the nine products of d and e2 these are six; z × z is none of them.
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
    m.comment("p = d x e2, q = c x e1. Matrix: the sum of columns x and y, of component y in q_x and so on.");
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
        let translation = inputs.translation(AXES[component], xy.stage(), w);
        let z = lender.term(&format!("{name}_z_or_translation"), of[2], translation);
        units.add(name, xy, z)
    });
    m.comment("u = (c . p) i, v = (d . q) i, t = (e2 . q) i. Matrix: all by the weight.");
    let i = units.reciprocal("i", det);
    let factor = lender.factor("i_or_weight", i, inputs.weight(i.stage(), w));
    let u = units.mul("u", cp, factor);
    let vv = units.mul("v", dq, factor);
    let t = units.mul("t", e2q, factor);
    let sum = units.add("u_plus_v", u, vv);
    let zero = m.zero(w);
    let one = m.lit(u128::from(f.one()), w);
    let none = zero.known(Known::Positive);
    let inside = (less_equal(f, none, u.known(Known::Result))
        & less_equal(f, none, vv.known(Known::Result)))
    .named("weights_positive")
    .register();
    let below = less_equal(f, sum.known(Known::Result), one.known(Known::Positive))
        .named("below_diagonal")
        .register();
    let flat = is_zero(f, det).named("det_is_zero").register();
    let misses = !inside | !below | flat;
    finish_test(&m, [t, u, vv], misses);
    finish_matrix(&m, [cp, dq, e2q], [u, vv, t]);
    m.finish()
}

/// The watertight test of Woop, Benthin and Wald: t, u, v and whether the ray misses, before the box and the limits; a moved point.
fn watertight(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let units = &plan.units;
    let m = Builder::new(
        "triangle_watertight",
        "the watertight ray-triangle test of Woop, Benthin and Wald: edge functions of vertices sheared into the ray's frame. \
         Its operators also apply a matrix to a point.",
    );
    let inputs = Shared::new(&m, plan);
    let Shared {
        ref p,
        ref lender,
        vertices,
        origin,
        ..
    } = inputs;
    m.group("The ray's shear");
    let kz = p.input("kz", 2);
    let shear = ["x", "y"].map(|x| p.input(format!("shear_{x}"), w));
    let zero = m.zero(w);

    m.comment("Matrix: the columns pass as if seen from the origin and along z; the point takes the shear's way.");
    let o = [0, 1, 2].map(|i| inputs.subtracted(&format!("seen_from_{}", AXES[i]), origin[i]));
    let kz = lender.choice("axis", kz, m.zero(2));
    let [along_x, along_y] = [0, 1].map(|i| {
        let name = format!("shear_or_point_{}", AXES[i]);
        lender.choice(&name, shear[i], origin[i])
    });
    let point_z = origin[2];

    m.comment("The vertices a, b, c, seen from the origin, their axes turned.");
    let names = ["a", "b", "c"];
    let seen = [0, 1, 2].map(|i| difference(plan, names[i], vertices[i], o));
    // kz names an axis; kx and ky follow it cyclically. In a matrix slot component x is where kz is, and so on.
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
    m.comment("What shears them. Matrix: the products of column x (by shear x) and y (by shear y), each component once.");
    let shift = |i: usize, along: usize, column: usize, component: usize| {
        let name = format!("{}{}_shift", names[i], AXES[along]);
        // Chosen before the register that turns the axes has anyway.
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
    let [ax_shift, bx_shift, cx_shift] = [(0, 0), (1, 2), (2, 1)].map(|(i, x)| shift(i, 0, 0, x));
    let [ay_shift, by_shift, cy_shift] = [(0, 1), (1, 0), (2, 2)].map(|(i, x)| shift(i, 1, 1, x));
    m.comment(
        "Sheared. Matrix: the sum of columns x and y in ax, ay, bx; column z passes in cx, cy.",
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
        lender.term("cx_subtrahend", cx_shift, zero),
    );
    let cy = units.sub(
        "cy",
        c_turned[1],
        lender.term("cy_subtrahend", cy_shift, zero),
    );
    let [az, bz, cz] = [a_turned[2], b_turned[2], c_turned[2]];
    let columns_xy = [ax, ay, bx];
    let column_z = [cz, cx, cy];

    m.comment("Edge functions. Matrix: plus the products of column z, which is added to the sum.");
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
        let minus = lender.subtrahend(&format!("{name}_subtrahend"), minus, columns_xy[component]);
        units.sub(name, plus, minus)
    };
    let eu = edge("eu", eu_plus, eu_minus, 1);
    let ev = edge("ev", ev_plus, ev_minus, 2);
    let ew = edge("ew", ew_plus, ew_minus, 0);
    let none = zero.known(Known::Positive);
    let edges = [eu, ev, ew].map(|e| e.known(Known::Result));
    let some_negative = m
        .or_all(&edges.map(|e| less(f, e, none)))
        .named("some_negative")
        .register();
    let some_positive = m
        .or_all(&edges.map(|e| less(f, none, e)))
        .named("some_positive")
        .register();
    m.comment(
        "det = (U + V) + W, i = 1 / det. Matrix: the translation is added, y in U + V, x in det.",
    );
    let translation_y = inputs.translation("y", eu.stage(), w);
    let uv = units.add(
        "uv",
        eu,
        lender.term("ev_or_translation", ev, translation_y),
    );
    let translation_x = inputs.translation("x", uv.stage(), w);
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
    let translation_z = inputs.translation("z", ua_vb.stage(), w);
    let scaled = units.add(
        "scaled",
        lender.term("ua_vb_or_sum", ua_vb, ev),
        lender.term("wc_or_translation", wc, translation_z),
    );
    m.comment("t = (T i) Sz, u = V i, v = W i. Matrix: all by the weight; the point moved takes the way of V and W.");
    let second = lender.choice("v_or_moved_y", ev, uv);
    let third = lender.choice("w_or_moved_x", ew, det);
    let factor = lender.factor("i_or_weight", i, inputs.weight(i.stage(), w));
    let distance = units.mul("distance", scaled, factor);
    let u = units.mul("u", second, factor);
    let vv = units.mul("v", third, factor);
    m.group("The reciprocal of the direction's greatest component");
    let shear_z = p.input_at("shear_z", w, distance.stage().unwrap_or(0));
    let t = units.mul("t", distance, shear_z);
    let misses = (some_negative & some_positive) | flat;
    finish_test(&m, [t, u, vv], misses);
    finish_matrix(&m, [third, second, scaled], [vv, u, distance]);
    m.finish()
}

/// The latest stage of some signals.
fn latest(signals: &[Signal<'_>]) -> u32 {
    signals.iter().filter_map(|s| s.stage()).max().unwrap_or(0)
}

/// The outputs of a matrix slot.
fn finish_matrix<'b>(m: &'b Builder, moved: Vector<'b>, weighted: Vector<'b>) {
    for (group, name, point) in [
        ("The point moved by the matrix", "moved", moved),
        ("The point moved and weighted", "weighted", weighted),
    ] {
        m.group(group);
        let end = latest(&point);
        for (x, signal) in AXES.iter().zip(point) {
            m.output(format!("{name}_{x}"), signal.at(end));
        }
    }
}

fn finish_test(m: &Builder, [t, u, v]: [Signal<'_>; 3], misses: Signal<'_>) {
    let end = latest(&[t, u, v, misses]);
    m.group(
        "Distance, the second and third vertex's weights, and whether the ray passes the triangle",
    );
    m.output("test_t", t.at(end));
    m.output("test_u", u.at(end));
    m.output("test_v", v.at(end));
    m.output("test_misses", misses.at(end));
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

/// The whole triangle test as a pipeline: the configured test, the box, the clamp and the ray's limits.
pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let test = match plan.config.triangle_test {
        TriangleTest::MollerTrumbore => moller_trumbore(plan)?,
        TriangleTest::Watertight => watertight(plan)?,
    };
    let in_box = triangle_box(plan)?;
    let m = Builder::new(
        "triangle_test",
        "a ray against a triangle: the test itself, clamped to the ray's interval in the triangle's own box, within tmin and tmax; \
         or a matrix applied to a point.",
    );
    let p = m.pipeline();
    let mut ports = vec![];
    for module in [&test, &in_box] {
        for port in module
            .ports()
            .iter()
            .filter(|port| port.direction == Direction::Input && port.name != "clk")
        {
            if !ports.iter().any(|(name, _)| *name == port.name) {
                m.group(port.group.clone());
                let signal = p.input_at(&port.name, port.width, port.stage.unwrap_or(0));
                ports.push((port.name.clone(), signal));
            }
        }
    }
    let place = |name: &str, module: &Arc<Module>| {
        let inputs: Vec<_> = ports
            .iter()
            .filter(|(name, _)| module.port(name).is_some())
            .map(|(name, signal)| (name.as_str(), *signal))
            .collect();
        m.instance(name, module, &inputs)
    };
    let tested = place("intersection", &test);
    let boxed = place("own_box", &in_box);
    let end = latest(&[tested.get("test_t"), boxed.get("box_near")]);
    m.comment("Clamp t into the box's interval; the box decides a miss before.");
    let t = tested.get("test_t").at(end);
    let near = boxed.get("box_near").at(end);
    let far = boxed.get("box_far").at(end);
    // A NaN is never replaced: t's makes it a miss.
    let [near, far] = [near, far].map(|end| end.known(Known::Number));
    let raised = plan.max("raised", t.known(Known::Result), near).register();
    let clamped = plan
        .min("clamped", raised.known(Known::Result), far)
        .register();
    m.group("The ray's limits, needed last");
    let limits_at = clamped.stage().unwrap_or(0);
    let tmin = p.input_at("tmin", w, limits_at);
    let tmax = p.input_at("tmax", w, limits_at);
    let misses = (tested.get("test_misses")
        | boxed.get("box_misses")
        | is_nan(f, tested.get("test_t")).at(end))
    .named("misses");
    let [least, most] = [tmin, tmax].map(|limit| limit.known(Known::Positive));
    // A NaN is a miss by itself.
    let distance = clamped.known(Known::Number);
    let within_limits =
        (less_equal(f, least, distance) & less_equal(f, distance, most) & is_finite(f, clamped))
            .named("within_limits");
    let hits = (within_limits & !misses.at(limits_at))
        .named("hits")
        .register();
    m.group("Whether the ray hits, and where");
    let last = limits_at + 1;
    m.output("hit", hits);
    m.output("t", clamped.at(last));
    m.output("u", tested.get("test_u").at(last));
    m.output("v", tested.get("test_v").at(last));
    for (module, placed, prefixes) in [
        (&test, &tested, &["moved_", "weighted_"][..]),
        (&in_box, &boxed, &["box_near", "box_far", "sum_"][..]),
    ] {
        for port in module.ports() {
            let passes = prefixes.iter().any(|prefix| port.name.starts_with(prefix));
            if port.direction == Direction::Output && passes {
                m.group(port.group.clone());
                m.output(&port.name, placed.get(&port.name));
            }
        }
    }
    m.finish()
}
