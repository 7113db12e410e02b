//! Scenes in the machine's number format.

use super::animation::some;
use super::{Bounds, Mesh, Scene, used_bounds};
use crate::float::{Arithmetic, Format};
use anyhow::{Context, Result, ensure};

/// A mesh scaled by a power of two and rounded once to the machine's number format. Trees, memory images
/// and results are computed only from it.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineMesh {
    /// The format of the vertices.
    pub format: Format,
    /// A scene coordinate times 2^`log2_scale` is a machine coordinate.
    pub log2_scale: i32,
    /// Values of the format, represented exactly, without −0.
    pub vertices: Vec<[f64; 3]>,
    /// Three indices into `vertices` per triangle, as in the scene's mesh.
    pub triangles: Vec<[u32; 3]>,
}

impl MachineMesh {
    /// The limit for the magnitude of a scaled scene's coordinates, as a power of two: 2⁸ = 256, or 2^(bias − 1)
    /// for a format with few exponent bits. The limit leaves room for distances and for rays that
    /// start outside.
    pub fn log2_limit(format: Format) -> i32 {
        8.min(format.bias() - 1)
    }

    /// Scales a scene by the greatest power of two for which the box of its triangles is within the limit (by 1
    /// if all of its vertices are at the origin) and rounds its vertices.
    ///
    /// # Errors
    /// If the mesh has no triangles, if a triangle names a missing vertex, if a vertex is not finite, or if
    /// double precision cannot represent the scale.
    pub fn new(scene: &Scene, format: Format) -> Result<Self> {
        let Scene { name, mesh, .. } = scene;
        check(mesh).with_context(|| format!("scene {name}"))?;
        let log2_scale =
            log2_scale(scene.bounds(), format).with_context(|| format!("scene {name}"))?;
        let (arithmetic, scale) = (Arithmetic::new(format), power_of_two(log2_scale));
        let vertices = mesh.positions.iter();
        Ok(Self {
            format,
            log2_scale,
            vertices: vertices
                .map(|p| p.map(|x| arithmetic.round(x * scale) + 0.0))
                .collect(),
            triangles: mesh.triangles.clone(),
        })
    }

    /// The exact box of the vertices that triangles use, in machine coordinates.
    ///
    /// # Panics
    /// If there are no triangles.
    pub fn bounds(&self) -> Bounds {
        used_bounds(&self.vertices, &self.triangles).expect("a machine mesh has triangles")
    }

    /// 2^`log2_scale`: machine units per scene unit.
    pub fn scale(&self) -> f64 {
        power_of_two(self.log2_scale)
    }

    /// The losses of `scene`, the source of this mesh, in the format, one line each.
    pub fn warnings(&self, scene: &Scene) -> Vec<String> {
        let mesh = &scene.mesh;
        let loss = Loss::of(
            &scene.name,
            &mesh.positions,
            &self.vertices,
            &mesh.triangles,
        );
        losses(&scene.name, self.format, &[loss])
    }
}

/// The losses of a mesh in the machine's number format, and its initial defects.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Loss {
    /// The mesh's name.
    name: String,
    triangles: usize,
    /// Number of triangles that had no area initially.
    flat: usize,
    /// Number of triangles that have lost their area.
    flattened: usize,
    /// Number of coordinates that became zero.
    flushed: usize,
    /// Distance from the origin in units of the mesh's own size, if that is large.
    distance: Option<f64>,
}

impl Loss {
    /// The losses of a mesh with the vertices `before` in the scene and `after` in the machine, up to a scale.
    pub(super) fn of(
        name: &str,
        before: &[[f64; 3]],
        after: &[[f64; 3]],
        triangles: &[[u32; 3]],
    ) -> Self {
        let is_flat = |&&triangle: &&[u32; 3]| is_degenerate(before, triangle);
        let flat = triangles.iter().filter(is_flat).count();
        let is_flat = |&&triangle: &&[u32; 3]| is_degenerate(after, triangle);
        let is_flattened =
            |triangle: &&[u32; 3]| is_flat(triangle) && !is_degenerate(before, **triangle);
        Loss {
            name: name.to_string(),
            triangles: triangles.len(),
            flat,
            flattened: triangles.iter().filter(is_flattened).count(),
            flushed: std::iter::zip(before, after)
                .flat_map(|(before, after)| std::iter::zip(before, after))
                .filter(|&(&before, &after)| before != 0.0 && after == 0.0)
                .count(),
            distance: used_bounds(after, triangles).and_then(distance),
        }
    }
}

/// The distance of a box from the origin in units of its own size, if it is so large that detail is lost: the
/// spacing of numbers grows with their magnitude.
fn distance((low, high): Bounds) -> Option<f64> {
    let extent = (0..3).map(|k| high[k] - low[k]).fold(0f64, f64::max);
    let greatest = low.iter().chain(&high).fold(0f64, |g, x| g.max(x.abs()));
    (extent < greatest / 16.0).then(|| (greatest / extent).min(1e9))
}

/// The warning about the distance of a whole scene with this box in the world: see [`losses`].
pub(super) fn world_warning(scene: &str, format: Format, world: Bounds) -> Option<String> {
    let distance = distance(world)?;
    Some(far(&format!("scene {scene}"), format, distance))
}

fn far(what: &str, format: Format, distance: f64) -> String {
    format!(
        "{what}: lies {distance:.0} times its own size away from the origin, where {format} is coarse; move it to the origin"
    )
}

/// The losses of a scene's meshes in a format: one line per kind of loss, which names the meshes if there are
/// several.
pub(super) fn losses(scene: &str, format: Format, meshes: &[Loss]) -> Vec<String> {
    let mut warnings = Vec::new();
    let total: usize = meshes.iter().map(|mesh| mesh.triangles).sum();
    // The number of losses of one kind, and their meshes.
    let of = |count: fn(&Loss) -> usize| {
        let with = meshes.iter().filter(|mesh| count(mesh) > 0);
        let names: Vec<String> = with
            .map(|mesh| format!("{} of {}", count(mesh), mesh.name))
            .collect();
        let sum: usize = meshes.iter().map(count).sum();
        let place = match meshes.len() {
            0 | 1 => String::new(),
            _ => format!(" ({})", some(names.iter().map(String::as_str))),
        };
        (sum, place)
    };
    let (flat, place) = of(|mesh| mesh.flat);
    if flat > 0 {
        warnings.push(format!(
            "scene {scene}: {flat} of {total} triangles have no area{place}; remove them from the mesh, because they only cost time"
        ));
    }
    let (flattened, place) = of(|mesh| mesh.flattened);
    if flattened > 0 {
        warnings.push(format!(
            "scene {scene}: {flattened} of {total} triangles have no area once rounded to {format}{place}; a format with more fraction bits would keep them"
        ));
    }
    let (flushed, place) = of(|mesh| mesh.flushed);
    if flushed > 0 {
        warnings.push(format!(
            "scene {scene}: {flushed} coordinates are too small for {format} and became zero{place}; a format with more exponent bits would keep them"
        ));
    }
    let distant: Vec<&Loss> = meshes.iter().filter(|m| m.distance.is_some()).collect();
    match distant.as_slice() {
        [] => {}
        [mesh] => {
            let what = match meshes.len() {
                1 => format!("scene {scene}"),
                _ => format!("scene {scene}, {}", mesh.name),
            };
            warnings.push(far(&what, format, mesh.distance.unwrap_or_default()));
        }
        several => {
            let times = |mesh: &&Loss| {
                let distance = mesh.distance.unwrap_or_default();
                format!("{} {distance:.0} times", mesh.name)
            };
            let names: Vec<String> = several.iter().map(times).collect();
            warnings.push(format!(
                "scene {scene}: {} objects lie many times their own size away from their origin ({}), where {format} is coarse; move them to it",
                several.len(),
                some(names.iter().map(String::as_str))
            ));
        }
    }
    warnings
}

/// The exponent of the greatest power of two by which a box can be scaled to fit ±2^[`MachineMesh::log2_limit`]; 0 for
/// a box that is only the origin.
///
/// # Errors
/// If double precision cannot represent that power.
pub fn log2_scale((low, high): Bounds, format: Format) -> Result<i32> {
    let greatest = low
        .iter()
        .chain(&high)
        .fold(0f64, |greatest, x| greatest.max(x.abs()));
    let log2_scale = match greatest {
        0.0 => 0,
        greatest => MachineMesh::log2_limit(format) - ceil_log2(greatest),
    };
    ensure!(
        (-1022..=1023).contains(&log2_scale),
        "its greatest coordinate, {greatest:e}, would have to be scaled by 2^{log2_scale}, which is out of range; scale the scene towards 1"
    );
    Ok(log2_scale)
}

/// Checks that every triangle's vertices exist and are finite.
fn check(mesh: &Mesh) -> Result<()> {
    ensure!(
        !mesh.triangles.is_empty(),
        "is an empty mesh, it has no triangles; give it some"
    );
    for (number, triangle) in mesh.triangles.iter().enumerate() {
        for &vertex in triangle {
            let position = mesh.positions.get(vertex as usize).with_context(|| {
                format!(
                    "triangle {number} names vertex {vertex}, which is out of range (there are {}, counted from 0); correct the mesh",
                    mesh.positions.len()
                )
            })?;
            ensure!(
                position.iter().all(|x| x.is_finite()),
                "vertex {vertex} of triangle {number} is not finite: {position:?}; correct the mesh"
            );
        }
    }
    Ok(())
}

/// 2^exponent, for exponents of normal double-precision numbers.
pub(super) fn power_of_two(exponent: i32) -> f64 {
    assert!((-1022..=1023).contains(&exponent));
    f64::from_bits(((exponent + 1023) as u64) << 52)
}

/// The minimum k with x ≤ 2^k, for a finite x > 0.
fn ceil_log2(x: f64) -> i32 {
    // The exponent field of subnormal numbers does not give their magnitude.
    let (x, shift) = if x < f64::MIN_POSITIVE {
        (x * power_of_two(100), 100)
    } else {
        (x, 0)
    };
    let bits = x.to_bits();
    let is_power = bits & ((1 << 52) - 1) == 0;
    (bits >> 52) as i32 - 1023 - shift + i32::from(!is_power)
}

/// Whether a triangle's edges are parallel, which includes coinciding corners. The result is exact if the edges are.
fn is_degenerate(positions: &[[f64; 3]], triangle: [u32; 3]) -> bool {
    let [a, b, c] = triangle.map(|index| positions[index as usize]);
    let ab: [f64; 3] = std::array::from_fn(|k| b[k] - a[k]);
    let ac: [f64; 3] = std::array::from_fn(|k| c[k] - a[k]);
    (0..3).all(|k| {
        let (i, j) = ((k + 1) % 3, (k + 2) % 3);
        // A fused operation gives the error of a rounded product.
        let product = |x: f64, y: f64| (x * y, x.mul_add(y, -(x * y)));
        product(ab[i], ac[j]) == product(ab[j], ac[i])
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scene(positions: &[[f64; 3]]) -> Scene {
        let count = positions.len() as u32 / 3;
        Scene {
            name: "test".into(),
            mesh: Mesh {
                positions: positions.to_vec(),
                triangles: (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2]).collect(),
            },
            warnings: Vec::new(),
        }
    }

    fn triangle_to(greatest: f64) -> Scene {
        scene(&[[0.0; 3], [greatest, 0.0, 0.0], [0.0, greatest / 2.0, 0.0]])
    }

    #[test]
    fn the_scale_is_the_greatest_that_fits() {
        for (greatest, expected) in [
            (1.0, 8),
            (256.0, 0),
            (256.0 + 1e-9, -1),
            (-256.0, 0),
            (255.0, 0),
            (128.0, 1),
            (1e-300, 1004),
            (1e300, -989),
        ] {
            let mesh = MachineMesh::new(&triangle_to(greatest), Format::FP24).unwrap();
            assert_eq!(mesh.log2_scale, expected, "for {greatest}");
            let reached = mesh.vertices[1][0].abs();
            assert!((128.0..=256.0).contains(&reached), "{reached}");
        }
    }

    #[test]
    fn few_exponent_bits_lower_the_limit() {
        for (exponent_bits, limit) in [(3, 4.0), (4, 64.0), (5, 256.0), (8, 256.0)] {
            let format = Format::new(exponent_bits, 8).unwrap();
            let mesh = MachineMesh::new(&triangle_to(1024.0), format).unwrap();
            assert_eq!(mesh.vertices[1][0], limit);
            assert_eq!(mesh.scale(), limit / 1024.0);
        }
    }

    #[test]
    fn vertices_are_rounded_once_and_have_no_negative_zero() {
        let odd = 1.0 + 2f64.powi(-17) + 2f64.powi(-40);
        let mesh = MachineMesh::new(
            &scene(&[[256.0, -0.0, odd], [0.0, -1e-300, 1.0], [0.0, 1.0, 0.0]]),
            Format::FP24,
        )
        .unwrap();
        assert_eq!(mesh.vertices[0], [256.0, 0.0, 1.0 + 2f64.powi(-16)]);
        for x in mesh.vertices.iter().flatten() {
            assert!(x.to_bits() != (-0.0f64).to_bits());
        }
    }

    #[test]
    fn flat_scenes_and_single_points_have_a_scale() {
        let flat = MachineMesh::new(&triangle_to(3.0), Format::FP24).unwrap();
        assert_eq!(flat.bounds(), ([0.0; 3], [192.0, 96.0, 0.0]));
        let point = MachineMesh::new(&scene(&[[0.0; 3]; 3]), Format::FP24).unwrap();
        assert_eq!(
            (point.log2_scale, point.bounds()),
            (0, ([0.0; 3], [0.0; 3]))
        );
        let warnings = point.warnings(&scene(&[[0.0; 3]; 3]));
        assert_eq!(warnings.len(), 1, "{warnings:?}");
        assert!(warnings[0].contains("1 of 1 triangles have no area; "));
    }

    #[test]
    fn unused_vertices_do_not_count() {
        let mut far = triangle_to(1.0);
        far.mesh.positions.push([1e6; 3]);
        let mesh = MachineMesh::new(&far, Format::FP24).unwrap();
        assert_eq!(mesh.log2_scale, 8);
        assert_eq!(mesh.bounds().1, [256.0, 128.0, 0.0]);
    }

    #[test]
    fn lost_detail_is_counted() {
        // The second triangle is smaller than the distance between neighbouring numbers; the third had no area before.
        let tiny = 1e-4;
        let all = scene(&[
            [0.0, 0.0, 0.0],
            [256.0, 0.0, 0.0],
            [0.0, 256.0, 1e-30],
            [200.0, 200.0, 0.0],
            [200.0 + tiny, 200.0, 0.0],
            [200.0, 200.0 + tiny, 0.0],
            [1.0, 1.0, 1.0],
            [2.0, 2.0, 2.0],
            [3.0, 3.0, 3.0],
        ]);
        let mesh = MachineMesh::new(&all, Format::FP24).unwrap();
        let warnings = mesh.warnings(&all);
        assert_eq!(warnings.len(), 3, "{warnings:?}");
        assert!(warnings[0].starts_with("scene test: 1 of 3 triangles have no area; "));
        assert!(
            warnings[1].starts_with("scene test: 1 of 3 triangles have no area once rounded to ")
        );
        assert!(warnings[2].starts_with("scene test: 1 coordinates are too small for "));
    }

    #[test]
    fn a_scene_far_from_the_origin_is_warned_of() {
        let far = scene(&[[1000.0, 0.0, 0.0], [1010.0, 0.0, 0.0], [1000.0, 10.0, 0.0]]);
        let mesh = MachineMesh::new(&far, Format::FP24).unwrap();
        let warnings = mesh.warnings(&far);
        assert_eq!(warnings.len(), 1);
        assert!(
            warnings[0].starts_with("scene test: lies 101 times its own size away from the origin")
        );
    }

    #[test]
    fn degenerate_means_exactly_parallel() {
        let p = |z: f64| [[0.0; 3], [1.0, 1.0, 1.0], [3.0, 3.0, z]];
        assert!(is_degenerate(&p(3.0), [0, 1, 2]));
        assert!(!is_degenerate(&p(3.0 + 1e-15), [0, 1, 2]));
        assert!(is_degenerate(&p(7.0), [0, 1, 1]));
    }

    #[test]
    fn bad_meshes_are_refused_in_one_line() {
        let fault = |scene: &Scene| {
            let error = MachineMesh::new(scene, Format::FP24).unwrap_err();
            format!("{error:#}")
        };
        assert_eq!(
            fault(&scene(&[])),
            "scene test: is an empty mesh, it has no triangles; give it some"
        );
        assert_eq!(
            fault(&triangle_to(f64::NAN)),
            "scene test: vertex 1 of triangle 0 is not finite: [NaN, 0.0, 0.0]; correct the mesh"
        );
        let mut missing = triangle_to(1.0);
        missing.mesh.triangles[0][2] = 3;
        assert_eq!(
            fault(&missing),
            "scene test: triangle 0 names vertex 3, which is out of range (there are 3, counted from 0); correct the mesh"
        );
        assert_eq!(
            fault(&triangle_to(5e-324)),
            "scene test: its greatest coordinate, 5e-324, would have to be scaled by 2^1082, which is out of range; scale the scene towards 1"
        );
    }
}
