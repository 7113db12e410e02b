//! Reads numbers from the buffers of a glTF file.
//!
//! The crate's own iterators trust counts, offsets and strides, which may be wrong in a file. Here everything is
//! checked, and every number becomes an `f64`, which represents all number types of glTF exactly.

use super::clean::Facts;
use crate::scene::sources::{place_of_uri, read_regular};
use crate::text;
use anyhow::{Context, Result, bail, ensure};
use base64::Engine;
use base64::alphabet::STANDARD;
use base64::engine::{DecodePaddingMode, GeneralPurpose, GeneralPurposeConfig};
use gltf::accessor::{Accessor, DataType, Dimensions};
use gltf::buffer::{Source, View};
use std::cell::OnceCell;
use std::path::Path;

/// Maximum number of zeros of an accessor without a buffer, unless another accessor has as many elements.
const MOST_ZEROS: usize = 1 << 24;

/// The interpretation of an accessor's integers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Numbers {
    /// Integers are indices; no other types are allowed.
    Indices,
    /// Integers are fractions of the type's maximum.
    Fractions,
    /// Integers are interpreted as the accessor states.
    AsStored,
}

/// The buffers of a file, read on first use, because buffers that only pictures need may be missing.
pub struct Buffers<'a> {
    document: &'a gltf::Document,
    facts: &'a Facts,
    folder: &'a Path,
    binary_chunk: Option<&'a [u8]>,
    read: Vec<OnceCell<Vec<u8>>>,
}

impl<'a> Buffers<'a> {
    /// Files are relative to `folder`.
    pub fn new(
        document: &'a gltf::Document,
        facts: &'a Facts,
        folder: &'a Path,
        binary_chunk: Option<&'a [u8]>,
    ) -> Self {
        let read = document.buffers().map(|_| OnceCell::new()).collect();
        Self {
            document,
            facts,
            folder,
            binary_chunk,
            read,
        }
    }

    fn buffer(&self, number: usize) -> Result<&[u8]> {
        let buffer = self.document.buffers().nth(number).expect("validated");
        let bytes = match buffer.source() {
            // Only the first buffer can be the GLB's chunk.
            Source::Bin if number > 0 => bail!(
                "buffer {number} has no data (EXT_meshopt_compression's fallback?); export it without compression"
            ),
            Source::Bin => self.binary_chunk.with_context(|| {
                format!("buffer {number} is missing: the file has no binary chunk for it; export it again")
            })?,
            Source::Uri(uri) => {
                let cell = &self.read[number];
                if cell.get().is_none() {
                    let bytes = self.fetch(uri).with_context(|| format!("buffer {number}"))?;
                    let _ = cell.set(bytes);
                }
                cell.get().expect("just set")
            }
        };
        let length = buffer.length();
        ensure!(
            bytes.len() >= length,
            "buffer {number} has {} bytes, not {length}; export the file again",
            bytes.len()
        );
        Ok(&bytes[..length])
    }

    fn fetch(&self, uri: &str) -> Result<Vec<u8>> {
        if let Some(data) = uri
            .get(..5)
            .filter(|scheme| scheme.eq_ignore_ascii_case("data:"))
        {
            return data_of(&uri[data.len()..]);
        }
        ensure!(
            !uri.contains("://"),
            "`{}` is not a file in the same folder; put it there",
            text::word(uri)
        );
        ensure!(
            !uri.is_empty(),
            "has an empty URI, which names no file; export the file again"
        );
        let path = place_of_uri(self.folder, uri).with_context(|| {
            format!(
                "`{}` is not a file's name here; rename the file",
                text::word(uri)
            )
        })?;
        read_regular(&path).map_err(|error| match error.kind() {
            std::io::ErrorKind::NotFound => anyhow::anyhow!(
                "is missing: there is no file {}; put it there",
                text::path(&path)
            ),
            _ => anyhow::anyhow!(
                "{}: cannot be read: {error}; give a file that can be",
                text::path(&path)
            ),
        })
    }

    fn view(&self, view: &View) -> Result<&[u8]> {
        let buffer = self.buffer(view.buffer().index())?;
        let range = view
            .offset()
            .checked_add(view.length())
            .and_then(|end| buffer.get(view.offset()..end));
        range.with_context(|| {
            format!(
                "bufferView {} reaches beyond buffer {} of {} bytes; export the file again",
                view.index(),
                view.buffer().index(),
                buffer.len()
            )
        })
    }

    /// The distance of a view's elements; `None` if they are adjacent.
    fn stride(&self, view: &View) -> Result<Option<usize>> {
        match &self.facts.strides[view.index()] {
            None | Some(serde_json::Value::Null) => Ok(None),
            Some(stride) => {
                let number = stride
                    .as_u64()
                    .and_then(|stride| usize::try_from(stride).ok());
                let number = number.with_context(|| {
                    format!(
                        "bufferView {} has the byteStride {}; export the file again",
                        view.index(),
                        text::word(&stride.to_string())
                    )
                })?;
                Ok((number > 0).then_some(number))
            }
        }
    }

    /// The numbers of an accessor, element after element; zeros if it has no buffer view.
    ///
    /// # Errors
    /// One line, which does not name the accessor, if it has other dimensions or types of numbers, if it exceeds
    /// its buffer, or if a number is not finite.
    pub fn read(
        &self,
        accessor: &Accessor,
        dimensions: Dimensions,
        numbers: Numbers,
    ) -> Result<Vec<f64>> {
        let most = MOST_ZEROS / dimensions.multiplicity();
        self.read_up_to(accessor, dimensions, numbers, most)
    }

    /// The same for an accessor that must have one element for each of `count` vertices.
    ///
    /// # Errors
    /// As [`Buffers::read`], and if the number of elements differs.
    pub fn read_for(
        &self,
        accessor: &Accessor,
        dimensions: Dimensions,
        numbers: Numbers,
        count: usize,
    ) -> Result<Vec<f64>> {
        ensure!(
            accessor.count() == count,
            "has {} elements for {count} vertices; export the file again",
            accessor.count()
        );
        self.read_up_to(accessor, dimensions, numbers, count)
    }

    fn read_up_to(
        &self,
        accessor: &Accessor,
        dimensions: Dimensions,
        numbers: Numbers,
        most: usize,
    ) -> Result<Vec<f64>> {
        let inner = || {
            ensure!(
                accessor.dimensions() == dimensions,
                "has elements of type {:?}, where {dimensions:?} belongs; export the file again",
                accessor.dimensions()
            );
            let kind = accessor.data_type();
            let fitting = match numbers {
                Numbers::Indices => matches!(kind, DataType::U8 | DataType::U16 | DataType::U32),
                Numbers::Fractions | Numbers::AsStored => kind != DataType::U32,
            };
            ensure!(
                fitting,
                "has numbers of type {kind:?}, which do not belong there; export the file again"
            );
            ensure!(
                self.view_of(accessor).is_some() || accessor.count() <= most,
                "has {} elements without a buffer; at most {most} may be so",
                accessor.count()
            );
            self.read_fitting(accessor, numbers)
        };
        inner().with_context(|| format!("accessor {}", accessor.index()))
    }

    /// Whether all numbers of an accessor are zero, because it refers to no buffer.
    pub fn is_zero(&self, accessor: &Accessor) -> bool {
        self.view_of(accessor).is_none() && accessor.sparse().is_none()
    }

    /// The view of an accessor, if it has one; the view after the file's own ones stands for none.
    fn view_of<'b>(&self, accessor: &Accessor<'b>) -> Option<View<'b>> {
        let view = accessor.view();
        view.filter(|view| view.index() < self.facts.views)
    }

    fn read_fitting(&self, accessor: &Accessor, numbers: Numbers) -> Result<Vec<f64>> {
        let layout = Layout {
            kind: accessor.data_type(),
            width: accessor.dimensions().multiplicity(),
            normalised: match numbers {
                Numbers::Indices => false,
                Numbers::Fractions => true,
                Numbers::AsStored => accessor.normalized(),
            },
        };
        let count = accessor.count();
        let mut values = match self.view_of(accessor) {
            Some(view) => {
                let stride = self.stride(&view)?;
                layout.read(self.view(&view)?, accessor.offset(), stride, count)?
            }
            None => vec![0.0; count * layout.width],
        };
        if let Some(sparse) = accessor.sparse() {
            let (indices, replacements) = (sparse.indices(), sparse.values());
            let index_layout = Layout {
                kind: match indices.index_type().size() {
                    1 => DataType::U8,
                    2 => DataType::U16,
                    _ => DataType::U32,
                },
                width: 1,
                normalised: false,
            };
            let view = indices.view();
            let places = index_layout.read(
                self.view(&view)?,
                indices.offset(),
                self.stride(&view)?,
                sparse.count(),
            )?;
            let view = replacements.view();
            let replacements = layout.read(
                self.view(&view)?,
                replacements.offset(),
                self.stride(&view)?,
                sparse.count(),
            )?;
            for (place, element) in std::iter::zip(places, replacements.chunks_exact(layout.width))
            {
                let place = place as usize;
                ensure!(
                    place < count,
                    "replaces element {place}, which is out of range (there are {count}, counted from 0); correct its sparse indices"
                );
                values[place * layout.width..][..layout.width].copy_from_slice(element);
            }
        }
        if let Some(place) = values.iter().position(|value| !value.is_finite()) {
            bail!(
                "element {} is not finite: it has {}; correct it",
                place / layout.width,
                values[place]
            );
        }
        Ok(values)
    }
}

/// The data of a data URI; `rest` is the part after the scheme: a media type, a comma, and data that is percent-encoded
/// and, if marked so, base64-encoded.
fn data_of(rest: &str) -> Result<Vec<u8>> {
    let (header, data) = rest
        .split_once(',')
        .context("is a data URI without data; export the file again")?;
    let data: Vec<u8> = percent_encoding::percent_decode_str(data).collect();
    let last = header.rsplit_once(';').map(|(_, last)| last.trim());
    if !last.is_some_and(|last| last.eq_ignore_ascii_case("base64")) {
        return Ok(data);
    }
    let digits: Vec<u8> = data
        .into_iter()
        .filter(|byte| !byte.is_ascii_whitespace())
        .collect();
    let lenient = GeneralPurposeConfig::new()
        .with_decode_allow_trailing_bits(true)
        .with_decode_padding_mode(DecodePaddingMode::Indifferent);
    GeneralPurpose::new(&STANDARD, lenient)
        .decode(digits)
        .map_err(|error| anyhow::anyhow!("is not base64: {error}; export the file again"))
}

/// The numbers of an accessor in groups of `N`.
pub fn groups<const N: usize>(numbers: &[f64]) -> Vec<[f64; N]> {
    let elements = numbers.chunks_exact(N);
    elements
        .map(|element| element.try_into().expect("N numbers"))
        .collect()
}

/// The position of elements in a buffer.
struct Layout {
    kind: DataType,
    width: usize,
    normalised: bool,
}

impl Layout {
    fn read(
        &self,
        bytes: &[u8],
        offset: usize,
        stride: Option<usize>,
        count: usize,
    ) -> Result<Vec<f64>> {
        let size = self.kind.size() * self.width;
        let stride = stride.unwrap_or(size);
        ensure!(
            stride >= size,
            "has elements of {size} bytes every {stride} bytes; export the file again"
        );
        if count == 0 {
            return Ok(Vec::new());
        }
        let end = (count - 1)
            .checked_mul(stride)
            .and_then(|last| last.checked_add(offset)?.checked_add(size));
        ensure!(
            end.is_some_and(|end| end <= bytes.len()),
            "has {count} elements of {size} bytes, which reach beyond its bufferView of {} bytes; export the file again",
            bytes.len()
        );
        let mut values = Vec::with_capacity(count * self.width);
        for element in bytes[offset..].chunks(stride).take(count) {
            let components = element[..size].chunks_exact(self.kind.size());
            values.extend(components.map(|component| self.number(component)));
        }
        Ok(values)
    }

    fn number(&self, bytes: &[u8]) -> f64 {
        let (value, greatest) = match (self.kind, bytes) {
            (DataType::I8, &[a]) => (f64::from(a as i8), f64::from(i8::MAX)),
            (DataType::U8, &[a]) => (f64::from(a), f64::from(u8::MAX)),
            (DataType::I16, &[a, b]) => {
                (f64::from(i16::from_le_bytes([a, b])), f64::from(i16::MAX))
            }
            (DataType::U16, &[a, b]) => {
                (f64::from(u16::from_le_bytes([a, b])), f64::from(u16::MAX))
            }
            (DataType::U32, &[a, b, c, d]) => (
                f64::from(u32::from_le_bytes([a, b, c, d])),
                f64::from(u32::MAX),
            ),
            (DataType::F32, &[a, b, c, d]) => {
                return f64::from(f32::from_le_bytes([a, b, c, d])) + 0.0;
            }
            _ => unreachable!("components are as long as their type"),
        };
        if self.normalised {
            // The minimum of a signed type would be less than −1.
            (value / greatest).max(-1.0)
        } else {
            value
        }
    }
}
