//! Tests of the hardware-construction layer: messages, pipelines, printed text, its simulation, and changes.

mod changes;
mod mistakes;
mod pipelines;
mod readme;
mod simulation;
mod text;
