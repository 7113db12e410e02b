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
