//! The records in memory. Memory images, golden model, RTL and documentation derive from these
//! definitions.
//!
//! A [`Record`] is a table of named bit fields. Arrays contain whole records. The image of an array is
//! a little-endian bit vector in 32-bit words, in which each record starts at a word; as text for `$readmemh` it has
//! one line of hexadecimal digits per record.
//!
//! # Positions in memory
//! An object of n triangles occupies n consecutive slots at one base in the node array and in the record
//! array; indices are absolute. Its n − 1 nodes fill the first slots: children before parents, two inner
//! children of one node next to each other, the root last. The last node slot is unused. The children of a node are
//!
//! | children        | left                 | right                |
//! |-----------------|----------------------|----------------------|
//! | two inner nodes | node \[link]         | node \[link + 1]     |
//! | left is a leaf  | record \[own index]  | node \[link]         |
//! | right is a leaf | node \[link]         | record \[own index]  |
//! | two leaves      | record \[own index]  | record \[link]       |
//!
//! Every triangle record belongs to exactly one node: the record at the index of a node with two inner children, and
//! the last record, are the right leaves of nodes with two leaves.

use std::collections::HashMap;
use std::collections::hash_map::Entry;

use anyhow::{Result, anyhow, bail, ensure};
use serde::Serialize;

use super::tree::{Bounds, Child, Refit, Tree};
use crate::float::Format;

/// Bits of an index in a link word.
pub const LINK_BITS: u32 = 26;

/// Bits of a joint's index in a palette.
pub const JOINT_BITS: u32 = 8;

/// Number of influences in a row of the skinning processor's stream.
pub const INFLUENCES_PER_ROW: usize = 4;

/// Maximum number of triangle records that a link word can address.
pub const MOST_RECORDS: u64 = 1 << LINK_BITS;

/// The records by field: what [`Record`] tabulates, as bundles.
pub mod fields {
    use super::{JOINT_BITS, LINK_BITS};
    use crate::bundle;
    use crate::float::Format;
    use crate::hdl::bundle::{Xyz, leaf};

    bundle! {
        /// The intervals of a node's children, each on its axis.
        pub struct Planes(format: Format) {
            left_lo: format.width(),
            left_hi: format.width(),
            right_lo: format.width(),
            right_hi: format.width(),
        }
    }

    bundle! {
        /// A link word.
        pub struct Link() {
            link: LINK_BITS,
            left_leaf: 1,
            right_leaf: 1,
            left_axis: 2,
            right_axis: 2,
        }
    }

    bundle! {
        /// A node.
        pub struct Node(format: Format) {
            planes: ..{Planes}(format),
            link: ..{Link}(),
        }
    }

    bundle! {
        /// A vertex.
        pub struct Vertex(format: Format) {
            position: ..{Xyz = [(); 3].map(|()| leaf(format.width()))},
        }
    }

    bundle! {
        /// A whole box.
        pub struct Box(format: Format) {
            lo: [format.width(); xyz],
            hi: [format.width(); xyz],
        }
    }

    bundle! {
        /// A triangle.
        pub struct Triangle() {
            v0: 32,
            v1: 32,
            v2: 32,
            number: 32,
        }
    }

    bundle! {
        /// An instance.
        pub struct Instance() {
            vectors: 32,
            root: 32,
            unused: 32,
            number: 32,
        }
    }

    bundle! {
        /// An influence of a row.
        pub struct Influence(format: Format) {
            weight: format.width() - 1,
            joint: JOINT_BITS,
            last: 1,
        }
    }
}

/// A named range of bits in a record.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Field {
    pub name: &'static str,
    /// Position of the field's least significant bit in the record.
    pub lsb: u32,
    /// Width in bits, 1 to 64.
    pub width: u32,
    pub description: &'static str,
}

impl Field {
    /// The value of the field in a record of little-endian `words`.
    pub fn get(&self, words: &[u32]) -> u64 {
        let mut value = 0;
        let mut done = 0;
        while done < self.width {
            let bit = self.lsb + done;
            let take = (32 - bit % 32).min(self.width - done);
            let part = u64::from(words[(bit / 32) as usize] >> (bit % 32)) & mask(take);
            value |= part << done;
            done += take;
        }
        value
    }

    /// Stores `value` in a record of little-endian `words` and keeps all other bits.
    ///
    /// # Panics
    /// If `value` does not fit the field.
    pub fn set(&self, words: &mut [u32], value: u64) {
        assert!(
            value & !mask(self.width) == 0,
            "{value:#x} does not fit the {} bits of field {}",
            self.width,
            self.name
        );
        let mut done = 0;
        while done < self.width {
            let bit = self.lsb + done;
            let take = (32 - bit % 32).min(self.width - done);
            let place = (mask(take) as u32) << (bit % 32);
            let word = &mut words[(bit / 32) as usize];
            *word = *word & !place | ((value >> done) as u32) << (bit % 32) & place;
            done += take;
        }
    }
}

fn mask(width: u32) -> u64 {
    if width >= 64 { !0 } else { (1 << width) - 1 }
}

/// The layout of one kind of record: its fields from the least significant bit up, without gaps.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Record {
    pub name: &'static str,
    /// Width in bits.
    pub width: u32,
    pub fields: Vec<Field>,
}

impl Record {
    fn new(name: &'static str, parts: &[(&'static str, u32, &'static str)]) -> Self {
        let mut width = 0;
        let fields = parts
            .iter()
            .map(|&(name, bits, description)| {
                let lsb = width;
                width += bits;
                Field {
                    name,
                    lsb,
                    width: bits,
                    description,
                }
            })
            .collect();
        Record {
            name,
            width,
            fields,
        }
    }

    /// A node: the intervals that bound its children, and a link word.
    pub fn node(format: Format) -> Self {
        let w = format.width();
        let mut parts = vec![
            (
                "left_lo",
                w,
                "least coordinate of the left child on its axis",
            ),
            (
                "left_hi",
                w,
                "greatest coordinate of the left child on its axis",
            ),
            (
                "right_lo",
                w,
                "least coordinate of the right child on its axis",
            ),
            (
                "right_hi",
                w,
                "greatest coordinate of the right child on its axis",
            ),
        ];
        parts.extend(LINK_WORD);
        Record::new("node", &parts)
    }

    /// A vertex's position.
    pub fn vertex(format: Format) -> Self {
        let w = format.width();
        Record::new(
            "vertex",
            &[
                ("x", w, "first coordinate"),
                ("y", w, "second coordinate"),
                ("z", w, "third coordinate"),
            ],
        )
    }

    /// The box of an object, as the update processor writes it.
    pub fn bounding_box(format: Format) -> Self {
        let w = format.width();
        Record::new(
            "box",
            &[
                ("lo_x", w, "least first coordinate"),
                ("lo_y", w, "least second coordinate"),
                ("lo_z", w, "least third coordinate"),
                ("hi_x", w, "greatest first coordinate"),
                ("hi_y", w, "greatest second coordinate"),
                ("hi_z", w, "greatest third coordinate"),
            ],
        )
    }

    /// A triangle: its vertices' indices in the mesh's order and its number in the mesh.
    pub fn triangle() -> Self {
        Record::new(
            "triangle",
            &[
                ("v0", 32, "index of the first vertex"),
                ("v1", 32, "index of the second vertex"),
                ("v2", 32, "index of the third vertex"),
                ("number", 32, "the triangle's number in its mesh"),
            ],
        )
    }

    /// An instance: the index of its six vectors, its object's root and its number. The record has the width of a triangle
    /// record and is in the same array, with the number in the same bits.
    pub fn instance() -> Self {
        Record::new(
            "instance",
            &[
                ("vectors", 32, "index of the first of its six vectors"),
                ("root", 32, "root link word of its object"),
                ("unused", 32, "0"),
                ("number", 32, "the instance's number in the scene"),
            ],
        )
    }

    /// A row of the skinning processor's influences: [`INFLUENCES_PER_ROW`] of them.
    pub fn influence_row(format: Format) -> Self {
        let w = format.width();
        let names = [
            ["weight0", "joint0", "last0"],
            ["weight1", "joint1", "last1"],
            ["weight2", "joint2", "last2"],
            ["weight3", "joint3", "last3"],
        ];
        let parts: Vec<_> = names
            .into_iter()
            .flat_map(|[weight, joint, last]| {
                [
                    (
                        weight,
                        w - 1,
                        "the joint's weight, without its sign, which is 0",
                    ),
                    (joint, JOINT_BITS, "the joint's place in the palette"),
                    (last, 1, "the vertex has no further influence"),
                ]
            })
            .collect();
        Record::new("influence_row", &parts)
    }

    /// A hit, as the chip writes it.
    pub fn hit(format: Format) -> Self {
        let w = format.width();
        Record::new(
            "hit",
            &[
                ("t", w, "distance"),
                ("u", w, "weight of the second vertex"),
                ("v", w, "weight of the third vertex"),
                ("triangle", 32, "the triangle's number in its mesh"),
                (
                    "instance",
                    24,
                    "the instance's number in the scene, modulo 2^24",
                ),
            ],
        )
    }

    /// The link word of a node; alone, the root of an object.
    pub fn link_word() -> Self {
        Record::new("link_word", &LINK_WORD)
    }

    /// The field with this name.
    ///
    /// # Panics
    /// If the record has no such field.
    pub fn field(&self, name: &str) -> &Field {
        self.fields
            .iter()
            .find(|field| field.name == name)
            .unwrap_or_else(|| panic!("a {} record has no field {name}", self.name))
    }

    /// The value of a named field in a record of little-endian `words`.
    pub fn get(&self, words: &[u32], name: &str) -> u64 {
        self.field(name).get(words)
    }

    /// Stores a named field in a record of little-endian `words`.
    pub fn set(&self, words: &mut [u32], name: &str, value: u64) {
        self.field(name).set(words, value);
    }

    /// Number of 32-bit words per record in an array.
    pub fn words(&self) -> usize {
        self.width.div_ceil(32) as usize
    }

    /// Number of hexadecimal digits of a record.
    pub fn hex_digits(&self) -> usize {
        self.width.div_ceil(4) as usize
    }

    /// The records of an array as text for `$readmemh`: one line per record, most significant digit first.
    ///
    /// # Panics
    /// If `words` does not contain whole records.
    pub fn hex_lines(&self, words: &[u32]) -> String {
        assert_eq!(words.len() % self.words(), 0, "whole records");
        let digits = self.hex_digits();
        let mut lines = String::with_capacity(words.len() / self.words() * (digits + 1));
        for record in words.chunks_exact(self.words()) {
            for digit in (0..digits).rev() {
                let nibble = record[digit / 8] >> (4 * (digit % 8)) & 15;
                lines.push(char::from_digit(nibble, 16).expect("a nibble"));
            }
            lines.push('\n');
        }
        lines
    }

    /// Parses the lines that [`Record::hex_lines`] writes into the words of an array.
    ///
    /// # Errors
    /// Names the first line that is not a record.
    pub fn words_of_hex(&self, lines: &str) -> Result<Vec<u32>> {
        let mut words = Vec::new();
        for (number, line) in lines.lines().enumerate() {
            let start = words.len();
            words.resize(start + self.words(), 0);
            ensure!(
                line.len() == self.hex_digits(),
                "line {}: a {} record has {} hexadecimal digits, not {}",
                number + 1,
                self.name,
                self.hex_digits(),
                line.len()
            );
            for (digit, character) in line.chars().rev().enumerate() {
                let Some(nibble) = character.to_digit(16) else {
                    bail!(
                        "line {}: {character:?} is not a hexadecimal digit",
                        number + 1
                    );
                };
                words[start + digit / 8] |= nibble << (4 * (digit % 8));
            }
        }
        Ok(words)
    }
}

const LINK_WORD: [(&str, u32, &str); 5] = [
    (
        "link",
        LINK_BITS,
        "index of the inner child, of the left one of two, or of the right leaf's record",
    ),
    ("left_leaf", 1, "the left child is a triangle"),
    ("right_leaf", 1, "the right child is a triangle"),
    (
        "left_axis",
        2,
        "axis of the left child's interval: 0 x, 1 y, 2 z",
    ),
    (
        "right_axis",
        2,
        "axis of the right child's interval: 0 x, 1 y, 2 z",
    ),
];

/// The positions of a node's children, and the axes of their intervals.
///
/// As a root: if `left_leaf` is set, the tree is one leaf, record \[link]; otherwise link is the root node's index.
/// `right_leaf` marks the root of a top-level tree, whose leaves are instances. The other fields are 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct LinkWord {
    /// Less than 2²⁶.
    pub link: u32,
    pub left_leaf: bool,
    pub right_leaf: bool,
    /// 0 = x, 1 = y, 2 = z.
    pub left_axis: u8,
    /// 0 = x, 1 = y, 2 = z; equal to `left_axis` in a machine with one axis per node.
    pub right_axis: u8,
}

impl LinkWord {
    /// The link word's 32 bits.
    ///
    /// # Panics
    /// If a field does not fit.
    pub fn pack(self) -> u32 {
        assert!(u64::from(self.link) < MOST_RECORDS && self.left_axis < 4 && self.right_axis < 4);
        self.link
            | u32::from(self.left_leaf) << LINK_BITS
            | u32::from(self.right_leaf) << (LINK_BITS + 1)
            | u32::from(self.left_axis) << (LINK_BITS + 2)
            | u32::from(self.right_axis) << (LINK_BITS + 4)
    }

    pub fn unpack(word: u32) -> Self {
        LinkWord {
            link: word & ((1 << LINK_BITS) - 1),
            left_leaf: word >> LINK_BITS & 1 == 1,
            right_leaf: word >> (LINK_BITS + 1) & 1 == 1,
            left_axis: (word >> (LINK_BITS + 2) & 3) as u8,
            right_axis: (word >> (LINK_BITS + 4) & 3) as u8,
        }
    }

    /// The children of the node at index `own`, each the index of a node or of a record.
    pub fn children(self, own: u32) -> [Target; 2] {
        match (self.left_leaf, self.right_leaf) {
            (false, false) => [Target::Node(self.link), Target::Node(self.link + 1)],
            (true, false) => [Target::Record(own), Target::Node(self.link)],
            (false, true) => [Target::Node(self.link), Target::Record(own)],
            (true, true) => [Target::Record(own), Target::Record(self.link)],
        }
    }

    /// The node or record that a root link word names.
    pub fn root(self) -> Target {
        if self.left_leaf {
            Target::Record(self.link)
        } else {
            Target::Node(self.link)
        }
    }
}

/// The target of a link, by absolute index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Target {
    Node(u32),
    /// The child is a leaf: a triangle record, or an instance record in a top-level tree.
    Record(u32),
}

/// A node in decoded form.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Node {
    /// \[minimum, maximum] coordinate of the left child on `link.left_axis`.
    pub left: [f64; 2],
    /// \[minimum, maximum] coordinate of the right child on `link.right_axis`.
    pub right: [f64; 2],
    pub link: LinkWord,
}

/// A triangle record in decoded form.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TriangleRecord {
    /// Vertex indices in the mesh's order.
    pub vertices: [u32; 3],
    /// The triangle's number in its mesh.
    pub number: u32,
}

/// An instance record in decoded form. It shares the array with triangle records; conversions keep its bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct InstanceRecord {
    /// Index of the first of its six vectors in the vertex array: the columns of the matrix that transforms a point of the
    /// world into object space, then the minimum and the maximum corner of its box in the world.
    pub vectors: u32,
    /// Its object's root.
    pub root: LinkWord,
    /// Its number in the scene, which is used in results and to resolve ties.
    pub number: u32,
}

impl InstanceRecord {
    /// Number of vectors of an instance in the vertex array.
    pub const VECTORS: usize = 6;
}

impl From<InstanceRecord> for TriangleRecord {
    /// The triangle record of the same bits.
    fn from(instance: InstanceRecord) -> Self {
        TriangleRecord {
            vertices: [instance.vectors, instance.root.pack(), 0],
            number: instance.number,
        }
    }
}

impl From<TriangleRecord> for InstanceRecord {
    /// The instance record of the same bits, without the unused field.
    fn from(record: TriangleRecord) -> Self {
        let [vectors, root, _] = record.vertices;
        InstanceRecord {
            vectors,
            root: LinkWord::unpack(root),
            number: record.number,
        }
    }
}

/// The contents of the machine's memory for a scene: arrays indexed by the absolute indices in links and records. Numbers
/// are values of `format`. [`super::InstancedImage`] creates images of two levels.
#[derive(Clone, Debug, PartialEq)]
pub struct MemoryImage {
    pub format: Format,
    /// The same number as `records`: the last node slot of an object is unused, as are slots below its base.
    pub nodes: Vec<Node>,
    /// Triangle records; in the top-level tree, the bits of instance records ([`InstanceRecord`]).
    pub records: Vec<TriangleRecord>,
    pub vertices: Vec<[f64; 3]>,
    /// `right_leaf` marks a scene of two levels.
    pub root: LinkWord,
    /// Minimum and maximum corner of the box of all triangles, or of all instances' boxes in the world.
    pub bounds: ([f64; 3], [f64; 3]),
}

/// The slots of one object in the node and record arrays, as [`place`] fills them.
#[derive(Clone, Debug, PartialEq)]
pub struct Placement {
    /// One per triangle; the last one is unused.
    pub nodes: Vec<Node>,
    /// One per triangle.
    pub records: Vec<TriangleRecord>,
    pub root: LinkWord,
}

/// The default order of the nodes: all descendants of a node's children, then the children next to each other. Every
/// subtree is contiguous except for its root.
pub fn default_order(tree: &Tree) -> Vec<u32> {
    // In reverse order: a node, then its children from right to left, the descendants of the left one last.
    let Child::Inner(root) = tree.root else {
        return Vec::new();
    };
    let mut order = Vec::with_capacity(tree.nodes.len());
    order.push(root);
    let mut open = vec![root];
    while let Some(index) = open.pop() {
        let node = &tree.nodes[index as usize];
        // The right child's descendants come first in this order, so they are pushed last.
        for child in node.children {
            if let Child::Inner(child) = child {
                open.push(child);
            }
        }
        for child in node.children.iter().rev() {
            if let Child::Inner(child) = *child {
                order.push(child);
            }
        }
    }
    order.reverse();
    order
}

/// Lays out a tree at `base`, with its nodes in `order` (indices into `tree.nodes`): children before parents, and two
/// inner children of one node next to each other, left first. `vertex_base` is added to vertex indices.
///
/// # Errors
/// If a link cannot address the object.
///
/// # Panics
/// If `order` violates these rules.
pub fn place(
    tree: &Tree,
    refit: &Refit,
    triangles: &[[u32; 3]],
    order: &[u32],
    base: u32,
    vertex_base: u32,
) -> Result<Placement> {
    place_records(tree, refit, order, base, |number| TriangleRecord {
        vertices: triangles[number as usize].map(|v| v + vertex_base),
        number,
    })
}

/// As [`place`], for leaves of any kind: `record` returns the record of a leaf's number.
pub(super) fn place_records(
    tree: &Tree,
    refit: &Refit,
    order: &[u32],
    base: u32,
    record: impl Fn(u32) -> TriangleRecord,
) -> Result<Placement> {
    let count = tree.triangle_count();
    check_capacity(u64::from(base), count as u64, LINK_BITS)?;
    if let Child::Leaf(number) = tree.root {
        return Ok(Placement {
            nodes: vec![Node::default()],
            records: vec![record(number)],
            root: LinkWord {
                link: base,
                left_leaf: true,
                ..LinkWord::default()
            },
        });
    }
    assert_eq!(order.len(), tree.nodes.len(), "an order names every node");

    const UNPLACED: u32 = u32::MAX;
    let mut slot_of = vec![UNPLACED; tree.nodes.len()];
    let mut nodes = vec![Node::default(); count];
    let mut records = vec![TriangleRecord::default(); count];
    // Nodes whose right leaf still needs a record. In each finished subtree, the nodes with two leaves outnumber the nodes
    // with two inner children by one, so a node waits whenever a record is free.
    let mut waiting: Vec<(usize, u32)> = Vec::new();
    for (slot, &index) in order.iter().enumerate() {
        let node = &tree.nodes[index as usize];
        let placed = |child: u32| {
            let slot = slot_of[child as usize];
            assert_ne!(slot, UNPLACED, "children precede their parents");
            base + slot
        };
        let mut link = LinkWord {
            left_axis: node.axes[0],
            right_axis: node.axes[1],
            ..LinkWord::default()
        };
        match node.children {
            [Child::Inner(left), Child::Inner(right)] => {
                link.link = placed(left);
                assert_eq!(link.link + 1, placed(right), "siblings lie side by side");
                let (owner, number) = waiting.pop().expect("a right leaf waits");
                nodes[owner].link.link = base + slot as u32;
                records[slot] = record(number);
            }
            [Child::Leaf(leaf), Child::Inner(inner)] => {
                link.link = placed(inner);
                link.left_leaf = true;
                records[slot] = record(leaf);
            }
            [Child::Inner(inner), Child::Leaf(leaf)] => {
                link.link = placed(inner);
                link.right_leaf = true;
                records[slot] = record(leaf);
            }
            [Child::Leaf(left), Child::Leaf(right)] => {
                link.left_leaf = true;
                link.right_leaf = true;
                records[slot] = record(left);
                waiting.push((slot, right));
            }
        }
        let [left, right] = refit.intervals[index as usize];
        nodes[slot] = Node { left, right, link };
        assert_eq!(slot_of[index as usize], UNPLACED, "a node is placed once");
        slot_of[index as usize] = slot as u32;
    }
    let (owner, number) = waiting.pop().expect("the last record is free");
    nodes[owner].link.link = base + count as u32 - 1;
    records[count - 1] = record(number);
    Ok(Placement {
        nodes,
        records,
        root: LinkWord {
            link: base + count as u32 - 2,
            ..LinkWord::default()
        },
    })
}

/// Checks that `triangles` records at `base` can be addressed with `address_bits` bits (at most [`LINK_BITS`]).
///
/// # Errors
/// Names the counts and the remedy.
pub fn check_capacity(base: u64, triangles: u64, address_bits: u32) -> Result<()> {
    let most = 1u64 << address_bits.min(LINK_BITS);
    ensure!(
        base + triangles <= most,
        "the scene is too large for its address space: {} triangles, but {} address bits hold {most}; \
         simplify the mesh or widen the address",
        base + triangles,
        address_bits.min(LINK_BITS),
    );
    Ok(())
}

impl MemoryImage {
    /// Creates the image of one mesh and its tree at base 0, with nodes in the default order. `vertices` are values of `format`.
    ///
    /// # Errors
    /// If the mesh is too large for the link word.
    pub fn new(
        format: Format,
        vertices: &[[f64; 3]],
        triangles: &[[u32; 3]],
        tree: &Tree,
    ) -> Result<Self> {
        let refit = tree.refit(vertices, triangles);
        let placement = place(tree, &refit, triangles, &default_order(tree), 0, 0)?;
        let Bounds { lo, hi } = refit.root;
        Ok(MemoryImage {
            format,
            nodes: placement.nodes,
            records: placement.records,
            vertices: vertices.to_vec(),
            root: placement.root,
            bounds: (lo, hi),
        })
    }

    /// Whether the scene has two levels, that is, the root is that of a top-level tree.
    pub fn is_instanced(&self) -> bool {
        self.root.right_leaf
    }

    /// The indices of the records below a root, in ascending order: an object's triangles, or the top-level tree's instances.
    ///
    /// # Errors
    /// If a link violates the layout.
    pub fn records_below(&self, root: LinkWord) -> Result<Vec<u32>> {
        let mut records = Vec::new();
        Walk::new(self).tree(root, |record, _| records.push(record))?;
        records.sort_unstable();
        Ok(records)
    }

    /// The consecutive instance records of the top-level tree, in ascending order. Empty in a scene of one
    /// level.
    ///
    /// # Errors
    /// If a link violates the layout, or if the records are not consecutive.
    pub fn instance_records(&self) -> Result<std::ops::Range<u32>> {
        if !self.is_instanced() {
            return Ok(0..0);
        }
        let records = self.records_below(self.root)?;
        let first = records[0];
        let range = first..first + records.len() as u32;
        ensure!(
            records.last() == Some(&(range.end - 1)),
            "the {} instance records do not lie one after another from {first} on; build the top-level tree again",
            records.len()
        );
        Ok(range)
    }

    /// Number of inner nodes, in a scene of one level.
    pub fn node_count(&self) -> usize {
        self.records.len() - 1
    }

    /// The words of the node array, [`Record::words`] per node.
    pub fn node_words(&self) -> Vec<u32> {
        let layout = Record::node(self.format);
        let numbers = ["left_lo", "left_hi", "right_lo", "right_hi"].map(|n| *layout.field(n));
        let link = link_field(&layout);
        pack(&layout, &self.nodes, |node, words| {
            let values = [node.left[0], node.left[1], node.right[0], node.right[1]];
            for (field, value) in numbers.iter().zip(values) {
                field.set(words, self.format.to_bits(value));
            }
            link.set(words, u64::from(node.link.pack()));
        })
    }

    /// Decodes the words of a node array.
    pub fn nodes_of_words(format: Format, words: &[u32]) -> Vec<Node> {
        let layout = Record::node(format);
        let number = |words: &[u32], name| format.to_f64(layout.get(words, name));
        words
            .chunks_exact(layout.words())
            .map(|words| Node {
                left: [number(words, "left_lo"), number(words, "left_hi")],
                right: [number(words, "right_lo"), number(words, "right_hi")],
                link: LinkWord::unpack(link_field(&layout).get(words) as u32),
            })
            .collect()
    }

    /// The words of the record array, [`Record::words`] per record.
    pub fn record_words(&self) -> Vec<u32> {
        let layout = Record::triangle();
        let fields = ["v0", "v1", "v2", "number"].map(|name| *layout.field(name));
        pack(&layout, &self.records, |record, words| {
            let [v0, v1, v2] = record.vertices;
            for (field, value) in fields.iter().zip([v0, v1, v2, record.number]) {
                field.set(words, u64::from(value));
            }
        })
    }

    /// Decodes the words of a record array.
    pub fn records_of_words(words: &[u32]) -> Vec<TriangleRecord> {
        let layout = Record::triangle();
        words
            .chunks_exact(layout.words())
            .map(|words| TriangleRecord {
                vertices: ["v0", "v1", "v2"].map(|name| layout.get(words, name) as u32),
                number: layout.get(words, "number") as u32,
            })
            .collect()
    }

    /// The words of the vertex array, [`Record::words`] per vertex.
    pub fn vertex_words(&self) -> Vec<u32> {
        vector_words(self.format, &self.vertices)
    }

    /// Decodes the words of a vertex array.
    pub fn vertices_of_words(format: Format, words: &[u32]) -> Vec<[f64; 3]> {
        let layout = Record::vertex(format);
        words
            .chunks_exact(layout.words())
            .map(|words| ["x", "y", "z"].map(|name| format.to_f64(layout.get(words, name))))
            .collect()
    }

    /// Number of inner nodes on the longest path from the root, over both levels. Each of them may push one entry on the
    /// traversal stack.
    ///
    /// # Errors
    /// If a link or record violates the layout.
    pub fn depth(&self) -> Result<u32> {
        let mut walk = Walk::new(self);
        let mut deepest = 0;
        if !self.is_instanced() {
            walk.tree(self.root, |_, depth| deepest = deepest.max(depth))?;
            let missed = walk.reached.iter().filter(|seen| !**seen).count();
            ensure!(
                missed == 0,
                "{missed} of {} triangle records are not reached from the root; build the tree again",
                walk.reached.len()
            );
            return Ok(deepest);
        }
        let mut instances = Vec::new();
        walk.tree(self.root, |record, depth| instances.push((record, depth)))?;
        // Walk each object once, independent of the number of its instances.
        let mut object_depths = HashMap::new();
        for (index, top_depth) in instances {
            let root = InstanceRecord::from(self.records[index as usize]).root;
            ensure!(
                !root.right_leaf,
                "instance record {index} names the root of a top-level tree: levels do not nest; name an object's root"
            );
            let depth = match object_depths.entry(root) {
                Entry::Occupied(known) => *known.get(),
                Entry::Vacant(unknown) => {
                    let mut depth = 0;
                    (walk.tree(root, |_, leaf_depth| depth = depth.max(leaf_depth))).map_err(
                        |error| anyhow!("the object of instance record {index}: {error}"),
                    )?;
                    *unknown.insert(depth)
                }
            };
            deepest = deepest.max(top_depth + depth);
        }
        Ok(deepest)
    }

    /// Checks an image for a machine with a stack of `stack_depth` entries. Every link must be in range. Every record must be
    /// reached exactly once; in two levels, several instances may share an object, and an object need not be instanced.
    /// Indices of vertices and vectors must be in range, instances must be numbered from 0, and the tree must not be deeper
    /// than the stack. The size of memory is checked by [`check_capacity`].
    ///
    /// # Errors
    /// One line that describes the fault and the remedy.
    pub fn check(&self, stack_depth: u32) -> Result<()> {
        check_capacity(0, self.records.len() as u64, LINK_BITS)?;
        ensure!(!self.records.is_empty(), "the scene has no triangles");
        let instances = self.instance_records()?;
        self.check_instances(instances.clone())?;
        for (index, record) in (0u32..).zip(&self.records) {
            if instances.contains(&index) {
                continue;
            }
            for vertex in record.vertices {
                ensure!(
                    (vertex as usize) < self.vertices.len(),
                    "triangle record {index} names vertex {vertex}, but there are {}; correct the mesh",
                    self.vertices.len()
                );
            }
        }
        let depth = self.depth()?;
        ensure!(
            depth <= stack_depth || self.is_instanced(),
            "the tree is {depth} nodes deep but the traversal stack holds {stack_depth} entries; \
             build it with a greatest depth of {stack_depth}"
        );
        ensure!(
            depth <= stack_depth,
            "both levels together are {depth} nodes deep but the traversal stack holds {stack_depth} entries; \
             build them with a greatest depth of {stack_depth} in all"
        );
        Ok(())
    }

    /// Checks instance records except for their roots.
    fn check_instances(&self, records: std::ops::Range<u32>) -> Result<()> {
        let count = records.len();
        let mut numbered = vec![false; count];
        for index in records {
            let record = self.records[index as usize];
            let InstanceRecord {
                vectors,
                root,
                number,
            } = record.into();
            ensure!(
                vectors as usize + InstanceRecord::VECTORS <= self.vertices.len(),
                "instance record {index} names vectors {vectors} and the {} after it, but there are {}; \
                 build the top-level tree again",
                InstanceRecord::VECTORS - 1,
                self.vertices.len()
            );
            ensure!(
                root.left_axis == 0 && root.right_axis == 0 && record.vertices[2] == 0,
                "instance record {index} has a field other than 0 where it must be 0; build the top-level tree again"
            );
            let Some(taken) = numbered.get_mut(number as usize) else {
                bail!(
                    "instance record {index} has the number {number}, but there are {count} instances, counted from 0; \
                     build the top-level tree again"
                );
            };
            ensure!(
                !std::mem::replace(taken, true),
                "two instances have the number {number}; build the top-level tree again"
            );
        }
        Ok(())
    }
}

/// Walks trees along their links and checks that nothing is reached twice.
struct Walk<'a> {
    image: &'a MemoryImage,
    visited: Vec<bool>,
    reached: Vec<bool>,
}

impl<'a> Walk<'a> {
    fn new(image: &'a MemoryImage) -> Self {
        Walk {
            image,
            visited: vec![false; image.nodes.len()],
            reached: vec![false; image.records.len()],
        }
    }

    /// Walks the tree of a root and calls `leaf` with each record's index and the number of inner nodes above it.
    fn tree(&mut self, root: LinkWord, mut leaf: impl FnMut(u32, u32)) -> Result<()> {
        let kind = if root.right_leaf {
            "instance"
        } else {
            "triangle"
        };
        let mut open = vec![(root.root(), 0)];
        while let Some((target, depth)) = open.pop() {
            match target {
                Target::Record(index) => {
                    let Some(seen) = self.reached.get_mut(index as usize) else {
                        bail!(
                            "a link leads to {kind} record {index}, but there are {}; build the tree again",
                            self.image.records.len()
                        );
                    };
                    ensure!(
                        !std::mem::replace(seen, true),
                        "{kind} record {index} is reached twice; build the tree again"
                    );
                    leaf(index, depth);
                }
                Target::Node(index) => {
                    let Some(seen) = self.visited.get_mut(index as usize) else {
                        bail!(
                            "a link leads to node {index}, but there are {}; build the tree again",
                            self.image.nodes.len()
                        );
                    };
                    ensure!(
                        !std::mem::replace(seen, true),
                        "node {index} is reached twice; build the tree again"
                    );
                    let link = self.image.nodes[index as usize].link;
                    ensure!(
                        link.left_axis < 3 && link.right_axis < 3,
                        "node {index} has an axis other than 0, 1 and 2; build the tree again"
                    );
                    open.extend(link.children(index).map(|child| (child, depth + 1)));
                }
            }
        }
        Ok(())
    }
}

/// The bits of a node's link word as one field.
fn link_field(node: &Record) -> Field {
    Field {
        name: "link_word",
        lsb: node.field("link").lsb,
        width: 32,
        description: "all fields of the link word",
    }
}

fn pack<T>(layout: &Record, items: &[T], fill: impl Fn(&T, &mut [u32])) -> Vec<u32> {
    let mut words = vec![0; items.len() * layout.words()];
    for (item, words) in items.iter().zip(words.chunks_exact_mut(layout.words())) {
        fill(item, words);
    }
    words
}

/// A matrix by its columns c_x, c_y, c_z, c_w: it maps the point (x, y, z) to c_x·x + c_y·y + c_z·z + c_w. In memory the
/// columns are consecutive vectors of the vertex array.
pub type Columns = [[f64; 3]; 4];

/// The influence of one joint on a vertex, as in the skinning processor's stream.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Influence {
    /// The joint's index in the palette.
    pub joint: u8,
    /// A value of the format; its sign is not stored.
    pub weight: f64,
    /// Whether this is the vertex's last influence.
    pub last: bool,
}

/// The words of the influence rows of a stream, [`Record::words`] of [`Record::influence_row`] per row. The last row is filled with zeros.
pub fn influence_words(format: Format, stream: &[Influence]) -> Vec<u32> {
    let layout = Record::influence_row(format);
    let rows: Vec<_> = stream.chunks(INFLUENCES_PER_ROW).collect();
    pack(&layout, &rows, |row, words| {
        for (influence, fields) in row.iter().zip(layout.fields.chunks_exact(3)) {
            let weight = format.to_bits(influence.weight) & !format.sign_bit();
            fields[0].set(words, weight);
            fields[1].set(words, influence.joint.into());
            fields[2].set(words, influence.last.into());
        }
    })
}

/// The influences in the words of whole rows, [`INFLUENCES_PER_ROW`] per row, including the filler in the last row.
pub fn influences_of_words(format: Format, words: &[u32]) -> Vec<Influence> {
    let layout = Record::influence_row(format);
    let row = |words| {
        let of = |fields: &[Field]| Influence {
            weight: format.to_f64(fields[0].get(words)),
            joint: fields[1].get(words) as u8,
            last: fields[2].get(words) != 0,
        };
        layout.fields.chunks_exact(3).map(of).collect::<Vec<_>>()
    };
    words.chunks_exact(layout.words()).flat_map(row).collect()
}

/// The words of vectors in the vertex array, [`Record::words`] of [`Record::vertex`] per vector: vertices, or the columns of
/// matrices (for a palette, `palette.as_flattened()`).
pub fn vector_words(format: Format, vectors: &[[f64; 3]]) -> Vec<u32> {
    let layout = Record::vertex(format);
    pack(&layout, vectors, |vector, words| {
        for (field, value) in layout.fields.iter().zip(vector) {
            field.set(words, format.to_bits(*value));
        }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::hdl::{Bundle, Specs};

    #[test]
    fn records_have_the_design_widths() {
        for (exponent, fraction) in [(7, 16), (3, 2), (8, 23), (10, 23)] {
            let format = Format::new(exponent, fraction).unwrap();
            assert_eq!(Record::node(format).width, 4 * format.width() + 32);
            assert_eq!(Record::vertex(format).width, 3 * format.width());
        }
        assert_eq!(Record::node(Format::FP24).width, 128);
        assert_eq!(Record::triangle().width, 128);
        assert_eq!(Record::link_word().width, 32);
    }

    #[test]
    fn bundles_have_the_records_fields() {
        fn alike(record: &Record, fields: &impl Specs) {
            let table = record.fields.iter().map(|f| (f.name.to_string(), f.width));
            let bundle = fields.fields().into_iter();
            let bundle = bundle.map(|(name, spec)| (name, spec.width));
            assert!(table.eq(bundle), "{}", record.name);
        }
        for (exponent, fraction) in [(7, 16), (3, 2), (10, 23)] {
            let format = Format::new(exponent, fraction).unwrap();
            alike(&Record::node(format), &fields::Node::of(format));
            alike(&Record::vertex(format), &fields::Vertex::of(format));
            alike(&Record::bounding_box(format), &fields::Box::of(format));
            let row = Record::influence_row(format);
            let influence = fields::Influence::of(format).fields();
            for (k, slot) in row.fields.chunks(influence.len()).enumerate() {
                let numbered = influence
                    .iter()
                    .map(|(name, spec)| (format!("{name}{k}"), spec.width));
                assert!(
                    slot.iter()
                        .map(|f| (f.name.to_string(), f.width))
                        .eq(numbered)
                );
            }
        }
        alike(&Record::link_word(), &fields::Link::of());
        alike(&Record::triangle(), &fields::Triangle::of());
        alike(&Record::instance(), &fields::Instance::of());
        // The hardware reads a record before it knows of which kind it is.
        let (triangle, instance) = (Record::triangle(), Record::instance());
        assert_eq!(instance.field("vectors").lsb, triangle.field("v0").lsb);
    }

    #[test]
    fn fields_read_back_and_leave_their_neighbours() {
        let seed = 0x5eed_0001;
        let mut random = fastrand::Rng::with_seed(seed);
        for (exponent, fraction) in [(7, 16), (3, 2), (10, 23)] {
            let format = Format::new(exponent, fraction).unwrap();
            for layout in [
                Record::node(format),
                Record::vertex(format),
                Record::triangle(),
            ] {
                let mut words: Vec<u32> = (0..layout.words()).map(|_| random.u32(..)).collect();
                for _ in 0..1000 {
                    let field = &layout.fields[random.usize(..layout.fields.len())];
                    let value = random.u64(..) & mask(field.width);
                    let before: Vec<u64> = layout.fields.iter().map(|f| f.get(&words)).collect();
                    field.set(&mut words, value);
                    for (other, before) in layout.fields.iter().zip(before) {
                        let expected = if other == field { value } else { before };
                        assert_eq!(
                            other.get(&words),
                            expected,
                            "seed {seed:#x}: {}",
                            other.name
                        );
                    }
                }
            }
        }
    }

    #[test]
    fn link_word_packs_as_its_fields_say() {
        let layout = Record::link_word();
        let link = LinkWord {
            link: 0x2ab_cdef,
            left_leaf: true,
            right_leaf: false,
            left_axis: 2,
            right_axis: 1,
        };
        let word = [link.pack()];
        assert_eq!(LinkWord::unpack(word[0]), link);
        assert_eq!(layout.get(&word, "link"), 0x2ab_cdef);
        assert_eq!(layout.get(&word, "left_leaf"), 1);
        assert_eq!(layout.get(&word, "right_leaf"), 0);
        assert_eq!(layout.get(&word, "left_axis"), 2);
        assert_eq!(layout.get(&word, "right_axis"), 1);
    }

    #[test]
    fn hex_lines_read_as_one_number_a_record() {
        let layout = Record::vertex(Format::FP24);
        // 72 bits are 18 digits; the third word has two of them.
        let words = [0x89ab_cdef, 0x0123_4567, 0xa5, 1, 2, 3];
        let lines = layout.hex_lines(&words);
        assert_eq!(lines, "a50123456789abcdef\n030000000200000001\n");
        assert_eq!(layout.words_of_hex(&lines).unwrap(), words);
        let error = layout.words_of_hex("a5").unwrap_err().to_string();
        assert!(
            error.starts_with("line 1: a vertex record has 18"),
            "{error}"
        );
        let error = layout.words_of_hex("g50123456789abcdef").unwrap_err();
        assert!(
            error.to_string().contains("'g' is not a hexadecimal digit"),
            "{error}"
        );
    }

    #[test]
    fn capacity_says_what_does_not_fit() {
        assert!(check_capacity(0, 1 << 26, 32).is_ok());
        let error = check_capacity(1, 1 << 26, 32).unwrap_err().to_string();
        assert!(error.contains("67108865 triangles"), "{error}");
        let error = check_capacity(0, 1025, 10).unwrap_err().to_string();
        assert!(error.contains("too large for its address space"), "{error}");
    }

    #[test]
    fn influences_read_back_from_their_rows() {
        let seed = 0x5eed_0002;
        let mut random = fastrand::Rng::with_seed(seed);
        for (exponent, fraction) in [(7, 16), (3, 2), (10, 23)] {
            let format = Format::new(exponent, fraction).unwrap();
            for count in [0, 1, 4, 5, 11] {
                let mut any = || Influence {
                    joint: random.u8(..),
                    weight: format.to_f64(random.u64(..format.sign_bit())),
                    last: random.bool(),
                };
                let mut stream: Vec<_> = (0..count).map(|_| any()).collect();
                // NaN is not equal to itself.
                stream.iter_mut().for_each(|influence| {
                    if influence.weight.is_nan() {
                        influence.weight = f64::INFINITY;
                    }
                });
                let words = influence_words(format, &stream);
                let read = influences_of_words(format, &words);
                assert_eq!(
                    read.len(),
                    stream.len().next_multiple_of(INFLUENCES_PER_ROW)
                );
                assert_eq!(read[..count], stream, "seed {seed:#x}");
                let filled = read[count..].iter().all(|i| *i == Influence::default());
                assert!(filled, "seed {seed:#x}");
            }
        }
        let nan = Influence {
            weight: f64::NAN,
            ..Influence::default()
        };
        let words = influence_words(Format::FP24, &[nan]);
        assert!(influences_of_words(Format::FP24, &words)[0].weight.is_nan());
    }
}
