//! Scenes and animations from files, and built-in ones.

mod animation;
mod corpus;
mod film;
mod scenes;
#[path = "../support/mod.rs"]
mod support;
