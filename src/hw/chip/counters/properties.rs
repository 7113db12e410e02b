//! Properties of the counters: each counts its own event.

use crate::hdl::{Builder, Reg, Signal};

pub(super) fn counts<'b>(m: &'b Builder, counters: &[(String, Signal<'b>, Reg<'b>)]) {
    let proof = &m.proof("counts", "each counter counts the cycles with its event");
    let known = proof.reg_reset("known", 1, 0);
    known.next(m.ones(1));
    for (name, event, count) in counters {
        let before = proof.past(count.q);
        let counted = proof.past(event.extend(count.q.width()));
        proof.assert(
            format!("{name} counts its event"),
            known.q.implies(count.q.eq(before + counted)),
        );
        proof.assert(
            format!("{name} is 0 after a reset"),
            known.q | count.q.is_zero(),
        );
    }
    let all: Vec<_> = counters.iter().map(|(_, _, count)| count.q.any()).collect();
    proof.cover("all events have been counted", m.concat(&all).all());
    let [(_, event, first), (_, _, second), ..] = counters else {
        return;
    };
    proof.fault(
        "an event is counted twice",
        first.q.literal_of(1).as_value(2),
    );
    proof.fault(
        "a counter counts in every cycle",
        first.q.enable().as_value(1),
    );
    proof.fault(
        "a counter counts the event of another",
        second.q.enable().as_signal(*event),
    );
    proof.fault("a counter has no reset", second.q.without_reset());
}
