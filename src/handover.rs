//! What the two sides share: these cells, and nothing else.
//!
//! | cell | from | to | when it is not taken in time |
//! |---|---|---|---|
//! | [`COMMAND`] | bus | control | the newer command replaces it; the older one is never wanted |
//! | [`CONFIGURATION`] | bus | control | the newer configuration replaces it |
//! | [`SYNC`] | bus | control | the newer time replaces it |
//! | [`REPORT`] | control | bus | the newer report replaces it |
//! | [`IDENTIFIED`] | control | bus | the newer result replaces it |
//! | [`BUS_PROGRESS`] | bus | control, for the watchdog | counts on; only a change matters |
//! | [`CONTROL_LATENESS`] | control | health | the largest value stays |
//!
//! A cell is copied with interrupts masked. That takes well under a microsecond for the sizes at hand, far less than
//! a frame on the bus (50 us at least), so it can delay a receive time stamp but never lose a frame.

use core::cell::Cell;
use core::sync::atomic::{AtomicU32, Ordering};

use canopen::Micros;
use controller::identification::Outcome;
use controller::{Command, Configuration, Report};
use embassy_sync::blocking_mutex::Mutex;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;

/// A value that one side replaces and the other reads: the latest wins.
pub struct Latest<T: Copy>(Mutex<CriticalSectionRawMutex, Cell<Option<T>>>);

impl<T: Copy> Latest<T> {
    const fn new() -> Self {
        Self(Mutex::new(Cell::new(None)))
    }

    /// Replaces the value.
    pub fn put(&self, value: T) {
        self.0.lock(|cell| cell.set(Some(value)));
    }

    /// Returns the latest value; `None` before the first.
    pub fn get(&self) -> Option<T> {
        self.0.lock(Cell::get)
    }
}

/// What the bus side asks for.
pub static COMMAND: Latest<Command> = Latest::new();

/// When the last SYNC was received, local time.
pub static SYNC: Latest<Micros> = Latest::new();

/// What the control side measured and decided.
pub static REPORT: Latest<Report> = Latest::new();

/// What an identification came to, until the bus side has taken it.
pub static IDENTIFIED: Signal<CriticalSectionRawMutex, Outcome> = Signal::new();

/// A new configuration, until the control side has taken it.
pub static CONFIGURATION: Signal<CriticalSectionRawMutex, Configuration> = Signal::new();

/// Turns that the bus task has completed.
pub static BUS_PROGRESS: Progress = Progress::new();

/// Longest time by which a control tick started late, since it was last asked for.
pub static CONTROL_LATENESS: Longest = Longest::new();

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

/// The longest time seen.
pub struct Longest(AtomicU32);

impl Longest {
    const fn new() -> Self {
        Self(AtomicU32::new(0))
    }

    /// Notes a time.
    pub fn note(&self, time: Micros) {
        let time_us = u32::try_from(time.0).unwrap_or(u32::MAX);
        self.0.fetch_max(time_us, Ordering::Relaxed);
    }

    /// Returns the longest time noted, in microseconds, and forgets it.
    pub fn take_us(&self) -> u32 {
        self.0.swap(0, Ordering::Relaxed)
    }
}
