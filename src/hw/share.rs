//! Operator sharing: a second computation that uses the operators of a pipeline.
//!
//! The slots of a pipeline are of two kinds, distinguished by a bit that enters with each slot. In an own slot the operators
//! compute the function of the pipeline. In a lent slot they compute another function, at the same stages. So slots of both
//! kinds can follow each other in any order, one per cycle, without conflict. The cost is a multiplexer before an operand, or
//! nothing if both computations use the same signal; both use the result of the operator.
//!
//! An operand that both take from the same signal is connected directly. The others are selected here:
//! [`Lender::factor`] before a multiplication, [`Lender::term`] before an addition or a subtraction,
//! [`Lender::subtrahend`] before a subtraction that is lent as an addition, [`Lender::choice`] before a register.
//!
//! At a high clock the additional level of logic may not fit into the operator's first stage; then a register follows the
//! multiplexer. The pipeline aligns all other signals, so the function is the same for any format and clock.

use super::fp::{Units, add, mul};
use crate::hdl::Signal;

/// Selects the operands of a pipeline's operators by the kind of the slot.
pub(super) struct Lender<'b> {
    /// Whether the slot is lent: 1 bit, at stage 0 of the pipeline.
    lent: Signal<'b>,
    before_addition: bool,
    before_multiplication: bool,
}

impl<'b> Lender<'b> {
    /// Makes the selection. `lent` is 1 bit at stage 0 of the pipeline: whether the slot is lent.
    pub fn new(units: &Units, lent: Signal<'b>) -> Lender<'b> {
        Lender {
            lent,
            before_addition: add::takes_choice(units.format, units.clock_mhz),
            before_multiplication: mul::takes_choice(units.format, units.clock_mhz),
        }
    }

    /// Returns `other` in a lent slot, else `own`; called `name` in the Verilog. It takes one level of logic.
    pub fn choice(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        self.lent.mux(other, own).named(name)
    }

    /// Selects an operand of a multiplication.
    pub fn factor(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        settled(self.choice(name, own, other), self.before_multiplication)
    }

    /// Selects an operand of an addition, or of a subtraction that is a subtraction in lent slots too.
    pub fn term(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        settled(self.choice(name, own, other), self.before_addition)
    }

    /// Selects the second operand of a subtraction; in a lent slot the operator adds `other`.
    pub fn subtrahend(&self, name: &str, own: Signal<'b>, other: Signal<'b>) -> Signal<'b> {
        self.term(name, own, negated(other))
    }

    /// The second operand of a subtraction; in a lent slot the operator adds it. It costs one LUT.
    pub fn added(&self, name: &str, operand: Signal<'b>) -> Signal<'b> {
        // Only the sign changes; it is not on the critical path of a subtractor's first stage.
        (operand.msb() ^ self.lent)
            .concat(operand.low(operand.width() - 1))
            .named(name)
    }
}

fn settled(choice: Signal<'_>, fits: bool) -> Signal<'_> {
    if fits { choice } else { choice.register() }
}

/// The number with the opposite sign. It costs no logic.
pub(super) fn negated(number: Signal<'_>) -> Signal<'_> {
    let negated = (!number.msb()).concat(number.low(number.width() - 1));
    negated.hinted_after(number, "negated")
}
