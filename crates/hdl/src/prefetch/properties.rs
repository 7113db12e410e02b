//! What is proved of words read ahead: each comes out in the order of the requests, as memory answered it. Memory answers each request
//! once, in any order. One word, any, is watched.

use super::{Inputs, Outputs};
use crate::properties::{shown_stays, wrapped};
use crate::{Memory, Proof, Reg, Signal};

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
    let proof = m.proof(
        "order",
        "words come out in the order of requests, whatever the answers' order; requests shown stay",
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
        "a word is popped only where one is shown",
        pop.implies(reader.front_valid.q),
    );
    proof.assume(
        "an address that is not taken stays",
        shown_stays(&proof, fetch_valid, fetch_ready, &[fetch_address]),
    );
    let shown = [fetch_address, reader.tail.q];
    let stays = shown_stays(&proof, request.valid, memory.request_ready, &shown);
    proof.assert(
        "a request that is not taken stays, its address and tag too",
        stays,
    );
    watched_word(&proof, reader);
    if let Some(registers) = &reader.registered {
        registered(&proof, reader, registers);
    }
    proof.fault(
        "a word is forgotten when another arrives",
        reader.advance.reads(pop).as_value(1),
    );
    proof.fault("it requests without room", reader.room.fault().as_value(1));
}

impl<'b> Reader<'b> {
    /// A signal in as many bits as sums of places need.
    fn wide(&self, signal: Signal<'b>) -> Signal<'b> {
        signal.extend(self.tail.q.width() + 2)
    }

    /// How many slots there are.
    fn slots(&self) -> Signal<'b> {
        let m = self.inputs.pop.module();
        m.lit(self.depth, self.tail.q.width() + 2)
    }

    /// The slots that are taken: the count, less one that it has yet to give back.
    fn taken(&self) -> Signal<'b> {
        let count = self.wide(self.count.q);
        match &self.registered {
            Some([.., freed]) => count - self.wide(freed.q),
            None => count,
        }
    }

    /// Words that were asked for and not popped.
    fn held(&self) -> Signal<'b> {
        self.taken() + self.wide(self.front_valid.q)
    }

    /// Whether the reader asks memory, and memory takes it.
    fn asks(&self) -> Signal<'b> {
        self.outputs.request.valid & self.inputs.memory.request_ready
    }
}

/// The slots whose words memory owes, a bit each; memory gives no others.
fn owed<'b>(proof: &Proof<'b>, reader: &Reader<'b>) -> Signal<'b> {
    let response = reader.inputs.memory.response;
    let (depth, tag) = (reader.depth, response.payload.tag);
    let requests = reader.asks().extend(depth);
    let answers = response.valid.extend(depth);
    let owed = proof.reg_reset("owed", depth, 0);
    owed.next((owed.q | requests.shl(reader.tail.q)) & !answers.shl(tag));
    let is_slot = reader.wide(tag).lt(reader.slots());
    proof.assume(
        "memory answers requests that were made, once",
        response.valid.implies(is_slot & owed.q.bit_at(tag)),
    );
    owed.q
}

/// Of all slots: those from the head to the tail are taken, each owed by memory or with its word.
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
        "the tail is as far from the head as slots are taken",
        wide(reader.tail.q).eq(end),
    );
    let arrived = reader.arrived.q;
    proof.assert(
        "every slot taken is owed by memory or has its word",
        (owed | arrived).eq(m.concat(&used)),
    );
    proof.assert(
        "no slot is both owed and has its word",
        (owed & arrived).is_zero(),
    );
    let head_owed = owed.bit_at(head);
    proof.assert(
        "it waits for nothing but the memory",
        reader.front_valid.q | reader.head_arrived | taken.is_zero() | head_owed,
    );
    proof.assert(
        "as many words are in flight as were asked for and not popped",
        inside.q.eq(reader.held()),
    );
    proof.assert(
        "it is empty where nothing is in flight",
        reader.outputs.empty.eq(inside.q.is_zero()),
    );
}

/// One request, any: its word, and how many are ahead of it.
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
}

/// The registers of what the head's word comes to.
fn registered<'b>(
    proof: &Proof<'b>,
    reader: &Reader<'b>,
    [is_there, second, freed]: &[Reg<'b>; 3],
) {
    let m = proof.module();
    let head = reader.head.q;
    proof.assert(
        "a slot that has just been freed is counted, and its word is the front",
        freed.q.implies(reader.count.q.any() & reader.front_valid.q),
    );
    proof.assert(
        "a word that is said to be there has arrived",
        is_there.q.implies(reader.arrived.q.bit_at(head)),
    );
    let next = head
        .equals(u128::from(reader.depth) - 1)
        .mux(m.zero(head.width()), head + m.lit(1u8, head.width()));
    proof.assert("the second slot is behind the head", second.q.eq(next));
    let second_arrived = reader.second_arrived.expect("it has a register");
    proof.fault(
        "the head's word is said to be there again when the next one's turn comes",
        (is_there.q.reads(second_arrived)).as_signal(reader.head_arrived),
    );
}
