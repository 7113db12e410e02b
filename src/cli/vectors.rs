//! `dynrt vectors`: what goes into and comes out of each unit, as files.

use super::frame::{Built, SceneArgs};
use super::{ConfigArgs, counted, print};
use anyhow::Result;
use dynrt::scene::ImageSize;
use dynrt::vectors::{self, Request, Summary};
use std::path::PathBuf;

const HELP: &str = "\
Writes memory images for $readmemh, stimulus and expected results of every unit, and manifest.json, which lists the files
and every bit of their lines. docs/vectors.md describes them so that another program can check them knowing nothing
else; the Verilog benches in sim/ replay them in plain Icarus.

DIR is made if it does not exist; earlier vectors in it are replaced as a whole; a folder that holds anything
else is left alone.

Examples:
  dynrt vectors builtin:cornell --out build/vectors
  dynrt vectors model.obj --config dynrt-2006 --size 128x96 --limit 500 --out build/vectors";

/// Write golden vectors: memory images, stimulus and expected results of every unit
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    scene: SceneArgs,
    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "64x48")]
    size: ImageSize,
    #[command(flatten)]
    config: ConfigArgs,
    /// The most packets of the picture to cast, spread evenly over it [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// The folder to write
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

pub fn run(args: &Args) -> Result<()> {
    let loaded = args.scene.load(args.size, &args.config)?;
    let Built { image, .. } = loaded.build_default()?;
    let Summary {
        packets,
        rays,
        steps,
        tests,
        files,
    } = vectors::write(&Request {
        config: &loaded.config,
        scene_name: &loaded.scene.name,
        image: &image,
        packets: &loaded.packets,
        limit: args.limit.map(|limit| limit as usize),
        out: &args.out,
    })?;
    print(&format!(
        "{}: {files} files: {}, {}, {}, {}; scene {}, configuration {}\n",
        args.out.display(),
        counted(packets, "packet"),
        counted(rays, "ray"),
        counted(steps, "packet step"),
        counted(tests, "ray-triangle test"),
        loaded.scene.name,
        loaded.config.name
    ))
}
