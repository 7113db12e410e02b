//! Clips N rays at once.

use super::clip::clip;
use super::setup::RaySetup;
use crate::float::Arithmetic;

/// The inputs of clipping for N rays, by axis and lane.
#[derive(Clone, Copy, Debug)]
pub struct RayLanes<const N: usize> {
    pub origin: [[f64; N]; 3],
    pub reciprocal: [[f64; N]; 3],
    pub negative: [[bool; N]; 3],
}

impl<const N: usize> RayLanes<N> {
    pub fn new(rays: &[RaySetup; N]) -> Self {
        RayLanes {
            origin: [0, 1, 2].map(|axis| rays.each_ref().map(|ray| ray.origin[axis])),
            reciprocal: [0, 1, 2].map(|axis| rays.each_ref().map(|ray| ray.reciprocal[axis])),
            negative: [0, 1, 2].map(|axis| rays.each_ref().map(|ray| ray.negative[axis])),
        }
    }

    /// [`clip`] in every lane.
    #[inline(always)]
    pub fn clip(
        &self,
        a: &Arithmetic,
        near: &mut [f64; N],
        far: &mut [f64; N],
        interval: [f64; 2],
        axis: usize,
    ) {
        #[cfg(target_arch = "x86_64")]
        if N >= 4 && is_x86_feature_detected!("avx2") {
            // SAFETY: the processor has the features that the function needs.
            return unsafe { self.clip_with_avx2(a, near, far, interval, axis) };
        }
        self.clip_anywhere(a, near, far, interval, axis);
    }

    /// [`Self::clip_anywhere`] as vector instructions. It must not be inlined, or it would be compiled without them.
    #[cfg(target_arch = "x86_64")]
    #[target_feature(enable = "avx2")]
    #[inline(never)]
    unsafe fn clip_with_avx2(
        &self,
        a: &Arithmetic,
        near: &mut [f64; N],
        far: &mut [f64; N],
        interval: [f64; 2],
        axis: usize,
    ) {
        self.clip_anywhere(a, near, far, interval, axis);
    }

    #[inline(always)]
    fn clip_anywhere(
        &self,
        a: &Arithmetic,
        near: &mut [f64; N],
        far: &mut [f64; N],
        interval: [f64; 2],
        axis: usize,
    ) {
        let (origin, reciprocal) = (&self.origin[axis], &self.reciprocal[axis]);
        let negative = &self.negative[axis];
        for k in 0..N {
            [near[k], far[k]] = clip(
                a,
                [near[k], far[k]],
                interval,
                origin[k],
                reciprocal[k],
                negative[k],
            );
        }
    }
}
