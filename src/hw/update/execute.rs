//! Execute: the current instruction goes unless what it needs is missing. Only here is memory waited for, and then all later instructions
//! wait too.

use super::Instruction;
use crate::hdl::{Builder, Flow, HdlError, Signal, Signals, Spec, Specs};
use crate::hw::fifo::{self, Placed};
use crate::hw::plan::Plan;
use crate::hw::prefetch::Occupancy;

/// What execution gives.
pub(super) struct Execute<'b> {
    /// Whether one more instruction may be decoded.
    pub queue_room: Signal<'b>,
    /// The instruction that goes, or waits.
    pub current: Instruction<Signal<'b>>,
    pub goes: Signal<'b>,
    /// It goes, and is a load; a node; one of the two kinds that merge.
    pub load_goes: Signal<'b>,
    pub node_goes: Signal<'b>,
    pub merge_goes: Signal<'b>,
    /// It is the end, and stays until the object's box is taken.
    pub end_waits: Signal<'b>,
    /// Why it waits.
    pub missing_vertex: Signal<'b>,
    pub missing_room: Signal<'b>,
    // For the properties.
    pub queue: Placed<'b>,
    pub in_flight: Occupancy<'b>,
    pub front: Instruction<Signal<'b>>,
    pub take: Signal<'b>,
    pub valid: Signal<'b>,
    pub load_waits: Signal<'b>,
}

impl<'b> Execute<'b> {
    /// Queues instructions, which take room by `decode` and come `completed` two clocks later, and lets them go in order: a load when its
    /// vertex is there, a node when `node_room` says so, the end when `box_taken` does.
    pub fn new(
        plan: &Plan,
        m: &'b Builder,
        decode: Signal<'b>,
        completed: Flow<Signal<'b>, Signal<'b>>,
        vertex_valid: Signal<'b>,
        [node_room, box_taken]: [Signal<'b>; 2],
    ) -> Result<Execute<'b>, HdlError> {
        m.comment("Instructions wait for their vertices.");
        let (depth, take) = (
            plan.config.update_instructions_ahead,
            m.wire("take_instruction", 1),
        );
        let (push, word, pop) = (completed.valid, completed.payload, take.get());
        let queue = fifo::place(plan, "instruction_queue", depth, push, word, pop)?;
        let in_flight = Occupancy::new(plan, m, "instructions_waiting", depth, decode, pop);

        m.comment("Execute: the current instruction goes unless what it needs is missing.");
        let instruction = Instruction::of(plan);
        let word = m.reg("current", instruction.width());
        let valid = m.reg_reset("current_valid", 1, 0);
        let current = instruction.unpack(word.q).named("current");
        let waits =
            |kind: Signal<'b>, name: &Spec| (valid.q & kind).named(format!("{}_waits", name.name));
        let loads = waits(current.load, &instruction.load);
        let leafs = waits(current.leaf, &instruction.leaf);
        let nodes = waits(current.node, &instruction.node);
        let ends = waits(current.end, &instruction.end);
        crate::named! {
            let missing_vertex = loads & !vertex_valid;
            let missing_room = nodes & !node_room;
            let unfinished = ends & !box_taken;
            let goes = valid.q & !(missing_vertex | missing_room | unfinished);
        }
        take.drive(queue.valid & (goes | !valid.q));
        let take = take.get();
        word.next_when(take, queue.front);
        valid.next(take | (valid.q & !goes));
        crate::named! {
            let node_goes = nodes & node_room;
            let merge_goes = leafs | node_goes;
        }
        Ok(Execute {
            queue_room: in_flight.room,
            current,
            goes,
            load_goes: loads & vertex_valid,
            node_goes,
            merge_goes,
            end_waits: ends,
            missing_vertex,
            missing_room,
            front: instruction.unpack(queue.front),
            queue,
            in_flight,
            take,
            valid: valid.q,
            load_waits: loads,
        })
    }
}
