//! Scenes: the sources of triangles, their conversion to the machine's number format, and rays.
//!
//! [`load`] reads an OBJ file or builds one of the scenes that need no file. [`MachineMesh`] is the scene
//! scaled and rounded to the machine's number format; everything else is computed from it. [`Camera`]
//! and [`Frame`] generate packets of rays. [`load_animated`] loads animated scenes:
//! see [`animation`].

pub mod animation;
mod builtin;
mod camera;
mod load;
mod machine;
mod obj;
mod rays;
mod sources;

pub use animation::Animated;
pub use builtin::{ANIMATED_NAMES, BUILTIN_NAMES, builtin};
pub use camera::{Camera, View, default_light};
pub use load::load_animated;
pub use machine::{MachineMesh, log2_scale};
pub use rays::{
    Frame, ImageSize, RAYS_PER_PACKET, RayKind, RayPacket, diffuse_rays, shadow_rays,
    sort_along_morton_curve,
};
pub use sources::{Role, SceneSpec, Source, sources};

use std::ffi::OsStr;

/// The minimum and the maximum corner of an axis-aligned box.
pub type Bounds = ([f64; 3], [f64; 3]);

/// Triangles with shared vertices, in the scene's own units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices; adjacent triangles share them as in the source.
    pub positions: Vec<[f64; 3]>,
    /// Three indices into `positions` per triangle. A triangle's number is its index here.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The exact box of the vertices that triangles use; `None` for a mesh without triangles.
    ///
    /// # Panics
    /// If a triangle names a missing vertex.
    pub fn bounds(&self) -> Option<Bounds> {
        used_bounds(&self.positions, &self.triangles)
    }
}

/// A mesh with a name for reports.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The file's stem, or the built-in scene's name.
    pub name: String,
    pub mesh: Mesh,
    /// The parts of the source that are not in the mesh, one line each.
    pub warnings: Vec<String>,
}

impl Scene {
    /// See [`Mesh::bounds`]. A loaded scene always has triangles.
    ///
    /// # Panics
    /// If the scene was created by hand without triangles.
    pub fn bounds(&self) -> Bounds {
        self.mesh.bounds().expect("a scene has triangles")
    }
}

/// Loads a scene.
///
/// `spec` is a [`SceneSpec`]: the path of an OBJ file, or `builtin:NAME`, optionally with parameters:
/// `builtin:NAME?key=value&key=value`, for example `builtin:teapot?tessellation=20`. See [`builtin()`] for
/// names and parameters.
///
/// The polygons of all groups and objects of an OBJ file become one mesh with shared vertices:
///
/// | in the file | treatment |
/// |---|---|
/// | encoding | UTF-8, or UTF-16 with a byte order mark or if it can be recognised; comments and names may have any encoding |
/// | lines | end in LF, CR LF or CR; `#` starts a comment except in a name; a backslash at the end joins the next line, except after a comment, a name or an unknown statement |
/// | `v` | x y z; of four numbers the last is a weight, by which the others are divided; three or four more are a colour, which is ignored |
/// | `f` | a fan around its first corner, which may be wrong for a concave polygon; texture coordinates and normals are ignored |
/// | groups, materials, `vt`, `vn`, smoothing | ignored; files of materials may be missing |
/// | lines, points, curves, surfaces, other files (`call`), unknown statements | left out, with a warning in [`Scene::warnings`] |
///
/// # Errors
/// One line that names the file, the place in it and the remedy, if the file is missing, if it is not a mesh (an OBJ file has `v`
/// or `f`), if a mesh has no triangles, if a face has no corners, if vertices are not finite, if an index is out of range, or if
/// the built-in scene is unknown.
pub fn load(spec: impl AsRef<OsStr>) -> anyhow::Result<Scene> {
    let spec = SceneSpec::new(spec);
    match spec.builtin() {
        Some(name) => builtin(&name),
        None => obj::load(spec.as_ref().as_ref()),
    }
}

fn used_bounds(positions: &[[f64; 3]], triangles: &[[u32; 3]]) -> Option<Bounds> {
    let mut corners = triangles
        .iter()
        .flatten()
        .map(|&index| positions[index as usize]);
    let first = corners.next()?;
    Some(corners.fold((first, first), |(low, high), p| {
        (
            std::array::from_fn(|axis| low[axis].min(p[axis])),
            std::array::from_fn(|axis| high[axis].max(p[axis])),
        )
    }))
}
