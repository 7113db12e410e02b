//! Sequences of OBJ files, one per frame.

use super::super::Mesh;
use super::super::obj::{self, LeftOut};
use super::{Animated, Clip, Kind, Writer};
use crate::scene::sources::{OBJ, is_named};
use crate::text;
use anyhow::{Context, Result, ensure};
use std::cmp::Ordering;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

/// The speed of a sequence of meshes. Vertices are interpolated linearly between two meshes.
pub const SEQUENCE_FRAMES_PER_SECOND: f64 = 24.0;

/// Loads the OBJ files of a folder in the order of their names (see [`by_name`]). Hidden files, whose names start with a
/// dot, are ignored: macOS creates such files on other file systems.
pub fn load(folder: &Path) -> Result<Animated> {
    let shown = text::path(folder);
    let entries = std::fs::read_dir(folder).with_context(|| format!("{shown}: cannot be read"))?;
    let (mut files, mut others): (Vec<PathBuf>, Vec<String>) = Default::default();
    for entry in entries {
        let path = entry
            .with_context(|| format!("{shown}: cannot be read"))?
            .path();
        let name = path.file_name().unwrap_or_default();
        let is_hidden = name.as_encoded_bytes().starts_with(b".");
        if is_named(&path, &OBJ) && !is_hidden {
            match path.is_file() {
                true => files.push(path),
                false => others.push(text::path(&path)),
            }
        }
    }
    files.sort_by(|a, b| by_name(a, b));
    ensure!(
        !files.is_empty(),
        "{shown}: has no OBJ files; give a folder whose files, each name ending in .obj, are the frames"
    );
    let (mut frames, mut first): (Vec<Vec<[f64; 3]>>, Option<Mesh>) = (Vec::new(), None);
    let mut left_out = LeftOut::default();
    for file in &files {
        let (mesh, more) = obj::read(file)?;
        left_out.merge(&more, &text::path(file));
        match &first {
            None => {
                frames.push(mesh.positions.clone());
                first = Some(mesh);
            }
            Some(first) => {
                check_topology(first, &mesh).with_context(|| {
                    format!(
                        "{}: its topology is not that of {}",
                        text::path(file),
                        text::path(&files[0])
                    )
                })?;
                frames.push(mesh.positions);
            }
        }
    }
    let mesh = first.expect("there is a file");
    // A folder given as `.` has no name.
    let name = folder
        .canonicalize()
        .unwrap_or_else(|_| folder.to_path_buf());
    let name = name.file_name().unwrap_or_default().to_string_lossy();
    let name = text::escaped(&name).into_owned();
    let seconds = frames.len() as f64 / SEQUENCE_FRAMES_PER_SECOND;
    let mut warnings = left_out.warnings(&shown, Some(frames.len()));
    others.sort();
    if let [first, more @ ..] = &others[..] {
        let more = match more.len() {
            0 => String::new(),
            count => format!(", nor are {count} more"),
        };
        warnings.push(format!(
            "{first}: is not a file that can be read{more}, and is left out of the frames"
        ));
    }
    let mut animated = Animated::single(name, mesh, Kind::Sequence, Writer::Frames(frames));
    animated.warnings = warnings;
    animated.clips.push(Clip {
        name: "sequence".into(),
        seconds,
    });
    Ok(animated)
}

/// The order of frames: runs of digits compare as numbers, so f2 precedes f10, and case is ignored. Names that
/// are then equal, such as f1, F1 and f01, are ordered by their bytes.
fn by_name(a: &Path, b: &Path) -> Ordering {
    let key = |path: &Path| folded(path.file_stem().unwrap_or_default());
    natural(&key(a), &key(b)).then_with(|| a.cmp(b))
}

/// A name in lower case; it need not be Unicode.
fn folded(name: &OsStr) -> Vec<u8> {
    match name.to_str() {
        Some(name) => name.to_lowercase().into_bytes(),
        None => name.as_encoded_bytes().to_ascii_lowercase(),
    }
}

/// Compares runs of digits as numbers of any length, all other bytes one by one.
fn natural(mut a: &[u8], mut b: &[u8]) -> Ordering {
    loop {
        let ([x, ..], [y, ..]) = (a, b) else {
            return a.len().cmp(&b.len());
        };
        let order = match x.is_ascii_digit() && y.is_ascii_digit() {
            true => {
                let (m, n) = (number(&mut a), number(&mut b));
                m.len().cmp(&n.len()).then_with(|| m.cmp(n))
            }
            false => {
                let order = x.cmp(y);
                (a, b) = (&a[1..], &b[1..]);
                order
            }
        };
        if order.is_ne() {
            return order;
        }
    }
}

/// Removes the leading digits and returns the significant ones.
fn number<'a>(bytes: &mut &'a [u8]) -> &'a [u8] {
    let end = bytes.iter().position(|byte| !byte.is_ascii_digit());
    let (digits, rest) = bytes.split_at(end.unwrap_or(bytes.len()));
    *bytes = rest;
    let zeros = digits.iter().take_while(|digit| **digit == b'0').count();
    &digits[zeros..]
}

fn check_topology(first: &Mesh, other: &Mesh) -> Result<()> {
    let remedy = "export all frames from one mesh";
    ensure!(
        first.positions.len() == other.positions.len(),
        "it has {} vertices, not {}; {remedy}",
        other.positions.len(),
        first.positions.len()
    );
    ensure!(
        first.triangles.len() == other.triangles.len(),
        "it has {} triangles, not {}; {remedy}",
        other.triangles.len(),
        first.triangles.len()
    );
    let differs = std::iter::zip(&first.triangles, &other.triangles).position(|(a, b)| a != b);
    if let Some(number) = differs {
        anyhow::bail!(
            "triangle {number} has the vertices {:?}, not {:?}; {remedy}",
            other.triangles[number],
            first.triangles[number]
        );
    }
    Ok(())
}

/// The vertices at a time: those of a frame, or interpolated between two.
pub fn at(frames: &[Vec<[f64; 3]>], seconds: f64) -> Vec<[f64; 3]> {
    let place = (seconds * SEQUENCE_FRAMES_PER_SECOND).clamp(0.0, (frames.len() - 1) as f64);
    // Division and multiplication may change the last bits of a frame's time.
    let nearest = place.round();
    if (place - nearest).abs() < 1e-9 {
        return frames[nearest as usize].clone();
    }
    let (before, part) = (place.floor() as usize, place.fract());
    std::iter::zip(&frames[before], &frames[before + 1])
        .map(|(a, b)| std::array::from_fn(|axis| a[axis] + (b[axis] - a[axis]) * part))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_in_one_order() {
        let mut random = fastrand::Rng::with_seed(17);
        let mut name = || -> PathBuf {
            let length = random.usize(1..6);
            let letter = |_| char::from(b"0019aBb.- "[random.usize(..10)]);
            let name: String = (0..length).map(letter).collect();
            format!("x{name}.obj").into()
        };
        for _ in 0..20_000 {
            let (a, b, c) = (name(), name(), name());
            let order = by_name(&a, &b);
            assert_eq!(order, by_name(&b, &a).reverse(), "{a:?} {b:?}");
            assert_eq!(order.is_eq(), a == b, "{a:?} {b:?}");
            if order == by_name(&b, &c) {
                assert_eq!(order, by_name(&a, &c), "{a:?} {b:?} {c:?}");
            }
        }
    }
}
