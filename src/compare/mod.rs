//! Compares the project's software with Embree 3 in one process: the same mesh and the same rays, in alternation.
//!
//! Both sides get the scene and the rays as the machine has them, rounded to its number format; numbers of
//! [`Format::FP24`](crate::float::Format::FP24) are exact in Embree's single precision. Hits can therefore differ only by
//! the arithmetic. Each ray with a different triangle is explained in the same way as a pixel that differs from the `f64`
//! intersector ([`Oracle::account`]).
//!
//! On DynRT's side the times are those of software, the builder and the golden model. Co-simulation measures the machine's speed.

mod embree;
mod picture;

pub use embree::Embree;
pub use picture::mark_differences;

use std::time::Instant;

use anyhow::{Context, Result, ensure};

use crate::bkd::{BuildOptions, MemoryImage, Tree, build};
use crate::config::Config;
use crate::float::Arithmetic;
use crate::golden::Caster;
use crate::golden::oracle::{Account, Oracle};
use crate::port::{Hit, Ray};
use crate::scene::MachineMesh;
use embree::{Mesh, rays_exactly, vertices_exactly};

/// Default number of rounds.
pub const ROUNDS: u32 = 5;

/// A measured task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Task {
    /// DynRT: the default tree and its memory image. Embree: a tree of medium quality.
    Build,
    /// New bounds for moved vertices.
    Refit,
    /// Closest hits, with this many rays at a time.
    Cast { together: usize },
}

/// The times of one task on both sides, measured in alternation.
#[derive(Clone, Debug)]
pub struct Timing {
    pub task: Task,
    pub cores: usize,
    /// Triangles built or refitted, or active rays cast, per round.
    pub work: usize,
    /// Seconds of DynRT, one value per round.
    pub ours_s: Vec<f64>,
    /// Seconds of Embree, one value per round.
    pub embree_s: Vec<f64>,
}

impl Timing {
    fn new(task: Task, cores: usize, work: usize) -> Self {
        Timing {
            task,
            cores,
            work,
            ours_s: Vec::new(),
            embree_s: Vec::new(),
        }
    }

    /// Median of DynRT's seconds over all rounds.
    pub fn ours(&self) -> f64 {
        median(&self.ours_s)
    }

    /// Median of Embree's seconds over all rounds.
    pub fn embree(&self) -> f64 {
        median(&self.embree_s)
    }

    /// Speed of Embree relative to DynRT: the median over the rounds of the ratio of two consecutive measurements.
    pub fn ratio(&self) -> f64 {
        let rounds = std::iter::zip(&self.ours_s, &self.embree_s);
        median(
            &rounds
                .map(|(ours, embree)| ours / embree)
                .collect::<Vec<_>>(),
        )
    }

    /// Measures both sides, DynRT first in even rounds.
    fn round(
        &mut self,
        round: u32,
        ours: impl FnOnce() -> Result<()>,
        embree: impl FnOnce() -> Result<()>,
    ) -> Result<()> {
        let (ours_s, embree_s);
        if round.is_multiple_of(2) {
            ours_s = seconds(ours)?;
            embree_s = seconds(embree)?;
        } else {
            embree_s = seconds(embree)?;
            ours_s = seconds(ours)?;
        }
        self.ours_s.push(ours_s);
        self.embree_s.push(embree_s);
        Ok(())
    }
}

fn seconds(work: impl FnOnce() -> Result<()>) -> Result<f64> {
    let started = Instant::now();
    work()?;
    // The clock may be too coarse for the refit of a small scene, so avoid a time of zero.
    Ok(started.elapsed().as_secs_f64().max(1e-9))
}

/// The median; for an even count, the mean of the two middle values.
fn median(numbers: &[f64]) -> f64 {
    let mut sorted = numbers.to_vec();
    sorted.sort_by(f64::total_cmp);
    let middle = sorted.len() / 2;
    match sorted.len() % 2 {
        0 => (sorted[middle - 1] + sorted[middle]) / 2.0,
        _ => sorted[middle],
    }
}

/// The comparison of the hits in one pose.
#[derive(Clone, Debug)]
pub struct Agreement {
    pub account: Account,
    /// The machine's hits, one per ray.
    pub hits: Vec<Hit>,
    /// Number of differing rays for which `f64`, as a substitute for exact arithmetic, agrees with the machine.
    pub machine_exact: usize,
    /// Number of differing rays for which it agrees with Embree.
    pub embree_exact: usize,
}

/// The result of a comparison.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Embree's version.
    pub version: String,
    /// Number of cores used for casting on all cores.
    pub cores: usize,
    pub rounds: u32,
    /// The original mesh, with both indexes built.
    pub built: Agreement,
    /// The mesh with moved vertices, with both indexes refitted.
    pub refitted: Agreement,
    /// Number of rays for which Embree reports another triangle when it casts four at a time.
    pub embree_differs_by_four: usize,
    pub timings: Vec<Timing>,
}

impl Comparison {
    /// Checks that the hits agree as required in both poses.
    ///
    /// # Errors
    /// One line that describes the fault: see [`Account::verdict`].
    pub fn verdict(&self) -> Result<()> {
        for (what, agreement) in [("built", &self.built), ("refitted", &self.refitted)] {
            let context = || format!("the {what} mesh against Embree {}", self.version);
            agreement.account.verdict().with_context(context)?;
        }
        Ok(())
    }
}

/// Numbers of rays cast at a time.
const TOGETHER: [usize; 2] = [1, 4];

/// Maximum motion of a vertex, as a share of the diagonal of the scene's box.
const DISPLACEMENT: f64 = 0.01;

/// The mesh displaced by a smooth wave, in the mesh's number format. Neighbours stay neighbours, as in animations.
fn displaced(mesh: &MachineMesh) -> Vec<[f64; 3]> {
    let arithmetic = Arithmetic::new(mesh.format);
    let (low, high) = mesh.bounds();
    let extent: [f64; 3] = std::array::from_fn(|k| high[k] - low[k]);
    let diagonal = extent.iter().map(|x| x * x).sum::<f64>().sqrt();
    // Three waves across the scene; the displacement on each axis depends on the coordinate on the next axis.
    let wave = |vertex: &[f64; 3], axis: usize| {
        let along = (axis + 1) % 3;
        let place = (vertex[along] - low[along]) / diagonal.max(f64::MIN_POSITIVE);
        vertex[axis] + DISPLACEMENT * diagonal * (3.0 * std::f64::consts::TAU * place).sin()
    };
    let displace = |v: &[f64; 3]| std::array::from_fn(|axis| arithmetic.round(wave(v, axis)) + 0.0);
    mesh.vertices.iter().map(displace).collect()
}

/// The same vertices in both precisions.
struct Pose {
    vertices: Vec<[f64; 3]>,
    singles: Vec<[f32; 3]>,
}

impl Pose {
    fn new(vertices: Vec<[f64; 3]>) -> Result<Pose> {
        let singles = vertices_exactly(&vertices)?;
        Ok(Pose { vertices, singles })
    }
}

/// The inputs of both sides.
struct Bench<'a> {
    config: &'a Config,
    mesh: &'a MachineMesh,
    rays: &'a [Ray],
    their_rays: Vec<embree::Ray>,
    rest: Pose,
    moved: Pose,
    tree: Tree,
}

impl<'a> Bench<'a> {
    fn new(config: &'a Config, mesh: &'a MachineMesh, rays: &'a [Ray]) -> Result<Self> {
        Ok(Bench {
            config,
            mesh,
            rays,
            their_rays: rays_exactly(rays)?,
            rest: Pose::new(mesh.vertices.clone())?,
            moved: Pose::new(displaced(mesh))?,
            tree: build(&mesh.vertices, &mesh.triangles, &build_options(config))?,
        })
    }

    /// The memory image of the tree, refitted to a pose.
    fn image(&self, tree: &Tree, pose: &Pose) -> Result<MemoryImage> {
        let MachineMesh {
            format, triangles, ..
        } = self.mesh;
        let image = MemoryImage::new(*format, &pose.vertices, triangles, tree)?;
        image.check(self.config.stack_depth)?;
        Ok(image)
    }

    /// The golden model for a pose.
    fn caster(&self, pose: &Pose, together: usize) -> Result<Caster> {
        let image = self.image(&self.tree, pose)?;
        Ok(Caster::new(&image, self.config.triangle_test, together))
    }

    /// Builds the memory image from the mesh.
    fn build_ours(&self) -> Result<()> {
        let MachineMesh {
            format,
            vertices,
            triangles,
            ..
        } = self.mesh;
        let tree = build(vertices, triangles, &build_options(self.config))?;
        std::hint::black_box(MemoryImage::new(*format, vertices, triangles, &tree)?);
        Ok(())
    }

    /// Embree's hits compared with the machine's.
    fn agreement(&self, pose: &Pose, machine: Vec<Hit>, embree: &[embree::Hit]) -> Agreement {
        let others: Vec<Hit> = embree.iter().map(|&hit| hit.into()).collect();
        let oracle = Oracle::new(&pose.vertices, &self.mesh.triangles);
        let account = oracle.account(self.mesh.format, self.rays, &machine, &others);
        let exact_as = |hits: &[Hit]| {
            let same = |&&(index, _): &&(usize, _)| {
                oracle.cast(&self.rays[index]).triangle == hits[index].triangle
            };
            account.differences.iter().filter(same).count()
        };
        Agreement {
            machine_exact: exact_as(&machine),
            embree_exact: exact_as(&others),
            account,
            hits: machine,
        }
    }
}

fn build_options(config: &Config) -> BuildOptions {
    BuildOptions::default_for(config.axes_per_node, config.stack_depth)
}

/// Runs the comparison on a mesh of one level. `rays` are closest-hit rays; the configuration gives the options of the tree and the
/// triangle test. `progress` receives the number of finished rounds.
///
/// # Errors
/// One line if Embree is missing, if single precision cannot represent a number, if a mesh cannot be built, or if hits depend on
/// the packet size, which is a bug of the golden model. [`Comparison::verdict`] checks that the hits agree.
pub fn run(
    config: &Config,
    mesh: &MachineMesh,
    rays: &[Ray],
    rounds: u32,
    progress: &dyn Fn(u32),
) -> Result<Comparison> {
    ensure!(
        rounds > 0,
        "nothing is measured in 0 rounds; give 1 or more"
    );
    let embree = Embree::load()?;
    let bench = Bench::new(config, mesh, rays)?;
    let their_mesh =
        |moves| -> Result<Mesh> { Mesh::new(&embree, &bench.rest.singles, &mesh.triangles, moves) };
    let mut theirs = their_mesh(false)?;
    theirs.commit()?;
    let mut moving = their_mesh(true)?;
    moving.commit()?;

    let all = rayon::current_num_threads();
    let one = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .context("no thread can be started")?;
    let mut building = Timing::new(Task::Build, 1, mesh.triangles.len());
    let mut refitting = Timing::new(Task::Refit, 1, mesh.triangles.len());
    let mut casting = Vec::new();
    let active = rays.iter().filter(|ray| ray.active).count();
    for together in TOGETHER {
        let ours = bench.caster(&bench.rest, together)?;
        casting.push(Casting {
            together,
            ours,
            our_hits: vec![],
            their_hits: vec![embree::Hit::MISS; rays.len()],
            one_core: Timing::new(Task::Cast { together }, 1, active),
            all_cores: Timing::new(Task::Cast { together }, all, active),
        });
    }
    for round in 0..rounds {
        // Each build of Embree needs a mesh without an index; the copy is not part of the measured time.
        let mut fresh = their_mesh(false)?;
        building.round(round, || bench.build_ours(), || fresh.commit())?;

        let pose = match round % 2 {
            0 => &bench.moved,
            _ => &bench.rest,
        };
        moving.move_to(&pose.singles);
        let refit = || {
            std::hint::black_box(bench.tree.refit(&pose.vertices, &mesh.triangles));
            Ok(())
        };
        refitting.round(round, refit, || moving.commit())?;

        for casting in &mut casting {
            let Casting {
                together,
                ours,
                our_hits,
                their_hits,
                one_core,
                all_cores,
            } = casting;
            let by_four = *together == 4;
            let mut cast_ours = || {
                *our_hits = ours.cast_packets(rays).hits;
                Ok(())
            };
            let mut cast_theirs = || theirs.cast(&bench.their_rays, their_hits, by_four);
            one_core.round(
                round,
                || one.install(&mut cast_ours),
                || one.install(&mut cast_theirs),
            )?;
            if all > 1 {
                all_cores.round(round, cast_ours, cast_theirs)?;
            }
        }
        progress(round + 1);
    }

    let [singly, by_four]: [Casting; 2] = casting.try_into().ok().expect("one for each number");
    for (index, (a, b)) in std::iter::zip(&singly.our_hits, &by_four.our_hits).enumerate() {
        ensure!(
            a.same_bits(b, mesh.format),
            "ray {index} hits otherwise alone than in a packet of 4: {a:?}, {b:?}"
        );
    }
    let pairs = std::iter::zip(&singly.their_hits, &by_four.their_hits);
    let embree_differs_by_four = pairs.filter(|(a, b)| !a.same_triangle(b)).count();

    // The last round may have left either pose.
    moving.move_to(&bench.moved.singles);
    moving.commit()?;
    let mut their_hits = vec![embree::Hit::MISS; rays.len()];
    moving.cast(&bench.their_rays, &mut their_hits, false)?;
    let our_hits = bench.caster(&bench.moved, 4)?.cast_packets(rays).hits;
    let refitted = bench.agreement(&bench.moved, our_hits, &their_hits);
    let built = bench.agreement(&bench.rest, singly.our_hits, &singly.their_hits);

    let mut timings = vec![building, refitting, singly.one_core, by_four.one_core];
    if all > 1 {
        timings.extend([singly.all_cores, by_four.all_cores]);
    }
    Ok(Comparison {
        version: embree.version(),
        cores: all,
        rounds,
        built,
        refitted,
        embree_differs_by_four,
        timings,
    })
}

/// Rays cast a given number at a time.
struct Casting {
    together: usize,
    ours: Caster,
    our_hits: Vec<Hit>,
    their_hits: Vec<embree::Hit>,
    one_core: Timing,
    all_cores: Timing,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::float::Format;
    use crate::scene;

    #[test]
    fn medians_and_ratios() {
        assert_eq!(median(&[3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(&[4.0, 1.0, 2.0, 3.0]), 2.5);
        let timing = Timing {
            ours_s: vec![2.0, 9.0, 4.0],
            embree_s: vec![1.0, 1.0, 1.0],
            ..Timing::new(Task::Build, 1, 10)
        };
        assert_eq!(
            (timing.ours(), timing.embree(), timing.ratio()),
            (4.0, 1.0, 4.0)
        );
    }

    #[test]
    fn sides_take_turns() {
        use std::cell::RefCell;
        let order = RefCell::new(String::new());
        let mut timing = Timing::new(Task::Refit, 1, 1);
        for round in 0..3 {
            let note = |side| {
                order.borrow_mut().push(side);
                Ok(())
            };
            timing.round(round, || note('o'), || note('e')).unwrap();
        }
        assert_eq!(order.into_inner(), "oeeooe");
        assert_eq!((timing.ours_s.len(), timing.embree_s.len()), (3, 3));
    }

    #[test]
    fn moved_vertices_move_a_little_and_stay_numbers_of_the_format() {
        let scene = scene::builtin("teapot").unwrap();
        let mesh = MachineMesh::new(&scene, Format::FP24).unwrap();
        let (moved, arithmetic) = (displaced(&mesh), Arithmetic::new(Format::FP24));
        let (low, high) = mesh.bounds();
        let diagonal = (0..3).map(|k| (high[k] - low[k]).powi(2)).sum::<f64>();
        let most = 1.01 * DISPLACEMENT * diagonal.sqrt();
        let pairs = std::iter::zip(mesh.vertices.as_flattened(), moved.as_flattened());
        let mut changed = 0;
        for (before, after) in pairs {
            assert!((before - after).abs() <= most);
            assert_eq!(arithmetic.round(*after).to_bits(), after.to_bits());
            changed += usize::from(before != after);
        }
        assert!(changed > mesh.vertices.len(), "only {changed} moved");
    }
}
