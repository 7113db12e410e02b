//! The workload of a single unit: the rays of a scene, or random tiny scenes with many ties.

use crate::bkd::layout::Record;
use crate::bkd::{
    BuildOptions, Child, Columns, InstanceRecord, InstanceSpec, InstancedImage, LinkWord,
    MemoryImage, Tree, TreeNode, build,
};
use crate::config::Config;
use crate::float::{Arithmetic, Format};
use crate::golden::{Caster, Instance, Triangle};
use crate::port::Ray;
use anyhow::{Result, ensure};
use std::rc::Rc;

use super::memory::Image;

/// The workload of a unit's co-simulation.
#[derive(Clone, Copy, Debug)]
pub enum Workload<'a> {
    /// Rays into one scene, in packets of the machine's size, in order; inactive rays fill the last packet.
    Rays {
        image: &'a MemoryImage,
        rays: &'a [Ray],
    },
    /// Random tiny scenes with many ties, and rays of every kind, until the given number of transactions is reached.
    Coincidences { transactions: u64 },
    /// The same in scenes of two levels: instances of a few tiny objects, rotated, scaled, mirrored.
    Instances { transactions: u64 },
}

/// Number of packets after which the unit runs empty; environment and scene may then change.
const PACKETS_OF_A_FRAME: usize = 2048;
const PACKETS_OF_A_TINY_SCENE: usize = 160;

/// Number of tiny scenes in a round. The first fills the stack and the second has one triangle, so every run has both.
const SCENES_OF_A_ROUND: usize = 16;

/// The tree of a tiny scene.
#[derive(Clone, Copy)]
pub(super) enum TinyTree {
    Any,
    /// Its depth is that of the stack.
    Deepest,
    /// The root is a leaf.
    Leaf,
}

/// A scene in the unit's memories and in the golden model.
pub(super) struct TestScene {
    pub root: LinkWord,
    pub bounds: ([f64; 3], [f64; 3]),
    pub nodes: Image,
    pub records: Image,
    pub vertices: Image,
    pub caster: Caster,
    /// By record; the element of an instance's record is undefined.
    pub triangles: Vec<Triangle>,
    /// By record; `Some` for instances.
    pub instances: Vec<Option<Instance>>,
    /// By node: the intervals of both children with their axes.
    pub intervals: Vec<[([f64; 2], usize); 2]>,
}

impl TestScene {
    pub fn new(config: &Config, image: &MemoryImage) -> Result<TestScene> {
        let most = 1u64 << config.address_bits;
        for (count, what) in [
            (image.records.len(), "triangles"),
            (image.vertices.len(), "vertices"),
        ] {
            ensure!(
                count as u64 <= most,
                "the scene has {count} {what}, but {} address bits name {most}: choose a configuration with more",
                config.address_bits
            );
        }
        let format = image.format;
        let vertex = |index: u32| image.vertices[index as usize];
        let instances = image.instance_records()?;
        let records = || (0u32..).zip(&image.records);
        Ok(TestScene {
            root: image.root,
            bounds: image.bounds,
            nodes: Image::from_words(image.node_words(), Record::node(format).width)?,
            records: Image::from_words(image.record_words(), Record::triangle().width)?,
            vertices: Image::from_words(image.vertex_words(), Record::vertex(format).width)?,
            caster: Caster::new(image, config.triangle_test, config.rays_per_packet as usize),
            triangles: records()
                .map(|(index, record)| match instances.contains(&index) {
                    true => Triangle::new([[0.0; 3]; 3], record.number),
                    false => Triangle::new(record.vertices.map(vertex), record.number),
                })
                .collect(),
            instances: records()
                .map(|(index, _)| {
                    (instances.contains(&index)).then(|| Instance::fetch(image, index))
                })
                .collect(),
            intervals: image
                .nodes
                .iter()
                .map(|node| {
                    [
                        (node.left, usize::from(node.link.left_axis)),
                        (node.right, usize::from(node.link.right_axis)),
                    ]
                })
                .collect(),
        })
    }
}

/// Packets of rays that are processed together.
pub(super) struct Batch {
    pub scene: Rc<TestScene>,
    /// The packets, each with all of its rays.
    pub packets: Vec<Vec<Ray>>,
    /// Whether the packets belong to a tiny scene and not to a picture.
    pub is_random: bool,
}

/// A workload, batch by batch.
pub(super) struct Batches<'a> {
    config: &'a Config,
    workload: Workload<'a>,
    rng: fastrand::Rng,
    scene: Option<Rc<TestScene>>,
    next_ray: usize,
    /// Number of tiny scenes so far.
    scenes: usize,
}

impl<'a> Batches<'a> {
    pub fn new(config: &'a Config, workload: Workload<'a>, seed: u64) -> Result<Batches<'a>> {
        let scene = match workload {
            Workload::Rays { image, .. } => {
                ensure!(
                    image.format == config.format(),
                    "the scene is in numbers of {}, the machine's are {}",
                    image.format,
                    config.format()
                );
                image.check(config.stack_depth)?;
                Some(Rc::new(TestScene::new(config, image)?))
            }
            Workload::Coincidences { .. } | Workload::Instances { .. } => None,
        };
        Ok(Batches {
            config,
            workload,
            rng: fastrand::Rng::with_seed(seed ^ 0x5ce7e5),
            scene,
            next_ray: 0,
            scenes: 0,
        })
    }

    /// Gives the rays of some packets such long directions that distances are near the least normal number.
    fn hasten(&mut self, batch: &mut Batch) {
        let a = Arithmetic::new(self.config.format());
        let longest = self.config.format().bias() - 1;
        for packet in &mut batch.packets {
            if self.rng.u8(..16) != 0 {
                continue;
            }
            let length = f64::powi(2.0, longest - self.rng.i32(0..4));
            for ray in packet {
                ray.direction = ray.direction.map(|x| a.round(x * length));
                (ray.tmin, ray.tmax) = (0.0, f64::INFINITY);
            }
        }
    }

    /// The next packets, given the number of finished `transactions`; `None` when the work is done.
    pub fn next(&mut self, transactions: u64) -> Result<Option<Batch>> {
        let size = self.config.rays_per_packet as usize;
        match self.workload {
            Workload::Rays { rays, .. } => {
                let rest = &rays[self.next_ray..];
                let taken = rest.len().min(PACKETS_OF_A_FRAME * size);
                self.next_ray += taken;
                let packets = rest[..taken].chunks(size).map(|rays| {
                    let mut packet = rays.to_vec();
                    packet.resize(size, Ray::INACTIVE);
                    packet
                });
                let scene = self.scene.clone().expect("a scene of its own");
                Ok((taken > 0).then(|| Batch {
                    scene,
                    packets: packets.collect(),
                    is_random: false,
                }))
            }
            Workload::Coincidences {
                transactions: enough,
            } => {
                if transactions >= enough {
                    return Ok(None);
                }
                let tree = match self.scenes % SCENES_OF_A_ROUND {
                    0 => TinyTree::Deepest,
                    1 => TinyTree::Leaf,
                    _ => TinyTree::Any,
                };
                self.scenes += 1;
                let mut batch =
                    tiny_scene(self.config, PACKETS_OF_A_TINY_SCENE, tree, &mut self.rng)?;
                self.hasten(&mut batch);
                Ok(Some(batch))
            }
            Workload::Instances {
                transactions: enough,
            } => {
                if transactions >= enough {
                    return Ok(None);
                }
                let size = self.config.rays_per_packet as usize;
                let (image, rays) =
                    instanced_scene(self.config, PACKETS_OF_A_TINY_SCENE * size, &mut self.rng)?;
                Ok(Some(Batch {
                    scene: Rc::new(TestScene::new(self.config, &image)?),
                    packets: rays.chunks(size).map(<[Ray]>::to_vec).collect(),
                    is_random: true,
                }))
            }
        }
    }
}

/// A random tiny scene, and packets of rays into it.
pub(super) fn tiny_scene(
    config: &Config,
    packets: usize,
    tree: TinyTree,
    rng: &mut fastrand::Rng,
) -> Result<Batch> {
    let format = config.format();
    let mesh = TinyMesh::random(config, tree, rng)?;
    let image = MemoryImage::new(format, &mesh.vertices, &mesh.triangles, &mesh.tree)?;
    let size = config.rays_per_packet as usize;
    Ok(Batch {
        scene: Rc::new(TestScene::new(config, &image)?),
        packets: (0..packets)
            .map(|_| match rng.u8(..16) {
                0 => mesh.packet_near_planes(format, size, rng),
                _ => mesh.packet(format, size, rng),
            })
            .collect(),
        is_random: true,
    })
}

/// A random tiny scene of two levels, and rays into it; neighbouring rays are often similar.
///
/// # Errors
/// If the machine's addresses are too short for any scene.
pub fn instanced_scene(
    config: &Config,
    rays: usize,
    rng: &mut fastrand::Rng,
) -> Result<(MemoryImage, Vec<Ray>)> {
    let format = config.format();
    // A machine with short addresses can hold few vertices; if a scene is too large, a smaller one is generated.
    let mut most_objects = 4;
    loop {
        let tiny = TinyInstances::random(config, most_objects, rng)?;
        if tiny.image.vertices.len() as u64 > 1 << config.address_bits && most_objects > 0 {
            most_objects -= 1;
            continue;
        }
        let size = config.rays_per_packet as usize;
        let mut all = vec![];
        while all.len() < rays {
            all.extend(match rng.u8(..16) {
                0 => tiny.packet_near_planes(format, size, rng),
                _ => tiny.packet(format, size, rng),
            });
        }
        all.truncate(rays);
        return Ok((tiny.image, all));
    }
}

/// Number of instances of the scene in [`in_instances`].
const INSTANCES_OF_A_SCENE: usize = 8;

/// A scene of one level as instances of itself: the first is unchanged, the others are rotated, scaled and partly mirrored about its
/// centre, and moved within its extent.
///
/// # Errors
/// If the stack is too small for both levels, or if the format or the machine's addresses are too small for
/// the instances.
pub fn in_instances(config: &Config, scene: &MemoryImage, seed: u64) -> Result<MemoryImage> {
    let mut rng = fastrand::Rng::with_seed(seed ^ 0x1_7a9c);
    let mut image = InstancedImage::new(scene.format);
    let object = image.add_object(scene)?;
    let bounds = image.objects()[object].bounds;
    let centre = [0, 1, 2].map(|i| (bounds.lo[i] + bounds.hi[i]) / 2.0);
    let mut specs = vec![];
    for number in 0..INSTANCES_OF_A_SCENE {
        let columns = if number == 0 {
            IDENTITY
        } else {
            let mut columns = random_turn(&mut rng);
            let [x, y, z, _] = columns;
            for i in 0..3 {
                let turned = x[i] * centre[0] + y[i] * centre[1] + z[i] * centre[2];
                let moved = (rng.f64() - 0.5) * (bounds.hi[i] - bounds.lo[i]);
                columns[3][i] = centre[i] - turned + moved;
            }
            columns
        };
        specs.push(InstanceSpec::new(
            scene.format,
            number,
            object,
            &columns,
            bounds,
        )?);
    }
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    image.set_top(&specs, &options)?;
    Ok(image.image().clone())
}

/// Instances of tiny objects.
struct TinyInstances {
    image: MemoryImage,
    objects: Vec<TinyMesh>,
    /// The object of each instance, and its matrix to the world.
    instances: Vec<(usize, Columns)>,
}

/// The minimum stack depth for an object; every tiny object fits it.
const LEAST_OBJECT_DEPTH: u32 = 6;

impl TinyInstances {
    /// At most `most_objects` objects, but at least one; if it is 0, one object of few triangles.
    fn random(config: &Config, most_objects: usize, rng: &mut fastrand::Rng) -> Result<Self> {
        let format = config.format();
        let object_depth = rng.u32(LEAST_OBJECT_DEPTH..config.stack_depth);
        let top_depth = config.stack_depth - object_depth;
        let of_object = Config {
            stack_depth: object_depth,
            ..config.clone()
        };
        let mut image = InstancedImage::new(format);
        let mut objects: Vec<TinyMesh> = vec![];
        let count = rng.usize(1..=most_objects.max(1));
        while objects.len() < count {
            let mesh = TinyMesh::random(&of_object, TinyTree::Any, rng)?;
            if most_objects == 0 && mesh.vertices.len() > 1 << (config.address_bits - 2) {
                continue;
            }
            let object = MemoryImage::new(format, &mesh.vertices, &mesh.triangles, &mesh.tree)?;
            image.add_object(&object)?;
            objects.push(mesh);
        }
        let most = 12.min(1 << top_depth.min(8));
        let mut instances: Vec<(usize, Columns)> = vec![];
        let mut specs: Vec<InstanceSpec> = vec![];
        for number in 0..rng.usize(1..=most) {
            let object = rng.usize(..objects.len());
            let bounds = image.objects()[object].bounds;
            let mut columns = random_placement(rng);
            if number > 0 && rng.u8(..6) == 0 {
                // At the position of another instance, so every distance occurs twice.
                columns = instances[rng.usize(..number)].1;
            }
            let spec = match InstanceSpec::new(format, number, object, &columns, bounds) {
                Ok(mut spec) => {
                    if columns == IDENTITY && rng.bool() {
                        // Not widened, so flat objects have flat boxes.
                        spec.world_box = bounds;
                    }
                    spec
                }
                // The format is too coarse at this position.
                Err(_) => {
                    columns = IDENTITY;
                    InstanceSpec {
                        object,
                        world_to_object: IDENTITY,
                        world_box: bounds,
                    }
                }
            };
            instances.push((object, columns));
            specs.push(spec);
        }
        if rng.bool() {
            let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
            image.set_top(&specs, &options)?;
        } else {
            let tree = random_tree(rng, specs.len(), config.axes_per_node, top_depth);
            image.set_top_tree(&specs, &tree)?;
        }
        let first = image.instance_vectors(0) as usize;
        let mut image = image.image().clone();
        if rng.u8(..8) == 0 {
            // Scenes do not contain such matrices, but golden model and RTL must agree on them. The box remains
            // valid, but may be infinite.
            for vectors in image.vertices[first..].chunks_mut(InstanceRecord::VECTORS) {
                let (columns, corners) = vectors.split_at_mut(4);
                for x in columns.as_flattened_mut() {
                    if rng.u8(..24) == 0 {
                        *x = odd_number(format, rng);
                    }
                }
                for (corner, end) in corners.iter_mut().zip([-f64::INFINITY, f64::INFINITY]) {
                    if rng.u8(..16) == 0 {
                        corner[rng.usize(..3)] = end;
                    }
                }
            }
        }
        Ok(TinyInstances {
            image,
            objects,
            instances,
        })
    }

    /// Rays near the planes of instances' boxes.
    fn packet_near_planes(&self, format: Format, size: usize, rng: &mut fastrand::Rng) -> Vec<Ray> {
        let first = self.image.vertices.len() - self.instances.len() * InstanceRecord::VECTORS;
        let ray = |_| {
            let instance = rng.usize(..self.instances.len());
            let vectors = &self.image.vertices[first + instance * InstanceRecord::VECTORS..];
            let (lo, hi) = (vectors[4], vectors[5]);
            let target = [0, 1, 2].map(|i| match (lo[i] + hi[i]) / 2.0 {
                centre if centre.is_finite() => centre,
                _ => 0.0,
            });
            ray_near_plane(format, [lo, hi], target, rng)
        };
        (0..size).map(ray).collect()
    }

    /// Rays at one of the instances, generated in its object space.
    fn packet(&self, format: Format, size: usize, rng: &mut fastrand::Rng) -> Vec<Ray> {
        let a = Arithmetic::new(format);
        let (object, columns) = &self.instances[rng.usize(..self.instances.len())];
        let mut rays = self.objects[*object].packet(format, size, rng);
        if *columns != IDENTITY {
            let linear = |v: [f64; 3]| {
                [0, 1, 2].map(|i| (0..3).map(|axis| columns[axis][i] * v[axis]).sum::<f64>())
            };
            for ray in &mut rays {
                let turned = linear(ray.origin);
                ray.origin = [0, 1, 2].map(|i| a.round(turned[i] + columns[3][i]));
                ray.direction = linear(ray.direction).map(|x| a.round(x));
            }
        }
        rays
    }
}

const IDENTITY: Columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];

/// The matrix of an object: the identity; permuted and mirrored axes; or rotated, scaled (uniformly or not) and possibly mirrored.
fn random_placement(rng: &mut fastrand::Rng) -> Columns {
    let kind = rng.u8(..4);
    if kind == 0 {
        return IDENTITY;
    }
    let reach = f64::from(GRID);
    let mut columns = [[0.0; 3]; 4];
    if kind == 1 {
        let mut axes = [0, 1, 2];
        rng.shuffle(&mut axes);
        for (column, axis) in columns.iter_mut().zip(axes) {
            column[axis] = one_of(rng, &[1.0, -1.0, 0.5, -2.0]);
        }
        columns[3] = [0; 3].map(|_| f64::from(rng.i32(-GRID..=GRID)));
        return columns;
    }
    columns = random_turn(rng);
    columns[3] = [0; 3].map(|_| (2.0 * rng.f64() - 1.0) * reach);
    columns
}

/// A matrix that rotates, scales (uniformly or not) and possibly mirrors, about the origin.
fn random_turn(rng: &mut fastrand::Rng) -> Columns {
    // The rotation of a random unit quaternion.
    let q = loop {
        let q = [0; 4].map(|_| 2.0 * rng.f64() - 1.0);
        let length = q.iter().map(|x| x * x).sum::<f64>().sqrt();
        if (0.1..=1.0).contains(&length) {
            break q.map(|x| x / length);
        }
    };
    let turn = glam::DMat3::from_quat(glam::DQuat::from_array(q)).to_cols_array_2d();
    let evenly = rng.bool().then(|| 0.5 + rng.f64());
    let mut columns = [[0.0; 3]; 4];
    for (column, turned) in columns.iter_mut().zip(turn) {
        let scale = evenly.unwrap_or_else(|| 0.25 + 2.0 * rng.f64());
        let mirror = one_of(rng, &[1.0, 1.0, -1.0]);
        *column = turned.map(|x| scale * mirror * x);
    }
    columns
}

/// A scene of few triangles, with a tree.
struct TinyMesh {
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    tree: Tree,
}

/// The maximum coordinate of a tiny scene's grid.
const GRID: i32 = 3;

fn one_of<T: Copy>(rng: &mut fastrand::Rng, choices: &[T]) -> T {
    choices[rng.usize(..choices.len())]
}

impl TinyMesh {
    fn random(config: &Config, tree: TinyTree, rng: &mut fastrand::Rng) -> Result<TinyMesh> {
        let a = Arithmetic::new(config.format());
        let axes = config.axes_per_node;
        let most_depth = config.stack_depth;
        let kind = match tree {
            TinyTree::Deepest => 0,
            TinyTree::Leaf => 1,
            TinyTree::Any => rng.u8(..10),
        };
        if kind == 0 {
            return Ok(TinyMesh::chain(rng, axes, most_depth));
        }
        let count = match kind {
            1 => 1,
            2 => rng.usize(2..=3),
            _ => rng.usize(4..=40),
        };
        // Coordinates on a coarse grid; between its lines; or on one of the grid's planes for each triangle.
        let on_grid = |rng: &mut fastrand::Rng| f64::from(rng.i32(-GRID..=GRID));
        let all_flat = (kind == 3).then(|| (rng.usize(..3), on_grid(rng)));
        let mut vertices: Vec<[f64; 3]> = vec![];
        let mut triangles: Vec<[u32; 3]> = vec![];
        while triangles.len() < count {
            if !triangles.is_empty() && rng.u8(..8) == 0 {
                // A copy of another triangle, possibly starting at another vertex.
                let mut again = triangles[rng.usize(..triangles.len())];
                again.rotate_left(rng.usize(..3));
                triangles.push(again);
                continue;
            }
            let own_flat = (kind == 4 || rng.u8(..6) == 0).then(|| (rng.usize(..3), on_grid(rng)));
            let mut corners = [0u32; 3];
            for i in 0..3 {
                if !vertices.is_empty() && own_flat.is_none() && rng.u8(..4) == 0 {
                    corners[i] = rng.u32(..vertices.len() as u32);
                    continue;
                }
                let mut vertex = match kind {
                    5 | 6 => [0; 3].map(|_| a.round((2.0 * rng.f64() - 1.0) * f64::from(GRID))),
                    _ => [0; 3].map(|_| on_grid(rng)),
                };
                if i > 0 && kind == 7 {
                    // A sliver: the previous vertex, moved on one axis.
                    let axis = rng.usize(..3);
                    let before = vertices[corners[i - 1] as usize];
                    for j in (0..3).filter(|j| *j != axis) {
                        vertex[j] = a.round(before[j] * one_of(rng, &[1.0, 1.0 + 1e-3]));
                    }
                }
                for (axis, at) in own_flat.into_iter().chain(all_flat) {
                    vertex[axis] = at;
                }
                if i > 0 && rng.u8(..24) == 0 {
                    vertex = vertices[corners[i - 1] as usize];
                }
                corners[i] = vertices.len() as u32;
                vertices.push(vertex);
            }
            triangles.push(corners);
        }
        // Scenes do not contain -0, but a record may.
        for x in vertices.iter_mut().flatten() {
            if *x == 0.0 {
                *x = if kind == 8 && rng.bool() { -0.0 } else { 0.0 };
            }
        }
        let options = match rng.u8(..4) {
            0 => Some(BuildOptions::plain(most_depth)),
            1 => Some(BuildOptions::region(most_depth)),
            2 => Some(BuildOptions::default_for(axes, most_depth)),
            _ => None,
        };
        let tree = match options {
            Some(options) => build(&vertices, &triangles, &options)?,
            None => random_tree(rng, triangles.len(), axes, most_depth),
        };
        Ok(TinyMesh {
            vertices,
            triangles,
            tree,
        })
    }

    /// A tree of the depth of the stack. Most rays enter both children of every node, the deep one first.
    fn chain(rng: &mut fastrand::Rng, axes: u32, depth: u32) -> TinyMesh {
        let (low, high) = (-f64::from(GRID), f64::from(GRID));
        let mut vertices = vec![[low; 3], [high; 3]];
        let triangles = (0..=depth)
            .map(|_| {
                if vertices.len() < 40 {
                    vertices.push([0; 3].map(|_| f64::from(rng.i32(-GRID..=GRID)) + 0.0));
                }
                [0, 1, rng.u32(2..vertices.len() as u32)]
            })
            .collect();
        let nodes = (0..depth)
            .map(|i| TreeNode {
                children: match i + 1 < depth {
                    true => [Child::Inner(i + 1), Child::Leaf(i)],
                    false => [Child::Leaf(i), Child::Leaf(i + 1)],
                },
                axes: random_axes(rng, axes),
            })
            .collect();
        TinyMesh {
            vertices,
            triangles,
            tree: Tree {
                nodes,
                root: Child::Inner(0),
            },
        }
    }

    /// Unrelated rays, or rays with one origin and almost the same direction.
    fn packet(&self, format: Format, size: usize, rng: &mut fastrand::Rng) -> Vec<Ray> {
        let a = Arithmetic::new(format);
        let together = rng.bool();
        let first = self.ray(&a, rng);
        (0..size)
            .map(|i| {
                if i == 0 || together && rng.u8(..8) == 0 {
                    return first;
                }
                if !together {
                    return self.ray(&a, rng);
                }
                let bend = |x: f64, rng: &mut fastrand::Rng| {
                    if x == 0.0 || x.is_nan() {
                        x
                    } else {
                        a.round(x * (1.0 + 0.2 * (rng.f64() - 0.5)))
                    }
                };
                Ray {
                    direction: first.direction.map(|x| bend(x, rng)),
                    any_hit: rng.u8(..4) == 0,
                    ..first
                }
            })
            .collect()
    }

    /// Rays near the planes of triangles' boxes.
    fn packet_near_planes(&self, format: Format, size: usize, rng: &mut fastrand::Rng) -> Vec<Ray> {
        let ray = |_| {
            let [p, q, r] = self.some_triangle(rng);
            let (u, v) = (0.1 + 0.4 * rng.f64(), 0.1 + 0.4 * rng.f64());
            let target = [0, 1, 2].map(|i| p[i] + u * (q[i] - p[i]) + v * (r[i] - p[i]));
            let lo = [0, 1, 2].map(|i| p[i].min(q[i]).min(r[i]));
            let hi = [0, 1, 2].map(|i| p[i].max(q[i]).max(r[i]));
            ray_near_plane(format, [lo, hi], target, rng)
        };
        (0..size).map(ray).collect()
    }

    fn some_triangle(&self, rng: &mut fastrand::Rng) -> [[f64; 3]; 3] {
        let triangle = self.triangles[rng.usize(..self.triangles.len())];
        triangle.map(|v| self.vertices[v as usize])
    }

    fn ray(&self, a: &Arithmetic, rng: &mut fastrand::Rng) -> Ray {
        let corner = |rng: &mut fastrand::Rng| self.some_triangle(rng)[rng.usize(..3)];
        let target = {
            let [p, q, r] = self.some_triangle(rng);
            let (u, v) = match rng.u8(..4) {
                0 => one_of(rng, &[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]),
                1 => one_of(rng, &[(0.5, 0.0), (0.0, 0.5), (0.5, 0.5)]),
                _ => (0.6 * rng.f64(), 0.4 * rng.f64()),
            };
            [0, 1, 2].map(|i| p[i] + u * (q[i] - p[i]) + v * (r[i] - p[i]))
        };
        let reach = f64::from(2 * GRID);
        let mut origin = match rng.u8(..8) {
            0 => corner(rng),
            1 => target,
            2..=4 => [0; 3].map(|_| f64::from(rng.i32(-2 * GRID..=2 * GRID))),
            _ => [0; 3].map(|_| (2.0 * rng.f64() - 1.0) * reach),
        };
        let mut direction = match rng.u8(..8) {
            0 => {
                let mut direction = [0; 3].map(|_| one_of(rng, &[0.0, -0.0]));
                direction[rng.usize(..3)] = one_of(rng, &[1.0, -1.0, 0.5, -2.0]);
                direction
            }
            1 => [0; 3].map(|_| f64::from(rng.i32(-2..=2))),
            2 => [0; 3].map(|_| 2.0 * rng.f64() - 1.0),
            _ => {
                let length = one_of(rng, &[1.0, 1.0, 0.125, 4.0]);
                [0, 1, 2].map(|i| length * (target[i] - origin[i]))
            }
        };
        if rng.u8(..8) == 0 {
            // Almost in the plane of a flat triangle, where the error of the test exceeds the slack of the box.
            let axis = rng.usize(..3);
            origin[axis] = target[axis] + one_of(rng, &[1.0, -1.0]) / 64.0;
            direction = [0, 1, 2].map(|i| target[i] - origin[i]);
        }
        // Rounding changes −0 to +0, so restore the zeros that were −0.
        let round = |x: f64| if x == 0.0 { x } else { a.round(x) };
        origin = origin.map(round);
        direction = direction.map(round);
        if rng.u8(..8) == 0 {
            // In a plane of some box.
            let axis = rng.usize(..3);
            origin[axis] = corner(rng)[axis];
            direction[axis] = one_of(rng, &[0.0, -0.0]);
        }
        if rng.u8(..16) == 0 {
            let odd = odd_number(a.format(), rng);
            let place = rng.usize(..6);
            if place < 3 {
                origin[place] = odd;
            } else {
                direction[place - 3] = odd;
            }
        }
        let (mut tmin, mut tmax) = (0.0, f64::INFINITY);
        match rng.u8(..8) {
            0 => tmin = 2.0 * rng.f64(),
            1 => tmax = 2.0 * rng.f64(),
            2 => {
                tmin = rng.f64();
                tmax = tmin + rng.f64();
            }
            // The distance of the target.
            3 => (tmin, tmax) = one_of(rng, &[(1.0, 1.0), (1.0, f64::INFINITY), (0.0, 1.0)]),
            4 if rng.u8(..8) == 0 => {
                (tmin, tmax) = (
                    odd_number(a.format(), rng),
                    one_of(rng, &[-0.0, 1.0, f64::INFINITY]),
                );
            }
            _ => {}
        }
        Ray {
            origin,
            direction,
            tmin: round(tmin),
            tmax: round(tmax),
            active: rng.u8(..32) != 0,
            any_hit: rng.u8(..4) == 0,
        }
    }
}

/// A ray parallel to an axis through a target in a box. It is so long and starts so close to a plane of the box that its distance is
/// within a few ulps of the least normal number, of either sign, so steps by ulps cross zero.
fn ray_near_plane(
    format: Format,
    [lo, hi]: [[f64; 3]; 2],
    target: [f64; 3],
    rng: &mut fastrand::Rng,
) -> Ray {
    let a = Arithmetic::new(format);
    let (longest, ulp) = (
        format.bias() - 1,
        f64::powi(2.0, -(format.fraction_bits() as i32)),
    );
    let axis = rng.usize(..3);
    let shorter = rng.i32(0..4);
    let plane = if rng.bool() { lo[axis] } else { hi[axis] };
    let ulps = f64::from(rng.i32(-2..6));
    let offset = one_of(rng, &[1.0, -1.0]) * f64::powi(2.0, -shorter) * (1.0 + ulps * ulp);
    let mut origin = target.map(|x| a.round(x));
    origin[axis] = a.round(plane + offset);
    let mut direction = [0.0; 3];
    direction[axis] = one_of(rng, &[1.0, -1.0]) * f64::powi(2.0, longest - shorter);
    Ray {
        origin,
        direction,
        tmin: 0.0,
        tmax: f64::INFINITY,
        active: true,
        any_hit: rng.u8(..4) == 0,
    }
}

/// A special value: zero, the least normal number, the greatest number, infinity or NaN.
pub(super) fn odd_number(format: Format, rng: &mut fastrand::Rng) -> f64 {
    let least = format.to_f64(format.least_normal());
    let greatest = format.to_f64(format.greatest());
    let magnitude = one_of(
        rng,
        &[0.0, least, greatest, f64::INFINITY, f64::INFINITY, f64::NAN],
    );
    if rng.bool() { -magnitude } else { magnitude }
}

fn random_axes(rng: &mut fastrand::Rng, axes: u32) -> [u8; 2] {
    let left = rng.u8(..3);
    [left, if axes == 2 { rng.u8(..3) } else { left }]
}

/// A random tree of limited depth; neighbouring leaves may be unrelated.
fn random_tree(rng: &mut fastrand::Rng, triangles: usize, axes: u32, most_depth: u32) -> Tree {
    fn grow(
        rng: &mut fastrand::Rng,
        leaves: &[u32],
        axes: u32,
        depth: u32,
        nodes: &mut Vec<TreeNode>,
    ) -> Child {
        if let [leaf] = leaves {
            return Child::Leaf(*leaf);
        }
        // Neither side may have more leaves than the remaining depth allows.
        let most = 1usize << (depth - 1).min(20);
        let least_left = leaves.len().saturating_sub(most).max(1);
        let at = rng.usize(least_left..=(leaves.len() - 1).min(most));
        let (left, right) = leaves.split_at(at);
        let children = [left, right].map(|side| grow(rng, side, axes, depth - 1, nodes));
        nodes.push(TreeNode {
            children,
            axes: random_axes(rng, axes),
        });
        Child::Inner(nodes.len() as u32 - 1)
    }
    let mut order: Vec<u32> = (0..triangles as u32).collect();
    rng.shuffle(&mut order);
    let mut nodes = vec![];
    let root = grow(rng, &order, axes, most_depth, &mut nodes);
    Tree { nodes, root }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The tiny scenes fit every machine, and some fill its stack.
    #[test]
    fn tiny_scenes_fit_their_machine() {
        let seed = fastrand::u64(..);
        println!("seed {seed}");
        let mut rng = fastrand::Rng::with_seed(seed);
        for _ in 0..20 {
            let mut config = Config::reference();
            for key in crate::config::KEYS {
                key.randomise(&mut config, &mut rng);
            }
            let mut deepest = 0;
            for _ in 0..200 {
                let mesh = TinyMesh::random(&config, TinyTree::Any, &mut rng).unwrap();
                let image =
                    MemoryImage::new(config.format(), &mesh.vertices, &mesh.triangles, &mesh.tree)
                        .unwrap();
                image.check(config.stack_depth).unwrap();
                TestScene::new(&config, &image).unwrap();
                deepest = deepest.max(image.depth().unwrap());
            }
            assert_eq!(deepest, config.stack_depth, "{config:?}");
        }
    }
}
