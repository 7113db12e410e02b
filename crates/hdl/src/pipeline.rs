//! Pipelines with automatic balancing of latencies.

use super::builder::Builder;
use super::signal::Signal;
use std::panic::Location;

/// The pipeline and the stage of a signal.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Stage {
    pub pipeline: u32,
    /// Number of registers since the pipeline's inputs.
    pub at: u32,
}

/// A pipeline of a module.
///
/// A signal in a pipeline has a stage: the number of registers between it and the inputs of the
/// pipeline. An operator that combines signals of different stages delays the earlier ones by
/// pipeline registers, so that all operands belong to the same set of inputs. Signals of two
/// pipelines must not be combined, nor signals with and without a stage; literals go with any.
#[derive(Clone, Copy)]
pub struct Pipeline<'b> {
    pub(super) builder: &'b Builder,
    pub(super) id: u32,
}

impl<'b> Pipeline<'b> {
    /// Declares an input port at stage 0.
    #[track_caller]
    pub fn input(&self, name: impl AsRef<str>, width: u32) -> Signal<'b> {
        self.builder.input_at(
            name.as_ref(),
            width,
            Some(self.stage(0)),
            Location::caller(),
        )
    }

    /// Declares an input port at stage `at`: it is expected `at` cycles after the inputs at stage
    /// 0. An instance of the module delays the signal connected to it accordingly.
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

    /// Declares an input port of one bit at stage 0 that tells whether the other inputs of the
    /// cycle are valid. Reset clears its pipeline registers.
    #[track_caller]
    pub fn valid_input(&self, name: impl AsRef<str>) -> Signal<'b> {
        self.input(name, 1).cleared_by_reset()
    }

    /// Returns a signal that has no stage as a signal at stage 0 of this pipeline.
    #[track_caller]
    pub fn enter(&self, signal: Signal<'b>) -> Signal<'b> {
        self.enter_at(signal, 0)
    }

    /// Returns a signal as a signal at stage `at` of this pipeline, without adding registers. The
    /// caller is responsible for the signal belonging to the inputs of that stage.
    #[track_caller]
    pub fn enter_at(&self, signal: Signal<'b>, at: u32) -> Signal<'b> {
        signal.restaged(Some(self.stage(at)), Location::caller())
    }
}
