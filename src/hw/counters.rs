//! Counters with a start value.

use crate::hdl::{Reg, Signal};

/// The start signal and the start value.
type Start<'b> = (Signal<'b>, Signal<'b>);

/// Counts up by 1 with each `step`.
#[track_caller]
pub(super) fn counts_up<'b>(register: Reg<'b>, (start, first): Start<'b>, step: Signal<'b>) {
    let one = start.module().lit(1u8, register.q.width());
    register.next_when(start | step, start.mux(first, register.q + one));
}

/// Counts down by 1 with each `step`.
#[track_caller]
pub(super) fn counts_down<'b>(register: Reg<'b>, (start, first): Start<'b>, step: Signal<'b>) {
    let one = start.module().lit(1u8, register.q.width());
    register.next_when(start | step, start.mux(first, register.q - one));
}
