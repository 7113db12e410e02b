//! What packets go to: nodes are requested of memory, leaves handed over to the geometry unit. Of each there are two queues, after steps,
//! and after pops and starts.

use super::enter::Entered;
use super::kept::{Item, PoppedWrites, Request};
use super::step::Step;
use crate::hdl::{self, Builder, Flow, HdlError, ReadOutputs, Signal, Specs, Wire, Wires};
use crate::hw::fifo::{self, Placed};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Leaf};

/// Two queues of which one is served.
pub(super) struct Served<'b> {
    pub preferred: Placed<'b>,
    pub other: Placed<'b>,
    pub valid: Signal<'b>,
    pub ready: Signal<'b>,
    pub held: Held<'b>,
}

/// A choice that stays while what it offers is not taken.
pub(super) struct Held<'b> {
    /// Whether it is the preferred one.
    pub choice: Signal<'b>,
    /// Whether something was offered and not taken, and from which it was.
    pub waits: Signal<'b>,
    pub waiting_choice: Signal<'b>,
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

/// Requests nodes, and says what is to be kept of a packet while its request is out.
pub(super) fn nodes<'b>(
    m: &'b Builder,
    plan: &Plan,
    (step, stepped): (&Step<'b>, Signal<'b>),
    (entered, popped): (&Entered<'b>, &PoppedWrites<'b>),
    ready: Signal<'b>,
    kept: Request<Wire<'b>>,
) -> Result<(ReadOutputs<Signal<'b>>, Served<'b>), HdlError> {
    let item = Item::of(plan);
    m.comment("Nodes to fetch: after steps, and after pops and starts.");
    let take_stepped = m.wire("take_step_item", 1);
    let take_entered = m.wire("take_pop_item", 1);
    let preferred = fifo::place(
        plan,
        "step_queue",
        plan.packets(),
        stepped & !step.first.leaf,
        item.pack(Item {
            packet: step.packet,
            address: step.first.address,
            context: step.context,
        }),
        take_stepped.get(),
    )?;
    let other = fifo::place(
        plan,
        "entered_queue",
        plan.packets(),
        entered.valid & !entered.leaf,
        item.pack(Item {
            packet: popped.packet.packet.get(),
            address: entered.address,
            context: entered.context,
        }),
        take_entered.get(),
    )?;
    let wanted = (preferred.valid | other.valid).named("node_wanted");
    let held = held_choice(m, "request", wanted, ready, preferred.valid);
    let choice = held.choice;
    take_stepped.drive(ready & choice);
    take_entered.drive(ready & !choice & other.valid);
    kept.drive(Request {
        fire: wanted & ready,
        item: choice.mux(preferred.front, other.front),
        popped: !choice,
    });
    let requested = item.unpack(kept.item.get());
    let inside = Context::of(plan).unpack(requested.context).inside;
    let request = hdl::Request {
        address: requested.address,
        tag: inside.concat(requested.packet),
    };
    let outputs = ReadOutputs {
        request: Flow::new(wanted, request),
    };
    let served = Served {
        preferred,
        other,
        valid: wanted,
        ready,
        held,
    };
    Ok((outputs, served))
}

/// Hands leaves over.
pub(super) fn leaves<'b>(
    m: &'b Builder,
    plan: &Plan,
    (step, stepped): (&Step<'b>, Signal<'b>),
    (entered, popped): (&Entered<'b>, &PoppedWrites<'b>),
    ready: Signal<'b>,
) -> Result<(Flow<Leaf<Signal<'b>>, Signal<'b>>, Served<'b>), HdlError> {
    let leaf = Leaf::of(plan);
    m.comment("Leaves to hand over: after steps, and after pops and starts.");
    let take_stepped = m.wire("take_step_leaf", 1);
    let take_entered = m.wire("take_pop_leaf", 1);
    let preferred = fifo::place_block(
        plan,
        "step_leaf_queue",
        plan.packets(),
        stepped & step.first.leaf,
        leaf.pack(Leaf {
            packet: step.packet,
            address: step.first.address,
            context: step.context,
            mask: step.first.mask,
        }),
        take_stepped.get(),
    )?;
    let other = fifo::place_block(
        plan,
        "entered_leaf_queue",
        plan.packets(),
        entered.valid & entered.leaf,
        leaf.pack(Leaf {
            packet: popped.packet.packet.get(),
            address: entered.address,
            context: entered.context,
            mask: popped.packet.mask.get(),
        }),
        take_entered.get(),
    )?;
    let wanted = (preferred.valid | other.valid).named("leaf_wanted");
    let held = held_choice(m, "leaf", wanted, ready, preferred.valid);
    let choice = held.choice;
    let front = choice.mux(preferred.front, other.front);
    let front = leaf.unpack(front.named("leaf_front"));
    take_stepped.drive(ready & choice);
    take_entered.drive(ready & !choice & other.valid);
    let served = Served {
        preferred,
        other,
        valid: wanted,
        ready,
        held,
    };
    Ok((Flow::new(wanted, front), served))
}
