//! The memory system: every burst, every byte and every event against a model in Rust, in front of an AXI4 slave that does whatever the
//! protocol allows, with the protocol monitor beside the master. Every rule of the monitor finds a seeded fault.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test cosim bus::` replays them.

use crate::support::{full, seed};
use dynrt::cosim::axi::Fault;
use dynrt::cosim::model;
use dynrt::cosim::scoreboard::{Category, Mutated, SELECT, UnitOptions, UnitReport};
use dynrt::cosim::unit_axi::{self, Checks, run_checked};
use dynrt::cosim::unit_bus;
use dynrt::hdl::{Bundle as _, Design, HdlError, Module, Mutation, Select};
use dynrt::hw::memory::axi::monitor::{self, Sizes};
use dynrt::hw::memory::axi::{self, Bus, monitored};
use std::collections::BTreeSet;
use std::sync::Arc;

/// The widths of the data.
const WIDTHS: [u32; 4] = [32, 64, 128, 256];

/// Bursts of all widths together, and of a short run.
const MANY: u64 = 1_000_000;
const FEW: u64 = 20_000;

fn bursts() -> u64 {
    if full() { MANY } else { FEW }
}

/// Shows what came of a run; every category must have been met.
fn check(name: &str, report: anyhow::Result<UnitReport>) -> UnitReport {
    let report = report.unwrap_or_else(|error| panic!("{error:#}"));
    println!("{name}: {}", report.summary());
    report.verdict().unwrap_or_else(|error| panic!("{error:#}"));
    for (category, count) in &report.categories {
        assert!(*count > 0, "{name}: no {}", category.name());
    }
    report
}

#[test]
fn the_master_in_front_of_any_slave() {
    let seed = seed();
    for data_bits in WIDTHS {
        let bus = Bus {
            data_bits,
            ..unit_axi::reference()
        };
        let name = format!("{data_bits} bits");
        let least = bursts() / WIDTHS.len() as u64;
        let report = check(&name, unit_axi::run(&bus, least, &UnitOptions::new(seed)));
        assert!(report.transactions >= least);
    }
}

#[test]
fn the_memory_system_in_front_of_any_slave() {
    let seed = seed();
    let reference = unit_bus::Sizes::reference();
    let others = unit_bus::Sizes {
        lines: 3,
        words: 8,
        reads: 1,
        writes: 1,
        ..reference
    };
    let of_width = WIDTHS.map(|data_bits| unit_bus::Sizes {
        data_bits,
        ..reference
    });
    for sizes in of_width.into_iter().chain([others]) {
        let least = bursts() / WIDTHS.len() as u64;
        let options = UnitOptions::new(seed);
        let report = unit_bus::run(&sizes, least, &options);
        let report = report.unwrap_or_else(|error| panic!("{error:#}"));
        println!("{sizes:?}: {}", report.summary());
        report.verdict().unwrap_or_else(|error| panic!("{error:#}"));
        for (category, count) in &report.categories {
            // With one read outstanding, no beat overtakes another.
            let possible = match category {
                Category::Overtaking | Category::Interleaved => sizes.reads > 1,
                _ => true,
            };
            assert!(*count > 0 || !possible, "no {}", category.name());
        }
    }
}

/// A rule, and the change of the master or the fault of the slave that violates it.
type Seeded = (&'static str, Option<Mutation>, Option<Fault>);

/// For every rule, the faults of the master or of the slave that it finds.
fn faults(master: &Module) -> Result<Vec<Seeded>, HdlError> {
    let signal = |name: &str| master.signal(name);
    let reads = |name: &str, other: &str| -> Result<_, HdlError> {
        Ok(signal(name)?.reads(signal(other)?))
    };
    let of_master = [
        (
            "stable_aw",
            reads("write_offered", "m_axi_awready")?.as_value(1),
        ),
        ("stable_w", reads("datum_room", "m_axi_wready")?.as_value(1)),
        (
            "stable_ar",
            reads("read_offered", "m_axi_arready")?.as_value(1),
        ),
        (
            "boundary_aw",
            signal("m_axi_awaddr")?.fault().with_flipped(0x800),
        ),
        (
            "boundary_ar",
            signal("m_axi_araddr")?.fault().with_flipped(0x800),
        ),
        ("size_aw", signal("m_axi_awsize")?.fault().with_flipped(1)),
        ("size_aw", signal("m_axi_awaddr")?.fault().with_flipped(1)),
        ("size_ar", signal("m_axi_arburst")?.fault().with_flipped(3)),
        ("last_w", signal("m_axi_wlast")?.fault().inverted()),
        ("early_w", signal("m_axi_awvalid")?.fault().as_value(0)),
        (
            "bound_r",
            reads("reads_outstanding_room", "read_ends")?.as_value(1),
        ),
        (
            "bound_w",
            reads("writes_outstanding_room", "written_q")?.as_value(1),
        ),
    ];
    // A slave in front of a ready that is always high has no chance to change its offer.
    let of_both = [
        (
            "stable_r",
            signal("m_axi_rready")?
                .fault()
                .as_signal(signal("read_valid")?),
        ),
        (
            "stable_b",
            signal("m_axi_bready")?
                .fault()
                .as_signal(signal("read_valid")?),
        ),
    ];
    let of_slave = [
        ("last_r", Fault::EarlyLast),
        ("last_r", Fault::LateLast),
        ("id_r", Fault::StrangeBeat),
        ("id_b", Fault::StrangeResponse),
        ("progress", Fault::Deaf),
        ("progress", Fault::Silent),
    ];
    let of_master = of_master.map(|(rule, change)| (rule, Some(change), None));
    let of_both = of_both.map(|(rule, change)| (rule, Some(change), Some(Fault::Restless)));
    let of_slave = of_slave.map(|(rule, fault)| (rule, None, Some(fault)));
    let all = of_master.into_iter().chain(of_both).chain(of_slave);
    Ok(all.collect())
}

#[test]
fn every_rule_of_the_monitor_finds_a_fault() {
    let (bus, seed) = (unit_axi::reference(), seed());
    let design = Design::new(unit_axi::module_of(&bus).unwrap()).unwrap();
    let faults = faults(design.module("axi_master").unwrap()).unwrap();
    // All in one model, which is built once.
    let changes: Vec<_> = (1u32..)
        .zip(&faults)
        .filter_map(|(number, (_, change, _))| Some((number, change.as_ref()?)))
        .collect();
    let design = design.apart().unwrap();
    let design = design.selectable(&changes, Select::Port(SELECT)).unwrap();
    let design = Arc::new(design);
    let mut found = BTreeSet::new();
    for (number, (rule, _, of_slave)) in (1u32..).zip(&faults) {
        let options = UnitOptions {
            mutated: Some(Mutated {
                design: design.clone(),
                selected: number,
            }),
            ..UnitOptions::new(seed)
        };
        let report = run_checked(&bus, FEW, Checks::Monitor(*of_slave), &options);
        let report = report.unwrap_or_else(|error| panic!("{rule}: {error:#}"));
        let said = report.mismatch.unwrap_or_default();
        println!("{rule}, {of_slave:?}: {said}");
        assert!(
            said.contains("the monitor reports") && said.contains(rule),
            "{rule}"
        );
        found.insert(*rule);
    }
    let rules = monitor::Rules::of().fields();
    let rules: BTreeSet<&str> = rules.iter().map(|(name, _)| name.as_str()).collect();
    assert_eq!(found, rules);
}

#[test]
fn the_verilog_is_clean_at_every_width() {
    for data_bits in WIDTHS {
        let bus = Bus {
            data_bits,
            ..unit_axi::reference()
        };
        let sizes = Sizes {
            bus,
            patience: 1000,
        };
        let system = unit_bus::Sizes {
            data_bits,
            ..unit_bus::Sizes::reference()
        };
        let modules = [
            axi::module(&bus).unwrap(),
            monitor::module(&sizes).unwrap(),
            monitored::module(&sizes).unwrap(),
            unit_bus::module(&system).unwrap(),
        ];
        for module in modules {
            let design = Design::new(module).unwrap();
            for module in design.modules() {
                let made_up: Vec<_> = module.made_up_names().collect();
                assert!(made_up.is_empty(), "{}: {made_up:?}", module.name());
            }
            model::lint(&model::Sources::of(&design))
                .unwrap_or_else(|error| panic!("{data_bits} bits: {error:#}"));
        }
    }
}
