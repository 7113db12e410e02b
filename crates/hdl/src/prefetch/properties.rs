//! Properties of prefetchers: words leave in the order of the requests, as memory returned them. Memory is assumed to respond to each
//! request once, in any order. The proof watches one arbitrary word.

use super::{Inputs, Outputs};
use crate::properties::{shown_stays, wrapped};
use crate::{Memory, Proof, Reg, Signal};

/// The ports and the state of a prefetcher.
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
    /// The registers of the head's arrival, if it has them: whether the word has arrived, the next slot, the freed slot.
    pub registered: Option<[Reg<'b>; 3]>,
    pub second_arrived: Option<Signal<'b>>,
}

pub(super) fn order<'b>(reader: &Reader<'b>) {
    let m = reader.inputs.pop.module();
    let proof = m.proof(
        "order",
        "words leave in the order of requests, for any order of responses; requests are stable",
    );
    let owed = owed(&proof, reader);
    slots(&proof, reader, owed);
    let Inputs {
        fetch_valid,
        fetch_address,
        pop,
        memory,
    } = reader.inputs;
    let Outputs {
        fetch_ready,
        request,
        ..
    } = reader.outputs;
    proof.assume(
        "a word is popped only while one is presented",
        pop.implies(reader.front_valid.q),
    );
    proof.assume(
        "an address is stable until it is accepted",
        shown_stays(&proof, fetch_valid, fetch_ready, &[fetch_address]),
    );
    let shown = [fetch_address, reader.tail.q];
    let stays = shown_stays(&proof, request.valid, memory.request_ready, &shown);
    proof.assert(
        "a request is stable until it is accepted, with address and tag",
        stays,
    );
    watched_word(&proof, reader);
    if let Some(registers) = &reader.registered {
        registered(&proof, reader, registers);
    }
    proof.fault(
        "an arrival clears the flag of another word",
        reader.advance.reads(pop).as_value(1),
    );
    proof.fault("it requests without room", reader.room.fault().as_value(1));
}

impl<'b> Reader<'b> {
    /// Extends a signal to the width of sums of addresses.
    fn wide(&self, signal: Signal<'b>) -> Signal<'b> {
        signal.extend(self.tail.q.width() + 2)
    }

    /// The number of slots.
    fn slots(&self) -> Signal<'b> {
        let m = self.inputs.pop.module();
        m.lit(self.depth, self.tail.q.width() + 2)
    }

    /// The number of occupied slots: the count, minus one that is yet to be freed.
    fn taken(&self) -> Signal<'b> {
        let count = self.wide(self.count.q);
        match &self.registered {
            Some([.., freed]) => count - self.wide(freed.q),
            None => count,
        }
    }

    /// Words that were requested and not popped.
    fn held(&self) -> Signal<'b> {
        self.taken() + self.wide(self.front_valid.q)
    }

    /// Whether a request is accepted by memory.
    fn asks(&self) -> Signal<'b> {
        self.outputs.request.valid & self.inputs.memory.request_ready
    }
}

/// The slots with an outstanding request, one bit each. Memory responds to no other tag.
fn owed<'b>(proof: &Proof<'b>, reader: &Reader<'b>) -> Signal<'b> {
    let response = reader.inputs.memory.response;
    let (depth, tag) = (reader.depth, response.payload.tag);
    let requests = reader.asks().extend(depth);
    let answers = response.valid.extend(depth);
    let owed = proof.reg_reset("owed", depth, 0);
    owed.next((owed.q | requests.shl(reader.tail.q)) & !answers.shl(tag));
    let is_slot = reader.wide(tag).lt(reader.slots());
    proof.assume(
        "memory responds once to each request",
        response.valid.implies(is_slot & owed.q.bit_at(tag)),
    );
    owed.q
}

/// Asserts that the slots from head to tail are occupied, each with an outstanding request or its word.
fn slots<'b>(proof: &Proof<'b>, reader: &Reader<'b>, owed: Signal<'b>) {
    let m = proof.module();
    let wide = |signal| reader.wide(signal);
    let (head, slots, taken) = (reader.head.q, reader.slots(), reader.taken());
    let inside = proof.reg_reset("inside", slots.width(), 0);
    let fetched = reader.inputs.fetch_valid & reader.outputs.fetch_ready;
    inside.next(inside.q + wide(fetched) - wide(reader.inputs.pop));
    let end = wrapped(wide(head) + taken, slots);
    let used: Vec<_> = (0..reader.depth)
        .rev()
        .map(|i| {
            let i = m.lit(i, slots.width());
            let from_head = wide(head).gt(i).mux(i + slots - wide(head), i - wide(head));
            from_head.lt(taken)
        })
        .collect();
    proof.assert(
        "no more words are in flight than there are slots",
        wide(reader.count.q).le(slots),
    );
    proof.assert("the head is a slot", wide(head).lt(slots));
    proof.assert(
        "the distance from head to tail is the number of occupied slots",
        wide(reader.tail.q).eq(end),
    );
    let arrived = reader.arrived.q;
    proof.assert(
        "every occupied slot has an outstanding request or its word",
        (owed | arrived).eq(m.concat(&used)),
    );
    proof.assert(
        "no slot has both an outstanding request and its word",
        (owed & arrived).is_zero(),
    );
    let head_owed = owed.bit_at(head);
    proof.assert(
        "it waits for memory only",
        reader.front_valid.q | reader.head_arrived | taken.is_zero() | head_owed,
    );
    proof.assert(
        "the number of words in flight is the number of words requested and not popped",
        inside.q.eq(reader.held()),
    );
    proof.assert(
        "it is empty if no word is in flight",
        reader.outputs.empty.eq(inside.q.is_zero()),
    );
}

/// Watches one arbitrary request: its word, and the number of words before it.
fn watched_word<'b>(proof: &Proof<'b>, reader: &Reader<'b>) {
    let m = proof.module();
    let wide = |signal| reader.wide(signal);
    let pop = reader.inputs.pop;
    let response = reader.inputs.memory.response;
    let [head, tail, arrived] = [reader.head, reader.tail, reader.arrived].map(|reg| reg.q);
    let [front_valid, front] = [reader.front_valid, reader.front].map(|reg| reg.q);
    let (slots, held) = (reader.slots(), reader.held());
    let choose = proof.any_seq("choose", 1);
    let watching = proof.reg_reset("watching", 1, 0);
    let answered = proof.reg("answered", 1);
    let word = proof.reg("word", front.width());
    let tag = proof.reg("tag", tail.width());
    let ahead = proof.reg("ahead", slots.width());
    let begins = !watching.q & reader.asks() & choose;
    let ends = watching.q & pop & ahead.q.is_zero();
    watching.next(begins | (watching.q & !ends));
    tag.next_when(begins, tail);
    ahead.next_when(
        begins | (watching.q & pop),
        begins.mux(held - wide(pop), ahead.q - m.lit(1u8, slots.width())),
    );
    let is_its = response.payload.tag.eq(tag.q);
    let answer = watching.q & response.valid & is_its & !answered.q;
    answered.next(!begins & (answered.q | answer));
    word.next_when(answer, response.payload.data);

    let in_front = ahead.q.is_zero() & front_valid;
    let behind = watching.q & !in_front;
    let slot = wrapped(wide(head) + ahead.q - wide(front_valid), slots);
    proof.cover("a watched word is popped", watching.q & in_front & pop);
    proof.assert(
        "a watched word leaves in order",
        (watching.q & in_front).implies(answered.q & front.eq(word.q)),
    );
    proof.assert(
        "a watched word is held until it is popped",
        watching.q.implies(ahead.q.lt(held)),
    );
    proof.assert(
        "a watched word keeps its slot",
        behind.implies(slot.eq(wide(tag.q))),
    );
    proof.assert(
        "a watched word has arrived after its response",
        behind.implies(answered.q.eq(arrived.bit_at(tag.q))),
    );
    proof.assert(
        "a watched word is stored as memory returned it",
        (behind & answered.q).implies(reader.words.peek(tag.q).eq(word.q)),
    );
}

/// Asserts the state of the registers of the head's arrival.
fn registered<'b>(
    proof: &Proof<'b>,
    reader: &Reader<'b>,
    [is_there, second, freed]: &[Reg<'b>; 3],
) {
    let m = proof.module();
    let head = reader.head.q;
    proof.assert(
        "a slot that has just been freed is still counted, and its word is the front word",
        freed.q.implies(reader.count.q.any() & reader.front_valid.q),
    );
    proof.assert(
        "a word marked as arrived has arrived",
        is_there.q.implies(reader.arrived.q.bit_at(head)),
    );
    let next = head
        .equals(u128::from(reader.depth) - 1)
        .mux(m.zero(head.width()), head + m.lit(1u8, head.width()));
    proof.assert("the second slot follows the head", second.q.eq(next));
    let second_arrived = reader.second_arrived.expect("it has a register");
    proof.fault(
        "the arrival flag of the head is kept for the next word",
        (is_there.q.reads(second_arrived)).as_signal(reader.head_arrived),
    );
}
