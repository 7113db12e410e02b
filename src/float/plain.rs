//! The definition of the arithmetic, with integers on bit patterns. The code is written to be read, not to be
//! fast.
//!
//! Every function accepts any bit pattern of the format, right-aligned: a stored exponent of 0 is a
//! zero with its sign, whatever its fraction, and every NaN pattern is the one NaN. Every returned pattern
//! is canonical ([`canonical`]). Arithmetic never returns −0; [`min`] and [`max`] return it if they choose it.

use super::Format;

/// The meaning of a bit pattern.
#[derive(Clone, Copy)]
enum Number {
    Nan,
    Infinity {
        negative: bool,
    },
    /// ± `significand` · 2^`exponent`: a zero, or a significand of exactly `fraction_bits` + 1 bits.
    Finite {
        negative: bool,
        significand: u128,
        exponent: i32,
    },
}

use Number::{Finite, Infinity, Nan};

impl Number {
    fn of(format: Format, bits: u64) -> Number {
        let negative = bits & format.sign_bit() != 0;
        let stored_exponent = bits >> format.fraction_bits() & format.exponent_mask();
        let fraction = bits & format.fraction_mask();
        if stored_exponent == format.exponent_mask() {
            return if fraction == 0 {
                Infinity { negative }
            } else {
                Nan
            };
        }
        let significand = if stored_exponent == 0 {
            0
        } else {
            1 << format.fraction_bits() | fraction
        };
        Finite {
            negative,
            significand: significand.into(),
            exponent: stored_exponent as i32 - format.bias() - format.fraction_bits() as i32,
        }
    }
}

fn signed(format: Format, negative: bool, magnitude: u64) -> u64 {
    if negative {
        format.sign_bit() | magnitude
    } else {
        magnitude
    }
}

/// The canonical pattern with the meaning of `bits`: fraction 0 if the stored exponent is 0, and the
/// canonical NaN for any NaN. Zeros keep their signs.
pub fn canonical(format: Format, bits: u64) -> u64 {
    match Number::of(format, bits) {
        Nan => format.nan(),
        Finite {
            negative,
            significand: 0,
            ..
        } => signed(format, negative, 0),
        _ => bits,
    }
}

/// Rounds ± `significand` · 2^`exponent` to nearest even with an unbounded exponent. Results below
/// the least normal number then become zero, and results above the greatest become infinity. A zero is always +0.
fn round(format: Format, negative: bool, significand: u128, exponent: i32) -> u64 {
    if significand == 0 {
        return 0;
    }
    let precision = format.fraction_bits() + 1;
    let length = u128::BITS - significand.leading_zeros();
    let (mut rounded, mut exponent) = if length <= precision {
        let missing = precision - length;
        (significand << missing, exponent - missing as i32)
    } else {
        let excess = length - precision;
        let kept = significand >> excess;
        let dropped = significand - (kept << excess);
        let half = 1 << (excess - 1);
        let up = dropped > half || dropped == half && kept & 1 == 1;
        (kept + u128::from(up), exponent + excess as i32)
    };
    if rounded == 1 << precision {
        rounded >>= 1;
        exponent += 1;
    }
    let stored_exponent = exponent + format.fraction_bits() as i32 + format.bias();
    if stored_exponent < 1 {
        0
    } else if stored_exponent >= format.exponent_mask() as i32 {
        signed(format, negative, format.infinity())
    } else {
        let fraction = rounded as u64 & format.fraction_mask();
        let magnitude = (stored_exponent as u64) << format.fraction_bits() | fraction;
        signed(format, negative, magnitude)
    }
}

/// a + b.
pub fn add(format: Format, a: u64, b: u64) -> u64 {
    match (Number::of(format, a), Number::of(format, b)) {
        (Nan, _) | (_, Nan) => format.nan(),
        (Infinity { negative: a }, Infinity { negative: b }) if a != b => format.nan(),
        (Infinity { negative }, _) | (_, Infinity { negative }) => {
            signed(format, negative, format.infinity())
        }
        (
            Finite {
                negative: a_negative,
                significand: a,
                exponent: a_exponent,
            },
            Finite {
                negative: b_negative,
                significand: b,
                exponent: b_exponent,
            },
        ) => {
            // With 64 bits below the significands of at most 24 bits, an operand loses bits only if it is
            // less than 2^−40 ulps of the other: too little to affect the rounding.
            const GUARD: u32 = 64;
            let exponent = a_exponent.max(b_exponent);
            let align = |significand: u128, own: i32| {
                let distance = (exponent - own) as u32;
                (significand << GUARD).checked_shr(distance).unwrap_or(0) as i128
            };
            let sign = |negative| if negative { -1 } else { 1 };
            let sum =
                sign(a_negative) * align(a, a_exponent) + sign(b_negative) * align(b, b_exponent);
            round(format, sum < 0, sum.unsigned_abs(), exponent - GUARD as i32)
        }
    }
}

/// a − b.
pub fn sub(format: Format, a: u64, b: u64) -> u64 {
    add(format, a, b ^ format.sign_bit())
}

/// a · b; 0 · ∞ is NaN.
pub fn mul(format: Format, a: u64, b: u64) -> u64 {
    let negative = (a ^ b) & format.sign_bit() != 0;
    match (Number::of(format, a), Number::of(format, b)) {
        (Nan, _) | (_, Nan) => format.nan(),
        (Infinity { .. }, Finite { significand: 0, .. })
        | (Finite { significand: 0, .. }, Infinity { .. }) => format.nan(),
        (Infinity { .. }, _) | (_, Infinity { .. }) => signed(format, negative, format.infinity()),
        (
            Finite {
                significand: a,
                exponent: a_exponent,
                ..
            },
            Finite {
                significand: b,
                exponent: b_exponent,
                ..
            },
        ) => round(format, negative, a * b, a_exponent + b_exponent),
    }
}

/// 1 ÷ a, correctly rounded: ±0 gives ±∞, ±∞ gives +0.
pub fn reciprocal(format: Format, a: u64) -> u64 {
    match Number::of(format, a) {
        Nan => format.nan(),
        Infinity { .. } => 0,
        Finite {
            negative,
            significand: 0,
            ..
        } => signed(format, negative, format.infinity()),
        Finite {
            negative,
            significand,
            exponent,
        } => {
            // A quotient of at least 40 bits; its lowest bit is set if there is a remainder.
            const SCALE: u32 = 64;
            let one = 1_u128 << SCALE;
            let quotient = (one / significand) | u128::from(!one.is_multiple_of(significand));
            round(format, negative, quotient, -exponent - SCALE as i32)
        }
    }
}

/// The position of a number in the order of the format's numbers: both zeros are 0,
/// the least normal number is 1, and +∞ is one above the greatest number. NaN has no position.
fn position(format: Format, bits: u64) -> Option<i64> {
    let magnitude = bits & !format.sign_bit();
    let distance = match Number::of(format, bits) {
        Nan => return None,
        Finite { significand: 0, .. } => 0,
        _ => (magnitude - format.least_normal() + 1) as i64,
    };
    Some(if bits == magnitude {
        distance
    } else {
        -distance
    })
}

/// The pattern at a [`position`], +0 for zero. Positions beyond the infinities give infinities.
fn at_position(format: Format, position: i64) -> u64 {
    if position == 0 {
        return 0;
    }
    let magnitude = (position.unsigned_abs() + format.least_normal() - 1).min(format.infinity());
    signed(format, position < 0, magnitude)
}

/// a < b; false with a NaN, and −0 = +0.
pub fn less(format: Format, a: u64, b: u64) -> bool {
    matches!((position(format, a), position(format, b)), (Some(a), Some(b)) if a < b)
}

/// a ≤ b; false with a NaN, and −0 = +0.
pub fn less_equal(format: Format, a: u64, b: u64) -> bool {
    matches!((position(format, a), position(format, b)), (Some(a), Some(b)) if a <= b)
}

/// a = b; false with a NaN, and −0 = +0.
pub fn equal(format: Format, a: u64, b: u64) -> bool {
    matches!((position(format, a), position(format, b)), (Some(a), Some(b)) if a == b)
}

/// `candidate` if it is less than `bound`, otherwise `bound`: a NaN never replaces a bound.
pub fn min(format: Format, bound: u64, candidate: u64) -> u64 {
    let replaced = less(format, candidate, bound);
    canonical(format, if replaced { candidate } else { bound })
}

/// `candidate` if it is greater than `bound`, otherwise `bound`: a NaN never replaces a bound.
pub fn max(format: Format, bound: u64, candidate: u64) -> u64 {
    let replaced = less(format, bound, candidate);
    canonical(format, if replaced { candidate } else { bound })
}

/// The number `ulps` steps above `value`, or below it if negative. −0 and +0 are one value whose
/// neighbours are ± the least normal number. Beyond the greatest number is ∞; ±∞ and NaN do not change. Never −0.
pub fn step(format: Format, value: u64, ulps: i32) -> u64 {
    match (Number::of(format, value), position(format, value)) {
        (Finite { .. }, Some(position)) => at_position(format, position + i64::from(ulps)),
        _ => canonical(format, value),
    }
}
