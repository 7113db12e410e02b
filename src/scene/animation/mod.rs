//! Animated scenes.
//!
//! An [`Animated`] scene consists of [`Object`]s, which are meshes of constant topology, and of their [`Instance`]s in the
//! world. A [`Pose`] is one frame: all data that the host computes and writes to the machine.
//!
//! | moving part | moved by |
//! |---|---|
//! | a whole object | the host writes the matrix of its instance |
//! | a skinned object's vertices | the host writes the matrices of the palette, the machine the vertices |
//! | morph targets, mesh sequences, water | the host writes the vertices (of a skinned object those at rest) |
//!
//! As in glTF, a skinned object ignores the place of its node: its palette leads to the world, and
//! the matrix of its instance is the identity. All numbers here are in the scene's own units and in double
//! precision; [`Animated::extents`] and [`log2_scale`](super::log2_scale) give the scale for the machine.

mod curve;
pub(super) mod gltf_file;
mod machine;
mod rig;
pub(super) mod sequence;
mod skin;

pub use machine::{MachineFrame, MachineObject, MachineScene, ObjectFrame};
pub use sequence::SEQUENCE_FRAMES_PER_SECOND;
pub use skin::{Influences, MOST_INFLUENCES, Skin, skin_f64, transform_point};

pub(super) use curve::{Curve, Interpolation};
pub(super) use rig::{Local, Node, Property, Rig, Track};

use super::{Bounds, Camera, ImageSize, Mesh, Scene};
use crate::text::escaped;
use anyhow::{Context, Result, bail, ensure};
use glam::{DAffine3, DQuat, DVec3};
use std::borrow::Cow;
use std::rc::Rc;

/// A 3×4 matrix by rows: it maps (x, y, z) to `m[row][0]·x + m[row][1]·y + m[row][2]·z + m[row][3]`.
pub type Matrix3x4 = [[f64; 4]; 3];

/// The identity.
pub const IDENTITY: Matrix3x4 = [
    [1.0, 0.0, 0.0, 0.0],
    [0.0, 1.0, 0.0, 0.0],
    [0.0, 0.0, 1.0, 0.0],
];

/// A scene with its clips.
#[derive(Clone, Debug)]
pub struct Animated {
    /// The file's stem, the folder's name, or the built-in scene's name.
    pub name: String,
    /// At least one object, each with at least one triangle.
    pub objects: Vec<Object>,
    /// At least one instance; every object has one.
    pub instances: Vec<Instance>,
    /// The clips of the scene; empty for a static scene.
    pub clips: Vec<Clip>,
    /// The parts of the source that were left out or changed, one line each.
    pub warnings: Vec<String>,
    pub(super) rig: Rig,
}

/// A mesh with constant triangles.
#[derive(Clone, Debug)]
pub struct Object {
    pub name: String,
    /// The mesh at rest, in object space. Adjacent triangles share vertices.
    pub mesh: Mesh,
    pub kind: Kind,
    pub(super) writer: Writer,
}

/// The way in which an object's vertices move within the object.
#[derive(Clone, Debug)]
pub enum Kind {
    /// Not at all.
    Static,
    /// By joints; the vertices at rest may also be blended from morph targets.
    Skinned(Skin),
    /// The host blends them from morph targets.
    Morphed,
    /// The host takes them from a sequence of meshes.
    Sequence,
    /// The host computes them.
    Procedural,
}

/// The source of the vertices that the host writes in each frame.
#[derive(Clone, Debug)]
pub(super) enum Writer {
    Nothing,
    /// The mesh plus displacements, each multiplied by a weight of the node.
    Morphs {
        displacements: Vec<Vec<[f64; 3]>>,
        node: usize,
    },
    Frames(Vec<Vec<[f64; 3]>>),
    /// The result of a formula for a resolution and a time in seconds.
    Formula {
        formula: fn(u32, f64) -> Vec<[f64; 3]>,
        detail: u32,
    },
}

/// An instance of an object in the world.
#[derive(Clone, Debug)]
pub struct Instance {
    pub name: String,
    /// Its index in [`Animated::objects`].
    pub object: usize,
    /// The node that carries it; `None` for the identity.
    pub(super) node: Option<usize>,
    /// Its transform relative to that node.
    pub(super) local: DAffine3,
}

/// A named motion of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    /// Unique in its scene; a clip without a name in the source is named by its number.
    pub name: String,
    /// The time of its last key; before 0 and after this time nothing moves. The caller may repeat the clip.
    pub seconds: f64,
}

impl Clip {
    /// Times that divide the clip into `frames` equal steps, starting with 0. The end is not included, because a repeated
    /// clip starts again there.
    pub fn frame_times(&self, frames: usize) -> Vec<f64> {
        let step = |i| self.seconds * i as f64 / frames as f64;
        (0..frames).map(step).collect()
    }
}

/// One frame: the data that the host computes and writes to the machine.
#[derive(Clone, Debug, PartialEq)]
pub struct Pose {
    /// One per object.
    pub objects: Vec<ObjectPose>,
    /// One matrix per instance, from object space to the world, never singular; `None` for an instance that is absent
    /// in this frame because a scale of 0 flattens it.
    pub instances: Vec<Option<Matrix3x4>>,
}

/// The data of one object in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectPose {
    /// The vertices, if the host writes them in each frame (see [`Object::is_written_by_host`]); those at rest if
    /// the object is skinned.
    pub positions: Option<Vec<[f64; 3]>>,
    /// For a skinned object, one matrix per joint: the joint's transform in the world × its inverse bind matrix. Otherwise empty.
    pub palette: Vec<Matrix3x4>,
}

/// Rotations of joints by a program, in addition to a clip.
#[derive(Clone, Debug, Default)]
pub struct Overrides {
    rotations: Vec<(String, Rotation)>,
}

#[derive(Clone, Copy, Debug)]
enum Rotation {
    Instead(DQuat),
    Further(DQuat),
}

impl Overrides {
    /// Sets a joint's rotation relative to its parent and overrides the clip; a quaternion x, y, z, w of any length
    /// except zero.
    pub fn rotate(mut self, joint: &str, quaternion: [f64; 4]) -> Self {
        let rotation = Rotation::Instead(DQuat::from_array(quaternion));
        self.rotations.push((joint.to_string(), rotation));
        self
    }

    /// Rotates a joint, relative to its position in the clip or at rest, about an axis in its own space. The axis may have any length
    /// except zero; the angle is in radians, counter-clockwise seen against the axis.
    pub fn turn(mut self, joint: &str, axis: [f64; 3], angle: f64) -> Self {
        // An invalid axis results in a quaternion of NaNs, which posing rejects.
        let axis = DVec3::from_array(axis).normalize();
        let rotation = Rotation::Further(DQuat::from_axis_angle(axis, angle));
        self.rotations.push((joint.to_string(), rotation));
        self
    }
}

/// The boxes of a scene over several frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Extents {
    /// The box of all instances' triangles in the world.
    pub world: Bounds,
    /// One per object.
    pub objects: Vec<ObjectExtents>,
}

/// The boxes of an object's triangles over several frames, in object space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectExtents {
    /// The box of the vertices as written by the host, before skinning.
    pub rest: Bounds,
    /// The box of the vertices after skinning, as in the tree.
    pub posed: Bounds,
}

impl Object {
    /// The skin, if the object has one.
    pub fn skin(&self) -> Option<&Skin> {
        match &self.kind {
            Kind::Skinned(skin) => Some(skin),
            _ => None,
        }
    }

    /// Whether the host writes the vertices in every frame (for a skinned object, those at rest); otherwise they are constant.
    pub fn is_written_by_host(&self) -> bool {
        !matches!(self.writer, Writer::Nothing)
    }

    /// For each vertex, whether a triangle uses it.
    fn used(&self) -> Vec<bool> {
        let mut used = vec![false; self.mesh.positions.len()];
        for &index in self.mesh.triangles.iter().flatten() {
            used[index as usize] = true;
        }
        used
    }
}

impl Animated {
    /// A static scene of one object.
    pub(super) fn still(scene: Scene) -> Self {
        let Scene {
            name,
            mesh,
            warnings,
        } = scene;
        let mut animated = Self::single(name, mesh, Kind::Static, Writer::Nothing);
        animated.warnings = warnings;
        animated
    }

    /// A scene of one object at the identity, without clips.
    pub(super) fn single(name: String, mesh: Mesh, kind: Kind, writer: Writer) -> Self {
        Animated {
            objects: vec![Object {
                name: name.clone(),
                mesh,
                kind,
                writer,
            }],
            instances: vec![Instance {
                name: name.clone(),
                object: 0,
                node: None,
                local: DAffine3::IDENTITY,
            }],
            clips: Vec::new(),
            warnings: Vec::new(),
            rig: Rig::default(),
            name,
        }
    }

    /// The index in `clips` of the clip with this name, in the form of the file or of messages; without a name, the first clip,
    /// if there is one.
    ///
    /// # Errors
    /// One line that lists the existing clips, if none has the name.
    pub fn clip(&self, name: Option<&str>) -> Result<Option<usize>> {
        let Some(name) = name else {
            return Ok((!self.clips.is_empty()).then_some(0));
        };
        let shown = escaped(name);
        let named = |name: &str| self.clips.iter().position(|clip| clip.name == name);
        match named(name).or_else(|| named(&shown)) {
            Some(place) => Ok(Some(place)),
            None if self.clips.is_empty() => bail!(
                "scene {}: no clip `{shown}`: this scene has no clips; leave the clip out",
                self.name
            ),
            None => bail!(
                "scene {}: no clip `{shown}`; there are {}",
                self.name,
                quoted(self.clips.iter().map(|clip| clip.name.as_str()))
            ),
        }
    }

    /// The names of the joints and other nodes that [`Overrides`] can rotate.
    pub fn node_names(&self) -> Vec<&str> {
        let nodes = self.rig.nodes.iter();
        nodes.map(|node| node.name.as_str()).collect()
    }

    /// Number of triangles of all objects, each object counted once.
    pub fn triangle_count(&self) -> usize {
        let objects = self.objects.iter();
        objects.map(|object| object.mesh.triangles.len()).sum()
    }

    /// The scene at a time of a clip, or at rest. Before the first key and after the last a clip is constant.
    ///
    /// # Errors
    /// See [`Animated::pose_with`].
    pub fn pose(&self, clip: Option<usize>, seconds: f64) -> Result<Pose> {
        self.pose_with(clip, seconds, &Overrides::default())
    }

    /// The scene at a time of a clip, or at rest, with joints rotated by a program.
    ///
    /// Instances with a singular matrix are left out, because the machine needs the inverse; animators use a scale of 0 to hide
    /// objects. [`Animated::warnings_of`] reports them.
    ///
    /// # Errors
    /// One line if there is no such clip, if the time is NaN, if an override names no node or several, if it is not a
    /// rotation, or if a matrix is not finite.
    pub fn pose_with(
        &self,
        clip: Option<usize>,
        seconds: f64,
        overrides: &Overrides,
    ) -> Result<Pose> {
        self.try_pose(clip, seconds, overrides).with_context(|| {
            match clip.and_then(|clip| self.clips.get(clip)) {
                Some(clip) => format!(
                    "scene {}, clip {} at {} s",
                    self.name,
                    clip.name,
                    number(seconds)
                ),
                None => format!("scene {}", self.name),
            }
        })
    }

    fn try_pose(&self, clip: Option<usize>, seconds: f64, overrides: &Overrides) -> Result<Pose> {
        ensure!(
            !seconds.is_nan(),
            "the time is NaN; give a number of seconds"
        );
        if let Some(clip) = clip {
            ensure!(
                clip < self.clips.len(),
                "no clip {clip}, counted from 0: there are {}",
                self.clips.len()
            );
        }
        let posed = self.rig.pose(clip, seconds, |locals| {
            for (name, rotation) in &overrides.rotations {
                let local = &mut locals[self.node(name)?];
                let rotation = match rotation {
                    Rotation::Instead(rotation) => *rotation,
                    Rotation::Further(turn) => local.rotation * *turn,
                };
                let length = rotation.length();
                ensure!(
                    length > 0.0 && length.is_finite(),
                    "the rotation given for `{name}` is not a rotation"
                );
                local.set_rotation(rotation / length);
            }
            Ok(())
        })?;
        let instances = self.instances.iter().map(|instance| {
            let Some(node) = instance.node else {
                return Ok(Some(IDENTITY));
            };
            let matrix = posed.globals[node] * instance.local;
            ensure!(
                matrix.is_finite(),
                "the matrix of instance {} is not finite; bring its node's numbers towards 1",
                instance.name
            );
            Ok((!is_singular(&matrix)).then(|| rows(&matrix)))
        });
        let instances = instances.collect::<Result<_>>()?;
        let objects = self.objects.iter().map(|object| {
            let palette = object.skin().map_or(Ok(Vec::new()), |skin| {
                std::iter::zip(&skin.nodes, &skin.inverse_bind)
                    .enumerate()
                    .map(|(joint, (&node, inverse_bind))| {
                        let matrix = posed.globals[node] * *inverse_bind;
                        ensure!(
                            matrix.is_finite(),
                            "the matrix of joint {} of {} is not finite; bring its node's numbers towards 1",
                            skin.joint_names[joint],
                            object.name
                        );
                        Ok(rows(&matrix))
                    })
                    .collect()
            })?;
            Ok(ObjectPose {
                positions: object.written(clip, seconds, &posed.weights),
                palette,
            })
        });
        Ok(Pose {
            objects: objects.collect::<Result<_>>()?,
            instances,
        })
    }

    /// The node with this name, in the form of the file or of messages; a joint has priority over another node.
    fn node(&self, name: &str) -> Result<usize> {
        let nodes = &self.rig.nodes;
        let shown = match nodes.iter().any(|node| node.name == name) {
            true => Cow::Borrowed(name),
            false => escaped(name),
        };
        let named = |node: &usize| nodes[*node].name == *shown;
        let skins = self.objects.iter().filter_map(Object::skin);
        let mut joints: Vec<usize> = skins
            .flat_map(|skin| skin.nodes.iter().copied())
            .filter(named)
            .collect();
        joints.sort_unstable();
        joints.dedup();
        if joints.is_empty() {
            joints = (0..self.rig.nodes.len()).filter(named).collect();
        }
        match joints.as_slice() {
            [node] => Ok(*node),
            [] if self.rig.nodes.is_empty() => {
                bail!("no joint `{shown}`: this scene has no joints")
            }
            [] => bail!(
                "no joint `{shown}`; there are {}",
                quoted(self.node_names())
            ),
            several => bail!(
                "`{shown}` is the name of {} nodes; give the one to turn a name of its own",
                several.len()
            ),
        }
    }

    /// Warnings about parts of the scene that are absent in these poses.
    ///
    /// # Panics
    /// If a pose belongs to another scene.
    pub fn warnings_of(&self, poses: &[Pose]) -> Vec<String> {
        let frames = |count: usize| match (count, poses.len()) {
            (all, frames) if all == frames => "all frames".into(),
            (1, frames) => format!("1 of {frames} frames"),
            (count, frames) => format!("{count} of {frames} frames"),
        };
        let mut hidden = Vec::new();
        for (number, instance) in self.instances.iter().enumerate() {
            let absent = poses
                .iter()
                .filter(|pose| pose.instances[number].is_none())
                .count();
            if absent > 0 {
                hidden.push(format!("{} in {}", instance.name, frames(absent)));
            }
        }
        let mut warnings = Vec::new();
        if !hidden.is_empty() {
            warnings.push(format!(
                "scene {}: instances are left out where a scale of 0 makes their matrix singular: {}",
                self.name,
                some(hidden.iter().map(String::as_str))
            ));
        }
        let is_empty = |pose: &&Pose| pose.instances.iter().all(Option::is_none);
        let empty = poses.iter().filter(is_empty).count();
        if empty > 0 {
            warnings.push(format!(
                "scene {}: nothing is left to show in {}: no rays are cast there",
                self.name,
                frames(empty)
            ));
        }
        warnings
    }

    /// The vertices of an object in a pose of this scene, after skinning, in double precision.
    ///
    /// # Panics
    /// If there is no such object, or if the pose belongs to another scene.
    pub fn vertices(&self, pose: &Pose, object: usize) -> Vec<[f64; 3]> {
        let (object, pose) = (&self.objects[object], &pose.objects[object]);
        let positions = pose.positions.as_ref().unwrap_or(&object.mesh.positions);
        match object.skin() {
            Some(skin) => skin_f64(positions, &skin.influences, &pose.palette),
            None => positions.clone(),
        }
    }

    /// The whole scene in a pose as one mesh in the world, in double precision, with all present instances in order.
    ///
    /// # Panics
    /// If the pose belongs to another scene, or if the scene has more than 2³² vertices.
    pub fn world_mesh(&self, pose: &Pose) -> Mesh {
        let mut mesh = Mesh::default();
        for (instance, matrix) in std::iter::zip(&self.instances, &pose.instances) {
            let Some(matrix) = matrix else {
                continue;
            };
            let base = u32::try_from(mesh.positions.len()).expect("at most 2^32 vertices");
            let vertices = self.vertices(pose, instance.object);
            let moved = vertices.iter().map(|&p| transform_point(matrix, p));
            mesh.positions.extend(moved);
            let triangles = &self.objects[instance.object].mesh.triangles;
            mesh.triangles
                .extend(triangles.iter().map(|t| t.map(|index| base + index)));
        }
        mesh
    }

    /// A camera that sees all triangles in all of these poses from the shortest possible distance.
    ///
    /// # Panics
    /// If there are no poses, if one belongs to another scene, or if a vertex is not finite.
    pub fn camera(&self, poses: &[Pose], size: ImageSize) -> Camera {
        let used: Vec<Vec<bool>> = self.objects.iter().map(Object::used).collect();
        let corners = poses.iter().flat_map(|pose| {
            let objects: Vec<Rc<[[f64; 3]]>> = (0..self.objects.len())
                .map(|object| {
                    let vertices = self.vertices(pose, object).into_iter();
                    let used = vertices.zip(&used[object]).filter(|(_, used)| **used);
                    used.map(|(vertex, _)| vertex).collect()
                })
                .collect();
            let instances = std::iter::zip(&self.instances, &pose.instances);
            let there = instances
                .filter_map(|(instance, matrix)| Some((instance.object, matrix.as_ref()?)));
            there.flat_map(move |(object, matrix)| {
                let vertices = Rc::clone(&objects[object]);
                (0..vertices.len()).map(move |vertex| transform_point(matrix, vertices[vertex]))
            })
        });
        Camera::framing_points(corners, f64::from(size.width) / f64::from(size.height))
    }

    /// The boxes of the scene and its objects over the frames of a clip, over the vertices that triangles use, in double
    /// precision.
    ///
    /// # Errors
    /// One line if `times` is empty or a vertex is not finite, and as [`Animated::pose`].
    pub fn extents(&self, clip: Option<usize>, times: &[f64]) -> Result<Extents> {
        ensure!(
            !times.is_empty(),
            "scene {}: no frames; give at least one",
            self.name
        );
        let poses = times.iter().map(|&seconds| self.pose(clip, seconds));
        self.extents_of(&poses.collect::<Result<Vec<_>>>()?)
    }

    /// The boxes of the scene and its objects over several poses: see [`Animated::extents`].
    ///
    /// # Errors
    /// One line if there are no poses, if no instance is present in any of them, or if a vertex is not finite.
    ///
    /// # Panics
    /// If a pose belongs to another scene.
    pub fn extents_of(&self, poses: &[Pose]) -> Result<Extents> {
        ensure!(
            !poses.is_empty(),
            "scene {}: no frames; give at least one",
            self.name
        );
        ensure!(
            poses
                .iter()
                .any(|pose| pose.instances.iter().any(Option::is_some)),
            "scene {}: nothing is shown in any frame: a scale of 0 makes the matrix of every instance singular ({}); give their nodes, and those above them, other scales, or show another time",
            self.name,
            some(self.instances.iter().map(|instance| instance.name.as_str()))
        );
        let mut world = GrowingBox::EMPTY;
        let mut boxes = vec![(GrowingBox::EMPTY, GrowingBox::EMPTY); self.objects.len()];
        let used: Vec<Vec<bool>> = self.objects.iter().map(Object::used).collect();
        for pose in poses {
            for (number, object) in self.objects.iter().enumerate() {
                let vertices = self.vertices(pose, number);
                let rest = pose.objects[number].positions.as_ref();
                let rest = rest.unwrap_or(&object.mesh.positions);
                let (at_rest, posed) = &mut boxes[number];
                let instances = std::iter::zip(&self.instances, &pose.instances);
                let matrices: Vec<&Matrix3x4> = instances
                    .filter(|(instance, _)| instance.object == number)
                    .filter_map(|(_, matrix)| matrix.as_ref())
                    .collect();
                for vertex in (0..vertices.len()).filter(|&vertex| used[number][vertex]) {
                    at_rest.grow(rest[vertex]);
                    posed.grow(vertices[vertex]);
                    for matrix in &matrices {
                        world.grow(transform_point(matrix, vertices[vertex]));
                    }
                }
            }
        }
        let of = |what: GrowingBox, name: &str| {
            let GrowingBox { low, high, finite } = what;
            ensure!(
                finite,
                "scene {}: {name} has vertices that are not finite; bring its numbers towards 1",
                self.name
            );
            Ok((low, high))
        };
        let objects = std::iter::zip(&self.objects, boxes).map(|(object, (rest, posed))| {
            Ok(ObjectExtents {
                rest: of(rest, &object.name)?,
                posed: of(posed, &object.name)?,
            })
        });
        Ok(Extents {
            objects: objects.collect::<Result<_>>()?,
            world: of(world, "the world")?,
        })
    }
}

impl Object {
    /// The vertices that the host writes at a time.
    fn written(
        &self,
        clip: Option<usize>,
        seconds: f64,
        weights: &[Vec<f64>],
    ) -> Option<Vec<[f64; 3]>> {
        let moves = clip.is_some();
        match &self.writer {
            Writer::Nothing => None,
            Writer::Morphs {
                displacements,
                node,
            } => {
                let mut positions = self.mesh.positions.clone();
                for (displacement, &weight) in std::iter::zip(displacements, &weights[*node]) {
                    if weight != 0.0 {
                        for (position, moved) in std::iter::zip(&mut positions, displacement) {
                            for axis in 0..3 {
                                position[axis] += weight * moved[axis];
                            }
                        }
                    }
                }
                Some(positions)
            }
            Writer::Frames(frames) if moves => Some(sequence::at(frames, seconds)),
            Writer::Formula { formula, detail } if moves => Some(formula(*detail, seconds)),
            Writer::Frames(_) | Writer::Formula { .. } => Some(self.mesh.positions.clone()),
        }
    }
}

/// A box to which points are added.
#[derive(Clone, Copy)]
struct GrowingBox {
    low: [f64; 3],
    high: [f64; 3],
    finite: bool,
}

impl GrowingBox {
    const EMPTY: Self = Self {
        low: [f64::INFINITY; 3],
        high: [f64::NEG_INFINITY; 3],
        finite: true,
    };

    fn grow(&mut self, point: [f64; 3]) {
        for (axis, x) in point.into_iter().enumerate() {
            self.low[axis] = self.low[axis].min(x);
            self.high[axis] = self.high[axis].max(x);
            self.finite &= x.is_finite();
        }
    }
}

/// Whether a matrix is singular up to rounding: its columns span almost no volume relative to their lengths.
fn is_singular(matrix: &DAffine3) -> bool {
    const NEXT_TO_NOTHING: f64 = 1e-12;
    let m = matrix.matrix3;
    let columns = [m.x_axis, m.y_axis, m.z_axis];
    if columns.iter().any(|column| column.length() == 0.0) {
        return true;
    }
    let [x, y, z] = columns.map(|column| column / column.length());
    x.cross(y).dot(z).abs() <= NEXT_TO_NOTHING
}

fn rows(matrix: &DAffine3) -> Matrix3x4 {
    let DAffine3 {
        matrix3,
        translation,
    } = matrix;
    std::array::from_fn(|row| {
        [
            matrix3.x_axis[row],
            matrix3.y_axis[row],
            matrix3.z_axis[row],
            translation[row],
        ]
    })
}

/// A number for a message; very large and very small ones in scientific notation.
fn number(x: f64) -> String {
    match x == 0.0 || !x.is_finite() || (1e-6..1e12).contains(&x.abs()) {
        true => x.to_string(),
        false => format!("{x:e}"),
    }
}

/// A list of names for a message, limited to the first few.
pub(super) fn some<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    const MOST: usize = 4;
    let names: Vec<&str> = names.into_iter().collect();
    match names.len() {
        0..=MOST => names.join(", "),
        count => format!("{} and {} more", names[..MOST].join(", "), count - MOST),
    }
}

/// A list of quoted names for an error message, limited in length.
fn quoted<'a>(names: impl IntoIterator<Item = &'a str>) -> String {
    const MOST: usize = 64;
    let names: Vec<String> = names.into_iter().map(|name| format!("`{name}`")).collect();
    match names.len() {
        0..=MOST => names.join(", "),
        count => format!("{} and {} more", names[..MOST].join(", "), count - MOST),
    }
}
