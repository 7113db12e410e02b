//! Execute: issues the current instruction when its operands are available. This is the only part that waits for memory; later
//! instructions then wait as well.

use super::decode::Decode;
use super::fetch::Vertices;
use super::{Around, Instruction};
use crate::hdl::fifo::Placed;
use crate::hdl::prefetch::Occupancy;
use crate::hdl::{HdlError, Signal, Signals, Spec, Specs};

/// The results of execution.
pub(super) struct Execute<'b> {
    /// The instructions with reserved room: it determines whether one more may be decoded.
    pub in_flight: Occupancy<'b>,
    /// The current instruction, issued or waiting.
    pub current: Instruction<Signal<'b>>,
    pub goes: Signal<'b>,
    /// Whether it is issued and is a load, a node, or one of the two kinds that merge.
    pub load_goes: Signal<'b>,
    pub node_goes: Signal<'b>,
    pub merge_goes: Signal<'b>,
    /// Whether it is the end instruction, which waits until the object's box is accepted.
    pub end_waits: Signal<'b>,
    /// The reason for waiting.
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
    /// Queues instructions, which reserve room when they leave the window and arrive two cycles later, and issues them in order: a load
    /// when its vertex is available, a node when there is room for its write, the end when the box is accepted.
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
