//! Write: queues vertices until they are written, and signals the completion of a mesh.

use super::Around;
use super::fetch::Rows;
use super::issue::Issue;
use super::sum::VertexSums;
use crate::bkd::layout::fields;
use crate::hdl::prefetch::Occupancy;
use crate::hdl::{Flow, Memory, Signal, Specs, Style, Write, bits_for};
use crate::hw::counters::{counts_down, counts_up};

/// The write queue, and the end of a mesh.
pub(super) struct Queue<'b> {
    pub write: Flow<Write<Signal<'b>>, Signal<'b>>,
    /// The vertices with reserved room in the queue: it determines whether one more may be issued.
    pub under_way: Occupancy<'b>,
    /// The whole mesh is written; the same one cycle later.
    pub over: Signal<'b>,
    pub done: Signal<'b>,
    // For the properties.
    pub depth: u32,
    pub words: Memory<'b>,
    pub data: Signal<'b>,
    pub head: Signal<'b>,
    pub tail: Signal<'b>,
    pub grows: Signal<'b>,
    pub queued: Occupancy<'b>,
    pub written: Signal<'b>,
    pub vertices_left: Signal<'b>,
}

impl<'b> Queue<'b> {
    /// Takes each summed vertex, for which room was reserved when its last influence was issued, and presents it until it is written, at
    /// least two cycles later. A mesh is complete when its palette is loaded and all its vertices are written.
    pub fn new(
        around: &Around<'b>,
        rows: &Rows<'b>,
        loading: Signal<'b>,
        issue: &Issue<'b>,
        sums: &VertexSums<'b>,
    ) -> Queue<'b> {
        let Around { plan, m, .. } = *around;
        let inputs = &around.inputs;
        m.comment("The write queue, in block RAM: read at the next head in every cycle; a word is valid two cycles after its write.");
        let depth = plan.config.skinning_vertices_waiting;
        let bits = bits_for(u64::from(depth));
        let of_vertex = fields::Vertex::of(plan.format);
        let words = m.memory("write_queue", depth, of_vertex.width(), Style::Block);
        let head = m.reg_reset("queue_head", bits, 0);
        let tail = m.reg_reset("queue_tail", bits, 0);
        let last = u128::from(depth) - 1;
        let after = |place: Signal<'b>| {
            let next = place + m.lit(1u8, bits);
            place.equals(last).mux(m.zero(bits), next)
        };
        let data = of_vertex.pack(fields::Vertex {
            position: inputs.vertex_sum,
        });
        let vertex_done = sums.vertex_done;
        words.write(vertex_done, tail.q, data);
        tail.next_when(vertex_done, after(tail.q));
        let written = m.wire("written", 1);
        let grows = m.reg_reset("queue_grows", 1, 0);
        grows.next(vertex_done);
        let queued = Occupancy::new(
            plan.timing.room,
            m,
            "queue_count",
            depth,
            grows.q,
            written.get(),
        );
        let next_head = written.get().mux(after(head.q), head.q).named("next_head");
        head.next(next_head);
        let front = words.read(next_head);
        written.drive(queued.any & inputs.write_ready);
        let written = written.get();
        let under_way = Occupancy::new(
            plan.timing.room,
            m,
            "vertices_under_way",
            depth,
            issue.completes,
            written,
        );
        let (start, mesh) = (rows.start.valid, rows.start.payload);
        let next_written = m.reg("next_written", plan.address());
        counts_up(next_written, (start, mesh.target), written);

        m.comment("End of the mesh: its last vertex is written.");
        let vertices_left = m.reg_reset("vertices_left", plan.address(), 0);
        counts_down(vertices_left, (start, mesh.vertices), written);
        let over = rows.skinning & !(loading | vertices_left.q.any());
        let done = m.reg_reset("mesh_done", 1, 0);
        done.next(over);
        let write = Write {
            address: next_written.q,
            data: front,
        };
        Queue {
            write: Flow::new(queued.any, write),
            under_way,
            over,
            done: done.q,
            depth,
            words,
            data,
            head: head.q,
            tail: tail.q,
            grows: grows.q,
            queued,
            written,
            vertices_left: vertices_left.q,
        }
    }
}
