//! The regression gate: the reference machine has the figures of `docs/baseline.json`, and the page of numbers is current.

use dynrt::baseline::{
    Baseline, Finding, Request, UnitClock, Verdict, compare, log_entry, measure, page,
};
use std::fs;
use std::path::{Path, PathBuf};

fn docs() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("docs")
}

fn checked_in() -> Baseline {
    Baseline::read(&docs().join("baseline.json")).unwrap_or_else(|error| panic!("{error:#}"))
}

fn failures(findings: &[Finding]) -> Vec<String> {
    let failed = findings.iter().filter(|f| f.verdict == Verdict::Fails);
    failed.map(ToString::to_string).collect()
}

/// Cycles are equal, and no smaller module that has changed takes more area. (`dynrt baseline --all --clock` checks the rest.)
#[test]
fn nothing_has_become_worse() {
    let was = checked_in();
    assert!(!was.frames.is_empty() && !was.films.is_empty() && was.area.len() > 20);
    let request = Request {
        most_lut4: Some(6000),
        ..Request::default()
    };
    let (is, kept) = measure(&was, &request, &|line| println!("{line}"))
        .unwrap_or_else(|error| panic!("{error:#}"));
    let findings = compare(&was, &is, &kept);
    println!("{} figures compared, {} kept", findings.len(), kept.len());
    assert!(findings.len() > 100);
    let failed = failures(&findings);
    assert!(
        failed.is_empty(),
        "{failed:#?}\nif that is meant: dynrt baseline --accept WHY, then make numbers"
    );
}

#[test]
fn the_page_of_numbers_is_current() {
    let files = page::files(&checked_in()).unwrap();
    assert_eq!(files.len(), 5);
    for (name, text) in files {
        let held = fs::read_to_string(docs().join(&name)).unwrap_or_default();
        assert!(
            held == text,
            "docs/{name} is not what is generated; refresh it with: make numbers"
        );
    }
}

/// Each kind of regression is detected, and permitted changes are accepted.
#[test]
fn losses_are_noticed() {
    let mut was = checked_in();
    was.clock = vec![UnitClock {
        name: "a_unit".into(),
        verilog: String::new(),
        mhz: 104.0,
        critical_path: "a → b".into(),
    }];
    was.fast_clock = vec![UnitClock {
        mhz: 130.0,
        ..was.clock[0].clone()
    }];
    assert!(failures(&compare(&was, &was, &[])).is_empty());
    type Edit = fn(&mut Baseline);
    let losses: [(&str, Edit); 27] = [
        ("cycles", |b| b.frames[0].cycles += 1),
        ("cycles", |b| b.frames[0].cycles -= 1),
        ("tpu_utilisation", |b| b.frames[1].tpu_utilisation -= 1e-4),
        ("update_cycles", |b| b.films[0].update_cycles += 1),
        ("skinning_cycles", |b| b.films[0].skinning_cycles += 1),
        ("nothing", |b| drop(b.frames.remove(0))),
        ("ecp5-85f, builtin:teapot framing 256x192: cycles", |b| {
            b.fast_frames[0].cycles += 1;
        }),
        (
            "ecp5-85f, builtin:figure 3 frames 256x192: update_cycles",
            |b| {
                b.fast_films[0].update_cycles -= 1;
            },
        ),
        ("diffuse rays, ddr-virtex4, 32/4/8 KiB: cycles", |b| {
            b.chip_frames[2].cycles += 1;
        }),
        ("node_hit_rate", |b| b.chip_caches[3].node_hit_rate -= 1e-4),
        ("bytes_read", |b| b.chip_memories[0].bytes_read += 16),
        ("lut4", |b| {
            let lut4 = &mut b.area.last_mut().unwrap().area.lut4;
            *lut4 += *lut4 / 90;
        }),
        ("dsp", |b| b.area.last_mut().unwrap().area.dsp += 1),
        ("ram", |b| b.area.last_mut().unwrap().area.ram += 2),
        ("nothing", |b| drop(b.area.pop())),
        ("new", |b| b.area[0].name += "_2"),
        ("mhz", |b| b.clock[0].mhz *= 0.96),
        ("mhz", |b| b.fast_clock[0].mhz *= 0.96),
        ("depth", |b| b.depths[0].depth += 1),
        ("mhz", |b| b.depths[0].mhz *= 0.96),
        ("lut4", |b| b.depths[0].area.lut4 *= 2),
        // The goals, each alone.
        ("at least 100 MHz → 99.0 MHz", |b| b.clock[0].mhz = 99.0),
        ("at least 125 MHz → 124.0 MHz", |b| {
            b.fast_clock[0].mhz = 124.0;
        }),
        ("at least 150 MHz → 149.0 MHz", |b| {
            b.depths.last_mut().unwrap().mhz = 149.0;
        }),
        ("at most 35 %", |b| {
            b.area.last_mut().unwrap().area.lut4 = 135_168 * 36 / 100;
        }),
        ("at most 40 %", |b| {
            b.area.last_mut().unwrap().area.ram = 116
        }),
        ("at most 55 %", |b| {
            b.chip_area.last_mut().unwrap().area.ram = 159
        }),
    ];
    for (what, edit) in losses {
        let mut is = was.clone();
        edit(&mut is);
        let failed = failures(&compare(&was, &is, &[]));
        assert!(
            failed.iter().any(|line| line.contains(what)),
            "{what}: {failed:?}"
        );
    }
    // A goal is independent of the previous figure.
    let mut slow = was.clone();
    slow.clock[0].mhz = 90.0;
    assert!(!failures(&compare(&slow, &slow, &[])).is_empty());
    let allowed: [Edit; 4] = [
        |b| {
            let lut4 = &mut b.area.last_mut().unwrap().area.lut4;
            *lut4 += *lut4 / 110;
        },
        |b| b.area.last_mut().unwrap().area.lut4 /= 2,
        |b| b.clock[0].mhz *= 0.98,
        |b| b.clock[0].mhz *= 1.5,
    ];
    for edit in allowed {
        let mut is = was.clone();
        edit(&mut is);
        let findings = compare(&was, &is, &[]);
        assert!(failures(&findings).is_empty());
        let entry = log_entry("a reason", &findings);
        assert!(
            entry.contains("## a reason") && entry.contains("→"),
            "{entry}"
        );
    }
}
