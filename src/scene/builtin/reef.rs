//! A reef: shoals of fish that circle over weeds and stones. It has many instances of few objects. Most instances move and
//! deform; some are mirrored, and all are scaled differently along different axes.

use super::super::Mesh;
use super::super::animation::{
    Animated, Clip, Curve, Instance, Interpolation, Kind, Local, Node, Object, Property, Rig,
    Track, Writer,
};
use super::{Welder, shapes, snap};
use glam::{DAffine3, DQuat, DVec3, dvec3};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const WEEDS: u32 = 160;
const STONES: u32 = 80;

/// The period of the motion in seconds.
const PERIOD: f64 = 6.0;

/// Number of tail beats per period.
const BEATS: u32 = 8;

/// Shoals: turns per period (counter-clockwise seen from above), distance from the centre, and height.
const SHOALS: [(i32, f64, f64); 8] = [
    (1, 1.2, 0.8),
    (-1, 1.9, 1.3),
    (1, 2.6, 0.9),
    (-2, 1.5, 1.9),
    (1, 3.2, 1.5),
    (-1, 3.7, 0.8),
    (1, 2.4, 2.3),
    (-1, 3.0, 2.1),
];

/// Distance of the seabed's edges from the centre.
const REACH: f64 = 4.5;

/// Index of the first node with the weights of morph targets; the nodes of the shoals follow.
const BEAT: usize = 0;
const SWAY: usize = 1;
const FIRST_SHOAL: usize = 2;

pub fn animated(fish: u32) -> Animated {
    let still = Local::new(DVec3::ZERO, DQuat::IDENTITY, DVec3::ONE);
    let node = |name: String, parent, local, targets| Node {
        name,
        parent,
        local,
        weights: vec![0.0; targets],
    };
    let mut nodes = vec![
        node("beat".into(), None, still, 1),
        node("sway".into(), None, still, 1),
    ];
    for shoal in 0..SHOALS.len() {
        nodes.push(node(format!("shoal{shoal}"), None, still, 0));
    }
    let mut instances = Vec::new();
    let mut stand = |object: usize, name: String, parent: Option<usize>, local: Local| {
        nodes.push(node(name.clone(), parent, local, 0));
        instances.push(Instance {
            name,
            object,
            node: Some(nodes.len() - 1),
            local: DAffine3::IDENTITY,
        });
    };
    for number in 0..fish {
        let shoal = number as usize % SHOALS.len();
        let (turns, radius, height) = SHOALS[shoal];
        let radius = radius + 0.5 * (spread(number, 0) - 0.5);
        let angle = TAU * spread(number, 1);
        let place = dvec3(
            radius * angle.cos(),
            height + 0.5 * (spread(number, 2) - 0.5),
            radius * angle.sin(),
        );
        // The fish look in the direction in which the shoal turns.
        let heading = FRAC_PI_2 - angle + if turns < 0 { PI } else { 0.0 };
        let size = 0.6 + 0.6 * spread(number, 3);
        let side = if number % 3 == 0 { -1.0 } else { 1.0 };
        let scale = dvec3(size, size * (0.8 + 0.4 * spread(number, 0)), side * size);
        let local = placed(place, heading, scale);
        stand(0, format!("fish{number}"), Some(FIRST_SHOAL + shoal), local);
    }
    for number in 0..WEEDS {
        let (place, heading) = somewhere(number, 0.25);
        let height = 0.5 + spread(number, 2);
        let local = placed(place, heading, dvec3(0.8, height, 0.8));
        stand(1, format!("weed{number}"), None, local);
    }
    for number in 0..STONES {
        let (place, heading) = somewhere(number + WEEDS, 0.7);
        let size = 0.08 + 0.22 * spread(number, 3).powi(3);
        let flat = 0.4 + 0.4 * spread(number, 1);
        let local = placed(place, heading, dvec3(size, flat * size, 0.8 * size));
        stand(2, format!("stone{number}"), None, local);
    }
    stand(3, "seabed".into(), None, still);

    let mut rig = Rig::new(nodes).expect("parents precede their children");
    let mut tracks = vec![wave(BEAT, BEATS), wave(SWAY, 1)];
    for (shoal, (turns, ..)) in SHOALS.iter().enumerate() {
        tracks.push(turning(FIRST_SHOAL + shoal, *turns));
    }
    rig.add_clip(tracks);
    let (body, bend) = fish_body();
    let (blades, lean) = weed();
    let morphs = |displacement, node| Writer::Morphs {
        displacements: vec![displacement],
        node,
    };
    let object = |name: &str, mesh, kind, writer| Object {
        name: name.into(),
        mesh,
        kind,
        writer,
    };
    Animated {
        name: "reef".into(),
        objects: vec![
            object("fish", body, Kind::Morphed, morphs(bend, BEAT)),
            object("weed", blades, Kind::Morphed, morphs(lean, SWAY)),
            object("stone", shapes::sphere(2), Kind::Static, Writer::Nothing),
            object("seabed", seabed(), Kind::Static, Writer::Nothing),
        ],
        instances,
        clips: vec![Clip {
            name: "swim".into(),
            seconds: PERIOD,
        }],
        warnings: Vec::new(),
        rig,
    }
}

/// A number from 0 to 1. For one `axis` and the numbers 0, 1, 2, …, the values are evenly distributed.
fn spread(number: u32, axis: usize) -> f64 {
    // Powers of the inverse of the root of x⁵ = x + 1, whose multiples are distributed most evenly.
    const STEPS: [f64; 4] = [
        0.856_674_883_854_502_9,
        0.733_891_856_627_126_7,
        0.628_706_721_080_836_3,
        0.538_597_257_171_207_7,
    ];
    (0.5 + f64::from(number + 1) * STEPS[axis]).fract()
}

fn placed(place: DVec3, heading: f64, scale: DVec3) -> Local {
    let vector = |v: DVec3| DVec3::from(v.to_array().map(snap));
    let turn = DQuat::from_array(DQuat::from_rotation_y(heading).to_array().map(snap));
    Local::new(vector(place), turn.normalize(), vector(scale))
}

/// A position on the seabed, lowered by the share `sunk` of its relief, and a heading.
fn somewhere(number: u32, sunk: f64) -> (DVec3, f64) {
    let [x, z] = [0, 1].map(|axis| REACH * 0.95 * (2.0 * spread(number, axis) - 1.0));
    (
        dvec3(x, relief(x, z) - 0.05 * sunk, z),
        TAU * spread(number, 2),
    )
}

fn relief(x: f64, z: f64) -> f64 {
    0.12 * ((1.1 * x + 0.4 * z).sin() + (0.5 * x - 1.3 * z).cos())
}

fn seabed() -> Mesh {
    let mut welder = Welder::default();
    let along = |s: f64| REACH * (2.0 * s - 1.0);
    // Seen from above, corners run counter-clockwise.
    welder.surface(12, 12, |s, t| {
        let (x, z) = (along(t), along(s));
        [x, relief(x, z), z]
    });
    welder.mesh
}

/// A fish that faces +x, and the displacements that bend its tail to one side.
fn fish_body() -> (Mesh, Vec<[f64; 3]>) {
    let mut welder = Welder::default();
    let angle = |fraction: f64| TAU * fraction.rem_euclid(1.0);
    welder.surface(8, 7, |s, t| {
        // From the nose, at t = 0, to the base of the tail.
        let thickness = (PI * t.powf(0.7)).sin().max(0.0) * 0.06;
        let (sin, cos) = angle(s).sin_cos();
        [
            0.16 - 0.32 * t,
            1.3 * thickness * cos,
            0.6 * thickness * sin,
        ]
    });
    let fins = [
        [[-0.13, 0.0, 0.0], [-0.25, 0.09, 0.0], [-0.21, 0.0, 0.0]],
        [[-0.13, 0.0, 0.0], [-0.21, 0.0, 0.0], [-0.25, -0.09, 0.0]],
        [[0.05, 0.07, 0.0], [-0.08, 0.12, 0.0], [-0.06, 0.05, 0.0]],
    ];
    for corners in fins {
        let corners = corners.map(|corner| welder.vertex(corner));
        welder.triangle(corners);
    }
    let bend = |[x, _, _]: [f64; 3]| {
        let behind = (0.06 - x).max(0.0);
        [0.0, 0.0, snap(0.9 * behind * behind)]
    };
    let mesh = welder.mesh;
    let displacement = mesh.positions.iter().map(|&p| bend(p)).collect();
    (mesh, displacement)
}

/// Three blades that point towards +y, and the displacements that lean them to one side.
fn weed() -> (Mesh, Vec<[f64; 3]>) {
    let mut welder = Welder::default();
    for (blade, height) in [0.9, 0.7, 0.55].into_iter().enumerate() {
        let (sin, cos) = (TAU * blade as f64 / 3.0).sin_cos();
        welder.surface(4, 8, |s, t| {
            let (around, across) = (TAU * s.rem_euclid(1.0)).sin_cos();
            let width = 0.035 * (1.0 - t);
            let out = 0.05 + 0.12 * t * t;
            [
                out * cos + width * across,
                height * t,
                out * sin + width * around,
            ]
        });
    }
    let lean = |[_, y, _]: [f64; 3]| [snap(0.25 * y * y), 0.0, snap(0.1 * y * y)];
    let mesh = welder.mesh;
    let displacement = mesh.positions.iter().map(|&p| lean(p)).collect();
    (mesh, displacement)
}

/// The weight of a node's morph target as a wave with the given number of periods.
fn wave(node: usize, periods: u32) -> Track {
    let keys = 12 * periods;
    let part = |key: u32| f64::from(key) / f64::from(keys);
    let times = (0..=keys).map(|key| PERIOD * part(key)).collect();
    let values = (0..=keys)
        .map(|key| snap((TAU * f64::from(periods) * part(key)).sin()))
        .collect();
    Track {
        node,
        property: Property::Weights,
        curve: Curve::new(times, values, 1, Interpolation::Linear).expect("well-formed keys"),
    }
}

/// The rotation of a node about the vertical axis by the given number of turns.
fn turning(node: usize, turns: i32) -> Track {
    let keys = 8 * turns.unsigned_abs();
    let part = |key: u32| f64::from(key) / f64::from(keys);
    let times = (0..=keys).map(|key| PERIOD * part(key)).collect();
    let values = (0..=keys)
        .flat_map(|key| DQuat::from_rotation_y(TAU * f64::from(turns) * part(key)).to_array())
        .map(snap)
        .collect();
    let curve = Curve::new(times, values, 4, Interpolation::Linear);
    Track {
        node,
        property: Property::Rotation,
        curve: (curve.and_then(Curve::of_rotations)).expect("well-formed keys"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_thousand_instances_move_and_return() {
        let reef = animated(800);
        assert!(reef.instances.len() >= 1000 && reef.objects.len() >= 3);
        let at = |seconds: f64| reef.pose(Some(0), seconds).unwrap();
        let (start, middle, end) = (at(0.0), at(PERIOD / 3.0), at(PERIOD));
        let moved = std::iter::zip(&start.instances, &middle.instances);
        assert_eq!(moved.filter(|(a, b)| a != b).count(), 800);
        for (a, b) in std::iter::zip(&start.instances, &end.instances) {
            let [a, b] = [a, b].map(|matrix| matrix.unwrap());
            for (a, b) in a.as_flattened().iter().zip(b.as_flattened()) {
                assert!((a - b).abs() < 1e-6, "{a} {b}");
            }
        }
        let beat = |pose: &super::super::super::animation::Pose, object: usize| {
            pose.objects[object].positions.clone()
        };
        let quarter = at(PERIOD / f64::from(BEATS) / 4.0);
        assert_ne!(beat(&start, 0), beat(&quarter, 0));
        assert_ne!(beat(&start, 1), beat(&quarter, 1));
        assert!(beat(&start, 2).is_none());
    }

    #[test]
    fn fish_swim_ahead() {
        let reef = animated(16);
        let step = 0.01;
        let [now, then] = [0.0, step].map(|t| reef.pose(Some(0), t).unwrap());
        for number in 0..16 {
            let [a, b] = [&now, &then].map(|pose| pose.instances[number].unwrap());
            let moved: Vec<f64> = (0..3).map(|row| b[row][3] - a[row][3]).collect();
            // The first column is the direction of the nose.
            let ahead: f64 = (0..3).map(|row| a[row][0] * moved[row]).sum();
            let length = |v: &[f64]| v.iter().map(|x| x * x).sum::<f64>().sqrt();
            let nose: Vec<f64> = a.iter().map(|row| row[0]).collect();
            assert!(
                ahead > 0.99 * length(&moved) * length(&nose),
                "fish {number}"
            );
        }
    }
}
