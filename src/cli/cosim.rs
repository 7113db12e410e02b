//! `dynrt cosim`: co-simulation of the generated Verilog and the golden model.

use super::files::{Kind, Output};
use super::frame::{Built, Loaded, PictureArgs, active};
use super::waveform::WaveformArgs;
use super::{counted, one_line, print, tell};
use anyhow::{Result, ensure};
use clap::ValueEnum;
use dynrt::bkd::{MemoryImage, Tree};
use dynrt::cosim::mismatch::Mismatch;
use dynrt::cosim::model::Trace;
use dynrt::cosim::raycast::{self, Options, Report};
use dynrt::cosim::scoreboard::{Surroundings, UnitOptions, UnitReport};
use dynrt::cosim::unit_skinning::{self, SkinMesh};
use dynrt::cosim::unit_update::{self, Traffic, UpdateObject};
use dynrt::cosim::workload::{Workload, in_instances};
use dynrt::cosim::{unit_geometry, unit_tpu};
use dynrt::golden::Caster;
use dynrt::hdl::Bundle as _;
use dynrt::port::Ray;
use dynrt::report;
use dynrt::scene::animation::MachineScene;
use dynrt::scene::load_animated;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::time::Duration;

const HELP: &str = "\
The Verilog of the configuration is compiled with Verilator once, kept in a cache ($DYNRT_CACHE, by default the user's cache
folder), and simulated cycle by cycle. Every hit, traversal step, ray transformation and ray-triangle test is compared bit by bit
with the golden model; the picture shows the results of the Verilog. The first mismatch ends the run; the report includes the
command that replays it. The exit status is 0 only if results were compared and all agree.

Examples:
  dynrt cosim builtin:teapot --out teapot.png
  dynrt cosim builtin:interior --view inside --json hall.json
  dynrt cosim builtin:interior --view inside --rays shadow --out shadows.png
  dynrt cosim builtin:teapot --unit tpu --seed 3
  dynrt cosim builtin:teapot --unit transform
  dynrt cosim builtin:sphere --unit update
  dynrt cosim builtin:figure --unit skinning
  dynrt cosim builtin:cornell --size 64x48 --set memory.latency=40 --set memory.jitter=20 --seed 7
  dynrt cosim builtin:cornell --size 64x48 --trace cornell.fst --from 1000 --cycles 500";

/// Co-simulate: cast the rays of a picture in the Verilog and compare with the golden model
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    picture: PictureArgs,
    /// The design under test: the whole ray casting unit with the configured memories, or a single unit with random
    /// delays and stalls at its ports
    #[arg(long, value_name = "UNIT", default_value = "raycast")]
    unit: Unit,
    /// Write the picture computed by the Verilog as PNG
    #[arg(long, value_name = "F.png", value_parser = Kind::Png)]
    out: Option<Output>,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
    #[command(flatten)]
    waveform: WaveformArgs,
}

#[derive(Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Unit {
    /// The traversal unit: every traversal step
    Tpu,
    /// The geometry unit: every ray-triangle test
    Geometry,
    /// The ray transformations of the geometry unit, in a two-level scene: SCENE if it has two levels, else eight instances of it with random rotations
    Transform,
    /// Ray setup, traversal unit and geometry unit together, from rays to hits
    Raycast,
    /// The update processor: every node written by the update program of the scene
    Update,
    /// The skinning processor: every vertex of the scene's skinned meshes, at the middle of the first clip; in a scene without
    /// skinned meshes, all vertices with random joints. SCENE may also be a glTF file
    Skinning,
}

impl Unit {
    fn name(self) -> &'static str {
        match self {
            Unit::Tpu => "tpu",
            Unit::Geometry => "geometry",
            Unit::Transform => "transform",
            Unit::Raycast => "raycast",
            Unit::Update => "update",
            Unit::Skinning => "skinning",
        }
    }
}

/// The report of a mismatch in a unit, of several lines.
#[derive(Debug)]
pub struct UnitMismatch(String);

impl std::fmt::Display for UnitMismatch {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(&self.0)
    }
}

impl std::error::Error for UnitMismatch {}

/// The results that are unknown after a run that ended with a mismatch.
const WHOLE_RUN_KEYS: [&str; 10] = [
    "hits",
    "checked",
    "cycles",
    "packet_steps",
    "ray_triangle_tests",
    "rays_per_clock",
    "tpu_utilisation",
    "gu_utilisation",
    "model_build_s",
    "simulate_s",
];

/// The inputs of a run.
struct Job<'a> {
    args: &'a Args,
    loaded: &'a Loaded,
    active: u64,
}

pub fn run(args: &Args) -> Result<()> {
    ensure!(
        args.unit == Unit::Raycast || args.out.is_none(),
        "--unit {}: a single unit computes no picture; leave out --out",
        args.unit.name()
    );
    args.waveform.around(|trace| run_traced(args, trace))
}

fn run_traced(args: &Args, trace: Option<Trace>) -> Result<()> {
    if args.unit == Unit::Skinning {
        return args.run_skinning(trace);
    }
    let PictureArgs { size, seed, .. } = args.picture;
    let loaded = args.picture.load()?;
    let Built { image, tree, .. } = loaded.build_default()?;
    let cast = args.picture.rays_of(&loaded, &image)?;
    let rays = cast.rays();
    let job = Job {
        args,
        loaded: &loaded,
        active: active(&rays)?,
    };
    if args.unit == Unit::Update {
        return job.run_update(&tree, trace);
    }
    if args.unit == Unit::Transform && !image.is_instanced() {
        let image = in_instances(&loaded.config, &image, seed)?;
        return job.run_unit(&image, &rays, trace);
    }
    if args.unit != Unit::Raycast {
        return job.run_unit(&image, &rays, trace);
    }
    let options = Options {
        seed,
        trace,
        replay: args.replay(),
        ..Options::default()
    };
    let bar = report::progress(rays.len() as u64, "building the model");
    bar.enable_steady_tick(Duration::from_millis(500));
    let result = raycast::run(&loaded.config, &image, &rays, &options, &|done| {
        bar.set_message("rays");
        bar.set_position(done);
    });
    bar.finish_and_clear();
    let found = match result {
        Ok(found) => found,
        Err(error) => {
            if let (Some(json), Some(mismatch)) = (&args.json, error.downcast_ref::<Mismatch>()) {
                let value = job.mismatch_json(&one_line(&error), mismatch.cycle, None);
                json.json(&value)?.publish()?;
            }
            return Err(error);
        }
    };
    ensure!(found.checked() > 0, "nothing was checked");
    args.waveform.check(found.cycles);
    let mut text = job.text(&found);
    let mut files = vec![];
    if let Some(out) = &args.out {
        let picture = cast.picture(size, &loaded, &found.hits);
        files.push(out.png(&picture)?);
        let _ = writeln!(text, "picture: {out}");
    }
    text += &args.waveform.line();
    if let Some(json) = &args.json {
        files.push(json.json(&job.json(&found))?);
    }
    report::publish_all(files)?;
    print(&text)
}

/// Adds the entries of one JSON object to another.
fn extend(value: &mut Value, more: Value) {
    if let (Value::Object(all), Value::Object(more)) = (value, more) {
        all.extend(more);
    }
}

impl Args {
    /// The command that runs this again.
    fn replay(&self) -> String {
        let mut text = format!("dynrt cosim{}", self.picture.replay());
        if self.unit != Unit::Raycast {
            text += &format!(" --unit {}", self.unit.name());
        }
        text
    }

    /// Runs the skinning processor alone, which needs no rays: first with random delays and stalls at its ports, then at full rate.
    fn run_skinning(&self, trace: Option<Trace>) -> Result<()> {
        let config = self.picture.config.load()?;
        let spec = self.picture.scene.spec();
        let scene = load_animated(spec)?;
        for warning in &scene.warnings {
            tell(&format!("warning: {warning}"));
        }
        let clip = scene.clip(None)?;
        let seconds = clip.map_or(0.0, |clip| scene.clips[clip].seconds / 2.0);
        let pose = scene.pose(clip, seconds)?;
        let extents = scene.extents_of(std::slice::from_ref(&pose))?;
        let (format, joints) = (config.format(), config.skinning_joints);
        let machine = MachineScene::new(&scene, &extents, format, joints)?;
        let hidden = scene.warnings_of(std::slice::from_ref(&pose));
        for warning in hidden.into_iter().chain(machine.warnings(&scene, &extents)) {
            tell(&format!("warning: {warning}"));
        }
        let frame = machine.frame(&pose)?;
        let mut meshes: Vec<SkinMesh> = std::iter::zip(&machine.objects, &frame.objects)
            .filter_map(|(object, frame)| SkinMesh::of_frame(object, frame))
            .collect();
        if meshes.is_empty() {
            tell(&format!(
                "{}: has no skinned meshes; vertices have random joints",
                scene.name
            ));
            let bound =
                |object| SkinMesh::bound_at_random(format, object, joints, self.picture.seed);
            meshes = machine.objects.iter().map(bound).collect();
        }
        let workload = unit_skinning::Workload::Meshes(&meshes);
        let options = UnitOptions {
            replay: self.replay(),
            trace,
            ..UnitOptions::new(self.picture.seed)
        };
        let at_pace = UnitOptions {
            surroundings: Some(Surroundings::steady(config.memory_latency)),
            trace: None,
            ..options.clone()
        };
        let write = |mut value: Value, found: &UnitReport| {
            extend(
                &mut value,
                json!({
                    "scene": scene.name,
                    "triangles": scene.triangle_count(),
                    "config": config.name,
                    "overrides": self.picture.config.overrides(&config),
                    "unit": self.unit.name(),
                    "seed": self.picture.seed,
                    "mismatches": found.mismatches,
                }),
            );
            match &self.json {
                Some(json) => json.json(&value)?.publish(),
                None => Ok(()),
            }
        };
        use unit_skinning::Traffic;
        let checked_run = |traffic, options: &UnitOptions| {
            let found = unit_skinning::run(&config, workload, traffic, options)?;
            let unit = &found.unit;
            if let Some(mismatch) = &unit.mismatch {
                let value = json!({
                    "checked": unit.checked,
                    "cycles": unit.cycles,
                    "mismatch": mismatch,
                    "replay": self.replay(),
                });
                write(value, unit)?;
                return Err(UnitMismatch(mismatch.clone()).into());
            }
            unit.verdict()?;
            Ok::<_, anyhow::Error>(found)
        };
        let found = checked_run(Traffic::Separate, &options)?;
        self.waveform.check(found.unit.cycles);
        let pace = checked_run(Traffic::Shared, &at_pace)?;
        let (unit, total) = (&found.unit, pace.total());
        let categories: Map<String, Value> = (unit.categories.iter())
            .map(|(category, count)| (category.name().to_string(), json!(count)))
            .collect();
        let value = json!({
            "meshes": pace.meshes.len(),
            "vertices": total.vertices,
            "influences": total.influences,
            "busy_cycles": total.busy_cycles,
            "influences_per_clock": total.influences_per_clock(),
            "vertices_per_clock": total.vertices_per_clock(),
            "checked": unit.checked + pace.unit.checked,
            "cycles": unit.cycles + pace.unit.cycles,
            "categories": categories,
            "model_build_s": unit.model_build_s + pace.unit.model_build_s,
            "simulate_s": unit.simulate_s + pace.unit.simulate_s,
        });
        write(value, unit)?;
        print(&format!(
            "{}\nat full rate, with {} bytes of memory traffic per cycle:\n{}\n",
            found.summary(),
            unit_skinning::SHARED_BYTES,
            pace.summary()
        ))
    }
}

impl Job<'_> {
    /// The results that are known for every outcome of the run.
    fn common_json(&self) -> Value {
        let size = self.args.picture.size;
        json!({
            "scene": self.loaded.scene.name,
            "triangles": self.loaded.mesh.triangles.len(),
            "config": self.loaded.config.name,
            "overrides": self.args.picture.config.overrides(&self.loaded.config),
            "view": self.loaded.view,
            "unit": self.args.unit.name(),
            "ray_kind": self.args.picture.rays.name(),
            "seed": self.args.picture.seed,
            "width": size.width,
            "height": size.height,
            "rays": self.active,
        })
    }

    /// The report of a run that ended with a mismatch; results of a whole run are null.
    fn mismatch_json(&self, mismatch: &str, cycles: u64, checked: Option<u64>) -> Value {
        let mut value = self.common_json();
        for key in WHOLE_RUN_KEYS {
            value[key] = Value::Null;
        }
        value["checked"] = json!(checked);
        value["cycles"] = json!(cycles);
        value["mismatches"] = json!(1);
        value["mismatch"] = json!(mismatch);
        value["replay"] = json!(self.args.replay());
        value
    }

    /// Runs one unit alone.
    fn run_unit(&self, image: &MemoryImage, rays: &[Ray], trace: Option<Trace>) -> Result<()> {
        let args = self.args;
        let Loaded { config, frame, .. } = self.loaded;
        let caster = Caster::new(image, config.triangle_test, frame.rays_per_packet());
        let hits = caster.cast_packets(rays).hits;
        let hits = hits.iter().filter(|hit| hit.is_hit()).count();
        let options = UnitOptions {
            replay: self.args.replay(),
            trace,
            ..UnitOptions::new(args.picture.seed)
        };
        let workload = Workload::Rays { image, rays };
        let run = match args.unit {
            Unit::Tpu => unit_tpu::run,
            Unit::Transform => unit_geometry::run_transform,
            _ => unit_geometry::run,
        };
        let found = run(config, workload, &options)?;
        let write = |value| match &args.json {
            Some(json) => json.json(&value)?.publish(),
            None => Ok(()),
        };
        if let Some(mismatch) = found.mismatch {
            write(self.mismatch_json(&mismatch, found.cycles, Some(found.checked)))?;
            return Err(UnitMismatch(mismatch).into());
        }
        found.verdict()?;
        self.args.waveform.check(found.cycles);
        write(self.unit_json(&found, hits))?;
        print(&format!("{}\n", found.summary()))
    }

    /// Runs the update processor alone, on the update program of the scene.
    fn run_update(&self, tree: &Tree, trace: Option<Trace>) -> Result<()> {
        let Loaded {
            config,
            mesh,
            scene,
            ..
        } = self.loaded;
        let options = UnitOptions {
            replay: self.args.replay(),
            trace,
            ..UnitOptions::new(self.args.picture.seed)
        };
        let object = UpdateObject::new(
            &scene.name,
            mesh.format,
            unit_update::machine(config)?,
            tree,
            &mesh.triangles,
            &mesh.vertices,
        )?;
        let workload = unit_update::Workload::Objects(std::slice::from_ref(&object));
        let found = unit_update::run(config, workload, Traffic::Separate, &options)?;
        let write = |value| match &self.args.json {
            Some(json) => json.json(&value)?.publish(),
            None => Ok(()),
        };
        let unit = &found.unit;
        if let Some(mismatch) = &unit.mismatch {
            write(self.mismatch_json(mismatch, unit.cycles, Some(unit.checked)))?;
            return Err(UnitMismatch(mismatch.clone()).into());
        }
        unit.verdict()?;
        self.args.waveform.check(unit.cycles);
        let mut value = self.unit_json(unit, 0);
        for figures in &found.objects {
            extend(
                &mut value,
                json!({
                    "instructions": figures.instructions,
                    "nodes_written": figures.nodes_written,
                    "busy_cycles": figures.busy_cycles,
                    "stalled_cycles": figures.stalled_cycles,
                    "instructions_per_clock": figures.instructions_per_clock(),
                    "triangles_per_clock": figures.triangles_per_clock(),
                    "nodes_per_clock": figures.nodes_per_clock(),
                }),
            );
        }
        write(value)?;
        print(&format!("{}\n", found.summary().trim_end()))
    }

    fn unit_json(&self, found: &UnitReport, hits: usize) -> Value {
        let of = |unit| match self.args.unit == unit {
            true => found.transactions,
            false => 0,
        };
        let per_clock = |count: u64| count as f64 / found.cycles as f64;
        let categories: Map<String, Value> = (found.categories.iter())
            .map(|(category, count)| (category.name().to_string(), json!(count)))
            .collect();
        let mut value = self.common_json();
        extend(
            &mut value,
            json!({
                "hits": hits,
                "checked": found.checked,
                "mismatches": found.mismatches,
                "cycles": found.cycles,
                "packet_steps": of(Unit::Tpu),
                "ray_triangle_tests": of(Unit::Geometry),
                "ray_transforms": of(Unit::Transform),
                "rays_per_clock": per_clock(self.active),
                "tpu_utilisation": per_clock(of(Unit::Tpu)),
                "gu_utilisation": per_clock(of(Unit::Geometry)),
                "categories": categories,
                "model_build_s": found.model_build_s,
                "simulate_s": found.simulate_s,
            }),
        );
        value
    }

    fn hits(&self, found: &Report) -> u64 {
        let hits = found.hits.iter().filter(|hit| hit.is_hit());
        hits.count() as u64
    }

    fn rays_per_clock(&self, found: &Report) -> f64 {
        self.active as f64 / found.cycles as f64
    }

    fn json(&self, found: &Report) -> Value {
        let mut value = self.common_json();
        // The cycles of the run are reported next to the counter of cycles since reset.
        let counters = found.counters.fields().into_iter();
        let counters: Map<String, Value> =
            counters.map(|(name, count)| (name, json!(count))).collect();
        extend(&mut value, Value::Object(counters));
        let results = json!({
            "hits": self.hits(found),
            "checked": found.checked(),
            "hits_checked": found.hits_checked,
            "steps_checked": found.steps_checked,
            "tests_checked": found.tests_checked,
            "transforms_checked": found.transforms_checked,
            // Always 0: a mismatch ends the run with an error.
            "mismatches": 0,
            "cycles": found.cycles,
            "rays_per_clock": self.rays_per_clock(found),
            "tpu_utilisation": found.tpu_utilisation(),
            "gu_utilisation": found.gu_utilisation(),
            "stack_high_water": found.stack_high_water,
            "model_build_s": found.model_build_s,
            "model_reused": found.model_reused,
            "simulate_s": found.simulate_s,
        });
        extend(&mut value, results);
        value
    }

    fn text(&self, found: &Report) -> String {
        let loaded = self.loaded;
        let model = match found.model_reused {
            true => "taken from the cache".to_string(),
            false => format!("built in {:.1} s", found.model_build_s),
        };
        format!(
            "scene {}, {}, configuration {}{}, view {}, {}\n\
             {}, {}: all bits agree in {}, {}, {}\n\
             {}, {:.4} rays per cycle; {:.3} traversal steps per cycle, {:.3} ray-triangle tests per cycle; at most {} stack entries\n\
             model {model}, simulated in {:.1} s ({:.0} thousand cycles per second)\n",
            loaded.scene.name,
            counted(loaded.mesh.triangles.len() as u64, "triangle"),
            loaded.config.name,
            self.args.picture.config.settings(),
            loaded.view,
            self.args.picture.size,
            counted(
                self.active,
                &format!("{} ray", self.args.picture.rays.name())
            ),
            counted(self.hits(found), "hit"),
            counted(found.hits_checked, "hit"),
            counted(found.steps_checked, "traversal step"),
            counted(found.tests_checked, "ray-triangle test"),
            counted(found.cycles, "cycle"),
            self.rays_per_clock(found),
            found.tpu_utilisation(),
            found.gu_utilisation(),
            found.stack_high_water,
            found.simulate_s,
            found.cycles as f64 / found.simulate_s / 1e3,
        )
    }
}
