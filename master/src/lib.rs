//! The master PC: drives a group of robots over one CAN bus.
//!
//! | room | what is in it |
//! |---|---|
//! | [`bus`] | how a bus is named, opened and paced: adapters, the [`bus::link::Link`] they all are, the load |
//! | [`session`] | [`Group`]: one master and its robots, from finding them to the SYNC that moves them |
//! | [`monitor`] | what is heard of a group: snapshots, telemetry, rows, and the errors worked out from them |
//! | [`path`] | what can be driven: curves by name or from a file, and how measured poses correct a drive |
//! | [`run`] | one whole drive along a path, on any bus |
//! | [`commission`], [`accept`] | finding, numbering, testing, calibrating and accepting robots |
//! | [`source`] | poses and yaw rates that come from outside as JSON lines |
//! | [`recording`] | files of everything on a bus, and what is made of them |
//! | [`mod@file`] | files that are never half a file |
//! | [`report`] | what a drive came to, as table, JSON and HTML |
//! | [`bridge`] | programs of your own drive a group and see it, by lines of JSON; Foxglove |
//! | [`controls`] | who may drive: the one place for page, keyboard, bridge, ROS 2 and fleets |
//! | [`serve`], [`pilot`] | the page, and the thread that drives for it and for the live view |
//! | `vda5050` | a group as one vehicle of a fleet control; the cargo feature of that name |
//! | [`ros`] | the group as a robot of ROS 2; its node is the cargo feature of that name |
//! | `simulation` | a simulated world as a bus; the cargo feature of that name, on by default |

pub mod abort;
pub mod accept;
#[cfg(all(feature = "server", feature = "recording"))]
pub mod bridge;
pub mod bus;
pub mod commission;
pub mod controls;
pub mod error;
pub mod file;
pub mod monitor;
pub mod path;
pub mod pilot;
#[cfg(feature = "recording")]
pub mod recording;
pub mod report;
#[cfg(feature = "recording")]
pub mod ros;
pub mod run;
pub mod serve;
pub mod session;
#[cfg(feature = "simulation")]
pub mod simulation;
pub mod source;
#[cfg(feature = "vda5050")]
pub mod vda5050;

pub use session::Group;
// What a program of one's own needs besides, so that this library alone suffices.
pub use {canopen, group, kinematics, protocol};

#[cfg(test)]
mod fake;
