//! Films in one memory: the lists of all frames on the golden chip, without a host. After each list, hits, vertices, nodes and boxes are
//! compared with those computed from scratch for the frame, in all bits.

use crate::support::{full, shared_scene, write_appearing};
use dynrt::bkd::layout::{LinkWord, MemoryImage, Target};
use dynrt::bkd::{
    Bounds, BuildOptions, InstanceRecord, InstanceSpec, InstancedImage, build, bytes::ByteRecord,
};
use dynrt::chip::Limits;
use dynrt::chip::descriptor::{Command, Scene, Skin};
use dynrt::chip::image::{Builder, hits_of};
use dynrt::chip::memory::Memory;
use dynrt::config::Config;
use dynrt::film::{self, Film, Packed, REBUILD_ABOVE};
use dynrt::float::{Arithmetic, Format};
use dynrt::golden::Caster;
use dynrt::golden::chip::{Chip, bytes_of_hits};
use dynrt::golden::skinning::skin_vertices;
use dynrt::port::Hit;
use dynrt::scene::animation::{MachineFrame, MachineScene, Overrides, Pose};
use dynrt::scene::{Animated, Frame, ImageSize, RayPacket, load_animated};
use std::collections::HashMap;

/// The frames of a scene in the machine's number format, and the rays.
struct Shown {
    config: Config,
    machine: MachineScene,
    frames: Vec<MachineFrame>,
    size: ImageSize,
    packets: Vec<RayPacket>,
}

/// What was compared.
#[derive(Clone, Copy, Debug, Default)]
struct Compared {
    rays: u64,
    hits: u64,
    vertices: u64,
    nodes: u64,
    boxes: u64,
    skins: u64,
    updates: u64,
    tops: u64,
    rebuilds: u64,
}

impl Shown {
    fn new(config: Config, scene: &Animated, poses: &[Pose], size: &str) -> Shown {
        let extents = scene.extents_of(poses).unwrap();
        let format = config.format();
        let machine = MachineScene::new(scene, &extents, format, config.skinning_joints).unwrap();
        let frames = poses.iter().map(|pose| machine.frame(pose).unwrap());
        let frames = frames.collect();
        let size: ImageSize = size.parse().unwrap();
        let frame = Frame::new(size, config.rays_per_packet as usize).unwrap();
        let camera = scene.camera(poses, size);
        let packets = frame.rays_in(&camera, format, machine.log2_scale).unwrap();
        Shown {
            config,
            machine,
            frames,
            size,
            packets,
        }
    }

    /// A number of frames of a clip.
    fn clip(config: Config, spec: &str, clip: Option<&str>, count: usize, size: &str) -> Shown {
        let scene = load_animated(spec).unwrap();
        let clip = scene.clip(clip).unwrap();
        let times = clip.map_or(vec![0.0; count], |clip| {
            scene.clips[clip].frame_times(count)
        });
        let poses: Vec<Pose> = (times.iter())
            .map(|&time| scene.pose(clip, time).unwrap())
            .collect();
        Shown::new(config, &scene, &poses, size)
    }

    fn film(&self) -> Film<'_> {
        Film {
            scene: &self.machine,
            frames: &self.frames,
            size: self.size,
            packets: &self.packets,
        }
    }

    fn pack(&self, rebuild_above: f64) -> Packed {
        let memory = Builder::new(0x1000, 1 << 30);
        let packed = film::pack(&self.config, self.film(), rebuild_above, memory);
        packed.unwrap_or_else(|error| panic!("{error:#}"))
    }

    /// The vertices of an object in a frame, in the order of the mesh.
    fn vertices(&self, object: usize, frame: usize) -> Vec<[f64; 3]> {
        let of = &self.machine.objects[object];
        let given = self.frames[..=frame].iter().rev();
        let written = given
            .filter_map(|frame| frame.objects[object].written.as_ref())
            .next();
        let rest = written.unwrap_or(&of.rest);
        match &of.influences {
            None => rest.clone(),
            Some(influences) => {
                let palette = &self.frames[frame].objects[object].palette;
                let arithmetic = Arithmetic::new(self.machine.format);
                skin_vertices(&arithmetic, rest, &influences.concat(), palette)
            }
        }
    }

    /// The image of a frame, with trees that are built for it; `None` if nothing is there. With it the present instances.
    fn built_for(&self, frame: usize) -> (Option<MemoryImage>, Vec<usize>, Vec<InstanceSpec>) {
        let (format, config) = (self.machine.format, &self.config);
        let depth = match self.film().is_one_level() {
            true => config.stack_depth,
            false => config.stack_depth.saturating_sub(12),
        };
        let options = BuildOptions::default_for(config.axes_per_node, depth);
        let mut image = InstancedImage::new(format);
        for (number, object) in self.machine.objects.iter().enumerate() {
            let (vertices, triangles) = (self.vertices(number, frame), &object.triangles);
            let tree = build(&vertices, triangles, &options).unwrap();
            let object = MemoryImage::new(format, &vertices, triangles, &tree).unwrap();
            image.add_object(&object).unwrap();
        }
        if self.machine.is_one_level(&self.frames) {
            let place = image.objects()[0];
            let only = MemoryImage {
                root: place.root,
                bounds: (place.bounds.lo, place.bounds.hi),
                ..image.image().clone()
            };
            return (Some(only), vec![0], vec![]);
        }
        let (mut there, mut specs) = (vec![], vec![]);
        for (number, matrix) in self.frames[frame].instances.iter().enumerate() {
            let Some(matrix) = matrix else { continue };
            let object = self.machine.instances[number];
            let columns = std::array::from_fn(|c| std::array::from_fn(|r| matrix[r][c]));
            let bounds = image.objects()[object].bounds;
            let spec = InstanceSpec::new(format, number, object, &columns, bounds).unwrap();
            there.push(number);
            specs.push(spec);
        }
        if specs.is_empty() {
            return (None, there, specs);
        }
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        image.set_top(&specs, &options).unwrap();
        (Some(image.image().clone()), there, specs)
    }
}

/// The scene of a frame in memory, as the chip reads it.
struct Found<'a> {
    format: Format,
    memory: &'a Memory,
    scene: Scene,
}

impl Found<'_> {
    fn words(&self, record: &ByteRecord, base: u32, index: u32) -> Vec<u32> {
        let address = u64::from(base) + u64::from(index) * u64::from(record.bytes);
        record.read(self.memory.read(address, record.bytes as usize).unwrap())
    }

    fn vector(&self, base: u32, index: u32) -> [f64; 3] {
        let words = self.words(&ByteRecord::vertex(self.format), base, index);
        MemoryImage::vertices_of_words(self.format, &words)[0]
    }

    fn bounds(&self, base: u32, index: u32) -> Bounds {
        Bounds {
            lo: self.vector(base, index),
            hi: self.vector(base, index + 1),
        }
    }

    /// The box of a tree from the boxes of its leaves; on the way, the bounds of each node are compared with those of its children.
    fn tree(
        &self,
        target: Target,
        leaf: &mut dyn FnMut(&Self, [u32; 4]) -> Bounds,
        nodes: &mut u64,
    ) -> Bounds {
        match target {
            Target::Record(index) => {
                let words = self.words(
                    &ByteRecord::triangle(self.format),
                    self.scene.records,
                    index,
                );
                leaf(self, [words[0], words[1], words[2], words[3]])
            }
            Target::Node(index) => {
                let words = self.words(&ByteRecord::node(self.format), self.scene.nodes, index);
                let node = MemoryImage::nodes_of_words(self.format, &words)[0];
                let [left, right] = node
                    .link
                    .children(index)
                    .map(|child| self.tree(child, leaf, nodes));
                assert_eq!(
                    node.left,
                    left.interval(node.link.left_axis),
                    "node {index}"
                );
                assert_eq!(
                    node.right,
                    right.interval(node.link.right_axis),
                    "node {index}"
                );
                *nodes += 1;
                left.union(right)
            }
        }
    }

    /// Compares the tree of an object with its vertices in a frame; returns its box.
    fn object(
        &self,
        root: LinkWord,
        triangles: &[[u32; 3]],
        vertices: &[[f64; 3]],
        to: &mut Compared,
    ) -> Bounds {
        let mut seen = vec![false; triangles.len()];
        let mut compared = 0;
        let mut leaf = |found: &Self, [v0, v1, v2, number]: [u32; 4]| {
            let wanted = triangles[number as usize].map(|vertex| vertices[vertex as usize]);
            let corners = [v0, v1, v2].map(|index| found.vector(found.scene.vertices, index));
            assert_eq!(corners, wanted, "triangle {number}");
            assert!(!std::mem::replace(&mut seen[number as usize], true));
            compared += 3;
            Bounds::of_triangle(&corners, [0, 1, 2])
        };
        let bounds = self.tree(root.root(), &mut leaf, &mut to.nodes);
        to.vertices += compared;
        assert!(seen.iter().all(|seen| *seen), "a triangle is missing");
        bounds
    }
}

/// The scene of a list. Between commands that write and those that may read it there must be a fence, which the golden chip does not need:
/// `skin`, `update` of objects, `update` of the top-level tree, `scene` are each behind one.
fn scene_behind_fences(commands: &[Command]) -> Scene {
    let stages: Vec<&[Command]> = commands
        .split(|command| matches!(command, Command::Fence))
        .collect();
    let (last, before) = stages.split_last().unwrap();
    let [Command::Scene(scene), casts @ .., Command::End] = last else {
        panic!("{last:?}");
    };
    assert!(!casts.is_empty() && casts.iter().all(|c| matches!(c, Command::Cast(_))));
    let is_skin = |command: &Command| matches!(command, Command::Skin(_));
    let skins = before
        .iter()
        .filter(|stage| stage.iter().any(is_skin))
        .count();
    assert!(skins <= 1 && before.len() <= skins + 2, "{commands:?}");
    for (place, stage) in before.iter().enumerate() {
        assert!(!stage.is_empty());
        let kind = is_skin(&stage[0]);
        assert!(stage.iter().all(|command| is_skin(command) == kind));
        assert_eq!(kind, place == 0 && skins == 1, "{commands:?}");
        for command in stage.iter() {
            match command {
                Command::Update(update) if update.bounds == scene.bounds => {
                    assert_eq!((stage.len(), place + 1), (1, before.len()));
                }
                Command::Skin(_) | Command::Update(_) => {}
                other => panic!("{other:?}"),
            }
        }
    }
    *scene
}

/// Compares memory after the list of a frame with everything computed from scratch.
fn compare(
    shown: &Shown,
    packed: &Packed,
    frame: usize,
    memory: &Memory,
    to: &mut Compared,
) -> Vec<Hit> {
    let format = shown.machine.format;
    let commands = &packed.frames[frame].commands;
    let limits = Limits::of(&shown.config);
    for command in commands {
        assert_eq!(Command::decode(&command.encode(), &limits), Ok(*command));
        to.skins += u64::from(matches!(command, Command::Skin(_)));
        to.updates += u64::from(matches!(command, Command::Update(_)));
    }
    let found = Found {
        format,
        memory,
        scene: scene_behind_fences(commands),
    };
    let (image, there, specs) = shown.built_for(frame);
    let hits = hits_of_all(shown, packed, memory);
    let rays = shown.film().rays();
    to.rays += rays.len() as u64;
    let Some(image) = image else {
        assert!(
            hits.iter().all(|hit| !hit.is_hit()),
            "frame {frame}: nothing is there"
        );
        return hits;
    };
    assert_eq!(packed.frames[frame].there, there);
    image.check(shown.config.stack_depth).unwrap();
    let slots = shown.config.rays_per_packet as usize;
    let wanted = Caster::new(&image, shown.config.triangle_test, slots)
        .cast_packets(&rays)
        .hits;
    for (number, (found, wanted)) in hits.iter().zip(&wanted).enumerate() {
        let same = found.same_bits(wanted, format);
        assert!(same, "frame {frame}, ray {number}: {found:?}, {wanted:?}");
        to.hits += u64::from(found.is_hit());
    }
    // Objects, in one level or below the top-level tree.
    let root = LinkWord::unpack(found.scene.root);
    let scene_box = found.bounds(found.scene.bounds, 0);
    let vertices: Vec<_> = (0..shown.machine.objects.len())
        .map(|k| shown.vertices(k, frame))
        .collect();
    let triangles = |object: usize| &shown.machine.objects[object].triangles[..];
    if specs.is_empty() {
        let bounds = found.object(root, triangles(0), &vertices[0], to);
        assert_eq!(bounds, scene_box, "frame {frame}");
        to.boxes += 1;
        return hits;
    }
    let mut objects: HashMap<usize, Bounds> = HashMap::new();
    let (mut inner, mut boxes) = (Compared::default(), 0);
    let mut leaf = |found: &Found, [vectors, root, _, number]: [u32; 4]| {
        let spec = &specs[number as usize];
        let bounds = *objects.entry(spec.object).or_insert_with(|| {
            let (triangles, vertices) = (triangles(spec.object), &vertices[spec.object]);
            found.object(LinkWord::unpack(root), triangles, vertices, &mut inner)
        });
        for (k, column) in (0u32..).zip(spec.world_to_object) {
            assert_eq!(
                found.vector(found.scene.vertices, vectors + k),
                column,
                "instance {number}"
            );
        }
        let corners = found.bounds(
            found.scene.vertices,
            vectors + InstanceRecord::VECTORS as u32 - 2,
        );
        // The box of an instance that an update writes is the object's, which the other one contains.
        let exact = corners == bounds && spec.world_box.union(bounds) == spec.world_box;
        assert!(
            exact || corners == spec.world_box,
            "frame {frame}, instance {number}: {corners:?}"
        );
        boxes += 1;
        corners
    };
    let bounds = found.tree(root.root(), &mut leaf, &mut to.nodes);
    assert_eq!(bounds, scene_box, "frame {frame}");
    to.nodes += inner.nodes;
    to.vertices += inner.vertices;
    to.boxes += boxes + 1;
    hits
}

fn hits_of_all(shown: &Shown, packed: &Packed, memory: &Memory) -> Vec<Hit> {
    (packed.casts.iter())
        .flat_map(|cast| hits_of(memory, &shown.config, cast))
        .collect()
}

/// Runs the lists of all frames twice, one after the other, and compares each. Returns the hits of the frames.
fn check(what: &str, shown: &Shown, rebuild_above: f64) -> (Compared, Packed, Vec<Vec<Hit>>) {
    let packed = shown.pack(rebuild_above);
    let mut compared = Compared::default();
    let mut memory = packed.memory.clone();
    let mut chip = Chip::new(&shown.config);
    let mut first = vec![];
    for (number, frame) in packed.frames.iter().enumerate() {
        let outcome = chip.run(&mut memory, frame.list, 1 << 16);
        outcome
            .check()
            .unwrap_or_else(|error| panic!("{what}, frame {number}: {error}"));
        first.push(compare(shown, &packed, number, &memory, &mut compared));
        compared.tops += u64::from(frame.new_top);
        compared.rebuilds += frame.trees.iter().filter(|tree| tree.rebuilt).count() as u64;
    }
    // The first list may follow the last one.
    for (number, frame) in packed.frames.iter().enumerate() {
        chip.run(&mut memory, frame.list, 1 << 16).check().unwrap();
        let hits = hits_of_all(shown, &packed, &memory);
        let same = std::iter::zip(&hits, &first[number])
            .all(|(a, b)| a.same_bits(b, shown.machine.format));
        assert!(same, "{what}: frame {number} in the second round");
    }
    let bytes = packed.memory.bytes().len();
    println!(
        "{what}, {} frames, {bytes} bytes: {compared:?}",
        packed.frames.len()
    );
    assert!(
        compared.rays > 0 && compared.hits > 0 && compared.nodes > 0 && compared.vertices > 0,
        "{what}"
    );
    (compared, packed, first)
}

/// All bits of the hits of frames in the reference format.
fn bytes(frames: &[Vec<Hit>]) -> Vec<u8> {
    bytes_of_hits(Format::FP24, &frames.concat(), false)
}

fn check_spec(spec: &str, clip: Option<&str>, frames: usize) -> (Compared, Packed, Vec<Vec<Hit>>) {
    let shown = Shown::clip(Config::reference(), spec, clip, frames, "48x36");
    check(spec, &shown, REBUILD_ABOVE)
}

// ---- Built-in scenes -------------------------------------------------------------------------------

#[test]
fn water_is_copied_and_updated_in_every_frame() {
    let (compared, packed, _) = check_spec("builtin:water?resolution=16", None, 4);
    assert_eq!((compared.skins, compared.updates), (4, 4));
    assert!(packed.frames.iter().all(|frame| frame.triangles == 512));
}

#[test]
fn the_figure_is_skinned_and_updated_in_every_frame() {
    for clip in ["walk", "wave"] {
        let (compared, ..) = check_spec("builtin:figure?detail=36", Some(clip), 3);
        assert_eq!((compared.skins, compared.updates), (3, 3));
    }
}

#[test]
fn a_thousand_instances_in_a_refitted_tree() {
    let scene = load_animated("builtin:reef").unwrap();
    let times = (0..if full() { 12 } else { 3 }).map(|k| 0.17 + 0.47 * f64::from(k));
    let poses: Vec<Pose> = times.map(|t| scene.pose(Some(0), t).unwrap()).collect();
    let shown = Shown::new(Config::reference(), &scene, &poses, "48x36");
    // One tree for all frames: it is refitted in each.
    let (compared, packed, _) = check("builtin:reef", &shown, f64::INFINITY);
    assert_eq!(compared.tops, 1);
    let tops = packed.frames.iter().filter(|frame| {
        let updates = frame
            .commands
            .iter()
            .filter(|c| matches!(c, Command::Update(_)));
        updates.count() == 3
    });
    assert_eq!(
        tops.count(),
        poses.len(),
        "two objects and the top-level tree"
    );
}

#[test]
fn what_stands_still_is_only_cast() {
    let (compared, packed, hits) = check_spec("builtin:cornell", None, 2);
    assert_eq!((compared.skins, compared.updates), (0, 0));
    assert_eq!(packed.frames[0].commands, packed.frames[1].commands);
    assert_eq!(bytes(&hits[..1]), bytes(&hits[1..]));
}

#[test]
fn other_machines() {
    for (name, keys) in [
        ("tiny", vec![]),
        ("dynrt-2006", vec![]),
        // Records of other sizes: rows of influences of 8 and of 32 bytes.
        (
            "virtex4-lx160",
            vec![("float.exponent_bits", "10"), ("float.fraction_bits", "23")],
        ),
        (
            "virtex4-lx160",
            vec![("float.exponent_bits", "6"), ("float.fraction_bits", "9")],
        ),
    ] {
        let mut config = Config::load(name).unwrap();
        for (key, value) in keys {
            config.set(key, value).unwrap();
        }
        for spec in ["builtin:figure?detail=36", "builtin:water?resolution=8"] {
            if spec.contains("figure") && config.skinning_joints < 21 {
                continue;
            }
            let shown = Shown::clip(config.clone(), spec, None, 2, "32x24");
            check(
                &format!("{name}, {}, {spec}", config.format()),
                &shown,
                REBUILD_ABOVE,
            );
        }
        let shown = appearing(config.clone(), &[1.0, 0.5, 1.0], &[1.0, 1.0, 0.0]);
        check(
            &format!("{name}, {}, two triangles", config.format()),
            &shown,
            REBUILD_ABOVE,
        );
    }
}

// ---- Public scenes ---------------------------------------------------------------------------------

fn check_file(file: &str) {
    let Some(path) = shared_scene(file) else {
        return;
    };
    let scene = load_animated(&path).unwrap();
    let clips = if full() {
        scene.clips.len()
    } else {
        scene.clips.len().min(2)
    };
    for clip in &scene.clips[..clips] {
        let frames = if full() { 12 } else { 2 };
        let shown = Shown::clip(
            Config::reference(),
            &path,
            Some(&clip.name),
            frames,
            "48x36",
        );
        let (compared, ..) = check(&format!("{file}, {}", clip.name), &shown, REBUILD_ABOVE);
        assert!(compared.updates > 0);
    }
}

#[test]
fn skinned_files() {
    for file in [
        "fox/Fox.glb",
        "cesium_man/CesiumMan.glb",
        "rigged_figure/RiggedFigure.glb",
        "spider/Spider.glb",
    ] {
        check_file(file);
    }
}

#[test]
fn robot_expressive() {
    check_file("robot_expressive/RobotExpressive.glb");
}

#[test]
fn morphs_and_sequences() {
    for file in [
        "morph_simple/AnimatedMorphCube.glb",
        "morph_simple/AnimatedMorphSphere.glb",
        "wolf",
    ] {
        check_file(file);
    }
}

#[test]
fn a_hand_that_a_program_closes() {
    let Some(path) = shared_scene("hand/left.glb") else {
        return;
    };
    let scene = load_animated(&path).unwrap();
    let poses = (0..3).map(|k| {
        let mut overrides = Overrides::default();
        for finger in ["index", "middle", "ring", "pinky"] {
            let joint = format!("{finger}-finger-phalanx-proximal");
            overrides = overrides.turn(&joint, [1.0, 0.0, 0.0], -0.6 * f64::from(k));
        }
        scene.pose_with(None, 0.0, &overrides).unwrap()
    });
    let poses: Vec<Pose> = poses.collect();
    let shown = Shown::new(Config::reference(), &scene, &poses, "48x36");
    let (compared, _, hits) = check("hand", &shown, REBUILD_ABOVE);
    assert!(compared.skins > 0 && bytes(&hits[..1]) != bytes(&hits[2..]));
}

// ---- Trees and instances ---------------------------------------------------------------------------

/// Two instances of a triangle: see [`write_appearing`].
fn appearing(config: Config, first: &[f32], second: &[f32]) -> Shown {
    let folder = tempfile::tempdir().unwrap();
    let path = write_appearing(folder.path(), first, second);
    Shown::clip(config, &path, None, first.len(), "24x16")
}

/// Frame by frame: only the second, none, both, both, only the first.
#[test]
fn instances_that_are_not_there_are_not_hit() {
    let shown = appearing(
        Config::reference(),
        &[0.0, 0.0, 1.0, 0.5, 1.0],
        &[1.0, 0.0, 1.0, 1.0, 0.0],
    );
    let (compared, packed, hits) = check("appearing", &shown, f64::INFINITY);
    let counts = hits
        .iter()
        .map(|hits| hits.iter().filter(|hit| hit.is_hit()).count());
    let counts: Vec<usize> = counts.collect();
    assert!(
        counts[0] > 0 && counts[4] > 0 && counts[3] < counts[2],
        "{counts:?}"
    );
    assert_eq!(counts[1], 0);
    assert_eq!(counts[2], counts[0] + counts[4]);
    let new: Vec<bool> = packed.frames.iter().map(|frame| frame.new_top).collect();
    assert_eq!(new, [true, false, true, false, true]);
    // Of both instances one moves in one frame: the first frame of their tree and that one each copy it and refit the tree.
    assert_eq!((compared.skins, compared.updates), (2, 2));
    assert_eq!(compared.tops, 3);
}

/// If nothing is there, rays from any place miss: also those for which the box of the scene does not count.
#[test]
fn nothing_is_hit_by_any_ray() {
    let mut shown = appearing(Config::reference(), &[0.0, 1.0], &[0.0, 1.0]);
    let directions = [0.0, -0.0, 1.0, f64::INFINITY, f64::NEG_INFINITY];
    let mut number = 0;
    for packet in &mut shown.packets {
        for ray in &mut packet.rays {
            number += 1;
            ray.origin = [0, 1, 2].map(|axis| directions[(number >> axis) % 5]);
            ray.direction = [0, 1, 2].map(|axis| directions[number / (axis + 2) % 5]);
        }
    }
    let packed = shown.pack(REBUILD_ABOVE);
    let mut memory = packed.memory.clone();
    let outcome = Chip::new(&shown.config).run(&mut memory, packed.frames[0].list, 1 << 10);
    outcome.check().unwrap();
    assert!(outcome.rays > 300 && outcome.hits == 0, "{outcome:?}");
}

/// Bad trees of objects are built anew as another copy from the next frame on; results stay.
#[test]
fn bad_trees_are_replaced() {
    let scene = load_animated("builtin:figure?detail=36").unwrap();
    let poses = [0.0, 0.4, 0.4, 0.9].map(|time| scene.pose(Some(0), time).unwrap());
    let shown = Shown::new(Config::reference(), &scene, &poses, "48x36");
    let (always, packed, hits) = check("rebuilt", &shown, 1.0);
    let (never, _, others) = check("never rebuilt", &shown, f64::INFINITY);
    assert!(always.rebuilds > 0 && never.rebuilds == 0);
    assert_eq!(bytes(&hits), bytes(&others));
    // The third frame has no motion, but the new tree.
    assert!(packed.frames[1].trees[0].rebuilt);
    assert!(packed.frames[2].triangles > 0);
    // In two levels another copy of an object needs another top-level tree.
    let scene = load_animated("builtin:reef").unwrap();
    let poses = [0.17, 0.64, 1.11].map(|time| scene.pose(Some(0), time).unwrap());
    let shown = Shown::new(Config::reference(), &scene, &poses, "32x24");
    let (always, _, hits) = check("reef rebuilt", &shown, 1.0);
    let (never, _, others) = check("reef never rebuilt", &shown, f64::INFINITY);
    assert!(always.rebuilds > 0 && always.tops > never.tops);
    assert_eq!(bytes(&hits), bytes(&others));
}

/// The update of a skinned object writes the box of its only instance beside others: no number of it comes from the host.
#[test]
fn updates_write_the_boxes_of_instances() {
    let Some(path) = shared_scene("robot_expressive/RobotExpressive.glb") else {
        return;
    };
    let shown = Shown::clip(Config::reference(), &path, None, 2, "24x18");
    let packed = shown.pack(f64::INFINITY);
    let vertex = ByteRecord::vertex(shown.machine.format).bytes;
    let mut direct = 0;
    for command in packed.frames.iter().flat_map(|frame| &frame.commands) {
        let Command::Update(update) = command else {
            continue;
        };
        let first = update.bounds.wrapping_sub(update.vertices) / vertex;
        let vertices = packed
            .parts
            .iter()
            .find(|part| part.name == "vertices")
            .unwrap();
        if (vertices.address..vertices.address + vertices.bytes as u32).contains(&update.bounds) {
            assert_eq!(first % 2, 0);
            direct += 1;
        }
    }
    println!("{direct} boxes of instances are written by updates");
    assert!(direct >= 2);
}

// ---- Copies ----------------------------------------------------------------------------------------

/// Skinning with the identity and the weight 1 is exact for all finite numbers without −0, in every format.
#[test]
fn the_identity_copies_every_number() {
    let seed = 0x5eed_0f11;
    let mut rng = fastrand::Rng::with_seed(seed);
    let mut compared = 0;
    for (exponent, fraction) in [(3, 2), (5, 9), (6, 9), (7, 16), (8, 23), (10, 23)] {
        let format = Format::new(exponent, fraction).unwrap();
        let special = [
            0,
            1,
            2,
            format.least_normal(),
            format.greatest(),
            format.greatest() | format.sign_bit(),
        ];
        let mut number = || loop {
            let bits = match rng.u8(..4) {
                0 => special[rng.usize(..special.len())],
                _ => rng.u64(..1 << format.width()),
            };
            let x = format.to_f64(bits) + 0.0;
            if x.is_finite() {
                return x;
            }
        };
        let vertices: Vec<[f64; 3]> = (0..2000)
            .map(|_| std::array::from_fn(|_| number()))
            .collect();
        let whole = dynrt::bkd::Influence {
            joint: 0,
            weight: 1.0,
            last: true,
        };
        let identity = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
        let arithmetic = Arithmetic::new(format);
        let copied = skin_vertices(
            &arithmetic,
            &vertices,
            &vec![whole; vertices.len()],
            &[identity],
        );
        for (copied, vertex) in copied.iter().flatten().zip(vertices.iter().flatten()) {
            assert_eq!(
                format.to_bits(*copied),
                format.to_bits(*vertex),
                "{format}: {vertex}"
            );
            compared += 1;
        }
    }
    println!("{compared} numbers copied");
    assert_eq!(compared, 6 * 6000);
}

/// One command copies any number of vectors with the shared rows: the last row is not filled with zeros.
#[test]
fn rows_of_copies_serve_any_number_of_vectors() {
    let shown = Shown::clip(
        Config::reference(),
        "builtin:water?resolution=8",
        None,
        2,
        "8x8",
    );
    let packed = shown.pack(REBUILD_ABOVE);
    let mut memory = packed.memory.clone();
    let commands = packed.frames[0].commands.iter();
    let skin = commands.clone().find_map(|command| match command {
        Command::Skin(skin) => Some(*skin),
        _ => None,
    });
    let skin = skin.unwrap();
    let mut builder = Builder::new(memory.base() + memory.bytes().len() as u32, 1 << 20);
    let lists: Vec<(u32, u32)> = (1..=9)
        .map(|count| {
            let commands = [
                Command::Skin(Skin {
                    count,
                    rows: count.div_ceil(4),
                    ..skin
                }),
                Command::End,
            ];
            (count, builder.list("copy", &commands).unwrap())
        })
        .collect();
    let (more, _) = builder.finish();
    let mut bytes = memory.bytes().to_vec();
    bytes.extend(more.bytes());
    memory = Memory::new(memory.base(), bytes);
    let vertex = u64::from(ByteRecord::vertex(shown.machine.format).bytes);
    let place = |index: u32| u64::from(skin.vertices) + u64::from(index) * vertex;
    for (count, list) in lists {
        let size = (count as u64 * vertex) as usize;
        memory
            .read_mut(place(skin.target), size + 16)
            .unwrap()
            .fill(0);
        let outcome = Chip::new(&shown.config).run(&mut memory, list, 10);
        outcome.check().unwrap();
        assert_eq!(outcome.vertices_skinned, u64::from(count));
        let copied = memory.read(place(skin.target), size).unwrap();
        assert_eq!(copied, memory.read(place(skin.rest), size).unwrap());
        let behind = memory.read(place(skin.target + count), 16).unwrap();
        assert_eq!(behind, [0; 16]);
    }
}

#[test]
fn a_memory_that_is_too_small_is_refused_in_one_line() {
    let shown = Shown::clip(
        Config::reference(),
        "builtin:water?resolution=8",
        None,
        3,
        "8x8",
    );
    let refused = |bytes| {
        let memory = Builder::new(0, bytes);
        let error = film::pack(&shown.config, shown.film(), REBUILD_ABOVE, memory).err();
        error.map(|error| format!("{error:#}"))
    };
    let whole = shown.pack(REBUILD_ABOVE).memory.bytes().len() as u64;
    assert_eq!(refused(whole), None);
    for bytes in [0, 1000, whole - 128] {
        let line = refused(bytes).unwrap_or_else(|| panic!("{bytes} bytes are enough"));
        assert!(
            line.contains("does not fit") && !line.contains('\n'),
            "{line}"
        );
    }
}
