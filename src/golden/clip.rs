//! The plane distance, and clipping a ray's interval by the planes of a box.

use crate::float::Arithmetic;

/// Number of ulps by which a near distance is decreased and a far distance is increased. It covers the three roundings of the
/// plane distance, so a ray never misses the box of a triangle that it hits.
pub const SLACK_ULPS: i32 = 3;

/// The distance at which a ray meets the plane at coordinate `plane` of an axis; NaN for 0 × ∞.
#[inline(always)]
pub fn plane_distance(a: &Arithmetic, plane: f64, origin: f64, reciprocal: f64) -> f64 {
    a.mul(a.sub(plane, origin), reciprocal)
}

/// Clips [near, far] of one ray by the interval [lo, hi] of an axis. `negative` is the sign bit of the
/// direction on that axis. A NaN distance does not clip.
#[inline(always)]
pub fn clip(
    a: &Arithmetic,
    [near, far]: [f64; 2],
    [lo, hi]: [f64; 2],
    origin: f64,
    reciprocal: f64,
    negative: bool,
) -> [f64; 2] {
    let (near_plane, far_plane) = if negative { (hi, lo) } else { (lo, hi) };
    let entry = plane_distance(a, near_plane, origin, reciprocal);
    let exit = plane_distance(a, far_plane, origin, reciprocal);
    [
        a.max(near, a.step(entry, -SLACK_ULPS)),
        a.min(far, a.step(exit, SLACK_ULPS)),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float::Format;

    const ANYWHERE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

    #[test]
    fn an_interval_is_entered_by_the_plane_that_the_sign_bit_says() {
        let a = Arithmetic::new(Format::FP24);
        let ulp = 2f64.powi(-16);
        let forward = clip(&a, ANYWHERE, [1.0, 2.0], 0.0, 1.0, false);
        // Below a power of two an ulp is half as large.
        assert_eq!(forward, [1.0 - 1.5 * ulp, 2.0 + 6.0 * ulp]);
        let backward = clip(&a, ANYWHERE, [1.0, 2.0], 4.0, -1.0, true);
        assert_eq!(backward, [2.0 - 3.0 * ulp, 3.0 + 6.0 * ulp]);
    }

    #[test]
    fn a_ray_in_a_plane_is_not_clipped_by_it() {
        let a = Arithmetic::new(Format::FP24);
        for (reciprocal, negative) in [(f64::INFINITY, false), (f64::NEG_INFINITY, true)] {
            let clipped = clip(&a, ANYWHERE, [1.0, 1.0], 1.0, reciprocal, negative);
            assert_eq!(clipped, ANYWHERE);
            let beside = clip(&a, [0.0, 100.0], [1.0, 1.0], 0.0, reciprocal, negative);
            assert!(beside[0] > beside[1], "{beside:?}");
        }
    }

    #[test]
    fn clipping_only_narrows() {
        let a = Arithmetic::new(Format::FP24);
        assert_eq!(
            clip(&a, [1.5, 1.75], [1.0, 2.0], 0.0, 1.0, false),
            [1.5, 1.75]
        );
    }
}
