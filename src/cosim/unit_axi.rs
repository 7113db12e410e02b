//! The AXI4 master alone, with its protocol monitor, in front of a slave that does whatever the protocol allows.
//!
//! Compared are all bursts and data on the bus with those that were given to the master, in order; the beats and responses that it hands on
//! with those of the bus, in their cycle; its events, in their cycle; and, after each batch, all bytes of memory. A beat is compared
//! with the memory's contents too, at the address that its burst was given.

use super::axi::{Bytes, Data, Edge, Fault, Handles, RandomPace, Slave};
use super::mismatch::Field;
use super::model::{Model, PortHandle};
use super::scoreboard::{Bench, Category, RESET_CYCLES, UnitOptions, UnitReport};
use crate::hdl::{self, Bundle, Module};
use crate::hw::memory::axi::monitor::{Rules, Sizes};
use crate::hw::memory::axi::monitored::{Inputs, Outputs, module, ports};
use crate::hw::memory::axi::{Bus, Events};
use anyhow::Result;
use std::collections::VecDeque;
use std::sync::Arc;

/// What the master can meet.
pub const CATEGORIES: &[Category] = &[
    Category::Overtaking,
    Category::Interleaved,
    Category::LongestBurst,
    Category::OneBeat,
    Category::UpToBoundary,
    Category::AllReads,
    Category::AllWrites,
    Category::DataFirst,
    Category::PartialWord,
    Category::BusError,
];

/// Bytes of memory. The first half of a batch's is read, the other written; the halves are exchanged after each batch.
const MEMORY: u32 = 1 << 16;

/// The multiple of bytes that a burst does not cross.
pub(super) const BOUNDARY: u32 = 4096;

/// The monitor's bound on waiting in these benches, in cycles: longer than any pace lets anything wait.
pub(super) const PATIENCE: u32 = 10_000;

/// Cycles in which nothing is transferred after which a run has stopped.
pub(super) const STUCK: u64 = 2 * PATIENCE as u64;

/// The bus that is simulated by default.
pub fn reference() -> Bus {
    Bus {
        data_bits: 128,
        id_bits: 4,
        reads: 8,
        writes: 4,
    }
}

/// The module that is simulated.
///
/// # Errors
/// None is known.
pub fn module_of(bus: &Bus) -> Result<Arc<Module>> {
    let sizes = Sizes {
        bus: *bus,
        patience: PATIENCE,
    };
    Ok(module(&sizes)?)
}

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// A burst that was given to the master.
#[derive(Clone, Copy, Debug)]
struct Given {
    id: u32,
    address: u32,
    beats: u32,
}

/// What an earlier edge transferred, which the master hands on in this cycle.
fn events(edge: &Edge) -> Events<u64> {
    Events {
        beat_read: edge.beat.is_some().into(),
        beat_written: edge.datum.is_some().into(),
        read_waits: edge.read_waits.into(),
        write_waits: edge.write_waits.into(),
        datum_waits: edge.datum_waits.into(),
        read_error: edge.beat.is_some_and(|beat| beat.error).into(),
        write_error: edge.response.is_some_and(|(_, error)| error).into(),
    }
}

/// The names of the rules that a monitor reports.
pub(super) fn violated(model: &Model, rules: &Rules<PortHandle>) -> String {
    let all = rules.fields();
    let names = all.iter().filter(|(_, port)| model.get(*port) != 0);
    let names: Vec<&str> = names.map(|(name, _)| name.as_str()).collect();
    names.join(", ")
}

/// What is offered at a port until it is taken, with pauses.
struct Offer<T> {
    item: Option<T>,
    pauses: f64,
}

impl<T> Offer<T> {
    fn new() -> Offer<T> {
        Offer {
            item: None,
            pauses: 0.0,
        }
    }

    /// Makes an item if none is offered and this is no pause.
    fn fill(
        &mut self,
        rng: &mut fastrand::Rng,
        make: impl FnOnce(&mut fastrand::Rng) -> Option<T>,
    ) {
        if self.item.is_none() && rng.f64() >= self.pauses {
            self.item = make(rng);
        }
    }
}

struct Run<'a> {
    bench: &'a mut Bench,
    bus: Bus,
    checks: Checks,
    ports: Ports,
    slave: Slave,
    pace: RandomPace,
    rng: fastrand::Rng,
    memory: Bytes,
    golden: Bytes,
    /// The half of memory that is written.
    half: u32,
    read: Offer<Given>,
    write: Offer<Given>,
    datum: Offer<(Data, u32)>,
    /// Bursts that are left to be given, reads and writes.
    left: [u64; 2],
    /// Bursts that the bus has not seen; write bursts whose data have not been given, with the number of those that have been.
    reads: VecDeque<Given>,
    writes: VecDeque<Given>,
    data_for: VecDeque<(Given, u32)>,
    data: VecDeque<(Data, u32, bool)>,
    /// Read bursts by identifier, with the number of beats that have come.
    beats_for: Vec<VecDeque<(Given, u32)>>,
    /// Bursts without a response.
    outstanding: [u64; 2],
}

/// Co-simulates the AXI4 master of a bus for a number of bursts.
///
/// # Errors
/// A tool that is missing. A mismatch is no error here: it is in the report.
pub fn run(bus: &Bus, bursts: u64, options: &UnitOptions) -> Result<UnitReport> {
    run_checked(bus, bursts, Checks::All, options)
}

/// What ends a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Checks {
    /// Any difference.
    All,
    /// Only what the monitor reports, in front of a slave that may have a fault.
    Monitor(Option<Fault>),
}

/// As [`run`], with fewer checks.
///
/// # Errors
/// As [`run`].
pub fn run_checked(
    bus: &Bus,
    bursts: u64,
    checks: Checks,
    options: &UnitOptions,
) -> Result<UnitReport> {
    let mut bench = Bench::new("axi", &module_of(bus)?, options)?;
    bench.model.reset(RESET_CYCLES);
    let ports = bench.model.ports(&ports(bus))?;
    let mut rng = fastrand::Rng::with_seed(options.seed);
    let base = [0, u32::MAX - MEMORY + 1, rng.u32(..) / MEMORY * MEMORY][rng.usize(..3)];
    let bytes = std::iter::repeat_with(|| rng.u8(..)).take(MEMORY as usize);
    let memory = Bytes {
        base,
        bytes: bytes.collect(),
    };
    let handles = Handles {
        out: ports.outputs.master.m_axi,
        into: ports.inputs.master.m_axi,
    };
    let mut slave = Slave::new(bus, handles);
    if let Checks::Monitor(fault) = checks {
        slave.fault = fault;
    }
    let mut run = Run {
        bus: *bus,
        checks,
        ports,
        slave,
        pace: RandomPace::new(rng.u64(..)),
        golden: memory.clone(),
        memory,
        half: 0,
        read: Offer::new(),
        write: Offer::new(),
        datum: Offer::new(),
        left: [0; 2],
        reads: VecDeque::new(),
        writes: VecDeque::new(),
        data_for: VecDeque::new(),
        data: VecDeque::new(),
        beats_for: vec![VecDeque::new(); 1 << bus.id_bits],
        outstanding: [0; 2],
        rng,
        bench: &mut bench,
    };
    let ended = (|| {
        // Nothing is left of what was before the reset.
        if checks == Checks::All {
            run.check_master(&Edge::default())?;
        }
        while run.bench.tally.transactions < bursts {
            run.batch()?;
        }
        Ok(())
    })();
    bench.report(ended, CATEGORIES)
}

impl Run<'_> {
    /// Some bursts under one pace, until all are complete; then the memory is compared.
    fn batch(&mut self) -> Result<()> {
        self.pace.draw();
        let mut probability = || [0.0, 0.0, 0.2, 0.7][self.rng.usize(..4)];
        self.read.pauses = probability();
        self.write.pauses = probability();
        self.datum.pauses = probability();
        let most = [20, 200][self.rng.usize(..2)];
        self.left = [self.rng.u64(..most), self.rng.u64(..most)];
        self.half = MEMORY / 2 - self.half;
        let mut idle = 0;
        while self.left != [0; 2] || self.outstanding != [0; 2] || !self.is_drained() {
            let moves = self.cycle()?;
            idle = if moves { 0 } else { idle + 1 };
            if idle > STUCK {
                let [reads, writes] = self.outstanding;
                let place = format!(
                    "nothing happens for {idle} cycles, with {reads} reads and {writes} writes outstanding"
                );
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        self.bench.tally.packets += 1;
        self.bench.tally.checked += 1;
        if self.checks != Checks::All {
            return Ok(());
        }
        let (golden, rtl) = (&self.golden.bytes, &self.memory.bytes);
        if let Some(at) = (0..golden.len()).find(|&i| golden[i] != rtl[i]) {
            let field = Field::integer("byte", golden[at].into(), rtl[at].into());
            let place = format!("memory at {:#x}", self.memory.base as usize + at);
            return Err(self.bench.mismatch(place, vec![field]));
        }
        Ok(())
    }

    fn is_drained(&self) -> bool {
        self.read.item.is_none() && self.write.item.is_none() && self.slave.is_empty()
    }

    /// A burst in a half of memory that does not cross a boundary.
    fn burst(&mut self, half: u32) -> Given {
        let (rng, bytes) = (&mut self.rng, self.bus.bytes());
        let page = rng.u32(..MEMORY / 2 / BOUNDARY) * BOUNDARY + half;
        let first = rng.u32(..BOUNDARY / bytes);
        let room = (BOUNDARY / bytes - first).min(256);
        // The long ones seldom: they take most of the cycles.
        let (first, beats) = match rng.u8(..48) {
            0 => (first, room),
            1 => (0, (BOUNDARY / bytes).min(256)),
            2..14 => (first, 1),
            _ => (first, rng.u32(1..=room.min(16))),
        };
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::LongestBurst, beats == (BOUNDARY / bytes).min(256));
        categories.count(Category::OneBeat, beats == 1);
        categories.count(
            Category::UpToBoundary,
            (first + beats) * bytes == BOUNDARY && beats > 1,
        );
        Given {
            id: rng.u32(..1 << self.bus.id_bits),
            address: self.memory.base + page + first * bytes,
            beats,
        }
    }

    /// Offers bursts and data for the coming edge.
    fn offer(&mut self) {
        let other = MEMORY / 2 - self.half;
        if self.read.item.is_none() && self.left[0] > 0 && self.rng.f64() >= self.read.pauses {
            self.read.item = Some(self.burst(other));
            self.left[0] -= 1;
        }
        if self.write.item.is_none() && self.left[1] > 0 && self.rng.f64() >= self.write.pauses {
            self.write.item = Some(self.burst(self.half));
            self.left[1] -= 1;
        }
        let (bytes, any_left) = (self.bus.bytes(), !self.data_for.is_empty());
        self.datum.fill(&mut self.rng, |rng| {
            let all = u32::MAX >> (32 - bytes);
            let strobes = match rng.u8(..4) {
                0 => rng.u32(..) & all,
                1 => 0,
                _ => all,
            };
            let mut data = Data::default();
            data[..bytes as usize / 4].fill_with(|| rng.u32(..));
            // Data may be offered before their burst is given.
            (any_left || rng.bool()).then_some((data, strobes))
        });
        let model = &mut self.bench.model;
        let inputs = &self.ports.inputs.master;
        model.set(inputs.read.valid, self.read.item.is_some().into());
        let payload = inputs.read.payload;
        match self.read.item {
            Some(burst) => {
                model.set(payload.address, burst.address.into());
                model.set(payload.beats, u64::from(burst.beats) - 1);
                model.set(payload.id, burst.id.into());
            }
            None => model.garble([payload.address, payload.beats, payload.id], &mut self.rng),
        }
        model.set(inputs.write.valid, self.write.item.is_some().into());
        let payload = inputs.write.payload;
        match self.write.item {
            Some(burst) => {
                model.set(payload.address, burst.address.into());
                model.set(payload.beats, u64::from(burst.beats) - 1);
            }
            None => model.garble([payload.address, payload.beats], &mut self.rng),
        }
        model.set(inputs.datum.valid, self.datum.item.is_some().into());
        let payload = inputs.datum.payload;
        match &self.datum.item {
            Some((data, strobes)) => {
                model.set_words(payload.data, data);
                model.set(payload.strobes, (*strobes).into());
            }
            None => model.garble([payload.data, payload.strobes], &mut self.rng),
        }
    }

    /// One cycle; whether anything moves.
    fn cycle(&mut self) -> Result<bool> {
        self.offer();
        let (bench, noise) = (&mut *self.bench, &mut self.rng);
        self.slave
            .show(&mut bench.model, &mut self.pace, &self.memory, noise)?;
        bench.model.eval();
        let given = self.take()?;
        let edge = match self.slave.step(&self.bench.model, &mut self.memory) {
            Ok(edge) => edge,
            Err(error) => return Err(self.bench.mismatch(format!("{error:#}"), vec![])),
        };
        let seen = self.check_bus(&edge);
        if self.checks == Checks::All {
            seen?;
        }
        self.bench.model.clock();
        self.check_monitor()?;
        if self.checks == Checks::All {
            self.check_master(&edge)?;
        }
        Ok(given || edge.any())
    }

    /// What the master takes at the coming edge.
    fn take(&mut self) -> Result<bool> {
        let outputs = &self.ports.outputs.master;
        let model = &self.bench.model;
        let mut any = false;
        if model.get(outputs.read_ready) != 0
            && let Some(burst) = self.read.item.take()
        {
            self.reads.push_back(burst);
            self.beats_for[burst.id as usize].push_back((burst, 0));
            self.outstanding[0] += 1;
            any = true;
        }
        if model.get(outputs.datum_ready) != 0
            && let Some((data, strobes)) = self.datum.item.take()
        {
            let Some((burst, done)) = self.data_for.front_mut() else {
                if self.checks != Checks::All {
                    return Ok(true);
                }
                let place = "a datum is taken that belongs to no burst";
                return Err(self.bench.mismatch(place, vec![]));
            };
            let bytes = self.bus.bytes();
            let address = burst.address.wrapping_add(*done * bytes);
            self.golden.write(address, bytes, &data, strobes)?;
            let all = u32::MAX >> (32 - bytes);
            let categories = &mut self.bench.tally.categories;
            categories.count(Category::PartialWord, strobes != 0 && strobes != all);
            *done += 1;
            let last = *done == burst.beats;
            self.data.push_back((data, strobes, last));
            if last {
                self.data_for.pop_front();
            }
            any = true;
        }
        if model.get(outputs.write_ready) != 0
            && let Some(burst) = self.write.item.take()
        {
            self.writes.push_back(burst);
            self.data_for.push_back((burst, 0));
            self.outstanding[1] += 1;
            any = true;
        }
        Ok(any)
    }

    /// Compares the attributes of the addresses that are offered with what they must be.
    fn check_attributes(&self) -> Result<()> {
        let (out, model) = (&self.ports.outputs.master.m_axi, &self.bench.model);
        let size = u64::from(self.bus.size());
        let (ar, aw) = (model.sample(&out.ar), model.sample(&out.aw));
        let all = [
            ("ARSIZE", size, ar.arsize),
            ("ARBURST", 1, ar.arburst),
            ("ARLOCK", 0, ar.arlock),
            ("ARCACHE", 3, ar.arcache),
            ("ARPROT", 2, ar.arprot),
            ("ARQOS", 0, ar.arqos),
            ("AWSIZE", size, aw.awsize),
            ("AWBURST", 1, aw.awburst),
            ("AWLOCK", 0, aw.awlock),
            ("AWCACHE", 3, aw.awcache),
            ("AWPROT", 2, aw.awprot),
            ("AWQOS", 0, aw.awqos),
        ];
        if all.iter().all(|(_, golden, rtl)| golden == rtl) {
            return Ok(());
        }
        let fields = all.map(|(name, golden, rtl)| Field::integer(name, golden, rtl));
        Err(self
            .bench
            .mismatch("attributes of a burst", fields.to_vec()))
    }

    /// Compares what the bus transfers with what the master was given.
    fn check_bus(&mut self, edge: &Edge) -> Result<()> {
        if edge.read.is_some() || edge.write.is_some() {
            self.check_attributes()?;
        }
        let addresses = [
            ("read burst", edge.read, &mut self.reads, true),
            ("write burst", edge.write, &mut self.writes, false),
        ];
        for (what, seen, given, has_id) in addresses {
            let Some(seen) = seen else { continue };
            let tally = &mut self.bench.tally;
            tally.transactions += 1;
            tally.checked += 1;
            let golden = given.pop_front();
            let id = |burst: &Given| if has_id { burst.id } else { 0 };
            let same = golden.as_ref().is_some_and(|golden| {
                (id(golden), golden.address, golden.beats) == (seen.id, seen.address, seen.beats)
            });
            if !same {
                let golden = golden.map_or([u64::MAX; 3], |golden| {
                    [id(&golden), golden.address, golden.beats].map(u64::from)
                });
                let rtl = [seen.id, seen.address, seen.beats].map(u64::from);
                let fields = ["identifier", "address", "beats"].into_iter().enumerate();
                let fields = fields.map(|(i, name)| Field::integer(name, golden[i], rtl[i]));
                let fields = fields.collect();
                return Err(self.bench.mismatch(format!("{what} on the bus"), fields));
            }
        }
        if let Some(seen) = edge.datum {
            let golden = self.data.pop_front();
            self.bench.tally.checked += 1;
            if golden != Some(seen) {
                let place = format!("datum on the bus: golden {golden:x?}, rtl {seen:x?}");
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        if let Some(beat) = edge.beat {
            let categories = &mut self.bench.tally.categories;
            categories.count(Category::Overtaking, beat.overtakes);
            categories.count(Category::Interleaved, beat.interleaved);
            categories.count(Category::BusError, beat.error);
            let Some((burst, done)) = self.beats_for[beat.id as usize].front_mut() else {
                return Err(self.bench.mismatch("a beat for no burst", vec![]));
            };
            let bytes = self.bus.bytes();
            let golden = (self.golden).beat(burst.address.wrapping_add(*done * bytes), bytes)?;
            *done += 1;
            let last = *done == burst.beats;
            if last {
                self.beats_for[beat.id as usize].pop_front();
                self.outstanding[0] -= 1;
            }
            self.bench.tally.checked += 1;
            if (golden, last) != (beat.data, beat.last) {
                let place = format!("beat on the bus: golden {golden:x?}, {last}, slave {beat:x?}");
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        if edge.response.is_some() {
            if self.outstanding[1] == 0 {
                return Err(self.bench.mismatch("a response for no burst", vec![]));
            }
            self.outstanding[1] -= 1;
        }
        let categories = &mut self.bench.tally.categories;
        let [reads, writes] = self.outstanding;
        categories.count(Category::AllReads, reads == u64::from(self.bus.reads));
        categories.count(Category::AllWrites, writes == u64::from(self.bus.writes));
        let early = edge.datum.is_some() && edge.write_waits;
        categories.count(Category::DataFirst, early);
        Ok(())
    }

    fn check_monitor(&self) -> Result<()> {
        let (outputs, model) = (&self.ports.outputs, &self.bench.model);
        if model.get(outputs.error) == 0 {
            return Ok(());
        }
        let rules = violated(model, &outputs.violated);
        Err((self.bench).mismatch(format!("the monitor reports {rules}"), vec![]))
    }

    /// Compares what the master hands on after an edge with what the edge transferred.
    fn check_master(&mut self, edge: &Edge) -> Result<()> {
        let (master, model) = (&self.ports.outputs.master, &self.bench.model);
        let mut fields = vec![];
        let mut compare = |name: &str, golden: u64, port| {
            let rtl = model.get(port);
            if golden != rtl {
                fields.push(Field::integer(name, golden, rtl));
            }
        };
        compare("beat valid", edge.beat.is_some().into(), master.beat.valid);
        compare("written", edge.response.is_some().into(), master.written);
        let payload = &master.beat.payload;
        if let Some(beat) = &edge.beat {
            compare("identifier", beat.id.into(), payload.id);
            compare("last", beat.last.into(), payload.last);
            compare("error", beat.error.into(), payload.error);
        }
        let golden = events(edge).fields();
        for ((name, port), (_, golden)) in master.event.fields().into_iter().zip(golden) {
            compare(&name, golden, port);
        }
        let mut data = Data::default();
        model.get_words(payload.data, &mut data);
        let place = match &edge.beat {
            Some(beat) if beat.data != data => {
                format!("data of a beat: golden {:x?}, rtl {data:x?}", beat.data)
            }
            _ if fields.is_empty() => return Ok(()),
            _ => "what the master hands on".to_string(),
        };
        Err(self.bench.mismatch(place, fields))
    }
}
