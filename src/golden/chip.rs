//! The chip: executes a command list on a memory of bytes, as `docs/chip.md` says. What it leaves in memory is what the RTL must leave.

use super::Caster;
use crate::bkd::bytes::ByteRecord;
use crate::bkd::layout::{InstanceRecord, LinkWord, MemoryImage, Node, Target, TriangleRecord};
use crate::chip::descriptor::{self, Cast, Command, Fault, Scene};
use crate::chip::memory::Memory;
use crate::chip::{most_rays, ray};
use crate::config::Config;
use crate::float::Format;
use crate::port::{Hit, Ray};
use anyhow::{Result, bail};

/// Why a list ended early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Error {
    /// Code and wrong value.
    pub fault: Fault,
    /// The address of the descriptor.
    pub descriptor: u32,
}

/// How a list ended.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Outcome {
    /// `None` if it reached its `end`.
    pub error: Option<Error>,
    /// Signals that raised the interrupt.
    pub interrupts: u64,
    /// Rays cast, and those that hit something.
    pub rays: u64,
    pub hits: u64,
}

impl Outcome {
    /// Checks that the list reached its end.
    ///
    /// # Errors
    /// One line with the error's name, the wrong value and the descriptor.
    pub fn check(&self) -> Result<()> {
        let Some(Error { fault, descriptor }) = self.error else {
            return Ok(());
        };
        bail!(
            "the command list ended early: error {}, value {:#x}, descriptor at {descriptor:#x}",
            descriptor::error_name(fault.code),
            fault.value
        )
    }

    /// The name of its error, or `none`.
    pub fn status(&self) -> &'static str {
        let code = self.error.map_or(0, |error| error.fault.code);
        descriptor::error_name(code)
    }
}

/// The golden chip. Its scene stays from list to list.
pub struct Chip {
    config: Config,
    scene: Option<(Scene, Caster)>,
}

impl Chip {
    pub fn new(config: &Config) -> Chip {
        Chip {
            config: config.clone(),
            scene: None,
        }
    }

    /// Executes the list at an address. It ends in an error after `most` descriptors, since a list may jump in a circle.
    pub fn run(&mut self, memory: &mut Memory, list: u32, most: usize) -> Outcome {
        let mut outcome = Outcome::default();
        let mut at = list;
        if !list.is_multiple_of(descriptor::BYTES) {
            outcome.error = Some(Error {
                fault: Fault {
                    code: Fault::ALIGNMENT,
                    value: list,
                },
                descriptor: list,
            });
            return outcome;
        }
        for _ in 0..most {
            match self.execute(memory, at, &mut outcome) {
                Ok(Next::Go(to)) => at = to,
                Ok(Next::End) => return outcome,
                Err(fault) => {
                    outcome.error = Some(Error {
                        fault,
                        descriptor: at,
                    });
                    return outcome;
                }
            }
        }
        panic!("the list at {list:#x} has not ended after {most} descriptors");
    }

    fn execute(
        &mut self,
        memory: &mut Memory,
        at: u32,
        outcome: &mut Outcome,
    ) -> Result<Next, Fault> {
        let mut words = [0; descriptor::WORDS];
        for (place, word) in words.iter_mut().enumerate() {
            let address = u64::from(at) + 4 * place as u64;
            *word = memory.word(address).ok_or(bus(address))?;
        }
        let next = Next::Go(at.wrapping_add(descriptor::BYTES));
        match Command::decode(&words, most_rays(&self.config))? {
            Command::End => return Ok(Next::End),
            Command::Jump { to } => return Ok(Next::Go(to)),
            Command::Fence => {}
            Command::Signal {
                address,
                value,
                interrupt,
            } => {
                write(memory, address.into(), &value.to_le_bytes())?;
                outcome.interrupts += u64::from(interrupt);
            }
            Command::Scene(scene) => {
                let image = fetch(memory, self.config.format(), &scene)?;
                let rays = self.config.rays_per_packet as usize;
                let caster = Caster::new(&image, self.config.triangle_test, rays);
                self.scene = Some((scene, caster));
            }
            Command::Cast(cast) => self.cast(memory, &cast, outcome)?,
        }
        Ok(next)
    }

    fn cast(
        &mut self,
        memory: &mut Memory,
        cast: &Cast,
        outcome: &mut Outcome,
    ) -> Result<(), Fault> {
        let format = self.config.format();
        let Some((_, caster)) = &self.scene else {
            return Err(Fault {
                code: Fault::SCENE,
                value: cast.count,
            });
        };
        let rays = (0..cast.count).map(|number| read_ray(memory, format, cast, number));
        let rays: Vec<Ray> = rays.collect::<Result<_, _>>()?;
        let hits = caster.cast_packets(&rays).hits;
        outcome.rays += rays.len() as u64;
        outcome.hits += hits.iter().filter(|hit| hit.is_hit()).count() as u64;
        let bytes = bytes_of_hits(format, &hits, cast.any_hit);
        let each = match cast.any_hit {
            true => 4,
            false => ByteRecord::hit(format).bytes as usize,
        };
        for (place, part) in bytes.chunks(each).enumerate() {
            let address = u64::from(cast.hits) + (place * each) as u64;
            write(memory, address, part)?;
        }
        Ok(())
    }
}

/// The hits of a cast in memory: a record for each ray, or a bit for each any-hit ray in words of 32.
pub fn bytes_of_hits(format: Format, hits: &[Hit], any_hit: bool) -> Vec<u8> {
    if any_hit {
        let word = |hits: &[Hit]| {
            let bits = (hits.iter().enumerate())
                .fold(0u32, |bits, (k, hit)| bits | u32::from(hit.is_hit()) << k);
            bits.to_le_bytes()
        };
        return hits.chunks(32).flat_map(word).collect();
    }
    let record = ByteRecord::hit(format);
    let words = hits
        .iter()
        .flat_map(|hit| words_of_hit(&record, format, hit));
    record.array(&words.collect::<Vec<_>>())
}

/// What comes after a descriptor.
enum Next {
    Go(u32),
    End,
}

fn bus(address: u64) -> Fault {
    Fault {
        code: Fault::BUS,
        value: address as u32,
    }
}

fn write(memory: &mut Memory, address: u64, bytes: &[u8]) -> Result<(), Fault> {
    let place = memory.read_mut(address, bytes.len());
    place.ok_or(bus(address))?.copy_from_slice(bytes);
    Ok(())
}

/// The words of a hit record.
pub fn words_of_hit(record: &ByteRecord, format: Format, hit: &Hit) -> Vec<u32> {
    let mut words = vec![0; record.record.words()];
    let numbers = [("t", hit.t), ("u", hit.u), ("v", hit.v)];
    for (name, number) in numbers {
        record.record.set(&mut words, name, format.to_bits(number));
    }
    record
        .record
        .set(&mut words, "triangle", hit.triangle.into());
    let instance = hit.instance & 0x00ff_ffff;
    record.record.set(&mut words, "instance", instance.into());
    words
}

fn read_ray(memory: &Memory, format: Format, cast: &Cast, number: u32) -> Result<Ray, Fault> {
    let size = cast.ray_bytes();
    let address = u64::from(cast.rays) + u64::from(number) * size as u64;
    let bytes = memory.read(address, size).ok_or(bus(address))?;
    let stored: Vec<f32> = (bytes.chunks_exact(4))
        .map(|word| f32::from_le_bytes([word[0], word[1], word[2], word[3]]))
        .collect();
    let numbers: ray::Numbers = match cast.short {
        None => std::array::from_fn(|k| stored[k]),
        Some(([x, y, z], tmin)) => [x, y, z, tmin, stored[0], stored[1], stored[2], stored[3]],
    };
    Ok(ray::from_numbers(format, &numbers, cast.any_hit))
}

/// All records that are reachable from a scene's root, in arrays that are as long as the greatest index needs. Records that are not
/// reachable are zero.
struct Fetch<'a> {
    memory: &'a Memory,
    scene: &'a Scene,
    node: ByteRecord,
    triangle: ByteRecord,
    vertex: ByteRecord,
    image: MemoryImage,
    fetched: Vec<bool>,
}

fn fetch(memory: &Memory, format: Format, scene: &Scene) -> Result<MemoryImage, Fault> {
    let mut fetch = Fetch {
        memory,
        scene,
        node: ByteRecord::node(format),
        triangle: ByteRecord::triangle(format),
        vertex: ByteRecord::vertex(format),
        image: MemoryImage {
            format,
            nodes: vec![],
            records: vec![],
            vertices: vec![],
            root: LinkWord::unpack(scene.root),
            bounds: ([0.0; 3], [0.0; 3]),
        },
        fetched: vec![],
    };
    let corner = |index| fetch.vector(scene.bounds, index);
    fetch.image.bounds = (corner(0)?, corner(1)?);
    let root = fetch.image.root;
    let instanced = root.right_leaf;
    let leaves = fetch.tree(root)?;
    let mut vectors = vec![];
    for leaf in leaves {
        let record = fetch.record(leaf)?;
        if !instanced {
            vectors.extend(record.vertices);
            continue;
        }
        let instance = InstanceRecord::from(record);
        let first = instance.vectors;
        vectors.extend(first..first + InstanceRecord::VECTORS as u32);
        for leaf in fetch.tree(instance.root)? {
            vectors.extend(fetch.record(leaf)?.vertices);
        }
    }
    for index in vectors {
        let vector = fetch.vector(scene.vertices, index)?;
        *slot(&mut fetch.image.vertices, index, [0.0; 3]) = vector;
    }
    Ok(fetch.image)
}

fn slot<T: Clone>(array: &mut Vec<T>, index: u32, fill: T) -> &mut T {
    let index = index as usize;
    if array.len() <= index {
        array.resize(index + 1, fill);
    }
    &mut array[index]
}

impl Fetch<'_> {
    fn words(&self, record: &ByteRecord, base: u32, index: u32) -> Result<Vec<u32>, Fault> {
        let address = u64::from(base) + u64::from(index) * u64::from(record.bytes);
        let bytes = self.memory.read(address, record.bytes as usize);
        bytes.map(|bytes| record.read(bytes)).ok_or(bus(address))
    }

    fn vector(&self, base: u32, index: u32) -> Result<[f64; 3], Fault> {
        let words = self.words(&self.vertex, base, index)?;
        Ok(MemoryImage::vertices_of_words(self.image.format, &words)[0])
    }

    fn record(&mut self, index: u32) -> Result<TriangleRecord, Fault> {
        let words = self.words(&self.triangle, self.scene.records, index)?;
        let record = MemoryImage::records_of_words(&words)[0];
        *slot(&mut self.image.records, index, TriangleRecord::default()) = record;
        Ok(record)
    }

    /// Fetches the nodes of a tree that have not been fetched; returns the indices of its leaves' records.
    fn tree(&mut self, root: LinkWord) -> Result<Vec<u32>, Fault> {
        let mut leaves = vec![];
        let mut open = vec![root.root()];
        while let Some(target) = open.pop() {
            let index = match target {
                Target::Record(index) => {
                    leaves.push(index);
                    continue;
                }
                Target::Node(index) => index,
            };
            if std::mem::replace(slot(&mut self.fetched, index, false), true) {
                continue;
            }
            let words = self.words(&self.node, self.scene.nodes, index)?;
            let node = MemoryImage::nodes_of_words(self.image.format, &words)[0];
            *slot(&mut self.image.nodes, index, Node::default()) = node;
            open.extend(node.link.children(index));
        }
        Ok(leaves)
    }
}
