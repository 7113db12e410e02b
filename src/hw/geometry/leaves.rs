//! Leaf store: the data of a packet's leaf that is needed when its rays leave the test.

use super::Inputs;
use super::fetch::Fetch;
use super::issue::Slot;
use super::stages::Stages;
use crate::bkd::layout::fields;
use crate::bundle;
use crate::hdl::{Builder, Signal, Signals, Specs, Style};
use crate::hw::plan::Plan;
use crate::hw::ray::{Context, Start};

bundle! {
    /// The root of an object.
    struct Root(plan: &Plan) {
        address: plan.address(),
        leaf: 1,
    }
}

/// The data read from the leaf store.
pub(super) struct Leaves<'b> {
    /// The start of the packet given by `setup_next_packet`, [`Plan::read_latency`] cycles later.
    pub start: Start<Signal<'b>>,
    /// The context of the leaf whose ray is merged.
    pub context: Context<Signal<'b>>,
    pub triangle_number: Signal<'b>,
    pub instance_number: Signal<'b>,
    pub traced: Option<Traced<'b>>,
}

/// Addresses of leaves, for trace ports only.
pub(super) struct Traced<'b> {
    /// The leaf whose ray is merged.
    pub merged: Signal<'b>,
    /// The instance whose ray leaves.
    pub instance: Signal<'b>,
}

/// Writes leaves when they are accepted and records when they arrive, and reads both for the slots that leave the test.
pub(super) fn keep<'b>(
    plan: &Plan,
    m: &'b Builder,
    inputs: &Inputs<Signal<'b>>,
    fetch: &Fetch<'b>,
    slot: &Slot<'b>,
    stages: &Stages,
    object_leaves_at: u32,
) -> Leaves<'b> {
    m.comment("Leaves, the numbers and roots in their records, and the reads of both.");
    let packets = plan.packets();
    let (root, context) = (Root::of(plan), Context::of(plan));
    let leaf = inputs.leaf.payload;
    let contexts = m.memory(
        "leaf_context_memory",
        packets,
        context.width(),
        Style::Block,
    );
    contexts.write(fetch.leaf.taken, leaf.packet, leaf.context);
    let (valid, record) = (inputs.record.response.valid, fetch.record);
    let data = inputs.record.response.payload.data;
    let instance = fields::Instance::of().unpack(data);
    let triangle_numbers = m.memory("triangle_number_memory", packets, 32, Style::Block);
    triangle_numbers.write(
        valid & !record.instance,
        record.packet,
        fields::Triangle::of().unpack(data).number,
    );
    let instance_numbers = m.memory("instance_number_memory", packets, 32, Style::Block);
    let instance_answer = (valid & record.instance).named("instance_answer");
    instance_numbers.write(instance_answer, record.packet, instance.number);
    let link = fields::Link::of().unpack(instance.root);
    let root_data = root
        .pack(Root {
            address: link.link.low(plan.address()).hinted("object_root_address"),
            leaf: link.left_leaf,
        })
        .named("root_data");
    let roots = m.memory("root_memory", packets, root.width(), Style::Block);
    roots.write(instance_answer, record.packet, root_data);

    let next_packet = inputs.setup_next_packet;
    let start_root = root.unpack(plan.read(roots, next_packet));
    let start_context = context.unpack(plan.read(contexts, next_packet));
    let read_at = stages.hit - plan.read_latency();
    let packet = slot.packet.at(read_at);
    let traced = plan.trace.then(|| {
        let addresses = m.memory("leaf_address_memory", packets, plan.address(), Style::Block);
        addresses.write(fetch.leaf.taken, leaf.packet, leaf.address);
        let at_object = slot.packet.at(object_leaves_at - plan.read_latency());
        Traced {
            merged: plan.read(addresses, packet).named("tested_record"),
            instance: plan.read(addresses, at_object),
        }
    });
    Leaves {
        start: Start {
            address: start_root.address,
            leaf: start_root.leaf,
            context: context.pack(Context {
                inside: m.lit(1u8, 1),
                ..start_context
            }),
        },
        context: context.unpack(plan.read(contexts, packet)).named("tested"),
        triangle_number: plan.read(triangle_numbers, packet).named("tested_triangle"),
        // In a scene of one level every triangle is of instance 0.
        instance_number: plan
            .read_where(
                instance_numbers,
                packet,
                slot.inside.at(read_at),
                m.zero(32),
            )
            .named("tested_instance"),
        traced,
    }
}
