//! The traversal processing unit: what one packet step decides, and what becomes of a popped entry.
//!
//! A packet's N rays are lanes of arrays; a mask's bit k stands for lane k. The near and far of a lane outside a
//! mask have no meaning.

use super::lanes::RayLanes;
use crate::bkd::layout::Target;
use crate::float::Arithmetic;

/// Rays that go somewhere together, and their intervals there.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<const N: usize> {
    pub mask: u8,
    pub near: [f64; N],
    pub far: [f64; N],
}

/// A stack entry: a child put off, and the rays that go there.
#[derive(Clone, Copy, Debug)]
pub struct Entry<const N: usize> {
    pub child: Target,
    /// Whether the child is in an object's tree below the top level: the rays go there in the object's space.
    pub inside: bool,
    pub rays: Lanes<N>,
}

/// What one packet step computes. The packet goes to a side if its mask is not empty.
#[derive(Clone, Copy, Debug)]
pub struct StepOutcome<const N: usize> {
    pub left: Lanes<N>,
    pub right: Lanes<N>,
    /// Of the rays that go both ways, those that go left first.
    pub left_first: u8,
}

impl<const N: usize> Lanes<N> {
    /// One packet step: both children's intervals and axes against all rays.
    #[inline(always)]
    pub fn step(
        &self,
        a: &Arithmetic,
        rays: &RayLanes<N>,
        intervals: [[f64; 2]; 2],
        axes: [usize; 2],
    ) -> StepOutcome<N> {
        let left = self.enter(a, rays, intervals[0], axes[0]);
        let right = self.enter(a, rays, intervals[1], axes[1]);
        let nearer = mask_where(|k| left.near[k] <= right.near[k], N);
        StepOutcome {
            left_first: left.mask & right.mask & nearer,
            left,
            right,
        }
    }

    /// The rays whose interval, clipped by a child's, is not empty.
    #[inline(always)]
    fn enter(
        &self,
        a: &Arithmetic,
        rays: &RayLanes<N>,
        interval: [f64; 2],
        axis: usize,
    ) -> Lanes<N> {
        let mut entered = *self;
        rays.clip(a, &mut entered.near, &mut entered.far, interval, axis);
        entered.mask &= mask_where(|k| entered.near[k] <= entered.far[k], N);
        entered
    }

    /// The rays of a popped entry that stay, their far bounded by each lane's `limit`.
    #[inline(always)]
    pub fn within(&self, a: &Arithmetic, limit: &[f64; N]) -> Lanes<N> {
        let mut rays = *self;
        for (far, &limit) in rays.far.iter_mut().zip(limit) {
            *far = a.min(*far, limit);
        }
        rays.mask &= mask_where(|k| self.near[k] <= limit[k], N);
        rays
    }
}

/// The mask of the lanes of which `holds` is true.
#[inline(always)]
fn mask_where(holds: impl Fn(usize) -> bool, lanes: usize) -> u8 {
    (0..lanes).fold(0, |mask, k| mask | u8::from(holds(k)) << k)
}
