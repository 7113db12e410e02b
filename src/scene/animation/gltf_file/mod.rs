//! glTF 2.0 files.
//!
//! Only the shown geometry and its motion are read. Everything else is removed from the JSON before the crate validates
//! it, so faults in it cannot cause an error (see [`clean`]). Geometry that is in the file and not in the picture
//! causes a warning. Two extensions are supported: EXT_mesh_gpu_instancing, which places instances, and KHR_node_visibility,
//! which hides nodes; see [`extensions`].

mod accessor;
mod clean;
mod extensions;
mod mesh;

use super::{
    Animated, Clip, Curve, Instance, Interpolation, Kind, Local, Node, Object, number, some,
};
use super::{Property, Rig, Skin, Track, Writer};
use crate::scene::sources::read_regular;
use crate::text;
use accessor::{Buffers, Numbers, groups};
use anyhow::{Context, Result, anyhow, bail, ensure};
use clean::Facts;
use glam::{DAffine3, DQuat, DVec3};
use gltf::accessor::Dimensions;
use gltf::json::validation::Checked;
use gltf::scene::Transform;
use serde_json::{Map, Value};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Maximum number of instances of EXT_mesh_gpu_instancing, because an accessor without a buffer can have any count.
const MOST_INSTANCES: usize = 1 << 20;

pub fn load(path: &Path) -> Result<Animated> {
    let shown = text::path(path);
    let bytes = read_regular(path)
        .map_err(|error| anyhow!("{shown}: cannot be read: {error}; give a file that can be"))?;
    let folder = path.parent().unwrap_or(Path::new(""));
    let name = path.file_stem().unwrap_or_default();
    let mut scene = parse(&bytes, folder, text::path(Path::new(name))).map_err(|error| {
        // Any part of the message may contain words from the file.
        anyhow!("{shown}: {}", text::escaped(&format!("{error:#}")))
    })?;
    for warning in &mut scene.warnings {
        *warning = text::escaped(warning).into_owned();
    }
    Ok(scene)
}

fn parse(bytes: &[u8], folder: &Path, name: String) -> Result<Animated> {
    let (json, binary_chunk) = chunks(bytes)?;
    let value: Value = serde_json::from_slice(trimmed(json))
        .map_err(|error| anyhow!("is not glTF: {error}; export it again"))?;
    let root = value
        .as_object()
        .context("is not glTF: its JSON is not an object; export it again")?;
    check_version(root)?;
    extensions::check_required(root)?;
    let (cleaned, facts) = clean::clean(root)?;
    drop(value);
    let root = serde_json::from_value(cleaned)
        .map_err(|error| anyhow!("is not glTF: {error}; export it again"))?;
    let document = gltf::Document::from_json(root).map_err(|error| match error {
        gltf::Error::Validation(faults) => {
            let (place, fault) = &faults[0];
            let fault = fault.to_string().to_lowercase();
            anyhow!("is not valid glTF: {place}: {fault}; export it again")
        }
        error => anyhow!("is not glTF: {error}; export it again"),
    })?;
    let loader = Loader {
        document: &document,
        buffers: Buffers::new(&document, &facts, folder, binary_chunk),
        warnings: facts.warnings.clone(),
        facts: &facts,
    };
    loader.load(name)
}

/// JSON without additions by some exporters: a byte order mark, and zeros at the end of a chunk.
fn trimmed(json: &[u8]) -> &[u8] {
    let json = json.strip_prefix(b"\xef\xbb\xbf").unwrap_or(json);
    let end = json
        .iter()
        .rposition(|&byte| byte != 0 && !byte.is_ascii_whitespace());
    &json[..end.map_or(0, |last| last + 1)]
}

/// The JSON and the binary chunk of a binary file, or the whole text file.
fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>)> {
    if !bytes.starts_with(b"glTF") {
        return Ok((bytes, None));
    }
    let word = |at: usize| -> Result<usize> {
        let word = bytes.get(at..at + 4);
        let word = word.context("is a binary glTF file that is cut off; export it again")?;
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
        let chunk = chunk.context("is a binary glTF file that is cut off; export it again")?;
        match &(kind as u32).to_le_bytes() {
            b"JSON" if json.is_none() => json = Some(chunk),
            b"BIN\0" if binary.is_none() => binary = Some(chunk),
            _ => {}
        }
        at += 8 + length;
    }
    let json = json.context("is a binary glTF file without a JSON chunk; export it again")?;
    Ok((json, binary))
}

fn check_version(root: &Map<String, Value>) -> Result<()> {
    let version = root.get("asset").and_then(|asset| asset.get("version"));
    let version = version.and_then(Value::as_str).unwrap_or("unknown");
    ensure!(
        version.starts_with("2."),
        "is glTF of version {}; export it as glTF 2.0",
        text::word(version)
    );
    Ok(())
}

struct Loader<'a> {
    document: &'a gltf::Document,
    facts: &'a Facts,
    buffers: Buffers<'a>,
    warnings: Vec<String>,
}

impl Loader<'_> {
    fn load(mut self, name: String) -> Result<Animated> {
        let mut rig = Rig::new(self.nodes()?)?;
        let (objects, instances) = self.objects(&rig)?;
        let clips = self.clips(&mut rig)?;
        // The same mesh may be read for several skins.
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
                        "{name}: its rotation is none: {}; correct it",
                        quaternion(rotation)
                    );
                    Local::new(wide(translation), rotation / length, wide(scale))
                }
            };
            let mesh = self.facts.meshes[node.index()];
            let targets = mesh.and_then(|mesh| self.facts.targets.get(mesh).copied());
            let given = node.weights();
            let given = given.or_else(|| node.mesh().and_then(|mesh| mesh.weights()));
            let mut weights: Vec<f64> = given
                .unwrap_or_default()
                .iter()
                .map(|&weight| f64::from(weight))
                .collect();
            weights.resize(targets.unwrap_or(0), 0.0);
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

    fn objects(&mut self, rig: &Rig) -> Result<(Vec<Object>, Vec<Instance>)> {
        let mut objects: Vec<Object> = Vec::new();
        let mut instances = Vec::new();
        // One object per mesh and skin. Morph targets are blended by the weights of a node, so each node with weights
        // has its own object.
        let mut known: HashMap<(usize, Option<usize>, Option<usize>), Option<usize>> =
            HashMap::new();
        for &node_number in &self.facts.shown {
            let document = self.document;
            let node = document.nodes().nth(node_number).expect("shown");
            let Some(mesh) = node.mesh() else {
                continue;
            };
            let skin = node.skin();
            let morphs = target_count(&mesh) > 0;
            let key = (
                mesh.index(),
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
            if let Some(object) = object {
                // The palette gives the place of a skinned object.
                let place = skin.is_none().then_some(node_number);
                self.stand(object, node_number, place, rig, &mut instances)?;
            }
        }
        if objects.is_empty() {
            let reasons = match self.warnings.is_empty() {
                true => "it has no triangles".into(),
                false => format!(
                    "nothing is left of it: {}",
                    some(self.warnings.iter().map(String::as_str))
                ),
            };
            bail!("is an empty scene, {reasons}; export it with its meshes");
        }
        Ok((objects, instances))
    }

    /// Places an object at its node: once, or as often as the node's EXT_mesh_gpu_instancing requires.
    fn stand(
        &self,
        object: usize,
        node: usize,
        place: Option<usize>,
        rig: &Rig,
        instances: &mut Vec<Instance>,
    ) -> Result<()> {
        let name = &rig.nodes[node].name;
        let locals = match self.facts.instancing.get(&node) {
            None => {
                instances.push(Instance {
                    name: name.clone(),
                    object,
                    node: place,
                    local: DAffine3::IDENTITY,
                });
                return Ok(());
            }
            Some(attributes) => self
                .instancing(attributes)
                .with_context(|| format!("{}: EXT_mesh_gpu_instancing", titled(node, name)))?,
        };
        ensure!(
            instances.len() + locals.len() <= MOST_INSTANCES,
            "{}: with its {} instances the scene has more than {MOST_INSTANCES}; export fewer",
            titled(node, name),
            locals.len()
        );
        let numbered = locals.into_iter().enumerate();
        instances.extend(numbered.map(|(number, local)| Instance {
            name: format!("{name} [{number}]"),
            object,
            node: place,
            local,
        }));
        Ok(())
    }

    /// The placements of instances relative to their node: translation × rotation × scale, as far as the file has them.
    fn instancing(&self, attributes: &[(String, usize)]) -> Result<Vec<DAffine3>> {
        let read = |wanted: &str, dimensions, numbers| {
            let Some((_, place)) = attributes.iter().find(|(name, _)| name == wanted) else {
                return Ok(None);
            };
            let accessor = self.document.accessors().nth(*place).expect("checked");
            ensure!(
                accessor.count() <= MOST_INSTANCES,
                "{wanted}: has {} instances; at most {MOST_INSTANCES} can be shown: export fewer",
                accessor.count()
            );
            let values = self.buffers.read(&accessor, dimensions, numbers);
            values.with_context(|| wanted.to_string()).map(Some)
        };
        let translations = read("TRANSLATION", Dimensions::Vec3, Numbers::AsStored)?;
        let rotations = read("ROTATION", Dimensions::Vec4, Numbers::Fractions)?;
        let scales = read("SCALE", Dimensions::Vec3, Numbers::AsStored)?;
        let translations = translations.map(|numbers| groups::<3>(&numbers));
        let rotations = rotations.map(|numbers| groups::<4>(&numbers));
        let scales = scales.map(|numbers| groups::<3>(&numbers));
        let counts = [
            translations.as_ref().map(Vec::len),
            rotations.as_ref().map(Vec::len),
            scales.as_ref().map(Vec::len),
        ];
        let mut given = counts.iter().flatten();
        let count = *given.next().expect("it has one of the three");
        ensure!(
            given.all(|&other| other == count),
            "its attributes have {} elements, which must be equal in number; export the file again",
            counts
                .iter()
                .flatten()
                .map(usize::to_string)
                .collect::<Vec<_>>()
                .join(" and ")
        );
        let locals = (0..count).map(|number| {
            let vector = |of: &Option<Vec<[f64; 3]>>, none| {
                of.as_ref()
                    .map_or(none, |all| DVec3::from_array(all[number]))
            };
            let rotation = match &rotations {
                None => DQuat::IDENTITY,
                Some(all) => {
                    let rotation = DQuat::from_array(all[number]);
                    let length = rotation.length();
                    ensure!(
                        length > 0.0 && length.is_finite(),
                        "ROTATION: element {number} is not a rotation: {}; correct it",
                        quaternion(rotation)
                    );
                    rotation / length
                }
            };
            Ok(DAffine3::from_scale_rotation_translation(
                vector(&scales, DVec3::ONE),
                rotation,
                vector(&translations, DVec3::ZERO),
            ))
        });
        locals.collect()
    }

    /// The object of a mesh; `None` if it has no triangles.
    fn object(
        &mut self,
        mesh: &gltf::Mesh,
        skin: Option<&gltf::Skin>,
        node: usize,
        rig: &Rig,
    ) -> Result<Option<Object>> {
        let skin = skin.map(|skin| self.skin(skin, rig)).transpose()?;
        let joint_count = skin.as_ref().map(Skin::joint_count);
        let number = format!("mesh {}", mesh.index());
        // The name for warnings and errors, and the name of the object.
        let (title, place, name) = match mesh.name() {
            Some(name) => (
                format!("mesh {name}"),
                format!("{number} ({name})"),
                name.to_string(),
            ),
            None => (number.clone(), number.clone(), number),
        };
        let nothing = self.facts.accessors;
        let parts = mesh::read(
            &self.buffers,
            mesh,
            &title,
            joint_count,
            nothing,
            &mut self.warnings,
        )
        .context(place)?;
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

    /// A skin that has no mesh yet.
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
                    "{}: has {} inverse bind matrices for {} joints; export the file again",
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
                Some(name) if !name.is_empty() => name.to_string(),
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
                        self.facts.channels[animation.index()][channel.index()]
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

    /// The track of a channel; `None` if it moves the morph targets of a mesh without any.
    fn track(&self, channel: &gltf::animation::Channel, rig: &Rig) -> Result<Option<Track>> {
        // The crate checks a channel's sampler, but not its target.
        let animation = &self.document.as_json().animations[channel.animation().index()];
        let target = &animation.channels[channel.index()].target;
        let node = target.node.value();
        ensure!(
            node < rig.nodes.len(),
            "moves node {node}, which is out of range (there are {}, counted from 0); export the file again",
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
        let curve = curve.map_err(|error| anyhow!("{error}; export the file again"))?;
        Ok(Some(Track {
            node,
            property,
            curve,
        }))
    }
}

fn quaternion(rotation: DQuat) -> String {
    format!("[{}]", rotation.to_array().map(number).join(", "))
}

fn node_name(node: &gltf::Node) -> String {
    match node.name() {
        Some(name) if !name.is_empty() => name.to_string(),
        _ => format!("node {}", node.index()),
    }
}

/// The name of a node in messages: its number, and its name if it has one.
fn titled(node: usize, name: &str) -> String {
    match name == format!("node {node}") {
        true => name.to_string(),
        false => format!("node {node} ({name})"),
    }
}

/// The number of morph targets of a mesh: the maximum over its primitives.
fn target_count(mesh: &gltf::Mesh) -> usize {
    let primitives = mesh.primitives();
    primitives
        .map(|primitive| primitive.morph_targets().count())
        .max()
        .unwrap_or(0)
}

/// A matrix given by columns, as an affine map.
fn affine(columns: &[[f64; 4]; 4]) -> Result<DAffine3> {
    let last_row = columns.map(|column| column[3]);
    ensure!(
        columns.iter().flatten().all(|x| x.is_finite()),
        "its matrix is not finite; correct it"
    );
    // Some exporters compute the last row, so tolerate rounding errors.
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

/// The numbers of the attribute sets JOINTS and WEIGHTS of a primitive.
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
