//! The order in which lines were last opened or closed: one bit for each pair.

use crate::hdl::{Builder, Reg, Signal};

/// For each pair of lines a bit: whether the one with the lower number came first.
pub(super) struct Order<'b> {
    lines: usize,
    /// By lower and higher number.
    pairs: Vec<(usize, usize, Reg<'b>)>,
}

impl<'b> Order<'b> {
    pub fn new(m: &'b Builder, lines: usize) -> Order<'b> {
        let pairs = (0..lines).flat_map(|low| (low + 1..lines).map(move |high| (low, high)));
        let pairs = pairs.map(|(low, high)| {
            let bit = m.reg(format!("line{low}_before{high}"), 1);
            (low, high, bit)
        });
        Order {
            lines,
            pairs: pairs.collect(),
        }
    }

    /// Whether one line came before another.
    pub fn before(&self, line: usize, other: usize) -> Signal<'b> {
        let (low, high) = (line.min(other), line.max(other));
        let mut pairs = self.pairs.iter();
        let pair = pairs.find(|(a, b, _)| (*a, *b) == (low, high));
        let bit = pair.expect("a bit for each pair").2.q;
        if line < other { bit } else { !bit }
    }

    /// Whether a line is one of some lines and came before all others of them. `kind` is a name for these lines.
    pub fn is_oldest(&self, kind: &str, line: usize, among: &[Signal<'b>]) -> Signal<'b> {
        let others = (0..self.lines).filter(|other| *other != line);
        let first = others.map(|other| !among[other] | self.before(line, other));
        let first: Vec<_> = first.collect();
        let m = among[line].module();
        let first = m.and_all(&first);
        among[line] & first.hinted(format!("{kind}{line}_is_first"))
    }

    /// Drives the bits. `newest` tells for each line whether it becomes the newest; at most one does.
    pub fn drive(&self, newest: &[Signal<'b>]) {
        for (low, high, bit) in &self.pairs {
            bit.next_when(newest[*low] | newest[*high], newest[*high]);
        }
    }
}
