//! Common parts of the properties of several modules.

use crate::prefetch::{Inputs, Outputs, prefetch};
use crate::{Flow, HdlError, Proof, ReadInputs, Signal};
use std::ops::Deref;

/// An address below twice the depth, reduced modulo the `depth` of a memory.
#[track_caller]
pub fn wrapped<'b>(place: Signal<'b>, depth: Signal<'b>) -> Signal<'b> {
    place.ge(depth).mux(place - depth, place)
}

/// Asserts that an offer at a port is stable until it is accepted.
#[track_caller]
pub fn assert_shown_stays<'b>(
    proof: &Proof<'b>,
    what: &str,
    valid: Signal<'b>,
    ready: Signal<'b>,
    shown: &[Signal<'b>],
) {
    let stays = shown_stays(proof, valid, ready, shown);
    proof.assert(format!("a {what} is stable until it is accepted"), stays);
}

/// The same as a condition, for an assumption on the environment of a unit.
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

/// Counts arrivals minus departures, in `bits` bits.
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

/// A prefetcher ([`prefetch`]) that a unit instantiates.
pub struct Reader<'b> {
    /// The number of slots; the front word has an additional one.
    pub room: u32,
    /// Takes the front word.
    pub pop: Signal<'b>,
    outputs: Outputs<Signal<'b>>,
}

impl<'b> Reader<'b> {
    /// Instantiates a prefetcher for the addresses of `fetch`, with the `names` of module and instance.
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

/// A prefetcher with its proved properties as assumptions: it has a word only for an accepted address, and it accepts an address
/// only with room.
pub struct Ahead<'b> {
    /// The number of words in it.
    pub count: Signal<'b>,
    /// Whether it has fewer words than slots.
    pub has_room: Signal<'b>,
}

impl<'b> Ahead<'b> {
    /// Width of the number of its words.
    const BITS: u32 = 10;

    /// Makes the assumptions. `takes` is high when the prefetcher accepts an address.
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
            "a prefetcher has a word only for an accepted address",
            reader.valid.implies(count.any()),
        );
        proof.assume(
            "a prefetcher without words is empty",
            reader.empty.eq(count.is_zero()),
        );
        proof.assume(
            "a prefetcher accepts an address only with room",
            reader.fetch_ready.implies(count.le(room)),
        );
        proof.assert(
            format!("{name} never holds more words than it has room for"),
            count.le(m.lit(reader.room + 1, Self::BITS)),
        );
        Ahead {
            count,
            has_room: count.lt(room),
        }
    }
}
