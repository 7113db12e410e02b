//! What is in an OBJ file and not in the picture.

use crate::text;

/// The most words of a kind that are named: all that are statements of geometry, and enough of unknown ones.
const MOST_WORDS: usize = 9;

/// What of an OBJ file, or of the files of a sequence, is not in the picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LeftOut {
    /// Lines, points, curves, surfaces.
    pub not_polygons: Tally,
    /// References to other files, and commands.
    pub other_files: Tally,
    /// Statements that the format does not have.
    pub unknown: Tally,
    /// Faces of one or two corners.
    pub small_faces: Tally,
    /// Vertices with numbers of unknown meaning.
    pub odd_vertices: Tally,
}

/// How often something was met, and where first.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tally {
    count: usize,
    /// The first words, each with how often it was met.
    words: Vec<(String, usize)>,
    /// The place where it was met first.
    first: String,
    /// How many files have it.
    files: usize,
}

impl Tally {
    /// Counts what begins with `word` in a line of the only file so far.
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

    /// Adds what another file has.
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
        // Those whose words the other does not name either.
        self.count += other.unnamed();
    }

    fn unnamed(&self) -> usize {
        self.count - self.words.iter().map(|(_, count)| count).sum::<usize>()
    }

    /// The words, and that there are more.
    fn list(&self, shown: impl Fn(&(String, usize)) -> String) -> String {
        let words: Vec<String> = self.words.iter().map(shown).collect();
        let more = match self.unnamed() {
            0 => "",
            _ => " and others",
        };
        words.join(", ") + more
    }

    /// The words, each with its count.
    fn counts(&self) -> String {
        self.list(|(word, count)| format!("{count} `{}`", text::word(word)))
    }
}

impl LeftOut {
    /// Adds what a file of a sequence leaves out; `file` is how messages show it.
    pub fn merge(&mut self, other: &LeftOut, file: &str) {
        self.not_polygons.merge(&other.not_polygons, file);
        self.other_files.merge(&other.other_files, file);
        self.unknown.merge(&other.unknown, file);
        self.small_faces.merge(&other.small_faces, file);
        self.odd_vertices.merge(&other.odd_vertices, file);
    }

    /// What a mesh without triangles has instead, for a message; nothing, if it has nothing.
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

    /// One line for each kind. `shown` is how messages show the file, or the folder of `frames` files.
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
