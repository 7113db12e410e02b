//! Arithmetic at the golden model's speed: a number is represented exactly in an `f64`; an operation is the
//! hardware's `f64` operation followed by one rounding.
//!
//! With p = 53 ≥ 2·24 + 2 bits, rounding a sum, product or quotient of numbers of at most 24 bits twice gives the same
//! result as rounding it once, and with at most 10 exponent bits no such `f64` result overflows or underflows.

use super::Format;

/// The operations of one format on numbers in `f64`. Every operand must be a value of the format.
///
/// Rounding and stepping have no branches, so a loop over a packet's rays becomes vector instructions
/// if the compiler may use them (with AVX2, 2.5 times as fast), and zeros and infinities cost no more than other numbers.
#[derive(Clone, Copy, Debug)]
pub struct Arithmetic {
    format: Format,
    /// Number of fraction bits of an `f64` in addition to the format's.
    shift: u32,
    half_minus_one: u64,
    keep: u64,
    /// The minimum and maximum magnitudes that round to a normal number, as `f64` bit patterns.
    least_rounded: u64,
    greatest_rounded: u64,
    /// The greatest number, as an `f64` bit pattern.
    greatest: u64,
    /// For [`Arithmetic::step`]: the position of the greatest number, and the difference between a shifted `f64` bit pattern
    /// and its number's position.
    greatest_position: i64,
    offset: i64,
}

const SIGN: u64 = 1 << 63;

impl Arithmetic {
    /// The arithmetic of a format.
    pub fn new(format: Format) -> Self {
        let shift = 52 - format.fraction_bits();
        let half = 1 << (shift - 1);
        let least = format.to_f64(format.least_normal()).to_bits();
        let greatest = format.to_f64(format.greatest()).to_bits();
        let offset = (least >> shift) as i64 - 1;
        Arithmetic {
            format,
            shift,
            half_minus_one: half - 1,
            keep: !0 << shift,
            // Both bounds are ties: to the least number, which is even, and to the power of two beyond the
            // greatest. (Below a power of two an `f64` has twice as many numbers, as the format would.)
            least_rounded: least - half,
            greatest_rounded: greatest + half - 1,
            greatest,
            greatest_position: (greatest >> shift) as i64 - offset,
            offset,
        }
    }

    pub fn format(&self) -> Format {
        self.format
    }

    /// Rounds any `f64` to the format: to nearest even, underflow to zero, overflow to infinity, −0 to +0.
    #[inline(always)]
    pub fn round(&self, value: f64) -> f64 {
        let bits = value.to_bits();
        let magnitude = bits & !SIGN;
        // Add half an ulp, or slightly less if that would round a tie to an odd number, and truncate.
        // A carry out of the fraction increments the exponent, as required.
        let odd = bits.wrapping_shr(self.shift) & 1;
        let more = self.half_minus_one.wrapping_add(odd);
        let rounded = bits.wrapping_add(more) & self.keep;
        let rounded = if magnitude < self.least_rounded {
            0
        } else {
            rounded
        };
        if magnitude <= self.greatest_rounded {
            f64::from_bits(rounded)
        } else {
            // An infinity with the same sign, or NaN.
            value * f64::INFINITY
        }
    }

    #[inline(always)]
    pub fn add(&self, a: f64, b: f64) -> f64 {
        self.round(a + b)
    }

    #[inline(always)]
    pub fn sub(&self, a: f64, b: f64) -> f64 {
        self.round(a - b)
    }

    #[inline(always)]
    pub fn mul(&self, a: f64, b: f64) -> f64 {
        self.round(a * b)
    }

    /// 1 ÷ a, correctly rounded; ±0 gives ±∞ and ±∞ gives +0.
    #[inline(always)]
    pub fn reciprocal(&self, a: f64) -> f64 {
        self.round(1.0 / a)
    }

    /// `candidate` if it is less than `bound`, otherwise `bound`: a NaN never replaces a bound.
    #[inline(always)]
    pub fn min(&self, bound: f64, candidate: f64) -> f64 {
        if candidate < bound { candidate } else { bound }
    }

    /// `candidate` if it is greater than `bound`, otherwise `bound`: a NaN never replaces a bound.
    #[inline(always)]
    pub fn max(&self, bound: f64, candidate: f64) -> f64 {
        if candidate > bound { candidate } else { bound }
    }

    /// The number `ulps` steps above `value`, or below it if negative. −0 and +0 are one value whose
    /// neighbours are ± the least normal number. Beyond the greatest number is ∞; ±∞ and NaN do not change.
    #[inline(always)]
    pub fn step(&self, value: f64, ulps: i32) -> f64 {
        let bits = value.to_bits();
        let magnitude = bits & !SIGN;
        let negate_if = |condition, position: i64| {
            if condition {
                position.wrapping_neg()
            } else {
                position
            }
        };
        // Positions are consecutive integers: zero is 0, the least normal number is 1.
        let position = if magnitude == 0 {
            0
        } else {
            (magnitude.wrapping_shr(self.shift) as i64).wrapping_sub(self.offset)
        };
        let position = negate_if(bits != magnitude, position).wrapping_add(i64::from(ulps));
        let negative = position < 0;
        let distance = negate_if(negative, position);
        let stepped = if distance == 0 {
            0
        } else {
            (distance.wrapping_add(self.offset) as u64).wrapping_shl(self.shift)
        };
        let stepped = if distance > self.greatest_position {
            f64::INFINITY.to_bits()
        } else {
            stepped
        };
        let stepped = if negative { stepped | SIGN } else { stepped };
        f64::from_bits(if magnitude > self.greatest {
            bits
        } else {
            stepped
        })
    }
}
