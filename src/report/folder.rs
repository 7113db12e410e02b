//! Folders of results that are filled under a temporary name next to their place and then renamed.

use crate::temporary::{self, Parents};
use crate::{interrupt, text};
use anyhow::{Context, Result, bail};
use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};

/// The kind of content of a folder, which determines what may be replaced.
#[derive(Clone, Copy)]
pub struct Content {
    /// Its name in messages, in the plural.
    pub name: &'static str,
    /// For a folder with files of the given names: the names that belong to an earlier result, or `None` if it contains no
    /// such result.
    pub owned: fn(&Path, &BTreeSet<String>) -> Option<BTreeSet<String>>,
}

/// A folder that is being filled. It is removed when dropped, unless it was [`Folder::publish`]ed.
pub struct Folder {
    content: Content,
    /// The path as the user gave it.
    shown: PathBuf,
    /// The path without links and dots, so that its parent and its name are well defined.
    place: PathBuf,
    temporary: temporary::Folder,
    /// Parent folders that were created for it. Declared after `temporary`, so they are empty when they are dropped.
    parents: Option<Parents>,
}

impl Folder {
    /// Begins a folder for `place`, which must not exist, or be empty, or contain only earlier content of this kind.
    ///
    /// # Errors
    /// One line that describes the obstacle.
    pub fn begin(place: &Path, content: Content) -> Result<Folder> {
        check_free(place, place, content)?;
        let shown = place;
        let advice = "give --out a place that can be written";
        let written = |error: std::io::Error| {
            anyhow::anyhow!(
                "{}: cannot be written: {}; {advice}",
                text::path(place),
                error.kind()
            )
        };
        let parent = match place.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        let parents = match place.exists() {
            true => None,
            false => Some(Parents::make(parent).map_err(written)?),
        };
        // Creating the parent of `v/../v` creates `v`, so check again whether the place exists.
        let place = match (place.exists(), place.file_name()) {
            (true, _) => place.canonicalize().map_err(written)?,
            (false, Some(name)) => parent.canonicalize().map_err(written)?.join(name),
            (false, None) => bail!(
                "{}: is not a folder name; give --out one",
                text::path(shown)
            ),
        };
        let current = std::env::current_dir().and_then(|folder| folder.canonicalize());
        let (false, Some(parent)) = (
            current.is_ok_and(|current| current.starts_with(&place)),
            place.parent(),
        ) else {
            bail!(
                "{}: holds the folder in which this runs, and cannot be replaced; name a folder in it",
                text::path(shown)
            );
        };
        Ok(Folder {
            content,
            shown: shown.to_path_buf(),
            temporary: temporary::Folder::for_result(parent).map_err(written)?,
            parents,
            place,
        })
    }

    /// The current path of a file with this name.
    pub fn file(&self, name: &str) -> PathBuf {
        self.temporary.path().join(name)
    }

    /// The path of a file for messages.
    pub fn shown(&self, name: &str) -> String {
        text::path(&self.shown.join(name))
    }

    /// Writes a whole file.
    ///
    /// # Errors
    /// One line that names the file.
    pub fn write(&self, name: &str, text: &str) -> Result<()> {
        fs::write(self.file(name), text)
            .with_context(|| format!("{}: cannot be written", self.shown(name)))
    }

    /// Moves the folder to its place and replaces an earlier result there.
    ///
    /// # Errors
    /// One line that names the place. The earlier result is still there or, if it cannot be put back, at the place that the line
    /// names.
    pub fn publish(self) -> Result<()> {
        let Folder {
            content,
            shown,
            place,
            // These are dropped in reverse order.
            parents,
            temporary,
        } = self;
        check_free(&place, &shown, content)?;
        let shown = text::path(&shown);
        let failed = |error: std::io::Error| {
            anyhow::anyhow!("{shown}: cannot be put in place: {}", error.kind())
        };
        // The earlier result moves into a folder that is removed later, and back if the new one cannot take its place.
        let _whole = interrupt::hold();
        let parent = temporary.path().parent().unwrap_or(Path::new("."));
        let retired = temporary::for_replaced(parent).map_err(failed)?;
        let earlier = retired.path().join(place.file_name().unwrap_or_default());
        let replaces = place.exists();
        if replaces {
            fs::rename(&place, &earlier).map_err(failed)?;
        }
        if let Err(error) = fs::rename(temporary.path(), &place) {
            if replaces && fs::rename(&earlier, &place).is_err() {
                let _ = retired.keep();
                bail!(
                    "{shown}: cannot be put in place: {}; the earlier {} are in {}: move them back",
                    error.kind(),
                    content.name,
                    text::path(&earlier)
                );
            }
            return Err(failed(error));
        }
        // Its content has moved, so there is nothing to remove.
        temporary.keep();
        if let Some(parents) = parents {
            parents.keep();
        }
        Ok(())
    }
}

/// Checks that `place` is free, or contains only files of an earlier result.
fn check_free(place: &Path, shown: &Path, content: Content) -> Result<()> {
    let shown = text::path(shown);
    if !place.exists() {
        return Ok(());
    }
    if !place.is_dir() {
        bail!("{shown}: is a file; give --out a folder's name");
    }
    let entries = fs::read_dir(place).with_context(|| format!("{shown}: cannot be read"))?;
    let mut names = BTreeSet::new();
    for entry in entries {
        let entry = entry.with_context(|| format!("{shown}: cannot be read"))?;
        names.insert(entry.file_name().to_string_lossy().into_owned());
    }
    if names.is_empty() {
        return Ok(());
    }
    let what = content.name;
    let Some(owned) = (content.owned)(place, &names) else {
        bail!(
            "{shown}: exists and holds no {what} that could be replaced; name a new folder, or remove it"
        );
    };
    if let Some(foreign) = names.iter().find(|name| !owned.contains(*name)) {
        bail!(
            "{shown}: holds {} besides earlier {what}; move it elsewhere, or name a new folder",
            text::escaped(foreign)
        );
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Content with the file `list`, which names the other file, `a.hex`.
    const VECTORS: Content = Content {
        name: "vectors",
        owned: |folder, _| {
            let list = fs::read_to_string(folder.join("list")).ok()?;
            let names = list.split_whitespace().chain(["list"]);
            Some(names.map(str::to_string).collect())
        },
    };

    fn fill(place: &Path, text: &str) -> Result<()> {
        let folder = Folder::begin(place, VECTORS)?;
        folder.write("a.hex", text)?;
        folder.write("list", "a.hex")?;
        folder.publish()
    }

    fn refusal(place: &Path) -> String {
        let error = format!(
            "{:#}",
            Folder::begin(place, VECTORS).err().expect("refused")
        );
        assert!(!error.contains('\n'), "{error}");
        error.replace(&place.display().to_string(), "PLACE")
    }

    #[test]
    fn vectors_replace_vectors_and_nothing_else() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("new/vectors");
        fill(&place, "1").unwrap();
        fill(&place, "2").unwrap();
        assert_eq!(fs::read_to_string(place.join("a.hex")).unwrap(), "2");
        fs::write(place.join("notes.txt"), "mine").unwrap();
        assert_eq!(
            refusal(&place),
            "PLACE: holds notes.txt besides earlier vectors; move it elsewhere, or name a new folder"
        );
        let left: Vec<_> = fs::read_dir(place.parent().unwrap()).unwrap().collect();
        assert_eq!(left.len(), 1, "no temporary folder is left: {left:?}");

        let other = parent.path().join("other");
        fs::create_dir(&other).unwrap();
        fill(&other, "1").unwrap();
        fs::remove_file(other.join("list")).unwrap();
        assert_eq!(
            refusal(&other),
            "PLACE: exists and holds no vectors that could be replaced; name a new folder, or remove it"
        );
        assert_eq!(
            refusal(&other.join("a.hex")),
            "PLACE: is a file; give --out a folder's name"
        );
    }

    #[test]
    fn a_place_may_be_named_in_a_roundabout_way() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("v");
        #[cfg(unix)]
        std::os::unix::fs::symlink("v", parent.path().join("link")).unwrap();
        #[cfg(not(unix))]
        fs::create_dir(parent.path().join("link")).unwrap();
        for name in ["v/../v", "v/.", "v/../v", "link/../v/", "v/../link/../v"] {
            fill(&parent.path().join(name), name).unwrap();
            let text = fs::read_to_string(place.join("a.hex")).unwrap();
            assert_eq!(text, name);
        }
        #[cfg(unix)]
        {
            fill(&parent.path().join("link"), "linked").unwrap();
            let text = fs::read_to_string(place.join("a.hex")).unwrap();
            assert_eq!(text, "linked");
        }
        let mut left: Vec<_> = (fs::read_dir(parent.path()).unwrap())
            .map(|entry| entry.unwrap().file_name())
            .collect();
        left.sort();
        assert_eq!(left, ["link", "v"]);
    }

    #[test]
    fn what_is_not_published_vanishes() {
        let parent = tempfile::tempdir().unwrap();
        let folder = Folder::begin(&parent.path().join("v"), VECTORS).unwrap();
        folder.write("a.hex", "1").unwrap();
        drop(folder);
        assert_eq!(fs::read_dir(parent.path()).unwrap().count(), 0);
    }
}
