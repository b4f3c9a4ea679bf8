//! What a robot does a thousand times a second: from encoder counts and a wish to duties.
//!
//! One half of `robot`, in a crate of its own because it is built for speed and the other half for
//! size: Cargo sets the optimisation by package. It knows the configuration that drives it, not the
//! parameters it came from.
//!
//! It cannot tell the time, allocate, log, or touch hardware.
#![no_std]
#![forbid(unsafe_code)]
#![cfg_attr(
    not(test),
    warn(
        clippy::unwrap_used,
        clippy::indexing_slicing,
        clippy::cast_possible_truncation
    )
)]

#[cfg(test)]
extern crate std;

pub mod brake;
pub mod clock;
pub mod configuration;
pub mod current;
pub mod drivetrain;
pub mod identification;
pub mod interface;
pub mod limiter;
pub mod math;
pub mod observer;
pub mod rollers;
pub mod setpoint;
mod silence;
pub mod supply;
pub mod threshold;
pub mod tick;
pub mod time;
mod watch;
pub mod wheel;
