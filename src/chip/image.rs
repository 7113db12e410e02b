//! Images of the chip's memory: the arrays of a scene, rays, command lists, and room for hits.

use super::descriptor::{self, Cast, Command, Scene};
use super::memory::Memory;
use super::{most_rays, ray};
use crate::bkd::bytes::{BASE_ALIGNMENT, ByteRecord};
use crate::bkd::layout::{MemoryImage, vector_words};
use crate::config::Config;
use crate::port::{Hit, NONE, Ray};
use anyhow::{Result, ensure};
use serde::Serialize;

/// Bytes of the longest burst: the chip reads whole lines.
const LONGEST_BURST: usize = 128;

/// A named range of the memory.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Part {
    pub name: String,
    pub address: u32,
    pub bytes: u64,
}

/// Fills a memory from a base address up. Each part begins at a multiple of [`BASE_ALIGNMENT`].
pub struct Builder {
    base: u32,
    most: u64,
    bytes: Vec<u8>,
    pub parts: Vec<Part>,
}

impl Builder {
    /// A memory that begins at `base`, a multiple of [`BASE_ALIGNMENT`], and has at most `most` bytes.
    pub fn new(base: u32, most: u64) -> Builder {
        assert!(base.is_multiple_of(BASE_ALIGNMENT), "an aligned base");
        Builder {
            base,
            most: most.min((1 << 32) - u64::from(base)),
            bytes: vec![],
            parts: vec![],
        }
    }

    /// Places bytes; returns their address.
    ///
    /// # Errors
    /// The memory is too small.
    pub fn place(&mut self, name: impl Into<String>, bytes: &[u8]) -> Result<u32> {
        let address = self.reserve(name, bytes.len() as u64)?;
        let first = (address - self.base) as usize;
        self.bytes[first..first + bytes.len()].copy_from_slice(bytes);
        Ok(address)
    }

    /// Reserves zeros; returns their address.
    ///
    /// # Errors
    /// The memory is too small.
    pub fn reserve(&mut self, name: impl Into<String>, bytes: u64) -> Result<u32> {
        let name = name.into();
        let end = self.bytes.len() as u64 + bytes.next_multiple_of(BASE_ALIGNMENT.into());
        ensure!(
            end <= self.most,
            "{name} does not fit: the image needs at least {end} bytes, but the memory has {}; give it more, or a smaller scene",
            self.most
        );
        let address = self.base + self.bytes.len() as u32;
        self.bytes.resize(end as usize, 0);
        self.parts.push(Part {
            name,
            address,
            bytes,
        });
        Ok(address)
    }

    /// The memory, filled up to a multiple of the longest burst.
    pub fn finish(mut self) -> (Memory, Vec<Part>) {
        self.bytes
            .resize(self.bytes.len().next_multiple_of(LONGEST_BURST), 0);
        (Memory::new(self.base, self.bytes), self.parts)
    }

    /// Places the arrays of a scene.
    ///
    /// # Errors
    /// The memory is too small.
    pub fn scene(&mut self, image: &MemoryImage) -> Result<Scene> {
        let format = image.format;
        let (lo, hi) = image.bounds;
        let bounds = vector_words(format, &[lo, hi]);
        let vertex = ByteRecord::vertex(format);
        let nodes = ByteRecord::node(format).array(&image.node_words());
        let records = ByteRecord::triangle(format).array(&image.record_words());
        Ok(Scene {
            root: image.root.pack(),
            nodes: self.place("nodes", &nodes)?,
            records: self.place("triangle records", &records)?,
            vertices: self.place("vertices", &vertex.array(&image.vertex_words()))?,
            bounds: self.place("box of the scene", &vertex.array(&bounds))?,
        })
    }

    /// Places rays and room for their hits; returns the casts, each of as many rays as the machine allows. Active rays must all be
    /// any-hit rays, or none; inactive ones are alike in memory. Rays of one origin and tmin become short rays.
    ///
    /// # Errors
    /// The memory is too small; rays of both kinds.
    pub fn casts(&mut self, config: &Config, rays: &[Ray]) -> Result<Vec<Cast>> {
        if rays.is_empty() {
            return Ok(vec![]);
        }
        let mut active = rays.iter().filter(|ray| ray.active);
        let any_hit = active.next().is_some_and(|ray| ray.any_hit);
        ensure!(
            active.all(|ray| ray.any_hit == any_hit),
            "rays of one cast are all any-hit rays, or none is"
        );
        let short = ray::shared_origin(rays);
        let skipped = match short {
            None => 0,
            Some(_) => ray::BYTES - ray::SHORT_BYTES,
        };
        let bytes: Vec<u8> = (rays.iter())
            .flat_map(|ray| ray::to_bytes(&ray::numbers(ray)).into_iter().skip(skipped))
            .collect();
        let ray_bytes = bytes.len() as u64 / rays.len() as u64;
        let record = u64::from(ByteRecord::hit(config.format()).bytes);
        let bytes_of = |count: u64| match any_hit {
            true => 4 * count.div_ceil(32),
            false => count * record,
        };
        let rays_at = self.place("rays", &bytes)?;
        let count = rays.len() as u64;
        let most = u64::from(most_rays(config));
        // The hits of each cast begin at an aligned address.
        let step = bytes_of(most).next_multiple_of(BASE_ALIGNMENT.into());
        let last = (count - 1) / most;
        let hits_at = self.reserve("hits", last * step + bytes_of(count - last * most))?;
        let casts = (0..=last).map(|number| Cast {
            rays: rays_at + (number * most * ray_bytes) as u32,
            count: most.min(count - number * most) as u32,
            hits: hits_at + (number * step) as u32,
            any_hit,
            short,
        });
        Ok(casts.collect())
    }

    /// Places a command list.
    ///
    /// # Errors
    /// The memory is too small.
    pub fn list(&mut self, name: impl Into<String>, commands: &[Command]) -> Result<u32> {
        let words = commands.iter().flat_map(Command::encode);
        let bytes: Vec<u8> = words.flat_map(u32::to_le_bytes).collect();
        debug_assert!(bytes.len().is_multiple_of(descriptor::BYTES as usize));
        self.place(name, &bytes)
    }
}

/// A memory with which the chip casts rays: scene, rays, command list.
pub struct Still {
    pub memory: Memory,
    pub parts: Vec<Part>,
    /// The address of the command list.
    pub list: u32,
    pub casts: Vec<Cast>,
    /// Where the hits are after the list.
    pub hits: Part,
}

/// Fills a memory for a list that casts rays in a scene.
///
/// # Errors
/// The memory is too small; no rays, or rays of both kinds.
pub fn still(
    config: &Config,
    mut memory: Builder,
    image: &MemoryImage,
    rays: &[Ray],
) -> Result<Still> {
    ensure!(!rays.is_empty(), "there are no rays to cast");
    let scene = memory.scene(image)?;
    let casts = memory.casts(config, rays)?;
    let hits = memory.parts.last().cloned();
    let commands: Vec<Command> = std::iter::once(Command::Scene(scene))
        .chain(casts.iter().map(|cast| Command::Cast(*cast)))
        .chain([Command::End])
        .collect();
    let list = memory.list("command list", &commands)?;
    let (memory, parts) = memory.finish();
    Ok(Still {
        memory,
        parts,
        list,
        casts,
        hits: hits.expect("the hits are the last part behind casts"),
    })
}

/// The hits of a cast in memory. The answer to an any-hit ray with a hit is a hit at distance 0.
///
/// # Panics
/// If the hits are not in the memory.
pub fn hits_of(memory: &Memory, config: &Config, cast: &Cast) -> Vec<Hit> {
    let format = config.format();
    let base = u64::from(cast.hits);
    let within = "hits are in the memory";
    if cast.any_hit {
        let answer = |ray: u64| {
            let word = memory.word(base + 4 * (ray / 32)).expect(within);
            match word >> (ray % 32) & 1 {
                0 => Hit::MISS,
                _ => Hit::any(0.0),
            }
        };
        return (0..u64::from(cast.count)).map(answer).collect();
    }
    let layout = ByteRecord::hit(format);
    let bytes = u64::from(layout.bytes);
    let hit = |ray: u64| {
        let place = memory.read(base + ray * bytes, layout.bytes as usize);
        let words = layout.read(place.expect(within));
        let number = |name| format.to_f64(layout.record.get(&words, name));
        let triangle = layout.record.get(&words, "triangle") as u32;
        let instance = layout.record.get(&words, "instance") as u32;
        Hit {
            t: number("t"),
            u: number("u"),
            v: number("v"),
            instance: if triangle == NONE { NONE } else { instance },
            triangle,
        }
    };
    (0..u64::from(cast.count)).map(hit).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bkd::{BuildOptions, build};
    use crate::chip::Limits;
    use crate::golden::Caster;
    use crate::golden::chip::{Chip, words_of_hit};
    use crate::scene::{self, Camera, Frame, MachineMesh};

    /// Casts of any-hit rays that are as short as the shortest tags allow begin at addresses that the chip accepts.
    #[test]
    fn many_short_casts_are_accepted() {
        let ray = Ray {
            direction: [1.0, 0.0, 0.0],
            tmax: 1.0,
            active: true,
            any_hit: true,
            ..Ray::INACTIVE
        };
        for (rays_per_packet, any_hit) in [(1, true), (1, false), (2, true), (8, true)] {
            let config = Config {
                tag_bits: 7,
                rays_per_packet,
                ..Config::reference()
            };
            let mut builder = Builder::new(0, 1 << 20);
            let casts = builder
                .casts(&config, &vec![Ray { any_hit, ..ray }; 1500])
                .unwrap();
            assert_eq!(
                casts.len(),
                1500_usize.div_ceil(128 * rays_per_packet as usize)
            );
            let counts: u32 = casts.iter().map(|cast| cast.count).sum();
            assert_eq!(counts, 1500);
            for cast in casts {
                let words = Command::Cast(cast).encode();
                assert!(
                    Command::decode(&words, &Limits::of(&config)).is_ok(),
                    "{cast:?}"
                );
            }
        }
    }

    /// The command list's hits in memory are the golden caster's, for both kinds of rays.
    #[test]
    fn a_list_casts_what_the_caster_casts() {
        let config = Config::reference();
        let scene = scene::load("builtin:cornell").unwrap();
        let mesh = MachineMesh::new(&scene, config.format()).unwrap();
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
        let image = MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree).unwrap();
        let picture =
            Frame::new("37x23".parse().unwrap(), config.rays_per_packet as usize).unwrap();
        let packets = picture
            .primary_rays(&Camera::framing(scene.bounds()), &mesh)
            .unwrap();
        let rays: Vec<Ray> = packets.iter().flat_map(|p| p.rays.clone()).collect();
        let expected = Caster::new(
            &image,
            config.triangle_test,
            config.rays_per_packet as usize,
        )
        .cast_packets(&rays)
        .hits;
        assert!(expected.iter().any(|hit| hit.is_hit()));
        for any_hit in [false, true] {
            // Inactive rays, the first among them, are of either kind.
            let mut rays: Vec<Ray> = rays.iter().map(|ray| Ray { any_hit, ..*ray }).collect();
            let mut expected = expected.clone();
            for place in (0..rays.len()).step_by(7) {
                rays[place] = Ray::INACTIVE;
                expected[place] = Hit::MISS;
            }
            let mut builder = Builder::new(0x1000, 1 << 24);
            let scene = builder.scene(&image).unwrap();
            let casts = builder.casts(&config, &rays).unwrap();
            let done = builder.reserve("done", 4).unwrap();
            let mut commands = vec![Command::Scene(scene)];
            commands.extend(casts.iter().map(|cast| Command::Cast(*cast)));
            let value = 7;
            let signal = Command::Signal {
                address: done,
                value,
                interrupt: true,
            };
            commands.extend([Command::Fence, signal, Command::End]);
            let list = builder.list("list", &commands).unwrap();
            let (mut memory, _) = builder.finish();
            let outcome = Chip::new(&config).run(&mut memory, list, 100);
            assert_eq!(outcome.error, None);
            assert_eq!(outcome.rays, rays.len() as u64);
            assert_eq!(memory.word(done.into()), Some(value));
            let record = ByteRecord::hit(config.format());
            let hits_at = u64::from(casts[0].hits);
            for (place, hit) in (0u64..).zip(&expected) {
                if any_hit {
                    let word = memory.word(hits_at + 4 * (place / 32)).unwrap();
                    assert_eq!(word >> (place % 32) & 1 == 1, hit.is_hit(), "ray {place}");
                } else {
                    let bytes = memory.read(hits_at + 16 * place, 16).unwrap();
                    let expected = words_of_hit(&record, config.format(), hit);
                    assert_eq!(record.read(bytes), expected, "ray {place}");
                }
            }
        }
    }
}
