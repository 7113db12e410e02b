//! Size and estimated cost of a tree.

use serde::Serialize;

use super::layout::Record;
use super::tree::{Bounds, Child, Tree};
use crate::float::Format;

/// A tree's size, and its cost estimated by areas, for a random ray that crosses the scene's box
/// and hits nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct TreeStatistics {
    pub triangles: usize,
    pub nodes: usize,
    /// Bytes of the nodes, the triangle records and the vertices, with each record rounded up to whole bytes.
    pub node_bytes: usize,
    pub record_bytes: usize,
    pub vertex_bytes: usize,
    /// Number of inner nodes on the longest path.
    pub depth: u32,
    /// Expected node steps: the sum of the areas of the nodes' regions, divided by the root's area.
    pub expected_steps: f64,
    /// Expected triangle tests: the same sum over the leaves.
    pub expected_tests: f64,
}

impl TreeStatistics {
    /// The statistics of a tree over a mesh, in the records of a format.
    pub fn new(tree: &Tree, vertices: &[[f64; 3]], triangles: &[[u32; 3]], format: Format) -> Self {
        let refit = tree.refit(vertices, triangles);
        let whole = refit.root.half_area();
        // No random ray crosses a scene without area; assume that a ray meets all nodes and leaves.
        let chance = |region: Bounds| {
            if whole > 0.0 {
                region.half_area() / whole
            } else {
                1.0
            }
        };
        let (mut expected_steps, mut expected_tests) = (0.0, 0.0);
        let mut open = vec![(tree.root, refit.root)];
        while let Some((child, region)) = open.pop() {
            match child {
                Child::Leaf(_) => expected_tests += chance(region),
                Child::Inner(index) => {
                    expected_steps += chance(region);
                    let node = tree.nodes[index as usize];
                    for side in [0, 1] {
                        let interval = refit.intervals[index as usize][side];
                        let region = region.with_interval(node.axes[side], interval);
                        open.push((node.children[side], region));
                    }
                }
            }
        }
        let bytes = |record: Record, count| count * record.width.div_ceil(8) as usize;
        TreeStatistics {
            triangles: triangles.len(),
            nodes: tree.nodes.len(),
            node_bytes: bytes(Record::node(format), tree.nodes.len()),
            record_bytes: bytes(Record::triangle(), triangles.len()),
            vertex_bytes: bytes(Record::vertex(format), vertices.len()),
            depth: tree.depth(),
            expected_steps,
            expected_tests,
        }
    }
}
