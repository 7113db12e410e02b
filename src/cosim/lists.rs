//! Random command lists: stimulus for the whole chip.

use super::unit_update;
use crate::bkd::bytes::ByteRecord;
use crate::bkd::layout::{Influence, MemoryImage, influence_words, vector_words};
use crate::bkd::{BuildOptions, build};
use crate::chip::descriptor::{Cast, Command, Scene, Skin, Update};
use crate::chip::image::Builder;
use crate::chip::memory::Memory;
use crate::config::Config;
use crate::float::Arithmetic;
use crate::port::Ray;
use crate::program::Program;
use anyhow::Result;

/// Words of scratch memory, which signals write.
const SCRATCH: u32 = 64;

/// Rays of a random cast at most.
const MOST_RAYS: u32 = 200;

/// Vertices and joints of the random mesh at most; the shortest indices hold all of its vectors.
const MOST_VERTICES: usize = 60;
const MOST_JOINTS: usize = 8;

/// Where the image begins in the address space.
const BASE: u32 = 0x1000;

/// The most bytes of an image.
const MOST_BYTES: u64 = 1 << 28;

/// A memory with a scene, rays, room for their hits, a mesh that moves, and command lists.
pub struct Lists {
    pub memory: Builder,
    pub scene: Scene,
    /// Casts of all rays: of closest hits, and of any hit.
    pub casts: Vec<Cast>,
    /// The address of the scratch memory.
    pub scratch: u32,
    moving: Moving,
    starts: Vec<u32>,
}

/// A mesh that is skinned and updated, as a scene of its own.
#[derive(Clone, Copy)]
struct Moving {
    skin: Skin,
    update: Update,
    scene: Scene,
}

impl Lists {
    /// Places a scene and rays. All rays are cast for closest hits and for any hit, whatever they ask for.
    ///
    /// # Errors
    /// No memory is large enough.
    pub fn new(
        config: &Config,
        image: &MemoryImage,
        rays: &[Ray],
        rng: &mut fastrand::Rng,
    ) -> Result<Lists> {
        let mut memory = Builder::new(BASE, MOST_BYTES);
        let scene = memory.scene(image)?;
        let mut casts = vec![];
        for any_hit in [false, true] {
            let rays: Vec<Ray> = rays.iter().map(|ray| Ray { any_hit, ..*ray }).collect();
            casts.extend(memory.casts(config, &rays)?.first());
        }
        let scratch = memory.reserve("scratch", 4 * u64::from(SCRATCH))?;
        Ok(Lists {
            moving: moving(config, &mut memory, image, rng)?,
            memory,
            scene,
            casts,
            scratch,
            starts: vec![],
        })
    }

    /// Adds a random list: casts of parts of the rays, of both kinds and both sizes, signals, waits, fences, and updates that overlap
    /// casts of another scene; now and then the mesh is skinned, updated and cast. Its end is elsewhere in memory, behind a jump.
    ///
    /// # Errors
    /// No memory is large enough.
    pub fn add(&mut self, rng: &mut fastrand::Rng) -> Result<()> {
        let mut commands = vec![Command::Scene(self.scene)];
        for _ in 0..rng.u32(1..8) {
            self.extend(&mut commands, rng);
        }
        let mut tail = vec![];
        self.extend(&mut tail, rng);
        tail.push(Command::End);
        let to = self.memory.list("end of a list", &tail)?;
        commands.push(Command::Jump { to });
        let start = self.memory.list("list", &commands)?;
        self.starts.push(start);
        Ok(())
    }

    /// Adds a command without an error, or commands that belong together.
    fn extend(&self, commands: &mut Vec<Command>, rng: &mut fastrand::Rng) {
        match rng.u8(..8) {
            0 => commands.push(Command::Fence),
            1 => commands.push(self.signal(rng)),
            2 => {
                let signal = self.signal(rng);
                commands.push(signal);
                if let Command::Signal { address, value, .. } = signal {
                    let value = rng.u32(..=value);
                    commands.push(Command::Wait { address, value });
                }
            }
            // No ray reaches the object while it is updated.
            3 => commands.push(Command::Update(self.moving.update)),
            4 => commands.extend([
                Command::Fence,
                Command::Skin(self.moving.skin),
                Command::Fence,
                Command::Update(self.moving.update),
                Command::Fence,
                Command::Scene(self.moving.scene),
                self.cast(rng),
                self.cast(rng),
                Command::Fence,
                Command::Scene(self.scene),
            ]),
            _ => commands.push(self.cast(rng)),
        }
    }

    fn signal(&self, rng: &mut fastrand::Rng) -> Command {
        Command::Signal {
            address: self.scratch + 4 * rng.u32(..SCRATCH),
            value: rng.u32(..),
            interrupt: rng.bool(),
        }
    }

    fn cast(&self, rng: &mut fastrand::Rng) -> Command {
        let all = self.casts[rng.usize(..self.casts.len())];
        let count = rng.u32(1..=all.count.min(MOST_RAYS));
        let first = rng.u32(..=all.count - count);
        // A short ray has the origin of one ray, and any numbers as direction.
        let short = rng.bool().then_some(([0.25, 0.5, -20.0], 0.0));
        Command::Cast(Cast {
            rays: all.rays + 32 * first,
            count,
            short,
            ..all
        })
    }

    /// The memory, and the addresses of the random lists.
    pub fn finish(self) -> (Memory, Vec<u32>) {
        (self.memory.finish().0, self.starts)
    }
}

/// Places a random mesh within the box of a scene, with its tree, its program, its influences and a random palette.
fn moving(
    config: &Config,
    memory: &mut Builder,
    image: &MemoryImage,
    rng: &mut fastrand::Rng,
) -> Result<Moving> {
    let format = config.format();
    let arithmetic = Arithmetic::new(format);
    let (lo, hi) = image.bounds;
    let count = rng.usize(3..=MOST_VERTICES);
    let mut point = || {
        std::array::from_fn(|k| {
            let x = lo[k] + (hi[k] - lo[k]) * rng.f64();
            arithmetic.round(if x.is_finite() { x } else { 0.0 }) + 0.0
        })
    };
    let rest: Vec<[f64; 3]> = (0..count).map(|_| point()).collect();
    let triangles: Vec<[u32; 3]> = (0..rng.usize(1..=count))
        .map(|_| std::array::from_fn(|_| rng.u32(..count as u32)))
        .collect();
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    let tree = build(&rest, &triangles, &options)?;
    let program = Program::compile(&tree, &triangles, count, unit_update::machine(config)?)?;
    let mesh = program.image(format, &rest, &triangles, &tree)?;

    let joints = rng.usize(1..=MOST_JOINTS);
    let palette: Vec<[f64; 3]> = (0..4 * joints)
        .map(|column| {
            std::array::from_fn(|row| {
                let identity = if column % 4 == row { 1.0 } else { 0.0 };
                arithmetic.round(identity + rng.f64() / 4.0 - 0.125)
            })
        })
        .collect();
    let mut influences = vec![];
    for _ in 0..count {
        let last = rng.usize(..4);
        influences.extend((0..=last).map(|k| Influence {
            joint: rng.u8(..joints as u8),
            weight: arithmetic.round(rng.f64() / (last + 1) as f64),
            last: k == last,
        }));
    }
    let rows = influence_words(format, &influences);
    let row = ByteRecord::influence_row(format);
    let row_count = rows.len() / row.record.words();
    // The vertices that are written begin at an aligned address.
    let vertex = ByteRecord::vertex(format);
    let target = (4 * joints + count).next_multiple_of((64 / vertex.bytes) as usize);
    let mut vectors = palette;
    vectors.extend(program.reorder_vertices(&rest));
    vectors.resize(target, [0.0; 3]);
    vectors.extend(&mesh.vertices);
    let vectors = vertex.array(&vector_words(format, &vectors));
    let vertices = memory.place("vectors of a mesh", &vectors)?;
    let influences = memory.place("influences", &row.array(&rows))?;
    let code = program.bytes();
    let scene = Scene {
        vertices: vertices + target as u32 * vertex.bytes,
        ..memory.scene(&mesh)?
    };
    Ok(Moving {
        skin: Skin {
            vertices,
            palette: 0,
            joints: joints as u32,
            influences,
            rows: row_count as u32,
            rest: 4 * joints as u32,
            count: count as u32,
            target: target as u32,
        },
        update: Update {
            program: memory.place("program", &code)?,
            rows: (code.len() / Program::ROW_BYTES) as u32,
            vertices: scene.vertices,
            first_vertex: 0,
            nodes: scene.nodes,
            first_node: 0,
            bounds: scene.bounds,
        },
        scene,
    })
}
