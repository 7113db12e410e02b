//! What a person is to read of a test that passes.

use std::io::Write;

/// A line on standard error, which the test runner does not keep to itself.
pub fn say(line: &str) {
    let _ = writeln!(std::io::stderr(), "{line}");
}
