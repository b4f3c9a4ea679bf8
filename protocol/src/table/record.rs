//! How a record is written down.

use crate::object::{Object, Value};

/// The objects at one index, and its name for EDS and protocol page.
pub(crate) struct Record {
    pub index: u16,
    pub name: &'static str,
    pub objects: &'static [Object],
}

impl Record {
    pub const fn new(index: u16, name: &'static str, objects: &'static [Object]) -> Self {
        Self {
            index,
            name,
            objects,
        }
    }
}

/// Declares records, and an address by name for each of their objects. An object is its name, its
/// sub-index, a constructor of [`Object`] with title, unit and what else it takes, and a text.
macro_rules! records {
    ($list:ident: $($index:literal $record:literal {
        $($name:ident = $sub:literal: $make:ident($title:literal $(, $arg:expr)*), $text:expr;)+
    })+) => {
        $($(
            #[doc = concat!($title, ", ", stringify!($index), ":", stringify!($sub), ".")]
            pub const $name: Address = Address::new($index, $sub);
        )+)+

        pub(super) const $list: &[Record] = &[$(
            Record::new($index, $record, &[
                $(Object::$make($name, $title $(, $arg)*, $text)),+
            ])
        ),+];
    };
}
pub(super) use records;

/// Limits and default of a REAL32.
pub(super) const fn real(min: f32, max: f32, default: f32) -> [Value; 3] {
    [Value::F32(min), Value::F32(max), Value::F32(default)]
}

/// Limits and default of an UNSIGNED8.
pub(super) const fn byte(min: u8, max: u8, default: u8) -> [Value; 3] {
    [Value::U8(min), Value::U8(max), Value::U8(default)]
}

/// Limits and default of an UNSIGNED16.
pub(super) const fn word(min: u16, max: u16, default: u16) -> [Value; 3] {
    [Value::U16(min), Value::U16(max), Value::U16(default)]
}

/// Limits and default of an UNSIGNED32.
pub(super) const fn long(min: u32, max: u32, default: u32) -> [Value; 3] {
    [Value::U32(min), Value::U32(max), Value::U32(default)]
}
