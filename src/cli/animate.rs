//! `dynrt animate`: co-simulation of an animated scene, every stage of every frame.

use super::files::{Kind, Output};
use super::film::{ClipArgs, RebuildArgs, Schedule, Scheduled};
use super::frame::{CameraArgs, SIZE, check_size};
use super::{ConfigArgs, counted, one_line, print, quoted};
use anyhow::{Result, ensure};
use dynrt::cosim::animate::{self, Figures, FrameReport, Options, Setup, TreeReport, Unit};
use dynrt::cosim::mismatch::Mismatch;
use dynrt::cosim::model::Trace;
use dynrt::report::{self, FrameFolder, Staged};
use dynrt::scene::{Animated, ImageSize, SceneSpec};
use dynrt::text;
use serde_json::{Value, json};
use std::fmt::Write as _;
use std::time::Duration;

const HELP: &str = "\
In every frame the host poses the scene and builds the top-level tree over its instances; the skinning processor writes the
vertices of skinned objects; the update processor refits the trees whose vertices moved; the ray casting unit casts the rays
of the picture. All three run as Verilog under Verilator, and all results are compared bit by bit with the golden model:
vertices, nodes, boxes, hits and the picture. The first mismatch ends the run; the report includes the command that replays
its frame. The exit status is 0 only if all results agree.

SCENE is a glTF file (.glb, .gltf), a folder of OBJ files (the frames of a sequence), an OBJ file, or builtin:NAME,
where NAME is water, figure, reef or a static scene.

Examples:
  dynrt animate builtin:water --frames 24 --gif water.gif
  dynrt animate builtin:figure --clip wave --fps 10 --size 256x192 --out wave
  dynrt animate model.glb --clip Run --frames 12 --json run.json
  dynrt animate model.glb --rebuild-above 1.2 --view outside --json rebuilt.json";

/// Co-simulate an animation: skinning, update and ray casting of every frame in the Verilog
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The scene: a glTF or OBJ file, a folder of OBJ files, or builtin:NAME
    #[arg(value_name = "SCENE")]
    scene: SceneSpec,
    #[command(flatten)]
    clip: ClipArgs,
    /// Width and height of each picture in pixels
    #[arg(long, value_name = "WxH", default_value = SIZE)]
    size: ImageSize,
    #[command(flatten)]
    camera: CameraArgs,
    #[command(flatten)]
    config: ConfigArgs,
    #[command(flatten)]
    rebuild: RebuildArgs,
    /// Random seed of the memories' delays and stalls
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Write the frames as PNG files to this folder
    #[arg(long, value_name = "DIR", value_parser = Kind::Folder)]
    out: Option<Output>,
    /// Write the frames as an animated GIF
    #[arg(long, value_name = "F.gif", value_parser = Kind::Gif)]
    gif: Option<Output>,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
    /// The first frame to co-simulate, counted from 0; earlier frames only bring the scene into its state
    #[arg(long, value_name = "K", default_value_t = 0)]
    from_frame: usize,
    /// Write a waveform of one unit as FST
    #[arg(long, value_name = "F.fst", requires_all = ["cycles", "unit"], value_parser = Kind::Fst)]
    trace: Option<Output>,
    /// The unit to record in the waveform
    #[arg(long, value_name = "UNIT", requires = "trace")]
    unit: Option<Unit>,
    /// The first cycle of the waveform, counted from the start of the first frame that is co-simulated
    #[arg(long, value_name = "CYCLE", default_value_t = 0, requires = "trace")]
    from: u64,
    /// Number of cycles in the waveform
    #[arg(long, value_name = "N", requires = "trace", value_parser = clap::value_parser!(u64).range(1..))]
    cycles: Option<u64>,
}

impl Args {
    /// The command that runs this again, without the first frame.
    fn replay(&self) -> String {
        let mut text = format!("dynrt animate {}", quoted(&self.scene));
        text += &self.clip.replay();
        text += &self.camera.replay();
        text += &self.config.replay();
        if self.size.to_string() != SIZE {
            text += &format!(" --size {}", self.size);
        }
        text += &self.rebuild.replay();
        if self.seed != 1 {
            text += &format!(" --seed {}", self.seed);
        }
        text
    }
}

pub fn run(args: &Args) -> Result<()> {
    check_size(args.size)?;
    args.rebuild.check()?;
    let config = args.config.load()?;
    let scheduled = Scheduled::load(&args.scene, &args.clip)?;
    let count = scheduled.schedule.times.len();
    ensure!(
        args.from_frame < count,
        "--from-frame {}: there are {}, counted from 0",
        args.from_frame,
        counted(count as u64, "frame")
    );
    let film = scheduled.shown(&config, args.size, &args.camera)?;
    let rays = film.rays();
    let (scene, schedule) = (&film.scene, &film.schedule);
    let folder = (args.out.as_ref())
        .map(|out| FrameFolder::begin(out.path()))
        .transpose()?;

    let trace = (args.trace.as_ref())
        .map(|trace| Staged::empty(trace.path()))
        .transpose()?;
    let options = Options {
        seed: args.seed,
        rebuild_above: args.rebuild.rebuild_above,
        from_frame: args.from_frame,
        trace: trace.as_ref().zip(args.unit).map(|(trace, unit)| {
            let trace = Trace {
                path: trace.temporary().to_path_buf(),
                from: args.from,
                cycles: args.cycles.unwrap_or(1),
            };
            (unit, trace)
        }),
        replay: args.replay(),
        ..Options::default()
    };
    let shown = count - args.from_frame;
    let bar = report::progress((shown * rays.len()) as u64, "building the models");
    bar.enable_steady_tick(Duration::from_millis(500));
    let told = |number: usize, done: u64| {
        bar.set_message(format!("frame {number}"));
        bar.set_position(((number - args.from_frame) * rays.len()) as u64 + done);
    };
    let mut job = Job {
        args,
        scene,
        config: &config.name,
        overrides: args.config.overrides(&config),
        schedule,
        frames: Vec::new(),
        total: Figures::default(),
    };
    let mut pictures = Vec::new();
    let result = animate::run(&config, film.film(), &options, &told, |frame| {
        if let Some(folder) = &folder {
            folder.add(frame.number, &frame.picture)?;
        }
        job.add(&frame);
        if args.gif.is_some() {
            pictures.push(frame.picture);
        }
        Ok(())
    });
    bar.finish_and_clear();
    let setup = match result {
        Ok(setup) => setup,
        Err(error) => {
            if error.is::<Mismatch>() {
                let json = args.json.as_ref();
                let json = json.map(|json| json.json(&job.json(None, Some(&error))));
                report::publish_all(trace.into_iter().chain(json.transpose()?))?;
            }
            let context = || format!("scene {}", scene.name);
            return match error.is::<Mismatch>() {
                true => Err(error),
                false => Err(error.context(context())),
            };
        }
    };
    ensure!(job.total.checked > 0, "nothing was checked");
    let mut text = job.text(&setup);
    let mut files: Vec<Staged> = trace.into_iter().collect();
    if let Some(out) = &args.out {
        let _ = writeln!(text, "frames: {out}");
    }
    if let Some(gif) = &args.gif {
        files.push(gif.gif(&pictures, schedule.frames_per_second)?);
        let _ = writeln!(text, "animated picture: {gif}");
    }
    if let Some(trace) = &args.trace {
        let _ = writeln!(text, "waveform: {trace}");
    }
    if let Some(json) = &args.json {
        files.push(json.json(&job.json(Some(&setup), None))?);
    }
    report::publish_beside(files, || folder.map_or(Ok(()), FrameFolder::publish))?;
    print(&text)
}

/// The results of a run so far.
struct Job<'a> {
    args: &'a Args,
    scene: &'a Animated,
    config: &'a str,
    overrides: Value,
    schedule: &'a Schedule,
    frames: Vec<Value>,
    total: Figures,
}

impl Job<'_> {
    fn add(&mut self, frame: &FrameReport) {
        self.total.add(&frame.figures);
        let mut value = json!({
            "frame": frame.number,
            "seconds": self.schedule.times[frame.number],
        });
        extend(&mut value, figures(&frame.figures, 0));
        let trees: &[TreeReport] = &frame.trees;
        value["trees"] = json!(trees);
        self.frames.push(value);
    }

    fn text(&self, setup: &Setup) -> String {
        let Figures {
            skinning_cycles,
            update_cycles,
            raycast_cycles,
            ..
        } = self.total;
        let percent = |share: f64| 100.0 * share;
        let grouped = super::grouped;
        let mut text = format!(
            "scene {}{}, {} of {} and {}, {}, configuration {}{}, view {}, {}\n\
             {} agree in all bits: {}, {} skinned, {} updated, {} hits\n\
             cycles: skinning {} ({:.1} %), update {} ({:.1} %), ray casting {}\n",
            self.scene.name,
            match &self.schedule.clip {
                Some(clip) => format!(", clip {}", text::escaped(clip)),
                None => String::new(),
            },
            counted(setup.triangles as u64, "triangle"),
            counted(setup.objects as u64, "object"),
            counted(setup.instances as u64, "instance"),
            counted(setup.levels.into(), "level"),
            self.config,
            self.args.config.settings(),
            self.args.camera.name(),
            self.args.size,
            counted(self.total.checked, "result"),
            counted(self.frames.len() as u64, "frame"),
            match self.total.vertices_skinned {
                1 => "1 vertex".into(),
                count => format!("{} vertices", grouped(count)),
            },
            counted(self.total.triangles, "triangle"),
            grouped(self.total.hits),
            grouped(skinning_cycles),
            percent(self.total.skinning_share()),
            grouped(update_cycles),
            percent(self.total.update_share()),
            grouped(raycast_cycles),
        );
        if let (Some(triangles), Some(nodes)) = (
            self.total.triangles_per_clock(),
            self.total.nodes_per_clock(),
        ) {
            let _ = writeln!(
                text,
                "update: {triangles:.3} triangles and {nodes:.3} nodes per cycle; refitted trees cost {:.3} times as much as new ones; {}",
                self.total.sah_ratio(),
                counted(self.total.rebuilds, "rebuild")
            );
        }
        text
    }

    /// The report as JSON: of a whole run, with its `setup`, or of a run that ended with a mismatch.
    fn json(&self, setup: Option<&Setup>, mismatch: Option<&anyhow::Error>) -> Value {
        let args = self.args;
        let mut value = json!({
            "scene": self.scene.name,
            "clip": self.schedule.clip,
            "config": self.config,
            "overrides": self.overrides,
            "view": args.camera.name(),
            "width": args.size.width,
            "height": args.size.height,
            "frames_per_second": self.schedule.frames_per_second,
            "rebuild_above": args.rebuild.rebuild_above,
            "seed": args.seed,
        });
        if let Some(setup) = setup {
            extend(&mut value, json!(setup));
        }
        if let Some(error) = mismatch {
            let found = error.downcast_ref::<Mismatch>();
            value["mismatch"] = json!(one_line(error));
            value["replay"] = json!(found.map(|mismatch| &mismatch.replay));
        }
        value["frames"] = json!(self.frames);
        value["total"] = figures(&self.total, mismatch.iter().count());
        value
    }
}

/// The figures as JSON. A rate over zero events is null.
fn figures(of: &Figures, mismatches: usize) -> Value {
    let ratio = |x: f64| if x.is_finite() { json!(x) } else { Value::Null };
    json!({
        "skinning_cycles": of.skinning_cycles,
        "update_cycles": of.update_cycles,
        "raycast_cycles": of.raycast_cycles,
        "update_share": ratio(of.update_share()),
        "skinning_share": ratio(of.skinning_share()),
        "vertices_skinned": of.vertices_skinned,
        "influences": of.influences,
        "triangles": of.triangles,
        "nodes_written": of.nodes_written,
        "instructions": of.instructions,
        "triangles_per_clock": of.triangles_per_clock(),
        "nodes_per_clock": of.nodes_per_clock(),
        "rays": of.rays,
        "hits": of.hits,
        "sah_ratio": ratio(of.sah_ratio()),
        "rebuilds": of.rebuilds,
        "checked": of.checked,
        "mismatches": mismatches,
    })
}

/// Adds the entries of one JSON object to another.
fn extend(value: &mut Value, more: Value) {
    if let (Value::Object(all), Value::Object(more)) = (value, more) {
        all.extend(more);
    }
}
