//! The local time of an STM32F4: the HAL's, by TIM9.

use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_time::Instant;

/// Microseconds since the start.
pub fn now_us() -> u64 {
    Instant::now().as_micros()
}

/// Sets the priority of its interrupt.
pub fn set_priority() {
    interrupt::TIM1_BRK_TIM9.set_priority(Priority::P1);
}

/// In every tick: the alarms have an interrupt of their own.
#[inline(always)]
pub fn tick() {}
