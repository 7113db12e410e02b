//! The traversal unit: the decisions of one packet step, and the treatment of a popped entry.
//!
//! A packet's N rays are lanes of arrays; bit k of a mask is lane k. The near and far of a lane outside a
//! mask are undefined.

use super::lanes::RayLanes;
use crate::bkd::layout::Target;
use crate::float::Arithmetic;

/// A set of rays, and their intervals.
#[derive(Clone, Copy, Debug)]
pub struct Lanes<const N: usize> {
    pub mask: u8,
    pub near: [f64; N],
    pub far: [f64; N],
}

/// A stack entry: a child for later, and the rays that enter it.
#[derive(Clone, Copy, Debug)]
pub struct Entry<const N: usize> {
    pub child: Target,
    /// Whether the child is in an object's tree below the top level; its rays are then in object space.
    pub inside: bool,
    pub rays: Lanes<N>,
}

/// The result of one packet step. The packet enters a child if its mask is not empty.
#[derive(Clone, Copy, Debug)]
pub struct StepOutcome<const N: usize> {
    pub left: Lanes<N>,
    pub right: Lanes<N>,
    /// The rays that enter both children, the left one first.
    pub left_first: u8,
}

impl<const N: usize> Lanes<N> {
    /// Performs one packet step: clips all rays by both children's intervals.
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

    /// The rays whose interval is not empty after clipping by a child's interval.
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

    /// The remaining rays of a popped entry, with their far bounded by each lane's `limit`.
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

/// The mask of the lanes for which `holds` is true.
#[inline(always)]
fn mask_where(holds: impl Fn(usize) -> bool, lanes: usize) -> u8 {
    (0..lanes).fold(0, |mask, k| mask | u8::from(holds(k)) << k)
}
