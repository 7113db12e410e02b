//! The environment of a unit under test: memory behind a tagged read port or a write port, and ready/valid
//! streams that stall at random.
//!
//! # Cycles
//!
//! A rising edge *k* samples the unit's inputs; after it the unit shows its outputs for edge *k* + 1. A
//! model here is stepped once per rising edge, just before it, with what the unit shows for that edge:
//!
//! ```text
//! loop {
//!     unit.set(ready, port.ready());              // for this edge
//!     unit.eval();                                // only if a request depends on an input in the same cycle
//!     let request = unit.get(valid) != 0 then Some(ReadRequest { address, tag });
//!     let response = port.step(request)?;         // accepts the request if, and only if, ready() was true
//!     unit.clock();                               // the edge
//!     unit.set(response_valid, response.is_some()); // for the next edge, with its tag and image.row(address)
//! }
//! ```
//!
//! So with a latency of L clocks, the response to a request accepted at edge *k* is sampled by the unit at
//! edge *k* + L, and with L = 1 it comes out of the very step that took the request.
//!
//! Everything random comes from the seed given, through [`fastrand`]: the same seed and the same requests
//! give the same run.

use super::model::{Model, PortHandle};
use anyhow::{Result, bail, ensure};
use dynrt_hdl::{Stream, Write};

/// A limit of `requests` accepted requests in `cycles` clocks.
///
/// In any span of *n* clocks at most ⌈*n* · requests ÷ cycles⌉ are accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bandwidth {
    /// Requests accepted per `cycles` clocks, at least 1 and at most `cycles`.
    pub requests: u32,
    /// The clocks in which they are accepted, at least 1.
    pub cycles: u32,
}

/// When a port takes requests and when it answers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
    /// Clocks from the edge that accepts a request to the edge that samples its response, 1 to 2²⁰.
    pub latency: u32,
    /// Greatest number of clocks by which a response is late, 0 to 2²⁰; each is late by a random number.
    pub jitter: u32,
    /// Whether responses come in another order than the requests did. Takes a `jitter` of at least 1, which
    /// is what moves one response past another.
    pub out_of_order: bool,
    /// How many requests are accepted; one a clock is the most a port can take.
    pub bandwidth: Bandwidth,
    /// Probability, 0 ≤ p < 1, that the port is not ready in a clock, whatever its bandwidth.
    pub backpressure: f64,
    /// Seed of everything random here.
    pub seed: u64,
}

impl Default for Timing {
    /// 8 clocks, in order, one request a clock, always ready.
    fn default() -> Self {
        Timing {
            latency: 8,
            jitter: 0,
            out_of_order: false,
            bandwidth: Bandwidth {
                requests: 1,
                cycles: 1,
            },
            backpressure: 0.0,
            seed: 1,
        }
    }
}

impl Timing {
    /// Greatest latency and greatest jitter.
    pub const MAX_CLOCKS: u32 = 1 << 20;

    /// Checks every range; the error names the field, its value and the range.
    pub fn check(&self) -> Result<()> {
        let Timing {
            latency,
            jitter,
            bandwidth,
            ..
        } = *self;
        let max = Self::MAX_CLOCKS;
        ensure!(
            (1..=max).contains(&latency),
            "memory latency is {latency} clocks, must be 1 to {max}"
        );
        ensure!(
            jitter <= max,
            "memory jitter is {jitter} clocks, must be 0 to {max}"
        );
        ensure!(
            !self.out_of_order || jitter > 0,
            "memory answers out of order only with a jitter of at least 1 clock, jitter is 0"
        );
        ensure!(
            bandwidth.requests >= 1 && bandwidth.requests <= bandwidth.cycles,
            "memory bandwidth is {} requests in {} clocks, must be 1 to {1} requests",
            bandwidth.requests,
            bandwidth.cycles
        );
        check_probability("memory back-pressure", self.backpressure)
    }
}

fn check_probability(what: &str, probability: f64) -> Result<()> {
    ensure!(
        (0.0..1.0).contains(&probability),
        "{what} is {probability}, must be at least 0 and less than 1"
    );
    Ok(())
}

/// Records of equal size, each a run of 32-bit words, least significant first: the contents of a memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    words: Vec<u32>,
    words_per_row: usize,
}

impl Image {
    /// `rows` records of `bits` bits (at least 1), all zero.
    pub fn zeroed(rows: u64, bits: u32) -> Image {
        let words_per_row = words_for(bits);
        Image {
            words: vec![0; rows as usize * words_per_row],
            words_per_row,
        }
    }

    /// Records of `bits` bits (at least 1), one after another in `words`; an error if they do not fill it exactly.
    pub fn from_words(words: Vec<u32>, bits: u32) -> Result<Image> {
        let words_per_row = words_for(bits);
        ensure!(
            words.len().is_multiple_of(words_per_row),
            "{} words do not make whole records of {words_per_row} words ({bits} bits)",
            words.len()
        );
        Ok(Image {
            words,
            words_per_row,
        })
    }

    /// The number of records.
    pub fn rows(&self) -> u64 {
        (self.words.len() / self.words_per_row) as u64
    }

    /// Record `address`. The ports of this module return addresses that are within the rows they were made for.
    ///
    /// # Panics
    /// If there is no such record.
    #[inline]
    pub fn row(&self, address: u64) -> &[u32] {
        let start = address as usize * self.words_per_row;
        &self.words[start..start + self.words_per_row]
    }

    /// Record `address`, to be changed.
    ///
    /// # Panics
    /// If there is no such record.
    #[inline]
    pub fn row_mut(&mut self, address: u64) -> &mut [u32] {
        let start = address as usize * self.words_per_row;
        &mut self.words[start..start + self.words_per_row]
    }

    /// All words, record after record.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// All words, record after record.
    pub fn into_words(self) -> Vec<u32> {
        self.words
    }
}

fn words_for(bits: u32) -> usize {
    bits.max(1).div_ceil(32) as usize
}

/// Says in which clocks a port takes a request: bandwidth and random back-pressure.
#[derive(Clone, Debug)]
struct Gate {
    bandwidth: Bandwidth,
    /// A request costs `bandwidth.cycles`, a clock earns `bandwidth.requests`.
    credit: u64,
    stall: RandomStall,
    ready: bool,
}

impl Gate {
    fn new(timing: &Timing, seed: u64) -> Result<Gate> {
        let mut gate = Gate {
            bandwidth: timing.bandwidth,
            credit: u64::from(timing.bandwidth.cycles),
            stall: RandomStall::new(timing.backpressure, seed)?,
            ready: false,
        };
        gate.ready = !gate.stall.stalls();
        Ok(gate)
    }

    /// One clock; true if the request offered in it is accepted.
    #[inline]
    fn step(&mut self, offered: bool) -> bool {
        let (cost, earned) = (
            u64::from(self.bandwidth.cycles),
            u64::from(self.bandwidth.requests),
        );
        let accepted = offered && self.ready;
        if accepted {
            self.credit -= cost;
        }
        // What is left of a request's cost is kept, so that the mean is exact; more is not, so that no burst is.
        self.credit = (self.credit + earned).min(cost + earned - 1);
        // Drawn even where there is no credit: the draws then do not depend on the requests.
        let stalls = self.stall.stalls();
        self.ready = self.credit >= cost && !stalls;
        accepted
    }
}

/// A request as a unit shows it: `valid` is the `Some` around it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadRequest {
    /// Index of the record wanted.
    pub address: u64,
    /// Returned with the response.
    pub tag: u32,
}

/// What a unit is to see for one edge: the record at `address`, for `tag`. It cannot be refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadResponse {
    /// The address of the request; its data are [`Image::row`] of it.
    pub address: u64,
    /// The tag of the request.
    pub tag: u32,
}

/// A read port of a model.
pub type ReadHandles = dynrt_hdl::ReadPort<PortHandle>;

/// Read ports of a model.
impl Model {
    /// The request that the model shows at a read port.
    pub fn read_request(&self, port: &ReadHandles) -> Option<ReadRequest> {
        let request = &port.request;
        (self.get(request.valid) != 0).then(|| ReadRequest {
            address: self.get(request.payload.address),
            tag: self.get(request.payload.tag) as u32,
        })
    }

    /// Shows a response at a read port, or that there is none. Behind a response tag and data become random bits: without `valid` they
    /// have no meaning, and nothing may depend on them.
    pub fn respond(&mut self, port: &ReadHandles, response: Option<ReadResponse>, data: &[u32]) {
        let port = &port.response;
        match response {
            Some(response) => {
                self.set(port.valid, 1);
                self.set(port.payload.tag, response.tag.into());
                self.set_words(port.payload.data, data);
            }
            None if self.get(port.valid) != 0 => {
                self.set(port.valid, 0);
                self.scramble([port.payload.tag, port.payload.data]);
            }
            None => {}
        }
    }
}

/// A write port of a model, its handshake and what is written.
pub type WriteHandles = Stream<Write<PortHandle>, PortHandle>;

/// Memory behind one tagged read port: requests with ready/valid, responses with valid only.
///
/// It keeps no data: a response carries its address, and the caller looks it up. At most one request is
/// accepted and one response given per clock. A response comes `latency` to `latency + jitter` clocks after
/// its request was accepted, whatever the order: every request reserves its clock when it is accepted, and
/// the last clock of its span cannot have been taken by an earlier one.
#[derive(Clone, Debug)]
pub struct ReadPort {
    name: String,
    rows: u64,
    timing: Timing,
    gate: Gate,
    rng: fastrand::Rng,
    /// Responses by the edge at which they are sampled, modulo the length, a power of two.
    slots: Vec<Option<ReadResponse>>,
    /// The edge that the next step is for.
    edge: u64,
    /// The edge of the latest response reserved.
    last_reserved: u64,
    outstanding: usize,
    accepted: u64,
}

impl ReadPort {
    /// A port, called `name` in errors, to a memory of `rows` records. An error if `timing` is out of range.
    pub fn new(name: impl Into<String>, rows: u64, timing: Timing) -> Result<ReadPort> {
        timing.check()?;
        let mut rng = fastrand::Rng::with_seed(timing.seed);
        let gate = Gate::new(&timing, rng.u64(..))?;
        let length = (timing.latency as usize + timing.jitter as usize + 1).next_power_of_two();
        Ok(ReadPort {
            name: name.into(),
            rows,
            timing,
            gate,
            rng,
            slots: vec![None; length],
            edge: 0,
            last_reserved: 0,
            outstanding: 0,
            accepted: 0,
        })
    }

    /// Whether the port takes a request at the coming edge.
    #[inline]
    pub fn ready(&self) -> bool {
        self.gate.ready
    }

    /// One rising edge. `request` is what the unit shows for it, accepted if [`ready`](Self::ready); returned
    /// is what the unit must be shown for the next edge.
    ///
    /// An error if an accepted request's address is not within the memory; the message names the port, the
    /// address and the tag.
    #[inline]
    pub fn step(&mut self, request: Option<ReadRequest>) -> Result<Option<ReadResponse>> {
        let accepted = self.gate.step(request.is_some());
        let mask = self.slots.len() as u64 - 1;
        if let (true, Some(ReadRequest { address, tag })) = (accepted, request) {
            if address >= self.rows {
                return Err(self.out_of_range(address, tag));
            }
            let earliest = self.edge + u64::from(self.timing.latency);
            let mut due = earliest;
            if self.timing.jitter > 0 {
                due += u64::from(self.rng.u32(0..=self.timing.jitter));
            }
            if self.timing.out_of_order {
                while self.slots[(due & mask) as usize].is_some() {
                    due += 1;
                }
            } else {
                due = due.max(self.last_reserved + 1);
            }
            debug_assert!(due <= earliest + u64::from(self.timing.jitter));
            self.slots[(due & mask) as usize] = Some(ReadResponse { address, tag });
            self.last_reserved = due;
            self.outstanding += 1;
            self.accepted += 1;
        }
        self.edge += 1;
        let response = self.slots[(self.edge & mask) as usize].take();
        self.outstanding -= usize::from(response.is_some());
        Ok(response)
    }

    #[cold]
    fn out_of_range(&self, address: u64, tag: u32) -> anyhow::Error {
        anyhow::anyhow!(
            "read port `{}`, clock {}: address {address:#x} (tag {tag}) is outside its memory of {} records",
            self.name,
            self.edge,
            self.rows
        )
    }

    /// Requests accepted whose response has not been returned yet.
    pub fn outstanding(&self) -> usize {
        self.outstanding
    }

    /// Requests accepted since the port was made.
    pub fn accepted(&self) -> u64 {
        self.accepted
    }
}

/// A write as a unit shows it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteRequest<'a> {
    /// Index of the record written.
    pub address: u64,
    /// The record's new contents, in words as in [`Image::row`].
    pub data: &'a [u32],
    /// One bit a lane, lane 0 lowest: which lanes are written.
    pub mask: u64,
}

/// Memory behind one write port, with ready/valid and a write mask.
#[derive(Clone, Debug)]
pub struct WritePort {
    name: String,
    /// For every lane the bits it covers, per word of the record.
    lane_masks: Vec<Vec<u32>>,
    words_per_row: usize,
    gate: Gate,
    edge: u64,
    accepted: u64,
}

impl WritePort {
    /// A port, called `name` in errors, to records made of `lane_bits`: the widths of the lanes that the write
    /// mask selects, from bit 0 upwards, 1 to 64 lanes.
    ///
    /// Of `timing`, bandwidth, back-pressure and seed count: a write has no response, and is visible to reads
    /// of its memory as soon as it is accepted.
    pub fn new(name: impl Into<String>, lane_bits: &[u32], timing: Timing) -> Result<WritePort> {
        timing.check()?;
        let name = name.into();
        if lane_bits.is_empty() || lane_bits.len() > 64 || lane_bits.contains(&0) {
            bail!(
                "write port `{name}`: lanes of {lane_bits:?} bits, must be 1 to 64 lanes of at least 1 bit each"
            );
        }
        let words_per_row = words_for(lane_bits.iter().sum());
        let mut lsb = 0;
        let lane_masks = lane_bits
            .iter()
            .map(|&bits| {
                let mut words = vec![0; words_per_row];
                for bit in lsb..lsb + bits {
                    words[bit as usize / 32] |= 1 << (bit % 32);
                }
                lsb += bits;
                words
            })
            .collect();
        let gate = Gate::new(&timing, timing.seed)?;
        Ok(WritePort {
            name,
            lane_masks,
            words_per_row,
            gate,
            edge: 0,
            accepted: 0,
        })
    }

    /// Whether the port takes a write at the coming edge.
    #[inline]
    pub fn ready(&self) -> bool {
        self.gate.ready
    }

    /// One rising edge. `request` is what the unit shows for it; if [`ready`](Self::ready), it is accepted,
    /// its lanes are written to `image`, and true is returned.
    ///
    /// An error, and no write, if an accepted write's address, data or mask do not fit the memory.
    #[inline]
    pub fn step(&mut self, request: Option<WriteRequest>, image: &mut Image) -> Result<bool> {
        let accepted = self.gate.step(request.is_some());
        if let (true, Some(write)) = (accepted, request) {
            self.write(write, image)?;
            self.accepted += 1;
        }
        self.edge += 1;
        Ok(accepted)
    }

    fn write(&self, write: WriteRequest, image: &mut Image) -> Result<()> {
        let WriteRequest {
            address,
            data,
            mask,
        } = write;
        let place = || format!("write port `{}`, clock {}", self.name, self.edge);
        ensure!(
            address < image.rows(),
            "{}: address {address:#x} is outside its memory of {} records",
            place(),
            image.rows()
        );
        ensure!(
            data.len() == self.words_per_row && image.words_per_row == self.words_per_row,
            "{}: {} words written to records of {} words through lanes of {} words",
            place(),
            data.len(),
            image.words_per_row,
            self.words_per_row
        );
        let lanes = self.lane_masks.len();
        ensure!(
            lanes == 64 || mask >> lanes == 0,
            "{}: mask {mask:#x} has more than {lanes} lanes",
            place()
        );
        let row = image.row_mut(address);
        for (_, lane) in self
            .lane_masks
            .iter()
            .enumerate()
            .filter(|(i, _)| mask >> i & 1 != 0)
        {
            for ((word, new), bits) in row.iter_mut().zip(data).zip(lane) {
                *word = *word & !bits | new & bits;
            }
        }
        Ok(())
    }

    /// Writes accepted since the port was made.
    pub fn accepted(&self) -> u64 {
        self.accepted
    }
}

/// A coin that says, clock by clock, whether to stall: a stream's consumer that is not ready.
#[derive(Clone, Debug)]
pub struct RandomStall {
    probability: f64,
    rng: fastrand::Rng,
}

impl RandomStall {
    /// Stalls with a `probability`, 0 ≤ p < 1, in each clock.
    pub fn new(probability: f64, seed: u64) -> Result<RandomStall> {
        check_probability("the probability of a stall", probability)?;
        Ok(RandomStall {
            probability,
            rng: fastrand::Rng::with_seed(seed),
        })
    }

    /// Whether to stall in the next clock. Call it once per clock.
    #[inline]
    pub fn stalls(&mut self) -> bool {
        self.probability > 0.0 && self.rng.f64() < self.probability
    }
}

/// The producer's side of a ready/valid stream: pauses at random, but once an item is offered it stays so
/// until it is accepted, as ready/valid asks.
#[derive(Clone, Debug)]
pub struct StreamSource {
    stall: RandomStall,
    open: bool,
}

impl StreamSource {
    /// Pauses with a `probability`, 0 ≤ p < 1, in each clock in which no item is waiting.
    pub fn new(probability: f64, seed: u64) -> Result<StreamSource> {
        let mut stall = RandomStall::new(probability, seed)?;
        let open = !stall.stalls();
        Ok(StreamSource { stall, open })
    }

    /// Whether to show an item (`valid`) for the coming edge, if there is one.
    #[inline]
    pub fn open(&self) -> bool {
        self.open
    }

    /// One rising edge, at which an item was or was not `offered`, and `ready` says whether the unit took it.
    /// True if an item was transferred.
    #[inline]
    pub fn step(&mut self, offered: bool, ready: bool) -> bool {
        let offered = offered && self.open;
        if !offered || ready {
            self.open = !self.stall.stalls();
        }
        offered && ready
    }
}
