//! Records in bytes: where each part of a record lies in the byte-addressed memory of the chip. The one definition from which memory
//! images, the golden chip, the RTL and `docs/layout.md` derive.

use super::layout::{Field, Record};
use crate::float::Format;

/// Alignment of the base of an array, of a command list and of its descriptors, in bytes.
pub const BASE_ALIGNMENT: u32 = 64;

/// What the bits of a part mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// A number of the machine's format. −0 is read as +0.
    Number,
    /// A number without its sign, an index, a link word or several fields together.
    Bits,
}

/// A part of a record that starts and ends at byte boundaries in memory. It is little-endian; the bits between its width and its
/// last byte are written as 0 and not read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Part {
    pub name: &'static str,
    /// The part's least significant bit in the record.
    pub lsb: u32,
    /// Bits, 1 to 64.
    pub width: u32,
    /// The part's first byte in the record.
    pub offset: u32,
    pub meaning: Meaning,
}

impl Part {
    /// Bytes in memory.
    pub fn bytes(&self) -> u32 {
        self.width.div_ceil(8)
    }

    fn field(&self) -> Field {
        Field {
            name: self.name,
            lsb: self.lsb,
            width: self.width,
            description: "",
        }
    }
}

/// A record in bytes: its parts one after another, then zeros up to a power of two.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ByteRecord {
    pub record: Record,
    pub parts: Vec<Part>,
    /// Bytes from one record of an array to the next, a power of two.
    pub bytes: u32,
    format: Format,
}

impl ByteRecord {
    /// Lays out a record. `groups` gives the number of consecutive fields of each part, with its name and meaning.
    fn new(format: Format, record: Record, groups: &[(usize, &'static str, Meaning)]) -> Self {
        let mut fields = record.fields.iter();
        let mut offset = 0;
        let mut parts = vec![];
        for &(count, name, meaning) in groups {
            let members: Vec<&Field> = fields.by_ref().take(count).collect();
            let part = Part {
                name,
                lsb: members[0].lsb,
                width: members.iter().map(|field| field.width).sum(),
                offset,
                meaning,
            };
            offset += part.bytes();
            parts.push(part);
        }
        assert_eq!(fields.count(), 0, "every field is in a part");
        ByteRecord {
            record,
            parts,
            bytes: offset.next_power_of_two(),
            format,
        }
    }

    /// A record whose fields are one part each.
    fn of_fields(format: Format, record: Record, numbers: usize) -> Self {
        let groups: Vec<_> = (record.fields.iter().enumerate())
            .map(|(place, field)| match place < numbers {
                true => (1, field.name, Meaning::Number),
                false => (1, field.name, Meaning::Bits),
            })
            .collect();
        ByteRecord::new(format, record, &groups)
    }

    /// A node: its four numbers, then its link word.
    pub fn node(format: Format) -> Self {
        let number = |name| (1, name, Meaning::Number);
        let groups = [
            number("left_lo"),
            number("left_hi"),
            number("right_lo"),
            number("right_hi"),
            (5, "link_word", Meaning::Bits),
        ];
        ByteRecord::new(format, Record::node(format), &groups)
    }

    /// A vertex. A box is two of them: the least corner, then the greatest.
    pub fn vertex(format: Format) -> Self {
        ByteRecord::of_fields(format, Record::vertex(format), 3)
    }

    /// A triangle record or an instance record.
    pub fn triangle(format: Format) -> Self {
        ByteRecord::of_fields(format, Record::triangle(), 0)
    }

    /// A row of influences: each influence is a part.
    pub fn influence_row(format: Format) -> Self {
        let names = ["influence0", "influence1", "influence2", "influence3"];
        let groups = names.map(|name| (3, name, Meaning::Bits));
        ByteRecord::new(format, Record::influence_row(format), &groups)
    }

    /// A hit.
    pub fn hit(format: Format) -> Self {
        ByteRecord::of_fields(format, Record::hit(format), 3)
    }

    /// Writes a record of little-endian `words` into `bytes`, which holds [`ByteRecord::bytes`].
    ///
    /// # Panics
    /// If `bytes` has another length.
    pub fn write(&self, words: &[u32], bytes: &mut [u8]) {
        assert_eq!(bytes.len(), self.bytes as usize, "one record");
        bytes.fill(0);
        for part in &self.parts {
            let value = part.field().get(words).to_le_bytes();
            let place = part.offset as usize;
            let count = part.bytes() as usize;
            bytes[place..place + count].copy_from_slice(&value[..count]);
        }
    }

    /// Reads a record as little-endian words; −0 becomes +0.
    ///
    /// # Panics
    /// If `bytes` does not hold [`ByteRecord::bytes`].
    pub fn read(&self, bytes: &[u8]) -> Vec<u32> {
        assert_eq!(bytes.len(), self.bytes as usize, "one record");
        let mut words = vec![0; self.record.words()];
        for part in &self.parts {
            let mut value = [0; 8];
            let place = part.offset as usize;
            let count = part.bytes() as usize;
            value[..count].copy_from_slice(&bytes[place..place + count]);
            let mut value = u64::from_le_bytes(value) & (u64::MAX >> (64 - part.width));
            let exponent = value >> self.format.fraction_bits() & self.format.exponent_mask();
            if part.meaning == Meaning::Number && exponent == 0 {
                value &= !self.format.sign_bit();
            }
            part.field().set(&mut words, value);
        }
        words
    }

    /// The bytes of an array from the words of its records ([`Record::words`] each).
    pub fn array(&self, words: &[u32]) -> Vec<u8> {
        let records = words.chunks_exact(self.record.words());
        let mut bytes = vec![0; records.len() * self.bytes as usize];
        let places = bytes.chunks_exact_mut(self.bytes as usize);
        for (record, place) in records.zip(places) {
            self.write(record, place);
        }
        bytes
    }

    /// The rows of this record's table in `docs/layout.md`.
    pub fn table(&self) -> String {
        let mut table = String::from("| part | bytes | what |\n|---|---|---|\n");
        let mut row = |name: &str, first: u32, count: u32, what: &str| {
            let last = first + count - 1;
            let bytes = match count {
                1 => first.to_string(),
                _ => format!("{first}–{last}"),
            };
            table += &format!("| {name} | {bytes} | {what} |\n");
        };
        let mut end = 0;
        for part in &self.parts {
            let what = match part.meaning {
                Meaning::Number => "number".to_string(),
                Meaning::Bits => format!("{} bits", part.width),
            };
            row(
                &format!("`{}`", part.name),
                part.offset,
                part.bytes(),
                &what,
            );
            end = part.offset + part.bytes();
        }
        if end < self.bytes {
            row("", end, self.bytes - end, "0");
        }
        table
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn all(format: Format) -> [ByteRecord; 5] {
        [
            ByteRecord::node(format),
            ByteRecord::vertex(format),
            ByteRecord::triangle(format),
            ByteRecord::influence_row(format),
            ByteRecord::hit(format),
        ]
    }

    #[test]
    fn every_record_of_the_reference_format_takes_16_bytes() {
        assert_eq!(all(Format::FP24).map(|record| record.bytes), [16; 5]);
        let wide = Format::new(10, 23).unwrap();
        assert_eq!(all(wide).map(|record| record.bytes), [32, 16, 16, 32, 32]);
        let narrow = Format::new(3, 2).unwrap();
        assert_eq!(all(narrow).map(|record| record.bytes), [8, 4, 16, 8, 16]);
    }

    /// Any bits come back, except the sign of a zero.
    #[test]
    fn records_survive_memory_but_for_minus_zero() {
        let mut rng = fastrand::Rng::with_seed(1);
        for format in [(3, 2), (7, 16), (8, 23), (10, 23), (5, 9)] {
            let format = Format::new(format.0, format.1).unwrap();
            for record in all(format) {
                for _ in 0..200 {
                    let mut words = vec![0; record.record.words()];
                    for field in &record.record.fields {
                        let any = rng.u64(..) & (u64::MAX >> (64 - field.width));
                        field.set(&mut words, any);
                    }
                    let bytes = record.array(&words);
                    for (part, field) in record.parts.iter().zip(&record.record.fields) {
                        if part.meaning == Meaning::Number
                            && field.get(&words) & format.infinity() == 0
                        {
                            let value = field.get(&words) & !format.sign_bit();
                            field.set(&mut words, value);
                        }
                    }
                    assert_eq!(record.read(&bytes), words, "{}", record.record.name);
                }
            }
        }
    }
}
