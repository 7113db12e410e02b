//! The picture is right: whole frames agree in triangle with an independent `f64` intersector on the rounded scene,
//! but for a few counted pixels, each of which lies at an edge or where two triangles are equally far.

use dynrt::bkd::{BuildOptions, MemoryImage, build};
use dynrt::config::TriangleTest;
use dynrt::float::Format;
use dynrt::golden::Caster;
use dynrt::golden::oracle::{Explanation, Oracle};
use dynrt::port::{Hit, Ray};
use dynrt::scene::{self, Camera, Frame, ImageSize, MachineMesh};
use rayon::prelude::*;

const TESTS: [TriangleTest; 2] = [TriangleTest::MollerTrumbore, TriangleTest::Watertight];

/// The greatest share of pixels that may show another triangle, in a thousand.
const MOST_PER_MILLE: usize = 1;

/// What a frame's pixels come to.
#[derive(Clone, Copy, Debug, Default)]
struct Account {
    pixels: usize,
    hits: usize,
    same_distance: usize,
    near_edge: usize,
    unexplained: usize,
    /// Of those near an edge, the pixels in which the machine sees nothing and the oracle something.
    lost: usize,
}

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
        let mut account = Account {
            pixels: rays.len(),
            ..Account::default()
        };
        for ((ray, machine), exact) in rays.iter().zip(&machine).zip(&exact) {
            account.hits += usize::from(machine.is_hit());
            match oracle.explain(format, ray, machine, exact) {
                Explanation::Agrees => {}
                Explanation::SameDistance { .. } => account.same_distance += 1,
                Explanation::NearEdge { .. } => {
                    account.near_edge += 1;
                    account.lost += usize::from(!machine.is_hit());
                }
                Explanation::Unexplained { distance, epsilon } => {
                    account.unexplained += 1;
                    eprintln!(
                        "{spec} {test:?}: {ray:?}\n  machine {machine:?}\n  f64     {exact:?}\n  \
                         {distance:e} from an edge, allowed is {epsilon:e}"
                    );
                }
            }
        }
        println!("{} {format} {test:?}: {account:?}", scene.name);
        assert_eq!(account.pixels, 512 * 384);
        assert!(
            account.hits > account.pixels / 20,
            "{spec}: hardly anything is hit"
        );
        assert_eq!(
            account.unexplained, 0,
            "{spec} {test:?}: unexplained pixels"
        );
        let others = account.same_distance + account.near_edge;
        assert!(
            others * 1000 <= account.pixels * MOST_PER_MILLE,
            "{spec} {test:?}: {others} of {} pixels show another triangle",
            account.pixels
        );
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
        let path = format!("{}/../shared/scenes/{path}", env!("CARGO_MANIFEST_DIR"));
        if std::path::Path::new(&path).exists() {
            account(&path, inside, Format::FP24);
        } else {
            eprintln!("{path} is absent: not tested with it");
        }
    }
}
