//! The geometry unit: a ray against a triangle, and the merge of a hit into the ray's result.

use super::setup::RaySetup;
use crate::config::TriangleTest;
use crate::float::Arithmetic;
use crate::port::Hit;

/// A triangle fetched: what the test reads, and what its box follows from.
#[derive(Clone, Copy, Debug)]
pub struct Triangle {
    /// In the record's order.
    pub vertices: [[f64; 3]; 3],
    /// The triangle's number in its mesh, which ties and results use.
    pub number: u32,
    /// Two equal vertices, or a box without extent on two axes: never hit.
    pub degenerate: bool,
}

/// What a ray–triangle test found.
#[derive(Clone, Copy, Debug)]
pub struct Outcome {
    pub hit: bool,
    /// t, u and v as the triangle test computes them, before t is clamped. Of a miss they may be anything.
    pub raw: [f64; 3],
    /// The ray's interval in the triangle's own box, from (−∞, +∞).
    pub near: f64,
    pub far: f64,
    /// t clamped into that interval; of a hit, its distance.
    pub t: f64,
}

/// A ray's result so far.
#[derive(Clone, Copy, Debug)]
pub struct Closest {
    pub hit: Hit,
    /// What a popped entry's near must not exceed.
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

    /// Least and greatest corner of the triangle's box.
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

    /// Tests a ray. Without `WHOLE` it stops as soon as a miss is certain, and of a miss only `hit` is of meaning;
    /// the answer is the same.
    #[inline(always)]
    pub fn intersect<const WHOLE: bool>(
        &self,
        a: &Arithmetic,
        test: TriangleTest,
        ray: &RaySetup,
    ) -> Outcome {
        let mut outcome = Outcome {
            hit: false,
            raw: [f64::NAN; 3],
            near: f64::NEG_INFINITY,
            far: f64::INFINITY,
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
            TriangleTest::MollerTrumbore => self.moller_trumbore(a, ray),
            TriangleTest::Watertight => self.watertight(a, ray),
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

    /// Whether the ray's line passes inside, and t, u, v.
    #[inline(always)]
    fn moller_trumbore(&self, a: &Arithmetic, ray: &RaySetup) -> (bool, [f64; 3]) {
        let [v0, v1, v2] = self.vertices;
        let d = ray.direction;
        let e1 = sub(a, v1, v0);
        let e2 = sub(a, v2, v0);
        let c = sub(a, ray.origin, v0);
        let p = cross(a, d, e2);
        let det = dot(a, e1, p);
        let i = a.reciprocal(det);
        let q = cross(a, c, e1);
        let u = a.mul(dot(a, c, p), i);
        let v = a.mul(dot(a, d, q), i);
        let t = a.mul(dot(a, e2, q), i);
        let inside = u >= 0.0 && v >= 0.0 && a.add(u, v) <= 1.0 && det != 0.0;
        (inside, [t, u, v])
    }

    /// Whether the ray's line passes inside, and t, u, v.
    #[inline(always)]
    fn watertight(&self, a: &Arithmetic, ray: &RaySetup) -> (bool, [f64; 3]) {
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
