//! The skinning processor, compared with the golden model in all bits: random meshes with memory latencies from 1 to 100 cycles
//! and with random back-pressure, and whole meshes at full rate.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test cosim skinning::` repeats them. `DYNRT_FULL=1` skins a million vertices,
//! otherwise a tenth of them.

use crate::support::seed;
#[allow(dead_code)]
use crate::support::{prepare, shared_scene};
use dynrt::bkd::layout::{influence_words, vector_words};
use dynrt::bkd::{Columns, Influence, Record};
use dynrt::config::{Config, TriangleTest};
use dynrt::cosim::memory::{ReadHandles, ReadPort, ReadResponse, Timing};
use dynrt::cosim::model::Sources;
use dynrt::cosim::model::{BuildOptions, Model, build};
use dynrt::cosim::scoreboard::{Fault, Surroundings, UnitOptions};
use dynrt::cosim::unit_skinning::{SkinFigures, SkinMesh, SkinReport, Traffic, Workload, run};
use dynrt::float::Arithmetic;
use dynrt::golden::Caster;
use dynrt::golden::skinning::skin_vertices;
use dynrt::hdl::Ports;
use dynrt::hw::ray::{Limits, Line};
use dynrt::hw::raycast::{emit, ports};
use dynrt::hw::skinning::Mesh;
use dynrt::hw::{self, Plan};
use dynrt::scene::load_animated;

/// `vertices` at full length, otherwise a tenth of them.
fn share(vertices: u64) -> u64 {
    let full = std::env::var_os("DYNRT_FULL").is_some_and(|value| value == "1");
    let share = if full { vertices } else { vertices / 10 };
    println!("{share} of {vertices} vertices (all with DYNRT_FULL=1)");
    share
}

fn check(
    config: &Config,
    workload: Workload<'_>,
    traffic: Traffic,
    options: &UnitOptions,
) -> SkinReport {
    let report = run(config, workload, traffic, options).unwrap_or_else(|e| panic!("{e:#}"));
    println!("{}, {}", config.name, report.summary());
    report.unit.verdict().unwrap_or_else(|e| panic!("{e:#}"));
    report
}

/// Random meshes with this number of vertices.
fn random(config: &Config, vertices: u64, seed: u64) -> SkinReport {
    let workload = Workload::Random { vertices };
    let report = check(config, workload, Traffic::Separate, &UnitOptions::new(seed));
    assert!(report.unit.transactions >= vertices);
    assert!(report.unit.checked > report.unit.packets);
    report
}

#[test]
fn random_meshes_on_the_reference_machine() {
    let report = random(&Config::reference(), share(1_000_000), seed());
    for (category, count) in &report.unit.categories {
        assert!(*count > 0, "no {}", category.name());
    }
}

/// Machines that differ from the reference in all parameters of the unit.
fn others() -> Vec<Config> {
    vec![
        Config::load("tiny").unwrap(),
        Config {
            name: "least queues, 3-bit exponent and 2-bit fraction, 66 MHz, Möller–Trumbore".into(),
            exponent_bits: 3,
            fraction_bits: 2,
            clock_mhz: 66,
            triangle_test: TriangleTest::MollerTrumbore,
            skinning_joints: 16,
            skinning_rows_ahead: 2,
            skinning_vertices_ahead: 2,
            skinning_vertices_waiting: 4,
            ..Config::reference()
        },
        Config {
            name: "odd sizes, 8-bit exponent and 23-bit fraction, 133 MHz, packets of 8".into(),
            exponent_bits: 8,
            fraction_bits: 23,
            clock_mhz: 133,
            rays_per_packet: 8,
            packets_in_flight: 13,
            skinning_joints: 64,
            skinning_rows_ahead: 5,
            skinning_vertices_ahead: 37,
            skinning_vertices_waiting: 101,
            address_bits: 26,
            ..Config::reference()
        },
    ]
}

#[test]
fn random_meshes_on_other_machines() {
    let seed = seed();
    let vertices = share(100_000);
    for config in others() {
        random(&config, vertices, seed);
    }
}

/// The skinned objects of a scene at the middle of its first clip, in the machine's number format, scaled to fit 256.
fn meshes(config: &Config, scene: &str) -> Vec<SkinMesh> {
    let animated = load_animated(scene).unwrap();
    let clip = animated.clip(None).unwrap();
    let seconds = clip.map_or(0.0, |clip| animated.clips[clip].seconds / 2.0);
    let pose = animated.pose(clip, seconds).unwrap();
    let a = Arithmetic::new(config.format());
    let skinned = animated.objects.iter().zip(&pose.objects);
    skinned
        .filter_map(|(object, pose)| {
            let skin = object.skin()?;
            let positions = pose.positions.as_ref().unwrap_or(&object.mesh.positions);
            let lengths = positions.iter().flatten().map(|x| x.abs());
            let limit = lengths
                .chain(pose.palette.iter().flatten().map(|row| row[3].abs()))
                .fold(f64::MIN_POSITIVE, f64::max);
            let scale = (256.0 / limit).log2().floor().exp2();
            let influences = skin.influences.iter().flat_map(|of_vertex| {
                let count = of_vertex.count();
                (0..count).map(move |k| Influence {
                    joint: of_vertex.joints[k] as u8,
                    weight: a.round(of_vertex.weights[k]),
                    last: k + 1 == count,
                })
            });
            let palette = pose.palette.iter().map(|rows| -> Columns {
                let scale_of = |column: usize| if column == 3 { scale } else { 1.0 };
                std::array::from_fn(|c| rows.map(|row| a.round(row[c] * scale_of(c))))
            });
            Some(SkinMesh {
                name: format!("{scene}, {}", object.name),
                rest: positions
                    .iter()
                    .map(|p| p.map(|x| a.round(x * scale)))
                    .collect(),
                influences: influences.collect(),
                palette: palette.collect(),
            })
        })
        .collect()
}

/// Meshes with one memory of 32 bytes per cycle behind all ports and a latency of 8 cycles.
fn at_full_pace(meshes: &[SkinMesh]) -> Vec<SkinFigures> {
    let options = UnitOptions {
        surroundings: Some(Surroundings::steady(8)),
        ..UnitOptions::new(seed())
    };
    let workload = Workload::Meshes(meshes);
    check(&Config::reference(), workload, Traffic::Shared, &options).meshes
}

/// Loading a palette and filling the pipeline costs a few hundred cycles per mesh.
#[test]
fn whole_meshes_at_full_pace() {
    let config = Config::reference();
    let files = [
        "fox/Fox.glb",
        "cesium_man/CesiumMan.glb",
        "rigged_figure/RiggedFigure.glb",
        "robot_expressive/RobotExpressive.glb",
        "spider/Spider.glb",
        "hand/left.glb",
    ];
    let files = files.into_iter().filter_map(shared_scene);
    let builtin = ["builtin:figure?detail=96", "builtin:figure"].map(str::to_string);
    let scenes = builtin.into_iter().chain(files);
    let meshes: Vec<_> = scenes.flat_map(|scene| meshes(&config, &scene)).collect();
    let figures = at_full_pace(&meshes);
    assert!(figures[0].influences >= 10_000, "{}", figures[0].summary());
    for figures in figures {
        if figures.influences >= 10_000 {
            let pace = figures.influences_per_clock();
            assert!(pace >= 0.95, "{}", figures.summary());
        }
    }
}

/// One influence is processed per cycle, for any number of influences per vertex: 32 bytes per cycle are sufficient for reading a
/// vertex, writing one, and a quarter of a row.
#[test]
fn an_influence_goes_every_clock_however_many_a_vertex_has() {
    let count = 12_000;
    let mesh = |per_vertex: usize| SkinMesh {
        name: format!("{per_vertex} influences a vertex"),
        rest: vec![[1.0, -2.0, 0.5]; count / per_vertex],
        influences: (0..count)
            .map(|k| Influence {
                joint: (k % 5) as u8,
                weight: 0.25,
                last: (k + 1) % per_vertex == 0,
            })
            .collect(),
        palette: vec![[[1.0, 0.0, 0.5], [0.25, 1.0, 0.0], [0.0, 0.5, 1.0], [1.0; 3]]; 5],
    };
    let meshes: Vec<_> = (1..=4).map(mesh).collect();
    for figures in at_full_pace(&meshes) {
        let pace = figures.influences_per_clock();
        assert!(pace >= 0.99, "{}", figures.summary());
    }
}

/// Typical faults of a design are detected.
#[test]
fn faults_are_mismatches() {
    let seed = seed();
    // The write queue is short, so it fills.
    let config = Config::load("tiny").unwrap();
    let faults: [(&str, Fault); 3] = [
        ("the first pair's sum is lost", |unit| {
            let processor = unit.module("skinning_processor")?;
            let done = processor.signal("upper_done")?;
            Ok(processor.signal("lower_sum_x")?.reads(done).as_value(0))
        }),
        ("a vertex is issued without room for it", |unit| {
            let processor = unit.module("skinning_processor")?;
            Ok(processor.signal("room")?.fault().as_value(1))
        }),
        ("the write queue's next word is shown too late", |unit| {
            let processor = unit.module("skinning_processor")?;
            let [shown, next, head] = ["write_data", "next_head", "queue_head"];
            let (next, head) = (processor.signal(next)?, processor.signal(head)?);
            Ok(processor.signal(shown)?.reads(next).as_signal(head))
        }),
    ];
    for (what, fault) in faults {
        let options = UnitOptions {
            fault: Some(fault),
            ..UnitOptions::new(seed)
        };
        let workload = Workload::Random { vertices: 10_000 };
        let report =
            run(&config, workload, Traffic::Separate, &options).unwrap_or_else(|e| panic!("{e:#}"));
        assert_eq!(report.unit.mismatches, 1, "{what}: is not noticed");
        assert!(report.unit.mismatch.is_some());
        assert!(report.unit.verdict().is_err());
    }
}

/// A read port of the ray casting unit with its memory.
struct Memory {
    handles: ReadHandles,
    port: ReadPort,
    words_per_record: usize,
    answer: Option<ReadResponse>,
}

impl Memory {
    fn new(handles: ReadHandles, name: &str, words: &[u32], record: &Record, seed: u64) -> Memory {
        let timing = Timing {
            latency: 3,
            jitter: 9,
            out_of_order: true,
            backpressure: 0.2,
            seed,
            ..Timing::default()
        };
        let rows = words.len() / record.words();
        Memory {
            handles,
            port: ReadPort::new(name, rows as u64, timing).unwrap(),
            words_per_record: record.words(),
            answer: None,
        }
    }

    /// Drives the inputs for the next edge.
    fn show(&self, model: &mut Model, words: &[u32]) {
        model.set(self.handles.request.ready, self.port.ready().into());
        let data = self.answer.map_or(&[][..], |answer| {
            let start = answer.address as usize * self.words_per_record;
            &words[start..start + self.words_per_record]
        });
        model.respond(&self.handles, self.answer, data);
    }

    /// Performs the edge.
    fn step(&mut self, model: &Model) {
        self.answer = self.port.step(model.read_request(&self.handles)).unwrap();
    }
}

/// Meshes are skinned between the packets of a picture: each waits until no packet is in flight, rays wait until it is complete,
/// and the results of both are correct.
#[test]
fn rays_and_meshes_take_turns() {
    let (config, seed) = (Config::reference(), seed());
    let mut rng = fastrand::Rng::with_seed(seed);
    let format = config.format();
    let prepared = prepare(&config, "builtin:cornell", "48x32", None);
    let rays = &prepared.rays;
    let per_packet = config.rays_per_packet as usize;
    let caster = Caster::new(&prepared.image, config.triangle_test, per_packet);
    let hits = caster.cast_packets(rays).hits;

    // The mesh is behind the scene's vertices: palette, vertices at rest, vertices to write.
    let a = Arithmetic::new(format);
    let mut vector = || std::array::from_fn(|_| a.round(8.0 * rng.f64() - 4.0));
    let palette: Vec<Columns> = (0..9).map(|_| std::array::from_fn(|_| vector())).collect();
    let rest: Vec<[f64; 3]> = (0..100).map(|_| vector()).collect();
    let influence = |k: u32| Influence {
        joint: (k % 9) as u8,
        weight: 0.375,
        last: k % 3 == 2,
    };
    let influences: Vec<_> = (0..300).map(influence).collect();
    let rows = influence_words(format, &influences);
    let skinned = skin_vertices(&a, &rest, &influences, &palette);
    let skinned = vector_words(format, &skinned);
    let base = prepared.image.vertices.len() as u64;
    let mut vertices = prepared.image.vertex_words();
    vertices.extend(vector_words(format, palette.as_flattened()));
    vertices.extend(vector_words(format, &rest));
    vertices.extend(vec![0; skinned.len()]);
    let mesh = Mesh {
        palette: base,
        joints: 9,
        influences: 0,
        rows: 75,
        rest: base + 36,
        vertices: 100,
        target: base + 136,
    };
    let target = (base as usize + 136) * 3;

    let plan = Plan::new(&config).unwrap();
    let machine = emit(&plan).unwrap();
    let sources = Sources::of(&machine.design);
    let built = build(&sources, &BuildOptions::default(), &|_| ()).unwrap();
    let mut model = Model::load(&built, &sources.ports).unwrap();
    model.reset(4);
    let nodes = prepared.image.node_words();
    let records = prepared.image.record_words();
    let ports = model.ports(&ports(&plan)).unwrap();
    let Ports { inputs, outputs } = ports;
    let mut memories = [
        (
            "node",
            outputs.node,
            inputs.node,
            &nodes,
            Record::node(format),
        ),
        (
            "record",
            outputs.record,
            inputs.record,
            &records,
            Record::triangle(),
        ),
        (
            "vertex",
            outputs.vertex,
            inputs.vertex,
            &vertices,
            Record::vertex(format),
        ),
        (
            "influence",
            outputs.influence,
            inputs.influence,
            &rows,
            Record::influence_row(format),
        ),
    ]
    .map(|(name, outputs, inputs, words, record)| {
        let handles = ReadHandles::of_unit(outputs, inputs);
        Memory::new(handles, name, words, &record, rng.u64(..))
    });

    model.set(inputs.scene_root, prepared.image.root.pack().into());
    let (lo, hi) = prepared.image.bounds;
    for i in 0..3 {
        model.set(inputs.scene_lo[i], format.to_bits(lo[i]));
        model.set(inputs.scene_hi[i], format.to_bits(hi[i]));
    }
    model.drive(&inputs.skin_start.payload, mesh);

    let (mut next_ray, mut hits_seen) = (0, 0);
    let mut places = vec![0; rays.len() / per_packet];
    let (mut asks, mut skinning, mut meshes, mut in_between) = (false, false, 0, 0);
    for clock in 0.. {
        assert!(clock < 2_000_000, "seed {seed}: the unit stands still");
        if hits_seen == rays.len() && !asks && !skinning {
            break;
        }
        asks |= !skinning && rng.u32(..300) == 0;
        model.set(inputs.skin_start.valid, asks.into());
        let offers = next_ray < rays.len() && rng.u8(..8) > 0;
        model.set(inputs.ray.valid, offers.into());
        if let Some(ray) = rays.get(next_ray) {
            let shown = hw::raycast::Ray {
                tag: (next_ray / per_packet) as u64,
                line: Line {
                    origin: ray.origin.map(|x| format.to_bits(x)),
                    direction: ray.direction.map(|x| format.to_bits(x)),
                },
                limits: Limits {
                    tmin: format.to_bits(ray.tmin),
                    tmax: format.to_bits(ray.tmax),
                },
                active: ray.active.into(),
                any_hit: ray.any_hit.into(),
            };
            model.drive(&inputs.ray.payload, shown);
        }
        let takes_hit = rng.u8(..4) > 0;
        model.set(inputs.hit_ready, takes_hit.into());
        let takes_write = rng.u8(..4) > 0;
        model.set(inputs.skin_write_ready, takes_write.into());
        for (memory, words) in memories.iter().zip([&nodes, &records, &vertices, &rows]) {
            memory.show(&mut model, words);
        }
        model.eval();

        if offers && model.get(outputs.ray_ready) != 0 {
            assert!(!asks && !skinning, "seed {seed}: a ray while a mesh waits");
            next_ray += 1;
        }
        if takes_hit && model.get(outputs.hit.valid) != 0 {
            assert!(!skinning, "seed {seed}: a hit while a mesh is skinned");
            let shown = model.sample(&outputs.hit.payload);
            let packet = shown.tag as usize;
            let hit = &hits[packet * per_packet + places[packet]];
            places[packet] += 1;
            hits_seen += 1;
            let number = |x| format.to_bits(x);
            let expected = [number(hit.t), number(hit.u), number(hit.v)];
            let shown = shown.hit;
            assert_eq!([shown.t, shown.u, shown.v], expected);
            assert_eq!(shown.triangle, u64::from(hit.triangle));
        }
        if asks && model.get(outputs.skin_start_ready) != 0 {
            let whole = next_ray / per_packet * per_packet;
            assert_eq!(hits_seen, whole, "seed {seed}: packets are under way");
            in_between += usize::from(next_ray > 0 && next_ray < rays.len());
            (asks, skinning) = (false, true);
            vertices[target..].fill(0);
        }
        if takes_write && model.get(outputs.skin_write.valid) != 0 {
            let at = model.get(outputs.skin_write.payload.address) as usize * 3;
            assert!(at >= target, "seed {seed}: a write outside");
            model.get_words(outputs.skin_write.payload.data, &mut vertices[at..at + 3]);
        }
        for memory in &mut memories {
            memory.step(&model);
        }
        model.clock();
        if model.get(outputs.skin_done) != 0 {
            assert_eq!(vertices[target..], skinned, "seed {seed}");
            skinning = false;
            meshes += 1;
        }
    }
    println!("{hits_seen} hits, {meshes} meshes, {in_between} of them amid the picture");
    assert!(in_between > 0, "seed {seed}: no mesh amid the picture");
}
