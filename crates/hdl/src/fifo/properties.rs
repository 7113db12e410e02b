//! Properties of queues: words leave unchanged, in order and once each, and no queue overflows. A queue is assumed to be popped only
//! while it presents a word and pushed only with room. The proof watches one arbitrary word.

use crate::properties::{shown_stays, wrapped};
use crate::{Builder, Memory, Outputs, Proof, Reads, Reg, Signal, bits_for};

const WHAT: &str =
    "words leave in order, each once; none is lost; no overflow; the front word is stable";

/// The ports and the state of a queue.
pub(super) struct Queue<'b> {
    pub depth: u32,
    pub push: Signal<'b>,
    pub data: Signal<'b>,
    pub pop: Signal<'b>,
    pub valid: Signal<'b>,
    pub front: Signal<'b>,
    /// The address of the front word or, if the front word is in a register, of the next word.
    pub head: Reg<'b>,
    pub tail: Reg<'b>,
    pub count: Reg<'b>,
    pub words: Memory<'b>,
}

/// A word that is watched from its push to its pop.
struct Watched<'b> {
    watching: Signal<'b>,
    word: Signal<'b>,
    /// The number of words before it.
    ahead: Signal<'b>,
}

impl<'b> Queue<'b> {
    /// Width for sums of addresses and counts.
    fn bits(&self) -> u32 {
        bits_for(u64::from(self.depth)) + 2
    }

    fn wide(&self, signal: Signal<'b>) -> Signal<'b> {
        signal.extend(self.bits())
    }

    fn module(&self) -> &'b Builder {
        self.push.module()
    }

    fn depth(&self) -> Signal<'b> {
        self.module().lit(self.depth, self.bits())
    }

    /// The address at a distance from another one, modulo the depth.
    fn behind(&self, place: Signal<'b>, words: Signal<'b>) -> Signal<'b> {
        wrapped(place + words, self.depth())
    }

    /// Watches an arbitrary word. `held` is the number of words in the queue.
    fn watch(&self, proof: &Proof<'b>, held: Signal<'b>) -> Watched<'b> {
        let m = self.module();
        let (push, pop) = (self.push, self.pop);
        proof.assume(
            "it is popped only while it presents a word",
            pop.implies(self.valid),
        );
        proof.assume(
            "it is pushed only with room",
            push.implies(held.lt(self.depth())),
        );
        let choose = proof.any_seq("choose", 1);
        let watching = proof.reg_reset("watching", 1, 0);
        let word = proof.reg("word", self.data.width());
        let ahead = proof.reg("ahead", self.bits());
        let begins = !watching.q & push & choose;
        let ends = watching.q & pop & ahead.q.is_zero();
        watching.next(begins | (watching.q & !ends));
        word.next_when(begins, self.data);
        let one = m.lit(1u8, self.bits());
        ahead.next_when(
            begins | (watching.q & pop),
            begins.mux(held - self.wide(pop), ahead.q - one),
        );
        proof.cover("a watched word is popped", watching.q & pop);
        proof.assert(
            "the queue never holds more words than it has room for",
            held.le(self.depth()),
        );
        proof.assert(
            "a watched word is held until it is popped",
            watching.q.implies(ahead.q.lt(held)),
        );
        proof.assert(
            "the front word is stable until it is popped",
            shown_stays(proof, self.valid, pop, &[self.front]),
        );
        Watched {
            watching: watching.q,
            word: word.q,
            ahead: ahead.q,
        }
    }

    /// Asserts that the distance from head to tail is the number of stored words.
    fn places(&self, proof: &Proof<'b>, head: Signal<'b>) {
        let head_slot = self.wide(self.head.q);
        proof.assert("the head is a slot", head_slot.lt(self.depth()));
        let tail = self.behind(head, self.wide(self.count.q));
        proof.assert(
            "the distance from head to tail is the number of words",
            self.wide(self.tail.q).eq(tail),
        );
    }

    /// The seeded faults of both kinds of queues. `together` is high when the count changes, or when a push and a pop coincide.
    fn seed_faults(&self, proof: &Proof<'b>, together: Signal<'b>) {
        proof.fault(
            "a push and a pop at once count as a push",
            self.count.q.enable().as_signal(together),
        );
        proof.fault(
            "a word is written to a wrong slot",
            self.words.write_address().as_signal(self.head.q),
        );
    }

    fn stored(&self, place: Signal<'b>) -> Signal<'b> {
        self.words.peek(place.low(bits_for(u64::from(self.depth))))
    }
}

/// Properties of a queue in distributed RAM. `front` are the registers of the front word, if it has them: whether there is a next word, and the word.
pub(super) fn order<'b>(queue: &Queue<'b>, front: Option<(Signal<'b>, Signal<'b>)>) {
    let m = queue.module();
    let proof = m.proof("order", WHAT);
    let count = queue.wide(queue.count.q);
    let head = match front {
        None => queue.wide(queue.head.q),
        Some(_) => {
            let last = m.lit(queue.depth - 1, queue.bits());
            let before = queue.wide(queue.head.q) - m.lit(1u8, queue.bits());
            queue.head.q.is_zero().mux(last, before)
        }
    };
    let watched = queue.watch(&proof, count);
    queue.places(&proof, head);
    proof.assert(
        "it presents a word if it holds one",
        queue.valid.eq(queue.count.q.any()),
    );
    let slot = queue.behind(head, watched.ahead);
    proof.assert(
        "a watched word keeps its slot",
        (watched.watching).implies(queue.stored(slot).eq(watched.word)),
    );
    proof.assert(
        "a watched word leaves in order",
        (watched.watching & watched.ahead.is_zero())
            .implies(queue.valid & queue.front.eq(watched.word)),
    );
    queue.seed_faults(&proof, queue.push | queue.pop);
    proof.fault(
        "a reset does not clear the count",
        queue.count.q.without_reset(),
    );
    if let Some((more, front)) = front {
        let one = m.lit(1u8, queue.count.q.width());
        proof.assert(
            "the flag of a next word is correct",
            more.eq(queue.count.q.gt(one)),
        );
        proof.fault(
            "a word that is pushed while the last one is popped does not become the front word",
            front
                .reads(queue.data)
                .as_signal(queue.words.peek(queue.head.q)),
        );
    }
}

/// Properties of a queue in block RAM: its front word is in a register, and the output of the RAM is valid after the head has been stable for the read latency.
pub(super) struct Block<'b> {
    pub queue: Queue<'b>,
    pub front_valid: Signal<'b>,
    /// For each cycle of the RAM's latency: whether the head has been stable for it, and the word read.
    pub settled: Vec<(Reg<'b>, Signal<'b>)>,
    pub load: Signal<'b>,
}

pub(super) fn block_order(block: &Block<'_>) {
    let Block {
        queue, front_valid, ..
    } = block;
    let m = queue.module();
    let proof = m.proof("order", WHAT);
    let held = queue.wide(queue.count.q) + queue.wide(*front_valid);
    let watched = queue.watch(&proof, held);
    let head = queue.wide(queue.head.q);
    queue.places(&proof, head);
    let in_front = *front_valid & watched.ahead.is_zero();
    let slot = queue.behind(head, watched.ahead - queue.wide(*front_valid));
    let kept = in_front.mux(queue.front, queue.stored(slot));
    proof.assert(
        "a watched word keeps its slot",
        watched.watching.implies(kept.eq(watched.word)),
    );
    proof.assert(
        "a watched word leaves in order",
        (watched.watching & watched.ahead.is_zero() & queue.valid)
            .implies(queue.front.eq(watched.word)),
    );
    let first = queue.words.peek(queue.head.q);
    for (settled, word) in &block.settled {
        proof.assert(
            "the word read is that at the head once the head has been stable",
            (settled.q).implies(queue.count.q.any() & word.eq(first)),
        );
    }
    queue.seed_faults(&proof, queue.push | block.load);
    let (settled, _) = block.settled.last().expect("a read takes a clock");
    proof.fault(
        "a reset does not clear the flag of a stable head",
        settled.q.without_reset(),
    );
}

/// A queue that a unit instantiates, for the properties of the unit.
#[derive(Clone)]
pub struct Placed<'b> {
    /// Whether there is a front word.
    pub valid: Signal<'b>,
    /// The front word.
    pub front: Signal<'b>,
    /// The name of the instance.
    pub name: String,
    /// The maximum number of words.
    pub depth: u32,
    /// The connected inputs.
    pub push: Signal<'b>,
    /// See `push`.
    pub pop: Signal<'b>,
    pub(super) instance: Outputs<'b>,
    /// The number of flags of a stable head, for a queue in block RAM.
    pub(super) settling: Option<u32>,
    /// Whether the front word is in a register, for a queue in distributed RAM.
    pub(super) registered: bool,
}

impl<'b> Placed<'b> {
    /// Width of the number of its words.
    pub fn count_bits(&self) -> u32 {
        bits_for(u64::from(self.depth) + 1)
    }

    /// The number of words in it, in `width` bits.
    pub fn count(&self, width: u32) -> Signal<'b> {
        let count = self.instance.inside("count").extend(width);
        match self.settling {
            None => count,
            Some(_) => count + self.instance.inside("front_valid").extend(width),
        }
    }

    /// Whether it presents a word.
    pub fn shows(&self) -> Signal<'b> {
        match self.settling {
            None => self.instance.inside("count").any(),
            Some(_) => self.instance.inside("front_valid"),
        }
    }

    /// The push input, for a fault.
    pub fn push_input(&self) -> Reads<&'b Builder> {
        self.instance.input("push")
    }

    /// Keeps the queue in a proof, with its proved properties as assumptions.
    pub fn keep(&self, proof: &Proof<'b>) {
        proof.keep(&self.instance);
        if self.registered {
            let count = self.instance.inside("count");
            let one = proof.module().lit(1u8, count.width());
            proof.assume(
                "the front word of a queue is valid if it holds one",
                self.instance.inside("front_valid").eq(count.any()),
            );
            proof.assume(
                "the flag of a next word in a queue is correct",
                self.instance.inside("more").eq(count.gt(one)),
            );
        }
    }

    /// Asserts for a queue in block RAM that its head is stable only while it is the address of a word.
    pub fn assert_settles(&self, proof: &Proof<'b>) {
        let Some(settling) = self.settling else {
            return;
        };
        let settled: Vec<_> = (0..settling)
            .map(|clock| self.instance.inside(&format!("settled{clock}")))
            .collect();
        proof.assert(
            format!("the stable head of {} is the address of a word", self.name),
            proof
                .module()
                .or_all(&settled)
                .implies(self.instance.inside("count").any()),
        );
    }
}
