//! Pipelines that balance themselves.

use super::builder::Builder;
use super::signal::Signal;
use std::panic::Location;

/// Where in which pipeline of a module a signal is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Stage {
    pub pipeline: u32,
    /// Registers since the pipeline's inputs.
    pub at: u32,
}

/// A pipeline of a module. Signals enter it; whatever is computed from them is aligned by delay registers.
#[derive(Clone, Copy)]
pub struct Pipeline<'b> {
    pub(super) builder: &'b Builder,
    pub(super) id: u32,
}

impl<'b> Pipeline<'b> {
    /// An input port of the module, at stage 0.
    #[track_caller]
    pub fn input(&self, name: impl AsRef<str>, width: u32) -> Signal<'b> {
        self.builder.input_at(
            name.as_ref(),
            width,
            Some(self.stage(0)),
            Location::caller(),
        )
    }

    /// An input port that meets the others at a later stage: an instance's input is delayed until then.
    #[track_caller]
    pub fn input_at(&self, name: impl AsRef<str>, width: u32, at: u32) -> Signal<'b> {
        let stage = Some(self.stage(at));
        self.builder
            .input_at(name.as_ref(), width, stage, Location::caller())
    }

    pub(super) fn stage(&self, at: u32) -> Stage {
        Stage {
            pipeline: self.id,
            at,
        }
    }

    /// A 1-bit input port at stage 0 that says whether what comes with it means anything; reset clears its
    /// delay registers.
    #[track_caller]
    pub fn valid_input(&self, name: impl AsRef<str>) -> Signal<'b> {
        self.input(name, 1).cleared_by_reset()
    }

    /// Brings a signal without a stage into the pipeline, at stage 0.
    #[track_caller]
    pub fn enter(&self, signal: Signal<'b>) -> Signal<'b> {
        self.enter_at(signal, 0)
    }

    /// Brings a signal into the pipeline at a stage: for what is known to be right there.
    #[track_caller]
    pub fn enter_at(&self, signal: Signal<'b>, at: u32) -> Signal<'b> {
        signal.restaged(Some(self.stage(at)), Location::caller())
    }
}
