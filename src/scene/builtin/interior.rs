//! A vaulted hall, in metres: a nave between two arcades of ten bays, aisles under groin vaults, benches,
//! chandeliers, urns and a sculpture. x runs along the nave, y points up. The walls are closed, so
//! every ray from inside hits.

use super::shapes::knot_into;
use super::{Mesh, Welder};
use std::f64::consts::{FRAC_PI_2, PI, TAU};

const HALF_LENGTH: f64 = 20.0;
const HALF_WIDTH: f64 = 8.0;
const HEIGHT: f64 = 13.8;
const BAYS: u32 = 10;
const BAY: f64 = 2.0 * HALF_LENGTH / BAYS as f64;
/// The walls of the arcades, as distances from the centre line of the nave.
const ARCADE_INNER: f64 = 3.65;
const ARCADE_OUTER: f64 = 4.35;
const ARCADE_MIDDLE: f64 = (ARCADE_INNER + ARCADE_OUTER) / 2.0;
/// The height at which the arches of the arcades and the vaults of the aisles begin.
const SPRINGING: f64 = 4.6;
const ARCH_RADIUS: f64 = 1.55;
/// The height at which the vault of the nave begins.
const NAVE_SPRINGING: f64 = 9.4;

pub fn mesh() -> Mesh {
    let mut hall = Welder::default();
    shell(&mut hall);
    nave_vault(&mut hall);
    for side in [-1.0, 1.0] {
        for bay in 0..BAYS {
            let middle = -HALF_LENGTH + BAY * (f64::from(bay) + 0.5);
            arcade_bay(&mut hall, middle, side);
            aisle_vault(&mut hall, middle, side);
            urn(&mut hall, [middle, 0.0, side * 7.2]);
            arch_moulding(
                &mut hall,
                [middle, 2.6, side * (HALF_WIDTH - 0.14)],
                1.0,
                0.12,
            );
            if bay > 0 {
                column(&mut hall, [middle - BAY / 2.0, 0.0, side * ARCADE_MIDDLE]);
            }
        }
        for end in [-1.0, 1.0] {
            let x = end * (HALF_LENGTH - 0.2);
            let (half, z) = ([0.2, 0.45], side * ARCADE_MIDDLE);
            pillar(&mut hall, [x, z], half, 0.0, SPRINGING);
        }
        cornice(&mut hall, side);
        benches(&mut hall, side);
    }
    for x in [-13.0, -5.0, 3.0] {
        chandelier(&mut hall, x);
    }
    sanctuary(&mut hall);
    hall.mesh
}

/// A floor with one quad per square metre, four walls and a roof.
fn shell(hall: &mut Welder) {
    let x = |s: f64| HALF_LENGTH * (2.0 * s - 1.0);
    let z = |t: f64| HALF_WIDTH * (2.0 * t - 1.0);
    hall.surface(40, 16, |s, t| [x(s), 0.0, z(t)]);
    hall.surface(10, 4, |s, t| [x(s), HEIGHT, z(t)]);
    for side in [-1.0, 1.0] {
        hall.surface(40, 7, |s, t| [x(s), HEIGHT * t, side * HALF_WIDTH]);
        hall.surface(16, 7, |s, t| [side * HALF_LENGTH, HEIGHT * t, z(s)]);
    }
}

/// A barrel vault with coffers, and a rib over each pair of columns.
fn nave_vault(hall: &mut Welder) {
    hall.surface(160, 44, |s, t| {
        // Coffers are at the positions where both waves are high.
        let wave = |phase: f64| (1.6 * (TAU * phase).cos()).clamp(-0.5, 0.5) + 0.5;
        let sunk = 0.16 * wave(f64::from(2 * BAYS) * s + 0.5) * wave(11.0 * t + 0.5);
        let edge = (4.0 * (PI * t).sin()).min(1.0);
        let radius = ARCADE_INNER + sunk * edge;
        let (sin, cos) = (PI * t).sin_cos();
        let x = HALF_LENGTH * (2.0 * s - 1.0);
        [x, NAVE_SPRINGING + radius * sin, -radius * cos]
    });
    for bay in 1..BAYS {
        let x = -HALF_LENGTH + BAY * f64::from(bay);
        // Across the rib: down one side, along its face, up the other side.
        let outline = [
            [-0.22, 0.1],
            [-0.22, -0.14],
            [-0.12, -0.22],
            [0.12, -0.22],
            [0.22, -0.14],
            [0.22, 0.1],
        ];
        hall.surface(5, 40, |s, t| {
            let [along, out] = outline[(s * 5.0).round() as usize];
            let (sin, cos) = (PI * t).sin_cos();
            let radius = ARCADE_INNER + out;
            [x + along, NAVE_SPRINGING + radius * sin, -radius * cos]
        });
    }
}

/// The wall of one bay above an arch between two columns, on both its faces, with mouldings.
fn arcade_bay(hall: &mut Welder, middle: f64, side: f64) {
    const STEPS: u32 = 20;
    let arch = |s: f64| {
        let (sin, cos) = (PI * s).sin_cos();
        [middle - ARCH_RADIUS * cos, SPRINGING + ARCH_RADIUS * sin]
    };
    for z in [side * ARCADE_INNER, side * ARCADE_OUTER] {
        // Below the clerestory, vertical strips above the arch, with the piers on both sides.
        let upright = |x: f64, low: f64, t: f64| [x, low + (NAVE_SPRINGING - low) * t, z];
        hall.surface(STEPS, 4, |s, t| {
            let [x, low] = arch(s);
            upright(x, low, t)
        });
        for end in [-1.0, 1.0] {
            hall.surface(1, 4, |s, t| {
                let x = middle + end * (ARCH_RADIUS + s * (BAY / 2.0 - ARCH_RADIUS));
                upright(x, SPRINGING, t)
            });
        }
        let outwards = if z.abs() < ARCADE_MIDDLE { -side } else { side };
        arch_moulding(
            hall,
            [middle, SPRINGING, z + 0.02 * outwards],
            ARCH_RADIUS + 0.2,
            0.09,
        );
    }
    hall.surface(STEPS, 3, |s, t| {
        let [x, y] = arch(s);
        [
            x,
            y,
            side * (ARCADE_INNER + t * (ARCADE_OUTER - ARCADE_INNER)),
        ]
    });
    // The frame and the bars of a round window, in front of the clerestory's wall.
    let centre = [middle, 7.75, side * (ARCADE_INNER - 0.03)];
    ring(hall, centre, [X, Y], 0.75, 0.08, [24, 6]);
    ring(hall, centre, [X, Y], 0.3, 0.05, [16, 5]);
    for spoke in 0..8 {
        let (sin, cos) = (TAU * f64::from(spoke) / 8.0).sin_cos();
        let at = |radius: f64| {
            [
                centre[0] + radius * cos,
                centre[1] + radius * sin,
                centre[2],
            ]
        };
        bar(hall, at(0.31), at(0.72), 0.035);
    }
}

/// Two crossing barrel vaults over one bay of an aisle.
fn aisle_vault(hall: &mut Welder, middle: f64, side: f64) {
    hall.surface(12, 12, |s, t| {
        // Evenly spaced angles resolve the steep feet of the vault.
        let (along, across) = (PI * s, PI * t);
        let x = middle - BAY / 2.0 * along.cos();
        let half = (HALF_WIDTH - ARCADE_OUTER) / 2.0;
        let z = side * (ARCADE_OUTER + half - half * across.cos());
        [x, SPRINGING + 1.75 * along.sin().max(across.sin()), z]
    });
}

/// A fluted column with base and capital, up to the springing of the arches.
fn column(hall: &mut Welder, foot: [f64; 3]) {
    let [x, _, z] = foot;
    pillar(hall, [x, z], [0.52, 0.52], 0.0, 0.25);
    pillar(hall, [x, z], [0.48, 0.46], SPRINGING - 0.25, SPRINGING);
    let base = [
        [0.5, 0.25],
        [0.52, 0.31],
        [0.5, 0.37],
        [0.44, 0.4],
        [0.43, 0.44],
        [0.46, 0.48],
        [0.45, 0.53],
        [0.4, 0.56],
    ];
    lathe(hall, foot, &base, 32, |_| 1.0);
    // Entasis: the shaft is widest a third of the way up.
    let shaft: Vec<[f64; 2]> = (0..=6)
        .map(|i| {
            let t = f64::from(i) / 6.0;
            [
                0.4 - 0.06 * t * t + 0.02 * (PI * t.sqrt()).sin(),
                0.56 + (3.7 - 0.56) * t,
            ]
        })
        .collect();
    // Flutes: every second of 32 lines is deeper.
    lathe(hall, foot, &shaft, 32, |angle| {
        0.965 + 0.035 * (16.0 * angle).cos()
    });
    let capital = [
        [0.34, 3.7],
        [0.37, 3.73],
        [0.37, 3.78],
        [0.34, 3.81],
        [0.35, 3.95],
        [0.38, 4.1],
        [0.44, 4.23],
        [0.47, 4.3],
        [0.45, 4.35],
    ];
    lathe(hall, foot, &capital, 32, |angle| {
        1.0 + 0.02 * (8.0 * angle).cos()
    });
}

/// A band along the base of the nave's vault, and one below the clerestory.
fn cornice(hall: &mut Welder, side: f64) {
    for (y, depth) in [(NAVE_SPRINGING - 0.15, 0.22), (6.55, 0.12)] {
        let outline = [
            [0.0, -0.2],
            [0.5, -0.12],
            [0.6, 0.0],
            [1.0, 0.05],
            [1.0, 0.15],
            [0.0, 0.2],
        ];
        hall.surface(40, 5, |s, t| {
            let [out, up] = outline[(t * 5.0).round() as usize];
            let x = HALF_LENGTH * (2.0 * s - 1.0);
            [x, y + up, side * (ARCADE_INNER + 0.01 - depth * out)]
        });
    }
}

/// Rows of benches on one side of the nave's middle.
fn benches(hall: &mut Welder, side: f64) {
    let middle = side * 2.0;
    for row in 0..15 {
        let x = -9.0 + 1.35 * f64::from(row);
        block(
            hall,
            [x, 0.42, middle - 1.1],
            [x + 0.42, 0.47, middle + 1.1],
        );
        block(
            hall,
            [x + 0.43, 0.3, middle - 1.1],
            [x + 0.48, 0.95, middle + 1.1],
        );
        block(
            hall,
            [x + 0.40, 0.96, middle - 1.12],
            [x + 0.54, 1.0, middle + 1.12],
        );
        for z in [middle - 1.0, middle, middle + 1.0] {
            pillar(hall, [x + 0.21, z], [0.19, 0.03], 0.0, 0.41);
        }
        for z in [middle - 1.13, middle + 1.13] {
            pillar(hall, [x + 0.22, z], [0.28, 0.025], 0.0, 0.94);
        }
    }
}

/// A ring of candles that hangs from a chain.
fn chandelier(hall: &mut Welder, x: f64) {
    let y = 6.4;
    ring(hall, [x, y, 0.0], [X, Z], 1.15, 0.05, [40, 6]);
    ring(hall, [x, y + 0.5, 0.0], [X, Z], 0.5, 0.04, [24, 6]);
    for candle in 0..12 {
        let (sin, cos) = (TAU * f64::from(candle) / 12.0).sin_cos();
        let foot = [x + 1.15 * cos, y + 0.05, 1.15 * sin];
        let profile = [
            [0.0, 0.0],
            [0.08, 0.02],
            [0.1, 0.06],
            [0.03, 0.07],
            [0.03, 0.3],
            [0.01, 0.31],
            [0.018, 0.34],
            [0.0, 0.4],
        ];
        lathe(hall, foot, &profile, 8, |_| 1.0);
        if candle % 3 == 0 {
            bar(
                hall,
                [x + 1.12 * cos, y, 1.12 * sin],
                [x + 0.5 * cos, y + 0.5, 0.5 * sin],
                0.02,
            );
            bar(
                hall,
                [x + 0.5 * cos, y + 0.5, 0.5 * sin],
                [x, y + 1.3, 0.0],
                0.02,
            );
        }
    }
    let (mut link, mut turned) = (y + 1.45, false);
    while link < NAVE_SPRINGING + ARCADE_INNER + 0.1 {
        let across = if turned { X } else { Z };
        let centre = [x, link, 0.0];
        ring(hall, centre, [across, Y], 0.15, 0.025, [12, 5]);
        link += 0.24;
        turned = !turned;
    }
}

/// Steps and a sculpture at one end, below a window's tracery.
fn sanctuary(hall: &mut Welder) {
    for step in 0..4 {
        let (inset, y) = (0.5 * f64::from(step), 0.2 * f64::from(step));
        pillar(hall, [-16.8, 0.0], [2.8 - inset, 3.2 - inset], y, y + 0.2);
    }
    pillar(hall, [-16.8, 0.0], [0.6, 0.6], 0.8, 2.0);
    knot_into(hall, 160, 10, 0.4, |[a, b, c]| {
        [-16.8 + 0.45 * c, 3.45 + 0.45 * a, 0.45 * b]
    });
    let centre = [-HALF_LENGTH + 0.12, 8.6, 0.0];
    for radius in [0.6, 1.6, 2.9] {
        ring(hall, centre, [Z, Y], radius, 0.1, [48, 8]);
    }
    for spoke in 0..16 {
        let (sin, cos) = (TAU * f64::from(spoke) / 16.0).sin_cos();
        let at = |radius: f64| [centre[0], centre[1] + radius * sin, radius * cos];
        bar(hall, at(0.65), at(2.85), 0.05);
        ring(hall, at(2.25), [Z, Y], 0.32, 0.04, [16, 5]);
    }
}

fn urn(hall: &mut Welder, foot: [f64; 3]) {
    pillar(hall, [foot[0], foot[2]], [0.35, 0.35], 0.0, 0.5);
    let profile = [
        [0.0, 0.5],
        [0.2, 0.52],
        [0.18, 0.58],
        [0.1, 0.63],
        [0.1, 0.68],
        [0.22, 0.8],
        [0.31, 0.95],
        [0.34, 1.1],
        [0.3, 1.25],
        [0.2, 1.37],
        [0.17, 1.43],
        [0.19, 1.5],
        [0.26, 1.55],
        [0.24, 1.57],
        [0.15, 1.5],
        [0.1, 1.3],
        [0.0, 1.25],
    ];
    lathe(hall, foot, &profile, 16, |_| 1.0);
}

const X: [f64; 3] = [1.0, 0.0, 0.0];
const Y: [f64; 3] = [0.0, 1.0, 0.0];
const Z: [f64; 3] = [0.0, 0.0, 1.0];

/// An upright half ring along x that stands on its two ends.
fn arch_moulding(hall: &mut Welder, centre: [f64; 3], radius: f64, thickness: f64) {
    hall.surface(6, 20, |s, t| {
        on_ring(centre, [X, Y], radius, thickness, PI * t, TAU * s)
    });
}

/// A torus in the plane of two perpendicular axes, with `counts` segments along and around it.
fn ring(
    hall: &mut Welder,
    centre: [f64; 3],
    axes: [[f64; 3]; 2],
    radius: f64,
    thickness: f64,
    counts: [u32; 2],
) {
    hall.surface(counts[1], counts[0], |s, t| {
        on_ring(centre, axes, radius, thickness, wrap(t), wrap(s))
    });
}

/// A fraction of a turn as an angle; a whole turn gives 0, so ends meet.
fn wrap(turn: f64) -> f64 {
    TAU * turn.rem_euclid(1.0)
}

fn on_ring(
    centre: [f64; 3],
    [a, b]: [[f64; 3]; 2],
    radius: f64,
    thickness: f64,
    along: f64,
    around: f64,
) -> [f64; 3] {
    let out = radius + thickness * around.cos();
    std::array::from_fn(|k| {
        let normal = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
        centre[k]
            + out * (along.cos() * a[k] + along.sin() * b[k])
            + thickness * around.sin() * normal
    })
}

/// A surface of revolution around the vertical axis through `foot`. The profile consists of radii and heights; `radial` scales
/// the radii by the angle.
fn lathe(
    hall: &mut Welder,
    foot: [f64; 3],
    profile: &[[f64; 2]],
    segments: u32,
    radial: impl Fn(f64) -> f64,
) {
    let rows = profile.len() - 1;
    hall.surface(segments, rows as u32, |s, t| {
        let [radius, y] = profile[(t * rows as f64).round() as usize];
        let angle = wrap(s);
        let radius = radius * radial(angle);
        [
            foot[0] + radius * angle.cos(),
            foot[1] + y,
            foot[2] - radius * angle.sin(),
        ]
    });
}

/// A square bar between two points.
fn bar(hall: &mut Welder, from: [f64; 3], to: [f64; 3], half: f64) {
    let along: [f64; 3] = std::array::from_fn(|k| to[k] - from[k]);
    // Two directions perpendicular to the bar: one horizontal, one perpendicular to both.
    let level = if along[0].abs() + along[2].abs() < 1e-9 {
        X
    } else {
        let length = along[0].hypot(along[2]);
        [-along[2] / length, 0.0, along[0] / length]
    };
    let cross: [f64; 3] = std::array::from_fn(|k| {
        level[(k + 1) % 3] * along[(k + 2) % 3] - level[(k + 2) % 3] * along[(k + 1) % 3]
    });
    let length = cross.iter().map(|x| x * x).sum::<f64>().sqrt();
    hall.surface(4, 1, |s, t| {
        let (sin, cos) = wrap(s).sin_cos();
        std::array::from_fn(|k| {
            from[k] + t * along[k] + half * (cos * level[k] + sin * cross[k] / length)
        })
    });
}

/// A box with an open bottom, for boxes that stand on another surface. `half` are its half extents along x and z.
fn pillar(hall: &mut Welder, [x, z]: [f64; 2], half: [f64; 2], low: f64, high: f64) {
    let corner = |turn: f64, y: f64| {
        let angle = FRAC_PI_2 * (turn * 4.0).round() + FRAC_PI_2 / 2.0;
        [
            x + half[0] * angle.cos().signum(),
            y,
            z + half[1] * angle.sin().signum(),
        ]
    };
    hall.surface(4, 1, |s, t| corner(s, low + (high - low) * t));
    hall.quad([0.0, 0.25, 0.5, 0.75].map(|turn| corner(turn, high)));
}

/// A closed box.
fn block(hall: &mut Welder, low: [f64; 3], high: [f64; 3]) {
    let (centre, half) = (
        [(low[0] + high[0]) / 2.0, (low[2] + high[2]) / 2.0],
        [(high[0] - low[0]) / 2.0, (high[2] - low[2]) / 2.0],
    );
    pillar(hall, centre, half, low[1], high[1]);
    hall.quad([
        [low[0], low[1], low[2]],
        [high[0], low[1], low[2]],
        [high[0], low[1], high[2]],
        [low[0], low[1], high[2]],
    ]);
}
