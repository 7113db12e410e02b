//! The quick part of `dynrt prove`, and that a fault planted in the emitted Verilog makes each proof fail.
//!
//! `dynrt prove` and `dynrt prove --plant` are the whole.

use dynrt::config::Config;
use dynrt::prove::{self, Options, Outcome, Row};

/// The machine that is proved. The sums are proved in a smaller format: they then take seconds with all of their cases.
fn machine(settings: &[(&str, &str)]) -> Config {
    let mut config = Config::load("virtex4-lx160").expect("a named configuration");
    for (key, value) in settings {
        config
            .set(key, value)
            .unwrap_or_else(|error| panic!("{error:#}"));
    }
    config
}

fn rows(config: &Config, units: &[&str], quick: bool, plant: bool) -> Vec<Row> {
    let units = units.iter().map(|unit| unit.to_string()).collect();
    let options = Options {
        units,
        quick,
        plant,
    };
    let mut told = 0;
    let rows = prove::run(config, &options, &|_| (), &mut |row| {
        told += 1;
        println!("{row:?}");
    })
    .unwrap_or_else(|error| panic!("{error:#}"));
    assert_eq!(told, rows.len());
    rows
}

/// Every proof ends as it should, and each has proved something.
fn hold(rows: &[Row], least: usize) {
    assert!(rows.len() >= least, "{} rows", rows.len());
    for row in rows {
        assert!(row.holds(), "{row:?}");
        match row.fault {
            None => assert!(row.cases > 0, "{row:?}"),
            // A counterexample is one line, and not empty.
            Some(_) => match &row.outcome {
                Outcome::Refuted(text) => assert!(!text.is_empty() && text.lines().count() == 1),
                _ => panic!("{row:?}"),
            },
        }
    }
}

const SMALL: &[(&str, &str)] = &[("float.exponent_bits", "4"), ("float.fraction_bits", "5")];

/// A machine whose control is the reference's, with few packets and small numbers.
fn few_packets() -> Config {
    machine(&[SMALL, &[("packets.in_flight", "4")]].concat())
}

/// `dynrt prove --quick`.
#[test]
fn the_quick_part_of_the_reference_machine() {
    hold(&rows(&machine(&[]), &[], true, false), 40);
}

#[test]
fn all_cases_of_a_small_format() {
    let units = ["add", "sub", "mul", "reciprocal", "compare", "step"];
    let rows = rows(&machine(SMALL), &units, false, false);
    hold(&rows, 15);
    let sums = rows
        .iter()
        .filter(|row| row.what.contains("of numbers, exact"));
    // Exponents of numbers are at most 2^4 - 3 apart.
    assert!(sums.map(|row| row.cases).eq([14, 14]));
}

#[test]
fn planted_faults_of_the_arithmetic_are_refuted() {
    let units = ["add", "sub", "mul", "reciprocal", "compare", "step"];
    let rows = rows(&machine(SMALL), &units, true, true);
    hold(&rows, 15);
    let example = rows
        .iter()
        .find(|row| row.unit == "mul")
        .expect("a fault of the multiplier");
    let Outcome::Refuted(text) = &example.outcome else {
        panic!("{example:?}")
    };
    assert!(
        text.contains("a = 0x") && text.contains("expected = 0x"),
        "{text}"
    );
}

#[test]
fn planted_faults_of_control_are_refuted() {
    let units = [
        "slots", "fifo", "prefetch", "credit", "skin", "geometry", "tpu", "stack", "share",
    ];
    hold(&rows(&few_packets(), &units, true, true), 42);
}

#[test]
fn a_unit_that_does_not_exist_is_named() {
    let options = Options {
        units: vec!["adder".into()],
        ..Options::default()
    };
    let error = prove::run(&machine(&[]), &options, &|_| (), &mut |_| ()).unwrap_err();
    let text = format!("{error:#}");
    assert!(
        text.starts_with("adder: nothing of this name") && text.contains("add, sub"),
        "{text}"
    );
    assert_eq!(text.lines().count(), 1);
}
