//! A queue in distributed RAM. Its first word shows before it is taken.

use crate::hdl::{Builder, HdlError, Module, Signal, Style, bits_for};
use std::rc::Rc;

/// A queue of `depth` words of `width` bits: `push`, `data` → `valid`, `front`; `pop` takes the front word, and only
/// where `valid` is high. A word shows a clock after it was pushed. There is no full flag: the queue is deep enough for all that
/// can be in it, which is the caller's to see to.
pub(super) fn fifo(width: u32, depth: u32) -> Result<Rc<Module>, HdlError> {
    let m = Builder::new(
        format!("fifo_{width}x{depth}"),
        format!(
            "a queue of {depth} words of {width} bits. What feeds it never has more than {depth} words under way."
        ),
    );
    m.group("In");
    let push = m.input("push", 1);
    let data = m.input("data", width);
    m.group("Out: the front word, taken by pop");
    let pop = m.input("pop", 1);

    let bits = bits_for(u64::from(depth));
    let count_bits = bits_for(u64::from(depth) + 1);
    let head = m.reg_reset("head", bits, 0);
    let tail = m.reg_reset("tail", bits, 0);
    let count = m.reg_reset("count", count_bits, 0);
    let one = m.lit(1u8, bits);
    let next_head = head
        .q
        .equals(u128::from(depth) - 1)
        .mux(m.zero(bits), head.q + one);
    let next_tail = tail
        .q
        .equals(u128::from(depth) - 1)
        .mux(m.zero(bits), tail.q + one);
    head.next_when(pop, next_head);
    tail.next_when(push, next_tail);
    let unit = m.lit(1u8, count_bits);
    count.next_when(push ^ pop, push.mux(count.q + unit, count.q - unit));

    let words = m.memory("words", depth, width, Style::Distributed);
    words.write(push, tail.q, data);
    m.output("valid", count.q.any());
    m.output("front", words.read_now(head.q));
    m.finish()
}

/// Places a queue. Returns its valid bit and its front word.
pub(super) fn place<'b>(
    name: &str,
    depth: u32,
    push: Signal<'b>,
    data: Signal<'b>,
    pop: Signal<'b>,
) -> Result<(Signal<'b>, Signal<'b>), HdlError> {
    let module = fifo(data.width(), depth)?;
    let queue = push.module().instance(
        name,
        &module,
        &[("push", push), ("data", data), ("pop", pop)],
    );
    Ok((queue.get("valid"), queue.get("front")))
}
