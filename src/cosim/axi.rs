//! An AXI4 slave for simulations: a memory of bytes behind the five channels of a bus.
//!
//! [`Slave`] obeys the protocol: beats and responses of one identifier are in order, and an offer stays until it is accepted. What is free
//! under the protocol is decided by a [`Pace`], cycle by cycle: which offers are accepted, which burst has the next beat, which has its
//! response. [`RandomPace`] decides at random; [`Ideal`] has a fixed latency; a model of a DRAM is one more.
//!
//! In each cycle the caller calls [`Slave::show`], which sets the inputs of the model for the coming edge, then [`Model::eval`], because a
//! master may use a ready in the same cycle, then [`Slave::step`], which says what the edge transfers, then [`Model::clock`].

use super::model::{Model, PortHandle};
use crate::hw::memory::axi::{Bus, MasterInputs, MasterOutputs};
use anyhow::{Result, ensure};
use std::collections::VecDeque;

/// The ports of a master in a model.
#[derive(Clone, Copy, Debug)]
pub struct Handles {
    pub out: MasterOutputs<PortHandle>,
    pub into: MasterInputs<PortHandle>,
}

/// The greatest width of a beat, in words of 32 bits.
pub const BEAT_WORDS: usize = 8;

/// The data of a beat, its least significant word first.
pub type Data = [u32; BEAT_WORDS];

/// Bytes from an address on.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Bytes {
    pub base: u32,
    pub bytes: Vec<u8>,
}

impl Bytes {
    /// The index of `count` bytes at an address.
    fn index(&self, address: u32, count: u32) -> Result<usize> {
        let offset = address.wrapping_sub(self.base) as usize;
        ensure!(
            offset + count as usize <= self.bytes.len(),
            "address {address:#x} is outside of the memory"
        );
        Ok(offset)
    }

    /// The beat of `count` bytes at an address that is a multiple of it.
    ///
    /// # Errors
    /// The address is outside of the memory.
    pub fn beat(&self, address: u32, count: u32) -> Result<Data> {
        let index = self.index(address, count)?;
        let mut data = Data::default();
        for (i, byte) in self.bytes[index..][..count as usize].iter().enumerate() {
            data[i / 4] |= u32::from(*byte) << (8 * (i % 4));
        }
        Ok(data)
    }

    /// Writes the bytes of a beat whose strobe is set.
    ///
    /// # Errors
    /// The address is outside of the memory.
    pub fn write(&mut self, address: u32, count: u32, data: &Data, strobes: u32) -> Result<()> {
        let index = self.index(address, count)?;
        for i in 0..count as usize {
            if strobes >> i & 1 != 0 {
                self.bytes[index + i] = (data[i / 4] >> (8 * (i % 4))) as u8;
            }
        }
        Ok(())
    }
}

/// A burst whose address was accepted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Accepted {
    pub id: u32,
    pub address: u32,
    /// Beats, from 1.
    pub beats: u32,
    /// Beats that have been transferred.
    pub done: u32,
    /// The cycle in which its address was accepted; of a complete write burst, in which it was completed.
    pub cycle: u64,
}

/// What a pace decides by.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The number of the cycle.
    pub now: u64,
    /// Which of the master's channels offers something.
    pub read_offered: bool,
    pub write_offered: bool,
    pub datum_offered: bool,
    /// Read bursts that are not complete, in the order of their addresses.
    pub reads: &'a [Accepted],
    /// Write bursts that wait for data.
    pub writes: usize,
    /// Data that wait for an address.
    pub data: usize,
    /// Whether the datum that was accepted last ended a burst.
    pub data_ended: bool,
    /// Write bursts that are complete and have no response, in the order of their addresses.
    pub complete: &'a [Accepted],
}

/// What a pace decides.
#[derive(Clone, Copy, Debug, Default)]
pub struct Decision {
    pub accept_read: bool,
    pub accept_write: bool,
    pub accept_datum: bool,
    /// The burst of the next beat, among [`View::reads`], and whether the beat reports an error. It must be the first of its identifier.
    pub beat: Option<(usize, bool)>,
    /// The burst of the next response, among [`View::complete`], and whether it reports an error. It must be the first of its identifier.
    pub response: Option<(usize, bool)>,
}

/// Decides what is free under the protocol.
pub trait Pace {
    fn decide(&mut self, view: &View<'_>) -> Decision;
}

/// A fault of a slave, which a monitor must find.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// `RLAST` comes one beat early; one beat late.
    EarlyLast,
    LateLast,
    /// A beat has an identifier with no outstanding burst.
    StrangeBeat,
    /// A response comes with no complete burst.
    StrangeResponse,
    /// No address is accepted; no beat, no response comes.
    Deaf,
    Silent,
    /// A beat or a response that is not accepted is another one in the next cycle.
    Restless,
}

/// What an edge transfers.
#[derive(Clone, Debug, Default)]
pub struct Edge {
    pub read: Option<Accepted>,
    pub write: Option<Accepted>,
    /// A datum, its strobes, and whether it is the last.
    pub datum: Option<(Data, u32, bool)>,
    pub beat: Option<Transferred>,
    /// The identifier of a response, and whether it reports an error.
    pub response: Option<(u32, bool)>,
    /// Which offered address or datum is not accepted.
    pub read_waits: bool,
    pub write_waits: bool,
    pub datum_waits: bool,
}

impl Edge {
    /// Whether anything is transferred.
    pub fn any(&self) -> bool {
        self.read.is_some()
            || self.write.is_some()
            || self.datum.is_some()
            || self.beat.is_some()
            || self.response.is_some()
    }
}

/// A beat of read data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Transferred {
    pub id: u32,
    pub data: Data,
    pub last: bool,
    pub error: bool,
    /// Whether an older burst is not complete; whether the burst of the beat before is not.
    pub overtakes: bool,
    pub interleaved: bool,
}

/// Codes of a response.
const OKAY: u64 = 0;
const SLVERR: u64 = 2;
const DECERR: u64 = 3;

/// The slave.
pub struct Slave {
    handles: Handles,
    bytes: u32,
    now: u64,
    reads: Vec<Accepted>,
    writes: VecDeque<Accepted>,
    data: VecDeque<(Data, u32, bool)>,
    data_ended: bool,
    complete: Vec<Accepted>,
    /// What is shown: the beat with the place of its burst, and the response with the place of its burst.
    beat: Option<(Transferred, usize)>,
    response: Option<(u32, bool, usize)>,
    /// The burst of the beat before, by identifier and address, if it is not complete.
    before: Option<(u32, u32)>,
    pub fault: Option<Fault>,
}

impl Slave {
    pub fn new(bus: &Bus, handles: Handles) -> Slave {
        Slave {
            handles,
            bytes: bus.bytes(),
            now: 0,
            reads: vec![],
            writes: VecDeque::new(),
            data: VecDeque::new(),
            data_ended: true,
            complete: vec![],
            beat: None,
            response: None,
            before: None,
            fault: None,
        }
    }

    /// Whether no burst is in it.
    pub fn is_empty(&self) -> bool {
        self.reads.is_empty()
            && self.writes.is_empty()
            && self.data.is_empty()
            && self.complete.is_empty()
            && self.beat.is_none()
            && self.response.is_none()
    }

    /// Whether no write burst is in it.
    pub fn has_written(&self) -> bool {
        self.writes.is_empty()
            && self.data.is_empty()
            && self.complete.is_empty()
            && self.response.is_none()
    }

    /// Sets the inputs of the model for the coming edge.
    ///
    /// # Errors
    /// An address is outside of the memory.
    pub fn show(
        &mut self,
        model: &mut Model,
        pace: &mut dyn Pace,
        memory: &Bytes,
        noise: &mut fastrand::Rng,
    ) -> Result<()> {
        let Handles { out, into } = self.handles;
        let view = View {
            now: self.now,
            read_offered: model.get(out.arvalid) != 0,
            write_offered: model.get(out.awvalid) != 0,
            datum_offered: model.get(out.wvalid) != 0,
            reads: &self.reads,
            writes: self.writes.len(),
            data: self.data.len(),
            data_ended: self.data_ended,
            complete: &self.complete,
        };
        let mut decision = pace.decide(&view);
        match self.fault {
            Some(Fault::Deaf) => (decision.accept_read, decision.accept_write) = (false, false),
            Some(Fault::Silent) => (decision.beat, decision.response) = (None, None),
            _ => {}
        }
        model.set(into.arready, decision.accept_read.into());
        model.set(into.awready, decision.accept_write.into());
        model.set(into.wready, decision.accept_datum.into());
        if self.beat.is_none() {
            self.choose_beat(decision.beat, memory)?;
            let payload = into.r;
            model.set(into.rvalid, self.beat.is_some().into());
            match &self.beat {
                Some((beat, _)) => {
                    model.set(payload.rid, beat.id.into());
                    model.set_words(payload.rdata, &beat.data);
                    model.set(payload.rresp, code(beat.error, beat.id));
                    model.set(payload.rlast, beat.last.into());
                }
                None => {
                    model.garble(
                        [payload.rid, payload.rdata, payload.rresp, payload.rlast],
                        noise,
                    );
                }
            }
        }
        if self.response.is_none() {
            self.response = decision.response.map(|(place, error)| {
                let id = self.complete[place].id;
                assert!(first_of_id(&self.complete, place));
                (id, error, place)
            });
            if self.fault == Some(Fault::StrangeResponse) && self.response.is_none() {
                self.response = Some((0, false, usize::MAX));
            }
            model.set(into.bvalid, self.response.is_some().into());
            match self.response {
                Some((id, error, _)) => {
                    model.set(into.b.bid, id.into());
                    model.set(into.b.bresp, code(error, self.now as u32));
                }
                None => model.garble([into.b.bid, into.b.bresp], noise),
            }
        }
        Ok(())
    }

    fn choose_beat(&mut self, choice: Option<(usize, bool)>, memory: &Bytes) -> Result<()> {
        let Some((place, error)) = choice else {
            return Ok(());
        };
        assert!(first_of_id(&self.reads, place));
        let burst = self.reads[place];
        let address = burst.address.wrapping_add(burst.done * self.bytes);
        let mut beat = Transferred {
            id: burst.id,
            data: memory.beat(address, self.bytes)?,
            last: burst.done + 1 == burst.beats,
            error,
            overtakes: place > 0,
            interleaved: (self.before).is_some_and(|before| before != (burst.id, burst.address)),
        };
        match self.fault {
            Some(Fault::EarlyLast) => beat.last = burst.done + 2 >= burst.beats,
            Some(Fault::LateLast) => beat.last = false,
            Some(Fault::StrangeBeat) => beat.id ^= 1,
            _ => {}
        }
        self.beat = Some((beat, place));
        Ok(())
    }

    /// What the coming edge transfers, which is then done.
    ///
    /// # Errors
    /// An address is outside of the memory.
    pub fn step(&mut self, model: &Model, memory: &mut Bytes) -> Result<Edge> {
        let Handles { out, into } = self.handles;
        let mut edge = Edge::default();
        let on = |port| model.get(port) != 0;
        if self.fault == Some(Fault::Restless) {
            self.beat = self.beat.take_if(|_| on(out.rready));
            self.response = self.response.take_if(|_| on(out.bready));
        }
        if on(out.rready)
            && let Some((beat, place)) = self.beat.take()
        {
            edge.beat = Some(beat);
            let burst = &mut self.reads[place];
            burst.done += 1;
            self.before = Some((burst.id, burst.address));
            if burst.done == burst.beats {
                self.reads.remove(place);
                self.before = None;
            }
        }
        if on(out.bready)
            && let Some((id, error, place)) = self.response.take()
        {
            edge.response = Some((id, error));
            if place < self.complete.len() {
                self.complete.remove(place);
            }
        }
        let accepted = |id, address, beats| Accepted {
            id: model.get(id) as u32,
            address: model.get(address) as u32,
            beats: model.get(beats) as u32 + 1,
            done: 0,
            cycle: self.now,
        };
        if on(out.arvalid) {
            match on(into.arready) {
                true => {
                    let burst = accepted(out.ar.arid, out.ar.araddr, out.ar.arlen);
                    self.reads.push(burst);
                    edge.read = Some(burst);
                }
                false => edge.read_waits = true,
            }
        }
        if on(out.awvalid) {
            match on(into.awready) {
                true => {
                    let burst = accepted(out.aw.awid, out.aw.awaddr, out.aw.awlen);
                    self.writes.push_back(burst);
                    edge.write = Some(burst);
                }
                false => edge.write_waits = true,
            }
        }
        if on(out.wvalid) {
            match on(into.wready) {
                true => {
                    let mut data = Data::default();
                    model.get_words(out.w.wdata, &mut data);
                    let strobes = model.get(out.w.wstrb) as u32;
                    let datum = (data, strobes, on(out.w.wlast));
                    self.data.push_back(datum);
                    self.data_ended = datum.2;
                    edge.datum = Some(datum);
                }
                false => edge.datum_waits = true,
            }
        }
        self.store(memory)?;
        self.now += 1;
        Ok(edge)
    }

    /// Writes the data that have their addresses.
    fn store(&mut self, memory: &mut Bytes) -> Result<()> {
        while let Some(burst) = self.writes.front_mut()
            && let Some((data, strobes, _)) = self.data.pop_front()
        {
            let address = burst.address.wrapping_add(burst.done * self.bytes);
            memory.write(address, self.bytes, &data, strobes)?;
            burst.done += 1;
            if burst.done == burst.beats {
                let cycle = self.now;
                self.complete.push(Accepted { cycle, ..*burst });
                self.writes.pop_front();
            }
        }
        Ok(())
    }
}

/// The code of a response; errors are of both kinds.
fn code(error: bool, number: u32) -> u64 {
    match (error, number % 2) {
        (false, _) => OKAY,
        (true, 0) => SLVERR,
        (true, _) => DECERR,
    }
}

/// Whether a burst is the first of its identifier.
fn first_of_id(bursts: &[Accepted], place: usize) -> bool {
    let id = bursts[place].id;
    bursts[..place].iter().all(|burst| burst.id != id)
}

/// The places of the bursts that are the first of their identifiers and at least `latency` cycles old.
fn eligible(bursts: &[Accepted], now: u64, latency: u64) -> impl Iterator<Item = usize> + '_ {
    (0..bursts.len())
        .filter(move |&place| bursts[place].cycle + latency <= now && first_of_id(bursts, place))
}

/// How a slave treats write data and addresses with respect to each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Order {
    /// Independently.
    Free,
    /// An address is accepted after all data of its burst; data only after their address.
    DataFirst,
    AddressFirst,
}

/// Decides at random, with probabilities that are drawn anew with [`RandomPace::draw`].
pub struct RandomPace {
    rng: fastrand::Rng,
    /// Probabilities of a pause in a cycle: read and write addresses, data, beats, responses.
    pauses: [f64; 5],
    /// An address is accepted only if it was offered before the ready; otherwise ready does not depend on valid.
    after_valid: bool,
    order: Order,
    latency: u64,
    /// Whether bursts of different identifiers overtake each other, and their beats alternate.
    overtake: bool,
    interleave: bool,
    /// The burst whose beats come one after another.
    current: Option<(u32, u32)>,
    /// Probability that a beat or a response reports an error.
    errors: f64,
}

impl RandomPace {
    pub fn new(seed: u64) -> RandomPace {
        let mut pace = RandomPace {
            rng: fastrand::Rng::with_seed(seed),
            pauses: [0.0; 5],
            after_valid: false,
            order: Order::Free,
            latency: 1,
            overtake: false,
            interleave: false,
            current: None,
            errors: 0.0,
        };
        pace.draw();
        pace
    }

    /// Draws the habits of the slave. No burst may be in it.
    pub fn draw(&mut self) {
        let rng = &mut self.rng;
        let all = [0.0, 0.1, 0.5, 0.9][rng.usize(..4)];
        for pauses in &mut self.pauses {
            *pauses = match rng.u8(..3) {
                0 => 0.0,
                1 => all,
                _ => [0.0, 0.3, 0.8][rng.usize(..3)],
            };
        }
        self.after_valid = rng.bool();
        self.order = [Order::Free, Order::DataFirst, Order::AddressFirst][rng.usize(..3)];
        self.latency = [1, 1, 10, 60][rng.usize(..4)];
        self.overtake = rng.bool();
        self.interleave = rng.bool();
        self.current = None;
        self.errors = [0.0, 0.0, 0.1][rng.usize(..3)];
    }

    /// One of the bursts that may come next.
    fn choose(&mut self, bursts: &[Accepted], now: u64) -> Option<usize> {
        let mut all = eligible(bursts, now, self.latency);
        match self.overtake {
            false => all.next(),
            true => {
                let all: Vec<usize> = all.collect();
                self.rng.choice(all)
            }
        }
    }
}

impl Pace for RandomPace {
    fn decide(&mut self, view: &View<'_>) -> Decision {
        let [read, write, datum, beat, response] = self
            .pauses
            .map(|pauses| pauses == 0.0 || self.rng.f64() >= pauses);
        let order = match self.order {
            Order::Free => (true, true),
            Order::DataFirst => {
                let complete = view.data > 0 && view.data_ended;
                (complete, !complete)
            }
            Order::AddressFirst => (true, view.writes > 0),
        };
        let mut decision = Decision {
            accept_read: read && (view.read_offered || !self.after_valid),
            accept_write: write && order.0 && (view.write_offered || !self.after_valid),
            accept_datum: datum && order.1 && (view.datum_offered || !self.after_valid),
            ..Decision::default()
        };
        if beat {
            let same = self.current.filter(|_| !self.interleave);
            let same = same.and_then(|(id, address)| {
                (view.reads.iter())
                    .position(|burst| (burst.id, burst.address) == (id, address) && burst.done > 0)
            });
            let place = same.or_else(|| self.choose(view.reads, view.now));
            self.current = place.map(|place| (view.reads[place].id, view.reads[place].address));
            decision.beat = place.map(|place| (place, self.rng.f64() < self.errors));
        }
        if response {
            let place = self.choose(view.complete, view.now);
            decision.response = place.map(|place| (place, self.rng.f64() < self.errors));
        }
        decision
    }
}

/// Accepts everything, and serves the oldest burst after a latency.
pub struct Ideal {
    /// Cycles from an accepted address to its first beat, or from the last datum to the response, from 1.
    pub latency: u64,
}

impl Pace for Ideal {
    fn decide(&mut self, view: &View<'_>) -> Decision {
        let oldest = |bursts| eligible(bursts, view.now, self.latency).next();
        Decision {
            accept_read: true,
            accept_write: true,
            accept_datum: true,
            beat: oldest(view.reads).map(|place| (place, false)),
            response: oldest(view.complete).map(|place| (place, false)),
        }
    }
}
