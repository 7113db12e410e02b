//! The memory system of the chip: caches, burst readers and write combiner between the units and the AXI4 master.

use super::{Client, arbiter_sizes, bus, cache_shape, record_of};
use crate::bkd::bytes::ByteRecord;
use crate::hdl::{Builder, Flow, HdlError, Module, Request, Response, Signal, Specs, Wires};
use crate::hw::memory::arbiter::{self, ClientInputs};
use crate::hw::memory::axi::{self, MasterInputs, MasterOutputs};
use crate::hw::memory::cache::{self, Events as CacheEvents, Shape};
use crate::hw::memory::combiner::{self, Word};
use crate::hw::memory::reader::{self, Sequence, Word as ReadWord};
use crate::hw::memory::{ADDRESS_BITS, Beat, Burst};
use crate::hw::plan::Plan;
use crate::hw::raycast;
use crate::hw::update;
use crate::{bundle, interface};
use std::sync::Arc;

/// A read port that has a cache: of the ray casting unit, and the vertices of the update processor.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Port {
    Nodes,
    Records,
    Vertices,
    Moved,
}

impl Port {
    fn layout(self, plan: &Plan) -> ByteRecord {
        match self {
            Port::Nodes => ByteRecord::node(plan.format),
            Port::Records => ByteRecord::triangle(plan.format),
            Port::Vertices | Port::Moved => ByteRecord::vertex(plan.format),
        }
    }

    /// The KiB of its cache, and the name of the cache.
    fn cache(self, plan: &Plan) -> (u32, &'static str) {
        match self {
            Port::Nodes => (plan.config.cache_nodes_kib, "node_cache"),
            Port::Records => (plan.config.cache_records_kib, "record_cache"),
            Port::Vertices => (plan.config.cache_vertices_kib, "vertex_cache"),
            Port::Moved => (plan.config.cache_update_kib, "update_cache"),
        }
    }

    /// The heading of its ports.
    fn heading(self) -> &'static str {
        match self {
            Port::Nodes => "Nodes: byte address of the array, and requests by index",
            Port::Records => "Triangle records: byte address of the array, and requests by index",
            Port::Vertices => "Vertices: byte address of the array, and requests by index",
            Port::Moved => {
                "Vertices that are updated: byte address of the array, and requests by index"
            }
        }
    }

    /// The widths of index and tag.
    fn widths(self, plan: &Plan) -> (u32, u32) {
        let ports = raycast::ports(plan).outputs;
        let of_update = update::ports(plan).outputs;
        let port = match self {
            Port::Nodes => &ports.node,
            Port::Records => &ports.record,
            Port::Vertices => &ports.vertex,
            Port::Moved => &of_update.vertex,
        };
        let request = &port.request.payload;
        (request.address.width, request.tag.width)
    }

    fn shape(self, plan: &Plan) -> Shape {
        let (index_bits, tag_bits) = self.widths(plan);
        let (kib, _) = self.cache(plan);
        cache_shape(plan, &self.layout(plan), kib, index_bits, tag_bits)
    }
}

bundle! {
    /// The inputs of a cached read port.
    pub(super) struct CachedInputs(plan: &Plan, port: Port) {
        (port.heading()) {
            /// The byte address of record 0.
            base: ADDRESS_BITS,
            request: Flow<Request>(port.widths(plan).0, port.widths(plan).1),
        }
    }
}

bundle! {
    /// The outputs of a cached read port.
    pub(super) struct CachedOutputs(plan: &Plan, port: Port) {
        (port.heading()) {
            request_ready: 1,
            response: Flow<Response>(port.widths(plan).1, port.layout(plan).record.width),
        }
    }
}

bundle! {
    /// Events of the memory system.
    pub struct Events() {
        node: {CacheEvents}(),
        record: {CacheEvents}(),
        vertex: {CacheEvents}(),
        moved: {CacheEvents}(),
        read_beats: 1,
        read_waits: 1,
        write_beats: 1,
        write_waits: 1,
    }
}

interface! {
    pub(super) (plan: &Plan) {
        in "Command processor: bursts, and their beats" { commands_read: Flow<Burst>(1) }
        out "Command processor: bursts, and their beats" {
            commands_ready: 1,
            commands_beat: Flow<Beat>(1, plan.config.bus_data_bits),
        }
        in "Rays: a sequence of words to read" { sequence: Flow<Sequence>() }
        out "Rays: the words, in order" { word: Flow<ReadWord>() }
        in "Rays: the words, in order" { word_ready: 1 }
        in "Rows of an update program or of influences: a sequence of words to read" {
            rows_sequence: Flow<Sequence>(),
        }
        out "Rows of an update program or of influences: a sequence of words to read" {
            rows_sequence_ready: 1,
        }
        out "Rows: the words, in order" { row_word: Flow<ReadWord>() }
        in "Rows: the words, in order" { row_word_ready: 1 }
        in "" {
            nodes: {CachedInputs}(plan, Port::Nodes),
            records: {CachedInputs}(plan, Port::Records),
            vertices: {CachedInputs}(plan, Port::Vertices),
            moved: {CachedInputs}(plan, Port::Moved),
        }
        out "" {
            nodes: {CachedOutputs}(plan, Port::Nodes),
            records: {CachedOutputs}(plan, Port::Records),
            vertices: {CachedOutputs}(plan, Port::Vertices),
            moved: {CachedOutputs}(plan, Port::Moved),
        }
        in "Discards all lines of the caches; only while no request is outstanding" { invalidate: 1 }
        out "Discards all lines of the caches; only while no request is outstanding" { invalidating: 1 }
        in "Words to write" { write: Flow<Word>() }
        out "Words to write" { write_ready: 1 }
        in "While it is high, no word is accepted and all lines are written" { flush: 1 }
        out "High if no accepted word is on its way to memory" { writes_done: 1 }
        in "" { m_axi: {MasterInputs}(&bus(&plan.config)) }
        out "" { m_axi: {MasterOutputs}(&bus(&plan.config)) }
        out "High for one cycle at an error of the bus, with the address of a line that was read" {
            error_valid: 1,
            error_address: ADDRESS_BITS,
        }
        out "Events for the counters" { event: {Events}() }
    }
}

bundle! {
    /// Signals from the master to the units before it.
    struct Back(plan: &Plan) {
        read_ready: 1,
        write_ready: 1,
        datum_ready: 1,
        written: 1,
        beat: Flow<Beat>(bus(&plan.config).id_bits, plan.config.bus_data_bits),
    }
}

bundle! {
    /// Signals from the arbiter to a client.
    struct ToClient(id_bits: u32, data_bits: u32) {
        ready: 1,
        beat: Flow<Beat>(id_bits, data_bits),
    }
}

/// Describes the memory system of a machine.
///
/// # Errors
/// A mistake in the description; a configuration whose caches have no shape.
pub(super) fn module(plan: &Plan) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "memory_system",
        "the memory system: caches, the burst readers for rays and rows, and the write combiner, behind one AXI4 master.",
    );
    let config = &plan.config;
    let bus = bus(config);
    let ports = ports(plan);
    let inputs = ports.inputs.inputs(&m);
    let back = Back::of(plan).wires(&m, "master_to");
    let told = back.get();
    let wires = Client::ALL.map(|client| {
        let of = ToClient::of(client.id_bits(config), bus.data_bits);
        of.wires(&m, &format!("to_{}", client.name()))
    });
    let to = |client: Client| wires[client as usize].get();
    let around = Around {
        m: &m,
        plan,
        inputs: &inputs,
    };
    let rays = around.reader(Client::Rays, to(Client::Rays))?;
    let rows = around.reader(Client::Rows, to(Client::Rows))?;
    let mut reads = vec![inputs.commands_read, rays.read, rows.read];
    let mut caches = vec![];
    for (port, client, of_port) in [
        (Port::Nodes, Client::Nodes, inputs.nodes),
        (Port::Records, Client::Records, inputs.records),
        (Port::Vertices, Client::Vertices, inputs.vertices),
        (Port::Moved, Client::Moved, inputs.moved),
    ] {
        let cache = around.cache(port, client, of_port, to(client))?;
        reads.push(cache.burst);
        caches.push(cache);
    }
    let clients: Vec<_> = reads
        .into_iter()
        .map(|read| ClientInputs { read })
        .collect();
    let to_arbiter = arbiter::Inputs {
        read_ready: told.read_ready,
        beat: told.beat,
    };
    let (clients, sent) =
        arbiter::place("arbiter", &m, &arbiter_sizes(config), &clients, to_arbiter)?;
    for (wires, client) in wires.iter().zip(&clients) {
        wires.drive(ToClient {
            ready: client.read_ready,
            beat: client.beat,
        });
    }

    let combiner = around.combiner(told)?;
    let master = axi::ports(&bus).place(
        "master",
        &m,
        &axi::module(&bus)?,
        axi::Inputs {
            read: sent.read,
            write: combiner.write,
            datum: combiner.datum,
            m_axi: inputs.m_axi,
        },
    );
    back.drive(Back {
        read_ready: master.read_ready,
        write_ready: master.write_ready,
        datum_ready: master.datum_ready,
        written: master.written,
        beat: master.beat,
    });

    let invalidating: Vec<_> = caches.iter().map(|cache| cache.invalidating).collect();
    let errors: Vec<_> = (caches.iter())
        .map(|cache| (cache.error.valid, cache.error.payload.address))
        .collect();
    let event = master.event;
    let outputs = Outputs {
        commands_ready: clients[0].read_ready,
        commands_beat: clients[0].beat,
        word: rays.word,
        nodes: around.cached(Port::Nodes, &caches[0]),
        records: around.cached(Port::Records, &caches[1]),
        vertices: around.cached(Port::Vertices, &caches[2]),
        moved: around.cached(Port::Moved, &caches[3]),
        rows_sequence_ready: rows.start_ready,
        row_word: rows.word,
        invalidating: m.or_all(&invalidating),
        write_ready: combiner.word_ready,
        writes_done: combiner.empty,
        m_axi: master.m_axi,
        error_valid: event.read_error | event.write_error,
        error_address: m.priority(&errors, m.zero(ADDRESS_BITS)),
        event: Events {
            node: caches[0].event,
            record: caches[1].event,
            vertex: caches[2].event,
            moved: caches[3].event,
            read_beats: event.beat_read,
            read_waits: event.read_waits,
            write_beats: event.beat_written,
            write_waits: event.write_waits | event.datum_waits,
        },
    };
    ports.outputs.outputs(&m, outputs);
    m.finish()
}

/// The description that the units of the memory system become part of.
struct Around<'a, 'b> {
    m: &'b Builder,
    plan: &'a Plan,
    inputs: &'a Inputs<Signal<'b>>,
}

impl<'b> Around<'_, 'b> {
    /// Places a burst reader: for the words of rays, or for those of rows.
    fn reader(
        &self,
        client: Client,
        told: ToClient<Signal<'b>>,
    ) -> Result<reader::Outputs<Signal<'b>>, HdlError> {
        let (config, inputs) = (&self.plan.config, self.inputs);
        let (words, start, word_ready) = match client {
            Client::Rows => (
                config.bus_rows_ahead,
                inputs.rows_sequence,
                inputs.row_word_ready,
            ),
            _ => (config.bus_rays_ahead, inputs.sequence, inputs.word_ready),
        };
        let sizes = reader::Sizes {
            data_bits: config.bus_data_bits,
            id_bits: 1,
            words,
            registers_front: self.plan.timing.queue_front,
        };
        let data = told.beat.payload.data;
        let inputs = reader::Inputs {
            start,
            read_ready: told.ready,
            beat: Flow::new(told.beat.valid, reader::Datum { data }),
            word_ready,
        };
        let module = reader::module(&sizes)?;
        Ok(reader::ports(&sizes).place(client.name(), self.m, &module, inputs))
    }

    /// Places the cache of a port.
    fn cache(
        &self,
        port: Port,
        client: Client,
        of_port: CachedInputs<Signal<'b>>,
        told: ToClient<Signal<'b>>,
    ) -> Result<cache::Outputs<Signal<'b>>, HdlError> {
        let (shape, (_, name)) = (port.shape(self.plan), port.cache(self.plan));
        let inputs = cache::Inputs {
            request: of_port.request,
            base: of_port.base,
            invalidate: self.inputs.invalidate,
            burst_ready: told.ready,
            beat: told.beat,
        };
        let instance = format!("cache_of_{}", client.name());
        let module = cache::module(name, &shape)?;
        Ok(cache::ports(&shape).place(instance, self.m, &module, inputs))
    }

    /// What a cache answers at its port: the record of the bytes that were read.
    fn cached(&self, port: Port, cache: &cache::Outputs<Signal<'b>>) -> CachedOutputs<Signal<'b>> {
        let Response { tag, data } = cache.response.payload;
        let data = record_of(self.plan, &port.layout(self.plan), data);
        CachedOutputs {
            request_ready: cache.request_ready,
            response: Flow::new(cache.response.valid, Response { tag, data }),
        }
    }

    /// Places the write combiner.
    fn combiner(&self, told: Back<Signal<'b>>) -> Result<combiner::Outputs<Signal<'b>>, HdlError> {
        let config = &self.plan.config;
        let sizes = combiner::Sizes {
            data_bits: config.bus_data_bits,
            lines: config.bus_write_lines,
            writes: config.bus_writes,
        };
        let inputs = combiner::Inputs {
            word: self.inputs.write,
            flush: self.inputs.flush,
            write_ready: told.write_ready,
            datum_ready: told.datum_ready,
            written: told.written,
        };
        let module = combiner::module(&sizes)?;
        Ok(combiner::ports(&sizes).place("combiner", self.m, &module, inputs))
    }
}
