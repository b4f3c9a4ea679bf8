//! What is an STM32G4's own, of the chips with 512 KiB (category 3), as far as a sketch needs it:
//! names that every family has.
//!
//! # Sources
//!
//! RM0440 rev 4 (sections 2.4 and 6.2.2 alone were at hand), and for all else the registers as
//! `stm32-metapac` has them and the clocks as `embassy-stm32` has them, both made from ST's own
//! files. The data sheet, DS12288, was not at hand.

use embassy_stm32::pac::iwdg::vals::Pr;

use super::stm32::iwdg::Setting;

pub mod clocks;
pub mod gpio;
pub mod supply;
pub mod time;

/// 400 counts of 4 LSI cycles: 50 ms at 32 kHz.
pub const NORMAL: Setting = Setting {
    prescaler: Pr::DIVIDE_BY4,
    reload: 400 - 1,
};

/// LSI at its fastest, kHz, and typically, Hz: 5 % apart, by the chip's product page. Its table of
/// tolerances was not at hand.
pub const FASTEST_LSI_KHZ: u32 = 34;
pub const LSI_HZ: u32 = 32_000;

/// The shortest that can be said: a sketch erases nothing.
pub const LONGEST_ERASE_MS: u32 = 1;
