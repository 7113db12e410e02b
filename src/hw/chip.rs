//! The chip around the core: registers, command processor, ray reader, hit writer, caches, and the AXI4 master, as `docs/chip.md`
//! defines them.

pub mod cast;
pub mod commands;
pub mod hits;
pub mod number;
pub mod rays;
pub mod registers;

use super::memory::ADDRESS_BITS;
use crate::bundle;

/// Bytes of a word that moves between the units of the chip and the memory system.
pub const WORD_BYTES: u32 = 16;

/// Bits of such a word.
pub const WORD_BITS: u32 = 8 * WORD_BYTES;

/// Width of the number of rays of a cast.
pub const COUNT_BITS: u32 = 32;

bundle! {
    /// A word to write, at a byte address that is a multiple of 16.
    pub struct WordWrite() {
        address: ADDRESS_BITS,
        data: WORD_BITS,
        /// One bit per byte that is written.
        strobes: WORD_BYTES,
    }
}
