//! Who feeds the independent watchdog, and when.
//!
//! The control tick feeds it, which proves its own progress, and only if the bus task has run since
//! the last feed. The bus task runs at least every 5 ms in thread mode, where it is the first to
//! starve. A control tick that hangs, an interrupt storm, or a task that never yields therefore
//! resets the chip 50 ms after the last feed (34 to 94 ms over the LSI's tolerance). It is
//! also fed with the outputs off: at start-up while the chip waits for its clock and its supply
//! (`board::power`), and where the watchdog's setting is changed, at start-up and around writes to
//! flash (`board::iwdg`), twice each time and with a bound on the time in between.
//!
//! One exception, because a reset is a hard stop of one robot under a common load: when the bus
//! side goes silent while the wheels turn, the control side detects this after 25 ms, which is
//! earlier than any reset, and ramps down. During the ramp its own progress is enough to feed the
//! watchdog, for at most [`GRACE_TICKS`]. The chip is then reset, and the next start reports the
//! cause.

use control::interface::{Mode, Report};
use control::time::TICK_US;
use protocol::Fault;

use crate::board::Watchdog;
use crate::board::post_mortem::{self, Failure};
use crate::shared::BUS_PROGRESS;

/// Control ticks between two feeds: 10 ms.
const PERIOD_TICKS: u32 = 10_000 / TICK_US;

/// Longest ramp without a bus side: 3 s.
const GRACE_TICKS: u32 = 3_000_000 / TICK_US;

/// Feeds the watchdog while both sides make progress.
pub struct Guard {
    watchdog: Watchdog,
    bus: u32,
    since_fed: u32,
    /// Ticks that only the control side has proved.
    alone: u32,
}

impl Guard {
    /// Takes the watchdog, which runs already.
    pub fn new(watchdog: Watchdog) -> Self {
        Self {
            watchdog,
            bus: BUS_PROGRESS.count(),
            since_fed: 0,
            alone: 0,
        }
    }

    /// One control tick has been done, with this result.
    pub fn tick(&mut self, report: &Report) {
        self.since_fed += 1;
        let bus = BUS_PROGRESS.count();
        let starved = report.fault == Some(Fault::BusStarved);
        if bus != self.bus {
            if self.since_fed >= PERIOD_TICKS {
                self.bus = bus;
                self.feed();
            }
            if self.alone > 0 {
                self.alone = 0;
                post_mortem::consume();
            }
        } else if starved && report.mode == Mode::Ramp && !report.standstill {
            if self.alone == 0 {
                post_mortem::write(Failure::BusStarved);
            }
            self.alone += 1;
            if self.alone < GRACE_TICKS {
                self.feed();
            }
        }
    }

    fn feed(&mut self) {
        self.since_fed = 0;
        self.watchdog.feed();
    }
}
