//! Operands: the inputs of the triangle test for each slot, and its results for the skinning processor.

use super::Inputs;
use super::issue::Slot;
use super::rays::Rays;
use super::stages::Stages;
use super::vectors::Vectors;
use crate::hdl::{Builder, Bundle, Flow, Signal};
use crate::hw::plan::{AXES, Plan};
use crate::hw::ray::{Tested, Vector};
use crate::hw::skinning::{Operands, Weighted};
use crate::hw::triangle::{self, Pairs};

/// The inputs of the test. The point of a matrix slot is the origin or the direction of the ray; the skinning processor provides
/// its own points, weights and pairs, at [`Stages::weight`] and [`Stages::sums`].
pub(super) fn operands<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    slot: &Slot<'b>,
    stages: &Stages,
    vectors: Vectors<'b>,
    rays: &Rays<'b>,
) -> triangle::Inputs<Signal<'b>> {
    m.comment("The triangle test, and the operands of the computations that share its operators.");
    let p = slot.pipeline;
    let read = plan.read_latency();
    let is_direction = slot.direction.at(read).named("point_is_direction");
    let influence = inputs.skin_issue.payload.influence;
    let origin = [0, 1, 2].map(|i| {
        let own = is_direction.mux(rays.direction[i], rays.tested.origin[i]);
        let point = p.enter(influence.point.axes[i]).at(read);
        let chosen = slot.skinning_at(read).mux(point, own);
        plan.choose(chosen.named(format!("point_{}", AXES[i])))
    });
    let in_transform = (slot.direction | slot.origin).hinted("in_transform_slot");
    let before = stages.test - 1;
    let matrix = in_transform.at(before) | slot.skinning_at(before);
    let matrix = matrix.hinted("matrix_slot").register();
    let [x, y, z] = inputs.skin.pair;
    let [u, v, t] = inputs.skin.vertex;
    let pairs = [x, y, z, u, v, t].map(|pair| {
        let [a, b] = [pair.a, pair.b].map(|operand| p.enter_at(operand, stages.sums));
        Operands { a, b }
    });
    triangle::Inputs {
        matrix,
        corners: vectors.corners,
        ray: Tested {
            origin,
            ..rays.tested
        },
        translation: vectors.translation,
        weight: p.enter(influence.weight).at(stages.weight),
        window: rays.window,
        limits: rays.kept.limits,
        shear_z: rays.shear_z,
        accumulate: slot.skinning_at(stages.sums),
        pairs: Pairs {
            sum_a: pairs.map(|pair| pair.a),
            sum_b: pairs.map(|pair| pair.b),
        },
    }
}

/// The transformed and weighted point of an influence, when it leaves the test, with the mark of the influence.
pub(super) fn weighted<'b>(
    inputs: &Inputs<Signal<'b>>,
    slot: &Slot<'b>,
    tested: &triangle::Outputs<Signal<'b>>,
) -> Flow<Weighted<Signal<'b>>, Signal<'b>> {
    let p = slot.pipeline;
    let at = tested.weighted[0].stage();
    let influence = inputs.skin_issue;
    let entered = p.enter(influence.valid).cleared_by_reset();
    Flow::new(
        entered.at(at).untimed(),
        Weighted {
            mark: (influence.payload.mark).map(|_, mark| p.enter(mark).at(at).untimed()),
            point: Vector {
                axes: tested.weighted.map(Signal::untimed),
            },
        },
    )
}
