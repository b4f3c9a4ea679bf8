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

/// How many transferred steps of this unit are one in SI, and the SI unit.
fn scale(unit: &str) -> (f64, &'static str) {
    match unit {
        "0.1 mm/s" => (10_000.0, "m/s"),
        "rad/s" => (1.0, "rad/s"),
        "0.1 mrad/s" => (10_000.0, "rad/s"),
        "2 mrad/s" => (500.0, "rad/s"),
        "20 mrad/s" => (50.0, "rad/s"),
        "0.1 mm" => (10_000.0, "m"),
        "0.1 mrad" => (10_000.0, "rad"),
        "1/65535" => (65_535.0, ""),
        _ => (1.0, ""),
    }
}
