//! Measurements that come from outside the bus, as JSON lines over TCP: [`pose`]s of the robots and
//! [`gyro`] rates.

pub mod gyro;
mod json_lines;
pub mod pose;
