//! What is an STM32F1's own, of the high-density chips (RM0008 rev 21; PM0075 rev 2 for the flash;
//! data sheet DS5792 rev 13): names that every family has. What a robot with this chip does without
//! is in `absent`.

use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::Pr;

use super::stm32::iwdg::Setting;

mod absent;
pub mod bxcan;
pub mod clocks;
pub mod flash;
#[cfg(feature = "bench")]
pub mod freeze;
pub mod gpio;
pub mod meters;
pub mod supply;
pub mod time;

pub use absent::{drives, gyro, program_flash, serial};

/// 512 counts of 4 LSI cycles: 51 ms at 40 kHz. DS5792 table 25: LSI has 30 to 60 kHz, so the reset
/// comes 34 to 68 ms after the last feeding.
pub const NORMAL: Setting = Setting {
    prescaler: Pr::DIVIDE_BY4,
    reload: 512 - 1,
};

/// LSI at its fastest, kHz, and typically, Hz.
pub const FASTEST_LSI_KHZ: u32 = 60;
pub const LSI_HZ: u32 = 40_000;

/// The longest write, a save: two sectors erased, 40 ms a page at most, and 2500 half-words
/// programmed, 70 us each at most (DS5792 table 29).
pub const LONGEST_ERASE_MS: u32 = 2 * 4 * 40 + 2_500 * 70 / 1_000;

/// Lets an external interrupt's line listen to a port; 0 is A (RM0008 9.4.3).
pub fn listen_to_port(line: usize, port: u8) {
    pac::AFIO
        .exticr(line / 4)
        .modify(|w| w.set_exti(line % 4, port));
}
