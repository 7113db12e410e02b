//! Write: the intervals of nodes, and the object's box at the end.

use super::execute::Execute;
use super::merge::{Merge, Operands};
use super::{Around, NODE_LANES, NODE_MASK, NodeWrite, Start, counts_later, later};
use crate::bkd::layout::{Record, fields};
use crate::hdl::fifo::Placed;
use crate::hdl::prefetch::Occupancy;
use crate::hdl::{Flow, HdlError, Signal, Specs, Write};
use crate::hw::counters::counts_up;

/// The writes of nodes.
pub(super) struct Nodes<'b> {
    pub write: Flow<NodeWrite<Signal<'b>>, Signal<'b>>,
    /// The nodes with reserved room: it determines whether one more may be issued.
    pub in_flight: Occupancy<'b>,
    // For the properties.
    pub queue: Placed<'b>,
    /// The registers of a node's bounds on their way to the queue.
    pub to_queue: Vec<Signal<'b>>,
}

impl<'b> Nodes<'b> {
    /// Selects the intervals of an issued node from its operands, one cycle after these, and queues them until they are written, starting
    /// with the object's first node.
    pub fn new(
        around: &Around<'b>,
        start: Start<'b>,
        execute: &Execute<'b>,
        operands: &Operands<'b>,
    ) -> Result<Nodes<'b>, HdlError> {
        let Around { plan, m, p, .. } = *around;
        let inputs = &around.inputs;
        m.comment("The intervals of a node, each on its axis, are queued until they are written.");
        let axes = p.enter(execute.current.z.low(4)).named("merge_axes");
        let axes = axes.at(operands.stage());
        let number = |child: u32, side: &str, end: &str, bounds: [Signal<'b>; 3]| {
            let axis = axes.part(side, 2 * child, 2);
            let number = m.select(axis, &bounds).named(format!("{side}_{end}"));
            number.register()
        };
        let (left, right) = (&operands.first, &operands.second);
        let intervals = fields::Planes::of(plan.format).pack(fields::Planes {
            left_lo: number(0, "left", "lo", left.lo),
            left_hi: number(0, "left", "hi", left.hi),
            right_lo: number(1, "right", "lo", right.lo),
            right_hi: number(1, "right", "hi", right.hi),
        });
        let at = intervals.stage();
        let goes = p.enter(execute.node_goes).cleared_by_reset();
        let node_pop = m.wire("node_pop", 1);
        let (depth, pop) = (plan.config.update_nodes_waiting, node_pop.get());
        let (push, data) = (goes.at(at).untimed(), intervals.untimed());
        let queue = plan.queue("node_queue", depth, push, data, pop)?;
        node_pop.drive(queue.valid & inputs.node_write_ready);
        let in_flight = Occupancy::new(
            plan.timing.room,
            m,
            "nodes_under_way",
            depth,
            execute.node_goes,
            pop,
        );
        let next_node = m.reg("next_node", plan.address());
        counts_up(next_node, (start.valid, start.payload.node_base), pop);
        let node = NodeWrite {
            address: next_node.q,
            mask: m.lit(NODE_MASK, NODE_LANES),
            data: queue.front.extend(Record::node(plan.format).width),
        };
        Ok(Nodes {
            write: Flow::new(queue.valid, node),
            in_flight,
            queue,
            to_queue: goes.stages(1..=at),
        })
    }
}

/// The end of an update.
pub(super) struct End<'b> {
    pub write: Flow<Write<Signal<'b>>, Signal<'b>>,
    pub box_taken: Signal<'b>,
    /// High for one cycle when the update is complete.
    pub done: Signal<'b>,
    // For the properties.
    /// The registers of the merge flag, one per cycle of a box's read.
    pub merging: Vec<Signal<'b>>,
    /// The registers of the flag of a waiting end, one fewer.
    pub waiting: Vec<Signal<'b>>,
    pub box_was_read: Signal<'b>,
    pub all_complete: Signal<'b>,
}

impl<'b> End<'b> {
    /// Presents the object's box until it is accepted. The box is the first operand of the end instruction, after its register has been
    /// read, all merges are in their registers, and all nodes are written.
    pub fn new(
        around: &Around<'b>,
        start: Start<'b>,
        execute: &Execute<'b>,
        operands: &Operands<'b>,
        merge: &Merge<'b>,
        nodes: &Nodes<'b>,
    ) -> End<'b> {
        let Around { plan, m, p, .. } = *around;
        let inputs = &around.inputs;
        let ends = execute.end_waits;
        let (read_at, merges) = (operands.stage(), merge.goes);
        m.comment("End of the update: when all merges are in their registers and all nodes are written, the object's box is read like that of a node.");
        // The presented box was read read_at cycles before.
        // No merge has started since the end waits.
        let under_way: Vec<_> = (read_at..merge.written + read_at)
            .map(|k| merges.at(k).untimed())
            .collect();
        let under_way = m.or_all(&under_way).hinted("merges_under_way");
        let under_way = (under_way | nodes.in_flight.any).hinted("work_under_way");
        let all_complete = (!under_way).named("all_complete");
        let box_shown = m.reg_reset("box_shown", 1, 0);
        let box_taken = box_shown.q & inputs.box_write_ready;
        // The end must have waited until its register is read: other merges may have ended long before.
        let waits = p.enter(ends).cleared_by_reset();
        let was_read = (1..read_at).fold(ends, |so_far, k| so_far & waits.at(k).untimed());
        let box_was_read = was_read.named("box_was_read");
        box_shown.next(box_was_read & all_complete & !box_taken);
        let box_index = m.reg("box_index", plan.address());
        box_index.next_when(start.valid, start.payload.box_index);
        let write = Write {
            address: box_index.q,
            data: fields::Box::of(plan.format).pack(operands.first).untimed(),
        };
        let over = m.reg_reset("over", 1, 0);
        over.next(box_taken);
        // With the same delay as the counters.
        let done = match counts_later(plan) {
            false => over.q,
            true => later(m, "over_before", over.q),
        };
        End {
            write: Flow::new(box_shown.q, write),
            box_taken,
            done,
            merging: merges.stages(1..=read_at),
            waiting: waits.stages(1..=read_at - 1),
            box_was_read,
            all_complete,
        }
    }
}
