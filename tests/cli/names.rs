//! Names are bytes, and only printable characters reach a terminal.

use super::{contents, dynrt, fault, fault_of, folder, prints};
use dynrt::config::Config;
use std::ffi::OsStr;
use std::fs;
use std::os::unix::ffi::OsStrExt;
use std::process::Command;

const OBJ: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

/// The output of a command that must succeed.
fn text_of(command: &mut Command) -> String {
    let output = command.output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{command:?}: {stderr}");
    assert_eq!(stderr, "", "{command:?}");
    String::from_utf8(output.stdout).unwrap()
}

#[test]
fn paths_need_not_be_utf8() {
    let folder = folder();
    let mesh = OsStr::from_bytes(b"na\xffme.obj");
    let config = OsStr::from_bytes(b"ma\xfechine.toml");
    let picture = OsStr::from_bytes(b"pic\xfdture.png");
    let at = |name: &OsStr| folder.path().join(name);
    fs::write(at(mesh), OBJ).unwrap();
    fs::write(at(config), Config::reference().to_toml()).unwrap();
    let text = text_of(
        dynrt("render --size 8x8 --config", folder.path())
            .arg(config)
            .arg("--out")
            .arg(picture)
            .arg(mesh),
    );
    assert!(
        text.starts_with("scene na\u{fffd}me, 1 triangle, configuration ma\u{fffd}chine, "),
        "{text}"
    );
    assert!(text.ends_with("\npicture: pic\u{fffd}ture.png\n"), "{text}");
    assert!(fs::read(at(picture)).unwrap().starts_with(b"\x89PNG"));
    text_of(dynrt("animate --size 8x8 --config tiny", folder.path()).arg(mesh));
    let sequence = OsStr::from_bytes(b"fi\xfflm");
    fs::create_dir(at(sequence)).unwrap();
    fs::copy(at(mesh), at(sequence).join(mesh)).unwrap();
    let vectors = OsStr::from_bytes(b"vec\xfftors");
    text_of(
        dynrt("vectors --config tiny --size 8x8 --out", folder.path()).args([vectors, sequence]),
    );
    assert!(at(vectors).join("manifest.json").is_file());
    let lines = [
        fault_of(dynrt("stats", folder.path()).arg(OsStr::from_bytes(b"mi\xffssing.obj"))),
        fault_of(dynrt("animate", folder.path()).arg(OsStr::from_bytes(b"mi\xffssing.glb"))),
        fault_of(
            dynrt("stats builtin:cornell --config", folder.path())
                .arg(OsStr::from_bytes(b"mi\xff")),
        ),
        fault_of(dynrt("stats --json", folder.path()).args([mesh, mesh])),
    ];
    for line in lines {
        assert!(
            line.starts_with("mi\u{fffd}")
                || line.starts_with("na\u{fffd}me.obj: is the input scene"),
            "{line}"
        );
    }
}

#[test]
fn an_argument_that_must_be_utf8_is_named() {
    let folder = folder();
    let mut command = dynrt("animate builtin:water --clip", folder.path());
    let output = command.arg(OsStr::from_bytes(b"ru\xffn")).output().unwrap();
    assert_eq!(output.status.code(), Some(2));
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(
        stderr.starts_with("error: argument $'ru\\377n' is not UTF-8"),
        "{stderr}"
    );
}

#[test]
fn control_characters_of_names_are_not_printed() {
    let folder = folder();
    let name = "a\x1b[31m\nb\u{202e}.obj";
    fs::write(folder.path().join(name), OBJ).unwrap();
    let far = "v 1000000 0 0\nv 1000001 0 0\nv 1000000 1 0\nf 1 2 3\n";
    fs::write(folder.path().join("far\x07\n.obj"), far).unwrap();
    let shown = r"a\u{1b}[31m\nb\u{202e}";
    let config = "c\x1b\n.toml";
    fs::write(folder.path().join(config), Config::reference().to_toml()).unwrap();
    for command in ["stats --size 8x8", "render --size 8x8", "program"] {
        let text = text_of(dynrt(command, folder.path()).args(["--config", config, name]));
        assert!(
            text.starts_with(&format!("scene {shown}, ")),
            "{command}: {text}"
        );
        let first = text.lines().next().unwrap();
        if command != "program" {
            assert!(
                first.contains(r", configuration c\u{1b}\n, "),
                "{command}: {text}"
            );
        }
    }
    let output = dynrt("stats --size 8x8", folder.path())
        .arg("far\x07\n.obj")
        .output()
        .unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{stderr}");
    let is_whole = |line: &str| line.starts_with(r"warning: scene far\u{7}\n: ");
    assert!(
        stderr.lines().count() > 0 && stderr.lines().all(is_whole),
        "{stderr}"
    );
    for (command, argument) in [
        ("stats", "no\x1b\nsuch.obj"),
        ("animate", "no\x1b\nsuch.gltf"),
        ("stats", "builtin:no\x1bsuch"),
        ("stats builtin:cornell --config", "no\x1b\nsuch"),
        ("stats builtin:cornell --set", "no\x1bsuch=1"),
        ("animate builtin:water --clip", "no\x1bsuch"),
        ("stats builtin:cornell --json", "no\x1b\nsuch/a.json"),
        ("generate --out", "no\x1bsuch.png"),
    ] {
        let line = fault_of(dynrt(command, folder.path()).arg(argument));
        assert!(
            line.contains(r"no\u{1b}") && !line.contains('\x1b'),
            "{command}: {line}"
        );
    }
}

#[test]
fn names_in_gltf_files_are_printed_escaped() {
    let folder = folder();
    // An animated triangle whose node and clips have names with control characters.
    let scene = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "no\u001bde\n", "mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "animations": [{"name": "ru\u0007n\n", "samplers": [{"input": 1, "output": 2}],
            "channels": [{"sampler": 0, "target": {"node": 0, "path": "translation"}}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
            {"bufferView": 1, "componentType": 5126, "count": 2, "type": "SCALAR", "min": [0], "max": [1]},
            {"bufferView": 2, "componentType": 5126, "count": 2, "type": "VEC3"}],
        "bufferViews": [{"buffer": 0, "byteLength": 36}, {"buffer": 0, "byteOffset": 36, "byteLength": 8},
            {"buffer": 0, "byteOffset": 44, "byteLength": 24}],
        "buffers": [{"uri": "b.bin", "byteLength": 68}]}"#;
    let numbers = [
        0f32, 0., 0., 1., 0., 0., 0., 1., 0., 0., 1., 0., 0., 0., 1., 0., 0.,
    ];
    fs::write(
        folder.path().join("b.bin"),
        numbers.map(f32::to_le_bytes).concat(),
    )
    .unwrap();
    fs::write(folder.path().join("s.gltf"), scene).unwrap();
    assert_eq!(
        fault("animate s.gltf --clip walk", folder.path()),
        r"scene s: no clip `walk`; there are `ru\u{7}n\n`"
    );
    let command = "animate s.gltf --config tiny --size 8x8 --frames 1 --clip";
    for clip in ["ru\x07n\n", r"ru\u{7}n\n"] {
        let text = text_of(dynrt(command, folder.path()).arg(clip));
        assert!(
            text.starts_with(r"scene s, clip ru\u{7}n\n, 1 triangle"),
            "{text}"
        );
    }
    let library = dynrt::scene::load_animated(folder.path().join("s.gltf")).unwrap();
    assert_eq!(library.node_names(), [r"no\u{1b}de\n"]);
}

#[test]
fn numbers_in_messages_are_short() {
    let folder = folder();
    for command in [
        "render builtin:cornell --eye 1e308,0,0",
        "render builtin:cornell --eye 1e-300,0,0 --look-at 1e-300,0,0",
        "render builtin:cornell --eye 1,2,3 --fov 1e300",
        "animate builtin:water --fps 1e300",
        "animate builtin:water --rebuild-above -1e300",
        "animate builtin:water --frames 1e300",
        "vectors builtin:water --seconds -1e300 --out v",
        "vectors builtin:cornell --eye 1e308,0,0 --out v",
        "mutate --least 1e300",
    ] {
        let line = fault(command, folder.path());
        assert!(
            line.len() < 250 && !line.contains("0000000000"),
            "{command}: {line}"
        );
    }
    let digits = "9".repeat(300);
    let line = fault(
        &format!("generate --out v --set packets.rays={digits}"),
        folder.path(),
    );
    assert!(line.len() < 250, "{line}");
    let text = prints(
        "render builtin:cornell --size 8x8 --eye 3,1,1e-20",
        folder.path(),
    );
    assert!(text.contains("view eye=3,1,1e-20, "), "{text}");
    assert_eq!(contents(folder.path()).len(), 0);
}
