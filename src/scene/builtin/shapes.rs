//! Closed shapes: every edge belongs to exactly two triangles.

use super::{Mesh, Welder, snap};
use std::collections::HashMap;
use std::f64::consts::TAU;

/// A unit sphere: an icosahedron whose triangles are divided into four `level` times. Corners are counter-clockwise
/// seen from outside.
pub fn sphere(level: u32) -> Mesh {
    let golden = (1.0 + 5f64.sqrt()) / 2.0;
    let mut positions: Vec<[f64; 3]> = Vec::new();
    for (a, b) in [
        (-1.0, golden),
        (1.0, golden),
        (-1.0, -golden),
        (1.0, -golden),
    ] {
        positions.push(onto_sphere([a, b, 0.0]));
        positions.push(onto_sphere([0.0, a, b]));
        positions.push(onto_sphere([b, 0.0, a]));
    }
    // Neighbours have distance 2 before normalising; a face consists of three mutual neighbours.
    let near = |i: usize, j: usize| {
        let d: f64 = (0..3)
            .map(|k| (positions[i][k] - positions[j][k]).powi(2))
            .sum();
        d < 1.2
    };
    let mut triangles = Vec::new();
    for i in 0..12 {
        for j in i + 1..12 {
            for k in j + 1..12 {
                if near(i, j) && near(j, k) && near(k, i) {
                    let [a, b, c] = [positions[i], positions[j], positions[k]];
                    let outwards = dot(cross(minus(b, a), minus(c, a)), a) > 0.0;
                    let (j, k) = if outwards { (j, k) } else { (k, j) };
                    triangles.push([i as u32, j as u32, k as u32]);
                }
            }
        }
    }
    for _ in 0..level {
        let mut middles = HashMap::new();
        let mut middle = |a: u32, b: u32| {
            *middles.entry((a.min(b), a.max(b))).or_insert_with(|| {
                let [p, q] = [positions[a as usize], positions[b as usize]];
                positions.push(onto_sphere(std::array::from_fn(|k| p[k] + q[k])));
                (positions.len() - 1) as u32
            })
        };
        triangles = triangles
            .into_iter()
            .flat_map(|[a, b, c]| {
                let (ab, bc, ca) = (middle(a, b), middle(b, c), middle(c, a));
                [[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]
            })
            .collect();
    }
    Mesh {
        positions,
        triangles,
    }
}

/// A tube along a trefoil knot that winds around a torus of radii 2 and 0.9.
pub fn knot(segments: u32, sides: u32) -> Mesh {
    let mut welder = Welder::default();
    knot_into(&mut welder, segments, sides, 0.42, |p| p);
    welder.mesh
}

/// Adds the tube of [`knot`], of radius `thickness`, placed by `place`.
pub fn knot_into(
    welder: &mut Welder,
    segments: u32,
    sides: u32,
    thickness: f64,
    place: impl Fn([f64; 3]) -> [f64; 3],
) {
    // Angles wrap around exactly, so the last ring is the first.
    let angle = |fraction: f64| TAU * fraction.rem_euclid(1.0);
    welder.surface(sides, segments, |s, t| {
        let (phi, theta) = (angle(2.0 * t), angle(3.0 * t));
        let ring = 2.0 + 0.9 * theta.cos();
        let centre = [ring * phi.cos(), ring * phi.sin(), 0.9 * theta.sin()];
        // The normal of the torus is perpendicular to the curve everywhere and periodic, so the frame has no residual twist.
        let normal = [
            theta.cos() * phi.cos(),
            theta.cos() * phi.sin(),
            theta.sin(),
        ];
        let tangent = [
            -2.7 * theta.sin() * phi.cos() - 2.0 * ring * phi.sin(),
            -2.7 * theta.sin() * phi.sin() + 2.0 * ring * phi.cos(),
            2.7 * theta.cos(),
        ];
        let side = normalise(cross(tangent, normal));
        let (sin, cos) = angle(s).sin_cos();
        place(std::array::from_fn(|k| {
            centre[k] + thickness * (cos * normal[k] + sin * side[k])
        }))
    });
}

fn onto_sphere(p: [f64; 3]) -> [f64; 3] {
    normalise(p).map(snap)
}

fn normalise(p: [f64; 3]) -> [f64; 3] {
    let length = dot(p, p).sqrt();
    p.map(|x| x / length)
}

fn minus(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|k| a[k] - b[k])
}

fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|k| a[k] * b[k]).sum()
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    ]
}
