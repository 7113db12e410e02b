//! Rays in bytes: numbers in binary32, which the chip converts to the machine's format.

use crate::float::{Arithmetic, Format};
use crate::port::Ray;

/// Bytes of a ray with its own origin, and of a short ray.
pub const BYTES: usize = 32;
pub const SHORT_BYTES: usize = 16;

/// A ray's numbers as binary32, in the order of memory: origin, tmin, direction, tmax.
pub type Numbers = [f32; 8];

/// A ray's numbers for memory: each rounded to binary32. A number of a format of at most 8 exponent bits is one exactly.
pub fn numbers(ray: &Ray) -> Numbers {
    let [ox, oy, oz] = ray.origin;
    let [dx, dy, dz] = ray.direction;
    // An inactive ray misses, because its limits exclude each other.
    let tmax = match ray.active {
        true => ray.tmax,
        false => f64::NEG_INFINITY,
    };
    [ox, oy, oz, ray.tmin, dx, dy, dz, tmax].map(|x| x as f32)
}

/// Origin and tmin of rays, if all active ones have the same: then they may be cast as short rays.
pub fn shared_origin(rays: &[Ray]) -> Option<([f32; 3], f32)> {
    let own = |ray: &Ray| {
        let [x, y, z, tmin, ..] = numbers(ray);
        [x, y, z, tmin]
    };
    let mut active = rays.iter().filter(|ray| ray.active);
    let first @ [x, y, z, tmin] = own(active.next()?);
    let same = |ray: &Ray| own(ray).map(f32::to_bits) == first.map(f32::to_bits);
    active.all(same).then_some(([x, y, z], tmin))
}

/// The bytes of a ray with its own origin; the last [`SHORT_BYTES`] are those of the short ray.
pub fn to_bytes(numbers: &Numbers) -> [u8; BYTES] {
    let mut bytes = [0; BYTES];
    for (place, number) in bytes.chunks_exact_mut(4).zip(numbers) {
        place.copy_from_slice(&number.to_le_bytes());
    }
    bytes
}

/// The ray of numbers, converted to the machine's format.
pub fn from_numbers(format: Format, numbers: &Numbers, any_hit: bool) -> Ray {
    let [ox, oy, oz, tmin, dx, dy, dz, tmax] = numbers.map(|x| convert(format, x));
    Ray {
        origin: [ox, oy, oz],
        direction: [dx, dy, dz],
        tmin,
        tmax,
        active: true,
        any_hit,
    }
}

/// A binary32 number as a number of the format: rounded to nearest, ties to even; zeros keep their sign.
pub fn convert(format: Format, number: f32) -> f64 {
    if number.is_subnormal() || number == 0.0 {
        return if number.is_sign_negative() { -0.0 } else { 0.0 };
    }
    let rounded = Arithmetic::new(format).round(f64::from(number));
    if rounded == 0.0 && number.is_sign_negative() {
        return -0.0;
    }
    rounded
}
