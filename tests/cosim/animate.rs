//! Animated scenes, with every stage of every frame in RTL and compared in all bits: skinning, update, two levels, ray casting, pictures.
//! Each runs on the units, which the host starts, and in the chip, which runs a command list for each frame.
//!
//! `cargo test` runs a few frames of each scene. `DYNRT_FULL=1` runs every clip with 12 frames of 256×192, one clip of each
//! scene at 512×384, and 10⁶ rays to check that a refitted and a rebuilt tree give the same picture.

use crate::support::command::dynrt;
#[allow(dead_code)]
use crate::support::full;
use crate::support::{shared_scene, write_appearing};
use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use dynrt::bkd::{Bounds, BuildOptions, InstanceSpec, InstancedImage, MemoryImage, build};
use dynrt::chip::image::{Builder, hits_of};
use dynrt::config::Config;
use dynrt::cosim::animate::{self, Figures, Film, FrameReport, Options, Unit};
use dynrt::cosim::chip::{self, Chip};
use dynrt::cosim::mismatch::Mismatch;
use dynrt::film;
use dynrt::float::Arithmetic;
use dynrt::golden::Caster;
use dynrt::golden::chip::Outcome;
use dynrt::golden::skinning::skin_vertices;
use dynrt::scene::animation::{MachineFrame, MachineScene, Overrides, Pose};
use dynrt::scene::{Animated, Frame, ImageSize, RayPacket, load_animated};
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// The frames of a scene in the machine's number format, and the rays.
pub(crate) struct Shown {
    machine: MachineScene,
    frames: Vec<MachineFrame>,
    size: ImageSize,
    packets: Vec<RayPacket>,
}

impl Shown {
    fn new(config: &Config, scene: &Animated, poses: &[Pose], size: &str) -> Shown {
        let extents = scene.extents_of(poses).unwrap();
        let format = config.format();
        let machine = MachineScene::new(scene, &extents, format, config.skinning_joints).unwrap();
        let frames = poses.iter().map(|pose| machine.frame(pose).unwrap());
        let frames: Vec<_> = frames.collect();
        let size: ImageSize = size.parse().unwrap();
        let frame = Frame::new(size, config.rays_per_packet as usize).unwrap();
        let camera = scene.camera(poses, size);
        let packets = frame.rays_in(&camera, format, machine.log2_scale).unwrap();
        Shown {
            machine,
            frames,
            size,
            packets,
        }
    }

    /// A number of frames of a clip.
    pub(crate) fn clip(
        config: &Config,
        scene: &Animated,
        clip: Option<usize>,
        count: usize,
        size: &str,
    ) -> Shown {
        let times = clip.map_or(vec![0.0; count], |clip| {
            scene.clips[clip].frame_times(count)
        });
        let poses: Vec<Pose> = times
            .iter()
            .map(|&time| scene.pose(clip, time).unwrap())
            .collect();
        Shown::new(config, scene, &poses, size)
    }

    pub(crate) fn film(&self) -> Film<'_> {
        Film {
            scene: &self.machine,
            frames: &self.frames,
            size: self.size,
            packets: &self.packets,
        }
    }

    pub(crate) fn run(
        &self,
        config: &Config,
        options: &Options,
    ) -> anyhow::Result<Vec<FrameReport>> {
        let mut reports = Vec::new();
        animate::run(config, self.film(), options, &|_, _| (), |report| {
            reports.push(report);
            Ok(())
        })?;
        Ok(reports)
    }
}

fn total(reports: &[FrameReport]) -> Figures {
    let mut total = Figures::default();
    for report in reports {
        total.add(&report.figures);
    }
    total
}

/// Runs the lists of all frames in the chip and checks that it draws the same pictures. Every byte of memory is compared.
fn in_the_chip(
    what: &str,
    config: &Config,
    shown: &Shown,
    rebuild_above: f64,
    reports: &[FrameReport],
) {
    let film = shown.film();
    let packed = film::pack(config, film, rebuild_above, Builder::new(0x1000, 1 << 31)).unwrap();
    let mut chip = Chip::new(config, &chip::Options::default(), &|_| ()).unwrap();
    let (mut memory, mut outcomes, mut checked) = (packed.memory, vec![], 0);
    for (number, frame) in packed.frames.iter().enumerate() {
        let report = chip
            .run(&mut memory, frame.list, &|_| ())
            .unwrap_or_else(|error| panic!("{what}, frame {number}: {error:#}"));
        report.outcome.check().unwrap();
        let casts = packed.casts.iter();
        let hits: Vec<_> = casts
            .flat_map(|cast| hits_of(&memory, config, cast))
            .collect();
        let objects = 0..film.scene.objects.len();
        let vertices = objects.map(|object| film.vertices(object, number).unwrap());
        let vertices: Vec<_> = vertices.collect();
        let picture = film.shade(number, &frame.there, |object| &vertices[object][..], &hits);
        assert!(picture == reports[number].picture, "{what}, frame {number}");
        checked += report.checked;
        outcomes.push(report.outcome);
    }
    let sum = |of: fn(&Outcome) -> u64| outcomes.iter().map(of).sum::<u64>();
    println!(
        "{what} in the chip: {} vertices, {} nodes, {} hits, {checked} bytes and all pictures agree",
        sum(|outcome| outcome.vertices_skinned),
        sum(|outcome| outcome.nodes_written),
        sum(|outcome| outcome.hits),
    );
    let total = total(reports);
    assert_eq!(sum(|outcome| outcome.hits), total.hits, "{what}");
    assert!(
        sum(|outcome| outcome.nodes_written) >= total.nodes_written,
        "{what}"
    );
}

/// Runs these frames and checks that something was compared and all of it agrees; if they begin with the first one, in the chip too.
fn check(what: &str, config: &Config, shown: &Shown, options: &Options) -> Vec<FrameReport> {
    let reports = shown
        .run(config, options)
        .unwrap_or_else(|error| panic!("{what}: {error:#}"));
    assert_eq!(reports.len(), shown.frames.len() - options.from_frame);
    for report in &reports {
        let figures = &report.figures;
        assert!(figures.checked > figures.rays, "{what}");
        assert!(figures.hits > 0, "{what}: frame {} is empty", report.number);
        assert!(
            figures.sah_ratio() > 0.5 && figures.sah_ratio().is_finite(),
            "{what}: {}",
            figures.sah_ratio()
        );
    }
    if options.from_frame == 0 {
        in_the_chip(what, config, shown, options.rebuild_above, &reports);
    }
    let total = total(&reports);
    println!(
        "{what}, {} frames of {}: {} results agree, {} hits; cycles: skinning {} ({:.1} %), update {} ({:.1} %), ray casting {}; \
         {} triangles updated, {:.3} a clock; trees cost {:.3} times new ones, {} rebuilds",
        reports.len(),
        shown.size,
        total.checked,
        total.hits,
        total.skinning_cycles,
        100.0 * total.skinning_share(),
        total.update_cycles,
        100.0 * total.update_share(),
        total.raycast_cycles,
        total.triangles,
        total.triangles_per_clock().unwrap_or(f64::NAN),
        total.sah_ratio(),
        total.rebuilds
    );
    reports
}

fn check_spec(spec: &str, clip: Option<&str>, frames: usize, size: &str) -> Vec<FrameReport> {
    let config = Config::reference();
    let scene = load_animated(spec).unwrap();
    let clip = scene.clip(clip).unwrap();
    let shown = Shown::clip(&config, &scene, clip, frames, size);
    check(spec, &config, &shown, &Options::default())
}

// ---- Built-in scenes ------------------------------------------------------------------------------------------

#[test]
fn water_is_updated_in_every_frame() {
    let (spec, size) = match full() {
        true => ("builtin:water", "256x192"),
        false => ("builtin:water?resolution=32", "64x48"),
    };
    for report in check_spec(spec, None, 4, size) {
        let figures = report.figures;
        assert_eq!(figures.nodes_written, figures.triangles - 1);
        assert!(figures.update_cycles > 0 && figures.skinning_cycles == 0);
    }
}

#[test]
fn the_figure_is_skinned_and_updated_in_every_frame() {
    let size = if full() { "256x192" } else { "64x48" };
    for clip in ["walk", "wave"] {
        for report in check_spec("builtin:figure?detail=36", Some(clip), 3, size) {
            let figures = report.figures;
            assert!(figures.skinning_cycles >= figures.influences);
            assert!(figures.influences >= figures.vertices_skinned);
            assert_eq!(figures.nodes_written, figures.triangles - 1);
        }
    }
}

#[test]
fn a_thousand_instances_of_four_objects() {
    let (frames, size) = if full() {
        (12, "256x192")
    } else {
        (2, "96x72")
    };
    let config = Config::reference();
    let scene = load_animated("builtin:reef").unwrap();
    assert!(scene.instances.len() >= 1000 && scene.objects.len() >= 3);
    // Fishes' tails beat every 0.75 s, so they are bent differently in any two of these frames.
    let times = (0..frames).map(|k| 0.17 + 0.47 * f64::from(k));
    let poses: Vec<Pose> = times.map(|t| scene.pose(Some(0), t).unwrap()).collect();
    let shown = Shown::new(&config, &scene, &poses, size);
    for report in check("builtin:reef", &config, &shown, &Options::default()) {
        // Stones and the seabed are static.
        assert_eq!(report.trees.len(), 2);
    }
}

#[test]
fn what_stands_still_is_only_cast() {
    let reports = check_spec("builtin:cornell", None, 2, "32x24");
    for report in &reports {
        let figures = report.figures;
        assert_eq!((figures.update_cycles, figures.skinning_cycles), (0, 0));
        assert_eq!(figures.triangles_per_clock(), None);
        assert_eq!(figures.sah_ratio(), 1.0);
    }
    assert_eq!(reports[0].picture, reports[1].picture);
}

#[test]
fn other_machines() {
    let scene = load_animated("builtin:figure?detail=36").unwrap();
    for name in ["tiny", "dynrt-2006"] {
        let config = Config::load(name).unwrap();
        if config.skinning_joints < 21 {
            continue;
        }
        let shown = Shown::clip(&config, &scene, Some(0), 2, "32x24");
        check(name, &config, &shown, &Options::default());
    }
}

// ---- Public scenes -------------------------------------------------------------------------------

/// All clips of a file; at full length, one of them at a larger size.
fn check_file(file: &str) {
    let Some(path) = shared_scene(file) else {
        return;
    };
    let config = Config::reference();
    let scene = load_animated(&path).unwrap();
    let (frames, size) = match full() {
        true => (12, "256x192"),
        false => (2, "48x36"),
    };
    let clips = match full() {
        true => scene.clips.len(),
        false => scene.clips.len().min(2),
    };
    for clip in 0..clips {
        let shown = Shown::clip(&config, &scene, Some(clip), frames, size);
        let what = format!("{file}, {}", scene.clips[clip].name);
        check(&what, &config, &shown, &Options::default());
    }
    if full() {
        let shown = Shown::clip(&config, &scene, Some(0), 4, "512x384");
        let reports = check(file, &config, &shown, &Options::default());
        let total = total(&reports);
        if total.skinning_cycles > 0 {
            let share = total.skinning_share() + total.update_share();
            assert!(
                share <= 0.15,
                "{file}: skinning and update take {share} of the cycles"
            );
        }
    }
}

#[test]
fn fox() {
    check_file("fox/Fox.glb");
}

#[test]
fn cesium_man() {
    check_file("cesium_man/CesiumMan.glb");
}

#[test]
fn rigged_figure() {
    check_file("rigged_figure/RiggedFigure.glb");
}

#[test]
fn robot_expressive() {
    check_file("robot_expressive/RobotExpressive.glb");
}

#[test]
fn spider() {
    check_file("spider/Spider.glb");
}

#[test]
fn morph_simple() {
    check_file("morph_simple/AnimatedMorphCube.glb");
    check_file("morph_simple/AnimatedMorphSphere.glb");
}

#[test]
fn wolf() {
    check_file("wolf");
}

#[test]
fn a_hand_that_a_program_closes() {
    let Some(path) = shared_scene("hand/left.glb") else {
        return;
    };
    let config = Config::reference();
    let scene = load_animated(&path).unwrap();
    let (frames, size) = if full() {
        (12, "256x192")
    } else {
        (3, "48x36")
    };
    let poses = (0..frames).map(|k| {
        let angle = -1.2 * f64::from(k) / f64::from(frames - 1);
        let mut overrides = Overrides::default();
        for finger in ["index", "middle", "ring", "pinky"] {
            for part in ["proximal", "intermediate"] {
                let joint = format!("{finger}-finger-phalanx-{part}");
                overrides = overrides.turn(&joint, [1.0, 0.0, 0.0], angle);
            }
        }
        scene.pose_with(None, 0.0, &overrides).unwrap()
    });
    let poses: Vec<Pose> = poses.collect();
    let shown = Shown::new(&config, &scene, &poses, size);
    let reports = check("hand", &config, &shown, &Options::default());
    assert_ne!(reports[0].picture, reports[1].picture);
}

// ---- Trees under motion ---------------------------------------------------------------------------------------

/// Two instances of a triangle: see [`write_appearing`].
fn appearing(first: &[f32], second: &[f32]) -> Animated {
    let folder = tempfile::tempdir().unwrap();
    load_animated(write_appearing(folder.path(), first, second)).unwrap()
}

#[test]
fn instances_that_are_not_there_are_not_drawn() {
    let config = Config::reference();
    // Frame by frame: only the second, none, both, only the first.
    let scene = appearing(&[0.0, 0.0, 1.0, 1.0], &[1.0, 0.0, 1.0, 0.0]);
    let shown = Shown::clip(&config, &scene, Some(0), 4, "24x16");
    let there = |frame: &MachineFrame| frame.instances.iter().flatten().count();
    assert_eq!(
        shown.frames.iter().map(there).collect::<Vec<_>>(),
        [1, 0, 2, 1]
    );
    let reports = shown.run(&config, &Options::default()).unwrap();
    let hits: Vec<u64> = reports.iter().map(|report| report.figures.hits).collect();
    assert!(hits[0] > 0 && hits[3] > 0, "{hits:?}");
    assert_eq!(hits[2], hits[0] + hits[3], "{hits:?}");
    // Without instances there are no rays and no cycles, and only memory is compared.
    let [empty, full] = [1, 2].map(|frame: usize| &reports[frame].figures);
    assert_eq!((empty.hits, empty.rays, empty.raycast_cycles), (0, 0, 0));
    assert!(empty.checked < full.checked && full.rays > 0);
    // If a picture shows a triangle, the picture without it shows the object behind.
    let differ = |a: usize, b: usize| {
        let pixels = std::iter::zip(reports[a].picture.pixels(), reports[b].picture.pixels());
        pixels.filter(|(a, b)| a != b).count() as u64
    };
    assert_eq!(differ(0, 1), hits[0]);
    assert_eq!(differ(3, 1), hits[3]);
    assert_eq!(differ(2, 1), hits[2]);
    // The same, starting in the middle of the film.
    let options = Options {
        from_frame: 1,
        ..Options::default()
    };
    let again = shown.run(&config, &options).unwrap();
    for (report, again) in std::iter::zip(&reports[1..], &again) {
        assert_eq!(report.picture, again.picture);
        assert_eq!(report.figures.hits, again.figures.hits);
    }
}

#[test]
fn trees_that_have_become_bad_are_built_anew() {
    let config = Config::reference();
    let scene = load_animated("builtin:figure?detail=36").unwrap();
    // It moves once and then stands still: the rebuilt tree is used from the next frame on, in which it is optimal.
    let poses = [0.0, 0.4, 0.4, 0.4].map(|time| scene.pose(Some(0), time).unwrap());
    let shown = Shown::new(&config, &scene, &poses, "48x36");
    let with = |rebuild_above: f64| {
        let options = Options {
            rebuild_above,
            ..Options::default()
        };
        check(&format!("above {rebuild_above}"), &config, &shown, &options)
    };
    let (never, always) = (with(f64::INFINITY), with(1.0));
    let ratios = |reports: &[FrameReport]| -> Vec<f64> {
        let ratio = |report: &FrameReport| report.figures.sah_ratio();
        reports.iter().map(ratio).collect()
    };
    let bad = ratios(&never)[1];
    assert!(bad > 1.0);
    assert_eq!(ratios(&never), [1.0, bad, bad, bad]);
    assert_eq!(ratios(&always), [1.0, bad, 1.0, 1.0]);
    // A static object is updated once more only if its tree is new.
    let updates = |reports: &[FrameReport]| -> Vec<bool> {
        let updated = |report: &FrameReport| report.figures.update_cycles > 0;
        reports.iter().map(updated).collect()
    };
    assert_eq!(updates(&never), [true, true, false, false]);
    assert_eq!(updates(&always), [true, true, true, false]);
    assert_eq!((total(&never).rebuilds, total(&always).rebuilds), (0, 1));
    for (never, always) in never.iter().zip(&always) {
        assert!(never.picture == always.picture, "the tree shows");
    }
}

/// The golden image of a frame, with objects' trees built for the vertices of `built_for`.
fn golden_image(config: &Config, shown: &Shown, frame: usize, built_for: usize) -> MemoryImage {
    let (scene, format) = (&shown.machine, config.format());
    let arithmetic = Arithmetic::new(format);
    let vertices = |number: usize, frame: usize| {
        let object = &scene.objects[number];
        let given = &shown.frames[frame].objects[number];
        let rest = given.written.as_ref().unwrap_or(&object.rest);
        match &object.influences {
            Some(influences) => {
                skin_vertices(&arithmetic, rest, &influences.concat(), &given.palette)
            }
            None => rest.clone(),
        }
    };
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth - 12);
    let mut image = InstancedImage::new(format);
    for (number, object) in scene.objects.iter().enumerate() {
        let triangles = &object.triangles;
        let tree = build(&vertices(number, built_for), triangles, &options).unwrap();
        let now = vertices(number, frame);
        image
            .add_object(&MemoryImage::new(format, &now, triangles, &tree).unwrap())
            .unwrap();
    }
    if scene.is_one_level(&shown.frames) {
        let place = image.objects()[0];
        return MemoryImage {
            root: place.root,
            bounds: (place.bounds.lo, place.bounds.hi),
            ..image.image().clone()
        };
    }
    let instances = scene.instances.iter().zip(&shown.frames[frame].instances);
    let specs = instances.enumerate().map(|(number, (&object, matrix))| {
        let columns = std::array::from_fn(|c| std::array::from_fn(|r| matrix.unwrap()[r][c]));
        let bounds: Bounds = image.objects()[object].bounds;
        InstanceSpec::new(format, number, object, &columns, bounds).unwrap()
    });
    let specs: Vec<_> = specs.collect();
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    image.set_top(&specs, &options).unwrap();
    image.image().clone()
}

/// A refitted and a rebuilt tree give every ray the same result, in all bits.
#[test]
fn refitted_and_rebuilt_trees_give_the_same_hits() {
    let config = Config::reference();
    let rays_per_packet = config.rays_per_packet as usize;
    let size = if full() { "256x192" } else { "64x48" };
    let frames = if full() { 8 } else { 3 };
    let mut specs: Vec<String> = [
        "builtin:water?resolution=40",
        "builtin:figure",
        "builtin:reef",
    ]
    .map(String::from)
    .into();
    let files = [
        "fox/Fox.glb",
        "robot_expressive/RobotExpressive.glb",
        "wolf",
    ];
    specs.extend(files.into_iter().filter_map(shared_scene));
    let (mut rays, mut hits) = (0, 0);
    for spec in specs {
        let scene = load_animated(&spec).unwrap();
        let shown = Shown::clip(&config, &scene, Some(0), frames, size);
        let primary: Vec<_> = (shown.packets.iter())
            .flat_map(|packet| packet.rays.clone())
            .collect();
        for frame in 1..frames {
            let cast = |built_for: usize| {
                let image = golden_image(&config, &shown, frame, built_for);
                image.check(config.stack_depth).unwrap();
                let caster = Caster::new(&image, config.triangle_test, rays_per_packet);
                caster.cast_packets(&primary).hits
            };
            for (number, (refitted, rebuilt)) in cast(0).iter().zip(&cast(frame)).enumerate() {
                assert!(
                    refitted.same_bits(rebuilt, config.format()),
                    "{spec}, frame {frame}, ray {number}: {refitted:?}, {rebuilt:?}"
                );
                hits += u64::from(refitted.is_hit());
            }
            rays += primary.len() as u64;
        }
    }
    println!("{rays} rays, {hits} hits: the tree does not show");
    assert!(hits * 20 > rays, "{hits} hits of {rays} rays");
    assert!(!full() || rays >= 1_000_000, "{rays}");
}

// ---- Replays and mismatches -----------------------------------------------------------------------------------

/// A machine whose memories respond in random order with random latency.
fn unsteady() -> Config {
    let mut config = Config::reference();
    for (key, value) in [
        ("memory.jitter", "20"),
        ("memory.order", "out-of-order"),
        ("memory.ready_percent", "60"),
    ] {
        config.set(key, value).unwrap();
    }
    config
}

#[test]
fn a_frame_on_its_own_is_the_frame_of_the_whole_run() {
    let config = unsteady();
    let scene = load_animated("builtin:figure?detail=36").unwrap();
    let shown = Shown::clip(&config, &scene, Some(0), 4, "32x24");
    // Trees are rebuilt on the way; the run of a single frame must do the same.
    let options = Options {
        rebuild_above: 1.0,
        ..Options::default()
    };
    let whole = check("whole", &config, &shown, &options);
    assert!(whole[..2].iter().any(|report| report.figures.rebuilds > 0));
    let alone = Options {
        from_frame: 2,
        ..options
    };
    let alone = check("alone", &config, &shown, &alone);
    for (whole, alone) in whole[2..].iter().zip(&alone) {
        assert_eq!(whole.number, alone.number);
        assert_eq!(whole.figures, alone.figures);
        assert_eq!(whole.trees, alone.trees);
        assert!(whole.picture == alone.picture);
    }
}

#[test]
fn a_fault_of_a_unit_is_a_mismatch_with_its_frame_and_replay() {
    let config = Config::reference();
    let scene = load_animated("builtin:water?resolution=8").unwrap();
    let shown = Shown::clip(&config, &scene, Some(0), 3, "16x12");
    let options = Options {
        replay: "dynrt animate builtin:water".into(),
        from_frame: 1,
        fault: Some((Unit::Update, |unit| {
            Ok(unit.top().signal("node_write_mask")?.fault().as_value(7))
        })),
        ..Options::default()
    };
    let error = shown.run(&config, &options).unwrap_err();
    let mismatch = error.downcast_ref::<Mismatch>().expect("a mismatch");
    assert_eq!(mismatch.unit, "update");
    assert!(
        mismatch.place.starts_with("frame 1, "),
        "{}",
        mismatch.place
    );
    assert_eq!(
        mismatch.replay,
        "dynrt animate builtin:water --from-frame 1 --unit update"
    );
}

// ---- The command ----------------------------------------------------------------------------------------------

fn contents(folder: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(next).unwrap() {
            let path = entry.unwrap().path();
            let name = path.strip_prefix(folder).unwrap().display().to_string();
            if path.is_dir() {
                files.insert(name, Vec::new());
                open.push(path);
            } else {
                files.insert(name, std::fs::read(path).unwrap());
            }
        }
    }
    files
}

#[test]
fn the_command_writes_frames_a_gif_and_figures() {
    let folder = tempfile::tempdir().unwrap();
    let arguments = "animate builtin:water?resolution=12 --frames 3 --size 40x30 --out film --gif film.gif --json film.json";
    let output = dynrt(arguments, folder.path()).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success(), "{stderr}");
    assert_eq!(stderr, "");
    let files = contents(folder.path());
    let names: Vec<_> = files.keys().map(String::as_str).collect();
    assert_eq!(
        names,
        [
            "film",
            "film.gif",
            "film.json",
            "film/frame_0000.png",
            "film/frame_0001.png",
            "film/frame_0002.png"
        ]
    );
    assert_eq!(&files["film.gif"][..6], b"GIF89a");
    let json: Value = serde_json::from_slice(&files["film.json"]).unwrap();
    let frames = json["frames"].as_array().unwrap();
    assert_eq!(frames.len(), 3);
    for key in [
        "skinning_cycles",
        "update_cycles",
        "raycast_cycles",
        "update_share",
        "triangles",
        "nodes_written",
        "instructions",
        "triangles_per_clock",
        "nodes_per_clock",
        "sah_ratio",
        "checked",
        "mismatches",
    ] {
        assert!(json["total"][key].is_number(), "{key}");
        assert!(frames.iter().all(|frame| frame[key].is_number()), "{key}");
    }
    for key in [
        "update_cycles",
        "raycast_cycles",
        "triangles",
        "nodes_written",
        "instructions",
        "checked",
    ] {
        let sum: u64 = frames
            .iter()
            .map(|frame| frame[key].as_u64().unwrap())
            .sum();
        assert_eq!(json["total"][key], json!(sum), "{key}");
        assert!(sum > 0, "{key}");
    }
    assert_eq!(json["total"]["mismatches"], 0);
    assert_eq!(json["total"]["triangles"], 3 * 288);
    assert_eq!(json["total"]["nodes_written"], 3 * 287);
}

/// The error line of a command that must fail and leave no files.
fn fault(arguments: &str, folder: &Path) -> String {
    let before = contents(folder);
    let arguments = format!("animate {arguments} --size 16x12");
    let output = dynrt(&arguments, folder).output().unwrap();
    let stderr = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(1), "{arguments}: {stderr}");
    assert_eq!(output.stdout, b"", "{arguments}");
    assert_eq!(stderr.lines().count(), 1, "{arguments}: {stderr}");
    assert!(!stderr.contains("panicked"), "{stderr}");
    assert!(
        contents(folder) == before,
        "{arguments} left something behind"
    );
    stderr.trim_end().to_string()
}

/// One triangle, skinned to two joints, as glTF.
fn gltf() -> Value {
    let mut bytes: Vec<u8> = Vec::new();
    for position in [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        bytes.extend(position.iter().flat_map(|x| x.to_le_bytes()));
    }
    for _ in 0..3 {
        bytes.extend([0u8, 1, 0, 0]);
    }
    for _ in 0..3 {
        bytes.extend([0.5f32, 0.5, 0.0, 0.0].iter().flat_map(|x| x.to_le_bytes()));
    }
    with_bytes(
        json!({
            "asset": {"version": "2.0"},
            "scenes": [{"nodes": [0, 1]}],
            "nodes": [
                {"mesh": 0, "skin": 0},
                {"name": "shoulder", "children": [2]},
                {"name": "elbow"},
            ],
            "skins": [{"joints": [1, 2]}],
            "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "JOINTS_0": 1, "WEIGHTS_0": 2}}]}],
            "accessors": [
                {"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3", "min": [0, 0, 0], "max": [1, 1, 0]},
                {"bufferView": 1, "componentType": 5121, "count": 3, "type": "VEC4"},
                {"bufferView": 2, "componentType": 5126, "count": 3, "type": "VEC4"},
            ],
            "bufferViews": [
                {"buffer": 0, "byteOffset": 0, "byteLength": 36},
                {"buffer": 0, "byteOffset": 36, "byteLength": 12},
                {"buffer": 0, "byteOffset": 48, "byteLength": 48},
            ],
        }),
        &bytes,
    )
}

fn with_bytes(mut gltf: Value, bytes: &[u8]) -> Value {
    let uri = format!(
        "data:application/octet-stream;base64,{}",
        STANDARD.encode(bytes)
    );
    gltf["buffers"] = json!([{"byteLength": bytes.len(), "uri": uri}]);
    gltf
}

fn bytes_of(gltf: &Value) -> Vec<u8> {
    let uri = gltf["buffers"][0]["uri"].as_str().unwrap();
    STANDARD.decode(uri.split(',').nth(1).unwrap()).unwrap()
}

#[test]
fn bad_scenes_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let refused = |gltf: Value, word: &str| {
        std::fs::write(folder.join("a.gltf"), gltf.to_string()).unwrap();
        let line = fault("a.gltf --out film --gif f.gif --json f.json", folder);
        assert!(line.starts_with("error: ") && line.contains(word), "{line}");
    };
    let mut cyclic = gltf();
    cyclic["nodes"][2]["children"] = json!([1]);
    cyclic["scenes"][0]["nodes"] = json!([0]);
    refused(cyclic, "cyclic");
    let mut missing = gltf();
    missing["buffers"][0]["uri"] = json!("nowhere.bin");
    refused(missing, "nowhere.bin");
    let mut bytes = bytes_of(&gltf());
    bytes[37] = 9;
    refused(with_bytes(gltf(), &bytes), "out of range");
    let mut bytes = bytes_of(&gltf());
    bytes[48..64].fill(0);
    refused(with_bytes(gltf(), &bytes), "weights");
    let mut bytes = bytes_of(&gltf());
    bytes[48..52].copy_from_slice(&f32::NAN.to_le_bytes());
    refused(
        with_bytes(gltf(), &bytes),
        "WEIGHTS_0: accessor 2: element 0 is not finite",
    );
    let mut flat = gltf();
    flat["nodes"][0] = json!({"mesh": 0, "scale": [1, 0, 1]});
    flat["meshes"][0]["primitives"][0]["attributes"] = json!({"POSITION": 0});
    flat["skins"].as_array_mut().unwrap().clear();
    flat.as_object_mut().unwrap().remove("skins");
    refused(flat, "singular");

    std::fs::create_dir(folder.join("sequence")).unwrap();
    let frame = |name: &str, faces: &str| {
        let text = format!("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\n{faces}");
        std::fs::write(folder.join("sequence").join(name), text).unwrap();
    };
    frame("1.obj", "f 1 2 3\n");
    frame("2.obj", "f 1 2 3\nf 2 4 3\n");
    let line = fault("sequence --out film", folder);
    assert!(line.contains("2.obj"), "{line}");
}

#[test]
fn bad_arguments_are_refused_in_one_line() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let water = "builtin:water?resolution=4";
    for (arguments, wanted) in [
        (
            format!("{water} --clip tide"),
            "error: scene water: no clip `tide`; there are `waves`",
        ),
        (
            format!("{water} --frames 0"),
            "error: --frames 0: give a whole number from 1 to 100000",
        ),
        (
            format!("{water} --frames -3"),
            "error: --frames -3: give a whole number from 1 to 100000",
        ),
        (
            format!("{water} --fps 0"),
            "error: --fps 0: give 0.001 to 1000000 frames per second",
        ),
        (
            format!("{water} --rebuild-above 0.5"),
            "error: --rebuild-above 0.5: give a factor of at least 1",
        ),
        (
            format!("{water} --frames 2 --from-frame 2"),
            "error: --from-frame 2: there are 2 frames, counted from 0",
        ),
        (
            format!("{water} --gif no/such.gif"),
            "error: no/such.gif: cannot be written: there is no folder no; give a place that exists and can be written",
        ),
        (
            "builtin:figure?detail=36 --set skinning.joints=16".into(),
            "error: scene figure: figure has 21 joints, but the machine's palette holds 16; raise skinning.joints, or bind the object to fewer",
        ),
        (
            format!("{water} --frames 1 --trace w.fst --cycles 5 --unit skinning"),
            "error: scene water: this scene has no skinned objects, so the skinning processor has no waveform; give another unit",
        ),
    ] {
        assert_eq!(fault(&arguments, folder), wanted);
    }
    std::fs::write(folder.join("taken"), "").unwrap();
    for (out, wanted) in [
        (
            "taken",
            "error: taken: is a file; give --out a folder's name",
        ),
        ("taken/below", "error: taken/below: cannot be written: "),
    ] {
        let line = fault(&format!("{water} --out {out}"), folder);
        assert!(line.starts_with(wanted), "{line}");
    }
}
