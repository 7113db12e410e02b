//! The layouts of one machine's files, and the conversion of values to the fields of their lines.

use super::layout::{Kind, Layout};
use crate::bkd::layout::{LINK_BITS, LinkWord, Node, Record, Target};
use crate::config::{Config, TriangleTest};
use crate::float::Format;
use crate::golden::raycast::RaySet;
use crate::golden::{Instance, MOST_RAYS, RaySetup, Transformed};
use crate::port::{Hit, Ray};

use Kind::{Flag, Mask, Number, Unsigned};

/// Bits of a slot number, the same for all packet sizes.
const SLOT_BITS: u32 = MOST_RAYS.ilog2();

/// The parameters of a machine on which its vectors depend.
#[derive(Clone, Debug)]
pub struct Shape {
    pub format: Format,
    pub test: TriangleTest,
    /// Rays per packet.
    pub rays: usize,
    pub tag_bits: u32,
    pub axes_per_node: u32,
    pub address_bits: u32,
}

/// Values of an expected line, each with a flag that says whether it is compared.
pub type Expected = Vec<(u64, bool)>;

impl Shape {
    pub fn new(config: &Config) -> Self {
        Shape {
            format: config.format(),
            test: config.triangle_test,
            rays: config.rays_per_packet as usize,
            tag_bits: config.tag_bits,
            axes_per_node: config.axes_per_node,
            address_bits: config.address_bits,
        }
    }

    pub fn number(&self) -> u32 {
        self.format.width()
    }

    pub fn bits(&self, number: f64) -> u64 {
        self.format.to_bits(number)
    }

    pub fn vector(&self, vector: [f64; 3]) -> [u64; 3] {
        vector.map(|number| self.bits(number))
    }

    /// The mask of all rays of a packet.
    pub fn all(&self) -> u8 {
        ((1u32 << self.rays) - 1) as u8
    }

    pub fn scene(&self) -> Layout {
        Layout::default()
            .field(
                "root",
                Record::link_word().width,
                Unsigned,
                "root link word",
            )
            .vector(
                "lo",
                self.number(),
                "minimum corner of the box of all triangles",
            )
            .vector(
                "hi",
                self.number(),
                "maximum corner of the box of all triangles",
            )
    }

    pub fn scene_values(&self, root: LinkWord, (lo, hi): ([f64; 3], [f64; 3])) -> Vec<u64> {
        let mut values = vec![u64::from(root.pack())];
        values.extend(self.vector(lo));
        values.extend(self.vector(hi));
        values
    }

    fn with_ray(&self, layout: Layout) -> Layout {
        let w = self.number();
        layout
            .vector("origin", w, "the ray's origin")
            .vector("direction", w, "the ray's direction")
            .field("tmin", w, Number, "minimum distance of a hit")
            .field("tmax", w, Number, "maximum distance of a hit")
            .field("active", 1, Flag, "1 if the slot contains a ray")
            .field("any_hit", 1, Flag, "1 for an any-hit ray")
    }

    pub fn raycast_rays(&self) -> Layout {
        self.with_ray(Layout::default())
            .field("tag", self.tag_bits, Unsigned, "the packet's tag")
    }

    /// The fields of a ray at the ports of the ray casting unit and of ray setup.
    pub fn ray_values(&self, ray: &Ray) -> Vec<u64> {
        let mut values = vec![];
        values.extend(self.vector(ray.origin));
        values.extend(self.vector(ray.direction));
        values.extend([
            self.bits(ray.tmin),
            self.bits(ray.tmax),
            u64::from(ray.active),
            u64::from(ray.any_hit),
        ]);
        values
    }

    pub fn raycast_hits(&self) -> Layout {
        let w = self.number();
        Layout::default()
            .field("t", w, Number, "distance in multiples of the direction")
            .field("u", w, Number, "weight of the second vertex")
            .field("v", w, Number, "weight of the third vertex")
            .field(
                "instance",
                32,
                Unsigned,
                "number of the instance, all ones if there is none",
            )
            .field(
                "triangle",
                32,
                Unsigned,
                "number of the triangle, all ones if there is none",
            )
            .field("tag", self.tag_bits, Unsigned, "the packet's tag")
    }

    pub fn hit_values(&self, hit: &Hit, tag: u64) -> Vec<u64> {
        vec![
            self.bits(hit.t),
            self.bits(hit.u),
            self.bits(hit.v),
            u64::from(hit.instance),
            u64::from(hit.triangle),
            tag,
        ]
    }

    pub fn raycast_packets(&self) -> Layout {
        Layout::default()
            .field("tag", self.tag_bits, Unsigned, "the packet's tag")
            .field(
                "first_step",
                32,
                Unsigned,
                "line of the first packet step in packet_step_*.hex, counted from 0",
            )
            .field("steps", 32, Unsigned, "number of packet steps")
            .field(
                "first_test",
                32,
                Unsigned,
                "line of the first ray-triangle test in triangle_test_*.hex, counted from 0",
            )
            .field("tests", 32, Unsigned, "number of ray-triangle tests")
            .field(
                "first_transform",
                32,
                Unsigned,
                "line of the first ray transformation in ray_transform_*.hex, counted from 0",
            )
            .field("transforms", 32, Unsigned, "number of ray transformations")
            .field(
                "scene",
                32,
                Unsigned,
                "line of the scene in scene.hex, counted from 0",
            )
            .field(
                "block",
                32,
                Unsigned,
                "number of the block in the picture, all ones if there is none",
            )
    }

    pub fn ray_transform_stimulus(&self) -> Layout {
        let w = self.number();
        let mut layout = Layout::default()
            .field("slot", SLOT_BITS, Unsigned, "slot of the ray in its packet")
            .field(
                "record",
                LINK_BITS,
                Unsigned,
                "index of the instance's record",
            );
        for column in ["cx", "cy", "cz", "cw"] {
            let what = format!("column c_{} of the instance's matrix", &column[1..]);
            layout = layout.vector(column, w, &what);
        }
        layout
            .vector("lo", w, "minimum corner of the instance's box in the world")
            .vector("hi", w, "maximum corner of the instance's box in the world")
            .vector("origin", w, "the ray's origin in the world")
            .vector("direction", w, "the ray's direction in the world")
            .vector("reciprocal", w, "reciprocal of the direction in the world")
            .field("signs", 3, Mask, "sign bits of the direction in the world")
    }

    pub fn ray_transform_values(
        &self,
        slot: u8,
        record: u32,
        instance: &Instance,
        ray: &RaySetup,
    ) -> Vec<u64> {
        let mut values = vec![u64::from(slot), u64::from(record)];
        let (lo, hi) = instance.bounds;
        let [x, y, z, w] = instance.columns;
        let vectors = [
            x,
            y,
            z,
            w,
            lo,
            hi,
            ray.origin,
            ray.direction,
            ray.reciprocal,
        ];
        for vector in vectors {
            values.extend(self.vector(vector));
        }
        values.push(signs(ray));
        values
    }

    pub fn ray_transform_expected(&self) -> Layout {
        let w = self.number();
        Layout::default()
            .vector("origin", w, "the ray's origin in object space")
            .vector("direction", w, "the ray's direction in object space")
            .field("near", w, Number, "near of the ray's window")
            .field("far", w, Number, "far of the ray's window")
    }

    pub fn ray_transform_outcome(&self, transformed: &Transformed) -> Expected {
        let [near, far] = transformed.window;
        let mut values = vec![];
        values.extend(self.vector(transformed.ray.origin));
        values.extend(self.vector(transformed.ray.direction));
        values.extend([self.bits(near), self.bits(far)]);
        values.into_iter().map(|value| (value, true)).collect()
    }

    pub fn ray_setup_stimulus(&self) -> Layout {
        self.with_ray(Layout::default())
    }

    pub fn ray_setup_expected(&self) -> Layout {
        let w = self.number();
        let layout = Layout::default()
            .field(
                "enters",
                1,
                Flag,
                "1 if the ray is in the packet's initial mask",
            )
            .field("near", w, Number, "near of the ray in the scene's box")
            .field("far", w, Number, "far of the ray in the scene's box")
            .field(
                "tmin",
                w,
                Number,
                "tmin, with +0 for a zero; compared only for a valid ray",
            )
            .field(
                "tmax",
                w,
                Number,
                "tmax, with +0 for a zero; compared only for a valid ray",
            )
            .field("any_hit", 1, Flag, "as in the stimulus");
        self.with_setup(layout)
    }

    /// Appends the results of ray setup that the triangle test reads, except for the limits.
    fn with_setup(&self, layout: Layout) -> Layout {
        let w = self.number();
        let layout = layout
            .vector("origin", w, "the ray's origin")
            .vector("reciprocal", w, "reciprocal of the ray's direction")
            .field("signs", 3, Mask, "sign bits of the ray's direction");
        match self.test {
            TriangleTest::MollerTrumbore => layout.vector("direction", w, "the ray's direction"),
            TriangleTest::Watertight => layout
                .field("kz", 2, Unsigned, "axis k_z: 0 x, 1 y, 2 z")
                .field("shear_x", w, Number, "S_x")
                .field("shear_y", w, Number, "S_y")
                .field("shear_z", w, Number, "S_z"),
        }
    }

    fn setup_values(&self, ray: &RaySetup) -> Vec<u64> {
        let mut values = vec![];
        values.extend(self.vector(ray.origin));
        values.extend(self.vector(ray.reciprocal));
        values.push(signs(ray));
        match self.test {
            TriangleTest::MollerTrumbore => values.extend(self.vector(ray.direction)),
            TriangleTest::Watertight => {
                values.push(u64::from(ray.shear.axes[2]));
                values.extend(self.vector(ray.shear.scale));
            }
        }
        values
    }

    /// `near` and `far` are the ray's interval in the scene's box.
    pub fn ray_setup_values(&self, ray: &RaySetup, [near, far]: [f64; 2]) -> Expected {
        let enters = ray.valid && near <= far;
        let mut expected = vec![
            (u64::from(enters), true),
            (self.bits(near), enters),
            (self.bits(far), enters),
            (self.bits(ray.tmin), ray.valid),
            (self.bits(ray.tmax), ray.valid),
            (u64::from(ray.any_hit), true),
        ];
        // For an invalid ray only the shear is undefined; its fields are above origin, reciprocal and signs.
        let always = match self.test {
            TriangleTest::MollerTrumbore => usize::MAX,
            TriangleTest::Watertight => 7,
        };
        let values = self.setup_values(ray).into_iter().enumerate();
        expected.extend(values.map(|(i, value)| (value, ray.valid || i < always)));
        expected
    }

    pub fn packet_step_stimulus(&self) -> Layout {
        let w = self.number();
        let mut layout = Layout::default()
            .field("node", LINK_BITS, Unsigned, "index of the node")
            .record(&Record::node(self.format), self.format)
            .field(
                "mask",
                self.rays as u32,
                Mask,
                "rays that take part in the step",
            );
        for k in 0..self.rays {
            layout = layout
                .vector(&format!("ray{k}_origin"), w, &format!("ray {k}'s origin"))
                .vector(
                    &format!("ray{k}_reciprocal"),
                    w,
                    &format!("reciprocal of ray {k}'s direction"),
                )
                .field(
                    format!("ray{k}_signs"),
                    3,
                    Mask,
                    format!("sign bits of ray {k}'s direction"),
                )
                .field(
                    format!("ray{k}_near"),
                    w,
                    Number,
                    format!("ray {k}'s near in the node"),
                )
                .field(
                    format!("ray{k}_far"),
                    w,
                    Number,
                    format!("ray {k}'s far in the node"),
                );
        }
        layout
    }

    /// Bits of one ray's fields in a line of `packet_step_stimulus.hex`.
    pub fn packet_step_ray_bits(&self) -> u32 {
        8 * self.number() + 3
    }

    /// A ray outside the mask has 0 in all fields except far = +∞. It would enter every child whose interval contains 0, so the
    /// vectors detect a machine that ignores the mask.
    pub fn packet_step_values(
        &self,
        index: u32,
        node: &Node,
        rays: &[RaySetup],
        set: &RaySet,
    ) -> Vec<u64> {
        let link = node.link;
        let mut values = vec![u64::from(index)];
        for number in node.left.into_iter().chain(node.right) {
            values.push(self.bits(number));
        }
        values.extend([
            u64::from(link.link),
            u64::from(link.left_leaf),
            u64::from(link.right_leaf),
            u64::from(link.left_axis),
            u64::from(link.right_axis),
            u64::from(set.mask),
        ]);
        for (k, ray) in rays.iter().enumerate() {
            if set.mask >> k & 1 == 0 {
                values.extend([0; 8]);
                values.push(self.bits(f64::INFINITY));
                continue;
            }
            let (near, far) = (set.near[k], set.far[k]);
            values.extend(self.vector(ray.origin));
            values.extend(self.vector(ray.reciprocal));
            values.extend([signs(ray), self.bits(near), self.bits(far)]);
        }
        values
    }

    pub fn packet_step_expected(&self) -> Layout {
        let n = self.rays as u32;
        let mut layout = Layout::default()
            .field("to_left", n, Mask, "rays that enter the left child")
            .field("to_right", n, Mask, "rays that enter the right child")
            .field(
                "both_left_first",
                n,
                Mask,
                "rays that enter both children, the left one first",
            )
            .field(
                "left_first",
                1,
                Flag,
                "1 if the packet continues with the left child",
            )
            .field(
                "goes_on",
                1,
                Flag,
                "1 if the packet continues with a child, 0 if it pops",
            )
            .field(
                "next_leaf",
                1,
                Flag,
                "1 if the child with which it continues is a leaf",
            )
            .field(
                "next",
                LINK_BITS,
                Unsigned,
                "index of that child's node or record",
            )
            .field("pushes", 1, Flag, "1 if the other child is pushed")
            .field("pushed_leaf", 1, Flag, "1 if the pushed child is a leaf")
            .field(
                "pushed",
                LINK_BITS,
                Unsigned,
                "index of the pushed child's node or record",
            );
        for side in ["left", "right"] {
            for k in 0..self.rays {
                for end in ["near", "far"] {
                    layout = layout.field(
                        format!("{side}_ray{k}_{end}"),
                        self.number(),
                        Number,
                        format!("ray {k}'s {end} in the {side} child"),
                    );
                }
            }
        }
        layout
    }

    pub fn packet_step_outcome(
        &self,
        index: u32,
        link: LinkWord,
        left: &RaySet,
        right: &RaySet,
        both_left_first: u8,
    ) -> Expected {
        let (goes_left, goes_right) = (left.mask != 0, right.mask != 0);
        let left_first = goes_left && (!goes_right || both_left_first != 0);
        let goes_on = goes_left || goes_right;
        let pushes = goes_left && goes_right;
        let children = link.children(index);
        let (first, second) = match left_first {
            true => (children[0], children[1]),
            false => (children[1], children[0]),
        };
        let mut expected = vec![
            (u64::from(left.mask), true),
            (u64::from(right.mask), true),
            (u64::from(both_left_first), true),
            (u64::from(left_first), true),
            (u64::from(goes_on), true),
        ];
        let child = |target: Target, meant: bool| {
            let (leaf, index) = match target {
                Target::Node(index) => (0, index),
                Target::Record(index) => (1, index),
            };
            [(leaf, meant), (u64::from(index), meant)]
        };
        let (next, pushed) = (child(first, goes_on), child(second, pushes));
        expected.extend(next);
        expected.push((u64::from(pushes), true));
        expected.extend(pushed);
        for side in [left, right] {
            for k in 0..self.rays {
                let meant = side.mask >> k & 1 == 1;
                expected.push((self.bits(side.near[k]), meant));
                expected.push((self.bits(side.far[k]), meant));
            }
        }
        expected
    }

    pub fn triangle_test_stimulus(&self) -> Layout {
        let w = self.number();
        let layout = Layout::default()
            .field("slot", SLOT_BITS, Unsigned, "slot of the ray in its packet")
            .field(
                "record",
                LINK_BITS,
                Unsigned,
                "index of the triangle's record",
            )
            .vector("v0", w, "first vertex")
            .vector("v1", w, "second vertex")
            .vector("v2", w, "third vertex")
            .field("tmin", w, Number, "minimum distance of a hit, not -0")
            .field("tmax", w, Number, "maximum distance of a hit, not -0")
            .field(
                "window_near",
                w,
                Number,
                "near of the ray's window, -infinity in the world",
            )
            .field(
                "window_far",
                w,
                Number,
                "far of the ray's window, +infinity in the world",
            );
        self.with_setup(layout)
    }

    pub fn triangle_test_values(
        &self,
        slot: u8,
        record: u32,
        vertices: &[[f64; 3]; 3],
        ray: &RaySetup,
        window: [f64; 2],
    ) -> Vec<u64> {
        let mut values = vec![u64::from(slot), u64::from(record)];
        for vertex in vertices {
            values.extend(self.vector(*vertex));
        }
        let [near, far] = window;
        values.extend([ray.tmin, ray.tmax, near, far].map(|x| self.bits(x)));
        values.extend(self.setup_values(ray));
        values
    }

    pub fn triangle_test_expected(&self) -> Layout {
        let w = self.number();
        Layout::default()
            .field("hit", 1, Flag, "1 if the ray hits")
            .field("t", w, Number, "distance, clamped to the triangle's box")
            .field("u", w, Number, "weight of the second vertex")
            .field("v", w, Number, "weight of the third vertex")
    }

    pub fn triangle_test_outcome(&self, outcome: &crate::golden::Outcome) -> Expected {
        let [_, u, v] = outcome.raw;
        let numbers = [outcome.t, u, v].map(|number| (self.bits(number), outcome.hit));
        let mut expected = vec![(u64::from(outcome.hit), true)];
        expected.extend(numbers);
        expected
    }

    pub fn operands(&self, count: usize) -> Layout {
        let operand = |layout: Layout, name: &str| {
            layout.field(name, self.number(), Number, format!("operand {name}"))
        };
        ["a", "b"][..count]
            .iter()
            .fold(Layout::default(), |layout, name| operand(layout, name))
    }

    pub fn result(&self) -> Layout {
        Layout::default().field("y", self.number(), Number, "result")
    }
}

fn signs(ray: &RaySetup) -> u64 {
    (0..3).fold(0, |bits, i| bits | u64::from(ray.negative[i]) << i)
}
