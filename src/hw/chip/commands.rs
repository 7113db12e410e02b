//! The command processor: executes command lists.

mod properties;

use super::cast::Cast;
use super::hits::Hits;
use super::motion::Motion;
use super::rays::Rays;
use super::write_of_32_bits;
use crate::bkd::bytes::ByteRecord;
use crate::bkd::layout::Record;
use crate::chip::Limits;
use crate::chip::descriptor::{
    self, Fault, cast, end, fence, jump, scene, signal, skin, update, wait,
};
use crate::hdl::{Builder, Bundle, Flow, HdlError, Module, Reg, Signal, Specs, bits_for};
use crate::hw::memory::combiner::Word;
use crate::hw::memory::reader::WORD_ADDRESS_BITS;
use crate::hw::memory::{ADDRESS_BITS, BEATS_BITS, Beat, Burst};
use crate::hw::plan::Plan;
use crate::{bundle, interface};
use std::sync::Arc;

/// Words of a descriptor that any command has, from word 0 on.
const STORED: u32 = 9;

/// Cycles between two reads of a word that a list waits for: 2 to the power of this.
const REST_BITS: u32 = 6;

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
        in "High while a cast, a mesh or an update runs" { casting: 1, skinning: 1, updating: 1 }
        in "Mesh to skin or object to update" { motion_ready: 1 }
        in "High while no write is pending, open or without its response" { writes_done: 1 }
        in "High while a cache invalidates itself" { invalidating: 1 }
        in "Bus error: high for one cycle, with the address of the burst" { bus_error_valid: 1, bus_error_address: ADDRESS_BITS }
        out "Command list to start" { start_ready: 1 }
        out "Memory: bursts to read" { read: Flow<Burst>(1) }
        out "Memory: writes" { write: Flow<Word>() }
        out "Cast to start, while no cast runs" { cast_valid: 1, cast: {CastStart}() }
        out "Mesh to skin or object to update" { motion: Flow<Motion>(plan) }
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
        /// A list that waits for a word: writes what is open, reads the word, compares it, rests.
        publishes: 1,
        fetches_word: 1,
        receives_word: 1,
        compares: 1,
        rests: 1,
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
        motion_starts: 1,
        /// The word that a list waits for is read.
        word_arrives: 1,
        /// It is as great as asked.
        wait_ends: 1,
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
    is_wait: Signal<'b>,
    is_skin: Signal<'b>,
    is_update: Signal<'b>,
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
        "executes command lists: reads descriptors, sets the scene, starts casts, meshes and updates, writes signals, waits for words of memory, and \
         orders memory with fences.",
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
    let reads = m.or_all(&[now.fetches, now.fetches_box, now.fetches_word]);
    let read_taken = (reads & inputs.read_ready).named("read_taken");
    let last_beat = (beat.valid & beat.payload.last).named("last_beat");

    let words = stored_words(&m, bus_bits, &now, beat, read_taken);
    let has_scene = m.reg_reset("has_scene", 1, 0);
    let decoded = decode(&m, plan, &words, has_scene.q);
    let (code, value) = kept_error(&m, &inputs, starts, &now, &decoded);
    let is_bad = code.any().named("is_failed");
    let rest = m.reg_reset("rest_cycles", REST_BITS, 0);
    rest.next_when(now.rests, rest.q + m.lit(1u8, REST_BITS));
    let polled = polled_word(&m, bus_bits, &words, now.receives_word, beat);
    let lists = Lists {
        m: &m,
        inputs: &inputs,
        starts,
        is_bad,
        decoded: &decoded,
        is_reached: polled.ge(words[wait::word::value]).named("is_reached"),
        rested: rest.q.all().named("has_rested"),
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
    let write = write_of_32_bits(
        words[signal::word::address],
        words[signal::word::address].bits(3, 2),
        words[signal::word::value],
    );
    let outputs = Outputs {
        start_ready: now.idle,
        read: Flow::new(reads, burst(plan, bus_bits, &now, &words, place.q)),
        write: Flow::new(now.signals, write),
        cast_valid: steps.cast_starts,
        cast: cast_start(&m, &words),
        motion: Flow::new(
            now.waits & !lists.is_blocked() & (decoded.is_skin | decoded.is_update),
            motion(plan, &decoded, &words),
        ),
        scene,
        flush: now.flushes | now.publishes,
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
        beat_bits: beat_offset_bits(bus_bits),
        limits: Limits::of(&plan.config),
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
        is_reached: lists.is_reached,
        rest,
    });
    m.finish()
}

/// Bits of a byte's place in a beat.
fn beat_offset_bits(bus_bits: u32) -> u32 {
    (bus_bits / 8).ilog2()
}

/// The burst that is read: of a descriptor, of a box, or of the word that a list waits for.
fn burst<'b>(
    plan: &Plan,
    bus_bits: u32,
    now: &States<Signal<'b>>,
    words: &[Signal<'b>],
    place: Signal<'b>,
) -> Burst<Signal<'b>> {
    let m = place.module();
    let beats = |bytes: u32| m.lit((8 * bytes).div_ceil(bus_bits) - 1, BEATS_BITS);
    let offset = beat_offset_bits(bus_bits);
    let polled_beat = words[wait::word::address].high(ADDRESS_BITS - offset);
    let addresses = [
        (now.fetches_box, words[scene::word::bounds]),
        (now.fetches_word, polled_beat.concat(m.zero(offset))),
    ];
    let counts = [
        (now.fetches_box, beats(box_bytes(plan))),
        (now.fetches_word, m.zero(BEATS_BITS)),
    ];
    Burst {
        address: m.priority(&addresses, place),
        beats: m.priority(&counts, beats(descriptor::BYTES)),
        id: m.zero(1),
    }
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
    /// The word that was read is as great as the list waits for.
    is_reached: Signal<'b>,
    /// The time between two reads of it is over.
    rested: Signal<'b>,
}

impl<'b> Lists<'_, 'b> {
    /// Whether the units that the decoded command needs run.
    fn is_blocked(&self) -> Signal<'b> {
        let (of, decoded) = (self.inputs, self.decoded);
        let moves = of.skinning | of.updating;
        self.m.or_all(&[
            decoded.is_cast & (of.casting | of.skinning),
            decoded.is_scene & of.casting,
            decoded.is_skin & (of.casting | moves),
            decoded.is_update & moves,
        ])
    }

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
            is_reached,
            rested,
        } = *self;
        let now = states.map(|_, state| state.q);
        m.comment("Transitions.");
        let stops = (decoded.fault | is_bad).named("stops");
        let goes = (now.decodes & !stops).named("executes");
        let signal_taken = (now.signals & inputs.write_ready).named("signal_taken");
        let is_free = (now.waits & !self.is_blocked()).named("units_are_free");
        let cast_starts = (is_free & decoded.is_cast).named("cast_starts");
        let scene_starts = (is_free & decoded.is_scene).named("scene_starts");
        let is_motion = decoded.is_skin | decoded.is_update;
        let motion_starts = (is_free & is_motion & inputs.motion_ready).named("motion_starts");
        let stays = now.waits & !(cast_starts | scene_starts | motion_starts);
        let box_arrives = (now.receives_box & last_beat).named("box_arrives");
        let asked = m.reg_reset("invalidation_asked", 1, 0);
        let runs = (inputs.casting | inputs.skinning | inputs.updating).named("units_run");
        let drained = (now.drains & !runs).named("drained");
        let published = (now.publishes & inputs.writes_done).named("published");
        let word_arrives = (now.receives_word & last_beat).named("word_arrives");
        let wait_ends = (now.compares & (is_reached | is_bad)).named("wait_ends");
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
        let advances = m
            .or_all(&[
                signal_taken,
                cast_starts,
                motion_starts,
                box_arrives,
                wait_ends,
                goes_on,
            ])
            .named("advances");
        let is_signal = (goes & decoded.is_signal).named("signal_starts");
        let is_wait = (goes & decoded.is_wait).named("wait_starts");
        let of_unit = decoded.is_cast | decoded.is_scene | is_motion;
        let needs_unit = (goes & of_unit).named("needs_a_unit");
        let asks = (now.invalidates & !asked.q).named("asks_to_invalidate");
        asked.next(asks | (asked.q & !invalidated));
        (states.idle).next(ended | (now.idle & !starts));
        (states.fetches).next(jumps | advances | first | (now.fetches & !read_taken));
        (states.receives).next((now.fetches & read_taken) | (now.receives & !last_beat));
        (states.decodes).next(now.receives & last_beat);
        (states.waits).next(needs_unit | stays);
        (states.fetches_box).next(scene_starts | (now.fetches_box & !read_taken));
        (states.receives_box)
            .next((now.fetches_box & read_taken) | (now.receives_box & !last_beat));
        (states.signals).next(is_signal | (now.signals & !signal_taken));
        (states.publishes).next(is_wait | (now.publishes & !published));
        let polls = published | (now.rests & rested);
        (states.fetches_word).next(polls | (now.fetches_word & !read_taken));
        (states.receives_word)
            .next((now.fetches_word & read_taken) | (now.receives_word & !last_beat));
        (states.compares).next(word_arrives);
        (states.rests).next((now.compares & !wait_ends) | (now.rests & !rested));
        let others = jumps | is_signal | is_wait | needs_unit;
        (states.drains).next((now.decodes & !others) | (now.drains & runs));
        (states.flushes).next(drained | (now.flushes & !flushed));
        (states.invalidates).next(starts | flushed | (now.invalidates & !invalidated));
        let steps = Steps {
            cast_starts,
            scene_starts,
            box_arrives,
            signal_taken,
            motion_starts,
            word_arrives,
            wait_ends,
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

/// The mesh or the object of a stored descriptor.
fn motion<'b>(plan: &Plan, decoded: &Decoded<'b>, words: &[Signal<'b>]) -> Motion<Signal<'b>> {
    use {skin::word as of_skin, update::word as of_update};
    let is_update = decoded.is_update;
    let either = |of_update: usize, of_skin: usize| is_update.mux(words[of_update], words[of_skin]);
    let index = |word: usize| words[word].low(plan.address());
    Motion {
        is_update,
        vertices: either(of_update::vertices, of_skin::vertices),
        nodes: words[of_update::nodes],
        bounds: words[of_update::bounds],
        rows_address: either(of_update::program, of_skin::influences),
        rows: either(of_update::rows, of_skin::rows).low(plan.address()),
        palette: index(of_skin::palette),
        joints: words[of_skin::joints].low(Motion::of(plan).joints.width),
        rest: index(of_skin::rest),
        count: index(of_skin::count),
        target: index(of_skin::target),
        first_vertex: index(of_update::first_vertex),
        first_node: index(of_update::first_node),
    }
}

/// The word that a list waits for, when its beat has arrived.
fn polled_word<'b>(
    m: &'b Builder,
    bus_bits: u32,
    words: &[Signal<'b>],
    receives: Signal<'b>,
    beat: Flow<Beat<Signal<'b>>, Signal<'b>>,
) -> Signal<'b> {
    m.comment("The word that the list waits for.");
    let polled = m.reg("polled_word", 32);
    let data = beat.payload.data;
    let word = match bus_bits / 32 {
        1 => data,
        count => {
            let place = words[wait::word::address].field(2, count.ilog2());
            let choices: Vec<_> = (0..count - 1)
                .map(|k| (place.equals(k.into()), data.field(32 * k, 32)))
                .collect();
            m.priority(&choices, data.field(32 * (count - 1), 32))
        }
    };
    polled.next_when(receives & beat.valid, word);
    polled.q
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
    m.comment("The first words of a descriptor; those of a box replace them.");
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
    let is_wait = is(wait::OPCODE, "wait");
    let is_scene = is(scene::OPCODE, "scene");
    let is_cast = is(cast::OPCODE, "cast");
    let is_skin = is(skin::OPCODE, "skin");
    let is_update = is(update::OPCODE, "update_command");
    let known = [
        is_end, is_jump, is_fence, is_signal, is_wait, is_scene, is_cast, is_skin, is_update,
    ];
    let known = m.or_all(&known).named("is_known");
    // The words that are addresses of a command, and the low bits that must be 0.
    let corner_bits = box_bytes(plan).ilog2();
    let addresses = [
        (is_jump, jump::word::to, 6),
        (is_signal, signal::word::address, 2),
        (is_wait, wait::word::address, 2),
        (is_scene, scene::word::nodes, 6),
        (is_scene, scene::word::records, 6),
        (is_scene, scene::word::vertices, 6),
        (is_scene, scene::word::bounds, 6),
        (is_cast, cast::word::rays, 4),
        (is_cast, cast::word::hits, 6),
        (is_skin, skin::word::vertices, 6),
        (is_skin, skin::word::influences, 4),
        (is_update, update::word::program, 4),
        (is_update, update::word::vertices, 6),
        (is_update, update::word::nodes, 6),
        (is_update, update::word::bounds, corner_bits),
    ];
    let addresses: Vec<_> = (addresses.iter())
        .map(|&(of, word, bits)| (of & words[word].low(bits).any(), words[word]))
        .collect();
    let sizes = sizes(m, plan, words, is_cast, is_skin, is_update);
    let any = |of: &[(Signal<'b>, Signal<'b>)]| {
        let wrong: Vec<_> = of.iter().map(|(is_wrong, _)| *is_wrong).collect();
        m.or_all(&wrong)
    };
    let is_odd = any(&addresses).named("is_misaligned");
    let is_size = any(&sizes).named("is_wrong_size");
    let without_scene = (is_cast & !has_scene).named("is_without_scene");
    let code = |code: u32| m.lit(code, CODE_BITS);
    let choices = [
        (!known, code(Fault::OPCODE)),
        (is_odd, code(Fault::ALIGNMENT)),
        (is_size, code(Fault::SIZE)),
    ];
    let mut values = vec![(!known, opcode.extend(ADDRESS_BITS))];
    values.extend(addresses);
    values.extend(sizes);
    Decoded {
        is_scene,
        is_jump,
        is_signal,
        is_cast,
        is_end,
        is_wait,
        is_skin,
        is_update,
        fault: !known | is_odd | is_size | without_scene,
        code: m.priority(&choices, code(Fault::SCENE)).named("fault_code"),
        value: m
            .priority(&values, words[cast::word::count])
            .named("fault_value"),
    }
}

/// The words that are counts or indices of a command, and whether they are out of range.
fn sizes<'b>(
    m: &'b Builder,
    plan: &Plan,
    words: &[Signal<'b>],
    is_cast: Signal<'b>,
    is_skin: Signal<'b>,
    is_update: Signal<'b>,
) -> Vec<(Signal<'b>, Signal<'b>)> {
    let limits = Limits::of(&plan.config);
    let most = |word: usize, most: u32| words[word].gt(m.lit(most, 32));
    let large = |word: usize| words[word].high(32 - plan.address()).any();
    let none = |word: usize| words[word].is_zero();
    let count = cast::word::count;
    let of_cast = [(count, none(count) | most(count, limits.rays))];
    let of_skin = {
        use skin::word::{count, joints, palette, rest, rows, target};
        [
            (palette, large(palette)),
            (joints, none(joints) | most(joints, limits.joints)),
            (rows, none(rows) | large(rows)),
            (rest, large(rest)),
            (count, none(count) | large(count)),
            (target, large(target)),
        ]
    };
    let of_update = {
        use update::word::{first_node, first_vertex, rows};
        [
            (rows, none(rows) | large(rows)),
            (first_vertex, large(first_vertex)),
            (first_node, large(first_node)),
        ]
    };
    let of = |is: Signal<'b>, (word, wrong): (usize, Signal<'b>)| (is & wrong, words[word]);
    let of_cast = of_cast.into_iter().map(|size| of(is_cast, size));
    let of_skin = of_skin.into_iter().map(|size| of(is_skin, size));
    let of_update = of_update.into_iter().map(|size| of(is_update, size));
    of_cast.chain(of_skin).chain(of_update).collect()
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
