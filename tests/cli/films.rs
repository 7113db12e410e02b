//! `dynrt pack` and `dynrt run` of animations.

use super::{contents, fault, prints};
use dynrt::chip::memory::Memory;
use dynrt::config::Config;
use dynrt::golden::chip::Chip;
use dynrt::vectors::sha256_of_bytes;
use serde_json::{Value, json};
use std::fs;

/// A host that has only the folder: the image at its load address, and a doorbell for each list of the manifest.
#[test]
fn a_packed_animation_needs_nothing_but_its_folder() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    for (scene, frames, levels) in [
        ("builtin:water?resolution=8", 3, 1),
        ("builtin:figure?detail=36 --clip wave --fps 3", 2, 1),
        ("builtin:reef --rebuild-above 1000", 2, 2),
    ] {
        let arguments =
            format!("pack {scene} --frames {frames} --size 24x18 --address 4096 --out image");
        let text = prints(&arguments, folder);
        let read = |name: &str| fs::read(folder.join("image").join(name)).unwrap();
        let manifest: Value = serde_json::from_slice(&read("manifest.json")).unwrap();
        let image = read("image.bin");
        assert_eq!(manifest["bytes"], image.len());
        assert_eq!(manifest["sha256"], sha256_of_bytes(&image));
        assert_eq!(manifest["levels"], levels);
        assert_eq!(manifest["load_address"], 4096);
        // The last line of image.hex holds the last bytes, the highest one first.
        let hex = String::from_utf8(read("image.hex")).unwrap();
        assert_eq!(hex.lines().count(), image.len() / 16);
        let last: String = (image[image.len() - 16..].iter().rev())
            .map(|byte| format!("{byte:02x}"))
            .collect();
        assert_eq!(hex.lines().last(), Some(&last[..]));
        // Parts follow each other, and the parts of the vertices are all of them.
        let number = |value: &Value| value.as_u64().unwrap();
        let mut end = 4096;
        for part in manifest["parts"].as_array().unwrap() {
            assert!(number(&part["address"]) >= end && number(&part["address"]) < end + 64);
            end = number(&part["address"]) + number(&part["bytes"]);
            assert!(text.contains(part["name"].as_str().unwrap()), "{text}");
        }
        let parts = manifest["parts"].as_array().unwrap();
        let vertices = parts.iter().find(|part| part["name"] == "vertices");
        let of_vertices = manifest["vertex_parts"].as_array().unwrap();
        let sum: u64 = of_vertices.iter().map(|part| number(&part["bytes"])).sum();
        assert_eq!(sum, number(&vertices.unwrap()["bytes"]));
        let mut memory = Memory::new(4096, image);
        let mut chip = Chip::new(&Config::reference());
        let shown = manifest["frames"].as_array().unwrap();
        assert_eq!(shown.len(), frames);
        let (mut moved, mut hits) = (0, 0);
        for frame in shown {
            let list = number(&frame["command_list"]) as u32;
            let outcome = chip.run(&mut memory, list, 1 << 10);
            outcome.check().unwrap();
            let bytes = number(&frame["result_bytes"]) as usize;
            let found = memory.read(number(&frame["result_address"]), bytes);
            let wanted = read(frame["result"].as_str().unwrap());
            assert!(found.unwrap() == wanted, "{scene}");
            assert_eq!(frame["result_sha256"], sha256_of_bytes(&wanted));
            assert_eq!(frame["hits"], outcome.hits);
            assert_eq!(frame["absent_instances"], json!([]));
            hits += outcome.hits;
            moved += outcome.vertices_skinned;
        }
        assert!(moved > 0 && hits > 0, "{scene}");
        assert_eq!(manifest["hits"], hits);
        let results = contents(&folder.join("image"));
        let results = results.keys().filter(|name| name.ends_with(".bin"));
        assert_eq!(results.count(), frames + 1, "no results of earlier images");
    }
}

#[test]
fn animations_that_cannot_be_packed_or_run_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let water = "builtin:water?resolution=4 --frames 2 --size 8x8";
    for (arguments, wanted) in [
        (
            format!("pack {water} --memory-size 1000 --out a"),
            "scene water: triangle records does not fit: the image needs at least ",
        ),
        (
            format!("pack {water} --rays shadow --out a"),
            "--rays shadow: the frames of an animation are cast with the rays of the camera",
        ),
        (
            format!("pack {water} --rebuild-above 0.5 --out a"),
            "--rebuild-above 0.5: give a factor of at least 1",
        ),
        (
            "pack builtin:water --frames 0 --out a".into(),
            "--frames 0: give a whole number from 1 to 100000",
        ),
        (
            "pack builtin:cornell --clip walk --out a".into(),
            "scene cornell: no clip `walk`: this scene has no clips; leave the clip out",
        ),
        (
            format!("run {water} --rays diffuse"),
            "--rays diffuse: the frames of an animation are cast with the rays of the camera",
        ),
        (
            format!("run {water} --out a.png"),
            "a.png: holds one picture, but there are 2; give --out a folder's name",
        ),
        (
            format!("run {water} --out -"),
            "the standard output: holds one picture, but there are 2; give --out a folder's name",
        ),
        (
            format!("run {water} --out a.gif"),
            "a.gif: the output is PNG; give it a name that ends in .png, not in .gif",
        ),
        (
            format!("run {water} --trace-events a.json"),
            "--trace-events: shows one frame, but there are 2; give --frames 1",
        ),
        (
            "run nowhere.glb".into(),
            "nowhere.glb: no such file; give a glTF or OBJ file, ",
        ),
    ] {
        let line = fault(&arguments, folder);
        assert!(line.starts_with(wanted), "dynrt {arguments}: {line}");
    }
}
