//! Addition and subtraction: align, add, normalise, round.

use super::binary;
use super::fields::{Fields, Special, operand, pack};
use super::schedule::{FAN_OUT, LOGIC, SHIFT, Schedule, Step, chain, reduction};
use crate::float::{Format, plain};
use crate::hdl::{Builder, HdlError, Library, Module, Parameter, Signal, Specs, bits_for};
use std::sync::Arc;

/// The maximum shift of the smaller significand: beyond its width and two more bits it affects the sticky bit only.
fn align_bits(format: Format) -> u32 {
    bits_for(u64::from(format.fraction_bits()) + 4).min(format.exponent_bits())
}

/// Width of the sum: carry, significand, guard, round and sticky bit.
fn sum_width(format: Format) -> u32 {
    format.fraction_bits() + 5
}

fn normalise_bits(format: Format) -> u32 {
    bits_for(u64::from(sum_width(format)))
}

/// Width of the result's exponent before the range check, in two's complement.
fn exponent_width(format: Format) -> u32 {
    format.exponent_bits().max(normalise_bits(format)) + 2
}

fn schedule(format: Format, clock_mhz: u32) -> Schedule {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let width = sum_width(format);
    let compare = chain(format.width() - 1).max(chain(e + 1) + 2 * LOGIC);
    let mut steps = vec![
        Step::new("compare", compare),
        Step::new("swap", LOGIC + FAN_OUT),
    ];
    for level in (0..align_bits(format)).rev() {
        steps.push(Step::new(format!("align by {}", 1 << level), SHIFT));
    }
    steps.push(Step::new("add", chain(width)));
    for level in (0..normalise_bits(format)).rev() {
        let delay = reduction(1 << level) + SHIFT + if level > 2 { FAN_OUT } else { 0 };
        steps.push(Step::new(format!("normalise by {}", 1 << level), delay));
    }
    steps.push(Step::new("rounding", 2 * LOGIC));
    steps.push(Step::new("round", chain(exponent_width(format) + f)));
    steps.push(Step::new("pack", reduction(e + 1) + LOGIC));
    Schedule::new(steps, clock_mhz)
}

/// The latency from operands to sum, in cycles.
pub fn latency(format: Format, clock_mhz: u32) -> u32 {
    schedule(format, clock_mhz).depth()
}

/// Whether a two-input multiplexer (one level of logic) fits before the unit without a register.
pub fn takes_choice(format: Format, clock_mhz: u32) -> bool {
    schedule(format, clock_mhz).takes_choice()
}

/// The function of `fp_add`.
pub fn model(format: Format, a: u64, b: u64) -> u64 {
    plain::add(format, a, b)
}

/// The function of `fp_sub`.
pub fn model_sub(format: Format, a: u64, b: u64) -> u64 {
    plain::sub(format, a, b)
}

/// Pairs of operands at the corner cases of the adder's steps.
pub fn directed_cases(format: Format) -> Vec<(u64, u64)> {
    let f = format.fraction_bits();
    let sign = format.sign_bit();
    let one = format.one();
    let mut cases = vec![];
    // One and powers of two, with their neighbours, at all distances that affect the rounding bits.
    for distance in 0..=u64::from(f) + 4 {
        let Some(small) = one.checked_sub(distance << f).filter(|s| *s > 3) else {
            break;
        };
        for (big_offset, small_offset) in [(0, 0), (0, 1), (1, 0), (1, 1), (3, 3)] {
            for signs in [0, sign] {
                cases.push((one + big_offset, (small + small_offset) | signs));
                cases.push((one + big_offset, (small - small_offset) | signs));
            }
        }
    }
    let (least, greatest) = (format.least_normal(), format.greatest());
    for step in 0..4 {
        // Cancellation to and below the least normal number, and sums near the greatest number.
        cases.push((least + step, sign | least));
        cases.push((2 * least + step, sign | (2 * least - 1)));
        cases.push((greatest, greatest - step));
    }
    // Half an ulp of the greatest number, and its neighbours: sums that round to infinity.
    let last = format.exponent_mask() - 1;
    if let Some(exponent) = last.checked_sub(u64::from(f) + 1).filter(|e| *e > 0) {
        let half_ulp = exponent << f;
        for addend in [half_ulp - 1, half_ulp, half_ulp + 1] {
            cases.push((greatest, addend));
            cases.push((sign | greatest, sign | addend));
        }
    }
    for zero in [0, sign, 1, sign | 1] {
        for other in [0, sign, one, sign | one, least, greatest] {
            cases.push((zero, other));
        }
    }
    let infinity = format.infinity();
    for special in [
        infinity,
        sign | infinity,
        format.nan(),
        sign | (infinity + 1),
    ] {
        for other in [0, one, sign | infinity, infinity, format.nan()] {
            cases.push((special, other));
        }
    }
    cases
}

/// The operands in the order of their magnitudes, the smaller one aligned.
struct Aligned<'b> {
    big_sign: Signal<'b>,
    big_exponent: Signal<'b>,
    big_fraction: Signal<'b>,
    /// The smaller significand, with two more bits below it.
    small: Signal<'b>,
    /// Whether a one was shifted out below these bits.
    sticky: Signal<'b>,
    subtracting: Signal<'b>,
    both_are_special: Signal<'b>,
}

/// Selects the operand of the greater magnitude, and aligns the other.
fn align<'b>(format: Format, plan: &Schedule, a: Fields<'b>, b: Fields<'b>) -> Aligned<'b> {
    let m = a.sign.module();
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    m.comment("The operand of the greater magnitude, and the shift of the other one.");
    crate::named! {
        let swap = a.magnitude.lt(b.magnitude);
        let exponent_difference = a.exponent.extend(e + 1) - b.exponent.extend(e + 1);
        let distance = exponent_difference.msb().mux(
            b.exponent - a.exponent,
            exponent_difference.low(e),
        );
        let subtracting = a.sign ^ b.sign;
        let both_are_special = a.exponent.all() & b.exponent.all();
        let either_is_zero = a.exponent.is_zero() | b.exponent.is_zero();
    }
    let shift_bits = align_bits(format);
    // The fraction of a zero is ignored, and so is that of an operand that is too small.
    let (small_is_nothing, small_is_far) = if shift_bits < e {
        let far = distance.bits(e - 1, shift_bits).any().named("too_far");
        let nothing = (either_is_zero | far).named("small_vanishes");
        (nothing, (far & !either_is_zero).hinted("small_is_far"))
    } else {
        (either_is_zero, m.zero(1))
    };

    let small_is_kept = (!small_is_nothing).hinted("small_is_kept");
    let at = plan.at("swap");
    let swap = swap.at(at);
    crate::named! {
        let big_sign = swap.mux(b.sign, a.sign);
        let big_exponent = swap.mux(b.exponent, a.exponent);
        let big_fraction = swap.mux(b.fraction, a.fraction);
        let small_fraction =
            swap.mux(a.fraction, b.fraction) & small_is_kept.at(at).repeat(f);
    }
    m.comment("Align the smaller significand; a sticky bit collects the bits shifted out.");
    let mut small = m
        .concat(&[small_is_kept.at(at), small_fraction, m.zero(2)])
        .named("unaligned");
    let mut sticky = small_is_far.at(at);
    let width = small.width();
    for level in (0..shift_bits).rev() {
        let by = 1 << level;
        let at = plan.at(format!("align by {by}"));
        let (select, word) = (
            distance.part(format!("by_{by}"), level, 1).at(at),
            small.at(at),
        );
        let lost = word.low(by.min(width)).any();
        let shifted = if by < width {
            word.high(width - by).extend(width)
        } else {
            m.zero(width)
        };
        small = select
            .mux(shifted, word)
            .named(format!("aligned_within_{by}"));
        sticky = (sticky.at(at) | (select & lost)).named(format!("sticky_within_{by}"));
    }
    Aligned {
        big_sign,
        big_exponent,
        big_fraction,
        small,
        sticky,
        subtracting,
        both_are_special,
    }
}

/// The sum of both significands.
struct Sum<'b> {
    /// The carry, the significand, and three rounding bits.
    significand: Signal<'b>,
    /// The exponent of the greater operand, plus 2.
    exponent_plus_2: Signal<'b>,
    /// The sign, a flag for infinity or NaN, and a flag for NaN.
    status: Signal<'b>,
}

/// Adds the significands and handles special operands.
fn sum<'b>(format: Format, plan: &Schedule, operands: &Aligned<'b>) -> Sum<'b> {
    let m = operands.sticky.module();
    let f = format.fraction_bits();
    m.comment("The sum: carry, significand, three rounding bits. It is never negative.");
    let at = plan.at("add");
    let x = exponent_width(format);
    let (aligned, subtracting) = (operands.small.at(at), operands.subtracting.at(at));
    crate::named! {
        let augend = m.concat(&[
            m.lit(1u8, 2),
            operands.big_fraction.at(at),
            m.zero(2),
            subtracting,
        ]);
        // A concatenation, not one word: Yosys then uses it as the second operand of the sum, whose complement costs no logic.
        let addend = m.concat(&[
            subtracting,
            aligned.msb() ^ subtracting,
            aligned.field(2, f) ^ subtracting.repeat(f),
            aligned.low(2) ^ subtracting.repeat(2),
            operands.sticky.at(at) ^ subtracting,
        ]);
        let sum = augend + addend;
    }
    m.comment(
        "A NaN or an infinity is always the greater operand. The sum of infinities of the same sign is that infinity.",
    );
    let [big_fraction, big_exponent] =
        [operands.big_fraction, operands.big_exponent].map(|field| field.at(at));
    crate::named! {
        let big_is_special = big_exponent.all();
        let nan = big_is_special
            & (big_fraction.any() | (operands.both_are_special.at(at) & subtracting));
        let status = m.concat(&[operands.big_sign.at(at), big_is_special, nan]);
        let exponent_plus_2 = big_exponent.extend(x) + m.lit(2u8, x);
    }
    Sum {
        significand: sum,
        exponent_plus_2,
        status,
    }
}

/// Shifts the leading one of a sum to the top. Returns the sum and the bits of the shift.
fn normalise<'b>(
    format: Format,
    plan: &Schedule,
    sum: Signal<'b>,
) -> (Signal<'b>, Vec<Signal<'b>>) {
    let m = sum.module();
    let width = sum_width(format);
    m.comment("Normalise: shift the leading one to the position of the carry.");
    let mut normal = sum;
    let mut shift = vec![];
    for level in (0..normalise_bits(format)).rev() {
        let by = 1 << level;
        let word = normal.at(plan.at(format!("normalise by {by}")));
        let empty = word.high(by).is_zero().named(format!("zeros_{by}"));
        let shifted = word.low(width - by).concat(m.zero(by));
        normal = empty
            .mux(shifted, word)
            .named(format!("normal_within_{by}"));
        shift.push(empty);
    }
    (normal, shift)
}

/// Describes the module `fp_add` or `fp_sub`.
pub fn module(format: Format, clock_mhz: u32, subtract: bool) -> Result<Arc<Module>, HdlError> {
    let library = Library {
        name: "fp_add_sub",
        doc: &format!(
            "y = a + b, or a - b, in {format}, rounded to nearest even, for {clock_mhz} MHz."
        ),
        parameters: &[Parameter::flag("SUBTRACT", "y = a - b")],
        values: &|subtract| vec![u32::from(*subtract)],
        samples: &[false, true],
        describe: &|subtract| describe(format, clock_mhz, *subtract),
    };
    library.module(&subtract)
}

fn describe(format: Format, clock_mhz: u32, subtract: bool) -> Result<Arc<Module>, HdlError> {
    let (e, f) = (format.exponent_bits(), format.fraction_bits());
    let plan = schedule(format, clock_mhz);
    let (name, operator) = if subtract {
        ("fp_sub", "-")
    } else {
        ("fp_add", "+")
    };
    let m = Builder::new(
        name,
        format!("y = a {operator} b in {format}, rounded to nearest even, for {clock_mhz} MHz."),
    );
    let p = m.pipeline();
    let ports = binary::ports(format);
    let binary::Inputs { a, b } = ports.inputs.inputs_at(&p, 0);
    let (a, b) = (operand(format, "a", a), operand(format, "b", b));

    m.simplify(false);
    let sign_of_addend = b.sign ^ m.lit(u8::from(subtract), 1);
    m.simplify(true);
    let b = Fields {
        sign: sign_of_addend.named("sign_of_addend"),
        ..b
    };
    let operands = align(format, &plan, a, b);
    let sum = sum(format, &plan, &operands);
    let (normal, shift) = normalise(format, &plan, sum.significand);

    m.comment(
        "Round to nearest even. The exponent is that of the greater operand, plus 1, minus the shift; \
         the shift is subtracted as its complement plus 1.",
    );
    let at = plan.at("rounding");
    let normal = normal.at(at);
    crate::named! {
        let round_up = normal.bit(3) & (normal.bit(4) | normal.low(3).any());
        let cancelled = !normal.msb();
        let normal_fraction = normal.field(4, f);
    }
    let at = plan.at("round");
    let x = exponent_width(format);
    let shift = m.concat(&shift).named("shift").at(at).extend(x);
    crate::named! {
        let unrounded = m.concat(&[
            sum.exponent_plus_2.at(at),
            normal_fraction.at(at),
            m.lit(1u8, 1),
        ]);
        let correction = m.concat(&[!shift, m.zero(f), round_up.at(at)]);
        let rounded = unrounded + correction;
    }

    m.comment("Underflow (below the least normal number) gives zero, overflow infinity.");
    let at = plan.at("pack");
    let (rounded, status) = (rounded.at(at), sum.status.at(at));
    crate::named! {
        let y_is_negative = status.bit(2);
        let y_is_special = status.bit(1);
        let y_is_nan = status.bit(0);
        let exponent = rounded.high(x);
        let fraction = rounded.field(1, f);
        let underflow = exponent.msb() | exponent.is_zero();
        let overflow =
            !exponent.msb() & (exponent.bits(x - 2, e).any() | exponent.low(e).all());
        let zero = (underflow | cancelled.at(at)) & !y_is_special;
        let infinity_or_nan = y_is_special | (overflow & !cancelled.at(at));
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
