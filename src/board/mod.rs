//! The board: the only place that knows the microcontroller, its pins and its registers.
//!
//! A board is one file that builds [`Board`] from the chip's peripherals; this one is the
//! NUCLEO-F446RE. The other files are what boards with this chip family share: the CAN controller,
//! the motor outputs, the way into the safe state, the two executors. Nothing here decides anything
//! about a robot.

pub mod can;
pub mod executors;
pub mod flash;
#[cfg(feature = "bench")]
mod freeze;
pub mod index;
pub mod iwdg;
mod memory;
mod nucleo_f446re;
pub mod outputs;
pub mod post_mortem;
pub mod power;
mod safe_state;
pub mod stack;
pub mod tick;

pub use nucleo_f446re::{Board, Encoders, Lines, Meters, ResetCause, now};
