//! The report: JSON for machines, HTML for people, a line of text for the terminal.
//!
//! The page is one self-contained file in the style of the other reports. The heading and
//! `hardware: false` mark an emulated or simulated run. Limits: a bus that another process
//! simulates in real time looks like a real one.

use std::fmt::Write as _;

use chart::page::{begin, end, escape};
use serde_json::{Value, json};

use crate::check::{Check, Outcome};

/// Version of the format of reports.
pub const FORMAT: u32 = 2;

/// Today's date in UTC, `2026-11-24`.
#[must_use]
pub fn today() -> String {
    let now = std::time::SystemTime::now();
    let since = now.duration_since(std::time::UNIX_EPOCH);
    date(since.map_or(0, |since| since.as_secs()) / 86_400)
}

/// The date so many days after 1970-01-01.
fn date(mut days: u64) -> String {
    let is_leap = |year: u64| {
        year.is_multiple_of(4) && (!year.is_multiple_of(100) || year.is_multiple_of(400))
    };
    let mut year = 1970;
    while days >= 365 + u64::from(is_leap(year)) {
        days -= 365 + u64::from(is_leap(year));
        year += 1;
    }
    let mut month = 1;
    for length in [
        31,
        28 + u64::from(is_leap(year)),
        31,
        30,
        31,
        30,
        31,
        31,
        30,
        31,
        30,
    ] {
        if days < length {
            break;
        }
        days -= length;
        month += 1;
    }
    format!("{year}-{month:02}-{:02}", days + 1)
}

/// What was tried.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Level of the acceptance, 1 to 3.
    pub level: u8,
    /// Board: `NUCLEO-F446RE`, or the group, and whether it is emulated.
    pub board: String,
    /// Chip and its revision.
    pub chip: String,
    /// Version of the firmware and of this program.
    pub versions: String,
    /// Day of the trial, `2026-11-24`.
    pub date: String,
    /// Whether anything of it is hardware.
    pub hardware: bool,
    /// The mutation, if there is one.
    pub mutation: Option<String>,
    /// What of it says less than a trial of hardware, in sentences.
    pub limits: Vec<String>,
}

/// How many promises came out which way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Count {
    /// Kept.
    pub kept: usize,
    /// Missed.
    pub missed: usize,
    /// Not tried.
    pub not_tried: usize,
}

impl Count {
    /// Counts checks.
    #[must_use]
    pub fn of(checks: &[Check]) -> Self {
        let count = |outcome| checks.iter().filter(|c| c.outcome() == outcome).count();
        Self {
            kept: count(Outcome::Kept),
            missed: count(Outcome::Missed),
            not_tried: count(Outcome::NotTried),
        }
    }
}

impl std::fmt::Display for Count {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "{} promises kept, {} missed, {} not tried",
            self.kept, self.missed, self.not_tried
        )
    }
}

/// The report as JSON.
#[must_use]
pub fn json(subject: &Subject, checks: &[Check]) -> Value {
    let count = Count::of(checks);
    json!({
        "format": FORMAT,
        "level": subject.level,
        "board": subject.board,
        "chip": subject.chip,
        "versions": subject.versions,
        "date": subject.date,
        "hardware": subject.hardware,
        "mutation": subject.mutation,
        "limits": subject.limits,
        "kept": count.kept,
        "missed": count.missed,
        "not_tried": count.not_tried,
        "checks": checks.iter().map(Check::json).collect::<Vec<_>>(),
    })
}

/// Takes over what an emulated run has measured, from its JSON, as what is to be expected.
pub fn expect(checks: &mut [Check], emulated: &Value) {
    let Some(before) = emulated["checks"].as_array() else {
        return;
    };
    for check in checks {
        let same = before.iter().find(|other| other["name"] == check.name);
        check.expected = same.and_then(|other| other["measured"].as_f64());
    }
}

/// Digits of a figure: enough to tell it from a bound that it misses narrowly.
const DIGITS: i32 = 8;

/// A number with as many digits as it needs, [`DIGITS`] at most, and six of them behind the point.
#[must_use]
pub fn figure(value: Option<f64>) -> String {
    let Some(value) = value else {
        return "-".to_owned();
    };
    let before_point = value.abs().max(1.0).log10() as i32 + 1;
    let behind = (DIGITS - before_point).clamp(0, 6) as usize;
    let text = format!("{value:.behind$}");
    match text.contains('.') {
        true => text.trim_end_matches('0').trim_end_matches('.').to_owned(),
        false => text,
    }
}

/// One line of text for a check.
#[must_use]
pub fn line(check: &Check) -> String {
    let word = match check.outcome() {
        Outcome::Kept => "ok",
        Outcome::Missed => "FAIL",
        Outcome::NotTried => "-",
    };
    format!(
        "{word:<4} {:<32} {:>14} {:<20} promised {} {}",
        check.name,
        figure(check.measured),
        check.unit,
        check.promised,
        check.note
    )
    .trim_end()
    .to_owned()
}

/// The report as a page.
#[must_use]
pub fn html(subject: &Subject, checks: &[Check]) -> String {
    let count = Count::of(checks);
    let heading = format!("Acceptance, level {}", subject.level);
    let mut out = begin(&format!("Omnibus: {heading}"), &heading);
    let _ = write!(
        out,
        "<p class=\"lead\"><code>{}</code>, {}{}<br>chip: {}<br>versions: {}</p><p><b>{}</b></p>",
        escape(&subject.board),
        escape(&subject.date),
        match &subject.mutation {
            Some(mutation) => format!(", with the defect <code>{}</code>", escape(mutation)),
            None => String::new(),
        },
        escape(&subject.chip),
        escape(&subject.versions),
        if subject.hardware {
            "Measured on hardware."
        } else {
            "Simulated: nothing of this has run on hardware."
        },
    );
    out.push_str("<div class=\"cards\">");
    for (value, text) in [
        (count.kept, "kept"),
        (count.missed, "missed"),
        (count.not_tried, "not tried"),
    ] {
        let _ = write!(
            out,
            "<div class=\"card\"><b>{value}</b><span>{text}</span></div>"
        );
    }
    out.push_str("</div>");
    let expected = if subject.hardware {
        "emulated"
    } else {
        "expected"
    };
    for (outcome, title) in [
        (Outcome::Missed, "Missed"),
        (Outcome::Kept, "Kept"),
        (Outcome::NotTried, "Not tried"),
    ] {
        let chosen = checks.iter().filter(|check| check.outcome() == outcome);
        table(&mut out, title, expected, chosen);
    }
    if !subject.limits.is_empty() {
        out.push_str("<h2>What this does not say</h2><ul>");
        for limit in &subject.limits {
            let _ = write!(out, "<li>{}</li>", escape(limit));
        }
        out.push_str("</ul>");
    }
    out.push_str(
        "<h2>Where this comes from</h2><p>Every promise is read from the document that makes it, \
         and every figure is measured by the procedure beside it. <code>docs/acceptance.md</code> \
         tells how to repeat this.</p>",
    );
    end(&mut out);
    out
}

/// The checks of one outcome.
fn table<'a>(
    out: &mut String,
    title: &str,
    expected: &str,
    checks: impl Iterator<Item = &'a Check>,
) {
    let mut rows = String::new();
    for check in checks {
        let mut note = escape(check.procedure);
        if !check.note.is_empty() {
            let dot = if note.is_empty() { "" } else { ". " };
            let _ = write!(note, "{dot}<b>{}</b>", escape(&check.note));
        }
        let _ = write!(
            rows,
            "<tr><td>{}<br><span style=\"color:#5b6673;font-size:13px\">{note}<br>{}</span></td>\
             <td style=\"white-space:nowrap\">{}</td><td>{}</td><td>{}</td>\
             <td style=\"text-align:left\">{}</td></tr>",
            escape(&check.name),
            escape(&check.source),
            escape(&check.promised.to_string()).replace("+-", "±"),
            figure(check.expected),
            figure(check.measured),
            escape(check.unit),
        );
    }
    if !rows.is_empty() {
        let _ = write!(
            out,
            "<h2>{title}</h2><table><thead><tr><th>promise</th><th>promised</th><th>{expected}</th>\
             <th>measured</th><th style=\"text-align:left\">unit</th></tr></thead>\
             <tbody>{rows}</tbody></table>"
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Days between dates by `date -d @$((days * 86400))`.
    #[test]
    fn dates_are_those_of_the_calendar() {
        assert_eq!(date(0), "1970-01-01");
        assert_eq!(date(11_016), "2000-02-29");
        assert_eq!(date(20_453), "2025-12-31");
        assert_eq!(date(20_454), "2026-01-01");
        assert_eq!(date(47_541), "2100-03-01");
    }

    #[test]
    fn a_figure_has_eight_digits_at_most() {
        for (value, text) in [
            (19_996.667_222, "19996.667"),
            (0.085_123_456, "0.085123"),
            (1_000_000.0, "1000000"),
            (-1.5, "-1.5"),
            (0.0, "0"),
        ] {
            assert_eq!(figure(Some(value)), text);
        }
        assert_eq!(figure(None), "-");
    }

    #[test]
    fn a_page_has_every_check_and_escapes_text() {
        let check = |name: &str, measured, tried| Check {
            name: name.into(),
            promised: crate::Bound::AtMost(1.0),
            measured,
            unit: "ms",
            tried,
            expected: Some(0.5),
            source: "docs/safety.md: a < b".into(),
            procedure: "measured",
            note: String::new(),
        };
        let checks = [
            check("kept.one", Some(0.25), true),
            check("missed.one", Some(2.0), true),
            check("left.out", None, false),
        ];
        let subject = Subject {
            level: 1,
            board: "<board>".into(),
            chip: "chip".into(),
            versions: "0".into(),
            date: date(0),
            hardware: false,
            mutation: None,
            limits: vec!["fewer frames".to_owned()],
        };
        let page = html(&subject, &checks);
        for words in [
            "kept.one",
            "missed.one",
            "left.out",
            "0.25",
            "&lt;board&gt;",
            "a &lt; b",
            "<li>fewer frames</li>",
        ] {
            assert!(page.contains(words), "{words}");
        }
        assert!(page.contains("nothing of this has run on hardware"));
        assert_eq!(json(&subject, &checks)["missed"], 1);
    }
}
