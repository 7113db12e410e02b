//! Object rays: sends transformed rays to ray setup, each with its interval in the instance's box.

use super::issue::Slot;
use super::leaves::Traced;
use super::rays::Rays;
use super::stages::Stages;
use super::{Moved, TransformTrace};
use crate::hdl::{Builder, Flow, Signal, Signals, Specs};
use crate::hw::fp::{Knowing, Known};
use crate::hw::plan::{AXES, Plan};
use crate::hw::ray::{Interval, Limits, Line, Place};
use crate::hw::triangle;

/// A ray in object space, and its valid bit.
pub(super) struct ObjectRay<'b> {
    pub leaves_at: u32,
    pub ray: Flow<Moved<Signal<'b>>, Signal<'b>>,
}

impl<'b> ObjectRay<'b> {
    /// The values of the trace ports.
    pub fn trace(
        &self,
        rays: &Rays<'b>,
        leaves: &Traced<'b>,
    ) -> Flow<TransformTrace<Signal<'b>>, Signal<'b>> {
        let Moved { place, line, .. } = self.ray.payload;
        let trace = TransformTrace {
            packet: place.packet,
            ray: place.ray,
            record: leaves.instance.untimed(),
            window: rays.own_window.at(self.leaves_at).untimed(),
            line,
        };
        Flow::new(self.ray.valid, trace)
    }
}

/// Stores the windows from box slots, and joins direction and origin. A ray leaves one or two registers after [`Stages::object`].
pub(super) fn leave<'b>(
    plan: &Plan,
    m: &'b Builder,
    slot: &Slot<'b>,
    stages: &Stages,
    rays: &Rays<'b>,
    tested: &triangle::Outputs<Signal<'b>>,
) -> ObjectRay<'b> {
    m.comment("The window of a ray is stored when its box slot leaves the test.");
    let new_window = Interval::of(plan)
        .pack(Interval {
            near: tested.box_near,
            far: tested.box_far,
        })
        .untimed();
    rays.windows.write(
        slot.in_box.at(stages.boxed).untimed(),
        slot.index.at(stages.boxed).untimed(),
        new_window,
    );
    m.comment("The direction waits for the origin, which follows one cycle later; then the transformed ray leaves, with its interval.");
    let moved = tested.moved;
    let moved_direction = [0, 1, 2].map(|i| {
        let held = m.reg(format!("moved_direction_{}", AXES[i]), plan.number());
        let comes = slot.direction.at(stages.moved).untimed();
        held.next_when(comes, moved[i].untimed());
        // It is stable until that of the next ray, three cycles later.
        let stage = stages.object.min(stages.moved + 2);
        slot.pipeline.enter_at(held.q, stage)
    });
    let object_near = plan.max(
        "object_near",
        rays.own_limits.tmin.known(Known::Positive),
        rays.own_window.near.known(Known::Number),
    );
    let object_far = plan.min(
        "object_far",
        rays.own_limits.tmax.known(Known::Positive),
        rays.own_window.far.known(Known::Number),
    );
    let leaves_at = object_near.stage() + 1;
    let ray = Moved {
        place: Place {
            packet: slot.packet,
            ray: slot.ray,
            first: slot.first,
            last: slot.last,
        },
        line: Line {
            origin: moved,
            direction: moved_direction,
        },
        limits: Limits {
            tmin: object_near,
            tmax: object_far,
        },
    };
    ObjectRay {
        leaves_at,
        ray: Flow::new(slot.origin, ray).at(leaves_at).untimed(),
    }
}
