//! Beats: where each belongs in the data memory, and which line is complete.

use super::decide::Decide;
use super::{Address, Around, PerMiss, bits, is_id, join};
use crate::hdl::{Flow, Reg, Signal};
use crate::hw::memory::ADDRESS_BITS;

pub(super) struct Fill<'b> {
    /// A beat that is written.
    pub valid: Signal<'b>,
    pub data: Signal<'b>,
    /// Its place in the data memory: way, set, word.
    pub place: Signal<'b>,
    /// Its place in a word of several beats.
    pub bank: Option<Signal<'b>>,
    /// By miss register: the last beat of its line arrives.
    pub last: Vec<Signal<'b>>,
    pub error: Flow<Address<Signal<'b>>, Signal<'b>>,
    // For the properties.
    /// By miss register: beats of its line so far; none if a line is one beat.
    pub positions: Option<Vec<Reg<'b>>>,
    pub lines: PerMiss<'b>,
}

impl<'b> Fill<'b> {
    pub fn new(around: &Around<'_, 'b>, decide: &Decide<'b>) -> Fill<'b> {
        let Around { m, shape, inputs } = *around;
        let beat = inputs.beat.payload;
        m.comment("The line of each miss register, and its way.");
        let line_bits = shape.line_bits();
        let word = join(&[decide.victim, Some(decide.line)]).expect("a line has bits");
        let word = word.hinted("victim_line");
        let lines = PerMiss::new(around, "filled_lines", decide.allocates, decide.free, word);
        let filled = lines.read(beat.id).hinted("filled");
        let way = bits(Some(filled), line_bits, shape.way_bits());

        m.comment(
            "The beats of a line arrive in order; those of several lines may be interleaved.",
        );
        let of_miss: Vec<_> = (is_id(shape, beat.id).into_iter().enumerate())
            .map(|(k, is)| (inputs.beat.valid & is).named(format!("beat_of_miss{k}")))
            .collect();
        let last = (of_miss.iter().enumerate())
            .map(|(k, of_miss)| (*of_miss & beat.last).named(format!("last_of_miss{k}")))
            .collect();
        let positions = (shape.beat_bits() > 0).then(|| {
            let position = |(k, of_miss): (usize, &Signal<'b>)| {
                let register = m.reg_reset(format!("position{k}"), shape.beat_bits(), 0);
                let one = m.lit(1u8, shape.beat_bits());
                register.next_when(*of_miss, register.q + one);
                register
            };
            of_miss.iter().enumerate().map(position).collect::<Vec<_>>()
        });
        let position = positions.as_ref().map(|positions| {
            let all: Vec<_> = positions.iter().map(|register| register.q).collect();
            m.select(beat.id, &all).named("position")
        });
        let in_word = shape.beats_per_word().ilog2();
        let word = bits(position, in_word, shape.word_bits());
        let set = filled.part("set", 0, shape.set_bits());
        let place = join(&[way, Some(set), word]).expect("a set has bits");

        m.comment("A beat is written a cycle after it arrives. After a reset no line is valid, so a beat that is written then does no harm.");
        let register = |name: &str, value: Signal<'b>| {
            let register = m.reg(name, value.width());
            register.next(value);
            register.q
        };
        let failed = m.reg_reset("fill_failed", 1, 0);
        failed.next(inputs.beat.valid & beat.error);
        let address = filled.low(line_bits);
        let line = register("fill_line", address);
        let below = m.zero(shape.line_bytes.ilog2());
        let error = match shape.line_bytes {
            1 => line,
            _ => line.concat(below),
        };
        Fill {
            valid: register("fill_valid", inputs.beat.valid),
            data: register("fill_data", beat.data),
            place: register("fill_place", place),
            bank: bits(position, 0, in_word).map(|bank| register("fill_bank", bank)),
            last,
            error: Flow::new(
                failed.q,
                Address {
                    address: error.extend(ADDRESS_BITS),
                },
            ),
            positions,
            lines,
        }
    }
}
