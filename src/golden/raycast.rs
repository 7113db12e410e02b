//! The ray casting unit: a packet of rays through setup, traversal and triangle tests.

use rayon::prelude::*;

use super::MOST_RAYS;
use super::geometry::{Closest, Outcome, Triangle};
use super::setup::RaySetup;
use super::tpu::{Entry, Lanes, PacketRays};
use crate::bkd::layout::{MemoryImage, Target};
use crate::config::TriangleTest;
use crate::float::Arithmetic;
use crate::port::{Hit, Ray};

/// Sees everything that happens to a packet, in order. The co-simulation's scoreboards hold the RTL's node steps
/// and triangle tests against it. A method that is not overridden costs nothing.
///
/// Arrays have a place for each of [`MOST_RAYS`] rays. Of a place outside the mask that goes with it, near and far
/// have no meaning.
pub trait Observer {
    /// Whether events are made at all.
    const WATCHES: bool = true;

    /// One packet step was taken.
    fn step(&mut self, _event: &StepEvent) {}
    /// The step's second child was pushed.
    fn push(&mut self, _event: &PushEvent) {}
    /// An entry was popped, and kept or dropped.
    fn pop(&mut self, _event: &PopEvent) {}
    /// A leaf was handed over to the geometry unit.
    fn hand_over(&mut self, _event: &HandOver) {}
    /// One ray was tested against one triangle: of a leaf handed over, ray by ray from slot 0 up.
    fn test(&mut self, _event: &RayTest) {}
}

/// Watches nothing, at no cost.
impl Observer for () {
    const WATCHES: bool = false;
}

/// Rays that are together somewhere, and their intervals there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySet {
    /// Bit k for the ray in slot k.
    pub mask: u8,
    pub near: [f64; MOST_RAYS],
    pub far: [f64; MOST_RAYS],
}

/// A packet step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StepEvent {
    /// The node's index.
    pub node: u32,
    /// The rays that come, with their intervals.
    pub rays: RaySet,
    /// The rays that go left, with their intervals clipped by the left child's.
    pub left: RaySet,
    /// The rays that go right, with their intervals clipped by the right child's.
    pub right: RaySet,
    /// Of the rays that go both ways, those that go left first.
    pub left_first: u8,
    /// Where the packet goes on: the only child that a ray enters, the first of two, or none: it pops.
    pub next: Option<Target>,
}

/// The second child of a step in which the packet goes both ways.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PushEvent {
    pub child: Target,
    /// The rays that go there, with their intervals.
    pub rays: RaySet,
    /// Entries on the stack, this one included.
    pub height: u32,
}

/// An entry taken from the stack.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PopEvent {
    pub child: Target,
    /// The rays that stay, with their far bounded by their limit. None stays: the entry is dropped, the next one popped.
    pub rays: RaySet,
    /// Entries left on the stack.
    pub height: u32,
}

/// A leaf handed over to the geometry unit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HandOver {
    /// Index of the triangle's record.
    pub record: u32,
    /// The rays to test.
    pub mask: u8,
}

/// A ray–triangle test and its merge.
#[derive(Clone, Copy, Debug)]
pub struct RayTest {
    /// The ray's place in its packet.
    pub slot: u8,
    /// Index of the triangle's record.
    pub record: u32,
    /// The triangle's number in its mesh.
    pub triangle: u32,
    pub outcome: Outcome,
    /// The ray's result with this test merged.
    pub merged: Closest,
}

/// What a packet cost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Counts {
    /// Packet steps.
    pub steps: u32,
    /// Leaves handed over: a packet's triangle tests.
    pub tests: u32,
    /// Ray–triangle tests: the rays of all leaves handed over.
    pub ray_tests: u32,
    /// The most entries on the stack at one time.
    pub stack_high_water: u32,
}

/// A packet's results.
#[derive(Clone, Debug)]
pub struct PacketResult {
    /// One for each ray given.
    pub hits: Vec<Hit>,
    pub counts: Counts,
}

/// The results of many packets.
#[derive(Clone, Debug)]
pub struct FrameResult {
    /// One for each ray given, in order.
    pub hits: Vec<Hit>,
    /// One for each packet.
    pub packets: Vec<Counts>,
}

impl FrameResult {
    /// Packet steps of all packets.
    pub fn steps(&self) -> u64 {
        self.packets
            .iter()
            .map(|packet| u64::from(packet.steps))
            .sum()
    }

    /// Leaves handed over by all packets.
    pub fn tests(&self) -> u64 {
        self.packets
            .iter()
            .map(|packet| u64::from(packet.tests))
            .sum()
    }

    /// Ray–triangle tests of all packets.
    pub fn ray_tests(&self) -> u64 {
        self.packets
            .iter()
            .map(|packet| u64::from(packet.ray_tests))
            .sum()
    }

    /// The most entries on any packet's stack.
    pub fn stack_high_water(&self) -> u32 {
        self.packets
            .iter()
            .map(|packet| packet.stack_high_water)
            .max()
            .unwrap_or(0)
    }
}

/// A node decoded for traversal.
#[derive(Clone, Copy, Debug)]
struct DecodedNode {
    /// [least, greatest] coordinate of the left and the right child on their axes.
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
    triangles: Vec<Triangle>,
    root: Target,
    bounds: ([f64; 3], [f64; 3]),
}

impl Caster {
    /// Decodes an image that [`MemoryImage::check`] accepts.
    ///
    /// # Panics
    /// Where `rays_per_packet` is not 1, 2, 4 or 8, or a link or a vertex index leads outside the image.
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
        Caster {
            arithmetic: Arithmetic::new(image.format),
            test,
            rays_per_packet,
            nodes: image.nodes.iter().enumerate().map(decode).collect(),
            triangles: fetch_triangles(image),
            root: image.root.root(),
            bounds: image.bounds,
        }
    }

    pub fn rays_per_packet(&self) -> usize {
        self.rays_per_packet
    }

    /// Casts one packet, telling `observer` all that happens. Places without a ray are inactive.
    ///
    /// # Panics
    /// Where there are more rays than a packet has.
    pub fn cast(&self, rays: &[Ray], observer: &mut impl Observer) -> PacketResult {
        let mut hits = vec![Hit::MISS; rays.len()];
        let counts = self.cast_into(rays, &mut hits, observer);
        PacketResult { hits, counts }
    }

    /// Casts rays in packets, in order, on all cores; the last packet is filled up with inactive rays.
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
        match self.rays_per_packet {
            1 => self.traverse::<1, _>(rays, hits, observer),
            2 => self.traverse::<2, _>(rays, hits, observer),
            4 => self.traverse::<4, _>(rays, hits, observer),
            _ => self.traverse::<8, _>(rays, hits, observer),
        }
    }

    fn traverse<const N: usize, O: Observer>(
        &self,
        rays: &[Ray],
        hits: &mut [Hit],
        observer: &mut O,
    ) -> Counts {
        let a = &self.arithmetic;
        let rays: [RaySetup; N] =
            std::array::from_fn(|k| RaySetup::new(a, rays.get(k).unwrap_or(&Ray::INACTIVE)));
        let mut closest = [Closest::default(); N];
        let mut counts = Counts::default();

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
            return counts;
        }

        let lanes = PacketRays::new(&rays);
        let mut stack: Vec<Entry<N>> = Vec::with_capacity(64);
        let mut next = Some(self.root);
        loop {
            next = match next {
                Some(Target::Node(index)) => {
                    counts.steps += 1;
                    let node = &self.nodes[index as usize];
                    let outcome =
                        lanes.step(a, &current, node.intervals, node.axes.map(usize::from));
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
                        observer.step(&StepEvent {
                            node: index,
                            rays: RaySet::from(&current),
                            left: RaySet::from(&left),
                            right: RaySet::from(&right),
                            left_first: outcome.left_first,
                            next,
                        });
                    }
                    match (left.mask != 0, right.mask != 0) {
                        (true, true) => {
                            let (first, second, child) = if left_first {
                                (left, right, node.children[1])
                            } else {
                                (right, left, node.children[0])
                            };
                            current = first;
                            stack.push(Entry {
                                child,
                                rays: second,
                            });
                            let height = stack.len() as u32;
                            counts.stack_high_water = counts.stack_high_water.max(height);
                            if O::WATCHES {
                                observer.push(&PushEvent {
                                    child,
                                    rays: RaySet::from(&second),
                                    height,
                                });
                            }
                        }
                        (true, false) => current = left,
                        (false, _) => current = right,
                    }
                    next
                }
                Some(Target::Record(record)) => {
                    counts.tests += 1;
                    counts.ray_tests += current.mask.count_ones();
                    if O::WATCHES {
                        observer.hand_over(&HandOver {
                            record,
                            mask: current.mask,
                        });
                    }
                    let triangle = &self.triangles[record as usize];
                    let mut mask = current.mask;
                    while mask != 0 {
                        let slot = mask.trailing_zeros() as usize;
                        mask &= mask - 1;
                        let ray = &rays[slot];
                        let outcome = if O::WATCHES {
                            triangle.intersect::<true>(a, self.test, ray)
                        } else {
                            triangle.intersect::<false>(a, self.test, ray)
                        };
                        closest[slot].merge(ray, &outcome, 0, triangle.number);
                        if O::WATCHES {
                            observer.test(&RayTest {
                                slot: slot as u8,
                                record,
                                triangle: triangle.number,
                                outcome,
                                merged: closest[slot],
                            });
                        }
                    }
                    None
                }
                None => {
                    let Some(entry) = stack.pop() else {
                        break;
                    };
                    let limit = closest.map(|ray| ray.limit);
                    current = entry.rays.within(a, &limit);
                    if O::WATCHES {
                        observer.pop(&PopEvent {
                            child: entry.child,
                            rays: RaySet::from(&current),
                            height: stack.len() as u32,
                        });
                    }
                    (current.mask != 0).then_some(entry.child)
                }
            };
        }
        for (hit, closest) in hits.iter_mut().zip(&closest) {
            *hit = closest.hit;
        }
        counts
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

/// The triangles of an image's records, in the records' order.
pub(super) fn fetch_triangles(image: &MemoryImage) -> Vec<Triangle> {
    let vertex = |index: u32| image.vertices[index as usize];
    image
        .records
        .iter()
        .map(|record| Triangle::new(record.vertices.map(vertex), record.number))
        .collect()
}
