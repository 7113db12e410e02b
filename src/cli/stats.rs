//! `dynrt stats`: size and traversal cost of trees.

use super::files::{Kind, Output};
use super::frame::{Built, Loaded, SIZE, SceneArgs, active};
use super::{ConfigArgs, counted, grouped, print};
use anyhow::Result;
use dynrt::bkd::BuildOptions;
use dynrt::bkd::stats::TreeStatistics;
use dynrt::golden::Caster;
use dynrt::port::Ray;
use dynrt::scene::ImageSize;
use serde_json::{Value, json};
use std::fmt::Write as _;

const HELP: &str = "\
Three trees are built and measured with the golden model:
  plain    surface area heuristic with the areas of boxes, one axis per node, sorted by centre
  region   the same with the area of the region that traversal knows
  default  the best options for the configuration, used by all other subcommands
A traversal step is one visit of a node by a packet, a triangle test one visit of a leaf by a packet. Averages are over
all packets of the picture, including those that miss the scene. build_s is the time of one build on one core in seconds.

Examples:
  dynrt stats builtin:interior --view inside
  dynrt stats model.obj --view outside --config dynrt-2006 --json model.json";

/// Measure trees of a scene: size, depth, and traversal steps and triangle tests per packet
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
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

/// The measurements of one tree.
struct Measured {
    name: &'static str,
    tree: TreeStatistics,
    steps_per_packet: f64,
    tests_per_packet: f64,
    build_s: f64,
}

pub fn run(args: &Args) -> Result<()> {
    let loaded = args.scene.load(args.size, &args.config)?;
    let rays = Loaded::rays(&loaded.packets);
    let ray_count = active(&rays)?;
    let depth = loaded.config.stack_depth;
    let [plain, region, default] = [
        ("plain", BuildOptions::plain(depth)),
        ("region", BuildOptions::region(depth)),
        (
            "default",
            BuildOptions::default_for(loaded.config.axes_per_node, depth),
        ),
    ]
    .map(|(name, options)| measure(name, &loaded, &options, &rays));
    let measured = [plain?, region?, default?];
    if let Some(json) = &args.json {
        json.json(&to_json(args, &loaded, ray_count, &measured))?
            .publish()?;
    }
    print(&to_text(args, &loaded, ray_count, &measured))
}

fn measure(
    name: &'static str,
    loaded: &Loaded,
    options: &BuildOptions,
    rays: &[Ray],
) -> Result<Measured> {
    let Built {
        tree,
        image,
        build_s,
    } = loaded.build(options)?;
    let mesh = &loaded.mesh;
    let caster = Caster::new(
        &image,
        loaded.config.triangle_test,
        loaded.frame.rays_per_packet(),
    );
    let frame = caster.cast_packets(rays);
    let packets = frame.packets.len() as f64;
    Ok(Measured {
        name,
        tree: TreeStatistics::new(&tree, &mesh.vertices, &mesh.triangles, mesh.format),
        steps_per_packet: frame.steps() as f64 / packets,
        tests_per_packet: frame.tests() as f64 / packets,
        build_s,
    })
}

fn to_json(args: &Args, loaded: &Loaded, rays: u64, measured: &[Measured; 3]) -> Value {
    let [.., default] = measured;
    let size = args.size;
    let mut value = json!({
        "scene": loaded.scene.name,
        "config": loaded.config.name,
        "overrides": args.config.overrides(&loaded.config),
        "view": loaded.view,
        "width": size.width,
        "height": size.height,
        "rays": rays,
        "triangles": default.tree.triangles,
        "nodes": default.tree.nodes,
        "node_bytes": default.tree.node_bytes,
        "record_bytes": default.tree.record_bytes,
        "vertex_bytes": default.tree.vertex_bytes,
        "depth": default.tree.depth,
    });
    for one in measured {
        value[one.name] = json!({
            "packet_steps_per_packet": one.steps_per_packet,
            "triangle_tests_per_packet": one.tests_per_packet,
            "build_s": one.build_s,
            "depth": one.tree.depth,
            "expected_steps": one.tree.expected_steps,
            "expected_tests": one.tree.expected_tests,
        });
    }
    value
}

fn to_text(args: &Args, loaded: &Loaded, rays: u64, measured: &[Measured; 3]) -> String {
    let [.., default] = measured;
    let tree = &default.tree;
    let mut text = format!(
        "scene {}, configuration {}{}, view {}, {}, {}\n\
         {}, {}; bytes: nodes {}, triangle records {}, vertices {}\n\n\
         {:8} {:>6} {:>13} {:>14} {:>9}\n",
        loaded.scene.name,
        loaded.config.name,
        args.config.settings(),
        loaded.view,
        args.size,
        counted(rays, "ray"),
        counted(tree.triangles as u64, "triangle"),
        counted(tree.nodes as u64, "node"),
        grouped(tree.node_bytes as u64),
        grouped(tree.record_bytes as u64),
        grouped(tree.vertex_bytes as u64),
        "tree",
        "depth",
        "steps/packet",
        "tests/packet",
        "build s"
    );
    for one in measured {
        let _ = writeln!(
            text,
            "{:8} {:>6} {:>13.2} {:>14.2} {:>9.3}",
            one.name, one.tree.depth, one.steps_per_packet, one.tests_per_packet, one.build_s
        );
    }
    text
}
