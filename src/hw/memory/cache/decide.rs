//! The decision about a request, and the miss registers that it depends on. A request that cannot be decided waits, and holds those
//! behind it.

use super::lookup::{Lookup, Sweep};
use super::{Around, Events, Shape, id, lowest, number};
use crate::hdl::{Builder, Reg, Signal, Style, Wire};

/// What the lookup is told of the decision.
pub(super) struct Told<'b> {
    /// The lookups move on to the next stage.
    pub advance: Wire<'b>,
    /// The set and the key of the request that is decided.
    pub set: Wire<'b>,
    pub key: Wire<'b>,
    /// By way: it gets the line.
    pub replaces: Vec<Wire<'b>>,
    /// By miss register: it takes the line; and its set.
    pub takes: Vec<Wire<'b>>,
    pub miss_sets: Vec<Wire<'b>>,
}

impl<'b> Told<'b> {
    pub fn new(m: &'b Builder, shape: &Shape) -> Told<'b> {
        let all = |count: u32, width: u32, name: &dyn Fn(u32) -> String| {
            (0..count).map(|k| m.wire(name(k), width)).collect()
        };
        Told {
            advance: m.wire("advance", 1),
            set: m.wire("decide_set", shape.set_bits()),
            key: m.wire("decide_key", shape.key_bits()),
            replaces: all(shape.ways, 1, &|way| format!("replaces_way{way}")),
            takes: all(shape.misses, 1, &|k| format!("miss{k}_takes")),
            miss_sets: all(shape.misses, shape.set_bits(), &|k| {
                format!("set_of_miss{k}")
            }),
        }
    }
}

/// A miss register.
pub(super) struct Miss<'b> {
    /// In use, from the request of its line until the last answer.
    pub busy: Reg<'b>,
    pub set: Reg<'b>,
    /// None if there is one way.
    pub way: Option<Reg<'b>>,
}

pub(super) struct Decide<'b> {
    /// The request is a hit; waits for a line in flight; requests its line.
    pub hit: Signal<'b>,
    pub appends: Signal<'b>,
    pub allocates: Signal<'b>,
    /// The miss register that has its line, and the free one that would take it.
    pub listed: Signal<'b>,
    pub free: Signal<'b>,
    pub line: Signal<'b>,
    pub offset: Option<Signal<'b>>,
    pub tag: Signal<'b>,
    /// The way that holds the line; the way that would get it.
    pub way: Option<Signal<'b>>,
    pub victim: Option<Signal<'b>>,
    /// Whether a line is in flight or its list is being answered.
    pub any_busy: Signal<'b>,
    pub events: Events<Signal<'b>>,
    // For the properties.
    pub misses: Vec<Miss<'b>>,
    pub valid: Signal<'b>,
    pub advance: Signal<'b>,
    pub victims: Vec<Signal<'b>>,
    pub in_flight: Vec<Signal<'b>>,
    pub pending: Signal<'b>,
    pub goes: Signal<'b>,
}

/// The part of the miss registers.
const MISSES: (&str, &str) = (
    "misses",
    "the miss registers: the sets and ways of lines in flight.",
);

/// The miss registers, and what they say of the request that is decided.
struct Registers<'b> {
    misses: Vec<Miss<'b>>,
    busy: Vec<Signal<'b>>,
    /// By way: its line in the request's set is in flight.
    in_flight: Vec<Signal<'b>>,
    /// By miss register: it has the request's line; the number of the one that does.
    has_line: Vec<Signal<'b>>,
    listed: Signal<'b>,
}

impl<'b> Registers<'b> {
    fn new(around: &Around<'_, 'b>, lookup: &Lookup<'b>) -> Registers<'b> {
        let Around { m, shape, .. } = *around;
        let found = &lookup.found;
        m.comment("A line is in flight while one has its set and way.");
        let misses: Vec<_> = (0..shape.misses).map(|k| miss(m, shape, k)).collect();
        let busy: Vec<_> = misses.iter().map(|miss| miss.busy.q).collect();
        let here: Vec<_> = (busy.iter().zip(&lookup.in_set).enumerate())
            .map(|(k, (busy, in_set))| (*busy & *in_set).named(format!("miss{k}_is_of_set")))
            .collect();
        // By way, and by miss register: its line is in the way of this set.
        let in_way: Vec<Vec<_>> = (0..shape.ways)
            .map(|way| {
                let its = here.iter().zip(&misses).enumerate();
                let its = its.map(|(k, (here, miss))| {
                    let its = *here & miss.is_of(way);
                    its.hinted(format!("miss{k}_has_way{way}"))
                });
                its.collect()
            })
            .collect();
        let in_flight: Vec<_> = (in_way.iter().enumerate())
            .map(|(way, its)| m.or_all(its).named(format!("way{way}_in_flight")))
            .collect();
        let has_line: Vec<_> = (0..misses.len())
            .map(|k| {
                let found = in_way.iter().zip(found).map(|(its, found)| its[k] & *found);
                let found: Vec<_> = found.collect();
                m.or_all(&found).named(format!("miss{k}_has_line"))
            })
            .collect();
        Registers {
            listed: id(m, shape, "listed_id", &has_line),
            misses,
            busy,
            in_flight,
            has_line,
        }
    }
}

impl<'b> Decide<'b> {
    /// `draining` is high while the data memory is used by answers, `freed` tells which miss registers are not used any more.
    pub fn new(
        around: &Around<'_, 'b>,
        sweep: &Sweep<'b>,
        lookup: &Lookup<'b>,
        told: &Told<'b>,
        draining: Signal<'b>,
        freed: Signal<'b>,
    ) -> Decide<'b> {
        let Around { m, shape, .. } = *around;
        let request = lookup.request;
        let (set, found) = (request.set(shape), &lookup.found);
        let Registers {
            misses,
            busy,
            in_flight,
            has_line,
            listed,
        } = m.part(MISSES.0, MISSES.1, || Registers::new(around, lookup));

        m.comment("The way that a line would replace: the first, from the preferred one on, that is not in flight.");
        let turn = (shape.ways > 1)
            .then(|| m.memory("turn", shape.sets, shape.way_bits(), Style::Distributed));
        let preferred = turn.map(|turn| turn.read_now(set).hinted("preferred_way"));
        let victims = victims(shape, preferred, &in_flight);

        m.comment("The decision. Answers go before new requests.");
        let is_found = m.or_all(found).named("is_found");
        let pending = m.or_all(&has_line).named("is_pending");
        let all_busy = m.and_all(&busy).named("all_busy");
        let no_way = m.and_all(&in_flight).named("all_ways_in_flight");
        let has_room = (!all_busy & !no_way).named("has_room");
        let goes = lookup.valid & !draining & (is_found | has_room);
        let goes = goes.named("goes");
        let hit = (goes & is_found & !pending).named("hit");
        let appends = (goes & pending).named("appends");
        let allocates = (goes & !is_found).named("allocates");
        let waits = (lookup.valid & !goes).named("waits");
        let advance = (!waits).named("moves_on");
        told.advance.drive(advance);
        told.set.drive(set);
        told.key.drive(request.key(shape));
        for (wire, victim) in told.replaces.iter().zip(&victims) {
            wire.drive(allocates & *victim);
        }
        let victim = number("victim", &victims);
        let free = m.part(MISSES.0, MISSES.1, || {
            let free = lowest(
                "is_next",
                &busy.iter().map(|busy| !*busy).collect::<Vec<_>>(),
            );
            for (k, miss) in misses.iter().enumerate() {
                told.takes[k].drive(allocates & free[k]);
                told.miss_sets[k].drive(miss.set.q);
            }
            for (k, miss) in misses.iter().enumerate() {
                let takes = told.takes[k].get();
                miss.busy.next(takes | (miss.busy.q & !freed.bit(k as u32)));
                miss.set.next_when(takes, set);
                if let (Some(way), Some(victim)) = (&miss.way, victim) {
                    way.next_when(takes, victim);
                }
            }
            id(m, shape, "free_id", &free)
        });
        let way = number("found_way", found);
        if let Some(turn) = turn {
            let (enable, next) = turns(shape, (goes, allocates, is_found), (way, victim));
            let sweeping = sweep.sweeping.q;
            let next = (next & (!sweeping).repeat(shape.way_bits())).named("turn_next");
            turn.write(sweeping | enable, sweep_or(sweep, set), next);
        }

        m.comment("Events for the counters.");
        let event = |name: &str, happens: Signal<'b>| {
            let register = m.reg_reset(format!("{name}_event"), 1, 0);
            register.next(happens);
            register.q
        };
        let events = Events {
            requests: event("request", goes),
            hits: event("hit", hit),
            misses: event("miss", allocates),
            stalls: event("stall", waits),
        };
        Decide {
            hit,
            appends,
            allocates,
            listed,
            free,
            line: request.line,
            offset: request.offset,
            tag: request.tag,
            way,
            victim,
            any_busy: m.or_all(&busy).named("any_busy"),
            events,
            misses,
            valid: lookup.valid,
            advance,
            victims,
            in_flight,
            pending,
            goes,
        }
    }
}

fn sweep_or<'b>(sweep: &Sweep<'b>, set: Signal<'b>) -> Signal<'b> {
    let set = sweep.sweeping.q.mux(sweep.set.q, set);
    set.hinted("written_set")
}

fn miss<'b>(m: &'b Builder, shape: &Shape, k: u32) -> Miss<'b> {
    Miss {
        busy: m.reg_reset(format!("miss{k}_busy"), 1, 0),
        set: m.reg(format!("miss{k}_set"), shape.set_bits()),
        way: (shape.ways > 1).then(|| m.reg(format!("miss{k}_way"), shape.way_bits())),
    }
}

impl<'b> Miss<'b> {
    /// Whether its way is this one.
    fn is_of(&self, way: u32) -> Signal<'b> {
        match &self.way {
            Some(register) => register.q.equals(u128::from(way)),
            None => self.busy.q.module().ones(1),
        }
    }
}

/// By way: whether it is the first, from the preferred one on, that is not in flight.
fn victims<'b>(
    shape: &Shape,
    preferred: Option<Signal<'b>>,
    in_flight: &[Signal<'b>],
) -> Vec<Signal<'b>> {
    let ways = shape.ways as usize;
    let Some(preferred) = preferred else {
        return vec![(!in_flight[0]).named("victim_way0")];
    };
    let victim = |way: usize| {
        let m = preferred.module();
        // From each preferred way, all those before this one must be in flight.
        let from = |distance: usize| {
            let start = (way + ways - distance) % ways;
            let is_preferred = preferred.equals(start as u128);
            let is_preferred = is_preferred.hinted_after(preferred, format!("is_{start}"));
            let reached = (0..distance).fold(is_preferred, |so_far, k| {
                so_far & in_flight[(start + k) % ways]
            });
            reached.hinted(format!("way{way}_after_way{start}"))
        };
        let reached: Vec<_> = (0..ways).map(from).collect();
        let reached = m.or_all(&reached).hinted(format!("way{way}_reached"));
        (reached & !in_flight[way]).named(format!("victim_way{way}"))
    };
    (0..ways).map(victim).collect()
}

/// Whether the preferred way of the set changes, and to which. Of two ways it is the one that was not used last; more take turns.
fn turns<'b>(
    shape: &Shape,
    (goes, allocates, is_found): (Signal<'b>, Signal<'b>, Signal<'b>),
    (way, victim): (Option<Signal<'b>>, Option<Signal<'b>>),
) -> (Signal<'b>, Signal<'b>) {
    let (way, victim) = (way.expect("two ways"), victim.expect("two ways"));
    match shape.ways {
        2 => (goes, !is_found.mux(way, victim)),
        _ => {
            let one = goes.module().lit(1u8, shape.way_bits());
            (allocates, victim + one)
        }
    }
}
