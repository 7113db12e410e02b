//! Files for software, from the tables of registers and descriptors: a header for C, and the register file in SystemRDL.

mod c;
mod rdl;

pub use c::header;
pub use rdl::rdl;

/// The key of these files in a manifest.
pub const KEY: &str = "host";

/// The names of the header and of the SystemRDL file of a machine whose names begin with `prefix`.
pub fn names(prefix: &str) -> [String; 2] {
    [
        format!("{prefix}regs.h"),
        format!("{}.rdl", prefix.trim_end_matches('_')),
    ]
}

/// A text of the tables in ASCII, for a comment or a string.
fn plain(text: &str) -> String {
    let text = text.replace('–', "-").replace('`', "");
    text.chars().filter(char::is_ascii).collect()
}
