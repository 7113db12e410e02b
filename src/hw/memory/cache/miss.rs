//! Lines in flight: their bursts, and the lists of the requests that wait for them.

use super::decide::Decide;
use super::fill::Fill;
use super::{Around, Burst, PerMiss, bits, id, is_id, join, lowest};
use crate::hdl::fifo::{self, Placed};
use crate::hdl::{Flow, HdlError, Memory, Reg, Signal, Style};
use crate::hw::memory::{ADDRESS_BITS, BEATS_BITS};

/// The requests of lines to memory.
pub(super) struct Bursts<'b> {
    pub burst: Flow<Burst<Signal<'b>>, Signal<'b>>,
    // For the properties.
    pub queue: Placed<'b>,
    pub lines: PerMiss<'b>,
}

impl<'b> Bursts<'b> {
    pub fn new(around: &Around<'_, 'b>, decide: &Decide<'b>) -> Result<Bursts<'b>, HdlError> {
        let Around { m, shape, inputs } = *around;
        m.comment("Miss registers whose line is to be requested, in order. There is room for all.");
        let pop = m.wire("burst_taken", 1);
        let registers_front = shape.timing.queue_front;
        let (push, data) = (decide.allocates, decide.free);
        let queue = fifo::place(
            registers_front,
            "burst_queue",
            // A queue with a register in front has room for two.
            shape.misses.max(2),
            push,
            data,
            pop.get(),
        )?;
        pop.drive(queue.valid & inputs.burst_ready);
        let lines = PerMiss::new(around, "lines", decide.allocates, decide.free, decide.line);
        let line = lines.read(queue.front).hinted("burst_line");
        let address = match shape.line_bytes {
            1 => line,
            bytes => line.concat(m.zero(bytes.ilog2())),
        };
        let burst = Burst {
            address: address.extend(ADDRESS_BITS),
            beats: m.lit(shape.beats() - 1, BEATS_BITS),
            id: queue.front,
        };
        Ok(Bursts {
            burst: Flow::new(queue.valid, burst),
            queue,
            lines,
        })
    }
}

/// The requests that wait for a line: a linked list per miss register, stored by tag. When a line is complete, its list is answered,
/// one request per cycle, in the order of arrival.
pub(super) struct Lists<'b> {
    /// A request is answered: its tag, and its record's place.
    pub draining: Signal<'b>,
    pub tag: Signal<'b>,
    pub way: Option<Signal<'b>>,
    pub set: Signal<'b>,
    pub offset: Option<Signal<'b>>,
    /// By miss register: its last answer goes.
    pub freed: Signal<'b>,
    // For the properties.
    pub complete: Vec<Reg<'b>>,
    pub begins: Signal<'b>,
    pub id: Signal<'b>,
    pub is_last: Signal<'b>,
    pub heads: PerMiss<'b>,
    pub tails: PerMiss<'b>,
    pub nexts: Memory<'b>,
    pub offsets: Option<Memory<'b>>,
    pub homes: PerMiss<'b>,
    pub home: Signal<'b>,
}

impl<'b> Lists<'b> {
    pub fn new(around: &Around<'_, 'b>, decide: &Decide<'b>, fill: &Fill<'b>) -> Lists<'b> {
        let Around { m, shape, .. } = *around;
        m.comment("Lines that are complete and not being answered. The first of them is next.");
        let draining = m.reg_reset("answering", 1, 0);
        let complete: Vec<_> = (0..shape.misses)
            .map(|k| m.reg_reset(format!("miss{k}_complete"), 1, 0))
            .collect();
        let chosen = lowest(
            "is_answered_next",
            &complete.iter().map(|reg| reg.q).collect::<Vec<_>>(),
        );
        let any_complete = m.or_all(&chosen).hinted("any_complete");
        let begins = (any_complete & !draining.q).named("answers_begin");
        for ((register, chosen), last) in complete.iter().zip(&chosen).zip(&fill.last) {
            register.next(*last | (register.q & !(begins & *chosen)));
        }
        let chosen_id = id(m, shape, "complete_id", &chosen);
        let answered = m.reg("answered_id", shape.id_bits());
        answered.next_when(begins, chosen_id);

        m.comment("The lists: the first and the last tag of each miss register, and the tag behind each tag.");
        let tag_bits = shape.tag_bits;
        let memory =
            |name: &str, depth: u32, width: u32| m.memory(name, depth, width, Style::Distributed);
        let heads = PerMiss::new(around, "heads", decide.allocates, decide.free, decide.tag);
        let listing = (decide.allocates | decide.appends).named("listing");
        let listed = decide.allocates.mux(decide.free, decide.listed);
        let listed = listed.hinted("listing_id");
        let tails = PerMiss::new(around, "tails", listing, listed, decide.tag);
        // No request is listed while a list is answered.
        let read_id = draining.q.mux(answered.q, decide.listed);
        let tail = tails.read(read_id.hinted("tail_id")).hinted("tail");
        let nexts = memory("nexts", 1 << tag_bits, tag_bits);
        nexts.write(decide.appends, tail, decide.tag);
        let current = m.reg("answered_tag", tag_bits);
        let next_tag = nexts.read_now(current.q).named("next_tag");
        let is_last = current.q.eq(tail).named("is_last");
        draining.next(begins | (draining.q & !is_last));
        let head = heads.read(chosen_id);
        current.next(draining.q.mux(next_tag, head));
        let offsets = decide.offset.map(|offset| {
            let offsets = memory("offsets", 1 << tag_bits, offset.width());
            offsets.write(listing, decide.tag, offset);
            offsets
        });

        m.comment("Where the line is.");
        let (way_bits, set_bits) = (shape.way_bits(), shape.set_bits());
        let set = decide.line.part("set", 0, set_bits);
        let home = join(&[decide.victim, Some(set)]).expect("a set has bits");
        let home = home.hinted("victim_place");
        let homes = PerMiss::new(around, "homes", decide.allocates, decide.free, home);
        let home = m.reg("answered_home", way_bits + set_bits);
        home.next_when(begins, homes.read(chosen_id));
        let ends = (draining.q & is_last).named("answers_end");
        let freed: Vec<_> = (is_id(shape, answered.q).iter().rev())
            .map(|is| ends & *is)
            .collect();
        Lists {
            draining: draining.q,
            tag: current.q,
            way: bits(Some(home.q), set_bits, way_bits),
            set: home.q.low(set_bits),
            offset: offsets.map(|offsets| offsets.read_now(current.q)),
            freed: m.concat(&freed),
            complete,
            begins,
            id: answered.q,
            is_last,
            heads,
            tails,
            nexts,
            offsets,
            homes,
            home: home.q,
        }
    }
}
