//! Traversal equals brute force for every tree; with the watertight test, no ray passes through an edge.
//!
//! Seeds are printed; `DYNRT_SEED=N cargo test --test reference laws::` repeats them. `DYNRT_FULL=1` casts 100,000 rays into each
//! public scene by brute force instead of 4,000, and ten times as many rays into all others.

use crate::support::shared_scene;
use crate::support::small::*;
use dynrt::config::TriangleTest;
use dynrt::float::{Arithmetic, Format};
use dynrt::golden::oracle::Oracle;
use dynrt::golden::{BruteForce, Caster, brute_force};
use dynrt::port::{Hit, Ray};
use dynrt::scene::{self, Camera, ImageSize, MachineMesh};
use fastrand::Rng;
use rayon::prelude::*;

/// Number of rays by brute force per scene of tens of thousands of triangles, without `DYNRT_FULL`.
const QUICK_RAYS: usize = 4_000;
const FULL_RAYS: usize = 100_000;

/// Counts of the rays by kind, to check that no kind is missing.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    rays: u64,
    hits: u64,
    any_hit: u64,
    any_hit_hits: u64,
    with_zero: u64,
    with_minus_zero: u64,
    with_infinity: u64,
    with_nan: u64,
    in_plane: u64,
    limited: u64,
    limited_hits: u64,
    inactive: u64,
}

impl Tally {
    fn add(&mut self, other: &Tally) {
        let pairs = self.fields().into_iter().zip({
            let mut other = *other;
            other.fields().map(|field| *field)
        });
        for (field, more) in pairs {
            *field += more;
        }
    }

    fn fields(&mut self) -> [&mut u64; 12] {
        [
            &mut self.rays,
            &mut self.hits,
            &mut self.any_hit,
            &mut self.any_hit_hits,
            &mut self.with_zero,
            &mut self.with_minus_zero,
            &mut self.with_infinity,
            &mut self.with_nan,
            &mut self.in_plane,
            &mut self.limited,
            &mut self.limited_hits,
            &mut self.inactive,
        ]
    }

    fn count(&mut self, mesh: &Mesh, ray: &Ray, hit: &Hit) {
        let numbers = || ray.origin.iter().chain(&ray.direction);
        let is_minus_zero = |x: f64| x == 0.0 && x.is_sign_negative();
        let in_plane = (0..3).any(|i| {
            ray.direction[i] == 0.0 && mesh.vertices.iter().any(|v| v[i] == ray.origin[i])
        });
        let limited = ray.tmin > 0.0 || ray.tmax < f64::INFINITY;
        self.rays += 1;
        self.hits += u64::from(hit.is_hit());
        self.any_hit += u64::from(ray.any_hit);
        self.any_hit_hits += u64::from(ray.any_hit && hit.is_hit());
        self.with_zero += u64::from(numbers().any(|&x| x == 0.0));
        self.with_minus_zero += u64::from(numbers().any(|&x| is_minus_zero(x)));
        self.with_infinity += u64::from(numbers().any(|x| x.is_infinite()));
        self.with_nan += u64::from(numbers().chain([&ray.tmin, &ray.tmax]).any(|x| x.is_nan()));
        self.in_plane += u64::from(in_plane);
        self.limited += u64::from(limited);
        self.limited_hits += u64::from(limited && hit.is_hit());
        self.inactive += u64::from(!ray.active);
    }
}

/// Casts `rays` rays with one scene, triangle test, tree and packet size, and compares them with brute force in all bits.
fn check_batch(kind: Kind, format: Format, test: TriangleTest, rays: usize, seed: u64) -> Tally {
    let rng = &mut Rng::with_seed(seed);
    let mesh = some_mesh(kind, format, rng);
    let tree_kind = rng.usize(..8);
    let tree = some_tree(&mesh, tree_kind, rng);
    let image = mesh.image(&tree);
    let rays_per_packet = one_of(rng, &PACKETS);
    let caster = Caster::new(&image, test, rays_per_packet);
    let brute = BruteForce::new(&image, test);
    let rays: Vec<Ray> = (0..rays).map(|_| some_ray(&mesh, rng)).collect();
    let want = brute.cast(&rays);
    let got = caster.cast_packets(&rays).hits;
    let what = || {
        format!(
            "{kind:?} {format} {test:?}, {} triangles, tree {tree_kind}, {rays_per_packet} rays a packet, batch seed {seed}",
            mesh.triangles.len()
        )
    };
    check_same(what, format, &rays, &got, &want);
    // The fast brute force equals the simple one.
    let few = &rays[..8];
    let plain: Vec<Hit> = few
        .iter()
        .map(|ray| brute_force(&image, test, ray))
        .collect();
    check_same(what, format, few, &want[..8], &plain);
    let mut tally = Tally::default();
    for (ray, hit) in rays.iter().zip(&want) {
        tally.count(&mesh, ray, hit);
    }
    tally
}

#[test]
fn nothing_is_lost_and_the_tree_does_not_show() {
    const RAYS: usize = 1000;
    let batches = if full() { 6400 } else { 640 };
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
                        0 | 1 => one_of(rng, &tiny),
                        2 => one_of(rng, &wide),
                        _ => Format::FP24,
                    };
                    check_batch(kind, format, test, RAYS, rng.u64(..))
                })
                .reduce(Tally::default, |mut sum, tally| {
                    sum.add(&tally);
                    sum
                });
            println!("{kind:?} {test:?}: {tally:?}");
            assert!(tally.hits > tally.rays / 50, "hardly anything is hit");
            all.add(&tally);
        }
    }
    println!("all: {all:?}");
    assert!(all.rays >= 10_000_000);
    for count in all.fields() {
        assert!(*count > 1000, "a kind of ray is missing");
    }
}

/// A scene of realistic size, and its rays.
struct View {
    name: String,
    mesh: Mesh,
    camera: Camera,
    machine: MachineMesh,
}

impl View {
    fn new(spec: &str, inside: bool) -> View {
        let scene = scene::load(spec).unwrap_or_else(|error| panic!("{error:#}"));
        let machine = MachineMesh::new(&scene, Format::FP24).expect("the scene fits");
        let camera = if inside {
            Camera::inside(scene.bounds())
        } else {
            Camera::outside(scene.bounds())
        };
        View {
            name: scene.name,
            mesh: Mesh {
                format: machine.format,
                vertices: machine.vertices.clone(),
                triangles: machine.triangles.clone(),
            },
            camera,
            machine,
        }
    }

    /// About `count` rays through a picture's pixels. Every third ray instead goes from a random point of the scene's box to a
    /// point of a triangle; some are limited or any-hit rays.
    fn rays(&self, count: usize, rng: &mut Rng) -> Vec<Ray> {
        let height = (count as f64 * 0.75).sqrt().ceil() as u32;
        let size = ImageSize::new(height * 4 / 3, height).expect("a size");
        let frame = scene::Frame::new(size, 4).expect("four rays a packet");
        let packets = frame
            .primary_rays(&self.camera, &self.machine)
            .expect("an eye in range");
        let mut rays: Vec<Ray> = packets.into_iter().flat_map(|packet| packet.rays).collect();
        let a = Arithmetic::new(self.mesh.format);
        let (lo, hi) = self.machine.bounds();
        for packet in rays.chunks_mut(4).skip(2).step_by(3) {
            let origin = [0, 1, 2].map(|i| a.round(between(rng, lo[i], hi[i])));
            let triangle = self.mesh.triangles[rng.usize(..self.mesh.triangles.len())];
            for (ray, vertex) in packet.iter_mut().zip(triangle.iter().cycle()) {
                let target = self.mesh.vertices[*vertex as usize];
                *ray = Ray {
                    origin,
                    direction: [0, 1, 2].map(|i| a.round(target[i] - origin[i])),
                    tmin: one_of(rng, &[0.0, 0.0, 0.25]),
                    tmax: one_of(rng, &[f64::INFINITY, 1.0, 0.75]),
                    active: true,
                    any_hit: rng.u8(..4) == 0,
                };
            }
        }
        rays
    }
}

#[test]
fn real_scenes_obey_the_law_too() {
    let seed = seed();
    let mut views = vec![
        (View::new("builtin:interior", true), QUICK_RAYS),
        (View::new("builtin:teapot", false), QUICK_RAYS),
    ];
    let shared_count = if full() { FULL_RAYS } else { QUICK_RAYS };
    for (path, inside) in [
        ("sponza/sponza.obj", true),
        ("kitchen/kitchen.obj", true),
        ("stanford_bunny/stanford-bunny.obj", false),
    ] {
        views.extend(shared_scene(path).map(|path| (View::new(&path, inside), shared_count)));
    }
    for (view, count) in views {
        let rng = &mut Rng::with_seed(seed);
        let format = view.mesh.format;
        let rays = view.rays(count, rng);
        assert!(rays.len() >= count);
        let trees =
            [0, 1, 3].map(|kind| (kind, view.mesh.image(&some_tree(&view.mesh, kind, rng))));
        let mut hits = 0;
        for test in TESTS {
            let want = BruteForce::new(&trees[0].1, test).cast(&rays);
            hits += want.iter().filter(|hit| hit.is_hit()).count();
            for (kind, image) in &trees {
                for size in PACKETS {
                    let got = Caster::new(image, test, size).cast_packets(&rays).hits;
                    let what =
                        || format!("{} {test:?}, tree {kind}, {size} rays a packet", view.name);
                    check_same(what, format, &rays, &got, &want);
                }
            }
        }
        let tested = TESTS.len() * rays.len();
        println!(
            "{}: {tested} rays by brute force, {hits} hits, each with 3 trees and 4 packet sizes",
            view.name
        );
        assert!(hits > tested / 4, "{}: hardly anything is hit", view.name);
    }
}

/// A closed mesh and points inside.
struct Room {
    name: &'static str,
    mesh: Mesh,
    origins: Vec<[f64; 3]>,
}

/// A built-in closed mesh in the machine's number format. The points are halfway from the middle of some triangles, inwards along
/// the normal, to the next triangle.
fn built_in_room(name: &'static str, rng: &mut Rng) -> Room {
    let mesh = View::new(name, true).mesh;
    let a = Arithmetic::new(mesh.format);
    let oracle = Oracle::new(&mesh.vertices, &mesh.triangles);
    let mut origins = Vec::new();
    while origins.len() < 64 {
        let triangle = mesh.triangles[rng.usize(..mesh.triangles.len())];
        let [p, q, r] = triangle.map(|v| glam::DVec3::from_array(mesh.vertices[v as usize]));
        let inwards = (r - p).cross(q - p).normalize();
        let start = (p + q + r) / 3.0 + 1e-3 * inwards;
        let hit = oracle.cast(&plain_ray(start.to_array(), inwards.to_array()));
        assert!(hit.is_hit(), "{name} is not closed, or inside out");
        origins.push(
            (start + 0.5 * hit.t * inwards)
                .to_array()
                .map(|x| a.round(x)),
        );
    }
    Room {
        name,
        mesh,
        origins,
    }
}

fn plain_ray(origin: [f64; 3], direction: [f64; 3]) -> Ray {
    Ray {
        origin,
        direction,
        tmin: 0.0,
        tmax: f64::INFINITY,
        active: true,
        any_hit: false,
    }
}

/// The surface of a cube with `n` × `n` squares per side, each divided along a diagonal, with its lattice points moved by `place`.
fn cube(name: &'static str, n: i32, place: impl Fn([i32; 3]) -> [f64; 3]) -> Room {
    let mut numbers = std::collections::BTreeMap::new();
    let mut vertices = Vec::new();
    let a = Arithmetic::new(Format::FP24);
    let mut vertex = |corner: [i32; 3]| {
        *numbers.entry(corner).or_insert_with(|| {
            vertices.push(place(corner).map(|x| a.round(x)));
            vertices.len() as u32 - 1
        })
    };
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [0, n] {
            for (x, y) in (0..n).flat_map(|x| (0..n).map(move |y| (x, y))) {
                let mut at = |x, y| {
                    let mut corner = [side; 3];
                    (corner[(axis + 1) % 3], corner[(axis + 2) % 3]) = (x, y);
                    vertex(corner)
                };
                let [p, q, r, s] = [at(x, y), at(x + 1, y), at(x + 1, y + 1), at(x, y + 1)];
                triangles.extend([[p, q, r], [p, r, s]]);
            }
        }
    }
    Room {
        name,
        mesh: Mesh {
            format: Format::FP24,
            vertices,
            triangles,
        },
        origins: Vec::new(),
    }
}

#[test]
fn the_watertight_test_lets_no_ray_out_of_a_closed_mesh() {
    const BATCH: usize = 4000;
    let rays_each: usize = if full() { 20_000_000 } else { 2_000_000 };
    let seed = seed();
    let rng = &mut Rng::with_seed(seed);
    let mut rooms = vec![
        built_in_room("builtin:sphere?level=3", rng),
        built_in_room("builtin:sphere?level=0", rng),
        built_in_room("builtin:knot?segments=64&sides=8", rng),
    ];

    // Walls in axis planes, edges along axes, and rays from lattice points.
    let mut cubic = cube("cube", 4, |corner| corner.map(|x| f64::from(x) - 2.0));
    cubic.origins = (0..64)
        .map(|k| match k % 2 {
            0 => [0; 3].map(|_| f64::from(rng.i32(-3..=3)) / 2.0),
            _ => [0; 3].map(|_| Arithmetic::new(Format::FP24).round(between(rng, -1.9, 1.9))),
        })
        .collect();
    rooms.push(cubic);

    // Spikes of random length seen from a distant centre: long, thin triangles at grazing angles.
    let lengths: Vec<f64> = (0..1000).map(|_| between(rng, 0.0, 3.0).exp2()).collect();
    let mut star = cube("star", 6, |corner| {
        let index = corner.iter().fold(0, |index, &x| 7 * index + x as usize);
        let direction = glam::DVec3::from_array(corner.map(|x| f64::from(x) - 3.0));
        (direction.normalize() * lengths[index] * 8.0 + glam::DVec3::new(100.0, -3.0, 0.3))
            .to_array()
    });
    star.origins = (0..64)
        .map(|_| {
            let offset = [0; 3].map(|_| between(rng, -0.5, 0.5));
            let middle = [100.0, -3.0, 0.3];
            [0, 1, 2].map(|i| Arithmetic::new(Format::FP24).round(middle[i] + offset[i]))
        })
        .collect();
    rooms.push(star);

    let mut all = 0;
    let mut lost = 0;
    for room in &rooms {
        let tree = some_tree(&room.mesh, 3, rng);
        let caster = Caster::new(&room.mesh.image(&tree), TriangleTest::Watertight, 4);
        let batches: Vec<u64> = (0..rays_each / BATCH).map(|_| rng.u64(..)).collect();
        let escaped: Vec<Ray> = batches
            .par_iter()
            .flat_map_iter(|&seed| {
                let rng = &mut Rng::with_seed(seed);
                let rays: Vec<Ray> = (0..BATCH).map(|_| aimed_ray(room, rng)).collect();
                let hits = caster.cast_packets(&rays).hits;
                let out = rays.into_iter().zip(hits).filter(|(_, hit)| !hit.is_hit());
                out.map(|(ray, _)| ray).collect::<Vec<_>>()
            })
            .collect();
        println!(
            "{}: {} triangles, {rays_each} rays, {} escaped",
            room.name,
            room.mesh.triangles.len(),
            escaped.len()
        );
        for ray in escaped.iter().take(3) {
            println!("    {ray:?}");
        }
        all += rays_each;
        lost += escaped.len();
    }
    assert!(all >= 10_000_000);
    assert_eq!(lost, 0, "rays escaped");
}

/// At the intersection of three planes of an axis-aligned box, the boxes of triangles end as well. There the slack of
/// three ulps in the clipping matters most.
#[test]
fn the_watertight_test_lets_no_ray_out_of_a_box() {
    const RAYS: usize = 1000;
    let boxes: u64 = if full() { 20_000 } else { 2000 };
    let seed = seed();
    let escaped: Vec<(u64, Ray)> = (0..boxes)
        .into_par_iter()
        .flat_map_iter(|number| {
            let seed = seed
                .wrapping_mul(0x9e37_79b9_7f4a_7c15)
                .wrapping_add(number);
            let rng = &mut Rng::with_seed(seed);
            let a = Arithmetic::new(Format::FP24);
            let lo = [0; 3].map(|_| between(rng, -64.0, 32.0));
            let size = [0; 3].map(|_| between(rng, -4.0, 5.0).exp2());
            let mut room = cube("box", 1, |corner| {
                [0, 1, 2].map(|i| lo[i] + f64::from(corner[i]) * size[i])
            });
            let inside = |rng: &mut Rng| {
                [0, 1, 2].map(|i| a.round(lo[i] + size[i] * between(rng, 0.05, 0.95)))
            };
            room.origins = (0..16).map(|_| inside(rng)).collect();
            let tree = some_tree(&room.mesh, 3, rng);
            let caster = Caster::new(&room.mesh.image(&tree), TriangleTest::Watertight, 4);
            let rays: Vec<Ray> = (0..RAYS).map(|_| aimed_ray(&room, rng)).collect();
            let hits = caster.cast_packets(&rays).hits;
            let out = rays.into_iter().zip(hits).filter(|(_, hit)| !hit.is_hit());
            out.map(|(ray, _)| (seed, ray)).collect::<Vec<_>>()
        })
        .collect();
    println!(
        "{boxes} boxes, {} rays, {} escaped",
        boxes * RAYS as u64,
        escaped.len()
    );
    for (seed, ray) in escaped.iter().take(3) {
        println!("    box seed {seed}: {ray:?}");
    }
    assert!(escaped.is_empty(), "rays escaped");
}

/// A ray from inside a room: three of four at a vertex or a point of an edge, or slightly beside one.
fn aimed_ray(room: &Room, rng: &mut Rng) -> Ray {
    let a = Arithmetic::new(room.mesh.format);
    let origin = one_of(rng, &room.origins);
    if rng.u8(..4) == 0 {
        let direction = [0; 3].map(|_| a.round(between(rng, -1.0, 1.0)));
        return plain_ray(origin, direction);
    }
    let triangle = one_of(rng, &room.mesh.triangles);
    let side = rng.usize(..3);
    let [from, to] = [side, (side + 1) % 3].map(|k| room.mesh.vertices[triangle[k] as usize]);
    let part = one_of(rng, &[0.0, 0.0, 0.5, 0.25, rng.clone().f64()]);
    let length = one_of(rng, &[1.0, 1.0, 0.1, 3.7]);
    let mut direction =
        [0, 1, 2].map(|i| a.round(length * (from[i] + part * (to[i] - from[i]) - origin[i])));
    if rng.bool() {
        let axis = rng.usize(..3);
        direction[axis] = a.step(direction[axis], rng.i32(-3..=3));
    }
    plain_ray(origin, direction)
}
