//! The tree: structural laws on random small meshes full of coincidences, and the measured cost of
//! traversing the trees of real scenes.

use dynrt::bkd::{BuildOptions, MemoryImage, Target, build};
use dynrt::float::{Arithmetic, Format};
use glam::DVec3;

struct Mesh {
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
}

// ---------------------------------------------------------------------------------------------------
// Packet traversal in f64: what the machine's TPU decides, without its rounding.

/// A ray of a packet and the nearest hit that it knows.
#[derive(Clone, Copy)]
struct Ray {
    origin: [f64; 3],
    direction: [f64; 3],
    reciprocal: [f64; 3],
    t: f64,
}

#[derive(Clone, Copy)]
struct Span {
    near: f64,
    far: f64,
}

#[derive(Default)]
struct Cost {
    packets: u64,
    steps: u64,
    tests: u64,
    hits: u64,
}

impl Cost {
    fn steps_per_packet(&self) -> f64 {
        self.steps as f64 / self.packets as f64
    }

    fn tests_per_packet(&self) -> f64 {
        self.tests as f64 / self.packets as f64
    }
}

const RAYS: usize = 4;

fn clip(ray: &Ray, axis: usize, interval: [f64; 2], span: Span) -> Span {
    let mut planes = interval.map(|p| (p - ray.origin[axis]) * ray.reciprocal[axis]);
    if ray.direction[axis].is_sign_negative() {
        planes.reverse();
    }
    let [near, far] = planes;
    // A NaN does not clip.
    Span {
        near: if near > span.near { near } else { span.near },
        far: if far < span.far { far } else { span.far },
    }
}

fn enters(ray: &Ray, span: Span) -> bool {
    span.near <= span.far && span.near <= ray.t
}

fn intersect(image: &MemoryImage, record: u32, ray: &mut Ray) {
    let corners = image.records[record as usize].vertices;
    let corners = corners.map(|v| DVec3::from(image.vertices[v as usize]));
    let direction = DVec3::from(ray.direction);
    let (e1, e2) = (corners[1] - corners[0], corners[2] - corners[0]);
    let p = direction.cross(e2);
    let determinant = e1.dot(p);
    let s = DVec3::from(ray.origin) - corners[0];
    let u = s.dot(p) / determinant;
    let q = s.cross(e1);
    let v = direction.dot(q) / determinant;
    let t = e2.dot(q) / determinant;
    if u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t >= 0.0 && t < ray.t {
        ray.t = t;
    }
}

fn traverse(image: &MemoryImage, rays: &mut [Ray; RAYS], cost: &mut Cost) {
    cost.packets += 1;
    const WHOLE: Span = Span {
        near: 0.0,
        far: f64::INFINITY,
    };
    const NOTHING: Span = Span {
        near: f64::INFINITY,
        far: f64::NEG_INFINITY,
    };
    let mut spans = [WHOLE; RAYS];
    for (ray, span) in rays.iter().zip(&mut spans) {
        for axis in 0..3 {
            let bounds = [image.bounds.0[axis], image.bounds.1[axis]];
            *span = clip(ray, axis, bounds, *span);
        }
    }
    let mut stack = vec![(image.root.root(), spans)];
    while let Some((mut target, mut spans)) = stack.pop() {
        // A popped entry that is too far costs no step.
        while (0..RAYS).any(|r| enters(&rays[r], spans[r])) {
            let index = match target {
                Target::Node(index) => index,
                Target::Record(record) => {
                    cost.tests += 1;
                    for (ray, span) in rays.iter_mut().zip(spans) {
                        if enters(ray, span) {
                            intersect(image, record, ray);
                        }
                    }
                    break;
                }
            };
            cost.steps += 1;
            let node = &image.nodes[index as usize];
            let link = node.link;
            let mut child_spans = [[NOTHING; RAYS]; 2];
            let (mut any, mut left_first) = ([false; 2], false);
            for (r, ray) in rays.iter().enumerate() {
                if !enters(ray, spans[r]) {
                    continue;
                }
                let left = clip(ray, link.left_axis.into(), node.left, spans[r]);
                let right = clip(ray, link.right_axis.into(), node.right, spans[r]);
                let into = [enters(ray, left), enters(ray, right)];
                any = [any[0] | into[0], any[1] | into[1]];
                left_first |= into[0] && into[1] && left.near <= right.near;
                child_spans[0][r] = left;
                child_spans[1][r] = right;
            }
            let children = link.children(index);
            let first = match any {
                [false, false] => break,
                [true, false] => 0,
                [false, true] => 1,
                [true, true] => {
                    let first = usize::from(!left_first);
                    stack.push((children[1 - first], child_spans[1 - first]));
                    first
                }
            };
            target = children[first];
            spans = child_spans[first];
        }
    }
    cost.hits += rays.iter().filter(|ray| ray.t.is_finite()).count() as u64;
}

struct Camera {
    eye: DVec3,
    direction: DVec3,
    /// Of half the vertical field of view.
    tangent: f64,
}

impl Camera {
    fn inside(lo: DVec3, hi: DVec3) -> Self {
        Camera {
            eye: (lo + hi) / 2.0 + DVec3::new(0.3, 0.0, 0.05) * (hi - lo),
            direction: DVec3::new(-1.0, 0.05, 0.1),
            tangent: 0.7,
        }
    }

    fn outside(lo: DVec3, hi: DVec3) -> Self {
        let away = 0.9 * (hi - lo).length() * DVec3::new(0.5, 0.4, 1.0).normalize();
        Camera {
            eye: (lo + hi) / 2.0 + away,
            direction: -away,
            tangent: 0.55,
        }
    }

    /// The cost of a frame of 512 × 384 rays, 2 × 2 a packet.
    fn frame(&self, image: &MemoryImage) -> Cost {
        const SIZE: [usize; 2] = [512, 384];
        let forward = self.direction.normalize();
        let right = forward.cross(DVec3::Y).normalize();
        let up = right.cross(forward);
        let aspect = SIZE[0] as f64 / SIZE[1] as f64;
        let mut cost = Cost::default();
        for y in (0..SIZE[1]).step_by(2) {
            for x in (0..SIZE[0]).step_by(2) {
                let mut rays = std::array::from_fn(|r| {
                    let across = ((x + r % 2) as f64 + 0.5) / SIZE[0] as f64 * 2.0 - 1.0;
                    let down = ((y + r / 2) as f64 + 0.5) / SIZE[1] as f64 * 2.0 - 1.0;
                    let direction = forward
                        + right * (across * self.tangent * aspect)
                        + up * (-down * self.tangent);
                    Ray {
                        origin: self.eye.into(),
                        direction: direction.into(),
                        reciprocal: direction.recip().into(),
                        t: f64::INFINITY,
                    }
                });
                traverse(image, &mut rays, &mut cost);
            }
        }
        cost
    }
}

/// A scene of the shared folder, scaled and rounded as scenes are when loaded; none where the folder is absent.
fn shared_scene(path: &str) -> Option<Mesh> {
    let path = format!("{}/../shared/scenes/{path}", env!("CARGO_MANIFEST_DIR"));
    if !std::path::Path::new(&path).exists() {
        eprintln!("{path} is absent: its tree is not measured");
        return None;
    }
    let options = tobj::LoadOptions {
        triangulate: true,
        ignore_lines: true,
        ignore_points: true,
        ..tobj::LoadOptions::default()
    };
    let (models, _) = tobj::load_obj(&path, &options).expect("a mesh");
    let (mut vertices, mut triangles) = (Vec::new(), Vec::new());
    for tobj::Model { mesh, .. } in models {
        let base = vertices.len() as u32;
        let positions = mesh.positions.chunks_exact(3);
        vertices.extend(positions.map(|p| [p[0], p[1], p[2]].map(f64::from)));
        let corners = mesh.indices.chunks_exact(3);
        triangles.extend(corners.map(|i| [i[0], i[1], i[2]].map(|i| base + i)));
    }
    let greatest = (vertices.iter().flatten()).fold(0.0_f64, |greatest, x| greatest.max(x.abs()));
    let scale = (256.0 / greatest).log2().floor().exp2();
    let arithmetic = Arithmetic::new(Format::FP24);
    for x in vertices.iter_mut().flatten() {
        *x = arithmetic.round(*x * scale);
    }
    Some(Mesh {
        vertices,
        triangles,
    })
}

const STACK: u32 = 32;

type View = fn(DVec3, DVec3) -> Camera;

fn measure(name: &str, mesh: &Mesh, view: View, label: &str, options: &BuildOptions) -> Cost {
    let start = std::time::Instant::now();
    let tree = build(&mesh.vertices, &mesh.triangles, options).unwrap();
    let built = start.elapsed().as_secs_f64();
    let image = MemoryImage::new(Format::FP24, &mesh.vertices, &mesh.triangles, &tree).unwrap();
    image.check(STACK, 26).unwrap();
    let (lo, hi) = image.bounds;
    let cost = view(lo.into(), hi.into()).frame(&image);
    eprintln!(
        "{name:14} {label:8} {:6.2} steps {:5.2} tests a packet, depth {:2}, built in {built:.3} s",
        cost.steps_per_packet(),
        cost.tests_per_packet(),
        tree.depth(),
    );
    cost
}

#[test]
fn trees_of_real_scenes_cost_what_the_design_asks() {
    // Scene, camera, the design page's first figures of the region cost (packet steps, triangle tests), and the
    // most steps of the builder's best for one of that cost.
    let scenes: [(&str, View, [f64; 2], f64); 3] = [
        ("sponza/sponza.obj", Camera::inside, [62.0, 7.5], 0.9),
        ("kitchen/kitchen.obj", Camera::inside, [27.0, 2.8], 0.9),
        (
            "stanford_bunny/stanford-bunny.obj",
            Camera::outside,
            [11.0, 1.8],
            1.0,
        ),
    ];
    for (path, view, [steps, tests], gain) in scenes {
        let Some(mesh) = shared_scene(path) else {
            continue;
        };
        let name = path.split('/').next().unwrap();
        let measure = |label, options| measure(name, &mesh, view, label, &options);
        measure("plain", BuildOptions::plain(STACK));
        let region = measure("region", BuildOptions::region(STACK));
        measure("1 axis", BuildOptions::default_for(1, STACK));
        let best = measure("default", BuildOptions::default_for(2, STACK));
        assert!(region.hits > 0 && region.hits == best.hits);
        assert!(region.steps_per_packet() <= 1.05 * steps, "{name}");
        assert!(region.tests_per_packet() <= 1.05 * tests, "{name}");
        assert!(
            best.steps_per_packet() <= gain * region.steps_per_packet(),
            "{name}"
        );
    }
}
