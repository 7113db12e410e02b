//! Block RAM of more words than one has.

use super::plan::Plan;
use crate::hdl::{Builder, Memory, Signal, Style, bits_for};

/// The choice that an index names, by a tree of choices between two. It is called `name` where it gets a name in the Verilog.
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

/// Words of a block RAM at its greatest width: 512 of 36 bits, in a Virtex-4 as in an ECP5.
const WORDS: u32 = 512;

/// What writes a bank, as it does: a clock late where there are several.
pub(super) struct BankWrite<'b> {
    pub enable: Signal<'b>,
    pub address: Signal<'b>,
    pub word: Signal<'b>,
}

/// What is read of all banks.
pub(super) struct BankRead<'b> {
    pub address: Signal<'b>,
    pub word: Signal<'b>,
    /// Of each bank, as its RAM has read it.
    pub of_banks: Vec<Signal<'b>>,
}

/// A memory in block RAM, as one or, where a choice between block RAMs needs a stage of its own, in banks.
pub(super) struct Banks<'b> {
    name: String,
    /// As many as the memory needs, each with the bits of its addresses; the last perhaps smaller.
    banks: Vec<(Memory<'b>, u32)>,
}

impl<'b> Banks<'b> {
    /// `plan` says whether there are banks: from the clock on where [`Plan::read`] has a register to choose behind.
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

    /// Each bank, with the bits of its addresses.
    pub fn banks(&self) -> &[(Memory<'b>, u32)] {
        &self.banks
    }

    /// The number of the bank that an address is in, and where it is there.
    pub fn split(address: Signal<'b>) -> (Signal<'b>, Signal<'b>) {
        let low = WORDS.trailing_zeros();
        (address.high(address.width() - low), address.low(low))
    }

    /// Writes a word at the clock edge; with banks a clock later, since wires to all of them take a clock of their own. So nobody may
    /// read it in the two clocks after.
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

    /// The word at an address, as late as [`Plan::read`] has it; with banks a clock later, as it is written.
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
