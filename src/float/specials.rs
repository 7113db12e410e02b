//! Special operands, for which faults of arithmetic are most likely.

use super::Format;
use std::collections::HashSet;

/// Formats with at most this number of patterns are tested completely.
const WHOLE: usize = 1 << 11;

/// The bit patterns for tests of arithmetic units with all pairs, in a fixed order
/// and without duplicates: all patterns of a format of at most 11 bits, otherwise 2,048 to 2,500 patterns.
///
/// With both signs: zeros, infinities, NaNs, and zeros with a non-zero fraction; the
/// numbers near 1, the least and the greatest normal number; powers of two over the whole range,
/// with both neighbours; significands that result in ties and long carries; and a fixed random rest.
pub fn specials(format: Format) -> Vec<u64> {
    if format.width() <= WHOLE.ilog2() {
        return (0..1 << format.width()).collect();
    }
    let mut list = List {
        format,
        patterns: Vec::new(),
        known: HashSet::new(),
    };
    let fraction_bits = format.fraction_bits();
    let ones = format.fraction_mask();
    let infinity = format.infinity();

    // Zeros, canonical and not; infinities; NaNs, canonical and not.
    for fraction in [0, 1, ones >> 1, 1 << (fraction_bits - 1), ones] {
        list.push(fraction);
        list.push(infinity | fraction);
    }
    // The ends of the range, and 1.
    for distance in 0..4 {
        list.push(format.least_normal() + distance);
        list.push(format.greatest() - distance);
        list.push(format.one() + distance);
        list.push(format.one() - distance);
    }
    // Fractions with few bits, with many bits, and halves of them: their sums and products are ties or have long carries.
    let mut fractions = vec![0, 1, 2, 3, ones, ones - 1, ones - 2, ones >> 1, ones / 3];
    for bit in 0..fraction_bits {
        fractions.extend([1 << bit, 1 << bit | 1, ones ^ 1 << bit, ones >> bit]);
    }
    for exponent in [format.bias() as u64 - 1, format.bias() as u64] {
        for &fraction in &fractions {
            list.push(exponent << fraction_bits | fraction);
        }
    }
    // Powers of two and their neighbours on both sides.
    for exponent in exponents(format) {
        let power = exponent << fraction_bits;
        list.push(power);
        list.push(power + 1);
        list.push(power - 1);
    }
    // The rest: any exponent, with one of these fractions or a random one.
    let mut random = SplitMix64(0x24);
    while list.patterns.len() < WHOLE {
        let exponent = 1 + random.below(format.exponent_mask() - 1);
        let fraction = match random.below(2) {
            0 => fractions[random.below(fractions.len() as u64) as usize],
            _ => random.below(ones + 1),
        };
        list.push(exponent << fraction_bits | fraction);
    }
    list.patterns
}

/// Stored exponents of normal numbers: all if there are at most 128, otherwise those at both ends and
/// near 1 within the reach of significands, and an even sample of the others.
fn exponents(format: Format) -> Vec<u64> {
    let last = format.exponent_mask() - 1;
    let one = format.bias() as u64;
    let reach = u64::from(format.fraction_bits()) + 3;
    let stride = last.div_ceil(128);
    (1..=last)
        .filter(|&exponent| {
            exponent % stride == 0
                || exponent <= reach
                || exponent > last - reach
                || exponent.abs_diff(one) <= reach
        })
        .collect()
}

struct List {
    format: Format,
    patterns: Vec<u64>,
    known: HashSet<u64>,
}

impl List {
    /// Appends a magnitude with both signs.
    fn push(&mut self, magnitude: u64) {
        if self.known.insert(magnitude) {
            self.patterns
                .extend([magnitude, magnitude | self.format.sign_bit()]);
        }
    }
}

/// An own generator, so the list does not depend on the version of a library.
struct SplitMix64(u64);

impl SplitMix64 {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mixed = (self.0 ^ self.0 >> 30).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let mixed = (mixed ^ mixed >> 27).wrapping_mul(0x94d0_49bb_1331_11eb);
        mixed ^ mixed >> 31
    }

    fn below(&mut self, limit: u64) -> u64 {
        self.next() % limit
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_format_has_its_list() {
        for exponent_bits in Format::EXPONENT_BITS {
            for fraction_bits in Format::FRACTION_BITS {
                let format = Format::new(exponent_bits, fraction_bits).unwrap();
                let list = specials(format);
                let distinct: HashSet<_> = list.iter().collect();
                assert_eq!(
                    distinct.len(),
                    list.len(),
                    "{format}: a pattern occurs twice"
                );
                assert!(
                    list.iter().all(|&bits| bits < 1 << format.width()),
                    "{format}"
                );
                let least = WHOLE.min(1 << format.width());
                assert!(
                    (least..=2500).contains(&list.len()),
                    "{format}: {}",
                    list.len()
                );
                for bits in [0, format.infinity(), format.nan(), format.one()] {
                    assert!(distinct.contains(&bits), "{format}: {bits:#x} is missing");
                }
            }
        }
    }
}
