//! An animated scene in the machine's number format.
//!
//! The world is scaled by the greatest power of two for which its box over all frames fits. Every object has its own scale, so its
//! vertices use the full number format, independent of the object's size in the world. A skinned object's vertices are in the
//! world, because its palette leads there; only its vertices at rest have a scale of their own. Matrices between two spaces
//! contain the scales; they are computed in double precision and rounded once.

use super::{Animated, Extents, Matrix3x4, Pose};
use crate::bkd::layout::{Columns, Influence};
use crate::float::{Arithmetic, Format};
use crate::scene::machine::{Loss, log2_scale, losses, power_of_two, world_warning};
use anyhow::{Context, Result, bail, ensure};

/// The constant part of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineScene {
    /// The format of vertices, weights and palettes.
    pub format: Format,
    /// A scene coordinate times 2^`log2_scale` is a machine coordinate of the world.
    pub log2_scale: i32,
    /// One per element of [`Animated::objects`].
    pub objects: Vec<MachineObject>,
    /// The index of the object of each of [`Animated::instances`].
    pub instances: Vec<usize>,
}

/// An object in the machine's number format.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineObject {
    pub name: String,
    /// An object's coordinate times 2^`log2_scale` is a machine coordinate in the space of its tree, which for a
    /// skinned object is the world.
    pub log2_scale: i32,
    /// The same for vertices as written by the host: for a skinned object those at rest, otherwise equal to `log2_scale`.
    pub rest_log2_scale: i32,
    /// The vertices as written by the host, rounded once, without −0.
    pub rest: Vec<[f64; 3]>,
    /// Three indices into `rest` per triangle, as in the object's mesh.
    pub triangles: Vec<[u32; 3]>,
    /// For a skinned object, the 1 to 4 influences of each vertex, with the last one marked.
    pub influences: Option<Vec<Vec<Influence>>>,
}

/// The data that the host supplies in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct MachineFrame {
    /// One per object.
    pub objects: Vec<ObjectFrame>,
    /// One matrix per instance, from object space to the world, both in machine coordinates, in double precision; `None` for
    /// an instance that is absent from this frame. (The machine needs the rounded inverse.)
    pub instances: Vec<Option<Matrix3x4>>,
}

/// The data of one object in a frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ObjectFrame {
    /// The vertices that the host writes in this frame, if any; for a skinned object, those at rest.
    pub written: Option<Vec<[f64; 3]>>,
    /// For a skinned object, one matrix per joint from vertices at rest to the world, both in machine coordinates; otherwise empty.
    pub palette: Vec<Columns>,
}

impl MachineScene {
    /// Scales and rounds a scene whose boxes over all frames are `extents`, for a machine whose palette holds
    /// `joints` matrices.
    ///
    /// # Errors
    /// One line that names the object if it has more joints than the machine's palette, or if its scale is not a number.
    pub fn new(
        scene: &Animated,
        extents: &Extents,
        format: Format,
        joints: u32,
    ) -> Result<MachineScene> {
        let arithmetic = Arithmetic::new(format);
        let world =
            log2_scale(extents.world, format).with_context(|| format!("scene {}", scene.name))?;
        let objects = std::iter::zip(&scene.objects, &extents.objects).map(|(object, extents)| {
            let of = |bounds| {
                log2_scale(bounds, format)
                    .with_context(|| format!("scene {}: {}", scene.name, object.name))
            };
            let (log2_scale, rest_log2_scale) = match object.skin() {
                Some(_) => (world, of(extents.rest)?),
                None => {
                    let own = of(extents.posed)?;
                    (own, own)
                }
            };
            let influences = match object.skin() {
                None => None,
                Some(skin) => {
                    let count = skin.joint_count();
                    ensure!(
                        count <= joints as usize,
                        "scene {}: {} has {count} joints, but the machine's palette holds {joints}; raise skinning.joints, or bind the object to fewer",
                        scene.name,
                        object.name
                    );
                    let of_vertex = |of: &super::Influences| {
                        let n = of.count();
                        let influence = |k: usize| Influence {
                            joint: of.joints[k] as u8,
                            weight: arithmetic.round(of.weights[k]),
                            last: k + 1 == n,
                        };
                        (0..n).map(influence).collect()
                    };
                    Some(skin.influences.iter().map(of_vertex).collect())
                }
            };
            Ok(MachineObject {
                name: object.name.clone(),
                log2_scale,
                rest_log2_scale,
                rest: rounded(&arithmetic, &object.mesh.positions, rest_log2_scale),
                triangles: object.mesh.triangles.clone(),
                influences,
            })
        });
        Ok(MachineScene {
            format,
            log2_scale: world,
            objects: objects.collect::<Result<_>>()?,
            instances: scene.instances.iter().map(|i| i.object).collect(),
        })
    }

    /// The losses of `scene`, the source of this scene, in the format, one line each: for every object at rest, and for the
    /// world.
    pub fn warnings(&self, scene: &Animated, extents: &Extents) -> Vec<String> {
        let meshes = std::iter::zip(&scene.objects, &self.objects).map(|(before, after)| {
            let positions = &before.mesh.positions;
            Loss::of(&before.name, positions, &after.rest, &after.triangles)
        });
        let meshes: Vec<Loss> = meshes.collect();
        let mut warnings = losses(&scene.name, self.format, &meshes);
        // The warning for an object whose box is that of the world was already given.
        let is_said = extents
            .objects
            .iter()
            .any(|object| object.posed == extents.world);
        if !is_said {
            warnings.extend(world_warning(&scene.name, self.format, extents.world));
        }
        warnings
    }

    /// Converts a pose of the scene from which this one was made.
    ///
    /// # Errors
    /// One line that names the object and the joint if the format cannot represent a number of a palette.
    ///
    /// # Panics
    /// If the pose belongs to another scene.
    pub fn frame(&self, pose: &Pose) -> Result<MachineFrame> {
        let arithmetic = Arithmetic::new(self.format);
        assert_eq!(pose.objects.len(), self.objects.len());
        assert_eq!(pose.instances.len(), self.instances.len());
        let objects = std::iter::zip(&self.objects, &pose.objects).map(|(object, pose)| {
            let written = (pose.positions.as_ref())
                .map(|positions| rounded(&arithmetic, positions, object.rest_log2_scale));
            let palette = pose.palette.iter().enumerate().map(|(joint, matrix)| {
                let [from, to] = [object.rest_log2_scale, object.log2_scale];
                let scaled = rescaled(matrix, from, to);
                let columns: Columns = std::array::from_fn(|column| {
                    std::array::from_fn(|row| arithmetic.round(scaled[row][column]) + 0.0)
                });
                ensure!(
                    columns.as_flattened().iter().all(|x| x.is_finite()),
                    "{}: the matrix of joint {joint} has a number that {} cannot hold; bring its scale towards 1, or give the format more exponent bits",
                    object.name,
                    self.format
                );
                Ok(columns)
            });
            Ok(ObjectFrame {
                written,
                palette: palette.collect::<Result<_>>()?,
            })
        });
        let instances = std::iter::zip(&self.instances, &pose.instances);
        Ok(MachineFrame {
            objects: objects.collect::<Result<_>>()?,
            instances: instances
                .map(|(&object, matrix)| {
                    let object = &self.objects[object];
                    // For a skinned object, both the matrix and the quotient of the scales are the identity.
                    let rescaled = |matrix| rescaled(matrix, object.log2_scale, self.log2_scale);
                    matrix.as_ref().map(rescaled)
                })
                .collect(),
        })
    }

    /// Whether all frames can be cast in one level: there is one instance, and in every frame its object space is
    /// the world.
    pub fn is_one_level(&self, frames: &[MachineFrame]) -> bool {
        let identity = |frame: &MachineFrame| frame.instances == [Some(super::IDENTITY)];
        self.instances.len() == 1 && frames.iter().all(identity)
    }

    /// Checks that the vertices of an object that triangles use are numbers after skinning.
    ///
    /// # Errors
    /// One line that names the object and the vertex.
    pub fn check_vertices(&self, object: usize, vertices: &[[f64; 3]]) -> Result<()> {
        let object = &self.objects[object];
        for &vertex in object.triangles.iter().flatten() {
            if vertices[vertex as usize].iter().any(|x| !x.is_finite()) {
                bail!(
                    "{}: vertex {vertex} leaves the numbers of {} on its way to {:?}; give the format more exponent bits",
                    object.name,
                    self.format,
                    vertices[vertex as usize]
                );
            }
        }
        Ok(())
    }
}

/// Positions, scaled and rounded once, with −0 replaced by +0.
fn rounded(arithmetic: &Arithmetic, positions: &[[f64; 3]], log2_scale: i32) -> Vec<[f64; 3]> {
    let scale = power_of_two(log2_scale);
    let number = |x: f64| arithmetic.round(x * scale) + 0.0;
    positions.iter().map(|p| p.map(number)).collect()
}

/// A matrix between two spaces; the source space is scaled by 2^`from`, the target space by 2^`to`.
fn rescaled(matrix: &Matrix3x4, from: i32, to: i32) -> Matrix3x4 {
    let scale = power_of_two(to);
    // Two steps, because the quotient alone may overflow.
    let linear = |x: f64| x * scale / power_of_two(from);
    matrix.map(|[x, y, z, w]| [linear(x), linear(y), linear(z), w * scale])
}

#[cfg(test)]
mod tests {
    use super::super::{IDENTITY, skin_f64, transform_point};
    use super::*;
    use crate::golden::skinning::skin_vertices;
    use crate::scene::load_animated;

    #[test]
    fn water_stands_in_one_level_and_fills_the_range() {
        let scene = load_animated("builtin:water?resolution=8").unwrap();
        let clip = scene.clip(None).unwrap();
        let times = scene.clips[0].frame_times(3);
        let extents = scene.extents(clip, &times).unwrap();
        let machine = MachineScene::new(&scene, &extents, Format::FP24, 256).unwrap();
        let frames: Vec<_> = times
            .iter()
            .map(|&t| machine.frame(&scene.pose(clip, t).unwrap()).unwrap())
            .collect();
        assert!(machine.is_one_level(&frames));
        assert_eq!(machine.objects[0].log2_scale, machine.log2_scale);
        let written = frames.iter().flat_map(|f| f.objects[0].written.as_ref());
        let greatest = written
            .flatten()
            .flatten()
            .fold(0f64, |g, x| g.max(x.abs()));
        assert!(greatest > 128.0 && greatest <= 256.0, "{greatest}");
    }

    #[test]
    fn skinning_in_machine_numbers_is_skinning_scaled() {
        let scene = load_animated("builtin:figure?detail=36").unwrap();
        let clip = scene.clip(Some("walk")).unwrap();
        let times = scene.clips[clip.unwrap()].frame_times(4);
        let extents = scene.extents(clip, &times).unwrap();
        let machine = MachineScene::new(&scene, &extents, Format::FP24, 32).unwrap();
        let pose = scene.pose(clip, times[1]).unwrap();
        let frame = machine.frame(&pose).unwrap();
        let object = &machine.objects[0];
        let influences = object.influences.as_ref().unwrap().concat();
        let arithmetic = Arithmetic::new(machine.format);
        let palette = &frame.objects[0].palette;
        let skinned = skin_vertices(&arithmetic, &object.rest, &influences, palette);
        let skin = scene.objects[0].skin().unwrap();
        let positions = &scene.objects[0].mesh.positions;
        let exact = skin_f64(positions, &skin.influences, &pose.objects[0].palette);
        let scale = power_of_two(machine.log2_scale);
        for (skinned, exact) in skinned.iter().zip(&exact) {
            for (x, y) in skinned.iter().zip(exact) {
                // A few roundings of numbers up to 512.
                assert!((x - y * scale).abs() < 0.05, "{x} {}", y * scale);
            }
        }
        machine.check_vertices(0, &skinned).unwrap();
        assert!(machine.is_one_level(&[frame]));
    }

    #[test]
    fn instances_carry_both_scales() {
        let mut matrix = IDENTITY;
        matrix[0] = [3.0, 0.5, 0.0, 10.0];
        let scaled = rescaled(&matrix, 4, -2);
        let [x, _, _] = transform_point(&scaled, [16.0, 32.0, 0.0]);
        // The point (1, 2, 0) is mapped to x = 3 + 1 + 10.
        assert_eq!(x, 14.0 / 4.0);
    }

    #[test]
    fn too_many_joints_and_too_great_numbers_are_refused() {
        let scene = load_animated("builtin:figure?detail=36").unwrap();
        let extents = scene.extents(None, &[0.0]).unwrap();
        let fault = MachineScene::new(&scene, &extents, Format::FP24, 16).unwrap_err();
        assert_eq!(
            fault.to_string(),
            "scene figure: figure has 21 joints, but the machine's palette holds 16; raise skinning.joints, or bind the object to fewer"
        );
        let machine = MachineScene::new(&scene, &extents, Format::FP24, 32).unwrap();
        let mut pose = scene.pose(None, 0.0).unwrap();
        pose.objects[0].palette[3][1][1] = 1e30;
        let fault = machine.frame(&pose).unwrap_err().to_string();
        assert!(
            fault.starts_with("figure: the matrix of joint 3 has a number that "),
            "{fault}"
        );
        let object = &machine.objects[0];
        let mut vertices = object.rest.clone();
        vertices[object.triangles[0][0] as usize][2] = f64::INFINITY;
        assert!(machine.check_vertices(0, &vertices).is_err());
    }
}
