//! Stepping by ulps: combinational, built into the caller's module.

use super::fields::fields;
use crate::float::Format;
use crate::hdl::{Signal, bits_for};

/// The number `ulps` steps above `a` (below, where negative), a zero's pattern being +0. −0 and +0 are one
/// value whose neighbours are ± the least normal number; past the greatest is infinity; infinities and NaNs do not
/// step, their patterns stay.
///
/// Costs an adder of the format's width and a LUT or two for each bit. `after_sum` may put a register behind the adder.
///
/// # Panics
/// Where `ulps` is 0, or steps over more numbers than there are between two powers of two.
pub fn step<'b>(
    format: Format,
    a: Signal<'b>,
    ulps: i32,
    after_sum: impl Fn(Signal<'b>) -> Signal<'b>,
) -> Signal<'b> {
    let up = a.module().lit(u8::from(ulps > 0), 1);
    step_up_or_down(format, a, up, ulps.unsigned_abs().into(), after_sum)
}

/// The same by `count` ulps, up where `up` is 1, else down.
pub(in super::super) fn step_up_or_down<'b>(
    format: Format,
    a: Signal<'b>,
    up: Signal<'b>,
    count: u64,
    after_sum: impl Fn(Signal<'b>) -> Signal<'b>,
) -> Signal<'b> {
    let m = a.module();
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    assert!(
        (1..=1 << f).contains(&count),
        "cannot step by {count} ulps in {format}"
    );
    // What the parts are called in the Verilog.
    let called = |signal: Signal<'b>, what: &str| signal.hinted_after(a, what);
    let fields_of_a = fields(format, a);
    let sign = fields_of_a.sign;

    // Away from zero the magnitude, an integer, grows by `count`; towards zero it shrinks.
    let outwards = called(sign ^ up, "outwards");
    let (up_by, down_by) = (count, (1 << (e + f)) - count);
    let steps = m.constant("STEPS", up_by, e + f);
    let minus_steps = m.constant("MINUS_STEPS", down_by, e + f);
    let change = outwards.mux(steps, minus_steps);
    let moved = called(fields_of_a.magnitude + change, "moved");
    let moved = after_sum(moved);
    let (moved_exponent, moved_fraction) =
        (moved.part("exponent", f, e), moved.part("fraction", 0, f));

    // Below the least normal number the integers that follow are zero, then the numbers of the other sign from
    // their least on: the complement of the fraction counts how many steps beyond zero it went.
    let is_number = called(fields_of_a.exponent.any(), "is_not_zero");
    let from_zero = called(!is_number, "is_zero");
    let inwards = called(!outwards, "inwards");
    let into_zero = called(inwards & moved_exponent.is_zero(), "steps_into_zero");
    let about_zero = called(from_zero | into_zero, "about_zero");
    let low = bits_for(count);
    let beyond = called(!moved_fraction.low(low), "steps_beyond_zero");
    let to_zero = called(!from_zero & beyond.is_zero(), "steps_to_zero");
    let near_fraction = to_zero.mux(
        m.zero(low),
        from_zero.mux(m.lit(count - 1, low), beyond - m.lit(1u8, low)),
    );
    let near_fraction = called(near_fraction, "fraction_about_zero");
    let near_zero = m.concat(&[
        !(up | to_zero),
        (!to_zero).extend(e),
        near_fraction.extend(f),
    ]);
    let near_zero = called(near_zero, "stepped_about_zero");

    let overflow = called(moved_exponent.all(), "overflows");
    let further = m.concat(&[sign, moved_exponent, moved_fraction & (!overflow).repeat(f)]);
    let further = called(further, "stepped_further");
    let special = called(fields_of_a.exponent.all(), "is_special");
    let number = called(about_zero.mux(near_zero, further), "stepped_number");
    called(special.mux(a, number), "stepped")
}
