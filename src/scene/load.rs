//! Loads animated scenes.

use super::animation::{Animated, gltf_file, sequence};
use super::{BUILTIN_NAMES, SceneSpec, builtin, obj};
use crate::text;
use anyhow::{Result, bail};
use std::ffi::OsStr;
use std::path::Path;

/// Loads a scene with its motion.
///
/// | `spec` | scene |
/// |---|---|
/// | a file whose name ends in `.glb` or `.gltf` | the shown nodes, skins, morph targets, clips and instances (EXT_mesh_gpu_instancing) of glTF 2.0; materials, pictures and cameras are ignored |
/// | a folder | a sequence whose frames are the files with names that end in `.obj`, in the order of their names: numbers in them compare as numbers, case is ignored, and hidden files are skipped |
/// | a file whose name ends in `.obj` | a static scene |
/// | `builtin:NAME` | a built-in scene, see [`builtin()`](fn@crate::scene::builtin) and [`ANIMATED_NAMES`](crate::scene::ANIMATED_NAMES) |
///
/// Vertices of a glTF mesh that are equal in everything that moves them are merged. Files split them where
/// normals or texture coordinates differ, which costs time and does not change the picture. [`Animated::warnings`] lists geometry
/// and motion that is in a file and not in the picture; parts that are not shown are not checked.
///
/// # Errors
/// One line that names the file, the place in it and the remedy, if a file or buffer is missing, if a file is not a mesh, if there
/// are no triangles, if an index or a joint is out of range, if numbers are not finite, if weights are zero, if nodes are cyclic,
/// if a required extension is not supported, or if the topology of frames differs.
pub fn load_animated(spec: impl AsRef<OsStr>) -> Result<Animated> {
    let spec = SceneSpec::new(spec);
    if let Some(name) = spec.builtin() {
        return builtin::animated(&name);
    }
    let path = Path::new(&spec);
    let shown = text::path(path);
    let metadata = match std::fs::metadata(path) {
        Ok(metadata) => metadata,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let mut names = builtin::ANIMATED_NAMES.iter().chain(&BUILTIN_NAMES);
            if names.any(|name| path.as_os_str() == *name) {
                bail!("{shown}: no such file; for the built-in scene, give builtin:{spec}");
            }
            bail!(
                "{shown}: no such file; give a glTF or OBJ file, a folder of OBJ files, or builtin:NAME"
            );
        }
        Err(error) => bail!("{shown}: cannot be read: {error}"),
    };
    if metadata.is_dir() {
        return sequence::load(path);
    }
    let extension = path.extension().unwrap_or_default().to_string_lossy();
    match extension.to_ascii_lowercase().as_str() {
        "glb" | "gltf" => gltf_file::load(path),
        "obj" => Ok(Animated::still(obj::load(path)?)),
        _ => bail!(
            "{shown}: is not a scene that can be read; give a file whose name ends in .glb, .gltf or .obj, a folder of OBJ files, or builtin:NAME"
        ),
    }
}
