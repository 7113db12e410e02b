//! What people and programs look at: pictures, JSON, progress.
//!
//! Files appear whole or not at all: they are written beside their place, then renamed. Symbolic links are followed;
//! devices and pipes are written to as they are.

pub(crate) mod folder;
mod frames;
mod picture;

pub use frames::FrameFolder;
pub use picture::{heatmap, heatmap_colour, shade, shade_triangles, write_gif, write_png};

use crate::temporary;
use anyhow::{Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

/// Writes a value as indented JSON with a final newline.
///
/// # Errors
/// One line that names the file if it cannot be written.
pub fn json(path: &Path, value: &serde_json::Value) -> Result<()> {
    write_whole(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        Ok(writeln!(file)?)
    })
}

/// Writes a text.
///
/// # Errors
/// One line that names the file if it cannot be written.
pub fn text(path: &Path, text: &str) -> Result<()> {
    write_whole(path, |file| Ok(file.write_all(text.as_bytes())?))
}

/// A progress bar on stderr that counts to `length`; silent where stderr is not a terminal.
pub fn progress(length: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::hidden());
    if std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::stderr());
    }
    let style = ProgressStyle::with_template("{msg} {bar:40} {human_pos}/{human_len} {eta}");
    bar.set_style(style.expect("the template is well formed"));
    bar.with_message(what)
}

/// Checks, before long work, that a file can be written at `path` when it is done; leaves nothing there.
///
/// # Errors
/// One line that names the file and why it cannot be written.
pub fn check_writable(path: &Path) -> Result<()> {
    match Place::of(path) {
        Place::File(file) => create_beside(path, &file).map(drop),
        // To open it could wait for a reader, or end what a reader sees.
        Place::Stream => Ok(()),
    }
}

/// Checks that `path` names a regular file or none yet, as formats need that are not written from first to last byte.
///
/// # Errors
/// One line that names what is there.
pub fn check_regular(path: &Path) -> Result<()> {
    match Place::of(path) {
        Place::File(_) => Ok(()),
        Place::Stream => bail!(
            "{}: cannot be written: it is no regular file; give a file's name",
            path.display()
        ),
    }
}

/// Whether two paths name the same regular file, which one of them would lose.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    let resolved = |path| match Place::of(path) {
        Place::File(file) => {
            let folder = folder_of(&file).canonicalize().ok()?;
            Some(folder.join(file.file_name()?))
        }
        Place::Stream => None,
    };
    resolved(a).is_some_and(|a| resolved(b) == Some(a))
}

/// What a path leads to.
enum Place {
    /// A file, or nothing yet, with symbolic links followed: it is replaced as a whole.
    File(PathBuf),
    /// A device, a pipe or a socket: it takes what is written and stays what it is.
    Stream,
}

impl Place {
    fn of(path: &Path) -> Place {
        if is_stdout(path) {
            return Place::Stream;
        }
        match std::fs::metadata(path) {
            Ok(found) if found.is_dir() => Place::File(path.to_path_buf()),
            Ok(found) => match path.canonicalize() {
                Ok(file) if found.is_file() => Place::File(file),
                _ => Place::Stream,
            },
            // A link to a file that does not exist yet leads to where it will be.
            Err(_) => Place::File(follow(path)),
        }
    }
}

/// Follows symbolic links to a place where nothing is.
fn follow(path: &Path) -> PathBuf {
    /// As many as the kernel follows.
    const LINKS: usize = 40;
    let mut place = path.to_path_buf();
    for _ in 0..LINKS {
        match std::fs::read_link(&place) {
            Ok(target) => place = folder_of(&place).join(target),
            Err(_) => break,
        }
    }
    place
}

/// Whether a path is the standard output. What goes there must share the position in it with the text that follows,
/// wherever the output is redirected to.
fn is_stdout(path: &Path) -> bool {
    ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"]
        .iter()
        .any(|name| path == Path::new(name))
}

/// Lets `write` write a file under a temporary name beside the place that `path` leads to, then gives it its name; or,
/// into a device or a pipe, directly.
fn write_whole(path: &Path, write: impl FnOnce(&mut dyn Write) -> Result<()>) -> Result<()> {
    let shown = path.display();
    let failed = |error: &std::io::Error| {
        anyhow::anyhow!("{shown}: cannot be written: {}; {ADVICE}", reason(error))
    };
    let fill = |stream: &mut dyn Write| {
        let mut buffered = std::io::BufWriter::new(stream);
        write(&mut buffered)
            .and_then(|()| Ok(buffered.flush()?))
            .map_err(|error| match error.downcast_ref::<std::io::Error>() {
                Some(error) => failed(error),
                None => error.context(format!("{shown}: cannot be written")),
            })
    };
    match Place::of(path) {
        Place::File(place) => {
            let mut file = create_beside(path, &place)?;
            fill(&mut file)?;
            file.persist(&place).map_err(|error| failed(&error))?;
            Ok(())
        }
        Place::Stream if is_stdout(path) => fill(&mut std::io::stdout().lock()),
        Place::Stream => {
            let mut stream = std::fs::OpenOptions::new()
                .write(true)
                .open(path)
                .map_err(|error| failed(&error))?;
            fill(&mut stream)
        }
    }
}

const ADVICE: &str = "give a place that exists and can be written";

/// The folder in which a path's last part is.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// A temporary file in the folder of `place`, to which `path` leads.
fn create_beside(path: &Path, place: &Path) -> Result<temporary::File> {
    let shown = path.display();
    if place.is_dir() {
        bail!("{shown}: cannot be written: it is a folder; give a file's name");
    }
    let folder = folder_of(place);
    temporary::File::new(folder).map_err(|error| {
        let reason = match folder.exists() {
            true => reason(&error),
            false => format!("there is no folder {}", folder.display()),
        };
        anyhow::anyhow!("{shown}: cannot be written: {reason}; {ADVICE}")
    })
}

/// Why, without the temporary name that the error may hold.
fn reason(error: &std::io::Error) -> String {
    error.kind().to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_is_written_whole_and_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        for value in [
            serde_json::json!({"b": 1, "a": [2.5]}),
            serde_json::json!(3),
        ] {
            json(&path, &value).unwrap();
            let text = std::fs::read_to_string(&path).unwrap();
            assert!(text.ends_with('\n'));
            let read: serde_json::Value = serde_json::from_str(&text).unwrap();
            assert_eq!(read, value);
        }
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn unwritable_places_are_named_in_one_line() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing").join("a.json");
        let fault = format!("{:#}", json(&path, &serde_json::json!(1)).unwrap_err());
        assert_eq!(fault, format!("{:#}", check_writable(&path).unwrap_err()));
        assert_eq!(
            fault,
            format!(
                "{}: cannot be written: there is no folder {}; give a place that exists and can be written",
                path.display(),
                path.parent().unwrap().display()
            )
        );
        let fault = format!(
            "{:#}",
            json(folder.path(), &serde_json::json!(1)).unwrap_err()
        );
        assert_eq!(
            fault,
            format!(
                "{}: cannot be written: it is a folder; give a file's name",
                folder.path().display()
            )
        );
    }

    #[test]
    fn a_failed_write_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        check_writable(&path).unwrap();
        write_whole(&path, |_| bail!("no more")).unwrap_err();
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
