//! The geometry unit: fetches a leaf and its vertices, and passes the packet's rays one a clock through the triangle test.
//!
//! - A leaf that is a **triangle** takes a slot of the test for each ray; the hits are merged.
//! - A leaf that is an **instance** of an object takes three slots for each ray, in which the test's own operators transform the ray:
//!   *box* (the ray's interval in the instance's box: its window), *direction* and *origin* (each a matrix times a vector). The
//!   transformed ray goes through ray setup again and the packet goes on in the object's space.
//!
//! A packet has at most one leaf under way, so everything here is numbered by its packet, queues are as deep as there are packets,
//! and nothing can overflow. Rays outside a leaf's mask are skipped and cost nothing.
//!
//! While no packet is under way, the skinning processor (`skinning.rs`) borrows the test: it writes a palette of matrices and then
//! issues an influence a clock, which takes a slot.
//!
//! Where a packet's vertices, an instance's six vectors and a palette's matrices are kept:
//!
//! | memory | by packet | behind, by packet | behind, by joint |
//! |---|---|---|---|
//! | `vertex0_memory` | first vertex, or c_x | least corner of the instance's box | p_x |
//! | `vertex1_memory` | second vertex, or c_y | greatest corner | p_y |
//! | `vertex2_memory` | third vertex, or c_z | greatest corner | p_z |
//! | `translation_memory` | c_w | | p_w |

mod properties;

use super::fifo;
use super::fp::{Knowing, Known, equal, less};
use super::plan::{AXES, Plan};
use super::ray::{
    Context, Hit, InContext, Interval, Leaf, Limit, Limits, Line, Place, Start, Tested, Vector,
};
use super::skinning::{Column, Influence, Operands, Sums, Taken, Weighted};
use super::triangle::{self, Corners, Pairs};
use crate::bkd::layout::{Record, fields};
use crate::hdl::{
    Builder, Bundle, Flow, HdlError, Module, ReadInputs, ReadOutputs, Request, Signal, Signals,
    Spec, Specs, Style,
};
use crate::{bundle, interface};
use properties::{Passage, Unit};
use std::sync::Arc;

/// Bits that number a leaf's vertices or vectors in the tags of their requests.
pub(super) const CORNER_BITS: u32 = 3;
const VERTICES_OF_TRIANGLE: u8 = 3;
/// Four columns of the matrix, two corners of the box.
const VECTORS_OF_INSTANCE: u8 = 6;

/// The slots that a ray takes to be transformed, in their order.
const BOX_SLOT: u128 = 0;
const DIRECTION_SLOT: u128 = 1;
const ORIGIN_SLOT: u128 = 2;

bundle! {
    /// What is kept of a ray for its tests.
    pub struct Kept(plan: &Plan) {
        limits: ..{Limits}(plan),
        any_hit: 1,
    }
}

bundle! {
    /// A ray that has been set up, as tests need it.
    pub struct SetUp(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        /// Whether it is in an object's space.
        object: 1,
        tested: ..{Tested}(plan),
        kept: ..{Kept}(plan),
    }
}

bundle! {
    /// A leaf: the tag of its record's request.
    struct Fetched(plan: &Plan) {
        packet: plan.packet_bits(),
        instance: 1,
    }
}

bundle! {
    /// The tag of a vertex's or a vector's request.
    struct Corner(plan: &Plan) {
        number: CORNER_BITS,
        packet: plan.packet_bits(),
    }
}

bundle! {
    /// A direction in the world, and whose it is.
    pub struct World(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        direction: [plan.number(); xyz],
    }
}

bundle! {
    /// A ray in an object's space.
    pub struct Moved(plan: &Plan) {
        place: ..{Place}(plan),
        line: ..{Line}(plan),
        limits: ..{Limits}(plan),
    }
}

bundle! {
    /// A ray-triangle test.
    pub struct TestWatch(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        record: plan.address(),
        instance: 32,
        hit: 1,
        replaces: 1,
        t: plan.number(),
        u: plan.number(),
        v: plan.number(),
    }
}

bundle! {
    /// A ray taken to an object's space, and its interval in the instance's box.
    pub struct TransformWatch(plan: &Plan) {
        packet: plan.packet_bits(),
        ray: plan.ray_bits(),
        record: plan.address(),
        window: ..{Interval}(plan),
        line: ..{Line}(plan),
    }
}

bundle! {
    /// A leaf as it is kept.
    struct LeafWord(plan: &Plan) {
        context: Context::of(plan).width(),
        address: plan.address(),
    }
}

bundle! {
    /// Where an object begins.
    struct Root(plan: &Plan) {
        address: plan.address(),
        leaf: 1,
    }
}

bundle! {
    /// The vertices to fetch for a packet, or an instance's first vector.
    struct Job(plan: &Plan) {
        packet: plan.packet_bits(),
        instance: 1,
        v0: plan.address(),
        v1: plan.address(),
        v2: plan.address(),
    }
}

bundle! {
    /// A ray's closest hit as it is kept.
    struct Closest(plan: &Plan) {
        t: plan.number(),
        u: plan.number(),
        v: plan.number(),
        triangle: 32,
        instance: 32,
    }
}

interface! {
    pub (plan: &Plan) {
        in "A ray that has been set up, of the world or in an object's space" {
            setup: Flow<SetUp>(plan),
        }
        in "The packet of the ray that will have been set up so many clocks later as a memory's read takes" {
            setup_next_packet: plan.packet_bits(),
        }
        in "Whether leaves in the world are instances of objects: bit right_leaf of the scene's root" {
            instanced: 1,
        }
        in "Leaves from the traversal unit" { leaf: Flow<Leaf>(plan) }
        in "" {
            record: {ReadInputs}(
                "Record memory", "in any order, always taken", plan.packet_bits() + 1, Record::triangle().width
            ),
            vertex: {ReadInputs}(
                "Vertex memory", "in any order, always taken",
                plan.packet_bits() + CORNER_BITS, Record::vertex(plan.format).width
            ),
        }
        in "Skinning: whether it borrows this unit" { skinning: 1 }
        in "Skinning: a column of a joint's matrix" {
            skin_palette: Flow<Column>(plan),
        }
        in "Skinning: an influence, and which of its vertex's it is" {
            skin_issue: Flow<Taken>(plan),
        }
        in "Skinning: numbers to add" {
            skin: {Sums}(plan, "", ""),
        }
        in "After reset, packet numbers in turn, to clear what counts by packet" {
            sweep: 1,
            sweep_packet: plan.packet_bits(),
        }
        in "Closest hits are read by packet and ray; the word is there a clock later" {
            read_packet: plan.packet_bits(),
            read_ray: plan.ray_bits(),
        }
        in "A ray of the world as it comes: the watertight test needs its direction for transformations alone" {
            world if (plan.watertight()): Flow<World>(plan),
            setup_shear_z if (plan.watertight()): plan.number(),
        }
        out "Leaves from the traversal unit" { leaf_ready: 1 }
        out "" {
            record: {ReadOutputs}("Record memory", plan.address(), plan.packet_bits() + 1),
            vertex: {ReadOutputs}("Vertex memory", plan.address(), plan.packet_bits() + CORNER_BITS),
        }
        out "Skinning: an influence's vertex moved and weighted, and which of its vertex's it is" {
            skin_weighted: Flow<Weighted>(plan),
        }
        out "Skinning: sums" {
            skin_pair_sum: [plan.number(); xyz],
            skin_vertex_sum: [plan.number(); xyz],
        }
        out "A ray in an object's space, to be set up; its interval comes as tmin and tmax" {
            object: Flow<Moved>(plan),
        }
        out "Where the packet announced by setup_next_packet starts in its object, when its ray has been set up" {
            start: {Start}(plan),
        }
        out "A closer hit of a ray: what its near must not exceed from now on" {
            limit: Flow<Limit>(plan),
        }
        out "A leaf all of whose tests are merged" {
            done: Flow<InContext>(plan),
        }
        out "The closest hit that was asked for, a clock or two later" { read: {Hit}(plan) }
        out "Counters' events" { slot_taken: 1, test_issued: 1, transform_issued: 1 }
        out "The ray-triangle test just merged, for whoever watches" {
            watch_test: Flow<TestWatch>(plan),
        }
        out "The ray just transformed, its interval in the instance's box, and the instance's record, for whoever watches" {
            watch_transform: Flow<TransformWatch>(plan),
        }
    }
}

/// The geometry unit, and the triangle test within.
pub struct Geometry {
    pub module: Arc<Module>,
    pub test: Arc<Module>,
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
    let context = Context::of(plan);
    let vertex = fields::Vertex::of(f);

    let m = Builder::new(
        "geometry_unit",
        "the geometry unit: a leaf's triangle and vertices are fetched, the packet's rays tested one a clock, the hits merged.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let Inputs {
        setup: Flow {
            valid: setup_valid,
            payload: setup,
        },
        setup_next_packet: next_packet,
        instanced,
        leaf,
        record:
            ReadInputs {
                request_ready: record_ready,
                response: record,
            },
        vertex: vertex_memory,
        skinning,
        skin_palette: palette,
        skin_issue: influence,
        skin,
        sweep,
        sweep_packet,
        read_packet: hit_packet,
        read_ray: hit_ray,
        world,
        setup_shear_z,
    } = inputs;
    let (record_valid, record) = (record.valid, record.payload);
    let vertex_ready = vertex_memory.request_ready;
    let Flow {
        valid: vertex_valid,
        payload: arrived,
    } = vertex_memory.response;
    let early = &ports.inputs.setup.payload.tested;
    let limits = &ports.inputs.setup.payload.kept;

    m.comment("A leaf is taken when its record can be requested. Its tag says whether it is an instance's.");
    let leaf_word = LeafWord::of(plan);
    let (fetched, of_corner) = (Fetched::of(plan), Corner::of(plan));
    let take_leaf = (leaf.valid & record_ready).named("take_leaf");
    let Leaf {
        packet: leaf_packet,
        address: leaf_address,
        context: leaf_context,
        mask: leaf_mask,
    } = leaf.payload;
    let leaf_valid = leaf.valid;
    let leaf_data = leaf_word
        .pack(LeafWord {
            context: leaf_context,
            address: leaf_address,
        })
        .named("leaf_data");
    let leaves = m.memory("leaf_memory", packets, leaf_word.width(), Style::Block);
    leaves.write(take_leaf, leaf_packet, leaf_data);
    let masks = m.memory("mask_memory", packets, rays, Style::Distributed);
    masks.write(take_leaf, leaf_packet, leaf_mask);
    let leaf_is_instance =
        (instanced & !context.unpack(leaf_context).inside).named("leaf_is_instance");
    let instance_leaves = m.memory("instance_leaf_memory", packets, 1, Style::Distributed);
    instance_leaves.write(take_leaf, leaf_packet, leaf_is_instance);
    let record_request = Request {
        address: leaf_address,
        tag: fetched.pack(Fetched {
            packet: leaf_packet,
            instance: leaf_is_instance,
        }),
    };

    m.comment(
        "A record's answer: numbers and an instance's root are kept; three vertices, or the six vectors that lie one after another, \
         are requested one a clock.",
    );
    let Fetched {
        packet: record_packet,
        instance: record_is_instance,
    } = fetched.unpack(record.tag);
    let triangle = fields::Triangle::of().unpack(record.data);
    let instance = fields::Instance::of().unpack(record.data);
    let triangle_numbers = m.memory("triangle_number_memory", packets, 32, Style::Block);
    triangle_numbers.write(
        record_valid & !record_is_instance,
        record_packet,
        triangle.number,
    );
    let instance_numbers = m.memory("instance_number_memory", packets, 32, Style::Block);
    let instance_answer = (record_valid & record_is_instance).named("instance_answer");
    instance_numbers.write(instance_answer, record_packet, instance.number);
    let link = fields::Link::of().unpack(instance.root);
    let root = Root::of(plan);
    let root_data = root
        .pack(Root {
            address: link.link.low(a),
            leaf: link.left_leaf,
        })
        .named("root_data");
    let roots = m.memory("root_memory", packets, root.width(), Style::Block);
    roots.write(instance_answer, record_packet, root_data);
    let job = Job::of(plan);
    let job_done = m.wire("job_done", 1);
    let vertex_queue = fifo::place_block(
        plan,
        "vertex_queue",
        packets,
        record_valid,
        job.pack(Job {
            packet: record_packet,
            instance: record_is_instance,
            // An instance's first vector is named where a triangle's first vertex is.
            v0: triangle.v0.low(a),
            v1: triangle.v1.low(a),
            v2: triangle.v2.low(a),
        }),
        job_done.get(),
    )?;
    let (job_valid, job_front) = (vertex_queue.valid, vertex_queue.front);
    let corner = m.reg_reset("corner", CORNER_BITS, 0);
    let vertex_fire = (job_valid & vertex_ready).named("vertex_fire");
    let job = job.unpack(job_front);
    let job_is_instance = job.instance;
    let one_corner = m.lit(1u8, CORNER_BITS);
    let last_corner = corner
        .q
        .eq(last_corner_of(job_is_instance))
        .named("last_corner");
    corner.next_when(
        vertex_fire,
        last_corner.mux(m.zero(CORNER_BITS), corner.q + one_corner),
    );
    job_done.drive(vertex_fire & last_corner);
    let vector_address = (job.v0 + corner.q.extend(a)).named("vector_address");
    let vertex_address = m
        .select(corner.q.low(2), &[job.v0, job.v1, job.v2])
        .named("vertex_address");
    let vertex_request = Request {
        address: job_is_instance.mux(vector_address, vertex_address),
        tag: of_corner.pack(Corner {
            number: corner.q,
            packet: job.packet,
        }),
    };

    m.comment(
        "Vertices and vectors arrive in any order; the last one to come makes the leaf complete.",
    );
    let Corner {
        number: arrived_corner,
        packet: arrived_packet,
    } = of_corner.unpack(arrived.tag);
    let arrives_as = |name: &str, corners: &[u32]| {
        let any: Vec<_> = corners
            .iter()
            .map(|corner| {
                let arrives = arrived_corner.equals(u128::from(*corner));
                arrives.hinted(format!("corner{corner}_arrives"))
            })
            .collect();
        (vertex_valid & m.or_all(&any)).hinted(format!("{name}_takes_it"))
    };
    // Vectors 4 and 5 are an instance's box.
    let arrived_place = arrived_corner.bit(2).concat(arrived_packet);
    let vector_data = skinning
        .mux(palette.payload.data, arrived.data)
        .named("vector_data");
    let joint_width = palette.payload.joint.width();
    let vector_memory = |name: &str, corners: &[u32], place: Signal<'_>, column: u128| {
        let bits = place.width().max(joint_width);
        let depth = (1 << bits) + plan.config.skinning_joints;
        let memory = m.memory(name, depth, vertex.width(), Style::Block);
        let in_palette = palette.payload.joint.extend(bits);
        let place = skinning.mux(in_palette, place.extend(bits));
        let writes_column = palette.valid & palette.payload.column.equals(column);
        let place = place.hinted(format!("{name}_place"));
        memory.write(
            skinning.mux(writes_column, arrives_as(name, corners)),
            skinning.concat(place),
            vector_data,
        );
        memory
    };
    let corners = [
        vector_memory("vertex0_memory", &[0, 4], arrived_place, 0),
        vector_memory("vertex1_memory", &[1, 5], arrived_place, 1),
        vector_memory("vertex2_memory", &[2, 5], arrived_place, 2),
    ];
    let translations = vector_memory("translation_memory", &[3], arrived_packet, 3);
    let arrivals = m.memory("arrival_memory", packets, CORNER_BITS, Style::Distributed);
    let before = arrivals.read_now(arrived_packet);
    let arrived_is_instance = instance_leaves.read_now(arrived_packet);
    let last_arrives = before
        .eq(last_corner_of(arrived_is_instance))
        .named("last_arrives");
    let complete = (vertex_valid & last_arrives).named("leaf_complete");
    let counted = last_arrives.mux(m.zero(CORNER_BITS), before + one_corner);
    arrivals.write(
        sweep | vertex_valid,
        sweep.mux(sweep_packet, arrived_packet),
        sweep.mux(m.zero(CORNER_BITS), counted),
    );

    m.comment(
        "The rays of a complete leaf's mask go into the test, one a clock: a ray once for a triangle, three times for an instance, \
         for its box, the direction and the origin.",
    );
    let take_ready = m.wire("take_ready", 1);
    let ready_queue = fifo::place(
        plan,
        "ready_queue",
        packets,
        complete,
        fetched.pack(Fetched {
            packet: arrived_packet,
            instance: arrived_is_instance,
        }),
        take_ready.get(),
    )?;
    let ready_valid = ready_queue.valid;
    let Fetched {
        packet: ready_packet,
        instance: ready_is_instance,
    } = fetched.unpack(ready_queue.front);
    let ready_mask = masks.read_now(ready_packet);
    let busy = m.reg_reset("busy", 1, 0);
    let now_packet = m.reg("now_packet", pb);
    let now_instance = m.reg("now_instance", 1);
    let now_mask = m.reg("now_mask", rays);
    let now_first = m.reg("now_first", 1);
    let slot = m.reg("slot", 2);
    let (issue_ray, rest_mask) = lowest(&m, now_mask.q, plan.ray_bits());
    let origin_next = slot.q.equals(ORIGIN_SLOT).hinted("slot_is_origin");
    let last_slot = (!now_instance.q | origin_next).named("last_slot");
    let now_last = (last_slot & rest_mask.is_zero()).named("now_last");
    let idle_next = (!busy.q | now_last).named("takes_next");
    let takes = (idle_next & ready_valid).named("takes");
    take_ready.drive(takes);
    busy.next(m.priority(&[(idle_next, ready_valid)], m.lit(1u8, 1)));
    now_packet.next_when(takes, ready_packet);
    now_instance.next_when(takes, ready_is_instance);
    let next_ray = (takes | last_slot).hinted("next_ray");
    now_mask.next_when(next_ray, takes.mux(ready_mask, rest_mask));
    now_first.next_when(next_ray, takes);
    slot.next(next_ray.mux(m.zero(2), slot.q + m.lit(1u8, 2)));
    let transforming = (busy.q & now_instance.q).hinted("transforming");
    let in_slot = |number: u128| transforming & slot.q.equals(number);

    m.comment("The test, and what it lends its operators to.");
    let p = m.pipeline();
    let test_issued = busy.q & !now_instance.q;
    let valid = p.enter(test_issued).cleared_by_reset();
    // What a reset leaves of it is written long before a packet comes for it.
    let box_slot = p.enter(in_slot(BOX_SLOT).named("in_box_slot"));
    let direction_slot = p.enter(in_slot(DIRECTION_SLOT).named("in_direction_slot"));
    let origin_slot = p
        .enter(in_slot(ORIGIN_SLOT).named("in_origin_slot"))
        .cleared_by_reset();
    // A joint goes the packet's way, and beside it with the bits that it has more.
    let Influence {
        joint,
        point,
        weight,
    } = influence.payload.influence;
    let joint_low = joint.extend(joint_width.max(pb)).low(pb);
    let packet = p.enter(
        skinning
            .mux(joint_low, now_packet.q)
            .named("packet_or_joint"),
    );
    let joint_high = (joint_width > pb).then(|| {
        let high = joint.high(joint_width - pb);
        p.enter((high & skinning.repeat(joint_width - pb)).named("joint_high"))
    });
    let ray = p.enter(issue_ray);
    let first = p.enter(now_first.q);
    let last = p.enter(now_last);
    let inside = p.enter((instanced & !now_instance.q).named("now_inside"));
    let by_ray = plan.rays_in_flight();
    let setup_index = plan
        .ray_index(setup.packet, setup.ray)
        .hinted("setup_index");
    let setup_level_index = setup.object.concat(setup_index);
    let of_world = (setup_valid & !setup.object).named("setup_of_world");
    let ray_memory = m.memory(
        "ray_memory",
        plan.level_rays_in_flight(),
        early.width(),
        Style::Block,
    );
    ray_memory.write(setup_valid, setup_level_index, early.pack(setup.tested));
    let limit_memory = m.memory("ray_limit_memory", by_ray, limits.width(), Style::Block);
    limit_memory.write(of_world, setup_index, limits.pack(setup.kept));
    let index = plan.ray_index(packet, ray).named("test_index");
    let level_index = inside.concat(index).named("test_level_index");
    let read = plan.read_latency();
    // The point that the test takes is chosen among three; where the clock asks for it, the test starts a clock after the choice.
    let start = read + plan.choose_latency();
    let ray_word = plan.read(ray_memory, level_index);
    let of_ray = early.unpack(ray_word);
    let direction = match (world, of_ray.direction) {
        (Some(world), _) => {
            let of_world = Vector::of(plan);
            let memory = m.memory("direction_memory", by_ray, of_world.width(), Style::Block);
            let World {
                packet,
                ray,
                direction: axes,
            } = world.payload;
            memory.write(
                world.valid,
                plan.ray_index(packet, ray),
                of_world.pack(Vector { axes }),
            );
            of_world.unpack(plan.read(memory, index)).axes
        }
        (None, Some(direction)) => direction,
        (None, None) => unreachable!("the test needs no direction only if it is watertight"),
    };
    // Above the packet: whether its box is wanted, or the rest of a joint; and whether it is a joint.
    // The skinning processor lends the test for a whole mesh, so that a register more changes nothing, and keeps a fan-out to
    // hundreds of operands off the operators' first stage.
    let skinning_at = |at: u32| match at.checked_sub(1) {
        Some(before) => p.enter_at(skinning, before).register(),
        None => p.enter_at(skinning, at),
    };
    let corner_bits = plan.level_packet_bits().max(joint_width);
    let above_packet = match joint_high {
        Some(high) => high | box_slot.extend(high.width()),
        None => box_slot,
    };
    let corner_index = m.concat(&[
        skinning_at(0),
        above_packet.extend(corner_bits - pb),
        packet,
    ]);
    let corner_index = corner_index.hinted("corner_index");
    let [v0, v1, v2] = corners.map(|memory| {
        let word = plan.read(memory, corner_index.at(start - read));
        vertex.unpack(word).position
    });
    let is_direction = direction_slot.at(read).named("point_is_direction");
    let origin = [0, 1, 2].map(|i| {
        let own = is_direction.mux(direction[i], of_ray.origin[i]);
        let chosen = skinning_at(read).mux(p.enter(point.axes[i]).at(read), own);
        plan.choose(chosen.named(format!("point_{}", AXES[i])))
    });
    let in_transform = (direction_slot | origin_slot).hinted("in_transform_slot");
    let matrix = in_transform.at(start - 1) | skinning_at(start - 1);
    let matrix = matrix.hinted("matrix_slot").register();
    let of_test = triangle::ports(plan);
    let stage_of = |port: &Spec| port.stage(&m, &test) + start;
    let translated_at = of_test.inputs.translation.each_ref().map(stage_of);
    let translated_at = *translated_at.iter().min().expect("three axes");
    let read_at = translated_at - read;
    let translation_index: Vec<_> = [
        Some(skinning_at(read_at)),
        joint_high.map(|high| high.at(read_at)),
        Some(packet.at(read_at)),
    ]
    .into_iter()
    .flatten()
    .collect();
    // A direction is not moved: it has the translation +0.
    let translation = plan.read_where(
        translations,
        m.concat(&translation_index),
        origin_slot.at(read_at) | skinning_at(read_at),
        m.zero(vertex.width()),
    );
    let translation = vertex.unpack(translation).position;
    let infinity = m.lit(u128::from(f.infinity()), w);
    let minus_infinity = m.lit(u128::from(f.infinity() | f.sign_bit()), w);
    let window = Interval::of(plan);
    let window_memory = m.memory("window_memory", by_ray, window.width(), Style::Block);
    let no_window = window.pack(Interval {
        near: minus_infinity,
        far: infinity,
    });
    let windowed_at = stage_of(&of_test.inputs.window.near);
    let window_word = plan.read_where(
        window_memory,
        index.at(windowed_at - read),
        inside.at(windowed_at - read),
        no_window,
    );
    let of_window = window.unpack(window_word);
    let at_limits = stage_of(&of_test.inputs.limits.tmin);
    let limits_word = plan.read(limit_memory, index.at(at_limits - read));
    let kept = limits.unpack(limits_word);
    let tmin = kept.limits.tmin;
    let shear_z = setup_shear_z.zip(of_test.inputs.shear_z.as_ref());
    let shear_z = shear_z.map(|(shear, port)| {
        let memory = m.memory("shear_memory", plan.level_rays_in_flight(), w, Style::Block);
        memory.write(setup_valid, setup_level_index, shear);
        plan.read(memory, level_index.at(stage_of(port) - read))
    });
    let weight = p.enter(weight).at(stage_of(&of_test.inputs.weight));
    let summed_at = stage_of(&of_test.inputs.accumulate);
    let accumulate = skinning_at(summed_at);
    let [x, y, z] = skin.pair;
    let [u, v, t] = skin.vertex;
    let operands = [x, y, z, u, v, t].map(|pair| {
        let [a, b] = [pair.a, pair.b].map(|operand| p.enter_at(operand, summed_at));
        Operands { a, b }
    });
    let operands = triangle::Inputs {
        matrix,
        corners: Corners { v0, v1, v2 },
        ray: Tested { origin, ..of_ray },
        translation,
        weight,
        window: of_window,
        limits: kept.limits,
        shear_z,
        accumulate,
        pairs: Pairs {
            sum_a: operands.map(|pair| pair.a),
            sum_b: operands.map(|pair| pair.b),
        },
    };
    let tested = of_test.place("test", &m, &test, operands);

    let weighted_at = tested.weighted[0].stage();
    let entered = p.enter(influence.valid).cleared_by_reset();
    let weighted = Flow::new(
        entered.at(weighted_at).untimed(),
        Weighted {
            mark: (influence.payload.mark).map(|_, mark| p.enter(mark).at(weighted_at).untimed()),
            point: Vector {
                axes: tested.weighted.map(Signal::untimed),
            },
        },
    );
    let [a, b, c, d, e, f_sum] = tested.sum.map(Signal::untimed);

    m.comment("A ray's window is kept as soon as its box slot has it.");
    let boxed_at = tested.box_near.stage();
    let new_window = window
        .pack(Interval {
            near: tested.box_near,
            far: tested.box_far,
        })
        .untimed();
    window_memory.write(
        box_slot.at(boxed_at).untimed(),
        index.at(boxed_at).untimed(),
        new_window,
    );
    m.comment("The direction waits for the origin, a clock behind it; then the transformed ray leaves, with its interval.");
    let moved = tested.moved;
    let moved_at = moved[0].stage();
    // The box's slot is two clocks ahead of the origin's: its window can be read from stage boxed_at - 1 of the origin's on.
    let leaves_at = moved_at.max(boxed_at + read - 1);
    let moved_direction = [0, 1, 2].map(|i| {
        let held = m.reg(format!("moved_direction_{}", AXES[i]), w);
        held.next_when(direction_slot.at(moved_at).untimed(), moved[i].untimed());
        // It stays until the next ray's, three clocks later.
        p.enter_at(held.q, leaves_at.min(moved_at + 2))
    });
    let own_window = plan.read(window_memory, index.at(leaves_at - read));
    let own_limits = plan.read(limit_memory, index.at(leaves_at - read));
    let own_window = window.unpack(own_window);
    let own_limits = limits.unpack(own_limits).limits;
    let object_near = plan.max(
        "object_near",
        own_limits.tmin.known(Known::Positive),
        own_window.near.known(Known::Number),
    );
    let object_far = plan.min(
        "object_far",
        own_limits.tmax.known(Known::Positive),
        own_window.far.known(Known::Number),
    );
    let left_at = object_near.stage() + 1;
    let left = |signal| Signal::at(signal, left_at).untimed();
    let object = Flow::new(
        left(origin_slot),
        Moved {
            place: Place {
                packet: left(packet),
                ray: left(ray),
                first: left(first),
                last: left(last),
            },
            line: Line {
                origin: moved.map(left),
                direction: moved_direction.map(left),
            },
            limits: Limits {
                tmin: left(object_near),
                tmax: left(object_far),
            },
        },
    );
    let start_root = root.unpack(plan.read(roots, next_packet));
    let start_leaf = leaf_word.unpack(plan.read(leaves, next_packet));
    let start = Start {
        address: start_root.address,
        leaf: start_root.leaf,
        context: context.pack(Context {
            inside: m.lit(1u8, 1),
            ..context.unpack(start_leaf.context)
        }),
    };

    m.comment("The merge: a hit replaces the ray's closest one if it is closer, or as close and of a lower instance and triangle.");
    let hit = tested.hit;
    let merge_at = hit.stage();
    let closest_word = Closest::of(plan);
    let closest = m.memory("closest_memory", by_ray, closest_word.width(), Style::Block);
    let read_at = merge_at - plan.read_latency();
    let old = closest_word.unpack(plan.read(closest, index.at(read_at)));
    let leaf = leaf_word.unpack(plan.read(leaves, packet.at(read_at)));
    let triangle_number = plan.read(triangle_numbers, packet.at(read_at));
    // In a scene of one level every triangle is of instance 0.
    let instance_number = plan.read_where(
        instance_numbers,
        packet.at(read_at),
        inside.at(read_at),
        m.zero(32),
    );
    let any_hit = kept.any_hit;
    let own_context = context.unpack(leaf.context);
    let touched = own_context.touched;
    let was_touched = bit_of(&m, touched, ray.at(merge_at)).named("was_touched");
    let t = tested.t;
    // Distances of hits, where the decision counts: not less than tmin.
    let [new_t, old_t] = [t, old.t].map(|t| t.known(Known::Positive));
    let closer = less(f, "closer", new_t, old_t).named("closer");
    let as_close = equal(f, "as_close", new_t, old_t).named("as_close");
    let identity = instance_number.concat(triangle_number).named("identity");
    let old_identity = old.instance.concat(old.triangle);
    let lower = identity.lt(old_identity).named("lower");
    let replaces = (hit & (any_hit.at(merge_at) | !was_touched | closer | (as_close & lower)))
        .named("replaces")
        .register();
    let merged_at = merge_at + 1;
    let none = m.lit(u128::from(u32::MAX), 32);
    let any = any_hit.at(merged_at);
    let merged = closest_word
        .pack(Closest {
            t: any.mux(tmin.at(merged_at), t.at(merged_at)),
            u: any.mux(m.zero(w), tested.u.at(merged_at)),
            v: any.mux(m.zero(w), tested.v.at(merged_at)),
            triangle: any.mux(none, triangle_number.at(merged_at)),
            instance: any.mux(none, instance_number.at(merged_at)),
        })
        .named("merged");
    let writes = (valid.at(merged_at) & replaces)
        .untimed()
        .named("merge_writes");
    let out_packet = packet.at(merged_at).untimed().named("merge_packet");
    let out_ray = ray.at(merged_at).untimed().named("merge_ray");
    closest.write(
        writes,
        plan.ray_index(out_packet, out_ray),
        merged.untimed(),
    );
    let limit = Flow::new(
        writes,
        Limit {
            packet: out_packet,
            ray: out_ray,
            value: any.mux(minus_infinity, t.at(merged_at)).untimed(),
        },
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
    let newly_touched = m.concat(&one_hot).hinted("newly_touched");
    let now_touched = (so_far | newly_touched).named("now_touched");
    gathered.next_when(valid.at(merged_at).untimed(), now_touched);
    let done = Flow::new(
        (valid.at(merged_at) & last.at(merged_at)).untimed(),
        InContext {
            packet: out_packet,
            context: context.pack(Context {
                level: own_context.level.at(merged_at).untimed(),
                touched: now_touched,
                inside: own_context.inside.at(merged_at).untimed(),
            }),
        },
    );
    let read = m.pipeline();
    let read_index = read.enter(plan.ray_index(hit_packet, hit_ray));
    let read_word = closest_word.unpack(closest.read(read_index).untimed());

    let merged = |signal| Signal::at(signal, merged_at).untimed();
    let watch_test = TestWatch {
        packet: out_packet,
        ray: out_ray,
        record: merged(leaf.address),
        instance: merged(instance_number),
        hit: merged(hit),
        replaces: replaces.untimed(),
        t: merged(t),
        u: merged(tested.u),
        v: merged(tested.v),
    };
    let watched_leaf = plan.read(leaves, packet.at(left_at - plan.read_latency()));
    let watch_transform = TransformWatch {
        packet: object.payload.place.packet,
        ray: object.payload.place.ray,
        record: leaf_word.unpack(watched_leaf).address.untimed(),
        window: own_window.at(left_at).untimed(),
        line: object.payload.line,
    };
    let outputs = Outputs {
        leaf_ready: record_ready,
        record: ReadOutputs {
            request: Flow::new(leaf_valid, record_request),
        },
        vertex: ReadOutputs {
            request: Flow::new(job_valid, vertex_request),
        },
        skin_weighted: weighted,
        skin_pair_sum: [a, b, c],
        skin_vertex_sum: [d, e, f_sum],
        object,
        start,
        limit,
        done,
        read: Hit {
            t: read_word.t,
            u: read_word.u,
            v: read_word.v,
            instance: read_word.instance,
            triangle: read_word.triangle,
        },
        slot_taken: busy.q,
        test_issued,
        transform_issued: in_slot(ORIGIN_SLOT),
        watch_test: Flow::new(merged(valid), watch_test),
        watch_transform: Flow::new(object.valid, watch_transform),
    };
    ports.outputs.outputs(&m, outputs);
    properties::conserves(&Unit {
        packets,
        inputs,
        outputs,
        leaf_is_instance,
        take_leaf,
        masks,
        instance_leaves,
        record_packet,
        record_is_instance,
        vertex_queue,
        job,
        corner: corner.q,
        last_corner,
        vertex_fire,
        arrived_packet,
        arrivals,
        last_arrives,
        complete,
        ready_queue,
        ready_packet,
        ready_is_instance,
        busy: busy.q,
        now_packet: now_packet.q,
        now_instance: now_instance.q,
        now_mask: now_mask.q,
        slot: slot.q,
        issue_ray,
        last_slot,
        now_last,
        idle_next,
        tests: Passage::new(valid, last, packet, merged_at),
        moves: Passage::new(origin_slot, last, packet, left_at),
    });
    Ok(Geometry {
        module: m.finish()?,
        test,
    })
}

/// The last of a leaf's vertices or vectors.
fn last_corner_of(is_instance: Signal<'_>) -> Signal<'_> {
    let m = is_instance.module();
    is_instance.mux(
        m.lit(VECTORS_OF_INSTANCE - 1, CORNER_BITS),
        m.lit(VERTICES_OF_TRIANGLE - 1, CORNER_BITS),
    )
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
