//! The reciprocal, by non-restoring division, a bit of the quotient at a time.
//!
//! For a significand x in [1, 2), 2 ÷ x lies in (1, 2]. Starting from the quotient 2 with the remainder
//! 2 − 2x, every digit doubles the remainder and adds x where it is negative, else subtracts it; the quotient's bits
//! are the signs of the remainders that follow. There is no tie to break and no sticky bit: 2 ÷ x is never half way
//! between two numbers, so one bit beyond the fraction rounds it. For x = 1 all bits are ones, the rounding carries all
//! the way, and the result is exact.

use super::fields::{Special, fields, pack};
use super::schedule::{FAN_OUT, LOGIC, Schedule, Step, chain};
use crate::float::{Format, plain};
use crate::hdl::{Builder, HdlError, Module};
use std::rc::Rc;

fn schedule(format: Format, clock_mhz: u32) -> Schedule {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let mut steps: Vec<Step> = (1..=f + 1)
        .map(|digit| Step::new(format!("digit {digit}"), chain(f + 2) + FAN_OUT))
        .collect();
    steps.push(Step::new("round", chain(e + f) + LOGIC));
    Schedule::new(steps, clock_mhz)
}

/// Clocks from operand to reciprocal.
pub fn latency(format: Format, clock_mhz: u32) -> u32 {
    schedule(format, clock_mhz).depth()
}

/// What `fp_reciprocal` computes.
pub fn model(format: Format, a: u64) -> u64 {
    plain::reciprocal(format, a)
}

/// Operands at the edges of what the divider distinguishes.
pub fn directed_cases(format: Format) -> Vec<u64> {
    let f = format.fraction_bits();
    let ones = format.fraction_mask();
    let mut magnitudes = vec![0, 1, format.infinity(), format.infinity() + 1, format.nan()];
    // About 1, the greatest, and where results are about the least normal number.
    let last = format.exponent_mask() - 1;
    for exponent in [1, 2, format.bias() as u64, last - 2, last - 1, last] {
        for fraction in [0, 1, 2, ones >> 1, ones - 1, ones] {
            magnitudes.push(exponent << f | fraction);
        }
    }
    magnitudes
        .into_iter()
        .flat_map(|bits| [bits, bits | format.sign_bit()])
        .collect()
}

/// The module `fp_reciprocal`.
pub fn module(format: Format, clock_mhz: u32) -> Result<Rc<Module>, HdlError> {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let plan = schedule(format, clock_mhz);
    let m = Builder::new(
        "fp_reciprocal",
        format!("y = 1 / a in {format}, rounded to nearest even, for {clock_mhz} MHz."),
    );
    let p = m.pipeline();
    let a = fields(format, p.input("a", format.width()));

    m.comment(
        "The exponent of 1 / a where a is no power of two; for a power of two rounding adds the 1 that lacks. \
         The two greatest exponents give results below the least normal number, except for the lesser power of two.",
    );
    let last = u128::from(format.exponent_mask()) - 1;
    crate::named! {
        let sign = a.sign;
        let exponent = !a.exponent - m.lit(2u8, e);
        let fraction_is_zero = a.fraction.is_zero();
        let underflow = a.exponent.equals(last)
            | (a.exponent.equals(last - 1) & !fraction_is_zero);
        let a_is_zero = a.exponent.is_zero();
        let a_is_special = a.exponent.all();
        let nan = a_is_special & !fraction_is_zero;
        let zero = underflow | (a_is_special & fraction_is_zero);
        let infinity_or_nan = a_is_zero | nan;
    }

    m.comment(
        "Non-restoring division of 2 by the significand: every remainder's sign is a bit of the quotient.",
    );
    let width = f + 2;
    let significand = m.lit(1u8, 2).concat(a.fraction).named("significand");
    let mut remainder = (significand - a.fraction.concat(m.zero(2))).named("remainder_1");
    let mut quotient = (!remainder.msb()).named("quotient_1");
    for digit in 2..=f + 1 {
        let at = plan.at(format!("digit {digit}"));
        let before = remainder.at(at);
        let subtract = (!before.msb()).named(format!("subtract_{digit}"));
        let doubled = m.concat(&[before.low(width - 1), subtract]);
        remainder = (doubled + (significand.at(at) ^ subtract.repeat(width)))
            .named(format!("remainder_{digit}"));
        quotient = quotient.at(at).concat(!remainder.msb());
        let ends_stage = digit == f + 1 || plan.at(format!("digit {}", digit + 1)) != at;
        if ends_stage {
            quotient = quotient.named(format!("quotient_{digit}"));
        }
    }

    m.comment("Round by the last bit of the quotient.");
    let at = plan.at("round");
    let quotient = quotient.at(at);
    crate::named! {
        let unrounded = exponent.at(at).concat(quotient.high(f));
        let rounded = unrounded + quotient.bit(0).extend(e + f);
    }
    let special = Special {
        infinity_or_nan: infinity_or_nan.at(at),
        nan: nan.at(at),
        zero: zero.at(at),
    };
    let y = pack(sign.at(at), rounded.high(e), rounded.low(f), special);
    m.output("y", y.at(plan.depth()));
    m.finish()
}
