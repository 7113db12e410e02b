//! Films: animated scenes, frame by frame, in the numbers of a machine.
//!
//! ```text
//! scene ─→ frames (poses in machine numbers) ─→ objects with trees and update programs ─→ memory of the machine
//! ```
//!
//! [`Film`] and [`Object`] are what every way to run a film has in common. [`pack()`] puts a film into one memory, with a command list for
//! each frame, so that the chip runs it without a host.

mod object;
mod pack;
mod plan;
mod top;

pub use object::{Object, object_options};
pub use pack::{Packed, PackedFrame, pack};

use crate::bkd::{Bounds, InstanceSpec};
use crate::config::Config;
use crate::hw::{Plan, update};
use crate::port::{Hit, Ray};
use crate::program::UpdateMachine;
use crate::report;
use crate::scene::animation::{MachineFrame, MachineScene, Matrix3x4, transform_point};
use crate::scene::{ImageSize, RayPacket};
use anyhow::Result;
use image::RgbImage;
use serde::Serialize;

/// Default ratio of [`Quality::ratio`](crate::bkd::Quality::ratio) above which a tree is rebuilt.
pub const REBUILD_ABOVE: f64 = 1.5;

/// An animated scene with its frames and rays.
#[derive(Clone, Copy, Debug)]
pub struct Film<'a> {
    pub scene: &'a MachineScene,
    /// At least one frame.
    pub frames: &'a [MachineFrame],
    pub size: ImageSize,
    /// The rays, the same in all frames.
    pub packets: &'a [RayPacket],
}

/// The tree of a moving object in a frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TreeReport {
    pub object: String,
    pub sah_ratio: f64,
    /// Whether it is rebuilt from the next frame on.
    pub rebuilt: bool,
}

/// Facts about a film before its first frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Setup {
    /// 1 or 2.
    pub levels: u32,
    pub objects: usize,
    pub instances: usize,
    /// Triangles of all objects, each object counted once.
    pub triangles: usize,
}

impl Film<'_> {
    /// Facts about it.
    pub fn setup(&self) -> Setup {
        let objects = &self.scene.objects;
        Setup {
            levels: if self.is_one_level() { 1 } else { 2 },
            objects: objects.len(),
            instances: self.scene.instances.len(),
            triangles: objects.iter().map(|object| object.triangles.len()).sum(),
        }
    }

    /// See [`MachineScene::is_one_level`].
    pub fn is_one_level(&self) -> bool {
        self.scene.is_one_level(self.frames)
    }

    /// The rays, packet after packet.
    pub fn rays(&self) -> Vec<Ray> {
        let rays = self.packets.iter().flat_map(|packet| &packet.rays);
        rays.copied().collect()
    }

    /// The instances that are present in a frame, from the boxes of the objects: their numbers in the scene, and what a top-level tree
    /// needs of each.
    ///
    /// # Errors
    /// As [`InstanceSpec::new`].
    pub fn instances(
        &self,
        frame: usize,
        boxes: &[Bounds],
    ) -> Result<(Vec<usize>, Vec<InstanceSpec>)> {
        let instances = std::iter::zip(&self.scene.instances, &self.frames[frame].instances);
        let mut there = Vec::new();
        let mut specs = Vec::new();
        for (number, (&object, matrix)) in instances.enumerate() {
            let Some(matrix) = matrix else {
                continue;
            };
            let (format, columns) = (self.scene.format, columns(matrix));
            let spec = InstanceSpec::new(format, number, object, &columns, boxes[object])?;
            specs.push(spec);
            there.push(number);
        }
        Ok((there, specs))
    }

    /// Draws the hits of the rays in a frame. `there` are the numbers in the scene of the instances by which hits are numbered;
    /// `vertices` returns those of an object.
    pub fn shade<'v>(
        &self,
        frame: usize,
        there: &[usize],
        vertices: impl Fn(usize) -> &'v [[f64; 3]],
        hits: &[Hit],
    ) -> RgbImage {
        let corners = |hit: &Hit| {
            let instance = there[hit.instance as usize];
            let object = self.scene.instances[instance];
            let triangle = self.scene.objects[object].triangles[hit.triangle as usize];
            let matrix = self.frames[frame].instances[instance].as_ref();
            let matrix = matrix.expect("what is hit is there");
            let vertices = vertices(object);
            triangle.map(|vertex| transform_point(matrix, vertices[vertex as usize]))
        };
        report::shade_triangles(self.size, self.packets, hits, corners, None)
    }
}

/// The parameters for compiling update programs for a machine.
///
/// # Errors
/// If the machine's description has a mistake, which is not known to occur.
pub fn update_machine(config: &Config) -> Result<UpdateMachine> {
    Ok(update::module(&Plan::new(config)?)?.machine)
}

fn columns(matrix: &Matrix3x4) -> [[f64; 3]; 4] {
    std::array::from_fn(|column| std::array::from_fn(|row| matrix[row][column]))
}
