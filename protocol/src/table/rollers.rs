//! Records with one object for each wheel, in the order front left, front right, rear left, rear
//! right: the rollers.

use super::record::{Record, byte, real};
use crate::address::Address;
use crate::object::{Kind, Object};

/// Declares records whose sub-indices are the four wheels; the address of an object is a function
/// of the wheel, 0 to 3.
macro_rules! of_wheels {
    ($list:ident: $($index:literal $record:literal {
        $name:ident: $make:ident($($arg:expr),*), $text:expr;
    })+) => {
        $(
            #[doc = concat!($record, ", ", stringify!($index), ".")]
            #[must_use]
            pub const fn $name(wheel: u8) -> Address {
                Address::new($index, wheel + 1)
            }
        )+

        pub(super) const $list: &[Record] = &[$(
            Record::new($index, $record, &[
                Object::$make($name(0), "Front left" $(, $arg)*, $text),
                Object::$make($name(1), "Front right" $(, $arg)*, $text),
                Object::$make($name(2), "Rear left" $(, $arg)*, $text),
                Object::$make($name(3), "Rear right" $(, $arg)*, $text),
            ])
        ),+];
    };
}

of_wheels! { PARAMETERS:
    0x2028 "Roller counts" {
        count: parameter("", byte(0, 64, 0)),
            "Rollers of this wheel, 3 at least; 0 computes with ideal rollers.";
    }
    0x2029 "Roller phases" {
        phase: parameter("rad", real(-1.048, 1.048, 0.0)),
            "How far the wheel has rolled on past the middle of its ground roller when its index \
             comes, once a turn of the wheel. From calibration.";
    }
}

of_wheels! { STATES:
    0x2114 "Roller states" {
        state: state("", Kind::U8),
            "0 ideal rollers; 1 the mean over a roller, index not seen yet; 2 the roller's angle; \
             3 the mean, the reference was wrong or has slipped.";
    }
    0x2115 "Roller angles" {
        sweep: state("rad", Kind::F32),
            "How far the wheel has rolled on past the middle of its ground roller now; true when \
             the state is 2.";
    }
}
