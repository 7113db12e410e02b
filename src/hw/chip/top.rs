//! The chip's module: instantiates the units and joins them.

use super::cast::{self, Cast};
use super::commands;
use super::registers::{self, CacheEvents, LiteInputs, LiteOutputs};
use super::{Client, NAME, WordWrite, bus, cache_shape, record_of};
use crate::bkd::bytes::ByteRecord;
use crate::hdl::{
    Builder, Bundle, Design, Flow, HdlError, Module, ReadInputs, ReadOutputs, Response, Signal,
    Spec, Specs, Wires,
};
use crate::hw::core::{self, default_prefix};
use crate::hw::memory::axi::{self, MasterInputs, MasterOutputs};
use crate::hw::memory::cache::{self, Shape};
use crate::hw::memory::{ADDRESS_BITS, Beat, Burst, combiner, reader};
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
    /// What a client of the read arbiter receives.
    struct ToClient(id_bits: u32, data_bits: u32) {
        ready: 1,
        beat: Flow<Beat>(id_bits, data_bits),
    }
}

bundle! {
    /// Signals from later units to earlier ones.
    struct Back(plan: &Plan) {
        start_valid: 1,
        start_address: ADDRESS_BITS,
        commands: {ToClient}(1, plan.config.bus_data_bits),
        rays: {ToClient}(1, plan.config.bus_data_bits),
        signal_ready: 1,
        hits_ready: 1,
        casting: 1,
        writes_done: 1,
        invalidating: 1,
        error_valid: 1,
        error_address: ADDRESS_BITS,
        word_ready: 1,
        ray_ready: 1,
        hit: Flow<TaggedHit>(plan),
        nodes: {CacheOut = cache_out(plan, Port::Nodes)},
        records: {CacheOut = cache_out(plan, Port::Records)},
        vertices: {CacheOut = cache_out(plan, Port::Vertices)},
    }
}

bundle! {
    /// A read port of the ray casting unit, as its cache answers it.
    struct CacheOut(tag_bits: u32, record_bits: u32) {
        request_ready: 1,
        response: Flow<Response>(tag_bits, record_bits),
    }
}

/// The read ports of the ray casting unit.
#[derive(Clone, Copy)]
enum Port {
    Nodes,
    Records,
    Vertices,
}

impl Port {
    fn layout(self, plan: &Plan) -> ByteRecord {
        match self {
            Port::Nodes => ByteRecord::node(plan.format),
            Port::Records => ByteRecord::triangle(plan.format),
            Port::Vertices => ByteRecord::vertex(plan.format),
        }
    }

    fn kib(self, plan: &Plan) -> u32 {
        match self {
            Port::Nodes => plan.config.cache_nodes_kib,
            Port::Records => plan.config.cache_records_kib,
            Port::Vertices => plan.config.cache_vertices_kib,
        }
    }

    /// The port's definition: widths of index and tag.
    fn of<T>(self, outputs: &raycast::Outputs<T>) -> &ReadOutputs<T> {
        match self {
            Port::Nodes => &outputs.node,
            Port::Records => &outputs.record,
            Port::Vertices => &outputs.vertex,
        }
    }

    fn shape(self, plan: &Plan) -> Shape {
        let ports = raycast::ports(plan);
        let request = &self.of(&ports.outputs).request.payload;
        cache_shape(
            plan,
            &self.layout(plan),
            self.kib(plan),
            request.address.width,
            request.tag.width,
        )
    }
}

fn cache_out(plan: &Plan, port: Port) -> CacheOut<Spec> {
    let ports = raycast::ports(plan);
    let tag = port.of(&ports.outputs).request.payload.tag.width;
    CacheOut::of(tag, port.layout(plan).record.width)
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

/// A burst that a client offers, with its number and its own identifier.
type Offer<'b> = Flow<Burst<Signal<'b>>, Signal<'b>>;

/// Describes the chip of a machine as a module.
///
/// # Errors
/// A mistake in the description; a configuration whose caches have no shape.
pub fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        NAME,
        "the whole chip: executes command lists from memory. Registers are behind an AXI4-Lite slave, memory behind an AXI4 master.",
    );
    let config = &plan.config;
    let bus = bus(config);
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let back = Back::of(plan).wires(&m, "");
    let told = back.get();

    let commands = commands::ports(plan, bus.data_bits).place(
        "commands",
        &m,
        &commands::module(plan, bus.data_bits)?,
        commands::Inputs {
            start_valid: told.start_valid,
            start_address: told.start_address,
            read_ready: told.commands.ready,
            beat: told.commands.beat,
            write_ready: told.signal_ready,
            casting: told.casting,
            writes_done: told.writes_done,
            invalidating: told.invalidating,
            bus_error_valid: told.error_valid,
            bus_error_address: told.error_address,
        },
    );
    let start = commands.cast;
    let words = reader::ports(bus.data_bits).place(
        "ray_words",
        &m,
        &reader::module(bus.data_bits, config.bus_rays_ahead)?,
        reader::Inputs {
            start: Flow::new(
                commands.cast_valid,
                reader::Sequence {
                    address: start.rays_address,
                    words: start.words,
                },
            ),
            read_ready: told.rays.ready,
            beat: told.rays.beat,
            word_ready: told.word_ready,
        },
    );
    let cast = cast::ports(plan).place(
        "cast",
        &m,
        &cast::module(plan)?,
        cast::Inputs {
            start: Flow::new(
                commands.cast_valid,
                Cast {
                    rays: start.rays,
                    hits: start.hits,
                },
            ),
            word_valid: words.word_valid,
            word: words.word,
            ray_ready: told.ray_ready,
            hit: told.hit,
            write_ready: told.hits_ready,
        },
    );
    let casting = core_inputs(&m, plan, &commands, &cast, &told);
    let updating = update::ports(plan).inputs.map(|_, spec| m.zero(spec.width));
    let (core, _) = core::place(plan, &core::module(plan)?, casting, updating);

    let mut offers: Vec<(Client, Offer<'_>)> = vec![
        (Client::Commands, commands.read),
        (Client::Rays, words.read),
    ];
    let master_beat = Beat::of(bus.id_bits, bus.data_bits).wires(&m, "bus_beat");
    let beat_valid = m.wire("bus_beat_valid", 1);
    let beat = Flow::new(beat_valid.get(), master_beat.get());
    let grants = m.wire("granted_clients", Client::ALL.len() as u32);
    let granted = |client: Client| grants.get().bit(client as u32);
    let mut caches = vec![];
    for (client, port, name, base) in [
        (
            Client::Nodes,
            Port::Nodes,
            "node_cache",
            commands.scene.nodes,
        ),
        (
            Client::Records,
            Port::Records,
            "record_cache",
            commands.scene.records,
        ),
        (
            Client::Vertices,
            Port::Vertices,
            "vertex_cache",
            commands.scene.vertices,
        ),
    ] {
        let shape = port.shape(plan);
        let read = port.of(&core).request;
        let beat = own_beat(config, client, beat);
        let placed = cache::ports(&shape).place(
            format!("{name}_unit"),
            &m,
            &cache::module(name, &shape)?,
            cache::Inputs {
                request: read,
                base,
                invalidate: commands.invalidate,
                burst_ready: granted(client),
                beat,
            },
        );
        offers.push((client, placed.burst));
        caches.push((port, placed));
    }
    let (granted_burst, grant_bits, read_ready) = arbitrate(&m, config, &offers);
    grants.drive(grant_bits);

    let hit_write = cast.write;
    let signal_first = commands.write.valid;
    let write = signal_first.choose(commands.write.payload, hit_write.payload);
    let write_valid = (commands.write.valid | hit_write.valid).named("write_word_valid");
    let sizes = combiner::Sizes {
        data_bits: bus.data_bits,
        lines: config.bus_write_lines,
        writes: config.bus_writes,
    };
    let combined = Combined::of(&bus).wires(&m, "combined");
    let told_combiner = combined.get();
    let WordWrite {
        address,
        data,
        strobes,
    } = write;
    let combiner = combiner::ports(&sizes).place(
        "combiner",
        &m,
        &combiner::module(&sizes)?,
        combiner::Inputs {
            word: Flow::new(
                write_valid,
                combiner::Word {
                    address,
                    data,
                    strobes,
                },
            ),
            flush: commands.flush,
            write_ready: told_combiner.write_ready,
            datum_ready: told_combiner.datum_ready,
            written: told_combiner.written,
        },
    );
    let master = axi::ports(&bus).place(
        "master",
        &m,
        &axi::module(&bus)?,
        axi::Inputs {
            read: granted_burst,
            write: combiner.write,
            datum: combiner.datum,
            m_axi: inputs.m_axi,
        },
    );
    combined.drive(Combined {
        write_ready: master.write_ready,
        datum_ready: master.datum_ready,
        written: master.written,
    });
    read_ready.drive(master.read_ready);
    beat_valid.drive(master.beat.valid);
    master_beat.drive(master.beat.payload);

    let events = |place: usize| {
        let event = caches[place].1.event;
        CacheEvents {
            requests: event.requests,
            hits: event.hits,
            misses: event.misses,
            stalls: event.stalls,
        }
    };
    let registers = registers::ports().place(
        "registers",
        &m,
        &registers::module(plan)?,
        registers::Inputs {
            s_axi: inputs.s_axi,
            start_ready: commands.start_ready,
            running: commands.running,
            signalled: commands.signalled,
            ended: commands.ended,
            failure: commands.failure,
            count: core.count,
            event: registers::Events {
                list_cycles: commands.running,
                cast_cycles: cast.casting,
                cast_rays: cast.ray_taken,
                node: events(0),
                record: events(1),
                vertex: events(2),
                read_beats: master.event.beat_read,
                read_waits: master.event.read_waits,
                write_beats: master.event.beat_written,
                write_waits: master.event.write_waits | master.event.datum_waits,
            },
        },
    );
    let invalidating: Vec<_> = caches.iter().map(|(_, cache)| cache.invalidating).collect();
    let read_errors: Vec<_> = caches.iter().map(|(_, cache)| cache.error.valid).collect();
    let error = m.or_all(&read_errors);
    let port = |place: usize| -> CacheOut<Signal<'_>> {
        let (port, cache) = &caches[place];
        let response = cache.response;
        CacheOut {
            request_ready: cache.request_ready,
            response: Flow::new(
                response.valid,
                Response {
                    tag: response.payload.tag,
                    data: record_of(plan, &port.layout(plan), response.payload.data),
                },
            ),
        }
    };
    back.drive(Back {
        start_valid: registers.start_valid,
        start_address: registers.start_address,
        commands: ToClient {
            ready: granted(Client::Commands),
            beat: own_beat(config, Client::Commands, beat),
        },
        rays: ToClient {
            ready: granted(Client::Rays),
            beat: own_beat(config, Client::Rays, beat),
        },
        signal_ready: combiner.word_ready,
        hits_ready: combiner.word_ready & !commands.write.valid,
        casting: cast.casting,
        writes_done: combiner.empty,
        invalidating: m.or_all(&invalidating),
        error_valid: error,
        error_address: caches[0].1.error.payload.address,
        word_ready: cast.word_ready,
        ray_ready: core.ray_ready,
        hit: core.hit,
        nodes: port(0),
        records: port(1),
        vertices: port(2),
    });
    let outputs = Outputs {
        s_axi: registers.s_axi,
        irq: registers.irq,
        m_axi: master.m_axi,
        trace: trace(&core, cast.hit_ready),
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
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

bundle! {
    /// Signals from the master to the write combiner.
    struct Combined(_bus: &axi::Bus) {
        write_ready: 1,
        datum_ready: 1,
        written: 1,
    }
}

/// The inputs of the ray casting unit. Nothing is skinned.
fn core_inputs<'b>(
    m: &'b Builder,
    plan: &Plan,
    commands: &commands::Outputs<Signal<'b>>,
    cast: &cast::Outputs<Signal<'b>>,
    told: &Back<Signal<'b>>,
) -> raycast::Inputs<Signal<'b>> {
    let zeros: raycast::Inputs<Signal<'b>> = raycast::ports(plan)
        .inputs
        .map(|_, spec| m.zero(spec.width));
    let port = |cache: CacheOut<Signal<'b>>| ReadInputs {
        request_ready: cache.request_ready,
        response: cache.response,
    };
    raycast::Inputs {
        scene_root: commands.scene.root,
        scene_lo: commands.scene.lo,
        scene_hi: commands.scene.hi,
        ray: cast.ray,
        hit_ready: cast.hit_ready,
        node: port(told.nodes),
        record: port(told.records),
        vertex: port(told.vertices),
        ..zeros
    }
}

/// The beats of a client, with its own identifier.
fn own_beat<'b>(
    config: &crate::config::Config,
    client: Client,
    beat: Flow<Beat<Signal<'b>>, Signal<'b>>,
) -> Flow<Beat<Signal<'b>>, Signal<'b>> {
    let id = beat.payload.id;
    let own = super::own_bits(config);
    let number = id.high(id.width() - own);
    let is_own = number.equals(client as u128);
    let payload = Beat {
        id: id.low(client.id_bits(config)),
        ..beat.payload
    };
    Flow::new(beat.valid & is_own, payload)
}

/// Selects one of the offered bursts in rotation. Returns it, the clients' ready bits, and the wire of the master's ready.
fn arbitrate<'b>(
    m: &'b Builder,
    config: &crate::config::Config,
    offers: &[(Client, Offer<'b>)],
) -> (Offer<'b>, Signal<'b>, crate::hdl::Wire<'b>) {
    let count = offers.len() as u32;
    let ready = m.wire("read_is_accepted", 1);
    let bits = 3;
    let last = m.reg_reset("last_client", bits, 0);
    let own = super::own_bits(config);
    let bus = bus(config);
    // A client behind the last one goes first; then any.
    let behind: Vec<_> = offers
        .iter()
        .map(|(client, offer)| offer.valid & last.q.lt(m.lit(*client as u32, bits)))
        .collect();
    let any: Vec<_> = offers.iter().map(|(_, offer)| offer.valid).collect();
    let number = |client: Client| m.lit(client as u32, bits);
    let mut choices: Vec<_> = vec![];
    for (place, (client, _)) in offers.iter().enumerate() {
        choices.push((behind[place], number(*client)));
    }
    for (place, (client, _)) in offers.iter().enumerate() {
        choices.push((any[place], number(*client)));
    }
    let selected = m.priority(&choices, m.zero(bits)).named("selected_client");
    let valid = m.or_all(&any).named("offered_burst");
    // The offer is registered: it is stable until the master takes it.
    let stored = m.reg_reset("burst_is_stored", 1, 0);
    let taken = stored.q & ready.get();
    let loads = (valid & (!stored.q | taken)).named("burst_loads");
    stored.next(loads | (stored.q & !taken));
    last.next_when(loads, selected);
    let select = |values: Vec<Signal<'b>>| m.select(selected, &values);
    let address = m.reg("burst_address", ADDRESS_BITS);
    address.next_when(
        loads,
        select(offers.iter().map(|(_, o)| o.payload.address).collect()),
    );
    let beats = m.reg("burst_beats", 8);
    beats.next_when(
        loads,
        select(offers.iter().map(|(_, o)| o.payload.beats).collect()),
    );
    let id = m.reg("burst_id", bus.id_bits);
    id.next_when(
        loads,
        selected.concat(select(
            offers
                .iter()
                .map(|(_, o)| o.payload.id.extend(own))
                .collect(),
        )),
    );
    let grants: Vec<_> = (0..count)
        .rev()
        .map(|k| loads & selected.equals(k.into()))
        .collect();
    let burst = Burst {
        address: address.q,
        beats: beats.q,
        id: id.q,
    };
    (Flow::new(stored.q, burst), m.concat(&grants), ready)
}
