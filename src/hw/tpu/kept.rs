//! What is kept of packets for their steps: their rays, and while a node is fetched what belongs to the packet there.

use super::SetUp;
use super::start::Start;
use crate::bundle;
use crate::hdl::{Builder, Flow, Memory, Signal, Specs, Style, Wire, Wires};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Interval};

bundle! {
    /// What a packet step needs of a ray.
    pub(super) struct RayWord(plan: &Plan) {
        origin: [plan.number(); xyz],
        reciprocal: [plan.number(); xyz],
        signs: 3,
    }
}

bundle! {
    /// A child to go to.
    pub(super) struct Item(plan: &Plan) {
        packet: plan.packet_bits(),
        address: plan.address(),
        context: Context::of(plan).width(),
    }
}

bundle! {
    /// A node request as it is made.
    pub(super) struct Request(plan: &Plan) {
        fire: 1,
        item: Item::of(plan).width(),
        /// Whether the packet comes from a pop or a start, not from a step.
        popped: 1,
    }
}

bundle! {
    /// What is kept of a packet while its node is fetched.
    pub(super) struct Requested(plan: &Plan) {
        address: plan.address(),
        context: Context::of(plan).width(),
        popped: 1,
    }
}

bundle! {
    /// What a step leaves of a packet for its next node.
    pub(super) struct Stepped(plan: &Plan) {
        intervals: plan.rays() * Interval::of(plan).width(),
        mask: plan.rays(),
    }
}

bundle! {
    /// What a step writes.
    pub(super) struct SteppedWrite(plan: &Plan) {
        write: 1,
        packet: plan.packet_bits(),
        kept: ..{Stepped}(plan),
    }
}

bundle! {
    /// What a pop or a start writes of a packet.
    pub(super) struct PoppedWrite(plan: &Plan) {
        packet: plan.packet_bits(),
        mask_write: 1,
        mask: plan.rays(),
    }
}

bundle! {
    /// What a pop or a start writes of a ray.
    pub(super) struct PoppedRay(plan: &Plan) {
        write: 1,
        interval: Interval::of(plan).width(),
    }
}

/// What pops and starts write, driven behind them.
pub(super) struct PoppedWrites<'b> {
    pub packet: PoppedWrite<Wire<'b>>,
    /// By place in the packet.
    pub rays: Vec<PoppedRay<Wire<'b>>>,
}

impl<'b> PoppedWrites<'b> {
    pub fn new(m: &'b Builder, plan: &Plan) -> Self {
        let of_ray = |i| PoppedRay::of(plan).wires(m, &format!("popped{i}"));
        PoppedWrites {
            packet: PoppedWrite::of(plan).wires(m, "popped"),
            rays: (0..plan.rays()).map(of_ray).collect(),
        }
    }
}

/// The memories from which a step reads.
pub(super) struct Kept<'b> {
    /// By place in the packet, words of [`RayWord`].
    pub rays: Vec<Memory<'b>>,
    pub requests: Memory<'b>,
    /// Intervals and masks of packets in the nodes that they go to, as steps leave them and as pops and starts do.
    pub stepped: Memory<'b>,
    pub popped_masks: Memory<'b>,
    /// By place in the packet.
    pub popped: Vec<Memory<'b>>,
}

/// Makes the memories, and writes them: rays as they are set up, the rest where the wires say so.
pub(super) fn keep<'b>(
    m: &'b Builder,
    plan: &Plan,
    (setup, setup_object): (Flow<SetUp<Signal<'b>>, Signal<'b>>, Signal<'b>),
    start: &Start<'b>,
    request: Request<Signal<'b>>,
    stepped: SteppedWrite<Signal<'b>>,
    popped: &PoppedWrites<'b>,
) -> Kept<'b> {
    let (interval, packets) = (Interval::of(plan).width(), plan.packets());
    m.comment(
        "Rays: origin, reciprocal and signs, a memory for each place in the packet, written when set up: in the world, and behind that \
         in the object's space, so that the world's are still there when the packet leaves an object.",
    );
    let SetUp {
        place,
        signs,
        origin,
        reciprocal,
        ..
    } = setup.payload;
    let ray_word = RayWord::of(plan);
    let setup_word = ray_word.pack(RayWord {
        origin,
        reciprocal,
        signs,
    });
    let setup_word = setup_word.named("setup_word");
    let level_packet = setup_object.concat(place.packet);
    let level_packet = level_packet.hinted("setup_level_packet");
    let rays = start.of_ray.iter().enumerate().map(|(i, write)| {
        let (name, words) = (format!("ray{i}_memory"), plan.level_packets());
        let memory = m.memory(name, words, ray_word.width(), Style::Block);
        memory.write(*write, level_packet, setup_word);
        memory
    });
    let rays = rays.collect();

    m.comment(
        "Where a requested node lies, and its packet's context, kept while the request is out.",
    );
    let of_request = Requested::of(plan);
    let width = of_request.width();
    let requests = m.memory("request_memory", packets, width, Style::Distributed);
    let Item {
        packet,
        address,
        context,
    } = Item::of(plan).unpack(request.item);
    let word = of_request.pack(Requested {
        address,
        context,
        popped: request.popped,
    });
    requests.write(request.fire, packet, word);

    m.comment("Intervals and mask of the packet in the node it goes to: as a step left them, and as a pop or the setup did.");
    let of_step = Stepped::of(plan);
    let stepped_memory = m.memory("stepped_memory", packets, of_step.width(), Style::Block);
    stepped_memory.write(stepped.write, stepped.packet, of_step.pack(stepped.kept));
    let PoppedWrite {
        packet,
        mask_write,
        mask,
    } = popped.packet.get();
    let width = plan.rays();
    let popped_masks = m.memory("popped_mask_memory", packets, width, Style::Distributed);
    popped_masks.write(mask_write, packet, mask);
    let popped = popped.rays.iter().enumerate().map(|(i, ray)| {
        let memory = m.memory(format!("popped{i}_memory"), packets, interval, Style::Block);
        memory.write(ray.write.get(), packet, ray.interval.get());
        memory
    });
    Kept {
        rays,
        requests,
        stepped: stepped_memory,
        popped_masks,
        popped: popped.collect(),
    }
}
