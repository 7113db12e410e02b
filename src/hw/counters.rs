//! Registers that count from where a start sets them.

use crate::hdl::{Reg, Signal};

/// A start, and the value that it sets a register to.
type Start<'b> = (Signal<'b>, Signal<'b>);

/// One more with each `step`.
#[track_caller]
pub(super) fn counts_up<'b>(register: Reg<'b>, (start, first): Start<'b>, step: Signal<'b>) {
    let one = start.module().lit(1u8, register.q.width());
    register.next_when(start | step, start.mux(first, register.q + one));
}

/// One less with each `step`.
#[track_caller]
pub(super) fn counts_down<'b>(register: Reg<'b>, (start, first): Start<'b>, step: Signal<'b>) {
    let one = start.module().lit(1u8, register.q.width());
    register.next_when(start | step, start.mux(first, register.q - one));
}
