//! Pictures are correct: whole frames agree with an independent `f64` intersector on the rounded scene,
//! except for a few counted pixels, each of which is at an edge or at two triangles of equal distance.

use crate::support::shared_scene;
use dynrt::bkd::{BuildOptions, MemoryImage, build};
use dynrt::config::TriangleTest;
use dynrt::float::Format;
use dynrt::golden::Caster;
use dynrt::golden::oracle::{Explanation, Oracle};
use dynrt::port::{Hit, Ray};
use dynrt::scene::{self, Camera, Frame, ImageSize, MachineMesh};
use rayon::prelude::*;

const TESTS: [TriangleTest; 2] = [TriangleTest::MollerTrumbore, TriangleTest::Watertight];

fn account(spec: &str, inside: bool, format: Format) {
    let scene = scene::load(spec).unwrap_or_else(|error| panic!("{error:#}"));
    let mesh = MachineMesh::new(&scene, format).expect("the scene fits");
    let camera = if inside {
        Camera::inside(scene.bounds())
    } else {
        Camera::outside(scene.bounds())
    };
    let frame =
        Frame::new(ImageSize::new(512, 384).expect("a size"), 4).expect("four rays a packet");
    let packets = frame.primary_rays(&camera, &mesh).expect("an eye in range");
    let rays: Vec<Ray> = packets.into_iter().flat_map(|packet| packet.rays).collect();

    let tree = build(
        &mesh.vertices,
        &mesh.triangles,
        &BuildOptions::default_for(2, 64),
    )
    .expect("the scene can be built");
    let image =
        MemoryImage::new(format, &mesh.vertices, &mesh.triangles, &tree).expect("the scene fits");
    let oracle = Oracle::new(&mesh.vertices, &mesh.triangles);
    let exact: Vec<Hit> = rays.par_iter().map(|ray| oracle.cast(ray)).collect();
    for test in TESTS {
        let machine = Caster::new(&image, test, 4).cast_packets(&rays).hits;
        let account = oracle.account(format, &rays, &machine, &exact);
        for &(index, explanation) in &account.differences {
            if let Explanation::Unexplained { distance, epsilon } = explanation {
                eprintln!(
                    "{spec} {test:?}: {:?}\n  machine {:?}\n  f64     {:?}\n  \
                     {distance:e} from an edge, allowed is {epsilon:e}",
                    rays[index], machine[index], exact[index]
                );
            }
        }
        println!(
            "{} {format} {test:?}: {} pixels, {} hits; another triangle: {} at the same distance, {} near an edge ({} lost), {} unexplained",
            scene.name,
            account.rays,
            account.hits,
            account.same_distance,
            account.near_edge,
            account.lost,
            account.unexplained
        );
        assert_eq!(account.rays, 512 * 384);
        assert!(
            account.hits > account.rays / 20,
            "{spec}: hardly anything is hit"
        );
        account
            .verdict()
            .unwrap_or_else(|error| panic!("{spec} {test:?}: {error}"));
    }
}

#[test]
fn built_in_scenes_look_as_in_f64() {
    account("builtin:teapot", false, Format::FP24);
    account("builtin:cornell", false, Format::FP24);
    account("builtin:interior", true, Format::FP24);
    account("builtin:knot", false, Format::FP24);
}

#[test]
fn other_formats_look_as_in_f64() {
    account(
        "builtin:teapot",
        false,
        Format::new(8, 23).expect("a format"),
    );
}

#[test]
fn shared_scenes_look_as_in_f64() {
    for (path, inside) in [
        ("teapot/teapot.obj", false),
        ("stanford_bunny/stanford-bunny.obj", false),
        ("kitchen/kitchen.obj", true),
        ("sponza/sponza.obj", true),
    ] {
        if let Some(path) = shared_scene(path) {
            account(&path, inside, Format::FP24);
        }
    }
}
