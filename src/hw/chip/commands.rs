//! The command processor: executes command lists.

mod properties;

use super::cast::Cast;
use super::hits::Hits;
use super::rays::Rays;
use super::write_of_32_bits;
use crate::bkd::bytes::ByteRecord;
use crate::bkd::layout::Record;
use crate::chip::descriptor::{self, Fault, cast, end, fence, jump, scene, signal};
use crate::chip::most_rays;
use crate::hdl::{Builder, Bundle, Flow, HdlError, Module, Reg, Signal, Specs, bits_for};
use crate::hw::memory::combiner::Word;
use crate::hw::memory::reader::WORD_ADDRESS_BITS;
use crate::hw::memory::{ADDRESS_BITS, BEATS_BITS, Beat, Burst};
use crate::hw::plan::Plan;
use crate::{bundle, interface};
use std::sync::Arc;

/// Words of a descriptor that any command has, from word 0 on.
const STORED: u32 = 8;

/// Width of an error code.
pub const CODE_BITS: u32 = 4;

bundle! {
    /// The arrays of a scene, constant while rays are cast.
    pub struct Arrays(plan: &Plan) {
        root: Record::link_word().width,
        /// Byte addresses.
        nodes: ADDRESS_BITS,
        records: ADDRESS_BITS,
        vertices: ADDRESS_BITS,
        lo: [plan.number(); xyz],
        hi: [plan.number(); xyz],
    }
}

bundle! {
    /// The start of a cast, for the burst reader, the ray reader and the hit writer.
    pub struct CastStart() {
        /// The address of the rays, and their words.
        rays_address: ADDRESS_BITS,
        words: WORD_ADDRESS_BITS,
        cast: ..{Cast}(),
    }
}

bundle! {
    /// How a list has ended early.
    pub struct Failure() {
        code: CODE_BITS,
        descriptor: ADDRESS_BITS,
        value: ADDRESS_BITS,
    }
}

interface! {
    pub (plan: &Plan, bus_bits: u32) {
        in "Command list to start" { start_valid: 1, start_address: ADDRESS_BITS }
        in "Memory: bursts to read" { read_ready: 1 }
        in "Memory: read data, always taken" { beat: Flow<Beat>(1, bus_bits) }
        in "Memory: writes" { write_ready: 1 }
        in "High while a cast runs" { casting: 1 }
        in "High while no write is pending, open or without its response" { writes_done: 1 }
        in "High while a cache invalidates itself" { invalidating: 1 }
        in "Bus error: high for one cycle, with the address of the burst" { bus_error_valid: 1, bus_error_address: ADDRESS_BITS }
        out "Command list to start" { start_ready: 1 }
        out "Memory: bursts to read" { read: Flow<Burst>(1) }
        out "Memory: writes" { write: Flow<Word>() }
        out "Cast to start, while no cast runs" { cast_valid: 1, cast: {CastStart}() }
        out "Scene of the cast" { scene: {Arrays}(plan) }
        out "High while all open lines of the write combiner must be closed" { flush: 1 }
        out "High for one cycle to invalidate all caches, which are idle" { invalidate: 1 }
        out "High while a list runs" { running: 1 }
        out "High for one cycle at a signal that raises the interrupt" { signalled: 1 }
        out "High for one cycle at the end of a list" { ended: 1 }
        out "With ended: code 0, or why the list ended early, and where" { failure: {Failure}() }
    }
}

bundle! {
    /// The states, one bit each.
    struct States() {
        idle: 1,
        fetches: 1,
        receives: 1,
        decodes: 1,
        waits: 1,
        fetches_box: 1,
        receives_box: 1,
        signals: 1,
        drains: 1,
        flushes: 1,
        invalidates: 1,
    }
}

bundle! {
    /// What happens in a cycle besides the change of state.
    struct Steps() {
        cast_starts: 1,
        scene_starts: 1,
        box_arrives: 1,
        signal_taken: 1,
        asks_to_invalidate: 1,
        ended: 1,
        jumps: 1,
        /// The next descriptor follows.
        advances: 1,
    }
}

/// What a decoded descriptor is.
struct Decoded<'b> {
    is_scene: Signal<'b>,
    is_jump: Signal<'b>,
    is_signal: Signal<'b>,
    is_cast: Signal<'b>,
    is_end: Signal<'b>,
    /// Whether it is refused, with the code and the wrong value.
    fault: Signal<'b>,
    code: Signal<'b>,
    value: Signal<'b>,
}

/// Describes the command processor of a machine whose bus has `bus_bits` bits of data.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan, bus_bits: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "command_processor",
        "executes command lists: reads descriptors, sets the scene, starts casts, writes signals, and orders memory with fences.",
    );
    let ports = ports(plan, bus_bits);
    let inputs = ports.inputs.inputs(&m);
    m.comment("The state, one bit each.");
    let states = States::of().map(|name, _| {
        let name = name.to_string();
        m.reg_reset(&name, 1, u128::from(name == "idle"))
    });
    let now = states.map(|_, state| state.q);
    let starts = (now.idle & inputs.start_valid).named("starts");
    let beat = inputs.beat;
    let read_taken = ((now.fetches | now.fetches_box) & inputs.read_ready).named("read_taken");
    let last_beat = (beat.valid & beat.payload.last).named("last_beat");

    let words = stored_words(&m, bus_bits, &now, beat, read_taken);
    let has_scene = m.reg_reset("has_scene", 1, 0);
    let decoded = decode(&m, plan, &words, has_scene.q);
    let (code, value) = kept_error(&m, &inputs, starts, &now, &decoded);
    let is_bad = code.any().named("is_failed");
    let lists = Lists {
        m: &m,
        inputs: &inputs,
        starts,
        is_bad,
        decoded: &decoded,
    };
    let Followed {
        steps,
        begins,
        ends_list,
        asked,
    } = lists.follow(&states, read_taken, last_beat);
    has_scene.next(steps.box_arrives | has_scene.q);

    m.comment("The descriptor that is executed.");
    let place = m.reg("descriptor_address", ADDRESS_BITS);
    let next_place = place.q + m.lit(descriptor::BYTES, ADDRESS_BITS);
    place.next_when(
        starts | steps.jumps | steps.advances,
        m.priority(
            &[
                (starts, inputs.start_address),
                (steps.jumps, words[jump::word::to]),
            ],
            next_place,
        ),
    );

    let scene = scene_registers(&m, plan, &words, steps.scene_starts, steps.box_arrives);
    let beats = |bytes: u32| m.lit((8 * bytes).div_ceil(bus_bits) - 1, BEATS_BITS);
    let write = write_of_32_bits(
        words[signal::word::address],
        words[signal::word::address].bits(3, 2),
        words[signal::word::value],
    );
    let outputs = Outputs {
        start_ready: now.idle,
        read: Flow::new(
            now.fetches | now.fetches_box,
            Burst {
                address: now.fetches_box.mux(words[scene::word::bounds], place.q),
                beats: now
                    .fetches_box
                    .mux(beats(box_bytes(plan)), beats(descriptor::BYTES)),
                id: m.zero(1),
            },
        ),
        write: Flow::new(now.signals, write),
        cast_valid: steps.cast_starts,
        cast: cast_start(&m, &words),
        scene,
        flush: now.flushes,
        invalidate: steps.asks_to_invalidate,
        running: !now.idle,
        signalled: steps.signal_taken & flag(&words, signal::flag::interrupt),
        ended: steps.ended,
        failure: Failure {
            code,
            descriptor: place.q,
            value,
        },
    };
    ports.outputs.outputs(&m, outputs);
    properties::executes(&properties::Unit {
        m: &m,
        most: most_rays(&plan.config),
        inputs: &inputs,
        outputs: &outputs,
        states: &states,
        steps: &steps,
        decoded: &decoded,
        is_bad,
        code,
        value,
        place,
        has_scene,
        begins,
        ends_list,
        asked,
    });
    m.finish()
}

/// The code and the wrong value of the first error of a list: of its own address, of a refused descriptor, or of the bus.
fn kept_error<'b>(
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    starts: Signal<'b>,
    now: &States<Signal<'b>>,
    decoded: &Decoded<'b>,
) -> (Signal<'b>, Signal<'b>) {
    m.comment(
        "An error is kept until the list ends: of its address, or the first of a refused descriptor or of the bus.",
    );
    let code = m.reg("kept_code", CODE_BITS);
    let value = m.reg("kept_value", ADDRESS_BITS);
    let none = code.q.is_zero();
    let refused = (now.decodes & decoded.fault & none).named("refuses");
    let breaks = (inputs.bus_error_valid & none & !now.idle).named("bus_breaks");
    let bus_code = m.lit(Fault::BUS, CODE_BITS);
    let loads = (refused | breaks).named("failure_loads");
    let offset = descriptor::BYTES.ilog2();
    let is_odd = inputs.start_address.low(offset).any();
    let of_start = is_odd.mux(m.lit(Fault::ALIGNMENT, CODE_BITS), m.zero(CODE_BITS));
    code.next_when(
        starts | loads,
        starts.mux(of_start, breaks.mux(bus_code, decoded.code)),
    );
    let of_list = breaks.mux(inputs.bus_error_address, decoded.value);
    value.next_when(starts | loads, starts.mux(inputs.start_address, of_list));
    (code.q, value.q)
}

/// What happens, and what is known of the fence that is executed.
struct Followed<'b> {
    steps: Steps<Signal<'b>>,
    /// Whether the list begins with it; whether the list ends after it.
    begins: Reg<'b>,
    ends_list: Reg<'b>,
    /// Whether the caches have been asked to invalidate themselves.
    asked: Reg<'b>,
}

/// What the states of a list follow from.
struct Lists<'a, 'b> {
    m: &'b Builder,
    inputs: &'a Inputs<Signal<'b>>,
    starts: Signal<'b>,
    /// The list has had an error.
    is_bad: Signal<'b>,
    decoded: &'a Decoded<'b>,
}

impl<'b> Lists<'_, 'b> {
    /// Sets the next states.
    fn follow(
        &self,
        states: &States<Reg<'b>>,
        read_taken: Signal<'b>,
        last_beat: Signal<'b>,
    ) -> Followed<'b> {
        let Lists {
            m,
            inputs,
            starts,
            is_bad,
            decoded,
        } = *self;
        let now = states.map(|_, state| state.q);
        m.comment("Transitions.");
        let stops = (decoded.fault | is_bad).named("stops");
        let goes = (now.decodes & !stops).named("executes");
        let signal_taken = (now.signals & inputs.write_ready).named("signal_taken");
        let cast_free = (now.waits & !inputs.casting).named("cast_is_free");
        let cast_starts = (cast_free & decoded.is_cast).named("cast_starts");
        let scene_starts = (cast_free & decoded.is_scene).named("scene_starts");
        let box_arrives = (now.receives_box & last_beat).named("box_arrives");
        let asked = m.reg_reset("invalidation_asked", 1, 0);
        let drained = (now.drains & !inputs.casting).named("drained");
        let flushed = (now.flushes & inputs.writes_done).named("flushed");
        let invalidated = (now.invalidates & asked.q & !inputs.invalidating).named("invalidated");
        let begins = m.reg("begins", 1);
        begins.next_when(starts | invalidated, starts);
        let ends_list = m.reg("ends_list", 1);
        ends_list.next_when(starts | now.decodes, now.decodes & (decoded.is_end | stops));
        let is_over = (is_bad | (!begins.q & ends_list.q)).named("is_over");
        let ended = (invalidated & is_over).named("list_ends");
        let jumps = (goes & decoded.is_jump).named("jumps");
        let goes_on = invalidated & !begins.q & !is_over;
        let first = (invalidated & begins.q & !is_bad).named("reads_first");
        let advances = (signal_taken | cast_starts | box_arrives | goes_on).named("advances");
        let is_signal = (goes & decoded.is_signal).named("signal_starts");
        let needs_cast = (goes & (decoded.is_cast | decoded.is_scene)).named("needs_cast_unit");
        let asks = (now.invalidates & !asked.q).named("asks_to_invalidate");
        asked.next(asks | (asked.q & !invalidated));
        (states.idle).next(ended | (now.idle & !starts));
        (states.fetches).next(jumps | advances | first | (now.fetches & !read_taken));
        (states.receives).next((now.fetches & read_taken) | (now.receives & !last_beat));
        (states.decodes).next(now.receives & last_beat);
        (states.waits).next(needs_cast | (now.waits & inputs.casting));
        (states.fetches_box).next(scene_starts | (now.fetches_box & !read_taken));
        (states.receives_box)
            .next((now.fetches_box & read_taken) | (now.receives_box & !last_beat));
        (states.signals).next(is_signal | (now.signals & !signal_taken));
        (states.drains).next(
            (now.decodes & !jumps & !is_signal & !needs_cast) | (now.drains & inputs.casting),
        );
        (states.flushes).next(drained | (now.flushes & !flushed));
        (states.invalidates).next(starts | flushed | (now.invalidates & !invalidated));
        let steps = Steps {
            cast_starts,
            scene_starts,
            box_arrives,
            signal_taken,
            asks_to_invalidate: asks,
            ended,
            jumps,
            advances,
        };
        Followed {
            steps,
            begins,
            ends_list,
            asked,
        }
    }
}

/// The start of the cast of a stored descriptor.
fn cast_start<'b>(m: &'b Builder, words: &[Signal<'b>]) -> CastStart<Signal<'b>> {
    let short = flag(words, cast::flag::short_rays);
    let any_hit = flag(words, cast::flag::any_hit);
    let count = words[cast::word::count];
    let origin = (cast::word::origin_x..=cast::word::tmin).rev();
    let origin: Vec<_> = origin.map(|k| words[k]).collect();
    // At most 2^26 rays, of two words if they are not short.
    let one = count.low(WORD_ADDRESS_BITS - 1);
    let both = one.concat(m.zero(1));
    CastStart {
        rays_address: words[cast::word::rays],
        words: short.mux(one.extend(WORD_ADDRESS_BITS), both),
        cast: Cast {
            rays: Rays {
                count,
                any_hit,
                short,
                origin: m.concat(&origin),
            },
            hits: Hits {
                count,
                any_hit,
                address: words[cast::word::hits],
            },
        },
    }
}

/// Bytes of the box of a scene.
fn box_bytes(plan: &Plan) -> u32 {
    2 * ByteRecord::vertex(plan.format).bytes
}

fn flag<'b>(words: &[Signal<'b>], bit: u32) -> Signal<'b> {
    words[0].bit(8 + bit)
}

/// The first words of the burst that is received: of a descriptor, or of a box.
fn stored_words<'b>(
    m: &'b Builder,
    bus_bits: u32,
    now: &States<Signal<'b>>,
    beat: Flow<Beat<Signal<'b>>, Signal<'b>>,
    read_taken: Signal<'b>,
) -> Vec<Signal<'b>> {
    m.comment("The first 32 bytes of a descriptor; of a box, they replace it.");
    let per_beat = bus_bits / 32;
    let beats = bits_for(u64::from(descriptor::WORDS as u32 / per_beat).max(2));
    let number = m.reg("beat_number", beats);
    let arrives = ((now.receives | now.receives_box) & beat.valid).named("beat_arrives");
    let one = m.lit(1u8, beats);
    number.next_when(
        read_taken | arrives,
        read_taken.mux(m.zero(beats), number.q + one),
    );
    let mut selects: Vec<Signal<'b>> = vec![];
    (0..STORED)
        .map(|k| {
            let word = m.reg(format!("word{k}"), 32);
            let (of_beat, place) = (k / per_beat, k % per_beat);
            if selects.len() as u32 == of_beat {
                let is_beat = number.q.equals(of_beat.into());
                selects.push((arrives & is_beat).named(format!("beat{of_beat}_arrives")));
            }
            let selected = selects[of_beat as usize];
            word.next_when(selected, beat.payload.data.field(32 * place, 32));
            word.q
        })
        .collect()
}

/// Decodes the stored descriptor, and checks it.
fn decode<'b>(
    m: &'b Builder,
    plan: &Plan,
    words: &[Signal<'b>],
    has_scene: Signal<'b>,
) -> Decoded<'b> {
    m.comment("The command, and what is wrong with it.");
    let opcode = words[0].low(8).named("opcode");
    let is = |code: u32, name: &str| opcode.equals(code.into()).named(format!("is_{name}"));
    let is_end = is(end::OPCODE, "end");
    let is_jump = is(jump::OPCODE, "jump");
    let is_fence = is(fence::OPCODE, "fence");
    let is_signal = is(signal::OPCODE, "signal");
    let is_scene = is(scene::OPCODE, "scene");
    let is_cast = is(cast::OPCODE, "cast");
    let known = m
        .or_all(&[is_end, is_jump, is_fence, is_signal, is_scene, is_cast])
        .named("is_known");
    // The words that are addresses of a command, and the low bits that must be 0.
    let addresses = [
        (is_jump, jump::word::to, 6),
        (is_signal, signal::word::address, 2),
        (is_scene, scene::word::nodes, 6),
        (is_scene, scene::word::records, 6),
        (is_scene, scene::word::vertices, 6),
        (is_scene, scene::word::bounds, 6),
        (is_cast, cast::word::rays, 4),
        (is_cast, cast::word::hits, 6),
    ];
    let addresses: Vec<_> = (addresses.iter())
        .map(|&(of, word, bits)| (of & words[word].low(bits).any(), words[word]))
        .collect();
    let odd: Vec<_> = addresses.iter().map(|(is_odd, _)| *is_odd).collect();
    let is_odd = m.or_all(&odd).named("is_misaligned");
    let count = words[cast::word::count];
    let most = most_rays(&plan.config);
    let excess = count.gt(m.lit(most, 32));
    let is_size = (is_cast & (count.is_zero() | excess)).named("is_wrong_size");
    let without_scene = (is_cast & !has_scene).named("is_without_scene");
    let code = |code: u32| m.lit(code, CODE_BITS);
    let choices = [
        (!known, code(Fault::OPCODE)),
        (is_odd, code(Fault::ALIGNMENT)),
        (is_size, code(Fault::SIZE)),
    ];
    let mut values = vec![(!known, opcode.extend(ADDRESS_BITS))];
    values.extend(addresses);
    Decoded {
        is_scene,
        is_jump,
        is_signal,
        is_cast,
        is_end,
        fault: !known | is_odd | is_size | without_scene,
        code: m.priority(&choices, code(Fault::SCENE)).named("fault_code"),
        value: m.priority(&values, count).named("fault_value"),
    }
}

/// The registers of the scene: arrays when its command starts, the box when it arrives.
fn scene_registers<'b>(
    m: &'b Builder,
    plan: &Plan,
    words: &[Signal<'b>],
    starts: Signal<'b>,
    box_arrives: Signal<'b>,
) -> Arrays<Signal<'b>> {
    m.comment("The scene.");
    let register = |name: &str, word: usize| {
        let register = m.reg(format!("scene_{name}_address"), 32);
        register.next_when(starts, words[word]);
        register.q
    };
    let loads = m.reg("box_loads", 1);
    loads.next(box_arrives);
    let bytes: Vec<_> = words.iter().rev().copied().collect();
    let bytes = m.concat(&bytes);
    let layout = ByteRecord::vertex(plan.format);
    let corner = |name: &str, record: u32| -> [Signal<'b>; 3] {
        let mut place = 0;
        ["x", "y", "z"].map(|axis| {
            let part = layout.parts[place];
            place += 1;
            let at = 8 * (record * layout.bytes + part.offset);
            let register = m.reg(format!("box_{name}_{axis}"), plan.number());
            register.next_when(
                loads.q,
                plan.without_minus_zero(bytes.field(at, part.width)),
            );
            register.q
        })
    };
    Arrays {
        root: register("root", scene::word::root),
        nodes: register("nodes", scene::word::nodes),
        records: register("records", scene::word::records),
        vertices: register("vertices", scene::word::vertices),
        lo: corner("lo", 0),
        hi: corner("hi", 1),
    }
}
