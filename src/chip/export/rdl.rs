//! The register file in SystemRDL 2.0.

use super::plain;
use crate::chip::descriptor::ERRORS;
use crate::chip::registers::{self, Access, Field, Register, offset};
use crate::config::Config;
use std::fmt::Write as _;

/// Words of the tables that SystemRDL reserves.
const RESERVED: [&str; 1] = ["signal"];

/// The type of the values of `ERROR_CODE`.
const ERROR_CODES: &str = "error_codes";

/// The register file as the address map `name`. The same configuration gives the same text. `origin` names what has generated it.
pub fn rdl(config: &Config, name: &str, origin: &str) -> String {
    let mut text = format!(
        "// SPDX-License-Identifier: MIT OR Apache-2.0\n\
         // {}\n\n\
         enum {ERROR_CODES} {{\n",
        plain(origin).replace('\n', " ")
    );
    for (code, error, what) in ERRORS {
        let _ = writeln!(
            text,
            "    {} = 32'd{code} {{ desc = {}; }};",
            identifier(error),
            string(what)
        );
    }
    let _ = write!(
        text,
        "}};\n\n\
         addrmap {} {{\n\
         \x20   name = \"Registers of the chip\";\n\
         \x20   desc = \"AXI4-Lite window of {} bytes\";\n\
         \x20   default regwidth = 32;\n\
         \x20   default accesswidth = 32;\n",
        identifier(name),
        registers::WINDOW
    );
    for register in registers::registers(config) {
        describe(&mut text, &register);
    }
    text += "};\n";
    text
}

/// A register with its fields.
fn describe(text: &mut String, register: &Register) {
    let _ = write!(
        text,
        "\n    reg {{\n        desc = {};\n",
        string(&register.what)
    );
    for field in fields(register) {
        let _ = writeln!(text, "        field {{");
        if !field.what.is_empty() {
            let _ = writeln!(text, "            desc = {};", string(field.what));
        }
        if register.offset == offset::ERROR_CODE {
            let _ = writeln!(text, "            encode = {ERROR_CODES};");
        }
        let Field { lsb, width, .. } = field;
        let reset = register.reset >> lsb & (u32::MAX >> (32 - width));
        let _ = writeln!(
            text,
            "            {}\n        }} {}[{}:{lsb}] = {width}'h{reset:x};",
            properties(register),
            identifier(field.name),
            lsb + width - 1
        );
    }
    let _ = writeln!(
        text,
        "    }} {} @ {:#05x};",
        identifier(&register.name),
        register.offset
    );
}

/// What software and hardware do with the fields of a register.
fn properties(register: &Register) -> &'static str {
    match register.access {
        Access::ReadOnly if is_constant(register) => "sw = r; hw = na;",
        Access::ReadOnly => "sw = r; hw = w;",
        Access::ReadWrite => "sw = rw; hw = r;",
        Access::ClearByOne => "sw = rw; onwrite = woclr; hw = r; hwset;",
        Access::Trigger => "sw = w; hw = r; swmod;",
    }
}

/// A name, escaped if it is reserved.
fn identifier(name: &str) -> String {
    match RESERVED.contains(&name) {
        true => format!("\\{name}"),
        false => name.to_string(),
    }
}

fn string(text: &str) -> String {
    format!(
        "\"{}\"",
        plain(text).replace('\\', "\\\\").replace('"', "\\\"")
    )
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
