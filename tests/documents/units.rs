//! Public numbers say their unit, as CONTRIBUTING.md asks.

use super::{files, nothing, read};

/// Units, and what stands for "none": a number without one says what it is a part or multiple of.
/// Of a unit such as `m/s^2` what stands before the slash counts.
const UNITS: [&str; 54] = [
    "A",
    "C",
    "H",
    "Hz",
    "J",
    "K",
    "MHz",
    "N",
    "Ohm",
    "Ω",
    "V",
    "W",
    "bits",
    "bytes",
    "clocks",
    "counts",
    "cycles",
    "deg",
    "degree",
    "degrees",
    "deviations",
    "factor",
    "fraction",
    "instructions",
    "kHz",
    "kg",
    "m",
    "mA",
    "mV",
    "matrix",
    "metres",
    "mm",
    "ms",
    "multiple",
    "ns",
    "ohm",
    "per",
    "percent",
    "pixels",
    "points",
    "ppm",
    "rad",
    "ratio",
    "revolution",
    "revolutions",
    "s",
    "second",
    "share",
    "squared",
    "steps",
    "times",
    "unit",
    "units",
    "us",
];

/// Files of private modules whose numbers are described elsewhere: the keys of the group file in
/// its declaration.
const DESCRIBED_ELSEWHERE: [&str; 2] = ["group/src/schema.rs", "group/src/check.rs"];

/// The name of the public number, or numbers, that a line declares.
fn number(line: &str) -> Option<&str> {
    let declared = line.trim_start().strip_prefix("pub")?;
    let (visibility, declared) = declared.split_once(' ')?;
    let is_plain = visibility.is_empty() || visibility.starts_with('(');
    let declared = declared.strip_prefix("const ").unwrap_or(declared);
    let declared = declared.strip_prefix("static ").unwrap_or(declared);
    let (name, kind) = declared.split_once(": ")?;
    let kind = kind.split(" = ").next()?;
    let bare = kind
        .split(|letter: char| !letter.is_ascii_alphanumeric())
        .filter(|word| !word.is_empty() && word.parse::<usize>().is_err())
        .all(|word| ["Option", "Vec", "f32", "f64"].contains(&word));
    let is_number = kind.contains("f32") || kind.contains("f64");
    let is_name = name
        .chars()
        .all(|letter| letter.is_ascii_alphanumeric() || letter == '_');
    (is_plain && bare && is_number && is_name).then_some(name)
}

/// Whether a text or a name has a unit, or a range that ends in 1.
fn has_unit(text: &str) -> bool {
    let word = |word: &str| {
        let word = word.trim_end_matches(['.', '\'']).trim_end_matches("'s");
        let unit = word.split(['/', '^']).next().unwrap_or(word);
        UNITS
            .iter()
            .any(|known| unit == *known || known.len() > 1 && unit.eq_ignore_ascii_case(known))
    };
    text.contains("..=1")
        || text.contains(" 1 ")
        || text
            .split(|letter: char| letter.is_whitespace() || ",;:()`_[]*·".contains(letter))
            .any(word)
}

/// The documentation above a line.
fn documentation(lines: &[&str], line: usize) -> String {
    let above = lines[..line].iter().rev().map(|line| line.trim_start());
    above
        .take_while(|line| line.starts_with("///") || line.starts_with("#["))
        .filter_map(|line| line.strip_prefix("///"))
        .collect::<Vec<_>>()
        .join(" ")
}

/// Numbers of a text that say no unit: neither they, nor their names, nor what holds them.
fn without_unit(text: &str) -> Vec<(usize, &str)> {
    let lines: Vec<&str> = text.lines().collect();
    let mut holder = false;
    let mut found = Vec::new();
    for (at, line) in lines.iter().enumerate() {
        if line.contains("struct ") || line.contains("enum ") {
            holder = has_unit(&documentation(&lines, at));
        } else if line.starts_with('}') {
            holder = false;
        }
        if let Some(name) = number(line)
            && !holder
            && !has_unit(name)
            && !has_unit(&documentation(&lines, at))
        {
            found.push((at + 1, name));
        }
    }
    found
}

#[test]
fn public_numbers_say_their_unit() {
    let mut complaints = Vec::new();
    for path in files("rs") {
        let name = path.to_string_lossy();
        if name.contains("tests") || DESCRIBED_ELSEWHERE.contains(&&*name) {
            continue;
        }
        for (line, number) in without_unit(&read(&path)) {
            complaints.push(format!("{name}:{line}: `{number}` without a unit"));
        }
    }
    nothing(&complaints);
}

#[test]
fn a_number_without_a_unit_is_found() {
    let text = "\
/// How far.
pub struct Way {
    /// As the crow flies.
    pub straight: f64,
    /// Along the path, m.
    pub path: f64,
    pub turned_deg: [f32; 4],
}
/// As it was measured, in rad.
pub struct Turn {
    pub by: Option<f64>,
}
pub const LONGEST: f64 = 4.0;
/// The fraction that is left.
pub const LEFT: f32 = 0.1;
pub count: usize,
";
    assert_eq!(without_unit(text), [(4, "straight"), (13, "LONGEST")]);
}
