//! The errors for which a group file is refused.
//!
//! One sentence in one fixed order, `file:line: field: problem; remedy`, so that an editor can jump
//! to the place and a person knows what to type there. The exact text is under test.

use std::fmt;

/// Why a group file was refused.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct GroupError {
    /// The file, as the caller named it.
    pub file: String,
    /// Line in the file, from 1. `None` when the file could not be read at all.
    pub line: Option<usize>,
    /// The field, with the table and robot it belongs to (`robots[1].wheel_radius`).
    pub field: String,
    /// What is wrong with it.
    pub problem: String,
    /// What to do about it.
    pub remedy: String,
}

impl fmt::Display for GroupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}", self.file)?;
        if let Some(line) = self.line {
            write!(f, ":{line}")?;
        }
        if !self.field.is_empty() {
            write!(f, ": {}", self.field)?;
        }
        write!(f, ": {}; {}", self.problem, self.remedy)
    }
}

impl std::error::Error for GroupError {}

/// The text a group file was read from, which turns places into lines.
#[derive(Clone, Copy)]
pub(crate) struct Source<'a> {
    pub file: &'a str,
    pub text: &'a str,
}

impl Source<'_> {
    /// Line of a byte offset, from 1.
    pub fn line(&self, offset: usize) -> usize {
        let offset = offset.min(self.text.len());
        1 + self.text.as_bytes()[..offset]
            .iter()
            .filter(|b| **b == b'\n')
            .count()
    }

    pub fn error(
        &self,
        offset: usize,
        field: impl Into<String>,
        problem: impl Into<String>,
        remedy: impl Into<String>,
    ) -> GroupError {
        GroupError {
            file: self.file.to_owned(),
            line: Some(self.line(offset)),
            field: field.into(),
            problem: problem.into(),
            remedy: remedy.into(),
        }
    }

    /// Turns what the TOML reader says into the same form: it knows the place, not the remedy.
    pub fn toml_error(&self, error: &toml::de::Error) -> GroupError {
        let start = error.span().map_or(0, |span| span.start);
        let message = error.message().trim().replace('\n', ", ");
        self.error(start, self.key_before(start), message, "fix the TOML here")
    }

    /// The key on the line of an offset, when that line has one.
    fn key_before(&self, offset: usize) -> String {
        let line = self.text.lines().nth(self.line(offset) - 1).unwrap_or("");
        line.split_once('=')
            .map_or(String::new(), |(key, _)| key.trim().to_owned())
    }
}

/// The known key that a misspelt one most likely meant: at most a third of its letters differ.
pub(crate) fn nearest<'a>(key: &str, known: &[&'a str]) -> Option<&'a str> {
    known
        .iter()
        .map(|k| (distance(key, k), *k))
        .filter(|(d, k)| d * 3 <= k.len())
        .min()
        .map(|(_, k)| k)
}

/// Levenshtein distance in bytes.
fn distance(a: &str, b: &str) -> usize {
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, x) in a.bytes().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, y) in b.bytes().enumerate() {
            let change = diagonal + usize::from(x != y);
            diagonal = row[j + 1];
            row[j + 1] = change.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}
