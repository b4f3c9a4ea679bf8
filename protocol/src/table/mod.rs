//! Every object of a robot beyond the communication profile, declared once: index, sub-index, type,
//! access, limits, default, unit and text.
//!
//! An object stands in its record, in the file of its subject. From this one declaration come its
//! address by name ([`crate::address`]), the robot's run-time table ([`ENTRIES`]), EDS, DBC and
//! protocol page, the mapping of the PDOs, and the master's list of parameters. A parameter needs
//! nothing else. An object that is no parameter is answered in the robot's `application::objects`.
//!
//! A parameter marked *required* has a default only so that it can be read: the robot refuses to
//! enable its drivers until it has been written. A parameter is checked against its limits when it
//! is written, and the whole set once more, as a set, when the robot is started; object 0x2002:1
//! says then what is wrong.

mod commissioning;
mod diagnostics;
mod entries;
mod geometry;
mod group;
pub mod history;
mod identity;
mod limits;
mod motors;
mod process;
pub mod rollers;
pub(crate) mod wheels;

use crate::address::{self as at, Address};
use crate::object::{Object, Value};

pub(crate) use entries::range;
pub use entries::{COUNT, ENTRIES, OBJECTS, PARAMETERS, RECORDS, entry, highest_sub};

/// Addresses by name.
pub(crate) mod names {
    pub use super::commissioning::*;
    pub use super::diagnostics::*;
    pub use super::geometry::*;
    pub use super::group::*;
    pub use super::identity::*;
    pub use super::limits::*;
    pub use super::motors::*;
    pub use super::process::*;
}

/// The objects at one index, and its name for EDS and protocol page.
pub(crate) struct Record {
    index: u16,
    name: &'static str,
    objects: &'static [Object],
}

impl Record {
    const fn new(index: u16, name: &'static str, objects: &'static [Object]) -> Self {
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
use records;

/// All records, by rising index.
const PARTS: &[&[Record]] = &[
    identity::IDENTITY_RECORDS,
    geometry::ROBOT_RECORDS,
    wheels::wheel::RECORDS,
    geometry::DRIVE_RECORDS,
    motors::WHEELS_RECORDS,
    wheels::motor::RECORDS,
    motors::SUPPLY_RECORDS,
    motors::TORQUE_RECORDS,
    motors::OUTPUT_STAGE_RECORDS,
    rollers::PARAMETERS,
    motors::ROLLER_REFERENCE_RECORDS,
    motors::ENCODER_INPUTS_RECORDS,
    limits::LIMITS_RECORDS,
    group::GROUP_RECORDS,
    commissioning::COMMISSIONING_RECORDS,
    commissioning::IDENTIFICATION_RECORDS,
    wheels::identified::RECORDS,
    commissioning::BLINK_RECORDS,
    process::SETPOINT_RECORDS,
    process::ALONE_RECORDS,
    process::STATUS_RECORDS,
    process::MEASURED_RECORDS,
    process::POSE_RECORDS,
    process::RATES_RECORDS,
    rollers::STATES,
    diagnostics::DIAGNOSTICS_RECORDS,
    history::RECORDS,
    diagnostics::STORE_RECORDS,
    diagnostics::POWER_RECORDS,
    diagnostics::FAULT_MEMORY_RECORDS,
    diagnostics::CAN_RECORDS,
];

/// The parameters that must be equal in all members of a group.
pub const COMMON: &[Address] = &[
    at::ACCELERATION,
    at::ACCELERATION_YAW,
    at::JERK,
    at::JERK_YAW,
    at::DECELERATION,
    at::DECELERATION_YAW,
    at::GROUP_ID,
    at::MEMBERS,
    at::SYNC_PERIOD,
    at::SYNC_TIMEOUT,
    at::SETPOINT_TIMEOUT,
    at::HEARTBEAT_TIMEOUT,
    at::STANDSTILL_SYNCS,
    at::CUTS_TOGETHER,
    at::BRAKE_RELEASE,
];

/// Limits and default of a REAL32.
const fn real(min: f32, max: f32, default: f32) -> [Value; 3] {
    [Value::F32(min), Value::F32(max), Value::F32(default)]
}

/// Limits and default of an UNSIGNED8.
const fn byte(min: u8, max: u8, default: u8) -> [Value; 3] {
    [Value::U8(min), Value::U8(max), Value::U8(default)]
}

/// Limits and default of an UNSIGNED16.
const fn word(min: u16, max: u16, default: u16) -> [Value; 3] {
    [Value::U16(min), Value::U16(max), Value::U16(default)]
}

/// Limits and default of an UNSIGNED32.
const fn long(min: u32, max: u32, default: u32) -> [Value; 3] {
    [Value::U32(min), Value::U32(max), Value::U32(default)]
}
