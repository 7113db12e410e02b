//! The topology of a tree, independent of its position in memory, and the bounds that follow from it.

/// A child of a node, or the root.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Child {
    /// The index of an inner node in [`Tree::nodes`].
    Inner(u32),
    /// The number of a triangle in its mesh, or of an instance in a top-level tree.
    Leaf(u32),
}

/// An inner node.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct TreeNode {
    /// Left and right.
    pub children: [Child; 2],
    /// For each child, the axis of its interval: 0 = x, 1 = y, 2 = z.
    pub axes: [u8; 2],
}

/// A tree's topology: n − 1 inner nodes over n ≥ 1 leaves, triangles or instances, in no particular order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tree {
    pub nodes: Vec<TreeNode>,
    pub root: Child,
}

/// An axis-aligned box.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Minimum corner.
    pub lo: [f64; 3],
    /// Maximum corner.
    pub hi: [f64; 3],
}

impl Bounds {
    /// The empty box.
    pub const EMPTY: Bounds = Bounds {
        lo: [f64::INFINITY; 3],
        hi: [f64::NEG_INFINITY; 3],
    };

    /// The box of a triangle's vertices: their exact minima and maxima.
    pub fn of_triangle(vertices: &[[f64; 3]], triangle: [u32; 3]) -> Self {
        let mut bounds = Bounds::EMPTY;
        for vertex in triangle {
            let vertex = vertices[vertex as usize];
            bounds = bounds.union(Bounds {
                lo: vertex,
                hi: vertex,
            });
        }
        bounds
    }

    /// The smallest box that contains both.
    pub fn union(self, other: Bounds) -> Self {
        let mut union = self;
        for axis in 0..3 {
            if other.lo[axis] < union.lo[axis] {
                union.lo[axis] = other.lo[axis];
            }
            if other.hi[axis] > union.hi[axis] {
                union.hi[axis] = other.hi[axis];
            }
        }
        union
    }

    /// \[minimum, maximum] coordinate on an axis.
    pub fn interval(self, axis: u8) -> [f64; 2] {
        [self.lo[axis as usize], self.hi[axis as usize]]
    }

    /// The box with its interval on an axis replaced.
    pub fn with_interval(mut self, axis: u8, interval: [f64; 2]) -> Self {
        self.lo[axis as usize] = interval[0];
        self.hi[axis as usize] = interval[1];
        self
    }

    /// Half the surface area.
    pub fn half_area(self) -> f64 {
        let [x, y, z] = std::array::from_fn(|axis| self.hi[axis] - self.lo[axis]);
        x * y + y * z + z * x
    }
}

/// The bounds of a tree over given vertices.
#[derive(Clone, Debug, PartialEq)]
pub struct Refit {
    /// For each of [`Tree::nodes`], the box of the triangles below it.
    pub boxes: Vec<Bounds>,
    /// For each of [`Tree::nodes`], its stored intervals: the \[minimum, maximum] coordinate of the left child and of the
    /// right child, each on its axis.
    pub intervals: Vec<[[f64; 2]; 2]>,
    /// The box of all triangles.
    pub root: Bounds,
}

impl Tree {
    /// Number of triangles in the tree.
    pub fn triangle_count(&self) -> usize {
        self.nodes.len() + 1
    }

    /// The indices of the nodes, every node after its children.
    pub fn children_first(&self) -> Vec<u32> {
        let mut order = Vec::with_capacity(self.nodes.len());
        let mut open = vec![self.root];
        while let Some(child) = open.pop() {
            if let Child::Inner(index) = child {
                order.push(index);
                open.extend(self.nodes[index as usize].children);
            }
        }
        order.reverse();
        order
    }

    /// Number of inner nodes on the longest path from the root: the maximum number of stack entries in traversal.
    pub fn depth(&self) -> u32 {
        let mut depth = vec![0; self.nodes.len()];
        let of = |depth: &[u32], child| match child {
            Child::Inner(index) => depth[index as usize],
            Child::Leaf(_) => 0,
        };
        for index in self.children_first() {
            let [left, right] = self.nodes[index as usize].children;
            depth[index as usize] = 1 + of(&depth, left).max(of(&depth, right));
        }
        of(&depth, self.root)
    }

    /// The bounds of the tree over `vertices`: exact minima and maxima of the triangles' vertices.
    pub fn refit(&self, vertices: &[[f64; 3]], triangles: &[[u32; 3]]) -> Refit {
        self.refit_leaves(|number| Bounds::of_triangle(vertices, triangles[number as usize]))
    }

    /// The bounds of the tree over leaves with the boxes of `leaf_box`: their exact minima and maxima.
    pub fn refit_leaves(&self, leaf_box: impl Fn(u32) -> Bounds) -> Refit {
        let mut boxes = vec![Bounds::EMPTY; self.nodes.len()];
        let mut intervals = vec![[[0.0; 2]; 2]; self.nodes.len()];
        let of = |boxes: &[Bounds], child| match child {
            Child::Inner(index) => boxes[index as usize],
            Child::Leaf(number) => leaf_box(number),
        };
        for index in self.children_first() {
            let node = &self.nodes[index as usize];
            let [left, right] = node.children.map(|child| of(&boxes, child));
            intervals[index as usize] = [left.interval(node.axes[0]), right.interval(node.axes[1])];
            boxes[index as usize] = left.union(right);
        }
        let root = of(&boxes, self.root);
        Refit {
            boxes,
            intervals,
            root,
        }
    }
}
