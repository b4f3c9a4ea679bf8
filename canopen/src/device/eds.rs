//! The communication objects of a device as sections of an electronic data sheet (CiA 306).
//!
//! A device made from the configuration is asked which objects it has, and for their types, access
//! and defaults, so a sheet cannot differ from the device that it describes. This file adds what no
//! device knows: the names that CiA 301 gives them, and which of them it calls an array.
//!
//! The caller writes the head of the sheet, up to `[MandatoryObjects]`, and the objects of its
//! application, from `[ManufacturerObjects]` on.

use core::fmt::{Error, Result, Write};

use super::Device;
use super::objects::Value;
use crate::{AbortCode, Config, NodeId};

/// Objects that every device must have (CiA 301, 7.5.1).
const MANDATORY: [u16; 3] = [0x1000, 0x1001, 0x1018];

/// Objects that CiA 301 defines as an ARRAY; all others with sub-indices are a RECORD.
const ARRAYS: [u16; 5] = [0x1003, 0x1010, 0x1011, 0x1016, 0x1029];

/// Different for each device, so that a sheet cannot have it.
const SERIAL: (u16, u8) = (0x1018, 4);

/// A device with this configuration, but for the node-ID. What two nodes differ in by as much as
/// their numbers follows the node-ID.
struct Twins {
    first: Device,
    second: Device,
}

/// One entry of an object.
struct Entry {
    index: u16,
    sub: u8,
    /// Of a new device. `None` for an entry that is empty then.
    value: Option<Value>,
    /// Whether the value is the node-ID and a constant.
    follows_node: bool,
}

/// Writes the lists of mandatory and of optional objects, each with its objects. The list of
/// optional objects ends with `others`, which the application has in this range; the caller writes
/// these.
///
/// ```
/// use canopen::{CobId, Config, PdoConfig};
///
/// const STATUS: PdoConfig = PdoConfig { cob_id: CobId::PlusNode(0x180), ..PdoConfig::DEFAULT };
/// let config = Config { heartbeat_ms: 100, tpdos: &[STATUS], ..Config::DEFAULT };
/// let mut sheet = String::new();
/// canopen::eds::communication_objects(&mut sheet, &config, &[0x1F50])?;
///
/// let section = |name| sheet.split("\n[").find_map(|text| text.strip_prefix(name));
/// let heartbeat = section("1017]\n").expect("every device has 0x1017");
/// assert!(heartbeat.contains("DataType=0x0006\nAccessType=rw\nDefaultValue=100\n"));
/// let cob_id = section("1800sub1]\n").expect("there is one TPDO");
/// assert!(cob_id.contains("DefaultValue=$NODEID+0x180\n"));
/// assert!(section("1801sub1]\n").is_none() && section("1010]\n").is_none());
/// # Ok::<(), std::fmt::Error>(())
/// ```
///
/// # Errors
/// Those of the writer, and an object of the device without a name in this file.
pub fn communication_objects(out: &mut impl Write, config: &Config, others: &[u16]) -> Result {
    let with_node = |node| Config { node, ..*config };
    let twins = Twins {
        first: Device::new(with_node(Some(NodeId::MIN))),
        second: Device::new(with_node(NodeId::new(NodeId::MIN.get() + 1))),
    };
    for (section, mandatory) in [("MandatoryObjects", true), ("OptionalObjects", false)] {
        let objects = (0x1000..0x2000)
            .filter(|index| MANDATORY.contains(index) == mandatory)
            .filter(|index| twins.first.core.own(*index, 0).is_some());
        let others = if mandatory { &[] } else { others };
        let count = objects.clone().count().saturating_add(others.len());
        writeln!(out, "[{section}]")?;
        writeln!(out, "SupportedObjects={count}")?;
        let listed = objects.clone().chain(others.iter().copied());
        for (number, index) in (1..).zip(listed) {
            let number: u16 = number;
            writeln!(out, "{number}=0x{index:04X}")?;
        }
        writeln!(out)?;
        for index in objects {
            object(out, &twins, index)?;
        }
    }
    Ok(())
}

impl Twins {
    fn entry(&self, index: u16, sub: u8) -> Option<Entry> {
        let value = match self.first.core.own(index, sub)? {
            Ok(value) => Some(value),
            Err(AbortCode::NoData) => None,
            Err(_) => return None,
        };
        let other = self.second.core.own(index, sub);
        let follows_node = match (&value, other) {
            (Some(Value::Number { value, .. }), Some(Ok(Value::Number { value: other, .. }))) => {
                *value != other
            }
            _ => false,
        };
        Some(Entry {
            index,
            sub,
            value,
            follows_node,
        })
    }
}

fn object(out: &mut impl Write, twins: &Twins, index: u16) -> Result {
    let entries = (0..=u8::MAX).filter_map(|sub| twins.entry(index, sub));
    let count = entries.clone().count();
    if count > 1 {
        write!(out, "[{index:04X}]\nParameterName=")?;
        name_of_object(out, index)?;
        let kind = if ARRAYS.contains(&index) { 8 } else { 9 };
        writeln!(out, "\nObjectType=0x{kind}\nSubNumber={count}\n")?;
    }
    for entry in entries {
        if count > 1 {
            write!(out, "[{index:04X}sub{:X}]\nParameterName=", entry.sub)?;
            name_of_entry(out, index, entry.sub)?;
        } else {
            write!(out, "[{index:04X}]\nParameterName=")?;
            name_of_object(out, index)?;
        }
        entry.describe(out, count > 1)?;
    }
    Ok(())
}

impl Entry {
    fn describe(&self, out: &mut impl Write, of_several: bool) -> Result {
        let (kind, access) = match self.value {
            Some(Value::Number { len, writable, .. }) => (
                match len {
                    1 => 5,
                    2 => 6,
                    _ => 7,
                },
                match writable {
                    true => "rw",
                    false if of_several && self.sub == 0 => "const",
                    false => "ro",
                },
            ),
            Some(Value::Text(_)) => (9, "const"),
            None => (7, "ro"),
        };
        write!(
            out,
            "\nObjectType=0x7\nDataType=0x{kind:04X}\nAccessType={access}\nDefaultValue="
        )?;
        self.default(out)?;
        writeln!(out, "\nPDOMapping=0\n")
    }

    fn default(&self, out: &mut impl Write) -> Result {
        match self.value {
            _ if (self.index, self.sub) == SERIAL => Ok(()),
            Some(Value::Number { value, .. }) if self.follows_node => {
                let base = value.saturating_sub(u32::from(NodeId::MIN.get()));
                write!(out, "$NODEID+0x{base:X}")
            }
            Some(Value::Number { value, len: 4, .. }) if value > 9 => write!(out, "0x{value:X}"),
            Some(Value::Number { value, .. }) => write!(out, "{value}"),
            Some(Value::Text(text)) => out.write_str(text),
            None => Ok(()),
        }
    }
}

/// Writes the name that CiA 301 gives to a communication object, and to the entry in it where it
/// has several.
///
/// ```
/// let mut name = String::new();
/// canopen::eds::name(&mut name, 0x1018, 4)?;
/// assert_eq!(name, "Identity: Serial number");
/// # Ok::<(), std::fmt::Error>(())
/// ```
///
/// # Errors
/// Those of the writer, and for an object without a name in this file.
pub fn name(out: &mut impl Write, index: u16, sub: u8) -> Result {
    name_of_object(out, index)?;
    let several = ARRAYS.contains(&index) || matches!(index, 0x1018 | 0x1400..0x1C00);
    match (several, sub) {
        (true, _) => {
            out.write_str(": ")?;
            name_of_entry(out, index, sub)
        }
        (false, 0) => Ok(()),
        (false, _) => Err(Error),
    }
}

fn name_of_object(out: &mut impl Write, index: u16) -> Result {
    let (kind, number, what) = match index {
        0x1400..0x1600 => ("RPDO", index - 0x13FF, "communication"),
        0x1600..0x1800 => ("RPDO", index - 0x15FF, "mapping"),
        0x1800..0x1A00 => ("TPDO", index - 0x17FF, "communication"),
        0x1A00..0x1C00 => ("TPDO", index - 0x19FF, "mapping"),
        _ => return out.write_str(name_of_single(index).ok_or(Error)?),
    };
    write!(out, "{kind}{number} {what} parameter")
}

const fn name_of_single(index: u16) -> Option<&'static str> {
    Some(match index {
        0x1000 => "Device type",
        0x1001 => "Error register",
        0x1003 => "Pre-defined error field",
        0x1005 => "COB-ID SYNC",
        0x1006 => "Communication cycle period",
        0x1007 => "Synchronous window length",
        0x1008 => "Manufacturer device name",
        0x1009 => "Manufacturer hardware version",
        0x100A => "Manufacturer software version",
        0x1010 => "Store parameters",
        0x1011 => "Restore default parameters",
        0x1014 => "COB-ID EMCY",
        0x1015 => "Inhibit time EMCY",
        0x1016 => "Consumer heartbeat time",
        0x1017 => "Producer heartbeat time",
        0x1018 => "Identity",
        0x1019 => "Synchronous counter overflow value",
        0x1029 => "Error behaviour",
        0x1F80 => "NMT startup",
        _ => return None,
    })
}

fn name_of_entry(out: &mut impl Write, index: u16, sub: u8) -> Result {
    out.write_str(match (index, sub) {
        (0x1003, 0) => "Number of errors",
        (0x1003, 1) => "Newest error",
        (0x1003, _) => return write!(out, "Error {sub}"),
        (0x1600..0x1800 | 0x1A00..0x1C00, 0) => "Number of mapped objects",
        (0x1600..0x1800 | 0x1A00..0x1C00, _) => return write!(out, "Mapped object {sub}"),
        (_, 0) => "Highest sub-index supported",
        (0x1010, 1) => "Save all parameters",
        (0x1010, 2) => "Save communication parameters",
        (0x1010, 3) => "Save application parameters",
        (0x1011, 1) => "Restore all default parameters",
        (0x1011, 2) => "Restore communication default parameters",
        (0x1011, 3) => "Restore application default parameters",
        (0x1016, _) => return write!(out, "Consumer heartbeat time {sub}"),
        (0x1018, 1) => "Vendor-ID",
        (0x1018, 2) => "Product code",
        (0x1018, 3) => "Revision number",
        (0x1018, 4) => "Serial number",
        (0x1029, 1) => "Communication error",
        (0x1400.., 1) => "COB-ID",
        (0x1400.., 2) => "Transmission type",
        (0x1400.., 3) => "Inhibit time",
        (0x1400.., 5) => "Event timer",
        (0x1400.., 6) => "SYNC start value",
        _ => return Err(Error),
    })
}
