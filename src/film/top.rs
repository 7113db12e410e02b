//! The top-level trees of a film. A tree serves consecutive frames in which the same instances of the same copies of objects are present,
//! until its cost is too high.

use super::plan::{BoxAt, FramePlan, Planner, Stage, UpdateStep};
use crate::bkd::stats::TreeStatistics;
use crate::bkd::{Bounds, BuildOptions, InstanceRecord, InstanceSpec, TopPlace, Tree};
use crate::chip::descriptor::Update;
use crate::program::Program;
use anyhow::{Context, Result};

/// Vectors of an instance.
const VECTORS: u32 = InstanceRecord::VECTORS as u32;

/// Unchanged instances between two changed ones that are copied with them: their vectors cost less time than another command.
const GAP: usize = 8;

/// A top-level tree, and the frames that it serves.
struct Top {
    first: usize,
    /// The numbers in the scene of its instances.
    there: Vec<usize>,
    tree: Tree,
    /// Its instances in each of its frames.
    specs: Vec<Vec<InstanceSpec>>,
}

impl Planner<'_> {
    /// The steps of all frames in a scene of two levels.
    pub fn tops(&mut self, stages: Vec<Stage>, rebuild_above: f64) -> Result<Vec<FramePlan>> {
        let directs = self.directs();
        let mut tops: Vec<Top> = vec![];
        let mut empty = vec![];
        for (frame, stage) in stages.iter().enumerate() {
            let (there, specs) = (self.instances_of(frame, stage, &directs))
                .with_context(|| format!("frame {frame}"))?;
            if there.is_empty() {
                empty.push(frame);
                continue;
            }
            let goes_on = (tops.last_mut())
                .filter(|top| top.first + top.specs.len() == frame && top.there == there);
            match goes_on {
                Some(top) if self.serves(top, &specs, rebuild_above)? => top.specs.push(specs),
                _ => tops.push(Top {
                    first: frame,
                    there,
                    tree: self.image.top_tree(&specs, &self.options())?,
                    specs: vec![specs],
                }),
            }
        }
        let mut frames: Vec<FramePlan> = (stages.iter())
            .map(|stage| FramePlan {
                skins: stage.skins.clone(),
                triangles: stage.triangles,
                trees: stage.trees.clone(),
                ..FramePlan::default()
            })
            .collect();
        if !empty.is_empty() {
            let root = self.nothing()?;
            let bounds = self.boxes.len() as u32;
            self.boxes.push(Some(Bounds::EMPTY));
            for frame in empty {
                let stage = &stages[frame];
                let plan = &mut frames[frame];
                (plan.root, plan.bounds) = (root, bounds);
                let update = |&object: &usize| UpdateStep {
                    command: stage.updates[object],
                    bounds: self.box_of(object),
                };
                plan.updates = stage.moved.iter().map(update).collect();
            }
        }
        for top in &tops {
            let range = top.first..top.first + top.specs.len();
            self.place_top(top, &directs, &stages[range.clone()], &mut frames[range])?;
        }
        Ok(frames)
    }

    fn options(&self) -> BuildOptions {
        BuildOptions::default_for(self.config.axes_per_node, self.config.stack_depth)
    }

    /// The instances of a frame, of the copies of objects in the image. The box of an instance that an update writes is the object's.
    fn instances_of(
        &self,
        frame: usize,
        stage: &Stage,
        directs: &[Option<usize>],
    ) -> Result<(Vec<usize>, Vec<InstanceSpec>)> {
        let (there, mut specs) = self.film.instances(frame, &stage.boxes)?;
        for spec in &mut specs {
            if directs[spec.object].is_some() && self.moves(spec.object) {
                spec.world_box = stage.boxes[spec.object];
            }
            spec.object = stage.copies[spec.object];
        }
        Ok((there, specs))
    }

    /// Whether a tree can serve another frame.
    fn serves(&self, top: &Top, specs: &[InstanceSpec], rebuild_above: f64) -> Result<bool> {
        let last = top.specs.last().expect("a tree serves a frame");
        let objects = |specs: &[InstanceSpec]| -> Vec<usize> {
            specs.iter().map(|spec| spec.object).collect()
        };
        if objects(last) != objects(specs) {
            return Ok(false);
        }
        if last == specs || !rebuild_above.is_finite() {
            return Ok(true);
        }
        let rebuilt = self.image.top_tree(specs, &self.options())?;
        let cost = |tree: &Tree| {
            let corners = (specs.iter()).flat_map(|spec| [spec.world_box.lo, spec.world_box.hi]);
            let corners: Vec<[f64; 3]> = corners.collect();
            let leaves = (0..specs.len() as u32).map(|k| [2 * k, 2 * k + 1, 2 * k + 1]);
            let leaves: Vec<[u32; 3]> = leaves.collect();
            let of = TreeStatistics::new(tree, &corners, &leaves, self.config.format());
            of.expected_steps + of.expected_tests
        };
        Ok(cost(&top.tree) <= rebuild_above * cost(&rebuilt))
    }

    /// Places a tree with its instances, and plans its frames.
    fn place_top(
        &mut self,
        top: &Top,
        directs: &[Option<usize>],
        stages: &[Stage],
        frames: &mut [FramePlan],
    ) -> Result<()> {
        let instances = &self.film.scene.instances;
        let by_update: Vec<Option<usize>> = (top.there.iter())
            .map(|&number| {
                let object = instances[number];
                (directs[object].is_some() && self.moves(object)).then_some(object)
            })
            .collect();
        let mut placed = Placed {
            top,
            by_update,
            changing: vec![],
            update: None,
            place: TopPlace::default(),
            bounds: self.boxes.len() as u32,
        };
        let numbers = 0..top.there.len();
        placed.changing = (numbers.clone())
            .map(|number| (1..top.specs.len()).any(|frame| placed.changes(frame, number)))
            .collect();
        let lives = placed.changing.contains(&true) || placed.by_update.iter().any(Option::is_some);

        // A box is two vertex records from an even index on.
        if self.image.instance_vectors(0) % 2 == 1 {
            self.image.add_vectors(&[[0.0; 3]])?;
        }
        if lives {
            let count = VECTORS * top.there.len() as u32;
            let corners = (0..count).step_by(VECTORS as usize);
            let corners: Vec<[u32; 2]> = corners.map(|k| [k + 4, k + 5]).collect();
            let program = Program::compile_top(&top.tree, &corners, count, self.machine);
            let program = program.context("the top-level tree")?;
            let order = &program.node_order;
            (self.image).set_top_in_order(&top.specs[0], &top.tree, order)?;
            placed.place = self.image.keep_top();
            let TopPlace { base, vectors, .. } = placed.place;
            let [program, rows] = self.add_program(&program);
            placed.update = Some(Update {
                program,
                rows,
                first_vertex: vectors,
                first_node: base,
                ..Update::default()
            });
            self.blank_nodes.push(base..base + top.there.len() as u32);
        } else {
            self.image.set_top_tree(&top.specs[0], &top.tree)?;
            placed.place = self.image.keep_top();
        }
        let boxes = |number: u32| top.specs[0][number as usize].world_box;
        let stored = top.tree.refit_leaves(boxes).root;
        self.boxes.push((!lives).then_some(stored));
        for number in numbers {
            let first = placed.vectors_of(number);
            if placed.changing[number] {
                self.blank_vertices.push(first..first + VECTORS);
            } else if placed.by_update[number].is_some() {
                self.blank_vertices.push(first + 4..first + VECTORS);
            }
        }
        for (at, (stage, plan)) in std::iter::zip(stages, frames).enumerate() {
            self.frame_of_top(&placed, at, stage, plan)?;
        }
        Ok(())
    }

    /// Plans frame number `at` of those that a tree serves.
    fn frame_of_top(
        &mut self,
        placed: &Placed,
        at: usize,
        stage: &Stage,
        plan: &mut FramePlan,
    ) -> Result<()> {
        let Placed { top, by_update, .. } = placed;
        plan.there.clone_from(&top.there);
        (plan.root, plan.bounds, plan.new_top) = (placed.place.root, placed.bounds, at == 0);
        // The first frame writes all that ever changes, independently of the contents before.
        let changed: Vec<bool> = match at {
            0 => placed.changing.clone(),
            _ => (0..top.there.len())
                .map(|number| placed.changes(at, number))
                .collect(),
        };
        for run in runs(&changed, |number| by_update[number].is_none()) {
            let target = placed.vectors_of(run.start);
            let moved: Vec<[f64; 3]> = top.specs[at][run].iter().flat_map(vectors).collect();
            let rest = self.image.add_vectors(&moved)?;
            self.vectors.instances += moved.len() as u64;
            let step = self.copy(rest, moved.len() as u32, target)?;
            plan.skins.push(step);
        }
        let mut updated = stage.moved.clone();
        let mut writes_boxes = false;
        for &object in by_update.iter().flatten() {
            let moves = updated.contains(&object);
            if at == 0 && !moves {
                updated.push(object);
                plan.triangles += self.film.scene.objects[object].triangles.len() as u64;
            }
            writes_boxes |= at == 0 || moves;
        }
        let update_of = |&object: &usize| UpdateStep {
            command: stage.updates[object],
            bounds: match by_update.iter().position(|by| *by == Some(object)) {
                Some(number) => BoxAt::Corners(placed.vectors_of(number) + 4),
                None => self.box_of(object),
            },
        };
        plan.updates = updated.iter().map(update_of).collect();
        let refits = at == 0 || writes_boxes || changed.contains(&true);
        let update = placed.update.filter(|_| refits);
        plan.top = update.map(|command| UpdateStep {
            command,
            bounds: BoxAt::Box(placed.bounds),
        });
        Ok(())
    }
}

/// A tree in memory.
struct Placed<'a> {
    top: &'a Top,
    /// For each instance: the object whose update writes the box.
    by_update: Vec<Option<usize>>,
    /// For each instance: whether its vectors differ between frames of the tree.
    changing: Vec<bool>,
    /// Its update, if anything below it changes.
    update: Option<Update>,
    place: TopPlace,
    /// The number of its box.
    bounds: u32,
}

impl Placed<'_> {
    /// Whether the vectors of an instance differ from those in the frame before. Those whose box an update writes do not.
    fn changes(&self, frame: usize, number: usize) -> bool {
        let of = |frame: usize| vectors(&self.top.specs[frame][number]);
        self.by_update[number].is_none() && of(frame) != of(frame - 1)
    }

    /// The index of the first vector of an instance.
    fn vectors_of(&self, number: usize) -> u32 {
        self.place.vectors + VECTORS * number as u32
    }
}

/// The six vectors of an instance, without −0.
fn vectors(spec: &InstanceSpec) -> [[f64; 3]; VECTORS as usize] {
    let [x, y, z, w] = spec.world_to_object;
    let Bounds { lo, hi } = spec.world_box;
    [x, y, z, w, lo, hi].map(|vector| vector.map(|number| number + 0.0))
}

/// The runs of marked places. Runs are joined over up to [`GAP`] places between them if all of these are bridges.
fn runs(marked: &[bool], is_bridge: impl Fn(usize) -> bool) -> Vec<std::ops::Range<usize>> {
    let mut runs: Vec<std::ops::Range<usize>> = vec![];
    for place in (0..marked.len()).filter(|&place| marked[place]) {
        match runs.last_mut() {
            Some(run) if place - run.end <= GAP && (run.end..place).all(&is_bridge) => {
                run.end = place + 1;
            }
            _ => runs.push(place..place + 1),
        }
    }
    runs
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_are_joined_over_short_gaps_of_bridges() {
        let mut marked = vec![false; 40];
        for place in [0, 1, 5, 20, 22, 39] {
            marked[place] = true;
        }
        assert_eq!(runs(&marked, |_| true), [0..6, 20..23, 39..40]);
        assert_eq!(
            runs(&marked, |place| place != 21),
            [0..6, 20..21, 22..23, 39..40]
        );
        assert_eq!(runs(&[false; 3], |_| true), []);
        marked.fill(false);
        (marked[0], marked[GAP], marked[2 * GAP + 2]) = (true, true, true);
        assert_eq!(
            runs(&marked, |_| true),
            [0..GAP + 1, 2 * GAP + 2..2 * GAP + 3]
        );
    }
}
