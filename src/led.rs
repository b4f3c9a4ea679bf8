//! The LED task: shows the state of the robot on LD2, in the blink codes of CiA 303-3.
//!
//! The bus task sets the pattern; the latest wins. A pattern is completed before the next one
//! starts, so a state shorter than a second may not be shown.
//!
//! | pattern | what it looks like | meaning |
//! |---|---|---|
//! | blinking | 0.2 s on, 0.2 s off | PRE-OPERATIONAL: waiting for configuration or NMT start |
//! | single flash | 0.2 s on, 1 s off | STOPPED |
//! | on | | OPERATIONAL, no fault |
//! | double flash | two of 0.2 s, 1 s off | emergency stop |
//! | triple flash | three of 0.2 s, 1 s off | another fault of its own, latched: NMT start clears it when the cause is gone |
//! | long flashes | 1 s on, 0.2 s off | stopped because another robot did; the cause is there |
//! | four flashes | four of 0.2 s, 1 s off | at start, before this task: no clock from outside, or the chip's supply is too low |
//! | flickering | 50 ms on, 50 ms off | off the bus |
//! | five short flashes | five of 50 ms, 0.6 s off | identification request (`omnibus blink`, object 0x2059) |

use core::sync::atomic::{AtomicU8, Ordering};

use embassy_time::Timer;

use crate::board::Led;

/// Pattern of the LED.
#[derive(Clone, Copy, PartialEq, Eq)]
#[repr(u8)]
pub enum Pattern {
    /// PRE-OPERATIONAL.
    Blinking,
    /// STOPPED.
    SingleFlash,
    /// OPERATIONAL.
    On,
    /// Emergency stop.
    DoubleFlash,
    /// Fault.
    TripleFlash,
    /// Another robot's fault.
    LongFlash,
    /// Bus-off.
    Flickering,
    /// Asked for by object 0x2059.
    Here,
}

impl Pattern {
    const ALL: [Self; 8] = [
        Self::Blinking,
        Self::SingleFlash,
        Self::On,
        Self::DoubleFlash,
        Self::TripleFlash,
        Self::LongFlash,
        Self::Flickering,
        Self::Here,
    ];

    /// How often it flashes, for how long each time, and the pause at the end, in milliseconds.
    const fn timing(self) -> (u8, u64, u64) {
        match self {
            Self::Blinking => (1, 200, 200),
            Self::SingleFlash => (1, 200, 1000),
            Self::On => (1, 200, 0),
            Self::DoubleFlash => (2, 200, 1000),
            Self::TripleFlash => (3, 200, 1000),
            Self::LongFlash => (1, 1000, 200),
            Self::Flickering => (1, 50, 50),
            Self::Here => (5, 50, 600),
        }
    }
}

static PATTERN: AtomicU8 = AtomicU8::new(Pattern::Blinking as u8);

/// Asks for a pattern.
pub fn show(pattern: Pattern) {
    PATTERN.store(pattern as u8, Ordering::Relaxed);
}

/// Shows the pattern asked for.
#[embassy_executor::task]
pub async fn led(mut led: Led) {
    loop {
        let asked = usize::from(PATTERN.load(Ordering::Relaxed));
        let pattern = Pattern::ALL
            .get(asked)
            .copied()
            .unwrap_or(Pattern::Blinking);
        let (flashes, on_ms, pause_ms) = pattern.timing();
        for flash in 0..flashes {
            led.set(true);
            Timer::after_millis(on_ms).await;
            if pause_ms > 0 {
                led.set(false);
            }
            if flash + 1 < flashes {
                Timer::after_millis(on_ms).await;
            }
        }
        if pause_ms > 0 {
            Timer::after_millis(pause_ms).await;
        }
    }
}
