//! Timing models of memories behind an AXI4 bus: when the data of a burst is on the device's data bus. They hold no data.
//!
//! A burst goes to one row of one bank at a time. The model keeps the row of a bank open until another row of the bank is needed, and
//! issues the commands of a bank as early as its timing allows, also while other data is on the data bus. Of the pending bursts it
//! serves the one whose data can start first; among equals the oldest.

use super::axi::{Accepted, Decision, Pace, View};
use crate::config::{Config, MemoryModel};
use std::collections::{HashMap, VecDeque};

/// Picoseconds.
type Time = u64;

/// A device: one row of the table in `docs/chip.md`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Device {
    /// The banks and the bytes of a row.
    pub banks: u64,
    pub row_bytes: u64,
    /// Bytes of a column access, and the time that they are on the data bus.
    pub column_bytes: u64,
    pub column: Time,
    /// From a column command to its first datum.
    pub cas: Time,
    /// From an activate command to a column command.
    pub rcd: Time,
    /// From a precharge command to an activate command.
    pub rp: Time,
    /// From an activate command to a precharge command; to the next activate command of the bank.
    pub ras: Time,
    pub rc: Time,
    /// A refresh, and the time between refreshes.
    pub rfc: Time,
    pub refi: Time,
    /// From the last datum written to a precharge command.
    pub wr: Time,
    /// Cycles of the controller before the first command, and after the data.
    pub controller: u64,
}

const NS: Time = 1000;

/// DDR-200 SDRAM, 64 bits wide: four banks of 256 Mbit devices of eight bits (JEDEC JESD79: -75 and slower grades have CL 2.5, tRCD and
/// tRP 20 ns, tRAS 45 ns, tRC 65 ns, tRFC 75 ns, tWR 15 ns, tREFI 7.8 µs). A burst of four takes two clocks of 10 ns.
pub const DDR_VIRTEX4: Device = Device {
    banks: 4,
    row_bytes: 8192,
    column_bytes: 32,
    column: 20 * NS,
    cas: 25 * NS,
    rcd: 20 * NS,
    rp: 20 * NS,
    ras: 45 * NS,
    rc: 65 * NS,
    rfc: 75 * NS,
    refi: 7800 * NS,
    wr: 15 * NS,
    controller: 8,
};

/// The SDR SDRAM of a ULX3S board at a clock of `mhz`: 16 bits wide, CL 3, bursts of eight.
fn sdr_ulx3s(mhz: u32) -> Device {
    let clocks = |count: u64| count * period(mhz);
    Device {
        banks: 4,
        row_bytes: 1024,
        column_bytes: 16,
        column: clocks(8),
        cas: clocks(3),
        rcd: clocks(2),
        rp: clocks(2),
        ras: clocks(5),
        rc: clocks(7),
        rfc: clocks(7),
        refi: 7800 * NS,
        wr: clocks(2),
        controller: 4,
    }
}

/// The period of a clock.
fn period(mhz: u32) -> Time {
    1_000_000 / u64::from(mhz)
}

/// A burst of the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// A number of the caller's.
    pub id: u64,
    pub address: u64,
    /// At least 1.
    pub bytes: u64,
    pub write: bool,
}

/// When a burst is served, in cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Served {
    pub access: Access,
    /// The cycle in which its first bytes have arrived at the bus, or have been taken from it.
    pub first: u64,
    /// The cycle in which its last bytes have.
    pub last: u64,
}

/// Bursts among which the next one is chosen.
const WINDOW: usize = 8;

/// A memory's timing.
#[derive(Clone, Debug)]
pub struct Dram {
    kind: Kind,
    /// The period of the chip's clock.
    period: Time,
    pending: VecDeque<(Time, Access)>,
    /// When the data bus is free.
    bus_free: Time,
    banks: Vec<Bank>,
    next_refresh: Time,
    /// Bytes on the data bus, and the time that they took.
    bytes: u64,
}

#[derive(Clone, Debug)]
enum Kind {
    /// A latency in cycles, and one beat per cycle.
    Ideal {
        latency: u64,
        beat_bytes: u64,
    },
    Device(Device),
}

#[derive(Clone, Copy, Debug, Default)]
struct Bank {
    row: Option<u64>,
    activated: Time,
    /// When a precharge may follow the last write; when column commands may.
    written: Time,
    ready: Time,
}

impl Dram {
    /// The memory of a configuration.
    pub fn new(config: &Config) -> Dram {
        let kind = match config.memory_model {
            MemoryModel::Ideal => Kind::Ideal {
                latency: config.memory_latency.into(),
                beat_bytes: u64::from(config.bus_data_bits / 8),
            },
            MemoryModel::DdrVirtex4 => Kind::Device(DDR_VIRTEX4),
            MemoryModel::SdrUlx3s => Kind::Device(sdr_ulx3s(config.clock_mhz)),
        };
        Dram::of(kind, config.clock_mhz)
    }

    fn of(kind: Kind, mhz: u32) -> Dram {
        let banks = match &kind {
            Kind::Ideal { .. } => 0,
            Kind::Device(device) => device.banks as usize,
        };
        let next_refresh = match &kind {
            Kind::Ideal { .. } => Time::MAX,
            Kind::Device(device) => device.refi,
        };
        Dram {
            kind,
            period: period(mhz),
            pending: VecDeque::new(),
            bus_free: 0,
            banks: vec![Bank::default(); banks],
            next_refresh,
            bytes: 0,
        }
    }

    /// The greatest number of bytes per cycle that the data bus can carry.
    pub fn peak_bytes_per_cycle(&self) -> f64 {
        match &self.kind {
            Kind::Ideal { beat_bytes, .. } => *beat_bytes as f64,
            Kind::Device(device) => {
                device.column_bytes as f64 * self.period as f64 / device.column as f64
            }
        }
    }

    /// Bytes that the data bus has carried, whole column accesses included.
    pub fn bytes(&self) -> u64 {
        self.bytes
    }

    /// Adds a burst that arrives in a cycle. Cycles never go back.
    pub fn push(&mut self, cycle: u64, access: Access) {
        let controller = match &self.kind {
            Kind::Ideal { .. } => 0,
            Kind::Device(device) => device.controller,
        };
        let ready = (cycle + controller) * self.period;
        self.pending.push_back((ready, access));
    }

    /// Decides on the next burst, if it is time: call it once or more in each cycle until it returns `None`. Bursts are returned in
    /// the order in which they use the data bus, before they do.
    pub fn serve(&mut self, cycle: u64) -> Option<Served> {
        let now = cycle * self.period;
        // Decisions are made late, so that a burst that arrives meanwhile can be better.
        if self.bus_free > now + self.lookahead() {
            return None;
        }
        match self.kind {
            Kind::Ideal {
                latency,
                beat_bytes,
            } => {
                let (arrived, access) = self.pending.pop_front()?;
                let beats = access.bytes.div_ceil(beat_bytes);
                let start = (arrived + latency.saturating_sub(1) * self.period).max(self.bus_free);
                self.bus_free = start + beats * self.period;
                self.bytes += beats * beat_bytes;
                let first = start / self.period + 1;
                Some(Served {
                    access,
                    first,
                    last: first + beats - 1,
                })
            }
            Kind::Device(device) => self.serve_device(&device, now),
        }
    }

    /// How long before the data bus is free the next burst is chosen.
    fn lookahead(&self) -> Time {
        match &self.kind {
            Kind::Ideal { .. } => Time::MAX / 2,
            Kind::Device(device) => device.rp + device.rcd + device.cas,
        }
    }

    fn serve_device(&mut self, device: &Device, now: Time) -> Option<Served> {
        if now >= self.next_refresh {
            self.refresh(device);
        }
        let window = self.pending.iter().take(WINDOW).enumerate();
        let starts = window.map(|(place, (ready, access))| {
            let mut bank = self.banks[device.place(access.address).0];
            (bank.prepare(device, access.address, *ready), place)
        });
        let (_, place) = starts.min()?;
        let (ready, access) = self.pending.remove(place)?;
        let (mut first, mut end) = (None, 0);
        let last_byte = access.address + access.bytes - 1;
        let mut at = access.address - access.address % device.column_bytes;
        while at <= last_byte {
            let bank = &mut self.banks[device.place(at).0];
            let command = bank.prepare(device, at, ready);
            let start = (command + device.cas).max(self.bus_free);
            end = start + device.column;
            self.bus_free = end;
            self.bytes += device.column_bytes;
            bank.ready = bank.ready.max(start - device.cas);
            if access.write {
                bank.written = end + device.wr;
            }
            first.get_or_insert(end);
            at += device.column_bytes;
        }
        let cycle = |time: Time| time.div_ceil(self.period) + device.controller;
        Some(Served {
            access,
            first: cycle(first?),
            last: cycle(end),
        })
    }

    /// Closes all rows and refreshes.
    fn refresh(&mut self, device: &Device) {
        let start = self.next_refresh.max(self.bus_free);
        let precharged = (self.banks.iter())
            .filter(|bank| bank.row.is_some())
            .map(|bank| start.max(bank.activated + device.ras).max(bank.written) + device.rp)
            .max();
        let ready = precharged.unwrap_or(start) + device.rfc;
        for bank in &mut self.banks {
            *bank = Bank {
                row: None,
                ready,
                ..*bank
            };
        }
        self.next_refresh += device.refi;
    }
}

impl Device {
    /// The bank and the row of an address: rows lie across the banks.
    fn place(&self, address: u64) -> (usize, u64) {
        let row = address / self.row_bytes;
        ((row % self.banks) as usize, row / self.banks)
    }
}

impl Bank {
    /// Opens the row of an address; returns the earliest time of a column command, not before `ready`.
    fn prepare(&mut self, device: &Device, address: u64, ready: Time) -> Time {
        let (_, row) = device.place(address);
        if self.row != Some(row) {
            let activate = match self.row {
                Some(_) => {
                    let precharge = ready
                        .max(self.ready)
                        .max(self.activated + device.ras)
                        .max(self.written);
                    (precharge + device.rp).max(self.activated + device.rc)
                }
                None => ready.max(self.ready),
            };
            *self = Bank {
                row: Some(row),
                activated: activate,
                ready: activate + device.rcd,
                ..*self
            };
        }
        ready.max(self.ready)
    }
}

/// Bursts of each kind that wait in the controller at most.
const QUEUE: usize = 32;

/// Identifier, address, and cycle of acceptance or completion of a burst.
type Key = (u32, u32, u64);

/// The pace of a slave with the timing of a memory.
pub struct DramPace {
    dram: Dram,
    beat_bytes: u64,
    next_id: u64,
    /// Bursts by the numbers that the timing model knows them by, and when they are served.
    keys: HashMap<u64, Key>,
    served: HashMap<Key, Served>,
}

impl DramPace {
    /// The memory of a configuration.
    pub fn new(config: &Config) -> DramPace {
        DramPace {
            dram: Dram::new(config),
            beat_bytes: u64::from(config.bus_data_bits / 8),
            next_id: 0,
            keys: HashMap::new(),
            served: HashMap::new(),
        }
    }

    /// The timing model.
    pub fn dram(&self) -> &Dram {
        &self.dram
    }

    /// Passes the bursts that are new in this cycle to the timing model.
    fn add(&mut self, now: u64, bursts: &[Accepted], write: bool) {
        for burst in bursts.iter().filter(|burst| burst.cycle + 1 == now) {
            let access = Access {
                id: self.next_id,
                address: burst.address.into(),
                bytes: u64::from(burst.beats) * self.beat_bytes,
                write,
            };
            self.keys.insert(self.next_id, key(burst));
            self.next_id += 1;
            self.dram.push(now, access);
        }
    }

    /// The burst among the first of their identifiers that has been due for the longest time.
    fn due(
        &self,
        now: u64,
        bursts: &[Accepted],
        due: impl Fn(&Served, &Accepted) -> u64,
    ) -> Option<usize> {
        let mut seen = vec![];
        let mut best = None;
        for (place, burst) in bursts.iter().enumerate() {
            if seen.contains(&burst.id) {
                continue;
            }
            seen.push(burst.id);
            let Some(served) = self.served.get(&key(burst)) else {
                continue;
            };
            let due = due(served, burst);
            if due <= now && best.is_none_or(|(earliest, _)| due < earliest) {
                best = Some((due, place));
            }
        }
        best.map(|(_, place)| place)
    }
}

fn key(burst: &Accepted) -> Key {
    (burst.id, burst.address, burst.cycle)
}

impl Pace for DramPace {
    fn decide(&mut self, view: &View<'_>) -> Decision {
        self.add(view.now, view.reads, false);
        self.add(view.now, view.complete, true);
        while let Some(served) = self.dram.serve(view.now) {
            if let Some(key) = self.keys.remove(&served.access.id) {
                self.served.insert(key, served);
            }
        }
        // What is over needs no entry any more.
        if self.served.len() > 4 * QUEUE {
            let live: Vec<Key> = view.reads.iter().chain(view.complete).map(key).collect();
            self.served.retain(|key, _| live.contains(key));
        }
        let beat = self.due(view.now, view.reads, |served, burst| {
            // The bytes of beat k have arrived when that share of the burst has.
            let share = (served.last - served.first) * u64::from(burst.done);
            served.first + share.div_ceil(u64::from(burst.beats - 1).max(1))
        });
        let response = self.due(view.now, view.complete, |served, _| served.last);
        Decision {
            accept_read: view.reads.len() < QUEUE,
            accept_write: view.writes < QUEUE,
            accept_datum: view.data < QUEUE,
            beat: beat.map(|place| (place, false)),
            response: response.map(|place| (place, false)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Runs accesses that arrive at the given cycles; returns when they are served.
    fn run(dram: &mut Dram, accesses: &[(u64, u64, u64, bool)]) -> Vec<Served> {
        let mut served = vec![];
        let mut next = accesses.iter().enumerate().peekable();
        for cycle in 0..1_000_000 {
            while let Some((id, &(_, address, bytes, write))) =
                next.next_if(|(_, (arrives, ..))| *arrives <= cycle)
            {
                let id = id as u64;
                dram.push(
                    cycle,
                    Access {
                        id,
                        address,
                        bytes,
                        write,
                    },
                );
            }
            while let Some(one) = dram.serve(cycle) {
                served.push(one);
            }
            if served.len() == accesses.len() {
                return served;
            }
        }
        panic!("{} of {} were served", served.len(), accesses.len());
    }

    fn device(device: Device) -> Dram {
        Dram::of(Kind::Device(device), 100)
    }

    #[test]
    fn an_ideal_memory_has_its_latency_and_a_beat_per_cycle() {
        let kind = Kind::Ideal {
            latency: 8,
            beat_bytes: 16,
        };
        let mut dram = Dram::of(kind, 100);
        let served = run(
            &mut dram,
            &[(0, 0, 64, false), (0, 4096, 64, false), (100, 0, 16, false)],
        );
        let cycles: Vec<_> = served.iter().map(|one| (one.first, one.last)).collect();
        assert_eq!(cycles, [(8, 11), (12, 15), (108, 108)]);
    }

    /// A single read from a closed row: controller, activate, column command, two clocks of data, controller.
    #[test]
    fn a_ddr_read_takes_what_the_table_says() {
        let served = run(&mut device(DDR_VIRTEX4), &[(0, 0, 32, false)]);
        let cycles = 8 + (20u64 + 25 + 20).div_ceil(10) + 8;
        assert_eq!((served[0].first, served[0].last), (cycles, cycles));
        // From the open row: no activate. From another row of the bank: a precharge, and an activate.
        let far = 4 * DDR_VIRTEX4.row_bytes;
        let accesses = [
            (0, 0, 32, false),
            (100, 32, 32, false),
            (200, far, 32, false),
        ];
        let served = run(&mut device(DDR_VIRTEX4), &accesses);
        let took: Vec<_> = served
            .iter()
            .zip(accesses)
            .map(|(one, of)| one.last - of.0)
            .collect();
        assert_eq!(took, [23, 21, 25]);
    }

    #[test]
    fn sequential_reads_reach_the_peak_less_refresh() {
        for (device_of, peak) in [(DDR_VIRTEX4, 16.0), (sdr_ulx3s(100), 2.0)] {
            let accesses: Vec<_> = (0..4000).map(|k| (0, 64 * k, 64, false)).collect();
            let mut dram = device(device_of);
            assert_eq!(dram.peak_bytes_per_cycle(), peak);
            let served = run(&mut dram, &accesses);
            let cycles = served.last().unwrap().last;
            let rate = 64.0 * accesses.len() as f64 / cycles as f64;
            assert!((0.95 * peak..=peak).contains(&rate), "{rate} of {peak}");
        }
    }

    /// Of two bursts the one whose row is open goes first; a burst is never overtaken for ever, since the window holds few.
    #[test]
    fn an_open_row_goes_first() {
        let far = 4 * DDR_VIRTEX4.row_bytes;
        let accesses = [(0, 0, 32, false), (1, far, 32, false), (1, 64, 32, false)];
        let served = run(&mut device(DDR_VIRTEX4), &accesses);
        let order: Vec<_> = served.iter().map(|one| one.access.id).collect();
        assert_eq!(order, [0, 2, 1]);
    }

    #[test]
    fn writes_delay_the_next_row_of_their_bank() {
        let far = 4 * DDR_VIRTEX4.row_bytes;
        let last = |write| {
            let accesses = [(0, 0, 32, write), (100, far, 32, false)];
            run(&mut device(DDR_VIRTEX4), &accesses)[1].last
        };
        assert_eq!(last(true), last(false));
        let last = |write| {
            let accesses = [(0, 0, 32, write), (0, far, 32, false)];
            run(&mut device(DDR_VIRTEX4), &accesses)[1].last
        };
        assert!(last(true) > last(false));
    }
}
