//! Co-simulation: pictures in the Verilog of the reference machine, with every step and test compared. The items of the report are
//! simulated cycles. The model is built first, unless it is in the cache; the build time is not measured.

mod common;

use common::{Subject, subjects};
use divan::Bencher;
use divan::counter::ItemsCount;
use dynrt::config::Config;
use dynrt::cosim::raycast::{Options, RaycastUnit};
use dynrt::scene::ImageSize;

fn main() {
    divan::main();
}

#[divan::bench(args = subjects(), sample_count = 3, sample_size = 1)]
fn raycast(bencher: Bencher, subject: &Subject) {
    let config = Config::reference();
    let size = ImageSize::new(128, 96).expect("a size");
    let (image, rays) = subject.picture(&config, size);
    let mut unit = RaycastUnit::new(&config, None).unwrap_or_else(|error| panic!("{error:#}"));
    let mut cast = || {
        let options = Options::default();
        unit.cast(&image, &rays, &options, &|_| ())
            .unwrap_or_else(|error| panic!("{error:#}"))
    };
    // Every run of a picture takes the same number of cycles.
    let clocks = cast().cycles;
    bencher.counter(ItemsCount::new(clocks)).bench_local(cast);
}
