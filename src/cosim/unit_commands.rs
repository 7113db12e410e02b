//! The chip's command processor alone: random command lists, with every neighbour played at random.
//!
//! Descriptors are made when they are read. The bench follows the list as `docs/chip.md` says, and knows in each cycle the one thing that may
//! happen next: a burst, a write, a cast, a flush, an invalidation or the end. Anything else is a mismatch, and so is that thing if it comes
//! while the page says that it waits, or does not come although nothing is waited for. Casts, write responses, invalidations and
//! errors of the bus take any time.

use super::mismatch::Field;
use super::model::PortHandle;
use super::scoreboard::{Bench, Category, RESET_CYCLES, UnitOptions, UnitReport};
use crate::bkd::bytes::ByteRecord;
use crate::chip::Limits;
use crate::chip::descriptor::{self, Cast, Command, Fault, Scene, Skin, Update, WORDS};
use crate::config::Config;
use crate::float::{Format, specials};
use crate::hdl::{self, Bundle};
use crate::hw::Plan;
use crate::hw::chip::commands::{Inputs, Outputs, module, ports};
use crate::hw::chip::motion::Motion;
use anyhow::Result;

/// What the unit can meet: descriptors, unless said otherwise.
pub const CATEGORIES: &[Category] = &[
    Category::EndCommand,
    Category::JumpCommand,
    Category::FenceCommand,
    Category::SignalCommand,
    Category::SceneCommand,
    Category::CastCommand,
    Category::WaitCommand,
    Category::SkinCommand,
    Category::UpdateCommand,
    Category::WrongOpcode,
    Category::Misaligned,
    Category::WrongSize,
    Category::WithoutScene,
    Category::MisalignedList,
    Category::BusError,
    Category::ErrorAtCheck,
    Category::ErrorInFence,
    Category::WaitsForCast,
    Category::UnderCast,
    Category::WaitsForMotion,
    Category::UpdateUnderCast,
    Category::WaitsOn,
    Category::WaitsForWrites,
    // A cycle in which a write waits.
    Category::WaitingWrite,
    Category::CutShort,
];

/// The machine that is simulated by default: the reference with casts of as many rays as any machine has.
pub fn reference() -> Config {
    Config {
        tag_bits: 24,
        ..Config::reference()
    }
}

/// Cycles within which the unit goes on when it waits for nothing.
const SOON: u32 = 4;

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// The least and the greatest corner of a box: x, y, z each.
type Corners = [u64; 6];

/// What may happen next.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Next {
    /// A list is started.
    Start,
    /// The caches are invalidated; then they are waited for.
    Invalidate,
    Invalidated,
    /// A descriptor is read; its beats come; it is checked.
    Descriptor,
    DescriptorBeat(u32),
    Check,
    /// A box is read; its beats come.
    Box(Scene),
    BoxBeat(Scene, u32),
    Signal,
    Cast(Cast),
    /// A mesh or an update starts.
    Skin(Skin),
    Update(Update),
    /// Of a list that waits: what is open is written, the word is read, compared, and read again after a pause.
    Publish(Awaited),
    Published(Awaited),
    Poll(Awaited),
    PollBeat(Awaited, u32),
    Compare(Awaited, u32),
    Rest(Awaited, u32),
    /// Lines are closed, until all is written.
    Flush,
    Flushed,
}

/// A word that a list waits for: its address, and the least value.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Awaited {
    address: u32,
    value: u32,
}

/// Cycles between two reads of it, as `docs/chip.md` says.
const REST: u32 = 64;

/// What the list has come to.
struct List {
    next: Next,
    /// Cycles in which the next thing could have happened.
    waited: u32,
    /// The address and the words of the descriptor that is read or executed.
    at: u32,
    words: [u32; WORDS],
    /// The words of the box that is read.
    corners: Vec<u32>,
    error: Option<Fault>,
    /// Whether the list ends after the fence that is executed; whether it begins with it.
    ends: bool,
    begins: bool,
    /// The scene that was set last.
    scene: Option<(Scene, Corners)>,
    /// Descriptors until the list ends.
    left: u32,
    /// Whether an offered burst or write has been refused, and must stay.
    is_offered: bool,
}

/// The neighbours of the unit.
#[derive(Default)]
struct Around {
    /// The list that waits to be started.
    start: Option<u32>,
    /// Cycles of the cast, of the mesh and of the update that run.
    casting: u32,
    skinning: u32,
    updating: u32,
    /// Whether a word is on its way to memory.
    writes: bool,
    /// Cycles until all caches are invalidated.
    invalidating: u32,
}

/// Probabilities of pauses, and the greatest lengths.
struct Pace {
    start: f64,
    read: f64,
    beat: f64,
    write: f64,
    responses: f64,
    longest_cast: u32,
    sets: u32,
    errors: f64,
    /// Descriptors of a list, and the share of wrong ones.
    descriptors: u32,
    wrong: f64,
}

impl Pace {
    fn random(rng: &mut fastrand::Rng) -> Pace {
        let mut pause = || [0.0, 0.0, 0.4, 0.9][rng.usize(..4)];
        Pace {
            start: pause(),
            read: pause(),
            beat: pause(),
            write: pause(),
            responses: pause(),
            longest_cast: [1, 10, 100, 1000][rng.usize(..4)],
            sets: [1, 3, 40][rng.usize(..3)],
            errors: [0.0, 0.0, 0.02, 0.1][rng.usize(..4)],
            descriptors: [2, 10, 60][rng.usize(..3)],
            wrong: [0.0, 0.05, 0.3][rng.usize(..3)],
        }
    }
}

/// What the bench gives in a cycle.
#[derive(Clone, Copy)]
struct Given {
    start: bool,
    read_ready: bool,
    /// The words of the beat, and whether it is the last.
    beat: Option<bool>,
    write_ready: bool,
    casting: bool,
    skinning: bool,
    updating: bool,
    motion_ready: bool,
    writes_done: bool,
    invalidating: bool,
    bus_error: Option<u32>,
}

/// What the unit shows in a cycle, besides what it offers with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Shown {
    start_ready: bool,
    running: bool,
    read: bool,
    write: bool,
    cast: bool,
    motion: bool,
    flush: bool,
    invalidate: bool,
    signalled: bool,
    ended: bool,
}

impl Given {
    fn moves(&self) -> bool {
        self.skinning || self.updating
    }
}

impl Shown {
    /// Nothing, while a list runs or not.
    fn none(running: bool) -> Shown {
        Shown {
            start_ready: !running,
            running,
            read: false,
            write: false,
            cast: false,
            motion: false,
            flush: false,
            invalidate: false,
            signalled: false,
            ended: false,
        }
    }

    fn fields(&self, rtl: &Shown) -> Vec<Field> {
        let bits = |shown: &Shown| {
            [
                shown.start_ready,
                shown.running,
                shown.read,
                shown.write,
                shown.cast,
                shown.motion,
                shown.flush,
                shown.invalidate,
                shown.signalled,
                shown.ended,
            ]
        };
        let names = [
            "start ready",
            "running",
            "read",
            "write",
            "cast",
            "motion",
            "flush",
            "invalidate",
            "signalled",
            "ended",
        ];
        let both = bits(self).into_iter().zip(bits(rtl));
        names
            .into_iter()
            .zip(both)
            .map(|(name, (golden, rtl))| Field::integer(name, golden.into(), rtl.into()))
            .collect()
    }
}

struct Run {
    bench: Bench,
    ports: Ports,
    rng: fastrand::Rng,
    format: Format,
    limits: Limits,
    /// Words of 32 bits in a beat.
    beat_words: usize,
    list: List,
    around: Around,
    pace: Pace,
}

/// Co-simulates the command processor of a machine with at least `descriptors` descriptors.
///
/// # Errors
/// A tool that is missing. A mismatch is no error here: it is in the report.
pub fn run(config: &Config, descriptors: u64, options: &UnitOptions) -> Result<UnitReport> {
    let plan = Plan::new(config)?;
    let bus_bits = config.bus_data_bits;
    let mut bench = Bench::new("commands", &module(&plan, bus_bits)?, options)?;
    let ports = bench.model.ports(&ports(&plan, bus_bits))?;
    bench.model.reset(RESET_CYCLES);
    let mut rng = fastrand::Rng::with_seed(options.seed);
    let mut run = Run {
        bench,
        ports,
        format: config.format(),
        limits: Limits::of(config),
        beat_words: bus_bits as usize / 32,
        list: List::new(),
        around: Around::default(),
        pace: Pace::random(&mut rng),
        rng,
    };
    let ended = run.all(descriptors);
    run.bench.report(ended, CATEGORIES)
}

impl List {
    /// What is there after a reset.
    fn new() -> List {
        List {
            next: Next::Start,
            waited: 0,
            at: 0,
            words: [0; WORDS],
            corners: vec![],
            error: None,
            ends: false,
            begins: false,
            scene: None,
            left: 0,
            is_offered: false,
        }
    }

    fn goes_to(&mut self, next: Next) {
        self.next = next;
        self.waited = 0;
        self.is_offered = false;
    }

    /// The next descriptor follows.
    fn advances(&mut self) {
        self.at = self.at.wrapping_add(descriptor::BYTES);
        self.goes_to(Next::Descriptor);
    }

    /// Whether the list is over when the caches are invalidated.
    fn is_over(&self) -> bool {
        self.error.is_some() || (!self.begins && self.ends)
    }
}

impl Run {
    fn all(&mut self, descriptors: u64) -> Result<()> {
        self.around.invalidating = self.rng.u32(..=self.pace.sets);
        let mut until_reset = u64::MAX;
        while self.bench.tally.transactions < descriptors {
            if until_reset == 0 {
                // The neighbours do not know of it.
                let given = self.give();
                self.show(&given);
                self.bench.model.reset(RESET_CYCLES);
                self.bench.tally.categories.count(Category::CutShort, true);
                self.list = List::new();
                // After a reset the caches invalidate themselves.
                self.around = Around {
                    invalidating: self.rng.u32(..=self.pace.sets),
                    ..Around::default()
                };
            }
            until_reset = until_reset.wrapping_sub(1);
            let starts = self.cycle()?;
            if starts {
                self.pace = Pace::random(&mut self.rng);
                self.list.left = self.rng.u32(..self.pace.descriptors);
                until_reset = match self.rng.u8(..16) {
                    0 => self.rng.u64(..1000),
                    _ => u64::MAX,
                };
            }
        }
        Ok(())
    }

    /// One cycle; whether a list starts.
    fn cycle(&mut self) -> Result<bool> {
        let given = self.give();
        self.show(&given);
        self.bench.model.eval();
        let shown = self.shown();
        let wanted = self.wanted(&given, &shown);
        if shown != wanted {
            let place = format!(
                "{:?} of the descriptor at {:#x}",
                self.list.next, self.list.at
            );
            let fields = wanted.fields(&shown);
            return Err(self.bench.mismatch(place, fields));
        }
        self.check_payloads(&given, &shown)?;
        let starts = given.start && shown.start_ready;
        self.follow(&given, &shown);
        self.go_on(&given, &shown);
        self.bench.model.clock();
        Ok(starts)
    }

    /// What the neighbours do in this cycle.
    fn give(&mut self) -> Given {
        let (rng, pace, around, list) = (&mut self.rng, &self.pace, &mut self.around, &self.list);
        if around.start.is_none() && rng.f64() >= pace.start {
            let address = match rng.u8(..16) {
                0 => rng.u32(..) | 1 << rng.u32(..6),
                1 => !63,
                _ => rng.u32(..) & !63,
            };
            around.start = Some(address);
        }
        let per_box = 2 * ByteRecord::vertex(self.format).bytes as usize / 4;
        let beats = |words: usize| words.div_ceil(self.beat_words) as u32;
        let beat = match list.next {
            Next::DescriptorBeat(number) => Some(number + 1 == beats(WORDS)),
            Next::BoxBeat(_, number) => Some(number + 1 == beats(per_box)),
            Next::PollBeat(..) => Some(true),
            _ => None,
        };
        // An error of the bus comes while bursts can be on their way, or in the idle state, where it belongs to no list.
        let may_fail = match list.next {
            Next::Start => true,
            Next::Invalidate | Next::Invalidated => false,
            Next::Flush | Next::Flushed => {
                around.writes || around.casting.max(around.skinning).max(around.updating) > 0
            }
            _ => true,
        };
        Given {
            start: around.start.is_some(),
            read_ready: rng.f64() >= pace.read,
            beat: beat.filter(|_| rng.f64() >= pace.beat),
            write_ready: rng.f64() >= pace.write,
            casting: around.casting > 0,
            skinning: around.skinning > 0,
            updating: around.updating > 0,
            motion_ready: rng.f64() >= pace.start,
            writes_done: !around.writes,
            invalidating: around.invalidating > 0,
            bus_error: (may_fail && rng.f64() < pace.errors).then(|| rng.u32(..)),
        }
    }

    /// Sets the inputs for the coming edge.
    fn show(&mut self, given: &Given) {
        let (model, rng, inputs) = (&mut self.bench.model, &mut self.rng, self.ports.inputs);
        model.set(inputs.start_valid, given.start.into());
        match self.around.start {
            Some(address) => model.set(inputs.start_address, address.into()),
            None => model.garble([inputs.start_address], rng),
        }
        model.set(inputs.read_ready, given.read_ready.into());
        let payload = inputs.beat.payload;
        model.set(inputs.beat.valid, given.beat.is_some().into());
        model.garble(payload.leaves(), rng);
        if let Some(last) = given.beat {
            let polled;
            let (words, number) = match self.list.next {
                Next::DescriptorBeat(number) => (&self.list.words[..], number),
                Next::BoxBeat(_, number) => (&self.list.corners[..], number),
                Next::PollBeat(awaited, found) => {
                    let mut words = vec![!found; self.beat_words];
                    words[awaited.address as usize / 4 % self.beat_words] = found;
                    polled = words;
                    (&polled[..], 0)
                }
                _ => unreachable!("beats come only in these three"),
            };
            let words = words.chunks(self.beat_words).nth(number as usize);
            model.set_words(payload.data, words.expect("a beat of the burst"));
            model.set(payload.last, last.into());
        }
        model.set(inputs.write_ready, given.write_ready.into());
        model.set(inputs.casting, given.casting.into());
        model.set(inputs.skinning, given.skinning.into());
        model.set(inputs.updating, given.updating.into());
        model.set(inputs.motion_ready, given.motion_ready.into());
        model.set(inputs.writes_done, given.writes_done.into());
        model.set(inputs.invalidating, given.invalidating.into());
        model.set(inputs.bus_error_valid, given.bus_error.is_some().into());
        match given.bus_error {
            Some(address) => model.set(inputs.bus_error_address, address.into()),
            None => model.garble([inputs.bus_error_address], rng),
        }
    }

    fn shown(&self) -> Shown {
        let (model, outputs) = (&self.bench.model, &self.ports.outputs);
        let bit = |port| model.get(port) != 0;
        Shown {
            start_ready: bit(outputs.start_ready),
            running: bit(outputs.running),
            read: bit(outputs.read.valid),
            write: bit(outputs.write.valid),
            cast: bit(outputs.cast_valid),
            motion: bit(outputs.motion.valid),
            flush: bit(outputs.flush),
            invalidate: bit(outputs.invalidate),
            signalled: bit(outputs.signalled),
            ended: bit(outputs.ended),
        }
    }

    /// What must be shown in this cycle. The unit may take its time for what comes next, but not for ever.
    fn wanted(&mut self, given: &Given, shown: &Shown) -> Shown {
        let list = &mut self.list;
        let mut wanted = Shown::none(list.next != Next::Start);
        // Whether the next thing may happen, and whether it does.
        let (may, does) = match list.next {
            Next::Start
            | Next::DescriptorBeat(_)
            | Next::BoxBeat(..)
            | Next::Check
            | Next::PollBeat(..)
            | Next::Compare(..)
            | Next::Rest(..) => {
                return wanted;
            }
            Next::Descriptor => (true, shown.read),
            Next::Box(_) => (!given.casting, shown.read),
            Next::Signal => (true, shown.write),
            Next::Cast(_) => (!given.casting && !given.skinning, shown.cast),
            Next::Skin(_) => (!given.casting && !given.moves(), shown.motion),
            Next::Update(_) => (!given.moves(), shown.motion),
            Next::Publish(_) => (true, shown.flush),
            Next::Poll(_) => (true, shown.read),
            Next::Flush => (!given.casting && !given.moves(), shown.flush),
            Next::Flushed | Next::Published(_) => {
                wanted.flush = true;
                return wanted;
            }
            Next::Invalidate => (true, shown.invalidate),
            Next::Invalidated => {
                let does = match list.is_over() {
                    true => shown.ended,
                    false => shown.read,
                };
                (!given.invalidating, does)
            }
        };
        list.waited += u32::from(may && !does);
        let happens = may && (does || list.waited > SOON || list.is_offered);
        match list.next {
            Next::Invalidated if list.is_over() => wanted.ended = happens,
            Next::Descriptor | Next::Box(_) | Next::Poll(_) | Next::Invalidated => {
                wanted.read = happens;
            }
            Next::Cast(_) => wanted.cast = happens,
            Next::Skin(_) | Next::Update(_) => wanted.motion = happens,
            Next::Flush | Next::Publish(_) => wanted.flush = happens,
            Next::Invalidate => wanted.invalidate = happens,
            _ => {
                wanted.write = happens;
                let flag = list.words[0] >> (8 + descriptor::signal::flag::interrupt) & 1;
                wanted.signalled = happens && given.write_ready && flag != 0;
            }
        }
        wanted
    }

    /// Compares what is offered with what happens.
    fn check_payloads(&mut self, given: &Given, shown: &Shown) -> Result<()> {
        let outputs = &self.ports.outputs;
        let list = &self.list;
        let beats = |bytes: u32| u64::from(bytes.div_ceil(4 * self.beat_words as u32)) - 1;
        let mut wanted: Vec<(&str, u64, PortHandle)> = vec![];
        if shown.read {
            let (address, bytes) = match list.next {
                Next::Box(scene) => (scene.bounds, 2 * ByteRecord::vertex(self.format).bytes),
                Next::Poll(awaited) => {
                    let bytes = 4 * self.beat_words as u32;
                    (awaited.address & !(bytes - 1), bytes)
                }
                // What follows a fence.
                Next::Invalidated if !list.begins => {
                    (list.at.wrapping_add(descriptor::BYTES), descriptor::BYTES)
                }
                _ => (list.at, descriptor::BYTES),
            };
            wanted.push(("address", address.into(), outputs.read.payload.address));
            wanted.push(("beats", beats(bytes), outputs.read.payload.beats));
            wanted.push(("identifier", 0, outputs.read.payload.id));
        }
        if shown.ended {
            let code = list.error.map_or(0, |fault| fault.code);
            wanted.push(("code", code.into(), outputs.failure.code));
            if let Some(fault) = list.error {
                wanted.push(("descriptor", list.at.into(), outputs.failure.descriptor));
                wanted.push(("value", fault.value.into(), outputs.failure.value));
            }
        }
        if let (Next::Cast(cast), true) = (list.next, shown.cast) {
            let words = cast.count * cast.ray_bytes() as u32 / 16;
            let (rays, hits) = (outputs.cast.cast.rays, outputs.cast.cast.hits);
            wanted.extend([
                ("rays", u64::from(cast.rays), outputs.cast.rays_address),
                ("words", words.into(), outputs.cast.words),
                ("rays, count", cast.count.into(), rays.count),
                ("hits, count", cast.count.into(), hits.count),
                ("rays, any hit", cast.any_hit.into(), rays.any_hit),
                ("hits, any hit", cast.any_hit.into(), hits.any_hit),
                ("short", cast.short.is_some().into(), rays.short),
                ("hits", cast.hits.into(), hits.address),
            ]);
        }
        if shown.motion {
            wanted.extend(motion(list.next, &outputs.motion.payload));
        }
        if (shown.cast || given.casting)
            && let Some((scene, corners)) = &list.scene
        {
            let ports = &outputs.scene;
            wanted.extend([
                ("root", u64::from(scene.root), ports.root),
                ("nodes", scene.nodes.into(), ports.nodes),
                ("records", scene.records.into(), ports.records),
                ("vertices", scene.vertices.into(), ports.vertices),
            ]);
            let ports = ports.lo.into_iter().chain(ports.hi);
            wanted.extend(
                corners
                    .iter()
                    .zip(ports)
                    .map(|(x, port)| ("corner", *x, port)),
            );
        }
        let place = format!("{:?} of the descriptor at {:#x}", list.next, list.at);
        self.bench.compare(place, &wanted)?;
        self.bench.tally.checked += wanted.len() as u64;
        self.check_wide(shown)
    }

    /// Compares what has more than 64 bits: the origin of short rays, and a write.
    fn check_wide(&mut self, shown: &Shown) -> Result<()> {
        let outputs = &self.ports.outputs;
        let (model, list) = (&self.bench.model, &self.list);
        if let (Next::Cast(cast), true) = (list.next, shown.cast)
            && let Some((origin, tmin)) = cast.short
        {
            let golden = [origin[0], origin[1], origin[2], tmin].map(f32::to_bits);
            let mut rtl = [0; 4];
            model.get_words(outputs.cast.cast.rays.origin, &mut rtl);
            if golden != rtl {
                let place = format!("origin and tmin: golden {golden:x?}, rtl {rtl:x?}");
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        if shown.write {
            use descriptor::signal::word;
            let (address, value) = (list.words[word::address], list.words[word::value]);
            let lane = address as usize / 4 % 4;
            let port = &outputs.write.payload;
            let mut data = [0; 4];
            model.get_words(port.data, &mut data);
            let fields = vec![
                Field::integer("address", (address & !15).into(), model.get(port.address)),
                Field::integer("strobes", 15 << (4 * lane), model.get(port.strobes)),
                Field::integer("value", value.into(), data[lane].into()),
            ];
            if fields.iter().any(Field::differs) {
                return Err(self.bench.mismatch("the word of a signal", fields));
            }
        }
        Ok(())
    }

    /// Follows the list by what happens in this cycle.
    fn follow(&mut self, given: &Given, shown: &Shown) {
        let before = self.list.error;
        let next = self.list.next;
        if next != Next::Start && before.is_none() {
            self.list.error = given.bus_error.map(|value| Fault {
                code: Fault::BUS,
                value,
            });
            self.count_error(given);
        }
        let list = &mut self.list;
        match next {
            Next::Start if given.start => self.start(),
            Next::Descriptor if shown.read => self.read(given, Next::Descriptor),
            Next::Invalidated if shown.read => {
                if !list.begins {
                    list.at = list.at.wrapping_add(descriptor::BYTES);
                }
                list.begins = false;
                self.read(given, Next::Descriptor);
            }
            Next::Box(scene) if shown.read => self.read(given, Next::Box(scene)),
            Next::DescriptorBeat(number) if given.beat.is_some() => {
                let last = given.beat == Some(true);
                let next = Next::DescriptorBeat(number + 1);
                list.goes_to(if last { Next::Check } else { next });
            }
            Next::BoxBeat(scene, number) if given.beat.is_some() => match given.beat {
                Some(true) => {
                    list.scene = Some((scene, corners(self.format, &list.corners)));
                    list.advances();
                }
                _ => list.goes_to(Next::BoxBeat(scene, number + 1)),
            },
            Next::Check => self.decode(before, given.bus_error),
            Next::Signal if shown.write => match given.write_ready {
                true => list.advances(),
                false => {
                    list.is_offered = true;
                    let categories = &mut self.bench.tally.categories;
                    categories.count(Category::WaitingWrite, true);
                }
            },
            Next::Cast(_) if shown.cast => list.advances(),
            Next::Skin(_) | Next::Update(_) if shown.motion => match given.motion_ready {
                true => list.advances(),
                false => list.is_offered = true,
            },
            Next::Publish(awaited) | Next::Published(awaited) if shown.flush => {
                list.goes_to(match given.writes_done {
                    true => Next::Poll(awaited),
                    false => Next::Published(awaited),
                });
            }
            Next::Poll(_) if shown.read => self.read(given, next),
            Next::PollBeat(awaited, found) if given.beat.is_some() => {
                list.goes_to(Next::Compare(awaited, found));
            }
            Next::Compare(awaited, found) => {
                let ends = found >= awaited.value || before.is_some();
                let categories = &mut self.bench.tally.categories;
                categories.count(Category::WaitsOn, !ends);
                match ends {
                    true => list.advances(),
                    false => list.goes_to(Next::Rest(awaited, 1)),
                }
            }
            Next::Rest(awaited, REST) => list.goes_to(Next::Poll(awaited)),
            Next::Rest(awaited, cycles) => list.next = Next::Rest(awaited, cycles + 1),
            Next::Flush | Next::Flushed if shown.flush => {
                let categories = &mut self.bench.tally.categories;
                categories.count(Category::WaitsForWrites, !given.writes_done);
                list.goes_to(match given.writes_done {
                    true => Next::Invalidate,
                    false => Next::Flushed,
                });
            }
            Next::Invalidate if shown.invalidate => list.goes_to(Next::Invalidated),
            Next::Invalidated if shown.ended => {
                self.bench.tally.packets += 1;
                list.goes_to(Next::Start);
            }
            _ => (),
        }
    }

    /// Counts an error of the bus that the list has now.
    fn count_error(&mut self, given: &Given) {
        let happens = given.bus_error.is_some();
        let next = self.list.next;
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::BusError, happens);
        categories.count(Category::ErrorAtCheck, happens && next == Next::Check);
        let in_fence = matches!(next, Next::Flush | Next::Flushed);
        categories.count(Category::ErrorInFence, happens && in_fence);
    }

    /// A list starts: its address must be aligned.
    fn start(&mut self) {
        let list = &mut self.list;
        let Some(address) = self.around.start.take() else {
            return;
        };
        list.at = address;
        list.ends = false;
        list.begins = true;
        let misaligned = address % descriptor::BYTES != 0;
        list.error = misaligned.then_some(Fault {
            code: Fault::ALIGNMENT,
            value: address,
        });
        list.goes_to(Next::Invalidate);
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::MisalignedList, misaligned);
    }

    /// A burst is offered: of a descriptor, which is made now, or of a box.
    fn read(&mut self, given: &Given, of: Next) {
        if !given.read_ready {
            self.list.goes_to(of);
            self.list.is_offered = true;
            return;
        }
        if let Next::Box(scene) = of {
            let record = ByteRecord::vertex(self.format);
            let bytes = 2 * record.bytes as usize;
            self.list.corners = self.corners(bytes / 4);
            self.list.goes_to(Next::BoxBeat(scene, 0));
            return;
        }
        if let Next::Poll(awaited) = of {
            let rng = &mut self.rng;
            let found = match rng.u8(..4) {
                0 => awaited.value,
                1 => awaited.value.saturating_sub(1),
                _ => rng.u32(..),
            };
            self.list.goes_to(Next::PollBeat(awaited, found));
            return;
        }
        self.list.words = self.descriptor();
        self.list.left = self.list.left.saturating_sub(1);
        self.list.goes_to(Next::DescriptorBeat(0));
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::UnderCast, given.casting);
    }

    /// The descriptor is checked, with the error that the list had before, and the error of the bus in this cycle.
    fn decode(&mut self, before: Option<Fault>, now: Option<u32>) {
        let (list, tally) = (&mut self.list, &mut self.bench.tally);
        tally.transactions += 1;
        let categories = &mut tally.categories;
        list.ends = true;
        if before.is_some() {
            return list.goes_to(Next::Flush);
        }
        let checked =
            Command::decode(&list.words, &self.limits).and_then(|command| match command {
                Command::Cast(cast) if list.scene.is_none() => Err(Fault {
                    code: Fault::SCENE,
                    value: cast.count,
                }),
                _ => Ok(command),
            });
        list.ends = checked.is_err() || checked == Ok(Command::End);
        let casting = self.around.casting > 0;
        let moves = self.around.skinning.max(self.around.updating) > 0;
        let waits = matches!(
            checked,
            Ok(Command::Scene(_)
                | Command::Cast(_)
                | Command::Skin(_)
                | Command::Fence
                | Command::End)
        );
        categories.count(Category::WaitsForCast, waits && casting);
        let is_update = matches!(checked, Ok(Command::Update(_)));
        let waits = is_update || matches!(checked, Ok(Command::Skin(_) | Command::Fence));
        categories.count(Category::WaitsForMotion, waits && moves);
        categories.count(Category::UpdateUnderCast, is_update && casting && !moves);
        let (category, next) = match checked {
            Err(fault) => {
                // An error of the bus in the same cycle goes first.
                if now.is_none() {
                    list.error = Some(fault);
                }
                let category = match fault.code {
                    Fault::OPCODE => Category::WrongOpcode,
                    Fault::ALIGNMENT => Category::Misaligned,
                    Fault::SIZE => Category::WrongSize,
                    _ => Category::WithoutScene,
                };
                (category, Next::Flush)
            }
            Ok(Command::End) => (Category::EndCommand, Next::Flush),
            Ok(Command::Fence) => (Category::FenceCommand, Next::Flush),
            Ok(Command::Jump { to }) => {
                list.at = to;
                (Category::JumpCommand, Next::Descriptor)
            }
            Ok(Command::Signal { .. }) => (Category::SignalCommand, Next::Signal),
            Ok(Command::Scene(scene)) => (Category::SceneCommand, Next::Box(scene)),
            Ok(Command::Cast(cast)) => (Category::CastCommand, Next::Cast(cast)),
            Ok(Command::Skin(skin)) => (Category::SkinCommand, Next::Skin(skin)),
            Ok(Command::Update(update)) => (Category::UpdateCommand, Next::Update(update)),
            Ok(Command::Wait { address, value }) => {
                let awaited = Awaited { address, value };
                (Category::WaitCommand, Next::Publish(awaited))
            }
        };
        categories.count(category, true);
        list.goes_to(next);
    }

    /// The neighbours go on by a cycle.
    fn go_on(&mut self, given: &Given, shown: &Shown) {
        let (rng, pace, around) = (&mut self.rng, &self.pace, &mut self.around);
        // Lines leave one by one while a flush lasts, and now and then without it.
        let leaves = match shown.flush {
            true => rng.f64() >= pace.responses,
            false => rng.u8(..64) == 0,
        };
        let written = shown.write && given.write_ready;
        let of_cast = (given.casting || given.moves()) && rng.u8(..4) == 0;
        around.writes = written || of_cast || (around.writes && !leaves);
        around.casting = match shown.cast {
            true => rng.u32(1..=pace.longest_cast),
            false => around.casting.saturating_sub(1),
        };
        let starts = shown.motion && given.motion_ready;
        let mut moves = |cycles: u32, starts: bool| match starts {
            true => rng.u32(1..=pace.longest_cast),
            false => cycles.saturating_sub(1),
        };
        // What starts is what was offered: the list has gone on.
        let is_update = self.list.words[0] & 0xff == descriptor::update::OPCODE;
        around.skinning = moves(around.skinning, starts && !is_update);
        around.updating = moves(around.updating, starts && is_update);
        around.invalidating = match shown.invalidate {
            true => rng.u32(1..=pace.sets),
            false => around.invalidating.saturating_sub(1),
        };
    }

    /// The words of a box: any bits, and special values.
    fn corners(&mut self, count: usize) -> Vec<u32> {
        let record = ByteRecord::vertex(self.format);
        let mut words: Vec<u32> = vec![];
        words.resize_with(count, || self.rng.u32(..));
        let special = specials(self.format);
        let zeros = [0, 1u64 << (self.format.width() - 1)];
        for corner in 0..2 {
            for part in &record.parts[..3] {
                let rng = &mut self.rng;
                let bits = match rng.u8(..4) {
                    0 => special[rng.usize(..special.len())],
                    // A zero has any fraction.
                    1 => {
                        let fraction = rng.u64(..1 << self.format.fraction_bits());
                        zeros[rng.usize(..2)] | fraction
                    }
                    _ => rng.u64(..1 << self.format.width()),
                };
                let at = 8 * (corner * record.bytes + part.offset);
                put(&mut words, at, part.width, bits);
            }
        }
        words
    }

    /// A descriptor: most are right, and the last of a list is an end.
    fn descriptor(&mut self) -> [u32; WORDS] {
        use descriptor::cast;
        let is_wrong = self.rng.f64() < self.pace.wrong;
        let command = match self.list.left {
            0 => Command::End,
            _ => self.command(),
        };
        let mut words = command.encode();
        let rng = &mut self.rng;
        if !is_wrong {
            return words;
        }
        // The words that are addresses, with the low bits that are 0.
        let aligned: &[(usize, u32)] = match command {
            Command::Jump { .. } => &[(1, 6)],
            Command::Signal { .. } => &[(1, 2)],
            Command::Scene(_) => &[(2, 6), (3, 6), (4, 6), (5, 6)],
            Command::Cast(_) => &[(1, 4), (3, 6)],
            Command::Wait { .. } => &[(1, 2)],
            Command::Skin(_) => &[(1, 6), (4, 4)],
            Command::Update(_) => &[(1, 4), (3, 6), (5, 6), (7, self.limits.box_bytes.ilog2())],
            Command::End | Command::Fence => &[],
        };
        if !aligned.is_empty() && rng.u8(..4) != 0 {
            let (word, bits) = aligned[rng.usize(..aligned.len())];
            words[word] |= 1 << rng.u32(..bits);
            if rng.u8(..4) == 0 {
                let (word, bits) = aligned[rng.usize(..aligned.len())];
                words[word] ^= rng.u32(..1 << bits);
            }
        }
        // The words that are counts or indices, with the greatest value.
        let index = self.limits.greatest_index;
        let counts: &[(usize, u32)] = match command {
            Command::Cast(_) => &[(cast::word::count, self.limits.rays)],
            Command::Skin(_) => {
                let joints = self.limits.joints;
                &[
                    (2, index),
                    (3, joints),
                    (5, index),
                    (6, index),
                    (7, index),
                    (8, index),
                ]
            }
            Command::Update(_) => &[(2, index), (4, index), (6, index)],
            _ => &[],
        };
        if !counts.is_empty() && rng.bool() {
            let (word, most) = counts[rng.usize(..counts.len())];
            words[word] = match rng.u8(..4) {
                0 => 0,
                1 => most.wrapping_add(1),
                2 => 1 << rng.u32(..32),
                _ => rng.u32(..),
            };
        }
        if rng.u8(..4) == 0 {
            words[0] = match rng.bool() {
                true => words[0] ^ 1 << rng.u32(..8),
                false => words[0] & !0xff | rng.u32(..256),
            };
        }
        words
    }

    fn command(&mut self) -> Command {
        let Limits {
            rays: most,
            joints,
            greatest_index,
            box_bytes,
        } = self.limits;
        let rng = &mut self.rng;
        let aligned = |rng: &mut fastrand::Rng, to: u32| rng.u32(..) & !(to - 1);
        let index = |rng: &mut fastrand::Rng| rng.u32(..=greatest_index);
        let count = |rng: &mut fastrand::Rng| rng.u32(1..=greatest_index);
        match rng.u8(..14) {
            0 => Command::Fence,
            1 => Command::Jump {
                to: aligned(rng, 64),
            },
            2..5 => Command::Signal {
                address: aligned(rng, 4),
                value: rng.u32(..),
                interrupt: rng.bool(),
            },
            5 | 6 => Command::Scene(Scene {
                root: rng.u32(..),
                nodes: aligned(rng, 64),
                records: aligned(rng, 64),
                vertices: aligned(rng, 64),
                bounds: aligned(rng, 64),
            }),
            7 => Command::Wait {
                address: aligned(rng, 4),
                value: rng.u32(..) >> rng.u32(..32),
            },
            8 | 9 => Command::Skin(Skin {
                vertices: aligned(rng, 64),
                palette: index(rng),
                joints: rng.u32(1..=joints),
                influences: aligned(rng, 16),
                rows: count(rng),
                rest: index(rng),
                count: count(rng),
                target: index(rng),
            }),
            10 | 11 => Command::Update(Update {
                program: aligned(rng, 16),
                rows: count(rng),
                vertices: aligned(rng, 64),
                first_vertex: index(rng),
                nodes: aligned(rng, 64),
                first_node: index(rng),
                bounds: aligned(rng, box_bytes),
            }),
            _ => Command::Cast(Cast {
                rays: aligned(rng, 16),
                count: match rng.u8(..4) {
                    0 => most,
                    1 => 1,
                    _ => rng.u32(1..=most),
                },
                hits: aligned(rng, 64),
                any_hit: rng.bool(),
                short: rng.bool().then(|| {
                    // Patterns that a copy leaves as they are: no NaN.
                    let mut number = || f32::from_bits(rng.u32(..) & 0xbfff_ffff);
                    ([number(), number(), number()], number())
                }),
            }),
        }
    }
}

/// What is offered of a mesh or an object: the fields that its command has.
fn motion(next: Next, ports: &Motion<PortHandle>) -> Vec<(&'static str, u64, PortHandle)> {
    match next {
        Next::Skin(skin) => vec![
            ("is update", 0, ports.is_update),
            ("vertices", skin.vertices.into(), ports.vertices),
            ("palette", skin.palette.into(), ports.palette),
            ("joints", skin.joints.into(), ports.joints),
            ("influences", skin.influences.into(), ports.rows_address),
            ("rows", skin.rows.into(), ports.rows),
            ("rest", skin.rest.into(), ports.rest),
            ("count", skin.count.into(), ports.count),
            ("target", skin.target.into(), ports.target),
        ],
        Next::Update(update) => vec![
            ("is update", 1, ports.is_update),
            ("program", update.program.into(), ports.rows_address),
            ("rows", update.rows.into(), ports.rows),
            ("vertices", update.vertices.into(), ports.vertices),
            (
                "first vertex",
                update.first_vertex.into(),
                ports.first_vertex,
            ),
            ("nodes", update.nodes.into(), ports.nodes),
            ("first node", update.first_node.into(), ports.first_node),
            ("bounds", update.bounds.into(), ports.bounds),
        ],
        _ => unreachable!("nothing else is offered as a motion"),
    }
}

/// Stores the low `width` bits of a value at a bit of some words.
fn put(words: &mut [u32], at: u32, width: u32, value: u64) {
    for bit in 0..width {
        let place = at + bit;
        let word = &mut words[place as usize / 32];
        *word &= !(1 << (place % 32));
        *word |= ((value >> bit & 1) as u32) << (place % 32);
    }
}

/// The corners of a box in two vertex records: numbers of the format, of which −0 becomes +0.
fn corners(format: Format, words: &[u32]) -> Corners {
    let record = ByteRecord::vertex(format);
    std::array::from_fn(|place| {
        let (corner, part) = (place as u32 / 3, &record.parts[place % 3]);
        let at = 8 * (corner * record.bytes + part.offset);
        let bit = |k: u32| u64::from(words[(at + k) as usize / 32] >> ((at + k) % 32) & 1);
        let bits = (0..part.width).fold(0, |bits, k| bits | bit(k) << k);
        let sign = 1 << (format.width() - 1);
        match format.to_f64(bits) == 0.0 {
            true => bits & !sign,
            false => bits,
        }
    })
}
