//! The command under test.

use std::path::Path;
use std::process::{Command, Stdio};

/// The command in a folder, with arguments that have no space in them, and nothing to read.
pub fn dynrt(arguments: &str, folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dynrt"));
    command
        .args(arguments.split_whitespace())
        .current_dir(folder)
        .stdin(Stdio::null());
    command
}
