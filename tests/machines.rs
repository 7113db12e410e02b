//! Machines of other configurations: each is emitted, linted by three tools and co-simulated on a small scene, with
//! memories and stalls that come and go at random.

mod common;

use common::{prepare, shadow_rays};
use dynrt::config::{Config, TriangleTest};
use dynrt::cosim::raycast::{Options, run};
use dynrt::{cosim, hw};

/// Emits, lints and runs a machine. Returns how much was checked.
fn whole(config: &Config, scene: &str, seed: u64) -> u64 {
    let machine = hw::core::emit(config).unwrap_or_else(|e| panic!("{}: {e}", config.name));
    cosim::model::lint(&cosim::sources(&machine.design))
        .unwrap_or_else(|e| panic!("{}: {e:#}", config.name));
    let prepared = prepare(config, scene, "37x25", None);
    let mut rays = prepared.rays.clone();
    rays.extend(shadow_rays(config, &prepared));
    let options = Options {
        seed,
        ray_stall: 0.2,
        hit_stall: 0.3,
        ..Options::default()
    };
    let report = run(config, &prepared.image, &rays, &options, &|_| ()).unwrap_or_else(|e| {
        panic!(
            "{} (seed {seed}):\n{}\n{e:#}",
            config.name,
            config.to_toml()
        )
    });
    println!(
        "{}: {} rays, {} packet steps, {} tests agree in all bits",
        config.name, report.hits_checked, report.steps_checked, report.tests_checked
    );
    assert!(report.hits_checked == rays.len() as u64 && report.steps_checked > 0);
    report.checked()
}

fn variant(name: &str, edit: impl FnOnce(&mut Config)) -> Config {
    let mut config = Config::reference();
    config.name = name.to_string();
    config.memory_latency = 13;
    config.memory_jitter = 20;
    config.memory_in_order = false;
    config.memory_ready_percent = 70;
    edit(&mut config);
    config
}

#[test]
fn named_configurations() {
    for name in ["virtex4-lx160", "dynrt-2006", "ecp5-85f", "tiny"] {
        whole(
            &Config::load(name).unwrap(),
            "builtin:teapot?tessellation=4",
            1,
        );
    }
}

#[test]
fn configurations_that_differ_most() {
    let variants = [
        variant("1 ray a packet", |c| c.rays_per_packet = 1),
        variant("2 rays a packet", |c| c.rays_per_packet = 2),
        variant("8 rays a packet", |c| c.rays_per_packet = 8),
        variant("8 exponent, 23 fraction bits", |c| {
            c.exponent_bits = 8;
            c.fraction_bits = 23;
        }),
        variant("133 MHz", |c| c.clock_mhz = 133),
        variant("Moller-Trumbore", |c| {
            c.triangle_test = TriangleTest::MollerTrumbore
        }),
        variant("one axis, 64 packets", |c| {
            c.axes_per_node = 1;
            c.packets_in_flight = 64;
        }),
        variant("25 MHz, 5 packets", |c| {
            c.clock_mhz = 25;
            c.packets_in_flight = 5;
        }),
    ];
    let checked: u64 = variants
        .iter()
        .map(|config| whole(config, "builtin:teapot?tessellation=3", 7))
        .sum();
    assert!(checked > 0);
}

#[test]
fn random_machines() {
    let seed = std::env::var("DYNRT_SEED").map_or_else(
        |_| fastrand::u64(..1 << 32),
        |seed| seed.parse().expect("DYNRT_SEED is a number"),
    );
    let machines = if std::env::var_os("DYNRT_FULL").is_some() {
        40
    } else {
        3
    };
    println!("random machines: DYNRT_SEED={seed} replays them");
    for i in 0..machines {
        // 240 triangles: what 8 address bits name and 8 stack entries reach.
        let config = Config::random(seed.wrapping_add(i));
        whole(&config, "builtin:teapot?tessellation=2", seed);
    }
}
