//! The cache alone, under random requests and memories: every response against memory's contents, every decision against the
//! functional model, for caches of several shapes.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test cosim cache::` replays them.

use crate::support::{full, seed};
use dynrt::cosim::model::{self, Sources};
use dynrt::cosim::scoreboard::{Category, Fault, UnitOptions};
use dynrt::cosim::unit_cache::{self, CacheReport, reference, shapes};
use dynrt::hdl::Design;
use dynrt::hw::memory::cache::{Shape, module};

/// Requests of each shape.
fn requests() -> u64 {
    if full() { 1_000_000 } else { 20_000 }
}

fn run(shape: &Shape, requests: u64, options: &UnitOptions) -> CacheReport {
    unit_cache::run(shape, requests, options).unwrap_or_else(|e| panic!("{e:#}"))
}

/// Whether a cache of this shape can meet a category.
fn can_meet(shape: &Shape, category: Category) -> bool {
    match category {
        // A way is in flight beside a register that is free.
        Category::WaysInFlight => shape.misses >= shape.ways,
        Category::InterleavedBeats => shape.misses > 1 && shape.beats() > 1,
        Category::LinesOvertake => shape.misses > 1,
        _ => true,
    }
}

#[test]
fn caches_of_every_shape() {
    for (name, shape) in shapes() {
        let report = run(&shape, requests(), &UnitOptions::new(seed()));
        println!("{name}, {}", report.summary());
        report.unit.verdict().unwrap_or_else(|e| panic!("{e:#}"));
        assert_eq!(report.unit.transactions, requests());
        assert_eq!(report.counts.requests, requests());
        let counts = report.counts;
        assert!(counts.hits + counts.misses < counts.requests);
        assert!((0.2..0.95).contains(&counts.hit_rate()), "{name}");
        for (category, count) in &report.unit.categories {
            let possible = can_meet(&shape, *category);
            assert!(*count > 0 || !possible, "{name}: no {}", category.name());
        }
    }
}

/// Three tools find nothing to say about caches at buses of every width, in readable modules.
#[test]
fn caches_are_clean() {
    let mut all = shapes();
    for bus_bits in [32, 64, 128, 256] {
        for ways in [1, 2, 4] {
            let shape = Shape {
                bus_bits,
                ways,
                ..reference()
            };
            all.push(("bus", shape));
        }
    }
    for (name, shape) in all {
        let design = module("cache", &shape).and_then(Design::new);
        let design = design.unwrap_or_else(|e| panic!("{name}: {e}"));
        model::lint(&Sources::of(&design)).unwrap_or_else(|e| panic!("{name}: {e:#}"));
        for module in design.modules() {
            let made_up: Vec<_> = module.made_up_names().collect();
            assert!(made_up.is_empty(), "{name}, {}: {made_up:?}", module.name());
            let lines = design.verilog(module).lines().count();
            // A line for each of 16 registers, several times.
            let most = if shape.misses > 8 { 600 } else { 500 };
            assert!(lines <= most, "{name}, {}: {lines} lines", module.name());
        }
    }
}

/// The checks check.
#[test]
fn faults_are_noticed() {
    let faults: [(Fault, &str); 7] = [
        // A line in flight is replaced.
        (
            |unit| {
                let top = unit.top();
                let in_flight = top.signal("way0_in_flight")?;
                Ok(top.signal("victim_way0")?.reads(in_flight).as_value(0))
            },
            "line",
        ),
        // A request for a line that was requested in the cycle before requests it again.
        (
            |unit| Ok(unit.top().signal("tags2_replaced0")?.fault().as_value(0)),
            "line",
        ),
        // The way used last is replaced.
        (
            |unit| Ok(unit.top().signal("turn_next")?.fault().inverted()),
            "line",
        ),
        // A list ends after its first answer.
        (
            |unit| Ok(unit.top().signal("is_last")?.fault().as_value(1)),
            "",
        ),
        // A request waits without need.
        (
            |unit| {
                let top = unit.top();
                let no_way = top.signal("all_ways_in_flight")?;
                Ok(top.signal("has_room")?.reads(no_way).as_value(1))
            },
            "waits for nothing",
        ),
        // A set keeps its lines.
        (
            |unit| {
                Ok(unit
                    .top()
                    .signal("tags_write_word")?
                    .fault()
                    .as_value(1 << 21))
            },
            "line",
        ),
        // The error of a beat is lost.
        (
            |unit| Ok(unit.top().signal("error_valid")?.fault().as_value(0)),
            "an error of the bus",
        ),
    ];
    for (fault, said) in faults {
        let options = UnitOptions {
            fault: Some(fault),
            ..UnitOptions::new(seed())
        };
        let report = run(&reference(), 20_000, &options);
        let mismatch = report.unit.mismatch.as_deref().unwrap_or("no mismatch");
        println!("{mismatch}");
        assert_eq!(report.unit.mismatches, 1);
        assert!(mismatch.contains(said), "{mismatch}");
    }
}

/// A shape that cannot be is refused in one line.
#[test]
fn wrong_shapes_are_refused() {
    let reference = reference();
    let wrong = [
        (
            Shape {
                ways: 3,
                ..reference
            },
            "ways: 3 is not a power of two",
        ),
        (
            Shape {
                line_bytes: 8,
                ..reference
            },
            "bytes of a line: 8",
        ),
        (
            Shape {
                misses: 17,
                ..reference
            },
            "miss registers: 17",
        ),
        (
            Shape {
                sets: 1,
                ..reference
            },
            "sets: 1",
        ),
        (
            Shape {
                record_bits: 129,
                ..reference
            },
            "bits of a record: 129",
        ),
    ];
    for (shape, said) in wrong {
        let error = module("cache", &shape).unwrap_err().to_string();
        assert!(
            error.contains(said) && error.lines().count() == 1,
            "{error}"
        );
    }
}
