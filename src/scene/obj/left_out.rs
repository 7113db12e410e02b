//! The parts of an OBJ file that are not in the picture.

use crate::text;

/// Maximum number of words named per kind: all statements of geometry, and sufficiently many unknown ones.
const MOST_WORDS: usize = 9;

/// The parts of an OBJ file, or of the files of a sequence, that are not in the picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LeftOut {
    /// Lines, points, curves, surfaces.
    pub not_polygons: Tally,
    /// References to other files, and commands.
    pub other_files: Tally,
    /// Statements that are not in the format.
    pub unknown: Tally,
    /// Faces of one or two corners.
    pub small_faces: Tally,
    /// Vertices with additional numbers of unknown meaning.
    pub odd_vertices: Tally,
}

/// The number of occurrences of something, and the first place.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tally {
    count: usize,
    /// The first words, each with its number of occurrences.
    words: Vec<(String, usize)>,
    /// The place of the first occurrence.
    first: String,
    /// Number of files with an occurrence.
    files: usize,
}

impl Tally {
    /// Counts a statement that starts with `word` in a line of the first file.
    pub fn add(&mut self, word: &str, line: usize) {
        if self.count == 0 {
            self.first = format!("line {line}");
            self.files = 1;
        }
        self.add_words(word, 1);
    }

    fn add_words(&mut self, word: &str, count: usize) {
        self.count += count;
        if let Some((_, met)) = self.words.iter_mut().find(|(known, _)| known == word) {
            *met += count;
        } else if self.words.len() < MOST_WORDS {
            self.words.push((word.to_string(), count));
        }
    }

    /// Adds the counts of another file.
    fn merge(&mut self, other: &Tally, file: &str) {
        if other.count == 0 {
            return;
        }
        if self.count == 0 {
            self.first = format!("{file}, {}", other.first);
        }
        self.files += other.files;
        for (word, count) in &other.words {
            self.add_words(word, *count);
        }
        // The words beyond the limit, which the other does not name either.
        self.count += other.unnamed();
    }

    fn unnamed(&self) -> usize {
        self.count - self.words.iter().map(|(_, count)| count).sum::<usize>()
    }

    /// The list of words, with a note if there are more.
    fn list(&self, shown: impl Fn(&(String, usize)) -> String) -> String {
        let words: Vec<String> = self.words.iter().map(shown).collect();
        let more = match self.unnamed() {
            0 => "",
            _ => " and others",
        };
        words.join(", ") + more
    }

    /// The words with their counts.
    fn counts(&self) -> String {
        self.list(|(word, count)| format!("{count} `{}`", text::word(word)))
    }
}

impl LeftOut {
    /// Adds the counts of a file of a sequence; `file` is its name in messages.
    pub fn merge(&mut self, other: &LeftOut, file: &str) {
        self.not_polygons.merge(&other.not_polygons, file);
        self.other_files.merge(&other.other_files, file);
        self.unknown.merge(&other.unknown, file);
        self.small_faces.merge(&other.small_faces, file);
        self.odd_vertices.merge(&other.odd_vertices, file);
    }

    /// For a message: the contents of a mesh without triangles; empty if there are none.
    pub fn instead_of_triangles(&self) -> String {
        let faces = match self.small_faces.count {
            0 => None,
            1 => Some("1 face of fewer than three corners".into()),
            count => Some(format!("{count} faces of fewer than three corners")),
        };
        let instead = (self.not_polygons.count > 0).then(|| self.not_polygons.counts());
        let has: Vec<String> = instead.into_iter().chain(faces).collect();
        match has.is_empty() {
            true => String::new(),
            false => format!(", only {}", has.join(", ")),
        }
    }

    /// One line per kind. `shown` is the name of the file, or of the folder of `frames` files, in messages.
    pub fn warnings(&self, shown: &str, frames: Option<usize>) -> Vec<String> {
        let line = |tally: &Tally, what: String, then: &str| {
            let within = match frames {
                None => String::new(),
                Some(frames) => format!(" in {} of {frames} frames", tally.files),
            };
            format!("{shown}: {what}{within}, first in {}{then}", tally.first)
        };
        let plural = |tally: &Tally, one: &str, many: &str| match tally.count {
            1 => format!("1 {one}"),
            count => format!("{count} {many}"),
        };
        let mut warnings = Vec::new();
        let mut warn = |tally: &Tally, what: String, then: &str| {
            if tally.count > 0 {
                warnings.push(line(tally, what, then));
            }
        };
        let unknown = match self.unknown.words.len() {
            1 => "the unknown statement",
            _ => "unknown statements",
        };
        warn(
            &self.unknown,
            format!(
                "{} of {unknown} {} left out",
                plural(&self.unknown, "line", "lines"),
                self.unknown
                    .list(|(word, _)| format!("`{}`", text::word(word)))
            ),
            "",
        );
        warn(
            &self.not_polygons,
            format!("{} left out", self.not_polygons.counts()),
            "; only faces are drawn: export lines, points, curves and surfaces as polygons",
        );
        warn(
            &self.other_files,
            format!("{} left out", self.other_files.counts()),
            "; other files are not read: put what they hold into this one",
        );
        warn(
            &self.small_faces,
            format!(
                "{} of fewer than three corners left out",
                plural(&self.small_faces, "face", "faces")
            ),
            "",
        );
        warn(
            &self.odd_vertices,
            format!(
                "{} something after x y z that is neither a weight nor a colour",
                plural(&self.odd_vertices, "vertex has", "vertices have")
            ),
            "; it is left out",
        );
        warnings
    }
}
