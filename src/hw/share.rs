//! Lending: a second computation that borrows a pipeline's operators.
//!
//! The slots of a pipeline are of two kinds, told by a bit that enters with each. In an own slot the operators do what
//! the pipeline is for. In a lent slot they compute something else, in the very stages where they are: so slots of both
//! kinds follow each other in any order, one a clock, and never meet. What it costs is a choice before an operand,
//! and nothing where both computations use the same signal; an operator's result serves both.
//!
//! An operand that both take from the same signal is passed to the operator as it is. The others are chosen here:
//! [`Lender::factor`] before a multiplication, [`Lender::term`] before an addition or a subtraction,
//! [`Lender::subtrahend`] before a subtraction that is lent as an addition, [`Lender::choice`] before a register.
//!
//! A level of logic more may be too much for the operator's first stage at a high clock; then a register follows the
//! choice. The pipeline aligns everything else with it, so what is computed is the same for any format and clock.

use super::fp::{Units, add, mul};
use crate::hdl::Signal;

/// Chooses the operands of a pipeline's operators, by the kind of the slot.
pub(super) struct Lender<'b> {
    /// Whether the slot is lent: 1 bit, at the pipeline's stage 0.
    lent: Signal<'b>,
    before_addition: bool,
    before_multiplication: bool,
}

impl<'b> Lender<'b> {
    /// `lent`: whether a slot is lent, 1 bit at stage 0 of the pipeline.
    pub fn new(units: &Units, lent: Signal<'b>) -> Lender<'b> {
        Lender {
            lent,
            before_addition: add::takes_choice(units.format, units.clock_mhz),
            before_multiplication: mul::takes_choice(units.format, units.clock_mhz),
        }
    }

    /// `other` in a lent slot, else `own`; called `name` in the Verilog. A level of logic.
    pub fn choice(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        self.lent.mux(other, own).named(name)
    }

    /// An operand of a multiplication.
    pub fn factor(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        settled(self.choice(name, own, other), self.before_multiplication)
    }

    /// An operand of an addition, or of a subtraction that is lent as such.
    pub fn term(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        settled(self.choice(name, own, other), self.before_addition)
    }

    /// The second operand of a subtraction, which in a lent slot adds `other`.
    pub fn subtrahend(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        self.term(name, own, negated(other))
    }

    /// The second operand of a subtraction, which in a lent slot adds it. Costs one LUT.
    pub fn added(&self, name: &str, operand: Signal<'b>) -> Signal<'b> {
        // Only the sign, which no first stage of a subtractor is in a hurry for.
        (operand.msb() ^ self.lent)
            .concat(operand.low(operand.width() - 1))
            .named(name)
    }
}

fn settled(choice: Signal<'_>, fits: bool) -> Signal<'_> {
    if fits { choice } else { choice.register() }
}

/// The number of opposite sign. Costs nothing.
pub(super) fn negated(number: Signal<'_>) -> Signal<'_> {
    let negated = (!number.msb()).concat(number.low(number.width() - 1));
    negated.hinted_after(number, "negated")
}
