//! Co-simulation of the whole ray casting unit: compares hits, packet steps, ray transformations and ray–triangle tests
//! with the golden model, in all bits.

use super::memory::{Image, ReadHandles, ReadPort, ReadRequest, Timing};
use super::mismatch::{Field, Mismatch};
use super::model::{BuildOptions, Model, PortHandle, Trace, build};
use super::scoreboard::{
    DISTURBED_CYCLES, Interrupted, Mutated, RECORDED_CYCLES, RESET_CYCLES, Recorder, sources_with,
};
use super::{TRACED, timing};
use crate::bkd::layout::{MemoryImage, Record};
use crate::config::Config;
use crate::float::Format;
use crate::golden::{Caster, EnterEvent, Observer, Outcome, RayTest, StepEvent};
use crate::hdl::{self, Bundle};
use crate::hw::geometry::{TestTrace, TransformTrace};
use crate::hw::ray::{Interval, Line};
use crate::hw::tpu::StepTrace;
use crate::hw::{self, Plan};
use crate::port::{Hit, NONE, Ray};
use anyhow::{Result, bail, ensure};
use std::time::Instant;

/// Number of cycles without an event after which a run ends as stuck.
const PATIENCE: u64 = 200_000;

/// Options of a run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Seed of the memories' jitter and of the stalls.
    pub seed: u64,
    /// Share of the cycles in which no ray is offered, 0 to 1.
    pub ray_stall: f64,
    /// Share of the cycles in which no hit is accepted, 0 to 1.
    pub hit_stall: f64,
    /// Cycles between two of the [`Report::samples`]; `None`: no samples.
    pub sample_cycles: Option<u64>,
    pub trace: Option<Trace>,
    /// The command that repeats the run, for a mismatch's report.
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

/// The result of a run.
#[derive(Clone, Debug)]
pub struct Report {
    /// The hits of the RTL, one per given ray, in order.
    pub hits: Vec<Hit>,
    /// Number of hits, packet steps, ray–triangle tests and ray transformations that were compared in all bits and agree.
    pub hits_checked: u64,
    pub steps_checked: u64,
    pub tests_checked: u64,
    pub transforms_checked: u64,
    /// From the first ray offered to the last hit accepted.
    pub cycles: u64,
    /// The RTL's own counters.
    pub counters: Counters,
    /// Maximum number of entries in a packet's stack.
    pub stack_high_water: u64,
    /// The counters after every [`Options::sample_cycles`] cycles.
    pub samples: Vec<Counters>,
    pub model_build_s: f64,
    pub model_reused: bool,
    pub simulate_s: f64,
}

/// Number of slots of the triangle test that one ray transformation uses.
const SLOTS_OF_TRANSFORM: u64 = 3;

/// Another pattern with the same meaning: the fraction of a zero or a NaN is arbitrary.
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

/// The counters of the ray casting unit since the last reset.
pub type Counters = hw::raycast::Counters<u64>;

impl Report {
    pub fn checked(&self) -> u64 {
        self.hits_checked + self.steps_checked + self.tests_checked + self.transforms_checked
    }

    pub fn rays_per_clock(&self) -> f64 {
        self.hits.len() as f64 / self.cycles as f64
    }

    /// Packet steps per cycle.
    pub fn tpu_utilisation(&self) -> f64 {
        self.counters.packet_steps as f64 / self.cycles as f64
    }

    /// Used slots of the triangle test per cycle: one per ray–triangle test, three per ray transformation.
    pub fn gu_utilisation(&self) -> f64 {
        self.counters.gu_busy_cycles as f64 / self.cycles as f64
    }
}

/// The golden model's events of one packet, and the RTL's progress in them.
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

/// A tagged read port of the model with its memory.
pub(super) struct MemoryPort {
    name: String,
    port: ReadPort,
    image: Image,
    handles: ReadHandles,
    shown_ready: bool,
    shown_valid: bool,
    next: Option<super::memory::ReadResponse>,
    /// A request that was shown and not accepted; it must be shown again unchanged.
    waiting: Option<ReadRequest>,
}

impl MemoryPort {
    pub(super) fn new(
        model: &mut Model,
        name: &str,
        handles: ReadHandles,
        image: Image,
        timing: Timing,
    ) -> Result<Self> {
        model.set(handles.request.ready, 0);
        model.set(handles.response.valid, 0);
        Ok(MemoryPort {
            name: name.to_string(),
            port: ReadPort::new(name, image.rows(), timing)?,
            image,
            handles,
            shown_ready: false,
            shown_valid: false,
            next: None,
            waiting: None,
        })
    }

    /// Before a clock edge: drives the memory's response, and whether it accepts a request.
    pub(super) fn show(&mut self, model: &mut Model) {
        let ready = self.port.ready();
        if ready != self.shown_ready {
            model.set(self.handles.request.ready, u64::from(ready));
            self.shown_ready = ready;
        }
        let data = (self.next).map_or(&[][..], |response| self.image.row(response.address));
        if self.next.is_some() || self.shown_valid {
            model.respond(&self.handles, self.next, data);
        }
        self.shown_valid = self.next.is_some();
    }

    /// At the same edge: accepts the request that the model offers.
    pub(super) fn take(&mut self, model: &Model) -> Result<()> {
        let request = model.read_request(&self.handles);
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

type Ports = hdl::Ports<hw::raycast::Inputs<PortHandle>, hw::raycast::Outputs<PortHandle>>;

/// Compares a traced packet step with the golden model's: no fields if they are equal, otherwise all fields.
pub(super) fn compare_step(
    model: &Model,
    ports: &StepTrace<PortHandle>,
    format: Format,
    golden: &StepEvent,
) -> Vec<Field> {
    let (shown, width) = (model.sample(ports), format.width());
    let [left, right] = [&golden.left, &golden.right];
    // Left first, if a ray that enters both children goes there first, or if no ray enters the right child.
    let left_first = left.mask != 0 && (golden.left_first != 0 || right.mask == 0);
    let integers = [
        ("node", golden.node.into(), shown.node),
        ("rays that go left", left.mask.into(), shown.left),
        ("rays that go right", right.mask.into(), shown.right),
        ("left first", left_first.into(), shown.left_first),
    ];
    let sides = [
        ("left", left, ports.left_intervals),
        ("right", right, ports.right_intervals),
    ];
    // Near and far of all rays that enter.
    let numbers = sides.into_iter().flat_map(|(side, set, port)| {
        let rays = (0..u8::BITS).filter(|k| set.mask >> k & 1 != 0);
        rays.flat_map(move |k| {
            let ends = [("near", set.near, 2 * k), ("far", set.far, 2 * k + 1)];
            ends.map(|(end, of, place)| {
                let rtl = model.get_field(port, place * width, width);
                ((k, side, end), format.to_bits(of[k as usize]), rtl)
            })
        })
    });
    if integers.iter().all(|(_, golden, rtl)| golden == rtl)
        && numbers.clone().all(|(_, golden, rtl)| golden == rtl)
    {
        return vec![];
    }
    let integers = integers.map(|(name, golden, rtl)| Field::integer(name, golden, rtl));
    let numbers = numbers.map(|((ray, side, end), golden, rtl)| {
        Field::number(format!("ray {ray} {side} {end}"), format, golden, rtl)
    });
    integers.into_iter().chain(numbers).collect()
}

/// The required t, u and v of a test: those of a hit; for a miss any values.
pub(super) fn test_numbers(shown: &TestTrace<u64>, format: Format, golden: &Outcome) -> [u64; 3] {
    match golden.hit {
        true => [golden.t, golden.raw[1], golden.raw[2]].map(|x| format.to_bits(x)),
        false => [shown.t, shown.u, shown.v],
    }
}

/// Compares a traced ray–triangle test with the expected one: no fields if they are equal, otherwise all fields.
pub(super) fn compare_test(
    shown: &TestTrace<u64>,
    format: Format,
    expected: &TestTrace<u64>,
) -> Vec<Field> {
    if shown == expected {
        return vec![];
    }
    let integers = [
        ("ray of the packet", expected.ray, shown.ray),
        ("record", expected.record, shown.record),
        ("instance", expected.instance, shown.instance),
        ("hit", expected.hit, shown.hit),
        ("replaces the closest", expected.replaces, shown.replaces),
    ];
    let numbers = [
        ("t", expected.t, shown.t),
        ("u", expected.u, shown.u),
        ("v", expected.v, shown.v),
    ];
    let integers = integers.map(|(name, golden, rtl)| Field::integer(name, golden, rtl));
    let numbers = numbers.map(|(name, golden, rtl)| Field::number(name, format, golden, rtl));
    integers.into_iter().chain(numbers).collect()
}

/// Compares a traced ray transformation with the golden model's: no fields if they are equal, otherwise all fields.
pub(super) fn compare_transform(
    shown: &TransformTrace<u64>,
    format: Format,
    golden: &EnterEvent,
) -> Vec<Field> {
    let transformed = &golden.transformed;
    let [near, far] = transformed.window.map(|x| format.to_bits(x));
    let expected = TransformTrace {
        packet: shown.packet,
        ray: golden.slot.into(),
        record: golden.record.into(),
        window: Interval { near, far },
        line: Line {
            origin: transformed.ray.origin.map(|x| format.to_bits(x)),
            direction: transformed.ray.direction.map(|x| format.to_bits(x)),
        },
    };
    if *shown == expected {
        return vec![];
    }
    let mut fields = vec![
        Field::integer("ray of the packet", expected.ray, shown.ray),
        Field::integer("instance record", expected.record, shown.record),
    ];
    let numbers = (expected.window.zip(shown.window).fields().into_iter())
        .chain(expected.line.zip(shown.line).fields());
    fields.extend(numbers.map(|(name, (golden, rtl))| Field::number(name, format, golden, rtl)));
    fields
}

/// Casts `rays`, in packets of the machine's size, in the RTL of `config` with the scene `image`, and compares all events.
/// Inactive rays fill the last packet. `progress` receives the number of rays that have returned.
///
/// # Errors
/// The first mismatch, or an error if the machine stops, if a tool is missing, or if there are no rays.
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
    ports: Ports,
    model_build_s: f64,
    model_reused: bool,
    /// The selected mutant, if there are mutants.
    mutated: Option<Mutated>,
}

impl RaycastUnit {
    /// Builds the unit of a machine, with support for the trace if one is given.
    ///
    /// # Errors
    /// If a tool is missing.
    pub fn new(config: &Config, trace: Option<&Trace>) -> Result<RaycastUnit> {
        Self::build(config, trace, &BuildOptions::default(), None)
    }

    /// The same, with the model built as `how` states; a model with a trace is always built for tracing.
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
    /// If a tool is missing.
    pub fn mutated(config: &Config, mutated: Option<&Mutated>) -> Result<RaycastUnit> {
        Self::build(config, None, &BuildOptions::default(), mutated)
    }

    fn build(
        config: &Config,
        trace: Option<&Trace>,
        how: &BuildOptions,
        mutated: Option<&Mutated>,
    ) -> Result<RaycastUnit> {
        let plan = Plan::new(config)?.with_trace(true);
        let machine = hw::emit(&plan)?;
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
            ports: model.ports(&hw::raycast::ports(&plan))?,
            model,
            model_build_s,
            model_reused: built.reused,
            mutated: mutated.cloned(),
        })
    }

    /// Makes the reset of the next picture interrupt earlier traffic.
    ///
    /// # Errors
    /// If the traffic belongs to another machine.
    pub fn interrupt(&mut self, interrupted: &Interrupted) -> Result<()> {
        self.model.reset(RESET_CYCLES);
        self.model.play(&interrupted.traffic, interrupted.at)?;
        // After playing, every input is 0.
        match &self.mutated {
            Some(mutated) => mutated.select(&mut self.model),
            None => Ok(()),
        }
    }

    /// Records the traffic from now on, for [`RaycastUnit::recorded`].
    pub fn record(&mut self) {
        self.model.record(RECORDED_CYCLES);
    }

    /// Stores the recorded traffic in a recorder.
    pub fn recorded(&mut self, recorder: &Recorder) {
        recorder.put(self.model.recorded());
    }

    /// Number of cycles simulated so far, including resets, as in mismatches and traces.
    pub fn cycles(&self) -> u64 {
        self.model.cycles()
    }

    /// Resets the unit and casts rays as [`run`] does, with the same options except for the trace.
    ///
    /// # Errors
    /// The first mismatch, or an error if the machine stops, if there are no rays, or if the machine cannot hold the image.
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
        let mut run = Run::new(self, image, rays, options)?;
        run.all(progress)?;
        Ok(Report {
            hits: run.hits,
            hits_checked: run.hits_checked,
            steps_checked: run.steps_checked,
            tests_checked: run.tests_checked,
            transforms_checked: run.transforms_checked,
            cycles: run.cycles,
            counters: run.counters,
            stack_high_water: run.stack_high_water,
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
    ports: Ports,
    /// By packet number in flight: the packet's expected events.
    expected: Vec<Option<Expected>>,
    /// By tag: the packet's number in flight, and the number of its rays that have returned.
    by_tag: Vec<Option<(usize, usize)>>,
    free_tags: Vec<u32>,
    hits: Vec<Hit>,
    hits_checked: u64,
    steps_checked: u64,
    tests_checked: u64,
    transforms_checked: u64,
    cycles: u64,
    /// The model's cycle at the end of the last reset.
    reset_at: u64,
    counters: Counters,
    stack_high_water: u64,
    samples: Vec<Counters>,
    rng: fastrand::Rng,
}

impl<'a> Run<'a> {
    fn new(
        unit: &'a mut RaycastUnit,
        image: &MemoryImage,
        rays: &'a [Ray],
        options: &'a Options,
    ) -> Result<Self> {
        let RaycastUnit {
            config,
            model,
            ports,
            ..
        } = unit;
        let (config, ports) = (&*config, *ports);
        let Ports { inputs, outputs } = ports;
        let format = config.format();
        let node = Image::from_words(image.node_words(), Record::node(format).width)?;
        let record = Image::from_words(image.record_words(), Record::triangle().width)?;
        let vertex = Image::from_words(image.vertex_words(), Record::vertex(format).width)?;
        let nodes = ReadHandles::of_unit(outputs.node, inputs.node);
        let records = ReadHandles::of_unit(outputs.record, inputs.record);
        let vertices = ReadHandles::of_unit(outputs.vertex, inputs.vertex);
        let timing = |seed| timing(config, options.seed ^ seed);
        let memories = [
            MemoryPort::new(model, "node", nodes, node, timing(1))?,
            MemoryPort::new(model, "record", records, record, timing(2))?,
            MemoryPort::new(model, "vertex", vertices, vertex, timing(3))?,
        ];
        let (lo, hi) = image.bounds;
        for (ports, values) in [(inputs.scene_lo, lo), (inputs.scene_hi, hi)] {
            for (port, value) in ports.into_iter().zip(values) {
                model.set(port, format.to_bits(value));
            }
        }
        model.set(inputs.scene_root, u64::from(image.root.pack()));
        let tags = 1u32 << config.tag_bits.min(16);
        Ok(Run {
            caster: Caster::new(image, config.triangle_test, config.rays_per_packet as usize),
            config,
            format,
            rays,
            options,
            model,
            memories,
            ports,
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
            counters: hw::raycast::Counters::of().map(|_, _| 0),
            stack_high_water: 0,
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
            // An offered ray stays until it is accepted.
            if shown.is_none() && offered < total && !self.stalls(self.options.ray_stall) {
                if offered.is_multiple_of(size) {
                    tag = self
                        .free_tags
                        .pop()
                        .expect("more tags than packets in flight");
                }
                let ray = self.rays.get(offered).copied().unwrap_or(Ray::INACTIVE);
                // The tag of a packet's first ray applies to the packet.
                let shown_tag = match offered.is_multiple_of(size) {
                    true => tag,
                    false => self.rng.u32(..),
                };
                self.offer(&ray, shown_tag);
                shown = Some(offered);
            } else if shown.is_none() {
                self.model.set(self.ports.inputs.ray.valid, 0);
            }
            let takes_hit = !self.stalls(self.options.hit_stall);
            self.model
                .set(self.ports.inputs.hit_ready, u64::from(takes_hit));

            let mut events = self.check_step()? | self.check_test()? | self.check_transform()?;
            if let Some(index) = shown
                && self.model.get(self.ports.outputs.ray_ready) != 0
            {
                events = true;
                started = true;
                shown = None;
                offered += 1;
                if offered.is_multiple_of(size) {
                    self.start(index + 1 - size, tag)?;
                }
            }
            if takes_hit && self.model.get(self.ports.outputs.hit.valid) != 0 {
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
                self.samples.push(self.counters());
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
        let port = &self.ports.inputs.ray;
        self.model.set(port.valid, 1);
        let port = &port.payload;
        self.model.set(port.tag, u64::from(tag));
        let rng = &mut self.rng;
        let numbers = (0..3).flat_map(|i| {
            [
                (port.line.origin[i], ray.origin[i]),
                (port.line.direction[i], ray.direction[i]),
            ]
        });
        for (port, number) in
            numbers.chain([(port.limits.tmin, ray.tmin), (port.limits.tmax, ray.tmax)])
        {
            self.model.set(port, disguised(f, f.to_bits(number), rng));
        }
        self.model.set(port.active, u64::from(ray.active));
        self.model.set(port.any_hit, u64::from(ray.any_hit));
    }

    /// The last ray of a packet was accepted: computes the expected events with the golden model.
    fn start(&mut self, first_ray: usize, tag: u32) -> Result<()> {
        // A packet of one ray has the tag that is currently at the port.
        self.model.eval();
        let trace = self.ports.outputs.trace_start.expect(TRACED).payload;
        let shown = self.model.get(trace.tag);
        if shown != u64::from(tag) {
            let fields = vec![Field::integer("tag", tag.into(), shown)];
            let place = format!("the packet that begins with ray {first_ray}");
            return Err(self.mismatch("raycast", place, fields));
        }
        let size = self.config.rays_per_packet as usize;
        let packet = self.model.get(trace.packet) as usize;
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
                format!("an event of packet {packet}, which is not in flight"),
                vec![],
            )
        })
    }

    fn check_step(&mut self) -> Result<bool> {
        let trace = self.ports.outputs.trace_step.as_ref().expect(TRACED);
        if self.model.get(trace.valid) == 0 {
            return Ok(false);
        }
        let packet = self.model.get(trace.payload.packet) as usize;
        let expected = self.expected("tpu", packet)?;
        let (at, first) = (expected.next_step, expected.first_ray);
        let last = first + self.config.rays_per_packet as usize - 1;
        let place = || format!("packet step {at} of the packet of rays {first} to {last}");
        let Some(golden) = expected.steps.get(at) else {
            let (node, steps) = (self.model.get(trace.payload.node), expected.steps.len());
            let place = format!("{}, which has only {steps}: node {node}", place());
            return Err(self.mismatch("tpu", place, vec![]));
        };
        let fields = compare_step(self.model, &trace.payload, self.format, golden);
        if !fields.is_empty() {
            return Err(self.mismatch("tpu", place(), fields));
        }
        if let Some(expected) = &mut self.expected[packet] {
            expected.next_step += 1;
        }
        self.steps_checked += 1;
        Ok(true)
    }

    fn check_test(&mut self) -> Result<bool> {
        let trace = self.ports.outputs.trace_test.as_ref().expect(TRACED);
        if self.model.get(trace.valid) == 0 {
            return Ok(false);
        }
        let test = self.model.sample(&trace.payload);
        let packet = test.packet as usize;
        let expected = self.expected("geometry", packet)?;
        let at = expected.next_test;
        let rays = self.config.rays_per_packet as usize;
        let place = |slot: usize| {
            format!(
                "ray-triangle test {at} of its packet, ray {}",
                expected.first_ray + slot
            )
        };
        let Some(golden) = expected.tests.get(at) else {
            return Err(self.mismatch(
                "geometry",
                format!(
                    "{}: the packet of {rays} rays has only {} tests",
                    place(test.ray as usize),
                    expected.tests.len()
                ),
                vec![],
            ));
        };
        let [t, u, v] = test_numbers(&test, self.format, &golden.outcome);
        let expected = TestTrace {
            ray: golden.slot.into(),
            record: golden.record.into(),
            instance: golden.instance.into(),
            hit: golden.outcome.hit.into(),
            t,
            u,
            v,
            ..test
        };
        let fields = compare_test(&test, self.format, &expected);
        if !fields.is_empty() {
            return Err(self.mismatch("geometry", place(golden.slot.into()), fields));
        }
        if let Some(expected) = &mut self.expected[packet] {
            expected.next_test += 1;
        }
        self.tests_checked += 1;
        Ok(true)
    }

    fn check_transform(&mut self) -> Result<bool> {
        let trace = &self.ports.outputs.trace_transform.expect(TRACED);
        if self.model.get(trace.valid) == 0 {
            return Ok(false);
        }
        let shown = self.model.sample(&trace.payload);
        let packet = shown.packet as usize;
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
        let fields = compare_transform(&shown, self.format, golden);
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
        let shown = self.model.sample(&self.ports.outputs.hit.payload);
        let tag = shown.tag as usize;
        let shown = shown.hit;
        let rtl = [shown.t, shown.u, shown.v];
        let Some((packet, slot)) = self.by_tag.get(tag).copied().flatten() else {
            return Err(self.mismatch(
                "raycast",
                format!("a hit of tag {tag}, which is not in flight"),
                vec![],
            ));
        };
        let size = self.config.rays_per_packet as usize;
        let expected = self.expected("raycast", packet)?;
        let golden = expected.hits[slot];
        let numbers = [golden.t, golden.u, golden.v].map(|x| self.format.to_bits(x));
        let identities = [golden.instance, golden.triangle].map(u64::from);
        let index = expected.first_ray + slot;
        if rtl != numbers || [shown.instance, shown.triangle] != identities {
            let mut fields: Vec<_> = ["t", "u", "v"]
                .into_iter()
                .enumerate()
                .map(|(i, name)| Field::number(name, self.format, numbers[i], rtl[i]))
                .collect();
            fields.push(Field::integer("instance", identities[0], shown.instance));
            fields.push(Field::integer("triangle", identities[1], shown.triangle));
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
            let [t, u, v] = rtl.map(|bits| self.format.to_f64(bits));
            *hit = Hit {
                t,
                u,
                v,
                instance: shown.instance as u32,
                triangle: shown.triangle as u32,
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

    fn counters(&self) -> Counters {
        self.model.sample(&self.ports.outputs.count)
    }

    /// Reads the unit's counters, and compares them with the observed events.
    fn end(&mut self) -> Result<()> {
        self.counters = self.counters();
        self.stack_high_water = self.model.get(self.ports.outputs.stack_high_water);
        ensure!(
            self.model.get(self.ports.outputs.stack_overflow) == 0,
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
            // For both units, busy and starved cycles add up to the cycles with packets in flight.
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
