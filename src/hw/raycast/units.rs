//! The instances of the units, and their connections.

use super::packets::Packets;
use super::{FromGeometry, FromHits, FromSkinner, Inputs};
use crate::bkd::layout::fields::Link;
use crate::hdl::{
    Builder, Bundle, Flow, HdlError, Module, ReadInputs, Request, Response, Signal, Spec, Specs,
};
use crate::hw::geometry::{self, Geometry};
use crate::hw::plan::Plan;
use crate::hw::ray::{Leaf, Tested};
use crate::hw::tpu::{self, Tpu};
use crate::hw::{setup, skinning};
use std::sync::Arc;

/// The modules of the units.
pub(super) struct Units {
    tpu: Tpu,
    setup: Arc<Module>,
    geometry: Geometry,
    skinning: Arc<Module>,
}

impl Units {
    pub fn new(plan: &Plan) -> Result<Units, HdlError> {
        let (tpu, geometry) = (tpu::module(plan)?, geometry::module(plan)?);
        Ok(Units {
            setup: setup::module(plan, tpu.pop_latency)?,
            skinning: skinning::module(plan, &geometry.test)?,
            tpu,
            geometry,
        })
    }
}

/// The environment in which the units are instantiated.
pub(super) struct Site<'a, 'b> {
    pub m: &'b Builder,
    pub plan: &'a Plan,
    pub units: &'a Units,
    pub inputs: &'a Inputs<Signal<'b>>,
}

impl<'b> Site<'_, 'b> {
    /// Instantiates ray setup. It takes a ray in object space if there is one, else a ray in world space.
    pub fn set_up(
        &self,
        packets: &Packets<'b>,
        object: Flow<geometry::Moved<Signal<'b>>, Signal<'b>>,
    ) -> setup::Outputs<Signal<'b>> {
        let ray = self.inputs.ray.payload;
        self.m.comment(
            "Ray setup: of rays in world space and, with priority, of rays that the geometry unit has transformed into object space.",
        );
        let of_world = geometry::Moved {
            place: packets.place,
            line: ray.line,
            limits: ray.limits,
        };
        let is_object = object.valid;
        let chosen = is_object.choose(object.payload, of_world);
        let given = setup::Inputs {
            valid: is_object | packets.take_ray,
            place: chosen.place,
            object: is_object,
            active: is_object | ray.active,
            any_hit: ray.any_hit,
            line: chosen.line,
            limits: chosen.limits,
            scene_lo: self.inputs.scene_lo,
            scene_hi: self.inputs.scene_hi,
        };
        let ports = setup::ports(self.plan, self.units.tpu.pop_latency);
        ports.place("setup", self.m, &self.units.setup, given)
    }

    /// Instantiates the traversal unit. It takes every ray from ray setup, and the results of the geometry unit.
    pub fn traverse(
        &self,
        set_up: &setup::Outputs<Signal<'b>>,
        geometry: FromGeometry<Signal<'b>>,
    ) -> tpu::Outputs<Signal<'b>> {
        self.m.comment("Traversal and geometry.");
        let out = set_up.out.payload;
        let ray = tpu::SetUp {
            place: out.place,
            enters: out.enters,
            interval: out.interval,
            signs: out.signs,
            origin: out.along.map(|axis| axis.origin),
            reciprocal: out.along.map(|axis| axis.reciprocal),
        };
        let given = tpu::Inputs {
            setup_soon: set_up.soon,
            setup: Flow::new(set_up.out.valid, ray),
            setup_object: out.object,
            object: geometry.start,
            root: self.inputs.scene_root,
            node: self.inputs.node,
            leaf_ready: geometry.leaf_ready,
            limit: geometry.limit,
            done: geometry.done,
        };
        tpu::ports(self.plan).place("traversal", self.m, &self.units.tpu.module, given)
    }

    /// Instantiates the geometry unit. It also takes every ray, the leaves of the traversal unit, and the operands of the skinning
    /// processor. It has the port to vertex memory unless skinning uses it.
    pub fn intersect(
        &self,
        packets: &Packets<'b>,
        set_up: &setup::Outputs<Signal<'b>>,
        leaf: Flow<Leaf<Signal<'b>>, Signal<'b>>,
        skinner: FromSkinner<Signal<'b>>,
        hits: FromHits<Signal<'b>>,
    ) -> (geometry::Outputs<Signal<'b>>, Signal<'b>) {
        let ports = geometry::ports(self.plan);
        let out = set_up.out.payload;
        let vertex = self.vertex(&ports.inputs.vertex, !skinner.skinning_now);
        let ray = geometry::SetUp {
            packet: out.place.packet,
            ray: out.place.ray,
            object: out.object,
            tested: Tested {
                origin: out.along.map(|axis| axis.origin),
                reciprocal: out.along.map(|axis| axis.reciprocal),
                signs: out.signs,
                shear: out.shear,
                direction: out.direction,
            },
            kept: geometry::Kept {
                limits: out.limits,
                any_hit: out.any_hit,
            },
        };
        let of_world = geometry::World {
            packet: packets.place.packet,
            ray: packets.place.ray,
            direction: self.inputs.ray.payload.line.direction,
        };
        let given = geometry::Inputs {
            setup: Flow::new(set_up.out.valid, ray),
            setup_next_packet: set_up.next_packet,
            instanced: Link::of().unpack(self.inputs.scene_root).right_leaf,
            leaf,
            record: self.inputs.record,
            vertex,
            skinning: skinner.skinning_now,
            skin_palette: skinner.skin_palette,
            skin_issue: skinner.skin_issue,
            skin: skinner.skin,
            sweep: packets.sweeping,
            sweep_packet: packets.sweep_packet,
            read_packet: hits.read_packet,
            read_ray: hits.read_ray,
            world: (self.plan.watertight()).then(|| Flow::new(packets.take_ray, of_world)),
            setup_shear_z: out.shear_z,
        };
        let module = &self.units.geometry.module;
        let outputs = ports.place("intersection", self.m, module, given);
        (outputs, vertex.response.valid)
    }

    /// Instantiates the skinning processor, which uses the operators of the geometry unit and its port to vertex memory.
    pub fn skin(
        &self,
        may_start: Signal<'b>,
        skinning_now: Signal<'b>,
        geometry: &geometry::Outputs<Signal<'b>>,
    ) -> (skinning::Outputs<Signal<'b>>, Signal<'b>) {
        self.m.comment(
            "Skinning uses the operators of the geometry unit and its port to vertex memory.",
        );
        let ports = skinning::ports(self.plan);
        let vertex = self.vertex(&ports.inputs.vertex, skinning_now);
        let given = skinning::Inputs {
            start: self.inputs.skin_start,
            may_start,
            vertex,
            influence: self.inputs.influence,
            write_ready: self.inputs.skin_write_ready,
            weighted: geometry.skin_weighted,
            pair_sum: geometry.skin_pair_sum,
            vertex_sum: geometry.skin_vertex_sum,
        };
        let outputs = ports.place("skinner", self.m, &self.units.skinning, given);
        (outputs, vertex.response.valid)
    }

    /// The port to vertex memory of one of the two units: it receives its own responses, with as many tag bits as its requests have.
    fn vertex(&self, ports: &ReadInputs<Spec>, its: Signal<'b>) -> ReadInputs<Signal<'b>> {
        let ReadInputs {
            request_ready,
            response,
        } = self.inputs.vertex;
        let Response { tag, data } = response.payload;
        let tag = tag.low(ports.response.payload.tag.width);
        ReadInputs {
            request_ready,
            response: Flow::new(response.valid & its, Response { tag, data }),
        }
    }
}

/// A request of a unit to vertex memory.
pub(super) type VertexRequest<'b> = Flow<Request<Signal<'b>>, Signal<'b>>;

/// The request to vertex memory: that of the unit which has the port.
pub(super) fn vertex_request<'b>(
    ports: &Flow<Request<Spec>, Spec>,
    skinning_now: Signal<'b>,
    of_skinner: VertexRequest<'b>,
    of_geometry: VertexRequest<'b>,
) -> VertexRequest<'b> {
    ports
        .zip(of_skinner.zip(of_geometry))
        .map(|_, (spec, (of_skinner, of_geometry))| {
            let [of_skinner, of_geometry] =
                [of_skinner, of_geometry].map(|request| request.extend(spec.width));
            skinning_now.mux(of_skinner, of_geometry)
        })
}
