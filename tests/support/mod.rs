//! Common code of the tests: scenes, rays, the command, seeds.

// Each test program uses only a part of it.
#![allow(dead_code, unused_imports)]

mod appearing;
pub mod command;
pub mod driver;
pub mod say;
mod shared;
pub mod small;

use dynrt::bkd::layout::{MemoryImage, check_capacity};
use dynrt::bkd::{BuildOptions, build};
use dynrt::config::Config;
use dynrt::golden::Caster;
use dynrt::port::Ray;
use dynrt::scene::{self, Camera, Frame, ImageSize, MachineMesh, RayPacket, View};

pub use appearing::write_appearing;
pub use dynrt::seed::of_run as seed;
pub use shared::shared_scene;

/// Whether tests are to run at full length: `DYNRT_FULL=1`.
pub fn full() -> bool {
    std::env::var_os("DYNRT_FULL").is_some_and(|value| value == "1")
}

/// A scene in a machine's memory, and the rays of a picture of it.
pub struct Prepared {
    pub mesh: MachineMesh,
    pub image: MemoryImage,
    pub camera: Camera,
    pub bounds: scene::Bounds,
    pub packets: Vec<RayPacket>,
    pub rays: Vec<Ray>,
}

/// Loads a scene, builds the default tree of the machine, and makes the rays of a picture.
pub fn prepare(config: &Config, scene: &str, size: &str, view: Option<View>) -> Prepared {
    let scene = scene::load(scene).unwrap();
    let mesh = MachineMesh::new(&scene, config.format()).unwrap();
    check_capacity(0, mesh.triangles.len() as u64, config.address_bits).unwrap();
    let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
    let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
    let image = MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree).unwrap();
    let bounds = scene.bounds();
    let camera = view.map_or_else(|| Camera::framing(bounds), |view| view.camera(bounds));
    let size: ImageSize = size.parse().unwrap();
    let frame = Frame::new(size, config.rays_per_packet as usize).unwrap();
    let packets = frame.primary_rays(&camera, &mesh).unwrap();
    let rays = rays_of(&packets);
    Prepared {
        mesh,
        image,
        camera,
        bounds,
        packets,
        rays,
    }
}

pub fn rays_of(packets: &[RayPacket]) -> Vec<Ray> {
    packets
        .iter()
        .flat_map(|packet| packet.rays.iter().copied())
        .collect()
}

/// The shadow rays of a prepared picture, by the golden model's primary hits.
#[allow(dead_code)]
pub fn shadow_rays(config: &Config, prepared: &Prepared) -> Vec<Ray> {
    let caster = Caster::new(
        &prepared.image,
        config.triangle_test,
        config.rays_per_packet as usize,
    );
    let hits = caster.cast_packets(&prepared.rays).hits;
    let light = scene::default_light(prepared.bounds, &prepared.camera);
    rays_of(&scene::shadow_rays(&prepared.packets, &hits, &prepared.mesh, light).unwrap())
}
