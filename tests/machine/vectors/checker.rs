//! `sim/check_vectors.py` finds no mismatch in generated vectors, and detects a changed
//! digit in every kind of file.

use crate::support::seed;
use fastrand::Rng;
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// The output of the checker for a folder.
fn check(folder: &Path, arguments: &[&str]) -> Output {
    Command::new("python3")
        .arg(Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/check_vectors.py"))
        .arg(folder)
        .args(arguments)
        .output()
        .expect("python3, which make deps installs")
}

fn text(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
}

/// Writes vectors with the command.
fn write(folder: &Path, arguments: &[&str]) {
    let output = Command::new(env!("CARGO_BIN_EXE_dynrt"))
        .arg("vectors")
        .args(arguments)
        .arg("--out")
        .arg(folder)
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", text(&output));
}

#[test]
fn the_checker_that_ships_finds_nothing_wrong() {
    let scratch = tempfile::tempdir().unwrap();
    for (name, kinds, arguments) in [
        (
            "one level",
            &["update of the scene", "triangle_test care"][..],
            &["builtin:cornell", "--size", "10x7"][..],
        ),
        (
            "skinned",
            &["skinning of the scene", "skinning_expected"],
            &[
                "builtin:figure?detail=36",
                "--seconds",
                "0.3",
                "--config",
                "dynrt-2006",
                "--size",
                "8x6",
            ],
        ),
        (
            "two levels",
            &["ray_transform", "ray_transforms of packets"],
            &[
                "builtin:reef?fish=3",
                "--config",
                "ecp5-85f",
                "--size",
                "9x6",
                "--limit",
                "12",
            ],
        ),
    ] {
        let (folder, report) = (
            scratch.path().join(name),
            scratch.path().join("report.json"),
        );
        write(&folder, arguments);
        let output = check(&folder, &["--json", report.to_str().unwrap()]);
        assert!(output.status.success(), "{name}: {}", text(&output));
        let report: Value = serde_json::from_slice(&fs::read(&report).unwrap()).unwrap();
        assert_eq!(report["mismatches"], 0, "{name}");
        assert!(
            report["checked"].as_u64().unwrap() > 100_000,
            "{name}: {}",
            report["checked"]
        );
        let always = [
            "raycast_hits",
            "brute force",
            "packet_steps of packets",
            "update_boxes",
            "checksums",
            "macros",
        ];
        for kind in always.iter().chain(kinds) {
            let checked = report["kinds"][kind]["checked"].as_u64();
            assert!(
                checked.is_some_and(|n| n > 0),
                "{name}: {kind}: {checked:?}"
            );
        }
        // A part of the folder, without output.
        let output = check(&folder, &["--limit", "3", "--quiet"]);
        assert!(
            output.status.success() && text(&output).is_empty(),
            "{name}: {}",
            text(&output)
        );
    }
}

/// A small folder with such a coarse number format that a changed digit of an operand affects most results.
const COARSE: [&str; 11] = [
    "builtin:cornell",
    "--size",
    "8x6",
    "--limit",
    "8",
    "--set",
    "float.exponent_bits=6",
    "--set",
    "float.fraction_bits=4",
    "--set",
    "skinning.joints=16",
];

/// Files in which some digits have no effect: random
/// operands whose result is a NaN or absorbs them, and registers that are never read.
const OPEN: [&str; 12] = [
    "fp_add_stimulus.hex",
    "fp_mul_stimulus.hex",
    "fp_reciprocal_stimulus.hex",
    "fp_sub_stimulus.hex",
    "packet_step_stimulus.hex",
    "ray_setup_stimulus.hex",
    "skinning_influences.hex",
    "skinning_vectors.hex",
    "triangle_test_stimulus.hex",
    "update_program.hex",
    "update_vertices.hex",
    "vertices.hex",
];

/// Changes one digit of a file and adapts its checksum in the manifest. Returns a description.
fn flip(folder: &Path, file: &str, rng: &mut Rng) -> String {
    let mut bytes = fs::read(folder.join(file)).unwrap();
    let digits = match file {
        "vectors.vh" => "0123456789",
        _ => "0123456789abcdef",
    };
    let is_digit = |i: &usize| digits.contains(bytes[*i] as char);
    let places: Vec<usize> = (0..bytes.len()).filter(is_digit).collect();
    let place = *rng.choice(&places).unwrap();
    let before = bytes[place];
    while bytes[place] == before {
        bytes[place] = *rng.choice(digits.as_bytes()).unwrap();
    }
    fs::write(folder.join(file), &bytes).unwrap();
    let path = folder.join("manifest.json");
    let mut manifest: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    for entry in manifest["files"].as_array_mut().unwrap() {
        if entry["file"] == file {
            entry["sha256"] = json!(format!("{:x}", Sha256::digest(&bytes)));
        }
    }
    fs::write(&path, manifest.to_string()).unwrap();
    let newlines = bytes[..place].iter().filter(|&&byte| byte == b'\n');
    let (after, before) = (bytes[place] as char, before as char);
    format!(
        "{file} line {}: {after} instead of {before}",
        newlines.count() + 1
    )
}

/// The numbers of the manifest that follow from the pages or from each other, as JSON pointers.
fn figures(value: &Value, pointer: &str, found: &mut Vec<String>) {
    let open = ["/configuration", "/made", "/ports"];
    match value {
        Value::Number(number) if number.is_u64() => found.push(pointer.to_string()),
        Value::Array(list) => {
            for (place, inner) in list.iter().enumerate() {
                figures(inner, &format!("{pointer}/{place}"), found);
            }
        }
        Value::Object(map) => {
            for (key, inner) in map {
                let inside = format!("{pointer}/{key}");
                if !open.iter().any(|end| inside.ends_with(end)) {
                    figures(inner, &inside, found);
                }
            }
        }
        _ => {}
    }
}

/// Whether the checker detects a change of a copy of a folder, and names the file or its unit.
fn notices(scratch: &Path, good: &Path, file: &str, rng: &mut Rng) -> Result<(), String> {
    let bad = scratch.join(format!("bad-{file}"));
    fs::create_dir(&bad).unwrap();
    for entry in fs::read_dir(good).unwrap() {
        let path = entry.unwrap().path();
        fs::copy(&path, bad.join(path.file_name().unwrap())).unwrap();
    }
    let done = flip(&bad, file, rng);
    let output = check(&bad, &["--quiet", "--jobs", "1"]);
    fs::remove_dir_all(&bad).unwrap();
    let said = text(&output);
    assert_ne!(output.status.code(), None, "{done}: {said}");
    assert!(!said.contains("Traceback"), "{done}: {said}");
    if output.status.success() {
        return Err(done);
    }
    // If two files disagree, the checker cannot know which one was changed.
    let unit = match file.split('_').next() {
        Some("raycast" | "update" | "skinning") => file.split('_').next().unwrap(),
        _ => file.trim_end_matches(".hex"),
    };
    let unit = ["_stimulus", "_expected", "_care"]
        .iter()
        .find_map(|role| unit.strip_suffix(role))
        .unwrap_or(unit);
    let image = ["nodes", "records", "vertices", "scene"].contains(&unit);
    assert!(
        said.contains(file)
            || said.contains(unit)
            || image && (said.contains("memory") || said.contains(" of packets")),
        "{done}: {said}"
    );
    Ok(())
}

#[test]
fn the_checker_that_ships_notices_a_changed_digit_in_every_kind_of_file() {
    let scratch = tempfile::tempdir().unwrap();
    let good = scratch.path().join("good");
    write(&good, &COARSE);
    let output = check(&good, &[]);
    assert!(output.status.success(), "{}", text(&output));
    let mut files: Vec<String> = fs::read_dir(&good)
        .unwrap()
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .filter(|file| file.ends_with(".hex") || file == "vectors.vh")
        .collect();
    files.sort();
    assert!(files.len() >= 38 && OPEN.iter().all(|file| files.iter().any(|f| f == file)));
    let seed = seed();
    let missed = std::thread::scope(|scope| {
        let part = |first: usize| {
            let (files, scratch, good) = (&files, scratch.path(), &good);
            scope.spawn(move || {
                let of_part = files.iter().skip(first).step_by(2);
                of_part
                    .filter_map(|file| unnoticed(scratch, good, file, seed))
                    .collect::<Vec<_>>()
            })
        };
        [part(0), part(1)].map(|part| part.join().unwrap()).concat()
    });
    assert!(
        missed.is_empty(),
        "not noticed, DYNRT_SEED={seed}:\n{}",
        missed.join("\n")
    );
}

#[test]
fn the_checker_that_ships_notices_a_changed_figure_of_the_manifest() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("folder");
    write(&folder, &["builtin:sphere?level=1", "--size", "2x2"]);
    let path = folder.join("manifest.json");
    let manifest: Value = serde_json::from_slice(&fs::read(&path).unwrap()).unwrap();
    let mut pointers = vec![];
    figures(&manifest, "", &mut pointers);
    assert!(pointers.len() > 1000, "{} figures", pointers.len());
    let seed = seed();
    let rng = &mut Rng::with_seed(seed);
    for _ in 0..8 {
        let pointer = rng.choice(&pointers).unwrap();
        let mut changed = manifest.clone();
        let figure = changed.pointer_mut(pointer).unwrap();
        *figure = json!(figure.as_u64().unwrap() + 1);
        fs::write(&path, changed.to_string()).unwrap();
        let output = check(&folder, &["--quiet", "--limit", "1"]);
        let said = text(&output);
        assert_eq!(
            output.status.code(),
            Some(1),
            "{pointer}, DYNRT_SEED={seed}: {said}"
        );
        assert!(
            !said.contains("Traceback"),
            "{pointer}, DYNRT_SEED={seed}: {said}"
        );
    }
}

/// An undetected change of a file: one digit, or twelve digits in files in which some have no effect.
fn unnoticed(scratch: &Path, good: &Path, file: &str, seed: u64) -> Option<String> {
    let name = file.bytes().fold(seed, |sum, byte| {
        sum.wrapping_mul(31).wrapping_add(byte.into())
    });
    let rng = &mut Rng::with_seed(name);
    let tries = if OPEN.contains(&file) { 12 } else { 1 };
    let mut missed = vec![];
    for _ in 0..tries {
        match notices(scratch, good, file, rng) {
            Ok(()) => return None,
            Err(done) => missed.push(done),
        }
    }
    Some(missed.join("; "))
}

#[test]
fn the_checker_that_ships_refuses_what_it_cannot_check() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path().join("folder");
    let manifest = folder.join("manifest.json");
    let refusal = |expected: &str| {
        let output = check(&folder, &[]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output));
        let said = String::from_utf8(output.stderr).unwrap();
        assert!(
            said.starts_with("error: ") && said.lines().count() == 1,
            "{said}"
        );
        assert!(said.contains(expected), "{expected}: {said}");
    };
    refusal("there is no such folder");
    fs::create_dir(&folder).unwrap();
    refusal("manifest.json: cannot be read");
    for (text, expected) in [
        ("", "is not JSON"),
        ("[1]", "has no key dynrt_vectors"),
        (
            r#"{"dynrt_vectors": 2}"#,
            "dynrt_vectors is 2, but this checker knows version 3",
        ),
        (
            r#"{"dynrt_vectors": 3}"#,
            "number_format.exponent_bits is not a whole number",
        ),
    ] {
        fs::write(&manifest, text).unwrap();
        refusal(expected);
    }
    fs::remove_dir_all(&folder).unwrap();
    write(&folder, &["builtin:sphere?level=1", "--size", "2x2"]);
    let whole: Value = serde_json::from_slice(&fs::read(&manifest).unwrap()).unwrap();
    let said = |change: &dyn Fn(&mut Value)| {
        let mut changed = whole.clone();
        change(&mut changed);
        fs::write(&manifest, changed.to_string()).unwrap();
        let output = check(&folder, &["--quiet", "--limit", "1"]);
        assert_eq!(output.status.code(), Some(1), "{}", text(&output));
        text(&output)
    };
    // A manifest without files; changed figures in the manifest.
    assert!(said(&|m| m["scenes"] = json!([])).contains("scenes is empty"));
    assert!(said(&|m| m["files"] = json!([])).contains("manifest"));
    assert!(said(&|m| m["units"] = json!([])).contains("units"));
    assert!(said(&|m| m["layouts"] = json!({})).contains("layouts"));
    assert!(said(&|m| m["packet_steps"] = json!(7)).contains("packet_steps"));
    assert!(
        said(&|m| m["layouts"]["nodes"]["fields"][0]["lsb"] = json!(1)).contains("layouts: nodes")
    );
    fs::write(&manifest, whole.to_string()).unwrap();
    // A missing file, a truncated one, an additional one.
    let hits = folder.join("raycast_hits.hex");
    let lines = fs::read_to_string(&hits).unwrap();
    fs::remove_file(&hits).unwrap();
    refusal("raycast_hits.hex: cannot be read");
    fs::write(&hits, &lines[..lines.len() - 20]).unwrap();
    assert!(text(&check(&folder, &["--quiet"])).contains("raycast_hits.hex"));
    fs::write(&hits, &lines).unwrap();
    let more: PathBuf = folder.join("more.txt");
    fs::write(&more, "").unwrap();
    assert!(text(&check(&folder, &["--quiet"])).contains("more.txt"));
    fs::remove_file(&more).unwrap();
    assert!(check(&folder, &["--quiet"]).status.success());
}
