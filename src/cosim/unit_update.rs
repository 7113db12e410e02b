//! Co-simulation of the update processor. Compares every requested program row and vertex, every written node
//! and the object's box with the golden model, in order, address and all bits. At the end it compares the whole node and box
//! memory, which detects unexpected writes.
//!
//! [`UpdateUnit`] runs one update after another on memories of the caller; [`run`] gives it a [`Workload`].

use super::memory::{Bandwidth, Image, ReadHandles, ReadPort, WriteHandles};
use super::mismatch::Field;
use super::model::{Model, PortHandle};
pub use super::processor::Traffic;
use super::processor::{
    Pace, Reads, Share, Writes, check_capacity, summary, surroundings, write_timing,
};
use super::scoreboard::{
    Bench, Categories, Category, RESET_CYCLES, Surroundings, UnitOptions, UnitReport,
};
use crate::bkd::layout::{Record, vector_words};
use crate::bkd::{Child, Tree, TreeNode};
use crate::config::Config;
use crate::float::Format;
use crate::golden::update::{UpdateCommand, UpdateEvent, UpdateMemory, Updated, update};
use crate::hdl::{self, Bundle, Write};
use crate::hw::Plan;
use crate::hw::update::{Counters, Inputs, Outputs, Update, module, ports};
use crate::program::{Program, UpdateMachine};
use anyhow::{Context, Result};
use std::collections::VecDeque;

/// Maximum number of cycles from a load's request for its vertex until the load is the waiting instruction.
const ARRIVAL_OF_A_LOAD: u64 = 4;

/// The categories.
pub const CATEGORIES: &[Category] = &[
    // A vertex that is read has a NaN or an infinity.
    Category::Nan,
    Category::Infinity,
    // A node that is written has a flat interval.
    Category::FlatBox,
    // An object is one triangle.
    Category::LeafRoot,
];

/// The parameters for compiling programs for a machine's update processor.
///
/// # Errors
/// If the machine's description has a mistake, which is not known to occur.
pub fn machine(config: &Config) -> Result<UpdateMachine> {
    Ok(module(&Plan::new(config)?)?.machine)
}

/// An object to update: its program, and its vertices in the program's order.
#[derive(Clone, Debug)]
pub struct UpdateObject {
    pub name: String,
    /// The program in whole rows.
    pub program: Vec<u8>,
    /// The vertices as whole [`Record::vertex`] records.
    pub vertices: Vec<u32>,
    pub triangles: u64,
}

impl UpdateObject {
    /// Compiles the object's program for a machine. `vertices` are values of `format`.
    ///
    /// # Errors
    /// If [`Program::compile`] rejects it.
    pub fn new(
        name: impl Into<String>,
        format: Format,
        machine: UpdateMachine,
        tree: &Tree,
        triangles: &[[u32; 3]],
        vertices: &[[f64; 3]],
    ) -> Result<UpdateObject> {
        let program = Program::compile(tree, triangles, vertices.len(), machine)?;
        Ok(UpdateObject {
            name: name.into(),
            program: program.bytes(),
            vertices: vector_words(format, &program.reorder_vertices(vertices)),
            triangles: triangles.len() as u64,
        })
    }
}

/// The workload of the unit.
#[derive(Clone, Copy, Debug)]
pub enum Workload<'a> {
    /// These objects, one after another.
    Objects(&'a [UpdateObject]),
    /// Random topologies, mostly small, whose vertices have many ties and special values,
    /// until the given number of instructions is executed.
    Random { instructions: u64 },
}

/// The memories of the unit.
#[derive(Clone, Debug)]
pub struct UpdateArrays {
    /// Programs, each in whole rows of 16 bytes.
    pub program: Vec<u8>,
    /// Words of [`Record::vertex`] records.
    pub vertices: Vec<u32>,
    /// [`Record::node`] records.
    pub nodes: Image,
    /// [`Record::bounding_box`] records.
    pub boxes: Image,
}

impl UpdateArrays {
    /// A row of the programs, in words.
    fn program_row(&self, row: u64) -> [u32; Program::ROW_BYTES / 4] {
        let bytes = &self.program[row as usize * Program::ROW_BYTES..];
        let word = |k: usize| std::array::from_fn(|byte| bytes[4 * k + byte]);
        std::array::from_fn(|k| u32::from_le_bytes(word(k)))
    }
}

/// Figures of updates.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct UpdateFigures {
    pub name: String,
    pub triangles: u64,
    pub nodes_written: u64,
    pub vertices_read: u64,
    /// Counters of the RTL; the first is compared with the golden model's.
    pub instructions: u64,
    /// Cycles from start to completion.
    pub busy_cycles: u64,
    /// Cycles in which no instruction was issued.
    pub stalled_cycles: u64,
    /// Cycles that waited for a vertex, and cycles that waited for room for a node.
    pub vertex_wait_cycles: u64,
    pub node_wait_cycles: u64,
}

impl UpdateFigures {
    fn add(&mut self, other: &UpdateFigures) {
        self.triangles += other.triangles;
        self.nodes_written += other.nodes_written;
        self.vertices_read += other.vertices_read;
        self.instructions += other.instructions;
        self.busy_cycles += other.busy_cycles;
        self.stalled_cycles += other.stalled_cycles;
        self.vertex_wait_cycles += other.vertex_wait_cycles;
        self.node_wait_cycles += other.node_wait_cycles;
    }

    pub fn instructions_per_clock(&self) -> f64 {
        self.instructions as f64 / self.busy_cycles as f64
    }

    pub fn triangles_per_clock(&self) -> f64 {
        self.triangles as f64 / self.busy_cycles as f64
    }

    pub fn nodes_per_clock(&self) -> f64 {
        self.nodes_written as f64 / self.busy_cycles as f64
    }

    /// The figures in one line.
    pub fn summary(&self) -> String {
        format!(
            "{}: {} triangles, {} instructions in {} cycles ({} waiting for a vertex, {} for room for a node): {:.4} instructions, {:.4} triangles, {:.4} nodes per cycle",
            self.name,
            self.triangles,
            self.instructions,
            self.busy_cycles,
            self.vertex_wait_cycles,
            self.node_wait_cycles,
            self.instructions_per_clock(),
            self.triangles_per_clock(),
            self.nodes_per_clock()
        )
    }
}

/// The result of a run.
#[derive(Clone, Debug)]
pub struct UpdateReport {
    /// The report, with updates as packets and instructions as transactions.
    pub unit: UnitReport,
    /// The figures of each object of the workload, or of all random ones together.
    pub objects: Vec<UpdateFigures>,
}

impl UpdateReport {
    /// The report in a few lines.
    pub fn summary(&self) -> String {
        let figures = self.objects.iter().map(UpdateFigures::summary);
        summary(&self.unit, ["instructions", "updates"], figures)
    }
}

/// The golden model's events of an update.
#[derive(Default)]
struct Expected {
    rows: VecDeque<u32>,
    vertices: VecDeque<u32>,
    nodes: VecDeque<(u32, [u64; 4])>,
    boxes: VecDeque<(u32, [u64; 6])>,
}

impl Expected {
    fn left(&self) -> usize {
        self.rows.len() + self.vertices.len() + self.nodes.len() + self.boxes.len()
    }
}

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// The update processor in simulation.
pub struct UpdateUnit {
    bench: Bench,
    format: Format,
    machine: UpdateMachine,
    ports: Ports,
    rng: fastrand::Rng,
    /// Number of updates so far, which gives the memories of each update their own seeds.
    updates: u64,
}

impl UpdateUnit {
    /// Builds the unit of a machine and resets it.
    ///
    /// # Errors
    /// If a tool is missing.
    pub fn new(config: &Config, options: &UnitOptions) -> Result<UpdateUnit> {
        let plan = Plan::new(config)?;
        let unit = module(&plan)?;
        let mut bench = Bench::new("update", &unit.module, options)?;
        bench.model.reset(RESET_CYCLES);
        let ports = bench.model.ports(&ports(&plan))?;
        Ok(UpdateUnit {
            format: config.format(),
            machine: unit.machine,
            ports,
            rng: fastrand::Rng::with_seed(options.seed),
            updates: 0,
            bench,
        })
    }

    /// The parameters for compiling its programs.
    pub fn machine(&self) -> UpdateMachine {
        self.machine
    }

    /// Number of cycles simulated so far, including the reset.
    pub fn cycles(&self) -> u64 {
        self.bench.model.cycles()
    }

    /// Number of results compared so far.
    pub fn checked(&self) -> u64 {
        self.bench.tally.checked
    }

    /// Resets the unit. Later random values then depend on `seed` and not on the number of earlier updates.
    pub fn restart(&mut self, seed: u64) {
        self.bench.model.reset(RESET_CYCLES);
        self.rng = fastrand::Rng::with_seed(seed);
        self.updates = 0;
    }

    /// Runs an update with `rows` rows of program. Node and box memory then have the contents written by the RTL, which equal
    /// the golden model's.
    ///
    /// # Errors
    /// A [`super::mismatch::Mismatch`], or an error if the golden model rejects the program.
    pub fn update(
        &mut self,
        arrays: &mut UpdateArrays,
        command: UpdateCommand,
        rows: u32,
        around: &Surroundings,
        traffic: Traffic,
    ) -> Result<UpdateFigures> {
        let mut nodes = arrays.nodes.words().to_vec();
        let mut boxes = arrays.boxes.words().to_vec();
        let mut expected = Expected::default();
        let first_row = command.program / Program::ROW_BYTES as u32;
        expected.rows.extend(first_row..first_row + rows);
        let memory = UpdateMemory {
            format: self.format,
            program: &arrays.program,
            vertices: &arrays.vertices,
            nodes: &mut nodes,
            boxes: &mut boxes,
        };
        let golden = update(memory, command, |event| match event {
            UpdateEvent::VertexRead { vertex } => expected.vertices.push_back(vertex),
            UpdateEvent::NodeWrite { node, bounds } => expected.nodes.push_back((node, bounds)),
            UpdateEvent::BoxWrite { index, bounds } => expected.boxes.push_back((index, bounds)),
        })?;
        self.count(&arrays.vertices, &expected);

        self.updates += 1;
        let mut memories = Memories::new(self, arrays, around, traffic)?;
        let values = Update {
            program: first_row,
            rows,
            vertex_base: command.vertex_base,
            node_base: command.node_base,
            box_index: command.box_index,
        };
        let Ports { inputs, outputs } = self.ports;
        let values = values.map(|_, value| value.into());
        self.bench.model.drive(&inputs.start.payload, values);
        let before = self.bench.model.sample(&outputs.count);
        if self.updates == 1 {
            self.bench.counts_from_zero(&before.leaves())?;
        }
        let waited = self.simulate(&mut memories, &mut expected, arrays, Pace::new(around))?;
        self.bench.model.set(inputs.start.valid, 0);
        memories.stop(&mut self.bench.model);
        let figures = self.figures(before, &golden, expected.left(), waited)?;
        for (place, golden, rtl) in [
            ("node memory after an update", &nodes, &arrays.nodes),
            ("box memory after an update", &boxes, &arrays.boxes),
        ] {
            self.bench.same_memory(place, golden, rtl)?;
        }
        let tally = &mut self.bench.tally;
        tally.packets += 1;
        tally.transactions += figures.instructions;
        tally.checked += 1;
        Ok(figures)
    }

    /// Offers the update until it is accepted, and runs the unit until it is done. Returns the number of cycles from the first read of
    /// a vertex to the first response.
    fn simulate(
        &mut self,
        memories: &mut Memories,
        expected: &mut Expected,
        arrays: &mut UpdateArrays,
        mut pace: Pace,
    ) -> Result<u64> {
        let Ports { inputs, outputs } = self.ports;
        let vertex_words = Record::vertex(self.format).words();
        let nodes = expected.nodes.len();
        let (mut first_read, mut first_answer) = (None, None);
        for clock in 0u64.. {
            let starts = pace.starts(&mut self.rng);
            let model = &mut self.bench.model;
            let Memories {
                program,
                vertex,
                node,
                bounds,
                share,
            } = memories;
            let offered = [
                program.offers(model),
                vertex.offers(model),
                node.offers(model),
                bounds.offers(model),
            ];
            let granted = share.grant(offered);
            let accepted: [bool; 4] = std::array::from_fn(|k| offered[k] && granted[k]);
            let is_ready = model.get(outputs.start_ready) != 0;
            if self.updates == 1 && !pace.started && !is_ready {
                let place = "not ready for the first update";
                return Err(self.bench.mismatch(place, vec![]));
            }

            // Inputs for the edge.
            model.set(inputs.start.valid, starts.into());
            program.show(model, granted[0], |row| arrays.program_row(row));
            vertex.show(model, granted[1], |index| {
                &arrays.vertices[index as usize * vertex_words..][..vertex_words]
            });
            node.show(model, granted[2]);
            bounds.show(model, granted[3]);

            // Events of the unit at the edge.
            let bench = &mut self.bench;
            if accepted[0] {
                bench.ordered("program row", expected.rows.pop_front(), program.address())?;
            }
            if accepted[1] {
                first_read.get_or_insert(clock);
                bench.ordered(
                    "vertex read",
                    expected.vertices.pop_front(),
                    vertex.address(),
                )?;
            }
            if accepted[2] {
                let next = expected.nodes.pop_front();
                let number = nodes - expected.nodes.len();
                bench.written(format!("node write {number} of an update"), next, node)?;
            }
            if accepted[3] {
                bench.written("the object's box", expected.boxes.pop_front(), bounds)?;
            }
            program.step(granted[0])?;
            if vertex.step(granted[1])? {
                first_answer.get_or_insert(clock);
            }
            node.step(&bench.model, accepted[2], &mut arrays.nodes)?;
            bounds.step(&bench.model, accepted[3], &mut arrays.boxes)?;
            bench.model.clock();
            if bench.model.get(outputs.done) != 0 {
                break;
            }
            if let Some(idle) = pace.step(starts && is_ready, &accepted) {
                let left = expected.nodes.len();
                let place =
                    format!("nothing happens for {idle} clocks, with {left} nodes to be written");
                return Err(bench.mismatch(place, vec![]));
            }
        }
        Ok(first_answer.unwrap_or(0) - first_read.unwrap_or(0))
    }

    /// Checks and returns the counts since `before`. `left` are the missing reads and writes; the first vertex took `waited` cycles.
    fn figures(
        &self,
        before: Counters<u64>,
        golden: &Updated,
        left: usize,
        waited: u64,
    ) -> Result<UpdateFigures> {
        let after = self.bench.model.sample(&self.ports.outputs.count);
        let Counters {
            instructions,
            busy_cycles: busy,
            stalled_cycles: stalled,
            vertex_wait_cycles: vertex_wait,
            node_wait_cycles: node_wait,
        } = after.zip(before).map(|_, (after, before)| after - before);
        if (instructions, busy, left) != (golden.instructions, instructions + stalled, 0) {
            let fields = vec![
                Field::integer("instructions", golden.instructions, instructions),
                Field::integer("busy cycles", instructions + stalled, busy),
                Field::integer("reads and writes left", 0, left as u64),
            ];
            return Err(self.bench.mismatch("after an update", fields));
        }
        // The first instruction is a load, which becomes the waiting instruction soon after its request.
        let (least, waits) = (
            waited.saturating_sub(ARRIVAL_OF_A_LOAD),
            vertex_wait + node_wait,
        );
        if !(least..=stalled).contains(&waits) || vertex_wait < least {
            let of_vertex = "clocks that wait for a vertex, at least";
            let fields = vec![
                Field::integer(of_vertex, least, vertex_wait),
                Field::integer("all clocks that wait, at most", stalled, waits),
            ];
            return Err(self.bench.mismatch("after an update", fields));
        }
        Ok(UpdateFigures {
            name: String::new(),
            triangles: golden.nodes_written + 1,
            nodes_written: golden.nodes_written,
            vertices_read: golden.vertices_read,
            instructions,
            busy_cycles: busy,
            stalled_cycles: stalled,
            vertex_wait_cycles: vertex_wait,
            node_wait_cycles: node_wait,
        })
    }

    /// Counts the categories of an update.
    fn count(&mut self, vertices: &[u32], expected: &Expected) {
        let format = self.format;
        let record = Record::vertex(format);
        let categories: &mut Categories = &mut self.bench.tally.categories;
        for &vertex in &expected.vertices {
            let words = &vertices[vertex as usize * record.words()..];
            let any = |is: fn(f64) -> bool| {
                let mut fields = record.fields.iter();
                fields.any(|field| is(format.to_f64(field.get(words))))
            };
            categories.count(Category::Nan, any(f64::is_nan));
            categories.count(Category::Infinity, any(f64::is_infinite));
        }
        for (_, [left_lo, left_hi, right_lo, right_hi]) in &expected.nodes {
            let flat = left_lo == left_hi || right_lo == right_hi;
            categories.count(Category::FlatBox, flat);
        }
        categories.count(Category::LeafRoot, expected.nodes.is_empty());
    }
}

/// The memories of the unit during an update.
struct Memories {
    program: Reads,
    vertex: Reads,
    node: Writes,
    bounds: Writes,
    share: Share<4>,
}

impl Memories {
    fn new(
        unit: &mut UpdateUnit,
        arrays: &UpdateArrays,
        around: &Surroundings,
        traffic: Traffic,
    ) -> Result<Memories> {
        let (format, Ports { inputs, outputs }) = (unit.format, unit.ports);
        let port = |number: u64| 4 * unit.updates + number;
        let rows = (arrays.program.len() / Program::ROW_BYTES) as u64;
        let vertices = (arrays.vertices.len() / Record::vertex(format).words()) as u64;
        let mut timing = around.port(port(0));
        if unit.rng.f64() < around.slow_programs {
            timing.bandwidth = Bandwidth {
                requests: 1,
                cycles: 64,
            };
        }
        let program = ReadPort::new("program", rows, timing)?;
        let vertex = ReadPort::new("vertex", vertices, around.port(port(1)))?;
        let node = outputs.node_write.payload;
        let node_write = WriteHandles {
            valid: outputs.node_write.valid,
            ready: inputs.node_write_ready,
            payload: Write {
                address: node.address,
                data: node.data,
            },
        };
        let box_write = WriteHandles {
            valid: outputs.box_write.valid,
            ready: inputs.box_write_ready,
            payload: outputs.box_write.payload,
        };
        let writes = |record, numbers, handles, mask, number| {
            let timing = write_timing(around, port(number));
            Writes::new(record, format, numbers, handles, mask, timing)
        };
        Ok(Memories {
            program: Reads::new(
                ReadHandles::of_unit(outputs.program, inputs.program),
                program,
            ),
            vertex: Reads::new(ReadHandles::of_unit(outputs.vertex, inputs.vertex), vertex),
            node: writes(Record::node(format), 4, node_write, Some(node.mask), 2)?,
            bounds: writes(Record::bounding_box(format), 6, box_write, None, 3)?,
            share: Share::new(traffic, [1; 4], 1, 0),
        })
    }

    fn stop(&self, model: &mut Model) {
        self.program.stop(model);
        self.vertex.stop(model);
        self.node.stop(model);
        self.bounds.stop(model);
    }
}

/// Co-simulates the update processor of a machine.
///
/// # Errors
/// If a tool is missing, or if the machine cannot hold an object. A mismatch is no error here; it is in the report.
pub fn run(
    config: &Config,
    workload: Workload<'_>,
    traffic: Traffic,
    options: &UnitOptions,
) -> Result<UpdateReport> {
    let mut unit = UpdateUnit::new(config, options)?;
    let mut rng = fastrand::Rng::with_seed(options.seed ^ 0x7570_6461_7465);
    let mut objects = vec![];
    let ended = match workload {
        Workload::Objects(all) => all.iter().try_for_each(|object| {
            let mut figures = batch(
                &mut unit,
                config,
                std::slice::from_ref(object),
                traffic,
                options,
                &mut rng,
            )?;
            figures.name.clone_from(&object.name);
            objects.push(figures);
            Ok(())
        }),
        Workload::Random { instructions } => {
            let mut total = UpdateFigures {
                name: "random topologies".into(),
                ..UpdateFigures::default()
            };
            let ended = (|| {
                while total.instructions < instructions {
                    let several = random_objects(config, unit.machine(), &mut rng)?;
                    total.add(&batch(
                        &mut unit, config, &several, traffic, options, &mut rng,
                    )?);
                }
                Ok(())
            })();
            objects.push(total);
            ended
        }
    };
    Ok(UpdateReport {
        unit: unit.bench.report(ended, CATEGORIES)?,
        objects,
    })
}

/// Updates objects in one memory, with gaps between them, one after another. If there are several, it updates them
/// twice, so that the state left by each one meets another.
fn batch(
    unit: &mut UpdateUnit,
    config: &Config,
    objects: &[UpdateObject],
    traffic: Traffic,
    options: &UnitOptions,
    rng: &mut fastrand::Rng,
) -> Result<UpdateFigures> {
    let around = surroundings(options, rng);
    let format = config.format();
    let vertex_words = Record::vertex(format).words();
    let mut program = vec![];
    let mut vertices = vec![];
    let mut nodes = 0;
    let mut commands = vec![];
    for (box_index, object) in objects.iter().enumerate() {
        let gap = rng.usize(..3);
        program.extend(std::iter::repeat_with(|| rng.u8(..)).take(gap * Program::ROW_BYTES));
        vertices.extend(std::iter::repeat_with(|| rng.u32(..)).take(gap * vertex_words));
        nodes += gap as u64;
        commands.push((
            UpdateCommand {
                program: program.len() as u32,
                vertex_base: (vertices.len() / vertex_words) as u32,
                node_base: nodes as u32,
                box_index: box_index as u32,
            },
            (object.program.len() / Program::ROW_BYTES) as u32,
        ));
        program.extend(&object.program);
        vertices.extend(&object.vertices);
        nodes += object.triangles;
    }
    let most = nodes
        .max((vertices.len() / vertex_words) as u64)
        .max((program.len() / Program::ROW_BYTES) as u64);
    check_capacity(config, "objects", most)?;
    // Random initial contents, which show unexpected writes.
    let mut noise = |rows: u64, bits: u32| {
        let count = rows as usize * bits.div_ceil(32) as usize;
        let words = std::iter::repeat_with(|| rng.u32(..)).take(count).collect();
        Image::from_words(words, bits)
    };
    let mut arrays = UpdateArrays {
        program,
        vertices,
        nodes: noise(nodes, Record::node(format).width)?,
        boxes: noise(objects.len() as u64, Record::bounding_box(format).width)?,
    };
    let mut figures = UpdateFigures::default();
    let rounds = if objects.len() > 1 { 2 } else { 1 };
    for (command, rows) in commands.iter().cycle().take(rounds * commands.len()) {
        figures.add(&unit.update(&mut arrays, *command, *rows, &around, traffic)?);
    }
    Ok(figures)
}

/// A few random objects that fit the machine's memory together.
fn random_objects(
    config: &Config,
    machine: UpdateMachine,
    rng: &mut fastrand::Rng,
) -> Result<Vec<UpdateObject>> {
    // n triangles need at most 2 log2(n) box registers, and a random triangle has up to three vertices of its own.
    let most = (1usize << (machine.box_registers / 2).min(11))
        .min((1 << config.address_bits) / 20)
        .max(1);
    (0..rng.usize(1..=4))
        .map(|_| random_object(config.format(), machine, most, rng))
        .collect()
}

/// An object of random size, at most `most` triangles, connectivity, tree and vertices.
fn random_object(
    format: Format,
    machine: UpdateMachine,
    most: usize,
    rng: &mut fastrand::Rng,
) -> Result<UpdateObject> {
    let size = [1, 2, 3, 10, 60, 400, 2000][rng.usize(..7)];
    let count = rng.usize(1..=most.min(size));
    let triangles: Vec<[u32; 3]> = match rng.u8(..3) {
        // Arbitrary corners, some of them equal.
        0 => {
            let vertices = rng.u32(1..=2 * count as u32);
            let mut corner = || rng.u32(..vertices);
            (0..count).map(|_| [corner(), corner(), corner()]).collect()
        }
        // A strip with randomly rotated corners.
        1 => (0..count as u32)
            .map(|k| {
                let mut corners = [k, k + 1, k + 2];
                rng.shuffle(&mut corners);
                corners
            })
            .collect(),
        // No shared vertices.
        _ => (0..count as u32)
            .map(|k| [3 * k, 3 * k + 1, 3 * k + 2])
            .collect(),
    };
    let used = triangles.iter().flatten().max().map_or(0, |v| v + 1);
    let kind = rng.u8(..4);
    let vertices: Vec<[f64; 3]> = (0..used)
        .map(|_| std::array::from_fn(|_| random_number(format, kind, rng)))
        .collect();
    let tree = random_tree(count, rng);
    UpdateObject::new("random", format, machine, &tree, &triangles, &vertices)
        .with_context(|| format!("a random object of {count} triangles"))
}

/// A value of the format other than −0: arbitrary, or one of few.
fn random_number(format: Format, kind: u8, rng: &mut fastrand::Rng) -> f64 {
    let special = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0];
    match kind {
        0 => f64::from(rng.i8(-2..=2)),
        1 if rng.u8(..4) == 0 => special[rng.usize(..4)],
        2 => [f64::NAN, special[rng.usize(..4)]][rng.usize(..2)],
        _ => match format.to_f64(rng.u64(..1 << format.width())) {
            0.0 => 0.0,
            x => x,
        },
    }
}

/// A tree of random shape over triangles in random order.
fn random_tree(count: usize, rng: &mut fastrand::Rng) -> Tree {
    let mut leaves: Vec<u32> = (0..count as u32).collect();
    rng.shuffle(&mut leaves);
    let mut nodes: Vec<TreeNode> = Vec::with_capacity(count - 1);
    let shape = rng.u8(..4);
    // The ranges of leaves that are not yet split, and their parents.
    let mut open = vec![(0, count, None::<(usize, usize)>)];
    let mut root = Child::Leaf(leaves[0]);
    while let Some((from, to, parent)) = open.pop() {
        let child = if to - from == 1 {
            Child::Leaf(leaves[from])
        } else {
            let split = match shape {
                0 => from + (to - from) / 2,
                1 => from + 1,
                2 => to - 1,
                _ => rng.usize(from + 1..to),
            };
            let node = nodes.len();
            open.push((from, split, Some((node, 0))));
            open.push((split, to, Some((node, 1))));
            nodes.push(TreeNode {
                children: [Child::Leaf(0); 2],
                axes: [rng.u8(..3), rng.u8(..3)],
            });
            Child::Inner(node as u32)
        };
        match parent {
            Some((node, side)) => nodes[node].children[side] = child,
            None => root = child,
        }
    }
    Tree { nodes, root }
}
