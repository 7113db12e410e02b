//! Ray store: the data of a ray for tests and transformations, by packet and slot.

use super::issue::Slot;
use super::stages::Stages;
use super::{Inputs, Kept, World};
use crate::hdl::{Builder, Flow, Memory, Signal, Signals, Specs, Style};
use crate::hw::plan::Plan;
use crate::hw::ray::{Interval, Limits, Tested, Vector};

/// The data that a slot reads of its ray.
pub(super) struct Rays<'b> {
    /// At stage [`Plan::read_latency`].
    pub tested: Tested<Signal<'b>>,
    pub direction: [Signal<'b>; 3],
    /// At [`Stages::window`]: the interval that clips a test; in object space, the interval in the instance.
    pub window: Interval<Signal<'b>>,
    /// At [`Stages::limits`].
    pub kept: Kept<Signal<'b>>,
    /// At [`Stages::shear_z`].
    pub shear_z: Option<Signal<'b>>,
    /// At [`Stages::object`]: the interval that limits the ray in the object of the instance.
    pub own_window: Interval<Signal<'b>>,
    pub own_limits: Limits<Signal<'b>>,
    /// The intervals in the boxes of instances, written when their box slots leave the test.
    pub windows: Memory<'b>,
}

/// Writes rays from ray setup, and reads them for slots. The limits and the direction in world space are kept while a ray is
/// in object space; all other data is stored per space.
pub(super) fn keep<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    slot: &Slot<'b>,
    stages: &Stages,
) -> Rays<'b> {
    m.comment("Rays from ray setup.");
    let w = plan.number();
    let by_ray = plan.rays_in_flight();
    let by_level_ray = plan.level_rays_in_flight();
    let (tested, limits) = (Tested::of(plan), Kept::of(plan));
    let Flow { valid, payload } = inputs.setup;
    let index = plan.ray_index(payload.packet, payload.ray);
    let index = index.hinted("setup_index");
    let level_index = payload.object.concat(index);
    let of_world = (valid & !payload.object).named("setup_of_world");
    let tests = m.memory("ray_memory", by_level_ray, tested.width(), Style::Block);
    tests.write(valid, level_index, tested.pack(payload.tested));
    let kept = m.memory("ray_limit_memory", by_ray, limits.width(), Style::Block);
    kept.write(of_world, index, limits.pack(payload.kept));
    let shear_z = stages.shear_z.zip(inputs.setup_shear_z);
    let shear_z = shear_z.map(|(stage, shear)| {
        let memory = m.memory("shear_memory", by_level_ray, w, Style::Block);
        memory.write(valid, level_index, shear);
        (memory, stage)
    });

    let read = plan.read_latency();
    let tested = tested
        .unpack(plan.read(tests, slot.level_index))
        .named("ray");
    let direction = match (inputs.world, tested.direction) {
        (Some(world), _) => world_direction(plan, m, world, slot),
        (None, Some(direction)) => direction,
        (None, None) => unreachable!("the test needs no direction only if it is watertight"),
    };
    let window = Interval::of(plan);
    let windows = m.memory("window_memory", by_ray, window.width(), Style::Block);
    let infinity = plan.infinity(m);
    let minus_infinity = plan.minus_infinity(m);
    let no_window = window.pack(Interval {
        near: minus_infinity,
        far: infinity,
    });
    let at = stages.window - read;
    let clips = plan.read_where(windows, slot.index.at(at), slot.inside.at(at), no_window);
    let by_ray = |memory, stage: u32| plan.read(memory, slot.index.at(stage - read));
    Rays {
        tested,
        direction,
        window: window.unpack(clips).named("window"),
        kept: limits.unpack(by_ray(kept, stages.limits)).named("ray"),
        shear_z: shear_z.map(|(memory, stage)| {
            let index = slot.level_index.at(stage - read);
            plan.read(memory, index).named("ray_shear_z")
        }),
        own_window: window.unpack(by_ray(windows, stages.object)).named("own"),
        own_limits: limits
            .unpack(by_ray(kept, stages.object))
            .limits
            .named("own"),
        windows,
    }
}

/// The direction of a ray in world space, in the configuration whose test does not need it.
fn world_direction<'b>(
    plan: &Plan,
    m: &'b Builder,
    world: Flow<World<Signal<'b>>, Signal<'b>>,
    slot: &Slot<'b>,
) -> [Signal<'b>; 3] {
    let vector = Vector::of(plan);
    let rays = plan.rays_in_flight();
    let memory = m.memory("direction_memory", rays, vector.width(), Style::Block);
    let World {
        packet,
        ray,
        direction: axes,
    } = world.payload;
    let index = plan.ray_index(packet, ray);
    memory.write(world.valid, index, vector.pack(Vector { axes }));
    vector
        .unpack(plan.read(memory, slot.index))
        .named("ray_world_direction")
        .axes
}
