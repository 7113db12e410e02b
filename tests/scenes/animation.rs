//! Animated scenes: files, built-in scenes, and error messages.

mod kinds;

use crate::support::shared_scene;
use dynrt::float::Format;
use dynrt::scene::animation::{
    IDENTITY, Influences, Kind, MOST_INFLUENCES, Overrides, SEQUENCE_FRAMES_PER_SECOND,
    transform_point,
};
use dynrt::scene::{Animated, Bounds, load_animated, log2_scale};
use glam::DVec3;
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::PathBuf;

fn fault(spec: &str) -> String {
    match load_animated(spec) {
        Ok(scene) => panic!("{spec} loaded as {}", scene.name),
        Err(error) => one_line(&error),
    }
}

fn one_line(error: &anyhow::Error) -> String {
    let line = format!("{error:#}");
    assert!(!line.contains('\n'), "more than one line: {line}");
    line
}

fn close(a: [f64; 3], b: [f64; 3]) -> bool {
    DVec3::from(a).distance(b.into()) < 1e-6
}

/// Checks that a loaded scene has the documented properties, at some times of every clip.
fn assert_well_formed(scene: &Animated) {
    let name = &scene.name;
    assert!(
        !scene.objects.is_empty() && !scene.instances.is_empty(),
        "{name}"
    );
    for (number, object) in scene.objects.iter().enumerate() {
        let vertices = object.mesh.positions.len();
        assert!(!object.mesh.triangles.is_empty(), "{name}: {}", object.name);
        let indices = object.mesh.triangles.iter().flatten();
        assert!(
            indices
                .into_iter()
                .all(|&index| (index as usize) < vertices)
        );
        assert!(
            scene
                .instances
                .iter()
                .any(|instance| instance.object == number)
        );
        if let Some(skin) = object.skin() {
            assert_eq!(skin.influences.len(), vertices);
            assert_eq!(skin.joint_names.len(), skin.joint_count());
            for influences in &skin.influences {
                assert_influences(influences, skin.joint_count());
            }
        }
    }
    let clips = (0..scene.clips.len()).map(Some).chain([None]);
    for clip in clips {
        let times = clip.map_or(vec![0.0], |clip| scene.clips[clip].frame_times(5));
        for &seconds in &times {
            let pose = scene.pose(clip, seconds).unwrap();
            assert_eq!(pose.objects.len(), scene.objects.len());
            assert_eq!(pose.instances.len(), scene.instances.len());
            for (object, pose) in std::iter::zip(&scene.objects, &pose.objects) {
                assert_eq!(pose.positions.is_some(), object.is_written_by_host());
                if let Some(positions) = &pose.positions {
                    assert_eq!(positions.len(), object.mesh.positions.len());
                }
                assert_eq!(
                    pose.palette.len(),
                    object.skin().map_or(0, |s| s.joint_count())
                );
            }
            assert_eq!(scene.pose(clip, seconds).unwrap(), pose, "not repeatable");
        }
        // The box contains every vertex of every frame and touches some on each side.
        let extents = scene.extents(clip, &times).unwrap();
        let mut touched = [false; 6];
        for &seconds in &times {
            let pose = scene.pose(clip, seconds).unwrap();
            let mesh = scene.world_mesh(&pose);
            for &index in mesh.triangles.iter().flatten() {
                for axis in 0..3 {
                    let x = mesh.positions[index as usize][axis];
                    let (low, high) = (extents.world.0[axis], extents.world.1[axis]);
                    assert!(low <= x && x <= high, "{name}: {x} outside");
                    touched[2 * axis] |= x == low;
                    touched[2 * axis + 1] |= x == high;
                }
            }
        }
        assert_eq!(touched, [true; 6], "{name}: the box is too large");
        let exponent = log2_scale(extents.world, Format::FP24).unwrap();
        let (low, high) = extents.world;
        let greatest = low.iter().chain(&high).fold(0f64, |g, x| g.max(x.abs()));
        let scaled = greatest * f64::from(exponent).exp2();
        assert!(scaled > 128.0 && scaled <= 256.0, "{name}: {scaled}");
    }
}

fn assert_influences(influences: &Influences, joint_count: usize) {
    let count = influences.count();
    assert!((1..=MOST_INFLUENCES).contains(&count));
    let Influences { joints, weights } = influences;
    assert!((weights.iter().sum::<f64>() - 1.0).abs() < 1e-12);
    assert!(weights.is_sorted_by(|a, b| a >= b));
    for place in 0..MOST_INFLUENCES {
        assert_eq!(weights[place] > 0.0, place < count);
        assert!((joints[place] as usize) < joint_count);
        assert!(place < count || joints[place] == 0);
    }
}

/// The box over nine evenly spaced times from start to end, as in the sources' descriptions.
fn nine_times(scene: &Animated, clip: usize) -> Bounds {
    let times = (0..9).map(|i| scene.clips[clip].seconds * f64::from(i) / 8.0);
    let times: Vec<f64> = times.collect();
    scene.extents(Some(clip), &times).unwrap().world
}

fn assert_bounds(what: &str, (low, high): Bounds, expected: [f64; 6]) {
    for (found, expected) in low.iter().chain(&high).zip(expected) {
        let tolerance = 1e-5 * (1.0 + expected.abs());
        assert!(
            (found - expected).abs() < tolerance,
            "{what}: {found} instead of {expected}"
        );
    }
}

// ---- Files of the public scenes --------------------------------------------------------------------------------

#[test]
fn shared_scenes_have_the_counts_of_their_sources() {
    // File, objects, instances, triangles, joints of each skin, clips.
    type Counts = (&'static str, usize, usize, usize, &'static [usize], usize);
    let expected: [Counts; 9] = [
        ("fox/Fox.glb", 1, 1, 576, &[24], 3),
        ("cesium_man/CesiumMan.glb", 1, 1, 4672, &[19], 1),
        ("rigged_figure/RiggedFigure.glb", 1, 1, 256, &[19], 1),
        ("rigged_figure/RiggedSimple.glb", 1, 1, 188, &[2], 1),
        (
            "robot_expressive/RobotExpressive.glb",
            14,
            14,
            3237,
            &[43, 43],
            14,
        ),
        ("spider/Spider.glb", 1, 1, 2712, &[39], 5),
        ("hand/left.glb", 1, 1, 2314, &[25], 0),
        ("morph_simple/AnimatedMorphCube.glb", 1, 1, 12, &[], 1),
        ("morph_simple/AnimatedMorphSphere.glb", 1, 1, 960, &[], 1),
    ];
    for (file, objects, instances, triangles, joints, clips) in expected {
        let Some(path) = shared_scene(file) else {
            continue;
        };
        let scene = load_animated(&path).unwrap();
        assert_eq!(scene.objects.len(), objects, "{file}");
        assert_eq!(scene.instances.len(), instances, "{file}");
        assert_eq!(scene.triangle_count(), triangles, "{file}");
        let skins = scene.objects.iter().filter_map(|object| object.skin());
        let found: Vec<usize> = skins.map(|skin| skin.joint_count()).collect();
        assert_eq!(found, joints, "{file}");
        assert_eq!(scene.clips.len(), clips, "{file}");
        assert!(scene.warnings.is_empty(), "{file}: {:?}", scene.warnings);
        assert_well_formed(&scene);
    }
}

#[test]
fn shared_scenes_move_as_their_sources_say() {
    // The robot's boxes are from another program; its source's description has them without normalising weights, of which
    // 752 have a sum of up to 2.
    let expected: [(&str, &str, [f64; 6]); 7] = [
        (
            "fox/Fox.glb",
            "Survey",
            [-29.8998, -0.13094, -85.8559, 25.9158, 79.0933, 68.8203],
        ),
        (
            "fox/Fox.glb",
            "Run",
            [-16.7272, -2.48157, -97.4806, 16.9817, 75.9212, 75.1721],
        ),
        (
            "cesium_man/CesiumMan.glb",
            "0",
            [-0.507516, -0.0113405, -0.207759, 0.46233, 1.51902, 0.31068],
        ),
        (
            "robot_expressive/RobotExpressive.glb",
            "Dance",
            [-2.90375, -0.0203044, -1.28176, 2.87427, 4.58921, 1.98815],
        ),
        (
            "robot_expressive/RobotExpressive.glb",
            "Death",
            [-3.33757, -0.569982, -6.48173, 2.77420, 4.47651, 1.34611],
        ),
        (
            "spider/Spider.glb",
            "SpiderArmature|Spider_Walk",
            [-3.0104, -0.0348724, -2.35408, 3.05795, 2.22339, 2.70221],
        ),
        (
            "morph_simple/AnimatedMorphSphere.glb",
            "Globe",
            [-3.01816, -1.0, -3.23619, 3.01816, 1.0, 2.48201],
        ),
    ];
    for (file, clip, expected) in expected {
        let Some(path) = shared_scene(file) else {
            continue;
        };
        let scene = load_animated(&path).unwrap();
        let place = scene.clip(Some(clip)).unwrap().unwrap();
        assert_bounds(
            &format!("{file}, {clip}"),
            nine_times(&scene, place),
            expected,
        );
    }
}

#[test]
fn vertices_that_files_part_are_shared_again() {
    // The number of distinct positions, as counted in the sources' descriptions.
    for (file, vertices) in [
        ("fox/Fox.glb", 1728 - 1438),
        ("cesium_man/CesiumMan.glb", 3273 - 935),
        ("hand/left.glb", 1360 - 201),
        ("morph_simple/AnimatedMorphSphere.glb", 1876 - 1394),
    ] {
        let Some(path) = shared_scene(file) else {
            continue;
        };
        let scene = load_animated(&path).unwrap();
        assert_eq!(scene.objects[0].mesh.positions.len(), vertices, "{file}");
    }
}

#[test]
fn the_robot_has_every_kind_of_motion() {
    let Some(path) = shared_scene("robot_expressive/RobotExpressive.glb") else {
        return;
    };
    let scene = load_animated(&path).unwrap();
    let kind = |name: &str| {
        let object = scene.objects.iter().find(|object| object.name == name);
        &object.unwrap().kind
    };
    assert!(matches!(kind("Head"), Kind::Morphed));
    assert!(matches!(kind("Torso"), Kind::Static));
    assert!(matches!(kind("Hand.L"), Kind::Skinned(_)));
    let clip = scene.clip(Some("Dance")).unwrap();
    let (first, later) = (
        scene.pose(clip, 0.0).unwrap(),
        scene.pose(clip, 1.0).unwrap(),
    );
    for (number, instance) in scene.instances.iter().enumerate() {
        let skinned = scene.objects[instance.object].skin().is_some();
        let stands = first.instances[number] == later.instances[number];
        assert_eq!(
            skinned,
            first.instances[number] == Some(IDENTITY),
            "{}",
            instance.name
        );
        assert!(
            skinned || !stands || instance.name.starts_with("Foot"),
            "{}",
            instance.name
        );
        let palette =
            |pose: &dynrt::scene::animation::Pose| pose.objects[instance.object].palette.clone();
        assert!(!skinned || palette(&first) != palette(&later));
    }
}

#[test]
fn a_program_curls_the_fingers_of_the_hand() {
    let Some(path) = shared_scene("hand/left.glb") else {
        return;
    };
    let hand = load_animated(&path).unwrap();
    assert_eq!(hand.clip(None).unwrap(), None);
    let names = ["proximal", "intermediate", "distal"];
    let curled = |angle: f64| {
        let mut overrides = Overrides::default();
        for finger in ["index", "middle", "ring", "pinky"] {
            for part in names {
                let joint = format!("{finger}-finger-phalanx-{part}");
                overrides = overrides.turn(&joint, [1.0, 0.0, 0.0], angle);
            }
        }
        hand.pose_with(None, 0.0, &overrides).unwrap()
    };
    let unturned = hand.pose(None, 0.0).unwrap();
    for (a, b) in std::iter::zip(hand.vertices(&curled(0.0), 0), hand.vertices(&unturned, 0)) {
        assert!(close(a, b));
    }
    // The distance of a finger's tip from the wrist decreases step by step; the wrist and the thumb do not move.
    let skin = hand.objects[0].skin().unwrap();
    let joint = |name: &str| skin.joint_names.iter().position(|n| n == name).unwrap();
    let vertex_of = |joint: usize| {
        let strongest = |v: &usize| {
            let influences = &skin.influences[*v];
            let place = influences.joints.iter().position(|&j| j as usize == joint);
            place.map_or(0.0, |place| influences.weights[place])
        };
        let vertices = 0..skin.influences.len();
        vertices
            .max_by(|a, b| strongest(a).total_cmp(&strongest(b)))
            .unwrap()
    };
    let wrist = vertex_of(joint("wrist"));
    let thumb = vertex_of(joint("thumb-phalanx-distal"));
    let tip = vertex_of(joint("middle-finger-phalanx-distal"));
    let rest = hand.vertices(&curled(0.0), 0);
    let mut last = f64::INFINITY;
    for step in 0..4 {
        let vertices = hand.vertices(&curled(0.35 * f64::from(step)), 0);
        assert!(close(vertices[wrist], rest[wrist]) && close(vertices[thumb], rest[thumb]));
        let reach = DVec3::from(vertices[tip]).distance(vertices[wrist].into());
        assert!(reach < last, "step {step}: {reach} after {last}");
        last = reach;
    }
    // The same angle given as a rotation instead of a further turn.
    let name = "index-finger-tip";
    let whole = Overrides::default().rotate(name, [0.0, 0.0, 2.0, 0.0]);
    let pose = hand.pose_with(None, 0.0, &whole).unwrap();
    assert_ne!(
        pose.objects[0].palette[joint(name)],
        hand.pose(None, 0.0).unwrap().objects[0].palette[joint(name)]
    );
    let error =
        |overrides: Overrides| one_line(&hand.pose_with(None, 0.0, &overrides).unwrap_err());
    let unknown = error(Overrides::default().turn("sixth-finger", [1.0, 0.0, 0.0], 1.0));
    assert!(
        unknown.starts_with("scene left: no joint `sixth-finger`; there are `"),
        "{unknown}"
    );
    let none = error(Overrides::default().turn(name, [0.0; 3], 1.0));
    assert_eq!(
        none,
        "scene left: the rotation given for `index-finger-tip` is not a rotation"
    );
}

#[test]
fn a_sequence_plays_its_frames() {
    let Some(path) = shared_scene("wolf") else {
        return;
    };
    let wolf = load_animated(&path).unwrap();
    assert_eq!((wolf.name.as_str(), wolf.triangle_count()), ("wolf", 10018));
    assert_well_formed(&wolf);
    let clip = wolf.clip(Some("sequence")).unwrap();
    let times = wolf.clips[0].frame_times(11);
    for (frame, &seconds) in times.iter().enumerate() {
        let file = shared_scene(&format!("wolf/{:04}.obj", 2 * frame + 1)).unwrap();
        let mesh = dynrt::scene::load(&file).unwrap().mesh;
        let pose = wolf.pose(clip, seconds).unwrap();
        assert_eq!(pose.objects[0].positions.as_ref().unwrap(), &mesh.positions);
        assert_eq!(wolf.objects[0].mesh.triangles, mesh.triangles);
    }
}

// ---- Built-in scenes ------------------------------------------------------------------------------------------

#[test]
fn water_moves_every_vertex_and_returns() {
    let water = load_animated("builtin:water").unwrap();
    assert_well_formed(&water);
    assert!(
        water.triangle_count() >= 20_000,
        "{}",
        water.triangle_count()
    );
    assert!(water.objects[0].is_written_by_host());
    let clip = water.clip(Some("waves")).unwrap();
    let at = |seconds: f64| water.vertices(&water.pose(clip, seconds).unwrap(), 0);
    let seconds = water.clips[0].seconds;
    assert_eq!(at(0.0), at(seconds));
    assert_eq!(at(seconds), at(seconds + 1.0), "the end does not hold");
    let times = water.clips[0].frame_times(12);
    for pair in times.windows(2) {
        let moved = std::iter::zip(at(pair[0]), at(pair[1])).filter(|(a, b)| a != b);
        assert_eq!(moved.count(), water.objects[0].mesh.positions.len());
    }
    // No crest curls over: seen from above, every triangle shows its front.
    for &seconds in &times {
        let vertices = at(seconds);
        for triangle in &water.objects[0].mesh.triangles {
            let [a, b, c] = triangle.map(|i| DVec3::from(vertices[i as usize]));
            assert!((b - a).cross(c - a).y > 0.0, "{triangle:?} at {seconds} s");
        }
    }
    let small = load_animated("builtin:water?resolution=2").unwrap();
    assert_eq!(small.triangle_count(), 8);
}

#[test]
fn the_figure_is_one_closed_skin_that_walks_and_waves() {
    for (spec, least) in [
        ("builtin:figure", 10_000),
        ("builtin:figure?detail=36", 6000),
        ("builtin:figure?detail=63", 15_000),
        ("builtin:figure?detail=96", 30_000),
    ] {
        let figure = load_animated(spec).unwrap();
        assert!(
            figure.triangle_count() >= least,
            "{spec}: {}",
            figure.triangle_count()
        );
        let object = &figure.objects[0];
        let skin = object.skin().unwrap();
        assert!(skin.joint_count() >= 15);
        // Closed, without holes, and not inside out: each edge occurs once in each direction, and Euler's number is that of a sphere.
        let mut edges: HashMap<(u32, u32), u32> = HashMap::new();
        for &[a, b, c] in &object.mesh.triangles {
            assert!(a != b && b != c && c != a);
            for edge in [(a, b), (b, c), (c, a)] {
                *edges.entry(edge).or_default() += 1;
            }
        }
        for (&(a, b), &count) in &edges {
            assert!(
                count == 1 && edges.contains_key(&(b, a)),
                "{spec}: edge {a} {b}"
            );
        }
        let (vertices, triangles) = (object.mesh.positions.len(), object.mesh.triangles.len());
        assert_eq!(vertices + triangles - edges.len() / 2, 2, "{spec}");
        let volume: f64 = object
            .mesh
            .triangles
            .iter()
            .map(|t| {
                let [a, b, c] = t.map(|i| DVec3::from(object.mesh.positions[i as usize]));
                a.dot(b.cross(c)) / 6.0
            })
            .sum();
        assert!(
            volume > 0.04 && volume < 0.12,
            "{spec}: {volume} cubic metres"
        );
    }
    let figure = load_animated("builtin:figure").unwrap();
    assert_well_formed(&figure);
    let rest = figure.pose(None, 0.0).unwrap();
    for (posed, rest) in
        std::iter::zip(figure.vertices(&rest, 0), &figure.objects[0].mesh.positions)
    {
        assert!(close(posed, *rest), "the skin at rest moves");
    }
    let skin = figure.objects[0].skin().unwrap();
    let joint = |name: &str| skin.joint_names.iter().position(|n| n == name).unwrap();
    let mean = |clip: Option<usize>, seconds: f64, joint: usize| {
        let vertices = figure.vertices(&figure.pose(clip, seconds).unwrap(), 0);
        let of_joint = (0..vertices.len())
            .filter(|&v| skin.influences[v].joints[0] as usize == joint)
            .map(|v| DVec3::from(vertices[v]));
        let (sum, count) = of_joint.fold((DVec3::ZERO, 0.0), |(sum, n), v| (sum + v, n + 1.0));
        sum / count
    };
    let walk = figure.clip(Some("walk")).unwrap();
    let seconds = figure.clips[walk.unwrap()].seconds;
    let [left, right] = ["left_foot", "right_foot"].map(joint);
    let stride =
        |part: f64| mean(walk, part * seconds, left).z - mean(walk, part * seconds, right).z;
    assert!(
        stride(0.25) > 0.4 && stride(0.75) < -0.4,
        "{} {}",
        stride(0.25),
        stride(0.75)
    );
    for part in [0.0, 0.1, 0.35] {
        // The second half equals the first with the sides exchanged, except for the triangles.
        let error = stride(part) + stride(part + 0.5);
        assert!(error.abs() < 1e-2, "{error} at {part}");
        let repeated = mean(walk, seconds, left).distance(mean(walk, 0.0, left));
        assert!(repeated < 1e-9, "{repeated}");
    }
    let wave = figure.clip(Some("wave")).unwrap();
    for part in [0.0, 0.2, 0.9] {
        let seconds = part * figure.clips[wave.unwrap()].seconds;
        let raised =
            mean(wave, seconds, joint("right_hand")).y - mean(wave, seconds, joint("neck")).y;
        assert!(raised > 0.05, "the hand is {raised} above the neck");
    }
}

#[test]
fn what_stands_still_loads_too() {
    let scene = load_animated("builtin:sphere?level=1").unwrap();
    assert_well_formed(&scene);
    assert_eq!((scene.triangle_count(), scene.clips.len()), (80, 0));
    assert!(matches!(scene.objects[0].kind, Kind::Static));
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("one.OBJ");
    std::fs::write(&path, "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n").unwrap();
    let scene = load_animated(path.to_str().unwrap()).unwrap();
    assert_eq!((scene.name.as_str(), scene.triangle_count()), ("one", 1));
}

// ---- Small files made here ------------------------------------------------------------------------------------

/// A glTF file under construction: numbers are appended to one buffer, with one accessor each.
struct File {
    json: Value,
    bytes: Vec<u8>,
}

impl File {
    /// A scene of node 0 with mesh 0, a triangle with the positions (0 0 0), (1 0 0), (0 1 0) in accessor 0.
    fn triangle() -> Self {
        let mut file = File {
            json: json!({
                "asset": {"version": "2.0"},
                "scene": 0,
                "scenes": [{"nodes": [0]}],
                "nodes": [{"mesh": 0}],
                "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}],
                "accessors": [],
                "bufferViews": [],
                "buffers": [{}],
            }),
            bytes: Vec::new(),
        };
        file.floats("VEC3", &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0]);
        file
    }

    /// The triangle bound to nodes 1 and 2; at rest, node 2 is 1 above node 1.
    fn skinned() -> Self {
        let mut file = Self::triangle();
        let joints = file.integers("VEC4", 5121, &[0, 1, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0]);
        let weights = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
        let weights = file.floats("VEC4", &weights);
        let mut matrices = [0.0; 32];
        for i in 0..4 {
            matrices[5 * i] = 1.0;
            matrices[16 + 5 * i] = 1.0;
        }
        matrices[16 + 13] = -1.0;
        let matrices = file.floats("MAT4", &matrices);
        file.json["meshes"][0]["primitives"][0]["attributes"] =
            json!({"POSITION": 0, "JOINTS_0": joints, "WEIGHTS_0": weights});
        file.json["nodes"] = json!([
            {"mesh": 0, "skin": 0, "translation": [100, 0, 0]},
            {"name": "root", "children": [2]},
            {"name": "tip", "translation": [0, 1, 0]},
        ]);
        file.json["scenes"][0]["nodes"] = json!([0, 1]);
        file.json["skins"] = json!([{"joints": [1, 2], "inverseBindMatrices": matrices}]);
        file
    }

    fn data(&mut self, bytes: &[u8]) -> usize {
        while !self.bytes.len().is_multiple_of(4) {
            self.bytes.push(0);
        }
        let views = self.json["bufferViews"].as_array_mut().unwrap();
        views.push(json!({"buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len()}));
        self.bytes.extend(bytes);
        views.len() - 1
    }

    fn accessor(&mut self, kind: &str, component: u32, bytes: &[u8], size: usize) -> usize {
        let width = match kind {
            "SCALAR" => 1,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            _ => panic!("{kind}"),
        };
        let view = self.data(bytes);
        let accessors = self.json["accessors"].as_array_mut().unwrap();
        accessors.push(json!({
            "bufferView": view,
            "componentType": component,
            "count": bytes.len() / size / width,
            "type": kind,
        }));
        accessors.len() - 1
    }

    fn floats(&mut self, kind: &str, numbers: &[f32]) -> usize {
        let bytes: Vec<u8> = numbers.iter().flat_map(|x| x.to_le_bytes()).collect();
        self.accessor(kind, 5126, &bytes, 4)
    }

    fn integers(&mut self, kind: &str, component: u32, numbers: &[u32]) -> usize {
        let size = match component {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            _ => 4,
        };
        let low = |x: &u32| x.to_le_bytes()[..size].to_vec();
        let bytes: Vec<u8> = numbers.iter().flat_map(low).collect();
        self.accessor(kind, component, &bytes, size)
    }

    /// Adds a clip with one channel.
    fn channel(
        &mut self,
        path: &str,
        node: usize,
        how: &str,
        times: &[f32],
        kind: &str,
        values: &[f32],
    ) {
        let input = self.floats("SCALAR", times);
        let output = self.floats(kind, values);
        if self.json.get("animations").is_none() {
            self.json["animations"] = json!([]);
        }
        self.json["animations"].as_array_mut().unwrap().push(json!({
            "name": format!("{path} {how}"),
            "samplers": [{"input": input, "output": output, "interpolation": how}],
            "channels": [{"sampler": 0, "target": {"node": node, "path": path}}],
        }));
    }

    fn text(&self) -> String {
        let mut json = self.json.clone();
        if json["buffers"][0].get("uri").is_none() {
            json["buffers"][0] = json!({
                "byteLength": self.bytes.len(),
                "uri": format!("data:application/octet-stream;base64,{}", base64(&self.bytes)),
            });
        }
        json.to_string()
    }

    /// The same as a binary file.
    fn binary(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        json["buffers"][0] = json!({"byteLength": self.bytes.len()});
        let mut chunks = Vec::new();
        for (kind, mut data, fill) in [
            (b"JSON", json.to_string().into_bytes(), b' '),
            (b"BIN\0", self.bytes.clone(), 0),
        ] {
            data.resize(data.len().next_multiple_of(4), fill);
            chunks.extend((data.len() as u32).to_le_bytes());
            chunks.extend(kind);
            chunks.extend(data);
        }
        let mut file = b"glTF\x02\0\0\0".to_vec();
        file.extend((chunks.len() as u32 + 12).to_le_bytes());
        file.extend(chunks);
        file
    }

    fn load(&self) -> Animated {
        let folder = tempfile::tempdir().unwrap();
        let scene = load_animated(write(&folder, "scene.gltf", self.text().as_bytes()));
        let scene = scene.map_err(|error| format!("{error:#}")).unwrap();
        assert_well_formed(&scene);
        scene
    }

    /// The error message, without the file's name.
    fn fault(&self) -> String {
        fault_of("scene.gltf", self.text().as_bytes())
    }
}

fn base64(bytes: &[u8]) -> String {
    const DIGITS: &[u8] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let mut text = String::new();
    for group in bytes.chunks(3) {
        let word = (0..3).fold(0, |word, i| {
            word << 8 | u32::from(*group.get(i).unwrap_or(&0))
        });
        for digit in 0..4 {
            text.push(match digit <= group.len() {
                true => DIGITS[(word >> (18 - 6 * digit) & 63) as usize] as char,
                false => '=',
            });
        }
    }
    text
}

fn write(folder: &tempfile::TempDir, name: &str, contents: &[u8]) -> String {
    let path: PathBuf = folder.path().join(name);
    std::fs::write(&path, contents).unwrap();
    path.to_str().unwrap().to_string()
}

/// The error message for a file, without its name.
fn fault_of(name: &str, contents: &[u8]) -> String {
    let folder = tempfile::tempdir().unwrap();
    let path = write(&folder, name, contents);
    let line = fault(&path);
    let rest = line.strip_prefix(&path);
    rest.unwrap_or_else(|| panic!("`{line}` does not begin with {path}"))
        .to_string()
}

fn corner(scene: &Animated, clip: Option<usize>, seconds: f64, corner: usize) -> [f64; 3] {
    scene
        .world_mesh(&scene.pose(clip, seconds).unwrap())
        .positions[corner]
}

#[test]
fn every_kind_of_file_holds_the_same_scene() {
    let file = File::skinned();
    let folder = tempfile::tempdir().unwrap();
    let text = write(&folder, "text.gltf", file.text().as_bytes());
    let binary = write(&folder, "binary.glb", &file.binary());
    let mut apart = File::skinned();
    apart.json["buffers"][0] = json!({"uri": "my%20data.bin", "byteLength": file.bytes.len()});
    write(&folder, "my data.bin", &file.bytes);
    let apart = write(&folder, "apart.gltf", apart.text().as_bytes());
    let meshes = [text, binary, apart].map(|spec| {
        let scene = load_animated(&spec).unwrap();
        scene.world_mesh(&scene.pose(None, 0.0).unwrap())
    });
    assert_eq!(meshes[0], meshes[1]);
    assert_eq!(meshes[0], meshes[2]);
    assert_eq!(meshes[0].positions[1], [1.0, 0.0, 0.0]);
}

#[test]
fn each_interpolation_of_each_property() {
    let mut file = File::triangle();
    file.channel(
        "translation",
        0,
        "STEP",
        &[1.0, 2.0],
        "VEC3",
        &[1.0, 0.0, 0.0, 5.0, 0.0, 0.0],
    );
    file.channel(
        "translation",
        0,
        "LINEAR",
        &[1.0, 2.0],
        "VEC3",
        &[1.0, 0.0, 0.0, 5.0, 0.0, 0.0],
    );
    // Rising from 0 to 1 with level ends: 3t² − 2t³.
    let mut spline = [0.0; 18];
    spline[12] = 1.0;
    file.channel(
        "translation",
        0,
        "CUBICSPLINE",
        &[0.0, 2.0],
        "VEC3",
        &spline,
    );
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let turn = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, half, half];
    file.channel("rotation", 0, "LINEAR", &[0.0, 1.0], "VEC4", &turn);
    file.channel("rotation", 0, "STEP", &[0.0, 1.0], "VEC4", &turn);
    file.channel(
        "scale",
        0,
        "LINEAR",
        &[0.0, 1.0],
        "VEC3",
        &[1.0, 1.0, 1.0, 3.0, 1.0, 1.0],
    );
    let scene = file.load();
    let x = |clip: &str, seconds: f64| {
        let clip = scene.clip(Some(clip)).unwrap();
        corner(&scene, clip, seconds, 1)
    };
    for (clip, seconds, expected) in [
        ("translation STEP", -1.0, [2.0, 0.0, 0.0]),
        ("translation STEP", 1.9, [2.0, 0.0, 0.0]),
        ("translation STEP", 2.0, [6.0, 0.0, 0.0]),
        ("translation LINEAR", 0.5, [2.0, 0.0, 0.0]),
        ("translation LINEAR", 1.25, [3.0, 0.0, 0.0]),
        ("translation LINEAR", 77.0, [6.0, 0.0, 0.0]),
        (
            "translation CUBICSPLINE",
            0.5,
            [1.0 + 3.0 / 16.0 - 2.0 / 64.0, 0.0, 0.0],
        ),
        ("translation CUBICSPLINE", 1.0, [1.5, 0.0, 0.0]),
        ("translation CUBICSPLINE", 9.0, [2.0, 0.0, 0.0]),
        ("rotation LINEAR", 1.0 / 3.0, [0.75f64.sqrt(), 0.5, 0.0]),
        ("rotation LINEAR", 1.0, [0.0, 1.0, 0.0]),
        ("rotation STEP", 0.99, [1.0, 0.0, 0.0]),
        ("scale LINEAR", 0.5, [2.0, 0.0, 0.0]),
    ] {
        let found = x(clip, seconds);
        assert!(close(found, expected), "{clip} at {seconds}: {found:?}");
    }
    assert_eq!(scene.clips[0].seconds, 2.0);
    assert_eq!(scene.clips[0].frame_times(4), [0.0, 0.5, 1.0, 1.5]);
}

#[test]
fn skins_follow_their_joints_and_ignore_their_node() {
    let mut file = File::skinned();
    file.channel(
        "translation",
        1,
        "LINEAR",
        &[0.0, 1.0],
        "VEC3",
        &[0.0, 0.0, 0.0, 0.0, 0.0, 8.0],
    );
    let half = std::f32::consts::FRAC_1_SQRT_2;
    let quarter = [0.0, 0.0, half, half];
    file.channel("rotation", 2, "STEP", &[0.0], "VEC4", &quarter);
    let scene = file.load();
    let moved = scene.clip(Some("translation LINEAR")).unwrap();
    assert!(close(corner(&scene, moved, 0.5, 0), [0.0, 0.0, 4.0]));
    assert!(close(corner(&scene, moved, 1.0, 2), [0.0, 1.0, 8.0]));
    // The tip rotates about (0, 1, 0), the position of the corner that follows it.
    let turned = scene.clip(Some("rotation STEP")).unwrap();
    assert!(close(corner(&scene, turned, 0.0, 2), [0.0, 1.0, 0.0]));
    assert!(close(corner(&scene, turned, 0.0, 1), [1.0, 0.0, 0.0]));
    let pose = scene.pose(turned, 0.0).unwrap();
    let tip = &pose.objects[0].palette[1];
    assert!(close(
        transform_point(tip, [1.0, 1.0, 0.0]),
        [0.0, 2.0, 0.0]
    ));
    assert_eq!(pose.instances, [Some(IDENTITY)]);
    assert_eq!(scene.node_names(), ["node 0", "root", "tip"]);
    // A program rotates the root about the vertical axis, in addition to the clip.
    let turn = Overrides::default().turn("root", [0.0, 3.0, 0.0], std::f64::consts::PI);
    let pose = scene.pose_with(moved, 1.0, &turn).unwrap();
    assert!(close(
        scene.world_mesh(&pose).positions[1],
        [-1.0, 0.0, 8.0]
    ));
}

#[test]
fn weights_may_be_integers_and_more_than_four() {
    let mut file = File::skinned();
    // One quarter for the root, three for the tip, as bytes whose sum is not exactly 255.
    let bytes = [63, 189, 0, 0].repeat(3);
    let weights = file.integers("VEC4", 5121, &bytes);
    file.json["accessors"][weights]["normalized"] = json!(true);
    let joints = file.integers("VEC4", 5123, &[0, 1, 9999, 7].repeat(3));
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = json!(joints);
    attributes["WEIGHTS_0"] = json!(weights);
    let scene = file.load();
    let skin = scene.objects[0].skin().unwrap();
    assert_eq!(skin.influences[0].joints, [1, 0, 0, 0]);
    assert_eq!(skin.influences[0].weights, [0.75, 0.25, 0.0, 0.0]);
    assert_eq!(skin.influence_count(), 6);
    assert!(scene.warnings.is_empty());

    // Six joints per vertex in two sets.
    let nodes = file.json["nodes"].as_array_mut().unwrap();
    nodes.extend((3..7).map(|_| json!({})));
    file.json["scenes"][0]["nodes"] = json!([0, 1, 3, 4, 5, 6]);
    file.json["skins"] = json!([{"joints": [1, 2, 3, 4, 5, 6]}]);
    let further = file.integers("VEC4", 5121, &[2, 3, 4, 5].repeat(3));
    let weights = file.integers("VEC4", 5123, &[65535, 300, 65535, 0].repeat(3));
    let attributes = &mut file.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_1"] = json!(further);
    attributes["WEIGHTS_1"] = json!(weights);
    let scene = file.load();
    let influences = &scene.objects[0].skin().unwrap().influences[0];
    assert_eq!(influences.joints, [2, 4, 1, 0]);
    assert_eq!(
        scene.warnings,
        ["mesh 0: 3 of 3 vertices follow more than 4 joints; they keep the 4 strongest"]
    );
}

#[test]
fn morph_targets_are_blended_and_may_be_skinned() {
    let mut file = File::skinned();
    let up = file.floats("VEC3", &[0.0, 0.0, 1.0].repeat(3));
    let along = file.floats("VEC3", &[0.0, 0.0, 0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
    file.json["meshes"][0]["primitives"][0]["targets"] =
        json!([{"POSITION": up}, {"POSITION": along}]);
    file.json["meshes"][0]["weights"] = json!([0.5, 0.0]);
    file.channel(
        "weights",
        0,
        "LINEAR",
        &[0.0, 1.0],
        "SCALAR",
        &[0.0, 0.0, 2.0, 1.0],
    );
    file.channel("translation", 1, "STEP", &[0.0], "VEC3", &[0.0, 7.0, 0.0]);
    let scene = file.load();
    assert!(matches!(scene.objects[0].kind, Kind::Skinned(_)));
    assert!(scene.objects[0].is_written_by_host());
    assert!(close(corner(&scene, None, 0.0, 1), [1.0, 0.0, 0.5]));
    assert!(close(corner(&scene, Some(0), 0.5, 1), [3.0, 0.0, 1.0]));
    assert!(close(corner(&scene, Some(1), 0.5, 1), [1.0, 7.0, 0.5]));
    let extents = scene.extents(Some(1), &[0.0]).unwrap().objects[0];
    assert_eq!((extents.rest.1[1], extents.posed.1[1]), (1.0, 8.0));

    // Without the skin, and with weights of the node.
    file.json["nodes"][0] = json!({"mesh": 0, "weights": [0.0, 0.25]});
    let scene = file.load();
    assert!(matches!(scene.objects[0].kind, Kind::Morphed));
    assert!(close(corner(&scene, None, 0.0, 1), [2.0, 0.0, 0.0]));
}

#[test]
fn a_mesh_that_stands_often_is_one_object() {
    let mut file = File::triangle();
    file.json["nodes"] = json!([
        {"mesh": 0, "children": [1, 2]},
        {"mesh": 0, "name": "mirrored", "scale": [-1, 1, 1], "translation": [5, 0, 0]},
        {"children": [3], "matrix": [2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 2, 0, 0, 0, 9, 1]},
        {"mesh": 0},
        {"mesh": 0, "name": "not in the scene"},
    ]);
    let scene = file.load();
    assert_eq!((scene.objects.len(), scene.instances.len()), (1, 3));
    assert_eq!(scene.instances[1].name, "mirrored");
    let mesh = scene.world_mesh(&scene.pose(None, 0.0).unwrap());
    assert_eq!(mesh.triangles.len(), 3);
    assert_eq!(mesh.positions[4], [4.0, 0.0, 0.0]);
    assert_eq!(mesh.positions[7], [2.0, 0.0, 9.0]);
    assert_eq!(
        scene.extents(None, &[0.0]).unwrap().world,
        ([0.0; 3], [5.0, 2.0, 9.0])
    );
}

#[test]
fn strips_fans_and_all_index_types() {
    let mut file = File::triangle();
    let square = file.floats(
        "VEC3",
        &[
            0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0, 9.0, 9.0, 9.0,
        ],
    );
    let strip = file.integers("SCALAR", 5121, &[0, 1, 2, 3, 3]);
    let fan = file.integers("SCALAR", 5123, &[0, 1, 3, 2]);
    let list = file.integers("SCALAR", 5125, &[0, 1, 2, 1, 3, 2, 0]);
    let attributes = json!({"POSITION": square, "NORMAL": 0, "_MY_OWN": 0});
    let primitive = |mode: u32, indices: usize| json!({"attributes": attributes, "mode": mode, "indices": indices, "material": 7});
    file.json["meshes"][0] = json!({"name": "M", "primitives": [
        primitive(5, strip), primitive(6, fan), primitive(4, list), primitive(1, list),
    ]});
    let scene = file.load();
    let mesh = &scene.objects[0].mesh;
    // The four corners are shared by all; the fifth vertex is unused.
    assert_eq!(mesh.positions.len(), 4);
    assert_eq!(mesh.triangles.len(), 6);
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| DVec3::from(mesh.positions[i as usize]));
        assert_eq!(
            (b - a).cross(c - a),
            DVec3::Z,
            "{triangle:?} faces the other way"
        );
    }
    assert_eq!(
        scene.warnings,
        [
            "mesh M, primitive 2: 1 vertices at its end make no triangle and are left out",
            "mesh M, primitive 3: left out, it is made of Lines, not of triangles",
        ]
    );
}

#[test]
fn sparse_interleaved_and_quantised_accessors() {
    let mut file = File::triangle();
    // Zeros, except for elements 1 and 2.
    let places = file.data(&[1, 2]);
    let values: Vec<u8> = [4.0f32, 0.0, 0.0, 0.0, 6.0, 0.0]
        .iter()
        .flat_map(|x| x.to_le_bytes())
        .collect();
    let values = file.data(&values);
    file.json["accessors"].as_array_mut().unwrap().push(json!({
        "componentType": 5126, "count": 3, "type": "VEC3",
        "sparse": {
            "count": 2,
            "indices": {"bufferView": places, "componentType": 5121},
            "values": {"bufferView": values},
        },
    }));
    file.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(1);
    let positions = file.load().objects[0].mesh.positions.clone();
    assert_eq!(positions, [[0.0; 3], [4.0, 0.0, 0.0], [0.0, 6.0, 0.0]]);
    let places = file.data(&[1, 3]);
    file.json["accessors"][1]["sparse"]["indices"]["bufferView"] = json!(places);
    assert_eq!(
        file.fault(),
        ": mesh 0: primitive 0: POSITION: accessor 1: replaces element 3, which is out of range (there are 3, counted from 0); correct its sparse indices"
    );

    // Signed shorts as fractions, with a stride of 8 bytes.
    let mut file = File::triangle();
    let shorts: [i16; 12] = [0, 0, 0, 99, 32767, 0, 0, 99, 0, -32768, 0, 99];
    let bytes: Vec<u8> = shorts.iter().flat_map(|x| x.to_le_bytes()).collect();
    let view = file.data(&bytes);
    file.json["bufferViews"][view]["byteStride"] = json!(8);
    file.json["extensionsRequired"] = json!(["KHR_mesh_quantization", "KHR_materials_unlit"]);
    file.json["accessors"][0] = json!({
        "bufferView": view, "componentType": 5122, "normalized": true, "count": 3, "type": "VEC3",
    });
    let positions = file.load().objects[0].mesh.positions.clone();
    assert_eq!(positions, [[0.0; 3], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]);
}

#[test]
fn missing_pictures_and_odd_materials_are_no_reason_to_refuse() {
    let mut file = File::triangle();
    file.json["images"] =
        json!([{"uri": "nowhere.png"}, {}, {"bufferView": 700, "mimeType": "image/webp"}]);
    file.json["textures"] = json!([{}, {"source": 9}]);
    file.json["materials"] = json!([{"alphaMode": "STRANGE"}]);
    file.json["buffers"]
        .as_array_mut()
        .unwrap()
        .push(json!({"uri": "pictures.bin", "byteLength": 5}));
    file.json["extensionsRequired"] = json!(["EXT_texture_webp"]);
    file.json["cameras"] = json!([{"type": "wide"}]);
    file.json["nodes"][0]["camera"] = json!(3);
    file.json["meshes"][0]["primitives"][0]["material"] = json!(12);
    file.json["animations"] = json!([{"samplers": [], "channels": [
        {"sampler": 0, "target": {"path": "pointer", "extensions": {"KHR_animation_pointer": {}}}},
    ]}]);
    let scene = file.load();
    assert_eq!(scene.triangle_count(), 1);
    assert_eq!(scene.clips[0].name, "0");
}

#[test]
fn clips_have_names_of_their_own_and_unknown_ones_list_them() {
    let mut file = File::triangle();
    for _ in 0..3 {
        file.channel("scale", 0, "STEP", &[0.0], "VEC3", &[1.0, 2.0, 1.0]);
    }
    file.json["animations"][1]
        .as_object_mut()
        .unwrap()
        .remove("name");
    let scene = file.load();
    let names: Vec<&str> = scene.clips.iter().map(|clip| clip.name.as_str()).collect();
    assert_eq!(names, ["scale STEP", "1", "scale STEP 2"]);
    assert_eq!(scene.clip(None).unwrap(), Some(0));
    assert_eq!(scene.clip(Some("1")).unwrap(), Some(1));
    let fault = |scene: &Animated| one_line(&scene.clip(Some("Fly")).unwrap_err());
    assert_eq!(
        fault(&scene),
        "scene scene: no clip `Fly`; there are `scale STEP`, `1`, `scale STEP 2`"
    );
    assert_eq!(
        fault(&File::triangle().load()),
        "scene scene: no clip `Fly`: this scene has no clips; leave the clip out"
    );
    let out_of_range = one_line(&scene.pose(Some(3), 0.0).unwrap_err());
    assert_eq!(
        out_of_range,
        "scene scene: no clip 3, counted from 0: there are 3"
    );
    let no_time = one_line(&scene.pose(Some(1), f64::NAN).unwrap_err());
    assert_eq!(
        no_time,
        "scene scene, clip 1 at NaN s: the time is NaN; give a number of seconds"
    );
}

#[test]
fn faulty_files_are_refused_in_one_line() {
    type Change = fn(&mut File);
    let cases: [(Change, &str); 28] = [
        (
            |f| f.json["scenes"][0]["nodes"] = json!([1]),
            ": is an empty scene, it has no triangles; export it with its meshes",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["mode"] = json!(0),
            ": is an empty scene, nothing is left of it: mesh 0, primitive 0: left out, it is made of Points, not of triangles; export it with its meshes",
        ),
        (
            |f| f.json["nodes"][2]["children"] = json!([1]),
            ": node 1 (root) is its own ancestor: the nodes are cyclic; correct their children",
        ),
        (
            |f| f.json["nodes"][0]["children"] = json!([2]),
            ": node 2 is a child of node 0 and of node 1; leave it one parent",
        ),
        (
            |f| f.json["nodes"][1]["rotation"] = json!([0, 0, 0, 0]),
            ": root: its rotation is none: [0, 0, 0, 0]; correct it",
        ),
        (
            |f| {
                let joints = f.integers("VEC4", 5121, &[0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0, 0]);
                f.json["meshes"][0]["primitives"][0]["attributes"]["JOINTS_0"] = json!(joints);
            },
            ": mesh 0: primitive 0, vertex 1: names joint 2, which is out of range (the skin has 2, counted from 0); correct JOINTS",
        ),
        (
            |f| f.replace_weights([0.0; 4]),
            ": mesh 0: primitive 0, vertex 1: has weights that are all zero; bind it to a joint",
        ),
        (
            |f| f.replace_weights([0.5, -0.5, 0.0, 0.0]),
            ": mesh 0: primitive 0, vertex 1: has the weight -0.5; give weights from 0 to 1",
        ),
        (
            |f| f.replace_weights([0.5, f32::NAN, 0.0, 0.0]),
            ": mesh 0: primitive 0: WEIGHTS_0: accessor 4: element 1 is not finite: it has NaN; correct it",
        ),
        (
            |f| {
                let attributes = f.json["meshes"][0]["primitives"][0]["attributes"].as_object_mut();
                attributes.unwrap().remove("WEIGHTS_0");
            },
            ": mesh 0: primitive 0: has JOINTS_0 or WEIGHTS_0 without the other; export the file again",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["attributes"] = json!({"POSITION": 0}),
            ": mesh 0: primitive 0: has a skin but neither JOINTS_0 nor WEIGHTS_0; bind its vertices to joints",
        ),
        (
            |f| {
                let positions = [0.0, 0.0, 0.0, 1.0, f32::NAN, 0.0, 0.0, 1.0, 0.0];
                let positions = f.floats("VEC3", &positions);
                f.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(positions);
            },
            ": mesh 0: primitive 0: POSITION: accessor 4: element 1 is not finite: it has NaN; correct it",
        ),
        (
            |f| {
                let indices = f.integers("SCALAR", 5123, &[0, 1, 3]);
                f.json["meshes"][0]["primitives"][0]["indices"] = json!(indices);
            },
            ": mesh 0: primitive 0: indices, accessor 4: element 2 names vertex 3, which is out of range (there are 3, counted from 0); correct it",
        ),
        (
            |f| f.json["accessors"][0]["count"] = json!(4),
            ": mesh 0: primitive 0: POSITION: accessor 0: has 4 elements of 12 bytes, which reach beyond its bufferView of 36 bytes; export the file again",
        ),
        (
            |f| f.json["accessors"][0]["count"] = json!(u64::MAX / 8),
            ": mesh 0: primitive 0: POSITION: accessor 0: has 2305843009213693951 elements of 12 bytes, which reach beyond its bufferView of 36 bytes; export the file again",
        ),
        (
            |f| f.json["bufferViews"][0]["byteOffset"] = json!(1_000_000),
            ": mesh 0: primitive 0: POSITION: accessor 0: bufferView 0 reaches beyond buffer 0 of 224 bytes; export the file again",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(2),
            ": mesh 0: primitive 0: POSITION: accessor 2: has elements of type Vec4, where Vec3 belongs; export the file again",
        ),
        (
            |f| f.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = json!(50),
            ": mesh 0: primitive 0: has its POSITION in accessor 50, which is out of range (there are 4, counted from 0); export the file again",
        ),
        (
            |f| f.json["nodes"][0]["mesh"] = json!(5),
            ": is not valid glTF: nodes[0].mesh: index out of bounds; export it again",
        ),
        (
            |f| f.json["buffers"][0] = json!({"uri": "gone.bin", "byteLength": 224}),
            ": skin 0, inverseBindMatrices: accessor 3: buffer 0: is missing: there is no file FOLDER/gone.bin; put it there",
        ),
        (
            |f| f.json["buffers"][0] = json!({"uri": "data:;base64,AAAA", "byteLength": 224}),
            ": skin 0, inverseBindMatrices: accessor 3: buffer 0 has 3 bytes, not 224; export the file again",
        ),
        (
            |f| f.json["buffers"][0] = json!({"uri": "data:;base64,A*AA", "byteLength": 3}),
            ": skin 0, inverseBindMatrices: accessor 3: buffer 0: is not base64: Invalid symbol 42, offset 1.; export the file again",
        ),
        (
            |f| {
                f.json["extensionsRequired"] = json!([
                    "KHR_draco_mesh_compression",
                    "KHR_materials_unlit",
                    "EXT_meshopt_compression"
                ])
            },
            ": requires KHR_draco_mesh_compression, EXT_meshopt_compression, which cannot be read here; export it without (uncompressed)",
        ),
        (
            |f| f.json["asset"]["version"] = json!("1.0"),
            ": is glTF of version 1.0; export it as glTF 2.0",
        ),
        (
            |f| f.channel("translation", 1, "LINEAR", &[1.0, 0.0], "VEC3", &[0.0; 6]),
            ": animation 0 (translation LINEAR), channel 0: times decrease: key 1 is at 0 s, the one before it at 1 s; export the file again",
        ),
        (
            |f| f.channel("rotation", 1, "LINEAR", &[0.0, 1.0], "VEC4", &[0.0; 4]),
            ": animation 0 (rotation LINEAR), channel 0: has 4 numbers for 2 keys, where 8 belong; export the file again",
        ),
        (
            |f| {
                f.channel("scale", 1, "LINEAR", &[0.0], "VEC3", &[1.0; 3]);
                f.json["animations"][0]["channels"][0]["target"]["node"] = json!(3);
            },
            ": animation 0 (scale LINEAR), channel 0: moves node 3, which is out of range (there are 3, counted from 0); export the file again",
        ),
        (
            |f| f.channel("colour", 1, "LINEAR", &[0.0], "VEC3", &[1.0; 3]),
            ": animation 0 (colour LINEAR), channel 0: moves no property that glTF knows; remove it",
        ),
    ];
    for (change, expected) in cases {
        let mut file = File::skinned();
        change(&mut file);
        let folder = tempfile::tempdir().unwrap();
        let path = write(&folder, "scene.gltf", file.text().as_bytes());
        let line = fault(&path).replace(&path, "");
        let line = line.replace(folder.path().to_str().unwrap(), "FOLDER");
        assert_eq!(line, expected);
    }
}

impl File {
    /// Sets the weights of vertex 1.
    fn replace_weights(&mut self, weights: [f32; 4]) {
        let mut all = [1.0, 0.0, 0.0, 0.0].repeat(3);
        all[4..8].copy_from_slice(&weights);
        let accessor = self.floats("VEC4", &all);
        self.json["meshes"][0]["primitives"][0]["attributes"]["WEIGHTS_0"] = json!(accessor);
    }
}

#[test]
fn a_file_cut_off_or_changed_anywhere_is_refused_or_read_but_never_panics() {
    let mut file = File::skinned();
    file.channel("translation", 1, "LINEAR", &[0.0, 1.0], "VEC3", &[0.0; 6]);
    let whole = file.binary();
    let folder = tempfile::tempdir().unwrap();
    for length in (0..whole.len()).step_by(7) {
        let path = write(&folder, "cut.glb", &whole[..length]);
        fault(&path);
    }
    let seed =
        std::env::var("SEED").map_or_else(|_| fastrand::u64(..), |seed| seed.parse().unwrap());
    println!("SEED={seed}");
    let mut random = fastrand::Rng::with_seed(seed);
    let (mut read, mut refused) = (0, 0);
    for _ in 0..2000 {
        let mut bytes = whole.clone();
        for _ in 0..random.usize(1..4) {
            let place = random.usize(..bytes.len());
            bytes[place] = match random.bool() {
                true => random.u8(..),
                // Replacing digits by digits keeps the JSON well-formed more often.
                false => random.u8(b'0'..=b'9'),
            };
        }
        let path = write(&folder, "changed.glb", &bytes);
        match load_animated(&path) {
            Err(error) => {
                one_line(&error);
                refused += 1;
            }
            Ok(scene) => {
                for clip in (0..scene.clips.len()).map(Some).chain([None]) {
                    if let Err(error) = scene.extents(clip, &[0.0, 0.5]) {
                        one_line(&error);
                    }
                }
                read += 1;
            }
        }
    }
    assert!(
        read > 100 && refused > 100,
        "{read} read, {refused} refused"
    );
}

/// A folder of frames; the x of the first vertex is the index in `names`.
fn frames(names: &[&str]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (x, name) in names.iter().enumerate() {
        let text = format!("v {x} 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n");
        write(&folder, name, text.as_bytes());
    }
    folder
}

/// The x of the first vertex of each frame of a sequence.
fn order(scene: &Animated, frames: usize) -> Vec<f64> {
    let x = |frame: usize| {
        let pose = scene.pose(Some(0), frame as f64 / SEQUENCE_FRAMES_PER_SECOND);
        scene.vertices(&pose.unwrap(), 0)[0][0]
    };
    (0..frames).map(x).collect()
}

#[test]
fn frames_play_in_the_order_of_the_numbers_in_their_names() {
    for names in [
        &["f1.obj", "f2.obj", "f10.obj"][..],
        &["f1.obj", "F2.OBJ", "f3.Obj", "F10.obj"],
        &["0001.obj", "0002.obj", "0010.obj", "10000.obj"],
        // Numbers may exceed the range of any integer.
        &[
            "a9.obj",
            "a99999999999999999999999999999999999999.obj",
            "a100000000000000000000000000000000000000.obj",
        ],
        // The first number decides, then the text after it.
        &["s1f2.obj", "s1f10.obj", "s2f1.obj", "s2g0.obj", "s10f0.obj"],
        &["f.obj", "f 1.obj", "f1.obj", "f1a.obj", "f1b.obj", "f2.obj"],
        // If the numbers are equal, the text after them decides, then leading zeros and case.
        &[
            "f01.obj",
            "f1.obj",
            "f001a.obj",
            "f01b.obj",
            "F02.obj",
            "f02.obj",
            "f2.obj",
        ],
        &["f0.obj", "f00a.obj", "f1.obj"],
        &["Ä1.obj", "ä2.obj", "Ä10.obj"],
    ] {
        let folder = frames(names);
        let scene = load_animated(folder.path().to_str().unwrap()).unwrap();
        let expected: Vec<f64> = (0..names.len()).map(|x| x as f64).collect();
        assert_eq!(order(&scene, names.len()), expected, "for {names:?}");
        assert_eq!(
            scene.clips[0].seconds,
            names.len() as f64 / SEQUENCE_FRAMES_PER_SECOND
        );
    }
}

#[test]
fn hidden_files_are_not_frames() {
    let folder = frames(&["f1.obj", "f2.obj"]);
    write(&folder, "._f1.obj", b"\0\x05\x16\x07\0\x02\0\0Mac OS X");
    write(&folder, ".f3.obj", b"v 0 0 0\nf 1 1 1\n");
    let spec = folder.path().to_str().unwrap();
    assert_eq!(order(&load_animated(spec).unwrap(), 2), [0.0, 1.0]);
    for name in ["f1.obj", "f2.obj"] {
        std::fs::remove_file(folder.path().join(name)).unwrap();
    }
    assert!(fault(spec).starts_with(&format!("{spec}: has no OBJ files; ")));
}

#[cfg(unix)]
#[test]
fn frames_that_are_not_files_are_warned_of() {
    let folder = frames(&["f1.obj", "f2.obj"]);
    let spec = folder.path().to_str().unwrap();
    std::os::unix::fs::symlink("nowhere", folder.path().join("f3.obj")).unwrap();
    let lost = format!("{spec}/f3.obj: is not a file that can be read");
    let scene = load_animated(spec).unwrap();
    assert_eq!(order(&scene, 2), [0.0, 1.0]);
    assert_eq!(
        scene.warnings,
        [format!("{lost}, and is left out of the frames")]
    );
    std::fs::create_dir(folder.path().join("f4.obj")).unwrap();
    assert_eq!(
        load_animated(spec).unwrap().warnings,
        [format!(
            "{lost}, nor are 1 more, and is left out of the frames"
        )]
    );
}

#[cfg(unix)]
#[test]
fn frames_need_not_have_names_in_utf8() {
    use std::os::unix::ffi::OsStrExt;
    let folder = frames(&["f1.obj"]);
    for (x, name) in [(2, &b"f\xff10.obj"[..]), (1, b"F\xff9.OBJ")] {
        let path = folder.path().join(std::ffi::OsStr::from_bytes(name));
        std::fs::write(path, format!("v {x} 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n")).unwrap();
    }
    let scene = load_animated(folder.path().to_str().unwrap()).unwrap();
    assert_eq!(order(&scene, 3), [0.0, 1.0, 2.0]);
}

#[test]
fn what_frames_leave_out_is_warned_of_once() {
    let folder = tempfile::tempdir().unwrap();
    let mesh = "v 0 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n";
    for (name, more) in [
        ("f1.obj", ""),
        ("f2.obj", "t 1\nl 1 2\n"),
        ("f9.obj", "\nt 1\nvw 0\nl 1 2\n"),
        ("f10.obj", "f 1\nt 2\n"),
    ] {
        write(&folder, name, format!("{mesh}{more}").as_bytes());
    }
    let spec = folder.path().to_str().unwrap();
    assert_eq!(
        load_animated(spec).unwrap().warnings,
        [
            format!(
                "{spec}: 4 lines of unknown statements `t`, `vw` left out in 3 of 4 frames, first in {spec}/f2.obj, line 5"
            ),
            format!(
                "{spec}: 2 `l` left out in 2 of 4 frames, first in {spec}/f2.obj, line 6; only faces are drawn: export lines, points, curves and surfaces as polygons"
            ),
            format!(
                "{spec}: 1 face of fewer than three corners left out in 1 of 4 frames, first in {spec}/f10.obj, line 5"
            ),
        ]
    );
    // The same for a static file.
    let file = folder.path().join("f2.obj");
    let file = file.to_str().unwrap();
    let warnings = load_animated(file).unwrap().warnings;
    assert_eq!(warnings, dynrt::scene::load(file).unwrap().warnings);
    assert_eq!(warnings.len(), 2);
}

#[test]
fn folders_that_are_no_sequence_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let spec = folder.path().to_str().unwrap().to_string();
    assert_eq!(
        fault(&spec),
        format!(
            "{spec}: has no OBJ files; give a folder whose files, each name ending in .obj, are the frames"
        )
    );
    let first = write(
        &folder,
        "1.obj",
        b"v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 3\nf 2 4 3\n",
    );
    write(&folder, "readme.txt", b"not a frame");
    assert_eq!(load_animated(&spec).unwrap().triangle_count(), 2);
    for (second, expected) in [
        (
            "v 0 0 1\nv 1 0 1\nv 0 1 1\nf 1 2 3\n",
            "it has 3 vertices, not 4",
        ),
        (
            "v 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\nf 1 2 3\nf 2 4 3\nf 1 4 3\n",
            "it has 3 triangles, not 2",
        ),
        (
            "v 0 0 1\nv 1 0 1\nv 0 1 1\nv 1 1 1\nf 1 2 3\nf 2 3 4\n",
            "triangle 1 has the vertices [1, 2, 3], not [1, 3, 2]",
        ),
    ] {
        let second = write(&folder, "2.obj", second.as_bytes());
        assert_eq!(
            fault(&spec),
            format!(
                "{second}: its topology is not that of {first}: {expected}; export all frames from one mesh"
            )
        );
    }
    let second = write(&folder, "2.obj", b"v 0 0 nan\n");
    assert_eq!(
        fault(&spec),
        format!("{second}, line 1: vertex 1 is not finite: its z is NaN; correct or remove it")
    );
    // Vertices move linearly between two frames, and the last frame is constant.
    write(
        &folder,
        "2.obj",
        b"v 0 0 8\nv 1 0 8\nv 0 1 8\nv 1 1 8\nf 1 2 3\nf 2 4 3\n",
    );
    let scene = load_animated(&spec).unwrap();
    assert_well_formed(&scene);
    assert_eq!(scene.clips[0].seconds, 2.0 / SEQUENCE_FRAMES_PER_SECOND);
    for (frame, z) in [(-1.0, 0.0), (0.0, 0.0), (0.25, 2.0), (1.0, 8.0), (2.0, 8.0)] {
        let pose = scene
            .pose(Some(0), frame / SEQUENCE_FRAMES_PER_SECOND)
            .unwrap();
        assert!(
            close(scene.vertices(&pose, 0)[1], [1.0, 0.0, z]),
            "at {frame}"
        );
    }
}

#[test]
fn other_things_are_refused_in_one_line() {
    for (spec, expected) in [
        (
            "builtin:whale",
            "builtin:whale: no such built-in scene; there are water, figure, reef, teapot, cornell, interior, sphere, knot",
        ),
        (
            "builtin:water?resolution=1",
            "builtin:water: resolution is `1`; give a whole number from 2 to 1024",
        ),
        (
            "builtin:figure?detail=50&hat=1",
            "builtin:figure: unknown parameter `hat`; there are detail",
        ),
        (
            "figure",
            "figure: no such file; for the built-in scene, give builtin:figure",
        ),
        (
            "none.glb",
            "none.glb: no such file; give a glTF or OBJ file, a folder of OBJ files, or builtin:NAME",
        ),
    ] {
        assert_eq!(fault(spec), expected);
    }
    for (name, contents, expected) in [
        (
            "picture.png",
            &b"\x89PNG"[..],
            ": is not a scene that can be read; give a file whose name ends in .glb, .gltf or .obj, a folder of OBJ files, or builtin:NAME",
        ),
        (
            "empty.gltf",
            b"",
            ": is not glTF: EOF while parsing a value at line 1 column 0; export it again",
        ),
        (
            "list.gltf",
            b"[1, 2]",
            ": is not glTF: its JSON is not an object; export it again",
        ),
        (
            "old.glb",
            b"glTF\x01\0\0\0\x14\0\0\0",
            ": is a binary glTF file of version 1; export it as glTF 2.0",
        ),
        (
            "short.glb",
            b"glTF\x02\0",
            ": is a binary glTF file that is cut off; export it again",
        ),
        (
            "bare.glb",
            b"glTF\x02\0\0\0\x0c\0\0\0",
            ": is a binary glTF file without a JSON chunk; export it again",
        ),
    ] {
        assert_eq!(fault_of(name, contents), expected);
    }
    // A buffer that should be in the binary chunk.
    let mut file = File::triangle().binary();
    let json_length = u32::from_le_bytes(file[12..16].try_into().unwrap()) as usize;
    file.truncate(20 + json_length);
    let length = file.len() as u32;
    file[8..12].copy_from_slice(&length.to_le_bytes());
    assert_eq!(
        fault_of("bare.glb", &file),
        ": mesh 0: primitive 0: POSITION: accessor 0: buffer 0 is missing: the file has no binary chunk for it; export it again"
    );
}
