//! The chip's module: instantiates the units and joins them.

use super::cast;
use super::memory::{self, CachedInputs, CachedOutputs, Port};
use super::motion::{self, FromUnits, RowRequest};
use super::registers::{self, LiteInputs, LiteOutputs};
use super::{NAME, bus, commands, counters};
use crate::hdl::{Builder, Design, Flow, HdlError, Module, ReadInputs, Signal, Specs, Wires};
use crate::hw::core::{self, default_prefix};
use crate::hw::memory::axi::{MasterInputs, MasterOutputs};
use crate::hw::memory::combiner::WORD_BITS;
use crate::hw::memory::reader::Sequence;
use crate::hw::memory::{ADDRESS_BITS, Beat};
use crate::hw::plan::Plan;
use crate::hw::raycast::{self, Machine, TaggedHit};
use crate::hw::update;
use crate::{bundle, interface};
use std::sync::Arc;

interface! {
    pub (plan: &Plan) {
        in "" { s_axi: {LiteInputs}() }
        out "" { s_axi: {LiteOutputs}() }
        out "Interrupt request, high while an enabled event is pending" { irq: 1 }
        in "" { m_axi: {MasterInputs}(&bus(&plan.config)) }
        out "" { m_axi: {MasterOutputs}(&bus(&plan.config)) }
        out "Trace: packet starts, hits, traversal steps and tests" {
            trace if (plan.trace): {Trace}(plan),
        }
    }
}

bundle! {
    /// What happens in the ray casting unit.
    pub struct Trace(plan: &Plan) {
        /// A packet whose last ray has been accepted.
        start_valid: 1,
        start_tag: plan.config.tag_bits,
        /// A hit that is accepted.
        hit_valid: 1,
        hit_tag: plan.config.tag_bits,
        /// A traversal step; a ray-triangle test.
        step: 1,
        test: 1,
    }
}

bundle! {
    /// Signals from later units to earlier ones.
    struct Back(plan: &Plan) {
        start_valid: 1,
        start_address: ADDRESS_BITS,
        commands_ready: 1,
        commands_beat: Flow<Beat>(1, plan.config.bus_data_bits),
        write_ready: 1,
        writes_done: 1,
        invalidating: 1,
        error_valid: 1,
        error_address: ADDRESS_BITS,
        word_valid: 1,
        word: WORD_BITS,
        ray_ready: 1,
        hit: Flow<TaggedHit>(plan),
        nodes: {CachedOutputs}(plan, Port::Nodes),
        records: {CachedOutputs}(plan, Port::Records),
        vertices: {CachedOutputs}(plan, Port::Vertices),
        moved: {CachedOutputs}(plan, Port::Moved),
        sequence_ready: 1,
        row_valid: 1,
        row: WORD_BITS,
        units: {FromUnits}(plan),
    }
}

/// Describes the chip of a machine. The top module is [`NAME`], which is emitted as `dynrt_chip`.
///
/// # Errors
/// A mistake in the description, with its location in the Rust source.
pub fn emit(plan: &Plan) -> Result<Machine, HdlError> {
    Ok(Machine {
        config: plan.config.clone(),
        trace: plan.trace,
        design: Design::new(module(plan)?)?.with_prefix(default_prefix()),
    })
}

/// Describes the chip of a machine as a module.
///
/// # Errors
/// A mistake in the description; a configuration whose caches have no shape.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        NAME,
        "the whole chip: executes command lists from memory. Registers are behind an AXI4-Lite slave, memory behind an AXI4 master.",
    );
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let back = Back::of(plan).wires(&m, "");
    let told = back.get();

    let lists = m.part(
        "lists",
        "executes command lists: the command processor, the cast unit and the motion unit.",
        || executed(&m, plan, &told),
    )?;
    let (core, update) = core::place(
        plan,
        &core::module(plan)?,
        casting(&lists, &told),
        updating(&lists, &told),
    );
    let placed = Placed {
        m: &m,
        plan,
        lists,
        core,
        update,
    };
    let memory = placed.memory(inputs.m_axi)?;
    let registers = placed.registers(inputs.s_axi, &memory)?;
    back.drive(Back {
        start_valid: registers.start_valid,
        start_address: registers.start_address,
        commands_ready: memory.commands_ready,
        commands_beat: memory.commands_beat,
        write_ready: memory.write_ready,
        writes_done: memory.writes_done,
        invalidating: memory.invalidating,
        error_valid: memory.error_valid,
        error_address: memory.error_address,
        word_valid: memory.word.valid,
        word: memory.word.payload.data,
        ray_ready: core.ray_ready,
        hit: core.hit,
        nodes: memory.nodes,
        records: memory.records,
        vertices: memory.vertices,
        moved: memory.moved,
        sequence_ready: memory.rows_sequence_ready,
        row_valid: memory.row_word.valid,
        row: memory.row_word.payload.data,
        units: from_units(&core, &update),
    });
    let outputs = Outputs {
        s_axi: registers.s_axi,
        irq: registers.irq,
        m_axi: memory.m_axi,
        trace: trace(&core, lists.cast.hit_ready),
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}

/// The units that execute command lists.
#[derive(Clone, Copy)]
struct Lists<'b> {
    commands: commands::Outputs<Signal<'b>>,
    cast: cast::Outputs<Signal<'b>>,
    motion: motion::Outputs<Signal<'b>>,
}

/// Places the command processor, the cast unit and the motion unit.
fn executed<'b>(
    m: &'b Builder,
    plan: &Plan,
    told: &Back<Signal<'b>>,
) -> Result<Lists<'b>, HdlError> {
    let bus_bits = plan.config.bus_data_bits;
    let [casting, skinning, updating, motion_ready] =
        ["casting", "skinning", "updating", "motion_ready"].map(|name| m.wire(name, 1));
    let commands = commands::ports(plan, bus_bits).place(
        "commands",
        m,
        &commands::module(plan, bus_bits)?,
        commands::Inputs {
            start_valid: told.start_valid,
            start_address: told.start_address,
            read_ready: told.commands_ready,
            beat: told.commands_beat,
            write_ready: told.write_ready,
            casting: casting.get(),
            skinning: skinning.get(),
            updating: updating.get(),
            motion_ready: motion_ready.get(),
            writes_done: told.writes_done,
            invalidating: told.invalidating,
            bus_error_valid: told.error_valid,
            bus_error_address: told.error_address,
        },
    );
    m.comment("A signal goes before records, and those before hits.");
    let motion = motion::ports(plan).place(
        "motion",
        m,
        &motion::module(plan)?,
        motion::Inputs {
            start: commands.motion,
            sequence_ready: told.sequence_ready,
            word_valid: told.row_valid,
            word: told.row,
            units: told.units,
            write_ready: told.write_ready & !commands.write.valid,
        },
    );
    let before = commands.write.valid | motion.write.valid;
    let cast = cast::ports(plan).place(
        "cast",
        m,
        &cast::module(plan)?,
        cast::Inputs {
            start: Flow::new(commands.cast_valid, commands.cast.cast),
            word_valid: told.word_valid,
            word: told.word,
            ray_ready: told.ray_ready,
            hit: told.hit,
            write_ready: told.write_ready & !before,
        },
    );
    casting.drive(cast.casting);
    skinning.drive(motion.skinning);
    updating.drive(motion.updating);
    motion_ready.drive(motion.start_ready);
    Ok(Lists {
        commands,
        cast,
        motion,
    })
}

/// The units that are placed before the memory system and the registers.
struct Placed<'a, 'b> {
    m: &'b Builder,
    plan: &'a Plan,
    lists: Lists<'b>,
    core: raycast::Outputs<Signal<'b>>,
    update: update::Outputs<Signal<'b>>,
}

impl<'b> Placed<'_, 'b> {
    /// Places the memory system.
    fn memory(
        &self,
        m_axi: MasterInputs<Signal<'b>>,
    ) -> Result<memory::Outputs<Signal<'b>>, HdlError> {
        let Lists {
            commands,
            cast,
            motion,
        } = &self.lists;
        let core = &self.core;
        let records = motion.write;
        let of_units = (records.valid).choose(records.payload, cast.write.payload);
        let signals = commands.write.valid;
        let write = signals.choose(commands.write.payload, of_units);
        let cached = |base, request| CachedInputs { base, request };
        let of_scene = commands.scene.vertices;
        let vertices = motion.skinning.mux(motion.vertices, of_scene);
        let inputs = memory::Inputs {
            commands_read: commands.read,
            sequence: Flow::new(
                commands.cast_valid,
                Sequence {
                    address: commands.cast.rays_address,
                    words: commands.cast.words,
                },
            ),
            word_ready: cast.word_ready,
            rows_sequence: motion.sequence,
            row_word_ready: motion.word_ready,
            nodes: cached(commands.scene.nodes, core.node.request),
            records: cached(commands.scene.records, core.record.request),
            vertices: cached(vertices, core.vertex.request),
            moved: cached(motion.vertices, self.update.vertex.request),
            invalidate: commands.invalidate,
            write: Flow::new(signals | records.valid | cast.write.valid, write),
            flush: commands.flush,
            m_axi,
        };
        let module = memory::module(self.plan)?;
        Ok(memory::ports(self.plan).place("memory", self.m, &module, inputs))
    }

    /// Places the registers, and the counters that they show.
    fn registers(
        &self,
        s_axi: LiteInputs<Signal<'b>>,
        memory: &memory::Outputs<Signal<'b>>,
    ) -> Result<registers::Outputs<Signal<'b>>, HdlError> {
        let Lists { commands, cast, .. } = &self.lists;
        let event = counters::Events {
            list_cycles: commands.running,
            cast_cycles: cast.casting,
            cast_rays: cast.ray_taken,
            memory: memory.event,
        };
        let counters = counters::ports().place(
            "counters",
            self.m,
            &counters::module()?,
            counters::Inputs { event },
        );
        let inputs = registers::Inputs {
            s_axi,
            start_ready: commands.start_ready,
            running: commands.running,
            signalled: commands.signalled,
            ended: commands.ended,
            failure: commands.failure,
            count: self.core.count,
            update: self.update.count,
            counted: counters.count,
        };
        let module = registers::module(self.plan)?;
        Ok(registers::ports().place("registers", self.m, &module, inputs))
    }
}

/// A read port's inputs, from its cache.
fn port<'b>(cache: CachedOutputs<Signal<'b>>) -> ReadInputs<Signal<'b>> {
    ReadInputs {
        request_ready: cache.request_ready,
        response: cache.response,
    }
}

/// The inputs of the ray casting unit.
fn casting<'b>(lists: &Lists<'b>, told: &Back<Signal<'b>>) -> raycast::Inputs<Signal<'b>> {
    let Lists {
        commands,
        cast,
        motion,
    } = lists;
    raycast::Inputs {
        scene_root: commands.scene.root,
        scene_lo: commands.scene.lo,
        scene_hi: commands.scene.hi,
        ray: cast.ray,
        hit_ready: cast.hit_ready,
        node: port(told.nodes),
        record: port(told.records),
        vertex: port(told.vertices),
        influence: motion.units.influence,
        skin_start: motion.units.skin,
        skin_write_ready: motion.units.skinned_ready,
    }
}

/// The inputs of the update processor.
fn updating<'b>(lists: &Lists<'b>, told: &Back<Signal<'b>>) -> update::Inputs<Signal<'b>> {
    let units = lists.motion.units;
    update::Inputs {
        start: units.update,
        program: units.program,
        vertex: port(told.moved),
        node_write_ready: units.node_ready,
        box_write_ready: units.bounds_ready,
    }
}

/// What the skinning processor and the update processor show.
fn from_units<'b>(
    core: &raycast::Outputs<Signal<'b>>,
    update: &update::Outputs<Signal<'b>>,
) -> FromUnits<Signal<'b>> {
    let row = |valid, tag| Flow::new(valid, RowRequest { tag });
    let influence = core.influence.request;
    let program = update.program.request;
    FromUnits {
        skin_ready: core.skin_start_ready,
        skin_done: core.skin_done,
        skinned: core.skin_write,
        influence: row(influence.valid, influence.payload.tag),
        update_ready: update.start_ready,
        update_done: update.done,
        node: update.node_write,
        bounds_valid: update.box_write.valid,
        bounds: update.box_write.payload.data,
        program: row(program.valid, program.payload.tag),
    }
}

/// What the trace ports of the core show, if it has them.
fn trace<'b>(
    core: &raycast::Outputs<Signal<'b>>,
    hit_ready: Signal<'b>,
) -> Option<Trace<Signal<'b>>> {
    let (start, step) = (core.trace_start?, core.trace_step?);
    Some(Trace {
        start_valid: start.valid,
        start_tag: start.payload.tag,
        hit_valid: core.hit.valid & hit_ready,
        hit_tag: core.hit.payload.tag,
        step: step.valid,
        test: core.trace_test?.valid,
    })
}
