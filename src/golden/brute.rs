//! Brute force: tests every triangle of every instance with the transformation, test and merge of the geometry unit, without a
//! tree, a box of the scene, or packets.
//!
//! A triangle is not tested further if the ray's interval in the triangle's own box is empty, because the test then gives
//! a miss. Triangles are tested in the order of the records, which does not affect the result.

use rayon::prelude::*;

use super::geometry::{Closest, Triangle};
use super::lanes::RayLanes;
use super::raycast::fetch_triangle;
use super::setup::RaySetup;
use super::transform::{Instance, WHOLE_LINE};
use crate::bkd::layout::{InstanceRecord, LinkWord, MemoryImage};
use crate::config::TriangleTest;
use crate::float::Arithmetic;
use crate::port::{Hit, Ray};

/// Number of rays that are clipped together.
const LANES: usize = 8;

/// The triangles of an object.
///
/// # Panics
/// If the image is not valid.
fn triangles_of(image: &MemoryImage, root: LinkWord) -> Vec<Triangle> {
    let records = image.records_below(root).expect("a sound image");
    let fetch = |index: u32| fetch_triangle(image, &image.records[index as usize]);
    records.into_iter().map(fetch).collect()
}

/// Tests one ray against every triangle, in the simplest way.
///
/// # Panics
/// If the image is not valid ([`MemoryImage::check`]).
pub fn brute_force(image: &MemoryImage, test: TriangleTest, ray: &Ray) -> Hit {
    let a = Arithmetic::new(image.format);
    let ray = RaySetup::new(&a, ray);
    let mut closest = Closest::default();
    let mut meet = |root, ray: &RaySetup, window, instance| {
        for triangle in triangles_of(image, root) {
            let outcome = triangle.intersect::<true>(&a, test, ray, window);
            closest.merge(ray, &outcome, instance, triangle.number);
        }
    };
    if ray.valid && !image.is_instanced() {
        meet(image.root, &ray, WHOLE_LINE, 0);
    } else if ray.valid {
        for record in image.instance_records().expect("a sound image") {
            let instance = Instance::fetch(image, record);
            let moved = instance.transform(&a, &ray);
            if moved.ray.valid {
                let root = InstanceRecord::from(image.records[record as usize]).root;
                meet(root, &moved.ray, moved.window, instance.number);
            }
        }
    }
    closest.hit
}

/// A triangle that is not degenerate, and the \[minimum, maximum] coordinate of its box on each axis.
type BoxedTriangle = (Triangle, [[f64; 2]; 3]);

/// [`brute_force`] for many rays on all cores, several rays at a time, with the same results.
#[derive(Clone, Debug)]
pub struct BruteForce {
    arithmetic: Arithmetic,
    test: TriangleTest,
    objects: Vec<Vec<BoxedTriangle>>,
    /// Each instance with its object's index in `objects`; empty in a scene of one level, which has one object in the world.
    instances: Vec<(Instance, usize)>,
}

impl BruteForce {
    /// # Panics
    /// If the image is not valid ([`MemoryImage::check`]).
    pub fn new(image: &MemoryImage, test: TriangleTest) -> Self {
        let records = image.instance_records().expect("a sound image");
        let root_of = |record: u32| InstanceRecord::from(image.records[record as usize]).root;
        let mut roots = Vec::new();
        let mut instances = Vec::new();
        for record in records {
            let root = root_of(record);
            let object = roots.iter().position(|&known| known == root);
            let object = object.unwrap_or_else(|| {
                roots.push(root);
                roots.len() - 1
            });
            instances.push((Instance::fetch(image, record), object));
        }
        if !image.is_instanced() {
            roots.push(image.root);
        }
        let boxed = |triangle: Triangle| {
            let (lo, hi) = triangle.bounds();
            (triangle, [0, 1, 2].map(|i| [lo[i], hi[i]]))
        };
        let object = |root: LinkWord| {
            let triangles = triangles_of(image, root).into_iter();
            triangles.filter(|t| !t.degenerate).map(boxed).collect()
        };
        BruteForce {
            arithmetic: Arithmetic::new(image.format),
            test,
            objects: roots.into_iter().map(object).collect(),
            instances,
        }
    }

    /// The hits of rays, in order. It is fastest if neighbouring rays are similar.
    pub fn cast(&self, rays: &[Ray]) -> Vec<Hit> {
        let mut hits = vec![Hit::MISS; rays.len()];
        rays.par_chunks(LANES)
            .zip(hits.par_chunks_mut(LANES))
            .for_each(|(rays, hits)| self.cast_group(rays, hits));
        hits
    }

    fn cast_group(&self, rays: &[Ray], hits: &mut [Hit]) {
        let a = &self.arithmetic;
        let rays: [RaySetup; LANES] =
            std::array::from_fn(|k| RaySetup::new(a, rays.get(k).unwrap_or(&Ray::INACTIVE)));
        let mut closest = [Closest::default(); LANES];
        if self.instances.is_empty() {
            self.meet(
                &self.objects[0],
                &rays,
                [WHOLE_LINE; LANES],
                0,
                &mut closest,
            );
        }
        for (instance, object) in &self.instances {
            let moved = rays.each_ref().map(|ray| instance.transform(a, ray));
            let windows = moved.each_ref().map(|moved| moved.window);
            self.meet(
                &self.objects[*object],
                &moved.map(|moved| moved.ray),
                windows,
                instance.number,
                &mut closest,
            );
        }
        for (hit, closest) in hits.iter_mut().zip(&closest) {
            *hit = closest.hit;
        }
    }

    /// Merges the hits of rays in object space with an object.
    fn meet(
        &self,
        object: &[BoxedTriangle],
        rays: &[RaySetup; LANES],
        windows: [[f64; 2]; LANES],
        instance: u32,
        closest: &mut [Closest; LANES],
    ) {
        let a = &self.arithmetic;
        let lanes = RayLanes::new(rays);
        for (triangle, intervals) in object {
            let mut near = windows.map(|[near, _]| near);
            let mut far = windows.map(|[_, far]| far);
            // near only grows and far only falls, so empty intervals stay empty.
            let mut some = true;
            for (axis, interval) in intervals.iter().enumerate() {
                lanes.clip(a, &mut near, &mut far, *interval, axis);
                some = (0..LANES).fold(false, |some, k| some | (near[k] <= far[k]));
                if !some {
                    break;
                }
            }
            if !some {
                continue;
            }
            for k in 0..LANES {
                if near[k] <= far[k] && rays[k].valid {
                    let outcome = triangle.intersect::<false>(a, self.test, &rays[k], windows[k]);
                    closest[k].merge(&rays[k], &outcome, instance, triangle.number);
                }
            }
        }
    }
}
