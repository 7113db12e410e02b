//! `dynrt compare`: the hits agree with Embree's, and a missing Embree is reported. No test depends on measured times.

use crate::support::command::dynrt;
use crate::support::say::say;
use dynrt::compare::{self, Comparison, Embree, Task, mark_differences};
use dynrt::config::{Config, TriangleTest};
use dynrt::golden::oracle::{Account, Explanation};
use dynrt::port::Ray;
use dynrt::report;
use dynrt::scene::{self, Camera, Frame, ImageSize, MachineMesh, RayPacket};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

/// Whether Embree is installed; if not, prints which tests are skipped. Any other fault of Embree is a failure.
fn embree_is_here() -> bool {
    match Embree::load() {
        Ok(_) => true,
        Err(error) if error.to_string().contains("is not installed") => {
            say(&format!("{error}: nothing is compared with Embree here"));
            false
        }
        Err(error) => panic!("{error:#}"),
    }
}

struct Picture {
    size: ImageSize,
    mesh: MachineMesh,
    packets: Vec<RayPacket>,
    rays: Vec<Ray>,
}

fn picture(config: &Config, spec: &str, inside: bool, size: &str) -> Picture {
    let scene = scene::load(spec).unwrap();
    let mesh = MachineMesh::new(&scene, config.format()).unwrap();
    let camera = match inside {
        true => Camera::inside(scene.bounds()),
        false => Camera::framing(scene.bounds()),
    };
    let size: ImageSize = size.parse().unwrap();
    let frame = Frame::new(size, config.rays_per_packet as usize).unwrap();
    let packets = frame.primary_rays(&camera, &mesh).unwrap();
    let rays = packets.iter().flat_map(|p| p.rays.iter().copied());
    Picture {
        size,
        mesh,
        rays: rays.collect(),
        packets,
    }
}

fn compare(config: &Config, picture: &Picture, rounds: u32) -> Comparison {
    let found = compare::run(config, &picture.mesh, &picture.rays, rounds, &|_| ());
    found.unwrap_or_else(|error| panic!("{error:#}"))
}

#[test]
fn hits_agree_with_embree_built_and_refitted() {
    if !embree_is_here() {
        return;
    }
    let mut config = Config::reference();
    for (test, spec, inside) in [
        (TriangleTest::Watertight, "builtin:teapot", false),
        (TriangleTest::Watertight, "builtin:interior", true),
        (TriangleTest::Watertight, "builtin:knot", false),
        (TriangleTest::MollerTrumbore, "builtin:teapot", false),
    ] {
        config.triangle_test = test;
        let picture = picture(&config, spec, inside, "256x192");
        // An odd and an even number of rounds leave the moving mesh in different poses.
        for rounds in [1, 2] {
            let found = compare(&config, &picture, rounds);
            found
                .verdict()
                .unwrap_or_else(|error| panic!("{spec} {test:?}: {error:#}"));
            for (what, agreement) in [("built", &found.built), ("refitted", &found.refitted)] {
                let account = &agreement.account;
                println!(
                    "{spec} {test:?}, {what}: {} rays, {} hits, {} differ: {} equally far, {} near an edge",
                    account.rays,
                    account.hits,
                    account.different(),
                    account.same_distance,
                    account.near_edge
                );
                assert_eq!(account.rays, 256 * 192);
                assert!(account.hits > account.rays / 10, "{spec}: hardly any hits");
            }
            let moved = std::iter::zip(&found.built.hits, &found.refitted.hits);
            let changed = moved.filter(|(a, b)| a.t != b.t).count();
            assert!(
                changed > found.built.account.hits / 2,
                "{spec}: the mesh has hardly moved"
            );
        }
    }
}

#[test]
fn everything_is_measured_in_every_round() {
    if !embree_is_here() {
        return;
    }
    let config = Config::reference();
    let picture = picture(&config, "builtin:cornell", false, "31x17");
    let found = compare(&config, &picture, 2);
    assert_eq!(
        found.built.account.rays,
        31 * 17,
        "inactive rays do not count"
    );
    let mut tasks: Vec<_> = found.timings.iter().map(|t| (t.task, t.cores)).collect();
    let expected = [
        (Task::Build, 1),
        (Task::Refit, 1),
        (Task::Cast { together: 1 }, 1),
        (Task::Cast { together: 4 }, 1),
    ];
    assert_eq!(tasks.drain(..4).collect::<Vec<_>>(), expected);
    assert!(tasks.iter().all(|&(_, cores)| cores == found.cores));
    for timing in &found.timings {
        assert_eq!((timing.ours_s.len(), timing.embree_s.len()), (2, 2));
        assert!(timing.work > 0 && timing.ratio() > 0.0);
    }
}

#[test]
fn a_wrong_triangle_is_noticed() {
    if !embree_is_here() {
        return;
    }
    let config = Config::reference();
    let picture = picture(&config, "builtin:cornell", false, "128x96");
    let found = compare(&config, &picture, 1);
    // A wrong triangle at another distance is detected.
    let mut hits = found.built.hits.clone();
    // A hit well inside its triangle.
    let amid = |hit: &&mut dynrt::port::Hit| {
        hit.is_hit() && hit.u > 0.25 && hit.v > 0.25 && hit.u + hit.v < 0.75
    };
    let wrong = hits.iter_mut().find(amid).unwrap();
    wrong.triangle = (wrong.triangle + 19) % picture.mesh.triangles.len() as u32;
    wrong.t *= 1.5;
    let oracle =
        dynrt::golden::oracle::Oracle::new(&picture.mesh.vertices, &picture.mesh.triangles);
    let account: Account = oracle.account(config.format(), &picture.rays, &hits, &found.built.hits);
    assert_eq!((account.different(), account.unexplained), (1, 1));
    assert!(matches!(
        account.differences[0].1,
        Explanation::Unexplained { .. }
    ));
    let error = account.verdict().unwrap_err().to_string();
    assert!(error.contains("1 of 12288 rays"), "{error}");
    let mut drawn = report::shade(picture.size, &picture.packets, &hits, &picture.mesh, None);
    let plain = drawn.clone();
    mark_differences(&mut drawn, &picture.packets, &account);
    assert_ne!(drawn, plain);
}

#[test]
fn numbers_beyond_single_precision_are_refused() {
    if !embree_is_here() {
        return;
    }
    let config = Config::reference();
    let mut picture = picture(&config, "builtin:cornell", false, "16x16");
    picture.mesh.vertices[0][0] = 0.1;
    let error = compare::run(&config, &picture.mesh, &picture.rays, 1, &|_| ()).unwrap_err();
    assert!(
        format!("{error:#}").contains("single precision"),
        "{error:#}"
    );
}

#[test]
fn the_command_writes_figures_and_a_picture() {
    if !embree_is_here() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let arguments = "compare builtin:teapot --size 64x48 --rounds 1 --json a.json --out a.png";
    let Output {
        status,
        stdout,
        stderr,
    } = dynrt(arguments, folder.path()).output().unwrap();
    let stderr = String::from_utf8(stderr).unwrap();
    assert!(status.success(), "{stderr}");
    assert_eq!(stderr, "");
    let text = String::from_utf8(stdout).unwrap();
    for part in [
        "Embree 3.",
        "build, 1 core",
        "refit, 1 core",
        "packets of 4, 1 core",
        "unexplained",
    ] {
        assert!(text.contains(part), "{part} in {text}");
    }
    let value: Value =
        serde_json::from_slice(&fs::read(folder.path().join("a.json")).unwrap()).unwrap();
    assert_eq!(value["agrees"], true);
    assert_eq!(value["rays"], 64 * 48);
    assert_eq!(value["triangles"], 6320);
    for pose in ["built", "refitted"] {
        assert!(value[pose]["hits"].as_u64().unwrap() > 300);
        assert_eq!(value[pose]["unexplained"], 0);
    }
    for timing in value["timings"].as_array().unwrap() {
        assert_eq!(timing["ours_rounds_s"].as_array().unwrap().len(), 1);
        assert!(timing["embree_s"].as_f64().unwrap() > 0.0);
    }
    let drawn = fs::read(folder.path().join("a.png")).unwrap();
    assert!(drawn.starts_with(b"\x89PNG"));
}

/// The error line of a command that must fail and leave no files.
fn fault(command: &mut Command, folder: &Path) -> String {
    let output = command.output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    assert_eq!(output.stdout, b"");
    assert_eq!(stderr.lines().count(), 1, "{stderr}");
    assert!(!folder.join("a.json").exists(), "a report of nothing");
    stderr
}

/// A compiler that prints the given text and fails.
#[cfg(unix)]
fn compiler_that_says(text: &str, folder: &Path) {
    use std::os::unix::fs::PermissionsExt;
    let path = folder.join("cc");
    fs::write(&path, format!("#!/bin/sh\necho '{text}' >&2\nexit 1\n")).unwrap();
    fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
}

#[cfg(unix)]
#[test]
fn what_is_missing_is_named_with_what_to_install() {
    let folder = tempfile::tempdir().unwrap();
    let place = folder.path();
    let compare = "compare builtin:cornell --size 16x16 --json a.json";
    let in_path = |path: &Path| {
        let mut command = dynrt(compare, place);
        command.env("PATH", path);
        command
    };
    let empty = place.join("empty");
    fs::create_dir(&empty).unwrap();
    let error = fault(&mut in_path(&empty), place);
    assert_eq!(
        error,
        "error: scene cornell: cc is not installed: apt-get install gcc\n"
    );
    for text in [
        "embree.c:7:10: fatal error: embree3/rtcore.h: No such file or directory",
        "/usr/bin/ld: cannot find -lembree3: No such file or directory",
    ] {
        compiler_that_says(text, &empty);
        let error = fault(&mut in_path(&empty), place);
        assert_eq!(
            error,
            "error: scene cornell: Embree 3 is not installed: apt-get install libembree-dev\n"
        );
    }
    compiler_that_says("embree.c:3: error: out of paper", &empty);
    let error = fault(&mut in_path(&empty), place);
    assert!(error.contains("out of paper"), "{error}");
}
