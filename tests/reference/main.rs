//! The golden model and its references: arithmetic, trees, traversal by brute force, update programs.

mod arithmetic;
mod laws;
mod program;
#[path = "../support/mod.rs"]
mod support;
mod tree;
mod two_levels;
