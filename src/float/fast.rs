//! Arithmetic at the golden model's speed: a number is carried exactly in an `f64`, an operation is the
//! hardware's `f64` operation and one rounding.
//!
//! With p = 53 ≥ 2·24 + 2 bits, rounding a sum, product or quotient of numbers of at most 24 bits twice is
//! rounding it once, and with at most 10 exponent bits no such `f64` result over- or underflows.

use super::Format;

/// The operations of one format on numbers carried in `f64`. Every operand must be a number of the format.
#[derive(Clone, Copy, Debug)]
pub struct Arithmetic {
    format: Format,
    /// Bits of an `f64` fraction beyond the format's.
    shift: u32,
    half_minus_one: u64,
    keep: u64,
    /// Magnitudes, as `f64` bit patterns, of the least normal and of the greatest number.
    least: u64,
    greatest: u64,
}

const SIGN: u64 = 1 << 63;

impl Arithmetic {
    pub fn new(format: Format) -> Self {
        let shift = 52 - format.fraction_bits();
        Arithmetic {
            format,
            shift,
            half_minus_one: (1 << (shift - 1)) - 1,
            keep: !0 << shift,
            least: format.to_f64(format.least_normal()).to_bits(),
            greatest: format.to_f64(format.greatest()).to_bits(),
        }
    }

    pub fn format(&self) -> Format {
        self.format
    }

    /// Rounds any `f64` to the format: to nearest even, underflow to zero, overflow to infinity, −0 to +0.
    #[inline(always)]
    pub fn round(&self, value: f64) -> f64 {
        let bits = value.to_bits();
        let rounded = bits.wrapping_add(self.half_minus_one + (bits >> self.shift & 1)) & self.keep;
        let magnitude = rounded & !SIGN;
        if magnitude.wrapping_sub(self.least) <= self.greatest - self.least {
            f64::from_bits(rounded)
        } else if value.is_nan() {
            f64::NAN
        } else if magnitude < self.least {
            0.0
        } else {
            f64::INFINITY.copysign(value)
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

    /// `candidate` where it is less than `bound`, else `bound`: a NaN never replaces a bound.
    #[inline(always)]
    pub fn min(&self, bound: f64, candidate: f64) -> f64 {
        if candidate < bound { candidate } else { bound }
    }

    /// `candidate` where it is greater than `bound`, else `bound`: a NaN never replaces a bound.
    #[inline(always)]
    pub fn max(&self, bound: f64, candidate: f64) -> f64 {
        if candidate > bound { candidate } else { bound }
    }

    /// The number `ulps` steps above `value` (below, where negative). −0 and +0 are one value whose
    /// neighbours are ± the least normal, beyond the greatest is ∞; ±∞ and NaN do not step.
    #[inline(always)]
    pub fn step(&self, value: f64, ulps: i32) -> f64 {
        if !value.is_finite() {
            return value;
        }
        // On this line the format's numbers are consecutive integers: zero is 0, the least normal 1.
        let magnitude = value.to_bits() & !SIGN;
        let offset = (self.least >> self.shift) as i64 - 1;
        let position = if magnitude == 0 {
            0
        } else {
            (magnitude >> self.shift) as i64 - offset
        };
        let position = if value < 0.0 { -position } else { position } + i64::from(ulps);
        let limit = (self.greatest >> self.shift) as i64 - offset;
        let magnitude = if position == 0 {
            return 0.0;
        } else if position.abs() > limit {
            f64::INFINITY
        } else {
            f64::from_bits(((position.abs() + offset) as u64) << self.shift)
        };
        if position < 0 { -magnitude } else { magnitude }
    }
}
