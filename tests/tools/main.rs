//! Proofs, mutants, synthesis, the baseline, the comparison with Embree.

mod baseline;
mod compare;
mod mutate;
mod prove;
#[path = "../support/mod.rs"]
mod support;
mod synth;
