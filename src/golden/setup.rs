//! Ray setup: the computations once per ray before its packet is traversed.

use super::clip::clip;
use crate::float::Arithmetic;
use crate::port::Ray;

/// A ray as the traversal unit and the geometry unit receive it.
#[derive(Clone, Copy, Debug)]
pub struct RaySetup {
    pub origin: [f64; 3],
    pub direction: [f64; 3],
    /// The sign bit of each component of the direction, set for −0 too.
    pub negative: [bool; 3],
    /// 1 ÷ each component of the direction.
    pub reciprocal: [f64; 3],
    /// The ray's limits; a zero is +0.
    pub tmin: f64,
    pub tmax: f64,
    pub any_hit: bool,
    /// Whether the ray can hit anything: it is active, has no NaN, and 0 ≤ tmin ≤ tmax.
    pub valid: bool,
    pub shear: Shear,
}

/// The shear with which the watertight test aligns the ray with the third axis. Defined only for a valid ray.
#[derive(Clone, Copy, Debug)]
pub struct Shear {
    /// k_x, k_y, k_z: 0 = x, 1 = y, 2 = z; k_z is the axis of the direction's largest component.
    pub axes: [u8; 3],
    /// S_x, S_y, S_z.
    pub scale: [f64; 3],
}

impl RaySetup {
    pub fn new(a: &Arithmetic, ray: &Ray) -> Self {
        let positive_zero = |x: f64| if x == 0.0 { 0.0 } else { x };
        let tmin = positive_zero(ray.tmin);
        let tmax = positive_zero(ray.tmax);
        let numbers = ray.origin.iter().chain(&ray.direction);
        let nan = numbers.chain([&tmin, &tmax]).any(|x| x.is_nan());
        let reciprocal = ray.direction.map(|d| a.reciprocal(d));
        RaySetup {
            origin: ray.origin,
            direction: ray.direction,
            negative: ray.direction.map(f64::is_sign_negative),
            reciprocal,
            tmin,
            tmax,
            any_hit: ray.any_hit,
            valid: ray.active && !nan && 0.0 <= tmin && tmin <= tmax,
            shear: Shear::new(a, ray.direction, reciprocal),
        }
    }

    /// The ray's interval from tmin to tmax, clipped by the scene's box with the given minimum and maximum corner.
    /// The ray misses the scene if near is greater than far.
    pub fn enter_scene(&self, a: &Arithmetic, (lo, hi): ([f64; 3], [f64; 3])) -> [f64; 2] {
        self.clip_box(a, [self.tmin, self.tmax], lo, hi)
    }

    /// Clips an interval by a box: on axis x, then y, then z.
    #[inline(always)]
    pub(super) fn clip_box(
        &self,
        a: &Arithmetic,
        mut interval: [f64; 2],
        lo: [f64; 3],
        hi: [f64; 3],
    ) -> [f64; 2] {
        for i in 0..3 {
            interval = clip(
                a,
                interval,
                [lo[i], hi[i]],
                self.origin[i],
                self.reciprocal[i],
                self.negative[i],
            );
        }
        interval
    }
}

impl Shear {
    fn new(a: &Arithmetic, direction: [f64; 3], reciprocal: [f64; 3]) -> Self {
        let mut kz = 0;
        for axis in 1..3 {
            if direction[axis].abs() > direction[kz].abs() {
                kz = axis;
            }
        }
        let (kx, ky) = ((kz + 1) % 3, (kz + 2) % 3);
        Shear {
            axes: [kx as u8, ky as u8, kz as u8],
            scale: [
                a.mul(direction[kx], reciprocal[kz]),
                a.mul(direction[ky], reciprocal[kz]),
                reciprocal[kz],
            ],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float::Format;

    fn setup(ray: Ray) -> RaySetup {
        RaySetup::new(&Arithmetic::new(Format::FP24), &ray)
    }

    const RAY: Ray = Ray {
        origin: [0.0; 3],
        direction: [1.0, -2.0, 2.0],
        tmin: 0.0,
        tmax: f64::INFINITY,
        active: true,
        any_hit: false,
    };

    #[test]
    fn only_sound_rays_are_valid() {
        assert!(setup(RAY).valid);
        let bad = [
            Ray {
                active: false,
                ..RAY
            },
            Ray { tmin: -1.0, ..RAY },
            Ray {
                tmin: 2.0,
                tmax: 1.0,
                ..RAY
            },
            Ray {
                tmin: f64::NAN,
                ..RAY
            },
            Ray {
                tmax: f64::NAN,
                ..RAY
            },
            Ray {
                origin: [0.0, f64::NAN, 0.0],
                ..RAY
            },
            Ray {
                direction: [0.0, 1.0, f64::NAN],
                ..RAY
            },
        ];
        for ray in bad {
            assert!(!setup(ray).valid, "{ray:?}");
        }
        let zero = setup(Ray {
            tmin: -0.0,
            tmax: -0.0,
            ..RAY
        });
        assert!(zero.valid && zero.tmin.is_sign_positive() && zero.tmax.is_sign_positive());
    }

    #[test]
    fn the_first_of_the_greatest_components_is_the_shear_axis() {
        let shear = setup(RAY).shear;
        assert_eq!(shear.axes, [2, 0, 1]);
        assert_eq!(shear.scale, [-1.0, -0.5, -0.5]);
        let equal = Ray {
            direction: [1.0; 3],
            ..RAY
        };
        assert_eq!(setup(equal).shear.axes, [1, 2, 0]);
    }

    #[test]
    fn sign_bits_count_for_zeros() {
        let ray = setup(Ray {
            direction: [-0.0, 0.0, 1.0],
            ..RAY
        });
        assert_eq!(ray.negative, [true, false, false]);
        assert_eq!(ray.reciprocal, [f64::NEG_INFINITY, f64::INFINITY, 1.0]);
    }
}
