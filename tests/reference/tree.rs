//! The tree: structural properties on random small meshes with many ties, and the measured cost of
//! traversing the trees of real scenes.

use dynrt::bkd::stats::TreeStatistics;
use dynrt::bkd::{
    BuildOptions, Child, MemoryImage, Node, Record, SortKeys, SplitCost, Target, build, layout,
};
use dynrt::float::{Arithmetic, Format};
use glam::DVec3;

struct Mesh {
    vertices: Vec<[f64; 3]>,
    triangles: Vec<[u32; 3]>,
}

// ---------------------------------------------------------------------------------------------------
// Packet traversal in f64: the decisions of the machine's traversal unit, without its rounding.

/// A ray of a packet and its closest hit so far.
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
    /// The tangent of half the vertical field of view.
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

    /// The cost of a frame of 512 × 384 rays in packets of 2 × 2.
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

/// A public scene, scaled and rounded as loaded scenes are; `None` if it is absent.
fn shared_scene(path: &str) -> Option<Mesh> {
    let path = crate::support::shared_scene(path)?;
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
    image.check(STACK).unwrap();
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
    // Scene, camera, first figures of the region cost (packet steps, triangle tests), and the
    // maximum ratio of the steps of the default tree to those of that cost.
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

// ---------------------------------------------------------------------------------------------------
// Structure.

/// All options of tree construction.
fn forms(max_depth: u32) -> Vec<BuildOptions> {
    let mut forms = Vec::new();
    for cost in [SplitCost::Boxes, SplitCost::Region] {
        for sort_keys in [SortKeys::Centre, SortKeys::CentreMinMax] {
            for axes_per_node in [1, 2] {
                forms.push(BuildOptions {
                    cost,
                    sort_keys,
                    axes_per_node,
                    max_depth,
                });
            }
        }
    }
    forms
}

/// A small mesh with many ties: coordinates on a coarse grid, some axes flat, triangles repeated.
fn random_mesh(random: &mut fastrand::Rng) -> Mesh {
    let steps: [u32; 3] = std::array::from_fn(|_| random.choice([1, 2, 3, 5, 9, 60000]).unwrap());
    let most = random.choice([3, 20, 150]).unwrap();
    let count = random.u32(1..=most);
    let corners = random.usize(1..=1 + count as usize);
    let arithmetic = Arithmetic::new(Format::FP24);
    let vertices: Vec<[f64; 3]> = (0..corners)
        .map(|_| steps.map(|n| arithmetic.round(f64::from(random.u32(0..n)) / 7.0 - 0.5)))
        .collect();
    let mut triangles: Vec<[u32; 3]> = Vec::new();
    for _ in 0..count {
        let again = !triangles.is_empty() && random.u32(0..4) == 0;
        triangles.push(if again {
            triangles[random.usize(..triangles.len())]
        } else {
            std::array::from_fn(|_| random.u32(..corners as u32))
        });
    }
    Mesh {
        vertices,
        triangles,
    }
}

/// The numbers of the triangles below a target, determined only by the image's links.
fn triangles_below(image: &MemoryImage, target: Target) -> Vec<u32> {
    match target {
        Target::Record(record) => vec![image.records[record as usize].number],
        Target::Node(index) => {
            let [left, right] = image.nodes[index as usize].link.children(index);
            let mut below = triangles_below(image, left);
            below.extend(triangles_below(image, right));
            below
        }
    }
}

/// The minimum and maximum coordinate of triangles on an axis.
fn extent(mesh: &Mesh, triangles: &[u32], axis: u8) -> [f64; 2] {
    let coordinates = || {
        (triangles.iter())
            .flat_map(|&t| mesh.triangles[t as usize])
            .map(|v| mesh.vertices[v as usize][axis as usize])
    };
    [
        coordinates().fold(f64::INFINITY, f64::min),
        coordinates().fold(f64::NEG_INFINITY, f64::max),
    ]
}

/// Asserts all properties of the layout for an image of one object at base 0; returns the number of checks.
fn assert_image_is_right(mesh: &Mesh, image: &MemoryImage, options: &BuildOptions) -> usize {
    let count = mesh.triangles.len();
    assert_eq!((image.nodes.len(), image.records.len()), (count, count));
    let root = match image.root.root() {
        Target::Record(record) => {
            assert_eq!((count, record), (1, 0));
            Target::Record(record)
        }
        Target::Node(node) => {
            assert_eq!(node as usize, count - 2, "the root is last");
            Target::Node(node)
        }
    };
    let mut all = triangles_below(image, root);
    for axis in 0..3 {
        let whole = [image.bounds.0[axis], image.bounds.1[axis]];
        assert_eq!(whole, extent(mesh, &all, axis as u8));
    }
    all.sort_unstable();
    assert!(
        all.iter().copied().eq(0..count as u32),
        "every triangle once"
    );
    for record in &image.records {
        assert_eq!(record.vertices, mesh.triangles[record.number as usize]);
    }
    assert_eq!(
        image.nodes[count - 1],
        Node::default(),
        "the last slot is unused"
    );
    for (index, node) in image.nodes[..count - 1].iter().enumerate() {
        let link = node.link;
        let children = link.children(index as u32);
        for child in children {
            if let Target::Node(child) = child {
                assert!((child as usize) < index, "children precede parents");
            }
        }
        if options.axes_per_node == 1 {
            assert_eq!(link.left_axis, link.right_axis);
        }
        let [left, right] = children.map(|child| triangles_below(image, child));
        assert_eq!(node.left, extent(mesh, &left, link.left_axis));
        assert_eq!(node.right, extent(mesh, &right, link.right_axis));
    }
    image.check(options.max_depth).unwrap();
    count
}

#[test]
fn random_meshes_keep_every_rule() {
    let base_seed = dynrt::seed::of_run();
    let mut checks = 0;
    for seed in base_seed..base_seed.saturating_add(400) {
        eprintln!("replay with DYNRT_SEED={seed}");
        let mut random = fastrand::Rng::with_seed(seed);
        let mesh = random_mesh(&mut random);
        let count = mesh.triangles.len();
        let least = count.next_power_of_two().ilog2();
        // The minimum depth, one more, and plenty.
        let max_depth = random.choice([least, least + 1, 32]).unwrap();
        for options in forms(max_depth) {
            let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
            assert_eq!(
                tree,
                build(&mesh.vertices, &mesh.triangles, &options).unwrap()
            );
            let image =
                MemoryImage::new(Format::FP24, &mesh.vertices, &mesh.triangles, &tree).unwrap();
            checks += assert_image_is_right(&mesh, &image, &options);
            assert_eq!(image.depth().unwrap(), tree.depth());
            assert!(tree.depth() <= max_depth);
        }
    }
    assert!(checks > 10_000);
}

#[test]
fn a_refitted_tree_has_the_bounds_of_its_triangles() {
    let seed = 7;
    let mut random = fastrand::Rng::with_seed(seed);
    let mut moved = 0;
    for _ in 0..50 {
        let mut mesh = random_mesh(&mut random);
        let options = BuildOptions::default_for(2, 32);
        let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
        for x in mesh.vertices.iter_mut().flatten() {
            *x = Arithmetic::new(Format::FP24).round(random.f64() * 4.0 - 2.0);
            moved += 1;
        }
        let image = MemoryImage::new(Format::FP24, &mesh.vertices, &mesh.triangles, &tree).unwrap();
        assert_image_is_right(&mesh, &image, &options);
    }
    assert!(moved > 0);
}

#[test]
fn images_survive_packing() {
    let seed = 11;
    let mut random = fastrand::Rng::with_seed(seed);
    let formats = [(7, 16), (3, 2), (10, 23), (8, 23)].map(|(e, f)| Format::new(e, f).unwrap());
    for format in formats {
        let arithmetic = Arithmetic::new(format);
        for _ in 0..20 {
            let mut mesh = random_mesh(&mut random);
            for x in mesh.vertices.iter_mut().flatten() {
                *x = arithmetic.round(*x / 10000.0);
            }
            let options = BuildOptions::default_for(2, 32);
            let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
            let image = MemoryImage::new(format, &mesh.vertices, &mesh.triangles, &tree).unwrap();
            let through_hex = |layout: Record, words: Vec<u32>| {
                let read = layout.words_of_hex(&layout.hex_lines(&words)).unwrap();
                assert_eq!(read, words);
                read
            };
            let nodes = through_hex(Record::node(format), image.node_words());
            let records = through_hex(Record::triangle(), image.record_words());
            let vertices = through_hex(Record::vertex(format), image.vertex_words());
            let read = MemoryImage {
                nodes: MemoryImage::nodes_of_words(format, &nodes),
                records: MemoryImage::records_of_words(&records),
                vertices: MemoryImage::vertices_of_words(format, &vertices),
                ..image.clone()
            };
            assert_eq!(read, image);
        }
    }
}

#[test]
fn an_object_placed_at_a_base_is_the_same_but_for_its_indices() {
    let mut random = fastrand::Rng::with_seed(13);
    for _ in 0..50 {
        let mesh = random_mesh(&mut random);
        let tree = build(&mesh.vertices, &mesh.triangles, &BuildOptions::plain(32)).unwrap();
        let refit = tree.refit(&mesh.vertices, &mesh.triangles);
        let order = layout::default_order(&tree);
        let place = |base, vertex_base| {
            layout::place(&tree, &refit, &mesh.triangles, &order, base, vertex_base).unwrap()
        };
        let (zero, moved) = (place(0, 0), place(1000, 70));
        assert_eq!(moved.root.link, zero.root.link + 1000);
        assert_eq!(moved.nodes.len(), zero.nodes.len());
        for (own, (zero, moved)) in (0..).zip(zero.nodes.iter().zip(&moved.nodes)) {
            if own as usize + 1 == mesh.triangles.len() {
                assert_eq!(zero, moved);
                continue;
            }
            let shifted = zero.link.children(own).map(|child| match child {
                Target::Node(index) => Target::Node(index + 1000),
                Target::Record(index) => Target::Record(index + 1000),
            });
            assert_eq!(moved.link.children(own + 1000), shifted);
        }
        for (zero, moved) in zero.records.iter().zip(&moved.records) {
            assert_eq!(moved.vertices, zero.vertices.map(|v| v + 70));
            assert_eq!(moved.number, zero.number);
        }
    }
}

/// n × n quads in a plane, two triangles each.
fn flat_grid(n: u32, across: [f64; 3], up: [f64; 3]) -> Mesh {
    let mut mesh = Mesh {
        vertices: Vec::new(),
        triangles: Vec::new(),
    };
    for y in 0..=n {
        for x in 0..=n {
            let (x, y) = (f64::from(x), f64::from(y));
            mesh.vertices
                .push(std::array::from_fn(|i| x * across[i] + y * up[i]));
        }
    }
    for y in 0..n {
        for x in 0..n {
            let at = |dx: u32, dy: u32| (y + dy) * (n + 1) + x + dx;
            mesh.triangles.push([at(0, 0), at(1, 0), at(1, 1)]);
            mesh.triangles.push([at(0, 0), at(1, 1), at(0, 1)]);
        }
    }
    mesh
}

#[test]
fn scenes_without_volume_do_not_become_lists() {
    let point = Mesh {
        vertices: vec![[1.0, 2.0, 3.0]; 3],
        triangles: vec![[0, 1, 2]; 10_000],
    };
    let one_triangle = Mesh {
        vertices: vec![[0.0, 0.0, 0.0], [1.0, 0.5, 0.0], [0.0, 1.0, 0.25]],
        triangles: vec![[0, 1, 2]; 10_000],
    };
    let scenes = [
        ("a point", point, 14),
        ("one triangle", one_triangle, 14),
        ("a line", flat_grid(70, [1.0, 0.0, 0.0], [0.0; 3]), 24),
        (
            "an oblique line",
            flat_grid(70, [1.0, 2.0, -1.0], [0.0; 3]),
            24,
        ),
        (
            "a wall",
            flat_grid(70, [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]),
            20,
        ),
        (
            "a slope",
            flat_grid(70, [1.0, 0.0, 0.5], [0.0, 1.0, 0.5]),
            20,
        ),
    ];
    for (name, mesh, most) in scenes {
        for options in forms(60) {
            let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
            let depth = tree.depth();
            assert!(depth <= most, "{name} is {depth} deep with {options:?}");
        }
    }
}

#[test]
fn a_line_is_cut_along_itself() {
    let mut random = fastrand::Rng::with_seed(17);
    for axis in 0..3 {
        let mut along = [0.0; 3];
        along[axis] = 1.0;
        let mut mesh = flat_grid(20, along, [0.0; 3]);
        random.shuffle(&mut mesh.triangles);
        for options in forms(32) {
            let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
            let Child::Inner(root) = tree.root else {
                panic!("800 triangles are no leaf");
            };
            assert_eq!(
                tree.nodes[root as usize].axes, [axis as u8; 2],
                "{options:?}"
            );
            let refit = tree.refit(&mesh.vertices, &mesh.triangles);
            let [left, right] = refit.intervals[root as usize].map(|[lo, hi]| hi - lo);
            assert!(
                left + right <= 21.0,
                "{left} + {right} of 20 with {options:?}"
            );
        }
    }
}

#[test]
fn the_region_cost_falls_where_the_measured_steps_do() {
    let mesh = flat_grid(40, [1.0, 0.0, 0.5], [0.0, 1.0, 0.5]);
    let statistics = |options| {
        let tree = build(&mesh.vertices, &mesh.triangles, &options).unwrap();
        TreeStatistics::new(&tree, &mesh.vertices, &mesh.triangles, Format::FP24)
    };
    let plain = statistics(BuildOptions::plain(32));
    let best = statistics(BuildOptions::default_for(2, 32));
    assert_eq!((plain.triangles, plain.nodes), (3200, 3199));
    assert_eq!(plain.node_bytes, 3199 * 16);
    assert_eq!(plain.record_bytes, 3200 * 16);
    assert_eq!(plain.vertex_bytes, 41 * 41 * 9);
    assert!(best.expected_steps < plain.expected_steps);
}

#[test]
fn what_cannot_be_built_is_said_in_one_line() {
    let vertices = [[0.0; 3], [1.0; 3], [f64::NAN, 0.0, 0.0]];
    let said = |triangles: &[[u32; 3]], max_depth| {
        let error = build(&vertices, triangles, &BuildOptions::plain(max_depth)).unwrap_err();
        error.to_string()
    };
    assert_eq!(said(&[], 32), "the mesh has no triangles");
    assert_eq!(
        said(&[[0, 1, 3]], 32),
        "triangle 0 names vertex 3, but there are 3; correct the mesh"
    );
    assert_eq!(
        said(&[[0, 1, 0], [0, 1, 2]], 32),
        "vertex 2 is not finite; correct the mesh"
    );
    assert_eq!(
        said(&[[0, 1, 0]; 9], 3),
        "9 triangles need a tree of depth 4, but the traversal stack allows 3; simplify the mesh or deepen the stack"
    );
}

#[test]
fn a_damaged_image_is_not_loaded() {
    let mesh = flat_grid(4, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
    let tree = build(&mesh.vertices, &mesh.triangles, &BuildOptions::region(32)).unwrap();
    let image = MemoryImage::new(Format::FP24, &mesh.vertices, &mesh.triangles, &tree).unwrap();
    image.check(tree.depth()).unwrap();
    let root = image.root.link as usize;
    assert!(!image.nodes[root].link.left_leaf && !image.nodes[root].link.right_leaf);
    let said = |damage: fn(&mut MemoryImage, usize)| {
        let mut damaged = image.clone();
        damage(&mut damaged, root);
        let error = damaged.check(32).unwrap_err().to_string();
        assert!(!error.contains('\n'));
        error
    };
    let far = said(|image, root| image.nodes[root].link.link = 1 << 20);
    assert!(far.contains("but there are 32"), "{far}");
    let cycle = said(|image, root| image.nodes[root].link.link = root as u32 - 1);
    assert!(cycle.contains("reached twice"), "{cycle}");
    let missed = said(|image, _| image.root.link -= 1);
    assert!(missed.contains("are not reached"), "{missed}");
    let axis = said(|image, root| image.nodes[root].link.left_axis = 3);
    assert!(axis.contains("axis other than"), "{axis}");
    let vertex = said(|image, _| image.records[5].vertices[1] = 25);
    assert!(vertex.contains("names vertex 25"), "{vertex}");
    let deep = image.check(tree.depth() - 1).unwrap_err().to_string();
    assert!(deep.contains("traversal stack"), "{deep}");
}
