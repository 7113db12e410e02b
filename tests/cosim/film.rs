//! The lists of several frames in Verilog: on the processors, each alone, and on the chip by `dynrt run`.

use crate::animate::Shown;
use crate::support::command::dynrt;
use crate::support::{seed, shared_scene};
use dynrt::bkd::Record;
use dynrt::bkd::bytes::ByteRecord;
use dynrt::chip::descriptor::{Command, Skin, Update};
use dynrt::chip::image::{Builder, hits_of};
use dynrt::chip::memory::Memory;
use dynrt::config::Config;
use dynrt::cosim::animate;
use dynrt::cosim::memory::Image;
use dynrt::cosim::scoreboard::{Surroundings, UnitOptions};
use dynrt::cosim::unit_skinning::{self, SkinArrays, SkinUnit};
use dynrt::cosim::unit_update::{self, UpdateArrays, UpdateUnit};
use dynrt::film;
use dynrt::golden::chip::Chip;
use dynrt::golden::skinning::SkinCommand;
use dynrt::golden::update::UpdateCommand;
use dynrt::scene::load_animated;
use serde_json::Value;

/// The processors in Verilog, and the arrays of a film in memory.
struct Processors {
    config: Config,
    skinning: SkinUnit,
    update: UpdateUnit,
    around: Surroundings,
    vertices_at: u32,
    vertices: Vec<u32>,
    nodes: Vec<u32>,
}

/// The words of `count` records at an address.
fn words(memory: &Memory, record: &ByteRecord, address: u32, count: u64) -> Vec<u32> {
    let bytes = count as usize * record.bytes as usize;
    let bytes = memory.read(address.into(), bytes).unwrap();
    let records = bytes.chunks_exact(record.bytes as usize);
    records.flat_map(|bytes| record.read(bytes)).collect()
}

impl Processors {
    fn skin(&mut self, memory: &Memory, skin: &Skin) {
        let (format, rows) = (self.config.format(), skin.rows);
        let row = ByteRecord::influence_row(format);
        let vertices = std::mem::take(&mut self.vertices);
        let mut arrays = SkinArrays {
            influences: words(memory, &row, skin.influences, rows.into()),
            vertices: Image::from_words(vertices, Record::vertex(format).width).unwrap(),
        };
        let command = SkinCommand {
            palette: skin.palette,
            joints: skin.joints,
            influences: 0,
            rows,
            rest: skin.rest,
            vertices: skin.count,
            target: skin.target,
        };
        let traffic = unit_skinning::Traffic::Shared;
        let found = self
            .skinning
            .skin(&mut arrays, command, &self.around, traffic);
        assert_eq!(found.unwrap().vertices, u64::from(skin.count));
        self.vertices = arrays.vertices.into_words();
    }

    fn update(&mut self, memory: &Memory, update: &Update) {
        let format = self.config.format();
        let rows = 16 * update.rows as usize;
        let mut arrays = UpdateArrays {
            program: memory.read(update.program.into(), rows).unwrap().to_vec(),
            vertices: self.vertices.clone(),
            nodes: Image::from_words(std::mem::take(&mut self.nodes), Record::node(format).width)
                .unwrap(),
            boxes: Image::zeroed(1, Record::bounding_box(format).width),
        };
        let command = UpdateCommand {
            program: 0,
            vertex_base: update.first_vertex,
            node_base: update.first_node,
            box_index: 0,
        };
        let traffic = unit_update::Traffic::Shared;
        let found = self
            .update
            .update(&mut arrays, command, update.rows, &self.around, traffic);
        found.unwrap_or_else(|error| panic!("{error:#}"));
        self.nodes = arrays.nodes.words().to_vec();
        // A box among the vertices is two of them.
        let (layout, vertex) = (Record::bounding_box(format), ByteRecord::vertex(format));
        let index = update.bounds.wrapping_sub(self.vertices_at) / vertex.bytes;
        let first = index as usize * vertex.record.words();
        if let Some(corners) = self
            .vertices
            .get_mut(first..first + 2 * vertex.record.words())
        {
            let corners = corners.chunks_exact_mut(vertex.record.words());
            for (corner, numbers) in corners.zip(layout.fields.chunks(3)) {
                for (name, number) in ["x", "y", "z"].into_iter().zip(numbers) {
                    vertex
                        .record
                        .set(corner, name, number.get(arrays.boxes.row(0)));
                }
            }
        }
    }
}

/// The skinning processor and the update processor run the commands of films: copies by the identity, and top-level trees whose vertices
/// are loaded by index. They leave the vertices and nodes of the golden chip.
#[test]
fn processors_run_the_lists_of_films() {
    let config = Config::reference();
    let (format, options) = (config.format(), UnitOptions::new(seed()));
    let mut specs = vec![
        "builtin:water?resolution=8".to_string(),
        "builtin:figure?detail=36".into(),
        "builtin:reef".into(),
    ];
    let robot = shared_scene("robot_expressive/RobotExpressive.glb");
    specs.extend(robot.clone());
    let (mut skins, mut updates, mut corners) = (0, 0, 0);
    for spec in specs {
        let scene = load_animated(&spec).unwrap();
        let clip = scene.clip(None).unwrap();
        let shown = Shown::clip(&config, &scene, clip, 2, "8x6");
        let builder = Builder::new(0x1000, 1 << 30);
        let packed = film::pack(&config, shown.film(), f64::INFINITY, builder).unwrap();
        let part = |name: &str| packed.parts.iter().find(|part| part.name == name).unwrap();
        let (vertex, node) = (ByteRecord::vertex(format), ByteRecord::node(format));
        let array = |memory: &Memory, name: &str, record: &ByteRecord| {
            let part = part(name);
            words(
                memory,
                record,
                part.address,
                part.bytes / u64::from(record.bytes),
            )
        };
        let mut memory = packed.memory.clone();
        let mut processors = Processors {
            config: config.clone(),
            skinning: SkinUnit::new(&config, &options).unwrap(),
            update: UpdateUnit::new(&config, &options).unwrap(),
            around: Surroundings::steady(8),
            vertices_at: part("vertices").address,
            vertices: array(&memory, "vertices", &vertex),
            nodes: array(&memory, "nodes", &node),
        };
        let mut chip = Chip::new(&config);
        for (number, frame) in packed.frames.iter().enumerate() {
            for command in &frame.commands {
                match command {
                    Command::Skin(skin) => {
                        processors.skin(&memory, skin);
                        skins += 1;
                    }
                    Command::Update(update) => {
                        processors.update(&memory, update);
                        updates += 1;
                        let vertices = part("vertices").address..part("update programs").address;
                        corners += u64::from(vertices.contains(&update.bounds));
                    }
                    _ => {}
                }
            }
            chip.run(&mut memory, frame.list, 1 << 16).check().unwrap();
            let same = processors.vertices == array(&memory, "vertices", &vertex);
            assert!(same, "{spec}, frame {number}: vertices");
            let same = processors.nodes == array(&memory, "nodes", &node);
            assert!(same, "{spec}, frame {number}: nodes");
        }
    }
    println!(
        "{skins} commands skin, {updates} update and agree; {corners} write the corners of an instance"
    );
    assert!(skins >= 8 && updates >= 8 && (corners > 0 || robot.is_none()));
}

/// The hits that the lists leave give the pictures of `dynrt animate`, whose processors are in Verilog and which builds other top-level
/// trees.
#[test]
fn pictures_are_those_of_the_other_command() {
    let config = Config::reference();
    let (mut frames, mut hits) = (0, 0);
    for spec in [
        "builtin:figure?detail=36",
        "builtin:reef",
        "builtin:water?resolution=8",
    ] {
        let scene = load_animated(spec).unwrap();
        let clip = scene.clip(None).unwrap();
        let shown = Shown::clip(&config, &scene, clip, 2, "32x24");
        let builder = Builder::new(0, 1 << 30);
        let packed = film::pack(&config, shown.film(), film::REBUILD_ABOVE, builder).unwrap();
        let reports = shown.run(&config, &animate::Options::default()).unwrap();
        let (mut memory, mut chip) = (packed.memory.clone(), Chip::new(&config));
        for (number, frame) in packed.frames.iter().enumerate() {
            let outcome = chip.run(&mut memory, frame.list, 1 << 16);
            outcome.check().unwrap();
            hits += outcome.hits;
            let found = packed
                .casts
                .iter()
                .flat_map(|cast| hits_of(&memory, &config, cast));
            let found: Vec<_> = found.collect();
            let objects = 0..scene.objects.len();
            let vertices = objects.map(|object| shown.film().vertices(object, number).unwrap());
            let vertices: Vec<_> = vertices.collect();
            let of = |object: usize| &vertices[object][..];
            let picture = shown.film().shade(number, &frame.there, of, &found);
            assert!(picture == reports[number].picture, "{spec}, frame {number}");
            frames += 1;
        }
    }
    println!("{frames} pictures with {hits} hits are equal");
    assert!(frames == 6 && hits > 500);
}

/// Frames of a still scene: each is a list of its own, and the figures of all are sums of theirs.
#[test]
fn the_command_runs_a_list_for_each_frame() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let arguments = "run builtin:cornell --config tiny --size 24x18 --frames 2 --out film --gif film.gif --json film.json";
    let output = dynrt(arguments, folder).output().unwrap();
    let (stdout, stderr) = (output.stdout, String::from_utf8(output.stderr).unwrap());
    assert!(output.status.success() && stderr.is_empty(), "{stderr}");
    let text = String::from_utf8(stdout).unwrap();
    for line in [
        "frame 0: ",
        "frame 1: ",
        "frames: film",
        "animated picture: film.gif",
    ] {
        assert!(text.lines().any(|l| l.starts_with(line)), "{line}: {text}");
    }
    let picture = |name: &str| image::open(folder.join(name)).unwrap().into_rgb8();
    let pictures = [0, 1].map(|number| picture(&format!("film/frame_000{number}.png")));
    assert_eq!(pictures[0].dimensions(), (24, 18));
    assert_eq!(pictures[0], pictures[1]);
    let json: Value =
        serde_json::from_slice(&std::fs::read(folder.join("film.json")).unwrap()).unwrap();
    let frames = json["per_frame"].as_array().unwrap();
    assert_eq!((frames.len(), &json["frames"]), (2, &Value::from(2)));
    for key in [
        "cycles",
        "rays",
        "hits",
        "bytes_read",
        "bytes_written",
        "cast_cycles",
    ] {
        let sum: u64 = frames
            .iter()
            .map(|frame| frame[key].as_u64().unwrap())
            .sum();
        assert_eq!(json[key].as_u64(), Some(sum), "{key}");
        assert!(sum > 0, "{key}");
    }
    for key in [
        "skinning_cycles",
        "update_cycles",
        "influences",
        "triangles_updated",
    ] {
        assert_eq!(json[key], 0, "{key}: nothing moves");
    }
    for key in [
        "update_triangles_per_clock",
        "skinning_influences_per_clock",
    ] {
        assert!(json[key].is_null(), "{key}");
    }
    let rate = json["rays"].as_f64().unwrap() / json["cast_cycles"].as_f64().unwrap();
    assert_eq!(json["rays_per_clock"].as_f64(), Some(rate));
    assert_eq!(json["rays"], 2 * 24 * 18);
    assert!(json["checked"].as_u64() > json["rays"].as_u64());
    // One frame is a picture, which a still scene has without --frames as well.
    for (frames, name) in [("", "still.png"), (" --view outside --frames 1", "one.png")] {
        let view = if frames.is_empty() {
            " --view outside"
        } else {
            ""
        };
        let arguments =
            format!("run builtin:cornell --config tiny --size 24x18{view}{frames} --out {name}");
        let output = dynrt(&arguments, folder).output().unwrap();
        assert!(
            output.status.success(),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    }
    assert_eq!(picture("still.png"), picture("one.png"));
}
