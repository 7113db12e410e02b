//! Results that were reached before, under a key of all that went into them.

use crate::cache;
use crate::temporary;
use anyhow::{Result, anyhow};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::fs;
use std::path::PathBuf;

pub(crate) use crate::cache::key;

/// Test bench, golden model and all else but the Verilog that decides what a check finds, as a part of keys; see `src/build.rs`.
pub(crate) const CHECKS: &str = env!("DYNRT_SOURCES");

/// The folder of results.
pub(crate) struct Store {
    folder: PathBuf,
    failed: PathBuf,
}

impl Store {
    /// Of synthesis, in the cache folder given, or the user's.
    pub fn open(cache: Option<PathBuf>) -> Result<Store> {
        Store::open_in(cache, "synth")
    }

    /// Of that name, in the cache folder given, or the user's.
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

    /// What is known; nothing too where the file cannot be read, so that it is made again.
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

    /// Where all that a failing tool said is kept.
    pub fn failure_log(&self, name: &str) -> PathBuf {
        self.failed.join(format!("{name}.log"))
    }
}
