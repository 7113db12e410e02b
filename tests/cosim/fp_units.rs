//! The floating-point units in Verilog, compared with the model of the arithmetic in all bits.
//!
//! Operands: every pair of the special ones, random ones, all operands of a small format, and all operands of
//! units with one operand. Random tests print their seed; `DYNRT_SEED=… cargo test --test cosim fp_units::` repeats them.

use crate::support::seed;
use dynrt::cosim::model::{self, BuildOptions, Model, PortHandle, Sources};
use dynrt::float::{Format, plain, specials};
use dynrt::hdl::{Builder, Design, Direction, Module};
use dynrt::hw::fp::{self, Units};
use std::sync::Arc;

/// The slack of the machine's plane distances, in ulps.
const ULPS: i32 = 3;

/// The operation that is compared.
#[derive(Clone, Copy, PartialEq, Debug)]
enum Operation {
    Add,
    Sub,
    Mul,
    Reciprocal,
    Min,
    Max,
    Down,
    Up,
    /// Less, less or equal, equal; then whether `a` is NaN, zero, infinite: from the most significant bit down.
    Relations,
}

use Operation::{Add, Down, Max, Min, Mul, Reciprocal, Relations, Sub, Up};

const BINARY: &[Operation] = &[Add, Sub, Mul, Min, Max, Relations];
const UNARY: &[Operation] = &[Reciprocal, Down, Up];
const ALL: &[Operation] = &[Add, Sub, Mul, Reciprocal, Min, Max, Down, Up, Relations];

impl Operation {
    fn port(self) -> &'static str {
        match self {
            Add => "sum",
            Sub => "difference",
            Mul => "product",
            Reciprocal => "reciprocal",
            Min => "least",
            Max => "greatest",
            Down => "lower",
            Up => "higher",
            Relations => "relations",
        }
    }

    fn expected(self, format: Format, a: u64, b: u64) -> u64 {
        match self {
            Add => fp::add::model(format, a, b),
            Sub => fp::add::model_sub(format, a, b),
            Mul => fp::mul::model(format, a, b),
            Reciprocal => fp::reciprocal::model(format, a),
            Min => plain::min(format, a, b),
            Max => plain::max(format, a, b),
            Down => plain::step(format, a, -ULPS),
            Up => plain::step(format, a, ULPS),
            Relations => {
                let magnitude = a & !format.sign_bit();
                [
                    plain::less(format, a, b),
                    plain::less_equal(format, a, b),
                    plain::equal(format, a, b),
                    format.is_nan(a),
                    magnitude < format.least_normal(),
                    magnitude < format.infinity(),
                ]
                .iter()
                .fold(0, |bits, bit| bits << 1 | u64::from(*bit))
            }
        }
    }

    /// The result of the hardware as the model would give it: operations that pass an operand on keep its pattern.
    fn canonical(self, format: Format, bits: u64) -> u64 {
        match self {
            Min | Max | Down | Up => plain::canonical(format, bits),
            _ => bits,
        }
    }
}

/// Units of one format and clock target, with the same operands.
struct Bench {
    format: Format,
    clock_mhz: u32,
    top: Arc<Module>,
    operations: &'static [Operation],
}

const BENCH: &str = "unit_bench";

impl Bench {
    fn new(format: Format, clock_mhz: u32, operations: &'static [Operation]) -> Bench {
        let units = Units::new(format, clock_mhz).unwrap_or_else(|error| panic!("{error}"));
        let m = Builder::new(BENCH, "The floating-point units side by side.");
        let p = m.pipeline();
        let (a, b) = (p.input("a", format.width()), p.input("b", format.width()));
        for &operation in operations {
            let y = match operation {
                Add => units.add("adder", a, b),
                Sub => units.sub("subtractor", a, b),
                Mul => units.mul("multiplier", a, b),
                Reciprocal => units.reciprocal("divider", a),
                Min => fp::less(format, "lesser", b, a).mux(b, a).register(),
                Max => fp::less(format, "greater", a, b).mux(b, a).register(),
                Down => fp::step(format, a, -ULPS, |sum| sum).register(),
                Up => fp::step(format, a, ULPS, |sum| sum).register(),
                Relations => m
                    .concat(&[
                        fp::less(format, "less", a, b),
                        fp::less_equal(format, "less_equal", a, b),
                        fp::equal(format, "equal", a, b),
                        fp::is_nan(format, a),
                        fp::is_zero(format, a),
                        fp::is_finite(format, a),
                    ])
                    .register(),
            };
            m.output(operation.port(), y);
        }
        Bench {
            format,
            clock_mhz,
            top: m.finish().unwrap_or_else(|error| panic!("{error}")),
            operations,
        }
    }

    /// The bench's modules with `suffix` appended to their names, so several benches fit in one model.
    fn files(&self, suffix: &str) -> Vec<(String, String)> {
        let design = Design::new(self.top.clone()).unwrap_or_else(|error| panic!("{error}"));
        let names: Vec<&str> = design.modules().iter().map(|m| m.name()).collect();
        let renamed = |text: &str| {
            names.iter().fold(text.to_string(), |text, name| {
                text.replace(name, &format!("{name}{suffix}"))
            })
        };
        design
            .modules()
            .iter()
            .map(|m| (renamed(m.name()) + ".v", renamed(m.verilog())))
            .collect()
    }
}

fn port(name: String, width: u32, input: bool) -> model::Port {
    model::Port { name, width, input }
}

/// One module with several benches, with numbered ports and modules.
fn sources(benches: &[Bench]) -> Sources {
    let mut files = vec![];
    let mut ports = vec![port("clk".into(), 1, true)];
    let mut body = String::new();
    for (i, bench) in benches.iter().enumerate() {
        files.extend(bench.files(&format!("_{i}")));
        let mut connections = vec![];
        for inner in bench.top.ports() {
            let outer = match inner.name.as_str() {
                "clk" => "clk".to_string(),
                name => {
                    let outer = format!("{name}_{i}");
                    let input = inner.direction == Direction::Input;
                    ports.push(port(outer.clone(), inner.width, input));
                    outer
                }
            };
            connections.push(format!(".{}({outer})", inner.name));
        }
        body += &format!("  {BENCH}_{i} bench_{i} ({});\n", connections.join(", "));
    }
    let declarations: Vec<String> = ports
        .iter()
        .map(|p| {
            let direction = if p.input { "input" } else { "output" };
            format!("  {direction} wire [{}:0] {}", p.width - 1, p.name)
        })
        .collect();
    let top = format!(
        "module top (\n{}\n);\n{body}endmodule\n",
        declarations.join(",\n")
    )
    .replace("[0:0] ", "");
    files.push(("top.v".into(), top));
    Sources {
        top: "top".into(),
        files,
        ports,
    }
}

/// A running model of several benches.
struct Rig {
    model: Model,
    lanes: Vec<Lane>,
}

struct Lane {
    bench: Bench,
    a: PortHandle,
    b: PortHandle,
    /// Each output: its operation, its port, and its latency in cycles.
    outputs: Vec<(Operation, PortHandle, usize)>,
}

fn built(benches: &[Bench]) -> (model::Built, Sources) {
    let sources = sources(benches);
    let built = model::build(&sources, &BuildOptions::default(), &|_| ())
        .unwrap_or_else(|error| panic!("{error:#}"));
    (built, sources)
}

impl Rig {
    fn load(built: &model::Built, sources: &Sources, benches: Vec<Bench>) -> Rig {
        let model = Model::load(built, &sources.ports).unwrap_or_else(|error| panic!("{error:#}"));
        let lanes = benches
            .into_iter()
            .enumerate()
            .map(|(i, bench)| {
                let handle = |name: &str| model.port(&format!("{name}_{i}")).expect("a port");
                let outputs = bench
                    .operations
                    .iter()
                    .map(|&operation| {
                        let stage = bench.top.port(operation.port()).and_then(|p| p.stage);
                        let latency = stage.expect("an output has a stage") as usize;
                        (operation, handle(operation.port()), latency)
                    })
                    .collect();
                Lane {
                    a: handle("a"),
                    b: handle("b"),
                    outputs,
                    bench,
                }
            })
            .collect();
        Rig { model, lanes }
    }

    fn new(benches: Vec<Bench>) -> Rig {
        let (built, sources) = built(&benches);
        Rig::load(&built, &sources, benches)
    }

    /// Applies the operands of each lane, and compares all of its results. Returns the number of operand
    /// pairs that were compared in each lane.
    fn compare(
        &mut self,
        operands: Vec<impl Iterator<Item = (u64, u64)>>,
        replay: &str,
    ) -> Vec<u64> {
        const HISTORY: usize = 64;
        let Rig { model, lanes } = self;
        assert_eq!(operands.len(), lanes.len());
        let mut operands: Vec<_> = operands.into_iter().map(Iterator::fuse).collect();
        let mut history = vec![[(0, 0); HISTORY]; lanes.len()];
        // The number of pairs given to each lane.
        let mut given = vec![0usize; lanes.len()];
        let mut idle = 0;
        let mut clock = 0;
        while idle < HISTORY {
            let mut fed = false;
            for (i, lane) in lanes.iter().enumerate() {
                if let Some((a, b)) = operands[i].next() {
                    assert_eq!((a | b) >> lane.bench.format.width(), 0, "{a:#x}, {b:#x}");
                    model.set(lane.a, a);
                    model.set(lane.b, b);
                    history[i][clock % HISTORY] = (a, b);
                    given[i] = clock + 1;
                    fed = true;
                }
            }
            idle = if fed { 0 } else { idle + 1 };
            model.clock();
            clock += 1;
            for (i, lane) in lanes.iter().enumerate() {
                for &(operation, output, latency) in &lane.outputs {
                    assert!((1..HISTORY).contains(&latency));
                    if clock < latency || clock - latency >= given[i] {
                        continue;
                    }
                    let (a, b) = history[i][(clock - latency) % HISTORY];
                    let format = lane.bench.format;
                    let got = operation.canonical(format, model.get(output));
                    let expected = operation.expected(format, a, b);
                    if got != expected {
                        mismatch(&lane.bench, operation, a, b, got, expected, replay);
                    }
                }
            }
        }
        given.iter().map(|n| *n as u64).collect()
    }
}

fn mismatch(
    bench: &Bench,
    operation: Operation,
    a: u64,
    b: u64,
    got: u64,
    expected: u64,
    replay: &str,
) -> ! {
    let format = bench.format;
    let show = |bits| format!("{bits:#x} ({:e})", format.to_f64(bits));
    let (got, expected) = match operation {
        Relations => (format!("{got:06b}"), format!("{expected:06b}")),
        _ => (show(got), show(expected)),
    };
    panic!(
        "{operation:?} in {format} at {} MHz of a = {}, b = {} gives {got}, not {expected}; replay: {replay}",
        bench.clock_mhz,
        show(a),
        show(b),
    );
}

fn replay(seed: u64, test: &str) -> String {
    let command = format!("DYNRT_SEED={seed} cargo test --test cosim fp_units::{test}");
    println!("replay: {command}");
    command
}

/// Random pairs, half of which have related operands.
fn random_pairs(format: Format, seed: u64, count: usize) -> impl Iterator<Item = (u64, u64)> {
    let mut random = fastrand::Rng::with_seed(seed);
    let f = format.fraction_bits();
    let all = (1 << format.width()) - 1;
    let (one, greatest) = (format.one(), format.greatest());
    (0..count).map(move |i| {
        let a = random.u64(0..=all);
        let b = match i % 4 {
            // Similar magnitudes with either sign: cancellation and alignment.
            0 => a.wrapping_add(random.u64(0..2 << f)).wrapping_sub(1 << f),
            1 => a ^ (random.u64(..) & ((1 << random.u32(0..=f)) - 1)) ^ format.sign_bit(),
            // Magnitudes near the inverse of the ends of the range: products near the limits.
            2 => {
                let inverse = (2 * one).wrapping_sub(a & (format.sign_bit() - 1));
                let end = if random.bool() { one } else { greatest - one };
                inverse
                    .wrapping_add(end)
                    .wrapping_add(random.u64(0..4 << f))
                    .wrapping_sub(2 * one)
            }
            _ => random.u64(..),
        };
        (a, b & all)
    })
}

/// All pairs of at most 2^16 operands.
fn pairs(list: Vec<u64>) -> impl Iterator<Item = (u64, u64)> {
    let n = list.len();
    (0..n * n).map(move |i| (list[i / n], list[i % n]))
}

fn directed(format: Format) -> impl Iterator<Item = (u64, u64)> {
    let mut cases = fp::add::directed_cases(format);
    cases.extend(fp::mul::directed_cases(format));
    cases.extend(
        fp::reciprocal::directed_cases(format)
            .iter()
            .map(|a| (*a, *a)),
    );
    assert!(
        cases.len() > 100,
        "{format}: {} directed cases",
        cases.len()
    );
    cases.into_iter()
}

fn format(exponent_bits: u32, fraction_bits: u32) -> Format {
    Format::new(exponent_bits, fraction_bits).expect("a format in range")
}

/// The compared formats and clock targets in addition to the reference: the ends of every range.
fn others() -> Vec<(Format, u32)> {
    let mut list: Vec<_> = [10, 50, 66, 133, 200].map(|mhz| (Format::FP24, mhz)).into();
    list.extend([
        (format(8, 23), 100),
        (format(10, 23), 66),
        (format(3, 2), 100),
        (format(4, 5), 133),
        (format(10, 2), 100),
        (format(3, 23), 133),
        (format(10, 23), 400),
        (format(3, 2), 10),
    ]);
    list
}

#[test]
fn all_pairs_of_special_operands() {
    let list = specials(Format::FP24);
    assert!(list.len() >= 2000);
    let least = (list.len() * list.len()) as u64;
    let mut rig = Rig::new(vec![Bench::new(Format::FP24, 100, BINARY)]);
    let operands = directed(Format::FP24).chain(pairs(list));
    let compared = rig.compare(
        vec![operands],
        "cargo test --test cosim fp_units::all_pairs_of_special_operands",
    )[0];
    assert!(compared > least);
    println!("{compared} pairs of special operands, {BINARY:?}");
}

#[test]
fn random_operands() {
    const COUNT: usize = 2_000_000;
    let seed = seed();
    let replay = replay(seed, "random_operands");
    let mut rig = Rig::new(vec![Bench::new(Format::FP24, 100, BINARY)]);
    let operands = random_pairs(Format::FP24, seed, COUNT);
    let compared = rig.compare(vec![operands], &replay)[0];
    assert_eq!(compared, COUNT as u64);
    println!("{compared} random pairs, {BINARY:?}");
}

#[test]
fn all_operands_of_one() {
    const PARTS: u64 = 4;
    let bench = || vec![Bench::new(Format::FP24, 100, UNARY)];
    let (library, sources) = built(&bench());
    let part = (1 << Format::FP24.width()) / PARTS;
    let compared: u64 = std::thread::scope(|scope| {
        let threads: Vec<_> = (0..PARTS)
            .map(|i| {
                let (library, sources) = (&library, &sources);
                scope.spawn(move || {
                    let operands = (i * part..(i + 1) * part).map(|a| (a, 0));
                    Rig::load(library, sources, bench()).compare(
                        vec![operands],
                        "cargo test --test cosim fp_units::all_operands_of_one",
                    )[0]
                })
            })
            .collect();
        threads
            .into_iter()
            .map(|thread| {
                thread
                    .join()
                    .unwrap_or_else(|panic| std::panic::resume_unwind(panic))
            })
            .sum()
    });
    assert_eq!(compared, 1 << 24);
    println!("{compared} operands, {UNARY:?}");
}

#[test]
fn all_pairs_of_a_small_format() {
    let small = format(4, 5);
    let mut rig = Rig::new(vec![Bench::new(small, 100, ALL)]);
    let compared = rig.compare(
        vec![pairs((0..1 << small.width()).collect())],
        "cargo test --test cosim fp_units::all_pairs_of_a_small_format",
    )[0];
    assert_eq!(compared, 1 << 20);
    println!("{compared} pairs in {small}, {ALL:?}");
}

#[test]
fn other_formats_and_clocks() {
    const RANDOM: usize = 100_000;
    const SPECIALS: usize = 400;
    let seed = seed();
    let replay = replay(seed, "other_formats_and_clocks");
    let benches: Vec<Bench> = others()
        .into_iter()
        .map(|(format, mhz)| Bench::new(format, mhz, ALL))
        .collect();
    let operands = benches
        .iter()
        .map(|bench| {
            let mut list = specials(bench.format);
            fastrand::Rng::with_seed(seed).shuffle(&mut list);
            list.truncate(SPECIALS);
            directed(bench.format)
                .chain(pairs(list))
                .chain(random_pairs(bench.format, seed, RANDOM))
        })
        .collect();
    let names: Vec<String> = benches
        .iter()
        .map(|b| format!("{} at {} MHz", b.format, b.clock_mhz))
        .collect();
    let compared = Rig::new(benches).compare(operands, &replay);
    for (name, compared) in names.iter().zip(compared) {
        println!("{compared} pairs in {name}, {ALL:?}");
        assert!(compared > RANDOM as u64);
    }
}

#[test]
fn tools_accept_every_unit() {
    let mut configurations = others();
    configurations.push((Format::FP24, 100));
    let mut units = 0;
    for (format, mhz) in configurations {
        let bench = Bench::new(format, mhz, ALL);
        let ports = bench.top.ports().iter();
        let sources = Sources {
            top: BENCH.into(),
            files: bench.files(""),
            ports: ports
                .map(|p| port(p.name.clone(), p.width, p.direction == Direction::Input))
                .collect(),
        };
        model::lint(&sources).unwrap_or_else(|error| panic!("{format} at {mhz} MHz: {error:#}"));
        units += sources.files.len() - 1;
    }
    println!("{units} units linted");
    assert!(units >= 4 * 12);
}

#[test]
fn latencies_are_those_documented() {
    // The table in the documentation of `dynrt::hw::fp`.
    let table = include_str!("../../src/hw/fp/mod.rs");
    let mut rows = 0;
    for mhz in [50, 66, 100, 133, 200] {
        let format = Format::FP24;
        let units = Units::new(format, mhz).unwrap_or_else(|error| panic!("{error}"));
        let latency = |module: &Module| module.latency().expect("a unit is a pipeline");
        let (add, mul) = (latency(&units.add), latency(&units.mul));
        let reciprocal = latency(&units.reciprocal);
        assert_eq!(add, fp::add::latency(format, mhz));
        assert_eq!(add, latency(&units.sub));
        assert_eq!(mul, fp::mul::latency(format, mhz));
        assert_eq!(reciprocal, fp::reciprocal::latency(format, mhz));
        let row = format!("//! | {mhz} | {add} | {mul} | {reciprocal} |");
        assert!(table.contains(&row), "the table should have: {row}");
        rows += 1;
    }
    assert_eq!(rows, 5);
}
