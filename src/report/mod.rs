//! Output for people and programs: pictures, JSON, progress.
//!
//! Files are written next to their place and then renamed, so they are never incomplete. Symbolic links are followed;
//! devices and pipes are written directly.

mod events;
pub mod folder;
mod frames;
mod picture;

pub use events::chrome_trace;
pub use frames::FrameFolder;
pub use picture::{heatmap, heatmap_colour, shade, shade_triangles, write_gif, write_png};

use crate::{interrupt, temporary, text};
use anyhow::{Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};

/// Writes a value as indented JSON with a final newline.
///
/// # Errors
/// One line that names the file if it cannot be written.
pub fn json(path: &Path, value: &serde_json::Value) -> Result<()> {
    Staged::json(path, value)?.publish()
}

/// Writes a text.
///
/// # Errors
/// One line that names the file if it cannot be written.
pub fn text(path: &Path, text: &str) -> Result<()> {
    Staged::text(path, text)?.publish()
}

/// A progress bar on stderr that counts to `length`; hidden if stderr is not a terminal.
pub fn progress(length: u64, what: &'static str) -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(length), ProgressDrawTarget::hidden());
    if std::io::stderr().is_terminal() {
        bar.set_draw_target(ProgressDrawTarget::stderr());
    }
    let style = ProgressStyle::with_template("{msg} {bar:40} {human_pos}/{human_len} {eta}");
    bar.set_style(style.expect("the template is well formed"));
    bar.with_message(what)
}

/// Checks before a long computation that a file can be written at `path`; leaves no file there.
///
/// # Errors
/// One line that names the file and why it cannot be written.
pub fn check_writable(path: &Path) -> Result<()> {
    match Place::of(path) {
        Place::File(file) => create_beside(path, &file).map(drop),
        // Opening it could wait for a reader, or end the stream of a reader.
        Place::Stream => Ok(()),
    }
}

/// Checks that `path` is a regular file or does not exist, as required for formats that are not written sequentially.
///
/// # Errors
/// One line that names the object at the path.
pub fn check_regular(path: &Path) -> Result<()> {
    match Place::of(path) {
        Place::File(_) => Ok(()),
        Place::Stream => bail!(
            "{}: cannot be written: it is not a regular file; give a file's name",
            text::path(path)
        ),
    }
}

/// The identity of the file or folder at a path, with links followed: the same for all its names, including hard links.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity(
    #[cfg(unix)] (u64, u64),
    #[cfg(not(unix))] std::path::PathBuf,
);

impl Identity {
    /// The identity of the object at `path`; `None` if there is none.
    pub fn of(path: &Path) -> Option<Identity> {
        #[cfg(unix)]
        {
            use std::os::unix::fs::MetadataExt;
            let found = std::fs::metadata(path).ok()?;
            Some(Identity((found.dev(), found.ino())))
        }
        #[cfg(not(unix))]
        {
            path.canonicalize().ok().map(Identity)
        }
    }
}

/// Whether `path` is a device, a pipe or the standard output, so that writing replaces nothing.
pub fn is_stream(path: &Path) -> bool {
    matches!(Place::of(path), Place::Stream)
}

/// Whether two paths name the same regular file, so that one output would overwrite the other.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    if is_stream(a) || is_stream(b) {
        return false;
    }
    if Identity::of(a).is_some_and(|a| Identity::of(b) == Some(a)) {
        return true;
    }
    let resolved = |path| match Place::of(path) {
        Place::File(file) => {
            let folder = folder_of(&file).canonicalize().ok()?;
            Some(folder.join(file.file_name()?))
        }
        Place::Stream => None,
    };
    resolved(a).is_some_and(|a| resolved(b) == Some(a))
}

/// The destination of a path.
enum Place {
    /// A file, which need not exist yet, with symbolic links followed. It is replaced as a whole.
    File(PathBuf),
    /// A device, a pipe or a socket. It is written directly.
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
            // A link to a missing file names the place where the file will be created.
            Err(_) => Place::File(follow(path)),
        }
    }
}

/// Follows symbolic links to a place where nothing exists.
fn follow(path: &Path) -> PathBuf {
    /// Maximum number of links, as in the kernel.
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

/// Whether a path is the standard output. Data written there must share its position with the text that follows,
/// even if the output is redirected.
pub fn is_stdout(path: &Path) -> bool {
    ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"]
        .iter()
        .any(|name| path == Path::new(name))
}

/// A file that is written but not yet in its place. It is removed when dropped, unless it was published.
pub struct Staged {
    /// The path as the user gave it.
    shown: String,
    content: Content,
}

enum Content {
    /// A temporary file next to the place.
    File(temporary::File, PathBuf),
    /// The data for a device, a pipe or the standard output.
    Stream(Vec<u8>, PathBuf),
}

impl Staged {
    /// Stages a value as indented JSON with a final newline.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written.
    pub fn json(path: &Path, value: &serde_json::Value) -> Result<Staged> {
        Staged::write(path, |file| {
            serde_json::to_writer_pretty(&mut *file, value)?;
            Ok(writeln!(file)?)
        })
    }

    /// Stages a text.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written.
    pub fn text(path: &Path, text: &str) -> Result<Staged> {
        Staged::write(path, |file| Ok(file.write_all(text.as_bytes())?))
    }

    /// Creates an empty file to be written by others at the path [`Staged::temporary`].
    ///
    /// # Errors
    /// One line that names the file if it cannot be written or is not a regular file.
    pub fn empty(path: &Path) -> Result<Staged> {
        check_regular(path)?;
        Staged::write(path, |_| Ok(()))
    }

    /// The current path of the file; for a device or a pipe, the final path.
    pub fn temporary(&self) -> &Path {
        match &self.content {
            Content::File(file, _) => file.path(),
            Content::Stream(_, path) => path,
        }
    }

    /// Calls `write` with a temporary file next to the destination of `path` or, for a device or a pipe,
    /// with a buffer in memory.
    pub(crate) fn write(
        path: &Path,
        write: impl FnOnce(&mut dyn Write) -> Result<()>,
    ) -> Result<Staged> {
        let shown = text::path(path);
        let fill = |stream: &mut dyn Write| {
            let mut buffered = std::io::BufWriter::new(stream);
            write(&mut buffered)
                .and_then(|()| Ok(buffered.flush()?))
                .map_err(|error| match error.downcast_ref::<std::io::Error>() {
                    Some(error) => failed(&shown, error),
                    None => error.context(format!("{shown}: cannot be written")),
                })
        };
        let content = match Place::of(path) {
            Place::File(place) => {
                let mut file = create_beside(path, &place)?;
                fill(&mut file)?;
                Content::File(file, place)
            }
            Place::Stream => {
                let mut bytes = vec![];
                fill(&mut bytes)?;
                Content::Stream(bytes, path.to_path_buf())
            }
        };
        Ok(Staged { shown, content })
    }

    /// Moves the file to its place.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn publish(self) -> Result<()> {
        publish_all([self])
    }

    /// Writes the data for a device, a pipe or the standard output.
    fn send(&self) -> Result<()> {
        let Content::Stream(bytes, path) = &self.content else {
            return Ok(());
        };
        let send = || {
            if is_stdout(path) {
                let mut stdout = std::io::stdout().lock();
                return match stdout.write_all(bytes).and_then(|()| stdout.flush()) {
                    // It is no error if the reader closes the pipe early.
                    Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => Ok(()),
                    sent => sent,
                };
            }
            let mut stream = std::fs::OpenOptions::new().write(true).open(path)?;
            stream.write_all(bytes)?;
            stream.flush()
        };
        send().map_err(|error| failed(&self.shown, &error))
    }
}

/// Moves all files to their places, or none if an obstacle is known in advance.
///
/// # Errors
/// One line that names the first file that cannot be moved.
pub fn publish_all(files: impl IntoIterator<Item = Staged>) -> Result<()> {
    publish_beside(files, || Ok(()))
}

/// As [`publish_all`], for files together with a folder. `publish_folder` moves the folder after the steps that can fail.
///
/// # Errors
/// See [`publish_all`], and the errors of `publish_folder`.
pub fn publish_beside(
    files: impl IntoIterator<Item = Staged>,
    publish_folder: impl FnOnce() -> Result<()>,
) -> Result<()> {
    let files: Vec<Staged> = files.into_iter().collect();
    // Writing can fail halfway; renaming rarely does.
    files.iter().try_for_each(Staged::send)?;
    publish_folder()?;
    let _whole = interrupt::hold();
    for Staged { shown, content } in files {
        if let Content::File(file, place) = content {
            file.persist(&place)
                .map_err(|error| failed(&shown, &error))?;
        }
    }
    Ok(())
}

fn failed(shown: &str, error: &std::io::Error) -> anyhow::Error {
    anyhow::anyhow!("{shown}: cannot be written: {}; {ADVICE}", reason(error))
}

const ADVICE: &str = "give a place that exists and can be written";

/// The folder that contains the last component of a path.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// Creates a temporary file in the folder of `place`, the destination of `path`.
fn create_beside(path: &Path, place: &Path) -> Result<temporary::File> {
    let shown = text::path(path);
    if place.is_dir() {
        bail!("{shown}: cannot be written: it is a folder; give a file's name");
    }
    let folder = folder_of(place);
    temporary::File::new(folder).map_err(|error| {
        let reason = match folder.exists() {
            true => reason(&error),
            false => format!("there is no folder {}", text::path(folder)),
        };
        anyhow::anyhow!("{shown}: cannot be written: {reason}; {ADVICE}")
    })
}

/// The reason of an error, without the temporary name that its message may contain.
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
    fn files_appear_together_or_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let value = serde_json::json!(1);
        let names = || {
            let entries = std::fs::read_dir(folder.path()).unwrap();
            let names = entries.map(|entry| entry.unwrap().file_name().into_string().unwrap());
            names
                .filter(|name| !name.starts_with('.'))
                .collect::<Vec<_>>()
        };
        let both = [
            Staged::json(&at("a.json"), &value).unwrap(),
            Staged::text(&at("b.txt"), "text").unwrap(),
        ];
        assert_eq!(names(), [""; 0]);
        publish_all(both).unwrap();
        assert_eq!(names().len(), 2);
        #[cfg(target_os = "linux")]
        {
            let both = [
                Staged::json(&at("c.json"), &value).unwrap(),
                Staged::text(Path::new("/dev/full"), "text").unwrap(),
            ];
            let error = publish_all(both).unwrap_err().to_string();
            assert!(
                error.starts_with("/dev/full: cannot be written: "),
                "{error}"
            );
            assert_eq!(names().len(), 2);
        }
    }

    #[test]
    fn a_failed_write_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        check_writable(&path).unwrap();
        let Err(error) = Staged::write(&path, |_| bail!("no more")) else {
            panic!("it fails");
        };
        assert!(format!("{error:#}").ends_with("a.json: cannot be written: no more"));
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
