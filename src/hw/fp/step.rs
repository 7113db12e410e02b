//! Steps by ulps: combinational logic in the caller's module.

use super::fields::fields;
use crate::float::Format;
use crate::hdl::{Signal, bits_for};

/// The number `ulps` steps above `a` (below if negative). −0 and +0 are one value, whose neighbours are ± the least normal number;
/// a resulting zero is +0. The successor of the greatest number is infinity. Infinities and NaNs keep their patterns.
///
/// The cost is an adder of the format's width and one or two LUTs per bit. `after_sum` may add a register after the adder.
///
/// # Panics
/// If `ulps` is 0 or exceeds the count of numbers between two powers of two.
pub fn step<'b>(
    format: Format,
    a: Signal<'b>,
    ulps: i32,
    after_sum: impl Fn(Signal<'b>) -> Signal<'b>,
) -> Signal<'b> {
    let up = a.module().lit(u8::from(ulps > 0), 1);
    step_up_or_down(format, a, up, ulps.unsigned_abs().into(), after_sum)
}

/// The same by `count` ulps, upwards if `up` is 1, else downwards.
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
    // The names of the parts in the Verilog.
    let called = |signal: Signal<'b>, what: &str| signal.hinted_after(a, what);
    let fields_of_a = fields(format, a);
    let sign = fields_of_a.sign;

    // The magnitude is an integer: it grows by `count` in steps away from zero, and shrinks in steps towards zero.
    let outwards = called(sign ^ up, "outwards");
    let (up_by, down_by) = (count, (1 << (e + f)) - count);
    let steps = m.constant("STEPS", up_by, e + f);
    let minus_steps = m.constant("MINUS_STEPS", down_by, e + f);
    let change = outwards.mux(steps, minus_steps);
    let moved = called(fields_of_a.magnitude + change, "moved");
    let moved = after_sum(moved);
    let (moved_exponent, moved_fraction) =
        (moved.part("exponent", f, e), moved.part("fraction", 0, f));

    // The steps below the least normal number lead to zero, then to the numbers of the other sign in increasing magnitude: the
    // complement of the fraction is the number of steps beyond zero.
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
