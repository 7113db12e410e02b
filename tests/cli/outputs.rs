//! Outputs never replace inputs, have suitable names, and may be the standard output.

use super::{contents, dynrt, fault, fault_of, folder, json, prints, run};
use dynrt::config::Config;
use serde_json::Value;
use std::fs;
use std::path::Path;

const OBJ: &str = "mtllib mesh.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";

/// A triangle whose vertices are in a separate file, and a picture that is not read.
const GLTF: &str = r#"{"asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
    "accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]}],
    "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "buffers": [{"uri": "three%20vertices", "byteLength": 36}], "images": [{"uri": "look"}]}"#;

/// A folder with every kind of input, with unusual extensions where possible.
fn inputs() -> tempfile::TempDir {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    fs::create_dir(at("film")).unwrap();
    for name in ["mesh.obj", "film/f1.obj", "film/f2.obj"] {
        fs::write(at(name), OBJ).unwrap();
    }
    fs::write(at("mesh.mtl"), "newmtl red\n").unwrap();
    fs::write(at("scene.gltf"), GLTF).unwrap();
    let vertices = [0f32, 0., 0., 1., 0., 0., 0., 1., 0.].map(f32::to_le_bytes);
    fs::write(at("three vertices"), vertices.concat()).unwrap();
    fs::write(at("look"), "not looked at").unwrap();
    fs::write(at("machine"), Config::reference().to_toml()).unwrap();
    fs::write(at("figures"), "{}").unwrap();
    folder
}

#[test]
fn what_is_read_is_not_overwritten() {
    let folder = inputs();
    let is = |out: &str, what: &str| format!("{out}: is {what}; give the output another name");
    let scene = "the input scene";
    for (command, expected) in [
        ("render mesh.obj --out mesh.obj", is("mesh.obj", scene)),
        ("render mesh.obj --heatmap mesh.obj", is("mesh.obj", scene)),
        ("stats mesh.obj --json mesh.obj", is("mesh.obj", scene)),
        (
            "compare mesh.obj --json ./mesh.obj",
            is("./mesh.obj", "mesh.obj, the input scene"),
        ),
        (
            "program mesh.obj --json film/../mesh.obj",
            is("film/../mesh.obj", "mesh.obj, the input scene"),
        ),
        (
            "cosim mesh.obj --cycles 5 --trace mesh.obj",
            is("mesh.obj", scene),
        ),
        ("vectors mesh.obj --out mesh.obj", is("mesh.obj", scene)),
        (
            "animate scene.gltf --gif scene.gltf",
            is("scene.gltf", scene),
        ),
        ("animate film --out film", is("film", scene)),
        (
            "stats mesh.obj --json mesh.mtl",
            is("mesh.mtl", "a material file of the input scene"),
        ),
        (
            "animate film --json film/f2.obj",
            is("film/f2.obj", "a frame of the input scene"),
        ),
        (
            "animate scene.gltf --json look",
            is("look", "an image of the input scene"),
        ),
        (
            "stats mesh.obj --config machine --json machine",
            is("machine", "the input configuration"),
        ),
        (
            "prove fifo --config machine --json machine",
            is("machine", "the input configuration"),
        ),
        (
            "fuzz --config machine --json machine",
            is("machine", "the input configuration"),
        ),
        (
            "mutate --config machine --json machine",
            is("machine", "the input configuration"),
        ),
        (
            "synth --config machine --json machine",
            is("machine", "the input configuration"),
        ),
        (
            "baseline --file figures --json figures",
            is("figures", "the input file of figures"),
        ),
        (
            "numbers --file figures --out figures",
            is("figures", "the input file of figures"),
        ),
        (
            "vectors mesh.obj --out .",
            ".: holds mesh.obj, the input scene; name another folder".into(),
        ),
    ] {
        assert_eq!(fault(command, folder.path()), expected, "{command}");
    }
    let mut command = dynrt("animate scene.gltf --json", folder.path());
    assert_eq!(
        fault_of(command.arg("three vertices")),
        is("three vertices", "a buffer of the input scene")
    );
}

#[test]
fn a_generated_file_does_not_replace_the_configuration() {
    let folder = inputs();
    fs::create_dir(folder.path().join("rtl")).unwrap();
    let at = |name: &str| folder.path().join("rtl").join(name);
    fs::copy(folder.path().join("machine"), at("manifest.json")).unwrap();
    assert_eq!(
        fault(
            "generate --config rtl/manifest.json --out rtl",
            folder.path()
        ),
        "rtl/manifest.json: is the input configuration; give the output another name"
    );
    // An input next to the output is permitted.
    fs::rename(at("manifest.json"), at("machine.toml")).unwrap();
    let before = fs::read(at("machine.toml")).unwrap();
    prints(
        "generate --config rtl/machine.toml --out rtl",
        folder.path(),
    );
    assert!(fs::read(at("machine.toml")).unwrap() == before);
    assert!(at("manifest.json").is_file());
}

#[cfg(unix)]
#[test]
fn what_is_read_is_not_overwritten_under_another_name() {
    use std::os::unix::fs::symlink;
    let folder = inputs();
    let at = |name: &str| folder.path().join(name);
    symlink("mesh.obj", at("soft")).unwrap();
    symlink("film", at("reel")).unwrap();
    fs::hard_link(at("mesh.obj"), at("hard.png")).unwrap();
    for out in ["soft", "hard.png"] {
        assert_eq!(
            fault(&format!("render mesh.obj --out {out}"), folder.path()),
            format!("{out}: is mesh.obj, the input scene; give the output another name")
        );
    }
    assert_eq!(
        fault("animate film --json reel/f1.obj", folder.path()),
        "reel/f1.obj: is film/f1.obj, a frame of the input scene; give the output another name"
    );
    assert_eq!(
        fault("animate film --out reel", folder.path()),
        "reel: is film, the input scene; give the output another name"
    );
    assert_eq!(
        fault("render soft --out hard.png", folder.path()),
        "hard.png: is soft, the input scene; give the output another name"
    );
    assert_eq!(
        fault(
            "render builtin:cornell --out hard.png --json soft",
            folder.path()
        ),
        "soft: is the same file as hard.png; give each output its own"
    );
}

#[test]
fn outputs_do_not_get_names_of_other_types() {
    let folder = inputs();
    let other = |out: &str, is: &str, right: &str, wrong: &str| {
        format!("{out}: the output is {is}; give it a name that ends in .{right}, not in .{wrong}")
    };
    for (command, expected) in [
        (
            "render mesh.obj --out a.jpg",
            other("a.jpg", "PNG", "png", "jpg"),
        ),
        (
            "render mesh.obj --out new.OBJ",
            other("new.OBJ", "PNG", "png", "obj"),
        ),
        (
            "render mesh.obj --heatmap a.json",
            other("a.json", "PNG", "png", "json"),
        ),
        (
            "stats mesh.obj --json a.png",
            other("a.png", "JSON", "json", "png"),
        ),
        (
            "stats mesh.obj --json a.toml",
            other("a.toml", "JSON", "json", "toml"),
        ),
        (
            "animate film --gif a.png",
            other("a.png", "GIF", "gif", "png"),
        ),
        (
            "cosim mesh.obj --cycles 5 --trace a.vcd",
            other("a.vcd", "FST", "fst", "vcd"),
        ),
    ] {
        assert_eq!(fault(command, folder.path()), expected, "{command}");
    }
    for command in [
        "generate --out rtl.v",
        "vectors mesh.obj --out a.gltf",
        "animate film --out a.gif",
    ] {
        let line = fault(command, folder.path());
        let (_, extension) = command.rsplit_once('.').unwrap();
        assert!(
            line.ends_with(&format!(
                ".{extension}: the output is a folder; give it a name that does not end in .{extension}"
            )),
            "{line}"
        );
    }
    let free = folder.path().join("free");
    fs::create_dir(&free).unwrap();
    for out in ["none", "a.PNG", "a.unknown", "a.2"] {
        prints(
            &format!("render builtin:cornell --size 8x8 --out {out}"),
            &free,
        );
        assert!(fs::read(free.join(out)).unwrap().starts_with(b"\x89PNG"));
    }
}

#[test]
fn json_may_go_to_the_standard_output_alone() {
    let folder = folder();
    for command in [
        "stats builtin:cornell --size 8x8",
        "render builtin:cornell --size 8x8",
        "program builtin:sphere?level=0 --list",
        "cosim builtin:sphere?level=0 --config tiny --size 8x8 --unit geometry",
        "animate builtin:sphere?level=0 --config tiny --size 8x8",
    ] {
        let output = run(&format!("{command} --json -"), folder.path());
        let stderr = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{command}: {stderr}");
        let value: Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(value["config"].is_string(), "{command}: {value}");
        assert!(stderr.lines().count() >= 2, "{command}: {stderr}");
        assert_eq!(contents(folder.path()).len(), 0, "{command}");
    }
    let picture = run("render builtin:cornell --size 8x8 --out -", folder.path());
    assert!(picture.stdout.starts_with(b"\x89PNG"));
    assert!(String::from_utf8_lossy(&picture.stderr).contains("picture: the standard output"));
    prints("stats builtin:cornell --size 8x8 --json ./-", folder.path());
    assert_eq!(json(&folder.path().join("-"))["scene"], "cornell");
    assert_eq!(
        fault("render builtin:cornell --out - --json -", folder.path()),
        "-: is the standard output, which can hold only one output; give the other one a file name"
    );
    assert_eq!(
        fault("generate --out -", folder.path()),
        "-: is the standard output, which cannot hold this output; give a file name (./- for a file named -)"
    );
}

#[test]
fn a_run_that_fails_leaves_all_its_outputs_as_they_were() {
    let folder = folder();
    let at = |name: &str| folder.path().join(name);
    for name in ["a.png", "a.json"] {
        fs::write(at(name), "earlier").unwrap();
    }
    let check = |command: &str| {
        let output = run(command, folder.path());
        assert_eq!(output.status.code(), Some(1), "{command}");
        for name in ["a.png", "a.json"] {
            assert_eq!(
                fs::read_to_string(at(name)).unwrap(),
                "earlier",
                "{command}: {name}"
            );
        }
        assert_eq!(contents(folder.path()).len(), 2, "{command}");
    };
    check("render builtin:nonesuch --out a.png --json a.json");
    if Path::new("/dev/full").exists() {
        check("render builtin:cornell --size 8x8 --out a.png --json a.json --heatmap /dev/full");
        check("animate builtin:cornell --size 8x8 --out film/a --json a.json --gif /dev/full");
    }
}

#[test]
fn an_output_does_not_lie_in_a_folder_that_is_replaced() {
    let folder = folder();
    fs::create_dir(folder.path().join("film")).unwrap();
    assert_eq!(
        fault(
            "animate builtin:water --out film --gif film/a.gif",
            folder.path()
        ),
        "film/a.gif: is in film, which is replaced as a whole; give it another place"
    );
}
