//! Scenes that need no file.

mod cornell;
mod figure;
mod interior;
mod reef;
mod shapes;
mod teapot;
mod teapot_data;
mod water;

use super::animation::Animated;
use super::{Mesh, Scene};
use anyhow::{Result, bail, ensure};
use std::ops::RangeInclusive;

/// The names of the scenes of [`builtin()`].
pub const BUILTIN_NAMES: [&str; 5] = ["teapot", "cornell", "interior", "sphere", "knot"];

/// The names of the animated built-in scenes: see [`load_animated`](super::load_animated).
///
/// | name | parameters (range, default) | content | clips |
/// |---|---|---|---|
/// | `water` | `resolution` (2–1024, 104) | a surface with travelling waves, 2·resolution² triangles; the host writes every vertex in every frame | `waves` |
/// | `figure` | `detail` (36–96, 48) | a human figure with one closed skin and 21 joints; its height is `detail` cells of the grid that gives the triangles | `walk`, `wave` |
/// | `reef` | `fish` (1–8192, 800) | shoals of `fish` fish over 160 weeds, 80 stones and a seabed: instances of four objects, two of which deform | `swim` |
pub const ANIMATED_NAMES: [&str; 3] = ["water", "figure", "reef"];

/// Builds a static scene that needs no file.
///
/// `spec` is a name, optionally followed by `?key=value` and further `&key=value`:
///
/// | name | parameters (range, default) | content |
/// |---|---|---|
/// | `teapot` | `tessellation` (2–128, 10) | the Utah teapot, each Bézier patch cut into tessellation² quads: 6,320 triangles |
/// | `cornell` | | the Cornell box as measured, 38 triangles |
/// | `interior` | | a vaulted hall with arcades, columns, benches and chandeliers |
/// | `sphere` | `level` (0–8, 4) | an icosahedron subdivided level times: closed, 20·4^level triangles |
/// | `knot` | `segments` (8–4096, 384), `sides` (3–64, 16) | a tube along a trefoil knot: closed, 2·segments·sides triangles |
///
/// Every scene is the same on every machine: coordinates are on a fine grid, which removes the differences between
/// libraries of elementary functions.
///
/// # Errors
/// One line if the name, a parameter's name or its value is unknown or out of range.
pub fn builtin(spec: &str) -> Result<Scene> {
    let (name, parameters) = spec.split_once('?').unwrap_or((spec, ""));
    let mut parameters = Parameters::parse(name, parameters)?;
    let mesh = match name {
        "teapot" => teapot::mesh(parameters.take("tessellation", 2..=128, 10)?),
        "cornell" => cornell::mesh(),
        "interior" => interior::mesh(),
        "sphere" => shapes::sphere(parameters.take("level", 0..=8, 4)?),
        "knot" => shapes::knot(
            parameters.take("segments", 8..=4096, 384)?,
            parameters.take("sides", 3..=64, 16)?,
        ),
        _ => bail!(
            "builtin:{name}: no such built-in scene; there are {}",
            BUILTIN_NAMES.join(", ")
        ),
    };
    parameters.finish()?;
    Ok(Scene {
        name: name.to_string(),
        mesh,
        warnings: Vec::new(),
    })
}

/// Builds a scene with its motion; scenes of [`builtin()`] have no motion.
pub(super) fn animated(spec: &str) -> Result<Animated> {
    let (name, parameters) = spec.split_once('?').unwrap_or((spec, ""));
    if BUILTIN_NAMES.contains(&name) {
        return Ok(Animated::still(builtin(spec)?));
    }
    let mut parameters = Parameters::parse(name, parameters)?;
    let animated = match name {
        "water" => water::animated(parameters.take("resolution", 2..=1024, 104)?),
        "figure" => figure::animated(parameters.take("detail", 36..=96, 48)?),
        "reef" => reef::animated(parameters.take("fish", 1..=8192, 800)?),
        _ => bail!(
            "builtin:{name}: no such built-in scene; there are {}",
            [&ANIMATED_NAMES[..], &BUILTIN_NAMES].concat().join(", ")
        ),
    };
    parameters.finish()?;
    Ok(animated)
}

/// The parameters of a built-in scene that have not been used yet.
struct Parameters<'a> {
    scene: &'a str,
    left: Vec<(&'a str, &'a str)>,
    known: Vec<&'static str>,
}

impl<'a> Parameters<'a> {
    fn parse(scene: &'a str, text: &'a str) -> Result<Self> {
        let mut left: Vec<(&str, &str)> = Vec::new();
        for part in text.split('&').filter(|part| !part.is_empty()) {
            let Some((key, value)) = part.split_once('=') else {
                bail!("builtin:{scene}: `{part}` has no value; write {part}=VALUE");
            };
            ensure!(
                left.iter().all(|&(other, _)| other != key),
                "builtin:{scene}: `{key}` is given twice; give it once"
            );
            left.push((key, value));
        }
        Ok(Self {
            scene,
            left,
            known: Vec::new(),
        })
    }

    fn take(&mut self, key: &'static str, range: RangeInclusive<u32>, default: u32) -> Result<u32> {
        self.known.push(key);
        let Some(index) = self.left.iter().position(|&(given, _)| given == key) else {
            return Ok(default);
        };
        let (_, value) = self.left.swap_remove(index);
        match value.parse() {
            Ok(number) if range.contains(&number) => Ok(number),
            _ => bail!(
                "builtin:{}: {key} is `{value}`; give a whole number from {} to {}",
                self.scene,
                range.start(),
                range.end()
            ),
        }
    }

    fn finish(self) -> Result<()> {
        let Some((key, _)) = self.left.first() else {
            return Ok(());
        };
        let scene = self.scene;
        match self.known.as_slice() {
            [] => bail!("builtin:{scene}: unknown parameter `{key}`; this scene has none"),
            known => bail!(
                "builtin:{scene}: unknown parameter `{key}`; there are {}",
                known.join(", ")
            ),
        }
    }
}

/// Rounds a coordinate to the grid of built-in scenes, multiples of 2⁻³². Equal coordinates that were computed in two ways
/// become equal in all bits, also on different machines.
fn snap(x: f64) -> f64 {
    const GRID: f64 = (1u64 << 32) as f64;
    (x * GRID).round() / GRID + 0.0
}

/// Merges vertices with equal positions.
#[derive(Default)]
struct Welder {
    mesh: Mesh,
    found: std::collections::HashMap<[u64; 3], u32>,
}

impl Welder {
    fn vertex(&mut self, position: [f64; 3]) -> u32 {
        let position = position.map(snap);
        *self
            .found
            .entry(position.map(f64::to_bits))
            .or_insert_with(|| {
                self.mesh.positions.push(position);
                (self.mesh.positions.len() - 1) as u32
            })
    }

    /// Adds a triangle, unless two of its corners are the same.
    fn triangle(&mut self, [a, b, c]: [u32; 3]) {
        if a != b && b != c && c != a {
            self.mesh.triangles.push([a, b, c]);
        }
    }

    fn quad(&mut self, [a, b, c, d]: [[f64; 3]; 4]) {
        let [a, b, c, d] = [a, b, c, d].map(|p| self.vertex(p));
        self.triangle([a, b, c]);
        self.triangle([a, c, d]);
    }

    /// Adds the surface `position(i / columns, j / rows)`, columns × rows quads.
    fn surface(&mut self, columns: u32, rows: u32, position: impl Fn(f64, f64) -> [f64; 3]) {
        let grid: Vec<u32> = (0..=rows)
            .flat_map(|j| (0..=columns).map(move |i| (i, j)))
            .map(|(i, j)| {
                self.vertex(position(
                    f64::from(i) / f64::from(columns),
                    f64::from(j) / f64::from(rows),
                ))
            })
            .collect();
        let at = |i: u32, j: u32| grid[(j * (columns + 1) + i) as usize];
        for j in 0..rows {
            for i in 0..columns {
                let (a, b, c, d) = (at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1));
                self.triangle([a, b, c]);
                self.triangle([a, c, d]);
            }
        }
    }
}
