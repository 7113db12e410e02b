//! The machine's numbers: a parameterised binary floating-point format and its arithmetic.
//!
//! A number has 1 sign bit, `exponent_bits` (bias 2^(e−1) − 1) and `fraction_bits`. Results are rounded to
//! nearest even with unbounded exponent; then below the least normal → zero, above the greatest →
//! infinity. There are no subnormals, in or out; infinities are IEEE 754's; there is one NaN; a result of
//! −0 is stored as +0. `docs/arithmetic.md` is normative.
//!
//! Two implementations are kept equal by test: [`Arithmetic`], fast, which carries a number exactly in an
//! `f64`, and [`plain`], on bit patterns with integers only, which reads as the definition does.

mod fast;
mod format;
pub mod plain;
mod specials;

pub use fast::Arithmetic;
pub use format::{Format, FormatError};
pub use specials::specials;
