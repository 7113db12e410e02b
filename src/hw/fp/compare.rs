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
///
/// `name` is what its parts are called after in the Verilog.
fn less_ordered<'b>(
    format: Format,
    name: Option<&str>,
    a: Signal<'b>,
    b: Signal<'b>,
) -> Signal<'b> {
    let both_zero = is_zero(format, a) & is_zero(format, b);
    let m = a.module();
    let (a, b) = (fields(format, a), fields(format, b));
    let magnitude_less = a.magnitude.concat(m.zero(1)).lt(b.magnitude.concat(b.sign));
    let unless_zero = (a.sign ^ b.sign).mux(a.sign, magnitude_less ^ a.sign);
    if let Some(name) = name {
        both_zero.named(format!("{name}_both_zero"));
        unless_zero.named(format!("{name}_unless_zero"));
    }
    unless_zero & !both_zero
}

fn ordered<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    !(is_nan(format, a) | is_nan(format, b))
}

/// a < b: −0 = +0, false with a NaN. 1 bit.
pub fn less<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    less_ordered(format, None, a, b) & ordered(format, a, b)
}

/// a ≤ b: −0 = +0, false with a NaN. 1 bit.
pub fn less_equal<'b>(format: Format, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    !less_ordered(format, None, b, a) & ordered(format, a, b)
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

/// [`less`], it and its parts called after `name` in the Verilog.
fn named_less<'b>(format: Format, name: String, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    let ordered = ordered(format, a, b).named(format!("{name}_ordered"));
    (less_ordered(format, Some(&name), a, b) & ordered).named(name)
}

/// [`min`], called `name` in the Verilog, and what decides it after that.
pub fn named_min<'b>(
    format: Format,
    name: impl AsRef<str>,
    bound: Signal<'b>,
    x: Signal<'b>,
) -> Signal<'b> {
    let name = name.as_ref();
    named_less(format, format!("{name}_is_less"), x, bound)
        .mux(x, bound)
        .named(name)
}

/// [`max`], called `name` in the Verilog, and what decides it after that.
pub fn named_max<'b>(
    format: Format,
    name: impl AsRef<str>,
    bound: Signal<'b>,
    x: Signal<'b>,
) -> Signal<'b> {
    let name = name.as_ref();
    named_less(format, format!("{name}_is_greater"), bound, x)
        .mux(x, bound)
        .named(name)
}
