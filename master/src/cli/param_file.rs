//! Parameters of one robot as a file: what `omnibus param dump` writes and `load` and `diff` read.
//!
//! TOML with one line per object, so that files can be compared and kept beside the group file.
//! Values are written so that reading gives the same bits back. A file is refused as a whole,
//! before anything is written, when it is of another wire version, names an object that does not
//! exist or cannot be written, or has a value beyond the object's limits.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context as _, bail};
use omnibus::session::sdo;
use protocol::object::Access;
use protocol::{Address, Kind, OBJECTS, Object, Value};
use serde::Deserialize;

use super::input;
use super::param_text::{find, parse};

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    wire_version: u16,
    #[serde(default)]
    node: Option<u8>,
    #[serde(default)]
    serial: Option<String>,
    parameters: BTreeMap<String, toml::Value>,
    #[serde(default)]
    blocks: BTreeMap<String, String>,
}

/// What a file holds.
pub struct Parameters {
    /// Node the values were read from.
    pub node: Option<u8>,
    /// In the order of the object dictionary.
    pub values: Vec<(Address, Value)>,
    /// Objects that are blocks of bytes.
    pub blocks: Vec<(Address, Vec<u8>)>,
}

impl Parameters {
    /// How many it holds.
    pub fn count(&self) -> usize {
        self.values.len() + self.blocks.len()
    }
}

/// A block as text: two digits a byte.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

fn from_hex(text: &str) -> Option<Vec<u8>> {
    if !text.is_ascii() || !text.len().is_multiple_of(2) {
        return None;
    }
    let pair = |n| u8::from_str_radix(text.get(n..n + 2)?, 16).ok();
    (0..text.len()).step_by(2).map(pair).collect()
}

/// The objects that make up a robot's configuration.
pub fn objects() -> impl Iterator<Item = &'static Object> {
    OBJECTS
        .iter()
        .filter(|object| object.access == Access::Parameter && object.persistent)
}

/// The text of a file.
pub fn write(
    node: u8,
    serial: u32,
    values: &[(&Object, Value)],
    blocks: &[(&Object, Vec<u8>)],
) -> String {
    let mut text = format!(
        "# Parameters of node {node}. `omnibus param load` writes them into a robot.\n\
         wire_version = {}\nnode = {node}\nserial = \"{serial:08X}\"\n\n[parameters]\n",
        protocol::WIRE_VERSION
    );
    for (object, value) in values {
        let unit = match object.unit {
            "" => String::new(),
            unit => format!(", {unit}"),
        };
        let number = match value {
            // TOML tells floating-point numbers by their point.
            Value::F32(value) => format!("{value:?}"),
            other => sdo::show(*other),
        };
        text += &format!(
            "\"{}\" = {number}  # {}{unit}\n",
            object.address, object.name
        );
    }
    if !blocks.is_empty() {
        text += "\n[blocks]\n";
    }
    for (object, bytes) in blocks {
        let (at, name) = (object.address, object.name);
        text += &format!("\"{at}\" = \"{}\"  # {name}\n", hex(bytes));
    }
    text
}

/// Reads and checks a file.
pub fn read(path: &Path) -> anyhow::Result<Parameters> {
    let text = input::text(path, "a file that `omnibus param dump` wrote")?;
    parse_text(&text).with_context(|| path.display().to_string())
}

fn parse_text(text: &str) -> anyhow::Result<Parameters> {
    let file: File = toml::from_str(text).map_err(|error| {
        anyhow::anyhow!(
            "is not a file that `omnibus param dump` wrote: {}; a group file goes into robots with \
             `omnibus group apply`",
            error.message()
        )
    })?;
    if file.wire_version != protocol::WIRE_VERSION {
        bail!(
            "wire_version: the file has version {}, this release has {}; dump the robot again",
            file.wire_version,
            protocol::WIRE_VERSION
        );
    }
    // For people only.
    drop(file.serial);
    let mut values = Vec::new();
    for (name, value) in &file.parameters {
        let object = find(name)?;
        if object.access != Access::Parameter {
            bail!(
                "{} is not a parameter; remove its line",
                sdo::name(object.address)
            );
        }
        let text = match value {
            toml::Value::Integer(number) => number.to_string(),
            toml::Value::Float(number) => number.to_string(),
            other => bail!("{}: {other} is not a number", sdo::name(object.address)),
        };
        values.push((object.address, parse(object, &text)?));
    }
    values.sort_by_key(|(at, _)| at.packed());
    let mut blocks = Vec::new();
    for (name, text) in &file.blocks {
        let object = find(name)?;
        let at = object.address;
        if object.kind != Kind::Domain || object.access != Access::Parameter {
            bail!(
                "{}: is not a block of bytes that can be written",
                sdo::name(at)
            );
        }
        let bytes = from_hex(text)
            .with_context(|| format!("{}: '{text}' is not a hexadecimal number", sdo::name(at)))?;
        blocks.push((at, bytes));
    }
    Ok(Parameters {
        node: file.node,
        values,
        blocks,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use protocol::address;

    #[test]
    fn what_is_written_reads_back_to_the_bit() {
        let radius = OBJECTS
            .iter()
            .find(|o| o.address == address::WHEEL_RADIUS)
            .unwrap();
        let members = OBJECTS
            .iter()
            .find(|o| o.address == address::MEMBERS)
            .unwrap();
        let values = [
            (radius, Value::F32(0.152_400_01)),
            (members, Value::U32(28)),
        ];
        let read = parse_text(&write(3, 0x1A2B, &values, &[])).unwrap();
        assert_eq!(read.node, Some(3));
        let expected: Vec<_> = values.iter().map(|(o, v)| (o.address, *v)).collect();
        assert_eq!(read.values, expected);
        let set = OBJECTS
            .iter()
            .find(|o| o.address == address::COMPENSATION_SET)
            .unwrap();
        let text = write(3, 0x1A2B, &values, &[(set, vec![0, 0xAB, 0xFF])]);
        assert_eq!(
            parse_text(&text).unwrap().blocks,
            [(set.address, vec![0, 0xAB, 0xFF])]
        );
    }

    #[test]
    fn files_that_do_not_fit_are_refused_by_name() {
        let head = format!("wire_version = {}\n[parameters]\n", protocol::WIRE_VERSION);
        let refused = |body: &str| {
            parse_text(&format!("{head}{body}"))
                .err()
                .unwrap()
                .to_string()
        };
        assert!(refused("\"2010:3\" = 99.0").contains("Wheel radius"));
        assert!(refused("\"2010:9\" = 1.0").contains("2010:9"));
        assert!(refused("\"2110:1\" = 1").contains("is not a parameter"));
        assert!(refused("\"2010:3\" = \"x\"").contains("is not a number"));
        let old = parse_text("wire_version = 0\n[parameters]\n")
            .err()
            .unwrap();
        assert!(old.to_string().contains("version 0"));
    }
}
