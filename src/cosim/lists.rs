//! Random command lists: stimulus for the whole chip.

use crate::bkd::layout::MemoryImage;
use crate::chip::descriptor::{Cast, Command, Scene};
use crate::chip::image::Builder;
use crate::chip::memory::Memory;
use crate::config::Config;
use crate::port::Ray;
use anyhow::Result;

/// Words of scratch memory, which signals write.
const SCRATCH: u32 = 64;

/// Rays of a random cast at most.
const MOST_RAYS: u32 = 200;

/// Where the image begins in the address space.
const BASE: u32 = 0x1000;

/// The most bytes of an image.
const MOST_BYTES: u64 = 1 << 28;

/// A memory with a scene, rays, room for their hits, and command lists.
pub struct Lists {
    pub memory: Builder,
    pub scene: Scene,
    /// Casts of all rays: of closest hits, and of any hit.
    pub casts: Vec<Cast>,
    /// The address of the scratch memory.
    pub scratch: u32,
    starts: Vec<u32>,
}

impl Lists {
    /// Places a scene and rays. All rays are cast for closest hits and for any hit, whatever they ask for.
    ///
    /// # Errors
    /// No memory is large enough.
    pub fn new(config: &Config, image: &MemoryImage, rays: &[Ray]) -> Result<Lists> {
        let mut memory = Builder::new(BASE, MOST_BYTES);
        let scene = memory.scene(image)?;
        let mut casts = vec![];
        for any_hit in [false, true] {
            let rays: Vec<Ray> = rays.iter().map(|ray| Ray { any_hit, ..*ray }).collect();
            casts.extend(memory.casts(config, &rays)?.first());
        }
        let scratch = memory.reserve("scratch", 4 * u64::from(SCRATCH))?;
        Ok(Lists {
            memory,
            scene,
            casts,
            scratch,
            starts: vec![],
        })
    }

    /// Adds a random list: casts of parts of the rays, of both kinds and both sizes, signals and fences; its end is elsewhere in memory,
    /// behind a jump.
    ///
    /// # Errors
    /// No memory is large enough.
    pub fn add(&mut self, rng: &mut fastrand::Rng) -> Result<()> {
        let mut commands = vec![Command::Scene(self.scene)];
        for _ in 0..rng.u32(1..8) {
            commands.push(self.command(rng));
        }
        let tail = [self.command(rng), Command::End];
        let to = self.memory.list("end of a list", &tail)?;
        commands.push(Command::Jump { to });
        let start = self.memory.list("list", &commands)?;
        self.starts.push(start);
        Ok(())
    }

    /// A command without an error.
    fn command(&self, rng: &mut fastrand::Rng) -> Command {
        match rng.u8(..5) {
            0 => Command::Fence,
            1 => Command::Signal {
                address: self.scratch + 4 * rng.u32(..SCRATCH),
                value: rng.u32(..),
                interrupt: rng.bool(),
            },
            _ => {
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
        }
    }

    /// The memory, and the addresses of the random lists.
    pub fn finish(self) -> (Memory, Vec<u32>) {
        (self.memory.finish().0, self.starts)
    }
}
