//! A film in one memory, with a command list for each frame.

use super::Film;
use super::plan::{BoxAt, FramePlan, Plan, SkinStep, UpdateStep, plan};
use crate::bkd::Bounds;
use crate::bkd::bytes::{BASE_ALIGNMENT, ByteRecord};
use crate::bkd::layout::{Influence, influence_words, vector_words};
use crate::chip::descriptor::{self, Cast, Command, Scene, Skin, Update};
use crate::chip::image::{Builder, Part};
use crate::chip::memory::Memory;
use crate::config::Config;
use crate::float::Format;
use anyhow::{Result, ensure};

/// A film in memory. The lists of its frames run one after the other, from the first one on; after the last one the first may follow.
pub struct Packed {
    pub memory: Memory,
    pub parts: Vec<Part>,
    /// Numbers of bytes of the part of vertices: what they are, bytes.
    pub vertex_bytes: Vec<(&'static str, u64)>,
    /// The casts, the same in all frames.
    pub casts: Vec<Cast>,
    /// Where the hits are after each list.
    pub hits: Part,
    pub frames: Vec<PackedFrame>,
}

/// A frame of a film in memory.
#[derive(Clone, Debug)]
pub struct PackedFrame {
    /// The address of its command list.
    pub list: u32,
    /// The commands of the list.
    pub commands: Vec<Command>,
    /// The numbers in the scene of the instances, by their numbers in hits.
    pub there: Vec<usize>,
    /// Triangles of the objects that are updated.
    pub triangles: u64,
    /// The trees of the objects that have moved, if a new one is considered.
    pub trees: Vec<super::TreeReport>,
    /// Whether it is the first frame of a top-level tree.
    pub new_top: bool,
}

/// Puts a film into memory. An object's tree is rebuilt if its cost exceeds that of a new tree by more than the factor
/// `rebuild_above`; +∞: never.
///
/// # Errors
/// If the machine cannot hold the scene, if the memory is too small, or if there are no rays.
pub fn pack(
    config: &Config,
    film: Film<'_>,
    rebuild_above: f64,
    mut memory: Builder,
) -> Result<Packed> {
    let rays = film.rays();
    ensure!(!rays.is_empty(), "there are no rays to cast");
    let plan = plan(config, film, rebuild_above)?;
    let vertex = u64::from(ByteRecord::vertex(config.format()).bytes);
    let all = plan.image.vertices.len() as u64;
    let of = plan.vectors;
    let other = all - of.rest - of.palettes - of.instances;
    let vertex_bytes = [
        ("vertices and instances", other),
        ("vertices at rest", of.rest),
        ("palettes", of.palettes),
        ("instances of frames", of.instances),
    ];
    let at = Addresses::place(config.format(), &plan, &mut memory)?;
    let casts = memory.casts(config, &rays)?;
    let hits = memory.parts.last().cloned();
    let mut bytes = vec![];
    let mut frames = vec![];
    for frame in plan.frames {
        let commands = at.commands(&frame, &casts);
        let offset = bytes.len() as u32;
        let words = commands.iter().flat_map(Command::encode);
        bytes.extend(words.flat_map(u32::to_le_bytes));
        frames.push(PackedFrame {
            list: offset,
            commands,
            there: frame.there,
            triangles: frame.triangles,
            trees: frame.trees,
            new_top: frame.new_top,
        });
    }
    debug_assert!(bytes.len().is_multiple_of(descriptor::BYTES as usize));
    let lists = memory.place("command lists", &bytes)?;
    for frame in &mut frames {
        frame.list += lists;
    }
    let (memory, parts) = memory.finish();
    Ok(Packed {
        memory,
        parts,
        vertex_bytes: vertex_bytes
            .map(|(what, count)| (what, count * vertex))
            .to_vec(),
        casts,
        hits: hits.expect("the hits are the last part behind casts"),
        frames,
    })
}

/// The addresses of the parts of a plan.
struct Addresses {
    nodes: u32,
    records: u32,
    vertices: u32,
    programs: u32,
    influences: u32,
    copies: u32,
    boxes: u32,
    box_bytes: u32,
    vertex_bytes: u32,
}

impl Addresses {
    fn place(format: Format, plan: &Plan, memory: &mut Builder) -> Result<Addresses> {
        let image = &plan.image;
        let vertex = ByteRecord::vertex(format);
        let nodes = ByteRecord::node(format).array(&image.node_words());
        let records = ByteRecord::triangle(format).array(&image.record_words());
        let box_bytes = (2 * vertex.bytes).next_multiple_of(BASE_ALIGNMENT);
        let boxes = plan.boxes.iter().flat_map(|bounds| {
            let written = Bounds {
                lo: [0.0; 3],
                hi: [0.0; 3],
            };
            let Bounds { lo, hi } = bounds.unwrap_or(written);
            let mut bytes = vertex.array(&vector_words(format, &[lo, hi]));
            bytes.resize(box_bytes as usize, 0);
            bytes
        });
        let whole = Influence {
            joint: 0,
            weight: 1.0,
            last: true,
        };
        let copies = influence_words(format, &vec![whole; plan.most_copied as usize]);
        let copies = ByteRecord::influence_row(format).array(&copies);
        // A film without motion has neither programs nor influences.
        let mut place = |name, bytes: &[u8]| match bytes.is_empty() {
            true => Ok(0),
            false => memory.place(name, bytes),
        };
        Ok(Addresses {
            nodes: place("nodes", &nodes)?,
            records: place("triangle records", &records)?,
            vertices: place("vertices", &vertex.array(&image.vertex_words()))?,
            programs: place("update programs", &plan.programs)?,
            influences: place("influences", &plan.influences)?,
            copies: place("influences of copies", &copies)?,
            boxes: place("boxes", &boxes.collect::<Vec<u8>>())?,
            box_bytes,
            vertex_bytes: vertex.bytes,
        })
    }

    fn box_at(&self, number: u32) -> u32 {
        self.boxes + number * self.box_bytes
    }

    fn skin(&self, step: &SkinStep) -> Command {
        let base = match step.copies {
            true => self.copies,
            false => self.influences,
        };
        Command::Skin(Skin {
            vertices: self.vertices,
            influences: base + step.command.influences,
            ..step.command
        })
    }

    fn update(&self, step: &UpdateStep) -> Command {
        Command::Update(Update {
            program: self.programs + step.command.program,
            vertices: self.vertices,
            nodes: self.nodes,
            bounds: match step.bounds {
                BoxAt::Box(number) => self.box_at(number),
                BoxAt::Corners(first) => self.vertices + first * self.vertex_bytes,
            },
            ..step.command
        })
    }

    /// The list of a frame.
    fn commands(&self, frame: &FramePlan, casts: &[Cast]) -> Vec<Command> {
        let mut commands = vec![];
        let stages = [
            frame.skins.iter().map(|step| self.skin(step)).collect(),
            frame.updates.iter().map(|step| self.update(step)).collect(),
            frame.top.iter().map(|step| self.update(step)).collect(),
        ];
        for stage in stages {
            let stage: Vec<Command> = stage;
            if !stage.is_empty() {
                commands.extend(stage);
                commands.push(Command::Fence);
            }
        }
        commands.push(Command::Scene(Scene {
            root: frame.root.pack(),
            nodes: self.nodes,
            records: self.records,
            vertices: self.vertices,
            bounds: self.box_at(frame.bounds),
        }));
        commands.extend(casts.iter().map(|cast| Command::Cast(*cast)));
        commands.push(Command::End);
        commands
    }
}
