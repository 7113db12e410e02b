//! The ray casting unit: ray setup, traversal processing unit, geometry unit, and who is in which packet's place.

mod properties;

use super::fifo;
use super::plan::{AXES, Plan};
use super::{geometry, setup, skinning, tpu};
use crate::bkd::layout::Record;
use crate::config::{Config, TriangleTest};
use crate::hdl::{Builder, Design, Direction, HdlError, Module, Style};
use properties::{Request, Unit};
use std::sync::Arc;

/// Bits of each counter; they wrap.
pub const COUNTER_BITS: u32 = 40;

/// A machine as it was emitted.
#[derive(Debug)]
pub struct Machine {
    pub config: Config,
    pub design: Design,
}

/// Describes the machine of a configuration. The top module is `raycast_unit`.
///
/// # Errors
/// A mistake in the description itself, with its place in the Rust source.
pub fn emit(config: &Config) -> Result<Machine, HdlError> {
    let plan = Plan::new(config)?;
    Ok(Machine {
        config: config.clone(),
        design: Design::new(module(&plan)?)?,
    })
}

pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let tpu = tpu::module(plan)?;
    let setup = setup::module(plan, tpu.pop_latency)?;
    let geometry = geometry::module(plan)?;
    let skinning = skinning::module(plan, &geometry.test)?;
    let w = plan.number();
    let rays = plan.rays();
    let packets = plan.packets();
    let pb = plan.packet_bits();
    let rb = plan.ray_bits();
    let watertight = plan.config.triangle_test == TriangleTest::Watertight;

    let m = Builder::new(
        "raycast_unit",
        format!(
            "casts packets of {rays} rays into a scene, {packets} packets at a time.\n\
             Rays arrive one a clock, a packet's in order; its hits leave the same way under its tag, packets in any order. \
             After reset, wait for ray_ready."
        ),
    );
    m.group("The scene: root link word and box, constant while packets are under way");
    let root = m.input("scene_root", Record::link_word().width);
    let scene_lo: Vec<_> = AXES.map(|x| m.input(format!("scene_lo_{x}"), w)).into();
    let scene_hi: Vec<_> = AXES.map(|x| m.input(format!("scene_hi_{x}"), w)).into();
    m.group("Rays in");
    let ray_valid = m.input("ray_valid", 1);
    let ray_tag = m.input("ray_tag", plan.config.tag_bits);
    let ray_origin: Vec<_> = AXES.map(|x| m.input(format!("ray_origin_{x}"), w)).into();
    let ray_direction: Vec<_> = AXES
        .map(|x| m.input(format!("ray_direction_{x}"), w))
        .into();
    let ray_tmin = m.input("ray_tmin", w);
    let ray_tmax = m.input("ray_tmax", w);
    let ray_active = m.input("ray_active", 1);
    let ray_any_hit = m.input("ray_any_hit", 1);
    m.group("Hits out");
    let hit_ready = m.input("hit_ready", 1);
    let node = Record::node(plan.format);
    let triangle = Record::triangle();
    let vertex = Record::vertex(plan.format);
    let memory_inputs = |name: &str, title: &str, tag: u32, data: u32| {
        m.group(format!("{title}: requests"));
        let ready = m.input(format!("{name}_request_ready"), 1);
        m.group(format!("{title}: answers, in any order, always taken"));
        let valid = m.input(format!("{name}_response_valid"), 1);
        let tag = m.input(format!("{name}_response_tag"), tag);
        let data = m.input(format!("{name}_response_data"), data);
        (ready, valid, tag, data)
    };
    let node_port = memory_inputs("node", "Node memory", plan.level_packet_bits(), node.width);
    let record_port = memory_inputs("record", "Record memory", pb + 1, triangle.width);
    let corner_tag = pb + geometry::CORNER_BITS;
    let vector_tag = skinning::vector_tag_bits(plan);
    let vertex_tag = corner_tag.max(vector_tag);
    let vertex_port = memory_inputs("vertex", "Vertex memory", vertex_tag, vertex.width);
    let influence_row = Record::influence_row(plan.format);
    let influence_port = memory_inputs(
        "influence",
        "Influence memory",
        skinning::row_tag_bits(plan),
        influence_row.width,
    );
    const SKINNING: &str = "A mesh to skin, taken when no packet is under way: indices of its palette, influence rows, vertices at rest \
         and vertices to write, and how many of each";
    m.group(SKINNING);
    let skin_start = m.input("skin_start_valid", 1);
    let skin_start_inputs: Vec<_> = skinning::start_ports(plan)
        .into_iter()
        .map(|(name, width)| (name, m.input(format!("skin_start_{name}"), width)))
        .collect();
    m.group("Vertex memory: writes of skinned vertices");
    let skin_write_ready = m.input("skin_write_ready", 1);

    m.comment("After reset every packet number is put into the queue of free ones, and what counts by packet is cleared.");
    let sweeping = m.reg_reset("sweeping", 1, 1);
    let sweep_packet = m.reg_reset("sweep_packet", pb, 0);
    sweeping.next(sweeping.q & !sweep_packet.q.equals(u128::from(packets) - 1));
    sweep_packet.next_when(sweeping.q, sweep_packet.q + m.lit(1u8, pb));
    let freed = m.wire("freed", 1);
    let freed_packet = m.wire("freed_packet", pb);
    let take_free = m.wire("take_free", 1);
    let free_queue = fifo::place(
        plan,
        "free_queue",
        packets,
        sweeping.q | freed.get(),
        sweeping.q.mux(sweep_packet.q, freed_packet.get()),
        take_free.get(),
    )?;
    let (free_any, free_front) = (free_queue.valid, free_queue.front);

    m.comment("A packet's rays arrive one by one; the first takes a free packet number, the others share it.");
    let place = m.reg_reset("place", rb, 0);
    let first = place.q.is_zero().named("first_ray");
    let last = place.q.equals(u128::from(rays) - 1).named("last_ray");
    let object_valid = m.wire("object_valid", 1);
    // A mesh to skin does not wait for a pause between packets: it makes one.
    let skinning_now = m.wire("skinning_now", 1);
    let paused = (skin_start | skinning_now.get()).named("paused");
    let ready = (!sweeping.q & free_any & !object_valid.get() & !paused).named("ready");
    let take = (ray_valid & ready).named("take_ray");
    take_free.drive(take & last);
    place.next_when(take, last.mux(m.zero(rb), place.q + m.lit(1u8, rb)));
    let tags = m.memory(
        "tag_memory",
        packets,
        plan.config.tag_bits,
        Style::Distributed,
    );
    tags.write(take & first, free_front, ray_tag);
    m.group("Rays in");
    m.output("ray_ready", ready);

    m.comment(
        "Ray setup: of a ray of the world, or, before that, of one that the geometry unit has taken to an object's space.",
    );
    let names = |prefix: &str| AXES.map(|x| format!("{prefix}_{x}"));
    let is_object = object_valid.get();
    let object_fields = [
        ("packet".to_string(), pb, free_front),
        ("ray".into(), rb, place.q),
        ("first".into(), 1, first),
        ("last".into(), 1, last),
        ("tmin".into(), w, ray_tmin),
        ("tmax".into(), w, ray_tmax),
    ]
    .into_iter()
    .chain((0..3).map(|i| (names("origin")[i].clone(), w, ray_origin[i])))
    .chain((0..3).map(|i| (names("direction")[i].clone(), w, ray_direction[i])));
    let mut inputs = vec![
        ("valid".to_string(), is_object | take),
        ("object".into(), is_object),
        ("active".into(), is_object | ray_active),
        ("any_hit".into(), ray_any_hit),
    ];
    let mut from_object = vec![];
    for (name, width, of_world) in object_fields {
        let of_object = m.wire(format!("object_{name}"), width);
        inputs.push((name.clone(), is_object.mux(of_object.get(), of_world)));
        from_object.push((name, of_object));
    }
    for i in 0..3 {
        inputs.push((names("scene_lo")[i].clone(), scene_lo[i]));
        inputs.push((names("scene_hi")[i].clone(), scene_hi[i]));
    }
    let borrowed: Vec<_> = inputs.iter().map(|(n, s)| (n.as_str(), *s)).collect();
    let set_up = m.instance("setup", &setup, &borrowed);

    m.comment("Traversal and geometry.");
    let leaf_ready = m.wire("leaf_ready", 1);
    let limit_valid = m.wire("limit_valid", 1);
    let limit_packet = m.wire("limit_packet", pb);
    let limit_ray = m.wire("limit_ray", rb);
    let limit_value = m.wire("limit_value", w);
    let done_valid = m.wire("done_valid", 1);
    let done_packet = m.wire("done_packet", pb);
    let context_width = tpu::context(plan).width();
    let done_context = m.wire("done_context", context_width);
    let start_address = m.wire("start_address", plan.address());
    let start_leaf = m.wire("start_leaf", 1);
    let start_context = m.wire("start_context", context_width);
    let mut inputs = vec![
        ("setup_soon".to_string(), set_up.get("soon")),
        ("object_address".into(), start_address.get()),
        ("object_leaf".into(), start_leaf.get()),
        ("object_context".into(), start_context.get()),
        ("root".into(), root),
        ("node_request_ready".into(), node_port.0),
        ("node_response_valid".into(), node_port.1),
        ("node_response_tag".into(), node_port.2),
        ("node_response_data".into(), node_port.3),
        ("leaf_ready".into(), leaf_ready.get()),
        ("limit_valid".into(), limit_valid.get()),
        ("limit_packet".into(), limit_packet.get()),
        ("limit_ray".into(), limit_ray.get()),
        ("limit_value".into(), limit_value.get()),
        ("done_valid".into(), done_valid.get()),
        ("done_packet".into(), done_packet.get()),
        ("done_context".into(), done_context.get()),
    ];
    let mut set_up_fields = vec![
        "valid", "packet", "ray", "first", "last", "object", "enters", "near", "far", "signs",
    ];
    let geometry_names = names("origin").into_iter().chain(names("reciprocal"));
    let shared: Vec<String> = geometry_names.collect();
    set_up_fields.extend(shared.iter().map(String::as_str));
    for field in set_up_fields {
        inputs.push((
            format!("setup_{field}"),
            set_up.get(&format!("out_{field}")),
        ));
    }
    let borrowed: Vec<_> = inputs.iter().map(|(n, s)| (n.as_str(), *s)).collect();
    let traversal = m.instance("traversal", &tpu.module, &borrowed);

    let read_packet = m.wire("read_packet", pb);
    let read_ray = m.wire("read_ray", rb);
    let right_leaf = Record::link_word().field("right_leaf").lsb;
    let vertex_to_geometry = vertex_port.1 & !skinning_now.get();
    let mut inputs = vec![
        ("instanced".to_string(), root.bit(right_leaf)),
        ("setup_next_packet".into(), set_up.get("next_packet")),
        ("leaf_valid".into(), traversal.get("leaf_valid")),
        ("leaf_packet".into(), traversal.get("leaf_packet")),
        ("leaf_address".into(), traversal.get("leaf_address")),
        ("leaf_context".into(), traversal.get("leaf_context")),
        ("leaf_mask".into(), traversal.get("leaf_mask")),
        ("record_request_ready".into(), record_port.0),
        ("record_response_valid".into(), record_port.1),
        ("record_response_tag".into(), record_port.2),
        ("record_response_data".into(), record_port.3),
        ("vertex_request_ready".into(), vertex_port.0),
        ("vertex_response_valid".into(), vertex_to_geometry),
        ("vertex_response_tag".into(), vertex_port.2.low(corner_tag)),
        ("vertex_response_data".into(), vertex_port.3),
        ("skinning".into(), skinning_now.get()),
        ("sweep".into(), sweeping.q),
        ("sweep_packet".into(), sweep_packet.q),
        ("read_packet".into(), read_packet.get()),
        ("read_ray".into(), read_ray.get()),
    ];
    let mut fields = vec![
        "valid", "packet", "ray", "object", "signs", "tmin", "tmax", "any_hit",
    ];
    fields.extend(shared.iter().map(String::as_str));
    let directions = names("direction");
    if watertight {
        fields.extend(["kz", "shear_x", "shear_y", "shear_z"]);
        inputs.push(("world_valid".into(), take));
        inputs.push(("world_packet".into(), free_front));
        inputs.push(("world_ray".into(), place.q));
        for i in 0..3 {
            inputs.push((format!("world_{}", directions[i]), ray_direction[i]));
        }
    } else {
        fields.extend(directions.iter().map(String::as_str));
    }
    for field in fields {
        inputs.push((
            format!("setup_{field}"),
            set_up.get(&format!("out_{field}")),
        ));
    }
    let of_skinning = |direction| {
        let ports = geometry.module.ports().iter();
        let ports = ports.filter(move |port| port.direction == direction);
        ports.filter_map(|port| Some((port.name.strip_prefix("skin_")?, port.width)))
    };
    let mut to_geometry = vec![];
    for (name, width) in of_skinning(Direction::Input) {
        let wire = m.wire(format!("skin_{name}"), width);
        inputs.push((format!("skin_{name}"), wire.get()));
        to_geometry.push((name, wire));
    }
    let borrowed: Vec<_> = inputs.iter().map(|(n, s)| (n.as_str(), *s)).collect();
    let intersection = m.instance("intersection", &geometry.module, &borrowed);
    leaf_ready.drive(intersection.get("leaf_ready"));
    limit_valid.drive(intersection.get("limit_valid"));
    limit_packet.drive(intersection.get("limit_packet"));
    limit_ray.drive(intersection.get("limit_ray"));
    limit_value.drive(intersection.get("limit_value"));
    done_valid.drive(intersection.get("done_valid"));
    done_packet.drive(intersection.get("done_packet"));
    done_context.drive(intersection.get("done_context"));
    start_address.drive(intersection.get("start_address"));
    start_leaf.drive(intersection.get("start_leaf"));
    start_context.drive(intersection.get("start_context"));
    object_valid.drive(intersection.get("object_valid"));
    for (name, wire) in from_object {
        wire.drive(intersection.get(&format!("object_{name}")));
    }

    m.comment("Finished packets hand out their hits ray by ray. The word read is always that of the ray shown next.");
    let out_word = pb + rays;
    let take_finished = m.wire("take_finished", 1);
    let finished_queue = fifo::place(
        plan,
        "finished_queue",
        packets,
        traversal.get("finished_valid"),
        traversal
            .get("finished_touched")
            .concat(traversal.get("finished_packet")),
        take_finished.get(),
    )?;
    let (finished_any, finished_front) = (finished_queue.valid, finished_queue.front);
    let out = m.reg("out", out_word);
    let out_valid = m.reg_reset("out_valid", 1, 0);
    let out_fresh = m.reg("out_fresh", 1);
    let out_ray = m.reg("out_ray", rb);
    let shown = (out_valid.q & out_fresh.q).named("shown");
    let taken = (shown & hit_ready).named("hit_taken");
    let out_last = out_ray.q.equals(u128::from(rays) - 1).named("out_last");
    let leaves = (taken & out_last).named("packet_leaves");
    let load = (finished_any & (!out_valid.q | leaves)).named("load");
    take_finished.drive(load);
    out.next_when(load, finished_front);
    out_valid.next(load | (out_valid.q & !leaves));
    let next_ray = taken
        .mux(out_ray.q + m.lit(1u8, rb), out_ray.q)
        .named("next_ray");
    out_ray.next(load.mux(m.zero(rb), next_ray));
    out_fresh.next(!load & out_valid.q & !leaves);
    let out_packet = out.q.low(pb).named("out_packet");
    read_packet.drive(out_packet);
    read_ray.drive(next_ray);
    freed.drive(leaves);
    freed_packet.drive(out_packet);
    let touched_bits: Vec<_> = (0..rays).map(|i| out.q.bit(pb + i)).collect();
    let touched = m.select(out_ray.q, &touched_bits).named("out_touched");
    let infinity = m.lit(u128::from(plan.format.infinity()), w);
    let hit_of = |name: &str| intersection.get(&format!("read_{name}"));
    let none = m.lit(u128::from(u32::MAX), 32);
    m.group("Hits out");
    m.output("hit_valid", shown);
    let hit_tag = tags.read_now(out_packet);
    m.output("hit_tag", hit_tag);
    m.output("hit_t", touched.mux(hit_of("t"), infinity));
    m.output("hit_u", touched.mux(hit_of("u"), m.zero(w)));
    m.output("hit_v", touched.mux(hit_of("v"), m.zero(w)));
    m.output("hit_instance", touched.mux(hit_of("instance"), none));
    m.output("hit_triangle", touched.mux(hit_of("triangle"), none));

    m.comment("Skinning borrows the geometry unit and its port to vertex memory.");
    let under_way = m.reg_reset("under_way", pb + 1, 0);
    let some = under_way.q.any().named("some_under_way");
    let enters = (take & last).named("packet_enters");
    let unit = m.lit(1u8, pb + 1);
    under_way.next_when(
        enters ^ leaves,
        enters.mux(under_way.q + unit, under_way.q - unit),
    );
    let may_start = !some & !sweeping.q;
    let vertex_to_skinner = vertex_port.1 & skinning_now.get();
    let mut inputs = vec![
        ("start_valid".to_string(), skin_start),
        ("may_start".into(), may_start),
        ("vertex_request_ready".into(), vertex_port.0),
        ("vertex_response_valid".into(), vertex_to_skinner),
        ("vertex_response_tag".into(), vertex_port.2.low(vector_tag)),
        ("vertex_response_data".into(), vertex_port.3),
        ("influence_request_ready".into(), influence_port.0),
        ("influence_response_valid".into(), influence_port.1),
        ("influence_response_tag".into(), influence_port.2),
        ("influence_response_data".into(), influence_port.3),
        ("write_ready".into(), skin_write_ready),
    ];
    for (name, signal) in skin_start_inputs {
        inputs.push((format!("start_{name}"), signal));
    }
    for (name, _) in of_skinning(Direction::Output) {
        inputs.push((name.to_string(), intersection.get(&format!("skin_{name}"))));
    }
    let borrowed: Vec<_> = inputs.iter().map(|(n, s)| (n.as_str(), *s)).collect();
    let skin = m.instance("skinner", &skinning, &borrowed);
    skinning_now.drive(skin.get("skinning"));
    for (name, wire) in to_geometry {
        wire.drive(skin.get(name));
    }
    m.group(SKINNING);
    m.output("skin_start_ready", skin.get("start_ready"));
    m.group("High for a clock when a mesh is complete");
    m.output("skin_done", skin.get("done"));
    m.group("Vertex memory: writes of skinned vertices");
    for port in ["valid", "address", "data"] {
        let name = format!("write_{port}");
        m.output(format!("skin_{name}"), skin.get(&name));
    }

    for (name, title, from) in [
        ("node", "Node memory", &traversal),
        ("record", "Record memory", &intersection),
        ("influence", "Influence memory", &skin),
    ] {
        m.group(format!("{title}: requests"));
        for port in ["valid", "address", "tag"] {
            m.output(
                format!("{name}_request_{port}"),
                from.get(&format!("{name}_request_{port}")),
            );
        }
    }
    m.group("Vertex memory: requests");
    let vertex_request = [
        ("valid", 1),
        ("address", plan.address()),
        ("tag", vertex_tag),
    ]
    .map(|(port, width)| {
        let name = format!("vertex_request_{port}");
        let of_skin = skin.get(&name).extend(width);
        let of_geometry = intersection.get(&name).extend(width);
        let asked = skinning_now.get().mux(of_skin, of_geometry);
        m.output(&name, asked);
        [of_geometry, of_skin, asked]
    });

    m.comment("Counters since reset.");
    let step = traversal.get("step_taken");
    let test = intersection.get("test_issued");
    let transform = intersection.get("transform_issued");
    let slot = intersection.get("slot_taken");
    m.group("Counters since reset");
    let counters = [
        ("cycles", m.lit(1u8, 1)),
        ("packet_steps", step),
        ("ray_triangle_tests", test),
        ("tpu_busy_cycles", step),
        ("tpu_starved_cycles", some & !step),
        ("ray_transforms", transform),
        ("gu_busy_cycles", slot),
        ("gu_starved_cycles", some & !slot),
        ("skin_influences", skin.get("influence_issued")),
        ("skin_cycles", skinning_now.get()),
    ];
    for (name, event) in counters {
        let counter = m.reg_reset(format!("{name}_counter"), COUNTER_BITS, 0);
        counter.next_when(event, counter.q + m.lit(1u8, COUNTER_BITS));
        m.output(format!("count_{name}"), counter.q);
    }
    m.output("stack_high_water", traversal.get("stack_high_water"));
    m.output("stack_overflow", traversal.get("stack_overflow"));

    m.group("What happens inside, for whoever watches");
    m.output("watch_start_valid", take & last);
    m.output("watch_start_packet", free_front);
    m.output(
        "watch_start_tag",
        first.mux(ray_tag, tags.read_now(free_front)),
    );
    m.output("watch_step_valid", step);
    for port in tpu
        .module
        .ports()
        .iter()
        .filter(|p| p.name.starts_with("watch_"))
    {
        m.output(port.name.clone(), traversal.get(&port.name));
    }
    for port in geometry
        .module
        .ports()
        .iter()
        .filter(|p| p.name.starts_with("watch_"))
    {
        m.output(port.name.clone(), intersection.get(&port.name));
    }

    let [of_geometry, of_skinner, request] = [0, 1, 2].map(|who| {
        let [valid, address, tag] = vertex_request.map(|port| port[who]);
        Request {
            valid,
            address,
            tag,
        }
    });
    let unit = Unit {
        packets,
        sweeping: sweeping.q,
        sweep_packet: sweep_packet.q,
        free: free_queue,
        tags,
        under_way: under_way.q,
        ray_tag,
        first_ray: first,
        object_valid: object_valid.get(),
        paused,
        ready,
        take_ray: take,
        enters,
        finished_packet: traversal.get("finished_packet"),
        finished: finished_queue,
        load,
        out: out.q,
        out_valid: out_valid.q,
        out_packet,
        out_ray: out_ray.q,
        hit_valid: shown,
        hit_ready,
        hit_tag,
        hit_taken: taken,
        leaves,
        skin_start,
        skin_start_ready: skin.get("start_ready"),
        may_start,
        skinning: skinning_now.get(),
        of_geometry,
        of_skinner,
        request,
        request_ready: vertex_port.0,
        response: vertex_port.1,
        to_geometry: vertex_to_geometry,
        to_skinner: vertex_to_skinner,
    };
    properties::shares(&m, &unit);
    m.finish()
}
