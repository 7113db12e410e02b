//! Issue: sends influences to the geometry unit, each with its vertex.

use super::fetch::{Rows, Vectors};
use super::{Around, Influence, Issued, Mark, POSITION_BITS, joint_bits};
use crate::bkd::layout::{INFLUENCES_PER_ROW, fields};
use crate::hdl::{Flow, Signal, Signals, Specs, bits_for};
use crate::hw::banks::pick;
use crate::hw::counters::counts_up;
use crate::hw::ray::Vector;

/// The issued influences.
pub(super) struct Issue<'b> {
    /// An influence, one cycle after `issue`.
    pub issued: Flow<Issued<Signal<'b>>, Signal<'b>>,
    pub issue: Signal<'b>,
    /// High with `issue` for the last influence of a vertex.
    pub completes: Signal<'b>,
    /// High when the front row has been used.
    pub pop_row: Signal<'b>,
    // For the properties.
    pub room_missing: Signal<'b>,
}

impl<'b> Issue<'b> {
    /// Issues one influence per cycle if it and its vertex are available and, for the last influence of a vertex, the write queue has room.
    pub fn new(
        &Around { plan, m, told, .. }: &Around<'b>,
        rows: &Rows<'b>,
        vectors: &Vectors<'b>,
    ) -> Issue<'b> {
        m.comment("Issue: an influence is issued with its vertex when both are available; the last influence of a vertex also needs room in the write queue.");
        let (start, skinning) = (rows.start.valid, rows.skinning);
        let slot_bits = bits_for(INFLUENCES_PER_ROW as u64);
        let slot = m.reg("slot", slot_bits);
        let of_row = fields::Influence::of(plan.format);
        let width = of_row.width();
        let slots: Vec<_> = (0..INFLUENCES_PER_ROW as u32)
            .map(|k| rows.reader.front.field(k * width, width))
            .collect();
        let influence = pick("influence", slot.q, &slots).named("influence");
        let fields::Influence {
            weight,
            joint,
            last,
        } = of_row.unpack(influence).named("influence");
        crate::named! {
            let vertex_missing = !vectors.reader.valid | vectors.loading;
            let row_missing = !rows.reader.valid;
            let room_missing = last & !told.room;
            let issue = skinning & !(vertex_missing | row_missing | room_missing);
            let last_slot = slot.q.all();
        }
        counts_up(slot, (start, m.zero(slot_bits)), issue);
        let position = m.reg("position", POSITION_BITS);
        let after = position.q + m.lit(1u8, POSITION_BITS);
        let next = (start | last).mux(m.zero(POSITION_BITS), after);
        position.next_when(start | issue, next);
        let issued = m.reg_reset("issued", 1, 0);
        issued.next(issue);
        let point = fields::Vertex::of(plan.format).unpack(vectors.reader.front);
        let influence = Influence {
            joint: joint.low(joint_bits(plan)),
            point: Vector {
                axes: point.position,
            },
            weight: m.zero(1).concat(weight),
        };
        let position = position.q;
        let mark = Mark { position, last };
        let held = Issued::of(plan).hold("issued", Issued { influence, mark });
        Issue {
            issued: Flow::new(issued.q, held),
            issue,
            completes: issue & last,
            // The rest of the last row is discarded when the mesh is complete.
            pop_row: rows.reader.valid & (!skinning | (issue & last_slot)),
            room_missing,
        }
    }
}
