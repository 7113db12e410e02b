//! What a host needs of a chip: the C header, the driver for every compiler, SystemRDL in a foreign compiler, and the chip between
//! foreign models of its buses.

use crate::support::command::dynrt;
use crate::support::driver::{
    FREESTANDING, STRICT, compile, folders, program, python, source, write_header,
};
use crate::support::say::say;
use dynrt::chip::export;
use dynrt::config::Config;
use serde_json::Value;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

const CROSS: &str = "riscv64-unknown-elf-gcc";

/// Machines with formats, packets and limits of every size.
fn machines() -> [Config; 4] {
    let tiny = Config::load("tiny").unwrap();
    let wide = Config {
        exponent_bits: 10,
        fraction_bits: 23,
        tag_bits: 32,
        address_bits: 27,
        ..tiny.clone()
    };
    let narrow = Config {
        exponent_bits: 3,
        fraction_bits: 2,
        ..tiny.clone()
    };
    [Config::reference(), tiny, wide, narrow]
}

/// Runs the command in a folder.
fn run(arguments: &str, folder: &Path) {
    let output = dynrt(arguments, folder).output().unwrap();
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{arguments}: {said}");
}

fn read(path: PathBuf) -> String {
    fs::read_to_string(&path).unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// `generate` and `pack` write the same header, in every run; a machine that becomes a core loses both files.
#[test]
fn generate_and_pack_write_the_files_of_a_host() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for out in ["a", "b"] {
        run(
            &format!("generate --config tiny --top chip --out {out}"),
            folder.path(),
        );
    }
    let manifest: Value = serde_json::from_str(&read(at("a/manifest.json"))).unwrap();
    assert_eq!(manifest["host"]["header"], "dynrt_regs.h");
    assert_eq!(manifest["host"]["systemrdl"], "dynrt.rdl");
    for name in ["dynrt_regs.h", "dynrt.rdl"] {
        assert!(read(at("a").join(name)) == read(at("b").join(name)));
        let listed = manifest["host"]["files"].as_array().unwrap();
        assert!(listed.iter().any(|file| file == name), "{name}");
    }
    run(
        "pack builtin:cornell --config tiny --size 4x3 --out packed",
        folder.path(),
    );
    assert!(read(at("packed/dynrt_regs.h")) == read(at("a/dynrt_regs.h")));
    let packed: Value = serde_json::from_str(&read(at("packed/manifest.json"))).unwrap();
    let files = packed["files"].as_array().unwrap();
    assert!(files.iter().any(|file| file == "dynrt_regs.h"));
    // The names follow the prefix, and so does the address map.
    run(
        "generate --config tiny --top chip --prefix small_ --out c",
        folder.path(),
    );
    assert!(read(at("c/small.rdl")).contains("addrmap small_chip {"));
    assert!(read(at("c/small_regs.h")) == read(at("a/dynrt_regs.h")));
    run("generate --config tiny --out a", folder.path());
    for name in ["a/dynrt_regs.h", "a/dynrt.rdl"] {
        assert!(!at(name).exists(), "{name} is gone with the chip");
    }
}

/// Names of an object file that it takes from elsewhere.
fn taken(folder: &Path, object: &str) -> Vec<String> {
    let mut nm = Command::new("nm");
    let output = nm
        .args(["-u", object])
        .current_dir(folder)
        .output()
        .unwrap();
    assert!(output.status.success());
    let printed = String::from_utf8_lossy(&output.stdout).into_owned();
    let names = printed.lines().map(|line| line.trim_start());
    names
        .map(|name| name.trim_start_matches("U ").to_string())
        .collect()
}

/// Compiles the driver and the freestanding example; they take nothing from a library but what the compiler itself brings along.
fn compiles_freestanding(compiler: &Path, options: &str) {
    for config in machines() {
        let folder = tempfile::tempdir().unwrap();
        write_header(folder.path(), &config);
        for level in ["-O0", "-O2", "-Os"] {
            let options = format!("{STRICT} {FREESTANDING} {options} {level} -c");
            for name in ["dynrt", "example"] {
                let file = [source(&format!("{name}.c"))];
                compile(compiler, folder.path(), &options, &file);
                let taken = taken(folder.path(), &format!("{name}.o"));
                // The compiler's own names begin with two underscores.
                let library = taken.iter().find(|taken| {
                    let ours = name == "example" && taken.starts_with("dynrt_");
                    !ours && !taken.starts_with("__") && !taken.starts_with("_GLOBAL_")
                });
                assert_eq!(library, None, "{name} {options}");
            }
        }
    }
}

#[test]
fn the_driver_compiles_here() {
    compiles_freestanding(Path::new("gcc"), "");
    // The program for Linux, which says how it is used.
    let folder = tempfile::tempdir().unwrap();
    write_header(folder.path(), &Config::reference());
    let files = ["dynrt.c", "example.c", "example_linux.c"].map(source);
    let options = format!("{STRICT} -O2 -o example");
    compile(Path::new("gcc"), folder.path(), &options, &files);
    let said = |words: &[&str]| {
        let mut example = Command::new(folder.path().join("example"));
        let output = example.args(words).output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), text)
    };
    let (code, text) = said(&[]);
    assert_eq!(code, Some(2));
    assert!(text.starts_with("usage: "), "{text}");
    let (code, text) = said(&["0", "0", "0", "0x40", "absent.bin"]);
    assert_eq!(code, Some(2));
    assert_eq!(text, "error: absent.bin cannot be read\n");
    assert!(
        said(&["0", "0", "0", "1x", "absent.bin"])
            .1
            .starts_with("usage: ")
    );
}

/// The header is C++ as well, and can be included twice.
#[test]
fn the_header_is_for_cpp_too() {
    let folder = tempfile::tempdir().unwrap();
    write_header(folder.path(), &Config::reference());
    let unit = folder.path().join("unit.cpp");
    let text = "#include \"dynrt.h\"\n#include \"dynrt.h\"\nint f(const dynrt_device *d) { return dynrt_open(d); }\n";
    fs::write(&unit, text).unwrap();
    let options = "-std=c++11 -Wall -Wextra -Wpedantic -Werror -c";
    compile(Path::new("g++"), folder.path(), options, &[unit]);
    let taken = taken(folder.path(), "unit.o");
    assert!(taken.contains(&"dynrt_open".to_string()), "{taken:?}");
}

#[test]
fn the_driver_compiles_for_rv32() {
    let Some(compiler) = program(CROSS) else {
        say(&format!(
            "absent: {CROSS}; the driver was not compiled for rv32; apt-get install gcc-riscv64-unknown-elf (200 MB) installs it"
        ));
        return;
    };
    compiles_freestanding(&compiler, "-march=rv32imac -mabi=ilp32");
}

/// Runs the check of a SystemRDL file; returns whether it passes, and what it says.
fn check(python: &Path, folder: &Path, rdl: &str, facts: &[u8]) -> (bool, String) {
    fs::write(folder.join("dynrt.rdl"), rdl).unwrap();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/check_rdl.py");
    let mut child = Command::new(python)
        .arg(script)
        .arg("dynrt.rdl")
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    child.stdin.take().unwrap().write_all(facts).unwrap();
    let output = child.wait_with_output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout) + String::from_utf8_lossy(&output.stderr);
    (output.status.success(), said.into_owned())
}

/// SystemRDL and the C header, each in a compiler of its own, say the same; and the check finds any change.
#[test]
fn systemrdl_and_the_header_agree() {
    let needed = [("systemrdl", "systemrdl-compiler")];
    let Some(python) = python(&needed, "the check of SystemRDL") else {
        return;
    };
    let program = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/machine/host/facts.c");
    for (number, config) in machines().iter().enumerate() {
        let folder = tempfile::tempdir().unwrap();
        write_header(folder.path(), config);
        let options = "-std=c99 -Wall -Wextra -Wpedantic -Werror -o facts";
        compile(
            Path::new("gcc"),
            folder.path(),
            options,
            std::slice::from_ref(&program),
        );
        let facts = Command::new(folder.path().join("facts")).output().unwrap();
        assert!(facts.status.success());
        let rdl = export::rdl(config, "dynrt_chip", "for a test");
        let (passes, said) = check(&python, folder.path(), &rdl, &facts.stdout);
        assert!(passes && said.starts_with("PASS "), "{said}");
        println!("{}: {}", config.name, said.trim());
        if number > 0 {
            continue;
        }
        let changes = [
            ("LIST @ 0x040", "LIST @ 0x03c"),
            ("LIST @ 0x040", "LISTS @ 0x040"),
            ("busy[0:0]", "busy[3:3]"),
            ("rays[7:0] = 8'h4", "rays[7:0] = 8'h5"),
            ("rays[7:0]", "ray[7:0]"),
            ("in_flight[15:8]", "in_flight[14:8]"),
            ("sw = rw; hw = r;", "sw = r; hw = w;"),
            (" onwrite = woclr;", ""),
            ("sw = w; hw = r;", "sw = rw; hw = r;"),
            ("opcode = 32'd1", "opcode = 32'd9"),
            ("addrmap", "addrmaps"),
        ];
        for (from, to) in changes {
            let changed = rdl.replacen(from, to, 1);
            assert_ne!(changed, rdl, "{from}");
            let (passes, said) = check(&python, folder.path(), &changed, &facts.stdout);
            assert!(!passes && said.contains("FAIL "), "{from} to {to}: {said}");
        }
        let (passes, said) = check(&python, folder.path(), &rdl, b"");
        assert!(!passes && said.contains("FAIL "), "{said}");
    }
}

/// The chip in Icarus between the AXI models of cocotbext-axi: all bytes of memory are the golden chip's; a wrong byte is found.
#[test]
fn cocotb_casts_a_packed_scene() {
    let needed = [
        ("cocotb_tools.runner", "cocotb"),
        ("cocotbext.axi", "cocotbext-axi"),
        ("libpython", "the shared library of Python (libpython3)"),
    ];
    let Some(python) = python(&needed, "the chip in cocotb") else {
        return;
    };
    if program("iverilog").is_none() {
        say("absent: iverilog; the chip in cocotb did not run; make deps installs it");
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    run("generate --config tiny --top chip --out rtl", folder.path());
    run(
        "pack builtin:cornell --config tiny --size 16x12 --address 4096 --out pack",
        folder.path(),
    );
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("sim/cocotb/run.py");
    let simulate = || {
        let path = std::env::join_paths(folders()).unwrap();
        let output = Command::new(&python)
            .arg(&script)
            .args(["rtl", "pack", "work"])
            .env("PATH", path)
            .current_dir(folder.path())
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stdout).into_owned();
        let last = said.lines().last().unwrap_or_default().to_string();
        (output.status.success(), last, said)
    };
    let (passes, last, said) = simulate();
    assert!(passes && last.starts_with("PASS 2 tests, "), "{said}");
    println!("{last}");
    for line in said.lines().filter(|line| line.contains("cycles,")) {
        println!("{line}");
    }
    let hits = folder.path().join("pack/hits/0000.bin");
    let mut bytes = fs::read(&hits).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(&hits, bytes).unwrap();
    let (passes, last, said) = simulate();
    assert!(!passes && last.starts_with("FAIL 2 of 2 tests"), "{said}");
}
