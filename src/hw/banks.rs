//! Memories of more words than one block RAM has.

use super::plan::Plan;
use crate::hdl::{Builder, Memory, Signal, Style, bits_for};

/// A multiplexer that selects the choice with number `index`, as a tree of two-input multiplexers. Its name in the Verilog is `name`.
pub(super) fn pick<'b>(name: &str, index: Signal<'b>, choices: &[Signal<'b>]) -> Signal<'b> {
    if let [only] = choices {
        return *only;
    }
    let half = choices.len().next_power_of_two() / 2;
    let (low, high) = choices.split_at(half);
    let level = half.trailing_zeros();
    let is_high = index.bit(level).hinted(format!("{name}_index{level}"));
    let high = pick(&format!("{name}_high"), index, high);
    is_high
        .mux(high, pick(&format!("{name}_low"), index, low))
        .hinted(name)
}

/// Words of a block RAM at its greatest width: 512 of 36 bits, for Virtex-4 and ECP5.
const WORDS: u32 = 512;

/// The write port of a bank. With several banks, writes are one cycle later.
pub(super) struct BankWrite<'b> {
    pub enable: Signal<'b>,
    pub address: Signal<'b>,
    pub word: Signal<'b>,
}

/// The words read from all banks.
pub(super) struct BankRead<'b> {
    pub address: Signal<'b>,
    pub word: Signal<'b>,
    /// The word of each bank, at the output of its RAM.
    pub of_banks: Vec<Signal<'b>>,
}

/// A memory in block RAM. It is split into banks if the multiplexer between block RAMs needs a pipeline stage of its own.
pub(super) struct Banks<'b> {
    name: String,
    /// The banks, each with its number of address bits; the last one can be smaller.
    banks: Vec<(Memory<'b>, u32)>,
}

impl<'b> Banks<'b> {
    /// Makes the memory. It has banks if [`Plan::chooses_after_read`].
    pub fn new(plan: &Plan, m: &'b Builder, name: &str, words: u32, width: u32) -> Banks<'b> {
        let whole = |name: String, words| {
            let memory = m.memory(name, words, width, Style::Block);
            (memory, bits_for(u64::from(words)))
        };
        let banks = match plan.chooses_after_read() && words > WORDS {
            false => vec![whole(name.to_string(), words)],
            true => (0..words.div_ceil(WORDS))
                .map(|i| whole(format!("{name}_bank{i}"), WORDS.min(words - i * WORDS)))
                .collect(),
        };
        let name = name.to_string();
        Banks { name, banks }
    }

    /// The banks, each with its number of address bits.
    pub fn banks(&self) -> &[(Memory<'b>, u32)] {
        &self.banks
    }

    /// Splits an address into the number of the bank and the address in the bank.
    pub fn split(address: Signal<'b>) -> (Signal<'b>, Signal<'b>) {
        let low = WORDS.trailing_zeros();
        (address.high(address.width() - low), address.low(low))
    }

    /// Writes a word at the clock edge. With banks the write is one cycle later, because the wires to all banks take a cycle of their
    /// own; the word must not be read in the two cycles after the call.
    pub fn write(
        &self,
        enable: Signal<'b>,
        address: Signal<'b>,
        word: Signal<'b>,
    ) -> Vec<BankWrite<'b>> {
        let write = |memory: Memory<'b>, enable, address, word| {
            memory.write(enable, address, word);
            BankWrite {
                enable,
                address,
                word,
            }
        };
        if let [(only, _)] = self.banks[..] {
            return vec![write(only, enable, address, word)];
        }
        let (bank, address) = Banks::split(address);
        let banks = (0u32..).zip(&self.banks);
        let written = banks.map(|(i, (memory, bits))| {
            let enable = (enable & bank.equals(u128::from(i))).register();
            let address = address.low(*bits).register();
            write(*memory, enable, address, word.register())
        });
        written.collect()
    }

    /// Reads the word at an address with the latency of [`Plan::read`]. With banks the latency is one cycle more, like that of a write.
    pub fn read(&self, plan: &Plan, address: Signal<'b>) -> BankRead<'b> {
        if let [(only, _)] = self.banks[..] {
            return BankRead {
                address,
                word: plan.read(only, address),
                of_banks: vec![only.read(address)],
            };
        }
        let (bank, place) = Banks::split(address);
        let read = (self.banks.iter()).map(|(memory, bits)| {
            let word = memory.read(place.low(*bits).register());
            (word, word.register())
        });
        let (of_banks, words): (Vec<_>, Vec<_>) = read.unzip();
        BankRead {
            address,
            word: plan.settle_choice(pick(&format!("{}_bank", self.name), bank, &words)),
            of_banks,
        }
    }
}
