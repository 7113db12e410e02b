//! Hit merge: the closest hit of each ray, and the hit mask of each packet.

use super::issue::Slot;
use super::leaves::Leaves;
use super::{Inputs, Kept, TestTrace};
use crate::bundle;
use crate::hdl::{Builder, Flow, Memory, Signal, Signals, Specs, Style};
use crate::hw::fp::{Knowing, Known, equal, less};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Hit, InContext, Limit};
use crate::hw::triangle;

bundle! {
    /// The stored closest hit of a ray.
    struct Closest(plan: &Plan) {
        t: plan.number(),
        u: plan.number(),
        v: plan.number(),
        triangle: 32,
        instance: 32,
    }
}

/// The result of the merge of a slot, one cycle after the test.
pub(super) struct Merge<'b> {
    pub limit: Flow<Limit<Signal<'b>>, Signal<'b>>,
    pub done: Flow<InContext<Signal<'b>>, Signal<'b>>,
    pub read: Hit<Signal<'b>>,
    pub trace: Option<Flow<TestTrace<Signal<'b>>, Signal<'b>>>,
}

/// Merges the result of a test with the closest hit of its ray, in the cycle after [`Stages::hit`](super::stages::Stages::hit). A
/// closest hit that is read at the ports is valid one cycle after its address.
pub(super) fn merge<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    slot: &Slot<'b>,
    leaf: &Leaves<'b>,
    ray: Kept<Signal<'b>>,
    test: &triangle::Outputs<Signal<'b>>,
) -> Merge<'b> {
    m.comment("Merge: a hit replaces the ray's closest hit if it is closer, or equally close with a lower instance and triangle number.");
    let w = plan.number();
    let word = Closest::of(plan);
    let rays = plan.rays_in_flight();
    let closest = m.memory("closest_memory", rays, word.width(), Style::Block);
    let replaces = replaces(plan, m, slot, leaf, ray, test, closest);
    let merged_at = replaces.stage();
    let none = m.lit(u128::from(u32::MAX), 32);
    let any = ray.any_hit.at(merged_at);
    let merged = word
        .pack(Closest {
            t: any.mux(ray.limits.tmin.at(merged_at), test.t.at(merged_at)),
            u: any.mux(m.zero(w), test.u.at(merged_at)),
            v: any.mux(m.zero(w), test.v.at(merged_at)),
            triangle: any.mux(none, leaf.triangle_number.at(merged_at)),
            instance: any.mux(none, leaf.instance_number.at(merged_at)),
        })
        .named("merged");
    let now = |signal: Signal<'b>| signal.at(merged_at).untimed();
    let writes = (slot.test.at(merged_at) & replaces)
        .untimed()
        .named("merge_writes");
    let packet = now(slot.packet).named("merge_packet");
    let number = now(slot.ray).named("merge_ray");
    closest.write(writes, plan.ray_index(packet, number), merged.untimed());
    let value = any.mux(plan.minus_infinity(m), test.t.at(merged_at));
    let limit = Limit {
        packet,
        ray: number,
        value: value.untimed(),
    };
    let limit = Flow::new(writes, limit);
    let done = gather(plan, m, slot, leaf, limit, merged_at);
    let asked = plan.ray_index(inputs.read_packet, inputs.read_ray);
    let asked = m.pipeline().enter(asked);
    let read = word.unpack(closest.read(asked).untimed());
    let trace = leaf.traced.as_ref().map(|traced| {
        let test = TestTrace {
            packet,
            ray: number,
            record: now(traced.merged),
            instance: now(leaf.instance_number),
            hit: now(test.hit),
            replaces: replaces.untimed(),
            t: now(test.t),
            u: now(test.u),
            v: now(test.v),
        };
        Flow::new(now(slot.test), test)
    });
    Merge {
        limit,
        done,
        read: Hit {
            t: read.t,
            u: read.u,
            v: read.v,
            instance: read.instance,
            triangle: read.triangle,
        },
        trace,
    }
}

/// Whether a hit replaces the ray's closest one, one register after the test.
fn replaces<'b>(
    plan: &Plan,
    m: &'b Builder,
    slot: &Slot<'b>,
    leaf: &Leaves<'b>,
    ray: Kept<Signal<'b>>,
    test: &triangle::Outputs<Signal<'b>>,
    closest: Memory<'b>,
) -> Signal<'b> {
    let f = plan.format;
    let merge_at = test.hit.stage();
    let read_at = merge_at - plan.read_latency();
    let old = Closest::of(plan).unpack(plan.read(closest, slot.index.at(read_at)));
    let touched = leaf.context.touched;
    let was_touched = bit_of(m, touched, slot.ray.at(merge_at)).named("was_touched");
    // The result is used for hits only, and their distances are at least tmin.
    let [new_t, old_t] = [test.t, old.t].map(|t| t.known(Known::Positive));
    let closer = less(f, "closer", new_t, old_t).named("closer");
    let as_close = equal(f, "as_close", new_t, old_t).named("as_close");
    let identity = leaf.instance_number.concat(leaf.triangle_number);
    let identity = identity.named("identity");
    let old_identity = old.instance.concat(old.triangle);
    let lower = identity.lt(old_identity).named("lower");
    let any_hit = ray.any_hit.at(merge_at);
    (test.hit & (any_hit | !was_touched | closer | (as_close & lower)))
        .named("replaces")
        .register()
}

/// Collects the hit mask over the rays of a leaf, and signals the completion of the leaf with the last ray.
fn gather<'b>(
    plan: &Plan,
    m: &'b Builder,
    slot: &Slot<'b>,
    leaf: &Leaves<'b>,
    merged: Flow<Limit<Signal<'b>>, Signal<'b>>,
    merged_at: u32,
) -> Flow<InContext<Signal<'b>>, Signal<'b>> {
    m.comment("The hit mask, collected over the rays of the leaf.");
    let gathered = m.reg("gathered", plan.rays());
    let ray = merged.payload.ray;
    let one_hot: Vec<_> = (0..plan.rays())
        .rev()
        .map(|i| merged.valid & ray.equals(u128::from(i)))
        .collect();
    let first = slot.first.at(merged_at).untimed();
    let context = leaf.context.at(merged_at).untimed();
    let so_far = first.mux(context.touched, gathered.q);
    let newly_touched = m.concat(&one_hot).hinted("newly_touched");
    let touched = (so_far | newly_touched).named("now_touched");
    gathered.next_when(slot.test.at(merged_at).untimed(), touched);
    let done = InContext {
        packet: merged.payload.packet,
        context: Context::of(plan).pack(Context { touched, ..context }),
    };
    let is_last = slot.test.at(merged_at) & slot.last.at(merged_at);
    Flow::new(is_last.untimed(), done)
}

/// The bit of a word with the given index.
fn bit_of<'b>(m: &'b Builder, word: Signal<'b>, index: Signal<'b>) -> Signal<'b> {
    let bits: Vec<_> = (0..word.width()).map(|i| word.bit(i)).collect();
    m.select(index, &bits)
}
