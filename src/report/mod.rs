//! What people and programs look at: pictures, JSON, progress.
//!
//! Files appear whole or not at all: they are written beside their place, then renamed.

mod picture;

pub use picture::{heatmap, heatmap_colour, shade, write_png};

use anyhow::{Context, Result, bail};
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::{IsTerminal, Write};
use std::path::Path;

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
    create_beside(path).map(drop)
}

/// Lets `write` write a file under a temporary name beside `path`, then gives it its name.
fn write_whole(
    path: &Path,
    write: impl FnOnce(&mut std::io::BufWriter<&mut tempfile::NamedTempFile>) -> Result<()>,
) -> Result<()> {
    let shown = path.display();
    let mut file = create_beside(path)?;
    let mut buffered = std::io::BufWriter::new(&mut file);
    write(&mut buffered)
        .and_then(|()| Ok(buffered.flush()?))
        .with_context(|| format!("{shown}: cannot be written"))?;
    drop(buffered);
    file.persist(path).map_err(|error| {
        anyhow::anyhow!(
            "{shown}: cannot be written: {}; {ADVICE}",
            reason(&error.error)
        )
    })?;
    Ok(())
}

const ADVICE: &str = "give a place that exists and can be written";

/// A temporary file in the folder of `path`.
fn create_beside(path: &Path) -> Result<tempfile::NamedTempFile> {
    let shown = path.display();
    if path.is_dir() {
        bail!("{shown}: cannot be written: it is a folder; give a file's name");
    }
    let folder = match path.parent() {
        Some(parent) if !parent.as_os_str().is_empty() => parent,
        _ => Path::new("."),
    };
    tempfile::Builder::new()
        .permissions_of_new_files()
        .tempfile_in(folder)
        .map_err(|error| {
            anyhow::anyhow!("{shown}: cannot be written: {}; {ADVICE}", reason(&error))
        })
}

/// Why, without the temporary name that the error may hold.
fn reason(error: &std::io::Error) -> String {
    error.kind().to_string()
}

trait PermissionsOfNewFiles {
    /// Temporary files are private; results are as readable as any new file.
    fn permissions_of_new_files(&mut self) -> &mut Self;
}

impl PermissionsOfNewFiles for tempfile::Builder<'_, '_> {
    fn permissions_of_new_files(&mut self) -> &mut Self {
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            // The process' file mode mask takes away what it forbids.
            self.permissions(std::fs::Permissions::from_mode(0o666));
        }
        self
    }
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
                "{}: cannot be written: entity not found; give a place that exists and can be written",
                path.display()
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
