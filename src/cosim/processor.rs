//! Common code of the co-simulations of the two processors: memories at their ports, optionally with limited traffic, a start that is
//! offered until it is accepted, and results in order.

use super::memory::{
    Image, ReadHandles, ReadPort, ReadRequest, ReadResponse, Timing, WriteHandles, WritePort,
    WriteRequest,
};
use super::mismatch::Field;
use super::model::{Model, PortHandle};
use super::scoreboard::{Bench, Surroundings, UnitOptions, UnitReport};
use crate::bkd::layout::Record;
use crate::config::Config;
use crate::float::Format;
use anyhow::{Result, ensure};

/// The limit of the memories' traffic, in addition to [`Surroundings`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Traffic {
    /// No limit: each port has its own memory.
    Separate,
    /// One memory behind all ports, which are served in turn.
    ///
    /// The update processor's memory accepts one request per cycle: a row of the program, a vertex, or a node's numbers. With up to 32 bits
    /// per number this is at most 16 bytes per cycle, padded to a row. (Only the object's box, once per update, is longer.)
    ///
    /// The skinning processor's memory transfers [`SHARED_BYTES`](super::unit_skinning::SHARED_BYTES) per cycle, for reads and writes together.
    /// A record uses whole bytes: in Fp24 9 for a vector and 16 for a row of influences. At most the bytes of one cycle are saved up.
    Shared,
}

/// Serves ports that may share a memory.
pub(super) struct Share<const N: usize> {
    traffic: Traffic,
    /// The cost of a request at each port, the credit per cycle, and the maximum credit.
    costs: [u32; N],
    each_clock: u32,
    saved: u32,
    budget: u32,
    turn: usize,
}

impl<const N: usize> Share<N> {
    pub fn new(traffic: Traffic, costs: [u32; N], each_clock: u32, saved: u32) -> Share<N> {
        Share {
            traffic,
            costs,
            each_clock,
            saved,
            budget: each_clock,
            turn: 0,
        }
    }

    /// The ports that may transfer a request in this cycle, given those that offer one.
    pub fn grant(&mut self, offered: [bool; N]) -> [bool; N] {
        if self.traffic == Traffic::Separate {
            return [true; N];
        }
        let mut granted = [false; N];
        let first = self.turn;
        for port in (0..N).map(|k| (first + k) % N) {
            if offered[port] && self.costs[port] <= self.budget {
                granted[port] = true;
                self.budget -= self.costs[port];
                self.turn = port + 1;
            }
        }
        self.budget = self.budget.min(self.saved) + self.each_clock;
        granted
    }
}

/// The memory at a read port. In each cycle call [`Reads::offers`], [`Reads::show`] and [`Reads::step`].
pub(super) struct Reads {
    handles: ReadHandles,
    port: ReadPort,
    request: Option<ReadRequest>,
    answer: Option<ReadResponse>,
}

impl Reads {
    pub fn new(handles: ReadHandles, port: ReadPort) -> Reads {
        Reads {
            handles,
            port,
            request: None,
            answer: None,
        }
    }

    /// Whether the port offers a request that the memory accepts if it is granted.
    pub fn offers(&mut self, model: &Model) -> bool {
        self.request = model.read_request(&self.handles);
        self.request.is_some() && self.port.ready()
    }

    /// The requested address.
    pub fn address(&self) -> u64 {
        self.request.map_or(0, |request| request.address)
    }

    /// Drives the inputs of the unit for the edge: `record` gives the words at an address.
    pub fn show<R: AsRef<[u32]>>(
        &self,
        model: &mut Model,
        granted: bool,
        record: impl FnOnce(u64) -> R,
    ) {
        let ready = self.port.ready() && granted;
        model.set(self.handles.request.ready, ready.into());
        let data = self.answer.map(|answer| record(answer.address));
        let words = data.as_ref().map_or(&[][..], AsRef::as_ref);
        model.respond(&self.handles, self.answer, words);
    }

    /// Performs the edge; returns whether there is a response for the next one.
    pub fn step(&mut self, granted: bool) -> Result<bool> {
        self.answer = self.port.step(self.request.filter(|_| granted))?;
        Ok(self.answer.is_some())
    }

    pub fn stop(&self, model: &mut Model) {
        model.set(self.handles.request.ready, 0);
        model.set(self.handles.response.valid, 0);
    }
}

/// The memory at a write port. In each cycle call [`Writes::offers`], [`Writes::show`] and [`Writes::step`].
pub(super) struct Writes {
    record: Record,
    format: Format,
    handles: WriteHandles,
    mask: Option<PortHandle>,
    /// The required mask; also used if the port has no mask.
    whole: u64,
    port: WritePort,
    data: Vec<u32>,
}

impl Writes {
    /// For records whose first `numbers` fields are written, selected by a `mask` if there are more fields.
    pub fn new(
        record: Record,
        format: Format,
        numbers: usize,
        handles: WriteHandles,
        mask: Option<PortHandle>,
        timing: Timing,
    ) -> Result<Writes> {
        let mut lanes = vec![format.width(); numbers];
        let rest = record.width - lanes.iter().sum::<u32>();
        lanes.extend((rest > 0).then_some(rest));
        Ok(Writes {
            port: WritePort::new(record.name, &lanes, timing)?,
            data: vec![0; record.words()],
            record,
            format,
            handles,
            mask,
            whole: (1 << numbers) - 1,
        })
    }

    /// Whether the port offers a write that the memory accepts if it is granted.
    pub fn offers(&self, model: &Model) -> bool {
        model.get(self.handles.valid) != 0 && self.port.ready()
    }

    pub fn show(&self, model: &mut Model, granted: bool) {
        let ready = self.port.ready() && granted;
        model.set(self.handles.ready, ready.into());
    }

    fn mask(&self, model: &Model) -> u64 {
        self.mask.map_or(self.whole, |mask| model.get(mask))
    }

    /// Performs the edge, at which the offered write is or is not `accepted`.
    pub fn step(&mut self, model: &Model, accepted: bool, image: &mut Image) -> Result<()> {
        if accepted {
            model.get_words(self.handles.payload.data, &mut self.data);
        }
        let write = WriteRequest {
            address: model.get(self.handles.payload.address),
            data: &self.data,
            mask: self.mask(model),
        };
        self.port.step(accepted.then_some(write), image)?;
        Ok(())
    }

    pub fn stop(&self, model: &mut Model) {
        model.set(self.handles.ready, 0);
    }
}

/// Offers a start until it is accepted, and detects a unit that has stopped.
pub(super) struct Pace {
    pauses: f64,
    patience: u64,
    pub started: bool,
    idle: u64,
}

impl Pace {
    pub fn new(around: &Surroundings) -> Pace {
        Pace {
            pauses: around.pauses,
            patience: around.patience(),
            started: false,
            idle: 0,
        }
    }

    /// Whether a start is offered in this cycle.
    pub fn starts(&self, rng: &mut fastrand::Rng) -> bool {
        let pauses = self.pauses > 0.0 && rng.f64() < self.pauses;
        !self.started && !pauses
    }

    /// Call after each edge. Returns the number of cycles without an event if it exceeds the limit.
    pub fn step(&mut self, starting: bool, accepted: &[bool]) -> Option<u64> {
        self.started |= starting;
        let progress = starting || accepted.contains(&true);
        self.idle = if progress { 0 } else { self.idle + 1 };
        (self.idle > self.patience).then_some(self.idle)
    }
}

/// Compares results in order.
impl Bench {
    /// Checks that counters start at 0.
    pub fn counts_from_zero(&self, counts: &[u64]) -> Result<()> {
        if counts.iter().all(|&count| count == 0) {
            return Ok(());
        }
        let fields = counts
            .iter()
            .map(|&count| Field::integer("counter", 0, count));
        Err(self.mismatch("after reset", fields.collect()))
    }

    /// Compares a read with the next one of the golden model.
    pub fn ordered(&mut self, what: &str, golden: Option<u32>, rtl: u64) -> Result<()> {
        self.tally.checked += 1;
        match golden.map(u64::from) {
            Some(golden) if golden == rtl => Ok(()),
            Some(golden) => {
                let fields = vec![Field::integer("index", golden, rtl)];
                Err(self.mismatch(what, fields))
            }
            None => Err(self.mismatch(format!("one {what} too many, at {rtl}"), vec![])),
        }
    }

    /// Compares a write with the next one of the golden model, at `place`.
    pub fn written<const N: usize>(
        &mut self,
        place: impl Into<String>,
        golden: Option<(u32, [u64; N])>,
        port: &Writes,
    ) -> Result<()> {
        self.tally.checked += 1;
        let (model, w, name) = (&self.model, port.format.width(), port.record.name);
        let address = model.get(port.handles.payload.address);
        let Some((index, numbers)) = golden else {
            let place = format!("one {name} too many is written, at {address}");
            return Err(self.mismatch(place, vec![]));
        };
        let number = |k| model.get_field(port.handles.payload.data, k as u32 * w, w);
        let rtl: [u64; N] = std::array::from_fn(number);
        let mask = port.mask(model);
        if (address, rtl, mask) == (index.into(), numbers, port.whole) {
            return Ok(());
        }
        let mut fields = vec![Field::integer(name, index.into(), address)];
        if port.mask.is_some() {
            fields.push(Field::integer("write mask", port.whole, mask));
        }
        for (field, (golden, rtl)) in port.record.fields.iter().zip(numbers.into_iter().zip(rtl)) {
            fields.push(Field::number(field.name, port.format, golden, rtl));
        }
        Err(self.mismatch(place, fields))
    }

    /// Compares the final contents of a memory; `place` names it.
    pub fn same_memory(&self, place: &str, golden: &[u32], rtl: &Image) -> Result<()> {
        let differs = golden.iter().zip(rtl.words()).position(|(g, r)| g != r);
        let Some(word) = differs else { return Ok(()) };
        let (golden, rtl) = (golden[word], rtl.words()[word]);
        let fields = vec![Field::integer("word", golden.into(), rtl.into())];
        Err(self.mismatch(format!("word {word} of {place}"), fields))
    }
}

/// The timing of a receiver of writes. It pauses independently, so slow writes also meet fast reads.
pub(super) fn write_timing(around: &Surroundings, port: u64) -> Timing {
    Timing {
        backpressure: around.pauses,
        ..around.port(port)
    }
}

/// The given surroundings, or random ones.
pub(super) fn surroundings(options: &UnitOptions, rng: &mut fastrand::Rng) -> Surroundings {
    match options.surroundings {
        Some(around) => around,
        // Fast reads and slowly accepted writes, because otherwise the reads are always the bottleneck.
        // In some runs writes are so slow that all queues are full.
        None if rng.u8(..4) == 0 => Surroundings {
            pauses: if rng.bool() { 0.8 } else { 0.97 },
            ..Surroundings::steady(rng.u32(1..=10))
        },
        None => Surroundings::random(rng),
    }
}

/// Checks that a machine's addresses can reach the `most` records of an array.
pub(super) fn check_capacity(config: &Config, what: &str, most: u64) -> Result<()> {
    ensure!(
        most < 1 << config.address_bits,
        "the {what} take {most} indices, but tree.address_bits = {} address {}; set it to {} or more",
        config.address_bits,
        1u64 << config.address_bits,
        64 - most.leading_zeros()
    );
    Ok(())
}

/// A report in a few lines, with the last lines of each figure.
pub(super) fn summary(
    unit: &UnitReport,
    [transactions, packets]: [&str; 2],
    figures: impl Iterator<Item = String>,
) -> String {
    let mut text = format!(
        "{}: {} {transactions} of {} {packets}, {} results checked, {} mismatches in {} cycles (seed {}; model {:.1} s, run {:.1} s)",
        unit.unit,
        unit.transactions,
        unit.packets,
        unit.checked,
        unit.mismatches,
        unit.cycles,
        unit.seed,
        unit.model_build_s,
        unit.simulate_s
    );
    for (category, count) in &unit.categories {
        text += &format!("\n  {:28} {count:>10}", category.name());
    }
    figures.for_each(|figure| text += &format!("\n  {figure}"));
    text
}
