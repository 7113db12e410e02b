//! The traversal unit (TPU): one traversal step per cycle.
//!
//! A packet in flight is in exactly one place: in a queue, in memory as a node request, in the step pipeline, in the pop
//! pipeline, or in the geometry unit. So a queue with one entry per packet can never overflow, every pipeline has a fixed
//! latency and never stalls, and the state of a packet travels with it as its *context*.
//!
//! ```text
//! start ──────────────────────────────► pop ──► fetch (popped) ──┐
//!                                        ▲ ▲                     ▼
//!  retry, step's pops, geometry's done ──┘ └── stack        node request
//!                                               ▲                │
//!  step ──► fetch (stepped) ────────────────────┼─► node request ▼
//!   ▲                                           │          node response
//!   └─ 4 plane distances/ray, decision, push  ──┴────────────────┘
//! ```

mod clip;
mod enter;
mod kept;
mod pop;
mod properties;
mod ray;
mod serve;
mod slice;
mod stack;
mod start;
mod step;

use super::plan::Plan;
use super::ray::{InContext, Interval, Leaf, Limit, Place, Start};
use crate::bkd::layout::Record;
use crate::hdl::{Builder, Flow, HdlError, Module, ReadInputs, ReadOutputs, Specs, Wires};
use crate::{bundle, interface};
use enter::PoppedWires;
use kept::{Request, SteppedWrite};
use pop::Retry;
use properties::Watched;
use std::sync::Arc;

/// The traversal unit, and the latency of its pop pipeline.
pub struct Tpu {
    pub module: Arc<Module>,
    /// Cycles from the start of a pop to its result. Any other write to the memories that a pop writes must be announced this early.
    pub pop_latency: u32,
    /// The slice of one ray, for its tests.
    pub slice: Arc<Module>,
}

bundle! {
    /// A ray from ray setup, in the form that traversal uses.
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
    /// A traversal step: its node, the rays that enter each child, and their intervals in it.
    pub struct StepTrace(plan: &Plan) {
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
    /// A finished packet and its hit mask.
    pub struct Finished(plan: &Plan) {
        packet: plan.packet_bits(),
        touched: plan.rays(),
    }
}

interface! {
    pub (plan: &Plan) {
        in "Ray from ray setup; the last one starts its packet. setup_soon is high earlier, by the latency of a pop" {
            setup_soon: 1,
            setup: Flow<SetUp>(plan),
        }
        in "High for a ray in object space; with the packet's last ray, its start there and its context" {
            setup_object: 1,
            object: {Start}(plan),
        }
        in "Link word of the scene's root, constant while packets are in flight" {
            root: Record::link_word().width,
        }
        in "" {
            node: {ReadInputs}(
                "Node memory", "any order, always accepted",
                plan.level_packet_bits(), Record::node(plan.format).width
            ),
        }
        in "Leaves to the geometry unit" { leaf_ready: 1 }
        in "New upper bound for near, from a closer hit" {
            limit: Flow<Limit>(plan),
        }
        in "Leaf complete: all of its tests are merged" {
            done: Flow<InContext>(plan),
        }
        out "" {
            node: {ReadOutputs}("Node memory", plan.address(), plan.level_packet_bits()),
        }
        out "Leaves to the geometry unit" {
            leaf: Flow<Leaf>(plan),
        }
        out "Finished packet and its hit mask" {
            finished: Flow<Finished>(plan),
        }
        out "Events for the counters, and stack figures" {
            step_taken: 1,
            stack_high_water: plan.level_bits(),
            stack_overflow: 1,
        }
        out "Trace: last traversal step" {
            trace_step if (plan.trace): {StepTrace}(plan),
        }
    }
}

/// Describes the traversal unit of a machine: its parts, in the order in which a packet passes them. Wires, declared first, carry
/// the signals from later parts to earlier ones.
pub fn module(plan: &Plan) -> Result<Tpu, HdlError> {
    let slice = slice::module(plan)?;
    let (ray, clip) = (ray::module(plan, &slice)?, clip::module(plan)?);
    let builder = Builder::new(
        "tpu",
        "the traversal unit: traverses a B-KD tree with packets of rays, one traversal step per cycle.",
    );
    let m = &builder;
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(m);
    let request = Request::of(plan).wires(m, "request");
    let stepped = SteppedWrite::of(plan).wires(m, "stepped");
    let popped = PoppedWires::new(m, plan);
    let retry = Retry::of(plan).wires(m, "retry");

    let start = m.part(
        "packet_start",
        "collects the rays of a packet that starts, in world space or in object space.",
        || start::start(m, plan, inputs.setup, inputs.setup_object),
    );
    let kept = m.part(
        "packet_store",
        "stores the state of packets whose node is in flight.",
        || kept::keep(m, plan, request.get(), stepped.get(), popped.packet.get()),
    );
    let (sliced, step) = m.part(
        "packet_step",
        "the traversal step: the children of a node that each ray enters, then the packet's next node.",
        || {
            let sliced = step::slices(m, plan, &ray, &inputs, &start, &popped, &kept);
            let step = step::decide(m, plan, &sliced, stepped);
            (sliced, step)
        },
    );
    let popping = m.part(
        "pop_choice",
        "selects the packet that pops its stack.",
        || pop::choose(m, plan, inputs.setup_soon, inputs.done, retry.get(), &step),
    )?;
    let stack = m.part("packet_stack", "the stacks of all packets.", || {
        stack::stack(m, plan, &step, &popping)
    });
    let pop = m.part(
        "packet_pop",
        "clips the popped entry to the closest hits; a ray with an empty interval leaves it.",
        || pop::clip(m, plan, &clip, inputs.limit, &popping, &stack),
    );
    let entered = m.part(
        "packet_enter",
        "sends packets, after a start or a pop, to a node, to a leaf, to another pop, or out.",
        || enter::enter(m, plan, &inputs, &start, &pop, &popped, retry),
    );
    let after_step = (&step, stepped.write.get());
    let (node, nodes) = m.part("node_fetch", "requests nodes from memory.", || {
        let ready = inputs.node.request_ready;
        serve::nodes(m, plan, after_step, &entered, ready, request)
    })?;
    let (leaf, leaves) = m.part(
        "leaf_dispatch",
        "dispatches leaves to the geometry unit.",
        || serve::leaves(m, plan, after_step, &entered, inputs.leaf_ready),
    )?;
    let finished = Flow {
        valid: entered.none_enters | (pop.done & pop.empty),
        payload: Finished {
            packet: entered.packet,
            touched: (inputs.setup.valid).mux(m.zero(plan.rays()), pop.touched),
        },
    };
    let outputs = Outputs {
        node,
        leaf,
        finished,
        step_taken: step.valid,
        stack_high_water: stack.high_water.q,
        stack_overflow: stack.overflow.q,
        trace_step: step.trace,
    };
    ports.outputs.outputs(m, outputs);
    properties::describe(&Watched {
        plan,
        inputs: &inputs,
        sliced: &sliced,
        step: &step,
        stepped: stepped.write.get(),
        stack: &stack,
        popping: &popping,
        pop: &pop,
        entered: &entered,
        nodes: &nodes,
        leaves: &leaves,
        finished: finished.valid,
    });
    let pop_latency = pop.latency;
    Ok(Tpu {
        module: builder.finish()?,
        pop_latency,
        slice,
    })
}
