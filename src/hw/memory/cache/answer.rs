//! The data memory, and the responses of hits and answers.

use super::decide::Decide;
use super::fill::Fill;
use super::miss::Lists;
use super::{Around, bits, join};
use crate::hdl::{Flow, Memory, Response, Signal};

pub(super) struct Answer<'b> {
    pub response: Flow<Response<Signal<'b>>, Signal<'b>>,
    /// The registers of the flag of a response.
    pub on_the_way: Vec<Signal<'b>>,
    // For the properties.
    /// Their tags.
    pub tags: Vec<Signal<'b>>,
    pub place: Signal<'b>,
    pub banks: Vec<Memory<'b>>,
    /// What the first bank has read, at each stage.
    pub words: Vec<Signal<'b>>,
}

impl<'b> Answer<'b> {
    pub fn new(
        around: &Around<'_, 'b>,
        decide: &Decide<'b>,
        fill: &Fill<'b>,
        lists: &Lists<'b>,
    ) -> Answer<'b> {
        let Around { m, shape, .. } = *around;
        m.comment("A hit or an answer: the place of its word, and of its record in the word.");
        let p = m.pipeline();
        let draining = lists.draining;
        let either = |name: &str, answer: Option<Signal<'b>>, hit: Option<Signal<'b>>| {
            let either = |answer: Signal<'b>| draining.mux(answer, hit.expect("both have it"));
            answer.map(|answer| either(answer).hinted(name))
        };
        let set = decide.line.part("set", 0, shape.set_bits());
        let way = either("read_way", lists.way, decide.way);
        let set = either("read_set_of_way", Some(lists.set), Some(set));
        let offset = either("read_offset", lists.offset, decide.offset);
        let in_word = shape.records_per_word().ilog2();
        let word = bits(offset, in_word, shape.word_bits());
        let place = join(&[way, set, word]).expect("a set has bits");
        let valid = p
            .enter((draining | decide.hit).named("reads"))
            .cleared_by_reset();
        let tag = p.enter(draining.mux(lists.tag, decide.tag).named("read_tag"));
        let place = p.enter(place.named("read_place"));
        let select = bits(offset, 0, in_word).map(|select| p.enter(select.named("read_record")));

        m.comment("The data memory. A beat that is part of a record is written to its bank.");
        let banks = banks(around, fill);
        let latency = shape.latency_of(shape.data_style());
        let read = |memory: &Memory<'b>| memory.read(place.register()).delay(latency - 1);
        let words: Vec<_> = banks.iter().rev().map(read).collect();
        let word = m.concat(&words);
        let record = match select {
            None => word,
            Some(select) => {
                let record = |k: u32| word.field(k * shape.record_bits, shape.record_bits);
                let records: Vec<_> = (0..shape.records_per_word()).map(record).collect();
                m.select(select.at(word.stage()), &records).register()
            }
        };
        let at = record.stage();
        let first = banks[0].read(place.register());
        let words = (0..latency).map(|k| first.delay(k).untimed()).collect();
        Answer {
            response: Flow::new(
                valid.at(at).untimed(),
                Response {
                    tag: tag.at(at).untimed(),
                    data: record.untimed(),
                },
            ),
            on_the_way: valid.stages(1..=at),
            tags: tag.stages(1..=at),
            place: place.untimed(),
            banks,
            words,
        }
    }
}

/// The data memory: one memory of beats where a beat holds whole records, else one bank for each beat of a record. Only the bits of
/// records are stored.
fn banks<'b>(around: &Around<'_, 'b>, fill: &Fill<'b>) -> Vec<Memory<'b>> {
    let Around { m, shape, .. } = *around;
    let depth = 1 << shape.place_bits();
    let memory = |name: &str, width: u32, enable: Signal<'b>, data: Signal<'b>| {
        let memory = m.memory(name, depth, width, shape.data_style());
        memory.write(enable, fill.place, data);
        memory
    };
    let Some(bank) = fill.bank else {
        let record = |k: u32| {
            (fill.data).part(
                format!("record{k}"),
                8 * shape.record_bytes * k,
                shape.record_bits,
            )
        };
        let records: Vec<_> = (0..shape.records_per_word()).rev().map(record).collect();
        let data = m.concat(&records).named("fill_records");
        return vec![memory("records", data.width(), fill.valid, data)];
    };
    let width = |k: u32| {
        let left = shape.record_bits.saturating_sub(k * shape.bus_bits);
        left.min(shape.bus_bits)
    };
    (0..shape.beats_per_word())
        .filter(|k| width(*k) > 0)
        .map(|k| {
            let enable = fill.valid & bank.equals(u128::from(k));
            let enable = enable.named(format!("fill_bank_is_{k}"));
            memory(
                &format!("records_bank{k}"),
                width(k),
                enable,
                fill.data.low(width(k)),
            )
        })
        .collect()
}
