//! Machines of other configurations: each is generated, linted by three tools, and co-simulated unit by unit and as a whole.
//!
//! Tests print their seed; `DYNRT_SEED=… cargo test --test machine machines::` repeats them. `DYNRT_FULL=1` runs
//! twenty random machines, and larger workloads on the named configurations.

use crate::support::say::say;
use crate::support::{full, seed};
use dynrt::config::{Config, NAMED, TriangleTest};
use dynrt::cosim::scoreboard::Fault;
use dynrt::emit;
use dynrt::fuzz::{Case, Event, Options, Report, Size, Stage, Workbench, run};
use dynrt::hdl::Prefix;
use dynrt::hw::Plan;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Checks machines, and that every stage checked something.
fn check(bench: &Workbench, options: &Options) -> Report {
    let report = run(bench, options, &mut |event| {
        if let Event::Passed(_, passed) = event {
            println!("{}: {:?}", passed.case.command(None), passed.checked);
        }
    });
    let report = report.unwrap_or_else(|e| panic!("{e:#}"));
    if let Some(failed) = &report.failed {
        panic!(
            "{}\n{}\nshrunk: {}\n{}",
            failed.case.command(Some(failed.failure.stage)),
            failed.failure.message,
            failed.shrunk.command(Some(failed.shrunk_failure.stage)),
            failed.shrunk_failure.message
        );
    }
    assert_eq!(report.passed.len() as u32, options.machines);
    for &stage in &options.stages {
        assert!(report.checked_in(stage) > 0, "nothing in {}", stage.name());
    }
    report
}

#[test]
fn random_machines() {
    let machines = if full() { 20 } else { 2 };
    let bench = Workbench::new().unwrap();
    let report = check(&bench, &Options::new(seed(), machines));
    println!("{} results", report.checked());
}

/// A change of a configuration, with its name.
type Change = (&'static str, fn(&mut Config));

/// The changes that differ from the reference most. Those of one row do not concern the same key, so one machine can have them all.
const CHANGES: [&[Change]; 3] = [
    &[
        ("1 ray a packet", |c| c.rays_per_packet = 1),
        ("Moller-Trumbore", |c| {
            c.triangle_test = TriangleTest::MollerTrumbore
        }),
        ("25 MHz, 5 packets", |c| {
            c.clock_mhz = 25;
            c.packets_in_flight = 5;
        }),
    ],
    &[
        ("2 rays a packet", |c| c.rays_per_packet = 2),
        ("8 exponent, 23 fraction bits", |c| {
            c.exponent_bits = 8;
            c.fraction_bits = 23;
        }),
        ("133 MHz", |c| c.clock_mhz = 133),
    ],
    &[
        ("8 rays a packet", |c| c.rays_per_packet = 8),
        ("one axis, 64 packets", |c| {
            c.axes_per_node = 1;
            c.packets_in_flight = 64;
        }),
    ],
];

/// The named configurations, and those with the changes: a machine for each row, at full length also one for each change.
fn chosen() -> Vec<Config> {
    let variant = |changes: &[Change]| {
        let names: Vec<_> = changes.iter().map(|(name, _)| *name).collect();
        let mut config = Config {
            name: names.join(", "),
            memory_latency: 13,
            memory_jitter: 20,
            memory_in_order: false,
            memory_ready_percent: 70,
            ..Config::reference()
        };
        for (_, change) in changes {
            change(&mut config);
        }
        config
    };
    let named = NAMED.iter().map(|(name, _)| Config::load(name).unwrap());
    let rows = CHANGES.iter().map(|row| variant(row));
    let each = CHANGES.iter().flat_map(|row| row.chunks(1)).map(variant);
    let each: Vec<_> = if full() { each.collect() } else { vec![] };
    named.chain(rows).chain(each).collect()
}

/// Their single units are tested elsewhere (`units`, `update`, `skinning`).
#[test]
fn named_configurations_and_those_that_differ_most() {
    let (seed, bench) = (seed(), Workbench::new().unwrap());
    for config in chosen() {
        println!("{}", config.name);
        let stages = [
            Stage::Generate,
            Stage::Lint,
            Stage::Raycast,
            Stage::Animation,
        ];
        let options = Options {
            config: Some(config),
            stages: stages.into(),
            sizes: [Size::Packets, Size::Frames]
                .map(|size| format!("{}={}", size.name(), size.most()))
                .into(),
            ..Options::new(seed, 1)
        };
        check(&bench, &options);
    }
}

/// A seeded fault in one unit is detected, its machine is shrunk to the reference machine with a minimal workload, and the
/// printed command reproduces that case.
#[test]
fn a_planted_fault_is_found_and_shrunk() {
    // Every written box is wrong in all bits. (Update processors are small and quick to build.)
    let fault: Fault = |unit| Ok(unit.top().signal("box_write_data")?.fault().inverted());
    let bench = Workbench::new().unwrap().with_fault(Stage::Update, fault);
    let options = Options {
        stages: vec![Stage::Update],
        shrink_attempts: 12,
        again: true,
        ..Options::new(seed(), 3)
    };
    let (mut tried, mut told) = (0, false);
    let report = run(&bench, &options, &mut |event| match event {
        Event::Failed(number, ..) => told = number == 0,
        Event::Shrinks(attempts, _) => tried = attempts,
        Event::Enters(..) | Event::Passed(..) => {}
    })
    .unwrap();
    assert!(report.passed.is_empty() && told);
    let failed = report.failed.expect("the fault shows");
    println!("{}", failed.failure.message);
    assert_eq!(failed.failure.stage, Stage::Update);
    assert_eq!(failed.case, Case::random(options.seed));
    assert_eq!((failed.attempts, failed.attempts > 0), (tried, true));
    assert_eq!(failed.shrunk.settings(), Vec::<String>::new());
    assert_eq!(failed.shrunk.sizes.get(Size::Transactions), 1);
    assert_eq!(failed.shrunk_failure.stage, Stage::Update);
    assert_eq!(
        failed.shrunk.command(Some(Stage::Update)),
        format!(
            "dynrt fuzz --machines 1 --seed {} --stage update --config virtex4-lx160{}",
            options.seed,
            Size::ALL
                .iter()
                .filter(|&&size| failed.case.sizes.get(size) > 1)
                .map(|size| format!(" --size {}=1", size.name()))
                .collect::<String>()
        )
    );
    // Without the fault it passes.
    let sound = Workbench::new().unwrap();
    let checked = sound.check(&failed.shrunk, &[Stage::Update], &|_| ());
    assert!(checked.unwrap()[0].count > 0);
}

/// A run without checks or without machines is an error.
#[test]
fn nothing_to_check_is_an_error() {
    let bench = Workbench::new().unwrap();
    let none = Options {
        stages: vec![],
        ..Options::new(1, 1)
    };
    for options in [none, Options::new(1, 0)] {
        let error = run(&bench, &options, &mut |_| ()).unwrap_err();
        assert!(error.to_string().contains("nothing would be checked"));
    }
}

fn dynrt(arguments: &str) -> std::process::Output {
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_dynrt"));
    command.args(arguments.split_whitespace()).output().unwrap()
}

/// The machines that the command lists are those of the library, and their settings reproduce them.
#[test]
fn listed_machines_are_the_seeds() {
    let output = dynrt("fuzz --machines 3 --seed 12 --list");
    assert!(output.status.success() && output.stderr.is_empty());
    let text = String::from_utf8(output.stdout).unwrap();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!((lines.len(), lines[0]), (4, "3 machines from seed 12"));
    for (seed, line) in (12..).zip(&lines[1..]) {
        let settings = line.strip_prefix(&format!("seed {seed}: --set ")).unwrap();
        let mut config = Config::reference();
        for setting in settings.split(" --set ") {
            let (key, value) = setting.split_once('=').unwrap();
            config.set(key, value).unwrap();
        }
        config.name = format!("random-{seed}");
        assert_eq!(config, Case::random(seed).config);
    }
}

#[test]
fn bad_requests_get_one_clear_line() {
    for (arguments, said) in [
        (
            "--size triangles=99",
            "triangles=99: is out of range; use 1 to 24",
        ),
        (
            "--config nonesuch",
            "nonesuch: no such configuration: name one of ",
        ),
        (
            "--config tiny --set packets.rays=3",
            "--set packets.rays=3: packets.rays = 3 is out of range: use 1, 2, 4, 8",
        ),
        ("--json /nonexistent/f.json", "/nonexistent/f.json: "),
    ] {
        let output = dynrt(&format!("fuzz {arguments}"));
        let text = String::from_utf8(output.stderr).unwrap();
        assert_eq!(output.status.code(), Some(1), "{arguments}: {text}");
        assert!(output.stdout.is_empty(), "{arguments}");
        assert!(text.starts_with(&format!("error: {said}")), "{text}");
        assert_eq!(text.lines().count(), 1, "{text}");
    }
}

// The generated FuseSoC core in the real FuseSoC.

/// FuseSoC, as installed by `make deps` or found in the path.
fn fusesoc() -> Option<PathBuf> {
    let named = std::env::var_os("DYNRT_TOOLS");
    let searched = std::env::var_os("PATH");
    let mut folders: Vec<PathBuf> = [named, searched]
        .iter()
        .flatten()
        .flat_map(std::env::split_paths)
        .collect();
    folders.push(Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tools/bin"));
    let found = folders.iter().map(|folder| folder.join("fusesoc"));
    let found = found.into_iter().find(|path| path.is_file());
    if found.is_none() {
        say("fusesoc is not installed: its core files were not run; make deps installs it");
    }
    found
}

/// Writes machines, with or without trace ports, each into a folder named after its prefix.
fn workspace(machines: &[(&Config, bool, &str)]) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    for (config, trace, prefix) in machines {
        let parsed: Prefix = prefix.parse().unwrap();
        let plan = Plan::new(config).unwrap().with_trace(*trace);
        let (_, files) =
            emit::generate_with(&plan, parsed, emit::Top::Core, emit::Extras::default()).unwrap();
        emit::write_folder(&folder.path().join("cores").join(prefix), &files).unwrap();
    }
    folder
}

/// Runs a target of a core in a workspace; returns whether it succeeds, and its output.
fn fuse(
    fusesoc: &Path,
    workspace: &Path,
    target: &str,
    core: &str,
    more: &[&str],
) -> (bool, String) {
    let output = Command::new(fusesoc)
        .args([
            "--cores-root",
            "cores",
            "run",
            "--clean",
            "--target",
            target,
            core,
        ])
        .args(more)
        .current_dir(workspace)
        .output()
        .unwrap();
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.success(), said.into_owned())
}

/// The smallest possible machine.
fn least() -> Config {
    let mut config = Config::load("tiny").unwrap();
    for (key, value) in [
        ("float.exponent_bits", "5"),
        ("float.fraction_bits", "2"),
        ("clock.target_mhz", "25"),
        ("tree.stack_depth", "8"),
        ("tree.address_bits", "8"),
        ("geometry.triangle_test", "moller-trumbore"),
        ("update.vertex_registers", "8"),
        ("update.box_registers", "8"),
        ("skinning.vertices_waiting", "4"),
    ] {
        config.set(key, value).unwrap();
    }
    Config {
        name: "least".into(),
        ..config
    }
}

#[test]
fn fusesoc_lints_simulates_and_synthesises() {
    let Some(fusesoc) = fusesoc() else { return };
    let (reference, least) = (Config::reference(), least());
    let folder = workspace(&[
        (&reference, true, "dynrt_"),
        (&least, false, "small_"),
        (&least, true, "traced_"),
    ]);
    let version = env!("CARGO_PKG_VERSION");
    let cores = [
        format!("dynrt:machine:dynrt_{}:{version}", reference.name),
        format!("dynrt:machine:small_least:{version}"),
        format!("dynrt:machine:traced_least:{version}"),
    ];
    let run =
        |target: &str, core: &str, more: &[&str]| fuse(&fusesoc, folder.path(), target, core, more);
    for core in &cores {
        let (passes, said) = run("lint", core, &[]);
        assert!(passes && !said.contains("%Warning"), "{said}");
        let (passes, said) = run("sim", core, &[]);
        let checked = said
            .lines()
            .any(|line| line.starts_with("PASS ") && !line.starts_with("PASS 0 "));
        assert!(passes && checked, "{said}");
    }
    let (passes, said) = run("sim_verilator", &cores[1], &[]);
    assert!(passes && said.contains("\nPASS "), "{said}");
    // This takes seconds module by module, and minutes for the flattened design.
    let (passes, said) = run("synth", &cores[1], &["--yosys_synth_options=-noflatten"]);
    assert!(passes, "{said}");
    let built = folder
        .path()
        .join(format!("build/{}/synth", cores[1].replace(':', "_")));
    let netlist = fs::read_dir(&built)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    let netlist = netlist
        .into_iter()
        .find(|path| path.extension().is_some_and(|e| e == "json"));
    let netlist = fs::read_to_string(netlist.expect("a netlist")).unwrap();
    assert!(netlist.contains("\"small_core\"") && netlist.contains("TRELLIS_FF"));

    // A wrong digit of any file makes the simulation fail. (The simulation of a small machine takes a tenth of the time.)
    for file in [
        "raycast_hits.hex",
        "packet_step_expected.hex",
        "vertices.hex",
    ] {
        let path = folder.path().join("cores/traced_/sim").join(file);
        let good = fs::read_to_string(&path).unwrap();
        // Every digit: a single one may be that of a number without a meaning.
        let flipped = |digit: char| match digit.to_digit(16) {
            Some(digit) => char::from_digit(digit ^ 1, 16).unwrap(),
            None => digit,
        };
        let lines = good.chars().map(flipped);
        fs::write(&path, lines.collect::<String>()).unwrap();
        let (passes, said) = run("sim", &cores[2], &[]);
        assert!(!passes && said.contains("\nFAIL "), "{file}: {said}");
        fs::write(&path, good).unwrap();
    }
}

/// Two machines of different configurations in one design of a FuseSoC workspace.
#[test]
fn fusesoc_takes_two_machines_into_one_design() {
    let Some(fusesoc) = fusesoc() else { return };
    let (reference, least) = (Config::reference(), least());
    let folder = workspace(&[(&reference, false, "big_"), (&least, false, "small_")]);
    let cores = folder.path().join("cores");
    fs::write(
        cores.join("both.v"),
        "/* verilator lint_off PINMISSING */\nmodule both (input wire clk, input wire rst);\n  \
         big_core first (.clk(clk), .rst(rst));\n  small_core second (.clk(clk), .rst(rst));\nendmodule\n",
    )
    .unwrap();
    let core = format!(
        "CAPI=2:\nname: user:design:both:1\nfilesets:\n  rtl:\n    depend: [\"dynrt:machine:big_{}\", \"dynrt:machine:small_least\"]\n    \
         files: [both.v]\n    file_type: verilogSource-2001\ntargets:\n  lint:\n    flow: lint\n    flow_options: {{tool: verilator}}\n    \
         filesets: [rtl]\n    toplevel: both\n",
        reference.name
    );
    fs::write(cores.join("both.core"), core).unwrap();
    let (passes, said) = fuse(&fusesoc, folder.path(), "lint", "user:design:both", &[]);
    assert!(passes, "{said}");
}
