//! What is proved of words read ahead: each comes out in the order of the requests, as memory answered it. Memory answers each request
//! once, in any order. One word, any, is watched.

use super::{Inputs, Outputs};
use crate::hdl::{Memory, ReadInputs, Reg, Response, Signal};
use crate::hw::properties::{shown_stays, wrapped};

/// A reader's ports and state.
pub(super) struct Reader<'b> {
    pub depth: u32,
    pub inputs: Inputs<Signal<'b>>,
    pub outputs: Outputs<Signal<'b>>,
    pub head: Reg<'b>,
    pub tail: Reg<'b>,
    pub count: Reg<'b>,
    pub arrived: Reg<'b>,
    pub head_arrived: Signal<'b>,
    pub room: Signal<'b>,
    pub advance: Signal<'b>,
    pub front_valid: Reg<'b>,
    pub front: Reg<'b>,
    pub words: Memory<'b>,
    /// Where it has them, the registers of what the head's word comes to: that it is there, the slot behind, the slot that was freed.
    pub registered: Option<[Reg<'b>; 3]>,
    pub second_arrived: Option<Signal<'b>>,
}

pub(super) fn order<'b>(reader: &Reader<'b>) {
    let m = reader.inputs.pop.module();
    let depth = reader.depth;
    let Inputs {
        fetch_valid,
        fetch_address,
        pop,
        memory: ReadInputs {
            request_ready,
            response,
        },
    } = reader.inputs;
    let Response {
        tag: response_tag,
        data: response_data,
    } = response.payload;
    let response_valid = response.valid;
    let Outputs {
        fetch_ready,
        request,
        empty,
        ..
    } = reader.outputs;
    let [head, tail, count, arrived] =
        [reader.head, reader.tail, reader.count, reader.arrived].map(|register| register.q);
    let [front_valid, front] = [reader.front_valid.q, reader.front.q];
    let (request_valid, request_tag) = (request.valid, tail);
    let tag_bits = tail.width();
    let bits = tag_bits + 2;
    let wide = |signal: Signal<'b>| signal.extend(bits);
    let proof = m.proof(
        "order",
        "words come out in the order of requests, whatever the answers' order; requests shown stay",
    );
    let slots = m.lit(depth, bits);
    let one = m.lit(1u8, bits);
    // The slots that are taken: the count, less one that it has yet to give back.
    let taken = match &reader.registered {
        Some([.., freed]) => wide(count) - wide(freed.q),
        None => wide(count),
    };
    let requests = (request_valid & request_ready).extend(depth);
    let answers = response_valid.extend(depth);
    let owed = proof.reg_reset("owed", depth, 0);
    owed.next((owed.q | requests.shl(request_tag)) & !answers.shl(response_tag));
    let is_slot = wide(response_tag).lt(slots);
    proof.assume(
        "memory answers requests that were made, once",
        response_valid.implies(is_slot & owed.q.bit_at(response_tag)),
    );
    proof.assume(
        "a word is popped only where one is shown",
        pop.implies(front_valid),
    );
    proof.assume(
        "an address that is not taken stays",
        shown_stays(&proof, fetch_valid, fetch_ready, &[fetch_address]),
    );

    let choose = proof.any_seq("choose", 1);
    let watching = proof.reg_reset("watching", 1, 0);
    let answered = proof.reg("answered", 1);
    let word = proof.reg("word", front.width());
    let tag = proof.reg("tag", tag_bits);
    let ahead = proof.reg("ahead", bits);
    let begins = !watching.q & request_valid & request_ready & choose;
    let ends = watching.q & pop & ahead.q.is_zero();
    watching.next(begins | (watching.q & !ends));
    tag.next_when(begins, request_tag);
    let held = taken + wide(front_valid);
    ahead.next_when(
        begins | (watching.q & pop),
        begins.mux(held - wide(pop), ahead.q - one),
    );
    let answer = watching.q & response_valid & response_tag.eq(tag.q) & !answered.q;
    answered.next(!begins & (answered.q | answer));
    word.next_when(answer, response_data);
    let inside = proof.reg_reset("inside", bits, 0);
    let fetched = fetch_valid & fetch_ready;
    inside.next(inside.q + wide(fetched) - wide(pop));

    let end = wrapped(wide(head) + taken, slots);
    let in_front = ahead.q.is_zero() & front_valid;
    let behind = watching.q & !in_front;
    let at = wide(head) + ahead.q - wide(front_valid);
    let slot = wrapped(at, slots);
    let used: Vec<_> = (0..depth)
        .rev()
        .map(|i| {
            let i = m.lit(i, bits);
            let from_head = wide(head).gt(i).mux(i + slots - wide(head), i - wide(head));
            from_head.lt(taken)
        })
        .collect();

    proof.cover("a watched word is popped", watching.q & in_front & pop);
    proof.assert(
        "no more words are in flight than there are slots",
        wide(count).le(slots),
    );
    proof.assert("the head is a slot", wide(head).lt(slots));
    proof.assert(
        "the tail is as far from the head as slots are taken",
        wide(tail).eq(end),
    );
    proof.assert(
        "every slot taken is owed by memory or has its word",
        (owed.q | arrived).eq(m.concat(&used)),
    );
    proof.assert(
        "no slot is both owed and has its word",
        (owed.q & arrived).is_zero(),
    );
    let shown = [fetch_address, request_tag];
    let stays = shown_stays(&proof, request_valid, request_ready, &shown);
    proof.assert(
        "a request that is not taken stays, its address and tag too",
        stays,
    );
    proof.assert(
        "a watched word comes out in its turn",
        (watching.q & in_front).implies(answered.q & front.eq(word.q)),
    );
    proof.assert(
        "a watched word is there until it is popped",
        watching.q.implies(ahead.q.lt(held)),
    );
    proof.assert(
        "a watched word keeps its slot",
        behind.implies(slot.eq(wide(tag.q))),
    );
    proof.assert(
        "a watched word has arrived when memory answered",
        behind.implies(answered.q.eq(arrived.bit_at(tag.q))),
    );
    proof.assert(
        "a watched word is stored as memory answered",
        (behind & answered.q).implies(reader.words.peek(tag.q).eq(word.q)),
    );
    proof.assert(
        "it waits for nothing but the memory",
        front_valid | reader.head_arrived | taken.is_zero() | owed.q.bit_at(head),
    );
    proof.assert(
        "as many words are in flight as were asked for and not popped",
        inside.q.eq(held),
    );
    proof.assert(
        "it is empty where nothing is in flight",
        empty.eq(inside.q.is_zero()),
    );
    if let Some([is_there, second, freed]) = &reader.registered {
        proof.assert(
            "a slot that has just been freed is counted, and its word is the front",
            freed.q.implies(count.any() & front_valid),
        );
        proof.assert(
            "a word that is said to be there has arrived",
            is_there.q.implies(arrived.bit_at(head)),
        );
        let next = head
            .equals(u128::from(depth) - 1)
            .mux(m.zero(tag_bits), head + m.lit(1u8, tag_bits));
        proof.assert("the second slot is behind the head", second.q.eq(next));
        let second_arrived = reader.second_arrived.expect("it has a register");
        proof.fault(
            "the head's word is said to be there again when the next one's turn comes",
            (is_there.q.reads(second_arrived)).as_signal(reader.head_arrived),
        );
    }
    proof.fault(
        "a word is forgotten when another arrives",
        reader.advance.reads(pop).as_value(1),
    );
    proof.fault("it requests without room", reader.room.fault().as_value(1));
}
