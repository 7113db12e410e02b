//! Co-simulation of skinning in the ray casting unit, where the skinning processor uses operators of the geometry unit. Compares every
//! requested vector and influence row and every written vertex with the golden model, in order, address and all bits. At the end it
//! compares the whole vertex memory, which detects unexpected writes.
//!
//! [`SkinUnit`] skins one mesh after another in memories of the caller; [`run`] gives it a [`Workload`].

use super::memory::{Image, ReadHandles, ReadPort, WriteHandles};
use super::mismatch::Field;
use super::model::{Model, PortHandle};
pub use super::processor::Traffic;
use super::processor::{self, Pace, Reads, Share, Writes, summary, surroundings, write_timing};
use super::scoreboard::{Bench, Category, RESET_CYCLES, Surroundings, UnitOptions, UnitReport};
use crate::bkd::layout::{
    Columns, INFLUENCES_PER_ROW, Influence, Record, influence_words, influences_of_words,
    vector_words,
};
use crate::config::Config;
use crate::float::{Arithmetic, Format};
use crate::golden::skinning::{MOST_INFLUENCES, SkinCommand, SkinEvent, SkinMemory, skin};
use crate::hdl::{self, Bundle};
use crate::hw::Plan;
use crate::hw::raycast::{Inputs, Outputs, emit, ports};
use crate::hw::skinning::Mesh;
use crate::scene::animation::{MachineObject, ObjectFrame};
use anyhow::{Result, ensure};
use std::collections::VecDeque;

/// The categories of vertices; the last two are those of meshes.
pub const CATEGORIES: &[Category] = &[
    Category::OneInfluence,
    Category::TwoInfluences,
    Category::ThreeInfluences,
    Category::FourInfluences,
    Category::InTwoRows,
    // The vertex at rest, a matrix or a weight has a NaN, an infinity or a −0.
    Category::Nan,
    Category::Infinity,
    Category::SignedZero,
    Category::FullPalette,
    Category::OneVertex,
];

/// A mesh to skin. Numbers are values of the machine's format.
#[derive(Clone, Debug)]
pub struct SkinMesh {
    pub name: String,
    /// At least one vertex.
    pub rest: Vec<[f64; 3]>,
    /// In the order of the vertices, 1 to 4 per vertex, with the last one of each marked.
    pub influences: Vec<Influence>,
    /// At least one matrix.
    pub palette: Vec<Columns>,
}

impl SkinMesh {
    /// A skinned object in a frame; `None` if it is not skinned.
    pub fn of_frame(object: &MachineObject, frame: &ObjectFrame) -> Option<SkinMesh> {
        let influences = object.influences.as_ref()?;
        Some(SkinMesh {
            name: object.name.clone(),
            rest: frame.written.as_ref().unwrap_or(&object.rest).clone(),
            influences: influences.iter().flatten().copied().collect(),
            palette: frame.palette.clone(),
        })
    }

    /// An object with random influences, the same for the same seed: every vertex follows 1 to 4 of up to `joints` random matrices.
    pub fn bound_at_random(
        format: Format,
        object: &MachineObject,
        joints: u32,
        seed: u64,
    ) -> SkinMesh {
        let mut rng = fastrand::Rng::with_seed(seed);
        let a = Arithmetic::new(format);
        let joints = rng.u32(1..=joints);
        let palette = (0..joints).map(|_| -> Columns {
            std::array::from_fn(|_| std::array::from_fn(|_| a.round(2.0 * rng.f64() - 1.0)))
        });
        let palette = palette.collect();
        let influences = object.rest.iter().flat_map(|_| {
            let follows = rng.usize(1..=MOST_INFLUENCES);
            let influence = |k| Influence {
                joint: rng.u32(..joints) as u8,
                weight: a.round(rng.f64()),
                last: k == follows,
            };
            (1..=follows).map(influence).collect::<Vec<_>>()
        });
        SkinMesh {
            name: object.name.clone(),
            rest: object.rest.clone(),
            influences: influences.collect(),
            palette,
        }
    }
}

/// The workload of the unit.
#[derive(Clone, Copy, Debug)]
pub enum Workload<'a> {
    /// These meshes, one after another.
    Meshes(&'a [SkinMesh]),
    /// Random meshes, mostly small, with many special values, until the given number of vertices is skinned.
    Random { vertices: u64 },
}

/// The memories of the unit.
#[derive(Clone, Debug)]
pub struct SkinArrays {
    /// Words of [`Record::influence_row`] records.
    pub influences: Vec<u32>,
    /// [`Record::vertex`] records: palettes, vertices at rest, written vertices.
    pub vertices: Image,
}

impl SkinArrays {
    /// Memories with one mesh, and the command that skins it: the vertices to write from index 0, then those at
    /// rest, then the palette.
    ///
    /// # Errors
    /// If a mesh has more vectors than an index can address.
    pub fn of_mesh(format: Format, mesh: &SkinMesh) -> Result<(SkinArrays, SkinCommand)> {
        let count = mesh.rest.len();
        let mut vectors = vec![[0.0; 3]; count];
        vectors.extend(&mesh.rest);
        vectors.extend(mesh.palette.as_flattened());
        ensure!(
            u32::try_from(vectors.len()).is_ok(),
            "{}: {} vectors are too many",
            mesh.name,
            vectors.len()
        );
        let arrays = SkinArrays {
            influences: influence_words(format, &mesh.influences),
            vertices: Image::from_words(
                vector_words(format, &vectors),
                Record::vertex(format).width,
            )?,
        };
        let command = SkinCommand {
            palette: 2 * count as u32,
            joints: mesh.palette.len() as u32,
            influences: 0,
            rows: mesh.influences.len().div_ceil(INFLUENCES_PER_ROW) as u32,
            rest: count as u32,
            vertices: count as u32,
            target: 0,
        };
        Ok((arrays, command))
    }
}

/// Bytes per cycle of [`Traffic::Shared`].
pub const SHARED_BYTES: u32 = 32;

/// Figures of skinning.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct SkinFigures {
    pub name: String,
    pub vertices: u64,
    /// Counters of the RTL; the first is compared with the golden model's.
    pub influences: u64,
    /// Cycles from start to completion.
    pub busy_cycles: u64,
}

impl SkinFigures {
    fn add(&mut self, other: &SkinFigures) {
        self.vertices += other.vertices;
        self.influences += other.influences;
        self.busy_cycles += other.busy_cycles;
    }

    pub fn influences_per_clock(&self) -> f64 {
        self.influences as f64 / self.busy_cycles as f64
    }

    pub fn vertices_per_clock(&self) -> f64 {
        self.vertices as f64 / self.busy_cycles as f64
    }

    /// The figures in one line.
    pub fn summary(&self) -> String {
        format!(
            "{}: {} vertices, {} influences in {} cycles: {:.4} influences, {:.4} vertices per cycle",
            self.name,
            self.vertices,
            self.influences,
            self.busy_cycles,
            self.influences_per_clock(),
            self.vertices_per_clock()
        )
    }
}

/// The result of a run.
#[derive(Clone, Debug)]
pub struct SkinReport {
    /// The report, with meshes as packets and vertices as transactions.
    pub unit: UnitReport,
    /// The figures of each mesh of the workload, or of all random ones together.
    pub meshes: Vec<SkinFigures>,
}

impl SkinReport {
    /// The figures of all meshes together.
    pub fn total(&self) -> SkinFigures {
        let mut total = SkinFigures {
            name: "all meshes".into(),
            ..SkinFigures::default()
        };
        self.meshes.iter().for_each(|mesh| total.add(mesh));
        total
    }

    /// The report in a few lines.
    pub fn summary(&self) -> String {
        let figures = self.meshes.iter().map(SkinFigures::summary);
        summary(&self.unit, ["vertices", "meshes"], figures)
    }
}

/// The golden model's events of skinning.
#[derive(Default)]
struct Expected {
    vectors: VecDeque<u32>,
    rows: VecDeque<u32>,
    writes: VecDeque<(u32, [u64; 3])>,
}

impl Expected {
    fn left(&self) -> usize {
        self.vectors.len() + self.rows.len() + self.writes.len()
    }
}

type Ports = hdl::Ports<Inputs<PortHandle>, Outputs<PortHandle>>;

/// The ray casting unit in simulation, used only for skinning.
pub struct SkinUnit {
    bench: Bench,
    format: Format,
    joints: u32,
    ports: Ports,
    rng: fastrand::Rng,
    /// Number of meshes so far, which gives the memories of each mesh their own seeds.
    meshes: u64,
}

impl SkinUnit {
    /// Builds the ray casting unit of a machine and resets it.
    ///
    /// # Errors
    /// If a tool is missing.
    pub fn new(config: &Config, options: &UnitOptions) -> Result<SkinUnit> {
        // The model is the same as that for ray casting.
        let plan = Plan::new(config)?.with_trace(true);
        let machine = emit(&plan)?;
        let mut bench = Bench::new("skinning", machine.design.top(), options)?;
        bench.model.reset(RESET_CYCLES);
        let ports = bench.model.ports(&ports(&plan))?;
        Ok(SkinUnit {
            format: config.format(),
            joints: config.skinning_joints,
            ports,
            rng: fastrand::Rng::with_seed(options.seed),
            meshes: 0,
            bench,
        })
    }

    /// Influences and cycles counted since the reset.
    fn counters(&self) -> [u64; 2] {
        let count = &self.ports.outputs.count;
        [count.skin_influences, count.skin_cycles].map(|port| self.bench.model.get(port))
    }

    /// Number of cycles simulated so far, including the reset.
    pub fn cycles(&self) -> u64 {
        self.bench.model.cycles()
    }

    /// Number of results compared so far.
    pub fn checked(&self) -> u64 {
        self.bench.tally.checked
    }

    /// Resets the unit. Later random values then depend on `seed` and not on the number of earlier meshes.
    pub fn restart(&mut self, seed: u64) {
        self.bench.model.reset(RESET_CYCLES);
        self.rng = fastrand::Rng::with_seed(seed);
        self.meshes = 0;
    }

    /// Skins a mesh. Vertex memory then has the contents written by the RTL, which equal the golden model's.
    ///
    /// # Errors
    /// A [`super::mismatch::Mismatch`], or an error if the golden model rejects the command or if the palette is too large.
    pub fn skin(
        &mut self,
        arrays: &mut SkinArrays,
        command: SkinCommand,
        around: &Surroundings,
        traffic: Traffic,
    ) -> Result<SkinFigures> {
        ensure!(
            command.joints <= self.joints,
            "the palette has {} joints, but skinning.joints = {}; set it to {} or more",
            command.joints,
            self.joints,
            command.joints.next_power_of_two()
        );
        let mut vertices = arrays.vertices.words().to_vec();
        let mut expected = Expected::default();
        let memory = SkinMemory {
            format: self.format,
            influences: &arrays.influences,
            vertices: &mut vertices,
        };
        let golden = skin(memory, command, |event| match event {
            SkinEvent::VectorRead { index } => expected.vectors.push_back(index),
            SkinEvent::RowRead { row } => expected.rows.push_back(row),
            SkinEvent::VertexWrite { vertex, position } => {
                expected.writes.push_back((vertex, position));
            }
        })?;
        self.count(arrays, command);

        self.meshes += 1;
        let mut memories = Memories::new(self, arrays, around, traffic)?;
        let values = Mesh {
            palette: command.palette,
            joints: command.joints,
            influences: command.influences,
            rows: command.rows,
            rest: command.rest,
            vertices: command.vertices,
            target: command.target,
        };
        let start = self.ports.inputs.skin_start;
        let values = values.map(|_, value| value.into());
        self.bench.model.drive(&start.payload, values);
        let before = self.counters();
        if self.meshes == 1 {
            self.bench.counts_from_zero(&before)?;
        }
        self.simulate(&mut memories, &mut expected, arrays, Pace::new(around))?;
        self.bench.model.set(start.valid, 0);
        memories.stop(&mut self.bench.model);
        let after = self.counters();
        let [influences, busy_cycles] = std::array::from_fn(|k| after[k] - before[k]);
        if (influences, expected.left()) != (golden.influences, 0) {
            let fields = vec![
                Field::integer("influences", golden.influences, influences),
                Field::integer("reads and writes left", 0, expected.left() as u64),
            ];
            return Err(self.bench.mismatch("after a mesh", fields));
        }
        let place = "vertex memory after a mesh";
        self.bench.same_memory(place, &vertices, &arrays.vertices)?;
        let tally = &mut self.bench.tally;
        tally.packets += 1;
        tally.transactions += golden.vertices;
        tally.checked += 1;
        Ok(SkinFigures {
            name: String::new(),
            vertices: golden.vertices,
            influences,
            busy_cycles,
        })
    }

    /// Offers the mesh until it is accepted, and runs the unit until it is done.
    fn simulate(
        &mut self,
        memories: &mut Memories,
        expected: &mut Expected,
        arrays: &mut SkinArrays,
        mut pace: Pace,
    ) -> Result<()> {
        let Ports { inputs, outputs } = self.ports;
        let row_words = Record::influence_row(self.format).words();
        let vertices = expected.writes.len();
        loop {
            let starts = pace.starts(&mut self.rng);
            let bench = &mut self.bench;
            let model = &mut bench.model;
            let Memories {
                vector,
                row,
                write,
                share,
            } = memories;
            let offered = [vector.offers(model), row.offers(model), write.offers(model)];
            let granted = share.grant(offered);
            let accepted: [bool; 3] = std::array::from_fn(|k| offered[k] && granted[k]);
            let starting = starts && model.get(outputs.skin_start_ready) != 0;

            // Inputs for the edge.
            model.set(inputs.skin_start.valid, starts.into());
            vector.show(model, granted[0], |index| arrays.vertices.row(index));
            row.show(model, granted[1], |index| {
                &arrays.influences[index as usize * row_words..][..row_words]
            });
            write.show(model, granted[2]);

            // Events of the unit at the edge.
            if accepted[0] {
                bench.ordered(
                    "vector read",
                    expected.vectors.pop_front(),
                    vector.address(),
                )?;
            }
            if accepted[1] {
                let next = expected.rows.pop_front();
                bench.ordered("row of influences read", next, row.address())?;
            }
            if accepted[2] {
                let next = expected.writes.pop_front();
                let number = vertices - expected.writes.len();
                bench.written(format!("vertex write {number} of a mesh"), next, write)?;
            }
            vector.step(granted[0])?;
            row.step(granted[1])?;
            write.step(&bench.model, accepted[2], &mut arrays.vertices)?;
            bench.model.clock();
            if bench.model.get(outputs.skin_done) != 0 {
                return Ok(());
            }
            if let Some(idle) = pace.step(starting, &accepted) {
                let left = expected.writes.len();
                let place = format!(
                    "nothing happens for {idle} clocks, with {left} vertices to be written"
                );
                return Err(bench.mismatch(place, vec![]));
            }
        }
    }

    /// Counts the categories of a mesh. The golden model has accepted the command.
    fn count(&mut self, arrays: &SkinArrays, command: SkinCommand) {
        let format = self.format;
        let vector_record = Record::vertex(format);
        let vector = |index: u32| {
            let words = arrays.vertices.row(index.into());
            ["x", "y", "z"].map(|name| format.to_f64(vector_record.get(words, name)))
        };
        let row_words = Record::influence_row(format).words();
        let rows = command.influences as usize * row_words;
        let rows = &arrays.influences[rows..rows + command.rows as usize * row_words];
        let influences = influences_of_words(format, rows);
        let categories = &mut self.bench.tally.categories;
        let mut place = 0;
        for number in 0..command.vertices {
            let first = place;
            let mut numbers = vector(command.rest + number).to_vec();
            loop {
                let influence = influences[place];
                place += 1;
                numbers.push(influence.weight);
                let columns = command.palette + 4 * u32::from(influence.joint);
                numbers.extend((columns..columns + 4).flat_map(vector));
                if influence.last {
                    break;
                }
            }
            let by_count = [
                Category::OneInfluence,
                Category::TwoInfluences,
                Category::ThreeInfluences,
                Category::FourInfluences,
            ];
            categories.count(by_count[place - first - 1], true);
            let split = first / INFLUENCES_PER_ROW != (place - 1) / INFLUENCES_PER_ROW;
            categories.count(Category::InTwoRows, split);
            let any = |is: fn(&f64) -> bool| numbers.iter().any(is);
            categories.count(Category::Nan, any(|x| x.is_nan()));
            categories.count(Category::Infinity, any(|x| x.is_infinite()));
            let negative_zero = any(|x| *x == 0.0 && x.is_sign_negative());
            categories.count(Category::SignedZero, negative_zero);
        }
        categories.count(Category::FullPalette, command.joints == self.joints);
        categories.count(Category::OneVertex, command.vertices == 1);
    }
}

/// The memories of the unit while it skins a mesh.
struct Memories {
    vector: Reads,
    row: Reads,
    write: Writes,
    share: Share<3>,
}

impl Memories {
    fn new(
        unit: &SkinUnit,
        arrays: &SkinArrays,
        around: &Surroundings,
        traffic: Traffic,
    ) -> Result<Memories> {
        let (format, Ports { inputs, outputs }) = (unit.format, unit.ports);
        let (vector_record, row_record) = (Record::vertex(format), Record::influence_row(format));
        let bytes = [vector_record.width, row_record.width, vector_record.width]
            .map(|bits| bits.div_ceil(8));
        let port = |number: u64| 3 * unit.meshes + number;
        let rows = (arrays.influences.len() / row_record.words()) as u64;
        let vector = ReadPort::new("vertex", arrays.vertices.rows(), around.port(port(0)))?;
        let row = ReadPort::new("influence", rows, around.port(port(1)))?;
        let write = WriteHandles {
            valid: outputs.skin_write.valid,
            ready: inputs.skin_write_ready,
            payload: outputs.skin_write.payload,
        };
        let timing = write_timing(around, port(2));
        Ok(Memories {
            vector: Reads::new(ReadHandles::of_unit(outputs.vertex, inputs.vertex), vector),
            row: Reads::new(
                ReadHandles::of_unit(outputs.influence, inputs.influence),
                row,
            ),
            write: Writes::new(vector_record, format, 3, write, None, timing)?,
            share: Share::new(traffic, bytes, SHARED_BYTES, SHARED_BYTES),
        })
    }

    fn stop(&self, model: &mut Model) {
        self.vector.stop(model);
        self.row.stop(model);
        self.write.stop(model);
    }
}

/// Co-simulates the skinning processor of a machine.
///
/// # Errors
/// If a tool is missing, or if the machine cannot hold a mesh. A mismatch is no error here; it is in the report.
pub fn run(
    config: &Config,
    workload: Workload<'_>,
    traffic: Traffic,
    options: &UnitOptions,
) -> Result<SkinReport> {
    let mut unit = SkinUnit::new(config, options)?;
    let mut rng = fastrand::Rng::with_seed(options.seed ^ 0x736b_696e);
    let mut meshes = vec![];
    let ended = match workload {
        Workload::Meshes(all) => all.iter().try_for_each(|mesh| {
            let around = surroundings(options, &mut rng);
            let (mut arrays, command) = SkinArrays::of_mesh(config.format(), mesh)?;
            check_capacity(config, &arrays)?;
            let mut figures = unit.skin(&mut arrays, command, &around, traffic)?;
            figures.name.clone_from(&mesh.name);
            meshes.push(figures);
            Ok(())
        }),
        Workload::Random { vertices } => {
            let mut total = SkinFigures {
                name: "random meshes".into(),
                ..SkinFigures::default()
            };
            let mut ended = Ok(());
            while ended.is_ok() && total.vertices < vertices {
                let around = surroundings(options, &mut rng);
                let (mut arrays, commands) = random_meshes(config, &mut rng)?;
                // Twice, so that the state left by each mesh meets another one.
                ended = commands.repeat(2).into_iter().try_for_each(|command| {
                    total.add(&unit.skin(&mut arrays, command, &around, traffic)?);
                    Ok(())
                });
            }
            meshes.push(total);
            ended
        }
    };
    Ok(SkinReport {
        unit: unit.bench.report(ended, CATEGORIES)?,
        meshes,
    })
}

/// Checks that the machine's addresses can reach all of the arrays.
fn check_capacity(config: &Config, arrays: &SkinArrays) -> Result<()> {
    let row_words = Record::influence_row(config.format()).words();
    let most = arrays
        .vertices
        .rows()
        .max((arrays.influences.len() / row_words) as u64);
    processor::check_capacity(config, "meshes", most)
}

/// A few random meshes in one memory, with random data between them and at the targets.
fn random_meshes(
    config: &Config,
    rng: &mut fastrand::Rng,
) -> Result<(SkinArrays, Vec<SkinCommand>)> {
    let format = config.format();
    let vector = Record::vertex(format);
    let row = Record::influence_row(format);
    // All palettes may have the maximum size; limit them to half of a small memory.
    let memory = 1usize << config.address_bits;
    let most_joints = config.skinning_joints.min((memory / 64) as u32);
    let room = memory - 32 * most_joints as usize;
    let most = (room / 32).clamp(1, 4000);
    let (mut influences, mut vertices) = (vec![], vec![]);
    let noise = |count: usize, words: usize, rng: &mut fastrand::Rng| -> Vec<u32> {
        std::iter::repeat_with(|| rng.u32(..))
            .take(count * words)
            .collect()
    };
    let mut commands = vec![];
    for _ in 0..rng.usize(1..=4) {
        let size = [1, 2, 3, 10, 60, 400, 4000][rng.usize(..7)];
        let count = rng.usize(1..=most.min(size));
        let joints = match rng.u8(..4) {
            0 => most_joints,
            1 => 1,
            _ => rng.u32(1..=most_joints),
        };
        let kind = rng.u8(..4);
        let add_vectors = |number: usize, vertices: &mut Vec<u32>, rng: &mut fastrand::Rng| {
            let gap = rng.usize(..3);
            vertices.extend(noise(gap, vector.words(), rng));
            let first = vertices.len() / vector.words();
            for _ in 0..number {
                let start = vertices.len();
                vertices.resize(start + vector.words(), 0);
                for field in &vector.fields {
                    field.set(&mut vertices[start..], random_bits(format, kind, rng));
                }
            }
            first as u32
        };
        let palette = add_vectors(4 * joints as usize, &mut vertices, rng);
        let rest = add_vectors(count, &mut vertices, rng);
        let target = add_vectors(count, &mut vertices, rng);
        // Either a random number of influences per vertex, or a constant one.
        let always = rng.usize(..=MOST_INFLUENCES);
        let mut stream = vec![];
        for _ in 0..count {
            let follows = match always {
                0 => rng.usize(1..=MOST_INFLUENCES),
                always => always,
            };
            stream.extend((1..=follows).map(|k| Influence {
                joint: rng.u32(..joints) as u8,
                weight: format.to_f64(random_bits(format, kind, rng) & !format.sign_bit()),
                last: k == follows,
            }));
        }
        let gap = rng.usize(..3);
        influences.extend(noise(gap, row.words(), rng));
        let first_row = influences.len() / row.words();
        influences.extend(influence_words(format, &stream));
        commands.push(SkinCommand {
            palette,
            joints,
            influences: first_row as u32,
            rows: stream.len().div_ceil(INFLUENCES_PER_ROW) as u32,
            rest,
            vertices: count as u32,
            target,
        });
    }
    let arrays = SkinArrays {
        influences,
        vertices: Image::from_words(vertices, vector.width)?,
    };
    check_capacity(config, &arrays)?;
    Ok((arrays, commands))
}

/// A random bit pattern: arbitrary, one of few, or of moderate size with some special ones.
fn random_bits(format: Format, kind: u8, rng: &mut fastrand::Rng) -> u64 {
    let special = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0];
    let moderate = |rng: &mut fastrand::Rng| {
        let bias = (format.exponent_mask() >> 1) as i64;
        let reach = bias.min(4);
        let exponent = (bias + rng.i64(-reach + 1..=reach)) as u64;
        let fraction = rng.u64(..=format.fraction_mask());
        let sign = if rng.bool() { format.sign_bit() } else { 0 };
        sign | exponent << format.fraction_bits() | fraction
    };
    match kind {
        0 => rng.u64(..1 << format.width()),
        1 => format.to_bits(f64::from(rng.i8(-1..=1)) * [1.0, -1.0][rng.usize(..2)]),
        2 if rng.u8(..16) == 0 => format.to_bits(special[rng.usize(..5)]),
        _ => moderate(rng),
    }
}
