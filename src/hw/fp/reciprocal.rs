//! The reciprocal, by non-restoring division with one bit of the quotient per step.
//!
//! For a significand x in [1, 2), 2 ÷ x is in (1, 2]. Starting with the quotient 2 and the remainder 2 − 2x, each step doubles
//! the remainder and adds x if the remainder is negative, else subtracts x; the bits of the quotient are the signs of the
//! resulting remainders. There are no ties and no sticky bit: 2 ÷ x is never halfway between two numbers, so one bit below the
//! fraction is enough for rounding. For x = 1 all bits are ones, the rounding carry propagates to the top, and the result is
//! exact.

use super::fields::{Special, operand, pack};
use super::schedule::{FAN_OUT, LOGIC, Schedule, Step, chain};
use super::unary;
use crate::float::{Format, plain};
use crate::hdl::{Builder, HdlError, Module, Specs};
use std::sync::Arc;

fn schedule(format: Format, clock_mhz: u32) -> Schedule {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let mut steps = vec![Step::new("digit 1", chain(f + 2))];
    for digit in 2..=f + 1 {
        steps.push(Step::new(format!("choose {digit}"), LOGIC + FAN_OUT));
        steps.push(Step::new(format!("digit {digit}"), chain(f + 2)));
    }
    steps.push(Step::new("round", chain(e + f) + LOGIC));
    Schedule::new(steps, clock_mhz)
}

/// The latency from operand to reciprocal, in cycles.
pub fn latency(format: Format, clock_mhz: u32) -> u32 {
    schedule(format, clock_mhz).depth()
}

/// The function of `fp_reciprocal`.
pub fn model(format: Format, a: u64) -> u64 {
    plain::reciprocal(format, a)
}

/// Operands at the corner cases of the divider.
pub fn directed_cases(format: Format) -> Vec<u64> {
    let f = format.fraction_bits();
    let ones = format.fraction_mask();
    let mut magnitudes = vec![0, 1, format.infinity(), format.infinity() + 1, format.nan()];
    // Near 1, near the greatest number, and with results near the least normal number.
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

/// Describes the module `fp_reciprocal`.
pub fn module(format: Format, clock_mhz: u32) -> Result<Arc<Module>, HdlError> {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let plan = schedule(format, clock_mhz);
    let m = Builder::new(
        "fp_reciprocal",
        format!("y = 1 / a in {format}, rounded to nearest even, for {clock_mhz} MHz."),
    );
    let p = m.pipeline();
    let ports = unary::ports(format);
    let a = operand(format, "a", ports.inputs.a.input_at(&p, 0));

    m.comment(
        "The exponent of 1 / a if a is not a power of two; for a power of two, rounding adds the missing 1. \
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
        let status = m.concat(&[sign, infinity_or_nan, nan, zero]);
    }

    m.comment(
        "Non-restoring division of 2 by the significand: the sign of each remainder is a bit of the quotient.",
    );
    let width = f + 2;
    let significand = m.lit(1u8, 2).concat(a.fraction).named("significand");
    let mut remainder = (significand - a.fraction.concat(m.zero(2))).named("remainder_1");
    let mut quotient = (!remainder.msb()).named("quotient_1");
    // The fraction as a stage receives it: complemented if the step before the register subtracted it. So a
    // register after the multiplexer holds no more bits than one before it.
    let (mut fraction, mut complemented) = (a.fraction, m.zero(1));
    let mut last = 0;
    for digit in 2..=f + 1 {
        let at = plan.at(format!("choose {digit}"));
        let before = remainder.at(at);
        (fraction, complemented) = (fraction.at(at), complemented.at(at));
        let subtract = (!before.msb()).named(format!("subtract_{digit}"));
        let chosen =
            (fraction ^ (complemented ^ subtract).repeat(f)).named(format!("chosen_{digit}"));

        let at = plan.at(format!("digit {digit}"));
        if before.stage() != at {
            (fraction, complemented) = (chosen, subtract);
        }
        let subtract = subtract.at(at);
        let doubled = before.part("low", 0, width - 1).at(at).concat(subtract);
        // The integer part of the significand is 01.
        let addend = m.concat(&[subtract, !subtract, chosen.at(at)]);
        remainder = (doubled + addend).named(format!("remainder_{digit}"));
        if at != last {
            quotient = quotient.named(format!("quotient_{}", digit - 1));
            last = at;
        }
        quotient = quotient.at(at).concat(!remainder.msb());
    }
    let quotient = quotient.named(format!("quotient_{}", f + 1));

    m.comment("Round with the last bit of the quotient.");
    let at = plan.at("round");
    let (quotient, status) = (quotient.at(at), status.at(at));
    crate::named! {
        let y_is_negative = status.bit(3);
        let unrounded = exponent.at(at).concat(quotient.high(f));
        let rounded = unrounded + quotient.bit(0).extend(e + f);
    }
    let special = Special {
        infinity_or_nan: status.bit(2).named("y_is_infinity_or_nan"),
        nan: status.bit(1).named("y_is_nan"),
        zero: status.bit(0).named("y_is_zero"),
    };
    let y = pack(y_is_negative, rounded.high(e), rounded.low(f), special);
    let y = y.at(plan.depth());
    ports.outputs.outputs(&m, unary::Outputs { y });
    m.finish()
}
