//! A prefetcher, which reads a stream from memory ahead of its use, and a counter of words in flight.

mod properties;

use crate::fifo::{next_place, track};
use crate::interface;
use crate::{
    Builder, Flow, HdlError, Library, Module, Parameter, Proof, ReadInputs, Request, Signal, Specs,
    Style, bits_for,
};
use properties::Reader;
use std::sync::Arc;

interface! {
    pub (width: u32, depth: u32, address: u32) {
        in "Addresses to read, accepted while fetch_ready is high" {
            /// Whether there is an address.
            fetch_valid: 1,
            /// The address.
            fetch_address: address,
        }
        in "" {
            /// The read port.
            memory: ..{ReadInputs}(
                "Memory", "any latency, any order", bits_for(u64::from(depth)), width
            ),
        }
        in "Words in order; pop removes the front word and may be high only while valid is high" {
            /// Takes the front word.
            pop: 1,
        }
        out "Words in order; pop removes the front word and may be high only while valid is high" {
            /// Whether the address is taken.
            fetch_ready: 1,
            /// The requests of the read port.
            request: Flow<Request>(address, bits_for(u64::from(depth))),
            /// Whether there is a front word.
            valid: 1,
            /// The front word.
            front: width,
        }
        out "High if no word is in flight or stored" {
            /// Whether no word is in flight or stored.
            empty: 1,
        }
    }
}

/// Instantiates a prefetcher. It accepts addresses while it has room for their words, requests the words through a tagged read port,
/// whose responses may come in any order, and presents the words in the order of the addresses. `name` is the name of the module,
/// `instance` that of the instance. With `registers_arrival` a register says whether the word at the head has arrived.
///
/// # Errors
/// None for a depth of at least 1.
pub fn prefetch<'b>(
    registers_arrival: bool,
    (name, instance): (&str, &str),
    depth: u32,
    inputs: Inputs<Signal<'b>>,
) -> Result<Outputs<Signal<'b>>, HdlError> {
    let (word, address) = (inputs.memory.response.payload.data, inputs.fetch_address);
    let sizes = Sizes {
        width: word.width(),
        depth,
        address: address.width(),
    };
    let module = module(registers_arrival, name, &sizes)?;
    let ports = ports(sizes.width, sizes.depth, sizes.address);
    Ok(ports.place(instance, word.module(), &module, inputs))
}

/// Width of a word, number of slots, width of an address.
struct Sizes {
    width: u32,
    depth: u32,
    address: u32,
}

const SAMPLES: &[Sizes] = &[
    Sizes {
        width: 32,
        depth: 16,
        address: 22,
    },
    Sizes {
        width: 71,
        depth: 11,
        address: 19,
    },
    Sizes {
        width: 130,
        depth: 5,
        address: 27,
    },
];

const PARAMETERS: &[Parameter] = &[
    Parameter::number("WIDTH", "bits per word"),
    Parameter::number("DEPTH", "maximum number of words in flight or stored"),
    Parameter::number("ADDRESS_BITS", "bits per address"),
    Parameter::number("TAG_BITS", "bits per tag: 2**TAG_BITS >= DEPTH"),
    Parameter::number(
        "COUNT_BITS",
        "bits of the word count: 2**COUNT_BITS > DEPTH",
    ),
];

fn module(registers_arrival: bool, name: &str, sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let library = Library {
        name: "prefetch",
        doc: "requests up to DEPTH words ahead through a tagged read port and outputs them in order.",
        parameters: PARAMETERS,
        values: &|sizes: &Sizes| {
            let depth = u64::from(sizes.depth);
            let (tag, count) = (bits_for(depth), bits_for(depth + 1));
            vec![sizes.width, sizes.depth, sizes.address, tag, count]
        },
        samples: SAMPLES,
        describe: &|sizes| describe(registers_arrival, name, sizes),
    };
    library.module(sizes)
}

fn describe(registers_arrival: bool, name: &str, sizes: &Sizes) -> Result<Arc<Module>, HdlError> {
    let depth = sizes.depth;
    let m = Builder::new(
        name,
        format!(
            "requests up to {depth} words ahead through a tagged read port and outputs them in order."
        ),
    );
    let tag = bits_for(u64::from(depth));
    let count_bits = bits_for(u64::from(depth) + 1);
    let width = sizes.width;
    m.simplify(false);
    let ports = ports(width, depth, sizes.address);
    let inputs = ports.inputs.inputs(&m);
    let Inputs {
        fetch_valid,
        fetch_address,
        memory: ReadInputs {
            request_ready,
            response,
        },
        pop,
    } = inputs;

    m.comment("A request occupies a slot, and its tag is the slot number; the slot is free again once its word is the front word.");
    let head = m.reg_reset("head", tag, 0);
    let tail = m.reg_reset("tail", tag, 0);
    let count = m.reg_reset("count", count_bits, 0);
    let arrived = m.reg_reset("arrived", depth, 0);
    let front_valid = m.reg_reset("front_valid", 1, 0);
    let registered = registers_arrival.then(|| {
        let is_there = m.reg_reset("head_is_there", 1, 0);
        let second = m.reg_reset("second", tag, 1);
        let freed = m.reg_reset("slot_freed", 1, 0);
        (is_there, second, freed)
    });
    let room = count.q.ne(m.lit(depth, count_bits)).named("room");
    let requested = (fetch_valid & request_ready & room).named("requested");
    let head_arrived = arrived.q.bit_numbered(head.q).named("head_arrived");
    let is_there = (registered.as_ref()).map_or(head_arrived, |(is_there, ..)| is_there.q);
    let advance = (is_there & (!front_valid.q | pop)).named("advance");
    // The departure from the count is one cycle late if the clock permits no other logic in the cycle of `pop`. The front word is present by then.
    let mut leaves = advance;
    let mut arrived_behind = None;
    if let Some((is_there, second, freed)) = registered {
        freed.next(advance);
        leaves = freed.q;
        // The value of the previous cycle is sufficient: the slot freed by an advance is not the next one in turn.
        let second_arrived = (arrived.q.bit_numbered(second.q)).named("second_arrived");
        arrived_behind = Some(second_arrived);
        is_there.next(advance.mux(second_arrived, head_arrived));
        head.next_when(advance, second.q);
        second.next_when(advance, next_place(second.q, depth));
    } else {
        head.next_when(advance, next_place(head.q, depth));
    }
    tail.next_when(requested, next_place(tail.q, depth));
    track(&count, requested, leaves);
    let lowest = m.lit(1u8, depth);
    let comes = lowest.shl(response.payload.tag) & response.valid.repeat(depth);
    let goes = lowest.shl(head.q) & advance.repeat(depth);
    arrived.next((arrived.q | comes) & !goes);

    let words = m.memory("words", depth, width, Style::Distributed);
    words.write(response.valid, response.payload.tag, response.payload.data);
    let front = m.reg("front_word", width);
    front.next_when(advance, words.read_now(head.q));
    front_valid.next(advance | (front_valid.q & !pop));

    let request = Request {
        address: fetch_address,
        tag: tail.q,
    };
    let outputs = Outputs {
        fetch_ready: request_ready & room,
        request: Flow::new(fetch_valid & room, request),
        valid: front_valid.q,
        front: front.q,
        empty: !(count.q.any() | front_valid.q),
    };
    ports.outputs.outputs(&m, outputs);
    properties::order(&Reader {
        depth,
        inputs,
        outputs,
        head,
        tail,
        count,
        arrived,
        head_arrived,
        room,
        advance,
        second_arrived: arrived_behind,
        front_valid,
        front,
        words,
        registered: registered.map(|(is_there, second, freed)| [is_there, second, freed]),
    });
    m.finish()
}

/// A counter of words in flight for a store with limited room.
#[derive(Clone)]
pub struct Occupancy<'b> {
    /// Whether there is room for one more.
    pub room: Signal<'b>,
    /// Whether anything is in flight.
    pub any: Signal<'b>,
    /// The number of words in flight.
    pub count: Signal<'b>,
    most: u32,
    /// Whether `room` is a register.
    registered: bool,
}

impl<'b> Occupancy<'b> {
    /// Creates a counter called `name` for at most `most` words. With `registered`, `room` is a register.
    pub fn new(
        registered: bool,
        m: &'b Builder,
        name: &str,
        most: u32,
        comes: Signal<'b>,
        goes: Signal<'b>,
    ) -> Occupancy<'b> {
        let bits = bits_for(u64::from(most) + 1);
        let count = m.reg_reset(name, bits, 0);
        track(&count, comes, goes);
        let room = match registered {
            false => count.q.ne(m.lit(most, bits)),
            true => {
                let room = m.reg_reset(format!("{name}_room"), 1, 1);
                let one_is_left = count.q.equals(u128::from(most) - 1);
                let fills = (comes & one_is_left).hinted(format!("{name}_fills"));
                let stays = (room.q & !fills).hinted(format!("{name}_room_stays"));
                room.next(goes | stays);
                room.q
            }
        };
        Occupancy {
            room,
            any: count.q.any().hinted(format!("{name}_any")),
            count: count.q,
            most,
            registered,
        }
    }

    /// Asserts the value of `room` if it is a register.
    pub fn assert_room(&self, proof: &Proof<'b>) {
        if self.registered {
            proof.assert(
                "the register says whether there is room",
                self.room.eq(!self.count.equals(u128::from(self.most))),
            );
        }
    }
}
