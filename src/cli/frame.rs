//! Common parts of the subcommands that cast rays: scene, camera, memory image, packets of rays.

use super::{ConfigArgs, grouped, quoted, tell};
use anyhow::{Context, Result, bail, ensure};
use dynrt::bkd::{BuildOptions, MemoryImage, Tree, build, layout};
use dynrt::config::Config;
use dynrt::golden::Caster;
use dynrt::port::{Hit, Ray};
use dynrt::report;
use dynrt::scene::{
    self, Bounds, Camera, Frame, ImageSize, MachineMesh, RayKind, RayPacket, Scene, SceneSpec,
    View, default_light,
};
use dynrt::text;
use std::time::Instant;

/// The default size of a picture.
pub const SIZE: &str = "512x384";

/// The maximum number of pixels of a picture: its rays are held in memory, about 150 bytes each.
const MOST_PIXELS: u64 = 1 << 24;

/// The scene and the camera.
#[derive(clap::Args)]
pub struct SceneArgs {
    /// The scene: an OBJ file, or builtin:NAME for a built-in scene
    #[arg(value_name = "SCENE")]
    scene: SceneSpec,
    #[command(flatten)]
    camera: CameraArgs,
}

/// The heading of [`CameraArgs`].
const CAMERA: &str = "Camera (default: outside, framing the scene)";

/// The camera. By default it frames the scene from outside; the other options modify this camera.
#[derive(clap::Args)]
pub struct CameraArgs {
    /// A camera that depends on the scene's box only: inside for rooms, outside for objects
    #[arg(long, value_name = "VIEW", help_heading = CAMERA)]
    view: Option<View>,
    /// Position of the camera, in units of the scene
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true, conflicts_with = "view", help_heading = CAMERA)]
    eye: Option<[f64; 3]>,
    /// Point that the camera looks at [default: the centre of the scene's box]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true, conflicts_with = "view", help_heading = CAMERA)]
    look_at: Option<[f64; 3]>,
    /// Up direction [default: 0,1,0]
    #[arg(long, value_name = "X,Y,Z", value_parser = vector, allow_hyphen_values = true, conflicts_with = "view", help_heading = CAMERA)]
    up: Option<[f64; 3]>,
    /// Full vertical field of view in degrees [default: 60 with --eye, else that of the camera that frames the scene]
    #[arg(
        long,
        value_name = "DEGREES",
        allow_hyphen_values = true,
        conflicts_with = "view", help_heading = CAMERA)]
    fov: Option<f64>,
}

/// Parses three numbers, separated by commas.
fn vector(text: &str) -> Result<[f64; 3], String> {
    let numbers: Option<Vec<f64>> = (text.split(','))
        .map(|part| part.trim().parse().ok())
        .collect();
    numbers
        .and_then(|numbers| numbers.try_into().ok())
        .ok_or_else(|| "give three numbers, such as 1,2.5,-3".into())
}

/// A picture whose rays are cast: scene, camera, machine and rays.
#[derive(clap::Args)]
pub struct PictureArgs {
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Width and height of the picture in pixels
    #[arg(long, value_name = "WxH", default_value = SIZE)]
    pub size: ImageSize,
    #[command(flatten)]
    pub config: ConfigArgs,
    /// The rays to cast: rays of the camera; any-hit rays from their hits to a light; or rays from their hits in random directions
    #[arg(long, value_name = "RAYS", default_value = "primary")]
    pub rays: RayKind,
    /// Random seed of the memories' delays and stalls, and of the directions of diffuse rays
    #[arg(long, value_name = "S", default_value_t = 1)]
    pub seed: u64,
}

impl PictureArgs {
    /// Loads configuration and scene, and makes the rays of the camera.
    pub fn load(&self) -> Result<Loaded> {
        self.scene.load(self.size, &self.config)
    }

    /// The rays, of which at least one is active.
    pub fn rays_of(&self, loaded: &Loaded, image: &MemoryImage) -> Result<CastRays> {
        let slots = loaded.frame.rays_per_packet();
        let caster = Caster::new(image, loaded.config.triangle_test, slots);
        let cast = loaded.rays_of(self.rays, &caster, self.seed)?;
        active(&cast.rays())?;
        Ok(cast)
    }

    /// Checks that the rays are those of the camera, which are the same in all frames of an animation.
    pub fn only_primary(&self) -> Result<()> {
        ensure!(
            self.rays == RayKind::Primary,
            "--rays {}: the frames of an animation are cast with the rays of the camera; leave --rays out, or give a still scene",
            self.rays.name()
        );
        Ok(())
    }

    /// The arguments that select this picture again.
    pub fn replay(&self) -> String {
        let PictureArgs {
            scene,
            size,
            config,
            rays,
            seed,
        } = self;
        let mut text = scene.replay() + &config.replay();
        if size.to_string() != SIZE {
            text += &format!(" --size {size}");
        }
        if *rays != RayKind::Primary {
            text += &format!(" --rays {}", rays.name());
        }
        if *seed != 1 {
            text += &format!(" --seed {seed}");
        }
        text
    }
}

/// A scene as in the memory of a machine, without a tree.
pub struct Loaded {
    pub config: Config,
    pub scene: Scene,
    pub mesh: MachineMesh,
    pub camera: Camera,
    /// The name of the camera in reports.
    pub view: String,
    pub frame: Frame,
    /// The primary rays.
    pub packets: Vec<RayPacket>,
}

/// The rays that are cast for a picture.
pub struct CastRays {
    packets: Vec<RayPacket>,
    /// Of rays that start at the hits of primary rays: those hits, by the golden model.
    primary_hits: Option<Vec<Hit>>,
}

impl CastRays {
    /// All rays, packet after packet.
    pub fn rays(&self) -> Vec<Ray> {
        Loaded::rays(&self.packets)
    }

    /// The picture of the primary rays; rays from their hits darken it where they hit something.
    pub fn picture(&self, size: ImageSize, loaded: &Loaded, hits: &[Hit]) -> image::RgbImage {
        let Some(primary) = &self.primary_hits else {
            return report::shade(size, &loaded.packets, hits, &loaded.mesh, None);
        };
        let dark: Vec<bool> = hits.iter().map(Hit::is_hit).collect();
        report::shade(size, &loaded.packets, primary, &loaded.mesh, Some(&dark))
    }
}

/// A tree in memory.
pub struct Built {
    pub tree: Tree,
    pub image: MemoryImage,
    /// The build time of the tree in seconds.
    pub build_s: f64,
}

impl SceneArgs {
    /// The scene argument.
    pub fn spec(&self) -> &SceneSpec {
        &self.scene
    }

    /// The camera.
    pub fn camera(&self) -> &CameraArgs {
        &self.camera
    }

    /// The arguments that select this scene and camera again.
    pub fn replay(&self) -> String {
        format!(" {}{}", quoted(&self.scene), self.camera.replay())
    }

    /// Loads configuration and scene, warns of values outside the number format, and makes the rays of the camera.
    pub fn load(&self, size: ImageSize, config: &ConfigArgs) -> Result<Loaded> {
        check_size(size)?;
        let config = config.load()?;
        let frame = Frame::new(size, config.rays_per_packet as usize)?;
        let (scene, mesh) = load_mesh(&self.scene, &config)?;
        let camera = self.camera.of(scene.bounds())?;
        let packets = frame.primary_rays(&camera, &mesh)?;
        Ok(Loaded {
            config,
            scene,
            mesh,
            camera,
            view: self.camera.name(),
            frame,
            packets,
        })
    }
}

/// Checks that the rays of a picture fit in memory.
pub fn check_size(size: ImageSize) -> Result<()> {
    ensure!(
        u64::from(size.width) * u64::from(size.height) <= MOST_PIXELS,
        "--size {size}: more than {} pixels; give a smaller picture",
        grouped(MOST_PIXELS)
    );
    Ok(())
}

/// Loads a scene in the number format of a machine. Warns of omitted parts of the mesh and of values outside the format.
pub fn load_mesh(spec: &SceneSpec, config: &Config) -> Result<(Scene, MachineMesh)> {
    let scene = scene::load(spec)?;
    check_address_space(&scene, config)
        .with_context(|| format!("{spec}, configuration {}", config.name))?;
    let mesh = MachineMesh::new(&scene, config.format())?;
    for warning in scene.warnings.iter().chain(&mesh.warnings(&scene)) {
        tell(&format!("warning: {warning}"));
    }
    Ok((scene, mesh))
}

/// Checks that indices of triangles, nodes and vertices fit the machine's addresses.
fn check_address_space(scene: &Scene, config: &Config) -> Result<()> {
    let mesh = &scene.mesh;
    layout::check_capacity(0, mesh.triangles.len() as u64, config.address_bits)?;
    let (vertices, most) = (mesh.positions.len() as u64, 1u64 << config.address_bits);
    ensure!(
        vertices <= most,
        "the scene is too large for its address space: {vertices} vertices, but {} address bits hold {most}; \
         simplify the mesh or widen the address",
        config.address_bits
    );
    Ok(())
}

impl CameraArgs {
    /// The given options other than `--view`, as `name=value`.
    fn settings(&self) -> Vec<String> {
        let vector = |name: &str, vector: Option<[f64; 3]>| {
            vector.map(|vector| format!("{name}={}", vector.map(text::number).join(",")))
        };
        [
            vector("eye", self.eye),
            vector("look-at", self.look_at),
            vector("up", self.up),
            self.fov.map(|fov| format!("fov={}", text::number(fov))),
        ]
        .into_iter()
        .flatten()
        .collect()
    }

    /// The name of the camera in reports: `inside`, `outside`, `framing`, or its options.
    pub fn name(&self) -> String {
        let base = match self.view {
            Some(View::Inside) => Some("inside"),
            Some(View::Outside) => Some("outside"),
            None if self.eye.is_none() => Some("framing"),
            None => None,
        };
        let base = base.map(str::to_string).into_iter();
        base.chain(self.settings()).collect::<Vec<_>>().join(" ")
    }

    /// Whether no camera option is given.
    pub fn is_default(&self) -> bool {
        self.view.is_none() && self.settings().is_empty()
    }

    /// The options that select this camera again.
    pub fn replay(&self) -> String {
        let mut text = String::new();
        match self.view {
            Some(View::Inside) => text += " --view inside",
            Some(View::Outside) => text += " --view outside",
            None => {}
        }
        for setting in self.settings() {
            text += &format!(" --{setting}");
        }
        text
    }

    /// The camera for a scene of this box.
    pub fn of(&self, bounds: Bounds) -> Result<Camera> {
        if let Some(view) = self.view {
            return Ok(view.camera(bounds));
        }
        let framing = Camera::framing(bounds);
        if self.settings().is_empty() {
            return Ok(framing);
        }
        let (eye, fov) = match self.eye {
            Some(eye) => (eye, 60.0),
            None => (framing.eye, framing.vertical_fov_degrees()),
        };
        let (low, high) = bounds;
        let middle = std::array::from_fn(|k| low[k] / 2.0 + high[k] / 2.0);
        Camera::look_at(
            eye,
            self.look_at.unwrap_or(middle),
            self.up.unwrap_or([0.0, 1.0, 0.0]),
            self.fov.unwrap_or(fov),
        )
    }
}

impl Loaded {
    /// The builder's best tree for the machine.
    pub fn build_default(&self) -> Result<Built> {
        let Config {
            axes_per_node,
            stack_depth,
            ..
        } = self.config;
        self.build(&BuildOptions::default_for(axes_per_node, stack_depth))
    }

    /// Builds a tree and checks that the machine can hold it.
    pub fn build(&self, options: &BuildOptions) -> Result<Built> {
        let MachineMesh {
            vertices,
            triangles,
            ..
        } = &self.mesh;
        let started = Instant::now();
        let tree = build(vertices, triangles, options)
            .with_context(|| format!("scene {}", self.scene.name))?;
        let build_s = started.elapsed().as_secs_f64();
        let image = MemoryImage::new(self.mesh.format, vertices, triangles, &tree)
            .and_then(|image| image.check(self.config.stack_depth).map(|()| image))
            .with_context(|| format!("scene {}", self.scene.name))?;
        Ok(Built {
            tree,
            image,
            build_s,
        })
    }

    /// The rays of a kind. Secondary rays start where the golden model's primary rays end; `seed` is that of random directions.
    pub fn rays_of(&self, kind: RayKind, caster: &Caster, seed: u64) -> Result<CastRays> {
        if kind == RayKind::Primary {
            return Ok(CastRays {
                packets: self.packets.clone(),
                primary_hits: None,
            });
        }
        let hits = caster.cast_packets(&Loaded::rays(&self.packets)).hits;
        let light = default_light(self.scene.bounds(), &self.camera);
        let packets = kind.rays(&self.packets, &hits, &self.mesh, light, seed)?;
        Ok(CastRays {
            packets,
            primary_hits: Some(hits),
        })
    }

    /// The rays of packets, one after the other.
    pub fn rays(packets: &[RayPacket]) -> Vec<Ray> {
        let rays = packets.iter().flat_map(|packet| &packet.rays);
        rays.copied().collect()
    }
}

/// The number of active rays, at least 1.
pub fn active(rays: &[Ray]) -> Result<u64> {
    match rays.iter().filter(|ray| ray.active).count() {
        0 => bail!("this picture has no valid ray; give another camera or scene"),
        count => Ok(count as u64),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_are_read() {
        assert_eq!(vector("1,2.5,-3e2"), Ok([1.0, 2.5, -300.0]));
        for text in ["", "1,2", "1,2,3,4", "a,b,c", "1,,2"] {
            assert_eq!(
                vector(text),
                Err("give three numbers, such as 1,2.5,-3".into())
            );
        }
    }
}
