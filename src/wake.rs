//! What wakes the bus task: a frame, a deadline, a free mailbox, a fault of the control side.
//!
//! One bell for all of them, because each further thing to wait for costs every turn of the task.
//! The control task looks after what can wait for its next tick: it wakes every millisecond anyway,
//! and a comparison there is all that a deadline costs.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use canopen::Micros;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;

/// The bus task's.
pub static BUS: Bell = Bell::new();

/// Wakes one task: at once, at the next tick, or at a time.
pub struct Bell {
    /// The lower half of the time in microseconds: deadlines lie far less than half of its range
    /// away.
    due: AtomicU32,
    soon: AtomicBool,
    rung: Signal<CriticalSectionRawMutex, ()>,
}

impl Bell {
    const fn new() -> Self {
        Self {
            due: AtomicU32::new(0),
            soon: AtomicBool::new(false),
            rung: Signal::new(),
        }
    }

    /// Wakes at once.
    pub fn ring(&self) {
        self.rung.signal(());
    }

    /// Asks to be woken at the next tick.
    pub fn ring_soon(&self) {
        self.soon.store(true, Ordering::Relaxed);
    }

    /// Asks to be woken at the first tick from `at` on; before the first such call, that is the
    /// first tick of all.
    pub fn ring_at(&self, at: Micros) {
        self.due.store(low(at), Ordering::Relaxed);
    }

    /// It is a tick: wakes if that has been asked for.
    pub fn tick(&self, now: Micros) {
        const HALF: u32 = 1 << 31;
        let due = low(now).wrapping_sub(self.due.load(Ordering::Relaxed)) < HALF;
        if due || self.soon.load(Ordering::Relaxed) {
            self.ring();
        }
    }

    /// Waits until it has been rung since the last time. Whatever asked for that has happened
    /// before this returns.
    pub async fn rung(&self) {
        self.rung.wait().await;
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
