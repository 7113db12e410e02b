//! The traversal processing unit: a packet step a clock.
//!
//! A packet under way is in exactly one place: waiting in a queue, in memory as a node request, in the step pipeline, in the
//! pop pipeline, or in the geometry unit. So every queue is as deep as there are packets and can never overflow, every pipeline
//! has a fixed latency and never stalls, and what belongs to a packet travels with it as its *context*.
//!
//! ```text
//! start ──────────────────────────────► pop ──► fetch (popped) ──┐
//!                                        ▲ ▲                     ▼
//!  retry, step's pops, geometry's done ──┘ └── stack        node request
//!                                               ▲                │
//!  step ──► fetch (stepped) ────────────────────┼─► node request ▼
//!   ▲                                           │           node answer
//!   └─ 4 plane distances a ray, decision, push ─┴────────────────┘
//! ```

mod properties;

use super::banks::{BankRead, BankWrite, Banks};
use super::bundle::Bundle;
use super::distance;
use super::fifo::{self, Placed};
use super::fp::{Knowing, Known, Operand, less_equal};
use super::plan::{AXES, Plan};
use crate::bkd::layout::Record;
use crate::hdl::{Builder, HdlError, Memory, Module, Outputs, Reg, Signal, Style, Wire};
use properties::Watched;
use std::sync::Arc;

/// The traversal processing unit, and how long its pop pipeline is.
pub struct Tpu {
    pub module: Arc<Module>,
    /// Clocks from a pop's start to its result. Whatever else writes what a pop writes must say so that long before.
    pub pop_latency: u32,
    /// The slice of one ray, for its own tests.
    pub slice: Arc<Module>,
}

/// Target clock, in MHz, from which on where a packet goes after a start or a pop has a register: whether any of its rays stays is
/// decided in the clock before, and the wires to all queues and memories take the rest of it.
const REGISTER_ENTERED_FROM: u32 = 120;

/// What belongs to a packet beside its rays: how full its stack is, which rays have hit something, and whether it is inside an
/// object, in whose space its rays then are.
pub(super) fn context(plan: &Plan) -> Bundle {
    Bundle::new(&[
        ("level", plan.level_bits()),
        ("touched", plan.rays()),
        ("inside", 1),
    ])
}

/// One ray's part of a packet step: its interval in both children, and where it goes.
fn slice(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let w = plan.number();
    let f = plan.format;
    let m = Builder::new(
        "tpu_slice",
        "one ray's part of a packet step: four plane distances, its interval in each child, where it goes.",
    );
    let p = m.pipeline();
    m.group("The node's intervals");
    let planes: Vec<_> = ["left_lo", "left_hi", "right_lo", "right_hi"]
        .map(|name| p.input(name, w))
        .into();
    m.group("The ray on the left and the right child's axis");
    let sides = ["left", "right"];
    let side_inputs: Vec<_> = sides
        .iter()
        .map(|s| {
            (
                p.input(format!("{s}_sign"), 1),
                p.input(format!("{s}_origin"), w),
                p.input(format!("{s}_reciprocal"), w),
            )
        })
        .collect();
    m.group("The ray's interval in the node, needed when the distances are there");
    let distance_latency = plan.near_distance.latency().unwrap_or(0);
    // A valid ray's 0 <= tmin <= near, and neither near nor far is ever a NaN.
    let near = p.input_at("ray_near", w, distance_latency);
    let far = p.input_at("ray_far", w, distance_latency);
    let active = p.input_at("ray_active", 1, distance_latency);

    let mut intervals = vec![];
    for (side, name) in sides.iter().enumerate() {
        m.comment(format!("The {name} child: near and far planes by the direction's sign, then near and far clipped."));
        let (lo, hi) = (planes[2 * side], planes[2 * side + 1]);
        let (sign, origin, reciprocal) = side_inputs[side];
        let near_plane = sign
            .mux(hi, lo)
            .named(format!("{name}_near_plane"))
            .register();
        let far_plane = sign
            .mux(lo, hi)
            .named(format!("{name}_far_plane"))
            .register();
        let place = |which: &str, module: &Arc<Module>, plane| {
            let instance = format!("{name}_{which}_distance");
            distance::place(instance, module, plane, origin, reciprocal)
        };
        let near_distance = place("near", &plan.near_distance, near_plane);
        let far_distance = place("far", &plan.far_distance, far_plane);
        let near = plan.max(
            format!("{name}_near_clipped"),
            near.known(Known::Positive),
            near_distance.known(Known::Result),
        );
        let far = plan.min(
            format!("{name}_far_clipped"),
            far.known(Known::Number),
            far_distance.known(Known::Result),
        );
        let near = near.register().known(Known::Positive);
        intervals.push((near, far.register().known(Known::Number)));
    }
    m.comment("Where the ray goes.");
    let (left_near, left_far) = intervals[0];
    let (right_near, right_far) = intervals[1];
    let compare = |a, b| plan.decide(less_equal(f, a, b));
    let goes_left = (active & compare(left_near, left_far)).named("goes_left");
    let goes_right = (active & compare(right_near, right_far)).named("goes_right");
    let left_first =
        (goes_left & goes_right & compare(left_near, right_near)).named("both_left_first");
    let [left_near, left_far, right_near, right_far] =
        [left_near, left_far, right_near, right_far].map(Operand::signal);
    let end = left_first.stage().unwrap_or(0) + 1;
    m.group("The ray's interval in the children, and where it goes");
    for (name, signal) in [
        ("left_near", left_near),
        ("left_far", left_far),
        ("right_near", right_near),
        ("right_far", right_far),
        ("to_left", goes_left),
        ("to_right", goes_right),
        ("left_before_right", left_first),
    ] {
        let name = if name.ends_with("near") || name.ends_with("far") {
            format!("out_{name}")
        } else {
            name.to_string()
        };
        m.output(name, signal.at(end));
    }
    m.finish()
}

/// The words that the unit's queues and memories hold.
struct Shapes {
    context: Bundle,
    /// A child to go to.
    item: Bundle,
    leaf_item: Bundle,
    pop_item: Bundle,
    interval: Bundle,
    /// An entry of the stack.
    entry: Bundle,
}

impl Shapes {
    fn new(plan: &Plan) -> Shapes {
        let (w, a, rays) = (plan.number(), plan.address(), plan.rays());
        let context = context(plan);
        let item = Bundle::new(&[
            ("packet", plan.packet_bits()),
            ("address", a),
            ("context", context.width()),
        ]);
        let leaf_item = Bundle::new(&[
            ("packet", plan.packet_bits()),
            ("address", a),
            ("context", context.width()),
            ("mask", rays),
        ]);
        let pop_item = Bundle::new(&[("packet", plan.packet_bits()), ("context", context.width())]);
        let interval = Bundle::new(&[("near", w), ("far", w)]);
        let entry = Bundle::new(&[
            ("address", a),
            ("leaf", 1),
            ("inside", 1),
            ("mask", rays),
            ("intervals", rays * interval.width()),
        ]);
        Shapes {
            context,
            item,
            leaf_item,
            pop_item,
            interval,
            entry,
        }
    }

    /// A packet that pops.
    fn pop<'b>(&self, packet: Signal<'b>, context: Signal<'b>) -> Signal<'b> {
        (self.pop_item).pack(&[("packet", packet), ("context", context)])
    }
}

/// The unit's inputs, named as its ports.
struct Inputs<'b> {
    setup_soon: Signal<'b>,
    setup_valid: Signal<'b>,
    setup_packet: Signal<'b>,
    setup_ray: Signal<'b>,
    setup_first: Signal<'b>,
    setup_last: Signal<'b>,
    setup_enters: Signal<'b>,
    setup_near: Signal<'b>,
    setup_far: Signal<'b>,
    setup_signs: Signal<'b>,
    setup_origin: [Signal<'b>; 3],
    setup_reciprocal: [Signal<'b>; 3],
    setup_object: Signal<'b>,
    object_address: Signal<'b>,
    object_leaf: Signal<'b>,
    object_context: Signal<'b>,
    root: Signal<'b>,
    node_ready: Signal<'b>,
    node_valid: Signal<'b>,
    node_tag: Signal<'b>,
    node_data: Signal<'b>,
    leaf_ready: Signal<'b>,
    limit_valid: Signal<'b>,
    limit_packet: Signal<'b>,
    limit_ray: Signal<'b>,
    limit_value: Signal<'b>,
    done_valid: Signal<'b>,
    done_packet: Signal<'b>,
    done_context: Signal<'b>,
}

impl<'b> Inputs<'b> {
    fn new(m: &'b Builder, plan: &Plan, shapes: &Shapes) -> Inputs<'b> {
        let (w, a) = (plan.number(), plan.address());
        let context = &shapes.context;
        m.group(
            "A ray that has been set up; a packet's last one that comes starts the packet. soon says so pop_latency clocks before",
        );
        let setup_soon = m.input("setup_soon", 1);
        let setup_valid = m.input("setup_valid", 1);
        let setup_packet = m.input("setup_packet", plan.packet_bits());
        let setup_ray = m.input("setup_ray", plan.ray_bits());
        let setup_first = m.input("setup_first", 1);
        let setup_last = m.input("setup_last", 1);
        let setup_enters = m.input("setup_enters", 1);
        let setup_near = m.input("setup_near", w);
        let setup_far = m.input("setup_far", w);
        let setup_signs = m.input("setup_signs", 3);
        let setup_origin = AXES.map(|x| m.input(format!("setup_origin_{x}"), w));
        let setup_reciprocal = AXES.map(|x| m.input(format!("setup_reciprocal_{x}"), w));
        m.group("The ray is in an object's space: where and with which context its packet starts there, beside its last ray");
        let setup_object = m.input("setup_object", 1);
        let object_address = m.input("object_address", a);
        let object_leaf = m.input("object_leaf", 1);
        let object_context = m.input("object_context", context.width());
        m.group("The root link word, constant while packets are under way");
        let root = m.input("root", Record::link_word().width);
        m.group("Node memory: requests");
        let node_ready = m.input("node_request_ready", 1);
        m.group("Node memory: answers, in any order, always taken");
        let node_valid = m.input("node_response_valid", 1);
        let node_tag = m.input("node_response_tag", plan.level_packet_bits());
        let node_data = m.input("node_response_data", Record::node(plan.format).width);
        m.group("Leaves to the geometry unit");
        let leaf_ready = m.input("leaf_ready", 1);
        m.group("A closer hit of a ray: what its near must not exceed from now on");
        let limit_valid = m.input("limit_valid", 1);
        let limit_packet = m.input("limit_packet", plan.packet_bits());
        let limit_ray = m.input("limit_ray", plan.ray_bits());
        let limit_value = m.input("limit_value", w);
        m.group("A leaf all of whose tests are merged");
        let done_valid = m.input("done_valid", 1);
        let done_packet = m.input("done_packet", plan.packet_bits());
        let done_context = m.input("done_context", context.width());
        Inputs {
            setup_soon,
            setup_valid,
            setup_packet,
            setup_ray,
            setup_first,
            setup_last,
            setup_enters,
            setup_near,
            setup_far,
            setup_signs,
            setup_origin,
            setup_reciprocal,
            setup_object,
            object_address,
            object_leaf,
            object_context,
            root,
            node_ready,
            node_valid,
            node_tag,
            node_data,
            leaf_ready,
            limit_valid,
            limit_packet,
            limit_ray,
            limit_value,
            done_valid,
            done_packet,
            done_context,
        }
    }
}

/// The unit under construction: its parts are made in the order of its methods, each from what the earlier ones return.
struct Unit<'b> {
    m: &'b Builder,
    plan: &'b Plan,
    shapes: Shapes,
    inputs: Inputs<'b>,
}

/// Rays by packet and level.
struct Rays<'b> {
    word: Bundle,
    /// By place in the packet.
    memories: Vec<Memory<'b>>,
    /// Whether the ray that has been set up has that place.
    setup_of: Vec<Signal<'b>>,
}

/// What is kept of a packet while its node is fetched.
struct Requests<'b> {
    word: Bundle,
    memory: Memory<'b>,
    fire: Wire<'b>,
    item: Wire<'b>,
    popped: Wire<'b>,
}

/// Intervals and masks of packets in the nodes that they go to, as steps leave them and as pops and starts do.
struct Intervals<'b> {
    stepped: Memory<'b>,
    stepped_write: Wire<'b>,
    stepped_packet: Wire<'b>,
    stepped_mask: Wire<'b>,
    stepped_intervals: Wire<'b>,
    popped_masks: Memory<'b>,
    popped_packet: Wire<'b>,
    popped_mask_write: Wire<'b>,
    popped_mask: Wire<'b>,
    /// By place in the packet.
    popped: Vec<Memory<'b>>,
    popped_write: Vec<Wire<'b>>,
    popped_interval: Vec<Wire<'b>>,
}

/// The step pipeline up to the slices' results.
struct Sliced<'b> {
    valid: Signal<'b>,
    packet: Signal<'b>,
    node: Signal<'b>,
    request: Signal<'b>,
    slices: Vec<Outputs<'b>>,
    /// The stage of the slices' results.
    decided: u32,
}

/// A packet step that has been decided: where the packet goes first, and what it pushes.
struct Step<'b> {
    valid: Signal<'b>,
    packet: Signal<'b>,
    /// Whether some ray goes left, and right; whether both; and the level then, in the pipeline.
    goes_left: Signal<'b>,
    goes_right: Signal<'b>,
    goes_both: Signal<'b>,
    level_before: Signal<'b>,
    /// Whether it goes anywhere.
    goes: Signal<'b>,
    leaf: Signal<'b>,
    address: Signal<'b>,
    context: Signal<'b>,
    mask: Signal<'b>,
    push: Signal<'b>,
    /// Entries on the stack before.
    push_level: Signal<'b>,
    push_word: Signal<'b>,
    /// Name and value of each watch port.
    watch: Vec<(&'static str, Signal<'b>)>,
}

/// The stack of all packets.
struct Stack<'b> {
    memory: Banks<'b>,
    /// Bits of a packet's number in its address.
    packet_bits: u32,
    write: Signal<'b>,
    bank_writes: Vec<BankWrite<'b>>,
    /// Entries on the stack after.
    level_after: Signal<'b>,
    overflow: Reg<'b>,
    high_water: Reg<'b>,
}

/// What comes out of the pop pipeline.
struct Pop<'b> {
    latency: u32,
    /// The queues of packets that are to pop: from the geometry unit, once more, from steps that went nowhere.
    queues: [Placed<'b>; 3],
    /// Whether a packet enters the pipeline.
    valid: Signal<'b>,
    /// The packet that does, its level, and whether its stack is empty; where the clock asks for it, a clock later.
    popping: Signal<'b>,
    popping_packet: Signal<'b>,
    popping_level: Signal<'b>,
    popping_empty: Signal<'b>,
    entry: BankRead<'b>,
    /// The rays that stay, as it is decided.
    stays: Signal<'b>,
    done: Signal<'b>,
    packet: Signal<'b>,
    /// Whether the stack was empty.
    empty: Signal<'b>,
    mask: Signal<'b>,
    touched: Signal<'b>,
    address: Signal<'b>,
    leaf: Signal<'b>,
    context: Signal<'b>,
    level: Signal<'b>,
    intervals: Vec<Signal<'b>>,
    /// Whether some ray stays, or none does.
    goes: Signal<'b>,
    dropped: Signal<'b>,
    retry_push: Wire<'b>,
    retry_item: Wire<'b>,
}

/// A packet that goes somewhere after a pop or a start.
struct Entered<'b> {
    /// Whether it goes somewhere; from [`REGISTER_ENTERED_FROM`] on, a clock before the rest.
    decided: Signal<'b>,
    registered: bool,
    valid: Signal<'b>,
    leaf: Signal<'b>,
    address: Signal<'b>,
    context: Signal<'b>,
    /// The packet that starts or whose pop ends; from [`REGISTER_ENTERED_FROM`] on, a clock before the rest.
    packet: Signal<'b>,
    /// Whether it starts nowhere, being of the world; in the same clock.
    none_enters: Signal<'b>,
}

/// Two queues of which one is served.
struct Served<'b> {
    preferred: Placed<'b>,
    other: Placed<'b>,
    valid: Signal<'b>,
    ready: Signal<'b>,
    held: Held<'b>,
}

/// A choice that stays while what it offers is not taken.
struct Held<'b> {
    /// Whether it is the preferred one.
    choice: Signal<'b>,
    /// Whether something was offered and not taken, and from which it was.
    waits: Signal<'b>,
    waiting_choice: Signal<'b>,
}

impl<'b> Unit<'b> {
    fn rays(&self) -> Rays<'b> {
        let (m, plan) = (self.m, self.plan);
        let rays = plan.rays();
        let Inputs {
            setup_valid,
            setup_packet,
            setup_ray,
            setup_signs,
            setup_origin,
            setup_reciprocal,
            setup_object,
            ..
        } = self.inputs;
        let w = plan.number();
        m.comment(
            "Rays: origin, reciprocal and signs, a memory for each place in the packet, written when set up: in the world, and behind that \
             in the object's space, so that the world's are still there when the packet leaves an object.",
        );
        let ray_word = Bundle::new(&[
            ("origin_x", w),
            ("origin_y", w),
            ("origin_z", w),
            ("reciprocal_x", w),
            ("reciprocal_y", w),
            ("reciprocal_z", w),
            ("signs", 3),
        ]);
        let setup_word = ray_word
            .pack(&[
                ("origin_x", setup_origin[0]),
                ("origin_y", setup_origin[1]),
                ("origin_z", setup_origin[2]),
                ("reciprocal_x", setup_reciprocal[0]),
                ("reciprocal_y", setup_reciprocal[1]),
                ("reciprocal_z", setup_reciprocal[2]),
                ("signs", setup_signs),
            ])
            .named("setup_word");
        let setup_of: Vec<_> = (0..rays)
            .map(|i| {
                (setup_valid & setup_ray.equals(u128::from(i))).named(format!("setup_of_ray{i}"))
            })
            .collect();
        let ray_memory: Vec<_> = (0..rays)
            .map(|i| {
                let memory = m.memory(
                    format!("ray{i}_memory"),
                    plan.level_packets(),
                    ray_word.width(),
                    Style::Block,
                );
                let place = setup_object.concat(setup_packet);
                memory.write(setup_of[i as usize], place, setup_word);
                memory
            })
            .collect();
        Rays {
            word: ray_word,
            memories: ray_memory,
            setup_of,
        }
    }

    fn requests(&self) -> Requests<'b> {
        let (m, plan) = (self.m, self.plan);
        let Shapes { context, item, .. } = &self.shapes;
        let packets = plan.packets();
        let a = plan.address();
        m.comment(
            "Where a requested node lies, and its packet's context, kept while the request is out.",
        );
        let request_word =
            Bundle::new(&[("address", a), ("context", context.width()), ("popped", 1)]);
        let request_fire = m.wire("request_fire", 1);
        let request_item = m.wire("request_item", item.width());
        let request_popped = m.wire("request_popped", 1);
        let requests = m.memory(
            "request_memory",
            packets,
            request_word.width(),
            Style::Distributed,
        );
        requests.write(
            request_fire.get(),
            item.get(request_item.get(), "packet"),
            request_word.pack(&[
                ("address", item.get(request_item.get(), "address")),
                ("context", item.get(request_item.get(), "context")),
                ("popped", request_popped.get()),
            ]),
        );
        Requests {
            word: request_word,
            memory: requests,
            fire: request_fire,
            item: request_item,
            popped: request_popped,
        }
    }

    fn intervals(&self) -> Intervals<'b> {
        let (m, plan) = (self.m, self.plan);
        let Shapes { interval, .. } = &self.shapes;
        let rays = plan.rays();
        let packets = plan.packets();
        m.comment("Intervals and mask of the packet in the node it goes to: as a step left them, and as a pop or the setup did.");
        let stepped_write = m.wire("stepped_write", 1);
        let stepped_packet = m.wire("stepped_packet", plan.packet_bits());
        let stepped_mask = m.wire("stepped_mask", rays);
        let stepped_intervals = m.wire("stepped_intervals", rays * interval.width());
        let stepped = m.memory(
            "stepped_memory",
            packets,
            rays * (1 + interval.width()),
            Style::Block,
        );
        stepped.write(
            stepped_write.get(),
            stepped_packet.get(),
            stepped_mask.get().concat(stepped_intervals.get()),
        );
        let popped_packet = m.wire("popped_packet", plan.packet_bits());
        let popped_mask_write = m.wire("popped_mask_write", 1);
        let popped_mask = m.wire("popped_mask", rays);
        let popped_masks = m.memory("popped_mask_memory", packets, rays, Style::Distributed);
        popped_masks.write(
            popped_mask_write.get(),
            popped_packet.get(),
            popped_mask.get(),
        );
        let popped_write: Vec<_> = (0..rays)
            .map(|i| m.wire(format!("popped_write{i}"), 1))
            .collect();
        let popped_interval: Vec<_> = (0..rays)
            .map(|i| m.wire(format!("popped_interval{i}"), interval.width()))
            .collect();
        let popped: Vec<_> = (0..rays as usize)
            .map(|i| {
                let memory = m.memory(
                    format!("popped{i}_memory"),
                    packets,
                    interval.width(),
                    Style::Block,
                );
                memory.write(
                    popped_write[i].get(),
                    popped_packet.get(),
                    popped_interval[i].get(),
                );
                memory
            })
            .collect();
        Intervals {
            stepped,
            stepped_write,
            stepped_packet,
            stepped_mask,
            stepped_intervals,
            popped_masks,
            popped_packet,
            popped_mask_write,
            popped_mask,
            popped,
            popped_write,
            popped_interval,
        }
    }

    /// The step pipeline: a node's answer enters with the packet's rays.
    fn slices(
        &self,
        slice: &Arc<Module>,
        rays_of: &Rays<'b>,
        kept: &Requests<'b>,
        intervals: &Intervals<'b>,
    ) -> Sliced<'b> {
        let (m, plan) = (self.m, self.plan);
        let Shapes { interval, .. } = &self.shapes;
        let Inputs {
            node_valid,
            node_tag,
            node_data,
            ..
        } = self.inputs;
        let rays = plan.rays();
        m.comment("The packet step. A node's answer enters with the packet's rays.");
        let p = m.pipeline();
        let valid = p.enter(node_valid).cleared_by_reset();
        let level_packet = p.enter(node_tag);
        let packet = level_packet.low(plan.packet_bits()).named("packet");
        let node = p.enter(node_data);
        let node_record = Record::node(plan.format);
        let field = |name: &str| {
            let field = node_record.field(name);
            node.field(field.lsb, field.width)
        };
        let named_field = |name: &'static str| (name, field(name).named(name));
        let planes = ["left_lo", "left_hi", "right_lo", "right_hi"].map(named_field);
        let left_axis = named_field("left_axis").1;
        let axes = match plan.config.axes_per_node {
            // One axis bounds both children: the right one's would say the same.
            1 => [left_axis; 2],
            _ => [left_axis, named_field("right_axis").1],
        };
        let slice_near = slice
            .port("ray_near")
            .and_then(|port| port.stage)
            .unwrap_or(0);
        let mut slices = vec![];
        let mut decided = 0;
        let sides = ["left", "right"];
        let ray_words: Vec<_> = rays_of
            .memories
            .iter()
            .map(|memory| plan.read(*memory, level_packet))
            .collect();
        let entry_stage = packet.stage().unwrap_or(0) + plan.read_latency() + 1;
        let read_at = entry_stage + slice_near - plan.read_latency();
        let late_packet = packet.at(read_at);
        let request = kept
            .memory
            .read_now(packet.at(read_at + plan.read_latency() - 1))
            .register();
        let from_pop = kept.word.get(request, "popped");
        let stepped_word = plan.read(intervals.stepped, late_packet);
        let popped_mask_word = intervals
            .popped_masks
            .read_now(packet.at(read_at + plan.read_latency() - 1))
            .register();
        let mask_in = from_pop
            .mux(popped_mask_word, stepped_word.high(rays))
            .named("mask_in");
        for (i, word) in ray_words.into_iter().enumerate() {
            let popped_word = plan.read(intervals.popped[i], late_packet);
            let current = from_pop
                .mux(
                    popped_word,
                    stepped_word.field(i as u32 * interval.width(), interval.width()),
                )
                .named(format!("ray{i}_interval"));
            let mut inputs = vec![];
            for (side, name) in sides.iter().enumerate() {
                let axis = axes[side];
                let along = |what: &str| {
                    let of = AXES.map(|x| rays_of.word.get(word, &format!("{what}_{x}")));
                    m.select(axis, &of)
                };
                let signs = rays_of.word.get(word, "signs");
                let sign = m
                    .select(axis, &[signs.bit(0), signs.bit(1), signs.bit(2)])
                    .named(format!("ray{i}_{name}_sign"));
                inputs.push((format!("{name}_sign"), sign.register()));
                inputs.push((
                    format!("{name}_origin"),
                    along("origin")
                        .named(format!("ray{i}_{name}_origin"))
                        .register(),
                ));
                inputs.push((
                    format!("{name}_reciprocal"),
                    along("reciprocal")
                        .named(format!("ray{i}_{name}_reciprocal"))
                        .register(),
                ));
            }
            for (name, plane) in planes {
                inputs.push((name.to_string(), plane));
            }
            inputs.push(("ray_near".into(), interval.get(current, "near")));
            inputs.push(("ray_far".into(), interval.get(current, "far")));
            inputs.push(("ray_active".into(), mask_in.bit(i as u32)));
            let inputs: Vec<(&str, Signal<'_>)> =
                inputs.iter().map(|(n, s)| (n.as_str(), *s)).collect();
            let placed = m.instance(format!("slice{i}"), slice, &inputs);
            decided = placed.get("out_left_near").stage().unwrap_or(0);
            slices.push(placed);
        }
        Sliced {
            valid,
            packet,
            node,
            request,
            slices,
            decided,
        }
    }

    /// The packet's decision.
    fn decide(
        &self,
        sliced: &Sliced<'b>,
        kept: &Requests<'b>,
        intervals: &Intervals<'b>,
    ) -> Step<'b> {
        let (m, plan) = (self.m, self.plan);
        let Shapes {
            context,
            interval,
            entry,
            ..
        } = &self.shapes;
        let a = plan.address();
        let Sliced {
            valid,
            packet,
            node,
            request,
            ref slices,
            decided,
        } = *sliced;
        let node_record = Record::node(plan.format);
        let field = |name: &str| {
            let field = node_record.field(name);
            node.field(field.lsb, field.width)
        };
        let named_field = |name: &'static str| (name, field(name).named(name));
        m.comment("The packet's decision.");
        let gather = |name: &str| {
            let bits: Vec<_> = slices.iter().rev().map(|s| s.get(name)).collect();
            m.concat(&bits)
        };
        let to_left = gather("to_left").named("to_left");
        let to_right = gather("to_right").named("to_right");
        let goes_left = to_left.any().named("goes_left");
        let goes_right = to_right.any().named("goes_right");
        let some_left_first = gather("left_before_right").any();
        let left_first = (goes_left & (some_left_first | !goes_right)).named("left_first");
        let intervals_of = |side: &str| {
            let parts: Vec<_> = slices
                .iter()
                .rev()
                .map(|s| {
                    interval.pack(&[
                        ("near", s.get(&format!("out_{side}_near"))),
                        ("far", s.get(&format!("out_{side}_far"))),
                    ])
                })
                .collect();
            m.concat(&parts)
        };
        let left_intervals = intervals_of("left").named("left_intervals");
        let right_intervals = intervals_of("right").named("right_intervals");

        let own = kept
            .word
            .get(request, "address")
            .at(decided)
            .named("own_address");
        let context_in = kept.word.get(request, "context").at(decided);
        let link = field("link").low(a).named("link");
        let left_leaf = named_field("left_leaf").1;
        let right_leaf = named_field("right_leaf").1;
        let link_after = (link + m.lit(1u8, a)).named("link_after");
        let right_inner = left_leaf.mux(link, link_after);
        let left_address = left_leaf
            .at(decided)
            .mux(own, link.at(decided))
            .named("left_address");
        let right_address = right_leaf
            .at(decided)
            .mux(
                left_leaf.at(decided).mux(link.at(decided), own),
                right_inner.register().at(decided),
            )
            .named("right_address");
        let first_leaf = left_first.mux(left_leaf.at(decided), right_leaf.at(decided));
        let second_leaf = left_first.mux(right_leaf.at(decided), left_leaf.at(decided));
        let first_address = left_first.mux(left_address, right_address);
        let second_address = left_first.mux(right_address, left_address);
        let first_mask = left_first.mux(to_left, to_right);
        let second_mask = left_first.mux(to_right, to_left);
        let first_intervals = left_first.mux(left_intervals, right_intervals);
        let second_intervals = left_first.mux(right_intervals, left_intervals);
        let level = context.get(context_in, "level");
        let touched = context.get(context_in, "touched");
        let inside = context.get(context_in, "inside");
        let both = (goes_left & goes_right).named("goes_both");
        let pushes = (both & valid.at(decided))
            .named("pushes")
            .cleared_by_reset();
        let next_level = (level + both.extend(plan.level_bits())).named("next_level");
        let next_context = context.pack(&[
            ("level", next_level),
            ("touched", touched),
            ("inside", inside),
        ]);

        let step_valid = valid.at(decided).register().untimed().named("step_valid");
        let step_packet = packet.at(decided + 1).untimed().named("step_packet");
        let step_goes = (goes_left | goes_right)
            .named("goes_on")
            .register()
            .untimed();
        let step_leaf = first_leaf.named("first_leaf").register().untimed();
        let step_address = first_address.named("first_address").register().untimed();
        let step_context = next_context.named("next_context").register().untimed();
        let step_mask = first_mask.named("first_mask").register().untimed();
        let step_intervals = first_intervals
            .named("first_intervals")
            .register()
            .untimed();
        intervals
            .stepped_write
            .drive((step_valid & step_goes).named("step_goes_on"));
        intervals.stepped_packet.drive(step_packet);
        intervals.stepped_mask.drive(step_mask);
        intervals.stepped_intervals.drive(step_intervals);
        m.comment("The stack.");
        let push = pushes.register().untimed();
        let level_before = level.named("level_before");
        let push_level = level_before.at(decided + 1).untimed();
        let push_word = entry
            .pack(&[
                ("address", second_address.named("second_address")),
                ("leaf", second_leaf.named("second_leaf")),
                ("inside", inside),
                ("mask", second_mask.named("second_mask")),
                ("intervals", second_intervals.named("second_intervals")),
            ])
            .register()
            .untimed();
        let watch = vec![
            ("watch_step_packet", step_packet),
            ("watch_step_node", own.at(decided + 1).untimed()),
            ("watch_step_left", to_left.at(decided + 1).untimed()),
            ("watch_step_right", to_right.at(decided + 1).untimed()),
            (
                "watch_step_left_first",
                left_first.at(decided + 1).untimed(),
            ),
            (
                "watch_step_left_intervals",
                left_intervals.at(decided + 1).untimed(),
            ),
            (
                "watch_step_right_intervals",
                right_intervals.at(decided + 1).untimed(),
            ),
        ];
        Step {
            valid: step_valid,
            packet: step_packet,
            goes_left,
            goes_right,
            goes_both: both,
            level_before,
            goes: step_goes,
            leaf: step_leaf,
            address: step_address,
            context: step_context,
            mask: step_mask,
            push,
            push_level,
            push_word,
            watch,
        }
    }

    /// The stack, and what a step pushes.
    fn push(&self, step: &Step<'b>) -> Stack<'b> {
        let (m, plan) = (self.m, self.plan);
        let Shapes { context, entry, .. } = &self.shapes;
        let packets = plan.packets();
        let full = step
            .push_level
            .equals(u128::from(plan.config.stack_depth))
            .named("stack_full");
        let stack_write = (step.push & !full).named("stack_write");
        let entries = packets << plan.stack_bits();
        let stack = Banks::new(plan, m, "stack", entries, entry.width());
        let stack_address_bits = crate::hdl::bits_for(u64::from(entries));
        let fit = stack_address_bits - plan.stack_bits();
        let bank_writes = stack.write(
            stack_write,
            step.packet
                .low(fit)
                .concat(step.push_level.low(plan.stack_bits())),
            step.push_word,
        );
        let overflow = m.reg_reset("overflow", 1, 0);
        overflow.next(overflow.q | (step.push & full));
        let high_water = m.reg_reset("high_water", plan.level_bits(), 0);
        let level_after = context.get(step.context, "level");
        high_water.next_when(step.push & high_water.q.lt(level_after), level_after);
        Stack {
            memory: stack,
            packet_bits: fit,
            write: stack_write,
            bank_writes,
            level_after,
            overflow,
            high_water,
        }
    }

    /// Packets that pop.
    fn pop(&self, step: &Step<'b>, stack: &Stack<'b>) -> Result<Pop<'b>, HdlError> {
        let (m, plan) = (self.m, self.plan);
        let rays = plan.rays();
        let Shapes {
            context,
            pop_item,
            interval,
            entry,
            ..
        } = &self.shapes;
        let Inputs {
            setup_soon,
            limit_valid,
            limit_packet,
            limit_ray,
            limit_value,
            done_valid,
            done_packet,
            done_context,
            ..
        } = self.inputs;
        let w = plan.number();
        let f = plan.format;
        let packets = plan.packets();
        m.comment(
            "Packets that pop: from the geometry unit, from steps that went nowhere, and again after a dropped entry or an instance \
             that no ray enters.",
        );
        let take_done = m.wire("take_done", 1);
        let take_retry = m.wire("take_retry", 1);
        let take_stepped = m.wire("take_stepped_pop", 1);
        let retry_push = m.wire("retry_push", 1);
        let retry_item = m.wire("retry_item", pop_item.width());
        let done_queue = fifo::place(
            plan,
            "done_queue",
            packets,
            done_valid,
            self.shapes.pop(done_packet, done_context),
            take_done.get(),
        )?;
        let (done_any, done_front) = (done_queue.valid, done_queue.front);
        let retry_queue = fifo::place(
            plan,
            "retry_queue",
            packets,
            retry_push.get(),
            retry_item.get(),
            take_retry.get(),
        )?;
        let (retry_any, retry_front) = (retry_queue.valid, retry_queue.front);
        let nowhere_queue = fifo::place(
            plan,
            "nowhere_queue",
            packets,
            (step.valid & !step.goes).named("step_goes_nowhere"),
            self.shapes.pop(step.packet, step.context),
            take_stepped.get(),
        )?;
        let (nowhere_any, nowhere_front) = (nowhere_queue.valid, nowhere_queue.front);
        let may_pop = (!setup_soon).named("may_pop");
        take_retry.drive(may_pop & retry_any);
        take_done.drive(may_pop & !retry_any & done_any);
        take_stepped.drive(may_pop & !retry_any & !done_any & nowhere_any);

        m.comment("The pop.");
        let q = m.pipeline();
        let pop_valid = q
            .enter(may_pop & (retry_any | done_any | nowhere_any))
            .named("pop_valid")
            .cleared_by_reset();
        let chosen = q
            .enter(m.priority(
                &[(retry_any, retry_front), (done_any, done_front)],
                nowhere_front,
            ))
            .named("pop_chosen");
        let pop = plan.choose(chosen).named("pop");
        let pop_packet = pop_item.get(pop, "packet");
        let pop_context = pop_item.get(pop, "context");
        let pop_level = context.get(pop_context, "level");
        let pop_touched = context.get(pop_context, "touched");
        let stack_empty = pop_level.is_zero().named("stack_empty");
        let level_below = (pop_level - m.lit(1u8, plan.level_bits())).named("level_below");
        let read_entry = stack.memory.read(
            plan,
            pop_packet
                .low(stack.packet_bits)
                .concat(level_below.low(plan.stack_bits())),
        );
        let popped_entry = read_entry.word;
        let before_entry = popped_entry.stage().unwrap_or(1) - 1;
        let entry_mask = entry.get(popped_entry, "mask");
        let entry_intervals = entry.get(popped_entry, "intervals");
        let mut stays = vec![];
        let mut pop_intervals = vec![];
        for i in 0..rays {
            let limits = m.memory(format!("limit{i}_memory"), packets, w, Style::Distributed);
            limits.write(
                limit_valid & limit_ray.equals(u128::from(i)),
                limit_packet,
                limit_value,
            );
            let limit = limits.read_now(pop_packet.at(before_entry)).register();
            let word = entry_intervals.field(i * interval.width(), interval.width());
            let near = interval.get(word, "near");
            let far = interval.get(word, "far");
            let touched = pop_touched.bit(i);
            // Any hit's limit is minus infinity; a closest hit's is a distance.
            let limit = limit.known(Known::Number);
            let within =
                less_equal(f, near.known(Known::Positive), limit).named(format!("ray{i}_within"));
            let stay = (entry_mask.bit(i) & (within | !touched)).named(format!("ray{i}_stays"));
            let nearer = plan.min(
                format!("ray{i}_far_or_limit"),
                far.known(Known::Number),
                limit,
            );
            let clipped = touched.mux(nearer, far).named(format!("ray{i}_far"));
            stays.push(plan.settle(stay));
            pop_intervals.push(plan.settle(interval.pack(&[("near", near), ("far", clipped)])));
        }
        stays.reverse();
        let stays = m.concat(&stays).named("stay_mask");
        let stay_mask = stays.register();
        let pop_intervals: Vec<_> = pop_intervals.into_iter().map(|s| s.register()).collect();
        // What clips a far may take a clock more than what a ray stays by.
        let pop_latency = (pop_intervals.iter().chain([&stay_mask]))
            .filter_map(Signal::stage)
            .max()
            .unwrap_or(0);
        let stay_mask = stay_mask.at(pop_latency);
        let pop_intervals: Vec<_> = (pop_intervals.into_iter())
            .map(|interval| interval.at(pop_latency))
            .collect();
        let pop_done = pop_valid.at(pop_latency).untimed().named("pop_done");
        let pop_out_packet = pop_packet.at(pop_latency).untimed().named("pop_out_packet");
        let pop_out_empty = stack_empty.at(pop_latency).untimed();
        let pop_out_mask = stay_mask.untimed().named("pop_out_mask");
        let pop_out_touched = pop_touched.at(pop_latency).untimed();
        let pop_out_level = level_below.at(pop_latency).untimed();
        let pop_out_address = entry.get(popped_entry, "address").at(pop_latency).untimed();
        let pop_out_leaf = entry.get(popped_entry, "leaf").at(pop_latency).untimed();
        let pop_out_context = context
            .pack(&[
                ("level", pop_out_level),
                ("touched", pop_out_touched),
                (
                    "inside",
                    entry.get(popped_entry, "inside").at(pop_latency).untimed(),
                ),
            ])
            .named("pop_out_context");
        let pop_goes = (pop_done & !pop_out_empty & pop_out_mask.any()).named("pop_goes_on");
        let pop_dropped = (pop_done & !pop_out_empty & !pop_out_mask.any()).named("pop_dropped");
        Ok(Pop {
            latency: pop_latency,
            queues: [done_queue, retry_queue, nowhere_queue],
            valid: pop_valid,
            popping: pop,
            popping_packet: pop_packet,
            popping_level: pop_level,
            popping_empty: stack_empty,
            entry: read_entry,
            stays,
            done: pop_done,
            packet: pop_out_packet,
            empty: pop_out_empty,
            mask: pop_out_mask,
            touched: pop_out_touched,
            address: pop_out_address,
            leaf: pop_out_leaf,
            context: pop_out_context,
            level: pop_out_level,
            intervals: pop_intervals,
            goes: pop_goes,
            dropped: pop_dropped,
            retry_push,
            retry_item,
        })
    }

    /// Packets that start, in the scene or in an object, and where packets go after starts and pops.
    fn enter(&self, pop: &Pop<'b>, rays_of: &Rays<'b>, intervals: &Intervals<'b>) -> Entered<'b> {
        let (m, plan) = (self.m, self.plan);
        let Shapes {
            context, interval, ..
        } = &self.shapes;
        let Inputs {
            setup_valid,
            setup_packet,
            setup_ray,
            setup_first,
            setup_last,
            setup_enters,
            setup_near,
            setup_far,
            setup_object,
            object_address,
            object_leaf,
            object_context,
            root,
            ..
        } = self.inputs;
        let rays = plan.rays();
        let a = plan.address();
        m.comment(
            "The start, in the scene or in an object: rays arrive one by one, the last one starts the packet at the root. No pop ends while \
             one arrives. Rays of the world and of an object's space may alternate.",
        );
        let bit_in: Vec<_> = (0..rays)
            .rev()
            .map(|i| setup_enters & setup_ray.equals(u128::from(i)))
            .collect();
        let bit_in = m.concat(&bit_in).named("bit_in");
        let gathered = m.reg("gathered", rays);
        let gathered_object = m.reg("gathered_object", rays);
        let so_far = setup_first.mux(
            m.zero(rays),
            setup_object.mux(gathered_object.q, gathered.q),
        );
        let start_mask = (so_far | bit_in).named("start_mask");
        gathered.next_when(setup_valid & !setup_object, start_mask);
        gathered_object.next_when(setup_valid & setup_object, start_mask);
        let start = (setup_valid & setup_last).named("start");
        let start_goes = (start & start_mask.any()).named("start_goes");
        let start_nowhere = (start & !start_mask.any()).named("start_nowhere");
        let link_word = Record::link_word();
        let root_address = root.field(link_word.field("link").lsb, a);
        let root_leaf = root.field(link_word.field("left_leaf").lsb, 1);
        let started_context = setup_object.mux(object_context, m.zero(context.width()));
        let started_address = setup_object.mux(object_address, root_address);
        let started_leaf = setup_object.mux(object_leaf, root_leaf);
        pop.retry_push
            .drive(pop.dropped | (start_nowhere & setup_object));
        pop.retry_item.drive(setup_valid.mux(
            self.shapes.pop(setup_packet, object_context),
            self.shapes.pop(pop.packet, pop.context),
        ));

        // What is kept here is read after the node's answer, which takes a clock more than this register.
        let registered = plan.config.clock_mhz >= REGISTER_ENTERED_FROM;
        let later = |name: &str, signal: Signal<'b>, reset: Option<u128>| {
            if !registered {
                return signal;
            }
            let (name, width) = (format!("{name}_s1"), signal.width());
            let register = match reset {
                Some(value) => m.reg_reset(name, width, value),
                None => m.reg(name, width),
            };
            register.next(signal);
            register.q
        };
        let packet = setup_valid.mux(setup_packet, pop.packet);
        intervals
            .popped_packet
            .drive(later("popped_packet", packet, None));
        let goes = start_goes | pop.goes;
        let mask_write = later("popped_mask_write", goes, None);
        intervals.popped_mask_write.drive(mask_write);
        let mask = setup_valid.mux(start_mask, pop.mask);
        intervals
            .popped_mask
            .drive(later("popped_mask", mask, None));
        let setup_interval = interval.pack(&[("near", setup_near), ("far", setup_far)]);
        for i in 0..rays as usize {
            let write = rays_of.setup_of[i] | pop.goes;
            let kept = setup_valid.mux(setup_interval, pop.intervals[i].untimed());
            intervals.popped_write[i].drive(later(&format!("popped_write{i}"), write, None));
            intervals.popped_interval[i].drive(later(&format!("popped_interval{i}"), kept, None));
        }
        let entered = goes.named("entered");
        let leaf = setup_valid.mux(started_leaf, pop.leaf);
        let address = setup_valid.mux(started_address, pop.address);
        let context = setup_valid.mux(started_context, pop.context);
        Entered {
            decided: entered,
            registered,
            valid: later("entered", entered, Some(0)),
            leaf: later("entered_leaf", leaf, None),
            address: later("entered_address", address, None),
            context: later("entered_context", context, None),
            packet: match registered {
                true => packet,
                false => intervals.popped_packet.get(),
            },
            none_enters: start_nowhere & !setup_object,
        }
    }

    /// Nodes to fetch.
    fn fetch(
        &self,
        step: &Step<'b>,
        entered: &Entered<'b>,
        intervals: &Intervals<'b>,
        kept: &Requests<'b>,
    ) -> Result<Served<'b>, HdlError> {
        let (m, plan) = (self.m, self.plan);
        let Shapes { context, item, .. } = &self.shapes;
        let Inputs { node_ready, .. } = self.inputs;
        let packets = plan.packets();
        m.comment("Nodes to fetch: after steps, and after pops and starts.");
        let take_step_item = m.wire("take_step_item", 1);
        let take_pop_item = m.wire("take_pop_item", 1);
        let step_queue = fifo::place(
            plan,
            "step_queue",
            packets,
            intervals.stepped_write.get() & !step.leaf,
            item.pack(&[
                ("packet", step.packet),
                ("address", step.address),
                ("context", step.context),
            ]),
            take_step_item.get(),
        )?;
        let (step_any, step_front) = (step_queue.valid, step_queue.front);
        let entered_queue = fifo::place(
            plan,
            "entered_queue",
            packets,
            entered.valid & !entered.leaf,
            item.pack(&[
                ("packet", intervals.popped_packet.get()),
                ("address", entered.address),
                ("context", entered.context),
            ]),
            take_pop_item.get(),
        )?;
        let (entered_any, entered_front) = (entered_queue.valid, entered_queue.front);
        let node_wanted = (step_any | entered_any).named("node_wanted");
        let held = held_choice(m, "request", node_wanted, node_ready, step_any);
        let from_step = held.choice;
        kept.item.drive(from_step.mux(step_front, entered_front));
        kept.popped.drive(!from_step);
        kept.fire.drive(node_wanted & node_ready);
        take_step_item.drive(node_ready & from_step);
        take_pop_item.drive(node_ready & !from_step & entered_any);
        m.group("Node memory: requests");
        m.output("node_request_valid", node_wanted);
        m.output("node_request_address", item.get(kept.item.get(), "address"));
        let request_context = item.get(kept.item.get(), "context");
        m.output(
            "node_request_tag",
            context
                .get(request_context, "inside")
                .concat(item.get(kept.item.get(), "packet")),
        );
        Ok(Served {
            preferred: step_queue,
            other: entered_queue,
            valid: node_wanted,
            ready: node_ready,
            held,
        })
    }

    /// Leaves to hand over.
    fn hand_over(
        &self,
        step: &Step<'b>,
        entered: &Entered<'b>,
        intervals: &Intervals<'b>,
    ) -> Result<Served<'b>, HdlError> {
        let (m, plan) = (self.m, self.plan);
        let Shapes { leaf_item, .. } = &self.shapes;
        let Inputs { leaf_ready, .. } = self.inputs;
        let packets = plan.packets();
        m.comment("Leaves to hand over: after steps, and after pops and starts.");
        let take_step_leaf = m.wire("take_step_leaf", 1);
        let take_pop_leaf = m.wire("take_pop_leaf", 1);
        let step_leaf_queue = fifo::place_block(
            plan,
            "step_leaf_queue",
            packets,
            intervals.stepped_write.get() & step.leaf,
            leaf_item.pack(&[
                ("packet", step.packet),
                ("address", step.address),
                ("context", step.context),
                ("mask", step.mask),
            ]),
            take_step_leaf.get(),
        )?;
        let (step_leaf_any, step_leaf_front) = (step_leaf_queue.valid, step_leaf_queue.front);
        let entered_leaf_queue = fifo::place_block(
            plan,
            "entered_leaf_queue",
            packets,
            entered.valid & entered.leaf,
            leaf_item.pack(&[
                ("packet", intervals.popped_packet.get()),
                ("address", entered.address),
                ("context", entered.context),
                ("mask", intervals.popped_mask.get()),
            ]),
            take_pop_leaf.get(),
        )?;
        let (entered_leaf_any, entered_leaf_front) =
            (entered_leaf_queue.valid, entered_leaf_queue.front);
        let leaf_wanted = (step_leaf_any | entered_leaf_any).named("leaf_wanted");
        let held = held_choice(m, "leaf", leaf_wanted, leaf_ready, step_leaf_any);
        let leaf_from_step = held.choice;
        let leaf_front = leaf_from_step
            .mux(step_leaf_front, entered_leaf_front)
            .named("leaf_front");
        take_step_leaf.drive(leaf_ready & leaf_from_step);
        take_pop_leaf.drive(leaf_ready & !leaf_from_step & entered_leaf_any);
        m.group("Leaves to the geometry unit");
        m.output("leaf_valid", leaf_wanted);
        for name in ["packet", "address", "context", "mask"] {
            m.output(format!("leaf_{name}"), leaf_item.get(leaf_front, name));
        }
        Ok(Served {
            preferred: step_leaf_queue,
            other: entered_leaf_queue,
            valid: leaf_wanted,
            ready: leaf_ready,
            held,
        })
    }
}

/// The traversal processing unit of a machine.
pub fn module(plan: &Plan) -> Result<Tpu, HdlError> {
    let slice = slice(plan)?;
    let shapes = Shapes::new(plan);
    let m = Builder::new(
        "tpu",
        "the traversal processing unit: takes packets through a B-KD tree, a packet step a clock.",
    );
    let unit = Unit {
        inputs: Inputs::new(&m, plan, &shapes),
        m: &m,
        plan,
        shapes,
    };
    let rays = unit.rays();
    let kept = unit.requests();
    let intervals = unit.intervals();
    let sliced = unit.slices(&slice, &rays, &kept, &intervals);
    let step = unit.decide(&sliced, &kept, &intervals);
    let stack = unit.push(&step);
    let pop = unit.pop(&step, &stack)?;
    let entered = unit.enter(&pop, &rays, &intervals);
    let nodes = unit.fetch(&step, &entered, &intervals, &kept)?;
    let leaves = unit.hand_over(&step, &entered, &intervals)?;

    m.group("A finished packet, and which of its rays have hit something");
    let finished = entered.none_enters | (pop.done & pop.empty);
    m.output("finished_valid", finished);
    m.output("finished_packet", entered.packet);
    m.output(
        "finished_touched",
        unit.inputs
            .setup_valid
            .mux(m.zero(plan.rays()), pop.touched),
    );

    m.group("Counters' events, and marks");
    m.output("step_taken", step.valid);
    m.output("stack_high_water", stack.high_water.q);
    m.output("stack_overflow", stack.overflow.q);

    m.group("The packet step just decided, for whoever watches");
    for (name, signal) in &step.watch {
        m.output(name, *signal);
    }
    let pop_latency = pop.latency;
    properties::describe(&Watched {
        plan,
        inputs: &unit.inputs,
        sliced: &sliced,
        step: &step,
        stepped: intervals.stepped_write.get(),
        stack: &stack,
        pop: &pop,
        entered: &entered,
        nodes: &nodes,
        leaves: &leaves,
        finished,
    });
    Ok(Tpu {
        module: m.finish()?,
        pop_latency,
        slice,
    })
}

/// Which of two queues is served: the preferred one where it has something, but what was offered and not
/// taken is offered again, so that a waiting request never changes.
fn held_choice<'b>(
    m: &'b Builder,
    name: &str,
    wanted: Signal<'b>,
    ready: Signal<'b>,
    preferred: Signal<'b>,
) -> Held<'b> {
    let waits = m.reg_reset(format!("{name}_waits"), 1, 0);
    let waiting_choice = m.reg(format!("{name}_waiting_choice"), 1);
    let choice = waits
        .q
        .mux(waiting_choice.q, preferred)
        .named(format!("{name}_choice"));
    waits.next(wanted & !ready);
    waiting_choice.next(choice);
    Held {
        choice,
        waits: waits.q,
        waiting_choice: waiting_choice.q,
    }
}
