//! The whole ray casting unit: rays in, hits out, every packet step, ray transformation and ray–triangle test on the way held
//! against the golden model, in all bits.

use super::memory::{Image, ReadPort, ReadRequest, Timing};
use super::mismatch::{Field, Mismatch};
use super::model::{BuildOptions, Model, PortHandle, build};
use super::scoreboard::{
    DISTURBED_CYCLES, Interrupted, Mutated, RECORDED_CYCLES, RESET_CYCLES, Recorder, sources_with,
};
use super::timing;
use crate::bkd::layout::{MemoryImage, Record};
use crate::config::Config;
use crate::float::Format;
use crate::golden::{Caster, EnterEvent, Observer, RayTest, StepEvent};
use crate::hw;
use crate::port::{Hit, NONE, Ray};
use anyhow::{Result, bail, ensure};
use std::path::PathBuf;
use std::time::Instant;

/// Clocks without any event after which a run is given up as stuck.
const PATIENCE: u64 = 200_000;

/// A window of cycles to trace.
#[derive(Clone, Debug)]
pub struct Trace {
    /// The FST file.
    pub path: PathBuf,
    pub from: u64,
    pub cycles: u64,
}

/// How to run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Of the memories' jitter and of the stalls.
    pub seed: u64,
    /// Share of the clocks in which no ray is offered, 0 to 1.
    pub ray_stall: f64,
    /// Share of the clocks in which no hit is taken, 0 to 1.
    pub hit_stall: f64,
    /// Clocks from one of [`Report::samples`] to the next; none are taken without.
    pub sample_cycles: Option<u64>,
    pub trace: Option<Trace>,
    /// What a person types to run this again, for a mismatch's report.
    pub replay: String,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            seed: 1,
            ray_stall: 0.0,
            hit_stall: 0.0,
            sample_cycles: None,
            trace: None,
            replay: String::new(),
        }
    }
}

/// What a run found.
#[derive(Clone, Debug)]
pub struct Report {
    /// The RTL's hits, one for each ray given, in order.
    pub hits: Vec<Hit>,
    /// Hits, packet steps, ray–triangle tests and ray transformations that were compared in all bits and agree.
    pub hits_checked: u64,
    pub steps_checked: u64,
    pub tests_checked: u64,
    pub transforms_checked: u64,
    /// From the first ray offered to the last hit taken.
    pub cycles: u64,
    /// The RTL's own counters.
    pub counters: Counters,
    /// The same as they stood every [`Options::sample_cycles`] clocks on the way.
    pub samples: Vec<Counters>,
    pub model_build_s: f64,
    pub model_reused: bool,
    pub simulate_s: f64,
}

/// Slots of the triangle test that a ray takes to be transformed.
const SLOTS_OF_TRANSFORM: u64 = 3;

/// A pattern that means the same: a zero or a NaN has any fraction.
fn disguised(format: Format, bits: u64, rng: &mut fastrand::Rng) -> u64 {
    let fraction = (1u64 << format.fraction_bits()) - 1;
    let exponent = bits >> format.fraction_bits() & format.exponent_mask();
    let is_nan = exponent == format.exponent_mask() && bits & fraction != 0;
    match exponent == 0 || is_nan {
        true if is_nan => {
            let any = match rng.bool() {
                true => rng.u64(1..=fraction),
                false => 1 << rng.u32(..format.fraction_bits()),
            };
            bits & !fraction | any
        }
        true => bits & !fraction | rng.u64(..=fraction),
        false => bits,
    }
}

/// The counters of the ray casting unit.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counters {
    pub cycles: u64,
    pub packet_steps: u64,
    pub ray_triangle_tests: u64,
    pub ray_transforms: u64,
    pub tpu_busy_cycles: u64,
    pub tpu_starved_cycles: u64,
    pub gu_busy_cycles: u64,
    pub gu_starved_cycles: u64,
    pub stack_high_water: u64,
}

impl Report {
    pub fn checked(&self) -> u64 {
        self.hits_checked + self.steps_checked + self.tests_checked + self.transforms_checked
    }

    pub fn rays_per_clock(&self) -> f64 {
        self.hits.len() as f64 / self.cycles as f64
    }

    /// Packet steps a clock.
    pub fn tpu_utilisation(&self) -> f64 {
        self.counters.packet_steps as f64 / self.cycles as f64
    }

    /// Slots of the triangle test that are used a clock: one for each ray–triangle test, three for each ray transformation.
    pub fn gu_utilisation(&self) -> f64 {
        self.counters.gu_busy_cycles as f64 / self.cycles as f64
    }
}

/// What the golden model says of one packet, and how far the RTL has come in it.
#[derive(Default)]
struct Expected {
    /// Index of the packet's first ray.
    first_ray: usize,
    hits: Vec<Hit>,
    steps: Vec<StepEvent>,
    tests: Vec<RayTest>,
    transforms: Vec<EnterEvent>,
    next_step: usize,
    next_test: usize,
    next_transform: usize,
}

impl Observer for Expected {
    fn step(&mut self, event: &StepEvent) {
        self.steps.push(*event);
    }
    fn test(&mut self, event: &RayTest) {
        self.tests.push(*event);
    }
    fn enter(&mut self, event: &EnterEvent) {
        self.transforms.push(*event);
    }
}

/// A tagged read port of the model with the memory behind it.
pub(super) struct MemoryPort {
    name: String,
    port: ReadPort,
    image: Image,
    request: [PortHandle; 3],
    ready: PortHandle,
    valid: PortHandle,
    tag: PortHandle,
    data: PortHandle,
    shown_ready: bool,
    shown_valid: bool,
    next: Option<super::memory::ReadResponse>,
    /// A request that was shown and not taken: it must be shown again, unchanged.
    waiting: Option<ReadRequest>,
}

impl MemoryPort {
    pub(super) fn new(model: &mut Model, name: &str, image: Image, timing: Timing) -> Result<Self> {
        let port = MemoryPort {
            name: name.to_string(),
            port: ReadPort::new(name, image.rows(), timing)?,
            image,
            request: [
                model.port(&format!("{name}_request_valid"))?,
                model.port(&format!("{name}_request_address"))?,
                model.port(&format!("{name}_request_tag"))?,
            ],
            ready: model.port(&format!("{name}_request_ready"))?,
            valid: model.port(&format!("{name}_response_valid"))?,
            tag: model.port(&format!("{name}_response_tag"))?,
            data: model.port(&format!("{name}_response_data"))?,
            shown_ready: false,
            shown_valid: false,
            next: None,
            waiting: None,
        };
        model.set(port.ready, 0);
        model.set(port.valid, 0);
        Ok(port)
    }

    /// Before a clock edge: presents what the memory answers, and whether it takes a request.
    pub(super) fn show(&mut self, model: &mut Model) {
        let ready = self.port.ready();
        if ready != self.shown_ready {
            model.set(self.ready, u64::from(ready));
            self.shown_ready = ready;
        }
        let valid = self.next.is_some();
        if valid != self.shown_valid {
            model.set(self.valid, u64::from(valid));
            self.shown_valid = valid;
        }
        if let Some(response) = self.next {
            model.set(self.tag, u64::from(response.tag));
            model.set_words(self.data, self.image.row(response.address));
        }
    }

    /// At the same edge: takes the request that the model offers.
    pub(super) fn take(&mut self, model: &Model) -> Result<()> {
        let request = (model.get(self.request[0]) != 0).then(|| ReadRequest {
            address: model.get(self.request[1]),
            tag: model.get(self.request[2]) as u32,
        });
        ensure!(
            self.waiting.is_none() || self.waiting == request,
            "read port of the {} memory, cycle {}: the request {:?} was not taken, yet now {:?} is shown",
            self.name,
            model.cycles(),
            self.waiting,
            request
        );
        self.waiting = if self.port.ready() { None } else { request };
        self.next = self.port.step(request)?;
        Ok(())
    }
}

/// The ports that a scoreboard watches.
struct Watch {
    step_valid: PortHandle,
    step_packet: PortHandle,
    step_node: PortHandle,
    step_left: PortHandle,
    step_right: PortHandle,
    step_left_first: PortHandle,
    intervals: [PortHandle; 2],
    test_valid: PortHandle,
    test_packet: PortHandle,
    test_ray: PortHandle,
    test_record: PortHandle,
    test_instance: PortHandle,
    test_hit: PortHandle,
    test_numbers: [PortHandle; 3],
    transform: TransformWatch,
}

/// The ports that show a ray taken to an object's space.
pub(super) struct TransformWatch {
    valid: PortHandle,
    packet: PortHandle,
    ray: PortHandle,
    record: PortHandle,
    /// Window, origin, direction.
    numbers: [PortHandle; 8],
}

/// The names of [`TransformWatch`]'s numbers.
const TRANSFORM_NUMBERS: [&str; 8] = [
    "near",
    "far",
    "origin_x",
    "origin_y",
    "origin_z",
    "direction_x",
    "direction_y",
    "direction_z",
];

impl TransformWatch {
    pub(super) fn new(model: &Model) -> Result<Self> {
        let port = |name: &str| model.port(&format!("watch_transform_{name}"));
        let mut numbers = vec![];
        for name in TRANSFORM_NUMBERS {
            numbers.push(port(name)?);
        }
        Ok(TransformWatch {
            valid: port("valid")?,
            packet: port("packet")?,
            ray: port("ray")?,
            record: port("record")?,
            numbers: numbers.try_into().expect("as many as there are names"),
        })
    }

    /// The packet in flight whose ray is shown, if one is.
    pub(super) fn packet(&self, model: &Model) -> Option<usize> {
        (model.get(self.valid) != 0).then(|| model.get(self.packet) as usize)
    }

    /// What differs between the ray shown and the golden model's: nothing, or all fields.
    pub(super) fn compare(&self, model: &Model, format: Format, golden: &EnterEvent) -> Vec<Field> {
        let transformed = &golden.transformed;
        let [near, far] = transformed.window;
        let [ox, oy, oz] = transformed.ray.origin;
        let [dx, dy, dz] = transformed.ray.direction;
        let numbers = [near, far, ox, oy, oz, dx, dy, dz].map(|x| format.to_bits(x));
        let (ray, record) = (u64::from(golden.slot), u64::from(golden.record));
        let get = |port| model.get(port);
        if get(self.ray) == ray && get(self.record) == record && self.numbers.map(get) == numbers {
            return vec![];
        }
        let mut fields = vec![
            Field::integer("ray of the packet", ray, get(self.ray)),
            Field::integer("instance record", record, get(self.record)),
        ];
        for ((name, golden), port) in TRANSFORM_NUMBERS.iter().zip(numbers).zip(self.numbers) {
            fields.push(Field::number(*name, format, golden, get(port)));
        }
        fields
    }
}

impl Watch {
    fn new(model: &Model) -> Result<Self> {
        let port = |name: &str| model.port(&format!("watch_{name}"));
        Ok(Watch {
            step_valid: port("step_valid")?,
            step_packet: port("step_packet")?,
            step_node: port("step_node")?,
            step_left: port("step_left")?,
            step_right: port("step_right")?,
            step_left_first: port("step_left_first")?,
            intervals: [port("step_left_intervals")?, port("step_right_intervals")?],
            test_valid: port("test_valid")?,
            test_packet: port("test_packet")?,
            test_ray: port("test_ray")?,
            test_record: port("test_record")?,
            test_instance: port("test_instance")?,
            test_hit: port("test_hit")?,
            test_numbers: [port("test_t")?, port("test_u")?, port("test_v")?],
            transform: TransformWatch::new(model)?,
        })
    }
}

struct RayPort {
    valid: PortHandle,
    ready: PortHandle,
    tag: PortHandle,
    origin: [PortHandle; 3],
    direction: [PortHandle; 3],
    tmin: PortHandle,
    tmax: PortHandle,
    active: PortHandle,
    any_hit: PortHandle,
}

struct HitPort {
    valid: PortHandle,
    ready: PortHandle,
    tag: PortHandle,
    numbers: [PortHandle; 3],
    instance: PortHandle,
    triangle: PortHandle,
}

/// Casts `rays`, in packets of the machine's size, through the RTL of `config` over `image`, and compares everything.
/// The last packet is filled up with inactive rays. `progress` is told how many rays have come back.
///
/// # Errors
/// The first mismatch; a machine that makes no headway; a tool that is missing; no rays at all.
pub fn run(
    config: &Config,
    image: &MemoryImage,
    rays: &[Ray],
    options: &Options,
    progress: &dyn Fn(u64),
) -> Result<Report> {
    ensure!(!rays.is_empty(), NO_RAYS);
    image.check(config.stack_depth)?;
    RaycastUnit::new(config, options.trace.as_ref())?.cast(image, rays, options, progress)
}

const NO_RAYS: &str = "there are no rays to cast: nothing would be checked";

/// The ray casting unit in simulation, built once for any number of pictures.
pub struct RaycastUnit {
    config: Config,
    model: Model,
    model_build_s: f64,
    model_reused: bool,
}

impl RaycastUnit {
    /// Builds the unit of a machine; with a trace, one that writes it.
    ///
    /// # Errors
    /// A tool that is missing.
    pub fn new(config: &Config, trace: Option<&Trace>) -> Result<RaycastUnit> {
        Self::build(config, trace, &BuildOptions::default(), None)
    }

    /// The same, its model built as `how` says; one with a trace is built for tracing, whatever that says.
    ///
    /// # Errors
    /// As [`RaycastUnit::new`].
    pub fn built(
        config: &Config,
        trace: Option<&Trace>,
        how: &BuildOptions,
    ) -> Result<RaycastUnit> {
        Self::build(config, trace, how, None)
    }

    /// Builds the unit with mutants, one of them selected.
    ///
    /// # Errors
    /// A tool that is missing.
    pub fn mutated(config: &Config, mutated: Option<&Mutated>) -> Result<RaycastUnit> {
        Self::build(config, None, &BuildOptions::default(), mutated)
    }

    fn build(
        config: &Config,
        trace: Option<&Trace>,
        how: &BuildOptions,
        mutated: Option<&Mutated>,
    ) -> Result<RaycastUnit> {
        let machine = hw::emit(config)?;
        let build_options = BuildOptions {
            traced: how.traced || trace.is_some(),
            ..how.clone()
        };
        let sources = sources_with(mutated, &machine.design);
        let started = Instant::now();
        let built = build(&sources, &build_options, &|_| ())?;
        let model_build_s = started.elapsed().as_secs_f64();
        let mut model = Model::load(&built, &sources.ports)?;
        model.disturb(1, DISTURBED_CYCLES);
        if let Some(mutated) = mutated {
            mutated.select(&mut model)?;
        }
        if let Some(trace) = trace {
            model.trace(&trace.path, trace.from, trace.cycles)?;
        }
        Ok(RaycastUnit {
            config: config.clone(),
            model,
            model_build_s,
            model_reused: built.reused,
        })
    }

    /// Lets a reset, that of the next picture, interrupt an earlier one's traffic.
    ///
    /// # Errors
    /// Traffic of another machine.
    pub fn interrupt(&mut self, interrupted: &Interrupted) -> Result<()> {
        self.model.reset(RESET_CYCLES);
        self.model.play(&interrupted.traffic, interrupted.at)
    }

    /// Records the first traffic from now on, for [`RaycastUnit::recorded`].
    pub fn record(&mut self) {
        self.model.record(RECORDED_CYCLES);
    }

    /// Leaves what was recorded with a recorder.
    pub fn recorded(&mut self, recorder: &Recorder) {
        recorder.put(self.model.recorded());
    }

    /// Clocks simulated so far, resets included: a mismatch's cycle is counted so, and a trace's.
    pub fn cycles(&self) -> u64 {
        self.model.cycles()
    }

    /// Resets the unit and casts rays as [`run`] does, whose options hold but for the trace.
    ///
    /// # Errors
    /// The first mismatch; a machine that makes no headway; no rays at all; an image that the machine cannot hold.
    pub fn cast(
        &mut self,
        image: &MemoryImage,
        rays: &[Ray],
        options: &Options,
        progress: &dyn Fn(u64),
    ) -> Result<Report> {
        ensure!(!rays.is_empty(), NO_RAYS);
        image.check(self.config.stack_depth)?;
        let started = Instant::now();
        let mut run = Run::new(&self.config, image, rays, options, &mut self.model)?;
        run.all(progress)?;
        Ok(Report {
            hits: run.hits,
            hits_checked: run.hits_checked,
            steps_checked: run.steps_checked,
            tests_checked: run.tests_checked,
            transforms_checked: run.transforms_checked,
            cycles: run.cycles,
            counters: run.counters,
            samples: run.samples,
            model_build_s: self.model_build_s,
            model_reused: self.model_reused,
            simulate_s: started.elapsed().as_secs_f64(),
        })
    }
}

struct Run<'a> {
    config: &'a Config,
    format: Format,
    rays: &'a [Ray],
    options: &'a Options,
    model: &'a mut Model,
    caster: Caster,
    memories: [MemoryPort; 3],
    ray_port: RayPort,
    hit_port: HitPort,
    watch: Watch,
    start_packet: PortHandle,
    start_tag: PortHandle,
    /// By packet number in flight: which packet it is.
    expected: Vec<Option<Expected>>,
    /// By tag: the packet's number in flight, and rays that have come back.
    by_tag: Vec<Option<(usize, usize)>>,
    free_tags: Vec<u32>,
    hits: Vec<Hit>,
    hits_checked: u64,
    steps_checked: u64,
    tests_checked: u64,
    transforms_checked: u64,
    cycles: u64,
    /// The model's clock at which the last reset had ended.
    reset_at: u64,
    counters: Counters,
    samples: Vec<Counters>,
    rng: fastrand::Rng,
}

impl<'a> Run<'a> {
    fn new(
        config: &'a Config,
        image: &MemoryImage,
        rays: &'a [Ray],
        options: &'a Options,
        model: &'a mut Model,
    ) -> Result<Self> {
        let format = config.format();
        let node = Image::from_words(image.node_words(), Record::node(format).width)?;
        let record = Image::from_words(image.record_words(), Record::triangle().width)?;
        let vertex = Image::from_words(image.vertex_words(), Record::vertex(format).width)?;
        let memories = [
            MemoryPort::new(model, "node", node, timing(config, options.seed ^ 1))?,
            MemoryPort::new(model, "record", record, timing(config, options.seed ^ 2))?,
            MemoryPort::new(model, "vertex", vertex, timing(config, options.seed ^ 3))?,
        ];
        let axes = |prefix: &str| -> Result<[PortHandle; 3]> {
            Ok([
                model.port(&format!("{prefix}_x"))?,
                model.port(&format!("{prefix}_y"))?,
                model.port(&format!("{prefix}_z"))?,
            ])
        };
        let ray_port = RayPort {
            valid: model.port("ray_valid")?,
            ready: model.port("ray_ready")?,
            tag: model.port("ray_tag")?,
            origin: axes("ray_origin")?,
            direction: axes("ray_direction")?,
            tmin: model.port("ray_tmin")?,
            tmax: model.port("ray_tmax")?,
            active: model.port("ray_active")?,
            any_hit: model.port("ray_any_hit")?,
        };
        let hit_port = HitPort {
            valid: model.port("hit_valid")?,
            ready: model.port("hit_ready")?,
            tag: model.port("hit_tag")?,
            numbers: [
                model.port("hit_t")?,
                model.port("hit_u")?,
                model.port("hit_v")?,
            ],
            instance: model.port("hit_instance")?,
            triangle: model.port("hit_triangle")?,
        };
        let (lo, hi) = image.bounds;
        for (ports, values) in [(axes("scene_lo")?, lo), (axes("scene_hi")?, hi)] {
            for (port, value) in ports.into_iter().zip(values) {
                model.set(port, format.to_bits(value));
            }
        }
        let root = model.port("scene_root")?;
        model.set(root, u64::from(image.root.pack()));
        let tags = 1u32 << config.tag_bits.min(16);
        Ok(Run {
            watch: Watch::new(model)?,
            start_packet: model.port("watch_start_packet")?,
            start_tag: model.port("watch_start_tag")?,
            caster: Caster::new(image, config.triangle_test, config.rays_per_packet as usize),
            config,
            format,
            rays,
            options,
            model,
            memories,
            ray_port,
            hit_port,
            expected: (0..config.packets_in_flight).map(|_| None).collect(),
            by_tag: (0..tags).map(|_| None).collect(),
            free_tags: (0..tags).rev().collect(),
            hits: vec![Hit::MISS; rays.len()],
            hits_checked: 0,
            steps_checked: 0,
            tests_checked: 0,
            transforms_checked: 0,
            cycles: 0,
            reset_at: 0,
            counters: Counters::default(),
            samples: Vec::new(),
            rng: fastrand::Rng::with_seed(options.seed ^ 4),
        })
    }

    fn all(&mut self, progress: &dyn Fn(u64)) -> Result<()> {
        let size = self.config.rays_per_packet as usize;
        let total = self.rays.len().div_ceil(size) * size;
        self.model.reset(RESET_CYCLES);
        self.reset_at = self.model.cycles();
        let (mut offered, mut taken) = (0usize, 0usize);
        let mut shown: Option<usize> = None;
        let mut tag = 0;
        let mut idle = 0u64;
        let mut started = false;
        while taken < total {
            for memory in &mut self.memories {
                memory.show(self.model);
            }
            // A ray once offered stays until it is taken.
            if shown.is_none() && offered < total && !self.stalls(self.options.ray_stall) {
                if offered.is_multiple_of(size) {
                    tag = self
                        .free_tags
                        .pop()
                        .expect("more tags than packets in flight");
                }
                let ray = self.rays.get(offered).copied().unwrap_or(Ray::INACTIVE);
                // The tag of a packet's first ray counts for all.
                let shown_tag = match offered.is_multiple_of(size) {
                    true => tag,
                    false => self.rng.u32(..),
                };
                self.offer(&ray, shown_tag);
                shown = Some(offered);
            } else if shown.is_none() {
                self.model.set(self.ray_port.valid, 0);
            }
            let takes_hit = !self.stalls(self.options.hit_stall);
            self.model.set(self.hit_port.ready, u64::from(takes_hit));

            let mut events = self.watch_step()? | self.watch_test()? | self.watch_transform()?;
            if let Some(index) = shown
                && self.model.get(self.ray_port.ready) != 0
            {
                events = true;
                started = true;
                shown = None;
                offered += 1;
                if offered.is_multiple_of(size) {
                    self.start(index + 1 - size, tag)?;
                }
            }
            if takes_hit && self.model.get(self.hit_port.valid) != 0 {
                events = true;
                self.take_hit()?;
                taken += 1;
                if taken.is_multiple_of(4096) {
                    progress(taken as u64);
                }
            }
            for memory in &mut self.memories {
                memory.take(self.model)?;
            }
            self.model.clock();
            self.cycles += u64::from(started);
            if let Some(every) = self.options.sample_cycles
                && started
                && self.cycles.is_multiple_of(every)
            {
                self.samples.push(self.counters()?);
            }
            idle = if events { 0 } else { idle + 1 };
            if idle > PATIENCE {
                bail!(
                    "the machine is stuck: nothing happened for {PATIENCE} cycles up to cycle {}, {taken} of {total} rays are back; trace it with {} --trace stuck.fst --from {} --cycles 2000",
                    self.model.cycles(),
                    self.options.replay,
                    self.model.cycles().saturating_sub(PATIENCE + 1000)
                );
            }
        }
        progress(total as u64);
        self.end()
    }

    fn stalls(&mut self, probability: f64) -> bool {
        probability > 0.0 && self.rng.f64() < probability
    }

    fn offer(&mut self, ray: &Ray, tag: u32) {
        let f = self.format;
        let port = &self.ray_port;
        self.model.set(port.valid, 1);
        self.model.set(port.tag, u64::from(tag));
        let rng = &mut self.rng;
        let numbers = (0..3).flat_map(|i| {
            [
                (port.origin[i], ray.origin[i]),
                (port.direction[i], ray.direction[i]),
            ]
        });
        for (port, number) in numbers.chain([(port.tmin, ray.tmin), (port.tmax, ray.tmax)]) {
            self.model.set(port, disguised(f, f.to_bits(number), rng));
        }
        self.model.set(port.active, u64::from(ray.active));
        self.model.set(port.any_hit, u64::from(ray.any_hit));
    }

    /// A packet's last ray was taken: the golden model says what must come of it.
    fn start(&mut self, first_ray: usize, tag: u32) -> Result<()> {
        // A packet of one ray has the tag that stands at the port.
        self.model.eval();
        let shown = self.model.get(self.start_tag);
        if shown != u64::from(tag) {
            let fields = vec![Field::integer("tag", tag.into(), shown)];
            let place = format!("the packet that begins with ray {first_ray}");
            return Err(self.mismatch("raycast", place, fields));
        }
        let size = self.config.rays_per_packet as usize;
        let packet = self.model.get(self.start_packet) as usize;
        let rays = &self.rays[first_ray..(first_ray + size).min(self.rays.len())];
        let mut expected = Expected {
            first_ray,
            ..Expected::default()
        };
        expected.hits = self.caster.cast(rays, &mut expected).hits;
        expected.hits.resize(size, Hit::MISS);
        self.expected[packet] = Some(expected);
        self.by_tag[tag as usize] = Some((packet, 0));
        Ok(())
    }

    fn mismatch(&self, unit: &'static str, place: String, fields: Vec<Field>) -> anyhow::Error {
        Mismatch {
            unit,
            place,
            cycle: self.model.cycles(),
            fields,
            replay: self.options.replay.clone(),
        }
        .into()
    }

    fn expected(&self, unit: &'static str, packet: usize) -> Result<&Expected> {
        self.expected[packet].as_ref().ok_or_else(|| {
            self.mismatch(
                unit,
                format!("an event of packet {packet}, which is not under way"),
                vec![],
            )
        })
    }

    fn watch_step(&mut self) -> Result<bool> {
        let w = &self.watch;
        if self.model.get(w.step_valid) == 0 {
            return Ok(false);
        }
        let packet = self.model.get(w.step_packet) as usize;
        let expected = self.expected("tpu", packet)?;
        let rays = self.config.rays_per_packet;
        let width = self.format.width();
        let at = expected.next_step;
        let place = || {
            format!(
                "packet step {at} of the packet of rays {} to {}",
                expected.first_ray,
                expected.first_ray + rays as usize - 1
            )
        };
        let Some(golden) = expected.steps.get(at) else {
            let node = self.model.get(w.step_node);
            return Err(self.mismatch(
                "tpu",
                format!(
                    "{}, which has only {}: node {node}",
                    place(),
                    expected.steps.len()
                ),
                vec![],
            ));
        };
        let masks = [self.model.get(w.step_left), self.model.get(w.step_right)];
        let both = golden.left.mask != 0 && golden.right.mask != 0;
        let mut agrees = self.model.get(w.step_node) == u64::from(golden.node)
            && masks == [u64::from(golden.left.mask), u64::from(golden.right.mask)]
            && (!both || (self.model.get(w.step_left_first) != 0) == (golden.left_first != 0));
        for (set, port) in [&golden.left, &golden.right].into_iter().zip(w.intervals) {
            for k in 0..rays {
                if set.mask >> k & 1 != 0 {
                    let near = self.model.get_field(port, 2 * k * width, width);
                    let far = self.model.get_field(port, (2 * k + 1) * width, width);
                    agrees &= near == self.format.to_bits(set.near[k as usize])
                        && far == self.format.to_bits(set.far[k as usize]);
                }
            }
        }
        if !agrees {
            let get = |port| self.model.get(port);
            let mut fields = vec![
                Field::integer("node", u64::from(golden.node), get(w.step_node)),
                Field::integer("rays that go left", u64::from(golden.left.mask), masks[0]),
                Field::integer("rays that go right", u64::from(golden.right.mask), masks[1]),
            ];
            if both {
                fields.push(Field::integer(
                    "left first",
                    u64::from(golden.left_first != 0),
                    get(w.step_left_first),
                ));
            }
            for (name, set, port) in [
                ("left", &golden.left, w.intervals[0]),
                ("right", &golden.right, w.intervals[1]),
            ] {
                for k in (0..rays).filter(|k| set.mask >> k & 1 != 0) {
                    for (which, value, lsb) in [
                        ("near", set.near[k as usize], 2 * k * width),
                        ("far", set.far[k as usize], (2 * k + 1) * width),
                    ] {
                        fields.push(Field::number(
                            format!("ray {k} {name} {which}"),
                            self.format,
                            self.format.to_bits(value),
                            self.model.get_field(port, lsb, width),
                        ));
                    }
                }
            }
            return Err(self.mismatch("tpu", place(), fields));
        }
        if let Some(expected) = &mut self.expected[packet] {
            expected.next_step += 1;
        }
        self.steps_checked += 1;
        Ok(true)
    }

    fn watch_test(&mut self) -> Result<bool> {
        let w = &self.watch;
        if self.model.get(w.test_valid) == 0 {
            return Ok(false);
        }
        let packet = self.model.get(w.test_packet) as usize;
        let expected = self.expected("geometry", packet)?;
        let at = expected.next_test;
        let rays = self.config.rays_per_packet as usize;
        let place = |slot: usize| {
            format!(
                "ray-triangle test {at} of its packet, ray {}",
                expected.first_ray + slot
            )
        };
        let get = |port| self.model.get(port);
        let Some(golden) = expected.tests.get(at) else {
            return Err(self.mismatch(
                "geometry",
                format!(
                    "{}: the packet of {rays} rays has only {} tests",
                    place(get(w.test_ray) as usize),
                    expected.tests.len()
                ),
                vec![],
            ));
        };
        let outcome = &golden.outcome;
        let numbers = [outcome.t, outcome.raw[1], outcome.raw[2]].map(|x| self.format.to_bits(x));
        let agrees = get(w.test_ray) == u64::from(golden.slot)
            && get(w.test_record) == u64::from(golden.record)
            && get(w.test_instance) == u64::from(golden.instance)
            && (get(w.test_hit) != 0) == outcome.hit
            && (!outcome.hit || w.test_numbers.map(get) == numbers);
        if !agrees {
            let mut fields = vec![
                Field::integer("ray of the packet", u64::from(golden.slot), get(w.test_ray)),
                Field::integer("record", u64::from(golden.record), get(w.test_record)),
                Field::integer("instance", u64::from(golden.instance), get(w.test_instance)),
                Field::integer("hit", u64::from(outcome.hit), get(w.test_hit)),
            ];
            for (i, name) in ["t", "u", "v"].into_iter().enumerate() {
                fields.push(Field::number(
                    name,
                    self.format,
                    numbers[i],
                    get(w.test_numbers[i]),
                ));
            }
            return Err(self.mismatch("geometry", place(golden.slot.into()), fields));
        }
        if let Some(expected) = &mut self.expected[packet] {
            expected.next_test += 1;
        }
        self.tests_checked += 1;
        Ok(true)
    }

    fn watch_transform(&mut self) -> Result<bool> {
        let watch = &self.watch.transform;
        let Some(packet) = watch.packet(self.model) else {
            return Ok(false);
        };
        let expected = self.expected("geometry", packet)?;
        let at = expected.next_transform;
        let first_ray = expected.first_ray;
        let Some(golden) = expected.transforms.get(at) else {
            let count = expected.transforms.len();
            let place = format!(
                "ray transformation {at} of the packet of ray {first_ray}, which has only {count}"
            );
            return Err(self.mismatch("geometry", place, vec![]));
        };
        let fields = watch.compare(self.model, self.format, golden);
        if !fields.is_empty() {
            let place = format!(
                "ray transformation {at} of its packet, ray {}, to instance {}",
                first_ray + usize::from(golden.slot),
                golden.instance
            );
            return Err(self.mismatch("geometry", place, fields));
        }
        if let Some(expected) = &mut self.expected[packet] {
            expected.next_transform += 1;
        }
        self.transforms_checked += 1;
        Ok(true)
    }

    fn take_hit(&mut self) -> Result<()> {
        let port = &self.hit_port;
        let get = |handle| self.model.get(handle);
        let tag = get(port.tag) as usize;
        let Some((packet, slot)) = self.by_tag.get(tag).copied().flatten() else {
            return Err(self.mismatch(
                "raycast",
                format!("a hit of tag {tag}, which is not under way"),
                vec![],
            ));
        };
        let size = self.config.rays_per_packet as usize;
        let expected = self.expected("raycast", packet)?;
        let golden = expected.hits[slot];
        let numbers = [golden.t, golden.u, golden.v].map(|x| self.format.to_bits(x));
        let identities = [golden.instance, golden.triangle].map(u64::from);
        let index = expected.first_ray + slot;
        if port.numbers.map(get) != numbers
            || [get(port.instance), get(port.triangle)] != identities
        {
            let mut fields: Vec<_> = ["t", "u", "v"]
                .into_iter()
                .enumerate()
                .map(|(i, name)| Field::number(name, self.format, numbers[i], get(port.numbers[i])))
                .collect();
            fields.push(Field::integer(
                "instance",
                identities[0],
                get(port.instance),
            ));
            fields.push(Field::integer(
                "triangle",
                identities[1],
                get(port.triangle),
            ));
            return Err(self.mismatch("raycast", format!("the hit of ray {index}"), fields));
        }
        let finished = slot + 1 == size;
        let work = [
            ("packet steps", expected.steps.len(), expected.next_step),
            (
                "ray-triangle tests",
                expected.tests.len(),
                expected.next_test,
            ),
            (
                "ray transformations",
                expected.transforms.len(),
                expected.next_transform,
            ),
        ];
        if finished && work.iter().any(|(_, golden, rtl)| golden != rtl) {
            let fields = work
                .into_iter()
                .map(|(name, golden, rtl)| Field::integer(name, golden as u64, rtl as u64))
                .collect();
            return Err(self.mismatch(
                "raycast",
                format!("the work done for the packet of ray {index}"),
                fields,
            ));
        }
        if let Some(hit) = self.hits.get_mut(index) {
            let [t, u, v] = port.numbers.map(|p| self.format.to_f64(self.model.get(p)));
            *hit = Hit {
                t,
                u,
                v,
                instance: self.model.get(port.instance) as u32,
                triangle: self.model.get(port.triangle) as u32,
            };
            debug_assert!(hit.triangle != NONE || hit.u == 0.0);
            self.hits_checked += 1;
        }
        if finished {
            self.expected[packet] = None;
            self.by_tag[tag] = None;
            self.free_tags.push(tag as u32);
        } else {
            self.by_tag[tag] = Some((packet, slot + 1));
        }
        Ok(())
    }

    fn counter(&self, name: &str) -> Result<u64> {
        Ok(self.model.get(self.model.port(name)?))
    }

    fn counters(&self) -> Result<Counters> {
        let counter = |name: &str| self.counter(name);
        Ok(Counters {
            cycles: counter("count_cycles")?,
            packet_steps: counter("count_packet_steps")?,
            ray_triangle_tests: counter("count_ray_triangle_tests")?,
            ray_transforms: counter("count_ray_transforms")?,
            tpu_busy_cycles: counter("count_tpu_busy_cycles")?,
            tpu_starved_cycles: counter("count_tpu_starved_cycles")?,
            gu_busy_cycles: counter("count_gu_busy_cycles")?,
            gu_starved_cycles: counter("count_gu_starved_cycles")?,
            stack_high_water: counter("stack_high_water")?,
        })
    }

    /// Reads what the unit counted, and holds it against what was seen of it.
    fn end(&mut self) -> Result<()> {
        self.counters = self.counters()?;
        ensure!(
            self.counter("stack_overflow")? == 0,
            "the machine flags a stack overflow"
        );
        let counted = [
            (
                "packet steps",
                self.steps_checked,
                self.counters.packet_steps,
            ),
            (
                "ray-triangle tests",
                self.tests_checked,
                self.counters.ray_triangle_tests,
            ),
            (
                "ray transformations",
                self.transforms_checked,
                self.counters.ray_transforms,
            ),
            (
                "clocks",
                self.model.cycles() - self.reset_at,
                self.counters.cycles,
            ),
            (
                "clocks of the traversal unit",
                self.steps_checked,
                self.counters.tpu_busy_cycles,
            ),
            (
                "clocks of the geometry unit",
                self.tests_checked + SLOTS_OF_TRANSFORM * self.transforms_checked,
                self.counters.gu_busy_cycles,
            ),
            // With both of them busy or not, as many clocks had packets under way.
            (
                "clocks with packets",
                self.counters.tpu_busy_cycles + self.counters.tpu_starved_cycles,
                self.counters.gu_busy_cycles + self.counters.gu_starved_cycles,
            ),
        ];
        if counted.iter().any(|(_, golden, rtl)| golden != rtl) {
            let fields = counted
                .into_iter()
                .map(|(name, golden, rtl)| Field::integer(name, golden, rtl))
                .collect();
            return Err(self.mismatch("raycast", "the machine's own counters".into(), fields));
        }
        Ok(())
    }
}
