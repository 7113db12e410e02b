//! `manifest.json`: the list of the files, the layouts of their lines, the ports to which fields belong, and how the folder was made.

use super::header;
use super::layout::Layout;
use super::ports::{Layouts, Map as PortMap};
use super::scenes::DirectedScene;
use super::shape::Shape;
use super::sheet::{Part, Sheet};
use super::{GIVEN, HEADER, Request, VERSION, VERSION_KEY};
use crate::bkd::layout::{MemoryImage, Record};
use crate::config::{Config, TriangleTest};
use crate::emit::parameters;
use crate::hdl::Design;
use crate::program::UpdateMachine;
use anyhow::Result;
use serde::Serialize;
use serde_json::{Map, Value, json};

/// The manifest's entry of a file.
#[derive(Serialize)]
pub struct FileEntry {
    pub file: String,
    pub unit: &'static str,
    pub role: &'static str,
    pub lines: u64,
    /// The name of a layout.
    pub layout: Option<String>,
    pub parts: Vec<Part>,
    pub sha256: String,
}

/// The completed files and their layouts.
#[derive(Default)]
pub struct Files {
    pub entries: Vec<FileEntry>,
    pub layouts: Layouts,
    /// The names of the layouts, in the order of the files.
    order: Vec<String>,
}

impl Files {
    /// Completes a file and lists it. A care file has the layout of its unit's expected results.
    ///
    /// # Errors
    /// One line that names a file that cannot be written.
    pub fn list(
        &mut self,
        sheet: &mut Sheet,
        unit: &'static str,
        role: &'static str,
    ) -> Result<()> {
        let sha256 = sheet.finish()?;
        let stem = sheet.file.trim_end_matches(".hex");
        let layout = match role {
            "care" => format!("{unit}_expected"),
            _ => stem.to_string(),
        };
        if role != "care" {
            self.add_layout(&layout, sheet.layout.clone());
        }
        self.entries.push(FileEntry {
            file: sheet.file.clone(),
            unit,
            role,
            lines: sheet.lines,
            layout: Some(layout),
            parts: sheet.parts.clone(),
            sha256,
        });
        Ok(())
    }

    fn add_layout(&mut self, name: &str, layout: Layout) {
        self.layouts.insert(name.to_string(), layout);
        self.order.push(name.to_string());
    }

    /// The layout of a listed file.
    pub fn layout_of(&self, entry: &FileEntry) -> Option<&Layout> {
        self.layouts.get(entry.layout.as_deref()?)
    }

    /// Adds the layouts of records that are parts of other files' lines.
    pub fn add_records(&mut self, shape: &Shape) {
        for record in [Record::link_word(), Record::instance()] {
            let layout = Layout::default().record(&record, shape.format);
            self.add_layout(record.name, layout);
        }
    }

    fn layouts(&self) -> Result<Map<String, Value>> {
        let mut all = Map::new();
        for name in &self.order {
            let layout = &self.layouts[name];
            let mut value = serde_json::to_value(layout)?;
            value["digits"] = json!(layout.digits());
            all.insert(name.clone(), value);
        }
        Ok(all)
    }

    fn lines(&self, file: &str) -> u64 {
        let found = self.entries.iter().find(|entry| entry.file == file);
        found.map_or(0, |entry| entry.lines)
    }
}

/// A unit, the module that implements it, its files, and its memories.
struct Unit {
    name: &'static str,
    module: &'static str,
    stimulus: &'static str,
    expected: &'static str,
    /// The prefix of each memory's ports, and its image.
    memories: &'static [(&'static str, &'static str)],
}

/// The units, in the order of the manifest.
const UNITS: [Unit; 11] = [
    Unit {
        name: "raycast",
        module: "raycast_unit",
        stimulus: "raycast_rays.hex",
        expected: "raycast_hits.hex",
        memories: &[
            ("node", "nodes.hex"),
            ("record", "records.hex"),
            ("vertex", "vertices.hex"),
        ],
    },
    pipeline(
        "ray_setup",
        "ray_setup",
        "ray_setup_stimulus.hex",
        "ray_setup_expected.hex",
    ),
    pipeline(
        "packet_step",
        "tpu_slice",
        "packet_step_stimulus.hex",
        "packet_step_expected.hex",
    ),
    pipeline(
        "triangle_test",
        "triangle_test",
        "triangle_test_stimulus.hex",
        "triangle_test_expected.hex",
    ),
    pipeline(
        "ray_transform",
        "raycast_unit",
        "ray_transform_stimulus.hex",
        "ray_transform_expected.hex",
    ),
    Unit {
        name: "update",
        module: "update_processor",
        stimulus: "update_commands.hex",
        expected: "update_node_writes.hex",
        memories: &[
            ("program", "update_program.hex"),
            ("vertex", "update_vertices.hex"),
        ],
    },
    Unit {
        name: "skinning",
        module: "raycast_unit",
        stimulus: "skinning_commands.hex",
        expected: "skinning_expected.hex",
        memories: &[
            ("vertex", "skinning_vectors.hex"),
            ("influence", "skinning_influences.hex"),
        ],
    },
    pipeline(
        "fp_add",
        "fp_add",
        "fp_add_stimulus.hex",
        "fp_add_expected.hex",
    ),
    pipeline(
        "fp_sub",
        "fp_sub",
        "fp_sub_stimulus.hex",
        "fp_sub_expected.hex",
    ),
    pipeline(
        "fp_mul",
        "fp_mul",
        "fp_mul_stimulus.hex",
        "fp_mul_expected.hex",
    ),
    pipeline(
        "fp_reciprocal",
        "fp_reciprocal",
        "fp_reciprocal_stimulus.hex",
        "fp_reciprocal_expected.hex",
    ),
];

const fn pipeline(
    name: &'static str,
    module: &'static str,
    stimulus: &'static str,
    expected: &'static str,
) -> Unit {
    Unit {
        name,
        module,
        stimulus,
        expected,
        memories: &[],
    }
}

/// The manifest's entries of all units.
fn units(files: &Files, shape: &Shape, design: &Design) -> Result<Vec<Value>> {
    let mut list = vec![];
    for unit in UNITS {
        let transactions = files.lines(unit.stimulus);
        if transactions == 0 {
            continue;
        }
        let module = header::module(design, unit.module);
        let copies = match unit.name {
            "packet_step" => shape.rays,
            _ => 1,
        };
        let map = PortMap {
            layouts: &files.layouts,
            unit: unit.name,
            rays: shape.rays,
        };
        let ports = match unit.name {
            "ray_transform" => vec![],
            _ => map.of(module, copies)?,
        };
        let own = || files.entries.iter().filter(|entry| entry.unit == unit.name);
        let care = own().find(|entry| entry.role == "care");
        let main = |file: &str| file == unit.stimulus || file == unit.expected;
        let others: Vec<&String> = own()
            .filter(|entry| entry.role != "care" && !main(&entry.file))
            .map(|entry| &entry.file)
            .collect();
        let memory = |&(ports, image): &(&str, &str)| {
            let bits = |port: &str| {
                module
                    .port(&format!("{ports}_{port}"))
                    .map(|port| port.width)
            };
            json!({
                "ports": ports,
                "image": image,
                "address_bits": bits("request_address"),
                "tag_bits": bits("request_tag"),
                "data_bits": bits("response_data"),
            })
        };
        list.push(json!({
            "unit": unit.name,
            "module": design.module_name(module),
            "parameters": parameters(module),
            "copies": copies,
            "transactions": transactions,
            "stimulus": unit.stimulus,
            "expected": unit.expected,
            "care": care.map(|entry| &entry.file),
            "others": others,
            "memories": unit.memories.iter().map(memory).collect::<Vec<_>>(),
            "ports": ports,
        }));
    }
    Ok(list)
}

/// The contents of the manifest in addition to the files.
pub struct Contents<'a> {
    pub request: &'a Request<'a>,
    pub directed: &'a [DirectedScene],
    pub shape: &'a Shape,
    pub design: &'a Design,
    /// The result of [`header::machine`].
    pub machine: &'a Map<String, Value>,
    pub update: UpdateMachine,
    /// Number of packets of the picture that were cast.
    pub of_picture: usize,
    /// Totals by key, in the manifest's order.
    pub totals: Vec<(&'static str, u64)>,
}

impl Contents<'_> {
    /// The whole manifest.
    ///
    /// # Errors
    /// One line that says which part of the machine cannot be described.
    pub fn manifest(&self, files: &Files) -> Result<Value> {
        let Contents { request, shape, .. } = self;
        let Request { config, image, .. } = **request;
        let (triangles, instances) = counts(image)?;
        let mut all = json!({
            VERSION_KEY: VERSION,
            "generator": concat!("dynrt ", env!("CARGO_PKG_VERSION")),
            "made": self.made(),
            "scene": request.scene_name,
            "triangles": triangles,
            "levels": levels(image),
            "instances": instances,
            "scenes": self.scenes()?,
            "picture": self.picture(),
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
            "update_machine": self.update,
        });
        for (key, count) in &self.totals {
            all[*key] = json!(count);
        }
        all["units"] = json!(units(files, shape, self.design)?);
        all["pipelines"] = json!(header::pipelines(self.design));
        all["machine"] = json!(self.machine);
        all["files"] = serde_json::to_value(&files.entries)?;
        all["layouts"] = json!(files.layouts()?);
        Ok(all)
    }

    fn made(&self) -> Value {
        let made = self.request.made;
        let (clip, seconds) = match made.motion {
            Some((clip, seconds)) => (clip, Some(seconds)),
            None => (None, None),
        };
        json!({
            "command": made.command,
            "size": [made.frame.size().width, made.frame.size().height],
            "limit": self.request.limit,
            "clip": clip,
            "seconds": seconds,
            "camera": {
                "eye": made.camera.eye,
                "forward": made.camera.forward,
                "right": made.camera.right,
                "up": made.camera.up,
            },
            "log2_scale": made.log2_scale,
        })
    }

    fn picture(&self) -> Value {
        let frame = self.request.made.frame;
        let size = [frame.size().width, frame.size().height];
        let block = frame.block();
        json!({
            "size": size,
            "block": block,
            "blocks": [size[0].div_ceil(block[0]), size[1].div_ceil(block[1])],
            "packets": self.of_picture,
        })
    }

    fn scenes(&self) -> Result<Vec<Value>> {
        let given = [(GIVEN, self.request.image, 0, 0)];
        let directed = self.directed.iter();
        let directed = directed.map(|scene| {
            (
                scene.label,
                &scene.image,
                scene.first_record,
                scene.first_vertex,
            )
        });
        given
            .into_iter()
            .chain(directed)
            .map(|(label, image, first_record, first_vertex)| {
                let (triangles, instances) = counts(image)?;
                Ok(json!({
                    "label": label,
                    "levels": levels(image),
                    "triangles": triangles,
                    "instances": instances,
                    "first_record": first_record,
                    "records": image.records.len(),
                    "first_vertex": first_vertex,
                    "vertices": image.vertices.len(),
                }))
            })
            .collect()
    }
}

fn levels(image: &MemoryImage) -> u32 {
    1 + u32::from(image.is_instanced())
}

/// Number of triangles and instances of a scene.
fn counts(image: &MemoryImage) -> Result<(usize, usize)> {
    let instances = image.instance_records()?.len();
    Ok((image.records.len() - instances, instances))
}

/// The entry of `vectors.vh`.
pub fn header_entry(text: &str) -> FileEntry {
    let lines = text.lines().count() as u64;
    FileEntry {
        file: HEADER.to_string(),
        unit: "sim",
        role: "macros",
        lines,
        layout: None,
        parts: vec![Part {
            first: 0,
            lines,
            label: "macros".to_string(),
        }],
        sha256: super::sheet::sha256(text),
    }
}

/// The configuration's keys and values, by section.
fn settings(config: &Config) -> Result<Value> {
    let table: toml::Table = config.to_toml().parse()?;
    Ok(serde_json::to_value(table)?)
}
