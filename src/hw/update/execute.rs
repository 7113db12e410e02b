//! Execute: the current instruction is issued when its operands are available. Only here is memory waited for, and then all later instructions
//! wait too.

use super::decode::Decode;
use super::fetch::Vertices;
use super::{Around, Instruction};
use crate::hdl::fifo::Placed;
use crate::hdl::prefetch::Occupancy;
use crate::hdl::{HdlError, Signal, Signals, Spec, Specs};

/// What execution gives.
pub(super) struct Execute<'b> {
    /// Instructions that have room: it tells whether one more may be decoded.
    pub in_flight: Occupancy<'b>,
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
    pub front: Instruction<Signal<'b>>,
    pub take: Signal<'b>,
    pub valid: Signal<'b>,
    pub load_waits: Signal<'b>,
}

impl<'b> Execute<'b> {
    /// Queues instructions, which take room as they leave the window and come two clocks later, and lets them go in order: a load when its
    /// vertex is there, a node when there is room for it, the end when the box is taken.
    pub fn new(
        &Around { plan, m, told, .. }: &Around<'b>,
        decode: &Decode<'b>,
        vertices: &Vertices<'b>,
    ) -> Result<Execute<'b>, HdlError> {
        m.comment("Instructions wait here for their vertices.");
        let depth = plan.config.update_instructions_ahead;
        let take = m.wire("take_instruction", 1);
        let (push, word) = (decode.completed.valid, decode.completed.payload);
        let (comes, pop) = (decode.decode, take.get());
        let queue = plan.queue("instruction_queue", depth, push, word, pop)?;
        let in_flight = Occupancy::new(
            plan.timing.room,
            m,
            "instructions_waiting",
            depth,
            comes,
            pop,
        );

        m.comment("Execute: the current instruction is issued when its operands are available.");
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
            let missing_vertex = loads & !vertices.reader.valid;
            let missing_room = nodes & !told.node_room;
            let unfinished = ends & !told.box_taken;
            let goes = valid.q & !(missing_vertex | missing_room | unfinished);
        }
        take.drive(queue.valid & (goes | !valid.q));
        let take = take.get();
        word.next_when(take, queue.front);
        valid.next(take | (valid.q & !goes));
        crate::named! {
            let node_goes = nodes & told.node_room;
            let merge_goes = leafs | node_goes;
        }
        Ok(Execute {
            current,
            goes,
            load_goes: loads & vertices.reader.valid,
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
