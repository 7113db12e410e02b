//! Divides the bytes of an OBJ file into statements.
//!
//! This module handles everything that depends on the notation and not on the meaning: encodings, line ends,
//! comments, and continued lines.

use std::borrow::Cow;

/// The interpretation of a statement's argument.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// A vertex's position.
    Vertex,
    /// A polygon.
    Face,
    /// Geometry that is not polygons: lines, points, free-form curves and surfaces.
    NotPolygon,
    /// A reference to another file or program; the argument is a name.
    OtherFile,
    /// A group, an object, a material or a library of materials; the argument is a name.
    Name,
    /// A statement without positions, or one that belongs to a free-form curve or surface.
    Attribute,
    /// A statement of parameters, whose argument may contain the words `u` and `v`.
    Parameters,
    /// A statement that is not in the format.
    Unknown,
}

impl Kind {
    fn of(word: &str) -> Self {
        match word {
            "v" => Kind::Vertex,
            // `fo` is the former name of `f`.
            "f" | "fo" => Kind::Face,
            "vt" | "vn" | "vp" | "s" | "mg" | "bevel" | "c_interp" | "d_interp" | "lod"
            | "ctech" | "stech" | "cstype" | "deg" | "step" | "trim" | "hole" | "scrv" | "sp"
            | "end" | "con" | "res" | "vc" => Kind::Attribute,
            "o" | "g" | "usemtl" | "mtllib" | "newmtl" | "usemap" | "maplib" => Kind::Name,
            "p" | "l" | "curv" | "curv2" | "surf" | "bsp" | "bzp" | "cdc" | "cdp" => {
                Kind::NotPolygon
            }
            "call" | "csh" | "shadow_obj" | "trace_obj" => Kind::OtherFile,
            "parm" | "bmat" => Kind::Parameters,
            _ => Kind::Unknown,
        }
    }

    /// Whether the argument is a name, which may contain `#` and may end in a backslash, such as a folder of Windows.
    fn takes_name(self) -> bool {
        matches!(self, Kind::Name | Kind::OtherFile)
    }

    /// Whether a backslash at the end of the line continues the statement. The argument of an unknown statement may be
    /// a name.
    fn goes_on(self) -> bool {
        !self.takes_name() && self != Kind::Unknown
    }
}

/// A statement, without surrounding white space.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Statement<'a> {
    /// The line on which it starts, counted from 1.
    pub line: usize,
    /// Its first word.
    pub word: &'a str,
    pub kind: Kind,
    /// The rest of the statement, in one line and without its comment. A name is kept whole: a `#` in it starts a comment only if
    /// there is no such name, and then [`without_comment`] removes it.
    pub argument: Cow<'a, str>,
}

/// The text of a file: UTF-8, or UTF-16 with a byte order mark or recognisable by its NULs. Characters in other
/// encodings, as in comments and names, become replacement characters; numbers are ASCII. `None` if the file is not text.
pub fn decode(bytes: &[u8]) -> Option<Cow<'_, str>> {
    let text = match bytes {
        [0xef, 0xbb, 0xbf, text @ ..] => String::from_utf8_lossy(text),
        [0xff, 0xfe, text @ ..] => utf16(text, u16::from_le_bytes),
        [0xfe, 0xff, text @ ..] => utf16(text, u16::from_be_bytes),
        text if text.contains(&0) => utf16(text, byte_order(text)?),
        text => String::from_utf8_lossy(text),
    };
    (!text.contains('\0')).then_some(text)
}

type Unit = fn([u8; 2]) -> u16;

fn utf16(bytes: &[u8], unit: Unit) -> Cow<'static, str> {
    let pairs = bytes.chunks_exact(2);
    // An incomplete unit at the end belongs to the last character.
    let cut = (!pairs.remainder().is_empty()).then_some(char::REPLACEMENT_CHARACTER);
    let units = pairs.map(|pair| unit([pair[0], pair[1]]));
    let text = char::decode_utf16(units).map(|c| c.unwrap_or(char::REPLACEMENT_CHARACTER));
    Cow::Owned(text.chain(cut).collect())
}

/// The byte order of UTF-16 without a mark. Most characters are ASCII, so most bytes in one half of the units are NUL,
/// and none in the other half.
fn byte_order(bytes: &[u8]) -> Option<Unit> {
    let mut zeros = [0; 2];
    for pair in bytes.chunks(2) {
        for (count, byte) in zeros.iter_mut().zip(pair) {
            *count += usize::from(*byte == 0);
        }
    }
    let is_most = |count: usize| bytes.len().is_multiple_of(2) && count > bytes.len() / 4;
    match zeros {
        [0, low] if is_most(low) => Some(u16::from_le_bytes),
        [high, 0] if is_most(high) => Some(u16::from_be_bytes),
        _ => None,
    }
}

/// The lines of a text, which end in LF, CR LF or (on old Macs) CR.
struct Lines<'a> {
    rest: Option<&'a str>,
}

impl<'a> Iterator for Lines<'a> {
    type Item = &'a str;

    fn next(&mut self) -> Option<&'a str> {
        let rest = self.rest?;
        let bytes = rest.as_bytes();
        let Some(end) = bytes.iter().position(|byte| matches!(byte, b'\n' | b'\r')) else {
            self.rest = None;
            return Some(rest);
        };
        let next = match &bytes[end..] {
            [b'\r', b'\n', ..] => end + 2,
            _ => end + 1,
        };
        self.rest = Some(&rest[next..]);
        Some(&rest[..end])
    }
}

/// The part of a line before a `#`.
pub fn without_comment(line: &str) -> &str {
    let end = line.bytes().position(|byte| byte == b'#');
    &line[..end.unwrap_or(line.len())]
}

/// The first word of a line that does not start with white space; empty if there is none.
fn first_word(line: &str) -> &str {
    &line[..line.find(char::is_whitespace).unwrap_or(line.len())]
}

/// The statements of a text. A statement whose line ends in a backslash, ignoring white space and comments, continues in the
/// next line; comments, names and unknown statements do not.
pub fn statements(text: &str) -> impl Iterator<Item = Statement<'_>> {
    let mut lines = Lines { rest: Some(text) }.zip(1..).peekable();
    std::iter::from_fn(move || {
        loop {
            let (line, number) = lines.next()?;
            let (cut, mut goes_on) = part(line);
            let word = first_word(cut);
            if word.is_empty() {
                continue;
            }
            let kind = Kind::of(word);
            goes_on &= kind.goes_on();
            let whole = match kind {
                _ if kind.takes_name() => line.trim(),
                Kind::Unknown => without_comment(line).trim(),
                _ => cut,
            };
            let mut argument = Cow::Borrowed(whole[word.len()..].trim_start());
            while goes_on {
                let Some((next, _)) =
                    lines.next_if(|(next, _)| kind == Kind::Parameters || !is_statement(next))
                else {
                    break;
                };
                let (next, further) = part(next);
                let argument = argument.to_mut();
                argument.push(' ');
                argument.push_str(next);
                goes_on = further;
            }
            return Some(Statement {
                line: number,
                word,
                kind,
                argument,
            });
        }
    })
}

/// A line without comment, surrounding white space and final backslash; and whether there was one.
fn part(line: &str) -> (&str, bool) {
    let cut = without_comment(line).trim();
    match cut.strip_suffix('\\') {
        Some(part) => (part, true),
        None => (cut, false),
    }
}

/// Whether a line starts with the word of a statement. A continuation line has only numbers, so the backslash before is stray,
/// and joining the lines would lose a vertex or a face.
fn is_statement(line: &str) -> bool {
    Kind::of(first_word(without_comment(line).trim())) != Kind::Unknown
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Line, word and argument of each statement.
    fn lexed(text: &str) -> Vec<(usize, String, String)> {
        statements(text)
            .map(|s| (s.line, s.word.to_string(), s.argument.into_owned()))
            .collect()
    }

    fn assert_lexed(text: &str, expected: &[(usize, &str, &str)]) {
        let expected: Vec<_> = expected
            .iter()
            .map(|&(line, word, argument)| (line, word.to_string(), argument.to_string()))
            .collect();
        assert_eq!(lexed(text), expected, "for {text:?}");
    }

    #[test]
    fn lines_end_in_lf_cr_lf_or_cr() {
        for end in ["\n", "\r\n", "\r"] {
            let text = ["# a", "", " v 1 2 3\t", "f 1 \\", "2 3", "g a"].join(end);
            let expected = [(3, "v", "1 2 3"), (4, "f", "1  2 3"), (6, "g", "a")];
            assert_lexed(&text, &expected);
            assert_lexed(&format!("{text}{end}"), &expected);
        }
        // Mixed line ends; the CR of a CR LF does not end a line of its own.
        assert_lexed(
            "v 1\rv 2\r\nv 3\n\rv 4",
            &[(1, "v", "1"), (2, "v", "2"), (3, "v", "3"), (5, "v", "4")],
        );
    }

    #[test]
    fn comments_end_statements_and_never_go_on() {
        assert_lexed(
            "# in C:\\models\\\nv 1 2 3 # x \\\nv 4 5 6#y\n#v 7\nvt 0 \\ # z\n1\nf#\n",
            &[
                (2, "v", "1 2 3"),
                (3, "v", "4 5 6"),
                (5, "vt", "0  1"),
                (7, "f", ""),
            ],
        );
    }

    #[test]
    fn numbers_go_on_over_any_number_of_lines_and_trailing_white_space() {
        assert_lexed(
            "f 1 \\ \t\n 2\\\n\t3 \\\r\n4\nv 0\n\\\nv 1 \\",
            &[(1, "f", "1  2 3  4"), (5, "v", "0"), (7, "v", "1 ")],
        );
        assert_lexed("f\\\n1 2 3\n", &[(1, "f", " 1 2 3")]);
        // A blank line ends the statement.
        assert_lexed("f 1 2 3 \\\n\n4\n", &[(1, "f", "1 2 3  "), (3, "4", "")]);
    }

    #[test]
    fn a_stray_backslash_does_not_swallow_a_statement() {
        assert_lexed(
            "vt 0 0 \\\nv 1 2 3 \\\n# 4\nf 1 2\\\nf 3",
            &[
                (1, "vt", "0 0 "),
                (2, "v", "1 2 3  "),
                (4, "f", "1 2"),
                (5, "f", "3"),
            ],
        );
        // Here `v` is a direction.
        assert_lexed("parm \\\nv 0 1\n", &[(1, "parm", " v 0 1")]);
    }

    #[test]
    fn names_are_whole_and_never_go_on() {
        for word in [
            "o", "g", "usemtl", "mtllib", "newmtl", "usemap", "maplib", "call", "csh",
        ] {
            assert_lexed(
                &format!("  {word}  C:\\my tex\\ \nv 1 2 3\n"),
                &[(1, word, "C:\\my tex\\"), (2, "v", "1 2 3")],
            );
        }
        // Unknown statements do not continue either, because their arguments are unknown.
        assert_lexed(
            "texture C:\\tex\\\nv 1\n",
            &[(1, "texture", "C:\\tex\\"), (2, "v", "1")],
        );
        let text = "usemtl steel #2 # polished\nusemtl\nusemtl #none\n";
        let names: Vec<_> = statements(text).map(|s| s.argument).collect();
        assert_eq!(names, ["steel #2 # polished", "", "#none"]);
        assert_eq!(without_comment(&names[0]).trim_end(), "steel");
        assert_eq!(without_comment(&names[2]), "");
    }

    #[test]
    fn text_is_read_in_utf8_and_utf16_and_nothing_else_is_text() {
        let text = "v 0 0 0 # größer 𝄞\ng Ωmega\n";
        let wide =
            |unit: fn(u16) -> [u8; 2]| -> Vec<u8> { text.encode_utf16().flat_map(unit).collect() };
        let (little, big) = (wide(u16::to_le_bytes), wide(u16::to_be_bytes));
        for bytes in [
            text.as_bytes().to_vec(),
            [b"\xef\xbb\xbf", text.as_bytes()].concat(),
            [b"\xff\xfe", &little[..]].concat(),
            [b"\xfe\xff", &big[..]].concat(),
            little.clone(),
            big.clone(),
        ] {
            assert_eq!(decode(&bytes).as_deref(), Some(text), "for {bytes:?}");
        }
        for (bytes, expected) in [
            (&b"g Gr\xfc\xdfe"[..], "g Gr\u{fffd}\u{fffd}e"),
            (b"\xff\xfev\0 \0\x00\xd8", "v \u{fffd}"),
            (b"\xff\xfev\0 ", "v\u{fffd}"),
            (b"\xff\xfe", ""),
            (b"", ""),
        ] {
            assert_eq!(decode(bytes).as_deref(), Some(expected), "for {bytes:?}");
        }
        for bytes in [
            &b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR"[..],
            b"glTF\x02\0\0\0\x14\0\0\0",
            b"v 0 0 0\0",
            b"\xff\xfe\0\0v\0\0\0",
            b"\0",
            b"\0\0\0\0",
        ] {
            assert_eq!(decode(bytes), None, "for {bytes:?}");
        }
    }
}
