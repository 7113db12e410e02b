//! The command under test.

use std::path::Path;
use std::process::{Command, Stdio};

/// The command in a folder, with arguments without spaces, and with empty standard input.
pub fn dynrt(arguments: &str, folder: &Path) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dynrt"));
    command
        .args(arguments.split_whitespace())
        .current_dir(folder)
        .stdin(Stdio::null());
    command
}
