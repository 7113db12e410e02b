//! Co-simulation of the geometry unit: compares it with the golden model test by test.
//!
//! This module models the unit's neighbours. Ray setup writes rays that the golden model has set up. The traversal unit dispatches
//! the leaves of a packet one after another. Triangle and vertex memory respond with any timing. After the last leaf of a packet
//! its closest hits are read back.
//!
//! Every ray–triangle test is compared in all bits (ray, record, whether it hits and replaces the closest hit, t, u and v of a hit, the
//! limit), as are every finished leaf (its context, with the hit mask) and every closest hit that is read back.
//!
//! In a scene of two levels the traversal unit also dispatches instances. Every transformed ray is compared in all bits (origin and
//! direction in object space, window, and the interval for ray setup), as is the root at which its packet starts in
//! the object. The golden model sets up the transformed rays; they are written, and triangles are tested with them.

use super::TRACED;
use super::memory::Image;
use super::mismatch::Field;
use super::model::{BuildOptions, PortHandle};
use super::raycast::{MemoryPort, compare_test, compare_transform, test_numbers};
use super::scoreboard::{
    Bench, Category, RESET_CYCLES, RaySetUp, SetupPlace, Surroundings, UnitOptions, UnitReport,
};
use super::workload::{Batch, Batches, TestScene, TinyTree, Workload, odd_number, tiny_scene};
use crate::bkd::layout::{InstanceRecord, Record, Target};
use crate::config::{Config, TriangleTest};
use crate::float::{Arithmetic, Format};
use crate::golden::{
    Closest, EnterEvent, HandOver, Instance, Observer, Outcome, RaySetup, Transformed, Triangle,
    WHOLE_LINE,
};
use crate::hdl::{self, Bundle, Flow, ReadPort, Spec, Specs};
use crate::hw::Plan;
use crate::hw::geometry::{self, TestTrace, World};
use crate::hw::ray::{Context, InContext, Leaf, Limit};
use crate::port::Ray;
use anyhow::{Result, ensure};
use std::collections::VecDeque;
use std::ops::Range;

/// The categories of ray–triangle tests.
pub const CATEGORIES: &[Category] = &[
    // The ray or a vertex has a NaN, an infinity or a -0.
    Category::Nan,
    Category::Infinity,
    Category::SignedZero,
    // The triangle's box is flat on one axis; on two, or two vertices are equal; the ray is in a plane of the box.
    Category::FlatBox,
    Category::Degenerate,
    Category::RayInPlane,
    Category::Hit,
    // The hit has the distance of the closest one; is clamped into the box; is on an edge or a vertex.
    Category::EqualDistances,
    Category::Clamped,
    Category::OnEdge,
    Category::AnyHit,
    Category::FiniteLimits,
    // The leaf's packet has a full stack.
    Category::DeepestStack,
];

/// The categories of ray transformations.
pub const TRANSFORM_CATEGORIES: &[Category] = &[
    // The ray, the instance's matrix or box, or a result has a NaN, an infinity or a -0.
    Category::Nan,
    Category::Infinity,
    Category::SignedZero,
    // The instance's box is flat on one axis; the ray is in a plane of it.
    Category::FlatBox,
    Category::RayInPlane,
    // The ray misses the instance's box; hits it, but not between tmin and tmax; no ray of the packet enters.
    Category::EmptyWindow,
    Category::OutsideLimits,
    Category::NothingEntered,
    Category::AnyHit,
    Category::FiniteLimits,
    // The instance is mirrored; the root of its object is a leaf.
    Category::Mirrored,
    Category::LeafRoot,
    Category::DeepestStack,
];

/// The transactions that are counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Counted {
    Tests,
    Transforms,
}

/// The properties of a triangle on which its categories depend.
struct Marks {
    lo: [f64; 3],
    hi: [f64; 3],
    nan: bool,
    infinite: bool,
    negative_zero: bool,
}

/// The contents of the unit's memories.
struct Contents {
    records: Image,
    vertices: Image,
    /// By record; the element of an instance's record is undefined.
    triangles: Vec<Triangle>,
    marks: Vec<Marks>,
    /// By record; `Some` for instances.
    instances: Vec<Option<Instance>>,
}

impl Contents {
    fn new(scene: &TestScene) -> Contents {
        let mut contents = Contents {
            records: scene.records.clone(),
            vertices: scene.vertices.clone(),
            triangles: scene.triangles.clone(),
            marks: vec![],
            instances: scene.instances.clone(),
        };
        contents.mark();
        contents
    }

    /// Whether leaves in the world are instances.
    fn is_instanced(&self) -> bool {
        self.instances.iter().any(Option::is_some)
    }

    /// Indices of the triangles' records, or of the instances'.
    fn records_of(&self, instances: bool) -> Vec<u32> {
        (0u32..)
            .zip(&self.instances)
            .filter(|(_, instance)| instance.is_some() == instances)
            .map(|(index, _)| index)
            .collect()
    }

    /// Puts infinities, NaNs and other special values into some of the vertices. Scenes do not contain them, but golden model
    /// and RTL must agree on them.
    fn poison(&mut self, format: Format, rng: &mut fastrand::Rng) {
        let (vertex, triangle) = (Record::vertex(format), Record::triangle());
        // The instances' vectors are at the end and do not change.
        let vectors = self.instances.iter().flatten().count() * InstanceRecord::VECTORS;
        let seldom = if rng.bool() { 32 } else { 6 };
        for row in 0..self.vertices.rows() - vectors as u64 {
            for axis in ["x", "y", "z"] {
                if rng.u8(..seldom) == 0 {
                    let bits = format.to_bits(odd_number(format, rng));
                    vertex.set(self.vertices.row_mut(row), axis, bits);
                }
            }
        }
        for (row, entry) in self.triangles.iter_mut().enumerate() {
            if self.instances[row].is_some() {
                continue;
            }
            let record = self.records.row(row as u64);
            let corners = ["v0", "v1", "v2"].map(|corner| {
                let words = self.vertices.row(triangle.get(record, corner));
                ["x", "y", "z"].map(|axis| format.to_f64(vertex.get(words, axis)))
            });
            *entry = Triangle::new(corners, entry.number);
        }
        self.mark();
    }

    fn mark(&mut self) {
        let mark = |triangle: &Triangle| {
            let some =
                |holds: fn(f64) -> bool| triangle.vertices.iter().flatten().any(|x| holds(*x));
            let (lo, hi) = triangle.bounds();
            Marks {
                lo,
                hi,
                nan: some(f64::is_nan),
                infinite: some(f64::is_infinite),
                negative_zero: some(is_negative_zero),
            }
        };
        self.marks = self.triangles.iter().map(mark).collect();
    }
}

fn is_negative_zero(x: f64) -> bool {
    x == 0.0 && x.is_sign_negative()
}

/// The categories of a ray transformation.
fn transform_categories(
    instance: &Instance,
    ray: &TestRay,
    transformed: &Transformed,
) -> [(Category, bool); 10] {
    let (lo, hi) = instance.bounds;
    let some = |holds: fn(f64) -> bool| {
        let moved = (transformed.ray.origin.iter()).chain(&transformed.ray.direction);
        let vectors = instance.columns.as_flattened().iter().chain(&lo).chain(&hi);
        moved.chain(vectors).any(|x| holds(*x))
    };
    let setup = &ray.setup;
    let in_plane = (0..3)
        .any(|i| setup.reciprocal[i].is_infinite() && [lo[i], hi[i]].contains(&setup.origin[i]));
    let [near, far] = transformed.window;
    let [x, y, z, _] = instance.columns;
    let cross = [0, 1, 2].map(|i: usize| {
        let (j, k) = ((i + 1) % 3, (i + 2) % 3);
        x[j] * y[k] - x[k] * y[j]
    });
    let volume: f64 = (0..3).map(|i| cross[i] * z[i]).sum();
    [
        (Category::Nan, ray.nan || some(f64::is_nan)),
        (Category::Infinity, ray.infinite || some(f64::is_infinite)),
        (
            Category::SignedZero,
            ray.negative_zero || some(is_negative_zero),
        ),
        (Category::FlatBox, (0..3).any(|i| lo[i] == hi[i])),
        (Category::RayInPlane, in_plane),
        (Category::EmptyWindow, near > far),
        (
            Category::OutsideLimits,
            near <= far && transformed.near > transformed.far,
        ),
        (Category::AnyHit, setup.any_hit),
        (
            Category::FiniteLimits,
            setup.tmin > 0.0 || setup.tmax < f64::INFINITY,
        ),
        (Category::Mirrored, volume < 0.0),
    ]
}

/// The expected result of one ray–triangle test.
struct Expected {
    ray: usize,
    outcome: Outcome,
    replaces: bool,
    limit: f64,
}

/// A ray of a packet, and its current result.
struct TestRay {
    setup: RaySetup,
    /// The ray in the object space that its packet entered last.
    object: Option<Transformed>,
    closest: Closest,
    nan: bool,
    infinite: bool,
    negative_zero: bool,
}

/// A packet in flight.
struct Packet {
    number: u64,
    rays: Vec<TestRay>,
    leaves: Vec<HandOver>,
    next_leaf: usize,
    /// Expected tests of the triangle in the unit; not empty while there is one.
    tests: VecDeque<Expected>,
    /// Expected transformations of the instance in the unit; not empty while there is one.
    transforms: VecDeque<EnterEvent>,
    /// The number of the packet's instance.
    instance: u32,
    level: u64,
    touched: u64,
    /// Number of rays read back so far.
    read: usize,
}

impl Packet {
    /// The leaf that is offered or in the unit.
    fn leaf(&self) -> HandOver {
        self.leaves[self.next_leaf]
    }
}

/// A ray to write into the unit.
struct Writing {
    place: SetupPlace,
    values: geometry::SetUp<u64>,
    /// The last component of its shear.
    shear_z: u64,
    /// For a ray of the world, the bits of its direction.
    direction: [u64; 3],
}

/// The pending operations of packets in flight.
#[derive(Default)]
struct Queues {
    /// Rays to write, and those whose packet was named early enough for the read latency of the unit's memory.
    arriving: VecDeque<Writing>,
    announced: VecDeque<Option<Writing>>,
    /// Packets with a leaf to dispatch; the one whose leaf is offered; those to read back.
    ready: Vec<usize>,
    offered: Option<usize>,
    finished: VecDeque<usize>,
}

type Ports = hdl::Ports<geometry::Inputs<PortHandle>, geometry::Outputs<PortHandle>>;

/// Co-simulates the geometry unit of a machine. With [`Workload::Rays`] the leaves are those of the golden model's traversal;
/// in tiny scenes they are random leaves with random rays.
///
/// # Errors
/// If a tool is missing, or if the machine cannot hold a scene. A mismatch is no error here; it is in the report.
pub fn run(config: &Config, workload: Workload<'_>, options: &UnitOptions) -> Result<UnitReport> {
    let mut run = Run::new(config, Counted::Tests, options)?;
    let ended = run.all(workload, options);
    run.bench.report(ended, CATEGORIES)
}

/// The same, but with ray transformations as transactions. A scene of one level has none.
///
/// # Errors
/// As [`run`].
pub fn run_transform(
    config: &Config,
    workload: Workload<'_>,
    options: &UnitOptions,
) -> Result<UnitReport> {
    let mut run = Run::new(config, Counted::Transforms, options)?;
    let ended = run.all(workload, options);
    run.bench.report(ended, TRANSFORM_CATEGORIES)
}

/// The throughput of the geometry unit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Throughput {
    /// Active rays per leaf.
    pub active_rays: u32,
    /// Number of ray–triangle tests, all of them compared.
    pub tests: u64,
    /// Number of cycles from the first to the last test.
    pub clocks: u64,
}

impl Throughput {
    /// Ray–triangle tests per cycle.
    pub fn rate(&self) -> f64 {
        self.tests as f64 / self.clocks as f64
    }

    /// The share of the peak of one test per cycle and one vertex per cycle, with three vertices per triangle.
    pub fn share_of_peak(&self) -> f64 {
        self.rate() / (f64::from(self.active_rays) / 3.0).min(1.0)
    }
}

/// Number of leaves per packet in measurements of throughput, large enough that start and end are negligible.
const LEAVES_FOR_THROUGHPUT: usize = 400;

/// Measures the geometry unit with leaves of `active_rays` rays each, with memories that respond in every cycle after 8 cycles,
/// and without pauses.
///
/// # Errors
/// If a tool is missing, if there is a mismatch, or if `active_rays` exceeds the packet size.
pub fn throughput(
    config: &Config,
    active_rays: u32,
    seed: u64,
    build: &BuildOptions,
) -> Result<Throughput> {
    ensure!(
        (1..=config.rays_per_packet).contains(&active_rays),
        "{active_rays} active rays in packets of {} are not possible",
        config.rays_per_packet
    );
    let options = UnitOptions {
        build: build.clone(),
        ..UnitOptions::new(seed)
    };
    let mut run = Run::new(config, Counted::Tests, &options)?;
    run.reset()?;
    let mut batch = tiny_scene(
        config,
        config.packets_in_flight as usize,
        TinyTree::Any,
        &mut run.rng,
    )?;
    // Only valid rays reach a leaf.
    for ray in batch.packets.iter_mut().flatten() {
        if !RaySetup::new(&run.arithmetic, ray).valid {
            *ray = Ray {
                direction: [1.0, 0.5, 0.25],
                tmax: f64::INFINITY,
                active: true,
                ..Ray::INACTIVE
            };
        }
    }
    let contents = Contents::new(&batch.scene);
    let all: Vec<u8> = (0..=u8::MAX)
        .filter(|mask| u32::from(*mask) >> config.rays_per_packet == 0)
        .filter(|mask| mask.count_ones() == active_rays)
        .collect();
    let records = contents.triangles.len() as u32;
    let packets = batch.packets.iter().map(|rays| {
        let leaf = |rng: &mut fastrand::Rng| HandOver {
            record: rng.u32(..records),
            instance: false,
            mask: all[rng.usize(..all.len())],
        };
        let leaves = (0..LEAVES_FOR_THROUGHPUT).map(|_| leaf(&mut run.rng));
        (rays.clone(), leaves.collect())
    });
    let packets: Vec<_> = packets.collect();
    run.batch(&contents, packets, &Surroundings::steady(8))?;
    let tests = run.bench.tally.transactions;
    ensure!(tests > 0, "no test was made");
    Ok(Throughput {
        active_rays,
        tests,
        clocks: run.tested.end - run.tested.start,
    })
}

struct Run<'a> {
    config: &'a Config,
    counted: Counted,
    /// Whether the batch's scene has two levels.
    instanced: bool,
    format: Format,
    arithmetic: Arithmetic,
    test: TriangleTest,
    /// Number of cycles between naming a packet and writing its ray.
    read_latency: usize,
    bench: Bench,
    ports: Ports,
    context: Context<Spec>,
    plan: Plan,
    /// By packet number in flight.
    packets: Vec<Option<Packet>>,
    free: Vec<usize>,
    started: u64,
    /// The cycle of the first test, and the cycle after the last one.
    tested: Range<u64>,
    rng: fastrand::Rng,
}

impl<'a> Run<'a> {
    fn new(config: &'a Config, counted: Counted, options: &UnitOptions) -> Result<Run<'a>> {
        let plan = Plan::new(config)?.with_trace(true);
        let name = match counted {
            Counted::Tests => "geometry",
            Counted::Transforms => "transform",
        };
        let bench = Bench::new(name, &geometry::module(&plan)?.module, options)?;
        let ports = bench.model.ports(&geometry::ports(&plan))?;
        let format = config.format();
        Ok(Run {
            config,
            counted,
            instanced: false,
            read_latency: plan.read_latency() as usize,
            format,
            arithmetic: Arithmetic::new(format),
            test: config.triangle_test,
            bench,
            ports,
            context: Context::of(&plan),
            packets: (0..plan.packets()).map(|_| None).collect(),
            free: (0..plan.packets() as usize).rev().collect(),
            plan,
            started: 0,
            tested: 0..0,
            rng: fastrand::Rng::with_seed(options.seed),
        })
    }

    /// Resets the unit and waits for the initialisation of all packets. No earlier result may appear.
    fn reset(&mut self) -> Result<()> {
        self.bench.model.reset(RESET_CYCLES);
        self.bench.model.set(self.ports.inputs.sweep, 1);
        for packet in 0..self.packets.len() {
            let model = &mut self.bench.model;
            model.set(self.ports.inputs.sweep_packet, packet as u64);
            model.eval();
            self.check_test()?;
            self.check_transform()?;
            self.bench.model.clock();
        }
        self.bench.model.set(self.ports.inputs.sweep, 0);
        Ok(())
    }

    fn all(&mut self, workload: Workload<'_>, options: &UnitOptions) -> Result<()> {
        self.reset()?;
        let mut batches = Batches::new(self.config, workload, options.seed)?;
        // Even the smallest run has scenes with special values.
        let mut until_poison = self.rng.u8(..4);
        while let Some(batch) = batches.next(self.bench.tally.transactions)? {
            let around = match options.surroundings {
                Some(around) => around,
                None => Surroundings::random(&mut self.rng),
            };
            let mut contents = Contents::new(&batch.scene);
            if batch.is_random {
                if until_poison == 0 {
                    contents.poison(self.format, &mut self.rng);
                }
                until_poison = (until_poison + 3) % 4;
            }
            let packets = self.scripts(&batch, &contents);
            self.batch(&contents, packets, &around)?;
        }
        Ok(())
    }

    /// The rays and leaves of each packet. Packets without a leaf are left out.
    fn scripts(&mut self, batch: &Batch, contents: &Contents) -> Vec<(Vec<Ray>, Vec<HandOver>)> {
        struct Leaves(Vec<HandOver>);
        impl Observer for Leaves {
            fn hand_over(&mut self, event: &HandOver) {
                self.0.push(*event);
            }
        }
        let (triangles, instances) = (contents.records_of(false), contents.records_of(true));
        let script = |rays: &Vec<Ray>| {
            let mut leaves = Leaves(vec![]);
            if batch.is_random {
                // Only valid rays reach a leaf.
                let valid = rays
                    .iter()
                    .map(|ray| RaySetup::new(&self.arithmetic, ray).valid);
                let all = (0..)
                    .zip(valid)
                    .fold(0u8, |mask, (slot, valid)| mask | u8::from(valid) << slot);
                if all == 0 {
                    return (rays.clone(), vec![]);
                }
                // In two levels, only the rays of an instance are in its object space.
                let mut come = all;
                for _ in 0..self.rng.usize(1..=12) {
                    let first = leaves.0.is_empty();
                    let instance = !instances.is_empty() && (first || self.rng.u8(..3) == 0);
                    let records = if instance { &instances } else { &triangles };
                    let among = if instance { all } else { come };
                    let mask = loop {
                        let mask = self.rng.u8(1..) & among;
                        if mask != 0 {
                            break mask;
                        }
                    };
                    if instance {
                        come = mask;
                    }
                    leaves.0.push(HandOver {
                        record: records[self.rng.usize(..records.len())],
                        instance,
                        mask,
                    });
                }
            } else {
                batch.scene.caster.cast(rays, &mut leaves);
            }
            (rays.clone(), leaves.0)
        };
        let scripts = batch.packets.iter().map(script);
        scripts.filter(|(_, leaves)| !leaves.is_empty()).collect()
    }

    /// Runs packets with a scene's contents until all are read back.
    fn batch(
        &mut self,
        contents: &Contents,
        packets: Vec<(Vec<Ray>, Vec<HandOver>)>,
        around: &Surroundings,
    ) -> Result<()> {
        self.instanced = contents.is_instanced();
        let model = &mut self.bench.model;
        let Ports { inputs, outputs } = self.ports;
        let records = ReadPort::of_unit(outputs.record, inputs.record);
        let (image, timing) = (contents.records.clone(), around.port(1));
        let mut records = MemoryPort::new(model, "record", records, image, timing)?;
        let vertices = ReadPort::of_unit(outputs.vertex, inputs.vertex);
        let (image, timing) = (contents.vertices.clone(), around.port(2));
        let mut vertices = MemoryPort::new(model, "vertex", vertices, image, timing)?;
        model.set(inputs.instanced, self.instanced.into());
        let mut waiting = packets.into_iter();
        let all = self.packets.len();
        let mut queues = Queues {
            announced: (0..self.read_latency).map(|_| None).collect(),
            ..Queues::default()
        };
        let mut idle = 0;
        loop {
            if queues.arriving.is_empty() && !self.free.is_empty() {
                match waiting.next() {
                    Some((rays, leaves)) => self.arrive(&rays, leaves, &mut queues.arriving),
                    None if self.free.len() == all => break,
                    None => {}
                }
            }
            let written = self.write_ray(&mut queues, around);
            self.offer_leaf(&mut queues, around);
            let reads = self.ask_for_hit(&queues, around);
            let model = &mut self.bench.model;
            records.show(model);
            vertices.show(model);

            // The outputs of the unit for this edge.
            model.eval();
            let mut progress = self.watch(contents, written, &mut queues)?;
            records.take(&self.bench.model)?;
            vertices.take(&self.bench.model)?;
            self.bench.model.clock();

            if let Some(id) = reads {
                progress = true;
                if self.read_back(id)? {
                    queues.finished.pop_front();
                }
            }
            idle = if progress { 0 } else { idle + 1 };
            if idle > around.patience() {
                return Err(self.stuck(idle));
            }
        }
        Ok(())
    }

    /// Writes the ray, if any, whose packet was named early enough, and names the packet of the next one. At most one ray is written per cycle.
    fn write_ray(&mut self, queues: &mut Queues, around: &Surroundings) -> Option<Writing> {
        let next = match self.pauses(around) {
            true => None,
            false => queues.arriving.pop_front(),
        };
        let (inputs, model) = (&self.ports.inputs, &mut self.bench.model);
        if let Some(writing) = &next {
            model.set(inputs.setup_next_packet, writing.place.packet as u64);
        }
        queues.announced.push_back(next);
        let written = queues.announced.pop_front().flatten();
        if let Some(world) = &inputs.world {
            let of_world = written.as_ref().filter(|w| !w.place.object);
            model.set(world.valid, of_world.is_some().into());
            if let Some(&Writing {
                place, direction, ..
            }) = of_world
            {
                let (packet, ray) = (place.packet as u64, place.ray as u64);
                let values = World {
                    packet,
                    ray,
                    direction,
                };
                model.drive(&world.payload, values);
            }
        }
        model.set(inputs.setup.valid, written.is_some().into());
        match &written {
            Some(writing) => {
                model.drive(&inputs.setup.payload, writing.values);
                if let Some(port) = inputs.setup_shear_z {
                    model.set(port, writing.shear_z);
                }
            }
            // The other inputs have no meaning and may have any value.
            None => {
                let fields = inputs.setup.payload.leaves().into_iter();
                model.garble(fields.chain(inputs.setup_shear_z), &mut self.rng);
            }
        }
        written
    }

    /// Offers a leaf, which then stays until it is accepted.
    fn offer_leaf(&mut self, queues: &mut Queues, around: &Surroundings) {
        if queues.offered.is_none() && !queues.ready.is_empty() && !self.pauses(around) {
            let id = queues
                .ready
                .swap_remove(self.rng.usize(..queues.ready.len()));
            self.offer(id, self.instanced);
            queues.offered = Some(id);
        }
        let (leaf, model) = (&self.ports.inputs.leaf, &mut self.bench.model);
        model.set(leaf.valid, queues.offered.is_some().into());
        if queues.offered.is_none() {
            model.garble(leaf.payload.leaves(), &mut self.rng);
        }
    }

    /// Requests the next closest hit; returns its packet. At most one is read per cycle.
    fn ask_for_hit(&mut self, queues: &Queues, around: &Surroundings) -> Option<usize> {
        let id = *queues.finished.front()?;
        if self.pauses(around) {
            return None;
        }
        let packet = self.packets[id].as_ref().expect("it is to be read back");
        let (inputs, model) = (&self.ports.inputs, &mut self.bench.model);
        model.set(inputs.read_packet, id as u64);
        model.set(inputs.read_ray, packet.read as u64);
        Some(id)
    }

    /// Checks the outputs before a clock edge; returns whether there was an event.
    fn watch(
        &mut self,
        contents: &Contents,
        written: Option<Writing>,
        queues: &mut Queues,
    ) -> Result<bool> {
        let mut progress = written.is_some();
        if let Some(place) = written.map(|writing| writing.place) {
            self.check_start(contents, place)?;
            if place.last {
                self.goes_on(place.packet, queues);
            }
        }
        if let Some(id) = queues.offered {
            if self.bench.model.get(self.ports.outputs.leaf_ready) != 0 {
                self.expect(contents, id);
                queues.offered = None;
                progress = true;
            }
        }
        if let Some((id, is_done)) = self.check_test()? {
            progress = true;
            if is_done {
                self.goes_on(id, queues);
            }
        }
        if let Some((id, is_done)) = self.check_transform()? {
            progress = true;
            if is_done {
                self.set_up_object(id, &mut queues.arriving);
            }
        }
        Ok(progress)
    }

    /// Advances a packet to its next leaf or, after the last one, to reading back.
    fn goes_on(&self, id: usize, queues: &mut Queues) {
        let packet = self.packets[id].as_ref().expect("it is in flight");
        match packet.next_leaf < packet.leaves.len() {
            true => queues.ready.push(id),
            false => queues.finished.push_back(id),
        }
    }

    fn pauses(&mut self, around: &Surroundings) -> bool {
        around.pauses > 0.0 && self.rng.f64() < around.pauses
    }

    /// Chooses a packet's number in flight, and queues its rays for writing.
    fn arrive(&mut self, rays: &[Ray], leaves: Vec<HandOver>, arriving: &mut VecDeque<Writing>) {
        let id = self.free.swap_remove(self.rng.usize(..self.free.len()));
        let mut tested = vec![];
        for (slot, ray) in rays.iter().enumerate() {
            let setup = RaySetup::new(&self.arithmetic, ray);
            let set_up = RaySetUp {
                ray: setup,
                interval: [setup.tmin, setup.tmax],
                enters: setup.valid,
            };
            let place = SetupPlace::of_world(id, slot, rays.len());
            arriving.push_back(Writing {
                direction: ray.direction.map(|x| self.format.to_bits(x)),
                ..self.writing(place, &set_up)
            });
            let numbers = ray.origin.iter().chain(&ray.direction);
            let some = |holds: fn(f64) -> bool| numbers.clone().any(|x| holds(*x));
            tested.push(TestRay {
                setup,
                object: None,
                closest: Closest::default(),
                nan: some(f64::is_nan) || ray.tmin.is_nan() || ray.tmax.is_nan(),
                infinite: some(f64::is_infinite),
                negative_zero: some(is_negative_zero),
            });
        }
        self.packets[id] = Some(Packet {
            number: self.started,
            rays: tested,
            leaves,
            next_leaf: 0,
            tests: VecDeque::new(),
            transforms: VecDeque::new(),
            instance: 0,
            level: 0,
            touched: 0,
            read: 0,
        });
        self.started += 1;
    }

    fn writing(&self, place: SetupPlace, ray: &RaySetUp) -> Writing {
        Writing {
            place,
            values: ray.for_tests(&self.plan, place),
            shear_z: self.format.to_bits(ray.ray.shear.scale[2]),
            direction: [0; 3],
        }
    }

    /// Sets up the rays that the unit has transformed. All of them are written, whether they enter or not.
    fn set_up_object(&self, id: usize, arriving: &mut VecDeque<Writing>) {
        let packet = self.packets[id].as_ref().expect("its rays are transformed");
        let mask = packet.leaves[packet.next_leaf - 1].mask;
        for (slot, ray) in packet.rays.iter().enumerate() {
            if mask >> slot & 1 == 0 {
                continue;
            }
            let object = ray.object.as_ref().expect("it was transformed");
            let set_up = RaySetUp {
                // Ray setup receives the interval as limits. The unit must keep the limits of the world.
                ray: RaySetup {
                    tmin: object.near,
                    tmax: object.far,
                    ..object.ray
                },
                interval: [object.near, object.far],
                enters: object.enters,
            };
            let place = SetupPlace {
                packet: id,
                ray: slot,
                first: mask & ((1 << slot) - 1) == 0,
                last: mask >> slot == 1,
                object: true,
            };
            arriving.push_back(self.writing(place, &set_up));
        }
    }

    /// With the last ray of an object, compares the root at which its packet starts.
    fn check_start(&mut self, contents: &Contents, place: SetupPlace) -> Result<()> {
        if !place.object || !place.last {
            return Ok(());
        }
        let packet = self.packets[place.packet]
            .as_ref()
            .expect("its rays are being written");
        let record = packet.leaves[packet.next_leaf - 1].record;
        let instance = contents.instances[record as usize]
            .as_ref()
            .expect("it is an instance");
        let (address, is_leaf) = match instance.root {
            Target::Node(index) => (index, 0),
            Target::Record(index) => (index, 1),
        };
        let start = self.bench.model.sample(&self.ports.outputs.start);
        let context = self.context(packet, 1);
        let fields = [
            ("root's index", u64::from(address), start.address),
            ("root is a leaf", is_leaf, start.leaf),
            ("context", context, start.context),
        ];
        if fields.iter().any(|(_, golden, rtl)| golden != rtl) {
            let fields = fields.map(|(name, golden, rtl)| Field::integer(name, golden, rtl));
            let place = format!(
                "start of packet {} ({} in flight) in the object of instance record {record}",
                packet.number, place.packet
            );
            return Err(self.bench.mismatch(place, fields.into()));
        }
        self.bench.tally.checked += 1;
        Ok(())
    }

    /// A packet's context in the form of the traversal unit.
    fn context(&self, packet: &Packet, inside: u64) -> u64 {
        self.context.encode(Context {
            level: packet.level,
            touched: packet.touched,
            inside,
        })
    }

    /// Drives a packet's next leaf.
    fn offer(&mut self, id: usize, instanced: bool) {
        let packet = self.packets[id]
            .as_mut()
            .expect("it has a leaf to hand over");
        // The unit passes the level on, so it may have any value.
        packet.level = match self.rng.u8(..8) {
            0 => u64::from(self.config.stack_depth),
            _ => self.rng.u64(..=u64::from(self.config.stack_depth)),
        };
        let leaf = packet.leaf();
        let packet = self.packets[id].as_ref().expect("it was there just now");
        let context = self.context(packet, u64::from(instanced && !leaf.instance));
        let shown = Leaf {
            packet: id as u64,
            address: leaf.record.into(),
            context,
            mask: leaf.mask.into(),
        };
        (self.bench.model).drive(&self.ports.inputs.leaf.payload, shown);
    }

    /// Computes the expected results of an accepted leaf with the golden model.
    fn expect(&mut self, contents: &Contents, id: usize) {
        let packet = self.packets[id].as_mut().expect("its leaf is taken");
        let leaf = packet.leaf();
        let full = packet.level == u64::from(self.config.stack_depth);
        let counts_transforms = self.counted == Counted::Transforms;
        if let Some(instance) = &contents.instances[leaf.record as usize] {
            packet.instance = instance.number;
            let mut some_enters = false;
            for (slot, ray) in packet.rays.iter_mut().enumerate() {
                if leaf.mask >> slot & 1 == 0 {
                    continue;
                }
                let transformed = instance.transform(&self.arithmetic, &ray.setup);
                ray.object = Some(transformed);
                some_enters |= transformed.enters;
                packet.transforms.push_back(EnterEvent {
                    slot: slot as u8,
                    record: leaf.record,
                    instance: instance.number,
                    transformed,
                });
                if counts_transforms {
                    let categories = &mut self.bench.tally.categories;
                    for (category, holds) in transform_categories(instance, ray, &transformed) {
                        categories.count(category, holds);
                    }
                    let leaf_root = matches!(instance.root, Target::Record(_));
                    categories.count(Category::LeafRoot, leaf_root);
                    categories.count(Category::DeepestStack, full);
                }
            }
            if counts_transforms {
                let categories = &mut self.bench.tally.categories;
                categories.count(Category::NothingEntered, !some_enters);
            }
            return;
        }
        let triangle = &contents.triangles[leaf.record as usize];
        let marks = &contents.marks[leaf.record as usize];
        let flat = (0..3).any(|i| marks.lo[i] == marks.hi[i]) && !triangle.degenerate;
        let categories = &mut self.bench.tally.categories;
        for (slot, ray) in packet.rays.iter_mut().enumerate() {
            if leaf.mask >> slot & 1 == 0 {
                continue;
            }
            let (setup, window) = match (&ray.object, self.instanced) {
                (Some(object), true) => (&object.ray, object.window),
                _ => (&ray.setup, WHOLE_LINE),
            };
            let outcome = triangle.intersect::<true>(&self.arithmetic, self.test, setup, window);
            let before = ray.closest;
            let instance = packet.instance;
            ray.closest
                .merge(setup, &outcome, instance, triangle.number);
            let after = ray.closest;
            let identity = |closest: &Closest| (closest.hit.instance, closest.hit.triangle);
            let nearer = after.hit.t != before.hit.t || identity(&after) != identity(&before);
            let replaces = outcome.hit && (setup.any_hit || nearer);
            packet.touched |= u64::from(replaces) << slot;
            packet.tests.push_back(Expected {
                ray: slot,
                outcome,
                replaces,
                limit: after.limit,
            });

            if counts_transforms {
                continue;
            }
            let [t, u, v] = outcome.raw;
            let hits = outcome.hit;
            let in_plane = (0..3).any(|i| {
                setup.reciprocal[i].is_infinite()
                    && [marks.lo[i], marks.hi[i]].contains(&setup.origin[i])
            });
            let limited = setup.tmin > 0.0 || setup.tmax < f64::INFINITY;
            let as_far = hits && !setup.any_hit && outcome.t == before.hit.t;
            let on_edge = hits && (u == 0.0 || v == 0.0 || u + v == 1.0);
            for (category, holds) in [
                (Category::Nan, ray.nan || marks.nan),
                (Category::Infinity, ray.infinite || marks.infinite),
                (
                    Category::SignedZero,
                    ray.negative_zero || marks.negative_zero,
                ),
                (Category::FlatBox, flat),
                (Category::Degenerate, triangle.degenerate),
                (Category::RayInPlane, in_plane),
                (Category::Hit, hits),
                (Category::EqualDistances, as_far),
                (Category::Clamped, hits && outcome.t != t),
                (Category::OnEdge, on_edge),
                (Category::AnyHit, setup.any_hit),
                (Category::FiniteLimits, limited),
                (Category::DeepestStack, full),
            ] {
                categories.count(category, holds);
            }
        }
    }

    /// Compares the test at the outputs, if any; returns its packet, and whether its leaf is finished.
    fn check_test(&mut self) -> Result<Option<(usize, bool)>> {
        let (ports, model) = (&self.ports.outputs, &self.bench.model);
        let (limit, done) = (model.sample(&ports.limit), model.sample(&ports.done));
        let trace = ports.trace_test.as_ref().expect(TRACED);
        if model.get(trace.valid) == 0 {
            let strays = [("a limit", limit.valid), ("a leaf done", done.valid)];
            return match strays.into_iter().find(|(_, valid)| *valid != 0) {
                Some((what, _)) => Err(self
                    .bench
                    .mismatch(format!("{what} without a test"), vec![])),
                None => Ok(None),
            };
        }
        let test = model.sample(&trace.payload);
        let id = test.packet as usize;
        let golden = self
            .packets
            .get_mut(id)
            .and_then(Option::as_mut)
            .and_then(|packet| Some((packet.tests.pop_front()?, packet)));
        let Some((expected, packet)) = golden else {
            let place = format!(
                "a ray-triangle test of packet {id} in flight, which has no leaf in the unit"
            );
            return Err(self.bench.mismatch(place, vec![]));
        };
        let is_done = packet.tests.is_empty();
        let leaf = packet.leaf();
        let (id_bits, ray, bits) = (id as u64, expected.ray as u64, |x| self.format.to_bits(x));
        let replaces = u64::from(expected.replaces);
        let [t, u, v] = test_numbers(&test, self.format, &expected.outcome);
        let golden_test = TestTrace {
            packet: id_bits,
            ray,
            record: leaf.record.into(),
            instance: packet.instance.into(),
            hit: expected.outcome.hit.into(),
            replaces,
            t,
            u,
            v,
        };
        // Without valid, the other outputs have no meaning.
        let golden_limit = match expected.replaces {
            true => Limit {
                packet: id_bits,
                ray,
                value: bits(expected.limit),
            },
            false => limit.payload,
        };
        let golden_done = match is_done {
            true => InContext {
                packet: id_bits,
                context: self.context.encode(Context {
                    level: packet.level,
                    touched: packet.touched,
                    inside: self.instanced.into(),
                }),
            },
            false => done.payload,
        };
        let limits = limit == Flow::new(replaces, golden_limit);
        if test != golden_test || !limits || done != Flow::new(is_done.into(), golden_done) {
            let mut fields = compare_test(&test, self.format, &golden_test);
            let (format, value) = (self.format, golden_limit.value);
            let (limited, ended) = (limit.payload, done.payload);
            fields.extend([
                Field::integer("limit given", replaces, limit.valid),
                Field::integer("limit's packet", golden_limit.packet, limited.packet),
                Field::integer("limit's ray", golden_limit.ray, limited.ray),
                Field::number("limit", format, value, limited.value),
                Field::integer("leaf done", is_done.into(), done.valid),
                Field::integer("packet done", golden_done.packet, ended.packet),
                Field::integer("its context", golden_done.context, ended.context),
            ]);
            let place = format!(
                "ray-triangle test of ray {ray} of packet {} ({id} in flight) with record {}, its leaf {}",
                packet.number, leaf.record, packet.next_leaf
            );
            return Err(self.bench.mismatch(place, fields));
        }
        if is_done {
            packet.next_leaf += 1;
        }
        let now = self.bench.model.cycles();
        if self.tested.end == 0 {
            self.tested.start = now;
        }
        self.tested.end = now + 1;
        let tally = &mut self.bench.tally;
        tally.transactions += u64::from(self.counted == Counted::Tests);
        tally.checked += 1 + u64::from(is_done);
        Ok(Some((id, is_done)))
    }

    /// Compares the transformed ray at the outputs, if any; returns its packet, and whether its instance is finished.
    fn check_transform(&mut self) -> Result<Option<(usize, bool)>> {
        let (ports, model) = (&self.ports.outputs, &self.bench.model);
        let valid = model.get(ports.object.valid);
        let trace = ports.trace_transform.as_ref().expect(TRACED);
        if model.get(trace.valid) == 0 {
            return match valid {
                0 => Ok(None),
                _ => Err(self
                    .bench
                    .mismatch("a ray for ray setup without a transformation", vec![])),
            };
        }
        let shown = model.sample(&trace.payload);
        let id = shown.packet as usize;
        let golden = self
            .packets
            .get_mut(id)
            .and_then(Option::as_mut)
            .and_then(|packet| Some((packet.transforms.pop_front()?, packet)));
        let Some((expected, packet)) = golden else {
            let place = format!(
                "a transformed ray of packet {id} in flight, which has no instance in the unit"
            );
            return Err(self.bench.mismatch(place, vec![]));
        };
        let is_done = packet.transforms.is_empty();
        let mask = packet.leaf().mask;
        let is_first = mask.trailing_zeros() == u32::from(expected.slot);
        let transformed = &expected.transformed;
        let mut fields = compare_transform(&shown, self.format, &expected);
        let bits = |x: f64| self.format.to_bits(x);
        let given = [
            id as u64,
            expected.slot.into(),
            is_first.into(),
            is_done.into(),
            bits(transformed.near),
            bits(transformed.far),
        ];
        let object = model.sample(&ports.object.payload);
        let rtl = [
            object.place.packet,
            object.place.ray,
            object.place.first,
            object.place.last,
            object.limits.tmin,
            object.limits.tmax,
        ];
        if !fields.is_empty() || valid != 1 || rtl != given {
            fields.push(Field::integer("given to ray setup", 1, valid));
            let names = ["packet", "ray", "first", "last"];
            for ((name, golden), rtl) in names.into_iter().zip(given).zip(rtl) {
                fields.push(Field::integer(name, golden, rtl));
            }
            for (name, k) in [("tmin", 4), ("tmax", 5)] {
                fields.push(Field::number(name, self.format, given[k], rtl[k]));
            }
            let place = format!(
                "ray {} of packet {} ({id} in flight) taken to instance record {}, its leaf {}",
                expected.slot, packet.number, expected.record, packet.next_leaf
            );
            return Err(self.bench.mismatch(place, fields));
        }
        if is_done {
            packet.next_leaf += 1;
        }
        let tally = &mut self.bench.tally;
        tally.transactions += u64::from(self.counted == Counted::Transforms);
        tally.checked += 1;
        Ok(Some((id, is_done)))
    }

    /// Compares the requested closest hit; returns whether it was the packet's last.
    fn read_back(&mut self, id: usize) -> Result<bool> {
        let shown = self.bench.model.sample(&self.ports.outputs.read);
        let packet = self.packets[id].as_mut().expect("it is being read back");
        let slot = packet.read;
        packet.read += 1;
        // A hit that was never written is undefined, but its bit in the hit mask is 0.
        if packet.touched >> slot & 1 != 0 {
            let hit = packet.rays[slot].closest.hit;
            let golden = [hit.t, hit.u, hit.v].map(|x| self.format.to_bits(x));
            let rtl = [shown.t, shown.u, shown.v];
            let identity = [shown.instance, shown.triangle];
            let golden_identity = [hit.instance, hit.triangle].map(u64::from);
            if golden != rtl || golden_identity != identity {
                let mut fields: Vec<_> = ["t", "u", "v"]
                    .into_iter()
                    .zip(golden)
                    .zip(rtl)
                    .map(|((name, golden), rtl)| Field::number(name, self.format, golden, rtl))
                    .collect();
                for (k, name) in ["instance", "triangle"].into_iter().enumerate() {
                    fields.push(Field::integer(name, golden_identity[k], identity[k]));
                }
                let place = format!(
                    "closest hit of ray {slot} of packet {} ({id} in flight), read back",
                    packet.number
                );
                return Err(self.bench.mismatch(place, fields));
            }
            self.bench.tally.checked += 1;
        }
        let is_last = packet.read == packet.rays.len();
        if is_last {
            self.packets[id] = None;
            self.free.push(id);
            self.bench.tally.packets += 1;
        }
        Ok(is_last)
    }

    #[cold]
    fn stuck(&self, clocks: u64) -> anyhow::Error {
        let mut place = format!("nothing has happened for {clocks} clocks");
        for (id, packet) in self.packets.iter().enumerate() {
            let Some(packet) = packet else { continue };
            if let Some(transform) = packet.transforms.front() {
                let (slot, record) = (transform.slot, transform.record);
                place += &format!(
                    "; packet {} ({id} in flight) waits for ray {slot} to be taken to instance record {record}",
                    packet.number
                );
            }
            if let Some(test) = packet.tests.front() {
                let record = packet.leaf().record;
                place += &format!(
                    "; packet {} ({id} in flight) waits for the test of ray {} with record {record}",
                    packet.number, test.ray
                );
            }
        }
        self.bench.mismatch(place, vec![])
    }
}
