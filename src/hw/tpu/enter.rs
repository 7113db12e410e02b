//! The destination of packets after starts and pops.

use super::Inputs;
use super::kept::PoppedWrite;
use super::pop::{Popped, Retry};
use super::ray;
use super::start::Start;
use crate::bkd::layout::fields::Link;
use crate::hdl::{Builder, Bundle, Signal, Specs, Wire, Wires};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, InContext};

/// The data that pops and starts write for the next step; [`enter`] drives the wires.
pub(super) struct PoppedWires<'b> {
    pub packet: PoppedWrite<Wire<'b>>,
    /// By slot in the packet.
    pub rays: Vec<ray::Write<Wire<'b>>>,
}

impl<'b> PoppedWires<'b> {
    pub fn new(m: &'b Builder, plan: &Plan) -> Self {
        let of_ray = |i| ray::Write::of(plan).wires(m, &format!("popped{i}"));
        PoppedWires {
            packet: PoppedWrite::of(plan).wires(m, "popped"),
            rays: (0..plan.rays()).map(of_ray).collect(),
        }
    }
}

/// A packet after a pop or a start.
pub(super) struct Entered<'b> {
    /// Whether it continues to a node or a leaf; with [`Timing::entered_packet`](crate::hw::timing::Timing), one cycle before the other fields.
    pub decided: Signal<'b>,
    pub registered: bool,
    pub valid: Signal<'b>,
    pub leaf: Signal<'b>,
    pub address: Signal<'b>,
    pub context: Signal<'b>,
    /// The packet number, and the mask.
    pub queued: Signal<'b>,
    pub mask: Signal<'b>,
    /// The packet that starts or whose pop ends; with [`Timing::entered_packet`](crate::hw::timing::Timing), one cycle before the other fields.
    pub packet: Signal<'b>,
    /// Whether it starts in world space and no ray enters the scene; in the same cycle.
    pub none_enters: Signal<'b>,
}

/// Determines the destination of a packet after a start or a pop, and writes the data for its next step, in the cycle of its last ray or
/// of the end of the pop. No pop ends in a cycle in which a ray arrives, so one multiplexer is sufficient. A packet pops again if none
/// of its rays enters an object, or if its entry is dropped.
pub(super) fn enter<'b>(
    m: &'b Builder,
    plan: &Plan,
    inputs: &Inputs<Signal<'b>>,
    start: &Start<'b>,
    pop: &Popped<'b>,
    popped: &PoppedWires<'b>,
    retry: Retry<Wire<'b>>,
) -> Entered<'b> {
    let &Inputs {
        setup,
        setup_object,
        object,
        root,
        ..
    } = inputs;
    let (arrives, setup) = (setup.valid, setup.payload);
    m.comment("The destination of a packet after a start or a pop.");
    let in_object = start.nowhere & setup_object;
    retry.push.drive(pop.dropped | in_object);
    let again = |packet, context| InContext::of(plan).pack(InContext { packet, context });
    let started = again(setup.place.packet, object.context);
    retry
        .item
        .drive(arrives.mux(started, again(pop.packet, pop.context)));

    // The data written here is read after the response with the node, which is later than this register by at least one cycle.
    let registered = plan.timing.entered_packet;
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
    let goes = (start.goes | pop.goes).named("entered");
    let packet = arrives.mux(setup.place.packet, pop.packet);
    popped.packet.drive(PoppedWrite {
        packet: later("popped_packet", packet, None),
        mask_write: later("popped_mask_write", goes, None),
        mask: later("popped_mask", arrives.mux(start.mask, pop.mask), None),
    });
    for (i, ray) in popped.rays.iter().enumerate() {
        let interval = arrives.choose(setup.interval, pop.intervals[i]);
        let write = start.of_ray[i] | pop.goes;
        ray.drive(ray::Write {
            write: later(&format!("popped{i}_write"), write, None),
            interval: interval
                .map(|name, number| later(&format!("popped{i}_{name}"), number, None)),
        });
    }
    let root = Link::of().unpack(root);
    let entering = |name, object, root, popped| {
        let started = setup_object.mux(object, root);
        arrives.mux(started, popped).hinted(name)
    };
    let leaf = entering("entering_leaf", object.leaf, root.left_leaf, pop.leaf);
    let address = root.link.low(plan.address()).hinted("root_address");
    let address = entering("entering_address", object.address, address, pop.address);
    let nothing = m.zero(Context::of(plan).width());
    let context = entering("entering_context", object.context, nothing, pop.context);
    Entered {
        decided: goes,
        registered,
        valid: later("entered", goes, Some(0)),
        leaf: later("entered_leaf", leaf, None),
        address: later("entered_address", address, None),
        context: later("entered_context", context, None),
        queued: popped.packet.packet.get(),
        mask: popped.packet.mask.get(),
        packet: match registered {
            true => packet,
            false => popped.packet.packet.get(),
        },
        none_enters: (start.nowhere & !setup_object).hinted("none_enters"),
    }
}
