//! A memory of bytes, as the chip sees it.

/// Consecutive bytes from an address on. All other addresses do not exist: the bus answers DECERR.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Memory {
    base: u32,
    bytes: Vec<u8>,
}

impl Memory {
    /// A memory of these bytes at `base`.
    ///
    /// # Panics
    /// If it reaches beyond the address space.
    pub fn new(base: u32, bytes: Vec<u8>) -> Memory {
        assert!(
            u64::from(base) + bytes.len() as u64 <= 1 << 32,
            "the memory ends within the address space"
        );
        Memory { base, bytes }
    }

    /// The first address.
    pub fn base(&self) -> u32 {
        self.base
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    fn range(&self, address: u64, count: usize) -> Option<std::ops::Range<usize>> {
        let first = usize::try_from(address.checked_sub(self.base.into())?).ok()?;
        let end = first.checked_add(count)?;
        (end <= self.bytes.len()).then_some(first..end)
    }

    /// The bytes at an address; `None` if not all of them exist.
    pub fn read(&self, address: u64, count: usize) -> Option<&[u8]> {
        self.range(address, count).map(|range| &self.bytes[range])
    }

    /// The bytes at an address for modification; `None` if not all of them exist.
    pub fn read_mut(&mut self, address: u64, count: usize) -> Option<&mut [u8]> {
        let range = self.range(address, count)?;
        Some(&mut self.bytes[range])
    }

    /// The 32-bit word at an address.
    pub fn word(&self, address: u64) -> Option<u32> {
        let bytes = self.read(address, 4)?;
        Some(u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]))
    }
}
