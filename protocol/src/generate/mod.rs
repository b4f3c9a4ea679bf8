//! What is made from the object table: the protocol page, the EDS, the DBC.
//!
//! Each function writes to anything that takes text, so none of this needs an allocator, and
//! nothing of it is linked into a robot that does not call it. The copies in `docs/` are compared
//! with the output by a test; `OMNIBUS_WRITE_DOCS=1 cargo test -p omnibus-protocol` renews them.

mod dbc;
mod eds;
mod page;

pub use dbc::dbc;
pub use eds::eds;
pub use page::page;

use core::fmt;

use crate::object::Value;

/// A value as people write it.
struct Shown(Value);

impl fmt::Display for Shown {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Value::I16(value) => write!(f, "{value}"),
            Value::U8(value) => write!(f, "{value}"),
            Value::U16(value) => write!(f, "{value}"),
            Value::U32(value) => write!(f, "{value}"),
            Value::F32(value) => write!(f, "{value}"),
            Value::I24(value) => write!(f, "{value}"),
            Value::Domain => Ok(()),
        }
    }
}

/// What a transferred step of this unit is in SI.
fn scale(unit: &str) -> (&'static str, &'static str) {
    match unit {
        "0.1 mm/s" => ("0.0001", "m/s"),
        "0.1 mrad/s" => ("0.0001", "rad/s"),
        "2 mrad/s" => ("0.002", "rad/s"),
        "20 mrad/s" => ("0.02", "rad/s"),
        "0.1 mm" => ("0.0001", "m"),
        "0.1 mrad" => ("0.0001", "rad"),
        "1/65535" => ("0.0000152590219", ""),
        _ => ("1", ""),
    }
}
