//! Common parts of the subcommands that run animated scenes: clip, frames, camera, rays.

use super::frame::{CameraArgs, active, check_size};
use super::{quoted, tell};
use anyhow::{Context, Result, ensure};
use dynrt::config::Config;
use dynrt::film::{Film, REBUILD_ABOVE};
use dynrt::port::Ray;
use dynrt::scene::animation::{MachineFrame, MachineScene};
use dynrt::scene::{Animated, Frame, ImageSize, RayPacket, SceneSpec, load_animated};
use dynrt::text;
use serde_json::{Value, json};

/// The frames of an animated scene.
#[derive(clap::Args)]
pub struct ClipArgs {
    /// The clip to play [default: the first clip of the scene]
    #[arg(long, value_name = "NAME")]
    clip: Option<String>,
    /// Number of frames [default: the length of the clip at --fps, else 12; 1 for a scene without clips]
    #[arg(long, value_name = "N", allow_hyphen_values = true)]
    frames: Option<String>,
    /// Frames per second; a clip that ends is repeated [default: the frames divide the clip evenly]
    #[arg(long, value_name = "F", allow_hyphen_values = true)]
    fps: Option<f64>,
}

/// When the trees of objects are rebuilt.
#[derive(clap::Args)]
pub struct RebuildArgs {
    /// Rebuild the tree of an object when its cost exceeds that of a new tree by more than this factor
    #[arg(long, value_name = "R", default_value_t = REBUILD_ABOVE, allow_hyphen_values = true)]
    pub rebuild_above: f64,
}

/// The times of the frames and the frame rate.
pub struct Schedule {
    /// The clip's name.
    pub clip: Option<String>,
    /// The time of each frame within the clip, in seconds.
    pub times: Vec<f64>,
    pub frames_per_second: f64,
}

/// The default number of frames.
const FRAMES: usize = 12;

/// The maximum number of frames: all of their pictures may be held in memory.
const MOST_FRAMES: usize = 100_000;

impl RebuildArgs {
    pub fn check(&self) -> Result<()> {
        ensure!(
            self.rebuild_above >= 1.0,
            "--rebuild-above {}: give a factor of at least 1",
            text::number(self.rebuild_above)
        );
        Ok(())
    }

    /// The option that selects this factor again.
    pub fn replay(&self) -> String {
        match self.rebuild_above == REBUILD_ABOVE {
            true => String::new(),
            false => format!(" --rebuild-above {}", text::number(self.rebuild_above)),
        }
    }
}

impl ClipArgs {
    /// Whether any option is given.
    pub fn is_given(&self) -> bool {
        self.clip.is_some() || self.frames.is_some() || self.fps.is_some()
    }

    /// The options that select these frames again.
    pub fn replay(&self) -> String {
        let mut text = String::new();
        if let Some(clip) = &self.clip {
            text += &format!(" --clip {}", quoted(clip));
        }
        if let Some(frames) = &self.frames {
            text += &format!(" --frames {frames}");
        }
        if let Some(fps) = self.fps {
            text += &format!(" --fps {}", text::number(fps));
        }
        text
    }

    /// The clip of a scene, and its frames.
    pub fn schedule(&self, scene: &Animated) -> Result<(Option<usize>, Schedule)> {
        let given = match &self.frames {
            None => None,
            Some(text) => match text.parse::<usize>() {
                Ok(count) if (1..=MOST_FRAMES).contains(&count) => Some(count),
                _ => anyhow::bail!(
                    "--frames {}: give a whole number from 1 to {MOST_FRAMES}",
                    text::word(text)
                ),
            },
        };
        if let Some(fps) = self.fps {
            ensure!(
                fps > 0.0 && (1e-3..=1e6).contains(&fps),
                "--fps {}: give 0.001 to 1000000 frames per second",
                text::number(fps)
            );
        }
        let clip = scene.clip(self.clip.as_deref())?;
        let seconds = clip.map_or(0.0, |clip| scene.clips[clip].seconds);
        let (times, frames_per_second) = if seconds > 0.0 {
            match (given, self.fps) {
                (given, Some(fps)) => {
                    // At most the limit, and at least one frame even if the clip is shorter than a frame.
                    let all = (seconds * fps).round().clamp(1.0, MOST_FRAMES as f64);
                    let count = given.unwrap_or(all as usize);
                    let time = |frame: usize| (frame as f64 / fps).rem_euclid(seconds);
                    ((0..count).map(time).collect(), fps)
                }
                (given, None) => {
                    let count = given.unwrap_or(FRAMES);
                    let clip = &scene.clips[clip.expect("it has a length")];
                    (clip.frame_times(count), count as f64 / seconds)
                }
            }
        } else {
            (vec![0.0; given.unwrap_or(1)], self.fps.unwrap_or(12.0))
        };
        Ok((
            clip,
            Schedule {
                clip: clip.map(|clip| scene.clips[clip].name.clone()),
                times,
                frames_per_second,
            },
        ))
    }
}

/// A scene whose clip and frames are known.
pub struct Scheduled {
    pub scene: Animated,
    pub clip: Option<usize>,
    pub schedule: Schedule,
}

impl Scheduled {
    /// Loads a scene.
    pub fn load(spec: &SceneSpec, args: &ClipArgs) -> Result<Scheduled> {
        let scene = load_animated(spec)?;
        for warning in &scene.warnings {
            tell(&format!("warning: {warning}"));
        }
        let (clip, schedule) = args.schedule(&scene)?;
        Ok(Scheduled {
            scene,
            clip,
            schedule,
        })
    }

    /// The frames in the numbers of a machine, and their rays. Warns of what is lost.
    pub fn shown(self, config: &Config, size: ImageSize, camera: &CameraArgs) -> Result<Shown> {
        let Scheduled {
            scene,
            clip,
            schedule,
        } = self;
        let frame = Frame::new(size, config.rays_per_packet as usize)?;
        let poses = schedule.times.iter().map(|&time| scene.pose(clip, time));
        let poses = poses.collect::<Result<Vec<_>>>()?;
        let extents = scene.extents_of(&poses)?;
        let format = config.format();
        let machine = MachineScene::new(&scene, &extents, format, config.skinning_joints)?;
        let hidden = scene.warnings_of(&poses);
        for warning in hidden.into_iter().chain(machine.warnings(&scene, &extents)) {
            tell(&format!("warning: {warning}"));
        }
        let frames = (poses.iter().enumerate())
            .map(|(number, pose)| {
                let frame = machine.frame(pose);
                frame.with_context(|| format!("scene {}, frame {number}", scene.name))
            })
            .collect::<Result<Vec<MachineFrame>>>()?;
        let camera = match camera.is_default() {
            true => scene.camera(&poses, size),
            false => camera.of(extents.world)?,
        };
        let packets = frame.rays_in(&camera, format, machine.log2_scale)?;
        let shown = Shown {
            scene,
            schedule,
            machine,
            frames,
            size,
            packets,
        };
        active(&shown.rays())?;
        Ok(shown)
    }
}

/// The frames of a scene in the numbers of a machine, and their rays.
pub struct Shown {
    pub scene: Animated,
    pub schedule: Schedule,
    pub machine: MachineScene,
    pub frames: Vec<MachineFrame>,
    pub size: ImageSize,
    pub packets: Vec<RayPacket>,
}

impl Shown {
    /// Loads a scene with its frames.
    pub fn load(
        spec: &SceneSpec,
        args: &ClipArgs,
        config: &Config,
        size: ImageSize,
        camera: &CameraArgs,
    ) -> Result<Shown> {
        check_size(size)?;
        Scheduled::load(spec, args)?.shown(config, size, camera)
    }

    pub fn film(&self) -> Film<'_> {
        Film {
            scene: &self.machine,
            frames: &self.frames,
            size: self.size,
            packets: &self.packets,
        }
    }

    pub fn rays(&self) -> Vec<Ray> {
        self.film().rays()
    }

    /// What a JSON file says of the scene.
    pub fn facts(&self, rebuild_above: f64) -> Value {
        let setup = self.film().setup();
        json!({
            "scene": self.scene.name,
            "clip": self.schedule.clip,
            "frames_per_second": self.schedule.frames_per_second,
            "levels": setup.levels,
            "objects": setup.objects,
            "instances": setup.instances,
            "triangles": setup.triangles,
            "rebuild_above": rebuild_above,
        })
    }

    /// The clip in a line of a report.
    pub fn clip(&self) -> String {
        match &self.schedule.clip {
            Some(clip) => format!(", clip {}", text::escaped(clip)),
            None => String::new(),
        }
    }
}
