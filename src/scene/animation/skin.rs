//! The binding of a mesh to its skeleton.

use super::{Matrix3x4, number};
use anyhow::{Result, ensure};
use glam::DAffine3;

/// Maximum number of influences of a vertex.
pub const MOST_INFLUENCES: usize = 4;

/// The influences of one vertex, the strongest first. Weights are positive, then zero; their sum is 1. A joint with weight
/// zero is joint 0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Influences {
    /// Indices into the object's palette.
    pub joints: [u16; MOST_INFLUENCES],
    pub weights: [f64; MOST_INFLUENCES],
}

impl Influences {
    /// The strongest of the given influences, whose joints may repeat, and whether there were more than [`MOST_INFLUENCES`].
    ///
    /// # Errors
    /// One line if a weight is negative or not finite, if all are zero, or if a joint with a weight is not below
    /// `joint_count`.
    pub fn new(given: &[(u32, f64)], joint_count: usize) -> Result<(Self, bool)> {
        let mut merged: Vec<(u16, f64)> = Vec::with_capacity(given.len());
        for &(joint, weight) in given {
            ensure!(
                weight.is_finite() && weight >= 0.0,
                "has the weight {}; give weights from 0 to 1",
                number(weight)
            );
            // Unused entries often name joints that do not exist.
            if weight == 0.0 {
                continue;
            }
            ensure!(
                (joint as usize) < joint_count,
                "names joint {joint}, which is out of range (the skin has {joint_count}, counted from 0); correct JOINTS"
            );
            let joint = joint as u16;
            match merged.iter_mut().find(|(other, _)| *other == joint) {
                Some((_, sum)) => *sum += weight,
                None => merged.push((joint, weight)),
            }
        }
        ensure!(
            !merged.is_empty(),
            "has weights that are all zero; bind it to a joint"
        );
        merged.sort_by(|(i, v), (j, w)| w.total_cmp(v).then(i.cmp(j)));
        let reduced = merged.len() > MOST_INFLUENCES;
        merged.truncate(MOST_INFLUENCES);
        // Dividing by the maximum first keeps the sum of very large or small weights finite and normal.
        let greatest = merged[0].1;
        let sum: f64 = merged.iter().map(|(_, weight)| weight / greatest).sum();
        let mut influences = Self {
            joints: [0; MOST_INFLUENCES],
            weights: [0.0; MOST_INFLUENCES],
        };
        for (place, (joint, weight)) in merged.into_iter().enumerate() {
            influences.joints[place] = joint;
            influences.weights[place] = weight / greatest / sum;
        }
        Ok((influences, reduced))
    }

    /// Number of influences of the vertex, 1 to [`MOST_INFLUENCES`].
    pub fn count(&self) -> usize {
        self.weights.iter().filter(|&&weight| weight > 0.0).count()
    }
}

/// The binding of an object's vertices to joints.
#[derive(Clone, Debug)]
pub struct Skin {
    /// One per vertex of the object's mesh.
    pub influences: Vec<Influences>,
    /// Names of the joints in the order of the palette.
    pub joint_names: Vec<String>,
    /// The node of each joint.
    pub(in crate::scene) nodes: Vec<usize>,
    /// From the space of the mesh to that of the joint at rest.
    pub(in crate::scene) inverse_bind: Vec<DAffine3>,
}

impl Skin {
    /// Number of matrices in the palette.
    pub fn joint_count(&self) -> usize {
        self.nodes.len()
    }

    /// Number of influences of all vertices, which determines the time of skinning.
    pub fn influence_count(&self) -> usize {
        self.influences.iter().map(Influences::count).sum()
    }
}

/// Applies a matrix to a point.
pub fn transform_point(matrix: &Matrix3x4, point: [f64; 3]) -> [f64; 3] {
    matrix.map(|[x, y, z, w]| x * point[0] + y * point[1] + z * point[2] + w)
}

/// Skinning in double precision: every vertex is the weighted sum of its transformations by its joints. It is used for bounds
/// and pictures; the machine's result is that of its own arithmetic.
///
/// # Panics
/// If `positions` and `influences` have different lengths, or if a joint is not in `palette`.
pub fn skin_f64(
    positions: &[[f64; 3]],
    influences: &[Influences],
    palette: &[Matrix3x4],
) -> Vec<[f64; 3]> {
    assert_eq!(positions.len(), influences.len());
    std::iter::zip(positions, influences)
        .map(|(&position, influences)| {
            let mut sum = [0.0; 3];
            for (&joint, &weight) in std::iter::zip(&influences.joints, &influences.weights) {
                if weight > 0.0 {
                    let moved = transform_point(&palette[joint as usize], position);
                    for axis in 0..3 {
                        sum[axis] += weight * moved[axis];
                    }
                }
            }
            sum
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn new(given: &[(u32, f64)]) -> Result<(Influences, bool), String> {
        Influences::new(given, 8).map_err(|error| error.to_string())
    }

    #[test]
    fn weights_are_sorted_merged_and_normalised() {
        let (influences, reduced) =
            new(&[(3, 0.5), (1, 1.0), (3, 0.5), (7, 2.0), (200, 0.0)]).unwrap();
        assert!(!reduced);
        assert_eq!(influences.joints, [7, 1, 3, 0]);
        assert_eq!(influences.weights, [0.5, 0.25, 0.25, 0.0]);
        assert_eq!(influences.count(), 3);
    }

    #[test]
    fn more_than_four_are_reduced_to_the_strongest() {
        let (influences, reduced) =
            new(&[(0, 1.0), (1, 4.0), (2, 2.0), (3, 0.5), (4, 1.0), (5, 8.0)]).unwrap();
        assert!(reduced);
        assert_eq!(influences.joints, [5, 1, 2, 0]);
        let sum: f64 = influences.weights.iter().sum();
        assert!((sum - 1.0).abs() < 1e-15);
        assert_eq!(influences.weights[0], 8.0 / 15.0);
    }

    #[test]
    fn extreme_weights_are_normalised_too() {
        let (influences, _) = new(&[(0, 1e308), (1, 1e308), (2, 1e308)]).unwrap();
        assert!((influences.weights[0] - 1.0 / 3.0).abs() < 1e-15);
        let (influences, _) = new(&[(0, 1e-310), (1, 1e-310)]).unwrap();
        assert_eq!(influences.weights[..2], [0.5, 0.5]);
    }

    #[test]
    fn faulty_weights_and_joints_are_refused() {
        assert_eq!(
            new(&[(0, 0.0), (1, 0.0)]).unwrap_err(),
            "has weights that are all zero; bind it to a joint"
        );
        assert_eq!(
            new(&[(0, f64::NAN)]).unwrap_err(),
            "has the weight NaN; give weights from 0 to 1"
        );
        assert_eq!(
            new(&[(0, 1.0), (1, -0.25)]).unwrap_err(),
            "has the weight -0.25; give weights from 0 to 1"
        );
        assert_eq!(
            new(&[(8, 0.5)]).unwrap_err(),
            "names joint 8, which is out of range (the skin has 8, counted from 0); correct JOINTS"
        );
    }

    #[test]
    fn a_vertex_is_the_weighted_sum_of_where_its_joints_take_it() {
        let shift = |x: f64| {
            [
                [1.0, 0.0, 0.0, x],
                [0.0, 2.0, 0.0, 0.0],
                [0.0, 0.0, 1.0, 0.0],
            ]
        };
        let (influences, _) = new(&[(0, 3.0), (1, 1.0)]).unwrap();
        let skinned = skin_f64(&[[1.0, 1.0, 1.0]], &[influences], &[shift(0.0), shift(8.0)]);
        assert_eq!(skinned, [[3.0, 2.0, 1.0]]);
    }
}
