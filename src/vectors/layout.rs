//! The layout of a line in a vectors file.

use crate::bkd::layout::{Field as RecordField, Record};
use crate::float::Format;
use serde::Serialize;

/// The interpretation of a field's bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// A floating-point number of the machine's format. A field that is one bit narrower has no sign bit; the sign is +.
    Number,
    /// An unsigned number.
    Unsigned,
    /// One bit per ray of a packet (bit 0 for slot 0), per axis (bit 0 for x), or per lane.
    Mask,
    /// One bit, 1 for yes.
    Flag,
}

/// A named range of a line's bits.
#[derive(Clone, Debug, Serialize)]
pub struct Field {
    pub name: String,
    /// Position of the least significant bit; bit 0 is the least significant bit of the line's last digit.
    pub lsb: u32,
    /// Width in bits, 1 to 64.
    pub width: u32,
    pub kind: Kind,
    pub description: String,
}

/// The fields of a file's lines, from the least significant bit up, without gaps.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Layout {
    /// Width of a line in bits.
    pub width: u32,
    pub fields: Vec<Field>,
}

impl Layout {
    /// Appends a field above the existing ones.
    pub fn field(
        mut self,
        name: impl Into<String>,
        width: u32,
        kind: Kind,
        description: impl Into<String>,
    ) -> Self {
        self.fields.push(Field {
            name: name.into(),
            lsb: self.width,
            width,
            kind,
            description: description.into(),
        });
        self.width += width;
        self
    }

    /// Appends the components x, y and z of a vector.
    pub fn vector(mut self, name: &str, width: u32, description: &str) -> Self {
        for axis in ["x", "y", "z"] {
            self = self.field(
                format!("{name}_{axis}"),
                width,
                Kind::Number,
                format!("{description}, {axis}"),
            );
        }
        self
    }

    /// Appends the fields of a record in memory.
    pub fn record(mut self, record: &Record, format: Format) -> Self {
        for RecordField {
            name,
            width,
            description,
            ..
        } in &record.fields
        {
            let kind = match name.trim_end_matches(|c: char| c.is_ascii_digit()) {
                "left_leaf" | "right_leaf" | "last" => Kind::Flag,
                "left_axis" | "right_axis" | "link" | "v" | "number" | "joint" | "vectors"
                | "root" | "unused" => Kind::Unsigned,
                stem => {
                    let signless = u32::from(stem == "weight");
                    assert_eq!(*width + signless, format.width(), "{name} is a number");
                    Kind::Number
                }
            };
            self = self.field(*name, *width, kind, *description);
        }
        self
    }

    /// Number of hexadecimal digits of a line.
    pub fn digits(&self) -> usize {
        self.width.div_ceil(4) as usize
    }

    /// The line that contains `values`, one per field in the order of the fields, as hexadecimal digits, most significant first.
    ///
    /// # Panics
    /// If the number of values is not the number of fields, or if a value does not fit.
    pub fn line(&self, values: &[u64]) -> String {
        assert_eq!(values.len(), self.fields.len(), "a value a field");
        let mut nibbles = vec![0u8; self.digits()];
        for (field, &value) in self.fields.iter().zip(values) {
            assert!(
                field.width == 64 || value >> field.width == 0,
                "{value:#x} does not fit the {} bits of {}",
                field.width,
                field.name
            );
            for bit in 0..field.width {
                let place = field.lsb + bit;
                nibbles[(place / 4) as usize] |= ((value >> bit & 1) as u8) << (place % 4);
            }
        }
        let digit = |nibble: &u8| char::from_digit(u32::from(*nibble), 16).expect("a nibble");
        nibbles.iter().rev().map(digit).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_first_field_is_the_last_digit() {
        let layout = Layout::default()
            .field("low", 3, Kind::Unsigned, "")
            .field("middle", 6, Kind::Unsigned, "")
            .field("high", 1, Kind::Flag, "");
        assert_eq!((layout.width, layout.digits()), (10, 3));
        // 1 | 10_0101 | 110
        assert_eq!(layout.line(&[0b110, 0b10_0101, 1]), "32e");
    }

    #[test]
    #[should_panic(expected = "does not fit the 3 bits of low")]
    fn a_value_that_is_too_great_is_refused() {
        let layout = Layout::default().field("low", 3, Kind::Unsigned, "");
        layout.line(&[8]);
    }
}
