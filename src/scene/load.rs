//! Where scenes that move come from.

use super::animation::{Animated, gltf_file, sequence};
use super::{BUILTIN_NAMES, SceneSpec, builtin, obj};
use crate::text;
use anyhow::{Result, bail};
use std::ffi::OsStr;
use std::path::Path;

/// Loads a scene with its motion.
///
/// | `spec` | what |
/// |---|---|
/// | a file whose name ends in `.glb` or `.gltf` | nodes, skins, morph targets, clips and instances (EXT_mesh_gpu_instancing) of glTF 2.0 that are shown; materials, pictures and cameras are not looked at |
/// | a folder | its files whose names end in `.obj` are the frames of a sequence, in the order of their names: numbers in them compare as numbers, case does not count, and hidden files are passed over |
/// | a file whose name ends in `.obj` | a scene that stands still |
/// | `builtin:NAME` | a built-in scene, see [`builtin()`](fn@crate::scene::builtin) and [`ANIMATED_NAMES`](crate::scene::ANIMATED_NAMES) |
///
/// Vertices of a glTF mesh that are the same in everything that moves them become one: files part them where
/// normals or texture coordinates differ, which costs the machine time and changes no picture. What of geometry and motion
/// is in a file and not in the picture is in [`Animated::warnings`]; what is not shown is not judged.
///
/// # Errors
/// One line that names the file, the place in it and the remedy: no such file; a file that is no mesh; no triangles; a
/// missing buffer; an index or a joint out of range; numbers that are not finite; weights that are zero;
/// cyclic nodes; a required extension that is not known here; frames of different topology.
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
