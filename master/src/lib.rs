//! The master PC: drives a group of robots over one CAN bus.

pub mod metrics;
pub mod record;
pub mod report;
