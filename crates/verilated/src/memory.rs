//! The environment of a module under test: memories behind tagged read ports and write ports, and ready/valid streams
//! that stall at random.
//!
//! # Cycles
//!
//! Rising edge *k* samples the inputs of the module; after it the module shows its outputs for edge *k* + 1. A model of
//! this library is stepped once per rising edge, just before it, with the outputs that the module shows for that edge:
//!
//! ```text
//! loop {
//!     module.set(ready, port.ready());              // for this edge
//!     module.eval();                                // only if a request depends combinationally on an input
//!     let request = if module.get(valid) != 0 { Some(ReadRequest { address, tag }) } else { None };
//!     let response = port.step(request)?;           // accepts the request if and only if ready() was true
//!     module.clock();                               // the edge
//!     module.set(response_valid, response.is_some()); // for the next edge, with its tag and image.row(address)
//! }
//! ```
//!
//! With a latency of L cycles, the response to a request accepted at edge *k* is sampled by the module at edge *k* + L;
//! with L = 1 it is returned by the step that accepts the request.
//!
//! All randomness comes from the given seed through [`fastrand`]: the same seed and the same requests give the same
//! run.

use super::model::{Model, PortHandle};
use anyhow::{Result, bail, ensure};
use dynrt_hdl::{Stream, Write};

/// A limit of `requests` accepted requests in `cycles` cycles.
///
/// In any interval of *n* cycles at most ⌈*n* · requests ÷ cycles⌉ requests are accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Bandwidth {
    /// The number of requests accepted per `cycles` cycles, at least 1 and at most `cycles`.
    pub requests: u32,
    /// The number of cycles, at least 1.
    pub cycles: u32,
}

/// The timing of a memory port.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Timing {
    /// The number of cycles from the edge that accepts a request to the edge that samples its
    /// response, 1 to [`Timing::MAX_CLOCKS`].
    pub latency: u32,
    /// The greatest additional delay of a response in cycles, 0 to [`Timing::MAX_CLOCKS`]; each
    /// response has a random one.
    pub jitter: u32,
    /// Whether responses may come in another order than their requests. This requires a `jitter` of
    /// at least 1.
    pub out_of_order: bool,
    /// The limit of accepted requests; at most one request is accepted per cycle.
    pub bandwidth: Bandwidth,
    /// The probability *p*, 0 ≤ *p* < 1, that the port is not ready in a cycle, in addition to the
    /// limit of the bandwidth.
    pub backpressure: f64,
    /// The seed of all random decisions of the port.
    pub seed: u64,
}

impl Default for Timing {
    /// Returns a latency of 8 cycles, in order, with one request per cycle and no back-pressure.
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
    /// The greatest latency and the greatest jitter in cycles.
    pub const MAX_CLOCKS: u32 = 1 << 20;

    /// Checks all fields.
    ///
    /// # Errors
    /// A field is out of range; the message names the field, its value and the range.
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

/// The contents of a memory: records of equal size, each stored as 32-bit words, the least
/// significant first.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Image {
    words: Vec<u32>,
    words_per_row: usize,
}

impl Image {
    /// Returns `rows` records of `bits` bits (at least 1), all zero.
    pub fn zeroed(rows: u64, bits: u32) -> Image {
        let words_per_row = words_for(bits);
        Image {
            words: vec![0; rows as usize * words_per_row],
            words_per_row,
        }
    }

    /// Returns records of `bits` bits (at least 1) with the contents `words`, one record after
    /// another.
    ///
    /// # Errors
    /// The number of words is not a multiple of the words of a record.
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

    /// Returns the number of records.
    pub fn rows(&self) -> u64 {
        (self.words.len() / self.words_per_row) as u64
    }

    /// Returns the record `address`. The ports of this module return only addresses within the
    /// number of records that they were created with.
    ///
    /// # Panics
    /// If there is no such record.
    #[inline]
    pub fn row(&self, address: u64) -> &[u32] {
        let start = address as usize * self.words_per_row;
        &self.words[start..start + self.words_per_row]
    }

    /// Returns the record `address` for modification.
    ///
    /// # Panics
    /// If there is no such record.
    #[inline]
    pub fn row_mut(&mut self, address: u64) -> &mut [u32] {
        let start = address as usize * self.words_per_row;
        &mut self.words[start..start + self.words_per_row]
    }

    /// Returns all words, record after record.
    pub fn words(&self) -> &[u32] {
        &self.words
    }

    /// Returns all words, record after record.
    pub fn into_words(self) -> Vec<u32> {
        self.words
    }
}

fn words_for(bits: u32) -> usize {
    bits.max(1).div_ceil(32) as usize
}

/// Decides in which cycles a port accepts a request, by bandwidth and random back-pressure.
#[derive(Clone, Debug)]
struct Gate {
    bandwidth: Bandwidth,
    /// A request costs `bandwidth.cycles`; each cycle earns `bandwidth.requests`.
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

    /// Advances by one cycle; returns whether the offered request is accepted.
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
        // Credit above the cost of a request is kept, which makes the mean exact. The limit prevents bursts.
        self.credit = (self.credit + earned).min(cost + earned - 1);
        // Draw a random number even without credit, so the sequence does not depend on the requests.
        let stalls = self.stall.stalls();
        self.ready = self.credit >= cost && !stalls;
        accepted
    }
}

/// A request that a module issues at a read port.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadRequest {
    /// The index of the requested record.
    pub address: u64,
    /// The tag that is returned with the response.
    pub tag: u32,
}

/// A response that a module receives in one cycle and cannot refuse: the record at `address`, for
/// `tag`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReadResponse {
    /// The address of the request; the data is [`Image::row`] of it.
    pub address: u64,
    /// The tag of the request.
    pub tag: u32,
}

/// The signals of a read port of a model.
pub type ReadHandles = dynrt_hdl::ReadPort<PortHandle>;

/// Access to read ports, for [`ReadPort`].
impl Model {
    /// Returns the request that the model shows at a read port, if its valid bit is 1.
    pub fn read_request(&self, port: &ReadHandles) -> Option<ReadRequest> {
        let request = &port.request;
        (self.get(request.valid) != 0).then(|| ReadRequest {
            address: self.get(request.payload.address),
            tag: self.get(request.payload.tag) as u32,
        })
    }

    /// Drives a response to a read port: the valid bit, and the tag and the data if there is a
    /// response. After a response the tag and the data are random bits: they have no meaning
    /// without the valid bit, and no module may depend on them.
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

/// The signals of a write port of a model: the handshake, the address and the data.
pub type WriteHandles = Stream<Write<PortHandle>, PortHandle>;

/// A model of a memory behind one tagged read port: requests with a ready/valid handshake,
/// responses with a valid bit only.
///
/// The port stores no data: a response carries the address, with which the caller looks up the
/// record. At most one request is accepted and at most one response is returned per cycle. A
/// response comes `latency` to `latency + jitter` cycles after its request was accepted.
#[derive(Clone, Debug)]
pub struct ReadPort {
    name: String,
    rows: u64,
    timing: Timing,
    gate: Gate,
    rng: fastrand::Rng,
    /// Responses by the edge that samples them, modulo the length, which is a power of two.
    slots: Vec<Option<ReadResponse>>,
    /// The edge of the next step.
    edge: u64,
    /// The edge of the latest response reserved.
    last_reserved: u64,
    outstanding: usize,
    accepted: u64,
}

impl ReadPort {
    /// Creates a port to a memory of `rows` records. The name is used in error messages.
    ///
    /// # Errors
    /// `timing` is out of range: see [`Timing::check`].
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

    /// Returns whether the port accepts a request at the coming edge.
    #[inline]
    pub fn ready(&self) -> bool {
        self.gate.ready
    }

    /// Advances by one rising edge. `request` is the request that the module shows for this edge;
    /// it is accepted if [`ready`](Self::ready) is true. The result is the response that the module
    /// must be shown for the next edge.
    ///
    /// # Errors
    /// The address of an accepted request is outside the memory; the message names the port, the
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

    /// Returns the number of accepted requests whose response has not been returned yet.
    pub fn outstanding(&self) -> usize {
        self.outstanding
    }

    /// Returns the number of requests accepted so far.
    pub fn accepted(&self) -> u64 {
        self.accepted
    }
}

/// A write that a module issues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct WriteRequest<'a> {
    /// The index of the record to write.
    pub address: u64,
    /// The new contents of the record, in words as in [`Image::row`].
    pub data: &'a [u32],
    /// The lanes to write, one bit per lane, lane 0 in bit 0.
    pub mask: u64,
}

/// A model of a memory behind one write port, with a ready/valid handshake and a write mask.
#[derive(Clone, Debug)]
pub struct WritePort {
    name: String,
    /// For every lane, the bits that it covers in each word of the record.
    lane_masks: Vec<Vec<u32>>,
    words_per_row: usize,
    gate: Gate,
    edge: u64,
    accepted: u64,
}

impl WritePort {
    /// Creates a port to records that consist of lanes. `lane_bits` holds the widths of the lanes
    /// that the write mask selects, from bit 0 upwards: 1 to 64 lanes of at least 1 bit. The name
    /// is used in error messages.
    ///
    /// Only `bandwidth`, `backpressure` and `seed` of `timing` are used: a write has no response,
    /// and is visible to reads as soon as it is accepted.
    ///
    /// # Errors
    /// `timing` or the lanes are out of range.
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

    /// Returns whether the port accepts a write at the coming edge.
    #[inline]
    pub fn ready(&self) -> bool {
        self.gate.ready
    }

    /// Advances by one rising edge. `request` is the write that the module shows for this edge. If
    /// [`ready`](Self::ready) is true, it is accepted: its lanes are written to `image`, and the
    /// result is true.
    ///
    /// # Errors
    /// The address, the data or the mask of an accepted write does not fit the memory; nothing is
    /// written.
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

    /// Returns the number of writes accepted so far.
    pub fn accepted(&self) -> u64 {
        self.accepted
    }
}

/// A random decision, cycle by cycle, whether to stall: for example the receiver of a stream that
/// is not always ready.
#[derive(Clone, Debug)]
pub struct RandomStall {
    probability: f64,
    rng: fastrand::Rng,
}

impl RandomStall {
    /// Creates a decision with a probability *p* of a stall in each cycle, 0 ≤ *p* < 1.
    ///
    /// # Errors
    /// The probability is out of range.
    pub fn new(probability: f64, seed: u64) -> Result<RandomStall> {
        check_probability("the probability of a stall", probability)?;
        Ok(RandomStall {
            probability,
            rng: fastrand::Rng::with_seed(seed),
        })
    }

    /// Returns whether to stall in the next cycle. Call it once per cycle.
    #[inline]
    pub fn stalls(&mut self) -> bool {
        self.probability > 0.0 && self.rng.f64() < self.probability
    }
}

/// The sender of a ready/valid stream. It pauses at random; an item that has been offered remains
/// so until it is accepted, as the handshake requires.
#[derive(Clone, Debug)]
pub struct StreamSource {
    stall: RandomStall,
    open: bool,
}

impl StreamSource {
    /// Creates a sender that pauses with a probability *p*, 0 ≤ *p* < 1, in each cycle in which no
    /// item is waiting.
    ///
    /// # Errors
    /// The probability is out of range.
    pub fn new(probability: f64, seed: u64) -> Result<StreamSource> {
        let mut stall = RandomStall::new(probability, seed)?;
        let open = !stall.stalls();
        Ok(StreamSource { stall, open })
    }

    /// Returns whether to offer an item (`valid`) for the coming edge, if there is one.
    #[inline]
    pub fn open(&self) -> bool {
        self.open
    }

    /// Advances by one rising edge. `offered` is whether there was an item to offer, `ready`
    /// whether the receiver was ready. The result is whether an item was transferred.
    #[inline]
    pub fn step(&mut self, offered: bool, ready: bool) -> bool {
        let offered = offered && self.open;
        if !offered || ready {
            self.open = !self.stall.stalls();
        }
        offered && ready
    }
}
