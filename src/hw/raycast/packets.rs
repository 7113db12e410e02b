//! Packet numbers, and the packets of arriving rays.

use super::FromHits;
use crate::hdl::fifo::Placed;
use crate::hdl::{Builder, HdlError, Memory, Signal, Style};
use crate::hw::plan::Plan;
use crate::hw::ray::Place;

/// Packet numbers, and the arriving ray.
pub(super) struct Packets<'b> {
    /// Whether packet numbers are being initialised after a reset, and the current number.
    pub sweeping: Signal<'b>,
    pub sweep_packet: Signal<'b>,
    pub free: Placed<'b>,
    pub tags: Memory<'b>,
    pub under_way: Signal<'b>,
    pub some_under_way: Signal<'b>,
    /// The packet and slot of the arriving ray.
    pub place: Place<Signal<'b>>,
    /// Whether a ray can be accepted, whether one is, and whether it is its packet's last.
    pub ready: Signal<'b>,
    pub take_ray: Signal<'b>,
    pub enters: Signal<'b>,
    /// The tag of the ray's packet, and the tag of the packet whose hits are output.
    pub tag_in: Signal<'b>,
    pub tag_out: Signal<'b>,
}

/// Assigns a free number to each arriving packet until its last hit has left, and stores its tag under this number. A ray waits while
/// a ray in object space arrives, and while `paused`. All signals are in the cycle of the ray or of the hit.
pub(super) fn packets<'b>(
    m: &'b Builder,
    plan: &Plan,
    (ray_valid, ray_tag): (Signal<'b>, Signal<'b>),
    object_valid: Signal<'b>,
    paused: Signal<'b>,
    hits: FromHits<Signal<'b>>,
) -> Result<Packets<'b>, HdlError> {
    let (rays, packets) = (plan.rays(), plan.packets());
    let (pb, rb) = (plan.packet_bits(), plan.ray_bits());
    m.comment("After reset, every packet number is pushed to the queue of free numbers, and the counts per packet are cleared.");
    let sweeping = m.reg_reset("sweeping", 1, 1);
    let sweep_packet = m.reg_reset("sweep_packet", pb, 0);
    sweeping.next(sweeping.q & !sweep_packet.q.equals(u128::from(packets) - 1));
    sweep_packet.next_when(sweeping.q, sweep_packet.q + m.lit(1u8, pb));
    let take_free = m.wire("take_free", 1);
    let free = plan.queue(
        "free_queue",
        packets,
        sweeping.q | hits.freed,
        sweeping.q.mux(sweep_packet.q, hits.read_packet),
        take_free.get(),
    )?;
    let packet = free.front;

    m.comment("The rays of a packet arrive one by one; the first takes a free packet number for all of them.");
    let ray = m.reg_reset("place", rb, 0);
    let first = ray.q.is_zero().named("first_ray");
    let last = ray.q.equals(u128::from(rays) - 1).named("last_ray");
    let ready = (!sweeping.q & free.valid & !object_valid & !paused).named("ready");
    let take = (ray_valid & ready).named("take_ray");
    let enters = (take & last).named("packet_enters");
    take_free.drive(enters);
    ray.next_when(take, last.mux(m.zero(rb), ray.q + m.lit(1u8, rb)));
    let tags = m.memory(
        "tag_memory",
        packets,
        plan.config.tag_bits,
        Style::Distributed,
    );
    tags.write(take & first, packet, ray_tag);
    let under_way = m.reg_reset("under_way", pb + 1, 0);
    let unit = m.lit(1u8, pb + 1);
    under_way.next_when(
        enters ^ hits.freed,
        enters.mux(under_way.q + unit, under_way.q - unit),
    );
    Ok(Packets {
        sweeping: sweeping.q,
        sweep_packet: sweep_packet.q,
        tags,
        under_way: under_way.q,
        some_under_way: under_way.q.any().named("some_under_way"),
        place: Place {
            packet,
            ray: ray.q,
            first,
            last,
        },
        ready,
        take_ray: take,
        enters,
        tag_out: tags.read_now(hits.read_packet),
        tag_in: first.mux(ray_tag, tags.read_now(packet)),
        free,
    })
}
