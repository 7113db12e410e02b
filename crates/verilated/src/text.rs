//! Makes text from outside safe to print.
//!
//! Names of files and words in files may contain line feeds, escape sequences or bytes that are not UTF-8. Pass them
//! through [`escaped`], [`path`] or [`word`] before they go to a message, a report or a terminal.

use std::borrow::Cow;
use std::path::Path;

/// Returns `text` with every control character, line or paragraph separator, and every character
/// that changes the direction of text escaped as in Rust source, such as `\u{1b}` or `\n`.
pub fn escaped(text: &str) -> Cow<'_, str> {
    if !text.chars().any(is_unprintable) {
        return Cow::Borrowed(text);
    }
    let mut shown = String::with_capacity(text.len() + 8);
    for c in text.chars() {
        match is_unprintable(c) {
            true => shown.extend(c.escape_default()),
            false => shown.push(c),
        }
    }
    Cow::Owned(shown)
}

/// Returns a path for display: bytes that are not UTF-8 become replacement characters, then the
/// text is [`escaped`].
pub fn path(path: &Path) -> String {
    escaped(&path.to_string_lossy()).into_owned()
}

/// Returns a word, [`escaped`] and cut after 24 characters.
pub fn word(word: &str) -> String {
    cut(word, 24)
}

/// Returns a text cut after `longest` characters, with `…` in place of the rest, and then
/// [`escaped`].
pub fn cut(text: &str, longest: usize) -> String {
    let mut shown: String = text.chars().take(longest).collect();
    if text.chars().nth(longest).is_some() {
        shown.push('…');
    }
    escaped(&shown).into_owned()
}

/// Returns a number in the shortest decimal form that reads back as the same value, with an
/// exponent if it is less than 10⁻⁵ or at least 10¹⁶ in magnitude.
pub fn number(x: f64) -> String {
    match x == 0.0 || !x.is_finite() || (1e-5..1e16).contains(&x.abs()) {
        true => x.to_string(),
        false => format!("{x:e}"),
    }
}

fn is_unprintable(c: char) -> bool {
    let changes_direction =
        matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    c.is_control() || changes_direction || matches!(c, '\u{2028}' | '\u{2029}')
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn control_characters_are_escaped_and_nothing_else_is() {
        assert_eq!(escaped("Straße 12 — `ok`"), "Straße 12 — `ok`");
        assert!(matches!(escaped("plain"), Cow::Borrowed(_)));
        assert_eq!(
            escaped("a\u{7}b\u{1b}[31m\0\n"),
            r"a\u{7}b\u{1b}[31m\u{0}\n"
        );
        assert_eq!(escaped("x\u{202e}y\u{9b}"), r"x\u{202e}y\u{9b}");
    }

    #[test]
    fn long_words_are_cut() {
        assert_eq!(word("short"), "short");
        assert_eq!(word(&"x".repeat(30)), format!("{}…", "x".repeat(24)));
    }

    #[test]
    fn numbers_are_never_long() {
        let shown = [0.0, -0.5, 60.0, 123456789.25, 1e15, 0.00002, f64::INFINITY].map(number);
        assert_eq!(
            shown,
            [
                "0",
                "-0.5",
                "60",
                "123456789.25",
                "1000000000000000",
                "0.00002",
                "inf"
            ]
        );
        let shown = [1e308, -1.5e16, 1e-300].map(number);
        assert_eq!(shown, ["1e308", "-1.5e16", "1e-300"]);
        for x in [1e308, 1e-300, -1e300] {
            assert_eq!(number(x).parse(), Ok(x));
        }
    }

    #[cfg(unix)]
    #[test]
    fn paths_that_are_not_utf8_are_shown_with_replacement_characters() {
        use std::os::unix::ffi::OsStrExt;
        let name = std::ffi::OsStr::from_bytes(b"na\xffme\n.obj");
        assert_eq!(path(Path::new(name)), "na\u{fffd}me\\n.obj");
    }
}
