//! Computes a hash of all sources before compilation. Stored results ([`mutate`](crate::mutate), [`fuzz`](crate::fuzz)) are keyed by it,
//! so a change of the test bench or the golden model invalidates them.

use std::collections::hash_map::DefaultHasher;
use std::fs;
use std::hash::{Hash, Hasher};
use std::io;
use std::path::{Path, PathBuf};

const FOLDERS: [&str; 3] = ["src", "crates/hdl/src", "crates/verilated/src"];

fn files(folder: &Path, found: &mut Vec<PathBuf>) -> io::Result<()> {
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        match path.is_dir() {
            true => files(&path, found)?,
            false => found.push(path),
        }
    }
    Ok(())
}

fn main() -> io::Result<()> {
    let mut found = vec![];
    // In a package from a registry the crates are separate packages, each with its own version.
    for folder in FOLDERS
        .map(Path::new)
        .iter()
        .filter(|folder| folder.is_dir())
    {
        println!("cargo::rerun-if-changed={}", folder.display());
        files(folder, &mut found)?;
    }
    found.sort();
    let mut hash = DefaultHasher::new();
    for path in &found {
        path.hash(&mut hash);
        fs::read(path)?.hash(&mut hash);
    }
    println!("cargo::rustc-env=DYNRT_SOURCES={:016x}", hash.finish());
    Ok(())
}
