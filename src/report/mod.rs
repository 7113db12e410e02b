//! What people and programs look at: pictures, JSON, progress.
//!
//! Files appear whole or not at all: they are written beside their place, then renamed. Symbolic links are followed;
//! devices and pipes are written to as they are.

pub mod folder;
mod frames;
mod picture;

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
            "{}: cannot be written: it is not a regular file; give a file's name",
            text::path(path)
        ),
    }
}

/// Which file or folder there is at a path, links followed: the same for all its names, hard links among them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity(
    #[cfg(unix)] (u64, u64),
    #[cfg(not(unix))] std::path::PathBuf,
);

impl Identity {
    /// That of what is at `path`; nothing if there is nothing.
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

/// Whether what is written at `path` goes to a device, a pipe or the standard output, and replaces nothing.
pub fn is_stream(path: &Path) -> bool {
    matches!(Place::of(path), Place::Stream)
}

/// Whether two paths name the same regular file, which one of them would lose.
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
pub fn is_stdout(path: &Path) -> bool {
    ["/dev/stdout", "/dev/fd/1", "/proc/self/fd/1"]
        .iter()
        .any(|name| path == Path::new(name))
}

/// A file that is written and not in its place yet. What is not published vanishes.
pub struct Staged {
    /// As the user named it.
    shown: String,
    content: Content,
}

enum Content {
    /// In a temporary file beside the place.
    File(temporary::File, PathBuf),
    /// For a device, a pipe or the standard output.
    Stream(Vec<u8>, PathBuf),
}

impl Staged {
    /// A value as indented JSON with a final newline.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written.
    pub fn json(path: &Path, value: &serde_json::Value) -> Result<Staged> {
        Staged::write(path, |file| {
            serde_json::to_writer_pretty(&mut *file, value)?;
            Ok(writeln!(file)?)
        })
    }

    /// A text.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written.
    pub fn text(path: &Path, text: &str) -> Result<Staged> {
        Staged::write(path, |file| Ok(file.write_all(text.as_bytes())?))
    }

    /// An empty file, to be written by others where [`Staged::temporary`] says.
    ///
    /// # Errors
    /// One line that names the file if it cannot be written, or is no regular file.
    pub fn empty(path: &Path) -> Result<Staged> {
        check_regular(path)?;
        Staged::write(path, |_| Ok(()))
    }

    /// Where the file is for now; for a device or a pipe, where it will go.
    pub fn temporary(&self) -> &Path {
        match &self.content {
            Content::File(file, _) => file.path(),
            Content::Stream(_, path) => path,
        }
    }

    /// Lets `write` write a file under a temporary name beside the place that `path` leads to; or, for a device or a pipe,
    /// into memory.
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

    /// Puts the file in its place.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn publish(self) -> Result<()> {
        publish_all([self])
    }

    /// Writes what goes to a device, a pipe or the standard output.
    fn send(&self) -> Result<()> {
        let Content::Stream(bytes, path) = &self.content else {
            return Ok(());
        };
        let send = || {
            if is_stdout(path) {
                let mut stdout = std::io::stdout().lock();
                return match stdout.write_all(bytes).and_then(|()| stdout.flush()) {
                    // A reader that has seen enough is no error.
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

/// Puts files in their places, all of them or, where that can be known before, none.
///
/// # Errors
/// One line that names the first that cannot be put in place.
pub fn publish_all(files: impl IntoIterator<Item = Staged>) -> Result<()> {
    publish_beside(files, || Ok(()))
}

/// The same of files beside a folder, which `publish_folder` puts in its place once what can fail on the way has not.
///
/// # Errors
/// See [`publish_all`]; those of `publish_folder`.
pub fn publish_beside(
    files: impl IntoIterator<Item = Staged>,
    publish_folder: impl FnOnce() -> Result<()>,
) -> Result<()> {
    let files: Vec<Staged> = files.into_iter().collect();
    // To write can fail on the way, to rename hardly.
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

/// The folder in which a path's last part is.
fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    }
}

/// A temporary file in the folder of `place`, to which `path` leads.
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
