//! Brute force: every triangle by the geometry unit's very test and merge; no tree, no box of the scene, no packets.
//!
//! A triangle that the ray's interval in the triangle's own box rules out is not tested further: that is the test's
//! own outcome. Triangles go by in the records' order, whose effect on the result is none.

use rayon::prelude::*;

use super::clip::RayLanes;
use super::geometry::{Closest, Triangle};
use super::raycast::fetch_triangles;
use super::setup::RaySetup;
use crate::bkd::layout::MemoryImage;
use crate::config::TriangleTest;
use crate::float::Arithmetic;
use crate::port::{Hit, Ray};

/// Rays whose boxes are clipped side by side.
const LANES: usize = 8;

/// Tests one ray against every triangle, in the plainest way.
pub fn brute_force(image: &MemoryImage, test: TriangleTest, ray: &Ray) -> Hit {
    let a = Arithmetic::new(image.format);
    let ray = RaySetup::new(&a, ray);
    let mut closest = Closest::default();
    if ray.valid {
        for triangle in fetch_triangles(image) {
            let outcome = triangle.intersect::<true>(&a, test, &ray);
            closest.merge(&ray, &outcome, 0, triangle.number);
        }
    }
    closest.hit
}

/// [`brute_force`] for many rays: the same result, on all cores, several rays at a time.
#[derive(Clone, Debug)]
pub struct BruteForce {
    arithmetic: Arithmetic,
    test: TriangleTest,
    /// Those that are not degenerate, each with its box.
    triangles: Vec<(Triangle, [[f64; 2]; 3])>,
}

impl BruteForce {
    pub fn new(image: &MemoryImage, test: TriangleTest) -> Self {
        let boxed = |triangle: Triangle| {
            let (lo, hi) = triangle.bounds();
            (triangle, [0, 1, 2].map(|i| [lo[i], hi[i]]))
        };
        BruteForce {
            arithmetic: Arithmetic::new(image.format),
            test,
            triangles: fetch_triangles(image)
                .into_iter()
                .filter(|triangle| !triangle.degenerate)
                .map(boxed)
                .collect(),
        }
    }

    /// The hits of rays, in order. Rays that are alike and neighbours are fastest.
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
        let lanes = RayLanes::new(&rays);
        let mut closest = [Closest::default(); LANES];
        for (triangle, intervals) in &self.triangles {
            let mut near = [f64::NEG_INFINITY; LANES];
            let mut far = [f64::INFINITY; LANES];
            // near only grows and far only falls: once all are empty they stay so.
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
                    let outcome = triangle.intersect::<false>(a, self.test, &rays[k]);
                    closest[k].merge(&rays[k], &outcome, 0, triangle.number);
                }
            }
        }
        for (hit, closest) in hits.iter_mut().zip(&closest) {
            *hit = closest.hit;
        }
    }
}
