//! The local time of an STM32G4: the HAL's, by TIM15.

use embassy_time::Instant;

/// Microseconds since the start.
pub fn now_us() -> u64 {
    Instant::now().as_micros()
}
