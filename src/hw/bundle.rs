//! Words that pack named values: what a queue carries, what a memory holds.

use crate::hdl::Signal;

/// Named fields, the first least significant.
#[derive(Clone, Debug)]
pub struct Bundle {
    fields: Vec<(&'static str, u32)>,
}

impl Bundle {
    pub fn new(fields: &[(&'static str, u32)]) -> Bundle {
        Bundle {
            fields: fields.to_vec(),
        }
    }

    pub fn width(&self) -> u32 {
        self.fields.iter().map(|(_, w)| w).sum()
    }

    fn position(&self, name: &str) -> (u32, u32) {
        let mut lsb = 0;
        for (field, width) in &self.fields {
            if *field == name {
                return (lsb, *width);
            }
            lsb += width;
        }
        panic!("a bundle of {:?} has no field {name}", self.fields)
    }

    /// A word of the fields' values, in the order of the fields.
    #[track_caller]
    pub fn pack<'b>(&self, values: &[(&str, Signal<'b>)]) -> Signal<'b> {
        assert_eq!(values.len(), self.fields.len(), "a value for each field");
        let mut parts: Vec<_> = self
            .fields
            .iter()
            .map(|(name, width)| {
                let (_, signal) = values
                    .iter()
                    .find(|(n, _)| n == name)
                    .unwrap_or_else(|| panic!("no value for field {name}"));
                assert_eq!(signal.width(), *width, "width of field {name}");
                *signal
            })
            .collect();
        parts.reverse();
        parts[0].module().concat(&parts)
    }

    /// A field of a word.
    #[track_caller]
    pub fn get<'b>(&self, word: Signal<'b>, name: &str) -> Signal<'b> {
        let (lsb, width) = self.position(name);
        word.field(lsb, width)
    }
}
