//! Whole frames in the RTL of the reference machine: every packet step, every ray–triangle test and every hit
//! equals the golden model's in all bits.

use crate::support::{Prepared, prepare, shadow_rays, shared_scene};
use dynrt::config::Config;
use dynrt::cosim::raycast::{Options, Report, run};
use dynrt::port::Ray;
use dynrt::scene::View;

fn check(config: &Config, what: &str, prepared: &Prepared, rays: &[Ray]) -> Report {
    let report = run(config, &prepared.image, rays, &Options::default(), &|_| ())
        .unwrap_or_else(|e| panic!("{what}: {e:#}"));
    let hits = report.hits.iter().filter(|hit| hit.is_hit()).count();
    println!(
        "{what}: {} rays, {hits} hits; {} hits, {} packet steps and {} tests agree in all bits; \
         {} cycles, {:.4} rays a clock, TPU {:.3}, GU {:.3}",
        rays.len(),
        report.hits_checked,
        report.steps_checked,
        report.tests_checked,
        report.cycles,
        report.rays_per_clock(),
        report.tpu_utilisation(),
        report.gu_utilisation()
    );
    assert_eq!(
        report.hits_checked,
        rays.len() as u64,
        "every ray's hit is checked"
    );
    assert!(hits > 0 && report.steps_checked > 0 && report.tests_checked > 0);
    report
}

fn frame(scene: &str, view: Option<View>) -> Report {
    let config = Config::reference();
    let prepared = prepare(&config, scene, "512x384", view);
    check(&config, scene, &prepared, &prepared.rays)
}

#[test]
fn teapot() {
    frame("builtin:teapot", None);
}

#[test]
fn interior_and_its_shadows() {
    let config = Config::reference();
    let prepared = prepare(&config, "builtin:interior", "512x384", Some(View::Inside));
    check(&config, "builtin:interior", &prepared, &prepared.rays);
    let shadows = shadow_rays(&config, &prepared);
    assert!(
        shadows
            .iter()
            .any(|ray| ray.any_hit && ray.tmax.is_finite())
    );
    check(
        &config,
        "builtin:interior, shadow rays",
        &prepared,
        &shadows,
    );
}

#[test]
fn shared_scenes() {
    for (file, view, least_tpu) in [
        ("teapot/teapot.obj", View::Outside, 0.0),
        ("stanford_bunny/stanford-bunny.obj", View::Outside, 0.0),
        ("kitchen/kitchen.obj", View::Inside, 0.0),
        // 48 packets in flight and a read latency of 8 keep the traversal unit busy.
        ("sponza/sponza.obj", View::Inside, 0.9),
    ] {
        let Some(scene) = shared_scene(file) else {
            continue;
        };
        let report = frame(&scene, Some(view));
        assert!(
            report.tpu_utilisation() >= least_tpu,
            "{file}: {} packet steps a clock, not {least_tpu}",
            report.tpu_utilisation()
        );
    }
}
