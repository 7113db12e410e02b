//! Where the public scenes are that `sim/fetch_scenes.sh` fetches.

use std::io::Write;
use std::path::PathBuf;

/// A file or folder of the public scenes, or nothing and a line about it where it is absent. `DYNRT_SCENES` names their folder;
/// cargo sets it, see `.cargo/config.toml`.
#[allow(dead_code)]
pub fn shared_scene(file: &str) -> Option<String> {
    let path = std::env::var_os("DYNRT_SCENES").map(|folder| PathBuf::from(folder).join(file));
    if let Some(path) = path.filter(|path| path.exists()) {
        return Some(path.to_string_lossy().into_owned());
    }
    // Not eprintln!, which the test runner keeps to itself.
    let _ = writeln!(
        std::io::stderr(),
        "absent, so not checked: {file} (run sim/fetch_scenes.sh)"
    );
    None
}
