//! What the tasks share.

use core::sync::atomic::{AtomicU32, Ordering};

/// Turns that the bus task has completed.
pub static BUS_PROGRESS: Progress = Progress::new();

/// Ticks that the control task has completed.
pub static CONTROL_PROGRESS: Progress = Progress::new();

/// Longest time by which a control tick started late, since it was last asked for, in microseconds.
pub static CONTROL_LATENESS: Worst = Worst::new();

/// A count that shows that a task still runs.
pub struct Progress(AtomicU32);

impl Progress {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// Notes that the task has come round once more.
    pub fn made(&self) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }

    /// How often it has come round, wrapping.
    pub fn count(&self) -> u32 {
        self.0.load(Ordering::Relaxed)
    }
}

/// The largest value seen.
pub struct Worst(AtomicU32);

impl Worst {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// Notes a value.
    pub fn note(&self, value: u32) {
        self.0.fetch_max(value, Ordering::Relaxed);
    }

    /// Returns the largest value noted and forgets it.
    pub fn take(&self) -> u32 {
        self.0.swap(0, Ordering::Relaxed)
    }
}
