//! The cache folder, and hash keys for its entries.

use anyhow::{Context, Result, anyhow};
use sha2::{Digest, Sha256};
use std::fmt::Write as _;
use std::fs;
use std::path::PathBuf;

/// The given cache folder, or the user's (see [`model`](super::model)); creates it if it is missing.
pub fn folder(given: Option<PathBuf>) -> Result<PathBuf> {
    let variable = |name| {
        std::env::var_os(name)
            .filter(|value| !value.is_empty())
            .map(PathBuf::from)
    };
    let folder = given
        .or_else(|| variable("DYNRT_CACHE"))
        .or_else(|| variable("XDG_CACHE_HOME").map(|folder| folder.join("dynrt")))
        .or_else(|| variable("HOME").map(|folder| folder.join(".cache/dynrt")))
        .context(
            "no folder for the model cache: set DYNRT_CACHE to a folder that can be written",
        )?;
    // Compilers run in other folders, so the path must be absolute.
    let folder = std::path::absolute(&folder).unwrap_or(folder);
    fs::create_dir_all(folder.join("models")).map_err(|error| {
        anyhow!(
            "cannot create the model cache {}: {error}; set DYNRT_CACHE to a folder that can be written",
            folder.display()
        )
    })?;
    Ok(folder)
}

/// The hash of a list of texts, including their lengths, so different lists have different hashes.
pub fn key(parts: &[&str]) -> String {
    let mut hash = Sha256::new();
    for part in parts {
        hash.update((part.len() as u64).to_le_bytes());
        hash.update(part);
    }
    let mut hex = String::new();
    for byte in &hash.finalize()[..16] {
        let _ = write!(hex, "{byte:02x}");
    }
    hex
}
