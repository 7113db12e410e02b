//! The events of a run in the Chrome trace format, which Perfetto and other viewers show.

use crate::cosim::chip::{ACTIVITY_CYCLES, Event};
use serde_json::{Value, json};

/// The process and its name in the viewer.
const PROCESS: u32 = 1;

/// Events as a trace. A cycle is shown as a microsecond.
pub fn chrome_trace(events: &[Event]) -> Value {
    let mut all = vec![json!({
        "name": "process_name", "ph": "M", "pid": PROCESS, "args": {"name": "dynrt_chip: 1 us is a cycle"},
    })];
    for (number, event) in events.iter().enumerate() {
        let mut span = |track: &str, name: String, begin: u64, end: u64| {
            for (phase, time) in [("b", begin), ("e", end)] {
                all.push(json!({
                    "name": name, "cat": track, "ph": phase, "id": number, "pid": PROCESS, "tid": track, "ts": time,
                }));
            }
        };
        match *event {
            Event::Read {
                client,
                address,
                begin,
                end,
            } => {
                let client = client.map_or("unknown", |client| client.name());
                span(
                    &format!("read: {client}"),
                    format!("{address:#010x}"),
                    begin,
                    end,
                );
            }
            Event::Write {
                address,
                begin,
                end,
            } => span("write", format!("{address:#010x}"), begin, end),
            Event::Packet { tag, begin, end } => {
                span("packets", format!("packet {tag}"), begin, end)
            }
            Event::Activity {
                cycle,
                steps,
                tests,
                bytes,
            } => {
                let counts = [
                    ("traversal steps per cycle", steps),
                    ("ray-triangle tests per cycle", tests),
                    ("bytes on the bus per cycle", bytes),
                ];
                let start = cycle.saturating_sub(ACTIVITY_CYCLES);
                for (name, count) in counts {
                    let rate = count as f64 / ACTIVITY_CYCLES as f64;
                    all.push(json!({
                        "name": name, "ph": "C", "pid": PROCESS, "ts": start, "args": {"value": rate},
                    }));
                }
            }
        }
    }
    json!({"displayTimeUnit": "ms", "traceEvents": all})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_span_begins_and_ends() {
        let events = [
            Event::Write {
                address: 64,
                begin: 3,
                end: 9,
            },
            Event::Packet {
                tag: 7,
                begin: 1,
                end: 20,
            },
            Event::Activity {
                cycle: 256,
                steps: 128,
                tests: 64,
                bytes: 512,
            },
        ];
        let trace = chrome_trace(&events);
        let all = trace["traceEvents"].as_array().unwrap();
        let of = |phase: &str| all.iter().filter(|event| event["ph"] == phase).count();
        assert_eq!((of("b"), of("e"), of("C"), of("M")), (2, 2, 3, 1));
        let rate = all.iter().find(|event| event["ph"] == "C").unwrap();
        assert_eq!(rate["args"]["value"], 0.5);
        assert_eq!(rate["ts"], 0);
    }
}
