//! The geometry unit alone, held against the golden model test by test.
//!
//! What is around the unit is played here: ray setup writes rays that the golden model has set up, the traversal unit hands over
//! leaves, a packet's next one when the last is done, and triangle and vertex memory answer at any pace. When a packet has had all its leaves
//! its closest hits are read back.
//!
//! Every ray–triangle test is compared in all bits (ray, record, whether it hits and replaces the closest hit, t, u and v of a hit, the
//! limit), every leaf done (its context, with the rays that have hit something), every closest hit read back.

use super::memory::Image;
use super::mismatch::Field;
use super::model::{BuildOptions, PortHandle};
use super::raycast::MemoryPort;
use super::scoreboard::{
    Bench, Category, RaySetUp, SetupPlace, SetupPorts, Surroundings, UnitOptions, UnitReport,
};
use super::workload::{Batch, Batches, TestScene, Workload, odd_number, tiny_scene};
use crate::bkd::layout::Record;
use crate::config::{Config, TriangleTest};
use crate::float::{Arithmetic, Format};
use crate::golden::{Closest, HandOver, Observer, Outcome, RaySetup, Triangle, WHOLE_LINE};
use crate::hw::{Plan, geometry};
use crate::port::Ray;
use anyhow::{Result, ensure};
use std::collections::VecDeque;
use std::ops::Range;

/// What the unit can meet, in ray–triangle tests.
pub const CATEGORIES: &[Category] = &[
    // The ray or a vertex has a NaN, an infinity, a -0.
    Category::Nan,
    Category::Infinity,
    Category::SignedZero,
    // The triangle's box is flat on one axis; on two, or has two equal vertices; the ray lies in a plane of the box.
    Category::FlatBox,
    Category::Degenerate,
    Category::RayInPlane,
    Category::Hit,
    // The hit is as far as the closest one; is moved into the box; lies on an edge or a vertex.
    Category::EqualDistances,
    Category::Clamped,
    Category::OnEdge,
    Category::AnyHit,
    Category::FiniteLimits,
    // The leaf's packet has a full stack.
    Category::DeepestStack,
];

/// A triangle as the categories see it.
struct Marks {
    lo: [f64; 3],
    hi: [f64; 3],
    nan: bool,
    infinite: bool,
    negative_zero: bool,
}

/// What the unit's memories hold.
struct Contents {
    records: Image,
    vertices: Image,
    triangles: Vec<Triangle>,
    marks: Vec<Marks>,
}

impl Contents {
    fn new(scene: &TestScene) -> Contents {
        let mut contents = Contents {
            records: scene.records.clone(),
            vertices: scene.vertices.clone(),
            triangles: scene.triangles.clone(),
            marks: vec![],
        };
        contents.mark();
        contents
    }

    /// Puts infinities, NaNs and other odd numbers into some of the vertices. No scene has such; yet they must do no more harm
    /// than golden model and RTL agree on.
    fn poison(&mut self, format: Format, rng: &mut fastrand::Rng) {
        let (vertex, triangle) = (Record::vertex(format), Record::triangle());
        for row in 0..self.vertices.rows() {
            for axis in ["x", "y", "z"] {
                if rng.u8(..32) == 0 {
                    let bits = format.to_bits(odd_number(format, rng));
                    vertex.set(self.vertices.row_mut(row), axis, bits);
                }
            }
        }
        for (row, entry) in self.triangles.iter_mut().enumerate() {
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

/// What must come of one ray–triangle test.
struct Expected {
    ray: usize,
    outcome: Outcome,
    replaces: bool,
    limit: f64,
}

/// A ray of a packet, and its result so far.
struct TestRay {
    setup: RaySetup,
    closest: Closest,
    nan: bool,
    infinite: bool,
    negative_zero: bool,
}

/// A packet under way.
struct Packet {
    number: u64,
    rays: Vec<TestRay>,
    leaves: Vec<HandOver>,
    next_leaf: usize,
    /// Of the leaf that is with the unit, not empty while one is.
    tests: VecDeque<Expected>,
    level: u64,
    touched: u64,
    /// Rays read back so far.
    read: usize,
}

impl Packet {
    /// The leaf that is offered or with the unit.
    fn leaf(&self) -> HandOver {
        self.leaves[self.next_leaf]
    }
}

/// Rays that are being written.
struct Arriving {
    id: usize,
    words: Vec<Vec<u64>>,
    next: usize,
}

struct Ports {
    leaf_valid: PortHandle,
    leaf_ready: PortHandle,
    leaf_packet: PortHandle,
    leaf_address: PortHandle,
    leaf_context: PortHandle,
    leaf_mask: PortHandle,
    sweep: PortHandle,
    sweep_packet: PortHandle,
    limit_valid: PortHandle,
    limit_packet: PortHandle,
    limit_ray: PortHandle,
    limit_value: PortHandle,
    done_valid: PortHandle,
    done_packet: PortHandle,
    done_context: PortHandle,
    test_valid: PortHandle,
    test_packet: PortHandle,
    test_ray: PortHandle,
    test_record: PortHandle,
    test_hit: PortHandle,
    test_replaces: PortHandle,
    test_numbers: [PortHandle; 3],
    read_packet: PortHandle,
    read_ray: PortHandle,
    read_numbers: [PortHandle; 3],
    read_triangle: PortHandle,
}

impl Ports {
    fn new(bench: &Bench) -> Result<Ports> {
        let port = |name: &str| bench.model.port(name);
        Ok(Ports {
            leaf_valid: port("leaf_valid")?,
            leaf_ready: port("leaf_ready")?,
            leaf_packet: port("leaf_packet")?,
            leaf_address: port("leaf_address")?,
            leaf_context: port("leaf_context")?,
            leaf_mask: port("leaf_mask")?,
            sweep: port("sweep")?,
            sweep_packet: port("sweep_packet")?,
            limit_valid: port("limit_valid")?,
            limit_packet: port("limit_packet")?,
            limit_ray: port("limit_ray")?,
            limit_value: port("limit_value")?,
            done_valid: port("done_valid")?,
            done_packet: port("done_packet")?,
            done_context: port("done_context")?,
            test_valid: port("watch_test_valid")?,
            test_packet: port("watch_test_packet")?,
            test_ray: port("watch_test_ray")?,
            test_record: port("watch_test_record")?,
            test_hit: port("watch_test_hit")?,
            test_replaces: port("watch_test_replaces")?,
            test_numbers: [
                port("watch_test_t")?,
                port("watch_test_u")?,
                port("watch_test_v")?,
            ],
            read_packet: port("read_packet")?,
            read_ray: port("read_ray")?,
            read_numbers: [port("read_t")?, port("read_u")?, port("read_v")?],
            read_triangle: port("read_triangle")?,
        })
    }
}

/// Co-simulates the geometry unit of a machine. Of [`Workload::Rays`] it gets the leaves that the golden model's traversal hands
/// over; of tiny scenes any leaves, with any rays.
///
/// # Errors
/// A tool that is missing; a scene that the machine cannot hold. A mismatch is no error here: it is in the report.
pub fn run(config: &Config, workload: Workload<'_>, options: &UnitOptions) -> Result<UnitReport> {
    let mut run = Run::new(config, options)?;
    let ended = run.all(workload, options);
    run.bench.report(ended, CATEGORIES)
}

/// How fast the geometry unit is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Throughput {
    /// Rays of each leaf.
    pub active_rays: u32,
    /// Ray–triangle tests, all of them compared.
    pub tests: u64,
    /// Clocks from the first to the last of them.
    pub clocks: u64,
}

impl Throughput {
    /// Ray–triangle tests a clock.
    pub fn rate(&self) -> f64 {
        self.tests as f64 / self.clocks as f64
    }

    /// The share of what there could be: a test a clock, and a vertex a clock, three of which make a triangle.
    pub fn share_of_peak(&self) -> f64 {
        self.rate() / (f64::from(self.active_rays) / 3.0).min(1.0)
    }
}

/// Leaves of each packet when throughput is measured: enough that beginning and end do not count.
const LEAVES_FOR_THROUGHPUT: usize = 400;

/// Measures the geometry unit with leaves of `active_rays` rays each, memories that answer every clock after 8 clocks,
/// and nobody who pauses.
///
/// # Errors
/// A tool that is missing; a mismatch; more active rays than a packet has.
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
    let mut run = Run::new(config, &options)?;
    run.reset();
    let batch = tiny_scene(config, config.packets_in_flight as usize, &mut run.rng)?;
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
    format: Format,
    arithmetic: Arithmetic,
    test: TriangleTest,
    level_bits: u32,
    bench: Bench,
    ports: Ports,
    setup: SetupPorts,
    /// By packet number in flight.
    packets: Vec<Option<Packet>>,
    free: Vec<usize>,
    started: u64,
    /// The clocks of the first and behind the last test.
    tested: Range<u64>,
    rng: fastrand::Rng,
}

impl<'a> Run<'a> {
    fn new(config: &'a Config, options: &UnitOptions) -> Result<Run<'a>> {
        let plan = Plan::new(config)?;
        let bench = Bench::new("geometry", &geometry::module(&plan)?.module, options)?;
        let setup = SetupPorts::new(&bench)?;
        let ports = Ports::new(&bench)?;
        let format = config.format();
        Ok(Run {
            config,
            format,
            arithmetic: Arithmetic::new(format),
            test: config.triangle_test,
            level_bits: plan.level_bits(),
            bench,
            ports,
            setup,
            packets: (0..plan.packets()).map(|_| None).collect(),
            free: (0..plan.packets() as usize).rev().collect(),
            started: 0,
            tested: 0..0,
            rng: fastrand::Rng::with_seed(options.seed),
        })
    }

    /// Reset, and the sweep over all packets that must follow.
    fn reset(&mut self) {
        let model = &mut self.bench.model;
        model.reset(4);
        model.set(self.ports.sweep, 1);
        for packet in 0..self.packets.len() {
            model.set(self.ports.sweep_packet, packet as u64);
            model.clock();
        }
        model.set(self.ports.sweep, 0);
    }

    fn all(&mut self, workload: Workload<'_>, options: &UnitOptions) -> Result<()> {
        self.reset();
        let mut batches = Batches::new(self.config, workload, options.seed)?;
        while let Some(batch) = batches.next(self.bench.tally.transactions)? {
            let around = match options.surroundings {
                Some(around) => around,
                None => Surroundings::random(&mut self.rng),
            };
            let mut contents = Contents::new(&batch.scene);
            if batch.is_random && self.rng.u8(..4) == 0 {
                contents.poison(self.format, &mut self.rng);
            }
            let packets = self.scripts(&batch);
            self.batch(&contents, packets, &around)?;
        }
        Ok(())
    }

    /// Each packet's rays and leaves. Packets that come to no leaf are left out.
    fn scripts(&mut self, batch: &Batch) -> Vec<(Vec<Ray>, Vec<HandOver>)> {
        struct Leaves(Vec<HandOver>);
        impl Observer for Leaves {
            fn hand_over(&mut self, event: &HandOver) {
                self.0.push(*event);
            }
        }
        let all = ((1u32 << self.config.rays_per_packet) - 1) as u8;
        let records = batch.scene.triangles.len() as u32;
        let script = |rays: &Vec<Ray>| {
            let mut leaves = Leaves(vec![]);
            if batch.is_random {
                for _ in 0..self.rng.usize(1..=12) {
                    leaves.0.push(HandOver {
                        record: self.rng.u32(..records),
                        instance: false,
                        mask: self.rng.u8(1..=all),
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

    fn batch(
        &mut self,
        contents: &Contents,
        packets: Vec<(Vec<Ray>, Vec<HandOver>)>,
        around: &Surroundings,
    ) -> Result<()> {
        let model = &mut self.bench.model;
        let mut records =
            MemoryPort::new(model, "record", contents.records.clone(), around.port(1))?;
        let mut vertices =
            MemoryPort::new(model, "vertex", contents.vertices.clone(), around.port(2))?;
        let mut waiting = packets.into_iter();
        let all = self.packets.len();
        let mut arriving: Option<Arriving> = None;
        // Packets that have a leaf to hand over; the one whose leaf is offered; those to be read back.
        let mut ready: Vec<usize> = vec![];
        let mut offered: Option<usize> = None;
        let mut finished: VecDeque<usize> = VecDeque::new();
        let mut idle = 0;
        loop {
            if arriving.is_none() && !self.free.is_empty() {
                arriving = match waiting.next() {
                    Some((rays, leaves)) => Some(self.arrive(&rays, leaves)?),
                    None if self.free.len() == all => break,
                    None => None,
                };
            }
            // One ray a clock is written.
            let writes = arriving.is_some() && !self.pauses(around);
            match &mut arriving {
                Some(packet) if writes => {
                    let word = &packet.words[packet.next];
                    let model = &mut self.bench.model;
                    let place = SetupPlace::of_world(packet.id, packet.next, packet.words.len());
                    self.setup.show(model, place, word);
                    packet.next += 1;
                    if packet.next == packet.words.len() {
                        ready.push(packet.id);
                        arriving = None;
                    }
                }
                _ => self.setup.hide(&mut self.bench.model),
            }
            // A leaf once offered stays until it is taken.
            if offered.is_none() && !ready.is_empty() && !self.pauses(around) {
                let id = ready.swap_remove(self.rng.usize(..ready.len()));
                self.offer(id);
                offered = Some(id);
            }
            let ports = &self.ports;
            let model = &mut self.bench.model;
            model.set(ports.leaf_valid, offered.is_some().into());
            // One closest hit a clock is read.
            let reads = if !finished.is_empty() && !self.pauses(around) {
                finished.front().copied()
            } else {
                None
            };
            let model = &mut self.bench.model;
            let ports = &self.ports;
            if let Some(id) = reads {
                let packet = self.packets[id].as_ref().expect("it is to be read back");
                model.set(ports.read_packet, id as u64);
                model.set(ports.read_ray, packet.read as u64);
            }
            records.show(model);
            vertices.show(model);

            // What the unit shows for the edge.
            model.eval();
            let mut progress = writes;
            if let Some(id) = offered {
                if self.bench.model.get(self.ports.leaf_ready) != 0 {
                    self.expect(contents, id);
                    offered = None;
                    progress = true;
                }
            }
            if let Some((id, is_done)) = self.watch_test()? {
                progress = true;
                if is_done {
                    let packet = self.packets[id].as_ref().expect("it was there just now");
                    if packet.next_leaf < packet.leaves.len() {
                        ready.push(id);
                    } else {
                        finished.push_back(id);
                    }
                }
            }
            records.take(&self.bench.model)?;
            vertices.take(&self.bench.model)?;
            self.bench.model.clock();

            if let Some(id) = reads {
                progress = true;
                if self.read_back(id)? {
                    finished.pop_front();
                }
            }
            idle = if progress { 0 } else { idle + 1 };
            if idle > around.patience() {
                return Err(self.stuck(idle));
            }
        }
        Ok(())
    }

    fn pauses(&mut self, around: &Surroundings) -> bool {
        around.pauses > 0.0 && self.rng.f64() < around.pauses
    }

    /// Chooses a packet's number in flight.
    fn arrive(&mut self, rays: &[Ray], leaves: Vec<HandOver>) -> Result<Arriving> {
        let id = self.free.swap_remove(self.rng.usize(..self.free.len()));
        let mut words = vec![];
        let mut tested = vec![];
        for ray in rays {
            let setup = RaySetup::new(&self.arithmetic, ray);
            let set_up = RaySetUp {
                ray: setup,
                interval: [setup.tmin, setup.tmax],
                enters: setup.valid,
            };
            words.push(self.setup.word(self.format, &set_up)?);
            let numbers = ray.origin.iter().chain(&ray.direction);
            let some = |holds: fn(f64) -> bool| numbers.clone().any(|x| holds(*x));
            tested.push(TestRay {
                setup,
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
            level: 0,
            touched: 0,
            read: 0,
        });
        self.started += 1;
        Ok(Arriving { id, words, next: 0 })
    }

    /// Shows a packet's next leaf.
    fn offer(&mut self, id: usize) {
        let packet = self.packets[id]
            .as_mut()
            .expect("it has a leaf to hand over");
        // The unit passes the level on; it may be any.
        packet.level = match self.rng.u8(..8) {
            0 => u64::from(self.config.stack_depth),
            _ => self.rng.u64(..=u64::from(self.config.stack_depth)),
        };
        let leaf = packet.leaf();
        let (ports, model) = (&self.ports, &mut self.bench.model);
        model.set(ports.leaf_packet, id as u64);
        model.set(ports.leaf_address, leaf.record.into());
        model.set(ports.leaf_mask, leaf.mask.into());
        let context = packet.level | packet.touched << self.level_bits;
        model.set(ports.leaf_context, context);
    }

    /// Asks the golden model what must come of a leaf that the unit takes.
    fn expect(&mut self, contents: &Contents, id: usize) {
        let packet = self.packets[id].as_mut().expect("its leaf is taken");
        let leaf = packet.leaf();
        let triangle = &contents.triangles[leaf.record as usize];
        let marks = &contents.marks[leaf.record as usize];
        let flat = (0..3).any(|i| marks.lo[i] == marks.hi[i]) && !triangle.degenerate;
        let categories = &mut self.bench.tally.categories;
        for (slot, ray) in packet.rays.iter_mut().enumerate() {
            if leaf.mask >> slot & 1 == 0 {
                continue;
            }
            let setup = &ray.setup;
            let outcome =
                triangle.intersect::<true>(&self.arithmetic, self.test, setup, WHOLE_LINE);
            let before = ray.closest;
            ray.closest.merge(setup, &outcome, 0, triangle.number);
            let after = ray.closest;
            let nearer = after.hit.t != before.hit.t || after.hit.triangle != before.hit.triangle;
            let replaces = outcome.hit && (setup.any_hit || nearer);
            packet.touched |= u64::from(replaces) << slot;
            packet.tests.push_back(Expected {
                ray: slot,
                outcome,
                replaces,
                limit: after.limit,
            });

            let [t, u, v] = outcome.raw;
            let hits = outcome.hit;
            let in_plane = (0..3).any(|i| {
                setup.reciprocal[i].is_infinite()
                    && [marks.lo[i], marks.hi[i]].contains(&setup.origin[i])
            });
            let limited = setup.tmin > 0.0 || setup.tmax < f64::INFINITY;
            let as_far = hits && !setup.any_hit && outcome.t == before.hit.t;
            let on_edge = hits && (u == 0.0 || v == 0.0 || u + v == 1.0);
            let full = packet.level == u64::from(self.config.stack_depth);
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

    /// Compares the test that the unit shows, if any; returns its packet, and whether its leaf is done.
    fn watch_test(&mut self) -> Result<Option<(usize, bool)>> {
        let (ports, model) = (&self.ports, &self.bench.model);
        let get = |port| model.get(port);
        let strays = || {
            [
                ("a limit", ports.limit_valid),
                ("a leaf done", ports.done_valid),
            ]
            .into_iter()
            .find(|(_, valid)| get(*valid) != 0)
        };
        if get(ports.test_valid) == 0 {
            return match strays() {
                Some((what, _)) => Err(self
                    .bench
                    .mismatch(format!("{what} without a test"), vec![])),
                None => Ok(None),
            };
        }
        let id = get(ports.test_packet) as usize;
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
        let hits = expected.outcome.hit;
        let bits = |x: f64| self.format.to_bits(x);
        let numbers = [
            expected.outcome.t,
            expected.outcome.raw[1],
            expected.outcome.raw[2],
        ];
        let context = packet.level | packet.touched << self.level_bits;
        let agrees = get(ports.test_ray) == expected.ray as u64
            && get(ports.test_record) == u64::from(leaf.record)
            && get(ports.test_hit) == u64::from(hits)
            && get(ports.test_replaces) == u64::from(expected.replaces)
            && (!hits || ports.test_numbers.map(get) == numbers.map(bits))
            && get(ports.limit_valid) == u64::from(expected.replaces)
            && (!expected.replaces
                || get(ports.limit_packet) == id as u64
                    && get(ports.limit_ray) == expected.ray as u64
                    && get(ports.limit_value) == bits(expected.limit))
            && get(ports.done_valid) == u64::from(is_done)
            && (!is_done
                || get(ports.done_packet) == id as u64 && get(ports.done_context) == context);
        if !agrees {
            let packet = self.packets[id].as_ref().expect("it was there just now");
            return Err(self.test_mismatch(id, packet, &expected, context));
        }
        if is_done {
            packet.next_leaf += 1;
        }
        let now = self.bench.model.cycles();
        let tally = &mut self.bench.tally;
        if tally.transactions == 0 {
            self.tested.start = now;
        }
        self.tested.end = now + 1;
        tally.transactions += 1;
        tally.checked += 1 + u64::from(is_done);
        Ok(Some((id, is_done)))
    }

    #[cold]
    fn test_mismatch(
        &self,
        id: usize,
        packet: &Packet,
        expected: &Expected,
        context: u64,
    ) -> anyhow::Error {
        let (ports, model) = (&self.ports, &self.bench.model);
        let outcome = &expected.outcome;
        let number = |name: &str, golden: f64, port| {
            let golden = self.format.to_bits(golden);
            Field::number(name, self.format, golden, model.get(port))
        };
        let integer = |name: &str, golden: u64, port| Field::integer(name, golden, model.get(port));
        let record = packet.leaf().record;
        let replaces = u64::from(expected.replaces);
        let is_done = packet.tests.is_empty();
        let mut fields = vec![
            integer("ray of the packet", expected.ray as u64, ports.test_ray),
            integer("record", record.into(), ports.test_record),
            integer("hit", outcome.hit.into(), ports.test_hit),
        ];
        if outcome.hit {
            fields.push(number("t", outcome.t, ports.test_numbers[0]));
            fields.push(number("u", outcome.raw[1], ports.test_numbers[1]));
            fields.push(number("v", outcome.raw[2], ports.test_numbers[2]));
        }
        fields.push(integer(
            "replaces the closest",
            replaces,
            ports.test_replaces,
        ));
        fields.push(integer("limit given", replaces, ports.limit_valid));
        if expected.replaces {
            fields.push(integer("limit's packet", id as u64, ports.limit_packet));
            fields.push(integer("limit's ray", expected.ray as u64, ports.limit_ray));
            fields.push(number("limit", expected.limit, ports.limit_value));
        }
        fields.push(integer("leaf done", is_done.into(), ports.done_valid));
        if is_done {
            fields.push(integer("packet done", id as u64, ports.done_packet));
            fields.push(integer("its context", context, ports.done_context));
        }
        let place = format!(
            "ray-triangle test of ray {} of packet {} ({id} in flight) with record {record}, its leaf {}",
            expected.ray, packet.number, packet.next_leaf
        );
        self.bench.mismatch(place, fields)
    }

    /// Compares the closest hit that was asked for; returns whether it was the packet's last.
    fn read_back(&mut self, id: usize) -> Result<bool> {
        let (ports, model) = (&self.ports, &self.bench.model);
        let packet = self.packets[id].as_mut().expect("it is being read back");
        let slot = packet.read;
        packet.read += 1;
        // What was never written has no meaning: whoever reads it knows that the ray has hit nothing.
        if packet.touched >> slot & 1 != 0 {
            let hit = packet.rays[slot].closest.hit;
            let golden = [hit.t, hit.u, hit.v].map(|x| self.format.to_bits(x));
            let rtl = ports.read_numbers.map(|port| model.get(port));
            let triangle = model.get(ports.read_triangle);
            if golden != rtl || u64::from(hit.triangle) != triangle {
                let mut fields: Vec<_> = ["t", "u", "v"]
                    .into_iter()
                    .zip(golden)
                    .zip(rtl)
                    .map(|((name, golden), rtl)| Field::number(name, self.format, golden, rtl))
                    .collect();
                fields.push(Field::integer("triangle", hit.triangle.into(), triangle));
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
