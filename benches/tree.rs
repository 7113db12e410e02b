//! Tree construction in its default and simpler forms, and refit, on one core. The items of the report are triangles.

mod common;

use common::{Subject, subjects};
use divan::Bencher;
use divan::counter::ItemsCount;
use dynrt::bkd::{self, BuildOptions};
use dynrt::config::Config;

fn main() {
    divan::main();
}

fn build(bencher: Bencher, subject: &Subject, options: impl Fn(&Config) -> BuildOptions) {
    let config = Config::reference();
    let mesh = subject.mesh(&config);
    let options = options(&config);
    bencher
        .counter(ItemsCount::new(mesh.triangles.len()))
        .bench_local(|| bkd::build(&mesh.vertices, &mesh.triangles, &options).expect("a tree"));
}

/// The region cost with three sort keys, on the axes of the reference machine.
#[divan::bench(args = subjects(), sample_count = 5, sample_size = 1)]
fn build_default(bencher: Bencher, subject: &Subject) {
    build(bencher, subject, |config| {
        BuildOptions::default_for(config.axes_per_node, config.stack_depth)
    });
}

/// The region cost, sorted by centre, on one axis.
#[divan::bench(args = subjects(), sample_count = 5, sample_size = 1)]
fn build_region(bencher: Bencher, subject: &Subject) {
    build(bencher, subject, |config| {
        BuildOptions::region(config.stack_depth)
    });
}

/// The classical surface area heuristic.
#[divan::bench(args = subjects(), sample_count = 5, sample_size = 1)]
fn build_plain(bencher: Bencher, subject: &Subject) {
    build(bencher, subject, |config| {
        BuildOptions::plain(config.stack_depth)
    });
}

/// New bounds for an unchanged topology.
#[divan::bench(args = subjects(), sample_count = 10, sample_size = 1)]
fn refit(bencher: Bencher, subject: &Subject) {
    let config = Config::reference();
    let mesh = subject.mesh(&config);
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    let tree = bkd::build(&mesh.vertices, &mesh.triangles, &options).expect("a tree");
    bencher
        .counter(ItemsCount::new(mesh.triangles.len()))
        .bench_local(|| tree.refit(&mesh.vertices, &mesh.triangles));
}
