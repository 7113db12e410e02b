//! The bench that is generated with a machine: that of the ray casting unit in `sim/`, with a small set of golden vectors. With it the
//! machine can be simulated without the rest of this program.

use crate::bkd::layout::MemoryImage;
use crate::bkd::{BuildOptions, build};
use crate::hw::Machine;
use crate::scene::{self, Camera, Frame, ImageSize, MachineMesh};
use crate::temporary;
use crate::vectors::{self, HEADER, Made, Summary};
use anyhow::{Context, Result};
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::fs;

/// The folder of the bench's files, inside the folder of the machine.
pub const FOLDER: &str = "sim";

/// The scene whose primary rays are cast; the variants of rays that all vectors have are added.
const SCENE: &str = "builtin:cornell";
const PICTURE: (u32, u32) = (8, 8);

/// The bench and the models around the unit; their modules use the names of the default prefix.
const SOURCES: [(&str, &str); 2] = [
    ("raycast_tb", include_str!("../../sim/raycast_tb.v")),
    ("memory", include_str!("../../sim/memory.v")),
];
/// Prefixes of the names of files that only trace ports need.
const TRACED: [&str; 3] = ["packet_step_", "triangle_test_", "ray_transform_"];
const MACROS: (&str, &str) = ("bench.vh", include_str!("../../sim/bench.vh"));

/// A bench: its files, with names relative to the folder of the machine.
pub struct Bench {
    /// The name of its top module.
    pub top: String,
    /// The Verilog files to compile.
    pub sources: Vec<(String, String)>,
    /// The Verilog files to include.
    pub headers: Vec<(String, String)>,
    /// The files that the bench reads at run time, by names without a folder.
    pub data: Vec<(String, String)>,
    /// Number of rays cast.
    rays: u64,
}

impl Bench {
    /// Casts the rays in the golden model and writes the vectors of the ray casting unit.
    ///
    /// # Errors
    /// If temporary files cannot be written. No configuration is known to cause an error.
    pub fn new(machine: &Machine) -> Result<Bench> {
        let (folder, summary) =
            vectors_of(machine).with_context(|| format!("vectors of {SCENE}"))?;
        let read = |name: &str| {
            let path = folder.path().join(name);
            fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
        };
        let header = read(HEADER)?;
        // The bench determines which files it loads: those for trace ports only for a machine that has them, and no ray
        // transformations for an image of one level.
        let loaded = SOURCES[0].1.split("`LOAD(\"").skip(1);
        let loaded: Vec<&str> = loaded
            .filter_map(|rest| rest.split('"').next())
            .filter(|name| folder.path().join(name).exists())
            .filter(|name| machine.trace || !TRACED.iter().any(|files| name.starts_with(files)))
            .collect();
        let mut data = vec![];
        for name in &loaded {
            let lines = lines_used(name, &summary).unwrap_or(usize::MAX);
            let text = read(name)?;
            let kept = text.split_inclusive('\n').take(lines).collect();
            data.push((name.to_string(), kept));
        }
        let mut header = header_of(&header, &loaded, &summary);
        if machine.trace {
            header += "\n// The machine has trace ports\n`define DYNRT_TRACE\n";
        }
        let design = &machine.design;
        let prefix = design.prefix().as_str();
        let renamed = |text: &str| text.replace(crate::hw::core::PREFIX, prefix);
        let place = |name: &str| format!("{FOLDER}/{name}");
        let sources = SOURCES.iter().map(|(name, text)| {
            let file = format!("{}.v", design.emitted(name));
            (place(&file), renamed(text))
        });
        Ok(Bench {
            top: design.emitted(SOURCES[0].0),
            sources: sources.collect(),
            headers: vec![
                (place(HEADER), header),
                (place(MACROS.0), MACROS.1.to_string()),
            ],
            data: data
                .into_iter()
                .map(|(name, text)| (place(&name), text))
                .collect(),
            rays: summary.rays,
        })
    }

    /// All files of the bench.
    pub fn files(&self) -> impl Iterator<Item = &(String, String)> {
        self.sources.iter().chain(&self.headers).chain(&self.data)
    }

    /// The entry of the bench in the machine's manifest.
    pub fn describe(&self) -> Value {
        let files: Vec<&str> = self.files().map(|(name, _)| name.as_str()).collect();
        json!({"top": self.top, "scene": SCENE, "rays": self.rays, "files": files})
    }
}

/// Writes the vectors of all units of a machine to a temporary folder.
fn vectors_of(machine: &Machine) -> Result<(temporary::Folder, Summary)> {
    let config = &machine.config;
    let scene = scene::load(SCENE)?;
    let mesh = MachineMesh::new(&scene, config.format())?;
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    let tree = build(&mesh.vertices, &mesh.triangles, &options)?;
    let image = MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree)?;
    let frame = Frame::new(
        ImageSize::new(PICTURE.0, PICTURE.1)?,
        config.rays_per_packet as usize,
    )?;
    let camera = Camera::framing(scene.bounds());
    let packets = frame.primary_rays(&camera, &mesh)?;
    let folder = temporary::Folder::new().context("cannot create a temporary folder")?;
    let summary = vectors::write(&vectors::Request {
        config,
        scene_name: &scene.name,
        image: &image,
        skins: &[],
        packets: &packets,
        limit: None,
        directed_scenes: false,
        force: false,
        made: Made {
            command: "dynrt generate",
            frame,
            camera,
            log2_scale: mesh.log2_scale,
            motion: None,
        },
        out: folder.path(),
    })?;
    Ok((folder, summary))
}

/// The number of lines of a file that the packets use. The remaining lines are only for the benches of single units.
fn lines_used(file: &str, summary: &Summary) -> Option<usize> {
    let lines = match file {
        _ if file.starts_with("packet_step_") => summary.steps,
        _ if file.starts_with("triangle_test_") => summary.tests,
        _ => return None,
    };
    usize::try_from(lines).ok()
}

/// The part of the header for the loaded files, with their reduced numbers of lines.
fn header_of(header: &str, loaded: &[&str], summary: &Summary) -> String {
    let is_of_another = |section: &&str| {
        let title = section.lines().next().unwrap_or_default();
        let file = title.trim_start_matches("// ");
        file.ends_with(".hex") && !loaded.contains(&file)
    };
    let mut text = String::new();
    for section in header
        .split("\n\n")
        .filter(|section| !is_of_another(section))
    {
        let file = section.lines().next().unwrap_or_default();
        let used = lines_used(file.trim_start_matches("// "), summary);
        if !text.is_empty() {
            text.push('\n');
        }
        for line in section.lines() {
            let _ = match (line.rsplit_once(' '), used) {
                (Some((define, _)), Some(lines)) if define.ends_with("_LINES") => {
                    writeln!(text, "{define} {lines}")
                }
                _ => writeln!(text, "{line}"),
            };
        }
    }
    text
}
