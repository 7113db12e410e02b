//! The geometry unit: fetches a leaf's triangle and its vertices, tests the packet's rays against it, one a clock, and merges the hits.
//!
//! A packet has at most one leaf under way, so everything here is numbered by its packet, queues are as deep as there are packets,
//! and nothing can overflow. Rays outside a leaf's mask are skipped and cost nothing.

use super::bundle::Bundle;
use super::distance;
use super::fifo;
use super::fp::{equal, is_infinite, is_nan, is_zero, less, less_equal, max, min};
use super::plan::{AXES, Plan};
use super::tpu;
use crate::bkd::layout::Record;
use crate::config::TriangleTest;
use crate::hdl::{Builder, HdlError, Module, Signal, Style, bits_for};
use std::rc::Rc;

/// The geometry unit, and the triangle test within.
pub struct Geometry {
    pub module: Rc<Module>,
    pub test: Rc<Module>,
}

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
fn triangle_test(plan: &Plan) -> Result<Rc<Module>, HdlError> {
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

/// The geometry unit of a machine.
pub fn module(plan: &Plan) -> Result<Geometry, HdlError> {
    let test = triangle_test(plan)?;
    let w = plan.number();
    let f = plan.format;
    let rays = plan.rays();
    let packets = plan.packets();
    let a = plan.address();
    let pb = plan.packet_bits();
    let context = tpu::context(plan);
    let watertight = plan.config.triangle_test == TriangleTest::Watertight;
    let triangle = Record::triangle();
    let vertex = Record::vertex(f);

    let m = Builder::new(
        "geometry_unit",
        "the geometry unit: a leaf's triangle and vertices are fetched, the packet's rays tested one a clock, the hits merged.",
    );
    m.group("A ray that has been set up");
    let setup_valid = m.input("setup_valid", 1);
    let setup_packet = m.input("setup_packet", pb);
    let setup_ray = m.input("setup_ray", plan.ray_bits());
    let mut early_fields: Vec<(&'static str, u32)> = vec![
        ("origin_x", w),
        ("origin_y", w),
        ("origin_z", w),
        ("reciprocal_x", w),
        ("reciprocal_y", w),
        ("reciprocal_z", w),
        ("signs", 3),
    ];
    let mut late_fields: Vec<(&'static str, u32)> = vec![("tmin", w), ("tmax", w), ("any_hit", 1)];
    if watertight {
        early_fields.extend([("kz", 2), ("shear_x", w), ("shear_y", w)]);
        late_fields.push(("shear_z", w));
    } else {
        early_fields.extend([("direction_x", w), ("direction_y", w), ("direction_z", w)]);
    }
    let early = Bundle::new(&early_fields);
    let late = Bundle::new(&late_fields);
    let setup_input = |fields: &[(&'static str, u32)]| -> Vec<(&'static str, Signal<'_>)> {
        fields
            .iter()
            .map(|(name, width)| (*name, m.input(format!("setup_{name}"), *width)))
            .collect()
    };
    let early_inputs = setup_input(&early_fields);
    let late_inputs = setup_input(&late_fields);
    m.group("Leaves from the traversal unit");
    let leaf_valid = m.input("leaf_valid", 1);
    let leaf_packet = m.input("leaf_packet", pb);
    let leaf_address = m.input("leaf_address", a);
    let leaf_context = m.input("leaf_context", context.width());
    let leaf_mask = m.input("leaf_mask", rays);
    m.group("Triangle record memory: requests");
    let record_ready = m.input("record_request_ready", 1);
    m.group("Triangle record memory: answers, in any order, always taken");
    let record_valid = m.input("record_response_valid", 1);
    let record_tag = m.input("record_response_tag", pb);
    let record_data = m.input("record_response_data", triangle.width);
    m.group("Vertex memory: requests");
    let vertex_ready = m.input("vertex_request_ready", 1);
    m.group("Vertex memory: answers, in any order, always taken");
    let vertex_valid = m.input("vertex_response_valid", 1);
    let vertex_tag = m.input("vertex_response_tag", pb + 2);
    let vertex_data = m.input("vertex_response_data", vertex.width);
    m.group("After reset, packet numbers in turn, to clear what counts by packet");
    let sweep = m.input("sweep", 1);
    let sweep_packet = m.input("sweep_packet", pb);
    m.group("Closest hits are read by packet and ray; the word is there a clock later");
    let hit_packet = m.input("read_packet", pb);
    let hit_ray = m.input("read_ray", plan.ray_bits());

    m.comment("A leaf is taken when its record can be requested.");
    let leaf_word = Bundle::new(&[("context", context.width()), ("mask", rays), ("address", a)]);
    let take_leaf = (leaf_valid & record_ready).named("take_leaf");
    let leaf_data = leaf_word
        .pack(&[
            ("context", leaf_context),
            ("mask", leaf_mask),
            ("address", leaf_address),
        ])
        .named("leaf_data");
    let leaves = m.memory(
        "leaf_memory",
        packets,
        leaf_word.width(),
        Style::Distributed,
    );
    leaves.write(take_leaf, leaf_packet, leaf_data);
    m.group("Leaves from the traversal unit");
    m.output("leaf_ready", record_ready);
    m.group("Triangle record memory: requests");
    m.output("record_request_valid", leaf_valid);
    m.output("record_request_address", leaf_address);
    m.output("record_request_tag", leaf_packet);

    m.comment(
        "A record's answer: its number is kept, its three vertices are requested one a clock.",
    );
    let record = |name: &str| {
        let field = triangle.field(name);
        record_data.field(field.lsb, field.width)
    };
    let numbers = m.memory("number_memory", packets, 32, Style::Distributed);
    numbers.write(record_valid, record_tag, record("number"));
    let job = Bundle::new(&[("packet", pb), ("v0", a), ("v1", a), ("v2", a)]);
    let job_done = m.wire("job_done", 1);
    let (job_valid, job_front) = fifo::place(
        "vertex_queue",
        packets,
        record_valid,
        job.pack(&[
            ("packet", record_tag),
            ("v0", record("v0").low(a)),
            ("v1", record("v1").low(a)),
            ("v2", record("v2").low(a)),
        ]),
        job_done.get(),
    )?;
    let corner = m.reg_reset("corner", 2, 0);
    let vertex_fire = (job_valid & vertex_ready).named("vertex_fire");
    let last_corner = corner.q.equals(2).named("last_corner");
    corner.next_when(
        vertex_fire,
        last_corner.mux(m.zero(2), corner.q + m.lit(1u8, 2)),
    );
    job_done.drive(vertex_fire & last_corner);
    m.group("Vertex memory: requests");
    m.output("vertex_request_valid", job_valid);
    m.output(
        "vertex_request_address",
        m.select(
            corner.q,
            &[
                job.get(job_front, "v0"),
                job.get(job_front, "v1"),
                job.get(job_front, "v2"),
            ],
        ),
    );
    m.output(
        "vertex_request_tag",
        job.get(job_front, "packet").concat(corner.q),
    );

    m.comment("Vertices arrive in any order; the third makes the triangle complete.");
    let arrived_packet = vertex_tag.high(pb);
    let arrived_corner = vertex_tag.low(2);
    let corners: Vec<_> = (0..3u32)
        .map(|i| {
            let memory = m.memory(
                format!("vertex{i}_memory"),
                packets,
                vertex.width,
                Style::Block,
            );
            memory.write(
                vertex_valid & arrived_corner.equals(u128::from(i)),
                arrived_packet,
                vertex_data,
            );
            memory
        })
        .collect();
    let arrivals = m.memory("arrival_memory", packets, 2, Style::Distributed);
    let before = arrivals.read_now(arrived_packet);
    let complete = (vertex_valid & before.equals(2)).named("triangle_complete");
    let counted = before.equals(2).mux(m.zero(2), before + m.lit(1u8, 2));
    arrivals.write(
        sweep | vertex_valid,
        sweep.mux(sweep_packet, arrived_packet),
        sweep.mux(m.zero(2), counted),
    );

    m.comment("The rays of a complete triangle's mask go into the test, one a clock.");
    let take_ready = m.wire("take_ready", 1);
    let (ready_valid, ready_packet) = fifo::place(
        "ready_queue",
        packets,
        complete,
        arrived_packet,
        take_ready.get(),
    )?;
    let ready_leaf = leaves.read_now(ready_packet);
    let busy = m.reg_reset("busy", 1, 0);
    let now_packet = m.reg("now_packet", pb);
    let now_mask = m.reg("now_mask", rays);
    let now_first = m.reg("now_first", 1);
    let (issue_ray, rest_mask) = lowest(&m, now_mask.q, plan.ray_bits());
    let now_last = rest_mask.is_zero().named("now_last");
    let idle_next = (!busy.q | now_last).named("takes_next");
    take_ready.drive(idle_next & ready_valid);
    busy.next(m.priority(&[(idle_next, ready_valid)], m.lit(1u8, 1)));
    now_packet.next_when(take_ready.get(), ready_packet);
    now_mask.next(
        take_ready
            .get()
            .mux(leaf_word.get(ready_leaf, "mask"), rest_mask),
    );
    now_first.next(take_ready.get());

    m.comment("The test.");
    let p = m.pipeline();
    let valid = p.enter(busy.q).cleared_by_reset();
    let packet = p.enter(now_packet.q);
    let ray = p.enter(issue_ray);
    let first = p.enter(now_first.q);
    let last = p.enter(now_last);
    let by_ray = packets << plan.ray_bits();
    let by_ray_bits = bits_for(u64::from(by_ray));
    let index_bits = by_ray_bits - plan.ray_bits();
    let setup_index = setup_packet.low(index_bits).concat(setup_ray);
    let ray_memory = m.memory("ray_memory", by_ray, early.width(), Style::Block);
    ray_memory.write(setup_valid, setup_index, early.pack(&early_inputs));
    let limit_memory = m.memory("ray_limit_memory", by_ray, late.width(), Style::Block);
    limit_memory.write(setup_valid, setup_index, late.pack(&late_inputs));
    let index = packet.low(index_bits).concat(ray).named("test_index");
    let ray_word = plan.read(ray_memory, index);
    let mut inputs: Vec<(String, Signal<'_>)> = vec![];
    for (i, memory) in corners.iter().enumerate() {
        let word = plan.read(*memory, packet);
        for x in AXES {
            let field = vertex.field(x);
            inputs.push((format!("v{i}_{x}"), word.field(field.lsb, field.width)));
        }
    }
    for (name, _) in &early_fields {
        inputs.push((name.to_string(), early.get(ray_word, name)));
    }
    let start = plan.read_latency();
    let stage_of = |port: &str| test.port(port).and_then(|p| p.stage).unwrap_or(0) + start;
    let limits_read = |at: u32| plan.read(limit_memory, index.at(at - plan.read_latency()));
    let at_limits = stage_of("tmin");
    let limits = limits_read(at_limits);
    inputs.push(("tmin".into(), late.get(limits, "tmin")));
    inputs.push(("tmax".into(), late.get(limits, "tmax")));
    if watertight {
        let shear_z = late.get(limits_read(stage_of("shear_z")), "shear_z");
        inputs.push(("shear_z".into(), shear_z));
    }
    let named: Vec<(&str, Signal<'_>)> = inputs.iter().map(|(n, s)| (n.as_str(), *s)).collect();
    let tested = m.instance("test", &test, &named);

    m.comment("The merge: a hit replaces the ray's closest one if it is closer, or as close and of a lower triangle.");
    let hit = tested.get("hit");
    let merge_at = hit.stage().unwrap_or(0);
    let closest_word = Bundle::new(&[("t", w), ("u", w), ("v", w), ("triangle", 32)]);
    let closest = m.memory("closest_memory", by_ray, closest_word.width(), Style::Block);
    let old = plan.read(closest, index.at(merge_at - plan.read_latency()));
    let leaf = leaves.read_now(packet.at(merge_at - 1)).register();
    let number = numbers.read_now(packet.at(merge_at - 1)).register();
    let any_hit = late.get(limits, "any_hit");
    let tmin = late.get(limits, "tmin");
    let leaf_context = leaf_word.get(leaf, "context");
    let touched = context.get(leaf_context, "touched");
    let was_touched = bit_of(&m, touched, ray.at(merge_at)).named("was_touched");
    let t = tested.get("t");
    let old_t = closest_word.get(old, "t");
    let closer = less(f, t, old_t).named("closer");
    let as_close = equal(f, t, old_t).named("as_close");
    let lower = number.lt(closest_word.get(old, "triangle")).named("lower");
    let replaces = (hit & (any_hit.at(merge_at) | !was_touched | closer | (as_close & lower)))
        .named("replaces")
        .register();
    let merged_at = merge_at + 1;
    let none = m.lit(u128::from(u32::MAX), 32);
    let any = any_hit.at(merged_at);
    let merged = closest_word
        .pack(&[
            ("t", any.mux(tmin.at(merged_at), t.at(merged_at))),
            ("u", any.mux(m.zero(w), tested.get("u").at(merged_at))),
            ("v", any.mux(m.zero(w), tested.get("v").at(merged_at))),
            ("triangle", any.mux(none, number.at(merged_at))),
        ])
        .named("merged");
    let writes = (valid.at(merged_at) & replaces)
        .untimed()
        .named("merge_writes");
    let out_packet = packet.at(merged_at).untimed().named("merge_packet");
    let out_ray = ray.at(merged_at).untimed().named("merge_ray");
    closest.write(
        writes,
        out_packet.low(index_bits).concat(out_ray),
        merged.untimed(),
    );
    m.group("A closer hit of a ray: what its near must not exceed from now on");
    m.output("limit_valid", writes);
    m.output("limit_packet", out_packet);
    m.output("limit_ray", out_ray);
    let minus_infinity = m.lit(u128::from(f.infinity() | f.sign_bit()), w);
    m.output(
        "limit_value",
        any.mux(minus_infinity, t.at(merged_at)).untimed(),
    );

    m.comment("Which rays have hit something, gathered over the triangle's rays.");
    let gathered = m.reg("gathered", rays);
    let one_hot: Vec<_> = (0..rays)
        .rev()
        .map(|i| writes & out_ray.equals(u128::from(i)))
        .collect();
    let so_far = first
        .at(merged_at)
        .untimed()
        .mux(touched.at(merged_at).untimed(), gathered.q);
    let now_touched = (so_far | m.concat(&one_hot)).named("now_touched");
    gathered.next_when(valid.at(merged_at).untimed(), now_touched);
    m.group("A leaf all of whose tests are merged");
    m.output(
        "done_valid",
        (valid.at(merged_at) & last.at(merged_at)).untimed(),
    );
    m.output("done_packet", out_packet);
    m.output(
        "done_context",
        context.pack(&[
            (
                "level",
                context.get(leaf_context, "level").at(merged_at).untimed(),
            ),
            ("touched", now_touched),
        ]),
    );
    m.group("The closest hit that was asked for, a clock or two later");
    let read = m.pipeline();
    let read_index = read.enter(hit_packet.low(index_bits).concat(hit_ray));
    let read_word = closest.read(read_index).untimed();
    for name in ["t", "u", "v", "triangle"] {
        m.output(format!("read_{name}"), closest_word.get(read_word, name));
    }
    m.group("Counters' events");
    m.output("test_issued", busy.q);

    m.group("The ray-triangle test just merged, for whoever watches");
    m.output("watch_test_valid", valid.at(merged_at).untimed());
    m.output("watch_test_packet", out_packet);
    m.output("watch_test_ray", out_ray);
    m.output(
        "watch_test_record",
        leaf_word.get(leaf, "address").at(merged_at).untimed(),
    );
    m.output("watch_test_hit", hit.at(merged_at).untimed());
    m.output("watch_test_replaces", replaces.untimed());
    m.output("watch_test_t", t.at(merged_at).untimed());
    m.output("watch_test_u", tested.get("u").at(merged_at).untimed());
    m.output("watch_test_v", tested.get("v").at(merged_at).untimed());
    Ok(Geometry {
        module: m.finish()?,
        test,
    })
}

/// The number of the lowest bit that is set, and the rest without it.
fn lowest<'b>(m: &'b Builder, mask: Signal<'b>, bits: u32) -> (Signal<'b>, Signal<'b>) {
    let width = mask.width();
    let choices: Vec<_> = (0..width)
        .map(|i| (mask.bit(i), m.lit(u128::from(i), bits)))
        .collect();
    let number = m
        .priority(&choices[..choices.len() - 1], choices[choices.len() - 1].1)
        .named("issue_ray");
    let rest = (mask & (mask - m.lit(1u8, width))).named("rest_mask");
    (number, rest)
}

/// The bit of a word that an index names.
fn bit_of<'b>(m: &'b Builder, word: Signal<'b>, index: Signal<'b>) -> Signal<'b> {
    let bits: Vec<_> = (0..word.width()).map(|i| word.bit(i)).collect();
    m.select(index, &bits)
}
