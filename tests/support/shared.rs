//! Finds the public scenes that `sim/fetch_scenes.sh` downloads.

use std::io::Write;
use std::path::PathBuf;

/// A file or folder of the public scenes; if it is absent, prints a line and returns `None`. `DYNRT_SCENES` names their folder;
/// cargo sets it, see `.cargo/config.toml`.
#[allow(dead_code)]
pub fn shared_scene(file: &str) -> Option<String> {
    let path = std::env::var_os("DYNRT_SCENES").map(|folder| PathBuf::from(folder).join(file));
    if let Some(path) = path.filter(|path| path.exists()) {
        return Some(path.to_string_lossy().into_owned());
    }
    // Not `eprintln!`, which the test runner captures.
    let _ = writeln!(
        std::io::stderr(),
        "absent, so not checked: {file} (run sim/fetch_scenes.sh)"
    );
    None
}
