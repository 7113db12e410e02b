//! The Utah teapot, from Martin Newell's published patches.

use super::teapot_data::{CONTROL_POINTS, PATCHES};
use super::{Mesh, Welder};

/// Divides each of the 32 patches into n × n quads of two triangles. Neighbouring patches share their
/// vertices. The 8 patches with a degenerate edge lose n triangles there, which leaves 64 n² − 8 n triangles.
/// The y axis points up. The published teapot is not closed: there is a gap around the lid, and
/// spout and handle penetrate the body.
pub fn mesh(n: u32) -> Mesh {
    let mut welder = Welder::default();
    for patch in &PATCHES {
        welder.surface(n, n, |u, v| {
            let [x, y, z] = evaluate(patch, u, v);
            [x, z, -y]
        });
    }
    welder.mesh
}

/// A point of a bicubic Bézier patch: u along a row of control points, v from row to row.
fn evaluate(patch: &[u16; 16], u: f64, v: f64) -> [f64; 3] {
    let (along, across) = (bernstein(u), bernstein(v));
    std::array::from_fn(|axis| {
        (0..16)
            .map(|i| {
                // Control points are counted from 1, as published.
                let point = CONTROL_POINTS[usize::from(patch[i]) - 1];
                across[i / 4] * along[i % 4] * point[axis]
            })
            .sum()
    })
}

fn bernstein(t: f64) -> [f64; 4] {
    let s = 1.0 - t;
    [s * s * s, 3.0 * s * s * t, 3.0 * s * t * t, t * t * t]
}
