//! The command line: output files, and error messages for bad input.

mod films;
#[cfg(unix)]
mod interrupt;
mod maintain;
#[cfg(unix)]
mod names;
mod outputs;
#[path = "../support/mod.rs"]
mod support;

use dynrt::config::Config;
use dynrt::scene::builtin;
use serde_json::Value;
use std::collections::BTreeMap;
use std::fs;
use std::path::Path;
use std::process::{Command, Output, Stdio};
use support::command::dynrt;

fn run(arguments: &str, folder: &Path) -> Output {
    dynrt(arguments, folder).output().unwrap()
}

/// Runs a command that must succeed; returns its output.
fn prints(arguments: &str, folder: &Path) -> String {
    let Output {
        status,
        stdout,
        stderr,
    } = run(arguments, folder);
    let stderr = String::from_utf8(stderr).unwrap();
    assert!(status.success(), "dynrt {arguments}: {stderr}");
    assert_eq!(stderr, "", "dynrt {arguments} is quiet off a terminal");
    String::from_utf8(stdout).unwrap()
}

/// The error line, without `error: `, of a command that must fail and leave the folder unchanged.
fn fault_of(command: &mut Command) -> String {
    let folder = command.get_current_dir().unwrap().to_path_buf();
    let before = contents(&folder);
    let output = command.output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{command:?}: {stderr}");
    assert_eq!(output.stdout, b"", "{command:?} printed results");
    assert_eq!(stderr.lines().count(), 1, "{command:?}: {stderr}");
    assert!(!stderr.contains("panicked"), "{command:?}: {stderr}");
    assert!(
        contents(&folder) == before,
        "{command:?} left something behind"
    );
    let Some(line) = stderr.strip_prefix("error: ") else {
        panic!("{command:?}: {stderr}");
    };
    line.trim_end().to_string()
}

fn fault(arguments: &str, folder: &Path) -> String {
    fault_of(&mut dynrt(arguments, folder))
}

/// All files below a folder, by path.
fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        for entry in fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(folder).unwrap().display().to_string();
            if path.is_dir() {
                files.insert(format!("{name}/"), vec![]);
                open.push(path);
            } else {
                files.insert(name, fs::read(path).unwrap());
            }
        }
    }
    files
}

fn json(path: &Path) -> Value {
    serde_json::from_slice(&fs::read(path).unwrap()).unwrap()
}

fn folder() -> tempfile::TempDir {
    tempfile::tempdir().unwrap()
}

const SUBCOMMANDS_WITH_SCENES: [&str; 4] = [
    "cosim",
    "render --out a.png",
    "stats --json a.json",
    "vectors --out a",
];

#[test]
fn help_of_every_subcommand_has_examples() {
    let folder = folder();
    let top = prints("--help", folder.path());
    let commands = top.lines().take_while(|line| *line != "Options:");
    let names: Vec<&str> = commands
        .filter_map(|line| line.strip_prefix("  ")?.split(' ').next())
        .collect();
    assert!(names.len() >= 18, "{names:?} in {top}");
    for name in names {
        let help = prints(&format!("{name} --help"), folder.path());
        assert!(
            help.contains("Examples:\n") && help.contains(&format!("\n  dynrt {name} ")),
            "{help}"
        );
    }
}

#[test]
fn a_command_that_makes_no_sense_has_status_2() {
    let folder = folder();
    for arguments in [
        "",
        "nonesuch",
        "generate",
        "render",
        "render builtin:cornell --size 5",
        "render builtin:cornell --eye 1,2",
        "render builtin:cornell --look-at 0,0,0 --view outside",
        "render builtin:cornell --eye 1,2,3 --view inside",
        "cosim builtin:cornell --from 3",
    ] {
        let output = run(arguments, folder.path());
        let stderr = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "dynrt {arguments}: {stderr}");
    }
}

#[test]
fn scenes_that_cannot_be_used_get_one_line() {
    let folder = folder();
    let files = [
        ("empty.obj", "", "empty"),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n", "empty"),
        (
            "nan.obj",
            "v 0 0 0\nv 1 nan 0\nv 0 1 0\nf 1 2 3\n",
            "finite",
        ),
        (
            "inf.obj",
            "v 0 0 0\nv 1 inf 0\nv 0 1 0\nf 1 2 3\n",
            "finite",
        ),
        (
            "huge.obj",
            "v 0 0 0\nv 1 1e999 0\nv 0 1 0\nf 1 2 3\n",
            "finite",
        ),
        (
            "large.obj",
            "v 0 0 0\nv 1 1e300 0\nv 0 1 0\nf 1 2 3\n",
            "beyond the range of single precision: its y is 1e300",
        ),
        ("index.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 4\n", "range"),
        ("zero.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 0 1 2\n", "range"),
        ("text.obj", "This is a letter and no mesh.\n", "mesh"),
        ("picture.png", "\u{fffd}PNG\r\n\u{1a}\n\0\0\0", "mesh"),
    ];
    for (name, text, _) in files {
        fs::write(folder.path().join(name), text).unwrap();
    }
    fs::write(folder.path().join("bytes.obj"), [0xff, 0xfe, 0x00, 0x80]).unwrap();
    fs::create_dir(folder.path().join("folder")).unwrap();
    let missing = [("nonesuch.obj", "", "no such file")];
    let others = [("bytes.obj", "", "mesh"), ("folder", "", "folder")];
    for command in SUBCOMMANDS_WITH_SCENES {
        for (name, _, expected) in files.iter().chain(&missing).chain(&others) {
            let line = fault(&format!("{command} {name}"), folder.path());
            assert!(
                line.contains(name) && line.contains(expected),
                "{command} {name}, expecting `{expected}`: {line}"
            );
        }
        let line = fault(&format!("{command} builtin:nonesuch"), folder.path());
        assert!(
            line.starts_with("builtin:nonesuch: no such built-in scene"),
            "{line}"
        );
    }
}

#[test]
fn a_byte_order_mark_is_no_fault_and_flat_triangles_are_counted() {
    let folder = folder();
    fs::write(
        folder.path().join("marked.obj"),
        "\u{feff}v 0 0 0\nv 1 0 0\nv 0 1 0\nv 2 0 0\nf 1 2 3\nf 1 2 4\n",
    )
    .unwrap();
    let output = run("stats marked.obj --size 8x8", folder.path());
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{stderr}");
    assert_eq!(
        stderr,
        "warning: scene marked: 1 of 2 triangles have no area; remove them from the mesh, because they only cost time\n"
    );
}

#[test]
fn what_is_in_a_mesh_and_not_in_the_picture_is_told_once() {
    let folder = folder();
    fs::write(
        folder.path().join("tags.obj"),
        "v 0 0 0\nv 1 0 0\nv 0 1 0\nt crease 2/1/0 0 1 2.0\nvw 0 0 1.0\nf 1 2 3\n",
    )
    .unwrap();
    for command in [
        "stats tags.obj --size 8x8",
        "render tags.obj --size 8x8",
        "program tags.obj",
        "vectors tags.obj --size 8x8 --out v",
    ] {
        let output = run(command, folder.path());
        assert!(output.status.success(), "{command}");
        assert_eq!(
            String::from_utf8(output.stderr).unwrap(),
            "warning: tags.obj: 2 lines of unknown statements `t`, `vw` left out, first in line 4\n",
            "{command}"
        );
    }
}

#[cfg(unix)]
#[test]
fn what_is_no_regular_file_is_not_read() {
    let folder = folder();
    std::os::unix::fs::symlink("/dev/zero", folder.path().join("device.obj")).unwrap();
    let refused = |arguments: &str| {
        let output = run(arguments, folder.path());
        assert_eq!(output.status.code(), Some(1));
        String::from_utf8(output.stderr).unwrap()
    };
    assert_eq!(
        refused("stats device.obj"),
        "error: device.obj: is not a regular file; give an OBJ file or builtin:NAME\n"
    );
    for place in [".", "device.obj"] {
        assert_eq!(
            refused(&format!("stats builtin:cornell --config {place}")),
            format!(
                "error: {place}: is not a regular file; give a configuration's name or a TOML file\n"
            )
        );
    }
}

#[test]
fn a_scene_too_large_for_its_address_space_gets_one_line() {
    let folder = folder();
    for command in SUBCOMMANDS_WITH_SCENES {
        let line = fault(
            &format!("{command} builtin:teapot --config tiny"),
            folder.path(),
        );
        assert_eq!(
            line,
            "builtin:teapot, configuration tiny: the scene is too large for its address space: 6320 triangles, \
             but 12 address bits hold 4096; simplify the mesh or widen the address"
        );
    }
    // Few triangles, but each with its own vertices.
    let triangle = |i: usize| {
        let [a, b, c] = [3 * i + 1, 3 * i + 2, 3 * i + 3];
        format!("v {i} 0 0\nv {i} 1 0\nv {i} 0 1\nf {a} {b} {c}\n")
    };
    let text: String = (0..1366).map(triangle).collect();
    fs::write(folder.path().join("loose.obj"), text).unwrap();
    assert_eq!(
        fault("stats loose.obj --config tiny", folder.path()),
        "loose.obj, configuration tiny: the scene is too large for its address space: 4098 vertices, \
         but 12 address bits hold 4096; simplify the mesh or widen the address"
    );
}

#[test]
fn a_stack_too_shallow_gets_one_line() {
    let folder = folder();
    let line = fault(
        "stats builtin:cornell --set tree.stack_depth=7",
        folder.path(),
    );
    assert_eq!(
        line,
        "--set tree.stack_depth=7: tree.stack_depth = 7 is out of range: use 8 to 64"
    );
    let line = fault(
        "stats builtin:teapot --set tree.stack_depth=8",
        folder.path(),
    );
    assert!(
        line.contains("6320 triangles need a tree of depth 13"),
        "{line}"
    );
}

#[test]
fn configurations_that_cannot_be_used_get_one_line() {
    let folder = folder();
    let reference = Config::reference().to_toml();
    let files = [
        (
            "unknown.toml",
            reference.replace("in_flight", "in_fligth"),
            "unknown.toml:",
        ),
        (
            "range.toml",
            reference.replace("rays = 4", "rays = 3"),
            "range: use 1, 2, 4, 8",
        ),
        (
            "section.toml",
            reference.replace("[tree]", "[three]"),
            "unknown section [three]",
        ),
        (
            "missing.toml",
            reference.replace("rays = 4\n", ""),
            "packets.rays is missing",
        ),
        (
            "type.toml",
            reference.replace("rays = 4", "rays = \"4\""),
            "packets.rays",
        ),
        (
            "syntax.toml",
            reference.replace("rays = 4", "rays = "),
            "syntax.toml:",
        ),
    ];
    for (name, text, expected) in files {
        fs::write(folder.path().join(name), text).unwrap();
        for command in [
            "generate --out out",
            "cosim builtin:cornell",
            "render builtin:cornell",
        ] {
            let line = fault(&format!("{command} --config {name}"), folder.path());
            assert!(line.starts_with(name) && line.contains(expected), "{line}");
        }
    }
    for (options, expected) in [
        (
            "--config nonesuch",
            "nonesuch: no such configuration: name one of ",
        ),
        (
            "--set packets.rays=3",
            "--set packets.rays=3: packets.rays = 3 is out of range: ",
        ),
        (
            "--set packets.rays=x",
            "--set packets.rays=x: packets.rays = \"x\" is not a whole number: ",
        ),
        (
            "--set packets.ray=4",
            "--set packets.ray=4: unknown key packets.ray: there are ",
        ),
        (
            "--set packets.rays",
            "--set packets.rays: has no value; write ",
        ),
        (
            "--set clock.target_mhz=-1",
            "--set clock.target_mhz=-1: clock.target_mhz = -1 is out of range: ",
        ),
        (
            "--set clock.target_mhz=99999999999999999999",
            "--set clock.target_mhz=99999999999999999999: clock.target_mhz = \"99999999999999999999\" is out of range: ",
        ),
    ] {
        let line = fault(&format!("generate --out out {options}"), folder.path());
        assert!(line.starts_with(expected), "{line}");
    }
}

#[test]
fn cameras_that_see_nothing_get_one_line() {
    let folder = folder();
    let line = fault(
        "render builtin:cornell --eye 1,2,3 --look-at 1,2,3",
        folder.path(),
    );
    assert!(
        line.contains("eye and look-at point are both (1, 2, 3)"),
        "{line}"
    );
    let line = fault("render builtin:cornell --size 16384x16384", folder.path());
    assert_eq!(
        line,
        "--size 16384x16384: more than 16,777,216 pixels; give a smaller picture"
    );
    let line = fault("render builtin:cornell --eye=-1,2,nan", folder.path());
    assert!(line.contains("not finite"), "{line}");
    let line = fault(
        "render builtin:cornell --eye 1,2,3 --fov -10",
        folder.path(),
    );
    assert!(line.contains("field of view is -10 degrees"), "{line}");
}

#[test]
fn a_missing_verilator_gets_one_line() {
    let folder = folder();
    let path = tempfile::tempdir().unwrap();
    let cache = tempfile::tempdir().unwrap();
    let mut command = dynrt(
        "cosim builtin:cornell --size 8x8 --json a.json --out a.png",
        folder.path(),
    );
    command
        .env("PATH", path.path())
        .env("DYNRT_CACHE", cache.path());
    assert_eq!(
        fault_of(&mut command),
        "verilator is not installed: apt-get install verilator g++, of Debian 12 or later, or name its folder in DYNRT_TOOLS"
    );
}

/// A command that finds a script as the tool with this name.
#[cfg(unix)]
fn with_tool(arguments: &str, folder: &Path, tool: &str, script: &str) -> Command {
    use std::os::unix::fs::PermissionsExt;
    let path = folder.join("tools");
    fs::create_dir_all(&path).unwrap();
    let file = path.join(tool);
    fs::write(&file, format!("#!/bin/sh\n{script}\n")).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    let mut command = dynrt(arguments, folder);
    let rest = std::env::var("PATH").unwrap();
    command
        .env("PATH", format!("{}:{rest}", path.display()))
        .env("DYNRT_CACHE", folder.join("cache"));
    command
}

#[cfg(unix)]
#[test]
fn a_tool_that_is_too_old_gets_one_line() {
    let old = |arguments: &str, tool: &str, says: &str| {
        let folder = folder();
        let script = format!("echo '{says}'");
        let said = fault_of(&mut with_tool(arguments, folder.path(), tool, &script));
        // The message contains the path of the tool.
        let place = format!("{}/tools/{tool}", folder.path().display());
        assert!(
            said.starts_with(&place) || said.starts_with(&format!("`{place}")),
            "{said}"
        );
        said.replace(&format!("{}/tools/", folder.path().display()), "")
    };
    for says in [
        "Verilator 4.038 2020-07-11",
        "Verilator 4.0xx devel",
        "Verilator 5.004 2022-12-14 (mod)",
    ] {
        assert_eq!(
            old("cosim builtin:cornell --size 8x8", "verilator", says),
            format!(
                "verilator is too old: {says}; 5.006 or later is needed: apt-get install verilator g++, of Debian 12 or later"
            )
        );
    }
    assert_eq!(
        old("prove fifo", "z3", "Z3 version 4.4.1"),
        "z3 is too old: Z3 version 4.4.1; 4.8 or later is needed: apt-get install z3"
    );
    for says in ["", "yosys: error while loading shared libraries"] {
        let mute = old("prove fifo", "yosys", says);
        assert!(
            mute.starts_with("yosys does not report its version: ")
                && mute.ends_with("; apt-get install yosys"),
            "{mute}"
        );
    }
}

/// A Verilator built from its repository is accepted, with any version string: here the real one with another version.
#[cfg(unix)]
#[test]
fn a_verilator_of_an_odd_version_is_used_with_a_warning() {
    let find = Command::new("sh")
        .args(["-c", "command -v verilator"])
        .output()
        .unwrap();
    let real = String::from_utf8(find.stdout).unwrap();
    for (says, warned) in [
        ("Verilator 5.0xx devel rev v5.004-12-g0123abc (mod)", true),
        ("Verilator 5.x", true),
        ("Verilator devel rev UNKNOWN.REV (mod)", true),
        ("Verilator", true),
        (
            "Verilator 5.031 2024-11-10 rev v5.030-78-g5470cf9fa (mod)",
            false,
        ),
        ("Verilator 6.0xx", false),
    ] {
        let folder = folder();
        let script = format!(
            "case $1 in --version) echo '{says}' ;; *) exec {} \"$@\" ;; esac",
            real.trim()
        );
        let warning = format!(
            "warning: {}/tools/verilator: its version cannot be read in `{says}`; 5.006 or later is required, and assumed
",
            folder.path().display()
        );
        let arguments = "cosim builtin:cornell --unit update --config tiny";
        let mut command = with_tool(arguments, folder.path(), "verilator", &script);
        if says == "Verilator 5.x" {
            let output = command.output().unwrap();
            let said = String::from_utf8(output.stderr).unwrap();
            assert!(output.status.success() && said == warning, "{said}");
            continue;
        }
        // Nothing is built, because there is no space for a model.
        fs::write(folder.path().join("cache"), "").unwrap();
        let said = String::from_utf8(command.output().unwrap().stderr).unwrap();
        let rest = match warned {
            true => said.strip_prefix(&warning),
            false => Some(&*said),
        };
        assert!(
            rest.is_some_and(|rest| rest.starts_with("error: cannot create the model cache")),
            "{said}"
        );
        assert_eq!(said.lines().count(), 1 + usize::from(warned), "{said}");
    }
}

#[test]
fn outputs_that_cannot_be_written_get_one_line() {
    let folder = folder();
    fs::write(folder.path().join("file"), "").unwrap();
    fs::create_dir(folder.path().join("folder")).unwrap();
    for out in ["file", "file/below", "/proc/nonesuch/out"] {
        let line = fault(&format!("generate --out {out}"), folder.path());
        assert!(
            line.starts_with(&format!("{out}: cannot be written: ")),
            "{line}"
        );
        let line = fault(
            &format!("vectors builtin:cornell --out {out}"),
            folder.path(),
        );
        assert!(line.starts_with(&format!("{out}: ")), "{line}");
    }
    for out in ["file/a", "missing/a", "folder", "/proc/nonesuch"] {
        for command in [
            "render builtin:cornell --out",
            "render builtin:cornell --heatmap",
            "stats builtin:cornell --json",
            "cosim builtin:cornell --out good.png --json",
            "cosim builtin:cornell --cycles 5 --trace",
        ] {
            let line = fault(&format!("{command} {out}"), folder.path());
            assert!(
                line.starts_with(&format!("{out}: cannot be written: ")),
                "{line}"
            );
        }
    }
}

#[cfg(unix)]
#[test]
fn links_and_devices_stay_what_they_are() {
    use std::os::unix::fs::symlink;
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let command = "stats builtin:cornell --size 8x8 --json";
    fs::write(at("real.json"), "old").unwrap();
    symlink("real.json", at("link.json")).unwrap();
    symlink("new.json", at("dangling.json")).unwrap();
    prints(&format!("{command} link.json"), folder.path());
    prints(&format!("{command} dangling.json"), folder.path());
    for name in ["link.json", "dangling.json"] {
        assert!(fs::symlink_metadata(at(name)).unwrap().is_symlink());
    }
    for name in ["real.json", "new.json"] {
        assert_eq!(json(&at(name))["config"], "virtex4-lx160", "{name}");
    }
    // The same as `-`: nothing else is written to the standard output.
    let output = run(&format!("{command} /dev/stdout"), folder.path());
    let value: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(value["view"], "framing");
    let text = String::from_utf8(output.stderr).unwrap();
    assert!(text.starts_with("scene cornell, configuration virtex4-lx160, view framing, "));
    // The name of a pipe is checked before it is opened, because that would wait for a reader.
    let made = Command::new("mkfifo").arg(at("pipe.obj")).status();
    assert!(made.unwrap().success());
    let output = run(&format!("{command} pipe.obj"), folder.path());
    assert_eq!(output.status.code(), Some(1));
    assert_eq!(
        String::from_utf8(output.stderr).unwrap(),
        "error: pipe.obj: the output is JSON; give it a name that ends in .json, not in .obj\n"
    );
    fs::remove_file(at("pipe.obj")).unwrap();
    symlink("/dev/full", at("full")).unwrap();
    let mut full = dynrt(&format!("{command} full"), folder.path());
    // Not `fault_of`, which would read the device.
    let output = full.output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1));
    assert!(
        stderr.starts_with("error: full: cannot be written: ") && stderr.lines().count() == 1,
        "{stderr}"
    );
    let trace = run(
        "cosim builtin:cornell --size 8x8 --trace full --cycles 5",
        folder.path(),
    );
    assert_eq!(
        String::from_utf8(trace.stderr).unwrap(),
        "error: full: cannot be written: it is not a regular file; give a file's name\n"
    );
}

#[test]
fn outputs_that_would_overwrite_each_other_are_refused() {
    let folder = folder();
    assert_eq!(
        fault("render builtin:cornell --out a --json ./a", folder.path()),
        "./a: is the same file as a; give each output its own"
    );
}

/// The names of all files except the manifest, and of all modules, start with the given prefix.
#[test]
fn generated_names_begin_with_the_prefix() {
    let folder = folder();
    for (options, prefix) in [
        ("", "dynrt_"),
        ("--prefix small_", "small_"),
        ("--prefix x", "x"),
    ] {
        let command = format!("generate --config tiny --out {prefix} {options}");
        let said = prints(&command, folder.path());
        assert!(
            said.contains(&format!(" top module {prefix}core,")),
            "{said}"
        );
        let out = folder.path().join(prefix);
        let manifest = json(&out.join("manifest.json"));
        assert_eq!(manifest["prefix"], prefix);
        assert_eq!(manifest["top"], format!("{prefix}core"));
        for module in manifest["modules"].as_array().unwrap() {
            let unit = module["unit"].as_str().unwrap();
            let name = module["name"].as_str().unwrap();
            let parameters = module["parameters"].as_object().unwrap();
            // A library unit is a module with another name and with parameters.
            assert!(name.starts_with(prefix), "{name}");
            assert_eq!(
                name == format!("{prefix}{unit}"),
                parameters.is_empty(),
                "{name}"
            );
            assert_eq!(module["file"], format!("{name}.v"));
        }
        for (name, bytes) in contents(&out) {
            // Vectors and include files have the names that the bench uses.
            let verilog = name
                .strip_prefix("sim/")
                .filter(|name| name.ends_with(".v"));
            let (own, file) = (!name.starts_with("sim/"), verilog.unwrap_or(&name));
            let must = file != "manifest.json" && (own || verilog.is_some());
            assert!(!must || file.starts_with(prefix), "{name}");
            let text = String::from_utf8(bytes).unwrap();
            for line in text.lines().filter(|line| line.starts_with("module ")) {
                assert!(line.starts_with(&format!("module {prefix}")), "{line}");
            }
            assert!(prefix == "dynrt_" || !text.contains("dynrt_"), "{name}");
        }
    }
    // Files of a machine with another prefix are removed.
    prints(
        "generate --config tiny --out x --prefix small_",
        folder.path(),
    );
    assert!(contents(&folder.path().join("x")) == contents(&folder.path().join("small_")));
    for bad in ["Small_", "9", "a-b", "_"] {
        let said = fault(&format!("generate --out bad --prefix {bad}"), folder.path());
        assert!(
            said.starts_with(&format!(
                "prefix `{bad}`: is not of the pattern [a-z][a-z0-9_]* "
            )),
            "{said}"
        );
        let said = fault(
            &format!("constraints --out bad --prefix {bad}"),
            folder.path(),
        );
        assert!(said.contains("[a-z][a-z0-9_]*"), "{said}");
    }
    assert!(!folder.path().join("bad").exists());
}

#[test]
fn generating_where_a_folder_is_in_the_way_changes_nothing() {
    let folder = folder();
    prints("generate --config tiny --out rtl", folder.path());
    let taken = folder.path().join("rtl/dynrt_raycast_unit.v");
    fs::remove_file(&taken).unwrap();
    fs::create_dir(&taken).unwrap();
    assert_eq!(
        fault("generate --out rtl", folder.path()),
        "rtl/dynrt_raycast_unit.v: cannot be written: it is a folder; move it elsewhere"
    );
}

#[test]
fn camera_options_change_the_camera_that_frames_the_scene() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let picture = |options: &str, expected: &str| {
        prints(
            &format!("render builtin:teapot --size 32x24 --out a.png --json a.json {options}"),
            folder.path(),
        );
        assert_eq!(json(&at("a.json"))["view"], expected);
        fs::read(at("a.png")).unwrap()
    };
    let mut pictures = vec![
        picture("", "framing"),
        picture("--fov 20", "framing fov=20"),
        picture("--look-at 0,0,0", "framing look-at=0,0,0"),
        picture("--up 1,0,0", "framing up=1,0,0"),
        picture("--view inside", "inside"),
        picture("--eye 9,9,9 --fov 50", "eye=9,9,9 fov=50"),
    ];
    let count = pictures.len();
    pictures.sort();
    pictures.dedup();
    assert_eq!(pictures.len(), count, "each option changes the picture");
}

#[test]
fn a_reader_that_leaves_is_no_error() {
    let folder = folder();
    let mut command = dynrt("stats builtin:cornell --size 32x24", folder.path());
    let mut child = command
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(String::from_utf8_lossy(&output.stderr), "");
    assert!(output.status.success());
}

#[test]
fn what_the_format_cannot_hold_is_warned_of() {
    let folder = folder();
    fs::write(
        folder.path().join("far.obj"),
        "v 1000000 0 0\nv 1000001 0 0\nv 1000000 1 0\nf 1 2 3\n",
    )
    .unwrap();
    let output = run("stats far.obj --size 8x8", folder.path());
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{stderr}");
    assert!(stderr.lines().count() > 0, "{stderr}");
    assert!(
        stderr
            .lines()
            .all(|line| line.starts_with("warning: scene far: ")),
        "{stderr}"
    );
}

#[test]
fn generating_is_deterministic_and_replaces_only_its_own() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    prints("generate --config tiny --out a", folder.path());
    prints("generate --config tiny --out deep/below/b", folder.path());
    let first = contents(&at("a"));
    assert!(first == contents(&at("deep/below/b")));
    for (name, bytes) in &first {
        let text = String::from_utf8_lossy(bytes);
        let place = folder.path().to_string_lossy();
        assert!(!text.contains(&*place), "{name} holds a path");
    }
    // Another machine in the same folder: only its files and foreign files remain.
    fs::write(at("a").join("notes.txt"), "mine").unwrap();
    fs::write(at("a").join("old_unit.v"), "ours").unwrap();
    let mut manifest = json(&at("a").join("manifest.json"));
    manifest["files"]
        .as_array_mut()
        .unwrap()
        .push("old_unit.v".into());
    fs::write(at("a").join("manifest.json"), manifest.to_string()).unwrap();
    prints("generate --config dynrt-2006 --out a", folder.path());
    prints("generate --config dynrt-2006 --out c", folder.path());
    let mut again = contents(&at("a"));
    assert_eq!(again.remove("notes.txt").as_deref(), Some(&b"mine"[..]));
    let again_names: Vec<_> = again.keys().collect();
    let fresh = contents(&at("c"));
    assert_eq!(again_names, fresh.keys().collect::<Vec<_>>());
    assert!(again == fresh);
    assert!(again != first);
}

#[test]
fn the_manifest_says_what_was_generated() {
    let folder = folder();
    prints("generate --out rtl --set memory.latency=13", folder.path());
    let out = folder.path().join("rtl");
    let manifest = json(&out.join("manifest.json"));
    let configuration = &manifest["configuration"];
    assert_eq!(configuration["name"], "virtex4-lx160-custom");
    assert_eq!(configuration["memory"]["latency"], 13);
    assert_eq!(configuration["geometry"]["triangle_test"], "watertight");
    for key in dynrt::config::KEYS {
        assert!(
            !configuration[key.section][key.name].is_null(),
            "{}",
            key.path()
        );
    }
    let top = manifest["top"].as_str().unwrap();
    let modules = manifest["modules"].as_array().unwrap();
    let files: Vec<_> = strings(&manifest["files"]);
    let list = fs::read_to_string(out.join(format!("{top}.f"))).unwrap();
    assert_eq!(list.lines().collect::<Vec<_>>(), files);
    let core = fs::read_to_string(out.join(format!("{top}.core"))).unwrap();
    let bench: Vec<_> = strings(&manifest["simulation"]["files"]);
    assert!(bench.len() > 10);
    for file in bench {
        assert!(
            out.join(file).is_file() && core.contains(&format!("      - {file}")),
            "{file}"
        );
    }
    assert!(core.starts_with("CAPI=2:\nname: dynrt:machine:dynrt_virtex4-lx160-custom:"));
    let mut named: Vec<&str> = vec![];
    for module in modules {
        let file = module["file"].as_str().unwrap();
        if !named.contains(&file) {
            named.push(file);
        }
    }
    assert_eq!(named, files);
    let mut seen: Vec<&str> = vec![];
    for module in modules {
        let name = module["name"].as_str().unwrap();
        let file = module["file"].as_str().unwrap();
        assert!(core.contains(&format!("      - {file}\n")));
        let verilog = fs::read_to_string(out.join(file)).unwrap();
        assert!(
            verilog.contains(&format!("module {name} "))
                || verilog.contains(&format!("module {name}(")),
            "{name}"
        );
        for child in strings(&module["instances"]) {
            assert!(seen.contains(&child), "{child} comes before {name}");
            assert!(verilog.contains(child), "{name} has a {child}");
        }
        let ports = module["ports"].as_array().unwrap();
        assert!(!ports.is_empty());
        for port in ports {
            let declared = verilog.lines().any(|line| {
                let mut words = line.split(|c: char| !c.is_ascii_alphanumeric() && c != '_');
                line.trim_start()
                    .starts_with(port["direction"].as_str().unwrap())
                    && words.any(|word| word == port["name"].as_str().unwrap())
            });
            assert!(declared, "{name} declares {port}");
        }
        seen.push(name);
    }
    assert_eq!(seen.last(), Some(&top));
    assert_eq!(manifest["ports"], modules.last().unwrap()["ports"]);
    assert!(!manifest["latencies"].as_object().unwrap().is_empty());
    for (name, width) in [
        ("node", 128),
        ("link_word", 32),
        ("triangle", 128),
        ("vertex", 72),
    ] {
        let layout = &manifest["layouts"][name];
        assert_eq!(layout["width"], width, "{name}");
        let fields = layout["fields"].as_array().unwrap();
        let total: u64 = fields.iter().map(|f| f["width"].as_u64().unwrap()).sum();
        assert_eq!(total, width, "{name}");
    }
    assert!(
        manifest["counters"]
            .as_array()
            .unwrap()
            .iter()
            .any(|c| c["port"] == "count_packet_steps")
    );
}

fn strings(value: &Value) -> Vec<&str> {
    value
        .as_array()
        .unwrap()
        .iter()
        .map(|v| v.as_str().unwrap())
        .collect()
}

#[test]
fn stats_measures_three_trees() {
    let folder = folder();
    let text = prints(
        "stats builtin:teapot --view outside --size 64x48 --json s.json",
        folder.path(),
    );
    let value = json(&folder.path().join("s.json"));
    let triangles = builtin("teapot").unwrap().mesh.triangles.len();
    assert_eq!(value["triangles"], triangles);
    assert_eq!(value["nodes"], triangles - 1);
    assert_eq!(value["node_bytes"], 16 * (triangles - 1));
    assert!(value["depth"].as_u64().unwrap() >= 13);
    let steps = |name: &str| value[name]["packet_steps_per_packet"].as_f64().unwrap();
    for name in ["plain", "region", "default"] {
        assert!(text.contains(name), "{text}");
        assert!(steps(name) > 1.0);
        assert!(value[name]["triangle_tests_per_packet"].as_f64().unwrap() > 0.1);
        assert!(value[name]["build_s"].as_f64().unwrap() > 0.0);
    }
    assert!(steps("default") < steps("region") && steps("region") < steps("plain"));
}

#[test]
fn stats_averages_over_packets_that_miss() {
    let folder = folder();
    // A camera that looks away: every packet misses the scene's box, so there is no step, but the number of packets is the same.
    prints(
        "stats builtin:sphere --eye 0,0,5 --look-at 0,0,9 --size 8x8 --json s.json",
        folder.path(),
    );
    let value = json(&folder.path().join("s.json"));
    assert_eq!(value["default"]["packet_steps_per_packet"], 0.0);
    assert_eq!(value["rays"], 64);
}

#[test]
fn render_and_cosim_draw_the_same_picture() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    let scene = "builtin:sphere?level=2 --config tiny --size 21x15";
    prints(
        &format!("render {scene} --out golden.png --heatmap steps.png --json r.json"),
        folder.path(),
    );
    let text = prints(
        &format!("cosim {scene} --out rtl.png --json c.json"),
        folder.path(),
    );
    assert!(text.contains("all bits agree"), "{text}");
    assert!(fs::read(at("golden.png")).unwrap() == fs::read(at("rtl.png")).unwrap());
    assert!(fs::read(at("steps.png")).unwrap() != fs::read(at("rtl.png")).unwrap());

    let (render, cosim) = (json(&at("r.json")), json(&at("c.json")));
    for key in [
        "scene",
        "triangles",
        "config",
        "width",
        "height",
        "rays",
        "hits",
        "packet_steps",
        "ray_triangle_tests",
    ] {
        assert!(
            !render[key].is_null() && render[key] == cosim[key],
            "{key}: {} {}",
            render[key],
            cosim[key]
        );
    }
    assert_eq!(cosim["rays"], 21 * 15);
    assert_eq!(cosim["mismatches"], 0);
    let number = |key: &str| {
        cosim[key]
            .as_f64()
            .unwrap_or_else(|| panic!("{key} is a number"))
    };
    for key in [
        "hits",
        "checked",
        "cycles",
        "rays_per_clock",
        "tpu_utilisation",
        "gu_utilisation",
        "simulate_s",
    ] {
        assert!(number(key) > 0.0, "{key}");
    }
    assert!(number("model_build_s") >= 0.0);
    assert!(
        number("checked") >= number("rays") + number("packet_steps") + number("ray_triangle_tests")
    );
}

#[test]
fn cosim_takes_shadow_rays_overrides_and_traces() {
    let folder = folder();
    let scene = "builtin:cornell --config tiny --size 16x12";
    prints(
        &format!(
            "cosim {scene} --rays shadow --set memory.jitter=9 --set memory.order=out-of-order --set memory.ready_percent=60 --seed 5 --json c.json --out s.png"
        ),
        folder.path(),
    );
    let value = json(&folder.path().join("c.json"));
    assert_eq!(value["ray_kind"], "shadow");
    assert_eq!(value["view"], "framing");
    assert_eq!(value["config"], "tiny-custom");
    assert_eq!(value["overrides"]["memory.jitter"], 9);
    assert!(value["hits"].as_u64().unwrap() > 0 && value["hits"].as_u64() < value["rays"].as_u64());
    prints(
        &format!("cosim {scene} --trace w.fst --from 100 --cycles 50"),
        folder.path(),
    );
    assert!(fs::metadata(folder.path().join("w.fst")).unwrap().len() > 100);
    let late = run(
        &format!("cosim {scene} --trace w.fst --from 900000000 --cycles 50"),
        folder.path(),
    );
    let stderr = String::from_utf8(late.stderr).unwrap();
    assert!(late.status.success(), "{stderr}");
    assert!(
        stderr.starts_with("warning: w.fst: the waveform is empty: ")
            && stderr.lines().count() == 1,
        "{stderr}"
    );
}

#[test]
fn cosim_runs_one_unit_alone() {
    let folder = folder();
    let scene = "builtin:sphere?level=1 --config tiny --size 16x12";
    for (unit, counted) in [
        ("tpu", "packet_steps"),
        ("geometry", "ray_triangle_tests"),
        ("update", "nodes_written"),
    ] {
        prints(
            &format!("cosim {scene} --unit {unit} --json u.json"),
            folder.path(),
        );
        let value = json(&folder.path().join("u.json"));
        assert_eq!(value["unit"], unit);
        assert_eq!(value["mismatches"], 0);
        let transactions = value[counted].as_u64().unwrap();
        assert!(transactions > 0 && value["checked"].as_u64().unwrap() >= transactions);
    }
    assert_eq!(
        fault(
            &format!("cosim {scene} --unit tpu --out a.png"),
            folder.path()
        ),
        "--unit tpu: a single unit computes no picture; leave out --out"
    );
}

#[test]
fn vectors_are_written_and_replaced() {
    let folder = folder();
    let command = "vectors builtin:sphere?level=1 --config tiny --size 8x8 --limit 5 --out v";
    let text = prints(command, folder.path());
    assert!(text.starts_with("v: "), "{text}");
    let first = contents(&folder.path().join("v"));
    assert!(first.contains_key("manifest.json"));
    prints(command, folder.path());
    assert!(contents(&folder.path().join("v")) == first);
    for out in ["v/../v", "v/."] {
        prints(
            &command.replace("--out v", &format!("--out {out}")),
            folder.path(),
        );
        let names = contents(folder.path());
        assert!(names.keys().all(|name| name.starts_with("v/")), "{names:?}");
        assert!(contents(&folder.path().join("v")) == first);
    }
    let place = folder.path().join("v");
    let before = contents(&place);
    let mut within = dynrt(&command.replace("--out v", "--out ."), &place);
    assert!(fault_of(&mut within).starts_with(".: holds the folder in which this runs"));
    assert!(contents(&place) == before);
}
