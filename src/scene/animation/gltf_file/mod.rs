//! glTF 2.0 files.
//!
//! Only geometry and motion are looked at: what materials, pictures, cameras and lights there are is cut out of the
//! JSON before the crate validates it, so that none of them can stand in a ray's way.

mod accessor;
mod mesh;

use super::{Animated, Clip, Curve, Instance, Interpolation, Kind, Local, Node, Object};
use super::{Property, Rig, Skin, Track, Writer};
use crate::text;
use accessor::{Buffers, Numbers, groups};
use anyhow::{Context, Result, anyhow, bail, ensure};
use glam::{DAffine3, DQuat, DVec3};
use gltf::accessor::Dimensions;
use gltf::json::validation::Checked;
use gltf::scene::Transform;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Required extensions that change nothing here: they concern pictures, materials and lights, or allow what is
/// read anyway. Those of materials are known by their beginning.
const HARMLESS_EXTENSIONS: [&str; 7] = [
    "KHR_lights_punctual",
    "KHR_mesh_quantization",
    "KHR_texture_basisu",
    "KHR_texture_transform",
    "EXT_texture_avif",
    "EXT_texture_webp",
    "MSFT_texture_dds",
];

pub fn load(path: &Path) -> Result<Animated> {
    let shown = text::path(path);
    let bytes = std::fs::read(path).with_context(|| format!("{shown}: cannot be read"))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    parse(&bytes, folder, text::escaped(&name).into_owned()).context(shown)
}

fn parse(bytes: &[u8], folder: &Path, name: String) -> Result<Animated> {
    let (json, binary_chunk) = chunks(bytes)?;
    let mut value: Value = serde_json::from_slice(json)
        .map_err(|error| anyhow!("is no glTF: {error}; export it anew"))?;
    let root = value
        .as_object_mut()
        .context("is no glTF: its JSON is no object; export it anew")?;
    check_version_and_extensions(root)?;
    keep_geometry(root)?;
    let root = serde_json::from_value(value)
        .map_err(|error| anyhow!("is no glTF: {error}; export it anew"))?;
    let document = gltf::Document::from_json(root).map_err(|error| match error {
        gltf::Error::Validation(faults) => {
            let (place, fault) = &faults[0];
            let fault = fault.to_string().to_lowercase();
            anyhow!("is no valid glTF: {place}: {fault}; export it anew")
        }
        error => anyhow!("is no glTF: {error}; export it anew"),
    })?;
    let loader = Loader {
        document: &document,
        buffers: Buffers::new(&document, folder, binary_chunk),
        warnings: Vec::new(),
    };
    loader.load(name)
}

/// The JSON and the binary chunk of a binary file, or the whole of a text file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| -> Result<usize> {
        let word = bytes.get(at..at + 4);
        let word = word.context("is a binary glTF file that is cut off; export it anew")?;
        Ok(u32::from_le_bytes(word.try_into().expect("four bytes")) as usize)
    };
    let version = word(4)?;
    ensure!(
        version == 2,
        "is a binary glTF file of version {version}; export it as glTF 2.0"
    );
    let (mut json, mut binary, mut at) = (None, None, 12);
    while at < bytes.len().min(word(8)?) {
        let (length, kind) = (word(at)?, word(at + 4)?);
        let chunk = (at + 8)
            .checked_add(length)
            .and_then(|end| bytes.get(at + 8..end));
        let chunk = chunk.context("is a binary glTF file that is cut off; export it anew")?;
        match &(kind as u32).to_le_bytes() {
            b"JSON" if json.is_none() => json = Some(chunk),
            b"BIN\0" if binary.is_none() => binary = Some(chunk),
            _ => {}
        }
        at += 8 + length;
    }
    let json = json.context("is a binary glTF file without a JSON chunk; export it anew")?;
    Ok((json, binary))
}

fn check_version_and_extensions(root: &Map<String, Value>) -> Result<()> {
    let version = root.get("asset").and_then(|asset| asset.get("version"));
    let version = version.and_then(Value::as_str).unwrap_or("unknown");
    ensure!(
        version.starts_with("2."),
        "is glTF of version {version}; export it as glTF 2.0"
    );
    let required = root.get("extensionsRequired").and_then(Value::as_array);
    let unknown: Vec<&str> = required
        .into_iter()
        .flatten()
        .filter_map(Value::as_str)
        .filter(|name| !HARMLESS_EXTENSIONS.contains(name) && !name.starts_with("KHR_materials_"))
        .collect();
    ensure!(
        unknown.is_empty(),
        "requires {}, which cannot be read here; export it without (uncompressed)",
        unknown.join(", ")
    );
    Ok(())
}

/// Cuts out what is neither geometry nor motion, and amends what the crate demands but nobody needs.
fn keep_geometry(root: &mut Map<String, Value>) -> Result<()> {
    for key in [
        "cameras",
        "extensions",
        "extensionsRequired",
        "extensionsUsed",
        "images",
        "materials",
        "samplers",
        "textures",
    ] {
        root.remove(key);
    }
    let accessors = root.get("accessors").and_then(Value::as_array);
    let accessor_count = accessors.map_or(0, Vec::len) as u64;
    for mesh in objects(root.get_mut("meshes")) {
        let Some(primitives) = mesh.get_mut("primitives") else {
            continue;
        };
        for primitive in objects(Some(primitives)) {
            primitive.remove("material");
            if let Some(Value::Object(attributes)) = primitive.get_mut("attributes") {
                attributes.retain(|name, _| {
                    name == "POSITION"
                        || name.starts_with("JOINTS_")
                        || name.starts_with("WEIGHTS_")
                });
                // The crate looks this one up before it has checked it.
                let position = attributes.get("POSITION").and_then(Value::as_u64);
                ensure!(
                    position.is_none_or(|accessor| accessor < accessor_count),
                    "is no valid glTF: a mesh has its POSITION in accessor {}, which is out of range (there are {accessor_count}, counted from 0); export it anew",
                    position.unwrap_or_default()
                );
            }
            for target in objects(primitive.get_mut("targets")) {
                target.retain(|name, _| name == "POSITION");
            }
        }
    }
    // Boxes are computed, not believed.
    for accessor in objects(root.get_mut("accessors")) {
        let zeros = || Value::from(vec![0.0; 3]);
        accessor.insert("min".into(), zeros());
        accessor.insert("max".into(), zeros());
    }
    for node in objects(root.get_mut("nodes")) {
        node.remove("camera");
        node.remove("extensions");
    }
    for scene in objects(root.get_mut("scenes")) {
        scene
            .entry("nodes")
            .or_insert_with(|| Value::Array(Vec::new()));
    }
    // Channels without a node belong to extensions that animate materials and the like.
    for animation in objects(root.get_mut("animations")) {
        if let Some(Value::Array(channels)) = animation.get_mut("channels") {
            channels.retain(|channel| {
                let target = channel.get("target");
                target.is_none_or(|target| target.get("node").is_some())
            });
        }
    }
    Ok(())
}

/// The objects in a list of them, if it is one.
fn objects(list: Option<&mut Value>) -> impl Iterator<Item = &mut Map<String, Value>> {
    let list = list.and_then(Value::as_array_mut);
    list.into_iter().flatten().filter_map(Value::as_object_mut)
}

struct Loader<'a> {
    document: &'a gltf::Document,
    buffers: Buffers<'a>,
    warnings: Vec<String>,
}

impl Loader<'_> {
    fn load(mut self, name: String) -> Result<Animated> {
        let mut rig = Rig::new(self.nodes()?)?;
        let (objects, instances) = self.objects(&rig)?;
        let clips = self.clips(&mut rig)?;
        // The same mesh may have been read for several skins.
        let mut warnings: Vec<String> = Vec::new();
        for warning in self.warnings {
            if !warnings.contains(&warning) {
                warnings.push(warning);
            }
        }
        Ok(Animated {
            name,
            objects,
            instances,
            clips,
            warnings,
            rig,
        })
    }

    fn nodes(&self) -> Result<Vec<Node>> {
        let mut nodes = Vec::new();
        for node in self.document.nodes() {
            let name = node_name(&node);
            let wide = |v: [f32; 3]| DVec3::from_array(v.map(f64::from));
            let local = match node.transform() {
                Transform::Matrix { matrix } => {
                    let matrix = matrix.map(|column| column.map(f64::from));
                    Local::of_matrix(affine(&matrix).with_context(|| name.clone())?)
                }
                Transform::Decomposed {
                    translation,
                    rotation,
                    scale,
                } => {
                    let rotation = DQuat::from_array(rotation.map(f64::from));
                    let length = rotation.length();
                    ensure!(
                        length > 0.0 && length.is_finite(),
                        "{name}: its rotation is none: {rotation}; correct it"
                    );
                    Local::new(wide(translation), rotation / length, wide(scale))
                }
            };
            let targets = node.mesh().map_or(0, |mesh| target_count(&mesh));
            let given = node.weights();
            let given = given.or_else(|| node.mesh().and_then(|mesh| mesh.weights()));
            let mut weights: Vec<f64> = given
                .unwrap_or_default()
                .iter()
                .map(|&weight| f64::from(weight))
                .collect();
            weights.resize(targets, 0.0);
            nodes.push(Node {
                name,
                parent: None,
                local,
                weights,
            });
        }
        for node in self.document.nodes() {
            for child in node.children() {
                let parent = &mut nodes[child.index()].parent;
                if let Some(other) = parent {
                    bail!(
                        "node {} is a child of node {other} and of node {}; leave it one parent",
                        child.index(),
                        node.index()
                    );
                }
                *parent = Some(node.index());
            }
        }
        Ok(nodes)
    }

    /// The nodes of the scene that the file shows first, or all of a file without scenes, in the order of a walk
    /// through the hierarchy, which has no cycles.
    fn shown_nodes(&self, rig: &Rig) -> Vec<gltf::Node<'_>> {
        let scene = self.document.default_scene();
        let scene = scene.or_else(|| self.document.scenes().next());
        let mut open: Vec<gltf::Node> = match scene {
            Some(scene) => scene.nodes().collect(),
            None => {
                let all = self.document.nodes();
                all.filter(|node| rig.nodes[node.index()].parent.is_none())
                    .collect()
            }
        };
        open.reverse();
        let (mut shown, mut seen) = (Vec::new(), vec![false; rig.nodes.len()]);
        while let Some(node) = open.pop() {
            if std::mem::replace(&mut seen[node.index()], true) {
                continue;
            }
            let children: Vec<gltf::Node> = node.children().collect();
            open.extend(children.into_iter().rev());
            shown.push(node);
        }
        shown
    }

    fn objects(&mut self, rig: &Rig) -> Result<(Vec<Object>, Vec<Instance>)> {
        let mut objects: Vec<Object> = Vec::new();
        let mut instances = Vec::new();
        // One object a mesh and skin. Morph targets are blended by the weights of a node, so that each node with some
        // has an object of its own.
        let mut known: HashMap<(usize, Option<usize>, Option<usize>), Option<usize>> =
            HashMap::new();
        let shown: Vec<(usize, usize)> = self
            .shown_nodes(rig)
            .iter()
            .filter_map(|node| Some((node.index(), node.mesh()?.index())))
            .collect();
        for (node_number, mesh_number) in shown {
            let document = self.document;
            let node = document.nodes().nth(node_number).expect("shown");
            let mesh = document.meshes().nth(mesh_number).expect("validated");
            let skin = node.skin();
            let morphs = target_count(&mesh) > 0;
            let key = (
                mesh_number,
                skin.as_ref().map(|skin| skin.index()),
                morphs.then_some(node_number),
            );
            let object = match known.get(&key) {
                Some(object) => *object,
                None => {
                    let object = self.object(&mesh, skin.as_ref(), node_number, rig)?;
                    let number = object.map(|object| {
                        objects.push(object);
                        objects.len() - 1
                    });
                    known.insert(key, number);
                    number
                }
            };
            // Of a skinned object the palette is the place.
            instances.extend(object.map(|object| Instance {
                name: rig.nodes[node_number].name.clone(),
                object,
                node: skin.is_none().then_some(node_number),
            }));
        }
        ensure!(
            !objects.is_empty(),
            "is an empty scene, it has no triangles; export it with its meshes"
        );
        Ok((objects, instances))
    }

    /// The object that a mesh becomes; none if it has no triangles.
    fn object(
        &mut self,
        mesh: &gltf::Mesh,
        skin: Option<&gltf::Skin>,
        node: usize,
        rig: &Rig,
    ) -> Result<Option<Object>> {
        let skin = skin.map(|skin| self.skin(skin, rig)).transpose()?;
        let joint_count = skin.as_ref().map(Skin::joint_count);
        let name = match mesh.name() {
            Some(name) => name.to_string(),
            None => format!("mesh {}", mesh.index()),
        };
        let parts = mesh::read(&self.buffers, mesh, &name, joint_count, &mut self.warnings)
            .with_context(|| format!("mesh {} ({name})", mesh.index()))?;
        if parts.mesh.triangles.is_empty() {
            return Ok(None);
        }
        let writer = match parts.displacements {
            displacements if displacements.is_empty() => Writer::Nothing,
            displacements => Writer::Morphs {
                displacements,
                node,
            },
        };
        let kind = match (skin, &writer) {
            (Some(skin), _) => Kind::Skinned(Skin {
                influences: parts.influences,
                ..skin
            }),
            (None, Writer::Nothing) => Kind::Static,
            (None, _) => Kind::Morphed,
        };
        Ok(Some(Object {
            name,
            mesh: parts.mesh,
            kind,
            writer,
        }))
    }

    /// A skin as yet without a mesh.
    fn skin(&self, skin: &gltf::Skin, rig: &Rig) -> Result<Skin> {
        let place = || format!("skin {}", skin.index());
        let nodes: Vec<usize> = skin.joints().map(|joint| joint.index()).collect();
        ensure!(
            nodes.len() <= usize::from(u16::MAX) + 1,
            "{}: has {} joints; at most 65536 can be named",
            place(),
            nodes.len()
        );
        let inverse_bind = match skin.inverse_bind_matrices() {
            None => vec![DAffine3::IDENTITY; nodes.len()],
            Some(accessor) => {
                let numbers = self
                    .buffers
                    .read(&accessor, Dimensions::Mat4, Numbers::AsStored)
                    .with_context(|| format!("{}, inverseBindMatrices", place()))?;
                let columns = groups::<4>(&numbers);
                let matrices: Vec<[[f64; 4]; 4]> = columns
                    .chunks_exact(4)
                    .map(|matrix| [matrix[0], matrix[1], matrix[2], matrix[3]])
                    .collect();
                ensure!(
                    matrices.len() >= nodes.len(),
                    "{}: has {} inverse bind matrices for {} joints; export the file anew",
                    place(),
                    matrices.len(),
                    nodes.len()
                );
                let matrices = matrices[..nodes.len()].iter().enumerate();
                matrices
                    .map(|(number, matrix)| {
                        affine(matrix)
                            .with_context(|| format!("{}, inverse bind matrix {number}", place()))
                    })
                    .collect::<Result<_>>()?
            }
        };
        Ok(Skin {
            influences: Vec::new(),
            joint_names: nodes
                .iter()
                .map(|&node| rig.nodes[node].name.clone())
                .collect(),
            nodes,
            inverse_bind,
        })
    }

    fn clips(&mut self, rig: &mut Rig) -> Result<Vec<Clip>> {
        let mut clips: Vec<Clip> = Vec::new();
        for animation in self.document.animations() {
            let given = match animation.name() {
                Some(name) if !name.is_empty() => text::escaped(name).into_owned(),
                _ => animation.index().to_string(),
            };
            let mut name = given.clone();
            let mut copy = 1;
            while clips.iter().any(|clip| clip.name == name) {
                copy += 1;
                name = format!("{given} {copy}");
            }
            let (mut tracks, mut seconds) = (Vec::new(), 0f64);
            for channel in animation.channels() {
                let track = self.track(&channel, rig).with_context(|| {
                    format!(
                        "animation {} ({name}), channel {}",
                        animation.index(),
                        channel.index()
                    )
                })?;
                seconds = track
                    .iter()
                    .fold(seconds, |seconds, track| seconds.max(track.curve.end()));
                tracks.extend(track);
            }
            rig.add_clip(tracks);
            clips.push(Clip { name, seconds });
        }
        Ok(clips)
    }

    /// What a channel does; nothing, if it moves morph targets of what has none.
    fn track(&self, channel: &gltf::animation::Channel, rig: &Rig) -> Result<Option<Track>> {
        // The crate checks a channel's sampler but not its target.
        let animation = &self.document.as_json().animations[channel.animation().index()];
        let target = &animation.channels[channel.index()].target;
        let node = target.node.value();
        ensure!(
            node < rig.nodes.len(),
            "moves node {node}, which is out of range (there are {}, counted from 0); export the file anew",
            rig.nodes.len()
        );
        let Checked::Valid(property) = target.path else {
            bail!("moves no property that glTF knows; remove it");
        };
        let (property, dimensions, numbers, width) = match property {
            gltf::animation::Property::Translation => (
                Property::Translation,
                Dimensions::Vec3,
                Numbers::AsStored,
                3,
            ),
            gltf::animation::Property::Rotation => {
                (Property::Rotation, Dimensions::Vec4, Numbers::Fractions, 4)
            }
            gltf::animation::Property::Scale => {
                (Property::Scale, Dimensions::Vec3, Numbers::AsStored, 3)
            }
            gltf::animation::Property::MorphTargetWeights => {
                let width = rig.nodes[node].weights.len();
                if width == 0 {
                    return Ok(None);
                }
                (
                    Property::Weights,
                    Dimensions::Scalar,
                    Numbers::Fractions,
                    width,
                )
            }
        };
        let sampler = channel.sampler();
        let times = self
            .buffers
            .read(&sampler.input(), Dimensions::Scalar, Numbers::AsStored)
            .context("input")?;
        let values = self
            .buffers
            .read(&sampler.output(), dimensions, numbers)
            .context("output")?;
        let interpolation = match sampler.interpolation() {
            gltf::animation::Interpolation::Step => Interpolation::Step,
            gltf::animation::Interpolation::Linear => Interpolation::Linear,
            gltf::animation::Interpolation::CubicSpline => Interpolation::CubicSpline,
        };
        let curve = Curve::new(times, values, width, interpolation);
        let curve = match property {
            Property::Rotation => curve.and_then(Curve::of_rotations),
            _ => curve,
        };
        let curve = curve.map_err(|error| anyhow!("{error}; export the file anew"))?;
        Ok(Some(Track {
            node,
            property,
            curve,
        }))
    }
}

fn node_name(node: &gltf::Node) -> String {
    match node.name() {
        Some(name) if !name.is_empty() => text::escaped(name).into_owned(),
        _ => format!("node {}", node.index()),
    }
}

/// Morph targets of a mesh: the most that any part of it has.
fn target_count(mesh: &gltf::Mesh) -> usize {
    let primitives = mesh.primitives();
    primitives
        .map(|primitive| primitive.morph_targets().count())
        .max()
        .unwrap_or(0)
}

/// A matrix by columns as an affine map.
fn affine(columns: &[[f64; 4]; 4]) -> Result<DAffine3> {
    let last_row = columns.map(|column| column[3]);
    ensure!(
        columns.iter().flatten().all(|x| x.is_finite()),
        "its matrix is not finite; correct it"
    );
    // Some exporters compute the last row; what is left of that is not meant.
    let off = std::iter::zip(last_row, [0.0, 0.0, 0.0, 1.0]).map(|(a, b)| (a - b).abs());
    ensure!(
        off.fold(0.0, f64::max) < 1e-3,
        "its matrix has the last row {last_row:?}; only 0, 0, 0, 1 is a place in space"
    );
    let column = |number: usize| {
        let [x, y, z, _] = columns[number];
        DVec3::new(x, y, z)
    };
    Ok(DAffine3::from_cols(
        column(0),
        column(1),
        column(2),
        column(3),
    ))
}

/// The numbers of the attribute sets that a primitive has: of JOINTS and of WEIGHTS.
fn attribute_sets(primitive: &gltf::Primitive) -> BTreeMap<u32, (bool, bool)> {
    let mut sets = BTreeMap::new();
    for (semantic, _) in primitive.attributes() {
        match semantic {
            gltf::Semantic::Joints(set) => sets.entry(set).or_insert((false, false)).0 = true,
            gltf::Semantic::Weights(set) => sets.entry(set).or_insert((false, false)).1 = true,
            _ => {}
        }
    }
    sets
}
