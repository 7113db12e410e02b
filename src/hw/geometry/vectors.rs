//! Vector store: the memories of vertices, vectors of instances, and matrices of joints.
//!
//! | memory | by packet | above, by packet | above, by joint |
//! |---|---|---|---|
//! | `vertex0_memory` | first vertex, or c_x | least corner of the instance's box | p_x |
//! | `vertex1_memory` | second vertex, or c_y | greatest corner | p_y |
//! | `vertex2_memory` | third vertex, or c_z | greatest corner | p_z |
//! | `translation_memory` | c_w | | p_w |

use super::Inputs;
use super::fetch::Arrival;
use super::issue::Slot;
use super::stages::Stages;
use crate::bkd::layout::fields;
use crate::hdl::{Builder, Flow, Memory, Signal, Signals, Specs, Style};
use crate::hw::plan::{AXES, Plan};
use crate::hw::triangle::Corners;

/// The data that a slot reads.
pub(super) struct Vectors<'b> {
    /// At the first stage of the test.
    pub corners: Corners<Signal<'b>>,
    /// From [`Stages::translation`] on. It is +0 for a direction, which is not translated.
    pub translation: [Signal<'b>; 3],
}

/// Writes vertices and vectors when they arrive or, during skinning, columns of matrices; reads the data of each slot.
pub(super) fn keep<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    arrival: &Arrival<'b>,
    slot: &Slot<'b>,
    stages: &Stages,
) -> Vectors<'b> {
    m.comment(
        "Vertices and vectors per packet; during skinning, the columns of the palette per joint.",
    );
    let (corners, translations) = write(plan, m, inputs, arrival);
    let read = plan.read_latency();
    let vertex = fields::Vertex::of(plan.format);
    // The address bits above the packet: whether its box is read, or the high bits of a joint; and whether it is a joint.
    let joint_width = inputs.skin_palette.payload.joint.width();
    let bits = plan.level_packet_bits().max(joint_width);
    let above_packet = match slot.joint_high {
        Some(high) => high | slot.in_box.extend(high.width()),
        None => slot.in_box,
    };
    let corner_index = m.concat(&[
        slot.skinning_at(0),
        above_packet.extend(bits - plan.packet_bits()),
        slot.packet,
    ]);
    let corner_index = corner_index.hinted("corner_index");
    let [v0, v1, v2] = corners.map(|memory| {
        let word = plan.read(memory, corner_index.at(stages.test - read));
        vertex.unpack(word).position
    });
    let read_at = stages.translation - read;
    let translation_index: Vec<_> = [
        Some(slot.skinning_at(read_at)),
        slot.joint_high.map(|high| high.at(read_at)),
        Some(slot.packet.at(read_at)),
    ]
    .into_iter()
    .flatten()
    .collect();
    let translation = plan.read_where(
        translations,
        m.concat(&translation_index),
        slot.origin.at(read_at) | slot.skinning_at(read_at),
        m.zero(vertex.width()),
    );
    let translation = vertex.unpack(translation).position;
    Vectors {
        corners: Corners { v0, v1, v2 }.named("corner"),
        translation: [0, 1, 2].map(|i| translation[i].named(format!("translation_{}", AXES[i]))),
    }
}

/// The memories of the three vertices, and that of translations.
fn write<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    arrival: &Arrival<'b>,
) -> ([Memory<'b>; 3], Memory<'b>) {
    let (skinning, palette) = (inputs.skinning, inputs.skin_palette);
    let Flow { valid, payload } = inputs.vertex.response;
    let arrives_as = |name: &str, corners: &[u32]| {
        let any: Vec<_> = corners
            .iter()
            .map(|corner| {
                let arrives = arrival.number.equals(u128::from(*corner));
                arrives.hinted(format!("corner{corner}_arrives"))
            })
            .collect();
        (valid & m.or_all(&any)).hinted(format!("{name}_takes_it"))
    };
    let data = skinning
        .mux(palette.payload.data, payload.data)
        .named("vector_data");
    let joint_width = palette.payload.joint.width();
    let memory = |name: &str, corners: &[u32], place: Signal<'b>, column: u128| {
        let bits = place.width().max(joint_width);
        let depth = (1 << bits) + plan.config.skinning_joints;
        let memory = m.memory(name, depth, data.width(), Style::Block);
        let in_palette = palette.payload.joint.extend(bits);
        let place = skinning.mux(in_palette, place.extend(bits));
        let writes_column = palette.valid & palette.payload.column.equals(column);
        let place = place.hinted(format!("{name}_place"));
        memory.write(
            skinning.mux(writes_column, arrives_as(name, corners)),
            skinning.concat(place),
            data,
        );
        memory
    };
    let packet = arrival.of.packet;
    // Vectors 4 and 5 are an instance's box.
    let place = arrival.number.bit(2).concat(packet);
    let corners = [
        memory("vertex0_memory", &[0, 4], place, 0),
        memory("vertex1_memory", &[1, 5], place, 1),
        memory("vertex2_memory", &[2, 5], place, 2),
    ];
    (corners, memory("translation_memory", &[3], packet, 3))
}
