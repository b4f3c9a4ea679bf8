//! The signal that wakes the bus task: for a frame, a deadline, a free mailbox or a fault.
//!
//! One signal serves all causes, because waiting for several things would cost time in every turn
//! of the task. The control side handles the causes that can wait for its next tick: there is one
//! every millisecond anyway, so a deadline costs only a comparison there.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use control::time::Micros;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;

/// The bus task's signal.
pub static BUS: Signal = Signal::new();

/// Wakes one task: at once, at the next tick, or at a time.
pub struct Signal {
    /// The lower half of the time in microseconds: deadlines lie far less than half of its range
    /// away.
    due: AtomicU32,
    soon: AtomicBool,
    now: embassy_sync::signal::Signal<CriticalSectionRawMutex, ()>,
}

impl Signal {
    const fn new() -> Self {
        Self {
            due: AtomicU32::new(0),
            soon: AtomicBool::new(false),
            now: embassy_sync::signal::Signal::new(),
        }
    }

    /// Wakes at once.
    pub fn signal(&self) {
        self.now.signal(());
    }

    /// Asks to be woken at the next tick.
    pub fn signal_at_next_tick(&self) {
        self.soon.store(true, Ordering::Relaxed);
    }

    /// Asks to be woken at the first tick from `at` on; before the first such call, that is the
    /// first tick of all.
    pub fn signal_at(&self, at: Micros) {
        self.due.store(low(at), Ordering::Relaxed);
    }

    /// It is a tick: wakes if that has been asked for.
    pub fn tick(&self, now: Micros) {
        const HALF: u32 = 1 << 31;
        let due = low(now).wrapping_sub(self.due.load(Ordering::Relaxed)) < HALF;
        if due || self.soon.load(Ordering::Relaxed) {
            self.signal();
        }
    }

    /// Waits for a signal, unless there has been one since the last wait. What caused the signal
    /// has happened before this returns.
    pub async fn wait(&self) {
        self.now.wait().await;
        self.soon.store(false, Ordering::Relaxed);
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "compared by wrapping differences"
)]
const fn low(time: Micros) -> u32 {
    time.0 as u32
}
