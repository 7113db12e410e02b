//! `dynrt program`: the update program of a scene's tree.

use super::files::{Kind, Output};
use super::frame::load_mesh;
use super::{ConfigArgs, counted, grouped, print};
use anyhow::{Context, Result};
use dynrt::bkd::{BuildOptions, build};
use dynrt::cosim::unit_update;
use dynrt::program::Program;
use dynrt::scene::SceneSpec;
use serde_json::{Value, json};
use std::time::Instant;

const HELP: &str = "\
The update program rewrites the bounds of a tree of fixed topology after its vertices have moved. It is one stream of
instructions: load a vertex, merge three vertices to the box of a leaf, merge two boxes and write the node above them.
docs/update.md defines the instructions in all bits.

Examples:
  dynrt program builtin:teapot
  dynrt program model.obj --list | less
  dynrt program model.obj --json program.json";

/// Compile the update program of a scene's tree, and print its statistics
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The scene: an OBJ file, or builtin:NAME for a built-in scene
    #[arg(value_name = "SCENE")]
    scene: SceneSpec,
    /// List the instructions, one per line: byte address, bytes, operands
    #[arg(long)]
    list: bool,
    #[command(flatten)]
    config: ConfigArgs,
    /// Write the results as JSON
    #[arg(long, value_name = "F", value_parser = Kind::Json)]
    json: Option<Output>,
}

pub fn run(args: &Args) -> Result<()> {
    let config = args.config.load()?;
    let (scene, mesh) = load_mesh(&args.scene, &config)?;
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    let context = || format!("scene {}", scene.name);
    let tree = build(&mesh.vertices, &mesh.triangles, &options).with_context(context)?;
    let started = Instant::now();
    let machine = unit_update::machine(&config)?;
    let program = Program::compile(&tree, &mesh.triangles, mesh.vertices.len(), machine)
        .with_context(context)?;
    let compile_s = started.elapsed().as_secs_f64();
    let statistics = program.statistics();
    if let Some(json) = &args.json {
        let mut figures = json!({"scene": scene.name, "config": config.name});
        let parts = [
            serde_json::to_value(&statistics)?,
            json!({"compile_s": compile_s}),
        ];
        for part in parts {
            if let (Value::Object(all), Value::Object(part)) = (&mut figures, part) {
                all.extend(part);
            }
        }
        json.json(&figures)?.publish()?;
    }
    if args.list {
        return print(&program.listing());
    }
    let s = &statistics;
    print(&format!(
        "scene {}, {}, {}, {} vertices\n\
         {} ({:.3} a triangle): {} loads, {} leaf merges, {} node merges, {} nops\n\
         {} bytes ({:.2} a triangle); {:.3} loads a vertex; {} of {} vertex and {} of {} box registers used\n\
         compiled in {compile_s:.2} s\n",
        scene.name,
        counted(s.triangles, "triangle"),
        counted(s.nodes, "node"),
        grouped(s.vertices),
        counted(s.instructions, "instruction"),
        s.instructions_per_triangle,
        grouped(s.loads),
        grouped(s.leaf_merges),
        grouped(s.node_merges),
        grouped(s.nops),
        grouped(s.bytes),
        s.bytes_per_triangle,
        s.loads_per_vertex,
        s.vertex_registers_used,
        machine.vertex_registers,
        s.box_registers_used,
        machine.box_registers,
    ))
}
