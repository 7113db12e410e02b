//! The bench that is generated beside a machine: the ray casting unit's of `sim/`, with a small set of golden vectors, so that the
//! machine can be simulated where nothing else of this program is.

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

/// The folder of the bench's files, within that of the machine.
pub const FOLDER: &str = "sim";

/// What it casts: primary rays of a picture of a built-in scene, and the variants of them that vectors always have.
const SCENE: &str = "builtin:cornell";
const PICTURE: (u32, u32) = (8, 8);

/// The bench and what surrounds the unit in it, in which modules have their names of the default prefix.
const SOURCES: [(&str, &str); 2] = [
    ("raycast_tb", include_str!("../../sim/raycast_tb.v")),
    ("memory", include_str!("../../sim/memory.v")),
];
/// What the names begin with of files of what trace ports show.
const TRACED: [&str; 3] = ["packet_step_", "triangle_test_", "ray_transform_"];
const MACROS: (&str, &str) = ("bench.vh", include_str!("../../sim/bench.vh"));

/// A bench: its files by their names within the folder of the machine.
pub struct Bench {
    /// Its module, as it is emitted.
    pub top: String,
    /// Verilog to compile.
    pub sources: Vec<(String, String)>,
    /// What the Verilog includes.
    pub headers: Vec<(String, String)>,
    /// What the bench reads where it runs, by names without a folder.
    pub data: Vec<(String, String)>,
    /// Rays that are cast.
    rays: u64,
}

impl Bench {
    /// Casts the rays in the golden model and writes the vectors of the ray casting unit.
    ///
    /// # Errors
    /// There is no room for temporary files; none that a configuration makes is known.
    pub fn new(machine: &Machine) -> Result<Bench> {
        let (folder, summary) =
            vectors_of(machine).with_context(|| format!("vectors of {SCENE}"))?;
        let read = |name: &str| {
            let path = folder.path().join(name);
            fs::read_to_string(&path).with_context(|| format!("cannot read {}", path.display()))
        };
        let header = read(HEADER)?;
        // The bench says itself what it loads: what trace ports show only of a machine that has them; of an image of one level no ray
        // transformations.
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

    /// All its files.
    pub fn files(&self) -> impl Iterator<Item = &(String, String)> {
        self.sources.iter().chain(&self.headers).chain(&self.data)
    }

    /// What the manifest of the machine says of it.
    pub fn describe(&self) -> Value {
        let files: Vec<&str> = self.files().map(|(name, _)| name.as_str()).collect();
        json!({"top": self.top, "scene": SCENE, "rays": self.rays, "files": files})
    }
}

/// The vectors of all units of a machine in a temporary folder.
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

/// How many lines of a file the packets need. Those that follow are for the benches of units alone.
fn lines_used(file: &str, summary: &Summary) -> Option<usize> {
    let lines = match file {
        _ if file.starts_with("packet_step_") => summary.steps,
        _ if file.starts_with("triangle_test_") => summary.tests,
        _ => return None,
    };
    usize::try_from(lines).ok()
}

/// The part of the header that is of the files that are loaded, with the lines that are left of them.
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
