//! Upgrade of configuration files, manual pages, completions.

use super::{contents, fault, folder, prints};
use dynrt::config::{Config, KEYS};
use std::fs;

#[test]
fn a_configuration_is_upgraded_in_place() {
    let folder = folder();
    let file = folder.path().join("machine.toml");
    let whole = Config::load("dynrt-2006").unwrap().to_toml();
    let old: String = whole
        .replace("rays = 4\n", "rays = 4 # as in 2006\n")
        .split_inclusive('\n')
        .filter(|line| !line.starts_with("tag_bits") && !line.starts_with("order"))
        .collect();
    fs::write(&file, format!("# mine\n{old}")).unwrap();
    let line = fault("stats builtin:cornell --config machine.toml", folder.path());
    assert!(
        line.starts_with("machine.toml: key packets.tag_bits is missing (tag of ")
            && line.ends_with(
                "add the line `tag_bits = 16` below [packets], or run dynrt config upgrade machine.toml, \
                 which adds all 2 that are missing"
            ),
        "{line}"
    );
    assert_eq!(
        prints("config upgrade machine.toml", folder.path()),
        "machine.toml: added packets.tag_bits, memory.order\n"
    );
    let text = fs::read_to_string(&file).unwrap();
    assert!(
        text.starts_with("# mine\n") && text.contains("rays = 4 # as in 2006\n"),
        "{text}"
    );
    let mut lines = text.lines();
    assert!(
        old.lines().all(|old| lines.any(|line| line == old)),
        "{text}"
    );
    let (upgraded, reference) = (Config::load(&file).unwrap(), Config::reference());
    let original = Config::load("dynrt-2006").unwrap();
    for key in KEYS {
        let is_added = ["packets.tag_bits", "memory.order"].contains(&key.path().as_str());
        let expected = if is_added { &reference } else { &original };
        assert_eq!(key.value(&upgraded), key.value(expected), "{}", key.path());
    }
    assert_eq!(
        prints("config upgrade machine.toml", folder.path()),
        "machine.toml: has every key; nothing to add\n"
    );
    assert_eq!(fs::read_to_string(&file).unwrap(), text);
    prints(
        "stats builtin:cornell --size 8x8 --config machine.toml",
        folder.path(),
    );
}

#[test]
fn a_configuration_that_cannot_be_upgraded_stays() {
    let folder = folder();
    fs::write(folder.path().join("faulty.toml"), "[packets]\nrays = 3\n").unwrap();
    fs::write(folder.path().join("bytes.toml"), b"[packets]\n# \xff\n").unwrap();
    for (file, expected) in [
        (
            "faulty.toml",
            "faulty.toml:2: packets.rays = 3 is out of range: use 1, 2, 4, 8",
        ),
        (
            "bytes.toml",
            "bytes.toml:2: is not UTF-8; save the file as UTF-8",
        ),
        (
            ".",
            ".: is not a regular file; give a configuration's name or a TOML file",
        ),
    ] {
        assert_eq!(
            fault(&format!("config upgrade {file}"), folder.path()),
            expected
        );
    }
    assert_eq!(
        fault("config upgrade tiny", folder.path()),
        "tiny: no such file; give a configuration's TOML file"
    );
}

#[cfg(unix)]
#[test]
fn an_upgraded_configuration_keeps_its_link_and_who_may_read_it() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    fs::write(at("real.toml"), "").unwrap();
    fs::set_permissions(at("real.toml"), fs::Permissions::from_mode(0o640)).unwrap();
    symlink("real.toml", at("link.toml")).unwrap();
    prints("config upgrade link.toml", folder.path());
    assert!(fs::symlink_metadata(at("link.toml")).unwrap().is_symlink());
    let mode = fs::metadata(at("real.toml")).unwrap().permissions().mode();
    assert_eq!(mode & 0o777, 0o640);
    assert_eq!(
        fs::read_to_string(at("real.toml")).unwrap(),
        Config::reference().to_toml()
    );
}

/// The commands in the help text, by group.
fn commands(help: &str) -> Vec<(String, Vec<String>)> {
    let mut groups: Vec<(String, Vec<String>)> = vec![];
    for line in help.lines().take_while(|line| *line != "Options:") {
        match (line.strip_suffix(':'), line.strip_prefix("  ")) {
            (Some(heading), _) => groups.push((heading.into(), vec![])),
            (_, Some(command)) => {
                let name = command.split(' ').next().unwrap();
                groups.last_mut().unwrap().1.push(name.into());
            }
            _ => {}
        }
    }
    groups
}

#[test]
fn help_shows_commands_by_group() {
    let folder = folder();
    let groups = commands(&prints("--help", folder.path()));
    let of = |heading: &str| {
        let group = groups.iter().find(|(name, _)| name == heading);
        group
            .unwrap_or_else(|| panic!("{heading} in {groups:?}"))
            .1
            .clone()
    };
    assert_eq!(groups.len(), 3);
    for (heading, some) in [
        ("Use the machine", ["generate", "cosim", "render"]),
        ("Verify it", ["prove", "fuzz", "mutate"]),
        ("Maintain it", ["baseline", "numbers", "config"]),
    ] {
        let names = of(heading);
        assert!(
            some.iter().all(|name| names.iter().any(|n| n == name)),
            "{names:?}"
        );
    }
}

#[test]
fn manual_pages_cover_every_command_and_replace_only_their_own() {
    let folder = folder();
    let text = prints("man --out man", folder.path());
    let pages = contents(&folder.path().join("man"));
    assert_eq!(text, format!("man: {} manual pages\n", pages.len()));
    let page = |name: &str| String::from_utf8(pages[name].clone()).unwrap();
    let all = commands(&prints("--help", folder.path()));
    for name in all.iter().flat_map(|(_, names)| names) {
        assert!(
            page(&format!("dynrt-{name}.1")).contains(".SH EXAMPLES"),
            "{name}"
        );
    }
    assert!(page("dynrt-config-upgrade.1").contains("dynrt config upgrade machine.toml"));
    assert!(page("dynrt.1").starts_with(".ie"), "{}", page("dynrt.1"));
    // Lines of examples are not wrapped.
    assert!(page("dynrt-stats.1").contains(".nf\n"));
    prints("man --out man", folder.path());
    assert!(contents(&folder.path().join("man")) == pages);
    fs::write(folder.path().join("man/mine.1"), "mine").unwrap();
    assert_eq!(
        fault("man --out man", folder.path()),
        "man: holds mine.1 besides earlier manual pages; move it elsewhere, or name a new folder"
    );
}

#[test]
fn shells_get_completions() {
    let folder = folder();
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let text = prints(&format!("completions {shell}"), folder.path());
        for word in ["cosim", "heatmap", "upgrade", "completions"] {
            assert!(text.contains(word), "{shell}: {word}");
        }
    }
}
