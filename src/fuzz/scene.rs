//! Small random animated scenes: degenerate triangles of all kinds; rotated, mirrored and flattened instances; vertices
//! moved by the host and by joints.
//!
//! Every part of a scene has its own random stream, so a scene with fewer parts has the same remaining parts.

use super::case::{Case, Size};
use crate::bkd::layout::{Columns, Influence, InstanceRecord};
use crate::bkd::{Bounds, InstanceSpec};
use crate::config::Config;
use crate::cosim::animate::Film;
use crate::float::{Arithmetic, Format};
use crate::golden::skinning::{MOST_INFLUENCES, skin_vertices};
use crate::port::Ray;
use crate::scene::animation::{
    IDENTITY, MachineFrame, MachineObject, MachineScene, Matrix3x4, ObjectFrame, transform_point,
};
use crate::scene::{ImageSize, RayPacket};
use anyhow::{Result, ensure};
use fastrand::Rng;
use glam::{DAffine3, DMat3, DQuat, DVec3};

/// The maximum coordinate at rest. It is small enough that the narrowest format can represent the moved vertices.
const REACH: i32 = 3;

/// Maximum number of joints of an object.
const MOST_JOINTS: u32 = 4;

/// A random animated scene, and the rays for each of its frames.
pub struct RandomFilm {
    scene: MachineScene,
    frames: Vec<MachineFrame>,
    size: ImageSize,
    packets: Vec<RayPacket>,
}

/// The part of a scene to which a random stream belongs.
#[derive(Clone, Copy)]
enum Part {
    Object,
    Triangle,
    Motion,
    Instance,
    Packet,
}

fn stream(seed: u64, part: Part, place: &[u32]) -> Rng {
    let mut state = seed ^ 0x0066_696c_6d00 ^ part as u64;
    for &number in place {
        // One step of a generator each, so neighbouring streams are unrelated.
        state = Rng::with_seed(state).u64(..) ^ u64::from(number);
    }
    Rng::with_seed(state)
}

/// The motion of an object's vertices.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Motion {
    Still,
    Written,
    Skinned,
    WrittenAndSkinned,
}

impl Motion {
    fn is_skinned(self) -> bool {
        matches!(self, Motion::Skinned | Motion::WrittenAndSkinned)
    }

    fn is_written(self) -> bool {
        matches!(self, Motion::Written | Motion::WrittenAndSkinned)
    }
}

fn one_of<T: Copy>(rng: &mut Rng, choices: &[T]) -> T {
    choices[rng.usize(..choices.len())]
}

/// A random number from −`reach` to `reach`.
fn between(rng: &mut Rng, reach: f64) -> f64 {
    (2.0 * rng.f64() - 1.0) * reach
}

impl RandomFilm {
    /// The scene of a case.
    ///
    /// # Errors
    /// If the machine cannot hold even the simplest scene. No configuration within the ranges is known to be that small.
    pub fn new(case: &Case) -> Result<RandomFilm> {
        let Case {
            seed,
            config,
            sizes,
        } = case;
        let format = config.format();
        let a = Arithmetic::new(format);
        let count = |size| sizes.get(size);
        let objects = (0..count(Size::Objects))
            .map(|number| Object::random(case, &a, number))
            .collect::<Result<Vec<_>>>()?;
        let instances: Vec<usize> = (0..count(Size::Instances))
            .map(|number| (number % count(Size::Objects)) as usize)
            .collect();
        let mut scene = MachineScene {
            format,
            log2_scale: 0,
            objects: objects.iter().map(|o| o.machine.clone()).collect(),
            instances,
        };
        let mut frames: Vec<MachineFrame> = vec![];
        // The vertices written by the host up to this frame, and the resulting positions.
        let mut rest: Vec<_> = scene.objects.iter().map(|o| o.rest.clone()).collect();
        let mut posed = rest.clone();
        for number in 0..count(Size::Frames) {
            let mut states = vec![];
            for (place, object) in objects.iter().enumerate() {
                let mut rng = stream(*seed, Part::Motion, &[place as u32, number]);
                let state = object.state(&a, &rest[place], number, &mut rng);
                if let Some(written) = &state.written {
                    rest[place].clone_from(written);
                }
                let state = object.held(&a, &rest[place], state);
                posed[place] = object.posed(&a, &rest[place], &state.palette);
                states.push(state);
            }
            let boxes: Vec<Bounds> = (scene.objects.iter().zip(&posed))
                .map(|(object, vertices)| box_of(&object.triangles, vertices))
                .collect();
            let mut matrices: Vec<Matrix3x4> = vec![];
            for (place, &object) in scene.instances.iter().enumerate() {
                let matrix = placement(config, *seed, place as u32, number, &matrices);
                let fits = |matrix: &Matrix3x4| {
                    InstanceSpec::new(format, place, object, &columns(matrix), boxes[object])
                };
                let matrix = match fits(&matrix) {
                    Ok(_) => matrix,
                    // The format is too coarse at this position.
                    Err(_) => IDENTITY,
                };
                fits(&matrix)?;
                matrices.push(matrix);
            }
            frames.push(MachineFrame {
                objects: states,
                instances: matrices.into_iter().map(Some).collect(),
            });
        }
        // An object without instances would have a box that nothing checks.
        let shown = scene.instances.len().min(scene.objects.len());
        scene.objects.truncate(shown);
        for frame in &mut frames {
            frame.objects.truncate(shown);
        }
        let targets = Targets::new(&scene, &frames[frames.len() - 1], &posed);
        let packets = (0..count(Size::Packets))
            .map(|number| {
                let rng = &mut stream(*seed, Part::Packet, &[number]);
                targets.packet(&a, config, number, rng)
            })
            .collect();
        let pixels = count(Size::Packets) * config.rays_per_packet;
        Ok(RandomFilm {
            scene,
            frames,
            size: ImageSize::new(PIXELS_A_ROW, pixels.div_ceil(PIXELS_A_ROW))?,
            packets,
        })
    }

    pub fn film(&self) -> Film<'_> {
        Film {
            scene: &self.scene,
            frames: &self.frames,
            size: self.size,
            packets: &self.packets,
        }
    }
}

/// Rays are unrelated to each other; each has its own pixel, which makes its hit visible.
const PIXELS_A_ROW: u32 = 16;

struct Object {
    motion: Motion,
    machine: MachineObject,
    joints: u32,
}

impl Object {
    fn random(case: &Case, a: &Arithmetic, number: u32) -> Result<Object> {
        let Case {
            seed,
            config,
            sizes,
        } = case;
        let rng = &mut stream(*seed, Part::Object, &[number]);
        let motion = match rng.u8(..8) {
            // At least one object moves in every scene.
            0 | 1 if number > 0 => Motion::Still,
            0..=3 => Motion::Written,
            4 | 5 => Motion::WrittenAndSkinned,
            _ => Motion::Skinned,
        };
        let joints = rng.u32(1..=MOST_JOINTS.min(config.skinning_joints));
        // The number of vectors that the object may use in memory: a skinned object has its palette, and its vertices twice.
        let instances = u64::from(sizes.get(Size::Instances)) * InstanceRecord::VECTORS as u64;
        let all = (1u64 << config.address_bits) - instances;
        let own = all / u64::from(sizes.get(Size::Objects));
        let most = match motion.is_skinned() {
            true => (own - 4 * u64::from(joints)) / 2,
            false => own,
        };
        // An update needs up to 2 log2(n) box registers for n triangles.
        let registers = 1 << (config.update_box_registers / 2).min(16);
        let triangles = sizes.get(Size::Triangles).min(registers);
        ensure!(
            most >= 3,
            "{} address bits do not even hold a triangle",
            config.address_bits
        );
        let mut mesh = Mesh {
            vertices: vec![],
            triangles: vec![],
            most: most as usize,
            flat: (rng.u8(..6) == 0).then(|| (rng.usize(..3), on_grid(rng))),
        };
        for triangle in 0..triangles {
            mesh.add(a, &mut stream(*seed, Part::Triangle, &[number, triangle]));
        }
        let influences = motion.is_skinned().then(|| {
            (mesh.vertices.iter())
                .map(|_| influences(a, joints, rng))
                .collect()
        });
        Ok(Object {
            motion,
            machine: MachineObject {
                name: format!("object {number}"),
                log2_scale: 0,
                rest_log2_scale: 0,
                rest: mesh.vertices,
                triangles: mesh.triangles,
                influences,
            },
            joints,
        })
    }

    /// The data that the host supplies for a frame.
    fn state(&self, a: &Arithmetic, rest: &[[f64; 3]], frame: u32, rng: &mut Rng) -> ObjectFrame {
        // In some frames nothing is written, so nothing moves.
        let is_written = self.motion.is_written() && (frame == 0 || rng.u8(..4) > 0);
        let flat = (rng.u8(..6) == 0).then(|| (rng.usize(..3), on_grid(rng)));
        let onto = (rng.u8(..12) == 0).then(|| [0; 3].map(|_| on_grid(rng)));
        let written = is_written.then(|| {
            let limit = f64::from(REACH);
            (rest.iter())
                .map(|at| {
                    let mut to = at.map(|x| (x + between(rng, 1.0)).clamp(-limit, limit));
                    if let Some((axis, plane)) = flat {
                        to[axis] = plane;
                    }
                    onto.unwrap_or(to).map(|x| a.round(x) + 0.0)
                })
                .collect()
        });
        let joints = if self.motion.is_skinned() {
            self.joints
        } else {
            0
        };
        ObjectFrame {
            written,
            palette: (0..joints).map(|_| joint(a, rng)).collect(),
        }
    }

    /// The state, with joints at rest if the format cannot represent the moved vertices.
    fn held(&self, a: &Arithmetic, rest: &[[f64; 3]], mut state: ObjectFrame) -> ObjectFrame {
        // Half of the greatest number, which leaves room for the widening of the box.
        let limit = greatest(a.format()) / 2.0;
        let posed = self.posed(a, rest, &state.palette);
        let mut used = (self.machine.triangles.iter().flatten()).map(|&v| posed[v as usize]);
        if used.any(|vertex| vertex.iter().any(|x| x.is_nan() || x.abs() > limit)) {
            state.palette.fill(columns(&IDENTITY));
        }
        state
    }

    fn posed(&self, a: &Arithmetic, rest: &[[f64; 3]], palette: &[Columns]) -> Vec<[f64; 3]> {
        match &self.machine.influences {
            Some(influences) => skin_vertices(a, rest, &influences.concat(), palette),
            None => rest.to_vec(),
        }
    }
}

/// A mesh under construction.
struct Mesh {
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
    /// Maximum number of vertices, at least three.
    most: usize,
    /// The plane of a flat mesh, if it is flat.
    flat: Option<(usize, f64)>,
}

impl Mesh {
    fn add(&mut self, a: &Arithmetic, rng: &mut Rng) {
        let kind = rng.u8(..10);
        if kind == 0 && !self.triangles.is_empty() {
            // A copy of another triangle, possibly with reversed orientation.
            let mut corners = one_of(rng, &self.triangles);
            match rng.bool() {
                true => corners.rotate_left(rng.usize(..3)),
                false => corners.swap(0, 1),
            }
            self.triangles.push(corners);
            return;
        }
        let plane = (kind == 1).then(|| (rng.usize(..3), on_grid(rng)));
        let first = self.corner(a, plane, rng);
        let second = match kind {
            // No area: two or three corners coincide.
            2 | 3 => first,
            // A sliver.
            4 => {
                let mut near = self.vertices[first as usize];
                let axis = rng.usize(..3);
                near[axis] = a.round(near[axis] * (1.0 + 1e-3) + one_of(rng, &[0.0, 0.125]));
                self.vertex(near, rng)
            }
            _ => self.corner(a, plane, rng),
        };
        let third = match kind {
            3 => first,
            // No area: the third corner is on the line of the others.
            5 => {
                let [p, q] = [first, second].map(|v| self.vertices[v as usize]);
                let between = [0, 1, 2].map(|i| a.round((p[i] + q[i]) / 2.0));
                self.vertex(between, rng)
            }
            _ => self.corner(a, plane, rng),
        };
        let mut corners = [first, second, third];
        rng.shuffle(&mut corners);
        self.triangles.push(corners);
    }

    /// A vertex, either new or shared with another triangle.
    fn corner(&mut self, a: &Arithmetic, plane: Option<(usize, f64)>, rng: &mut Rng) -> u32 {
        if plane.is_none() && !self.vertices.is_empty() && rng.u8(..3) == 0 {
            return rng.u32(..self.vertices.len() as u32);
        }
        let mut at = match rng.bool() {
            true => [0; 3].map(|_| on_grid(rng)),
            false => [0; 3].map(|_| a.round(between(rng, f64::from(REACH)))),
        };
        if let Some((axis, to)) = plane {
            at[axis] = to;
        }
        self.vertex(at, rng)
    }

    /// A new vertex if there is room, otherwise an existing one.
    fn vertex(&mut self, mut at: [f64; 3], rng: &mut Rng) -> u32 {
        let count = self.vertices.len();
        if count == self.most {
            return rng.u32(..count as u32);
        }
        if let Some((axis, to)) = self.flat {
            at[axis] = to;
        }
        self.vertices.push(at.map(|x| x + 0.0));
        count as u32
    }
}

fn on_grid(rng: &mut Rng) -> f64 {
    f64::from(rng.i32(-REACH..=REACH))
}

/// Influences of 1 to 4 joints, whose weights have the sum 1 up to rounding.
fn influences(a: &Arithmetic, joints: u32, rng: &mut Rng) -> Vec<Influence> {
    let count = rng.usize(1..=MOST_INFLUENCES);
    let weights: Vec<f64> = (0..count).map(|_| 0.05 + rng.f64()).collect();
    let sum: f64 = weights.iter().sum();
    (weights.iter().enumerate())
        .map(|(place, weight)| Influence {
            joint: rng.u32(..joints) as u8,
            weight: a.round(weight / sum),
            last: place + 1 == count,
        })
        .collect()
}

/// A matrix of a palette: it rotates, mirrors, flattens or keeps the object, and translates it slightly.
fn joint(a: &Arithmetic, rng: &mut Rng) -> Columns {
    let linear = match rng.u8(..6) {
        0 => DMat3::IDENTITY,
        1 => exchange(rng),
        2 => DMat3::from_diagonal(DVec3::new(1.0, 1.0, 0.0)),
        _ => turn(rng) * DMat3::from_diagonal(DVec3::splat(0.5 + rng.f64() / 2.0)),
    };
    let place = DVec3::from_array([0; 3].map(|_| between(rng, 1.0)));
    let matrix = DAffine3::from_mat3_translation(linear, place).to_cols_array_2d();
    matrix.map(|column| column.map(|x| a.round(x) + 0.0))
}

/// A permutation of the axes, some of them mirrored.
fn exchange(rng: &mut Rng) -> DMat3 {
    let mut axes = [DVec3::X, DVec3::Y, DVec3::Z];
    rng.shuffle(&mut axes);
    let [x, y, z] = axes.map(|axis| axis * one_of(rng, &[1.0, -1.0]));
    DMat3::from_cols(x, y, z)
}

fn turn(rng: &mut Rng) -> DMat3 {
    let numbers = [0; 4].map(|_| between(rng, 1.0));
    let length = numbers.iter().map(|x| x * x).sum::<f64>().sqrt();
    match length > 0.1 {
        true => DMat3::from_quat(DQuat::from_array(numbers.map(|x| x / length))),
        false => DMat3::IDENTITY,
    }
}

/// The placement of an instance in a frame. `before` has the frame's instances with lower numbers.
fn placement(
    config: &Config,
    seed: u64,
    number: u32,
    frame: u32,
    before: &[Matrix3x4],
) -> Matrix3x4 {
    let rng = &mut stream(seed, Part::Instance, &[number]);
    let kind = rng.u8(..8);
    if kind == 0 && !before.is_empty() {
        // At the position of another instance, of the same or another object.
        return one_of(rng, before);
    }
    let (moves, linear) = match kind {
        0 | 1 => return IDENTITY,
        2 => (false, exchange(rng) * one_of(rng, &[0.5, 1.0, 2.0])),
        3 => {
            // Almost flat.
            let scale = DVec3::new(1.0, 1.0, 1.0 / 64.0);
            (rng.bool(), turn(rng) * DMat3::from_diagonal(scale))
        }
        _ => {
            let scale = DVec3::from_array([0; 3].map(|_| 0.25 + 1.5 * rng.f64()));
            let mirror = DVec3::new(one_of(rng, &[1.0, 1.0, -1.0]), 1.0, 1.0);
            let linear = turn(rng) * DMat3::from_diagonal(scale * mirror);
            (rng.bool(), linear)
        }
    };
    let reach = (greatest(config.format()) / 4.0).min(8.0);
    let place = DVec3::from_array([0; 3].map(|_| between(rng, reach)));
    let mut matrix = DAffine3::from_mat3_translation(linear, place);
    if moves {
        matrix.matrix3 *= DMat3::from_rotation_y(f64::from(frame));
        matrix.translation.x += 0.5 * f64::from(frame);
    }
    let columns = matrix.to_cols_array_2d();
    std::array::from_fn(|row| std::array::from_fn(|column| columns[column][row]))
}

fn columns(matrix: &Matrix3x4) -> Columns {
    std::array::from_fn(|column| std::array::from_fn(|row| matrix[row][column]))
}

/// The finite number of a format with the greatest exponent and fraction 0.
fn greatest(format: Format) -> f64 {
    f64::from(format.bias()).exp2()
}

fn box_of(triangles: &[[u32; 3]], vertices: &[[f64; 3]]) -> Bounds {
    (triangles.iter()).fold(Bounds::EMPTY, |bounds, &triangle| {
        bounds.union(Bounds::of_triangle(vertices, triangle))
    })
}

/// Triangles in the world as targets of rays.
struct Targets {
    triangles: Vec<[[f64; 3]; 3]>,
}

impl Targets {
    fn new(scene: &MachineScene, frame: &MachineFrame, posed: &[Vec<[f64; 3]>]) -> Targets {
        let places = scene.instances.iter().zip(&frame.instances);
        let there = places.filter_map(|(&object, matrix)| Some((object, matrix.as_ref()?)));
        let triangles = there.flat_map(|(object, matrix)| {
            let vertices = &posed[object];
            let at = move |v: u32| transform_point(matrix, vertices[v as usize]);
            (scene.objects[object].triangles.iter()).map(move |triangle| triangle.map(at))
        });
        Targets {
            triangles: triangles.collect(),
        }
    }

    /// Unrelated rays, or rays with one origin and almost the same direction.
    fn packet(&self, a: &Arithmetic, config: &Config, number: u32, rng: &mut Rng) -> RayPacket {
        let size = config.rays_per_packet;
        let together = rng.bool();
        let first = self.ray(a, rng);
        let rays = (0..size).map(|place| match (place, together) {
            (0, _) => first,
            (_, true) => Ray {
                direction: (first.direction).map(|x| a.round(x * (1.0 + between(rng, 0.1)))),
                ..first
            },
            (_, false) => self.ray(a, rng),
        });
        let rays = rays.collect();
        let pixel = |place: u32| {
            let pixel = number * size + place;
            [pixel % PIXELS_A_ROW, pixel / PIXELS_A_ROW]
        };
        RayPacket {
            pixels: (0..size).map(pixel).collect(),
            rays,
        }
    }

    fn ray(&self, a: &Arithmetic, rng: &mut Rng) -> Ray {
        if rng.u8(..12) == 0 {
            return Ray::INACTIVE;
        }
        let [p, q, r] = one_of(rng, &self.triangles);
        let (u, v) = match rng.u8(..4) {
            0 => one_of(rng, &[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]),
            1 => one_of(rng, &[(0.5, 0.0), (0.0, 0.5), (0.5, 0.5)]),
            _ => (0.6 * rng.f64(), 0.4 * rng.f64()),
        };
        let target = [0, 1, 2].map(|i| p[i] + u * (q[i] - p[i]) + v * (r[i] - p[i]));
        let reach = greatest(a.format()).min(4.0 * f64::from(REACH)) / 2.0;
        let origin = match rng.u8(..8) {
            0 => target,
            1 => p,
            2 | 3 => [0; 3].map(|_| on_grid(rng)),
            _ => [0; 3].map(|_| between(rng, reach)),
        };
        let origin = origin.map(|x| a.round(x));
        let mut direction = [0, 1, 2].map(|i| a.round(target[i] - origin[i]));
        if rng.u8(..8) == 0 {
            // Parallel to an axis: reciprocals are infinite, and the ray may be in a plane of a box.
            direction = [0; 3].map(|_| one_of(rng, &[0.0, -0.0]));
            direction[rng.usize(..3)] = one_of(rng, &[1.0, -1.0]);
        }
        let mut ray = Ray {
            origin,
            direction,
            tmin: one_of(rng, &[0.0, 0.0, 0.0, 0.5]),
            tmax: one_of(rng, &[f64::INFINITY, f64::INFINITY, 1.0, 2.0]),
            active: true,
            any_hit: false,
        };
        if rng.u8(..24) == 0 {
            let odd = one_of(rng, &[f64::NAN, f64::INFINITY, f64::NEG_INFINITY]);
            match rng.u8(..3) {
                0 => ray.origin[rng.usize(..3)] = odd,
                1 => ray.direction[rng.usize(..3)] = odd,
                _ => ray.tmax = odd,
            }
        }
        ray
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scenes_of_all_machines_are_sound_and_full_of_what_is_hard() {
        let (mut coincident, mut no_area, mut flat, mut moved, mut levels) = (0, 0, 0, 0, [0; 2]);
        for seed in 0..400 {
            let case = Case::random(seed);
            let film = RandomFilm::new(&case)
                .unwrap_or_else(|error| panic!("seed {seed}: {error:#}\n{:?}", case.settings()));
            let scene = &film.scene;
            assert_eq!(film.frames.len() as u32, case.sizes.get(Size::Frames));
            assert!(!film.packets.is_empty() && !scene.objects.is_empty());
            levels[usize::from(!scene.is_one_level(&film.frames))] += 1;
            let a = Arithmetic::new(scene.format);
            for object in &scene.objects {
                assert!(!object.triangles.is_empty());
                for x in object.rest.as_flattened() {
                    assert!(a.round(*x) == *x && x.to_bits() != (-0f64).to_bits());
                }
                let at = |v: u32| object.rest[v as usize];
                let set = |t: &[u32; 3]| {
                    let mut corners = *t;
                    corners.sort_unstable();
                    corners
                };
                for (number, triangle) in object.triangles.iter().enumerate() {
                    let before = &object.triangles[..number];
                    coincident += u32::from(before.iter().any(|t| set(t) == set(triangle)));
                    let [p, q, r] = triangle.map(|v| DVec3::from_array(at(v)));
                    no_area += u32::from((q - p).cross(r - p) == DVec3::ZERO);
                    let bounds = Bounds::of_triangle(&object.rest, *triangle);
                    flat += u32::from((0..3).any(|i| bounds.lo[i] == bounds.hi[i]));
                }
            }
            for pair in film.frames.windows(2) {
                moved += u32::from(pair[0] != pair[1]);
            }
        }
        println!(
            "{coincident} coincident, {no_area} without area, {flat} flat, {moved} moved, {levels:?} of one and two levels"
        );
        assert!(coincident > 100 && no_area > 100 && flat > 100 && moved > 100);
        assert!(levels.iter().all(|&count| count > 10));
    }

    #[test]
    fn a_smaller_scene_is_the_same_but_for_what_it_lacks() {
        let case = (0..)
            .map(Case::random)
            .find(|case| {
                // Room for all vertices, so none is shared for lack of room.
                case.config.address_bits > 12
                    && case.sizes.get(Size::Triangles) > 6
                    && case.sizes.get(Size::Frames) > 1
            })
            .unwrap();
        let mut smaller = case.clone();
        smaller.sizes.set(Size::Triangles, 5);
        smaller.sizes.set(Size::Frames, 1);
        let [whole, part] = [&case, &smaller].map(|case| RandomFilm::new(case).unwrap());
        let [w, p] = [&whole, &part].map(|film| &film.scene.objects[0].triangles);
        assert_eq!(w[..p.len()], p[..]);
        assert_eq!(whole.frames[0].instances, part.frames[0].instances);
    }
}
