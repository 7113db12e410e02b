//! Queues that show their front word before it is taken: in distributed RAM for one word per cycle, in block RAM for a word every few
//! cycles.

mod properties;

use crate::interface;
use crate::{Builder, HdlError, Library, Module, Parameter, Reg, Signal, Specs, Style, bits_for};
pub use properties::Placed;
use properties::{Block, Queue};
use std::sync::Arc;

interface! {
    pub (width: u32) {
        in "Write port" {
            /// Stores a word.
            push: 1,
            /// The word.
            data: width,
        }
        in "Read port: the front word; pop removes it" {
            /// Takes the front word; only while `valid` is 1.
            pop: 1,
        }
        out "Read port: the front word; pop removes it" {
            /// Whether there is a front word.
            valid: 1,
            /// The front word.
            front: width,
        }
    }
}

/// Sample widths and depths that distinguish the parameters.
const SAMPLES: &[(u32, u32)] = &[(32, 16), (11, 5), (47, 23)];

const PARAMETERS: &[Parameter] = &[
    Parameter::number("WIDTH", "bits per word"),
    Parameter::number("DEPTH", "words"),
    Parameter::number("INDEX_BITS", "bits of an index: 2**INDEX_BITS >= DEPTH"),
    Parameter::number(
        "COUNT_BITS",
        "bits of the word count: 2**COUNT_BITS > DEPTH",
    ),
];

fn values(&(width, depth): &(u32, u32)) -> Vec<u32> {
    let depth = u64::from(depth);
    vec![width, depth as u32, bits_for(depth), bits_for(depth + 1)]
}

/// Returns a queue of `depth` words of `width` bits: `push`, `data` → `valid`, `front`; `pop` takes the front word, and only while
/// `valid` is 1. A word is the front one cycle after the push at the earliest. There is no full flag: the caller must never have more
/// than `depth` words in flight. With `registers_front` the valid bit and the front word are registers.
///
/// # Errors
/// None for a depth of at least 1.
pub fn fifo(registers_front: bool, width: u32, depth: u32) -> Result<Arc<Module>, HdlError> {
    let library = Library {
        name: "fifo",
        doc: "a queue of DEPTH words of WIDTH bits. It has no full flag: at most DEPTH words may be in flight.",
        parameters: PARAMETERS,
        values: &values,
        samples: SAMPLES,
        describe: &|&(width, depth)| describe(registers_front, width, depth),
    };
    library.module(&(width, depth))
}

/// Returns the address after another one in a memory of `depth` words; the first follows the last.
pub(crate) fn next_place(place: Signal<'_>, depth: u32) -> Signal<'_> {
    let m = place.module();
    let is_last = place.equals(u128::from(depth) - 1);
    let next = place + m.lit(1u8, place.width());
    is_last.mux(m.zero(place.width()), next)
}

/// Lets a register count arrivals minus departures.
pub(crate) fn track<'b>(count: &Reg<'b>, comes: Signal<'b>, goes: Signal<'b>) {
    let one = comes.module().lit(1u8, count.q.width());
    count.next_when(comes ^ goes, comes.mux(count.q + one, count.q - one));
}

fn describe(registered: bool, width: u32, depth: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        format!("fifo_{width}x{depth}"),
        format!(
            "a queue of {depth} words of {width} bits. It has no full flag: at most {depth} words may be in flight."
        ),
    );
    m.simplify(false);
    let ports = ports(width);
    let Inputs { push, data, pop } = ports.inputs.inputs(&m);

    let bits = bits_for(u64::from(depth));
    let count_bits = bits_for(u64::from(depth) + 1);
    // With the front word in a register, only if the next word is stored.
    let head = match registered {
        false => m.reg_reset("head", bits, 0),
        true => m.reg_reset("behind", bits, u128::from(1 % depth)),
    };
    let tail = m.reg_reset("tail", bits, 0);
    let count = m.reg_reset("count", count_bits, 0);
    head.next_when(pop, next_place(head.q, depth));
    tail.next_when(push, next_place(tail.q, depth));
    track(&count, push, pop);

    let words = m.memory("words", depth, width, Style::Distributed);
    words.write(push, tail.q, data);
    let queue = |valid, front| Queue {
        depth,
        push,
        data,
        pop,
        valid,
        front,
        head,
        tail,
        count,
        words,
    };
    if !registered {
        let (valid, front) = (count.q.any(), words.read_now(head.q));
        ports.outputs.outputs(&m, Outputs { valid, front });
        properties::order(&queue(valid, front), None);
        return m.finish();
    }
    m.comment("The front word is also in a register, which loads the next word: a stored one, or the one being pushed.");
    let front_valid = m.reg_reset("front_valid", 1, 0);
    let more = m.reg_reset("more", 1, 0);
    let front = m.reg("front_word", width);
    let no_pop = !pop;
    front_valid.next(push | more.q | (front_valid.q & no_pop));
    let three = count.q.ge(m.lit(3u8, count_bits)).named("at_least_three");
    more.next(pop.mux(push.mux(more.q, three), more.q | (push & front_valid.q)));
    front.next_when(
        pop | !front_valid.q,
        more.q.mux(words.read_now(head.q), data),
    );
    let (valid, front_word) = (front_valid.q, front.q);
    let outputs = Outputs {
        valid,
        front: front_word,
    };
    ports.outputs.outputs(&m, outputs);
    properties::order(&queue(valid, front_word), Some((more.q, front_word)));
    m.finish()
}

/// Places a queue of [`fifo`] as the instance `name` in the module of `push`.
///
/// # Errors
/// As [`fifo`].
pub fn place<'b>(
    registers_front: bool,
    name: &str,
    depth: u32,
    push: Signal<'b>,
    data: Signal<'b>,
    pop: Signal<'b>,
) -> Result<Placed<'b>, HdlError> {
    let module = fifo(registers_front, data.width(), depth)?;
    Ok(placed(
        name,
        depth,
        &module,
        Inputs { push, data, pop },
        None,
        registers_front,
    ))
}

fn placed<'b>(
    name: &str,
    depth: u32,
    module: &Arc<Module>,
    inputs: Inputs<Signal<'b>>,
    settling: Option<u32>,
    registered: bool,
) -> Placed<'b> {
    let Inputs { push, data, pop } = inputs;
    let (Outputs { valid, front }, instance) =
        ports(data.width()).instance(name, push.module(), module, inputs);
    Placed {
        valid,
        front,
        name: name.to_string(),
        depth,
        push,
        pop,
        instance,
        settling,
        registered,
    }
}

/// Returns a queue with the ports of [`fifo`], in block RAM with `read_latency` registers from address to word. A word is the front
/// `read_latency` + 2 cycles after the push, and the next one may be taken `read_latency` + 1 cycles after the one before.
///
/// # Errors
/// None for a depth of at least 1.
pub fn block_fifo(read_latency: u32, width: u32, depth: u32) -> Result<Arc<Module>, HdlError> {
    let library = Library {
        name: "block_fifo",
        doc: "a queue of DEPTH words of WIDTH bits in block RAM, for at most one word every few cycles. It has no full flag: at most DEPTH words may be in flight.",
        parameters: PARAMETERS,
        values: &values,
        samples: SAMPLES,
        describe: &|&(width, depth)| describe_block(read_latency, width, depth),
    };
    library.module(&(width, depth))
}

fn describe_block(latency: u32, width: u32, depth: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        format!("block_fifo_{width}x{depth}"),
        format!(
            "a queue of {depth} words of {width} bits in block RAM, for at most one word every few cycles. It has no full flag: at most {depth} words may be in flight."
        ),
    );
    m.simplify(false);
    let ports = ports(width);
    let Inputs { push, data, pop } = ports.inputs.inputs(&m);

    let bits = bits_for(u64::from(depth));
    let count_bits = bits_for(u64::from(depth) + 1);
    let head = m.reg_reset("head", bits, 0);
    let tail = m.reg_reset("tail", bits, 0);
    let count = m.reg_reset("count", count_bits, 0);
    let words = m.memory("words", depth, width, Style::Block);
    words.write(push, tail.q, data);
    let word = words.read(head.q).delay(latency - 1);

    m.comment("The word at the head is read in every cycle; it is valid once the head has been stable for the read latency.");
    let stored = count.q.any().named("stored");
    let load = m.wire("load", 1);
    let mut settled = stored;
    let mut stands = vec![];
    for clock in 0..latency {
        let next = m.reg_reset(format!("settled{clock}"), 1, 0);
        next.next(settled & stored & !load.get());
        settled = next.q;
        stands.push((next, words.read(head.q).delay(clock)));
    }
    let front_valid = m.reg_reset("front_valid", 1, 0);
    load.drive(settled & (!front_valid.q | pop));
    front_valid.next(load.get() | (front_valid.q & !pop));
    let front = m.reg("front_word", width);
    front.next_when(load.get(), word);
    head.next_when(load.get(), next_place(head.q, depth));
    tail.next_when(push, next_place(tail.q, depth));
    track(&count, push, load.get());
    let (valid, front) = (front_valid.q, front.q);
    ports.outputs.outputs(&m, Outputs { valid, front });
    properties::block_order(&Block {
        queue: Queue {
            depth,
            push,
            data,
            pop,
            valid,
            front,
            head,
            tail,
            count,
            words,
        },
        front_valid: valid,
        settled: stands,
        load: load.get(),
    });
    m.finish()
}

/// Places a queue of [`block_fifo`] as the instance `name` in the module of `push`.
///
/// # Errors
/// As [`block_fifo`].
pub fn place_block<'b>(
    read_latency: u32,
    name: &str,
    depth: u32,
    push: Signal<'b>,
    data: Signal<'b>,
    pop: Signal<'b>,
) -> Result<Placed<'b>, HdlError> {
    let module = block_fifo(read_latency, data.width(), depth)?;
    let settling = Some(read_latency);
    Ok(placed(
        name,
        depth,
        &module,
        Inputs { push, data, pop },
        settling,
        false,
    ))
}
