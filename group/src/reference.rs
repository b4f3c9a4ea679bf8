//! The declaration for people and for editors: the page `docs/group-files.md` and a JSON Schema.

use std::fmt::Write as _;

use serde_json::{Map, Value, json};

use crate::declaration::{FILE, Field, Kind, Without};
use crate::number::rounded;

const HEAD: &str = "# Group files

One TOML file describes a group completely: which robots there are, where each stands, their wheels,
motors and encoders. The master writes it into the robots before anything moves; the simulator
builds the same robots from it. Axes are x ahead, y to the left, headings counter-clockwise.

```sh
omnibus group new my-group.toml         # asks, and writes a file that passes its own check
omnibus group check my-group.toml       # everything that is wrong, each with file, line and remedy
omnibus group draw my-group.toml        # a picture, in the terminal or as SVG
omnibus group show my-group.toml        # every parameter as it would be written into each robot
omnibus group schema > group.schema.json
```

An unknown key is an error, because a misspelt key is a value that silently kept its default. An
editor that knows JSON Schema for TOML (taplo, Even Better TOML) completes and explains keys with
`#:schema ./group.schema.json` as the file's first line.

This page is generated from `group/src/declaration/`; `omnibus group check` uses the same
declaration. Ranges are those of the robots' own objects where a key becomes one
([CAN protocol](can-protocol.md)); `group check` says more about keys that depend on each other.
";

/// The page `docs/group-files.md`.
#[must_use]
pub fn page() -> String {
    let mut out = HEAD.to_owned();
    section(&mut out, "The file", "", FILE.iter());
    tables(&mut out, "", FILE.iter());
    out
}

fn tables(out: &mut String, path: &str, fields: impl Iterator<Item = &'static Field>) {
    for field in fields {
        let name = format!("{path}{}", field.key);
        let title = match field.kind {
            Kind::Table(_) => format!("`[{name}]`"),
            Kind::Tables(_) => format!("`[[{name}]]`"),
            _ => continue,
        };
        // What `[robot]` has is described there.
        let own: Vec<_> = if field.key == "robots" {
            field
                .inner()
                .take_while(|f| f.key != "half_track")
                .collect()
        } else {
            field.inner().collect()
        };
        section(out, &title, field.text, own.iter().copied());
        // Four wheels are described once.
        let inner: Vec<_> = own
            .into_iter()
            .filter(|f| f.key == "front_left" || !is_wheel(f))
            .collect();
        tables(out, &format!("{name}."), inner.into_iter());
    }
}

fn is_wheel(field: &Field) -> bool {
    ["front_left", "front_right", "rear_left", "rear_right"].contains(&field.key)
}

fn section(
    out: &mut String,
    title: &str,
    text: &str,
    fields: impl Iterator<Item = &'static Field>,
) {
    let _ = write!(out, "\n## {title}\n\n");
    if !text.is_empty() {
        let _ = write!(out, "{text}\n\n");
    }
    out.push_str(
        "| key | holds | unit | without it | object | meaning |\n|---|---|---|---|---|---|\n",
    );
    for field in fields {
        let object = field
            .object
            .map_or_else(String::new, |object| object.address.to_string());
        let formerly = field.formerly.map_or_else(String::new, |old| {
            format!(" Formerly `{old}`, which is still read.")
        });
        let _ = writeln!(
            out,
            "| `{}` | {} | {} | {} | {object} | {}{formerly} |",
            field.key,
            holds(field),
            field.unit,
            without(field),
            field.text,
        );
    }
}

fn holds(field: &Field) -> String {
    let end = |value: f64| rounded(value);
    match (field.kind, field.range()) {
        (Kind::Number(_) | Kind::Whole(..), Some(range)) => {
            let (low, high) = (range.min > f64::MIN, range.max < 9e18);
            let what = if matches!(field.kind, Kind::Whole(..)) {
                "whole number"
            } else {
                "number"
            };
            match (low, high) {
                (true, true) if range.above_min => {
                    format!("{what} above {} up to {}", end(range.min), end(range.max))
                }
                (true, true) => format!("{what}, {} to {}", end(range.min), end(range.max)),
                (true, false) if range.above_min => format!("{what} above {}", end(range.min)),
                (true, false) => format!("{what}, {} or more", end(range.min)),
                _ => what.to_owned(),
            }
        }
        (Kind::Flag, _) => "true or false".into(),
        (Kind::Choice(words), _) => {
            let words: Vec<_> = words.iter().map(|word| format!("`\"{word}\"`")).collect();
            words.join(", ")
        }
        (Kind::Numbers(Some(count)), _) => format!("list of {count} numbers"),
        (Kind::Numbers(None), _) => "list of numbers".into(),
        (Kind::Rows(columns), _) => format!("rows of {columns} numbers"),
        (Kind::Table(_), _) => "table".into(),
        (Kind::Tables(_), _) => "list of tables".into(),
        _ => "text".into(),
    }
}

fn without(field: &Field) -> String {
    match field.without {
        Without::Required | Without::Needed => "required".into(),
        Without::NeededSomewhere => "required here or in the robot's entry".into(),
        Without::Default(value) => rounded(value),
        Without::Otherwise(what) => what.into(),
    }
}

/// A JSON Schema (draft 7, which editors for TOML read) of the group file.
#[must_use]
pub fn schema() -> String {
    let mut schema = object(FILE.iter());
    let root = [
        ("$schema", "http://json-schema.org/draft-07/schema#"),
        ("title", "Omnibus group file"),
    ];
    for (key, value) in root {
        schema[key] = value.into();
    }
    // A document of strings, numbers and lists can always be written.
    let text = serde_json::to_string_pretty(&schema).unwrap_or_default();
    text + "\n"
}

fn object(fields: impl Iterator<Item = &'static Field>) -> Value {
    let (mut properties, mut required) = (Map::new(), Vec::new());
    for field in fields {
        if matches!(field.without, Without::Required) || ["robots", "node"].contains(&field.key) {
            required.push(field.key);
        }
        let property = property(field);
        if let Some(old) = field.formerly {
            let mut old_one = property.clone();
            old_one["deprecated"] = true.into();
            old_one["description"] = format!("Old name of `{}`.", field.key).into();
            properties.insert(old.into(), old_one);
        }
        properties.insert(field.key.into(), property);
    }
    json!({"type": "object", "properties": properties, "required": required,
           "additionalProperties": false})
}

fn property(field: &Field) -> Value {
    let mut out = match field.kind {
        Kind::Number(_) => json!({"type": "number"}),
        Kind::Whole(..) => json!({"type": "integer"}),
        Kind::Flag => json!({"type": "boolean"}),
        Kind::Text => json!({"type": "string"}),
        Kind::Choice(words) => json!({"enum": words}),
        Kind::Numbers(None) => json!({"type": "array", "items": {"type": "number"}}),
        Kind::Numbers(Some(count)) => numbers(count),
        Kind::Rows(columns) => json!({"type": "array", "items": numbers(columns)}),
        Kind::Table(_) => object(field.inner()),
        Kind::Tables(_) => json!({"type": "array", "items": object(field.inner())}),
    };
    let unit = match field.unit {
        "" => String::new(),
        unit => format!(" Unit: {unit}."),
    };
    out["description"] = format!("{}{unit}", field.text).into();
    if let Without::Default(value) = field.without {
        out["default"] = shortest(value);
    }
    if let Some(range) = field.range() {
        if range.min > f64::MIN {
            let key = if range.above_min {
                "exclusiveMinimum"
            } else {
                "minimum"
            };
            out[key] = shortest(range.min);
        }
        if range.max < 9e18 {
            out["maximum"] = shortest(range.max);
        }
    }
    out
}

fn numbers(count: usize) -> Value {
    json!({"type": "array", "items": {"type": "number"}, "minItems": count, "maxItems": count})
}

/// A number as [`rounded`] writes it, whole where it is whole.
fn shortest(value: f64) -> Value {
    let text = rounded(value);
    text.parse::<i64>().map_or_else(
        |_| text.parse::<f64>().map_or(Value::Null, Value::from),
        Value::from,
    )
}
