//! The ray transformation: a ray of the world in an instance's object space, and its window there.

use super::setup::RaySetup;
use crate::bkd::Columns;
use crate::bkd::layout::{InstanceRecord, MemoryImage, Target};
use crate::float::Arithmetic;
use crate::port::Ray;

/// The window of a ray that is in no instance; it excludes nothing.
pub const WHOLE_LINE: [f64; 2] = [f64::NEG_INFINITY, f64::INFINITY];

/// A fetched instance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// The columns c_x, c_y, c_z, c_w of the matrix that transforms a point of the world into object space.
    pub columns: Columns,
    /// Minimum and maximum corner of its box in the world.
    pub bounds: ([f64; 3], [f64; 3]),
    /// Its object's root.
    pub root: Target,
    /// Its number in the scene, which is used in results and to resolve ties.
    pub number: u32,
}

/// A ray transformed for an instance.
#[derive(Clone, Copy, Debug)]
pub struct Transformed {
    /// The ray in object space; limits and kind are unchanged. It is valid unless a component is a NaN.
    pub ray: RaySetup,
    /// Its interval in the instance's box, from (−∞, +∞).
    pub window: [f64; 2],
    /// tmin and tmax clipped by the window: the interval in which the object's tree is entered.
    pub near: f64,
    pub far: f64,
    pub enters: bool,
}

impl Instance {
    /// Fetches the instance of a record and its six vectors.
    ///
    /// # Panics
    /// If the record or a vector is not in the image.
    pub fn fetch(image: &MemoryImage, record: u32) -> Self {
        let record = InstanceRecord::from(image.records[record as usize]);
        let vector = |k: usize| image.vertices[record.vectors as usize + k];
        Instance {
            columns: [0, 1, 2, 3].map(vector),
            bounds: (vector(4), vector(5)),
            root: record.root.root(),
            number: record.number,
        }
    }

    /// Transforms a valid ray of the world into object space.
    pub fn transform(&self, a: &Arithmetic, ray: &RaySetup) -> Transformed {
        let (lo, hi) = self.bounds;
        let window = ray.clip_box(a, WHOLE_LINE, lo, hi);
        let [cx, cy, cz, cw] = self.columns;
        let [ox, oy, oz] = ray.origin;
        let [dx, dy, dz] = ray.direction;
        let origin = [0, 1, 2].map(|i| {
            let xy = a.add(a.mul(cx[i], ox), a.mul(cy[i], oy));
            a.add(a.add(xy, a.mul(cz[i], oz)), cw[i])
        });
        let direction = [0, 1, 2].map(|i| {
            let xy = a.add(a.mul(cx[i], dx), a.mul(cy[i], dy));
            a.add(xy, a.mul(cz[i], dz))
        });
        let ray = RaySetup::new(
            a,
            &Ray {
                origin,
                direction,
                tmin: ray.tmin,
                tmax: ray.tmax,
                active: ray.valid,
                any_hit: ray.any_hit,
            },
        );
        let near = a.max(ray.tmin, window[0]);
        let far = a.min(ray.tmax, window[1]);
        Transformed {
            ray,
            window,
            near,
            far,
            enters: ray.valid && near <= far,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float::Format;

    const INSTANCE: Instance = Instance {
        // Maps x to y and y to −x, doubles z, then translates by (1, 2, 3).
        columns: [
            [0.0, 1.0, 0.0],
            [-1.0, 0.0, 0.0],
            [0.0, 0.0, 2.0],
            [1.0, 2.0, 3.0],
        ],
        bounds: ([-1.0; 3], [1.0; 3]),
        root: Target::Record(0),
        number: 0,
    };

    fn transform(origin: [f64; 3], direction: [f64; 3], tmin: f64, tmax: f64) -> Transformed {
        let a = Arithmetic::new(Format::FP24);
        let ray = Ray {
            origin,
            direction,
            tmin,
            tmax,
            active: true,
            any_hit: false,
        };
        INSTANCE.transform(&a, &RaySetup::new(&a, &ray))
    }

    #[test]
    fn a_ray_is_moved_and_clipped_by_the_box_in_the_world() {
        let ulp = 2f64.powi(-16);
        let moved = transform([0.0, 0.5, -4.0], [0.0, 0.0, 2.0], 0.0, 2.0);
        assert_eq!(moved.ray.origin, [0.5, 2.0, -5.0]);
        assert_eq!(moved.ray.direction, [0.0, 0.0, 4.0]);
        // −1 and 1 are at 1.5 and 2.5 times the direction in the world, each moved outwards by three ulps.
        assert_eq!(moved.window, [1.5 - 3.0 * ulp, 2.5 + 6.0 * ulp]);
        assert_eq!((moved.near, moved.far), (moved.window[0], 2.0));
        assert!(moved.enters && moved.ray.valid && moved.ray.tmax == 2.0);
    }

    #[test]
    fn a_ray_that_misses_the_box_or_is_a_nan_does_not_enter() {
        let forever = f64::INFINITY;
        let inside = [0.5, 0.25, 0.0];
        assert!(transform(inside, [0.0, 1.0, 0.0], 0.0, forever).enters);
        let beside = transform([2.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.0, forever);
        assert!(beside.ray.valid && !beside.enters);
        let past = transform(inside, [0.0, 1.0, 0.0], 4.0, forever);
        assert!(past.ray.valid && !past.enters);
        // 0 × ∞ for a coefficient of zero.
        let endless = transform(inside, [0.0, forever, 0.0], 0.0, forever);
        assert!(endless.ray.direction[1].is_nan());
        assert!(!endless.ray.valid && !endless.enters);
    }
}
