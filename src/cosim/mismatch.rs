//! The report of the first difference between RTL and golden model.

use crate::float::Format;
use std::fmt;

/// One compared value.
#[derive(Clone, Debug)]
pub struct Field {
    name: String,
    format: Option<Format>,
    golden: u64,
    rtl: u64,
}

impl Field {
    pub fn integer(name: impl Into<String>, golden: u64, rtl: u64) -> Field {
        Field {
            name: name.into(),
            format: None,
            golden,
            rtl,
        }
    }

    /// Whether golden model and RTL differ.
    pub fn differs(&self) -> bool {
        self.golden != self.rtl
    }

    /// A number of a format, given by bit patterns.
    pub fn number(name: impl Into<String>, format: Format, golden: u64, rtl: u64) -> Field {
        Field {
            name: name.into(),
            format: Some(format),
            golden,
            rtl,
        }
    }
}

/// The first difference of a run.
#[derive(Clone, Debug)]
pub struct Mismatch {
    pub unit: &'static str,
    /// The transaction that differs.
    pub place: String,
    pub cycle: u64,
    pub fields: Vec<Field>,
    /// The command that repeats the run.
    pub replay: String,
}

/// Number of cycles before the mismatch in its waveform.
const LEAD: u64 = 400;

impl fmt::Display for Mismatch {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "mismatch in unit {} at cycle {}: {}",
            self.unit, self.cycle, self.place
        )?;
        for field in &self.fields {
            let mark = if field.golden == field.rtl { ' ' } else { '*' };
            match field.format {
                Some(format) => {
                    let digits = format.width().div_ceil(4) as usize;
                    write!(
                        f,
                        "\n {mark} {:24} golden {:0digits$x} ({:e})  rtl {:0digits$x} ({:e})",
                        field.name,
                        field.golden,
                        format.to_f64(field.golden),
                        field.rtl,
                        format.to_f64(field.rtl),
                    )?;
                }
                None => write!(
                    f,
                    "\n {mark} {:24} golden {:x} ({})  rtl {:x} ({})",
                    field.name, field.golden, field.golden, field.rtl, field.rtl
                )?,
            }
        }
        if !self.replay.is_empty() {
            let from = self.cycle.saturating_sub(LEAD);
            write!(
                f,
                "\n   replay with a waveform: {} --trace mismatch.fst --from {from} --cycles {}",
                self.replay,
                LEAD + 20
            )?;
        }
        Ok(())
    }
}

impl std::error::Error for Mismatch {}
