//! The lookup of a line: address, tag memory, comparison. A lookup takes some cycles, in which lines that are requested by earlier
//! requests change the tag memory; so every stage notes which ways of its set have been replaced since it was read, and whether the
//! new line is its own.

use super::decide::Told;
use super::{Around, BASE_BYTES, Shape, bits};
use crate::bundle;
use crate::hdl::{Bundle, Memory, Reg, Signal};

bundle! {
    /// A request on its way to its decision.
    pub(super) struct Looked(shape: &Shape) {
        line: shape.line_bits(),
        offset if (shape.offset_bits() > 0): shape.offset_bits(),
        tag: shape.tag_bits,
    }
}

impl<'b> Looked<Signal<'b>> {
    pub fn set(&self, shape: &Shape) -> Signal<'b> {
        self.line.part("set", 0, shape.set_bits())
    }

    pub fn key(&self, shape: &Shape) -> Signal<'b> {
        self.line.part("key", shape.set_bits(), shape.key_bits())
    }
}

/// Discards all lines, after a reset and when told.
pub(super) struct Sweep<'b> {
    pub sweeping: Reg<'b>,
    pub set: Reg<'b>,
    /// Whether no request may be accepted.
    pub blocks: Signal<'b>,
}

impl<'b> Sweep<'b> {
    pub fn new(around: &Around<'_, 'b>) -> Sweep<'b> {
        let Around { m, shape, inputs } = *around;
        m.comment("After a reset, and when told, all sets are emptied, one per cycle.");
        let sweeping = m.reg_reset("sweeping", 1, 1);
        let set = m.reg_reset("sweep_set", shape.set_bits(), 0);
        let last = set.q.all().named("last_set");
        sweeping.next(inputs.invalidate | (sweeping.q & !last));
        let next = set.q + m.lit(1u8, shape.set_bits());
        // It is back at set 0 after the last one.
        set.next_when(sweeping.q, next);
        let blocks = (inputs.invalidate | sweeping.q).named("accepts_none");
        Sweep {
            sweeping,
            set,
            blocks,
        }
    }
}

/// What a stage has noted of a way since its set was read.
#[derive(Clone, Copy)]
pub(super) struct Noted<'b> {
    /// The way has been replaced.
    pub replaced: Signal<'b>,
    /// By the line that is looked up.
    pub by_own: Signal<'b>,
}

/// A stage of the lookup.
pub(super) struct Stage<'b> {
    pub valid: Signal<'b>,
    pub request: Looked<Signal<'b>>,
    /// By way; empty where nothing has been read yet.
    pub noted: Vec<Noted<'b>>,
    /// By way, the word of the tag memory; empty likewise.
    pub words: Vec<Signal<'b>>,
}

/// A request that is to be decided, and its ways.
pub(super) struct Lookup<'b> {
    /// Whether a request is accepted in this cycle, and whether any is being looked up.
    pub ready: Signal<'b>,
    pub any: Signal<'b>,
    pub valid: Signal<'b>,
    pub request: Looked<Signal<'b>>,
    /// By way: whether it holds the line, requested or arrived.
    pub found: Vec<Signal<'b>>,
    /// By miss register: whether its set is the request's.
    pub in_set: Vec<Signal<'b>>,
    // For the properties.
    pub stages: Vec<Stage<'b>>,
    pub tags: Vec<Memory<'b>>,
    pub taken: Signal<'b>,
    pub read_set: Signal<'b>,
    pub write_set: Signal<'b>,
}

/// Declares a register for each field of a request, loaded where `enable` is 1.
fn held<'b>(prefix: &str, enable: Signal<'b>, request: &Looked<Signal<'b>>) -> Looked<Signal<'b>> {
    request.map_in(prefix, |name, value| {
        let register = value.module().reg(name.to_string(), value.width());
        register.next_when(enable, value);
        register.q
    })
}

fn bit<'b>(name: String, enable: Signal<'b>, value: Signal<'b>) -> Signal<'b> {
    let register = value.module().reg(name, 1);
    register.next_when(enable, value);
    register.q
}

impl<'b> Lookup<'b> {
    pub fn new(around: &Around<'_, 'b>, sweep: &Sweep<'b>, told: &Told<'b>) -> Lookup<'b> {
        let Around { m, shape, inputs } = *around;
        let advance = told.advance.get();
        let valid_register = |name: String, value| {
            let register = m.reg_reset(name, 1, 0);
            register.next_when(advance, value);
            register.q
        };
        m.comment("The line of a request, and the place of its record in the line.");
        let ready = (advance & !sweep.blocks).named("ready");
        let arriving = address(around);
        let accepted = (inputs.request.valid & !sweep.blocks).named("request_taken");
        let mut stages = vec![Stage {
            valid: valid_register("address_valid".into(), accepted),
            request: held("address", advance, &arriving),
            noted: vec![],
            words: vec![],
        }];

        m.comment("The tags of its set. While a decision waits, the set of the stage behind is read again.");
        let set_of = |stage: &Stage<'b>| stage.request.set(shape);
        let first = &stages[0];
        let (first_valid, first_request, first_set) = (first.valid, first.request, set_of(first));
        let valid = valid_register("tags1_valid".into(), first_valid);
        let request = held("tags1", advance, &first_request);
        let read_set = advance.mux(first_set, request.set(shape)).named("read_set");
        let write_set = sweep.sweeping.q.mux(sweep.set.q, told.set.get());
        let write_set = write_set.named("tags_write_set");
        let word = (!sweep.sweeping.q)
            .concat(told.key.get())
            .named("tags_write_word");
        let tags: Vec<_> = (0..shape.ways)
            .map(|way| {
                let (depth, width) = (shape.sets, 1 + shape.key_bits());
                let memory = m.memory(format!("tags_way{way}"), depth, width, shape.tag_style());
                let write = sweep.sweeping.q | told.replaces[way as usize].get();
                memory.write(write, write_set, word);
                memory
            })
            .collect();
        let words = tags.iter().map(|memory| memory.read(read_set)).collect();
        let noted = note(around, told, &stages[0], 1);
        stages.push(Stage {
            valid,
            request,
            noted,
            words,
        });
        for k in 2..=shape.tag_latency() {
            let before = stages.last().expect("a stage");
            let valid = valid_register(format!("tags{k}_valid"), before.valid);
            let request = held(&format!("tags{k}"), advance, &before.request);
            let word = |way: usize, word: &Signal<'b>| {
                let register = m.reg(format!("tags{k}_word{way}"), word.width());
                register.next_when(advance, *word);
                register.q
            };
            let words = before.words.iter().enumerate();
            let words = words.map(|(way, w)| word(way, w)).collect();
            let noted = note(around, told, before, k);
            stages.push(Stage {
                valid,
                request,
                noted,
                words,
            });
        }
        Lookup::compared(
            around,
            told,
            stages,
            tags,
            [ready, accepted, read_set, write_set],
        )
    }

    /// Compares the words read with the line, and the sets of the miss registers with its set.
    fn compared(
        around: &Around<'_, 'b>,
        told: &Told<'b>,
        stages: Vec<Stage<'b>>,
        tags: Vec<Memory<'b>>,
        [ready, taken, read_set, write_set]: [Signal<'b>; 4],
    ) -> Lookup<'b> {
        let Around { m, shape, .. } = *around;
        let advance = told.advance.get();
        m.comment("The ways whose tag is that of the line.");
        let last = stages.last().expect("a stage");
        let key = last.request.key(shape);
        let now = compare(around, told, last);
        let found = (last.words.iter().zip(&last.noted).enumerate()).map(|(way, (word, noted))| {
            let is_key = word.low(shape.key_bits()).eq(key);
            let stored = (word.msb() & is_key).named(format!("way{way}_is_line"));
            let before = noted.replaced.mux(noted.by_own, stored);
            let replaced = told.replaces[way].get() & now.same_set;
            let found = replaced.mux(now.same_key, before);
            bit(format!("found_way{way}"), advance, found)
        });
        let found = found.collect();
        m.comment("The miss registers of its set.");
        let set = last.request.set(shape);
        let in_set = (0..shape.misses as usize).map(|k| {
            let its = told.miss_sets[k].get().eq(set);
            let in_set = told.takes[k].get().mux(now.same_set, its);
            bit(format!("in_set_of_miss{k}"), advance, in_set)
        });
        let in_set = in_set.collect();
        let valid = m.reg_reset("decide_valid", 1, 0);
        valid.next_when(advance, last.valid);
        let request = held("decide", advance, &last.request);
        let valids: Vec<_> = stages.iter().map(|stage| stage.valid).collect();
        Lookup {
            ready,
            any: (m.or_all(&valids) | valid.q).named("looks_up"),
            valid: valid.q,
            request,
            found,
            in_set,
            stages,
            tags,
            taken,
            read_set,
            write_set,
        }
    }
}

/// The line of the offered request, and the place of its record in the line.
fn address<'b>(around: &Around<'_, 'b>) -> Looked<Signal<'b>> {
    let Around { shape, inputs, .. } = *around;
    let request = inputs.request.payload;
    // The base has zeros below these bits, so only those above are added.
    let step = shape.line_bytes.min(BASE_BYTES);
    let low = (step / shape.record_bytes).ilog2();
    let width = shape.address_bits - step.ilog2();
    let base = inputs.base.part("steps", step.ilog2(), width);
    let sum = match shape.index_bits > low {
        true => {
            base + request
                .address
                .field(low, shape.index_bits - low)
                .extend(width)
        }
        false => base,
    };
    let sum = sum.named("request_sum");
    let above = (shape.line_bytes / step).ilog2();
    // The record's place: bits of the sum within a line, then the index's below those of the base.
    let index = match shape.index_bits >= low {
        true => bits(Some(request.address), 0, low),
        false => Some(request.address.extend(low)),
    };
    Looked {
        line: sum.field(above, shape.line_bits()),
        offset: super::join(&[bits(Some(sum), 0, above), index]),
        tag: request.tag,
    }
}

/// Whether the line of a stage and the one that is decided have the same set, and the same key.
struct Same<'b> {
    same_set: Signal<'b>,
    same_key: Signal<'b>,
}

fn compare<'b>(around: &Around<'_, 'b>, told: &Told<'b>, stage: &Stage<'b>) -> Same<'b> {
    let shape = around.shape;
    let (set, key) = (stage.request.set(shape), stage.request.key(shape));
    Same {
        same_set: set.eq(told.set.get()).hinted_after(set, "is_decided"),
        same_key: key.eq(told.key.get()).hinted_after(key, "is_decided"),
    }
}

/// The notes of stage `k`, from the stage before it. Those of the first stage are for one cycle: where it waits, its set is read
/// again, and the word then has what was written.
fn note<'b>(
    around: &Around<'_, 'b>,
    told: &Told<'b>,
    before: &Stage<'b>,
    k: u32,
) -> Vec<Noted<'b>> {
    let advance = told.advance.get();
    let now = compare(around, told, before);
    let note = |way: usize| {
        let replaced = told.replaces[way].get() & now.same_set;
        let replaced = replaced.hinted(format!("replaced_now{k}_way{way}"));
        let (replaced, by_own) = match before.noted.get(way) {
            None => (replaced, now.same_key),
            Some(noted) => (
                replaced | noted.replaced,
                replaced.mux(now.same_key, noted.by_own),
            ),
        };
        let enable = match before.noted.is_empty() {
            true => replaced.module().ones(1),
            false => advance,
        };
        Noted {
            replaced: bit(format!("tags{k}_replaced{way}"), enable, replaced),
            by_own: bit(format!("tags{k}_by_own{way}"), enable, by_own),
        }
    };
    (0..around.shape.ways as usize).map(note).collect()
}
