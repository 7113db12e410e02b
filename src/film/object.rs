//! An object of a film: its tree and program, and its vertices in the current frame.

use super::Film;
use crate::bkd::layout::{Influence, MemoryImage};
use crate::bkd::stats::TreeStatistics;
use crate::bkd::{BuildOptions, Quality, Tree, build};
use crate::config::Config;
use crate::float::{Arithmetic, Format};
use crate::golden::skinning::skin_vertices;
use crate::program::{Program, UpdateMachine};
use crate::scene::animation::{MachineFrame, MachineObject, MachineScene, ObjectFrame};
use anyhow::Result;

/// An object of a film.
pub struct Object<'a> {
    number: usize,
    pub machine: &'a MachineObject,
    /// Whether any frame moves its vertices.
    pub moves: bool,
    pub options: BuildOptions,
    pub tree: Tree,
    pub program: Program,
    /// The vertices in the order of the mesh, as supplied last by the host.
    pub rest: Vec<[f64; 3]>,
    /// The vertices of the tree in the order of the mesh, by the golden model.
    pub vertices: Vec<[f64; 3]>,
}

impl<'a> Object<'a> {
    /// Creates the object with a tree for the vertices of the first frame.
    ///
    /// # Errors
    /// If the vertices are not numbers, if no tree can be built, or if its program needs more registers than the machine has.
    pub fn new(
        film: Film<'a>,
        number: usize,
        machine: UpdateMachine,
        options: BuildOptions,
    ) -> Result<Object<'a>> {
        let object = &film.scene.objects[number];
        let is_written = |frame: &MachineFrame| frame.objects[number].written.is_some();
        let (mut rest, first) = (object.rest.clone(), &film.frames[0].objects[number]);
        let vertices = posed(film.scene, number, &mut rest, first)?;
        let tree = build(&vertices, &object.triangles, &options)?;
        let program = Program::compile(&tree, &object.triangles, vertices.len(), machine)?;
        Ok(Object {
            number,
            machine: object,
            moves: object.influences.is_some() || film.frames.iter().any(is_written),
            options,
            tree,
            program,
            rest,
            vertices,
        })
    }

    /// Advances to a frame, of which all before have been given.
    ///
    /// # Errors
    /// One line if a vertex that a triangle uses is not a number.
    pub fn pose(&mut self, scene: &MachineScene, frame: &ObjectFrame) -> Result<()> {
        self.vertices = posed(scene, self.number, &mut self.rest, frame)?;
        Ok(())
    }

    /// The object's memory image at base 0, by the golden model, with bounds computed from scratch.
    ///
    /// # Errors
    /// If the mesh is too large for the link word.
    pub fn image(&self, format: Format) -> Result<MemoryImage> {
        let triangles = &self.machine.triangles;
        self.program
            .image(format, &self.vertices, triangles, &self.tree)
    }

    /// The stream of influences of the first `count` vertices in the order of the program; empty for an object without a skin.
    pub fn influences(&self, count: usize) -> Vec<Influence> {
        let influences = self.machine.influences.as_ref();
        influences.map_or(Vec::new(), |influences| {
            self.program.reorder_vertices(influences)[..count].concat()
        })
    }

    /// Expected cycles of a random ray through the object's box, for the current vertices.
    pub fn cost(&self, format: Format) -> f64 {
        let triangles = &self.machine.triangles;
        let statistics = TreeStatistics::new(&self.tree, &self.vertices, triangles, format);
        statistics.expected_steps + statistics.expected_tests
    }

    /// Compares the tree with one that is built for the current vertices.
    ///
    /// # Errors
    /// If none can be built.
    pub fn quality(&self, format: Format) -> Result<Quality> {
        let triangles = &self.machine.triangles;
        Quality::of(&self.tree, &self.vertices, triangles, &self.options, format)
    }

    /// Gives the object another tree, and therefore another program and another order of vertices and nodes.
    ///
    /// # Errors
    /// If the program needs more registers than the machine has.
    pub fn rebuild(&mut self, tree: Tree, machine: UpdateMachine) -> Result<()> {
        let triangles = &self.machine.triangles;
        self.program = Program::compile(&tree, triangles, self.vertices.len(), machine)?;
        self.tree = tree;
        Ok(())
    }
}

/// The vertices of the tree in a frame, in the order of the mesh, by the golden model. `rest` becomes the data that the host has
/// supplied up to then.
fn posed(
    scene: &MachineScene,
    number: usize,
    rest: &mut Vec<[f64; 3]>,
    frame: &ObjectFrame,
) -> Result<Vec<[f64; 3]>> {
    if let Some(written) = &frame.written {
        rest.clone_from(written);
    }
    let vertices = match &scene.objects[number].influences {
        Some(influences) => {
            let arithmetic = Arithmetic::new(scene.format);
            skin_vertices(&arithmetic, rest, &influences.concat(), &frame.palette)
        }
        None => rest.clone(),
    };
    scene.check_vertices(number, &vertices)?;
    Ok(vertices)
}

impl Film<'_> {
    /// The vertices of an object in a frame, in the order of the mesh, by the golden model.
    ///
    /// # Errors
    /// One line if a vertex that a triangle uses is not a number.
    pub fn vertices(&self, object: usize, frame: usize) -> Result<Vec<[f64; 3]>> {
        let frames = self.frames[..=frame].iter().rev();
        let mut written = frames.filter_map(|frame| frame.objects[object].written.as_ref());
        let rest = written
            .next()
            .unwrap_or(&self.scene.objects[object].rest)
            .clone();
        posed(
            self.scene,
            object,
            &mut { rest },
            &self.frames[frame].objects[object],
        )
    }
}

/// How the tree of one of a film's objects is built: it leaves a part of the stack to the top-level tree.
pub fn object_options(config: &Config, film: Film<'_>, number: usize) -> BuildOptions {
    let count = film.scene.objects[number].triangles.len();
    let depth = object_depth(config.stack_depth, film.scene.instances.len(), count);
    BuildOptions::default_for(config.axes_per_node, depth)
}

/// The maximum depth of a tree over some of a scene's triangles: the part of the stack that the top-level tree does not need.
fn object_depth(stack_depth: u32, instances: usize, triangles: usize) -> u32 {
    /// Entries in addition to the minimum for the top-level tree, because it need not be balanced.
    const SLACK: u32 = 4;
    if instances == 1 {
        return stack_depth;
    }
    let top = instances.next_power_of_two().ilog2() + SLACK;
    let fewest = triangles.next_power_of_two().ilog2();
    stack_depth.saturating_sub(top).max(fewest).min(stack_depth)
}
