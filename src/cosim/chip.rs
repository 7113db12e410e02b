//! The whole chip between its two buses: a host writes registers, memory answers bursts, and at the end every byte of memory is held
//! against the golden chip.

mod host;

use super::axi::{Accepted, Bytes, Decision, Edge, Handles, Pace, RandomPace, Slave, View};
use super::dram::DramPace;
use super::mismatch::{Field, Mismatch};
use super::model::{BuildOptions, Model, PortHandle, Sources, Trace, build};
use super::scoreboard::{DISTURBED_CYCLES, RESET_CYCLES};
use crate::chip::memory::Memory;
use crate::chip::registers::{self, COUNTERS, interrupt, offset};
use crate::config::Config;
use crate::golden::chip::{self as golden, Outcome};
use crate::hdl::{self, Design};
use crate::hw::chip::registers::LiteOutputs;
use crate::hw::chip::{self, Client, monitored};
use crate::hw::core::default_prefix;
use crate::hw::{Plan, memory::axi::Bus};
use anyhow::{Result, ensure};
use std::collections::{HashMap, VecDeque};
use std::time::Instant;

/// Cycles without a transfer on the memory bus after which a run is given up as stuck.
const PATIENCE: u64 = 100_000;

/// Descriptors after which the golden chip gives up a list.
const MOST_DESCRIPTORS: usize = 1 << 20;

/// Cycles between reports of progress.
const PROGRESS: u64 = 1 << 14;

/// How memory behaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Behaviour {
    /// As the memory model of the configuration.
    Model,
    /// Any order of identifiers, interleaved beats, stalls on every channel; drawn anew for each list.
    Random,
}

/// How to run.
#[derive(Clone, Debug)]
pub struct Options {
    pub seed: u64,
    pub behaviour: Behaviour,
    pub trace: Option<Trace>,
    /// Whether [`Report::events`] are collected; the model then has trace ports.
    pub events: bool,
    /// What a person types to run this again, for a mismatch's report.
    pub replay: String,
    pub build: BuildOptions,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            seed: 1,
            behaviour: Behaviour::Model,
            trace: None,
            events: false,
            replay: String::new(),
            build: BuildOptions::default(),
        }
    }
}

/// What has crossed the memory bus.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    pub read_bursts: u64,
    pub write_bursts: u64,
    /// Whole beats, whatever their strobes are.
    pub bytes_read: u64,
    pub bytes_written: u64,
    /// Of those read, the bytes of rays.
    pub bytes_of_rays: u64,
}

/// Cycles of a [`Event::Activity`].
pub const ACTIVITY_CYCLES: u64 = 256;

/// Something that happened in a run. Cycles count from the doorbell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// A read burst, from its address to its last beat.
    Read {
        client: Option<Client>,
        address: u32,
        begin: u64,
        end: u64,
    },
    /// A write burst, from its address to its response.
    Write { address: u32, begin: u64, end: u64 },
    /// A packet, from its last ray to its last hit.
    Packet { tag: u64, begin: u64, end: u64 },
    /// What happened in the [`ACTIVITY_CYCLES`] cycles before.
    Activity {
        cycle: u64,
        steps: u64,
        tests: u64,
        bytes: u64,
    },
}

/// Collects events.
#[derive(Default)]
struct Collector {
    events: Vec<Event>,
    reads: Vec<(Accepted, u64)>,
    writes: VecDeque<(u32, u64)>,
    packets: HashMap<u64, (u64, u64)>,
    steps: u64,
    tests: u64,
    bytes: u64,
}

/// What the run of a list found.
#[derive(Clone, Debug)]
pub struct Report {
    pub outcome: Outcome,
    /// Bytes of memory that were compared and agree.
    pub checked: u64,
    /// From the doorbell to the interrupt.
    pub cycles: u64,
    pub traffic: Traffic,
    /// The increase of each of [`COUNTERS`] in this list.
    pub counters: Vec<u64>,
    /// In the order in which they ended, if they were asked for.
    pub events: Vec<Event>,
    pub simulate_s: f64,
}

impl Report {
    /// A counter by its name.
    ///
    /// # Panics
    /// If there is none of this name.
    pub fn counter(&self, name: &str) -> u64 {
        let place = COUNTERS.iter().position(|(known, _)| *known == name);
        self.counters[place.unwrap_or_else(|| panic!("no counter {name}"))]
    }
}

/// The events that were collected, in cycles from `first` on.
fn events(collector: Option<&mut Collector>, first: u64) -> Vec<Event> {
    let events = collector.map(|collector| std::mem::take(&mut collector.events));
    let from = |cycle: u64| cycle - first;
    let moved = events
        .unwrap_or_default()
        .into_iter()
        .map(|event| match event {
            Event::Read {
                client,
                address,
                begin,
                end,
            } => Event::Read {
                client,
                address,
                begin: from(begin),
                end: from(end),
            },
            Event::Write {
                address,
                begin,
                end,
            } => Event::Write {
                address,
                begin: from(begin),
                end: from(end),
            },
            Event::Packet { tag, begin, end } => Event::Packet {
                tag,
                begin: from(begin),
                end: from(end),
            },
            Event::Activity {
                cycle,
                steps,
                tests,
                bytes,
            } => Event::Activity {
                cycle: from(cycle),
                steps,
                tests,
                bytes,
            },
        });
    moved.collect()
}

/// The model of a chip, with its memory.
pub struct Chip {
    options: Options,
    model: Model,
    ports: hdl::Ports<monitored::Inputs<PortHandle>, monitored::Outputs<PortHandle>>,
    bus: Bus,
    slave: Slave,
    pace: Behaving,
    rng: fastrand::Rng,
    golden: golden::Chip,
    memory: Bytes,
    traffic: Traffic,
    collector: Option<Collector>,
    config: Config,
    /// What the register slave showed before the last edge.
    lite: LiteOutputs<u64>,
    interrupt: bool,
    /// Cycles since the last transfer on the memory bus.
    quiet: u64,
    pub model_build_s: f64,
    pub model_reused: bool,
}

enum Behaving {
    Model(Box<DramPace>),
    Random(Faultless),
}

/// A random pace that reports no errors.
struct Faultless(RandomPace);

impl Pace for Faultless {
    fn decide(&mut self, view: &View<'_>) -> Decision {
        let decision = self.0.decide(view);
        Decision {
            beat: decision.beat.map(|(place, _)| (place, false)),
            response: decision.response.map(|(place, _)| (place, false)),
            ..decision
        }
    }
}

impl Chip {
    /// Builds the model of a configuration's chip, and resets it.
    ///
    /// # Errors
    /// A tool that is missing.
    pub fn new(config: &Config, options: &Options, progress: &dyn Fn(&str)) -> Result<Chip> {
        let plan = Plan::new(config)?.with_trace(options.events);
        let bus = chip::bus(config);
        let design = Design::new(monitored::module(&plan)?)?.with_prefix(default_prefix());
        let sources = Sources::of(&design);
        let mut how = options.build.clone();
        how.traced |= options.trace.is_some();
        let built = build(&sources, &how, progress)?;
        let mut model = Model::load(&built, &sources.ports)?;
        let ports = model.ports(&monitored::ports(&plan))?;
        model.disturb(options.seed, DISTURBED_CYCLES);
        if let Some(window) = &options.trace {
            model.trace(&window.path, window.from, window.cycles)?;
        }
        let handles = Handles {
            out: ports.outputs.chip.m_axi,
            into: ports.inputs.chip.m_axi,
        };
        let lite = model.sample(&ports.outputs.chip.s_axi);
        let mut chip = Chip {
            slave: Slave::new(&bus, handles),
            pace: match options.behaviour {
                Behaviour::Model => Behaving::Model(Box::new(DramPace::new(config))),
                Behaviour::Random => Behaving::Random(Faultless(RandomPace::new(options.seed))),
            },
            rng: fastrand::Rng::with_seed(options.seed),
            golden: golden::Chip::new(config),
            memory: Bytes {
                base: 0,
                bytes: vec![],
            },
            traffic: Traffic::default(),
            collector: options.events.then(Collector::default),
            config: config.clone(),
            lite,
            interrupt: false,
            quiet: 0,
            options: options.clone(),
            model,
            ports,
            bus,
            model_build_s: built.build_seconds,
            model_reused: built.reused,
        };
        chip.idle_registers();
        chip.model.reset(RESET_CYCLES);
        let all = (1 << interrupt::COUNT) - 1;
        chip.write(offset::INTERRUPT_ENABLE, all)?;
        Ok(chip)
    }

    /// Offers nothing on the register bus.
    fn idle_registers(&mut self) {
        let lite = &self.ports.inputs.chip.s_axi;
        let valids = [
            lite.awvalid,
            lite.wvalid,
            lite.bready,
            lite.arvalid,
            lite.rready,
        ];
        for port in valids {
            self.model.set(port, 0);
        }
    }

    /// One cycle of everything.
    fn cycle(&mut self) -> Result<()> {
        let pace: &mut dyn Pace = match &mut self.pace {
            Behaving::Model(pace) => pace.as_mut(),
            Behaving::Random(pace) => pace,
        };
        (self.slave).show(&mut self.model, pace, &self.memory, &mut self.rng)?;
        self.model.eval();
        let outputs = self.ports.outputs;
        self.lite = self.model.sample(&outputs.chip.s_axi);
        self.interrupt = self.model.get(outputs.chip.irq) != 0;
        let edge = self.slave.step(&self.model, &mut self.memory)?;
        self.count(&edge);
        self.collect(&edge);
        self.model.clock();
        if self.model.get(outputs.error) != 0 {
            return Err(self.protocol_error());
        }
        self.quiet = if edge.any() { 0 } else { self.quiet + 1 };
        ensure!(
            self.quiet < PATIENCE,
            "the chip has stopped: no transfer on the memory bus for {PATIENCE} cycles, at cycle {}",
            self.model.cycles()
        );
        Ok(())
    }

    fn count(&mut self, edge: &Edge) {
        let bytes = u64::from(self.bus.bytes());
        let traffic = &mut self.traffic;
        traffic.read_bursts += u64::from(edge.read.is_some());
        traffic.write_bursts += u64::from(edge.write.is_some());
        if let Some(beat) = edge.beat {
            traffic.bytes_read += bytes;
            let of_rays = Client::of_id(&self.config, beat.id) == Some(Client::Rays);
            traffic.bytes_of_rays += bytes * u64::from(of_rays);
        }
        traffic.bytes_written += bytes * u64::from(edge.datum.is_some());
    }

    /// Adds what an edge does to the events.
    fn collect(&mut self, edge: &Edge) {
        let Some(collector) = &mut self.collector else {
            return;
        };
        let now = self.model.cycles();
        let bytes = u64::from(self.bus.bytes());
        if let Some(burst) = edge.read {
            collector.reads.push((burst, now));
        }
        if let Some(beat) = edge.beat {
            collector.bytes += bytes;
            let of_id = |(burst, _): &(Accepted, u64)| burst.id == beat.id;
            if beat.last
                && let Some(place) = collector.reads.iter().position(of_id)
            {
                let (burst, begin) = collector.reads.remove(place);
                collector.events.push(Event::Read {
                    client: Client::of_id(&self.config, burst.id),
                    address: burst.address,
                    begin,
                    end: now,
                });
            }
        }
        if let Some(burst) = edge.write {
            collector.writes.push_back((burst.address, now));
        }
        collector.bytes += bytes * u64::from(edge.datum.is_some());
        if edge.response.is_some()
            && let Some((address, begin)) = collector.writes.pop_front()
        {
            let end = now;
            collector.events.push(Event::Write {
                address,
                begin,
                end,
            });
        }
        let Some(trace) = &self.ports.outputs.chip.trace else {
            return;
        };
        let shown = self.model.sample(trace);
        let hits = u64::from(self.config.rays_per_packet);
        if shown.start_valid != 0 {
            collector.packets.insert(shown.start_tag, (now, hits));
        }
        if shown.hit_valid != 0
            && let Some((begin, left)) = collector.packets.get_mut(&shown.hit_tag)
        {
            *left -= 1;
            if *left == 0 {
                let (tag, begin) = (shown.hit_tag, *begin);
                collector.packets.remove(&tag);
                let end = now;
                collector.events.push(Event::Packet { tag, begin, end });
            }
        }
        collector.steps += shown.step;
        collector.tests += shown.test;
        if now.is_multiple_of(ACTIVITY_CYCLES) {
            let take = |count: &mut u64| std::mem::take(count);
            let event = Event::Activity {
                cycle: now,
                steps: take(&mut collector.steps),
                tests: take(&mut collector.tests),
                bytes: take(&mut collector.bytes),
            };
            collector.events.push(event);
        }
    }

    /// The mismatch of a rule of the bus that the monitor found violated.
    fn protocol_error(&self) -> anyhow::Error {
        use crate::hdl::Bundle as _;
        let rules = self.model.sample(&self.ports.outputs.violated);
        let rules = rules.fields().into_iter().filter(|(_, on)| *on != 0);
        let fields = rules.map(|(name, on)| Field::integer(name, 0, on));
        self.mismatch("AXI4 protocol monitor".into(), fields.collect())
    }

    fn mismatch(&self, place: String, fields: Vec<Field>) -> anyhow::Error {
        let mismatch = Mismatch {
            unit: "chip",
            place,
            cycle: self.model.cycles(),
            fields,
            replay: self.options.replay.clone(),
        };
        mismatch.into()
    }

    /// Writes a register, as a host does.
    ///
    /// # Errors
    /// A violation of the protocol of the memory bus; a chip that makes no headway.
    pub fn write(&mut self, offset: u32, value: u32) -> Result<()> {
        let lite = self.ports.inputs.chip.s_axi;
        let model = &mut self.model;
        model.set(lite.awvalid, 1);
        model.set(lite.awaddr, offset.into());
        model.set(lite.awprot, 0);
        model.set(lite.wvalid, 1);
        model.set(lite.wdata, value.into());
        model.set(lite.wstrb, 0xf);
        model.set(lite.bready, 1);
        loop {
            self.cycle()?;
            if self.lite.awready != 0 {
                self.model.set(lite.awvalid, 0);
            }
            if self.lite.wready != 0 {
                self.model.set(lite.wvalid, 0);
            }
            if self.lite.bvalid != 0 {
                break;
            }
        }
        self.model.set(lite.bready, 0);
        Ok(())
    }

    /// Reads a register, as a host does.
    ///
    /// # Errors
    /// As [`Chip::write`].
    pub fn read(&mut self, offset: u32) -> Result<u32> {
        let lite = self.ports.inputs.chip.s_axi;
        let model = &mut self.model;
        model.set(lite.arvalid, 1);
        model.set(lite.araddr, offset.into());
        model.set(lite.arprot, 0);
        model.set(lite.rready, 1);
        loop {
            self.cycle()?;
            if self.lite.arready != 0 {
                self.model.set(lite.arvalid, 0);
            }
            if self.lite.rvalid != 0 {
                break;
            }
        }
        self.model.set(lite.rready, 0);
        Ok(self.lite.rdata as u32)
    }

    /// All counters, as a snapshot.
    fn counters(&mut self) -> Result<Vec<u64>> {
        self.write(offset::SNAPSHOT, 1)?;
        let mut all = vec![];
        for place in 0..COUNTERS.len() {
            let [low, high] = registers::counter(place);
            all.push(u64::from(self.read(low)?) | u64::from(self.read(high)?) << 32);
        }
        Ok(all)
    }

    /// Runs the list at an address of a memory, which becomes what the chip has made of it, and compares every byte with the golden
    /// chip's. `progress` receives the bytes of rays that have been read.
    ///
    /// # Errors
    /// The first mismatch; a violation of the protocol of the memory bus; a chip that makes no headway.
    pub fn run(
        &mut self,
        memory: &mut Memory,
        list: u32,
        progress: &dyn Fn(u64),
    ) -> Result<Report> {
        let mut expected = memory.clone();
        let outcome = self.golden.run(&mut expected, list, MOST_DESCRIPTORS);
        self.memory = Bytes {
            base: memory.base(),
            bytes: memory.bytes().to_vec(),
        };
        if let Behaving::Random(pace) = &mut self.pace {
            pace.0.draw();
        }
        let before = self.counters()?;
        let traffic = self.traffic;
        self.write(offset::LIST, list)?;
        let started = Instant::now();
        let first = self.model.cycles();
        if let Some(collector) = &mut self.collector {
            *collector = Collector::default();
        }
        self.write(offset::DOORBELL, 1)?;
        self.quiet = 0;
        let signal = 1 << interrupt::SIGNAL;
        let mut seen = 0;
        loop {
            while !self.interrupt {
                self.cycle()?;
                if self.model.cycles().is_multiple_of(PROGRESS) {
                    progress(self.traffic.bytes_of_rays - traffic.bytes_of_rays);
                }
            }
            let pending = self.read(offset::INTERRUPT_STATUS)?;
            self.write(offset::INTERRUPT_STATUS, pending)?;
            self.cycle()?;
            seen |= pending;
            if pending & !signal != 0 {
                break;
            }
        }
        let cycles = self.model.cycles() - first;
        let simulate_s = started.elapsed().as_secs_f64();
        self.check_status(&outcome, seen)?;
        let checked = self.check_memory(&expected)?;
        *memory = expected;
        let after = self.counters()?;
        Ok(Report {
            outcome,
            checked,
            cycles,
            traffic: Traffic {
                read_bursts: self.traffic.read_bursts - traffic.read_bursts,
                write_bursts: self.traffic.write_bursts - traffic.write_bursts,
                bytes_read: self.traffic.bytes_read - traffic.bytes_read,
                bytes_written: self.traffic.bytes_written - traffic.bytes_written,
                bytes_of_rays: self.traffic.bytes_of_rays - traffic.bytes_of_rays,
            },
            counters: after
                .iter()
                .zip(before)
                .map(|(after, before)| after - before)
                .collect(),
            events: events(self.collector.as_mut(), first),
            simulate_s,
        })
    }

    /// Compares how the list has ended.
    fn check_status(&mut self, outcome: &Outcome, seen: u32) -> Result<()> {
        let [code, descriptor, value] = match outcome.error {
            None => [0; 3],
            Some(error) => [error.fault.code, error.descriptor, error.fault.value],
        };
        let bit = |place: u32| u64::from(seen >> place & 1);
        let failed = u64::from(outcome.error.is_some());
        let mut fields = vec![
            Field::integer("interrupt end", 1 - failed, bit(interrupt::END)),
            Field::integer("interrupt error", failed, bit(interrupt::ERROR)),
            Field::integer(
                "interrupt signal",
                (outcome.interrupts > 0).into(),
                bit(interrupt::SIGNAL),
            ),
            Field::integer("interrupt overrun", 0, bit(interrupt::OVERRUN)),
        ];
        let found = self.read(offset::ERROR_CODE)?;
        fields.push(Field::integer("error code", code.into(), found.into()));
        if outcome.error.is_some() {
            let found = self.read(offset::ERROR_DESCRIPTOR)?;
            fields.push(Field::integer(
                "error descriptor",
                descriptor.into(),
                found.into(),
            ));
            let found = self.read(offset::ERROR_ADDRESS)?;
            fields.push(Field::integer("error address", value.into(), found.into()));
        }
        let found = self.read(offset::STATUS)?;
        fields.push(Field::integer("status", 0, found.into()));
        if fields.iter().any(Field::differs) {
            return Err(self.mismatch("how the list has ended".into(), fields));
        }
        Ok(())
    }

    /// Compares all of memory.
    fn check_memory(&self, expected: &Memory) -> Result<u64> {
        let pairs = expected.bytes().iter().zip(&self.memory.bytes);
        if let Some(place) = pairs.clone().position(|(golden, rtl)| golden != rtl) {
            let first = place - place % 16;
            let fields = (first..(first + 16).min(self.memory.bytes.len())).map(|k| {
                let address = u64::from(expected.base()) + k as u64;
                let [golden, rtl] = [expected.bytes()[k], self.memory.bytes[k]].map(u64::from);
                Field::integer(format!("byte {address:#010x}"), golden, rtl)
            });
            let address = u64::from(expected.base()) + place as u64;
            return Err(self.mismatch(format!("memory at {address:#010x}"), fields.collect()));
        }
        Ok(pairs.len() as u64)
    }
}
