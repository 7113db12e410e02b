//! Where packets go after starts and pops.

use super::Inputs;
use super::kept::PoppedWrite;
use super::pop::{Popped, Retry};
use super::ray;
use super::start::Start;
use crate::bkd::layout::fields::Link;
use crate::hdl::{Builder, Bundle, Signal, Specs, Wire, Wires};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, InContext};

/// What pops and starts write for the step; [`enter`] drives the wires.
pub(super) struct PoppedWires<'b> {
    pub packet: PoppedWrite<Wire<'b>>,
    /// By place in the packet.
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

/// A packet that goes somewhere after a pop or a start.
pub(super) struct Entered<'b> {
    /// Whether it goes somewhere; with [`Timing::entered_packet`](crate::hw::timing::Timing), a clock before the rest.
    pub decided: Signal<'b>,
    pub registered: bool,
    pub valid: Signal<'b>,
    pub leaf: Signal<'b>,
    pub address: Signal<'b>,
    pub context: Signal<'b>,
    /// Which packet that is, and its rays.
    pub queued: Signal<'b>,
    pub mask: Signal<'b>,
    /// The packet that starts or whose pop ends; with [`Timing::entered_packet`](crate::hw::timing::Timing), a clock before the rest.
    pub packet: Signal<'b>,
    /// Whether it starts nowhere, being of the world; in the same clock.
    pub none_enters: Signal<'b>,
}

/// Says where a packet goes that starts or has popped, and writes what its step there will read, in the clock of its last ray or of the
/// pop's end. No pop ends where a ray arrives, so a choice by that is all that it takes. A packet that goes nowhere in an object pops
/// again, as one does whose entry is dropped.
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

    // What is kept here is read after the node's answer, which takes a clock more than this register.
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
