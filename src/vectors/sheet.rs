//! Files that are written line by line.

use super::layout::Layout;
use crate::report::folder::Folder;
use anyhow::{Context, Result};
use serde::Serialize;
use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{BufWriter, Write};

/// A run of lines of one kind.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Part {
    /// Index of its first line, from 0.
    pub first: u64,
    pub lines: u64,
    /// The kind of its lines.
    pub label: String,
}

/// The label of lines that belong to packets, and of packets of the picture.
pub const PACKETS: &str = "packets";
pub const PICTURE: &str = "picture";

/// A file of lines with the same layout.
pub struct Sheet {
    /// The file's name.
    pub file: String,
    pub layout: Layout,
    /// Number of lines so far.
    pub lines: u64,
    /// Consecutive parts from line 0; empty parts are omitted.
    pub parts: Vec<Part>,
    hash: Sha256,
    shown: String,
    writer: BufWriter<File>,
}

impl Sheet {
    /// Creates an empty file; `label` is the label of its first part.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn new(folder: &Folder, stem: &str, layout: Layout, label: &str) -> Result<Sheet> {
        let file = format!("{stem}.hex");
        let shown = folder.shown(&file);
        let writer = File::create(folder.file(&file))
            .with_context(|| format!("{shown}: cannot be written"))?;
        Ok(Sheet {
            file,
            layout,
            lines: 0,
            parts: vec![Part {
                first: 0,
                lines: 0,
                label: label.to_string(),
            }],
            hash: Sha256::new(),
            shown,
            writer: BufWriter::new(writer),
        })
    }

    /// Starts a part with this label.
    pub fn begin(&mut self, label: &str) {
        let last = self.parts.last_mut().expect("there is always a part");
        if last.label == label {
            return;
        }
        if last.lines == 0 {
            last.label = label.to_string();
            return;
        }
        self.parts.push(Part {
            first: self.lines,
            lines: 0,
            label: label.to_string(),
        });
    }

    /// Appends a line.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn push(&mut self, values: &[u64]) -> Result<()> {
        let line = self.layout.line(values);
        self.push_text(&line)
    }

    /// Appends a line that is already formatted.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn push_text(&mut self, line: &str) -> Result<()> {
        self.lines += 1;
        self.parts.last_mut().expect("there is always a part").lines += 1;
        self.hash.update(line);
        self.hash.update("\n");
        writeln!(self.writer, "{line}")
            .with_context(|| format!("{}: cannot be written", self.shown))
    }

    /// Flushes the file and returns its SHA-256.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn finish(&mut self) -> Result<String> {
        self.writer
            .flush()
            .with_context(|| format!("{}: cannot be written", self.shown))?;
        self.parts.retain(|part| part.lines > 0);
        Ok(hex(&self.hash.clone().finalize()))
    }

    /// Size in bytes of a file with `lines` lines of this layout.
    pub fn bytes(layout: &Layout, lines: u64) -> u64 {
        lines * (layout.digits() as u64 + 1)
    }
}

/// The SHA-256 of bytes, in hexadecimal digits.
pub fn sha256_of_bytes(bytes: &[u8]) -> String {
    hex(&Sha256::digest(bytes))
}

/// The SHA-256 of a text, in hexadecimal digits.
pub fn sha256(text: &str) -> String {
    hex(&Sha256::digest(text))
}

fn hex(digest: &[u8]) -> String {
    digest.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// A unit's stimulus, its expected results, and the mask of compared bits.
pub struct UnitSheets {
    /// The unit's name.
    pub name: &'static str,
    pub stimulus: Sheet,
    pub expected: Sheet,
    /// `None` if all bits are compared in every line.
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
        let sheet =
            |role: &str, layout| Sheet::new(folder, &format!("{name}_{role}"), layout, PACKETS);
        let care = with_care.then(|| sheet("care", expected.clone()));
        Ok(UnitSheets {
            name,
            care: care.transpose()?,
            stimulus: sheet("stimulus", stimulus)?,
            expected: sheet("expected", expected)?,
        })
    }

    /// Starts a part of transactions with this label.
    pub fn begin(&mut self, label: &str) {
        self.sheets().for_each(|sheet| sheet.begin(label));
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
