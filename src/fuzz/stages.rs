//! The stages that every machine passes through.

use super::case::{Case, Size};
use super::scene::RandomFilm;
use crate::cache;
use crate::cosim::chip::{self, Behaviour, Chip};
use crate::cosim::lists::Lists;
use crate::cosim::model::{self, BuildOptions, Sources};
use crate::cosim::raycast::{self, RaycastUnit};
use crate::cosim::scoreboard::{Fault, UnitOptions, UnitReport};
use crate::cosim::workload::{Workload, instanced_scene};
use crate::cosim::{animate, build, unit_geometry, unit_skinning, unit_tpu, unit_update};
use crate::emit;
use crate::hw::{self, Plan};
use crate::temporary;
use anyhow::{Context, Result, ensure};
use std::panic::{AssertUnwindSafe, catch_unwind};

/// A stage of the checks of a machine, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Stage {
    /// Generation of the Verilog and the manifest
    Generate,
    /// verilator -Wall, iverilog -g2001 and yosys report no warnings
    Lint,
    /// The traversal unit alone, by traversal steps
    Tpu,
    /// The geometry unit alone, by tests
    Geometry,
    /// The geometry unit alone, by ray transformations
    Transform,
    /// The update processor alone
    Update,
    /// The skinning processor alone
    Skinning,
    /// The ray casting unit on two-level scenes, with rays of every kind
    Raycast,
    /// Skinning, update and ray casting of an animated scene
    Animation,
    /// The whole chip: random command lists, with memory that responds in any order and stalls
    Chip,
}

impl Stage {
    pub const ALL: [Stage; 10] = [
        Stage::Generate,
        Stage::Lint,
        Stage::Tpu,
        Stage::Geometry,
        Stage::Transform,
        Stage::Update,
        Stage::Skinning,
        Stage::Raycast,
        Stage::Animation,
        Stage::Chip,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Stage::Generate => "generate",
            Stage::Lint => "lint",
            Stage::Tpu => "tpu",
            Stage::Geometry => "geometry",
            Stage::Transform => "transform",
            Stage::Update => "update",
            Stage::Skinning => "skinning",
            Stage::Raycast => "raycast",
            Stage::Animation => "animation",
            Stage::Chip => "chip",
        }
    }
}

/// The result of a passed stage: the number of files generated, of tools without a warning, or of results compared in all bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Checked {
    pub stage: Stage,
    pub count: u64,
}

/// A failure of a machine.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Failure {
    pub stage: Stage,
    /// One line, or the report of a mismatch.
    pub message: String,
}

/// The folder of models: it is cleared after every machine, because its models are not needed again.
pub struct Workbench {
    folder: temporary::Folder,
    build: BuildOptions,
    /// A fault in the Verilog of one unit, with which tests check that the stage fails.
    fault: Option<(Stage, Fault)>,
}

impl Workbench {
    /// Creates a workbench separate from the user's models; it is removed when dropped. A first model is built here, which checks
    /// that all tools work.
    ///
    /// # Errors
    /// One line that names a tool that is missing or fails, or a cache that cannot be written.
    pub fn new() -> Result<Workbench> {
        let cache = cache::folder(None)?;
        let folder =
            temporary::Folder::named(&cache, build::Workshop::PREFIX).with_context(|| {
                format!(
                    "cannot write to the cache {}; set DYNRT_CACHE to a folder that can be written",
                    cache.display()
                )
            })?;
        let bench = Workbench {
            build: BuildOptions {
                // Simulations are short, so the compile time dominates.
                opt: OPT.into(),
                models: Some(folder.path().to_path_buf()),
                ..BuildOptions::default()
            },
            folder,
            fault: None,
        };
        let trivial = Sources {
            top: "trivial".into(),
            files: vec![("trivial.v".into(), TRIVIAL.into())],
            ports: [("clk", true), ("d", true), ("q", false)]
                .map(|(name, input)| model::Port {
                    name: name.into(),
                    width: 1,
                    input,
                })
                .into(),
        };
        model::lint(&trivial)?;
        model::build(&trivial, &bench.build, &|_| ())?;
        Ok(bench)
    }

    /// As [`Workbench::new`], with a fault in the Verilog of one stage's unit.
    #[must_use]
    pub fn with_fault(mut self, stage: Stage, fault: Fault) -> Workbench {
        self.fault = Some((stage, fault));
        self
    }

    /// Removes the models built so far; errors are ignored.
    pub fn clear(&self) {
        let models = std::fs::read_dir(self.folder.path());
        for model in models.into_iter().flatten().flatten() {
            let _ = std::fs::remove_dir_all(model.path());
        }
    }

    /// Runs the stages of `stages` on a case, in order. `told` is called before each stage.
    ///
    /// # Errors
    /// The first stage that fails or checks nothing.
    pub fn check(
        &self,
        case: &Case,
        stages: &[Stage],
        told: &dyn Fn(Stage),
    ) -> Result<Vec<Checked>, Failure> {
        let mut all = vec![];
        for stage in Stage::ALL.into_iter().filter(|s| stages.contains(s)) {
            told(stage);
            let found = catch_unwind(AssertUnwindSafe(|| self.stage(case, stage)));
            let failure = match found {
                Ok(Ok(0)) => "nothing was checked".to_string(),
                Ok(Ok(count)) => {
                    all.push(Checked { stage, count });
                    continue;
                }
                Ok(Err(error)) => format!("{error:#}"),
                Err(panic) => {
                    let text = panic.downcast_ref::<String>().map(String::as_str);
                    let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
                    format!("panic: {}", text.unwrap_or("without a message"))
                }
            };
            return Err(Failure {
                stage,
                message: failure,
            });
        }
        Ok(all)
    }

    fn stage(&self, case: &Case, stage: Stage) -> Result<u64> {
        let Case {
            seed,
            config,
            sizes,
        } = case;
        let transactions = u64::from(sizes.get(Size::Transactions));
        let options = UnitOptions {
            build: self.build.clone(),
            fault: (self.fault.filter(|(of, _)| *of == stage)).map(|(_, fault)| fault),
            ..UnitOptions::new(*seed)
        };
        let one_level = Workload::Coincidences { transactions };
        let two_levels = Workload::Instances { transactions };
        let checked = |report: UnitReport| report.verdict().map(|()| report.checked);
        match stage {
            Stage::Generate => {
                let (_, files) = emit::generate(config)?;
                Ok(files.len() as u64)
            }
            Stage::Lint => {
                for trace in [false, true] {
                    let machine = hw::core::emit(&Plan::new(config)?.with_trace(trace))?;
                    model::lint(&model::Sources::of(&machine.design))?;
                }
                let chip = hw::chip::emit(&Plan::new(config)?)?;
                model::lint(&model::Sources::of(&chip.design))?;
                Ok(3 * LINT_TOOLS)
            }
            Stage::Tpu => {
                let one = checked(unit_tpu::run(config, one_level, &options)?)?;
                Ok(one + checked(unit_tpu::run(config, two_levels, &options)?)?)
            }
            Stage::Geometry => {
                let one = checked(unit_geometry::run(config, one_level, &options)?)?;
                Ok(one + checked(unit_geometry::run(config, two_levels, &options)?)?)
            }
            Stage::Transform => {
                checked(unit_geometry::run_transform(config, two_levels, &options)?)
            }
            Stage::Update => {
                let workload = unit_update::Workload::Random {
                    instructions: transactions,
                };
                let traffic = [unit_update::Traffic::Separate, unit_update::Traffic::Shared];
                let traffic = traffic[(seed % 2) as usize];
                checked(unit_update::run(config, workload, traffic, &options)?.unit)
            }
            Stage::Skinning => {
                let workload = unit_skinning::Workload::Random {
                    vertices: transactions.div_ceil(4),
                };
                let traffic = [
                    unit_skinning::Traffic::Separate,
                    unit_skinning::Traffic::Shared,
                ];
                let traffic = traffic[(seed % 2) as usize];
                checked(unit_skinning::run(config, workload, traffic, &options)?.unit)
            }
            Stage::Raycast => self.raycast(case),
            Stage::Animation => self.animation(case),
            Stage::Chip => self.chip(case),
        }
    }

    /// Scenes of two levels, with memories that never stall and memories that stall often.
    fn raycast(&self, case: &Case) -> Result<u64> {
        let Case {
            seed,
            config,
            sizes,
        } = case;
        let mut rng = fastrand::Rng::with_seed(seed ^ 0x7261_7963_6173_7400);
        let mut unit = RaycastUnit::built(config, None, &self.build)?;
        let count = (sizes.get(Size::Packets) * config.rays_per_packet) as usize;
        let mut checked = 0;
        for stall in [0.0, 0.3] {
            let (image, rays) = instanced_scene(config, count, &mut rng)?;
            let options = raycast::Options {
                seed: rng.u64(..),
                ray_stall: stall,
                hit_stall: stall,
                ..raycast::Options::default()
            };
            let report = unit.cast(&image, &rays, &options, &|_| ())?;
            ensure!(
                report.hits_checked == rays.len() as u64,
                "{} of {} hits were checked",
                report.hits_checked,
                rays.len()
            );
            checked += report.checked();
        }
        Ok(checked)
    }

    fn animation(&self, case: &Case) -> Result<u64> {
        let film = RandomFilm::new(case)?;
        let options = animate::Options {
            seed: case.seed,
            rebuild_above: [1.0, animate::REBUILD_ABOVE, f64::INFINITY][(case.seed % 3) as usize],
            build: self.build.clone(),
            ..animate::Options::default()
        };
        let (mut checked, mut frames) = (0, 0);
        animate::run(&case.config, film.film(), &options, &|_, _| (), |frame| {
            checked += frame.figures.checked;
            frames += 1;
            Ok(())
        })?;
        let asked = case.sizes.get(Size::Frames);
        ensure!(frames == asked, "{frames} of {asked} frames were drawn");
        Ok(checked)
    }
}

impl Workbench {
    /// Random lists in a scene of two levels, behind a random memory and behind that of the configuration.
    fn chip(&self, case: &Case) -> Result<u64> {
        let Case {
            seed,
            config,
            sizes,
        } = case;
        let mut rng = fastrand::Rng::with_seed(seed ^ 0x6368_6970);
        let count = (sizes.get(Size::Packets) * config.rays_per_packet) as usize;
        let mut checked = 0;
        for behaviour in [Behaviour::Random, Behaviour::Model] {
            let options = chip::Options {
                seed: *seed,
                behaviour,
                build: self.build.clone(),
                ..chip::Options::default()
            };
            let mut chip = Chip::new(config, &options, &|_| ())?;
            let (image, rays) = instanced_scene(config, count, &mut rng)?;
            let mut lists = Lists::new(config, &image, &rays)?;
            for _ in 0..RANDOM_LISTS {
                lists.add(&mut rng)?;
            }
            let (mut memory, starts) = lists.finish();
            for list in starts {
                let report = chip.run(&mut memory, list, &|_| ())?;
                ensure!(
                    report.outcome.rays > 0 || report.checked > 0,
                    "a list did nothing"
                );
                checked += report.checked;
            }
        }
        Ok(checked)
    }
}

/// Random lists of a chip, for each behaviour of memory.
const RANDOM_LISTS: u32 = 4;

/// The compiler's optimisation option for models.
const OPT: &str = "-O0";

/// Verilator, Icarus Verilog and Yosys.
const LINT_TOOLS: u64 = 3;

/// The smallest module on which every tool can be tried.
const TRIVIAL: &str = "`default_nettype none
module trivial (input wire clk, input wire d, output reg q);
    always @(posedge clk) q <= d;
endmodule
`default_nettype wire
";
