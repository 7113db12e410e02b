//! Golden vectors: memory images, stimulus and expected results of every unit, as text files that any program reads.
//!
//! [`write()`] casts packets in the golden model and writes down what goes into and comes out of each unit.
//! `docs/vectors.md` describes the files for who knows nothing else; the benches in `sim/` replay them in the RTL.
//!
//! | module | what |
//! |---|---|
//! | `layout` | the fields of a line |
//! | `shape` | the layout of each file of one machine, and the values of its lines |
//! | `sheet` | a file of lines being written |
//! | `collect` | lines from the golden model at work |
//! | `directed` | lines that a frame may not bring |
//! | `update` | the update of the scene's objects |
//! | `skinning` | skinned meshes |
//! | `pose` | a scene that moves, in memory as it is at one time |
//! | `header` | what the Verilog benches must know, as macros |

mod collect;
mod directed;
mod header;
mod layout;
mod pose;
mod shape;
mod sheet;
mod skinning;
mod update;

pub use pose::{Posed, pose};

use crate::bkd::layout::{MemoryImage, Record, check_capacity};
use crate::config::{Config, TriangleTest};
use crate::cosim::unit_skinning::SkinMesh;
use crate::hw;
use crate::port::Hit;
use crate::report::folder::{Content, Folder};
use crate::scene::RayPacket;
use anyhow::{Context, Result, anyhow, ensure};
use collect::Collector;
use directed::Operation;
use layout::Layout;
use serde_json::{Value, json};
use shape::Shape;
use sheet::{Sheet, UnitSheets};
use skinning::SkinSheets;
use std::path::Path;
use update::UpdateSheets;

/// The version of the vectors' form, in the manifest.
pub const VERSION: u32 = 2;

/// The manifest's name in the folder.
const MANIFEST: &str = "manifest.json";
/// The manifest's key that says that a folder holds vectors; its value is the version of their form.
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

/// The file of the macros for the Verilog benches.
pub const HEADER: &str = "vectors.vh";

/// What vectors to write.
#[derive(Clone, Copy, Debug)]
pub struct Request<'a> {
    pub config: &'a Config,
    /// Names the scene in the manifest.
    pub scene_name: &'a str,
    /// Of one level or two, in the configuration's number format.
    pub image: &'a MemoryImage,
    /// The scene's skinned objects, to which others are always added.
    pub skins: &'a [SkinMesh],
    /// Of as many rays as the configuration says; at least one packet.
    pub packets: &'a [RayPacket],
    /// The most of `packets` to cast, spread over them; `None` for all.
    pub limit: Option<usize>,
    /// The folder to write.
    pub out: &'a Path,
}

/// What was written.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Summary {
    /// Packets cast: those of the request, and of variants of their rays.
    pub packets: u64,
    /// Their rays, inactive ones included.
    pub rays: u64,
    /// Their packet steps.
    pub steps: u64,
    /// Their ray–triangle tests.
    pub tests: u64,
    /// Their ray transformations; none in a scene of one level.
    pub transforms: u64,
    /// Updates of objects, and the nodes that they write.
    pub updates: u64,
    pub nodes_written: u64,
    /// Meshes skinned, and their vertices.
    pub skins: u64,
    pub vertices_skinned: u64,
    /// Files in the folder.
    pub files: usize,
}

/// Casts packets and writes the vectors of all units into a folder, which appears whole or not at all. Earlier vectors in its
/// place are replaced.
///
/// # Errors
/// One line: no packet to cast, an image that the machine cannot hold, a folder that holds something else or cannot be written.
pub fn write(request: &Request<'_>) -> Result<Summary> {
    let Request { config, image, .. } = *request;
    check(request)?;
    let machine = hw::core::emit(config).map_err(|error| anyhow!("the machine: {error}"))?;
    let folder = Folder::begin(request.out, CONTENT)?;
    let shape = Shape::new(config);

    let mut memories = vec![];
    for (stem, record, words) in [
        ("nodes", Record::node(image.format), image.node_words()),
        ("records", Record::triangle(), image.record_words()),
        (
            "vertices",
            Record::vertex(image.format),
            image.vertex_words(),
        ),
    ] {
        let layout = Layout::default().record(&record, image.format);
        let mut sheet = Sheet::new(&folder, stem, layout)?;
        for line in record.hex_lines(&words).lines() {
            sheet.push_text(line)?;
        }
        memories.push(sheet);
    }
    let mut scene = Sheet::new(&folder, "scene", shape.scene())?;
    scene.push(&shape.scene_values(image.root, image.bounds))?;

    let mut collector = Collector::new(&folder, shape.clone(), image)?;
    cast(&mut collector, request)?;
    let context = || format!("scene {}", request.scene_name);
    let mut update = UpdateSheets::write(&folder, config, &shape, image).with_context(context)?;
    let mut skin =
        SkinSheets::write(&folder, config, &shape, request.skins).with_context(context)?;
    directed::transactions(&mut collector)?;
    let mut arithmetic = operations(&folder, &collector)?;

    let mut units = vec![];
    let mut files = vec![];
    let mut list = |sheet: &mut Sheet, unit: &str, role: &str, layout: &str| {
        sheet.finish()?;
        files.push((
            sheet.file.clone(),
            json!({"file": sheet.file, "unit": unit, "role": role, "lines": sheet.lines, "layout": layout}),
            sheet.layout.clone(),
            sheet.lines,
        ));
        anyhow::Ok(())
    };
    for sheet in &mut memories {
        let stem = stem(sheet);
        list(sheet, "memory", "image", &stem)?;
    }
    list(&mut scene, "memory", "registers", "scene")?;
    list(&mut collector.rays, "raycast", "stimulus", "raycast_rays")?;
    list(&mut collector.hits, "raycast", "expected", "raycast_hits")?;
    list(
        &mut collector.packets,
        "raycast",
        "packets",
        "raycast_packets",
    )?;
    let [program, vertices, before] = &mut update.images;
    for (sheet, role) in [
        (program, "image"),
        (vertices, "image"),
        (before, "image"),
        (&mut update.commands, "stimulus"),
        (&mut update.writes, "expected"),
        (&mut update.after, "expected"),
        (&mut update.boxes, "expected"),
    ] {
        let stem = stem(sheet);
        list(sheet, "update", role, &stem)?;
    }
    for (sheet, role) in [
        (&mut skin.influences, "image"),
        (&mut skin.vectors, "image"),
        (&mut skin.commands, "stimulus"),
        (&mut skin.expected, "expected"),
    ] {
        let stem = stem(sheet);
        list(sheet, "skinning", role, &stem)?;
    }
    let transforms = collector.transforms();
    let sheets = [
        Some(&mut collector.setup),
        Some(&mut collector.step),
        Some(&mut collector.test),
        collector.transform.as_mut(),
    ];
    for unit in sheets.into_iter().flatten().chain(&mut arithmetic) {
        let name = unit.name;
        units.push(json!({
            "unit": name,
            "transactions": unit.stimulus.lines,
            "stimulus": unit.stimulus.file,
            "expected": unit.expected.file,
            "care": unit.care.as_ref().map(|care| &care.file),
        }));
        for (role, sheet) in ["stimulus", "expected", "care"].iter().zip(unit.sheets()) {
            let layout = match *role {
                "care" => format!("{name}_expected"),
                _ => stem(sheet),
            };
            list(sheet, name, role, &layout)?;
        }
    }
    let entries: Vec<_> = files
        .iter()
        .map(|(file, _, layout, lines)| header::Entry {
            stem: file.trim_end_matches(".hex"),
            lines: *lines,
            layout,
        })
        .collect();
    folder.write(
        HEADER,
        &header::text(config, &shape, &machine.design, &entries),
    )?;
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
        files: files.len() + 2,
    };
    let mut layouts = serde_json::Map::new();
    for (file, described, layout, _) in &files {
        if described["role"] != "care" {
            let mut value = serde_json::to_value(layout)?;
            value["digits"] = json!(layout.digits());
            layouts.insert(file.trim_end_matches(".hex").to_string(), value);
        }
    }
    let mut described: Vec<Value> = files.into_iter().map(|(_, value, _, _)| value).collect();
    described.push(json!({"file": HEADER, "unit": "sim", "role": "macros"}));
    let instances = image.instance_records()?.len();
    let manifest = json!({
        VERSION_KEY: VERSION,
        "scene": request.scene_name,
        "triangles": image.records.len() - instances,
        "levels": 1 + u32::from(image.is_instanced()),
        "instances": instances,
        "config": config.name,
        "configuration": settings(config)?,
        "number_format": {
            "width": image.format.width(),
            "exponent_bits": image.format.exponent_bits(),
            "fraction_bits": image.format.fraction_bits(),
            "bias": image.format.bias(),
        },
        "rays_per_packet": shape.rays,
        "tag_bits": shape.tag_bits,
        "triangle_test": match shape.test {
            TriangleTest::MollerTrumbore => "moller-trumbore",
            TriangleTest::Watertight => "watertight",
        },
        "packets": summary.packets,
        "rays": summary.rays,
        "packet_steps": summary.steps,
        "ray_triangle_tests": summary.tests,
        "ray_transforms": summary.transforms,
        "updates": summary.updates,
        "update_instructions": update.instructions,
        "nodes_written": summary.nodes_written,
        "skinned_meshes": summary.skins,
        "skinned_vertices": summary.vertices_skinned,
        "influences": skin.total,
        "units": units,
        "pipelines": header::pipelines(&machine.design),
        "files": described,
        "layouts": layouts,
    });
    folder.write(MANIFEST, &format!("{manifest:#}\n"))?;
    folder.publish()?;
    Ok(summary)
}

fn stem(sheet: &Sheet) -> String {
    sheet.file.trim_end_matches(".hex").to_string()
}

/// What must hold of a request before anything is written.
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

/// Casts the request's packets, or as many as its limit allows, then variants of the one with the most hits.
fn cast(collector: &mut Collector<'_>, request: &Request<'_>) -> Result<()> {
    let packets = request.packets;
    let count = request.limit.unwrap_or(packets.len()).min(packets.len());
    // One at random from each of `count` equal parts: a fixed distance would often meet the same column of the picture.
    let mut rng = fastrand::Rng::with_seed(3);
    for part in 0..count {
        let (from, to) = (
            part * packets.len() / count,
            (part + 1) * packets.len() / count,
        );
        collector.cast(&packets[rng.usize(from..to)].rays)?;
    }
    // Not only of those that were cast: the variants of rays that hit nothing would say little.
    let hits_of = |packet: &RayPacket| collector.hits_of(&packet.rays);
    let hits: Vec<Vec<Hit>> = packets.iter().map(hits_of).collect();
    let richest = (0..packets.len())
        .rev()
        .max_by_key(|&number| hits[number].iter().filter(|hit| hit.is_hit()).count())
        .expect("there are packets");
    directed::cast_variants(collector, &packets[richest].rays, &hits[richest])
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

/// The configuration's keys and values, by section.
fn settings(config: &Config) -> Result<Value> {
    let table: toml::Table = config.to_toml().parse()?;
    Ok(serde_json::to_value(table)?)
}
