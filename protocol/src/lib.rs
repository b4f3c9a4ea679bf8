//! What Omnibus says on the CAN bus, in one place for robot, simulator and master.
//!
//! Four kinds of thing live here and no behaviour at all:
//!
//! - [`pdo`]: the eight bytes of every process data frame, with their scaling. Encoding saturates
//!   and rounds to nearest; a value that is not a number becomes the reserved "invalid" pattern;
//!   decoding refuses a wrong length, an unknown state and an invalid value by name.
//! - [`table`]: one declaration per object of the dictionary. The robot's dictionary, the EDS, the
//!   protocol page and the master's parameter list are all made from it.
//! - [`timing`]: times that both ends of the bus go by.
//! - [`code`]: the numbers of limits (active but moving) and faults (latched, outputs off).
//!
//! The bytes are versioned by [`WIRE_VERSION`], which is itself an object: a master reads it before
//! it starts anything.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    deny(
        clippy::unwrap_used,
        clippy::expect_used,
        clippy::panic,
        clippy::unreachable,
        clippy::indexing_slicing,
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss
    )
)]

#[cfg(test)]
extern crate std;

pub mod address;
pub mod cob;
pub mod code;
pub mod compensation;
mod crc;
pub mod generate;
mod gyro;
pub mod object;
pub mod pdo;
pub mod pdos;
mod plan;
mod report;
pub mod scaling;
pub mod self_test;
mod stored_fault;
pub mod table;
pub mod timing;

pub use address::Address;
pub use code::{Code, Fault, Limit, Reaction};
pub use compensation::CompensationSet;
pub use crc::crc32;
pub use gyro::GyroState;
pub use object::{Access, Kind, Object, Value};
pub use pdo::{
    DecodeError, GroupTwist, MeasuredTwist, MemberState, MemberStatus, PoseReport, Scale,
    WheelRateReport, YawRateReport,
};
pub use plan::Plan;
pub use report::RobotReport;
pub use stored_fault::StoredFault;
pub use table::{ENTRIES, Entry, OBJECTS, RECORDS, entry};

/// Version of every byte layout and object meaning in this crate. It goes up by one with any
/// change that would make an older master or robot misread a frame.
pub const WIRE_VERSION: u16 = 6;

/// Product code of a robot, object 0x1018:2: "INMO" as bytes from the lowest.
pub const PRODUCT: u32 = 0x4F4D_4E49;

/// Device name of a robot, object 0x1008.
pub const NAME: &str = "Omnibus robot";

/// Node number of the master.
pub const MASTER: u8 = 1;

/// Lowest node number of a robot.
pub const FIRST_ROBOT: u8 = 2;

/// Highest node number of a robot.
pub const LAST_ROBOT: u8 = 17;

/// Robots that fit on one bus.
pub const MAX_ROBOTS: usize = 16;

/// Every bit that may be set in a member mask: bit *n* stands for node *n*, robots are 2 to 17.
pub const MEMBER_MASK: u32 = 0x0003_FFFC;

/// True for a node number a robot may have.
#[must_use]
pub const fn is_robot(node: u8) -> bool {
    node >= FIRST_ROBOT && node <= LAST_ROBOT
}
