//! An animated scene in memory at one time.

use crate::bkd::layout::MemoryImage;
use crate::bkd::{BuildOptions, InstanceSpec, InstancedImage, build};
use crate::config::Config;
use crate::cosim::unit_skinning::SkinMesh;
use crate::float::Arithmetic;
use crate::golden::skinning::skin_vertices;
use crate::scene::animation::{MachineFrame, MachineScene};
use anyhow::{Context, Result};

/// The image and the skinned objects of one frame.
#[derive(Clone, Debug)]
pub struct Posed {
    /// Two levels, unless the frame's only instance has the identity as its matrix.
    pub image: MemoryImage,
    /// Skinned objects with the palettes of this frame.
    pub skins: Vec<SkinMesh>,
}

/// Skins a scene's objects for a frame, and builds their trees and the top-level tree.
///
/// # Errors
/// One line if a tree, an image or an instance is rejected.
pub fn pose(config: &Config, scene: &MachineScene, frame: &MachineFrame) -> Result<Posed> {
    let format = scene.format;
    let one_level = scene.is_one_level(std::slice::from_ref(frame));
    // The top-level tree gets its minimum depth plus a margin, because it need not be balanced.
    let top = match one_level {
        true => 0,
        false => scene.instances.len().next_power_of_two().ilog2() + 4,
    };
    let mut skins = vec![];
    let mut objects = vec![];
    for (number, (object, given)) in scene.objects.iter().zip(&frame.objects).enumerate() {
        let skin = SkinMesh::of_frame(object, given);
        let vertices = match &skin {
            Some(mesh) => {
                let a = Arithmetic::new(format);
                skin_vertices(&a, &mesh.rest, &mesh.influences, &mesh.palette)
            }
            None => given.written.as_ref().unwrap_or(&object.rest).clone(),
        };
        scene.check_vertices(number, &vertices)?;
        skins.extend(skin);
        let least = object.triangles.len().next_power_of_two().ilog2();
        let depth = config.stack_depth.saturating_sub(top).max(least);
        let options =
            BuildOptions::default_for(config.axes_per_node, depth.min(config.stack_depth));
        let image = build(&vertices, &object.triangles, &options)
            .and_then(|tree| MemoryImage::new(format, &vertices, &object.triangles, &tree))
            .with_context(|| object.name.clone())?;
        objects.push(image);
    }
    if one_level {
        let image = objects.swap_remove(0);
        return Ok(Posed { image, skins });
    }
    let mut image = InstancedImage::new(format);
    for object in &objects {
        image.add_object(object)?;
    }
    // An instance that is absent from this frame has no number in the image.
    let there = scene.instances.iter().zip(&frame.instances);
    let there = there.filter_map(|(&object, matrix)| Some((object, matrix.as_ref()?)));
    let specs = there
        .enumerate()
        .map(|(number, (object, matrix))| {
            let columns =
                std::array::from_fn(|column| std::array::from_fn(|row| matrix[row][column]));
            let bounds = image.objects()[object].bounds;
            InstanceSpec::new(format, number, object, &columns, bounds)
        })
        .collect::<Result<Vec<_>>>()?;
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    image.set_top(&specs, &options)?;
    Ok(Posed {
        image: image.image().clone(),
        skins,
    })
}
