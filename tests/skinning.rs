//! The skinning processor, in all bits against the golden model: random meshes under memory latencies from 1 to 100 clocks
//! and back-pressure of every kind, and whole meshes at its full pace.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test skinning` replays them. With `DYNRT_FULL=1` a million vertices
//! are skinned, else a tenth of them.

use dynrt::bkd::{Columns, Influence};
use dynrt::config::Config;
use dynrt::cosim::scoreboard::{Fault, Surroundings, UnitOptions};
use dynrt::cosim::unit_skinning::{SkinFigures, SkinMesh, SkinReport, Traffic, Workload, run};
use dynrt::cosim::{model, sources};
use dynrt::float::Arithmetic;
use dynrt::hdl::Design;
use dynrt::hw::{Plan, skinning};
use dynrt::scene::animation::{Animated, load_animated};

fn seed() -> u64 {
    let seed = match std::env::var("DYNRT_SEED") {
        Ok(text) => text.parse().expect("DYNRT_SEED must be a number"),
        Err(_) => fastrand::u64(..),
    };
    println!("replay with DYNRT_SEED={seed}");
    seed
}

/// So many in the full mode, a tenth of them else.
fn share(vertices: u64) -> u64 {
    let full = std::env::var_os("DYNRT_FULL").is_some_and(|value| value == "1");
    let share = if full { vertices } else { vertices / 10 };
    println!("{share} of {vertices} vertices (all with DYNRT_FULL=1)");
    share
}

fn check(
    config: &Config,
    workload: Workload<'_>,
    traffic: Traffic,
    options: &UnitOptions,
) -> SkinReport {
    let report = run(config, workload, traffic, options).unwrap_or_else(|e| panic!("{e:#}"));
    println!("{}, {}", config.name, report.summary());
    report.unit.verdict().unwrap_or_else(|e| panic!("{e:#}"));
    report
}

/// So many vertices of random meshes.
fn random(config: &Config, vertices: u64, seed: u64) -> SkinReport {
    let workload = Workload::Random { vertices };
    let report = check(config, workload, Traffic::Separate, &UnitOptions::new(seed));
    assert!(report.unit.transactions >= vertices);
    assert!(report.unit.checked > report.unit.packets);
    report
}

#[test]
fn random_meshes_on_the_reference_machine() {
    let report = random(&Config::reference(), share(1_000_000), seed());
    for (category, count) in &report.unit.categories {
        assert!(*count > 0, "no {}", category.name());
    }
}
