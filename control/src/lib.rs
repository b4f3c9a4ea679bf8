//! The code that a robot runs a thousand times a second: from encoder counts and a command to
//! duties.
//!
//! It is the control side of a robot, in a crate of its own because it is built for speed and the
//! bus side (`robot`) for size: Cargo sets the optimisation level per package. It uses the
//! configuration, not the parameters from which the configuration is built.
//!
//! It does not read a clock, allocate, log, or access hardware.
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

pub mod brake;
pub mod clock;
pub mod compensation;
pub mod configuration;
pub mod current;
pub mod drivetrain;
pub mod gyro;
pub mod interface;
pub mod limiter;
pub mod math;
pub mod observer;
pub mod odometry;
pub mod output_stage;
pub mod quantity;
pub mod rollers;
pub mod setpoint;
mod silence;
pub mod smart_drive;
pub mod supply;
pub mod threshold;
pub mod tick;
pub mod time;
pub mod twist;
mod watch;
pub mod wheel;
pub mod wheel_drive;
