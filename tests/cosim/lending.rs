//! The triangle test as a separate module: tests of triangles, matrices applied to points and sums, in random
//! order, one per cycle, compared with the model of the arithmetic and the golden triangle test in all bits.
//!
//! Random tests print their seed; `DYNRT_SEED=… cargo test --test cosim lending::` repeats them.

use crate::support::seed;
use dynrt::config::{Config, TriangleTest};
use dynrt::cosim::model::{self, BuildOptions, Model, PortHandle, Sources};
use dynrt::float::{Arithmetic, Format, plain, specials};
use dynrt::golden::{RaySetup, Triangle, WHOLE_LINE};
use dynrt::hdl::{Design, Direction, Module};
use dynrt::hw::{Plan, geometry};
use dynrt::port::Ray;
use std::collections::VecDeque;
use std::sync::Arc;

const AXES: [&str; 3] = ["x", "y", "z"];
/// Number of pairs that are added in parallel.
const PAIRS: usize = 6;

fn config(test: TriangleTest, (exponent, fraction): (u32, u32), clock_mhz: u32) -> Config {
    let mut config = Config::reference();
    config.triangle_test = test;
    config.exponent_bits = exponent;
    config.fraction_bits = fraction;
    config.clock_mhz = clock_mhz;
    config
}

fn triangle_test(config: &Config) -> Arc<Module> {
    let plan = Plan::new(config).unwrap_or_else(|error| panic!("{error}"));
    geometry::module(&plan)
        .unwrap_or_else(|error| panic!("{error}"))
        .test
}

/// A port, and the cycle after the first one of a slot in which it has the slot's value.
struct TimedPort {
    name: String,
    width: u32,
    stage: usize,
    handle: PortHandle,
}

/// The inputs and the expected outputs of one slot.
struct Slot {
    inputs: Vec<u64>,
    /// `None` if the output is undefined.
    outputs: Vec<Option<u64>>,
}

/// Numbers of comparisons by kind.
#[derive(Debug, Default)]
struct Counts {
    hits: u32,
    misses: u32,
    /// Tests of a triangle with a NaN in a vertex.
    nans: u32,
    /// Hits that were moved only by a window.
    moved_into_window: u32,
    matrices: u32,
    /// Transformed points with a component that is neither zero nor infinity nor NaN.
    ordinary_points: u32,
    sums: u32,
    /// A test right after a matrix, or the reverse.
    turns: u32,
    compared: u64,
}

struct Rig {
    test: TriangleTest,
    a: Arithmetic,
    model: Model,
    inputs: Vec<TimedPort>,
    outputs: Vec<TimedPort>,
    odd: Vec<u64>,
    rng: fastrand::Rng,
    counts: Counts,
}

impl Rig {
    fn new(config: &Config, seed: u64) -> Rig {
        let module = triangle_test(config);
        let design = Design::new(module.clone()).unwrap_or_else(|error| panic!("{error}"));
        let sources = Sources {
            top: module.name().into(),
            files: design.files(),
            ports: module
                .ports()
                .iter()
                .map(|p| model::Port {
                    name: p.name.clone(),
                    width: p.width,
                    input: p.direction == Direction::Input,
                })
                .collect(),
        };
        model::lint(&sources).unwrap_or_else(|error| panic!("{error:#}"));
        let built = model::build(&sources, &BuildOptions::default(), &|_| ())
            .unwrap_or_else(|error| panic!("{error:#}"));
        let model = Model::load(&built, &sources.ports).unwrap_or_else(|error| panic!("{error:#}"));
        let ports = |direction| -> Vec<TimedPort> {
            let of = module.ports().iter().filter(|p| p.direction == direction);
            of.filter(|p| p.name != "clk")
                .map(|p| TimedPort {
                    name: p.name.clone(),
                    width: p.width,
                    stage: p.stage.expect("every port has a stage") as usize,
                    handle: model.port(&p.name).expect("a port"),
                })
                .collect()
        };
        let format = config.format();
        Rig {
            test: config.triangle_test,
            a: Arithmetic::new(format),
            inputs: ports(Direction::Input),
            outputs: ports(Direction::Output),
            odd: specials(format),
            rng: fastrand::Rng::with_seed(seed),
            counts: Counts::default(),
            model,
        }
    }

    fn format(&self) -> Format {
        self.a.format()
    }

    /// A number of the format: mostly of a scene's magnitude, sometimes any pattern or a special value.
    fn number(&mut self) -> f64 {
        let format = self.format();
        match self.rng.u32(0..24) {
            0 => {
                let i = self.rng.usize(0..self.odd.len());
                format.to_f64(self.odd[i])
            }
            1 => format.to_f64(self.rng.u64(0..1 << format.width())),
            2 => f64::from(self.rng.i32(-2..=2)),
            _ => self.a.round(self.rng.f64() * 4.0 - 2.0),
        }
    }

    fn vector(&mut self) -> [f64; 3] {
        [(); 3].map(|()| self.number())
    }

    /// A slot with random contents.
    fn noise(&mut self) -> Slot {
        let rng = &mut self.rng;
        Slot {
            inputs: self
                .inputs
                .iter()
                .map(|p| rng.u64(..) >> (64 - p.width))
                .collect(),
            outputs: vec![None; self.outputs.len()],
        }
    }

    fn give_bits(&self, slot: &mut Slot, name: &str, bits: u64) {
        let port = self.inputs.iter().position(|p| p.name == name);
        slot.inputs[port.unwrap_or_else(|| panic!("there is no input {name}"))] = bits;
    }

    fn give(&self, slot: &mut Slot, name: &str, number: f64) {
        self.give_bits(slot, name, self.format().to_bits(number));
    }

    fn give_vector(&self, slot: &mut Slot, name: &str, vector: [f64; 3]) {
        for (x, number) in AXES.iter().zip(vector) {
            self.give(slot, &format!("{name}_{x}"), number);
        }
    }

    fn expect_bits(&self, slot: &mut Slot, name: &str, bits: u64) {
        let port = self.outputs.iter().position(|p| p.name == name);
        slot.outputs[port.unwrap_or_else(|| panic!("there is no output {name}"))] = Some(bits);
    }

    fn expect(&self, slot: &mut Slot, name: &str, number: f64) {
        self.expect_bits(slot, name, self.format().to_bits(number));
    }

    /// A ray and a triangle that is often near the ray, sometimes with a window.
    fn test_slot(&mut self) -> Slot {
        let mut slot = self.noise();
        // Only valid rays are tested: 0 <= tmin <= tmax.
        let tmin = match self.rng.bool() {
            true => 0.0,
            false => self.number().abs(),
        };
        let ray = Ray {
            origin: self.vector(),
            direction: self.vector(),
            tmin,
            tmax: match self.rng.bool() {
                true => f64::INFINITY,
                false => self.number().abs().max(tmin),
            },
            active: true,
            any_hit: false,
        };
        let t = self.rng.f64() * 2.0;
        let mut vertices = [(); 3].map(|()| self.vector());
        if self.rng.u32(0..4) > 0 {
            for vertex in &mut vertices {
                for (i, component) in vertex.iter_mut().enumerate() {
                    let at = ray.origin[i] + t * ray.direction[i];
                    *component = self.a.round(at + *component);
                }
            }
        }
        let setup = RaySetup::new(&self.a, &ray);
        let window = match self.rng.u32(0..3) {
            0 => WHOLE_LINE,
            1 => {
                // Near the intersection of the ray with the triangle.
                let near = t + self.rng.f64() - 0.75;
                [near, near + self.rng.f64()].map(|x| self.a.round(x))
            }
            // Any number but NaN: a window starts at infinity, and a NaN does not clip.
            _ => [self.number(), self.number()].map(|x| if x.is_nan() { 0.0 } else { x }),
        };
        // It is a result of operators, which is never -0.
        let window = window.map(|x| if x == 0.0 { 0.0 } else { x });
        self.give_bits(&mut slot, "matrix", 0);
        self.give_bits(&mut slot, "accumulate", 0);
        for (i, vertex) in vertices.iter().enumerate() {
            self.give_vector(&mut slot, &format!("v{i}"), *vertex);
        }
        self.give_vector(&mut slot, "origin", setup.origin);
        self.give_vector(&mut slot, "reciprocal", setup.reciprocal);
        let signs = (0..3).fold(0, |bits, i| bits | u64::from(setup.negative[i]) << i);
        self.give_bits(&mut slot, "signs", signs);
        match self.test {
            TriangleTest::MollerTrumbore => {
                self.give_vector(&mut slot, "direction", setup.direction);
            }
            TriangleTest::Watertight => {
                self.give_bits(&mut slot, "kz", u64::from(setup.shear.axes[2]));
                self.give_vector(&mut slot, "shear", setup.shear.scale);
            }
        }
        self.give(&mut slot, "window_near", window[0]);
        self.give(&mut slot, "window_far", window[1]);
        self.give(&mut slot, "tmin", setup.tmin);
        self.give(&mut slot, "tmax", setup.tmax);

        let triangle = Triangle::new(vertices, 0);
        let outcome = triangle.intersect::<true>(&self.a, self.test, &setup, window);
        // A NaN has no box; the only requirement is that the ray misses.
        if vertices.iter().flatten().any(|x| x.is_nan()) {
            assert!(!outcome.hit, "a hit of a triangle with a NaN: {vertices:?}");
            self.counts.nans += 1;
        } else {
            self.expect(&mut slot, "box_near", outcome.near);
            self.expect(&mut slot, "box_far", outcome.far);
        }
        self.expect_bits(&mut slot, "hit", u64::from(outcome.hit));
        self.expect(&mut slot, "u", outcome.raw[1]);
        self.expect(&mut slot, "v", outcome.raw[2]);
        if outcome.hit {
            self.expect(&mut slot, "t", outcome.t);
            self.counts.hits += 1;
            let whole = triangle.intersect::<true>(&self.a, self.test, &setup, WHOLE_LINE);
            self.counts.moved_into_window += u32::from(whole.t != outcome.t);
        } else {
            self.counts.misses += 1;
        }
        slot
    }

    /// A matrix applied to a point, as in *Two levels* and *Skinning*; sometimes with unrelated sums.
    fn matrix_slot(&mut self) -> Slot {
        let mut slot = self.noise();
        let a = self.a;
        let columns = [(); 3].map(|()| self.vector());
        let translation = self.vector();
        let point = self.vector();
        let weight = self.number();
        self.give_bits(&mut slot, "matrix", 1);
        for (i, column) in columns.iter().enumerate() {
            self.give_vector(&mut slot, &format!("v{i}"), *column);
        }
        self.give_vector(&mut slot, "origin", point);
        self.give_vector(&mut slot, "translation", translation);
        self.give(&mut slot, "weight", weight);
        self.counts.matrices += 1;
        for (i, x) in AXES.iter().enumerate() {
            let [by_x, by_y, by_z] = [0, 1, 2].map(|j: usize| a.mul(columns[j][i], point[j]));
            let moved = a.add(a.add(a.add(by_x, by_y), by_z), translation[i]);
            self.expect(&mut slot, &format!("moved_{x}"), moved);
            self.expect(&mut slot, &format!("weighted_{x}"), a.mul(moved, weight));
            self.counts.ordinary_points += u32::from(moved.is_normal());
        }
        let accumulate = self.rng.bool();
        self.give_bits(&mut slot, "accumulate", u64::from(accumulate));
        for k in (0..PAIRS).filter(|_| accumulate) {
            let (first, second) = (self.number(), self.number());
            self.give(&mut slot, &format!("sum_a_{k}"), first);
            self.give(&mut slot, &format!("sum_b_{k}"), second);
            self.expect(&mut slot, &format!("sum_{k}"), a.add(first, second));
            self.counts.sums += 1;
        }
        slot
    }

    /// Runs slots of random kinds, one per cycle, and compares every defined output.
    fn run(&mut self, slots: usize, what: &str) {
        let ports = self.inputs.iter().chain(&self.outputs);
        let depth = ports.map(|p| p.stage).max().expect("ports") + 1;
        // The newest slot first.
        let mut history: VecDeque<Slot> = VecDeque::new();
        let mut was_matrix = false;
        for clock in 0..slots + depth {
            let is_matrix = self.rng.bool();
            let slot = match (clock < slots, is_matrix) {
                (false, _) => self.noise(),
                (true, true) => self.matrix_slot(),
                (true, false) => self.test_slot(),
            };
            self.counts.turns += u32::from(is_matrix != was_matrix);
            was_matrix = is_matrix;
            history.push_front(slot);
            history.truncate(depth);
            for (i, port) in self.inputs.iter().enumerate() {
                if let Some(slot) = history.get(port.stage) {
                    self.model.set(port.handle, slot.inputs[i]);
                }
            }
            self.model.clock();
            for (i, port) in self.outputs.iter().enumerate() {
                let slot = history.get(port.stage - 1);
                let Some(expected) = slot.and_then(|slot| slot.outputs[i]) else {
                    continue;
                };
                let format = self.a.format();
                let bits = self.model.get(port.handle);
                let got = match port.width {
                    1 => bits,
                    _ => plain::canonical(format, bits),
                };
                self.counts.compared += 1;
                if got != expected {
                    let given: Vec<String> = self
                        .inputs
                        .iter()
                        .zip(&slot.expect("it is expected").inputs)
                        .map(|(port, bits)| format!("{} {bits:#x}", port.name))
                        .collect();
                    panic!(
                        "{what}: {} of the slot of clock {} is {got:#x}, not {expected:#x}; inputs: {}",
                        port.name,
                        clock + 1 - port.stage,
                        given.join(", ")
                    );
                }
            }
        }
    }
}

fn compare(test: TriangleTest) {
    const SLOTS: usize = 50_000;
    let seed = seed();
    // The reference; a narrow and a wide format; clock targets with none, some and all of the registers after multiplexers.
    for (format, clock_mhz) in [((7, 16), 100), ((5, 9), 50), ((8, 23), 133)] {
        let config = config(test, format, clock_mhz);
        let what = format!(
            "{test:?}, {} at {clock_mhz} MHz, seed {seed}",
            config.format()
        );
        let mut rig = Rig::new(&config, seed);
        rig.run(SLOTS, &what);
        println!("{what}: {:?}", rig.counts);
        let Counts {
            hits,
            misses,
            nans,
            moved_into_window,
            matrices,
            ordinary_points,
            sums,
            turns,
            compared,
        } = rig.counts;
        let least = (SLOTS / 100) as u32;
        assert!(
            hits > least && misses > least && nans > least / 10 && moved_into_window > least / 10
        );
        assert!(matrices > 10 * least && ordinary_points > 10 * least && sums > 10 * least);
        assert!(turns > 10 * least && compared > SLOTS as u64);
    }
}

#[test]
fn moller_trumbore_lends_its_operators() {
    compare(TriangleTest::MollerTrumbore);
}

#[test]
fn watertight_lends_its_operators() {
    compare(TriangleTest::Watertight);
}

#[test]
fn lending_takes_no_operator_more() {
    // The operators of the tests and of the plane distances of a box, by `docs/arithmetic.md`.
    let cases = [
        (
            TriangleTest::MollerTrumbore,
            // Two cross products, four dot products, three products with i; three differences; u + v.
            [2 * 6 + 4 * 3 + 3 + 6, 4 * 2 + 1, 3 * 3 + 2 * 3 + 6],
        ),
        (
            TriangleTest::Watertight,
            // Shears, edge functions, T, T i and Sz, u and v; three differences.
            [3 * 2 + 3 * 2 + 3 + 2 + 2 + 6, 2 + 2, 3 * 3 + 3 * 2 + 3 + 6],
        ),
    ];
    for (test, expected) in cases {
        let module = triangle_test(&config(test, (7, 16), 100));
        let design = Design::new(module).unwrap_or_else(|error| panic!("{error}"));
        let count = |operator: &str| -> usize {
            let start = format!("{operator} ");
            let modules = design.modules().iter();
            modules
                .flat_map(|m| m.verilog().lines())
                .filter(|line| line.trim_start().starts_with(&start))
                .count()
        };
        let counted = ["fp_mul", "fp_add", "fp_sub"].map(count);
        assert_eq!(counted, expected, "{test:?}: mul, add, sub");
    }
}
