//! The register file: what an access reads and changes, as `docs/chip.md` and the table of `docs/registers.md` say.

use crate::chip::registers::{
    self as table, Access, COUNTER_BITS, COUNTERS, counter, interrupt, offset, status,
};
use crate::config::Config;
use std::collections::HashMap;

/// The counters, in the order of the table.
pub type Counts = [u64; COUNTERS.len()];

/// A write to the register window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Write {
    pub address: u32,
    pub data: u32,
    /// One bit for each byte that is written.
    pub strobes: u32,
}

/// How a list has ended; code 0 is no error.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct End {
    pub code: u32,
    pub descriptor: u32,
    pub value: u32,
}

/// What happens at the end of a cycle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cycle {
    /// The write that is accepted.
    pub write: Option<Write>,
    /// Whether the command processor starts the queued list.
    pub starts: bool,
    /// Whether a signal raises the interrupt.
    pub signalled: bool,
    /// How the list ends.
    pub ended: Option<End>,
}

/// What a cycle had that benches count.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Effects {
    /// A doorbell without effect.
    pub overrun: bool,
    /// A pending interrupt that was cleared; one whose event came in the same cycle.
    pub cleared: bool,
    pub cleared_at_event: bool,
    pub snapshot: bool,
}

/// The register file.
#[derive(Clone, Debug)]
pub struct Registers {
    constants: HashMap<u32, u32>,
    list: u32,
    queued: Option<u32>,
    error: End,
    /// Whether an error's descriptor and value are shown; they have no meaning after a list without an error.
    shows_error: bool,
    status: u32,
    enable: u32,
    copies: Counts,
}

const ALL_INTERRUPTS: u32 = (1 << interrupt::COUNT) - 1;

impl Registers {
    /// The registers of a machine after a reset.
    pub fn new(config: &Config) -> Registers {
        let constants = table::registers(config).into_iter();
        let constants = constants.filter(|register| register.access == Access::ReadOnly);
        Registers {
            constants: constants.map(|r| (r.offset, r.reset)).collect(),
            list: 0,
            queued: None,
            error: End {
                code: 0,
                descriptor: 0,
                value: 0,
            },
            shows_error: true,
            status: 0,
            enable: 0,
            copies: [0; COUNTERS.len()],
        }
    }

    /// The list that waits to be started.
    pub fn queued(&self) -> Option<u32> {
        self.queued
    }

    /// Whether the interrupt is requested.
    pub fn interrupts(&self) -> bool {
        self.status & self.enable != 0
    }

    /// The value at an address, while a list runs or not; `None` if it has no meaning.
    pub fn read(&self, address: u32, running: bool) -> Option<u32> {
        let of_error = |value: u32| self.shows_error.then_some(value);
        let place = address & !3;
        if let Some(number) = place.checked_sub(offset::COUNTERS)
            && let Some(count) = self.copies.get(number as usize / 8)
        {
            let [low, _] = counter(number as usize / 8);
            return Some((count >> (8 * (place - low))) as u32);
        }
        match place {
            offset::LIST => Some(self.list),
            offset::STATUS => {
                let overrun = self.status >> interrupt::OVERRUN & 1;
                Some(
                    u32::from(running) << status::BUSY
                        | u32::from(self.queued.is_some()) << status::QUEUED
                        | overrun << status::OVERRUN,
                )
            }
            offset::ERROR_CODE => Some(self.error.code),
            offset::ERROR_DESCRIPTOR => of_error(self.error.descriptor),
            offset::ERROR_ADDRESS => of_error(self.error.value),
            offset::INTERRUPT_STATUS => Some(self.status),
            offset::INTERRUPT_ENABLE => Some(self.enable),
            _ => Some(self.constants.get(&place).copied().unwrap_or(0)),
        }
    }

    /// Goes on by a cycle, in which the counters have these values.
    pub fn step(&mut self, cycle: &Cycle, counts: &Counts) -> Effects {
        let mut effects = Effects::default();
        let (mut clears, mut events) = (0, 0);
        let mut rings = false;
        if let Some(Write {
            address,
            data,
            strobes,
        }) = cycle.write
        {
            let mask = (0..4)
                .filter(|byte| strobes >> byte & 1 != 0)
                .fold(0, |mask, byte| mask | 0xff << (8 * byte));
            let merged = |old: u32| (data & mask) | (old & !mask);
            match address & !3 {
                offset::LIST => self.list = merged(self.list),
                offset::DOORBELL => rings = true,
                offset::INTERRUPT_STATUS => clears = data & mask,
                offset::INTERRUPT_ENABLE => self.enable = merged(self.enable) & ALL_INTERRUPTS,
                offset::SNAPSHOT => {
                    self.copies = counts.map(|count| count & ((1 << COUNTER_BITS) - 1));
                    effects.snapshot = true;
                }
                _ => (),
            }
        }
        // A doorbell at the start of the queued list finds it still queued.
        if rings && self.queued.is_some() {
            effects.overrun = true;
            events |= 1 << interrupt::OVERRUN;
        } else if rings {
            self.queued = Some(self.list);
        }
        if cycle.starts {
            self.queued = None;
            self.error.code = 0;
        }
        if let Some(end) = cycle.ended {
            self.shows_error = end.code != 0;
            self.error = end;
            let event = match end.code {
                0 => interrupt::END,
                _ => interrupt::ERROR,
            };
            events |= 1 << event;
        }
        events |= u32::from(cycle.signalled) << interrupt::SIGNAL;
        effects.cleared = self.status & clears & !events != 0;
        effects.cleared_at_event = events & clears != 0;
        // An event is not lost if it comes as the bit is cleared.
        self.status = (self.status & !clears) | events;
        effects
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn write(address: u32, data: u32, strobes: u32) -> Cycle {
        Cycle {
            write: Some(Write {
                address,
                data,
                strobes,
            }),
            ..Cycle::default()
        }
    }

    #[test]
    fn doorbells_start_queue_and_overrun() {
        let mut unit = Registers::new(&Config::reference());
        let mut step = |cycle: &Cycle| {
            unit.step(cycle, &[7; COUNTERS.len()]);
            let read = |at| unit.read(at, false).unwrap();
            (unit.queued(), read(offset::STATUS), read(offset::LIST))
        };
        assert_eq!(step(&write(offset::LIST, 0x1234_5678, 0xf)).2, 0x1234_5678);
        assert_eq!(step(&write(offset::LIST, 0xaaaa_aaaa, 0x2)).2, 0x1234_aa78);
        assert_eq!(step(&write(offset::DOORBELL, 0, 0xf)).0, Some(0x1234_aa78));
        assert_eq!(step(&write(offset::LIST, 0x40, 0xf)).0, Some(0x1234_aa78));
        let queued = 1 << status::QUEUED;
        let (list, now, _) = step(&write(offset::DOORBELL, 1, 0xf));
        assert_eq!(
            (list, now),
            (Some(0x1234_aa78), queued | 1 << status::OVERRUN)
        );
        let starts = Cycle {
            starts: true,
            ..Cycle::default()
        };
        assert_eq!(step(&starts).0, None);
        let cleared = step(&write(offset::INTERRUPT_STATUS, 0xf, 0xf));
        assert_eq!(cleared.1, 0);
    }
}
