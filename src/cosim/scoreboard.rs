//! Common code of the co-simulations of single units: their environment, options and report, and
//! the part of ray setup, which they replace.

use super::memory::{Bandwidth, Timing};
use super::mismatch::{Field, Mismatch};
use super::model::{BuildOptions, Model, PortHandle, Recording, Sources, Trace, build};
use crate::float::Format;
use crate::golden::RaySetup;
use crate::hdl::{Design, HdlError, Module, Mutation};
use crate::hw::{Plan, geometry, ray, tpu};
use anyhow::{Result, bail, ensure};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

/// The environment of a unit: memories, and the speed of its neighbours.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Surroundings {
    /// The timing of every read port; each has its own seed.
    pub memory: Timing,
    /// Probability, 0 ≤ p < 1, that a neighbour pauses in a cycle: it neither supplies nor accepts data.
    pub pauses: f64,
    /// Maximum number of cycles, at least 1, for the model of the geometry unit to test a leaf.
    pub leaf_clocks: u32,
    /// Probability, 0 ≤ p ≤ 1, that the rows of an update's program are the bottleneck.
    pub slow_programs: f64,
}

impl Surroundings {
    /// Memories with a response in every cycle after `latency` cycles, and neighbours that never pause.
    pub fn steady(latency: u32) -> Surroundings {
        Surroundings {
            memory: Timing {
                latency,
                ..Timing::default()
            },
            pauses: 0.0,
            leaf_clocks: 60,
            slow_programs: 0.0,
        }
    }

    /// Random latency (1 to 100 cycles), order of responses and back-pressure (none to most cycles).
    pub fn random(rng: &mut fastrand::Rng) -> Surroundings {
        let latency = match rng.u8(..8) {
            0 => 1,
            1 => 100,
            _ => rng.u32(1..=100),
        };
        let jitter = if rng.bool() { rng.u32(0..=100) } else { 0 };
        let mut probability = || [0.0, 0.1, 0.3, 0.6][rng.usize(..4)];
        let (backpressure, pauses) = (probability(), probability());
        let (requests, cycles) = [(1, 1), (1, 1), (2, 3), (1, 2)][rng.usize(..4)];
        Surroundings {
            memory: Timing {
                latency,
                jitter,
                out_of_order: jitter > 0 && rng.bool(),
                bandwidth: Bandwidth { requests, cycles },
                backpressure,
                seed: rng.u64(..),
            },
            pauses,
            leaf_clocks: [1, 20, 200][rng.usize(..3)],
            slow_programs: 0.125,
        }
    }

    /// The timing of port number `port`, with a unique seed.
    pub(super) fn port(&self, port: u64) -> Timing {
        Timing {
            seed: self.memory.seed ^ port.wrapping_mul(0x9e37_79b9_7f4a_7c15),
            ..self.memory
        }
    }

    /// Number of cycles without an event after which a unit counts as stopped.
    pub(super) fn patience(&self) -> u64 {
        20_000 + 100 * u64::from(self.memory.latency + self.memory.jitter + self.leaf_clocks)
    }
}

/// Options for the co-simulation of a unit.
#[derive(Clone, Debug)]
pub struct UnitOptions {
    /// Seed of all random values; the same seed gives the same run.
    pub seed: u64,
    /// `None`: random ones, which change during the run.
    pub surroundings: Option<Surroundings>,
    /// The `dynrt cosim` command that repeats the run, for a mismatch's report; may be empty.
    pub replay: String,
    pub trace: Option<Trace>,
    /// A fault in the unit, with which tests check that it is detected.
    pub fault: Option<Fault>,
    /// The unit with mutants, of which one is selected.
    pub mutated: Option<Mutated>,
    /// Traffic of an earlier run, which a reset interrupts before this one begins.
    pub interrupted: Option<Interrupted>,
    /// The recorder for the first traffic of the run, for [`UnitOptions::interrupted`] of another run.
    pub record: Option<Recorder>,
    /// Options for building the model. A model with a trace is always built for tracing.
    pub build: BuildOptions,
}

impl UnitOptions {
    /// Random surroundings, no trace, the user's cache.
    pub fn new(seed: u64) -> UnitOptions {
        UnitOptions {
            seed,
            surroundings: None,
            replay: String::new(),
            trace: None,
            fault: None,
            mutated: None,
            interrupted: None,
            record: None,
            build: BuildOptions::default(),
        }
    }
}

/// Records the first traffic of a run.
#[derive(Clone, Debug, Default)]
pub struct Recorder(Arc<Mutex<Option<Recording>>>);

impl Recorder {
    pub(super) fn put(&self, recording: Option<Recording>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = recording;
    }

    /// The recording; `None` before the run has ended, or if no cycle was simulated.
    pub fn take(&self) -> Option<Arc<Recording>> {
        let mut recorded = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let recording = recorded.take().filter(|recording| !recording.is_empty());
        recording.map(Arc::new)
    }
}

/// Traffic that is played up to a cycle and then interrupted.
#[derive(Clone, Debug)]
pub struct Interrupted {
    pub traffic: Arc<Recording>,
    pub at: usize,
}

/// Number of recorded cycles, including resets.
pub const RECORDED_CYCLES: usize = 4000;

/// A change of a unit's design.
pub type Fault = fn(&Design) -> Result<Mutation, HdlError>;

/// The input that selects the mutant.
pub const SELECT: &str = "mutant";

/// A design with mutants that replaces the unit's design.
#[derive(Clone, Debug)]
pub struct Mutated {
    /// The design, in which [`SELECT`] selects the mutant: see [`Design::selectable`].
    pub design: Arc<Design>,
    pub selected: u32,
}

impl Mutated {
    pub(super) fn select(&self, model: &mut Model) -> Result<()> {
        let port = model.port(SELECT)?;
        model.set(port, u64::from(self.selected));
        Ok(())
    }
}

/// The sources of a unit for Verilator: those of the design with mutants, if there is one.
pub(super) fn sources_with(mutated: Option<&Mutated>, design: &Design) -> Sources {
    Sources::of(mutated.map_or(design, |mutated| &mutated.design))
}

/// A kind of transaction that is counted separately. See [`Category::name`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Category {
    Nan,
    Infinity,
    SignedZero,
    FlatBox,
    RayInPlane,
    EqualDistances,
    DeepestStack,
    Degenerate,
    AnyHit,
    FiniteLimits,
    InactiveRay,
    DroppedEntry,
    NothingEntered,
    LeafRoot,
    Hit,
    Clamped,
    OnEdge,
    EmptyWindow,
    OutsideLimits,
    Mirrored,
    OneInfluence,
    TwoInfluences,
    ThreeInfluences,
    FourInfluences,
    InTwoRows,
    FullPalette,
    OneVertex,
    ListedRequest,
    RegistersInUse,
    WaysInFlight,
    HitUnderMiss,
    LongList,
    InterleavedBeats,
    LinesOvertake,
    ReplacedLine,
    Invalidation,
    InvalidatedAtOnce,
    HitAfterAnswers,
    ListedAtLastBeat,
    NextInLine,
    MovedBase,
    BusError,
    ShortRay,
    Overtakes,
    HeldPacket,
    WaitingWrite,
    CutShort,
    Overtaking,
    Interleaved,
    LongestBurst,
    OneBeat,
    UpToBoundary,
    AllReads,
    AllWrites,
    DataFirst,
    PartialWord,
    FullLine,
    TrimmedLine,
    GapInLine,
    OverwrittenByte,
    EvictedLine,
    Contention,
    ShortBlock,
    PartialStrobes,
    NoStrobes,
    AddressFirst,
    Unassigned,
    BothAccesses,
    WaitingResponse,
    QueuedList,
    Overrun,
    RingsAtStart,
    Snapshot,
    ClearedInterrupt,
    ClearedAtEvent,
    FailedList,
    EndCommand,
    JumpCommand,
    FenceCommand,
    SignalCommand,
    SceneCommand,
    CastCommand,
    WaitCommand,
    SkinCommand,
    UpdateCommand,
    WrongOpcode,
    Misaligned,
    WrongSize,
    WithoutScene,
    MisalignedList,
    ErrorAtCheck,
    ErrorInFence,
    WaitsForCast,
    UnderCast,
    WaitsForMotion,
    UpdateUnderCast,
    WaitsOn,
    RowAnswered,
    VertexWritten,
    NodeWritten,
    BoxWritten,
    WaitingWord,
    WaitingTag,
    WaitsForWrites,
}

impl Category {
    const COUNT: usize = Category::WaitsForWrites as usize + 1;

    /// The category's name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Category::Nan => "NaN",
            Category::Infinity => "infinities",
            Category::SignedZero => "signed zeros",
            Category::FlatBox => "flat boxes",
            Category::RayInPlane => "rays in a plane",
            Category::EqualDistances => "equal distances",
            Category::DeepestStack => "deepest stack",
            Category::Degenerate => "degenerate triangles",
            Category::AnyHit => "any-hit rays",
            Category::FiniteLimits => "finite tmin or tmax",
            Category::InactiveRay => "inactive rays",
            Category::DroppedEntry => "dropped entries",
            Category::NothingEntered => "nothing entered",
            Category::LeafRoot => "root is a leaf",
            Category::Hit => "hits",
            Category::Clamped => "distance clamped to the box",
            Category::OnEdge => "hits on an edge",
            Category::EmptyWindow => "empty windows",
            Category::OutsideLimits => "window outside tmin and tmax",
            Category::Mirrored => "mirroring instances",
            Category::OneInfluence => "one influence",
            Category::TwoInfluences => "two influences",
            Category::ThreeInfluences => "three influences",
            Category::FourInfluences => "four influences",
            Category::InTwoRows => "influences in two rows",
            Category::FullPalette => "palette full",
            Category::OneVertex => "mesh of one vertex",
            Category::ShortRay => "short rays",
            Category::Overtakes => "packets that overtake",
            Category::HeldPacket => "cycles of held packets",
            Category::WaitingWrite => "cycles of waiting writes",
            Category::CutShort => "cut short by a reset",
            Category::ListedRequest => "requests for a line in flight",
            Category::RegistersInUse => "waits: all miss registers in use",
            Category::WaysInFlight => "waits: all ways in flight",
            Category::HitUnderMiss => "hits under a miss",
            Category::LongList => "lists longer than two",
            Category::InterleavedBeats => "interleaved beats",
            Category::LinesOvertake => "lines out of order",
            Category::ReplacedLine => "replaced lines",
            Category::Invalidation => "invalidations",
            Category::InvalidatedAtOnce => "invalidations right after idle",
            Category::HitAfterAnswers => "hits right after the answers",
            Category::ListedAtLastBeat => "listed at the last beat",
            Category::NextInLine => "listed in the next cycle",
            Category::MovedBase => "moved bases",
            Category::BusError => "errors of the bus",
            Category::Overtaking => "beats before an older burst's",
            Category::Interleaved => "beats of bursts interleaved",
            Category::LongestBurst => "longest burst",
            Category::OneBeat => "burst of one beat",
            Category::UpToBoundary => "burst up to 4 KiB",
            Category::AllReads => "all reads outstanding",
            Category::AllWrites => "all writes outstanding",
            Category::DataFirst => "data before their address",
            Category::PartialWord => "some bytes of a beat written",
            Category::FullLine => "line full",
            Category::TrimmedLine => "line trimmed",
            Category::GapInLine => "word without strobes in a burst",
            Category::OverwrittenByte => "byte overwritten in a line",
            Category::EvictedLine => "oldest line closed for room",
            Category::Contention => "two clients wait at once",
            Category::ShortBlock => "burst shorter than a block",
            Category::PartialStrobes => "writes of some bytes",
            Category::NoStrobes => "writes of no byte",
            Category::AddressFirst => "addresses before their data",
            Category::Unassigned => "accesses to no register",
            Category::BothAccesses => "write and read accepted at once",
            Category::WaitingResponse => "cycles of waiting responses",
            Category::QueuedList => "lists queued behind another",
            Category::Overrun => "doorbells without effect",
            Category::RingsAtStart => "doorbells as a list starts",
            Category::Snapshot => "snapshots",
            Category::ClearedInterrupt => "interrupts cleared",
            Category::ClearedAtEvent => "interrupts cleared as they come",
            Category::FailedList => "lists that fail",
            Category::EndCommand => "end",
            Category::JumpCommand => "jump",
            Category::FenceCommand => "fence",
            Category::SignalCommand => "signal",
            Category::SceneCommand => "scene",
            Category::CastCommand => "cast",
            Category::WaitCommand => "wait",
            Category::SkinCommand => "skin",
            Category::UpdateCommand => "update",
            Category::WrongOpcode => "unknown opcodes",
            Category::Misaligned => "misaligned addresses",
            Category::WrongSize => "wrong numbers of rays",
            Category::WithoutScene => "casts without a scene",
            Category::MisalignedList => "lists at misaligned addresses",
            Category::ErrorAtCheck => "bus errors at a descriptor's check",
            Category::ErrorInFence => "bus errors in a fence",
            Category::WaitsForCast => "commands that wait for a cast",
            Category::UnderCast => "descriptors read during a cast",
            Category::WaitsForMotion => "commands that wait for a mesh or an update",
            Category::UpdateUnderCast => "updates that start during a cast",
            Category::WaitsOn => "words that are still too small",
            Category::RowAnswered => "rows",
            Category::VertexWritten => "vertices written",
            Category::NodeWritten => "nodes written",
            Category::BoxWritten => "boxes written",
            Category::WaitingWord => "rows that wait for a word",
            Category::WaitingTag => "words that wait for a request",
            Category::WaitsForWrites => "fences that wait for writes",
        }
    }
}

/// Transactions by category.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Categories([u64; Category::COUNT]);

impl Default for Categories {
    fn default() -> Categories {
        Categories([0; Category::COUNT])
    }
}

impl Categories {
    #[inline]
    pub(super) fn count(&mut self, category: Category, holds: bool) {
        self.0[category as usize] += u64::from(holds);
    }

    /// Number of transactions of a category.
    pub fn of(&self, category: Category) -> u64 {
        self.0[category as usize]
    }
}

/// The result of a unit's co-simulation.
#[derive(Clone, Debug)]
pub struct UnitReport {
    /// `tpu`, `geometry`, `transform`, `update`, `skinning` or `cache`.
    pub unit: &'static str,
    pub seed: u64,
    /// Number of packets processed.
    pub packets: u64,
    /// Number of packet steps of the traversal unit, or of ray–triangle tests or ray transformations of the geometry unit.
    pub transactions: u64,
    /// Number of compared results: transactions, dispatched leaves, finished packets, and hits read back.
    pub checked: u64,
    /// 0 or 1, because the run ends at the first mismatch.
    pub mismatches: u64,
    /// The report of the mismatch.
    pub mismatch: Option<String>,
    /// Number of cycles, including the reset.
    pub cycles: u64,
    /// The categories that can occur in the unit, with their numbers of transactions.
    pub categories: Vec<(Category, u64)>,
    /// Build time of the model in seconds.
    pub model_build_s: f64,
    /// Time of simulation and comparison in seconds.
    pub simulate_s: f64,
}

impl UnitReport {
    /// Checks that the unit has passed.
    ///
    /// # Errors
    /// The mismatch, or a message that nothing was checked.
    pub fn verdict(&self) -> Result<()> {
        if let Some(mismatch) = &self.mismatch {
            bail!("{mismatch}");
        }
        ensure!(
            self.transactions > 0 && self.checked > 0,
            "{}: nothing was checked: no ray of the workload gives the unit anything to do",
            self.unit
        );
        Ok(())
    }

    /// The report in a few lines.
    pub fn summary(&self) -> String {
        use std::fmt::Write as _;
        let mut text = format!(
            "{}: {} transactions, {} results of {} packets checked, {} mismatches in {} cycles (seed {}; model {:.1} s, run {:.1} s)",
            self.unit,
            self.transactions,
            self.checked,
            self.packets,
            self.mismatches,
            self.cycles,
            self.seed,
            self.model_build_s,
            self.simulate_s
        );
        for (category, count) in &self.categories {
            let _ = write!(text, "\n  {:28} {count:>10}", category.name());
        }
        text
    }
}

/// The counts of a run so far.
#[derive(Clone, Debug, Default)]
pub(super) struct Tally {
    pub packets: u64,
    pub transactions: u64,
    pub checked: u64,
    pub categories: Categories,
}

/// Number of cycles of a reset; one is sufficient for every unit.
pub(super) const RESET_CYCLES: u64 = 1;

/// Number of cycles with random inputs before the first reset.
pub(super) const DISTURBED_CYCLES: u64 = 64;

/// A unit's model, built and loaded, with the data for a mismatch report.
pub(super) struct Bench {
    pub unit: &'static str,
    pub model: Model,
    pub tally: Tally,
    pub seed: u64,
    replay: String,
    record: Option<Recorder>,
    model_build_s: f64,
    started: Instant,
}

impl Bench {
    pub fn new(unit: &'static str, module: &Arc<Module>, options: &UnitOptions) -> Result<Bench> {
        let mut design = Design::new(module.clone())?;
        if let Some(fault) = options.fault {
            design = design.with(&fault(&design)?)?;
        }
        let sources = sources_with(options.mutated.as_ref(), &design);
        let mut how = options.build.clone();
        how.traced |= options.trace.is_some();
        let built = build(&sources, &how, &|_| ())?;
        let mut model = Model::load(&built, &sources.ports)?;
        model.disturb(options.seed, DISTURBED_CYCLES);
        if let Some(interrupted) = &options.interrupted {
            model.reset(RESET_CYCLES);
            model.play(&interrupted.traffic, interrupted.at)?;
        }
        if options.record.is_some() {
            model.record(RECORDED_CYCLES);
        }
        if let Some(mutated) = &options.mutated {
            mutated.select(&mut model)?;
        }
        if let Some(window) = &options.trace {
            model.trace(&window.path, window.from, window.cycles)?;
        }
        Ok(Bench {
            unit,
            model,
            tally: Tally::default(),
            seed: options.seed,
            replay: options.replay.clone(),
            record: options.record.clone(),
            model_build_s: built.build_seconds,
            started: Instant::now(),
        })
    }

    /// The error for fields that differ, or without fields for an unexpected or missing event.
    #[cold]
    pub fn mismatch(&self, place: impl Into<String>, fields: Vec<Field>) -> anyhow::Error {
        let mismatch = Mismatch {
            unit: self.unit,
            place: place.into(),
            cycle: self.model.cycles(),
            fields,
            replay: self.replay.clone(),
        };
        mismatch.into()
    }

    /// Compares ports: each with its name and the golden value.
    ///
    /// # Errors
    /// A mismatch with all of them, if one differs.
    pub fn compare(
        &self,
        place: impl Into<String>,
        ports: &[(&str, u64, PortHandle)],
    ) -> Result<()> {
        let model = &self.model;
        if (ports.iter()).all(|(_, golden, port)| *golden == model.get(*port)) {
            return Ok(());
        }
        let field = |(name, golden, port): &(&str, u64, PortHandle)| {
            Field::integer(*name, *golden, model.get(*port))
        };
        Err(self.mismatch(place, ports.iter().map(field).collect()))
    }

    /// The report of a run. Only a mismatch is a result; other errors are returned.
    pub fn report(mut self, ended: Result<()>, categories: &[Category]) -> Result<UnitReport> {
        self.model.trace_end();
        if let Some(record) = &self.record {
            record.put(self.model.recorded());
        }
        let mismatch = match ended {
            Ok(()) => None,
            Err(error) => Some(error.downcast::<Mismatch>()?.to_string()),
        };
        let tally = &self.tally;
        Ok(UnitReport {
            unit: self.unit,
            seed: self.seed,
            packets: tally.packets,
            transactions: tally.transactions,
            checked: tally.checked,
            mismatches: mismatch.is_some().into(),
            mismatch,
            cycles: self.model.cycles(),
            categories: categories
                .iter()
                .map(|&category| (category, tally.categories.of(category)))
                .collect(),
            model_build_s: self.model_build_s,
            simulate_s: self.started.elapsed().as_secs_f64(),
        })
    }
}

/// A ray after ray setup, by the golden model.
#[derive(Clone, Copy, Debug)]
pub(super) struct RaySetUp {
    pub ray: RaySetup,
    /// near and far in the scene's box.
    pub interval: [f64; 2],
    pub enters: bool,
}

/// The position of a ray: its packet in flight and its slot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct SetupPlace {
    pub packet: usize,
    /// Its slot in the packet.
    pub ray: usize,
    /// Whether it is the first, and the last, of the packet's rays that arrive.
    pub first: bool,
    pub last: bool,
    /// Whether it is in object space.
    pub object: bool,
}

impl SetupPlace {
    /// A ray of the world, in a packet of `rays`.
    pub fn of_world(packet: usize, ray: usize, rays: usize) -> SetupPlace {
        SetupPlace {
            packet,
            ray,
            first: ray == 0,
            last: ray + 1 == rays,
            object: false,
        }
    }
}

impl RaySetUp {
    /// The ray as the traversal unit receives it.
    pub fn for_traversal(&self, format: Format, place: SetupPlace) -> tpu::SetUp<u64> {
        let numbers = |x: [f64; 3]| x.map(|x| format.to_bits(x));
        let [near, far] = self.interval.map(|x| format.to_bits(x));
        tpu::SetUp {
            place: ray::Place {
                packet: place.packet as u64,
                ray: place.ray as u64,
                first: place.first.into(),
                last: place.last.into(),
            },
            enters: self.enters.into(),
            interval: ray::Interval { near, far },
            signs: self.signs(),
            origin: numbers(self.ray.origin),
            reciprocal: numbers(self.ray.reciprocal),
        }
    }

    /// The ray as the geometry unit receives it, without the last component of a watertight test's shear.
    pub fn for_tests(&self, plan: &Plan, place: SetupPlace) -> geometry::SetUp<u64> {
        let number = |x: f64| plan.format.to_bits(x);
        let ray = &self.ray;
        let [shear_x, shear_y, _] = ray.shear.scale.map(number);
        geometry::SetUp {
            packet: place.packet as u64,
            ray: place.ray as u64,
            object: place.object.into(),
            tested: ray::Tested {
                origin: ray.origin.map(number),
                reciprocal: ray.reciprocal.map(number),
                signs: self.signs(),
                shear: plan.watertight().then(|| ray::Shear {
                    kz: ray.shear.axes[2] as u64,
                    shear_x,
                    shear_y,
                }),
                direction: (!plan.watertight()).then(|| ray.direction.map(number)),
            },
            kept: geometry::Kept {
                limits: ray::Limits {
                    tmin: number(ray.tmin),
                    tmax: number(ray.tmax),
                },
                any_hit: ray.any_hit.into(),
            },
        }
    }

    fn signs(&self) -> u64 {
        (0..3).fold(0, |bits, i| bits | u64::from(self.ray.negative[i]) << i)
    }
}
