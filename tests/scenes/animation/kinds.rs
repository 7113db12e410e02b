//! Kinds of glTF files by other programs: the parts that are read, and messages about the others.

use super::{File, base64, close, corner, fault, fault_of, one_line, write};
use dynrt::float::Format;
use dynrt::scene::animation::{IDENTITY, MachineScene, Matrix3x4, Overrides, Pose};
use dynrt::scene::{Animated, Mesh, load_animated};
use serde_json::{Value, json};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;
use std::time::{Duration, Instant};

impl File {
    /// A scene that cannot be shown at all times.
    fn load_unchecked(&self) -> Animated {
        let folder = tempfile::tempdir().unwrap();
        load_animated(write(&folder, "scene.gltf", self.text().as_bytes())).unwrap()
    }
}

fn world(scene: &Animated) -> Mesh {
    scene.world_mesh(&scene.pose(None, 0.0).unwrap())
}

fn triangle() -> Vec<[f64; 3]> {
    vec![[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
}

/// Adds an accessor without a buffer view.
fn nowhere(file: &mut File, kind: &str, component: u32, count: usize) -> usize {
    let accessors = file.json["accessors"].as_array_mut().unwrap();
    accessors.push(json!({"componentType": component, "count": count, "type": kind}));
    accessors.len() - 1
}

// ---- Parts that are read, and parts that are ignored -------------------------------------------------------------

#[test]
fn an_accessor_without_a_buffer_view_is_zeros() {
    // A morph target without displacements, and one with displacements.
    let mut file = File::triangle();
    let still = nowhere(&mut file, "VEC3", 5126, 3);
    let up = file.floats("VEC3", &[0.0, 0.0, 2.0].repeat(3));
    file.json["meshes"][0]["primitives"][0]["targets"] =
        json!([{"POSITION": still}, {"POSITION": up}]);
    file.json["meshes"][0]["weights"] = json!([1.0, 0.5]);
    let scene = file.load();
    assert_eq!(corner(&scene, None, 0.0, 1), [1.0, 0.0, 1.0]);
    assert!(scene.warnings.is_empty());
    file.json["accessors"][still]["count"] = json!(4);
    assert_eq!(
        file.fault(),
        ": mesh 0: primitive 0: morph target 0: has 4 elements for 3 vertices; export the file again"
    );
    file.json["accessors"][still] = json!({"componentType": 5126, "count": 3, "type": "SCALAR"});
    assert_eq!(
        file.fault(),
        ": mesh 0: primitive 0: morph target 0: accessor 1: has elements of type Scalar, where Vec3 belongs; export the file again"
    );

    // Unsupported attributes, and an unused accessor.
    let mut file = File::triangle();
    let zeros = nowhere(&mut file, "VEC3", 5126, 3);
    nowhere(&mut file, "VEC3", 5126, 3);
    file.json["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = json!(zeros);
    assert_eq!(world(&file.load()).positions, triangle());

    // Joints that are all the first, a track that leads to the origin, and indices that all name one vertex.
    let mut file = File::skinned();
    let joints = nowhere(&mut file, "VEC4", 5121, 3);
    file.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(joints);
    file.json["nodes"][1]["translation"] = json!([5, 0, 0]);
    file.channel("translation", 1, "STEP", &[0.0], "VEC3", &[9.0; 3]);
    let output = nowhere(&mut file, "VEC3", 5126, 1);
    file.json["animations"][0]["samplers"][0]["output"] = json!(output);
    let scene = file.load();
    assert_eq!(scene.objects[0].skin().unwrap().influences[2].joints[0], 0);
    assert_eq!(corner(&scene, None, 0.0, 2), [5.0, 1.0, 0.0]);
    assert_eq!(corner(&scene, Some(0), 0.0, 2), [0.0, 1.0, 0.0]);
    let matrices = nowhere(&mut file, "MAT4", 5126, 2);
    file.json["skins"][0]["inverseBindMatrices"] = json!(matrices);
    assert!(
        file.fault()
            .contains("inverse bind matrix 0: its matrix has the last row [0.0, 0.0, 0.0, 0.0]"),
        "{}",
        file.fault()
    );
    let mut file = File::triangle();
    file.json["accessors"][0]["count"] = json!(u64::MAX / 8);
    file.json["accessors"][0]
        .as_object_mut()
        .unwrap()
        .remove("bufferView");
    assert_eq!(
        file.fault(),
        ": mesh 0: primitive 0: POSITION: accessor 0: has 2305843009213693951 elements without a buffer; at most 5592405 may be so"
    );
}

/// Adds these members to all objects below, except for maps from names to accessors.
fn give_all(value: &mut Value, extras: &Value) {
    match value {
        Value::Array(all) => all.iter_mut().for_each(|value| give_all(value, extras)),
        Value::Object(fields) => {
            for (name, value) in fields.iter_mut() {
                if name != "attributes" && name != "targets" {
                    give_all(value, extras);
                }
            }
            fields.insert("extras".into(), extras.clone());
        }
        _ => {}
    }
}

#[test]
fn extras_may_be_any_json() {
    let mut file = File::skinned();
    file.channel("translation", 1, "LINEAR", &[0.0, 1.0], "VEC3", &[0.0; 6]);
    let expected = world(&file.load());
    for extras in [
        json!(1),
        json!("text"),
        json!(null),
        json!([1, {"a": []}]),
        json!(true),
        json!({"nested": {"extras": 2}}),
    ] {
        let mut given = File {
            json: file.json.clone(),
            bytes: file.bytes.clone(),
        };
        give_all(&mut given.json, &extras);
        let scene = given.load();
        assert_eq!(world(&scene), expected, "{extras}");
        assert!(scene.warnings.is_empty());
    }
}

#[test]
fn what_nothing_shown_uses_is_not_judged() {
    let mut file = File::skinned();
    file.channel("translation", 1, "LINEAR", &[0.0, 1.0], "VEC3", &[0.0; 6]);
    let expected = world(&file.load());
    let json = &mut file.json;
    let push = |list: &mut Value, more: Value| list.as_array_mut().unwrap().push(more);
    push(
        &mut json["accessors"],
        json!({"bufferView": 0, "componentType": 5130, "count": 1, "type": "VEC3"}),
    );
    push(
        &mut json["accessors"],
        json!({"bufferView": 99, "componentType": 5126, "count": 1, "type": "VEC3"}),
    );
    push(&mut json["accessors"], json!("nonsense"));
    push(
        &mut json["bufferViews"],
        json!({"buffer": 77, "byteLength": -1, "byteStride": "wide"}),
    );
    push(
        &mut json["buffers"],
        json!({"uri": 5, "byteLength": "long"}),
    );
    push(
        &mut json["meshes"],
        json!({"primitives": [{"attributes": {"POSITION": 99}, "mode": 12}]}),
    );
    push(&mut json["meshes"], json!(7));
    push(
        &mut json["skins"],
        json!({"joints": [400], "inverseBindMatrices": 5000}),
    );
    push(
        &mut json["nodes"],
        json!({"mesh": 1, "skin": 1, "rotation": [0, 0, 0, 0], "children": [90]}),
    );
    push(
        &mut json["nodes"],
        json!({"mesh": 5, "matrix": "none", "name": 3}),
    );
    push(&mut json["scenes"], json!({"nodes": [3, 4, 5]}));
    push(
        &mut json["animations"][0]["samplers"],
        json!({"input": 1000, "output": 2000, "interpolation": "ODD"}),
    );
    for view in json["bufferViews"].as_array_mut().unwrap() {
        view["target"] = json!(0);
    }
    json["asset"]["copyright"] = json!(["nobody"]);
    let scene = file.load();
    assert_eq!(world(&scene), expected);
    assert_eq!(
        scene.warnings,
        ["3 accessors are faulty, but nothing here reads them: accessors 6, 7, 8"]
    );
    assert_eq!(
        scene.node_names(),
        ["node 0", "root", "tip", "node 3", "node 4"]
    );
}

#[test]
fn what_is_used_is_judged() {
    type Change = fn(&mut File);
    let cases: [(Change, &str); 12] = [
        (
            |f| f.json["accessors"][0]["componentType"] = json!(5130),
            ": is not valid glTF: accessors[0].componentType: invalid value; export it again",
        ),
        (
            |f| f.json["bufferViews"][0]["byteStride"] = json!(8),
            ": mesh 0: primitive 0: POSITION: accessor 0: has elements of 12 bytes every 8 bytes; export the file again",
        ),
        (
            |f| f.json["bufferViews"][0]["byteStride"] = json!("wide"),
            ": mesh 0: primitive 0: POSITION: accessor 0: bufferView 0 has the byteStride \"wide\"; export the file again",
        ),
        // An index one beyond the end of each list is out of range.
        (
            |f| f.json["accessors"][0]["bufferView"] = json!(1),
            ": is not valid glTF: accessors[0].bufferView: index out of bounds; export it again",
        ),
        (
            |f| f.json["bufferViews"][0]["buffer"] = json!(1),
            ": is not valid glTF: bufferViews[0].buffer: index out of bounds; export it again",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["indices"] = json!(1),
            ": is not valid glTF: meshes[0].primitives[0].indices: index out of bounds; export it again",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["targets"] = json!([{"POSITION": 1}]),
            ": is not valid glTF: meshes[0].primitives[0].targets[0].positions: index out of bounds; export it again",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(1),
            ": mesh 0: primitive 0: has its POSITION in accessor 1, which is out of range (there are 1, counted from 0); export the file again",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["mode"] = json!(9),
            ": is not valid glTF: meshes[0].primitives[0].mode: invalid value; export it again",
        ),
        (
            |f| f.json["scene"] = json!(1),
            ": is not valid glTF: scene: index out of bounds; export it again",
        ),
        (
            |f| f.json["nodes"][0]["children"] = json!([1]),
            ": is not valid glTF: nodes[0].children[0]: index out of bounds; export it again",
        ),
        (
            |f| f.json["nodes"][0]["rotation"] = json!([0, 0, 0, "x"]),
            ": is not glTF: invalid type: string \"x\", expected f32; export it again",
        ),
    ];
    for (change, expected) in cases {
        let mut file = File::triangle();
        change(&mut file);
        assert_eq!(file.fault(), expected);
    }
}

#[test]
fn strides_of_any_size_are_read() {
    for stride in [0, 12, 13, 256, 1000] {
        let mut file = File::triangle();
        let mut bytes = Vec::new();
        for (number, position) in triangle().iter().enumerate() {
            bytes.resize(number * if stride == 0 { 12 } else { stride }, 0xff);
            bytes.extend(position.iter().flat_map(|&x| (x as f32).to_le_bytes()));
        }
        let view = file.data(&bytes);
        file.json["bufferViews"][view]["byteStride"] = json!(stride);
        file.json["accessors"][0]["bufferView"] = json!(view);
        assert_eq!(world(&file.load()).positions, triangle(), "{stride}");
    }
}

#[test]
fn primitives_without_positions_are_left_out() {
    let mut file = File::triangle();
    let mesh = &mut file.json["meshes"][0];
    mesh["name"] = json!("M");
    let primitives = mesh["primitives"].as_array_mut().unwrap();
    primitives.push(json!({"attributes": {"NORMAL": 0}, "indices": 44}));
    let scene = file.load();
    assert_eq!(world(&scene).positions, triangle());
    assert_eq!(
        scene.warnings,
        ["mesh M, primitive 1: left out, it is without POSITION"]
    );
    for without in [json!({}), json!({"attributes": null})] {
        file.json["meshes"][0]["primitives"][1] = without;
        let scene = file.load();
        assert_eq!(world(&scene).positions, triangle());
        assert_eq!(
            scene.warnings,
            ["mesh M, primitive 1: left out, it is without POSITION"]
        );
    }
    let primitives = file.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.push(json!({"attributes": {}}));
    let warnings = file.load().warnings;
    assert_eq!(
        warnings,
        ["mesh M: 2 primitives are left out, they are without POSITION; the first is primitive 1"]
    );
    let primitives = file.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.remove(0);
    assert_eq!(
        file.fault(),
        ": is an empty scene, nothing is left of it: mesh M: 2 primitives are left out, they are without POSITION; the first is primitive 0; export it with its meshes"
    );
}

// ---- Extensions -------------------------------------------------------------------------------------------------

fn instanced(attributes: Value) -> Value {
    json!({"EXT_mesh_gpu_instancing": {"attributes": attributes}})
}

fn matrices(scene: &Animated, clip: Option<usize>, seconds: f64) -> Vec<Matrix3x4> {
    let pose = scene.pose(clip, seconds).unwrap();
    pose.instances.into_iter().map(Option::unwrap).collect()
}

#[test]
fn gpu_instancing_is_read() {
    let mut file = File::triangle();
    let places = file.floats("VEC3", &[0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 6.0, 0.0, 0.0]);
    file.json["nodes"][0]["name"] = json!("crowd");
    file.json["nodes"][0]["extensions"] = instanced(json!({"TRANSLATION": places, "_ID": 99}));
    file.json["extensionsUsed"] = json!(["EXT_mesh_gpu_instancing"]);
    file.json["extensionsRequired"] = json!(["EXT_mesh_gpu_instancing"]);
    let scene = file.load();
    assert!(scene.warnings.is_empty(), "{:?}", scene.warnings);
    assert_eq!((scene.objects.len(), scene.instances.len()), (1, 3));
    assert_eq!(scene.instances[2].name, "crowd [2]");
    let at = |x: f64| {
        let mut matrix = IDENTITY;
        matrix[0][3] = x;
        matrix
    };
    assert_eq!(matrices(&scene, None, 0.0), [at(0.0), at(3.0), at(6.0)]);

    // Translation × rotation × scale, below a moving node: a quarter turn about z as a short, and as a byte.
    let scales = file.floats("VEC3", &[1.0, 1.0, 1.0, 2.0, 1.0, 1.0, 1.0, 3.0, 1.0]);
    for (component, greatest) in [(5122, 32767i32), (5120, 127)] {
        let turn = (f64::from(greatest) * 0.5f64.sqrt()).round() as i32 as u32;
        let one = greatest as u32;
        let rotations = [0, 0, 0, one, 0, 0, turn, turn, 0, 0, 0, one];
        let rotations = file.integers("VEC4", component, &rotations);
        file.json["accessors"][rotations]["normalized"] = json!(true);
        file.json["nodes"][0]["extensions"] =
            instanced(json!({"TRANSLATION": places, "ROTATION": rotations, "SCALE": scales}));
        file.json["animations"] = json!(null);
        file.json.as_object_mut().unwrap().remove("animations");
        file.channel(
            "translation",
            0,
            "LINEAR",
            &[0.0, 1.0],
            "VEC3",
            &[0.0, 0.0, 0.0, 0.0, 0.0, 8.0],
        );
        let scene = file.load();
        let found = matrices(&scene, Some(0), 0.5);
        // The corner (1, 0, 0) of the second is mapped to (0, 2, 0) and placed at 3; the corner (0, 1, 0) of the third to y = 3.
        let point =
            |instance: usize, p| dynrt::scene::animation::transform_point(&found[instance], p);
        assert!(
            close(point(1, [1.0, 0.0, 0.0]), [3.0, 2.0, 4.0]),
            "{found:?}"
        );
        assert!(
            close(point(1, [0.0, 1.0, 0.0]), [2.0, 0.0, 4.0]),
            "{found:?}"
        );
        assert!(
            close(point(2, [0.0, 1.0, 0.0]), [6.0, 3.0, 4.0]),
            "{found:?}"
        );
        assert!(
            close(point(0, [1.0, 0.0, 0.0]), [1.0, 0.0, 4.0]),
            "{found:?}"
        );
    }
    // Without a buffer view all instances are at the node.
    let zeros = nowhere(&mut file, "VEC3", 5126, 2);
    file.json["nodes"][0]["extensions"] = instanced(json!({"TRANSLATION": zeros}));
    assert_eq!(matrices(&file.load(), None, 0.0), [IDENTITY; 2]);
}

#[test]
fn faulty_gpu_instancing_is_refused() {
    let mut file = File::triangle();
    let two = file.floats("VEC3", &[0.0; 6]);
    let zero = file.floats("VEC4", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0]);
    let many = nowhere(&mut file, "VEC3", 5126, 1 << 21);
    for (attributes, expected) in [
        (
            json!({"TRANSLATION": 0, "SCALE": two}),
            ": node 0: EXT_mesh_gpu_instancing: its attributes have 3 and 2 elements, which must be equal in number; export the file again",
        ),
        (
            json!({"TRANSLATION": 4}),
            ": node 0: EXT_mesh_gpu_instancing: TRANSLATION is not an accessor of the file (there are 4, counted from 0); export it again",
        ),
        (
            json!({"ROTATION": two}),
            ": node 0: EXT_mesh_gpu_instancing: ROTATION: accessor 1: has elements of type Vec3, where Vec4 belongs; export the file again",
        ),
        (
            json!({"ROTATION": zero}),
            ": node 0: EXT_mesh_gpu_instancing: ROTATION: element 1 is not a rotation: [0, 0, 0, 0]; correct it",
        ),
        (
            json!({"TRANSLATION": many}),
            ": node 0: EXT_mesh_gpu_instancing: TRANSLATION: has 2097152 instances; at most 1048576 can be shown: export fewer",
        ),
    ] {
        file.json["nodes"][0]["extensions"] = instanced(attributes);
        assert_eq!(file.fault(), expected);
    }
    // Without attributes it defines no instances.
    let mut file = File::triangle();
    for without in [json!(5), json!({}), json!({"attributes": []})] {
        file.json["nodes"][0]["extensions"] = json!({"EXT_mesh_gpu_instancing": without});
        let scene = file.load();
        assert_eq!(matrices(&scene, None, 0.0), [IDENTITY]);
        assert_eq!(
            scene.warnings,
            ["node 0: its EXT_mesh_gpu_instancing is without attributes: the mesh is shown once"]
        );
    }
    // A skinned mesh has no place, so instancing has no effect.
    let mut file = File::skinned();
    file.json["nodes"][0]["extensions"] = instanced(json!({"TRANSLATION": 0}));
    let scene = file.load();
    assert_eq!(scene.instances.len(), 1);
    assert_eq!(
        scene.warnings,
        [
            "node 0: its EXT_mesh_gpu_instancing is not read, since a skinned mesh ignores its node's place: the mesh is shown once"
        ]
    );
}

#[test]
fn hidden_nodes_are_not_shown() {
    let hidden = json!({"KHR_node_visibility": {"visible": false}});
    let mut file = File::triangle();
    file.json["scenes"][0]["nodes"] = json!([0, 1, 3]);
    file.json["nodes"] = json!([
        {"mesh": 0},
        {"name": "group", "children": [2], "extensions": hidden},
        {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": true}}},
        {"mesh": 0, "name": "also", "extensions": {"KHR_node_visibility": {}}},
    ]);
    file.json["extensionsUsed"] = json!(["KHR_node_visibility"]);
    file.json["extensionsRequired"] = json!(["KHR_node_visibility"]);
    let scene = file.load();
    let names: Vec<&str> = scene.instances.iter().map(|i| i.name.as_str()).collect();
    assert_eq!(names, ["node 0", "also"]);
    assert_eq!(
        scene.warnings,
        ["1 node is hidden by KHR_node_visibility, with all that is below: group"]
    );
    // A scene with only hidden nodes is shown, because an unsupported motion may make them appear.
    file.json["scenes"][0]["nodes"] = json!([1]);
    let scene = file.load();
    assert_eq!(scene.instances.len(), 1);
    assert_eq!(
        scene.warnings,
        [
            "1 node is hidden by KHR_node_visibility, with all that is below: group; nothing else is in the scene, so it is shown all the same"
        ]
    );
}

#[test]
fn extensions_that_are_not_read_are_named() {
    let mut file = File::triangle();
    file.json["extensionsUsed"] = json!([
        "KHR_materials_unlit",
        "KHR_lights_punctual",
        "KHR_texture_transform",
        "KHR_mesh_quantization",
        "MSFT_lod",
        "XYZ_hair",
        "XYZ_paint",
        "KHR_animation_pointer",
    ]);
    file.json["materials"] = json!([{"extensions": {"XYZ_paint": {}, "KHR_materials_unlit": {}}}]);
    file.json["nodes"][0]["extensions"] = json!({"MSFT_lod": {"ids": [1]}, "XYZ_undeclared": 1});
    assert_eq!(
        file.load().warnings,
        [
            "uses MSFT_lod (at 1 object of the file), which is not read here: of several levels of detail only the first is shown",
            "uses XYZ_hair, which is not read here: its effect on shapes, instances, positions or motion is missing",
            "uses XYZ_undeclared (at 1 object of the file), which is not read here: its effect on shapes, instances, positions or motion is missing",
        ]
    );

    // Channels that do not move a property of a node.
    let mut file = File::triangle();
    file.channel("translation", 0, "LINEAR", &[0.0, 2.0], "VEC3", &[0.0; 6]);
    let channels = file.json["animations"][0]["channels"]
        .as_array_mut()
        .unwrap();
    let pointer = |to: &str| json!({"sampler": 0, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {"pointer": to}}}});
    channels.insert(0, pointer("/nodes/0/scale"));
    channels.insert(0, json!({"sampler": 0, "target": {"path": "scale"}}));
    channels.insert(
        0,
        json!({"sampler": 0, "target": {"path": "weights", "node": 0}}),
    );
    channels.push(pointer("/materials/0/emissiveFactor"));
    let scene = file.load();
    assert_eq!(scene.clips[0].seconds, 2.0);
    assert_eq!(
        scene.warnings,
        [
            "2 animation channels are left out: KHR_animation_pointer is not read here, so that `/nodes/0/scale` and others stay as they are",
            "1 animation channel is left out, without a node to move",
            "1 animation channel is left out: the node has no morph targets that the weights could blend",
        ]
    );
    // Remaining channels are named by their numbers in the file.
    file.json["animations"][0]["channels"][3]["target"]["node"] = json!(8);
    assert_eq!(
        file.fault(),
        ": animation 0 (translation LINEAR), channel 3: moves node 8, which is out of range (there are 1, counted from 0); export the file again"
    );
}

#[test]
fn compressed_vertices_are_not_taken_for_zeros() {
    let draco =
        json!({"KHR_draco_mesh_compression": {"bufferView": 0, "attributes": {"POSITION": 0}}});
    let mut file = File::triangle();
    file.json["extensionsUsed"] = json!(["KHR_draco_mesh_compression"]);
    file.json["meshes"][0]["primitives"][0]["extensions"] = draco;
    let scene = file.load();
    assert_eq!(world(&scene).positions, triangle());
    assert_eq!(
        scene.warnings,
        [
            "uses KHR_draco_mesh_compression (at 1 object of the file), which is not read here: the uncompressed vertices are shown instead"
        ]
    );
    file.json["accessors"][0]
        .as_object_mut()
        .unwrap()
        .remove("bufferView");
    assert_eq!(
        file.fault(),
        ": mesh 0: primitive 0: its vertices are compressed by KHR_draco_mesh_compression, which cannot be read here; export it without (uncompressed)"
    );

    // A second buffer without data is the fallback of a compressed one; only the first can be the binary chunk.
    let mut file = File::triangle();
    file.json["extensionsUsed"] = json!(["EXT_meshopt_compression"]);
    file.json["bufferViews"][0] = json!({"buffer": 1, "byteLength": 36, "extensions": {
        "EXT_meshopt_compression": {"buffer": 0, "byteLength": 20, "byteStride": 12, "mode": "ATTRIBUTES", "count": 3}
    }});
    let buffers = file.json["buffers"].as_array_mut().unwrap();
    buffers.push(
        json!({"byteLength": 36, "extensions": {"EXT_meshopt_compression": {"fallback": true}}}),
    );
    for (name, bytes) in [
        ("scene.glb", file.binary()),
        ("scene.gltf", file.text().into_bytes()),
    ] {
        assert_eq!(
            fault_of(name, &bytes),
            ": mesh 0: primitive 0: POSITION: accessor 0: buffer 1 has no data (EXT_meshopt_compression's fallback?); export it without compression"
        );
    }
    file.json["buffers"][1]["uri"] = json!(format!("data:;base64,{}", base64(&file.bytes)));
    let scene = file.load();
    assert_eq!(world(&scene).positions, triangle());
    assert_eq!(scene.warnings.len(), 1, "{:?}", scene.warnings);
    assert!(
        scene.warnings[0].starts_with("uses EXT_meshopt_compression (at 2 objects of the file), ")
    );
}

// ---- Containers -------------------------------------------------------------------------------------------------

#[test]
fn what_is_around_the_json_is_passed_over() {
    let file = File::skinned();
    let expected = world(&file.load());
    let folder = tempfile::tempdir().unwrap();
    let bom = "\u{feff}";
    for (before, after) in [
        (bom, ""),
        ("", "\0\0\0"),
        ("", " \r\n\0 "),
        (bom, "\n\0"),
        (" \n", "\t"),
    ] {
        let text = format!("{before}{}{after}", file.text());
        let scene = load_animated(write(&folder, "a.gltf", text.as_bytes())).unwrap();
        assert_eq!(world(&scene), expected, "{before:?} {after:?}");
        let binary = binary_with(&file, before, after);
        let scene = load_animated(write(&folder, "a.glb", &binary)).unwrap();
        assert_eq!(world(&scene), expected, "{before:?} {after:?}");
    }
    for after in ["}", "\0{}", "x"] {
        let line = fault_of("a.gltf", format!("{}{after}", file.text()).as_bytes());
        assert!(
            line.starts_with(": is not glTF: trailing characters at line 1 column "),
            "{line}"
        );
        assert!(fault_of("a.glb", &binary_with(&file, "", after)).contains("trailing characters"));
    }
    assert!(fault_of("a.gltf", &[0; 8]).starts_with(": is not glTF: EOF while parsing"));
}

/// A binary file with other bytes before and after the JSON.
fn binary_with(file: &File, before: &str, after: &str) -> Vec<u8> {
    let whole = file.binary();
    let length = u32::from_le_bytes(whole[12..16].try_into().unwrap()) as usize;
    let mut json = before.as_bytes().to_vec();
    json.extend(&whole[20..20 + length]);
    json.extend(after.as_bytes());
    let mut bytes = whole[..12].to_vec();
    bytes.extend((json.len() as u32).to_le_bytes());
    bytes.extend(b"JSON");
    bytes.extend(&json);
    bytes.extend(&whole[20 + length..]);
    let length = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    bytes
}

#[test]
fn data_uris_are_those_of_rfc_2397() {
    let mut file = File::triangle();
    let plain = base64(&file.bytes);
    let percent =
        |text: &str| -> String { text.bytes().map(|byte| format!("%{byte:02x}")).collect() };
    let raw: String = file
        .bytes
        .iter()
        .map(|byte| format!("%{byte:02X}"))
        .collect();
    let broken: String = (plain.as_bytes().chunks(7))
        .map(|part| format!(" {}\r\n\t", std::str::from_utf8(part).unwrap()))
        .collect();
    for uri in [
        format!("data:application/octet-stream;base64,{plain}"),
        format!("data:;base64,{plain}"),
        format!("DATA:application/gltf-buffer;charset=utf-8;BASE64,{plain}"),
        format!("data:a/b; base64 ,{plain}"),
        format!("data:;base64,{}", percent(&plain)),
        format!("data:;base64,{broken}"),
        format!(
            "data:;base64,{}",
            plain.replace('/', "%2F").replace('+', "%2b")
        ),
        format!("data:,{raw}"),
        format!("data:text/plain;charset=latin1,{raw}"),
    ] {
        file.json["buffers"][0] = json!({"uri": uri, "byteLength": 36});
        assert_eq!(world(&file.load()).positions, triangle(), "{uri}");
    }
    // Padding may be missing, and bits after the last byte are ignored.
    for (uri, length) in [
        ("data:;base64,AAAA", 3),
        ("data:;base64,AA", 1),
        ("data:;base64,AB==", 1),
        ("data:,ab%20c", 4),
        ("data:,", 0),
    ] {
        file.json["buffers"][0] = json!({"uri": uri, "byteLength": 36});
        assert_eq!(
            file.fault(),
            format!(
                ": mesh 0: primitive 0: POSITION: accessor 0: buffer 0 has {length} bytes, not 36; export the file again"
            ),
            "{uri}"
        );
    }
    for (uri, expected) in [
        ("data:;base64", "is a data URI without data"),
        (
            "data:;base64,A*AA",
            "is not base64: Invalid symbol 42, offset 1.",
        ),
        (
            "https://a.b/c",
            "`https://a.b/c` is not a file in the same folder; put it there",
        ),
    ] {
        file.json["buffers"][0] = json!({"uri": uri, "byteLength": 36});
        let line = file.fault();
        assert!(line.contains(expected), "{line}");
    }
}

// ---- Absent instances -------------------------------------------------------------------------------------------

fn warnings_of(scene: &Animated, clip: Option<usize>, times: &[f64]) -> Vec<String> {
    let poses: Vec<Pose> = times
        .iter()
        .map(|&t| scene.pose(clip, t).unwrap())
        .collect();
    scene.warnings_of(&poses)
}

#[test]
fn an_instance_of_scale_zero_is_not_there() {
    let mut file = File::triangle();
    file.json["scenes"][0]["nodes"] = json!([0, 1]);
    file.json["nodes"] = json!([
        {"mesh": 0, "name": "Ghost"},
        {"mesh": 0, "translation": [2, 0, 0]},
    ]);
    file.channel(
        "scale",
        0,
        "LINEAR",
        &[0.0, 1.0],
        "VEC3",
        &[0.0, 0.0, 0.0, 1.0, 1.0, 1.0],
    );
    // Flattened on one axis, it has no inverse either.
    file.channel(
        "scale",
        0,
        "STEP",
        &[0.0, 1.0],
        "VEC3",
        &[1.0, 0.0, 1.0, 1.0, 1.0, 1.0],
    );
    let scene = file.load_unchecked();
    let there = |clip, seconds| {
        let pose = scene.pose(Some(clip), seconds).unwrap();
        let mesh = scene.world_mesh(&pose);
        (
            pose.instances
                .iter()
                .map(Option::is_some)
                .collect::<Vec<_>>(),
            mesh,
        )
    };
    let (instances, mesh) = there(0, 0.0);
    assert_eq!(instances, [false, true]);
    assert_eq!(
        mesh.positions,
        [[2.0, 0.0, 0.0], [3.0, 0.0, 0.0], [2.0, 1.0, 0.0]]
    );
    assert_eq!(there(0, 0.001).0, [true, true]);
    assert_eq!(there(1, 0.5).0, [false, true]);
    assert_eq!(there(1, 1.0).0, [true, true]);
    assert_eq!(
        scene.extents(Some(0), &[0.0]).unwrap().world,
        ([2.0, 0.0, 0.0], [3.0, 1.0, 0.0])
    );
    assert_eq!(
        warnings_of(&scene, Some(0), &[0.0, 0.5, 1.0]),
        [
            "scene scene: instances are left out where a scale of 0 makes their matrix singular: Ghost in 1 of 3 frames"
        ]
    );
    assert!(warnings_of(&scene, Some(0), &[0.5, 1.0]).is_empty());

    // A film that begins without instances, and one without any.
    file.json["scenes"][0]["nodes"] = json!([0]);
    let scene = file.load_unchecked();
    assert_eq!(
        warnings_of(&scene, Some(0), &[0.0, 1.0]),
        [
            "scene scene: instances are left out where a scale of 0 makes their matrix singular: Ghost in 1 of 2 frames",
            "scene scene: nothing is left to show in 1 of 2 frames: no rays are cast there"
        ]
    );
    assert!(scene.extents(Some(0), &[0.0, 1.0]).is_ok());
    assert_eq!(
        one_line(&scene.extents(Some(0), &[0.0]).unwrap_err()),
        "scene scene: nothing is shown in any frame: a scale of 0 makes the matrix of every instance singular (Ghost); give their nodes, and those above them, other scales, or show another time"
    );

    // A flat parent makes a rotated child singular up to rounding.
    let mut file = File::triangle();
    file.json["nodes"] = json!([
        {"children": [1], "scale": [1, 0, 1], "rotation": [0.2, 0.4, 0.4, 0.8]},
        {"mesh": 0, "rotation": [0.4, 0.2, 0.8, 0.4]},
    ]);
    assert_eq!(
        file.load_unchecked().pose(None, 0.0).unwrap().instances,
        [None]
    );
    // Only the first few of many are named; instances of an extension can be hidden one by one.
    let mut file = File::triangle();
    let scales = file.floats("VEC3", &[[0.0; 15].as_slice(), &[1.0; 3]].concat());
    file.json["nodes"][0]["extensions"] = instanced(json!({"SCALE": scales}));
    let warnings = warnings_of(&file.load_unchecked(), None, &[0.0]);
    assert_eq!(
        warnings,
        [
            "scene scene: instances are left out where a scale of 0 makes their matrix singular: node 0 [0] in all frames, node 0 [1] in all frames, node 0 [2] in all frames, node 0 [3] in all frames and 1 more"
        ]
    );

    // Bones may have any scale: the vertices that follow them shrink to a point and remain.
    let mut file = File::skinned();
    file.json["nodes"][1]["scale"] = json!([0, 0, 0]);
    file.json["nodes"][0]["scale"] = json!([0, 0, 0]);
    let scene = file.load_unchecked();
    let pose = scene.pose(None, 0.0).unwrap();
    assert_eq!(pose.instances, [Some(IDENTITY)]);
    assert_eq!(scene.world_mesh(&pose).positions, [[0.0; 3]; 3]);
    assert!(scene.warnings_of(&[pose]).is_empty());
}

// ---- Messages -----------------------------------------------------------------------------------------------------

#[test]
fn names_are_escaped_and_found_by_either_spelling() {
    let mut file = File::skinned();
    file.json["nodes"][2]["name"] = json!("tip\u{1b}[31m\n");
    file.json["meshes"][0]["name"] = json!("me\u{7}sh");
    let primitives = file.json["meshes"][0]["primitives"].as_array_mut().unwrap();
    primitives.push(json!({"attributes": {"POSITION": 0}, "mode": 1}));
    for name in ["go\r", r"go\r", "go\r"] {
        file.channel("translation", 2, "STEP", &[0.0], "VEC3", &[0.0, 4.0, 0.0]);
        let animations = file.json["animations"].as_array_mut().unwrap();
        animations.last_mut().unwrap()["name"] = json!(name);
    }
    let scene = file.load();
    let names: Vec<&str> = scene.clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, [r"go\r", r"go\r 2", r"go\r 3"]);
    assert_eq!(scene.clip(Some("go\r")).unwrap(), Some(0));
    assert_eq!(scene.clip(Some(r"go\r 2")).unwrap(), Some(1));
    assert_eq!(scene.clip(Some("go\r 3")).unwrap(), Some(2));
    assert_eq!(scene.node_names()[2], r"tip\u{1b}[31m\n");
    assert_eq!(
        scene.warnings,
        [r"mesh me\u{7}sh, primitive 1: left out, it is made of Lines, not of triangles"]
    );
    for spelling in ["tip\u{1b}[31m\n", r"tip\u{1b}[31m\n"] {
        let turn = Overrides::default().turn(spelling, [0.0, 0.0, 1.0], 1.0);
        assert!(scene.pose_with(None, 0.0, &turn).is_ok());
    }
    let unknown = one_line(&scene.clip(Some("\u{1b}[2J")).unwrap_err());
    assert!(
        unknown.starts_with(r"scene scene: no clip `\u{1b}[2J`; there are "),
        "{unknown}"
    );

    // Words of the file other than names, in errors.
    let mut file = File::triangle();
    file.json["extensionsRequired"] = json!(["X\u{1b}]0;title\u{7}"]);
    assert_eq!(
        file.fault(),
        r": requires X\u{1b}]0;title\u{7}, which cannot be read here; export it without (uncompressed)"
    );
    let mut file = File::triangle();
    file.json["buffers"][0] = json!({"uri": "no\nsuch%1b", "byteLength": 36});
    let line = file.fault();
    assert!(line.contains(r"no\nsuch\u{1b}; put it there"), "{line}");
    let mut file = File::triangle();
    file.json["asset"]["version"] = json!("\u{9b}1");
    assert_eq!(
        file.fault(),
        r": is glTF of version \u{9b}1; export it as glTF 2.0"
    );
}

/// The warnings about a scene at rest in the machine's number format.
fn precision(scene: &Animated) -> Vec<String> {
    let extents = scene.extents(None, &[0.0]).unwrap();
    let machine = MachineScene::new(scene, &extents, Format::FP24, 256).unwrap();
    machine.warnings(scene, &extents)
}

#[test]
fn what_the_format_cannot_hold_is_said_of_every_object_once() {
    // The same words as for a static mesh.
    let folder = tempfile::tempdir().unwrap();
    let obj =
        "v 1000000 0 0\nv 1000001 0 0\nv 1000000 1 0\nv 1000000 1 0.5\nf 1 2 3\nf 1 1 2\nf 1 4 2\n";
    let path = write(&folder, "far.obj", obj.as_bytes());
    let still = dynrt::scene::load(&path).unwrap();
    let mesh = dynrt::scene::MachineMesh::new(&still, Format::FP24).unwrap();
    let warnings = mesh.warnings(&still);
    assert_eq!(warnings.len(), 3, "{warnings:?}");
    assert_eq!(precision(&load_animated(&path).unwrap()), warnings);

    // Only objects with losses are named. A distant node affects the world, not its object.
    let mut file = File::triangle();
    let far = file.floats("VEC3", &[1e6, 0.0, 0.0, 1e6 + 1.0, 0.0, 0.0, 1e6, 1.0, 0.0]);
    let flat = file.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 1.0, 0.0, 2.0, 2.0, 0.0]);
    let tiny = file.floats("VEC3", &[0.0, 0.0, 1e-30, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
    let mesh = |name: &str, accessor: usize| json!({"name": name, "primitives": [{"attributes": {"POSITION": accessor}}]});
    file.json["meshes"] = json!([
        mesh("good", 0),
        mesh("far", far),
        mesh("flat", flat),
        mesh("tiny", tiny)
    ]);
    file.json["nodes"] = json!([{"mesh": 0}, {"mesh": 1}, {"mesh": 2}, {"mesh": 3}, {"mesh": 2}]);
    file.json["scenes"][0]["nodes"] = json!([0, 1, 2, 3, 4]);
    let format = Format::FP24;
    assert_eq!(
        precision(&file.load()),
        [
            "scene scene: 1 of 4 triangles have no area (1 of flat); remove them from the mesh, because they only cost time".to_string(),
            format!("scene scene: 1 of 4 triangles have no area once rounded to {format} (1 of far); a format with more fraction bits would keep them"),
            format!("scene scene: 1 coordinates are too small for {format} and became zero (1 of tiny); a format with more exponent bits would keep them"),
            format!("scene scene, far: lies 1000000 times its own size away from the origin, where {format} is coarse; move it to the origin"),
        ]
    );
    let mut file = File::triangle();
    file.json["nodes"][0]["translation"] = json!([1000, 0, 0]);
    assert_eq!(
        precision(&file.load()),
        [format!(
            "scene scene: lies 1001 times its own size away from the origin, where {format} is coarse; move it to the origin"
        )]
    );
    // A skinned object's vertices at rest have their own scale.
    let mut file = File::skinned();
    file.json["nodes"][1]["scale"] = json!([1e-6, 1e-6, 1e-6]);
    assert!(precision(&file.load()).is_empty());
}

// ---- Files that were changed at random --------------------------------------------------------------------------

thread_local! {
    static LARGEST: Cell<usize> = const { Cell::new(0) };
}

/// Records the largest allocation of a thread.
struct Watched;

// SAFETY: all calls are passed on to the system's allocator unchanged.
unsafe impl GlobalAlloc for Watched {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        LARGEST.with(|largest| largest.set(largest.get().max(layout.size())));
        // SAFETY: the caller fulfils the requirements of `GlobalAlloc`.
        unsafe { System.alloc(layout) }
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        LARGEST.with(|largest| largest.set(largest.get().max(layout.size())));
        // SAFETY: the caller fulfils the requirements of `GlobalAlloc`.
        unsafe { System.alloc_zeroed(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller fulfils the requirements of `GlobalAlloc`.
        unsafe { System.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        LARGEST.with(|largest| largest.set(largest.get().max(size)));
        // SAFETY: the caller fulfils the requirements of `GlobalAlloc`.
        unsafe { System.realloc(pointer, layout, size) }
    }
}

#[global_allocator]
static WATCHED: Watched = Watched;

/// All places in a document, as JSON pointers.
fn pointers(value: &Value, here: String, all: &mut Vec<String>) {
    match value {
        Value::Array(list) => {
            for (number, value) in list.iter().enumerate() {
                pointers(value, format!("{here}/{number}"), all);
            }
        }
        Value::Object(fields) => {
            for (name, value) in fields {
                pointers(value, format!("{here}/{name}"), all);
            }
        }
        _ => {}
    }
    all.push(here);
}

fn random_value(rng: &mut fastrand::Rng, others: &Value, pointers: &[String]) -> Value {
    match rng.u32(..14) {
        0 => json!(null),
        1 => json!(rng.bool()),
        2 => json!(rng.u32(..8)),
        3 => json!(-(rng.u32(..300) as i64)),
        4 => json!(rng.u32(..)),
        5 => json!(u64::MAX >> rng.u32(..64)),
        6 => json!(f64::from_bits(rng.u64(..))),
        7 => json!([]),
        8 => json!({}),
        9 => json!(["", "\u{1b}x\n", "VEC3", "LINEAR", "data:,x", "pointer"][rng.usize(..6)]),
        10 => json!([5120, 5121, 5122, 5123, 5125, 5126][rng.usize(..6)]),
        11 => json!(rng.u32(..100_000_000)),
        // A value from elsewhere in the file.
        _ => others
            .pointer(&pointers[rng.usize(..pointers.len())])
            .cloned()
            .unwrap_or_default(),
    }
}

/// Files that together use all supported features.
fn whole_files() -> [File; 3] {
    let mut skinned = File::skinned();
    let up = skinned.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    let still = nowhere(&mut skinned, "VEC3", 5126, 3);
    let indices = skinned.integers("SCALAR", 5123, &[0, 1, 2, 2, 1, 0]);
    skinned.json["meshes"][0]["primitives"][0]["targets"] =
        json!([{"POSITION": up}, {"POSITION": still}]);
    skinned.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
    skinned.channel(
        "translation",
        1,
        "CUBICSPLINE",
        &[0.0, 1.0],
        "VEC3",
        &[0.5; 18],
    );
    skinned.channel(
        "weights",
        0,
        "LINEAR",
        &[0.0, 1.0],
        "SCALAR",
        &[0.0, 0.0, 2.0, 1.0],
    );
    let mut crowd = File::triangle();
    let places = crowd.floats("VEC3", &[0.0, 0.0, 0.0, 3.0, 0.0, 0.0]);
    let turns = crowd.integers("VEC4", 5122, &[0, 0, 0, 32767, 0, 0, 23170, 23170]);
    crowd.json["nodes"] = json!([
        {"mesh": 0, "extensions": instanced(json!({"TRANSLATION": places, "ROTATION": turns, "SCALE": places}))},
        {"mesh": 0, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 4, 0, 0, 1], "children": [2]},
        {"mesh": 0, "extensions": {"KHR_node_visibility": {"visible": false}}},
    ]);
    crowd.json["scenes"][0]["nodes"] = json!([0, 1]);
    crowd.channel("scale", 0, "STEP", &[0.0, 1.0], "VEC3", &[1.0; 6]);
    let mut sparse = File::triangle();
    let places = sparse.data(&[1, 2]);
    let values: Vec<u8> = [4.0f32, 0.0, 0.0, 0.0, 6.0, 0.0]
        .iter()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    let values = sparse.data(&values);
    sparse.json["accessors"][0] = json!({
        "componentType": 5126, "count": 3, "type": "VEC3",
        "sparse": {
            "count": 2,
            "indices": {"bufferView": places, "componentType": 5121},
            "values": {"bufferView": values},
        },
    });
    sparse.json["extensionsUsed"] = json!(["KHR_animation_pointer", "MSFT_lod"]);
    [skinned, crowd, sparse]
}

#[test]
fn files_changed_at_random_become_a_scene_or_one_line() {
    const ROUNDS: usize = 6000;
    // A frame has only a few vertices, so a larger allocation follows from a claim of the file.
    const MOST_BYTES: usize = 256 << 20;
    let seed =
        std::env::var("SEED").map_or_else(|_| fastrand::u64(..), |seed| seed.parse().unwrap());
    println!("SEED={seed}");
    let mut rng = fastrand::Rng::with_seed(seed);
    let folder = tempfile::tempdir().unwrap();
    let files = whole_files();
    let (mut read, mut refused) = (0, 0);
    for round in 0..ROUNDS {
        let file = &files[rng.usize(..files.len())];
        let mut changed = File {
            json: file.json.clone(),
            bytes: file.bytes.clone(),
        };
        let mut places = Vec::new();
        pointers(&file.json, String::new(), &mut places);
        for _ in 0..rng.usize(1..3) {
            let place = &places[rng.usize(..places.len())];
            let value = random_value(&mut rng, &file.json, &places);
            match place.rsplit_once('/') {
                Some((parent, key)) if rng.u32(..4) == 0 => {
                    let parent = changed.json.pointer_mut(parent);
                    if let Some(Value::Object(fields)) = parent {
                        fields.remove(key);
                    }
                }
                _ if place.is_empty() => {}
                _ => {
                    if let Some(old) = changed.json.pointer_mut(place) {
                        *old = value;
                    }
                }
            }
        }
        if rng.bool() {
            let place = rng.usize(..changed.bytes.len());
            changed.bytes[place] = rng.u8(..);
        }
        let is_list = changed.json["buffers"].get(0).is_some_and(Value::is_object);
        let text = match is_list {
            true => changed.text(),
            false => changed.json.to_string(),
        };
        let path = write(&folder, "a.gltf", text.as_bytes());
        LARGEST.set(0);
        let began = Instant::now();
        match load_animated(&path) {
            Err(error) => {
                let line = one_line(&error);
                assert!(
                    !line.chars().any(char::is_control),
                    "round {round}: {line:?}"
                );
                refused += 1;
            }
            Ok(scene) => {
                read += 1;
                for clip in (0..scene.clips.len()).map(Some).chain([None]) {
                    for seconds in [0.0, 0.5] {
                        match scene.pose(clip, seconds) {
                            Ok(pose) => drop(scene.extents_of(&[pose]).map_err(|e| one_line(&e))),
                            Err(error) => drop(one_line(&error)),
                        }
                    }
                }
            }
        }
        let (took, largest) = (began.elapsed(), LARGEST.get());
        assert!(
            took < Duration::from_secs(60),
            "round {round} took {took:?}: {text}"
        );
        assert!(
            largest < MOST_BYTES,
            "round {round} wanted {largest} bytes: {text}"
        );
    }
    println!("{read} read, {refused} refused");
    assert!(
        read > ROUNDS / 20 && refused > ROUNDS / 20,
        "{read} read, {refused} refused"
    );
    // Without a change all of them are read.
    for file in &files {
        let path = write(&folder, "a.gltf", file.text().as_bytes());
        load_animated(&path).unwrap();
    }
    assert!(fault(folder.path().join("b.gltf").to_str().unwrap()).contains("no such file"));
}

#[cfg(unix)]
#[test]
fn buffers_are_regular_files_of_any_name() {
    use std::os::unix::ffi::OsStrExt;
    let folder = tempfile::tempdir().unwrap();
    let mut file = File::triangle();
    let scene = |file: &File| load_animated(write(&folder, "s.gltf", file.text().as_bytes()));
    let name = std::ffi::OsStr::from_bytes(b"na\xffme.bin");
    std::fs::write(folder.path().join(name), &file.bytes).unwrap();
    file.json["buffers"][0] = json!({"uri": "na%FFme.bin", "byteLength": file.bytes.len()});
    assert_eq!(world(&scene(&file).unwrap()).positions, triangle());
    // Opening a pipe could wait forever, and reading a device could never end.
    let pipe = folder.path().join("pipe.bin");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    for (uri, place) in [
        ("pipe.bin", pipe.as_path()),
        ("/dev/zero", "/dev/zero".as_ref()),
    ] {
        file.json["buffers"][0]["uri"] = json!(uri);
        let error = format!("{:#}", scene(&file).unwrap_err());
        let expected = format!(
            "buffer 0: {}: cannot be read: it is not a regular file; give a file that can be",
            place.display()
        );
        assert!(error.ends_with(&expected), "{error}");
    }
    let pipe = folder.path().join("pipe.gltf");
    let made = std::process::Command::new("mkfifo").arg(&pipe).status();
    assert!(made.unwrap().success());
    assert_eq!(
        format!("{:#}", load_animated(&pipe).unwrap_err()),
        format!(
            "{}: cannot be read: it is not a regular file; give a file that can be",
            pipe.display()
        )
    );
}
