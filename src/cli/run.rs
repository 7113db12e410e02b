//! `dynrt run`: the whole chip in Verilator, from command lists in memory to the hits in memory.

use super::files::{Kind, Output};
use super::film::{ClipArgs, RebuildArgs, Shown};
use super::frame::{Built, PictureArgs, active};
use super::waveform::WaveformArgs;
use super::{counted, print, quoted};
use anyhow::{Context, Error, Result, ensure};
use dynrt::chip::descriptor::Cast;
use dynrt::chip::image::{Builder, Part, Still, hits_of, still};
use dynrt::chip::memory::Memory;
use dynrt::config::{Config, MemoryModel};
use dynrt::cosim::chip::{Chip, Options, Report, Traffic};
use dynrt::cosim::dram::Dram;
use dynrt::cosim::mismatch::Mismatch;
use dynrt::cosim::model::Trace;
use dynrt::film::{self, Packed};
use dynrt::golden::chip::Outcome;
use dynrt::port::Hit;
use dynrt::report::{self, FrameFolder};
use dynrt::scene::sort_along_morton_curve;
use image::RgbImage;
use serde_json::{Map, Value, json};
use std::fmt::Write as _;
use std::time::Duration;

const HELP: &str = "\
The chip stands between two buses. The host writes a scene, rays and command lists into memory, and rings the
doorbell for each frame. The chip moves the vertices, updates the trees, reads the rays, casts them behind its
caches, and writes their hits. After each frame every byte of memory and the status are compared with the
golden chip. An AXI4 protocol monitor watches the memory bus in every cycle. The exit status is 0 only if all
agree.

SCENE is an OBJ file, a glTF file (.glb, .gltf), a folder of OBJ files (the frames of a sequence), or
builtin:NAME, as for dynrt animate.

Examples:
  dynrt run builtin:cornell --out cornell.png
  dynrt run builtin:figure --frames 4 --size 128x96 --gif figure.gif --json figure.json
  dynrt run builtin:interior --view inside --rays diffuse --json run.json
  dynrt run builtin:interior --view inside --memory ideal --set cache.nodes_kib=4";

/// Run the whole chip: command lists move and cast scenes in memory, compared with the golden chip
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    clip: ClipArgs,
    #[command(flatten)]
    rebuild: RebuildArgs,
    /// The memory behind the bus [default: memory.model of the configuration]
    #[arg(long, value_name = "M", value_parser = clap::builder::PossibleValuesParser::new(MemoryModel::NAMES))]
    memory: Option<String>,
    /// Write the picture computed by the Verilog as PNG; of several frames, their PNG files to this folder
    #[arg(long, value_name = "F.png|DIR", value_parser = Kind::Pictures)]
    out: Option<Output>,
    /// Write the frames as an animated GIF
    #[arg(long, value_name = "F.gif", value_parser = Kind::Gif)]
    gif: Option<Output>,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
    /// Write where the packets, bursts and units of one frame spend their time, as Chrome trace (for Perfetto)
    #[arg(long, value_name = "F.json", value_parser = Kind::Json)]
    trace_events: Option<Output>,
    #[command(flatten)]
    waveform: WaveformArgs,
}

/// Where the image of a run begins in the address space.
const BASE: u32 = 0x1000;

/// A memory has at most this many bytes in a simulation.
const MOST_BYTES: u64 = 1 << 31;

pub fn run(args: &Args) -> Result<()> {
    args.rebuild.check()?;
    let spec = args.picture.scene.spec();
    args.waveform
        .around(|trace| match args.clip.is_given() || spec.is_animated() {
            false => run_still(args, trace),
            true => run_film(args, trace),
        })
}

/// A picture of the hits of a frame.
type Shade<'a> = &'a dyn Fn(usize, &[Hit]) -> Result<RgbImage>;

/// What the chip runs.
struct Work<'a> {
    args: &'a Args,
    config: &'a Config,
    memory: Memory,
    parts: Vec<Part>,
    casts: Vec<Cast>,
    lists: Vec<List>,
    /// Active rays of each frame.
    active: u64,
    triangles: u64,
    /// The first words of the report, and facts for the results.
    title: String,
    facts: Value,
    frames_per_second: f64,
    shade: Shade<'a>,
}

/// The list of a frame.
struct List {
    address: u32,
    /// Triangles of the objects that it updates.
    triangles: u64,
    facts: Value,
}

impl Args {
    /// Sets the memory that is asked for.
    fn set_memory(&self, config: &mut Config) -> Result<()> {
        match &self.memory {
            Some(model) => config.set("memory.model", model),
            None => Ok(()),
        }
    }

    /// The command that runs this again.
    fn replay(&self) -> String {
        let mut text = format!("dynrt run{}{}", self.picture.replay(), self.clip.replay());
        text += &self.rebuild.replay();
        if let Some(memory) = &self.memory {
            text += &format!(" --memory {}", quoted(memory));
        }
        text
    }
}

fn run_still(args: &Args, trace: Option<Trace>) -> Result<()> {
    let mut loaded = args.picture.load()?;
    args.set_memory(&mut loaded.config)?;
    // The order in which a host that knows of caches writes its rays.
    sort_along_morton_curve(&mut loaded.packets);
    let Built { image, .. } = loaded.build_default()?;
    let cast = args.picture.rays_of(&loaded, &image)?;
    let rays = cast.rays();
    let Still {
        memory,
        parts,
        list,
        casts,
        ..
    } = still(
        &loaded.config,
        Builder::new(BASE, MOST_BYTES),
        &image,
        &rays,
    )?;
    let triangles = loaded.mesh.triangles.len();
    let work = Work {
        args,
        config: &loaded.config,
        memory,
        parts,
        casts,
        lists: vec![List {
            address: list,
            triangles: 0,
            facts: json!({}),
        }],
        active: active(&rays)?,
        triangles: triangles as u64,
        title: format!("scene {}", loaded.scene.name),
        facts: json!({"scene": loaded.scene.name, "triangles": triangles}),
        frames_per_second: 1.0,
        shade: &|_, hits| Ok(cast.picture(args.picture.size, &loaded, hits)),
    };
    work.run(trace)
}

fn run_film(args: &Args, trace: Option<Trace>) -> Result<()> {
    let picture = &args.picture;
    picture.only_primary()?;
    let mut config = picture.config.load()?;
    args.set_memory(&mut config)?;
    let mut shown = Shown::load(
        picture.scene.spec(),
        &args.clip,
        &config,
        picture.size,
        picture.scene.camera(),
    )?;
    sort_along_morton_curve(&mut shown.packets);
    let film = shown.film();
    let memory = Builder::new(BASE, MOST_BYTES);
    let packed = film::pack(&config, film, args.rebuild.rebuild_above, memory);
    let Packed {
        memory,
        parts,
        casts,
        frames,
        ..
    } = packed.with_context(|| format!("scene {}", shown.scene.name))?;
    let setup = film.setup();
    let lists = frames.iter().enumerate().map(|(number, frame)| List {
        address: frame.list,
        triangles: frame.triangles,
        facts: json!({
            "seconds": shown.schedule.times[number],
            "instances_present": frame.there.len(),
            "trees": frame.trees,
            "new_top": frame.new_top,
        }),
    });
    let shade = |number: usize, hits: &[Hit]| {
        let vertices = (0..setup.objects).map(|object| film.vertices(object, number));
        let vertices = vertices.collect::<Result<Vec<_>>>()?;
        let of = |object: usize| &vertices[object][..];
        Ok(film.shade(number, &frames[number].there, of, hits))
    };
    let work = Work {
        args,
        config: &config,
        memory,
        parts,
        casts,
        lists: lists.collect(),
        active: active(&film.rays())?,
        triangles: setup.triangles as u64,
        title: format!(
            "scene {}{}, {} and {}",
            shown.scene.name,
            shown.clip(),
            counted(setup.objects as u64, "object"),
            counted(setup.instances as u64, "instance"),
        ),
        facts: shown.facts(args.rebuild.rebuild_above),
        frames_per_second: shown.schedule.frames_per_second,
        shade: &shade,
    };
    work.run(trace)
}

/// Runs that have ended well: what each frame found, and the sum.
struct Found {
    frames: Vec<Report>,
    total: Report,
    model_build_s: f64,
    model_reused: bool,
}

/// The sum of reports, without events.
fn sum(reports: &[Report]) -> Report {
    let of = |number: &dyn Fn(&Report) -> u64| reports.iter().map(number).sum::<u64>();
    let outcome = |number: &dyn Fn(&Outcome) -> u64| of(&|report| number(&report.outcome));
    let traffic = |number: &dyn Fn(&Traffic) -> u64| of(&|report| number(&report.traffic));
    let counters = reports.iter().map(|report| report.counters.len()).max();
    Report {
        outcome: Outcome {
            error: None,
            interrupts: outcome(&|o| o.interrupts),
            rays: outcome(&|o| o.rays),
            hits: outcome(&|o| o.hits),
            vertices_skinned: outcome(&|o| o.vertices_skinned),
            influences: outcome(&|o| o.influences),
            nodes_written: outcome(&|o| o.nodes_written),
            instructions: outcome(&|o| o.instructions),
        },
        checked: of(&|report| report.checked),
        cycles: of(&|report| report.cycles),
        traffic: Traffic {
            read_bursts: traffic(&|t| t.read_bursts),
            write_bursts: traffic(&|t| t.write_bursts),
            bytes_read: traffic(&|t| t.bytes_read),
            bytes_written: traffic(&|t| t.bytes_written),
            bytes_of_rays: traffic(&|t| t.bytes_of_rays),
        },
        counters: (0..counters.unwrap_or(0))
            .map(|place| of(&|report| report.counters[place]))
            .collect(),
        events: vec![],
        simulate_s: reports.iter().map(|report| report.simulate_s).sum(),
    }
}

/// A mismatch with its frame.
fn in_frame(error: Error, number: usize) -> Error {
    match error.downcast::<Mismatch>() {
        Ok(mut mismatch) => {
            mismatch.place = format!("frame {number}, {}", mismatch.place);
            mismatch.into()
        }
        Err(error) => error.context(format!("frame {number}")),
    }
}

impl Work<'_> {
    fn run(mut self, trace: Option<Trace>) -> Result<()> {
        let args = self.args;
        let count = self.lists.len();
        if count > 1 {
            if let Some(out) = &args.out {
                out.check_folder(count)?;
            }
            ensure!(
                args.trace_events.is_none(),
                "--trace-events: shows one frame, but there are {count}; give --frames 1"
            );
        }
        let folder = (args.out.as_ref().filter(|_| count > 1))
            .map(|out| FrameFolder::begin(out.path()))
            .transpose()?;
        let (found, pictures) = self.simulate(trace, folder.as_ref())?;
        ensure!(found.total.checked > 0, "nothing was checked");
        let mut text = self.text(&found);
        let mut files = vec![];
        if let Some(out) = &args.out {
            match &folder {
                None => {
                    files.push(out.png(&pictures[0])?);
                    text += &format!("picture: {out}\n");
                }
                Some(_) => text += &format!("frames: {out}\n"),
            }
        }
        if let Some(gif) = &args.gif {
            files.push(gif.gif(&pictures, self.frames_per_second)?);
            text += &format!("animated picture: {gif}\n");
        }
        args.waveform.check(found.total.cycles);
        text += &args.waveform.line();
        if let Some(out) = &args.trace_events {
            let events = &found.frames[0].events;
            files.push(out.json(&report::chrome_trace(events))?);
            let events = counted(events.len() as u64, "event");
            text += &format!("{events} written to {out}\n");
        }
        if let Some(json) = &args.json {
            files.push(json.json(&self.json(&found))?);
        }
        report::publish_beside(files, || folder.map_or(Ok(()), FrameFolder::publish))?;
        print(&text)
    }

    /// Runs the lists of all frames, and draws the pictures that are asked for.
    fn simulate(
        &mut self,
        trace: Option<Trace>,
        folder: Option<&FrameFolder>,
    ) -> Result<(Found, Vec<RgbImage>)> {
        let args = self.args;
        let slots: u64 = self.casts.iter().map(|cast| u64::from(cast.count)).sum();
        let ray_bytes = self.casts.iter().map(Cast::ray_bytes).max().unwrap_or(1) as u64;
        let bar = report::progress(slots * self.lists.len() as u64, "building the model");
        bar.enable_steady_tick(Duration::from_millis(500));
        let options = Options {
            seed: args.picture.seed,
            trace,
            events: args.trace_events.is_some(),
            replay: args.replay(),
            ..Options::default()
        };
        let (mut frames, mut pictures) = (vec![], vec![]);
        let mut all = || -> Result<Chip> {
            let mut chip = Chip::new(self.config, &options, &|_| ())?;
            for (number, list) in self.lists.iter().enumerate() {
                bar.set_message(match self.lists.len() {
                    1 => "rays".to_string(),
                    _ => format!("frame {number}"),
                });
                let told = |done: u64| bar.set_position(number as u64 * slots + done / ray_bytes);
                let report = chip.run(&mut self.memory, list.address, &told);
                let report = match self.lists.len() {
                    1 => report?,
                    _ => report.map_err(|error| in_frame(error, number))?,
                };
                report.outcome.check()?;
                frames.push(report);
                if args.out.is_none() && args.gif.is_none() {
                    continue;
                }
                let hits = (self.casts.iter())
                    .flat_map(|cast: &Cast| hits_of(&self.memory, self.config, cast));
                let picture = (self.shade)(number, &hits.collect::<Vec<Hit>>())?;
                if let Some(folder) = folder {
                    folder.add(number, &picture)?;
                }
                if folder.is_none() || args.gif.is_some() {
                    pictures.push(picture);
                }
            }
            Ok(chip)
        };
        let chip = all();
        bar.finish_and_clear();
        let chip = chip?;
        let found = Found {
            total: sum(&frames),
            frames,
            model_build_s: chip.model_build_s,
            model_reused: chip.model_reused,
        };
        Ok((found, pictures))
    }

    fn peak(&self) -> f64 {
        let bus = f64::from(self.config.bus_data_bits / 8);
        Dram::new(self.config).peak_bytes_per_cycle().min(bus)
    }

    fn figures(&self, of: &Report, rays: u64, triangles: u64) -> Figures {
        let traffic = of.traffic;
        let bytes = traffic.bytes_read + traffic.bytes_written;
        // A list without updates needs no counter of them.
        let update_cycles = match of.outcome.instructions {
            0 => 0,
            _ => of.counter("update_busy_cycles"),
        };
        Figures {
            rays,
            triangles,
            skinning_cycles: of.counter("skin_cycles"),
            update_cycles,
            cast_cycles: of.counter("cast_cycles"),
            bus_utilisation: bytes as f64 / (of.cycles as f64 * self.peak()),
        }
    }

    fn triangles_updated(&self) -> u64 {
        self.lists.iter().map(|list| list.triangles).sum()
    }

    fn total(&self, found: &Found) -> Figures {
        let rays = self.active * self.lists.len() as u64;
        self.figures(&found.total, rays, self.triangles_updated())
    }

    fn json(&self, found: &Found) -> Value {
        let size = self.args.picture.size;
        let total = &found.total;
        let traffic = total.traffic;
        let caches = CACHES.iter().map(|(name, counter)| {
            let (requests, hit_rate, misses) = cache(total, counter);
            let value = json!({
                "requests": requests,
                "hit_rate": hit_rate,
                "misses": misses,
                "stalls": total.counter(&format!("{counter}_stalls")),
            });
            (name.to_string(), value)
        });
        let frames = self.lists.iter().zip(&found.frames).map(|(list, report)| {
            let figures = self.figures(report, self.active, list.triangles);
            let mut frame = figures.json(report);
            extend(&mut frame, list.facts.clone());
            frame
        });
        let names = dynrt::chip::registers::COUNTERS.iter().zip(&total.counters);
        let counters: Map<String, Value> = names
            .map(|((name, _), count)| (name.to_string(), json!(count)))
            .collect();
        let mut value = json!({
            "frames": self.lists.len(),
            "per_frame": frames.collect::<Vec<Value>>(),
            "config": self.config.name,
            "overrides": self.args.picture.config.overrides(self.config),
            "view": self.args.picture.scene.camera().name(),
            "ray_kind": self.args.picture.rays.name(),
            "seed": self.args.picture.seed,
            "width": size.width,
            "height": size.height,
            "memory": self.config.memory_model.name(),
            "memory_parts": self.parts,
            "peak_bytes_per_cycle": self.peak(),
            "checked": total.checked,
            // Always 0: a mismatch ends the run with an error.
            "mismatches": 0,
            "read_bursts": traffic.read_bursts,
            "write_bursts": traffic.write_bursts,
            "cache": caches.collect::<Map<String, Value>>(),
            "counters": counters,
            "status": total.outcome.status(),
            "model_build_s": found.model_build_s,
            "model_reused": found.model_reused,
            "simulate_s": total.simulate_s,
        });
        extend(&mut value, self.facts.clone());
        extend(&mut value, self.total(found).json(total));
        value
    }

    fn text(&self, found: &Found) -> String {
        let (total, picture) = (&found.total, &self.args.picture);
        let figures = self.total(found);
        let model = match found.model_reused {
            true => "taken from the cache".to_string(),
            false => format!("built in {:.1} s", found.model_build_s),
        };
        let frames = match self.lists.len() {
            1 => String::new(),
            count => format!("{} of ", counted(count as u64, "frame")),
        };
        let mut text = format!(
            "{}, {}, configuration {}{}, memory {}, view {}, {frames}{}\n{}, {}: all bits agree in {} of memory\n",
            self.title,
            counted(self.triangles, "triangle"),
            self.config.name,
            picture.config.settings(),
            self.config.memory_model.name(),
            picture.scene.camera().name(),
            picture.size,
            counted(figures.rays, &format!("{} ray", picture.rays.name())),
            counted(total.outcome.hits, "hit"),
            counted(total.checked, "byte"),
        );
        let _ = writeln!(
            text,
            "{}, {:.4} rays per cycle; {} read, {} written, {:.0} % of the peak of the bus",
            counted(total.cycles, "cycle"),
            figures.rays_per_clock(),
            counted(total.traffic.bytes_read, "byte"),
            counted(total.traffic.bytes_written, "byte"),
            100.0 * figures.bus_utilisation,
        );
        text += &figures.motion(total);
        let per_frame = self.lists.iter().zip(&found.frames).enumerate();
        for (number, (list, report)) in per_frame.filter(|_| self.lists.len() > 1) {
            let figures = self.figures(report, self.active, list.triangles);
            let _ = writeln!(
                text,
                "frame {number}: {}, {}, {:.4} rays per cycle; skinning {:.1} %, update {:.1} % of the cycles",
                counted(report.cycles, "cycle"),
                counted(report.outcome.hits, "hit"),
                figures.rays_per_clock(),
                100.0 * figures.share(figures.skinning_cycles, report),
                100.0 * figures.share(figures.update_cycles, report),
            );
        }
        for (name, counter) in CACHES {
            let (requests, rate, misses) = cache(total, counter);
            let _ = writeln!(
                text,
                "cache of {name}: {}, {:.2} % hits, {} read",
                counted(requests, "request"),
                100.0 * rate,
                counted(misses, "line")
            );
        }
        let _ = writeln!(
            text,
            "model {model}, simulated in {:.1} s ({:.0} thousand cycles per second)",
            total.simulate_s,
            total.cycles as f64 / total.simulate_s / 1e3,
        );
        text
    }
}

/// The figures of a frame, or of all.
struct Figures {
    /// Active rays.
    rays: u64,
    /// Triangles of updated objects.
    triangles: u64,
    skinning_cycles: u64,
    update_cycles: u64,
    cast_cycles: u64,
    bus_utilisation: f64,
}

impl Figures {
    /// Rays per cycle of casts.
    fn rays_per_clock(&self) -> f64 {
        self.rays as f64 / self.cast_cycles as f64
    }

    fn share(&self, cycles: u64, of: &Report) -> f64 {
        cycles as f64 / of.cycles as f64
    }

    /// Triangles of updated objects per cycle of updates; `None` without updates.
    fn update_triangles_per_clock(&self) -> Option<f64> {
        (self.update_cycles > 0).then(|| self.triangles as f64 / self.update_cycles as f64)
    }

    /// Influences per cycle of skinning; `None` without skinning.
    fn skinning_influences_per_clock(&self, of: &Report) -> Option<f64> {
        let influences = of.outcome.influences as f64;
        (self.skinning_cycles > 0).then(|| influences / self.skinning_cycles as f64)
    }

    /// The line of a report about skinning and updates; empty without them.
    fn motion(&self, of: &Report) -> String {
        let mut parts = vec![];
        if let Some(rate) = self.skinning_influences_per_clock(of) {
            parts.push(format!(
                "skinning: {}, {}, {rate:.3} influences per cycle, {:.1} % of the cycles",
                counted(of.outcome.influences, "influence"),
                counted(self.skinning_cycles, "cycle"),
                100.0 * self.share(self.skinning_cycles, of)
            ));
        }
        if let Some(rate) = self.update_triangles_per_clock() {
            parts.push(format!(
                "update: {}, {}, {rate:.3} triangles per cycle, {:.1} % of the cycles",
                counted(self.triangles, "triangle"),
                counted(self.update_cycles, "cycle"),
                100.0 * self.share(self.update_cycles, of)
            ));
        }
        parts.iter().map(|part| format!("{part}\n")).collect()
    }

    fn json(&self, of: &Report) -> Value {
        json!({
            "cycles": of.cycles,
            "rays": self.rays,
            "hits": of.outcome.hits,
            "rays_per_clock": self.rays_per_clock(),
            "bytes_read": of.traffic.bytes_read,
            "bytes_written": of.traffic.bytes_written,
            "bus_utilisation": self.bus_utilisation,
            "cast_cycles": self.cast_cycles,
            "skinning_cycles": self.skinning_cycles,
            "skinning_share": self.share(self.skinning_cycles, of),
            "skinning_influences_per_clock": self.skinning_influences_per_clock(of),
            "vertices_skinned": of.outcome.vertices_skinned,
            "influences": of.outcome.influences,
            "update_cycles": self.update_cycles,
            "update_share": self.share(self.update_cycles, of),
            "update_triangles_per_clock": self.update_triangles_per_clock(),
            "triangles_updated": self.triangles,
            "nodes_written": of.outcome.nodes_written,
            "instructions": of.outcome.instructions,
        })
    }
}

/// Requests, hit rate and misses of a cache.
fn cache(of: &Report, counter: &str) -> (u64, f64, u64) {
    let of = |what: &str| of.counter(&format!("{counter}_{what}"));
    let requests = of("requests");
    let rate = of("hits") as f64 / requests.max(1) as f64;
    (requests, rate, of("misses"))
}

/// Adds the entries of one JSON object to another.
fn extend(value: &mut Value, more: Value) {
    if let (Value::Object(all), Value::Object(more)) = (value, more) {
        all.extend(more);
    }
}

/// The names of the caches in results and of their counters.
const CACHES: [(&str, &str); 3] = [
    ("nodes", "node"),
    ("records", "record"),
    ("vertices", "vertex"),
];
