//! Output of hits.

use crate::hdl::fifo::Placed;
use crate::hdl::{Builder, Flow, HdlError, Signal, Specs};
use crate::hw::plan::Plan;
use crate::hw::ray::Hit;
use crate::hw::tpu::Finished;

/// The packet whose hits are output, and the current hit.
pub(super) struct Hits<'b> {
    pub finished: Placed<'b>,
    /// Whether the next finished packet is loaded.
    pub load: Signal<'b>,
    /// The current packet and its hit mask, as one word, and its valid bit.
    pub out: Signal<'b>,
    pub out_valid: Signal<'b>,
    pub packet: Signal<'b>,
    /// The ray whose hit is output, and the ray whose hit is read.
    pub ray: Signal<'b>,
    pub next_ray: Signal<'b>,
    pub taken: Signal<'b>,
    /// Whether the packet's last hit is accepted.
    pub leaves: Signal<'b>,
    pub hit: Flow<Hit<Signal<'b>>, Signal<'b>>,
}

/// Outputs the hits of finished packets, ray by ray. `read` is the closest hit of the packet's next ray, one cycle after its address.
pub(super) fn hits<'b>(
    m: &'b Builder,
    plan: &Plan,
    finished: Flow<Finished<Signal<'b>>, Signal<'b>>,
    ready: Signal<'b>,
    read: Hit<Signal<'b>>,
) -> Result<Hits<'b>, HdlError> {
    let (pb, rb, rays) = (plan.packet_bits(), plan.ray_bits(), plan.rays());
    let of_finished = Finished::of(plan);
    m.comment("Finished packets output their hits ray by ray. The word that is read belongs to the next ray to be output.");
    let take_finished = m.wire("take_finished", 1);
    let queue = plan.queue(
        "finished_queue",
        plan.packets(),
        finished.valid,
        of_finished.pack(finished.payload),
        take_finished.get(),
    )?;
    let out = m.reg("out", of_finished.width());
    let out_valid = m.reg_reset("out_valid", 1, 0);
    let out_fresh = m.reg("out_fresh", 1);
    let out_ray = m.reg("out_ray", rb);
    let shown = (out_valid.q & out_fresh.q).named("shown");
    let taken = (shown & ready).named("hit_taken");
    let out_last = out_ray.q.equals(u128::from(rays) - 1).named("out_last");
    let leaves = (taken & out_last).named("packet_leaves");
    let load = (queue.valid & (!out_valid.q | leaves)).named("load");
    take_finished.drive(load);
    out.next_when(load, queue.front);
    out_valid.next(load | (out_valid.q & !leaves));
    let next_ray = taken
        .mux(out_ray.q + m.lit(1u8, rb), out_ray.q)
        .named("next_ray");
    out_ray.next(load.mux(m.zero(rb), next_ray));
    out_fresh.next(!load & out_valid.q & !leaves);
    let packet = out.q.low(pb).named("out_packet");
    let touched_bits: Vec<_> = (0..rays).map(|i| out.q.bit(pb + i)).collect();
    let touched = m.select(out_ray.q, &touched_bits).named("out_touched");
    let zero = m.zero(plan.number());
    let none = m.constant("NOTHING", u32::MAX, 32);
    let miss = Hit {
        t: plan.infinity(m),
        u: zero,
        v: zero,
        instance: none,
        triangle: none,
    };
    Ok(Hits {
        finished: queue,
        load,
        out: out.q,
        out_valid: out_valid.q,
        packet,
        ray: out_ray.q,
        next_ray,
        taken,
        leaves,
        hit: Flow::new(shown, touched.choose(read, miss)),
    })
}
