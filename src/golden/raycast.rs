//! The ray casting unit: a packet of rays in setup, traversal, ray transformation and triangle test.

use std::ops::Range;

use rayon::prelude::*;

use super::MOST_RAYS;
use super::geometry::{Closest, Outcome, Triangle};
use super::lanes::RayLanes;
use super::setup::RaySetup;
use super::tpu::{Entry, Lanes};
use super::transform::{Instance, Transformed, WHOLE_LINE};
use crate::bkd::layout::{MemoryImage, Target, TriangleRecord};
use crate::config::TriangleTest;
use crate::float::Arithmetic;
use crate::port::{Hit, Ray};

/// Receives all events of a packet, in order. The scoreboards of co-simulation compare them with the RTL's node steps
/// and triangle tests. A method that is not overridden costs nothing.
///
/// Arrays have one element for each of [`MOST_RAYS`] rays. For a ray outside the corresponding mask, near and far
/// are undefined.
pub trait Observer {
    /// Whether events are generated at all.
    const WATCHES: bool = true;

    /// One packet step was taken.
    fn step(&mut self, _event: &StepEvent) {}
    /// The step's second child was pushed.
    fn push(&mut self, _event: &PushEvent) {}
    /// An entry was popped, and kept or dropped.
    fn pop(&mut self, _event: &PopEvent) {}
    /// A leaf was dispatched to the geometry unit.
    fn hand_over(&mut self, _event: &HandOver) {}
    /// One ray was transformed into an instance's object space. The rays of a dispatched instance follow in order of slots. If
    /// any ray enters, the packet continues at the object's root in object space.
    fn enter(&mut self, _event: &EnterEvent) {}
    /// One ray was tested against one triangle. The rays of a dispatched leaf follow in order of slots.
    fn test(&mut self, _event: &RayTest) {}
}

/// An observer that ignores all events, at no cost.
impl Observer for () {
    const WATCHES: bool = false;
}

/// A set of rays, and their intervals in a node or child.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySet {
    /// Bit k is the ray in slot k.
    pub mask: u8,
    pub near: [f64; MOST_RAYS],
    pub far: [f64; MOST_RAYS],
}

/// A packet step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepEvent {
    /// Index of the node.
    pub node: u32,
    /// Whether the packet is in object space, below a top-level tree.
    pub inside: bool,
    /// The rays that take part, with their intervals.
    pub rays: RaySet,
    /// The rays that enter the left child, with their clipped intervals.
    pub left: RaySet,
    /// The rays that enter the right child, with their clipped intervals.
    pub right: RaySet,
    /// The rays that enter both children, the left one first.
    pub left_first: u8,
    /// The child with which the packet continues: the only one that a ray enters, or the first of two; `None` if it pops.
    pub next: Option<Target>,
}

/// The second child of a step in which the packet enters both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PushEvent {
    pub child: Target,
    /// Whether the child is in an object's tree, below a top-level tree.
    pub inside: bool,
    /// The rays that enter the child, with their intervals.
    pub rays: RaySet,
    /// Number of entries on the stack, including this one.
    pub height: u32,
}

/// An entry taken from the stack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PopEvent {
    pub child: Target,
    /// Whether the child is in an object's tree below a top-level tree, so that the packet continues in object space.
    pub inside: bool,
    /// The remaining rays, with their far bounded by their limit. If none remains, the entry is dropped and the next one is popped.
    pub rays: RaySet,
    /// Number of entries left on the stack.
    pub height: u32,
}

/// A leaf dispatched to the geometry unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HandOver {
    /// Index of the leaf's record.
    pub record: u32,
    /// Whether the leaf is an instance that the rays enter; otherwise it is a triangle to test.
    pub instance: bool,
    /// The rays that take part.
    pub mask: u8,
}

/// A ray transformed into an instance's object space.
#[derive(Clone, Copy, Debug)]
pub struct EnterEvent {
    /// The ray's slot in its packet.
    pub slot: u8,
    /// Index of the instance's record.
    pub record: u32,
    /// The instance's number in the scene.
    pub instance: u32,
    /// The ray in object space, its window, and whether it enters.
    pub transformed: Transformed,
}

/// A ray–triangle test and its merge.
#[derive(Clone, Copy, Debug)]
pub struct RayTest {
    /// The ray's slot in its packet.
    pub slot: u8,
    /// Index of the triangle's record.
    pub record: u32,
    /// The number of the current instance, 0 in a scene of one level.
    pub instance: u32,
    /// The triangle's number in its mesh.
    pub triangle: u32,
    pub outcome: Outcome,
    /// The ray's result after this test.
    pub merged: Closest,
}

/// The work of a packet.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Number of packet steps.
    pub steps: u32,
    /// Triangles dispatched: the packet's triangle tests.
    pub tests: u32,
    /// Ray–triangle tests: the sum of the rays over all dispatched triangles.
    pub ray_tests: u32,
    /// Instances dispatched: the packet's entries into instances.
    pub entries: u32,
    /// Ray transformations: the sum of the rays over all dispatched instances.
    pub ray_transforms: u32,
    /// Maximum number of entries on the stack.
    pub stack_high_water: u32,
}

/// The results of a packet.
#[derive(Clone, Debug)]
pub struct PacketResult {
    /// One per given ray.
    pub hits: Vec<Hit>,
    pub counts: Counts,
}

/// The results of many packets.
#[derive(Clone, Debug)]
pub struct FrameResult {
    /// One per given ray, in order.
    pub hits: Vec<Hit>,
    /// One per packet.
    pub packets: Vec<Counts>,
}

impl FrameResult {
    /// Number of packet steps of all packets.
    pub fn steps(&self) -> u64 {
        self.sum(|packet| packet.steps)
    }

    /// Number of triangles dispatched by all packets.
    pub fn tests(&self) -> u64 {
        self.sum(|packet| packet.tests)
    }

    /// Number of ray–triangle tests of all packets.
    pub fn ray_tests(&self) -> u64 {
        self.sum(|packet| packet.ray_tests)
    }

    /// Number of instances dispatched by all packets.
    pub fn entries(&self) -> u64 {
        self.sum(|packet| packet.entries)
    }

    /// Number of ray transformations of all packets.
    pub fn ray_transforms(&self) -> u64 {
        self.sum(|packet| packet.ray_transforms)
    }

    fn sum(&self, count: impl Fn(&Counts) -> u32) -> u64 {
        self.packets
            .iter()
            .map(|packet| u64::from(count(packet)))
            .sum()
    }

    /// Maximum number of entries on any packet's stack.
    pub fn stack_high_water(&self) -> u32 {
        self.packets
            .iter()
            .map(|packet| packet.stack_high_water)
            .max()
            .unwrap_or(0)
    }
}

/// A node, decoded for traversal.
#[derive(Clone, Copy, Debug)]
struct DecodedNode {
    /// [minimum, maximum] coordinate of the left and the right child on their axes.
    intervals: [[f64; 2]; 2],
    axes: [u8; 2],
    children: [Target; 2],
}

/// Casts packets of rays into a memory image.
#[derive(Clone, Debug)]
pub struct Caster {
    arithmetic: Arithmetic,
    test: TriangleTest,
    rays_per_packet: usize,
    nodes: Vec<DecodedNode>,
    /// Indexed by record; the element of an instance's record is undefined.
    triangles: Vec<Triangle>,
    /// In a scene of two levels, indexed by record from `first_instance` on.
    instances: Vec<Instance>,
    first_instance: u32,
    root: Target,
    bounds: ([f64; 3], [f64; 3]),
}

impl Caster {
    /// Decodes an image that [`MemoryImage::check`] accepts.
    ///
    /// # Panics
    /// If `rays_per_packet` is not 1, 2, 4 or 8, or if the image is not valid.
    pub fn new(image: &MemoryImage, test: TriangleTest, rays_per_packet: usize) -> Self {
        assert!(
            matches!(rays_per_packet, 1 | 2 | 4 | 8),
            "a packet has 1, 2, 4 or 8 rays, not {rays_per_packet}"
        );
        let decode = |(index, node): (usize, &crate::bkd::layout::Node)| DecodedNode {
            intervals: [node.left, node.right],
            axes: [node.link.left_axis, node.link.right_axis],
            children: node.link.children(index as u32),
        };
        let instances = image.instance_records().expect("a sound image");
        Caster {
            arithmetic: Arithmetic::new(image.format),
            test,
            rays_per_packet,
            nodes: image.nodes.iter().enumerate().map(decode).collect(),
            triangles: fetch_triangles(image, &instances),
            first_instance: instances.start,
            instances: instances
                .map(|record| Instance::fetch(image, record))
                .collect(),
            root: image.root.root(),
            bounds: image.bounds,
        }
    }

    pub fn rays_per_packet(&self) -> usize {
        self.rays_per_packet
    }

    /// Casts one packet and reports all events to `observer`. Slots without a ray are inactive.
    ///
    /// # Panics
    /// If there are more rays than slots in a packet.
    pub fn cast(&self, rays: &[Ray], observer: &mut impl Observer) -> PacketResult {
        let mut hits = vec![Hit::MISS; rays.len()];
        let counts = self.cast_into(rays, &mut hits, observer);
        PacketResult { hits, counts }
    }

    /// Casts rays in packets, in order, on all cores; inactive rays fill the last packet.
    pub fn cast_packets(&self, rays: &[Ray]) -> FrameResult {
        let mut hits = vec![Hit::MISS; rays.len()];
        let packets = rays
            .par_chunks(self.rays_per_packet)
            .zip(hits.par_chunks_mut(self.rays_per_packet))
            .map(|(rays, hits)| self.cast_into(rays, hits, &mut ()))
            .collect();
        FrameResult { hits, packets }
    }

    fn cast_into(&self, rays: &[Ray], hits: &mut [Hit], observer: &mut impl Observer) -> Counts {
        assert!(
            rays.len() <= self.rays_per_packet,
            "a packet has {} rays, not {}",
            self.rays_per_packet,
            rays.len()
        );
        match (self.rays_per_packet, self.instances.is_empty()) {
            (1, true) => self.traverse::<1, false, _>(rays, hits, observer),
            (2, true) => self.traverse::<2, false, _>(rays, hits, observer),
            (4, true) => self.traverse::<4, false, _>(rays, hits, observer),
            (_, true) => self.traverse::<8, false, _>(rays, hits, observer),
            (1, false) => self.traverse::<1, true, _>(rays, hits, observer),
            (2, false) => self.traverse::<2, true, _>(rays, hits, observer),
            (4, false) => self.traverse::<4, true, _>(rays, hits, observer),
            (_, false) => self.traverse::<8, true, _>(rays, hits, observer),
        }
    }

    /// Casts a packet of N rays. `INSTANCED` says whether the scene has two levels; without it the code for them is omitted.
    fn traverse<const N: usize, const INSTANCED: bool, O: Observer>(
        &self,
        rays: &[Ray],
        hits: &mut [Hit],
        observer: &mut O,
    ) -> Counts {
        let a = &self.arithmetic;
        let rays: [RaySetup; N] =
            std::array::from_fn(|k| RaySetup::new(a, rays.get(k).unwrap_or(&Ray::INACTIVE)));
        let mut current = Lanes {
            mask: 0,
            near: [0.0; N],
            far: [0.0; N],
        };
        for (k, ray) in rays.iter().enumerate() {
            [current.near[k], current.far[k]] = ray.enter_scene(a, self.bounds);
            let enters = ray.valid && current.near[k] <= current.far[k];
            current.mask |= u8::from(enters) << k;
        }
        if current.mask == 0 {
            return Counts::default();
        }
        let lanes = RayLanes::new(&rays);
        let mut packet = Packet::<N, INSTANCED, O> {
            caster: self,
            observer,
            rays: &rays,
            lanes: &lanes,
            inside: false,
            object: INSTANCED.then(|| Inside::new(&rays, &lanes)),
            current,
            stack: Vec::with_capacity(64),
            closest: [Closest::default(); N],
            counts: Counts::default(),
        };
        packet.traverse();
        for (hit, closest) in hits.iter_mut().zip(&packet.closest) {
            *hit = closest.hit;
        }
        packet.counts
    }
}

/// A packet of N rays during traversal.
struct Packet<'a, const N: usize, const INSTANCED: bool, O> {
    caster: &'a Caster,
    observer: &'a mut O,
    /// The rays in the world.
    rays: &'a [RaySetup; N],
    lanes: &'a RayLanes<N>,
    /// Whether the packet is in object space; `object` then has its rays.
    inside: bool,
    /// `Some` in a scene of two levels.
    object: Option<Inside<N>>,
    /// The rays in the current space.
    current: Lanes<N>,
    stack: Vec<Entry<N>>,
    closest: [Closest; N],
    counts: Counts,
}

// Each of these steps has one call, in the loop of `traverse`, and is inlined there.
impl<const N: usize, const INSTANCED: bool, O: Observer> Packet<'_, N, INSTANCED, O> {
    /// Traverses from the root until the stack is empty.
    #[inline(always)]
    fn traverse(&mut self) {
        let mut next = Some(self.caster.root);
        loop {
            next = match next {
                Some(Target::Node(index)) => self.step(index),
                Some(Target::Record(record)) => self.hand_over(record),
                None => match self.stack.pop() {
                    Some(entry) => self.resume(entry),
                    None => return,
                },
            };
        }
    }

    /// Performs one packet step. Returns the child with which the packet continues: the only one that a ray enters, or the first of two; the second one is pushed.
    #[inline(always)]
    fn step(&mut self, index: u32) -> Option<Target> {
        self.counts.steps += 1;
        let node = &self.caster.nodes[index as usize];
        let lanes = match &self.object {
            Some(object) if INSTANCED && self.inside => &object.lanes,
            _ => self.lanes,
        };
        let axes = node.axes.map(usize::from);
        let outcome = (self.current).step(&self.caster.arithmetic, lanes, node.intervals, axes);
        let (left, right) = (outcome.left, outcome.right);
        let left_first = outcome.left_first != 0;
        let next = match (left.mask != 0, right.mask != 0) {
            (false, false) => None,
            (goes_left, goes_right) => {
                let first = usize::from(!goes_left || goes_right && !left_first);
                Some(node.children[first])
            }
        };
        if O::WATCHES {
            self.observer.step(&StepEvent {
                node: index,
                inside: self.inside,
                rays: RaySet::from(&self.current),
                left: RaySet::from(&left),
                right: RaySet::from(&right),
                left_first: outcome.left_first,
                next,
            });
        }
        match (left.mask != 0, right.mask != 0) {
            (true, true) if left_first => {
                self.current = left;
                self.push(node.children[1], right);
            }
            (true, true) => {
                self.current = right;
                self.push(node.children[0], left);
            }
            (true, false) => self.current = left,
            (false, _) => self.current = right,
        }
        next
    }

    /// Pushes a child with the rays that enter it.
    #[inline(always)]
    fn push(&mut self, child: Target, rays: Lanes<N>) {
        let inside = self.inside;
        self.stack.push(Entry {
            child,
            inside,
            rays,
        });
        let height = self.stack.len() as u32;
        self.counts.stack_high_water = self.counts.stack_high_water.max(height);
        if O::WATCHES {
            self.observer.push(&PushEvent {
                child,
                inside,
                rays: RaySet::from(&rays),
                height,
            });
        }
    }

    /// Continues with a popped entry if any of its rays remains, and returns its child.
    #[inline(always)]
    fn resume(&mut self, entry: Entry<N>) -> Option<Target> {
        self.inside = entry.inside;
        let limit = self.closest.map(|ray| ray.limit);
        self.current = entry.rays.within(&self.caster.arithmetic, &limit);
        if O::WATCHES {
            self.observer.pop(&PopEvent {
                child: entry.child,
                inside: self.inside,
                rays: RaySet::from(&self.current),
                height: self.stack.len() as u32,
            });
        }
        (self.current.mask != 0).then_some(entry.child)
    }

    /// Processes a leaf: the rays enter an instance, or are tested against a triangle. Returns the node or record with which the packet
    /// continues, if it continues without a pop.
    #[inline(always)]
    fn hand_over(&mut self, record: u32) -> Option<Target> {
        let instance = INSTANCED && !self.inside;
        if O::WATCHES {
            self.observer.hand_over(&HandOver {
                record,
                instance,
                mask: self.current.mask,
            });
        }
        if instance {
            return self.enter(record);
        }
        self.test(record);
        None
    }

    /// Transforms the rays into an instance's object space, and continues at its root with the rays that enter it, if there are any.
    #[inline(always)]
    fn enter(&mut self, record: u32) -> Option<Target> {
        let object = self.object.as_mut()?;
        let mask = self.current.mask;
        self.counts.entries += 1;
        self.counts.ray_transforms += mask.count_ones();
        let instance = &self.caster.instances[(record - self.caster.first_instance) as usize];
        let (a, observer) = (&self.caster.arithmetic, &mut *self.observer);
        self.current = object.enter(a, instance, self.rays, mask, |slot, transformed| {
            if O::WATCHES {
                observer.enter(&EnterEvent {
                    slot,
                    record,
                    instance: instance.number,
                    transformed: *transformed,
                });
            }
        });
        self.inside = self.current.mask != 0;
        self.inside.then_some(instance.root)
    }

    /// Tests the rays against a triangle.
    #[inline(always)]
    fn test(&mut self, record: u32) {
        self.counts.tests += 1;
        self.counts.ray_tests += self.current.mask.count_ones();
        let (a, test) = (&self.caster.arithmetic, self.caster.test);
        let triangle = &self.caster.triangles[record as usize];
        let mut mask = self.current.mask;
        while mask != 0 {
            let slot = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            let (ray, window, instance) = match &self.object {
                Some(object) if INSTANCED => {
                    (&object.rays[slot], object.windows[slot], object.number)
                }
                _ => (&self.rays[slot], WHOLE_LINE, 0),
            };
            let outcome = if O::WATCHES {
                triangle.intersect::<true>(a, test, ray, window)
            } else {
                triangle.intersect::<false>(a, test, ray, window)
            };
            self.closest[slot].merge(ray, &outcome, instance, triangle.number);
            if O::WATCHES {
                self.observer.test(&RayTest {
                    slot: slot as u8,
                    record,
                    instance,
                    triangle: triangle.number,
                    outcome,
                    merged: self.closest[slot],
                });
            }
        }
    }
}

/// A packet's rays in the object space of the instance entered last. All stack entries of an instance are gone before
/// another leaf can enter an instance.
struct Inside<const N: usize> {
    /// The number of the instance.
    number: u32,
    rays: [RaySetup; N],
    lanes: RayLanes<N>,
    windows: [[f64; 2]; N],
}

impl<const N: usize> Inside<N> {
    /// The state before any instance is entered; rays that never enter keep it.
    fn new(rays: &[RaySetup; N], lanes: &RayLanes<N>) -> Self {
        Inside {
            number: 0,
            rays: *rays,
            lanes: *lanes,
            windows: [WHOLE_LINE; N],
        }
    }

    /// Transforms the rays of a mask into an instance's object space, and returns those that enter it. `watch` receives each ray.
    fn enter(
        &mut self,
        a: &Arithmetic,
        instance: &Instance,
        world: &[RaySetup; N],
        mut mask: u8,
        mut watch: impl FnMut(u8, &Transformed),
    ) -> Lanes<N> {
        let mut entering = Lanes {
            mask: 0,
            near: [0.0; N],
            far: [0.0; N],
        };
        self.number = instance.number;
        while mask != 0 {
            let slot = mask.trailing_zeros() as usize;
            mask &= mask - 1;
            let transformed = instance.transform(a, &world[slot]);
            watch(slot as u8, &transformed);
            self.rays[slot] = transformed.ray;
            self.windows[slot] = transformed.window;
            entering.mask |= u8::from(transformed.enters) << slot;
            entering.near[slot] = transformed.near;
            entering.far[slot] = transformed.far;
        }
        self.lanes = RayLanes::new(&self.rays);
        entering
    }
}

impl<const N: usize> From<&Lanes<N>> for RaySet {
    fn from(lanes: &Lanes<N>) -> Self {
        let widen =
            |values: &[f64; N]| std::array::from_fn(|k| values.get(k).copied().unwrap_or(0.0));
        RaySet {
            mask: lanes.mask,
            near: widen(&lanes.near),
            far: widen(&lanes.far),
        }
    }
}

/// The triangles of an image's records, in order; the records of instances give triangles at the origin.
fn fetch_triangles(image: &MemoryImage, instances: &Range<u32>) -> Vec<Triangle> {
    (0..)
        .zip(&image.records)
        .map(|(index, record)| {
            if instances.contains(&index) {
                Triangle::new([[0.0; 3]; 3], u32::MAX)
            } else {
                fetch_triangle(image, record)
            }
        })
        .collect()
}

/// The triangle of a record.
pub(super) fn fetch_triangle(image: &MemoryImage, record: &TriangleRecord) -> Triangle {
    let vertex = |index: u32| image.vertices[index as usize];
    Triangle::new(record.vertices.map(vertex), record.number)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bkd::{BuildOptions, InstanceSpec, InstancedImage, build};
    use crate::float::Format;
    use glam::{DAffine3, DMat3, DVec3, EulerRot};

    /// Checks during a cast that the sequence of events conforms to `docs/arithmetic.md`.
    #[derive(Default)]
    struct Follower {
        instanced: bool,
        counts: Counts,
        stack: Vec<PushEvent>,
        /// The next target of the packet, and its rays; for an object's root only the rays are known.
        expected: Option<(Option<Target>, u8)>,
        /// Whether that target is in object space.
        inside: bool,
        untested: u8,
        /// The rays of an instance that are not yet transformed, and those that entered it, with their intervals.
        untransformed: u8,
        entered: Option<RaySet>,
        instance: u32,
        windows: [[f64; 2]; MOST_RAYS],
        limits: [f64; MOST_RAYS],
        dropped: u32,
        tested: [Closest; MOST_RAYS],
    }

    fn same_intervals(x: &RaySet, y: &RaySet) -> bool {
        let same = |k: usize| x.near[k] == y.near[k] && x.far[k] == y.far[k];
        x.mask == y.mask && (0..MOST_RAYS).all(|k| x.mask >> k & 1 == 0 || same(k))
    }

    impl Observer for Follower {
        fn step(&mut self, event: &StepEvent) {
            self.counts.steps += 1;
            assert_eq!(self.untested, 0);
            if let Some((target, mask)) = self.expected {
                assert!(target.is_none_or(|target| target == Target::Node(event.node)));
                assert_eq!(mask, event.rays.mask);
            }
            assert_eq!(self.inside, event.inside);
            if let Some(entered) = self.entered.take() {
                assert!(same_intervals(&entered, &event.rays));
            }
            let both = event.left.mask & event.right.mask;
            assert_eq!((event.left.mask | event.right.mask) & !event.rays.mask, 0);
            assert_eq!(event.left_first & !both, 0);
            let first = if event.left.mask != 0 && (event.right.mask == 0 || event.left_first != 0)
            {
                &event.left
            } else {
                &event.right
            };
            assert_eq!(event.next.is_some(), first.mask != 0);
            self.expected = event.next.map(|next| (Some(next), first.mask));
        }

        fn push(&mut self, event: &PushEvent) {
            assert!(
                self.expected
                    .is_some_and(|(first, _)| first != Some(event.child))
            );
            assert_eq!(self.inside, event.inside);
            self.stack.push(*event);
            assert_eq!(event.height as usize, self.stack.len());
            self.counts.stack_high_water = self.counts.stack_high_water.max(event.height);
        }

        fn pop(&mut self, event: &PopEvent) {
            assert!(self.expected.is_none() && self.untested == 0 && self.untransformed == 0);
            self.entered = None;
            let pushed = self.stack.pop().expect("what is popped was pushed");
            assert_eq!(
                (pushed.child, pushed.inside, self.stack.len()),
                (event.child, event.inside, event.height as usize)
            );
            self.inside = event.inside;
            let mut stay = pushed.rays;
            for k in 0..MOST_RAYS {
                stay.far[k] = stay.far[k].min(self.limits[k]);
                if stay.near[k] > self.limits[k] {
                    stay.mask &= !(1 << k);
                }
            }
            assert!(same_intervals(&stay, &event.rays));
            self.dropped += u32::from(stay.mask == 0);
            self.expected = (stay.mask != 0).then_some((Some(event.child), stay.mask));
        }

        fn hand_over(&mut self, event: &HandOver) {
            let (target, mask) = self.expected.expect("a leaf follows from a step or a pop");
            assert!(target.is_none_or(|target| target == Target::Record(event.record)));
            assert_eq!(mask, event.mask);
            self.expected = None;
            assert_eq!(event.instance, self.instanced && !self.inside);
            if event.instance {
                self.counts.entries += 1;
                self.untransformed = mask;
                self.entered = Some(RaySet {
                    mask: 0,
                    near: [0.0; MOST_RAYS],
                    far: [0.0; MOST_RAYS],
                });
            } else {
                self.counts.tests += 1;
                self.untested = mask;
            }
        }

        fn enter(&mut self, event: &EnterEvent) {
            self.counts.ray_transforms += 1;
            assert_eq!(self.untransformed.trailing_zeros(), u32::from(event.slot));
            self.untransformed &= self.untransformed - 1;
            let slot = usize::from(event.slot);
            let moved = &event.transformed;
            self.instance = event.instance;
            self.windows[slot] = moved.window;
            let entered = self.entered.as_mut().expect("an instance was handed over");
            assert_eq!(moved.enters, moved.ray.valid && moved.near <= moved.far);
            entered.mask |= u8::from(moved.enters) << slot;
            entered.near[slot] = moved.near;
            entered.far[slot] = moved.far;
            if self.untransformed == 0 && entered.mask != 0 {
                self.expected = Some((None, entered.mask));
                self.inside = true;
            }
        }

        fn test(&mut self, event: &RayTest) {
            self.counts.ray_tests += 1;
            assert_eq!(self.inside, self.instanced);
            assert_eq!(event.instance, self.instance);
            assert_eq!(self.untested.trailing_zeros(), u32::from(event.slot));
            self.untested &= self.untested - 1;
            let slot = usize::from(event.slot);
            let RayTest {
                outcome, merged, ..
            } = event;
            assert!(!outcome.hit || outcome.near <= outcome.t && outcome.t <= outcome.far);
            assert!(!outcome.hit || merged.limit <= outcome.t);
            if self.instanced {
                let [near, far] = self.windows[slot];
                assert!(outcome.near >= near && outcome.far <= far);
            }
            self.limits[slot] = merged.limit;
            self.tested[slot] = *merged;
        }
    }

    #[test]
    fn events_follow_from_one_another_and_watching_changes_nothing() {
        let seed = 41;
        let mut random = fastrand::Rng::with_seed(seed);
        let a = Arithmetic::new(Format::FP24);
        let mut point = |scale: f64| [0; 3].map(|_| a.round(scale * (random.f64() - 0.5)));
        let mut vertices = Vec::new();
        for _ in 0..500 {
            let centre = point(16.0);
            for _ in 0..3 {
                let offset = point(4.0);
                vertices.push([0, 1, 2].map(|i| a.add(centre[i], offset[i])));
            }
        }
        let triangles: Vec<[u32; 3]> = (0..500).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let tree = build(&vertices, &triangles, &BuildOptions::default_for(2, 64)).unwrap();
        let image = MemoryImage::new(Format::FP24, &vertices, &triangles, &tree).unwrap();
        let mut instanced = InstancedImage::new(Format::FP24);
        instanced.add_object(&image).unwrap();
        let instances: Vec<InstanceSpec> = (0..12)
            .map(|number| {
                let [x, y, z] = point(1.0);
                let turn = DMat3::from_euler(EulerRot::XYZ, 4.0 * x, 4.0 * y, 4.0 * z);
                let place = DVec3::from_array(point(20.0));
                let matrix = DAffine3::from_mat3_translation(turn * 0.5, place);
                let bounds = instanced.objects()[0].bounds;
                let columns = matrix.to_cols_array_2d();
                InstanceSpec::new(Format::FP24, number, 0, &columns, bounds).unwrap()
            })
            .collect();
        let options = BuildOptions::default_for(2, 64);
        instanced.set_top(&instances, &options).unwrap();
        let mut dropped = 0;
        let mut hits = 0;
        let mut entries = 0;
        let images = [&image, instanced.image()];
        for test in [TriangleTest::MollerTrumbore, TriangleTest::Watertight] {
            for (image, rays_per_packet) in images
                .into_iter()
                .flat_map(|image| [1, 2, 4, 8].map(|rays| (image, rays)))
            {
                let caster = Caster::new(image, test, rays_per_packet);
                let rays: Vec<Ray> = (0..400)
                    .map(|k| Ray {
                        origin: point(24.0),
                        direction: point(1.0),
                        tmin: 0.0,
                        tmax: f64::INFINITY,
                        active: k % 7 != 0,
                        any_hit: k % 5 == 0,
                    })
                    .collect();
                let frame = caster.cast_packets(&rays);
                assert!(frame.steps() > 0 && frame.ray_tests() >= frame.tests());
                for (index, rays) in rays.chunks(rays_per_packet).enumerate() {
                    let mut follower = Follower {
                        instanced: image.is_instanced(),
                        limits: [f64::INFINITY; MOST_RAYS],
                        ..Follower::default()
                    };
                    let result = caster.cast(rays, &mut follower);
                    assert!(
                        follower.stack.is_empty() && follower.untested == 0,
                        "seed {seed}"
                    );
                    assert_eq!(result.counts, follower.counts);
                    assert_eq!(result.counts, frame.packets[index]);
                    let want = &frame.hits[index * rays_per_packet..];
                    for (slot, (hit, want)) in result.hits.iter().zip(want).enumerate() {
                        assert!(hit.same_bits(want, Format::FP24), "seed {seed}");
                        assert!(hit.same_bits(&follower.tested[slot].hit, Format::FP24));
                        hits += u32::from(hit.is_hit());
                    }
                    dropped += follower.dropped;
                    entries += follower.counts.entries;
                }
            }
        }
        assert!(
            hits > 1000 && dropped > 500 && entries > 1000,
            "{hits} hits, {dropped} entries dropped, {entries} entries of instances"
        );
    }

    #[test]
    fn a_scene_of_one_triangle_takes_no_step() {
        let vertices = [[0.0, 0.0, 1.0], [2.0, 0.0, 1.0], [0.0, 2.0, 1.0]];
        let triangles = [[0, 1, 2]];
        let tree = build(&vertices, &triangles, &BuildOptions::plain(64)).unwrap();
        let image = MemoryImage::new(Format::FP24, &vertices, &triangles, &tree).unwrap();
        let ray = Ray {
            origin: [0.5, 0.5, 0.0],
            direction: [0.0, 0.0, 0.5],
            tmin: 0.0,
            tmax: f64::INFINITY,
            active: true,
            any_hit: false,
        };
        let beside = Ray {
            origin: [-1.0, 0.5, 0.0],
            ..ray
        };
        for test in [TriangleTest::MollerTrumbore, TriangleTest::Watertight] {
            let result = Caster::new(&image, test, 4).cast(&[ray, beside], &mut ());
            let hit = result.hits[0];
            assert_eq!((hit.t, hit.u, hit.v, hit.triangle), (2.0, 0.25, 0.25, 0));
            assert!(!result.hits[1].is_hit());
            let counts = Counts {
                tests: 1,
                ray_tests: 1,
                ..Counts::default()
            };
            assert_eq!(result.counts, counts);
        }
    }
}
