//! The chip's register file alone, with its event counters: a host at the AXI4-Lite bus and a command processor that are both random.
//!
//! Address and data of a write come in either order with any gaps, responses wait, lists start and end at any time. Every output is compared
//! in every cycle with the golden register file and the timing that `docs/chip.md` states. The register file is given random counters, so
//! that all bits of a copy count; those of the event counters are compared with the events.

use super::model::PortHandle;
use super::scoreboard::{Bench, Category, RESET_CYCLES, UnitOptions, UnitReport};
use crate::chip::registers::{COUNTER_BITS, COUNTERS, WINDOW, interrupt, offset};
use crate::config::Config;
use crate::golden::registers::{Counts, Cycle, Effects, End, Registers, Write};
use crate::hdl::{self, Builder, Bundle, HdlError, Module, Specs};
use crate::hw::Plan;
use crate::hw::chip::counters::{self, Counted, Events};
use crate::hw::chip::registers::{self, Inputs as FileInputs, Outputs as FileOutputs};
use crate::interface;
use anyhow::Result;
use std::sync::Arc;

/// What the unit can meet.
pub const CATEGORIES: &[Category] = &[
    Category::DataFirst,
    Category::AddressFirst,
    Category::PartialStrobes,
    Category::NoStrobes,
    Category::Unassigned,
    Category::BothAccesses,
    Category::WaitingResponse,
    Category::QueuedList,
    Category::Overrun,
    Category::RingsAtStart,
    Category::Snapshot,
    Category::ClearedInterrupt,
    Category::ClearedAtEvent,
    Category::FailedList,
    Category::CutShort,
];

interface! {
    pub () {
        in "" { file: ..{FileInputs}() }
        in "Events to count" { event: {Events}() }
        out "" { file: ..{FileOutputs}() }
        out "The event counters" { events_counted: {Counted}() }
    }
}

/// Describes the register file beside the event counters.
///
/// # Errors
/// A mistake in the description; none is known.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "register_file",
        "the register file beside the event counters, whose counts are seen before they enter it.",
    );
    let ports = ports();
    let inputs = ports.inputs.inputs(&m);
    let file = registers::ports().place("file", &m, &registers::module(plan)?, inputs.file);
    let counting = counters::Inputs {
        event: inputs.event,
    };
    let counting = counters::ports().place("counters", &m, &counters::module()?, counting);
    let outputs = Outputs {
        file,
        events_counted: counting.count,
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// Accesses of each kind under one pace.
const BATCH: u64 = 200;

/// Events that are counted; they come last in the table of counters.
const EVENTS: usize = COUNTERS.len() - CORE;
/// Counters of the ray casting unit and of the update processor.
const CORE: usize = 15;

/// A write that is offered: its parts are shown when their delays are over.
struct Offer {
    write: Write,
    address_in: u32,
    data_in: u32,
}

/// The host: what it offers and what it waits for.
#[derive(Default)]
struct Host {
    write: Option<Offer>,
    read: Option<u32>,
    /// Whether the response of a write is shown.
    responds: bool,
    /// The read whose register is selected in this cycle.
    selects: Option<u32>,
    /// The word that is shown; `Some(None)` if its value has no meaning.
    shows: Option<Option<u32>>,
}

/// The command processor: cycles until the end of its list.
#[derive(Default)]
struct Processor {
    left: Option<u32>,
}

/// Probabilities of pauses, and the greatest gaps.
struct Pace {
    write_gap: f64,
    read_gap: f64,
    /// Greatest delay of one part of a write behind the other.
    skew: u32,
    bready: f64,
    rready: f64,
    start_ready: f64,
    /// Greatest number of cycles of a list.
    longest: u32,
    /// The share of accesses to the registers of lists and interrupts.
    control: f64,
}

impl Pace {
    fn random(rng: &mut fastrand::Rng) -> Pace {
        let mut pause = || [0.0, 0.3, 0.9][rng.usize(..3)];
        Pace {
            write_gap: pause(),
            read_gap: pause(),
            bready: 1.0 - pause(),
            rready: 1.0 - pause(),
            start_ready: 1.0 - pause(),
            skew: [0, 3, 20][rng.usize(..3)],
            longest: [2, 20, 300][rng.usize(..3)],
            control: [0.3, 0.8][rng.usize(..2)],
        }
    }
}

struct Run<'a> {
    config: &'a Config,
    bench: Bench,
    ports: Ports,
    rng: fastrand::Rng,
    pace: Pace,
    golden: Registers,
    /// How often each event has occurred.
    counted: [u64; EVENTS],
    host: Host,
    processor: Processor,
}

/// What the bench gives to the unit in a cycle.
struct Given {
    address: bool,
    data: bool,
    read: bool,
    bready: bool,
    rready: bool,
    start_ready: bool,
    running: bool,
    cycle: Cycle,
    counts: Counts,
    events: [bool; EVENTS],
}

/// Co-simulates the register file of a machine with at least `accesses` reads and writes.
///
/// # Errors
/// A tool that is missing. A mismatch is no error here: it is in the report.
pub fn run(config: &Config, accesses: u64, options: &UnitOptions) -> Result<UnitReport> {
    let plan = Plan::new(config)?;
    let mut bench = Bench::new("registers", &module(&plan)?, options)?;
    let ports = bench.model.ports(&ports())?;
    bench.model.reset(RESET_CYCLES);
    let mut rng = fastrand::Rng::with_seed(options.seed);
    let mut run = Run {
        config,
        bench,
        ports,
        pace: Pace::random(&mut rng),
        rng,
        golden: Registers::new(config),
        counted: [0; EVENTS],
        host: Host::default(),
        processor: Processor::default(),
    };
    let ended = run.all(accesses);
    run.bench.report(ended, CATEGORIES)
}

impl Run<'_> {
    fn all(&mut self, accesses: u64) -> Result<()> {
        while self.bench.tally.transactions < accesses {
            self.pace = Pace::random(&mut self.rng);
            let end = self.bench.tally.transactions + BATCH;
            let mut until_reset = match self.rng.u8(..4) {
                0 => self.rng.u64(..300),
                _ => u64::MAX,
            };
            while self.bench.tally.transactions < end {
                if until_reset == 0 {
                    self.reset();
                }
                until_reset = until_reset.wrapping_sub(1);
                self.cycle()?;
            }
            self.bench.tally.packets += 1;
        }
        Ok(())
    }

    fn reset(&mut self) {
        // The neighbours do not know of it.
        let given = self.give();
        self.show(&given);
        self.bench.model.reset(RESET_CYCLES);
        self.bench.tally.categories.count(Category::CutShort, true);
        self.golden = Registers::new(self.config);
        self.counted = [0; EVENTS];
        self.host = Host::default();
        self.processor = Processor::default();
    }

    /// An address: of a register, of one beside, or any.
    fn address(&mut self) -> u32 {
        let rng = &mut self.rng;
        let low = match rng.u8(..4) {
            0 => rng.u32(..4),
            _ => 0,
        };
        let place = if rng.f64() < self.pace.control {
            let often = [
                offset::DOORBELL,
                offset::INTERRUPT_STATUS,
                offset::INTERRUPT_ENABLE,
            ];
            match rng.bool() {
                true => often[rng.usize(..often.len())],
                false => rng.u32(offset::LIST..=offset::SNAPSHOT) & !3,
            }
        } else {
            match rng.u8(..8) {
                0 => rng.u32(..0x40) & !3,
                1 | 2 => rng.u32(..WINDOW) & !3,
                // The address of a register in another part of the window.
                3 => (rng.u32(..0x200) & !3) ^ 1 << rng.u32(9..12),
                _ => {
                    let counter = rng.u32(..2 * COUNTERS.len() as u32);
                    offset::COUNTERS + 4 * counter
                }
            }
        };
        place | low
    }

    fn write(&mut self) -> Write {
        let rng = &mut self.rng;
        let strobes = match rng.u8(..4) {
            0 => rng.u32(..16),
            _ => 15,
        };
        let data = match rng.u8(..8) {
            0 => 0,
            1 => 1 << rng.u32(..interrupt::COUNT),
            _ => rng.u32(..),
        };
        Write {
            address: self.address(),
            data,
            strobes,
        }
    }

    /// What the neighbours do in this cycle.
    fn give(&mut self) -> Given {
        if self.host.write.is_none() && self.rng.f64() >= self.pace.write_gap {
            let write = self.write();
            let late = self.rng.u32(..=self.pace.skew);
            let (address_in, data_in) = match self.rng.bool() {
                true => (0, late),
                false => (late, 0),
            };
            self.host.write = Some(Offer {
                write,
                address_in,
                data_in,
            });
        }
        if self.host.read.is_none() && self.rng.f64() >= self.pace.read_gap {
            self.host.read = Some(self.address());
        }
        let rng = &mut self.rng;
        let running = self.processor.left.is_some();
        let ends = self.processor.left == Some(0);
        let offer = self.host.write.as_ref();
        let mut counts = [0; COUNTERS.len()];
        counts.fill_with(|| rng.u64(..1 << COUNTER_BITS));
        let mut events = [false; EVENTS];
        events.fill_with(|| rng.bool());
        let ended = ends.then(|| End {
            code: match rng.bool() {
                true => rng.u32(1..16),
                false => 0,
            },
            descriptor: rng.u32(..),
            value: rng.u32(..),
        });
        Given {
            address: offer.is_some_and(|offer| offer.address_in == 0),
            data: offer.is_some_and(|offer| offer.data_in == 0),
            read: self.host.read.is_some(),
            bready: rng.f64() < self.pace.bready,
            rready: rng.f64() < self.pace.rready,
            start_ready: !running && rng.f64() < self.pace.start_ready,
            running,
            cycle: Cycle {
                write: None,
                starts: false,
                signalled: running && rng.u8(..8) == 0,
                ended,
            },
            counts,
            events,
        }
    }

    /// Sets the inputs for the coming edge.
    fn show(&mut self, given: &Given) {
        let (model, rng) = (&mut self.bench.model, &mut self.rng);
        let inputs = self.ports.inputs.file;
        let bus = inputs.s_axi;
        let write = self.host.write.as_ref().map(|offer| offer.write);
        model.set(bus.awvalid, given.address.into());
        model.garble([bus.awaddr, bus.awprot, bus.arprot], rng);
        model.garble([bus.wdata, bus.wstrb, bus.araddr], rng);
        if let Some(write) = write.filter(|_| given.address) {
            model.set(bus.awaddr, write.address.into());
        }
        model.set(bus.wvalid, given.data.into());
        if let Some(write) = write.filter(|_| given.data) {
            model.set(bus.wdata, write.data.into());
            model.set(bus.wstrb, write.strobes.into());
        }
        model.set(bus.arvalid, given.read.into());
        if let Some(address) = self.host.read {
            model.set(bus.araddr, address.into());
        }
        model.set(bus.bready, given.bready.into());
        model.set(bus.rready, given.rready.into());
        model.set(inputs.start_ready, given.start_ready.into());
        model.set(inputs.running, given.running.into());
        model.set(inputs.signalled, given.cycle.signalled.into());
        model.set(inputs.ended, given.cycle.ended.is_some().into());
        match given.cycle.ended {
            Some(end) => {
                model.set(inputs.failure.code, end.code.into());
                model.set(inputs.failure.descriptor, end.descriptor.into());
                model.set(inputs.failure.value, end.value.into());
            }
            None => model.garble(inputs.failure.leaves(), rng),
        }
        let all = inputs.count.leaves().into_iter();
        let all = all
            .chain(inputs.update.leaves())
            .chain(inputs.counted.leaves());
        for (port, count) in all.zip(given.counts) {
            model.set(port, count);
        }
        let events = self.ports.inputs.event.leaves();
        for (port, event) in events.into_iter().zip(given.events) {
            model.set(port, event.into());
        }
    }

    /// Compares all outputs of a cycle; whether a write and a read are accepted.
    fn compare(&self, given: &Given) -> Result<(bool, bool)> {
        let host = &self.host;
        let outputs = &self.ports.outputs.file;
        let bus = outputs.s_axi;
        let writes = given.address && given.data && !host.responds;
        let arready = host.selects.is_none() && host.shows.is_none();
        let queued = self.golden.queued();
        let mut wanted = vec![
            ("awready", u64::from(writes), bus.awready),
            ("wready", writes.into(), bus.wready),
            ("bvalid", host.responds.into(), bus.bvalid),
            ("arready", arready.into(), bus.arready),
            ("rvalid", host.shows.is_some().into(), bus.rvalid),
            ("irq", self.golden.interrupts().into(), outputs.irq),
            ("start valid", queued.is_some().into(), outputs.start_valid),
        ];
        if host.responds {
            wanted.push(("bresp", 0, bus.bresp));
        }
        if let Some(word) = host.shows {
            wanted.push(("rresp", 0, bus.rresp));
            wanted.extend(word.map(|word| ("rdata", word.into(), bus.rdata)));
        }
        wanted.extend(queued.map(|list| ("start address", list.into(), outputs.start_address)));
        let counted = self.ports.outputs.events_counted.leaves();
        let counted = self.counted.iter().zip(counted);
        wanted.extend(counted.map(|(count, port)| ("event counter", *count, port)));
        self.bench.compare("outputs", &wanted)?;
        Ok((writes, given.read && arready))
    }

    /// One cycle.
    fn cycle(&mut self) -> Result<()> {
        let mut given = self.give();
        self.show(&given);
        self.bench.model.eval();
        let (writes, reads) = self.compare(&given)?;
        let running = given.running;
        let queued = self.golden.queued().is_some();
        let starts = queued && given.start_ready;
        given.cycle.starts = starts;
        given.cycle.write = (self.host.write.as_ref())
            .map(|offer| offer.write)
            .filter(|_| writes);
        self.count(&given, reads);

        // A read shows its register as it is in the cycle after its address.
        let host = &mut self.host;
        let responded = host.responds && given.bready;
        host.responds = writes || (host.responds && !responded);
        if host.shows.is_some() && given.rready {
            host.shows = None;
        }
        if let Some(address) = host.selects.take() {
            host.shows = Some(self.golden.read(address, running));
        }
        if reads {
            host.selects = host.read.take();
        }
        if writes {
            host.write = None;
        } else if let Some(offer) = &mut host.write {
            offer.address_in = offer.address_in.saturating_sub(1);
            offer.data_in = offer.data_in.saturating_sub(1);
        }
        let effects = self.golden.step(&given.cycle, &given.counts);
        for (count, event) in self.counted.iter_mut().zip(given.events) {
            *count += u64::from(event);
        }
        self.processor.left = match self.processor.left {
            Some(left) => left.checked_sub(1),
            None => starts.then(|| self.rng.u32(..self.pace.longest)),
        };
        let tally = &mut self.bench.tally;
        tally.transactions += u64::from(writes) + u64::from(reads);
        tally.checked += u64::from(responded);
        self.count_effects(&effects, running && !queued, starts);
        self.bench.model.clock();
        Ok(())
    }

    /// Counts what the bus did.
    fn count(&mut self, given: &Given, reads: bool) {
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::AddressFirst, given.address && !given.data);
        categories.count(Category::DataFirst, given.data && !given.address);
        let waits =
            (self.host.responds && !given.bready) || (self.host.shows.is_some() && !given.rready);
        categories.count(Category::WaitingResponse, waits);
        categories.count(
            Category::FailedList,
            given.cycle.ended.is_some_and(|end| end.code != 0),
        );
        if let Some(write) = given.cycle.write {
            categories.count(Category::NoStrobes, write.strobes == 0);
            let partial = write.strobes != 0 && write.strobes != 15;
            categories.count(Category::PartialStrobes, partial);
            categories.count(Category::BothAccesses, reads);
        }
        let last = offset::COUNTERS + 8 * COUNTERS.len() as u32;
        let unassigned = self.host.read.is_some_and(|address| address >= last);
        categories.count(Category::Unassigned, reads && unassigned);
    }

    /// Counts what the registers did; `may_queue` if a list runs and none waited behind it.
    fn count_effects(&mut self, effects: &Effects, may_queue: bool, starts: bool) {
        let queued = self.golden.queued().is_some() && may_queue;
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::QueuedList, queued);
        categories.count(Category::Overrun, effects.overrun);
        categories.count(Category::RingsAtStart, effects.overrun && starts);
        categories.count(Category::Snapshot, effects.snapshot);
        categories.count(Category::ClearedInterrupt, effects.cleared);
        categories.count(Category::ClearedAtEvent, effects.cleared_at_event);
    }
}
