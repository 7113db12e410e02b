//! The read arbiter: sends the bursts of its clients, in rotation, and routes the beats back.
//!
//! A register holds whose turn it is, as one bit for each client. The turn stays while its client's burst waits. When the burst is accepted,
//! or while the client has none, the turn goes to the next client that has one, if there is another. So the choice of a client has a
//! cycle of its own, and one burst per cycle is accepted as long as a client has one.

mod properties;

use super::{Beat, Burst};
use crate::hdl::{
    Builder, Bundle, Flow, HdlError, Module, Ports, Reg, Signal, Spec, Specs, bits_for,
};
use crate::{bundle, interface};
use std::sync::Arc;

/// The parameters of an arbiter.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sizes {
    pub data_bits: u32,
    /// Bits of each client's identifiers.
    pub clients: Vec<u32>,
}

impl Sizes {
    fn number_bits(&self) -> u32 {
        bits_for(self.clients.len() as u64)
    }

    fn local_bits(&self) -> u32 {
        self.clients.iter().copied().max().unwrap_or(1)
    }

    /// Bits of an identifier on the bus: the number of a client and its own identifier.
    pub fn id_bits(&self) -> u32 {
        self.number_bits() + self.local_bits()
    }
}

bundle! {
    /// The inputs of a client's port.
    pub struct ClientInputs(number: usize, id_bits: u32) {
        (format!("Client {number}: bursts")) { read: Flow<Burst>(id_bits) }
    }
}

bundle! {
    /// The outputs of a client's port.
    pub struct ClientOutputs(number: usize, id_bits: u32, data_bits: u32) {
        (format!("Client {number}: bursts")) { read_ready: 1 }
        (format!("Client {number}: beats, always taken")) { beat: Flow<Beat>(id_bits, data_bits) }
    }
}

interface! {
    pub (sizes: &Sizes) {
        out "Bursts of all clients" { read: Flow<Burst>(sizes.id_bits()) }
        in "Bursts of all clients" { read_ready: 1 }
        in "Beats for all clients" { beat: Flow<Beat>(sizes.id_bits(), sizes.data_bits) }
    }
}

/// Returns the definition of each client's port. Its names begin with `client`, the number and `_`.
pub fn clients(sizes: &Sizes) -> Vec<Ports<ClientInputs<Spec>, ClientOutputs<Spec>>> {
    let port = |(number, id_bits): (usize, &u32)| {
        let named = |spec: Spec| Spec {
            name: format!("client{number}_{}", spec.name),
            ..spec
        };
        Ports {
            inputs: ClientInputs::of(number, *id_bits).map(|_, spec| named(spec)),
            outputs: ClientOutputs::of(number, *id_bits, sizes.data_bits)
                .map(|_, spec| named(spec)),
        }
    };
    sizes.clients.iter().enumerate().map(port).collect()
}

/// The outputs of an arbiter: those of each client's port, and the others.
pub type Placed<'b> = (Vec<ClientOutputs<Signal<'b>>>, Outputs<Signal<'b>>);

/// Places an arbiter.
///
/// # Errors
/// None for at least two clients.
pub fn place<'b>(
    name: &str,
    m: &'b Builder,
    sizes: &Sizes,
    of_clients: &[ClientInputs<Signal<'b>>],
    inputs: Inputs<Signal<'b>>,
) -> Result<Placed<'b>, HdlError> {
    let module = module(sizes)?;
    let (ports, clients) = (ports(sizes), clients(sizes));
    let mut connected = vec![];
    for (port, client) in clients.iter().zip(of_clients) {
        (port.inputs).with(*client, |spec: Spec, signal| {
            connected.push((spec.name, signal))
        });
    }
    (ports.inputs).with(inputs, |spec: Spec, signal| {
        connected.push((spec.name, signal))
    });
    let connected: Vec<_> = (connected.iter())
        .map(|(name, signal)| (name.as_str(), *signal))
        .collect();
    let placed = m.instance(name, &module, &connected);
    let of_clients = clients
        .iter()
        .map(|port| port.outputs.map(|_, spec| placed.get(&spec.name)));
    let outputs = ports.outputs.map(|_, spec| placed.get(&spec.name));
    Ok((of_clients.collect(), outputs))
}

/// Describes an arbiter.
///
/// # Errors
/// None for at least two clients.
pub fn module(sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "read_arbiter",
        "the read arbiter: sends the bursts of its clients, in rotation, and routes the beats back.",
    );
    let clients = clients(sizes);
    let bursts: Vec<_> = clients
        .iter()
        .map(|port| port.inputs.inputs(&m).read)
        .collect();
    let ports = ports(sizes);
    let Inputs { read_ready, beat } = ports.inputs.inputs(&m);

    m.comment("The turn: one bit for each client. It moves when the burst of its client is accepted, or if it has none.");
    let count = clients.len();
    let turn: Vec<Reg<'_>> = (0..count)
        .map(|i| m.reg_reset(format!("turn{i}"), 1, u128::from(i == 0)))
        .collect();
    let has = |i: usize| bursts[i % count].valid;
    let offered: Vec<_> = (0..count)
        .map(|i| (turn[i].q & has(i)).hinted(format!("offered{i}")))
        .collect();
    let valid = m.or_all(&offered).named("any_offered");
    let moves = (read_ready | !valid).named("turn_ends");
    let others: Vec<_> = (0..count)
        .map(|i| (has(i) & !turn[i].q).hinted(format!("waits{i}")))
        .collect();
    let others = m.or_all(&others).named("another_waits");
    let moves = (moves & others).named("turn_moves");
    for i in 0..count {
        // From each other client on, if none between them and this one has a burst: with the turn of the client before, of the second
        // one before, and so on.
        let mut from = m.zero(1);
        for steps in (1..count).rev() {
            let other = (i + count - steps) % count;
            let passes = match steps + 1 < count {
                true => from & !has(other),
                false => from,
            };
            from = (passes | turn[other].q).hinted(format!("turn_reaches{i}_from{other}"));
        }
        let next = (has(i) & from).hinted(format!("turn{i}_is_next"));
        turn[i].next_when(moves, next);
    }

    m.comment("The identifier on the bus is the number of the client and its own.");
    let (number_bits, local_bits) = (sizes.number_bits(), sizes.local_bits());
    let of = Burst::of(sizes.id_bits());
    let words: Vec<_> = (0..count)
        .map(|i| {
            let burst = bursts[i].payload;
            let id = m
                .lit(i as u32, number_bits)
                .concat(burst.id.extend(local_bits))
                .hinted(format!("id{i}"));
            let word = of.pack(Burst { id, ..burst }).hinted(format!("burst{i}"));
            (turn[i].q.repeat(word.width()) & word).hinted(format!("burst_in_turn{i}"))
        })
        .collect();
    let burst = of.unpack(m.or_all(&words).named("burst"));
    let number = beat.payload.id.high(number_bits).named("client_of_beat");
    let mut of_clients = vec![];
    for (i, port) in clients.iter().enumerate() {
        let payload = Beat {
            id: beat.payload.id.low(sizes.clients[i]),
            ..beat.payload
        };
        let mine = beat.valid & number.equals(i as u128);
        let outputs = ClientOutputs {
            read_ready: turn[i].q & read_ready,
            beat: Flow::new(mine, payload),
        };
        port.outputs.outputs(&m, outputs);
        of_clients.push(outputs);
    }
    let outputs = Outputs {
        read: Flow::new(valid, burst),
    };
    ports.outputs.outputs(&m, outputs);
    properties::rotates(
        &m,
        &turn,
        &bursts,
        &of_clients,
        outputs,
        read_ready,
        number_bits,
    );
    m.finish()
}
