//! The stages of the triangle test's inputs and outputs, counted from the cycle in which a slot is issued.

use super::Plan;
use crate::hdl::{Builder, Module, Spec};
use crate::hw::triangle;

/// The stages of the pipeline of slots. A memory is read [`Plan::read_latency`] stages before its word is needed.
pub(super) struct Stages {
    /// The test's first inputs.
    pub test: u32,
    /// The first component of a translation.
    pub translation: u32,
    pub window: u32,
    pub limits: u32,
    pub shear_z: Option<u32>,
    pub weight: u32,
    /// The pairs to add, and `accumulate`.
    pub sums: u32,
    /// A ray's interval in a box.
    pub boxed: u32,
    /// A point moved by a matrix.
    pub moved: u32,
    /// The first stage at which a ray in object space can leave.
    pub object: u32,
    /// The result of a test.
    pub hit: u32,
}

impl Stages {
    pub fn of(plan: &Plan, m: &Builder, test: &Module) -> Stages {
        let read = plan.read_latency();
        // The point is selected from three sources. If the target clock requires it, the test starts one cycle after this multiplexer.
        let start = read + plan.choose_latency();
        let ports = triangle::ports(plan);
        let of = |port: &Spec| port.stage(m, test) + start;
        let (inputs, outputs) = (&ports.inputs, &ports.outputs);
        let translation = inputs.translation.each_ref().map(of);
        let (boxed, moved) = (of(&outputs.box_near), of(&outputs.moved[0]));
        Stages {
            test: start,
            translation: translation.into_iter().min().expect("three axes"),
            window: of(&inputs.window.near),
            limits: of(&inputs.limits.tmin),
            shear_z: inputs.shear_z.as_ref().map(of),
            weight: of(&inputs.weight),
            sums: of(&inputs.accumulate),
            boxed,
            moved,
            // The box slot is two cycles ahead of the origin slot: its window can be read from stage boxed - 1 of the origin slot on.
            object: moved.max(boxed + read - 1),
            hit: of(&outputs.hit),
        }
    }
}
