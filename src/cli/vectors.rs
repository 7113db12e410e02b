//! `dynrt vectors`: golden vectors, the stimulus and expected results of each unit as files.

use super::files::{Kind, Output};
use super::frame::{CameraArgs, check_size, load_mesh};
use super::{ConfigArgs, counted, print, quoted, tell};
use anyhow::{Context, Result, ensure};
use dynrt::bkd::{BuildOptions, MemoryImage, build};
use dynrt::config::Config;
use dynrt::scene::animation::MachineScene;
use dynrt::scene::{BUILTIN_NAMES, Camera, Frame, ImageSize, RayPacket, SceneSpec, load_animated};
use dynrt::text;
use dynrt::vectors::{self, Made, Posed, Request, Summary};

const HELP: &str = "\
Writes memory images for $readmemh, stimulus and expected results of every unit, and manifest.json, which defines the files
and every bit of their lines. docs/vectors.md describes the files for other checkers; the Verilog test benches in sim/ replay
them in Icarus Verilog.

SCENE may be animated: a glTF file (.glb, .gltf), a folder of OBJ files, or builtin:water, builtin:figure, builtin:reef. The vectors
show it at one time, its skinned objects with their palettes. A scene with several objects or with transforms has two levels;
ray transformations are then written as well.

DIR is created if it does not exist. Earlier vectors in it are replaced as a whole; a folder with any other file is
refused.

Examples:
  dynrt vectors builtin:cornell --out build/vectors
  dynrt vectors model.obj --config dynrt-2006 --size 128x96 --limit 500 --out build/vectors
  dynrt vectors model.glb --clip Run --seconds 0.5 --out build/vectors";

/// Write golden vectors: memory images, stimulus and expected results of every unit
#[derive(clap::Args)]
#[command(after_help = HELP)]
pub struct Args {
    /// The scene: an OBJ or glTF file, a folder of OBJ files, or builtin:NAME
    #[arg(value_name = "SCENE")]
    scene: SceneSpec,
    /// The clip of an animated scene [default: its first clip]
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// The time within the clip of an animated scene, in seconds
    #[arg(
        long,
        value_name = "T",
        default_value_t = 0.0,
        allow_hyphen_values = true
    )]
    seconds: f64,
    #[command(flatten)]
    camera: CameraArgs,
    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = "64x48")]
    size: ImageSize,
    #[command(flatten)]
    config: ConfigArgs,
    /// Maximum number of packets of the picture, spread evenly over it; variants and directed packets are added to them [default: all]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Write the files even if they exceed 1 GiB
    #[arg(long)]
    force: bool,
    /// The output folder
    #[arg(long, value_name = "DIR", value_parser = Kind::Folder)]
    out: Output,
}

/// A scene in the memory of a machine, and the rays to cast.
struct Prepared {
    name: String,
    posed: Posed,
    packets: Vec<RayPacket>,
    camera: Camera,
    log2_scale: i32,
    /// The name of the clip, for an animated scene.
    clip: Option<String>,
}

impl Args {
    /// Whether the scene can be animated; other scenes are loaded with their warnings.
    fn moves(&self) -> bool {
        if let Some(rest) = self.scene.builtin() {
            let name = rest.split('?').next().unwrap_or(&rest);
            return !BUILTIN_NAMES.contains(&name);
        }
        self.scene.is_folder_or_gltf()
    }

    /// The command that writes the same files, without the output folder.
    fn replay(&self) -> String {
        let mut text = format!("dynrt vectors {}", quoted(&self.scene));
        if let Some(clip) = &self.clip {
            text += &format!(" --clip {}", quoted(clip));
        }
        if self.seconds != 0.0 {
            text += &format!(" --seconds {}", self.seconds);
        }
        text += &self.camera.replay();
        text += &format!(" --size {}", self.size);
        text += &self.config.replay();
        if let Some(limit) = self.limit {
            text += &format!(" --limit {limit}");
        }
        if self.force {
            text += " --force";
        }
        text
    }

    fn still(&self, config: &Config, frame: &Frame) -> Result<Prepared> {
        ensure!(
            self.clip.is_none() && self.seconds == 0.0,
            "{}: is a static scene; leave out --clip and --seconds, or give an animated scene",
            self.scene
        );
        let (scene, mesh) = load_mesh(&self.scene, config)?;
        let camera = self.camera.of(scene.bounds())?;
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        let image = build(&mesh.vertices, &mesh.triangles, &options)
            .and_then(|tree| MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree))
            .with_context(|| format!("scene {}", scene.name))?;
        Ok(Prepared {
            packets: frame.primary_rays(&camera, &mesh)?,
            camera,
            log2_scale: mesh.log2_scale,
            clip: None,
            name: scene.name,
            posed: Posed {
                image,
                skins: vec![],
            },
        })
    }

    fn at_a_time(&self, config: &Config, frame: &Frame) -> Result<Prepared> {
        ensure!(
            self.seconds.is_finite() && self.seconds >= 0.0,
            "--seconds {}: give a time of at least 0",
            text::number(self.seconds)
        );
        let scene = load_animated(&self.scene)?;
        for warning in &scene.warnings {
            tell(&format!("warning: {warning}"));
        }
        let clip = scene.clip(self.clip.as_deref())?;
        let poses = [scene.pose(clip, self.seconds)?];
        let extents = scene.extents_of(&poses)?;
        let machine = MachineScene::new(&scene, &extents, config.format(), config.skinning_joints)?;
        let hidden = scene.warnings_of(&poses);
        for warning in hidden.into_iter().chain(machine.warnings(&scene, &extents)) {
            tell(&format!("warning: {warning}"));
        }
        let camera = self.camera.of(extents.world)?;
        let posed = machine
            .frame(&poses[0])
            .and_then(|frame| vectors::pose(config, &machine, &frame))
            .with_context(|| format!("scene {}", scene.name))?;
        Ok(Prepared {
            packets: frame.rays_in(&camera, config.format(), machine.log2_scale)?,
            camera,
            log2_scale: machine.log2_scale,
            clip: clip.map(|number| scene.clips[number].name.clone()),
            name: scene.name,
            posed,
        })
    }
}

pub fn run(args: &Args) -> Result<()> {
    check_size(args.size)?;
    let config = args.config.load()?;
    let frame = Frame::new(args.size, config.rays_per_packet as usize)?;
    let Prepared {
        name,
        posed: Posed { image, skins },
        packets,
        camera,
        log2_scale,
        clip,
    } = match args.moves() {
        true => args.at_a_time(&config, &frame)?,
        false => args.still(&config, &frame)?,
    };
    let Summary {
        packets,
        rays,
        steps,
        tests,
        transforms,
        updates,
        nodes_written,
        skins: meshes,
        vertices_skinned,
        files,
    } = vectors::write(&Request {
        config: &config,
        scene_name: &name,
        image: &image,
        skins: &skins,
        packets: &packets,
        limit: args.limit.map(|limit| limit as usize),
        directed_scenes: true,
        force: args.force,
        made: Made {
            command: &args.replay(),
            frame,
            camera,
            log2_scale,
            motion: args.moves().then_some((clip.as_deref(), args.seconds)),
        },
        out: args.out.path(),
    })?;
    let transforms = match image.is_instanced() {
        true => format!("{}, ", counted(transforms, "ray transformation")),
        false => String::new(),
    };
    print(&format!(
        "{}: {files} files: {}, {}, {}, {transforms}{}; {} with {}; {} with {}; scene {name}, configuration {}\n",
        args.out,
        counted(packets, "packet"),
        counted(rays, "ray"),
        counted(steps, "traversal step"),
        counted(tests, "ray-triangle test"),
        counted(updates, "update"),
        counted(nodes_written, "node write"),
        counted(meshes, "skinned object"),
        counted(vertices_skinned, "vertex write"),
        config.name
    ))
}
