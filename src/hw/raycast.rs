//! The ray casting unit: ray setup, traversal unit, geometry unit, and the assignment of packet numbers.

mod hits;
mod packets;
mod properties;
mod units;

use super::geometry::{self, Moved, TestTrace, TransformTrace};
use super::plan::Plan;
use super::ray::{Hit, InContext, Limit, Limits, Line, Start};
use super::skinning::{self, Column, Issued, Mesh, Sums, Taken};
use super::tpu::{self, StepTrace};
use crate::bkd::layout::Record;
use crate::config::Config;
use crate::hdl::{
    Builder, Bundle, Design, Flow, HdlError, Module, ReadInputs, ReadOutputs, Signal, Specs, Wires,
    Write,
};
use crate::{bundle, interface};
use hits::Hits;
use packets::Packets;
use properties::Watched;
use std::sync::Arc;
use units::{Site, Units, VertexRequest};

/// Width of each counter; counters wrap.
pub const COUNTER_BITS: u32 = 40;

/// An emitted machine.
#[derive(Debug)]
pub struct Machine {
    pub config: Config,
    /// Whether it has trace ports.
    pub trace: bool,
    pub design: Design,
}

/// Describes the ray casting unit of a machine. The top module is `raycast_unit`.
///
/// # Errors
/// A mistake in the description, with its location in the Rust source.
pub fn emit(plan: &Plan) -> Result<Machine, HdlError> {
    Ok(Machine {
        config: plan.config.clone(),
        trace: plan.trace,
        design: Design::new(module(plan)?)?,
    })
}

bundle! {
    /// A ray to cast.
    pub struct Ray(plan: &Plan) {
        /// Valid with the first ray of a packet.
        tag: plan.config.tag_bits,
        line: ..{Line}(plan),
        limits: ..{Limits}(plan),
        active: 1,
        any_hit: 1,
    }
}

bundle! {
    /// The closest hit of a ray, with the tag of its packet.
    pub struct TaggedHit(plan: &Plan) {
        tag: plan.config.tag_bits,
        hit: ..{Hit}(plan),
    }
}

bundle! {
    /// A packet whose last ray has been accepted, and its packet number.
    pub struct StartTrace(plan: &Plan) {
        packet: plan.packet_bits(),
        tag: plan.config.tag_bits,
    }
}

bundle! {
    /// The counters since reset.
    pub struct Counters() {
        cycles: COUNTER_BITS,
        packet_steps: COUNTER_BITS,
        ray_triangle_tests: COUNTER_BITS,
        tpu_busy_cycles: COUNTER_BITS,
        tpu_starved_cycles: COUNTER_BITS,
        ray_transforms: COUNTER_BITS,
        gu_busy_cycles: COUNTER_BITS,
        gu_starved_cycles: COUNTER_BITS,
        skin_influences: COUNTER_BITS,
        skin_cycles: COUNTER_BITS,
    }
}

/// Width of the tags of vertex reads, by the geometry unit or the skinning processor.
fn vertex_tag_bits(plan: &Plan) -> u32 {
    (plan.packet_bits() + geometry::CORNER_BITS).max(skinning::vector_tag_bits(plan))
}

interface! {
    pub (plan: &Plan) {
        in "Scene: link word of the root, and box; constant while packets are in flight" {
            scene_root: Record::link_word().width,
            scene_lo: [plan.number(); xyz],
            scene_hi: [plan.number(); xyz],
        }
        in "Rays in" { ray: Flow<Ray>(plan) }
        in "Hits out" { hit_ready: 1 }
        in "" {
            node: {ReadInputs = tpu::Inputs::of(plan).node},
            record: {ReadInputs = geometry::Inputs::of(plan).record},
            vertex: {ReadInputs}(
                "Vertex memory", "any order, always accepted",
                vertex_tag_bits(plan), Record::vertex(plan.format).width
            ),
            influence: {ReadInputs}(
                "Influence memory", "any order, always accepted",
                skinning::row_tag_bits(plan), Record::influence_row(plan.format).width
            ),
        }
        in "Mesh to skin, accepted while no packet is in flight: index and count of its palette, influence rows, vertices at rest \
            and vertices to write" {
            skin_start: Flow<Mesh>(plan),
        }
        in "Vertex memory: writes of skinned vertices" { skin_write_ready: 1 }
        out "Rays in" { ray_ready: 1 }
        out "Hits out" { hit: Flow<TaggedHit>(plan) }
        out "Mesh to skin, accepted while no packet is in flight: index and count of its palette, influence rows, vertices at rest \
            and vertices to write" {
            skin_start_ready: 1,
        }
        out "High for one cycle when a mesh is complete" { skin_done: 1 }
        out "Vertex memory: writes of skinned vertices" {
            skin_write: Flow<Write>(plan.address(), Record::vertex(plan.format).width),
        }
        out "" {
            node: {ReadOutputs = tpu::Outputs::of(plan).node},
            record: {ReadOutputs = geometry::Outputs::of(plan).record},
            influence: {ReadOutputs = skinning::Outputs::of(plan).influence},
            vertex: {ReadOutputs}("Vertex memory", plan.address(), vertex_tag_bits(plan)),
        }
        out "Counters since reset" {
            count: {Counters}(),
            stack_high_water: plan.level_bits(),
            stack_overflow: 1,
        }
        out "Trace: packet starts, traversal steps, tests and transformations" {
            trace_start if (plan.trace): Flow<StartTrace>(plan),
            trace_step if (plan.trace): Flow<StepTrace>(plan),
            trace_test if (plan.trace): Flow<TestTrace>(plan),
            trace_transform if (plan.trace): Flow<TransformTrace>(plan),
        }
    }
}

bundle! {
    /// The signals from the geometry unit to earlier units.
    struct FromGeometry(plan: &Plan) {
        /// A ray in object space, to ray setup.
        object: Flow<Moved>(plan),
        leaf_ready: 1,
        limit: Flow<Limit>(plan),
        done: Flow<InContext>(plan),
        start: {Start}(plan),
    }
}

bundle! {
    /// The signals from the skinning processor to the geometry unit, and whether it uses the unit.
    struct FromSkinner(plan: &Plan) {
        skinning_now: 1,
        skin_palette: Flow<Column>(plan),
        skin_issue: Flow<Taken>(plan),
        skin: {Sums}(plan, "", ""),
    }
}

bundle! {
    /// The packet whose hits are output, the ray whose hit is read, and whether the packet's last hit is accepted.
    struct FromHits(plan: &Plan) {
        freed: 1,
        read_packet: plan.packet_bits(),
        read_ray: plan.ray_bits(),
    }
}

pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let units = Units::new(plan)?;
    let builder = Builder::new(
        "raycast_unit",
        format!(
            "casts packets of {} rays into a scene, {} packets at a time.\n\
             One ray enters per cycle, the rays of a packet in order. One hit leaves per cycle, with the packet's tag, the hits of a packet in order, the packets in any order. \
             After reset, wait for ray_ready.",
            plan.rays(),
            plan.packets()
        ),
    );
    let m = &builder;
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(m);
    let site = Site {
        m,
        plan,
        units: &units,
        inputs: &inputs,
    };
    let from_hits = FromHits::of(plan).wires(m, "");
    let from_geometry = FromGeometry::of(plan).wires(m, "");
    let from_skinner = FromSkinner::of(plan).wires(m, "");
    let (object, skinning) = (from_geometry.object.get(), from_skinner.skinning_now.get());
    // A mesh to skin stops new packets, so it starts as soon as the packets in flight are finished.
    let paused = (inputs.skin_start.valid | skinning).named("paused");

    let ray = (inputs.ray.valid, inputs.ray.payload.tag);
    let packets = m.part(
        "packet_numbers",
        "assigns packet numbers to arriving packets and passes their rays to ray setup.",
        || packets::packets(m, plan, ray, object.valid, paused, from_hits.get()),
    )?;
    let set_up = site.set_up(&packets, object);
    let traversal = site.traverse(&set_up, from_geometry.get());
    let (intersection, to_geometry) = site.intersect(
        &packets,
        &set_up,
        traversal.leaf,
        from_skinner.get(),
        from_hits.get(),
    );
    from_geometry.drive(FromGeometry {
        object: intersection.object,
        leaf_ready: intersection.leaf_ready,
        limit: intersection.limit,
        done: intersection.done,
        start: intersection.start,
    });
    let hits = m.part(
        "hit_output",
        "outputs the hits of finished packets, one ray per cycle.",
        || {
            let (finished, ready) = (traversal.finished, inputs.hit_ready);
            hits::hits(m, plan, finished, ready, intersection.read)
        },
    )?;
    from_hits.drive(FromHits {
        freed: hits.leaves,
        read_packet: hits.packet,
        read_ray: hits.next_ray,
    });
    let may_start = !packets.some_under_way & !packets.sweeping;
    let (skinner, to_skinner) = site.skin(may_start, skinning, &intersection);
    let Issued { influence, mark } = skinner.issue.payload;
    from_skinner.drive(FromSkinner {
        skinning_now: skinner.skinning,
        skin_palette: skinner.palette,
        skin_issue: Flow::new(skinner.issue.valid, Taken { mark, influence }),
        skin: skinner.operands,
    });
    let [of_skinner, of_geometry] = [skinner.vertex, intersection.vertex].map(|port| port.request);
    let request = &ports.outputs.vertex.request;
    let request = m.part(
        "vertex_arbiter",
        "shares the vertex memory port between the geometry unit and the skinning processor.",
        || units::vertex_request(request, skinning, of_skinner, of_geometry),
    );
    let placed = Placed {
        packets: &packets,
        traversal,
        intersection,
        skinner,
    };
    let count = m.part("counters", "counts events since reset.", || {
        count(m, placed.events(skinning))
    });
    let outputs = placed.outputs(plan, &hits, request, count);
    ports.outputs.outputs(m, outputs);
    properties::shares(&Watched {
        inputs,
        outputs,
        plan,
        packets: &packets,
        hits: &hits,
        object_valid: object.valid,
        paused,
        finished_packet: traversal.finished.payload.packet,
        may_start,
        skinning,
        of_geometry,
        of_skinner,
        to_geometry,
        to_skinner,
    });
    builder.finish()
}

/// The outputs of the instantiated units.
struct Placed<'a, 'b> {
    packets: &'a Packets<'b>,
    traversal: tpu::Outputs<Signal<'b>>,
    intersection: geometry::Outputs<Signal<'b>>,
    skinner: skinning::Outputs<Signal<'b>>,
}

impl<'b> Placed<'_, 'b> {
    /// The events for the counters.
    fn events(&self, skinning: Signal<'b>) -> Counters<Signal<'b>> {
        let (some, step) = (self.packets.some_under_way, self.traversal.step_taken);
        let slot = self.intersection.slot_taken;
        Counters {
            cycles: some.module().lit(1u8, 1),
            packet_steps: step,
            ray_triangle_tests: self.intersection.test_issued,
            tpu_busy_cycles: step,
            tpu_starved_cycles: some & !step,
            ray_transforms: self.intersection.transform_issued,
            gu_busy_cycles: slot,
            gu_starved_cycles: some & !slot,
            skin_influences: self.skinner.influence_issued,
            skin_cycles: skinning,
        }
    }

    fn outputs(
        &self,
        plan: &Plan,
        hits: &Hits<'b>,
        vertex_request: VertexRequest<'b>,
        count: Counters<Signal<'b>>,
    ) -> Outputs<Signal<'b>> {
        let Placed {
            packets,
            traversal,
            intersection,
            skinner,
        } = self;
        let hit = TaggedHit {
            tag: packets.tag_out,
            hit: hits.hit.payload,
        };
        let start = StartTrace {
            packet: packets.place.packet,
            tag: packets.tag_in,
        };
        Outputs {
            ray_ready: packets.ready,
            hit: Flow::new(hits.hit.valid, hit),
            skin_start_ready: skinner.start_ready,
            skin_done: skinner.done,
            skin_write: skinner.write,
            node: traversal.node,
            record: intersection.record,
            influence: skinner.influence,
            vertex: ReadOutputs {
                request: vertex_request,
            },
            count,
            stack_high_water: traversal.stack_high_water,
            stack_overflow: traversal.stack_overflow,
            trace_start: (plan.trace).then(|| Flow::new(packets.enters, start)),
            trace_step: (traversal.trace_step).map(|step| Flow::new(traversal.step_taken, step)),
            trace_test: intersection.trace_test,
            trace_transform: intersection.trace_transform,
        }
    }
}

/// Counts events. The counters wrap.
fn count<'b>(m: &'b Builder, events: Counters<Signal<'b>>) -> Counters<Signal<'b>> {
    m.comment("Counters since reset.");
    events.map(|name, event| {
        let counter = m.reg_reset(format!("{name}_counter"), COUNTER_BITS, 0);
        counter.next_when(event, counter.q + m.lit(1u8, COUNTER_BITS));
        counter.q
    })
}
