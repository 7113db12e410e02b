//! The triangle test as a pipeline: Möller–Trumbore or watertight, and the ray's interval in the triangle's own box.

use super::distance;
use super::fp::{equal, is_infinite, is_nan, is_zero, less, less_equal, max, min};
use super::plan::{AXES, Plan};
use crate::config::TriangleTest;
use crate::hdl::{Builder, HdlError, Module, Signal};
use std::rc::Rc;

type Vector<'b> = [Signal<'b>; 3];

fn vector<'b>(f: impl FnMut(&'static str) -> Signal<'b>) -> Vector<'b> {
    AXES.map(f)
}

/// The ray's interval in the triangle's own box, and whether the triangle is degenerate.
fn triangle_box(plan: &Plan) -> Result<Rc<Module>, HdlError> {
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

    let (mut near, mut far) = (None, None);
    let mut flat = vec![];
    let mut same = [vec![], vec![], vec![]];
    for (i, x) in AXES.iter().enumerate() {
        m.comment(format!("The {x} axis."));
        let lo = plan.settle(min(f, v[0][i], v[1][i]).named(format!("lo01_{x}")));
        let hi = plan.settle(max(f, v[0][i], v[1][i]).named(format!("hi01_{x}")));
        let lo = min(f, lo, v[2][i]).named(format!("lo_{x}")).register();
        let hi = max(f, hi, v[2][i]).named(format!("hi_{x}")).register();
        flat.push(equal(f, lo, hi).named(format!("flat_{x}")).register());
        for (pair, (j, k)) in [(0, 1), (1, 2), (2, 0)].into_iter().enumerate() {
            same[pair].push(
                equal(f, v[j][i], v[k][i])
                    .named(format!("same{j}{k}_{x}"))
                    .register(),
            );
        }
        let sign = signs.bit(i as u32);
        let place = |name: String, module: &Rc<Module>, plane| {
            distance::place(name, module, plane, origin[i], reciprocal[i])
        };
        let n = place(
            format!("near_{x}"),
            &plan.near_distance,
            sign.mux(hi, lo).named(format!("near_plane_{x}")).register(),
        );
        let d = place(
            format!("far_{x}"),
            &plan.far_distance,
            sign.mux(lo, hi).named(format!("far_plane_{x}")).register(),
        );
        // From (-infinity, +infinity): a NaN does not clip.
        near = Some(match near {
            None => is_nan(f, n)
                .mux(m.lit(u128::from(f.infinity() | f.sign_bit()), w), n)
                .named("near_after_x")
                .register(),
            Some(near) => max(f, near, n).named(format!("near_after_{x}")).register(),
        });
        far = Some(match far {
            None => is_nan(f, d)
                .mux(m.lit(u128::from(f.infinity()), w), d)
                .named("far_after_x")
                .register(),
            Some(far) => min(f, far, d).named(format!("far_after_{x}")).register(),
        });
    }
    let (near, far) = (near.expect("three axes"), far.expect("three axes"));
    m.comment("Degenerate: two vertices are equal, or the box is flat on two axes.");
    let mut degenerate = vec![flat[0] & flat[1], flat[1] & flat[2], flat[2] & flat[0]];
    degenerate.extend(same.iter().map(|s| m.and_all(s)));
    let degenerate = m.or_all(&degenerate).named("any_degenerate").register();
    let empty = less(f, far, near).named("empty_interval").register();
    let end = empty.stage().unwrap_or(0);
    m.group("The interval, and whether the box alone makes the ray miss");
    m.output("box_near", near.at(end));
    m.output("box_far", far.at(end));
    m.output("box_misses", empty | degenerate.at(end));
    m.finish()
}

/// Möller–Trumbore: t, u, v and whether the ray misses, before the box and the limits.
fn moller_trumbore(plan: &Plan) -> Result<Rc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let units = &plan.units;
    let m = Builder::new(
        "triangle_moller_trumbore",
        "the ray-triangle test of Moeller and Trumbore.",
    );
    let p = m.pipeline();
    m.group("The triangle's vertices");
    let v: Vec<Vector<'_>> = (0..3)
        .map(|i| vector(|x| p.input(format!("v{i}_{x}"), w)))
        .collect();
    m.group("The ray");
    let o = vector(|x| p.input(format!("origin_{x}"), w));
    let d = vector(|x| p.input(format!("direction_{x}"), w));

    m.comment("Edges, and the origin seen from the first vertex.");
    let e1 = difference(plan, "e1", v[1], v[0]);
    let e2 = difference(plan, "e2", v[2], v[0]);
    let c = difference(plan, "c", o, v[0]);
    m.comment("p = d x e2, det = e1 . p, i = 1 / det.");
    let pv = cross(plan, "p", d, e2);
    let det = dot(plan, "det", e1, pv);
    let i = units.reciprocal("i", det);
    m.comment("u = (c . p) i");
    let u = units.mul("u", dot(plan, "cp", c, pv), i);
    m.comment("q = c x e1, v = (d . q) i, t = (e2 . q) i");
    let qv = cross(plan, "q", c, e1);
    let vv = units.mul("v", dot(plan, "dq", d, qv), i);
    let t = units.mul("t", dot(plan, "e2q", e2, qv), i);
    let sum = units.add("u_plus_v", u, vv);
    let zero = m.zero(w);
    let one = m.lit(u128::from(f.one()), w);
    let inside = (less_equal(f, zero, u) & less_equal(f, zero, vv))
        .named("weights_positive")
        .register();
    let below = less_equal(f, sum, one).named("below_diagonal").register();
    let flat = is_zero(f, det).named("det_is_zero").register();
    let misses = !inside | !below | flat;
    finish_test(&m, [t, u, vv], misses);
    m.finish()
}

/// The watertight test of Woop, Benthin and Wald: t, u, v and whether the ray misses, before the box and the limits.
fn watertight(plan: &Plan) -> Result<Rc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let units = &plan.units;
    let m = Builder::new(
        "triangle_watertight",
        "the watertight ray-triangle test of Woop, Benthin and Wald: edge functions of vertices sheared into the ray's frame.",
    );
    let p = m.pipeline();
    m.group("The triangle's vertices");
    let v: Vec<Vector<'_>> = (0..3)
        .map(|i| vector(|x| p.input(format!("v{i}_{x}"), w)))
        .collect();
    m.group("The ray, and its shear");
    let o = vector(|x| p.input(format!("origin_{x}"), w));
    let kz = p.input("kz", 2);
    let shear_x = p.input("shear_x", w);
    let shear_y = p.input("shear_y", w);
    m.group("The reciprocal of the direction's greatest component, needed last");
    let scaled_at = shear_z_stage(plan);
    let shear_z = p.input_at("shear_z", w, scaled_at);

    let names = ["a", "b", "c"];
    let mut sheared: Vec<Vector<'_>> = vec![];
    for (name, vertex) in names.iter().zip(&v) {
        m.comment(format!(
            "{}, seen from the origin and sheared.",
            name.to_uppercase()
        ));
        let from = difference(plan, name, *vertex, o);
        // kz names an axis; kx and ky follow it cyclically.
        let pick = |what: &str, choices: [usize; 3]| {
            let choices = choices.map(|axis| from[axis]);
            m.select(kz, &choices)
                .named(format!("{name}_{what}"))
                .register()
        };
        let z = pick("kz", [0, 1, 2]);
        let x = pick("kx", [1, 2, 0]);
        let y = pick("ky", [2, 0, 1]);
        let sx = units.sub(
            format!("{name}x"),
            x,
            units.mul(format!("{name}x_shift"), shear_x, z),
        );
        let sy = units.sub(
            format!("{name}y"),
            y,
            units.mul(format!("{name}y_shift"), shear_y, z),
        );
        sheared.push([sx, sy, z]);
    }
    let [a, b, c] = [sheared[0], sheared[1], sheared[2]];
    m.comment("Edge functions.");
    let eu = edge_function(plan, "eu", c, b);
    let ev = edge_function(plan, "ev", a, c);
    let ew = edge_function(plan, "ew", b, a);
    let negative = |e| less(f, e, m.zero(w));
    let positive = |e| less(f, m.zero(w), e);
    let some_negative = (negative(eu) | negative(ev) | negative(ew))
        .named("some_negative")
        .register();
    let some_positive = (positive(eu) | positive(ev) | positive(ew))
        .named("some_positive")
        .register();
    m.comment("det = (U + V) + W, i = 1 / det.");
    let det = units.add("det", units.add("uv", eu, ev), ew);
    let i = units.reciprocal("i", det);
    let flat = is_zero(f, det).named("det_is_zero").register();
    m.comment("T = (U Az + V Bz) + W Cz, t = (T i) Sz, u = V i, v = W i.");
    let ua = units.mul("ua", eu, a[2]);
    let vb = units.mul("vb", ev, b[2]);
    let wc = units.mul("wc", ew, c[2]);
    let scaled = units.add("scaled", units.add("ua_vb", ua, vb), wc);
    let distance = units.mul("distance", scaled, i);
    assert_eq!(distance.stage(), Some(scaled_at), "where shear_z is needed");
    let t = units.mul("t", distance, shear_z);
    let u = units.mul("u", ev, i);
    let vv = units.mul("v", ew, i);
    let misses = (some_negative & some_positive) | flat;
    finish_test(&m, [t, u, vv], misses);
    m.finish()
}

/// The stage at which T × i is there: the sum of what is computed before it on the longest path.
fn shear_z_stage(plan: &Plan) -> u32 {
    let of = |module: &Rc<Module>| module.latency().unwrap_or(0);
    let (add, sub, mul) = (
        of(&plan.units.add),
        of(&plan.units.sub),
        of(&plan.units.mul),
    );
    let edges = sub + 1 + mul + sub + mul + sub;
    let inverse = edges + 2 * add + of(&plan.units.reciprocal);
    let scaled = edges + mul + 2 * add;
    inverse.max(scaled) + mul
}

fn finish_test(m: &Builder, [t, u, v]: [Signal<'_>; 3], misses: Signal<'_>) {
    let end = [t, u, v, misses]
        .iter()
        .filter_map(|s| s.stage())
        .max()
        .unwrap_or(0);
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

/// a × b: a_y b_z − a_z b_y and so on.
fn cross<'b>(plan: &Plan, name: &str, a: Vector<'b>, b: Vector<'b>) -> Vector<'b> {
    [0, 1, 2].map(|i| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        let x = AXES[i];
        let plus = plan.units.mul(format!("{name}_{x}_plus"), a[j], b[k]);
        let minus = plan.units.mul(format!("{name}_{x}_minus"), a[k], b[j]);
        plan.units.sub(format!("{name}_{x}"), plus, minus)
    })
}

/// (a_x b_x + a_y b_y) + a_z b_z.
fn dot<'b>(plan: &Plan, name: &str, a: Vector<'b>, b: Vector<'b>) -> Signal<'b> {
    let product = |i: usize| plan.units.mul(format!("{name}_of_{}", AXES[i]), a[i], b[i]);
    let xy = plan.units.add(format!("{name}_xy"), product(0), product(1));
    plan.units.add(name, xy, product(2))
}

/// p.x q.y − p.y q.x.
fn edge_function<'b>(plan: &Plan, name: &str, p: Vector<'b>, q: Vector<'b>) -> Signal<'b> {
    let plus = plan.units.mul(format!("{name}_plus"), p[0], q[1]);
    let minus = plan.units.mul(format!("{name}_minus"), p[1], q[0]);
    plan.units.sub(name, plus, minus)
}

/// The whole triangle test as a pipeline: the configured test, the box, the clamp and the ray's limits.
pub(super) fn module(plan: &Plan) -> Result<Rc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let test = match plan.config.triangle_test {
        TriangleTest::MollerTrumbore => moller_trumbore(plan)?,
        TriangleTest::Watertight => watertight(plan)?,
    };
    let in_box = triangle_box(plan)?;
    let m = Builder::new(
        "triangle_test",
        "a ray against a triangle: the test itself, clamped to the ray's interval in the triangle's own box, within tmin and tmax.",
    );
    let p = m.pipeline();
    let mut ports = vec![];
    let end = test
        .latency()
        .unwrap_or(0)
        .max(in_box.latency().unwrap_or(0));
    for module in [&test, &in_box] {
        for port in module
            .ports()
            .iter()
            .filter(|port| port.direction == crate::hdl::Direction::Input && port.name != "clk")
        {
            if !ports.iter().any(|(name, _)| *name == port.name) {
                m.group(port.group.clone());
                let signal = p.input_at(&port.name, port.width, port.stage.unwrap_or(0));
                ports.push((port.name.clone(), signal));
            }
        }
    }
    let place = |name: &str, module: &Rc<Module>| {
        let inputs: Vec<_> = ports
            .iter()
            .filter(|(name, _)| module.port(name).is_some())
            .map(|(name, signal)| (name.as_str(), *signal))
            .collect();
        m.instance(name, module, &inputs)
    };
    let tested = place("intersection", &test);
    let boxed = place("own_box", &in_box);
    m.group("The ray's limits, needed last");
    let limits_at = end + 2;
    let tmin = p.input_at("tmin", w, limits_at);
    let tmax = p.input_at("tmax", w, limits_at);
    m.comment("Clamp t into the box's interval; the box decides a miss before.");
    let t = tested.get("test_t").at(end);
    let near = boxed.get("box_near").at(end);
    let far = boxed.get("box_far").at(end);
    let raised = less(f, t, near).mux(near, t).named("raised").register();
    let clamped = less(f, far, raised)
        .mux(far, raised)
        .named("clamped")
        .register();
    let misses = (tested.get("test_misses")
        | boxed.get("box_misses")
        | is_nan(f, tested.get("test_t")).at(end))
    .named("misses");
    let within_limits =
        (less_equal(f, tmin, clamped) & less_equal(f, clamped, tmax) & !is_infinite(f, clamped))
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
    m.finish()
}
