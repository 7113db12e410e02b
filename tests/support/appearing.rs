//! A scene whose instances appear and disappear.

use serde_json::json;
use std::path::Path;

/// Writes two instances of a triangle into a folder, as glTF; returns the path. The first is present in the frames in which its scale is
/// not 0, the second in those in which its own scale is not 0.
pub fn write_appearing(folder: &Path, first: &[f32], second: &[f32]) -> String {
    let mut bytes: Vec<u8> = Vec::new();
    let mut add = |numbers: &[f32]| {
        let at = bytes.len();
        bytes.extend(numbers.iter().flat_map(|x| x.to_le_bytes()));
        json!({"buffer": 0, "byteOffset": at, "byteLength": bytes.len() - at})
    };
    let times: Vec<f32> = (0..=first.len()).map(|frame| frame as f32).collect();
    let scales = |of: &[f32]| -> Vec<f32> {
        let of = of.iter().chain(of.last());
        of.flat_map(|&scale| [scale; 3]).collect()
    };
    let views = [
        add(&[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.5]),
        add(&times),
        add(&scales(first)),
        add(&scales(second)),
    ];
    let accessor = |view: usize, count: usize, kind: &str| json!({"bufferView": view, "componentType": 5126, "count": count, "type": kind});
    let keys = times.len();
    let sampler = |output: usize| json!({"input": 1, "output": output, "interpolation": "STEP"});
    let channel = |node: usize| json!({"sampler": node, "target": {"node": node, "path": "scale"}});
    std::fs::write(folder.join("a.bin"), &bytes).unwrap();
    let file = json!({
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0, 1]}],
        "nodes": [{"mesh": 0}, {"mesh": 0, "translation": [2, 0, 0]}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
        "accessors": [
            accessor(0, 3, "VEC3"),
            accessor(1, keys, "SCALAR"),
            accessor(2, keys, "VEC3"),
            accessor(3, keys, "VEC3"),
        ],
        "animations": [{"samplers": [sampler(2), sampler(3)], "channels": [channel(0), channel(1)]}],
        "bufferViews": views,
        "buffers": [{"byteLength": bytes.len(), "uri": "a.bin"}],
    });
    let path = folder.join("a.gltf");
    std::fs::write(&path, file.to_string()).unwrap();
    path.to_str().unwrap().to_string()
}
