//! What a host does with the chip besides [`Chip::read`] and [`Chip::write`]: it fills and reads memory, and waits. A test may thus put
//! software between itself and the chip.

use super::Chip;
use crate::chip::memory::Memory;
use crate::cosim::axi::{BEAT_WORDS, Bytes, Data};
use anyhow::Result;

/// Bytes of a word.
const WORD: u32 = 4;

impl Chip {
    /// Connects a memory to the bus, in place of the one before. The chip must be idle.
    pub fn connect(&mut self, memory: &Memory) {
        self.memory = Bytes {
            base: memory.base(),
            bytes: memory.bytes().to_vec(),
        };
    }

    /// The memory as chip and host have left it.
    pub fn memory(&self) -> Memory {
        Memory::new(self.memory.base, self.memory.bytes.clone())
    }

    /// The word at an address of memory.
    ///
    /// # Errors
    /// The address is outside of the memory.
    pub fn read_memory(&self, address: u32) -> Result<u32> {
        let [word, ..] = self.memory.beat(address, WORD)?;
        Ok(word)
    }

    /// Writes the word at an address of memory, also while the chip runs.
    ///
    /// # Errors
    /// The address is outside of the memory.
    pub fn write_memory(&mut self, address: u32, word: u32) -> Result<()> {
        let mut data: Data = [0; BEAT_WORDS];
        data[0] = word;
        self.memory.write(address, WORD, &data, 0xf)
    }

    /// Lets cycles pass in which the host does nothing.
    ///
    /// # Errors
    /// A violation of the protocol of the memory bus. A chip that makes no headway is the host's to notice.
    pub fn step(&mut self, cycles: u64) -> Result<()> {
        for _ in 0..cycles {
            self.cycle()?;
            self.quiet = 0;
        }
        Ok(())
    }

    /// Whether the chip requested the interrupt in the last cycle.
    pub fn interrupts(&self) -> bool {
        self.interrupt
    }
}
