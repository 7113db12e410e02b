//! Files of lines, written as lines come.

use super::layout::Layout;
use crate::report::folder::Folder;
use anyhow::{Context, Result};
use std::fs::File;
use std::io::{BufWriter, Write};

/// A file of equal lines.
pub struct Sheet {
    /// The file's name.
    pub file: String,
    pub layout: Layout,
    /// Lines so far.
    pub lines: u64,
    shown: String,
    writer: BufWriter<File>,
}

impl Sheet {
    /// # Errors
    /// One line that names the file.
    pub fn new(folder: &Folder, stem: &str, layout: Layout) -> Result<Sheet> {
        let file = format!("{stem}.hex");
        let shown = folder.shown(&file);
        let writer = File::create(folder.file(&file))
            .with_context(|| format!("{shown}: cannot be written"))?;
        Ok(Sheet {
            file,
            layout,
            lines: 0,
            shown,
            writer: BufWriter::new(writer),
        })
    }

    /// Appends a line.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn push(&mut self, values: &[u64]) -> Result<()> {
        let line = self.layout.line(values);
        self.push_text(&line)
    }

    /// Appends a line that is made up already.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn push_text(&mut self, line: &str) -> Result<()> {
        self.lines += 1;
        writeln!(self.writer, "{line}")
            .with_context(|| format!("{}: cannot be written", self.shown))
    }

    /// Writes what is still held back.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn finish(&mut self) -> Result<()> {
        self.writer
            .flush()
            .with_context(|| format!("{}: cannot be written", self.shown))
    }
}

/// A unit's stimulus and expected results, and which bits of these are compared.
pub struct UnitSheets {
    /// The unit.
    pub name: &'static str,
    pub stimulus: Sheet,
    pub expected: Sheet,
    /// `None` if all bits are always compared.
    pub care: Option<Sheet>,
}

impl UnitSheets {
    /// # Errors
    /// One line that names the file that cannot be written.
    pub fn new(
        folder: &Folder,
        name: &'static str,
        stimulus: Layout,
        expected: Layout,
        with_care: bool,
    ) -> Result<UnitSheets> {
        let care = with_care
            .then(|| Sheet::new(folder, &format!("{name}_care"), expected.clone()))
            .transpose()?;
        Ok(UnitSheets {
            name,
            stimulus: Sheet::new(folder, &format!("{name}_stimulus"), stimulus)?,
            expected: Sheet::new(folder, &format!("{name}_expected"), expected)?,
            care,
        })
    }

    /// Appends a transaction. A value that is not compared is written as 0.
    ///
    /// # Errors
    /// One line that names the file that cannot be written.
    pub fn push(&mut self, stimulus: &[u64], expected: &[(u64, bool)]) -> Result<()> {
        self.stimulus.push(stimulus)?;
        let values = expected
            .iter()
            .map(|&(value, meant)| value * u64::from(meant));
        self.expected.push(&values.collect::<Vec<_>>())?;
        if let Some(care) = &mut self.care {
            let fields = care.layout.fields.iter().zip(expected);
            let mask = fields
                .map(|(field, &(_, meant))| u64::from(meant) * (u64::MAX >> (64 - field.width)));
            let mask: Vec<_> = mask.collect();
            care.push(&mask)?;
        }
        Ok(())
    }

    pub fn sheets(&mut self) -> impl Iterator<Item = &mut Sheet> {
        [
            Some(&mut self.stimulus),
            Some(&mut self.expected),
            self.care.as_mut(),
        ]
        .into_iter()
        .flatten()
    }
}
