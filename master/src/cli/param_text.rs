//! Objects and values as people write them on the command line and in parameter files.

use anyhow::bail;
use omnibus::session::sdo;
use protocol::{Address, Kind, OBJECTS, Object, Value};

use super::communication;

/// The object at an address written as `2010:3`, or with a name.
pub fn find(text: &str) -> anyhow::Result<&'static Object> {
    let named: Vec<_> = OBJECTS
        .iter()
        .filter(|object| object.name.eq_ignore_ascii_case(text))
        .collect();
    match named[..] {
        [only] => return Ok(only),
        [first, ..] => bail!(
            "{} objects are called '{text}', the first of them {}; give an address",
            named.len(),
            first.address
        ),
        [] => {}
    }
    let (index, sub) = text.split_once(':').unwrap_or((text, "0"));
    let parsed = u16::from_str_radix(index.trim_start_matches("0x"), 16)
        .ok()
        .zip(u8::from_str_radix(sub, 16).ok());
    let Some((index, sub)) = parsed else {
        bail!(
            "'{text}' is not an object; write index and sub-index in hex, such as 2010:3, or a name \
             from `omnibus param list`"
        );
    };
    let at = Address::new(index, sub);
    let known = OBJECTS.iter().find(|object| object.address == at);
    let Some(object) = known else {
        let of_record = OBJECTS
            .iter()
            .filter(|object| object.address.index == index);
        let of_record: Vec<_> = of_record
            .map(|object| format!("{} ({})", object.address, object.name))
            .collect();
        if communication::find(text).is_some() {
            bail!(
                "{at} ({}) is a communication object: `omnibus param get` reads it, and a general \
                 CANopen tool writes it (docs/omnibus.eds)",
                communication::name(at)?
            );
        }
        if of_record.is_empty() {
            bail!("there is no object {at}; `omnibus param list` shows all");
        }
        bail!(
            "there is no object {at}; {index:04X} has {}",
            of_record.join(", ")
        );
    };
    Ok(object)
}

/// A value of an object from its text, within the object's limits.
pub fn parse(object: &Object, text: &str) -> anyhow::Result<Value> {
    let name = sdo::name(object.address);
    let value = match object.kind {
        Kind::I16 => text.parse().ok().map(Value::I16),
        Kind::U8 => text.parse().ok().map(Value::U8),
        Kind::U16 => text.parse().ok().map(Value::U16),
        Kind::U32 => text.parse().ok().map(Value::U32),
        Kind::F32 => text.parse().ok().map(Value::F32),
        Kind::I24 => text.parse().ok().map(Value::I24),
        Kind::Domain => bail!("{name} is a block of bytes, which a group file or a dump holds"),
    };
    let range = format!(
        "{} to {} {}",
        sdo::show(object.min),
        sdo::show(object.max),
        object.unit
    );
    let range = range.trim_end();
    let Some(value) = value else {
        let kind = match object.kind {
            Kind::F32 => "number",
            _ => "whole number of this size",
        };
        bail!("{name}: '{text}' is not a {kind}; give {range}");
    };
    value
        .check(object.min, object.max)
        .map_err(|error| anyhow::anyhow!("{name} = {}: {error}; give {range}", sdo::show(value)))?;
    Ok(value)
}
