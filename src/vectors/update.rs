//! Vectors of the update processor: objects with moved vertices, and the bounds that an update must write.
//!
//! All objects are in separate memories, each preceded by filler records, and are updated one after another.

use super::layout::{Kind, Layout};
use super::shape::Shape;
use super::sheet::Sheet;
use crate::bkd::layout::{LINK_BITS, MemoryImage, Record, Target, place, vector_words};
use crate::bkd::{BuildOptions, Child, Tree, TreeNode, build};
use crate::config::Config;
use crate::float::{Arithmetic, Format};
use crate::golden::Instance;
use crate::golden::update::{UpdateCommand, UpdateEvent, UpdateMemory, update};
use crate::hw::Plan;
use crate::hw::update::{NODE_LANES, module};
use crate::program::{Program, UpdateMachine};
use crate::report::folder::Folder;
use anyhow::{Context, Result, anyhow, ensure};
use std::collections::{BTreeSet, HashMap};

use Kind::{Mask, Unsigned};

/// Number of directed objects: small objects whose vertices contain many ties and special values.
const DIRECTED: usize = 20;
/// Maximum number of triangles of a directed object. Its tree fits the minimum number of box registers: 2·log₂ 12 < 8.
const MOST_TRIANGLES: usize = 12;
/// An upper bound for the records of a directed object in any memory, including fillers.
const ROOM: u64 = 40;
/// Maximum motion of a vertex per coordinate, as a fraction of the largest side of its object's box.
const MOTION: f64 = 1.0 / 64.0;

/// The write mask of a node: all lanes except the uppermost one, the link word.
const ALL_NUMBERS: u64 = (1 << (NODE_LANES - 1)) - 1;

/// One object: a tree over triangles, its vertices when its bounds were last written, and its current vertices.
struct Object {
    tree: Tree,
    triangles: Vec<[u32; 3]>,
    before: Vec<[f64; 3]>,
    after: Vec<[f64; 3]>,
    /// Whether the bounds in memory are those of `before`. Otherwise they are NaN, because an update does not read bounds.
    has_bounds: bool,
}

/// The files of the update processor.
pub struct UpdateSheets {
    /// The memory images in the order of the manifest.
    pub images: [Sheet; 4],
    pub commands: Sheet,
    pub writes: Sheet,
    pub after: Sheet,
    pub boxes: Sheet,
    /// Number of instructions of all updates.
    pub instructions: u64,
    /// The parameters for which the programs were compiled.
    pub machine: UpdateMachine,
}

/// Labels of the parts.
const OF_SCENE: &str = "objects of the scene";
const OF_NONE: &str = "directed objects";

impl Shape {
    fn update_program(&self) -> Layout {
        Layout::default()
            .field(
                "low",
                64,
                Unsigned,
                "bytes 0 to 7 of the row, byte 0 least significant",
            )
            .field("high", 64, Unsigned, "bytes 8 to 15 of the row")
    }

    fn update_commands(&self) -> Layout {
        let index =
            |layout: Layout, name: &str, what: &str| layout.field(name, LINK_BITS, Unsigned, what);
        let layout = index(
            Layout::default(),
            "program",
            "index of the program's first row",
        );
        let layout = index(layout, "rows", "number of rows of the program");
        let layout = index(layout, "vertex_base", "index of the object's first vertex");
        let layout = index(layout, "node_base", "index of the object's first node");
        index(
            layout,
            "box_index",
            "index at which the object's box is written",
        )
        .field(
            "first_write",
            32,
            Unsigned,
            "line of the first written node in update_node_writes.hex, counted from 0",
        )
        .field("writes", 32, Unsigned, "number of nodes written")
        .field(
            "instructions",
            32,
            Unsigned,
            "number of instructions executed, including the end instruction",
        )
    }

    fn update_node_writes(&self) -> Layout {
        let mut layout = Layout::default()
            .field("node", LINK_BITS, Unsigned, "index of the node written")
            .field(
                "mask",
                NODE_LANES,
                Mask,
                "lanes written, always 15: the four numbers (bit 0 for left_lo), not the link word",
            );
        for field in &Record::node(self.format).fields[..4] {
            layout = layout.field(field.name, field.width, Kind::Number, field.description);
        }
        layout
    }
}

impl UpdateSheets {
    /// Updates the objects of an image and directed objects.
    ///
    /// # Errors
    /// One line if the update processor has too few registers for an object, or if a file cannot be written.
    pub fn write(
        folder: &Folder,
        config: &Config,
        shape: &Shape,
        image: &MemoryImage,
    ) -> Result<Self> {
        let format = shape.format;
        let machine = Plan::new(config)
            .and_then(|plan| module(&plan))
            .map_err(|error| anyhow!("the machine: {error}"))?
            .machine;
        let mut rng = fastrand::Rng::with_seed(4);
        let objects = objects_of(image, &mut rng);
        let mut memory = Memory::default();
        let mut commands = vec![];
        for (number, object) in objects.iter().enumerate() {
            memory.guard(format, &mut rng);
            let command = memory
                .add(format, machine, object)
                .with_context(|| format!("update program of object {number}"))?;
            commands.push(command);
        }
        memory.check(config)?;
        for _ in 0..DIRECTED {
            if memory.most(format) + ROOM > 1 << config.address_bits {
                break;
            }
            let object = directed(config, &mut rng)?;
            memory.guard(format, &mut rng);
            commands.push(memory.add(format, machine, &object)?);
        }
        // The order of the boxes differs from the order of the objects.
        let boxes = (0..commands.len() as u32).rev();
        for ((command, _), index) in commands.iter_mut().zip(boxes) {
            command.box_index = index;
        }
        memory.guard(format, &mut rng);
        memory.run(folder, shape, (&commands, objects.len()), machine)
    }
}

/// The memories of the update processor.
#[derive(Default)]
struct Memory {
    program: Vec<u8>,
    /// Words of [`Record::vertex`] and [`Record::node`] records.
    vertices: Vec<u32>,
    nodes: Vec<u32>,
    /// Words of triangle records. No update reads them; they give the triangle of each leaf.
    records: Vec<u32>,
}

impl Memory {
    /// Appends one or two filler records, which no update may read or write, to each memory. Nodes and records stay parallel.
    fn guard(&mut self, format: Format, rng: &mut fastrand::Rng) {
        let mut one_or_two = || rng.usize(1..=2);
        let rows = one_or_two() * Program::ROW_BYTES;
        self.program.extend(std::iter::repeat_n(u8::MAX, rows));
        let (vertices, slots) = (one_or_two(), one_or_two());
        for (record, words, count) in [
            (Record::vertex(format), &mut self.vertices, vertices),
            (Record::node(format), &mut self.nodes, slots),
            (Record::triangle(), &mut self.records, slots),
        ] {
            words.extend(filler(&record, format).repeat(count));
        }
    }

    /// Appends an object with moved vertices and old bounds; returns the command of its update, and the number of rows of its
    /// program.
    fn add(
        &mut self,
        format: Format,
        machine: UpdateMachine,
        object: &Object,
    ) -> Result<(UpdateCommand, u64)> {
        let Object {
            tree,
            triangles,
            before,
            after,
            has_bounds,
        } = object;
        let program = Program::compile(tree, triangles, before.len(), machine)?;
        let command = UpdateCommand {
            program: self.program.len() as u32,
            vertex_base: (self.vertices.len() / Record::vertex(format).words()) as u32,
            node_base: (self.nodes.len() / Record::node(format).words()) as u32,
            box_index: 0,
        };
        let mut placement = place(
            tree,
            &tree.refit(before, triangles),
            &program.renumber(triangles),
            &program.node_order,
            command.node_base,
            command.vertex_base,
        )?;
        if !has_bounds {
            // The last slot contains no node.
            for node in placement.nodes.iter_mut().take(triangles.len() - 1) {
                (node.left, node.right) = ([f64::NAN; 2], [f64::NAN; 2]);
            }
        }
        let slots = MemoryImage {
            format,
            nodes: placement.nodes,
            records: placement.records,
            vertices: vec![],
            root: placement.root,
            bounds: ([0.0; 3], [0.0; 3]),
        };
        let code = program.bytes();
        let rows = (code.len() / Program::ROW_BYTES) as u64;
        self.program.extend(code);
        self.vertices
            .extend(vector_words(format, &program.reorder_vertices(after)));
        self.nodes.extend(slots.node_words());
        self.records.extend(slots.record_words());
        Ok((command, rows))
    }

    /// The number of records in the largest memory.
    fn most(&self, format: Format) -> u64 {
        let vertices = self.vertices.len() / Record::vertex(format).words();
        let nodes = self.nodes.len() / Record::node(format).words();
        let rows = self.program.len() / Program::ROW_BYTES;
        vertices.max(nodes).max(rows) as u64
    }

    /// Checks that the machine can address all records.
    fn check(&self, config: &Config) -> Result<()> {
        let most = self.most(config.format());
        ensure!(
            most <= 1 << config.address_bits,
            "the scene is too large for its address space: its objects and their update programs take {most} indices, but {} \
             address bits hold {}; simplify the mesh or widen the address",
            config.address_bits,
            1u64 << config.address_bits
        );
        Ok(())
    }

    /// Runs the updates in the golden model and writes all files.
    fn run(
        mut self,
        folder: &Folder,
        shape: &Shape,
        (commands, of_scene): (&[(UpdateCommand, u64)], usize),
        machine: UpdateMachine,
    ) -> Result<UpdateSheets> {
        let format = shape.format;
        let [vertex, node, bounding_box] = [
            Record::vertex(format),
            Record::node(format),
            Record::bounding_box(format),
        ];
        let records = |stem: &str, record: &Record, words: &[u32]| {
            let layout = Layout::default().record(record, format);
            let label = if stem == "update_boxes" {
                "boxes"
            } else {
                "objects and fillers"
            };
            let mut sheet = Sheet::new(folder, stem, layout, label)?;
            for line in record.hex_lines(words).lines() {
                sheet.push_text(line)?;
            }
            anyhow::Ok(sheet)
        };
        let sheet = |stem: &str, layout, label: &str| Sheet::new(folder, stem, layout, label);
        let mut program = sheet(
            "update_program",
            shape.update_program(),
            "programs and fillers",
        )?;
        for row in self.program.chunks_exact(Program::ROW_BYTES) {
            let half = |from: usize| {
                let bytes = row[from..from + 8].try_into().expect("eight bytes");
                u64::from_le_bytes(bytes)
            };
            program.push(&[half(0), half(8)])?;
        }
        let images = [
            program,
            records("update_vertices", &vertex, &self.vertices)?,
            records("update_nodes_before", &node, &self.nodes)?,
            records("update_records", &Record::triangle(), &self.records)?,
        ];
        let mut lines = sheet("update_commands", shape.update_commands(), OF_SCENE)?;
        let mut writes = sheet("update_node_writes", shape.update_node_writes(), OF_SCENE)?;
        let mut box_words = vec![0; commands.len() * bounding_box.words()];
        let mut instructions = 0;
        for (number, &(command, rows)) in commands.iter().enumerate() {
            if number == of_scene {
                lines.begin(OF_NONE);
                writes.begin(OF_NONE);
            }
            let first_write = writes.lines;
            let mut result = Ok(());
            let memory = UpdateMemory {
                format,
                program: &self.program,
                vertices: &self.vertices,
                nodes: &mut self.nodes,
                boxes: &mut box_words,
            };
            let updated = update(memory, command, |event| {
                if let (UpdateEvent::NodeWrite { node, bounds }, true) = (event, result.is_ok()) {
                    let mut values = vec![u64::from(node), ALL_NUMBERS];
                    values.extend(bounds);
                    result = writes.push(&values);
                }
            })
            .with_context(|| format!("update {number}"))?;
            result?;
            let row = Program::ROW_BYTES as u32;
            instructions += updated.instructions;
            lines.push(&[
                u64::from(command.program / row),
                rows,
                u64::from(command.vertex_base),
                u64::from(command.node_base),
                u64::from(command.box_index),
                first_write,
                updated.nodes_written,
                updated.instructions,
            ])?;
        }
        Ok(UpdateSheets {
            images,
            commands: lines,
            writes,
            after: records("update_nodes_after", &node, &self.nodes)?,
            boxes: records("update_boxes", &bounding_box, &box_words)?,
            instructions,
            machine,
        })
    }
}

/// A record that nothing reads. Its numbers are NaN and its other fields are all ones, so any use of it changes a result.
pub fn filler(record: &Record, format: Format) -> Vec<u32> {
    let mut words = vec![0; record.words()];
    let layout = Layout::default().record(record, format);
    for (field, described) in record.fields.iter().zip(&layout.fields) {
        let value = match described.kind {
            Kind::Number => format.nan(),
            _ => u64::MAX >> (64 - field.width),
        };
        field.set(&mut words, value);
    }
    words
}

/// Each object of an image once, with slightly moved vertices.
fn objects_of(image: &MemoryImage, rng: &mut fastrand::Rng) -> Vec<Object> {
    let instances = image.instance_records().expect("a sound image");
    let mut roots = BTreeSet::new();
    if instances.is_empty() {
        roots.insert(key(image.root.root()));
    }
    for record in instances {
        roots.insert(key(Instance::fetch(image, record).root));
    }
    roots
        .into_iter()
        .map(|(leaf, index)| {
            let root = match leaf {
                true => Target::Record(index),
                false => Target::Node(index),
            };
            let (tree, triangles, before) = taken_out(image, root);
            let after = moved(image.format, &before, rng);
            Object {
                tree,
                triangles,
                before,
                after,
                has_bounds: true,
            }
        })
        .collect()
}

/// A sort key for a root.
fn key(root: Target) -> (bool, u32) {
    match root {
        Target::Node(index) => (false, index),
        Target::Record(index) => (true, index),
    }
}

/// The tree below a root with its triangles and vertices, renumbered from 0.
fn taken_out(image: &MemoryImage, root: Target) -> (Tree, Vec<[u32; 3]>, Vec<[f64; 3]>) {
    let mut tree = Tree {
        nodes: vec![],
        root: Child::Leaf(0),
    };
    let mut records = vec![];
    let mut open = vec![(root, None::<(usize, usize)>)];
    while let Some((target, parent)) = open.pop() {
        let child = match target {
            Target::Record(record) => {
                records.push(image.records[record as usize].vertices);
                Child::Leaf(records.len() as u32 - 1)
            }
            Target::Node(index) => {
                let link = image.nodes[index as usize].link;
                let number = tree.nodes.len();
                for (side, child) in link.children(index).into_iter().enumerate() {
                    open.push((child, Some((number, side))));
                }
                tree.nodes.push(TreeNode {
                    children: [Child::Leaf(0); 2],
                    axes: [link.left_axis, link.right_axis],
                });
                Child::Inner(number as u32)
            }
        };
        match parent {
            Some((node, side)) => tree.nodes[node].children[side] = child,
            None => tree.root = child,
        }
    }
    let mut numbers = HashMap::new();
    let mut vertices = vec![];
    let triangles = records
        .iter()
        .map(|corners| {
            corners.map(|corner| {
                *numbers.entry(corner).or_insert_with(|| {
                    vertices.push(image.vertices[corner as usize]);
                    vertices.len() as u32 - 1
                })
            })
        })
        .collect();
    (tree, triangles, vertices)
}

/// Vertices moved at random, each coordinate by at most [`MOTION`] times the largest side of their box.
fn moved(format: Format, vertices: &[[f64; 3]], rng: &mut fastrand::Rng) -> Vec<[f64; 3]> {
    let a = Arithmetic::new(format);
    let side = |i: usize| {
        let coordinates = || vertices.iter().map(|v| v[i]);
        coordinates().fold(f64::MIN, f64::max) - coordinates().fold(f64::MAX, f64::min)
    };
    let reach = MOTION * side(0).max(side(1)).max(side(2));
    // Adding +0 turns −0 into +0.
    let mut coordinate = |x: f64| a.round(x + reach * (2.0 * rng.f64() - 1.0)) + 0.0;
    vertices.iter().map(|v| v.map(&mut coordinate)).collect()
}

/// A small object: triangles with arbitrary corners, one unused vertex, coordinates on a coarse grid before the update; after it,
/// some coordinates are infinite or NaN.
fn directed(config: &Config, rng: &mut fastrand::Rng) -> Result<Object> {
    let count = rng.usize(1..=MOST_TRIANGLES);
    let vertices = rng.u32(3..=2 * MOST_TRIANGLES as u32);
    let mut grid = |_| std::array::from_fn(|_| f64::from(rng.i8(-4..=4)) / 2.0 + 0.0);
    let before: Vec<[f64; 3]> = (0..=vertices).map(&mut grid).collect();
    let mut after: Vec<[f64; 3]> = (0..=vertices).map(&mut grid).collect();
    for coordinate in after.as_flattened_mut() {
        if rng.u8(..8) == 0 {
            *coordinate = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY][rng.usize(..3)];
        }
    }
    let triangles: Vec<[u32; 3]> = (0..count)
        .map(|_| std::array::from_fn(|_| rng.u32(..vertices)))
        .collect();
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    Ok(Object {
        tree: build(&before, &triangles, &options)?,
        triangles,
        before,
        after,
        has_bounds: false,
    })
}
