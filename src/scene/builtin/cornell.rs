//! The Cornell box, from Cornell University's published measurements, in millimetres, rotated by 180°
//! around the vertical axis: its open front faces +z, as in other scenes.

use super::{Mesh, Welder, snap};

/// Floor, ceiling, three walls (the front is open) and two blocks on the floor without bottom faces. The ceiling has a
/// hole for the light, so no two faces overlap.
pub fn mesh() -> Mesh {
    let mut scene = Welder::default();
    let floor = [
        [552.8, 0.0, 0.0],
        [0.0, 0.0, 0.0],
        [0.0, 0.0, 559.2],
        [549.6, 0.0, 559.2],
    ];
    let ceiling = [
        [556.0, 548.8, 0.0],
        [0.0, 548.8, 0.0],
        [0.0, 548.8, 559.2],
        [556.0, 548.8, 559.2],
    ];
    let light = [
        [343.0, 548.8, 227.0],
        [213.0, 548.8, 227.0],
        [213.0, 548.8, 332.0],
        [343.0, 548.8, 332.0],
    ];
    scene.quad(floor);
    for i in 0..4 {
        let j = (i + 1) % 4;
        scene.quad([ceiling[i], light[i], light[j], ceiling[j]]);
    }
    scene.quad([light[0], light[3], light[2], light[1]]);
    // Back, right (green) and left (red).
    for (i, j) in [(2, 3), (1, 2), (3, 0)] {
        scene.quad([floor[i], ceiling[i], ceiling[j], floor[j]]);
    }
    let short = [[130.0, 65.0], [82.0, 225.0], [240.0, 272.0], [290.0, 114.0]];
    let tall = [
        [423.0, 247.0],
        [265.0, 296.0],
        [314.0, 456.0],
        [472.0, 406.0],
    ];
    for (outline, height) in [(short, 165.0), (tall, 330.0)] {
        let at = |i: usize, y: f64| [outline[i % 4][0], y, outline[i % 4][1]];
        scene.quad([0, 1, 2, 3].map(|i| at(i, height)));
        for i in 0..4 {
            scene.quad([at(i, 0.0), at(i, height), at(i + 1, height), at(i + 1, 0.0)]);
        }
    }
    for [x, _, z] in &mut scene.mesh.positions {
        (*x, *z) = (snap(556.0 - *x), snap(559.2 - *z));
    }
    scene.mesh
}
