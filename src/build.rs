//! Before compilation: the hash of all that decides what a check finds, with what makes mutants. Remembered outcomes
//! ([`mutate`](crate::mutate), [`fuzz`](crate::fuzz)) go by it, so that none outlives the test bench or the golden model that it was reached with.

use std::collections::hash_map::DefaultHasher;
use std::fs;
use std::hash::{Hash, Hasher};
use std::io;
use std::path::{Path, PathBuf};

/// What only reports.
const BESIDE: [&str; 6] = ["baseline", "cli", "compare", "main.rs", "prove", "report"];

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
    println!("cargo::rerun-if-changed=src");
    let mut found = vec![];
    for entry in fs::read_dir("src")? {
        let entry = entry?;
        let beside = BESIDE.iter().any(|name| entry.file_name() == *name);
        match entry.file_type()?.is_dir() {
            _ if beside => {}
            true => files(&entry.path(), &mut found)?,
            false => found.push(entry.path()),
        }
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
