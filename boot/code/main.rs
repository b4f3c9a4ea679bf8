//! The boot code: the first thing that runs after a reset, in sector 0.
//!
//! # Theory of operation
//!
//! It reads what is known about the two slots, checks the image that is to be started and starts
//! it; if that image is not whole, the other one. Before an image on trial it notes the attempt and
//! starts the watchdog, so that a program that stops anywhere comes back here. It is done within
//! 5 ms: the checksum is computed by the chip's CRC unit at 84 MHz. With nothing to start it waits
//! for a programmer.
//!
//! Pins stay as the reset has left them, brake on and motor drivers off. RAM outside the first
//! 32 KiB, which is the image's stack and its own, stays as it is, because the record of the last
//! failure is in it. Registers are given back as after a reset.
//!
//! # Interface
//!
//! The records, in `omnibus_boot`; the table of [services] behind the vectors.
//!
//! # Limits
//!
//! The STM32F446 and the STM32F407 have the registers used here (RM0390 rev 6, RM0090 rev 19) at
//! the same addresses.
#![cfg_attr(target_os = "none", no_std, no_main)]

#[cfg(target_os = "none")]
mod chip;
#[cfg(target_os = "none")]
#[path = "../../src/board/memory.rs"]
mod memory;
#[cfg(target_os = "none")]
mod services;
#[cfg(target_os = "none")]
mod start;

/// Says what this is good for.
#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("This is a robot's boot code; the build of the firmware builds it.");
}
