//! What the layer says of a mistaken design.

use std::fmt;
use std::panic::Location;

/// A mistake in the description of a module, and where in the Rust source it was made.
#[derive(Debug, Clone)]
pub struct HdlError {
    pub module: String,
    pub message: String,
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
