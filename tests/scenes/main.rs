//! Scenes and animations from files and from the program.

mod animation;
mod corpus;
mod scenes;
#[path = "../support/mod.rs"]
mod support;
