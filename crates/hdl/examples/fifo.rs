//! A FIFO of any width and depth as one Verilog module with parameters, and a proof of it.

use dynrt_hdl::{Builder, Design, HdlError, Library, Module, Parameter, Style, bits_for};
use std::sync::Arc;

/// A FIFO of `depth` words, a power of two from 2 on.
pub fn fifo(width: u32, depth: u32) -> Result<Arc<Module>, HdlError> {
    let library = Library {
        name: "fifo",
        doc: "a FIFO of DEPTH words of WIDTH bits.",
        parameters: &[
            Parameter::number("WIDTH", "bits of a word"),
            Parameter::number("DEPTH", "words, a power of two"),
            Parameter::number("ADDRESS", "bits of an address: DEPTH = 2**ADDRESS"),
        ],
        values: &|&(width, depth)| vec![width, depth, bits_for(depth.into())],
        samples: &[(32, 16), (11, 64), (47, 256)],
        describe: &|&(width, depth)| describe(width, depth),
    };
    library.module(&(width, depth))
}

fn describe(width: u32, depth: u32) -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(format!("fifo_{width}x{depth}"), "a FIFO.");
    m.simplify(false); // the same text for all numbers
    m.group("In");
    let (in_valid, data) = (m.input("in_valid", 1), m.input("in_data", width));
    m.group("Out");
    let out_ready = m.input("out_ready", 1);

    // The pointers have one bit more than an address, so that full and empty differ.
    let bits = bits_for(depth.into());
    let (head, tail) = (
        m.reg_reset("head", bits + 1, 0),
        m.reg_reset("tail", bits + 1, 0),
    );
    let count = (tail.q - head.q).named("count");
    let full = count.equals(depth.into());
    let ready = (!full).named("ready");
    let valid = (!count.is_zero()).named("valid");
    let push = (in_valid & ready).named("push");
    let pop = (valid & out_ready).named("pop");
    let one = m.lit(1u8, bits + 1);
    head.next_when(pop, head.q + one);
    tail.next_when(push, tail.q + one);

    let words = m.memory("words", depth, width, Style::Distributed);
    words.write(push, tail.q.low(bits), data);
    let front = words.read_now(head.q.low(bits));
    m.output("out_valid", valid);
    m.output("out_data", front);
    m.group("In");
    m.output("in_ready", ready);

    // For an arbitrary position in the stream of words, the word pushed there is the word popped there.
    let proof = m.proof("order", "words leave in the order in which they came");
    let at = proof.any_const("at", bits + 1);
    let (present, word) = (proof.reg_reset("present", 1, 0), proof.reg("word", width));
    let (enters, leaves) = (push & tail.q.eq(at), pop & head.q.eq(at));
    present.next(enters | (present.q & !leaves));
    word.next_when(enters, data);
    let inside = (at - head.q).lt(count) & words.peek(at.low(bits)).eq(word.q);
    proof.assert(
        "never more than DEPTH words",
        count.le(m.lit(depth, bits + 1)),
    );
    proof.assert("the word is stored", present.q.implies(inside));
    proof.assert(
        "the word leaves unchanged",
        (leaves & present.q).implies(front.eq(word.q)),
    );
    proof.cover("the word leaves", leaves & present.q);
    proof.fault(
        "a word is stored in the wrong place",
        words.write_address().inverted(),
    );
    m.finish()
}

/// Two FIFOs in a row, of different sizes: the design has one module `fifo`.
pub fn two() -> Result<Arc<Module>, HdlError> {
    let m = Builder::new("two_fifos", "two FIFOs in a row.");
    let (valid, data) = (m.input("in_valid", 1), m.input("in_data", 24));
    let first_ready = m.wire("first_ready", 1);
    let inputs = [
        ("in_valid", valid),
        ("in_data", data),
        ("out_ready", first_ready.get()),
    ];
    let first = m.instance("first", &fifo(24, 8)?, &inputs);
    let sum = first.get("out_data").high(12) + first.get("out_data").low(12);
    let ready = m.input("out_ready", 1);
    let inputs = [
        ("in_valid", first.get("out_valid")),
        ("in_data", sum),
        ("out_ready", ready),
    ];
    let second = m.instance("second", &fifo(12, 32)?, &inputs);
    first_ready.drive(second.get("in_ready"));
    m.output("in_ready", first.get("in_ready"));
    m.output("out_valid", second.get("out_valid"));
    m.output("out_data", second.get("out_data"));
    m.finish()
}

pub fn verilog() -> Result<String, HdlError> {
    let files = Design::new(two()?)?.files();
    let texts: Vec<String> = files.into_iter().map(|(_, text)| text).collect();
    Ok(texts.join("\n"))
}

#[allow(dead_code)]
fn main() -> Result<(), HdlError> {
    print!("{}", verilog()?);
    Ok(())
}
