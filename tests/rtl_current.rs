//! `rtl/` holds the reference machine as the program generates it.

use dynrt::config::Config;
use dynrt::emit;
use std::collections::BTreeSet;
use std::fs;
use std::path::Path;

const REFRESH: &str = "refresh it with: make rtl";

#[test]
fn the_checked_in_machine_is_what_is_generated() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("rtl");
    let (_, files) = emit::generate(&Config::reference()).unwrap();
    assert!(files.len() > 5);
    let mut present = BTreeSet::new();
    for within in ["", "sim/"] {
        let entries = fs::read_dir(folder.join(within))
            .unwrap_or_else(|error| panic!("rtl/{within}: {error}; {REFRESH}"));
        for entry in entries {
            let entry = entry.unwrap();
            if entry.file_type().unwrap().is_file() {
                let name = entry.file_name().into_string().unwrap();
                present.insert(format!("{within}{name}"));
            }
        }
    }
    let generated: BTreeSet<String> = files.iter().map(|(name, _)| name.clone()).collect();
    let missing: Vec<_> = generated.difference(&present).collect();
    let stale: Vec<_> = present.difference(&generated).collect();
    assert!(
        missing.is_empty() && stale.is_empty(),
        "rtl/ lacks {missing:?} and has {stale:?} too many; {REFRESH}"
    );
    for (name, text) in &files {
        let held = fs::read_to_string(folder.join(name)).unwrap();
        if held != *text {
            let pairs = held.lines().zip(text.lines());
            let line = pairs.take_while(|(a, b)| a == b).count() + 1;
            panic!("rtl/{name} differs from what is generated, from line {line} on; {REFRESH}");
        }
    }
}

/// Every name in the Verilog is one that the description gives, or follows from one: of a port, a field, a register, a memory.
#[test]
fn no_name_is_made_up() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("configs");
    let mut made_up = vec![];
    let mut checked = vec![];
    for entry in fs::read_dir(folder).unwrap() {
        let path = entry.unwrap().path();
        let config = Config::load(&path).unwrap();
        let (machine, _) = emit::generate(&config).unwrap();
        let mut signals = 0;
        for module in machine.design.modules() {
            signals += module.signal_count();
            made_up.extend(module.made_up_names().map(|(name, place)| {
                let config = path.file_stem().unwrap().to_string_lossy();
                format!("{config}: {} {name}, made at {place}", module.name())
            }));
        }
        assert!(signals > 1000, "{}: {signals} signals", path.display());
        checked.push(signals);
    }
    assert!(checked.len() >= 4, "{checked:?}");
    println!("signals checked: {checked:?}");
    assert!(made_up.is_empty(), "{}", made_up.join("\n"));
}
