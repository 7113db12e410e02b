//! The ray casting unit: ray setup, traversal processing unit, geometry unit, and who is in which packet's place.

mod properties;

use super::fifo;
use super::geometry::{self, TestWatch, TransformWatch};
use super::plan::Plan;
use super::ray::{Hit, Limits, Line, Place, Tested};
use super::setup;
use super::skinning::{self, Issued, Mesh, Taken};
use super::tpu::{self, StepWatch};
use crate::bkd::layout::{Record, fields};
use crate::config::Config;
use crate::hdl::{
    Builder, Bundle, Design, Flow, HdlError, Module, ReadInputs, ReadOutputs, Response, Spec,
    Specs, Style, Wires, Write,
};
use crate::{bundle, interface};
use properties::Unit;
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

bundle! {
    /// A ray to cast.
    pub struct Ray(plan: &Plan) {
        /// Counts at a packet's first ray.
        tag: plan.config.tag_bits,
        line: ..{Line}(plan),
        limits: ..{Limits}(plan),
        active: 1,
        any_hit: 1,
    }
}

bundle! {
    /// A ray's closest hit, under its packet's tag.
    pub struct TaggedHit(plan: &Plan) {
        tag: plan.config.tag_bits,
        hit: ..{Hit}(plan),
    }
}

bundle! {
    /// A packet all of whose rays have been taken, and its number in flight.
    pub struct StartWatch(plan: &Plan) {
        packet: plan.packet_bits(),
        tag: plan.config.tag_bits,
    }
}

bundle! {
    /// What is counted since reset.
    pub struct Counters() {
        cycles: COUNTER_BITS,
        packet_steps: COUNTER_BITS,
        ray_triangle_tests: COUNTER_BITS,
        tpu_busy_cycles: COUNTER_BITS,
        tpu_starved_cycles: COUNTER_BITS,
        ray_transforms: COUNTER_BITS,
        gu_busy_cycles: COUNTER_BITS,
        gu_starved_cycles: COUNTER_BITS,
        skin_influences: COUNTER_BITS,
        skin_cycles: COUNTER_BITS,
    }
}

/// Bits of the tags of vertex reads: the geometry unit's or the skinning processor's.
fn vertex_tag_bits(plan: &Plan) -> u32 {
    (plan.packet_bits() + geometry::CORNER_BITS).max(skinning::vector_tag_bits(plan))
}

interface! {
    pub (plan: &Plan) {
        in "The scene: root link word and box, constant while packets are under way" {
            scene_root: Record::link_word().width,
            scene_lo: [plan.number(); xyz],
            scene_hi: [plan.number(); xyz],
        }
        in "Rays in" { ray: Flow<Ray>(plan) }
        in "Hits out" { hit_ready: 1 }
        in "" {
            node: {ReadInputs = tpu::Inputs::of(plan).node},
            record: {ReadInputs = geometry::Inputs::of(plan).record},
            vertex: {ReadInputs}(
                "Vertex memory", "in any order, always taken",
                vertex_tag_bits(plan), Record::vertex(plan.format).width
            ),
            influence: {ReadInputs}(
                "Influence memory", "in any order, always taken",
                skinning::row_tag_bits(plan), Record::influence_row(plan.format).width
            ),
        }
        in "A mesh to skin, taken when no packet is under way: indices of its palette, influence rows, vertices at rest \
            and vertices to write, and how many of each" {
            skin_start: Flow<Mesh>(plan),
        }
        in "Vertex memory: writes of skinned vertices" { skin_write_ready: 1 }
        out "Rays in" { ray_ready: 1 }
        out "Hits out" { hit: Flow<TaggedHit>(plan) }
        out "A mesh to skin, taken when no packet is under way: indices of its palette, influence rows, vertices at rest \
            and vertices to write, and how many of each" {
            skin_start_ready: 1,
        }
        out "High for a clock when a mesh is complete" { skin_done: 1 }
        out "Vertex memory: writes of skinned vertices" {
            skin_write: Flow<Write>(plan.address(), Record::vertex(plan.format).width),
        }
        out "" {
            node: {ReadOutputs = tpu::Outputs::of(plan).node},
            record: {ReadOutputs = geometry::Outputs::of(plan).record},
            influence: {ReadOutputs = skinning::Outputs::of(plan).influence},
            vertex: {ReadOutputs}("Vertex memory", plan.address(), vertex_tag_bits(plan)),
        }
        out "Counters since reset" {
            count: {Counters}(),
            stack_high_water: plan.level_bits(),
            stack_overflow: 1,
        }
        out "What happens inside, for whoever watches" {
            watch_start: Flow<StartWatch>(plan),
            watch_step: Flow<StepWatch>(plan),
            watch_test: Flow<TestWatch>(plan),
            watch_transform: Flow<TransformWatch>(plan),
        }
    }
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

    let m = Builder::new(
        "raycast_unit",
        format!(
            "casts packets of {rays} rays into a scene, {packets} packets at a time.\n\
             Rays arrive one a clock, a packet's in order; its hits leave the same way under its tag, packets in any order. \
             After reset, wait for ray_ready."
        ),
    );
    let ports = ports(plan);
    let unit_inputs = ports.inputs.inputs(&m);
    let Inputs {
        scene_root: root,
        scene_lo,
        scene_hi,
        ray: Flow {
            valid: ray_valid,
            payload: ray,
        },
        hit_ready,
        node,
        record,
        vertex,
        influence,
        skin_start,
        skin_write_ready,
    } = unit_inputs;

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
    let paused = (skin_start.valid | skinning_now.get()).named("paused");
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
    tags.write(take & first, free_front, ray.tag);

    m.comment(
        "Ray setup: of a ray of the world, or, before that, of one that the geometry unit has taken to an object's space.",
    );
    let is_object = object_valid.get();
    let of_geometry = geometry::ports(plan);
    // What a ray of the world says, or one of an object's space, whose wire is driven later.
    let chosen = |spec: &Spec, of_world| {
        let of_object = m.wire(&spec.name, spec.width);
        (of_object, is_object.mux(of_object.get(), of_world))
    };
    let spec = &of_geometry.outputs.object.payload;
    let place_chosen = Place {
        packet: chosen(&spec.place.packet, free_front),
        ray: chosen(&spec.place.ray, place.q),
        first: chosen(&spec.place.first, first),
        last: chosen(&spec.place.last, last),
    };
    let limits_chosen = Limits {
        tmin: chosen(&spec.limits.tmin, ray.limits.tmin),
        tmax: chosen(&spec.limits.tmax, ray.limits.tmax),
    };
    let on_axes =
        |specs: &[Spec; 3], of_world: [_; 3]| [0, 1, 2].map(|i| chosen(&specs[i], of_world[i]));
    let line_chosen = Line {
        origin: on_axes(&spec.line.origin, ray.line.origin),
        direction: on_axes(&spec.line.direction, ray.line.direction),
    };
    let inputs = setup::Inputs {
        valid: is_object | take,
        place: place_chosen.map(|_, (_, chosen)| chosen),
        object: is_object,
        active: is_object | ray.active,
        any_hit: ray.any_hit,
        line: line_chosen.map(|_, (_, chosen)| chosen),
        limits: limits_chosen.map(|_, (_, chosen)| chosen),
        scene_lo,
        scene_hi,
    };
    let set_up = setup::ports(plan, tpu.pop_latency).place("setup", &m, &setup, inputs);
    let out = set_up.out.payload;

    m.comment("Traversal and geometry.");
    let leaf_ready = m.wire("leaf_ready", 1);
    let limit = of_geometry.outputs.limit.wires(&m, "limit");
    let done = of_geometry.outputs.done.wires(&m, "done");
    let start = of_geometry.outputs.start.wires(&m, "start");
    let inputs = tpu::Inputs {
        setup_soon: set_up.soon,
        setup: Flow::new(
            set_up.out.valid,
            tpu::SetUp {
                place: out.place,
                enters: out.enters,
                interval: out.interval,
                signs: out.signs,
                origin: out.along.map(|axis| axis.origin),
                reciprocal: out.along.map(|axis| axis.reciprocal),
            },
        ),
        setup_object: out.object,
        object: start.get(),
        root,
        node,
        leaf_ready: leaf_ready.get(),
        limit: limit.get(),
        done: done.get(),
    };
    let traversal = tpu::ports(plan).place("traversal", &m, &tpu.module, inputs);

    let read_packet = m.wire("read_packet", pb);
    let read_ray = m.wire("read_ray", rb);
    let of_inputs = &of_geometry.inputs;
    // The same memory, of which each takes its own responses and as many bits of their tags as it has given.
    let vertex_of = |ports: &ReadInputs<Spec>, its| ReadInputs {
        request_ready: vertex.request_ready,
        response: Flow::new(
            vertex.response.valid & its,
            Response {
                tag: (vertex.response.payload.tag).low(ports.response.payload.tag.width),
                data: vertex.response.payload.data,
            },
        ),
    };
    let vertex_of_geometry = vertex_of(&of_inputs.vertex, !skinning_now.get());
    let palette = of_inputs.skin_palette.wires(&m, "skin_palette");
    let issue = of_inputs.skin_issue.wires(&m, "skin_issue");
    let operands = of_inputs.skin.wires(&m, "skin");
    let inputs = geometry::Inputs {
        setup: Flow::new(
            set_up.out.valid,
            geometry::SetUp {
                packet: out.place.packet,
                ray: out.place.ray,
                object: out.object,
                tested: Tested {
                    origin: out.along.map(|axis| axis.origin),
                    reciprocal: out.along.map(|axis| axis.reciprocal),
                    signs: out.signs,
                    shear: out.shear,
                    direction: out.direction,
                },
                kept: geometry::Kept {
                    limits: out.limits,
                    any_hit: out.any_hit,
                },
            },
        ),
        setup_next_packet: set_up.next_packet,
        instanced: fields::Link::of().unpack(root).right_leaf,
        leaf: traversal.leaf,
        record,
        vertex: vertex_of_geometry,
        skinning: skinning_now.get(),
        skin_palette: palette.get(),
        skin_issue: issue.get(),
        skin: operands.get(),
        sweep: sweeping.q,
        sweep_packet: sweep_packet.q,
        read_packet: read_packet.get(),
        read_ray: read_ray.get(),
        world: plan.watertight().then(|| {
            Flow::new(
                take,
                geometry::World {
                    packet: free_front,
                    ray: place.q,
                    direction: ray.line.direction,
                },
            )
        }),
        setup_shear_z: out.shear_z,
    };
    let intersection = of_geometry.place("intersection", &m, &geometry.module, inputs);
    leaf_ready.drive(intersection.leaf_ready);
    limit.drive(intersection.limit);
    done.drive(intersection.done);
    start.drive(intersection.start);
    let object = intersection.object.payload;
    object_valid.drive(intersection.object.valid);
    (place_chosen.map(|_, (wire, _)| wire)).drive(object.place);
    (limits_chosen.map(|_, (wire, _)| wire)).drive(object.limits);
    (line_chosen.map(|_, (wire, _)| wire)).drive(object.line);

    m.comment("Finished packets hand out their hits ray by ray. The word read is always that of the ray shown next.");
    let out_word = pb + rays;
    let take_finished = m.wire("take_finished", 1);
    let finished_queue = fifo::place(
        plan,
        "finished_queue",
        packets,
        traversal.finished.valid,
        traversal
            .finished
            .payload
            .touched
            .concat(traversal.finished.payload.packet),
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
    let none = m.lit(u128::from(u32::MAX), 32);
    let miss = Hit {
        t: infinity,
        u: m.zero(w),
        v: m.zero(w),
        instance: none,
        triangle: none,
    };
    let hit = TaggedHit {
        tag: tags.read_now(out_packet),
        hit: touched.choose(intersection.read, miss),
    };

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
    let of_skinning = skinning::ports(plan);
    let vertex_of_skinner = vertex_of(&of_skinning.inputs.vertex, skinning_now.get());
    let inputs = skinning::Inputs {
        start: skin_start,
        may_start,
        vertex: vertex_of_skinner,
        influence,
        write_ready: skin_write_ready,
        weighted: intersection.skin_weighted,
        pair_sum: intersection.skin_pair_sum,
        vertex_sum: intersection.skin_vertex_sum,
    };
    let skin = of_skinning.place("skinner", &m, &skinning, inputs);
    skinning_now.drive(skin.skinning);
    palette.drive(skin.palette);
    let Issued { influence, mark } = skin.issue.payload;
    issue.drive(Flow::new(skin.issue.valid, Taken { mark, influence }));
    operands.drive(skin.operands);
    let of_vertex =
        (ports.outputs.vertex.request).zip(skin.vertex.request.zip(intersection.vertex.request));
    let vertex_request = of_vertex.map(|_, (spec, (of_skin, of_geometry))| {
        let [of_skin, of_geometry] =
            [of_skin, of_geometry].map(|request| request.extend(spec.width));
        skinning_now.get().mux(of_skin, of_geometry)
    });

    m.comment("Counters since reset.");
    let step = traversal.step_taken;
    let slot = intersection.slot_taken;
    let events = Counters {
        cycles: m.lit(1u8, 1),
        packet_steps: step,
        ray_triangle_tests: intersection.test_issued,
        tpu_busy_cycles: step,
        tpu_starved_cycles: some & !step,
        ray_transforms: intersection.transform_issued,
        gu_busy_cycles: slot,
        gu_starved_cycles: some & !slot,
        skin_influences: skin.influence_issued,
        skin_cycles: skinning_now.get(),
    };
    let outputs = Outputs {
        ray_ready: ready,
        hit: Flow::new(shown, hit),
        skin_start_ready: skin.start_ready,
        skin_done: skin.done,
        skin_write: skin.write,
        node: traversal.node,
        record: intersection.record,
        influence: skin.influence,
        vertex: ReadOutputs {
            request: vertex_request,
        },
        count: events.map(|name, event| {
            let counter = m.reg_reset(format!("{name}_counter"), COUNTER_BITS, 0);
            counter.next_when(event, counter.q + m.lit(1u8, COUNTER_BITS));
            counter.q
        }),
        stack_high_water: traversal.stack_high_water,
        stack_overflow: traversal.stack_overflow,
        watch_start: Flow::new(
            take & last,
            StartWatch {
                packet: free_front,
                tag: first.mux(ray.tag, tags.read_now(free_front)),
            },
        ),
        watch_step: Flow::new(step, traversal.watch_step),
        watch_test: intersection.watch_test,
        watch_transform: intersection.watch_transform,
    };
    ports.outputs.outputs(&m, outputs);

    let unit = Unit {
        inputs: unit_inputs,
        outputs,
        packets,
        sweeping: sweeping.q,
        sweep_packet: sweep_packet.q,
        free: free_queue,
        tags,
        under_way: under_way.q,
        first_ray: first,
        object_valid: object_valid.get(),
        paused,
        take_ray: take,
        enters,
        finished_packet: traversal.finished.payload.packet,
        finished: finished_queue,
        load,
        out: out.q,
        out_valid: out_valid.q,
        out_packet,
        out_ray: out_ray.q,
        hit_taken: taken,
        leaves,
        may_start,
        skinning: skinning_now.get(),
        of_geometry: intersection.vertex.request,
        of_skinner: skin.vertex.request,
        to_geometry: vertex_of_geometry.response.valid,
        to_skinner: vertex_of_skinner.response.valid,
    };
    properties::shares(&m, &unit);
    m.finish()
}
