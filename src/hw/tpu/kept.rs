//! What is kept of packets while a node is fetched, for the step there.

use crate::bundle;
use crate::hdl::{Builder, Memory, Signal, Specs, Style};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Interval};

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

/// The memories from which a step reads.
pub(super) struct Kept<'b> {
    pub requests: Memory<'b>,
    /// Intervals and masks of packets in the nodes that they go to, as steps leave them, and masks as pops and starts do.
    pub stepped: Memory<'b>,
    pub popped_masks: Memory<'b>,
}

/// Makes the memories, which the wires write.
pub(super) fn keep<'b>(
    m: &'b Builder,
    plan: &Plan,
    request: Request<Signal<'b>>,
    stepped: SteppedWrite<Signal<'b>>,
    popped: PoppedWrite<Signal<'b>>,
) -> Kept<'b> {
    let packets = plan.packets();
    m.comment(
        "The address of a requested node and its packet's context, stored while the request is in flight.",
    );
    let of_request = Requested::of(plan);
    let width = of_request.width();
    let requests = m.memory("request_memory", packets, width, Style::Distributed);
    let item = Item::of(plan).unpack(request.item);
    let word = of_request.pack(Requested {
        address: item.address,
        context: item.context,
        popped: request.popped,
    });
    requests.write(request.fire, item.packet, word);

    m.comment("Intervals and mask of the packet in its next node, written by a step; its mask, written by a pop or a start.");
    let of_step = Stepped::of(plan);
    let stepped_memory = m.memory("stepped_memory", packets, of_step.width(), Style::Block);
    stepped_memory.write(stepped.write, stepped.packet, of_step.pack(stepped.kept));
    let width = plan.rays();
    let popped_masks = m.memory("popped_mask_memory", packets, width, Style::Distributed);
    popped_masks.write(popped.mask_write, popped.packet, popped.mask);
    Kept {
        requests,
        stepped: stepped_memory,
        popped_masks,
    }
}
