//! The driver in C, compiled for a machine.

use super::say::say;
use dynrt::chip::export;
use dynrt::config::Config;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

/// The options of every compilation: warnings are errors, and nothing is taken from a library.
pub const STRICT: &str = "-std=c99 -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror";
pub const FREESTANDING: &str = "-ffreestanding";

/// A file of the driver.
pub fn source(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("driver")
        .join(name)
}

/// The folders with external tools: of `DYNRT_TOOLS`, of `make deps`, of the path.
pub fn folders() -> Vec<PathBuf> {
    let of = |name| std::env::var_os(name).unwrap_or_default();
    let ours = Path::new(env!("CARGO_MANIFEST_DIR")).join("target/tools/bin");
    std::env::split_paths(&of("DYNRT_TOOLS"))
        .chain([ours])
        .chain(std::env::split_paths(&of("PATH")))
        .filter(|folder| !folder.as_os_str().is_empty())
        .collect()
}

/// A program in one of the folders.
pub fn program(name: &str) -> Option<PathBuf> {
    let paths = folders().into_iter().map(|folder| folder.join(name));
    paths.into_iter().find(|path| path.is_file())
}

/// A Python with all of these modules (`libpython` is Python itself as a shared library), each named with the package that has it; otherwise says what is absent, and what has not run.
pub fn python(needed: &[(&str, &str)], what: &str) -> Option<PathBuf> {
    const ABSENT: &str = "import ctypes, importlib, sys, sysconfig\n\
         def use(name):\n\
         \x20   if name != 'libpython': return importlib.import_module(name)\n\
         \x20   ctypes.CDLL(sysconfig.get_config_var('INSTSONAME'))\n\
         for name in sys.argv[1:]:\n\
         \x20   try: use(name)\n\
         \x20   except (ImportError, OSError): print(name)";
    let mut least: Option<Vec<&str>> = None;
    for python in folders().iter().map(|folder| folder.join("python3")) {
        let modules = needed.iter().map(|(module, _)| module);
        let output = Command::new(&python)
            .args(["-c", ABSENT])
            .args(modules)
            .output();
        let Some(output) = output.ok().filter(|output| output.status.success()) else {
            continue;
        };
        let printed = String::from_utf8_lossy(&output.stdout);
        let lacks = |module: &str| printed.lines().any(|line| line == module);
        let absent = needed.iter().filter(|(module, _)| lacks(module));
        let absent: Vec<&str> = absent.map(|(_, package)| *package).collect();
        if absent.is_empty() {
            return Some(python);
        }
        if least
            .as_ref()
            .is_none_or(|least| absent.len() < least.len())
        {
            least = Some(absent);
        }
    }
    let absent = least.map_or("python3".into(), |absent| absent.join(", "));
    say(&format!(
        "absent: {absent}; {what} did not run; make deps installs it"
    ));
    None
}

/// Writes the header of a machine into a folder.
pub fn write_header(folder: &Path, config: &Config) {
    let header = export::header(config, "for a test");
    fs::write(folder.join("dynrt_regs.h"), header).unwrap();
}

/// Runs a C compiler in a folder with the header of a machine.
pub fn compile(compiler: &Path, folder: &Path, options: &str, files: &[PathBuf]) {
    let output = Command::new(compiler)
        .args(options.split_whitespace())
        .arg("-I.")
        .arg("-I")
        .arg(source(""))
        .args(files)
        .current_dir(folder)
        .output()
        .unwrap_or_else(|error| panic!("{}: {error}", compiler.display()));
    assert!(
        output.status.success(),
        "{} {options}: {}",
        compiler.display(),
        String::from_utf8_lossy(&output.stderr)
    );
}
