//! What is an STM32F4's own: names that every family has, and drivers of what only this one has.

use embassy_stm32::pac;
use embassy_stm32::pac::iwdg::vals::Pr;

use super::stm32::iwdg::Setting;

pub mod bxcan;
pub mod clocks;
pub mod drives;
pub mod flash;
#[cfg(feature = "bench")]
pub mod freeze;
pub mod gpio;
pub mod gyro;
pub mod meters;
#[cfg(feature = "self-test")]
pub mod probe;
pub mod program_flash;
pub mod serial;
pub mod supply;
pub mod time;

/// 400 counts of 4 LSI cycles: 50 ms at 32 kHz. DS10693 rev 10, table 42: LSI has 17 to 47 kHz, so
/// the reset comes 34 to 94 ms after the last feeding.
pub const NORMAL: Setting = Setting {
    prescaler: Pr::DIVIDE_BY4,
    reload: 400 - 1,
};

/// LSI at its fastest, kHz, and typically, Hz.
pub const FASTEST_LSI_KHZ: u32 = 47;
pub const LSI_HZ: u32 = 32_000;

/// The longest erase: 128 KiB at 32 bits (DS10693 rev 10, table 49).
pub const LONGEST_ERASE_MS: u32 = 2_000;

/// Lets an external interrupt's line listen to a port; 0 is A (RM0390 rev 6, 8.2.5 and 8.2.6).
pub fn listen_to_port(line: usize, port: u8) {
    pac::SYSCFG
        .exticr(line / 4)
        .modify(|w| w.set_exti(line % 4, port));
}
