//! Files for software, from the tables of registers and descriptors: a header for C, and the register file in SystemRDL.

mod c;
mod rdl;

use super::registers::{Access, Field, Register, offset};

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

/// Whether a register never changes.
fn is_constant(register: &Register) -> bool {
    register.access == Access::ReadOnly && register.offset < offset::LIST
}

/// The fields of a register; one of a single value is a field of 32 bits.
fn fields(register: &Register) -> Vec<Field> {
    if !register.fields.is_empty() {
        return register.fields.clone();
    }
    let value = Field {
        name: "value",
        lsb: 0,
        width: 32,
        what: "",
    };
    vec![value]
}
