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
mod lock;
mod motors;
mod process;
mod record;
pub mod rollers;
mod update;
pub(crate) mod wheels;

use crate::address::{self as at, Address};

pub use entries::{
    COUNT, ENTRIES, Entry, OBJECTS, PARAMETERS, PROFILE_OBJECTS, RECORDS, entry, highest_sub,
};

/// Addresses by name.
pub(crate) mod names {
    pub use super::commissioning::*;
    pub use super::diagnostics::*;
    pub use super::geometry::*;
    pub use super::group::*;
    pub use super::identity::*;
    pub use super::limits::*;
    pub use super::lock::*;
    pub use super::motors::*;
    pub use super::process::*;
    pub use super::update::*;
}

/// The parameters that must be equal in all members of a group.
pub const COMMON: &[Address] = &[
    at::ACCELERATION,
    at::ACCELERATION_YAW,
    at::JERK,
    at::JERK_YAW,
    at::DECELERATION,
    at::DECELERATION_YAW,
    at::SPEED_MAX,
    at::YAW_RATE_MAX,
    at::GROUP_ID,
    at::MEMBERS,
    at::SYNC_PERIOD,
    at::SYNC_TIMEOUT,
    at::SETPOINT_TIMEOUT,
    at::HEARTBEAT_TIMEOUT,
    at::AGREEMENT_DELAY,
    at::STANDSTILL_SYNCS,
    at::CUTS_TOGETHER,
    at::BRAKE_RELEASE,
];
