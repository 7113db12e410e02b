//! Comparisons: combinational logic in the caller's module.

use super::fields::fields;
use crate::float::Format;
use crate::hdl::Signal;

/// Whether a number is a NaN, with any bit pattern.
pub fn is_nan<'b>(format: Format, number: Signal<'b>) -> Signal<'b> {
    let a = fields(format, number);
    (a.exponent.all() & a.fraction.any()).hinted_after(number, "is_nan")
}

/// Whether a number is a zero of either sign, that is, whether its stored exponent is 0.
pub fn is_zero<'b>(format: Format, number: Signal<'b>) -> Signal<'b> {
    let a = fields(format, number);
    a.exponent.is_zero().hinted_after(number, "is_zero")
}

/// Whether a number is neither an infinity nor a NaN.
pub fn is_finite<'b>(format: Format, number: Signal<'b>) -> Signal<'b> {
    let a = fields(format, number);
    (!a.exponent.all()).hinted_after(number, "is_finite")
}

/// Known facts about the bit pattern of an operand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Known {
    Nothing,
    /// It is not a NaN, or the result of the comparison is not used if it is.
    NoNan,
    /// It is the result of an operator: the only pattern of a zero is +0, and the only pattern of a NaN is the canonical one, which is positive and greater than any number.
    Result,
    /// It is the result of an operator and not a NaN.
    Number,
    /// It is the result of an operator, not a NaN and not negative.
    Positive,
}

/// An operand of a comparison: a signal, and facts that the caller guarantees. A comparison has no logic for cases that these exclude.
#[derive(Clone, Copy)]
pub struct Operand<'b> {
    signal: Signal<'b>,
    known: Known,
}

impl<'b> From<Signal<'b>> for Operand<'b> {
    fn from(signal: Signal<'b>) -> Operand<'b> {
        signal.known(Known::Nothing)
    }
}

/// Attaches known facts to a signal.
pub trait Knowing<'b> {
    fn known(self, known: Known) -> Operand<'b>;
}

impl<'b> Knowing<'b> for Signal<'b> {
    fn known(self, known: Known) -> Operand<'b> {
        Operand {
            signal: self,
            known,
        }
    }
}

impl<'b> Operand<'b> {
    pub fn signal(self) -> Signal<'b> {
        self.signal
    }

    fn may_be_nan(self, format: Format) -> Option<Signal<'b>> {
        matches!(self.known, Known::Nothing | Known::Result).then(|| is_nan(format, self.signal))
    }

    /// Whether zero has only one bit pattern.
    fn has_one_zero(self) -> bool {
        !matches!(self.known, Known::Nothing | Known::NoNan)
    }
}

/// a < b for numbers that are not NaN; false if a is an operator's NaN and b a number.
///
/// With equal signs one carry chain decides. The order of negative numbers is the inverse order of their magnitudes, so the
/// sign, as an additional bit of `b`, turns "less" into "less or equal", and then inverts it.
///
/// `name` is the prefix of the names of its parts in the Verilog.
///
/// If `of_equals` is false, the result for equal patterns is undefined and the additional bit is omitted.
fn less_ordered<'b>(
    format: Format,
    name: &str,
    a: Operand<'b>,
    b: Operand<'b>,
    of_equals: bool,
) -> Signal<'b> {
    let part = |signal: Signal<'b>, what: &str| signal.hinted(format!("{name}_{what}"));
    let m = a.signal.module();
    let (x, y) = (fields(format, a.signal), fields(format, b.signal));
    let magnitude_less = |x, y| part(Signal::lt(x, y), "by_magnitude");
    let positive = |operand: Operand<'b>| operand.known == Known::Positive;
    let unless_zero = match (positive(a), positive(b)) {
        (true, true) => magnitude_less(x.magnitude, y.magnitude),
        (true, false) => {
            let y_positive = (!y.sign).hinted_after(b.signal, "is_positive");
            magnitude_less(x.magnitude, y.magnitude) & y_positive
        }
        (false, true) => magnitude_less(x.magnitude, y.magnitude) | x.sign,
        (false, false) => {
            let magnitude_less = match of_equals {
                true => {
                    let twice = x.magnitude.concat(m.zero(1));
                    let and_sign = y.magnitude.concat(y.sign);
                    magnitude_less(
                        twice.hinted_after(a.signal, "magnitude_twice"),
                        and_sign.hinted_after(b.signal, "magnitude_and_sign"),
                    )
                }
                false => magnitude_less(x.magnitude, y.magnitude),
            };
            let signs_differ = part(x.sign ^ y.sign, "signs_differ");
            let by_sign = part(magnitude_less ^ x.sign, "by_sign");
            signs_differ.mux(x.sign, by_sign)
        }
    };
    // Zeros with only one pattern need no special case.
    if a.has_one_zero() && b.has_one_zero() {
        return unless_zero;
    }
    let both_zero = is_zero(format, a.signal) & is_zero(format, b.signal);
    part(unless_zero, "unless_zero") & !part(both_zero, "both_zero")
}

/// The result of a comparison if no operand is a NaN, else false. Operands that are known not to be NaN need no check.
fn unless_nan<'b>(
    format: Format,
    name: &str,
    says: Signal<'b>,
    operands: &[Operand<'b>],
) -> Signal<'b> {
    let nans = operands.iter().filter_map(|o| o.may_be_nan(format));
    let any_nan = nans.reduce(|a, b| (a | b).hinted(format!("{name}_any_nan")));
    any_nan.map_or(says, |any_nan| {
        let ordered = (!any_nan).hinted(format!("{name}_ordered"));
        says.hinted(format!("{name}_unless_nan")) & ordered
    })
}

/// The operands of a < b or a ≤ b that need a check for NaN. An operator's NaN on the left needs none, since it is greater than any number.
fn to_order<'b>(a: Operand<'b>, b: Operand<'b>) -> Vec<Operand<'b>> {
    match a.known {
        Known::Result => vec![b],
        _ => vec![a, b],
    }
}

/// a < b, 1 bit: −0 = +0, false if an operand is a NaN. The names in the Verilog begin with `name`.
pub fn less<'b>(
    format: Format,
    name: impl AsRef<str>,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (name, a, b) = (name.as_ref(), a.into(), b.into());
    let less = less_ordered(format, name, a, b, true);
    unless_nan(format, name, less, &to_order(a, b)).hinted(name)
}

/// [`less`] for a selection of `a` or `b`: the result is undefined for equal patterns. It is called `name` in the Verilog.
pub fn goes_before<'b>(
    format: Format,
    name: &str,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (a, b) = (a.into(), b.into());
    // Zeros with different patterns are equal numbers.
    let of_equals = !(a.has_one_zero() && b.has_one_zero());
    let less = less_ordered(format, name, a, b, of_equals);
    unless_nan(format, name, less, &to_order(a, b)).named(name)
}

/// a ≤ b, 1 bit: −0 = +0, false if an operand is a NaN. It is named as [`less`].
pub fn less_equal<'b>(
    format: Format,
    name: impl AsRef<str>,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (name, a, b) = (name.as_ref(), a.into(), b.into());
    let not = format!("{name}_not");
    let less_equal = !less_ordered(format, &not, b, a, true).hinted(not);
    unless_nan(format, name, less_equal, &to_order(a, b)).hinted(name)
}

/// a = b, 1 bit: −0 = +0, false if an operand is a NaN. It is named as [`less`].
pub fn equal<'b>(
    format: Format,
    name: impl AsRef<str>,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (name, a, b) = (name.as_ref(), a.into(), b.into());
    let part = |signal: Signal<'b>, what: &str| signal.hinted(format!("{name}_{what}"));
    let same = part(a.signal.eq(b.signal), "pattern");
    let one_zero = a.has_one_zero() && b.has_one_zero();
    let equal = match one_zero {
        true => same,
        false => {
            let both = is_zero(format, a.signal) & is_zero(format, b.signal);
            part(same | part(both, "both_zero"), "unless_nan")
        }
    };
    // If one of two equal patterns is not a NaN, neither is the other.
    match [a, b].map(|o| o.may_be_nan(format)) {
        [Some(_), Some(_)] => unless_nan(format, name, equal, &[a, b]).hinted(name),
        _ => equal.hinted(name),
    }
}
