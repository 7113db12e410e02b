//! The driver in C, compiled for a machine.

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
