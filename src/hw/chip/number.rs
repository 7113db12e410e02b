//! Conversion of binary32 numbers to the machine's format.

use crate::float::Format;
use crate::hdl::{Builder, HdlError, Module};
use std::sync::Arc;

/// Fraction bits, exponent bias and greatest exponent of binary32.
const FRACTION: u32 = 23;
const BIAS: i32 = 127;
const GREATEST: i32 = 255;

/// Describes a combinational module that converts a binary32 number to a format: see *Rays and hits* in `docs/chip.md`.
///
/// # Errors
/// A mistake in the description; none is known for any format.
pub fn module(format: Format) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "number_from_binary32",
        "converts a binary32 number to the machine's format: rounded to nearest, ties to even; a zero keeps its sign.",
    );
    m.group("Binary32");
    let word = m.input("word", 32);
    let (sign, exponent) = (word.bit(31), word.bits(30, FRACTION).named("exponent"));
    let fraction = word.low(FRACTION);

    m.comment("A carry out of the fraction increments the exponent.");
    let dropped = FRACTION - format.fraction_bits();
    let kept = word.bits(30, dropped).named("kept");
    let rounded = match dropped {
        0 => kept,
        _ => {
            let half = word.bit(dropped - 1);
            let below = match dropped {
                1 => m.zero(1),
                _ => word.low(dropped - 1).any().named("below_half"),
            };
            let odd = word.bit(dropped);
            let up = (half & (below | odd)).named("round_up");
            kept + up.extend(kept.width())
        }
    }
    .named("rounded");
    let scale = rounded.high(8).named("rounded_exponent");

    let bias = format.bias();
    let special = exponent.all().named("is_special");
    let is_nan = (special & fraction.any()).named("is_nan");
    let subnormal = exponent.is_zero();
    // The rounded exponents of the least and of the first too large magnitude.
    let (least, too_large) = (BIAS + 1 - bias, BIAS - bias + format.exponent_mask() as i32);
    let small = match least {
        ..=1 => subnormal,
        least => scale.lt(m.lit(least as u32, 8)),
    }
    .named("too_small");
    let large = match too_large {
        ..=GREATEST => scale.ge(m.lit(too_large as u32, 8)) | special,
        _ => special,
    }
    .named("too_large");

    let bits = format.exponent_bits();
    let offset = (bias - BIAS).rem_euclid(1 << bits) as u32;
    let scale = match bits {
        ..8 => scale.low(bits),
        _ => scale.extend(bits),
    };
    let normal = m.concat(&[
        (scale + m.lit(offset, bits)).named("new_exponent"),
        rounded.low(format.fraction_bits()),
    ]);
    let magnitude_bits = format.width() - 1;
    let magnitude = m.priority(
        &[
            (
                large,
                m.constant("INFINITY", format.infinity(), magnitude_bits),
            ),
            (small, m.zero(magnitude_bits)),
        ],
        normal,
    );
    let nan = m.constant("NAN", format.nan(), format.width());
    m.group("The machine's format");
    m.output("number", is_nan.mux(nan, sign.concat(magnitude)));
    m.finish()
}
