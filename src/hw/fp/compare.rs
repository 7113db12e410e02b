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

/// Whether a number is neither an infinity nor a NaN.
pub fn is_finite<'b>(format: Format, a: Signal<'b>) -> Signal<'b> {
    !fields(format, a).exponent.all()
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
    name: Option<&str>,
    a: Operand<'b>,
    b: Operand<'b>,
    of_equals: bool,
) -> Signal<'b> {
    let part = |signal: Signal<'b>, what: &str| match name {
        Some(name) => signal.named(format!("{name}_{what}")),
        None => signal,
    };
    let m = a.signal.module();
    let (x, y) = (fields(format, a.signal), fields(format, b.signal));
    let positive = |operand: Operand<'b>| operand.known == Known::Positive;
    let unless_zero = match (positive(a), positive(b)) {
        (true, true) => x.magnitude.lt(y.magnitude),
        (true, false) => x.magnitude.lt(y.magnitude) & !y.sign,
        (false, true) => x.magnitude.lt(y.magnitude) | x.sign,
        (false, false) => {
            let magnitude_less = match of_equals {
                true => x.magnitude.concat(m.zero(1)).lt(y.magnitude.concat(y.sign)),
                false => x.magnitude.lt(y.magnitude),
            };
            (x.sign ^ y.sign).mux(x.sign, magnitude_less ^ x.sign)
        }
    };
    // Zeros of one pattern are in order as they are.
    if a.has_one_zero() && b.has_one_zero() {
        return unless_zero;
    }
    let both_zero = is_zero(format, a.signal) & is_zero(format, b.signal);
    part(unless_zero, "unless_zero") & !part(both_zero, "both_zero")
}

/// Whether neither is a NaN, so far as it is not known; `None` where it is.
fn ordered<'b>(format: Format, operands: &[Operand<'b>]) -> Option<Signal<'b>> {
    let nans = operands.iter().filter_map(|o| o.may_be_nan(format));
    nans.reduce(|a, b| a | b).map(|nan| !nan)
}

/// The operands of a < b or a ≤ b whose NaN makes it false only by being looked for: an operator's on the left is greater than any number.
fn to_order<'b>(a: Operand<'b>, b: Operand<'b>) -> Vec<Operand<'b>> {
    match a.known {
        Known::Result => vec![b],
        _ => vec![a, b],
    }
}

/// a < b: −0 = +0, false with a NaN. 1 bit.
pub fn less<'b>(
    format: Format,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (a, b) = (a.into(), b.into());
    let less = less_ordered(format, None, a, b, true);
    ordered(format, &to_order(a, b)).map_or(less, |ordered| less & ordered)
}

/// [`less`] for a choice between `a` and `b`: where their patterns are the same it may say either. It and its parts are called after
/// `name` in the Verilog.
pub fn goes_before<'b>(
    format: Format,
    name: &str,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (a, b) = (a.into(), b.into());
    // Zeros of several patterns are equal, but not the same.
    let of_equals = !(a.has_one_zero() && b.has_one_zero());
    let less = less_ordered(format, Some(name), a, b, of_equals);
    let ordered = ordered(format, &to_order(a, b));
    let less = ordered.map_or(less, |o| less & o.named(format!("{name}_ordered")));
    less.named(name)
}

/// a ≤ b: −0 = +0, false with a NaN. 1 bit.
pub fn less_equal<'b>(
    format: Format,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (a, b) = (a.into(), b.into());
    let less_equal = !less_ordered(format, None, b, a, true);
    ordered(format, &to_order(a, b)).map_or(less_equal, |ordered| less_equal & ordered)
}

/// a = b: −0 = +0, false with a NaN. 1 bit.
pub fn equal<'b>(
    format: Format,
    a: impl Into<Operand<'b>>,
    b: impl Into<Operand<'b>>,
) -> Signal<'b> {
    let (a, b) = (a.into(), b.into());
    let same = a.signal.eq(b.signal);
    let one_zero = a.has_one_zero() && b.has_one_zero();
    let equal = match one_zero {
        true => same,
        false => same | (is_zero(format, a.signal) & is_zero(format, b.signal)),
    };
    // Of a pattern that is no NaN's, the same is none either.
    let nan = match [a, b].map(|o| o.may_be_nan(format)) {
        [Some(_), Some(_)] => ordered(format, &[a, b]),
        _ => None,
    };
    nan.map_or(equal, |ordered| equal & ordered)
}
