//! A virtual CAN bus, plants, and robots native or emulated.
#![forbid(unsafe_code)]

pub mod bus;
mod error;
pub mod motor;
pub mod plant;

pub use error::SimError;
