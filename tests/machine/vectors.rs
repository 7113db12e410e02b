//! Golden vectors, checked only by their files: with an independent checker here, and with the Verilog benches in `sim/`.

mod checker;

use crate::support::{full, seed};
use dynrt::bkd::{self, BuildOptions, MemoryImage};
use dynrt::bkd::{LinkWord, Node, Record, TriangleRecord};
use dynrt::config::{Config, TriangleTest};
use dynrt::cosim::unit_skinning::SkinMesh;
use dynrt::float::{Format, plain};
use dynrt::golden::{Caster, EnterEvent, HandOver, Observer, RayTest};
use dynrt::hdl::{Design, Direction};
use dynrt::hw::{self, Plan};
use dynrt::port::Ray;
use dynrt::prove;
use dynrt::scene::animation::MachineScene;
use dynrt::scene::{self, Camera, Frame, ImageSize, MachineMesh, RayPacket};
use dynrt::vectors::{Made, Posed, Request, Summary, pose, write};
use serde_json::{Value, json};
use sha2::{Digest, Sha256};
use std::collections::{BTreeMap, BTreeSet, HashMap};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Different machines, each with a scene and a picture size.
const CASES: [(&str, &str, &str); 3] = [
    ("virtex4-lx160", "builtin:sphere?level=1", "8x6"),
    ("tiny", "builtin:cornell", "6x4"),
    ("dynrt-2006", "builtin:knot?segments=12&sides=3", "8x6"),
];

/// Animated scenes: one of two levels, one with skinning.
const MOVING: [(&str, &str, &str); 2] = [
    ("virtex4-lx160", "builtin:reef?fish=3", "10x6"),
    ("dynrt-2006", "builtin:figure?detail=36", "8x6"),
];

struct Case {
    config: Config,
    spec: &'static str,
    image: MemoryImage,
    skins: Vec<SkinMesh>,
    packets: Vec<RayPacket>,
    frame: Frame,
    camera: Camera,
    log2_scale: i32,
    /// The time within the motion.
    seconds: Option<f64>,
}

impl Case {
    fn new((config, spec, size): (&str, &'static str, &str)) -> Case {
        Case::of(Config::load(config).unwrap(), spec, size)
    }

    fn of(config: Config, spec: &'static str, size: &str) -> Case {
        let scene = scene::load(spec).unwrap();
        let mesh = MachineMesh::new(&scene, config.format()).unwrap();
        let options = BuildOptions::default_for(config.axes_per_node, config.stack_depth);
        let tree = bkd::build(&mesh.vertices, &mesh.triangles, &options).unwrap();
        let image = MemoryImage::new(mesh.format, &mesh.vertices, &mesh.triangles, &tree).unwrap();
        let size: ImageSize = size.parse().unwrap();
        let frame = Frame::new(size, config.rays_per_packet as usize).unwrap();
        let camera = Camera::framing(scene.bounds());
        let packets = frame.primary_rays(&camera, &mesh).unwrap();
        Case {
            config,
            spec,
            image,
            skins: vec![],
            packets,
            frame,
            camera,
            log2_scale: mesh.log2_scale,
            seconds: None,
        }
    }

    /// An animated scene at a time after its start.
    fn moving((config, spec, size): (&str, &'static str, &str)) -> Case {
        let config = Config::load(config).unwrap();
        let scene = scene::load_animated(spec).unwrap();
        let pose_of_scene = scene.pose(scene.clip(None).unwrap(), 0.3).unwrap();
        let poses = [pose_of_scene];
        let extents = scene.extents_of(&poses).unwrap();
        let machine =
            MachineScene::new(&scene, &extents, config.format(), config.skinning_joints).unwrap();
        let Posed { image, skins } =
            pose(&config, &machine, &machine.frame(&poses[0]).unwrap()).unwrap();
        let size: ImageSize = size.parse().unwrap();
        let frame = Frame::new(size, config.rays_per_packet as usize).unwrap();
        let camera = Camera::framing(extents.world);
        let packets = frame
            .rays_in(&camera, config.format(), machine.log2_scale)
            .unwrap();
        Case {
            config,
            spec,
            image,
            skins,
            packets,
            frame,
            camera,
            log2_scale: machine.log2_scale,
            seconds: Some(0.3),
        }
    }

    fn request<'a>(&'a self, out: &'a Path) -> Request<'a> {
        Request {
            config: &self.config,
            scene_name: self.spec,
            image: &self.image,
            skins: &self.skins,
            packets: &self.packets,
            limit: None,
            directed_scenes: true,
            force: false,
            made: Made {
                command: "dynrt vectors",
                frame: self.frame,
                camera: self.camera,
                log2_scale: self.log2_scale,
                motion: self.seconds.map(|seconds| (None, seconds)),
            },
            out,
        }
    }

    fn write(&self, out: &Path) -> Summary {
        write(&self.request(out)).unwrap()
    }

    /// The machine, with or without trace ports.
    fn machine(&self, trace: bool) -> hw::Machine {
        hw::core::emit(&Plan::new(&self.config).unwrap().with_trace(trace)).unwrap()
    }

    fn write_rtl(&self, trace: bool, folder: &Path) {
        fs::create_dir_all(folder).unwrap();
        for (name, text) in self.machine(trace).design.files() {
            fs::write(folder.join(name), text).unwrap();
        }
    }
}

/// A folder of vectors, read only as `docs/vectors.md` defines.
struct Vectors {
    folder: PathBuf,
    manifest: Value,
}

/// A line of a file: bits by names of fields.
struct Line<'a> {
    digits: Vec<u8>,
    fields: &'a HashMap<String, (u32, u32)>,
}

impl Line<'_> {
    fn get(&self, name: &str) -> u64 {
        let (lsb, width) = self.fields[name];
        (0..width).fold(0, |value, bit| {
            let place = lsb + bit;
            let digit = self.digits[self.digits.len() - 1 - (place / 4) as usize];
            value | u64::from(digit >> (place % 4) & 1) << bit
        })
    }

    fn flag(&self, name: &str) -> bool {
        assert_eq!(self.fields[name].1, 1, "{name} is a flag");
        self.get(name) == 1
    }

    fn vector(&self, name: &str) -> [u64; 3] {
        ["x", "y", "z"].map(|axis| self.get(&format!("{name}_{axis}")))
    }
}

impl Vectors {
    fn open(folder: &Path) -> Vectors {
        let manifest = fs::read_to_string(folder.join("manifest.json")).unwrap();
        Vectors {
            folder: folder.to_path_buf(),
            manifest: serde_json::from_str(&manifest).unwrap(),
        }
    }

    fn number(&self, path: &str) -> u64 {
        let value = self.manifest.pointer(path).and_then(Value::as_u64);
        value.unwrap_or_else(|| panic!("the manifest has no number {path}"))
    }

    fn format(&self) -> Format {
        let bits = |name: &str| self.number(&format!("/number_format/{name}")) as u32;
        Format::new(bits("exponent_bits"), bits("fraction_bits")).unwrap()
    }

    fn file(&self, file: &str) -> &Value {
        let files = self.manifest["files"].as_array().unwrap();
        files.iter().find(|f| f["file"] == file).unwrap()
    }

    fn fields(&self, file: &str) -> HashMap<String, (u32, u32)> {
        let layout = self.file(file)["layout"].as_str().unwrap();
        let fields = self.manifest["layouts"][layout]["fields"]
            .as_array()
            .unwrap();
        let part = |field: &Value, name: &str| field[name].as_u64().unwrap() as u32;
        let entry = |field: &Value| {
            let name = field["name"].as_str().unwrap().to_string();
            (name, (part(field, "lsb"), part(field, "width")))
        };
        fields.iter().map(entry).collect()
    }

    /// Calls `check` with every line, checks the number of lines against the manifest, and returns it.
    fn lines<'a>(&self, file: &str, fields: &'a HashMap<String, (u32, u32)>) -> Vec<Line<'a>> {
        let text = fs::read_to_string(self.folder.join(file)).unwrap();
        let layout = self.file(file)["layout"].as_str().unwrap();
        let digits = self.number(&format!("/layouts/{layout}/digits")) as usize;
        let lines: Vec<_> = text
            .lines()
            .map(|line| {
                assert_eq!(line.len(), digits, "{file}: digits of {line}");
                let digit = |c: char| c.to_digit(16).unwrap() as u8;
                Line {
                    digits: line.chars().map(digit).collect(),
                    fields,
                }
            })
            .collect();
        assert_eq!(Some(lines.len() as u64), self.file(file)["lines"].as_u64());
        assert!(!lines.is_empty(), "{file} is empty");
        lines
    }

    /// Recomputes every transaction of a unit; `expect` returns the names of expected fields and their values. Exactly the bits of
    /// the care file must be recomputed and are compared. Returns the number of transactions.
    fn unit(&self, unit: &str, expect: impl Fn(&Line<'_>) -> Vec<(String, u64)>) -> usize {
        let units = self.manifest["units"].as_array().unwrap();
        let described = units.iter().find(|u| u["unit"] == unit).unwrap();
        let name = |role: &str| described[role].as_str();
        let (stimulus, expected) = (name("stimulus").unwrap(), name("expected").unwrap());
        let fields = [self.fields(stimulus), self.fields(expected)];
        let stimuli = self.lines(stimulus, &fields[0]);
        let results = self.lines(expected, &fields[1]);
        let cares = name("care").map(|care| self.lines(care, &fields[1]));
        assert_eq!(stimuli.len(), results.len());
        for (number, (line, result)) in stimuli.iter().zip(&results).enumerate() {
            let computed: HashMap<_, _> = expect(line).into_iter().collect();
            for (field, (_, width)) in &fields[1] {
                let all = u64::MAX >> (64 - width);
                let care = cares.as_ref().map_or(all, |cares| cares[number].get(field));
                assert!(care == 0 || care == all, "a field is compared whole");
                match (computed.get(field), care) {
                    (_, 0) => assert_eq!(result.get(field), 0, "what is not compared is 0"),
                    (Some(value), _) => assert_eq!(
                        *value,
                        result.get(field),
                        "{expected} line {}: {field}",
                        number + 1
                    ),
                    (None, _) => panic!(
                        "{expected} line {}: {field} is compared, but of no meaning",
                        number + 1
                    ),
                }
            }
        }
        stimuli.len()
    }
}

/// The arithmetic of `docs/arithmetic.md`, on bits.
#[derive(Clone, Copy)]
struct Machine {
    f: Format,
    watertight: bool,
    /// A rule of the triangle test that is left out.
    without: Option<Rule>,
}

/// A rule of the triangle test.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Rule {
    /// t < ∞.
    Finite,
    /// lo_i = hi_i on two axes.
    FlatBox,
}

/// A ray with the fields that traversal and triangle tests read.
struct Setup {
    origin: [u64; 3],
    direction: [u64; 3],
    reciprocal: [u64; 3],
    signs: u64,
    tmin: u64,
    tmax: u64,
    kz: usize,
    shear: [u64; 3],
    valid: bool,
    window: [u64; 2],
}

impl Machine {
    fn infinity(self, negative: bool) -> u64 {
        self.f.infinity() | if negative { self.f.sign_bit() } else { 0 }
    }

    fn is_zero(self, x: u64) -> bool {
        plain::equal(self.f, x, 0)
    }

    fn clip(self, [near, far]: [u64; 2], [lo, hi]: [u64; 2], o: u64, r: u64, s: bool) -> [u64; 2] {
        let f = self.f;
        let (first, last) = if s { (hi, lo) } else { (lo, hi) };
        let distance = |plane| plain::mul(f, plain::sub(f, plane, o), r);
        [
            plain::max(f, near, plain::step(f, distance(first), -3)),
            plain::min(f, far, plain::step(f, distance(last), 3)),
        ]
    }

    fn clip_box(self, mut interval: [u64; 2], lo: [u64; 3], hi: [u64; 3], ray: &Setup) -> [u64; 2] {
        for i in 0..3 {
            let sign = ray.signs >> i & 1 == 1;
            interval = self.clip(
                interval,
                [lo[i], hi[i]],
                ray.origin[i],
                ray.reciprocal[i],
                sign,
            );
        }
        interval
    }

    fn set_up(self, line: &Line<'_>) -> Setup {
        let (origin, direction) = (line.vector("origin"), line.vector("direction"));
        let limit = |name| match line.get(name) {
            x if self.is_zero(x) => 0,
            x => x,
        };
        let (tmin, tmax) = (limit("tmin"), limit("tmax"));
        let setup = self.prepare(origin, direction, [tmin, tmax]);
        Setup {
            valid: setup.valid && line.flag("active"),
            ..setup
        }
    }

    fn prepare(self, origin: [u64; 3], direction: [u64; 3], [tmin, tmax]: [u64; 2]) -> Setup {
        let f = self.f;
        let reciprocal = direction.map(|d| plain::reciprocal(f, d));
        let mut numbers = origin.iter().chain(&direction).chain([&tmin, &tmax]);
        let valid = !numbers.any(|&x| f.is_nan(x))
            && plain::less_equal(f, 0, tmin)
            && plain::less_equal(f, tmin, tmax);
        let size = |i: usize| direction[i] & !f.sign_bit();
        let kz = (1..3).fold(0, |kz, i| {
            if plain::less(f, size(kz), size(i)) {
                i
            } else {
                kz
            }
        });
        let rkz = reciprocal[kz];
        let shear = |i: usize| plain::mul(f, direction[(kz + i) % 3], rkz);
        Setup {
            origin,
            direction,
            reciprocal,
            signs: (0..3).fold(0, |s, i| {
                s | u64::from(direction[i] & f.sign_bit() != 0) << i
            }),
            tmin,
            tmax,
            kz,
            shear: [shear(1), shear(2), rkz],
            valid,
            window: [self.infinity(true), self.infinity(false)],
        }
    }

    /// The ray in a line of `triangle_test_stimulus.hex`.
    fn given(self, line: &Line<'_>) -> Setup {
        let watertight = self.watertight;
        Setup {
            origin: line.vector("origin"),
            direction: if watertight {
                [0; 3]
            } else {
                line.vector("direction")
            },
            reciprocal: line.vector("reciprocal"),
            signs: line.get("signs"),
            tmin: line.get("tmin"),
            tmax: line.get("tmax"),
            kz: if watertight {
                line.get("kz") as usize
            } else {
                0
            },
            shear: if watertight {
                line.vector("shear")
            } else {
                [0; 3]
            },
            valid: true,
            window: [line.get("window_near"), line.get("window_far")],
        }
    }

    /// The rounded sum of the products of a point or a direction with the columns of a matrix.
    fn linear(self, columns: &[[u64; 3]; 4], i: usize, v: [u64; 3]) -> u64 {
        let f = self.f;
        let product = |k: usize| plain::mul(f, columns[k][i], v[k]);
        plain::add(f, plain::add(f, product(0), product(1)), product(2))
    }

    fn point(self, columns: &[[u64; 3]; 4], v: [u64; 3]) -> [u64; 3] {
        [0, 1, 2].map(|i| plain::add(self.f, self.linear(columns, i, v), columns[3][i]))
    }

    fn direction(self, columns: &[[u64; 3]; 4], v: [u64; 3]) -> [u64; 3] {
        [0, 1, 2].map(|i| self.linear(columns, i, v))
    }

    /// The ray in an instance's object space, if it enters.
    fn enter(self, instance: &Placed, ray: &Setup) -> Option<Setup> {
        let f = self.f;
        let everywhere = [self.infinity(true), self.infinity(false)];
        let window = self.clip_box(everywhere, instance.lo, instance.hi, ray);
        let moved = self.prepare(
            self.point(&instance.columns, ray.origin),
            self.direction(&instance.columns, ray.direction),
            [ray.tmin, ray.tmax],
        );
        let near = plain::max(f, ray.tmin, window[0]);
        let far = plain::min(f, ray.tmax, window[1]);
        let enters = moved.valid && plain::less_equal(f, near, far);
        enters.then_some(Setup { window, ..moved })
    }

    fn difference(self, a: [u64; 3], b: [u64; 3]) -> [u64; 3] {
        [0, 1, 2].map(|i| plain::sub(self.f, a[i], b[i]))
    }

    /// a·b − c·d, rounded three times.
    fn products(self, a: u64, b: u64, c: u64, d: u64) -> u64 {
        let f = self.f;
        plain::sub(f, plain::mul(f, a, b), plain::mul(f, c, d))
    }

    fn cross(self, a: [u64; 3], b: [u64; 3]) -> [u64; 3] {
        [(1, 2), (2, 0), (0, 1)].map(|(j, k)| self.products(a[j], b[k], a[k], b[j]))
    }

    fn dot(self, a: [u64; 3], b: [u64; 3]) -> u64 {
        let f = self.f;
        let product = |i: usize| plain::mul(f, a[i], b[i]);
        plain::add(f, plain::add(f, product(0), product(1)), product(2))
    }

    /// t, u, v of a hit.
    fn test(self, v: [[u64; 3]; 3], ray: &Setup) -> Option<[u64; 3]> {
        let f = self.f;
        let lo = [0, 1, 2].map(|i| plain::min(f, plain::min(f, v[0][i], v[1][i]), v[2][i]));
        let hi = [0, 1, 2].map(|i| plain::max(f, plain::max(f, v[0][i], v[1][i]), v[2][i]));
        let [near, far] = self.clip_box(ray.window, lo, hi, ray);
        let same = |a: [u64; 3], b: [u64; 3]| (0..3).all(|i| plain::equal(f, a[i], b[i]));
        let flat = (0..3).filter(|&i| plain::equal(f, lo[i], hi[i])).count();
        let flat = flat >= 2 && self.without != Some(Rule::FlatBox);
        let degenerate = same(v[0], v[1]) || same(v[1], v[2]) || same(v[2], v[0]) || flat;
        let [mut t, u, w] = if self.watertight {
            self.watertight_test(v, ray)?
        } else {
            self.moller_trumbore(v, ray)?
        };
        if degenerate || plain::less(f, far, near) || f.is_nan(t) {
            return None;
        }
        if plain::less(f, t, near) {
            t = near;
        }
        if plain::less(f, far, t) {
            t = far;
        }
        let within = plain::less_equal(f, ray.tmin, t) && plain::less_equal(f, t, ray.tmax);
        let finite = plain::less(f, t, f.infinity()) || self.without == Some(Rule::Finite);
        (within && finite).then_some([t, u, w])
    }

    fn moller_trumbore(self, v: [[u64; 3]; 3], ray: &Setup) -> Option<[u64; 3]> {
        let f = self.f;
        let (e1, e2) = (self.difference(v[1], v[0]), self.difference(v[2], v[0]));
        let c = self.difference(ray.origin, v[0]);
        let p = self.cross(ray.direction, e2);
        let det = self.dot(e1, p);
        let i = plain::reciprocal(f, det);
        let q = self.cross(c, e1);
        let u = plain::mul(f, self.dot(c, p), i);
        let w = plain::mul(f, self.dot(ray.direction, q), i);
        let t = plain::mul(f, self.dot(e2, q), i);
        let positive = |x| plain::less_equal(f, 0, x);
        let below = plain::less_equal(f, plain::add(f, u, w), f.one());
        (positive(u) && positive(w) && below && !self.is_zero(det)).then_some([t, u, w])
    }

    fn watertight_test(self, v: [[u64; 3]; 3], ray: &Setup) -> Option<[u64; 3]> {
        let f = self.f;
        let [sx, sy, sz] = ray.shear;
        let [a, b, c] = v.map(|vertex| {
            let p = self.difference(vertex, ray.origin);
            let (kx, ky, kz) = ((ray.kz + 1) % 3, (ray.kz + 2) % 3, ray.kz);
            let shift = |k: usize, s| plain::sub(f, p[k], plain::mul(f, s, p[kz]));
            [shift(kx, sx), shift(ky, sy), p[kz]]
        });
        let edges = [(c, b), (a, c), (b, a)].map(|(p, q)| self.products(p[0], q[1], p[1], q[0]));
        let negative = edges.iter().any(|&e| plain::less(f, e, 0));
        let positive = edges.iter().any(|&e| plain::less(f, 0, e));
        let [eu, ev, ew] = edges;
        let det = plain::add(f, plain::add(f, eu, ev), ew);
        if negative && positive || self.is_zero(det) {
            return None;
        }
        let i = plain::reciprocal(f, det);
        let scaled = self.dot(edges, [a[2], b[2], c[2]]);
        let t = plain::mul(f, plain::mul(f, scaled, i), sz);
        Some([t, plain::mul(f, ev, i), plain::mul(f, ew, i)])
    }
}

/// An instance, as read from memory.
struct Placed {
    columns: [[u64; 3]; 4],
    lo: [u64; 3],
    hi: [u64; 3],
    number: u64,
    /// The root of its object.
    root: u64,
}

/// By root: numbers and vertices of its triangles.
type Triangles = Vec<(u64, [[u64; 3]; 3])>;

/// A scene in the files.
struct Place {
    root: u64,
    lo: [u64; 3],
    hi: [u64; 3],
    /// Empty in a scene of one level, whose only object is in the world.
    instances: Vec<Placed>,
    objects: HashMap<u64, Triangles>,
}

impl Place {
    /// Counts in `reached` how often each record is reached.
    fn read(
        registers: &Line<'_>,
        (nodes, records): (&[Line<'_>], &[Line<'_>]),
        vector: &dyn Fn(u64) -> [u64; 3],
        reached: &mut [u32],
    ) -> Place {
        let root = registers.get("root");
        let mut instances = vec![];
        let mut roots = BTreeSet::from([root]);
        if root >> 27 & 1 == 1 {
            roots.clear();
            for record in records_below(nodes, root) {
                reached[record] += 1;
                let record = &records[record];
                let of = |k| vector(record.get("v0") + k);
                assert_eq!(record.get("v2"), 0);
                roots.insert(record.get("v1"));
                instances.push(Placed {
                    columns: [0, 1, 2, 3].map(of),
                    lo: of(4),
                    hi: of(5),
                    number: record.get("number"),
                    root: record.get("v1"),
                });
            }
            let numbers: BTreeSet<_> = instances.iter().map(|placed| placed.number).collect();
            assert!(numbers.into_iter().eq(0..instances.len() as u64));
        }
        let mut objects: HashMap<u64, Triangles> = HashMap::new();
        for root in roots {
            let mut triangles = vec![];
            for record in records_below(nodes, root) {
                reached[record] += 1;
                let record = &records[record];
                let corners = ["v0", "v1", "v2"].map(|name| vector(record.get(name)));
                triangles.push((record.get("number"), corners));
            }
            objects.insert(root, triangles);
        }
        Place {
            root,
            lo: registers.vector("lo"),
            hi: registers.vector("hi"),
            instances,
            objects,
        }
    }

    /// Checks that the box is that of all triangles, or of all instances' boxes.
    fn check_bounds(&self, f: Format) {
        let corners: Vec<[u64; 3]> = match self.instances.is_empty() {
            true => self.objects[&self.root]
                .iter()
                .flat_map(|(_, v)| *v)
                .collect(),
            false => self.instances.iter().flat_map(|p| [p.lo, p.hi]).collect(),
        };
        for i in 0..3 {
            let mut corners = corners.iter().map(|corner| corner[i]);
            let first = corners.next().unwrap();
            let bounds = corners.fold([first; 2], |[least, greatest], x| {
                [plain::min(f, least, x), plain::max(f, greatest, x)]
            });
            assert_eq!(bounds, [self.lo[i], self.hi[i]]);
        }
    }
}

/// The records below a root.
fn records_below(nodes: &[Line<'_>], root: u64) -> Vec<usize> {
    let mut records = vec![];
    let mut open = vec![(root >> 26 & 1 == 1, (root & 0x3ff_ffff) as usize)];
    while let Some((leaf, index)) = open.pop() {
        if leaf {
            records.push(index);
            continue;
        }
        let node = &nodes[index];
        let link = node.get("link") as usize;
        open.extend(match (node.flag("left_leaf"), node.flag("right_leaf")) {
            (false, false) => [(false, link), (false, link + 1)],
            (true, false) => [(true, index), (false, link)],
            (false, true) => [(false, link), (true, index)],
            (true, true) => [(true, index), (true, link)],
        });
    }
    records
}

fn named<const N: usize>(name: &str, values: [u64; N]) -> Vec<(String, u64)> {
    let axes = ["x", "y", "z"].iter().zip(values);
    axes.map(|(axis, value)| (format!("{name}_{axis}"), value))
        .collect()
}

/// Recomputes everything in a folder of vectors.
fn check(folder: &Path, summary: &Summary) {
    let vectors = Vectors::open(folder);
    assert_eq!(vectors.number("/dynrt_vectors"), 3);
    let f = vectors.format();
    let machine = Machine {
        f,
        watertight: vectors.manifest["triangle_test"] == "watertight",
        without: None,
    };
    let rays = vectors.number("/rays_per_packet") as usize;

    // The arithmetic units.
    let binary = |unit: &str, operation: fn(Format, u64, u64) -> u64| {
        vectors.unit(unit, |line| {
            vec![("y".into(), operation(f, line.get("a"), line.get("b")))]
        })
    };
    for (unit, operation) in [
        ("fp_add", plain::add as fn(Format, u64, u64) -> u64),
        ("fp_sub", plain::sub),
        ("fp_mul", plain::mul),
    ] {
        assert!(binary(unit, operation) > 8000);
    }
    let reciprocals = vectors.unit("fp_reciprocal", |line| {
        vec![("y".into(), plain::reciprocal(f, line.get("a")))]
    });
    assert!(reciprocals > 2000);

    // The memory images: every record is reached once, and the box is that of all triangles.
    let scene_fields = vectors.fields("scene.hex");
    let registers = vectors.lines("scene.hex", &scene_fields);
    let (lo, hi) = (registers[0].vector("lo"), registers[0].vector("hi"));
    let [node_fields, record_fields, vertex_fields] =
        ["nodes.hex", "records.hex", "vertices.hex"].map(|file| vectors.fields(file));
    let nodes = vectors.lines("nodes.hex", &node_fields);
    let records = vectors.lines("records.hex", &record_fields);
    let vertices = vectors.lines("vertices.hex", &vertex_fields);
    assert_eq!(nodes.len(), records.len());
    let vector = |index: u64| ["x", "y", "z"].map(|axis| vertices[index as usize].get(axis));
    let mut reached = vec![0; records.len()];
    let described = vectors.manifest["scenes"].as_array().unwrap();
    assert_eq!(described.len(), registers.len());
    let mut places: Vec<Place> = vec![];
    for (scene, described) in registers.iter().zip(described) {
        let place = Place::read(scene, (&nodes, &records), &vector, &mut reached);
        let of = |name: &str| described[name].as_u64().unwrap();
        assert_eq!(of("instances"), place.instances.len() as u64);
        assert_eq!(of("levels"), 1 + u64::from(!place.instances.is_empty()));
        let triangles: usize = place.objects.values().map(Vec::len).sum();
        assert_eq!(of("triangles"), triangles as u64);
        let slots = of("first_record")..of("first_record") + of("records");
        assert_eq!(of("records"), of("triangles") + of("instances"));
        assert!((slots.start..slots.end).all(|slot| reached[slot as usize] == 1));
        place.check_bounds(f);
        places.push(place);
    }
    assert!(reached.iter().all(|&count| count == 1), "{reached:?}");
    assert_eq!(
        vectors.number("/instances"),
        places[0].instances.len() as u64
    );
    assert_eq!(
        vectors.number("/levels"),
        described[0]["levels"].as_u64().unwrap()
    );

    // Ray setup.
    let setups = vectors.unit("ray_setup", |line| {
        let ray = machine.set_up(line);
        let [near, far] = machine.clip_box([ray.tmin, ray.tmax], lo, hi, &ray);
        let enters = ray.valid && plain::less_equal(f, near, far);
        let mut fields: Vec<(String, u64)> = vec![
            ("enters".into(), u64::from(enters)),
            ("tmin".into(), ray.tmin),
            ("tmax".into(), ray.tmax),
            ("any_hit".into(), line.get("any_hit")),
            ("signs".into(), ray.signs),
        ];
        fields.extend(named("origin", ray.origin));
        fields.extend(named("reciprocal", ray.reciprocal));
        if enters {
            fields.extend([("near".into(), near), ("far".into(), far)]);
        }
        if !machine.watertight {
            fields.extend(named("direction", ray.direction));
        } else if ray.valid {
            fields.push(("kz".into(), ray.kz as u64));
            fields.extend(named("shear", ray.shear));
        }
        fields
    });
    assert!(setups > 500);

    // Packet steps.
    let steps = vectors.unit("packet_step", |line| step(machine, rays, line));
    assert!(steps as u64 > summary.steps && summary.steps > 0);

    // Triangle tests.
    let tests = vectors.unit("triangle_test", |line| {
        let ray = machine.given(line);
        let v = ["v0", "v1", "v2"].map(|vertex| line.vector(vertex));
        let mut fields = vec![("hit".to_string(), 0)];
        if let Some(values) = machine.test(v, &ray) {
            fields[0].1 = 1;
            let names = ["t", "u", "v"].map(String::from);
            fields.extend(names.into_iter().zip(values));
        }
        fields
    });
    assert!(tests as u64 > summary.tests && summary.tests > 0);

    // Whole rays, by brute force.
    let fields = ["raycast_rays.hex", "raycast_hits.hex"].map(|file| vectors.fields(file));
    let lines = vectors.lines("raycast_rays.hex", &fields[0]);
    let hits = vectors.lines("raycast_hits.hex", &fields[1]);
    assert_eq!(
        (lines.len() as u64, hits.len()),
        (summary.rays, lines.len())
    );
    let packet_fields = vectors.fields("raycast_packets.hex");
    let packets = vectors.lines("raycast_packets.hex", &packet_fields);
    let mut counts = [0; 3];
    let none = u64::from(u32::MAX);
    for (number, (line, hit)) in lines.iter().zip(&hits).enumerate() {
        let ray = machine.set_up(line);
        let Place {
            root,
            lo,
            hi,
            instances,
            objects,
        } = &places[packets[number / rays].get("scene") as usize];
        let mut closest = [f.infinity(), 0, 0, none, none];
        let [near, far] = machine.clip_box([ray.tmin, ray.tmax], *lo, *hi, &ray);
        if ray.valid && plain::less_equal(f, near, far) {
            let mut test = |ray: &Setup, instance: u64, root: u64| {
                for (triangle, v) in &objects[&root] {
                    let Some([t, u, w]) = machine.test(*v, ray) else {
                        continue;
                    };
                    if line.flag("any_hit") {
                        closest = [ray.tmin, 0, 0, none, none];
                    } else if plain::less(f, t, closest[0])
                        || plain::equal(f, t, closest[0])
                            && (instance, *triangle) < (closest[3], closest[4])
                    {
                        closest = [t, u, w, instance, *triangle];
                    }
                }
            };
            if instances.is_empty() {
                test(&ray, 0, *root);
            }
            for placed in instances {
                if let Some(moved) = machine.enter(placed, &ray) {
                    test(&moved, placed.number, placed.root);
                }
            }
        }
        let given = ["t", "u", "v", "instance", "triangle"].map(|name| hit.get(name));
        assert_eq!(given, closest, "raycast_hits.hex line {}", number + 1);
        assert_eq!(hit.get("tag"), line.get("tag"));
        let tags = 1 << vectors.number("/tag_bits");
        assert_eq!(hit.get("tag"), (number / rays) as u64 % tags);
        counts[match closest[0] {
            _ if line.flag("any_hit") && closest[0] != f.infinity() => 0,
            t if t != f.infinity() => 1,
            _ => 2,
        }] += 1;
    }
    assert!(
        counts.iter().all(|&count| count > 0),
        "hits of any-hit rays, hits, misses: {counts:?}"
    );

    // The parts of the packets in the units' files are consecutive.
    let parts = ["step", "test", "transform"];
    let mut next = [0; 3];
    for packet in &packets {
        for (next, part) in next.iter_mut().zip(parts) {
            assert_eq!(packet.get(&format!("first_{part}")), *next);
            *next += packet.get(&format!("{part}s"));
        }
    }
    assert_eq!(next, [summary.steps, summary.tests, summary.transforms]);

    // Ray transformations of the packet's rays, with the instance's vectors in memory.
    if places.iter().any(|place| !place.instances.is_empty()) {
        let transforms = vectors.unit("ray_transform", |line| {
            let record = &records[line.get("record") as usize];
            let of = |k| vector(record.get("v0") + k);
            let columns = [0, 1, 2, 3].map(of);
            let given = ["cx", "cy", "cz", "cw", "lo", "hi"].map(|name| line.vector(name));
            let [cx, cy, cz, cw] = columns;
            assert_eq!(given, [cx, cy, cz, cw, of(4), of(5)]);
            let ray = machine.prepare(line.vector("origin"), line.vector("direction"), [0, 0]);
            assert_eq!(
                (ray.reciprocal, ray.signs),
                (line.vector("reciprocal"), line.get("signs"))
            );
            let everywhere = [machine.infinity(true), machine.infinity(false)];
            let [near, far] = machine.clip_box(everywhere, of(4), of(5), &ray);
            let mut fields = named("origin", machine.point(&columns, ray.origin));
            fields.extend(named(
                "direction",
                machine.direction(&columns, ray.direction),
            ));
            fields.extend([("near".into(), near), ("far".into(), far)]);
            fields
        });
        assert_eq!(transforms as u64, summary.transforms);
        assert!(transforms > 0);
        let fields = vectors.fields("ray_transform_stimulus.hex");
        let transforms = vectors.lines("ray_transform_stimulus.hex", &fields);
        for (number, packet) in packets.iter().enumerate() {
            let first = packet.get("first_transform") as usize;
            for line in &transforms[first..][..packet.get("transforms") as usize] {
                let ray = &lines[number * rays + line.get("slot") as usize];
                for name in ["origin", "direction"] {
                    assert_eq!(line.vector(name), ray.vector(name));
                }
            }
        }
    }
    check_files(&vectors, f);
    check_steps(&vectors, rays);
    let updates = check_updates(&vectors, f);
    assert_eq!(updates, [summary.updates, summary.nodes_written]);
    let skins = check_skins(&vectors, machine);
    assert_eq!(skins, [summary.skins, summary.vertices_skinned]);
    assert_eq!(packets.len() as u64, summary.packets);
    let files = fs::read_dir(folder).unwrap().count();
    assert_eq!(files, summary.files);
}

/// Checks the manifest's entries of files: checksums, parts, canonical numbers.
fn check_files(vectors: &Vectors, f: Format) {
    for file in vectors.manifest["files"].as_array().unwrap() {
        let name = file["file"].as_str().unwrap();
        let text = fs::read_to_string(vectors.folder.join(name)).unwrap();
        let sum: String = (Sha256::digest(&text).iter())
            .map(|byte| format!("{byte:02x}"))
            .collect();
        assert_eq!(file["sha256"], sum.as_str(), "{name}");
        let lines = text.lines().count() as u64;
        assert_eq!(file["lines"], lines, "{name}");
        let mut next = 0;
        for part in file["parts"].as_array().unwrap() {
            assert_eq!(part["first"], next, "{name}");
            assert!(!part["label"].as_str().unwrap().is_empty());
            next += part["lines"].as_u64().unwrap();
        }
        assert_eq!(next, lines, "{name}: its parts are the whole file");
        for key in ["file", "unit", "role", "lines", "layout", "parts", "sha256"] {
            assert!(file.get(key).is_some(), "{name}: {key}");
        }
        let Some(layout) = file["layout"].as_str() else {
            assert_eq!(name, "vectors.vh");
            continue;
        };
        if name.starts_with("fp_") || name.contains("_care") || name == "update_program.hex" {
            continue;
        }
        // −0 occurs only in rays, and in the results of ray setup that pass them on.
        let layout = vectors.manifest["layouts"][layout]["fields"]
            .as_array()
            .unwrap();
        let fields = vectors.fields(name);
        for (number, line) in vectors.lines(name, &fields).iter().enumerate() {
            for field in layout.iter().filter(|field| field["kind"] == "number") {
                let what = field["name"].as_str().unwrap();
                let value = line.get(what);
                let place = format!("{name} line {}: {what} is {value:x}", number + 1);
                assert_eq!(value, f.to_bits(f.to_f64(value)), "{place}");
                let of_ray = ["origin_", "direction_", "tmin", "tmax"];
                let may_be_negative = ["raycast_rays.hex", "ray_setup_stimulus.hex"]
                    .contains(&name)
                    || !["nodes.hex", "raycast_hits.hex"].contains(&name)
                        && of_ray[..2].iter().any(|prefix| what.contains(prefix));
                assert!(
                    value != f.sign_bit() || may_be_negative,
                    "{place}, which is -0"
                );
            }
        }
    }
}

/// Checks that indices are within the machine's addresses, and that rays outside the mask are not compared.
fn check_steps(vectors: &Vectors, rays: usize) {
    let f = vectors.format();
    let most = 1 << vectors.number("/machine/address_bits");
    let file = "packet_step_stimulus.hex";
    let fields = vectors.fields(file);
    let mut outside = 0;
    for line in vectors.lines(file, &fields) {
        assert!(line.get("node") < most && line.get("link") < most - 1);
        for k in (0..rays).filter(|k| line.get("mask") >> k & 1 == 0) {
            outside += 1;
            for (name, _) in fields
                .iter()
                .filter(|(name, _)| name.starts_with(&format!("ray{k}_")))
            {
                let due = if name.ends_with("_far") {
                    f.infinity()
                } else {
                    0
                };
                assert_eq!(line.get(name), due, "{name}");
            }
        }
    }
    assert!(outside > 0 || rays == 1);
}

/// Runs every update program on the files, as `docs/update.md` defines. Returns the numbers of updates and of nodes written.
fn check_updates(vectors: &Vectors, f: Format) -> [u64; 2] {
    let files = [
        "update_program.hex",
        "update_vertices.hex",
        "update_nodes_before.hex",
        "update_commands.hex",
        "update_node_writes.hex",
        "update_nodes_after.hex",
        "update_boxes.hex",
    ];
    let fields = files.map(|file| vectors.fields(file));
    let lines: Vec<_> = files
        .iter()
        .zip(&fields)
        .map(|(file, fields)| vectors.lines(file, fields))
        .collect();
    let [program, vertices, before, commands, writes, after, boxes] = &lines[..] else {
        unreachable!()
    };
    let code: Vec<u8> = program
        .iter()
        .flat_map(|row| {
            ["low", "high"]
                .map(|half| row.get(half).to_le_bytes())
                .concat()
        })
        .collect();
    assert_eq!(before.len(), after.len());
    let mut written: Vec<Option<usize>> = vec![None; before.len()];
    let mut boxes_written = BTreeSet::new();
    let (mut next_write, mut instructions, mut moved) = (0, 0, 0);
    let infinity = [f.infinity() | f.sign_bit(), f.infinity()];
    type Region = [[u64; 2]; 3];
    let grow = |region: &mut Region, i: usize, lo: u64, hi: u64| {
        region[i] = [
            plain::min(f, region[i][0], lo),
            plain::max(f, region[i][1], hi),
        ];
    };
    for (number, command) in commands.iter().enumerate() {
        let of = |name: &str| command.get(name) as usize;
        assert_eq!(of("first_write"), next_write, "update {number}");
        let code = &code[16 * of("program")..][..16 * of("rows")];
        let (mut at, mut count) = (0, 0);
        let mut v: [Option<[u64; 3]>; 64] = [None; 64];
        let mut b: [Option<Region>; 64] = [None; 64];
        let (mut next_vertex, mut next_node) = (of("vertex_base"), of("node_base"));
        let (mut last, mut free, mut fresh) = (0, vec![], 0);
        // For each register, the index of its vertex; and the indices of each leaf.
        let (mut held, mut leaves) = ([0; 64], vec![]);
        loop {
            let word = (0..5).rev().fold(0u64, |word, k| {
                word << 8 | u64::from(code.get(at + k).copied().unwrap_or(0))
            });
            let six = |lsb: u32| (word >> lsb & 63) as usize;
            count += 1;
            let vertex = |index: usize| Some(["x", "y", "z"].map(|axis| vertices[index].get(axis)));
            match (word & 3, word >> 2 & 3, word >> 4 & 15) {
                (3, _, _) => {
                    last = six(2);
                    v[last] = vertex(next_vertex);
                    held[last] = next_vertex as u64;
                    next_vertex += 1;
                    at += 1;
                }
                (2, 3, 2) => {
                    last = six(8);
                    let index = of("vertex_base") + (word >> 14 & 0x3ff_ffff) as usize;
                    v[last] = vertex(index);
                    held[last] = index as u64;
                    at += 5;
                }
                (kind @ (0 | 1), 3, _) => {
                    let third = if kind == 0 { six(16) } else { last };
                    leaves.push(
                        [six(4), six(10), third]
                            .map(|register| held[register])
                            .into(),
                    );
                    let mut region = [[infinity[1], infinity[0]]; 3];
                    for register in [six(4), six(10), third] {
                        let corner = v[register].expect("loaded before it is used");
                        for (i, x) in corner.into_iter().enumerate() {
                            grow(&mut region, i, x, x);
                        }
                    }
                    let register = free.pop().unwrap_or_else(|| {
                        fresh += 1;
                        fresh - 1
                    });
                    b[register] = Some(region);
                    at += if kind == 0 { 3 } else { 2 };
                }
                (2, 3, 0) => at += 1,
                (2, 3, 1) => {
                    let region = b[six(8)].expect("a box");
                    let index = of("box_index");
                    assert!(boxes_written.insert(index), "each box is written once");
                    let corners = ["lo", "hi"].map(|end| boxes[index].vector(end));
                    let expected = [0, 1].map(|end| region.map(|interval| interval[end]));
                    assert_eq!(corners, expected, "update_boxes.hex line {}", index + 1);
                    at += 2;
                    break;
                }
                (2, 3, _) => panic!("no instruction"),
                (left_axis, right_axis, _) => {
                    let (left, right) = (six(4), six(10));
                    let regions = [left, right].map(|register| b[register].expect("a box"));
                    let [[left_lo, left_hi], [right_lo, right_hi]] = [
                        regions[0][left_axis as usize],
                        regions[1][right_axis as usize],
                    ];
                    let line = &writes[next_write];
                    let given = ["node", "mask", "left_lo", "left_hi", "right_lo", "right_hi"]
                        .map(|name| line.get(name));
                    let expected = [
                        next_node as u64,
                        0b01111,
                        left_lo,
                        left_hi,
                        right_lo,
                        right_hi,
                    ];
                    assert_eq!(
                        given,
                        expected,
                        "update_node_writes.hex line {}",
                        next_write + 1
                    );
                    // The axes are those of the link word.
                    let node = &before[next_node];
                    let axes = [node.get("left_axis"), node.get("right_axis")];
                    assert_eq!(axes, [left_axis, right_axis]);
                    assert_eq!(written[next_node], None, "a node is written once");
                    written[next_node] = Some(next_write);
                    let mut merged = regions[0];
                    for (i, [lo, hi]) in regions[1].into_iter().enumerate() {
                        grow(&mut merged, i, lo, hi);
                    }
                    (b[left], b[right]) = (Some(merged), None);
                    free.push(right);
                    (next_node, next_write, at) = (next_node + 1, next_write + 1, at + 2);
                }
            }
        }
        check_update_records(vectors, before, command, &leaves);
        assert!(at.div_ceil(16) == of("rows") && code[at..].iter().all(|&byte| byte == 0));
        assert_eq!(of("instructions"), count);
        assert_eq!(of("writes"), next_write - of("first_write"));
        instructions += count as u64;
    }
    for (index, (node, after)) in before.iter().zip(after).enumerate() {
        for name in node.fields.keys() {
            let due = match written[index] {
                Some(line) if name.ends_with("_lo") || name.ends_with("_hi") => {
                    writes[line].get(name)
                }
                _ => node.get(name),
            };
            assert_eq!(
                after.get(name),
                due,
                "update_nodes_after.hex line {}",
                index + 1
            );
            moved += u64::from(due != node.get(name));
        }
    }
    // The vertices have moved, and the fillers between the objects are unchanged.
    assert!(moved > 0);
    assert!(written.iter().filter(|line| line.is_none()).count() > commands.len());
    assert_eq!(next_write, writes.len());
    assert_eq!(instructions, vectors.number("/update_instructions"));
    assert_eq!(boxes_written.len(), boxes.len());
    [commands.len() as u64, next_write as u64]
}

/// Checks the records of updated objects: a leaf of the program has its record's vertices. Also checks the fillers between the objects.
fn check_update_records(
    vectors: &Vectors,
    nodes: &[Line<'_>],
    command: &Line<'_>,
    leaves: &[BTreeSet<u64>],
) {
    let fields = vectors.fields("update_records.hex");
    let records = vectors.lines("update_records.hex", &fields);
    assert_eq!(nodes.len(), records.len());
    let count = leaves.len() as u64;
    let base = command.get("node_base");
    // The root is the last node; an object of one triangle has none.
    let root = match count {
        1 => 1 << 26 | base,
        _ => base + count - 2,
    };
    let below = records_below(nodes, root);
    let mut corners: Vec<BTreeSet<u64>> = (below.iter())
        .map(|&record| {
            ["v0", "v1", "v2"]
                .map(|name| records[record].get(name))
                .into()
        })
        .collect();
    let numbers: BTreeSet<u64> = below.iter().map(|&r| records[r].get("number")).collect();
    assert!(numbers.into_iter().eq(0..count));
    let mut leaves = leaves.to_vec();
    leaves.sort();
    corners.sort();
    assert_eq!(leaves, corners);
    let filler = &records[base as usize - 1];
    assert!(filler.digits.iter().all(|&digit| digit == 15));
    assert_eq!(
        nodes[base as usize - 1].get("left_lo"),
        vectors.format().nan()
    );
    assert_eq!(nodes[base as usize - 1].get("link"), (1 << 26) - 1);
}

/// Skins every mesh of the files. Returns the numbers of meshes and vertices.
fn check_skins(vectors: &Vectors, machine: Machine) -> [u64; 2] {
    let f = machine.f;
    let files = [
        "skinning_influences.hex",
        "skinning_vectors.hex",
        "skinning_commands.hex",
        "skinning_expected.hex",
    ];
    let fields = files.map(|file| vectors.fields(file));
    let lines: Vec<_> = files
        .iter()
        .zip(&fields)
        .map(|(file, fields)| vectors.lines(file, fields))
        .collect();
    let [rows, memory, commands, expected] = &lines[..] else {
        unreachable!()
    };
    let vector = |index: u64| ["x", "y", "z"].map(|axis| memory[index as usize].get(axis));
    let (mut next, mut influences) = (0, 0);
    let mut follows = BTreeSet::new();
    for command in commands {
        assert_eq!(command.get("first_vertex"), next as u64);
        let mut place = 0;
        for number in 0..command.get("vertices") {
            let rest = vector(command.get("rest") + number);
            let mut q = [[0; 3]; 4];
            let mut k = 0;
            loop {
                let row = &rows[command.get("influences") as usize + place / 4];
                let of = |name: &str| row.get(&format!("{name}{}", place % 4));
                let joint = of("joint");
                assert!(joint < command.get("joints"));
                let columns = [0, 1, 2, 3].map(|c| vector(command.get("palette") + 4 * joint + c));
                let moved = machine.point(&columns, rest);
                q[k] = moved.map(|x| plain::mul(f, x, of("weight")));
                let last = of("last") == 1;
                (place, k) = (place + 1, k + 1);
                if last {
                    follows.insert(k);
                    break;
                }
            }
            let sum = |i: usize| {
                let pair = |k: usize| plain::add(f, q[k][i], q[k + 1][i]);
                plain::add(f, pair(0), pair(2))
            };
            let line = &expected[next];
            let given = (
                line.get("vertex"),
                ["x", "y", "z"].map(|axis| line.get(axis)),
            );
            let due = (command.get("target") + number, [0, 1, 2].map(sum));
            assert_eq!(given, due, "skinning_expected.hex line {}", next + 1);
            next += 1;
        }
        assert_eq!(command.get("count"), place as u64);
        assert_eq!(command.get("rows"), place.div_ceil(4) as u64);
        influences += place as u64;
    }
    assert_eq!(next, expected.len());
    assert_eq!(influences, vectors.number("/influences"));
    assert!(
        follows.into_iter().eq(1..=4),
        "vertices of 1 to 4 influences"
    );
    [commands.len() as u64, next as u64]
}

/// The expected results of a packet step, by names of fields.
fn step(machine: Machine, rays: usize, line: &Line<'_>) -> Vec<(String, u64)> {
    let f = machine.f;
    let mask = line.get("mask");
    let mut fields = vec![];
    let mut nears = [vec![], vec![]];
    let mut masks = [0u64; 2];
    for (side, name) in ["left", "right"].into_iter().enumerate() {
        let axis = ["x", "y", "z"][line.get(&format!("{name}_axis")) as usize];
        let interval = ["lo", "hi"].map(|end| line.get(&format!("{name}_{end}")));
        for k in 0..rays {
            let of = |what: &str| line.get(&format!("ray{k}_{what}"));
            let sign = of("signs") >> line.get(&format!("{name}_axis")) & 1 == 1;
            let [near, far] = machine.clip(
                [of("near"), of("far")],
                interval,
                of(&format!("origin_{axis}")),
                of(&format!("reciprocal_{axis}")),
                sign,
            );
            if mask >> k & 1 == 1 && plain::less_equal(f, near, far) {
                masks[side] |= 1 << k;
                fields.push((format!("{name}_ray{k}_near"), near));
                fields.push((format!("{name}_ray{k}_far"), far));
            }
            nears[side].push(near);
        }
    }
    let nearer = |k: &usize| plain::less_equal(f, nears[0][*k], nears[1][*k]);
    let left_nearer = (0..rays).filter(nearer).fold(0, |bits, k| bits | 1 << k);
    let both = masks[0] & masks[1] & left_nearer;
    let (left, right) = (masks[0] != 0, masks[1] != 0);
    let left_first = left && (!right || both != 0);
    let (own, link) = (line.get("node"), line.get("link"));
    let children = match (line.flag("left_leaf"), line.flag("right_leaf")) {
        (false, false) => [(0, link), (0, link + 1)],
        (true, false) => [(1, own), (0, link)],
        (false, true) => [(0, link), (1, own)],
        (true, true) => [(1, own), (1, link)],
    };
    let mut flag = |name: &str, value| fields.push((name.to_string(), value));
    flag("to_left", masks[0]);
    flag("to_right", masks[1]);
    flag("both_left_first", both);
    flag("left_first", u64::from(left_first));
    flag("goes_on", u64::from(left || right));
    flag("pushes", u64::from(left && right));
    let (next, pushed) = (
        children[usize::from(!left_first)],
        children[usize::from(left_first)],
    );
    if left || right {
        flag("next_leaf", next.0);
        flag("next", next.1);
    }
    if left && right {
        flag("pushed_leaf", pushed.0);
        flag("pushed", pushed.1);
    }
    fields
}

/// The labels of a folder's scenes.
fn scenes_of(folder: &Path) -> Vec<String> {
    let vectors = Vectors::open(folder);
    let scenes = vectors.manifest["scenes"].as_array().unwrap();
    let label = |scene: &Value| scene["label"].as_str().unwrap().to_string();
    scenes.iter().map(label).collect()
}

#[test]
fn files_alone_tell_every_result() {
    let cases = CASES.into_iter().map(Case::new);
    for case in cases.chain(MOVING.into_iter().map(Case::moving)) {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("vectors");
        let summary = case.write(&out);
        println!("{}, {}: {summary:?}", case.config.name, case.spec);
        check(&out, &summary);
        // Each distinct object and each skinned one, in addition to the directed ones.
        let of_scene = [summary.updates - 20, summary.skins - 12];
        let (objects, skinned) = match case.spec {
            "builtin:reef?fish=3" => (4, 0),
            "builtin:figure?detail=36" => (1, 1),
            _ => (1, 0),
        };
        assert_eq!(of_scene, [objects, skinned]);
        assert_eq!(
            scenes_of(&out),
            ["given", "ties", "instances", "transforms"]
        );
        assert!(summary.transforms > 500);
    }
    for (rays_per_packet, exponent_bits, fraction_bits) in [(8, 8, 23), (2, 6, 11)] {
        let config = Config {
            rays_per_packet,
            exponent_bits,
            fraction_bits,
            ..Config::reference()
        };
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("vectors");
        let summary = Case::of(config, CASES[0].1, CASES[0].2).write(&out);
        check(&out, &summary);
        assert_eq!(scenes_of(&out).len(), 4);
    }
    // As many as the machine can address are written.
    let config = Config {
        address_bits: 8,
        ..Config::reference()
    };
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("vectors");
    let summary = Case::of(config, CASES[0].1, CASES[0].2).write(&out);
    assert!((2..21).contains(&summary.updates) && (2..12).contains(&summary.skins));
    assert_eq!(scenes_of(&out), ["given", "ties", "instances"]);
    check(&out, &summary);
}

/// A scene of the files as the golden model reads it; slots and vertices of other scenes are zero.
fn image_of(vectors: &Vectors, scene: usize) -> MemoryImage {
    let f = vectors.format();
    let read = |file: &str, record: Record| {
        let text = fs::read_to_string(vectors.folder.join(file)).unwrap();
        record.words_of_hex(&text).unwrap()
    };
    let nodes = MemoryImage::nodes_of_words(f, &read("nodes.hex", Record::node(f)));
    let records = MemoryImage::records_of_words(&read("records.hex", Record::triangle()));
    let vertices = MemoryImage::vertices_of_words(f, &read("vertices.hex", Record::vertex(f)));
    let of = |name: &str| vectors.number(&format!("/scenes/{scene}/{name}")) as usize;
    let slots = of("first_record")..of("first_record") + of("records");
    let fields = vectors.fields("scene.hex");
    let registers = vectors.lines("scene.hex", &fields);
    let corner = |end: &str| registers[scene].vector(end).map(|bits| f.to_f64(bits));
    let mut image = MemoryImage {
        format: f,
        nodes: vec![Node::default(); slots.end],
        records: vec![TriangleRecord::default(); slots.end],
        vertices,
        root: LinkWord::unpack(registers[scene].get("root") as u32),
        bounds: (corner("lo"), corner("hi")),
    };
    image.nodes[slots.clone()].copy_from_slice(&nodes[slots.clone()]);
    image.records[slots.clone()].copy_from_slice(&records[slots]);
    image
}

/// Events of a packet that would differ in a machine with one rule changed.
#[derive(Default)]
struct Told {
    /// By slot: distance, instance and triangle of each hit, in the order of the tests.
    hits: [Vec<(f64, u32, u32)>; 8],
    /// The record of the current instance, whether one of the rays enters, and whether one would enter if NaNs were accepted.
    entry: Option<(u32, bool, bool)>,
    /// Number of instances that no ray enters although one would with that change.
    kept_out: usize,
}

impl Told {
    fn leave(&mut self) {
        if let Some((_, false, true)) = self.entry.take() {
            self.kept_out += 1;
        }
    }
}

impl Observer for Told {
    fn hand_over(&mut self, _: &HandOver) {
        self.leave();
    }

    fn enter(&mut self, event: &EnterEvent) {
        let moved = &event.transformed;
        let would = !moved.ray.valid && moved.near <= moved.far;
        let (_, enters, nan) = self.entry.unwrap_or((event.record, false, false));
        self.entry = Some((event.record, enters || moved.enters, nan || would));
    }

    fn test(&mut self, event: &RayTest) {
        if event.outcome.hit {
            let hit = (event.outcome.t, event.instance, event.triangle);
            self.hits[event.slot as usize].push(hit);
        }
    }
}

/// The number of effects of each changed rule in the packets of a scene: first hit kept, last hit kept, triangle compared before instance, NaN enters.
fn packets_tell(vectors: &Vectors, scene: usize) -> [usize; 4] {
    let f = vectors.format();
    let test = match vectors.manifest["triangle_test"] == "watertight" {
        true => TriangleTest::Watertight,
        false => TriangleTest::MollerTrumbore,
    };
    let rays = vectors.number("/rays_per_packet") as usize;
    let caster = Caster::new(&image_of(vectors, scene), test, rays);
    let files = [
        "raycast_packets.hex",
        "raycast_rays.hex",
        "raycast_hits.hex",
    ];
    let fields = files.map(|file| vectors.fields(file));
    let [packets, lines, hits] = [0, 1, 2].map(|k| vectors.lines(files[k], &fields[k]));
    let mut told = [0; 4];
    for (number, packet) in packets.iter().enumerate() {
        if packet.get("scene") != scene as u64 {
            continue;
        }
        let own = number * rays..(number + 1) * rays;
        let cast: Vec<Ray> = (lines[own.clone()].iter())
            .map(|line| Ray {
                origin: line.vector("origin").map(|bits| f.to_f64(bits)),
                direction: line.vector("direction").map(|bits| f.to_f64(bits)),
                tmin: f.to_f64(line.get("tmin")),
                tmax: f.to_f64(line.get("tmax")),
                active: line.flag("active"),
                any_hit: line.flag("any_hit"),
            })
            .collect();
        let mut watch = Told::default();
        let result = caster.cast(&cast, &mut watch);
        watch.leave();
        told[3] += watch.kept_out;
        assert_eq!(u64::from(result.counts.steps), packet.get("steps"));
        for (k, (hit, line)) in result.hits.iter().zip(&hits[own]).enumerate() {
            assert_eq!(f.to_bits(hit.t), line.get("t"));
            assert_eq!(u64::from(hit.triangle), line.get("triangle"));
            if cast[k].any_hit || !hit.is_hit() {
                continue;
            }
            let equal = watch.hits[k].iter().filter(|(t, _, _)| *t == hit.t);
            let equal: Vec<(u32, u32)> = equal.map(|&(_, i, n)| (i, n)).collect();
            let expected = (hit.instance, hit.triangle);
            assert_eq!(equal.iter().min(), Some(&expected));
            let in_front = equal.iter().min_by_key(|(i, n)| (*n, *i));
            told[0] += usize::from(equal.first() != Some(&expected));
            told[1] += usize::from(equal.last() != Some(&expected));
            told[2] += usize::from(in_front != Some(&expected));
        }
    }
    told
}

/// The number of triangle tests that fail without one rule.
fn tests_tell(vectors: &Vectors, without: Rule) -> usize {
    let machine = Machine {
        f: vectors.format(),
        watertight: vectors.manifest["triangle_test"] == "watertight",
        without: Some(without),
    };
    let files = ["triangle_test_stimulus.hex", "triangle_test_expected.hex"];
    let fields = files.map(|file| vectors.fields(file));
    let [stimuli, results] = [0, 1].map(|k| vectors.lines(files[k], &fields[k]));
    let lines = stimuli.iter().zip(&results);
    let fails = lines.filter(|(line, result)| {
        let v = ["v0", "v1", "v2"].map(|vertex| line.vector(vertex));
        machine.test(v, &machine.given(line)).is_some() != result.flag("hit")
    });
    fails.count()
}

#[test]
fn directed_vectors_tell_each_rule() {
    let moving = MOVING.into_iter().map(Case::moving);
    for built in CASES.into_iter().map(Case::new).chain(moving) {
        let watertight = built.config.triangle_test == TriangleTest::Watertight;
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("vectors");
        write(&Request {
            limit: Some(2),
            ..built.request(&out)
        })
        .unwrap();
        let vectors = Vectors::open(&out);
        let [first, last, _, _] = packets_tell(&vectors, 1);
        assert!(first > 0 && last > 0, "ties: {first}, {last}");
        let told = packets_tell(&vectors, 2);
        assert!(told.iter().all(|&count| count > 0), "instances: {told:?}");
        let finite = tests_tell(&vectors, Rule::Finite);
        let flat = tests_tell(&vectors, Rule::FlatBox);
        println!(
            "{}: ties {first} {last}, instances {told:?}, t < ∞ {finite}, flat {flat}",
            built.config.name
        );
        assert!(finite >= 32, "t < ∞: {finite}");
        // Möller and Trumbore's det is 0 on such a box.
        assert_eq!(flat >= 32, watertight, "flat boxes: {flat}");
        assert!(watertight || flat == 0);
    }
}

/// The macros, derived from the manifest as `docs/vectors.md` defines.
fn macros_of(manifest: &Value) -> BTreeMap<String, String> {
    let mut macros = BTreeMap::new();
    let mut define = |name: String, value: String| {
        let name = format!("DYNRT_{}", name.to_uppercase());
        assert!(macros.insert(name.clone(), value).is_none(), "{name} twice");
    };
    for (key, value) in manifest["machine"].as_object().unwrap() {
        match value {
            Value::Bool(false) => {}
            Value::Bool(true) => define(key.clone(), String::new()),
            number => define(key.clone(), number.to_string()),
        }
    }
    for pipeline in manifest["pipelines"].as_array().unwrap() {
        let name = pipeline["macros"].as_str().unwrap().strip_prefix("DYNRT_");
        let name = name.unwrap();
        define(format!("{name}_LATENCY"), pipeline["latency"].to_string());
        for (input, stage) in pipeline["stages"].as_object().unwrap() {
            define(format!("{name}_{input}_STAGE"), stage.to_string());
        }
    }
    for file in manifest["files"].as_array().unwrap() {
        let Some(layout) = file["layout"].as_str() else {
            continue;
        };
        let stem = file["file"].as_str().unwrap().trim_end_matches(".hex");
        let layout = &manifest["layouts"][layout];
        define(format!("{stem}_LINES"), file["lines"].to_string());
        define(format!("{stem}_BITS"), layout["width"].to_string());
        for field in layout["fields"].as_array().unwrap() {
            let lsb = field["lsb"].as_u64().unwrap();
            let last = lsb + field["width"].as_u64().unwrap() - 1;
            let name = field["name"].as_str().unwrap();
            define(format!("{stem}_{name}"), format!("{last}:{lsb}"));
            define(format!("{stem}_{name}_LSB"), lsb.to_string());
        }
    }
    macros
}

/// Checks every port of a unit's module and its contents. Returns the fields on ports.
fn check_ports(unit: &Value, layouts: &Value, design: &Design) -> BTreeSet<(String, String)> {
    let module = design.modules().iter();
    let module = module
        .clone()
        .find(|m| design.module_name(m) == unit["module"].as_str().unwrap());
    let module = module.expect("a module of the machine");
    let width_of = |layout: &str, field: &str| {
        let fields = layouts[layout]["fields"].as_array().unwrap();
        let found = fields.iter().find(|f| f["name"] == field);
        found.unwrap()["width"].as_u64().unwrap()
    };
    let ports = unit["ports"].as_array().unwrap();
    let copies = unit["copies"].as_u64().unwrap();
    let mut used = BTreeSet::new();
    for copy in (0..copies).filter(|_| !ports.is_empty()) {
        let own = ports.iter().filter(|port| port["copy"] == copy);
        assert_eq!(
            own.clone().count(),
            module.ports().len(),
            "{}",
            unit["unit"]
        );
        for (port, real) in own.zip(module.ports()) {
            let place = format!("{}, {}", unit["unit"], real.name);
            assert_eq!(port["port"], real.name.as_str(), "{place}");
            assert_eq!(port["width"], real.width, "{place}");
            let input = real.direction == Direction::Input;
            assert_eq!(port["direction"], if input { "input" } else { "output" });
            let how = port["use"].as_str().unwrap();
            assert!(how != "unused" || !input, "{place}");
            assert!(how != "constant" || input && port["value"] == 0, "{place}");
            let fields = port["fields"].as_array().unwrap();
            assert_eq!(
                !fields.is_empty(),
                ["fields", "select"].contains(&how),
                "{place}"
            );
            assert_eq!(port["by"].is_object(), how == "select", "{place}");
            for field in fields {
                let of = |name: &str| field[name].as_u64().unwrap();
                let (layout, name) = (
                    field["layout"].as_str().unwrap(),
                    field["field"].as_str().unwrap(),
                );
                let width = width_of(layout, name);
                assert!(of("lsb") + of("width") <= width, "{place}");
                assert!(
                    of("port_lsb") + of("width") <= u64::from(real.width),
                    "{place}"
                );
                // Only an index can be wider than its port.
                let whole = of("width") == width
                    || width == 26
                    || of("width") == 1
                    || how == "select"
                    || ["slot", "joints"].contains(&name);
                assert!(whole, "{place}: {name}");
                used.insert((layout.to_string(), name.to_string()));
            }
        }
    }
    used
}

#[test]
fn the_manifest_says_all_of_the_macros_and_ports() {
    for number in [0, 2] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("vectors");
        let case = Case::new(CASES[number]);
        write(&Request {
            limit: Some(1),
            ..case.request(&out)
        })
        .unwrap();
        let Vectors { manifest, .. } = Vectors::open(&out);
        let text = fs::read_to_string(out.join("vectors.vh")).unwrap();
        let defined: BTreeMap<String, String> = text
            .lines()
            .filter_map(|line| {
                let rest = line.strip_prefix("`define ")?;
                let (name, value) = rest.split_once(' ').unwrap_or((rest, ""));
                Some((name.to_string(), value.to_string()))
            })
            .collect();
        assert_eq!(defined, macros_of(&manifest));

        let machine = case.machine(true);
        let mut on_ports = BTreeSet::new();
        let units = manifest["units"].as_array().unwrap();
        assert_eq!(units.len(), 11);
        for unit in units {
            on_ports.extend(check_ports(unit, &manifest["layouts"], &machine.design));
        }
        let tag_bits = |unit: usize, memory: usize| &units[unit]["memories"][memory]["tag_bits"];
        assert_eq!(tag_bits(0, 2), &manifest["machine"]["vertex_tag_bits"]);
        // All inputs and outputs of a pipeline.
        for (name, layout) in manifest["layouts"].as_object().unwrap() {
            let pipeline = [
                "ray_setup_",
                "triangle_test_",
                "fp_",
                "raycast_rays",
                "raycast_hits",
                "scene",
            ];
            if !pipeline.iter().any(|prefix| name.starts_with(prefix)) {
                continue;
            }
            for field in layout["fields"].as_array().unwrap() {
                let field = field["name"].as_str().unwrap().to_string();
                assert!(
                    on_ports.contains(&(name.clone(), field.clone())),
                    "{name}: {field}"
                );
            }
        }
        assert_eq!(manifest["made"]["size"], json!([8, 6]));
        assert_eq!(manifest["made"]["limit"], 1);
        assert_eq!(manifest["made"]["clip"], Value::Null);
        assert_eq!(manifest["made"]["log2_scale"], case.log2_scale);
        assert_eq!(manifest["picture"]["packets"], 1);
    }
}

#[test]
fn what_would_be_too_large_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("vectors");
    let case = Case::new(CASES[0]);
    let repeated = |times: usize| -> Vec<RayPacket> {
        let packets = case.packets.iter().cycle().take(times * case.packets.len());
        packets.cloned().collect()
    };
    let size = |times: usize| -> f64 {
        let packets = repeated(times);
        write(&Request {
            packets: &packets,
            ..case.request(&out)
        })
        .unwrap();
        let files = fs::read_dir(&out).unwrap();
        files
            .map(|file| file.unwrap().metadata().unwrap().len() as f64)
            .sum()
    };
    let [once, more] = [1, 11].map(size);
    let times = 1 + (1.5 * 2f64.powi(30) / ((more - once) / 10.0)) as usize;
    fs::remove_dir_all(&out).unwrap();
    let packets = repeated(times);
    let error = write(&Request {
        packets: &packets,
        ..case.request(&out)
    });
    let error = error.unwrap_err().to_string();
    let rest = error
        .strip_prefix("scene builtin:sphere?level=1: the files would take about ")
        .unwrap();
    let (size, _) = rest
        .split_once(" GiB, and more than 1 GiB is written only with --force")
        .unwrap();
    assert_eq!(size, "1.5");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[test]
fn hits_can_be_drawn_as_a_picture() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("vectors");
    // The size is not a multiple of blocks of 2 by 2.
    let case = Case::new(("virtex4-lx160", CASES[0].1, "9x7"));
    case.write(&out);
    let vectors = Vectors::open(&out);
    let pair = |name: &str| [0, 1].map(|k| vectors.number(&format!("/picture/{name}/{k}")));
    let ([w, h], [columns, rows]) = (pair("block"), pair("blocks"));
    assert_eq!(
        (pair("size"), [w, h], [columns, rows]),
        ([9, 7], [2, 2], [5, 4])
    );
    let files = ["raycast_packets.hex", "raycast_rays.hex"];
    let fields = files.map(|file| vectors.fields(file));
    let [packets, rays] = [0, 1].map(|k| vectors.lines(files[k], &fields[k]));
    let mut drawn = BTreeSet::new();
    for (packet, rays) in packets.iter().zip(rays.chunks(4)) {
        let block = packet.get("block");
        if block == u64::from(u32::MAX) {
            continue;
        }
        for (k, ray) in (0..).zip(rays) {
            let pixel = [w * (block % columns) + k % w, h * (block / columns) + k / w];
            let inside = pixel[0] < 9 && pixel[1] < 7;
            assert_eq!(ray.flag("active"), inside, "{pixel:?}");
            if inside {
                assert!(drawn.insert(pixel), "{pixel:?} twice");
            }
        }
    }
    assert_eq!(drawn.len(), 63);
}

/// Runs the Verilog benches; returns whether they pass, and their output.
fn run(vectors: &Path, rtl: &Path, arguments: &[&str]) -> (bool, String) {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/run.sh");
    let Output {
        status,
        stdout,
        stderr,
    } = Command::new(script)
        .args([vectors, rtl])
        .args(arguments)
        .output()
        .unwrap();
    let said = String::from_utf8(stdout).unwrap() + &String::from_utf8(stderr).unwrap();
    (status.success(), said)
}

/// A proof that a machine's outputs do not depend on its trace ports.
fn assert_same_without_trace_ports(config: &Config) {
    let options = prove::Options {
        units: vec!["trace".into()],
        ..prove::Options::default()
    };
    let rows = prove::run(config, &options, &|_| (), &mut |_| ()).unwrap();
    assert!(rows.iter().all(prove::Row::holds), "{rows:?}");
    let outputs: usize = rows.iter().map(|row| row.cases).sum();
    assert!(outputs > 400, "{rows:?}");
}

/// A folder of this name for a test's vectors and Verilog.
fn workplace(name: &str) -> PathBuf {
    Path::new(env!("CARGO_TARGET_TMPDIR"))
        .join("vectors")
        .join(name)
}

#[test]
fn verilog_benches_replay_them() {
    let mut cases: Vec<Case> = CASES.into_iter().map(Case::new).collect();
    cases.extend(MOVING.into_iter().map(Case::moving));
    // More packets in flight than tags, another format, a faster clock.
    let config = Config {
        name: "few-tags".into(),
        rays_per_packet: 2,
        tag_bits: 4,
        packets_in_flight: 33,
        exponent_bits: 6,
        fraction_bits: 11,
        clock_mhz: 133,
        ..Config::load("dynrt-2006").unwrap()
    };
    cases.push(Case::of(config, CASES[0].1, CASES[0].2));
    std::thread::scope(|scope| {
        for built in cases {
            scope.spawn(move || {
                let spec = built.spec.split([':', '?']).nth(1).unwrap();
                let case = &format!("{}-{spec}", built.config.name);
                let folder = workplace(case);
                let (out, rtl) = (folder.join("vectors"), folder.join("rtl"));
                let _ = fs::remove_dir_all(&folder);
                built.write_rtl(true, &rtl);
                // The directed scenes of a machine are replayed once.
                let limited = Request {
                    limit: Some(4),
                    directed_scenes: full() || built.seconds.is_none(),
                    ..built.request(&out)
                };
                let summary = write(&limited).unwrap();
                let (passes, said) = run(&out, &rtl, &[]);
                println!("{case}:\n{said}");
                assert!(passes, "{said}");
                let expected = format!(
                    "raycast: PASS {} hits checked, {} packet steps, {} triangle tests, {} ray transformations\n",
                    summary.rays, summary.steps, summary.tests, summary.transforms
                );
                assert!(said.contains(&expected), "{said}");
                // Without trace ports, hits are compared and other events are counted. All outputs are proved to be the same in every
                // cycle, so the packets of the scene alone are cast.
                assert_same_without_trace_ports(&built.config);
                let (plain, fewer) = (folder.join("plain"), folder.join("fewer"));
                built.write_rtl(false, &plain);
                let cast = write(&Request {
                    directed_scenes: full(),
                    out: &fewer,
                    ..limited
                })
                .unwrap();
                let (passes, said_plain) = run(&fewer, &plain, &["raycast", "skinning"]);
                let expected = format!(
                    "raycast: PASS {} hits checked; counted {} packet steps, {} triangle tests, {} ray transformations\n",
                    cast.rays, cast.steps, cast.tests, cast.transforms
                );
                assert!(passes && said_plain.contains(&expected), "{said_plain}");
                assert!(cast.rays > 0 && cast.steps > 0 && cast.tests > 0, "{cast:?}");
                assert_eq!(cast.skins, summary.skins);
                let manifest = Vectors::open(&out);
                let total = |name: &str| manifest.number(&format!("/{name}"));
                for line in [
                    format!(
                        "update: PASS {} updates checked, {} node writes, {} instructions\n",
                        summary.updates,
                        summary.nodes_written,
                        total("update_instructions")
                    ),
                    format!(
                        "skinning: PASS {} meshes checked, {} vertices, {} influences\n",
                        summary.skins,
                        summary.vertices_skinned,
                        total("influences")
                    ),
                ] {
                    assert!(said.contains(&line), "{line}: {said}");
                }
                assert!(summary.steps > 0 && summary.tests > 0, "{summary:?}");
                for bench in ["fp", "ray_setup", "packet_step", "triangle_test"] {
                    assert!(said.contains(&format!("{bench}: PASS ")), "{said}");
                }
            });
        }
    });
}

#[test]
fn the_benches_find_what_is_wrong() {
    let folder = workplace("changed");
    let _ = fs::remove_dir_all(&folder);
    let (good, rtl) = (folder.join("good"), folder.join("rtl"));
    let case = Case::new(CASES[1]);
    case.write_rtl(true, &rtl);
    // The benches are checked here, with the packets of the scene alone.
    write(&Request {
        directed_scenes: full(),
        ..case.request(&good)
    })
    .unwrap();
    let seed = seed();
    let mut rng = fastrand::Rng::with_seed(seed);

    // The vectors pass with irregular memories and neighbours.
    let seed_argument = format!("+seed={}", seed & 0x7fff_ffff);
    let surroundings = [
        "raycast",
        "+latency=2",
        "+jitter=30",
        "+in_order=0",
        "+ready=50",
        "+rays=70",
        "+hits=50",
        &seed_argument,
    ];
    let (passes, said) = run(&good, &rtl, &surroundings);
    assert!(passes && said.starts_with("raycast: PASS "), "{said}");

    for bench in ["update", "skinning"] {
        let surroundings = [
            bench,
            "+latency=2",
            "+jitter=30",
            "+in_order=0",
            "+ready=50",
            "+writes=50",
            &seed_argument,
        ];
        let (passes, said) = run(&good, &rtl, &surroundings);
        assert!(
            passes && said.starts_with(&format!("{bench}: PASS ")),
            "{said}"
        );
    }

    // The least significant bit of these lines is always compared.
    let changed = folder.join("vectors");
    for (bench, file) in [
        ("fp", "fp_add_expected.hex"),
        ("fp", "fp_sub_expected.hex"),
        ("fp", "fp_mul_expected.hex"),
        ("fp", "fp_reciprocal_expected.hex"),
        ("ray_setup", "ray_setup_expected.hex"),
        ("packet_step", "packet_step_expected.hex"),
        ("triangle_test", "triangle_test_expected.hex"),
        ("raycast", "raycast_hits.hex"),
        ("update", "update_node_writes.hex"),
        ("update", "update_nodes_after.hex"),
        ("update", "update_boxes.hex"),
        ("skinning", "skinning_expected.hex"),
    ] {
        copy(&good, &changed);
        let mut lines: Vec<String> = fs::read_to_string(good.join(file))
            .unwrap()
            .lines()
            .map(String::from)
            .collect();
        // Early in the file, so the bench ends soon.
        let number = rng.usize(..lines.len().min(300));
        let line = &mut lines[number];
        let digit = u8::from_str_radix(&line.split_off(line.len() - 1), 16).unwrap();
        line.push_str(&format!("{:x}", digit ^ 1));
        fs::write(changed.join(file), lines.join("\n") + "\n").unwrap();
        let (passes, said) = run(&changed, &rtl, &[bench]);
        let expected = format!("{bench}: FAIL {file} line {}: ", number + 1);
        assert!(!passes && said.starts_with(&expected), "{expected}: {said}");
    }

    // Changes of stimuli are detected as well: a bit of a field is changed in all lines. (It is in an exponent, because a box
    // changes with any one of its vertices only if the vertex moves far.)
    for (bench, file, field, bit) in [
        ("update", "update_vertices.hex", "x", 20),
        ("update", "update_nodes_before.hex", "link", 0),
        ("update", "update_commands.hex", "node_base", 0),
        ("skinning", "skinning_commands.hex", "target", 0),
        ("skinning", "skinning_influences.hex", "weight0", 20),
    ] {
        copy(&good, &changed);
        let fields = Vectors::open(&good).fields(file);
        let place = fields[field].0 + bit;
        let text = fs::read_to_string(good.join(file)).unwrap();
        let lines: Vec<String> = text
            .lines()
            .map(|line| {
                let mut digits: Vec<char> = line.chars().collect();
                let digit = digits.len() - 1 - (place / 4) as usize;
                let changed = digits[digit].to_digit(16).unwrap() ^ 1 << (place % 4);
                digits[digit] = char::from_digit(changed, 16).unwrap();
                digits.into_iter().collect()
            })
            .collect();
        fs::write(changed.join(file), lines.join("\n") + "\n").unwrap();
        let (passes, said) = run(&changed, &rtl, &[bench]);
        let expected = format!("{bench}: FAIL ");
        assert!(!passes && said.starts_with(&expected), "{file}: {said}");
        assert!(said.contains(".hex"), "{file}: {said}");
    }

    // Events inside the unit are compared as well.
    let steps = Vectors::open(&good).number("/packet_steps") as usize;
    let tests = Vectors::open(&good).number("/ray_triangle_tests") as usize;
    for (file, belonging) in [
        ("packet_step_expected.hex", steps),
        ("triangle_test_expected.hex", tests),
    ] {
        copy(&good, &changed);
        let text = fs::read_to_string(good.join(file)).unwrap();
        let mut lines: Vec<String> = text.lines().map(String::from).collect();
        let number = rng.usize(..belonging);
        let line = &mut lines[number];
        let digit = u8::from_str_radix(&line.split_off(line.len() - 1), 16).unwrap();
        line.push_str(&format!("{:x}", digit ^ 1));
        fs::write(changed.join(file), lines.join("\n") + "\n").unwrap();
        let (passes, said) = run(&changed, &rtl, &["raycast"]);
        let expected = format!("raycast: FAIL {file} line {}: ", number + 1);
        assert!(!passes && said.starts_with(&expected), "{expected}: {said}");
    }

    // Without trace ports, the number of events is compared: a packet has one step more or less than expected.
    let plain = folder.join("plain");
    case.write_rtl(false, &plain);
    copy(&good, &changed);
    let file = "raycast_packets.hex";
    let place = Vectors::open(&good).fields(file)["steps"].0 as usize / 4;
    let mut packets = fs::read(good.join(file)).unwrap();
    let end = packets.iter().position(|byte| *byte == b'\n').unwrap();
    let digit = &mut packets[end - 1 - place];
    *digit = if *digit == b'1' { b'0' } else { b'1' };
    fs::write(changed.join(file), packets).unwrap();
    let (passes, said) = run(&changed, &plain, &["raycast"]);
    assert!(
        !passes && said.starts_with("raycast: FAIL counters: "),
        "{said}"
    );

    // Ray transformations, in a scene of two levels.
    let two_levels = Case::moving(MOVING[0]);
    let (reef, reef_rtl) = (folder.join("reef"), folder.join("reef_rtl"));
    two_levels.write_rtl(true, &reef_rtl);
    let limited = Request {
        limit: Some(1),
        directed_scenes: full(),
        ..two_levels.request(&reef)
    };
    write(&limited).unwrap();
    let file = "ray_transform_expected.hex";
    let text = fs::read_to_string(reef.join(file)).unwrap();
    let mut lines: Vec<String> = text.lines().map(String::from).collect();
    let number = rng.usize(..lines.len().min(100));
    let digit = lines[number].pop().unwrap().to_digit(16).unwrap() ^ 1;
    lines[number].push(char::from_digit(digit, 16).unwrap());
    fs::write(reef.join(file), lines.join("\n") + "\n").unwrap();
    let (passes, said) = run(&reef, &reef_rtl, &["raycast"]);
    let expected = format!("raycast: FAIL {file} line {}: ", number + 1);
    assert!(!passes && said.starts_with(&expected), "{expected}: {said}");

    // Files that are missing or too short.
    copy(&good, &changed);
    let hits = fs::read_to_string(good.join("raycast_hits.hex")).unwrap();
    let last = hits.lines().count();
    let shortened: Vec<_> = hits.lines().take(last - 1).collect();
    fs::write(changed.join("raycast_hits.hex"), shortened.join("\n")).unwrap();
    let (passes, said) = run(&changed, &rtl, &["raycast"]);
    let expected =
        format!("raycast: FAIL raycast_hits.hex line {last}: missing, or no hexadecimal number\n");
    assert!(!passes && said.starts_with(&expected), "{said}");
    fs::remove_file(changed.join("scene.hex")).unwrap();
    for bench in ["ray_setup", "raycast"] {
        let (passes, said) = run(&changed, &rtl, &[bench]);
        let expected = format!("{bench}: FAIL scene.hex: the file is missing\n");
        assert!(!passes && said == expected, "{said}");
    }

    // A file without lines.
    let header = fs::read_to_string(changed.join("vectors.vh")).unwrap();
    let lines = format!("DYNRT_RAYCAST_HITS_LINES {last}\n");
    assert!(header.contains(&lines));
    fs::write(
        changed.join("vectors.vh"),
        header.replace(&lines, "DYNRT_RAYCAST_HITS_LINES 0\n"),
    )
    .unwrap();
    let (passes, said) = run(&changed, &rtl, &["raycast"]);
    assert!(
        !passes && said.contains("nothing to check: DYNRT_RAYCAST_HITS_LINES 0"),
        "{said}"
    );
    fs::remove_file(changed.join("vectors.vh")).unwrap();
    let (passes, said) = run(&changed, &rtl, &["fp"]);
    assert!(
        !passes && said.ends_with("vectors.vh is missing\n"),
        "{said}"
    );
    let (passes, said) = run(&good, &good, &["fp"]);
    assert!(
        !passes && said.ends_with("rtl/dynrt_raycast_unit.v is missing\n"),
        "{said}"
    );
}

fn copy(from: &Path, to: &Path) {
    let _ = fs::remove_dir_all(to);
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        fs::copy(entry.path(), to.join(entry.file_name())).unwrap();
    }
}

#[test]
fn the_same_request_writes_the_same_files() {
    let folder = tempfile::tempdir().unwrap();
    let case = Case::new(CASES[1]);
    let [first, second] = ["first", "second"].map(|name| folder.path().join(name));
    let summary = case.write(&first);
    assert_eq!(summary, case.write(&second));
    // Again, to the same place.
    case.write(&first);
    for entry in fs::read_dir(&first).unwrap() {
        let name = entry.unwrap().file_name();
        assert!(
            fs::read(first.join(&name)).unwrap() == fs::read(second.join(&name)).unwrap(),
            "{name:?} differs"
        );
    }
    let limited = Request {
        limit: Some(3),
        ..case.request(&second)
    };
    let fewer = write(&limited).unwrap();
    assert_eq!(
        summary.packets - fewer.packets,
        case.packets.len() as u64 - 3
    );
    check(&second, &fewer);
}

#[test]
fn bad_requests_are_refused_in_one_line_and_leave_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("vectors");
    let case = Case::new(CASES[1]);
    let good = case.request(&out);
    let refusal = |request: Request<'_>| {
        let error = format!("{:#}", write(&request).unwrap_err());
        assert!(!error.contains('\n'), "{error}");
        error.replace(&folder.path().display().to_string(), "FOLDER")
    };
    let scene = "scene builtin:cornell";
    assert_eq!(
        refusal(Request {
            limit: Some(0),
            ..good
        }),
        format!("{scene}: no packet is to be cast; allow at least one")
    );
    assert_eq!(
        refusal(Request {
            packets: &[],
            ..good
        }),
        format!("{scene}: no packet is to be cast; allow at least one")
    );
    let config = Config {
        rays_per_packet: 4,
        ..case.config.clone()
    };
    assert_eq!(
        refusal(Request {
            config: &config,
            ..good
        }),
        format!(
            "{scene}: packet 0 has 1 rays, but the machine tiny takes packets of 4; make packets for this machine"
        )
    );
    let config = Config {
        fraction_bits: 10,
        ..case.config.clone()
    };
    assert_eq!(
        refusal(Request {
            config: &config,
            ..good
        }),
        format!(
            "{scene}: its memory image is of fp24(1-7-16), but the machine tiny has fp18(1-7-10); make the image for this machine"
        )
    );
    let config = Config {
        address_bits: 5,
        ..case.config.clone()
    };
    assert!(
        refusal(Request {
            config: &config,
            ..good
        })
        .starts_with(&format!(
            "{scene}: the scene is too large for its address space: "
        ))
    );
    let config = Config {
        stack_depth: 2,
        ..case.config.clone()
    };
    assert!(
        refusal(Request {
            config: &config,
            ..good
        })
        .contains(" nodes deep but the traversal stack holds 2 entries")
    );
    let mut image = case.image.clone();
    image.records[3].vertices[1] = 1 << 20;
    assert!(
        refusal(Request {
            image: &image,
            ..good
        })
        .starts_with(&format!(
            "{scene}: triangle record 3 names vertex 1048576, but there are "
        ))
    );
    assert_eq!(
        fs::read_dir(folder.path()).unwrap().count(),
        0,
        "nothing is left"
    );
    fs::create_dir(&out).unwrap();
    fs::write(out.join("thesis.txt"), "mine").unwrap();
    assert_eq!(
        refusal(good),
        "FOLDER/vectors: exists and holds no vectors that could be replaced; name a new folder, or remove it"
    );
    assert_eq!(fs::read_dir(&out).unwrap().count(), 1);
}

/// The text between the end of `<!-- table: NAME -->` and the next empty line but one.
fn table_in(text: &str, name: &str) -> String {
    let mark = format!("<!-- table: {name} -->\n\n");
    let (_, after) = text
        .split_once(&mark)
        .unwrap_or_else(|| panic!("the page has no table {name}"));
    let lines = after.lines().take_while(|line| line.starts_with('|'));
    lines.map(|line| format!("{line}\n")).collect()
}

fn page(name: &str) -> String {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("docs")
        .join(name);
    fs::read_to_string(path).unwrap()
}

#[test]
fn the_layout_page_says_what_the_layout_is() {
    use dynrt::bkd::{LinkWord, Node, Record};
    let text = page("layout.md");
    for record in [
        Record::node(Format::FP24),
        Record::link_word(),
        Record::instance(),
        Record::influence_row(Format::FP24),
        Record::triangle(),
        Record::vertex(Format::FP24),
    ] {
        let mut table = String::from("| field | bits | width | what |\n|---|---|---|---|\n");
        for field in &record.fields {
            let last = field.lsb + field.width - 1;
            let bits = if last == field.lsb {
                format!("{last}")
            } else {
                format!("{last}:{}", field.lsb)
            };
            table += &format!(
                "| `{}` | {bits} | {} | {} |\n",
                field.name, field.width, field.description
            );
        }
        table += &format!("| | | {} | |\n", record.width);
        assert_eq!(
            table_in(&text, record.name),
            table,
            "docs/layout.md, {}:\n{table}",
            record.name
        );
    }
    use dynrt::bkd::bytes::ByteRecord;
    for record in [
        ByteRecord::node(Format::FP24),
        ByteRecord::vertex(Format::FP24),
        ByteRecord::triangle(Format::FP24),
        ByteRecord::influence_row(Format::FP24),
        ByteRecord::hit(Format::FP24),
    ] {
        let name = format!("{} in bytes", record.record.name);
        let table = record.table();
        let shown = table_in(&text, &name);
        assert_eq!(shown, table, "docs/layout.md, {name}:\n{table}");
    }
    let link = LinkWord {
        link: 5,
        left_leaf: true,
        right_leaf: false,
        left_axis: 2,
        right_axis: 1,
    };
    let image = MemoryImage {
        nodes: vec![Node {
            left: [0.0, 2.5],
            right: [4.0, 5.0],
            link,
        }],
        ..Case::new(CASES[1]).image
    };
    let line = Record::node(Format::FP24).hex_lines(&image.node_words());
    assert!(text.contains(&format!("\n\n    {line}\n")), "{line}");
    assert!(text.contains(&format!("| {:08x} | `link` = 5,", link.pack())));
    use dynrt::bkd::layout::Target;
    assert_eq!(link.children(7), [Target::Record(7), Target::Node(5)]);
}

/// A layout in the form of the page: the fields of all rays of a packet except the first are one row.
fn layout_table(layout: &Value) -> String {
    let fields = layout["fields"].as_array().unwrap();
    let text = |field: &Value, key: &str| field[key].as_str().unwrap().to_string();
    let number = |field: &Value, key: &str| field[key].as_u64().unwrap();
    let repeated = |field: &Value| {
        let name = text(field, "name");
        name.split('_').any(|part| {
            part.strip_prefix("ray")
                .is_some_and(|k| k.parse().is_ok_and(|k: u32| k > 0))
        })
    };
    let mut table = String::from("| field | bits | width | kind | what |\n|---|---|---|---|---|\n");
    let mut place = 0;
    while let Some(field) = fields.get(place) {
        let run = fields[place..].iter().take_while(|f| repeated(f)).count();
        let last = &fields[place + run.max(1) - 1];
        let lsb = number(field, "lsb");
        let end = number(last, "lsb") + number(last, "width");
        let bits = match end - lsb {
            1 => format!("{lsb}"),
            _ => format!("{}:{lsb}", end - 1),
        };
        table += &match run {
            0 => format!(
                "| `{}` | {bits} | {} | {} | {} |\n",
                text(field, "name"),
                end - lsb,
                text(field, "kind"),
                text(field, "description")
            ),
            _ => format!(
                "| `{}` … `{}` | {bits} | {} | | as for ray 0 |\n",
                text(field, "name"),
                text(last, "name"),
                end - lsb
            ),
        };
        place += run.max(1);
    }
    table + &format!("| | | {} | | |\n", layout["width"])
}

#[test]
fn the_vectors_page_says_what_the_reference_machines_layouts_are() {
    let text = page("vectors.md");
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("vectors");
    let case = Case::moving(MOVING[0]);
    let request = Request {
        limit: Some(1),
        ..case.request(&out)
    };
    write(&request).unwrap();
    let vectors = Vectors::open(&out);
    for name in [
        "scene",
        "raycast_rays",
        "raycast_hits",
        "raycast_packets",
        "ray_setup_stimulus",
        "ray_setup_expected",
        "packet_step_stimulus",
        "packet_step_expected",
        "triangle_test_stimulus",
        "triangle_test_expected",
        "fp_add_stimulus",
        "fp_add_expected",
        "ray_transform_stimulus",
        "ray_transform_expected",
        "update_program",
        "update_commands",
        "update_node_writes",
        "update_boxes",
        "skinning_commands",
        "skinning_expected",
    ] {
        let table = layout_table(&vectors.manifest["layouts"][name]);
        assert_eq!(
            table_in(&text, name),
            table,
            "docs/vectors.md, {name}:\n{table}"
        );
    }
    // The example decodes to what its table says.
    let example = "000700000123000000003d00003e8000416800";
    assert!(text.contains(&format!("\n\n    {example}\n")));
    let fields = vectors.fields("raycast_hits.hex");
    let line = Line {
        digits: example
            .chars()
            .map(|c| c.to_digit(16).unwrap() as u8)
            .collect(),
        fields: &fields,
    };
    for (name, (lsb, width)) in &fields {
        let digits = width.div_ceil(4) as usize;
        let row = format!(
            "| `{name}` | {}:{lsb} | {:0digits$x} | ",
            lsb + width - 1,
            line.get(name)
        );
        assert!(text.contains(&row), "{row}");
    }
    let numbers = ["t", "u", "v"].map(|name| Format::FP24.to_f64(line.get(name)));
    assert_eq!(numbers, [5.625, 0.75, 0.25]);
    // Every file is mentioned, at least by its unit's name in braces.
    for file in fs::read_dir(&out).unwrap() {
        let name = file.unwrap().file_name().into_string().unwrap();
        let stem = name.split('.').next().unwrap();
        let spoken = text.contains(&format!("`{name}`"))
            || ["stimulus", "expected", "care"].iter().any(|role| {
                stem.strip_suffix(&format!("_{role}")).is_some_and(|unit| {
                    text.contains(&format!("`{unit}_{{"))
                        || unit.starts_with("fp_") && text.contains("`fp_{add,sub,mul}_{")
                })
            });
        assert!(spoken, "docs/vectors.md does not speak of {name}");
    }
}
