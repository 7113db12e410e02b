//! Extraction of the fields of numbers, and assembly of results.

use crate::float::Format;
use crate::hdl::Signal;

/// The fields of a number.
#[derive(Clone, Copy)]
pub(super) struct Fields<'b> {
    pub sign: Signal<'b>,
    pub exponent: Signal<'b>,
    pub fraction: Signal<'b>,
    /// Exponent and fraction: an integer that grows with the number's magnitude.
    pub magnitude: Signal<'b>,
}

pub(super) fn fields<'b>(format: Format, number: Signal<'b>) -> Fields<'b> {
    Fields {
        sign: number.part("sign", format.width() - 1, 1),
        exponent: number.part("exponent", format.fraction_bits(), format.exponent_bits()),
        fraction: number.part("fraction", 0, format.fraction_bits()),
        magnitude: number.part("magnitude", 0, format.width() - 1),
    }
}

/// The fields of an operand of a module. Their names in the Verilog begin with that of the operand.
pub(super) fn operand<'b>(format: Format, name: &str, number: Signal<'b>) -> Fields<'b> {
    let Fields {
        sign,
        exponent,
        fraction,
        magnitude,
    } = fields(format, number);
    Fields {
        sign: sign.named(format!("{name}_sign")),
        exponent: exponent.named(format!("{name}_exponent")),
        fraction: fraction.named(format!("{name}_fraction")),
        magnitude: magnitude.named(format!("{name}_magnitude")),
    }
}

/// The special cases of a result. At most one of `infinity_or_nan` and `zero` is set; a NaN sets `infinity_or_nan` too.
#[derive(Clone, Copy)]
pub(super) struct Special<'b> {
    pub infinity_or_nan: Signal<'b>,
    pub nan: Signal<'b>,
    pub zero: Signal<'b>,
}

/// The canonical pattern of a result, with one four-input LUT per bit.
pub(super) fn pack<'b>(
    sign: Signal<'b>,
    exponent: Signal<'b>,
    fraction: Signal<'b>,
    special: Special<'b>,
) -> Signal<'b> {
    let m = sign.module();
    let Special {
        infinity_or_nan,
        nan,
        zero,
    } = special;
    let (e, f) = (exponent.width(), fraction.width());
    crate::named! {
        let y_sign = sign & !nan & !zero;
        let y_exponent = infinity_or_nan.repeat(e) | (exponent & (!zero).repeat(e));
        let number_fraction = fraction & (!(infinity_or_nan | zero)).repeat(f);
        let y_fraction = m.concat(&[number_fraction.msb() | nan, number_fraction.low(f - 1)]);
    }
    m.concat(&[y_sign, y_exponent, y_fraction]).named("result")
}
