//! The golden model: a picture's primary rays, on all cores and on one. The items of the report are rays.

mod common;

use common::{Subject, subjects};
use divan::Bencher;
use divan::counter::ItemsCount;
use dynrt::config::Config;
use dynrt::golden::Caster;
use dynrt::scene::ImageSize;

fn main() {
    divan::main();
}

fn cast(bencher: Bencher, subject: &Subject, threads: usize) {
    let config = Config::reference();
    let size = ImageSize::new(512, 384).expect("a size");
    let (image, rays) = subject.picture(&config, size);
    let caster = Caster::new(
        &image,
        config.triangle_test,
        config.rays_per_packet as usize,
    );
    // 0 stands for one thread per core.
    let pool = rayon::ThreadPoolBuilder::new()
        .num_threads(threads)
        .build()
        .expect("threads");
    bencher
        .counter(ItemsCount::new(rays.len()))
        .bench_local(|| pool.install(|| caster.cast_packets(&rays)));
}

#[divan::bench(args = subjects(), sample_count = 5, sample_size = 1)]
fn all_cores(bencher: Bencher, subject: &Subject) {
    cast(bencher, subject, 0);
}

#[divan::bench(args = subjects(), sample_count = 5, sample_size = 1)]
fn one_core(bencher: Bencher, subject: &Subject) {
    cast(bencher, subject, 1);
}
