//! The counters of the chip's events: those of the ray casting unit are in that unit.

mod properties;

use super::memory::Events as MemoryEvents;
use crate::chip::registers::COUNTER_BITS;
use crate::hdl::{Builder, Bundle, HdlError, Module, Specs};
use crate::{bundle, interface};
use std::sync::Arc;

bundle! {
    /// Events that are counted here, in the order of the counters in the table.
    pub struct Events() {
        list_cycles: 1,
        cast_cycles: 1,
        cast_rays: 1,
        memory: ..{MemoryEvents}(),
    }
}

bundle! {
    /// How often each of the [`Events`] has occurred since reset.
    pub struct Counted() {
        list_cycles: COUNTER_BITS,
        cast_cycles: COUNTER_BITS,
        cast_rays: COUNTER_BITS,
        node_requests: COUNTER_BITS,
        node_hits: COUNTER_BITS,
        node_misses: COUNTER_BITS,
        node_stalls: COUNTER_BITS,
        record_requests: COUNTER_BITS,
        record_hits: COUNTER_BITS,
        record_misses: COUNTER_BITS,
        record_stalls: COUNTER_BITS,
        vertex_requests: COUNTER_BITS,
        vertex_hits: COUNTER_BITS,
        vertex_misses: COUNTER_BITS,
        vertex_stalls: COUNTER_BITS,
        moved_requests: COUNTER_BITS,
        moved_hits: COUNTER_BITS,
        moved_misses: COUNTER_BITS,
        moved_stalls: COUNTER_BITS,
        read_beats: COUNTER_BITS,
        read_waits: COUNTER_BITS,
        write_beats: COUNTER_BITS,
        write_waits: COUNTER_BITS,
    }
}

interface! {
    pub () {
        in "Events to count" { event: {Events}() }
        out "Counters" { count: {Counted}() }
    }
}

/// Describes the counters.
///
/// # Errors
/// A mistake in the description; none is known.
pub fn module() -> Result<Arc<Module>, HdlError> {
    let m = Builder::new(
        "event_counters",
        "counts the events of the chip, each cycle in which one is high.",
    );
    let ports = ports();
    let inputs = ports.inputs.inputs(&m);
    let mut counters = vec![];
    for (name, event) in inputs.event.fields() {
        let count = m.reg_reset(format!("counter_of_{name}"), COUNTER_BITS, 0);
        count.next_when(event, count.q + m.lit(1u8, COUNTER_BITS));
        counters.push((name.clone(), event, count));
    }
    let mut counts = counters.iter().map(|(_, _, count)| count.q);
    let count = (Counted::of()).map(|_, _| counts.next().expect("a counter for each event"));
    ports.outputs.outputs(&m, Outputs { count });
    properties::counts(&m, &counters);
    m.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_event_has_its_counter() {
        let events = Events::of().fields().into_iter().map(|(name, _)| name);
        let counted = Counted::of().fields().into_iter().map(|(name, _)| name);
        assert!(events.eq(counted));
    }
}
