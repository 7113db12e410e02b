//! Messages of tests that pass.

use std::io::Write;

/// Writes a line to standard error, past the test runner, which would capture it.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
