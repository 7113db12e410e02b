//! What a film needs in memory, by index: arrays, programs, and the steps of each frame. [`super::pack()`] gives them addresses.

use super::{Film, Object, TreeReport, object_options, update_machine};
use crate::bkd::bytes::{BASE_ALIGNMENT, ByteRecord};
use crate::bkd::layout::{
    INFLUENCES_PER_ROW, LinkWord, MemoryImage, check_capacity, influence_words,
};
use crate::bkd::{Bounds, Child, InstancedImage, Tree};
use crate::chip::descriptor::{Skin, Update};
use crate::config::Config;
use crate::program::{Program, UpdateMachine};
use crate::scene::animation::{IDENTITY, ObjectFrame};
use anyhow::{Context, Result, ensure};
use std::ops::Range;

/// A command `skin`. Its address of influences is an offset in [`Plan::influences`] or, if `copies`, among the rows of copies.
#[derive(Clone, Copy, Debug)]
pub(super) struct SkinStep {
    pub command: Skin,
    /// Whether it copies vectors: all influences have the weight 1, and the only joint is the identity.
    pub copies: bool,
}

/// Where an update writes the box.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum BoxAt {
    /// A box by its number in [`Plan::boxes`].
    Box(u32),
    /// The corners of an instance: the index of the first one among the vertices.
    Corners(u32),
}

/// A command `update`. Its address of the program is an offset in [`Plan::programs`].
#[derive(Clone, Copy, Debug)]
pub(super) struct UpdateStep {
    pub command: Update,
    pub bounds: BoxAt,
}

/// The steps of a frame.
#[derive(Clone, Debug, Default)]
pub(super) struct FramePlan {
    pub skins: Vec<SkinStep>,
    pub updates: Vec<UpdateStep>,
    pub top: Option<UpdateStep>,
    pub root: LinkWord,
    /// The number of the scene's box.
    pub bounds: u32,
    /// The numbers in the scene of the instances, by their numbers in hits.
    pub there: Vec<usize>,
    /// Triangles of the objects that are updated.
    pub triangles: u64,
    pub trees: Vec<TreeReport>,
    /// Whether it is the first frame of a top-level tree.
    pub new_top: bool,
}

/// Numbers of vectors in the vertex array, by what they are.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Vectors {
    pub rest: u64,
    pub palettes: u64,
    /// Of instances, for each frame in which they change.
    pub instances: u64,
}

/// A film in memory, by index.
pub(super) struct Plan {
    /// Nodes, records and vertices. What the chip writes is 0.
    pub image: MemoryImage,
    pub programs: Vec<u8>,
    /// Rows of influences in bytes.
    pub influences: Vec<u8>,
    /// The most vectors that one command copies.
    pub most_copied: u32,
    /// Boxes; `None` for those that updates write.
    pub boxes: Vec<Option<Bounds>>,
    pub frames: Vec<FramePlan>,
    pub vectors: Vectors,
}

/// Plans a film.
///
/// # Errors
/// If the machine cannot hold the scene, or if a frame has a number that its format lacks.
pub(super) fn plan(config: &Config, film: Film<'_>, rebuild_above: f64) -> Result<Plan> {
    let mut planner = Planner::new(config, film)?;
    let count = film.frames.len();
    let stages = (0..count)
        .map(|frame| {
            let stage = planner.objects_of(frame, rebuild_above);
            stage.with_context(|| format!("frame {frame}"))
        })
        .collect::<Result<Vec<_>>>()?;
    let frames = match planner.one_level {
        true => stages
            .into_iter()
            .map(|stage| planner.only(stage))
            .collect(),
        false => planner.tops(stages, rebuild_above)?,
    };
    planner.finish(frames)
}

/// An object, and where its current copy is.
struct State<'a> {
    object: Object<'a>,
    /// Its number in the image.
    copy: usize,
    /// Offset and rows of its program.
    program: u32,
    rows: u32,
    /// Offset and rows of its influences, if it is skinned.
    influences: Option<(u32, u32)>,
    /// The vertices at rest that were placed last, and their index.
    rest: Option<(Vec<[f64; 3]>, u32)>,
    given: Option<ObjectFrame>,
    /// The box of its triangles in the current frame.
    bounds: Bounds,
    /// The number of the box that its update writes.
    boxed: u32,
}

/// The objects in a frame.
pub(super) struct Stage {
    pub skins: Vec<SkinStep>,
    /// The objects that are updated because their vertices change.
    pub moved: Vec<usize>,
    pub triangles: u64,
    pub trees: Vec<TreeReport>,
    /// For each object: the number of its copy, its box, its update.
    pub copies: Vec<usize>,
    pub boxes: Vec<Bounds>,
    pub updates: Vec<Update>,
}

pub(super) struct Planner<'a> {
    pub config: &'a Config,
    pub film: Film<'a>,
    pub machine: UpdateMachine,
    pub image: InstancedImage,
    pub programs: Vec<u8>,
    pub influences: Vec<u8>,
    pub boxes: Vec<Option<Bounds>>,
    pub vectors: Vectors,
    /// Nodes and vertices that the chip writes.
    pub blank_nodes: Vec<Range<u32>>,
    pub blank_vertices: Vec<Range<u32>>,
    objects: Vec<State<'a>>,
    one_level: bool,
    /// The index of a palette of the identity alone.
    identity: Option<u32>,
    most_copied: u32,
}

impl<'a> Planner<'a> {
    fn new(config: &'a Config, film: Film<'a>) -> Result<Planner<'a>> {
        let mut planner = Planner {
            config,
            film,
            machine: update_machine(config)?,
            image: InstancedImage::new(config.format()),
            programs: vec![],
            influences: vec![],
            boxes: vec![],
            vectors: Vectors::default(),
            blank_nodes: vec![],
            blank_vertices: vec![],
            objects: vec![],
            one_level: film.is_one_level(),
            identity: None,
            most_copied: 0,
        };
        let setup = film.setup();
        check_capacity(0, setup.triangles as u64, config.address_bits)?;
        for (number, object) in film.scene.objects.iter().enumerate() {
            let options = object_options(config, film, number);
            let made = Object::new(film, number, planner.machine, options);
            let object = made.with_context(|| object.name.clone())?;
            let bounds = planner.bounds_of(&object);
            let boxed = planner.boxes.len() as u32;
            planner.boxes.push((!object.moves).then_some(bounds));
            let mut state = State {
                object,
                copy: 0,
                program: 0,
                rows: 0,
                influences: None,
                rest: None,
                given: None,
                bounds,
                boxed,
            };
            planner.add_copy(&mut state)?;
            planner.objects.push(state);
        }
        Ok(planner)
    }

    fn bounds_of(&self, object: &Object) -> Bounds {
        let triangles = &object.machine.triangles;
        object.tree.refit(&object.vertices, triangles).root
    }

    /// Adds an object in its current state: nodes, records, vertices, program, influences.
    fn add_copy(&mut self, state: &mut State<'a>) -> Result<()> {
        let format = self.config.format();
        let object = &state.object;
        state.copy = self.image.add_object(&object.image(format)?)?;
        state.rest = None;
        state.given = None;
        if !object.moves {
            return Ok(());
        }
        let place = self.image.objects()[state.copy];
        let used = object.program.vertices_used();
        self.blank_nodes
            .push(place.base..place.base + place.triangles);
        (self.blank_vertices).push(place.vertex_base..place.vertex_base + used);
        [state.program, state.rows] = self.add_program(&object.program);
        let stream = object.influences(used as usize);
        if !stream.is_empty() {
            let rows = stream.len().div_ceil(INFLUENCES_PER_ROW) as u32;
            state.influences = Some((self.influences.len() as u32, rows));
            let words = influence_words(format, &stream);
            let bytes = ByteRecord::influence_row(format).array(&words);
            self.influences.extend(bytes);
            let aligned = self
                .influences
                .len()
                .next_multiple_of(BASE_ALIGNMENT as usize);
            self.influences.resize(aligned, 0);
        }
        Ok(())
    }

    /// Adds a program; returns its offset and its rows.
    pub fn add_program(&mut self, program: &Program) -> [u32; 2] {
        let (offset, bytes) = (self.programs.len() as u32, program.bytes());
        self.programs.extend_from_slice(&bytes);
        [offset, (bytes.len() / Program::ROW_BYTES) as u32]
    }

    /// Whether an object's vertices move.
    pub fn moves(&self, object: usize) -> bool {
        self.objects[object].object.moves
    }

    /// The number of the box that the update of an object writes if nothing else needs it.
    pub fn box_of(&self, object: usize) -> BoxAt {
        BoxAt::Box(self.objects[object].boxed)
    }

    /// The command that copies `vectors`, which lie at `rest`, to `target`.
    pub fn copy(&mut self, rest: u32, count: u32, target: u32) -> Result<SkinStep> {
        let palette = match self.identity {
            Some(palette) => palette,
            None => {
                let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [0.0; 3]];
                *self.identity.insert(self.image.add_vectors(&columns)?)
            }
        };
        self.most_copied = self.most_copied.max(count);
        Ok(SkinStep {
            command: Skin {
                palette,
                joints: 1,
                rows: count.div_ceil(INFLUENCES_PER_ROW as u32),
                rest,
                count,
                target,
                ..Skin::default()
            },
            copies: true,
        })
    }

    /// Advances all objects to a frame.
    fn objects_of(&mut self, frame: usize, rebuild_above: f64) -> Result<Stage> {
        let mut stage = Stage {
            skins: vec![],
            moved: vec![],
            triangles: 0,
            trees: vec![],
            copies: vec![],
            boxes: vec![],
            updates: vec![],
        };
        for number in 0..self.objects.len() {
            let given = &self.film.frames[frame].objects[number];
            let state = &mut self.objects[number];
            if state.object.moves && state.given.as_ref() != Some(given) {
                state.object.pose(self.film.scene, given)?;
                state.given = Some(given.clone());
                stage.moved.push(number);
                stage.triangles += state.object.machine.triangles.len() as u64;
                stage.skins.push(self.skin(number, given)?);
                self.objects[number].bounds = self.bounds_of(&self.objects[number].object);
            }
        }
        for state in &self.objects {
            let place = self.image.objects()[state.copy];
            stage.copies.push(state.copy);
            stage.boxes.push(state.bounds);
            stage.updates.push(Update {
                program: state.program,
                rows: state.rows,
                first_vertex: place.vertex_base,
                first_node: place.base,
                ..Update::default()
            });
        }
        if rebuild_above.is_finite() {
            for &number in &stage.moved {
                let report = self.rebuild_if_bad(number, frame, rebuild_above)?;
                stage.trees.push(report);
            }
        }
        Ok(stage)
    }

    /// The command that writes the vertices of an object.
    fn skin(&mut self, number: usize, given: &ObjectFrame) -> Result<SkinStep> {
        let state = &mut self.objects[number];
        let place = self.image.objects()[state.copy];
        let program = &state.object.program;
        let count = program.vertices_used();
        let mut rest = program.reorder_vertices(&state.object.rest);
        rest.truncate(count as usize);
        let rest_at = match &state.rest {
            Some((held, at)) if *held == rest => *at,
            _ => {
                let at = self.image.add_vectors(&rest)?;
                self.vectors.rest += u64::from(count);
                state.rest = Some((rest, at));
                at
            }
        };
        let Some((influences, rows)) = state.influences else {
            return self.copy(rest_at, count, place.vertex_base);
        };
        let palette = given.palette.as_flattened();
        self.vectors.palettes += palette.len() as u64;
        Ok(SkinStep {
            command: Skin {
                palette: self.image.add_vectors(palette)?,
                joints: given.palette.len() as u32,
                influences,
                rows,
                rest: rest_at,
                count,
                target: place.vertex_base,
                ..Skin::default()
            },
            copies: false,
        })
    }

    /// Evaluates the tree of an object in a frame; if it is bad, the next frame has another copy with a new tree.
    fn rebuild_if_bad(&mut self, number: usize, frame: usize, above: f64) -> Result<TreeReport> {
        let state = &self.objects[number];
        let quality = state.object.quality(self.config.format())?;
        // The last frame has no next one that could use a new tree.
        let rebuilt = quality.ratio() > above && frame + 1 < self.film.frames.len();
        let report = TreeReport {
            object: state.object.machine.name.clone(),
            sah_ratio: quality.ratio(),
            rebuilt,
        };
        if rebuilt {
            let mut state = self.objects.remove(number);
            state.object.rebuild(quality.tree, self.machine)?;
            self.add_copy(&mut state)?;
            self.objects.insert(number, state);
        }
        Ok(report)
    }

    /// The steps of a frame in a scene of one level.
    fn only(&self, stage: Stage) -> FramePlan {
        let bounds = self.objects[0].boxed;
        let update = |&object: &usize| UpdateStep {
            command: stage.updates[object],
            bounds: BoxAt::Box(bounds),
        };
        FramePlan {
            updates: stage.moved.iter().map(update).collect(),
            skins: stage.skins,
            root: self.image.objects()[stage.copies[0]].root,
            bounds,
            there: vec![0],
            triangles: stage.triangles,
            trees: stage.trees,
            ..FramePlan::default()
        }
    }

    /// For each object, the only instance of it if that is the identity whenever it is present: the object's box is the instance's.
    pub fn directs(&self) -> Vec<Option<usize>> {
        let instances = &self.film.scene.instances;
        let direct = |object: usize| {
            let mut of = (0..instances.len()).filter(|&number| instances[number] == object);
            let (first, None) = (of.next()?, of.next()) else {
                return None;
            };
            let mut matrices = self.film.frames.iter().map(|frame| &frame.instances[first]);
            matrices
                .all(|matrix| matrix.is_none_or(|matrix| matrix == IDENTITY))
                .then_some(first)
        };
        (0..self.objects.len()).map(direct).collect()
    }

    /// A root that no ray hits: a triangle whose corners are one point. The rays that reach it are those for which a box that is empty
    /// is none.
    pub fn nothing(&mut self) -> Result<LinkWord> {
        let tree = Tree {
            nodes: vec![],
            root: Child::Leaf(0),
        };
        let format = self.config.format();
        let image = MemoryImage::new(format, &[[0.0; 3]], &[[0; 3]], &tree)?;
        let number = self.image.add_object(&image)?;
        Ok(self.image.objects()[number].root)
    }

    fn finish(self, frames: Vec<FramePlan>) -> Result<Plan> {
        let mut image = self.image.image().clone();
        for range in &self.blank_nodes {
            for index in range.clone() {
                let node = &mut image.nodes[index as usize];
                (node.left, node.right) = ([0.0; 2], [0.0; 2]);
            }
        }
        for range in &self.blank_vertices {
            image.vertices[range.start as usize..range.end as usize].fill([0.0; 3]);
        }
        let bits = self.config.address_bits;
        for (what, count) in [
            ("nodes", image.nodes.len()),
            ("vertices and vectors", image.vertices.len()),
        ] {
            ensure!(
                count as u64 <= 1 << bits,
                "the film is too large for its address space: {count} {what}, but {bits} address bits hold {}; \
                 give fewer frames, simplify the meshes or widen the address",
                1u64 << bits
            );
        }
        Ok(Plan {
            image,
            programs: self.programs,
            influences: self.influences,
            most_copied: self.most_copied,
            boxes: self.boxes,
            frames,
            vectors: self.vectors,
        })
    }
}
