//! Node requests to memory, and dispatch of leaves to the geometry unit. Each has two queues: one after steps, and one after pops
//! and starts.

use super::enter::Entered;
use super::kept::{Item, Request};
use super::step::Step;
use crate::hdl::fifo::Placed;
use crate::hdl::{self, Builder, Flow, HdlError, ReadOutputs, Signal, Specs, Wire, Wires};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Leaf};

/// Two queues, one of which is served.
pub(super) struct Served<'b> {
    pub preferred: Placed<'b>,
    pub other: Placed<'b>,
    pub valid: Signal<'b>,
    pub ready: Signal<'b>,
    pub held: Held<'b>,
}

/// A choice between two queues that is stable until its offer is accepted.
pub(super) struct Held<'b> {
    /// Whether it is the preferred one.
    pub choice: Signal<'b>,
    /// Whether an offer was not accepted, and the queue that it came from.
    pub waits: Signal<'b>,
    pub waiting_choice: Signal<'b>,
}

/// Packets for the queues: valid bit and word, after a step, and after a pop or a start.
struct Coming<'b> {
    after_step: (Signal<'b>, Signal<'b>),
    after_pop: (Signal<'b>, Signal<'b>),
}

/// A function that instantiates a queue, such as [`Plan::queue`].
type PlaceQueue<'b> =
    fn(&Plan, &str, u32, Signal<'b>, Signal<'b>, Signal<'b>) -> Result<Placed<'b>, HdlError>;

/// Serves one of two queues, with priority for the queue after steps. An offer that is not accepted is repeated, so it is stable
/// while it waits. The first result is the offered word.
fn serve<'b>(
    plan: &Plan,
    name: &str,
    place: PlaceQueue<'b>,
    coming: Coming<'b>,
    ready: Signal<'b>,
) -> Result<(Signal<'b>, Served<'b>), HdlError> {
    let m = ready.module();
    let [take_step, take_pop] =
        ["step", "pop"].map(|after| m.wire(format!("take_{after}_{name}"), 1));
    let queue = |after, (push, word), take: Wire<'b>| {
        let name = format!("{after}_{name}_queue");
        place(plan, &name, plan.packets(), push, word, take.get())
    };
    let preferred = queue("step", coming.after_step, take_step)?;
    let other = queue("entered", coming.after_pop, take_pop)?;
    let wanted = (preferred.valid | other.valid).named(format!("{name}_wanted"));
    let waits = m.reg_reset(format!("{name}_waits"), 1, 0);
    let waiting_choice = m.reg(format!("{name}_waiting_choice"), 1);
    let choice = waits.q.mux(waiting_choice.q, preferred.valid);
    let choice = choice.named(format!("{name}_choice"));
    waits.next(wanted & !ready);
    waiting_choice.next(choice);
    take_step.drive(ready & choice);
    take_pop.drive(ready & !choice & other.valid);
    let front = choice.mux(preferred.front, other.front);
    let served = Served {
        preferred,
        other,
        valid: wanted,
        ready,
        held: Held {
            choice,
            waits: waits.q,
            waiting_choice: waiting_choice.q,
        },
    };
    Ok((front.named(format!("{name}_front")), served))
}

/// Requests nodes, and returns the state of a packet to be stored while its request is in flight.
pub(super) fn nodes<'b>(
    m: &'b Builder,
    plan: &Plan,
    (step, stepped): (&Step<'b>, Signal<'b>),
    entered: &Entered<'b>,
    ready: Signal<'b>,
    kept: Request<Wire<'b>>,
) -> Result<(ReadOutputs<Signal<'b>>, Served<'b>), HdlError> {
    let item = Item::of(plan);
    m.comment("Node requests: after steps, and after pops and starts.");
    let after_step = item.pack(Item {
        packet: step.packet,
        address: step.first.address,
        context: step.context,
    });
    let after_pop = item.pack(Item {
        packet: entered.queued,
        address: entered.address,
        context: entered.context,
    });
    let coming = Coming {
        after_step: (stepped & !step.first.leaf, after_step),
        after_pop: (entered.valid & !entered.leaf, after_pop),
    };
    let (front, served) = serve(plan, "node", Plan::queue, coming, ready)?;
    kept.drive(Request {
        fire: served.valid & ready,
        item: front,
        popped: !served.held.choice,
    });
    let requested = item.unpack(kept.get().item);
    let inside = Context::of(plan).unpack(requested.context).inside;
    let request = hdl::Request {
        address: requested.address,
        tag: inside.concat(requested.packet),
    };
    let request = Flow::new(served.valid, request);
    Ok((ReadOutputs { request }, served))
}

/// Dispatches leaves.
pub(super) fn leaves<'b>(
    m: &'b Builder,
    plan: &Plan,
    (step, stepped): (&Step<'b>, Signal<'b>),
    entered: &Entered<'b>,
    ready: Signal<'b>,
) -> Result<(Flow<Leaf<Signal<'b>>, Signal<'b>>, Served<'b>), HdlError> {
    let leaf = Leaf::of(plan);
    m.comment("Leaves to dispatch: after steps, and after pops and starts.");
    let after_step = leaf.pack(Leaf {
        packet: step.packet,
        address: step.first.address,
        context: step.context,
        mask: step.first.mask,
    });
    let after_pop = leaf.pack(Leaf {
        packet: entered.queued,
        address: entered.address,
        context: entered.context,
        mask: entered.mask,
    });
    let coming = Coming {
        after_step: (stepped & step.first.leaf, after_step),
        after_pop: (entered.valid & entered.leaf, after_pop),
    };
    let (front, served) = serve(plan, "leaf", Plan::block_queue, coming, ready)?;
    Ok((Flow::new(served.valid, leaf.unpack(front)), served))
}
