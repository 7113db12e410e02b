//! Stored results, under keys of all their inputs.

use crate::cache;
use crate::temporary;
use anyhow::{Result, anyhow};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs;
use std::path::PathBuf;

pub(crate) use crate::cache::key;

/// The hash of everything except the Verilog that determines the result of a check, as a part of keys; see `src/build.rs`.
pub(crate) const CHECKS: &str = env!("DYNRT_SOURCES");

/// The folder of results.
pub(crate) struct Store {
    folder: PathBuf,
    failed: PathBuf,
}

impl Store {
    /// The store of synthesis results, in the given cache folder or the user's.
    pub fn open(cache: Option<PathBuf>) -> Result<Store> {
        Store::open_in(cache, "synth")
    }

    /// The store with this name, in the given cache folder or the user's.
    pub fn open_in(cache: Option<PathBuf>, name: &str) -> Result<Store> {
        let cache = cache::folder(cache)?;
        let store = Store {
            folder: cache.join(name),
            failed: cache.join("failed"),
        };
        fs::create_dir_all(&store.folder).map_err(|error| store.fault(&error))?;
        Ok(store)
    }

    fn fault(&self, error: &std::io::Error) -> anyhow::Error {
        anyhow!(
            "cannot write to the cache {}: {error}; set DYNRT_CACHE to a folder that can be written",
            self.folder.display()
        )
    }

    fn place(&self, name: &str, key: &str) -> PathBuf {
        self.folder.join(format!("{name}-{key}.json"))
    }

    /// The stored result; `None` also if the file cannot be read, so that the result is computed again.
    pub fn get<T: DeserializeOwned>(&self, name: &str, key: &str) -> Option<T> {
        let text = fs::read_to_string(self.place(name, key)).ok()?;
        serde_json::from_str(&text).ok()
    }

    pub fn put<T: Serialize>(&self, name: &str, key: &str, value: &T) -> Result<()> {
        let mut file = temporary::File::new(&self.folder).map_err(|error| self.fault(&error))?;
        serde_json::to_writer(&mut file, value)?;
        file.persist(&self.place(name, key))
            .map_err(|error| self.fault(&error))
    }

    /// The path at which the output of a failing tool is kept.
    pub fn failure_log(&self, name: &str) -> PathBuf {
        self.failed.join(format!("{name}.log"))
    }
}
