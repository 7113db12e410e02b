//! Rows: the words of the burst reader as rows of influences or of a program.

use super::{Around, RowRequest, program_tag_bits};
use crate::bkd::bytes::ByteRecord;
use crate::hdl::fifo::Placed;
use crate::hdl::{Flow, HdlError, ReadInputs, Reg, Response, Signal};
use crate::hw::chip::record_of;
use crate::hw::memory::combiner::{WORD_BITS, WORD_BYTES};
use crate::hw::skinning;

/// The rows that are handed on.
pub(super) struct Rows<'b> {
    pub influence: ReadInputs<Signal<'b>>,
    pub program: ReadInputs<Signal<'b>>,
    pub word_ready: Signal<'b>,
    // For the properties.
    pub tags: Placed<'b>,
    /// A row leaves in this cycle.
    pub leaves: Signal<'b>,
    /// Whether a half of a row, or of a word, is kept; only if a row is no word.
    pub kept: Option<Reg<'b>>,
}

/// A row, before its tag is known.
struct Assembled<'b> {
    valid: Signal<'b>,
    bytes: Signal<'b>,
    /// Whether the word at the front is needed no longer when the row leaves, or at once.
    pops: Signal<'b>,
    pops_at_once: Signal<'b>,
    kept: Option<(Reg<'b>, Reg<'b>)>,
}

impl<'b> Rows<'b> {
    /// Answers requests in their order. A processor has at most as many rows under way as it has tags, so there is always room for a tag.
    pub fn new(around: &Around<'_, 'b>) -> Result<Rows<'b>, HdlError> {
        let Around {
            m,
            plan,
            inputs,
            is_update,
            ..
        } = *around;
        let units = &inputs.units;
        m.comment("The tags of the requested rows.");
        let (skin_bits, program_bits) = (skinning::row_tag_bits(plan), program_tag_bits(plan));
        let bits = skin_bits.max(program_bits);
        let tag = |request: RowRequest<Signal<'b>>| request.tag.extend(bits);
        let pushes = (units.influence.valid | units.program.valid).named("row_requested");
        let asked = is_update.mux(tag(units.program.payload), tag(units.influence.payload));
        let leaves = m.wire("row_leaves", 1);
        let tags = plan.queue("row_tags", 1 << bits, pushes, asked, leaves.get())?;

        let row = assembled(around);
        leaves.drive(row.valid & tags.valid);
        if let Some((has_half, half)) = &row.kept {
            let gone = leaves.get() & has_half.q;
            let stored = match half.q.width() == WORD_BITS {
                // The first half of a wide row is stored when it arrives.
                true => row.pops_at_once,
                // The second half of a word is stored when the first leaves.
                false => leaves.get() & !has_half.q & !is_update,
            };
            has_half.next((stored | (has_half.q & !gone)) & !around.starts);
            let word = inputs.word;
            half.next_when(stored, word.high(half.q.width()));
        }
        let response = |valid: Signal<'b>, tag_bits: u32, data: Signal<'b>| ReadInputs {
            request_ready: m.ones(1),
            response: Flow::new(
                valid,
                Response {
                    tag: tags.front.low(tag_bits),
                    data,
                },
            ),
        };
        let layout = ByteRecord::influence_row(plan.format);
        let influences = record_of(plan, &layout, row.bytes);
        let program = inputs.word;
        Ok(Rows {
            influence: response(leaves.get() & !is_update, skin_bits, influences),
            program: response(leaves.get() & is_update, program_bits, program),
            word_ready: (leaves.get() & row.pops) | row.pops_at_once,
            leaves: leaves.get(),
            tags,
            kept: row.kept.map(|(has_half, _)| has_half),
        })
    }
}

/// The row that comes next: of one word, of two, or of half a word.
fn assembled<'b>(around: &Around<'_, 'b>) -> Assembled<'b> {
    let Around {
        m,
        plan,
        inputs,
        is_update,
        ..
    } = *around;
    let (valid, word) = (inputs.word_valid, inputs.word);
    let row = ByteRecord::influence_row(plan.format).bytes;
    if row == WORD_BYTES {
        return Assembled {
            valid,
            bytes: word,
            pops: m.ones(1),
            pops_at_once: m.zero(1),
            kept: None,
        };
    }
    let has_half = m.reg_reset("has_half", 1, 0);
    if row > WORD_BYTES {
        m.comment("The first word of a wide row is stored.");
        let half = m.reg("first_word", WORD_BITS);
        let complete = (is_update | has_half.q).named("row_complete");
        return Assembled {
            valid: valid & complete,
            bytes: word.concat(half.q),
            pops: m.ones(1),
            pops_at_once: valid & !complete,
            kept: Some((has_half, half)),
        };
    }
    m.comment("The second row of a word is stored when the first leaves.");
    let half = m.reg("second_row", WORD_BITS / 2);
    Assembled {
        valid: valid | has_half.q,
        bytes: has_half.q.mux(half.q, word.low(WORD_BITS / 2)),
        pops: !has_half.q,
        pops_at_once: m.zero(1),
        kept: Some((has_half, half)),
    }
}
