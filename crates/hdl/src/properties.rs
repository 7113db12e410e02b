//! What properties of several modules have in common.

use crate::prefetch::{Inputs, Outputs, prefetch};
use crate::{Flow, HdlError, Proof, ReadInputs, Signal};
use std::ops::Deref;

/// A place of a memory of `depth` words, less than twice as far, brought back into it.
#[track_caller]
pub fn wrapped<'b>(place: Signal<'b>, depth: Signal<'b>) -> Signal<'b> {
    place.ge(depth).mux(place - depth, place)
}

/// That what is shown at a port and not taken is shown again.
#[track_caller]
pub fn assert_shown_stays<'b>(
    proof: &Proof<'b>,
    what: &str,
    valid: Signal<'b>,
    ready: Signal<'b>,
    shown: &[Signal<'b>],
) {
    let stays = shown_stays(proof, valid, ready, shown);
    proof.assert(format!("a {what} that is not taken stays"), stays);
}

/// The same as a condition, to be assumed of what surrounds a unit.
#[track_caller]
pub fn shown_stays<'b>(
    proof: &Proof<'b>,
    valid: Signal<'b>,
    ready: Signal<'b>,
    shown: &[Signal<'b>],
) -> Signal<'b> {
    let m = proof.module();
    let refused = proof.past(!m.reset() & valid & !ready);
    let same = shown.iter().map(|signal| signal.eq(proof.past(*signal)));
    refused.implies(same.fold(valid, |all, same| all & same))
}

/// A count, in `bits` bits, of what has come and not yet gone.
#[track_caller]
pub fn count<'b>(
    proof: &Proof<'b>,
    bits: u32,
    name: &str,
    comes: Signal<'b>,
    goes: Signal<'b>,
) -> Signal<'b> {
    let count = proof.reg_reset(name, bits, 0);
    count.next(count.q + comes.extend(bits) - goes.extend(bits));
    count.q
}

/// A reader ahead ([`prefetch`]) as a unit places it.
pub struct Reader<'b> {
    /// Words that have a place; the front word has one more.
    pub room: u32,
    /// Takes the front word.
    pub pop: Signal<'b>,
    outputs: Outputs<Signal<'b>>,
}

impl<'b> Reader<'b> {
    /// Places one with the module's and the instance's `names`, which reads at the addresses of `fetch`.
    pub fn new(
        registers_arrival: bool,
        names: (&str, &str),
        room: u32,
        fetch: Flow<Signal<'b>, Signal<'b>>,
        memory: ReadInputs<Signal<'b>>,
        pop: Signal<'b>,
    ) -> Result<Reader<'b>, HdlError> {
        let inputs = Inputs {
            fetch_valid: fetch.valid,
            fetch_address: fetch.payload,
            memory,
            pop,
        };
        let outputs = prefetch(registers_arrival, names, room, inputs)?;
        Ok(Reader { room, pop, outputs })
    }
}

impl<'b> Deref for Reader<'b> {
    type Target = Outputs<Signal<'b>>;

    fn deref(&self) -> &Outputs<Signal<'b>> {
        &self.outputs
    }
}

/// A reader ahead of which is assumed what is proved of it: it has a word only if it was given an address for it, and it takes no more
/// than it has room for.
pub struct Ahead<'b> {
    /// How many words are in it.
    pub count: Signal<'b>,
    /// Whether fewer are in it than have a place.
    pub has_room: Signal<'b>,
}

impl<'b> Ahead<'b> {
    /// Bits that count its words.
    const BITS: u32 = 10;

    /// `takes` says that it takes an address.
    #[track_caller]
    pub fn assumed(
        proof: &Proof<'b>,
        name: &str,
        takes: Signal<'b>,
        reader: &Reader<'b>,
    ) -> Ahead<'b> {
        let m = proof.module();
        let count = count(
            proof,
            Self::BITS,
            &format!("{name}_ahead"),
            takes,
            reader.pop,
        );
        let room = m.lit(reader.room, Self::BITS);
        proof.assume(
            "a reader ahead has a word only if it was given an address",
            reader.valid.implies(count.any()),
        );
        proof.assume(
            "a reader ahead is empty where nothing is in it",
            reader.empty.eq(count.is_zero()),
        );
        proof.assume(
            "a reader ahead takes an address only where it has room",
            reader.fetch_ready.implies(count.le(room)),
        );
        proof.assert(
            format!("no more words are in {name} than it has room for"),
            count.le(m.lit(reader.room + 1, Self::BITS)),
        );
        Ahead {
            count,
            has_room: count.lt(room),
        }
    }
}
