//! Comparison and choice: combinational, built into the caller's module.

use super::fields::fields;
use crate::float::Format;
use crate::hdl::Signal;

/// Whether a number is a NaN, of whatever pattern.
pub fn is_nan<'b>(format: Format, number: Signal<'b>) -> Signal<'b> {
    let a = fields(format, number);
    (a.exponent.all() & a.fraction.any()).hinted_after(number, "is_nan")
}

/// Whether a number is a zero of either sign: whether its stored exponent is 0.
pub fn is_zero<'b>(format: Format, number: Signal<'b>) -> Signal<'b> {
    let a = fields(format, number);
    a.exponent.is_zero().hinted_after(number, "is_zero")
}

/// Whether a number is neither an infinity nor a NaN.
pub fn is_finite<'b>(format: Format, number: Signal<'b>) -> Signal<'b> {
    let a = fields(format, number);
    (!a.exponent.all()).hinted_after(number, "is_finite")
}

/// What is known of an operand's pattern.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Known {
    Nothing,
    /// No NaN; or the comparison does not matter where it is one.
    NoNan,
    /// As operators give it: no other pattern of zero than +0, none of NaN than theirs, which is positive and greater than any number.
    Result,
    /// As operators give it, and no NaN.
    Number,
    /// And not negative.
    Positive,
}

/// An operand of a comparison: a signal, and what its user vouches for. A comparison has no logic for what cannot be.
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

/// To say what is known of a signal.
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

    /// Whether zero has one pattern.
    fn has_one_zero(self) -> bool {
        !matches!(self.known, Known::Nothing | Known::NoNan)
    }
}

/// a < b for numbers that are not NaN, and false where a is an operator's NaN and b a number.
///
/// With equal signs one carry chain decides: negative numbers are in order where their magnitudes are not, so the
/// sign, as one bit more of `b`, turns "less" into "less or equal", and then inverts it.
///
/// `name` is what its parts are called after in the Verilog.
///
/// Where `of_equals` is false it says anything of equal patterns, and needs no bit more.
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
    // Zeros of one pattern are in order as they are.
    if a.has_one_zero() && b.has_one_zero() {
        return unless_zero;
    }
    let both_zero = is_zero(format, a.signal) & is_zero(format, b.signal);
    part(unless_zero, "unless_zero") & !part(both_zero, "both_zero")
}

/// What a comparison says where no operand is a NaN, so far as that is not known; else false.
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

/// The operands of a < b or a ≤ b whose NaN makes it false only by being looked for: an operator's on the left is greater than any number.
fn to_order<'b>(a: Operand<'b>, b: Operand<'b>) -> Vec<Operand<'b>> {
    match a.known {
        Known::Result => vec![b],
        _ => vec![a, b],
    }
}

/// a < b: −0 = +0, false with a NaN. 1 bit. This and what it is made of are called after `name` where they get names in the Verilog.
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

/// [`less`] for a choice between `a` and `b`: where their patterns are the same it may say either. It is called `name` in the Verilog.
pub fn goes_before<'b>(
    format: Format,
    name: &str,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (a, b) = (a.into(), b.into());
    // Zeros of several patterns are equal, but not the same.
    let of_equals = !(a.has_one_zero() && b.has_one_zero());
    let less = less_ordered(format, name, a, b, of_equals);
    unless_nan(format, name, less, &to_order(a, b)).named(name)
}

/// a ≤ b: −0 = +0, false with a NaN. 1 bit. Called as [`less`].
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

/// a = b: −0 = +0, false with a NaN. 1 bit. Called as [`less`].
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
    // Of a pattern that is no NaN's, the same is none either.
    match [a, b].map(|o| o.may_be_nan(format)) {
        [Some(_), Some(_)] => unless_nan(format, name, equal, &[a, b]).hinted(name),
        _ => equal.hinted(name),
    }
}
