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
use super::distance;
use super::fifo::{self, Placed};
use super::fp::{Knowing, Known, Operand, less_equal};
use super::plan::Plan;
use super::ray::{Context, InContext, Interval, Leaf, Limit, Place, Start};
use crate::bkd::layout::Record;
use crate::bkd::layout::fields::{Link, Node, Planes};
use crate::hdl::{
    Builder, Flow, HdlError, Memory, Module, ReadInputs, ReadOutputs, Reg, Request, Signal,
    Signals, Specs, Style, Wire, Wires,
};
use crate::{bundle, interface};
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

bundle! {
    /// A ray that has been set up, as traversal needs it.
    pub struct SetUp(plan: &Plan) {
        place: ..{Place}(plan),
        enters: 1,
        interval: ..{Interval}(plan),
        signs: 3,
        origin: [plan.number(); xyz],
        reciprocal: [plan.number(); xyz],
    }
}

bundle! {
    /// What a packet step needs of a ray.
    pub struct RayWord(plan: &Plan) {
        origin: [plan.number(); xyz],
        reciprocal: [plan.number(); xyz],
        signs: 3,
    }
}

bundle! {
    /// A packet step: its node, which rays go to each child, and their intervals in it.
    pub struct StepWatch(plan: &Plan) {
        packet: plan.packet_bits(),
        node: plan.address(),
        left: plan.rays(),
        right: plan.rays(),
        left_first: 1,
        left_intervals: plan.rays() * Interval::of(plan).width(),
        right_intervals: plan.rays() * Interval::of(plan).width(),
    }
}

bundle! {
    /// What a step leaves of a packet for its next node.
    struct Stepped(plan: &Plan) {
        intervals: plan.rays() * Interval::of(plan).width(),
        mask: plan.rays(),
    }
}

bundle! {
    /// A child to go to.
    struct Item(plan: &Plan) {
        packet: plan.packet_bits(),
        address: plan.address(),
        context: Context::of(plan).width(),
    }
}

bundle! {
    /// An entry of the stack.
    struct Entry(plan: &Plan) {
        address: plan.address(),
        leaf: 1,
        inside: 1,
        mask: plan.rays(),
        intervals: plan.rays() * Interval::of(plan).width(),
    }
}

bundle! {
    /// What is kept of a packet while its node is fetched.
    struct Requested(plan: &Plan) {
        address: plan.address(),
        context: Context::of(plan).width(),
        popped: 1,
    }
}

bundle! {
    /// A finished packet, and which of its rays have hit something.
    pub struct Finished(plan: &Plan) {
        packet: plan.packet_bits(),
        touched: plan.rays(),
    }
}

interface! {
    pub (plan: &Plan) {
        in "A ray that has been set up; a packet's last one that comes starts the packet. soon says so as many clocks before as a pop takes" {
            setup_soon: 1,
            setup: Flow<SetUp>(plan),
        }
        in "The ray is in an object's space: where and with which context its packet starts there, beside its last ray" {
            setup_object: 1,
            object: {Start}(plan),
        }
        in "The root link word, constant while packets are under way" {
            root: Record::link_word().width,
        }
        in "" {
            node: {ReadInputs}(
                "Node memory", "in any order, always taken",
                plan.level_packet_bits(), Record::node(plan.format).width
            ),
        }
        in "Leaves to the geometry unit" { leaf_ready: 1 }
        in "A closer hit of a ray: what its near must not exceed from now on" {
            limit: Flow<Limit>(plan),
        }
        in "A leaf all of whose tests are merged" {
            done: Flow<InContext>(plan),
        }
        out "" {
            node: {ReadOutputs}("Node memory", plan.address(), plan.level_packet_bits()),
        }
        out "Leaves to the geometry unit" {
            leaf: Flow<Leaf>(plan),
        }
        out "A finished packet, and which of its rays have hit something" {
            finished: Flow<Finished>(plan),
        }
        out "Counters' events, and marks" {
            step_taken: 1,
            stack_high_water: plan.level_bits(),
            stack_overflow: 1,
        }
        out "The packet step just decided, for whoever watches" {
            watch_step: {StepWatch}(plan),
        }
    }
}

/// The slice's ports.
mod slice_ports {
    use super::*;

    bundle! {
        /// The ray on the axis of one child.
        pub struct Side(plan: &Plan) {
            sign: 1,
            origin: plan.number(),
            reciprocal: plan.number(),
        }
    }

    interface! {
        pub (plan: &Plan) {
            in "The node's intervals" {
                planes: ..{Planes}(plan.format),
            }
            in "The ray on the left and the right child's axis" {
                left: {Side}(plan),
                right: {Side}(plan),
            }
            in "The ray's interval in the node, needed when the distances are there" {
                ray: {Interval}(plan),
                ray_active: 1,
            }
            out "The ray's interval in the children, and where it goes" {
                out_left: {Interval}(plan),
                out_right: {Interval}(plan),
                to_left: 1,
                to_right: 1,
                left_before_right: 1,
            }
        }
    }
}

/// One ray's part of a packet step: its interval in both children, and where it goes.
fn slice(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let f = plan.format;
    let m = Builder::new(
        "tpu_slice",
        "one ray's part of a packet step: four plane distances, its interval in each child, where it goes.",
    );
    let p = m.pipeline();
    let ports = slice_ports::ports(plan);
    let inputs = &ports.inputs;
    let planes = inputs.planes.inputs_at(&p, 0);
    let sides = [&inputs.left, &inputs.right].map(|side| side.inputs_at(&p, 0));
    let distance_latency = plan.near_distance.stage("distance")?;
    // A valid ray's 0 <= tmin <= near, and neither near nor far is ever a NaN.
    let Interval { near, far } = inputs.ray.inputs_at(&p, distance_latency);
    let active = inputs.ray_active.input_at(&p, distance_latency);

    let mut intervals = vec![];
    for (name, side, lo, hi) in [
        ("left", sides[0], planes.left_lo, planes.left_hi),
        ("right", sides[1], planes.right_lo, planes.right_hi),
    ] {
        m.comment(format!("The {name} child: near and far planes by the direction's sign, then near and far clipped."));
        let slice_ports::Side {
            sign,
            origin,
            reciprocal,
        } = side;
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
    let compare = |name: &str, a, b| plan.decide(less_equal(f, name, a, b));
    let goes_left = (active & compare("left_is_met", left_near, left_far)).named("goes_left");
    let goes_right = (active & compare("right_is_met", right_near, right_far)).named("goes_right");
    let left_first = (goes_left & goes_right & compare("left_is_nearer", left_near, right_near))
        .named("both_left_first");
    let [left, right] = [(left_near, left_far), (right_near, right_far)].map(|(near, far)| {
        let [near, far] = [near, far].map(Operand::signal);
        Interval { near, far }
    });
    let outputs = slice_ports::Outputs {
        out_left: left,
        out_right: right,
        to_left: goes_left,
        to_right: goes_right,
        left_before_right: left_first,
    };
    let end = left_first.stage() + 1;
    ports.outputs.outputs(&m, outputs.at(end));
    m.finish()
}

/// The unit under construction: its parts are made in the order of its methods, each from what the earlier ones return.
struct Unit<'b> {
    m: &'b Builder,
    plan: &'b Plan,
    inputs: Inputs<Signal<'b>>,
}

/// Rays by packet and level.
struct Rays<'b> {
    /// By place in the packet.
    memories: Vec<Memory<'b>>,
    /// Whether the ray that has been set up has that place.
    setup_of: Vec<Signal<'b>>,
}

/// What is kept of a packet while its node is fetched.
struct Requests<'b> {
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
    left: Stepped<Wire<'b>>,
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
    request: Requested<Signal<'b>>,
    slices: Vec<slice_ports::Outputs<Signal<'b>>>,
    /// The stage of the slices' results.
    decided: u32,
}

/// A packet step that has been decided: where the packet goes first, and what it pushes.
struct Step<'b> {
    valid: Signal<'b>,
    packet: Signal<'b>,
    /// Whether some ray goes left, and right; whether both; and the levels before and after. In the pipeline.
    goes_left: Signal<'b>,
    goes_right: Signal<'b>,
    goes_both: Signal<'b>,
    level_before: Signal<'b>,
    next_level: Signal<'b>,
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
    watch: StepWatch<Signal<'b>>,
}

/// The stack of all packets.
struct Stack<'b> {
    memory: Banks<'b>,
    /// Bits of a packet's number in its address.
    packet_bits: u32,
    full: Signal<'b>,
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
    /// Its level after the pop; in the pipeline.
    level_below: Signal<'b>,
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
            setup,
            setup_object,
            ..
        } = self.inputs;
        let SetUp {
            place,
            signs,
            origin,
            reciprocal,
            ..
        } = setup.payload;
        m.comment(
            "Rays: origin, reciprocal and signs, a memory for each place in the packet, written when set up: in the world, and behind that \
             in the object's space, so that the world's are still there when the packet leaves an object.",
        );
        let setup_word = RayWord::of(plan).pack(RayWord {
            origin,
            reciprocal,
            signs,
        });
        let setup_word = setup_word.named("setup_word");
        let setup_of: Vec<_> = (0..rays)
            .map(|i| {
                let is_ray = place
                    .ray
                    .equals(u128::from(i))
                    .hinted(format!("setup_ray_is_{i}"));
                (setup.valid & is_ray).named(format!("setup_of_ray{i}"))
            })
            .collect();
        let ray_memory: Vec<_> = (0..rays)
            .map(|i| {
                let memory = m.memory(
                    format!("ray{i}_memory"),
                    plan.level_packets(),
                    RayWord::of(plan).width(),
                    Style::Block,
                );
                let address = setup_object
                    .concat(place.packet)
                    .hinted("setup_level_packet");
                memory.write(setup_of[i as usize], address, setup_word);
                memory
            })
            .collect();
        Rays {
            memories: ray_memory,
            setup_of,
        }
    }

    fn requests(&self) -> Requests<'b> {
        let (m, plan) = (self.m, self.plan);
        let (item, requested) = (Item::of(plan), Requested::of(plan));
        let packets = plan.packets();
        m.comment(
            "Where a requested node lies, and its packet's context, kept while the request is out.",
        );
        let request_fire = m.wire("request_fire", 1);
        let request_item = m.wire("request_item", item.width());
        let request_popped = m.wire("request_popped", 1);
        let requests = m.memory(
            "request_memory",
            packets,
            requested.width(),
            Style::Distributed,
        );
        let Item {
            packet,
            address,
            context,
        } = item.unpack(request_item.get());
        let popped = request_popped.get();
        let word = requested.pack(Requested {
            address,
            context,
            popped,
        });
        requests.write(request_fire.get(), packet, word);
        Requests {
            memory: requests,
            fire: request_fire,
            item: request_item,
            popped: request_popped,
        }
    }

    fn intervals(&self) -> Intervals<'b> {
        let (m, plan) = (self.m, self.plan);
        let interval = Interval::of(plan);
        let rays = plan.rays();
        let packets = plan.packets();
        m.comment("Intervals and mask of the packet in the node it goes to: as a step left them, and as a pop or the setup did.");
        let stepped_write = m.wire("stepped_write", 1);
        let stepped_packet = m.wire("stepped_packet", plan.packet_bits());
        let stepped_word = Stepped::of(plan);
        let left = stepped_word.wires(m, "stepped");
        let stepped = m.memory(
            "stepped_memory",
            packets,
            stepped_word.width(),
            Style::Block,
        );
        stepped.write(
            stepped_write.get(),
            stepped_packet.get(),
            stepped_word.pack(left.get()),
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
            left,
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
        let interval = Interval::of(plan);
        let Flow {
            valid,
            payload: response,
        } = self.inputs.node.response;
        m.comment("The packet step. A node's answer enters with the packet's rays.");
        let p = m.pipeline();
        let valid = p.enter(valid).cleared_by_reset();
        let level_packet = p.enter(response.tag);
        let packet = level_packet.low(plan.packet_bits()).named("packet");
        let node = p.enter(response.data);
        let of_planes = Planes::of(plan.format);
        let planes = of_planes.unpack(node.low(of_planes.width())).named("");
        let of_node = Node::of(plan.format);
        let [left_axis, right_axis] = [&of_node.link.left_axis, &of_node.link.right_axis];
        let left = of_node.get(node, left_axis).named(&left_axis.name);
        let axes = match plan.config.axes_per_node {
            // One axis bounds both children: the right one's would say the same.
            1 => [left; 2],
            _ => [left, of_node.get(node, right_axis).named(&right_axis.name)],
        };
        let ports = slice_ports::ports(plan);
        let slice_near = ports.inputs.ray.near.stage(m, slice);
        let mut slices = vec![];
        let mut decided = 0;
        let ray_words: Vec<_> = rays_of
            .memories
            .iter()
            .map(|memory| plan.read(*memory, level_packet))
            .collect();
        let entry_stage = packet.stage() + plan.read_latency() + 1;
        let read_at = entry_stage + slice_near - plan.read_latency();
        let late_packet = packet.at(read_at);
        let request = kept
            .memory
            .read_now(packet.at(read_at + plan.read_latency() - 1))
            .register();
        let request = Requested::of(plan).unpack(request);
        let from_pop = request.popped;
        let stepped = Stepped::of(plan).unpack(plan.read(intervals.stepped, late_packet));
        let popped_mask_word = intervals
            .popped_masks
            .read_now(packet.at(read_at + plan.read_latency() - 1))
            .register();
        let mask_in = from_pop
            .mux(popped_mask_word, stepped.mask)
            .named("mask_in");
        for (i, word) in ray_words.into_iter().enumerate() {
            let popped_word = plan.read(intervals.popped[i], late_packet);
            let current = from_pop
                .mux(
                    popped_word,
                    (stepped.intervals).part(
                        format!("ray{i}"),
                        i as u32 * interval.width(),
                        interval.width(),
                    ),
                )
                .named(format!("ray{i}_interval"));
            let of_ray = RayWord::of(plan).unpack(word);
            let [left, right] = [("left", axes[0]), ("right", axes[1])].map(|(name, axis)| {
                let along = |what: &str, of: &[Signal<'b>; 3]| {
                    let along = m.select(axis, of).named(format!("ray{i}_{name}_{what}"));
                    along.register()
                };
                slice_ports::Side {
                    sign: along("sign", &[0, 1, 2].map(|axis| of_ray.signs.bit(axis))),
                    origin: along("origin", &of_ray.origin),
                    reciprocal: along("reciprocal", &of_ray.reciprocal),
                }
            });
            let inputs = slice_ports::Inputs {
                planes,
                left,
                right,
                ray: interval.unpack(current),
                ray_active: mask_in.bit(i as u32),
            };
            let placed = ports.place(format!("slice{i}"), m, slice, inputs);
            decided = placed.out_left.near.stage();
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
    fn decide(&self, sliced: &Sliced<'b>, intervals: &Intervals<'b>) -> Step<'b> {
        let (m, plan) = (self.m, self.plan);
        let (context, interval, entry) = (Context::of(plan), Interval::of(plan), Entry::of(plan));
        let a = plan.address();
        let Sliced {
            valid,
            packet,
            node,
            request,
            ref slices,
            decided,
        } = *sliced;
        m.comment("The packet's decision.");
        let gather = |of: fn(&slice_ports::Outputs<Signal<'b>>) -> Signal<'b>| {
            let bits: Vec<_> = slices.iter().rev().map(of).collect();
            m.concat(&bits)
        };
        let to_left = gather(|slice| slice.to_left).named("to_left");
        let to_right = gather(|slice| slice.to_right).named("to_right");
        let goes_left = to_left.any().named("goes_left");
        let goes_right = to_right.any().named("goes_right");
        let some_left_first = gather(|slice| slice.left_before_right)
            .hinted("left_before_right")
            .any();
        let left_first = (goes_left & (some_left_first | !goes_right)).named("left_first");
        let intervals_of = |of: fn(&slice_ports::Outputs<Signal<'b>>) -> Interval<Signal<'b>>| {
            let parts = slices.iter().rev().map(|slice| interval.pack(of(slice)));
            m.concat(&parts.collect::<Vec<_>>())
        };
        let left_intervals = intervals_of(|slice| slice.out_left).named("left_intervals");
        let right_intervals = intervals_of(|slice| slice.out_right).named("right_intervals");

        let own = request.address.at(decided).named("own_address");
        let context_in = request.context.at(decided);
        let of_node = Node::of(plan.format);
        let link = of_node.get(node, &of_node.link.link).low(a).named("link");
        let left_leaf = of_node
            .get(node, &of_node.link.left_leaf)
            .named("left_leaf");
        let right_leaf = of_node
            .get(node, &of_node.link.right_leaf)
            .named("right_leaf");
        let link_after = (link + m.lit(1u8, a)).named("link_after");
        let right_inner = left_leaf
            .mux(link, link_after)
            .hinted("right_inner_address");
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
        let Context {
            level,
            touched,
            inside,
        } = context.unpack(context_in);
        let both = (goes_left & goes_right).named("goes_both");
        let pushes = (both & valid.at(decided))
            .named("pushes")
            .cleared_by_reset();
        let next_level = (level + both.extend(plan.level_bits())).named("next_level");
        let next_context = context.pack(Context {
            level: next_level,
            touched,
            inside,
        });

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
        intervals.left.drive(Stepped {
            intervals: step_intervals,
            mask: step_mask,
        });
        m.comment("The stack.");
        let push = pushes.register().untimed();
        let level_before = level.named("level_before");
        let push_level = level_before.at(decided + 1).untimed();
        let push_word = entry
            .pack(Entry {
                address: second_address.named("second_address"),
                leaf: second_leaf.named("second_leaf"),
                inside,
                mask: second_mask.named("second_mask"),
                intervals: second_intervals.named("second_intervals"),
            })
            .register()
            .untimed();
        let late = |signal: Signal<'b>| signal.at(decided + 1).untimed();
        let watch = StepWatch {
            packet: step_packet,
            node: late(own),
            left: late(to_left),
            right: late(to_right),
            left_first: late(left_first),
            left_intervals: late(left_intervals),
            right_intervals: late(right_intervals),
        };
        Step {
            valid: step_valid,
            packet: step_packet,
            goes_left,
            goes_right,
            goes_both: both,
            level_before,
            next_level,
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
        let (context, entry) = (Context::of(plan), Entry::of(plan));
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
        let push_place = (step.packet.low(fit)).concat(step.push_level.low(plan.stack_bits()));
        let push_place = push_place.hinted("push_place");
        let bank_writes = stack.write(stack_write, push_place, step.push_word);
        let overflow = m.reg_reset("overflow", 1, 0);
        overflow.next(overflow.q | (step.push & full));
        let high_water = m.reg_reset("high_water", plan.level_bits(), 0);
        let level_after = context.unpack(step.context).level;
        high_water.next_when(step.push & high_water.q.lt(level_after), level_after);
        Stack {
            memory: stack,
            packet_bits: fit,
            full,
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
        let (context, popping, interval, entry) = (
            Context::of(plan),
            InContext::of(plan),
            Interval::of(plan),
            Entry::of(plan),
        );
        let Inputs {
            setup_soon,
            limit,
            done,
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
        let retry_item = m.wire("retry_item", popping.width());
        let done_queue = fifo::place(
            plan,
            "done_queue",
            packets,
            done.valid,
            popping.pack(done.payload),
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
            popping.pack(InContext {
                packet: step.packet,
                context: step.context,
            }),
            take_stepped.get(),
        )?;
        let (nowhere_any, nowhere_front) = (nowhere_queue.valid, nowhere_queue.front);
        let may_pop = (!setup_soon).named("may_pop");
        take_retry.drive(may_pop & retry_any);
        let no_retry = (may_pop & !retry_any).hinted("may_pop_and_no_retry");
        take_done.drive(no_retry & done_any);
        take_stepped.drive(no_retry & !done_any & nowhere_any);

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
        let pop_word = plan.choose(chosen).named("pop");
        let pop = popping.unpack(pop_word);
        let pop_packet = pop.packet;
        let Context {
            level: pop_level,
            touched: pop_touched,
            ..
        } = context.unpack(pop.context);
        let stack_empty = pop_level.is_zero().named("stack_empty");
        let level_below = (pop_level - m.lit(1u8, plan.level_bits())).named("level_below");
        let pop_place =
            (pop_packet.low(stack.packet_bits)).concat(level_below.low(plan.stack_bits()));
        let read_entry = stack.memory.read(plan, pop_place.hinted("pop_place"));
        let popped_entry = read_entry.word;
        let before_entry = popped_entry.stage() - 1;
        let popped_entry = entry.unpack(popped_entry);
        let mut stays = vec![];
        let mut pop_intervals = vec![];
        for i in 0..rays {
            let limits = m.memory(format!("limit{i}_memory"), packets, w, Style::Distributed);
            limits.write(
                limit.valid & limit.payload.ray.equals(u128::from(i)),
                limit.payload.packet,
                limit.payload.value,
            );
            let limit = limits.read_now(pop_packet.at(before_entry)).register();
            let intervals = popped_entry.intervals;
            let word = intervals.part(format!("ray{i}"), i * interval.width(), interval.width());
            let Interval { near, far } = interval.unpack(word);
            let touched = pop_touched.part(format!("ray{i}"), i, 1);
            // Any hit's limit is minus infinity; a closest hit's is a distance.
            let limit = limit.known(Known::Number);
            let name = format!("ray{i}_within");
            let within = less_equal(f, &name, near.known(Known::Positive), limit).named(name);
            let was_in = popped_entry.mask.part(format!("ray{i}"), i, 1);
            let untouched = (!touched).hinted(format!("ray{i}_untouched"));
            let stay = (was_in & (within | untouched)).named(format!("ray{i}_stays"));
            let nearer = plan.min(
                format!("ray{i}_far_or_limit"),
                far.known(Known::Number),
                limit,
            );
            let clipped = touched.mux(nearer, far).named(format!("ray{i}_far"));
            stays.push(plan.settle(stay));
            let clipped = interval.pack(Interval { near, far: clipped });
            pop_intervals.push(plan.settle(clipped.hinted(format!("ray{i}_popped_interval"))));
        }
        stays.reverse();
        let stays = m.concat(&stays).named("stay_mask");
        let stay_mask = stays.register();
        let pop_intervals: Vec<_> = pop_intervals.into_iter().map(|s| s.register()).collect();
        // What clips a far may take a clock more than what a ray stays by.
        let pop_latency = (pop_intervals.iter().chain([&stay_mask]))
            .map(Signal::stage)
            .max()
            .expect("some intervals");
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
        let pop_out_address = popped_entry.address.at(pop_latency).untimed();
        let pop_out_leaf = popped_entry.leaf.at(pop_latency).untimed();
        let pop_out_context = context
            .pack(Context {
                level: pop_out_level,
                touched: pop_out_touched,
                inside: popped_entry.inside.at(pop_latency).untimed(),
            })
            .named("pop_out_context");
        let pop_entry = (pop_done & !pop_out_empty).hinted("pop_has_entry");
        let any_stays = pop_out_mask.any().hinted("pop_any_stays");
        let pop_goes = (pop_entry & any_stays).named("pop_goes_on");
        let pop_dropped = (pop_entry & !any_stays).named("pop_dropped");
        Ok(Pop {
            latency: pop_latency,
            queues: [done_queue, retry_queue, nowhere_queue],
            valid: pop_valid,
            popping: pop_word,
            popping_packet: pop_packet,
            popping_level: pop_level,
            popping_empty: stack_empty,
            level_below,
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
        let (context, interval, popping) =
            (Context::of(plan), Interval::of(plan), InContext::of(plan));
        let Inputs {
            setup,
            setup_object,
            object,
            root,
            ..
        } = self.inputs;
        let Flow {
            valid: setup_valid,
            payload: setup,
        } = setup;
        let rays = plan.rays();
        let a = plan.address();
        m.comment(
            "The start, in the scene or in an object: rays arrive one by one, the last one starts the packet at the root. No pop ends while \
             one arrives. Rays of the world and of an object's space may alternate.",
        );
        let bit_in: Vec<_> = (0..rays)
            .rev()
            .map(|i| setup.enters & setup.place.ray.equals(u128::from(i)))
            .collect();
        let bit_in = m.concat(&bit_in).named("bit_in");
        let gathered = m.reg("gathered", rays);
        let gathered_object = m.reg("gathered_object", rays);
        let so_far = setup.place.first.mux(
            m.zero(rays),
            setup_object.mux(gathered_object.q, gathered.q),
        );
        let so_far = so_far.hinted("gathered_so_far");
        let start_mask = (so_far | bit_in).named("start_mask");
        gathered.next_when(setup_valid & !setup_object, start_mask);
        gathered_object.next_when(setup_valid & setup_object, start_mask);
        let start = (setup_valid & setup.place.last).named("start");
        let any_enters = start_mask.any().hinted("any_enters");
        let start_goes = (start & any_enters).named("start_goes");
        let start_nowhere = (start & !any_enters).named("start_nowhere");
        let root = Link::of().unpack(root);
        let started_context = setup_object.mux(object.context, m.zero(context.width()));
        let started_address = setup_object.mux(object.address, root.link.low(a));
        let started_leaf = setup_object.mux(object.leaf, root.left_leaf);
        pop.retry_push
            .drive(pop.dropped | (start_nowhere & setup_object));
        pop.retry_item.drive(setup_valid.mux(
            popping.pack(InContext {
                packet: setup.place.packet,
                context: object.context,
            }),
            popping.pack(InContext {
                packet: pop.packet,
                context: pop.context,
            }),
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
        let packet = setup_valid.mux(setup.place.packet, pop.packet);
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
        let setup_interval = interval.pack(setup.interval).hinted("setup_interval");
        for i in 0..rays as usize {
            let write = rays_of.setup_of[i] | pop.goes;
            let kept = setup_valid.mux(setup_interval, pop.intervals[i].untimed());
            intervals.popped_write[i].drive(later(&format!("popped_write{i}"), write, None));
            intervals.popped_interval[i].drive(later(&format!("popped_interval{i}"), kept, None));
        }
        let entered = goes.named("entered");
        let entering = |name, started, popped| setup_valid.mux(started, popped).hinted(name);
        let leaf = entering("entering_leaf", started_leaf, pop.leaf);
        let address = entering("entering_address", started_address, pop.address);
        let context = entering("entering_context", started_context, pop.context);
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
    ) -> Result<(ReadOutputs<Signal<'b>>, Served<'b>), HdlError> {
        let (m, plan) = (self.m, self.plan);
        let (context, item) = (Context::of(plan), Item::of(plan));
        let node_ready = self.inputs.node.request_ready;
        let packets = plan.packets();
        m.comment("Nodes to fetch: after steps, and after pops and starts.");
        let take_step_item = m.wire("take_step_item", 1);
        let take_pop_item = m.wire("take_pop_item", 1);
        let step_queue = fifo::place(
            plan,
            "step_queue",
            packets,
            intervals.stepped_write.get() & !step.leaf,
            item.pack(Item {
                packet: step.packet,
                address: step.address,
                context: step.context,
            }),
            take_step_item.get(),
        )?;
        let (step_any, step_front) = (step_queue.valid, step_queue.front);
        let entered_queue = fifo::place(
            plan,
            "entered_queue",
            packets,
            entered.valid & !entered.leaf,
            item.pack(Item {
                packet: intervals.popped_packet.get(),
                address: entered.address,
                context: entered.context,
            }),
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
        let requested = item.unpack(kept.item.get());
        let inside = context.unpack(requested.context).inside;
        let request = Request {
            address: requested.address,
            tag: inside.concat(requested.packet),
        };
        let outputs = ReadOutputs {
            request: Flow::new(node_wanted, request),
        };
        let served = Served {
            preferred: step_queue,
            other: entered_queue,
            valid: node_wanted,
            ready: node_ready,
            held,
        };
        Ok((outputs, served))
    }

    /// Leaves to hand over.
    fn hand_over(
        &self,
        step: &Step<'b>,
        entered: &Entered<'b>,
        intervals: &Intervals<'b>,
    ) -> Result<(Flow<Leaf<Signal<'b>>, Signal<'b>>, Served<'b>), HdlError> {
        let (m, plan) = (self.m, self.plan);
        let leaf = Leaf::of(plan);
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
            leaf.pack(Leaf {
                packet: step.packet,
                address: step.address,
                context: step.context,
                mask: step.mask,
            }),
            take_step_leaf.get(),
        )?;
        let (step_leaf_any, step_leaf_front) = (step_leaf_queue.valid, step_leaf_queue.front);
        let entered_leaf_queue = fifo::place_block(
            plan,
            "entered_leaf_queue",
            packets,
            entered.valid & entered.leaf,
            leaf.pack(Leaf {
                packet: intervals.popped_packet.get(),
                address: entered.address,
                context: entered.context,
                mask: intervals.popped_mask.get(),
            }),
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
        let served = Served {
            preferred: step_leaf_queue,
            other: entered_leaf_queue,
            valid: leaf_wanted,
            ready: leaf_ready,
            held,
        };
        Ok((Flow::new(leaf_wanted, leaf.unpack(leaf_front)), served))
    }
}

/// The traversal processing unit of a machine.
pub fn module(plan: &Plan) -> Result<Tpu, HdlError> {
    let slice = slice(plan)?;
    let m = Builder::new(
        "tpu",
        "the traversal processing unit: takes packets through a B-KD tree, a packet step a clock.",
    );
    let ports = ports(plan);
    let unit = Unit {
        inputs: ports.inputs.inputs(&m),
        m: &m,
        plan,
    };
    let rays = unit.rays();
    let kept = unit.requests();
    let intervals = unit.intervals();
    let sliced = unit.slices(&slice, &rays, &kept, &intervals);
    let step = unit.decide(&sliced, &intervals);
    let stack = unit.push(&step);
    let pop = unit.pop(&step, &stack)?;
    let entered = unit.enter(&pop, &rays, &intervals);
    let (node, nodes) = unit.fetch(&step, &entered, &intervals, &kept)?;
    let (leaf, leaves) = unit.hand_over(&step, &entered, &intervals)?;
    let finished = Flow {
        valid: entered.none_enters | (pop.done & pop.empty),
        payload: Finished {
            packet: entered.packet,
            touched: (unit.inputs.setup.valid).mux(m.zero(plan.rays()), pop.touched),
        },
    };
    let outputs = Outputs {
        node,
        leaf,
        finished,
        step_taken: step.valid,
        stack_high_water: stack.high_water.q,
        stack_overflow: stack.overflow.q,
        watch_step: step.watch,
    };
    ports.outputs.outputs(&m, outputs);
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
        finished: finished.valid,
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
