//! Boards that run a few instructions assembled by hand: what needs a core and not only registers.
//!
//! [`code::Code`] knows the handful of encodings that are used (ARMv7-M Architecture Reference
//! Manual, section A7.7).

mod blocks;
mod code;
mod core;
mod exceptions;
mod f103;
mod peripherals;
