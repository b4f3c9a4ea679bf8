//! The histories: the last eight faults and limits; sub-index 1 is the newest.

use super::record::Record;
use crate::address::Address;
use crate::object::{Kind, Object};

/// Faults, and limits, that are remembered.
pub const DEPTH: u8 = 8;

/// Declares records whose sub-indices are the last eight, the newest first; the address of an
/// object is a function of `nth`, 1 to 8.
macro_rules! newest_first {
    ($(
        $index:literal $record:literal { $name:ident: $unit:literal, $kind:expr, $text:expr; }
    )+) => {
        $(
            #[doc = concat!($record, ", ", stringify!($index), "; 1 is the newest.")]
            #[must_use]
            pub const fn $name(nth: u8) -> Address {
                Address::new($index, nth)
            }
        )+

        pub(super) const RECORDS: &[Record] = &[$(
            Record::new($index, $record, &[
                Object::state($name(1), "Newest", $unit, $kind, $text),
                Object::state($name(2), "Second", $unit, $kind, $text),
                Object::state($name(3), "Third", $unit, $kind, $text),
                Object::state($name(4), "Fourth", $unit, $kind, $text),
                Object::state($name(5), "Fifth", $unit, $kind, $text),
                Object::state($name(6), "Sixth", $unit, $kind, $text),
                Object::state($name(7), "Seventh", $unit, $kind, $text),
                Object::state($name(8), "Eighth", $unit, $kind, $text),
            ])
        ),+];
    };
}

newest_first! {
    0x2122 "Fault codes" {
        code: "", Kind::U16, "Fault code; 0 when there was none.";
    }
    0x2123 "Fault times" {
        time: "ms", Kind::U32, "When that fault appeared, since the robot started.";
    }
    0x2124 "Limit codes" {
        limit_code: "", Kind::U16, "Limit code; 0 when there was none.";
    }
    0x2125 "Limit times" {
        limit_time: "ms", Kind::U32, "When that limit became active, since the robot started.";
    }
}
