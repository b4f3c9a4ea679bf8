//! CAN frames as text, each form once: [`slcan`] (serial adapters), [`socketcand`] (a CAN interface
//! over TCP) and [`candump`] (logs).
//!
//! Pure functions and small parsers, without I/O and without an allocator: the firmware, the
//! master's adapters, the simulator's endpoints and the readers of logs share them. Every form
//! carries more than a [`Frame`](canopen::Frame), which is a classic data frame with an 11-bit
//! identifier; what else a text may hold (extended, remote, CAN FD and error frames) is told apart
//! from nonsense and reported as foreign, never cut down to a frame.
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

pub mod candump;
mod hex;
pub mod slcan;
pub mod socketcand;
