//! Comparison and choice: combinational, built into the caller's module.

use super::fields::fields;
use crate::float::Format;
use crate::hdl::Signal;

/// Whether a number is a NaN, of whatever pattern.
pub fn is_nan<'b>(format: Format, a: Signal<'b>) -> Signal<'b> {
    let a = fields(format, a);
    a.exponent.all() & a.fraction.any()
}

/// Whether a number is a zero of either sign: whether its stored exponent is 0.
pub fn is_zero<'b>(format: Format, a: Signal<'b>) -> Signal<'b> {
    fields(format, a).exponent.is_zero()
}

/// Whether a number is an infinity of either sign.
pub fn is_infinite<'b>(format: Format, a: Signal<'b>) -> Signal<'b> {
    let a = fields(format, a);
    a.exponent.all() & a.fraction.is_zero()
}

/// a < b for numbers that are not NaN.
///
/// With equal signs one carry chain decides: negative numbers are in order where their magnitudes are not, so the
/// sign, as one bit more of `b`, turns "less" into "less or equal", and then inverts it.
fn less_ordered<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    let both_zero = is_zero(format, a) & is_zero(format, b);
    let m = a.module();
    let (a, b) = (fields(format, a), fields(format, b));
    let magnitude_less = a.magnitude.concat(m.zero(1)).lt(b.magnitude.concat(b.sign));
    (a.sign ^ b.sign).mux(a.sign, magnitude_less ^ a.sign) & !both_zero
}

fn ordered<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    !(is_nan(format, a) | is_nan(format, b))
}

/// a < b: −0 = +0, false with a NaN. 1 bit.
pub fn less<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    less_ordered(format, a, b) & ordered(format, a, b)
}

/// a ≤ b: −0 = +0, false with a NaN. 1 bit.
pub fn less_equal<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    !less_ordered(format, b, a) & ordered(format, a, b)
}

/// a = b: −0 = +0, false with a NaN. 1 bit.
pub fn equal<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    let both_zero = is_zero(format, a) & is_zero(format, b);
    (a.eq(b) | both_zero) & !is_nan(format, a) & !is_nan(format, b)
}

/// `x` where it is less than `bound`, else `bound`, its pattern unchanged: a NaN never replaces a bound.
pub fn min<'b>(format: Format, bound: Signal<'b>, x: Signal<'b>) -> Signal<'b> {
    less(format, x, bound).mux(x, bound)
}

/// `x` where it is greater than `bound`, else `bound`, its pattern unchanged: a NaN never replaces a bound.
pub fn max<'b>(format: Format, bound: Signal<'b>, x: Signal<'b>) -> Signal<'b> {
    less(format, bound, x).mux(x, bound)
}
