//! The board of a sketch: what a chip of a new family can have before the drivers of CAN and wheels
//! are written. Outputs are low from the first instructions on and nothing here raises one, but the
//! LED's.

use super::iwdg::Watchdog;
use super::{Begun, Led, SAFE_OUTPUTS, begin, serial};

/// Everything a sketch uses.
pub struct Sketch {
    /// LED.
    pub led: Led,
    /// Watchdog, running.
    pub watchdog: Watchdog,
    /// How long the start waited for clock and supply, ms.
    pub clock_wait_ms: u16,
    /// The chip's unique number, folded to 32 bits.
    pub serial: u32,
}

impl Sketch {
    /// Sets up watchdog, clocks and pins. To be called once.
    pub fn new() -> Self {
        let Begun {
            watchdog,
            clock_wait_ms,
        } = begin();
        Self {
            led: Led(()),
            watchdog,
            clock_wait_ms,
            serial: serial(),
        }
    }
}

/// Lowers all outputs, from any context.
pub fn cut() {
    for output in SAFE_OUTPUTS {
        output.set(false);
    }
}
