//! The data at the ports of the ray casting unit: rays in, hits out.

use crate::float::Format;

/// The number that stands for no triangle and no instance: all ones.
pub const NONE: u32 = u32::MAX;

/// A ray in machine coordinates. Every number is a value of the machine's format in an `f64`. −0, ±∞
/// and NaN are allowed; `docs/arithmetic.md` defines their meaning.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    pub origin: [f64; 3],
    /// Of any length; distances are multiples of this vector.
    pub direction: [f64; 3],
    /// A hit's distance t satisfies tmin ≤ t ≤ tmax. A ray misses unless 0 ≤ tmin ≤ tmax.
    pub tmin: f64,
    pub tmax: f64,
    /// Whether the slot contains a ray; an inactive ray misses.
    pub active: bool,
    /// Whether the ray is an any-hit ray, which only reports whether there is a hit.
    pub any_hit: bool,
}

impl Ray {
    /// The ray in a slot without a ray.
    pub const INACTIVE: Ray = Ray {
        origin: [0.0; 3],
        direction: [0.0; 3],
        tmin: 0.0,
        tmax: 0.0,
        active: false,
        any_hit: false,
    };
}

/// The first hit of a ray. u and v are the weights of the triangle's second and third vertex.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    pub t: f64,
    pub u: f64,
    pub v: f64,
    /// The instance's number; 0 in a scene of one level, [`NONE`] for a miss.
    pub instance: u32,
    /// The triangle's number in its mesh, [`NONE`] for a miss and for an any-hit ray.
    pub triangle: u32,
}

impl Hit {
    pub const MISS: Hit = Hit {
        t: f64::INFINITY,
        u: 0.0,
        v: 0.0,
        instance: NONE,
        triangle: NONE,
    };

    /// The result of an any-hit ray with a hit.
    pub fn any(tmin: f64) -> Hit {
        Hit {
            t: tmin,
            ..Hit::MISS
        }
    }

    pub fn is_hit(&self) -> bool {
        self.t < f64::INFINITY
    }

    /// Whether two hits are equal in all bits.
    pub fn same_bits(&self, other: &Hit, format: Format) -> bool {
        let bits = |h: &Hit| [h.t, h.u, h.v].map(|x| format.to_bits(x));
        bits(self) == bits(other)
            && self.instance == other.instance
            && self.triangle == other.triangle
    }
}
