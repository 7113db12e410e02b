//! `dynrt pack`: the contents of memory with which a host needs no other software to cast the rays of a picture or of an animation.

use super::files::{Kind, Output};
use super::film::{ClipArgs, RebuildArgs, Shown};
use super::frame::{Built, PictureArgs, active};
use super::{counted, print};
use anyhow::{Context, Result, ensure};
use dynrt::chip::export;
use dynrt::chip::image::{Builder, Part, Still, still};
use dynrt::chip::memory::Memory;
use dynrt::config::Config;
use dynrt::emit::{self, HITS};
use dynrt::film::{self, Packed};
use dynrt::golden::chip::{Chip, Outcome};
use dynrt::hw::core::PREFIX;
use dynrt::scene::sort_along_morton_curve;
use dynrt::vectors::sha256_of_bytes;
use serde_json::{Value, json};
use std::fmt::Write as _;

const HELP: &str = "\
Writes into DIR
  image.bin        the bytes of memory from the load address on: arrays, rays, room for hits, command lists;
                   of an animation also update programs, and palettes, vertices and instances of all frames
  image.hex        the same for $readmemh, 16 bytes per line, the highest byte first
  hits/0000.bin    the bytes of the hits after the list of a frame, by the golden chip; one file per frame
  dynrt_regs.h     registers, descriptors, record sizes and limits of the machine for C programs
  manifest.json    load address, parts, and for each frame the address of its command list, the results and
                   their checksum; a coordinate in memory is one of the scene times 2^log2_scale

The host copies image.bin to the load address. For each frame it writes the address of the command list to
LIST and rings DOORBELL; it writes nothing else. The driver in driver/ does this; see docs/integrating.md.

SCENE is an OBJ file, a glTF file (.glb, .gltf), a folder of OBJ files (the frames of a sequence), or
builtin:NAME, as for dynrt animate.

Examples:
  dynrt pack builtin:cornell --size 64x48 --out build/cornell
  dynrt pack builtin:figure --frames 24 --size 256x192 --out build/figure
  dynrt pack builtin:interior --view inside --rays shadow --memory-size 33554432 --out build/hall";

/// Write an image of memory for a host: scene, rays, command lists, and the expected hits
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    #[command(flatten)]
    picture: PictureArgs,
    #[command(flatten)]
    clip: ClipArgs,
    #[command(flatten)]
    rebuild: RebuildArgs,
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

/// Descriptors after which the golden chip gives up a list.
const MOST_DESCRIPTORS: usize = 1 << 20;

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
    args.rebuild.check()?;
    let memory = Builder::new(args.address, room);
    match args.clip.is_given() || args.picture.scene.spec().is_animated() {
        false => pack_still(args, memory),
        true => pack_film(args, memory),
    }
}

/// What is written: the memory with the lists of its frames, and facts about the scene.
struct Image<'a> {
    args: &'a Args,
    config: &'a Config,
    memory: Memory,
    parts: Vec<Part>,
    hits: Part,
    /// For each frame, the address of its list, and facts for the manifest.
    lists: Vec<(u32, Value)>,
    /// Active rays of each frame.
    active: u64,
    /// The first words of the report, and facts for the manifest.
    title: String,
    facts: Value,
    /// Of the part of vertices, what its bytes are.
    vertex_bytes: Vec<(&'static str, u64)>,
}

fn pack_still(args: &Args, memory: Builder) -> Result<()> {
    let picture = &args.picture;
    let mut loaded = picture.load()?;
    sort_along_morton_curve(&mut loaded.packets);
    let Built { image, .. } = loaded.build_default()?;
    let rays = picture.rays_of(&loaded, &image)?.rays();
    let Still {
        memory,
        parts,
        list,
        hits,
        ..
    } = still(&loaded.config, memory, &image, &rays)?;
    let triangles = loaded.mesh.triangles.len();
    let image = Image {
        args,
        config: &loaded.config,
        memory,
        parts,
        hits,
        lists: vec![(list, json!({}))],
        active: active(&rays)?,
        title: format!("scene {}", loaded.scene.name),
        facts: json!({
            "scene": loaded.scene.name,
            "triangles": triangles,
            "log2_scale": loaded.mesh.log2_scale,
        }),
        vertex_bytes: vec![],
    };
    image.write(triangles as u64)
}

fn pack_film(args: &Args, memory: Builder) -> Result<()> {
    let picture = &args.picture;
    picture.only_primary()?;
    let config = picture.config.load()?;
    let camera = picture.scene.camera();
    let mut shown = Shown::load(
        picture.scene.spec(),
        &args.clip,
        &config,
        picture.size,
        camera,
    )?;
    sort_along_morton_curve(&mut shown.packets);
    let film = shown.film();
    let packed = film::pack(&config, film, args.rebuild.rebuild_above, memory);
    let packed = packed.with_context(|| format!("scene {}", shown.scene.name))?;
    let setup = film.setup();
    let Packed {
        memory,
        parts,
        vertex_bytes,
        hits,
        frames,
        ..
    } = packed;
    let instances = 0..film.scene.instances.len();
    let lists = frames.iter().enumerate().map(|(number, frame)| {
        let absent = instances.clone().filter(|k| !frame.there.contains(k));
        let facts = json!({
            "seconds": shown.schedule.times[number],
            "triangles_updated": frame.triangles,
            // Hits name the instances that are present, in order.
            "absent_instances": absent.collect::<Vec<_>>(),
        });
        (frame.list, facts)
    });
    let mut facts = shown.facts(args.rebuild.rebuild_above);
    facts["log2_scale"] = json!(film.scene.log2_scale);
    let image = Image {
        args,
        config: &config,
        memory,
        parts,
        hits,
        lists: lists.collect(),
        active: active(&film.rays())?,
        title: format!(
            "scene {}{}, {} of {} and {}",
            shown.scene.name,
            shown.clip(),
            counted(frames.len() as u64, "frame"),
            counted(setup.objects as u64, "object"),
            counted(setup.instances as u64, "instance"),
        ),
        facts,
        vertex_bytes,
    };
    image.write(setup.triangles as u64)
}

impl Image<'_> {
    /// Runs the lists one after the other on the golden chip. For each, what it leaves as hits, and how it ended.
    fn results(&self) -> Result<Vec<(Vec<u8>, Outcome)>> {
        let mut memory = self.memory.clone();
        let mut chip = Chip::new(self.config);
        let result = |(list, _): &(u32, Value)| {
            let outcome = chip.run(&mut memory, *list, MOST_DESCRIPTORS);
            outcome.check()?;
            let bytes = memory.read(self.hits.address.into(), self.hits.bytes as usize);
            Ok((bytes.unwrap_or_default().to_vec(), outcome))
        };
        self.lists.iter().map(result).collect()
    }

    /// The image for $readmemh.
    fn hex(&self) -> String {
        let bytes = self.memory.bytes();
        let mut hex = String::with_capacity(bytes.len() / LINE * (2 * LINE + 1));
        for line in bytes.chunks(LINE) {
            for byte in line.iter().rev() {
                let _ = write!(hex, "{byte:02x}");
            }
            hex.push('\n');
        }
        hex
    }

    fn text(&self, triangles: u64, hits: u64) -> String {
        let Args { picture, out, .. } = self.args;
        let mut text = format!(
            "{}, {}, configuration {}{}: {} at {:#x}\n",
            self.title,
            counted(triangles, "triangle"),
            self.config.name,
            picture.config.settings(),
            counted(self.memory.bytes().len() as u64, "byte"),
            self.args.address,
        );
        for part in &self.parts {
            let bytes = counted(part.bytes, "byte");
            let _ = writeln!(text, "  {:#010x} {bytes:>16}  {}", part.address, part.name);
            let of_vertices = (self.vertex_bytes.iter())
                .filter(|(_, bytes)| part.name == "vertices" && *bytes > 0);
            for (what, bytes) in of_vertices {
                let _ = writeln!(
                    text,
                    "  {:10} {:>16}    {what}",
                    "",
                    counted(*bytes, "byte")
                );
            }
        }
        let lists = match self.lists.len() {
            1 => "command list",
            _ => "first command list",
        };
        let _ = writeln!(
            text,
            "{}, {}; {lists} at {:#x}; written to {out}",
            counted(self.active, &format!("{} ray", picture.rays.name())),
            counted(hits, "hit"),
            self.lists[0].0,
        );
        text
    }

    fn write(self, triangles: u64) -> Result<()> {
        let picture = &self.args.picture;
        let results = self.results()?;
        let hits = results.iter().map(|(_, outcome)| outcome.hits).sum();
        let bytes = self.memory.bytes();
        let hex = self.hex();
        let mut names = vec!["image.bin".to_string(), "image.hex".to_string()];
        let mut frames = vec![];
        for (number, ((list, facts), (result, outcome))) in
            self.lists.iter().zip(&results).enumerate()
        {
            let name = format!("{HITS}/{number:04}.bin");
            let mut frame = json!({
                "command_list": list,
                "result_address": self.hits.address,
                "result_bytes": self.hits.bytes,
                "result": name,
                "result_sha256": sha256_of_bytes(result),
                "hits": outcome.hits,
            });
            extend(&mut frame, facts);
            frames.push(frame);
            names.push(name);
        }
        let [header, _] = export::names(PREFIX);
        names.push(header);
        let mut manifest = json!({
            "generator": format!("dynrt {}", env!("CARGO_PKG_VERSION")),
            "files": names,
            "config": self.config.name,
            "overrides": picture.config.overrides(self.config),
            "view": picture.scene.camera().name(),
            "width": picture.size.width,
            "height": picture.size.height,
            "ray_kind": picture.rays.name(),
            "rays": self.active,
            "hits": hits,
            "load_address": self.args.address,
            "bytes": bytes.len(),
            "sha256": sha256_of_bytes(bytes),
            "parts": self.parts,
            "frames": frames,
        });
        extend(&mut manifest, &self.facts);
        if !self.vertex_bytes.is_empty() {
            let of_vertices = self.vertex_bytes.iter();
            let of_vertices =
                of_vertices.map(|(what, bytes)| json!({"name": what, "bytes": bytes}));
            manifest["vertex_parts"] = of_vertices.collect();
        }
        let text = self.text(triangles, hits);
        let mut manifest = serde_json::to_string_pretty(&manifest)?;
        manifest.push('\n');
        let origin = format!("{}. Do not edit.", emit::origin(self.config));
        let header = export::header(self.config, &origin).into_bytes();
        let results = results.into_iter().map(|(bytes, _)| bytes);
        let contents = [bytes.to_vec(), hex.into_bytes()]
            .into_iter()
            .chain(results)
            .chain([header]);
        let mut files: Vec<(String, Vec<u8>)> = names.into_iter().zip(contents).collect();
        files.push((emit::MANIFEST.to_string(), manifest.into_bytes()));
        emit::write_folder(self.args.out.path(), &files)?;
        print(&text)
    }
}

/// Adds the entries of one JSON object to another.
fn extend(value: &mut Value, more: &Value) {
    if let (Value::Object(all), Value::Object(more)) = (value, more) {
        all.extend(more.clone());
    }
}
