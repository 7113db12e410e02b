//! The cast unit: the ray reader and the hit writer of a cast.

mod properties;

use super::hits::{self, Hits};
use super::rays::{self, Rays};
use crate::hdl::{Builder, Flow, HdlError, Module, Specs};
use crate::hw::memory::combiner::{WORD_BITS, Word};
use crate::hw::plan::Plan;
use crate::hw::raycast::{Ray, TaggedHit};
use crate::{bundle, interface};
use std::sync::Arc;

bundle! {
    /// What a cast reads and writes.
    pub struct Cast() {
        rays: {Rays}(),
        hits: {Hits}(),
    }
}

interface! {
    pub (plan: &Plan) {
        in "Cast to start, accepted while no cast runs" { start: Flow<Cast>() }
        in "Words of rays, in the order of memory" { word_valid: 1, word: WORD_BITS }
        in "Rays" { ray_ready: 1 }
        in "Hits: those of a packet one after another, packets in any order" { hit: Flow<TaggedHit>(plan) }
        in "Writes" { write_ready: 1 }
        out "High from the cycle after the start until the last write is accepted" { casting: 1 }
        out "Words of rays, in the order of memory" { word_ready: 1 }
        out "Rays" { ray: Flow<Ray>(plan) }
        out "Hits: those of a packet one after another, packets in any order" { hit_ready: 1 }
        out "Writes" { write: Flow<Word>() }
        out "Events for the counters" { ray_taken: 1 }
    }
}

/// Describes the cast unit of a machine.
///
/// # Errors
/// A mistake in the description; none is known for any configuration.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "cast_unit",
        "casts rays from memory: reads rays, passes them to the ray casting unit in packets, and writes their hits.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let cast = inputs.start.payload;
    let hold = m.wire("hold_packets", 1);
    let reader = rays::ports(plan).place(
        "rays",
        &m,
        &rays::module(plan)?,
        rays::Inputs {
            start: Flow::new(inputs.start.valid, cast.rays),
            word_valid: inputs.word_valid,
            word: inputs.word,
            hold: hold.get(),
            ray_ready: inputs.ray_ready,
        },
    );
    let writer = hits::ports(plan).place(
        "hits",
        &m,
        &hits::module(plan)?,
        hits::Inputs {
            start: Flow::new(inputs.start.valid, cast.hits),
            hit: inputs.hit,
            packet: reader.packet,
            write_ready: inputs.write_ready,
        },
    );
    hold.drive(writer.hold);
    let outputs = Outputs {
        casting: reader.running | writer.running,
        word_ready: reader.word_ready,
        ray: reader.ray,
        hit_ready: writer.hit_ready,
        write: writer.write,
        ray_taken: reader.ray_taken,
    };
    ports.outputs.outputs(&m, outputs);
    if plan.rays() > 1 {
        properties::joins(&properties::Unit {
            m: &m,
            plan,
            inputs,
            outputs,
            reader,
            writer,
            hold: hold.get(),
        });
    }
    m.finish()
}
