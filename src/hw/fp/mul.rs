//! Multiplication: the rounded product of the significands.

use super::binary;
use super::fields::{Special, operand, pack};
use super::schedule::{LOGIC, MULTIPLY, Schedule, Step, chain, reduction};
use crate::float::{Format, plain};
use crate::hdl::{Builder, HdlError, Module, Signal, Specs};
use std::sync::Arc;

/// Width of an unsigned operand of a DSP48, which multiplies signed numbers of 18 bits.
const DSP_BITS: u32 = 17;

fn schedule(format: Format, clock_mhz: u32) -> Schedule {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let mut steps = vec![Step::new("multiply", MULTIPLY).registered()];
    if f + 1 > DSP_BITS {
        steps.push(Step::new("add crosswise", chain(f + 2)));
        steps.push(Step::new("add products", chain(2 * f + 2 - DSP_BITS)));
    }
    // The bits below the rounding position are known one level after the product; their test is a parallel tree.
    steps.push(Step::new("rounding", reduction(f).max(LOGIC) + 2 * LOGIC));
    steps.push(Step::new("round", chain(e + f + 3)));
    steps.push(Step::new("pack", reduction(e + 1) + LOGIC));
    Schedule::new(steps, clock_mhz)
}

/// The latency from operands to product, in cycles.
pub fn latency(format: Format, clock_mhz: u32) -> u32 {
    schedule(format, clock_mhz).depth()
}

/// Whether a two-input multiplexer (one level of logic) fits before the unit without a register.
pub fn takes_choice(format: Format, clock_mhz: u32) -> bool {
    schedule(format, clock_mhz).takes_choice()
}

/// The function of `fp_mul`.
pub fn model(format: Format, a: u64, b: u64) -> u64 {
    plain::mul(format, a, b)
}

/// Pairs of operands at the corner cases of the multiplier's steps.
pub fn directed_cases(format: Format) -> Vec<(u64, u64)> {
    let f = format.fraction_bits();
    let sign = format.sign_bit();
    let (one, infinity) = (format.one(), format.infinity());
    let ones = format.fraction_mask();
    let mut cases = vec![];
    // Products near a power of two, ties, and rounding that carries into the exponent.
    for a in [0, 1, 2, 3, ones, ones - 1, ones >> 1, (ones >> 1) + 1] {
        for b in [0, 1, 2, 3, ones, ones - 1, ones >> 1, (ones >> 1) + 1] {
            for signs in [0, sign] {
                cases.push((one | a, (one | b) | signs));
            }
            // The same at the limits of the range: sums of exponents equal to the least or the greatest, or one beyond.
            let last = format.exponent_mask() - 1;
            let bias = format.bias() as u64;
            for exponent in [bias - 1, bias, bias + 1, bias + 2] {
                cases.push((1 << f | a, exponent << f | b));
                cases.push((last << f | a, exponent << f | b));
            }
        }
    }
    let (least, greatest) = (format.least_normal(), format.greatest());
    let edges = [
        0,
        1,
        least,
        one,
        greatest,
        infinity,
        infinity + 1,
        format.nan(),
    ];
    for a in edges {
        for b in edges {
            for signs in [0, sign] {
                cases.push((a, b | signs));
                cases.push((a | sign, b | signs));
            }
        }
    }
    cases
}

/// The product of two significands, complete before the step "rounding".
fn product<'b>(plan: &Schedule, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
    let m = a.module();
    let width = a.width();
    let registered = plan.at("multiply") + 1;
    if width <= DSP_BITS {
        return a.mul(b).named("product").at(registered);
    }
    m.comment("Wider than a DSP block: the sum of four partial products.");
    let (a_low, a_high) = (a.low(DSP_BITS), a.high(width - DSP_BITS));
    let (b_low, b_high) = (b.low(DSP_BITS), b.high(width - DSP_BITS));
    crate::named! {
        let low_product = a_low.mul(b_low);
        let cross_product_1 = a_high.mul(b_low);
        let cross_product_2 = a_low.mul(b_high);
        let high_product = a_high.mul(b_high);
    }
    let at = plan.at("add crosswise").max(registered);
    crate::named! {
        let crosswise =
            cross_product_1.at(at).extend(width + 1) + cross_product_2.at(at).extend(width + 1);
    }
    let at = plan.at("add products");
    let outer = m.concat(&[high_product.at(at), low_product.at(at).high(DSP_BITS)]);
    let upper = (outer + crosswise.at(at).extend(outer.width())).named("upper_product");
    upper
        .concat(low_product.at(at).low(DSP_BITS))
        .named("product")
}

/// Describes the module `fp_mul`.
pub fn module(format: Format, clock_mhz: u32) -> Result<Arc<Module>, HdlError> {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let plan = schedule(format, clock_mhz);
    let m = Builder::new(
        "fp_mul",
        format!("y = a * b in {format}, rounded to nearest even, for {clock_mhz} MHz."),
    );
    let p = m.pipeline();
    let ports = binary::ports(format);
    let binary::Inputs { a, b } = ports.inputs.inputs_at(&p, 0);
    let (a, b) = (operand(format, "a", a), operand(format, "b", b));

    m.comment("The significands are in [1, 2), their product is in [1, 4).");
    crate::named! {
        let a_significand = m.lit(1u8, 1).concat(a.fraction);
        let b_significand = m.lit(1u8, 1).concat(b.fraction);
    }
    let product = product(&plan, a_significand, b_significand);

    m.comment("The exponent for a product in [1, 2). The bias is a power of two minus 1: the 1 is the carry-in.");
    let x = e + 2;
    crate::named! {
        let sign = a.sign ^ b.sign;
        let exponent_sum = a.exponent.extend(e + 1).concat(m.lit(1u8, 1))
            + b.exponent.extend(e + 1).concat(m.lit(1u8, 1));
    }
    let sum_plus_1 = exponent_sum.high(e + 1);
    crate::named! {
        let low_exponent = m.concat(&[
            sum_plus_1.high(2).extend(3) - m.lit(1u8, 3),
            sum_plus_1.low(e - 1),
        ]);
    }
    m.comment("The product is a NaN for zero times infinity and if a factor is a NaN.");
    crate::named! {
        let a_is_zero = a.exponent.is_zero();
        let b_is_zero = b.exponent.is_zero();
        let a_is_special = a.exponent.all();
        let b_is_special = b.exponent.all();
        let special = a_is_special | b_is_special;
        let factor_is_zero = a_is_zero | b_is_zero;
        let nan = (a_is_special & a.fraction.any())
            | (b_is_special & b.fraction.any())
            | (special & factor_is_zero);
        let status = m.concat(&[sign, special, nan, factor_is_zero]);
    }

    m.comment("Round to nearest even.");
    let product = product.at(plan.at("rounding"));
    crate::named! {
        let at_least_2 = product.msb();
        let product_fraction = at_least_2.mux(product.field(f + 1, f), product.field(f, f));
        let half = at_least_2.mux(product.bit(f), product.bit(f - 1));
        let more_than_half = product.low(f - 1).any() | (at_least_2 & product.bit(f - 1));
        let round_up = half & (more_than_half | product_fraction.bit(0));
    }
    let at = plan.at("round");
    crate::named! {
        let unrounded = m.concat(&[
            low_exponent.at(at),
            product_fraction.at(at),
            m.lit(1u8, 1),
        ]);
        let correction = m.concat(&[
            at_least_2.at(at).extend(x),
            m.zero(f),
            round_up.at(at),
        ]);
        let rounded = unrounded + correction;
    }

    m.comment("Underflow (below the least normal number) gives zero, overflow infinity.");
    let at = plan.at("pack");
    let (rounded, status) = (rounded.at(at), status.at(at));
    crate::named! {
        let y_is_negative = status.bit(3);
        let y_is_special = status.bit(2);
        let y_is_nan = status.bit(1);
        let y_is_zero = status.bit(0);
        let exponent = rounded.high(x);
        let fraction = rounded.field(1, f);
        let underflow = exponent.msb() | exponent.is_zero();
        let overflow = !exponent.msb() & (exponent.bit(e) | exponent.low(e).all());
        let zero = (underflow | y_is_zero) & !y_is_special;
        let infinity_or_nan = y_is_special | (overflow & !y_is_zero);
    }
    let special = Special {
        infinity_or_nan,
        nan: y_is_nan,
        zero,
    };
    let y = pack(y_is_negative, exponent.low(e), fraction, special);
    let y = y.at(plan.depth());
    ports.outputs.outputs(&m, binary::Outputs { y });
    m.finish()
}
