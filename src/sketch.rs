//! A sketch: the image of a board whose drivers are not all written (feature `sketch`).
//!
//! It starts watchdog, clocks and local time, and shows on the LED that it is off the bus. There is
//! no CAN, no control tick and no code that raises an output other than the LED's, so it takes no
//! command and cannot be made to drive.

use crate::board::{Sketch, now, post_mortem};

/// Between two feedings of the watchdog, by the local time: where that stands still, a reset comes.
const FEEDING_US: u64 = 10_000;

/// Half a period of the LED, as of a robot off the bus.
const FLICKER_US: u64 = 50_000;

/// Runs the sketch.
pub fn run() -> ! {
    let mut sketch = Sketch::new();
    defmt::info!(
        "sketch: no CAN, no drive; clock after {=u16} ms, serial {=u32:#010x}",
        sketch.clock_wait_ms,
        sketch.serial
    );
    if let Some(failure) = post_mortem::consume() {
        defmt::error!("the last run ended with {}", failure);
    }
    let mut fed_at = now().0;
    loop {
        let time = now().0;
        if time - fed_at >= FEEDING_US {
            fed_at = time;
            sketch.watchdog.feed();
        }
        sketch.led.set((time / FLICKER_US).is_multiple_of(2));
    }
}
