//! The geometry unit: fetches a leaf's triangle and its vertices, tests the packet's rays against it, one a clock, and merges the hits.
//!
//! A packet has at most one leaf under way, so everything here is numbered by its packet, queues are as deep as there are packets,
//! and nothing can overflow. Rays outside a leaf's mask are skipped and cost nothing.

use super::bundle::Bundle;
use super::fifo;
use super::fp::{equal, less};
use super::plan::{AXES, Plan};
use super::tpu;
use super::triangle;
use crate::bkd::layout::Record;
use crate::config::TriangleTest;
use crate::hdl::{Builder, Direction, HdlError, Module, Signal, Style, bits_for};
use std::rc::Rc;

/// The geometry unit, and the triangle test within.
pub struct Geometry {
    pub module: Rc<Module>,
    pub test: Rc<Module>,
}

/// The geometry unit of a machine.
pub fn module(plan: &Plan) -> Result<Geometry, HdlError> {
    let test = triangle::module(plan)?;
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
    // Every slot is a test, from (-infinity, +infinity).
    for port in test.ports() {
        let value = match port.name.as_str() {
            "window_near" => f.infinity() | f.sign_bit(),
            "window_far" => f.infinity(),
            "matrix" | "accumulate" | "weight" => 0,
            name if name.starts_with("translation_")
                || name.starts_with("sum_") && port.direction == Direction::Input =>
            {
                0
            }
            _ => continue,
        };
        inputs.push((port.name.clone(), m.lit(value, port.width)));
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
