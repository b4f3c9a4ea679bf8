//! The master PC: drives a group of robots over one CAN bus.

pub mod abort;
pub mod adapter;
pub mod bus;
pub mod bus_load;
pub mod calibrate;
pub mod configure;
pub mod course;
pub mod curve;
pub mod drive;
pub mod error;
pub mod follow;
pub mod gyro;
pub mod hand_over;
pub mod identify;
mod json_lines;
pub mod link;
pub mod listen;
pub mod lss;
pub mod metrics;
pub mod odometry;
pub mod path_file;
pub mod pilot;
pub mod pose;
pub mod punctuality;
pub mod record;
pub mod recording;
pub mod report;
pub mod rollers;
pub mod sdo;
pub mod session;
pub mod sim_link;
pub mod steering;
pub mod survey;
pub mod telemetry;
pub mod together;
pub mod trial;
pub mod web;
pub mod wheel_test;
pub mod wire;

pub use session::Group;

#[cfg(test)]
mod fake;
