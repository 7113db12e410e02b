//! Files by other programs: each loads, or is rejected with one line that names it, and no file that once loaded is rejected.
//!
//! `tests/corpus.tsv` lists them. They are in Debian's package `assimp-testmodels`, which `make deps` installs, and in the source of the crate
//! `gltf-json`. `DYNRT_BLESS=1 cargo test --test scenes corpus::` rewrites the list, but never changes a file that loads to a rejected one.
//!
//! The module also tests `sim/fetch_scenes.sh`, which downloads the public scenes.

use crate::support::say::say;
use serde_json::Value;
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Length of an error message in the list, in characters after the file's name.
const KEPT: usize = 70;
/// Time limit, far above the time for any of the files.
const TIME_OUT: Duration = Duration::from_secs(60);

/// A line of the list.
struct Listed {
    package: String,
    file: String,
    sha256: String,
    gives: String,
}

fn list_path() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/corpus.tsv")
}

fn list() -> (String, Vec<Listed>) {
    let text = fs::read_to_string(list_path()).unwrap();
    let (head, rest) = text.split_once('\n').unwrap();
    let entry = |line: &str| {
        let fields: Vec<String> = line.split('\t').map(str::to_string).collect();
        let [package, file, sha256, gives]: [String; 4] = fields.try_into().unwrap();
        Listed {
            package,
            file,
            sha256,
            gives,
        }
    };
    (head.to_string(), rest.lines().map(entry).collect())
}

/// The base folder of a package's files, if it exists.
fn folder_of(package: &str) -> Option<PathBuf> {
    let folder = match package {
        "assimp-testmodels" => PathBuf::from("/usr/share/assimp/models"),
        krate => crate_folder(krate)?,
    };
    folder.is_dir().then_some(folder)
}

/// The folder in which cargo keeps the source of a dependency.
fn crate_folder(name: &str) -> Option<PathBuf> {
    let output = Command::new(env!("CARGO"))
        .args(["metadata", "--format-version", "1", "--offline", "--locked"])
        .current_dir(env!("CARGO_MANIFEST_DIR"))
        .output()
        .ok()?;
    let metadata: Value = serde_json::from_slice(&output.stdout).ok()?;
    let packages = metadata["packages"].as_array()?;
    let found = packages.iter().find(|package| package["name"] == name)?;
    let manifest = found["manifest_path"].as_str()?;
    Some(Path::new(manifest).parent()?.to_path_buf())
}

/// The mesh files below a folder, by relative path.
fn mesh_files(folder: &Path) -> BTreeSet<String> {
    let mut files = BTreeSet::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(inside) = open.pop() {
        for entry in fs::read_dir(inside).unwrap() {
            let path = entry.unwrap().path();
            let ending = path.extension().unwrap_or_default().to_ascii_lowercase();
            if path.is_dir() {
                open.push(path);
            } else if ["obj", "gltf", "glb"].iter().any(|known| ending == *known) {
                let name = path.strip_prefix(folder).unwrap().to_string_lossy();
                files.insert(name.replace('\\', "/"));
            }
        }
    }
    files
}

/// The output of a program, or `None` after the time limit.
fn output_in_time(command: &mut Command) -> Option<Output> {
    let mut child = command
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let start = Instant::now();
    while child.try_wait().unwrap().is_none() {
        if start.elapsed() > TIME_OUT {
            child.kill().unwrap();
            child.wait().unwrap();
            return None;
        }
        std::thread::sleep(Duration::from_millis(5));
    }
    Some(child.wait_with_output().unwrap())
}

/// The result of loading a file, in the form of the list; `Err` if it is neither a scene nor one line that names the file.
fn loaded(folder: &Path, file: &str) -> Result<String, String> {
    let scratch = tempfile::tempdir().unwrap();
    let (path, out) = (folder.join(file), scratch.path().join("vectors"));
    let mut command = Command::new(env!("CARGO_BIN_EXE_dynrt"));
    command.arg("vectors").arg(&path);
    command.args(["--size", "4x4", "--limit", "1", "--out"]);
    let output = output_in_time(command.arg(&out)).ok_or("it takes too long")?;
    let stderr = String::from_utf8(output.stderr).map_err(|_| "stderr is not UTF-8")?;
    let mut lines: Vec<&str> = stderr.lines().collect();
    let refusal = match output.status.code() {
        Some(0) => None,
        Some(1) => Some(lines.pop().ok_or("it is refused without a word")?),
        _ => return Err(format!("{}: {stderr}", output.status)),
    };
    if let Some(line) = lines.iter().find(|line| !line.starts_with("warning: ")) {
        return Err(format!("a line that is no warning: {line}"));
    }
    let Some(refusal) = refusal else {
        let manifest = fs::read(out.join("manifest.json")).map_err(|e| e.to_string())?;
        let manifest: Value = serde_json::from_slice(&manifest).map_err(|e| e.to_string())?;
        return Ok(format!("ok {}", manifest["triangles"]));
    };
    if fs::read_dir(scratch.path()).unwrap().next().is_some() {
        return Err("it is refused, but something is written".into());
    }
    let lead = format!("error: {}", path.display());
    let rest = refusal
        .strip_prefix(&lead)
        .ok_or_else(|| format!("the refusal does not begin with the file's name: {refusal}"))?;
    let rest = rest.replace(&format!("{}/", folder.display()), "");
    let kept: String = rest.chars().take(KEPT).collect();
    Ok(format!("refused{}", kept.trim_end()))
}

fn sha256(path: &Path) -> String {
    format!("{:x}", Sha256::digest(fs::read(path).unwrap()))
}

/// The result of each file, by package and name, with two files loaded at a time.
fn load_all(
    files: &[(String, PathBuf, String)],
) -> BTreeMap<(String, String), Result<String, String>> {
    let half = files.len().div_ceil(2).max(1);
    std::thread::scope(|scope| {
        let load = |part: &[(String, PathBuf, String)]| -> Vec<_> {
            let each = part.iter().map(|(package, folder, file)| {
                ((package.clone(), file.clone()), loaded(folder, file))
            });
            each.collect()
        };
        let parts: Vec<_> = files
            .chunks(half)
            .map(|part| scope.spawn(move || load(part)))
            .collect();
        parts
            .into_iter()
            .flat_map(|part| part.join().unwrap())
            .collect()
    })
}

#[test]
fn files_of_others_load_or_are_refused_in_one_line() {
    let (head, listed) = list();
    let bless = std::env::var_os("DYNRT_BLESS").is_some();
    let packages: BTreeSet<String> = listed.iter().map(|entry| entry.package.clone()).collect();
    let mut files = vec![];
    for package in &packages {
        match folder_of(package) {
            Some(folder) => {
                let names = mesh_files(&folder);
                files.extend(
                    names
                        .into_iter()
                        .map(|name| (package.clone(), folder.clone(), name)),
                );
            }
            None => say(&format!("absent, so not checked: the files of {package}")),
        }
    }
    let given = load_all(&files);
    let folders: BTreeMap<_, _> = files
        .iter()
        .map(|(p, folder, _)| (p.clone(), folder))
        .collect();
    let mut faults = vec![];
    let mut lines = vec![];
    for entry in &listed {
        let key = (entry.package.clone(), entry.file.clone());
        let mut gives = entry.gives.clone();
        if let Some(folder) = folders.get(&entry.package) {
            let path = folder.join(&entry.file);
            if !path.exists() || sha256(&path) != entry.sha256 {
                say(&format!(
                    "not the listed file, so not compared: {} of {}",
                    entry.file, entry.package
                ));
            } else {
                match &given[&key] {
                    Err(_) => {}
                    Ok(now) if entry.gives.starts_with("ok ") && !now.starts_with("ok ") => {
                        faults.push(format!("{}: loaded once, is now {now}", entry.file));
                    }
                    Ok(now) if bless => gives = now.clone(),
                    Ok(now) if *now != entry.gives => {
                        faults.push(format!(
                            "{}: {}, listed as {}",
                            entry.file, now, entry.gives
                        ));
                    }
                    Ok(_) => {}
                }
            }
        }
        lines.push(
            [&entry.package, &entry.file, &entry.sha256, &gives]
                .map(String::as_str)
                .join("\t"),
        );
    }
    let known: BTreeSet<_> = listed
        .iter()
        .map(|e| (e.package.clone(), e.file.clone()))
        .collect();
    for ((package, file), now) in &given {
        match now {
            Err(why) => faults.push(format!("{file}: {why}")),
            Ok(now) if bless && !known.contains(&(package.clone(), file.clone())) => {
                let sum = sha256(&folders[package].join(file));
                lines.push([package, file, &sum, now].map(String::as_str).join("\t"));
            }
            Ok(_) => {}
        }
    }
    assert!(
        faults.is_empty(),
        "{} of {} files:\n{}\nIf the change is meant: DYNRT_BLESS=1 cargo test --test scenes corpus::",
        faults.len(),
        given.len(),
        faults.join("\n")
    );
    say(&format!(
        "{} files of {} packages tried",
        given.len(),
        folders.len()
    ));
    if bless {
        lines.sort();
        fs::write(list_path(), format!("{head}\n{}\n", lines.join("\n"))).unwrap();
    }
}

// ---- sim/fetch_scenes.sh ---------------------------------------------------------------------------------------

/// Runs the script with its table replaced by `table`.
fn fetch(folder: &Path, table: &str, arguments: &[&str]) -> (bool, String) {
    let file = folder.join("table");
    fs::write(&file, table).unwrap();
    let output = Command::new(Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/fetch_scenes.sh"))
        .arg("--table")
        .arg(&file)
        .arg("--dir")
        .arg(folder.join("scenes"))
        .args(arguments)
        .output()
        .unwrap();
    let said = String::from_utf8(output.stdout).unwrap() + &String::from_utf8_lossy(&output.stderr);
    (output.status.success(), said)
}

/// Files below a folder, as names and contents.
fn contents(folder: &Path) -> BTreeMap<String, String> {
    let mut found = BTreeMap::new();
    for folder in fs::read_dir(folder).into_iter().flatten() {
        let folder = folder.unwrap().path();
        for file in fs::read_dir(&folder).unwrap() {
            let path = file.unwrap().path();
            let name = path.strip_prefix(folder.parent().unwrap()).unwrap();
            found.insert(
                name.to_string_lossy().into_owned(),
                fs::read_to_string(&path).unwrap(),
            );
        }
    }
    found
}

#[test]
fn scenes_are_fetched_whole_and_right_or_not_at_all() {
    let scratch = tempfile::tempdir().unwrap();
    let folder = scratch.path();
    let origin = folder.join("origin.obj");
    fs::write(&origin, "v 0 0 0\n").unwrap();
    let sum = sha256(&origin);
    let url = format!("file://{}", origin.display());
    let good = format!("a/one.obj | {sum} | {url} | none\nb/two.obj | {sum} | {url} | none\n");
    let scenes = folder.join("scenes");

    // A wrong SHA-256, a missing origin, an origin that is no download: none leaves a file or a folder.
    let wrong = sum.replace(['0', '1', '2'], "f");
    for line in [
        format!("a/one.obj | {wrong} | {url} | none\n"),
        format!("a/one.obj | {sum} | {url}.absent | none\n"),
        format!("a/one.obj | {sum} | see the book | none\n"),
    ] {
        let (right, said) = fetch(folder, &line, &[]);
        assert!(!right && said.contains("MISSING  a/one.obj"), "{said}");
        assert!(said.contains("put it at"), "{said}");
        assert_eq!(contents(&scenes), BTreeMap::new());
        assert!(!scenes.join("a").exists());
    }

    // All files are downloaded; a second run downloads nothing, and existing files remain.
    let (right, said) = fetch(folder, &good, &[]);
    assert!(
        right && said.contains("0 were there, 2 fetched, 0 missing"),
        "{said}"
    );
    let whole = contents(&scenes);
    assert_eq!(whole.keys().collect::<Vec<_>>(), ["a/one.obj", "b/two.obj"]);
    assert!(whole.values().all(|text| text == "v 0 0 0\n"));
    fs::remove_file(&origin).unwrap();
    let (right, said) = fetch(folder, &good, &[]);
    assert!(
        right && said.contains("2 were there, 0 fetched, 0 missing"),
        "{said}"
    );

    // A wrong file is named and not replaced.
    fs::write(scenes.join("b/two.obj"), "v 1 1 1\n").unwrap();
    let (right, said) = fetch(folder, &good, &[]);
    assert!(!right && said.contains("WRONG    b/two.obj"), "{said}");
    assert_eq!(contents(&scenes)["b/two.obj"], "v 1 1 1\n");

    // From another place with the same layout as the folder.
    let mirror = folder.join("mirror");
    fs::create_dir_all(mirror.join("b")).unwrap();
    fs::write(mirror.join("b/two.obj"), "v 0 0 0\n").unwrap();
    fs::remove_file(scenes.join("b/two.obj")).unwrap();
    let (right, said) = fetch(folder, &good, &["--from", mirror.to_str().unwrap()]);
    assert!(
        right && said.contains("1 were there, 1 fetched, 0 missing"),
        "{said}"
    );
    assert_eq!(contents(&scenes), whole);
}

#[test]
fn the_scenes_that_are_there_are_those_of_the_table() {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/fetch_scenes.sh");
    let list = Command::new(&script).arg("--list").output().unwrap();
    let list = String::from_utf8(list.stdout).unwrap();
    let files: Vec<&str> = list.lines().filter(|line| !line.starts_with(' ')).collect();
    assert!(files.len() >= 25, "{list}");
    for kind in ["SHA-256", "licence", "origin"] {
        let named = list
            .lines()
            .filter(|line| line.trim_start().starts_with(kind));
        assert_eq!(named.count(), files.len(), "{kind}");
    }
    let folder = std::env::var("DYNRT_SCENES").unwrap();
    let present = files
        .iter()
        .filter(|file| Path::new(&folder).join(file).exists());
    if present.count() < files.len() {
        say(
            "not all public scenes are there, so their SHA-256 is not checked (run sim/fetch_scenes.sh)",
        );
        return;
    }
    let output = Command::new(&script)
        .args(["--dir", &folder])
        .output()
        .unwrap();
    let said = String::from_utf8(output.stdout).unwrap();
    assert!(output.status.success(), "{said}");
}
