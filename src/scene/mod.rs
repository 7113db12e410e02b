//! Scenes: where triangles come from, how they become the machine's numbers, and the rays that look at them.
//!
//! [`load`] reads an OBJ file or builds one of the scenes that need no file; [`MachineMesh`] is the scene
//! scaled and rounded to the machine's number format, from which everything else is computed; [`Camera`]
//! and [`Frame`] make the packets of rays that cross the ray port. [`load_animated`] reads what moves:
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
pub use rays::{Frame, ImageSize, RAYS_PER_PACKET, RayPacket, shadow_rays};
pub use sources::{Role, SceneSpec, Source, sources};

use std::ffi::OsStr;

/// The least and the greatest corner of an axis-aligned box.
pub type Bounds = ([f64; 3], [f64; 3]);

/// Triangles on shared vertices, in the scene's own units.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices; triangles that meet share them as their source does.
    pub positions: Vec<[f64; 3]>,
    /// Three indices into `positions` each. A triangle's number is its place here.
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    /// The exact box of the vertices that triangles use; `None` for a mesh without triangles.
    ///
    /// # Panics
    /// If a triangle names a vertex that does not exist.
    pub fn bounds(&self) -> Option<Bounds> {
        used_bounds(&self.positions, &self.triangles)
    }
}

/// A mesh with the name by which reports speak of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// The file's stem, or the built-in scene's name.
    pub name: String,
    pub mesh: Mesh,
    /// What of the source is not in the mesh, a line each.
    pub warnings: Vec<String>,
}

impl Scene {
    /// See [`Mesh::bounds`]. A loaded scene always has triangles.
    ///
    /// # Panics
    /// If the scene was made by hand without triangles.
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
/// Of an OBJ file the polygons of all groups and objects are read, as one mesh whose vertices stay shared:
///
/// | in the file | what becomes of it |
/// |---|---|
/// | encoding | UTF-8, or UTF-16 with a byte order mark or where it is plain; comments and names may be in any |
/// | lines | end in LF, CR LF or CR; `#` begins a comment anywhere but in a name; a backslash at the end joins the next line, but not after a comment, a name or an unknown statement |
/// | `v` | x y z; of four numbers the last is a weight, by which they are divided; three or four more are a colour, which is not used |
/// | `f` | a fan around its first corner, which may be wrong if it is concave; texture coordinates and normals are not looked at |
/// | groups, materials, `vt`, `vn`, smoothing | not used; files of materials may be missing |
/// | lines, points, curves, surfaces, other files (`call`), unknown statements | left out, with a warning in [`Scene::warnings`] |
///
/// # Errors
/// One line that names the file, the place in it and the remedy: no such file, a file that is no mesh (an OBJ file has `v` or
/// `f`), a mesh without triangles, a face without corners, vertices that are not finite, an index out of range, an unknown
/// built-in scene.
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
