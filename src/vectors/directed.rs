//! Vectors that a frame may not contain: rays of all kinds, and transactions with many ties and special values.
//! The same machine and frame give the same vectors.

use super::collect::{Collector, Packet};
use super::sheet::UnitSheets;
use crate::bkd::layout::{LinkWord, Node};
use crate::config::TriangleTest;
use crate::float::{Arithmetic, specials};
use crate::golden::lanes::RayLanes;
use crate::golden::raycast::RaySet;
use crate::golden::tpu::Lanes;
use crate::golden::{RaySetup, Triangle, WHOLE_LINE};
use crate::port::{Hit, Ray};
use anyhow::Result;

/// Number of directed transactions per unit.
const TRANSACTIONS: usize = 500;
/// Number of second operands per special operand.
const PARTNERS: usize = 4;

/// Derives a ray from a ray of the frame and its hit.
type Variant = fn(&Arithmetic, &Ray, &Hit) -> Ray;

/// The variants of a ray that are written in addition to the rays of the frame.
const VARIANTS: &[(&str, Variant)] = &[
    ("as in the picture", |_, ray, _| *ray),
    ("any hit", |_, ray, _| Ray {
        any_hit: true,
        ..*ray
    }),
    // The interval of distances is closed: a hit at tmin or tmax counts, a hit one ulp beyond does not.
    ("tmax at the hit", |_, ray, hit| Ray {
        tmax: hit.t,
        ..*ray
    }),
    ("tmax before the hit", |a, ray, hit| Ray {
        tmax: a.step(hit.t, -1),
        ..*ray
    }),
    ("any hit, tmax before the hit", |a, ray, hit| Ray {
        any_hit: true,
        tmax: a.step(hit.t, -1),
        ..*ray
    }),
    ("tmin at the hit", |_, ray, hit| Ray {
        tmin: hit.t,
        ..*ray
    }),
    ("tmin beyond the hit", |a, ray, hit| Ray {
        tmin: a.step(hit.t, 1),
        ..*ray
    }),
    ("any hit, tmin and tmax at the hit", |_, ray, hit| Ray {
        any_hit: true,
        tmin: hit.t,
        tmax: hit.t,
        ..*ray
    }),
    // Limits with which a ray misses, and zeros of both signs.
    ("tmin above tmax", |_, ray, _| Ray {
        tmin: 2.0,
        tmax: 1.0,
        ..*ray
    }),
    ("tmin negative", |_, ray, _| Ray { tmin: -1.0, ..*ray }),
    ("tmin -0", |_, ray, _| Ray { tmin: -0.0, ..*ray }),
    ("tmin and tmax -0", |_, ray, _| Ray {
        tmin: -0.0,
        tmax: -0.0,
        ..*ray
    }),
    ("tmin infinite", |_, ray, _| Ray {
        tmin: f64::INFINITY,
        ..*ray
    }),
    ("inactive", |_, ray, _| Ray {
        active: false,
        ..*ray
    }),
    // NaNs, zeros and infinities.
    ("tmin NaN", |_, ray, _| Ray {
        tmin: f64::NAN,
        ..*ray
    }),
    ("tmax NaN", |_, ray, _| Ray {
        tmax: f64::NAN,
        ..*ray
    }),
    ("origin NaN", |_, ray, _| Ray {
        origin: with(ray.origin, 1, f64::NAN),
        ..*ray
    }),
    ("origin infinite", |_, ray, _| Ray {
        origin: with(ray.origin, 2, f64::INFINITY),
        ..*ray
    }),
    ("direction NaN", |_, ray, _| Ray {
        direction: with(ray.direction, 0, f64::NAN),
        ..*ray
    }),
    ("direction 0 on an axis", |_, ray, _| Ray {
        direction: with(ray.direction, 0, 0.0),
        ..*ray
    }),
    ("direction -0 on an axis", |_, ray, _| Ray {
        direction: with(ray.direction, 1, -0.0),
        ..*ray
    }),
    ("direction infinite on an axis", |_, ray, _| Ray {
        direction: with(ray.direction, 2, f64::NEG_INFINITY),
        ..*ray
    }),
    ("direction 0", |_, ray, _| Ray {
        direction: [0.0; 3],
        ..*ray
    }),
    // Valid, because no component is a NaN. On this axis the ray is not clipped. In object space it is a NaN and must not enter.
    ("origin and direction infinite on an axis", |_, ray, _| {
        Ray {
            origin: with(ray.origin, 0, f64::INFINITY),
            direction: with(ray.direction, 0, f64::INFINITY),
            ..*ray
        }
    }),
];

fn with(mut vector: [f64; 3], axis: usize, component: f64) -> [f64; 3] {
    vector[axis] = component;
    vector
}

/// Packets of variants of one packet's rays. Each ray appears once in each kind, and each packet mixes kinds.
pub fn variants(a: &Arithmetic, rays: &[Ray], hits: &[Hit]) -> Vec<Packet> {
    let packet = |first: usize| {
        let kind = |k: usize| VARIANTS[(first + k) % VARIANTS.len()];
        let of = rays.iter().zip(hits).enumerate();
        Packet {
            scene: 0,
            block: None,
            label: "variants",
            rays: of.map(|(k, (ray, hit))| kind(k).1(a, ray, hit)).collect(),
            kinds: (0..rays.len()).map(|k| kind(k).0).collect(),
        }
    };
    (0..VARIANTS.len()).map(packet).collect()
}

/// Random values on a coarse grid, which produces many ties.
struct Grid {
    rng: fastrand::Rng,
    arithmetic: Arithmetic,
}

impl Grid {
    fn number(&mut self) -> f64 {
        self.arithmetic.round(f64::from(self.rng.i32(-4..=4)) / 2.0)
    }

    fn vector(&mut self) -> [f64; 3] {
        std::array::from_fn(|_| self.number())
    }

    fn one_of<T: Copy>(&mut self, values: &[T]) -> T {
        values[self.rng.usize(..values.len())]
    }

    /// A valid ray, directed at `target` if there is one.
    fn ray(&mut self, target: Option<[f64; 3]>) -> Ray {
        let origin = self.vector();
        let mut direction = match target {
            Some(target) => std::array::from_fn(|i| self.arithmetic.sub(target[i], origin[i])),
            None => self.vector(),
        };
        for component in &mut direction {
            if *component == 0.0 && self.rng.bool() {
                *component = -0.0;
            }
        }
        Ray {
            origin,
            direction,
            tmin: self.one_of(&[0.0, 0.0, 0.0, 0.5, 1.0]),
            tmax: self.one_of(&[1.0, 2.0, f64::INFINITY, f64::INFINITY]),
            active: true,
            any_hit: false,
        }
    }
}

/// Writes ray setups with special values, and triangle tests and packet steps with many ties.
///
/// # Errors
/// One line that names a file that cannot be written.
pub fn transactions(collector: &mut Collector<'_>) -> Result<()> {
    let mut grid = Grid {
        rng: fastrand::Rng::with_seed(1),
        arithmetic: collector.arithmetic,
    };
    let format = collector.shape.format;
    let special: Vec<f64> = specials(format).iter().map(|&b| format.to_f64(b)).collect();
    collector.setup.begin("directed: special values");
    collector.test.begin("directed: coarse grid");
    collector.step.begin("directed: coarse grid");
    for _ in 0..TRANSACTIONS {
        let mut ray = grid.ray(None);
        for place in 0..8 {
            if grid.rng.u8(..4) > 0 {
                continue;
            }
            let number = grid.one_of(&special);
            match place {
                0..3 => ray.origin[place] = number,
                3..6 => ray.direction[place - 3] = number,
                6 => ray.tmin = number,
                _ => ray.tmax = number,
            }
        }
        ray.active = grid.rng.u8(..16) > 0;
        ray.any_hit = grid.rng.bool();
        collector.set_up(&ray)?;
    }
    for _ in 0..TRANSACTIONS {
        triangle_test(collector, &mut grid)?;
    }
    collector.test.begin("directed: t would be infinite");
    search(collector, &mut grid, endless)?;
    collector.test.begin("directed: box flat on two axes");
    search(collector, &mut grid, flat)?;
    for _ in 0..TRANSACTIONS {
        match collector.shape.rays {
            1 => packet_step::<1>(collector, &mut grid)?,
            2 => packet_step::<2>(collector, &mut grid)?,
            4 => packet_step::<4>(collector, &mut grid)?,
            _ => packet_step::<8>(collector, &mut grid)?,
        }
    }
    Ok(())
}

fn triangle_test(collector: &mut Collector<'_>, grid: &mut Grid) -> Result<()> {
    let a = collector.arithmetic;
    let vertices: [[f64; 3]; 3] = std::array::from_fn(|_| grid.vector());
    // The ray is aimed at nothing, at a corner, at the middle of an edge, or at the inside of the triangle.
    let [v0, v1, v2] = vertices;
    let between = |p: [f64; 3], q: [f64; 3]| std::array::from_fn(|i| a.round((p[i] + q[i]) / 2.0));
    let target = match grid.rng.u8(..6) {
        0 => None,
        1 => Some(v2),
        2 => Some(between(v0, v1)),
        _ => Some(between(between(v0, v1), v2)),
    };
    let ray = grid.ray(target);
    let setup = RaySetup::new(&a, &ray);
    let window = match grid.rng.u8(..4) {
        0 => [
            grid.one_of(&[f64::NEG_INFINITY, 0.0, 0.5, 1.0]),
            grid.one_of(&[0.5, 1.0, 2.0, f64::INFINITY]),
        ],
        _ => WHOLE_LINE,
    };
    let outcome =
        Triangle::new(vertices, 0).intersect::<true>(&a, collector.shape.test, &setup, window);
    collector.test((0, 0), &vertices, (&setup, window), &outcome)
}

/// The maximum number of tests per kind that a search writes, and the number of candidates that it tries.
const FOUND: usize = 32;
const TRIED: usize = 20_000;

/// Three vertices and a ray.
type Candidate = ([[f64; 3]; 3], Ray);

/// Writes tests that would hit if one rule did not exist. There are none in some formats, and none for a rule that the test implies.
fn search(
    collector: &mut Collector<'_>,
    grid: &mut Grid,
    kind: fn(&mut Grid) -> (Candidate, Rule),
) -> Result<()> {
    let a = collector.arithmetic;
    let test = collector.shape.test;
    let mut found = 0;
    for _ in 0..TRIED {
        let ((vertices, ray), rule) = kind(grid);
        let setup = RaySetup::new(&a, &ray);
        let triangle = Triangle::new(vertices, 0);
        let outcome = triangle.intersect::<true>(&a, test, &setup, WHOLE_LINE);
        if setup.valid && !outcome.hit && hits_without(&a, test, &triangle, &setup, rule) {
            collector.test((0, 0), &vertices, (&setup, WHOLE_LINE), &outcome)?;
            found += 1;
            if found == FOUND {
                break;
            }
        }
    }
    Ok(())
}

/// A rule of the triangle test.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// t < ∞.
    Finite,
    /// A box with lo_i = hi_i on two axes is degenerate.
    FlatBox,
}

/// Whether a ray hits a triangle if one rule is ignored.
fn hits_without(
    a: &Arithmetic,
    test: TriangleTest,
    triangle: &Triangle,
    ray: &RaySetup,
    rule: Rule,
) -> bool {
    let [v0, v1, v2] = triangle.vertices;
    let equal = v0 == v1 || v1 == v2 || v2 == v0;
    let triangle = Triangle {
        degenerate: equal || triangle.degenerate && rule != Rule::FlatBox,
        ..*triangle
    };
    let outcome = triangle.intersect::<true>(a, test, ray, WHOLE_LINE);
    if rule != Rule::Finite {
        return outcome.hit;
    }
    let (inside, _) = match test {
        TriangleTest::MollerTrumbore => triangle.moller_trumbore::<true>(a, ray),
        TriangleTest::Watertight => triangle.watertight::<true>(a, ray),
    };
    inside
        && !triangle.degenerate
        && outcome.near <= outcome.far
        && !outcome.raw[0].is_nan()
        && ray.tmin <= outcome.t
        && outcome.t <= ray.tmax
}

/// A ray with such a short direction that t of the triangle in front of it is infinite.
fn endless(grid: &mut Grid) -> (Candidate, Rule) {
    let a = grid.arithmetic;
    let vertices: [[f64; 3]; 3] = std::array::from_fn(|_| grid.vector());
    let weights = [0.25, 0.25, 0.5];
    let target: [f64; 3] =
        std::array::from_fn(|i| (0..3).map(|k| weights[k] * vertices[k][i]).sum());
    let towards: [f64; 3] = std::array::from_fn(|_| f64::from(grid.rng.i32(-2..=2)));
    let far = f64::from(grid.rng.u32(1..=4));
    let short = 2f64.powi(grid.rng.i32(1..=3) - a.format().bias());
    let ray = Ray {
        origin: std::array::from_fn(|i| a.round(target[i] - far * towards[i])),
        direction: towards.map(|x| a.round(short * x)),
        tmin: 0.0,
        tmax: f64::INFINITY,
        active: true,
        any_hit: false,
    };
    ((vertices, ray), Rule::Finite)
}

/// A triangle that is a line parallel to an axis, and a ray of about the same direction that meets it.
fn flat(grid: &mut Grid) -> (Candidate, Rule) {
    let a = grid.arithmetic;
    let axis = grid.rng.usize(..3);
    let mut anywhere = || a.round(4.0 * grid.rng.f64() - 2.0);
    let base: [f64; 3] = std::array::from_fn(|_| anywhere());
    let vertices: [[f64; 3]; 3] = std::array::from_fn(|_| with(base, axis, anywhere()));
    let target = with(base, axis, (vertices[0][axis] + vertices[1][axis]) / 2.0);
    let direction: [f64; 3] = std::array::from_fn(|i| match i == axis {
        true => 1.0,
        false => anywhere() / 4.0,
    });
    let direction = direction.map(|x| a.round(x));
    let ray = Ray {
        origin: std::array::from_fn(|i| a.round(target[i] - 4.0 * direction[i])),
        direction,
        tmin: 0.0,
        tmax: f64::INFINITY,
        active: true,
        any_hit: false,
    };
    ((vertices, ray), Rule::FlatBox)
}

fn packet_step<const N: usize>(collector: &mut Collector<'_>, grid: &mut Grid) -> Result<()> {
    let a = collector.arithmetic;
    let setups: [RaySetup; N] = std::array::from_fn(|_| RaySetup::new(&a, &grid.ray(None)));
    let mut interval = || {
        let (p, q) = (grid.number(), grid.number());
        if p < q { [p, q] } else { [q, p] }
    };
    let (left, right) = (interval(), interval());
    let left_axis = grid.rng.u8(..3);
    let right_axis = match collector.shape.axes_per_node {
        1 => left_axis,
        _ => grid.rng.u8(..3),
    };
    let node = Node {
        left,
        right,
        link: LinkWord {
            link: grid.rng.u32(..(1 << collector.shape.address_bits) - 1),
            left_leaf: grid.rng.bool(),
            right_leaf: grid.rng.bool(),
            left_axis,
            right_axis,
        },
    };
    let index = grid.rng.u32(..1 << collector.shape.address_bits);
    let mut come = Lanes {
        mask: grid.rng.u8(1..=collector.shape.all()),
        near: [0.0; N],
        far: [0.0; N],
    };
    for k in 0..N {
        come.near[k] = grid.one_of(&[0.0, 0.0, 0.5, 1.0]);
        come.far[k] = grid.one_of(&[1.0, 2.0, 8.0, f64::INFINITY]);
    }
    let outcome = come.step(
        &a,
        &RayLanes::new(&setups),
        [node.left, node.right],
        [node.link.left_axis, node.link.right_axis].map(usize::from),
    );
    collector.step(
        (index, &node),
        &setups,
        &RaySet::from(&come),
        (
            &RaySet::from(&outcome.left),
            &RaySet::from(&outcome.right),
            outcome.left_first,
        ),
    )
}

/// An operation on numbers.
pub enum Operation {
    Unary(fn(&Arithmetic, f64) -> f64),
    Binary(fn(&Arithmetic, f64, f64) -> f64),
}

/// Writes the lines of an arithmetic unit: every special operand, with several second operands if there are two, then the operands of the frame.
///
/// # Errors
/// One line that names a file that cannot be written.
pub fn arithmetic(
    collector: &Collector<'_>,
    sheets: &mut UnitSheets,
    operation: &Operation,
    of_frame: &[[f64; 2]],
) -> Result<()> {
    let a = &collector.arithmetic;
    let format = collector.shape.format;
    let special = specials(format);
    let result = |operands: [u64; 2]| {
        let [x, y] = operands.map(|bits| format.to_f64(bits));
        format.to_bits(match operation {
            Operation::Unary(f) => f(a, x),
            Operation::Binary(f) => f(a, x, y),
        })
    };
    let count = match operation {
        Operation::Unary(_) => 1,
        Operation::Binary(_) => 2,
    };
    sheets.begin("directed: special operands");
    let mut push =
        |operands: [u64; 2]| sheets.push(&operands[..count], &[(result(operands), true)]);
    let mut rng = fastrand::Rng::with_seed(2);
    for &x in &special {
        match operation {
            Operation::Unary(_) => push([x, 0])?,
            Operation::Binary(_) => {
                for _ in 0..PARTNERS {
                    push([x, special[rng.usize(..special.len())]])?;
                }
            }
        }
    }
    sheets.begin("operands of packets");
    for operands in of_frame {
        let operands = operands.map(|number| format.to_bits(number));
        sheets.push(&operands[..count], &[(result(operands), true)])?;
    }
    Ok(())
}
