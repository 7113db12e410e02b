//! Scenes: files, built-in scenes, and error messages.

use crate::support::seed;
use crate::support::shared_scene;
use dynrt::float::Format;
use dynrt::port::Ray;
use dynrt::scene::{BUILTIN_NAMES, Camera, Frame, ImageSize, MachineMesh, Mesh, View, load};
use glam::DVec3;
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

fn fault(spec: &str) -> String {
    match load(spec) {
        Ok(scene) => panic!("{spec} loaded as {}", scene.name),
        Err(error) => {
            let line = format!("{error:#}");
            assert!(!line.contains('\n'), "more than one line: {line}");
            line
        }
    }
}

/// For each undirected edge, the number of its triangles.
fn edge_counts(mesh: &Mesh) -> HashMap<(u32, u32), u32> {
    let mut counts = HashMap::new();
    for &[a, b, c] in &mesh.triangles {
        for (p, q) in [(a, b), (b, c), (c, a)] {
            *counts.entry((p.min(q), p.max(q))).or_default() += 1;
        }
    }
    counts
}

fn assert_well_formed(name: &str, mesh: &Mesh) {
    assert!(!mesh.triangles.is_empty(), "{name} is empty");
    let mut used = vec![false; mesh.positions.len()];
    for &triangle in &mesh.triangles {
        let [a, b, c] = triangle;
        assert!(
            a != b && b != c && c != a,
            "{name} has a triangle {triangle:?}"
        );
        for index in triangle {
            used[index as usize] = true;
        }
        let [a, b, c] = triangle.map(|i| DVec3::from(mesh.positions[i as usize]));
        assert!(
            (b - a).cross(c - a).length() > 0.0,
            "{name} has a triangle without area, {triangle:?}"
        );
    }
    assert!(used.iter().all(|&used| used), "{name} has unused vertices");
    assert!(mesh.positions.iter().flatten().all(|x| x.is_finite()));
}

/// The volume of a closed mesh, positive if its corners are counter-clockwise seen from outside.
fn volume(mesh: &Mesh) -> f64 {
    let volumes = mesh.triangles.iter().map(|t| {
        let [a, b, c] = t.map(|i| DVec3::from(mesh.positions[i as usize]));
        a.dot(b.cross(c)) / 6.0
    });
    volumes.sum()
}

#[test]
fn shared_scenes_have_the_triangles_of_their_sources() {
    let expected = [
        ("cornell_box/cornell_box.obj", 36),
        ("suzanne/suzanne.obj", 968),
        ("teapot/teapot.obj", 6320),
        ("spot/spot.obj", 5856),
        ("kitchen/kitchen.obj", 58649),
        ("sponza/sponza.obj", 66454),
        ("stanford_bunny/stanford-bunny.obj", 69451),
    ];
    for (file, triangles) in expected {
        let Some(path) = shared_scene(file) else {
            continue;
        };
        let scene = load(&path).unwrap();
        assert_eq!(scene.mesh.triangles.len(), triangles, "{file}");
        let mesh = MachineMesh::new(&scene, Format::FP24).unwrap();
        let (low, high) = mesh.bounds();
        let greatest = low.iter().chain(&high).fold(0f64, |g, x| g.max(x.abs()));
        assert!(greatest > 128.0 && greatest <= 256.0, "{file}: {greatest}");
    }
}

#[test]
fn the_built_in_teapot_is_the_published_one() {
    let Some(path) = shared_scene("teapot/teapot.obj") else {
        return;
    };
    // That file has the same tessellation, with single-precision vertices printed in decimal.
    let cell = |p: &[f64; 3]| p.map(|x| (x * 64.0).round() as i64);
    let mut cells: HashMap<[i64; 3], Vec<DVec3>> = HashMap::new();
    let ours = load("builtin:teapot").unwrap().mesh;
    for p in &ours.positions {
        let [x, y, z] = cell(p);
        for (dx, dy, dz) in (0..27).map(|i| (i / 9 - 1, i / 3 % 3 - 1, i % 3 - 1)) {
            let near = cells.entry([x + dx, y + dy, z + dz]).or_default();
            near.push((*p).into());
        }
    }
    let theirs = load(&path).unwrap().mesh;
    assert_eq!(theirs.triangles.len(), ours.triangles.len());
    for p in &theirs.positions {
        let near = cells.get(&cell(p)).map(Vec::as_slice).unwrap_or_default();
        assert!(
            near.iter().any(|q| q.distance((*p).into()) < 1e-5),
            "{p:?} is not on the built-in teapot"
        );
    }
}

#[test]
fn built_in_scenes_are_well_formed_and_repeatable() {
    for name in BUILTIN_NAMES {
        let spec = format!("builtin:{name}");
        let scene = load(&spec).unwrap();
        assert_eq!(scene.name, name);
        assert_well_formed(name, &scene.mesh);
        assert_eq!(load(&spec).unwrap(), scene);
        let mesh = MachineMesh::new(&scene, Format::FP24).unwrap();
        let warnings = mesh.warnings(&scene);
        assert!(warnings.is_empty(), "{warnings:?}");
    }
    let count = |spec| load(spec).unwrap().mesh.triangles.len();
    assert_eq!(count("builtin:cornell"), 38);
    assert_eq!(count("builtin:sphere"), 20 << 8);
    assert_eq!(count("builtin:knot"), 2 * 384 * 16);
    let interior = count("builtin:interior");
    assert!(interior >= 60_000, "{interior}");
}

#[test]
fn the_teapot_has_the_triangles_of_its_tessellation_and_no_seams() {
    for n in [2, 3, 10, 17] {
        let mesh = load(format!("builtin:teapot?tessellation={n}"))
            .unwrap()
            .mesh;
        assert_well_formed("teapot", &mesh);
        assert_eq!(mesh.triangles.len(), 64 * n * n - 8 * n);
    }
    let mesh = load("builtin:teapot").unwrap().mesh;
    let mut sorted = mesh.positions.clone();
    sorted.sort_by(|p, q| p.partial_cmp(q).unwrap());
    for (i, p) in sorted.iter().enumerate() {
        let near = sorted[i + 1..].iter().take_while(|q| q[0] - p[0] < 1e-6);
        for q in near {
            let distance = DVec3::from(*p).distance((*q).into());
            assert!(distance > 1e-6, "{p:?} and {q:?} are not welded");
        }
    }
    // The open edges are the rims of body and lid, and those of spout and handle at the body and at the tip.
    let counts = edge_counts(&mesh);
    assert!(counts.values().all(|&count| count <= 2));
    let open = counts.values().filter(|&&count| count == 1).count();
    assert_eq!(open, 2 * 40 + 4 * 20);
}

#[test]
fn closed_scenes_are_closed() {
    for spec in [
        "builtin:sphere?level=0",
        "builtin:sphere?level=1",
        "builtin:sphere",
        "builtin:knot?segments=8&sides=3",
        "builtin:knot?sides=5",
        "builtin:knot",
    ] {
        let mesh = load(spec).unwrap().mesh;
        assert_well_formed(spec, &mesh);
        let counts = edge_counts(&mesh);
        assert!(counts.values().all(|&count| count == 2), "{spec} is open");
        let directed: HashSet<_> = mesh
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)])
            .collect();
        assert_eq!(
            directed.len(),
            2 * counts.len(),
            "{spec} turns over somewhere"
        );
        // A sphere is one surface without holes; the tube of the knot has one hole.
        let euler = mesh.positions.len() as i64 - counts.len() as i64 + mesh.triangles.len() as i64;
        assert_eq!(euler, if spec.contains("sphere") { 2 } else { 0 });
        assert!(volume(&mesh) > 0.0, "{spec} is inside out");
    }
    let sphere = volume(&load("builtin:sphere?level=6").unwrap().mesh);
    let exact = 4.0 / 3.0 * std::f64::consts::PI;
    assert!(sphere < exact && sphere > 0.999 * exact, "{sphere}");
}

/// The distance along a ray to the nearest triangle, in double precision, by signed volumes.
fn nearest(mesh: &MachineMesh, ray: &Ray) -> Option<f64> {
    let (origin, direction) = (DVec3::from(ray.origin), DVec3::from(ray.direction));
    let distances = mesh.triangles.iter().filter_map(|t| {
        let [a, b, c] = t.map(|i| DVec3::from(mesh.vertices[i as usize]) - origin);
        let [u, v, w] = [(c, b), (a, c), (b, a)].map(|(p, q)| p.cross(q).dot(direction));
        let same_side = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
        let total = u + v + w;
        let t = (u * a + v * b + w * c).dot(direction) / total / direction.length_squared();
        (same_side && total != 0.0 && t > 0.0).then_some(t)
    });
    distances.reduce(f64::min)
}

fn hit_share(spec: &str, camera: impl Fn(dynrt::scene::Bounds) -> Camera) -> f64 {
    let scene = load(spec).unwrap();
    let mesh = MachineMesh::new(&scene, Format::FP24).unwrap();
    let frame = Frame::new(ImageSize::new(24, 18).unwrap(), 4).unwrap();
    let camera = camera(scene.bounds());
    let packets = frame.primary_rays(&camera, &mesh).unwrap();
    let rays: Vec<&Ray> = packets.iter().flat_map(|p| &p.rays).collect();
    let hits = rays.iter().filter(|ray| nearest(&mesh, ray).is_some());
    hits.count() as f64 / rays.len() as f64
}

#[test]
fn rooms_are_seen_from_inside() {
    let inside = |bounds| View::Inside.camera(bounds);
    assert_eq!(hit_share("builtin:interior", inside), 1.0);
    // The Cornell box has no front.
    assert!(hit_share("builtin:cornell", inside) > 0.7);
}

#[test]
fn objects_are_seen_whole_and_large() {
    for spec in [
        "builtin:teapot?tessellation=4",
        "builtin:sphere?level=2",
        "builtin:knot?sides=6",
    ] {
        let outside = hit_share(spec, |bounds| View::Outside.camera(bounds));
        assert!(outside > 0.08 && outside < 0.7, "{spec}: {outside}");
        let framed = hit_share(spec, Camera::framing);
        assert!(framed > 0.1 && framed < 0.8, "{spec}: {framed}");
    }
}

#[test]
fn unknown_built_in_scenes_and_parameters_say_what_there_is() {
    for (spec, expected) in [
        (
            "builtin:cow",
            "builtin:cow: no such built-in scene; there are teapot, cornell, interior, sphere, knot",
        ),
        (
            "builtin:",
            "builtin:: no such built-in scene; there are teapot, cornell, interior, sphere, knot",
        ),
        (
            "builtin:teapot?tessellation=0",
            "builtin:teapot: tessellation is `0`; give a whole number from 2 to 128",
        ),
        (
            "builtin:sphere?level=many",
            "builtin:sphere: level is `many`; give a whole number from 0 to 8",
        ),
        (
            "builtin:knot?sides=4&color=red",
            "builtin:knot: unknown parameter `color`; there are segments, sides",
        ),
        (
            "builtin:cornell?level=3",
            "builtin:cornell: unknown parameter `level`; this scene has none",
        ),
        (
            "builtin:sphere?level",
            "builtin:sphere: `level` has no value; write level=VALUE",
        ),
        (
            "builtin:sphere?level=1&level=2",
            "builtin:sphere: `level` is given twice; give it once",
        ),
    ] {
        assert_eq!(fault(spec), expected);
    }
}

/// A path in the form of messages.
fn shown(path: &Path) -> String {
    path.to_str().unwrap().replace('\u{1b}', "\\u{1b}")
}

#[test]
fn files_that_are_no_meshes_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let write = |name: &str, contents: &[u8]| -> PathBuf {
        let path = folder.path().join(name);
        std::fs::write(&path, contents).unwrap();
        path
    };
    let subfolder = folder.path().join("folder.obj");
    std::fs::create_dir(&subfolder).unwrap();
    let triangle = "v 0 0 0\nv 1 0 0\nv 0 1 0\n";
    for (path, expected) in [
        (
            folder.path().join("none.obj"),
            ": no such file; give an OBJ file or builtin:NAME",
        ),
        (
            subfolder,
            ": is a folder, not a mesh; `dynrt animate`, `dynrt vectors` and `dynrt cosim --unit skinning` read a folder of OBJ files as a sequence; give this command an OBJ file or builtin:NAME",
        ),
        (
            write("model.gltf", b"{}"),
            ": is a glTF file; `dynrt animate`, `dynrt vectors` and `dynrt cosim --unit skinning` read it; give this command an OBJ file or builtin:NAME",
        ),
        (
            write("model.GLB", b"glTF"),
            ": is a glTF file; `dynrt animate`, `dynrt vectors` and `dynrt cosim --unit skinning` read it; give this command an OBJ file or builtin:NAME",
        ),
        (
            write("picture.png", b"\x89PNG\r\n\x1a\n\0\0"),
            ": is not a mesh that can be read; give an OBJ file, whose name ends in .obj, or builtin:NAME",
        ),
        (
            write("picture.obj", b"\x89PNG\r\n\x1a\n\0\0"),
            ": is a binary file, not an OBJ mesh; export the mesh as OBJ",
        ),
        (
            write("noise.obj", b"\xfc\xfe\x80 1 2 3\n"),
            ", line 1: `\u{fffd}\u{fffd}\u{fffd}` is not an OBJ statement, and the file, which has neither vertices (`v`) nor faces (`f`), is not an OBJ mesh; give an OBJ mesh",
        ),
        (
            write("prose.obj", b"# not a mesh\nDear reader,\n"),
            ", line 2: `Dear` is not an OBJ statement, and the file, which has neither vertices (`v`) nor faces (`f`), is not an OBJ mesh; give an OBJ mesh",
        ),
        (
            write("empty.obj", b""),
            ": is an empty file, not an OBJ mesh: it has neither vertices (`v`) nor faces (`f`); export the mesh again",
        ),
        (
            write("face.obj", format!("{triangle}f 1 2 3\nf\n").as_bytes()),
            ", line 5: face 2 has no corners; give it at least three, or remove it",
        ),
        (
            write("old\u{1b}mac.obj", b"v 0 0 0\r# a\\\rv 1 0 \\\r0\rv 0 1\r"),
            ", line 5: vertex 3 has 2 numbers where 3 belong; correct or remove it",
        ),
        (
            write("points.obj", triangle.as_bytes()),
            ": is an empty mesh, it has no triangles; export it with its faces",
        ),
        (
            write("nan.obj", b"v 0 0 0\nv 0 0 nan\nv 0 1 0\nf 1 2 3\n"),
            ", line 2: vertex 2 is not finite: its z is NaN; correct or remove it",
        ),
        (
            write("infinite.obj", b"v 0 0 0\nv 0 1 0\n\nv -inf 1 0\nf 1 2 3\n"),
            ", line 4: vertex 3 is not finite: its x is -inf; correct or remove it",
        ),
        (
            write(
                "range.obj",
                format!("{triangle}f 1 2 3\nf 1 2 4\n").as_bytes(),
            ),
            ", line 5: face 2 names vertex 4, which is out of range (there are 3); correct or remove it",
        ),
    ] {
        assert_eq!(
            fault(path.to_str().unwrap()),
            format!("{}{expected}", shown(&path))
        );
    }
    assert_eq!(
        fault("teapot"),
        "teapot: no such file; for the built-in scene, give builtin:teapot"
    );
}

#[test]
fn a_file_loads_whatever_the_case_of_its_ending_and_the_encoding_of_its_comments() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("Dreieck.OBJ");
    let text = b"# Gr\xfc\xdfe\r\nmtllib none.mtl\r\nv 0 0 0\r\nv 1 0 0\r\nv 0 1 0\r\nusemtl x\r\nf 1/1 2/2 3/3\r\n";
    std::fs::write(&path, text).unwrap();
    let scene = load(path.to_str().unwrap()).unwrap();
    assert_eq!(scene.name, "Dreieck");
    assert_eq!(scene.mesh.triangles, [[0, 1, 2]]);
    assert_eq!(scene.mesh.positions[1], [1.0, 0.0, 0.0]);
}

#[test]
fn what_is_in_a_file_and_not_in_the_mesh_is_warned_of_by_name_and_count() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("ta\u{7}gs.obj");
    let text = "v 0 0 0 # a\nv 1 0 0 0 1 1 1\nv 0 1 0\nt crease\nl 1 2\n\u{1b}[31m\nf 1 2 3\nvw 0 1\nf 1 2\nt\n";
    std::fs::write(&path, text).unwrap();
    let scene = load(path.to_str().unwrap()).unwrap();
    assert_eq!(scene.name, r"ta\u{7}gs");
    assert_eq!(scene.mesh.triangles, [[0, 1, 2]]);
    assert_eq!(scene.mesh.positions[1], [1.0, 0.0, 0.0]);
    let shown = folder.path().join(r"ta\u{7}gs.obj");
    let expected = [
        r"4 lines of unknown statements `t`, `\u{1b}[31m`, `vw` left out, first in line 4",
        "1 `l` left out, first in line 5; only faces are drawn: export lines, points, curves and surfaces as polygons",
        "1 face of fewer than three corners left out, first in line 9",
    ];
    let expected = expected.map(|warning| format!("{}: {warning}", shown.display()));
    assert_eq!(scene.warnings, expected);
    assert!(load("builtin:cornell").unwrap().warnings.is_empty());
}

/// Meshes that together use all features of the reader.
const WHOLE: [&str; 5] = [
    "# made in C:\\model\\\nmtllib a b.mtl\nv 0 0 0\nv 1 0 0 # x\nv 0 1 0\nv 1 1 0\ng a#b\nf 1 2 3\nf 2 4 3\n",
    "v 0 0 0 2\r\nv 1 0 0 0.5 0.5 0.5\r\nv 0 1 0 0 0 0 1\r\nvt 0 0\r\nvn 0 0 1\r\nf 1/1/1 2/1/1 3/1/1\r\nf -1//1 -2//1 -3//1\r\n",
    "v 0 0 0\rv 1 0 0\rv 0 1 0\rv 0 1 5\ro \\\rf 1 2 \\ \r3 \\\r4\rl 1 2\rp 3\r",
    "f 1 2 3\nusemtl steel\nt crease 2/1/0 0 1 2.0\nv -1e3 +2. .5\nv 1 0 0 1 1\nv 0 1 0\nfo 3 2 1\nf 1 2\n",
    "cstype bspline\ndeg 1 1\nv 1 2 3\nv 4 5 6\nv 7 8 10\nsurf 0 1 0 1 1 2 3\nparm \\\nv 0 1\nend\ns off\nf 3 2 1\n",
];

/// Changes bytes as storage faults, editors and bad exporters do.
fn damage(bytes: &mut Vec<u8>, random: &mut fastrand::Rng) {
    const PIECES: [&[u8]; 22] = [
        b"\\\n",
        b"\\",
        b"#",
        b"\r",
        b"\n",
        b" ",
        b"/",
        b"-",
        b"nan",
        b"inf",
        b"1e999",
        b"-1 ",
        b" 0 ",
        b"f ",
        b"v ",
        b"\nf\n",
        b"\0",
        b"\xff\xfe",
        b"\xef\xbb\xbf",
        b"\xc3",
        b"99999999999999999999",
        b"\x1a",
    ];
    match random.u8(..8) {
        0 => bytes.truncate(random.usize(..=bytes.len())),
        1 | 2 if !bytes.is_empty() => {
            let place = random.usize(..bytes.len());
            bytes[place] = match random.bool() {
                true => random.u8(..),
                false => random.u8(b'0'..=b'9'),
            };
        }
        3 if !bytes.is_empty() => {
            let start = random.usize(..bytes.len());
            let end = (start + random.usize(1..8)).min(bytes.len());
            bytes.drain(start..end);
        }
        4 if !bytes.is_empty() => {
            let start = random.usize(..bytes.len());
            let end = (start + random.usize(1..20)).min(bytes.len());
            let copy = bytes[start..end].to_vec();
            let place = random.usize(..=bytes.len());
            bytes.splice(place..place, copy);
        }
        _ => {
            let place = random.usize(..=bytes.len());
            let piece = PIECES[random.usize(..PIECES.len())];
            bytes.splice(place..place, piece.iter().copied());
        }
    }
}

#[test]
fn an_obj_file_cut_off_or_changed_anywhere_is_refused_or_read_but_never_panics() {
    let mut random = fastrand::Rng::with_seed(seed());
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("damaged.obj");
    let spec = path.to_str().unwrap();
    let wide = |text: &str| text.encode_utf16().flat_map(u16::to_le_bytes).collect();
    for whole in WHOLE {
        std::fs::write(&path, whole).unwrap();
        let mesh = load(spec).unwrap().mesh;
        assert_well_formed_or_flat(whole.as_bytes(), &mesh);
        std::fs::write(&path, [&b"\xff\xfe"[..], &wide(whole) as &Vec<u8>].concat()).unwrap();
        assert_eq!(load(spec).unwrap().mesh, mesh);
    }
    let (mut read, mut refused) = (0, 0);
    for _ in 0..4000 {
        let whole = WHOLE[random.usize(..WHOLE.len())];
        let mut bytes: Vec<u8> = match random.u8(..4) {
            0 => wide(whole),
            1 => [&b"\xff\xfe"[..], &wide(whole) as &Vec<u8>].concat(),
            _ => whole.into(),
        };
        for _ in 0..random.usize(1..5) {
            damage(&mut bytes, &mut random);
        }
        // A new file each time, because on some file systems truncating and rewriting a file waits for the disk.
        std::fs::remove_file(&path).unwrap();
        std::fs::write(&path, &bytes).unwrap();
        match load(spec) {
            Err(error) => {
                let line = format!("{error:#}");
                assert!(
                    line.starts_with(spec) && !line.contains(|c: char| c.is_control()),
                    "{bytes:?}: {line:?}"
                );
                refused += 1;
            }
            Ok(scene) => {
                assert_well_formed_or_flat(&bytes, &scene.mesh);
                for warning in &scene.warnings {
                    assert!(
                        warning.starts_with(spec) && !warning.contains(|c: char| c.is_control()),
                        "{bytes:?}: {warning:?}"
                    );
                }
                read += 1;
            }
        }
    }
    assert!(
        read > 500 && refused > 500,
        "{read} read, {refused} refused"
    );
}

/// Checks that a mesh is valid, although triangles may have no area.
fn assert_well_formed_or_flat(source: &[u8], mesh: &Mesh) {
    assert!(!mesh.triangles.is_empty(), "{source:?}");
    let count = mesh.positions.len() as u32;
    assert!(mesh.triangles.iter().flatten().all(|&index| index < count));
    assert!(
        (mesh.positions.iter().flatten()).all(|x| (*x as f32).is_finite()),
        "{source:?}"
    );
}
