//! `dynrt render`: a picture from the golden model.

use super::files::{Kind, Output};
use super::frame::{Loaded, SIZE, SceneArgs, active};
use super::{ConfigArgs, counted, print};
use anyhow::Result;
use dynrt::golden::Caster;
use dynrt::report;
use dynrt::scene::ImageSize;
use serde_json::json;
use std::fmt::Write as _;
use std::time::Instant;

const HELP: &str = "\
The golden model computes the same results as the machine of the configuration, in all bits, without timing. A triangle
test is one visit of a leaf by a packet. Averages are over all packets, including those that miss the scene.

Examples:
  dynrt render builtin:teapot --out teapot.png
  dynrt render builtin:interior --view inside --out hall.png --heatmap steps.png
  dynrt render model.obj --eye=4,2,-7 --look-at=0,1,0 --fov=40 --size 1024x768 --out model.png";

/// Render a picture with the golden model, and a heat map of its traversal steps
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = SIZE)]
    size: ImageSize,
    #[command(flatten)]
    config: ConfigArgs,
    /// Write the picture as PNG
    #[arg(long, value_name = "F.png", value_parser = Kind::Png)]
    out: Option<Output>,
    /// Write the traversal steps per packet as PNG; brighter means more
    #[arg(long, value_name = "F.png", value_parser = Kind::Png)]
    heatmap: Option<Output>,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    let loaded = args.scene.load(args.size, &args.config)?;
    let rays = Loaded::rays(&loaded.packets);
    let ray_count = active(&rays)?;
    let built = loaded.build_default()?;
    let caster = Caster::new(
        &built.image,
        loaded.config.triangle_test,
        loaded.frame.rays_per_packet(),
    );
    let started = Instant::now();
    let frame = caster.cast_packets(&rays);
    let cast_s = started.elapsed().as_secs_f64();

    let hits = frame.hits.iter().filter(|hit| hit.is_hit()).count();
    let packets = frame.packets.len();
    let per_packet = |count: u64| count as f64 / packets as f64;
    let mrays_per_s = ray_count as f64 / cast_s / 1e6;
    let size = args.size;
    let mut text = format!(
        "scene {}, {}, configuration {}{}, view {}, {size}\n\
         {}, {}, {:.2} traversal steps and {:.2} triangle tests per packet\n\
         {:.2} M rays/s, tree built in {:.2} s\n",
        loaded.scene.name,
        counted(loaded.mesh.triangles.len() as u64, "triangle"),
        loaded.config.name,
        args.config.settings(),
        loaded.view,
        counted(ray_count, "ray"),
        counted(hits as u64, "hit"),
        per_packet(frame.steps()),
        per_packet(frame.tests()),
        mrays_per_s,
        built.build_s,
    );
    let mut files = vec![];
    if let Some(out) = &args.out {
        let picture = report::shade(size, &loaded.packets, &frame.hits, &loaded.mesh, None);
        files.push(out.png(&picture)?);
        let _ = writeln!(text, "picture: {out}");
    }
    if let Some(heatmap) = &args.heatmap {
        let steps: Vec<u32> = frame.packets.iter().map(|packet| packet.steps).collect();
        let (picture, greatest) = report::heatmap(size, &loaded.packets, &steps, None);
        files.push(heatmap.png(&picture)?);
        let _ = writeln!(text, "heat map, 0 to {greatest} traversal steps: {heatmap}");
    }
    if let Some(json) = &args.json {
        let value = json!({
            "scene": loaded.scene.name,
            "triangles": loaded.mesh.triangles.len(),
            "config": loaded.config.name,
            "overrides": args.config.overrides(&loaded.config),
            "view": loaded.view,
            "width": size.width,
            "height": size.height,
            "rays": ray_count,
            "hits": hits,
            "packets": packets,
            "packet_steps": frame.steps(),
            "triangle_tests": frame.tests(),
            "ray_triangle_tests": frame.ray_tests(),
            "packet_steps_per_packet": per_packet(frame.steps()),
            "triangle_tests_per_packet": per_packet(frame.tests()),
            "stack_high_water": frame.stack_high_water(),
            "build_s": built.build_s,
            "cast_s": cast_s,
            "mrays_per_s": mrays_per_s,
        });
        files.push(json.json(&value)?);
    }
    report::publish_all(files)?;
    print(&text)
}
