//! `dynrt run`: the whole chip in Verilator, from a command list in memory to the hits in memory.

use super::files::{Kind, Output};
use super::frame::{Built, Loaded, PictureArgs, active};
use super::waveform::WaveformArgs;
use super::{counted, print};
use anyhow::{Result, ensure};
use dynrt::chip::descriptor::Cast;
use dynrt::chip::image::{Builder, Still, hits_of, still};
use dynrt::config::MemoryModel;
use dynrt::cosim::chip::{Chip, Options, Report};
use dynrt::cosim::dram::Dram;
use dynrt::cosim::model::Trace;
use dynrt::port::Hit;
use dynrt::report;
use dynrt::scene::sort_along_morton_curve;
use serde_json::{Map, Value, json};
use std::time::Duration;

const HELP: &str = "\
The chip stands between two buses. The host writes a scene, rays and a command list into memory, and rings the doorbell; the chip
reads the rays, casts them behind its caches, and writes their hits. At the end every byte of memory and the status are compared with
the golden chip. An AXI4 protocol monitor watches the memory bus in every cycle. The exit status is 0 only if all agree.

Examples:
  dynrt run builtin:cornell --out cornell.png
  dynrt run builtin:interior --view inside --rays diffuse --json run.json
  dynrt run builtin:interior --view inside --memory ideal --set cache.nodes_kib=4";

/// Run the whole chip: a command list casts rays from memory, compared with the golden chip
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    picture: PictureArgs,
    /// The memory behind the bus [default: memory.model of the configuration]
    #[arg(long, value_name = "M", value_parser = clap::builder::PossibleValuesParser::new(MemoryModel::NAMES))]
    memory: Option<String>,
    /// Write the picture computed by the Verilog as PNG
    #[arg(long, value_name = "F.png", value_parser = Kind::Png)]
    out: Option<Output>,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
    /// Write where packets, bursts and units spend their time, in the Chrome trace format (for Perfetto)
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
    args.waveform.around(|trace| run_traced(args, trace))
}

fn run_traced(args: &Args, trace: Option<Trace>) -> Result<()> {
    let mut loaded = args.picture.load()?;
    if let Some(model) = &args.memory {
        loaded.config.set("memory.model", model)?;
    }
    // The order in which a host that knows of caches writes its rays.
    sort_along_morton_curve(&mut loaded.packets);
    let config = &loaded.config;
    let Built { image, .. } = loaded.build_default()?;
    let cast = args.picture.rays_of(&loaded, &image)?;
    let rays = cast.rays();
    let active = active(&rays)?;

    let Still {
        mut memory,
        parts,
        list,
        casts,
        ..
    } = still(config, Builder::new(BASE, MOST_BYTES), &image, &rays)?;

    let ray_bytes = casts.iter().map(Cast::ray_bytes).max().unwrap_or(1) as u64;
    let bar = report::progress(rays.len() as u64, "building the model");
    bar.enable_steady_tick(Duration::from_millis(500));
    let options = Options {
        seed: args.picture.seed,
        trace,
        events: args.trace_events.is_some(),
        replay: args.replay(),
        ..Options::default()
    };
    let result = Chip::new(config, &options, &|_| ()).and_then(|mut chip| {
        bar.set_message("rays");
        let report = chip.run(&mut memory, list, &|done| {
            bar.set_position(done / ray_bytes)
        })?;
        Ok((chip, report))
    });
    bar.finish_and_clear();
    let (chip, found) = result?;
    found.outcome.check()?;
    ensure!(found.checked > 0, "nothing was checked");
    let job = Job {
        args,
        loaded: &loaded,
        active,
        found: &found,
        chip: &chip,
    };
    let mut text = job.text();
    let hits: Vec<Hit> = (casts.iter())
        .flat_map(|cast: &Cast| hits_of(&memory, config, cast))
        .collect();
    let mut files = vec![];
    if let Some(out) = &args.out {
        files.push(out.png(&cast.picture(args.picture.size, &loaded, &hits))?);
        text += &format!("picture: {out}\n");
    }
    args.waveform.check(found.cycles);
    text += &args.waveform.line();
    if let Some(out) = &args.trace_events {
        files.push(out.json(&report::chrome_trace(&found.events))?);
        text += &format!(
            "{} written to {out}\n",
            counted(found.events.len() as u64, "event")
        );
    }
    if let Some(json) = &args.json {
        let mut value = job.json();
        value["memory_parts"] = json!(parts);
        files.push(json.json(&value)?);
    }
    report::publish_all(files)?;
    print(&text)
}

impl Args {
    /// The command that runs this again.
    fn replay(&self) -> String {
        let mut text = format!("dynrt run{}", self.picture.replay());
        if let Some(memory) = &self.memory {
            text += &format!(" --memory {memory}");
        }
        text
    }
}

/// A run that has ended well.
struct Job<'a> {
    args: &'a Args,
    loaded: &'a Loaded,
    active: u64,
    found: &'a Report,
    chip: &'a Chip,
}

/// The names of the caches in results and of their counters.
const CACHES: [(&str, &str); 3] = [
    ("nodes", "node"),
    ("records", "record"),
    ("vertices", "vertex"),
];

impl Job<'_> {
    /// Rays per cycle of casts.
    fn rays_per_clock(&self) -> f64 {
        self.active as f64 / self.found.counter("cast_cycles") as f64
    }

    fn peak(&self) -> f64 {
        let bus = f64::from(self.loaded.config.bus_data_bits / 8);
        Dram::new(&self.loaded.config)
            .peak_bytes_per_cycle()
            .min(bus)
    }

    fn bus_utilisation(&self) -> f64 {
        let traffic = self.found.traffic;
        let bytes = traffic.bytes_read + traffic.bytes_written;
        bytes as f64 / (self.found.cycles as f64 * self.peak())
    }

    /// Requests, hit rate and misses of a cache.
    fn cache(&self, counter: &str) -> (u64, f64, u64) {
        let of = |what: &str| self.found.counter(&format!("{counter}_{what}"));
        let requests = of("requests");
        let rate = of("hits") as f64 / requests.max(1) as f64;
        (requests, rate, of("misses"))
    }

    fn json(&self) -> Value {
        let Job { loaded, found, .. } = self;
        let size = self.args.picture.size;
        let traffic = found.traffic;
        let caches = CACHES.iter().map(|(name, counter)| {
            let (requests, hit_rate, misses) = self.cache(counter);
            let value = json!({
                "requests": requests,
                "hit_rate": hit_rate,
                "misses": misses,
                "stalls": found.counter(&format!("{counter}_stalls")),
            });
            (name.to_string(), value)
        });
        let frame = json!({
            "cycles": found.cycles,
            "rays": self.active,
            "hits": found.outcome.hits,
            "rays_per_clock": self.rays_per_clock(),
            "bytes_read": traffic.bytes_read,
            "bytes_written": traffic.bytes_written,
            "bus_utilisation": self.bus_utilisation(),
        });
        let names = dynrt::chip::registers::COUNTERS.iter().zip(&found.counters);
        let counters: Map<String, Value> = names
            .map(|((name, _), count)| (name.to_string(), json!(count)))
            .collect();
        let mut value = json!({
            "scene": loaded.scene.name,
            "triangles": loaded.mesh.triangles.len(),
            "frames": 1,
            "per_frame": [frame.clone()],
            "config": loaded.config.name,
            "overrides": self.args.picture.config.overrides(&loaded.config),
            "view": loaded.view,
            "ray_kind": self.args.picture.rays.name(),
            "seed": self.args.picture.seed,
            "width": size.width,
            "height": size.height,
            "memory": loaded.config.memory_model.name(),
            "peak_bytes_per_cycle": self.peak(),
            "checked": found.checked,
            // Always 0: a mismatch ends the run with an error.
            "mismatches": 0,
            "read_bursts": traffic.read_bursts,
            "write_bursts": traffic.write_bursts,
            "cache": caches.collect::<Map<String, Value>>(),
            "counters": counters,
            "status": found.outcome.status(),
            "model_build_s": self.chip.model_build_s,
            "model_reused": self.chip.model_reused,
            "simulate_s": found.simulate_s,
        });
        if let (Value::Object(all), Value::Object(frame)) = (&mut value, frame) {
            all.extend(frame);
        }
        value
    }

    fn text(&self) -> String {
        let Job { loaded, found, .. } = self;
        let model = match self.chip.model_reused {
            true => "taken from the cache".to_string(),
            false => format!("built in {:.1} s", self.chip.model_build_s),
        };
        let mut text = format!(
            "scene {}, {}, configuration {}{}, memory {}, view {}, {}\n             {}, {}: all bits agree in {} of memory\n             {}, {:.4} rays per cycle; {} read, {} written, {:.0} % of the peak of the bus\n",
            loaded.scene.name,
            counted(loaded.mesh.triangles.len() as u64, "triangle"),
            loaded.config.name,
            self.args.picture.config.settings(),
            loaded.config.memory_model.name(),
            loaded.view,
            self.args.picture.size,
            counted(
                self.active,
                &format!("{} ray", self.args.picture.rays.name())
            ),
            counted(found.outcome.hits, "hit"),
            counted(found.checked, "byte"),
            counted(found.cycles, "cycle"),
            self.rays_per_clock(),
            counted(found.traffic.bytes_read, "byte"),
            counted(found.traffic.bytes_written, "byte"),
            100.0 * self.bus_utilisation(),
        );
        for (name, counter) in CACHES {
            let (requests, rate, misses) = self.cache(counter);
            text += &format!(
                "cache of {name}: {}, {:.2} % hits, {} read\n",
                counted(requests, "request"),
                100.0 * rate,
                counted(misses, "line")
            );
        }
        text + &format!(
            "model {model}, simulated in {:.1} s ({:.0} thousand cycles per second)\n",
            found.simulate_s,
            found.cycles as f64 / found.simulate_s / 1e3,
        )
    }
}
