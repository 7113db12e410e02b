//! Block RAM of more words than one has.

use super::plan::Plan;
use super::prefetch::pick;
use crate::hdl::{Builder, Memory, Signal, Style, bits_for};

/// Words of a block RAM at its greatest width: 512 of 36 bits, in a Virtex-4 as in an ECP5.
const WORDS: u32 = 512;

/// A memory in block RAM, as one or, where a choice between block RAMs needs a stage of its own, in banks.
pub(super) struct Banks<'b> {
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
        Banks { banks }
    }

    fn split(address: Signal<'b>) -> (Signal<'b>, Signal<'b>) {
        let low = WORDS.trailing_zeros();
        (address.high(address.width() - low), address.low(low))
    }

    /// Writes a word at the clock edge; with banks a clock later, since wires to all of them take a clock of their own. So nobody may
    /// read it in the two clocks after.
    pub fn write(&self, enable: Signal<'b>, address: Signal<'b>, word: Signal<'b>) {
        if let [(only, _)] = self.banks[..] {
            return only.write(enable, address, word);
        }
        let (bank, address) = Banks::split(address);
        for (i, (memory, bits)) in (0u32..).zip(&self.banks) {
            let enable = (enable & bank.equals(u128::from(i))).register();
            memory.write(enable, address.low(*bits).register(), word.register());
        }
    }

    /// The word at an address, as late as [`Plan::read`] has it; with banks a clock later, as it is written.
    pub fn read(&self, plan: &Plan, address: Signal<'b>) -> Signal<'b> {
        if let [(only, _)] = self.banks[..] {
            return plan.read(only, address);
        }
        let (bank, address) = Banks::split(address);
        let words: Vec<_> = (self.banks.iter())
            .map(|(memory, bits)| memory.read(address.low(*bits).register()).register())
            .collect();
        plan.settle_choice(pick(bank, &words))
    }
}
