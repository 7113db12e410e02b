//! The B-KD tree. [`build`](mod@build) creates a [`Tree`] for a mesh, and [`Tree::refit`] computes its bounds. [`layout`] defines
//! the positions in memory and creates the [`MemoryImage`] that golden model and RTL read. [`InstancedImage`] adds a
//! top-level tree over instances of objects.
//!
//! A node has one interval on one axis for each of its two children. A leaf is one triangle.

pub mod build;
pub mod bytes;
mod instances;
pub mod layout;
pub mod quality;
pub mod stats;
mod tree;

pub use build::{BuildOptions, SortKeys, SplitCost, build, build_over_boxes};
pub use instances::{InstanceSpec, InstancedImage, ObjectPlace, TopPlace, WIDENING};
pub use layout::{
    Columns, Field, Influence, InstanceRecord, LINK_BITS, LinkWord, MemoryImage, Node, Placement,
    Record, Target, TriangleRecord,
};
pub use quality::Quality;
pub use tree::{Bounds, Child, Refit, Tree, TreeNode};
