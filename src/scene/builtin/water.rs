//! Open water: a sheet with travelling waves.

use super::super::Mesh;
use super::super::animation::{Animated, Clip, Kind, Writer};
use super::snap;
use std::f64::consts::TAU;

/// The period of all waves in seconds.
const PERIOD: f64 = 4.0;

/// The sheet's half width.
const HALF_WIDTH: f64 = 2.0;

/// Trochoidal waves: direction of travel in degrees from +x towards +z, length, height above
/// the mean, number of passes per period, and initial phase in turns. The sum of height × 2π / length is less than
/// 1, so no crest curls over.
const WAVES: [(f64, f64, f64, f64, f64); 6] = [
    (20.0, 2.60, 0.085, 3.0, 0.00),
    (-35.0, 1.70, 0.045, 4.0, 0.31),
    (75.0, 1.10, 0.027, 5.0, 0.62),
    (-80.0, 0.75, 0.015, 6.0, 0.17),
    (5.0, 0.48, 0.009, 8.0, 0.84),
    (130.0, 0.36, 0.006, 9.0, 0.45),
];

pub fn animated(resolution: u32) -> Animated {
    let at = |column: u32, row: u32| row * (resolution + 1) + column;
    let mut mesh = Mesh {
        positions: surface(resolution, 0.0),
        triangles: Vec::with_capacity(2 * (resolution * resolution) as usize),
    };
    for row in 0..resolution {
        for column in 0..resolution {
            let [a, b] = [at(column, row), at(column + 1, row)];
            let [d, c] = [at(column, row + 1), at(column + 1, row + 1)];
            // Seen from above, corners run counter-clockwise.
            mesh.triangles.extend([[a, c, b], [a, d, c]]);
        }
    }
    let writer = Writer::Formula {
        formula: surface,
        detail: resolution,
    };
    let mut animated = Animated::single("water".into(), mesh, Kind::Procedural, writer);
    animated.clips.push(Clip {
        name: "waves".into(),
        seconds: PERIOD,
    });
    animated
}

/// The vertices of the sheet at a time, row by row.
pub fn surface(resolution: u32, seconds: f64) -> Vec<[f64; 3]> {
    let seconds = seconds.clamp(0.0, PERIOD);
    let waves = WAVES.map(|(degrees, length, height, passes, start)| {
        let (sin, cos) = degrees.to_radians().sin_cos();
        let turned = (passes * seconds / PERIOD + start).fract();
        (cos, sin, TAU / length, height, TAU * turned)
    });
    let along = |i: u32| HALF_WIDTH * (2.0 * f64::from(i) / f64::from(resolution) - 1.0);
    let mut positions = Vec::with_capacity(((resolution + 1) as usize).pow(2));
    for row in 0..=resolution {
        for column in 0..=resolution {
            let (x, z) = (along(column), along(row));
            let mut position = [x, 0.0, z];
            for (towards_x, towards_z, number, height, phase) in waves {
                // Water moves in circles, which sharpens crests and widens troughs.
                let (sin, cos) = (number * (towards_x * x + towards_z * z) - phase).sin_cos();
                position[0] -= height * towards_x * sin;
                position[1] += height * cos;
                position[2] -= height * towards_z * sin;
            }
            positions.push(position.map(snap));
        }
    }
    positions
}
