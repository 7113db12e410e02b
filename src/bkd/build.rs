//! Tree construction: a full sweep with the surface area heuristic over presorted lists.
//!
//! The triangles are sorted once by each key on each axis. A node is split at the position of the list with the least
//! cost. The lists are then partitioned stably, so they stay sorted. The run time is O(n log n) if the tree's depth is
//! O(log n), and at most O(n · maximum depth).

use std::marker::PhantomData;

use anyhow::{Result, bail, ensure};

use super::tree::{Bounds, Child, Tree, TreeNode};

/// The box that determines the estimated probability that a ray enters a child.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SplitCost {
    /// The child's tight box, as if the node stored it completely.
    Boxes,
    /// The region known to traversal: the parent's region, clipped by the child's interval.
    Region,
}

/// The sort keys of triangles on each axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum SortKeys {
    /// The centre of the triangle's box: 3 lists.
    Centre,
    /// The centre, the minimum and the maximum of the triangle's box: 9 lists.
    CentreMinMax,
}

/// Options of tree construction.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct BuildOptions {
    pub cost: SplitCost,
    pub sort_keys: SortKeys,
    /// 1: both children's intervals are on one common axis; 2: each has its own axis.
    pub axes_per_node: u32,
    /// Maximum number of inner nodes on a path, which is the number of entries of the traversal stack. The limit
    /// [`MOST_DEPTH`] applies in addition.
    pub max_depth: u32,
}

/// Maximum depth of any tree, independent of the options.
pub const MOST_DEPTH: u32 = 60;

impl BuildOptions {
    /// The classical construction: areas of boxes, one axis per node, sorted by centre.
    pub fn plain(max_depth: u32) -> Self {
        BuildOptions {
            cost: SplitCost::Boxes,
            sort_keys: SortKeys::Centre,
            axes_per_node: 1,
            max_depth,
        }
    }

    /// As [`BuildOptions::plain`], but with the region cost.
    pub fn region(max_depth: u32) -> Self {
        BuildOptions {
            cost: SplitCost::Region,
            ..Self::plain(max_depth)
        }
    }

    /// The best known options for a machine with 1 or 2 axes per node.
    pub fn default_for(axes_per_node: u32, max_depth: u32) -> Self {
        BuildOptions {
            cost: SplitCost::Region,
            sort_keys: SortKeys::CentreMinMax,
            axes_per_node,
            max_depth,
        }
    }
}

/// Builds the tree of a mesh. The result depends only on the arguments.
///
/// # Errors
/// If there is no triangle, if a triangle names a vertex that is missing or not finite, or if the maximum depth
/// is too small for the number of triangles.
pub fn build(
    vertices: &[[f64; 3]],
    triangles: &[[u32; 3]],
    options: &BuildOptions,
) -> Result<Tree> {
    ensure!(!triangles.is_empty(), "the mesh has no triangles");
    for (number, triangle) in triangles.iter().enumerate() {
        for &index in triangle {
            let Some(vertex) = vertices.get(index as usize) else {
                bail!(
                    "triangle {number} names vertex {index}, but there are {}; correct the mesh",
                    vertices.len()
                );
            };
            ensure!(
                vertex.iter().all(|x| x.is_finite()),
                "vertex {index} is not finite; correct the mesh"
            );
        }
    }
    let boxes: Vec<Bounds> = (triangles.iter())
        .map(|&triangle| Bounds::of_triangle(vertices, triangle))
        .collect();
    let leaves = Leaves {
        plural: "triangles",
        remedy: "simplify the mesh",
    };
    build_leaves(&boxes, leaves, options)
}

/// Builds the top-level tree over instances with the given boxes in the world. The result depends only on the
/// arguments.
///
/// # Errors
/// If there is no box, if a box is not finite, or if the maximum depth is too small for the number of boxes.
pub fn build_over_boxes(boxes: &[Bounds], options: &BuildOptions) -> Result<Tree> {
    ensure!(!boxes.is_empty(), "the scene has no instances");
    for (number, bounds) in boxes.iter().enumerate() {
        ensure!(
            (bounds.lo.iter().chain(&bounds.hi)).all(|x| x.is_finite()),
            "the box of instance {number} is not finite; correct its matrix"
        );
    }
    let leaves = Leaves {
        plural: "instances",
        remedy: "leave some out",
    };
    build_leaves(boxes, leaves, options)
}

/// The name of the leaves in error messages.
struct Leaves {
    plural: &'static str,
    remedy: &'static str,
}

/// Builds a tree over at least one finite box.
fn build_leaves(boxes: &[Bounds], leaves: Leaves, options: &BuildOptions) -> Result<Tree> {
    ensure!(
        matches!(options.axes_per_node, 1 | 2),
        "a node has 1 or 2 axes, not {}",
        options.axes_per_node
    );
    let count = boxes.len();
    super::layout::check_capacity(0, count as u64, super::layout::LINK_BITS)?;
    let max_depth = options.max_depth.min(MOST_DEPTH);
    ensure!(
        count as u64 <= 1 << max_depth,
        "{count} {} need a tree of depth {}, but the traversal stack allows {}; \
         {} or deepen the stack",
        leaves.plural,
        count.next_power_of_two().ilog2(),
        options.max_depth,
        leaves.remedy
    );

    let boxes = scaled_boxes(boxes);
    let all = (boxes.iter()).fold(SweepBox::EMPTY, |union, b| union.union(b));
    let mut builder = Builder {
        lists: sorted_lists(&boxes, options.sort_keys),
        goes_left: vec![false; count],
        rest: Vec::with_capacity(count),
        nodes: vec![
            TreeNode {
                children: [Child::Leaf(0); 2],
                axes: [0; 2],
            };
            count - 1
        ],
        boxes,
    };
    let range = Range {
        start: 0,
        count,
        region: all,
        depth: max_depth,
    };
    let root = match (options.cost, options.axes_per_node) {
        (SplitCost::Boxes, 1) => builder.subtree(&mut Sweep::<BoxArea>::new(count), range),
        (SplitCost::Boxes, _) => builder.subtree(&mut Sweep::<BoxAreaOwnAxes>::new(count), range),
        (SplitCost::Region, 1) => builder.subtree(&mut Sweep::<RegionArea>::new(count), range),
        (SplitCost::Region, _) => {
            builder.subtree(&mut Sweep::<RegionAreaOwnAxes>::new(count), range)
        }
    };
    Ok(Tree {
        nodes: builder.nodes,
        root,
    })
}

/// A box for sweeping: minimum corner and negated maximum corner, which makes a union eight minima.
#[derive(Clone, Copy, PartialEq)]
#[repr(align(32))]
struct SweepBox([f32; 8]);

impl SweepBox {
    const EMPTY: SweepBox = SweepBox([f32::INFINITY; 8]);

    #[inline(always)]
    fn union(self, other: &SweepBox) -> SweepBox {
        SweepBox(std::array::from_fn(|i| {
            if other.0[i] < self.0[i] {
                other.0[i]
            } else {
                self.0[i]
            }
        }))
    }

    #[inline(always)]
    fn lo(&self, axis: usize) -> f32 {
        self.0[axis]
    }

    #[inline(always)]
    fn hi(&self, axis: usize) -> f32 {
        -self.0[4 + axis]
    }

    #[inline(always)]
    fn extents(&self) -> [f32; 3] {
        std::array::from_fn(|axis| EXTENT + self.hi(axis) - self.lo(axis))
    }

    /// This region, clipped by a child's interval on an axis.
    #[inline(always)]
    fn clipped(&self, axis: usize, child: &SweepBox) -> SweepBox {
        let mut clipped = *self;
        clipped.0[axis] = child.0[axis];
        clipped.0[4 + axis] = child.0[4 + axis];
        clipped
    }
}

/// Added to every extent, in units of the scene's extent. It keeps the areas of a flat scene proportional to its lengths.
const EXTENT: f32 = 1.0 / 65536.0;

#[inline(always)]
fn half_area([x, y, z]: [f32; 3]) -> f32 {
    x * y + y * z + z * x
}

/// Boxes scaled by a power of two, so that no coordinate exceeds 1 and no area overflows.
fn scaled_boxes(exact: &[Bounds]) -> Vec<SweepBox> {
    let greatest = (exact.iter())
        .flat_map(|b| b.lo.into_iter().chain(b.hi))
        .fold(f64::MIN_POSITIVE, |greatest, x| greatest.max(x.abs()));
    // 2^−(exponent + 1) from the bits of the exponent, which is the same on every machine.
    let scale = f64::from_bits((2045 - (greatest.to_bits() >> 52)).max(1) << 52);
    (exact.iter())
        .map(|b| {
            let mut scaled = SweepBox([0.0; 8]);
            for axis in 0..3 {
                scaled.0[axis] = (b.lo[axis] * scale) as f32;
                scaled.0[4 + axis] = (-b.hi[axis] * scale) as f32;
            }
            scaled
        })
        .collect()
}

/// The numbers of the triangles, sorted by each key on each axis; equal keys are sorted by number. List i belongs to axis i mod 3.
fn sorted_lists(boxes: &[SweepBox], keys: SortKeys) -> Vec<Vec<u32>> {
    type Key = fn(&SweepBox, usize) -> f32;
    let centre: Key = |b, axis| b.lo(axis) + b.hi(axis);
    let keys: &[Key] = match keys {
        SortKeys::Centre => &[centre],
        SortKeys::CentreMinMax => &[centre, SweepBox::lo, SweepBox::hi],
    };
    let mut lists = Vec::with_capacity(3 * keys.len());
    for key in keys {
        for axis in 0..3 {
            // One integer with the same order as (key, number).
            let mut sorted: Vec<u64> = (boxes.iter().zip(0u64..))
                .map(|(b, number)| {
                    let bits = (key(b, axis) + 0.0).to_bits();
                    let ordered = if bits >> 31 == 1 {
                        !bits
                    } else {
                        bits | 1 << 31
                    };
                    u64::from(ordered) << 32 | number
                })
                .collect();
            sorted.sort_unstable();
            lists.push(sorted.into_iter().map(|packed| packed as u32).collect());
        }
    }
    lists
}

/// The cost of a split of a range by one list, and the axes of the children's intervals.
trait Measure {
    /// Prepares the measure for a range with the given region and for the axis of a list.
    fn new(region: &SweepBox, sweep_axis: usize) -> Self;
    /// The area that is proportional to the estimated probability that a ray enters the child.
    fn area(&self, child: &SweepBox) -> f32;
    /// The estimated cost of a subtree of `count` triangles after it is entered, up to a common factor.
    fn subtree_cost(count: usize) -> f64;
    /// The axes of the children's intervals.
    fn axes(region: &SweepBox, sweep_axis: usize, children: &[SweepBox; 2]) -> [u8; 2];
}

/// The axis on which the child's interval reduces the region most.
fn best_axis(region: &SweepBox, child: &SweepBox) -> u8 {
    let area = |axis: u8| half_area(region.clipped(axis.into(), child).extents());
    (1..3).fold(
        0,
        |best, axis| {
            if area(axis) < area(best) { axis } else { best }
        },
    )
}

/// The area of the tight box; both intervals are on the axis of the sweep.
struct BoxArea;

impl Measure for BoxArea {
    #[inline(always)]
    fn new(_: &SweepBox, _: usize) -> Self {
        BoxArea
    }

    #[inline(always)]
    fn area(&self, child: &SweepBox) -> f32 {
        half_area(child.extents())
    }

    fn subtree_cost(count: usize) -> f64 {
        count as f64
    }

    fn axes(_: &SweepBox, sweep_axis: usize, _: &[SweepBox; 2]) -> [u8; 2] {
        [sweep_axis as u8; 2]
    }
}

/// The area of the tight box; each interval is on the axis on which it reduces the region most.
struct BoxAreaOwnAxes;

impl Measure for BoxAreaOwnAxes {
    #[inline(always)]
    fn new(_: &SweepBox, _: usize) -> Self {
        BoxAreaOwnAxes
    }

    #[inline(always)]
    fn area(&self, child: &SweepBox) -> f32 {
        half_area(child.extents())
    }

    fn subtree_cost(count: usize) -> f64 {
        count as f64
    }

    fn axes(region: &SweepBox, _: usize, children: &[SweepBox; 2]) -> [u8; 2] {
        [0, 1].map(|child| best_axis(region, &children[child]))
    }
}

/// The area of the region clipped on the axis of the sweep, linear in the child's extent there.
struct RegionArea {
    /// The change of the area per unit of the child's extent, by axis; 0 except on the axis of the sweep.
    slope: [f32; 3],
    constant: f32,
}

impl Measure for RegionArea {
    #[inline(always)]
    fn new(region: &SweepBox, sweep_axis: usize) -> Self {
        let extents = region.extents();
        let [y, z] = [1, 2].map(|step| extents[(sweep_axis + step) % 3]);
        let mut slope = [0.0; 3];
        slope[sweep_axis] = y + z;
        RegionArea {
            slope,
            constant: y * z,
        }
    }

    #[inline(always)]
    fn area(&self, child: &SweepBox) -> f32 {
        let [x, y, z] = child.extents();
        x * self.slope[0] + y * self.slope[1] + z * self.slope[2] + self.constant
    }

    fn subtree_cost(count: usize) -> f64 {
        count as f64
    }

    fn axes(_: &SweepBox, sweep_axis: usize, _: &[SweepBox; 2]) -> [u8; 2] {
        [sweep_axis as u8; 2]
    }
}

/// The area of the region clipped on the axis on which the child's interval reduces it most.
struct RegionAreaOwnAxes {
    slope: [f32; 3],
    constant: [f32; 3],
}

impl Measure for RegionAreaOwnAxes {
    #[inline(always)]
    fn new(region: &SweepBox, _: usize) -> Self {
        let [x, y, z] = region.extents();
        RegionAreaOwnAxes {
            slope: [y + z, z + x, x + y],
            constant: [y * z, z * x, x * y],
        }
    }

    #[inline(always)]
    fn area(&self, child: &SweepBox) -> f32 {
        let extents = child.extents();
        let area = |axis| extents[axis] * self.slope[axis] + self.constant[axis];
        area(0).min(area(1)).min(area(2))
    }

    /// A ray that enters a subtree visits only a part of it, and the share falls with the size: count^¾. Averaged over
    /// eight views, this needs 39.7 steps per packet instead of 46.8 in Sponza, 18.5 instead of 19.1 in the kitchen, and no
    /// fewer for the bunny. With one axis per node it saves nothing. (Square roots, unlike `powf`, are the same on every machine.)
    fn subtree_cost(count: usize) -> f64 {
        let count = count as f64;
        (count * count.sqrt()).sqrt()
    }

    fn axes(region: &SweepBox, _: usize, children: &[SweepBox; 2]) -> [u8; 2] {
        [0, 1].map(|child| best_axis(region, &children[child]))
    }
}

/// The triangles of one subtree.
#[derive(Clone, Copy)]
struct Range {
    /// Its first position in every list.
    start: usize,
    count: usize,
    /// The region known to traversal.
    region: SweepBox,
    /// Maximum number of inner nodes on a path.
    depth: u32,
}

/// A split of a range: the first `left` triangles of a list become the left child.
struct Split {
    list: usize,
    left: usize,
}

/// The search for the best split, and its scratch memory.
struct Sweep<M> {
    /// For each position, the area to the right of it.
    right: Vec<f32>,
    /// For each number of triangles, the estimated cost of a subtree.
    subtree_cost: Vec<f64>,
    measure: PhantomData<M>,
}

impl<M: Measure> Sweep<M> {
    fn new(count: usize) -> Self {
        Sweep {
            right: vec![0.0; count],
            subtree_cost: (0..=count).map(M::subtree_cost).collect(),
            measure: PhantomData,
        }
    }

    /// The split with the least cost. Ties are resolved by the most even division, then by position.
    fn best_split(&mut self, boxes: &[SweepBox], lists: &[Vec<u32>], range: &Range) -> Split {
        let count = range.count;
        let whole = range.start..range.start + count;
        let numbers = &lists[0][whole.clone()];
        let one = boxes[numbers[0] as usize];
        if numbers.iter().all(|&number| boxes[number as usize] == one) {
            // No split separates the triangles: keep the tree shallow, and clip on the best axis.
            let area = |list: usize| M::new(&range.region, list).area(&one);
            let list = (1..3).fold(
                0,
                |best, list| if area(list) < area(best) { list } else { best },
            );
            return Split {
                list,
                left: count / 2,
            };
        }
        let mut best = Split { list: 0, left: 0 };
        // Only positions that respect the maximum depth on both sides; the object median always does.
        let most = 1 << (range.depth - 1);
        let first = count.saturating_sub(most).max(1);
        let last = most.min(count - 1);
        let right = &mut self.right[..count];
        let mut best_cost = (f64::INFINITY, usize::MAX);
        for (list, numbers) in lists.iter().enumerate() {
            let measure = M::new(&range.region, list % 3);
            let numbers = &numbers[whole.clone()];
            let mut union = SweepBox::EMPTY;
            for position in (first..count).rev() {
                union = union.union(&boxes[numbers[position] as usize]);
                right[position] = measure.area(&union);
            }
            let mut union = SweepBox::EMPTY;
            for position in 1..=last {
                union = union.union(&boxes[numbers[position - 1] as usize]);
                if position < first {
                    continue;
                }
                let left = f64::from(measure.area(&union));
                let cost = left * self.subtree_cost[position]
                    + f64::from(right[position]) * self.subtree_cost[count - position];
                if cost <= best_cost.0 {
                    let cost = (cost, position.abs_diff(count - position));
                    if cost < best_cost {
                        best_cost = cost;
                        best = Split {
                            list,
                            left: position,
                        };
                    }
                }
            }
        }
        best
    }
}

struct Builder {
    boxes: Vec<SweepBox>,
    /// The numbers of the triangles, sorted differently in each list; a subtree has the same range in all lists.
    lists: Vec<Vec<u32>>,
    goes_left: Vec<bool>,
    /// Scratch memory of a partition.
    rest: Vec<u32>,
    nodes: Vec<TreeNode>,
}

impl Builder {
    /// Builds a subtree. Its count − 1 nodes get the indices from the start of the range: first those of the left
    /// child, then its root, then those of the right child.
    fn subtree<M: Measure>(&mut self, sweep: &mut Sweep<M>, range: Range) -> Child {
        if range.count == 1 {
            return Child::Leaf(self.lists[0][range.start]);
        }
        let split = sweep.best_split(&self.boxes, &self.lists, &range);
        let children = self.partition(&range, &split);
        let axes = M::axes(&range.region, split.list % 3, &children);
        let [left, right] = [0, 1].map(|child| Range {
            start: range.start + child * split.left,
            count: if child == 0 {
                split.left
            } else {
                range.count - split.left
            },
            region: range.region.clipped(axes[child].into(), &children[child]),
            depth: range.depth - 1,
        });
        let index = range.start + split.left - 1;
        let children = [self.subtree(sweep, left), self.subtree(sweep, right)];
        self.nodes[index] = TreeNode { children, axes };
        Child::Inner(index as u32)
    }

    /// Partitions all lists stably by a split, and returns the boxes of both sides.
    fn partition(&mut self, range: &Range, split: &Split) -> [SweepBox; 2] {
        let whole = range.start..range.start + range.count;
        let numbers = &self.lists[split.list][whole.clone()];
        let mut boxes = [SweepBox::EMPTY; 2];
        for (position, &number) in numbers.iter().enumerate() {
            let side = usize::from(position >= split.left);
            self.goes_left[number as usize] = side == 0;
            boxes[side] = boxes[side].union(&self.boxes[number as usize]);
        }
        for (list, numbers) in self.lists.iter_mut().enumerate() {
            if list == split.list {
                continue;
            }
            let numbers = &mut numbers[whole.clone()];
            self.rest.clear();
            self.rest.resize(range.count, 0);
            let (mut left, mut right) = (0, 0);
            for position in 0..range.count {
                let number = numbers[position];
                let goes_left = self.goes_left[number as usize];
                numbers[left] = number;
                self.rest[right] = number;
                left += usize::from(goes_left);
                right += usize::from(!goes_left);
            }
            numbers[left..].copy_from_slice(&self.rest[..right]);
        }
        boxes
    }
}
