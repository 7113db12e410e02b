//! The chip: executes a command list on a memory of bytes, as `docs/chip.md` says. What it leaves in memory is what the RTL must leave.

use super::Caster;
use super::skinning::{SkinCommand, SkinMemory, skin};
use super::update::{self, NODE_BOUNDS, UpdateCommand, UpdateEvent};
use crate::bkd::bytes::ByteRecord;
use crate::bkd::layout::{
    InstanceRecord, LinkWord, MemoryImage, Node, Target, TriangleRecord, vector_words,
};
use crate::chip::descriptor::{self, Cast, Command, Fault, Scene, Skin, Update};
use crate::chip::memory::Memory;
use crate::chip::{Limits, ray};
use crate::config::Config;
use crate::float::Format;
use crate::port::{Hit, Ray};
use anyhow::{Result, bail};
use std::collections::VecDeque;

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
    /// Vertices skinned, and their influences.
    pub vertices_skinned: u64,
    pub influences: u64,
    /// Nodes written by updates, and their instructions.
    pub nodes_written: u64,
    pub instructions: u64,
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
    /// Words that the host will write: address and value.
    host: VecDeque<(u32, u32)>,
}

impl Chip {
    pub fn new(config: &Config) -> Chip {
        Chip {
            config: config.clone(),
            scene: None,
            host: VecDeque::new(),
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
        match Command::decode(&words, &Limits::of(&self.config))? {
            Command::End => return Ok(Next::End),
            Command::Jump { to } => return Ok(Next::Go(to)),
            Command::Fence => {}
            Command::Signal {
                address,
                value,
                interrupt,
            } => {
                write_bytes(memory, address.into(), &value.to_le_bytes())?;
                outcome.interrupts += u64::from(interrupt);
            }
            Command::Scene(scene) => {
                let image = fetch(memory, self.config.format(), &scene)?;
                let rays = self.config.rays_per_packet as usize;
                let caster = Caster::new(&image, self.config.triangle_test, rays);
                self.scene = Some((scene, caster));
            }
            Command::Cast(cast) => self.cast(memory, &cast, outcome)?,
            Command::Wait { address, value } => {
                let place = u64::from(address);
                while memory.word(place).ok_or(bus(place))? < value {
                    // Only the host can change it.
                    let write = (self.host.pop_front()).unwrap_or_else(|| {
                        panic!("the list waits at {at:#x} for a word that nobody writes")
                    });
                    write_bytes(memory, write.0.into(), &write.1.to_le_bytes())?;
                }
            }
            Command::Skin(command) => self.skin(memory, &command, outcome)?,
            Command::Update(command) => self.update(memory, &command, outcome)?,
        }
        Ok(next)
    }

    /// Words that the host will write while lists run, in this order: each when a list waits and finds that it must wait on.
    pub fn host_writes(&mut self, words: impl IntoIterator<Item = (u32, u32)>) {
        self.host.extend(words);
    }

    fn skin(
        &mut self,
        memory: &mut Memory,
        command: &Skin,
        outcome: &mut Outcome,
    ) -> Result<(), Fault> {
        let format = self.config.format();
        let (vertex, row) = (
            ByteRecord::vertex(format),
            ByteRecord::influence_row(format),
        );
        let vectors =
            |first: u32, count: u32| array(memory, &vertex, command.vertices, first, count);
        let mut words = vectors(command.palette, 4 * command.joints)?;
        words.extend(vectors(command.rest, command.count)?);
        let read = words.len();
        words.resize(read + command.count as usize * vertex.record.words(), 0);
        let influences = array(memory, &row, command.influences, 0, command.rows)?;
        // The vectors that the command reads, then those that it writes.
        let moved = SkinCommand {
            palette: 0,
            joints: command.joints,
            influences: 0,
            rows: command.rows,
            rest: 4 * command.joints,
            vertices: command.count,
            target: 4 * command.joints + command.count,
        };
        let arrays = SkinMemory {
            format,
            influences: &influences,
            vertices: &mut words,
        };
        let skinned = skin(arrays, moved, |_| ())
            .unwrap_or_else(|error| panic!("a mesh that cannot be skinned: {error:#}"));
        outcome.vertices_skinned += skinned.vertices;
        outcome.influences += skinned.influences;
        let address = address_of(&vertex, command.vertices, command.target);
        write_bytes(memory, address, &vertex.array(&words[read..]))
    }

    fn update(
        &mut self,
        memory: &mut Memory,
        command: &Update,
        outcome: &mut Outcome,
    ) -> Result<(), Fault> {
        let format = self.config.format();
        let (vertex, node) = (ByteRecord::vertex(format), ByteRecord::node(format));
        let place = u64::from(command.program);
        let rows = 16 * command.rows as usize;
        let program = memory.read(place, rows).ok_or(bus(place))?.to_vec();
        let bases = UpdateCommand {
            program: command.program,
            vertex_base: command.first_vertex,
            node_base: command.first_node,
            box_index: 0,
        };
        // The memory as it was is read, and written into a list: a program reads no vertex that it writes.
        let vertex_at = |index: u32| {
            let words = array(memory, &vertex, command.vertices, index, 1).ok()?;
            Some(MemoryImage::vertices_of_words(format, &words)[0])
        };
        let mut written: Vec<(u64, Vec<u8>)> = vec![];
        let mut nodes = vec![];
        let event = |event: UpdateEvent| {
            match event {
                UpdateEvent::VertexRead { .. } => (),
                UpdateEvent::NodeWrite { node, bounds } => nodes.push((node, bounds)),
                UpdateEvent::BoxWrite { bounds, .. } => {
                    let numbers = bounds.map(|bits| format.to_f64(bits));
                    let (lo, hi) = numbers.split_at(3);
                    let corners = [lo, hi].map(|x| [x[0], x[1], x[2]]);
                    let words = vector_words(format, &corners);
                    written.push((command.bounds.into(), vertex.array(&words)));
                }
            }
            Ok(())
        };
        let updated = update::run(format, &program, &bases, vertex_at, event)
            .unwrap_or_else(|error| panic!("a program that cannot be run: {error:#}"));
        outcome.instructions += updated.instructions;
        outcome.nodes_written += updated.nodes_written;
        let numbers = &node.parts[..NODE_BOUNDS.len()];
        for (index, bounds) in nodes {
            for (part, bits) in numbers.iter().zip(bounds) {
                let address = address_of(&node, command.nodes, index) + u64::from(part.offset);
                let bytes = &bits.to_le_bytes()[..part.bytes() as usize];
                write_bytes(memory, address, bytes)?;
            }
        }
        for (address, bytes) in written {
            write_bytes(memory, address, &bytes)?;
        }
        Ok(())
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
            write_bytes(memory, address, part)?;
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

fn write_bytes(memory: &mut Memory, address: u64, bytes: &[u8]) -> Result<(), Fault> {
    let place = memory.read_mut(address, bytes.len());
    place.ok_or(bus(address))?.copy_from_slice(bytes);
    Ok(())
}

/// The address of a record of an array.
fn address_of(record: &ByteRecord, base: u32, index: u32) -> u64 {
    u64::from(base) + u64::from(index) * u64::from(record.bytes)
}

/// The words of `count` records of an array, from one of them on.
fn array(
    memory: &Memory,
    record: &ByteRecord,
    base: u32,
    first: u32,
    count: u32,
) -> Result<Vec<u32>, Fault> {
    let address = address_of(record, base, first);
    let bytes = memory.read(address, (count * record.bytes) as usize);
    let bytes = bytes.ok_or(bus(address))?;
    let records = bytes.chunks_exact(record.bytes as usize);
    Ok(records.flat_map(|bytes| record.read(bytes)).collect())
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
        array(self.memory, record, base, index, 1)
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
