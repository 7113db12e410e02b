//! The units of the chip, each alone, and the whole chip.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test cosim chip::` replays them. With `DYNRT_FULL=1` the units have a million
//! transactions each.

use crate::support::{full, seed};
use dynrt::config::Config;
use dynrt::cosim::scoreboard::UnitOptions;
use dynrt::cosim::unit_cast;

/// The reference with some keys changed.
fn variant(keys: &[(&str, &str)]) -> Config {
    let mut config = Config::reference();
    for (key, value) in keys {
        config.set(key, value).unwrap();
        config.name += &format!(", {key} = {value}");
    }
    config
}

/// Rays of random casts with random neighbours: formats of every record size, packets of every number of rays, and tags so short that a
/// cast is never longer than the open words of answers.
#[test]
fn casts_read_rays_and_write_hits() {
    let rays = if full() { 1_000_000 } else { 20_000 };
    let configs = [
        variant(&[]),
        variant(&[
            ("packets.rays", "1"),
            ("packets.tag_bits", "7"),
            ("float.exponent_bits", "10"),
            ("float.fraction_bits", "23"),
        ]),
        variant(&[
            ("packets.rays", "8"),
            ("float.exponent_bits", "8"),
            ("float.fraction_bits", "23"),
        ]),
        variant(&[
            ("packets.rays", "2"),
            ("packets.tag_bits", "32"),
            ("float.exponent_bits", "3"),
            ("float.fraction_bits", "2"),
        ]),
    ];
    for (number, config) in configs.iter().enumerate() {
        let report = unit_cast::run(config, rays, &UnitOptions::new(seed())).unwrap();
        println!("{}: {}", config.name, report.summary());
        report.verdict().unwrap_or_else(|error| panic!("{error}"));
        assert!(report.transactions >= rays);
        for (category, count) in report.categories.iter().filter(|_| number == 0) {
            assert!(*count > 0, "no {}", category.name());
        }
    }
}
