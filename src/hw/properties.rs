//! What properties of several units have in common.

use crate::hdl::{Proof, Signal};

/// That what is shown at a port and not taken is shown again. `id` names the registers that remember it.
#[track_caller]
pub(super) fn assert_shown_stays<'b>(
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
pub(super) fn shown_stays<'b>(
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

/// A reader ahead ([`super::prefetch`]) that a unit places, of which is assumed what is proved of it: it has a word only if it was given
/// an address for it, and it takes no more than it has room for.
pub(super) struct Ahead<'b> {
    /// How many words are in it.
    pub count: Signal<'b>,
}

impl<'b> Ahead<'b> {
    /// Bits that count its words.
    pub const BITS: u32 = 10;

    /// `takes` and `pops` say that it takes an address, and that its word is popped; `room` words have a place, and the front word
    /// has one more.
    #[track_caller]
    #[allow(clippy::too_many_arguments)] // they are its ports
    pub fn assumed(
        proof: &Proof<'b>,
        name: &str,
        takes: Signal<'b>,
        pops: Signal<'b>,
        room: u32,
        valid: Signal<'b>,
        empty: Signal<'b>,
        fetch_ready: Signal<'b>,
    ) -> Ahead<'b> {
        let m = proof.module();
        let count = proof.reg_reset(&format!("{name}_ahead"), Self::BITS, 0);
        let (comes, goes) = (takes.extend(Self::BITS), pops.extend(Self::BITS));
        count.next(count.q + comes - goes);
        proof.assume(valid.implies(count.q.any()));
        proof.assume(empty.eq(count.q.is_zero()));
        proof.assume(fetch_ready.implies(count.q.le(m.lit(room, Self::BITS))));
        proof.assert(
            format!("no more words are in {name} than it has room for"),
            count.q.le(m.lit(room + 1, Self::BITS)),
        );
        Ahead { count: count.q }
    }
}
