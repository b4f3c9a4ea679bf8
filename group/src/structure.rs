//! A file against the declaration: unknown keys, values of the wrong kind, missing keys, and
//! numbers that a robot would refuse.
//!
//! [`Checker::prune`] reports every such thing and takes it out of the tree, so that what is left
//! can be read and the other rules see it too: one run says everything. [`Checker::outside_limits`]
//! then goes through the numbers. Both know places in the text; what they do not know are rules
//! that involve more than one key.

use toml::Spanned;
use toml::de::{DeTable, DeValue};

use crate::check::Checker;
use crate::declaration::{Field, Kind, Range, Without};
use crate::error::nearest;
use crate::number::{rounded, shown, slip};

/// The key under which a robot's entries stand; what they lack is for rules that know `[robot]`.
const ROBOTS: &str = "robots";

impl Checker<'_> {
    /// Reports and removes what does not fit the declaration.
    pub fn prune(&self, table: &mut DeTable<'_>, fields: &[&'static Field], path: &str) {
        let mut bad = Vec::new();
        for (name, value) in table.iter_mut() {
            let key = name.get_ref().to_string();
            let known = fields
                .iter()
                .find(|f| f.key == key || f.formerly == Some(&key));
            let Some(field) = known else {
                self.unknown(name, &joined(path, &key), fields);
                bad.push(key);
                continue;
            };
            let path = joined(path, field.key);
            if !self.fits(value, field, &path) {
                bad.push(key);
            }
        }
        for key in bad {
            table.remove(key.as_str());
        }
    }

    fn unknown(&self, name: &Spanned<toml::de::DeString<'_>>, path: &str, fields: &[&Field]) {
        let known: Vec<&str> = fields.iter().map(|field| field.key).collect();
        let remedy = match nearest(name.get_ref(), &known) {
            Some(near) => {
                let table = path.strip_suffix(name.get_ref().as_ref()).unwrap_or("");
                self.settle(format!("{table}{near}"));
                format!("did you mean `{near}`?")
            }
            None => format!("remove it, or use one of: {}", known.join(", ")),
        };
        self.report(name.span().start, path, "unknown key", &remedy);
    }

    /// Whether a value is what the key holds; reports it otherwise.
    fn fits(&self, value: &mut Spanned<DeValue<'_>>, field: &Field, path: &str) -> bool {
        let span = value.span();
        let expected = match (field.kind, value.get_mut()) {
            (Kind::Number(_), DeValue::Float(_) | DeValue::Integer(_))
            | (Kind::Flag, DeValue::Boolean(_))
            | (Kind::Text, DeValue::String(_)) => return true,
            (Kind::Whole(..), DeValue::Integer(_)) => return true,
            (Kind::Choice(words), DeValue::String(word)) => {
                if words.contains(&word.as_ref()) {
                    return true;
                }
                let problem = format!("\"{word}\" is not one of its values");
                let remedy = format!("use one of: {}", words.join(", "));
                self.report(span.start, path, &problem, &remedy);
                return false;
            }
            (Kind::Numbers(count), DeValue::Array(list)) => {
                if list.iter().all(is_number) && count.is_none_or(|n| n == list.len()) {
                    return true;
                }
                count.map_or_else(|| "a list of numbers".into(), |n| format!("{n} numbers"))
            }
            (Kind::Rows(columns), DeValue::Array(list)) => {
                let row = |row: &Spanned<DeValue<'_>>| match row.get_ref() {
                    DeValue::Array(row) => row.len() == columns && row.iter().all(is_number),
                    _ => false,
                };
                if list.iter().all(row) {
                    return true;
                }
                format!("rows of {columns} numbers")
            }
            (Kind::Table(_), DeValue::Table(table)) => {
                return self.table(span.start, table, field, path);
            }
            (Kind::Tables(_), DeValue::Array(list)) => {
                return self.tables(list, field, path);
            }
            (kind, _) => expected(kind),
        };
        let text = self.source.text.get(span.clone()).unwrap_or("").trim();
        let problem = format!("`{text}` is not allowed here");
        self.report(span.start, path, &problem, &format!("give {expected}"));
        false
    }

    /// Whether a table has what it must have. Its parts are checked in any case.
    fn table(&self, at: usize, table: &mut DeTable<'_>, field: &Field, path: &str) -> bool {
        let fields: Vec<_> = field.inner().collect();
        let keys: Vec<_> = table.keys().map(|key| key.get_ref().to_string()).collect();
        self.prune(table, &fields, path);
        let mut complete = true;
        for field in fields {
            if matches!(field.without, Without::Required) && !table.contains_key(field.key) {
                complete = false;
                // What was there and wrong has been reported.
                if !keys.iter().any(|key| key == field.key) {
                    self.lacks(at, path, field.key);
                }
            }
        }
        complete
    }

    fn lacks(&self, at: usize, path: &str, key: &str) {
        let remedy = format!("add `{key} = ...`");
        self.report(at, &joined(path, key), "is missing", &remedy);
    }

    fn tables(&self, list: &mut toml::de::DeArray<'_>, field: &Field, path: &str) -> bool {
        let mut complete = true;
        for (n, entry) in list.iter_mut().enumerate() {
            let path = format!("{path}[{n}]");
            let start = entry.span().start;
            match entry.get_mut() {
                DeValue::Table(table) => complete &= self.table(start, table, field, &path),
                _ => {
                    self.report(start, &path, "is not a table", "give a table");
                    complete = false;
                }
            }
        }
        complete
    }

    /// What the file itself must have.
    pub fn required(&self, table: &DeTable<'_>, fields: &[Field]) {
        for field in fields {
            if matches!(field.without, Without::Required) && !table.contains_key(field.key) {
                self.lacks(0, "", field.key);
            }
        }
    }

    /// Reports numbers that are outside what the declaration or the robot's object allows.
    pub fn outside_limits(&self, table: &DeTable<'_>, fields: &[&'static Field], path: &str) {
        for (name, value) in table {
            let key = name.get_ref();
            let known = |f: &&&Field| f.key == key || f.formerly == Some(key);
            let Some(field) = fields.iter().find(known) else {
                continue;
            };
            let path = joined(path, field.key);
            let inner: Vec<_> = field.inner().collect();
            match value.get_ref() {
                DeValue::Table(table) => self.outside_limits(table, &inner, &path),
                DeValue::Array(list) if field.key == ROBOTS || !inner.is_empty() => {
                    for (n, entry) in list.iter().enumerate() {
                        if let DeValue::Table(table) = entry.get_ref() {
                            self.outside_limits(table, &inner, &format!("{path}[{n}]"));
                        }
                    }
                }
                _ => self.in_range(value, field, &path),
            }
        }
    }

    fn in_range(&self, value: &Spanned<DeValue<'_>>, field: &Field, path: &str) {
        let (Some(range), Some(number)) = (field.range(), number(value.get_ref())) else {
            return;
        };
        if range.holds(number) {
            return;
        }
        let unit = match field.unit {
            "" => String::new(),
            unit => format!(" {unit}"),
        };
        let meant = slip(number, field.unit, |value| range.holds(value));
        let meant = meant.map_or_else(String::new, |meant| format!("; {meant}"));
        let problem = format!("is {}{unit}", shown(number));
        self.report(
            value.span().start,
            path,
            &problem,
            &format!("{}{meant}", range.remedy(&unit)),
        );
    }
}

impl Range {
    /// Whether a number is in it. The ends come from numbers in other units, so they are widened by
    /// what rounding does.
    #[must_use]
    pub fn holds(&self, value: f64) -> bool {
        let slack = |end: f64| end.abs() * 1e-6;
        let low = if self.above_min {
            value > self.min
        } else {
            value >= self.min - slack(self.min)
        };
        value.is_finite() && low && value <= self.max + slack(self.max)
    }

    fn remedy(&self, unit: &str) -> String {
        let (min, max) = (rounded(self.min), rounded(self.max));
        match (self.min > f64::MIN, self.max < f64::MAX) {
            (true, true) if self.above_min => format!("give more than {min}, up to {max}{unit}"),
            (true, true) => format!("give {min} to {max}{unit}"),
            (true, false) if self.above_min => "give a number greater than 0".into(),
            (true, false) => format!("give {min} or more"),
            (false, true) => format!("give at most {max}{unit}"),
            (false, false) => "give a finite number".into(),
        }
    }
}

fn expected(kind: Kind) -> String {
    match kind {
        Kind::Number(_) => "a number".into(),
        Kind::Whole(..) => "a whole number".into(),
        Kind::Flag => "true or false".into(),
        Kind::Text => "text in quotes".into(),
        Kind::Choice(words) => format!("one of: {}", words.join(", ")),
        Kind::Numbers(None) => "a list of numbers".into(),
        Kind::Numbers(Some(count)) => format!("{count} numbers"),
        Kind::Rows(columns) => format!("rows of {columns} numbers"),
        Kind::Table(_) => "a table".into(),
        Kind::Tables(_) => "a list of tables".into(),
    }
}

fn is_number(value: &Spanned<DeValue<'_>>) -> bool {
    matches!(value.get_ref(), DeValue::Float(_) | DeValue::Integer(_))
}

fn number(value: &DeValue<'_>) -> Option<f64> {
    match value {
        DeValue::Float(number) => number.as_str().parse().ok(),
        DeValue::Integer(number) => i64::from_str_radix(number.as_str(), number.radix())
            .ok()
            .map(|number| number as f64),
        _ => None,
    }
}

fn joined(path: &str, key: &str) -> String {
    if path.is_empty() {
        key.to_owned()
    } else {
        format!("{path}.{key}")
    }
}
