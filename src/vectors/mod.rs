//! Golden vectors: memory images, stimulus and expected results of every unit, as text files that any program can read.
//!
//! [`write()`] casts packets in the golden model and writes the inputs and outputs of each unit.
//! `docs/vectors.md` defines the files; the benches in `sim/` replay them in the RTL.
//!
//! | module | content |
//! |---|---|
//! | `layout` | the fields of a line |
//! | `shape` | the layout of each file of one machine, and the values of its lines |
//! | `sheet` | writes a file line by line |
//! | `collect` | lines from events of the golden model |
//! | `directed` | lines that a frame may not contain |
//! | `update` | updates of the scene's objects |
//! | `skinning` | skinned meshes |
//! | `pose` | an animated scene in memory at one time |
//! | `scenes` | directed scenes, stored after the given one |
//! | `plan` | the packets to cast, and the size of the files |
//! | `header` | macros for the Verilog benches |
//! | `ports` | the field that belongs to each port |
//! | `manifest` | the manifest |

mod collect;
mod directed;
mod header;
mod layout;
mod manifest;
mod plan;
mod ports;
mod pose;
mod scenes;
mod shape;
mod sheet;
mod skinning;
mod update;

pub use pose::{Posed, pose};

use crate::bkd::layout::{MemoryImage, Record, check_capacity};
use crate::config::Config;
use crate::cosim::unit_skinning::SkinMesh;
use crate::golden::Caster;
use crate::hw;
use crate::report::folder::{Content, Folder};
use crate::scene::{Camera, Frame, RayPacket};
use anyhow::{Context, Result, anyhow, ensure};
use collect::{Collector, Scene};
use directed::Operation;
use layout::Layout;
use manifest::{Contents, Files};
use scenes::DirectedScene;
use serde_json::Value;
use shape::Shape;
pub use sheet::sha256_of_bytes;
use sheet::{Sheet, UnitSheets};
use skinning::SkinSheets;
use std::path::Path;
use std::rc::Rc;
use update::UpdateSheets;

/// The version of the format, which is in the manifest.
pub const VERSION: u32 = 3;

/// The file name of the manifest.
const MANIFEST: &str = "manifest.json";
/// The key in the manifest that marks a folder of vectors; its value is the version of the format.
const VERSION_KEY: &str = "dynrt_vectors";

/// A folder of vectors: its manifest lists its files.
const CONTENT: Content = Content {
    name: "vectors",
    owned: |folder, _| {
        let text = std::fs::read_to_string(folder.join(MANIFEST)).ok()?;
        let manifest: Value = serde_json::from_str(&text).ok()?;
        manifest.get(VERSION_KEY)?;
        let files = manifest["files"].as_array();
        let listed = files.into_iter().flatten();
        let names = listed.filter_map(|file| file["file"].as_str());
        Some(names.chain([MANIFEST]).map(str::to_string).collect())
    },
};

/// The label of the given scene.
const GIVEN: &str = "given";

/// The file with the macros for the Verilog benches.
pub const HEADER: &str = "vectors.vh";

/// A request to write vectors.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    pub config: &'a Config,
    /// The scene's name in the manifest.
    pub scene_name: &'a str,
    /// One or two levels, in the configuration's number format.
    pub image: &'a MemoryImage,
    /// The scene's skinned objects; directed meshes are always added.
    pub skins: &'a [SkinMesh],
    /// At least one packet; each has the number of rays that the configuration defines.
    pub packets: &'a [RayPacket],
    /// Maximum number of `packets` to cast, spread evenly; `None` for all.
    pub limit: Option<usize>,
    /// Whether to write directed scenes after the image, as far as the machine can hold them. They test rules that few
    /// scenes exercise, and are most of the bytes of a small folder.
    pub directed_scenes: bool,
    /// Whether to write more than 1 GiB.
    pub force: bool,
    /// Recorded in the manifest.
    pub made: Made<'a>,
    /// The folder to write.
    pub out: &'a Path,
}

/// Origin of the packets and the scene.
#[derive(Clone, Copy, Debug)]
pub struct Made<'a> {
    /// The command that writes the same files again, except for the output folder.
    pub command: &'a str,
    /// The picture that the packets belong to.
    pub frame: Frame,
    pub camera: Camera,
    /// A coordinate of the scene times 2^`log2_scale` is a machine coordinate.
    pub log2_scale: i32,
    /// For an animated scene: the clip, if it has one, and the time in seconds.
    pub motion: Option<(Option<&'a str>, f64)>,
}

/// Counts of what was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Packets cast: those of the request, variants of their rays, and those of directed scenes.
    pub packets: u64,
    /// Rays of these packets, including inactive ones.
    pub rays: u64,
    /// Packet steps of these packets.
    pub steps: u64,
    /// Ray–triangle tests of these packets.
    pub tests: u64,
    /// Ray transformations of these packets; 0 if all scenes have one level.
    pub transforms: u64,
    /// Updates of objects, and the number of nodes written.
    pub updates: u64,
    pub nodes_written: u64,
    /// Skinned meshes, and the number of their vertices.
    pub skins: u64,
    pub vertices_skinned: u64,
    /// Files in the folder.
    pub files: usize,
}

/// Casts packets and writes the vectors of all units into a folder. The folder appears only when it is complete, and replaces
/// earlier vectors of the same name.
///
/// # Errors
/// One line if there is no packet to cast, if the machine cannot hold the image, if the files are larger than allowed, or if the
/// folder contains other files or cannot be written.
pub fn write(request: &Request<'_>) -> Result<Summary> {
    let Request { config, image, .. } = *request;
    check(request)?;
    let machine = hw::Plan::new(config)
        .and_then(|plan| hw::core::emit(&plan.with_trace(true)))
        .map_err(|error| anyhow!("the machine: {error}"))?;
    let design = &machine.design;
    let shape = Shape::new(config);
    let directed = match request.directed_scenes {
        true => scenes::scenes(config, image),
        false => vec![],
    };
    let given = [(image, 0)].into_iter();
    let behind = directed
        .iter()
        .map(|scene| (&scene.image, scene.first_record as u32));
    let scenes: Vec<Scene<'_>> = given
        .chain(behind)
        .map(|(image, first_record)| Scene {
            image,
            caster: Rc::new(Caster::new(image, shape.test, shape.rays)),
            first_record,
        })
        .collect();
    let plan = {
        let casters: Vec<&Caster> = scenes.iter().map(|scene| &*scene.caster).collect();
        plan::plan(request, &shape, &directed, &casters)
    };
    plan.check(request.scene_name, request.force)?;

    let folder = Folder::begin(request.out, CONTENT)?;
    let mut files = Files::default();
    memories(&folder, &mut files, &shape, image, &directed)?;
    let two_levels = scenes.iter().any(|scene| scene.image.is_instanced());
    let mut collector = Collector::new(&folder, shape.clone(), scenes)?;
    for packet in &plan.packets {
        collector.cast(packet)?;
    }
    let context = || format!("scene {}", request.scene_name);
    let mut update = UpdateSheets::write(&folder, config, &shape, image).with_context(context)?;
    let mut skin =
        SkinSheets::write(&folder, config, &shape, request.skins).with_context(context)?;
    let transforms = collector.transforms();
    directed::transactions(&mut collector)?;
    let mut arithmetic = operations(&folder, &collector)?;
    list(
        &mut files,
        &mut collector,
        &mut update,
        &mut skin,
        &mut arithmetic,
    )?;

    let settings = header::machine(config, &shape, design, two_levels);
    let described = files.entries.iter();
    let entries: Vec<_> = described
        .filter_map(|entry| {
            Some(header::Entry {
                stem: entry.file.trim_end_matches(".hex"),
                lines: entry.lines,
                layout: files.layout_of(entry)?,
            })
        })
        .collect();
    let text = header::text(&settings, design, &entries);
    folder.write(HEADER, &text)?;
    files.entries.push(manifest::header_entry(&text));
    files.add_records(&shape);
    let summary = Summary {
        packets: collector.packets.lines,
        rays: collector.rays.lines,
        steps: collector.steps,
        tests: collector.tests,
        transforms,
        updates: update.commands.lines,
        nodes_written: update.writes.lines,
        skins: skin.commands.lines,
        vertices_skinned: skin.expected.lines,
        files: files.entries.len() + 1,
    };
    let contents = Contents {
        request,
        directed: &directed,
        shape: &shape,
        design,
        machine: &settings,
        update: update.machine,
        of_picture: plan.of_picture,
        totals: vec![
            ("packets", summary.packets),
            ("rays", summary.rays),
            ("packet_steps", summary.steps),
            ("ray_triangle_tests", summary.tests),
            ("ray_transforms", summary.transforms),
            ("updates", summary.updates),
            ("update_instructions", update.instructions),
            ("nodes_written", summary.nodes_written),
            ("skinned_meshes", summary.skins),
            ("skinned_vertices", summary.vertices_skinned),
            ("influences", skin.total),
        ],
    };
    folder.write(MANIFEST, &format!("{:#}\n", contents.manifest(&files)?))?;
    folder.publish()?;
    Ok(summary)
}

/// Writes the memory arrays of all scenes, one after another, and the scenes' registers.
fn memories(
    folder: &Folder,
    files: &mut Files,
    shape: &Shape,
    image: &MemoryImage,
    directed: &[DirectedScene],
) -> Result<()> {
    let given = [(GIVEN, image)].into_iter();
    let behind = directed.iter().map(|scene| (scene.label, &scene.placed));
    let scenes: Vec<(&str, &MemoryImage)> = given.chain(behind).collect();
    type Words = fn(&MemoryImage) -> Vec<u32>;
    for (stem, record, words) in [
        (
            "nodes",
            Record::node(image.format),
            MemoryImage::node_words as Words,
        ),
        ("records", Record::triangle(), MemoryImage::record_words),
        (
            "vertices",
            Record::vertex(image.format),
            MemoryImage::vertex_words,
        ),
    ] {
        let layout = Layout::default().record(&record, image.format);
        let mut sheet = Sheet::new(folder, stem, layout, scenes[0].0)?;
        for (label, image) in &scenes {
            sheet.begin(label);
            for line in record.hex_lines(&words(image)).lines() {
                sheet.push_text(line)?;
            }
        }
        files.list(&mut sheet, "memory", "image")?;
    }
    let mut registers = Sheet::new(folder, "scene", shape.scene(), scenes[0].0)?;
    for (label, image) in &scenes {
        registers.begin(label);
        registers.push(&shape.scene_values(image.root, image.bounds))?;
    }
    files.list(&mut registers, "memory", "registers")
}

/// Completes and lists the files of all units.
fn list(
    files: &mut Files,
    collector: &mut Collector<'_>,
    update: &mut UpdateSheets,
    skin: &mut SkinSheets,
    arithmetic: &mut [UnitSheets],
) -> Result<()> {
    files.list(&mut collector.rays, "raycast", "stimulus")?;
    files.list(&mut collector.hits, "raycast", "expected")?;
    files.list(&mut collector.packets, "raycast", "packets")?;
    for sheet in &mut update.images {
        files.list(sheet, "update", "image")?;
    }
    files.list(&mut update.commands, "update", "stimulus")?;
    for sheet in [&mut update.writes, &mut update.after, &mut update.boxes] {
        files.list(sheet, "update", "expected")?;
    }
    files.list(&mut skin.influences, "skinning", "image")?;
    files.list(&mut skin.vectors, "skinning", "image")?;
    files.list(&mut skin.commands, "skinning", "stimulus")?;
    files.list(&mut skin.expected, "skinning", "expected")?;
    let sheets = [
        Some(&mut collector.setup),
        Some(&mut collector.step),
        Some(&mut collector.test),
        collector.transform.as_mut(),
    ];
    for unit in sheets.into_iter().flatten().chain(arithmetic) {
        let name = unit.name;
        for (role, sheet) in ["stimulus", "expected", "care"]
            .into_iter()
            .zip(unit.sheets())
        {
            files.list(sheet, name, role)?;
        }
    }
    Ok(())
}

/// Checks a request before anything is written.
fn check(request: &Request<'_>) -> Result<()> {
    let Request {
        config,
        image,
        packets,
        ..
    } = *request;
    let scene = request.scene_name;
    ensure!(
        !packets.is_empty() && request.limit != Some(0),
        "scene {scene}: no packet is to be cast; allow at least one"
    );
    ensure!(
        image.format == config.format(),
        "scene {scene}: its memory image is of {}, but the machine {} has {}; make the image for this machine",
        image.format,
        config.name,
        config.format()
    );
    let rays = config.rays_per_packet as usize;
    for (number, packet) in packets.iter().enumerate() {
        ensure!(
            packet.rays.len() == rays,
            "scene {scene}: packet {number} has {} rays, but the machine {} takes packets of {rays}; make packets for this machine",
            packet.rays.len(),
            config.name
        );
    }
    image
        .check(config.stack_depth)
        .with_context(|| format!("scene {scene}"))?;
    check_capacity(0, image.records.len() as u64, config.address_bits)
        .with_context(|| format!("scene {scene}"))?;
    ensure!(
        image.vertices.len() as u64 <= 1 << config.address_bits,
        "scene {scene}: the scene is too large for its address space: {} vertices, but {} address bits hold {}; \
         simplify the mesh or widen the address",
        image.vertices.len(),
        config.address_bits,
        1u64 << config.address_bits
    );
    Ok(())
}

/// The vectors of the arithmetic units.
fn operations(folder: &Folder, collector: &Collector<'_>) -> Result<Vec<UnitSheets>> {
    let operands = &collector.operands;
    let directions: Vec<_> = operands.reciprocal.kept.iter().map(|&x| [x, 0.0]).collect();
    let mut units = vec![];
    for (name, operation, of_frame) in [
        (
            "fp_add",
            Operation::Binary(|a, x, y| a.add(x, y)),
            &operands.add.kept,
        ),
        (
            "fp_sub",
            Operation::Binary(|a, x, y| a.sub(x, y)),
            &operands.sub.kept,
        ),
        (
            "fp_mul",
            Operation::Binary(|a, x, y| a.mul(x, y)),
            &operands.mul.kept,
        ),
        (
            "fp_reciprocal",
            Operation::Unary(|a, x| a.reciprocal(x)),
            &directions,
        ),
    ] {
        let count = match operation {
            Operation::Unary(_) => 1,
            Operation::Binary(_) => 2,
        };
        let shape = &collector.shape;
        let mut sheets =
            UnitSheets::new(folder, name, shape.operands(count), shape.result(), false)?;
        directed::arithmetic(collector, &mut sheets, &operation, of_frame)?;
        units.push(sheets);
    }
    Ok(units)
}
