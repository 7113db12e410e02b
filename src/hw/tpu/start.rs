//! Starts of packets, in world space or in object space.

use super::SetUp;
use crate::hdl::{Builder, Flow, Signal};
use crate::hw::plan::Plan;

/// The effect of a ray from ray setup on its packet, in the cycle in which it arrives.
pub(super) struct Start<'b> {
    /// By slot in the packet: whether the arriving ray has this slot.
    pub of_ray: Vec<Signal<'b>>,
    /// The packet's rays so far that enter, including this one.
    pub mask: Signal<'b>,
    /// Whether the ray is the packet's last and at least one ray enters, and whether it is the last and none enters.
    pub goes: Signal<'b>,
    pub nowhere: Signal<'b>,
}

/// Collects the rays of a packet. They arrive one by one, with rays in world space and in object space interleaved in any order; the
/// last one starts the packet. All outputs are in the cycle in which a ray arrives.
pub(super) fn start<'b>(
    m: &'b Builder,
    plan: &Plan,
    setup: Flow<SetUp<Signal<'b>>, Signal<'b>>,
    setup_object: Signal<'b>,
) -> Start<'b> {
    let Flow {
        valid,
        payload: SetUp { place, enters, .. },
    } = setup;
    let rays = plan.rays();
    m.comment(
        "Start in world space or in object space: rays arrive one by one, the last one starts the packet at the root. No pop ends while \
         one arrives. Rays in world space and in object space may alternate.",
    );
    let is_ray: Vec<_> = (0..rays)
        .map(|i| {
            let is_ray = place.ray.equals(u128::from(i));
            is_ray.hinted(format!("setup_ray_is_{i}"))
        })
        .collect();
    let of_ray = is_ray.iter().enumerate();
    let of_ray = of_ray.map(|(i, is_ray)| (valid & *is_ray).named(format!("setup_of_ray{i}")));
    let of_ray = of_ray.collect();
    let bit_in: Vec<_> = is_ray.iter().rev().map(|is_ray| enters & *is_ray).collect();
    let bit_in = m.concat(&bit_in).named("bit_in");
    let gathered = m.reg("gathered", rays);
    let gathered_object = m.reg("gathered_object", rays);
    let so_far = place.first.mux(
        m.zero(rays),
        setup_object.mux(gathered_object.q, gathered.q),
    );
    let so_far = so_far.hinted("gathered_so_far");
    let mask = (so_far | bit_in).named("start_mask");
    gathered.next_when(valid & !setup_object, mask);
    gathered_object.next_when(valid & setup_object, mask);
    let start = (valid & place.last).named("start");
    let any_enters = mask.any().hinted("any_enters");
    Start {
        of_ray,
        mask,
        goes: (start & any_enters).named("start_goes"),
        nowhere: (start & !any_enters).named("start_nowhere"),
    }
}
