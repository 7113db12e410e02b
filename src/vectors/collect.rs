//! Writes vectors from the events that the golden model reports to its observer.

use super::shape::Shape;
use super::sheet::{PICTURE, Sheet, UnitSheets};
use crate::bkd::layout::{MemoryImage, Node};
use crate::float::Arithmetic;
use crate::golden::raycast::{EnterEvent, RaySet};
use crate::golden::{
    Caster, Instance, Observer, Outcome, RaySetup, RayTest, StepEvent, WHOLE_LINE,
};
use crate::port::Ray;
use crate::report::folder::Folder;
use anyhow::Result;
use std::rc::Rc;

/// An even selection of at most 2,000 operands of one kind from a frame; the same frame gives the same selection.
pub struct Reservoir<T> {
    pub kept: Vec<T>,
    seen: usize,
    rng: fastrand::Rng,
}

impl<T> Reservoir<T> {
    const CAPACITY: usize = 2000;

    fn new() -> Self {
        Reservoir {
            kept: vec![],
            seen: 0,
            rng: fastrand::Rng::with_seed(2006),
        }
    }

    fn offer(&mut self, item: T) {
        self.seen += 1;
        if self.kept.len() < Self::CAPACITY {
            self.kept.push(item);
        } else {
            let place = self.rng.usize(..self.seen);
            if place < Self::CAPACITY {
                self.kept[place] = item;
            }
        }
    }
}

/// A scene into which packets are cast, with indices from 0.
pub struct Scene<'a> {
    pub image: &'a MemoryImage,
    pub caster: Rc<Caster>,
    /// Offset of node and record indices in the files.
    pub first_record: u32,
}

/// A packet to cast.
pub struct Packet {
    /// Index of the packet's scene; 0 is the given scene.
    pub scene: usize,
    /// The packet's block of the picture, if it belongs to the picture.
    pub block: Option<u32>,
    pub label: &'static str,
    /// One ray per slot of the machine's packets.
    pub rays: Vec<Ray>,
    /// The kind of each ray; empty if the label gives it.
    pub kinds: Vec<&'static str>,
}

/// Operands that occur in the frame.
pub struct Operands {
    /// u and v of a triangle test.
    pub add: Reservoir<[f64; 2]>,
    /// A plane and an origin.
    pub sub: Reservoir<[f64; 2]>,
    /// Their difference and a reciprocal.
    pub mul: Reservoir<[f64; 2]>,
    /// Components of directions.
    pub reciprocal: Reservoir<f64>,
}

/// Writes the lines of packets that are cast, and of single transactions.
pub struct Collector<'a> {
    pub shape: Shape,
    pub arithmetic: Arithmetic,
    /// All scenes, the given one first.
    scenes: Vec<Scene<'a>>,
    /// Index of the scene into which packets are cast.
    scene: usize,
    pub rays: Sheet,
    pub hits: Sheet,
    pub packets: Sheet,
    pub setup: UnitSheets,
    pub step: UnitSheets,
    pub test: UnitSheets,
    /// `Some` if at least one scene has two levels.
    pub transform: Option<UnitSheets>,
    pub operands: Operands,
    /// Number of packet steps and ray–triangle tests of the packets.
    pub steps: u64,
    pub tests: u64,
}

impl<'a> Collector<'a> {
    /// Creates a collector for `scenes`, the first of which is the given scene.
    ///
    /// # Errors
    /// One line that names a file that cannot be written.
    pub fn new(folder: &Folder, shape: Shape, scenes: Vec<Scene<'a>>) -> Result<Self> {
        let sheet = |stem: &str, layout| Sheet::new(folder, stem, layout, PICTURE);
        Ok(Collector {
            arithmetic: Arithmetic::new(shape.format),
            rays: sheet("raycast_rays", shape.raycast_rays())?,
            hits: sheet("raycast_hits", shape.raycast_hits())?,
            packets: sheet("raycast_packets", shape.raycast_packets())?,
            setup: UnitSheets::new(
                folder,
                "ray_setup",
                shape.ray_setup_stimulus(),
                shape.ray_setup_expected(),
                true,
            )?,
            step: UnitSheets::new(
                folder,
                "packet_step",
                shape.packet_step_stimulus(),
                shape.packet_step_expected(),
                true,
            )?,
            test: UnitSheets::new(
                folder,
                "triangle_test",
                shape.triangle_test_stimulus(),
                shape.triangle_test_expected(),
                true,
            )?,
            transform: (scenes.iter().any(|scene| scene.image.is_instanced()))
                .then(|| {
                    UnitSheets::new(
                        folder,
                        "ray_transform",
                        shape.ray_transform_stimulus(),
                        shape.ray_transform_expected(),
                        false,
                    )
                })
                .transpose()?,
            operands: Operands {
                add: Reservoir::new(),
                sub: Reservoir::new(),
                mul: Reservoir::new(),
                reciprocal: Reservoir::new(),
            },
            shape,
            scenes,
            scene: 0,
            steps: 0,
            tests: 0,
        })
    }

    /// Casts a packet.
    ///
    /// # Errors
    /// One line that names a file that cannot be written.
    pub fn cast(&mut self, packet: &Packet) -> Result<()> {
        let Packet {
            scene,
            block,
            label,
            rays,
            kinds,
        } = packet;
        self.scene = *scene;
        let tag = self.packets.lines & (u64::MAX >> (64 - self.shape.tag_bits));
        self.packets.begin(label);
        let mut setups = vec![];
        for (k, ray) in rays.iter().enumerate() {
            // Ray setup uses the box of scene 0 only.
            setups.push(match scene {
                0 => self.set_up(ray)?,
                _ => RaySetup::new(&self.arithmetic, ray),
            });
            let mut values = self.shape.ray_values(ray);
            values.push(tag);
            self.rays.begin(kinds.get(k).unwrap_or(label));
            self.rays.push(&values)?;
        }
        let (first_step, first_test) = (self.step.stimulus.lines, self.test.stimulus.lines);
        let caster = Rc::clone(&self.scenes[*scene].caster);
        let first_transform = self.transforms();
        let mut watcher = Watcher {
            inside: setups.clone(),
            windows: vec![WHOLE_LINE; setups.len()],
            collector: self,
            setups: &setups,
            result: Ok(()),
        };
        let result = caster.cast(rays, &mut watcher);
        watcher.result?;
        let steps = self.step.stimulus.lines - first_step;
        let tests = self.test.stimulus.lines - first_test;
        let transforms = self.transforms() - first_transform;
        self.packets.push(&[
            tag,
            first_step,
            steps,
            first_test,
            tests,
            first_transform,
            transforms,
            *scene as u64,
            block.unwrap_or(u32::MAX).into(),
        ])?;
        self.steps += steps;
        self.tests += tests;
        for (k, hit) in result.hits.iter().enumerate() {
            self.hits.begin(kinds.get(k).unwrap_or(label));
            let values = self.shape.hit_values(hit, tag);
            self.hits.push(&values)?;
        }
        Ok(())
    }

    /// Number of ray transformations so far; 0 in a scene of one level.
    pub fn transforms(&self) -> u64 {
        (self.transform.as_ref()).map_or(0, |sheets| sheets.stimulus.lines)
    }

    /// The current scene's image, and the index of its first slot.
    fn image(&self) -> (&'a MemoryImage, u32) {
        let scene = &self.scenes[self.scene];
        (scene.image, scene.first_record)
    }

    /// Writes the setup of one ray in the given scene.
    ///
    /// # Errors
    /// One line that names a file that cannot be written.
    pub fn set_up(&mut self, ray: &Ray) -> Result<RaySetup> {
        let setup = RaySetup::new(&self.arithmetic, ray);
        let interval = setup.enter_scene(&self.arithmetic, self.scenes[0].image.bounds);
        for component in setup.direction {
            self.operands.reciprocal.offer(component);
        }
        self.setup.push(
            &self.shape.ray_values(ray),
            &self.shape.ray_setup_values(&setup, interval),
        )?;
        Ok(setup)
    }

    /// Writes a packet step: the rays that take part, the rays that enter the left and the right child, and those that enter both, the left one first.
    ///
    /// # Errors
    /// One line that names a file that cannot be written.
    pub fn step(
        &mut self,
        (index, node): (u32, &Node),
        setups: &[RaySetup],
        come: &RaySet,
        (left, right, left_first): (&RaySet, &RaySet, u8),
    ) -> Result<()> {
        let shape = &self.shape;
        let stimulus = shape.packet_step_values(index, node, setups, come);
        let expected = shape.packet_step_outcome(index, node.link, left, right, left_first);
        self.step.push(&stimulus, &expected)
    }

    /// Writes a test of a ray, with its window, against a triangle.
    ///
    /// # Errors
    /// One line that names a file that cannot be written.
    pub fn test(
        &mut self,
        (slot, record): (u8, u32),
        vertices: &[[f64; 3]; 3],
        (setup, window): (&RaySetup, [f64; 2]),
        outcome: &Outcome,
    ) -> Result<()> {
        let stimulus = self
            .shape
            .triangle_test_values(slot, record, vertices, setup, window);
        let expected = self.shape.triangle_test_outcome(outcome);
        self.test.push(&stimulus, &expected)
    }
}

/// Writes the events of one packet as lines; after an error it writes nothing more.
struct Watcher<'c, 'a> {
    collector: &'c mut Collector<'a>,
    setups: &'c [RaySetup],
    /// The rays in the object space of the instance entered last, and their windows. In a scene of one level these are the
    /// rays themselves.
    inside: Vec<RaySetup>,
    windows: Vec<[f64; 2]>,
    result: Result<()>,
}

impl Observer for Watcher<'_, '_> {
    fn step(&mut self, event: &StepEvent) {
        if self.result.is_err() {
            return;
        }
        let (image, first) = self.collector.image();
        let mut node = image.nodes[event.node as usize];
        node.link.link += first;
        let sides = [
            (node.left, node.link.left_axis),
            (node.right, node.link.right_axis),
        ];
        let a = self.collector.arithmetic;
        let setups = match event.inside {
            true => &self.inside,
            false => self.setups,
        };
        for (k, setup) in setups.iter().enumerate() {
            if event.rays.mask >> k & 1 == 0 {
                continue;
            }
            for (interval, axis) in sides {
                let (origin, reciprocal) =
                    (setup.origin[axis as usize], setup.reciprocal[axis as usize]);
                for plane in interval {
                    let operands = &mut self.collector.operands;
                    operands.sub.offer([plane, origin]);
                    operands.mul.offer([a.sub(plane, origin), reciprocal]);
                }
            }
        }
        self.result = self.collector.step(
            (first + event.node, &node),
            setups,
            &event.rays,
            (&event.left, &event.right, event.left_first),
        );
    }

    fn test(&mut self, event: &RayTest) {
        if self.result.is_err() {
            return;
        }
        let [_, u, v] = event.outcome.raw;
        self.collector.operands.add.offer([u, v]);
        let (image, first) = self.collector.image();
        let record = image.records[event.record as usize];
        let vertices = (record.vertices).map(|vertex| image.vertices[vertex as usize]);
        self.result = self.collector.test(
            (event.slot, first + event.record),
            &vertices,
            (
                &self.inside[event.slot as usize],
                self.windows[event.slot as usize],
            ),
            &event.outcome,
        );
    }

    fn enter(&mut self, event: &EnterEvent) {
        if self.result.is_err() {
            return;
        }
        let slot = event.slot as usize;
        let (image, first) = self.collector.image();
        let Collector {
            shape, transform, ..
        } = &mut *self.collector;
        let sheets = transform.as_mut().expect("a scene of two levels");
        let record = first + event.record;
        let instance = Instance::fetch(image, event.record);
        self.result = sheets.push(
            &shape.ray_transform_values(event.slot, record, &instance, &self.setups[slot]),
            &shape.ray_transform_outcome(&event.transformed),
        );
        self.inside[slot] = event.transformed.ray;
        self.windows[slot] = event.transformed.window;
    }
}
