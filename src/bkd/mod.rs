//! The B-KD tree: [`build`](mod@build) makes a [`Tree`] of a mesh, [`Tree::refit`] its bounds, [`layout`] says where it lies in
//! memory and makes the [`MemoryImage`] that golden model and RTL read. [`InstancedImage`] puts objects under a top-level
//! tree over their instances.
//!
//! A node holds, for each of its two children, one interval on one axis. One triangle a leaf.

pub mod build;
pub mod bytes;
mod instances;
pub mod layout;
pub mod quality;
pub mod stats;
mod tree;

pub use build::{BuildOptions, SortKeys, SplitCost, build, build_over_boxes};
pub use instances::{InstanceSpec, InstancedImage, ObjectPlace, WIDENING};
pub use layout::{
    Columns, Field, Influence, InstanceRecord, LINK_BITS, LinkWord, MemoryImage, Node, Placement,
    Record, Target, TriangleRecord,
};
pub use quality::Quality;
pub use tree::{Bounds, Child, Refit, Tree, TreeNode};
