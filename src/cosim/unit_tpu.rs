//! Co-simulation of the traversal unit: compares it with the golden model step by step.
//!
//! This module models the unit's neighbours. Ray setup supplies rays that the golden model has set up. Node memory responds
//! with any timing. The geometry unit accepts leaves and returns the results of the golden model's triangle tests: limits,
//! one per cycle, then the leaf's context with the hit mask. In a scene of two levels it also accepts
//! instances, and returns the rays that the golden model has transformed through ray setup, between rays of the world.
//!
//! Every packet step is compared in all bits (node, masks, intervals, order of the children), as are every dispatched leaf
//! (record, rays, stack level, hit mask), every finished packet, and at the end the
//! maximum height of the stack.

use super::TRACED;
use super::mismatch::Field;
use super::model::PortHandle;
use super::raycast::{MemoryPort, compare_step};
use super::scoreboard::{
    Bench, Categories, Category, RESET_CYCLES, RaySetUp, SetupPlace, Surroundings, UnitOptions,
    UnitReport,
};
use super::workload::{Batch, Batches, TestScene, Workload};
use crate::bkd::Target;
use crate::config::Config;
use crate::float::{Arithmetic, Format};
use crate::golden::raycast::StepEvent;
use crate::golden::{
    Closest, EnterEvent, HandOver, Observer, PopEvent, PushEvent, RaySetup, RayTest,
};
use crate::hdl::{self, Bundle, ReadPort, Spec, Specs};
use crate::hw::ray::{Context, InContext, Limit, Start};
use crate::hw::tpu::Finished;
use crate::hw::{Plan, tpu};
use crate::port::Ray;
use anyhow::Result;
use std::cmp::Reverse;
use std::collections::{BinaryHeap, VecDeque};
use std::rc::Rc;

/// The categories, of packet steps unless stated otherwise.
pub const CATEGORIES: &[Category] = &[
    // A ray of the packet has a NaN, an infinity or a -0; or does not exist.
    Category::Nan,
    Category::Infinity,
    Category::SignedZero,
    Category::InactiveRay,
    // A child's interval is flat; a ray is in one of the planes.
    Category::FlatBox,
    Category::RayInPlane,
    // A ray enters both children at the same distance.
    Category::EqualDistances,
    // A ray of the step is an any-hit ray, or has a limit.
    Category::AnyHit,
    Category::FiniteLimits,
    // Pushes that fill the stack; entries dropped because all their rays have closer hits.
    Category::DeepestStack,
    Category::DroppedEntry,
    // Leaves whose triangle is degenerate.
    Category::Degenerate,
    // Packets whose rays all miss the scene's box; packets that reach a triangle without a node.
    Category::NothingEntered,
    Category::LeafRoot,
];

/// Number of cycles after a reset in which no packet can have received its first node.
const NOTHING_PUSHED: u64 = 4;

/// The expected events of a packet, in order.
#[expect(clippy::large_enum_variant, reason = "most events are steps")]
enum Event {
    Step(StepEvent),
    Leaf {
        leaf: HandOver,
        level: u32,
        /// Rays whose closest hit changes in the leaf, and their limits.
        limits: Vec<(u8, f64)>,
        /// For an instance, its rays in object space.
        entries: Vec<EnterEvent>,
    },
}

/// The events of a packet, by the golden model.
struct Script<'a> {
    scene: &'a TestScene,
    rays: &'a [RaySetup],
    stack_depth: u32,
    events: Vec<Event>,
    level: u32,
    high_water: u32,
    closest: Vec<Closest>,
    categories: &'a mut Categories,
    /// Categories of the whole packet.
    has: [(Category, bool); 4],
}

impl Observer for Script<'_> {
    fn step(&mut self, event: &StepEvent) {
        let categories = &mut *self.categories;
        for (category, holds) in self.has {
            categories.count(category, holds);
        }
        let children = &self.scene.intervals[event.node as usize];
        let coming = |k: usize| event.rays.mask >> k & 1 != 0;
        let some_ray = |holds: &dyn Fn(usize, &RaySetup) -> bool| {
            let mut rays = self.rays.iter().enumerate();
            rays.any(|(k, ray)| coming(k) && holds(k, ray))
        };
        let flat = children.iter().any(|([lo, hi], _)| lo == hi);
        categories.count(Category::FlatBox, flat);
        let in_plane = some_ray(&|_, ray| {
            children.iter().any(|(interval, axis)| {
                ray.reciprocal[*axis].is_infinite() && interval.contains(&ray.origin[*axis])
            })
        });
        categories.count(Category::RayInPlane, in_plane);
        let both = event.left.mask & event.right.mask;
        let equal =
            some_ray(&|k, _| both >> k & 1 != 0 && event.left.near[k] == event.right.near[k]);
        categories.count(Category::EqualDistances, equal);
        categories.count(Category::AnyHit, some_ray(&|_, ray| ray.any_hit));
        let limited = some_ray(&|_, ray| ray.tmin > 0.0 || ray.tmax < f64::INFINITY);
        categories.count(Category::FiniteLimits, limited);
        self.events.push(Event::Step(*event));
    }

    fn push(&mut self, event: &PushEvent) {
        self.level = event.height;
        self.high_water = self.high_water.max(event.height);
        let full = event.height == self.stack_depth;
        self.categories.count(Category::DeepestStack, full);
    }

    fn pop(&mut self, event: &PopEvent) {
        self.level = event.height;
        let dropped = event.rays.mask == 0;
        self.categories.count(Category::DroppedEntry, dropped);
    }

    fn hand_over(&mut self, event: &HandOver) {
        let degenerate = !event.instance && self.scene.triangles[event.record as usize].degenerate;
        self.categories.count(Category::Degenerate, degenerate);
        self.events.push(Event::Leaf {
            leaf: *event,
            level: self.level,
            limits: vec![],
            entries: vec![],
        });
    }

    fn enter(&mut self, event: &EnterEvent) {
        if let Some(Event::Leaf { entries, .. }) = self.events.last_mut() {
            entries.push(*event);
        }
    }

    fn test(&mut self, event: &RayTest) {
        let before = &mut self.closest[usize::from(event.slot)];
        let merged = event.merged;
        let identity = |closest: &Closest| (closest.hit.instance, closest.hit.triangle);
        let replaced = event.outcome.hit
            && (before.limit != merged.limit || identity(before) != identity(&merged));
        *before = merged;
        if let (true, Some(Event::Leaf { limits, .. })) = (replaced, self.events.last_mut()) {
            limits.push((event.slot, merged.limit));
        }
    }
}

/// A packet in flight.
struct Packet {
    number: u64,
    events: Vec<Event>,
    next: usize,
    steps: usize,
    touched: u64,
    /// Whether its leaf is in the geometry unit.
    in_leaf: bool,
}

/// A ray that ray setup passes to the unit.
struct Arriving {
    place: SetupPlace,
    values: tpu::SetUp<u64>,
}

type Ports = hdl::Ports<tpu::Inputs<PortHandle>, tpu::Outputs<PortHandle>>;

/// Co-simulates the traversal unit of a machine.
///
/// # Errors
/// If a tool is missing, or if the machine cannot hold a scene. A mismatch is no error here; it is in the report.
pub fn run(config: &Config, workload: Workload<'_>, options: &UnitOptions) -> Result<UnitReport> {
    let plan = Plan::new(config)?.with_trace(true);
    let unit = tpu::module(&plan)?;
    let mut run = Run::new(config, &plan, &unit, options)?;
    let ended = run.all(workload, options);
    run.bench.report(ended, CATEGORIES)
}

struct Run<'a> {
    config: &'a Config,
    format: Format,
    arithmetic: Arithmetic,
    bench: Bench,
    ports: Ports,
    context: Context<Spec>,
    /// Whether the batch's scene has two levels.
    instanced: bool,
    /// By packet number in flight.
    packets: Vec<Option<Packet>>,
    free: Vec<usize>,
    /// Announced rays, one per cycle; the first one is shown for the next edge.
    announced: VecDeque<Option<Arriving>>,
    /// Rays in object space that have not been announced yet.
    entering: VecDeque<Arriving>,
    /// Leaves in the test, by the cycle in which it ends.
    tested: BinaryHeap<Reverse<(u64, usize)>>,
    /// The leaf whose limits are being returned, and the next limit.
    merging: Option<(usize, usize)>,
    /// Leaves to finish in later cycles.
    done: VecDeque<usize>,
    high_water: u32,
    /// The cycle after the reset.
    reset_at: u64,
    started: u64,
    rng: fastrand::Rng,
}

impl<'a> Run<'a> {
    fn new(
        config: &'a Config,
        plan: &Plan,
        unit: &tpu::Tpu,
        options: &UnitOptions,
    ) -> Result<Run<'a>> {
        let bench = Bench::new("tpu", &unit.module, options)?;
        let ports = bench.model.ports(&tpu::ports(plan))?;
        let format = config.format();
        Ok(Run {
            config,
            format,
            arithmetic: Arithmetic::new(format),
            bench,
            ports,
            context: Context::of(plan),
            instanced: false,
            packets: (0..plan.packets()).map(|_| None).collect(),
            free: (0..plan.packets() as usize).collect(),
            announced: std::iter::repeat_with(|| None)
                .take(unit.pop_latency as usize)
                .collect(),
            entering: VecDeque::new(),
            tested: BinaryHeap::new(),
            merging: None,
            done: VecDeque::new(),
            high_water: 0,
            reset_at: 0,
            started: 0,
            rng: fastrand::Rng::with_seed(options.seed),
        })
    }

    fn all(&mut self, workload: Workload<'_>, options: &UnitOptions) -> Result<()> {
        self.bench.model.reset(RESET_CYCLES);
        self.reset_at = self.bench.model.cycles();
        let mut batches = Batches::new(self.config, workload, options.seed)?;
        while let Some(batch) = batches.next(self.bench.tally.transactions)? {
            let around = match options.surroundings {
                Some(around) => around,
                None => Surroundings::random(&mut self.rng),
            };
            self.batch(&batch, &around)?;
        }
        self.stack_mark(self.high_water, "after all packets")
    }

    /// Compares the maximum height of the stack since the reset.
    fn stack_mark(&mut self, deepest: u32, when: &str) -> Result<()> {
        let (outputs, model) = (&self.ports.outputs, &self.bench.model);
        let [high_water, overflow] =
            [outputs.stack_high_water, outputs.stack_overflow].map(|port| model.get(port));
        if [high_water, overflow] != [deepest.into(), 0] {
            let fields = vec![
                Field::integer("stack high-water mark", deepest.into(), high_water),
                Field::integer("stack overflow", 0, overflow),
            ];
            return Err(self.bench.mismatch(when, fields));
        }
        self.bench.tally.checked += 1;
        Ok(())
    }

    fn batch(&mut self, batch: &Batch, around: &Surroundings) -> Result<()> {
        let scene = Rc::clone(&batch.scene);
        self.instanced = scene.root.right_leaf;
        let root = u64::from(scene.root.pack());
        self.bench.model.set(self.ports.inputs.root, root);
        let (inputs, outputs) = (self.ports.inputs, self.ports.outputs);
        let port = ReadPort::of_unit(outputs.node, inputs.node);
        let (model, nodes) = (&mut self.bench.model, scene.nodes.clone());
        let mut memory = MemoryPort::new(model, "node", port, nodes, around.port(1))?;
        let mut waiting = batch.packets.iter();
        // The rays of a packet that have not been announced yet.
        let mut arriving: VecDeque<Arriving> = VecDeque::new();
        let all = self.packets.len();
        let mut idle = 0;
        loop {
            // Ray setup: a ray is announced, and shown a fixed number of cycles later. Rays in object space have priority.
            if arriving.is_empty() && !self.free.is_empty() {
                match waiting.next() {
                    Some(rays) => self.arrive(&scene, rays, &mut arriving),
                    None if self.free.len() == all => break,
                    None => {}
                }
            }
            let next = match self.pauses(around) {
                true => None,
                false => self.entering.pop_front().or_else(|| arriving.pop_front()),
            };
            let model = &mut self.bench.model;
            model.set(inputs.setup_soon, next.is_some().into());
            self.announced.push_back(next);
            match self.announced.pop_front().flatten() {
                Some(ray) => self.show(&scene, &ray),
                None => {
                    // The other inputs have no meaning and may have any value.
                    model.set(inputs.setup.valid, 0);
                    let fields = inputs.setup.payload.leaves().into_iter();
                    model.garble(fields.chain([inputs.setup_object]), &mut self.rng);
                }
            }
            let model = &mut self.bench.model;
            memory.show(model);
            self.return_leaves(around);
            let takes_leaf = !self.pauses(around);
            let model = &mut self.bench.model;
            model.set(inputs.leaf_ready, takes_leaf.into());

            // The outputs of the unit for this edge.
            model.eval();
            let mut progress = self.check_step()?;
            progress |= self.check_finished()?;
            if takes_leaf && self.bench.model.get(outputs.leaf.valid) != 0 {
                self.take_leaf(around)?;
                progress = true;
            }
            memory.take(&self.bench.model)?;
            self.bench.model.clock();
            // Check now for remains of a reset, before packets reach a greater height.
            if self.bench.model.cycles() < self.reset_at + NOTHING_PUSHED {
                self.stack_mark(0, "after the reset")?;
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

    /// Shows a ray after setup; for the last ray of an object, also the root at which the packet starts.
    fn show(&mut self, scene: &TestScene, ray: &Arriving) {
        let model = &mut self.bench.model;
        let inputs = &self.ports.inputs;
        model.set(inputs.setup.valid, 1);
        model.set(inputs.setup_object, ray.place.object.into());
        model.drive(&inputs.setup.payload, ray.values);
        if !ray.place.object || !ray.place.last {
            return;
        }
        let packet = self.packets[ray.place.packet]
            .as_mut()
            .expect("its rays are transformed");
        packet.in_leaf = false;
        let Event::Leaf { leaf, level, .. } = &packet.events[packet.next - 1] else {
            unreachable!("the packet is at an instance");
        };
        let instance = scene.instances[leaf.record as usize]
            .as_ref()
            .expect("it is an instance");
        let (address, leaf) = match instance.root {
            Target::Node(index) => (index.into(), 0),
            Target::Record(index) => (index.into(), 1),
        };
        let context = self.context.encode(Context {
            level: (*level).into(),
            touched: packet.touched,
            inside: 1,
        });
        let start = Start {
            address,
            leaf,
            context,
        };
        model.drive(&inputs.object, start);
    }

    /// Sets up the rays of an instance.
    fn enter(&mut self, id: usize) {
        let packet = self.packets[id].as_ref().expect("the packet is in a leaf");
        let Event::Leaf { entries, .. } = &packet.events[packet.next - 1] else {
            unreachable!("the packet is at an instance");
        };
        for (k, entry) in entries.iter().enumerate() {
            let ray = &entry.transformed;
            let set_up = RaySetUp {
                ray: ray.ray,
                interval: [ray.near, ray.far],
                enters: ray.enters,
            };
            let place = SetupPlace {
                packet: id,
                ray: entry.slot.into(),
                first: k == 0,
                last: k + 1 == entries.len(),
                object: true,
            };
            self.entering.push_back(Arriving {
                place,
                values: set_up.for_traversal(self.format, place),
            });
        }
    }

    /// Chooses a packet's number in flight, and computes its expected events with the golden model.
    fn arrive(&mut self, scene: &TestScene, rays: &[Ray], arriving: &mut VecDeque<Arriving>) {
        let a = self.arithmetic;
        let id = self.free.swap_remove(self.rng.usize(..self.free.len()));
        let set_up: Vec<RaySetUp> = rays
            .iter()
            .map(|ray| {
                let ray = RaySetup::new(&a, ray);
                let interval = ray.enter_scene(&a, scene.bounds);
                RaySetUp {
                    enters: ray.valid && interval[0] <= interval[1],
                    ray,
                    interval,
                }
            })
            .collect();
        for (k, ray) in set_up.iter().enumerate() {
            let place = SetupPlace::of_world(id, k, rays.len());
            arriving.push_back(Arriving {
                place,
                values: ray.for_traversal(self.format, place),
            });
        }
        let has = |holds: &dyn Fn(f64) -> bool| {
            rays.iter().any(|ray| {
                let numbers = ray.origin.iter().chain(&ray.direction);
                ray.active && numbers.into_iter().any(|x| holds(*x))
            })
        };
        let has_nan_limit = rays
            .iter()
            .any(|ray| ray.active && (ray.tmin.is_nan() || ray.tmax.is_nan()));
        let golden: Vec<RaySetup> = set_up.iter().map(|ray| ray.ray).collect();
        let categories = &mut self.bench.tally.categories;
        let nothing = !set_up.iter().any(|ray| ray.enters);
        categories.count(Category::NothingEntered, nothing);
        let leaf_root = !nothing && matches!(scene.root.root(), Target::Record(_));
        categories.count(Category::LeafRoot, leaf_root);
        let mut script = Script {
            scene,
            rays: &golden,
            stack_depth: self.config.stack_depth,
            events: vec![],
            level: 0,
            high_water: 0,
            closest: vec![Closest::default(); rays.len()],
            categories,
            has: [
                (Category::Nan, has_nan_limit || has(&f64::is_nan)),
                (Category::Infinity, has(&f64::is_infinite)),
                (
                    Category::SignedZero,
                    has(&|x| x == 0.0 && x.is_sign_negative()),
                ),
                (Category::InactiveRay, rays.iter().any(|ray| !ray.active)),
            ],
        };
        scene.caster.cast(rays, &mut script);
        self.high_water = self.high_water.max(script.high_water);
        self.packets[id] = Some(Packet {
            number: self.started,
            events: script.events,
            next: 0,
            steps: 0,
            touched: 0,
            in_leaf: false,
        });
        self.started += 1;
    }

    /// Models the geometry unit: limits and finished leaves for the next edge.
    fn return_leaves(&mut self, around: &Surroundings) {
        let now = self.bench.model.cycles();
        let (mut limit, mut done) = (None, None);
        if self.merging.is_none() {
            if let Some(&Reverse((due, id))) = self.tested.peek() {
                if due <= now {
                    self.tested.pop();
                    if self.is_at_instance(id) {
                        self.enter(id);
                    } else {
                        self.merging = Some((id, 0));
                    }
                }
            }
        }
        if let Some((id, next)) = self.merging {
            if !self.pauses(around) {
                let packet = self.packets[id].as_ref().expect("the packet is in a leaf");
                let limits = match &packet.events[packet.next - 1] {
                    Event::Leaf { limits, .. } => limits.as_slice(),
                    Event::Step(_) => &[],
                };
                limit = limits.get(next).map(|limit| (id, *limit));
                if next + 1 >= limits.len() {
                    self.merging = None;
                    self.done.push_back(id);
                } else {
                    self.merging = Some((id, next + 1));
                }
            }
        }
        // Together with the last limit, as in the geometry unit, or later.
        if !self.done.is_empty() && !self.pauses(around) {
            done = self.done.pop_front();
        }
        let (inputs, model) = (&self.ports.inputs, &mut self.bench.model);
        model.set(inputs.limit.valid, limit.is_some().into());
        if let Some((packet, (ray, value))) = limit {
            let limit = Limit {
                packet: packet as u64,
                ray: ray.into(),
                value: self.format.to_bits(value),
            };
            model.drive(&inputs.limit.payload, limit);
        }
        model.set(inputs.done.valid, done.is_some().into());
        if let Some(id) = done {
            let packet = self.packets[id].as_mut().expect("the packet is in a leaf");
            if let Event::Leaf { level, limits, .. } = &packet.events[packet.next - 1] {
                for (ray, _) in limits {
                    packet.touched |= 1 << ray;
                }
                let context = self.context.encode(Context {
                    level: (*level).into(),
                    touched: packet.touched,
                    inside: self.instanced.into(),
                });
                let packet = id as u64;
                model.drive(&inputs.done.payload, InContext { packet, context });
            }
            packet.in_leaf = false;
        }
    }

    /// Whether the current leaf of a packet is an instance.
    fn is_at_instance(&self, id: usize) -> bool {
        let packet = self.packets[id].as_ref().expect("the packet is in a leaf");
        matches!(&packet.events[packet.next - 1], Event::Leaf { leaf, .. } if leaf.instance)
    }

    /// The packet of an event of the unit.
    fn packet(&self, id: usize, what: &str) -> Result<&Packet> {
        match self.packets.get(id).and_then(Option::as_ref) {
            Some(packet) if packet.in_leaf => Err(self.bench.mismatch(
                format!(
                    "{what} of {} while its leaf is being tested",
                    name(id, packet)
                ),
                vec![],
            )),
            Some(packet) => Ok(packet),
            None => Err(self.bench.mismatch(
                format!("{what} of packet number {id}, which is not in flight"),
                vec![],
            )),
        }
    }

    fn check_step(&mut self) -> Result<bool> {
        let (ports, model) = (&self.ports.outputs, &self.bench.model);
        if model.get(ports.step_taken) == 0 {
            return Ok(false);
        }
        let step = ports.trace_step.as_ref().expect(TRACED);
        let id = model.get(step.packet) as usize;
        let packet = self.packet(id, "a packet step")?;
        let Some(Event::Step(golden)) = packet.events.get(packet.next) else {
            let place = format!(
                "{}: a packet step at node {}, but {} is next",
                name(id, packet),
                model.get(step.node),
                expected(packet)
            );
            return Err(self.bench.mismatch(place, vec![]));
        };
        let fields = compare_step(model, step, self.format, golden);
        if !fields.is_empty() {
            let place = format!(
                "packet step {} at node {} of {}",
                packet.steps,
                golden.node,
                name(id, packet)
            );
            return Err(self.bench.mismatch(place, fields));
        }
        let packet = self.packets[id].as_mut().expect("it was there just now");
        packet.next += 1;
        packet.steps += 1;
        self.bench.tally.transactions += 1;
        self.bench.tally.checked += 1;
        Ok(true)
    }

    fn take_leaf(&mut self, around: &Surroundings) -> Result<()> {
        let shown = self.bench.model.sample(&self.ports.outputs.leaf.payload);
        let (id, address) = (shown.packet as usize, shown.address);
        let packet = self.packet(id, "a leaf")?;
        let Some(Event::Leaf { leaf, level, .. }) = packet.events.get(packet.next) else {
            let place = format!(
                "{}: a leaf with record {address} is handed over, but {} is next",
                name(id, packet),
                expected(packet)
            );
            return Err(self.bench.mismatch(place, vec![]));
        };
        let context = self.context.decode(shown.context);
        let rtl = [
            address,
            shown.mask,
            context.level,
            context.touched,
            context.inside,
        ];
        let golden = [
            leaf.record.into(),
            leaf.mask.into(),
            u64::from(*level),
            packet.touched,
            u64::from(self.instanced && !leaf.instance),
        ];
        if rtl != golden {
            let names = [
                "record",
                "rays to test",
                "stack level",
                "rays that have hit something",
                "inside an object",
            ];
            let fields = (names.into_iter().zip(golden).zip(rtl))
                .map(|((name, golden), rtl)| Field::integer(name, golden, rtl))
                .collect();
            let place = format!(
                "leaf after packet step {} of {}",
                packet.steps,
                name(id, packet)
            );
            return Err(self.bench.mismatch(place, fields));
        }
        let packet = self.packets[id].as_mut().expect("it was there just now");
        packet.next += 1;
        packet.in_leaf = true;
        let clocks = u64::from(self.rng.u32(1..=around.leaf_clocks.max(1)));
        self.tested
            .push(Reverse((self.bench.model.cycles() + clocks, id)));
        self.bench.tally.checked += 1;
        Ok(())
    }

    fn check_finished(&mut self) -> Result<bool> {
        let (ports, model) = (&self.ports.outputs.finished, &self.bench.model);
        if model.get(ports.valid) == 0 {
            return Ok(false);
        }
        let Finished { packet, touched } = model.sample(&ports.payload);
        let id = packet as usize;
        let packet = self.packet(id, "the end")?;
        if packet.next < packet.events.len() {
            let place = format!(
                "{} ends, but {} is next",
                name(id, packet),
                expected(packet)
            );
            return Err(self.bench.mismatch(place, vec![]));
        }
        if touched != packet.touched {
            let field = Field::integer("rays that have hit something", packet.touched, touched);
            let place = format!("the end of {}", name(id, packet));
            return Err(self.bench.mismatch(place, vec![field]));
        }
        self.packets[id] = None;
        self.free.push(id);
        self.bench.tally.packets += 1;
        self.bench.tally.checked += 1;
        Ok(true)
    }

    #[cold]
    fn stuck(&self, clocks: u64) -> anyhow::Error {
        let mut place = format!("nothing has happened for {clocks} clocks");
        for (id, packet) in self.packets.iter().enumerate() {
            if let Some(packet) = packet {
                place += &format!("; {} waits for {}", name(id, packet), expected(packet));
            }
        }
        self.bench.mismatch(place, vec![])
    }
}

fn name(id: usize, packet: &Packet) -> String {
    format!("packet {} ({id} in flight)", packet.number)
}

/// The next expected event of a packet, as text.
fn expected(packet: &Packet) -> String {
    match packet.events.get(packet.next) {
        Some(Event::Step(step)) => format!("packet step {} at node {}", packet.steps, step.node),
        Some(Event::Leaf { leaf, .. }) => format!("the leaf with record {}", leaf.record),
        None => "its end".into(),
    }
}
