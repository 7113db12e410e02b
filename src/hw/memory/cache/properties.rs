//! Properties of the cache, in three proofs. *Lists*: every tag in use is in one place, each list is a chain in the order of arrival, and
//! unfinished work moves on or waits for memory; for any outcome of lookups. *Lines*: a line is in one way and in one miss register,
//! lookups know what is stored, and no word is read while it is written; for lists of any length.
//! *Records*: a response carries the record of its request; one arbitrary tag and record are watched. Assumptions: a tag is not in use
//! twice; lines are discarded only while no request is outstanding; memory returns the beats of each burst once, in order; the proved
//! properties of the queue of bursts.

use super::answer::Answer;
use super::decide::{Decide, Miss};
use super::fill::Fill;
use super::lookup::{Looked, Lookup, Stage, Sweep};
use super::miss::{Bursts, Lists};
use super::{Around, Outputs, Shape, join};
use crate::hdl::properties::{assert_shown_stays, shown_stays};
use crate::hdl::{Builder, Proof, Signal};

/// The cache's parts.
pub(super) struct Watched<'a, 'b> {
    pub around: Around<'a, 'b>,
    pub outputs: &'a Outputs<Signal<'b>>,
    pub sweep: &'a Sweep<'b>,
    pub lookup: &'a Lookup<'b>,
    pub decide: &'a Decide<'b>,
    pub fill: &'a Fill<'b>,
    pub bursts: &'a Bursts<'b>,
    pub lists: &'a Lists<'b>,
    pub answer: &'a Answer<'b>,
}

/// Proofs count and compare all tags: they are described for caches of few.
const FEW_TAGS: u32 = 3;

pub(super) fn describe(unit: &Watched<'_, '_>) {
    let shape = unit.around.shape;
    let is_small = shape.tag_bits <= FEW_TAGS && shape.sets <= 4 && shape.misses <= 2;
    if is_small && shape.ways > 1 && shape.beats() > 1 && shape.misses > 1 {
        lists(unit);
        lines(unit);
        records(unit);
    }
}

impl<'a, 'b> Watched<'a, 'b> {
    fn m(&self) -> &'b Builder {
        self.around.m
    }

    fn shape(&self) -> &'a Shape {
        self.around.shape
    }

    fn misses(&self) -> impl Iterator<Item = (usize, &'a Miss<'b>)> {
        self.decide.misses.iter().enumerate()
    }

    fn id(&self, k: usize) -> Signal<'b> {
        self.m().lit(k as u32, self.shape().id_bits())
    }

    fn tag(&self, k: u32) -> Signal<'b> {
        self.m().lit(k, self.shape().tag_bits)
    }

    fn tags(&self) -> impl Iterator<Item = (u32, Signal<'b>)> {
        (0..1u32 << self.shape().tag_bits).map(|k| (k, self.tag(k)))
    }

    /// Way and set of a miss register's line.
    fn home(&self, miss: &Miss<'b>) -> Signal<'b> {
        let way = miss.way.as_ref().map(|way| way.q);
        join(&[way, Some(miss.set.q)]).expect("a set has bits")
    }

    /// Way and set of a place in the data memory.
    fn home_of(&self, place: Signal<'b>) -> Signal<'b> {
        place.high(self.shape().way_bits() + self.shape().set_bits())
    }

    /// Whether a way holds a line, by the tag memory.
    fn holds(&self, way: usize, request: &Looked<Signal<'b>>) -> Signal<'b> {
        let word = self.lookup.tags[way].peek(request.set(self.shape()));
        word.msb()
            & word
                .low(self.shape().key_bits())
                .eq(request.key(self.shape()))
    }
}

/// What is at memory, and what is assumed of memory and of the queue of bursts.
struct Memory<'b> {
    /// By miss register: its burst is in the queue; is accepted and not all its beats have come.
    queued: Vec<Signal<'b>>,
    at_memory: Vec<Signal<'b>>,
}

impl<'b> Memory<'b> {
    fn new(unit: &Watched<'_, 'b>, proof: &Proof<'b>) -> Memory<'b> {
        let inputs = unit.around.inputs;
        let (queue, beat) = (&unit.bursts.queue, inputs.beat);
        let accepted = proof.named("accepted", queue.valid & inputs.burst_ready);
        let mut memory = Memory {
            queued: vec![],
            at_memory: vec![],
        };
        for (k, _) in unit.misses() {
            let its = |id: Signal<'b>| id.eq(unit.id(k));
            let queued = proof.reg_reset(&format!("queued{k}"), 1, 0);
            let pushed = queue.push & its(unit.decide.free);
            queued.next(pushed | (queued.q & !(accepted & its(queue.front))));
            let at_memory = proof.reg_reset(&format!("at_memory{k}"), 1, 0);
            let ends = beat.valid & beat.payload.last & its(beat.payload.id);
            let begins = accepted & its(queue.front);
            at_memory.next(begins | (at_memory.q & !ends));
            memory.queued.push(queued.q);
            memory.at_memory.push(at_memory.q);
        }
        let m = unit.m();
        let of = |id: Signal<'b>, of: &[Signal<'b>]| m.select(id, of);
        proof.assume(
            "memory returns beats of accepted bursts",
            beat.valid.implies(of(beat.payload.id, &memory.at_memory)),
        );
        let positions = unit.fill.positions.as_ref().expect("several beats");
        let positions: Vec<_> = positions.iter().map(|position| position.q.all()).collect();
        proof.assume(
            "the last beat of a burst is marked",
            beat.valid
                .implies(beat.payload.last.eq(of(beat.payload.id, &positions))),
        );
        proof.assume(
            "the queue shows a word if it holds one",
            queue.valid.eq(m.or_all(&memory.queued)),
        );
        proof.assume(
            "the queue shows a word that was pushed and not popped",
            queue.valid.implies(of(queue.front, &memory.queued)),
        );
        proof.assume(
            "the front of the queue is stable until it is popped",
            shown_stays(proof, queue.valid, queue.pop, &[queue.front]),
        );
        proof.assert(
            "the queue is popped only while it shows a word",
            queue.pop.implies(queue.valid),
        );
        proof.assert(
            "the queue has room for a push",
            queue.push.implies(!m.and_all(&memory.queued)),
        );
        memory
    }

    /// A miss register in use is in one state.
    fn states(&self, unit: &Watched<'_, 'b>, proof: &Proof<'b>) {
        let (m, lists) = (unit.m(), unit.lists);
        let positions = unit.fill.positions.as_ref().expect("several beats");
        for (k, miss) in unit.misses() {
            let answered = lists.draining & lists.id.eq(unit.id(k));
            let states = [
                self.queued[k],
                self.at_memory[k],
                lists.complete[k].q,
                answered,
            ];
            proof.assert(
                format!("the line of miss register {k} is queued, at memory, complete or answered"),
                m.concat(&states).count_ones(3).eq(miss.busy.q.extend(3)),
            );
            proof.assert(
                format!("no beat of miss register {k} has come before its burst is accepted"),
                self.at_memory[k] | positions[k].q.is_zero(),
            );
        }
    }

    /// Whether the line of a miss register is requested and not being answered.
    fn expected(&self, k: usize, unit: &Watched<'_, 'b>) -> Signal<'b> {
        self.queued[k] | self.at_memory[k] | unit.lists.complete[k].q
    }
}

/// The tags in use, and the waiting ones with their ranks: the place in the order of arrival at their miss register.
struct Tags<'b> {
    in_use: Vec<Signal<'b>>,
    waiting: Vec<Signal<'b>>,
    owner: Vec<Signal<'b>>,
    rank: Vec<Signal<'b>>,
    /// By miss register: the rank of the first request of its list, and the one behind the last.
    first: Vec<Signal<'b>>,
    end: Vec<Signal<'b>>,
}

impl<'b> Tags<'b> {
    fn new(unit: &Watched<'_, 'b>, proof: &Proof<'b>) -> Tags<'b> {
        let (m, inputs, outputs) = (unit.m(), unit.around.inputs, unit.outputs);
        let (decide, lists) = (unit.decide, unit.lists);
        let bits = unit.shape().tag_bits + 1;
        let one = m.lit(1u8, bits);
        let lists_it = decide.allocates | decide.appends;
        let to = decide.allocates.mux(decide.free, decide.listed);
        let counter = |name: String, steps: Signal<'b>| {
            let register = proof.reg_reset(&name, bits, 0);
            register.next(register.q + steps.extend(bits));
            register.q
        };
        let (mut first, mut end) = (vec![], vec![]);
        for (k, _) in unit.misses() {
            let answers = lists.draining & lists.id.eq(unit.id(k));
            first.push(counter(format!("first{k}"), answers));
            end.push(counter(format!("end{k}"), lists_it & to.eq(unit.id(k))));
        }
        let mut tags = Tags {
            in_use: vec![],
            waiting: vec![],
            owner: vec![],
            rank: vec![],
            first,
            end,
        };
        let accepted = inputs.request.valid & outputs.request_ready;
        for (k, tag) in unit.tags() {
            let register = |name: &str| proof.reg_reset(&format!("{name}{k}"), 1, 0);
            let in_use = register("in_use");
            let comes = accepted & inputs.request.payload.tag.eq(tag);
            let goes = outputs.response.valid & outputs.response.payload.tag.eq(tag);
            in_use.next(comes | (in_use.q & !goes));
            let waiting = register("waiting");
            let listed = lists_it & decide.tag.eq(tag);
            waiting.next(listed | (waiting.q & !(lists.draining & lists.tag.eq(tag))));
            let owner = proof.reg(&format!("owner{k}"), unit.shape().id_bits());
            owner.next_when(listed, to);
            let rank = proof.reg(&format!("rank{k}"), bits);
            rank.next_when(listed, m.select(to, &tags.end));
            tags.in_use.push(in_use.q);
            tags.waiting.push(waiting.q);
            tags.owner.push(owner.q);
            tags.rank.push(rank.q);
        }
        proof.assume(
            "no request has a tag in use",
            inputs
                .request
                .valid
                .implies(!m.select(inputs.request.payload.tag, &tags.in_use)),
        );
        proof.assume(
            "lines are discarded only while no request is outstanding",
            inputs.invalidate.implies(!m.or_all(&tags.in_use)),
        );
        tags.places(unit, proof);
        tags.counts(unit, proof, one);
        tags
    }

    /// A tag in use is in one place: a stage of the lookup, a list, or on the way to its response.
    fn places(&self, unit: &Watched<'_, 'b>, proof: &Proof<'b>) {
        let (m, response) = (unit.m(), unit.outputs.response);
        let stages = unit.lookup.stages.iter();
        let stages = stages.map(|stage: &Stage<'b>| (stage.valid, stage.request.tag));
        let decided = [(unit.lookup.valid, unit.lookup.request.tag)];
        let answers = unit
            .answer
            .on_the_way
            .iter()
            .copied()
            .zip(unit.answer.tags.iter().copied());
        let places: Vec<_> = stages.chain(decided).chain(answers).collect();
        for (k, tag) in unit.tags() {
            let here = places.iter().map(|(valid, at)| *valid & at.eq(tag));
            let here: Vec<_> = here.chain([self.waiting[k as usize]]).collect();
            let count = m.concat(&here).count_ones(4);
            proof.assert(
                format!("tag {k} is in one place if it is in use, else in none"),
                count.eq(self.in_use[k as usize].extend(4)),
            );
        }
        proof.assert(
            "a response is that of a request",
            response
                .valid
                .implies(m.select(response.payload.tag, &self.in_use)),
        );
        proof.assert(
            "idle means that no tag is in use",
            unit.outputs.idle.eq(!m.or_all(&self.in_use)),
        );
    }

    /// The ranks of a list are consecutive, and as many as its requests.
    fn counts(&self, unit: &Watched<'_, 'b>, proof: &Proof<'b>, one: Signal<'b>) {
        let (m, bits) = (unit.m(), one.width());
        let misses: Vec<_> = unit
            .misses()
            .map(|(k, _)| self.end[k] - self.first[k])
            .collect();
        let (decide, lists) = (unit.decide, unit.lists);
        let listing = decide.allocates | decide.appends;
        let to = decide.allocates.mux(decide.free, decide.listed);
        for (k, miss) in unit.misses() {
            // Partial sums in registers make it easy for the solver that the last one is the number of requests.
            let comes = listing & to.eq(unit.id(k));
            let goes = lists.draining & lists.id.eq(unit.id(k));
            let mut before = m.zero(bits);
            for (t, tag) in unit.tags() {
                let sum = proof.reg_reset(&format!("sum{k}_{t}"), bits, 0);
                let of = |at: Signal<'b>, moves: Signal<'b>| (moves & at.le(tag)).extend(bits);
                sum.next(sum.q + of(decide.tag, comes) - of(lists.tag, goes));
                let t = t as usize;
                let its = self.waiting[t] & self.owner[t].eq(unit.id(k));
                proof.assert(
                    format!("requests up to tag {t} in the list of miss register {k} are counted"),
                    sum.q.eq(before + its.extend(bits)),
                );
                before = sum.q;
            }
            proof.assert(
                format!("the list of miss register {k} has as many requests as ranks"),
                before.eq(misses[k]),
            );
            proof.assert(
                format!("miss register {k} is in use while its list is not empty"),
                miss.busy.q.eq(misses[k].any()),
            );
        }
        for t in 0..self.waiting.len() {
            let (owner, waiting) = (self.owner[t], self.waiting[t]);
            let first = m.select(owner, &self.first);
            proof.assert(
                format!("the rank of tag {t} is one of its list"),
                waiting.implies((self.rank[t] - first).lt(m.select(owner, &misses))),
            );
            for u in 0..t {
                let both = waiting & self.waiting[u] & owner.eq(self.owner[u]);
                proof.assert(
                    format!("tags {u} and {t} have different ranks in a list"),
                    both.implies(self.rank[t].ne(self.rank[u])),
                );
            }
        }
    }

    /// Whether a tag waits in the list of a miss register, with a rank.
    fn is_listed(
        &self,
        unit: &Watched<'_, 'b>,
        tag: Signal<'b>,
        owner: Signal<'b>,
        rank: Signal<'b>,
    ) -> Signal<'b> {
        let m = unit.m();
        let of = |of: &[Signal<'b>]| m.select(tag, of);
        of(&self.waiting) & of(&self.owner).eq(owner) & of(&self.rank).eq(rank)
    }

    /// A list is a chain from its first request to its last, in the order of their ranks.
    fn chains(&self, unit: &Watched<'_, 'b>, proof: &Proof<'b>) {
        let (m, lists) = (unit.m(), unit.lists);
        let one = m.lit(1u8, self.end[0].width());
        for (k, miss) in unit.misses() {
            let (id, busy) = (unit.id(k), miss.busy.q);
            let answered = lists.draining & lists.id.eq(id);
            let head = answered.mux(lists.tag, lists.heads.peek(id));
            proof.assert(
                format!("miss register {k} knows the first request of its list"),
                busy.implies(self.is_listed(unit, head, id, self.first[k])),
            );
            let tail = lists.tails.peek(id);
            proof.assert(
                format!("miss register {k} knows the last request of its list"),
                busy.implies(self.is_listed(unit, tail, id, self.end[k] - one)),
            );
        }
        for (k, tag) in unit.tags() {
            let t = k as usize;
            let next = lists.nexts.peek(tag);
            let after = self.rank[t] + one;
            let is_last = after.eq(m.select(self.owner[t], &self.end));
            proof.assert(
                format!("behind tag {k} in its list is the request that came next"),
                (self.waiting[t] & !is_last).implies(self.is_listed(
                    unit,
                    next,
                    self.owner[t],
                    after,
                )),
            );
        }
    }
}

/// Tags and lists, for any outcome of lookups.
fn lists<'b>(unit: &Watched<'_, 'b>) {
    let (m, shape, decide, lists) = (unit.m(), unit.shape(), unit.decide, unit.lists);
    let proof = &m.proof(
        "lists",
        format!(
            "every tag is in one place; lists are answered in order; no deadlock; {} misses, {} tags",
            shape.misses,
            1 << shape.tag_bits
        ),
    );
    let lookup = unit.lookup;
    lookup
        .found
        .iter()
        .chain(&lookup.in_set)
        .for_each(|cut| proof.cut(*cut));
    let tags = Tags::new(unit, proof);
    let memory = Memory::new(unit, proof);
    tags.chains(unit, proof);
    memory.states(unit, proof);
    progress(unit, proof, &tags, &memory);
    let appended = proof.reg_reset("appended", 1, 0);
    appended.next(appended.q | decide.appends);
    proof.cover(
        "the last answer of a list of two leaves",
        appended.q & lists.draining & lists.is_last,
    );
    proof.fault(
        "a request is decided during answers",
        decide.goes.reads(lists.draining).as_value(0),
    );
    proof.fault(
        "a list is linked from its new request",
        lists.nexts.write_address().as_signal(decide.tag),
    );
    proof.fault(
        "a list ends with its first answer",
        lists.is_last.fault().as_value(1),
    );
    proof.fault(
        "answers begin before a line is complete",
        lists.begins.fault().as_value(1),
    );
    proof.fault(
        "a reset does not end answers",
        lists.draining.without_reset(),
    );
    proof.fault(
        "a request for a line in flight counts as a hit too",
        decide.hit.reads(decide.pending).as_value(0),
    );
    proof.fault(
        "a request is accepted while lines are discarded",
        lookup.ready.reads(unit.sweep.blocks).as_value(0),
    );
    proof.fault(
        "a request moves on although it waits",
        decide.advance.fault().as_value(1),
    );
}

/// Lines, their entries in the tag memory, and lookups, for lists of any length.
fn lines<'b>(unit: &Watched<'_, 'b>) {
    let (m, shape, decide, lookup) = (unit.m(), unit.shape(), unit.decide, unit.lookup);
    let proof = &m.proof(
        "lines",
        format!(
            "no line is requested twice; no way in flight is replaced; lookups know what is stored; stable bursts; {} sets of {} ways, {} misses",
            shape.sets, shape.ways, shape.misses
        ),
    );
    proof.cut(unit.lists.is_last);
    let memory = Memory::new(unit, proof);
    proof.assume(
        "lines are discarded only while no request is outstanding",
        unit.around.inputs.invalidate.implies(unit.outputs.idle),
    );
    memory.states(unit, proof);
    homes(unit, proof);
    stored_tags(unit, proof);
    lookups(unit, proof);
    memories(unit, proof, &memory);
    let replaced = unit.holds(0, &lookup.request) | unit.holds(1, &lookup.request);
    let refused = proof.past(!m.reset() & decide.valid & !decide.goes);
    proof.cover(
        "a request that waited is a hit",
        refused & decide.hit & replaced,
    );
    proof.fault(
        "a way in flight is replaced",
        decide.victims[0].reads(decide.in_flight[0]).as_value(0),
    );
    proof.fault(
        "a lookup does not see the request of its line before it",
        lookup.stages[1].noted[0].replaced.fault().as_value(0),
    );
    proof.fault(
        "while a decision waits the tags of another set are read",
        lookup.read_set.reads(decide.advance).as_value(1),
    );
    proof.fault(
        "a request for a line in flight counts as a hit",
        decide.pending.fault().as_value(0),
    );
    proof.fault(
        "a request is looked up while lines are discarded",
        lookup.taken.reads(unit.sweep.blocks).as_value(0),
    );
    proof.fault(
        "a beat is written to another place",
        unit.fill
            .place
            .fault()
            .with_flipped(1 << (shape.place_bits() - 1)),
    );
    proof.fault(
        "answers read the line of another miss register",
        unit.lists.home.enable().as_value(0),
    );
}

/// All that is stored of a line in flight agrees.
fn homes<'b>(unit: &Watched<'_, 'b>, proof: &Proof<'b>) {
    let (m, shape, lists) = (unit.m(), unit.shape(), unit.lists);
    for (k, miss) in unit.misses() {
        let (id, busy) = (unit.id(k), miss.busy.q);
        let answered = lists.draining & lists.id.eq(id);
        let (home, line) = (unit.home(miss), unit.bursts.lines.peek(id));
        let filled = unit.fill.lines.peek(id);
        proof.assert(
            format!("all that is stored of the line of miss register {k} agrees"),
            busy.implies(
                lists.homes.peek(id).eq(home)
                    & line.low(shape.set_bits()).eq(miss.set.q)
                    & filled.low(shape.line_bits()).eq(line)
                    & filled
                        .high(shape.way_bits())
                        .eq(home.high(shape.way_bits())),
            ),
        );
        proof.assert(
            format!("answers read the line of miss register {k}"),
            answered.implies(lists.home.eq(home)),
        );
        let stored: Vec<_> = unit
            .lookup
            .tags
            .iter()
            .map(|tags| tags.peek(miss.set.q))
            .collect();
        let word = m.select(miss.way.as_ref().expect("two ways").q, &stored);
        let key = line.high(shape.key_bits());
        proof.assert(
            format!("the line of miss register {k} has an entry in the tag memory"),
            busy.implies(word.msb() & word.low(shape.key_bits()).eq(key)),
        );
        for (other, before) in unit.misses().take(k) {
            let both = busy & before.busy.q;
            proof.assert(
                format!("miss registers {other} and {k} have different ways"),
                both.implies(home.ne(unit.home(before))),
            );
            proof.assert(
                "no line is requested twice at once",
                both.implies(line.ne(unit.bursts.lines.peek(unit.id(other)))),
            );
        }
        let decide = unit.decide;
        let victim = join(&[decide.victim, Some(decide.line.low(shape.set_bits()))]);
        proof.assert(
            format!("the way of miss register {k} is not replaced"),
            (decide.allocates & busy).implies(home.ne(victim.expect("a set"))),
        );
    }
    let burst = unit.outputs.burst;
    assert_shown_stays(
        proof,
        "burst",
        burst.valid,
        unit.around.inputs.burst_ready,
        &[burst.payload.address, burst.payload.id],
    );
}

/// No line has entries in two ways; while lines are discarded nothing else goes on.
fn stored_tags<'b>(unit: &Watched<'_, 'b>, proof: &Proof<'b>) {
    let (m, shape, sweep) = (unit.m(), unit.shape(), unit.sweep);
    let sweeping = sweep.sweeping.q;
    proof.assert(
        "no request is outstanding while lines are discarded",
        sweeping.implies(unit.outputs.idle),
    );
    for set in 0..shape.sets {
        let set = m.lit(set, shape.set_bits());
        let words: Vec<_> = unit.lookup.tags.iter().map(|tags| tags.peek(set)).collect();
        let valid: Vec<_> = words.iter().map(|word| word.msb()).collect();
        proof.assert(
            "a set that is swept has no lines",
            (sweeping & set.lt(sweep.set.q)).implies(!m.or_all(&valid)),
        );
        for (way, word) in words.iter().enumerate() {
            for before in &words[..way] {
                proof.assert(
                    "no line is in two ways",
                    (!sweeping & word.msb()).implies(word.ne(*before)),
                );
            }
        }
    }
    proof.assert(
        "the sweep begins with set 0",
        sweeping | sweep.set.q.is_zero(),
    );
}

/// A stage of the lookup knows of its set what the tag memory holds now.
fn lookups<'b>(unit: &Watched<'_, 'b>, proof: &Proof<'b>) {
    let (m, lookup) = (unit.m(), unit.lookup);
    let shape = unit.shape();
    for (k, stage) in lookup.stages.iter().enumerate() {
        for (way, (noted, word)) in stage.noted.iter().zip(&stage.words).enumerate() {
            let key = stage.request.key(shape);
            let read = word.msb() & word.low(shape.key_bits()).eq(key);
            let known = noted.replaced.mux(noted.by_own, read);
            proof.assert(
                format!("stage {k} of the lookup knows way {way}"),
                stage
                    .valid
                    .implies(known.eq(unit.holds(way, &stage.request))),
            );
        }
    }
    for (way, found) in lookup.found.iter().enumerate() {
        let holds = unit.holds(way, &lookup.request);
        proof.assert(
            format!("the decision knows way {way}"),
            lookup.valid.implies(found.eq(holds)),
        );
    }
    for ((k, miss), in_set) in unit.misses().zip(&lookup.in_set) {
        let same = miss.set.q.eq(lookup.request.set(shape));
        proof.assert(
            format!("the decision knows the set of miss register {k}"),
            (lookup.valid & miss.busy.q).implies(in_set.eq(same)),
        );
    }
    // The word that is read while it is written is undefined in hardware.
    let first = &lookup.stages[1];
    for (way, noted) in first.noted.iter().enumerate() {
        let write = unit.decide.allocates & unit.decide.victims[way];
        let collides = write & lookup.read_set.eq(lookup.write_set);
        let collided = proof.past(!m.reset() & collides);
        proof.assert(
            "a tag that is read while it is written is not used",
            (collided & first.valid).implies(noted.replaced),
        );
    }
}

/// The data memory is read only where it is not written.
fn memories<'b>(unit: &Watched<'_, 'b>, proof: &Proof<'b>, memory: &Memory<'b>) {
    let (m, fill, answer) = (unit.m(), unit.fill, unit.answer);
    let beat = unit.around.inputs.beat;
    let fills = proof.reg_reset("fills", 1, 0);
    fills.next(beat.valid);
    // The hardware's flag is not cleared by a reset, because no line is there then.
    let was_reset = proof.past(m.reset());
    proof.assert(
        "lines are discarded after a reset",
        was_reset.implies(unit.sweep.sweeping.q),
    );
    proof.assert(
        "what is written is a beat",
        was_reset | fill.valid.eq(fills.q),
    );
    let id = proof.past(beat.payload.id);
    let reads = answer.on_the_way[0];
    let read = unit.home_of(answer.place.register());
    let mut of_line = vec![];
    for (k, miss) in unit.misses() {
        let home = unit.home(miss);
        proof.assert(
            format!("the line of miss register {k} is not read before it is complete"),
            (reads & memory.expected(k, unit)).implies(read.ne(home)),
        );
        let received = memory.at_memory[k] | unit.lists.complete[k].q;
        of_line.push(received & unit.home_of(fill.place).eq(home));
    }
    proof.assert(
        "a beat is written to its line",
        fills.q.implies(m.select(id, &of_line)),
    );
    proof.assert(
        "no record is read while it is written",
        (fills.q & reads).implies(fill.place.ne(answer.place.register())),
    );
}

/// Unfinished work progresses or waits for memory.
fn progress<'b>(unit: &Watched<'_, 'b>, proof: &Proof<'b>, tags: &Tags<'b>, memory: &Memory<'b>) {
    let (m, decide, lists) = (unit.m(), unit.decide, unit.lists);
    let moves = m.or_all(&[
        decide.goes,
        lists.draining,
        lists.begins,
        m.or_all(&unit.answer.on_the_way),
        decide.advance & unit.lookup.any,
    ]);
    let waits = m.or_all(&[memory.queued.as_slice(), memory.at_memory.as_slice()].concat());
    proof.assert(
        "requests progress or wait for memory",
        m.or_all(&tags.in_use).implies(moves | waits),
    );
    proof.assert(
        "a burst that is queued is offered",
        m.or_all(&memory.queued).implies(unit.outputs.burst.valid),
    );
}

/// One arbitrary tag, and one arbitrary record with its value in memory.
struct WatchedRecord<'b> {
    tag: Signal<'b>,
    line: Signal<'b>,
    offset: Signal<'b>,
    value: Signal<'b>,
    /// The tag is in use for this record.
    wanted: Signal<'b>,
    /// It waits in the list of this miss register.
    waiting: Signal<'b>,
    owner: Signal<'b>,
}

/// A response carries the record of its request, from base and index to the value that memory returned.
fn records<'b>(unit: &Watched<'_, 'b>) {
    let (m, lists, lookup) = (unit.m(), unit.lists, unit.lookup);
    let proof = &m.proof(
        "records",
        format!(
            "a response carries the record of its request; {} bytes",
            unit.shape().bytes()
        ),
    );
    proof.cut(lists.is_last);
    proof.cut(lists.tag);
    let memory = Memory::new(unit, proof);
    proof.assume(
        "lines are discarded only while no request is outstanding",
        unit.around.inputs.invalidate.implies(unit.outputs.idle),
    );
    memory.states(unit, proof);
    homes(unit, proof);
    stored_tags(unit, proof);
    lookups(unit, proof);
    memories(unit, proof, &memory);
    let record = watch(unit, proof);
    fetched(unit, proof, &record, &memory);
    carried(unit, proof, &record);
    let response = unit.outputs.response;
    let answered = proof.reg_reset("answered", 1, 0);
    answered.next(answered.q | (lists.draining & lists.tag.eq(record.tag) & record.wanted));
    let responds = response.valid & response.payload.tag.eq(record.tag) & record.wanted;
    proof.cover(
        "a request that waited for its line gets its record",
        answered.q & responds,
    );
    proof.fault(
        "a beat is written to another place",
        unit.fill.place.fault().with_flipped(1),
    );
    proof.fault(
        "the place of a record is stored for another tag",
        lists
            .offsets
            .expect("several records")
            .write_enable()
            .as_value(0),
    );
    proof.fault(
        "an answer reads the line of a request",
        unit.answer.place.reads(lists.draining).as_value(0),
    );
    proof.fault(
        "a request looks up another line",
        lookup.request.line.fault().with_flipped(1),
    );
}

/// Watches a tag and a record. That a tag is in use while it is in the cache, and that an answer is of a waiting request of its line,
/// is proved with the lists.
fn watch<'b>(unit: &Watched<'_, 'b>, proof: &Proof<'b>) -> WatchedRecord<'b> {
    let (m, shape, inputs, decide) = (unit.m(), unit.shape(), unit.around.inputs, unit.decide);
    let lists = unit.lists;
    let tag = proof.any_const("tag", shape.tag_bits);
    let line = proof.any_const("line", shape.line_bits());
    let offset = proof.any_const("offset", shape.offset_bits());
    let value = proof.any_const("value", shape.record_bits);
    let base = inputs.base.low(shape.address_bits);
    let step = shape.line_bytes.min(super::BASE_BYTES).ilog2();
    proof.assume("the base is a multiple", base.low(step).is_zero());
    let (request, response) = (inputs.request, unit.outputs.response);
    let index = request.payload.address.extend(shape.address_bits);
    let shift = m.lit(shape.record_bytes.ilog2(), 4);
    let address = base + index.shl(shift);
    let within = m.zero(shape.record_bytes.ilog2().max(1));
    let watched = match shape.record_bytes {
        1 => line.concat(offset),
        _ => m.concat(&[line, offset, within]),
    };
    let comes = request.valid & unit.outputs.request_ready & request.payload.tag.eq(tag);
    let goes = response.valid & response.payload.tag.eq(tag);
    let in_use = proof.reg_reset("in_use", 1, 0);
    in_use.next(comes | (in_use.q & !goes));
    let wanted = proof.reg_reset("wanted", 1, 0);
    wanted.next(comes.mux(address.eq(watched), wanted.q & !goes));
    let waiting = proof.reg_reset("waiting", 1, 0);
    let owner = proof.reg("owner", shape.id_bits());
    let to = decide.allocates.mux(decide.free, decide.listed);
    let listed = (decide.allocates | decide.appends) & decide.tag.eq(tag);
    let answered = lists.draining & lists.tag.eq(tag);
    waiting.next(listed | (waiting.q & !answered));
    owner.next_when(listed, to);
    proof.assume(
        "no request has a tag in use",
        (request.valid & request.payload.tag.eq(tag)).implies(!in_use.q),
    );
    let stages = unit
        .lookup
        .stages
        .iter()
        .map(|stage| (stage.valid, stage.request.tag));
    let decided = (unit.lookup.valid, unit.lookup.request.tag);
    let answers = unit
        .answer
        .on_the_way
        .iter()
        .copied()
        .zip(unit.answer.tags.iter().copied());
    let here = stages.chain([decided]).chain(answers);
    let here: Vec<_> = here
        .map(|(valid, at)| (valid & at.eq(tag)).extend(4))
        .collect();
    let places = here
        .into_iter()
        .reduce(|sum, bit| sum + bit)
        .expect("stages");
    proof.assume(
        "a tag in use is in one place",
        (places + waiting.q.extend(4)).eq(in_use.q.extend(4)),
    );
    proof.assume(
        "an answer is of a waiting request of its line",
        answered.implies(waiting.q & owner.q.eq(lists.id)),
    );
    proof.assume(
        "a request waits for a line in flight",
        waiting.q.implies(m.select(owner.q, &busy_of(unit))),
    );
    WatchedRecord {
        tag,
        line,
        offset,
        value,
        wanted: wanted.q,
        waiting: waiting.q,
        owner: owner.q,
    }
}

fn busy_of<'b>(unit: &Watched<'_, 'b>) -> Vec<Signal<'b>> {
    unit.misses().map(|(_, miss)| miss.busy.q).collect()
}

/// What memory returns of the watched record is stored, from its beat on, while its line is there.
fn fetched<'b>(
    unit: &Watched<'_, 'b>,
    proof: &Proof<'b>,
    record: &WatchedRecord<'b>,
    memory: &Memory<'b>,
) {
    let (m, shape, fill) = (unit.m(), unit.shape(), unit.fill);
    let beat = unit.around.inputs.beat;
    let positions = fill.positions.as_ref().expect("several beats");
    let lines: Vec<_> = unit
        .misses()
        .map(|(k, _)| unit.bursts.lines.peek(unit.id(k)))
        .collect();
    let of_beat = |of: Vec<Signal<'b>>| m.select(beat.payload.id, &of);
    let is_beat = of_beat(lines.iter().map(|line| line.eq(record.line)).collect())
        & of_beat(
            positions
                .iter()
                .map(|position| position.q.eq(record.offset))
                .collect(),
        );
    proof.assume(
        "memory returns the value of the record",
        (beat.valid & is_beat).implies(beat.payload.data.low(shape.record_bits).eq(record.value)),
    );
    let set = record.line.low(shape.set_bits());
    let [bank] = unit.answer.banks[..] else {
        unreachable!("a record is a beat");
    };
    for (way, tags) in unit.lookup.tags.iter().enumerate() {
        let stored = tags.peek(set);
        let key = record.line.high(shape.key_bits());
        let holds = stored.msb() & stored.low(shape.key_bits()).eq(key);
        let way = m.lit(way as u32, shape.way_bits());
        let missing = unit.misses().map(|(k, miss)| {
            let passed = record.offset.lt(positions[k].q) & memory.at_memory[k];
            let home = unit.home(miss).eq(way.concat(set));
            let is_there = passed | !(memory.queued[k] | memory.at_memory[k]);
            miss.busy.q & home & !is_there
        });
        let missing = m.or_all(&missing.collect::<Vec<_>>());
        let place = m.concat(&[way, set, record.offset]);
        let comes = fill.valid & fill.place.eq(place);
        let word = comes.mux(fill.data.low(shape.record_bits), bank.peek(place));
        proof.assert(
            "the record is stored where its line is",
            (!unit.sweep.sweeping.q & holds & !missing).implies(word.eq(record.value)),
        );
    }
}

/// The watched tag has the line and the place of its record wherever it is, then the record itself.
fn carried<'b>(unit: &Watched<'_, 'b>, proof: &Proof<'b>, record: &WatchedRecord<'b>) {
    let (m, shape, lists, answer) = (unit.m(), unit.shape(), unit.lists, unit.answer);
    let of = |valid: Signal<'b>, tag: Signal<'b>| valid & tag.eq(record.tag) & record.wanted;
    let is_it = |request: &Looked<Signal<'b>>| {
        request.line.eq(record.line) & request.offset.expect("several records").eq(record.offset)
    };
    let stages = unit
        .lookup
        .stages
        .iter()
        .map(|stage| (stage.valid, stage.request));
    for (valid, request) in stages.chain([(unit.lookup.valid, unit.lookup.request)]) {
        proof.assert(
            "a request has the line and the place of its record",
            of(valid, request.tag).implies(is_it(&request)),
        );
    }
    let offsets = lists.offsets.expect("several records");
    let lines: Vec<_> = unit
        .misses()
        .map(|(k, _)| unit.bursts.lines.peek(unit.id(k)))
        .collect();
    let waits =
        offsets.peek(record.tag).eq(record.offset) & m.select(record.owner, &lines).eq(record.line);
    proof.assert(
        "a request that waits has the line and the place of its record",
        (record.waiting & record.wanted).implies(waits),
    );
    let set = record.line.low(shape.set_bits());
    let place = answer.place.register();
    let ways = (0..).zip(&unit.lookup.tags).map(|(way, tags)| {
        let stored = tags.peek(set);
        let key = record.line.high(shape.key_bits());
        let holds = stored.msb() & stored.low(shape.key_bits()).eq(key);
        let at = m.concat(&[m.lit(way as u32, shape.way_bits()), set, record.offset]);
        holds & place.eq(at)
    });
    let ways: Vec<_> = ways.collect();
    proof.assert(
        "a response reads the place of its record",
        of(answer.on_the_way[0], answer.tags[0]).implies(m.or_all(&ways)),
    );
    for ((valid, tag), word) in answer
        .on_the_way
        .iter()
        .zip(&answer.tags)
        .skip(1)
        .zip(&answer.words)
    {
        proof.assert(
            "a response has its record",
            of(*valid, *tag).implies(word.eq(record.value)),
        );
    }
}
