//! The instructions and their encoding. Encoder, decoder and manifest derive from these definitions.

use anyhow::{Result, bail, ensure};
use serde::Serialize;

use crate::bkd::Field;

/// An instruction of the update program, as `docs/update.md` defines it. Destinations of merges are implicit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Instruction {
    /// Loads the next vertex in memory.
    Load { register: u8 },
    /// Loads a vertex by its index, which counts from the vertex base: one that was replaced, or the corner of an instance.
    Reload { register: u8, vertex: u32 },
    /// Merges three vertices into a box.
    Leaf { vertices: [u8; 3] },
    /// Merges two vertices and the one loaded last into a box.
    LeafLast { vertices: [u8; 2] },
    /// Merges two boxes and writes the next node.
    Node {
        /// Box registers of left and right child; the first receives the merged box, the second is freed.
        children: [u8; 2],
        /// The axis of the interval of left and right child: 0 = x, 1 = y, 2 = z.
        axes: [u8; 2],
    },
    /// Does nothing for one issue slot.
    Nop,
    /// Writes the object's box and completes the update.
    End { register: u8 },
}

/// The encoding of a kind of instruction.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Form {
    pub name: &'static str,
    /// Length in bytes.
    pub bytes: usize,
    /// The bits of the first byte that identify the form …
    pub mask: u8,
    /// … and their values. If several forms match, the first in [`FORMS`] applies.
    pub value: u8,
    /// Operands, in the order of the listing.
    pub fields: &'static [Field],
}

const fn field(name: &'static str, lsb: u32, width: u32, description: &'static str) -> Field {
    Field {
        name,
        lsb,
        width,
        description,
    }
}

const LOAD: usize = 0;
const RELOAD: usize = 1;
const NOP: usize = 2;
const END: usize = 3;
const LEAF: usize = 4;
const LEAF_LAST: usize = 5;
const NODE: usize = 6;

/// All forms; a first byte that matches none is invalid.
pub static FORMS: [Form; 7] = [
    Form {
        name: "load",
        bytes: 1,
        mask: 0b11,
        value: 0b11,
        fields: &[field("register", 2, 6, "vertex register")],
    },
    Form {
        name: "reload",
        bytes: 5,
        mask: 0xff,
        value: 0x2e,
        fields: &[
            field("register", 8, 6, "vertex register"),
            field("vertex", 14, 26, "index from the vertex base"),
        ],
    },
    Form {
        name: "nop",
        bytes: 1,
        mask: 0xff,
        value: 0x0e,
        fields: &[],
    },
    Form {
        name: "end",
        bytes: 2,
        mask: 0xff,
        value: 0x1e,
        fields: &[field("register", 8, 6, "box register of the whole object")],
    },
    Form {
        name: "leaf",
        bytes: 3,
        mask: 0xf,
        value: 0xc,
        fields: &[
            field("x", 4, 6, "vertex register"),
            field("y", 10, 6, "vertex register"),
            field("z", 16, 6, "vertex register"),
        ],
    },
    Form {
        name: "leaf_last",
        bytes: 2,
        mask: 0xf,
        value: 0xd,
        fields: &[
            field("x", 4, 6, "vertex register"),
            field("y", 10, 6, "vertex register"),
        ],
    },
    Form {
        name: "node",
        bytes: 2,
        // All other values, in which neither axis is 3.
        mask: 0,
        value: 0,
        fields: &[
            field("a", 4, 6, "box register of the left child, and of both"),
            field("b", 10, 6, "box register of the right child, then free"),
            field("left_axis", 0, 2, "axis of the left child's interval"),
            field("right_axis", 2, 2, "axis of the right child's interval"),
        ],
    },
];

impl Instruction {
    /// The encoding of the instruction.
    pub fn form(&self) -> &'static Form {
        &FORMS[self.operands().0]
    }

    /// The index of the form in [`FORMS`] and the values of its fields, padded with zeros.
    fn operands(&self) -> (usize, [u32; 4]) {
        match *self {
            Instruction::Load { register } => (LOAD, [register.into(), 0, 0, 0]),
            Instruction::Reload { register, vertex } => (RELOAD, [register.into(), vertex, 0, 0]),
            Instruction::Nop => (NOP, [0; 4]),
            Instruction::End { register } => (END, [register.into(), 0, 0, 0]),
            Instruction::Leaf {
                vertices: [x, y, z],
            } => (LEAF, [x.into(), y.into(), z.into(), 0]),
            Instruction::LeafLast { vertices: [x, y] } => (LEAF_LAST, [x.into(), y.into(), 0, 0]),
            Instruction::Node {
                children: [a, b],
                axes: [left, right],
            } => (NODE, [a.into(), b.into(), left.into(), right.into()]),
        }
    }

    fn from_operands(form: usize, values: [u32; 4]) -> Self {
        let [x, y, z, w] = values.map(|value| value as u8);
        match form {
            LOAD => Instruction::Load { register: x },
            RELOAD => Instruction::Reload {
                register: x,
                vertex: values[1],
            },
            NOP => Instruction::Nop,
            END => Instruction::End { register: x },
            LEAF => Instruction::Leaf {
                vertices: [x, y, z],
            },
            LEAF_LAST => Instruction::LeafLast { vertices: [x, y] },
            NODE => Instruction::Node {
                children: [x, y],
                axes: [z, w],
            },
            _ => unreachable!("a form's place"),
        }
    }
}

/// The encoded instructions, one after another.
///
/// # Panics
/// If an operand does not fit its field, or if an axis is not 0, 1 or 2.
pub fn encode(instructions: &[Instruction]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(instructions.len() * 5 / 2);
    for instruction in instructions {
        let (place, operands) = instruction.operands();
        let form = &FORMS[place];
        let mut bits = u64::from(form.value);
        for (field, operand) in form.fields.iter().zip(operands) {
            let fits = operand >> field.width == 0;
            assert!(fits, "{instruction:?}: {} does not fit", field.name);
            bits |= u64::from(operand) << field.lsb;
        }
        debug_assert_eq!(
            form_of(bits as u8),
            Some(place),
            "{instruction:?} reads back"
        );
        bytes.extend_from_slice(&bits.to_le_bytes()[..form.bytes]);
    }
    bytes
}

/// Decodes the bytes of a program up to and including `end`; the bytes after it are ignored.
///
/// # Errors
/// Names the first byte at which no instruction starts, the bytes end, or bits that must be 0 are not.
pub fn decode(bytes: &[u8]) -> Result<Vec<Instruction>> {
    let mut instructions = Vec::with_capacity(bytes.len() / 2);
    let mut at = 0;
    loop {
        let Some(&first) = bytes.get(at) else {
            bail!("the program does not end: there are only {at} bytes of it");
        };
        let Some(place) = form_of(first) else {
            bail!("byte {at} of the program, {first:#04x}, starts no instruction");
        };
        let form = &FORMS[place];
        let Some(code) = bytes.get(at..at + form.bytes) else {
            bail!("byte {at} of the program starts an instruction that the end cuts off");
        };
        let mut whole = [0; 8];
        whole[..form.bytes].copy_from_slice(code);
        let bits = u64::from_le_bytes(whole);
        let mut values = [0; 4];
        let mut meant = u64::from(form.mask);
        for (field, value) in form.fields.iter().zip(&mut values) {
            let mask = (1 << field.width) - 1;
            *value = (bits >> field.lsb & mask) as u32;
            meant |= mask << field.lsb;
        }
        ensure!(
            bits & !meant == 0,
            "byte {at} of the program starts a {} with bits set that must be 0",
            form.name
        );
        let instruction = Instruction::from_operands(place, values);
        instructions.push(instruction);
        at += form.bytes;
        if place == END {
            return Ok(instructions);
        }
    }
}

/// The index in [`FORMS`] of the form with this first byte.
fn form_of(first: u8) -> Option<usize> {
    let place = FORMS
        .iter()
        .position(|form| first & form.mask == form.value)?;
    // Axis 3 does not exist; its codes belong to the other forms.
    (place != NODE || first & 0b1100 != 0b1100).then_some(place)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_first_byte_means_what_the_page_says() {
        for first in 0..=u8::MAX {
            let expected = match (first & 3, first >> 2 & 3, first >> 4) {
                (3, _, _) => Some("load"),
                (0, 3, _) => Some("leaf"),
                (1, 3, _) => Some("leaf_last"),
                (2, 3, 0) => Some("nop"),
                (2, 3, 1) => Some("end"),
                (2, 3, 2) => Some("reload"),
                (2, 3, _) => None,
                _ => Some("node"),
            };
            assert_eq!(
                form_of(first).map(|place| FORMS[place].name),
                expected,
                "{first:#04x}"
            );
        }
    }

    #[test]
    fn bits_are_where_the_page_says() {
        let code = |instruction| encode(&[instruction]);
        assert_eq!(code(Instruction::Load { register: 0x2a }), [0xab]);
        let reload = Instruction::Reload {
            register: 63,
            vertex: 0x2ab_cdef,
        };
        let bits: u64 = 0x2e | 63 << 8 | 0x2ab_cdef << 14;
        assert_eq!(code(reload), bits.to_le_bytes()[..5]);
        let leaf = Instruction::Leaf {
            vertices: [1, 2, 63],
        };
        assert_eq!(code(leaf), [0x1c, 0x08, 0x3f]);
        let leaf = Instruction::LeafLast { vertices: [1, 2] };
        assert_eq!(code(leaf), [0x1d, 0x08]);
        let node = Instruction::Node {
            children: [62, 33],
            axes: [1, 2],
        };
        let bits: u16 = 1 | 2 << 2 | 62 << 4 | 33 << 10;
        assert_eq!(code(node), bits.to_le_bytes());
        assert_eq!(code(Instruction::Nop), [0x0e]);
        assert_eq!(code(Instruction::End { register: 5 }), [0x1e, 5]);
    }

    #[test]
    fn random_instructions_read_back() {
        let seed = 0x5eed_0301;
        let mut random = fastrand::Rng::with_seed(seed);
        let mut register = || random.u8(..64);
        let mut instructions: Vec<Instruction> = (0..10_000)
            .map(|number| match number % 6 {
                0 => Instruction::Load {
                    register: register(),
                },
                1 => Instruction::Reload {
                    register: register(),
                    vertex: (number * 6151) % (1 << 26),
                },
                2 => Instruction::Leaf {
                    vertices: [register(), register(), register()],
                },
                3 => Instruction::LeafLast {
                    vertices: [register(), register()],
                },
                4 => Instruction::Node {
                    children: [register(), register()],
                    axes: [register() % 3, register() % 3],
                },
                _ => Instruction::Nop,
            })
            .collect();
        instructions.push(Instruction::End { register: 17 });
        let mut bytes = encode(&instructions);
        bytes.extend([0xff; 3]);
        assert_eq!(decode(&bytes).unwrap(), instructions, "seed {seed:#x}");
    }

    #[test]
    fn what_is_no_program_is_refused() {
        let fault = |bytes: &[u8]| decode(bytes).unwrap_err().to_string();
        assert_eq!(
            fault(&[3, 3]),
            "the program does not end: there are only 2 bytes of it"
        );
        assert_eq!(
            fault(&[3, 0x3e]),
            "byte 1 of the program, 0x3e, starts no instruction"
        );
        assert_eq!(
            fault(&[0x1e]),
            "byte 0 of the program starts an instruction that the end cuts off"
        );
        assert_eq!(
            fault(&[0xc, 0, 0x40]),
            "byte 0 of the program starts a leaf with bits set that must be 0"
        );
    }
}
