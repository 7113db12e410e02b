//! Directed scenes: small scenes after the given one in memory, with rays that test rules which a picture may not exercise.

use crate::bkd::layout::{InstanceRecord, LinkWord, MemoryImage, Target, TriangleRecord};
use crate::bkd::{
    Bounds, BuildOptions, Child, InstanceSpec, InstancedImage, Tree, build, build_over_boxes,
};
use crate::config::Config;
use crate::float::{Arithmetic, Format, specials};
use crate::port::Ray;
use anyhow::Result;

/// A scene in the shared arrays.
pub struct DirectedScene {
    pub label: &'static str,
    /// The scene alone, with indices from 0.
    pub image: MemoryImage,
    /// The same slots, vertices and registers with indices into the shared arrays.
    pub placed: MemoryImage,
    /// Index of its first slot in the shared arrays.
    pub first_record: usize,
    pub first_vertex: usize,
    /// Packets, each with the purpose of its rays.
    pub packets: Vec<(&'static str, Vec<Ray>)>,
}

/// A scene alone, with indices from 0.
struct Plan {
    label: &'static str,
    image: MemoryImage,
    packets: Vec<(&'static str, Vec<Ray>)>,
}

/// Minimum number of rays of each kind: for ties, NaNs and special values.
const TIE_RAYS: usize = 96;
const NAN_RAYS: usize = 16;
const SPECIAL_RAYS: usize = 40;
/// Instances of the scene `transforms`.
const SPECIAL_INSTANCES: usize = 24;

/// The directed scenes that fit after `image`: within the machine's addresses, its stack and its number format.
/// They are the same for the same configuration.
pub fn scenes(config: &Config, image: &MemoryImage) -> Vec<DirectedScene> {
    let (mut record, mut vertex) = (image.records.len(), image.vertices.len());
    let most = 1usize << config.address_bits;
    let mut placed = vec![];
    for plan in [ties, instances, transforms] {
        // A format with few bits cannot represent the positions of all scenes.
        let Ok(plan) = plan(config) else {
            continue;
        };
        let fits = record + plan.image.records.len() <= most
            && vertex + plan.image.vertices.len() <= most
            && plan.image.check(config.stack_depth).is_ok();
        if !fits {
            continue;
        }
        let (first_record, first_vertex) = (record, vertex);
        record += plan.image.records.len();
        vertex += plan.image.vertices.len();
        placed.push(DirectedScene {
            label: plan.label,
            placed: moved(&plan.image, first_record, first_vertex),
            image: plan.image,
            first_record,
            first_vertex,
            packets: plan.packets,
        });
    }
    placed
}

/// An image with the indices that it has if its first slot is `record` and its first vertex is `vertex`.
fn moved(image: &MemoryImage, record: usize, vertex: usize) -> MemoryImage {
    let moved_link = |link: LinkWord| LinkWord {
        link: link.link + record as u32,
        ..link
    };
    let instances = image.instance_records().expect("a sound image");
    let mut nodes = image.nodes.clone();
    for index in nodes_of(image) {
        let node = &mut nodes[index as usize];
        node.link = moved_link(node.link);
    }
    let mut records = vec![];
    for (index, old) in (0u32..).zip(&image.records) {
        records.push(match instances.contains(&index) {
            true => {
                let instance = InstanceRecord::from(*old);
                InstanceRecord {
                    vectors: instance.vectors + vertex as u32,
                    root: moved_link(instance.root),
                    ..instance
                }
                .into()
            }
            false => TriangleRecord {
                vertices: old.vertices.map(|index| index + vertex as u32),
                ..*old
            },
        });
    }
    MemoryImage {
        format: image.format,
        nodes,
        records,
        vertices: image.vertices.clone(),
        root: moved_link(image.root),
        bounds: image.bounds,
    }
}

/// The nodes below all roots, without the unused slots between objects.
fn nodes_of(image: &MemoryImage) -> Vec<u32> {
    let instances = image.instance_records().expect("a sound image");
    let mut roots = vec![image.root.root()];
    for record in instances {
        let instance = InstanceRecord::from(image.records[record as usize]);
        roots.push(instance.root.root());
    }
    let mut reached = vec![];
    while let Some(target) = roots.pop() {
        if let Target::Node(index) = target
            && !reached.contains(&index)
        {
            reached.push(index);
            roots.extend(image.nodes[index as usize].link.children(index));
        }
    }
    reached
}

/// A square of side 2 in the plane z = 0 around the origin, divided into `side`² squares of two triangles. Each triangle occurs
/// twice, starting at different corners. The order is random.
fn sheet(side: u32, rng: &mut fastrand::Rng) -> (Vec<[f64; 3]>, Vec<[u32; 3]>) {
    let coordinate = |k: u32| 2.0 * f64::from(k) / f64::from(side) - 1.0;
    let corners = (0..=side).flat_map(|y| (0..=side).map(move |x| (x, y)));
    let vertices = corners.map(|(x, y)| [coordinate(x), coordinate(y), 0.0]);
    let mut triangles = vec![];
    for y in 0..side {
        for x in 0..side {
            let at = |dx: u32, dy: u32| (y + dy) * (side + 1) + x + dx;
            let [a, b, c, d] = [at(0, 0), at(1, 0), at(0, 1), at(1, 1)];
            triangles.extend([[a, b, c], [d, c, b], [b, c, a], [c, b, d]]);
        }
    }
    rng.shuffle(&mut triangles);
    (vertices.collect(), triangles)
}

/// The image of an object of one level, with its leaves in random order, so any of several equal triangles may come first in the
/// tree. The builder alone would sort them by number.
fn object(
    config: &Config,
    vertices: &[[f64; 3]],
    triangles: &[[u32; 3]],
    rng: &mut fastrand::Rng,
) -> Result<MemoryImage> {
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    let order = shuffled(triangles.len(), rng);
    let in_order: Vec<[u32; 3]> = order.iter().map(|&k| triangles[k as usize]).collect();
    let tree = renumbered(build(vertices, &in_order, &options)?, &order);
    MemoryImage::new(config.format(), vertices, triangles, &tree)
}

/// The numbers below `count` in random order.
fn shuffled(count: usize, rng: &mut fastrand::Rng) -> Vec<u32> {
    let mut order: Vec<u32> = (0..count as u32).collect();
    rng.shuffle(&mut order);
    order
}

/// A tree whose leaf k is `order[k]`.
fn renumbered(mut tree: Tree, order: &[u32]) -> Tree {
    let renumber = |child: &mut Child| {
        if let Child::Leaf(number) = child {
            *number = order[*number as usize];
        }
    };
    renumber(&mut tree.root);
    tree.nodes
        .iter_mut()
        .flat_map(|node| &mut node.children)
        .for_each(renumber);
    tree
}

/// A ray through a point of a sheet around `centre`: a corner, an edge or the inside of a triangle.
fn ray_at_sheet(a: &Arithmetic, centre: [f64; 3], rng: &mut fastrand::Rng) -> Ray {
    const DIRECTIONS: [[f64; 3]; 6] = [
        [0.0, 0.0, -1.0],
        [0.0, 0.0, 2.0],
        [0.0, -0.0, -0.5],
        [1.0, 0.0, -1.0],
        [0.5, -1.0, 1.0],
        [-1.0, 1.0, -2.0],
    ];
    let direction = DIRECTIONS[rng.usize(..DIRECTIONS.len())];
    let target = [0, 1, 2].map(|axis| match axis {
        2 => centre[2],
        _ => centre[axis] + f64::from(rng.i32(-4..=4)) / 4.0,
    });
    Ray {
        origin: [0, 1, 2].map(|i| a.round(target[i] - direction[i])),
        direction,
        tmin: 0.0,
        tmax: f64::INFINITY,
        active: true,
        any_hit: false,
    }
}

/// Full packets, at least one, with `count` or more rays in total.
fn packets(
    config: &Config,
    label: &'static str,
    count: usize,
    mut ray: impl FnMut(usize) -> Ray,
) -> Vec<(&'static str, Vec<Ray>)> {
    let rays = config.rays_per_packet as usize;
    let packet = |number: usize| (label, (0..rays).map(|_| ray(number)).collect());
    (0..count.div_ceil(rays)).map(packet).collect()
}

/// A scene of one level with equal triangles and shared edges.
fn ties(config: &Config) -> Result<Plan> {
    let a = Arithmetic::new(config.format());
    let mut rng = fastrand::Rng::with_seed(6);
    let (vertices, triangles) = sheet(2, &mut rng);
    Ok(Plan {
        label: "ties",
        image: object(config, &vertices, &triangles, &mut rng)?,
        packets: packets(config, "ties of triangles", TIE_RAYS, |_| {
            ray_at_sheet(&a, [0.0; 3], &mut rng)
        }),
    })
}

/// Positions of groups of equal instances.
const PLACES: [[f64; 3]; 4] = [
    [-1.5, -1.5, 0.0],
    [1.5, -1.5, 0.5],
    [-1.5, 1.5, -0.5],
    [1.5, 1.5, 0.0],
];

/// Equal instances of objects that number equal triangles differently, and rays that are a NaN in object space.
fn instances(config: &Config) -> Result<Plan> {
    let format = config.format();
    let a = Arithmetic::new(format);
    let mut rng = fastrand::Rng::with_seed(7);
    let mut image = InstancedImage::new(format);
    let (vertices, triangles) = sheet(1, &mut rng);
    // The second object starts with triangles that no ray meets, so the same triangles have higher numbers.
    let mut hidden = vertices.clone();
    let first = hidden.len() as u32;
    hidden.extend([[0.0, 0.0, 0.0], [0.0, 0.0, 0.25], [0.0, 0.0, 0.5]]);
    let slivers = [[first, first + 1, first + 2]; 3];
    let behind: Vec<[u32; 3]> = slivers.into_iter().chain(triangles.clone()).collect();
    let reversed: Vec<[u32; 3]> = triangles.iter().rev().copied().collect();
    for (vertices, triangles) in [
        (&vertices, &triangles),
        (&hidden, &behind),
        (&vertices, &reversed),
    ] {
        image.add_object(&object(config, vertices, triangles, &mut rng)?)?;
    }
    let mut standing: Vec<(usize, [f64; 3])> = (PLACES.into_iter())
        .flat_map(|place| [1, 0, 2, 1].map(|object| (object, place)))
        .collect();
    rng.shuffle(&mut standing);
    let specs = standing
        .iter()
        .enumerate()
        .map(|(number, (object, place))| {
            let matrix = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], *place];
            let bounds = image.objects()[*object].bounds;
            InstanceSpec::new(format, number, *object, &matrix, bounds)
        });
    let specs = specs.collect::<Result<Vec<_>>>()?;
    let deepest = image.objects().iter().map(|object| object.depth).max();
    let depth = config.stack_depth.saturating_sub(deepest.unwrap_or(0));
    let options = BuildOptions::default_for(config.axes_per_node, depth);
    let order = shuffled(specs.len(), &mut rng);
    let boxes: Vec<Bounds> = order.iter().map(|&k| specs[k as usize].world_box).collect();
    let top = renumbered(build_over_boxes(&boxes, &options)?, &order);
    image.set_top_tree(&specs, &top)?;
    let mut all = packets(config, "ties of instances", TIE_RAYS, |_| {
        let place = PLACES[rng.usize(..PLACES.len())];
        ray_at_sheet(&a, place, &mut rng)
    });
    // Infinite on one axis, on which the ray is not clipped; on the other axes it meets a group of instances.
    all.extend(packets(config, "NaN in an object", NAN_RAYS, |number| {
        let place = PLACES[number % PLACES.len()];
        let axis = number / PLACES.len() % 2;
        let mut ray = ray_at_sheet(&a, place, &mut rng);
        let endless = [f64::INFINITY, f64::NEG_INFINITY][rng.usize(..2)];
        ray.origin[axis] = endless;
        ray.direction[axis] = endless;
        ray
    }));
    Ok(Plan {
        label: "instances",
        image: image.image().clone(),
        packets: all,
    })
}

/// Instances at the origin with special numbers in their matrices, and rays through it with such components.
fn transforms(config: &Config) -> Result<Plan> {
    let format = config.format();
    let a = Arithmetic::new(format);
    let mut rng = fastrand::Rng::with_seed(8);
    let mut image = InstancedImage::new(format);
    let (vertices, triangles) = sheet(1, &mut rng);
    image.add_object(&object(config, &vertices, &triangles[..2], &mut rng)?)?;
    let mut coordinate = || f64::from(rng.i32(1..=8)) / 4.0;
    let boxes: Vec<Bounds> = (0..SPECIAL_INSTANCES)
        .map(|_| Bounds {
            lo: [0; 3].map(|_| -coordinate()),
            hi: [0; 3].map(|_| coordinate()),
        })
        .collect();
    let specs: Vec<InstanceSpec> = (boxes.into_iter())
        .map(|world_box| InstanceSpec {
            object: 0,
            world_to_object: [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]],
            world_box,
        })
        .collect();
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    image.set_top(&specs, &options)?;
    let first = image.instance_vectors(0) as usize;
    let mut image = image.image().clone();
    let mut special = Specials::new(format, &mut rng);
    for matrix in image.vertices[first..].chunks_exact_mut(InstanceRecord::VECTORS) {
        for component in matrix[..4].as_flattened_mut() {
            if special.rng.u8(..3) == 0 {
                // Memory never contains −0.
                *component = special.number() + 0.0;
            }
        }
    }
    let packets = packets(config, "special transformations", SPECIAL_RAYS, |_| {
        let mut ray = Ray {
            tmax: [4.0, f64::INFINITY][special.rng.usize(..2)],
            ..ray_at_sheet(&a, [0.0; 3], special.rng)
        };
        for component in ray.origin.iter_mut().chain(&mut ray.direction) {
            if special.rng.u8(..6) == 0 {
                *component = special.valid_number();
            }
        }
        ray
    });
    Ok(Plan {
        label: "transforms",
        image,
        packets,
    })
}

/// Special numbers: half of them are at the ends of the range or not finite.
struct Specials<'r> {
    all: Vec<f64>,
    ends: Vec<f64>,
    rng: &'r mut fastrand::Rng,
}

impl<'r> Specials<'r> {
    fn new(format: Format, rng: &'r mut fastrand::Rng) -> Self {
        let number = |bits: u64| format.to_f64(bits);
        let ends = [
            0,
            format.sign_bit(),
            format.least_normal(),
            format.greatest(),
            format.infinity(),
            format.infinity() | format.sign_bit(),
            format.nan(),
        ];
        Specials {
            all: specials(format).into_iter().map(number).collect(),
            ends: ends.map(number).to_vec(),
            rng,
        }
    }

    fn number(&mut self) -> f64 {
        let list = match self.rng.bool() {
            true => &self.all,
            false => &self.ends,
        };
        list[self.rng.usize(..list.len())]
    }

    /// A special number that is not a NaN.
    fn valid_number(&mut self) -> f64 {
        loop {
            let number = self.number();
            if !number.is_nan() {
                return number;
            }
        }
    }
}
