//! The geometry unit: the test of a ray against a triangle, and the merge of a hit into the ray's result.

use super::setup::RaySetup;
use crate::config::TriangleTest;
use crate::float::Arithmetic;
use crate::port::Hit;

/// A fetched triangle, as the test and its box need it.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// In the order of the record.
    pub vertices: [[f64; 3]; 3],
    /// The triangle's number in its mesh, which is used in results and to resolve ties.
    pub number: u32,
    /// Whether the triangle has two equal vertices, or a box without extent on two axes. It is then never hit.
    pub degenerate: bool,
}

/// The result of a ray–triangle test.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    pub hit: bool,
    /// t, u and v as the triangle test computes them, before t is clamped. For a miss they are undefined.
    pub raw: [f64; 3],
    /// The ray's interval in the triangle's own box, within its window.
    pub near: f64,
    pub far: f64,
    /// t clamped to that interval: the distance of a hit.
    pub t: f64,
}

/// The current result of a ray.
#[derive(Clone, Copy, Debug)]
pub struct Closest {
    pub hit: Hit,
    /// Upper bound for the near of a popped entry.
    pub limit: f64,
}

impl Triangle {
    pub fn new(vertices: [[f64; 3]; 3], number: u32) -> Self {
        let mut triangle = Triangle {
            vertices,
            number,
            degenerate: false,
        };
        let [v0, v1, v2] = vertices;
        let (lo, hi) = triangle.bounds();
        let flat_axes = (0..3).filter(|&i| lo[i] == hi[i]).count();
        triangle.degenerate = v0 == v1 || v1 == v2 || v2 == v0 || flat_axes >= 2;
        triangle
    }

    /// Minimum and maximum corner of the triangle's box.
    #[inline(always)]
    pub fn bounds(&self) -> ([f64; 3], [f64; 3]) {
        let [v0, v1, v2] = &self.vertices;
        let pick = |first: f64, second: f64, keep: fn(&f64, &f64) -> bool| {
            if keep(&second, &first) { second } else { first }
        };
        let mut lo = [0.0; 3];
        let mut hi = [0.0; 3];
        for i in 0..3 {
            lo[i] = pick(pick(v0[i], v1[i], f64::lt), v2[i], f64::lt);
            hi[i] = pick(pick(v0[i], v1[i], f64::gt), v2[i], f64::gt);
        }
        (lo, hi)
    }

    /// Tests a ray with a window: [`super::Transformed::window`] in an instance, otherwise [`super::WHOLE_LINE`]. Without `WHOLE` it
    /// stops as soon as a miss is certain; for a miss only `hit` is then defined. The result is the same.
    #[inline(always)]
    pub fn intersect<const WHOLE: bool>(
        &self,
        a: &Arithmetic,
        test: TriangleTest,
        ray: &RaySetup,
        window: [f64; 2],
    ) -> Outcome {
        let mut outcome = Outcome {
            hit: false,
            raw: [f64::NAN; 3],
            near: window[0],
            far: window[1],
            t: f64::NAN,
        };
        if !WHOLE && self.degenerate {
            return outcome;
        }
        let (lo, hi) = self.bounds();
        [outcome.near, outcome.far] = ray.clip_box(a, [outcome.near, outcome.far], lo, hi);
        if !WHOLE && outcome.near > outcome.far {
            return outcome;
        }
        let inside;
        (inside, outcome.raw) = match test {
            TriangleTest::MollerTrumbore => self.moller_trumbore::<WHOLE>(a, ray),
            TriangleTest::Watertight => self.watertight::<WHOLE>(a, ray),
        };
        outcome.t = outcome.raw[0];
        if outcome.t < outcome.near {
            outcome.t = outcome.near;
        }
        if outcome.t > outcome.far {
            outcome.t = outcome.far;
        }
        outcome.hit = inside
            && !self.degenerate
            && outcome.near <= outcome.far
            && !outcome.raw[0].is_nan()
            && ray.tmin <= outcome.t
            && outcome.t <= ray.tmax
            && outcome.t < f64::INFINITY;
        outcome
    }

    /// Whether the ray's line passes through the triangle, and t, u, v.
    #[inline(always)]
    pub(crate) fn moller_trumbore<const WHOLE: bool>(
        &self,
        a: &Arithmetic,
        ray: &RaySetup,
    ) -> (bool, [f64; 3]) {
        let [v0, v1, v2] = self.vertices;
        let d = ray.direction;
        let e1 = sub(a, v1, v0);
        let e2 = sub(a, v2, v0);
        let c = sub(a, ray.origin, v0);
        let p = cross(a, d, e2);
        let det = dot(a, e1, p);
        let i = a.reciprocal(det);
        let u = a.mul(dot(a, c, p), i);
        if !WHOLE && !(0.0..=1.0).contains(&u) {
            // As v ≥ 0, u + v ≤ 1 implies u ≤ 1.
            return (false, [f64::NAN; 3]);
        }
        let q = cross(a, c, e1);
        let v = a.mul(dot(a, d, q), i);
        let t = a.mul(dot(a, e2, q), i);
        let inside = u >= 0.0 && v >= 0.0 && a.add(u, v) <= 1.0 && det != 0.0;
        (inside, [t, u, v])
    }

    /// Whether the ray's line passes through the triangle, and t, u, v.
    #[inline(always)]
    pub(crate) fn watertight<const WHOLE: bool>(
        &self,
        a: &Arithmetic,
        ray: &RaySetup,
    ) -> (bool, [f64; 3]) {
        let [kx, ky, kz] = ray.shear.axes.map(usize::from);
        let [sx, sy, sz] = ray.shear.scale;
        let sheared = self.vertices.map(|vertex| {
            let p = sub(a, vertex, ray.origin);
            [
                a.sub(p[kx], a.mul(sx, p[kz])),
                a.sub(p[ky], a.mul(sy, p[kz])),
                p[kz],
            ]
        });
        let [[ax, ay, az], [bx, by, bz], [cx, cy, cz]] = sheared;
        let u = a.sub(a.mul(cx, by), a.mul(cy, bx));
        let v = a.sub(a.mul(ax, cy), a.mul(ay, cx));
        let w = a.sub(a.mul(bx, ay), a.mul(by, ax));
        let some_negative = u < 0.0 || v < 0.0 || w < 0.0;
        let some_positive = u > 0.0 || v > 0.0 || w > 0.0;
        if !WHOLE && some_negative && some_positive {
            return (false, [f64::NAN; 3]);
        }
        let det = a.add(a.add(u, v), w);
        let i = a.reciprocal(det);
        let distance = a.add(a.add(a.mul(u, az), a.mul(v, bz)), a.mul(w, cz));
        let t = a.mul(a.mul(distance, i), sz);
        let inside = !(some_negative && some_positive) && det != 0.0;
        (inside, [t, a.mul(v, i), a.mul(w, i)])
    }
}

impl Default for Closest {
    /// No hit yet.
    fn default() -> Self {
        Closest {
            hit: Hit::MISS,
            limit: f64::INFINITY,
        }
    }
}

impl Closest {
    /// Merges a test's outcome; a miss changes nothing.
    #[inline(always)]
    pub fn merge(&mut self, ray: &RaySetup, outcome: &Outcome, instance: u32, triangle: u32) {
        if !outcome.hit {
            return;
        }
        if ray.any_hit {
            self.hit = Hit::any(ray.tmin);
            self.limit = f64::NEG_INFINITY;
            return;
        }
        let nearer = outcome.t < self.hit.t;
        let lower = (instance, triangle) < (self.hit.instance, self.hit.triangle);
        if nearer || outcome.t == self.hit.t && lower {
            self.hit = Hit {
                t: outcome.t,
                u: outcome.raw[1],
                v: outcome.raw[2],
                instance,
                triangle,
            };
            self.limit = outcome.t;
        }
    }
}

#[inline(always)]
fn sub(a: &Arithmetic, x: [f64; 3], y: [f64; 3]) -> [f64; 3] {
    [a.sub(x[0], y[0]), a.sub(x[1], y[1]), a.sub(x[2], y[2])]
}

#[inline(always)]
fn cross(a: &Arithmetic, x: [f64; 3], y: [f64; 3]) -> [f64; 3] {
    [
        a.sub(a.mul(x[1], y[2]), a.mul(x[2], y[1])),
        a.sub(a.mul(x[2], y[0]), a.mul(x[0], y[2])),
        a.sub(a.mul(x[0], y[1]), a.mul(x[1], y[0])),
    ]
}

#[inline(always)]
fn dot(a: &Arithmetic, x: [f64; 3], y: [f64; 3]) -> f64 {
    a.add(
        a.add(a.mul(x[0], y[0]), a.mul(x[1], y[1])),
        a.mul(x[2], y[2]),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float::Format;
    use crate::golden::WHOLE_LINE;
    use crate::port::Ray;

    const BOTH: [TriangleTest; 2] = [TriangleTest::MollerTrumbore, TriangleTest::Watertight];

    fn ray(direction: [f64; 3], tmin: f64, tmax: f64) -> RaySetup {
        let ray = Ray {
            origin: [0.0; 3],
            direction,
            tmin,
            tmax,
            active: true,
            any_hit: false,
        };
        RaySetup::new(&Arithmetic::new(Format::FP24), &ray)
    }

    fn test_both(triangle: &Triangle, ray: &RaySetup) -> [Outcome; 2] {
        let a = Arithmetic::new(Format::FP24);
        BOTH.map(|test| {
            let whole = triangle.intersect::<true>(&a, test, ray, WHOLE_LINE);
            let early = triangle.intersect::<false>(&a, test, ray, WHOLE_LINE);
            assert_eq!(whole.hit, early.hit);
            if whole.hit {
                assert_eq!((whole.t, whole.raw), (early.t, early.raw));
            }
            whole
        })
    }

    #[test]
    fn limits_are_within() {
        let triangle = Triangle::new([[-1.0, -1.0, 2.0], [3.0, -1.0, 2.0], [-1.0, 3.0, 2.0]], 0);
        let limits = [
            (0.0, f64::INFINITY, true),
            (2.0, 2.0, true),
            (2.25, 3.0, false),
            (0.0, 1.75, false),
        ];
        for (tmin, tmax, hit) in limits {
            for outcome in test_both(&triangle, &ray([0.0, 0.0, 1.0], tmin, tmax)) {
                assert_eq!((outcome.hit, outcome.t), (hit, 2.0), "{tmin} {tmax}");
            }
        }
        for outcome in test_both(&triangle, &ray([0.0, 0.0, -1.0], 0.0, f64::INFINITY)) {
            assert!(!outcome.hit && outcome.t == -2.0);
        }
    }

    #[test]
    fn a_hit_outside_the_window_is_moved_to_it() {
        let a = Arithmetic::new(Format::FP24);
        let triangle = Triangle::new([[-1.0, -1.0, 2.0], [3.0, -1.0, 2.0], [-1.0, 3.0, 2.0]], 0);
        let ulp = 2f64.powi(-15);
        let cases = [
            ([1.0, 3.0], Some(2.0)),
            ([2.0 + ulp, 3.0], Some(2.0 + ulp)),
            ([1.0, 2.0 - ulp], Some(2.0 - ulp)),
            // The interval beyond the slack of the triangle's own box is empty.
            ([2.0 + 4.0 * ulp, 3.0], None),
            ([3.0, 1.0], None),
        ];
        for (window, t) in cases {
            for test in BOTH {
                let ray = ray([0.0, 0.0, 1.0], 0.0, f64::INFINITY);
                let whole = triangle.intersect::<true>(&a, test, &ray, window);
                let early = triangle.intersect::<false>(&a, test, &ray, window);
                assert_eq!((whole.hit, early.hit), (t.is_some(), t.is_some()));
                assert!(t.is_none_or(|t| whole.t == t && early.t == t), "{window:?}");
            }
        }
    }

    #[test]
    fn degenerate_triangles_never_hit() {
        let flat = [
            [[1.0, 1.0, 1.0]; 3],
            [[1.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 2.0, 1.0]],
            [[1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [1.0, 2.0, 1.0]],
        ];
        for vertices in flat {
            let triangle = Triangle::new(vertices, 0);
            assert!(triangle.degenerate);
            for outcome in test_both(&triangle, &ray([1.0, 1.0, 1.0], 0.0, f64::INFINITY)) {
                assert!(!outcome.hit);
            }
        }
        // A line that is oblique to all axes is not recognised as degenerate; the tests must handle it.
        let line = Triangle::new([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0], [3.0, 3.0, 3.0]], 0);
        assert!(!line.degenerate);
        test_both(&line, &ray([1.0, 1.0, 1.0], 0.0, f64::INFINITY));
    }

    #[test]
    fn of_equal_hits_the_lowest_number_stays() {
        let ray = ray([0.0, 0.0, 1.0], 0.0, f64::INFINITY);
        let outcome = |t, u| Outcome {
            hit: true,
            raw: [t, u, 0.0],
            near: t,
            far: t,
            t,
        };
        let numbers = |order: &[(f64, u32)]| {
            let mut closest = Closest::default();
            for &(t, number) in order {
                closest.merge(&ray, &outcome(t, f64::from(number)), 0, number);
            }
            assert_eq!(
                (closest.limit, closest.hit.u),
                (closest.hit.t, f64::from(closest.hit.triangle))
            );
            (closest.hit.t, closest.hit.triangle)
        };
        assert_eq!(numbers(&[(2.0, 7), (2.0, 3), (2.0, 5), (3.0, 1)]), (2.0, 3));
        assert_eq!(numbers(&[(2.0, 3), (1.0, 9)]), (1.0, 9));
    }

    #[test]
    fn an_any_hit_ray_is_answered_by_its_first_hit() {
        let ray = RaySetup {
            any_hit: true,
            tmin: 0.5,
            ..ray([0.0, 0.0, 1.0], 0.0, f64::INFINITY)
        };
        let triangle = Triangle::new([[-1.0, -1.0, 2.0], [3.0, -1.0, 2.0], [-1.0, 3.0, 2.0]], 6);
        let mut closest = Closest::default();
        closest.merge(&ray, &test_both(&triangle, &ray)[0], 0, 6);
        assert!(closest.hit.same_bits(&Hit::any(0.5), Format::FP24));
        assert_eq!(closest.limit, f64::NEG_INFINITY);
    }
}
