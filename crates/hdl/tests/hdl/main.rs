//! The hardware-construction layer, from the outside: messages, pipelines, text, what the text computes, and changes.

mod changes;
mod mistakes;
mod pipelines;
mod readme;
mod simulation;
mod text;
