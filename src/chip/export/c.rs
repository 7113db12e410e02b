//! The header for C: offsets, fields, descriptors, records, limits.

use super::plain;
use crate::bkd::bytes::{BASE_ALIGNMENT, ByteRecord};
use crate::chip::descriptor::{self, COMMANDS, ERRORS};
use crate::chip::registers::{self, COUNTER_BITS, COUNTERS, Register, WINDOW, offset};
use crate::chip::{Limits, ray};
use crate::config::{Config, TriangleTest};
use std::fmt::Write as _;

/// Writes macros.
struct Header {
    text: String,
}

impl Header {
    /// Begins a group of macros.
    fn section(&mut self, what: &str) {
        let _ = write!(self.text, "\n/* {} */\n\n", plain(what));
    }

    /// A macro with a value, and its meaning if it has one.
    fn define(&mut self, name: &str, value: &str, what: &str) {
        let name = format!("DYNRT_{}", name.to_uppercase());
        let _ = match what {
            "" => writeln!(self.text, "#define {name} {value}"),
            _ => writeln!(self.text, "#define {name} {value} /* {} */", plain(what)),
        };
    }

    /// A macro with a number in decimal.
    fn number(&mut self, name: &str, value: u32, what: &str) {
        self.define(name, &format!("{value}u"), what);
    }

    /// A macro with a number in hexadecimal.
    fn bits(&mut self, name: &str, value: u32, what: &str) {
        self.define(name, &format!("{value:#x}u"), what);
    }

    /// A macro that expands to its argument for each row.
    fn each(&mut self, name: &str, arguments: &str, rows: impl Iterator<Item = String>) {
        let _ = write!(
            self.text,
            "\n/* Expands X({arguments}) for each row of the table. */\n#define DYNRT_FOR_EACH_{name}(X)"
        );
        for row in rows {
            let _ = write!(self.text, " \\\n    X({row})");
        }
        self.text.push('\n');
    }
}

/// The header of a machine's registers, descriptors, records and limits. The same configuration gives the same text. `origin` names what
/// has generated it.
pub fn header(config: &Config, origin: &str) -> String {
    let mut header = Header {
        text: format!(
            "/* SPDX-License-Identifier: MIT OR Apache-2.0 */\n\
             /* {} */\n\
             /* Registers, command lists and records of the chip; docs/chip.md of DynRT says what they do. */\n\
             #ifndef DYNRT_REGS_H\n#define DYNRT_REGS_H\n",
            plain(origin).replace("*/", "")
        ),
    };
    let all = registers::registers(config);
    machine(&mut header, config);
    register_file(&mut header, &all);
    field_bits(&mut header, &all);
    counters(&mut header);
    descriptors(&mut header);
    errors(&mut header);
    header.text += "\n#endif\n";
    header.text
}

/// What a host must know of a machine: sizes and limits.
fn machine(header: &mut Header, config: &Config) {
    let format = config.format();
    header.section("Numbers: sign, exponent, fraction, from the highest bit down");
    header.number("exponent_bits", config.exponent_bits, "");
    header.number("fraction_bits", config.fraction_bits, "");
    header.number("number_bytes", format.width().div_ceil(8), "in memory");

    header.section("Records in memory, in bytes; all values are little-endian");
    let records = [
        ("node", ByteRecord::node(format)),
        ("record", ByteRecord::triangle(format)),
        ("vertex", ByteRecord::vertex(format)),
        ("influence_row", ByteRecord::influence_row(format)),
        ("hit", ByteRecord::hit(format)),
    ];
    for (name, record) in &records {
        header.number(&format!("{name}_bytes"), record.bytes, "");
    }
    let box_bytes = Limits::of(config).box_bytes;
    header.number("box_bytes", box_bytes, "two vertices");
    header.number("ray_bytes", ray::BYTES as u32, "");
    header.number("short_ray_bytes", ray::SHORT_BYTES as u32, "");
    header.number("program_row_bytes", 16, "a row of an update program");
    for part in &records[4].1.parts {
        header.number(&format!("hit_{}_offset", part.name), part.offset, "");
        header.number(&format!("hit_{}_bytes", part.name), part.bytes(), "");
    }
    header.bits("no_triangle", u32::MAX, "the triangle of a miss");

    header.section("Multiples that addresses must be of, in bytes");
    header.number("base_alignment", BASE_ALIGNMENT, "arrays, hits, a list");
    header.number(
        "stream_alignment",
        16,
        "rays, influences, an update program",
    );
    header.number("word_alignment", 4, "the word of a signal or a wait");

    header.section("Limits of this machine");
    let limits = Limits::of(config);
    let rows = [
        (
            "rays_per_packet",
            config.rays_per_packet,
            "consecutive rays are traversed together",
        ),
        ("most_rays", limits.rays, "of a cast"),
        ("most_joints", limits.joints, "matrices of a palette"),
        (
            "greatest_index",
            limits.greatest_index,
            "of a record; also the most rows or vertices of a command",
        ),
        (
            "stack_depth",
            config.stack_depth,
            "greatest depth of a tree in inner nodes",
        ),
        ("axes_per_node", config.axes_per_node, ""),
        (
            "watertight",
            u32::from(config.triangle_test == TriangleTest::Watertight),
            "whether the triangle test is watertight",
        ),
    ];
    for (name, value, what) in rows {
        header.number(name, value, what);
    }
}

/// Offsets and values after reset.
fn register_file(header: &mut Header, all: &[Register]) {
    header.section("Registers: offsets in bytes from the base of the window");
    header.bits("window_bytes", WINDOW, "");
    for register in all {
        let access = register.access.name();
        header.define(
            &format!("reg_{}", register.name),
            &format!("{:#05x}u", register.offset),
            &format!("{access}: {}", register.what),
        );
    }
    header.section("Registers: values after reset; a constant keeps it");
    for register in all {
        header.bits(&format!("{}_reset", register.name), register.reset, "");
    }
    let rows = all.iter().map(|register| {
        format!(
            "{}, {:#05x}u, {}, {:#x}u",
            register.name,
            register.offset,
            register.access.name().to_uppercase(),
            register.reset
        )
    });
    header.each("REGISTER", "name, offset, access, reset", rows);
}

/// Shifts and masks.
fn field_bits(header: &mut Header, all: &[Register]) {
    header.section("Fields: the place of the lowest bit, and a mask of all bits in their place");
    for register in all {
        for field in &register.fields {
            let name = format!("{}_{}", register.name, field.name);
            header.number(&format!("{name}_shift"), field.lsb, field.what);
            let mask = (u32::MAX >> (32 - field.width)) << field.lsb;
            header.bits(&format!("{name}_mask"), mask, "");
        }
    }
    let rows = all.iter().flat_map(|register| {
        let names = register
            .fields
            .iter()
            .map(|field| field.name.to_uppercase());
        names.map(|field| format!("{}, {field}", register.name))
    });
    header.each("FIELD", "register, name", rows);
}

fn counters(header: &mut Header) {
    header.section(
        "Counters: each has two registers, the low half first; SNAPSHOT copies all of them",
    );
    header.number("counter_bits", COUNTER_BITS, "a counter wraps");
    header.number("counter_count", COUNTERS.len() as u32, "");
    header.bits("reg_counters", offset::COUNTERS, "the first counter");
    for (place, (name, what)) in COUNTERS.iter().enumerate() {
        header.number(&format!("counter_{name}"), place as u32, what);
    }
    let rows = (COUNTERS.iter().enumerate())
        .map(|(place, (name, _))| format!("{}, {place}u, \"{name}\"", name.to_uppercase()));
    header.each("COUNTER", "name, number, text", rows);
}

fn descriptors(header: &mut Header) {
    header.section(
        "Descriptors: word 0 holds the opcode and the flags, words that are not named are 0",
    );
    header.number("descriptor_words", descriptor::WORDS as u32, "");
    header.number("descriptor_bytes", descriptor::BYTES, "");
    for command in COMMANDS {
        let name = command.name;
        header.text.push('\n');
        header.number(&format!("op_{name}"), command.opcode, command.what);
        for (bit, flag, what) in command.flags {
            header.bits(
                &format!("{name}_flag_{flag}"),
                1 << (8 + bit),
                &format!("in word 0: {what}"),
            );
        }
        for (place, word, what) in command.words {
            header.number(&format!("{name}_word_{word}"), *place as u32, what);
        }
    }
}

fn errors(header: &mut Header) {
    header.section("Values of ERROR_CODE");
    for (code, name, what) in ERRORS {
        header.number(&format!("error_{name}"), *code, what);
    }
    let rows = ERRORS.iter().map(|(code, name, what)| {
        format!(
            "{}, {code}u, \"{name}\", \"{}\"",
            name.to_uppercase(),
            plain(what)
        )
    });
    header.each("ERROR", "name, code, text, condition", rows);
}
