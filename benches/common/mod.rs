//! Common code of the benchmarks: scenes, and the rays of their pictures.

use dynrt::bkd::{BuildOptions, MemoryImage, build};
use dynrt::config::Config;
use dynrt::port::Ray;
use dynrt::scene::{self, Frame, ImageSize, MachineMesh, View};
use std::fmt;
use std::path::PathBuf;

/// A scene with the name that a benchmark's report shows.
#[derive(Clone, Debug)]
pub struct Subject {
    name: String,
    spec: String,
    view: View,
}

impl fmt::Display for Subject {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name)
    }
}

/// The built-in scenes and the available public scenes (see `.cargo/config.toml`); a line on stderr names each missing scene.
pub fn subjects() -> Vec<Subject> {
    let built_in = [
        ("builtin:teapot", View::Outside),
        ("builtin:knot?segments=2048&sides=24", View::Outside),
        ("builtin:interior", View::Inside),
    ];
    let shared = [
        ("stanford_bunny/stanford-bunny.obj", View::Outside),
        ("kitchen/kitchen.obj", View::Inside),
        ("sponza/sponza.obj", View::Inside),
    ];
    let folder = PathBuf::from(std::env::var_os("DYNRT_SCENES").unwrap_or_default());
    let mut subjects: Vec<Subject> = built_in
        .map(|(spec, view)| Subject {
            name: spec.into(),
            spec: spec.into(),
            view,
        })
        .into();
    for (file, view) in shared {
        let path = folder.join(file);
        if path.exists() {
            subjects.push(Subject {
                name: file.into(),
                spec: path.to_string_lossy().into_owned(),
                view,
            });
        } else {
            eprintln!("absent, so not measured: {file} (run sim/fetch_scenes.sh)");
        }
    }
    subjects
}

impl Subject {
    /// The scene in the machine's number format.
    #[allow(dead_code)]
    pub fn mesh(&self, config: &Config) -> MachineMesh {
        let scene = scene::load(&self.spec).expect("the scene loads");
        MachineMesh::new(&scene, config.format()).expect("the scene fits")
    }

    /// The memory image, and the rays of a picture.
    #[allow(dead_code)]
    pub fn picture(&self, config: &Config, size: ImageSize) -> (MemoryImage, Vec<Ray>) {
        let scene = scene::load(&self.spec).expect("the scene loads");
        let mesh = MachineMesh::new(&scene, config.format()).expect("the scene fits");
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        let tree = build(&mesh.vertices, &mesh.triangles, &options).expect("a tree");
        let image = MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree)
            .expect("the tree fits");
        let frame = Frame::new(size, config.rays_per_packet as usize).expect("a packet's size");
        let camera = self.view.camera(scene.bounds());
        let packets = frame.primary_rays(&camera, &mesh).expect("an eye in range");
        let rays = packets.into_iter().flat_map(|packet| packet.rays);
        (image, rays.collect())
    }
}
