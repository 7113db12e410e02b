//! Verilator models: building, caching and driving them; properties of the memory models.

#[path = "../examples/counter.rs"]
mod counter;

use dynrt_verilated::seed::of_run as seed;
use std::cell::RefCell;
use std::collections::{HashMap, VecDeque};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::LazyLock;
use std::thread;

use dynrt_verilated::memory::{
    Bandwidth, Image, RandomStall, ReadPort, ReadRequest, StreamSource, Timing, WritePort,
    WriteRequest,
};
use dynrt_verilated::model::{BuildOptions, Built, Model, Port, Sources, build, lint};

/// The cache of this test run; models are removed from it when the run begins.
static CACHE: LazyLock<PathBuf> = LazyLock::new(|| {
    let cache = Path::new(env!("CARGO_TARGET_TMPDIR")).join("model-cache");
    let _ = fs::remove_dir_all(cache.join("models"));
    let _ = fs::remove_dir_all(cache.join("failed"));
    cache
});

fn options() -> BuildOptions {
    BuildOptions {
        cache: Some(CACHE.clone()),
        ..BuildOptions::default()
    }
}

fn input(name: &str, width: u32) -> Port {
    Port {
        name: name.into(),
        width,
        input: true,
    }
}

fn output(name: &str, width: u32) -> Port {
    Port {
        name: name.into(),
        width,
        input: false,
    }
}

/// A module with ports of every storage class of Verilator, registered and combinational outputs, and an instance in a second file.
fn mixer(comment: &str) -> Sources {
    let mixer = format!(
        "// {comment}
`default_nettype none
module mixer (
    input  wire         clk,
    input  wire         rst,
    input  wire [4:0]   a5,
    input  wire [11:0]  a12,
    input  wire [31:0]  a32,
    input  wire [39:0]  a__40,
    input  wire [99:0]  a100,
    output wire [40:0]  sum_now,
    output reg  [40:0]  sum_next,
    output wire [99:0]  inverse_now,
    output wire [99:0]  wide_next,
    output reg  [15:0]  count
);
    assign sum_now     = {{1'b0, a__40}} + {{9'b0, a32}} + {{29'b0, a12}} + {{36'b0, a5}};
    assign inverse_now = ~a100;

    keep #(.WIDTH(100)) kept (.clk(clk), .d(a100), .q(wide_next));

    always @(posedge clk) begin
        sum_next <= sum_now;
        if (rst) count <= 16'd0;
        else     count <= count + 16'd1;
    end
endmodule
`default_nettype wire
"
    );
    let keep = "`default_nettype none
module keep #(
    parameter WIDTH = 1
) (
    input  wire             clk,
    input  wire [WIDTH-1:0] d,
    output reg  [WIDTH-1:0] q
);
    always @(posedge clk) q <= d;
endmodule
`default_nettype wire
";
    Sources {
        top: "mixer".into(),
        files: vec![("mixer.v".into(), mixer), ("keep.v".into(), keep.into())],
        ports: vec![
            input("clk", 1),
            input("rst", 1),
            input("a5", 5),
            input("a12", 12),
            input("a32", 32),
            input("a__40", 40),
            input("a100", 100),
            output("sum_now", 41),
            output("sum_next", 41),
            output("inverse_now", 100),
            output("wide_next", 100),
            output("count", 16),
        ],
    }
}

fn built(sources: &Sources, options: &BuildOptions) -> Built {
    build(sources, options, &|_| ()).unwrap_or_else(|error| panic!("{error:#}"))
}

fn error<T>(result: anyhow::Result<T>) -> String {
    let message = format!("{:#}", result.err().expect("an error"));
    assert!(!message.contains('\n'), "more than one line: {message}");
    message
}

#[test]
fn values_reach_ports_of_every_width() {
    let sources = mixer("values");
    let mut model = Model::load(&built(&sources, &options()), &sources.ports).unwrap();
    let handle = |model: &Model, name: &str| model.port(name).unwrap();
    let [a5, a12, a32, a40, a100] =
        ["a5", "a12", "a32", "a__40", "a100"].map(|name| handle(&model, name));
    let [sum_now, sum_next, inverse_now, wide_next, count] =
        ["sum_now", "sum_next", "inverse_now", "wide_next", "count"]
            .map(|name| handle(&model, name));

    model.reset(3);
    assert_eq!((model.cycles(), model.get(count)), (3, 0));
    let mut rng = fastrand::Rng::with_seed(seed());
    let mut previous_sum = model.get(sum_next);
    for round in 0..1000 {
        // Bits above the port's width must not reach it.
        let values: [u64; 4] = std::array::from_fn(|_| rng.u64(..));
        for (port, value) in [a5, a12, a32, a40].into_iter().zip(values) {
            model.set(port, value);
        }
        let wide: [u32; 4] = std::array::from_fn(|_| rng.u32(..));
        model.set_words(a100, &wide);
        let wide = u128::from_le_bytes(wide.map(u32::to_le_bytes).concat().try_into().unwrap())
            & ((1 << 100) - 1);
        let sum: u64 = [5, 12, 32, 40]
            .iter()
            .zip(values)
            .map(|(width, value)| value & ((1 << width) - 1))
            .sum();

        model.eval();
        assert_eq!(model.get(sum_now), sum);
        assert_eq!(
            model.get(sum_next),
            previous_sum,
            "a register changed without a clock"
        );
        assert_eq!(model.get(a12), values[1] & 0xfff);
        let mut words = [0xdead_beef; 5];
        model.get_words(inverse_now, &mut words);
        let inverse = !wide & ((1 << 100) - 1);
        assert_eq!(
            words,
            [0, 32, 64, 96, 128].map(|bit| inverse.checked_shr(bit).unwrap_or(0) as u32)
        );

        model.clock();
        assert_eq!(model.get(sum_next), sum);
        assert_eq!(model.get(wide_next), wide as u64);
        assert_eq!(model.get(count), u64::max(round, 1));
        let width = rng.u32(1..=64);
        let lsb = rng.u32(0..=100 - width);
        let mask = u64::MAX >> (64 - width);
        assert_eq!(
            model.get_field(wide_next, lsb, width),
            (wide >> lsb) as u64 & mask,
            "{width} bits from {lsb}"
        );

        let field = rng.u64(..);
        model.set_field(a100, lsb, width, field);
        model.set_field(a12, 3, 5, field);
        model.clock();
        let changed = wide & !(u128::from(mask) << lsb) | u128::from(field & mask) << lsb;
        let mut words = [0; 4];
        model.get_words(wide_next, &mut words);
        assert_eq!(
            words,
            [0, 32, 64, 96].map(|bit| (changed >> bit) as u32),
            "{width} bits from {lsb}"
        );
        let twelve = values[1] & 0xfff & !0xf8 | (field & 0x1f) << 3;
        assert_eq!(model.get(a12), twelve);
        model.set(a100, u64::MAX);
        model.reset(1);
        assert_eq!(
            (
                model.get(count),
                model.get(wide_next),
                model.get_field(wide_next, 64, 36)
            ),
            (0, u64::MAX, 0)
        );
        model.run(round);
        previous_sum = model.get(sum_next);
    }
    assert!(
        error(model.port("a13").map(|_| ())).contains("no port `a13`; its ports are clk, rst, a5")
    );
}

#[test]
fn models_share_nothing_and_run_in_threads() {
    let sources = mixer("threads");
    let built = built(&sources, &options());
    let counts: Vec<u64> = thread::scope(|scope| {
        let models: Vec<_> = (1..=4)
            .map(|n| (n, Model::load(&built, &sources.ports).unwrap()))
            .collect();
        let running: Vec<_> = models
            .into_iter()
            .map(|(n, mut model)| {
                scope.spawn(move || {
                    let count = model.port("count").unwrap();
                    model.reset(2);
                    (0..1000 * n).for_each(|_| model.clock());
                    model.get(count)
                })
            })
            .collect();
        running
            .into_iter()
            .map(|thread| thread.join().unwrap())
            .collect()
    });
    assert_eq!(counts, [1000, 2000, 3000, 4000]);
}

#[test]
fn a_combinational_module_needs_neither_clock_nor_reset() {
    let text =
        "module parity (input wire [69:0] a, output wire p);\n    assign p = ^a;\nendmodule\n";
    let sources = Sources {
        top: "parity".into(),
        files: vec![("parity.v".into(), text.into())],
        ports: vec![output("p", 1), input("a", 70)],
    };
    lint(&sources).unwrap();
    let mut model = Model::load(&built(&sources, &options()), &sources.ports).unwrap();
    let (a, p) = (model.port("a").unwrap(), model.port("p").unwrap());
    model.reset(1);
    for bit in 0..70 {
        model.set_field(a, bit, 1, 1);
        model.eval();
        assert_eq!(model.get(p), u64::from(bit % 2 == 0));
    }
}

#[test]
fn the_same_model_is_built_once_and_a_changed_one_again() {
    let sources = mixer("cache");
    let said = RefCell::new(Vec::new());
    let say = |line: &str| said.borrow_mut().push(line.to_owned());
    let first = build(&sources, &options(), &say).unwrap();
    assert!(!first.reused && first.build_seconds > 0.0);
    assert!(
        said.borrow()
            .iter()
            .any(|line| line.contains("verilating mixer")),
        "{said:?}"
    );
    said.borrow_mut().clear();
    let second = build(&sources, &options(), &say).unwrap();
    assert!(second.reused && second.library == first.library && said.borrow().is_empty());

    let mut renamed = sources.clone();
    renamed.files[1].0 = "kept.v".into();
    let changed = [
        (mixer("cache, changed"), options()),
        (renamed, options()),
        (
            sources.clone(),
            BuildOptions {
                opt: "-O2".into(),
                ..options()
            },
        ),
    ];
    let mut libraries = vec![first.library];
    for (sources, options) in changed {
        let built = built(&sources, &options);
        assert!(!built.reused && !libraries.contains(&built.library));
        Model::load(&built, &sources.ports).unwrap();
        libraries.push(built.library);
    }
}

#[test]
fn a_model_that_is_not_to_be_kept_has_its_own_folder() {
    let sources = mixer("elsewhere");
    let models = tempfile::tempdir().unwrap();
    let options = BuildOptions {
        models: Some(models.path().join("new")),
        ..options()
    };
    let elsewhere = built(&sources, &options);
    assert!(!elsewhere.reused && elsewhere.library.starts_with(models.path()));
    Model::load(&elsewhere, &sources.ports).unwrap();
    assert!(built(&sources, &options).reused);
    // What is not the model's alone is kept in the cache.
    assert_eq!(fs::read_dir(models.path().join("new")).unwrap().count(), 1);
    assert!(!built(&sources, &self::options()).reused);
}

#[test]
fn processes_and_threads_build_the_same_model_at_once() {
    const CHILD: &str = "DYNRT_TEST_CHILD_CACHE";
    let sources = mixer("at once");
    if let Ok(cache) = std::env::var(CHILD) {
        let options = BuildOptions {
            cache: Some(cache.into()),
            ..BuildOptions::default()
        };
        Model::load(&built(&sources, &options), &sources.ports).unwrap();
        return;
    }
    let children: Vec<_> = (0..2)
        .map(|_| {
            Command::new(std::env::current_exe().unwrap())
                .args([
                    "--exact",
                    "processes_and_threads_build_the_same_model_at_once",
                ])
                .env(CHILD, &*CACHE)
                .spawn()
                .unwrap()
        })
        .collect();
    thread::scope(|scope| {
        for _ in 0..2 {
            scope.spawn(|| Model::load(&built(&sources, &options()), &sources.ports).unwrap());
        }
    });
    for mut child in children {
        assert!(child.wait().unwrap().success());
    }
    assert!(built(&sources, &options()).reused);
}

#[test]
fn rejected_verilog_is_reported_by_file_and_line_and_leaves_no_model() {
    let mut sources = mixer("rejected");
    sources.files[1].1 = sources.files[1].1.replace("q <= d;", "q <= ;");
    for _ in 0..2 {
        let message = error(build(&sources, &options(), &|_| ()));
        assert!(
            message.starts_with("verilator: Error: keep.v:9:"),
            "{message}"
        );
        let log = message
            .split_once("(complete log: ")
            .unwrap()
            .1
            .trim_end_matches(')');
        assert!(fs::read_to_string(log).unwrap().contains("keep.v:9"));
    }
    sources.files[1].1.clear();
    let message = error(build(&sources, &options(), &|_| ()));
    assert!(
        message.contains("mixer.v:") && message.contains("keep"),
        "{message}"
    );

    // A failing compiler leaves neither a model nor a build folder.
    let cache = tempfile::tempdir().unwrap();
    let options = BuildOptions {
        cache: Some(cache.path().into()),
        opt: "-Os -no-such-option".into(),
        ..BuildOptions::default()
    };
    let message = error(build(&mixer("rejected by g++"), &options, &|_| ()));
    assert!(
        message.starts_with("g++: ") && message.contains("-no-such-option"),
        "{message}"
    );
    assert_eq!(
        fs::read_dir(cache.path().join("models")).unwrap().count(),
        0
    );
    let left: Vec<_> = fs::read_dir(cache.path())
        .unwrap()
        .map(|entry| entry.unwrap().file_name())
        .collect();
    assert!(
        !left
            .iter()
            .any(|name| name.to_string_lossy().starts_with("building-")),
        "{left:?}"
    );
}

#[test]
fn ports_must_be_those_of_the_verilog() {
    type Change = fn(&mut Vec<Port>);
    let cases: [(&str, Change); 6] = [
        (
            "port `a12` was described as an input of 13 bits, but the Verilog has an input of 12 bits",
            |p| p[3].width = 13,
        ),
        (
            "port `a12` was described as an output of 12 bits, but",
            |p| p[3].input = false,
        ),
        ("port `a12`, an input of 12 bits, was not described", |p| {
            drop(p.remove(3))
        }),
        (
            "port `extra` was described, but the Verilog has no such port",
            |p| p.push(input("extra", 1)),
        ),
        ("port `a12` is given twice", |p| p.push(input("a12", 12))),
        ("port `a-b` is not a plain Verilog name", |p| {
            p.push(input("a-b", 1))
        }),
    ];
    for (expected, change) in cases {
        let mut sources = mixer("ports");
        change(&mut sources.ports);
        let message = error(build(&sources, &options(), &|_| ()));
        assert!(
            message.contains("module mixer: ") && message.contains(expected),
            "{message}"
        );
    }
    let sources = mixer("ports");
    let built = built(&sources, &options());
    assert!(error(Model::load(&built, &sources.ports[1..])).contains("was built for other ports"));
}

#[test]
fn a_file_name_cannot_leave_the_build_folder() {
    for name in ["../keep.v", "/tmp/keep.v", "-keep.v", ""] {
        let mut sources = mixer("file names");
        sources.files[1].0 = name.into();
        assert!(error(build(&sources, &options(), &|_| ())).contains("must be relative"));
    }
}

#[test]
fn missing_tools_and_unusable_caches_are_named() {
    const CHILD: &str = "DYNRT_TEST_CHILD_WITHOUT_TOOLS";
    let sources = mixer("no tools");
    if std::env::var_os(CHILD).is_some() {
        // Not `options()`, because the parent's cache is in use.
        println!(
            "build: {}",
            error(build(&sources, &BuildOptions::default(), &|_| ()))
        );
        println!("lint: {}", error(lint(&sources)));
        return;
    }
    let empty = tempfile::tempdir().unwrap();
    let output = Command::new(std::env::current_exe().unwrap())
        .args([
            "--exact",
            "missing_tools_and_unusable_caches_are_named",
            "--nocapture",
        ])
        .env(CHILD, "1")
        .env("PATH", empty.path())
        .output()
        .unwrap();
    let printed = String::from_utf8_lossy(&output.stdout);
    assert!(
        printed.contains("build: verilator is not installed: apt-get install verilator g++, of Debian 12 or later, or name its folder in DYNRT_TOOLS\n"),
        "{printed}"
    );
    assert!(
        printed.contains("lint: verilator is not installed: apt-get install verilator g++, of Debian 12 or later, or name its folder in DYNRT_TOOLS\n"),
        "{printed}"
    );

    let file = empty.path().join("file");
    fs::write(&file, "").unwrap();
    let options = BuildOptions {
        cache: Some(file.join("cache")),
        ..BuildOptions::default()
    };
    let message = error(build(&sources, &options, &|_| ()));
    assert!(
        message.contains("cannot create the model cache") && message.contains("set DYNRT_CACHE"),
        "{message}"
    );
}

#[test]
fn a_trace_covers_its_window() {
    let sources = mixer("trace");
    let plain = built(&sources, &options());
    let traced = built(
        &sources,
        &BuildOptions {
            traced: true,
            ..options()
        },
    );
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("t.fst");

    let mut model = Model::load(&plain, &sources.ports).unwrap();
    assert!(error(model.trace(&path, 0, 10)).contains("built without traces") && !path.exists());

    let mut model = Model::load(&traced, &sources.ports).unwrap();
    assert!(
        error(model.trace(&folder.path().join("no/t.fst"), 0, 10))
            .contains("cannot write the trace")
    );
    model.reset(2);
    assert!(error(model.trace(&path, 0, 2)).contains("nothing to trace"));
    model.trace(&path, 10, 5).unwrap();
    model.run(13);
    assert_eq!(model.cycles(), 15);
    // The trace is complete although the model still exists. Its header: a byte 0, its length, first and last time, ...
    let fst = fs::read(&path).unwrap();
    let word = |index: usize| {
        let at = 1 + 8 * index;
        u64::from_be_bytes(fst[at..at + 8].try_into().unwrap())
    };
    assert_eq!((fst[0], word(0), word(1), word(2)), (0, 329, 100, 145));
    // ... a double, the memory used, scopes, variables (the ports and internal ones), ..., the exponent to base ten of
    // the time unit in seconds.
    assert!(
        word(6) >= sources.ports.len() as u64,
        "{} variables",
        word(6)
    );
    assert_eq!(fst[73] as i8, -9);
    model.trace(&path, 20, 1000).unwrap();
    model.run(10);
    model.trace_end();
    assert_eq!(
        fs::read(&path).unwrap()[9..25],
        [200u64.to_be_bytes(), 245u64.to_be_bytes()].concat()
    );
}

#[test]
fn lint_says_which_tool_objects() {
    lint(&mixer("lint")).unwrap();
    let mut unused = mixer("lint");
    unused.files[0].1 = unused.files[0].1.replace(
        "    assign sum_now",
        "    wire nothing = 1'b0;\n    assign sum_now",
    );
    let message = error(lint(&unused));
    assert!(
        message.starts_with("module mixer fails lint: verilator: Warning-UNUSED")
            && message.contains("mixer.v:"),
        "{message}"
    );

    // SystemVerilog: Verilator accepts it, Icarus in Verilog-2001 mode does not.
    let mut modern = mixer("lint");
    modern.files[1].1 = modern.files[1]
        .1
        .replace("always @(posedge clk)", "always_ff @(posedge clk)");
    let message = error(lint(&modern));
    assert!(
        message.starts_with("module mixer fails lint: iverilog: keep.v:"),
        "{message}"
    );

    // Two drivers of one wire, which is legal Verilog.
    let mut twice = mixer("lint");
    twice.files[0].1 = twice.files[0].1.replace(
        "    assign inverse_now",
        "    assign inverse_now = a100;\n    assign inverse_now",
    );
    let message = error(lint(&twice));
    assert!(
        message.starts_with("module mixer fails lint: yosys: ")
            && message.contains("conflicting drivers"),
        "{message}"
    );
}

// ---- memory ----

/// The events at a port: (edge, address, tag) of each accepted request, and the same of each response.
struct Observed {
    accepted: Vec<(u64, u64, u32)>,
    answered: Vec<(u64, u64, u32)>,
    ready: Vec<bool>,
}

const ROWS: u64 = 1000;

/// Drives a port with requests of the given probability until `count` requests were accepted and answered.
fn observe(timing: Timing, count: usize, demand: f64, rng: &mut fastrand::Rng) -> Observed {
    let mut port = ReadPort::new("nodes", ROWS, timing).unwrap();
    let mut seen = Observed {
        accepted: vec![],
        answered: vec![],
        ready: vec![],
    };
    for edge in 0.. {
        assert!(edge < 1_000_000, "the port does not finish: {timing:?}");
        let wants = seen.accepted.len() < count && rng.f64() < demand;
        let request = wants.then(|| ReadRequest {
            address: rng.u64(..ROWS),
            tag: seen.accepted.len() as u32,
        });
        let ready = port.ready();
        seen.ready.push(ready);
        if let (true, Some(ReadRequest { address, tag })) = (ready, request) {
            seen.accepted.push((edge, address, tag));
        }
        if let Some(response) = port.step(request).unwrap() {
            // A response returned by the step of this edge is sampled at the next edge.
            seen.answered
                .push((edge + 1, response.address, response.tag));
        }
        assert_eq!(
            port.outstanding(),
            seen.accepted.len() - seen.answered.len()
        );
        assert_eq!(port.accepted(), seen.accepted.len() as u64);
        if seen.answered.len() == count {
            break;
        }
    }
    seen
}

fn random_timing(rng: &mut fastrand::Rng) -> Timing {
    let jitter = if rng.bool() { 0 } else { rng.u32(1..=40) };
    let cycles = rng.u32(1..=6);
    Timing {
        latency: if rng.bool() {
            rng.u32(1..=3)
        } else {
            rng.u32(1..=100)
        },
        jitter,
        out_of_order: jitter > 0 && rng.bool(),
        bandwidth: Bandwidth {
            requests: rng.u32(1..=cycles),
            cycles,
        },
        backpressure: if rng.bool() { 0.0 } else { rng.f64() * 0.8 },
        seed: rng.u64(..),
    }
}

#[test]
fn a_read_port_keeps_its_laws() {
    let mut rng = fastrand::Rng::with_seed(seed());
    let (mut out_of_order, mut reordered, mut late) = (0, 0, 0);
    for _ in 0..300 {
        let timing = random_timing(&mut rng);
        let demand = if rng.bool() {
            1.0
        } else {
            rng.f64() * 0.9 + 0.1
        };
        let count = rng.usize(1..=400);
        let seen = observe(timing, count, demand, &mut rng);

        // Every request gets exactly one response, with its address and within its bounds; at most one response per cycle.
        let requests: HashMap<u32, (u64, u64)> =
            seen.accepted.iter().map(|&(e, a, t)| (t, (e, a))).collect();
        let mut answered: Vec<u32> = seen.answered.iter().map(|&(_, _, tag)| tag).collect();
        for &(edge, address, tag) in &seen.answered {
            let (accepted_at, wanted) = requests[&tag];
            assert_eq!(address, wanted, "{timing:?}");
            let took = edge - accepted_at;
            let (least, most) = (
                u64::from(timing.latency),
                u64::from(timing.latency + timing.jitter),
            );
            assert!((least..=most).contains(&took), "{took} clocks: {timing:?}");
            late += usize::from(took > least);
        }
        assert!(
            seen.answered.windows(2).all(|pair| pair[0].0 < pair[1].0),
            "{timing:?}"
        );
        let in_order = answered.is_sorted();
        assert!(in_order || timing.out_of_order, "{timing:?}");
        out_of_order += usize::from(timing.out_of_order && count > 50);
        reordered += usize::from(!in_order);
        answered.sort_unstable();
        assert!(answered.iter().copied().eq(0..count as u32), "{timing:?}");

        // In no interval are more requests accepted than the bandwidth allows.
        let edges: Vec<u64> = seen.accepted.iter().map(|&(edge, ..)| edge).collect();
        let Bandwidth { requests, cycles } = timing.bandwidth;
        for (i, first) in edges.iter().enumerate() {
            for (j, last) in edges.iter().enumerate().skip(i) {
                let allowed =
                    ((last - first + 1) * u64::from(requests)).div_ceil(u64::from(cycles));
                assert!((j - i + 1) as u64 <= allowed, "{timing:?}");
            }
        }
    }
    assert!(
        out_of_order > 10 && reordered >= out_of_order / 2 && late > 1000,
        "{out_of_order} {reordered} {late}"
    );
}

#[test]
fn a_read_port_reaches_its_bandwidth_and_repeats_itself() {
    let mut rng = fastrand::Rng::with_seed(seed());
    for (requests, cycles) in [(1, 1), (1, 2), (2, 3), (3, 7), (5, 6)] {
        let timing = Timing {
            bandwidth: Bandwidth { requests, cycles },
            ..Timing::default()
        };
        let seen = observe(timing, 3000, 1.0, &mut rng);
        let span = seen.accepted[2999].0 + 1;
        let ideal = 3000 * u64::from(cycles) / u64::from(requests);
        assert!(
            span <= ideal + u64::from(cycles) && span + u64::from(cycles) >= ideal,
            "{span} clocks, not {ideal}"
        );
    }
    // The frequency of back-pressure is as requested: 20,000 draws, within ten standard deviations.
    let timing = Timing {
        backpressure: 0.3,
        seed: rng.u64(..),
        ..Timing::default()
    };
    let seen = observe(timing, 20_000, 1.0, &mut rng);
    let share = seen.ready.iter().filter(|ready| !**ready).count() as f64 / seen.ready.len() as f64;
    assert!(
        (share - 0.3).abs() < 0.03,
        "not ready in {share} of the clocks"
    );

    for _ in 0..20 {
        let timing = random_timing(&mut rng);
        let demand = rng.u64(..);
        let runs =
            [(); 2].map(|()| observe(timing, 200, 0.7, &mut fastrand::Rng::with_seed(demand)));
        assert_eq!(runs[0].answered, runs[1].answered, "{timing:?}");
    }
}

#[test]
fn bad_addresses_and_timings_are_errors() {
    let mut port = ReadPort::new("nodes", ROWS, Timing::default()).unwrap();
    port.step(Some(ReadRequest {
        address: ROWS - 1,
        tag: 0,
    }))
    .unwrap();
    let message = error(port.step(Some(ReadRequest {
        address: ROWS,
        tag: 7,
    })));
    assert_eq!(
        message,
        "read port `nodes`, clock 1: address 0x3e8 (tag 7) is outside its memory of 1000 records"
    );

    let default = Timing::default;
    let bandwidth = |requests, cycles| Bandwidth { requests, cycles };
    let cases = [
        (
            "latency is 0",
            Timing {
                latency: 0,
                ..default()
            },
        ),
        (
            "latency is 4294967295",
            Timing {
                latency: u32::MAX,
                ..default()
            },
        ),
        (
            "jitter is 4294967295",
            Timing {
                jitter: u32::MAX,
                ..default()
            },
        ),
        (
            "out of order only with a jitter",
            Timing {
                out_of_order: true,
                ..default()
            },
        ),
        (
            "bandwidth is 0 requests",
            Timing {
                bandwidth: bandwidth(0, 1),
                ..default()
            },
        ),
        (
            "bandwidth is 2 requests in 1 clocks, must be 1 to 1",
            Timing {
                bandwidth: bandwidth(2, 1),
                ..default()
            },
        ),
        (
            "bandwidth is 0 requests in 0",
            Timing {
                bandwidth: bandwidth(0, 0),
                ..default()
            },
        ),
        (
            "back-pressure is 1,",
            Timing {
                backpressure: 1.0,
                ..default()
            },
        ),
        (
            "back-pressure is NaN,",
            Timing {
                backpressure: f64::NAN,
                ..default()
            },
        ),
        (
            "back-pressure is -0.1,",
            Timing {
                backpressure: -0.1,
                ..default()
            },
        ),
    ];
    for (expected, timing) in cases {
        let message = error(ReadPort::new("p", 1, timing));
        assert!(message.contains(expected), "{message}");
        error(WritePort::new("p", &[8], timing));
    }
    for lanes in [&[][..], &[8, 0], &[1; 65]] {
        assert!(
            error(WritePort::new("updates", lanes, default())).contains("write port `updates`")
        );
    }
    assert!(error(Image::from_words(vec![0; 9], 160)).contains("9 words"));
}

#[test]
fn a_write_port_writes_the_lanes_it_is_told_to() {
    let mut rng = fastrand::Rng::with_seed(seed());
    let lanes = [24, 24, 24, 24, 32];
    let timing = Timing {
        backpressure: 0.25,
        seed: rng.u64(..),
        ..Timing::default()
    };
    let mut port = WritePort::new("nodes", &lanes, timing).unwrap();
    let mut image = Image::from_words((0..40).collect(), 128).unwrap();
    let wide = |words: &[u32]| {
        words
            .iter()
            .rev()
            .fold(0u128, |value, &word| value << 32 | u128::from(word))
    };
    let mut expected: Vec<u128> = (0..image.rows()).map(|row| wide(image.row(row))).collect();
    let mut refused = 0;
    for _ in 0..4000 {
        let data: [u32; 4] = std::array::from_fn(|_| rng.u32(..));
        let write = WriteRequest {
            address: rng.u64(..10),
            data: &data,
            mask: rng.u64(..32),
        };
        let ready = port.ready();
        assert_eq!(port.step(Some(write), &mut image).unwrap(), ready);
        refused += u64::from(!ready);
        if ready {
            let mut lsb = 0;
            for (lane, bits) in lanes.iter().enumerate() {
                let mask = ((1u128 << bits) - 1) << lsb;
                if write.mask >> lane & 1 == 1 {
                    let row = &mut expected[write.address as usize];
                    *row = *row & !mask | wide(&data) & mask;
                }
                lsb += bits;
            }
        }
        assert_eq!(
            wide(image.row(write.address)),
            expected[write.address as usize]
        );
        if rng.u32(..4) == 0 {
            assert!(!port.step(None, &mut image).unwrap());
        }
    }
    assert!(
        refused > 500 && port.accepted() + refused == 4000,
        "{refused}"
    );
    assert!((0..10).all(|row| wide(image.row(row)) == expected[row as usize]));

    let before = image.clone();
    let data = [0; 4];
    for (expected, address, data, mask) in [
        ("address 0xa is outside", 10, &data[..], 1),
        ("3 words written to records of 4 words", 0, &data[..3], 1),
        ("mask 0x20 has more than 5 lanes", 0, &data[..], 32),
    ] {
        while !port.ready() {
            port.step(None, &mut image).unwrap();
        }
        let message = error(port.step(
            Some(WriteRequest {
                address,
                data,
                mask,
            }),
            &mut image,
        ));
        assert!(
            message.starts_with("write port `nodes`, clock ") && message.contains(expected),
            "{message}"
        );
    }
    assert_eq!(image, before);
}

#[test]
fn a_stream_offers_until_it_is_taken() {
    let mut rng = fastrand::Rng::with_seed(seed());
    let mut source = StreamSource::new(0.5, rng.u64(..)).unwrap();
    let mut sink = RandomStall::new(0.5, rng.u64(..)).unwrap();
    let mut items: VecDeque<u32> = (0..10_000).collect();
    let (mut taken, mut waiting, mut pauses) = (Vec::new(), None, 0);
    while let Some(&item) = items.front() {
        let (valid, ready) = (source.open(), !sink.stalls());
        if let Some(waiting) = waiting {
            assert!(valid && waiting == item, "an offer was withdrawn");
        }
        pauses += usize::from(!valid);
        waiting = (valid && !ready).then_some(item);
        if source.step(true, ready) {
            assert!(valid && ready);
            taken.push(items.pop_front().unwrap());
        }
    }
    assert!(taken.iter().copied().eq(0..10_000));
    // A pause follows a transfer with probability ½, and takes two cycles on average.
    assert!((8_000..12_000).contains(&pauses), "{pauses} pauses");
    assert!(!(0..1000).any(|_| RandomStall::new(0.0, 1).unwrap().stalls()));
    error(RandomStall::new(1.0, 1));
}

#[test]
fn the_readme_shows_the_example_and_what_it_prints() {
    let readme = include_str!("../README.md");
    let source = include_str!("../examples/counter.rs");
    let (_, code) = source.split_at(source.find("use ").unwrap());
    let printed = counter::simulate(&options()).unwrap();
    let shown = format!("```rust,no_run\n{code}```\n\nIt prints:\n\n```text\n{printed}```\n");
    assert!(
        readme.contains(&shown),
        "README.md must show it so:\n{shown}"
    );
}
