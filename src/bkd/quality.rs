//! The quality of a tree after its vertices have moved.
//!
//! A refit keeps a tree correct, but not efficient: a split that separated two limbs no longer separates them after they cross.
//! The measure is the tree's cost by areas, relative to a tree rebuilt for the current vertices.

use super::build::{BuildOptions, build};
use super::stats::TreeStatistics;
use super::tree::Tree;
use crate::float::Format;
use anyhow::Result;

/// A comparison of a refitted tree with a rebuilt one.
#[derive(Clone, Debug)]
pub struct Quality {
    /// Expected cycles of a random ray through the object's box, for the refitted tree.
    pub refitted: f64,
    /// The same for the rebuilt tree.
    pub rebuilt: f64,
    /// The rebuilt tree.
    pub tree: Tree,
}

impl Quality {
    /// Compares a tree over `triangles` with one that is built with `options` for the current vertices.
    ///
    /// # Errors
    /// If [`build`] rejects the mesh.
    pub fn of(
        tree: &Tree,
        vertices: &[[f64; 3]],
        triangles: &[[u32; 3]],
        options: &BuildOptions,
        format: Format,
    ) -> Result<Quality> {
        let rebuilt = build(vertices, triangles, options)?;
        let cost = |tree: &Tree| {
            let of = TreeStatistics::new(tree, vertices, triangles, format);
            // A traversal step takes one cycle of the traversal unit, a test one cycle of the geometry unit.
            of.expected_steps + of.expected_tests
        };
        Ok(Quality {
            refitted: cost(tree),
            rebuilt: cost(&rebuilt),
            tree: rebuilt,
        })
    }

    /// Cost of the refitted tree ÷ cost of the rebuilt one. It is 1 for equal trees, and can be slightly below 1, because
    /// the builder does not find the optimal tree.
    pub fn ratio(&self) -> f64 {
        self.refitted / self.rebuilt
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_has_not_moved_is_as_good_and_what_has_crossed_is_not() {
        // A row of triangles along x.
        let row = |k: u32| {
            let x = f64::from(k);
            [[x, 0.0, 0.0], [x + 0.5, 0.0, 0.0], [x, 1.0, 0.5]]
        };
        let mut vertices: Vec<[f64; 3]> = (0..64).flat_map(row).collect();
        let triangles: Vec<[u32; 3]> = (0..64).map(|k| [3 * k, 3 * k + 1, 3 * k + 2]).collect();
        let options = BuildOptions::default_for(2, 32);
        let tree = build(&vertices, &triangles, &options).unwrap();
        let quality =
            |vertices: &[_]| Quality::of(&tree, vertices, &triangles, &options, Format::FP24);
        let still = quality(&vertices).unwrap();
        assert_eq!((still.ratio(), &still.tree), (1.0, &tree));
        // Every second triangle of the first half is swapped with one of the second half.
        for k in (0..32).step_by(2) {
            for corner in 0..3 {
                vertices.swap(3 * k + corner, 3 * (k + 32) + corner);
            }
        }
        let crossed = quality(&vertices).unwrap();
        assert!(crossed.ratio() > 1.5, "{}", crossed.ratio());
        let again = Quality::of(&crossed.tree, &vertices, &triangles, &options, Format::FP24);
        assert_eq!(again.unwrap().ratio(), 1.0);
    }
}
