//! One robot of a group, without I/O: the same code in the firmware and in a simulated robot.
//!
//! # Theory of operation
//!
//! A robot is two machines that run at different rates and share two small values:
//!
//! ```text
//!  frames --> BusSide --- Command ---> ControlSide --> Outputs (duty, drivers, brake)
//!  frames <--         <--- Report ----             <-- Inputs (counts, stop, supply)
//! ```
//!
//! The [`BusSide`] is driven by frames and deadlines: CANopen device, object dictionary, state
//! machine, agreement with the other members. The [`ControlSide`](control::tick::ControlSide) is driven by a 1 kHz tick:
//! measurement, limits, wheel loops, and every decision about the outputs. Between them pass a
//! [`Command`](control::interface::Command), a [`Report`](control::interface::Report) and, at a
//! start, a [`Configuration`](control::configuration::Configuration); all are `Copy`. Time is an
//! argument everywhere, so a robot also runs in virtual time.
//!
//! From a group twist to a duty:
//!
//! ```text
//!  latched at SYNC k -> x smallest scale of all members, a little later -> line over one period
//!  -> acceleration and jerk limits -> J C K -> wheel rates -> feedforward + PI -> duty
//!  `---------------- the same in every member ----------------'
//! ```
//!
//! # Limits
//!
//! This crate has no clock, allocator or logger, and does not access hardware; only the copy of a
//! robot (feature `copies`) takes memory from an allocator.
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

#[cfg(feature = "copies")]
extern crate alloc;
#[cfg(test)]
extern crate std;

pub mod agreement;
mod application;
mod bus_side;
mod can;
mod compensation;
pub mod configuration;
mod counters;
mod event;
mod fault_memory;
mod hardware;
mod history;
mod identity;
mod interlock;
pub mod lock;
pub mod parameters;
pub mod record_store;
pub mod rhythm;
pub mod sequence;
pub mod state;
mod store;
mod strain;
pub mod update;

pub use bus_side::BusSide;
pub use can::CanErrors;
pub use configuration::ConfigurationError;
pub use counters::{CableLosses, Counters, StoreWear};
pub use event::Event;
pub use fault_memory::Memorable;
pub use hardware::Hardware;
pub use identity::Identity;
pub use parameters::Parameters;
pub use state::State;
pub use store::{IMAGE_MAX, Stored, stored_node};

#[cfg(test)]
mod tests;
