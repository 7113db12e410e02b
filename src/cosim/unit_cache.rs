//! A cache alone, held against memory's contents and against the functional model ([`crate::golden::cache`]).
//!
//! Requests come in segments of various locality; memory takes bursts at any pace and returns beats after any time, lines in any order,
//! beats of several lines interleaved. Between batches all lines are discarded, memory's contents change, and the array moves.
//!
//! The model has no clock, so it is told in which order lookups are decided and answers leave; both can be seen at the ports. An event
//! tells of a decision one cycle later, and a response leaves a fixed number of cycles after its hit or its answer. What happened in one
//! cycle inside is therefore put together from two cycles at the ports (`Moment`), and the model must agree with all of it: whether
//! each request hits, waits for a line in flight or requests its line, that a request waits exactly where it must, that each list is answered
//! in order. So the counts of requests, hits and misses are compared exactly, one by one. Every response is compared with memory.

use super::mismatch::Field;
use super::model::PortHandle;
use super::scoreboard::{Bench, Category, RESET_CYCLES, Surroundings, UnitOptions, UnitReport};
use crate::golden::cache::{Cache, CacheCounts, Outcome, Sizes};
use crate::hdl::{self, Bundle, Request};
use crate::hw::memory::cache::{BASE_BYTES, BLOCK_BITS, Inputs, Outputs, Shape, module, ports};
use crate::hw::memory::{Beat, Burst};
use crate::hw::timing::Timing;
use anyhow::Result;
use std::collections::VecDeque;

/// What the unit can meet.
pub const CATEGORIES: &[Category] = &[
    Category::ListedRequest,
    Category::RegistersInUse,
    Category::WaysInFlight,
    Category::HitUnderMiss,
    Category::LongList,
    Category::InterleavedBeats,
    Category::LinesOvertake,
    Category::ReplacedLine,
    Category::Invalidation,
    // The pulse comes in the first cycle in which no request is outstanding.
    Category::InvalidatedAtOnce,
    // A hit in the cycle after the last answer of its line's list.
    Category::HitAfterAnswers,
    // A request is listed when the last beat of its line has arrived, or arrives.
    Category::ListedAtLastBeat,
    // A request is listed in the cycle after its line was requested.
    Category::NextInLine,
    // The array moves while its lines stay.
    Category::MovedBase,
    Category::BusError,
];

/// A cache of 4 KiB for records of 16 bytes, as in front of the read ports of the reference machine.
pub fn reference() -> Shape {
    Shape {
        record_bits: 118,
        record_bytes: 16,
        line_bytes: 64,
        ways: 2,
        sets: 32,
        misses: 4,
        tag_bits: 6,
        index_bits: 22,
        bus_bits: 128,
        address_bits: 32,
        block_bits: BLOCK_BITS,
        timing: Timing::at(100),
    }
}

/// The shapes that are tested: every width of bus, number of ways, way of storage and number of registers after a memory.
pub fn shapes() -> Vec<(&'static str, Shape)> {
    let reference = reference();
    vec![
        ("reference", reference),
        (
            "direct",
            Shape {
                record_bits: 72,
                ways: 1,
                sets: 16,
                misses: 3,
                tag_bits: 7,
                bus_bits: 64,
                timing: Timing::at(66),
                ..reference
            },
        ),
        (
            "four_ways",
            Shape {
                record_bits: 230,
                record_bytes: 32,
                line_bytes: 128,
                ways: 4,
                sets: 4,
                misses: 8,
                tag_bits: 5,
                index_bits: 20,
                bus_bits: 32,
                timing: Timing::at(133),
                ..reference
            },
        ),
        (
            "wide_bus",
            Shape {
                record_bits: 72,
                sets: 64,
                misses: 16,
                line_bytes: 128,
                bus_bits: 256,
                timing: Timing::at(133),
                ..reference
            },
        ),
        (
            "one_miss",
            Shape {
                record_bits: 32,
                record_bytes: 4,
                line_bytes: 32,
                sets: 2,
                misses: 1,
                tag_bits: 3,
                index_bits: 24,
                bus_bits: 64,
                address_bits: 28,
                timing: Timing::at(50),
                ..reference
            },
        ),
        (
            "one_beat",
            Shape {
                record_bits: 90,
                line_bytes: 16,
                sets: 4,
                misses: 5,
                tag_bits: 4,
                ..reference
            },
        ),
    ]
}

/// What a run found.
#[derive(Clone, Debug)]
pub struct CacheReport {
    /// Requests as its transactions, batches as its packets.
    pub unit: UnitReport,
    pub counts: CacheCounts,
    /// Cycles in which a request waited.
    pub stalls: u64,
}

impl CacheReport {
    /// The report in a few lines.
    pub fn summary(&self) -> String {
        let CacheCounts { hits, misses, .. } = self.counts;
        format!(
            "{}\n  {hits} hits ({:.4}), {misses} lines requested, {} cycles in which a request waited",
            self.unit.summary(),
            self.counts.hit_rate(),
            self.stalls
        )
    }
}

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// The most 32-bit words of a record or a beat.
const WORDS: usize = 16;

/// An accepted request.
#[derive(Clone, Copy, Debug)]
struct Waiting {
    line: u64,
    address: u64,
}

/// A burst under way.
struct Flight {
    line: u64,
    id: u64,
    beat: u32,
    due: u64,
}

/// In which order beats come.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Order {
    /// Burst after burst as requested; bursts in any order; any beat.
    Requested,
    Bursts,
    Beats,
}

/// What happened in a cycle inside the cache.
#[derive(Clone, Copy, Debug, Default)]
struct Moment {
    decided: bool,
    hit: bool,
    missed: bool,
    waited: bool,
    /// The last beat of this line arrived.
    last_beat: Option<u64>,
}

/// Co-simulates a cache.
///
/// # Errors
/// A tool that is missing. A mismatch is no error here: it is in the report.
pub fn run(shape: &Shape, requests: u64, options: &UnitOptions) -> Result<CacheReport> {
    let module = module("cache", shape)?;
    let mut bench = Bench::new("cache", &module, options)?;
    let ports = bench.model.ports(&ports(shape))?;
    bench.model.reset(RESET_CYCLES);
    let mut run = Run::new(*shape, bench, ports, options);
    let ended = run.all(requests, options);
    Ok(CacheReport {
        counts: run.golden.counts,
        stalls: run.stalls,
        unit: run.bench.report(ended, CATEGORIES)?,
    })
}

struct Run {
    shape: Shape,
    bench: Bench,
    ports: Ports,
    rng: fastrand::Rng,
    golden: Cache,
    /// Of memory's contents.
    generation: u64,
    base: u64,
    /// By tag.
    waiting: Vec<Option<Waiting>>,
    free: Vec<u64>,
    /// Tags that are accepted and not decided, in order.
    undecided: VecDeque<u64>,
    flights: Vec<Flight>,
    /// Lines that the model requests, and those of bursts: the same in the same order, either may be ahead.
    wanted: VecDeque<u64>,
    taken: VecDeque<u64>,
    order: Order,
    /// The request that is offered.
    offered: Option<(u64, u64)>,
    /// Moments that are not compared yet: the last one is that of this cycle.
    moments: VecDeque<Moment>,
    /// Lines that are complete, and not all of whose list is answered.
    complete: Vec<u64>,
    /// Compared moments: the line requested, and the line whose last answer left, in the one before.
    requested_before: Option<u64>,
    completed_before: Option<u64>,
    /// A burst that was refused, the id of the last beat.
    refused: Option<Burst<u64>>,
    beat_before: Option<(u64, bool)>,
    /// The error of the beat that is shown, and of the one before.
    error_due: Option<u64>,
    error_shown: Option<u64>,
    stall_due: Option<bool>,
    stalls: u64,
    events: CacheCounts,
    trace: Locality,
    idle: u64,
    invalidating: u32,
}

/// Makes indices of records, segment by segment.
struct Locality {
    first: u64,
    records: u64,
    left: u32,
    kind: u32,
    at: u64,
    step: u64,
}

impl Run {
    fn new(shape: Shape, bench: Bench, ports: Ports, options: &UnitOptions) -> Run {
        let tags = 1u64 << shape.tag_bits;
        Run {
            bench,
            ports,
            rng: fastrand::Rng::with_seed(options.seed),
            golden: Cache::new(Sizes {
                ways: shape.ways as usize,
                sets: shape.sets as usize,
                misses: shape.misses as usize,
            }),
            generation: 0,
            base: 0,
            waiting: vec![None; tags as usize],
            free: (0..tags).collect(),
            undecided: VecDeque::new(),
            flights: vec![],
            wanted: VecDeque::new(),
            taken: VecDeque::new(),
            order: Order::Requested,
            offered: None,
            moments: (0..=shape.answer_latency())
                .map(|_| Moment::default())
                .collect(),
            complete: vec![],
            requested_before: None,
            completed_before: None,
            refused: None,
            beat_before: None,
            error_due: None,
            error_shown: None,
            stall_due: None,
            stalls: 0,
            events: CacheCounts::default(),
            trace: Locality {
                first: 0,
                records: 1,
                left: 0,
                kind: 0,
                at: 0,
                step: 1,
            },
            idle: 0,
            invalidating: 0,
            shape,
        }
    }

    fn all(&mut self, requests: u64, options: &UnitOptions) -> Result<()> {
        self.move_array();
        while self.bench.tally.transactions < requests {
            let around = match options.surroundings {
                Some(around) => around,
                None => self.surroundings(),
            };
            self.order = [Order::Requested, Order::Bursts, Order::Beats][self.rng.usize(..3)];
            let length = [3, 30, 300, 3000][self.rng.usize(..4)];
            let length = self
                .rng
                .u64(1..=length)
                .min(requests - self.bench.tally.transactions);
            let tags = match self.rng.u8(..4) {
                0 => self.rng.usize(1..=self.free.len()),
                _ => self.free.len(),
            };
            self.batch(length, tags, &around)?;
            self.between()?;
            self.bench.tally.packets += 1;
        }
        let field = |name, golden, rtl| Field::integer(name, golden, rtl);
        let (golden, rtl) = (self.golden.counts, self.events);
        if golden != rtl {
            let fields = vec![
                field("requests", golden.requests, rtl.requests),
                field("hits", golden.hits, rtl.hits),
                field("misses", golden.misses, rtl.misses),
            ];
            return Err(self.bench.mismatch("after all requests", fields));
        }
        Ok(())
    }

    /// Mostly short latencies: then lines come back while much else goes on.
    fn surroundings(&mut self) -> Surroundings {
        let mut around = Surroundings::random(&mut self.rng);
        if self.rng.bool() {
            around.memory.latency = self.rng.u32(1..=12);
            around.memory.jitter = self.rng.u32(0..=8);
        }
        around
    }

    /// Chooses another place for the array in memory, and another part of it.
    fn move_array(&mut self) {
        let shape = &self.shape;
        let all = 1u64 << shape.index_bits;
        let lines = u64::from(shape.bytes() / shape.record_bytes);
        let records = (lines * [1, 2, 8][self.rng.usize(..3)]).min(all);
        let span = all * u64::from(shape.record_bytes);
        let bases = ((1u64 << shape.address_bits).saturating_sub(span)) / u64::from(BASE_BYTES);
        self.base = self.rng.u64(0..=bases) * u64::from(BASE_BYTES);
        let first = self.rng.u64(0..=all - records);
        self.trace = Locality {
            first,
            records,
            ..self.trace
        };
        let base = self.ports.inputs.base;
        // A base at the end of all addresses is only possible for an array of no bytes.
        let top = (1u64 << shape.address_bits) - u64::from(BASE_BYTES);
        self.base = self.base.min(top);
        self.bench.model.set(base, self.base);
    }

    /// Between batches no request is outstanding: memory may change if all lines are discarded, and the array may move in any case.
    fn between(&mut self) -> Result<()> {
        if self.rng.bool() {
            self.move_array();
            self.bench.tally.categories.count(Category::MovedBase, true);
        }
        if self.rng.u8(..3) == 0 {
            return Ok(());
        }
        let pause = [0, 0, 1, 2, 20][self.rng.usize(..5)];
        for _ in 0..pause {
            self.cycle(&Surroundings::steady(1))?;
        }
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::Invalidation, true);
        categories.count(Category::InvalidatedAtOnce, pause == 0);
        self.bench.model.set(self.ports.inputs.invalidate, 1);
        if self.rng.bool() && self.offered.is_none() {
            self.offer();
        }
        self.cycle(&Surroundings::steady(1))?;
        self.bench.model.set(self.ports.inputs.invalidate, 0);
        self.golden.invalidate();
        self.generation += 1;
        Ok(())
    }

    /// Offers so many requests, with at most so many tags in use, until all are answered.
    fn batch(&mut self, length: u64, tags: usize, around: &Surroundings) -> Result<()> {
        let mut left = length;
        if self.offered.is_some() {
            left -= 1;
        }
        let all = self.waiting.len();
        loop {
            let in_use = all - self.free.len();
            if left == 0 && self.offered.is_none() && in_use == 0 {
                return Ok(());
            }
            let pauses = self.rng.f64() < around.pauses;
            if self.offered.is_none() && left > 0 && in_use < tags && !pauses {
                self.offer();
                left -= 1;
            }
            self.cycle(around)?;
        }
    }

    fn offer(&mut self) {
        let tag = self.free.swap_remove(self.rng.usize(..self.free.len()));
        let index = self.trace.next(&self.shape, &mut self.rng);
        self.offered = Some((index, tag));
    }

    fn line_of(&self, address: u64) -> u64 {
        address / u64::from(self.shape.line_bytes)
    }

    /// One cycle: inputs, outputs, clock.
    fn cycle(&mut self, around: &Surroundings) -> Result<()> {
        let Ports { inputs, outputs } = self.ports;
        let model = &mut self.bench.model;
        model.set(inputs.request.valid, self.offered.is_some().into());
        match self.offered {
            Some((address, tag)) => {
                model.drive(&inputs.request.payload, Request { address, tag });
            }
            None => model.garble(inputs.request.payload.leaves(), &mut self.rng),
        }
        let takes_burst = self.rng.f64() >= around.memory.backpressure;
        model.set(inputs.burst_ready, takes_burst.into());
        let last_beat = self.show_beat(around);
        self.bench.model.eval();

        let now = self.moments.back_mut().expect("a moment for each cycle");
        now.last_beat = last_beat;
        self.check_steady()?;
        self.take_events()?;
        self.take_response()?;
        self.take_burst(takes_burst, around)?;
        let blocked = self.bench.model.get(outputs.invalidating) != 0
            || self.bench.model.get(inputs.invalidate) != 0;
        let ready = self.bench.model.get(outputs.request_ready) != 0;
        if blocked && ready {
            return Err(self
                .bench
                .mismatch("ready while lines are discarded", vec![]));
        }
        self.stall_due = (!blocked).then_some(!ready);
        if let (true, Some((index, tag))) = (ready, self.offered) {
            let address = self.base + index * u64::from(self.shape.record_bytes);
            let line = self.line_of(address);
            self.waiting[tag as usize] = Some(Waiting { line, address });
            self.undecided.push_back(tag);
            self.offered = None;
            self.idle = 0;
        }
        self.bench.model.clock();
        self.moments.push_back(Moment::default());
        self.idle += 1;
        if self.idle > around.patience() {
            let place = format!("nothing has happened for {} cycles", self.idle);
            return Err(self.bench.mismatch(place, vec![]));
        }
        Ok(())
    }

    /// Shows a beat for the coming edge, or none. Returns the line that it completes.
    fn show_beat(&mut self, around: &Surroundings) -> Option<u64> {
        let now = self.bench.model.cycles();
        let bandwidth = around.memory.bandwidth;
        let slow = self.rng.u32(..bandwidth.cycles) >= bandwidth.requests;
        let due: Vec<usize> = (self.flights.iter().enumerate())
            .filter(|(_, flight)| flight.due <= now)
            .map(|(k, _)| k)
            .collect();
        let begun = due.iter().find(|k| self.flights[**k].beat > 0);
        let chosen = match self.order {
            Order::Requested => due.first().filter(|k| **k == 0),
            Order::Bursts if begun.is_some() => begun,
            _ if due.is_empty() => None,
            _ => Some(&due[self.rng.usize(..due.len())]),
        };
        let inputs = &self.ports.inputs;
        let model = &mut self.bench.model;
        let Some(&chosen) = chosen.filter(|_| !slow) else {
            model.set(inputs.beat.valid, 0);
            model.garble(inputs.beat.payload.leaves(), &mut self.rng);
            self.error_due = None;
            return None;
        };
        let shape = &self.shape;
        let flight = &mut self.flights[chosen];
        let (line, id, beat) = (flight.line, flight.id, flight.beat);
        flight.beat += 1;
        let last = flight.beat == shape.beats();
        let error = self.rng.u8(..64) == 0;
        let address = line * u64::from(shape.line_bytes);
        model.set(inputs.beat.valid, 1);
        let Beat { data, .. } = inputs.beat.payload;
        let words = shape.bus_bytes().div_ceil(4) as usize;
        let first = address + u64::from(beat * shape.bus_bytes());
        let contents = contents(self.generation, first, words);
        model.set_words(data, &contents[..words]);
        model.set(inputs.beat.payload.id, id);
        model.set(inputs.beat.payload.last, last.into());
        model.set(inputs.beat.payload.error, error.into());
        self.error_due = error.then_some(address);
        let categories = &mut self.bench.tally.categories;
        categories.count(Category::BusError, error);
        let between = (self.beat_before).is_some_and(|(before, ended)| before != id && !ended);
        categories.count(Category::InterleavedBeats, between);
        categories.count(Category::LinesOvertake, last && chosen > 0);
        self.beat_before = Some((id, last));
        if last {
            self.flights.remove(chosen);
        }
        self.idle = 0;
        last.then_some(line)
    }

    /// What must hold in every cycle: `idle`, the length of an invalidation.
    fn check_steady(&mut self) -> Result<()> {
        let (outputs, model) = (&self.ports.outputs, &self.bench.model);
        let outstanding = self.waiting.iter().any(Option::is_some);
        let idle = model.get(outputs.idle);
        if idle != u64::from(!outstanding) {
            let field = Field::integer("idle", (!outstanding).into(), idle);
            return Err(self.bench.mismatch("the flag of no request", vec![field]));
        }
        self.invalidating = match model.get(outputs.invalidating) {
            0 => 0,
            _ => self.invalidating + 1,
        };
        if self.invalidating > self.shape.sets {
            let place = "lines are discarded for more cycles than there are sets";
            return Err(self.bench.mismatch(place, vec![]));
        }
        Ok(())
    }

    /// Takes the events, which tell of the cycle before, and the error of the beat of the cycle before.
    fn take_events(&mut self) -> Result<()> {
        let outputs = &self.ports.outputs;
        let event = self.bench.model.sample(&outputs.event);
        let waits = event.stalls != 0;
        if let Some(due) = self.stall_due.filter(|due| *due != waits) {
            let field = Field::integer("stall", due.into(), event.stalls);
            return Err(self
                .bench
                .mismatch("the event of a request that waits", vec![field]));
        }
        self.stalls += event.stalls;
        self.events.requests += event.requests;
        self.events.hits += event.hits;
        self.events.misses += event.misses;
        // In the first cycle there is none before.
        let len = self.moments.len();
        let before = &mut self.moments[len - 2];
        before.decided = event.requests != 0;
        before.hit = event.hits != 0;
        before.missed = event.misses != 0;
        before.waited = waits;
        let shown = self.bench.model.get(outputs.error.valid) != 0;
        let shown = shown.then(|| self.bench.model.get(outputs.error.payload.address));
        let (due, now) = (self.error_shown, shown);
        if due != now {
            let fields = vec![
                Field::integer("is an error", due.is_some().into(), now.is_some().into()),
                Field::integer("address", due.unwrap_or(0), now.unwrap_or(0)),
            ];
            return Err(self.bench.mismatch("an error of the bus", fields));
        }
        self.error_shown = self.error_due;
        Ok(())
    }

    /// Takes the response, and compares the moment from which it comes.
    fn take_response(&mut self) -> Result<()> {
        let outputs = self.ports.outputs.response;
        let model = &self.bench.model;
        let response = (model.get(outputs.valid) != 0).then(|| model.get(outputs.payload.tag));
        let moment = self.moments.pop_front().expect("a moment for each cycle");
        if let Some(line) = moment.last_beat {
            self.complete.push(line);
        }
        self.check_moment(moment, response)?;
        let Some(tag) = response else {
            return Ok(());
        };
        let Some(Waiting { address, .. }) = self.waiting[tag as usize].take() else {
            let place = format!("a response with tag {tag}, which is not in use");
            return Err(self.bench.mismatch(place, vec![]));
        };
        self.free.push(tag);
        self.idle = 0;
        let mut shown = [0; WORDS];
        let words = self.shape.record_bits.div_ceil(32) as usize;
        let data = outputs.payload.data;
        self.bench.model.get_words(data, &mut shown[..words]);
        let expected = contents(self.generation, address, words);
        let mut fields = vec![];
        for word in 0..words {
            let bits = (self.shape.record_bits - 32 * word as u32).min(32);
            let golden = u64::from(expected[word]) & (u64::MAX >> (64 - bits));
            fields.push(Field::integer(
                format!("word {word}"),
                golden,
                shown[word].into(),
            ));
        }
        if fields.iter().any(Field::differs) {
            let place = format!("the record at byte {address:#x}, tag {tag}");
            return Err(self.bench.mismatch(place, fields));
        }
        self.bench.tally.transactions += 1;
        self.bench.tally.checked += 1;
        Ok(())
    }

    /// Compares what happened in a cycle inside with the model.
    fn check_moment(&mut self, moment: Moment, response: Option<u64>) -> Result<()> {
        let answered = response.filter(|tag| self.golden.is_listed(*tag));
        let front = self.undecided.front().copied();
        let line_of = |run: &Run, tag: u64| run.waiting[tag as usize].map(|waiting| waiting.line);
        let front_line = front.and_then(|tag| line_of(self, tag));
        if moment.waited {
            let Some(line) = front_line else {
                return Err(self.bench.mismatch("a request waits that is none", vec![]));
            };
            let waits = self.golden.waits(line);
            let categories = &mut self.bench.tally.categories;
            if let Some(waits) = waits {
                categories.count(Category::RegistersInUse, waits.registers);
                categories.count(Category::WaysInFlight, waits.ways);
            } else if answered.is_none() {
                let place = format!("the request of line {line:#x} waits for nothing");
                return Err(self.bench.mismatch(place, vec![]));
            }
        }
        let mut requested = None;
        let mut hit = None;
        if moment.decided {
            let (Some(tag), Some(line)) = (front, front_line) else {
                return Err(self.bench.mismatch("a decision of no request", vec![]));
            };
            self.undecided.pop_front();
            if self.golden.waits(line).is_some() || answered.is_some() {
                let place = format!("the request of line {line:#x} does not wait");
                return Err(self.bench.mismatch(place, vec![]));
            }
            let under_miss = self.golden.in_flight() > 0;
            let outcome = self.golden.lookup(line, tag);
            let golden = [
                matches!(outcome, Outcome::Hit),
                matches!(outcome, Outcome::Requested { .. }),
            ];
            if golden != [moment.hit, moment.missed] {
                let fields = vec![
                    Field::integer("hit", golden[0].into(), moment.hit.into()),
                    Field::integer("miss", golden[1].into(), moment.missed.into()),
                ];
                let place = format!("the request of line {line:#x}, tag {tag}");
                return Err(self.bench.mismatch(place, fields));
            }
            let arrived = self.complete.contains(&line);
            let categories = &mut self.bench.tally.categories;
            match outcome {
                Outcome::Hit => {
                    hit = Some(tag);
                    categories.count(Category::HitUnderMiss, under_miss);
                    let after = self.completed_before == Some(line);
                    categories.count(Category::HitAfterAnswers, after);
                }
                Outcome::Listed { place } => {
                    categories.count(Category::ListedRequest, true);
                    categories.count(Category::LongList, place == 3);
                    categories.count(Category::ListedAtLastBeat, arrived);
                    let next = self.requested_before == Some(line);
                    categories.count(Category::NextInLine, next);
                }
                Outcome::Requested { replaced } => {
                    requested = Some(line);
                    categories.count(Category::ReplacedLine, replaced.is_some());
                    self.wanted.push_back(line);
                    self.match_bursts()?;
                }
            }
        } else if moment.hit || moment.missed {
            return Err(self.bench.mismatch("a hit or a miss of no request", vec![]));
        }
        self.requested_before = requested;
        self.completed_before = None;
        if let Some(tag) = answered {
            let Some((line, arrived)) = self.golden.answered(tag) else {
                let place = format!("tag {tag} is answered before one that came earlier");
                return Err(self.bench.mismatch(place, vec![]));
            };
            if !self.complete.contains(&line) {
                let place = format!("tag {tag} is answered before line {line:#x} is complete");
                return Err(self.bench.mismatch(place, vec![]));
            }
            if arrived {
                self.complete.retain(|of| *of != line);
                self.completed_before = Some(line);
            }
        } else if response != hit {
            let none = u64::MAX;
            let fields = vec![Field::integer(
                "tag",
                hit.unwrap_or(none),
                response.unwrap_or(none),
            )];
            return Err(self.bench.mismatch("a response and a hit", fields));
        }
        Ok(())
    }

    /// Takes a burst, which must be of a line that was requested.
    fn take_burst(&mut self, takes: bool, around: &Surroundings) -> Result<()> {
        let outputs = &self.ports.outputs;
        let model = &self.bench.model;
        let shown =
            (model.get(outputs.burst.valid) != 0).then(|| model.sample(&outputs.burst.payload));
        if let Some(refused) = self.refused.filter(|refused| shown != Some(*refused)) {
            let place = format!("a burst that waits changes: {refused:x?} to {shown:x?}");
            return Err(self.bench.mismatch(place, vec![]));
        }
        self.refused = shown.filter(|_| !takes);
        let Some(burst) = shown.filter(|_| takes) else {
            return Ok(());
        };
        let (line, beats) = (self.line_of(burst.address), self.shape.beats());
        let aligned = burst.address % u64::from(self.shape.line_bytes) == 0;
        if !aligned || burst.beats + 1 != u64::from(beats) {
            let place = format!("a burst is no line: {burst:x?}");
            return Err(self.bench.mismatch(place, vec![]));
        }
        let taken =
            (self.flights.iter()).any(|flight| flight.line == line || flight.id == burst.id);
        if taken {
            let place = format!("a line or a register is in flight already: {burst:x?}");
            return Err(self.bench.mismatch(place, vec![]));
        }
        let memory = around.memory;
        let clocks = memory.latency + self.rng.u32(0..=memory.jitter);
        self.flights.push(Flight {
            line,
            id: burst.id,
            beat: 0,
            due: self.bench.model.cycles() + u64::from(clocks),
        });
        self.taken.push_back(line);
        self.idle = 0;
        self.match_bursts()
    }

    /// Compares the lines of bursts with those that the model requests.
    fn match_bursts(&mut self) -> Result<()> {
        while let (Some(golden), Some(rtl)) = (self.wanted.front(), self.taken.front()) {
            if golden != rtl {
                let field = Field::integer("line", *golden, *rtl);
                return Err(self.bench.mismatch("a burst", vec![field]));
            }
            self.wanted.pop_front();
            self.taken.pop_front();
            self.bench.tally.checked += 1;
        }
        Ok(())
    }
}

impl Locality {
    /// The next index of a record.
    fn next(&mut self, shape: &Shape, rng: &mut fastrand::Rng) -> u64 {
        let in_line = u64::from(shape.line_bytes / shape.record_bytes);
        if self.left == 0 {
            self.left = rng.u32(1..=200);
            self.kind = rng.u32(..7);
            self.at = rng.u64(..self.records);
            self.step = match rng.bool() {
                true => in_line * rng.u64(1..=8),
                false => rng.u64(1..=3 * in_line),
            };
        }
        self.left -= 1;
        let of_way = in_line * u64::from(shape.sets);
        let next = match self.kind {
            // In order; at a distance.
            0 => {
                self.at += 1;
                self.at
            }
            1 => {
                self.at += self.step;
                self.at
            }
            // Anywhere; in a window; in one line.
            2 => rng.u64(..),
            3 => self.at + rng.u64(..4 * in_line),
            4 => self.at / in_line * in_line + rng.u64(..in_line),
            // In more lines of one set than there are ways, records once or several times.
            5 => {
                let lines = u64::from(shape.ways) + 1;
                self.at + rng.u64(..lines) * of_way + rng.u64(..in_line)
            }
            _ => {
                let lines = u64::from(shape.ways) + 2;
                self.at + (u64::from(self.left) / self.step % lines) * of_way
            }
        };
        self.first + next % self.records
    }
}

/// Words of memory from a byte address on: any, but the same for the same address and generation.
fn contents(generation: u64, address: u64, words: usize) -> [u32; WORDS] {
    let mut all = [0; WORDS];
    for (k, word) in all[..words].iter_mut().enumerate() {
        let x = (address / 4 + k as u64) ^ generation << 32;
        let x = (x ^ x >> 31).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        let x = (x ^ x >> 29).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        *word = (x >> 32) as u32;
    }
    all
}
