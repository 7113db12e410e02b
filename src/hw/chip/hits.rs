//! The hit writer: turns the hits of a cast into writes.

mod properties;

use super::answers::{self, AnswerWord, Answers};
use super::{COUNT_BITS, fitted, write_of_32_bits};
use crate::bkd::bytes::ByteRecord;
use crate::hdl::{Builder, Flow, HdlError, Module, Reg, Signal, Specs, Wire};
use crate::hw::memory::ADDRESS_BITS;
use crate::hw::memory::combiner::{WORD_BITS, WORD_BYTES, Word};
use crate::hw::plan::Plan;
use crate::hw::ray::Hit;
use crate::hw::raycast::TaggedHit;
use crate::{bundle, interface};
use std::sync::Arc;

bundle! {
    /// The hits of a cast.
    pub struct Hits() {
        /// The number of rays, at least 1.
        count: COUNT_BITS,
        any_hit: 1,
        /// The address of the hits, a multiple of 64.
        address: ADDRESS_BITS,
    }
}

interface! {
    pub (plan: &Plan) {
        in "Cast to start, accepted while the unit is idle" { start: Flow<Hits>() }
        in "Hits: those of a packet one after another" { hit: Flow<TaggedHit>(plan) }
        in "The packet that the next ray belongs to" { packet: plan.config.tag_bits }
        in "Writes" { write_ready: 1 }
        out "High from the cycle after the start until the last write is accepted" { running: 1 }
        out "Hits: those of a packet one after another" { hit_ready: 1 }
        out "High while no further packet may start" { hold: 1 }
        out "Writes" { write: Flow<Word>() }
    }
}

/// A write of up to two words, before its register.
#[derive(Clone, Copy)]
struct Offer<'b> {
    valid: Signal<'b>,
    address: Signal<'b>,
    data: Signal<'b>,
    strobes: Signal<'b>,
}

/// The state that the parts share.
struct Writer<'a, 'b> {
    m: &'b Builder,
    plan: &'a Plan,
    inputs: Inputs<Signal<'b>>,
    /// Whether a hit is accepted.
    taken: Signal<'b>,
    slot: Signal<'b>,
    /// Rays and address of the cast.
    count: Signal<'b>,
    base: Signal<'b>,
}

/// Describes the hit writer of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "hit_writer",
        "writes the hits of a cast: a record for each ray, or one bit for each any-hit ray.\n\
         Packets finish in any order; the address of a hit follows from the tag of its packet.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let start = inputs.start.valid;
    let cast = inputs.start.payload;
    let (rays, slot_bits) = (plan.rays(), plan.ray_bits());

    let count = m.reg("ray_count", COUNT_BITS);
    let any_hit = m.reg("is_any_hit", 1);
    let base = m.reg("base_address", ADDRESS_BITS);
    count.next_when(start, cast.count);
    any_hit.next_when(start, cast.any_hit);
    base.next_when(start, cast.address);

    m.comment("The last hit of each packet counts the packet.");
    let taken = m.wire("takes_hit", 1);
    let slot = m.reg("slot", slot_bits);
    let last_slot = slot.q.equals(u128::from(rays) - 1).named("is_last_slot");
    let one_slot = m.lit(1u8, slot_bits);
    slot.next_when(
        start | taken.get(),
        (start | last_slot).mux(m.zero(slot_bits), slot.q + one_slot),
    );
    let packets_left = m.reg_reset("packets_left", COUNT_BITS, 0);
    let packet_ends = (taken.get() & last_slot).named("packet_ends");
    let packets = packets_of(plan, cast.count);
    packets_left.next_when(
        start | packet_ends,
        start.mux(packets, packets_left.q - m.lit(1u8, COUNT_BITS)),
    );

    let writer = Writer {
        m: &m,
        plan,
        inputs,
        taken: taken.get(),
        slot: slot.q,
        count: count.q,
        base: base.q,
    };
    let record = writer.record();
    let room = m.wire("has_room", 1);
    let (packet_answers, earlier) = writer.answers();
    let packet_answers = Flow::new(packet_ends & any_hit.q, packet_answers);
    let collector = answers::ports(plan).place(
        "collector",
        &m,
        &answers::module(plan)?,
        answers::Inputs {
            start: start & cast.any_hit,
            packets,
            answers: packet_answers,
            packet: inputs.packet,
            word_ready: room.get(),
        },
    );
    let answers = writer.answer_write(collector.word);
    let stored = Stored::new(&m, inputs.write_ready, record.data.width(), room);
    let hit_ready = (any_hit.q | room.get()).named("is_hit_ready");
    taken.drive(inputs.hit.valid & hit_ready);
    stored.follow(&m, any_hit.q, record, answers);

    let outputs = Outputs {
        running: packets_left.q.any() | collector.running | stored.valid.q,
        hit_ready,
        hold: any_hit.q & collector.hold,
        write: Flow::new(stored.valid.q, stored.write()),
    };
    ports.outputs.outputs(&m, outputs);
    properties::writes(&properties::Unit {
        m: &m,
        plan,
        inputs,
        outputs,
        stored: &stored,
        packets: properties::Packets {
            left: packets_left,
            all: packets,
            slot,
            any_hit,
            count,
            base,
            taken: taken.get(),
            ends: packet_ends,
        },
        record,
        answers: packet_answers,
        answer_write: answers,
        earlier,
        collector,
    });
    m.finish()
}

/// The write that is offered.
struct Stored<'b> {
    valid: Reg<'b>,
    /// Whether the second word of a record follows.
    second: Reg<'b>,
    address: Reg<'b>,
    data: Reg<'b>,
    strobes: Reg<'b>,
    room: Signal<'b>,
    accepted: Signal<'b>,
    leaves: Signal<'b>,
}

impl<'b> Stored<'b> {
    fn new(m: &'b Builder, ready: Signal<'b>, data_bits: u32, room: Wire<'b>) -> Stored<'b> {
        m.comment("A write is registered. The second word of a wide record follows the first.");
        let valid = m.reg_reset("is_write_valid", 1, 0);
        let second = m.reg_reset("second_follows", 1, 0);
        let address = m.reg("stored_address", ADDRESS_BITS);
        let data = m.reg("stored_data", data_bits);
        let strobes = m.reg("stored_strobes", WORD_BYTES);
        let accepted = (valid.q & ready).named("is_accepted");
        let leaves = (accepted & !second.q).named("write_leaves");
        room.drive(!valid.q | leaves);
        Stored {
            valid,
            second,
            address,
            data,
            strobes,
            room: room.get(),
            accepted,
            leaves,
        }
    }

    /// Drives the registers by a record or by a word of answers.
    fn follow(&self, m: &'b Builder, any_hit: Signal<'b>, record: Offer<'b>, answers: Offer<'b>) {
        let offer = Offer {
            valid: any_hit.mux(answers.valid, record.valid).named("offers"),
            address: any_hit.mux(answers.address, record.address),
            data: any_hit.mux(answers.data, record.data),
            strobes: any_hit.mux(answers.strobes, record.strobes),
        };
        let loads = (offer.valid & self.room).named("loads_write");
        self.valid.next(loads | (self.valid.q & !self.leaves));
        let moves_on = (self.accepted & self.second.q).named("second_moves");
        let step = m.lit(WORD_BYTES, ADDRESS_BITS);
        self.address.next_when(
            loads | moves_on,
            moves_on.mux(self.address.q + step, offer.address),
        );
        self.strobes.next_when(loads, offer.strobes);
        match self.data.q.width() / WORD_BITS {
            1 => {
                self.second.next(m.zero(1));
                self.data.next_when(loads, offer.data);
            }
            _ => {
                let stays = self.second.q & !self.accepted;
                self.second.next((loads & !any_hit) | stays);
                let shifted = m.zero(WORD_BITS).concat(self.data.q.high(WORD_BITS));
                self.data
                    .next_when(loads | moves_on, moves_on.mux(shifted, offer.data));
            }
        }
    }

    fn write(&self) -> Word<Signal<'b>> {
        Word {
            address: self.address.q,
            data: self.data.q.low(WORD_BITS),
            strobes: self.strobes.q,
        }
    }
}

/// The number of packets of a number of rays.
fn packets_of<'b>(plan: &Plan, rays: Signal<'b>) -> Signal<'b> {
    let m = rays.module();
    let slots = plan.rays().ilog2();
    if slots == 0 {
        return rays;
    }
    let part = rays.low(slots).any().extend(COUNT_BITS);
    (m.zero(slots).concat(rays.high(COUNT_BITS - slots)) + part).named("packet_count")
}

impl<'b> Writer<'_, 'b> {
    /// The number of the ray whose hit is offered, in `COUNT_BITS` bits.
    fn ray(&self) -> Signal<'b> {
        let tag = self.inputs.hit.payload.tag;
        let number = match self.plan.rays() {
            1 => tag,
            _ => tag.concat(self.slot),
        };
        fitted(number, COUNT_BITS)
    }

    /// A record for each ray.
    fn record(&self) -> Offer<'b> {
        let m = self.m;
        m.comment("A record for each ray: the parts of the hit at their bytes.");
        let layout = ByteRecord::hit(self.plan.format);
        let ray = self.ray().named("ray_number");
        let exists = ray.lt(self.count).named("ray_exists");
        let scale = layout.bytes.ilog2();
        let offset = ray.low(ADDRESS_BITS - scale).concat(m.zero(scale));
        let bytes = layout.bytes.max(WORD_BYTES);
        Offer {
            valid: self.taken & exists,
            address: (self.base + offset).named("record_address"),
            data: bytes_of(&layout, self.inputs.hit.payload.hit, 8 * bytes).named("record_bytes"),
            strobes: m.ones(WORD_BYTES),
        }
    }

    /// The answers of the packet whose last hit is offered, and the register of the earlier ones, if a packet has several rays.
    fn answers(&self) -> (Answers<Signal<'b>>, Option<Reg<'b>>) {
        let (m, plan) = (self.m, self.plan);
        m.comment("One bit for each any-hit ray; those of a packet are collected.");
        let offered = self.inputs.hit.payload;
        let is_hit = offered.hit.t.ne(plan.infinity(m)).named("is_hit");
        let (bits, earlier) = match plan.rays() {
            1 => (is_hit, None),
            rays => {
                let earlier = m.reg("earlier_answers", rays - 1);
                let all = is_hit.concat(earlier.q);
                earlier.next_when(self.taken, all.high(rays - 1));
                (all, Some(earlier))
            }
        };
        let answers = Answers {
            tag: offered.tag,
            bits: bits.named("packet_answers"),
        };
        (answers, earlier)
    }

    /// The write of a word of answers.
    fn answer_write(&self, word: Flow<AnswerWord<Signal<'b>>, Signal<'b>>) -> Offer<'b> {
        let m = self.m;
        let AnswerWord { number, bits } = word.payload;
        let offset = number.low(ADDRESS_BITS - 2).concat(m.zero(2));
        let address = (self.base + offset).named("answer_address");
        let write = write_of_32_bits(address, number.low(2), bits);
        Offer {
            valid: word.valid,
            address: write.address,
            data: write.data.extend(bytes_width(self.plan)),
            strobes: write.strobes,
        }
    }
}

/// Bits of the data of a write: a record, at least a word.
fn bytes_width(plan: &Plan) -> u32 {
    8 * ByteRecord::hit(plan.format).bytes.max(WORD_BYTES)
}

/// A hit as bytes.
fn bytes_of<'b>(layout: &ByteRecord, hit: Hit<Signal<'b>>, width: u32) -> Signal<'b> {
    let m = hit.t.module();
    let value = |name: &str| match name {
        "t" => hit.t,
        "u" => hit.u,
        "v" => hit.v,
        "triangle" => hit.triangle,
        _ => hit.instance.low(24),
    };
    let mut parts: Vec<Signal<'b>> = vec![];
    let mut bytes = 0;
    for part in &layout.parts {
        parts.push(value(part.name).extend(8 * part.bytes()));
        bytes += part.bytes();
    }
    if 8 * bytes < width {
        parts.push(m.zero(width - 8 * bytes));
    }
    parts.reverse();
    m.concat(&parts)
}
