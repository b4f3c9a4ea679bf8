//! Observes a group and evaluates what it observes; nothing here sends a frame.
//!
//! [`listener`] makes a snapshot of the frames of a bus that another master drives. A session fills
//! [`rows`], one a SYNC period, and publishes [`telemetry`]; `common_frame` brings the members'
//! poses into one frame, [`odometry`] and [`average`] make the group's pose of them, and
//! [`metrics`] the errors of a drive.

pub mod average;
pub(crate) mod common_frame;
pub mod listener;
pub mod metrics;
pub mod odometry;
pub mod rows;
pub mod telemetry;
