//! The supported extensions of glTF, and warnings for unsupported ones.

use super::clean::items;
use crate::scene::animation::some;
use crate::text::escaped;
use anyhow::{Result, ensure};
use serde_json::{Map, Value};
use std::collections::BTreeMap;

const INSTANCING: &str = "EXT_mesh_gpu_instancing";
const VISIBILITY: &str = "KHR_node_visibility";
const POINTER: &str = "KHR_animation_pointer";

/// Prefixes of the names of extensions that concern only materials, pictures, lights and sound.
const NO_GEOMETRY: [&str; 11] = [
    "ADOBE_materials_",
    "EXT_lights_",
    "EXT_materials_",
    "EXT_texture_",
    "KHR_audio",
    "KHR_lights_",
    "KHR_materials_",
    "KHR_texture_",
    "MSFT_audio",
    "MSFT_packing_",
    "MSFT_texture_",
];

/// Extensions next to geometry that have no effect here: they describe the geometry, or permit data that is read anyway.
const HARMLESS: [&str; 14] = [
    "CESIUM_primitive_outline",
    "EXT_feature_metadata",
    "EXT_instance_features",
    "EXT_mesh_features",
    "EXT_mesh_manifold",
    "EXT_structural_metadata",
    "FB_ngon_encoding",
    "KHR_mesh_quantization",
    "KHR_node_hoverability",
    "KHR_node_selectability",
    "KHR_techniques_webgl",
    "KHR_xmp",
    "KHR_xmp_json_ld",
    "MPEG_audio_spatial",
];

fn is_harmless(name: &str) -> bool {
    HARMLESS.contains(&name) || NO_GEOMETRY.iter().any(|prefix| name.starts_with(prefix))
}

/// # Errors
/// One line that names the required extensions that are not supported.
pub fn check_required(root: &Map<String, Value>) -> Result<()> {
    let required = items(root.get("extensionsRequired"));
    let unknown: Vec<String> = required
        .iter()
        .filter_map(Value::as_str)
        .filter(|name| !is_harmless(name) && ![INSTANCING, VISIBILITY].contains(name))
        .map(|name| escaped(name).into_owned())
        .collect();
    ensure!(
        unknown.is_empty(),
        "requires {}, which cannot be read here; export it without (uncompressed)",
        some(unknown.iter().map(String::as_str))
    );
    Ok(())
}

fn extension<'a>(object: &'a Value, name: &str) -> Option<&'a Value> {
    object.get("extensions")?.get(name)
}

/// Whether a node is hidden, together with its descendants.
pub fn is_hidden(node: &Value) -> bool {
    let visible = extension(node, VISIBILITY).and_then(|extension| extension.get("visible"));
    visible == Some(&Value::Bool(false))
}

/// The attributes that place a node's instances, with their accessors, or a description of a fault in the extension. Instances
/// with only application-specific attributes are all at the node's place, so one of them is sufficient.
pub fn instancing(node: &Value) -> Result<Vec<(&str, &Value)>, &'static str> {
    let Some(extension) = extension(node, INSTANCING) else {
        return Ok(vec![]);
    };
    let attributes = extension.get("attributes").and_then(Value::as_object);
    let attributes = attributes.ok_or("is without attributes")?;
    Ok(attributes
        .iter()
        .map(|(name, accessor)| (name.as_str(), accessor))
        .filter(|(name, _)| ["TRANSLATION", "ROTATION", "SCALE"].contains(name))
        .collect())
}

/// The pointer in a channel's target, if the target is not a node.
pub fn pointer(target: &Value) -> Option<String> {
    let pointer = extension(target, POINTER);
    let is_pointer = target.get("path").and_then(Value::as_str) == Some("pointer");
    if pointer.is_none() && !is_pointer {
        return None;
    }
    let pointer = pointer.and_then(|pointer| pointer.get("pointer")?.as_str());
    // Both the beginning and the end of a pointer say what it moves.
    let shown: String = pointer.unwrap_or("?").chars().take(80).collect();
    Some(escaped(&shown).into_owned())
}

/// The extension that contains a primitive's vertices, if its accessors do not.
pub fn of_primitive(primitive: &Value) -> Option<String> {
    let extensions = primitive.get("extensions")?.as_object()?;
    let mut names = extensions.keys().filter(|name| !is_harmless(name));
    names.next().map(|name| escaped(name).into_owned())
}

/// One line for each extension that concerns geometry, motion or buffers and is not supported.
pub fn warnings(root: &Map<String, Value>) -> Vec<String> {
    let mut places: BTreeMap<&str, Places> = BTreeMap::new();
    for name in items(root.get("extensionsUsed"))
        .iter()
        .filter_map(Value::as_str)
    {
        places.entry(name).or_default();
    }
    count(root, &mut places);
    let mut warnings = Vec::new();
    for (name, found) in places {
        let is_read = [INSTANCING, VISIBILITY, POINTER].contains(&name);
        if is_read || is_harmless(name) || (found.near == 0 && found.far > 0) {
            continue;
        }
        let missing = match name {
            "KHR_draco_mesh_compression" => "the uncompressed vertices are shown instead",
            "EXT_meshopt_compression" | "KHR_meshopt_compression" => {
                "the uncompressed buffers are shown instead"
            }
            "MSFT_lod" => "of several levels of detail only the first is shown",
            _ => "its effect on shapes, instances, positions or motion is missing",
        };
        let at = match found.near {
            0 => String::new(),
            1 => " (at 1 object of the file)".into(),
            count => format!(" (at {count} objects of the file)"),
        };
        warnings.push(format!(
            "uses {}{at}, which is not read here: {missing}",
            escaped(name)
        ));
    }
    warnings
}

/// The number of uses of an extension in objects that concern geometry, motion or buffers, and in other objects.
#[derive(Default)]
struct Places {
    near: usize,
    far: usize,
}

fn count<'a>(root: &'a Map<String, Value>, places: &mut BTreeMap<&'a str, Places>) {
    let mut at = |object: &'a Value, near: bool| {
        let extensions = object.get("extensions").and_then(Value::as_object);
        for name in extensions.into_iter().flat_map(Map::keys) {
            let found = places.entry(name).or_default();
            match near {
                true => found.near += 1,
                false => found.far += 1,
            }
        }
    };
    let list = |key: &str| items(root.get(key));
    for key in [
        "scenes",
        "nodes",
        "skins",
        "accessors",
        "bufferViews",
        "buffers",
    ] {
        list(key).iter().for_each(|object| at(object, true));
    }
    for mesh in list("meshes") {
        at(mesh, true);
        let primitives = items(mesh.get("primitives"));
        primitives.iter().for_each(|object| at(object, true));
    }
    for animation in list("animations") {
        at(animation, true);
        for channel in items(animation.get("channels")) {
            at(channel, true);
            channel
                .get("target")
                .into_iter()
                .for_each(|object| at(object, true));
        }
        let samplers = items(animation.get("samplers"));
        samplers.iter().for_each(|object| at(object, true));
    }
    for key in ["materials", "textures", "images", "samplers", "cameras"] {
        list(key).iter().for_each(|object| at(object, false));
    }
}
