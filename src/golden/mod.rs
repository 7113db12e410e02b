//! The golden model: the function of the machine, exact in all bits, without timing.
//!
//! It is written from `docs/arithmetic.md`, in that page's vocabulary, independently of the RTL. Each file
//! models one unit. Numbers of the machine's format are represented exactly in `f64`.
//!
//! | file | unit |
//! |---|---|
//! | [`setup`] | ray setup: validity, reciprocals, shear, clip to the scene's box |
//! | [`clip`] | the plane distance and the clipping by an interval, used by all units |
//! | [`tpu`] | the packet step, the stack entry and its pop |
//! | [`transform`] | the ray transformation into an instance's object space, and the window |
//! | [`geometry`] | both triangle tests, the interval of the triangle's box, the merge of hits |
//! | [`raycast`] | a packet in all of these units: [`Caster`] |
//! | [`chip`] | the chip: executes a command list on a memory of bytes |
//! | [`registers`] | the chip's register file: what an access reads and changes |
//! | [`skinning`] | the skinning processor: computes vertices from a palette of matrices and influences |
//! | [`update`] | the update processor: computes bounds from vertices by a program |
//! | [`cache`] | a cache: hits, misses, replaced lines, given the order of lookups and answers |
//! | [`brute`] | brute force: every triangle of every instance by the same test, without a tree |
//! | [`oracle`] | an independent `f64` intersector for comparison with pictures |

pub mod brute;
pub mod cache;
pub mod chip;
pub mod clip;
pub mod geometry;
pub mod lanes;
pub mod oracle;
pub mod raycast;
pub mod registers;
pub mod setup;
pub mod skinning;
pub mod tpu;
pub mod transform;
pub mod update;

pub use brute::{BruteForce, brute_force};
pub use geometry::{Closest, Outcome, Triangle};
pub use raycast::{
    Caster, Counts, EnterEvent, FrameResult, HandOver, Observer, PacketResult, PopEvent, PushEvent,
    RaySet, RayTest, StepEvent,
};
pub use setup::RaySetup;
pub use transform::{Instance, Transformed, WHOLE_LINE};

/// Maximum number of rays in a packet.
pub const MOST_RAYS: usize = 8;
