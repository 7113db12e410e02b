//! The layout of a number's bits, and conversion to and from `f64`.

use std::fmt;

/// A binary floating-point format: 1 sign bit, 3–10 exponent bits, 2–23 fraction bits.
///
/// Bit patterns are right-aligned in a `u64`: sign, exponent, fraction from the most significant bit down.
#[derive(Clone, Copy, PartialEq, Eq, Hash, Debug)]
pub struct Format {
    exponent_bits: u32,
    fraction_bits: u32,
}

/// The error of a format outside the supported range.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct FormatError {
    exponent_bits: u32,
    fraction_bits: u32,
}

impl fmt::Display for FormatError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "no float format has {} exponent and {} fraction bits: use {}–{} exponent bits and {}–{} fraction bits",
            self.exponent_bits,
            self.fraction_bits,
            Format::EXPONENT_BITS.start(),
            Format::EXPONENT_BITS.end(),
            Format::FRACTION_BITS.start(),
            Format::FRACTION_BITS.end(),
        )
    }
}

impl std::error::Error for FormatError {}

impl Format {
    /// The range of a format's exponent bits.
    pub const EXPONENT_BITS: std::ops::RangeInclusive<u32> = 3..=10;
    /// The range of a format's fraction bits, limited so that double rounding through `f64` is exact.
    pub const FRACTION_BITS: std::ops::RangeInclusive<u32> = 2..=23;
    /// The reference format: one DSP48 multiplies its 17-bit significands.
    pub const FP24: Format = Format {
        exponent_bits: 7,
        fraction_bits: 16,
    };

    /// The format with the given numbers of bits.
    ///
    /// # Errors
    /// If either is outside its range.
    pub fn new(exponent_bits: u32, fraction_bits: u32) -> Result<Self, FormatError> {
        if Self::EXPONENT_BITS.contains(&exponent_bits)
            && Self::FRACTION_BITS.contains(&fraction_bits)
        {
            Ok(Format {
                exponent_bits,
                fraction_bits,
            })
        } else {
            Err(FormatError {
                exponent_bits,
                fraction_bits,
            })
        }
    }

    pub const fn exponent_bits(self) -> u32 {
        self.exponent_bits
    }

    pub const fn fraction_bits(self) -> u32 {
        self.fraction_bits
    }

    /// Width of a number in bits: sign, exponent and fraction.
    pub const fn width(self) -> u32 {
        1 + self.exponent_bits + self.fraction_bits
    }

    /// The value added to a number's exponent before it is stored.
    pub const fn bias(self) -> i32 {
        (1 << (self.exponent_bits - 1)) - 1
    }

    /// The stored exponent of infinities and the NaN: all ones.
    pub const fn exponent_mask(self) -> u64 {
        (1 << self.exponent_bits) - 1
    }

    pub const fn fraction_mask(self) -> u64 {
        (1 << self.fraction_bits) - 1
    }

    pub const fn sign_bit(self) -> u64 {
        1 << (self.width() - 1)
    }

    /// The bit pattern of +∞.
    pub const fn infinity(self) -> u64 {
        self.exponent_mask() << self.fraction_bits
    }

    /// The bit pattern of the one NaN: positive, with the greatest fraction bit set.
    pub const fn nan(self) -> u64 {
        self.infinity() | 1 << (self.fraction_bits - 1)
    }

    /// The bit pattern of the least positive number, 2^(1 − bias).
    pub const fn least_normal(self) -> u64 {
        1 << self.fraction_bits
    }

    /// The bit pattern of the greatest finite number.
    pub const fn greatest(self) -> u64 {
        self.infinity() - 1
    }

    /// The bit pattern of 1.
    pub const fn one(self) -> u64 {
        (self.bias() as u64) << self.fraction_bits
    }

    /// Whether a bit pattern is a NaN, canonical or not.
    pub const fn is_nan(self, bits: u64) -> bool {
        bits & !self.sign_bit() > self.infinity()
    }

    /// The value of a bit pattern, exactly. A pattern with the stored exponent 0 is a zero with
    /// its sign (there are no subnormals); every NaN pattern gives NaN.
    pub fn to_f64(self, bits: u64) -> f64 {
        let magnitude = bits & !self.sign_bit();
        let value = if magnitude > self.infinity() {
            return f64::NAN;
        } else if magnitude == self.infinity() {
            f64::INFINITY
        } else if magnitude < self.least_normal() {
            0.0
        } else {
            let exponent = (magnitude >> self.fraction_bits) as i64 - self.bias() as i64 + 1023;
            let fraction = (magnitude & self.fraction_mask()) << (52 - self.fraction_bits);
            f64::from_bits((exponent as u64) << 52 | fraction)
        };
        if bits & self.sign_bit() != 0 {
            -value
        } else {
            value
        }
    }

    /// The bit pattern of a value of the format, including −0; any NaN gives the canonical one.
    ///
    /// # Panics
    /// In debug builds, if `value` is not a value of the format: round it first ([`super::Arithmetic::round`]).
    pub fn to_bits(self, value: f64) -> u64 {
        if value.is_nan() {
            return self.nan();
        }
        let sign = if value.is_sign_negative() {
            self.sign_bit()
        } else {
            0
        };
        let magnitude = value.to_bits() & !(1 << 63);
        if magnitude == 0 {
            return sign;
        }
        if magnitude == f64::INFINITY.to_bits() {
            return sign | self.infinity();
        }
        let exponent = (magnitude >> 52) as i64 - 1023 + self.bias() as i64;
        let shift = 52 - self.fraction_bits;
        debug_assert!(
            exponent > 0 && exponent < self.exponent_mask() as i64,
            "{value:e} is outside the format"
        );
        debug_assert!(
            magnitude & ((1 << shift) - 1) == 0,
            "{value:e} has more fraction bits than the format"
        );
        sign | (exponent as u64) << self.fraction_bits | magnitude >> shift & self.fraction_mask()
    }

    /// Rounds an `f64` to a bit pattern (never that of −0).
    pub fn round_to_bits(self, value: f64) -> u64 {
        self.to_bits(super::Arithmetic::new(self).round(value))
    }

    /// Rounds an `f32` to a bit pattern (never that of −0).
    pub fn round_f32_to_bits(self, value: f32) -> u64 {
        self.round_to_bits(f64::from(value))
    }

    /// The nearest `f32` of a bit pattern; exact for all formats with at most 8 exponent bits.
    pub fn to_f32(self, bits: u64) -> f32 {
        self.to_f64(bits) as f32
    }
}

impl fmt::Display for Format {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "fp{}(1-{}-{})",
            self.width(),
            self.exponent_bits,
            self.fraction_bits
        )
    }
}
