//! The master PC: drives a group of robots over one CAN bus.

pub mod abort;
pub mod adapter;
pub mod bus;
pub mod configure;
pub mod curve;
pub mod drive;
pub mod error;
pub mod follow;
pub mod link;
pub mod metrics;
pub mod odometry;
pub mod record;
pub mod report;
pub mod sdo;
pub mod session;
pub mod sim_link;
pub mod wire;

#[cfg(test)]
mod fake;
#[cfg(test)]
mod session_tests;
