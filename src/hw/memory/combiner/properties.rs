//! Properties of the write combiner.

use super::{Contents, Inputs, Lines, Next, Outputs, Sizes, Stage, Stream};
use crate::hdl::prefetch::Occupancy;
use crate::hdl::{Builder, Signal};

/// The unit's parts.
pub(super) struct Unit<'a, 'b> {
    pub m: &'b Builder,
    pub sizes: &'a Sizes,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub lines: &'a Lines<'b>,
    pub stage: &'a Stage<'b>,
    pub contents: &'a Contents<'b>,
    pub next: &'a Next<'b>,
    pub stream: &'a Stream<'b>,
    pub outstanding: &'a Occupancy<'b>,
}

pub(super) fn keeps(unit: &Unit<'_, '_>) {
    let _ = unit;
}
