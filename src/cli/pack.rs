//! `dynrt pack`: the contents of memory with which a host needs no other software to cast the rays of a picture.

use super::files::{Kind, Output};
use super::frame::{Built, PictureArgs, active};
use super::{counted, print};
use anyhow::{Result, ensure};
use dynrt::chip::export;
use dynrt::chip::image::{Builder, Still, still};
use dynrt::emit::{self, HITS};
use dynrt::golden::chip::Chip;
use dynrt::hw::core::PREFIX;
use dynrt::scene::sort_along_morton_curve;
use dynrt::vectors::sha256_of_bytes;
use serde_json::json;
use std::fmt::Write as _;

const HELP: &str = "\
Writes into DIR
  image.bin        the bytes of memory from the load address on: arrays of the scene, rays, room for hits, the command list
  image.hex        the same for $readmemh, 16 bytes per line, the highest byte first
  hits/0000.bin    the bytes of the hits after the list, by the golden chip
  dynrt_regs.h     registers, descriptors, record sizes and limits of the machine for C programs
  manifest.json    load address, parts, address of the command list, and results with their checksums;
                   a coordinate in memory is one of the scene times 2^log2_scale

The host copies image.bin to the load address, writes the address of the command list to LIST, and rings DOORBELL; see docs/chip.md.
The driver in driver/ does this; see docs/integrating.md.

Examples:
  dynrt pack builtin:cornell --size 64x48 --out build/cornell
  dynrt pack builtin:interior --view inside --rays shadow --memory-size 33554432 --out build/hall";

/// Write an image of memory for a host: scene, rays, command list, and the expected hits
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    picture: PictureArgs,
    /// Address of the image in memory, a multiple of 64
    #[arg(long, value_name = "BYTES", default_value_t = 0)]
    address: u32,
    /// Size of the memory, at least the address and the image
    #[arg(long, value_name = "BYTES", default_value_t = 1 << 27)]
    memory_size: u64,
    /// The output folder
    #[arg(long, value_name = "DIR", value_parser = Kind::Folder)]
    out: Output,
}

/// Bytes of a line of image.hex.
const LINE: usize = 16;

pub fn run(args: &Args) -> Result<()> {
    ensure!(
        args.address.is_multiple_of(64),
        "--address {}: is not a multiple of 64",
        args.address
    );
    let Some(room) = args.memory_size.checked_sub(args.address.into()) else {
        anyhow::bail!(
            "--memory-size {}: the memory ends below --address {}",
            args.memory_size,
            args.address
        );
    };
    let picture = &args.picture;
    let mut loaded = picture.load()?;
    sort_along_morton_curve(&mut loaded.packets);
    let config = &loaded.config;
    let Built { image, .. } = loaded.build_default()?;
    let rays = picture.rays_of(&loaded, &image)?.rays();
    let active = active(&rays)?;
    let Still {
        memory,
        parts,
        list,
        hits,
        ..
    } = still(config, Builder::new(args.address, room), &image, &rays)?;
    let mut after = memory.clone();
    let outcome = Chip::new(config).run(&mut after, list, 1 << 10);
    outcome.check()?;
    let result = after.read(hits.address.into(), hits.bytes as usize);
    let result = result.unwrap_or_default().to_vec();
    let bytes = memory.bytes().to_vec();
    let mut hex = String::with_capacity(bytes.len() / LINE * (2 * LINE + 1));
    for line in bytes.chunks(LINE) {
        for byte in line.iter().rev() {
            let _ = write!(hex, "{byte:02x}");
        }
        hex.push('\n');
    }
    let name = format!("{HITS}/0000.bin");
    let [header, _] = export::names(PREFIX);
    let origin = format!("{}. Do not edit.", emit::origin(config));
    let manifest = json!({
        "generator": format!("dynrt {}", env!("CARGO_PKG_VERSION")),
        "files": ["image.bin", "image.hex", name, header],
        "scene": loaded.scene.name,
        "triangles": loaded.mesh.triangles.len(),
        "log2_scale": loaded.mesh.log2_scale,
        "config": config.name,
        "overrides": picture.config.overrides(config),
        "view": loaded.view,
        "width": picture.size.width,
        "height": picture.size.height,
        "ray_kind": picture.rays.name(),
        "rays": active,
        "hits": outcome.hits,
        "load_address": args.address,
        "bytes": bytes.len(),
        "sha256": sha256_of_bytes(&bytes),
        "parts": parts,
        "frames": [{
            "command_list": list,
            "result_address": hits.address,
            "result_bytes": hits.bytes,
            "result": name,
            "result_sha256": sha256_of_bytes(&result),
        }],
    });
    let mut text = format!(
        "scene {}, {}, configuration {}{}: {} at {:#x}\n",
        loaded.scene.name,
        counted(loaded.mesh.triangles.len() as u64, "triangle"),
        config.name,
        picture.config.settings(),
        counted(bytes.len() as u64, "byte"),
        args.address,
    );
    for part in &parts {
        let _ = writeln!(
            text,
            "  {:#010x} {:>12}  {}",
            part.address,
            counted(part.bytes, "byte"),
            part.name
        );
    }
    let _ = writeln!(
        text,
        "{}, {}; command list at {list:#x}; written to {}",
        counted(active, &format!("{} ray", picture.rays.name())),
        counted(outcome.hits, "hit"),
        args.out
    );
    let mut manifest = serde_json::to_string_pretty(&manifest)?;
    manifest.push('\n');
    let files = [
        ("image.bin".to_string(), bytes),
        ("image.hex".to_string(), hex.into_bytes()),
        (name, result),
        (header, export::header(config, &origin).into_bytes()),
        ("manifest.json".to_string(), manifest.into_bytes()),
    ];
    emit::write_folder(args.out.path(), &files)?;
    print(&text)
}
