//! Scenes of two levels: consecutive objects, and a top-level tree over their instances.

use anyhow::{Context, Result, ensure};
use glam::{DAffine3, DVec3};

use super::build::{BuildOptions, build_over_boxes};
use super::layout::{
    self, Columns, InstanceRecord, LINK_BITS, LinkWord, MemoryImage, Node, TriangleRecord,
    check_capacity,
};
use super::tree::{Bounds, Tree};
use crate::float::{Arithmetic, Format};

/// Widening of an instance's box in the world on every side, in machine units. It covers the displacement of a hit,
/// as seen from the world, by the rounding of the matrix and of the transformed ray.
pub const WIDENING: f64 = 1.0 / 16.0;

/// An instance. Its number is its index in the list that [`InstancedImage::set_top`] receives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InstanceSpec {
    /// The object's number, as returned by [`InstancedImage::add_object`].
    pub object: usize,
    /// Transforms a point of the world into object space. The numbers are values of the format.
    pub world_to_object: Columns,
    /// The box in the world, already widened. The numbers are values of the format.
    pub world_box: Bounds,
}

impl InstanceSpec {
    /// Creates an instance from `object_to_world`, a transformation of machine coordinates. The inverse is rounded once to
    /// the format. The box in the world is that of the eight transformed corners of `object_box` (the object's box in
    /// object space), widened by [`WIDENING`] on every side and rounded outwards.
    ///
    /// # Errors
    /// One line that names the instance by `number`, if the matrix is singular or if the format cannot represent its
    /// inverse or the box.
    pub fn new(
        format: Format,
        number: usize,
        object: usize,
        object_to_world: &Columns,
        object_box: Bounds,
    ) -> Result<Self> {
        let a = Arithmetic::new(format);
        let matrix = DAffine3::from_cols_array_2d(object_to_world);
        ensure!(
            matrix.is_finite(),
            "instance {number}: its matrix holds a number that is not finite; correct it"
        );
        ensure!(
            !is_flat(&matrix),
            "instance {number}: its matrix is singular; give it an extent in all three dimensions"
        );
        let world_to_object =
            (matrix.inverse().to_cols_array_2d()).map(|column| column.map(|x| a.round(x)));
        let rounded = DAffine3::from_cols_array_2d(&world_to_object);
        let mut world_box = Bounds::EMPTY;
        for corner in 0..8 {
            let coordinate = |axis: usize| match corner >> axis & 1 {
                0 => object_box.lo[axis],
                _ => object_box.hi[axis],
            };
            let corner = DVec3::from_array([0, 1, 2].map(coordinate));
            let corner = matrix.transform_point3(corner).to_array();
            world_box = world_box.union(Bounds {
                lo: corner,
                hi: corner,
            });
        }
        ensure!(
            rounded.is_finite() && !is_flat(&rounded),
            "instance {number}: {format} cannot hold the inverse of its matrix; {}",
            remedy(&world_box)
        );
        world_box.lo = world_box.lo.map(|x| round_down(&a, x - WIDENING));
        world_box.hi = world_box.hi.map(|x| -round_down(&a, -x - WIDENING) + 0.0);
        ensure!(
            is_box(&world_box),
            "instance {number}: {format} cannot hold its box in the world; place it nearer to the origin"
        );
        Ok(InstanceSpec {
            object,
            world_to_object,
            world_box,
        })
    }

    /// Checks that all numbers are values of the format, and that the box is valid.
    fn check(&self, a: &Arithmetic) -> Result<()> {
        let numbers = self.world_to_object.as_flattened().iter();
        let numbers = numbers.chain(&self.world_box.lo).chain(&self.world_box.hi);
        for &x in numbers {
            ensure!(
                x.is_finite() && a.round(x) == x,
                "{x:e} is not a number of {}; round its matrix and its box to the format",
                a.format()
            );
        }
        ensure!(
            is_box(&self.world_box),
            "its box in the world is empty; correct its matrix"
        );
        Ok(())
    }
}

/// Whether a transformation is singular up to rounding: its columns span almost no volume relative to their lengths.
fn is_flat(matrix: &DAffine3) -> bool {
    const NEXT_TO_NOTHING: f64 = 1e-12;
    let m = matrix.matrix3;
    let [x, y, z] = [m.x_axis, m.y_axis, m.z_axis].map(DVec3::normalize_or_zero);
    x.cross(y).dot(z).abs() <= NEXT_TO_NOTHING
}

/// The remedy for an instance whose matrix has no inverse in the format, given its exact box in the world.
fn remedy(world_box: &Bounds) -> String {
    /// The distance, in units of a box's own size, from which the box counts as far away.
    const FAR: f64 = 1e3;
    let Bounds { lo, hi } = world_box;
    let size = (0..3).map(|k| hi[k] - lo[k]).fold(0f64, f64::max);
    let distance = lo.iter().chain(hi).fold(0f64, |d, x| d.max(x.abs()));
    match distance > FAR * size {
        true => format!(
            "it stands {:.0e} times its own size away from the origin: place it nearer",
            (distance / size).min(1e99)
        ),
        false => "give it a scale nearer to 1".into(),
    }
}

/// Whether a box is finite and not empty.
fn is_box(bounds: &Bounds) -> bool {
    (0..3).all(|i| {
        bounds.lo[i].is_finite() && bounds.hi[i].is_finite() && bounds.lo[i] <= bounds.hi[i]
    })
}

/// The greatest value of the format that is not above x; −∞ if there is none.
fn round_down(a: &Arithmetic, x: f64) -> f64 {
    let rounded = a.round(x);
    if rounded > x {
        a.step(rounded, -1)
    } else {
        rounded
    }
}

/// The position of an object in the arrays of an [`InstancedImage`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ObjectPlace {
    /// Index of its first node and record: the node base of an update.
    pub base: u32,
    /// Number of its triangles, which is its number of slots in both arrays; the last node slot is unused.
    pub triangles: u32,
    /// Index of its first vertex: the vertex base of an update.
    pub vertex_base: u32,
    pub vertices: u32,
    /// Its root, by which instances enter it.
    pub root: LinkWord,
    /// The box of its triangles in object space.
    pub bounds: Bounds,
    /// Number of inner nodes on the longest path from its root.
    pub depth: u32,
}

/// The position of a top-level tree that was kept.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TopPlace {
    /// Index of its first node and record.
    pub base: u32,
    /// Index of the first vector of its first instance.
    pub vectors: u32,
    /// Its root.
    pub root: LinkWord,
}

/// A memory image of two levels in two parts. Objects and additional vectors are added once; the top-level tree over
/// the instances is replaced whenever an instance moves.
///
/// The node and record arrays contain the objects, one after another, then the top-level tree. The vertex array contains
/// everything that was added, in order, then six vectors per instance, in the order of the instances' numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct InstancedImage {
    image: MemoryImage,
    objects: Vec<ObjectPlace>,
    /// Number of records and vertices below those of the top level.
    record_count: usize,
    vertex_count: usize,
}

impl InstancedImage {
    /// Creates an image without objects.
    pub fn new(format: Format) -> Self {
        InstancedImage {
            image: MemoryImage {
                format,
                nodes: Vec::new(),
                records: Vec::new(),
                vertices: Vec::new(),
                root: NO_TOP,
                bounds: EMPTY_SCENE,
            },
            objects: Vec::new(),
            record_count: 0,
            vertex_count: 0,
        }
    }

    /// Adds an object from its own image at base 0, and returns its number. The top level must then be set again.
    ///
    /// # Errors
    /// If the object has another format, if it is not a valid scene of one level, or if the arrays become too large for a link.
    pub fn add_object(&mut self, object: &MemoryImage) -> Result<usize> {
        let number = self.objects.len();
        let place = self
            .placed(object, self.record_count, self.vertex_count)
            .with_context(|| format!("object {number}"))?;
        self.remove_top();
        let at = place.base as usize;
        (self.image.nodes).resize(at + object.nodes.len(), Node::default());
        (self.image.records).resize(at + object.records.len(), TriangleRecord::default());
        (self.image.vertices).resize(place.vertex_base as usize + object.vertices.len(), [0.0; 3]);
        self.fill(object, &place);
        self.record_count = self.image.records.len();
        self.vertex_count = self.image.vertices.len();
        self.objects.push(place);
        Ok(number)
    }

    /// Replaces the state of an object: its vertices, its bounds, or its tree over the same number of triangles. Instances
    /// do not change: set the top level again if the object's box or depth has changed.
    ///
    /// # Errors
    /// As [`InstancedImage::add_object`], and if the number of triangles or vertices differs.
    ///
    /// # Panics
    /// If there is no such object.
    pub fn replace_object(&mut self, number: usize, object: &MemoryImage) -> Result<()> {
        let old = self.objects[number];
        let place = self
            .placed(object, old.base as usize, old.vertex_base as usize)
            .with_context(|| format!("object {number}"))?;
        ensure!(
            (place.triangles, place.vertices) == (old.triangles, old.vertices),
            "object {number} has {} triangles and {} vertices, but its place holds {} and {}; build the image again",
            place.triangles,
            place.vertices,
            old.triangles,
            old.vertices
        );
        self.fill(object, &place);
        for index in self.record_count..self.image.records.len() {
            let record = &mut self.image.records[index];
            let mut instance = InstanceRecord::from(*record);
            if instance.root == old.root {
                instance.root = place.root;
                *record = instance.into();
            }
        }
        self.objects[number] = place;
        Ok(())
    }

    /// Adds vectors that no triangle names to the vertex array, such as palettes or vertices at rest. Returns the index of
    /// the first one. The top level must then be set again.
    ///
    /// # Errors
    /// If an index of the vertex array would need more than 32 bits.
    pub fn add_vectors(&mut self, vectors: &[[f64; 3]]) -> Result<u32> {
        let first = self.vertex_count;
        check_vertices(first + vectors.len())?;
        self.remove_top();
        self.image.vertices.extend_from_slice(vectors);
        self.vertex_count = self.image.vertices.len();
        Ok(first as u32)
    }

    /// Overwrites added vectors from an index on.
    ///
    /// # Panics
    /// If they overlap the vectors of the top level.
    pub fn write_vectors(&mut self, first: u32, vectors: &[[f64; 3]]) {
        let first = first as usize;
        assert!(first + vectors.len() <= self.vertex_count, "added vectors");
        self.image.vertices[first..first + vectors.len()].copy_from_slice(vectors);
    }

    /// Builds the top-level tree over instances and replaces the previous one. `options` are those of the objects' trees:
    /// the depth of both levels together is at most `max_depth`.
    ///
    /// # Errors
    /// One line if there is no instance, if an instance is invalid or names a missing object, if the stack is too small for
    /// both levels, or if the arrays become too large. The image then does not change.
    pub fn set_top(&mut self, instances: &[InstanceSpec], options: &BuildOptions) -> Result<()> {
        let tree = self.top_tree(instances, options)?;
        self.put_top(instances, &tree, &layout::default_order(&tree))
    }

    /// Builds the tree that [`InstancedImage::set_top`] sets.
    ///
    /// # Errors
    /// As [`InstancedImage::set_top`], except for the size of the arrays.
    pub fn top_tree(&self, instances: &[InstanceSpec], options: &BuildOptions) -> Result<Tree> {
        self.check_instances(instances)?;
        let objects = instances.iter().map(|instance| instance.object);
        let deepest = objects.map(|object| self.objects[object].depth).max();
        let deepest = deepest.unwrap_or(0);
        let needed = instances.len().next_power_of_two().ilog2();
        ensure!(
            needed + deepest <= options.max_depth,
            "{} instances need a top-level tree of depth {needed} and their objects one of {deepest}, but the traversal \
             stack allows {} in all; build shallower objects, leave instances out or deepen the stack",
            instances.len(),
            options.max_depth
        );
        let boxes: Vec<Bounds> = instances.iter().map(|spec| spec.world_box).collect();
        let options = BuildOptions {
            max_depth: options.max_depth - deepest,
            ..*options
        };
        build_over_boxes(&boxes, &options)
    }

    /// Removes the top-level tree, because there is no tree over zero instances.
    pub fn clear_top(&mut self) {
        self.remove_top();
    }

    /// Sets a given top-level tree, whose leaves are the numbers of instances.
    ///
    /// # Errors
    /// As [`InstancedImage::set_top`], except for the depth, which [`MemoryImage::check`] checks.
    ///
    /// # Panics
    /// If `tree` is not a tree over these instances.
    pub fn set_top_tree(&mut self, instances: &[InstanceSpec], tree: &Tree) -> Result<()> {
        self.set_top_in_order(instances, tree, &layout::default_order(tree))
    }

    /// As [`InstancedImage::set_top_tree`], with the nodes in the order in which an update program writes them.
    ///
    /// # Errors
    /// As [`InstancedImage::set_top_tree`].
    ///
    /// # Panics
    /// If `tree` is not a tree over these instances, or if `order` is not one of its nodes as [`layout::place`] requires.
    pub fn set_top_in_order(
        &mut self,
        instances: &[InstanceSpec],
        tree: &Tree,
        order: &[u32],
    ) -> Result<()> {
        self.check_instances(instances)?;
        assert_eq!(
            tree.triangle_count(),
            instances.len(),
            "a leaf for each instance"
        );
        self.put_top(instances, tree, order)
    }

    /// Keeps the top-level tree where it is: what is added from now on lies behind it, another top-level tree as well. The image is
    /// without a top level again, and [`MemoryImage::check`] does not know trees that were kept.
    ///
    /// # Panics
    /// If no top level is set.
    pub fn keep_top(&mut self) -> TopPlace {
        assert!(self.image.is_instanced(), "a top level is set");
        let kept = TopPlace {
            base: self.top_base(),
            vectors: self.instance_vectors(0),
            root: self.image.root,
        };
        self.record_count = self.image.records.len();
        self.vertex_count = self.image.vertices.len();
        self.image.root = NO_TOP;
        self.image.bounds = EMPTY_SCENE;
        kept
    }

    /// The whole image. Until the top level is set it has no root, and [`MemoryImage::check`] rejects it.
    pub fn image(&self) -> &MemoryImage {
        &self.image
    }

    /// The positions of the objects, by number.
    pub fn objects(&self) -> &[ObjectPlace] {
        &self.objects
    }

    /// The index of the top level's first slot among nodes and records.
    pub fn top_base(&self) -> u32 {
        self.record_count as u32
    }

    /// The index of an instance's first vector in the vertex array.
    pub fn instance_vectors(&self, number: usize) -> u32 {
        (self.vertex_count + InstanceRecord::VECTORS * number) as u32
    }

    fn check_instances(&self, instances: &[InstanceSpec]) -> Result<()> {
        ensure!(!instances.is_empty(), "the scene has no instances");
        let a = Arithmetic::new(self.image.format);
        for (number, instance) in instances.iter().enumerate() {
            ensure!(
                instance.object < self.objects.len(),
                "instance {number} is of object {}, but there are {}, counted from 0; add the object first",
                instance.object,
                self.objects.len()
            );
            (instance.check(&a)).map_err(|error| error.context(format!("instance {number}")))?;
        }
        Ok(())
    }

    fn put_top(&mut self, instances: &[InstanceSpec], tree: &Tree, order: &[u32]) -> Result<()> {
        check_vertices(self.vertex_count + InstanceRecord::VECTORS * instances.len())?;
        let refit = tree.refit_leaves(|number| instances[number as usize].world_box);
        let record = |number: u32| {
            TriangleRecord::from(InstanceRecord {
                vectors: self.instance_vectors(number as usize),
                root: self.objects[instances[number as usize].object].root,
                number,
            })
        };
        let placement = layout::place_records(tree, &refit, order, self.top_base(), record)?;
        self.remove_top();
        self.image.nodes.extend(placement.nodes);
        self.image.records.extend(placement.records);
        for instance in instances {
            let Bounds { lo, hi } = instance.world_box;
            let vectors = instance.world_to_object.into_iter().chain([lo, hi]);
            (self.image.vertices).extend(vectors.map(|vector| vector.map(|x| x + 0.0)));
        }
        self.image.root = LinkWord {
            right_leaf: true,
            ..placement.root
        };
        self.image.bounds = (refit.root.lo, refit.root.hi);
        Ok(())
    }

    fn remove_top(&mut self) {
        self.image.nodes.truncate(self.record_count);
        self.image.records.truncate(self.record_count);
        self.image.vertices.truncate(self.vertex_count);
        self.image.root = NO_TOP;
        self.image.bounds = EMPTY_SCENE;
    }

    /// The position of an object for given bases.
    fn placed(&self, object: &MemoryImage, base: usize, vertex_base: usize) -> Result<ObjectPlace> {
        ensure!(
            object.format == self.image.format,
            "it is in {} but the scene in {}; build it in the scene's format",
            object.format,
            self.image.format
        );
        ensure!(
            !object.is_instanced(),
            "it has two levels itself, which do not nest; add its objects instead"
        );
        object.check(u32::MAX)?;
        check_capacity(base as u64, object.records.len() as u64, LINK_BITS)?;
        check_vertices(vertex_base + object.vertices.len())?;
        let (lo, hi) = object.bounds;
        Ok(ObjectPlace {
            base: base as u32,
            triangles: object.records.len() as u32,
            vertex_base: vertex_base as u32,
            vertices: object.vertices.len() as u32,
            root: raised(object.root, base as u32),
            bounds: Bounds { lo, hi },
            depth: object.depth()?,
        })
    }

    /// Copies an object to its position.
    fn fill(&mut self, object: &MemoryImage, place: &ObjectPlace) {
        let base = place.base as usize;
        let used = object.nodes.len() - 1;
        for (slot, node) in self.image.nodes[base..]
            .iter_mut()
            .zip(&object.nodes[..used])
        {
            *slot = Node {
                link: raised(node.link, place.base),
                ..*node
            };
        }
        for (slot, record) in self.image.records[base..].iter_mut().zip(&object.records) {
            *slot = TriangleRecord {
                vertices: record.vertices.map(|v| v + place.vertex_base),
                number: record.number,
            };
        }
        let vertices = &mut self.image.vertices[place.vertex_base as usize..];
        vertices[..object.vertices.len()].copy_from_slice(&object.vertices);
    }
}

/// The root of a scene whose top level is not set; it names no valid node.
const NO_TOP: LinkWord = LinkWord {
    link: (1 << LINK_BITS) - 1,
    left_leaf: true,
    right_leaf: true,
    left_axis: 0,
    right_axis: 0,
};

const EMPTY_SCENE: ([f64; 3], [f64; 3]) = ([0.0; 3], [0.0; 3]);

/// A link word with an object's base added to its index.
fn raised(link: LinkWord, base: u32) -> LinkWord {
    LinkWord {
        link: link.link + base,
        ..link
    }
}

fn check_vertices(count: usize) -> Result<()> {
    ensure!(
        u32::try_from(count).is_ok(),
        "the scene has {count} vertices, more than 32 bits name; simplify the meshes"
    );
    Ok(())
}
