//! Properties of the read arbiter: one client has the turn, its burst is on the bus unchanged and stable, and no client waits for more
//! than one burst of each other client.

use super::{ClientOutputs, Outputs};
use crate::hdl::properties::{assert_shown_stays, shown_stays};
use crate::hdl::{Builder, Flow, Reg, Signal};
use crate::hw::memory::Burst;

type Offer<'b> = Flow<Burst<Signal<'b>>, Signal<'b>>;

pub(super) fn rotates<'b>(
    m: &'b Builder,
    turn: &[Reg<'b>],
    bursts: &[Offer<'b>],
    of_clients: &[ClientOutputs<Signal<'b>>],
    outputs: Outputs<Signal<'b>>,
    read_ready: Signal<'b>,
    number_bits: u32,
) {
    let proof = &m.proof(
        "rotates",
        "bursts are sent unchanged, one of each waiting client in turn; beats reach their client",
    );
    let count = turn.len();
    let bits = number_bits + 2;
    for (i, burst) in bursts.iter().enumerate() {
        let Burst { address, beats, id } = burst.payload;
        let ready = of_clients[i].read_ready;
        proof.assume(
            format!("the burst of client {i} is stable until it is accepted"),
            shown_stays(proof, burst.valid, ready, &[address, beats, id]),
        );
    }
    let turns: Vec<_> = turn.iter().map(|reg| reg.q).collect();
    let bits_of_turns = m.concat(&turns);
    proof.assert(
        "one client has the turn",
        bits_of_turns.count_ones(bits).equals(1),
    );
    let Burst { address, beats, id } = outputs.read.payload;
    assert_shown_stays(
        proof,
        "burst",
        outputs.read.valid,
        read_ready,
        &[address, beats, id],
    );
    let number = id.high(number_bits);
    for (i, burst) in bursts.iter().enumerate() {
        let own = burst.payload;
        let same = address.eq(own.address) & beats.eq(own.beats) & number.equals(i as u128);
        let local = id.low(own.id.width()).eq(own.id);
        let accepted = burst.valid & of_clients[i].read_ready;
        proof.assert(
            format!("an accepted burst of client {i} is on the bus with its number"),
            accepted.implies(outputs.read.valid & read_ready & same & local),
        );
    }
    let accepted = |i: usize| bursts[i].valid & of_clients[i].read_ready;
    let sent = outputs.read.valid & read_ready;
    let any: Vec<_> = (0..count).map(accepted).collect();
    proof.assert(
        "a burst on the bus is accepted from a client",
        sent.eq(m.or_all(&any)),
    );

    // A client that waits: how many bursts of others have been sent since, and how many turns there are before its own.
    let most = m.lit(count as u32 - 1, bits);
    for i in 0..count {
        let waits = bursts[i].valid & !of_clients[i].read_ready;
        let passed = proof.reg_reset(&format!("passed{i}"), bits, 0);
        let one = m.lit(1u8, bits);
        let next = (sent & !accepted(i)).mux(passed.q + one, passed.q);
        passed.next(waits.mux(next, m.zero(bits)));
        let before: Vec<_> = (0..count)
            .map(|k| turns[(i + count - k) % count].repeat(bits) & m.lit(k as u32, bits))
            .collect();
        proof.assert(
            format!("no more bursts pass client {i} than there are others"),
            passed.q.le(most),
        );
        proof.assert(
            format!("client {i} waits for at most one burst of each other"),
            bursts[i]
                .valid
                .implies((passed.q + m.or_all(&before)).le(most)),
        );
        proof.cover(
            format!("client {i} has its turn after all others"),
            accepted(i) & passed.q.eq(most),
        );
    }
    let beats: Vec<_> = of_clients.iter().map(|client| client.beat.valid).collect();
    proof.assert(
        "a beat reaches at most one client",
        m.concat(&beats).count_ones(bits).le(m.lit(1u8, bits)),
    );
    proof.fault("the turn stays where it is", turns[0].enable().as_value(0));
    proof.fault(
        "the turn moves while a burst waits",
        turns[1].enable().as_value(1),
    );
    proof.fault("reset gives nobody the turn", turns[0].without_reset());
    proof.fault(
        "the burst of another client is sent",
        outputs
            .read
            .payload
            .address
            .fault()
            .as_signal(bursts[0].payload.address),
    );
    proof.fault(
        "a client is told that its burst is accepted when it is not its turn",
        of_clients[1].read_ready.fault().as_signal(read_ready),
    );
}
