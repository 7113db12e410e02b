//! The arithmetic units of a machine, for any [`Format`], with pipeline depths for the target clock.
//!
//! | unit | module | ports | computes |
//! |---|---|---|---|
//! | [`add`] | `fp_add`, `fp_sub` | `a`, `b` → `y` | a + b, a − b |
//! | [`mul`] | `fp_mul` | `a`, `b` → `y` | a × b |
//! | [`reciprocal`] | `fp_reciprocal` | `a` → `y` | 1 ÷ a |
//!
//! These are pipelines without control: one set of operands per cycle, with a fixed latency
//! ([`Module::latency`]). Inputs are not registered; outputs are registers. Any bit pattern is a valid
//! operand: a stored exponent of 0 is a zero with any fraction, and so on; results are canonical and never −0.
//! `docs/arithmetic.md` is normative, [`crate::float::plain`] the model.
//!
//! Comparisons ([`less`], [`less_equal`], [`equal`]) and steps by ulps ([`step()`]) are
//! combinational and become part of the caller's module. The caller adds registers where needed.
//!
//! # Depth
//!
//! The steps of a unit are distributed over the fewest stages that the clock allows, by a table of delays (`schedule.rs`) of an
//! ECP5 of the slowest grade, with a margin of a fifth of the period and at least 2 ns. Depths for [`Format::FP24`]:
//!
//! | clock, MHz | add, sub | mul | reciprocal |
//! |---|---|---|---|
//! | 50 | 3 | 2 | 5 |
//! | 66 | 3 | 2 | 7 |
//! | 100 | 5 | 3 | 12 |
//! | 133 | 9 | 4 | 18 |
//! | 200 | 13 | 4 | 34 |
//!
//! Measurements for [`Format::FP24`]: LUT4, flip-flops and DSP48 of a Virtex-4 by Yosys, and the register-to-register clock on an
//! ECP5-85F of the slowest grade by nextpnr.
//!
//! | unit | for 66 MHz | for 100 MHz | for 133 MHz |
//! |---|---|---|---|
//! | add | 327 / 105 / 0, 87 MHz | 343 / 173 / 0, 132 MHz | 321 / 328 / 0, 176 MHz |
//! | mul | 89 / 71 / 1, 101 MHz | 89 / 102 / 1, 139 MHz | 89 / 131 / 1, 187 MHz |
//! | reciprocal | 377 / 345 / 0, 81 MHz | 431 / 609 / 0, 120 MHz | 324 / 906 / 0, 172 MHz |
//!
//! Combinational functions, in LUT4: less 56, equal 33, min or max 81, a step of three ulps 63 to 78. Comparisons of operands with
//! [`Known`] facts are smaller.

pub mod add;
mod compare;
mod fields;
pub mod mul;
pub mod reciprocal;
mod schedule;
mod step;

pub use compare::{
    Knowing, Known, Operand, equal, goes_before, is_finite, is_nan, is_zero, less, less_equal,
};
pub use step::step;
pub(super) use step::step_up_or_down;

use crate::float::Format;
use crate::hdl::{HdlError, Module, Signal};
use std::sync::Arc;

/// The modules of a machine's arithmetic units, each described once.
#[derive(Clone)]
pub struct Units {
    pub format: Format,
    /// The target clock of the units, in MHz.
    pub clock_mhz: u32,
    pub add: Arc<Module>,
    pub sub: Arc<Module>,
    pub mul: Arc<Module>,
    pub reciprocal: Arc<Module>,
}

impl Units {
    /// # Errors
    /// A mistake in the description of a unit; none is known for any format.
    pub fn new(format: Format, clock_mhz: u32) -> Result<Units, HdlError> {
        Ok(Units {
            format,
            clock_mhz,
            add: add::module(format, clock_mhz, false)?,
            sub: add::module(format, clock_mhz, true)?,
            mul: mul::module(format, clock_mhz)?,
            reciprocal: reciprocal::module(format, clock_mhz)?,
        })
    }

    /// Instantiates a + b as `name` in the module of the operands.
    #[track_caller]
    pub fn add<'b>(&self, name: impl AsRef<str>, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
        self.binary(&self.add, name, a, b)
    }

    /// Instantiates a − b as `name` in the module of the operands.
    #[track_caller]
    pub fn sub<'b>(&self, name: impl AsRef<str>, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
        self.binary(&self.sub, name, a, b)
    }

    /// Instantiates a × b as `name` in the module of the operands.
    #[track_caller]
    pub fn mul<'b>(&self, name: impl AsRef<str>, a: Signal<'b>, b: Signal<'b>) -> Signal<'b> {
        self.binary(&self.mul, name, a, b)
    }

    /// Instantiates 1 ÷ a as `name` in the module of the operand.
    #[track_caller]
    pub fn reciprocal<'b>(&self, name: impl AsRef<str>, a: Signal<'b>) -> Signal<'b> {
        let ports = unary::ports(self.format);
        let inputs = unary::Inputs { a };
        ports.place(name, a.module(), &self.reciprocal, inputs).y
    }

    #[track_caller]
    fn binary<'b>(
        &self,
        module: &Arc<Module>,
        name: impl AsRef<str>,
        a: Signal<'b>,
        b: Signal<'b>,
    ) -> Signal<'b> {
        let ports = binary::ports(self.format);
        ports
            .place(name, a.module(), module, binary::Inputs { a, b })
            .y
    }
}

/// The ports of a unit with one operand.
mod unary {
    use super::Format;

    crate::interface! {
        pub (format: Format) {
            in "" { a: format.width() }
            out "" { y: format.width() }
        }
    }
}

/// The ports of a unit with two operands.
mod binary {
    use super::Format;

    crate::interface! {
        pub (format: Format) {
            in "" { a: format.width(), b: format.width() }
            out "" { y: format.width() }
        }
    }
}
