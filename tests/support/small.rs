//! Tiny scenes with many ties, random trees, and rays near corner cases, for the comparison of
//! traversal with brute force.

pub use super::{full, seed};
use dynrt::bkd::{BuildOptions, Child, MemoryImage, Tree, TreeNode, build};
use dynrt::config::TriangleTest;
use dynrt::float::{Arithmetic, Format};
use dynrt::port::{Hit, Ray};
use fastrand::Rng;

pub const TESTS: [TriangleTest; 2] = [TriangleTest::MollerTrumbore, TriangleTest::Watertight];
pub const PACKETS: [usize; 4] = [1, 2, 4, 8];
/// Maximum depth of a tree in the tests.
pub const MOST_DEEP: u32 = 64;

/// A mesh whose vertices are values of the format.
pub struct Mesh {
    pub format: Format,
    pub vertices: Vec<[f64; 3]>,
    pub triangles: Vec<[u32; 3]>,
}

impl Mesh {
    pub fn rounded(format: Format, corners: &[[[f64; 3]; 3]]) -> Mesh {
        let a = Arithmetic::new(format);
        let greatest = format.to_f64(format.greatest());
        let round = |x: f64| a.round(x).clamp(-greatest, greatest);
        Mesh {
            format,
            vertices: corners.iter().flatten().map(|v| v.map(round)).collect(),
            triangles: (0..corners.len() as u32)
                .map(|t| [3 * t, 3 * t + 1, 3 * t + 2])
                .collect(),
        }
    }

    pub fn image(&self, tree: &Tree) -> MemoryImage {
        let image = MemoryImage::new(self.format, &self.vertices, &self.triangles, tree)
            .expect("a small scene fits");
        image
            .check(self.triangles.len() as u32)
            .expect("the image is sound");
        image
    }
}

/// A random tree: triangles divided at random, axes at random.
pub fn random_tree(triangles: usize, rng: &mut Rng) -> Tree {
    fn divide(numbers: &mut [u32], nodes: &mut Vec<TreeNode>, rng: &mut Rng) -> Child {
        if let [number] = numbers {
            return Child::Leaf(*number);
        }
        rng.shuffle(numbers);
        let (left, right) = numbers.split_at_mut(rng.usize(1..numbers.len()));
        let children = [divide(left, nodes, rng), divide(right, nodes, rng)];
        nodes.push(TreeNode {
            children,
            axes: [rng.u8(0..3), rng.u8(0..3)],
        });
        Child::Inner(nodes.len() as u32 - 1)
    }
    let mut numbers: Vec<u32> = (0..triangles as u32).collect();
    let mut nodes = Vec::new();
    let root = divide(&mut numbers, &mut nodes, rng);
    Tree { nodes, root }
}

/// One of the builder's three trees, or a random one.
pub fn some_tree(mesh: &Mesh, kind: usize, rng: &mut Rng) -> Tree {
    let options = match kind {
        0 => BuildOptions::plain(MOST_DEEP),
        1 => BuildOptions::region(MOST_DEEP),
        2 => BuildOptions::default_for(1, MOST_DEEP),
        3 => BuildOptions::default_for(2, MOST_DEEP),
        _ => return random_tree(mesh.triangles.len(), rng),
    };
    build(&mesh.vertices, &mesh.triangles, &options).expect("a small scene can be built")
}

pub fn one_of<T: Copy>(rng: &mut Rng, choices: &[T]) -> T {
    choices[rng.usize(..choices.len())]
}

pub fn between(rng: &mut Rng, lo: f64, hi: f64) -> f64 {
    lo + (hi - lo) * rng.f64()
}

/// The kinds of small scenes; each batch creates a new scene.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Kind {
    /// Random triangles in a cube.
    Soup,
    /// The two halves of axis-aligned rectangles on a grid: all boxes are flat.
    Rectangles,
    /// Triangles much longer than wide, down to a few ulps.
    Slivers,
    /// All coordinates in −2 … 2: many shared planes, vertices and equal distances.
    Grid,
    /// All triangles in one axis-aligned plane, on top of each other: the scene's box is flat, and distances are equal.
    Pancake,
    /// Triangles far apart along an axis, so that limits separate them.
    Row,
    /// Half of the triangles are points, lines or equal pairs; the other half are repeated with other numbers.
    Degenerate,
    /// Coordinates over the format's whole range, from zero to the greatest number.
    Extreme,
}

pub const KINDS: [Kind; 8] = [
    Kind::Soup,
    Kind::Rectangles,
    Kind::Slivers,
    Kind::Grid,
    Kind::Pancake,
    Kind::Row,
    Kind::Degenerate,
    Kind::Extreme,
];

pub fn some_mesh(kind: Kind, format: Format, rng: &mut Rng) -> Mesh {
    let count = rng.usize(1..=20);
    // A magnitude whose differences a small format can represent.
    let size = (f64::from(format.bias()) / 2.0).min(3.0).exp2();
    let grid = |rng: &mut Rng| f64::from(rng.i32(-2..=2));
    let anywhere = |rng: &mut Rng| [0; 3].map(|_| between(rng, -size, size));
    let mut corners: Vec<[[f64; 3]; 3]> = Vec::new();
    while corners.len() < count {
        match kind {
            Kind::Soup => corners.push([0; 3].map(|_| anywhere(rng))),
            Kind::Rectangles => {
                let axis = rng.usize(..3);
                let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
                let (height, lo, hi) = (grid(rng), [grid(rng), grid(rng)], [grid(rng), grid(rng)]);
                let at = |x, y| {
                    let mut corner = [height; 3];
                    (corner[b], corner[c]) = (x, y);
                    corner
                };
                let [p, q, r, s] = [
                    at(lo[0], lo[1]),
                    at(hi[0], lo[1]),
                    at(hi[0], hi[1]),
                    at(lo[0], hi[1]),
                ];
                corners.push([p, q, r]);
                corners.push([p, r, s]);
            }
            Kind::Slivers => {
                let (p, q) = (anywhere(rng), anywhere(rng));
                let part = rng.f64();
                let width = (-between(rng, 2.0, f64::from(format.fraction_bits()) + 1.0)).exp2();
                let r = [0, 1, 2]
                    .map(|i| p[i] + part * (q[i] - p[i]) + size * width * between(rng, -1.0, 1.0));
                corners.push([p, q, r]);
            }
            Kind::Grid => corners.push([0; 3].map(|_| [0; 3].map(|_| grid(rng)))),
            Kind::Pancake => {
                let mut triangle = [0; 3].map(|_| [0; 3].map(|_| grid(rng)));
                for corner in &mut triangle {
                    corner[count % 3] = 1.0;
                }
                corners.push(triangle);
            }
            Kind::Row => {
                let place = size * between(rng, -4.0, 4.0);
                let mut triangle = [0; 3].map(|_| anywhere(rng));
                for corner in &mut triangle {
                    corner[count % 3] = corner[count % 3] / 4.0 + place;
                }
                corners.push(triangle);
            }
            Kind::Degenerate => {
                let mut triangle = [0; 3].map(|_| [0; 3].map(|_| grid(rng)));
                match rng.u8(..4) {
                    0 => triangle[1] = triangle[rng.usize(..3)],
                    1 => {
                        let axis = rng.usize(..3);
                        for other in [(axis + 1) % 3, (axis + 2) % 3] {
                            triangle = triangle.map(|mut corner| {
                                corner[other] = 0.0;
                                corner
                            });
                        }
                    }
                    2 => triangle[2] = [0, 1, 2].map(|i| 2.0 * triangle[1][i] - triangle[0][i]),
                    _ => {
                        triangle = corners.get(count % 3).copied().unwrap_or(triangle);
                        triangle.rotate_left(rng.usize(..3));
                    }
                }
                corners.push(triangle);
            }
            Kind::Extreme => {
                let reach = f64::from(format.bias());
                let number = |rng: &mut Rng| match rng.u8(..8) {
                    0 => 0.0,
                    1 => -1.0,
                    _ => between(rng, -2.0, 2.0) * between(rng, -reach, reach).exp2(),
                };
                corners.push([0; 3].map(|_| [0; 3].map(|_| number(rng))));
            }
        }
    }
    Mesh::rounded(format, &corners)
}

pub fn some_ray(mesh: &Mesh, rng: &mut Rng) -> Ray {
    let a = Arithmetic::new(mesh.format);
    let format = mesh.format;
    let size = (f64::from(format.bias()) / 2.0).min(3.0).exp2();
    let corner = |rng: &mut Rng| mesh.vertices[rng.usize(..mesh.vertices.len())];
    let on_triangle = |rng: &mut Rng| {
        let [p, q, r] =
            mesh.triangles[rng.usize(..mesh.triangles.len())].map(|v| mesh.vertices[v as usize]);
        // Vertices, edges and the inside, in equal shares.
        let (mut u, mut v) = (rng.f64(), rng.f64());
        match rng.u8(..3) {
            0 => (u, v) = one_of(rng, &[(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]),
            1 => v = one_of(rng, &[0.0, 1.0 - u]),
            _ if u + v > 1.0 => (u, v) = (1.0 - u, 1.0 - v),
            _ => {}
        }
        [0, 1, 2].map(|i| p[i] + u * (q[i] - p[i]) + v * (r[i] - p[i]))
    };
    let mut origin = match rng.u8(..6) {
        0 => corner(rng),
        1 => [0; 3].map(|_| f64::from(rng.i32(-3..=3))),
        2 => on_triangle(rng),
        _ => [0; 3].map(|_| between(rng, -2.0 * size, 2.0 * size)),
    };
    origin = origin.map(|x| a.round(x));
    let mut direction = match rng.u8(..8) {
        0 => {
            let mut direction = [0; 3].map(|_| one_of(rng, &[0.0, -0.0]));
            direction[rng.usize(..3)] = one_of(rng, &[1.0, -1.0, 0.5, -2.0]);
            direction
        }
        1 => [0; 3].map(|_| f64::from(rng.i32(-2..=2))),
        2 => [0; 3].map(|_| between(rng, -1.0, 1.0)),
        _ => {
            let target = on_triangle(rng);
            let length = one_of(rng, &[1.0, 1.0, 0.125, 4.0]);
            [0, 1, 2].map(|i| length * (target[i] - origin[i]))
        }
    };
    direction = direction.map(|x| a.round(x));
    if rng.u8(..8) == 0 {
        // In a plane of some box.
        let axis = rng.usize(..3);
        origin[axis] = corner(rng)[axis];
        direction[axis] = one_of(rng, &[0.0, -0.0]);
    }
    if rng.u8(..16) == 0 {
        let least = format.to_f64(format.least_normal());
        let greatest = format.to_f64(format.greatest());
        let odd = [
            0.0,
            -0.0,
            f64::INFINITY,
            f64::NEG_INFINITY,
            least,
            -least,
            greatest,
            -greatest,
        ];
        let odd = if rng.u8(..8) == 0 {
            f64::NAN
        } else {
            one_of(rng, &odd)
        };
        let place = rng.usize(..6);
        if place < 3 {
            origin[place] = odd;
        } else {
            direction[place - 3] = odd;
        }
    }
    let (mut tmin, mut tmax) = (0.0, f64::INFINITY);
    match rng.u8(..8) {
        0 => tmin = between(rng, 0.0, 2.0),
        1 => tmax = between(rng, 0.0, 2.0),
        2 => {
            tmin = between(rng, 0.0, 1.5);
            tmax = tmin + between(rng, 0.0, 1.0);
        }
        // The distance of the target.
        3 => (tmin, tmax) = one_of(rng, &[(1.0, 1.0), (1.0, f64::INFINITY), (0.0, 1.0)]),
        4 if rng.u8(..8) == 0 => {
            let odd = [
                -0.0,
                0.0,
                -1.0,
                1.0,
                f64::NAN,
                f64::INFINITY,
                f64::NEG_INFINITY,
            ];
            (tmin, tmax) = (one_of(rng, &odd), one_of(rng, &odd));
        }
        _ => {}
    }
    let minus_zero = tmin == 0.0 && tmin.is_sign_negative();
    Ray {
        origin,
        direction,
        tmin: if minus_zero { -0.0 } else { a.round(tmin) },
        tmax: a.round(tmax),
        active: rng.u8(..64) != 0,
        any_hit: rng.u8(..4) == 0,
    }
}

pub fn check_same(
    what: impl Fn() -> String,
    format: Format,
    rays: &[Ray],
    got: &[Hit],
    want: &[Hit],
) {
    assert_eq!(got.len(), want.len());
    for ((ray, got), want) in rays.iter().zip(got).zip(want) {
        assert!(
            got.same_bits(want, format),
            "{}: {ray:?}\ntraversal   {got:?}\nbrute force {want:?}",
            what()
        );
    }
}
