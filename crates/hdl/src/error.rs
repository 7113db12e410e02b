//! The error type of the crate.

use std::fmt;
use std::panic::Location;

/// A mistake in the description of a module, and its place in the Rust source. It is displayed as
/// `file:line: module name: message`.
#[derive(Debug, Clone)]
pub struct HdlError {
    /// The name of the module.
    pub module: String,
    /// A description of the mistake.
    pub message: String,
    /// The place in the Rust source that describes the module.
    pub place: &'static Location<'static>,
}

impl fmt::Display for HdlError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{}:{}: module {}: {}",
            self.place.file(),
            self.place.line(),
            self.module,
            self.message
        )
    }
}

impl std::error::Error for HdlError {}
