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
//! | [`BUS_DUE`] | bus and back | control wakes the bus task at its tick | it is woken at the next tick |
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

/// When the bus task wants to come round without a frame.
pub static BUS_DUE: Alarm = Alarm::new();

/// Turns that the bus task has completed.
pub static BUS_PROGRESS: Progress = Progress::new();

/// Longest time by which a control tick started late, since it was last asked for.
pub static CONTROL_LATENESS: Longest = Longest::new();

/// A time that one side waits for and the other watches.
///
/// The control task wakes every millisecond anyway. To let it look after the bus task's deadline as well costs a
/// comparison; a timer of the bus task's own costs the executor's timer queue two thousand cycles a millisecond.
pub struct Alarm {
    /// The lower half of the time in microseconds: deadlines lie far less than half of its range away.
    at: AtomicU32,
    rung: Signal<CriticalSectionRawMutex, ()>,
}

impl Alarm {
    const fn new() -> Self {
        Self {
            at: AtomicU32::new(0),
            rung: Signal::new(),
        }
    }

    /// Sets the time; before the first, it is due at once.
    pub fn set(&self, at: Micros) {
        self.at.store(low(at), Ordering::Relaxed);
    }

    /// Wakes whoever waits, if it is time.
    pub fn ring_if_due(&self, now: Micros) {
        const HALF: u32 = 1 << 31;
        if low(now).wrapping_sub(self.at.load(Ordering::Relaxed)) < HALF {
            self.ring();
        }
    }

    /// Wakes whoever waits.
    pub fn ring(&self) {
        self.rung.signal(());
    }

    /// Waits until it has been rung since the last time.
    pub async fn wait(&self) {
        self.rung.wait().await;
    }
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "compared by wrapping differences"
)]
const fn low(time: Micros) -> u32 {
    time.0 as u32
}

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
