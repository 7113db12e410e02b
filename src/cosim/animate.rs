//! Co-simulation of an animated scene, with every stage of every frame in RTL.
//!
//! ```text
//! host: pose ─→ vertices at rest, palettes ─→ skinning processor ─→ vertices ─→ update processor ─→ bounds, boxes
//!       boxes, instances ─→ top-level tree ──────────────────────────────────────────────→ ray casting unit ─→ picture
//! ```
//!
//! The units are compared with their golden models transaction by transaction. In addition, after every frame the whole
//! memory of the machine is compared with one computed by other means: vertices skinned in the order of the mesh, and bounds of
//! the tree computed from scratch. The picture is compared with that of the golden caster. The host reads only data that the RTL
//! has written; no data comes from the golden model.
//!
//! If the motion has made a tree inefficient, the host rebuilds it and compiles its program; both are used from the
//! next frame on.

use super::memory::Image;
use super::mismatch::{Field, Mismatch};
use super::model::BuildOptions as ModelOptions;
use super::model::Trace;
use super::raycast::{self, RaycastUnit};
use super::scoreboard::{Fault, Surroundings, UnitOptions};
use super::timing;
use super::unit_skinning::{self, SkinArrays, SkinUnit};
use super::unit_update::{self, Traffic, UpdateArrays, UpdateUnit};
use crate::bkd::layout::{
    INFLUENCES_PER_ROW, Influence, MemoryImage, Record, check_capacity, influence_words,
    vector_words,
};
use crate::bkd::{Bounds, BuildOptions, InstanceSpec, InstancedImage, Quality, Tree};
use crate::config::Config;
use crate::film::{Object, object_options};
use crate::float::Format;
use crate::golden::Caster;
use crate::golden::skinning::{SkinCommand, SkinMemory, skin};
use crate::golden::update::{UpdateCommand, UpdateMemory, update};
use crate::port::{Hit, Ray};
use crate::program::{Program, UpdateMachine};
use crate::scene::animation::ObjectFrame;
use anyhow::{Context, Result, ensure};
use image::RgbImage;

pub use crate::film::{Film, REBUILD_ABOVE, Setup, TreeReport};

/// The units with their own models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Unit {
    /// The skinning processor
    Skinning,
    /// The update processor
    Update,
    /// Ray setup, traversal unit and geometry unit together
    Raycast,
}

impl Unit {
    pub fn name(self) -> &'static str {
        match self {
            Unit::Skinning => "skinning",
            Unit::Update => "update",
            Unit::Raycast => "raycast",
        }
    }
}

/// Options of a run.
#[derive(Clone, Debug)]
pub struct Options {
    /// Seed of the memories' jitter and stalls; those of a frame depend on it and on the frame's number.
    pub seed: u64,
    /// An object's tree is rebuilt if the ratio of its cost to that of a rebuilt tree is above this value; at least 1, +∞: never.
    pub rebuild_above: f64,
    /// The first frame that runs in RTL; earlier frames only bring trees and memory to the required state.
    pub from_frame: usize,
    /// A waveform of one unit; its cycles are counted from the beginning of `from_frame`.
    pub trace: Option<(Unit, Trace)>,
    /// A fault in the Verilog of one processor, with which tests check that it is detected.
    pub fault: Option<(Unit, Fault)>,
    /// Options for building the models. A model with a trace is always built for tracing.
    pub build: ModelOptions,
    /// The command that repeats the run from its first frame, for a mismatch's report; may be empty.
    pub replay: String,
}

impl Default for Options {
    fn default() -> Self {
        Options {
            seed: 1,
            rebuild_above: REBUILD_ABOVE,
            from_frame: 0,
            trace: None,
            fault: None,
            build: ModelOptions::default(),
            replay: String::new(),
        }
    }
}

/// The figures of one frame, or the sum over several.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Cycles from a unit's start to its completion. Skinning and update have one memory behind all of their
    /// ports; see [`unit_update::Traffic::Shared`].
    pub skinning_cycles: u64,
    pub update_cycles: u64,
    pub raycast_cycles: u64,
    /// Number of skinned vertices and of their influences.
    pub vertices_skinned: u64,
    pub influences: u64,
    /// Triangles of updated objects, nodes written, and instructions executed.
    pub triangles: u64,
    pub nodes_written: u64,
    pub instructions: u64,
    /// Number of active rays, and of their hits.
    pub rays: u64,
    pub hits: u64,
    /// Costs of the refitted trees and of rebuilt trees, each weighted by the area of its instances' boxes in
    /// the world.
    pub refitted_cost: f64,
    pub rebuilt_cost: f64,
    /// Number of trees rebuilt after the frame.
    pub rebuilds: u64,
    /// Number of results of the RTL compared in all bits.
    pub checked: u64,
}

impl Figures {
    /// Cycles of all units.
    pub fn cycles(&self) -> u64 {
        self.skinning_cycles + self.update_cycles + self.raycast_cycles
    }

    /// The update's share of all cycles, from 0 to 1.
    pub fn update_share(&self) -> f64 {
        self.update_cycles as f64 / self.cycles() as f64
    }

    /// Skinning's share of all cycles, from 0 to 1.
    pub fn skinning_share(&self) -> f64 {
        self.skinning_cycles as f64 / self.cycles() as f64
    }

    /// Triangles per cycle of the update; `None` if nothing was updated.
    pub fn triangles_per_clock(&self) -> Option<f64> {
        (self.update_cycles > 0).then(|| self.triangles as f64 / self.update_cycles as f64)
    }

    /// Nodes per cycle of the update; `None` if nothing was updated.
    pub fn nodes_per_clock(&self) -> Option<f64> {
        (self.update_cycles > 0).then(|| self.nodes_written as f64 / self.update_cycles as f64)
    }

    /// Cost of the refitted trees relative to trees rebuilt for each frame.
    pub fn sah_ratio(&self) -> f64 {
        self.refitted_cost / self.rebuilt_cost
    }

    /// Adds the figures of another frame.
    pub fn add(&mut self, other: &Figures) {
        self.skinning_cycles += other.skinning_cycles;
        self.update_cycles += other.update_cycles;
        self.raycast_cycles += other.raycast_cycles;
        self.vertices_skinned += other.vertices_skinned;
        self.influences += other.influences;
        self.triangles += other.triangles;
        self.nodes_written += other.nodes_written;
        self.instructions += other.instructions;
        self.rays += other.rays;
        self.hits += other.hits;
        self.refitted_cost += other.refitted_cost;
        self.rebuilt_cost += other.rebuilt_cost;
        self.rebuilds += other.rebuilds;
        self.checked += other.checked;
    }
}

/// The result of a frame in RTL.
#[derive(Clone, Debug)]
pub struct FrameReport {
    /// Its index in [`Film::frames`].
    pub number: usize,
    pub figures: Figures,
    /// For objects with moving vertices: the tree's cost relative to a rebuilt tree, and whether it is rebuilt.
    pub trees: Vec<TreeReport>,
    pub picture: RgbImage,
}

/// Runs a film in the RTL of `config` from `options.from_frame` on, and passes each frame to `done` when all of
/// it agrees. `progress` receives the number of rays of the current frame that have returned.
///
/// # Errors
/// The first mismatch, a [`Mismatch`] whose cycle and replay refer to its frame. Also an error if the machine cannot hold the
/// scene, if a tool is missing, if there is no frame `from_frame`, or if `done` fails.
pub fn run(
    config: &Config,
    film: Film<'_>,
    options: &Options,
    progress: &dyn Fn(usize, u64),
    mut done: impl FnMut(FrameReport) -> Result<()>,
) -> Result<Setup> {
    ensure!(
        options.from_frame < film.frames.len(),
        "there is no frame {}: there are {}, counted from 0",
        options.from_frame,
        film.frames.len()
    );
    let mut host = Host::new(config, film)?;
    let skins = host.objects.iter().any(|object| object.skin.is_some());
    ensure!(
        skins || !matches!(options.trace, Some((Unit::Skinning, _))),
        "this scene has no skinned objects, so the skinning processor has no waveform; give another unit"
    );
    let mut units = Units::new(config, options, skins)?;
    for number in 0..film.frames.len() {
        let run = match number >= options.from_frame {
            true => Some(&mut units),
            false => None,
        };
        let report = host
            .frame(number, run, options, progress)
            .map_err(|error| match error.downcast_ref::<Mismatch>() {
                Some(_) => error,
                None => error.context(format!("frame {number}")),
            })?;
        if let Some(report) = report {
            done(report)?;
        }
    }
    Ok(host.setup)
}

/// The models, each built once.
struct Units {
    /// `Some` if any object is skinned.
    skinning: Option<SkinUnit>,
    update: UpdateUnit,
    raycast: RaycastUnit,
    around: Surroundings,
    /// By [`Unit`]: the cycles of its model before this frame that a run starting with this frame would not have.
    began: [u64; 3],
}

impl Units {
    fn new(config: &Config, options: &Options, skins: bool) -> Result<Units> {
        let trace_of = |unit: Unit| {
            let traced = options.trace.as_ref().filter(|(of, _)| *of == unit);
            traced.map(|(_, trace)| trace.clone())
        };
        let of_unit = |unit: Unit| UnitOptions {
            trace: trace_of(unit),
            fault: (options.fault.filter(|(of, _)| *of == unit)).map(|(_, fault)| fault),
            build: options.build.clone(),
            ..UnitOptions::new(options.seed)
        };
        Ok(Units {
            skinning: match skins {
                true => Some(SkinUnit::new(config, &of_unit(Unit::Skinning))?),
                false => None,
            },
            update: UpdateUnit::new(config, &of_unit(Unit::Update))?,
            raycast: RaycastUnit::built(config, trace_of(Unit::Raycast).as_ref(), &options.build)?,
            around: Surroundings {
                memory: timing(config, options.seed),
                pauses: 0.0,
                leaf_clocks: 1,
                slow_programs: 0.0,
            },
            began: [0; 3],
        })
    }

    /// Begins a frame. All random values in it depend only on the frame's number, so the frame can be run alone.
    fn begin(&mut self, seed: u64, frame: usize) {
        let seed = seed ^ (frame as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
        self.around.memory.seed = seed;
        // All units are reset for every frame. The ray casting unit resets itself; the others are also reset when they are built.
        if let Some(skinning) = &mut self.skinning {
            self.began[Unit::Skinning as usize] = skinning.cycles() - RESET;
            skinning.restart(seed);
        }
        self.began[Unit::Update as usize] = self.update.cycles() - RESET;
        self.update.restart(seed);
        self.began[Unit::Raycast as usize] = self.raycast.cycles();
    }
}

/// Number of cycles for which a unit is reset when it is built.
const RESET: u64 = 4;

/// An object of the film, and where its parts are.
struct Placed<'a> {
    object: Object<'a>,
    /// The program in whole rows, and the address of its first byte.
    code: Vec<u8>,
    code_at: u32,
    skin: Option<SkinPlace>,
    /// The data that the host supplied last; `None` before the first frame, and if memory must be written in a new order.
    given: Option<ObjectFrame>,
    /// Costs of the refitted tree and of a rebuilt one, for the current vertices.
    costs: [f64; 2],
}

/// The positions of the parts of a skinned object in memory.
#[derive(Clone, Copy)]
struct SkinPlace {
    /// Indices of the first vector of the palette and of the first vertex at rest.
    palette: u32,
    rest: u32,
    /// Index of the first row of influences, and the number of rows.
    influences: u32,
    rows: u32,
}

impl Placed<'_> {
    /// The stream of influences in the order of the program's vertices; empty for an object without a skin.
    fn influences(&self) -> Vec<Influence> {
        self.object.influences(self.object.vertices.len())
    }
}

/// The host: it manages the machine's memory and starts its units.
struct Host<'a> {
    config: &'a Config,
    film: Film<'a>,
    rays: Vec<Ray>,
    machine: UpdateMachine,
    objects: Vec<Placed<'a>>,
    /// The required contents of memory, by the golden model.
    golden: InstancedImage,
    /// The contents of memory, as written by host and RTL.
    arrays: UpdateArrays,
    influences: Vec<u32>,
    one_level: bool,
    /// The instances of the top-level tree in memory: those that are present in the frame.
    specs: Vec<InstanceSpec>,
    /// The numbers of these instances in the scene.
    there: Vec<usize>,
    setup: Setup,
}

impl<'a> Host<'a> {
    fn new(config: &'a Config, film: Film<'a>) -> Result<Host<'a>> {
        let (scene, format) = (film.scene, config.format());
        let machine = unit_update::machine(config)?;
        let one_level = film.is_one_level();
        let setup = film.setup();
        let top = if one_level { 0 } else { scene.instances.len() };
        check_capacity(0, (setup.triangles + top) as u64, config.address_bits)?;
        let mut objects = Vec::new();
        let mut golden = InstancedImage::new(format);
        let (mut program, mut influences) = (Vec::new(), Vec::new());
        let row = INFLUENCES_PER_ROW;
        for (number, object) in scene.objects.iter().enumerate() {
            let options = object_options(config, film, number);
            let made = Object::new(film, number, machine, options);
            let made = made.with_context(|| object.name.clone())?;
            golden.add_object(&made.image(format)?)?;
            let mut object = Placed {
                code: made.program.bytes(),
                code_at: program.len() as u32,
                skin: None,
                given: None,
                costs: [made.cost(format); 2],
                object: made,
            };
            program.extend_from_slice(&object.code);
            let stream = object.influences();
            if !stream.is_empty() {
                let joints = film.frames[0].objects[number].palette.len();
                object.skin = Some(SkinPlace {
                    palette: golden.add_vectors(&vec![[0.0; 3]; 4 * joints])?,
                    rest: golden.add_vectors(&vec![[0.0; 3]; object.object.rest.len()])?,
                    influences: influences.len() as u32 / row_words(format),
                    rows: stream.len().div_ceil(row) as u32,
                });
                influences.extend(influence_words(format, &stream));
            }
            objects.push(object);
        }
        let mut host = Host {
            config,
            film,
            rays: film.rays(),
            machine,
            arrays: UpdateArrays {
                program,
                vertices: Vec::new(),
                nodes: Image::zeroed(0, 1),
                boxes: Image::zeroed(objects.len() as u64, Record::bounding_box(format).width),
            },
            influences,
            objects,
            golden,
            one_level,
            specs: Vec::new(),
            there: vec![0],
            setup,
        };
        // The host loads memory: links, triangle records, and the bounds of static objects. The update processor writes all other
        // bounds, which are zero before.
        let boxes: Vec<Bounds> = host.golden.objects().iter().map(|o| o.bounds).collect();
        for (number, bounds) in boxes.iter().enumerate() {
            if !host.objects[number].object.moves {
                let (layout, row) = (Record::bounding_box(format), number as u64);
                let numbers = bounds.lo.into_iter().chain(bounds.hi);
                for (field, x) in layout.fields.iter().zip(numbers) {
                    field.set(host.arrays.boxes.row_mut(row), format.to_bits(x));
                }
            }
        }
        host.set_top(0, &boxes)?;
        let image = host.golden.image();
        // Memory has room for all instances, of which some may be absent from the first frame.
        let (slots, vertices) = match one_level {
            true => (image.nodes.len(), image.vertices.len() as u64),
            false => (
                host.golden.top_base() as usize + scene.instances.len(),
                host.golden.instance_vectors(scene.instances.len()).into(),
            ),
        };
        ensure!(
            vertices <= 1 << config.address_bits,
            "the scene is too large for its address space: {vertices} vertices and vectors, but {} address bits hold {}; simplify the meshes or widen the address",
            config.address_bits,
            1u64 << config.address_bits
        );
        let mut words = image.vertex_words();
        words.resize(vertices as usize * Record::vertex(format).words(), 0);
        host.arrays.vertices = words;
        let mut nodes = image.node_words();
        nodes.resize(slots * Record::node(format).words(), 0);
        host.arrays.nodes = Image::from_words(nodes, Record::node(format).width)?;
        for number in 0..host.objects.len() {
            if host.objects[number].object.moves {
                host.load_tree(number);
            }
        }
        Ok(host)
    }

    fn format(&self) -> Format {
        self.film.scene.format
    }

    /// Writes the links of an object's nodes, with zeros as bounds.
    fn load_tree(&mut self, number: usize) {
        let layout = Record::node(self.format());
        let place = self.golden.objects()[number];
        let words = self.golden.image().node_words();
        let slots = place.base as usize..(place.base + place.triangles) as usize;
        for slot in slots {
            let node = self.arrays.nodes.row_mut(slot as u64);
            node.copy_from_slice(&words[slot * layout.words()..][..layout.words()]);
            for bound in ["left_lo", "left_hi", "right_lo", "right_hi"] {
                layout.set(node, bound, 0);
            }
        }
    }

    /// Writes vectors to vertex memory from an index on.
    fn write_vectors(&mut self, first: u32, vectors: &[[f64; 3]]) {
        let words = vector_words(self.format(), vectors);
        let start = first as usize * Record::vertex(self.format()).words();
        self.arrays.vertices[start..start + words.len()].copy_from_slice(&words);
    }

    /// The box of an object in box memory.
    fn box_of(&self, number: usize) -> Bounds {
        let (layout, format) = (Record::bounding_box(self.format()), self.format());
        let words = self.arrays.boxes.row(number as u64);
        let numbers: Vec<f64> = (layout.fields.iter())
            .map(|field| format.to_f64(field.get(words)))
            .collect();
        Bounds {
            lo: [numbers[0], numbers[1], numbers[2]],
            hi: [numbers[3], numbers[4], numbers[5]],
        }
    }

    /// Builds the top-level tree over the instances that are present in a frame, from the boxes of the objects. There is
    /// no tree in a scene of one level, nor over zero instances.
    fn set_top(&mut self, frame: usize, boxes: &[Bounds]) -> Result<()> {
        if self.one_level {
            return Ok(());
        }
        let (there, specs) = self.film.instances(frame, boxes)?;
        self.specs = specs;
        self.there = there;
        if self.specs.is_empty() {
            self.golden.clear_top();
            return Ok(());
        }
        let Config {
            axes_per_node,
            stack_depth,
            ..
        } = *self.config;
        let options = BuildOptions::default_for(axes_per_node, stack_depth);
        self.golden.set_top(&self.specs, &options)
    }

    /// Writes the part of the golden image that belongs to the top level: nodes and the instances' vectors.
    fn load_top(&mut self) {
        if self.one_level {
            return;
        }
        let image = self.golden.image();
        let words = Record::node(image.format).words();
        let nodes = image.node_words();
        let first = self.golden.top_base() as usize;
        for slot in first..image.nodes.len() {
            let node = &nodes[slot * words..][..words];
            self.arrays.nodes.row_mut(slot as u64).copy_from_slice(node);
        }
        let first = self.golden.instance_vectors(0);
        let vectors = image.vertices[first as usize..].to_vec();
        self.write_vectors(first, &vectors);
    }

    /// Advances memory to a frame; with `units`, in RTL, which then casts the rays.
    fn frame(
        &mut self,
        number: usize,
        mut units: Option<&mut Units>,
        options: &Options,
        progress: &dyn Fn(usize, u64),
    ) -> Result<Option<FrameReport>> {
        let film = self.film;
        let frame = &film.frames[number];
        let mut figures = Figures::default();
        if let Some(units) = &mut units {
            units.begin(options.seed, number);
        }
        let mut changed = Vec::new();
        for object in 0..self.objects.len() {
            let given = &frame.objects[object];
            let state = &mut self.objects[object];
            if !state.object.moves || state.given.as_ref() == Some(given) {
                continue;
            }
            state.object.pose(film.scene, given)?;
            state.given = Some(given.clone());
            self.move_object(object, given, units.as_deref_mut(), &mut figures)
                .map_err(|error| located(error, number, units.as_deref(), options))?;
            // The reference of the golden model, by other means.
            let image = self.objects[object].object.image(self.format())?;
            self.golden.replace_object(object, &image)?;
            changed.push(object);
        }
        let boxes: Vec<Bounds> = (0..self.objects.len()).map(|k| self.box_of(k)).collect();
        let moved = number == 0 || frame.instances != film.frames[number - 1].instances;
        if moved || !changed.is_empty() {
            self.set_top(number, &boxes)?;
            self.load_top();
        }
        figures.checked += self
            .compare_memory()
            .map_err(|mismatch| located(mismatch.into(), number, units.as_deref(), options))?;

        // The costs of trees and the golden picture are computed while the RTL casts the rays.
        let image = self.image(&boxes);
        let (format, objects) = (self.format(), &self.objects);
        let side = |draws: bool| {
            let qualities = changed
                .iter()
                .map(|&number| objects[number].object.quality(format));
            let qualities: Result<Vec<Quality>> = qualities.collect();
            let rays_per_packet = self.config.rays_per_packet as usize;
            let hits = draws.then(|| {
                let caster = Caster::new(&image, self.config.triangle_test, rays_per_packet);
                caster.cast_packets(&self.rays).hits
            });
            (qualities, hits)
        };
        // There is no tree over zero instances, so nothing is cast or counted.
        let is_empty = self.there.is_empty();
        let (qualities, drawn) = match &mut units {
            Some(_) if is_empty => {
                progress(number, self.rays.len() as u64);
                (side(false).0?, None)
            }
            None => (side(false).0?, None),
            Some(units) => {
                image.check(self.config.stack_depth)?;
                let (rtl, (qualities, golden)) = std::thread::scope(|scope| {
                    let golden = scope.spawn(|| side(true));
                    let options = raycast::Options {
                        seed: units.around.memory.seed,
                        ..raycast::Options::default()
                    };
                    let told = |rays| progress(number, rays);
                    let rtl = units.raycast.cast(&image, &self.rays, &options, &told);
                    (rtl, golden.join().expect("the golden model does not panic"))
                });
                let rtl = rtl.map_err(|error| located(error, number, Some(&**units), options))?;
                (qualities?, Some((rtl, golden.expect("it was cast"))))
            }
        };
        for (&object, quality) in changed.iter().zip(&qualities) {
            self.objects[object].costs = [quality.refitted, quality.rebuilt];
        }
        let picture = match &drawn {
            None if is_empty && units.is_some() => {
                let misses = vec![Hit::MISS; self.rays.len()];
                Some(self.shade(number, &misses))
            }
            None => None,
            Some((rtl, golden)) => {
                let picture = self.shade(number, &rtl.hits);
                compare_pictures(&picture, &self.shade(number, golden))
                    .map_err(|e| located(e.into(), number, units.as_deref(), options))?;
                let active = self.rays.iter().filter(|ray| ray.active).count() as u64;
                figures.raycast_cycles = rtl.cycles;
                figures.rays = active;
                figures.hits = rtl.hits.iter().filter(|hit| hit.is_hit()).count() as u64;
                figures.checked += rtl.checked() + active;
                Some(picture)
            }
        };
        self.weigh(&mut figures);
        let qualities = changed.into_iter().zip(qualities);
        let trees = self.rebuild_bad(number, qualities, options, &mut figures)?;
        Ok(picture.map(|picture| FrameReport {
            number,
            figures,
            trees,
            picture,
        }))
    }

    /// Evaluates the trees of objects that have moved in a frame, and rebuilds the inefficient ones.
    fn rebuild_bad(
        &mut self,
        number: usize,
        qualities: impl Iterator<Item = (usize, Quality)>,
        options: &Options,
        figures: &mut Figures,
    ) -> Result<Vec<TreeReport>> {
        let mut trees = Vec::new();
        for (object, quality) in qualities {
            let sah_ratio = quality.ratio();
            // The last frame has no next one that could use a new tree.
            let rebuilt = sah_ratio > options.rebuild_above && number + 1 < self.film.frames.len();
            trees.push(TreeReport {
                object: self.objects[object].object.machine.name.clone(),
                sah_ratio,
                rebuilt,
            });
            if rebuilt {
                figures.rebuilds += 1;
                self.rebuild(object, quality.tree)?;
            }
        }
        Ok(trees)
    }

    /// Skins and updates an object whose vertices have changed.
    fn move_object(
        &mut self,
        number: usize,
        given: &ObjectFrame,
        mut units: Option<&mut Units>,
        figures: &mut Figures,
    ) -> Result<()> {
        let format = self.format();
        let place = self.golden.objects()[number];
        let state = &self.objects[number];
        let rest = state.object.program.reorder_vertices(&state.object.rest);
        let (code_at, rows) = (state.code_at, state.code.len() / Program::ROW_BYTES);
        match state.skin {
            None => self.write_vectors(place.vertex_base, &rest),
            Some(skin) => {
                self.golden.write_vectors(skin.rest, &rest);
                let palette = given.palette.as_flattened();
                self.golden.write_vectors(skin.palette, palette);
                self.write_vectors(skin.rest, &rest);
                self.write_vectors(skin.palette, palette);
                let command = SkinCommand {
                    palette: skin.palette,
                    joints: given.palette.len() as u32,
                    influences: skin.influences,
                    rows: skin.rows,
                    rest: skin.rest,
                    vertices: place.vertices,
                    target: place.vertex_base,
                };
                self.skin(command, units.as_deref_mut(), figures)?;
            }
        }
        let command = UpdateCommand {
            program: code_at,
            vertex_base: place.vertex_base,
            node_base: place.base,
            box_index: number as u32,
        };
        let Some(units) = units else {
            let (mut nodes, mut boxes) = (
                self.arrays.nodes.words().to_vec(),
                self.arrays.boxes.words().to_vec(),
            );
            let memory = UpdateMemory {
                format,
                program: &self.arrays.program,
                vertices: &self.arrays.vertices,
                nodes: &mut nodes,
                boxes: &mut boxes,
            };
            update(memory, command, |_| ())?;
            self.arrays.nodes = Image::from_words(nodes, Record::node(format).width)?;
            self.arrays.boxes = Image::from_words(boxes, Record::bounding_box(format).width)?;
            return Ok(());
        };
        let before = units.update.checked();
        let found = units.update.update(
            &mut self.arrays,
            command,
            rows as u32,
            &units.around,
            Traffic::Shared,
        )?;
        figures.update_cycles += found.busy_cycles;
        figures.triangles += found.triangles;
        figures.nodes_written += found.nodes_written;
        figures.instructions += found.instructions;
        figures.checked += units.update.checked() - before;
        Ok(())
    }

    /// Skins an object.
    fn skin(
        &mut self,
        command: SkinCommand,
        units: Option<&mut Units>,
        figures: &mut Figures,
    ) -> Result<()> {
        let format = self.format();
        let Some(units) = units else {
            let memory = SkinMemory {
                format,
                influences: &self.influences,
                vertices: &mut self.arrays.vertices,
            };
            skin(memory, command, |_| ())?;
            return Ok(());
        };
        let unit = (units.skinning.as_mut()).expect("a scene with a skin has the unit");
        let vertices = std::mem::take(&mut self.arrays.vertices);
        let mut arrays = SkinArrays {
            influences: std::mem::take(&mut self.influences),
            vertices: Image::from_words(vertices, Record::vertex(format).width)?,
        };
        let before = unit.checked();
        let found = unit.skin(
            &mut arrays,
            command,
            &units.around,
            unit_skinning::Traffic::Shared,
        );
        self.influences = arrays.influences;
        self.arrays.vertices = arrays.vertices.into_words();
        let found = found?;
        figures.skinning_cycles += found.busy_cycles;
        figures.vertices_skinned += found.vertices;
        figures.influences += found.influences;
        figures.checked += unit.checked() - before;
        Ok(())
    }

    /// The memory image for ray casting, with the given boxes of the objects.
    fn image(&self, boxes: &[Bounds]) -> MemoryImage {
        let mut image = self.golden.image().clone();
        if self.one_level {
            image.root = self.golden.objects()[0].root;
            image.bounds = (boxes[0].lo, boxes[0].hi);
        }
        image
    }

    /// Compares all memory that changes with the golden image; returns the number of records compared.
    fn compare_memory(&self) -> Result<u64, Mismatch> {
        let (image, format) = (self.golden.image(), self.format());
        let mut boxes = Vec::new();
        let box_layout = Record::bounding_box(format);
        for place in self.golden.objects() {
            let mut words = vec![0; box_layout.words()];
            let numbers = place.bounds.lo.into_iter().chain(place.bounds.hi);
            for (field, x) in box_layout.fields.iter().zip(numbers) {
                field.set(&mut words, format.to_bits(x));
            }
            boxes.extend(words);
        }
        let mut compared = 0;
        for (layout, golden, memory) in [
            (
                Record::vertex(format),
                image.vertex_words(),
                &self.arrays.vertices[..],
            ),
            (
                Record::node(format),
                image.node_words(),
                self.arrays.nodes.words(),
            ),
            (box_layout, boxes, self.arrays.boxes.words()),
        ] {
            let records = std::iter::zip(
                golden.chunks_exact(layout.words()),
                memory.chunks_exact(layout.words()),
            );
            for (index, (golden, memory)) in records.enumerate() {
                if golden != memory {
                    let fields = layout.fields.iter().map(|field| {
                        let (golden, memory) = (field.get(golden), field.get(memory));
                        match field.width == format.width() {
                            true => Field::number(field.name, format, golden, memory),
                            false => Field::integer(field.name, golden, memory),
                        }
                    });
                    return Err(Mismatch {
                        unit: Unit::Update.name(),
                        place: format!("{} {index} of memory", layout.name),
                        cycle: 0,
                        fields: fields.collect(),
                        replay: String::new(),
                    });
                }
                compared += 1;
            }
        }
        Ok(compared)
    }

    /// Draws the hits of rays in a frame.
    fn shade(&self, frame: usize, hits: &[Hit]) -> RgbImage {
        let vertices = |object: usize| &self.objects[object].object.vertices[..];
        self.film.shade(frame, &self.there, vertices, hits)
    }

    /// Sums the trees' costs over the instances, weighted by the areas of their boxes in the world.
    fn weigh(&self, figures: &mut Figures) {
        for (place, &number) in self.there.iter().enumerate() {
            let object = self.film.scene.instances[number];
            let area = match self.specs.get(place) {
                Some(spec) => spec.world_box.half_area(),
                None => 1.0,
            };
            let [refitted, rebuilt] = self.objects[object].costs;
            figures.refitted_cost += area * refitted;
            figures.rebuilt_cost += area * rebuilt;
        }
    }

    /// Gives an object another tree, and therefore another program and another order of vertices and nodes. The whole object is
    /// written and updated again in the next frame.
    fn rebuild(&mut self, number: usize, tree: Tree) -> Result<()> {
        let format = self.format();
        let object = &mut self.objects[number];
        object.object.rebuild(tree, self.machine)?;
        object.code = object.object.program.bytes();
        object.given = None;
        // Programs are consecutive, and the new one may have another length.
        self.arrays.program.clear();
        for object in &mut self.objects {
            object.code_at = self.arrays.program.len() as u32;
            self.arrays.program.extend_from_slice(&object.code);
        }
        let object = &self.objects[number];
        if let Some(skin) = object.skin {
            let words = influence_words(format, &object.influences());
            let start = (skin.influences * row_words(format)) as usize;
            self.influences[start..start + words.len()].copy_from_slice(&words);
        }
        let image = object.object.image(format)?;
        self.golden.replace_object(number, &image)?;
        self.load_tree(number);
        Ok(())
    }
}

fn row_words(format: Format) -> u32 {
    Record::influence_row(format).words() as u32
}

fn compare_pictures(rtl: &RgbImage, golden: &RgbImage) -> Result<(), Mismatch> {
    let differs = (rtl.enumerate_pixels().zip(golden.pixels())).find(|((_, _, r), g)| r != g);
    let Some(((x, y, rtl), golden)) = differs else {
        return Ok(());
    };
    let channels = ["red", "green", "blue"].into_iter().enumerate();
    let field =
        |(k, name): (usize, &str)| Field::integer(name, golden.0[k].into(), rtl.0[k].into());
    Err(Mismatch {
        unit: Unit::Raycast.name(),
        place: format!("pixel {x}, {y} of the picture"),
        cycle: 0,
        fields: channels.map(field).collect(),
        replay: String::new(),
    })
}

/// A mismatch with its frame, its cycle counted from the beginning of the frame, and the command that starts there.
fn located(
    error: anyhow::Error,
    number: usize,
    units: Option<&Units>,
    options: &Options,
) -> anyhow::Error {
    let mut mismatch = match error.downcast::<Mismatch>() {
        Ok(mismatch) => mismatch,
        Err(error) => return error,
    };
    let unit = match mismatch.unit {
        "skinning" => Unit::Skinning,
        "update" => Unit::Update,
        _ => Unit::Raycast,
    };
    if let Some(units) = units {
        let began = units.began[unit as usize];
        mismatch.cycle = mismatch.cycle.saturating_sub(began);
    }
    mismatch.place = format!("frame {number}, {}", mismatch.place);
    if !options.replay.is_empty() {
        mismatch.replay = format!(
            "{} --from-frame {number} --unit {}",
            options.replay,
            unit.name()
        );
    }
    mismatch.into()
}
