//! An independent intersector in plain `f64`, without the machine's arithmetic, boxes or trees, and
//! an account of the pixels in which the machine sees another triangle.

use anyhow::{Result, ensure};
use glam::DVec3;

use crate::float::Format;
use crate::port::{Hit, NONE, Ray};

/// Maximum number of triangles in a leaf of the oracle's hierarchy.
const LEAF_SIZE: usize = 4;

/// Casts rays at a mesh in `f64`.
#[derive(Clone, Debug)]
pub struct Oracle {
    corners: Vec<[DVec3; 3]>,
    /// Triangle numbers; those of a leaf are consecutive.
    order: Vec<u32>,
    /// The root is first.
    boxes: Vec<BoxNode>,
}

#[derive(Clone, Copy, Debug)]
struct BoxNode {
    lo: DVec3,
    hi: DVec3,
    /// For a leaf, the start of its range in `order`; for an inner node, the index of its first child.
    first: u32,
    second: u32,
    leaf: bool,
}

/// The relation between the results of machine and oracle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Explanation {
    /// Both see the same triangle, or both none.
    Agrees,
    /// Two triangles at distances that the format cannot distinguish, |Δt|·|d| ≤ ε. The ray meets both of them or passes within ε of
    /// an edge.
    SameDistance { difference: f64, epsilon: f64 },
    /// The ray passes within ε of an edge of either triangle.
    NearEdge { distance: f64, epsilon: f64 },
    /// Neither applies, so the machine is wrong.
    Unexplained {
        /// Distance from the nearest edge.
        distance: f64,
        epsilon: f64,
    },
}

/// At most one in this many rays may see another triangle than an independent intersector.
pub const RAYS_PER_DIFFERENCE: usize = 1000;

/// The comparison of many rays between two intersectors.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Account {
    /// Number of active rays.
    pub rays: usize,
    /// Number of rays with a hit in the machine.
    pub hits: usize,
    /// Number of rays explained by [`Explanation::SameDistance`].
    pub same_distance: usize,
    /// Number of rays explained by [`Explanation::NearEdge`].
    pub near_edge: usize,
    /// Number of the latter that miss in the machine and hit in the other intersector.
    pub lost: usize,
    /// Number of unexplained rays.
    pub unexplained: usize,
    /// The indices of all rays that see another triangle, in order.
    pub differences: Vec<(usize, Explanation)>,
}

impl Account {
    /// Number of rays that see another triangle, explained or not.
    pub fn different(&self) -> usize {
        self.differences.len()
    }

    /// Checks that there were hits, that all differences are explained, and that they are few enough ([`RAYS_PER_DIFFERENCE`]).
    ///
    /// # Errors
    /// One line that describes the failed check.
    pub fn verdict(&self) -> Result<()> {
        let Account {
            rays,
            hits,
            unexplained,
            ..
        } = *self;
        ensure!(
            hits > 0,
            "none of {rays} rays hits anything: nothing was compared; give another camera"
        );
        ensure!(
            unexplained == 0,
            "{unexplained} of {rays} rays see another triangle, and neither an edge nor an equal distance explains it"
        );
        let different = self.different();
        ensure!(
            different * RAYS_PER_DIFFERENCE <= rays,
            "{different} of {rays} rays see another triangle, more than one in {RAYS_PER_DIFFERENCE}"
        );
        Ok(())
    }
}

impl Oracle {
    /// Creates an oracle for a mesh of rounded vertices.
    ///
    /// # Panics
    /// If a triangle names a missing vertex.
    pub fn new(vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> Self {
        let corner = |index: u32| DVec3::from_array(vertices[index as usize]);
        let mut oracle = Oracle {
            corners: triangles.iter().map(|t| t.map(corner)).collect(),
            order: (0..triangles.len() as u32).collect(),
            boxes: Vec::new(),
        };
        if !triangles.is_empty() {
            oracle.build(0, triangles.len());
        }
        oracle
    }

    /// Adds the hierarchy over a range of `order` and returns its index.
    fn build(&mut self, start: usize, end: usize) -> u32 {
        let index = self.boxes.len();
        let range = &mut self.order[start..end];
        let corners = &self.corners;
        let all = range.iter().flat_map(|&t| corners[t as usize]);
        let (lo, hi) = all.fold(
            (DVec3::INFINITY, DVec3::NEG_INFINITY),
            |(lo, hi), corner| (lo.min(corner), hi.max(corner)),
        );
        self.boxes.push(BoxNode {
            lo,
            hi,
            first: start as u32,
            second: end as u32,
            leaf: true,
        });
        if end - start > LEAF_SIZE {
            let extent = hi - lo;
            let axis = (0..3)
                .max_by(|&i, &j| extent[i].total_cmp(&extent[j]))
                .expect("three axes");
            let centre = |t: u32| corners[t as usize].iter().map(|c| c[axis]).sum::<f64>();
            let middle = (end - start) / 2;
            range.select_nth_unstable_by(middle, |&s, &t| centre(s).total_cmp(&centre(t)));
            let first = self.build(start, start + middle);
            let second = self.build(start + middle, end);
            let node = &mut self.boxes[index];
            (node.first, node.second, node.leaf) = (first, second, false);
        }
        index as u32
    }

    /// The closest hit with tmin ≤ t ≤ tmax; of equal ones, that of the triangle with the lowest number. An inactive or malformed
    /// ray misses; an any-hit ray is treated like any other ray.
    pub fn cast(&self, ray: &Ray) -> Hit {
        let mut best = Hit::MISS;
        let sound = ray.active && 0.0 <= ray.tmin && ray.tmin <= ray.tmax;
        if self.boxes.is_empty() || !sound {
            return best;
        }
        let origin = DVec3::from_array(ray.origin);
        let direction = DVec3::from_array(ray.direction);
        let inverse = direction.recip();
        let mut open = vec![0];
        while let Some(index) = open.pop() {
            let node = &self.boxes[index as usize];
            if !enters(node, origin, inverse, ray.tmin, ray.tmax.min(best.t)) {
                continue;
            }
            if !node.leaf {
                open.extend([node.first, node.second]);
                continue;
            }
            for &number in &self.order[node.first as usize..node.second as usize] {
                let Some((t, u, v)) = meet(&self.corners[number as usize], origin, direction)
                else {
                    continue;
                };
                let nearer = t < best.t || t == best.t && number < best.triangle;
                if ray.tmin <= t && t <= ray.tmax && nearer {
                    best = Hit {
                        t,
                        u,
                        v,
                        instance: 0,
                        triangle: number,
                    };
                }
            }
        }
        best
    }

    /// Minimum and maximum corner of the mesh.
    fn bounds(&self) -> (DVec3, DVec3) {
        self.boxes
            .first()
            .map_or((DVec3::ZERO, DVec3::ZERO), |root| (root.lo, root.hi))
    }

    /// Compares the machine's hits, computed in `format`, with the hits `others` of another intersector: this one, or one
    /// with at least the machine's precision.
    ///
    /// # Panics
    /// If the numbers of hits and rays differ.
    pub fn account(
        &self,
        format: Format,
        rays: &[Ray],
        machine: &[Hit],
        others: &[Hit],
    ) -> Account {
        assert!(rays.len() == machine.len() && rays.len() == others.len());
        let mut account = Account {
            rays: rays.iter().filter(|ray| ray.active).count(),
            ..Account::default()
        };
        for (index, ray) in rays.iter().enumerate() {
            let (machine, other) = (&machine[index], &others[index]);
            account.hits += usize::from(machine.is_hit());
            let explanation = self.explain(format, ray, machine, other);
            match explanation {
                Explanation::Agrees => continue,
                Explanation::SameDistance { .. } => account.same_distance += 1,
                Explanation::NearEdge { .. } => {
                    account.near_edge += 1;
                    account.lost += usize::from(!machine.is_hit());
                }
                Explanation::Unexplained { .. } => account.unexplained += 1,
            }
            account.differences.push((index, explanation));
        }
        account
    }

    /// Explains the machine's result, computed in `format`, for a ray with the oracle's result `exact`.
    /// ε = 32 · 2^−(f+1) · (|o| + t·|d| + the box's diagonal), where t is the distance of the respective hit.
    pub fn explain(&self, format: Format, ray: &Ray, machine: &Hit, exact: &Hit) -> Explanation {
        if machine.triangle == exact.triangle {
            return Explanation::Agrees;
        }
        let origin = DVec3::from_array(ray.origin);
        let direction = DVec3::from_array(ray.direction);
        let (lo, hi) = self.bounds();
        let unit = 32.0 * (-f64::from(format.fraction_bits() + 1)).exp2();
        let epsilon_at =
            |t: f64| unit * (origin.length() + t * direction.length() + (hi - lo).length());

        let to_edges = |hit: &Hit| {
            let corners = self.corners[hit.triangle as usize];
            (0..3)
                .map(|side| {
                    ray_to_segment(origin, direction, corners[side], corners[(side + 1) % 3])
                })
                .fold(f64::INFINITY, f64::min)
        };
        // Two triangles in one plane have the same distance at every ray; that does not explain which of them is hit.
        let meets = |hit: &Hit| {
            meet(&self.corners[hit.triangle as usize], origin, direction).is_some()
                || to_edges(hit) <= epsilon_at(hit.t)
        };
        if machine.is_hit() && exact.is_hit() {
            let difference = (machine.t - exact.t).abs() * direction.length();
            let epsilon = epsilon_at(machine.t.min(exact.t));
            if difference <= epsilon && meets(machine) && meets(exact) {
                return Explanation::SameDistance {
                    difference,
                    epsilon,
                };
            }
        }
        // Of the edges of both hits, the nearest in units of its ε.
        let mut nearest = (f64::INFINITY, 1.0);
        for hit in [machine, exact] {
            if hit.triangle == NONE {
                continue;
            }
            let epsilon = epsilon_at(hit.t);
            let distance = to_edges(hit);
            if distance / epsilon < nearest.0 / nearest.1 {
                nearest = (distance, epsilon);
            }
        }
        let (distance, epsilon) = nearest;
        if distance <= epsilon {
            Explanation::NearEdge { distance, epsilon }
        } else {
            Explanation::Unexplained { distance, epsilon }
        }
    }
}

/// Whether a ray may hit something in a box; the margin is much larger than the errors of `f64`.
fn enters(node: &BoxNode, origin: DVec3, inverse: DVec3, tmin: f64, tmax: f64) -> bool {
    let (mut near, mut far) = (tmin, tmax);
    for axis in 0..3 {
        let at_lo = (node.lo[axis] - origin[axis]) * inverse[axis];
        let at_hi = (node.hi[axis] - origin[axis]) * inverse[axis];
        if at_lo.is_nan() || at_hi.is_nan() {
            continue;
        }
        near = near.max(at_lo.min(at_hi) - 1e-12 * at_lo.min(at_hi).abs());
        far = far.min(at_lo.max(at_hi) + 1e-12 * at_lo.max(at_hi).abs());
    }
    near <= far
}

/// The intersection of a line with a triangle: t and the weights of the second and third corner. The triple products use
/// the corners relative to the origin, so two triangles agree about a shared edge.
fn meet(corners: &[DVec3; 3], origin: DVec3, direction: DVec3) -> Option<(f64, f64, f64)> {
    let [a, b, c] = corners.map(|corner| corner - origin);
    let weight_a = direction.dot(c.cross(b));
    let weight_b = direction.dot(a.cross(c));
    let weight_c = direction.dot(b.cross(a));
    let weights = [weight_a, weight_b, weight_c];
    if weights.iter().any(|&w| w < 0.0) && weights.iter().any(|&w| w > 0.0) {
        return None;
    }
    let sum = weight_a + weight_b + weight_c;
    let normal = (b - a).cross(c - a);
    let t = a.dot(normal) / direction.dot(normal);
    (sum != 0.0 && t.is_finite()).then(|| (t, weight_b / sum, weight_c / sum))
}

/// The distance between a ray and a segment. Along the segment, the distance from the ray is convex.
fn ray_to_segment(origin: DVec3, direction: DVec3, from: DVec3, to: DVec3) -> f64 {
    let squared = direction.length_squared();
    let from_ray = |part: f64| {
        let point = from.lerp(to, part) - origin;
        let along = (point.dot(direction) / squared).max(0.0);
        (point - along * direction).length()
    };
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..100 {
        let third = (high - low) / 3.0;
        if from_ray(low + third) <= from_ray(high - third) {
            high -= third;
        } else {
            low += third;
        }
    }
    from_ray(low).min(from_ray(0.0)).min(from_ray(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> Oracle {
        let corners = [
            [0.0, 0.0, 1.0],
            [1.0, 0.0, 1.0],
            [1.0, 1.0, 1.0],
            [0.0, 1.0, 1.0],
        ];
        Oracle::new(&corners, &[[0, 1, 2], [0, 2, 3]])
    }

    fn down(x: f64, y: f64) -> Ray {
        Ray {
            origin: [x, y, 0.0],
            direction: [0.0, 0.0, 2.0],
            tmin: 0.0,
            tmax: f64::INFINITY,
            active: true,
            any_hit: false,
        }
    }

    #[test]
    fn a_square_is_hit_where_it_is() {
        let hit = square().cast(&down(0.75, 0.25));
        assert_eq!((hit.t, hit.u, hit.v, hit.triangle), (0.5, 0.5, 0.25, 0));
        let hit = square().cast(&down(0.25, 0.75));
        assert_eq!((hit.t, hit.u, hit.v, hit.triangle), (0.5, 0.25, 0.5, 1));
        assert_eq!(square().cast(&down(0.5, 0.5)).triangle, 0);
        assert!(!square().cast(&down(1.25, 0.5)).is_hit());
        let short = Ray {
            tmax: 0.49,
            ..down(0.75, 0.25)
        };
        assert!(!square().cast(&short).is_hit());
    }

    #[test]
    fn the_hierarchy_does_not_show() {
        let mut random = fastrand::Rng::with_seed(7);
        let mut point = || [0; 3].map(|_| random.f64() * 2.0 - 1.0);
        let corners: Vec<[f64; 3]> = (0..300).map(|_| point()).collect();
        let triangles: Vec<[u32; 3]> = (0..100).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let oracle = Oracle::new(&corners, &triangles);
        let mut hits = 0;
        for _ in 0..1000 {
            let ray = Ray {
                origin: point(),
                direction: point(),
                ..down(0.0, 0.0)
            };
            let (o, d) = (
                DVec3::from_array(ray.origin),
                DVec3::from_array(ray.direction),
            );
            let plain = oracle
                .corners
                .iter()
                .enumerate()
                .filter_map(|(number, corners)| {
                    let (t, ..) = meet(corners, o, d)?;
                    (t >= 0.0).then_some((t, number as u32))
                });
            let plain = plain.min_by(|x, y| x.partial_cmp(y).expect("finite"));
            let hit = oracle.cast(&ray);
            assert_eq!(plain.map_or(NONE, |(_, number)| number), hit.triangle);
            hits += usize::from(hit.is_hit());
        }
        assert!(hits > 100, "only {hits} hits");
    }

    #[test]
    fn explanations_tell_an_edge_from_a_blunder() {
        let oracle = square();
        let explain = |ray: &Ray, machine: &Hit| {
            oracle.explain(Format::FP24, ray, machine, &oracle.cast(ray))
        };
        let edge = down(0.00001, 0.5);
        assert!(matches!(
            explain(&edge, &Hit::MISS),
            Explanation::NearEdge { .. }
        ));
        let inside = down(0.75, 0.25);
        assert!(matches!(
            explain(&inside, &Hit::MISS),
            Explanation::Unexplained { .. }
        ));
        let other = Hit {
            triangle: 1,
            ..oracle.cast(&inside)
        };
        assert!(
            matches!(explain(&inside, &other), Explanation::Unexplained { .. }),
            "the neighbour is equally far, but not there"
        );
        let diagonal = down(0.500001, 0.5);
        let neighbour = Hit {
            triangle: 1,
            ..oracle.cast(&diagonal)
        };
        assert!(matches!(
            explain(&diagonal, &neighbour),
            Explanation::SameDistance { .. }
        ));
        let far = Hit { t: 5.0, ..other };
        assert!(matches!(
            explain(&inside, &far),
            Explanation::Unexplained { .. }
        ));
        assert_eq!(explain(&inside, &oracle.cast(&inside)), Explanation::Agrees);
    }

    #[test]
    fn an_account_counts_and_judges() {
        let oracle = square();
        let rays = [down(0.75, 0.25), down(0.00001, 0.5), down(2.0, 0.5)];
        let exact = rays.map(|ray| oracle.cast(&ray));
        let account = |machine: &[Hit]| oracle.account(Format::FP24, &rays, machine, &exact);
        let same = account(&exact);
        assert_eq!((same.rays, same.hits, same.different()), (3, 2, 0));
        same.verdict().unwrap();

        let fault = |account: Account| account.verdict().unwrap_err().to_string();
        let lost = account(&[exact[0], Hit::MISS, Hit::MISS]);
        assert_eq!((lost.near_edge, lost.lost, lost.hits), (1, 1, 1));
        assert_eq!(lost.differences[0].0, 1);
        assert!(fault(lost).contains("1 of 3 rays see another triangle, more than"));
        let blunder = account(&[Hit::MISS, exact[1], Hit::MISS]);
        assert_eq!((blunder.unexplained, blunder.different()), (1, 1));
        assert!(fault(blunder).contains("explains it"));
        assert!(fault(account(&[Hit::MISS; 3])).contains("nothing was compared"));
    }

    #[test]
    fn distance_of_ray_and_segment() {
        let z = DVec3::Z;
        let distance = |from, to| ray_to_segment(DVec3::ZERO, z, from, to);
        let crossing = distance(DVec3::new(-1.0, 0.5, 3.0), DVec3::new(1.0, 0.5, 3.0));
        assert!((crossing - 0.5).abs() < 1e-7);
        let behind = distance(DVec3::new(0.0, 0.0, -2.0), DVec3::new(0.0, 1.0, -2.0));
        assert!((behind - 2.0).abs() < 1e-7);
    }
}
