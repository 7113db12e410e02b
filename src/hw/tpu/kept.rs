//! The state of packets while their node is in flight, for the next step.

use crate::bundle;
use crate::hdl::{Builder, Memory, Signal, Specs, Style};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Interval};

bundle! {
    /// A child, as the destination of a packet.
    pub(super) struct Item(plan: &Plan) {
        packet: plan.packet_bits(),
        address: plan.address(),
        context: Context::of(plan).width(),
    }
}

bundle! {
    /// An issued node request.
    pub(super) struct Request(plan: &Plan) {
        fire: 1,
        item: Item::of(plan).width(),
        /// Whether the packet comes from a pop or a start instead of a step.
        popped: 1,
    }
}

bundle! {
    /// The state of a packet while its node is in flight.
    pub(super) struct Requested(plan: &Plan) {
        address: plan.address(),
        context: Context::of(plan).width(),
        popped: 1,
    }
}

bundle! {
    /// The state of a packet from a step, for its next node.
    pub(super) struct Stepped(plan: &Plan) {
        intervals: plan.rays() * Interval::of(plan).width(),
        mask: plan.rays(),
    }
}

bundle! {
    /// The write of a step.
    pub(super) struct SteppedWrite(plan: &Plan) {
        write: 1,
        packet: plan.packet_bits(),
        kept: ..{Stepped}(plan),
    }
}

bundle! {
    /// The write of a pop or a start.
    pub(super) struct PoppedWrite(plan: &Plan) {
        packet: plan.packet_bits(),
        mask_write: 1,
        mask: plan.rays(),
    }
}

/// The memories from which a step reads.
pub(super) struct Kept<'b> {
    pub requests: Memory<'b>,
    /// Intervals and masks of packets in their next nodes, written by steps, and masks written by pops and starts.
    pub stepped: Memory<'b>,
    pub popped_masks: Memory<'b>,
}

/// Makes the memories. Their write ports are the given wires.
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
