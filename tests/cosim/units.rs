//! The traversal unit and the geometry unit, compared with the golden model in all bits: real frames and tiny scenes with many
//! ties, with memory latencies from 1 to 100 cycles and random back-pressure.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test cosim units::` repeats them.

use crate::support::prepare;
use crate::support::seed;
use dynrt::config::{Config, TriangleTest};
use dynrt::cosim::scoreboard::{Category, Fault, UnitOptions, UnitReport};
use dynrt::cosim::workload::{Workload, instanced_scene};
use dynrt::cosim::{model, raycast, unit_geometry, unit_tpu};
use dynrt::golden::Caster;
use dynrt::port::Ray;

/// Number of transactions per unit of the reference machine, over all its workloads.
const MANY: u64 = 1_000_000;

/// Number of transactions in tiny scenes with which every category occurs many times.
const FEW: u64 = 60_000;

/// Number of two-level scenes per machine.
const SCENES_OF_TWO_LEVELS: u32 = 12;

type Run = fn(&Config, Workload<'_>, &UnitOptions) -> anyhow::Result<UnitReport>;

/// Runs a workload, prints its report and checks it.
fn check(run: Run, config: &Config, workload: Workload<'_>, seed: u64) -> UnitReport {
    let report = run(config, workload, &UnitOptions::new(seed)).unwrap_or_else(|e| panic!("{e:#}"));
    println!("{}, {}", config.name, report.summary());
    report.verdict().unwrap_or_else(|e| panic!("{e:#}"));
    report
}

/// Runs this number of transactions in tiny scenes; each category must occur.
fn coincidences(run: Run, config: &Config, transactions: u64, seed: u64) -> u64 {
    let workload = Workload::Coincidences { transactions };
    let report = check(run, config, workload, seed);
    assert!(report.transactions >= transactions);
    let is_tpu = report.unit == "tpu";
    for (category, count) in &report.categories {
        let possible = match category {
            // A packet of one ray never steps for an absent ray.
            Category::Nan | Category::InactiveRay => config.rays_per_packet > 1 || !is_tpu,
            // A category with few tests in 60,000 may not occur.
            Category::Clamped => transactions >= MANY / 2,
            _ => true,
        };
        assert!(*count > 0 || !possible, "no {}", category.name());
    }
    report.transactions
}

fn reference(test: TriangleTest) -> Config {
    Config {
        triangle_test: test,
        name: format!("reference, {test:?}"),
        ..Config::reference()
    }
}

#[test]
fn tpu_of_the_reference_machine() {
    let (config, seed) = (Config::reference(), seed());
    let scene = prepare(&config, "builtin:teapot", "256x192", None);
    let (image, rays) = (&scene.image, &scene.rays);
    let workload = Workload::Rays { image, rays };
    let report = check(unit_tpu::run, &config, workload, seed);
    let golden = Caster::new(image, config.triangle_test, 4).cast_packets(rays);
    assert_eq!(
        (report.transactions, report.packets),
        (golden.steps(), golden.packets.len() as u64)
    );
    let rest = MANY.saturating_sub(report.transactions).max(FEW);
    let total = report.transactions + coincidences(unit_tpu::run, &config, rest, seed);
    assert!(total >= MANY);
}

fn geometry_of_the_reference_machine(test: TriangleTest) {
    let (config, seed) = (reference(test), seed());
    let scene = prepare(&config, "builtin:teapot", "256x192", None);
    let (image, rays) = (&scene.image, &scene.rays);
    let workload = Workload::Rays { image, rays };
    let report = check(unit_geometry::run, &config, workload, seed);
    let golden = Caster::new(image, config.triangle_test, 4).cast_packets(rays);
    assert_eq!(report.transactions, golden.ray_tests());
    let rest = MANY.saturating_sub(report.transactions).max(FEW);
    let total = report.transactions + coincidences(unit_geometry::run, &config, rest, seed);
    assert!(total >= MANY);
    for active in 1..=config.rays_per_packet {
        let throughput =
            unit_geometry::throughput(&config, active, seed, &model::BuildOptions::default())
                .unwrap_or_else(|e| panic!("{e:#}"));
        println!(
            "leaves of {active} rays: {:.4} tests a clock, {:.4} of the peak ({} tests)",
            throughput.rate(),
            throughput.share_of_peak(),
            throughput.tests
        );
        assert!(throughput.share_of_peak() >= 0.95);
    }
}

#[test]
fn watertight_geometry_of_the_reference_machine() {
    geometry_of_the_reference_machine(TriangleTest::Watertight);
}

#[test]
fn moller_trumbore_geometry_of_the_reference_machine() {
    geometry_of_the_reference_machine(TriangleTest::MollerTrumbore);
}

/// Machines that differ from the reference in all parameters of the two units.
fn others() -> Vec<Config> {
    let single = Config {
        name: "8 rays, 8-bit exponent and 23-bit fraction, 133 MHz".into(),
        rays_per_packet: 8,
        exponent_bits: 8,
        fraction_bits: 23,
        clock_mhz: 133,
        packets_in_flight: 21,
        triangle_test: TriangleTest::MollerTrumbore,
        ..Config::reference()
    };
    let pairs = Config {
        name: "2 rays, one axis, 64 packets, 66 MHz".into(),
        rays_per_packet: 2,
        packets_in_flight: 64,
        axes_per_node: 1,
        stack_depth: 11,
        clock_mhz: 66,
        ..Config::reference()
    };
    vec![Config::load("tiny").unwrap(), pairs, single]
}

#[test]
fn tpu_of_other_machines() {
    let seed = seed();
    for config in others() {
        coincidences(unit_tpu::run, &config, FEW, seed);
        let transactions = FEW;
        let workload = Workload::Instances { transactions };
        let report = check(unit_tpu::run, &config, workload, seed);
        assert!(report.transactions >= FEW);
    }
}

#[test]
fn geometry_of_other_machines() {
    let seed = seed();
    for config in others() {
        coincidences(unit_geometry::run, &config, FEW, seed);
    }
}

/// Ray transformations of the geometry unit, with tests in object space between them.
fn transforms_of_the_reference_machine(test: TriangleTest) {
    let (config, seed) = (reference(test), seed());
    let workload = Workload::Instances { transactions: MANY };
    let run: Run = unit_geometry::run_transform;
    let report = check(run, &config, workload, seed);
    assert!(report.transactions >= MANY);
    for (category, count) in &report.categories {
        assert!(*count > 0, "no {}", category.name());
    }
}

#[test]
fn watertight_transforms_of_the_reference_machine() {
    transforms_of_the_reference_machine(TriangleTest::Watertight);
}

#[test]
fn moller_trumbore_transforms_of_the_reference_machine() {
    transforms_of_the_reference_machine(TriangleTest::MollerTrumbore);
}

/// The geometry unit of other machines in scenes of two levels, with its tests as transactions.
#[test]
fn two_levels_in_the_geometry_unit_of_other_machines() {
    let seed = seed();
    for config in others() {
        let transactions = FEW;
        let workload = Workload::Instances { transactions };
        let report = check(unit_geometry::run, &config, workload, seed);
        assert!(report.transactions >= FEW);
    }
}

/// Scenes of two levels in the whole ray casting unit: packet steps, ray transformations, triangle tests and hits, in all
/// bits, for packets of every size, with both triangle tests.
#[test]
fn whole_machines_of_two_levels() {
    let seed = seed();
    let mut rng = fastrand::Rng::with_seed(seed);
    for rays_per_packet in [1, 2, 4, 8] {
        for triangle_test in [TriangleTest::Watertight, TriangleTest::MollerTrumbore] {
            let config = Config {
                rays_per_packet,
                triangle_test,
                packets_in_flight: rng.u32(4..=24),
                clock_mhz: [50, 75, 100, 133][rng.usize(..4)],
                memory_jitter: rng.u32(0..=20),
                memory_in_order: rng.bool(),
                memory_ready_percent: rng.u32(50..=100),
                name: format!("{rays_per_packet} rays, {triangle_test:?}"),
                ..Config::reference()
            };
            let (mut transforms, mut tests, mut hits) = (0, 0, 0);
            for scene in 0..SCENES_OF_TWO_LEVELS {
                let (image, rays) = instanced_scene(&config, 600, &mut rng).unwrap();
                let options = raycast::Options {
                    seed: rng.u64(..),
                    ray_stall: [0.0, 0.3][rng.usize(..2)],
                    hit_stall: [0.0, 0.3][rng.usize(..2)],
                    ..raycast::Options::default()
                };
                let report = raycast::run(&config, &image, &rays, &options, &|_| ())
                    .unwrap_or_else(|e| panic!("{}, scene {scene}: {e:#}", config.to_toml()));
                assert_eq!(report.hits_checked, rays.len() as u64);
                transforms += report.transforms_checked;
                tests += report.tests_checked;
                hits += report.hits.iter().filter(|hit| hit.is_hit()).count();
            }
            println!(
                "{} rays, {triangle_test:?}: {transforms} transformations, {tests} tests, {hits} hits",
                rays_per_packet
            );
            assert!(transforms > 1000 && tests > 1000 && hits > 100);
        }
    }
}

/// Faults in rarely used logic are detected, and if only one field can show a fault, the
/// report marks that field.
#[test]
fn faults_are_noticed() {
    let (config, seed) = (Config::load("tiny").unwrap(), seed());
    let one_level = Workload::Coincidences { transactions: FEW };
    let two_levels = Workload::Instances { transactions: FEW };
    let faults: [(Run, Workload<'_>, Fault, &str); 8] = [
        // A limit that is wrong by an ulp.
        (
            unit_tpu::run,
            one_level,
            |unit| {
                let clip = &unit.top().instances_of("tpu_clip")[0];
                Ok(clip.input("limit_value")?.with_flipped(1))
            },
            "unit tpu",
        ),
        // Popped entries are never dropped.
        (
            unit_tpu::run,
            one_level,
            |unit| {
                let clip = unit.module("tpu_clip")?;
                Ok((clip.signal("stay")?.reads(clip.signal("is_within")?)).as_value(1))
            },
            "unit tpu",
        ),
        // The hit mask of a finished packet is empty.
        (
            unit_tpu::run,
            one_level,
            |unit| Ok(unit.top().signal("finished_touched")?.fault().as_value(0)),
            "* rays that have hit something",
        ),
        // Of hits at equal distances, the last one is kept.
        (
            unit_geometry::run,
            one_level,
            |unit| {
                let lower = unit.top().signal("lower")?;
                Ok(unit.top().signal("replaces")?.reads(lower).as_value(1))
            },
            "* replaces the closest",
        ),
        // The hit that is read back is wrong by an ulp.
        (
            unit_geometry::run,
            one_level,
            |unit| Ok(unit.top().signal("read_v")?.fault().with_flipped(1)),
            "* v ",
        ),
        // An instance that no ray enters ends its packet.
        (
            unit_tpu::run,
            two_levels,
            |unit| {
                let object = unit.top().signal("setup_object")?;
                Ok((unit.top().signal("finished_valid")?.reads(object)).as_value(0))
            },
            "unit tpu",
        ),
        // The interval in object space is wrong by an ulp.
        (
            unit_geometry::run_transform,
            two_levels,
            |unit| Ok(unit.top().signal("object_tmax")?.fault().with_flipped(1)),
            "* tmax",
        ),
        // Triangles in an object are reported for instance 0.
        (
            unit_geometry::run,
            two_levels,
            |unit| Ok(unit.top().signal("read_instance")?.fault().with_flipped(1)),
            "* instance",
        ),
    ];
    for (run, workload, fault, said) in faults {
        let options = UnitOptions {
            fault: Some(fault),
            ..UnitOptions::new(seed)
        };
        let report = run(&config, workload, &options).unwrap_or_else(|e| panic!("{e:#}"));
        let mismatch = report.mismatch.as_deref().unwrap_or("no mismatch");
        println!("{said}\n{mismatch}");
        assert_eq!(report.mismatches, 1);
        assert!(mismatch.contains(said), "{mismatch}");
        assert!(report.verdict().is_err());
    }
}

/// A run that checks nothing fails.
#[test]
fn nothing_checked_is_a_failure() {
    let config = Config::load("tiny").unwrap();
    let scene = prepare(&config, "builtin:sphere?level=0", "2x2", None);
    let rays = [Ray::INACTIVE; 8];
    let workload = Workload::Rays {
        image: &scene.image,
        rays: &rays,
    };
    for run in [unit_tpu::run as Run, unit_geometry::run as Run] {
        let report = run(&config, workload, &UnitOptions::new(1)).unwrap();
        let error = report.verdict().unwrap_err().to_string();
        assert!(error.contains("nothing was checked"), "{error}");
    }
}
