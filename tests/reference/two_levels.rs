//! Traversal of two levels equals brute force for every pair of trees. A scene of instances gives the same hits as the
//! transformed triangles in one level.
//!
//! Seeds are printed; `DYNRT_SEED=N cargo test --test reference two_levels::` repeats them. `DYNRT_FULL=1` casts ten times as many
//! rays.

use crate::support::small::*;
use dynrt::bkd::{
    Bounds, BuildOptions, Columns, InstanceRecord, InstanceSpec, InstancedImage, MemoryImage, Tree,
    WIDENING, build,
};
use dynrt::config::TriangleTest;
use dynrt::float::{Arithmetic, Format};
use dynrt::golden::oracle::{Explanation, Oracle};
use dynrt::golden::{BruteForce, Caster, Instance, brute_force};
use dynrt::port::{Hit, Ray};
use dynrt::scene::{self, Camera, Frame, ImageSize, MachineMesh};
use fastrand::Rng;
use glam::{DAffine3, DMat3, DQuat, DVec3};
use rayon::prelude::*;

/// The placement of an instance.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Placing {
    /// Translated by integers: many shared planes and equal distances between instances.
    Moved,
    /// Permuted and mirrored axes, exactly.
    Mirrored,
    Rotated,
    /// Rotated, scaled by different factors on the axes, possibly mirrored.
    Scaled,
    /// Nearly flat: scaled by a very small factor on one axis.
    Pressed,
    /// The same placement as another instance, of the same object or another.
    Coincident,
    /// An arbitrary matrix and an unrelated box; traversal must still equal brute force.
    Anything,
}

const PLACINGS: [Placing; 7] = [
    Placing::Moved,
    Placing::Mirrored,
    Placing::Rotated,
    Placing::Scaled,
    Placing::Pressed,
    Placing::Coincident,
    Placing::Anything,
];

fn some_rotation(rng: &mut Rng) -> DMat3 {
    let [x, y, z, w] = [0; 4].map(|_| between(rng, -1.0, 1.0));
    DMat3::from_quat(DQuat::from_xyzw(x, y, z, w + 1e-3).normalize())
}

/// A matrix from the object to the world; `None` for [`Placing::Coincident`] and [`Placing::Anything`].
fn some_matrix(placing: Placing, size: f64, rng: &mut Rng) -> Option<DAffine3> {
    let grid = DVec3::from_array([0; 3].map(|_| f64::from(rng.i32(-2..=2))));
    let anywhere = DVec3::from_array([0; 3].map(|_| between(rng, -size, size)));
    Some(match placing {
        Placing::Moved => DAffine3::from_translation(grid),
        Placing::Mirrored => {
            let mut axes = [DVec3::X, DVec3::Y, DVec3::Z].map(|axis| match rng.bool() {
                true => axis,
                false => -axis,
            });
            rng.shuffle(&mut axes);
            DAffine3::from_mat3_translation(DMat3::from_cols(axes[0], axes[1], axes[2]), grid)
        }
        Placing::Rotated => DAffine3::from_mat3_translation(some_rotation(rng), anywhere),
        Placing::Scaled => {
            let scale = [0; 3].map(|_| one_of(rng, &[1.0, -1.0]) * between(rng, -2.0, 2.0).exp2());
            let scale = DMat3::from_diagonal(DVec3::from_array(scale));
            let linear = some_rotation(rng) * scale * some_rotation(rng);
            DAffine3::from_mat3_translation(linear, anywhere)
        }
        Placing::Pressed => {
            let mut scale = [1.0; 3];
            scale[rng.usize(..3)] = between(rng, -14.0, -4.0).exp2();
            let scale = DMat3::from_diagonal(DVec3::from_array(scale));
            DAffine3::from_mat3_translation(some_rotation(rng) * scale, anywhere)
        }
        Placing::Coincident | Placing::Anything => return None,
    })
}

fn box_of(mesh: &Mesh) -> Bounds {
    (mesh.triangles.iter()).fold(Bounds::EMPTY, |all, &triangle| {
        all.union(Bounds::of_triangle(&mesh.vertices, triangle))
    })
}

/// A matrix and a box of random numbers of the format.
fn anything(object: usize, format: Format, size: f64, rng: &mut Rng) -> InstanceSpec {
    let a = Arithmetic::new(format);
    let number = |rng: &mut Rng| match rng.u8(..4) {
        0 => f64::from(rng.i32(-1..=1)),
        _ => a.round(between(rng, -2.0, 2.0)),
    };
    let [p, q] = [0; 2].map(|_| [0; 3].map(|_| a.round(between(rng, -size, size))));
    InstanceSpec {
        object,
        world_to_object: [0; 4].map(|_| [0; 3].map(|_| number(rng))),
        world_box: Bounds {
            lo: [0, 1, 2].map(|i| p[i].min(q[i])),
            hi: [0, 1, 2].map(|i| p[i].max(q[i])),
        },
    }
}

/// A small scene of two levels.
struct Small {
    objects: Vec<Mesh>,
    specs: Vec<InstanceSpec>,
    placings: Vec<Placing>,
    image: MemoryImage,
    /// The approximate triangles in the world, as targets of rays.
    world: Mesh,
}

fn some_scene(kind: Kind, format: Format, rng: &mut Rng) -> Small {
    let size = (f64::from(format.bias()) / 2.0).min(3.0).exp2();
    let mut objects = vec![some_mesh(kind, format, rng)];
    for _ in 0..rng.usize(..3) {
        objects.push(some_mesh(one_of(rng, &KINDS), format, rng));
    }
    let mut image = InstancedImage::new(format);
    for (number, mesh) in objects.iter().enumerate() {
        let tree_kind = rng.usize(..8);
        let object = mesh.image(&some_tree(mesh, tree_kind, rng));
        assert_eq!(image.add_object(&object).expect("a sound object"), number);
        if rng.u8(..4) == 0 {
            image.add_vectors(&[[1.0; 3]; 5]).expect("room");
        }
    }
    let mut specs: Vec<InstanceSpec> = Vec::new();
    let mut placings = Vec::new();
    for number in 0..rng.usize(1..=10) {
        let object = rng.usize(..objects.len());
        let mut placing = one_of(rng, &PLACINGS);
        let spec = match some_matrix(placing, size, rng) {
            Some(matrix) => InstanceSpec::new(
                format,
                number,
                object,
                &matrix.to_cols_array_2d(),
                box_of(&objects[object]),
            )
            .ok(),
            None if placing == Placing::Coincident && !specs.is_empty() => {
                let mut spec = one_of(rng, &specs);
                spec.object = one_of(rng, &[spec.object, object]);
                Some(spec)
            }
            None => None,
        };
        specs.push(spec.unwrap_or_else(|| {
            placing = Placing::Anything;
            anything(object, format, size, rng)
        }));
        placings.push(placing);
    }
    let corners = specs.iter().flat_map(|spec| {
        let to_world = DAffine3::from_cols_array_2d(&spec.world_to_object).inverse();
        let mesh = &objects[spec.object];
        mesh.triangles.iter().map(move |triangle| {
            triangle.map(|v| {
                let v = DVec3::from_array(mesh.vertices[v as usize]);
                let moved = to_world.transform_point3(v);
                (if moved.is_finite() { moved } else { v }).to_array()
            })
        })
    });
    let world = Mesh::rounded(format, &corners.collect::<Vec<_>>());
    let options = match rng.usize(..6) {
        0 => Some(BuildOptions::plain(MOST_DEEP)),
        1 => Some(BuildOptions::region(MOST_DEEP)),
        2 => Some(BuildOptions::default_for(2, MOST_DEEP)),
        _ => None,
    };
    match options {
        Some(options) => {
            // Earlier contents have no effect.
            let before = rng.usize(1..=specs.len());
            let fresh = {
                let mut fresh = image.clone();
                fresh.set_top(&specs, &options).expect("a top level");
                fresh
            };
            (image.set_top(&specs[..before], &options)).expect("a top level");
            image.set_top(&specs, &options).expect("a top level");
            assert_eq!(image, fresh);
        }
        None => {
            let tree = random_tree(specs.len(), rng);
            image.set_top_tree(&specs, &tree).expect("a top level");
        }
    }
    let image = image.image().clone();
    image.check(MOST_DEEP).expect("a sound image");
    Small {
        objects,
        specs,
        placings,
        image,
        world,
    }
}

/// A ray at an instance's triangles, or in a plane of an instance's box.
fn some_world_ray(scene: &Small, rng: &mut Rng) -> Ray {
    let mut ray = some_ray(&scene.world, rng);
    if rng.u8(..8) == 0 {
        let bounds = one_of(rng, &scene.specs).world_box;
        let axis = rng.usize(..3);
        ray.origin[axis] = one_of(rng, &[bounds.lo[axis], bounds.hi[axis]]);
        if rng.bool() {
            ray.direction[axis] = one_of(rng, &[0.0, -0.0]);
        }
    }
    ray
}

/// Counts of the results of rays by kind, to check that no kind is missing.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    rays: u64,
    hits: u64,
    any_hit_hits: u64,
    limited_hits: u64,
    with_zero: u64,
    with_infinity: u64,
    with_nan: u64,
    /// Hits of rays that start inside an instance's box.
    inside_hits: u64,
    /// Hits of instances at the same place as another instance of the same object: the lowest number wins.
    tied_hits: u64,
    /// Hits by the instance's [`Placing`].
    hits_by_placing: [u64; PLACINGS.len()],
    /// Hits of a flat object that is rotated.
    flat_rotated_hits: u64,
    entries: u64,
}

impl Tally {
    fn add(mut self, other: Tally) -> Tally {
        let Tally {
            rays,
            hits,
            any_hit_hits,
            limited_hits,
            with_zero,
            with_infinity,
            with_nan,
            inside_hits,
            tied_hits,
            hits_by_placing,
            flat_rotated_hits,
            entries,
        } = other;
        for (sum, more) in [
            (&mut self.rays, rays),
            (&mut self.hits, hits),
            (&mut self.any_hit_hits, any_hit_hits),
            (&mut self.limited_hits, limited_hits),
            (&mut self.with_zero, with_zero),
            (&mut self.with_infinity, with_infinity),
            (&mut self.with_nan, with_nan),
            (&mut self.inside_hits, inside_hits),
            (&mut self.tied_hits, tied_hits),
            (&mut self.flat_rotated_hits, flat_rotated_hits),
            (&mut self.entries, entries),
        ] {
            *sum += more;
        }
        for (sum, more) in self.hits_by_placing.iter_mut().zip(hits_by_placing) {
            *sum += more;
        }
        self
    }

    fn count(&mut self, scene: &Small, ray: &Ray, hit: &Hit) {
        let numbers = || ray.origin.iter().chain(&ray.direction);
        let inside =
            |b: &Bounds| (0..3).all(|i| b.lo[i] < ray.origin[i] && ray.origin[i] < b.hi[i]);
        self.rays += 1;
        self.with_zero += u64::from(numbers().any(|&x| x == 0.0));
        self.with_infinity += u64::from(numbers().any(|x| x.is_infinite()));
        self.with_nan += u64::from(numbers().any(|x| x.is_nan()));
        if !hit.is_hit() {
            return;
        }
        self.hits += 1;
        self.any_hit_hits += u64::from(ray.any_hit);
        self.limited_hits += u64::from(ray.tmin > 0.0 || ray.tmax < f64::INFINITY);
        self.inside_hits += u64::from(scene.specs.iter().any(|spec| inside(&spec.world_box)));
        if ray.any_hit {
            return;
        }
        let number = hit.instance as usize;
        let spec = &scene.specs[number];
        let placing = scene.placings[number];
        self.tied_hits += u64::from(scene.specs[number + 1..].contains(spec));
        assert!(
            !scene.specs[..number].contains(spec),
            "not the lowest instance"
        );
        let place = PLACINGS.iter().position(|&p| p == placing);
        self.hits_by_placing[place.expect("a placing")] += 1;
        let object = box_of(&scene.objects[spec.object]);
        let flat = (0..3).any(|i| object.lo[i] == object.hi[i]);
        let rotated = matches!(placing, Placing::Rotated | Placing::Scaled);
        self.flat_rotated_hits += u64::from(flat && rotated);
    }
}

/// Casts rays with one scene, triangle test, pair of trees and packet size, and compares them with brute force in all bits.
fn check_batch(kind: Kind, format: Format, test: TriangleTest, rays: usize, seed: u64) -> Tally {
    let rng = &mut Rng::with_seed(seed);
    let scene = some_scene(kind, format, rng);
    let rays_per_packet = one_of(rng, &PACKETS);
    let rays: Vec<Ray> = (0..rays).map(|_| some_world_ray(&scene, rng)).collect();
    let want = BruteForce::new(&scene.image, test).cast(&rays);
    let frame = Caster::new(&scene.image, test, rays_per_packet).cast_packets(&rays);
    let what = || {
        format!(
            "{kind:?} {format} {test:?}, {:?}, {rays_per_packet} rays a packet, batch seed {seed}",
            scene.placings
        )
    };
    check_same(what, format, &rays, &frame.hits, &want);
    // The fast brute force equals the simple one.
    let few = &rays[..4];
    let plain: Vec<Hit> = (few.iter())
        .map(|ray| brute_force(&scene.image, test, ray))
        .collect();
    check_same(what, format, few, &want[..4], &plain);
    assert!(frame.ray_transforms() >= frame.entries());
    let mut tally = Tally {
        entries: frame.entries(),
        ..Tally::default()
    };
    for (ray, hit) in rays.iter().zip(&want) {
        tally.count(&scene, ray, hit);
    }
    tally
}

#[test]
fn nothing_is_lost_and_neither_tree_shows() {
    const RAYS: usize = 400;
    let batches = if full() { 2000 } else { 200 };
    let seed = seed();
    let tiny = [(3, 2), (3, 8), (4, 3), (5, 2), (5, 10)].map(|(e, f)| Format::new(e, f).unwrap());
    let wide = [(8, 23), (10, 23), (7, 12), (6, 17)].map(|(e, f)| Format::new(e, f).unwrap());
    let mut all = Tally::default();
    for (kind_index, kind) in KINDS.into_iter().enumerate() {
        for test in TESTS {
            let tally = (0..batches)
                .into_par_iter()
                .map(|batch| {
                    let seed = seed
                        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
                        .wrapping_add(batch * 64 + kind_index as u64 * 2 + test as u64);
                    let rng = &mut Rng::with_seed(seed);
                    let format = match rng.u8(..8) {
                        0 => one_of(rng, &tiny),
                        1 => one_of(rng, &wide),
                        _ => Format::FP24,
                    };
                    check_batch(kind, format, test, RAYS, rng.u64(..))
                })
                .reduce(Tally::default, Tally::add);
            println!("{kind:?} {test:?}: {tally:?}");
            assert!(tally.hits > tally.rays / 50, "hardly anything is hit");
            all = all.add(tally);
        }
    }
    println!("all: {all:?}");
    assert!(all.rays >= 1_000_000);
    let counts = [
        all.any_hit_hits,
        all.limited_hits,
        all.with_zero,
        all.with_infinity,
        all.with_nan,
        all.inside_hits,
        all.tied_hits,
        all.flat_rotated_hits,
        all.entries,
    ];
    for count in counts.into_iter().chain(all.hits_by_placing) {
        assert!(count > 1000, "a kind of ray or instance is missing");
    }
}

/// A flat object whose triangles can all be hit.
fn sheet() -> Mesh {
    let corner = |x: i32, y: i32| [f64::from(x), f64::from(y), 0.0];
    let squares = (-4..4).flat_map(|x| (-4..4).map(move |y| (x, y)));
    let triangles = squares.flat_map(|(x, y)| {
        let [p, q, r, s] = [
            corner(x, y),
            corner(x + 1, y),
            corner(x + 1, y + 1),
            corner(x, y + 1),
        ];
        [[p, q, r], [p, r, s]]
    });
    Mesh::rounded(Format::FP24, &triangles.collect::<Vec<_>>())
}

/// Flat sheets, rotated. If they are nearly parallel to an axis, their boxes in the world are very thin, and without
/// widening they would lose hits that rounding moves.
#[test]
fn rotated_sheets_are_hit_wherever_they_are_aimed_at() {
    const RAYS: usize = 200;
    let scenes = if full() { 20_000 } else { 2000 };
    let format = Format::FP24;
    let seed = seed();
    let mesh = sheet();
    let object =
        mesh.image(&build(&mesh.vertices, &mesh.triangles, &BuildOptions::plain(64)).unwrap());
    let lost: Vec<[usize; 2]> = (0..scenes as u64)
        .into_par_iter()
        .map(|number| {
            let seed = seed
                .wrapping_mul(0x9e37_79b9_7f4a_7c15)
                .wrapping_add(number);
            let rng = &mut Rng::with_seed(seed);
            let a = Arithmetic::new(format);
            // Rotated about one axis of its plane, so that the box is flat in the world too, or about any axis.
            let turn = match rng.u8(..3) {
                0 => some_rotation(rng),
                1 => DMat3::from_rotation_z(between(rng, -3.0, 3.0)),
                _ => DMat3::from_rotation_x(1e-3 * between(rng, -3.0, 3.0)),
            };
            let exchange = one_of(
                rng,
                &[
                    DMat3::IDENTITY,
                    DMat3::from_cols(DVec3::Y, DVec3::Z, DVec3::X),
                    DMat3::from_cols(DVec3::Z, DVec3::X, DVec3::Y),
                ],
            );
            let place = DVec3::from_array([0; 3].map(|_| between(rng, -200.0, 200.0)));
            let matrix =
                DAffine3::from_mat3_translation(exchange * turn * between(rng, 3.0, 5.0), place);
            let columns: Columns = matrix.to_cols_array_2d();
            let spec = InstanceSpec::new(format, 0, 0, &columns, box_of(&mesh)).expect("in range");
            let narrow = InstanceSpec {
                world_box: Bounds {
                    lo: spec.world_box.lo.map(|x| a.round(x + WIDENING)),
                    hi: spec.world_box.hi.map(|x| a.round(x - WIDENING)),
                },
                ..spec
            };
            let rays: Vec<Ray> = (0..RAYS)
                .map(|_| {
                    let target = DVec3::new(between(rng, -3.9, 3.9), between(rng, -3.9, 3.9), 0.0);
                    let target = matrix.transform_point3(target);
                    let origin = target
                        .to_array()
                        .map(|x| a.round(x + between(rng, -40.0, 40.0)));
                    Ray {
                        origin,
                        direction: [0, 1, 2].map(|i| a.round(target[i] - origin[i])),
                        tmin: 0.0,
                        tmax: f64::INFINITY,
                        active: true,
                        any_hit: false,
                    }
                })
                // Not along the sheet, where single ulps decide.
                .filter(|ray| {
                    let direction = DVec3::from_array(ray.direction).normalize();
                    direction.dot(matrix.matrix3.z_axis.normalize()).abs() > 0.1
                })
                .collect();
            [spec, narrow].map(|spec| {
                let mut image = InstancedImage::new(format);
                image.add_object(&object).expect("a sound object");
                (image.set_top(&[spec], &BuildOptions::plain(64))).expect("a top level");
                let hits = Caster::new(image.image(), TriangleTest::Watertight, 4)
                    .cast_packets(&rays)
                    .hits;
                hits.iter().filter(|hit| !hit.is_hit()).count()
            })
        })
        .collect();
    let [lost, without] = [0, 1].map(|k| lost.iter().map(|lost| lost[k]).sum::<usize>());
    println!("{scenes} sheets, {lost} rays lost; {without} with boxes that are not widened");
    assert_eq!(lost, 0, "rays lost");
    assert!(
        without > 100,
        "the boxes need no widening: the test shows nothing"
    );
}

/// A picture of many instances of three objects equals that of the same triangles in one level, cast in `f64`, except for
/// pixels at edges.
#[test]
fn a_picture_of_instances_is_one_of_their_triangles() {
    let format = Format::FP24;
    let seed = seed();
    let rng = &mut Rng::with_seed(seed);
    let meshes: Vec<MachineMesh> = [
        "builtin:teapot",
        "builtin:knot?segments=64&sides=8",
        "builtin:cornell",
    ]
    .map(|spec| {
        let scene = scene::load(spec).unwrap_or_else(|error| panic!("{error:#}"));
        MachineMesh::new(&scene, format).expect("the scene fits")
    })
    .into();
    let options = BuildOptions::default_for(2, 64);
    let mut image = InstancedImage::new(format);
    for mesh in &meshes {
        let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
        let object = MemoryImage::new(format, &mesh.vertices, &mesh.triangles, &tree).unwrap();
        image.add_object(&object).unwrap();
    }
    let mut specs = Vec::new();
    for number in 0..24 {
        let object = number % meshes.len();
        let scale = [0; 3].map(|_| one_of(rng, &[1.0, -1.0]) * between(rng, 0.2, 0.35));
        let matrix = DAffine3::from_mat3_translation(
            some_rotation(rng) * DMat3::from_diagonal(DVec3::from_array(scale)),
            DVec3::from_array([0; 3].map(|_| between(rng, -120.0, 120.0))),
        );
        let (lo, hi) = meshes[object].bounds();
        let columns = matrix.to_cols_array_2d();
        specs.push(InstanceSpec::new(format, number, object, &columns, Bounds { lo, hi }).unwrap());
    }
    image.set_top(&specs, &options).unwrap();
    image.image().check(64).unwrap();

    // The positions of the vertices by the rounded matrices, without further rounding.
    let mut flat = MachineMesh {
        format,
        log2_scale: 0,
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    let mut first_triangle = Vec::new();
    for spec in &specs {
        let mesh = &meshes[spec.object];
        let to_world = DAffine3::from_cols_array_2d(&spec.world_to_object).inverse();
        let base = flat.vertices.len() as u32;
        first_triangle.push(flat.triangles.len() as u32);
        let moved = |v: &[f64; 3]| to_world.transform_point3(DVec3::from_array(*v)).to_array();
        flat.vertices.extend(mesh.vertices.iter().map(moved));
        (flat.triangles).extend(mesh.triangles.iter().map(|t| t.map(|v| v + base)));
    }
    let camera = Camera::outside(flat.bounds());
    let frame = Frame::new(ImageSize::new(512, 384).expect("a size"), 4).expect("a frame");
    let packets = frame.primary_rays(&camera, &flat).expect("an eye in range");
    let rays: Vec<Ray> = packets.into_iter().flat_map(|packet| packet.rays).collect();
    let oracle = Oracle::new(&flat.vertices, &flat.triangles);
    let exact: Vec<Hit> = rays.par_iter().map(|ray| oracle.cast(ray)).collect();
    for test in TESTS {
        let frame = Caster::new(image.image(), test, 4).cast_packets(&rays);
        let (mut hits, mut explained, mut seen) = (0, 0, vec![0; specs.len()]);
        for ((ray, hit), exact) in rays.iter().zip(&frame.hits).zip(&exact) {
            let mut hit = *hit;
            if hit.is_hit() {
                hits += 1;
                seen[hit.instance as usize] += 1;
                hit.triangle += first_triangle[hit.instance as usize];
            }
            match oracle.explain(format, ray, &hit, exact) {
                Explanation::Agrees => {}
                Explanation::SameDistance { .. } | Explanation::NearEdge { .. } => explained += 1,
                unexplained => panic!(
                    "seed {seed} {test:?}: {ray:?}\n  machine {hit:?}\n  f64     {exact:?}\n  {unexplained:?}"
                ),
            }
        }
        println!(
            "{test:?}: {} pixels, {hits} hits, {explained} explained, {} entries, {} ray transformations, {} steps, {} ray-triangle tests",
            rays.len(),
            frame.entries(),
            frame.ray_transforms(),
            frame.steps(),
            frame.ray_tests()
        );
        assert!(hits > rays.len() / 10, "hardly anything is hit");
        assert!(
            explained * 1000 <= rays.len(),
            "{explained} pixels show another triangle"
        );
        assert!(seen.iter().filter(|&&pixels| pixels > 0).count() > specs.len() / 2);
    }
}

fn two_triangles() -> (Mesh, Tree) {
    let mesh = Mesh::rounded(
        Format::FP24,
        &[
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
            [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]],
        ],
    );
    let tree = build(&mesh.vertices, &mesh.triangles, &BuildOptions::plain(8)).unwrap();
    (mesh, tree)
}

fn moved_by(x: f64, object: usize) -> InstanceSpec {
    let matrix = DAffine3::from_translation(DVec3::new(x, 0.0, 0.0)).to_cols_array_2d();
    let unit = Bounds {
        lo: [0.0; 3],
        hi: [1.0; 3],
    };
    InstanceSpec::new(Format::FP24, 0, object, &matrix, unit).unwrap()
}

#[test]
fn an_image_lies_as_the_layout_says() {
    let (mesh, tree) = two_triangles();
    let object = mesh.image(&tree);
    let mut image = InstancedImage::new(Format::FP24);
    assert!(image.image().check(64).is_err());
    image.add_object(&object).unwrap();
    let palette = image.add_vectors(&[[7.0; 3]; 4]).unwrap();
    image.add_object(&object).unwrap();
    let specs = [moved_by(0.0, 1), moved_by(4.0, 0), moved_by(8.0, 1)];
    image.set_top(&specs, &BuildOptions::plain(8)).unwrap();
    image.image().check(3).unwrap();

    let count = mesh.vertices.len() as u32;
    let [first, second] = [image.objects()[0], image.objects()[1]];
    assert_eq!((first.base, first.vertex_base, palette), (0, 0, count));
    assert_eq!((second.base, second.vertex_base), (2, count + 4));
    assert_eq!((second.root.link, second.root.right_leaf), (2, false));
    assert_eq!(
        (image.top_base(), image.instance_vectors(1)),
        (4, 2 * count + 10)
    );
    let memory = image.image();
    assert_eq!((memory.nodes.len(), memory.records.len()), (7, 7));
    assert_eq!(memory.vertices.len() as u32, 2 * count + 4 + 18);
    assert_eq!(memory.instance_records().unwrap(), 4..7);
    assert_eq!(memory.records_below(second.root).unwrap(), [2, 3]);
    assert_eq!((memory.root.link, memory.root.right_leaf), (5, true));
    assert_eq!(memory.depth().unwrap(), 3);
    assert_eq!(
        memory.bounds,
        (
            [-WIDENING; 3],
            [9.0 + WIDENING, 1.0 + WIDENING, 1.0 + WIDENING]
        )
    );
    let mut numbers = Vec::new();
    for record in 4..7 {
        let instance = Instance::fetch(memory, record);
        let spec = specs[instance.number as usize];
        assert_eq!(instance.columns, spec.world_to_object);
        assert_eq!(instance.bounds, (spec.world_box.lo, spec.world_box.hi));
        assert_eq!(instance.root, image.objects()[spec.object].root.root());
        numbers.push(instance.number);
    }
    numbers.sort_unstable();
    assert_eq!(numbers, [0, 1, 2]);

    // The words are the same, and a new state of an object changes only its own place.
    let words = memory.record_words();
    assert_eq!(MemoryImage::records_of_words(&words), memory.records);
    let before = memory.clone();
    let mut bent = mesh.image(&tree);
    bent.vertices[0][1] = -1.0;
    image.replace_object(1, &bent).unwrap();
    assert_eq!(image.image().vertices[count as usize + 4][1], -1.0);
    image.replace_object(1, &object).unwrap();
    assert_eq!(*image.image(), before);
}

#[test]
fn bad_instances_get_one_clear_line() {
    let unit = Bounds {
        lo: [0.0; 3],
        hi: [1.0; 3],
    };
    let made = |x: [f64; 3], w: f64| {
        let columns = [x, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [w, 0.0, 0.0]];
        let made = InstanceSpec::new(Format::FP24, 5, 0, &columns, unit);
        made.map_err(|error| format!("{error:#}"))
    };
    assert!(made([1.0, 0.0, 0.0], 0.0).is_ok());
    for (x, w, said) in [
        ([0.0; 3], 0.0, "its matrix is singular"),
        ([0.0, 1.0, 1.0], 0.0, "its matrix is singular"),
        ([f64::NAN; 3], 0.0, "not finite"),
        (
            [1e-30, 0.0, 0.0],
            0.0,
            "cannot hold the inverse of its matrix",
        ),
        (
            [1e30, 0.0, 0.0],
            0.0,
            "cannot hold the inverse of its matrix",
        ),
        (
            [1e-3, 0.0, 0.0],
            1e19,
            "; it stands 1e19 times its own size away from the origin: place it nearer",
        ),
        // The scale of the world is small because the instance is far away.
        (
            [1e-30, 0.0, 0.0],
            1e6,
            "; it stands 1e6 times its own size away from the origin: place it nearer",
        ),
    ] {
        let error = made(x, w).unwrap_err();
        assert!(
            error.starts_with("instance 5: ") && error.contains(said),
            "{error}"
        );
        assert!(error.contains(';') && !error.contains('\n'), "{error}");
    }

    let (mesh, tree) = two_triangles();
    let mut image = InstancedImage::new(Format::FP24);
    image.add_object(&mesh.image(&tree)).unwrap();
    let options = BuildOptions::plain(2);
    let said = |image: &mut InstancedImage, specs: &[InstanceSpec]| {
        let before = image.clone();
        let error = format!("{:#}", image.set_top(specs, &options).unwrap_err());
        assert_eq!(*image, before);
        error
    };
    assert_eq!(said(&mut image, &[]), "the scene has no instances");
    let error = said(&mut image, &[moved_by(0.0, 0), moved_by(0.0, 1)]);
    assert!(
        error.starts_with("instance 1 is of object 1, but there are 1"),
        "{error}"
    );
    let odd = InstanceSpec {
        world_to_object: [[0.1; 3]; 4],
        ..moved_by(0.0, 0)
    };
    let error = said(&mut image, &[odd]);
    assert!(
        error.starts_with("instance 0: 1e-1 is not a number of"),
        "{error}"
    );
    let error = said(&mut image, &[moved_by(0.0, 0); 3]);
    assert!(
        error.contains("a top-level tree of depth 2 and their objects one of 1"),
        "{error}"
    );
    image.set_top(&[moved_by(0.0, 0); 2], &options).unwrap();
    image.image().check(2).unwrap();
    let nested = image.clone();
    let error = format!("{:#}", image.add_object(nested.image()).unwrap_err());
    assert!(
        error.starts_with("object 1: it has two levels itself"),
        "{error}"
    );
}

#[test]
fn a_damaged_image_of_two_levels_is_refused() {
    let (mesh, tree) = two_triangles();
    let mut image = InstancedImage::new(Format::FP24);
    image.add_object(&mesh.image(&tree)).unwrap();
    let specs = [moved_by(0.0, 0), moved_by(2.0, 0), moved_by(4.0, 0)];
    image.set_top(&specs, &BuildOptions::plain(8)).unwrap();
    let sound = image.image();
    sound.check(3).unwrap();
    let error = sound.check(2).unwrap_err().to_string();
    assert!(
        error.starts_with("both levels together are 3 nodes deep"),
        "{error}"
    );

    type Damage = fn(&mut InstanceRecord);
    let cases: [(Damage, &str); 7] = [
        (|i| i.vectors += 13, "names vectors"),
        (
            |i| i.number = 3,
            "has the number 3, but there are 3 instances",
        ),
        (
            |i| i.number = (i.number + 1) % 3,
            "two instances have the number",
        ),
        (|i| i.root.right_leaf = true, "levels do not nest"),
        (|i| i.root.link = 99, "a link leads to node 99"),
        (|i| i.root.link = 3, "node 3 is reached twice"),
        (|i| i.root.left_axis = 1, "a field other than 0"),
    ];
    for (damage, said) in cases {
        let mut image = sound.clone();
        let mut instance = InstanceRecord::from(image.records[4]);
        damage(&mut instance);
        image.records[4] = instance.into();
        let error = format!("{:#}", image.check(64).unwrap_err());
        assert!(
            error.contains(said) && error.contains(';'),
            "{said}: {error}"
        );
    }
}
