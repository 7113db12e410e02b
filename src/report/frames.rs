//! A folder with the pictures of an animation.

use super::folder::{Content, Folder};
use super::write_png;
use anyhow::Result;
use image::RgbImage;
use std::path::Path;

const PREFIX: &str = "frame_";
const SUFFIX: &str = ".png";

/// A folder contains frames if it has a first frame; it owns all files with names of frames.
const CONTENT: Content = Content {
    name: "frames",
    owned: |_, names| {
        let is_frame = |name: &&String| {
            let number = name
                .strip_prefix(PREFIX)
                .and_then(|rest| rest.strip_suffix(SUFFIX));
            number.is_some_and(|n| n.len() >= 4 && n.bytes().all(|b| b.is_ascii_digit()))
        };
        let frames: std::collections::BTreeSet<_> =
            names.iter().filter(is_frame).cloned().collect();
        (!frames.is_empty()).then_some(frames)
    },
};

/// A folder of pictures `frame_0000.png`, `frame_0001.png`, … that appears only when it is complete.
pub struct FrameFolder(Folder);

impl FrameFolder {
    /// Begins a folder for `place`, which must not exist, or be empty, or contain only earlier frames.
    ///
    /// # Errors
    /// One line that describes the obstacle.
    pub fn begin(place: &Path) -> Result<FrameFolder> {
        Ok(FrameFolder(Folder::begin(place, CONTENT)?))
    }

    /// Adds frame number `number`.
    ///
    /// # Errors
    /// One line if it cannot be written.
    pub fn add(&self, number: usize, picture: &RgbImage) -> Result<()> {
        let name = format!("{PREFIX}{number:04}{SUFFIX}");
        write_png(&self.0.file(&name), picture)
    }

    /// Moves the folder to its place and replaces earlier frames there.
    ///
    /// # Errors
    /// One line that names the place.
    pub fn publish(self) -> Result<()> {
        self.0.publish()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn frames_replace_frames_and_nothing_else() {
        let parent = tempfile::tempdir().unwrap();
        let place = parent.path().join("film");
        let picture = RgbImage::new(2, 2);
        let write = |count: usize| {
            let folder = FrameFolder::begin(&place)?;
            (0..count).try_for_each(|number| folder.add(number, &picture))?;
            folder.publish()
        };
        write(3).unwrap();
        write(2).unwrap();
        let mut names: Vec<_> = fs::read_dir(&place)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, ["frame_0000.png", "frame_0001.png"]);
        fs::write(place.join("frame_x.png"), "mine").unwrap();
        let error = format!("{:#}", write(1).unwrap_err());
        assert_eq!(
            error,
            format!(
                "{}: holds frame_x.png besides earlier frames; move it elsewhere, or name a new folder",
                place.display()
            )
        );
    }
}
