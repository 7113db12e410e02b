//! A human figure with one closed skin.
//!
//! The body is the smooth union of round cones around the bones of the skeleton. Marching tetrahedra convert it to triangles,
//! which are then smoothed. A vertex is bound to the bone with the nearest cone; the binding is then spread over the
//! skin, so it bends smoothly and the motion of one leg does not move the other.

use super::super::Mesh;
use super::super::animation::{
    Animated, Clip, Curve, Influences, Instance, Interpolation, Kind, Local, MOST_INFLUENCES, Node,
    Object, Property, Rig, Skin, Track, Writer,
};
use super::snap;
use glam::{DAffine3, DQuat, DVec3};
use std::collections::{BTreeMap, HashMap};
use std::f64::consts::TAU;

/// Height in metres.
const HEIGHT: f64 = 1.8;

/// Distance over which cones are blended, in metres.
const SMOOTHING: f64 = 0.075;

/// Width over which the binding is spread, as a share of the figure's height.
const SPREAD: f64 = 0.035;

/// Joints: name, parent and position at rest, in metres. The figure stands on y = 0 and faces +z; its left is +x; its arms
/// point outwards and down at 45°. The joints of the left side are mirrored to the right.
const MIDDLE: [(&str, &str, [f64; 3]); 5] = [
    ("hips", "", [0.0, 0.95, 0.0]),
    ("spine", "hips", [0.0, 1.07, 0.0]),
    ("chest", "spine", [0.0, 1.22, 0.0]),
    ("neck", "chest", [0.0, 1.45, -0.01]),
    ("head", "neck", [0.0, 1.55, 0.0]),
];
const LEFT: [(&str, &str, [f64; 3]); 8] = [
    ("shoulder", "chest", [0.05, 1.38, 0.0]),
    ("upper_arm", "shoulder", [0.19, 1.385, 0.0]),
    ("forearm", "upper_arm", [0.388, 1.187, 0.0]),
    ("hand", "forearm", [0.565, 1.010, 0.0]),
    ("thigh", "hips", [0.10, 0.90, 0.0]),
    ("shin", "thigh", [0.13, 0.50, 0.0]),
    ("foot", "shin", [0.145, 0.10, -0.015]),
    ("toes", "foot", [0.150, 0.045, 0.095]),
];

/// A cone with round ends around a bone: the positions of both ends, each with its radius.
type Cone = (&'static str, [f64; 3], f64, [f64; 3], f64);

const MIDDLE_CONES: [Cone; 10] = [
    (
        "hips",
        [-0.07, 0.955, 0.0],
        0.110,
        [0.07, 0.955, 0.0],
        0.110,
    ),
    (
        "spine",
        [-0.035, 1.10, 0.0],
        0.108,
        [0.035, 1.10, 0.0],
        0.108,
    ),
    ("chest", [-0.06, 1.26, 0.0], 0.115, [0.06, 1.26, 0.0], 0.115),
    (
        "chest",
        [-0.09, 1.345, 0.0],
        0.085,
        [0.09, 1.345, 0.0],
        0.085,
    ),
    ("neck", [0.0, 1.42, -0.01], 0.056, [0.0, 1.53, 0.0], 0.052),
    ("head", [0.0, 1.61, 0.03], 0.078, [0.0, 1.615, 0.04], 0.074),
    (
        "head",
        [0.0, 1.69, 0.005],
        0.100,
        [0.0, 1.695, -0.015],
        0.098,
    ),
    (
        "head",
        [0.0, 1.655, 0.105],
        0.016,
        [0.0, 1.625, 0.128],
        0.020,
    ),
    (
        "head",
        [-0.095, 1.645, 0.0],
        0.024,
        [-0.105, 1.675, -0.01],
        0.026,
    ),
    (
        "head",
        [0.095, 1.645, 0.0],
        0.024,
        [0.105, 1.675, -0.01],
        0.026,
    ),
];
const LEFT_CONES: [Cone; 10] = [
    (
        "shoulder",
        [0.08, 1.385, 0.0],
        0.060,
        [0.17, 1.385, 0.0],
        0.066,
    ),
    (
        "upper_arm",
        [0.19, 1.385, 0.0],
        0.060,
        [0.388, 1.187, 0.0],
        0.044,
    ),
    (
        "forearm",
        [0.388, 1.187, 0.0],
        0.044,
        [0.565, 1.010, 0.0],
        0.032,
    ),
    (
        "hand",
        [0.585, 0.990, 0.0],
        0.036,
        [0.650, 0.925, 0.005],
        0.034,
    ),
    (
        "hand",
        [0.590, 0.990, 0.02],
        0.024,
        [0.615, 0.945, 0.062],
        0.020,
    ),
    ("thigh", [0.10, 0.90, 0.0], 0.092, [0.13, 0.50, 0.0], 0.060),
    (
        "shin",
        [0.13, 0.50, 0.0],
        0.058,
        [0.145, 0.11, -0.015],
        0.042,
    ),
    (
        "shin",
        [0.133, 0.40, -0.02],
        0.050,
        [0.138, 0.30, -0.02],
        0.046,
    ),
    (
        "foot",
        [0.145, 0.065, -0.035],
        0.050,
        [0.150, 0.045, 0.080],
        0.042,
    ),
    (
        "toes",
        [0.150, 0.042, 0.095],
        0.040,
        [0.152, 0.036, 0.150],
        0.034,
    ),
];

pub fn animated(detail: u32) -> Animated {
    let joints = joints();
    let cones = cones(&joints);
    let mut mesh = isosurface(&cones, HEIGHT / f64::from(detail));
    let neighbours = neighbours(&mesh);
    smooth(&mut mesh.positions, &neighbours, &cones);
    // Edges are about half a cell long, and a random spread reaches a distance that grows with the square root of the number of steps.
    let steps = (2.0 * SPREAD * f64::from(detail)).powi(2).round() as usize;
    let influences = bind(&mesh.positions, &neighbours, &cones, joints.len(), steps);
    let place = |joint: usize| DVec3::from_array(joints[joint].place);
    let nodes = joints.iter().enumerate().map(|(number, joint)| {
        let origin = joint.parent.map_or(DVec3::ZERO, place);
        Node {
            name: joint.name.clone(),
            parent: joint.parent,
            local: Local::new(place(number) - origin, DQuat::IDENTITY, DVec3::ONE),
            weights: Vec::new(),
        }
    });
    let mut rig = Rig::new(nodes.collect()).expect("parents precede their children");
    let mut clips = Vec::new();
    for (name, seconds, motion) in [
        ("walk", 1.2, walk as fn(&mut Limbs, f64)),
        ("wave", 1.6, wave),
    ] {
        rig.add_clip(tracks(&joints, seconds, motion));
        clips.push(Clip {
            name: name.into(),
            seconds,
        });
    }
    let skin = Skin {
        influences,
        joint_names: joints.iter().map(|joint| joint.name.clone()).collect(),
        nodes: (0..joints.len()).collect(),
        inverse_bind: (0..joints.len())
            .map(|joint| DAffine3::from_translation(-place(joint)))
            .collect(),
    };
    Animated {
        name: "figure".into(),
        objects: vec![Object {
            name: "figure".into(),
            mesh,
            kind: Kind::Skinned(skin),
            writer: Writer::Nothing,
        }],
        instances: vec![Instance {
            name: "figure".into(),
            object: 0,
            node: None,
            local: DAffine3::IDENTITY,
        }],
        clips,
        warnings: Vec::new(),
        rig,
    }
}

struct Joint {
    name: String,
    parent: Option<usize>,
    place: [f64; 3],
}

fn mirrored([x, y, z]: [f64; 3]) -> [f64; 3] {
    [-x, y, z]
}

/// The full name of `name` on one side of the body.
fn sided(name: &str, side: &str) -> String {
    match MIDDLE.iter().any(|(middle, ..)| *middle == name) {
        true => name.to_string(),
        false => format!("{side}_{name}"),
    }
}

fn joints() -> Vec<Joint> {
    let mut all: Vec<(String, String, [f64; 3])> = MIDDLE
        .iter()
        .map(|&(name, parent, place)| (name.to_string(), parent.to_string(), place))
        .collect();
    for side in ["left", "right"] {
        for (name, parent, place) in LEFT {
            let place = if side == "left" {
                place
            } else {
                mirrored(place)
            };
            all.push((sided(name, side), sided(parent, side), place));
        }
    }
    all.iter()
        .map(|(name, parent, place)| Joint {
            name: name.clone(),
            parent: all.iter().position(|(other, ..)| other == parent),
            place: *place,
        })
        .collect()
}

/// A cone, and the joint of its bone.
struct Flesh {
    joint: usize,
    from: DVec3,
    along: DVec3,
    radii: (f64, f64),
}

impl Flesh {
    /// The approximate distance from its surface, negative inside.
    fn distance(&self, point: DVec3) -> f64 {
        let offset = point - self.from;
        let part = (offset.dot(self.along) / self.along.length_squared()).clamp(0.0, 1.0);
        let radius = self.radii.0 + (self.radii.1 - self.radii.0) * part;
        (offset - self.along * part).length() - radius
    }
}

fn cones(joints: &[Joint]) -> Vec<Flesh> {
    let flesh = |name: String, from: [f64; 3], to: [f64; 3], radii| {
        let joint = joints.iter().position(|joint| joint.name == name);
        Flesh {
            joint: joint.expect("cones name joints"),
            from: DVec3::from_array(from),
            along: DVec3::from_array(to) - DVec3::from_array(from),
            radii,
        }
    };
    let mut all = Vec::new();
    for (name, from, r, to, s) in MIDDLE_CONES {
        all.push(flesh(name.to_string(), from, to, (r, s)));
    }
    for (name, from, r, to, s) in LEFT_CONES {
        all.push(flesh(sided(name, "left"), from, to, (r, s)));
        let (from, to) = (mirrored(from), mirrored(to));
        all.push(flesh(sided(name, "right"), from, to, (r, s)));
    }
    all
}

/// The field of the smooth union, negative inside.
fn field(cones: &[Flesh], point: DVec3) -> f64 {
    let distances = cones.iter().map(|cone| cone.distance(point));
    distances
        .reduce(|a, b| {
            // A polynomial that equals the minimum at some distance.
            let overlap = (SMOOTHING - (a - b).abs()).max(0.0) / SMOOTHING;
            a.min(b) - overlap * overlap * SMOOTHING / 4.0
        })
        .expect("there are cones")
}

/// The triangles of the field's zero by marching tetrahedra: each cube of a grid is divided into six tetrahedra, and
/// the surface cuts a tetrahedron in one or two triangles. The mesh is closed for any field, and each edge joins two
/// triangles.
fn isosurface(cones: &[Flesh], cell: f64) -> Mesh {
    let (mut low, mut high) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    for cone in cones {
        let radius = DVec3::splat(cone.radii.0.max(cone.radii.1) + SMOOTHING + cell);
        for end in [cone.from, cone.from + cone.along] {
            low = low.min(end - radius);
            high = high.max(end + radius);
        }
    }
    // One plane of the grid is the plane of symmetry.
    let first = (low / cell).floor();
    let counts = ((high / cell).ceil() - first + 1.0).to_array();
    let counts = counts.map(|count| count as usize);
    let point = |p: [usize; 3]| (first + DVec3::from_array(p.map(|i| i as f64))) * cell;
    let number = |p: [usize; 3]| (p[2] * counts[1] + p[1]) * counts[0] + p[0];
    let grid = |most: [usize; 3]| {
        (0..most[2])
            .flat_map(move |z| (0..most[1]).flat_map(move |y| (0..most[0]).map(move |x| [x, y, z])))
    };
    let values: Vec<f64> = grid(counts).map(|p| field(cones, point(p))).collect();
    let mut mesh = Mesh::default();
    // Keyed by the grid points of the edge that contains the vertex.
    let mut vertices: HashMap<[usize; 2], u32> = HashMap::new();
    for base in grid(counts.map(|count| count - 1)) {
        // A tetrahedron follows the cube's edges along the axes, in some order, from corner 000 to corner 111.
        for order in [
            [0, 1, 2],
            [1, 2, 0],
            [2, 0, 1],
            [0, 2, 1],
            [2, 1, 0],
            [1, 0, 2],
        ] {
            let mut corners = [base; 4];
            for (step, axis) in order.into_iter().enumerate() {
                for corner in &mut corners[step + 1..] {
                    corner[axis] += 1;
                }
            }
            let (inside, outside): (Vec<_>, Vec<_>) = corners
                .iter()
                .partition(|&&corner| values[number(corner)] < 0.0);
            let cut: Vec<[[usize; 3]; 2]> = match (inside.as_slice(), outside.as_slice()) {
                (&[i], &[a, b, c]) => vec![[i, a], [i, b], [i, c]],
                (&[a, b, c], &[o]) => vec![[a, o], [b, o], [c, o]],
                (&[i, j], &[a, b]) => vec![[i, a], [i, b], [j, b], [j, a]],
                _ => continue,
            };
            // The front is the side of the outside, judged by the midpoints of the edges, which are in one plane.
            let middle = |[i, o]: [[usize; 3]; 2]| (point(i) + point(o)) / 2.0;
            let [p, q, r] = [0, 1, 2].map(|corner| middle(cut[corner]));
            let outwards = point(cut[0][1]) - point(cut[0][0]);
            let turned = (q - p).cross(r - p).dot(outwards) < 0.0;
            let mut corners: Vec<u32> = cut
                .into_iter()
                .map(|[i, o]| {
                    *vertices.entry([number(i), number(o)]).or_insert_with(|| {
                        let (inner, outer) = (values[number(i)], values[number(o)]);
                        let place = point(i).lerp(point(o), inner / (inner - outer));
                        mesh.positions.push(place.to_array());
                        (mesh.positions.len() - 1) as u32
                    })
                })
                .collect();
            if turned {
                corners.reverse();
            }
            let fan = corners.windows(2).skip(1);
            mesh.triangles
                .extend(fan.map(|pair| [corners[0], pair[0], pair[1]]));
        }
    }
    mesh
}

/// For each vertex, the vertices that share an edge with it.
fn neighbours(mesh: &Mesh) -> Vec<Vec<usize>> {
    let mut neighbours = vec![Vec::new(); mesh.positions.len()];
    for &[a, b, c] in &mesh.triangles {
        // In a closed mesh every edge occurs once in each direction.
        for (from, to) in [(a, b), (b, c), (c, a)] {
            neighbours[from as usize].push(to as usize);
        }
    }
    neighbours
}

/// Smooths the traces of the grid: vertices move to the mean of their neighbours and from there back to the surface.
fn smooth(positions: &mut Vec<[f64; 3]>, neighbours: &[Vec<usize>], cones: &[Flesh]) {
    const ROUNDS: usize = 6;
    const STEP: f64 = 1e-4;
    for _ in 0..ROUNDS {
        let moved = neighbours.iter().map(|around| {
            let sum: DVec3 = around
                .iter()
                .map(|&other| DVec3::from_array(positions[other]))
                .sum();
            let middle = sum / around.len() as f64;
            let slope = DVec3::AXES.map(|axis| {
                let [ahead, behind] = [STEP, -STEP].map(|step| field(cones, middle + step * axis));
                (ahead - behind) / (2.0 * STEP)
            });
            let slope = DVec3::from_array(slope);
            let onto = middle - slope * (field(cones, middle) / slope.length_squared());
            onto.to_array().map(snap)
        });
        *positions = moved.collect();
    }
}

/// Binds every vertex to the joint with the nearest cone. Then `steps` times replaces the binding of each vertex by the mean of
/// itself and its neighbours.
fn bind(
    positions: &[[f64; 3]],
    neighbours: &[Vec<usize>],
    cones: &[Flesh],
    joint_count: usize,
    steps: usize,
) -> Vec<Influences> {
    let mut bindings: Vec<BTreeMap<usize, f64>> = positions
        .iter()
        .map(|&position| {
            let point = DVec3::from_array(position);
            let nearest = cones
                .iter()
                .min_by(|a, b| a.distance(point).total_cmp(&b.distance(point)));
            BTreeMap::from([(nearest.expect("there are cones").joint, 1.0)])
        })
        .collect();
    for _ in 0..steps {
        bindings = (0..bindings.len())
            .map(|vertex| {
                let around = &neighbours[vertex];
                let mut mean = bindings[vertex].clone();
                for &neighbour in around {
                    for (&joint, weight) in &bindings[neighbour] {
                        *mean.entry(joint).or_default() += weight;
                    }
                }
                let parts = 1.0 + around.len() as f64;
                mean.values_mut().for_each(|weight| *weight /= parts);
                mean
            })
            .collect();
    }
    bindings
        .into_iter()
        .map(|binding| {
            let mut given: Vec<(u32, f64)> = binding
                .into_iter()
                .map(|(joint, weight)| (joint as u32, weight))
                .collect();
            given.sort_by(|(_, v), (_, w)| w.total_cmp(v));
            // Very small weights of distant joints would cost one influence each and would not be visible.
            let strongest = given[0].1;
            given.retain(|(_, weight)| *weight >= strongest / 32.0);
            given.truncate(MOST_INFLUENCES);
            let given: Vec<(u32, f64)> = given.iter().map(|&(j, w)| (j, snap(w))).collect();
            let (influences, _) = Influences::new(&given, joint_count).expect("positive weights");
            influences
        })
        .collect()
}

/// The state of a motion at one time: rotations of joints, in radians, and the position of the hips.
struct Limbs<'a> {
    joints: &'a [Joint],
    rotations: Vec<DQuat>,
    hips: DVec3,
}

impl Limbs<'_> {
    /// Rotates a joint about an axis of the world at rest, before the rotations set earlier.
    fn turn(&mut self, joint: &str, axis: DVec3, angle: f64) {
        let place = self.joints.iter().position(|other| other.name == joint);
        let rotation = &mut self.rotations[place.expect("motions name joints")];
        *rotation = DQuat::from_axis_angle(axis, angle) * *rotation;
    }

    /// Rotates a joint so that a bone that points down swings forwards.
    fn swing(&mut self, joint: &str, angle: f64) {
        self.turn(joint, DVec3::NEG_X, angle);
    }
}

/// The angle of the relaxed arms relative to their 45°, in radians.
const AT_EASE: f64 = 0.62;

/// One step with each foot. `phase` runs from 0 to 1.
fn walk(limbs: &mut Limbs, phase: f64) {
    for (side, out, turn) in [("left", 1.0, phase), ("right", -1.0, phase + 0.5)] {
        let (sin, cos) = (TAU * turn).sin_cos();
        let named = |name: &str| format!("{side}_{name}");
        // The knee bends while the leg moves forward.
        let knee = 0.12 + 0.85 * cos.max(0.0).powi(2);
        limbs.swing(&named("thigh"), 0.08 + 0.42 * sin);
        limbs.swing(&named("shin"), -knee);
        limbs.swing(&named("foot"), 0.6 * knee - 0.25 * sin - 0.05);
        limbs.swing(&named("toes"), 0.35 * (-sin).max(0.0) * cos.max(0.0));
        limbs.turn(&named("upper_arm"), DVec3::Z, -out * AT_EASE);
        limbs.swing(&named("upper_arm"), -0.45 * sin);
        // The forearm bends forwards about the axis perpendicular to its 45°.
        let across = DVec3::new(-1.0, -out, 0.0).normalize();
        limbs.turn(&named("forearm"), across, 0.35 - 0.25 * sin);
    }
    let (sin, _) = (TAU * phase).sin_cos();
    limbs.turn("hips", DVec3::Y, -0.09 * sin);
    limbs.turn("spine", DVec3::Y, 0.09 * sin);
    limbs.turn("chest", DVec3::Y, 0.11 * sin);
    limbs.turn("head", DVec3::Y, -0.11 * sin);
    limbs.turn("spine", DVec3::X, 0.05);
    // The hips are highest when a leg passes below them.
    limbs.hips.y += 0.018 * (2.0 * TAU * phase).cos() - 0.03;
}

/// Waves with the right hand. `phase` runs from 0 to 1.
fn wave(limbs: &mut Limbs, phase: f64) {
    let (sin, _) = (TAU * phase).sin_cos();
    let (faster, _) = (2.0 * TAU * phase).sin_cos();
    limbs.turn("left_upper_arm", DVec3::Z, -AT_EASE + 0.04 * sin);
    limbs.turn(
        "left_forearm",
        DVec3::new(-1.0, -1.0, 0.0).normalize(),
        0.25,
    );
    limbs.turn("right_shoulder", DVec3::Z, -0.25);
    limbs.turn("right_upper_arm", DVec3::Z, -0.75);
    limbs.turn("right_forearm", DVec3::Z, -1.25 + 0.4 * faster);
    limbs.turn("right_hand", DVec3::Z, 0.25 * faster);
    limbs.turn("chest", DVec3::Z, 0.04 * sin);
    limbs.turn("head", DVec3::Z, 0.10 + 0.05 * sin);
    limbs.turn("head", DVec3::Y, -0.15);
    limbs.hips.x += 0.012 * sin;
}

/// The keys of a periodic motion.
fn tracks(joints: &[Joint], seconds: f64, motion: fn(&mut Limbs, f64)) -> Vec<Track> {
    const KEYS: u32 = 24;
    let times: Vec<f64> = (0..=KEYS)
        .map(|key| seconds * f64::from(key) / f64::from(KEYS))
        .collect();
    let keys: Vec<Limbs> = (0..=KEYS)
        .map(|key| {
            let mut limbs = Limbs {
                joints,
                rotations: vec![DQuat::IDENTITY; joints.len()],
                hips: DVec3::from_array(joints[0].place),
            };
            motion(&mut limbs, f64::from(key % KEYS) / f64::from(KEYS));
            limbs
        })
        .collect();
    let curve = |width: usize, values: Vec<f64>| {
        let values = values.into_iter().map(snap).collect();
        Curve::new(times.clone(), values, width, Interpolation::Linear).expect("well-formed keys")
    };
    let mut tracks = vec![Track {
        node: 0,
        property: Property::Translation,
        curve: curve(
            3,
            keys.iter()
                .flat_map(|limbs| limbs.hips.to_array())
                .collect(),
        ),
    }];
    for joint in 0..joints.len() {
        if keys
            .iter()
            .all(|limbs| limbs.rotations[joint] == DQuat::IDENTITY)
        {
            continue;
        }
        let values = keys
            .iter()
            .flat_map(|limbs| limbs.rotations[joint].to_array());
        tracks.push(Track {
            node: joint,
            property: Property::Rotation,
            curve: curve(4, values.collect())
                .of_rotations()
                .expect("rotations"),
        });
    }
    tracks
}
