//! Meshes of glTF files, with joined primitives and shared vertices.

use super::super::{Influences, MOST_INFLUENCES};
use super::accessor::{Buffers, Numbers, groups};
use super::{attribute_sets, target_count};
use crate::scene::Mesh;
use anyhow::{Context, Result, ensure};
use gltf::accessor::Dimensions;
use gltf::mesh::{Mode, Semantic};
use std::collections::{BTreeMap, HashMap};

/// A mesh and the data that moves its vertices.
#[derive(Default)]
pub struct Parts {
    pub mesh: Mesh,
    /// One per vertex; empty without a skin.
    pub influences: Vec<Influences>,
    /// For each morph target, one displacement per vertex.
    pub displacements: Vec<Vec<[f64; 3]>>,
}

/// Joins the triangles of all primitives of a mesh. With `joint_count`, vertices must be bound to that number of joints.
/// Vertices that are equal in all respects are merged, and unused vertices are left out. The accessor `nothing` stands
/// for positions that the file does not contain.
pub fn read(
    buffers: &Buffers,
    mesh: &gltf::Mesh,
    title: &str,
    joint_count: Option<usize>,
    nothing: usize,
    warnings: &mut Vec<String>,
) -> Result<Parts> {
    let mut welder = Welder {
        parts: Parts {
            displacements: vec![Vec::new(); target_count(mesh)],
            ..Parts::default()
        },
        found: HashMap::new(),
    };
    let (mut reduced, mut bound) = (0, 0);
    let mut left_out: BTreeMap<String, Vec<usize>> = BTreeMap::new();
    for primitive in mesh.primitives() {
        let place = format!("primitive {}", primitive.index());
        if !matches!(
            primitive.mode(),
            Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan
        ) {
            let reason = format!("made of {:?}, not of triangles", primitive.mode());
            left_out.entry(reason).or_default().push(primitive.index());
            continue;
        }
        let positions = primitive.get(&Semantic::Positions);
        if positions.is_none_or(|accessor| accessor.index() == nothing) {
            let reason = "without POSITION".to_string();
            left_out.entry(reason).or_default().push(primitive.index());
            continue;
        }
        let source = Source::read(buffers, &primitive, joint_count.is_some())
            .with_context(|| place.clone())?;
        let (triangles, left_over) = source.triangles(&primitive);
        if left_over > 0 {
            warnings.push(format!(
                "{title}, {place}: {left_over} vertices at its end make no triangle and are left out"
            ));
        }
        let mut numbers: Vec<Option<u32>> = vec![None; source.positions.len()];
        for triangle in triangles {
            let mut welded = [0; 3];
            for (corner, index) in std::iter::zip(&mut welded, triangle) {
                let vertex = index as usize;
                *corner = match numbers[vertex] {
                    Some(number) => number,
                    None => {
                        let influences = match joint_count {
                            None => None,
                            Some(count) => {
                                let given = &source.influences[vertex];
                                let (influences, more) = Influences::new(given, count)
                                    .with_context(|| format!("{place}, vertex {vertex}"))?;
                                bound += 1;
                                reduced += usize::from(more);
                                Some(influences)
                            }
                        };
                        let number = welder.vertex(&source, vertex, influences)?;
                        *numbers[vertex].insert(number)
                    }
                };
            }
            welder.parts.mesh.triangles.push(welded);
        }
    }
    for (reason, primitives) in left_out {
        warnings.push(match primitives.as_slice() {
            [one] => format!("{title}, primitive {one}: left out, it is {reason}"),
            several => format!(
                "{title}: {} primitives are left out, they are {reason}; the first is primitive {}",
                several.len(),
                several[0]
            ),
        });
    }
    if reduced > 0 {
        warnings.push(format!(
            "{title}: {reduced} of {bound} vertices follow more than {MOST_INFLUENCES} joints; they keep the {MOST_INFLUENCES} strongest"
        ));
    }
    Ok(welder.parts)
}

/// A primitive as in the file.
struct Source {
    positions: Vec<[f64; 3]>,
    /// Indices into `positions`.
    indices: Vec<u32>,
    /// The joints and weights of each vertex, as given; empty without a skin.
    influences: Vec<Vec<(u32, f64)>>,
    displacements: Vec<Vec<[f64; 3]>>,
}

impl Source {
    fn read(buffers: &Buffers, primitive: &gltf::Primitive, skinned: bool) -> Result<Self> {
        let positions = primitive.get(&Semantic::Positions).expect("validated");
        let positions = buffers
            .read(&positions, Dimensions::Vec3, Numbers::AsStored)
            .context("POSITION")?;
        let positions = groups::<3>(&positions);
        let count = positions.len();
        let indices: Vec<u32> = match primitive.indices() {
            None => (0..u32::try_from(count).context("has more than 2^32 vertices")?).collect(),
            Some(accessor) => {
                let indices = buffers
                    .read(&accessor, Dimensions::Scalar, Numbers::Indices)
                    .context("indices")?;
                for (place, &index) in indices.iter().enumerate() {
                    ensure!(
                        index < count as f64,
                        "indices, accessor {}: element {place} names vertex {index}, which is out of range (there are {count}, counted from 0); correct it",
                        accessor.index()
                    );
                }
                indices.into_iter().map(|index| index as u32).collect()
            }
        };
        let mut displacements = Vec::new();
        for (number, target) in primitive.morph_targets().enumerate() {
            let place = || format!("morph target {number}");
            displacements.push(match target.positions() {
                None => vec![[0.0; 3]; count],
                // Zeros that are never written need no memory.
                Some(accessor)
                    if buffers.is_zero(&accessor)
                        && accessor.count() == count
                        && accessor.dimensions() == Dimensions::Vec3 =>
                {
                    vec![[0.0; 3]; count]
                }
                Some(accessor) => {
                    let moved = buffers
                        .read_for(&accessor, Dimensions::Vec3, Numbers::AsStored, count)
                        .with_context(place)?;
                    groups::<3>(&moved)
                }
            });
        }
        let influences = match skinned {
            false => Vec::new(),
            true => Self::influences(buffers, primitive, count)?,
        };
        Ok(Self {
            positions,
            indices,
            influences,
            displacements,
        })
    }

    fn influences(
        buffers: &Buffers,
        primitive: &gltf::Primitive,
        count: usize,
    ) -> Result<Vec<Vec<(u32, f64)>>> {
        let sets = attribute_sets(primitive);
        ensure!(
            !sets.is_empty(),
            "has a skin but neither JOINTS_0 nor WEIGHTS_0; bind its vertices to joints"
        );
        let mut influences = vec![Vec::new(); count];
        for (set, (joints, weights)) in sets {
            ensure!(
                joints && weights,
                "has JOINTS_{set} or WEIGHTS_{set} without the other; export the file again"
            );
            let attribute = |semantic: Semantic, numbers| {
                let place = semantic.to_string();
                let accessor = primitive.get(&semantic).expect("there is this set");
                let values = buffers.read_for(&accessor, Dimensions::Vec4, numbers, count);
                anyhow::Ok(groups::<4>(&values.context(place)?))
            };
            let joints = attribute(Semantic::Joints(set), Numbers::Indices)?;
            let weights = attribute(Semantic::Weights(set), Numbers::Fractions)?;
            for (vertex, given) in influences.iter_mut().enumerate() {
                let pairs = std::iter::zip(joints[vertex], weights[vertex]);
                given.extend(pairs.map(|(joint, weight)| (joint as u32, weight)));
            }
        }
        Ok(influences)
    }

    /// The triangles, and the number of vertices at the end that form no triangle.
    fn triangles(&self, primitive: &gltf::Primitive) -> (Vec<[u32; 3]>, usize) {
        let indices = &self.indices;
        if primitive.mode() == Mode::Triangles {
            let triangles = indices.chunks_exact(3);
            let left_over = triangles.remainder().len();
            return (triangles.map(|t| [t[0], t[1], t[2]]).collect(), left_over);
        }
        let windows = indices.windows(3);
        let triangles: Vec<[u32; 3]> = match primitive.mode() {
            Mode::TriangleFan => windows
                .map(|window| [window[1], window[2], indices[0]])
                .collect(),
            // Every other triangle of a strip has the opposite orientation. Triangles without area only connect others.
            _ => windows
                .enumerate()
                .map(|(number, window)| match number % 2 {
                    0 => [window[0], window[1], window[2]],
                    _ => [window[0], window[2], window[1]],
                })
                .filter(|[a, b, c]| a != b && b != c && c != a)
                .collect(),
        };
        let left_over = if indices.len() < 3 { indices.len() } else { 0 };
        (triangles, left_over)
    }
}

/// Merges vertices that agree in position and in everything that moves them.
struct Welder {
    parts: Parts,
    found: HashMap<Vec<u64>, u32>,
}

impl Welder {
    fn vertex(
        &mut self,
        source: &Source,
        vertex: usize,
        influences: Option<Influences>,
    ) -> Result<u32> {
        let position = source.positions[vertex];
        let none = [0.0; 3];
        let targets = self.parts.displacements.len();
        let displaced: Vec<[f64; 3]> = (0..targets)
            .map(|target| source.displacements.get(target).map_or(none, |d| d[vertex]))
            .collect();
        let mut key: Vec<u64> = position.iter().map(|x| x.to_bits()).collect();
        key.extend(displaced.iter().flatten().map(|x| x.to_bits()));
        if let Some(influences) = &influences {
            key.extend(influences.joints.iter().map(|&joint| u64::from(joint)));
            key.extend(influences.weights.iter().map(|weight| weight.to_bits()));
        }
        if let Some(&number) = self.found.get(&key) {
            return Ok(number);
        }
        let parts = &mut self.parts;
        let number = u32::try_from(parts.mesh.positions.len());
        let number = number.context("has more than 2^32 vertices")?;
        parts.mesh.positions.push(position);
        parts.influences.extend(influences);
        for (all, one) in std::iter::zip(&mut parts.displacements, displaced) {
            all.push(one);
        }
        self.found.insert(key, number);
        Ok(number)
    }
}
