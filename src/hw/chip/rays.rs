//! The ray reader: makes packets of rays from the words of a cast.

mod properties;

use super::{COUNT_BITS, number};
use crate::hdl::{Builder, Flow, HdlError, Module, Reg, Signal, Specs, Wire};
use crate::hw::memory::combiner::WORD_BITS;
use crate::hw::plan::Plan;
use crate::hw::ray::{Limits, Line};
use crate::hw::raycast::Ray;
use crate::{bundle, interface};
use std::sync::Arc;

bundle! {
    /// The rays of a cast.
    pub struct Rays() {
        /// The number of rays, at least 1.
        count: COUNT_BITS,
        any_hit: 1,
        /// Whether a ray is one word, direction and tmax, and not two.
        short: 1,
        /// Origin and tmin of short rays, in binary32.
        origin: WORD_BITS,
    }
}

interface! {
    pub (plan: &Plan) {
        in "Cast to start, accepted while the unit is idle" { start: Flow<Rays>() }
        in "Words of rays, in the order of memory" { word_valid: 1, word: WORD_BITS }
        in "High while no further packet may start" { hold: 1 }
        in "Rays" { ray_ready: 1 }
        out "High from the cycle after the start until the last ray of the last packet is accepted" { running: 1 }
        out "Words of rays, in the order of memory" { word_ready: 1 }
        out "The packet that the next ray belongs to" { packet: plan.config.tag_bits }
        out "Rays" { ray: Flow<Ray>(plan) }
        out "Events for the counters" { ray_taken: 1 }
    }
}

/// Describes the ray reader of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "ray_reader",
        "converts the rays of a cast to the machine's format and passes them to the ray casting unit in packets.\n\
         The tag of a packet is its number in the cast. Inactive rays fill the last packet.",
    );
    let convert = number::module(plan.format)?;
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let start = (inputs.start.valid).named("starts");
    let cast = inputs.start.payload;

    let running = m.reg_reset("is_running", 1, 0);
    let left = m.reg("rays_left", COUNT_BITS);
    let any_hit = m.reg("is_any_hit", 1);
    let short = m.reg("is_short", 1);
    any_hit.next_when(start, cast.any_hit);
    short.next_when(start, cast.short);
    let words = Words::new(&m, &inputs, start, running.q, short.q);
    let loaded = Loaded::new(&m, plan, &convert, &words);

    m.comment("Rays leave in packets; a packet starts only while it is not held. Inactive rays follow the last ray to the end of its packet.");
    let (rays, slot_bits, tag_bits) = (plan.rays(), plan.ray_bits(), plan.config.tag_bits);
    let slot = m.reg("slot", slot_bits);
    let packet = m.reg("packet_number", tag_bits);
    let fills = (running.q & left.q.is_zero()).named("fills");
    let held = (inputs.hold & slot.q.is_zero()).named("is_held");
    let valid = ((words.ray_valid.q | fills) & !held).named("offers_ray");
    let taken = (valid & inputs.ray_ready).named("takes");
    let active_taken = (taken & !fills).named("takes_active_ray");
    words.ray_taken.drive(active_taken);
    words
        .ray_valid
        .next(loaded.direction_loads | (words.ray_valid.q & !active_taken));
    let one = m.lit(1u8, COUNT_BITS);
    left.next_when(start | active_taken, start.mux(cast.count, left.q - one));
    let last_slot = slot.q.equals(u128::from(rays) - 1).named("is_last_slot");
    slot.next_when(
        start | taken,
        (start | last_slot).mux(m.zero(slot_bits), slot.q + m.lit(1u8, slot_bits)),
    );
    let packet_ends = (taken & last_slot).named("packet_ends");
    packet.next_when(
        start | packet_ends,
        start.mux(m.zero(tag_bits), packet.q + m.lit(1u8, tag_bits)),
    );
    let none_left = (fills | left.q.equals(1)).named("none_left");
    running.next(start | (running.q & !(packet_ends & none_left)));

    let ray = Ray {
        tag: packet.q,
        line: Line {
            origin: loaded.origin,
            direction: loaded.direction,
        },
        limits: Limits {
            tmin: loaded.tmin,
            tmax: loaded.tmax,
        },
        active: !fills,
        any_hit: any_hit.q,
    };
    let outputs = Outputs {
        running: running.q,
        word_ready: words.ready,
        packet: packet.q,
        ray: Flow::new(valid, ray),
        ray_taken: active_taken,
    };
    ports.outputs.outputs(&m, outputs);
    properties::packs(&properties::Unit {
        m: &m,
        plan,
        inputs,
        outputs,
        words: &words,
        loaded: &loaded,
        packets: properties::Packets {
            running,
            left,
            slot,
            packet,
            short: short.q,
            fills,
            held,
            taken,
            none_left,
        },
    });
    m.finish()
}

/// The word that is converted next.
struct Words<'b> {
    valid: Reg<'b>,
    word: Reg<'b>,
    is_origin: Reg<'b>,
    expects_origin: Reg<'b>,
    /// A ray is complete; it leaves.
    ray_valid: Reg<'b>,
    ray_taken: Wire<'b>,
    /// The word is converted, and a word is accepted.
    moves: Signal<'b>,
    ready: Signal<'b>,
    taken: Signal<'b>,
}

impl<'b> Words<'b> {
    fn new(
        m: &'b Builder,
        inputs: &Inputs<Signal<'b>>,
        start: Signal<'b>,
        running: Signal<'b>,
        short: Signal<'b>,
    ) -> Words<'b> {
        let cast = inputs.start.payload;
        m.comment("A word is registered, then converted. Words of origins and of directions alternate; short rays have one origin for all, in a word of the start.");
        let valid = m.reg_reset("is_word_valid", 1, 0);
        let word = m.reg("stored_word", WORD_BITS);
        let is_origin = m.reg("is_origin", 1);
        let ray_valid = m.reg_reset("is_ray_valid", 1, 0);
        let ray_taken = m.wire("takes_ray", 1);
        let moves = (valid.q & (!ray_valid.q | ray_taken.get())).named("moves");
        let ready = (running & (!valid.q | moves)).named("is_word_ready");
        let taken = (inputs.word_valid & ready).named("takes_word");
        valid.next((start & cast.short) | taken | (valid.q & !moves));
        word.next_when(start | taken, start.mux(cast.origin, inputs.word));
        let expects_origin = m.reg("expects_origin", 1);
        expects_origin.next_when(
            start | taken,
            start.mux(!cast.short, !short & !expects_origin.q),
        );
        is_origin.next_when(start | taken, start.mux(m.lit(1u8, 1), expects_origin.q));
        Words {
            valid,
            word,
            is_origin,
            expects_origin,
            ray_valid,
            ray_taken,
            moves,
            ready,
            taken,
        }
    }
}

/// The converted numbers of a ray.
struct Loaded<'b> {
    origin: [Signal<'b>; 3],
    tmin: Signal<'b>,
    direction: [Signal<'b>; 3],
    tmax: Signal<'b>,
    /// The numbers of the word that is converted.
    numbers: Vec<Signal<'b>>,
    origin_loads: Signal<'b>,
    direction_loads: Signal<'b>,
}

impl<'b> Loaded<'b> {
    fn new(m: &'b Builder, plan: &Plan, convert: &Arc<Module>, words: &Words<'b>) -> Loaded<'b> {
        let number = plan.number();
        let numbers: Vec<_> = (["x", "y", "z", "limit"].iter().zip(0u32..))
            .map(|(part, place)| {
                let binary32 = words.word.q.field(32 * place, 32);
                let unit = m.instance(format!("convert_{part}"), convert, &[("word", binary32)]);
                unit.get("number")
            })
            .collect();
        let registers = |names: [&str; 4], load: Signal<'b>| {
            let mut place = 0;
            names.map(|name| {
                let register = m.reg(name, number);
                register.next_when(load, numbers[place]);
                place += 1;
                register.q
            })
        };
        let origin_loads = (words.moves & words.is_origin.q).named("loads_origin");
        let direction_loads = (words.moves & !words.is_origin.q).named("loads_direction");
        let [ox, oy, oz, tmin] =
            registers(["origin_x", "origin_y", "origin_z", "tmin"], origin_loads);
        let [dx, dy, dz, tmax] = registers(
            ["direction_x", "direction_y", "direction_z", "tmax"],
            direction_loads,
        );
        Loaded {
            origin: [ox, oy, oz],
            tmin,
            direction: [dx, dy, dz],
            tmax,
            numbers,
            origin_loads,
            direction_loads,
        }
    }
}
