//! What a host and the chip share: registers, descriptors of commands, rays and hits in bytes. `docs/chip.md` is the normative page; the
//! tables here are the one definition from which the RTL, the golden chip, `docs/registers.md` and the files for software derive.

pub mod descriptor;
pub mod export;
pub mod image;
pub mod memory;
pub mod ray;
pub mod registers;

use crate::bkd::bytes::ByteRecord;
use crate::config::Config;
use std::fmt::Write as _;

/// What the numbers in descriptors are checked against.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Rays of a cast.
    pub rays: u32,
    /// Matrices of a palette.
    pub joints: u32,
    /// The greatest index of a record, and number of rows or vertices.
    pub greatest_index: u32,
    /// Bytes of a box, which is two vertex records.
    pub box_bytes: u32,
}

impl Limits {
    pub fn of(config: &Config) -> Limits {
        Limits {
            rays: most_rays(config),
            joints: config.skinning_joints,
            greatest_index: u32::MAX >> (32 - config.address_bits),
            box_bytes: 2 * ByteRecord::vertex(config.format()).bytes,
        }
    }
}

/// Rays that a cast may have: the tags tell packets apart, and the addresses of rays stay within the address space.
pub fn most_rays(config: &Config) -> u32 {
    let rays = u64::from(config.rays_per_packet) << config.tag_bits;
    rays.min(1 << 26) as u32
}

/// The text of `docs/registers.md`, for the machine of a configuration.
pub fn page(config: &Config) -> String {
    let mut page = String::from(
        "# Registers and descriptors\n\n\
         This page is generated from `src/chip/registers.rs` and `src/chip/descriptor.rs` for the reference machine; a test keeps it current.\n\
         [`chip.md`](chip.md) defines what the registers and commands do.\n\
         `dynrt generate --top chip` writes the same as a C header and in SystemRDL, for any machine: [`integrating.md`](integrating.md#driver).\n\n\
         ## Registers\n\n\
         Offsets are in bytes from the base of the AXI4-Lite window.\n\n",
    );
    page += &registers::table(config);
    page += "\n## Descriptors\n\nA descriptor has 16 words of 32 bits. Bits 7:0 of word 0 are the opcode, bits 15:8 the flags. Words that are not listed are 0.\n";
    for command in descriptor::COMMANDS {
        let _ = write!(
            page,
            "\n### `{}`\n\nOpcode {}: {}.\n",
            command.name, command.opcode, command.what
        );
        if !command.words.is_empty() || !command.flags.is_empty() {
            page += "\n| place | name | what |\n|---|---|---|\n";
        }
        for (bit, name, what) in command.flags {
            let _ = writeln!(page, "| flag {bit} | `{name}` | {what} |");
        }
        for (word, name, what) in command.words {
            let _ = writeln!(page, "| word {word} | `{name}` | {what} |");
        }
    }
    page += "\n## Error codes\n\n| code | name | condition |\n|---|---|---|\n";
    for (code, name, what) in descriptor::ERRORS {
        let _ = writeln!(page, "| {code} | `{name}` | {what} |");
    }
    page
}
