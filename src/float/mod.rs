//! The machine's numbers: a parameterised binary floating-point format and its arithmetic.
//!
//! A number has 1 sign bit, `exponent_bits` (bias 2^(e−1) − 1) and `fraction_bits`. Results are rounded to
//! nearest even with an unbounded exponent. Results below the least normal number then become zero, and results above the
//! greatest number become infinity. There are no subnormals, neither as operands nor as results. Infinities are those of
//! IEEE 754. There is one NaN. A result of −0 is stored as +0. `docs/arithmetic.md` is normative.
//!
//! Tests compare two implementations: [`Arithmetic`], which is fast and represents a number exactly in an
//! `f64`, and [`plain`], which uses only integers on bit patterns and follows the definition.

mod fast;
mod format;
pub mod plain;
mod specials;

pub use fast::Arithmetic;
pub use format::{Format, FormatError};
pub use specials::specials;
