//! The report: JSON for machines, HTML for people.

use serde_json::{Value, json};

use crate::check::Check;

/// What was tried.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Board: `NUCLEO-F446RE`, and whether it is emulated.
    pub board: String,
    /// Chip and its revision.
    pub chip: String,
    /// Version of the firmware and of this program.
    pub versions: String,
    /// Whether anything of it is hardware.
    pub hardware: bool,
    /// The mutation, if there is one.
    pub mutation: Option<String>,
}

/// The report as JSON.
#[must_use]
pub fn json(subject: &Subject, checks: &[Check]) -> Value {
    json!({
        "format": 1,
        "level": 1,
        "board": subject.board,
        "chip": subject.chip,
        "versions": subject.versions,
        "hardware": subject.hardware,
        "mutation": subject.mutation,
        "checks": checks.iter().map(Check::json).collect::<Vec<_>>(),
    })
}

/// One line of text for a check.
#[must_use]
pub fn line(check: &Check) -> String {
    let measured = match check.measured {
        Some(value) => format!("{value:.6}"),
        None => "-".to_owned(),
    };
    let measured = measured.trim_end_matches('0').trim_end_matches('.');
    format!(
        "{:<4} {:<32} {:>14} {:<20} promised {} {}",
        if check.within() { "ok" } else { "FAIL" },
        check.name,
        measured,
        check.unit,
        check.promised,
        check.note
    )
    .trim_end()
    .to_owned()
}
