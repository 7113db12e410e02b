//! The update processor, compared with the golden model in all bits: random topologies with memory latencies from 1 to
//! 100 cycles and random back-pressure, and whole scenes at full rate.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test cosim update::` repeats them.

use crate::support::seed;
#[allow(dead_code)]
use crate::support::shared_scene;
use dynrt::bkd::{BuildOptions, build};
use dynrt::config::Config;
use dynrt::cosim::model;
use dynrt::cosim::scoreboard::{Surroundings, UnitOptions};
use dynrt::cosim::unit_update::{
    Traffic, UpdateFigures, UpdateObject, UpdateReport, Workload, machine, run,
};
use dynrt::hdl::Design;
use dynrt::hw::{Plan, update};
use dynrt::program::UpdateMachine;
use dynrt::scene::{self, MachineMesh};

/// Number of instructions of random topologies on the reference machine.
const MANY: u64 = 1_000_000;

/// The same on each other machine.
const FEW: u64 = 50_000;

fn check(
    config: &Config,
    workload: Workload<'_>,
    traffic: Traffic,
    options: &UnitOptions,
) -> UpdateReport {
    let report = run(config, workload, traffic, options).unwrap_or_else(|e| panic!("{e:#}"));
    println!("{}, {}", config.name, report.summary());
    report.unit.verdict().unwrap_or_else(|e| panic!("{e:#}"));
    report
}

/// Random topologies with this number of instructions.
fn random(config: &Config, instructions: u64, seed: u64) -> UpdateReport {
    let workload = Workload::Random { instructions };
    let report = check(config, workload, Traffic::Separate, &UnitOptions::new(seed));
    assert!(report.unit.transactions >= instructions);
    assert!(report.unit.checked > report.unit.packets);
    report
}

#[test]
fn random_topologies_on_the_reference_machine() {
    let report = random(&Config::reference(), MANY, seed());
    for (category, count) in &report.unit.categories {
        assert!(*count > 0, "no {}", category.name());
    }
    let waits = &report.objects[0];
    assert!(waits.vertex_wait_cycles > 0, "no wait for a vertex");
    assert!(waits.node_wait_cycles > 0, "no wait for room for a node");
}

/// Machines that differ from the reference in all parameters of the unit.
fn others() -> Vec<Config> {
    vec![
        Config::load("tiny").unwrap(),
        Config {
            name: "least registers and queues, 3-bit exponent and 2-bit fraction, 66 MHz".into(),
            exponent_bits: 3,
            fraction_bits: 2,
            clock_mhz: 66,
            update_vertex_registers: 8,
            update_box_registers: 8,
            update_program_rows: 2,
            update_instructions_ahead: 4,
            update_vertices_ahead: 2,
            update_nodes_waiting: 2,
            ..Config::reference()
        },
        Config {
            name: "odd sizes, 8-bit exponent and 23-bit fraction, 133 MHz".into(),
            exponent_bits: 8,
            fraction_bits: 23,
            clock_mhz: 133,
            update_vertex_registers: 11,
            update_box_registers: 37,
            update_program_rows: 5,
            update_instructions_ahead: 100,
            update_vertices_ahead: 37,
            update_nodes_waiting: 13,
            address_bits: 26,
            ..Config::reference()
        },
    ]
}

#[test]
fn random_topologies_on_other_machines() {
    let seed = seed();
    for config in others() {
        random(&config, FEW, seed);
    }
}

#[test]
fn random_machines_are_clean_verilog() {
    let seed = seed();
    let random = (0..4).map(|k| Config::random(seed.wrapping_add(k)));
    for config in others().into_iter().chain(random) {
        let unit = update::module(&Plan::new(&config).unwrap()).unwrap();
        let design = Design::new(unit.module).unwrap();
        model::lint(&model::Sources::of(&design))
            .unwrap_or_else(|e| panic!("{}: {e:#}", config.name));
    }
}

/// A scene as an object, with the machine's default tree.
fn object(config: &Config, name: &str) -> UpdateObject {
    let scene = scene::load(name).unwrap();
    let mesh = MachineMesh::new(&scene, config.format()).unwrap();
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
    let machine = machine(config).unwrap();
    let (format, triangles, vertices) = (config.format(), &mesh.triangles, &mesh.vertices);
    UpdateObject::new(name, format, machine, &tree, triangles, vertices).unwrap()
}

/// The merge distance of a machine is the minimum: a program compiled for one less reads a register
/// too early, and the result differs.
#[test]
fn a_merge_that_comes_too_soon_is_a_mismatch() {
    let seed = seed();
    for config in [vec![Config::reference()], others()].concat() {
        // A strip in which every box extends beyond the previous ones.
        let steps = (0..14).map(|k| (f64::from(k % 4) + 4.0) * f64::from(1 << (k / 4)) / 4.0);
        let vertices: Vec<[f64; 3]> = steps.map(|x| [x, x, -x]).collect();
        let triangles: Vec<[u32; 3]> = (0..12).map(|k| [k, k + 1, k + 2]).collect();
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        let tree = build(&vertices, &triangles, &options).unwrap();
        let machine = machine(&config).unwrap();
        let mismatches = |merge_distance| {
            let machine = UpdateMachine {
                merge_distance,
                ..machine
            };
            let format = config.format();
            let object =
                UpdateObject::new("strip", format, machine, &tree, &triangles, &vertices).unwrap();
            let options = UnitOptions {
                surroundings: Some(Surroundings::steady(1)),
                ..UnitOptions::new(seed)
            };
            let workload = Workload::Objects(std::slice::from_ref(&object));
            let report = run(&config, workload, Traffic::Separate, &options).unwrap();
            assert_eq!(
                report.unit.mismatches,
                report.unit.mismatch.iter().count() as u64
            );
            report.unit.mismatches
        };
        assert_eq!(mismatches(machine.merge_distance), 0, "{}", config.name);
        assert_eq!(mismatches(machine.merge_distance - 1), 1, "{}", config.name);
    }
}

/// Scenes with one memory of 16 bytes per cycle behind all ports and a latency of 8 cycles.
fn at_full_pace(scenes: &[String]) -> Vec<UpdateFigures> {
    let (config, seed) = (Config::reference(), seed());
    let objects: Vec<_> = scenes.iter().map(|name| object(&config, name)).collect();
    let options = UnitOptions {
        surroundings: Some(Surroundings::steady(8)),
        ..UnitOptions::new(seed)
    };
    let workload = Workload::Objects(&objects);
    let report = check(&config, workload, Traffic::Shared, &options);
    for figures in &report.objects {
        if figures.triangles >= 10_000 {
            assert!(
                figures.instructions_per_clock() >= 0.95,
                "{}",
                figures.summary()
            );
        }
    }
    report.objects
}

#[test]
fn scenes_at_full_pace() {
    let closed = ["builtin:knot", "builtin:sphere?level=5"].map(str::to_string);
    let open = ["builtin:cornell", "builtin:teapot", "builtin:interior"].map(str::to_string);
    let files = [
        "stanford_bunny/stanford-bunny.obj",
        "spot/spot.obj",
        "teapot/teapot.obj",
    ];
    let files = files.into_iter().filter_map(shared_scene);
    let scenes: Vec<_> = closed.into_iter().chain(open).chain(files).collect();
    let figures = at_full_pace(&scenes);
    for figures in &figures[..2] {
        assert!(figures.triangles >= 10_000);
        let pace = figures.triangles_per_clock();
        assert!(pace >= 0.37, "{}", figures.summary());
    }
}
