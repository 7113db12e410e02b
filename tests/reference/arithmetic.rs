//! Both implementations of the arithmetic, compared with two independent oracles: the
//! processor's `f64` followed by one rounding, and `rustc_apfloat`.
//!
//! Random tests print their seed; `DYNRT_SEED=… cargo test --test reference arithmetic::` repeats them.

use dynrt::float::{Arithmetic, Format, plain, specials};
use fastrand::Rng;
use rayon::prelude::*;
use rustc_apfloat::ieee::{Double, IeeeFloat, Semantics};
use rustc_apfloat::{Float, FloatConvert};
use std::cmp::Ordering;
use std::sync::OnceLock;

/// An independent implementation of the operations on the bit patterns of one format.
trait Oracle: Sync {
    /// The value of a pattern, exactly.
    fn value(&self, bits: u64) -> f64;
    /// The canonical pattern with the meaning of `bits`.
    fn canonical(&self, bits: u64) -> u64;
    /// Any `f64`, rounded.
    fn round(&self, value: f64) -> u64;
    fn add(&self, a: u64, b: u64) -> u64;
    fn sub(&self, a: u64, b: u64) -> u64;
    fn mul(&self, a: u64, b: u64) -> u64;
    fn reciprocal(&self, a: u64) -> u64;
    fn compare(&self, a: u64, b: u64) -> Option<Ordering>;
    /// One step by an ulp, towards +∞ or towards −∞.
    fn neighbour(&self, bits: u64, up: bool) -> u64;
}

/// The processor's `f64`, then one rounding. Unlike the implementation under test it does not use the bits of an
/// `f64`: it scales by powers of two and rounds to integers.
struct Hardware {
    format: Format,
    /// 2^−1022, 2^−1021, … 2^1023.
    powers: Vec<f64>,
    least: f64,
    greatest: f64,
}

impl Hardware {
    fn new(format: Format) -> Self {
        let doubles = |power: &f64| Some(power * 2.0).filter(|power| power.is_finite());
        let mut oracle = Hardware {
            format,
            powers: std::iter::successors(Some(f64::MIN_POSITIVE), doubles).collect(),
            least: 0.0,
            greatest: 0.0,
        };
        oracle.least = oracle.power(1 - format.bias());
        oracle.greatest = (2.0 - oracle.power(-(format.fraction_bits() as i32)))
            * oracle.power(format.exponent_mask() as i32 - 1 - format.bias());
        oracle
    }

    fn power(&self, exponent: i32) -> f64 {
        self.powers[(exponent + 1022) as usize]
    }

    /// The exponent of a positive normal `f64`.
    fn exponent(&self, magnitude: f64) -> i32 {
        let mut exponent = (magnitude.log2() as i32).clamp(-1022, 1023);
        while self.power(exponent) > magnitude {
            exponent -= 1;
        }
        while exponent < 1023 && self.power(exponent + 1) <= magnitude {
            exponent += 1;
        }
        exponent
    }

    /// The weight of the last fraction bit of a positive number.
    fn ulp(&self, magnitude: f64) -> f64 {
        self.power(self.exponent(magnitude) - self.format.fraction_bits() as i32)
    }
}

impl Oracle for Hardware {
    fn value(&self, bits: u64) -> f64 {
        let format = self.format;
        let scale = 1_u64 << format.fraction_bits();
        let fraction = (bits % scale) as f64 / scale as f64;
        let exponent = bits / scale % (1 << format.exponent_bits());
        let magnitude = if exponent == 0 {
            0.0
        } else if exponent < format.exponent_mask() {
            (1.0 + fraction) * self.power(exponent as i32 - format.bias())
        } else if fraction == 0.0 {
            f64::INFINITY
        } else {
            return f64::NAN;
        };
        let negative = bits >> (format.width() - 1) == 1;
        if negative { -magnitude } else { magnitude }
    }

    fn canonical(&self, bits: u64) -> u64 {
        let value = self.value(bits);
        if value == 0.0 && value.is_sign_negative() {
            self.format.sign_bit()
        } else {
            self.round(value)
        }
    }

    fn round(&self, value: f64) -> u64 {
        let format = self.format;
        let magnitude = value.abs();
        let sign = if value < 0.0 { format.sign_bit() } else { 0 };
        if value.is_nan() {
            return format.nan();
        } else if magnitude < self.least / 2.0 {
            return 0;
        } else if magnitude > self.greatest * 2.0 {
            return sign | format.infinity();
        }
        let exponent = self.exponent(magnitude);
        let ulp = self.power(exponent - format.fraction_bits() as i32);
        let significand = (magnitude / ulp).round_ties_even();
        let rounded = significand * ulp;
        if rounded < self.least {
            return 0;
        } else if rounded > self.greatest {
            return sign | format.infinity();
        }
        // The first significand is a power of two, so a carry into the next exponent needs no special case.
        let stored_exponent = (exponent + format.bias()) as u64;
        let scale = 1 << format.fraction_bits();
        sign | (stored_exponent * scale + significand as u64 - scale)
    }

    fn add(&self, a: u64, b: u64) -> u64 {
        self.round(self.value(a) + self.value(b))
    }

    fn sub(&self, a: u64, b: u64) -> u64 {
        self.round(self.value(a) - self.value(b))
    }

    fn mul(&self, a: u64, b: u64) -> u64 {
        self.round(self.value(a) * self.value(b))
    }

    fn reciprocal(&self, a: u64) -> u64 {
        self.round(1.0 / self.value(a))
    }

    fn compare(&self, a: u64, b: u64) -> Option<Ordering> {
        self.value(a).partial_cmp(&self.value(b))
    }

    fn neighbour(&self, bits: u64, up: bool) -> u64 {
        let value = self.value(bits);
        if !value.is_finite() {
            return self.canonical(bits);
        }
        let magnitude = value.abs();
        if magnitude == 0.0 {
            return self.round(if up { self.least } else { -self.least });
        }
        let exponent = self.exponent(magnitude);
        let ulp = self.power(exponent - self.format.fraction_bits() as i32);
        let next = if (value > 0.0) == up {
            magnitude + ulp
        } else if magnitude == self.power(exponent) {
            magnitude - ulp / 2.0
        } else {
            magnitude - ulp
        };
        self.round(next.copysign(value))
    }
}

/// `rustc_apfloat` with 12 exponent bits, so that no operation on numbers with at most 10 reaches its
/// subnormals or its infinity; then the limits of the format.
struct Apfloat<const FRACTION_BITS: usize>(Format);

struct Wide<const FRACTION_BITS: usize>;

const WIDE_EXPONENT_BITS: usize = 12;
const WIDE_BIAS: i64 = (1 << (WIDE_EXPONENT_BITS - 1)) - 1;

impl<const FRACTION_BITS: usize> Semantics for Wide<FRACTION_BITS> {
    const BITS: usize = 1 + WIDE_EXPONENT_BITS + FRACTION_BITS;
    const EXP_BITS: usize = WIDE_EXPONENT_BITS;
}

impl<const FRACTION_BITS: usize> Apfloat<FRACTION_BITS> {
    fn widen(&self, bits: u64) -> IeeeFloat<Wide<FRACTION_BITS>> {
        let bias = i64::from(self.0.bias());
        let negative = bits & self.0.sign_bit() != 0;
        let fraction = bits & ((1 << FRACTION_BITS) - 1);
        let exponent = (bits & !self.0.sign_bit()) >> FRACTION_BITS;
        let magnitude = if exponent == 0 {
            IeeeFloat::ZERO
        } else if exponent < self.0.exponent_mask() {
            let exponent = exponent as i64 - bias + WIDE_BIAS;
            IeeeFloat::from_bits(u128::from((exponent as u64) << FRACTION_BITS | fraction))
        } else if fraction == 0 {
            IeeeFloat::INFINITY
        } else {
            IeeeFloat::NAN
        };
        if negative { -magnitude } else { magnitude }
    }

    /// The pattern of a result with the sign of a zero kept.
    fn narrow(&self, wide: IeeeFloat<Wide<FRACTION_BITS>>) -> u64 {
        let sign = if wide.is_negative() {
            self.0.sign_bit()
        } else {
            0
        };
        if wide.is_nan() {
            return self.0.nan();
        } else if wide.is_infinite() {
            return sign | self.0.infinity();
        } else if wide.is_zero() {
            return sign;
        }
        let magnitude = wide.abs().to_bits() as u64;
        let exponent = (magnitude >> FRACTION_BITS) as i64 - WIDE_BIAS + i64::from(self.0.bias());
        if exponent < 1 {
            sign
        } else if exponent >= self.0.exponent_mask() as i64 {
            sign | self.0.infinity()
        } else {
            sign | (exponent as u64) << FRACTION_BITS | magnitude & ((1 << FRACTION_BITS) - 1)
        }
    }

    /// The pattern of a result: −0 is stored as +0.
    fn store(&self, wide: IeeeFloat<Wide<FRACTION_BITS>>) -> u64 {
        match self.narrow(wide) {
            zero if zero == self.0.sign_bit() => 0,
            bits => bits,
        }
    }
}

impl<const FRACTION_BITS: usize> Oracle for Apfloat<FRACTION_BITS> {
    fn value(&self, bits: u64) -> f64 {
        let double: Double = self.widen(bits).convert(&mut false).value;
        f64::from_bits(double.to_bits() as u64)
    }

    fn canonical(&self, bits: u64) -> u64 {
        self.narrow(self.widen(bits))
    }

    fn round(&self, value: f64) -> u64 {
        let double = Double::from_bits(value.to_bits().into());
        self.store(double.convert(&mut false).value)
    }

    fn add(&self, a: u64, b: u64) -> u64 {
        self.store((self.widen(a) + self.widen(b)).value)
    }

    fn sub(&self, a: u64, b: u64) -> u64 {
        self.store((self.widen(a) - self.widen(b)).value)
    }

    fn mul(&self, a: u64, b: u64) -> u64 {
        self.store((self.widen(a) * self.widen(b)).value)
    }

    fn reciprocal(&self, a: u64) -> u64 {
        let one = self.widen(self.0.one());
        self.store((one / self.widen(a)).value)
    }

    fn compare(&self, a: u64, b: u64) -> Option<Ordering> {
        self.widen(a).partial_cmp(&self.widen(b))
    }

    fn neighbour(&self, bits: u64, up: bool) -> u64 {
        let wide = self.widen(bits);
        if !wide.is_finite() {
            self.narrow(wide)
        } else if wide.is_zero() {
            // The wider format has numbers between zero and the least number of this one.
            self.0.least_normal() | if up { 0 } else { self.0.sign_bit() }
        } else {
            let next = if up { wide.next_up() } else { wide.next_down() };
            self.store(next.value)
        }
    }
}

fn apfloat(format: Format) -> Box<dyn Oracle> {
    macro_rules! by_fraction_bits {
        ($($bits:literal)*) => {
            match format.fraction_bits() {
                $($bits => Box::new(Apfloat::<$bits>(format)),)*
                bits => panic!("no oracle for {bits} fraction bits"),
            }
        };
    }
    by_fraction_bits!(2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23)
}

/// One format's two implementations and two oracles.
struct Bench {
    format: Format,
    fast: Arithmetic,
    hardware: Hardware,
    apfloat: Box<dyn Oracle>,
}

impl Bench {
    fn new(format: Format) -> Self {
        Bench {
            format,
            fast: Arithmetic::new(format),
            hardware: Hardware::new(format),
            apfloat: apfloat(format),
        }
    }

    /// Compares the results of implementations with those of both oracles; the error lists all of them.
    fn agree(
        &self,
        operation: &str,
        operands: &[u64],
        plain: u64,
        fast: u64,
        oracle: impl Fn(&dyn Oracle) -> u64,
    ) -> Result<(), String> {
        let hardware = oracle(&self.hardware);
        let apfloat = oracle(&*self.apfloat);
        if plain == hardware && plain == apfloat && fast == plain {
            return Ok(());
        }
        let operands: Vec<_> = operands
            .iter()
            .map(|&bits| format!("{bits:#x} = {:e}", self.hardware.value(bits)))
            .collect();
        Err(format!(
            "{} {operation} of {}: plain {plain:#x}, fast {fast:#x}; f64 oracle {hardware:#x}, rustc_apfloat {apfloat:#x}",
            self.format,
            operands.join(" and "),
        ))
    }

    /// Every binary operation on one pair of patterns.
    fn binary(&self, a: u64, b: u64) -> Result<(), String> {
        let (format, fast) = (self.format, &self.fast);
        let (x, y) = (format.to_f64(a), format.to_f64(b));
        let bits = |value| format.to_bits(value);
        let pair = [a, b];
        let choose = |oracle: &dyn Oracle, replacing| {
            let replaced = oracle.compare(b, a) == Some(replacing);
            oracle.canonical(if replaced { b } else { a })
        };
        self.agree(
            "add",
            &pair,
            plain::add(format, a, b),
            bits(fast.add(x, y)),
            |o| o.add(a, b),
        )?;
        self.agree(
            "sub",
            &pair,
            plain::sub(format, a, b),
            bits(fast.sub(x, y)),
            |o| o.sub(a, b),
        )?;
        self.agree(
            "mul",
            &pair,
            plain::mul(format, a, b),
            bits(fast.mul(x, y)),
            |o| o.mul(a, b),
        )?;
        self.agree(
            "min",
            &pair,
            plain::min(format, a, b),
            bits(fast.min(x, y)),
            |o| choose(o, Ordering::Less),
        )?;
        self.agree(
            "max",
            &pair,
            plain::max(format, a, b),
            bits(fast.max(x, y)),
            |o| choose(o, Ordering::Greater),
        )?;
        self.agree(
            "less",
            &pair,
            plain::less(format, a, b).into(),
            (x < y).into(),
            |o| (o.compare(a, b) == Some(Ordering::Less)).into(),
        )?;
        self.agree(
            "less_equal",
            &pair,
            plain::less_equal(format, a, b).into(),
            (x <= y).into(),
            |o| matches!(o.compare(a, b), Some(Ordering::Less | Ordering::Equal)).into(),
        )?;
        self.agree(
            "equal",
            &pair,
            plain::equal(format, a, b).into(),
            (x == y).into(),
            |o| (o.compare(a, b) == Some(Ordering::Equal)).into(),
        )
    }

    /// Every unary operation on one pattern.
    fn unary(&self, a: u64) -> Result<(), String> {
        let (format, fast) = (self.format, &self.fast);
        let x = format.to_f64(a);
        self.agree(
            "reciprocal",
            &[a],
            plain::reciprocal(format, a),
            format.to_bits(fast.reciprocal(x)),
            |o| o.reciprocal(a),
        )?;
        self.steps(a)?;
        self.conversions(a)
    }

    /// Steps by −3 to 3 ulps.
    fn steps(&self, a: u64) -> Result<(), String> {
        let (format, fast) = (self.format, &self.fast);
        let x = format.to_f64(a);
        let zero_step = [&self.hardware as &dyn Oracle, &*self.apfloat]
            .map(|oracle| without_negative_zero(format, oracle.canonical(a)));
        for up in [false, true] {
            let [mut hardware, mut apfloat] = zero_step;
            for distance in 0..=3 {
                let ulps = if up { distance } else { -distance };
                if distance > 0 {
                    hardware = self.hardware.neighbour(hardware, up);
                    apfloat = self.apfloat.neighbour(apfloat, up);
                }
                let plain = plain::step(format, a, ulps);
                let fast = format.to_bits(fast.step(x, ulps));
                if plain != hardware || plain != apfloat || plain != fast {
                    return Err(format!(
                        "{format} step of {a:#x} = {x:e} by {ulps}: plain {plain:#x}, fast {fast:#x}; f64 oracle {hardware:#x}, rustc_apfloat {apfloat:#x}",
                    ));
                }
            }
        }
        Ok(())
    }

    /// To `f64` and `f32` and back.
    fn conversions(&self, a: u64) -> Result<(), String> {
        let format = self.format;
        let x = format.to_f64(a);
        let canonical = plain::canonical(format, a);
        let stored = without_negative_zero(format, canonical);
        self.agree("to_f64", &[a], ordinal(x), ordinal(x), |o| {
            ordinal(o.value(a))
        })?;
        self.agree("to_bits", &[a], canonical, format.to_bits(x), |o| {
            o.canonical(a)
        })?;
        self.agree(
            "round_to_bits",
            &[a],
            stored,
            format.round_to_bits(x),
            |o| o.round(o.value(a)),
        )?;
        let single = format.to_f32(a);
        let single_bits = ordinal(single.into());
        self.agree("to_f32", &[a], single_bits, single_bits, |o| {
            ordinal((o.value(a) as f32).into())
        })?;
        let back = format.round_f32_to_bits(single);
        self.agree("round_f32_to_bits", &[a], back, back, |o| {
            o.round(single.into())
        })?;
        if format.exponent_bits() <= 8 && back != stored {
            return Err(format!(
                "{format} {a:#x} = {x:e} is {single:e} as an f32, and that is {back:#x}, not {stored:#x}",
            ));
        }
        Ok(())
    }

    /// Rounds an arbitrary `f64` to the format.
    fn rounding(&self, value: f64) -> Result<(), String> {
        let rounded = self.fast.round(value);
        let bits = self.format.to_bits(rounded);
        let hardware = self.hardware.round(value);
        let apfloat = self.apfloat.round(value);
        if bits != hardware || bits != apfloat {
            return Err(format!(
                "{} round of {value:e} ({:#x}): {bits:#x}; f64 oracle {hardware:#x}, rustc_apfloat {apfloat:#x}",
                self.format,
                value.to_bits(),
            ));
        }
        Ok(())
    }
}

/// The bits of an `f64`, the same for every NaN.
fn ordinal(value: f64) -> u64 {
    if value.is_nan() {
        f64::NAN.to_bits()
    } else {
        value.to_bits()
    }
}

fn without_negative_zero(format: Format, bits: u64) -> u64 {
    if bits == format.sign_bit() { 0 } else { bits }
}

fn format(exponent_bits: u32, fraction_bits: u32) -> Format {
    Format::new(exponent_bits, fraction_bits).unwrap()
}

fn every_format() -> impl Iterator<Item = Format> {
    Format::EXPONENT_BITS.flat_map(|e| Format::FRACTION_BITS.map(move |f| format(e, f)))
}

/// The corners of the supported range of formats, and the widths of an `f32`.
fn extreme_formats() -> [Format; 6] {
    [(3, 2), (3, 23), (10, 2), (10, 23), (8, 23), (7, 16)].map(|(e, f)| format(e, f))
}

/// Runs the checks 0 to `count` − 1 on all cores; fails with the first error, or if there was nothing to check.
fn check_all(what: &str, count: u64, check: impl Fn(u64) -> Result<(), String> + Sync) {
    const CHUNK: u64 = 1 << 12;
    check_chunks(what, count, CHUNK, |first, length| {
        (first..first + length).try_for_each(&check)
    });
}

/// Checks `count` random cases on all cores, each chunk with its own generator.
fn check_random(what: &str, count: u64, check: impl Fn(&mut Rng) -> Result<(), String> + Sync) {
    const CHUNK: u64 = 1 << 12;
    let seed = seed();
    check_chunks(
        &format!("{what} (DYNRT_SEED={seed})"),
        count,
        CHUNK,
        |first, length| {
            let mut rng = Rng::with_seed(seed ^ first.wrapping_mul(0x9e37_79b9_7f4a_7c15));
            (0..length).try_for_each(|_| check(&mut rng))
        },
    );
}

fn check_chunks(
    what: &str,
    count: u64,
    chunk: u64,
    check: impl Fn(u64, u64) -> Result<(), String> + Sync,
) {
    assert!(count > 0, "{what}: nothing to check");
    let failure = (0..count.div_ceil(chunk))
        .into_par_iter()
        .find_map_first(|index| {
            let first = index * chunk;
            check(first, chunk.min(count - first)).err()
        });
    if let Some(failure) = failure {
        panic!("{what}: {failure}");
    }
    println!("{what}: {count} checked, all agree");
}

/// The same in all tests of a run.
fn seed() -> u64 {
    static SEED: OnceLock<u64> = OnceLock::new();
    *SEED.get_or_init(dynrt::seed::of_run)
}

/// The distribution of random pairs.
#[derive(Clone, Copy, Debug)]
enum Distribution {
    /// Any two bit patterns.
    Uniform,
    /// Exponents so close that the bits of one operand overlap the other's, or its rounding.
    CloseExponents,
    /// Magnitudes a few ulps apart.
    NearCancellation,
    /// Sums and products near the least and the greatest number.
    RangeEdge,
    /// Fractions with few or with almost all bits set: ties and long carries.
    FewBits,
}

const DISTRIBUTIONS: [Distribution; 5] = [
    Distribution::Uniform,
    Distribution::CloseExponents,
    Distribution::NearCancellation,
    Distribution::RangeEdge,
    Distribution::FewBits,
];

impl Distribution {
    fn pair(self, format: Format, rng: &mut Rng) -> (u64, u64) {
        let any = |rng: &mut Rng| rng.u64(..1 << format.width());
        let reach = format.fraction_bits() as i64 + 3;
        let last = format.exponent_mask() as i64 - 1;
        let bias = i64::from(format.bias());
        let with_exponent = |bits: u64, exponent: i64| {
            let exponent = exponent.clamp(0, last + 1) as u64;
            bits & !format.infinity() | exponent << format.fraction_bits()
        };
        let exponent = |bits: u64| (bits >> format.fraction_bits() & format.exponent_mask()) as i64;
        let (a, b) = (any(rng), any(rng));
        match self {
            Distribution::Uniform => (a, b),
            Distribution::CloseExponents => {
                (a, with_exponent(b, exponent(a) + rng.i64(-reach..=reach)))
            }
            Distribution::NearCancellation => {
                let magnitude = (a & !format.sign_bit()) as i64 + rng.i64(-8..=8);
                let magnitude = magnitude.clamp(0, format.sign_bit() as i64 - 1) as u64;
                (a, b & format.sign_bit() | magnitude)
            }
            Distribution::RangeEdge => {
                let near = rng.i64(-3..=3);
                match rng.u8(..4) {
                    0 => (a, with_exponent(b, bias + 1 - exponent(a) + near)),
                    1 => (a, with_exponent(b, bias + last - exponent(a) + near)),
                    2 => {
                        let mut low = |bits| with_exponent(bits, rng.i64(1..=reach));
                        (low(a), low(b))
                    }
                    _ => {
                        let mut high = |bits| with_exponent(bits, last - rng.i64(0..=reach));
                        (high(a), high(b))
                    }
                }
            }
            Distribution::FewBits => {
                let mut few = |bits: u64| {
                    let mut fraction = 0;
                    for _ in 0..rng.u32(0..4) {
                        fraction |= 1 << rng.u32(0..format.fraction_bits());
                    }
                    if rng.bool() {
                        fraction ^= format.fraction_mask();
                    }
                    bits & !format.fraction_mask() | fraction
                };
                let (a, b) = (few(a), few(b));
                (a, with_exponent(b, exponent(a) + rng.i64(-reach..=reach)))
            }
        }
    }
}

fn check_random_pairs(format: Format, count: u64) {
    let bench = Bench::new(format);
    for distribution in DISTRIBUTIONS {
        let what = format!("{format} binary operations, {distribution:?} pairs");
        check_random(&what, count, |rng| {
            let (a, b) = distribution.pair(format, rng);
            bench.binary(a, b)
        });
    }
}

fn check_special_pairs(format: Format) {
    let bench = Bench::new(format);
    let list = specials(format);
    let count = list.len() as u64;
    check_all(
        &format!("{format} binary operations, all pairs of {count} special operands"),
        count * count,
        |index| {
            let (a, b) = (index / count, index % count);
            bench.binary(list[a as usize], list[b as usize])
        },
    );
}

#[test]
fn fp24_unary_operations_on_all_patterns() {
    let bench = Bench::new(Format::FP24);
    check_all(
        "fp24 reciprocal, steps by −3 to 3 ulps, conversions of all patterns",
        1 << 24,
        |a| bench.unary(a),
    );
}

#[test]
fn fp24_rounding_at_all_boundaries() {
    let format = Format::FP24;
    let bench = Bench::new(format);
    let beside =
        |value: f64, towards: i64| f64::from_bits((value.to_bits() as i64 + towards) as u64);
    check_all(
        "fp24 rounding of the midpoint beyond every number and of its two f64 neighbours",
        format.infinity() - format.least_normal(),
        |offset| {
            let below = format.least_normal() + offset;
            let above = below + 1;
            let even = if below & 1 == 0 { below } else { above };
            let value = format.to_f64(below);
            let midpoint = value + bench.hardware.ulp(value) / 2.0;
            for (input, expected) in [
                (beside(midpoint, -1), below),
                (midpoint, even),
                (beside(midpoint, 1), above),
            ] {
                bench.rounding(input)?;
                for (input, expected) in [(input, expected), (-input, format.sign_bit() | expected)]
                {
                    let rounded = format.round_to_bits(input);
                    if rounded != expected {
                        return Err(format!("{input:e} is {rounded:#x}, not {expected:#x}"));
                    }
                }
            }
            Ok(())
        },
    );
    // Below the least number rounding has an unbounded exponent: the midpoint is a quarter of an ulp away.
    let least = format.to_f64(format.least_normal());
    let midpoint = least - bench.hardware.ulp(least) / 4.0;
    assert_eq!(format.round_to_bits(midpoint), format.least_normal());
    assert_eq!(format.round_to_bits(beside(midpoint, -1)), 0);
    assert_eq!(format.round_to_bits(-beside(midpoint, -1)), 0);
}

#[test]
fn fp24_binary_operations_on_random_pairs() {
    check_random_pairs(Format::FP24, 2_400_000);
}

#[test]
fn fp24_binary_operations_on_all_special_pairs() {
    let count = specials(Format::FP24).len();
    assert!(count >= 2000, "{count} special operands are too few");
    check_special_pairs(Format::FP24);
}

#[test]
fn ten_bit_format_on_all_pairs() {
    let format = format(4, 5);
    let bench = Bench::new(format);
    check_all(&format!("{format} unary operations"), 1 << 10, |a| {
        bench.unary(a)
    });
    check_all(
        &format!("{format} binary operations, all pairs"),
        1 << 20,
        |pair| bench.binary(pair >> 10, pair & 0x3ff),
    );
}

#[test]
fn ten_bit_format_steps_of_any_length() {
    let format = format(4, 5);
    let bench = Bench::new(format);
    // All numbers in order, with the zeros once.
    let mut line: Vec<u64> = (0..1 << 10)
        .filter(|&bits| {
            !bench.hardware.value(bits).is_nan() && bench.hardware.canonical(bits) == bits
        })
        .filter(|&bits| bits != format.sign_bit())
        .collect();
    line.sort_by(|&a, &b| bench.hardware.value(a).total_cmp(&bench.hardware.value(b)));
    let last = line.len() as i64 - 1;
    let lengths: Vec<i32> = (-1000..=1000)
        .chain([i32::MIN, i32::MIN + 1, i32::MAX - 1, i32::MAX])
        .collect();
    check_all(
        &format!("{format} steps by {} lengths", lengths.len()),
        line.len() as u64 * lengths.len() as u64,
        |case| {
            let place = case as usize / lengths.len();
            let ulps = lengths[case as usize % lengths.len()];
            let finite = place != 0 && place as i64 != last;
            let end = place as i64 + if finite { i64::from(ulps) } else { 0 };
            let expected = line[end.clamp(0, last) as usize];
            let plain = plain::step(format, line[place], ulps);
            let fast = format.to_bits(bench.fast.step(format.to_f64(line[place]), ulps));
            if plain != expected || fast != expected {
                return Err(format!(
                    "{:#x} by {ulps}: plain {plain:#x}, fast {fast:#x}, not {expected:#x}",
                    line[place]
                ));
            }
            Ok(())
        },
    );
}

#[test]
fn extreme_formats_on_random_and_special_operands() {
    for format in extreme_formats() {
        let bench = Bench::new(format);
        check_random_pairs(format, 60_000);
        check_random(&format!("{format} unary operations"), 300_000, |rng| {
            bench.unary(rng.u64(..1 << format.width()))
        });
        let list = specials(format);
        check_all(
            &format!("{format} unary operations, special operands"),
            list.len() as u64,
            |i| bench.unary(list[i as usize]),
        );
    }
    check_special_pairs(format(10, 23));
    check_special_pairs(format(3, 2));
}

#[test]
fn every_format_on_random_operands() {
    const ROUNDS: u64 = 10_000;
    let benches: Vec<Bench> = every_format().map(Bench::new).collect();
    let what = format!("all operations, of {} formats", benches.len());
    check_random(&what, benches.len() as u64 * ROUNDS, |rng| {
        let bench = &benches[rng.usize(..benches.len())];
        let distribution = DISTRIBUTIONS[rng.usize(..DISTRIBUTIONS.len())];
        let (a, b) = distribution.pair(bench.format, rng);
        bench.binary(a, b)?;
        bench.unary(a)?;
        let ulps = rng.i32(..) >> rng.u32(..32);
        let plain = plain::step(bench.format, a, ulps);
        let fast = bench.fast.step(bench.format.to_f64(a), ulps);
        match bench.format.to_bits(fast) {
            fast if fast == plain => Ok(()),
            fast => Err(format!(
                "{} step of {a:#x} by {ulps}: plain {plain:#x}, fast {fast:#x}",
                bench.format
            )),
        }
    });
}

#[test]
fn rounding_any_f64_and_f32() {
    for format in extreme_formats() {
        let bench = Bench::new(format);
        let shift = 52 - format.fraction_bits();
        check_random(&format!("{format} rounding of any f64"), 250_000, |rng| {
            bench.rounding(f64::from_bits(rng.u64(..)))
        });
        check_random(
            &format!("{format} rounding of an f64 in or about the range"),
            250_000,
            |rng| {
                let reach = format.bias() + 4;
                let exponent = (1023 + rng.i32(-reach..=reach)) as u64;
                let mut fraction = rng.u64(..1 << 52);
                // Half of them are ties or neighbours of a tie in `f64`.
                if rng.bool() {
                    fraction = fraction >> shift << shift | 1 << (shift - 1);
                    fraction = fraction.saturating_add_signed(rng.i64(-1..=1));
                }
                let sign = u64::from(rng.bool()) << 63;
                bench.rounding(f64::from_bits(sign | exponent << 52 | fraction))
            },
        );
        check_random(&format!("{format} rounding of any f32"), 250_000, |rng| {
            let single = f32::from_bits(rng.u32(..));
            bench.rounding(single.into())?;
            let (bits, expected) = (
                format.round_f32_to_bits(single),
                bench.hardware.round(single.into()),
            );
            if bits != expected {
                return Err(format!("f32 {single:e} is {bits:#x}, not {expected:#x}"));
            }
            Ok(())
        });
    }
}

/// Corner cases of the definition with results computed by hand, which are independent of the oracles' reading of it.
#[test]
fn named_corners() {
    const F: Format = Format::FP24;
    let (one, least, greatest, infinity, nan) = (
        F.one(),
        F.least_normal(),
        F.greatest(),
        F.infinity(),
        F.nan(),
    );
    let minus = F.sign_bit();
    assert_eq!(
        (one, least, greatest, infinity, nan, minus),
        (
            0x3f_0000, 0x01_0000, 0x7e_ffff, 0x7f_0000, 0x7f_8000, 0x80_0000
        )
    );
    type Binary = fn(Format, u64, u64) -> u64;
    let cases: &[(&str, Binary, u64, u64, u64)] = &[
        ("−0 + −0 is stored as +0", plain::add, minus, minus, 0),
        ("x − x is +0", plain::sub, one, one, 0),
        ("∞ − ∞", plain::sub, infinity, infinity, nan),
        ("∞ + −∞", plain::add, infinity, minus | infinity, nan),
        ("∞ + NaN", plain::add, infinity, nan, nan),
        (
            "−∞ + greatest",
            plain::add,
            minus | infinity,
            greatest,
            minus | infinity,
        ),
        ("0 × ∞", plain::mul, 0, infinity, nan),
        ("−1 × 0 is stored as +0", plain::mul, minus | one, 0, 0),
        (
            "−∞ × −1",
            plain::mul,
            minus | infinity,
            minus | one,
            infinity,
        ),
        (
            "a NaN pattern is the NaN",
            plain::mul,
            minus | infinity | 1,
            one,
            nan,
        ),
        (
            "a stored exponent of 0 is a zero",
            plain::mul,
            0xffff,
            infinity,
            nan,
        ),
        (
            "greatest + half an ulp is a tie, and ∞",
            plain::add,
            greatest,
            0x6d_0000,
            infinity,
        ),
        (
            "greatest + less than half an ulp",
            plain::add,
            greatest,
            0x6c_ffff,
            greatest,
        ),
        ("least × ½ underflows", plain::mul, least, 0x3e_0000, 0),
        (
            "−least × ½ underflows to +0",
            plain::mul,
            minus | least,
            0x3e_0000,
            0,
        ),
        // (2 − 2⁻¹⁶) · ½ · 2⁻⁶² has 17 significant bits: it is below the least number.
        (
            "below least, not rounded up to it",
            plain::mul,
            least + 0xffff,
            0x3e_0000,
            0,
        ),
        // (1 + 2⁻¹⁶)·(1 − 2⁻¹⁶)·2⁻⁶² = (1 − 2⁻³²)·2⁻⁶² rounds to 2⁻⁶² with unbounded exponent.
        (
            "rounded up to least",
            plain::mul,
            least + 1,
            0x3e_fffe,
            least,
        ),
        (
            "1 + 2⁻¹⁷ is a tie to even, down",
            plain::add,
            one,
            0x2e_0000,
            one,
        ),
        (
            "1 + 2⁻¹⁶ + 2⁻¹⁷ is a tie to even, up",
            plain::add,
            one + 1,
            0x2e_0000,
            one + 2,
        ),
        ("a NaN does not replace a bound", plain::min, one, nan, one),
        ("a NaN bound is not replaced", plain::max, nan, one, nan),
        ("equal zeros: the bound stays", plain::min, 0, minus, 0),
        ("equal zeros: the bound stays", plain::max, minus, 0, minus),
        (
            "min(∞, −∞)",
            plain::min,
            infinity,
            minus | infinity,
            minus | infinity,
        ),
    ];
    for &(name, operation, a, b, expected) in cases {
        let result = operation(F, a, b);
        assert_eq!(result, expected, "{name}: {result:#x}, not {expected:#x}");
    }
    for (name, value, ulps, expected) in [
        ("beyond +0", 0, 1, least),
        ("beyond −0", minus, 1, least),
        ("below +0", 0, -1, minus | least),
        ("across zero", minus | least, 2, least),
        ("onto zero", minus | least, 1, 0),
        ("−0 by none", minus, 0, 0),
        ("to ∞", greatest, 1, infinity),
        ("far beyond ∞", greatest, i32::MAX, infinity),
        ("to −∞", minus | greatest, -3, minus | infinity),
        ("∞ does not step", infinity, -1, infinity),
        ("−∞ does not step", minus | infinity, 1, minus | infinity),
        ("NaN does not step", minus | nan, 1, nan),
        ("over a power of two", one, -1, one - 1),
    ] {
        let result = plain::step(F, value, ulps);
        assert_eq!(
            result, expected,
            "step {name}: {result:#x}, not {expected:#x}"
        );
    }
    for (name, value, expected) in [
        ("1 ÷ 1", one, one),
        ("1 ÷ 0", 0, infinity),
        ("1 ÷ −0", minus, minus | infinity),
        ("1 ÷ −∞ is stored as +0", minus | infinity, 0),
        ("1 ÷ 3 = 1.0101…01|0101…₂ · 2⁻²", 0x40_8000, 0x3d_5555),
        ("1 ÷ 2⁻⁶² is the power 2⁶²", least, 0x7d_0000),
        ("1 ÷ 2⁶³ underflows", 0x7e_0000, 0),
        ("1 ÷ 2⁶² is least", 0x7d_0000, least),
        ("1 ÷ (2⁶² + 1 ulp) underflows", 0x7d_0001, 0),
    ] {
        let result = plain::reciprocal(F, value);
        assert_eq!(result, expected, "{name}: {result:#x}, not {expected:#x}");
    }
}
